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

"""The samples that were flagged as outliers: why, and what the ones after them showed.

Of those that were not flagged, but for which something else held than the limits, how many there
are, and why.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.arrays import Bools, Integers
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.methods import METHODS, WITHIN_LIMITS
from gyro_drift_filter.core.sample import STARTED
from gyro_drift_filter.messages.imu import are_filtered
from gyro_drift_filter.messages.outlier_reason import reason_name, reason_text
from gyro_drift_filter.messages.rules import Rule
from gyro_drift_filter.messages.span import Span


@dataclass
class FlaggedSequence:
    """Samples in a row, of one axis, that were flagged.

    Attributes:
        axis: 0, 1 or 2.
        log_time: Of the first one, in ns.
        number: Of the first one, as messages with a rate are counted from 0 on.
        samples: How many.
        rate: The first one as it came, rad/s.
        innovation: The first one minus its prediction, rad/s; 0 where it was no usable number.
        deviation: The standard deviation that was expected of the innovation, rad/s.
        reason: Why the first one was flagged.
        outcome: What the next sample showed; None where the recording ends before it.
        reason_name: What the code calls the reason.
        outcome_name: What the code calls the outcome.
        innovation_threshold: What the size of the innovation had to exceed by `outlier.threshold`,
            rad/s; None where there was no such limit.
        least_jump: What it had to exceed by what a body can do, likewise.
    """

    axis: int
    log_time: int
    number: int
    samples: int
    rate: float
    innovation: float
    deviation: float
    reason: str
    outcome: str | None = None
    reason_name: str = ''
    outcome_name: str | None = None
    innovation_threshold: float | None = None
    least_jump: float | None = None


@dataclass
class UnflaggedSamples:
    """All samples of one axis that were not flagged, but not just within the limits either.

    Attributes:
        axis: 0, 1 or 2.
        reason: What was decided of them, and why.
        reason_name: What the code calls the reason.
        samples: How many.
        first: Log time of the first one, in ns.
        last: And of the last one.
        longest: The most in a row.
        longest_start: Log time of the first one of these.
    """

    axis: int
    reason: str
    reason_name: str
    samples: int
    first: int
    last: int
    longest: int
    longest_start: int


class FlaggedLog:
    """Sees what goes through a filter, and keeps what was flagged.

    Attributes:
        samples: How many have gone through the filter, flagged or not.
        sequences: In the order of their first samples.
    """

    def __init__(self, filter_: Filter) -> None:
        """Start with a filter that has seen nothing yet."""
        self.samples = 0
        self.sequences: list[FlaggedSequence] = []
        (method,) = (m for m in METHODS if m.name == filter_.parameters.method)
        self._method = method.name
        self._unmeasured = list(method.unmeasured)
        self._open: list[FlaggedSequence | None] = [None, None, None]
        # By axis and reason: the numbers of the samples, and their log times.
        self._unflagged: dict[tuple[int, int], list[tuple[NDArray[Any], NDArray[Any]]]] = {}

    def take(self, imus: Any, log_times: Integers) -> None:
        """See messages (n,) IMU that were filtered, with their log times (n,) in ns."""
        kept = are_filtered(imus)
        before = self.samples
        self.samples += int(kept.sum())
        result, times = imus['result'][kept], log_times[kept]
        rates = imus['sample']['angular_velocity'][kept]
        flagged = result['outlier'] > 0.0
        judged = flagged | ~np.isin(result['reason'], self._unmeasured)
        for axis in range(3):
            rows = np.flatnonzero(judged[:, axis])
            # Beside the flagged ones, those that come right behind one.
            ends = np.append(self._open[axis] is not None, flagged[rows[:-1], axis])[: len(rows)]
            listed = flagged[:, axis].copy()
            listed[rows[ends]] = True
            self._note_unflagged(axis, result['reason'][:, axis], listed, times, before)
            for row in rows[flagged[rows, axis] | ends].tolist():
                if flagged[row, axis]:
                    rate = float(rates[row, axis])
                    self._add(axis, before + row, int(times[row]), rate, result[row])
                else:
                    self._close(axis, int(result['reason'][row, axis]))
        self.sequences.sort(key=lambda sequence: sequence.log_time)

    def _note_unflagged(
        self,
        axis: int,
        reasons: Integers,
        listed: Bools,
        times: Integers,
        before: int,
    ) -> None:
        """Note samples with a reason of their own that are `listed` in no sequence."""
        own = ~listed & (reasons != STARTED) & (reasons != WITHIN_LIMITS)
        for reason in np.unique(reasons[own]).tolist():
            rows = np.flatnonzero(own & (reasons == reason))
            self._unflagged.setdefault((axis, reason), []).append((before + rows, times[rows]))

    def unflagged(self, origin: int, begin: float, end: float) -> list[UnflaggedSamples]:
        """Return what is not in `sequences`, by reason and axis, from `begin` to `end`.

        Both are in s after `origin`, a log time in ns.
        """
        found = []
        for (axis, reason), parts in sorted(
            self._unflagged.items(), key=lambda item: item[0][::-1]
        ):
            numbers, times = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
            seconds = 1e-9 * (times - origin)
            within = (seconds >= begin) & (seconds <= end)
            numbers, times = numbers[within], times[within]
            if len(times) == 0:
                continue
            starts = np.flatnonzero(np.append(True, np.diff(numbers) > 1))
            lengths = np.diff(np.append(starts, len(numbers)))
            longest = int(lengths.argmax())
            found.append(
                UnflaggedSamples(
                    axis=axis,
                    reason=reason_text(self._method, reason),
                    reason_name=reason_name(self._method, reason),
                    samples=len(times),
                    first=int(times[0]),
                    last=int(times[-1]),
                    longest=int(lengths[longest]),
                    longest_start=int(times[starts[longest]]),
                )
            )
        return found

    def judge(self, span: Span, rules: Sequence[Rule], seconds: float) -> None:
        """Pass over the reports, of which there are none where a recording is explained."""

    def _add(self, axis: int, number: int, log_time: int, rate: float, result: Any) -> None:
        sequence = self._open[axis]
        if sequence is not None:
            sequence.samples += 1
            return
        reason = int(result['reason'][axis])
        sequence = FlaggedSequence(
            axis=axis,
            log_time=log_time,
            number=number,
            samples=1,
            rate=rate,
            innovation=float(result['innovation'][axis]),
            deviation=math.sqrt(result['innovation_variance'][axis]),
            reason=reason_text(self._method, reason),
            reason_name=reason_name(self._method, reason),
            innovation_threshold=float(result['innovation_threshold'][axis]) or None,
            least_jump=float(result['least_jump'][axis]) or None,
        )
        self._open[axis] = sequence
        self.sequences.append(sequence)

    def _close(self, axis: int, reason: int) -> None:
        sequence = self._open[axis]
        if sequence is not None:
            sequence.outcome = reason_text(self._method, reason)
            sequence.outcome_name = reason_name(self._method, reason)
        self._open[axis] = None
