# Copyright 2026 gyro_drift_filter maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A topic of a bag that says how a body is oriented, as arrays."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.message_types import read_message
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import BagError, Recording, messages, topic_types
from gyro_drift_filter.bags.topics import topic_named
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.phrases import counted

_log = logging.getLogger(__name__)

# Where the quaternion stands in a message, by its type.
PLACES = {
    'geometry_msgs/msg/PoseStamped': 'pose.orientation',
    'geometry_msgs/msg/PoseWithCovarianceStamped': 'pose.pose.orientation',
    'geometry_msgs/msg/TransformStamped': 'transform.rotation',
    'geometry_msgs/msg/QuaternionStamped': 'quaternion',
    'nav_msgs/msg/Odometry': 'pose.pose.orientation',
    IMU_TYPE: 'orientation',
}


@dataclass(frozen=True)
class OrientationArrays:
    """A topic, n messages in the order of their log times.

    Attributes:
        stamps: (n,) in ns.
        orientations: (n, 4) quaternions x, y, z, w from the body's axes to the world's, as stated.
    """

    stamps: NDArray[np.int64]
    orientations: NDArray[np.float64]


def read_orientations(bag: Path, topic: str) -> OrientationArrays:
    """Read the orientations of a topic, passing over messages that can't be read.

    Args:
        bag: rosbag2 folder, bare .mcap or .db3 file, or .bag file of ROS 1.
        topic: Of PoseStamped, PoseWithCovarianceStamped, TransformStamped, QuaternionStamped,
            Odometry or Imu messages.

    Raises:
        BagError: The bag can't be read, or holds no such topic or no orientations on it.
    """
    stamps, rows, damaged = [], [], 0
    with open_bag(bag) as recording:
        name, kind = chosen = _chosen(recording, topic)
        for connection, _, data in messages(recording):
            if (connection.topic, connection.msgtype) != chosen:
                continue
            try:
                message = read_message(data, connection)
                if kind == IMU_TYPE and message.orientation_covariance[0] == -1.0:
                    continue  # not reported (REP-145)
                # A type that the bag defines may lack what it is read for.
                stamp, quaternion = orientation_of(message, kind)
            except Exception:  # whatever the bytes of others bring about
                damaged += 1
                continue
            stamps.append(stamp)
            rows.append(quaternion)
    unread = f'{counted(damaged, "message")} of {name} can not be read'
    if not rows:
        raise BagError(unread if damaged else f'topic {name} has no message with an orientation')
    if damaged:
        _log.warning('%s: %s', bag, unread)
    return OrientationArrays(np.array(stamps, np.int64), np.array(rows))


def orientation_of(message: Any, kind: str) -> tuple[int, tuple[float, float, float, float]]:
    """Return stamp in ns and quaternion x, y, z, w of a message of one of the types of PLACES."""
    stamp, value = message.header.stamp, message
    for part in PLACES[kind].split('.'):
        value = getattr(value, part)
    return stamp.sec * 1_000_000_000 + stamp.nanosec, (value.x, value.y, value.z, value.w)


def _chosen(recording: Recording, wanted: str) -> tuple[str, str]:
    """Return name and type of a topic."""
    types = topic_types(recording)
    topic = topic_named(types, wanted)
    if topic is None:
        having = [topic for topic, kinds in sorted(types.items()) if set(kinds) & set(PLACES)]
        raise BagError(
            f'no topic {wanted} in the bag; of a type that has an orientation: '
            f'{", ".join(having) or "none"}'
        )
    for kind in types[topic]:
        if kind in PLACES:
            return topic, kind
    listed = ', '.join(name.rpartition('/')[2] for name in PLACES)
    raise BagError(f'topic {topic} is of type {" and ".join(types[topic])}, not one of {listed}')
