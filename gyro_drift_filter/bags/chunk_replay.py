"""The fast path of `replay`: an MCAP file chunk by chunk, in compiled code.

What it writes is byte for byte what the general path writes, message by message. It is taken where
the kernels are compiled and the bag is one MCAP file whose chunks follow each other in time.
"""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import RECORD_BYTES, ROW, list_messages
from gyro_drift_filter.bags.imu_kernels import IMU, no_frame, read_imus
from gyro_drift_filter.bags.library import AnyReader, Connection, DirectoryReader, McapReader
from gyro_drift_filter.bags.mcap_reader import ChunkPlace, Layout, read_chunks, read_layout
from gyro_drift_filter.bags.mcap_records import McapError
from gyro_drift_filter.bags.recording import BagError, kind
from gyro_drift_filter.bags.replay_run import (
    BATCH_SPAN,
    LARGEST_BATCH,
    BatchEnd,
    Piece,
    ReplayRun,
    Word,
)
from gyro_drift_filter.core.compiled import is_compiled

_CHANNELS = 2**16
# What is filtered and laid out at once is at most as much, in messages and log time (ns): in the
# latter as the state of the filter is kept for each report.
_PIECE = 8192
_PIECE_SPAN = 100 * BATCH_SPAN


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

    Three threads work side by side, as kernels and compression let go of the interpreter's lock:
    one reads the next chunk, this one filters, and that of the storage packs.

    Args:
        file: The file.
        run: The run.
        progress: Called with the number of messages done.

    Raises:
        BagError: A chunk is damaged, or the output can't be written.
    """
    batches = _Batches()
    done = 0
    for piece in _pieces(file, run, batches):
        run.take_piece(piece)
        done += len(piece.rows)
        progress(done)
    last = batches.last()
    if last is not None:
        run.end_batch(last.first, last.last)


def _pieces(file: ChunkedFile, run: ReplayRun, batches: '_Batches') -> Iterator[Piece]:
    """Yield the messages of a file piece by piece."""
    known = np.zeros(_CHANNELS, np.bool_)
    ours, told = known.copy(), known.copy()
    known[list(file.connections)] = True
    for channel, connection in file.connections.items():
        ours[channel] = run.is_ours(connection)
        told[channel] = run.is_told_by(connection)
    run.map_channels(file.connections, ours)
    frame, doubles = no_frame(), np.zeros(37)
    for data, all_rows in _chunks(file, known):
        done = 0
        while done < len(all_rows):
            rows = all_rows[done : done + _PIECE]
            # As a difference, for a sum may be beyond 63 bits.
            times = rows['log_time'] - rows['log_time'][0]
            rows = rows[: np.searchsorted(times, _PIECE_SPAN)]
            done += len(rows)
            of_imus = rows[ours[rows['channel']]]
            imus = np.zeros(len(of_imus), IMU)
            read_imus(data, of_imus, (doubles.view(np.uint8), doubles), frame, imus)
            words: list[Word | BatchEnd] = [
                Word(int(row), file.connections[int(rows[row]['channel'])])
                for row in np.flatnonzero(told[rows['channel']])
            ]
            # Where a batch ends before a word, that comes first.
            stops = sorted([*batches.ends(rows['log_time'].copy()), *words], key=_row)
            yield Piece(data, rows, imus, stops)


def _row(stop: Word | BatchEnd) -> int:
    return stop.row


def _chunks(
    file: ChunkedFile, known: NDArray[np.bool_]
) -> Iterator[tuple[NDArray[np.uint8], NDArray[Any]]]:
    """Yield the records of each chunk, and ROWs of its messages in the order of their log times.

    `known` tells of each channel whether it has a connection; others are left out.
    """

    def listed(
        place: ChunkPlace, data: NDArray[np.uint8]
    ) -> tuple[NDArray[np.uint8], NDArray[Any]]:
        rows = _rows(place, data)
        return data, rows[known[rows['channel']]]

    try:
        yield from read_chunks(file.path, file.layout, listed)
    except (McapError, OSError) as error:
        raise BagError(f'{file.path} is damaged and can be read no further: {error}') from error


def _rows(place: ChunkPlace, data: NDArray[np.uint8]) -> NDArray[Any]:
    """Return the ROWs of the messages of a chunk, in the order of their log times."""
    room = np.empty(len(data) // RECORD_BYTES + 1, ROW)
    count = list_messages(data, room)
    rows = room[: max(count, 0)]
    times = rows['log_time']
    if count < 0 or (count and not place.first <= times.min() <= times.max() <= place.last):
        raise McapError(f'the records in the chunk at byte {place.start} are not sound')
    if (np.diff(times) < 0).any():
        rows = rows[np.argsort(times, kind='stable')]
    return rows


class _Batches:
    """Cut messages into batches as the general path does, across the ends of chunks."""

    def __init__(self) -> None:
        self._count = 0
        self._first = self._last = 0

    def ends(self, times: NDArray[np.int64]) -> Iterator[BatchEnd]:
        """Yield the ends of batches before the messages with these log times (ns)."""
        place = 0
        while place < len(times):
            following = int(times[place])
            full = self._count == LARGEST_BATCH
            if self._count and (full or following - self._first >= BATCH_SPAN):
                yield BatchEnd(place, self._first, self._last)
                self._count = 0
            if self._count == 0:
                self._first = following
            coming = times[place : place + LARGEST_BATCH - self._count]
            # As a difference, for the sum may be beyond 63 bits.
            taken = int(np.searchsorted(coming - self._first, BATCH_SPAN))
            self._count += taken
            self._last = int(coming[taken - 1])
            place += taken

    def last(self) -> BatchEnd | None:
        """Return the end of the batch under way, None before the first message."""
        return BatchEnd(0, self._first, self._last) if self._count else None
