"""Replay a bag through the filter: the input's topics and the filter's beside them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.cdr import IMU_TYPE, VECTOR_TYPE
from gyro_drift_filter.bags.health import NODE_NAME, Health, Status
from gyro_drift_filter.bags.message_filter import (
    SAMPLE_TOPICS,
    MessageFilter,
    Outcome,
    sample_message,
)
from gyro_drift_filter.bags.motion_hint import HINT_TYPES, moves
from gyro_drift_filter.bags.recording import (
    AnyReader,
    BagError,
    BagWriter,
    Connection,
    is_cdr,
    message_type,
    messages,
    open_bag,
    serialize,
)
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.filter import LARGEST_RATE

DIAGNOSTICS = '/diagnostics'
DIAGNOSTICS_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'
TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'
BOOL_TYPE = 'std_msgs/msg/Bool'
AT_REST = 'at_rest'
_REPORT_PERIOD = 1_000_000_000  # ns
_LARGEST_BATCH = 4096
_LATEST_STAMP = 2**31 * 10**9 - 1  # ns: a stamp's seconds have 31 bits

Progress = Callable[[int, int], None]
Message = tuple[Connection, int, bytes]


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation per axis in rad/s; NaN where there was no sample."""

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


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
    status: list[Status]


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


def choose_topic(reader: AnyReader, wanted: str | None) -> str:
    """Return the Imu topic to filter: the one wanted, or the only one.

    Raises:
        BagError: There is none, there are several, or the wanted one is of another type; the text
            lists what there is.
    """
    types = {connection.topic: connection.msgtype for connection in reader.connections}
    imus = sorted(topic for topic, kind in types.items() if kind == IMU_TYPE)
    if wanted is not None:
        for topic, kind in types.items():
            if topic.strip('/') == wanted.strip('/'):
                if kind == IMU_TYPE:
                    return topic
                raise BagError(f'topic {topic} is of type {kind}, not {IMU_TYPE}')
        raise BagError(f'no topic {wanted} in the bag; Imu topics: {", ".join(imus) or "none"}')
    if not types:
        raise BagError('the bag is empty: it holds no topic')
    if not imus:
        listed = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(types.items()))
        raise BagError(f'no topic of type {IMU_TYPE} in the bag; it holds {listed}')
    outputs = {Topics.of(topic).filtered for topic in imus}
    inputs = [topic for topic in imus if topic not in outputs]
    if len(inputs) == 1:
        return inputs[0]
    raise BagError(f'several Imu topics: choose one with --topic: {", ".join(imus)}')


class _Moments:
    """Count, mean and sum of squared deviations per axis, batch by batch (Chan's formula)."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = np.zeros(3)
        self.squares = np.zeros(3)

    def add(self, values: NDArray[np.float64]) -> None:
        n = len(values)
        if n == 0:
            return
        mean = values.mean(axis=0)
        total = self.count + n
        delta = mean - self.mean
        self.squares += ((values - mean) ** 2).sum(axis=0) + delta**2 * (self.count * n / total)
        self.mean += delta * (n / total)
        self.count = total

    def statistics(self) -> Statistics:
        if self.count == 0:
            return Statistics(np.full(3, np.nan), np.full(3, np.nan))
        return Statistics(self.mean, np.sqrt(self.squares / self.count))


class _Replay:
    """One replay: the filter, the connections of the output bag and the sums for the summary."""

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
        self._told_by = _told_by(reader, self._topics.temperature, hint)
        self._at_rest = -1.0
        self._health = Health(self._filter)
        self._health_in_all = Health(self._filter)
        self._raw, self._filtered = _Moments(), _Moments()
        self._written = 0
        names = SAMPLE_TOPICS if diagnostics else ()
        own = {self._topics.filtered} | {self._topics.sample(name) for name in names}
        if diagnostics:
            own.add(self._topics.sample(AT_REST))
        self._copies: dict[int, Connection] = {}
        self._left_out: dict[str, str] = {}
        for connection in reader.connections:
            if connection.topic in own:
                self._left_out[connection.topic] = 'the filter writes this topic itself'
            elif not is_cdr(connection):
                self._left_out[connection.topic] = 'its messages are not in CDR'
            else:
                self._copies[connection.id] = writer.copy_connection(connection, reader)
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

    def take(self, batch: list[Message]) -> None:
        """Filter the Imu messages of a batch and write all of it, in its order."""
        ours = [data for connection, _, data in batch if connection.topic == self._topic]
        outcomes = self._process(batch)
        self._add_up(outcomes)
        following = iter(zip(ours, outcomes, strict=True))
        for connection, log_time, data in batch:
            copy = self._copies.get(connection.id)
            if copy is None:
                continue
            self._writer.write(copy, log_time, data)
            if connection.topic == self._topic:
                self._write_outcome(log_time, *next(following))

    def _process(self, batch: list[Message]) -> list[Outcome]:
        """Filter the Imu messages between those that tell of temperature or motion."""
        outcomes: list[Outcome] = []
        waiting: list[bytes] = []
        for connection, _, data in batch:
            if connection.topic == self._topic:
                waiting.append(data)
            elif connection.topic in self._told_by:
                outcomes += self._filter.process_batch(waiting)
                waiting = []
                self._tell(connection, data)
        return outcomes + self._filter.process_batch(waiting)

    def _tell(self, connection: Connection, data: bytes) -> None:
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
        if self._rest is not None and outcome.result['at_rest'] != self._at_rest:
            self._at_rest = float(outcome.result['at_rest'])
            told = message_type(BOOL_TYPE)(self._at_rest > 0.0)
            self._writer.write(self._rest, log_time, serialize(told, BOOL_TYPE))

    def report(self, log_time: int, seconds: float) -> None:
        """Write the filter's health as of a log time in ns, `seconds` after the last report."""
        array = _diagnostic_array(log_time, self._health.report(seconds))
        self._writer.write(self._reports, log_time, serialize(array, DIAGNOSTICS_TYPE))

    def _add_up(self, outcomes: list[Outcome]) -> None:
        rows = [o for o in outcomes if o.data is not None and o.result is not None]
        if not rows:
            return
        raw = np.array([o.imu.angular_velocity for o in rows if o.imu is not None])
        filtered = np.array([o.result['angular_velocity'] for o in rows])
        usable = (np.abs(raw) <= LARGEST_RATE).all(axis=1)
        self._raw.add(raw[usable])
        self._filtered.add(filtered[usable])

    def summary(self, seconds: float) -> Summary:
        """Return what was done in all `seconds` of the bag."""
        state = self._filter.filter.state
        return Summary(
            topic=self._topic,
            output_topic=self._topics.filtered,
            received=self._filter.received,
            written=self._written,
            not_reported=self._filter.not_reported,
            left_out=self._left_out,
            outliers=state['counts']['outliers'].copy(),
            raw=self._raw.statistics(),
            filtered=self._filtered.statistics(),
            period=float(state['clock']['period']),
            status=self._health_in_all.report(seconds),
        )


def _told_by(reader: AnyReader, temperature: str, hint: str | None) -> set[str]:
    """Return the topics that the filter listens to beside the Imu.

    Raises:
        BagError: The bag has no topic of that name that could tell of motion.
    """
    types = {connection.topic: connection.msgtype for connection in reader.connections}
    topics = {temperature} if types.get(temperature) == TEMPERATURE_TYPE else set()
    if hint is None:
        return topics
    found = [topic for topic in types if topic.strip('/') == hint.strip('/')]
    if not found:
        raise BagError(f'no topic {hint} in the bag')
    if types[found[0]] not in HINT_TYPES.values():
        wanted = ', '.join(HINT_TYPES.values())
        raise BagError(f'topic {hint} is of type {types[found[0]]}, not one of {wanted}')
    return topics | {found[0]}


def _diagnostic_array(log_time: int, statuses: list[Status]) -> Any:
    seconds, nanoseconds = divmod(min(log_time, _LATEST_STAMP), 10**9)
    header = message_type('std_msgs/msg/Header')
    time = message_type('builtin_interfaces/msg/Time')
    pair = message_type('diagnostic_msgs/msg/KeyValue')
    status = message_type('diagnostic_msgs/msg/DiagnosticStatus')
    return message_type(DIAGNOSTICS_TYPE)(
        header(time(seconds, nanoseconds), ''),
        [
            status(s.level, s.name, s.message, '', [pair(k, v) for k, v in s.values.items()])
            for s in statuses
        ],
    )


def _batches(stream: Iterable[Message]) -> Iterator[list[Message]]:
    """Cut a stream of messages into pieces of at most a second and of bounded length."""
    batch: list[Message] = []
    for message in stream:
        if batch and (len(batch) == _LARGEST_BATCH or message[1] - batch[0][1] >= _REPORT_PERIOD):
            yield batch
            batch = []
        batch.append(message)
    if batch:
        yield batch


def replay(
    source: Path,
    destination: Path,
    *,
    parameters: Parameters,
    topic: str | None = None,
    diagnostics: bool = False,
    hint: str | None = None,
    progress: Progress = lambda done, total: None,
) -> Summary:
    """Filter the Imu topic of a bag and write all into a new bag.

    Messages go through the filter in the order of their log times, and what comes out has the log
    time of what went in. `/diagnostics` is written about once a second.

    Args:
        source: rosbag2 folder or bare .mcap or .db3 file.
        destination: rosbag2 folder to be made.
        parameters: Of the filter.
        topic: The Imu topic, needed where there are several.
        diagnostics: Whether the per-sample topics are written, too.
        hint: Topic by which the robot says whether it moves: Twist, TwistStamped or Odometry.
        progress: Called with the number of messages done and their total.

    Raises:
        BagError: The source can't be read, holds no Imu, or the destination can't be written.
    """
    with open_bag(source) as reader:
        chosen = choose_topic(reader, topic)
        total = reader.message_count
        with BagWriter(destination) as writer:
            run = _Replay(reader, writer, chosen, parameters, diagnostics, hint)
            done = first = reported = now = 0
            for batch in _batches(messages(reader)):
                if done == 0:
                    first = reported = batch[0][1]
                run.take(batch)
                done += len(batch)
                now = batch[-1][1]
                if now - reported >= _REPORT_PERIOD // 2:
                    run.report(now, (now - reported) * 1e-9)
                    reported = now
                progress(done, total)
            if done and (now > reported or now == first):
                run.report(now, (now - reported) * 1e-9)
            summary = run.summary((now - first) * 1e-9)
            if summary.received == 0:
                raise BagError(f'topic {chosen} has no messages')
    return summary
