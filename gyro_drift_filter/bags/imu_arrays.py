"""The Imu topic of a bag as arrays, for programs that look at all of it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import BagError, by_connection
from gyro_drift_filter.bags.topics import choose_topic
from gyro_drift_filter.core.sample import SAMPLE
from gyro_drift_filter.messages.imu import ImuKind, frame_id


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
    parts = [np.zeros(0, SAMPLE)]
    done = refused = 0
    frame = ''
    with open_bag(bag) as recording:
        chosen = choose_topic(recording, topic)
        is_imu = np.zeros(by_connection(recording), np.bool_)
        is_imu[[c.id for c in recording.connections if c.topic == chosen]] = True
        for piece in recording.pieces():
            imus = read_imus(piece, is_imu)
            good = imus[imus['kind'] == ImuKind.GOOD]
            if len(good) and not any(map(len, parts)):
                frame = frame_id(piece.message(good[0]['row']), good[0])
            parts.append(good['sample'])
            refused += len(imus) - len(good)
            done += len(piece.rows)
            progress(done, recording.message_count)
    samples = np.concatenate(parts)
    if not len(samples):
        raise BagError(f'topic {chosen} has no message with an angular velocity')
    return ImuArrays(
        chosen,
        frame,
        samples['stamp'].copy(),
        samples['angular_velocity'].copy(),
        samples['linear_acceleration'].copy(),
        refused,
    )
