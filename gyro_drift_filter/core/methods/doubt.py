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

"""What is remembered of doubtful samples: those that are held back, and what is usual.

`outliers.py` decides by it what a sample was.
"""

import math
from typing import TypedDict

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.methods.jolts import LEAST_USUAL, USUAL_LIMIT, usual_after
from gyro_drift_filter.core.methods.noise import LARGEST_NOISE
from gyro_drift_filter.core.methods.outlier_limits import OutlierLimits
from gyro_drift_filter.core.methods.reasons import Decision, Reason, decision_of
from gyro_drift_filter.core.sensor_checks import RANGE

RETURN = 0.5  # back by half the jump: the jump was an outlier
AGREEMENT = 0.25  # of the jump: held samples that differ by more are no motion
CONSTANT_DEVIATIONS = 0.01  # standard deviations of the noise: repeats closer than this ...
CONSTANT_SAMPLES = 14  # ... so many times are a constant, whatever was learned before
CONFIRMED_START = 2  # samples that agree: until then the first one is as doubtful as the next
SHARE_MEMORY = 0.025  # the weight of a sample in the share of those that are held
LEAST_SHARE = 1e-9  # as processors are slow with denormal numbers


class Doubt(TypedDict):
    """The samples of one axis that are held back, the last one, and what is usual."""

    unaccepted: int  # consecutive samples that were held back, missing or not measured
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
    equal: int  # samples in a row before it that were as good as equal to it
    share_held: float  # of the last samples, not counting drop-outs


@kernel
def start_doubt(doubt: Doubt, sample: float) -> None:
    """Start at a sample (rad/s)."""
    doubt['unaccepted'] = doubt['unmeasured'] = doubt['confirmations'] = 0
    doubt['behind_gap'] = False
    doubt['before_restart'] = sample
    doubt['usual_innovation'] = LARGEST_NOISE
    doubt['usual_rate_change'] = LEAST_USUAL
    doubt['equal'] = 0
    doubt['share_held'] = 0.0
    doubt['last_sample'] = sample


@kernel
def holds_any(doubt: Doubt) -> bool:
    """Return whether a sample was held back since the last accepted one, not only missing."""
    return doubt['unaccepted'] > doubt['unmeasured']


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
    follows = not dropout and (doubt['unaccepted'] == 0 or doubt['offset'] != 0.0)
    doubt['step'] = sample - doubt['last_sample'] if follows else 0.0
    if doubt['unaccepted'] == 0:
        # What was known before the first of them: it grows while nothing is accepted.
        doubt['typical_innovation'] = typical_innovation
        doubt['first_size'] = 0.0 if dropout else abs(innovation)
        doubt['agreeing'] = doubt['growing'] = 0
    else:
        if not _continues(doubt, change, dropout, limits):
            doubt['agreeing'] = 0
        further = goes_further(doubt, innovation, change, limits)
        doubt['growing'] = doubt['growing'] + 1 if further else 0
    doubt['unaccepted'] += 1
    doubt['unmeasured'] = 0
    doubt['agreeing'] += 1
    doubt['offset'] = 0.0 if dropout else innovation


@kernel
def note_missing(doubt: Doubt, typical_innovation: float) -> None:
    """Note a sample that is missing: as much may have happened as in one that is held back."""
    if doubt['unaccepted'] == 0:
        doubt['typical_innovation'] = typical_innovation
        doubt['first_size'] = 0.0
    doubt['unaccepted'] += 1
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
def note_repeat(doubt: Doubt, sample: float, variance: float) -> bool:
    """Count how often the same value has come; return whether so often that it must be the rate.

    Arguments: sample in rad/s, variance of the noise in (rad/s)^2.
    """
    if abs(sample - doubt['last_sample']) > CONSTANT_DEVIATIONS * math.sqrt(variance):
        doubt['equal'] = 0
        return False
    doubt['equal'] += 1
    if doubt['equal'] < CONSTANT_SAMPLES:
        return False
    doubt['equal'] = 0
    return True


@kernel
def unmeasured_variance(doubt: Doubt) -> float:
    """Return the variance in (rad/s)^2 of a rate since the last sample that was measured.

    The body may have gone on by the usual change with each one, up to the end of any range.
    """
    change = min(doubt['unmeasured'] * doubt['usual_rate_change'], RANGE)
    return float(change * change)


@kernel
def goes_further(doubt: Doubt, innovation: float, change: float, limits: OutlierLimits) -> bool:
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
    return change <= agreement(
        doubt['offset'], limits['threshold'] * doubt['typical_innovation'], limits
    )


@kernel
def agreement(offset: float, threshold: float, limits: OutlierLimits) -> float:
    """Return the difference in rad/s up to which two held samples agree: by noise, or by motion.

    `threshold` in rad/s is what noise does, `offset` in rad/s the jump of the first of the two.
    """
    return float(max(min(AGREEMENT * abs(offset), limits['agreement_limit']), threshold))
