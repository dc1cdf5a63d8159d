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

"""One bag: streamed once through the filter, and what the table says of it."""

import logging
import math
import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Integers
from gyro_drift_filter.bags.message_types import read_message
from gyro_drift_filter.bags.opening import FILE_SUFFIXES, open_bag
from gyro_drift_filter.bags.output import NoOutput, Output
from gyro_drift_filter.bags.recording import OutputError, Piece, Recording, are_among, is_cdr
from gyro_drift_filter.bags.replay_run import TEMPERATURE_TYPE, ReplayRun
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.examination import Examined, examine
from gyro_drift_filter.doctor.findings import Finding
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.fleet.bag_report import report_path, shown_topic
from gyro_drift_filter.fleet.noise import AxisNoise, identify_noise
from gyro_drift_filter.fleet.sources import Bag, shown
from gyro_drift_filter.fleet.streamed import StreamedPath, content_hash
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.messages.telemetry import MessageReport, Telemetry
from gyro_drift_filter.recordings.examined import Reading
from gyro_drift_filter.report.page import DrawnRecording, page
from gyro_drift_filter.report.signals import Signals
from gyro_drift_filter.report.verdict import BiasSource, RunWatch, Verdict
from gyro_drift_filter.whole_file import write_whole

Row = dict[str, Any]

# A bag that was cut off is recovered into a temporary file, whose name says nothing.
_TEMPORARY = re.compile(re.escape(tempfile.gettempdir()) + r'/\S+/bag(\.\w+)?')
_LOGGER = logging.getLogger('gyro_drift_filter')


@dataclass(frozen=True)
class Job:
    """What is done with each bag.

    Attributes:
        parameters: Of the filter.
        bags: Folder that filtered bags are written to; None for none.
        reports: Folder that reports are written to; None for none.
    """

    parameters: Parameters
    bags: Path | None = None
    reports: Path | None = None


@dataclass(frozen=True)
class Result:
    """What was measured of one bag.

    Attributes:
        content: Hash of what it holds; empty where that could not be read.
        rows: Of the table, without the columns of `PLACE`.
        lasting: Whether the same content gives the same rows: not where the store failed, or the
            disk that is written to.
    """

    content: str
    rows: list[Row]
    lasting: bool


def content_of(bag: Bag) -> str:
    """Return the hash of what a bag holds, for which all of it is read; empty where it can't be."""
    with suppress(GyroDriftFilterError, OSError), bag.opened() as path:
        return content_hash(path.contents)
    return ''


def measure(bag: Bag, job: Job) -> Result:
    """Return what the table says of a bag; whatever is wrong with it is a row with the error."""
    content, lasting, error = '', True, ''
    rows: list[Row] = []
    topics: list[DrawnRecording] = []
    with _notes() as notes, ExitStack() as stack:
        try:
            path = stack.enter_context(bag.opened())
        except GyroDriftFilterError as failure:
            return Result('', [_failed(failure)], lasting=False)
        try:
            rows, topics = _measured(path, bag, job)
        except (GyroDriftFilterError, OSError) as failure:
            error, lasting = str(failure), not _is_of_the_machine(failure)
        except Exception as failure:  # a file that lies may bring about nearly anything
            error, lasting = f'{type(failure).__name__}: {failure}', False
        try:
            content = content_hash(path.contents)
            if topics and job.reports is not None:
                write_whole(report_path(job.reports, content), page(topics))
        except (GyroDriftFilterError, OSError) as failure:
            error, lasting = str(failure), False
        for failed in (file.failure for file in path.contents.values() if file.failure):
            error, lasting = f'the store does not give it: {failed}', False
    if error:
        rows = [_failed(error)]
    for row in rows:
        row['content'] = content or None
        row['notes'] = [_nameless(note) for note in notes]
    return Result(content, rows, lasting)


def _is_of_the_machine(failure: BaseException | None) -> bool:
    """Return whether an error is that of a disk, say a full one, and not of what a bag holds."""
    while failure is not None and not isinstance(failure, (OSError, OutputError)):
        failure = failure.__cause__
    return failure is not None


def _failed(error: object) -> Row:
    return {'error': _nameless(str(error))}


def _nameless(text: str) -> str:
    """Return an error or a note as it may be shown, about the content alone."""
    return shown(_TEMPORARY.sub('the bag', text))


@contextmanager
def _notes() -> Iterator[list[str]]:
    """Collect what is logged, as a bag may have more to say than its figures."""
    notes: list[str] = []

    class Collector(logging.Handler):
        def emit(self, record: logging.LogRecord) -> None:
            notes.append(record.getMessage())

    collector, propagate = Collector(logging.WARNING), _LOGGER.propagate
    _LOGGER.addHandler(collector)
    _LOGGER.propagate = False
    try:
        yield notes
    finally:
        _LOGGER.removeHandler(collector)
        _LOGGER.propagate = propagate


class _Temperatures:
    """The temperatures that are recorded beside an Imu."""

    def __init__(self, recording: Recording, topic: str) -> None:
        self._connections = {
            connection.id: connection
            for connection in recording.connections
            if (connection.topic, connection.msgtype) == (topic, TEMPERATURE_TYPE)
            and is_cdr(connection)
        }
        self._is_temperature = are_among(recording, self._connections)
        self._values: list[float] = []

    def take(self, piece: Piece) -> None:
        """Take a piece of the recording in, passing over what can't be read."""
        for row in np.flatnonzero(self._is_temperature[piece.rows['channel']]).tolist():
            with suppress(Exception):
                connection = self._connections[int(piece.rows['channel'][row])]
                message = read_message(piece.message(row), connection)
                self._values.append(float(message.temperature))

    def mean(self) -> float | None:
        """Return the mean in degrees Celsius, None where there are none."""
        finite = [value for value in self._values if math.isfinite(value)]
        return math.fsum(finite) / len(finite) if finite else None


def _measured(path: StreamedPath, bag: Bag, job: Job) -> tuple[list[Row], list[DrawnRecording]]:
    """Return the rows of a bag that can be read, and what its report, if any, shows of each topic.

    Raises:
        BagError: It can't be.
    """
    selection = Selection(all_imu=True, distinct_outputs=True)
    with open_bag(path) as recording, ExitStack() as stack:
        inputs = selection.inputs(recording)
        output: Output | NoOutput = NoOutput(len(inputs))
        if job.bags is not None:
            writer = stack.enter_context(BagWriter(written_path(job.bags, bag), replace=True))
            kept = selection.keeps(recording)
            output = Output(recording, writer, inputs, kept, diagnostics=False)
        watches: dict[str, RunWatch] = {}
        signals: dict[str, Signals] = {}

        def watched(topic: str, filter_: Filter) -> RunWatch | Signals:
            if job.reports is None:
                watches[topic] = RunWatch(filter_)
                return watches[topic]
            signals[topic] = Signals(filter_)
            watches[topic] = signals[topic].watch
            return signals[topic]

        run = ReplayRun(recording, output, job.parameters, inputs, watched)
        readings = {
            topic: (Reading(recording, topic, names), _Temperatures(recording, names.temperature))
            for topic, names in inputs.items()
        }
        for piece in selection.pieces(recording, lambda done, total: None):
            run.take(piece)
            for reading, temperatures in readings.values():
                reading.take(piece)
                temperatures.take(piece)
        summaries = run.finish()
    rows: list[Row] = []
    for summary, filter_ in zip(summaries, run.filters, strict=True):
        reading, temperatures = readings[summary.topic]
        rows += _rows_of_topic(
            summary,
            watches[summary.topic],
            filter_.messages.report(),
            reading.finish(),
            temperatures.mean(),
        )
    by_topic = {summary.topic: summary for summary in summaries}
    topics = [
        shown_topic(f'{bag.robot}, {bag.below}', of_topic, by_topic[topic], job.parameters)
        for topic, of_topic in signals.items()
        if len(of_topic.log_times)
    ]
    return rows, topics


def written_path(bags: Path, bag: Bag) -> Path:
    """Return where the filtered bag is written: below a folder as the bag is below its source."""
    below = Path(bag.below)
    return bags / (below.with_suffix('') if below.suffix in FILE_SUFFIXES else below)


def _times(examined: Examined, watch: RunWatch) -> Integers:
    """Return in ns when each sample (n,) was taken: its stamp, or what takes its place."""
    stamps = np.asarray(examined.log_times if watch.is_by_log else examined.stamps)
    if np.ptp(stamps) > 0:
        return stamps
    # They tell no time, and neither does the log: a sample rate was given.
    return np.round(np.arange(len(stamps)) * watch.period * 1e9).astype(np.int64)


def _rows_of_topic(
    summary: Summary,
    watch: RunWatch,
    report: MessageReport,
    examined: Examined,
    temperature: float | None,
) -> list[Row]:
    """Return the rows of one Imu topic: one for each axis, or one with an error."""
    common: Row = {
        'topic': summary.topic,
        'frame_id': report.frame,
        'start': summary.start,
        'duration': summary.seconds,
        'messages': summary.received,
    }
    if not len(examined.stamps):
        error = f'topic {summary.topic} has no message with an angular velocity'
        if not summary.start:  # the bag has no message at all
            common |= {'start': None, 'duration': None}
        return [common | {'error': error}]
    verdict, findings, state = watch.verdict(summary), examine(examined), report.telemetry
    noises = identify_noise(
        _times(examined, watch), examined.rates, examined.accelerations, examined.log_times
    )
    common |= {
        'sample_rate': 1.0 / verdict.period,
        'jitter': _value(findings, 'jitter_seconds'),
        'gaps': state.gaps,
        'missing_samples': state.missing_samples,
        'repeats': _value(findings, 'repeated'),
        'rest': verdict.rests.seconds,
        'noise_samples': verdict.rests.samples,
        'temperature': temperature,
        'drift_before': verdict.heading.raw,
        'drift_after': verdict.heading.left,
        'outcome': str(verdict.outcome),
        'faults': sorted({f.name for f in findings if f.is_fault}),
    }
    rows = (
        common | _figures_of_axis(axis, verdict, findings, state) | _figures_of_noise(noise)
        for axis, noise in enumerate(noises)
    )
    return [{key: _plain(value) for key, value in row.items()} for row in rows]


def _figures_of_axis(axis: int, verdict: Verdict, findings: list[Finding], state: Telemetry) -> Row:
    is_known = verdict.bias.source != BiasSource.UNKNOWN
    amplitude, frequency = _strongest_line(findings, AXES[axis])
    judged = state.nis_samples[axis]
    return {
        'axis': AXES[axis],
        'noise': verdict.rests.raw_deviation[axis],
        'bias': verdict.bias.rates[axis] if is_known else None,
        'bias_deviation': verdict.bias.deviations[axis] if is_known else None,
        'vibration': amplitude,
        'vibration_frequency': frequency,
        'outlier_share': verdict.outliers.axes[axis] / max(verdict.received, 1),
        'consistency': state.nis_sum[axis] / judged if judged else None,
    }


def _figures_of_noise(noise: AxisNoise | None) -> Row:
    if noise is None:
        return {}
    walk = noise.allan.angle_random_walk
    return {
        'angle_random_walk': walk.value if walk else None,
        'bias_instability': noise.allan.bias_instability.value,
        'bias_instability_is_bound': noise.allan.still_falls,
        'bias_trend': noise.trend,
    }


def _value(findings: list[Finding], key: str) -> Any:
    """Return a figure that one finding has, None where none has it."""
    return next((finding.values[key] for finding in findings if key in finding.values), None)


def _strongest_line(findings: list[Finding], axis: str) -> tuple[float | None, float | None]:
    """Return amplitude in rad/s and frequency in Hz of the strongest line of an axis."""
    lines = _value(findings, 'lines')
    if lines is None:
        return None, None
    of_axis = [line for line in lines if line.axis == axis]
    if not of_axis:
        return 0.0, None
    strongest = max(of_axis, key=lambda line: line.amplitude)
    return strongest.amplitude, strongest.frequency


def _plain(value: Any) -> Any:
    """Return a figure as JSON knows it: what is no number is none."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
