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

"""What the model assumes of the residual, tested; a failed check is a warning, not a stop.

At a million samples every real sensor fails every test by its p-value, so the verdicts go by the
size of the effect wherever it has one. Only an axis that measures nothing is an error.
"""

import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from statsmodels.tsa.stattools import adfuller, kpss

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.preprocess import mean_deviation
from gyro_drift_filter.identify.series import (
    Values,
    all_parts,
    block_means,
    mean_of,
    mean_square,
    parts,
    thinned,
)

MEAN_LIMIT = 3.0  # deviations of the mean
# Of ADF, which has to speak for a constant level, and of KPSS, which speaks against one. Of three
# perfect axes one in seven recordings would fail at 0.05. The table of KPSS ends at 0.01.
ROOT_SIGNIFICANCE, LEVEL_SIGNIFICANCE = 0.05, 0.01
# Stationarity is a matter of long times: it is tested on this many block means at most.
STATIONARITY_POINTS = 2000
STATIONARITY_LEAST = 50
# Beyond these a Gaussian likelihood gives visibly wrong intervals.
SKEWNESS_LIMIT, KURTOSIS_LIMIT = 0.5, 1.0
# Quantisation step in noise deviations: at 0.5 it adds 2 % to the variance.
STEP_LIMIT = 0.5
# Share of the differences that have to be whole multiples of a step, within a tolerance in steps.
MULTIPLES, MULTIPLE_TOLERANCE, LARGEST_MULTIPLE = 0.95, 0.05, 100.0
# Differences below this share of the usual one are rounding of floating point.
ROUNDING = 1e-6
QUANTISATION_SAMPLES = 200_000
# A dead band: so many samples hold one value, and the nearest other one is this many steps off.
DEAD_SHARE, DEAD_STEPS = 0.3, 3.0
COARSE_SHARE = 0.95


@dataclass(frozen=True)
class Check:
    """One assumption and what came of it.

    Attributes:
        name: Of the assumption.
        passed: False makes it a warning.
        statistic: The figure that `detail` gives in a few digits; which one, the function says that
            makes the check. It is for programs: what the command prints is `detail` alone.
        detail: The figures, in one sentence.
        consequence: What a failure means for the user, in one sentence; empty where it passed.
    """

    name: str
    passed: bool
    statistic: float
    detail: str
    consequence: str


def _check(name: str, statistic: float, detail: str, failure: str, *, passed: bool) -> Check:
    """Return a check; what a failure means is left out where it passed."""
    return Check(name, passed, statistic, detail, '' if passed else failure)


def dead_value(values: Values) -> float | None:
    """Return the value of an axis (n,) that holds one to the last bit, None where it changes."""
    known: float | None = None
    for part in parts(values):
        finite = part[np.isfinite(part)]
        if not len(finite):
            continue
        known = float(finite[0]) if known is None else known
        if (finite != known).any():
            return None
    return known


def require_noise(spans: Sequence[Values], axis: str) -> None:
    """Make sure that an axis measures at all.

    Args:
        spans: Rates at rest as the sensor gives them, (n,) each, in rad/s; may hold NaN.
        axis: Its name, for the message.

    Raises:
        IdentificationError: The axis is empty, all zero, constant, dead-banded, or so coarse that
            nearly all samples hold one value.
    """
    values = thinned(spans)
    values = values[np.isfinite(values)]
    if not len(values):
        raise IdentificationError(f'axis {axis} has no finite sample at rest')
    levels, counts = np.unique(values, return_counts=True)
    mode = levels[np.argmax(counts)]
    share = float(counts.max()) / len(values)
    if len(levels) == 1 or np.ptp(levels) <= 1e-12 * np.abs(levels).max():
        what = 'zero throughout' if mode == 0.0 else f'constant at {np.degrees(mode):.6g} deg/s'
        raise IdentificationError(
            f'axis {axis} is {what}: it does not measure, or the driver filters its noise away'
        )
    if share > DEAD_SHARE and _nearest(levels, mode) > DEAD_STEPS * _usual_step(levels, mode):
        raise IdentificationError(
            f'axis {axis} has a dead band: {100 * share:.0f} % of the samples at rest are '
            f'{np.degrees(mode):.6g} deg/s and the nearest other is '
            f'{np.degrees(_nearest(levels, mode)):.3g} deg/s off; '
            'switch the dead band or zero-rate filter of the driver off'
        )
    if share > COARSE_SHARE:
        raise IdentificationError(
            f'axis {axis} is too coarse: {100 * share:.0f} % of the samples at rest hold one '
            'value, so its noise lies below its resolution'
        )


def check_zero_mean(residuals: Sequence[Values]) -> Check:
    """Test that no span's mean departs from zero; the statistic is in its own deviations.

    The deviation of a mean is taken from block means, so that it holds for correlated noise.

    Args:
        residuals: Per span (n,) in rad/s.
    """
    count = sum(map(len, residuals))
    whole = mean_deviation(residuals)
    worst, where = 0.0, 0
    for index, span in enumerate(residuals):
        # A short span is judged by the whole recording's deviation, scaled to its length.
        deviation = whole * np.sqrt(count / len(span))
        score = abs(mean_of([span])) / float(deviation) if deviation > 0.0 else 0.0
        if score > worst:
            worst, where = score, index
    passed = worst <= MEAN_LIMIT
    return _check(
        'zero mean',
        worst,
        f'the mean of span {where + 1} of {len(residuals)} is the farthest from zero, by '
        f'{worst:.2f} of its standard deviations (limit {MEAN_LIMIT:g})',
        'the bias differs from one motionless span to another by more than the noise '
        'explains, so the bias written is not that of each span.',
        passed=passed,
    )


def check_stationarity(residuals: Sequence[Values]) -> Check:
    """Test by ADF (null: a unit root) and KPSS (null: a constant level) together.

    Both run on the longest span, averaged in equal blocks down to 2,000 points at most, and ADF
    with 12 (n / 100)^(1/4) lags (Schwert) without a search for a better number, so that a million
    samples take no time or memory. What this leaves out are changes within a block, which do not
    make a level wander. The statistic is that of KPSS.

    Args:
        residuals: Per span (n,) in rad/s.

    Raises:
        IdentificationError: The longest span is too short, or constant.
    """
    span = max(residuals, key=len)
    points = block_means([span], min(len(span), STATIONARITY_POINTS))
    if len(span) < STATIONARITY_LEAST or points.std() == 0.0:
        raise IdentificationError(
            f'stationarity can not be tested on {len(span)} samples without change'
            if len(span) >= STATIONARITY_LEAST
            else f'{len(span)} samples are too few to test stationarity'
        )
    points = points / points.std()
    lags = int(12 * (len(points) / 100) ** 0.25)
    with warnings.catch_warnings():
        # p values beyond the tables are cut off at their ends, and newer versions say more.
        warnings.simplefilter('ignore')
        root = float(adfuller(points, maxlag=lags, regression='c', autolag=None)[1])
        result = kpss(points, regression='c', nlags='auto')
    statistic, level = float(result[0]), float(result[1])
    no_root, stays = root < ROOT_SIGNIFICANCE, level > LEVEL_SIGNIFICANCE
    verdict, consequence = _STATIONARITY[no_root, stays]
    return Check(
        'stationarity',
        no_root and stays,
        statistic,
        f'{verdict}: ADF p {root:.3g}, KPSS {statistic:.3g} (p {level:.2g}, cut off at 0.01 and '
        f'0.1) on {len(points)} means of {len(span) / len(points):.3g} samples',
        consequence,
    )


# By (ADF rejects a unit root, KPSS keeps a constant level).
_STATIONARITY = {
    (True, True): ('stationary', ''),
    (True, False): (
        'noise about a level that wanders',
        'the bias moves during the recording by more than the noise, so identify it anew at the '
        "start of each run or let the filter's bias estimation follow it.",
    ),
    (False, True): (
        'undecided',
        'the recording is too short to tell slow noise from a wandering level, so a longer one is '
        'needed before the coefficients can be trusted.',
    ),
    (False, False): (
        'a random walk',
        'the noise has no constant level that an AR(1) drift could return to, so its coefficient '
        'comes out near 1 and the bias is valid only for the time of its rest.',
    ),
}


def check_normality(residuals: Sequence[Values]) -> Check:
    """Test by skewness and excess kurtosis, and report the statistic of Jarque and Bera.

    The verdict goes by the size of the two (0.5 and 1), not by p: at a million samples an excess
    kurtosis of 0.02, which nobody could notice, has p below 0.0001. The statistic is that of
    Jarque and Bera.

    Args:
        residuals: Per span (n,) in rad/s.

    Raises:
        IdentificationError: The residuals are constant.
    """
    count = sum(map(len, residuals))
    mean = mean_of(residuals) if count else 0.0
    deviation = math.sqrt(max(mean_square(residuals) - mean**2, 0.0)) if count else 0.0
    if deviation == 0.0:
        raise IdentificationError('normality can not be tested on values without change')
    moments = np.zeros(2)
    for part in all_parts(residuals):
        scaled = (part - mean) / deviation
        moments += (scaled**3).sum(), (scaled**4).sum()
    skewness, excess = float(moments[0] / count), float(moments[1] / count) - 3.0
    # Of Jarque and Bera; chi squared with two degrees of freedom where the noise is Gaussian.
    statistic = count / 6.0 * (skewness**2 + excess**2 / 4.0)
    p = math.exp(-0.5 * statistic)
    passed = abs(skewness) <= SKEWNESS_LIMIT and abs(excess) <= KURTOSIS_LIMIT
    return _check(
        'normality',
        statistic,
        f'skewness {skewness:.3f} (limit {SKEWNESS_LIMIT:g}), excess kurtosis {excess:.3f} (limit '
        f'{KURTOSIS_LIMIT:g}); Jarque-Bera {statistic:.4g}, p {p:.2g} on {count} samples, which '
        'does not decide, as any sensor fails with enough of them',
        'the noise is not Gaussian, so the standard errors and the outlier limits, which '
        'assume that it is, are too narrow.',
        passed=passed,
    )


def check_quantisation(spans: Sequence[Values], deviation: float) -> Check:
    """Compare the sensor's step with its noise; the statistic is step over deviation.

    Args:
        spans: Rates at rest as the sensor gives them, (n,) each, in rad/s.
        deviation: Of the residuals, in rad/s.
    """
    step = find_step(spans)
    share = step / deviation if deviation > 0.0 else 0.0
    passed = share <= STEP_LIMIT
    detail = (
        f'steps of {np.degrees(step):.4g} deg/s are {share:.3g} of the noise deviation '
        f'(limit {STEP_LIMIT:g})'
        if step
        else 'no quantisation found'
    )
    return _check(
        'quantisation',
        share,
        detail,
        f'rounding to steps adds {100 * share**2 / 12:.0f} % to the variance as white noise '
        'that is not Gaussian, so the coefficients of the finest noise are those of the rounding.',
        passed=passed,
    )


def find_step(spans: Sequence[Values]) -> float:
    """Return the quantisation step in rad/s, 0 where there is none.

    The differences of neighbouring samples are whole multiples of it. Small differences are tried,
    from the smallest up; of a step that fits, the median of difference over multiple is returned.

    Args:
        spans: Rates at rest as the sensor gives them, (n,) each, in rad/s; may hold NaN.
    """
    found, count = [np.zeros(0)], 0
    for part in all_parts(spans):
        steps = np.abs(np.diff(part))
        found.append(steps[np.isfinite(steps)])
        count += len(found[-1])
        if count >= QUANTISATION_SAMPLES:
            break
    differences = np.concatenate(found)[:QUANTISATION_SAMPLES]
    differences = differences[differences > 0.0]
    if not len(differences):
        return 0.0
    differences = differences[differences > ROUNDING * np.median(differences)]
    for share in (0.0, 0.001, 0.01, 0.05):
        candidate = float(np.quantile(differences, share, method='lower'))
        # Multiples far out would ask for more digits of the step than it has.
        near = differences[differences < LARGEST_MULTIPLE * candidate]
        for reach in (2.5, 10.0, LARGEST_MULTIPLE):
            part = near[near < reach * candidate]
            multiple = np.round(part / candidate)
            known = multiple > 0
            candidate = float(np.median(part[known] / multiple[known]))
        off = np.abs(near / candidate - np.round(near / candidate))
        enough = len(near) >= 0.02 * len(differences)
        if enough and float((off < MULTIPLE_TOLERANCE).mean()) >= MULTIPLES:
            return candidate
    return 0.0


def _nearest(levels: Floats, mode: float) -> float:
    """Return the distance from the most frequent value to the nearest other one."""
    others = np.abs(levels - mode)
    return float(others[others > 0.0].min())


def _usual_step(levels: Floats, mode: float) -> float:
    """Return the median distance between neighbours among the other values."""
    others = np.sort(levels[levels != mode])
    below, above = others[others < mode], others[others > mode]
    steps = np.concatenate([np.diff(below), np.diff(above)])
    return float(np.median(steps)) if len(steps) else np.inf
