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

"""A recording through one or several filters at once, with all that the report draws of it."""

from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import (
    BagError,
    Piece,
    Recording,
    are_among,
    channels_of,
)
from gyro_drift_filter.bags.replay_run import (
    NO_MESSAGES,
    Summary,
    TopicFilter,
    small_parts,
    why_nothing,
)
from gyro_drift_filter.bags.report_times import ReportTimes
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.identify.series import Stored, append_rows, stacked, stored_columns
from gyro_drift_filter.messages.imu import IMU_TYPE, ImuKind
from gyro_drift_filter.report.page import when_recorded
from gyro_drift_filter.report.signals import COMPARED, VECTORS, Signals


class Recorded(NamedTuple):
    """What a recording holds on its filtered topic.

    Attributes:
        times: (n,) log times in s since the first message.
        rates: (n, 3) in rad/s.
        same: Share of the samples that are what the filter makes here, bit for bit.
    """

    times: NDArray[np.float64]
    rates: NDArray[np.float64]
    same: float


class Filtered(NamedTuple):
    """A recording that went through filters.

    Attributes:
        signals: By method.
        summaries: By method.
        recorded: Its own filtered topic, None where it has none.
        frame: header.frame_id of the Imu messages.
        messages: Of all topics.
    """

    signals: dict[str, Signals]
    summaries: dict[str, Summary]
    recorded: Recorded | None
    frame: str
    messages: int


class _Pass:
    """One pass through a recording."""

    def __init__(
        self,
        recording: Recording,
        parameters: Sequence[Parameters],
        chosen: str,
        names: Any,
    ) -> None:
        self._is_imu = channels_of(recording, chosen)
        filtered = (names.filtered, IMU_TYPE)
        ids = [c.id for c in recording.connections if (c.topic, c.msgtype) == filtered]
        self._is_filtered = are_among(recording, ids)
        self.signals: dict[str, Signals] = {}
        self.filters = {
            p.method: TopicFilter(recording, p, chosen, names, partial(self._keep, p.method))
            for p in parameters
        }
        self.report_times = ReportTimes()
        self._recorded_times = Stored(np.int64)
        self._recorded = stored_columns(3)
        self._exact = stored_columns(3)  # as this filter makes them

    def _keep(self, method: str, filter_: Filter) -> Signals:
        """Return who keeps the signals of a method, all those of the first one."""
        self.signals[method] = Signals(filter_, COMPARED if self.signals else VECTORS)
        return self.signals[method]

    def take(self, piece: Piece) -> None:
        """Take a piece of the recording in."""
        for part in small_parts(piece):
            self._filter(part, self.report_times.among(part.rows))
            if self._is_filtered.any():
                self._keep_recorded(part)

    def end(self) -> None:
        """Make the last report."""
        self._filter(NO_MESSAGES, self.report_times.at_end())

    def _filter(self, piece: Piece, reports: Any) -> None:
        main = next(iter(self.filters))
        for method, filter_ in self.filters.items():
            imus = read_imus(piece, self._is_imu)
            filter_.judge(filter_.take(piece, imus, reports), reports)
            if method == main and self._is_filtered.any():
                good = imus[imus['kind'] == ImuKind.GOOD]
                append_rows(self._exact, good['result']['angular_velocity'])

    def _keep_recorded(self, piece: Piece) -> None:
        imus = read_imus(piece, self._is_filtered)
        good = imus[imus['kind'] == ImuKind.GOOD]
        self._recorded_times.append(piece.rows['log_time'][good['row']])
        append_rows(self._recorded, good['sample']['angular_velocity'])

    def recorded(self) -> Recorded | None:
        """Return what the recording holds on its filtered topic."""
        if not len(self._recorded_times):
            return None
        rates, ours = stacked(self._recorded), stacked(self._exact)
        # Every message of both, in their order, unless some were refused or lost.
        same = 0.0
        if len(rates) == len(ours):
            same = float((rates == ours).all(axis=1).mean())
        times = (np.asarray(self._recorded_times) - self.report_times.start) * 1e-9
        return Recorded(times, rates, same)


def filter_recording(
    bag: Path,
    parameters: Sequence[Parameters],
    selection: Selection,
    progress: Callable[[int, int], None],
) -> Filtered:
    """Send a recording through a filter for each of the parameters, which differ by their method.

    Raises:
        BagError: The bag can't be read, or holds no message with an angular velocity in that time.
    """
    with open_bag(bag) as recording:
        ((chosen, names),) = selection.inputs(recording).items()
        run = _Pass(recording, parameters, chosen, names)
        for piece in selection.pieces(recording, progress):
            run.take(piece)
        run.end()
        count = recording.message_count
    start, seconds = run.report_times.start, run.report_times.seconds
    summaries = {
        method: filter_.summary(filter_.messages.report().received, {}, start, seconds)
        for method, filter_ in run.filters.items()
    }
    if not len(next(iter(run.signals.values())).log_times):
        summary = next(iter(summaries.values()))
        raise BagError(f'topic {chosen} {why_nothing(summary)}{selection.when}')
    frame = next(iter(run.filters.values())).messages.report().frame
    return Filtered(run.signals, summaries, run.recorded(), frame, count)


def facts_of(bag: Path, filtered: Filtered, command: str) -> list[tuple[str, str]]:
    """Return where the report comes from: pairs of what and which."""
    summary = next(iter(filtered.summaries.values()))
    return [
        ('bag', str(bag)),
        ('topic', f'{summary.topic}, frame {filtered.frame}'),
        when_recorded(summary, f' of {filtered.messages}'),
        ('command', command),
        ('made', f'{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC'),
    ]
