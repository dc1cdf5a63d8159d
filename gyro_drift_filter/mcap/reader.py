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

"""Read MCAP files chunk by chunk: what `replay` needs to be as fast as the disk.

What is not laid out as ROS 2 recorders do is left to rosbags, see `read_layout`.
"""

import struct
from array import array
from collections.abc import Iterator
from typing import Any, BinaryIO, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.mcap.message_kernels import rows_of, times_of
from gyro_drift_filter.mcap.records import (
    CHANNEL,
    CHUNK,
    CHUNK_INDEX,
    MAGIC,
    PREFIX,
    SCHEMA,
    Fields,
    McapError,
    read_footer,
    records,
    unpack_chunk,
)

_LARGEST_SUMMARY = 2**26  # bytes: enough for 600,000 chunks
_LATEST = 2**63  # ns: log times are unsigned in a file, and signed in all that counts with them


class Openable(Protocol):
    """A file that is opened by its path, or by what stands for one, as of an object store."""

    def open(self, mode: Literal['rb'], /) -> BinaryIO:
        """Open it for reading."""


class ChunkIndex(NamedTuple):
    """Where a chunk stands, as the summary has it.

    Attributes:
        first: Log time of its first message in ns.
        last: Of its last message.
        start: Offset of its record in the file.
        length: Of the record, with opcode and length.
    """

    first: int
    last: int
    start: int
    length: int


class Layout(NamedTuple):
    """What the summary section of a file says.

    Attributes:
        channels: Topic and type by channel id.
        chunk_fields: (n, 4) those of a `ChunkIndex` in each row, as a long recording has many.
    """

    channels: dict[int, tuple[str, str]]
    chunk_fields: NDArray[np.uint64]

    def chunks(self) -> Iterator[ChunkIndex]:
        """Yield the chunks in the order of their log times; they do not overlap."""
        for fields in self.chunk_fields:
            yield ChunkIndex(*fields.tolist())


def read_layout(path: Openable) -> Layout | None:
    """Return the layout of an MCAP file, or None where it is no plain chunked and indexed one.

    None stands for: no summary, chunks without an index of their messages or that overlap in time,
    anything that can't be read. A reader for all files has to take over then.
    """
    try:
        with path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                return None
            footer = read_footer(file)
            if footer is None or file.read() != MAGIC:
                return None
            summary, size = footer.summary, footer.start - footer.summary
            if summary < len(MAGIC) or not 0 < size <= _LARGEST_SUMMARY:
                return None
            file.seek(summary)
            return _layout(file.read(size), summary)
    except (OSError, struct.error, UnicodeDecodeError, KeyError, IndexError):
        return None


def _layout(summary: bytes, end: int) -> Layout | None:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    fields_of_chunks = array('Q')  # no tuples, as a long recording has many
    for opcode, content in records(summary):
        fields = Fields(content)
        if opcode == SCHEMA:
            key = fields.read('H')
            schemas[key] = fields.text()
        elif opcode == CHANNEL:
            key, schema = fields.read('HH')
            channels[key] = fields.text(), schemas[schema]
        elif opcode == CHUNK_INDEX:
            fields_of_chunks.extend(fields.read('QQQQ'))
            # Readers that go by the index pass over a chunk without one.
            if fields.read('I') == 0:
                return None
    chunks = np.array(fields_of_chunks, np.uint64).reshape(-1, 4)
    chunks = chunks[np.lexsort(chunks.T[::-1])]  # by the first column, then by the next one
    first, last, start, length = chunks.T
    # At equal times the one that stands first in the file is read first.
    early = (first[1:] == last[:-1]) & (start[1:] < start[:-1])
    if not len(chunks) or np.any(first[1:] < last[:-1]) or np.any(early) or last.max() >= _LATEST:
        return None
    if np.any(start > end) or np.any(length > end - start):
        return None
    return Layout(channels, chunks)


def read_chunk(
    file: BinaryIO, chunk: ChunkIndex, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.uint8], Any]:
    """Return the decompressed records of a chunk, and ROWs of its messages by their log times.

    `numbers` is as for `list_messages`.

    Raises:
        McapError: The chunk is damaged.
        OSError: The file can't be read.
    """
    file.seek(chunk.start)
    data = np.frombuffer(_decompressed(file.read(chunk.length), chunk), np.uint8)
    rows = rows_of(data, numbers)
    first, last, ascend = chunk.first, chunk.last, True
    if rows is not None and len(rows):
        first, last, ascend = times_of(rows)
    if rows is None or not chunk.first <= first <= last <= chunk.last:
        raise McapError(f'the records in the chunk at byte {chunk.start} are not sound')
    return data, rows if ascend else rows[np.argsort(rows['log_time'], kind='stable')]


def _decompressed(record: bytes, chunk: ChunkIndex) -> bytes:
    if len(record) < PREFIX.size or PREFIX.unpack_from(record) != (
        CHUNK,
        chunk.length - PREFIX.size,
    ):
        raise McapError(f'no chunk at byte {chunk.start}, where the index has one')
    try:
        content = unpack_chunk(memoryview(record)[PREFIX.size :])
    except McapError as error:
        raise McapError(f'the chunk at byte {chunk.start} {error}') from error
    if not content.whole:
        raise McapError(f'the chunk at byte {chunk.start} can not be as long as it says')
    if not content.is_sound:
        raise McapError(f'the chunk at byte {chunk.start} is damaged: size or checksum is wrong')
    return content.data
