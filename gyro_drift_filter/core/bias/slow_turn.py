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

"""A rate of rest that is not the bias: a slow turn, or a bias that has jumped.

A gyroscope alone can't tell the one from the other, so such a rate is a turn unless it stays for
longer than robots turn slowly. Gravity tells them apart sooner: a turn about any axis but the
vertical would move it. Where it stands the bias has jumped, as when a sensor is switched on anew,
takes its own bias off, or has had a blow. And so it has changed where the body stands with this
rate, turns elsewhere at a rate that no bias has, and stands with it again: as the bias of a sensor
that warms up faster than it is expected to. But a head that scans slowly, and turns back fast or
on round, is where it began by then, which would be chance if it had stood. While a bias still warms
up, the rate has moved on by then: the same way, and no faster than it has come from the bias, as a
sensor warms up ever more slowly.
"""

import math
from enum import IntEnum
from typing import TYPE_CHECKING, TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.rest.noise import segment_variance
from gyro_drift_filter.core.rest.records import Rest, RestLengths
from gyro_drift_filter.core.rest.segment import block_mean, is_block_filled, segment_mean
from gyro_drift_filter.core.rest.standing import LEAST_GRAVITY, STEADY_GRAVITY

if TYPE_CHECKING:
    from gyro_drift_filter.core.bias.records import Bias

# A turn lasts no longer than this: then it is the bias after all. No body is quieter while it turns
# than while it stands, but beside a machine that has stopped meanwhile.
LONGEST_TURN, LONGEST_QUIETER_TURN = 90.0, 30.0  # s
# It stays, or moves on as a bias that warms up does, within so many deviations of its noise.
SAME_TURN_GATE = 4.0
# A body that has turned by so much in between, in rad, has not kept on turning slowly meanwhile.
TURN_BETWEEN = 1.0
# The slow turn of a head that scans is this share of the fast one that takes it back, or round to
# where it begins: to so many rad. The first slow turn may have begun within the sector, with this
# share of it left.
LEAST_SCANNED, SAME_HEADING, LEAST_LEFT = 0.2, 0.3, 1.0 / 3.0
# Two slow turns in a row may be as fast as one bias that warms up, by chance. So it has to be there
# again so often, where one that has jumped has to be once.
RETURNS_OF_WARM_UP = 2
# No bias warms up faster, in rad/s^2: by 10 K a minute at 0.2 deg/s per K, more than data sheets
# say.
FASTEST_WARM_UP = 5.8e-4
# Gravity denies a turn that should have moved it by so much, three times what it may move and still
# stand, where the part of the turn across it is more than this share of the whole. What is less may
# be a turn about the vertical: no vehicle without wings leans by 30 degrees and keeps leaning.
LEAST_ANGLE = 0.06  # rad
LEAST_SHARE_ACROSS = 0.5
# A turn that stops has the bias that is known, in so many still blocks in a row at least, which are
# a second: half of a segment of rest. A smooth motion may have that rate for half a second.
STOP_BLOCKS = 8
# The bias that was given up is back where the rate is so near it, as a share of the way from there.
BACK_SHARE = 0.1
# A rate lies where the bias can be within so many deviations; the part across it lies beyond.
GATE = 3.5


class SlowTurnOutcome(IntEnum):
    """What the rate of a segment is, if it is not the bias that is known."""

    TURN = 0  # a turn, as far as is known
    DENIED = 1  # another bias: gravity stands, and would have moved with a turn
    LASTED = 2  # another bias, as it has stayed for longer than a turn, or over a faster turn


class SlowTurn(TypedDict):
    """The rate of rest that was not accepted as the bias."""

    rate: PerAxis  # rad/s, of the last segment
    since_rest: float  # s, from the last rest to that segment
    seconds: float  # for how long rest has had it
    moves: bool  # it has moved on meanwhile
    turned: float  # rad, by which the body has turned since, at rates that no bias has
    # by which it has turned the way of the slow turn, in rad, since the first segment of it or the
    # first one after a fast turn; and the most of that at a segment
    heading: float
    scanned: float
    scans: bool  # the last fast turn has ended where the slow one began, as that of a scan
    returns: int  # how often it has stood again with this rate after such a turn
    blocks_at_bias: int  # in a row, up to now, in which the rate was the bias that is known
    # the stillness under way, for as long as it has had this rate and gravity has stood
    standing_seconds: float
    angle: PerAxis  # rad, by which the body would have turned
    gravity: PerAxis  # m/s^2, at its beginning
    mistaken: bool  # a turn was once taken for the bias, so that the body turns slowly at times
    # the bias that was given up for a rate that has lasted, and may yet have been right
    gave_up: bool  # there is one
    given_up: PerAxis  # rad/s
    given_up_variance: PerAxis  # (rad/s)^2


@kernel
def largest_bias_variance(state: 'Bias', axis: int) -> float:
    """Return the variance of a bias that has walked as far as it may by now, in (rad/s)^2."""
    return float(state['variance'][axis] + state['largest_process_noise'])


@kernel
def forget_slow_turn(turn: SlowTurn) -> None:
    """Begin anew: the bias is known."""
    turn['seconds'] = 0.0
    turn['moves'] = False
    turn['turned'] = turn['heading'] = turn['scanned'] = 0.0
    turn['scans'] = False
    turn['returns'] = 0
    turn['blocks_at_bias'] = 0
    interrupt_slow_turn(turn)


@kernel
def interrupt_slow_turn(turn: SlowTurn) -> None:
    """Note that the body has moved, so that gravity tells nothing of the time before."""
    turn['standing_seconds'] = 0.0
    for axis in range(3):
        turn['angle'][axis] = 0.0


@kernel
def note_turning(state: 'Bias', lengths: RestLengths, bias_max: float) -> None:
    """Note by how much the body turns in the full block, and whether beyond `bias_max` (rad/s).

    A slow turn that is nearly as fast exceeds that by noise now and then, and is none in between.
    """
    turn, rest = state['turn'], state['rest']
    if turn['seconds'] == 0.0 or not is_block_filled(rest, lengths):
        return
    rate, differs = 0.0, False
    along = square = 0.0
    for axis in range(3):
        mean, scatter = block_mean(rest, axis), rest['signals'][axis]['scatter']
        slow = turn['rate'][axis] - state['bias'][axis]
        along += (mean - state['bias'][axis]) * slow
        square += slow * slow
        rate = max(rate, abs(mean))
        differs = differs or is_beyond_gate(mean - turn['rate'][axis], SAME_TURN_GATE, scatter)
    if rate > bias_max and differs:
        turn['turned'] += rate * lengths['block_seconds']
    if square > 0.0:
        turn['heading'] += along / math.sqrt(square) * lengths['block_seconds']


@kernel
def note_stop(state: 'Bias', lengths: RestLengths) -> None:
    """Note whether the full block has the bias that is known, in the midst of a slow turn."""
    turn, rest = state['turn'], state['rest']
    if turn['seconds'] == 0.0 or not is_block_filled(rest, lengths):
        turn['blocks_at_bias'] = 0
        return
    at_bias, differs = True, False
    for axis in range(3):
        mean, scatter = block_mean(rest, axis), rest['signals'][axis]['scatter']
        spread = largest_bias_variance(state, axis) + scatter
        at_bias = at_bias and not is_beyond_gate(mean - state['bias'][axis], GATE, spread)
        differs = differs or is_beyond_gate(mean - turn['rate'][axis], SAME_TURN_GATE, spread)
    turn['blocks_at_bias'] = turn['blocks_at_bias'] + 1 if at_bias and differs else 0


@kernel
def end_stopped_turn(turn: SlowTurn, still_blocks: int) -> None:
    """Forget the turn if the body has stopped, as a bias that has jumped does not come back.

    So many `still_blocks` there are in a row by now.
    """
    if min(turn['blocks_at_bias'], still_blocks) >= STOP_BLOCKS:
        forget_slow_turn(turn)


@kernel
def update_slow_turn(state: 'Bias', block_seconds: float, quieter: bool) -> SlowTurnOutcome:
    """Update by a segment whose rate is not the bias; return what that rate is.

    A block of the segment lasts `block_seconds`. It may be far `quieter` than all rest that has
    shown the bias.
    """
    turn, rest, bias = state['turn'], state['rest'], state['bias']
    seconds, since_rest = rest['blocks'] * block_seconds, state['seconds_since_rest']
    if turn['seconds'] > 0.0 and not _stays(turn, rest):
        turn['moves'] = _moves_on(turn, rest, since_rest, bias)
        if not turn['moves']:
            forget_slow_turn(turn)
    if turn['standing_seconds'] > 0.0 and not _gravity_stands(turn, rest):
        interrupt_slow_turn(turn)
    variance = noise = 0.0  # of the axis where each is largest
    for axis in range(3):
        variance = max(variance, largest_bias_variance(state, axis))
        noise = max(noise, segment_variance(rest, axis))
        turn['rate'][axis] = segment_mean(rest, axis)
        turn['angle'][axis] += (segment_mean(rest, axis) - bias[axis]) * seconds
        if turn['standing_seconds'] == 0.0:
            turn['gravity'][axis] = rest['signals'][3 + axis]['segment']['first']
    turn['since_rest'] = since_rest
    turn['seconds'] += seconds
    turn['standing_seconds'] += seconds
    standing = turn['standing_seconds']
    uncertain = standing * (standing * variance + seconds * noise)
    if _is_denied(turn, rest, uncertain):
        return SlowTurnOutcome.DENIED
    if turn['turned'] > TURN_BETWEEN:
        turn['scans'] = _scans(turn)
        if turn['scans']:
            turn['seconds'] = seconds
        else:
            turn['returns'] += 1
        turn['turned'] = turn['heading'] = turn['scanned'] = 0.0
    turn['scanned'] = max(turn['scanned'], turn['heading'])
    needed = RETURNS_OF_WARM_UP if turn['moves'] else 1
    again = turn['returns'] >= needed and not turn['mistaken']
    quieter_lasts = quieter and turn['seconds'] >= LONGEST_QUIETER_TURN and not turn['mistaken']
    lasted = again or quieter_lasts or turn['seconds'] >= LONGEST_TURN
    return SlowTurnOutcome.LASTED if lasted else SlowTurnOutcome.TURN


@kernel
def _scans(turn: SlowTurn) -> bool:
    """Return whether the body has turned back fast to where it began to turn slowly, or round."""
    heading, scanned = turn['heading'], turn['scanned']
    off = abs(heading - 2.0 * math.pi * round(heading / (2.0 * math.pi)))
    behind = not turn['scans'] and 0.0 < -heading < (1.0 / LEAST_LEFT - 1.0) * scanned
    is_back = off < SAME_HEADING or behind
    return bool(is_back and scanned > LEAST_SCANNED * turn['turned'])


@kernel
def _stays(turn: SlowTurn, rest: Rest) -> bool:
    """Return whether the segment has the rate of the one before."""
    for axis in range(3):
        distance = segment_mean(rest, axis) - turn['rate'][axis]
        spread = 2.0 * segment_variance(rest, axis)
        if is_beyond_gate(distance, SAME_TURN_GATE, spread):
            return False
    return True


@kernel
def _moves_on(turn: SlowTurn, rest: Rest, since_rest: float, bias: PerAxis) -> bool:
    """Return whether the rate has moved on since the segment before as a bias does that warms up.

    That is between where it was and where it would be if it went on as fast as it has come from the
    `bias` (3,) in rad/s, within `since_rest` s by now.
    """
    if turn['since_rest'] <= 0.0:
        return False
    share = since_rest / turn['since_rest']
    for axis in range(3):
        before = turn['rate'][axis] - bias[axis]
        if abs(before) > FASTEST_WARM_UP * turn['since_rest']:
            return False
        now = segment_mean(rest, axis) - bias[axis]
        furthest = share * before
        beyond = max(min(before, furthest) - now, now - max(before, furthest))
        spread = (1.0 + share * share) * segment_variance(rest, axis)
        if beyond > 0.0 and is_beyond_gate(beyond, SAME_TURN_GATE, spread):
            return False
    return True


@kernel
def give_up_bias(state: 'Bias') -> None:
    """Keep the bias that another rate replaces, as that may yet have been a turn.

    Where an earlier one that was given up may yet be right, that is kept.
    """
    turn = state['turn']
    if turn['gave_up']:
        return
    turn['gave_up'] = True
    for axis in range(3):
        turn['given_up'][axis] = state['bias'][axis]
        turn['given_up_variance'][axis] = largest_bias_variance(state, axis)


@kernel
def is_back(state: 'Bias') -> bool:
    """Return whether the segment has the bias that was given up: what lasted was a turn."""
    turn, rest = state['turn'], state['rest']
    if not turn['gave_up']:
        return False
    jump = 0.0
    for axis in range(3):
        change = state['bias'][axis] - turn['given_up'][axis]
        jump += change * change
    for axis in range(3):
        distance = segment_mean(rest, axis) - turn['given_up'][axis]
        spread = turn['given_up_variance'][axis] + segment_variance(rest, axis)
        far = distance * distance > BACK_SHARE * BACK_SHARE * jump
        if far and is_beyond_gate(distance, GATE, spread):
            return False
    return True


@kernel
def _gravity_stands(turn: SlowTurn, rest: Rest) -> bool:
    for axis in range(3):
        last = rest['signals'][3 + axis]['segment']['last']
        if abs(last - turn['gravity'][axis]) > STEADY_GRAVITY:
            return False
    return True


@kernel
def _is_denied(turn: SlowTurn, rest: Rest, variance: float) -> bool:
    """Return whether gravity would have moved with the turn, and has not.

    `variance` is that of the angle about an axis, in rad^2.
    """
    angle, gravity = turn['angle'], turn['gravity']
    size = across = whole = 0.0
    # An accelerometer without noise may hang.
    lives = False
    for axis in range(3):
        after, behind = (axis + 1) % 3, (axis + 2) % 3
        change = angle[after] * gravity[behind] - angle[behind] * gravity[after]
        across += change * change
        size += gravity[axis] * gravity[axis]
        whole += angle[axis] * angle[axis]
        sums = rest['signals'][3 + axis]['segment']
        lives = lives or sums['first'] != sums['last']
    if size < LEAST_GRAVITY * LEAST_GRAVITY or not lives or not _gravity_stands(turn, rest):
        return False
    across /= size
    least = max(LEAST_ANGLE, LEAST_SHARE_ACROSS * math.sqrt(whole), GATE * math.sqrt(variance))
    return bool(across > least * least)
