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

"""Outliers, bias and trend of one axis at rest are taken out, as the paper's section 2 asks.

What is left is the residual that tests, fits and the Allan deviation work on. Time keeps its even
steps: an outlier and a sample that is not finite are replaced by the line between their neighbours,
not cut, because the models live on the correlation from one sample to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import chi2

from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.blocks import PER_MEDIAN_DEVIATION, block_rows, row_medians
from gyro_drift_filter.identify.quiet import SampleSpan
from gyro_drift_filter.identify.series import (
    Ramp,
    Stored,
    Stretch,
    Values,
    all_parts,
    block_means,
    mean_of,
    parts,
    thinned,
)

# Outliers are judged against the line through the medians of blocks this long.
MEDIAN_SECONDS = 1.0
LEAST_MEDIAN = 16  # samples
# Limit in robust deviations: Gaussian noise passes it twice in 1e9 samples.
OUTLIER_DEVIATIONS = 6.0

# The trend is fitted to this many means of equal parts of the recording.
TREND_BLOCKS = 24
HIGHEST_ORDER = 2
# How much lower the information criterion of a higher order has to be; 6 is "strong evidence".
MATERIAL = 6.0

# Numbers of blocks from which the deviation of a mean is estimated; the largest estimate counts.
MEAN_BLOCKS = (12, 24, 48, 96, 192)
LEAST_SAMPLES = 64
# Means of one bias differ by so much as seldom as this.
BY_CHANCE = 1e-3


@dataclass(frozen=True)
class Preprocessed:
    """One axis at rest without outliers, bias and trend.

    Attributes:
        residuals: Per span (n,) in rad/s; evenly spaced, of mean zero over all spans.
        cleaned: Per span (n,) in rad/s: without outliers, with bias and trend still in.
        bias: Mean rate in rad/s, over all spans or, if the bias moves, over the longest one.
        bias_moves: Whether the bias differs from span to span.
        bias_deviation: Standard deviation of `bias` in rad/s, with its moves from span to span;
            `identify` adds by how much it moved to rests that are left out for that. From one
            power-up to the next a bias differs by more.
        trend_order: 0 to 2; 0 is none.
        trend: Coefficients of (t - t0) in rad/s^2, then of (t - t0)^2 in rad/s^3; `trend_order` of
            them. Taken out are the mean over all spans and the sum of c_i ((t - t0)^i - mean of
            that).
        trend_centre: t0 in s, on the time axis of `begins`.
        outliers: Number of samples replaced as outliers.
        missing: Number of samples replaced as not finite.
    """

    # As long as the recording, which is too much for the results that programs get.
    residuals: tuple[Stored, ...] = field(metadata={'in_json': False})
    cleaned: tuple[Stored, ...] = field(metadata={'in_json': False})
    bias: float
    bias_moves: bool
    bias_deviation: float
    trend_order: int
    trend: tuple[float, ...]
    trend_centre: float
    outliers: int
    missing: int


def preprocess(
    rate: Values, spans: Sequence[SampleSpan], period: float, begins: Sequence[float]
) -> Preprocessed:
    """Return the residuals of one axis over the motionless spans, and what was taken out.

    The trend is a polynomial in time over all spans together. Its order is the smallest whose
    Bayesian information criterion, on the means of 24 equal parts of the data, lies within 6 of the
    best. Parts, not samples, because neighbouring samples are no independent witnesses.

    Args:
        rate: (n,) of the whole recording in rad/s; may hold NaN.
        spans: Of samples at rest, in order.
        period: In s.
        begins: Time of each span's first sample in s, for the trend.

    Raises:
        IdentificationError: There are too few samples, or too few of them are finite.
    """
    count = sum(map(len, spans))
    if count < LEAST_SAMPLES:
        raise IdentificationError(f'{count} samples at rest are too few: at least {LEAST_SAMPLES}')
    raw = [Stretch(rate, span.first, span.stop) for span in spans]
    lacking = [sum(int((~np.isfinite(part)).sum()) for part in parts(piece)) for piece in raw]
    if any(less > 0.5 * len(span) for less, span in zip(lacking, spans, strict=True)):
        raise IdentificationError('more than half of the samples of a span at rest are not finite')
    cleaned, outliers = replace_outliers(raw, period)
    ramps = [Ramp(begin, period, len(span)) for begin, span in zip(begins, spans, strict=True)]
    centre, level = mean_of(ramps), mean_of(cleaned)
    trend = _fit_trend(
        block_means(ramps, TREND_BLOCKS) - centre, block_means(cleaned, TREND_BLOCKS) - level
    )
    means = [_power_mean(ramps, centre, i) for i in range(1, len(trend) + 1)]
    residuals = []
    for ramp, piece in zip(ramps, cleaned, strict=True):
        residuals.append(Stored())
        for time, values in zip(parts(ramp), parts(piece), strict=True):
            left = values - level
            for i, (coefficient, mean) in enumerate(zip(trend, means, strict=True), 1):
                left -= coefficient * ((time - centre) ** i - mean)
            residuals[-1].append(left)
    bias, bias_deviation, bias_moves = _bias(level, cleaned, residuals, len(trend))
    return Preprocessed(
        residuals=tuple(residuals),
        cleaned=tuple(cleaned),
        bias=bias,
        bias_deviation=bias_deviation,
        bias_moves=bias_moves,
        trend_order=len(trend),
        trend=trend,
        trend_centre=centre,
        outliers=outliers,
        missing=sum(lacking),
    )


def replace_outliers(pieces: Sequence[Values], period: float) -> tuple[list[Stored], int]:
    """Return copies with outliers and NaN replaced by lines, and the number of outliers.

    An outlier lies more than six robust deviations (1.4826 times the median absolute deviation,
    over all pieces) off the line through the medians of blocks of one second.

    Args:
        pieces: (n,) each, in rad/s, at rest; half of each or more is finite.
        period: In s.
    """
    size = max(LEAST_MEDIAN, round(MEDIAN_SECONDS / period))
    departures = [Stored() for _ in pieces]
    for piece, stored in zip(pieces, departures, strict=True):
        for part in parts(piece):
            stored.append(part - _course(part, size))
    every = thinned(departures)
    limit = OUTLIER_DEVIATIONS * _robust_deviation(every[np.isfinite(every)])
    cleaned, count = [Stored() for _ in pieces], 0
    for piece, stored, out in zip(pieces, departures, cleaned, strict=True):
        for part, departure in zip(parts(piece), parts(stored), strict=True):
            finite = np.isfinite(departure)
            outlier = finite & (np.abs(np.where(finite, departure, 0.0)) > limit)
            count += int(outlier.sum())
            out.append(bridged(part, finite & ~outlier))
    return cleaned, count


def _bias(
    level: float, cleaned: Sequence[Values], residuals: Sequence[Values], fitted: int
) -> tuple[float, float, bool]:
    """Return the bias, its deviation as one of any of the spans, and whether it moves.

    It moves where the means of the spans differ by more than their errors (Cochran's Q test). Over
    hours it does, and then no time has that of the mean of a day: it is that of the longest span,
    and by how much the others differ from it counts. Else it is `level`, the mean over all spans.
    """
    lengths = np.array(list(map(len, cleaned)))
    longest = int(lengths.argmax())
    means = np.array([mean_of([piece]) for piece in cleaned])
    variances = np.array([mean_deviation([piece], fitted) ** 2 for piece in residuals])
    if not _differ(means, variances):
        return level, mean_deviation(residuals, fitted), False
    explained = variances + variances[longest]
    explained[longest] = 0.0
    moves = float((lengths * ((means - means[longest]) ** 2 - explained)).sum() / lengths.sum())
    return float(means[longest]), float(np.sqrt(variances[longest] + max(moves, 0.0))), True


def _differ(means: Floats, variances: Floats) -> bool:
    """Return whether values differ by more than their variances explain."""
    if len(means) < 2:
        return False
    weights = 1.0 / np.maximum(variances, np.finfo(float).tiny)
    distances = means - np.average(means, weights=weights)
    return bool(chi2.sf((weights * distances**2).sum(), len(means) - 1) < BY_CHANCE)


def mean_deviation(spans: Sequence[Values], fitted: int = 0) -> float:
    """Return the standard deviation of the mean of correlated values.

    The values are cut into 12 to 192 blocks; the deviation of the block means over the root of
    their number is right where a block is longer than the correlation. Of all numbers of blocks the
    largest estimate is taken: it is some percent too large for white noise and follows a bias that
    wanders over minutes. Bias instability has no true mean at all, so it is a lower bound then.
    Too few values for blocks count as uncorrelated.

    Args:
        spans: (n,) each.
        fitted: Number of trend coefficients that were fitted to them.
    """
    count = sum(map(len, spans))
    estimates = []
    for blocks in [some for some in MEAN_BLOCKS if 4 * some <= count] or [count]:
        means = block_means(spans, blocks)
        squares = float(((means - means.mean()) ** 2).sum())
        estimates.append(np.sqrt(squares / max(blocks - 1 - fitted, 1) / blocks))
    return float(max(estimates))


def _course(piece: Floats, size: int) -> Floats:
    """Return the line through the medians of blocks of about `size` samples, (n,)."""
    count = max(1, len(piece) // size)
    edges = np.arange(count + 1) * len(piece) // count
    medians = row_medians(block_rows(piece, edges[:-1], edges[1:]))
    centres = 0.5 * (edges[:-1] + edges[1:] - 1)
    known = np.isfinite(medians)
    return np.asarray(np.interp(np.arange(len(piece)), centres[known], medians[known]), float)


def _robust_deviation(departures: Floats) -> float:
    """Return a deviation that outliers do not reach, also of coarsely quantised values."""
    deviation = PER_MEDIAN_DEVIATION * float(np.median(np.abs(departures)))
    # Where half the samples hold one value the median says too little.
    middle = np.sort(departures**2)[: max(1, int(0.99 * len(departures)))]
    return max(deviation, float(np.sqrt(middle.mean())))


def bridged(piece: Floats, good: Bools) -> Floats:
    """Return values (n,) with lines drawn over those that are not good; some have to be."""
    index = np.arange(len(piece))
    out = piece.copy()
    out[~good] = np.interp(index[~good], index[good], piece[good])
    return out


def _fit_trend(times: Floats, means: Floats) -> tuple[float, ...]:
    """Return the coefficients of (t - t0), (t - t0)^2 of the smallest sufficient order.

    Args:
        times: (b,) mean time of each block, less t0.
        means: (b,) mean rate of each block.
    """
    fits = [_fit_order(times, means, order) for order in range(HIGHEST_ORDER + 1)]
    best = min(criterion for criterion, _ in fits)
    return next(trend for criterion, trend in fits if criterion <= best + MATERIAL)


def _fit_order(times: Floats, means: Floats, order: int) -> tuple[float, tuple[float, ...]]:
    """Return the Bayesian information criterion and the coefficients of one order."""
    scale = float(np.abs(times).max())
    powers = np.stack([(times / scale) ** i for i in range(order + 1)], axis=1)
    solution = np.linalg.lstsq(powers, means, rcond=None)[0]
    squares = float(((means - powers @ solution) ** 2).sum())
    floor = 1e-24 * float((means**2).sum()) + 1e-300
    count = len(means)
    criterion = count * np.log(max(squares, floor) / count) + (order + 1) * np.log(count)
    return float(criterion), tuple(float(solution[i] / scale**i) for i in range(1, order + 1))


def _power_mean(ramps: Sequence[Ramp], centre: float, power: int) -> float:
    total = sum(float(((time - centre) ** power).sum()) for time in all_parts(ramps))
    return total / sum(map(len, ramps))
