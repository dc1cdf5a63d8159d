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

"""Read a recording by rosbags, message by message: whatever storage it is in."""

import struct
from collections.abc import Iterable, Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from gyro_drift_filter.bags.definitions import LibraryOfRos1, LibraryOfRos2
from gyro_drift_filter.bags.library import Connection, DirectoryReader
from gyro_drift_filter.bags.recording import READ_NO_FURTHER, BagError, Damage, Piece, damaged_piece
from gyro_drift_filter.errors import reason
from gyro_drift_filter.mcap.message_kernels import ROW

# A piece ends with the message that reaches one of these.
_PIECE_MESSAGES = 4096
_PIECE_BYTES = 2**22
_ZSTD = b'\x28\xb5\x2f\xfd'  # begins what is compressed (RFC 8878, 3.1.1), and no message of ROS


class RosbagsReader:
    """A `Recording` that rosbags has opened."""

    def __init__(self, library: LibraryOfRos1 | LibraryOfRos2) -> None:
        self.path = Path(str(library.path))
        self.connections = library.connections
        self.message_count = library.message_count
        self._library = library
        self.in_order = True
        # rosbags reads the files of a folder in the order of its metadata.yaml.
        if isinstance(storage := getattr(library, 'storage', None), DirectoryReader):
            storage.storages.sort(key=lambda file: file.metadata.start_time)
            times = [(f.metadata.start_time, f.metadata.end_time) for f in storage.storages]
            # An end is one ns behind the last message.
            self.in_order = all(end - 1 <= start for (_, end), (start, _) in pairwise(times))

    def pieces(self) -> Iterator[Piece]:
        """Yield all messages, see `Recording`."""
        for k, piece in enumerate(self._pieces()):
            # Where messages are compressed, all are. A later one that looks so is merely damaged.
            if k == 0 and len(piece.rows) and piece.message(0).startswith(_ZSTD):
                raise BagError(
                    f'{self.path} holds compressed messages, which only its metadata.yaml '
                    'tells how to read: name the folder that both are in'
                )
            yield piece

    def _pieces(self) -> Iterator[Piece]:
        times: list[int] = []
        channels: list[int] = []
        contents: list[bytes] = []
        size, read_to, failure = 0, None, ''
        try:
            for connection, log_time, data in self._messages():
                times.append(log_time)
                channels.append(connection.id)
                contents.append(data)
                size += len(data)
                read_to = log_time
                if len(times) == _PIECE_MESSAGES or size >= _PIECE_BYTES:
                    yield _piece(times, channels, contents)
                    times, channels, contents, size = [], [], [], 0
        except BagError as error:
            failure = str(error)
        if times:
            yield _piece(times, channels, contents)
        if failure:
            yield damaged_piece(Damage(failure, read_to if self.in_order else None))

    def _messages(self) -> Iterator[tuple[Connection, int, bytes]]:
        # An empty selection of connections makes rosbags read all, and fail where there are none.
        if not self.connections:
            return
        try:
            yield from self._library.messages()
        except Exception as error:
            raise BagError(f'{self.path} {READ_NO_FURTHER}: {self._reason(error)}') from error

    def _reason(self, error: Exception) -> str:
        """Return why no further message can be read."""
        return reason_of_library(error)


def reason_of_library(error: Exception) -> str:
    """Return the text of an error that rosbags raises, where that is meant to be read."""
    mishap = TypeError, LookupError, AttributeError, AssertionError, struct.error
    if isinstance(error, mishap):  # the parser itself has stumbled, and tells of its own code
        return 'it is damaged, or something else'
    return reason(error)


def _piece(times: list[int], channels: list[int], contents: Iterable[bytes]) -> Piece:
    rows = np.empty(len(times), ROW)
    rows['log_time'] = np.array(times, np.uint64).view(np.int64)
    rows['channel'] = channels
    sizes = np.array([len(content) for content in contents], np.int64)
    rows['size'], rows['start'] = sizes, np.cumsum(sizes) - sizes
    return Piece(np.frombuffer(b''.join(contents), np.uint8), rows)
