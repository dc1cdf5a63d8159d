"""Write MCAP files chunk by chunk, message by message or in bulk."""

import struct
from bisect import bisect_right
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import group_index
from gyro_drift_filter.bags.library import (
    CompressionMode,
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
)
from gyro_drift_filter.mcap.records import (
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


class McapWriter:
    """An MCAP file in chunks. Chunks are packed and written beside the caller's work.

    Attributes:
        counts: Messages by channel that are in the file; complete after `flush`, as
        first: the log time of the first of them in ns, and
        last: of the last.
    """

    def __init__(self, path: Path, compression: str) -> None:
        """Begin the file; `compression` is 'zstd' or ''.

        Raises:
            OSError: It exists already or can't be written, here or in what follows.
        """
        self.path = path
        self._compression = compression
        self._file: BinaryIO = self.path.open('xb')
        self._place = 0
        self._write(MAGIC + record(HEADER, text('ros2'), text('gyro_drift_filter')))
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self.counts: dict[int, int] = {}
        self._chunk_indexes: list[bytes] = []
        self.first, self.last = 2**64 - 1, 0
        self._worker = ThreadPoolExecutor(1)
        self._pending: list[Future[None]] = []
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

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._place += len(data)

    def _start_chunk(self) -> None:
        self._pieces: list[Any] = []
        self._size = 0
        self._entries: list[tuple[int, int, int]] = []
        self._indexes: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []

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

    def write_bulk(
        self, records: NDArray[np.uint8], channels: NDArray[np.int64], index: NDArray[np.int64]
    ) -> None:
        """Write message records that lie behind each other, without copying them.

        Chunks end where `write_message` would end them.

        Args:
            records: The records, bytes; they may not be changed from then on.
            channels: (n,) the channel of each.
            index: (n, 2) log time in ns and place of each, as in a MESSAGE_INDEX; it is changed.
        """
        self._settle_entries()
        starts, done, written = index[:, 1], 0, 0
        while done < len(channels):
            stop = bisect_right(starts, CHUNK_BYTES - self._size + written, done + 1)
            end = int(starts[stop]) if stop < len(starts) else len(records)
            index[done:stop, 1] += self._size - written
            self._indexes.append((channels[done:stop], index[done:stop]))
            self._append(records[written:end])
            done, written = stop, end
            if self._size > CHUNK_BYTES:
                self._close_chunk()

    def _settle_entries(self) -> None:
        """Keep single messages and bulks in their order."""
        if self._entries:
            entries = np.array(self._entries, np.uint64).astype(np.int64)
            self._indexes.append((entries[:, 0], entries[:, 1:]))
            self._entries = []

    def _close_chunk(self) -> None:
        self._settle_entries()
        channels = np.concatenate([np.empty(0, np.int64), *(c for c, _ in self._indexes)])
        index = np.concatenate([np.empty((0, 2), np.int64), *(i for _, i in self._indexes)])
        writing = self._worker.submit(self._write_chunk, self._pieces, channels, index)
        self._pending.append(writing)
        self._start_chunk()
        if len(self._pending) > _PENDING:
            self._await_chunk()

    def _await_chunk(self) -> None:
        self._pending[0].result()  # where it failed it stays, so that all that follows fails, too
        del self._pending[0]

    def _write_chunk(
        self, pieces: list[Any], channels: NDArray[np.int64], index: NDArray[np.int64]
    ) -> None:
        """Pack and write a chunk with the index of its messages: in a thread, one by one."""
        data = pieces[0] if len(pieces) == 1 else b''.join(pieces)
        numbers = np.bincount(channels)
        ends = np.cumsum(numbers)
        grouped, times = np.empty((len(index), 2), '<u8'), np.array([2**64 - 1, 0], '<u8')
        group_index(channels, index.view('<u8'), ends - numbers, grouped, times)
        first, last = times.tolist() if len(grouped) else (0, 0)
        compression = self._compression
        packed = zstd.compress(data, ZSTD_LEVEL) if compression else data
        head = CHUNK_HEAD.pack(first, last, len(data), crc32(data), len(compression))
        head += compression.encode() + struct.pack('<Q', len(packed))
        start = self._place
        parts = [PREFIX.pack(CHUNK, len(head) + len(packed)), head, packed]
        place = end = start + sum(map(len, parts))
        offsets = b''
        for channel in np.flatnonzero(numbers).tolist():
            content = grouped[ends[channel] - numbers[channel] : ends[channel]].tobytes()
            offsets += struct.pack('<HQ', channel, place)
            parts.append(record(MESSAGE_INDEX, struct.pack('<HI', channel, len(content)), content))
            place += len(parts[-1])
            self.counts[channel] += int(numbers[channel])
        self._write(b''.join(parts))
        if len(grouped):
            self.first, self.last = min(self.first, first), max(self.last, last)
        self._chunk_indexes.append(
            record(
                CHUNK_INDEX,
                struct.pack('<QQQQI', first, last, start, end - start, len(offsets)),
                offsets,
                struct.pack('<Q', place - end),
                text(compression),
                struct.pack('<QQ', len(packed), len(data)),
            )
        )

    def flush(self) -> None:
        """Write all that is not in the file yet."""
        if self._size:
            self._close_chunk()
        while self._pending:
            self._await_chunk()

    def finish(self, metadata: bytes = b'') -> None:
        """Write what is left, a METADATA record called 'rosbag2', and the summary; close."""
        self.flush()
        self._worker.shutdown()
        place = self._place
        self._write(metadata + record(DATA_END, struct.pack('<I', 0)))
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
        start = place = self._place
        summary = b''.join(groups.values())
        offsets = b''
        for opcode, group in groups.items():
            if group:
                offsets += record(SUMMARY_OFFSET, struct.pack('<BQQ', opcode, place, len(group)))
            place += len(group)
        # The checksum is of all from the begin of the summary to its own place in the footer.
        footer = PREFIX.pack(FOOTER, FOOTER_FIELDS.size) + struct.pack('<QQ', start, place)
        checksum = crc32(summary + offsets + footer)
        self._write(summary + offsets + footer + struct.pack('<I', checksum) + MAGIC)

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
