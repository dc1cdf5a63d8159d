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

"""The Imu topic of a bag as arrays, in parts or as a whole."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import BagError, channels_of
from gyro_drift_filter.bags.selection import Selection, choose_topic
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.messages.imu import IMU_TYPE, ImuKind, frame_id


@dataclass(frozen=True)
class ImuPart:
    """The good messages, m of them, of a piece of a recording.

    Attributes:
        topic: Its name.
        frame: header.frame_id of the first message; empty where there is none.
        samples: (m,) of `SAMPLE`.
        log_times: (m,) in ns.
        refused: Messages of the piece that were malformed or did not report an angular velocity.
    """

    topic: str
    frame: str
    samples: Any
    log_times: NDArray[np.int64]
    refused: int


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


def imu_parts(
    bag: Path,
    topic: str | None,
    progress: Callable[[int, int], None],
    *,
    between: tuple[float, float] = (0.0, math.inf),
) -> Iterator[ImuPart]:
    """Yield the Imu topic of a bag piece by piece.

    Args:
        bag: rosbag2 folder, bare .mcap or .db3 file, or .bag file of ROS 1.
        topic: Needed where there are several Imu topics.
        progress: Called with the number of messages done and their total.
        between: First and last time to be used, in s of log time since the first message of the
            recording.

    Raises:
        BagError: The bag can't be read or holds no usable Imu message in that time.
    """
    start, end = between
    selection = Selection(start=start, end=end)
    good_ones = 0
    with open_bag(bag) as recording:
        chosen = choose_topic(recording, topic)
        is_imu = channels_of(recording, chosen, IMU_TYPE)
        for piece in selection.pieces(recording, progress):
            imus = read_imus(piece, is_imu)
            good = imus[imus['kind'] == ImuKind.GOOD]
            frame = frame_id(piece.message(good[0]['row']), good[0]) if len(good) else ''
            log_times = np.asarray(piece.rows['log_time'][good['row']])
            good_ones += len(good)
            yield ImuPart(chosen, frame, good['sample'], log_times, len(imus) - len(good))
    if not good_ones:
        raise BagError(f'topic {chosen} has no message with an angular velocity{selection.when}')


def usable(values: NDArray[np.float64], largest: float = LARGEST_RATE) -> NDArray[np.float64]:
    """Return values (n, 3) with NaN for those beyond the largest, as the filter leaves them out."""
    return np.where(np.abs(values) <= largest, values, np.nan)


def read_imu_arrays(
    bag: Path,
    topic: str | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> ImuArrays:
    """Read the Imu topic of a bag; arguments and errors are those of `imu_parts`."""
    parts = list(imu_parts(bag, topic, progress))
    samples = np.concatenate([part.samples for part in parts])
    return ImuArrays(
        parts[0].topic,
        next(part.frame for part in parts if len(part.samples)),
        samples['stamp'].copy(),
        samples['angular_velocity'].copy(),
        samples['linear_acceleration'].copy(),
        sum(part.refused for part in parts),
    )
