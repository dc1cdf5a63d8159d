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

"""Samples in, rest out: values make blocks, still blocks make segments."""

import math

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core.rest.force import forget_force, note_force
from gyro_drift_filter.core.rest.noise import learn_noise_from_segment, learn_variance_ratio
from gyro_drift_filter.core.rest.records import (
    HALF,
    SEGMENT_BLOCKS,
    SIGNALS,
    BlockOutcome,
    Halves,
    Obstacle,
    Rest,
    RestLengths,
)
from gyro_drift_filter.core.rest.segment import (
    add_value,
    add_waiting_block,
    block_mean,
    drop_early_half,
    forget_segment_before,
    is_block_filled,
    let_block_wait,
    segment_mean,
    start_block,
    start_segment,
    start_value,
)
from gyro_drift_filter.core.rest.spikes import forget_waiting, let_wait, note_next
from gyro_drift_filter.core.rest.standing import note_gravity
from gyro_drift_filter.core.rest.stationarity import (
    holds_together,
    is_steady,
    note_obstacle,
    obstacle_of_block,
    tilts,
)
from gyro_drift_filter.core.sample import Sample

LEAST_SEGMENT = 4  # blocks: half a second, at the end of a rest
# Blocks: once the noise is known a stop may be so short, where single blocks show the motions
# before and after it. The turning point of a slow swing is still for as long, but such a swing
# shows only by how far the means of blocks move.
SHORTEST_STOP = 6
# Before anything is known a segment may be called steady from so many blocks on.
LEAST_STEADY_BLOCKS = 6
# So long after the noise has been doubted, and without a rest since, the accelerations of the one
# before are no bound any more. A noise that is known is kept: else a road would be a rest.
FORGET_CALM_SECONDS = 300.0
# No vehicle speeds up evenly for longer, in s: a train would be at 100 km/h, with 0.5 m/s^2.
LONGEST_PUSH = 60.0


@kernel
def start_rest(rest: Rest) -> None:
    """Forget the rest under way; what is known of the noise is kept."""
    rest['at_rest'] = False
    rest['run'] = 0
    rest['turned'] = math.inf
    start_value(rest)
    start_block(rest)
    start_segment(rest)
    forget_segment_before(rest)
    forget_waiting(rest['waiting'])
    forget_force(rest['force'])


@inlined_kernel
def note_sample(
    rest: Rest, sample: Sample, trusted: bool, missing: int, lengths: RestLengths
) -> bool:
    """Take a sample in, with `missing` ones before it, which count as time alone.

    So does it itself where it is not `trusted`; where it is, all rates are usable. While the noise
    is not known, it waits for the next one, which shows whether it is a spike.
    Returns whether a block is complete, so that `close_block` has to be called.
    """
    if rest['known']:
        return _add_sample(rest, sample, trusted, missing, lengths)
    return _wait_for_next(rest, sample, trusted, missing, lengths)


@kernel
def _wait_for_next(
    rest: Rest, sample: Sample, trusted: bool, missing: int, lengths: RestLengths
) -> bool:
    """Take the sample that waits in, unless this one shows that it is a spike; let this one wait.

    Arguments and result as for `note_sample`.
    """
    waiting = rest['waiting']
    spike, complete = note_next(waiting, sample, trusted, missing), False
    if waiting['waits']:
        complete = _add_sample(rest, waiting['sample'], not spike, 0, lengths)
    let_wait(waiting, sample, trusted, missing)
    # The last sample of a block is taken in at once, so that no block is later for it.
    if _completes_block(rest, missing, lengths):
        waiting['waits'] = False
    if waiting['waits']:
        return complete
    return _add_sample(rest, sample, trusted, missing, lengths) or complete


@kernel
def _completes_block(rest: Rest, missing: int, lengths: RestLengths) -> bool:
    """Return whether the block is complete with a sample, and `missing` ones before it."""
    values = (rest['samples'] + 1 + missing) // lengths['value']
    return bool(values > 0 and rest['index'] + values >= lengths['block'])


@inlined_kernel
def _add_sample(
    rest: Rest, sample: Sample, trusted: bool, missing: int, lengths: RestLengths
) -> bool:
    """Add a sample to the value under way, as `note_sample` says."""
    rate, force = sample['angular_velocity'], rest['force']
    rest['samples'] += 1 + missing
    force['samples_since_change'] += missing if trusted else 1 + missing
    if missing > 0 or not trusted:
        rest['turned'] = math.inf  # nobody has measured what it turned meanwhile
    if trusted:
        rest['averaged'] += 1
        longest = lengths['value'] * lengths['block'] // 2
        note_force(force, sample['linear_acceleration'], longest)
        if force['doubted'][0] + force['doubted'][1] + force['doubted'][2] > 0:
            rest['turned'] = math.inf  # a knock may have turned it between two samples
        for axis in range(3):
            rest['signals'][axis]['value'] += rate[axis]
            rest['signals'][3 + axis]['value'] += force['felt'][axis]
    if rest['samples'] < lengths['value']:
        return False
    # Without missing samples it is one: the division is for the others, as it takes its time.
    rest['index'] += rest['samples'] // lengths['value'] if missing > 0 else 1
    if 2 * rest['averaged'] >= rest['samples']:
        add_value(rest)
    start_value(rest)
    return bool(rest['index'] >= lengths['block'])


@kernel
def close_block(rest: Rest, lengths: RestLengths) -> BlockOutcome:
    """Judge a full block.

    Returns:
        What it brought. Where a segment is ready, `segment_mean` can be read, and `next_segment`
        has to be called.
    """
    sudden_before, still = rest['sudden'], _is_still(rest, lengths)
    rest['blocks_since_rest'] += 1
    _note_turn(rest, lengths['block_seconds'])
    if rest['blocks_since_rest'] * lengths['block_seconds'] > FORGET_CALM_SECONDS:
        rest['calm_known'] = False
    if still:
        return _take_still_block(rest, lengths)
    ended = _ended_rest(rest, sudden_before)
    if ended != BlockOutcome.NOTHING and not holds_together(rest, lengths):
        ended = BlockOutcome.NOTHING
    rest['at_rest'] = False
    rest['run'] = 0
    start_block(rest)
    if ended == BlockOutcome.NOTHING:
        start_segment(rest)
        forget_segment_before(rest)
    return ended


@kernel
def _note_turn(rest: Rest, block_seconds: float) -> None:
    """Note by how much the body has turned in a block, against what was a rest before."""
    rest['seconds_since_segment'] += block_seconds
    if rest['count'] == 0 or rest['seconds_since_segment'] > LONGEST_PUSH:
        rest['turned'] = math.inf
        return
    square = 0.0
    for axis in range(3):
        angle = (block_mean(rest, axis) - rest['signals'][axis]['before']) * block_seconds
        rest['turn'][axis] += angle
        square += angle * angle
    rest['turned'] += math.sqrt(square)


@kernel
def _is_still(rest: Rest, lengths: RestLengths) -> bool:
    """Return whether the block is still; if it is not, the obstacle is noted."""
    if not is_block_filled(rest, lengths):
        moves = rest['hinted_motion']
        note_obstacle(rest, Obstacle.HINTED_MOTION if moves else Obstacle.FEW_SAMPLES, 0)
        return False
    still = True
    for i in range(SIGNALS):
        obstacle = obstacle_of_block(rest, i)
        # A signal that varies within the block says more than one whose mean has moved.
        if obstacle == Obstacle.VARIES or (still and obstacle != Obstacle.NONE):
            still = False
            note_obstacle(rest, obstacle, i)
    note_gravity(rest, lengths['block_seconds'])
    return still


@kernel
def _take_still_block(rest: Rest, lengths: RestLengths) -> BlockOutcome:
    """Take the block before into the segment, and let this one wait; return what that brings."""
    if rest['run'] >= 2:
        add_waiting_block(rest)
    rest['run'] += 1
    let_block_wait(rest)
    start_block(rest)
    if rest['blocks'] >= SEGMENT_BLOCKS:
        return _close_segment(rest, lengths)
    if rest['known'] or rest['blocks'] < LEAST_STEADY_BLOCKS:
        return BlockOutcome.NOTHING
    steady = is_steady(rest) and not tilts(rest, lengths['block_seconds'])
    return BlockOutcome.STEADY if steady else BlockOutcome.NOTHING


@kernel
def _close_segment(rest: Rest, lengths: RestLengths) -> BlockOutcome:
    """Judge a full segment; return whether it is ready."""
    if rest['halves'] == Halves.LATER:
        drop_early_half(rest)
        rest['halves'] = Halves.LEFT_BEHIND
        return BlockOutcome.NOTHING
    rest['halves'] = Halves.WHOLE
    if not holds_together(rest, lengths):
        rest['at_rest'] = False
        forget_segment_before(rest)
        drop_early_half(rest)
        rest['halves'] = Halves.LATER if rest['known'] else Halves.WHOLE
        rest['run'] = 2
        return BlockOutcome.NOTHING
    learn_noise_from_segment(rest, lengths['block'])
    return BlockOutcome.SEGMENT


@kernel
def _ended_rest(rest: Rest, sudden_before: bool) -> BlockOutcome:
    """Return what the segment is that a motion has ended: it may be long enough to count as rest.

    `sudden_before` where the motion before the segment showed in a single block.
    """
    blocks = rest['blocks']
    if not rest['known']:
        return BlockOutcome.NOTHING  # also of a rest whose noise has become doubtful meanwhile
    if rest['at_rest']:
        return BlockOutcome.END_OF_REST if blocks >= LEAST_SEGMENT else BlockOutcome.NOTHING
    if rest['halves'] != Halves.WHOLE:
        return BlockOutcome.END_OF_REST if blocks >= HALF + LEAST_SEGMENT else BlockOutcome.NOTHING
    sudden = sudden_before and rest['sudden']
    return BlockOutcome.STOP if sudden and blocks >= SHORTEST_STOP else BlockOutcome.NOTHING


@kernel
def next_segment(rest: Rest, ended_rest: bool) -> None:
    """Begin the next segment; `ended_rest` where the rest is over."""
    if ended_rest:
        forget_segment_before(rest)
    else:
        learn_variance_ratio(rest)
        rest['at_rest'] = True
        rest['obstacle'] = Obstacle.NONE
        rest['sudden'] = False
        rest['seconds_since_segment'] = rest['turned'] = 0.0
        for axis in range(3):
            rest['turn'][axis] = 0.0
        for i in range(SIGNALS):
            rest['signals'][i]['before'] = segment_mean(rest, i)
            rest['signals'][i]['before_blocks'] = rest['blocks']
    start_segment(rest)


@kernel
def has_stood_still(rest: Rest, blocks: int) -> bool:
    """Return whether this is rest, or has been still for so many blocks in a row.

    A steady turn that is no bias is still, too: what is noise shows as well in it.
    """
    return bool(rest['at_rest'] or (rest['known'] and rest['run'] >= blocks))


@kernel
def shows_noise(rest: Rest) -> bool:
    """Return whether the last samples that were accepted are noise alone, for a segment's time.

    In the first segment nobody could tell a spike from motion, so that they may be among them.
    """
    spiky = rest['learned'] == 1 and rest['waiting']['spikes'] > 0
    return has_stood_still(rest, SEGMENT_BLOCKS) and not spiky
