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

"""One run of a recording through the filter: what is filtered, written, counted and reported."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import chain, starmap
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.bias_memory import ReplayBiasMemory
from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.library import Connection
from gyro_drift_filter.bags.message_types import read_message
from gyro_drift_filter.bags.output import NoOutput, Output
from gyro_drift_filter.bags.recording import Piece, Recording, are_among, channels_of, is_cdr
from gyro_drift_filter.bags.report_times import BATCH_SPAN, ReportTimes
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.mcap.message_kernels import ROW
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.imu import IMU_TYPE, ImuKind
from gyro_drift_filter.messages.message_filter import NOTE, MessageFilter
from gyro_drift_filter.messages.motion_hint import HINT_TYPES, moves
from gyro_drift_filter.messages.rules import Rule
from gyro_drift_filter.messages.span import Span
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.messages.telemetry import MessageReport
from gyro_drift_filter.phrases import without_rate

TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'
# What is filtered and laid out at once is at most as much, in messages and log time (ns): there may
# be a report for each second.
_PART = 8192
_PART_SPAN = 100 * BATCH_SPAN
# What the last report comes with.
NO_MESSAGES = Piece(np.empty(0, np.uint8), np.empty(0, ROW))


class Watcher(Protocol):
    """Who sees what goes through the filter of a topic."""

    def take(self, imus: Any, log_times: NDArray[np.int64]) -> None:
        """See messages (n,) IMU that were filtered, with their log times (n,) in ns."""

    def judge(self, span: Span, rules: Sequence[Rule], seconds: float) -> None:
        """See which rules apply to a report, so many s after the one before."""


class Watch(NamedTuple):
    """What a caller sees of a replay as it goes on.

    Attributes:
        progress: Called with the number of messages done and their total.
        watcher: Called with each Imu topic and its filter, which has seen nothing yet; returns who
            sees what goes through it.
    """

    progress: Callable[[int, int], None] = lambda done, total: None
    watcher: Callable[[str, Filter], Watcher | None] = lambda topic, filter_: None


def why_nothing(summary: Summary, when: str = '') -> str:
    """Return why nothing of a topic came out of a filter; `when` is the time of a `Selection`."""
    if not summary.received:
        return f'topic {summary.topic} has no messages{when}'
    never, why = int(summary.unusable.max()), summary.status[0].message
    if never:
        known = [int(count) < never for count in summary.unusable]
        why = without_rate(known, LARGEST_RATE) or why
    return f'nothing of topic {summary.topic} can be filtered: {why}'


class ReplayRun:
    """Take pieces of a recording through filters, and write them to the output.

    Attributes:
        filters: One for each Imu topic.
    """

    def __init__(
        self,
        recording: Recording,
        output: Output | NoOutput,
        parameters: Parameters,
        inputs: Mapping[str, Topics],
        watcher: Callable[[str, Filter], Watcher | None],
        hint: str | None = None,
        memory: Path | None = None,
        *,
        is_judged: bool = True,
    ) -> None:
        """Start.

        Args:
            recording: What is replayed.
            output: Where to.
            parameters: Of the filters.
            inputs: The names of the outputs by the Imu topic that they belong to.
            watcher: As of a `Watch`.
            hint: The topic that hints at motion, if there is one.
            memory: File of the bias that the recording before has left, if there is one.
            is_judged: Whether there are reports, of which each takes as long as many samples.

        Raises:
            BagError: The messages of an Imu topic are in no form that can be read.
        """
        self._output = output
        self._report_times = ReportTimes()
        self._is_judged = is_judged
        self.filters = [
            TopicFilter(recording, parameters, topic, names, partial(watcher, topic), hint, memory)
            for topic, names in inputs.items()
        ]

    def save_memory(self) -> None:
        """Write the bias for the next recording.

        Raises:
            MemoryFileError: The disk does not take it.
        """
        for filter_ in self.filters:
            if filter_.memory is not None:
                filter_.memory.save()

    def take(self, piece: Piece) -> None:
        """Filter the Imu messages of a piece and write all of it, with the reports that are due.

        Raises:
            BagError: The output can't be written.
        """
        for part in small_parts(piece):
            self._filter(part, self._report_times.among(part.rows))

    def _filter(self, piece: Piece, reports: Any) -> None:
        """Filter the Imu messages of a piece, and write it with reports."""
        if not self._is_judged:
            reports = reports[:0]
        imus, statuses = [], []
        for index, filter_ in enumerate(self.filters):
            of_topic = read_imus(piece, filter_.is_imu)
            of_topic['topic'] = index
            imus.append(of_topic)
            message_reports = filter_.take(piece, of_topic, reports)
            statuses.append(filter_.judge(message_reports, reports))
        all_imus = imus[0]
        if len(imus) > 1:
            all_imus = np.concatenate(imus)
            all_imus = all_imus[np.argsort(all_imus['row'])]
        together = (list(chain(*of_report)) for of_report in zip(*statuses, strict=True))
        self._output.write(piece, all_imus, reports, together)

    def finish(self) -> list[Summary]:
        """Write the last report and return what was done with each Imu topic.

        Raises:
            BagError: The output can't be written.
        """
        self._filter(NO_MESSAGES, self._report_times.at_end())
        times = self._report_times.start, self._report_times.seconds
        return [
            filter_.summary(written, self._output.left_out, *times)
            for filter_, written in zip(self.filters, self._output.written, strict=True)
        ]


class TopicFilter:
    """The filter of one Imu topic, with the topics beside it that it listens to.

    Attributes:
        is_imu: By the `id` of a connection, whether it is of the topic.
    """

    def __init__(
        self,
        recording: Recording,
        parameters: Parameters,
        topic: str,
        names: Topics,
        watcher: Callable[[Filter], Watcher | None],
        hint: str | None = None,
        memory: Path | None = None,
    ) -> None:
        self.topic = topic
        self.is_imu = channels_of(recording, topic, IMU_TYPE)
        self._names = names
        self.messages = MessageFilter(parameters)
        filter_ = self.messages.filter
        self.memory = (
            None if memory is None else ReplayBiasMemory(memory, names.node, self.messages)
        )
        self._watcher = watcher(filter_)
        self._health = Health(names.node)
        self._first_stamp = 0
        listened = {(hint, kind) for kind in HINT_TYPES.values()}
        listened.add((names.temperature, TEMPERATURE_TYPE))
        self._listened = {
            connection.id: connection
            for connection in recording.connections
            if is_cdr(connection) and (connection.topic, connection.msgtype) in listened
        }
        self._is_listened = are_among(recording, self._listened)

    def take(self, piece: Piece, imus: Any, reports: Any) -> list[MessageReport]:
        """Filter the Imu messages of a piece; return what it was like at each REPORT_TIME."""
        if self.memory is not None:
            self.memory.note(piece, imus)
        # A report that stands before a message comes before what that may say of the temperature.
        listened = np.flatnonzero(self._is_listened[piece.rows['channel']])
        notes: Any = np.zeros(len(reports), NOTE)
        rows_of_imus = np.ascontiguousarray(imus['row'])
        notes['index'] = np.searchsorted(rows_of_imus, reports['row'])
        stops = np.searchsorted(rows_of_imus, listened).tolist()
        notes_before = np.searchsorted(reports['row'], listened, 'right').tolist()
        done = noted = 0
        for row, stop, before in zip(
            [*listened.tolist(), None],
            [*stops, len(imus)],
            [*notes_before, len(notes)],
            strict=True,
        ):
            notes['index'][noted:before] -= done  # they count from where the call begins
            self.messages.take_imus(piece.data, imus[done:stop], notes[noted:before])
            done, noted = stop, before
            if row is not None:
                self._listen(self._listened[int(piece.rows[row]['channel'])], piece.message(row))
        if not self._first_stamp:
            good = np.flatnonzero(imus['kind'] == ImuKind.GOOD)
            self._first_stamp = int(imus['sample']['stamp'][good[0]]) if len(good) else 0
        if self._watcher is not None:
            self._watcher.take(imus, piece.rows['log_time'][rows_of_imus])
        return self.messages.reports(notes)

    def judge(
        self, message_reports: Sequence[MessageReport], reports: Any
    ) -> Iterator[list[DiagnosticStatus]]:
        """Judge each report; return what is to be said at it, worded where that is asked for."""
        judged = []
        for report, seconds in zip(message_reports, reports['seconds'].tolist(), strict=True):
            span, of_input, of_filter = self._health.rules(report, seconds)
            if self._watcher is not None:
                self._watcher.judge(span, of_input + of_filter, seconds)
            judged.append((span, of_input, of_filter))
        return starmap(self._health.statuses, judged)

    def _listen(self, connection: Connection, data: bytes) -> None:
        """Tell the filter what another topic says, passing over what can't be read."""
        said, is_temperature = None, connection.msgtype == TEMPERATURE_TYPE
        with suppress(Exception):
            message = read_message(data, connection)
            said = message.temperature if is_temperature else moves(message)
        if said is None:
            return
        if is_temperature:
            self.messages.filter.note_temperature(said)
        else:
            self.messages.filter.hint(said)

    def summary(
        self, written: int, left_out: dict[str, str], start: int, seconds: float
    ) -> Summary:
        """Return what was done, at the end of a recording that started then and lasted so long."""
        state, report = self.messages.filter.state, self.messages.report()
        return Summary(
            topic=self.topic,
            output_topic=self._names.filtered,
            received=report.received,
            written=written,
            not_reported=report.not_reported,
            left_out=left_out,
            outliers=state['counts']['outliers'].copy(),
            unusable=state['checks']['unusable'].copy(),
            period=float(state['clock']['mean_period']),
            bias_deviation=np.array(report.telemetry.bias_deviation),
            # Other topics may go on for longer, so that the rate is not judged.
            status=Health(self._names.node, self._first_stamp).judge(report, seconds, paced=False),
            start=start,
            seconds=seconds,
        )


def small_parts(piece: Piece) -> Iterator[Piece]:
    """Cut a piece into parts of bounded length."""
    times, done = piece.rows['log_time'], 0
    while done < len(times):
        elapsed = times[done : done + _PART] - times[done]
        stop = done + int(np.searchsorted(elapsed, _PART_SPAN))
        yield Piece(piece.data, piece.rows[done:stop])
        done = stop
