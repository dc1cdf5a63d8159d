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

"""A slow swing, as of a boat or of a hand: where its rate is largest it changes least, as at rest.

So there a segment may pass for rest, and its mean for the bias. How much the mean rates of the
gentle motion before it vary, and how fast, tells how far from the bias such a mean may lie.
"""

import math
from typing import TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.rest.records import HALF, SIGNALS, Obstacle, Rest, RestLengths
from gyro_drift_filter.core.rest.segment import LEAST_VARIANCE, block_mean, is_block_filled
from gyro_drift_filter.core.rest.stationarity import MEAN_DEVIATIONS, obstacle_of_block

# A swing is remembered for so long, in s: about as long as a boat takes to roll to and fro. From 15
# to 60 s little changes, but that a rest is learned later.
SWING_SECONDS = 15.0
# The square of one distance counts for so many variances at most: noise may throw one mean far.
LARGEST_SURPRISE = 4.0


class Swing(TypedDict):
    """How the mean rates of a gentle motion vary: each over `HALF` blocks, half of a segment."""

    blocks: int  # so many blocks of the mean under way
    sum: PerAxis  # rad/s, of these blocks
    follows: bool  # the motion was as gentle before this mean, so that it follows the last one
    last: PerAxis  # rad/s, the last mean
    centre: PerAxis  # rad/s, what the means vary about
    variance: PerAxis  # (rad/s)^2
    step_variance: PerAxis  # (rad/s)^2, mean square of the difference of two means in a row


SWING = record(Swing)


@kernel
def forget_swing(swing: Swing) -> None:
    """Start as if nothing had moved."""
    _interrupt(swing, 1.0)


@kernel
def note_swing(swing: Swing, rest: Rest, lengths: RestLengths) -> None:
    """Take a block in that is full and has not been judged yet."""
    share = lengths['block_seconds'] / SWING_SECONDS
    if rest['at_rest'] or not _is_gentle(rest, lengths):
        _interrupt(swing, share)
        _end(swing, rest)
        return
    for axis in range(3):
        swing['sum'][axis] += block_mean(rest, axis)
    swing['blocks'] += 1
    if swing['blocks'] == HALF:
        _take_mean(swing, rest, HALF * share)


@kernel
def _interrupt(swing: Swing, share: float) -> None:
    """Begin another mean, and forget a share of what varied."""
    swing['blocks'] = 0
    swing['follows'] = False
    for axis in range(3):
        swing['sum'][axis] = 0.0
        swing['variance'][axis] *= 1.0 - share
        swing['step_variance'][axis] *= 1.0 - share


@kernel
def _end(swing: Swing, rest: Rest) -> None:
    """Forget what varied on an axis, if all of it would have shown by now.

    A swing that is larger than what passes for rest has crossed its centre after half a period.
    """
    for axis in range(3):
        seen = swing['variance'][axis] > _largest_bend(rest, axis)
        angle = math.acos(min(max(_correlation(swing, axis), -1.0), 1.0))
        if seen and angle * rest['run'] > math.pi * HALF:
            swing['variance'][axis] = swing['step_variance'][axis] = 0.0


@kernel
def _largest_bend(rest: Rest, axis: int) -> float:
    """Return the largest square of a change, in (rad/s)^2, that may pass for noise of a block."""
    return float(MEAN_DEVIATIONS * MEAN_DEVIATIONS * rest['signals'][axis]['scatter'])


@kernel
def _correlation(swing: Swing, axis: int) -> float:
    """Return the correlation of two means in a row."""
    variance, step_variance = swing['variance'][axis], swing['step_variance'][axis]
    return float(1.0 - 0.5 * step_variance / max(variance, LEAST_VARIANCE))


@kernel
def _is_gentle(rest: Rest, lengths: RestLengths) -> bool:
    """Return whether the values of the block vary no more than the noise does."""
    gentle = rest['known'] and is_block_filled(rest, lengths)
    for i in range(SIGNALS):
        gentle = gentle and obstacle_of_block(rest, i) != Obstacle.VARIES
    return gentle


@kernel
def _take_mean(swing: Swing, rest: Rest, share: float) -> None:
    """Take the mean that is complete in, by its share, less what noise makes of it."""
    for axis in range(3):
        mean, noise = swing['sum'][axis] / HALF, rest['signals'][axis]['scatter'] / HALF
        if swing['follows']:
            distance, step = mean - swing['centre'][axis], mean - swing['last'][axis]
            variance, step_variance = swing['variance'][axis], swing['step_variance'][axis]
            square = min(distance * distance, LARGEST_SURPRISE * (variance + noise))
            variance += share * (square - noise - variance)
            step_variance += share * (step * step - 2.0 * noise - step_variance)
            swing['variance'][axis] = max(variance, 0.0)
            swing['step_variance'][axis] = max(step_variance, 0.0)
            swing['centre'][axis] += share * distance
        else:
            swing['centre'][axis] = mean
        swing['last'][axis] = mean
        swing['sum'][axis] = 0.0
    swing['blocks'] = 0
    swing['follows'] = True


@kernel
def variance_of_swing(swing: Swing, rest: Rest, axis: int) -> float:
    """Return the variance in (rad/s)^2 about the bias of means that pass for rest in the swing.

    If c is the correlation of two means in a row, a swing of amplitude A bends by A (1 - c) from
    the middle of a segment to its end. A segment passes that bends by `MEAN_DEVIATIONS` of a
    block's noise at most, and so does no faster one, whose means in a row have opposite signs.
    """
    variance, correlation = swing['variance'][axis], _correlation(swing, axis)
    if correlation <= 0.0:
        return 0.0
    bend = _largest_bend(rest, axis)
    left = (1.0 - correlation) / correlation
    return float(variance if left * left * variance <= bend else bend / (left * left))
