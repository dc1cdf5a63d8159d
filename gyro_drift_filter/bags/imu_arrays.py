"""The Imu topic of a bag as arrays, for programs that look at all of it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.library import Connection
from gyro_drift_filter.bags.recording import BagError, messages, open_bag
from gyro_drift_filter.bags.replay import choose_topic
from gyro_drift_filter.messages.cdr import (
    IMUS,
    MalformedMessageError,
    frame_id,
    read_imu,
    read_imus,
)

Message = tuple[Connection, int, bytes]

_BATCH = 4096


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
    parts: list[NDArray[np.void]] = []
    refused = 0
    with open_bag(bag) as reader:
        chosen = choose_topic(reader, topic)
        total, done, frame = reader.message_count, 0, None
        for batch in _batches(messages(reader)):
            done += len(batch)
            progress(done, total)
            ours = [data for connection, _, data in batch if connection.topic == chosen]
            if not ours:
                continue
            part = read_imus(ours)
            usable = _one_by_one(ours) if part is None else part
            usable = usable[usable['angular_velocity_variance'] != -1.0]
            refused += len(ours) - len(usable)
            if frame is None and len(usable):
                frame = _frame(ours)
            parts.append(usable)
    table = np.concatenate(parts) if parts else np.zeros(0, IMUS)
    if not len(table):
        raise BagError(f'topic {chosen} has no message with an angular velocity')
    accelerations = table['linear_acceleration'].copy()
    accelerations[table['linear_acceleration_variance'] == -1.0] = np.nan
    return ImuArrays(
        chosen,
        frame or '',
        table['stamp'].copy(),
        table['angular_velocity'].copy(),
        accelerations,
        refused,
    )


def _batches(stream: Iterator[Message]) -> Iterator[list[Message]]:
    while batch := list(islice(stream, _BATCH)):
        yield batch


def _one_by_one(messages_: Sequence[bytes]) -> NDArray[np.void]:
    """Return what is readable of messages that differ in form."""
    parts = [read_imus([message]) for message in messages_]
    return np.concatenate([np.zeros(0, IMUS), *(part for part in parts if part is not None)])


def _frame(messages_: Sequence[bytes]) -> str:
    """Return the frame of the first message that can be read."""
    for data in messages_:
        with suppress(MalformedMessageError):
            return frame_id(data, read_imu(data)).decode('utf-8', 'replace')
    return ''
