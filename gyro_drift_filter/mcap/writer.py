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

"""Write MCAP files chunk by chunk, message by message or many at once."""

import struct
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any, BinaryIO
from zlib import crc32

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.mcap.message_kernels import CHANNELS, group_index, rows_of
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
    METADATA_INDEX,
    PREFIX,
    SCHEMA,
    STATISTICS,
    SUMMARY_OFFSET,
    ZSTD_LEVEL,
    record,
    statistics,
    text,
    zstd,
)

# A chunk is closed with the message that makes it longer, as rosbags does.
CHUNK_BYTES = 2**20
# Chunks on their way to the disk.
_PENDING = 2


class McapWriter:
    """An MCAP file in chunks. Chunks are packed and written beside the caller's work.

    Attributes:
        counts: Messages by channel that are in the file; complete after `flush`.
        first: Log time in ns of the first message in the file; known after `flush`.
        last: Log time in ns of the last message in the file; known after `flush`.
        numbers: (CHANNELS,) the number of each channel that was added, -1 for all others.
    """

    def __init__(self, path: Path, compression: str) -> None:
        """Begin the file; `compression` is 'zstd' or ''.

        Raises:
            OSError: It exists already or can't be written, here or in what follows.
        """
        self.path = path
        self._compression = compression
        self._file: BinaryIO = self.path.open('xb')
        self._offset = 0
        self._write(MAGIC + record(HEADER, text('ros2'), text('gyro_drift_filter')))
        self._schemas: dict[int, bytes] = {}
        self._channels: dict[int, bytes] = {}
        self.counts: dict[int, int] = {}
        self.numbers = np.full(CHANNELS, -1)
        self._chunk_indexes: list[bytes] = []
        self.first, self.last = 2**64 - 1, 0
        self._worker = ThreadPoolExecutor(1)
        self._pending: list[Future[None]] = []
        self._pieces: list[bytes | memoryview | NDArray[np.uint8]] = []
        self._size = 0

    def add_schema(self, key: int, schema: bytes) -> None:
        """Add a schema by its number and record, before its first channel."""
        self._schemas[key] = schema
        self._append(schema)

    def add_channel(self, key: int, channel: bytes) -> None:
        """Add a channel by its number and record, before its first message."""
        self._channels[key] = channel
        self.counts[key] = 0
        self.numbers[key] = key
        self._append(channel)

    def _write(self, data: bytes) -> None:
        self._file.write(data)
        self._offset += len(data)

    def _append(self, piece: bytes | memoryview | NDArray[np.uint8]) -> None:
        self._pieces.append(piece)
        self._size += len(piece)

    def write_message(self, channel: int, log_time: int, data: bytes | memoryview) -> None:
        """Write a message with its log time in ns."""
        self._append(
            struct.pack('<BQHIQQ', MESSAGE, 22 + len(data), channel, 0, log_time, log_time)
        )
        self._append(data)
        if self._size > CHUNK_BYTES:
            self._close_chunk()

    def write_records(self, records: NDArray[np.uint8], ends: NDArray[np.int64]) -> None:
        """Write message records that lie behind each other, without copying them.

        They may not be changed from then on. Chunks end where `write_message` would end them.

        Args:
            records: The records, bytes.
            ends: (n,) the offset behind each.
        """
        start = done = 0
        while done < len(ends):
            limit = start + CHUNK_BYTES - self._size
            done = min(int(np.searchsorted(ends, limit, 'right')), len(ends) - 1) + 1
            end = int(ends[done - 1])
            self._append(records[start:end])
            start = end
            if self._size > CHUNK_BYTES:
                self._close_chunk()

    def _close_chunk(self) -> None:
        self._pending.append(self._worker.submit(self._write_chunk, self._pieces))
        self._pieces, self._size = [], 0
        if len(self._pending) > _PENDING:
            self._await_chunk()

    def _await_chunk(self) -> None:
        self._pending[0].result()  # where it failed it stays, so that all that follows fails, too
        del self._pending[0]

    def _write_chunk(self, pieces: list[Any]) -> None:
        """Pack and write a chunk with the index of its messages: in a thread, one by one."""
        data: Any = np.frombuffer(pieces[0] if len(pieces) == 1 else b''.join(pieces), np.uint8)
        rows = rows_of(data, self.numbers)
        assert rows is not None
        numbers = np.bincount(rows['channel'])
        ends = np.cumsum(numbers)
        grouped, times = np.empty((len(rows), 2), '<u8'), np.array([2**64 - 1, 0], '<u8')
        group_index(rows, ends - numbers, grouped, times)
        first, last = times.tolist() if len(rows) else (0, 0)
        compression = self._compression
        packed = zstd.compress(data, ZSTD_LEVEL) if compression else data
        head = CHUNK_HEAD.pack(first, last, len(data), crc32(data), len(compression))
        head += compression.encode() + struct.pack('<Q', len(packed))
        start = self._offset
        parts: list[Any] = [PREFIX.pack(CHUNK, len(head) + len(packed)), head, packed]
        offset = end = start + sum(map(len, parts))
        offsets = b''
        for channel in np.flatnonzero(numbers).tolist():
            content = grouped[ends[channel] - numbers[channel] : ends[channel]].tobytes()
            offsets += struct.pack('<HQ', channel, offset)
            parts.append(record(MESSAGE_INDEX, struct.pack('<HI', channel, len(content)), content))
            offset += len(parts[-1])
            self.counts[channel] += int(numbers[channel])
        for part in parts:
            self._write(part)
        if len(grouped):
            self.first, self.last = min(self.first, first), max(self.last, last)
        index = record(
            CHUNK_INDEX,
            struct.pack('<QQQQI', first, last, start, end - start, len(offsets)),
            offsets,
            struct.pack('<Q', offset - end),
            text(compression),
            struct.pack('<QQ', len(packed), len(data)),
        )
        self._chunk_indexes.append(index)

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
        offset = self._offset
        self._write(metadata + record(DATA_END, struct.pack('<I', 0)))
        index = record(METADATA_INDEX, struct.pack('<QQ', offset, len(metadata)), text('rosbag2'))
        self._write_summary(index if metadata else b'')
        self._file.close()

    def _write_summary(self, metadata_index: bytes) -> None:
        kinds = len(self._schemas), len(self._channels), 0, int(bool(metadata_index))
        numbers = *kinds, len(self._chunk_indexes)
        groups = {
            SCHEMA: b''.join(self._schemas.values()),
            CHANNEL: b''.join(self._channels.values()),
            CHUNK_INDEX: b''.join(self._chunk_indexes),
            METADATA_INDEX: metadata_index,
            STATISTICS: statistics(self.counts, numbers, self.first, self.last),
        }
        start = offset = self._offset
        summary = b''.join(groups.values())
        offsets = b''
        for opcode, group in groups.items():
            if group:
                offsets += record(SUMMARY_OFFSET, struct.pack('<BQQ', opcode, offset, len(group)))
            offset += len(group)
        # The checksum is of all from the start of the summary up to itself in the footer.
        footer = PREFIX.pack(FOOTER, FOOTER_FIELDS.size) + struct.pack('<QQ', start, offset)
        checksum = crc32(summary + offsets + footer)
        self._write(summary + offsets + footer + struct.pack('<I', checksum) + MAGIC)

    def abort(self) -> None:
        """Close the file as it is."""
        self._worker.shutdown(cancel_futures=True)
        self._file.close()
