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

"""Whether the mean rate of a segment of rest is accepted as the bias.

A constant slow turn can't be told from a bias by an IMU alone. So a segment whose mean is beyond
`bias.max` on any axis is refused, and another one is accepted only where

- no bias is known yet, unless a provisional one contradicts it that was far steadier, or that was
  steady for as long as a rest takes at higher rates where the segment turns about the vertical, or
- the robot says that it stands, or
- it is the first rest of this run, beside a remembered bias, or
- the mean lies where the bias can have come since the last segment, by the deviation of the bias,
  and so do the means of the last segments of this rest together, however many of them, and gravity
  does not move with the rate, as in a slow tilt (`carried_gravity.py`). After a slow turn
  `DOUBTED_SEGMENTS` in a row have to.

While the robot says that it moves, no segment comes here but that of a stop (`at_rest.py`). A rate
of rest that lies elsewhere is a slow turn, or the bias after all (`slow_turn.py`).
"""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.carried_gravity import TiltEvidence, has_rate, judge_tilt
from gyro_drift_filter.core.bias.provisional import (
    is_far_from_provisional,
    is_less_steady,
    turns_about_vertical,
)
from gyro_drift_filter.core.bias.records import Bias, Hint, widen
from gyro_drift_filter.core.bias.segments import (
    is_reachable_from_before_tilt,
    note_segment,
    take_back,
    take_back_tilt,
    unreachable_segments,
)
from gyro_drift_filter.core.bias.slow_turn import (
    GATE,
    SlowTurnOutcome,
    give_up_bias,
    is_back,
    largest_bias_variance,
    update_slow_turn,
)
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.rest.noise import (
    FAR_QUIETER,
    forget_noise,
    learn_noise_from_segment,
    noise_level,
    segment_variance,
    shows_motion,
    unlearn_first_segment,
)
from gyro_drift_filter.core.rest.records import BlockOutcome, Halves, Rest, RestLengths
from gyro_drift_filter.core.rest.segment import LEAST_VARIANCE, segment_mean
from gyro_drift_filter.core.rest.standing import STEADY_GRAVITY

# What a bias has moved by where it has warmed up faster than the parameter allows, in deviations of
# the random walk from then on. So the next rest may lie nearly twice as far away.
WARM_UP_DEVIATIONS = 2.0
# After a slow turn so many segments of rest in a row have to agree before they are accepted: a turn
# to and fro passes the bias.
DOUBTED_SEGMENTS = 2
# A gyroscope feels accelerations a little, so that its bias is another one where it lies otherwise:
# data sheets of small MEMS ones have 0.1 deg/s per g. In rad/s per m/s^2.
ACCELERATION_SENSITIVITY = 1.8e-4


@kernel
def accept_segment(state: Bias, found: BlockOutcome, lengths: RestLengths, bias_max: float) -> bool:
    """Accept a segment if its rate is one that the bias can have; return whether it is.

    The bias and its doubts are made ready for it then; if not, what it shows instead is noted.
    """
    carried = state['carried']
    judge_tilt(carried, state['rest'], lengths, found == BlockOutcome.SEGMENT)
    tilts = carried['evidence'] == TiltEvidence.TILT
    if _is_beyond_max(state['rest'], bias_max):
        state['segments_beyond_max'] += 1
        state['rest_beyond_max'] = True
        return False
    _let_gravity_move_bias(state)
    if not state['known']:
        return _accept_first_rest(state, found, lengths)
    if state['hint'] == Hint.STANDS:
        _let_bias_come_to_segment(state)
        state['recent_count'] = 0
        carried['evidence'] = TiltEvidence.STANDS  # the robot has said so
        return True
    note_segment(state)
    unreachable = unreachable_segments(state)
    same = carried['evidence'] == TiltEvidence.SAME
    # What may have been of a tilt was one, if the bias can't have come from there to this rate.
    if unreachable > 0 and same and is_reachable_from_before_tilt(state):
        take_back_tilt(state)
        note_segment(state)
        unreachable = 0
    if unreachable == 0 and not tilts:
        # A segment of the later half of one and the early half of another is no proof.
        if state['rest']['halves'] == Halves.WHOLE:
            state['doubted_segments'] = max(state['doubted_segments'] - 1, 0)
        return bool(state['doubted_segments'] == 0)
    if found == BlockOutcome.END_OF_REST:
        # The start of the next motion may be in it, so it raises no doubt about later rests.
        return False
    if state['segments'] == 0 and not tilts:
        # The first rest of a run: since it was switched off the bias may have come anywhere.
        give_up_bias(state)
        state['known'] = False
        state['recent_count'] = 0
        return True
    state['segments_turning'] += 1
    state['doubted_segments'] = DOUBTED_SEGMENTS
    # What was learned at another rate may have been a rest before the tilt.
    if tilts and carried['undecided'] and has_rate(state['rest'], carried['undecided_rate']):
        take_back_tilt(state)
    else:
        take_back(state, max(unreachable, 1))
    return _accept_unreachable(state, found, lengths)


@kernel
def _accept_first_rest(state: Bias, found: BlockOutcome, lengths: RestLengths) -> bool:
    """Do as `accept_segment` where no bias is known, but a provisional one may be."""
    if not is_far_from_provisional(state):
        return True
    less_steady = is_less_steady(state)
    if state['hint'] == Hint.STANDS or not (less_steady or turns_about_vertical(state)):
        # One of the two was a turn about the vertical: the next rest shows which.
        give_up_bias(state)
        return True
    # A slow turn, or a motion that is nearly steady, as of a drone that takes off.
    if less_steady and found == BlockOutcome.SEGMENT:
        unlearn_first_segment(state['rest'])
    return _accept_unreachable(state, found, lengths)


@kernel
def _accept_unreachable(state: Bias, found: BlockOutcome, lengths: RestLengths) -> bool:
    """Accept a segment with a rate that the bias can't have come to, if it is one all the same.

    Return whether it is.
    """
    rest, turn = state['rest'], state['turn']
    # Noise is learned from whole segments alone.
    if found == BlockOutcome.SEGMENT and shows_motion(rest, lengths['block']):
        forget_noise(rest)
        learn_noise_from_segment(rest, lengths['block'])
        turn['gave_up'] = False
    elif is_back(state):
        turn['gave_up'] = False
        turn['mistaken'] = True
        state['walk'] = min(state['walk'], 1.0)
    else:
        quieter = found == BlockOutcome.SEGMENT and _is_far_quieter(state)
        outcome = update_slow_turn(state, lengths['block_seconds'], quieter)
        carried = state['carried']
        # Gravity tells within a minute, once it is carried on.
        undecided = carried['evidence'] == TiltEvidence.UNDECIDED and carried['seconds'] > 0.0
        waits = undecided or carried['evidence'] == TiltEvidence.TILT
        if outcome == SlowTurnOutcome.TURN or (waits and outcome == SlowTurnOutcome.LASTED):
            return False
        if outcome == SlowTurnOutcome.LASTED:
            if turn['moves']:
                _expect_warm_up(state)
            give_up_bias(state)
        else:
            turn['gave_up'] = False
    state['known'] = False
    state['doubted_segments'] = state['recent_count'] = 0
    return True


@kernel
def _is_far_quieter(state: Bias) -> bool:
    """Return whether the segment is far quieter than the quietest one that has shown the bias."""
    rates, accelerations = noise_level(state['rest'], 0), noise_level(state['rest'], 3)
    less = math.log(FAR_QUIETER)
    without = state['quietest_accelerations'] <= math.log(LEAST_VARIANCE)  # an accelerometer
    calmer = without or accelerations < state['quietest_accelerations'] + less
    return bool(calmer and rates < state['quietest_rates'] + less)


@kernel
def may_be_bias(state: Bias, rest: Rest) -> bool:
    """Return whether the mean of a segment of `rest` is a rate that the bias can have come to."""
    beyond = False
    for axis in range(3):
        beyond = beyond or _is_out_of_reach(state, rest, axis)
    return not beyond


@kernel
def _is_out_of_reach(state: Bias, rest: Rest, axis: int) -> bool:
    """Return whether the mean of an axis in a segment of `rest` lies where the bias can't be."""
    distance = segment_mean(rest, axis) - state['bias'][axis]
    spread = largest_bias_variance(state, axis) + segment_variance(rest, axis)
    return is_beyond_gate(distance, GATE, spread)


@kernel
def _is_beyond_max(rest: Rest, bias_max: float) -> bool:
    """Return whether the rate of the segment is beyond the largest bias, in rad/s."""
    beyond = False
    for axis in range(3):
        beyond = beyond or abs(segment_mean(rest, axis)) > bias_max
    return beyond


@kernel
def _let_gravity_move_bias(state: Bias) -> None:
    """Widen the bias by what gravity may add to it where it has another direction than before."""
    before, square = state['gravity'], 0.0
    for axis in range(3):
        change = segment_mean(state['rest'], 3 + axis) - before[axis]
        square += change * change
    if square > STEADY_GRAVITY * STEADY_GRAVITY:
        for axis in range(3):
            before[axis] = segment_mean(state['rest'], 3 + axis)
        widen(state, ACCELERATION_SENSITIVITY * ACCELERATION_SENSITIVITY * square)


@kernel
def _let_bias_come_to_segment(state: Bias) -> None:
    """Widen the bias as far as the segment: the robot itself says that it stands."""
    rest = state['rest']
    for axis in range(3):
        if _is_out_of_reach(state, rest, axis):
            distance = segment_mean(rest, axis) - state['bias'][axis]
            widen(state, max(distance * distance - state['process_noise'], 0.0))


@kernel
def _expect_warm_up(state: Bias) -> None:
    """Let the bias walk as fast as it has moved since the last rest: the sensor warms up."""
    largest = 0.0
    for axis in range(3):
        moved = segment_mean(state['rest'], axis) - state['bias'][axis]
        largest = max(largest, moved * moved)
    if state['largest_process_noise'] > 0.0:
        walk = largest / (WARM_UP_DEVIATIONS * WARM_UP_DEVIATIONS * state['largest_process_noise'])
        state['walk'] = max(state['walk'], 1.0) * max(walk, 1.0)
