"""The fast path of `replay`: an MCAP file chunk by chunk, in compiled code.

What it writes is byte for byte what the general path writes, message by message. It is taken where
the kernels are compiled and the bag is one MCAP file whose chunks follow each other in time.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate.kernels import is_compiled
from gyro_drift_filter.bags.chunk_kernels import (
    BATCH,
    CHANNELS,
    RECORD_BYTES,
    ROW,
    end_batches,
    list_messages,
    times_of,
)
from gyro_drift_filter.bags.library import AnyReader, Connection, DirectoryReader, McapReader
from gyro_drift_filter.bags.recording import BagError, kind
from gyro_drift_filter.bags.replay_run import (
    BATCH_SPAN,
    LARGEST_BATCH,
    BatchEnd,
    Piece,
    ReplayRun,
    Word,
)
from gyro_drift_filter.mcap.reader import ChunkPlace, Layout, read_chunks, read_layout
from gyro_drift_filter.mcap.records import McapError
from gyro_drift_filter.messages.imu_kernels import IMU, no_frame, read_imus, room_for_doubles

# What is filtered and laid out at once is at most as much, in messages and log time (ns): a report
# may be due for each second.
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
    pieces = _Pieces(file, run)
    done = 0
    for piece in _ahead(iter(pieces)):
        run.take_piece(piece)
        done += len(piece.rows)
        progress(done)
    under_way = pieces.batch[0]
    if under_way['count'] > 0:
        run.end_batch(int(under_way['first']), int(under_way['last']))


def _ahead(pieces: Iterator[Piece]) -> Iterator[Piece]:
    """Yield pieces; the next one is made meanwhile, in a thread of its own."""
    with ThreadPoolExecutor(1) as worker:
        coming = worker.submit(next, pieces, None)
        while (piece := coming.result()) is not None:
            coming = worker.submit(next, pieces, None)
            yield piece


class _Pieces:
    """Pieces of the chunks of a file, in their order.

    Attributes:
        batch: (1,) BATCH, the one under way.
    """

    def __init__(self, file: ChunkedFile, run: ReplayRun) -> None:
        self._file = file
        self._known, self._ours, self._words = np.zeros((3, CHANNELS), np.bool_)
        self._known[list(file.connections)] = True
        for channel, connection in file.connections.items():
            self._ours[channel] = run.is_ours(connection)
            self._words[channel] = run.is_told_by(connection)
        run.map_channels(file.connections, self._ours)
        self.batch = np.zeros(1, BATCH)
        self._frame, self._room = no_frame(), room_for_doubles()

    def __iter__(self) -> Iterator[Piece]:
        """Yield the messages of each chunk in the order of their log times.

        Raises:
            BagError: A chunk is damaged, or the file can't be read.
        """
        try:
            for place, data in read_chunks(self._file.path, self._file.layout):
                rows, done = self._rows(place, data), 0
                while done < len(rows):
                    coming = rows[done : done + _PIECE]
                    limit = int(coming[0]['log_time']) + _PIECE_SPAN
                    if int(coming[-1]['log_time']) >= limit:
                        coming = coming[: np.searchsorted(coming['log_time'], limit)]
                    yield self._piece(data, coming)
                    done += len(coming)
        except (McapError, OSError) as error:
            raise BagError(
                f'{self._file.path} is damaged and can be read no further: {error}'
            ) from error

    def _rows(self, place: ChunkPlace, data: NDArray[np.uint8]) -> NDArray[Any]:
        """Return the ROWs of the messages of a chunk, in the order of their log times."""
        room = np.empty(len(data) // RECORD_BYTES + 1, ROW)
        count = list_messages(data, self._known, room)
        rows = room[: max(count, 0)]
        first, last, ascend = times_of(rows) if count > 0 else (place.first, place.last, True)
        if count < 0 or not place.first <= first <= last <= place.last:
            raise McapError(f'the records in the chunk at byte {place.start} are not sound')
        return rows if ascend else rows[np.argsort(rows['log_time'], kind='stable')]

    def _piece(self, data: NDArray[np.uint8], rows: NDArray[Any]) -> Piece:
        imus, places = np.zeros(len(rows), IMU), np.empty(len(rows), np.int64)
        count = read_imus(data, rows, self._ours, self._room, self._frame, imus, places)
        ends = np.empty(len(rows), BATCH)
        ended = end_batches(rows, LARGEST_BATCH, BATCH_SPAN, self.batch, ends)
        stops: list[Word | BatchEnd] = [BatchEnd(*end[:3]) for end in ends[:ended].tolist()]
        if self._words.any():
            stops += [
                Word(int(row), self._file.connections[int(rows[row]['channel'])])
                for row in np.flatnonzero(self._words[rows['channel']])
            ]
            # Where a batch ends before a word, that comes first.
            stops.sort(key=_row)
        return Piece(data, rows, imus[:count], places[:count], stops)


def _row(stop: Word | BatchEnd) -> int:
    return stop.row
