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

"""What a recording is to all who read one, whatever storage it is in."""

import math
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.library import (
    Connection,
    ConnectionExtRosbag2,
    Qos,
    RPath,
)
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.mcap.message_kernels import ROW

# What the name of a file of rosbag2 ends with.
ROSBAG2_SUFFIXES = ('.mcap', '.db3')

# The serialization of messages that can't be converted to CDR.
OF_ROS1 = 'ros1'

# What is said of a file with damage in its middle, before the reason.
READ_NO_FURTHER = 'is damaged and can be read no further'

Identity = tuple[str, str, str, tuple[Qos, ...]]


class BagError(GyroDriftFilterError):
    """A bag can't be read or written; the text says which and why."""


class OutputError(BagError):
    """A bag can't be written, whatever it was to hold: the disk is full, the name is taken."""


class Damage(NamedTuple):
    """A part of a recording that can't be read.

    Attributes:
        why: What is damaged, as a sentence.
        first: Log time in ns from which on messages are lost; None where that is not known.
        last: Log time up to which they are; None where all that follow are lost.
    """

    why: str
    first: int | None = None
    last: int | None = None

    def seconds(self, begin: int | None) -> tuple[float, float]:
        """Return from when to when messages are lost, in s since a log time in ns.

        Without such a time nothing was read before, so that the recording begins with these.
        """
        if self.first is None:
            return -math.inf, math.inf
        begin = self.first if begin is None else begin
        last = math.inf if self.last is None else 1e-9 * (self.last - begin)
        return 1e-9 * (self.first - begin), last

    def text(self, begin: int | None) -> str:
        """Return what is damaged, and when messages are lost; times are counted as above."""
        if self.first is None:
            return self.why
        first, last = self.seconds(begin)
        until = 'on' if self.last is None else f'to {last:.3f} s'
        return (
            f'{self.why}; what is lost are the messages from {first:.3f} s {until}, counted from '
            'the first message of the recording'
        )


class Piece(NamedTuple):
    """Messages that follow each other in a recording.

    Attributes:
        data: What they stand in, bytes.
        rows: (n,) ROW of each, in the order of their log times, but see `Recording.pieces`; the
            channel is the `id` of its connection.
        damage: Why there are no messages, where they can't be read.
    """

    data: NDArray[np.uint8]
    rows: Any
    damage: Damage | None = None

    def message(self, row: int) -> bytes:
        """Return a message by the index of its row."""
        start, size = self.rows[row]['start'], self.rows[row]['size']
        return self.data[start : start + size].tobytes()


class StoredPath(RPath, Protocol):
    """What stands for a path in a store that is no file system."""

    @property
    def name(self) -> str:
        """Its last part."""

    def iterdir(self) -> Iterator[Self]:
        """Yield what a folder holds."""

    def glob(self, pattern: str) -> Iterator[Self]:
        """Yield what matches a pattern in a folder."""


class Recording(Protocol):
    """A recording that is open for reading.

    Attributes:
        path: What is read.
        connections: Topics with their types, once for each publisher.
        message_count: How many messages there are.
        in_order: Whether all pieces follow each other in time; files of a folder may overlap.
    """

    path: Path
    connections: list[Connection]
    message_count: int
    in_order: bool

    def pieces(self) -> Iterator[Piece]:
        """Yield all messages, in the order of their log times where they are `in_order`.

        Else those of each file are in order, one file behind the other, also within a piece.
        In place of messages that can't be read there is a piece with their `Damage`.

        Raises:
            BagError: The recording can be read no further.
        """


def damaged_piece(damage: Damage) -> Piece:
    """Return what stands in place of messages that can't be read."""
    return Piece(np.empty(0, np.uint8), np.empty(0, ROW), damage)


def messages(recording: Recording) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, log time in ns and bytes of each message, in the order of the pieces.

    Raises:
        BagError: The recording is damaged from some message on.
    """
    connections = {connection.id: connection for connection in recording.connections}
    begin = None
    for piece in recording.pieces():
        if piece.damage is not None:
            raise BagError(piece.damage.text(begin))
        if begin is None and len(piece.rows):
            begin = int(piece.rows['log_time'][0])
        for k, row in enumerate(piece.rows):
            log_time = int(row['log_time']) % 2**64
            yield connections[int(row['channel'])], log_time, piece.message(k)


def length_by_id(recording: Recording) -> int:
    """Return the length of an array with an element for each connection, by its `id`."""
    return 1 + max((connection.id for connection in recording.connections), default=0)


def are_among(recording: Recording, ids: Collection[int]) -> NDArray[np.bool_]:
    """Return by the `id` of a connection whether it is one of these: (`length_by_id`,)."""
    among = np.zeros(length_by_id(recording), np.bool_)
    among[list(ids)] = True
    return among


def channels_of(recording: Recording, topic: str, kind: str) -> NDArray[np.bool_]:
    """Return by the `id` of a connection whether it is of a topic and a type, in CDR.

    The result is like that of `are_among`.

    Raises:
        BagError: No message of the topic is.
    """
    wanted = topic, kind
    ids = [c.id for c in recording.connections if (c.topic, c.msgtype) == wanted and is_cdr(c)]
    if not ids:
        others = [c for c in recording.connections if (c.topic, c.msgtype) == wanted]
        raise BagError(f'the messages of topic {topic} {why_not_cdr(others[0])}')
    return are_among(recording, ids)


def topic_types(recording: Recording) -> dict[str, list[str]]:
    """Return the types of each topic: one, but where publishers did not agree."""
    types: dict[str, set[str]] = {}
    for connection in recording.connections:
        types.setdefault(connection.topic, set()).add(connection.msgtype)
    return {topic: sorted(kinds) for topic, kinds in types.items()}


def identity(connection: Connection) -> Identity:
    """Return what tells connections apart for a reader: topic, type, serialization and QoS."""
    extension = connection.ext
    assert isinstance(extension, ConnectionExtRosbag2)
    qos = tuple(extension.offered_qos_profiles)
    return connection.topic, connection.msgtype, extension.serialization_format, qos


def is_cdr(connection: Connection) -> bool:
    """Tell whether a topic's messages are serialized as ROS 2 does; rosbags writes no others."""
    extension = connection.ext
    return isinstance(extension, ConnectionExtRosbag2) and extension.serialization_format == 'cdr'


def why_not_cdr(connection: Connection) -> str:
    """Return why messages that are not in CDR can't be taken, as the end of a sentence."""
    extension = connection.ext
    if isinstance(extension, ConnectionExtRosbag2) and extension.serialization_format == OF_ROS1:
        return 'can not be converted to ROS 2: their definition can not be read, or is another one'
    return 'are not in CDR'
