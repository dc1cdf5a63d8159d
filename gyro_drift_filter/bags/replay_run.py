"""One run of a recording through the filter: what is filtered, written, counted and reported."""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.output import Output
from gyro_drift_filter.bags.recording import Piece, Recording, is_cdr
from gyro_drift_filter.bags.report_times import BATCH_SPAN, ReportTimes
from gyro_drift_filter.bags.statistics import RateStatistics, Statistics
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.mcap.message_kernels import ROW
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.message_filter import NOTE, MessageFilter
from gyro_drift_filter.messages.motion_hint import moves

TEMPERATURE_TYPE = 'sensor_msgs/msg/Temperature'
# What is filtered and laid out at once is at most as much, in messages and log time (ns): there may
# be a report for each second.
_PART = 8192
_PART_SPAN = 100 * BATCH_SPAN


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


class ReplayRun:
    """Take pieces of a recording through the filter, and write them to the output."""

    def __init__(
        self,
        recording: Recording,
        output: Output,
        parameters: Parameters,
        topic: str,
        hint: str | None,
    ) -> None:
        """Start; `hint` is the topic that hints at motion, if there is one."""
        self._output = output
        self._topic = topic
        self._typestore = recording.typestore
        self._messages = MessageFilter(parameters)
        self._health = Health(Topics.of(topic).node)
        self._statistics = RateStatistics()
        self._report_times = ReportTimes()
        # Topics beside the Imu that the filter listens to.
        temperature = Topics.of(topic).temperature, TEMPERATURE_TYPE
        self._listened = {
            connection.id: connection.msgtype
            for connection in recording.connections
            if is_cdr(connection)
            and (connection.topic == hint or (connection.topic, connection.msgtype) == temperature)
        }

    def take(self, piece: Piece) -> None:
        """Filter the Imu messages of a piece and write all of it, with the reports that are due.

        Raises:
            BagError: The output can't be written.
        """
        for part in _parts(piece):
            imus = read_imus(part, self._output.is_imu)
            reports = self._report_times.among(part.rows)
            statuses = self._filter(part, imus, reports)
            self._output.write(part, imus, reports, statuses)
            self._statistics.add(imus)

    def _filter(self, piece: Piece, imus: Any, reports: Any) -> list[list[DiagnosticStatus]]:
        """Filter the Imu messages of a piece; return what each report says."""
        # A report that stands before a message comes before what that may say of the temperature.
        listened = np.flatnonzero(np.isin(piece.rows['channel'], list(self._listened)))
        notes: Any = np.zeros(len(reports), NOTE)
        notes['index'] = np.searchsorted(imus['row'], reports['row'])
        stops = np.searchsorted(imus['row'], listened).tolist()
        notes_before = np.searchsorted(reports['row'], listened, 'right').tolist()
        done = noted = 0
        for row, stop, before in zip(
            [*listened.tolist(), None],
            [*stops, len(imus)],
            [*notes_before, len(notes)],
            strict=True,
        ):
            notes['index'][noted:before] -= done
            self._messages.take_imus(piece.data, imus[done:stop], notes[noted:before])
            done, noted = stop, before
            if row is not None:
                self._listen(self._listened[int(piece.rows[row]['channel'])], piece.message(row))
        return [
            self._health.judge(report, seconds)
            for report, seconds in zip(
                self._messages.reports(notes), reports['seconds'].tolist(), strict=True
            )
        ]

    def _listen(self, kind: str, data: bytes) -> None:
        """Tell the filter what another topic says, passing over what can't be read."""
        with suppress(Exception):
            message: Any = self._typestore.deserialize_cdr(data, kind)
            if kind == TEMPERATURE_TYPE:
                self._messages.filter.note_temperature(message.temperature)
            else:
                self._messages.filter.hint(moves(message))

    def finish(self) -> Summary:
        """Write the last report and return what was done.

        Raises:
            BagError: The output can't be written.
        """
        nothing = Piece(np.empty(0, np.uint8), np.empty(0, ROW))
        imus = read_imus(nothing, self._output.is_imu)
        reports = self._report_times.at_end()
        self._output.write(nothing, imus, reports, self._filter(nothing, imus, reports))
        state, report = self._messages.filter.state, self._messages.report()
        raw, filtered = self._statistics.both()
        return Summary(
            topic=self._topic,
            output_topic=Topics.of(self._topic).filtered,
            received=report.received,
            written=self._output.written,
            not_reported=report.not_reported,
            left_out=self._output.left_out,
            outliers=state['counts']['outliers'].copy(),
            raw=raw,
            filtered=filtered,
            period=float(state['clock']['mean_period']),
            # Other topics may go on for longer, so that the rate is not judged.
            status=Health(Topics.of(self._topic).node).judge(
                report, self._report_times.seconds, paced=False
            ),
        )


def _parts(piece: Piece) -> Iterator[Piece]:
    """Cut a piece into parts of bounded length."""
    times, done = piece.rows['log_time'], 0
    while done < len(times):
        elapsed = times[done : done + _PART] - times[done]
        stop = done + int(np.searchsorted(elapsed, _PART_SPAN))
        yield Piece(piece.data, piece.rows[done:stop])
        done = stop
