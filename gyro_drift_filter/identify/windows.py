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

"""A recording cut into windows, and the noise of one axis in them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.identify.blocks import (
    PER_MEDIAN_DEVIATION,
    block_rows,
    row_means,
    row_medians,
)
from gyro_drift_filter.identify.series import Values

# Share of windows that are taken as the quietest, and their least number.
QUIETEST_SHARE, QUIETEST_WINDOWS = 0.05, 5
# A window counts as noise up to this many spreads above the level, within these ratios to it.
SPREADS = 6.0
LEAST_RATIO, LARGEST_RATIO = 1.35, 3.0
# Limit of a step between means in noise deviations: AR(1) noise of 0.9 at 100 Hz reaches 3.
LARGEST_STEP = 3.5
# A spike: this many deviations off the median of itself and its neighbours.
SPIKE = 6.0
# Share of a window's largest deviations that the first level of the noise leaves out.
TRIMMED = 0.05
# Where this share of the samples holds one value, the sensor's step hides its noise.
STILL_SHARE = 0.3
# Motion of a body is smooth over this time, noise is not.
SMOOTH_SECONDS = 0.02
# Noise that has forgotten itself within this part of a window gives it independent samples enough.
MEMORY_SHARE = 8
# Samples that are worked on together, to bound the memory.
_GROUP = 1 << 18


@dataclass(frozen=True)
class Windows:
    """Borders of windows, w of them: sample indices, and the part between gaps that each is in."""

    first: Integers  # (w,)
    stop: Integers  # (w,)
    part: Integers  # (w,)
    size: int  # samples, which each window has at least

    def groups(self) -> Iterator[slice]:
        """Yield runs of windows, each of which can be worked on at once."""
        count = max(1, _GROUP // self.size)
        for k in range(0, len(self.first), count):
            yield slice(k, min(k + count, len(self.first)))


@dataclass(frozen=True)
class AxisNoise:
    """The noise of one axis, as w windows show it.

    Attributes:
        mean: (w,).
        level: Deviation of the noise within a window.
        limit: How far two neighbouring means may lie apart.
        calm: (w,) which windows hold no more than that noise.
        steady: (w,) which of these have a mean that stays, too.
        roughness: Variance of the differences over `SMOOTH_SECONDS`, halved, over that of the
            samples; median of the calm windows. 1 is white, and 0 a straight line; NaN where
            nothing changes.
        slow_roughness: The same over an eighth of a window.
    """

    mean: Floats
    level: float
    limit: float
    calm: Bools
    steady: Bools
    roughness: float
    slow_roughness: float


def cut(parts: Sequence[tuple[int, int]], size: int) -> Windows:
    """Cut parts, from a first sample to before another, into windows of `size` or a bit more."""
    first, stop, part = [], [], []
    for index, (begin, end) in enumerate(parts):
        count = (end - begin) // size
        edges = begin + (np.arange(count + 1) * (end - begin)) // max(count, 1)
        first.append(edges[:-1])
        stop.append(edges[1:])
        part.append(np.full(count, index))
    return Windows(np.concatenate(first), np.concatenate(stop), np.concatenate(part), size)


def rows_of(values: Values, windows: Windows, group: slice) -> Floats:
    """Return the finite samples of w windows, filled up with NaN: (w, those of the longest)."""
    return _rows(_load(values, windows, group, 0), windows, group)


def measure_noise(values: Values, windows: Windows, period: float) -> AxisNoise:
    """Measure the noise of one axis; isolated spikes are taken out.

    Args:
        values: (n,); may hold NaN.
        windows: Of the n samples.
        period: In s.
    """
    groups = list(windows.groups())
    first_level, step_size = _first_level(values, windows, groups)
    lags = max(1, round(SMOOTH_SECONDS / period)), max(1, windows.size // MEMORY_SHARE)
    found = []
    for group in groups:
        samples = _without_spikes(_load(values, windows, group, 1), SPIKE * first_level)
        found.append(_statistics(_rows(samples, windows, group), windows, group, lags))
    mean, deviation, enough, *roughness = (np.concatenate(x) for x in zip(*found, strict=True))
    level, limit = _level(deviation[enough])
    level, limit = max(level, step_size), max(limit, LEAST_RATIO * step_size)
    calm = enough & (deviation <= limit)
    step = np.abs(np.diff(mean))
    pairs = (np.diff(windows.part) == 0) & calm[1:] & calm[:-1]
    furthest = step_limit(step[pairs], level, windows)
    jump = pairs & (step > furthest)
    # Which of the two moves is open: both are left out.
    steady = calm.copy()
    steady[1:] &= ~jump
    steady[:-1] &= ~jump
    return AxisNoise(mean, level, furthest, calm, steady, *(_median(r[calm]) for r in roughness))


def _first_level(values: Values, windows: Windows, groups: Sequence[slice]) -> tuple[float, float]:
    """Return a first level of the noise, and the step that counts as noise, 0 without such a step.

    A coarse or dead-banded sensor stands still at rest: one of its steps counts as its noise.
    """
    trimmed, steps = [], []
    for group in groups:
        samples = _load(values, windows, group, 0)
        steps.append(_step_of_still_sensor(samples))
        trimmed.append(_trimmed_deviations(_rows(samples, windows, group)))
    step_size = min((step for step in steps if step), default=0.0)
    return max(_level(np.concatenate(trimmed))[0], step_size), step_size


def step_limit(steps: Floats, level: float, windows: Windows) -> float:
    """Return how far two neighbouring means may lie apart, by the steps (m,) of calm windows."""
    size = float(np.median(windows.stop - windows.first))
    white = SPREADS * level * np.sqrt(2.0 / size)
    seen = SPREADS * PER_MEDIAN_DEVIATION * float(np.median(steps)) if len(steps) else 0.0
    return float(max(white, min(seen, LARGEST_STEP * level)))


def _load(values: Values, windows: Windows, group: slice, around: int) -> Floats:
    """Return the samples of a group of windows, and so many on each side; NaN is what is not."""
    first, stop = int(windows.first[group][0]) - around, int(windows.stop[group][-1]) + around
    inside = values[max(first, 0) : stop]
    samples = np.full(stop - first, np.nan)
    offset = max(-first, 0)
    samples[offset : offset + len(inside)] = inside
    samples[~np.isfinite(samples)] = np.nan
    return samples


def _rows(samples: Floats, windows: Windows, group: slice) -> Floats:
    begin = windows.first[group][0]
    return block_rows(samples, windows.first[group] - begin, windows.stop[group] - begin)


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


def _trimmed_deviations(rows: Floats) -> Floats:
    """Return the deviation of each window without its farthest samples; nearly empty ones not."""
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
        spread = PER_MEDIAN_DEVIATION * float(np.median(np.abs(like - level))) if len(like) else 0.0
        ratio = 1.0 + SPREADS * spread / level if level else LEAST_RATIO
        new = level * min(max(ratio, LEAST_RATIO), LARGEST_RATIO)
        if new <= limit:
            break
        limit = new
    return level, limit


def _without_spikes(samples: Floats, size: float) -> Floats:
    """Return all but the first and last, those that stand off both neighbours as their median."""
    before, here, after = samples[:-2], samples[1:-1], samples[2:]
    # Beyond the ends of the recording, and beside a sample that is missing, there is no neighbour.
    median = np.clip(here, np.minimum(before, after), np.maximum(before, after))
    return np.where((np.abs(here - median) > size) & (size > 0.0), median, here)


def _statistics(
    rows: Floats, windows: Windows, group: slice, lags: Sequence[int]
) -> tuple[Floats, Floats, Bools, Floats, Floats]:
    """Return means, deviations, which have half their samples or more, roughness at both lags."""
    mean = row_means(rows)
    # The mean of equal numbers is off by rounding, which is no noise: it would be a smooth one.
    lowest = np.fmin.reduce(rows, axis=1)
    mean = np.where(lowest == np.fmax.reduce(rows, axis=1), lowest, mean)
    deviation = np.sqrt(row_means((rows - mean[:, None]) ** 2))
    count = np.isfinite(rows).sum(axis=1)
    enough = count >= 0.5 * (windows.stop - windows.first)[group]
    roughness = []
    for lag in lags:
        differences = row_means((rows[:, lag:] - rows[:, :-lag]) ** 2)
        with np.errstate(invalid='ignore', divide='ignore'):
            roughness.append(0.5 * differences / deviation**2)
    return mean, deviation, enough, roughness[0], roughness[1]


def _median(values: Floats) -> float:
    values = values[np.isfinite(values)]
    return float(np.median(values)) if len(values) else np.nan
