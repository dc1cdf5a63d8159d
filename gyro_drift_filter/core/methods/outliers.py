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

"""Outliers or motion: a doubtful sample is held back until those after it say what it was.

A sample far outside the prediction is held back, and the prediction stands in for it. The next
sample decides. If it is back near the prediction, the first one was an outlier and leaves no trace,
unless the accelerometer felt a knock: then its angle is given back. If the samples grow smoothly
with one sign, go on by steps like the first one, or agree for longer than outliers last, they were
motion, and the filter starts anew at the sample at hand. If none of this holds, that sample is held
back, too, for a bounded number of samples. A jump that comes with a jolt of the accelerometer is a
knock, and the filter starts anew at the next sample that is still away; a message that is corrupted
as a whole has a jolt, too, but does not repeat.

At rest noise alone says what is far. In motion it has to be more than a body reaches in a sample
period, too, and no more than a push that shakes the accelerometer explains. After samples that were
missing or repeated an extrapolation says little: a rate that a body can have reached is no outlier.

This stands in place of the paper's equations (18) to (20), whose band compares squares of rates and
so grows tight as the robot turns. Here the threshold counts typical innovations, the same at every
rate of turn.
"""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.methods.adaptive_axis import AdaptiveAxis, AdaptiveAxisWorkspace
from gyro_drift_filter.core.methods.circumstances import Circumstances
from gyro_drift_filter.core.methods.doubt import (
    AGREEMENT,
    CONFIRMED_START,
    RETURN,
    Doubt,
    agreement,
    goes_further,
    holds_any,
)
from gyro_drift_filter.core.methods.outlier_limits import JOLT_LIMIT, OutlierLimits
from gyro_drift_filter.core.methods.reasons import Reason

EXTRAPOLATION_POWER = 1.5  # the error of an extrapolation over n samples grows as n to this power
GROWTH = 1.3  # motion that has only begun goes on growing by this factor a sample
GROWTH_START = 4.0  # thresholds: a motion begins with a smaller step than that
BODY_LIMIT_SAMPLES = 2  # so many more have to agree where a jump is beyond `body_limit`
LARGEST_SHARE_HELD = 0.25  # of the samples: above it the doubt is wrong, not the samples
# A foot that strikes the ground, or a body that falls, stops from any rate, with up to 6,000
# rad/s^2. So in motion a shake excuses a jump of any size, if it explains the jump at this distance
# from the axis, in levers: 4.5 cm, or 1 cm behind a sample that was held back, as most outliers are
# alone. But a burst of outliers stays where it has jumped to: there it takes 1.5 cm. A body that is
# slower in both samples has been stopped, and 0.5 cm are enough: what stops it may act close to the
# sensor, and an accelerometer shows only a part of a blow that is shorter than a sample period.
FIRST_HIT, CONFIRMED_HIT, STAYING_HIT, STOPPING_HIT = 1.5, 1.0 / 3.0, 0.5, 1.0 / 6.0
# The steps by which a body stops within 25 ms are alike within this factor at 100 Hz.
STEADY = 0.4
# Where more samples may be missing, no extrapolation says where a body has gone.
MOST_EXTRAPOLATED = 5
# The largest change of a rate that swings to and fro, in mean changes.
LARGEST_RATE_CHANGE = 3.0


@kernel
def find_reason(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
) -> Reason:
    """Return the reason for the decision on a sample (rad/s), after `fill_innovation_limits`."""
    doubt, innovation_limits = state['doubt'], workspace['innovation_limits']
    prediction, last_accepted = workspace['prediction'], state['last_accepted']
    size, dropout = abs(sample - prediction), circumstances['dropout']
    held = doubt['unaccepted']
    if doubt['share_held'] > LARGEST_SHARE_HELD and not dropout:
        return Reason.CROWDED if held == 0 else Reason.CROWDED_WHILE_HELD
    nearest = min(size, abs(sample - last_accepted), abs(sample - doubt['before_restart']))
    beyond = nearest > innovation_limits['body_jump']
    threshold = innovation_limits['innovation_threshold']
    doubtful = beyond or (size > threshold and size > innovation_limits['least_jump'])
    if _is_within_reach(state, workspace, circumstances, limits, sample) and not dropout:
        # What was held back is motion where the sample is nearer to that than to the prediction.
        near_held = holds_any(doubt) and abs(sample - doubt['last_sample']) < size
        if doubtful or near_held:
            return Reason.REACHED
        return Reason.RETURNED if holds_any(doubt) else Reason.EXPECTED
    if held > 0:
        return _reason_behind_held(state, workspace, circumstances, limits, sample, beyond)
    if dropout:
        return Reason.DROPOUT
    if not doubtful:
        return Reason.EXPECTED
    if doubt['confirmations'] < CONFIRMED_START:
        return Reason.UNCONFIRMED
    if _stays(sample, prediction, last_accepted):
        return Reason.STAYED
    if _is_pushed(size, circumstances, limits):
        return Reason.PUSHED
    if beyond:
        return Reason.BEYOND_BODY
    return Reason.FAR_WHILE_STILL if circumstances['still'] else Reason.FAR


@kernel
def _is_pushed(size: float, circumstances: Circumstances, limits: OutlierLimits) -> bool:
    """Return whether the accelerometer tells of a push that explains a jump of a size in rad/s."""
    # At rest a shake does not excuse a large jump: a message that is corrupted as a whole shows
    # one, too.
    shaken = circumstances['shake'] > limits['shake_per_jump'] * size
    shaken = shaken and (not circumstances['still'] or size <= limits['acceleration_limit'])
    felt = circumstances['jolted_before'] or shaken
    pushed = felt and size < _jolt_limit(circumstances, limits)
    return pushed or circumstances['explained_jump'] > FIRST_HIT * size


@kernel
def _jolt_limit(circumstances: Circumstances, limits: OutlierLimits) -> float:
    """Return what a hit may do to the rate in a sample, in rad/s."""
    return JOLT_LIMIT if circumstances['still'] else limits['jolt_limit']


@kernel
def _reason_behind_held(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
    beyond: bool,
) -> Reason:
    """Return the reason for the decision on a sample behind some that were held back or missing.

    `held` counts both. Arguments as for `find_reason`; `beyond` is true of a sample that no body
    reaches.
    """
    doubt, innovation = state['doubt'], sample - workspace['prediction']
    size, threshold = abs(innovation), workspace['innovation_limits']['innovation_threshold']
    held, offset = doubt['unaccepted'], doubt['offset']
    lasted = held >= limits['longest_hold']
    if circumstances['dropout']:
        # One more than other runs: two drop-outs of two samples each may follow each other.
        goes_on = lasted or doubt['agreeing'] > limits['run']
        return Reason.DROPOUT_GOES_ON if goes_on else Reason.DROPOUT
    same_side = innovation * offset > 0.0
    held_threshold = limits['threshold'] * doubt['typical_innovation']
    near = size <= held_threshold * (held + 1.0) ** EXTRAPOLATION_POWER
    # Beyond the prediction, on its other side, it is back as well: the prediction was off.
    away = same_side and size > 0.5 * threshold and size > RETURN * abs(offset)
    change = abs(sample - doubt['last_sample'])
    # A sample that lies by those held back belongs to them, wherever the prediction has gone.
    nearer = size < change or offset == 0.0
    if near and nearer and not away and not beyond:
        return Reason.RETURNED if holds_any(doubt) else Reason.EXPECTED
    last_accepted = state['last_accepted']
    if _turns_back(doubt, workspace, sample, last_accepted):
        return Reason.STAYED
    # Outliers are large: a smaller one that the next sample confirms was the start of a motion.
    small = same_side and abs(offset) <= limits['acceleration_limit']
    if small and change < limits['growth_limit']:
        return Reason.CONFIRMED
    hit, slower = CONFIRMED_HIT, _is_slower(sample, last_accepted)
    if slower and _is_slower(doubt['last_sample'], last_accepted):
        hit = STOPPING_HIT
    elif not slower and change <= AGREEMENT * abs(offset):
        hit = STAYING_HIT
    if circumstances['explained_jump'] > hit * size:
        return Reason.PUSHED
    # The first sample of a burst of outliers jumps further than a hit turns a body in a sample.
    jolt_limit = _jolt_limit(circumstances, limits)
    burst = doubt['first_size'] >= jolt_limit or size >= jolt_limit * (held + 1.0)
    if circumstances['jolted'] and not burst:
        return Reason.JOLTED
    # Outliers do not go away further and further, as a body does that gains speed.
    if doubt['growing'] > 0 and goes_further(doubt, innovation, change, limits):
        return Reason.GROWN_AGAIN
    grows = same_side and size > GROWTH * abs(offset)
    starts = abs(offset) < GROWTH_START * held_threshold * (held * 1.0) ** EXTRAPOLATION_POWER
    alone = doubt['agreeing'] <= 1  # a burst that lasts does not grow
    if grows and starts and alone and change < limits['growth_limit']:
        return Reason.GROWN
    if _goes_on(doubt, circumstances, limits, sample, last_accepted):
        return Reason.GONE_ON
    alike = change <= agreement(offset, held_threshold, limits)
    run = limits['run'] + (BODY_LIMIT_SAMPLES if abs(offset) > limits['body_limit'] else 0)
    if alike and doubt['agreeing'] >= run:
        return Reason.AGREED
    if lasted:
        return Reason.HELD_LONGEST
    return Reason.UNDECIDED if holds_any(doubt) else Reason.BEYOND_REACH


@kernel
def _is_within_reach(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
) -> bool:
    """Return whether the rate can have come to a sample (rad/s) while nothing was measured.

    The extrapolation to it says little then: what the body can have come to is no outlier. One that
    stood still before has hardly got anywhere yet.
    """
    doubt, still, largest = state['doubt'], circumstances['still'], -1.0
    possible = circumstances['possibly_missing']
    if doubt['unmeasured'] > 0:
        samples = doubt['unmeasured'] + 1.0
        largest = limits['body_limit'] * samples
        if still:
            largest = min(largest, limits['least_jump_while_still'] * samples * samples)
    if may_lie_behind_gap(circumstances) and not still:
        largest = max(largest, limits['body_limit'] * (possible + 1.0))
    if doubt['behind_gap'] and not still:
        # One sample behind a gap does not show yet how the motion has changed meanwhile.
        change = min(LARGEST_RATE_CHANGE * doubt['usual_rate_change'], limits['body_limit'])
        largest = max(largest, 2.0 * change)
    if abs(sample - state['last_accepted']) <= largest:
        return True
    return (
        possible > 0 and not still and _is_extrapolated(state, workspace, limits, sample, possible)
    )


@kernel
def may_lie_behind_gap(circumstances: Circumstances) -> bool:
    """Return whether so many samples may be missing that no extrapolation says what comes."""
    return bool(circumstances['possibly_missing'] > MOST_EXTRAPOLATED)


@kernel
def _is_extrapolated(
    state: AdaptiveAxis,
    workspace: AdaptiveAxisWorkspace,
    limits: OutlierLimits,
    sample: float,
    possible: int,
) -> bool:
    """Return whether a sample (rad/s) is one that is predicted if up to `possible` are missing.

    The error of a prediction grows with the samples that it goes ahead, by no more than a body does
    in one of them.
    """
    prediction, steps = workspace['prediction'], state['doubt']['unaccepted'] + 1.0
    innovation = sample - prediction
    ahead = possible * (prediction - state['last_accepted']) / steps
    nearest = min(max(innovation, min(ahead, 0.0)), max(ahead, 0.0))
    limit = workspace['innovation_limits']['innovation_threshold'] * (possible + 1.0)
    return abs(innovation - nearest) <= min(limit, limits['body_limit'])


@kernel
def _stays(sample: float, prediction: float, last_accepted: float) -> bool:
    """Return whether a rate has changed by no more than was predicted, if the other way.

    A motion may end at once, and an outlier hardly lies there. But a rate that has not changed at
    all was not measured. All arguments in rad/s.
    """
    return 0.0 < abs(sample - last_accepted) <= abs(prediction - last_accepted)


@kernel
def _is_slower(sample: float, last_accepted: float) -> bool:
    """Return whether a body turns more slowly than before: something may have stopped it.

    Sample and last accepted one in rad/s.
    """
    return abs(sample) < abs(last_accepted)


@kernel
def _turns_back(
    doubt: Doubt, workspace: AdaptiveAxisWorkspace, sample: float, last_accepted: float
) -> bool:
    """Return whether a motion has turned back while samples were held: its prediction ran away.

    The rate lies where the last accepted one did. In a burst of outliers it would be as far from
    the prediction as the one before it. Sample and last accepted one in rad/s.
    """
    prediction, offset = workspace['prediction'], doubt['offset']
    apart = abs(sample - prediction - offset) > AGREEMENT * abs(offset)
    stays = workspace['is_at_accepted'] and _stays(sample, prediction, last_accepted)
    return apart and stays


@kernel
def _goes_on(
    doubt: Doubt,
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
    last_accepted: float,
) -> bool:
    """Return whether a sample goes on as those held back: by like steps, as a body that is stopped.

    A burst of outliers begins with a jump that is larger than its steps, and steps from one burst
    to another lead back to where the first one came from, and beyond. Two outliers in a row may
    look like two steps, so behind a single sample the body has to be slower than before, and the
    accelerometer has to be shaken by as much as explains the larger step 1 cm from the axis. Sample
    and last accepted one in rad/s.
    """
    step, before = sample - doubt['last_sample'], doubt['step']
    if step * before <= 0.0:
        return False
    largest = max(abs(step), abs(before))
    if doubt['unaccepted'] == 1:
        explained = circumstances['shake'] > CONFIRMED_HIT * limits['shake_per_jump'] * largest
        if circumstances['still'] or not explained or not _is_slower(sample, last_accepted):
            return False
    else:
        begun = (sample - step - before - last_accepted) / (doubt['unaccepted'] - 1.0)
        if begun * step < 0.0:
            return False
        largest = max(largest, abs(begun))
    least = max(STEADY * largest, LARGEST_RATE_CHANGE * doubt['usual_rate_change'])
    return min(abs(step), abs(before)) >= least
