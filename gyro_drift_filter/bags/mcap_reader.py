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

"""Read a recording that is a single plain MCAP file chunk by chunk, as fast as the disk."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.definitions import LibraryOfRos2
from gyro_drift_filter.bags.library import DirectoryReader, McapReader
from gyro_drift_filter.bags.recording import (
    READ_NO_FURTHER,
    BagError,
    Damage,
    Piece,
    damaged_piece,
    identity,
)
from gyro_drift_filter.bags.rosbags_reader import RosbagsReader
from gyro_drift_filter.mcap.message_kernels import CHANNELS
from gyro_drift_filter.mcap.reader import Layout, Openable, read_chunk, read_layout
from gyro_drift_filter.mcap.records import McapError


class ChunkReader(RosbagsReader):
    """A `Recording` that is an MCAP file whose chunks follow each other in time."""

    def __init__(
        self, library: LibraryOfRos2, file: Openable, layout: Layout, numbers: NDArray[np.int64]
    ) -> None:
        """Take the topics from rosbags, and the messages from the file.

        `numbers` is the connection's `id` by channel of the file, -1 where there is none.
        """
        super().__init__(library)
        self._file, self._layout, self._numbers = file, layout, numbers

    def _pieces(self) -> Iterator[Piece]:
        """Yield a piece for each chunk.

        The next chunk is read meanwhile, in a thread of its own.
        """
        pieces = self._chunks()
        try:
            with ThreadPoolExecutor(1) as worker:
                coming = worker.submit(next, pieces, None)
                while (piece := coming.result()) is not None:
                    coming = worker.submit(next, pieces, None)
                    yield piece
        except OSError as error:
            raise BagError(f'{self._file} {READ_NO_FURTHER}: {error}') from error

    def _chunks(self) -> Iterator[Piece]:
        """Yield a piece for each chunk; for one that is damaged, a piece that says so."""
        with self._file.open('rb') as file:
            for chunk in self._layout.chunks():
                try:
                    yield Piece(*read_chunk(file, chunk, self._numbers))
                except McapError as error:
                    why = f'{self._file} {READ_NO_FURTHER}: {error}'
                    yield damaged_piece(Damage(why, chunk.first, chunk.last))


def chunk_reader(library: LibraryOfRos2) -> ChunkReader | None:
    """Return a reader of the file that rosbags has opened, or None where it is of another kind."""
    storage: Any = library.storage
    if isinstance(storage, DirectoryReader):
        if len(storage.storages) != 1 or storage.metadata.compression_mode == 'message':
            return None
        storage = storage.storages[0]
    if not isinstance(storage, McapReader):
        return None
    file: Openable = storage.path
    layout = read_layout(file)
    if layout is None:
        return None
    # The library numbers its connections anew; alike ones can't be told apart, so are left to it.
    outer = {identity(connection): connection for connection in library.connections}
    if len(outer) != len(library.connections):
        return None
    numbers = np.full(CHANNELS, -1)
    for inner in storage.connections:
        same = outer.get(identity(inner))
        if same is None or layout.channels.get(inner.id) != (inner.topic, inner.msgtype):
            return None
        numbers[inner.id] = same.id
    # Nobody asks the library for messages any more, and its index grows with the recording.
    storage.chunks.clear()
    return ChunkReader(library, file, layout, numbers)
