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

"""Time: the sample period learned from the stamps, and how many samples a gap has swallowed.

A filter step stands for one sample period, whatever the stamps say: drivers stamp on arrival, late
by any delay, and deliver in bursts. Samples are taken at even steps, so what the stamps say of them
is their lower envelope: the line of even steps that no stamp lies below. What a stamp lies above it
is its delay.

- A stretch is a hundred stamps or half a second. Its least late stamp is a point of the envelope.
- The period is the slope of the envelope between two such points that are two seconds apart, over
  the last five of these blocks. The filter works with it as it was until it is off by 1 %, as its
  coefficients depend on it.
- A delay of a period is suspicious. If it is far beyond the delays of late, or most suspicions of
  late were right, samples are missing and are predicted through. If those after it come early by as
  much, none was missing, and the count is taken back.
- Any other suspicion waits. If all samples after it stay late by a period, some were missing; they
  are counted, but not predicted through, as the filter has followed the samples since.
- While stamps come in bursts a delay means nothing.

Where many samples are lost from the very start on, the period is learned longer by their share.
Even stamps show it: all steps with nothing missing between have the same length then. This length
is taken for the period if it makes at most half as many more samples missing as were found missing.
(A bus that is asked every 8 ms for samples of every 10 ms has steps of one length, too, but next to
nothing was found missing.) Where delays come near a period as well, losses and delays can't be told
apart.

Every effect of a stamp is counted:

==================  ==========================================================================
stamp               effect
==================  ==========================================================================
zero                one step; the clock is left alone (the driver does not stamp)
same, same rates    a repeat: no step, the result of the sample before once more
same, new rates     one step (a coarse clock)
backward            one step, and the clock goes on from there; beyond `gap_limit` a restart
forward             one step, after a prediction for each sample that is missing for sure; beyond
                    `gap_limit` a restart
==================  ==========================================================================

The envelope as a causal fit to delayed stamps: E. Olson, "A Passive Solution to the Sensor
Synchronization Problem", IROS 2010; L. Zhang, Z. Liu, C. H. Xia, "Clock Synchronization Algorithms
for Network Measurements", INFOCOM 2002.
"""

import math
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import inlined_kernel, kernel, record

BLOCKS = 5
BLOCK_SECONDS = 2.0
BLOCK_SAMPLES = 40

# A stretch ends after so many samples, or after that time where it has enough of them: long enough
# for one stamp to come with next to no delay, and short enough for the period to be known by then.
STRETCH_SAMPLES = 100
STRETCH_SECONDS = 0.5
LEAST_STRETCH_SAMPLES = 20
# The first sample has a delay of its own: after a stretch that long the envelope starts anew.
ANCHOR_SAMPLES = 16

# The period in use before anything is known, in s: for stamps that are all zero.
UNKNOWN_PERIOD = 0.01
SHORTEST_PERIOD, LONGEST_PERIOD = 1.0e-4, 1.0

# In periods. A missing sample makes all those after it late by one. Stamps that are off by up to
# 40 % of the period either way are late by up to 0.8: what is later may be a gap.
SUSPICIOUS = 0.95
# And such stamps are 1.2 periods apart at least where one is missing between them; those of a
# sensor that has become slower by less are no sign of it.
LONG_STEP = 1.05
# Late by so little, a sample shows that none is missing before it.
MADE_UP = 0.6
# Samples until the verdict, and as many more for each period of delay: what was only held up comes
# in at once, or at twice the pace at least.
VERDICT_SAMPLES = 16
VERDICT_PACE = 2.0
# Mean deviation of a step from the period, relative to it, up to which stamps count as regular.
# Jitter of a timer stays below 0.3. A driver has to show that it is regular: it starts at 1 with
# the weight of `PRIOR_STEPS` steps.
REGULAR = 0.4
# The same of samples that come two or more at a time is 0.8 and more: waiting means nothing then.
BURSTS = 0.7
PRIOR_STEPS = 20
MEMORY_STEPS = 100
LARGEST_DEVIATION = 2.0
LEAST_DEVIATION = 1e-9  # as processors are slow with denormal numbers

# Verdicts of late: where more were for missing samples, the next one is taken for it at once. At
# the start it is so.
FIRST_SHARE = 0.75
SHARE_WEIGHT = 0.125
# The steps over gaps are longer by as many periods as samples are missing. Those that only seem to
# be gaps, as the period in use is too short, are longer by as much as delays vary.
GAP_STEPS = 0.7

# The longest delay of late counts for so long, in s. It is no more than doubled, and grows by no
# more than a period beyond, in one stretch: a driver that hung once is not one that often does.
DELAY_MEMORY = 10.0
MEAN_DELAY_WEIGHT = 0.25
# In periods, the delays seen reach up to a little less than the longest one.
LIMIT_MARGIN = 0.05

# Steps between neighbours that vary by no more than this share of theirs leave no doubt where
# samples are missing. Their mean is the period if it is another one for sure, by so many deviations
# of it, and if the samples missing by it are at most so many times those that were found missing.
EVEN_STEPS, STEP_DEVIATIONS, MISSING_RATIO = 0.1, 3.0, 1.5

# In periods: behind a longer step samples may be missing, even if delays explain it so far; and no
# more than so many samples.
LATE_STEP, MOST_POSSIBLE = 1.4, 5

# A new period within these shares of the old one, or of the rate that was given, is the same.
SAME_PERIOD = 0.01
SAME_RATE = 0.1
# Beyond that the rate has changed, and delays are not what they were.
OTHER_PERIOD = 0.1

# The bias walks no further than in this time, whatever the stamps say, in s.
LONGEST_ABSENCE = 86_400.0

# In place of a number of missing samples: time has jumped.
TIME_JUMP = -1

BlockPeriods = Annotated[NDArray[np.float64], np.float64, (BLOCKS,)]


class Clock(TypedDict):
    """The sample period, and where in time the filter stands.

    The envelope is a line of even steps of `mean_period` that starts at the point where the block
    did. `lateness` is measured from it, and steps are counted from there, missing samples among
    them.
    """

    period: float  # s, that the filter works with: `mean_period` but for small changes
    mean_period: float  # s
    mean_rate: float  # Hz, of it
    stamp: int  # ns, of the last stamped sample
    started: bool
    irregularity: float  # mean |step - period| / period
    irregularity_steps: int  # that it is the mean of, up to a limit
    lateness: float  # s, of the last stamp
    earliest: float  # s, the least lateness of this stretch and the one before
    # the stretch
    stretch_samples: int
    stretch_length: int  # samples that it takes at least
    stretch_end: int  # ns, and until when, or STRETCH_SAMPLES
    least: float  # s, the least lateness
    least_steps: int  # where it was
    least_missing: int
    least_gap_steps: float
    longest: float  # s, of delays that are not suspicious or were made up for
    sum: float  # s, of delays that are not suspicious
    # the block
    anchored: bool  # whether it starts at a point of the envelope, not at any sample
    steps: int
    missing: int
    long_steps: int
    gap_steps: float  # s, by which the steps over gaps were longer than the period
    single_steps: int  # that were about a period long
    single_sum: float  # s, of them
    single_squares: float  # s^2
    block_periods: BlockPeriods  # s
    blocks: int
    # delays
    mean_delay: float  # s
    longest_delay: float  # s, of late
    suspicious: float  # s: beyond it samples may be missing
    delay_limit: float  # s: beyond it they are
    lost_share: float  # of late, of the suspicions that were right
    # the suspicion
    verdict_samples: int  # until the verdict, 0 where there is no suspicion
    suspect_delay: float  # s, with that of the missing samples
    suspect_step: float  # s, by which the step was longer than the period
    suspect_least: float  # s, the least delay since
    suspect_missing: int  # samples that were counted at once
    suspect_gaps: int
    # counts
    gaps: int
    missing_samples: int
    restarts: int
    zero_stamps: int
    same_stamps: int
    backward_stamps: int


CLOCK = record(Clock)


@kernel
def start_clock(clock: Clock, sample_rate: float) -> None:
    """Set a zeroed clock up; `sample_rate` in Hz, 0 where it is to be learned."""
    clock['period'] = _period_of(sample_rate)
    _set_mean_period(clock, clock['period'])
    _forget_delays(clock)


@kernel
def give_rate(clock: Clock, sample_rate: float) -> None:
    """Take another rate in Hz between two samples; a period that stamps have told stands."""
    if sample_rate <= 0.0:
        return
    if clock['blocks'] > 0:
        clock['period'] = _given_or_learned(clock['mean_period'], sample_rate)
        return
    clock['period'] = _period_of(sample_rate)
    _set_mean_period(clock, clock['period'])
    _forget_delays(clock)
    _start_envelope(clock)


@kernel
def _period_of(sample_rate: float) -> float:
    """Return the sample period in s of a rate in Hz, which is 0 where it is to be learned."""
    if sample_rate <= 0.0:
        return UNKNOWN_PERIOD
    return max(1.0 / max(sample_rate, 1.0 / LONGEST_PERIOD), SHORTEST_PERIOD)


@kernel
def _set_mean_period(clock: Clock, period: float) -> None:
    clock['mean_period'], clock['mean_rate'] = period, 1.0 / period


@kernel
def _given_or_learned(period: float, sample_rate: float) -> float:
    """Return the period in s of the rate that was given, if any, where a learned one is about it.

    Oscillators of sensors are off by some percent, and a rate that was given is to be kept to.
    """
    if sample_rate > 0.0 and abs(period * sample_rate - 1.0) < SAME_RATE:
        return 1.0 / sample_rate
    return period


@kernel
def lengthen_period(clock: Clock, times: float, sample_rate: float) -> None:
    """Start anew, at the last stamp, with samples that are so many times as far apart."""
    if sample_rate > 0.0 and not clock['started']:
        return  # nothing but this rate says how far they are
    period = min(times * clock['mean_period'], LONGEST_PERIOD)
    _set_mean_period(clock, period)
    clock['period'] = _given_or_learned(period, sample_rate)
    clock['blocks'] = 0
    _forget_delays(clock)
    _start_envelope(clock)


@kernel
def elapsed_seconds(clock: Clock, stamp: int) -> float:
    """Return the time in s from the last sample to a stamp (ns), as far as the stamps say."""
    if stamp == 0 or not clock['started']:
        return float(clock['period'])
    return float(min(max((stamp - clock['stamp']) * 1e-9, 0.0), LONGEST_ABSENCE))


@kernel
def possibly_missing(clock: Clock, elapsed: float, period: float) -> int:
    """Return how many samples may be missing before one for which `advance_clock` found none.

    There may be some where the step of `elapsed` s is long for the period in s, and where samples
    have been missing before: delays may hide a loss until later stamps show it.
    """
    if clock['missing_samples'] == 0 or elapsed <= LATE_STEP * period:
        return 0
    return min(int(elapsed / period - LATE_STEP) + 1, MOST_POSSIBLE)


@inlined_kernel
def advance_clock(clock: Clock, stamp: int, sample_rate: float, gap_limit: float) -> int:
    """Move the clock to `stamp` (ns) and return the number of samples missing before it.

    Returns `TIME_JUMP` where the time jumped by more than `gap_limit` (s) in either direction.
    """
    if stamp == 0:
        clock['zero_stamps'] += 1
        return 0
    if not clock['started']:
        clock['started'] = True
        clock['stamp'] = stamp
        _start_envelope(clock)
        return 0
    elapsed = (stamp - clock['stamp']) * 1e-9
    clock['stamp'] = stamp
    if elapsed == 0.0:
        clock['same_stamps'] += 1
    elif elapsed < 0.0:
        clock['backward_stamps'] += 1
    if elapsed > gap_limit:
        clock['gaps'] += 1
    if abs(elapsed) > gap_limit:
        clock['restarts'] += 1
        _start_envelope(clock)
        return TIME_JUMP
    # Backward, but not before its time: it is the one before that was late.
    if elapsed < 0.0 and clock['lateness'] + elapsed - clock['mean_period'] < clock['earliest']:
        _start_envelope(clock)
        return 0
    missing = _follow_envelope(clock, elapsed)
    samples = clock['stretch_samples']
    if samples >= clock['stretch_length'] and (
        samples >= STRETCH_SAMPLES or stamp >= clock['stretch_end']
    ):
        _end_stretch(clock, sample_rate)
    return missing


@kernel
def _start_envelope(clock: Clock) -> None:
    """Start block and stretch at the last stamp."""
    clock['lateness'] = clock['earliest'] = 0.0
    clock['anchored'] = False
    clock['steps'] = clock['missing'] = 0
    clock['gap_steps'] = 0.0
    _forget_steps(clock)
    _drop_suspicion(clock)
    clock['stretch_samples'] = 0
    _start_stretch(clock)


@kernel
def _forget_steps(clock: Clock) -> None:
    """Forget how long the steps of the block were."""
    clock['long_steps'] = clock['single_steps'] = 0
    clock['single_sum'] = clock['single_squares'] = 0.0


@kernel
def _start_stretch(clock: Clock) -> None:
    """Start a stretch; the first ones double in length."""
    before = clock['stretch_samples']
    if clock['blocks'] == 0 and before < LEAST_STRETCH_SAMPLES:
        clock['stretch_length'], clock['stretch_end'] = max(2 * before, 1), 0
    else:
        clock['stretch_length'] = LEAST_STRETCH_SAMPLES
        clock['stretch_end'] = clock['stamp'] + int(STRETCH_SECONDS * 1e9)
    clock['stretch_samples'] = 0
    clock['least'], clock['longest'], clock['sum'] = math.inf, 0.0, 0.0


@kernel
def _forget_delays(clock: Clock) -> None:
    """Suspect no delay until a stretch has shown what the period is."""
    clock['mean_delay'] = clock['longest_delay'] = 0.0
    clock['suspicious'] = clock['delay_limit'] = math.inf
    clock['lost_share'] = FIRST_SHARE
    clock['irregularity'], clock['irregularity_steps'] = 1.0, 0


@kernel
def _follow_envelope(clock: Clock, elapsed: float) -> int:
    """Take a stamp in that is `elapsed` s behind the last one; return the samples missing."""
    period = clock['mean_period']
    lateness = clock['lateness'] + elapsed - period
    delay = lateness - clock['earliest']
    clock['steps'] += 1
    missing = 0
    is_long = elapsed > LONG_STEP * period
    if is_long:
        clock['long_steps'] += 1
    if abs(elapsed - period) < 0.5 * period:  # one period is the nearest number of them
        clock['single_steps'] += 1
        clock['single_sum'] += elapsed
        clock['single_squares'] += elapsed * elapsed
    if delay <= clock['suspicious']:
        clock['sum'] += delay
        clock['longest'] = max(clock['longest'], delay)
    elif is_long and clock['irregularity'] < BURSTS:
        missing = _suspect(clock, elapsed, delay)
        lateness -= missing * period
    _learn_regularity(clock, elapsed * clock['mean_rate'] - 1.0 - missing)
    if clock['verdict_samples'] > 0:
        lateness -= _judge(clock, lateness - clock['earliest']) * period
    clock['lateness'] = lateness
    clock['earliest'] = min(clock['earliest'], lateness)
    clock['stretch_samples'] += 1
    if lateness < clock['least']:
        clock['least'] = lateness
        clock['least_steps'], clock['least_missing'] = clock['steps'], clock['missing']
        clock['least_gap_steps'] = clock['gap_steps']
    return missing


@kernel
def _learn_regularity(clock: Clock, deviation: float) -> None:
    weight = 1.0 / MEMORY_STEPS
    if clock['irregularity_steps'] < MEMORY_STEPS - PRIOR_STEPS:
        clock['irregularity_steps'] += 1
        weight = 1.0 / (PRIOR_STEPS + clock['irregularity_steps'])
    limited = min(max(abs(deviation), LEAST_DEVIATION), LARGEST_DEVIATION)
    clock['irregularity'] += weight * (limited - clock['irregularity'])


@kernel
def _suspect(clock: Clock, elapsed: float, delay: float) -> int:
    """Start a suspicion that samples are missing; return how many if it is taken for sure."""
    period, missing = clock['mean_period'], 0
    if clock['irregularity'] < REGULAR:
        sure = delay > clock['delay_limit'] or clock['lost_share'] > 0.5
    else:
        sure = delay > clock['delay_limit'] and clock['longest_delay'] > period
    if sure:
        missing = max(int(np.rint((delay - clock['mean_delay']) / period)), 1)
        _count_missing(clock, missing, elapsed - period)
    elif clock['verdict_samples'] > 0 and elapsed - period < clock['suspect_step']:
        return 0
    clock['suspect_delay'] = delay + clock['suspect_missing'] * period
    clock['suspect_step'] = elapsed - period
    clock['suspect_least'] = delay
    if missing > 0:
        clock['suspect_missing'] += missing
        clock['suspect_gaps'] += 1
    longest = max(clock['suspect_delay'], clock['longest_delay'])
    clock['verdict_samples'] = VERDICT_SAMPLES + int(VERDICT_PACE * longest / period)
    return missing


@kernel
def _drop_suspicion(clock: Clock) -> None:
    clock['verdict_samples'] = clock['suspect_missing'] = clock['suspect_gaps'] = 0


@kernel
def _count_missing(clock: Clock, missing: int, step: float) -> None:
    """Count missing samples, over which the step was by `step` s longer than the period."""
    clock['steps'] += missing
    clock['missing'] += missing
    clock['gap_steps'] += step
    clock['missing_samples'] += missing
    clock['gaps'] += 1


@kernel
def _judge(clock: Clock, delay: float) -> int:
    """Judge the suspicion by the sample's delay (s); return how many more samples were missing.

    The number is below zero where some that were counted were not.
    """
    period, counted = clock['mean_period'], clock['suspect_missing']
    clock['verdict_samples'] -= 1
    if counted > 0:
        if delay < (MADE_UP - 1.0) * period:
            return -_take_back(clock, -delay)
        if clock['verdict_samples'] == 0:
            _learn_verdict(clock, True)
            _drop_suspicion(clock)
        return 0
    clock['suspect_least'] = min(clock['suspect_least'], delay)
    if clock['suspect_least'] < MADE_UP * period:
        clock['longest'] = max(clock['longest'], clock['suspect_delay'])
        _learn_verdict(clock, False)
        _drop_suspicion(clock)
    elif clock['verdict_samples'] == 0:
        _learn_verdict(clock, True)
        _drop_suspicion(clock)
        missing = int(np.rint(clock['suspect_least'] / period))
        _count_missing(clock, missing, clock['suspect_step'])
        return missing
    return 0


@kernel
def _take_back(clock: Clock, early: float) -> int:
    """Return how many samples were not missing, as those after a gap come so early (s)."""
    period = clock['mean_period']
    found = min(max(int(np.rint(early / period)), 1), clock['suspect_missing'])
    clock['steps'] -= found
    clock['missing'] -= found
    clock['gap_steps'] -= found * period
    clock['missing_samples'] -= found
    clock['suspect_missing'] -= found
    made_up = clock['suspect_delay'] - clock['suspect_missing'] * period
    clock['longest'] = max(clock['longest'], made_up)
    _learn_verdict(clock, False)
    if clock['suspect_missing'] == 0:
        clock['gaps'] -= clock['suspect_gaps']
        _drop_suspicion(clock)
    return found


@kernel
def _learn_verdict(clock: Clock, missing: bool) -> None:
    clock['lost_share'] += SHARE_WEIGHT * (missing - clock['lost_share'])


@kernel
def _end_stretch(clock: Clock, sample_rate: float) -> None:
    """Learn from the stretch what there is to learn, and start the next one."""
    starting, period = clock['blocks'] == 0, clock['mean_period']
    regular, samples = clock['irregularity'] < REGULAR, clock['stretch_samples']
    # Who is found regular so early has next to no jitter, and the period is known.
    if clock['anchored'] or (regular and samples == ANCHOR_SAMPLES):
        _learn_delays(clock)
    full = (
        clock['steps'] * period + clock['lateness'] >= BLOCK_SECONDS
        and clock['steps'] - clock['missing'] >= BLOCK_SAMPLES
    )
    single = _single_step(clock)
    if single != period:
        _correct_period(clock, single, sample_rate)
        return
    if full or starting:
        _learn_period(clock, sample_rate, full)
    change = clock['mean_period'] - period
    clock['lateness'] -= change * clock['steps']
    clock['least'] -= change * clock['least_steps']
    if full or (regular and not clock['anchored'] and samples >= ANCHOR_SAMPLES):
        # The block starts at the point of the envelope that ends the last one.
        clock['anchored'] = True
        clock['lateness'] -= clock['least']
        clock['least'] = 0.0
        clock['steps'] -= clock['least_steps']
        clock['missing'] -= clock['least_missing']
        clock['gap_steps'] -= clock['least_gap_steps']
        _forget_steps(clock)
    clock['earliest'] = clock['least']
    if abs(change) > OTHER_PERIOD * period:
        _forget_delays(clock)
        _drop_suspicion(clock)
        if not starting:
            _start_envelope(clock)
            return
    _start_stretch(clock)


@kernel
def _learn_delays(clock: Clock) -> None:
    """Learn from the delays of the stretch how long they are, and how long one is a gap."""
    period, samples = clock['mean_period'], clock['stretch_samples']
    if clock['suspicious'] < math.inf:
        longest, mean = clock['longest'], clock['sum'] / samples
        if clock['blocks'] > 0:
            before = clock['longest_delay']
            remembered = before * max(1.0 - samples * period / DELAY_MEMORY, 0.0)
            longest = max(remembered, min(longest, 2.0 * before + period))
            before = clock['mean_delay']
            mean = before + MEAN_DELAY_WEIGHT * (min(mean, longest) - before)
        clock['longest_delay'], clock['mean_delay'] = longest, mean
    _limit_delays(clock)


@kernel
def _limit_delays(clock: Clock) -> None:
    """Say by what is known of the delays how long one is suspicious, and how long it is a gap."""
    period, longest, mean = clock['mean_period'], clock['longest_delay'], clock['mean_delay']
    # Jitter of a timer is even: it ends at twice its mean. What is beyond is a tail, of which one
    # may yet see twice as much; and delays of more than a period are those of a queue, which may
    # grow to twice its length.
    tail = longest if longest >= period else max(longest - 2.0 * mean, 0.0)
    clock['suspicious'] = SUSPICIOUS * period
    clock['delay_limit'] = max(longest + tail + LIMIT_MARGIN * period, clock['suspicious'])


@kernel
def _learn_period(clock: Clock, sample_rate: float, full: bool) -> None:
    """Take the period from the envelope of the block, which is full or the first one."""
    period, steps, missing = clock['mean_period'], clock['least_steps'], clock['least_missing']
    lateness, samples = clock['least'], clock['steps'] - clock['missing']
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
        return
    period = min(span / steps, LONGEST_PERIOD)
    if full:
        clock['block_periods'][clock['blocks'] % BLOCKS] = period
        clock['blocks'] += 1
        period = _typical(clock['block_periods'], min(clock['blocks'], BLOCKS))
    _set_mean_period(clock, period)
    if not full and sample_rate > 0.0:
        return
    used = _given_or_learned(period, sample_rate)
    if used != period or abs(period / clock['period'] - 1.0) >= SAME_PERIOD:
        clock['period'] = used


@kernel
def _single_step(clock: Clock) -> float:
    """Return the mean step from a sample to the next in s, where samples are missing.

    Returns the period where steps are not even, or where they and the period agree.
    """
    period, count, missing = clock['mean_period'], clock['single_steps'], clock['missing']
    samples = clock['steps'] - missing
    if missing == 0 or count < BLOCK_SAMPLES or 2 * count < samples:
        return float(period)
    single = clock['single_sum'] / count
    variance = max(clock['single_squares'] / count - single * single, 0.0)
    if variance > (EVEN_STEPS * single) ** 2:
        return float(period)
    doubt = SAME_PERIOD * period + STEP_DEVIATIONS * math.sqrt(variance / count)
    missing_by_it = (clock['steps'] * period + clock['lateness']) / single - samples
    if abs(single - period) < doubt or not 0.0 < missing_by_it < MISSING_RATIO * missing:
        return float(period)
    return float(single)


@kernel
def _correct_period(clock: Clock, period: float, sample_rate: float) -> None:
    """Take the period (s) in place of what was learned, and start anew at the last stamp."""
    for i in range(BLOCKS):
        clock['block_periods'][i] = period
    clock['blocks'] += 1
    _set_mean_period(clock, period)
    clock['period'] = _given_or_learned(period, sample_rate)
    if clock['suspicious'] < math.inf:
        _limit_delays(clock)
    _start_envelope(clock)


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
