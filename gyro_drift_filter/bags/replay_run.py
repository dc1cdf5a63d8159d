"""One run of a bag through the filter: what is filtered, written, counted and reported."""

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.chunk_kernels import RECORD_BYTES, lay_out, place_in_result
from gyro_drift_filter.bags.library import AnyReader, Connection
from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.bags.recording import (
    BagError,
    BagWriter,
    is_cdr,
)
from gyro_drift_filter.bags.statistics import Moments, Statistics
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.sample import RESULT
from gyro_drift_filter.messages.cdr import (
    IMU_TYPE,
    VECTOR_TYPE,
)
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, diagnostic_arrays
from gyro_drift_filter.messages.health import NODE_NAME, Health
from gyro_drift_filter.messages.imu_kernels import room_for_doubles
from gyro_drift_filter.messages.message_filter import (
    SAMPLE_TOPICS,
    MessageFilter,
    Outcome,
    sample_message,
)
from gyro_drift_filter.messages.motion_hint import moves
from gyro_drift_filter.messages.telemetry import MessageReport

DIAGNOSTICS = '/diagnostics'
DIAGNOSTICS_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'
TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'
BOOL_TYPE = 'std_msgs/msg/Bool'
AT_REST = 'at_rest'
# A batch is at most as long, in log time (ns) and messages. Reports are written between batches.
BATCH_SPAN = 1_000_000_000
LARGEST_BATCH = 4096
_LATEST_STAMP = 2**31 * 10**9 - 1  # ns: a stamp's seconds have 31 bits

Message = tuple[Connection, int, bytes]


@dataclass(frozen=True)
class Summary:
    """What a replay did.

    Attributes:
        topic: The input topic.
        output_topic: The filtered topic.
        received: Imu messages read.
        written: Messages written to the filtered topic.
        not_reported: Messages without angular velocity, passed on as they came.
        left_out: Topics of the input that were not copied, and why.
        outliers: Samples flagged, per axis (3,).
        raw: Statistics of the usable rates as they came.
        filtered: Statistics of the same samples after the filter.
        period: Sample period at the end, in s.
        status: The filter's health over the whole bag.
    """

    topic: str
    output_topic: str
    received: int
    written: int
    not_reported: int
    left_out: dict[str, str]
    outliers: NDArray[np.int64]
    raw: Statistics
    filtered: Statistics
    period: float
    status: list[DiagnosticStatus]


@dataclass(frozen=True)
class Topics:
    """Names of the outputs that belong to an input topic."""

    filtered: str
    node: str
    temperature: str

    @classmethod
    def of(cls, topic: str) -> 'Topics':
        """Return the names: beside the input, in its namespace.

        /robot1/imu/data_raw gives /robot1/imu/data_filtered and /robot1/gyro_drift_filter;
        an input of another name, /camera/imu, gives /camera/imu_filtered.
        """
        topic = '/' + topic.strip('/')
        parent = topic.rpartition('/')[0]
        if topic.endswith('/imu/data_raw'):
            node = f'{parent.rpartition("/")[0]}/{NODE_NAME}'
            return cls(f'{parent}/data_filtered', node, f'{parent}/temperature')
        filtered = f'{topic}_filtered'
        if topic.endswith('/data_raw'):
            filtered = f'{parent}/data_filtered'
        return cls(filtered, f'{parent}/{NODE_NAME}', f'{parent}/temperature')

    def sample(self, name: str) -> str:
        """Return the name of one of `SAMPLE_TOPICS`."""
        return f'{self.node}/{name}'


class Word(NamedTuple):
    """A message on temperature or motion.

    Attributes:
        row: Its place in the piece.
        connection: Its topic.
    """

    row: int
    connection: Connection


class BatchEnd(NamedTuple):
    """The end of a batch.

    Attributes:
        row: The place in the piece of the first message that is not of it.
        first: Log time of its first message in ns.
        last: Of its last.
    """

    row: int
    first: int
    last: int


class Piece(NamedTuple):
    """A stretch of the messages of an MCAP chunk.

    Attributes:
        data: The chunk's records, bytes.
        rows: Where each message stands, ROWs of `chunk_kernels`.
        imus: What those of the Imu topic hold, IMUs of `imu_kernels`.
        places: Where each of these is among the messages.
        stops: Before which messages the filter has to stop, in their order, and what for.
    """

    data: NDArray[np.uint8]
    rows: NDArray[Any]
    imus: NDArray[Any]
    places: NDArray[np.int64]
    stops: list[Word | BatchEnd]


class _Moment(NamedTuple):
    """When a report is made.

    Attributes:
        time: Log time in ns.
        seconds: Since the report before.
    """

    time: int
    seconds: float


def payload(data: NDArray[np.uint8], row: Any) -> bytes:
    """Return the content of a message in a chunk."""
    return data[row['start'] : row['start'] + row['size']].tobytes()


class ReplayRun:
    """The filter, the connections of the output bag and the sums for the summary."""

    def __init__(
        self,
        reader: AnyReader,
        writer: BagWriter,
        topic: str,
        parameters: Parameters,
        diagnostics: bool,
        hint: str | None,
    ) -> None:
        self._reader = reader
        self._writer = writer
        self._topic = topic
        self._topics = Topics.of(topic)
        self._filter = MessageFilter(parameters)
        self._told_by = {hint} | {
            connection.topic
            for connection in reader.connections
            if (connection.topic, connection.msgtype)
            == (self._topics.temperature, TEMPERATURE_TYPE)
        }
        self._at_rest = np.array([-1.0])
        self._health = Health()
        self._moments = Moments()
        self._room = room_for_doubles()
        self._written = 0
        self._began = self._reported = self._now = -1  # log times in ns
        names = SAMPLE_TOPICS if diagnostics else ()
        own = {self._topics.filtered} | {self._topics.sample(name) for name in names}
        if diagnostics:
            own.add(self._topics.sample(AT_REST))
        self._copies: dict[int, Connection] = {}
        self._imus: set[int] = set()
        self._left_out: dict[str, str] = {}
        for connection in reader.connections:
            if connection.topic in own:
                self._left_out[connection.topic] = 'the filter writes this topic itself'
            elif not is_cdr(connection):
                self._left_out[connection.topic] = 'its messages are not in CDR'
            else:
                self._copies[connection.id] = writer.copy_connection(connection, reader)
                if connection.topic == topic:
                    self._imus.add(connection.id)
        if not self._imus:
            raise BagError(f'the messages of topic {topic} are not in CDR')
        self._output = writer.add_connection(self._topics.filtered, IMU_TYPE)
        existing = (
            copy
            for copy in self._copies.values()
            if (copy.topic, copy.msgtype) == (DIAGNOSTICS, DIAGNOSTICS_TYPE)
        )
        self._reports = next(existing, None) or writer.add_connection(DIAGNOSTICS, DIAGNOSTICS_TYPE)
        self._samples = {
            name: writer.add_connection(self._topics.sample(name), VECTOR_TYPE) for name in names
        }
        self._rest = (
            writer.add_connection(self._topics.sample(AT_REST), BOOL_TYPE) if diagnostics else None
        )

    def is_ours(self, connection: Connection) -> bool:
        """Tell whether a topic is the Imu topic."""
        return connection.id in self._imus

    def is_told_by(self, connection: Connection) -> bool:
        """Tell whether the filter listens to a topic beside the Imu."""
        return connection.topic in self._told_by and is_cdr(connection)

    def take(self, batch: list[Message]) -> None:
        """Filter the Imu messages of a batch and write all of it, in its order."""
        ours = [data for connection, _, data in batch if self.is_ours(connection)]
        outcomes = self._process(batch)
        self._add_up(outcomes)
        following = iter(zip(ours, outcomes, strict=True))
        for connection, log_time, data in batch:
            copy = self._copies.get(connection.id)
            if copy is None:
                continue
            self._writer.write(copy, log_time, data)
            if self.is_ours(connection):
                self._write_outcome(log_time, *next(following))

    def _process(self, batch: list[Message]) -> list[Outcome]:
        """Filter the Imu messages between those that tell of temperature or motion."""
        outcomes: list[Outcome] = []
        waiting: list[bytes] = []
        for connection, _, data in batch:
            if self.is_ours(connection):
                waiting.append(data)
            elif self.is_told_by(connection):
                outcomes += self._filter.process_batch(waiting)
                waiting = []
                self.tell(connection, data)
        return outcomes + self._filter.process_batch(waiting)

    def tell(self, connection: Connection, data: bytes) -> None:
        """Tell the filter what another topic says, passing over what can't be read."""
        with suppress(Exception):
            message: Any = self._reader.deserialize(data, connection.msgtype)
            if connection.msgtype == TEMPERATURE_TYPE:
                self._filter.filter.note_temperature(message.temperature)
            else:
                self._filter.filter.hint(moves(message))

    def _write_outcome(self, log_time: int, data: bytes, outcome: Outcome) -> None:
        if outcome.data is None:
            return
        self._written += 1
        self._writer.write(self._output, log_time, outcome.data)
        if outcome.result is None or outcome.imu is None:
            return
        for name, connection in self._samples.items():
            message = sample_message(data, outcome.imu, outcome.result, name)
            self._writer.write(connection, log_time, message)
        if self._rest is not None and outcome.result['at_rest'] != self._at_rest[0]:
            self._at_rest[0] = outcome.result['at_rest']
            message = message_type(BOOL_TYPE)(bool(self._at_rest[0] > 0.0))
            self._writer.write(self._rest, log_time, serialize(message, BOOL_TYPE))

    def map_channels(self, connections: dict[int, Connection], ours: NDArray[np.bool_]) -> None:
        """Say which connection each channel of the MCAP file is, before the first piece.

        `ours` tells for every channel number whether it is the Imu topic.
        """
        self._ours = ours
        self._channel_copies = np.zeros(len(ours), np.int64)
        for channel, connection in connections.items():
            copy = self._copies.get(connection.id)
            self._channel_copies[channel] = 0 if copy is None else copy.id
        vectors = [(c.id, place_in_result(name)) for name, c in self._samples.items()]
        self._vectors = np.array(vectors, np.int64).reshape(-1, 2)

    def take_piece(self, piece: Piece) -> None:
        """Filter the Imu messages of a piece and write all of it: as `take` does, at once."""
        results = np.empty(len(piece.imus), RESULT)
        reports = self._process_piece(piece, results)
        self._write_piece(piece, results, reports)
        self._moments.add_results(piece.imus, results)

    def _process_piece(
        self, piece: Piece, results: NDArray[Any]
    ) -> list[tuple[int, _Moment, MessageReport]]:
        """Filter the Imu messages of a piece.

        Returns:
            For each report to be written the row that it stands before, when, and of what.
        """
        data, rows, imus, places, stops = piece
        befores = np.searchsorted(places, [stop.row for stop in stops]).tolist()

        def message(k: int) -> bytes:
            return payload(data, rows[places[k]])

        reports, due, marks, done = [], [], [], 0
        for stop, before in zip([*stops, None], [*befores, len(imus)], strict=True):
            if isinstance(stop, BatchEnd):
                moment = self._moment_if_due(stop.first, stop.last)
                if moment is not None:
                    due.append((stop.row, moment))
                    marks.append(before)
                continue
            part = range(done, before)
            marked = self._filter.process_imus(imus, part, message, results, marks)
            reports += [(*when, what) for when, what in zip(due, marked, strict=True)]
            due, marks, done = [], [], part.stop
            if stop is not None:
                self.tell(stop.connection, payload(data, rows[stop.row]))
        return reports

    def _write_piece(
        self,
        piece: Piece,
        results: NDArray[Any],
        reports: list[tuple[int, _Moment, MessageReport]],
    ) -> None:
        """Write a piece that has been filtered, with the reports on it."""
        data, rows, imus, places, _ = piece
        texts, ends = diagnostic_arrays([self._report(when, of) for _, when, of in reports])
        reported = np.empty((len(reports), 3), np.int64)
        reported[:, 0] = [row for row, _, _ in reports]
        reported[:, 1] = [moment.time for _, moment, _ in reports]
        reported[:, 2] = ends
        # One record for each message, and for an Imu what the filter makes of it: each no longer.
        made = 1 + len(self._samples) + 1
        count = len(rows) + made * len(imus) + len(reports)
        sizes = int(rows['size'].sum()) + made * int(rows['size'][places].sum())
        out = np.empty(sizes + len(texts) + count * RECORD_BYTES, np.uint8)
        channels, index = np.empty(count, np.int64), np.empty((count, 2), np.int64)
        size, count, written = lay_out(
            data,
            rows,
            self._channel_copies,
            self._ours,
            imus,
            results,
            results.view(np.uint8).reshape(len(imus), RESULT.itemsize),
            self._room,
            self._output.id,
            self._vectors,
            0 if self._rest is None else self._rest.id,
            self._at_rest,
            self._reports.id,
            reported,
            texts,
            out,
            channels,
            index,
        )
        if count:
            self._writer.write_bulk(out[:size], channels[:count], index[:count])
        self._written += written

    def end_batch(self, first: int, last: int) -> None:
        """Write a report after a batch of messages with these log times (ns), if it is time."""
        moment = self._moment_if_due(first, last)
        if moment is not None:
            self._write_report(moment)

    def _moment_if_due(self, first: int, last: int) -> _Moment | None:
        """Return that of a report after a batch with these log times (ns), if it is time."""
        if self._began < 0:
            self._began = self._reported = first
        self._now = last
        return self._moment() if last - self._reported >= BATCH_SPAN // 2 else None

    def _moment(self) -> _Moment:
        """Return the present one, for a report."""
        seconds = (self._now - self._reported) * 1e-9
        self._reported = self._now
        return _Moment(self._now, seconds)

    def _write_report(self, moment: _Moment) -> None:
        report, _ = diagnostic_arrays([self._report(moment, self._filter.report())])
        self._writer.write(self._reports, moment.time, report.tobytes())

    def _report(self, moment: _Moment, report: MessageReport) -> tuple[int, list[DiagnosticStatus]]:
        """Return stamp (ns) and content of a report; they are made in their order."""
        statuses = self._health.judge(report, moment.seconds)
        return min(moment.time, _LATEST_STAMP), statuses

    def _add_up(self, outcomes: list[Outcome]) -> None:
        rows = [o for o in outcomes if o.data is not None and o.result is not None]
        if rows:
            self._moments.add(
                np.array([o.imu.angular_velocity for o in rows if o.imu is not None]),
                np.array([o.result['angular_velocity'] for o in rows]),
            )

    def finish(self) -> Summary:
        """Write the last report and return what was done."""
        if self._began >= 0 and (self._now > self._reported or self._now == self._began):
            self._write_report(self._moment())
        state = self._filter.filter.state
        raw, filtered = self._moments.statistics()
        return Summary(
            topic=self._topic,
            output_topic=self._topics.filtered,
            received=self._filter.received,
            written=self._written,
            not_reported=self._filter.not_reported,
            left_out=self._left_out,
            outliers=state['counts']['outliers'].copy(),
            raw=raw,
            filtered=filtered,
            period=float(state['clock']['period']),
            # Other topics may go on for longer, so that nothing is told of the rate.
            status=Health().judge(
                self._filter.report(), (self._now - self._began) * 1e-9, paced=False
            ),
        )
