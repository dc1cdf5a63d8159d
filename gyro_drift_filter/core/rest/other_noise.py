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

"""Noise at rest that is another one by now: a fan was switched on, or a motor idles.

Where the noise has risen for good nothing is still any more, by what is known of it. So what is not
known as rest is looked at a second time, by a detector that knows no noise, as before the first
rest. Where it finds rest with one and the same noise several times, while gravity stands, that is
the noise at rest from now on. The bias has to be able to have had the rate each time: else the
vibration of wheels in a steady turn would be confirmed. On a straight way it has the rate, so a
body that has been pushed has to be shaken less than on its way: what it drives on would be
confirmed. A robot may drive for long in between. Where the noise falls again it is learned as
always.
"""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.rest.detection import close_block, next_segment, start_rest
from gyro_drift_filter.core.rest.noise import (
    LARGEST_EXCESS,
    correlation_of_means,
    forget_noise,
)
from gyro_drift_filter.core.rest.records import (
    SEGMENT_BLOCKS,
    SIGNALS,
    BlockOutcome,
    OtherNoise,
    Rest,
    RestLengths,
)
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    block_moments,
    is_block_filled,
    scatter_of_means,
    segment_mean,
    value_variance,
)
from gyro_drift_filter.core.rest.standing import STEADY_GRAVITY

# A motion may pass for noise once.
CONFIRMING = 3  # segments
# The variance of values over the known one: below this the noise that is known finds the rest, and
# two segments have one and the same noise.
NOISIER = 2.0
# A machine that starts shakes gravity for so many blocks at most. If it is shaken for longer, the
# body has been pushed, and may roll. No way is so even that gravity stands for so many s on it.
LONGEST_START, LONGEST_ROLL = 4, 300.0
# How strongly a body is shaken on its way is the mean over so many s.
SHAKEN_SECONDS = 60.0
# Where the rates wander, the correlation of the means of one block and the next is larger than
# before by this. Three segments of white noise have it by chance on one axis in a hundred; with
# each one more it is rarer.
LARGEST_CORRELATION = 0.35
# A machine that turns within 1.2 Hz of the frequency of blocks, or of a multiple, leaves means that
# scatter by less than this share of what white noise of the same variance has.
LEAST_SCATTER = 0.5
# Correlation is the mean over so many segments, half a minute: with fewer of them a long drive
# meets three without any by chance, and with more a stand behind it is found late.
REMEMBERED = 12
# What has been neither rest nor of that noise for so long was motion. The detector may learn
# another noise then; segments that had this one still count.
FORGET_OTHER_NOISE_SECONDS = 10.0


@kernel
def hand_on_block(rest: Rest, other: Rest) -> None:
    """Give the other detector the block that is complete, before it is closed."""
    other['count'] = rest['count']
    if rest['turned'] == math.inf:
        other['turned'] = math.inf
    for i in range(SIGNALS):
        given, taken = rest['signals'][i], other['signals'][i]
        taken['least_variance'] = given['least_variance']
        taken['origin'] = given['origin']
        taken['sum'] = given['sum']
        taken['squares'] = given['squares']


@kernel
def note_shaking(rest: Rest, noise: OtherNoise, lengths: RestLengths) -> None:
    """Note how strongly the body is shaken, on the mean since the last rest, before a block ends.

    A block that lacks more than half of its samples says nothing.
    """
    if not is_block_filled(rest, lengths):
        return
    blocks = min(rest['blocks_since_rest'] + 1.0, SHAKEN_SECONDS / lengths['block_seconds'])
    for i in range(SIGNALS):
        _, variance = block_moments(rest, i)
        noise['shaken'][i] += (variance - noise['shaken'][i]) / blocks


@kernel
def finds_other_segment(rest: Rest, noise: OtherNoise, lengths: RestLengths) -> bool:
    """Close the block that was handed on; return whether a segment is ready.

    Then its mean can be read, and `confirm_other_noise` has to be called.
    """
    other = noise['rest']
    if rest['at_rest'] or not rest['known']:
        start_rest(other)
        return False
    if other['blocks_since_rest'] * lengths['block_seconds'] > FORGET_OTHER_NOISE_SECONDS:
        other['known'] = False
    found = close_block(other, lengths)
    if found in (BlockOutcome.END_OF_REST, BlockOutcome.STOP):
        next_segment(other, True)
    return bool(found == BlockOutcome.SEGMENT)


@kernel
def confirm_other_noise(
    rest: Rest, noise: OtherNoise, lengths: RestLengths, may_be_bias: bool
) -> None:
    """Take the noise of the segments over where enough of them confirm it, one after the other.

    Each of them `may_be_bias`, as its rate says: what turns is no rest, however steady it is. What
    may roll does not count, and each segment of it is judged as the first one, so that one of a
    stop is not taken for more of the same.
    """
    other = noise['rest']
    if _may_roll(rest, noise, lengths['block_seconds']):
        next_segment(other, False)
        forget_noise(other)
        return
    if may_be_bias:
        _note_segment(noise, lengths['block'])
    else:
        noise['segments'] = 0
    next_segment(other, False)
    stands = rest['standing_seconds'] >= SEGMENT_BLOCKS * lengths['block_seconds']
    stands = stands and not _wanders(rest, noise)
    if stands and noise['segments'] >= CONFIRMING and _is_of_a_machine(rest, other):
        _take_noise(rest, other)


@kernel
def _may_roll(rest: Rest, noise: OtherNoise, block_seconds: float) -> bool:
    """Return whether the body may have been pushed out of the last rest, and roll since.

    It does so as steadily as it stood, if the ground lets it. But rolling shakes its rates, and a
    body that stands is shaken less than it was on its way.
    """
    standing, other = rest['standing_seconds'], noise['rest']
    since_rest = rest['blocks_since_rest'] * block_seconds
    pushed = since_rest - standing > LONGEST_START * block_seconds
    for i in range(3, SIGNALS):  # it may be pushed evenly since the very last block of the rest
        moved = segment_mean(other, i) - rest['signals'][i]['before']
        pushed = pushed or abs(moved) > STEADY_GRAVITY
    rolls = pushed and standing < LONGEST_ROLL and _is_noisier(rest, other, 3)
    return rolls and not _is_calmer(noise)


@kernel
def _is_calmer(noise: OtherNoise) -> bool:
    """Return whether the body is shaken less in the segment than since the last rest."""
    other, calmer = noise['rest'], 0.0
    for i in range(SIGNALS):
        variance = max(value_variance(other, other['signals'][i]), LEAST_VARIANCE)
        calmer += math.log(max(noise['shaken'][i], LEAST_VARIANCE) / variance)
    return calmer > SIGNALS * math.log(NOISIER)


@kernel
def _is_noisier(rest: Rest, other: Rest, signals: int) -> bool:
    """Return whether any of the first signals varies more than the known noise does."""
    noisier = False
    for i in range(signals):
        variance = rest['signals'][i]['variance']
        noisier = noisier or other['signals'][i]['variance'] > NOISIER * variance
    return noisier


@kernel
def _note_segment(noise: OtherNoise, length: int) -> None:
    """Count a segment that has the noise of the one before, which may be long ago.

    Its blocks have `length` values each.
    """
    other, alike = noise['rest'], True
    for i in range(SIGNALS):
        before, now = noise['variances'][i], other['signals'][i]['variance']
        alike = alike and now <= NOISIER * before and before <= NOISIER * now
        noise['variances'][i] = now
    noise['segments'] = noise['segments'] + 1 if alike else 1
    share, mean = 1.0 / min(noise['segments'], REMEMBERED), noise['mean_correlation']
    for axis in range(3):
        mean[axis] += share * (_correlation_of_wander(other, axis, length) - mean[axis])


@kernel
def _correlation_of_wander(rest: Rest, axis: int, length: int) -> float:
    """Return how the means of the blocks of a segment, `length` values each, follow each other.

    It is 0 where they hardly scatter: what is left in them of a machine that turns with nearly the
    period of a block is slow, too, but small.
    """
    signal, blocks = rest['signals'][axis], rest['blocks']
    by_noise = value_variance(rest, signal) / length
    if scatter_of_means(signal['segment'], blocks) < LEAST_SCATTER * by_noise:
        return 0.0
    return correlation_of_means(signal['segment'], blocks)


@kernel
def _wanders(rest: Rest, noise: OtherNoise) -> bool:
    """Return whether the rates of the last segments wander, as by the steering of what drives."""
    ratio, wanders = rest['variance_ratio'], False
    usual = (ratio - 1.0) / (ratio + 1.0)
    for axis in range(3):
        wanders = wanders or noise['mean_correlation'][axis] > usual + LARGEST_CORRELATION
    return wanders


@kernel
def _is_of_a_machine(rest: Rest, other: Rest) -> bool:
    """Return whether values vary more, and their means by no more than follows from that.

    In a slow turn the means alone vary more, and in a vehicle far more than its vibration says.
    """
    for i in range(SIGNALS):
        before, now = rest['signals'][i], other['signals'][i]
        risen = max(now['variance'] / before['variance'], 1.0)
        if now['scatter'] > LARGEST_EXCESS * risen * before['scatter']:
            return False
    return _is_noisier(rest, other, SIGNALS)


@kernel
def _take_noise(rest: Rest, other: Rest) -> None:
    rest['variance_ratio'] = other['variance_ratio']
    rest['acceleration_ratio'] = other['acceleration_ratio']
    rest['blocks_since_rest'] = 0
    rest['turned'] = math.inf  # what shakes the body may have moved the mean of its accelerometer
    for i in range(SIGNALS):
        rest['signals'][i]['variance'] = other['signals'][i]['variance']
        rest['signals'][i]['scatter'] = other['signals'][i]['scatter']
