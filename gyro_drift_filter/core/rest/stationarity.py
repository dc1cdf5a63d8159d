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

"""Whether a block, and a segment of them, can be those of a body at rest."""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.matrices import vector_length
from gyro_drift_filter.core.rest.noise import is_calm
from gyro_drift_filter.core.rest.records import (
    BLOCK_SECONDS,
    HALF,
    SIGNALS,
    Obstacle,
    Rest,
    RestLengths,
    Signal,
)
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    block_moments,
    mean_of,
    mean_square_step,
    scatter_of_means,
    segment_mean,
    value_variance,
)
from gyro_drift_filter.core.rest.standing import LEAST_GRAVITY

# A block is noise up to a variance of 1 + so many deviations of the variance of n values. With 8,
# one of some 100,000 blocks of plain noise would exceed it, and a short rest be lost.
VARIANCE_DEVIATIONS = 10.0
# So does the scatter of the means of a segment.
SCATTER_DEVIATIONS = 8.0
# A mean lies with the others within so many deviations of the scatter of means.
MEAN_DEVIATIONS = 5.0
# Of the means of a segment's halves. Rates differ where a slow turn begins or ends, gravity while
# one lasts that is not about the vertical.
HALVES_DEVIATIONS = 4.0
# Blocks of accelerations follow each other where their noise is slow, and where a roll was taken
# for rest. So the ratio of variances counts up to that of noise behind a low-pass of 1 Hz.
LARGEST_ACCELERATION_RATIO = 4.0
# The means of a slow turn scatter more than white values say, and differ little from one to the
# next.
LARGEST_SMOOTH, LEAST_STEPS = 2.0, 0.16
FIRST_HALVES_DEVIATIONS = 6.0  # while the noise is not known, where it is correlated over blocks
# Of two segments' means of gravity, one after the other.
GRAVITY_DEVIATIONS = 6.0
# What has changed an acceleration by less, in g, may be the accelerometer: one that is shaken shows
# another mean, by some hundredths of g.
LEAST_PUSH = 0.02
# Of a change along the ground, the share by which an accelerometer shows gravity larger or smaller:
# its offset, over g.
LARGEST_OFFSET = 0.03
# While the noise is not known, the values of one half may vary by so much more than those of the
# other: a hand that comes to rest trembles a hundred times as much before as after.
LARGEST_RATIO_OF_HALVES = 9.0
# While the noise is not known, the means may scatter as those of the noisiest sensors and of a
# running motor: less than this if averaged over a second, and by the root of the time more if over
# less. It is an angle random walk of 34 deg/sqrt(h), some 25 times that of a cheap gyroscope; a
# body in motion has five times as much. The second is that of gravity. Noise that is correlated
# within a block may scatter less: it has passed a low-pass, and a hand that holds the sensor sways
# like that.
LARGEST_RANDOM_WALK = 0.01  # rad/s^(1/2)
LARGEST_VELOCITY_RANDOM_WALK = 0.1  # m/s^(3/2)
# Of means that alternate, the share of their scatter that counts at least: a body that is swung to
# and fro has a thousand times as much.
LEAST_SLOW_SHARE = 0.25
# Before anything is known a segment is steady, as of a drone that idles, where its mean has so
# small a deviation (rad/s), by the scatter of its blocks, and gravity scatters by less (m/s^2). In
# a hand rates are ten times as unsteady.
STEADY_DEVIATION, STEADY_GRAVITY_SCATTER = 3e-3, 0.15
# Its rate is no turn where gravity moves by less than this share of what the turn would move it, or
# by less than this in m/s^2, or by less than so many deviations of its own noise.
TURN_SHARE, LEAST_TURN, TURN_DEVIATIONS = 0.25, 0.05, 2.0


@kernel
def obstacle_of_block(rest: Rest, index: int) -> Obstacle:
    """Return what of signal `index` shows that the block is no noise, as far as that is known."""
    if not rest['known']:
        return Obstacle.NONE
    signal, count = rest['signals'][index], rest['count']
    mean, variance = block_moments(rest, index)
    usual, scatter = _noise_in_blocks(signal, 1.0 * count)
    alike = _alike_values(scatter, usual, 1.0 * count)
    if variance > _variance_limit(alike, 1.0 * count) * usual:
        return Obstacle.VARIES
    blocks = rest['blocks']
    if blocks == 0:
        return Obstacle.NONE
    distance = mean - mean_of(signal['segment'], blocks)
    spread = scatter * (1.0 + 1.0 / blocks)
    return Obstacle.MOVED if is_beyond_gate(distance, MEAN_DEVIATIONS, spread) else Obstacle.NONE


@kernel
def _noise_in_blocks(signal: Signal, count: float) -> tuple[float, float]:
    """Return the variance of values at rest, and of the means of blocks of `count`.

    The rounding to counts is in it, as in that of each block: the noise may have been learned from
    one and the same value, before another one has shown the count.
    """
    least = signal['least_variance']
    return max(signal['variance'], least), max(signal['scatter'], least / count)


@kernel
def holds_together(rest: Rest, lengths: RestLengths) -> bool:
    """Return whether the means of the segment scatter as noise does, and gravity stands.

    What shows that they do not is noted.
    """
    for i in range(SIGNALS):
        obstacle = _obstacle_of_segment(rest, i, lengths)
        if obstacle != Obstacle.NONE:
            note_obstacle(rest, obstacle, i)
            return False
    return True


@kernel
def note_obstacle(rest: Rest, obstacle: Obstacle, signal: int) -> None:
    """Note why a block or a segment is no rest.

    Where samples are missing, the last motion is the one before them.
    """
    if obstacle != Obstacle.FEW_SAMPLES:
        rest['sudden'] = obstacle == Obstacle.VARIES or obstacle == Obstacle.HINTED_MOTION
    rest['obstacle'] = obstacle
    rest['obstacle_signal'] = signal


@kernel
def _obstacle_of_segment(rest: Rest, index: int, lengths: RestLengths) -> Obstacle:
    """Return what of signal `index` shows that the segment is no rest."""
    signal = rest['signals'][index]
    if rest['known']:
        _, scatter = _noise_in_blocks(signal, 1.0 * lengths['block'])
        limit = 1.0 + SCATTER_DEVIATIONS * math.sqrt(2.0 / (rest['blocks'] - 1.0))
        if scatter_of_means(signal['segment'], rest['blocks']) > limit * scatter:
            return Obstacle.SCATTERS
        ratio = rest['variance_ratio']
        if index >= 3:
            ratio = min(rest['acceleration_ratio'], LARGEST_ACCELERATION_RATIO)
        if _halves_differ(rest, signal, ratio * scatter, HALVES_DEVIATIONS):
            return Obstacle.DRIFTS
    else:
        obstacle = _obstacle_of_first(rest, index, lengths)
        if obstacle != Obstacle.NONE:
            return obstacle
        if index >= 3 and not is_calm(rest, signal):
            return Obstacle.LOUD
    if index >= 3 and signal['before_blocks'] > 0:
        blocks = 1.0 * rest['blocks']
        step = segment_mean(rest, index) - signal['before']
        spread = signal['scatter'] * (1.0 / blocks + 1.0 / signal['before_blocks'])
        if is_beyond_gate(step, GRAVITY_DEVIATIONS, spread):
            return Obstacle.TILTED
    if index >= 3 and _is_pushed(rest, index):
        return Obstacle.PUSHED
    return Obstacle.NONE


@kernel
def _is_pushed(rest: Rest, index: int) -> bool:
    """Return whether acceleration `index` has changed since the last rest without a turn.

    Gravity moves by no more than the body turns: the rest of the change is a speed that grows. An
    acceleration along the ground makes gravity larger. So where it has become less, it was the rest
    before that was none.
    """
    signals = rest['signals']
    x, y, z = segment_mean(rest, 3), segment_mean(rest, 4), segment_mean(rest, 5)
    before = vector_length(signals[3]['before'], signals[4]['before'], signals[5]['before'])
    change = vector_length(
        x - signals[3]['before'], y - signals[4]['before'], z - signals[5]['before']
    )
    is_less = vector_length(x, y, z) < before - LARGEST_OFFSET * change
    if before < LEAST_GRAVITY or is_less:
        return False
    step = segment_mean(rest, index) - signals[index]['before']
    noise = GRAVITY_DEVIATIONS * math.sqrt(2.0 * signals[index]['scatter'] / rest['blocks'])
    return bool(abs(step) > before * (LEAST_PUSH + _largest_turn(rest)) + noise)


@kernel
def _largest_turn(rest: Rest) -> float:
    """Return by how much the body can have turned since the last rest, in rad.

    Turns in a row lead no further than the sum of their sizes s, and than the size of their sum and
    s^2 / 2, as they do not commute. What is less than a count of the gyroscope does not show.
    """
    signals, turn, sizes = rest['signals'], rest['turn'], rest['turned']
    rounding = 0.0
    for axis in range(3):
        rounding += signals[axis]['least_variance']
    unseen = math.sqrt(rounding) * rest['seconds_since_segment']
    size_of_sum = vector_length(turn[0], turn[1], turn[2])
    return float(min(sizes, size_of_sum + 0.5 * sizes * sizes) + unseen)


@kernel
def _obstacle_of_first(rest: Rest, index: int, lengths: RestLengths) -> Obstacle:
    """Return what of signal `index` can't be that of a body at rest, with noise of any spectrum."""
    signal, length = rest['signals'][index], 1.0 * lengths['block']
    scatter = scatter_of_means(signal['segment'], rest['blocks'])
    walk = LARGEST_RANDOM_WALK if index < 3 else LARGEST_VELOCITY_RANDOM_WALK
    variance = value_variance(rest, signal)
    alike = _alike_values(scatter, variance, length)
    limit = _variance_limit(alike, length)
    # By the differences of means that follow each other, which a slow turn leaves as they are.
    step_variance = 0.5 * mean_square_step(signal['segment'], rest['blocks'])
    deviations = min(HALVES_DEVIATIONS * math.sqrt(alike), FIRST_HALVES_DEVIATIONS)
    if alike > LARGEST_SMOOTH and _is_smooth(step_variance, scatter):
        return Obstacle.DRIFTS
    # A vibration that the blocks alias makes the means alternate, which leads nowhere: those of two
    # blocks each scatter less than by half.
    slow_scatter = max(min(scatter, 2.0 * scatter - step_variance), LEAST_SLOW_SHARE * scatter)
    correlated = max(min(alike, length * BLOCK_SECONDS / lengths['block_seconds']), 1.0)
    if not slow_scatter * correlated <= walk * walk / lengths['block_seconds']:
        return Obstacle.SCATTERS
    largest = max(signal['largest_variance'], signal['early_largest_variance'])
    if not largest <= limit * variance or _halves_vary_unlike(rest, signal):
        return Obstacle.UNEVEN
    if _halves_differ(rest, signal, max(step_variance, variance / length), deviations):
        return Obstacle.DRIFTS
    return Obstacle.NONE


@kernel
def _halves_differ(rest: Rest, signal: Signal, scatter: float, deviations: float) -> bool:
    """Return whether the mean of the segment moves from its first half to its second."""
    late = rest['blocks'] - HALF
    if late <= 0:
        return False
    late_means = signal['segment']['means'] - signal['early_means']
    step = late_means / late - signal['early_means'] / HALF
    spread = scatter * (1.0 / HALF + 1.0 / late)
    return is_beyond_gate(step, deviations, spread)


@kernel
def _halves_vary_unlike(rest: Rest, signal: Signal) -> bool:
    """Return whether the values vary far less in one half of the segment than in the other."""
    early = signal['early_variances'] / HALF
    late = (signal['variances'] - signal['early_variances']) / (rest['blocks'] - HALF)
    return bool(max(early, late) > LARGEST_RATIO_OF_HALVES * min(early, late))


@kernel
def _is_smooth(step_variance: float, scatter: float) -> bool:
    """Return whether means that scatter differ little from one to the next, as in a slow turn."""
    return step_variance < LEAST_STEPS * scatter


@kernel
def _alike_values(scatter: float, variance: float, count: float) -> float:
    """Return how many values of a block of `count` are alike, by how much its mean varies."""
    return min(max(0.5 * scatter * count / variance, 1.0), count)


@kernel
def _variance_limit(alike: float, count: float) -> float:
    """Return how much more a block of `count` values may vary than the noise does."""
    return 1.0 + VARIANCE_DEVIATIONS * math.sqrt(2.0 * alike / (count - 1.0))


@kernel
def is_steady(rest: Rest) -> bool:
    """Return whether the means of the segment scatter about one value, and little."""
    blocks = 1.0 * rest['blocks']
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        scatter = scatter_of_means(signal['segment'], rest['blocks'])
        limit = STEADY_DEVIATION * STEADY_DEVIATION * blocks
        if i >= 3:
            limit = STEADY_GRAVITY_SCATTER * STEADY_GRAVITY_SCATTER
        step_variance = 0.5 * mean_square_step(signal['segment'], rest['blocks'])
        if scatter > limit or (scatter > LEAST_VARIANCE and _is_smooth(step_variance, scatter)):
            return False
    return True


@kernel
def tilts(rest: Rest, block_seconds: float) -> bool:
    """Return whether gravity moves with the mean rate of the segment, which is a turn then."""
    seconds = (rest['blocks'] - 1.0) * block_seconds
    square = unexplained = noise = 0.0
    for axis in range(3):
        after, behind = (axis + 1) % 3, (axis + 2) % 3
        gravity = rest['signals'][3 + axis]['segment']
        change = gravity['last'] - gravity['first']
        # g' = g x w, for a turn at the rate w
        expected = segment_mean(rest, 3 + after) * segment_mean(rest, behind)
        expected -= segment_mean(rest, 3 + behind) * segment_mean(rest, after)
        square += change * change
        unexplained += (change - expected * seconds) * (change - expected * seconds)
        noise += mean_square_step(gravity, rest['blocks'])
    largest = max(TURN_SHARE * math.sqrt(unexplained), TURN_DEVIATIONS * math.sqrt(noise))
    largest = max(largest, LEAST_TURN)
    return bool(math.sqrt(square) > largest)
