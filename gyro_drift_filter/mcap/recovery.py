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

"""MCAP files without a good summary: made whole where they were cut off, as by a killed recorder.

Such a file has no summary, and its last records may be missing. All complete records are read, and
of a last chunk that is incomplete as much as can be unpacked. A file whose summary is damaged is
read in the same way, as only the summary tells where its chunks are. A whole file that was written
without a summary needs no copy: what it would say is found by reading all of the file.
"""

import logging
import struct
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

import numpy as np

from gyro_drift_filter.mcap.message_kernels import RECORD_BYTES, rows_of
from gyro_drift_filter.mcap.reader import Openable
from gyro_drift_filter.mcap.records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    FOOTER_FIELDS,
    LARGEST_CHUNK,
    MAGIC,
    MESSAGE,
    PREFIX,
    SCHEMA,
    McapError,
    read_footer,
    record,
    records,
    statistics,
    unpack_chunk,
)
from gyro_drift_filter.mcap.writer import McapWriter

_log = logging.getLogger(__name__)

_KEY = struct.Struct('<H')
_MESSAGE_HEAD = struct.Struct('<HIQ')  # channel, sequence, log time
_CHECKSUM_BYTES = 4  # the last field of a footer
_BLOCK = 2**20  # bytes that are read at once for a checksum


def is_cut_off(path: Openable) -> bool:
    """Tell whether a file begins as MCAP and does not end so.

    Raises:
        OSError: It can't be read.
    """
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
        file.seek(max(0, file.seek(0, 2) - len(MAGIC)))
        return file.read() != MAGIC


def has_damaged_summary(path: Openable) -> bool:
    """Tell whether a file begins and ends as MCAP, and has another summary than was written.

    What tells is the checksum in the footer. Without a checksum, or without a summary, nothing can
    be known.

    Raises:
        OSError: The file can't be read.
    """
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
        footer = read_footer(file)
        if file.read() != MAGIC:
            return False
        if footer is None or footer.summary > footer.start:
            return True
        if footer.summary == 0 or footer.checksum == 0:
            return False
        end = footer.start + PREFIX.size + FOOTER_FIELDS.size - _CHECKSUM_BYTES
        return _checksum(file, footer.summary, end) != footer.checksum


def _checksum(file: BinaryIO, start: int, end: int) -> int:
    """Return the CRC-32 of a part of a file."""
    file.seek(start)
    checksum = 0
    for place in range(start, end, _BLOCK):
        checksum = crc32(file.read(min(_BLOCK, end - place)), checksum)
    return checksum


def recover(source: Openable, destination: Path) -> int:
    """Write all whole messages of a file into a new one, up to the first damage; that is logged.

    Returns:
        Their number.

    Raises:
        McapError: The file is damaged before its first channel.
        OSError: A file can't be read or written.
    """
    writer = McapWriter(destination, '')
    try:
        with source.open('rb') as file:
            try:
                for opcode, content, whole in _records(file):
                    if opcode == CHUNK:
                        _take_records(writer, _unpacked(content, whole=whole))
                    else:
                        _take_records(writer, record(opcode, content))
            except McapError as error:
                # After a power cut the end may be there without having been written.
                if not writer.counts:
                    raise
                place = file.tell()
                behind = file.seek(0, 2) - place
                _log.warning(
                    '%s %s: this and the %d bytes behind it are not read', source, error, behind
                )
        writer.finish()
    except BaseException:
        writer.abort()
        raise
    return sum(writer.counts.values())


def summary_of(file: BinaryIO) -> bytes:
    """Return the summary that a whole file might have had, but for an index; a footer ends it.

    Raises:
        McapError: The file is damaged.
        struct.error: Likewise.
    """
    found: dict[tuple[int, bytes], bytes] = {}
    counts: Counter[int] = Counter()
    first, last, chunks = 2**64 - 1, 0, 0
    try:
        for opcode, content, whole in _records(file):
            chunks += opcode == CHUNK
            data = _unpacked(content, whole=whole) if opcode == CHUNK else record(opcode, content)
            for kind, fields in records(data):
                if kind in (SCHEMA, CHANNEL):
                    found[kind, fields[: _KEY.size]] = record(kind, fields)
                elif kind == MESSAGE:
                    channel, _, time = _MESSAGE_HEAD.unpack_from(fields)
                    counts[channel] += 1
                    first, last = min(first, time), max(last, time)
    except McapError as error:
        raise McapError(f'it {error}') from error
    kinds = Counter(kind for kind, _ in found)
    numbers = kinds[SCHEMA], kinds[CHANNEL], 0, 0, chunks
    definitions = (found[key] for key in sorted(found))
    return b''.join((*definitions, statistics(counts, numbers, first, last), record(FOOTER)))


def _records(file: BinaryIO) -> Iterator[tuple[int, bytes, bool]]:
    """Yield opcode, content and whether that is whole, of the records of the data section."""
    end = file.seek(0, 2)
    file.seek(len(MAGIC))
    while len(prefix := file.read(PREFIX.size)) == PREFIX.size:
        opcode, length = PREFIX.unpack(prefix)
        if opcode in (DATA_END, FOOTER):
            return
        # Whatever the length says, no more is read than is there.
        if length > LARGEST_CHUNK and opcode in (SCHEMA, CHANNEL, MESSAGE, CHUNK):
            raise McapError(f'has a record at byte {file.tell()} that is too long')
        if opcode in (SCHEMA, CHANNEL, MESSAGE, CHUNK):
            content = file.read(length)
            if opcode == CHUNK or len(content) == length:
                yield opcode, content, len(content) == length
        elif length > end - file.tell():
            return
        else:
            file.seek(length, 1)


def _unpacked(content: bytes, *, whole: bool) -> bytes:
    """Return the records of a chunk; none where it was cut off too early."""
    try:
        chunk = unpack_chunk(content)
    except McapError:
        if whole:
            raise
        return b''
    if whole and not chunk.is_sound:
        raise McapError('is damaged: the size or checksum of a chunk is wrong')
    return chunk.data


def _take_records(writer: McapWriter, data: bytes) -> None:
    """Write the whole records of a chunk."""
    array = np.frombuffer(data, np.uint8, _hand_on(writer, data))
    rows = rows_of(array, writer.numbers)
    if rows is None:
        raise McapError('holds records that are not sound')
    if len(rows):
        starts, ends = rows['start'] - RECORD_BYTES, rows['start'] + rows['size']
        parts = [array[start:end] for start, end in zip(starts, ends, strict=True)]
        writer.write_records(np.concatenate(parts), np.cumsum(ends - starts))


def _hand_on(writer: McapWriter, data: bytes) -> int:
    """Hand schemas and channels of a chunk on; return where its last whole record ends."""
    offset = 0
    while offset + PREFIX.size <= len(data):
        opcode, length = PREFIX.unpack_from(data, offset)
        end = offset + PREFIX.size + length
        if end > len(data):
            break
        if opcode in (SCHEMA, CHANNEL) and length >= _KEY.size:
            (key,) = _KEY.unpack_from(data, offset + PREFIX.size)
            if opcode == SCHEMA:
                writer.add_schema(key, data[offset:end])
            elif key not in writer.counts:
                writer.add_channel(key, data[offset:end])
        offset = end
    return offset
