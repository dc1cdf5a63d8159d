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

"""What is known of the noise at rest, learned from the segments that hold together."""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.rest.records import SIGNALS, MeanSums, Rest, RestLengths, Signal
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    mean_square_step,
    scatter_of_means,
    segment_mean,
    value_variance,
)
from gyro_drift_filter.core.rest.spikes import forget_waiting
from gyro_drift_filter.core.sample import COUNT_VARIANCE

STRONGEST_CORRELATION = 0.9  # of the means of two blocks, one after the other
# The noise is learned with this weight per segment.
NOISE_LEARNING = 0.1
# The ratio of variances is learned slower, as a segment says less of it. It starts with the
# correlation of the first segment's blocks, which counts as RATIO_PRIOR + 1 segments; one step
# counts for LARGEST_RATIO_STEP at most.
RATIO_LEARNING, RATIO_PRIOR, LARGEST_RATIO_STEP = 0.02, 2.0, 16.0
# Of the variance of an acceleration at rest: with less, what has made the noise has stopped.
QUIETER = 0.25
# Of the variance of all signals: a body that stands shows a tenth to a hundredth of what it shows
# in motion, and noise by itself does not change so much.
FAR_QUIETER = 1.0 / 9.0
# The means of blocks vary by no more than their values say, where a machine shakes a body that
# stands. On the road they vary by eight times that and more.
LARGEST_EXCESS = 3.0


@kernel
def note_count(rest: Rest, signal: int, count: float) -> None:
    """Note what a count of a signal is worth in its unit, 0 where it is not known."""
    rest['signals'][signal]['least_variance'] = COUNT_VARIANCE * count * count


@kernel
def learn_noise_from_segment(rest: Rest, length: int) -> None:
    """Learn the noise from a segment that holds together."""
    rest['learned'] = rest['learned'] + 1 if rest['known'] else 1
    share = _weight(rest)
    ratio = _ratio_in_segment(rest, 3)
    if rest['learned'] == 1:
        rest['variance_ratio'], rest['acceleration_ratio'] = _ratio_in_segment(rest, 0), ratio
    rest['acceleration_ratio'] += _weight_of_ratio(rest) * (ratio - rest['acceleration_ratio'])
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        variance, scatter = _noise_of_segment(rest, signal, length)
        if rest['learned'] == 1:
            signal['variance'] = variance
            signal['scatter'] = scatter
        else:
            signal['variance'] += share * (variance - signal['variance'])
            signal['scatter'] += share * (scatter - signal['scatter'])
    rest['known'] = True
    forget_waiting(rest['waiting'])  # else it is one of long ago when the noise is forgotten
    if rest['learned'] > 1:
        rest['waiting']['spikes'] = 0
    rest['calm_known'] = False
    rest['blocks_since_rest'] = 0
    rest['standing_seconds'] = 0.0


@kernel
def _weight(rest: Rest) -> float:
    """Return the weight of the last segment that was learned from."""
    return max(NOISE_LEARNING, 1.0 / rest['learned'])


@kernel
def _noise_of_segment(rest: Rest, signal: Signal, length: int) -> tuple[float, float]:
    """Return the variance of values in blocks of `length`, and of the means of these."""
    variance = value_variance(rest, signal)
    return variance, max(scatter_of_means(signal['segment'], rest['blocks']), variance / length)


@kernel
def _weight_of_ratio(rest: Rest) -> float:
    """Return the weight of a ratio of variances that the last segment shows."""
    return max(RATIO_LEARNING, 1.0 / (rest['learned'] + RATIO_PRIOR))


@kernel
def _ratio_in_segment(rest: Rest, first: int) -> float:
    """Return the ratio of variances by the correlation of three signals, from `first` on."""
    correlation = 0.0
    for i in range(first, first + 3):
        correlation += correlation_of_means(rest['signals'][i]['segment'], rest['blocks']) / 3.0
    return ratio_by_correlation(correlation)


@kernel
def correlation_of_means(sums: MeanSums, blocks: int) -> float:
    """Return the correlation of the means of one block and the next, of so many in a row."""
    steps, scatter = mean_square_step(sums, blocks), scatter_of_means(sums, blocks)
    # Von Neumann's ratio, 2 for independent ones and for a coarse sensor that shows none.
    return 1.0 - 0.5 * (steps + 2.0 * LEAST_VARIANCE) / (scatter + LEAST_VARIANCE)


@kernel
def ratio_by_correlation(correlation: float) -> float:
    """Return how much more the mean of blocks varies than if they were independent.

    As if their correlation fell off exponentially from one block to the next.
    """
    correlation = min(max(correlation, 0.0), STRONGEST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)


@kernel
def learn_variance_ratio(rest: Rest) -> None:
    """Learn from how far the means of the segment and the one before lie apart."""
    ratio = 0.0
    for i in range(3):
        signal = rest['signals'][i]
        if signal['before_blocks'] == 0:
            return
        step = segment_mean(rest, i) - signal['before']
        spread = signal['scatter'] * (1.0 / rest['blocks'] + 1.0 / signal['before_blocks'])
        ratio += step * step / spread / 3.0
    change = min(ratio, LARGEST_RATIO_STEP) - rest['variance_ratio']
    rest['variance_ratio'] = max(rest['variance_ratio'] + _weight_of_ratio(rest) * change, 1.0)


@kernel
def forget_noise(rest: Rest) -> None:
    """Forget the noise: the next segment is judged as the first one was."""
    rest['known'] = rest['calm_known'] = False


@kernel
def doubt_noise(rest: Rest) -> None:
    """Forget the noise of the rates, and keep that of the accelerations as a bound."""
    rest['calm_known'] = rest['known'] or rest['calm_known']
    rest['known'] = False
    rest['blocks_since_rest'] = 0  # so that the bound holds for some time


@kernel
def expect_no_noise(rest: Rest) -> None:
    """Forget the noise, and take none of the accelerations for the bound of what is rest."""
    rest['known'] = False
    rest['calm_known'] = True
    rest['blocks_since_rest'] = 0
    for i in range(3, SIGNALS):
        rest['signals'][i]['variance'] = 0.0


@kernel
def is_calm(rest: Rest, signal: Signal) -> bool:
    """Return whether an acceleration varies in the segment about as it did when it was at rest."""
    variance = value_variance(rest, signal)
    return bool(not rest['calm_known'] or FAR_QUIETER * variance <= signal['variance'])


@kernel
def shows_motion(rest: Rest, length: int) -> bool:
    """Return whether the segment shows that what was taken for rest before it was motion.

    The signals vary far less than before, by the geometric mean of how much, and the means of one
    varied by more than its values said. The noise has been learned from the segment, in blocks of
    `length` values, which is undone here.
    """
    if rest['learned'] < 2:
        return False
    share, wandered = _weight(rest), False
    quieter = signals = 0.0
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        variance, scatter = _noise_of_segment(rest, signal, length)
        before = (signal['variance'] - share * variance) / (1.0 - share)
        scatter_before = (signal['scatter'] - share * scatter) / (1.0 - share)
        if before > 0.0:
            signals += 1.0
            quieter += math.log(max(variance / before, LEAST_VARIANCE))
            wandered = wandered or length * scatter_before > LARGEST_EXCESS * before
    return wandered and quieter < signals * math.log(FAR_QUIETER)


@kernel
def noise_level(rest: Rest, first: int) -> float:
    """Return the mean logarithm of the variance of three signals, from `first` on, in the segment.

    The variances are in (rad/s)^2, or in (m/s^2)^2 for the accelerations, from signal 3 on.
    """
    total = 0.0
    for i in range(first, first + 3):
        total += math.log(max(value_variance(rest, rest['signals'][i]), LEAST_VARIANCE))
    return total / 3.0


@kernel
def unlearn_first_segment(rest: Rest) -> None:
    """Forget the noise, if it is that of one segment alone, which was no rest."""
    if rest['learned'] == 1:
        rest['known'] = False


@kernel
def random_walk_of(rest: Rest, axis: int, lengths: RestLengths) -> float:
    """Return the variance in rad^2/s by which noise at rest turns an axis; 0 while not known."""
    return rest['signals'][axis]['scatter'] * lengths['block_seconds'] if rest['known'] else 0.0


@kernel
def segment_variance(rest: Rest, axis: int) -> float:
    """Return the variance of `segment_mean` of an axis of the gyroscope."""
    return variance_of_mean(rest, axis, rest['blocks'])


@kernel
def variance_of_mean(rest: Rest, axis: int, blocks: float) -> float:
    """Return the variance of the mean of so many blocks of an axis of the gyroscope."""
    return float(rest['variance_ratio'] * rest['signals'][axis]['scatter'] / blocks)


@kernel
def deviation_of_values(rest: Rest, signal: int) -> float:
    """Return the standard deviation of the values of a signal at rest; 0 while not known.

    In rad/s, or in m/s^2 for signals 3 to 5, which are the accelerations.
    """
    return math.sqrt(rest['signals'][signal]['variance']) if rest['known'] else 0.0


@kernel
def has_noise_of(rest: Rest, axis: int, deviation: float) -> bool:
    """Return whether an axis of the gyroscope has noise of more than a deviation in rad/s at rest.

    Where a motor has stopped it may have none any more, and then the accelerometer has less, too.
    """
    if not rest['known'] or rest['signals'][axis]['variance'] <= deviation * deviation:
        return False
    for i in range(3, SIGNALS):
        signal = rest['signals'][i]
        if signal['waiting_variance'] > QUIETER * signal['variance']:
            return True
    return False
