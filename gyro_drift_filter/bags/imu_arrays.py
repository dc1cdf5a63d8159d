"""The Imu topic of a bag as arrays, for programs that look at all of it."""

from array import array
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.cdr import MalformedMessageError, frame_id, read_imu
from gyro_drift_filter.bags.recording import BagError, messages, open_bag
from gyro_drift_filter.bags.replay import choose_topic

_PROGRESS_EVERY = 4096


@dataclass(frozen=True)
class ImuArrays:
    """A topic, n messages in the order of their log times.

    Attributes:
        topic: Its name.
        frame: header.frame_id of the first message.
        stamps: (n,) in ns.
        angular_velocity: (n, 3) in rad/s.
        linear_acceleration: (n, 3) in m/s^2, NaN where not reported.
        refused: Messages that were malformed or did not report an angular velocity.
    """

    topic: str
    frame: str
    stamps: NDArray[np.int64]
    angular_velocity: NDArray[np.float64]
    linear_acceleration: NDArray[np.float64]
    refused: int


def read_imu_arrays(
    bag: Path,
    topic: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ImuArrays:
    """Read the Imu topic of a bag.

    Args:
        bag: rosbag2 folder or bare .mcap or .db3 file.
        topic: Needed where there are several Imu topics.
        progress: Called with the number of messages done and their total.

    Raises:
        BagError: The bag can't be read or holds no usable Imu message.
    """
    stamps, values = array('q'), array('d')
    refused, frame = 0, ''
    with open_bag(bag) as reader:
        chosen = choose_topic(reader, topic)
        total = reader.message_count
        for done, (connection, _, data) in enumerate(messages(reader), 1):
            if done % _PROGRESS_EVERY == 0:
                progress(done, total)
            if connection.topic != chosen:
                continue
            try:
                imu = read_imu(data)
            except MalformedMessageError:
                refused += 1
                continue
            if not imu.angular_velocity_reported:
                refused += 1
                continue
            if not stamps:
                frame = frame_id(data, imu).decode('utf-8', 'replace')
            stamps.append(imu.stamp)
            values.extend(imu.angular_velocity)
            values.extend(imu.linear_acceleration)
    if not stamps:
        raise BagError(f'topic {chosen} has no message with an angular velocity')
    table = np.frombuffer(values, np.float64).reshape(-1, 6)
    return ImuArrays(
        chosen,
        frame,
        np.frombuffer(stamps, np.int64),
        table[:, :3].copy(),
        table[:, 3:].copy(),
        refused,
    )
