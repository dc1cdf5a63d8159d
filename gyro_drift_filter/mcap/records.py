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

"""MCAP records: their opcodes, layouts and fields.

Layouts are those of the MCAP specification (mcap.dev/spec, version 0). All integers are little
endian; a string is its length in four bytes and then UTF-8.
"""

import struct
import sys
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO, NamedTuple
from zlib import crc32

from gyro_drift_filter.errors import GyroDriftFilterError

if sys.version_info >= (3, 14):
    from compression import zstd as zstd
else:
    from backports import zstd as zstd
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F

# Between MCAP's own level, 1, and that of `zstd_fast` of ros2 bag, -5: a fifth faster than the
# former, and 3 % larger.
ZSTD_LEVEL = -1

PREFIX = struct.Struct('<BQ')  # of every record: opcode and length
CHUNK_HEAD = struct.Struct('<QQQII')  # start, end, uncompressed size and CRC, length of 'zstd'
FOOTER_FIELDS = struct.Struct('<QQI')

# No recorder makes chunks beyond this, in bytes; a file that says so lies.
LARGEST_CHUNK = 2**28


class McapError(GyroDriftFilterError):
    """A file is not as its own index says; the text says where."""


class Footer(NamedTuple):
    """The last record of a file.

    Attributes:
        start: Offset of the record.
        summary: Offset of the summary section, 0 where there is none.
        checksum: CRC-32 from there to this checksum itself, 0 where there is none.
    """

    start: int
    summary: int
    checksum: int


def read_footer(file: BinaryIO) -> Footer | None:
    """Return the footer of a file; None where something else stands in its place.

    Behind it the file is left at its last bytes, which should be `MAGIC`.
    """
    start = file.seek(0, 2) - PREFIX.size - FOOTER_FIELDS.size - len(MAGIC)
    if start < len(MAGIC):
        return None
    file.seek(start)
    head, fields = file.read(PREFIX.size), file.read(FOOTER_FIELDS.size)
    if head != PREFIX.pack(FOOTER, FOOTER_FIELDS.size):
        return None
    summary, _, checksum = FOOTER_FIELDS.unpack(fields)
    return Footer(start, summary, checksum)


class Fields:
    """Read the fields of a record one after the other; too few bytes are a `struct.error`."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._offset = 0

    def read(self, layout: str) -> Any:
        """Return the next field, or the next ones where the layout has several."""
        values = struct.unpack_from('<' + layout, self._data, self._offset)
        self._offset += struct.calcsize('<' + layout)
        return values[0] if len(values) == 1 else values

    def text(self) -> str:
        """Return the next field, a string."""
        data: bytes = self.read(f'{self.read("I")}s')
        return data.decode()


def records(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield opcode and content of records that lie behind each other."""
    offset = 0
    while offset < len(data):
        opcode, length = PREFIX.unpack_from(data, offset)
        offset += PREFIX.size
        yield opcode, data[offset : offset + length]
        offset += length


def text(value: str) -> bytes:
    """Return a string field."""
    data = value.encode()
    return struct.pack('<I', len(data)) + data


def record(opcode: int, *fields: bytes) -> bytes:
    """Return a record."""
    content = b''.join(fields)
    return PREFIX.pack(opcode, len(content)) + content


def statistics(
    counts: Mapping[int, int], numbers: tuple[int, int, int, int, int], first: int, last: int
) -> bytes:
    """Return the record that says what a file holds.

    Args:
        counts: Messages by channel.
        numbers: Of schemas, channels, attachments, metadata and chunks.
        first: Log time in ns of the first message, if there are messages.
        last: Of the last one.
    """
    total = sum(counts.values())
    times = (first, last) if total else (0, 0)
    by_channel = b''.join(struct.pack('<HQ', *item) for item in sorted(counts.items()))
    head = struct.pack('<QHIIIIQQI', total, *numbers, *times, len(by_channel))
    return record(STATISTICS, head, by_channel)


class Chunk(NamedTuple):
    """The content of a chunk record.

    Attributes:
        size: Of its records in bytes, uncompressed.
        checksum: CRC-32 of them, 0 where there is none.
        data: Its records, uncompressed; one byte more than `size` at most, to see whether it lies.
        whole: Whether all of the compressed bytes are there.
    """

    size: int
    checksum: int
    data: bytes
    whole: bool

    @property
    def is_sound(self) -> bool:
        """Whether the records are as long as they should be, and have their checksum."""
        return len(self.data) == self.size and self.checksum in (0, crc32(self.data))


def unpack_chunk(content: bytes | memoryview) -> Chunk:
    """Return what is there of a chunk, whose end may be missing.

    Raises:
        McapError: It is damaged, longer than can be, or compressed in an unknown way.
    """
    content = memoryview(content)  # of which parts are no copies
    try:
        _, _, size, checksum, name_length = CHUNK_HEAD.unpack_from(content)
        start = CHUNK_HEAD.size + name_length
        compression = bytes(content[CHUNK_HEAD.size : start]).decode()
        (compressed_size,) = struct.unpack_from('<Q', content, start)
        compressed = content[start + 8 : start + 8 + compressed_size]
        if size > LARGEST_CHUNK:
            raise McapError('can not be as long as it says')
        match compression:
            case '':
                data = bytes(compressed)
            case 'zstd':
                data = zstd.ZstdDecompressor().decompress(compressed, size + 1)
            case 'lz4':
                data = LZ4FrameDecompressor().decompress(compressed, size + 1)
            case _:
                raise McapError(f'has the unknown compression {compression!r}')
    except (struct.error, UnicodeDecodeError, zstd.ZstdError, RuntimeError) as error:
        raise McapError(f'is damaged: {error}') from error
    return Chunk(size, checksum, data, len(compressed) == compressed_size)
