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

"""The sample period: from the envelope of a block, where the stamps alone have not told it."""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.clock.delays import REGULAR
from gyro_drift_filter.core.clock.records import BLOCKS, BlockPeriods, Clock

BLOCK_SAMPLES = 40  # that a block has at least, or as many steps to tell the period by
# The period in use before anything is known, in s: for stamps that are all zero.
UNKNOWN_PERIOD = 0.01
SHORTEST_PERIOD, LONGEST_PERIOD = 1.0e-4, 1.0
# The steps over gaps are longer by as many periods as samples are missing. Those that only seem to
# be gaps, as the period in use is too short, are longer by as much as delays vary.
GAP_STEPS = 0.7
# A new period within these shares of the old one, or of the rate that was given, is the same.
SAME_PERIOD = 0.01
SAME_RATE = 0.1
# Of the time that samples take by their period: stamps that tell less of it, for so long (s), stand
# still, or are in another unit. No period is learned so wrong, and units differ by 1,000. Some
# drivers stamp in whole seconds, or deliver so late.
LEAST_STAMPED_SHARE, STALLED_SECONDS = 0.1, 5.0
# Beyond this share of the old period the rate has changed, and delays are not what they were.
OTHER_PERIOD = 0.1


@kernel
def period_of(sample_rate: float) -> float:
    """Return the sample period in s of a rate in Hz, which is 0 where it is to be learned."""
    if sample_rate <= 0.0:
        return UNKNOWN_PERIOD
    return max(1.0 / max(sample_rate, 1.0 / LONGEST_PERIOD), SHORTEST_PERIOD)


@kernel
def set_mean_period(clock: Clock, period: float) -> None:
    """Set the mean period in s, and the rate that follows."""
    clock['mean_period'], clock['mean_rate'] = period, 1.0 / period


@kernel
def given_or_learned(period: float, sample_rate: float) -> float:
    """Return the period in s of the rate that was given, if any, where a learned one is about it.

    Oscillators of sensors are off by some percent, and a rate that was given is to be kept to.
    """
    if sample_rate > 0.0 and abs(period * sample_rate - 1.0) < SAME_RATE:
        return 1.0 / sample_rate
    return period


@kernel
def take_period(clock: Clock, period: float, sample_rate: float) -> None:
    """Take a period in s for the mean, and from now on for the filter, unless a rate was given."""
    set_mean_period(clock, period)
    clock['period'] = given_or_learned(period, sample_rate)


@kernel
def learn_period(clock: Clock, sample_rate: float, full: bool, found: float) -> None:
    """Take the period from the block, which is full or the first one.

    It is `found`, in s, where the stamps agree with a period although samples are missing; else
    that is 0, and the envelope tells the period.
    """
    period = found if found > 0.0 else _period_of_envelope(clock)
    if period == 0.0:
        return
    if full:
        clock['block_periods'][clock['blocks'] % BLOCKS] = period
        clock['blocks'] += 1
        period = _typical(clock['block_periods'], min(clock['blocks'], BLOCKS))
    set_mean_period(clock, period)
    if not full and sample_rate > 0.0:
        return
    used = given_or_learned(period, sample_rate)
    if used != period or abs(period / clock['period'] - 1.0) >= SAME_PERIOD:
        clock['period'] = used


@kernel
def _period_of_envelope(clock: Clock) -> float:
    """Return the period in s by the envelope of the block, or 0 where it says none."""
    period, steps, missing = clock['mean_period'], clock['least_steps'], clock['least_missing']
    lateness, samples = clock['stretch_least_lateness'], clock['steps'] - clock['missing']
    # More missing than received, and not by one gap, or most steps long: these are no gaps, the
    # driver has changed its rate or delivers in long bursts.
    no_gaps = (
        (clock['missing'] >= samples and clock['long_steps'] > 1)
        or 2 * clock['long_steps'] > samples
        or clock['gap_steps'] < GAP_STEPS * clock['missing'] * period
    )
    if clock['blocks'] == 0 and (no_gaps or clock['irregularity'] >= REGULAR):
        # The first stretches are too short to hold the envelope of bursts.
        steps, missing, lateness = clock['steps'], clock['missing'], clock['lateness']
    span = steps * period + lateness
    if no_gaps:
        steps -= missing
    # Of samples that came all at once no stamp says how far they lie apart.
    if steps <= 0 or span < steps * SHORTEST_PERIOD:
        return 0.0
    return min(span / steps, LONGEST_PERIOD)


@kernel
def _typical(values: BlockPeriods, count: int) -> float:
    """Return the mean of those of the first `count` values that are about their median."""
    median = _median(values, count)
    total, about = 0.0, 0
    for i in range(count):
        if abs(values[i] - median) <= SAME_PERIOD * median:
            total += values[i]
            about += 1
    return total / about if about > 0 else median


@kernel
def _median(values: BlockPeriods, count: int) -> float:
    """Return the median of the first `count` values; numba's own takes two seconds to compile."""
    middle = (count - 1) // 2
    low = high = 0.0
    for i in range(count):
        less = 0
        for k in range(count):
            # Equal values count in their order.
            if values[k] < values[i] or (values[k] == values[i] and k < i):
                less += 1
        if less == middle:
            low = values[i]
        if less == count // 2:
            high = values[i]
    return 0.5 * (low + high)
