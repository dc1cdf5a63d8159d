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

"""A recording through filters: with all that the report draws of it, or what one has flagged."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.output import NoOutput
from gyro_drift_filter.bags.recording import BagError, Piece, Recording, are_among
from gyro_drift_filter.bags.replay_run import ReplayRun, small_parts, why_nothing
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.identify.series import Stored, append_rows, stacked, stored_columns
from gyro_drift_filter.messages.imu import IMU_TYPE, ImuKind
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.report.flagged import FlaggedLog
from gyro_drift_filter.report.signals import COMPARED, Signals


class Recorded(NamedTuple):
    """What a recording holds on its filtered topic.

    Attributes:
        times: (n,) log times in s since the first message.
        rates: (n, 3) in rad/s.
        is_same: Whether all are what the filter makes here, bit for bit.
    """

    times: Floats
    rates: Floats
    is_same: bool


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


class _ExactSignals(Signals):
    """The signals of a filter, with its rates to the last bit, as a filtered topic has them."""

    def __init__(self, filter_: Filter) -> None:
        super().__init__(filter_)
        self.exact = stored_columns(3)

    def take(self, imus: Any, log_times: Integers) -> None:
        """See messages (n,) IMU that were filtered, with their log times (n,) in ns."""
        super().take(imus, log_times)
        append_rows(self.exact, imus['result']['angular_velocity'][imus['kind'] == ImuKind.GOOD])


class _FilteredTopic:
    """What a recording holds on its filtered topic."""

    def __init__(self, recording: Recording, topic: str) -> None:
        filtered = (topic, IMU_TYPE)
        ids = [c.id for c in recording.connections if (c.topic, c.msgtype) == filtered]
        self.is_there = bool(ids)
        self._is_filtered = are_among(recording, ids)
        self._times = Stored(np.int64)
        self._rates = stored_columns(3)

    def take(self, piece: Piece) -> None:
        """Take a piece of the recording in."""
        for part in small_parts(piece) if self.is_there else ():
            imus = read_imus(part, self._is_filtered)
            good = imus[imus['kind'] == ImuKind.GOOD]
            self._times.append(part.rows['log_time'][good['row']])
            append_rows(self._rates, good['sample']['angular_velocity'])

    def beside(self, signals: Signals, start: int) -> Recorded | None:
        """Return it beside what a filter makes, None without any; `start` is a log time in ns."""
        if not (len(self._times) and isinstance(signals, _ExactSignals)):
            return None
        rates, ours = stacked(self._rates), stacked(signals.exact)
        times = (np.asarray(self._times) - start) * 1e-9
        return Recorded(times, rates, np.array_equal(rates, ours))


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
    signals: dict[str, Signals] = {}
    with open_bag(bag) as recording:
        inputs = selection.inputs(recording)
        (names,) = inputs.values()
        filtered = _FilteredTopic(recording, names.filtered)

        def watched(topic: str, filter_: Filter) -> Signals:
            """Return who keeps the signals of a method, all those of the first one."""
            if signals:
                kept = Signals(filter_, COMPARED)
            else:
                kept = _ExactSignals(filter_) if filtered.is_there else Signals(filter_)
            return signals.setdefault(filter_.parameters.method, kept)

        runs = [ReplayRun(recording, NoOutput(1), p, inputs, watched) for p in parameters]
        for piece in selection.pieces(recording, progress):
            for run in runs:
                run.take(piece)
            filtered.take(piece)
        all_summaries = [run.finish()[0] for run in runs]
        count = recording.message_count
    # Nothing is written here: what went in would be.
    summaries = {
        method: replace(summary, written=summary.received)
        for method, summary in zip(signals, all_summaries, strict=True)
    }
    main, summary = next(iter(signals.values())), all_summaries[0]
    if not len(main.log_times):
        raise BagError(why_nothing(summary, selection.when))
    recorded = filtered.beside(main, summary.start)
    frame = runs[0].filters[0].messages.report().frame
    return Filtered(signals, summaries, recorded, frame, count)


def read_flagged(
    bag: Path,
    parameters: Parameters,
    selection: Selection,
    progress: Callable[[int, int], None],
) -> tuple[Summary, FlaggedLog]:
    """Send one Imu topic of a recording through the filter; return what was done, and flagged.

    Raises:
        BagError: The bag can't be read, or holds no message with an angular velocity.
    """
    logs: list[FlaggedLog] = []

    def watched(topic: str, filter_: Filter) -> FlaggedLog:
        logs.append(FlaggedLog(filter_))
        return logs[-1]

    with open_bag(bag) as recording:
        inputs, hint = selection.inputs(recording), selection.hint_topic(recording)
        output = NoOutput(1)
        run = ReplayRun(recording, output, parameters, inputs, watched, hint, is_judged=False)
        for piece in selection.pieces(recording, progress):
            run.take(piece)
        (summary,) = run.finish()
    if not logs[0].samples:
        raise BagError(why_nothing(summary))
    return summary, logs[0]
