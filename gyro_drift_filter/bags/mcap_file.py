"""MCAP records, read and written chunk by chunk: what `replay` needs to be as fast as the disk.

Record layouts are those of the MCAP specification (mcap.dev/spec, version 0). All integers are
little endian; a string is its length in four bytes and then UTF-8. What is not laid out as ROS 2
recorders do is left to rosbags, see `read_layout`.
"""

import struct
import sys
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import ENTRY
from gyro_drift_filter.bags.library import (
    CompressionMode,
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
)
from gyro_drift_filter.core.errors import GyroDriftFilterError

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]

MAGIC = b'\x89MCAP0\r\n'
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX = range(1, 9)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = 0x0B, 0x0C, 0x0D, 0x0E, 0x0F

_PREFIX = struct.Struct('<BQ')  # of every record: opcode and length
_CHUNK = struct.Struct('<QQQII')  # start, end, uncompressed size and CRC, length of 'zstd'
_FOOTER = struct.Struct('<QQI')
# A chunk is closed with the message that makes it longer, as rosbags does.
CHUNK_BYTES = 2**20
# No recorder makes chunks beyond this, in bytes; a file that says so lies.
LARGEST_CHUNK = 2**28
_LARGEST_SUMMARY = 2**26  # bytes: enough for 600,000 chunks
_LATEST = 2**63  # ns: log times are unsigned in a file, and signed in all that counts with them
# Chunks on their way to the disk.
_PENDING = 3

_INDEX_ENTRY = np.dtype([('log_time', '<u8'), ('offset', '<u8')])


class McapError(GyroDriftFilterError):
    """A file is not as its own index says; the text says where."""


class ChunkPlace(NamedTuple):
    """Where a chunk stands.

    Attributes:
        first: Log time of its first message in ns.
        last: Of its last message.
        start: Its record's place in the file.
        length: Of the record, with opcode and length.
    """

    first: int
    last: int
    start: int
    length: int


class Layout(NamedTuple):
    """What the summary section of a file tells.

    Attributes:
        channels: Topic and type by channel id.
        chunks: In the order of their log times; they do not overlap.
    """

    channels: dict[int, tuple[str, str]]
    chunks: list[ChunkPlace]


class _Fields:
    """Read the fields of a record one after the other; too few bytes are a `struct.error`."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._place = 0

    def take(self, layout: str) -> Any:
        values = struct.unpack_from('<' + layout, self._data, self._place)
        self._place += struct.calcsize('<' + layout)
        return values[0] if len(values) == 1 else values

    def text(self) -> str:
        data: bytes = self.take(f'{self.take("I")}s')
        return data.decode()


def read_layout(path: Path) -> Layout | None:
    """Return the layout of an MCAP file, or None where it is no plain chunked and indexed one.

    None stands for: no summary, chunks without an index of their messages or that overlap in time,
    anything that can't be read. A reader for all files has to take over then.
    """
    try:
        with path.open('rb') as file:
            if file.read(len(MAGIC)) != MAGIC:
                return None
            tail = _PREFIX.size + _FOOTER.size + len(MAGIC)
            footer = file.seek(-tail, 2)
            opcode, length = _PREFIX.unpack(file.read(_PREFIX.size))
            summary, _, _ = _FOOTER.unpack(file.read(_FOOTER.size))
            if (opcode, length) != (FOOTER, _FOOTER.size) or file.read() != MAGIC:
                return None
            if not len(MAGIC) <= summary < footer or footer - summary > _LARGEST_SUMMARY:
                return None
            file.seek(summary)
            return _layout(file.read(footer - summary), summary)
    except (OSError, struct.error, UnicodeDecodeError, KeyError, IndexError):
        return None


def _layout(summary: bytes, end: int) -> Layout | None:
    schemas: dict[int, str] = {}
    channels: dict[int, tuple[str, str]] = {}
    chunks: list[ChunkPlace] = []
    for opcode, content in _records(summary):
        fields = _Fields(content)
        if opcode == SCHEMA:
            key = fields.take('H')
            schemas[key] = fields.text()
        elif opcode == CHANNEL:
            key, schema = fields.take('HH')
            channels[key] = fields.text(), schemas[schema]
        elif opcode == CHUNK_INDEX:
            chunks.append(ChunkPlace(*fields.take('QQQQ')))
            # Readers that go by the index pass over a chunk without one.
            if fields.take('I') == 0 or chunks[-1].last >= _LATEST:
                return None
    chunks.sort()
    for before, after in pairwise(chunks):
        # At equal times the one that stands first in the file is read first.
        if (after.first, after.start) < (before.last, before.start):
            return None
    if not chunks or any(chunk.start + chunk.length > end for chunk in chunks):
        return None
    return Layout(channels, chunks)


def _records(data: bytes) -> Iterator[tuple[int, bytes]]:
    place = 0
    while place < len(data):
        opcode, length = _PREFIX.unpack_from(data, place)
        place += _PREFIX.size
        yield opcode, data[place : place + length]
        place += length


def read_chunks(path: Path, layout: Layout) -> Iterator[NDArray[np.uint8]]:
    """Yield the records of each chunk, decompressed; the next one is made ready meanwhile.

    Raises:
        McapError: A chunk is damaged.
        OSError: The file can't be read.
    """
    with path.open('rb') as file, ThreadPoolExecutor(1) as worker:
        ready: Future[bytes] | None = None
        for place in layout.chunks:
            file.seek(place.start)
            coming = worker.submit(_decompressed, file.read(place.length), place)
            if ready is not None:
                yield np.frombuffer(ready.result(), np.uint8)
            ready = coming
        if ready is not None:
            yield np.frombuffer(ready.result(), np.uint8)


def _decompressed(record: bytes, place: ChunkPlace) -> bytes:
    try:
        opcode, length = _PREFIX.unpack_from(record)
        _, _, size, checksum, name_length = _CHUNK.unpack_from(record, _PREFIX.size)
        fields = _PREFIX.size + _CHUNK.size
        compression = record[fields : fields + name_length].decode()
        fields += name_length
        (compressed_size,) = struct.unpack_from('<Q', record, fields)
        compressed = record[fields + 8 : fields + 8 + compressed_size]
        if opcode != CHUNK or length != place.length - _PREFIX.size:
            raise McapError(f'no chunk at byte {place.start}, where the index has one')
        if size > LARGEST_CHUNK or len(compressed) != compressed_size:
            raise McapError(f'the chunk at byte {place.start} can not be as long as it says')
        # One byte more than there should be, to see whether it lies.
        match compression:
            case '':
                data = compressed
            case 'zstd':
                data = zstd.ZstdDecompressor().decompress(compressed, size + 1)
            case 'lz4':
                data = LZ4FrameDecompressor().decompress(compressed, size + 1)
            case _:
                raise McapError(f'chunk compression {compression!r} is unknown')
    except (struct.error, UnicodeDecodeError, zstd.ZstdError, RuntimeError) as error:
        raise McapError(f'the chunk at byte {place.start} is damaged: {error}') from error
    if len(data) != size or (checksum and crc32(data) != checksum):
        raise McapError(f'the chunk at byte {place.start} is damaged: size or checksum is wrong')
    return data


def _text(value: str) -> bytes:
    data = value.encode()
    return struct.pack('<I', len(data)) + data


def _record(opcode: int, *fields: bytes) -> bytes:
    content = b''.join(fields)
    return _PREFIX.pack(opcode, len(content)) + content


class McapStorage:
    """Storage of `rosbags.rosbag2.Writer`: an MCAP file in chunks, message by message or in bulk.

    The interface is rosbags' own for storages. Chunks are compressed beside the caller's work.

    Attributes:
        counts: Messages by channel that are in the file.
        first: Log time of the first of them in ns.
        last: Of the last.
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        self.path = path / f'{path.name}.mcap'
        self._compression = 'zstd' if compression == CompressionMode.STORAGE else ''
        self._file: BinaryIO = self.path.open('xb')
        self._file.write(MAGIC + _record(HEADER, _text('ros2'), _text('gyro_drift_filter')))
        self._schemas: dict[str, tuple[int, bytes]] = {}
        self._channels: list[bytes] = []
        self.counts: dict[int, int] = {}
        self._chunk_indexes: list[bytes] = []
        self.first, self.last = 2**64 - 1, 0
        self._worker = ThreadPoolExecutor(1)
        self._pending: list[tuple[Future[tuple[int, int, bytes]], NDArray[Any]]] = []
        self._start_chunk()

    def _start_chunk(self) -> None:
        self._pieces: list[Any] = []
        self._size = 0
        self._entries: list[tuple[int, int, int]] = []
        self._bulk_entries: list[NDArray[Any]] = []

    def add_msgtype(self, connection: Connection) -> None:
        """Add a message type, before its first connection."""
        plain = connection.msgdef.format == MessageDefinitionFormat.MSG
        key = len(self._schemas) + 1
        record = _record(
            SCHEMA,
            struct.pack('<H', key),
            _text(connection.msgtype),
            _text('ros2msg' if plain else 'ros2idl'),
            _text(connection.msgdef.data),
        )
        self._schemas[connection.msgtype] = key, record
        self._append(record)

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a topic."""
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        metadata = _text('offered_qos_profiles') + _text(offered_qos_profiles)
        record = _record(
            CHANNEL,
            struct.pack('<HH', connection.id, self._schemas[connection.msgtype][0]),
            _text(connection.topic),
            _text(extension.serialization_format),
            struct.pack('<I', len(metadata)),
            metadata,
        )
        self._channels.append(record)
        self.counts[connection.id] = 0
        self._append(record)

    def _append(self, piece: Any) -> None:
        self._pieces.append(piece)
        self._size += len(piece)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message with its log time in ns."""
        self._entries.append((connection.id, timestamp, self._size))
        self._append(
            struct.pack('<BQHIQQ', MESSAGE, 22 + len(data), connection.id, 0, timestamp, timestamp)
        )
        self._append(data)
        if self._size > CHUNK_BYTES:
            self._close_chunk()

    def write_bulk(self, records: NDArray[np.uint8], entries: NDArray[Any]) -> None:
        """Write message records that lie behind each other, with an ENTRY for each.

        Both belong to the storage from then on. Chunks end where `write` would end them.
        """
        self._settle_entries()
        if self._size + len(records) <= CHUNK_BYTES:  # the common case
            entries['offset'] += np.uint64(self._size)
            self._bulk_entries.append(entries)
            self._append(records)
            return
        ends = np.append(entries['offset'][1:], len(records)).astype(np.int64)
        done = written = 0
        while done < len(entries):
            last = int(np.searchsorted(ends, CHUNK_BYTES - self._size + written, side='right'))
            stop = min(last + 1, len(entries))
            piece = entries[done:stop].copy()
            piece['offset'] = piece['offset'].astype(np.int64) + (self._size - written)
            self._settle_entries()
            self._bulk_entries.append(piece)
            self._append(records[written : ends[stop - 1]])
            done, written = stop, int(ends[stop - 1])
            if self._size > CHUNK_BYTES:
                self._close_chunk()

    def _settle_entries(self) -> None:
        """Keep single messages and bulks in their order."""
        if self._entries:
            self._bulk_entries.append(np.array(self._entries, ENTRY))
            self._entries = []

    def _close_chunk(self) -> None:
        self._settle_entries()
        entries = np.concatenate([np.empty(0, ENTRY), *self._bulk_entries])
        pack = self._worker.submit(_packed, self._pieces, self._compression)
        self._pending.append((pack, entries))
        self._start_chunk()
        if len(self._pending) > _PENDING:
            self._write_chunk()

    def _write_chunk(self) -> None:
        """Write the chunk that has waited longest, and the indexes of its messages."""
        packed, entries = self._pending.pop(0)
        size, checksum, data = packed.result()
        times = entries['log_time']
        first, last = (int(times.min()), int(times.max())) if len(times) else (0, 0)
        start = self._file.tell()
        head = _CHUNK.pack(first, last, size, checksum, len(self._compression))
        head += self._compression.encode() + struct.pack('<Q', len(data))
        self._file.write(_PREFIX.pack(CHUNK, len(head) + len(data)) + head)
        self._file.write(data)
        end = self._file.tell()
        offsets = b''
        for channel in np.unique(entries['channel']):
            chosen = entries[entries['channel'] == channel]
            index = np.empty(len(chosen), _INDEX_ENTRY)
            index['log_time'], index['offset'] = chosen['log_time'], chosen['offset']
            offsets += struct.pack('<HQ', channel, self._file.tell())
            content = index.tobytes()
            self._file.write(
                _record(MESSAGE_INDEX, struct.pack('<HI', channel, len(content)), content)
            )
            self.counts[int(channel)] += len(chosen)
        if len(times):
            self.first, self.last = min(self.first, first), max(self.last, last)
        self._chunk_indexes.append(
            _record(
                CHUNK_INDEX,
                struct.pack('<QQQQI', first, last, start, end - start, len(offsets)),
                offsets,
                struct.pack('<Q', self._file.tell() - end),
                _text(self._compression),
                struct.pack('<QQ', len(data), size),
            )
        )

    def flush(self) -> None:
        """Write all that is not in the file yet."""
        if self._size:
            self._close_chunk()
        while self._pending:
            self._write_chunk()

    def close(self, version: int, metadata: str) -> None:
        """Write what is left, the metadata of the bag, and the summary; close the file."""
        self.flush()
        self._worker.shutdown()
        content = _text('serialized_metadata') + _text(metadata)
        record = _record(METADATA, _text('rosbag2'), struct.pack('<I', len(content)), content)
        place = self._file.tell()
        self._file.write(record + _record(DATA_END, struct.pack('<I', 0)))
        self._write_summary(
            _record(METADATA_INDEX, struct.pack('<QQ', place, len(record)), _text('rosbag2'))
        )
        self._file.close()

    def _write_summary(self, metadata_index: bytes) -> None:
        counts = b''.join(struct.pack('<HQ', *item) for item in sorted(self.counts.items()))
        total = sum(self.counts.values())
        numbers = total, len(self._schemas), len(self._channels), 0, 1, len(self._chunk_indexes)
        times = (self.first, self.last) if total else (0, 0)
        statistics = _record(
            STATISTICS, struct.pack('<QHIIIIQQI', *numbers, *times, len(counts)), counts
        )
        groups = {
            SCHEMA: b''.join(record for _, record in self._schemas.values()),
            CHANNEL: b''.join(self._channels),
            CHUNK_INDEX: b''.join(self._chunk_indexes),
            METADATA_INDEX: metadata_index,
            STATISTICS: statistics,
        }
        start = place = self._file.tell()
        summary = b''.join(groups.values())
        offsets = b''
        for opcode, group in groups.items():
            if group:
                offsets += _record(SUMMARY_OFFSET, struct.pack('<BQQ', opcode, place, len(group)))
            place += len(group)
        # The checksum is of all from the begin of the summary to its own place in the footer.
        footer = _PREFIX.pack(FOOTER, _FOOTER.size) + struct.pack('<QQ', start, place)
        checksum = crc32(summary + offsets + footer)
        self._file.write(summary + offsets + footer + struct.pack('<I', checksum) + MAGIC)

    def abort(self) -> None:
        """Close the file as it is."""
        self._worker.shutdown(cancel_futures=True)
        self._file.close()


def _packed(pieces: list[Any], compression: str) -> tuple[int, int, bytes]:
    """Return the size, the checksum and the compressed bytes of a chunk."""
    data = b''.join(pieces)
    return len(data), crc32(data), zstd.compress(data) if compression else data
