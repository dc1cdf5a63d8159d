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

"""Where the sensor stands still, judged against its own noise on all axes at once.

Gyroscope and accelerometer give six signals. Each is averaged over hundredths of a second, "values"
below, so that all sample rates are alike, and cut into blocks of an eighth of a second. Blocks that
stand still are gathered into segments of up to two seconds. A block stands still where, on every
signal,

- the values vary about the block's mean no more than the noise does, and
- the mean lies where those of the segment lie, as far as the noise allows.

The first and the last block of a rest are left out: motion begins and ends gently. Of a segment
that does not hold together the later half is kept: rest may begin with a turn, or where a hand has
just let go, and of a thousand segments of plain rest one or two look like that. If the rest is over
before there is another segment, that half counts, once the noise is known.

What the noise is on each signal, within blocks and from block to block, is learned from segments
that hold together. The first one may have noise of any spectrum: what tells it is that no mean
moves from its first half to its second, neither of a rate nor of gravity, by the scatter that this
sensor's own means have, that the values vary alike in both halves, and that this scatter is one
that a body at rest can have. Noise that is correlated varies more from block to block, and so may
blocks and segments of it. A vibration that comes later counts as noise after some minutes. How much
more the means of segments vary than the blocks within them say, as slow noise makes them, is begun
with the correlation of one block and the next, and learned from one segment to the next.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Annotated, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, Sample

VALUE_SECONDS = 0.01
BLOCK_SECONDS = 0.125
LEAST_BLOCK = 8  # values
SEGMENT_BLOCKS = 16
HALF = 8  # blocks
LEAST_SEGMENT = 4  # blocks: half a second, at the end of a rest

# A block varies as noise does up to 1 + so many deviations of a variance of n values.
# With 8, one of some 100,000 blocks of plain noise is none, and a short rest lost.
VARIANCE_DEVIATIONS = 10.0
# So does the scatter of the means of a segment.
SCATTER_DEVIATIONS = 8.0
# A mean lies with the others within so many deviations of the scatter of means.
MEAN_DEVIATIONS = 5.0
# Of the means of a segment's halves, which differ where a slow turn begins or ends.
HALVES_DEVIATIONS = 4.0
# The means of a slow turn scatter more than white values say, and differ little from one to the
# next.
LARGEST_SMOOTH, LEAST_STEPS = 2.0, 0.16
FIRST_HALVES_DEVIATIONS = 6.0  # while the noise is not known, where it is correlated over blocks
# Of two segments' means of gravity, one after the other.
GRAVITY_DEVIATIONS = 6.0
# While the noise is not known, the values of one half may vary by so much more than those of the
# other: a hand that comes to rest trembles a hundred times as much before as after.
LARGEST_RATIO_OF_HALVES = 9.0
# While the noise is not known, the means may scatter as the noisiest sensors and a running motor
# make them: by less than this where they are averages over a second, and by the root of the time
# more where they are of less. It is an angle random walk of 34 deg/sqrt(h), some 25 times that of a
# cheap gyroscope; a body in motion has five times as much. The same for gravity. Noise that is
# correlated over a part of BLOCK_SECONDS has passed a low-pass, and so is less: a hand that holds
# the sensor sways like that.
LARGEST_RANDOM_WALK = 0.01  # rad/s^(1/2)
LARGEST_VELOCITY_RANDOM_WALK = 0.1  # m/s^(3/2)
# Of means that alternate, the share of their scatter that counts at least: a body that is swung to
# and fro has a thousand times as much.
LEAST_SLOW_SHARE = 0.25
STRONGEST_CORRELATION = 0.9  # of the means of two blocks, one after the other
# Of a signal in its unit squared: a coarse sensor shows none at rest. One whose counts are known
# has that of a value anywhere within a count.
LEAST_VARIANCE, COUNT_VARIANCE = 1e-10, 1.0 / 12.0
# The noise is learned with this weight per segment.
LEARNING = 0.1
# Before anything is known a segment of so many blocks is steady, as of a drone that idles, where
# its mean has so small a deviation (rad/s), by the scatter of its blocks, and gravity scatters by
# less. In a hand rates are ten times as unsteady.
LEAST_STEADY_BLOCKS = 6
STEADY_DEVIATION, STEADY_GRAVITY_SCATTER = 3e-3, 0.15
# Its rate is no turn where gravity moves by less than this share of what the turn would move it, or
# by less than this in m/s^2, or by less than so many deviations of its own noise.
TURN_SHARE, LEAST_TURN, TURN_DEVIATIONS = 0.25, 0.05, 2.0
# Gravity stands where the means of blocks stay within this, a tilt of a degree, and is that.
STEADY_GRAVITY, LEAST_GRAVITY = 0.2, 5.0  # m/s^2
# The ratio of variances is learned slower, as a segment says less of it. It starts at one, as if
# the first segments and so many more had said so, and one step counts for so large a ratio at most.
RATIO_LEARNING, RATIO_PRIOR, LARGEST_RATIO = 0.02, 2.0, 16.0
# After so long without rest all that is learned anew, as vibration may have come to stay.
FORGOTTEN_SECONDS = 300.0

# Of the variance of an acceleration at rest: with less, what has made the noise has stopped.
QUIETER = 0.25

SIGNALS = 6


class Signal(TypedDict):
    """One of the six signals: what is known of its noise, and the sums under way."""

    least_variance: float
    variance: float  # of values about their block's mean
    scatter: float  # variance of the means of blocks
    value: float  # sum over the value under way
    # the block under way, and the one before, which waits for the verdict on this one
    origin: float
    sum: float
    squares: float
    waiting_mean: float
    waiting_variance: float
    # the segment
    means: float  # sum of means less the first one
    mean_squares: float
    variances: float
    largest_variance: float  # of the half under way; read only where the noise is not known yet
    steps: float  # sum of squared differences of one mean and the next
    last: float  # mean of the last block
    first: float  # mean of the first block
    # of the first `HALF` blocks of the segment
    early_means: float
    early_mean_squares: float
    early_variances: float
    early_largest_variance: float
    early_steps: float
    # the segment before in the same rest
    before: float
    before_blocks: int


SIGNAL = record(Signal)


class Halves(IntEnum):
    """What became of the halves of a segment that did not hold together."""

    WHOLE = 0  # there was no such segment
    LATER = 1  # this segment begins with the later half of it
    LEFT_BEHIND = 2  # that half has been left behind, up to the end of this segment


class Rest(TypedDict):
    """The rest under way, and what is known of the noise."""

    signals: Annotated[Sequence[Signal], SIGNAL, (SIGNALS,)]
    known: bool  # what the noise is
    learned: int  # segments that it was learned from
    # of the means of the gyroscope's segments, to what the scatter of their blocks says
    variance_ratio: float
    restless: int  # blocks since the last rest
    steady_seconds: float  # since then, for which gravity has stood
    gravity: PerAxis  # m/s^2, when it began to
    at_rest: bool
    samples: int  # since the start of the value, missing ones among them
    accepted: int  # of them
    index: int  # values since the start of the block, missing ones among them
    count: int  # values in it
    run: int  # still blocks in a row
    blocks: int  # in the segment
    halves: int  # a member of Halves


class RestLengths(TypedDict):
    """Lengths for one sample period."""

    value: int  # samples that are averaged to a value
    block: int  # values in a block
    block_seconds: float


class BlockOutcome(IntEnum):
    """What a block brought."""

    NOTHING = 0
    SEGMENT = 1  # a segment is ready
    END_OF_REST = 2  # the block ended the rest, and what there is of the segment is ready
    STEADY = 3  # the segment under way is steady, if not known as rest yet


REST = record(Rest)
REST_LENGTHS = record(RestLengths)


@kernel
def derive_lengths(period: float, lengths: RestLengths) -> None:
    """Fill the lengths for a sample period in s."""
    lengths['value'] = max(1, int(VALUE_SECONDS / period + 0.5))
    seconds = lengths['value'] * period
    lengths['block'] = max(LEAST_BLOCK, int(BLOCK_SECONDS / seconds + 0.5))
    lengths['block_seconds'] = lengths['block'] * seconds


@kernel
def least_rest(lengths: RestLengths) -> float:
    """Return for how long in s a sensor stands still until it is found at rest the first time."""
    # A block before the segment and one after it are left out.
    return (SEGMENT_BLOCKS + 2) * lengths['block_seconds']


@kernel
def note_count(rest: Rest, axis: int, count: float) -> None:
    """Note what a count of an axis of the gyroscope is worth in rad/s, 0 where it is not known."""
    rest['signals'][axis]['least_variance'] = COUNT_VARIANCE * count * count


@kernel
def start_rest(rest: Rest) -> None:
    """Forget the rest under way; what is known of the noise is kept."""
    rest['at_rest'] = False
    rest['run'] = 0
    _start_value(rest)
    _start_block(rest)
    _start_segment(rest)
    _forget_before(rest)


@kernel
def has_stood_still(rest: Rest, blocks: int) -> bool:
    """Return whether this is rest, or has been still for so many blocks in a row.

    A steady turn that is no bias is still, too: what is noise shows as well in it.
    """
    return bool(rest['at_rest'] or (rest['known'] and rest['run'] >= blocks))


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


@kernel
def _start_block(rest: Rest) -> None:
    rest['index'] = 0
    rest['count'] = 0
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['sum'] = 0.0
        signal['squares'] = 0.0


@kernel
def _start_value(rest: Rest) -> None:
    rest['samples'] = 0
    rest['accepted'] = 0
    for i in range(SIGNALS):
        rest['signals'][i]['value'] = 0.0


@kernel
def _start_segment(rest: Rest) -> None:
    rest['blocks'] = 0
    rest['halves'] = Halves.WHOLE
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['means'] = 0.0
        signal['mean_squares'] = 0.0
        signal['variances'] = 0.0
        signal['largest_variance'] = 0.0
        signal['early_largest_variance'] = 0.0
        signal['steps'] = 0.0


@kernel
def note_sample(
    rest: Rest, sample: Sample, accepted: bool, missing: int, lengths: RestLengths
) -> bool:
    """Take a sample in, with `missing` ones before it, which count as time alone.

    An acceleration that is no number or beyond all sensors counts as zero: who has none has none
    all the time. Returns whether a block is complete, so that `close_block` has to be called.
    """
    rate, acceleration = sample['angular_velocity'], sample['linear_acceleration']
    rest['samples'] += 1 + missing
    if accepted:
        rest['accepted'] += 1
        for axis in range(3):
            gyroscope, accelerometer = rest['signals'][axis], rest['signals'][3 + axis]
            gyroscope['value'] += rate[axis] if abs(rate[axis]) < np.inf else 0.0
            force = acceleration[axis]
            accelerometer['value'] += force if abs(force) <= LARGEST_ACCELERATION else 0.0
    if rest['samples'] < lengths['value']:
        return False
    # Without missing samples it is one: the division is for the others, as it takes its time.
    rest['index'] += rest['samples'] // lengths['value'] if missing > 0 else 1
    if 2 * rest['accepted'] >= rest['samples']:
        _note_value(rest)
    _start_value(rest)
    return bool(rest['index'] >= lengths['block'])


@kernel
def _note_value(rest: Rest) -> None:
    rest['count'] += 1
    share = 1.0 / rest['accepted']
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        value = signal['value'] * share
        if rest['count'] == 1:
            signal['origin'] = value
        deviation = value - signal['origin']
        signal['sum'] += deviation
        signal['squares'] += deviation * deviation


@kernel
def close_block(rest: Rest, lengths: RestLengths) -> BlockOutcome:
    """Judge a full block.

    Returns:
        What it brought. Where a segment is ready, `segment_mean` can be read, and `next_segment`
        has to be called.
    """
    length = lengths['block']
    still = 2 * rest['count'] >= length
    if still:
        for i in range(SIGNALS):
            if not _is_still(rest, rest['signals'][i]):
                still = False
        _note_gravity(rest, lengths)
    rest['restless'] += 1
    if rest['restless'] * lengths['block_seconds'] > FORGOTTEN_SECONDS:
        rest['known'] = False
    if not still:
        ready = _lasted(rest) and _holds_together(rest, lengths)
        rest['at_rest'] = False
        rest['run'] = 0
        _start_block(rest)
        if ready:
            return BlockOutcome.END_OF_REST
        _start_segment(rest)
        _forget_before(rest)
        return BlockOutcome.NOTHING
    if rest['run'] >= 2:
        _add_to_segment(rest)
    rest['run'] += 1
    _let_wait(rest)
    _start_block(rest)
    if rest['blocks'] < SEGMENT_BLOCKS:
        if rest['known'] or rest['blocks'] < LEAST_STEADY_BLOCKS:
            return BlockOutcome.NOTHING
        steady = _is_steady(rest) and not _tilts(rest, lengths['block_seconds'])
        return BlockOutcome.STEADY if steady else BlockOutcome.NOTHING
    if rest['halves'] == Halves.LATER:
        _drop_early_half(rest)
        rest['halves'] = Halves.LEFT_BEHIND
        return BlockOutcome.NOTHING
    rest['halves'] = Halves.WHOLE
    if not _holds_together(rest, lengths):
        rest['at_rest'] = False
        _forget_before(rest)
        _drop_early_half(rest)
        rest['halves'] = Halves.LATER if rest['known'] else Halves.WHOLE
        rest['run'] = 2
        return BlockOutcome.NOTHING
    _learn(rest, length)
    return BlockOutcome.SEGMENT


@kernel
def _note_gravity(rest: Rest, lengths: RestLengths) -> None:
    """Note for how long gravity has stood, whatever the rates do."""
    gravity, size, moved = rest['gravity'], 0.0, False
    for axis in range(3):
        mean, _ = _block(rest, rest['signals'][3 + axis])
        size += mean * mean
        if abs(mean - gravity[axis]) > STEADY_GRAVITY:
            moved = True
    rest['steady_seconds'] += lengths['block_seconds']
    if moved:
        for axis in range(3):
            gravity[axis], _ = _block(rest, rest['signals'][3 + axis])
    if moved or size < LEAST_GRAVITY * LEAST_GRAVITY:
        rest['steady_seconds'] = 0.0


@kernel
def _lasted(rest: Rest) -> bool:
    """Return whether the segment that a motion has ended is long enough to count as rest."""
    if rest['at_rest']:
        return bool(rest['blocks'] >= LEAST_SEGMENT)
    begun = rest['halves'] != Halves.WHOLE and rest['blocks'] >= HALF + LEAST_SEGMENT
    return bool(rest['known'] and begun)


@kernel
def _drop_early_half(rest: Rest) -> None:
    """Make the later half of the segment the first one of the next."""
    rest['blocks'] -= HALF
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['means'] -= signal['early_means']
        signal['mean_squares'] -= signal['early_mean_squares']
        signal['variances'] -= signal['early_variances']
        signal['steps'] -= signal['early_steps']
    _note_half(rest)


@kernel
def _is_still(rest: Rest, signal: Signal) -> bool:
    """Return whether the block is noise, as far as the noise is known."""
    if not rest['known']:
        return True
    count = rest['count']
    mean, variance = _block(rest, signal)
    alike = _alike_values(signal['scatter'], signal['variance'], 1.0 * count)
    if variance > _variance_limit(alike, 1.0 * count) * signal['variance']:
        return False
    blocks = rest['blocks']
    if blocks == 0:
        return True
    distance = mean - (signal['first'] + signal['means'] / blocks)
    spread = signal['scatter'] * (1.0 + 1.0 / blocks)
    return bool(distance * distance <= MEAN_DEVIATIONS * MEAN_DEVIATIONS * spread)


@kernel
def _block(rest: Rest, signal: Signal) -> tuple[float, float]:
    """Return mean and variance of the block."""
    count = 1.0 * rest['count']
    mean = signal['sum'] / count
    variance = (signal['squares'] - mean * signal['sum']) / (count - 1.0)
    return signal['origin'] + mean, max(variance, signal['least_variance'], LEAST_VARIANCE)


@kernel
def _let_wait(rest: Rest) -> None:
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        mean, variance = _block(rest, signal)
        signal['waiting_mean'] = mean
        signal['waiting_variance'] = variance


@kernel
def _add_to_segment(rest: Rest) -> None:
    """Take the waiting block into the segment."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        mean, variance = signal['waiting_mean'], signal['waiting_variance']
        if rest['blocks'] == 0:
            signal['first'] = mean
        else:
            step = mean - signal['last']
            signal['steps'] += step * step
        signal['last'] = mean
        deviation = mean - signal['first']
        signal['means'] += deviation
        signal['mean_squares'] += deviation * deviation
        signal['variances'] += variance
        signal['largest_variance'] = max(signal['largest_variance'], variance)
    rest['blocks'] += 1
    if rest['blocks'] == HALF:
        _note_half(rest)


@kernel
def _note_half(rest: Rest) -> None:
    """Keep the sums of the segment, which has its first half."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        signal['early_means'] = signal['means']
        signal['early_mean_squares'] = signal['mean_squares']
        signal['early_variances'] = signal['variances']
        signal['early_largest_variance'] = signal['largest_variance']
        signal['largest_variance'] = 0.0
        signal['early_steps'] = signal['steps']


@kernel
def segment_mean(rest: Rest, index: int) -> float:
    """Return the mean of signal `index` over the segment."""
    signal = rest['signals'][index]
    return float(signal['first'] + signal['means'] / rest['blocks'])


@kernel
def first_mean(rest: Rest, index: int) -> float:
    """Return the mean of signal `index` over the first block of the segment."""
    return float(rest['signals'][index]['first'])


@kernel
def last_mean(rest: Rest, index: int) -> float:
    """Return the mean of signal `index` over the last block of the segment."""
    return float(rest['signals'][index]['last'])


@kernel
def random_walk_of(rest: Rest, axis: int, lengths: RestLengths) -> float:
    """Return the variance in rad^2/s by which noise at rest turns an axis; 0 while not known."""
    return rest['signals'][axis]['scatter'] * lengths['block_seconds'] if rest['known'] else 0.0


@kernel
def value_variance(rest: Rest, index: int) -> float:
    """Return the variance of values about the mean of their block, of signal `index`."""
    return float(rest['signals'][index]['variances'] / rest['blocks'])


@kernel
def forget_noise(rest: Rest) -> None:
    """Forget the noise: from now on a value is a mean of fewer samples."""
    rest['known'] = False


@kernel
def unlearn_first_segment(rest: Rest) -> None:
    """Forget the noise, if it is that of one segment alone, which was no rest."""
    if rest['learned'] == 1:
        rest['known'] = False


@kernel
def segment_variance(rest: Rest, axis: int) -> float:
    """Return the variance of `segment_mean` of an axis of the gyroscope."""
    return variance_of_mean(rest, axis, rest['blocks'])


@kernel
def variance_of_mean(rest: Rest, axis: int, blocks: float) -> float:
    """Return the variance of the mean of so many blocks of an axis of the gyroscope."""
    return float(rest['variance_ratio'] * rest['signals'][axis]['scatter'] / blocks)


@kernel
def next_segment(rest: Rest, moved: bool) -> None:
    """Begin the next segment; `moved` where the rest is over."""
    if moved:
        _forget_before(rest)
    else:
        _learn_variance_ratio(rest)
        rest['at_rest'] = True
        for i in range(SIGNALS):
            rest['signals'][i]['before'] = segment_mean(rest, i)
            rest['signals'][i]['before_blocks'] = rest['blocks']
    _start_segment(rest)


@kernel
def _learn_variance_ratio(rest: Rest) -> None:
    """Learn from how far the means of the segment and the one before lie apart."""
    ratio = 0.0
    for i in range(3):
        signal = rest['signals'][i]
        if signal['before_blocks'] == 0:
            return
        step = segment_mean(rest, i) - signal['before']
        spread = signal['scatter'] * (1.0 / rest['blocks'] + 1.0 / signal['before_blocks'])
        ratio += step * step / spread / 3.0
    share = max(RATIO_LEARNING, 1.0 / (rest['learned'] + RATIO_PRIOR))
    change = min(ratio, LARGEST_RATIO) - rest['variance_ratio']
    rest['variance_ratio'] = max(rest['variance_ratio'] + share * change, 1.0)


@kernel
def _forget_before(rest: Rest) -> None:
    for i in range(SIGNALS):
        rest['signals'][i]['before_blocks'] = 0


@kernel
def _scatter(rest: Rest, signal: Signal) -> float:
    """Return the variance of the means in the segment."""
    blocks = 1.0 * rest['blocks']
    squares = signal['mean_squares'] - signal['means'] * signal['means'] / blocks
    return float(max(squares, 0.0) / (blocks - 1.0))


@kernel
def _holds_together(rest: Rest, lengths: RestLengths) -> bool:
    """Return whether the means of the segment scatter as noise does, and gravity stands."""
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        if rest['known']:
            limit = 1.0 + SCATTER_DEVIATIONS * math.sqrt(2.0 / (rest['blocks'] - 1.0))
            if _scatter(rest, signal) > limit * signal['scatter']:
                return False
            scatter = signal['scatter'] * rest['variance_ratio']
            if i < 3 and _has_halves(rest, signal, scatter, HALVES_DEVIATIONS):
                return False
        elif not _is_stationary(rest, i, lengths):
            return False
        if i >= 3 and signal['before_blocks'] > 0:
            blocks = 1.0 * rest['blocks']
            step = signal['first'] + signal['means'] / blocks - signal['before']
            spread = signal['scatter'] * (1.0 / blocks + 1.0 / signal['before_blocks'])
            if step * step > GRAVITY_DEVIATIONS * GRAVITY_DEVIATIONS * spread:
                return False
    return True


@kernel
def _is_stationary(rest: Rest, index: int, lengths: RestLengths) -> bool:
    """Return whether signal `index` can be that of a body at rest, with noise of any spectrum."""
    signal, length = rest['signals'][index], 1.0 * lengths['block']
    scatter = _scatter(rest, signal)
    walk = LARGEST_RANDOM_WALK if index < 3 else LARGEST_VELOCITY_RANDOM_WALK
    variance = signal['variances'] / rest['blocks']
    alike = _alike_values(scatter, variance, length)
    limit = _variance_limit(alike, length)
    # By the differences of means that follow each other, which a slow turn leaves as they are.
    steps = 0.5 * signal['steps'] / (rest['blocks'] - 1.0)
    deviations = min(HALVES_DEVIATIONS * math.sqrt(alike), FIRST_HALVES_DEVIATIONS)
    smooth = alike > LARGEST_SMOOTH and _is_smooth(rest, signal, scatter)
    # A vibration that the blocks alias makes the means alternate, which leads nowhere: those of two
    # blocks each scatter less than by half.
    slow_scatter = max(min(scatter, 2.0 * scatter - steps), LEAST_SLOW_SHARE * scatter)
    correlated = max(min(alike, length * BLOCK_SECONDS / lengths['block_seconds']), 1.0)
    return (
        not smooth
        and slow_scatter * correlated <= walk * walk / lengths['block_seconds']
        and max(signal['largest_variance'], signal['early_largest_variance']) <= limit * variance
        and not _has_unlike_halves(rest, signal)
        and not _has_halves(rest, signal, max(steps, variance / length), deviations)
    )


@kernel
def _has_unlike_halves(rest: Rest, signal: Signal) -> bool:
    """Return whether the values vary far less in one half of the segment than in the other."""
    early = signal['early_variances'] / HALF
    late = (signal['variances'] - signal['early_variances']) / (rest['blocks'] - HALF)
    return bool(max(early, late) > LARGEST_RATIO_OF_HALVES * min(early, late))


@kernel
def _alike_values(scatter: float, variance: float, count: float) -> float:
    """Return how many values of a block of `count` are alike, by how much its mean varies."""
    return min(max(0.5 * scatter * count / variance, 1.0), count)


@kernel
def _variance_limit(alike: float, count: float) -> float:
    """Return how much more a block of `count` values may vary than the noise does."""
    return 1.0 + VARIANCE_DEVIATIONS * math.sqrt(2.0 * alike / (count - 1.0))


@kernel
def _is_steady(rest: Rest) -> bool:
    """Return whether the means of the segment scatter about one value, and little."""
    blocks = 1.0 * rest['blocks']
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        scatter = _scatter(rest, signal)
        limit = STEADY_DEVIATION * STEADY_DEVIATION * blocks
        if i >= 3:
            limit = STEADY_GRAVITY_SCATTER * STEADY_GRAVITY_SCATTER
        if scatter > limit or (scatter > LEAST_VARIANCE and _is_smooth(rest, signal, scatter)):
            return False
    return True


@kernel
def _tilts(rest: Rest, block_seconds: float) -> bool:
    """Return whether gravity moves with the mean rate of the segment, which is a turn then."""
    seconds = (rest['blocks'] - 1.0) * block_seconds
    moved = unexplained = noise = 0.0
    for axis in range(3):
        after, behind = (axis + 1) % 3, (axis + 2) % 3
        signal = rest['signals'][3 + axis]
        change = signal['last'] - signal['first']
        # g' = g x w, for a turn at the rate w
        turned = segment_mean(rest, 3 + after) * segment_mean(rest, behind)
        turned -= segment_mean(rest, 3 + behind) * segment_mean(rest, after)
        moved += change * change
        unexplained += (change - turned * seconds) * (change - turned * seconds)
        noise += signal['steps'] / (rest['blocks'] - 1.0)
    largest = max(TURN_SHARE * math.sqrt(unexplained), TURN_DEVIATIONS * math.sqrt(noise))
    largest = max(largest, LEAST_TURN)
    return bool(math.sqrt(moved) > largest)


@kernel
def _is_smooth(rest: Rest, signal: Signal, scatter: float) -> bool:
    """Return whether means that scatter differ little from one to the next, as in a slow turn."""
    return bool(0.5 * signal['steps'] / (rest['blocks'] - 1.0) < LEAST_STEPS * scatter)


@kernel
def segment_scatter(rest: Rest, index: int) -> float:
    """Return the variance of the mean of signal `index`, by the scatter of the segment's blocks."""
    return float(_scatter(rest, rest['signals'][index]) / rest['blocks'])


@kernel
def _has_halves(rest: Rest, signal: Signal, scatter: float, deviations: float) -> bool:
    """Return whether the mean of the segment moves from its first half to its second."""
    late = rest['blocks'] - HALF
    if late <= 0:
        return False
    step = (signal['means'] - signal['early_means']) / late - signal['early_means'] / HALF
    spread = scatter * (1.0 / HALF + 1.0 / late)
    return bool(step * step > deviations * deviations * spread)


@kernel
def _correlated_ratio(rest: Rest) -> float:
    """Return how much more the mean of a segment varies than if its blocks were independent.

    From the correlation of one block and the next on the axes of the gyroscope, as if it fell off
    exponentially.
    """
    correlation = 0.0
    for i in range(3):
        signal = rest['signals'][i]
        # Von Neumann's ratio, 2 for independent ones and for a coarse sensor that shows none.
        steps = signal['steps'] / (rest['blocks'] - 1.0) + 2.0 * LEAST_VARIANCE
        correlation += (1.0 - 0.5 * steps / (_scatter(rest, signal) + LEAST_VARIANCE)) / 3.0
    correlation = min(max(correlation, 0.0), STRONGEST_CORRELATION)
    return (1.0 + correlation) / (1.0 - correlation)


@kernel
def _learn(rest: Rest, length: int) -> None:
    """Learn the noise from a segment that holds together."""
    blocks = 1.0 * rest['blocks']
    rest['learned'] = rest['learned'] + 1 if rest['known'] else 1
    share = max(LEARNING, 1.0 / rest['learned'])
    if rest['learned'] == 1:
        rest['variance_ratio'] = _correlated_ratio(rest)
    for i in range(SIGNALS):
        signal = rest['signals'][i]
        variance = signal['variances'] / blocks
        scatter = max(_scatter(rest, signal), variance / length)
        if rest['learned'] == 1:
            signal['variance'] = variance
            signal['scatter'] = scatter
        else:
            signal['variance'] += share * (variance - signal['variance'])
            signal['scatter'] += share * (scatter - signal['scatter'])
    rest['known'] = True
    rest['restless'] = 0
    rest['steady_seconds'] = 0.0
