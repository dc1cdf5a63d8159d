"""Write MCAP files chunk by chunk, message by message or in bulk."""

import struct
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO
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
from gyro_drift_filter.bags.mcap_records import (
    CHANNEL,
    CHUNK,
    CHUNK_HEAD,
    CHUNK_INDEX,
    DATA_END,
    FOOTER,
    FOOTER_FIELDS,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    PREFIX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    ZSTD_LEVEL,
    record,
    text,
    zstd,
)

# A chunk is closed with the message that makes it longer, as rosbags does.
CHUNK_BYTES = 2**20
# Chunks on their way to the disk.
_PENDING = 3

_CHANNEL_BYTES = 2  # of an ENTRY, before what the index of one channel holds


class McapWriter:
    """An MCAP file in chunks. Chunks are compressed beside the caller's work.

    Attributes:
        counts: Messages by channel that are in the file.
        first: Log time of the first of them in ns.
        last: Of the last.
    """

    def __init__(self, path: Path, compression: str) -> None:
        """Begin the file; `compression` is 'zstd' or ''.

        Raises:
            OSError: It exists already or can't be written, here or in what follows.
        """
        self.path = path
        self._compression = compression
        self._file: BinaryIO = self.path.open('xb')
        self._file.write(MAGIC + record(HEADER, text('ros2'), text('gyro_drift_filter')))
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self.counts: dict[int, int] = {}
        self._chunk_indexes: list[bytes] = []
        self.first, self.last = 2**64 - 1, 0
        self._worker = ThreadPoolExecutor(1)
        self._pending: list[tuple[Future[tuple[int, int, bytes]], NDArray[Any]]] = []
        self._start_chunk()

    def add_schema(self, key: int, schema: bytes) -> None:
        """Add a schema by its number and record, before its first channel."""
        self._schemas[key] = schema
        self._append(schema)

    def add_channel(self, key: int, channel: bytes) -> None:
        """Add a channel by its number and record, before its first message."""
        self._channels[key] = channel
        self.counts[key] = 0
        self._append(channel)

    def _start_chunk(self) -> None:
        self._pieces: list[Any] = []
        self._size = 0
        self._entries: list[tuple[int, int, int]] = []
        self._bulk_entries: list[NDArray[Any]] = []

    def _append(self, piece: Any) -> None:
        self._pieces.append(piece)
        self._size += len(piece)

    def write_message(self, channel: int, log_time: int, data: bytes | memoryview) -> None:
        """Write a message with its log time in ns."""
        self._entries.append((channel, log_time, self._size))
        self._append(
            struct.pack('<BQHIQQ', MESSAGE, 22 + len(data), channel, 0, log_time, log_time)
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
        # As bytes: numpy joins records field by field.
        parts = [np.empty(0, np.uint8), *(part.view(np.uint8) for part in self._bulk_entries)]
        entries = np.concatenate(parts).view(ENTRY)
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
        head = CHUNK_HEAD.pack(first, last, size, checksum, len(self._compression))
        head += self._compression.encode() + struct.pack('<Q', len(data))
        self._file.write(PREFIX.pack(CHUNK, len(head) + len(data)) + head)
        self._file.write(data)
        end = self._file.tell()
        offsets = b''
        for channel in np.unique(entries['channel']):
            chosen = entries[entries['channel'] == channel]
            offsets += struct.pack('<HQ', channel, self._file.tell())
            content = (
                chosen.view(np.uint8).reshape(-1, ENTRY.itemsize)[:, _CHANNEL_BYTES:].tobytes()
            )
            self._file.write(
                record(MESSAGE_INDEX, struct.pack('<HI', channel, len(content)), content)
            )
            self.counts[int(channel)] += len(chosen)
        if len(times):
            self.first, self.last = min(self.first, first), max(self.last, last)
        self._chunk_indexes.append(
            record(
                CHUNK_INDEX,
                struct.pack('<QQQQI', first, last, start, end - start, len(offsets)),
                offsets,
                struct.pack('<Q', self._file.tell() - end),
                text(self._compression),
                struct.pack('<QQ', len(data), size),
            )
        )

    def flush(self) -> None:
        """Write all that is not in the file yet."""
        if self._size:
            self._close_chunk()
        while self._pending:
            self._write_chunk()

    def finish(self, metadata: bytes = b'') -> None:
        """Write what is left, a METADATA record called 'rosbag2', and the summary; close."""
        self.flush()
        self._worker.shutdown()
        place = self._file.tell()
        self._file.write(metadata + record(DATA_END, struct.pack('<I', 0)))
        index = record(METADATA_INDEX, struct.pack('<QQ', place, len(metadata)), text('rosbag2'))
        self._write_summary(index if metadata else b'')
        self._file.close()

    def _write_summary(self, metadata_index: bytes) -> None:
        counts = b''.join(struct.pack('<HQ', *item) for item in sorted(self.counts.items()))
        total = sum(self.counts.values())
        kinds = len(self._schemas), len(self._channels), 0, int(bool(metadata_index))
        numbers = total, *kinds, len(self._chunk_indexes)
        times = (self.first, self.last) if total else (0, 0)
        statistics = record(
            STATISTICS, struct.pack('<QHIIIIQQI', *numbers, *times, len(counts)), counts
        )
        groups = {
            SCHEMA: b''.join(self._schemas.values()),
            CHANNEL: b''.join(self._channels.values()),
            CHUNK_INDEX: b''.join(self._chunk_indexes),
            METADATA_INDEX: metadata_index,
            STATISTICS: statistics,
        }
        start = place = self._file.tell()
        summary = b''.join(groups.values())
        offsets = b''
        for opcode, group in groups.items():
            if group:
                offsets += record(SUMMARY_OFFSET, struct.pack('<BQQ', opcode, place, len(group)))
            place += len(group)
        # The checksum is of all from the begin of the summary to its own place in the footer.
        footer = PREFIX.pack(FOOTER, FOOTER_FIELDS.size) + struct.pack('<QQ', start, place)
        checksum = crc32(summary + offsets + footer)
        self._file.write(summary + offsets + footer + struct.pack('<I', checksum) + MAGIC)

    def abort(self) -> None:
        """Close the file as it is."""
        self._worker.shutdown(cancel_futures=True)
        self._file.close()


class McapStorage(McapWriter):
    """Storage of `rosbags.rosbag2.Writer`; the interface is rosbags' own."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        zstd_ = compression == CompressionMode.STORAGE
        super().__init__(path / f'{path.name}.mcap', 'zstd' if zstd_ else '')
        self._keys: dict[str, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        """Add a message type, before its first connection."""
        plain = connection.msgdef.format == MessageDefinitionFormat.MSG
        key = self._keys[connection.msgtype] = len(self._keys) + 1
        encoding = 'ros2msg' if plain else 'ros2idl'
        fields = text(connection.msgtype), text(encoding), text(connection.msgdef.data)
        self.add_schema(key, record(SCHEMA, struct.pack('<H', key), *fields))

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a topic."""
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        metadata = text('offered_qos_profiles') + text(offered_qos_profiles)
        channel = record(
            CHANNEL,
            struct.pack('<HH', connection.id, self._keys[connection.msgtype]),
            text(connection.topic),
            text(extension.serialization_format),
            struct.pack('<I', len(metadata)),
            metadata,
        )
        self.add_channel(connection.id, channel)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message with its log time in ns."""
        self.write_message(connection.id, timestamp, data)

    def close(self, version: int, metadata: str) -> None:
        """Write what is left, and the metadata of the bag; close the file."""
        content = text('serialized_metadata') + text(metadata)
        self.finish(record(METADATA, text('rosbag2'), struct.pack('<I', len(content)), content))


def _packed(pieces: list[Any], compression: str) -> tuple[int, int, bytes]:
    """Return the size, the checksum and the compressed bytes of a chunk."""
    data = b''.join(pieces)
    return len(data), crc32(data), zstd.compress(data, ZSTD_LEVEL) if compression else data
