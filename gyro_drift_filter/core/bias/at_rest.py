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

"""The bias of the gyroscope, tracked at rest: one small Kalman filter per axis.

The measurement is the mean rate of a segment of rest (`rest/`), its noise what such means scatter
by. Between rests the bias walks at random. Not every segment is accepted (`acceptance.py`).
"""

import math
from typing import TYPE_CHECKING

import numpy as np

from gyro_drift_filter.accelerate import PerAxis, inlined_kernel, kernel
from gyro_drift_filter.core.bias.acceptance import accept_segment, may_be_bias
from gyro_drift_filter.core.bias.carried_gravity import (
    carry_gravity,
    carry_on_with,
    forget_gravity,
    lose_gravity,
)
from gyro_drift_filter.core.bias.in_motion import lose_direction
from gyro_drift_filter.core.bias.motion_state import widen_both
from gyro_drift_filter.core.bias.provisional import (
    PROVISIONAL_DEVIATION,
    take_provisional,
    take_standing,
)
from gyro_drift_filter.core.bias.records import (
    Bias,
    Hint,
    bias_variance,
    forget_contradiction,
    has_learned_bias,
    widen,
)
from gyro_drift_filter.core.bias.segments import note_accepted
from gyro_drift_filter.core.bias.shaken_stand import (
    forget_stand,
    note_stand,
    stand_mean,
    variance_of_stand_mean,
)
from gyro_drift_filter.core.bias.shared import learn_at_rest, start_motion_bias, start_wide_prior
from gyro_drift_filter.core.bias.shift import limit_shift
from gyro_drift_filter.core.bias.slow_turn import (
    GATE,
    end_stopped_turn,
    forget_slow_turn,
    interrupt_slow_turn,
    note_stop,
    note_turning,
)
from gyro_drift_filter.core.bias.swing import forget_swing, note_swing, variance_of_swing
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.quantisation import (
    Choice,
    Quantisation,
    forget_counts,
    forget_still,
    is_refuted,
    likely_count,
    loss_by_cut,
    needs_half_counts,
    rest_finds_cut,
    variance_of_cut,
)
from gyro_drift_filter.core.rest.detection import close_block, next_segment, note_sample, start_rest
from gyro_drift_filter.core.rest.noise import (
    noise_level,
    note_count,
    segment_variance,
    variance_of_mean,
)
from gyro_drift_filter.core.rest.other_noise import (
    confirm_other_noise,
    finds_other_segment,
    hand_on_block,
    note_shaking,
)
from gyro_drift_filter.core.rest.records import BlockOutcome, Obstacle, Rest, RestLengths
from gyro_drift_filter.core.rest.segment import is_block_filled, segment_mean, shift_rates
from gyro_drift_filter.core.rest.stationarity import note_obstacle
from gyro_drift_filter.core.sample import Sample

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord
    from gyro_drift_filter.core.settings import Settings

# At rest the bias walks slower than in motion, in which it may also warm up: share of the variance.
# With more a quiet sensor's bias follows the slow part of its noise.
REST_SHARE = 0.003
# How fast the bias walks is learned from how well it was predicted, with WALK_LEARNING per segment:
# in motion from the first segment of a rest, at rest from the others.
# A squared innovation counts for LARGEST_SURPRISE variances at most, and the variance of the walk
# is at least LEAST_WALK of what the parameter allows.
WALK_LEARNING, LEAST_WALK, LARGEST_SURPRISE = 0.4, 0.003, 4.0
# A sensor warms up for minutes, and meanwhile its bias leads the estimate: by the mean innovation
# of the last segments, each with LAG_WEIGHT. What the square of that has beyond LAG_DEVIATIONS of
# noise adds to the variance.
LAG_WEIGHT, LAG_DEVIATIONS = 0.05, 3.0
# A bias that is off by so much (rad/s) tilts gravity within a minute so far that a velocity comes
# to the 50 m/s that no robot has: it explains why rates and accelerations contradict each other.
LEAST_EXPLAINING = 3e-3
EXPLAINING_DEVIATIONS = 3.0  # of the segment's noise, which may be more
# No gyroscope's bias walks further within a second than its noise says for a second: the Allan
# deviation of each falls for 1.7 s at least, and of most for minutes. In 1/s.
FASTEST_WALK = 1.0
LARGEST_THERMAL_CHANGE = 1.0  # rad/s: no change of temperature moves the bias by more
# A hint of the robot is good for so long.
HINT_SECONDS = 1.0


@kernel
def start_bias(
    state: Bias, bias: PerAxis, variance: PerAxis, known: bool, turn_on_deviation: float
) -> None:
    """Begin with a bias (3,) in rad/s and its variance (3,), infinite where it is a mere guess.

    Where it is infinite, `turn_on_deviation` (rad/s) takes its place. What is not `known` is
    replaced by the first rest. Call `set_shift` before.
    """
    leave_rest(state)
    state['known'] = known
    for axis in range(3):
        state['bias'][axis] = bias[axis]
        state['variance'][axis] = variance[axis]
        if not variance[axis] < np.inf:
            state['known'] = False
            state['variance'][axis] = turn_on_deviation * turn_on_deviation
        state['assumed_bias'][axis] = state['bias'][axis]
        state['assumed_variance'][axis] = state['variance'][axis]
        state['provisional_variance'][axis] = 0.0
        state['wander'][axis] = 0.0
    forget_contradiction(state)
    carry_on_with(state['carried'], state['bias'])
    start_motion_bias(state['motion'], state['bias'], state['variance'])
    start_wide_prior(state['wide_prior'], state['bias'], state['variance'])
    state['walk'] = state['walk_at_rest'] = 1.0
    state['quietest_rates'] = state['quietest_accelerations'] = -np.inf
    state['doubted_segments'] = 0
    state['corrected'] = 0
    state['restored'] = False
    state['temperature'] = state['temperature_before'] = np.nan
    state['process_noise'] = state['largest_process_noise'] = 0.0
    forget_slow_turn(state['turn'])
    forget_swing(state['swing'])


@kernel
def forget_bias(state: Bias, turn_on_deviation: float) -> None:
    """Begin anew with no bias, as uncertain as `turn_on_deviation` in rad/s says."""
    for axis in range(3):
        state['bias'][axis] = 0.0
        state['variance'][axis] = np.inf
    start_bias(state, state['bias'], state['variance'], False, turn_on_deviation)


@kernel
def leave_rest(state: Bias) -> None:
    """Forget the rest under way: time has jumped, or the filter starts anew. The bias is kept."""
    start_rest(state['rest'])
    start_rest(state['other_noise']['rest'])
    forget_stand(state['shaken_stand'])
    lose_direction(state['motion'])
    lose_direction(state['wide_prior'])
    forget_gravity(state['carried'])
    _forget_stillness(state)


@kernel
def _forget_stillness(state: Bias) -> None:
    state['recent_count'] = 0
    state['rest_beyond_max'] = False
    state['still_seconds'] = state['still_blocks'] = 0.0
    for axis in range(3):
        state['still_sum'][axis] = state['lag'][axis] = 0.0
    interrupt_slow_turn(state['turn'])


@inlined_kernel
def track_bias(
    filter_: 'FilterRecord', sample: Sample, trusted: bool, missing: int, elapsed: float
) -> None:
    """Take a sample in, with `missing` ones before it.

    `trusted` where it is no outlier and its sensor measures; `elapsed` is the time in s since the
    last sample.
    """
    state, quantisation = filter_['state']['bias'], filter_['state']['quantisation']
    settings, lengths = filter_['settings'], filter_['coefficients']['rest']
    rest = state['rest']
    _let_time_pass(state, elapsed, settings['bias_random_walk'])
    if state['hint'] == Hint.MOVES:
        trusted = False
        rest['hinted_motion'] = True
        forget_stand(state['shaken_stand'])
    if note_sample(rest, sample, trusted, missing, lengths):
        if is_refuted(quantisation):
            if needs_half_counts(quantisation, settings['input_quantisation']):
                widen(state, variance_of_cut(quantisation))
            forget_counts(quantisation)
        for axis in range(3):
            note_count(rest, axis, likely_count(quantisation, axis))
            note_count(rest, 3 + axis, rest['force']['resolution'][axis])
        _take_block(state, quantisation, lengths, settings)


@kernel
def _let_time_pass(state: Bias, elapsed: float, random_walk: float) -> None:
    """Let hints grow old, and the bias walk, within `elapsed` s.

    `random_walk` in rad/s^(3/2).
    """
    at_rest = state['rest']['at_rest']
    state['hint_seconds'] -= elapsed
    if state['hint'] != Hint.NONE and state['hint_seconds'] <= 0.0:
        state['hint'] = Hint.NONE
        forget_stand(state['shaken_stand'])
    state['seconds_since_rest'] = 0.0 if at_rest else state['seconds_since_rest'] + elapsed
    walked = random_walk * random_walk * elapsed
    largest = max(state['walk'], 1.0)
    state['largest_process_noise'] += walked * largest
    share = REST_SHARE * state['walk_at_rest'] * largest if at_rest else state['walk']
    process_noise = walked * share
    state['process_noise'] += process_noise
    state['motion']['pending_process_noise'] += process_noise
    state['wide_prior']['pending_process_noise'] += process_noise


@kernel
def _take_block(
    state: Bias, quantisation: Quantisation, lengths: RestLengths, settings: 'Settings'
) -> None:
    """Take in what the block that is complete says of rest, and so of the bias."""
    rest, other = state['rest'], state['other_noise']
    run = rest['run']
    note_shaking(rest, other, lengths)
    hand_on_block(rest, other['rest'])
    note_swing(state['swing'], rest, lengths)
    note_turning(state, lengths, settings['bias_max'])
    note_stop(state, lengths)
    stood = _note_hinted_stand(state, lengths)
    carry_gravity(state['carried'], rest, lengths)
    found = close_block(rest, lengths)
    moves = rest['run'] == 0 and rest['sudden']
    rest['hinted_motion'] = False
    end_stopped_turn(state['turn'], rest['run'])
    if finds_other_segment(rest, other, lengths):
        confirm_other_noise(rest, other, lengths, may_be_bias(state, other['rest']))
    take_standing(state, lengths['block_seconds'], settings['bias_max'])
    if found == BlockOutcome.STEADY:
        take_provisional(state, lengths['block_seconds'], settings['bias_max'])
    if found != BlockOutcome.NOTHING and found != BlockOutcome.STEADY:
        _take_segment(state, quantisation, found, lengths, settings)
        forget_stand(state['shaken_stand'])
    elif stood:
        _take_shaken_stand(state, settings['bias_max'])
    if rest['run'] < run:
        _forget_stillness(state)
        forget_still(quantisation)
    if moves:
        lose_gravity(state['carried'])


@kernel
def _take_segment(
    state: Bias,
    quantisation: Quantisation,
    found: BlockOutcome,
    lengths: RestLengths,
    settings: 'Settings',
) -> None:
    """Learn from a segment that is ready, as `found` says."""
    rest, ended_rest = state['rest'], found != BlockOutcome.SEGMENT
    if state['hint'] == Hint.MOVES and found != BlockOutcome.STOP:
        next_segment(rest, True)
        return
    if ended_rest:
        # By itself, as the start of the motion may be in it, or nothing of this rest came before.
        state['recent_count'] = 0
    else:
        _note_stillness(state, lengths['block_seconds'], settings['bias_calibration_time'])
    if accept_segment(state, found, lengths, settings['bias_max']):
        undone = not ended_rest and rest_finds_cut(quantisation)
        undone = undone and settings['input_quantisation'] == Choice.AUTO
        if undone:
            _undo_cut(state, quantisation)
        _learn(state)
        note_accepted(state)
        if undone:
            forget_gravity(state['carried'])
            carry_on_with(state['carried'], state['bias'])
        state['motion']['untracked_share'] = _untracked_share(
            rest, lengths['block_seconds'], settings['bias_random_walk']
        )
        next_segment(rest, ended_rest)
    else:
        next_segment(rest, True)
        rest['at_rest'] = False
        note_obstacle(rest, Obstacle.NOT_ACCEPTED, 0)


@kernel
def _undo_cut(state: Bias, quantisation: Quantisation) -> None:
    """Add half a count to the rates of the rest so far, as it is added to those that follow."""
    if has_learned_bias(state):
        widen(state, variance_of_cut(quantisation))
    state['recent_count'] = 0
    for axis in range(3):
        loss, growth = loss_by_cut(quantisation, axis)
        shift_rates(state['rest'], axis, loss, growth)
        state['still_sum'][axis] += state['still_blocks'] * loss


@kernel
def _note_hinted_stand(state: Bias, lengths: RestLengths) -> bool:
    """Note the full block where the robot says that it stands and there is no rest.

    Return whether that brings a mean for `_take_shaken_stand`.
    """
    rest, stand = state['rest'], state['shaken_stand']
    if state['hint'] == Hint.STANDS and not rest['at_rest']:
        return is_block_filled(rest, lengths) and note_stand(stand, rest)
    forget_stand(stand)
    return False


@kernel
def _take_shaken_stand(state: Bias, bias_max: float) -> None:
    """Take the mean of a stand for the bias, as the robot itself says that it is one."""
    stand = state['shaken_stand']
    stand['beyond_max'] = False
    for axis in range(3):
        if abs(stand_mean(stand, axis)) > bias_max:
            state['segments_beyond_max'] += 1
            stand['beyond_max'] = True
            return
    # A gyroscope that is shaken is off by that much, however often it is.
    besides = PROVISIONAL_DEVIATION * PROVISIONAL_DEVIATION
    for axis in range(3):
        noise = variance_of_stand_mean(stand, axis) + besides
        innovation = stand_mean(stand, axis) - state['bias'][axis]
        variance, least = noise, noise
        if state['known']:
            variance = bias_variance(state, axis)
            least = min(variance, besides)
            if is_beyond_gate(innovation, GATE, variance + noise):
                variance = innovation * innovation
            variance *= noise / (variance + noise)
        state['bias'][axis] += variance / noise * innovation
        state['variance'][axis] = max(variance, least)
    _settle_anew(state)


@kernel
def _untracked_share(rest: Rest, block_seconds: float, random_walk: float) -> float:
    """Return by what share of its variance the random walk exceeds that of this sensor's bias.

    `random_walk` in rad/s^(3/2); see `FASTEST_WALK`.
    """
    noise = 0.0  # (rad/s)^2 s, of the noisiest axis
    for axis in range(3):
        noise = max(noise, variance_of_mean(rest, axis, 1.0) * block_seconds)
    fastest, walked = FASTEST_WALK * FASTEST_WALK * noise, random_walk * random_walk
    return 1.0 - fastest / walked if fastest < walked else 0.0


@kernel
def _note_stillness(state: Bias, block_seconds: float, calibration_time: float) -> None:
    """Keep the mean rate of the last stillness, of one to two times `calibration_time` s."""
    rest = state['rest']
    if state['still_seconds'] > 2.0 * calibration_time:
        state['still_seconds'] *= 0.5
        state['still_blocks'] *= 0.5
        for axis in range(3):
            state['still_sum'][axis] *= 0.5
    state['still_seconds'] += rest['blocks'] * block_seconds
    state['still_blocks'] += rest['blocks']
    for axis in range(3):
        state['still_sum'][axis] += rest['blocks'] * segment_mean(rest, axis)


@kernel
def calibrate_bias(state: Bias) -> None:
    """Take the mean of the stillness under way for the bias, whatever the bias was."""
    blocks = state['still_blocks']
    for axis in range(3):
        state['bias'][axis] = state['still_sum'][axis] / blocks
        state['variance'][axis] = variance_of_mean(state['rest'], axis, blocks)
    _settle_anew(state)


@kernel
def warm_bias(state: Bias, temperature: float, settings: 'Settings') -> None:
    """Widen the bias if the temperature (deg C) is a step away from that of the last widening.

    Steps of the temperature in one direction move the bias in one direction, so that their sum
    counts, and not the sum of their squares. A step in the other direction begins another sum, as
    motion may have shown the bias meanwhile.
    """
    if not abs(temperature) < np.inf:
        return
    last = state['temperature']
    change = temperature - last
    if abs(change) <= settings['bias_temperature_step']:
        return
    state['temperature'] = temperature
    if not abs(change) < np.inf:
        state['temperature_before'] = temperature
        return
    if change * (last - state['temperature_before']) < 0.0:
        state['temperature_before'] = last
    coefficient, before = settings['bias_temperature_coefficient'], state['temperature_before']
    counted = min(coefficient * abs(last - before), LARGEST_THERMAL_CHANGE)
    moved = min(coefficient * abs(temperature - before), LARGEST_THERMAL_CHANGE)
    widen(state, moved * moved - counted * counted)


@kernel
def _learn(state: Bias) -> None:
    """Take the segment into the bias."""
    rest, anew = state['rest'], not state['known']
    if anew:
        # What came before was no rest and may have been a turn: the first rest replaces it.
        for axis in range(3):
            state['bias'][axis] = segment_mean(rest, axis)
            state['variance'][axis] = segment_variance(rest, axis)
        forget_gravity(state['carried'])
        carry_on_with(state['carried'], state['bias'])
    else:
        _correct(state)
    _note_quietest(state, anew)
    for axis in range(3):
        anew = limit_shift(state['motion'], axis, rest['signals'][axis]['variance']) or anew
    if anew:
        start_motion_bias(state['motion'], state['bias'], state['variance'])
    _settle(state)


@kernel
def _note_quietest(state: Bias, anew: bool) -> None:
    """Note how quiet the segment is, the first one of its bias or not.

    Of a bias that was given, or is remembered, nothing is quieter.
    """
    rates, accelerations = noise_level(state['rest'], 0), noise_level(state['rest'], 3)
    if anew:
        state['quietest_rates'], state['quietest_accelerations'] = rates, accelerations
    state['quietest_rates'] = min(state['quietest_rates'], rates)
    state['quietest_accelerations'] = min(state['quietest_accelerations'], accelerations)


@kernel
def _correct(state: Bias) -> None:
    """Correct the bias by the segment, and the random walk by how well it was predicted."""
    rest, surprise, share = state['rest'], 0.0, 0.0
    rest_begins, explains = state['seconds_since_rest'] > 0.0, False
    for axis in range(3):
        mean, noise = segment_mean(rest, axis), segment_variance(rest, axis)
        noise += variance_of_swing(state['swing'], rest, axis)
        variance = bias_variance(state, axis)
        innovation, innovation_variance = mean - state['bias'][axis], variance + noise
        lagged = _variance_of_lag(state, axis, innovation, innovation_variance)
        variance += lagged
        innovation_variance += lagged
        widen_both(state['motion'], axis, lagged)
        if rest_begins:
            by_chance = EXPLAINING_DEVIATIONS * math.sqrt(noise)
            explains = explains or abs(innovation) > LEAST_EXPLAINING + by_chance
        else:
            _note_wander(state, axis, innovation, innovation_variance)
        gain = variance / innovation_variance
        surprise += innovation * innovation / innovation_variance / 3.0
        share += state['process_noise'] / innovation_variance / 3.0
        learn_at_rest(state['motion'], axis, mean, noise)
        state['bias'][axis] += gain * innovation
        state['variance'][axis] = (1.0 - gain) * variance
    if explains:
        forget_contradiction(state)
    exponent = WALK_LEARNING * share * (min(surprise, LARGEST_SURPRISE) - 1.0)
    factor, walk = math.exp(exponent), state['walk']
    if rest_begins or walk > 1.0:
        # Only `_expect_warm_up` lets it be more than the parameter allows.
        least = LEAST_WALK if rest_begins else 1.0
        state['walk'] = min(max(walk * factor, least), max(walk, 1.0))
    else:
        # How far it walks in motion a stand at one temperature does not say.
        state['walk_at_rest'] = min(max(state['walk_at_rest'] * factor, LEAST_WALK), 1.0)
    state['recent'][0]['process_noise'] = state['process_noise']
    state['recent'][0]['largest_process_noise'] = state['largest_process_noise']


@kernel
def _variance_of_lag(
    state: Bias, axis: int, innovation: float, innovation_variance: float
) -> float:
    """Return the variance in (rad/s)^2 by which a bias that moves steadily leads its estimate.

    Innovation in rad/s, and its variance by noise and random walk.
    """
    lag = (1.0 - LAG_WEIGHT) * state['lag'][axis] + LAG_WEIGHT * innovation
    state['lag'][axis] = lag
    of_mean = LAG_WEIGHT / (2.0 - LAG_WEIGHT) * innovation_variance
    return float(max(lag * lag - LAG_DEVIATIONS * LAG_DEVIATIONS * of_mean, 0.0))


@kernel
def _note_wander(state: Bias, axis: int, innovation: float, innovation_variance: float) -> None:
    """Note by how much the bias wanders about its estimate at rest.

    The mean square of the innovations says so, each with LAG_WEIGHT: what it has beyond their
    variance by noise and random walk. Innovation in rad/s.
    """
    excess = innovation * innovation - innovation_variance
    by_chance = math.sqrt(2.0 * LAG_WEIGHT / (2.0 - LAG_WEIGHT)) * innovation_variance
    wander = state['wander'][axis] + LAG_WEIGHT * (excess - state['wander'][axis])
    # A bias that was widened is predicted too well for some time, which says nothing of later.
    state['wander'][axis] = max(wander, -by_chance)


@kernel
def _settle_anew(state: Bias) -> None:
    """Begin anew with a bias that takes the place of the one before, whatever speaks against it."""
    start_motion_bias(state['motion'], state['bias'], state['variance'])
    state['recent_count'] = state['doubted_segments'] = 0
    forget_gravity(state['carried'])
    carry_on_with(state['carried'], state['bias'])
    _settle(state)


@kernel
def _settle(state: Bias) -> None:
    """Begin to count anew what the bias may have done since it was learned."""
    if state['segments'] == 0 or not state['known']:
        state['motion']['contradictions'] = 0  # what is replaced may have been why
    state['known'] = True
    for axis in range(3):
        state['provisional_variance'][axis] = 0.0
    state['rest_beyond_max'] = False
    state['segments'] += 1
    state['seconds_since_rest'] = 0.0
    state['process_noise'] = state['largest_process_noise'] = 0.0
    state['temperature_before'] = state['temperature']
    forget_slow_turn(state['turn'])
