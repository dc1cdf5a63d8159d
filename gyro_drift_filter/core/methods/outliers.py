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

import math
from typing import TYPE_CHECKING, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.methods.jolts import (
    LEAST_USUAL,
    USUAL_LIMIT,
    shake_per_jump,
    usual_after,
)
from gyro_drift_filter.core.methods.mode_set import FORESEEN_SECONDS
from gyro_drift_filter.core.methods.noise import LARGEST_NOISE
from gyro_drift_filter.core.methods.reasons import Decision, Reason, decision_of
from gyro_drift_filter.core.sensor_checks import RANGE

if TYPE_CHECKING:
    from gyro_drift_filter.core.methods.adaptive_axis import AdaptiveAxis, AdaptiveAxisWorkspace
    from gyro_drift_filter.core.settings import Settings

RETURN = 0.5  # back by half the jump: the jump was an outlier
EXTRAPOLATION_POWER = 1.5  # the error of an extrapolation over n samples grows as n to this power
GROWTH = 1.3  # motion that has only begun goes on growing by this factor a sample ...
GROWTH_LIMIT = 500.0  # rad/s^2: ... and by no more than an arm can do
GROWTH_START = 4.0  # thresholds: a motion begins with a smaller step than that
# At sample periods above `FORESEEN_SECONDS` the least jump in motion grows with what the modes fail
# to foresee, up to the change of a hand that reverses its turn, in rad/s.
LARGEST_REVERSAL = 16.0
JERK_FROM_REST = 250.0  # rad/s^3: a motion that begins faster shows in the next sample
AGREEMENT = 0.25  # of the jump: held samples that differ by more are no motion,
AGREEMENT_LIMIT = 150.0  # rad/s^2: nor those that differ by more than this
BODY_LIMIT = 1000.0  # rad/s^2: what is not hit does no more, so a jump beyond needs ...
BODY_LIMIT_SAMPLES = 2  # ... so many samples more to be accepted
CONSTANT_DEVIATIONS = 0.01  # standard deviations of the noise: repeats closer than this ...
CONSTANT_SAMPLES = 14  # ... so many times are a constant, whatever was learned before

CONFIRMED_START = 2  # samples that agree: until then the first one is as doubtful as the next

LARGEST_SHARE_HELD = 0.25  # of the samples: above it the doubt is wrong, not the samples ...
SHARE_MEMORY = 0.025  # ... with this weight of a sample in the share
LEAST_SHARE = 1e-9  # as processors are slow with denormal numbers

JOLT_LIMIT = 6.0  # rad/s: what a hit may do to the rate in a sample, ...
JOLT_ACCELERATION = 300.0  # rad/s^2: ... or in a longer period, up to `LARGEST_REVERSAL`
# A foot that strikes the ground, or a body that falls, stops from any rate, with up to 6,000
# rad/s^2. So in motion a shake excuses a jump of any size, if it explains the jump at this distance
# from the axis, in levers: 4.5 cm, or 1 cm behind a sample that was held back, as most outliers are
# alone. But a burst of outliers stays where it has jumped to: there it takes 1.5 cm, unless the
# body is slower than before, as what stops a body may act close to the sensor.
FIRST_HIT, CONFIRMED_HIT, STAYING_HIT = 1.5, 1.0 / 3.0, 0.5
# The steps by which a body stops within 25 ms are alike within this factor at 100 Hz.
STEADY = 0.4

# Where more samples may be missing, no extrapolation says where a body has gone.
MOST_EXTRAPOLATED = 5
# The largest change of a rate that swings to and fro, in mean changes.
LARGEST_RATE_CHANGE = 3.0


class Circumstances(TypedDict):
    """What is known of a sample beside its rate on the axis at hand."""

    possibly_missing: int  # samples before it, which its stamp and earlier losses do not rule out
    may_follow_gap: bool  # samples were missing before, and may be again before this one
    dropout: bool  # the sensor had nothing to report
    repeated: bool  # the sensor has not measured since the sample before
    still: bool  # some blocks of samples before it have been still,
    noise_alone: bool  # and so many that a whole block of noise lies within them
    jolted: bool  # the accelerometer has just been shaken,
    jolted_before: bool  # or had been at the sample before
    shake: float  # m/s^2, by which the acceleration has changed, now or at the sample before
    explained_jump: float  # rad/s, of a body that is hit in motion, see `jump_by_shake`
    transition: int  # a member of Transition: what the modes are expected to do


class OutlierLimits(TypedDict):
    """Limits for one sample period."""

    threshold: float  # typical or usual innovations
    acceleration_limit: float  # rad/s, by `outlier.acceleration` in a sample period
    least_jump: float  # rad/s,
    least_jump_while_still: float  # rad/s, the same where the sensor is still
    growth_limit: float  # rad/s
    agreement_limit: float  # rad/s
    body_limit: float  # rad/s
    jolt_limit: float  # rad/s
    shake_per_jump: float  # m/s^2 for a jump of 1 rad/s
    run: int  # samples: the longest run of equal outliers
    longest_hold: int  # samples


class Doubt(TypedDict):
    """The samples of one axis that are held back, and the last one."""

    held: int  # consecutive samples that were held back or are missing
    unmeasured: int  # consecutive samples that were not measured, up to the last one
    confirmations: int  # accepted samples since the one that it starts at, itself among them
    behind_gap: bool  # the last one that was measured was the first one after some that were not
    # These mean nothing where none is held.
    agreeing: int  # how many of the latest agree
    growing: int  # how many of the latest were each further away than the one before
    offset: float  # innovation of the last one in rad/s, 0 after a drop-out
    # rad/s, to the last one from that before it, be it held or accepted; 0 where one of the two was
    # not measured
    step: float
    typical_innovation: float  # rad/s, when the first one came
    first_size: float  # rad/s, of its innovation; 0 where it was not measured
    # of every sample
    before_restart: float  # rad/s, the accepted one before all modes last started anew
    usual_innovation: float  # rad/s, of the last samples
    usual_rate_change: float  # rad/s, from one of those that were accepted to the next
    last_sample: float  # as it came, rad/s
    repeats: int  # how often it has come before
    share_held: float  # of the last samples, not counting drop-outs


class InnovationLimits(TypedDict):
    """What the innovation of the sample at hand has to exceed to be doubtful, in rad/s."""

    innovation_threshold: float  # `outlier.threshold` typical or usual innovations
    least_jump: float  # by `outlier.acceleration`, or less where the sensor is still
    body_jump: float  # beyond this it is doubtful whatever the other two are


@kernel
def derive_limits(settings: 'Settings', period: float, limits: OutlierLimits) -> None:
    """Fill the limits for a sample period in s."""
    enabled = settings['outlier_enabled']
    limits['threshold'] = settings['outlier_threshold'] if enabled else np.inf
    limit = settings['outlier_acceleration'] * period
    unforeseen = max(period / FORESEEN_SECONDS, 1.0) ** 2.0
    limits['acceleration_limit'] = limit
    limits['least_jump'] = max(min(limit * unforeseen, LARGEST_REVERSAL), limit)
    from_rest = 0.5 * JERK_FROM_REST * period * period
    limits['least_jump_while_still'] = min(from_rest, limit)
    limits['growth_limit'] = GROWTH_LIMIT * period
    limits['agreement_limit'] = AGREEMENT_LIMIT * period
    limits['body_limit'] = BODY_LIMIT * period
    limits['jolt_limit'] = max(JOLT_LIMIT, min(JOLT_ACCELERATION * period, LARGEST_REVERSAL))
    limits['shake_per_jump'] = shake_per_jump(period)
    limits['run'] = settings['outlier_run']
    limits['longest_hold'] = 2 * settings['outlier_run'] + 2


@kernel
def start_doubt(doubt: Doubt, sample: float) -> None:
    """Start at a sample (rad/s)."""
    doubt['held'] = doubt['unmeasured'] = doubt['confirmations'] = 0
    doubt['behind_gap'] = False
    doubt['before_restart'] = sample
    doubt['usual_innovation'] = LARGEST_NOISE
    doubt['usual_rate_change'] = LEAST_USUAL
    doubt['repeats'] = 0
    doubt['share_held'] = 0.0
    doubt['last_sample'] = sample


@kernel
def fill_innovation_limits(
    innovation_limits: InnovationLimits,
    doubt: Doubt,
    typical_innovation: float,
    still: bool,
    limits: OutlierLimits,
) -> None:
    """Fill in what the innovation of a sample has to exceed, before `find_reason`.

    The typical innovation, in rad/s, is what the modes expect of white noise.
    """
    usual = limits['threshold'] * doubt['usual_innovation']
    innovation_limits['innovation_threshold'] = max(limits['threshold'] * typical_innovation, usual)
    least_jump = limits['least_jump_while_still'] if still else limits['least_jump']
    innovation_limits['least_jump'] = least_jump
    # No body jumps this far, whatever the modes expect, except back from where outliers led.
    innovation_limits['body_jump'] = max(limits['jolt_limit'], limits['body_limit'], usual)


@kernel
def find_reason(
    state: 'AdaptiveAxis',
    workspace: 'AdaptiveAxisWorkspace',
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
) -> Reason:
    """Return the reason for the decision on a sample (rad/s), after `fill_innovation_limits`."""
    doubt, innovation_limits = state['doubt'], workspace['innovation_limits']
    prediction, last_accepted = workspace['prediction'], state['last_accepted']
    size, dropout = abs(sample - prediction), circumstances['dropout']
    held = doubt['held']
    if doubt['share_held'] > LARGEST_SHARE_HELD and not dropout:
        return Reason.CROWDED if held == 0 else Reason.CROWDED_WHILE_HELD
    apart = min(size, abs(sample - last_accepted), abs(sample - doubt['before_restart']))
    beyond = apart > innovation_limits['body_jump']
    threshold = innovation_limits['innovation_threshold']
    doubtful = beyond or (size > threshold and size > innovation_limits['least_jump'])
    if _is_within_reach(state, workspace, circumstances, limits, sample) and not dropout:
        if doubtful:
            return Reason.REACHED
        return Reason.RETURNED if _holds_any(doubt) else Reason.EXPECTED
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
    state: 'AdaptiveAxis',
    workspace: 'AdaptiveAxisWorkspace',
    circumstances: Circumstances,
    limits: OutlierLimits,
    sample: float,
    beyond: bool,
) -> Reason:
    """Return the reason for the decision on a sample that comes behind some that were held back.

    Arguments as for `find_reason`; `beyond` is true of a sample that no body reaches.
    """
    doubt, innovation = state['doubt'], sample - workspace['prediction']
    size, threshold = abs(innovation), workspace['innovation_limits']['innovation_threshold']
    held, offset = doubt['held'], doubt['offset']
    lasted = held >= limits['longest_hold']
    if circumstances['dropout']:
        # One more than other runs: two drop-outs of two samples each may follow each other.
        goes_on = lasted or doubt['agreeing'] > limits['run']
        return Reason.DROPOUT_GOES_ON if goes_on else Reason.DROPOUT
    same_side = innovation * offset > 0.0
    held_jump = limits['threshold'] * doubt['typical_innovation']
    near = size <= held_jump * (held + 1.0) ** EXTRAPOLATION_POWER
    # Beyond the prediction, on its other side, it is back as well: the prediction was off.
    away = same_side and size > 0.5 * threshold and size > RETURN * abs(offset)
    change = abs(sample - doubt['last_sample'])
    # A sample that lies by those held back belongs to them, wherever the prediction has gone.
    nearer = size < change or offset == 0.0
    if near and nearer and not away and not beyond:
        return Reason.RETURNED if _holds_any(doubt) else Reason.EXPECTED
    last_accepted = state['last_accepted']
    if _turns_back(doubt, workspace, sample, last_accepted):
        return Reason.STAYED
    # Outliers are large: a smaller one that the next sample confirms was the start of a motion.
    small = same_side and abs(offset) <= limits['acceleration_limit']
    if small and change < limits['growth_limit']:
        return Reason.CONFIRMED
    stays = change <= AGREEMENT * abs(offset) and not _is_slower(sample, last_accepted)
    hit = STAYING_HIT if stays else CONFIRMED_HIT
    if circumstances['explained_jump'] > hit * size:
        return Reason.PUSHED
    # The first sample of a burst of outliers jumps further than a hit turns a body in a sample.
    jolt_limit = _jolt_limit(circumstances, limits)
    burst = doubt['first_size'] >= jolt_limit or size >= jolt_limit * (held + 1.0)
    if circumstances['jolted'] and not burst:
        return Reason.JOLTED
    # Outliers do not go away further and further, as a body does that gains speed.
    if doubt['growing'] > 0 and _grows(doubt, innovation, change, limits):
        return Reason.GROWN_AGAIN
    grows = same_side and size > GROWTH * abs(offset)
    starts = abs(offset) < GROWTH_START * held_jump * (held * 1.0) ** EXTRAPOLATION_POWER
    alone = doubt['agreeing'] <= 1  # a burst that lasts does not grow
    if grows and starts and alone and change < limits['growth_limit']:
        return Reason.GROWN
    if _goes_on(doubt, circumstances, limits, sample, last_accepted):
        return Reason.GONE_ON
    alike = change <= _agreement(offset, held_jump, limits)
    run = limits['run'] + (BODY_LIMIT_SAMPLES if abs(offset) > limits['body_limit'] else 0)
    if alike and doubt['agreeing'] >= run:
        return Reason.AGREED
    if lasted:
        return Reason.HELD_LONGEST
    return Reason.UNDECIDED if _holds_any(doubt) else Reason.BEYOND_REACH


@kernel
def _holds_any(doubt: Doubt) -> bool:
    """Return whether a sample was held back since the last accepted one, not only missing."""
    return doubt['held'] > doubt['unmeasured']


@kernel
def _is_within_reach(
    state: 'AdaptiveAxis',
    workspace: 'AdaptiveAxisWorkspace',
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
    state: 'AdaptiveAxis',
    workspace: 'AdaptiveAxisWorkspace',
    limits: OutlierLimits,
    sample: float,
    possible: int,
) -> bool:
    """Return whether a sample (rad/s) is one that is predicted if up to `possible` are missing.

    The error of a prediction grows with the samples that it goes ahead, by no more than a body does
    in one of them.
    """
    prediction, steps = workspace['prediction'], state['doubt']['held'] + 1.0
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
    doubt: Doubt, workspace: 'AdaptiveAxisWorkspace', sample: float, last_accepted: float
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
    if doubt['held'] == 1:
        explained = circumstances['shake'] > CONFIRMED_HIT * limits['shake_per_jump'] * largest
        if circumstances['still'] or not explained or not _is_slower(sample, last_accepted):
            return False
    else:
        begun = (sample - step - before - last_accepted) / (doubt['held'] - 1.0)
        if begun * step < 0.0:
            return False
        largest = max(largest, abs(begun))
    least = max(STEADY * largest, LARGEST_RATE_CHANGE * doubt['usual_rate_change'])
    return min(abs(step), abs(before)) >= least


@kernel
def lies_at_accepted(doubt: Doubt, sample: float, last_accepted: float) -> bool:
    """Return whether a sample lies where the last accepted one did, both in rad/s.

    That shows that the one held back before it was an outlier.
    """
    return bool(abs(sample - last_accepted) < RETURN * abs(doubt['last_sample'] - last_accepted))


@kernel
def note_confirmation(doubt: Doubt, reason: int) -> None:
    """Note whether a sample confirms the one that the filter starts at, or takes its place."""
    if reason == Reason.UNCONFIRMED:
        doubt['confirmations'] = 1
    elif decision_of(reason) == Decision.ACCEPT:
        doubt['confirmations'] = min(doubt['confirmations'] + 1, CONFIRMED_START)


@kernel
def note_held(
    doubt: Doubt,
    sample: float,
    innovation: float,
    typical_innovation: float,
    dropout: bool,
    limits: OutlierLimits,
) -> None:
    """Note a sample that is held back; it and its innovations are in rad/s."""
    change = abs(sample - doubt['last_sample'])
    follows = not dropout and (doubt['held'] == 0 or doubt['offset'] != 0.0)
    doubt['step'] = sample - doubt['last_sample'] if follows else 0.0
    if doubt['held'] == 0:
        # What was known before the first of them: it grows while nothing is accepted.
        doubt['typical_innovation'] = typical_innovation
        doubt['first_size'] = 0.0 if dropout else abs(innovation)
        doubt['agreeing'] = doubt['growing'] = 0
    else:
        if not _continues(doubt, change, dropout, limits):
            doubt['agreeing'] = 0
        further = _grows(doubt, innovation, change, limits)
        doubt['growing'] = doubt['growing'] + 1 if further else 0
    doubt['held'] += 1
    doubt['unmeasured'] = 0
    doubt['agreeing'] += 1
    doubt['offset'] = 0.0 if dropout else innovation


@kernel
def note_missing(doubt: Doubt, typical_innovation: float) -> None:
    """Note a sample that is missing: as much may have happened as in one that is held back."""
    if doubt['held'] == 0:
        doubt['typical_innovation'] = typical_innovation
        doubt['first_size'] = 0.0
    doubt['held'] += 1
    doubt['unmeasured'] += 1
    doubt['growing'] = doubt['agreeing'] = 0
    doubt['offset'] = doubt['step'] = 0.0


@kernel
def note_innovation(doubt: Doubt, innovation: float, is_held: bool) -> None:
    """Keep account of how large innovations are (rad/s), and of how many samples are held.

    What is usual is no jump, and a vibration must not be held for ever.
    """
    usual = doubt['usual_innovation']
    doubt['usual_innovation'] = usual_after(usual, abs(innovation), USUAL_LIMIT * usual)
    if is_held or doubt['share_held'] > LEAST_SHARE:
        doubt['share_held'] += SHARE_MEMORY * ((1.0 if is_held else 0.0) - doubt['share_held'])


@kernel
def note_rate_change(doubt: Doubt, change: float, limits: OutlierLimits) -> None:
    """Keep account of how much the rate changes from one sample to the next, in rad/s."""
    usual = doubt['usual_rate_change']
    largest = max(USUAL_LIMIT * usual, limits['acceleration_limit'])
    doubt['usual_rate_change'] = usual_after(usual, abs(change), largest)


@kernel
def unmeasured_variance(doubt: Doubt) -> float:
    """Return the variance in (rad/s)^2 of a rate since the last sample that was measured.

    The body may have gone on by the usual change with each one, up to the end of any range.
    """
    change = min(doubt['unmeasured'] * doubt['usual_rate_change'], RANGE)
    return float(change * change)


@kernel
def _grows(doubt: Doubt, innovation: float, change: float, limits: OutlierLimits) -> bool:
    """Return whether a sample lies further away than the one held before it, as a body can do."""
    further = innovation * doubt['offset'] > 0.0 and abs(innovation) > abs(doubt['offset'])
    disagrees = change > AGREEMENT * abs(doubt['offset'])
    return bool(further and disagrees and change < limits['growth_limit'])


@kernel
def _continues(doubt: Doubt, change: float, dropout: bool, limits: OutlierLimits) -> bool:
    """Return whether a sample belongs to the same run as the one held before it."""
    after_dropout = doubt['offset'] == 0.0
    if dropout or after_dropout:
        return bool(dropout and after_dropout)
    return change <= _agreement(
        doubt['offset'], limits['threshold'] * doubt['typical_innovation'], limits
    )


@kernel
def _agreement(offset: float, jump: float, limits: OutlierLimits) -> float:
    """Return the difference in rad/s up to which two held samples agree."""
    agreement: float = max(min(AGREEMENT * abs(offset), limits['agreement_limit']), jump)
    return agreement


@kernel
def note_repeat(doubt: Doubt, sample: float, variance: float) -> bool:
    """Count how often the same value has come; return whether so often that it must be the rate.

    Arguments: sample in rad/s, variance of the noise in (rad/s)^2.
    """
    if abs(sample - doubt['last_sample']) > CONSTANT_DEVIATIONS * math.sqrt(variance):
        doubt['repeats'] = 0
        return False
    doubt['repeats'] += 1
    if doubt['repeats'] < CONSTANT_SAMPLES:
        return False
    doubt['repeats'] = 0
    return True
