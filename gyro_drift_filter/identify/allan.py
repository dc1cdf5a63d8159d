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

"""Overlapping Allan deviation and the noise coefficients read from it.

After IEEE Std 952-2020, annex C: with the averaging time tau, sigma(tau) is

- N / sqrt(tau) where angle random walk rules (slope -1/2), N in rad/s/sqrt(Hz);
- 0.664 B at its minimum, where bias instability B rules, in rad/s;
- K sqrt(tau / 3) where rate random walk rules (slope +1/2), K in rad/s^2/sqrt(Hz).

Several spans are combined: at each tau, the variances of the spans long enough for it, weighted by
their number of overlapping differences. No difference reaches over a gap. Of a span of more than
a million samples, averages that are short against that are taken in parts, long ones over means of
as many samples as it takes to bring it below a million: differences overlap in such steps then.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import allantools
import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.series import LARGEST_PART, Stretch, Values, block_means, parts
from gyro_drift_filter.phrases import plain

TAUS_PER_DECADE = 12
# The longest tau fits this often into the longest span; fewer leave the deviation to chance.
LEAST_CLUSTERS = 8
LEAST_SAMPLES = 64
# Averages of a long span are taken in parts up to this share of a part.
_IN_PARTS = 64
BIAS_INSTABILITY = 0.664  # sqrt(2 ln 2 / pi)

# How far a slope may be off and still count as -1/2 or +1/2; slopes are read over half a decade.
SLOPE_TOLERANCE = 0.15
SLOPE_POINTS = 7
LEAST_POINTS = 4
ARW_SLOPE, RRW_SLOPE = -0.5, 0.5
# The minimum is known to be one where the curve rises by this much behind it.
RISE = 1.05


@dataclass(frozen=True)
class Coefficient:
    """A coefficient and the range of averaging times in s that it was read in."""

    value: float
    shortest: float
    longest: float


@dataclass(frozen=True)
class Allan:
    """Overlapping Allan deviation of one axis, at m averaging times.

    Attributes:
        taus: (m,) in s.
        deviations: (m,) in rad/s.
        counts: (m,) number of overlapping differences.
        angle_random_walk: N in rad/s/sqrt(Hz), the deviation at 1 s on the line of slope -1/2; None
            where no part of the curve has that slope.
        bias_instability: B in rad/s at the minimum; an upper bound where a warning says so.
        rate_random_walk: K in rad/s^2/sqrt(Hz); None where the curve does not rise so.
        warnings: One sentence each.
    """

    taus: Floats
    deviations: Floats
    counts: Integers
    angle_random_walk: Coefficient | None
    bias_instability: Coefficient
    rate_random_walk: Coefficient | None
    warnings: tuple[str, ...]

    @property
    def still_falls(self) -> bool:
        """Whether the minimum may lie at longer times: the bias instability is a bound then."""
        return _still_falls(self.deviations)

    def at(self, tau: float) -> float:
        """Return the deviation in rad/s at `tau` in s, on a straight line of logarithms.

        Raises:
            IdentificationError: `tau` is not within `taus`.
        """
        if not self.taus[0] <= tau <= self.taus[-1]:
            raise IdentificationError(
                f'the Allan deviation at {tau:g} s can not be read: it covers '
                f'{self.taus[0]:g} to {self.taus[-1]:g} s'
            )
        return float(np.exp(np.interp(np.log(tau), np.log(self.taus), np.log(self.deviations))))


def allan_deviation(spans: Sequence[Values], period: float) -> Allan:
    """Return the Allan deviation of one axis at rest and what is read from it.

    Outliers raise the whole curve, so `Preprocessed.cleaned` is what to pass. A trend rises with
    slope +1 at long times (the standard's rate ramp); with the trend taken out, part of the bias
    instability is gone too, and the curve is too low at the longest times.

    Args:
        spans: Each (n,) in rad/s, evenly spaced, finite.
        period: In s.

    Raises:
        IdentificationError: The longest span is too short, or nothing in it changes.
    """
    longest = max((len(span) for span in spans), default=0)
    if longest < LEAST_SAMPLES:
        raise IdentificationError(
            f'{longest} samples in the longest span are too few for an Allan deviation: at least '
            f'{LEAST_SAMPLES}'
        )
    taus, variances, counts = _combine(spans, period, _cluster_sizes(longest))
    if not (variances > 0.0).all():
        raise IdentificationError('a constant axis has no Allan deviation')
    deviations = np.sqrt(variances)
    slopes = _slopes(taus, deviations)
    bottom = int(np.argmin(deviations))
    walk = _read_slope(taus, deviations, slopes, ARW_SLOPE, slice(0, bottom + 1), near=1.0)
    drift = _read_slope(taus, deviations, slopes, RRW_SLOPE, slice(bottom, None), near=np.inf)
    instability = Coefficient(
        float(deviations[bottom]) / BIAS_INSTABILITY, float(taus[bottom]), float(taus[bottom])
    )
    return Allan(
        taus,
        deviations,
        counts,
        walk,
        instability,
        None if drift is None else Coefficient(drift.value * 3**0.5, drift.shortest, drift.longest),
        _warnings(taus, deviations, walk, drift),
    )


def _cluster_sizes(longest: int) -> Integers:
    """Return the numbers of samples to average over, evenly spaced in logarithm."""
    largest = longest // LEAST_CLUSTERS
    count = 2 + int(TAUS_PER_DECADE * np.log10(largest))
    return np.unique(np.round(np.geomspace(1, largest, count)).astype(np.int64))


def _combine(
    spans: Sequence[Values], period: float, sizes: Integers
) -> tuple[Floats, Floats, Integers]:
    """Return taus in s, Allan variances and numbers of differences over all spans."""
    sums = np.zeros(len(sizes))
    counts = np.zeros(len(sizes), np.int64)
    for span in spans:
        usable = sizes <= len(span) // LEAST_CLUSTERS
        # As the parts are no shorter than half of that, they hold many averages.
        short = usable & (sizes <= LARGEST_PART // _IN_PARTS)
        if len(span) <= LARGEST_PART:
            short = usable
        for part in parts(span):
            _add(part, 1, sizes, short, sums, counts)
        step = -(-len(span) // LARGEST_PART)
        if (usable & ~short).any():
            _add(_means(span, step), step, sizes, usable & ~short, sums, counts)
    found = counts > 0
    taus = np.asarray(sizes[found] * period, float)
    return taus, sums[found] / counts[found], counts[found]


def _add(
    values: Floats,
    step: int,
    sizes: Integers,
    usable: Bools,
    sums: Floats,
    counts: Integers,
) -> None:
    """Add the squares of the differences of a series, means of `step` samples, at usable sizes."""
    numbers = np.round(sizes[usable] / step)
    if not len(numbers):
        return
    # In units of samples, where every size is exact; the mean is of no account but costs digits
    # in the running sum.
    _, deviations, _, found = allantools.oadev(
        values - values.mean(), rate=1.0, data_type='freq', taus=numbers
    )
    sums[usable] += np.asarray(found) * np.asarray(deviations) ** 2
    counts[usable] += np.asarray(found, np.int64)


def _means(span: Values, step: int) -> Floats:
    """Return the means of so many samples each; those that are left over at the end are not."""
    return block_means([Stretch(span, 0, len(span) // step * step)], len(span) // step)


def _slopes(taus: Floats, deviations: Floats) -> Floats:
    """Return the slope of the logarithms at each tau, by a line through its neighbours: (m,)."""
    x, y = np.log(taus), np.log(deviations)
    out = np.empty(len(x))
    half = SLOPE_POINTS // 2
    for k in range(len(x)):
        near = slice(max(0, k - half), k + half + 1)
        out[k] = np.polyfit(x[near], y[near], 1)[0]
    return out


def _read_slope(
    taus: Floats, deviations: Floats, slopes: Floats, slope: float, within: slice, near: float
) -> Coefficient | None:
    """Fit a line of the given slope to the run of taus that has it and lies nearest to `near`.

    Returns:
        The line's value at tau = 1 s, or None where no run is long enough.
    """
    inside = np.zeros(len(taus), bool)
    inside[within] = True
    fits = np.flatnonzero(inside & (np.abs(slopes - slope) < SLOPE_TOLERANCE))
    runs = np.split(fits, np.flatnonzero(np.diff(fits) > 1) + 1) if len(fits) else []
    runs = [run for run in runs if len(run) >= LEAST_POINTS]
    if not runs:
        return None
    if np.isinf(near):
        run = runs[-1]
    else:
        run = min(runs, key=lambda r: float(np.abs(np.log(taus[r] / near)).min()))
    logarithm = float(np.mean(np.log(deviations[run]) - slope * np.log(taus[run])))
    return Coefficient(float(np.exp(logarithm)), float(taus[run[0]]), float(taus[run[-1]]))


def _still_falls(deviations: Floats) -> bool:
    """Tell whether the minimum of deviations (m,) may lie at longer times."""
    bottom = int(np.argmin(deviations))
    return bool(deviations[bottom:].max() < RISE * deviations[bottom])


def _warnings(
    taus: Floats, deviations: Floats, walk: Coefficient | None, drift: Coefficient | None
) -> tuple[str, ...]:
    warnings = []
    if walk is None:
        warnings.append(
            'no part of the Allan deviation falls as white noise does, so there is no angle random '
            'walk to read'
        )
    elif not walk.shortest <= 1.0 <= walk.longest:
        warnings.append(
            f'the angle random walk was read at {plain(walk.shortest, 2)} to '
            f'{plain(walk.longest, 2)} s and carried over to 1 s'
        )
    if _still_falls(deviations):
        warnings.append(
            f'the Allan deviation still falls at {plain(taus[-1])} s: the recording is too short '
            'for the bias instability, which is an upper bound'
        )
    if drift is None:
        warnings.append(
            f'the Allan deviation up to {plain(taus[-1])} s shows no rate random walk: the sensor '
            'has little of it or the recording is too short'
        )
    return tuple(warnings)
