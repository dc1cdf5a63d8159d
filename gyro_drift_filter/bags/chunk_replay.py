"""The fast path of `replay`: an MCAP file chunk by chunk, in compiled code.

What it writes is byte for byte what the general path writes, message by message. It is taken where
numba is there and the bag is one MCAP file whose chunks follow each other in time.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import RECORD_BYTES, ROW, list_messages
from gyro_drift_filter.bags.imu_kernels import IMU, no_frame, read_imus
from gyro_drift_filter.bags.library import AnyReader, Connection, DirectoryReader, McapReader
from gyro_drift_filter.bags.mcap_reader import Layout, read_chunks, read_layout
from gyro_drift_filter.bags.mcap_records import McapError
from gyro_drift_filter.bags.recording import BagError, kind
from gyro_drift_filter.bags.replay_run import (
    BATCH_SPAN,
    LARGEST_BATCH,
    Piece,
    ReplayRun,
    Word,
    payload,
)
from gyro_drift_filter.core.compiled import is_compiled

_CHANNELS = 2**16


class ChunkedFile(NamedTuple):
    """An MCAP file that can be replayed chunk by chunk.

    Attributes:
        path: Of the file.
        layout: Where its chunks are.
        connections: The reader's connection by channel id.
    """

    path: Path
    layout: Layout
    connections: dict[int, Connection]


def chunked_file(reader: AnyReader) -> ChunkedFile | None:
    """Return the file behind a reader, or None where the general path has to be taken."""
    storage: Any = getattr(reader.readers[0], 'storage', None)
    if isinstance(storage, DirectoryReader):
        if len(storage.storages) != 1 or storage.metadata.compression_mode == 'message':
            return None
        storage = storage.storages[0]
    if not is_compiled() or len(reader.readers) != 1 or not isinstance(storage, McapReader):
        return None
    layout = read_layout(Path(str(storage.path)))
    if layout is None:
        return None
    # The reader numbers its connections anew; alike ones can't be told apart, so are left to it.
    outer = {kind(connection): connection for connection in reader.connections}
    if len(outer) != len(reader.connections):
        return None
    connections = {}
    for inner in storage.connections:
        same = outer.get(kind(inner))
        if same is None or layout.channels.get(inner.id) != (inner.topic, inner.msgtype):
            return None
        connections[inner.id] = same
    return ChunkedFile(Path(str(storage.path)), layout, connections)


def replay_chunks(file: ChunkedFile, run: ReplayRun, progress: Callable[[int], None]) -> None:
    """Take a file through a run.

    Args:
        file: The file.
        run: The run.
        progress: Called with the number of messages done.

    Raises:
        BagError: A chunk is damaged, or the output can't be written.
    """
    known = np.zeros(_CHANNELS, np.bool_)
    ours, told = known.copy(), known.copy()
    known[list(file.connections)] = True
    for channel, connection in file.connections.items():
        ours[channel] = run.is_ours(connection)
        told[channel] = run.is_told_by(connection)
    run.map_channels(file.connections, ours)
    batches = _Batches(run)
    frame = no_frame()
    done = 0
    for data, rows in _chunks(file):
        rows = rows[known[rows['channel']]]
        imus = _imus(data, rows[ours[rows['channel']]], frame)
        # How many of our messages come before each row.
        before = np.append(0, np.cumsum(ours[rows['channel']]))
        messages_told = np.flatnonzero(told[rows['channel']])
        for first, stop in batches.stretches(rows['log_time']):
            begin, end = np.searchsorted(messages_told, (first, stop))
            words = [
                Word(
                    int(before[row] - before[first]),
                    file.connections[int(rows[row]['channel'])],
                    payload(data, rows[row]),
                )
                for row in messages_told[begin:end]
            ]
            run.take_piece(Piece(data, rows[first:stop], imus[before[first] : before[stop]], words))
        done += len(rows)
        progress(done)
    batches.end()


def _chunks(file: ChunkedFile) -> Iterator[tuple[NDArray[np.uint8], NDArray[Any]]]:
    """Yield each chunk and the ROWs of its messages, in the order of their log times."""
    try:
        for place, data in zip(
            file.layout.chunks, read_chunks(file.path, file.layout), strict=True
        ):
            room = np.empty(len(data) // RECORD_BYTES + 1, ROW)
            count = list_messages(data, room)
            rows = room[: max(count, 0)]
            times = rows['log_time']
            if count < 0 or (count and not place.first <= times.min() <= times.max() <= place.last):
                raise McapError(f'the records in the chunk at byte {place.start} are not sound')
            if (np.diff(times) < 0).any():
                rows = rows[np.argsort(times, kind='stable')]
            yield data, rows
    except (McapError, OSError) as error:
        raise BagError(f'{file.path} is damaged and can be read no further: {error}') from error


def _imus(data: NDArray[np.uint8], rows: NDArray[Any], frame: NDArray[Any]) -> NDArray[Any]:
    """Return an IMU for each ROW; `frame` is that of the message before."""
    imus = np.zeros(len(rows), IMU)
    doubles = np.zeros(37)
    read_imus(data, rows, (doubles.view(np.uint8), doubles), frame, imus)
    return imus


class _Batches:
    """Cut messages into batches as the general path does, across the ends of chunks."""

    def __init__(self, run: ReplayRun) -> None:
        self._run = run
        self._count = 0
        self._first = self._last = 0

    def stretches(self, times: NDArray[np.int64]) -> Iterator[tuple[int, int]]:
        """Yield (first, stop) of the parts of batches that lie in a chunk with these log times."""
        place = 0
        while place < len(times):
            following = int(times[place])
            if self._count == LARGEST_BATCH or (
                self._count and following - self._first >= BATCH_SPAN
            ):
                self.end()
            if self._count == 0:
                self._first = following
            # As a difference, for the sum may be beyond 63 bits.
            late = place + int(np.searchsorted(times[place:] - self._first, BATCH_SPAN))
            stop = min(late, place + LARGEST_BATCH - self._count, len(times))
            yield place, stop
            self._count += stop - place
            self._last = int(times[stop - 1])
            place = stop

    def end(self) -> None:
        """End the batch under way, if there is one."""
        if self._count:
            self._run.end_batch(self._first, self._last)
        self._count = 0
