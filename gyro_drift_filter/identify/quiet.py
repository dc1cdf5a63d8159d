"""Where a recording is motionless, judged against the sensor's own noise.

The recording is cut at gaps of its stamps, and the parts into windows of about a second. A window
is motionless if, on every axis of the gyroscope and of the accelerometer,

- the deviation of the samples about the window's mean is that of the quietest windows, and
- the mean has not moved from that of the window before by more than the noise moves it.

For the accelerometer the mean of three windows is compared with the one ten windows before as
well, so that gravity shows a turn that is too slow for the gyroscope's noise. Isolated outliers are
taken out first; two in a row count as a knock. A window beside a moving one is left out too, as
a motion begins and ends gently. There is no limit in rad/s: only ratios to the noise.

What can't be told: a constant slow turn about the vertical, which moves neither gravity nor the
rate, if the recording has no rest beside it to compare with; and vibration or sway of a few times
the noise that lasts throughout, which is noise to this code.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.identify.blocks import block_rows, row_means, row_medians
from gyro_drift_filter.identify.timing import Timing

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

WINDOW_SECONDS = 1.0
LEAST_WINDOW = 16  # samples
# Shorter stretches are not used: their ends are motion settling.
SHORTEST_SECONDS = 5.0

# Share of windows that are taken as the quietest, and their least number.
QUIETEST_SHARE, QUIETEST_WINDOWS = 0.05, 5
# A window counts as noise up to this many spreads above the level, within these ratios to it.
SPREADS = 6.0
LEAST_RATIO, LARGEST_RATIO = 1.35, 3.0
# Limit of a step between means in noise deviations: AR(1) noise of 0.9 at 100 Hz reaches 3.
LARGEST_STEP = 3.5
# A spike: this many deviations off the median of itself and its neighbours.
SPIKE = 6.0
# Share of a window's largest deviations that the first look at the noise leaves out.
TRIMMED = 0.05
# Gravity is compared over this many windows, in means of so many.
SLOW_WINDOWS, SLOW_MEAN = 10, 3
# Motion of a body is smooth over this time, noise is not: where the quietest windows have a
# smaller share of their variance in differences than this, they are motion too.
SMOOTH_SECONDS = 0.02
LEAST_ROUGHNESS = 0.08
# Where this share of the samples holds one value, the sensor's step hides its noise.
STILL_SHARE = 0.3
# An accelerometer whose deviation is below this share of its mean does not measure.
DEAD_ACCELEROMETER = 1e-9


@dataclass(frozen=True)
class Span:
    """A stretch of samples: `first` up to, and without, `stop`."""

    first: int
    stop: int

    def __len__(self) -> int:
        """Return the number of samples."""
        return self.stop - self.first


@dataclass(frozen=True)
class Quiet:
    """Where a recording is motionless.

    Attributes:
        spans: The stretches that are long enough, in order.
        longest: The longest stretch, long enough or not; None where nothing is quiet.
        missing: Samples with a rate that is not finite, in the whole recording.
        noise: (3,) deviation of the rate within a motionless window in rad/s.
        accelerometer: True where the accelerometer could be used.
    """

    spans: tuple[Span, ...]
    longest: Span | None
    missing: int
    noise: tuple[float, float, float]
    accelerometer: bool


@dataclass(frozen=True)
class _Windows:
    """Borders of windows, w of them: sample indices, and the part between gaps that each is in."""

    first: Integers  # (w,)
    stop: Integers  # (w,)
    part: Integers  # (w,)


def find_quiet(timing: Timing, rates: Floats, accelerations: Floats) -> Quiet:
    """Return the motionless stretches of five seconds or more, and what was seen besides.

    Args:
        timing: Of the n samples.
        rates: (n, 3) in rad/s; may hold NaN.
        accelerations: (n, 3) in m/s^2; zeros or NaN where there is no accelerometer.
    """
    period = timing.period
    missing = int((~np.isfinite(rates).all(axis=1)).sum())
    breaks = np.flatnonzero(timing.gaps) + 1
    windows = _cut(len(rates), breaks, max(LEAST_WINDOW, round(WINDOW_SECONDS / period)))
    if not len(windows.first):
        return Quiet((), None, missing, (0.0, 0.0, 0.0), False)
    lag = max(1, round(SMOOTH_SECONDS / period))
    # An acceleration that is partly NaN beside good rates says nothing about the rates.
    measured = [axis for axis in range(3) if _measures(accelerations[:, axis])]
    still = np.ones(len(windows.first), bool)
    noise, means, limits = [], [], []
    for axis in range(3):
        mean, level, limit, fits = _judge(rates[:, axis], windows, lag, smooth_is_motion=True)
        still &= fits
        noise.append(level)
        means.append(mean)
        limits.append(limit)
    for axis in measured:
        mean, level, _, fits = _judge(accelerations[:, axis], windows, lag, smooth_is_motion=False)
        still &= fits & _gravity_stands(mean, level, windows, still & fits)
    stretches = _join(_shrink(still, windows), windows)
    longest = max(stretches, key=len, default=None)
    spans = [span for span in stretches if len(span) * period >= SHORTEST_SECONDS]
    spans = _same_rate(spans, windows, np.array(means), np.array(limits))
    return Quiet(
        tuple(spans),
        longest,
        missing,
        (noise[0], noise[1], noise[2]),
        bool(measured),
    )


def _cut(n: int, breaks: Integers, size: int) -> _Windows:
    """Cut n samples at the breaks, and each part into windows of `size` samples or a bit more."""
    borders = [0, *breaks.tolist(), n]
    first, stop, part = [], [], []
    for index, (begin, end) in enumerate(pairwise(borders)):
        count = (end - begin) // size
        edges = begin + (np.arange(count + 1) * (end - begin)) // max(count, 1)
        first.append(edges[:-1])
        stop.append(edges[1:])
        part.append(np.full(count, index))
    return _Windows(*(np.concatenate(x).astype(np.int64) for x in (first, stop, part)))


def _measures(values: Floats) -> bool:
    finite = values[np.isfinite(values)]
    if len(finite) < 0.5 * len(values):
        return False
    return bool(np.std(finite) > DEAD_ACCELEROMETER * max(float(np.abs(finite).max()), 1e-300))


def _judge(
    values: Floats, windows: _Windows, lag: int, smooth_is_motion: bool
) -> tuple[Floats, float, float, Bools]:
    """Return of one axis: means (w,), noise level, limit of a step, and which windows fit (w,)."""
    values = np.where(np.isfinite(values), values, np.nan)
    # A coarse or dead-banded sensor stands still at rest: one of its steps counts as its noise.
    step_size = _step_of_still_sensor(values)
    first_level = max(_level(_trimmed_deviations(values, windows))[0], step_size)
    clean = _without_spikes(values, SPIKE * first_level)
    rows = block_rows(clean, windows.first, windows.stop)
    mean, deviation, enough = _statistics(rows, windows)
    level, limit = _level(deviation[enough])
    level, limit = max(level, step_size), max(limit, LEAST_RATIO * step_size)
    calm = enough & (deviation <= limit)
    fits = calm.copy()
    if smooth_is_motion and _is_smooth(rows[calm], deviation[calm], lag):
        fits[:] = False
    step = np.abs(np.diff(mean))
    neighbours = np.diff(windows.part) == 0
    step_limit = _step_limit(step[neighbours & calm[1:] & calm[:-1]], level, windows)
    jump = neighbours & calm[1:] & calm[:-1] & (step > step_limit)
    # Which of the two moves is open: both are left out.
    fits[1:] &= ~jump
    fits[:-1] &= ~jump
    return mean, level, step_limit, fits


def _step_of_still_sensor(values: Floats) -> float:
    """Return the smallest distance from the median, 0 where few samples are equal to it."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return 0.0
    distance = np.abs(finite - np.median(finite))
    moved = distance[distance > 0.0]
    if not len(moved) or len(moved) > (1.0 - STILL_SHARE) * len(distance):
        return 0.0
    return float(moved.min())


def _trimmed_deviations(values: Floats, windows: _Windows) -> Floats:
    """Return the deviation of each window without its farthest samples; nearly empty ones not."""
    rows = block_rows(values, windows.first, windows.stop)
    count = np.isfinite(rows).sum(axis=1)
    rows, count = rows[count > 1], count[count > 1]
    squares = np.sort((rows - row_medians(rows)[:, None]) ** 2, axis=1)
    kept = np.maximum(1, ((1.0 - TRIMMED) * count).astype(int))
    squares[np.arange(squares.shape[1]) >= kept[:, None]] = np.nan
    return np.sqrt(row_means(squares))


def _level(deviations: Floats) -> tuple[float, float]:
    """Return the noise level among windows, most of which may be motion, and the limit for it."""
    if not len(deviations):
        return 0.0, 0.0
    ordered = np.sort(deviations)
    count = max(QUIETEST_WINDOWS, round(QUIETEST_SHARE * len(ordered)))
    level = float(np.median(ordered[:count]))
    limit = LEAST_RATIO * level
    # From the quietest windows the level climbs to the middle of all that are like them.
    for _ in range(20):
        like = ordered[ordered <= limit]
        level = float(np.median(like)) if len(like) else level
        spread = 1.4826 * float(np.median(np.abs(like - level))) if len(like) else 0.0
        ratio = 1.0 + SPREADS * spread / level if level else LEAST_RATIO
        new = level * min(max(ratio, LEAST_RATIO), LARGEST_RATIO)
        if new <= limit:
            break
        limit = new
    return level, limit


def _without_spikes(values: Floats, size: float) -> Floats:
    """Return a copy in which a sample that stands off both neighbours is their median."""
    out = values.copy()
    if len(values) < 3 or size <= 0.0:
        return out
    before, here, after = values[:-2], values[1:-1], values[2:]
    low, high = np.minimum(before, after), np.maximum(before, after)
    median = np.clip(here, low, high)
    spike = np.abs(here - median) > size
    out[1:-1][spike] = median[spike]
    return out


def _statistics(rows: Floats, windows: _Windows) -> tuple[Floats, Floats, Bools]:
    """Return means and deviations of the windows, and which have half their samples or more."""
    mean = row_means(rows)
    deviation = np.sqrt(row_means((rows - mean[:, None]) ** 2))
    count = np.isfinite(rows).sum(axis=1)
    return mean, deviation, count >= 0.5 * (windows.stop - windows.first)


def _is_smooth(rows: Floats, deviation: Floats, lag: int) -> bool:
    """Tell whether the quietest windows are themselves smooth motion, not noise."""
    if rows.shape[1] <= lag:
        return False
    differences = row_means((rows[:, lag:] - rows[:, :-lag]) ** 2)
    moving = (deviation > 0.0) & np.isfinite(differences)
    roughness = 0.5 * differences[moving] / deviation[moving] ** 2
    return bool(len(roughness)) and float(np.median(roughness)) < LEAST_ROUGHNESS


def _step_limit(steps: Floats, level: float, windows: _Windows) -> float:
    """Return how far two neighbouring means may lie apart."""
    size = float(np.median(windows.stop - windows.first))
    white = SPREADS * level * np.sqrt(2.0 / size)
    seen = SPREADS * 1.4826 * float(np.median(steps)) if len(steps) else 0.0
    return float(max(white, min(seen, LARGEST_STEP * level)))


def _gravity_stands(mean: Floats, level: float, windows: _Windows, still: Bools) -> Bools:
    """Tell where an axis of the accelerometer has stayed over ten windows, (w,)."""
    stands = np.ones(len(mean), bool)
    reach = SLOW_WINDOWS + SLOW_MEAN
    if len(mean) < reach:
        return stands
    smooth = np.convolve(mean, np.full(SLOW_MEAN, 1.0 / SLOW_MEAN), 'valid')
    step = np.abs(smooth[SLOW_WINDOWS:] - smooth[:-SLOW_WINDOWS])
    # Only where all windows in between are still, so that a span's ends do not suffer for others.
    run = np.convolve(still, np.ones(reach), 'valid')[: len(step)] > reach - 0.5
    run &= windows.part[reach - 1 :] == windows.part[: len(step)]
    if not run.any():
        return stands
    limit = _step_limit(step[run], level, windows)
    for k in np.flatnonzero(run & (step > limit)):
        stands[k : k + reach] = False
    return stands


def _shrink(still: Bools, windows: _Windows) -> Bools:
    """Take away the windows that lie beside a moving one within the same part."""
    out = still.copy()
    same = np.diff(windows.part) == 0
    out[1:] &= still[:-1] | ~same
    out[:-1] &= still[1:] | ~same
    return out


def _join(still: Bools, windows: _Windows) -> list[Span]:
    """Return runs of still windows within the same part as spans."""
    spans: list[Span] = []
    part = -1
    for k in np.flatnonzero(still):
        first, stop = int(windows.first[k]), int(windows.stop[k])
        if spans and spans[-1].stop == first and part == windows.part[k]:
            spans[-1] = Span(spans[-1].first, stop)
        else:
            spans.append(Span(first, stop))
        part = int(windows.part[k])
    return spans


def _same_rate(spans: list[Span], windows: _Windows, means: Floats, limits: Floats) -> list[Span]:
    """Leave out spans whose rate is another than that of the accepted one beside them.

    A turn at constant rate between two rests is quiet in itself. The longest span is taken as
    rest, and the others are compared outwards from it.
    """
    if not spans:
        return spans
    longest = spans.index(max(spans, key=len))

    def end_mean(span: Span, last: bool) -> Floats:
        inside = np.flatnonzero((windows.first >= span.first) & (windows.stop <= span.stop))
        near = inside[-SLOW_WINDOWS:] if last else inside[:SLOW_WINDOWS]
        return np.asarray(np.median(means[:, near], axis=1))

    def walk(others: list[Span], forward: bool) -> list[Span]:
        kept, reference = [], spans[longest]
        for span in others:
            step = np.abs(end_mean(span, not forward) - end_mean(reference, forward))
            if (step <= limits).all():
                kept.append(span)
                reference = span
        return kept

    before = walk(spans[:longest][::-1], forward=False)[::-1]
    return [*before, spans[longest], *walk(spans[longest + 1 :], forward=True)]
