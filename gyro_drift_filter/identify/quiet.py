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

"""Where a recording is motionless, judged against the sensor's own noise.

The recording is cut at gaps of its stamps, and the parts at one sample rate into windows of about a
second. A window is motionless if, on every axis of the gyroscope and of the accelerometer,

- the deviation of the samples about the window's mean is that of the quietest windows, and
- the mean has not moved from that of the window before by more than the noise moves it.

For the accelerometer the mean of three windows is compared with the one ten windows before as
well, so that gravity shows a turn that is too slow for the gyroscope's noise. Isolated outliers are
taken out first; two in a row count as a knock. A window beside a moving one is left out too, as
a motion begins and ends gently. There is no limit in rad/s: only ratios to the noise.

Noise that changes as slowly as a body moves, as that of a phone's filter at 10 Hz, is told from
motion by gravity: a turn moves it by as much as the rates say, noise does not (`slow_noise.py`).
Windows are longer then, so that the means of the sensor's own noise stay.

What can't be told: a constant slow turn about the vertical, which moves neither gravity nor the
rate, if the recording has no rest beside it to compare with; and vibration or sway of a few times
the noise that lasts throughout, which is noise to this code.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.identify.series import Values, columns, parts
from gyro_drift_filter.identify.slow_noise import Cause, is_smooth, judge_slow_rates
from gyro_drift_filter.identify.timing import Timing
from gyro_drift_filter.identify.windows import AxisNoise, Windows, cut, measure_noise, step_limit

WINDOW_SECONDS = 1.0
LEAST_WINDOW = 16  # samples
# Shorter stretches are not used: their ends are motion settling.
SHORTEST_SECONDS = 5.0
# All stretches together, in s: less does not tell the noise.
SHORTEST_QUIET = 20.0
# Gravity is compared over this many windows, in means of so many.
SLOW_WINDOWS, SLOW_MEAN = 10, 3
# Of a turn about the vertical a gyroscope may see this share across it, as its axes are those of
# the accelerometer to some degrees only.
ALIGNED = 0.1
# An accelerometer whose deviation is below this share of its mean does not measure.
DEAD_ACCELEROMETER = 1e-9


@dataclass(frozen=True)
class SampleSpan:
    """A stretch of samples: `first` up to, and without, `stop`."""

    first: int
    stop: int

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.stop - self.first


@dataclass(frozen=True)
class OtherRate:
    """A quiet stretch whose rate is another one than that of the rests beside it.

    Attributes:
        span: Where it is.
        step: (3,) by how much the rate is another one, in rad/s.
        turns_not: True where gravity stood though the step would have tilted it: the bias is
            another one there. False where it may as well be a slow turn.
    """

    span: SampleSpan
    step: tuple[float, ...]
    turns_not: bool


@dataclass(frozen=True)
class Quiet:
    """Where a recording is motionless.

    Attributes:
        spans: The stretches that are long enough, in order.
        longest: The longest stretch, long enough or not; None where nothing is quiet.
        missing: Samples with a rate that is not finite, in the whole recording.
        noise: (3,) deviation of the rate within a motionless window in rad/s.
        accelerometer: True where the accelerometer could be used.
        other_rates: Stretches that are quiet and long enough, but no part of `spans`, in order.
        open: True where even the quietest rates change as slowly as those of a body, and nothing
            tells whether that is the sensor's own filter.
    """

    spans: tuple[SampleSpan, ...]
    longest: SampleSpan | None
    missing: int
    noise: tuple[float, ...]
    accelerometer: bool
    other_rates: tuple[OtherRate, ...]
    open: bool


def find_quiet(
    timing: Timing,
    rates: Floats | tuple[Values, ...],
    accelerations: Floats | tuple[Values, ...],
) -> Quiet:
    """Return the motionless stretches of five seconds or more, and what was seen besides.

    Args:
        timing: Of the n samples.
        rates: (n, 3) in rad/s, or its columns; may hold NaN.
        accelerations: (n, 3) in m/s^2, or its columns; zeros or NaN where there is no
            accelerometer.
    """
    rates, accelerations = columns(rates), columns(accelerations)
    period, n = timing.period, len(rates[0])
    missing = sum(
        int((~np.isfinite(np.column_stack(samples)).all(axis=1)).sum())
        for samples in zip(*map(parts, rates), strict=True)
    )
    size = max(LEAST_WINDOW, round(WINDOW_SECONDS / period))
    windows = cut(timing.parts(n), size)
    if not len(windows.first):
        nothing = (0.0, 0.0, 0.0)
        return Quiet((), None, missing, nothing, accelerometer=False, other_rates=(), open=False)
    # An acceleration that is partly NaN beside good rates says nothing about the rates.
    measured = tuple(axis for axis in accelerations if _measures(axis))
    axes = (*rates, *measured)
    noises = [measure_noise(axis, windows, period) for axis in axes]
    smooth, cause = any(map(is_smooth, noises[:3])), Cause.OPEN
    if len(measured) in (0, 3):
        cause, longer = judge_slow_rates(noises, windows, axes, timing)
        if cause == Cause.NOISE:
            windows, noises = longer
    still = np.full(len(windows.first), not smooth or cause == Cause.NOISE)
    for noise in noises[:3]:
        still &= noise.steady
    for noise in noises[3:]:
        still &= noise.steady & _gravity_stands(noise, windows, still & noise.steady)
    stretches = _join(_shrink(still, windows), windows)
    longest = max(stretches, key=len, default=None)
    spans = [span for span in stretches if len(span) * period >= SHORTEST_SECONDS]
    spans, others = _same_rate(spans, windows, noises, period)
    return Quiet(
        spans=tuple(spans),
        longest=longest,
        missing=missing,
        noise=tuple(noise.level for noise in noises[:3]),
        accelerometer=bool(measured),
        other_rates=tuple(others),
        open=cause == Cause.OPEN,
    )


def _measures(values: Values) -> bool:
    """Tell whether an axis of an accelerometer is there and alive."""
    count, lowest, highest = 0, np.inf, -np.inf
    for part in parts(values):
        finite = part[np.isfinite(part)]
        if len(finite):
            count += len(finite)
            lowest, highest = min(lowest, finite.min()), max(highest, finite.max())
    if count < 0.5 * len(values) or not count:
        return False
    return bool(highest - lowest > DEAD_ACCELEROMETER * max(abs(lowest), abs(highest), 1e-300))


def _gravity_stands(noise: AxisNoise, windows: Windows, still: Bools) -> Bools:
    """Tell where an axis of the accelerometer has stayed over ten windows, (w,)."""
    stands = np.ones(len(still), bool)
    reach = SLOW_WINDOWS + SLOW_MEAN
    if len(still) < reach:
        return stands
    smooth = np.convolve(noise.mean, np.full(SLOW_MEAN, 1.0 / SLOW_MEAN), 'valid')
    step = np.abs(smooth[SLOW_WINDOWS:] - smooth[:-SLOW_WINDOWS])
    # Only where all windows in between are still, so that a span's ends do not suffer for others.
    run = np.convolve(still, np.ones(reach), 'valid')[: len(step)] > reach - 0.5
    run &= windows.part[reach - 1 :] == windows.part[: len(step)]
    if not run.any():
        return stands
    limit = step_limit(step[run], noise.level, windows)
    for k in np.flatnonzero(run & (step > limit)):
        stands[k : k + reach] = False
    return stands


def _shrink(still: Bools, windows: Windows) -> Bools:
    """Take away the windows that lie beside a moving one within the same part."""
    out = still.copy()
    same = np.diff(windows.part) == 0
    out[1:] &= still[:-1] | ~same
    out[:-1] &= still[1:] | ~same
    return out


def _join(still: Bools, windows: Windows) -> list[SampleSpan]:
    """Return runs of still windows within the same part as spans."""
    spans: list[SampleSpan] = []
    part = -1
    for k in np.flatnonzero(still):
        first, stop = int(windows.first[k]), int(windows.stop[k])
        if spans and spans[-1].stop == first and part == windows.part[k]:
            spans[-1] = SampleSpan(spans[-1].first, stop)
        else:
            spans.append(SampleSpan(first, stop))
        part = int(windows.part[k])
    return spans


def _same_rate(
    spans: list[SampleSpan], windows: Windows, noises: Sequence[AxisNoise], period: float
) -> tuple[list[SampleSpan], list[OtherRate]]:
    """Leave out spans whose rate is another than that of the accepted one beside them.

    A turn at constant rate between two rests is quiet in itself. The longest span is taken as
    rest, and the others are compared outwards from it. Those that are left out come second.
    """
    if not spans:
        return spans, []
    longest = spans.index(max(spans, key=len))
    means = np.array([noise.mean for noise in noises])
    limits = np.array([noise.limit for noise in noises])
    others: list[OtherRate] = []

    def end_mean(span: SampleSpan, *, last: bool) -> Floats:
        inside = _inside(span, windows)
        near = inside[-SLOW_WINDOWS:] if last else inside[:SLOW_WINDOWS]
        return np.asarray(np.median(means[:3, near], axis=1))

    def walk(following: list[SampleSpan], *, forward: bool) -> list[SampleSpan]:
        kept, reference = [], spans[longest]
        for span in following:
            step = end_mean(span, last=not forward) - end_mean(reference, last=forward)
            if (np.abs(step) <= limits[:3]).all():
                kept.append(span)
                reference = span
            else:
                gravity = means[3:, _inside(span, windows)]
                stood = _stood(gravity, limits, step, len(span) * period)
                others.append(OtherRate(span, tuple(step.tolist()), stood))
        return kept

    before = walk(spans[:longest][::-1], forward=False)[::-1]
    kept = [*before, spans[longest], *walk(spans[longest + 1 :], forward=True)]
    return kept, sorted(others, key=lambda other: other.span.first)


def _inside(span: SampleSpan, windows: Windows) -> Integers:
    """Return the indices of the windows of a span."""
    return np.flatnonzero((windows.first >= span.first) & (windows.stop <= span.stop))


def _stood(gravity: Floats, limits: Floats, rate: Floats, seconds: float) -> bool:
    """Tell whether gravity (3, w), which a turn by the rate would have tilted, did not follow.

    A turn about the vertical does not tilt it, and leaves the question open. `limits` (6,) are how
    far means of the noise lie apart, of the rates and of gravity.
    """
    half = gravity.shape[1] // 2
    if len(gravity) != 3 or not half:
        return False
    before, behind = np.median(gravity[:, :half], axis=1), np.median(gravity[:, -half:], axis=1)
    down = 0.5 * (before + behind)
    across = np.linalg.norm(np.cross(rate, down)) / np.linalg.norm(down)
    if across < max(limits[:3].max(), ALIGNED * np.linalg.norm(rate)):
        return False
    # The middles of the halves are half of the time apart.
    tilt = across * np.linalg.norm(down) * 0.5 * seconds
    visible = tilt > np.linalg.norm(limits[3:])
    return bool(visible and np.linalg.norm(behind - before) < 0.5 * tilt)
