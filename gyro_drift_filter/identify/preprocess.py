"""Outliers, bias and trend of one axis at rest are taken out, as the paper's section 2 asks.

What is left is the residual that tests, fits and the Allan deviation work on. Time keeps its even
steps: an outlier and a sample that is not finite are replaced by the line between their neighbours,
not cut, because the models live on the correlation from one sample to the next.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.identify.blocks import block_means, block_rows, row_medians
from gyro_drift_filter.identify.errors import IdentificationError
from gyro_drift_filter.identify.quiet import Span

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

# Outliers are judged against the line through the medians of blocks this long.
MEDIAN_SECONDS = 1.0
LEAST_MEDIAN = 16  # samples
# Limit in robust deviations: Gaussian noise passes it twice in 1e9 samples.
OUTLIER_DEVIATIONS = 6.0
# Deviation of Gaussian noise per median absolute deviation.
PER_MEDIAN_DEVIATION = 1.4826

# The trend is fitted to this many means of equal parts of the recording.
TREND_BLOCKS = 24
HIGHEST_ORDER = 2
# How much lower the information criterion of a higher order has to be; 6 is "strong evidence".
MATERIAL = 6.0

# Numbers of blocks from which the deviation of a mean is estimated; the largest estimate counts.
MEAN_BLOCKS = (12, 24, 48, 96, 192)
LEAST_SAMPLES = 64


@dataclass(frozen=True)
class Preprocessed:
    """One axis at rest without outliers, bias and trend.

    Attributes:
        residuals: Per span (n,) in rad/s; evenly spaced, of mean zero over all spans.
        cleaned: Per span (n,) in rad/s: without outliers, with bias and trend still in.
        bias: Mean rate in rad/s.
        bias_deviation: Standard deviation of `bias` as the mean of this recording, in rad/s. From
            one power-up to the next a bias differs by more.
        trend_order: 0 to 2; 0 is none.
        trend: Coefficients of (t - t0) in rad/s^2, then of (t - t0)^2 in rad/s^3; `trend_order` of
            them. The trend is bias + sum of c_i ((t - t0)^i - mean of that), so that `bias` stays
            the mean.
        trend_centre: t0 in s, on the time axis of `begins`.
        outliers: Number of samples replaced as outliers.
        missing: Number of samples replaced as not finite.
    """

    residuals: tuple[Floats, ...]
    cleaned: tuple[Floats, ...]
    bias: float
    bias_deviation: float
    trend_order: int
    trend: tuple[float, ...]
    trend_centre: float
    outliers: int
    missing: int


def preprocess(
    rate: Floats, spans: Sequence[Span], period: float, begins: Sequence[float] | None = None
) -> Preprocessed:
    """Return the residuals of one axis over the motionless spans, and what was taken out.

    The trend is a polynomial in time over all spans together. Its order is the smallest whose
    Bayesian information criterion, on the means of 24 equal parts of the data, lies within 6 of the
    best. Parts, not samples, because neighbouring samples are no independent witnesses.

    Args:
        rate: (n,) of the whole recording in rad/s; may hold NaN.
        spans: Of samples at rest, in order.
        period: In s.
        begins: Time of each span's first sample in s, for the trend; by default its index times
            the period, which is right where the recording has no gaps.

    Raises:
        IdentificationError: There are too few samples, or too few of them are finite.
    """
    pieces = [np.asarray(rate[span.first : span.stop], float) for span in spans]
    if sum(map(len, pieces)) < LEAST_SAMPLES:
        raise IdentificationError(
            f'{sum(map(len, pieces))} samples at rest are too few: at least {LEAST_SAMPLES}'
        )
    finite = [np.isfinite(piece) for piece in pieces]
    if min(float(good.mean()) for good in finite) < 0.5:
        raise IdentificationError('more than half of the samples of a span at rest are not finite')
    missing = sum(int((~good).sum()) for good in finite)
    pieces, outliers = replace_outliers(pieces, period)
    if begins is None:
        begins = [span.first * period for span in spans]
    time = np.concatenate(
        [begin + np.arange(len(span)) * period for begin, span in zip(begins, spans, strict=True)]
    )
    values = np.concatenate(pieces)
    centre = float(time.mean())
    bias = float(values.mean())
    trend = _fit_trend(time - centre, values - bias)
    values = values - bias - _evaluate(trend, time - centre)
    values -= values.mean()
    borders = np.cumsum([len(piece) for piece in pieces])[:-1]
    return Preprocessed(
        residuals=tuple(np.split(values, borders)),
        cleaned=tuple(pieces),
        bias=bias,
        bias_deviation=mean_deviation(values, len(trend)),
        trend_order=len(trend),
        trend=trend,
        trend_centre=centre,
        outliers=outliers,
        missing=missing,
    )


def replace_outliers(pieces: Sequence[Floats], period: float) -> tuple[list[Floats], int]:
    """Return copies with outliers and NaN replaced by lines, and the number of outliers.

    An outlier lies more than six robust deviations (1.4826 times the median absolute deviation,
    over all pieces) off the line through the medians of blocks of one second.

    Args:
        pieces: (n,) each, in rad/s, at rest; half of each or more is finite.
        period: In s.
    """
    size = max(LEAST_MEDIAN, round(MEDIAN_SECONDS / period))
    departures = [piece - _course(piece, size) for piece in pieces]
    every = np.concatenate(departures)
    every = every[np.isfinite(every)]
    limit = OUTLIER_DEVIATIONS * _robust_deviation(every)
    cleaned, count = [], 0
    for piece, departure in zip(pieces, departures, strict=True):
        finite = np.isfinite(departure)
        outlier = finite & (np.abs(np.where(finite, departure, 0.0)) > limit)
        count += int(outlier.sum())
        cleaned.append(_bridge(piece, finite & ~outlier))
    return cleaned, count


def mean_deviation(values: Floats, fitted: int = 0) -> float:
    """Return the standard deviation of the mean of correlated values.

    The values are cut into 12 to 192 blocks; the deviation of the block means over the root of
    their number is right where a block is longer than the correlation. Of all numbers of blocks the
    largest estimate is taken: it is some percent too large for white noise and follows a bias that
    wanders over minutes. Bias instability has no true mean at all, so it is a lower bound then.

    Args:
        values: (n,).
        fitted: Number of trend coefficients that were fitted to them.
    """
    estimates = [0.0]
    for blocks in MEAN_BLOCKS:
        if len(values) >= 4 * blocks:
            means = block_means(values, blocks)
            variance = float(((means - means.mean()) ** 2).sum()) / (blocks - 1 - fitted)
            estimates.append(np.sqrt(variance / blocks))
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


def _bridge(piece: Floats, good: Bools) -> Floats:
    index = np.arange(len(piece))
    out = piece.copy()
    out[~good] = np.interp(index[~good], index[good], piece[good])
    return out


def _fit_trend(time: Floats, values: Floats) -> tuple[float, ...]:
    """Return the coefficients of (t - t0), (t - t0)^2 of the smallest sufficient order."""
    times, means = block_means(time, TREND_BLOCKS), block_means(values, TREND_BLOCKS)
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


def _evaluate(trend: tuple[float, ...], time: Floats) -> Floats:
    """Return the trend at times from its centre, of mean zero: (n,)."""
    out = np.zeros_like(time)
    for i, coefficient in enumerate(trend, 1):
        power = time**i
        out += coefficient * (power - power.mean())
    return out
