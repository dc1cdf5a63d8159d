"""Make a whole MCAP file of one that was cut off, as when the recorder was killed.

Its summary is missing then, and the last records may be. They are read one after the other as far
as they go; what is there of the last chunk is unpacked as far as that goes.
"""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import CHANNELS, RECORD_BYTES, ROW, list_messages
from gyro_drift_filter.mcap.records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    LARGEST_CHUNK,
    MAGIC,
    MESSAGE,
    PREFIX,
    SCHEMA,
    McapError,
    unpack_chunk,
)
from gyro_drift_filter.mcap.writer import McapWriter

_KEY = struct.Struct('<H')


def is_cut_off(path: Path) -> bool:
    """Tell whether a file begins as MCAP and does not end so.

    Raises:
        OSError: It can't be read.
    """
    with path.open('rb') as file:
        if file.read(len(MAGIC)) != MAGIC:
            return False
        file.seek(max(0, file.seek(0, 2) - len(MAGIC)))
        return file.read() != MAGIC


def recover(source: Path, destination: Path) -> int:
    """Write all whole messages of a file that was cut off into a new one.

    Returns:
        Their number.

    Raises:
        McapError: The first chunk is damaged.
        OSError: A file can't be read or written.
    """
    writer = McapWriter(destination, '')
    try:
        with source.open('rb') as file:
            for opcode, content, whole in _records(file):
                if opcode != CHUNK:
                    _take_records(writer, PREFIX.pack(opcode, len(content)) + content)
                    continue
                try:
                    data = unpack_chunk(content).data
                except McapError:
                    # After a power cut the end may be there without having been written.
                    if whole and not writer.counts:
                        raise
                    break
                _take_records(writer, data)
        writer.finish()
    except BaseException:
        writer.abort()
        raise
    return sum(writer.counts.values())


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


def _take_records(writer: McapWriter, data: bytes) -> None:
    """Write the whole records of a chunk."""
    whole = _whole(writer, data)
    array = np.frombuffer(data, np.uint8)[:whole]
    rows = np.empty(whole // RECORD_BYTES + 1, ROW)
    known = np.zeros(CHANNELS, np.bool_)
    known[list(writer.counts)] = True
    count = list_messages(array, known, rows)
    if count < 0:
        raise McapError('holds records that are not sound')
    _write(writer, array, rows[:count])


def _whole(writer: McapWriter, data: bytes) -> int:
    """Return where the last whole record of a chunk ends; hand schemas and channels on."""
    place = 0
    while place + PREFIX.size <= len(data):
        opcode, length = PREFIX.unpack_from(data, place)
        end = place + PREFIX.size + length
        if end > len(data):
            break
        if opcode in (SCHEMA, CHANNEL) and length >= _KEY.size:
            (key,) = _KEY.unpack_from(data, place + PREFIX.size)
            if opcode == SCHEMA:
                writer.add_schema(key, data[place:end])
            elif key not in writer.counts:
                writer.add_channel(key, data[place:end])
        place = end
    return place


def _write(writer: McapWriter, array: NDArray[np.uint8], rows: NDArray[np.void]) -> None:
    """Write the messages that ROWs tell of."""
    if not len(rows):
        return
    starts, sizes = rows['start'] - RECORD_BYTES, rows['size'] + RECORD_BYTES
    index = np.column_stack((rows['log_time'], np.append(0, np.cumsum(sizes[:-1]))))
    pieces = [array[start : start + size] for start, size in zip(starts, sizes, strict=True)]
    writer.write_bulk(np.concatenate(pieces), rows['channel'], index)
