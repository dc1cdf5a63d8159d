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

"""What the noise at rest says of how counts are made: cut towards zero, or rounded.

Noise has a smooth density, and where counts are cut zero stands for twice as much of it as any
other count. A normal distribution is fitted to how often each count comes, once as rounded and once
as cut, by expectation and maximisation. To be believed, the better one has to explain nearly all of
what the other one leaves open: neither a dead band nor noise that is not normal does that.
"""

import math
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.sample import COUNT_VARIANCE

# Counts from -LARGEST to LARGEST are told from each other; the outer two stand for all beyond.
LARGEST = 12
BINS = 2 * LARGEST + 1
LARGEST_STEP = 2.0 * LARGEST
# Beyond them lies no more than this share: the fit would follow what it does not see.
LARGEST_SHARE_BEYOND = 0.02
LEAST_SAMPLES = 100
# Zero is then within the noise, and the noise wide enough to show more than three counts.
MEAN_DEVIATIONS, LEAST_DEVIATION = 3.0, 0.7
# Zeros on all axes of a sensor that has nothing to report are so many more than by chance, at
# least, if they make zero twice as frequent.
ZEROS_BY_CHANCE, LEAST_ZEROS = 1.5, 10
ITERATIONS = 6
# A dead band up to so many counts, in which rates are given as zero, leaves part of those beside.
DEAD_BANDS = (0.65, 0.8, 1.0, 1.25)
FITTED = 3  # of the shares of the counts: mean, deviation, and their sum
# Of a count: a spike does not decide, nor is it part of the noise.
LEAST_PROBABILITY = 1e-9
LEAST_VARIANCE = 0.01
STRONGEST_CORRELATION = 0.995
# Of what rounding leaves unexplained, cutting leaves no more than this share.
UNEXPLAINED_SHARE = 0.25

Bins = Annotated[NDArray[np.int64], np.int64, (3 * BINS,)]


class CountsAtRest(TypedDict):
    """How often each count came on the three axes."""

    bins: Bins
    square_steps: PerAxis  # sum over the steps from one sample to the next, in counts squared
    samples: int
    zeros: int  # of them, those with zero on all axes


COUNTS_AT_REST = record(CountsAtRest)


@kernel
def forget_counts_at_rest(counts: CountsAtRest) -> None:
    """Forget all counts."""
    for i in range(3 * BINS):
        counts['bins'][i] = 0
    for axis in range(3):
        counts['square_steps'][axis] = 0.0
    counts['samples'] = counts['zeros'] = 0


@kernel
def note_count_at_rest(counts: CountsAtRest, axis: int, count: float, step: float) -> None:
    """Take in a whole count of an axis, and the step to it from the sample before."""
    inside = int(min(max(count, -LARGEST), LARGEST))
    counts['bins'][BINS * axis + LARGEST + inside] += 1
    step = min(abs(step), LARGEST_STEP)
    counts['square_steps'][axis] += step * step


@kernel
def add_counts_at_rest(counts: CountsAtRest, total: CountsAtRest) -> None:
    """Add the counts to others, and forget them."""
    for i in range(3 * BINS):
        total['bins'][i] += counts['bins'][i]
    for axis in range(3):
        total['square_steps'][axis] += counts['square_steps'][axis]
    total['samples'] += counts['samples']
    total['zeros'] += counts['zeros']
    forget_counts_at_rest(counts)


@kernel
def moments_at_rest(counts: CountsAtRest, axis: int, half: float) -> tuple[float, float, float]:
    """Return number, mean and variance of the counts of an axis, with `half` put further out."""
    number = total = squares = 0.0
    for k in range(-LARGEST, LARGEST + 1):
        times = 1.0 * counts['bins'][BINS * axis + LARGEST + k]
        value = k + (half if k > 0 else -half if k < 0 else 0.0)
        number += times
        total += times * value
        squares += times * value * value
    mean = total / max(number, 1.0)
    return number, mean, squares / max(number, 1.0) - mean * mean


@kernel
def evidence_of_cut(counts: CountsAtRest) -> float:
    """Return the log likelihood ratio of counts that are cut to the next best explanation.

    It is 0 where reads may have failed. Correlated noise counts as fewer independent samples.
    """
    if _has_nothing_to_report(counts):
        return 0.0
    cut = _fit(counts, 0.5, 1.0)
    rounded = other = _fit(counts, 0.0, 0.5)
    for edge in DEAD_BANDS:
        other = max(other, _fit(counts, 0.0, edge))
    explains = -cut < UNEXPLAINED_SHARE * -rounded
    return cut - other if explains else min(cut - other, 0.0)


@kernel
def _fit(counts: CountsAtRest, half: float, edge: float) -> float:
    """Return the log likelihood of the counts by the best normal noise, over the axes that tell.

    `half` is what is cut off, in counts: a half, or nothing. Rates within `edge` counts are given
    as zero. It is relative to the log likelihood by the observed shares themselves, and what chance
    takes from it on average is added.
    """
    fit = 0.0
    for axis in range(3):
        number, mean, variance = moments_at_rest(counts, axis, 0.0)
        if number < LEAST_SAMPLES or not _tells(counts, axis, number, mean, variance):
            continue
        best, different = 0.0, 0
        for i in range(BINS * axis, BINS * (axis + 1)):
            if counts['bins'][i] > 0:
                best += counts['bins'][i] * math.log(counts['bins'][i] / number)
                different += 1
        share = _independent_share(counts, axis, number, variance)
        fit += share * (_log_likelihood(counts, axis, half, edge) - best)
        fit += 0.5 * max(different - FITTED, 0)
    return fit


@kernel
def _has_nothing_to_report(counts: CountsAtRest) -> bool:
    """Return whether zeros come on all axes at once more often than by chance."""
    expected = 1.0 * counts['samples']
    for axis in range(3):
        number, _, _ = moments_at_rest(counts, axis, 0.0)
        if number > 0.0:
            expected *= counts['bins'][BINS * axis + LARGEST] / number
    return bool(counts['zeros'] > ZEROS_BY_CHANCE * expected + LEAST_ZEROS)


@kernel
def _tells(counts: CountsAtRest, axis: int, number: float, mean: float, variance: float) -> bool:
    """Return whether the noise of an axis, with such moments of counts, reaches zero."""
    first, last = BINS * axis, BINS * (axis + 1) - 1
    beyond = counts['bins'][first] + counts['bins'][last]
    near = mean * mean < MEAN_DEVIATIONS * MEAN_DEVIATIONS * variance
    wide = variance > LEAST_DEVIATION * LEAST_DEVIATION
    return bool(near and wide and beyond <= LARGEST_SHARE_BEYOND * number)


@kernel
def _independent_share(counts: CountsAtRest, axis: int, number: float, variance: float) -> float:
    """Return how many independent samples say as much as one of an axis does.

    How often a count comes follows the correlation by its square, which falls off exponentially at
    the slowest where it is that of a low-pass.
    """
    step = counts['square_steps'][axis] / number
    # Rounding adds to both, and would hide that the noise is slow.
    noise = max(variance - COUNT_VARIANCE, 0.5 * variance)
    correlation = 1.0 - 0.5 * max(step - 2.0 * COUNT_VARIANCE, 0.0) / noise
    correlation = min(abs(correlation), STRONGEST_CORRELATION)
    square = correlation * correlation
    return float((1.0 - square) / (1.0 + square))


@kernel
def _log_likelihood(counts: CountsAtRest, axis: int, half: float, zero: float) -> float:
    """Return the log likelihood of the counts of an axis by the best normal noise.

    `half` a count is cut off, or nothing, and zero is what is up to `zero` counts. Expectation and
    maximisation lead there: the moments of what each count stands for, by those before.
    """
    _, mean, variance = moments_at_rest(counts, axis, half)
    result = 0.0
    for _ in range(ITERATIONS):
        deviation = math.sqrt(max(variance, LEAST_VARIANCE))
        result = number = means = squares = 0.0
        # The normal distribution up to the count, its density, and that times where it is.
        below = density_below = moment_below = 0.0
        for k in range(-LARGEST, LARGEST + 1):
            upto, density, moment = 1.0, 0.0, 0.0
            if k < LARGEST:
                place = (_upper_edge(k, half, zero) - mean) / deviation
                upto = 0.5 * math.erfc(-place / math.sqrt(2.0))
                density = math.exp(-0.5 * place * place) / math.sqrt(2.0 * math.pi)
                moment = place * density
            times, probability = 1.0 * counts['bins'][BINS * axis + LARGEST + k], upto - below
            if times > 0.0:
                result += times * math.log(max(probability, LEAST_PROBABILITY))
                if probability > LEAST_PROBABILITY:
                    number += times
                    means += times * (density_below - density) / probability
                    squares += times * (1.0 + (moment_below - moment) / probability)
            below, density_below, moment_below = upto, density, moment
        means /= max(number, 1.0)
        mean += deviation * means
        variance = deviation * deviation * (squares / max(number, 1.0) - means * means)
    return result


@kernel
def _upper_edge(count: int, half: float, zero: float) -> float:
    """Return up to where rates are given as a count; arguments as for `_log_likelihood`."""
    if count == 0 or count == -1:
        return zero if count == 0 else -zero
    return count + 0.5 + (half if count > 0 else -half)
