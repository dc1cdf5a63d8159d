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

"""One stamp after the other: steps, stretches and blocks of the envelope."""

import math

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core.clock.delays import (
    BURSTS,
    LONG_STEP,
    REGULAR,
    forget_delays,
    learn_delays,
    learn_regularity,
    limit_delays,
    long_step,
)
from gyro_drift_filter.core.clock.losses import (
    correct_count,
    drop_suspicion,
    judge_suspicion,
    note_long_step,
    suspect,
)
from gyro_drift_filter.core.clock.periodogram import (
    ClockWorkspace,
    keep_stamp,
    period_of_stamps,
)
from gyro_drift_filter.core.clock.periods import (
    BLOCK_SAMPLES,
    LEAST_STAMPED_SHARE,
    LONGEST_PERIOD,
    OTHER_PERIOD,
    SAME_PERIOD,
    STALLED_SECONDS,
    given_or_learned,
    learn_period,
    period_of,
    set_mean_period,
    take_period,
)
from gyro_drift_filter.core.clock.records import BLOCKS, Clock
from gyro_drift_filter.core.clock.runs import note_long_run, note_short_run, note_time_owed

PERIOD_BLOCK_SECONDS = 2.0
# A stretch ends after so many samples, or after that time where it has enough of them: long enough
# for one stamp to come with next to no delay, and short enough for the period to be known by then.
STRETCH_SAMPLES = 100
STRETCH_SECONDS = 0.5
LEAST_STRETCH_SAMPLES = 20
# The first sample has a delay of its own: after a stretch that long the envelope starts anew.
ANCHOR_SAMPLES = 16
# The bias walks no further than in this time, whatever the stamps say, in s.
LONGEST_ABSENCE = 86_400.0


@kernel
def start_clock(clock: Clock, sample_rate: float) -> None:
    """Set a zeroed clock up; `sample_rate` in Hz, 0 where it is to be learned."""
    clock['period'] = period_of(sample_rate)
    set_mean_period(clock, clock['period'])
    forget_delays(clock)


@kernel
def give_rate(clock: Clock, sample_rate: float) -> None:
    """Take another rate in Hz between two samples; a period that stamps have told stands."""
    if sample_rate <= 0.0:
        return
    if clock['blocks'] > 0:
        clock['period'] = given_or_learned(clock['mean_period'], sample_rate)
        return
    start_clock(clock, sample_rate)
    _start_envelope(clock)


@kernel
def lengthen_period(clock: Clock, times: float, sample_rate: float) -> None:
    """Start anew, at the last stamp, with samples that are so many times as far apart."""
    if sample_rate > 0.0 and not clock['started']:
        return  # nothing but this rate says how far they are
    take_period(clock, min(times * clock['mean_period'], LONGEST_PERIOD), sample_rate)
    clock['blocks'] = 0
    forget_delays(clock)
    _start_envelope(clock)


@kernel
def note_elapsed(clock: Clock, stamp: int) -> float:
    """Note how far a stamp (ns) is from the last sample; return that in s.

    It is a period where no stamp says, or where stamps stand.
    """
    period = float(clock['period'])
    if stamp == 0 or not clock['started']:
        return period
    stamped = float(min(max((stamp - clock['stamp']) * 1e-9, 0.0), LONGEST_ABSENCE))
    return max(stamped, period) if _note_standing(clock, stamped) else stamped


@kernel
def _note_standing(clock: Clock, stamped: float) -> bool:
    """Note that a stamp is `stamped` s behind the last; return whether stamps tell no time."""
    standing = LEAST_STAMPED_SHARE * STALLED_SECONDS
    unstamped = clock['unstamped'] + LEAST_STAMPED_SHARE * clock['period'] - stamped
    clock['unstamped'] = min(max(unstamped, 0.0), standing)
    return bool(clock['unstamped'] >= standing)


@inlined_kernel
def advance_clock(
    clock: Clock, stamp: int, sample_rate: float, gap_limit: float, workspace: ClockWorkspace
) -> tuple[int, bool]:
    """Move the clock to `stamp` (ns).

    Returns:
        The number of samples missing before it, and whether the time has jumped by more than
        `gap_limit` (s) in either direction instead: then nobody knows how many.
    """
    if stamp == 0:
        clock['zero_stamps'] += 1
        return 0, False
    if not clock['started']:
        clock['started'] = True
        clock['stamp'] = stamp
        _start_envelope(clock)
        return 0, False
    elapsed = (stamp - clock['stamp']) * 1e-9
    clock['stamp'] = stamp
    if elapsed == 0.0:
        clock['same_stamps'] += 1
    elif elapsed < 0.0:
        clock['backward_stamps'] += 1
    note_time_owed(clock, elapsed)
    if elapsed > gap_limit:
        clock['gaps'] += 1
    if abs(elapsed) > gap_limit:
        clock['restarts'] += 1
        _start_envelope(clock)
        return 0, True
    # A stamp before its time: the clock was set back. If not, the stamp before it was just late.
    if elapsed < 0.0 and clock['lateness'] + elapsed - clock['mean_period'] < clock['earliest']:
        _start_envelope(clock)
        return 0, False
    missing = _follow_envelope(clock, elapsed)
    other_period = note_long_run(clock, elapsed, missing)
    if other_period == 0.0:
        other_period = note_short_run(clock, elapsed)
    if other_period > 0.0:
        _correct_period(clock, other_period, sample_rate)
        return 0, False
    keep_stamp(clock, stamp)
    samples = clock['stretch_samples']
    if samples >= clock['stretch_length'] and (
        samples >= STRETCH_SAMPLES or stamp >= clock['stretch_end']
    ):
        _end_stretch(clock, sample_rate, workspace)
    return missing, False


@kernel
def _start_envelope(clock: Clock) -> None:
    """Start block and stretch at the last stamp."""
    clock['lateness'] = clock['earliest'] = 0.0
    clock['anchored'] = False
    clock['steps'] = clock['missing'] = 0
    clock['gap_steps'] = 0.0
    clock['long_steps'] = 0
    drop_suspicion(clock)
    clock['long_run'] = clock['short_run'] = 0
    clock['kept'] = 0
    clock['stretch_samples'] = 0
    _start_stretch(clock)


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
    clock['stretch_least_lateness'] = math.inf
    clock['stretch_longest_delay'] = clock['stretch_delay_sum'] = 0.0


@kernel
def _follow_envelope(clock: Clock, elapsed: float) -> int:
    """Take a stamp in that is `elapsed` s behind the last one; return the samples missing."""
    period = clock['mean_period']
    lateness = clock['lateness'] + elapsed - period
    delay = lateness - clock['earliest']
    clock['steps'] += 1
    note_long_step(clock, elapsed)
    missing = 0
    is_long = elapsed > LONG_STEP * period and elapsed > long_step(clock) * period
    if is_long:
        clock['long_steps'] += 1
    if delay <= clock['suspicious']:
        clock['stretch_delay_sum'] += delay
        clock['stretch_longest_delay'] = max(clock['stretch_longest_delay'], delay)
    elif is_long and clock['irregularity'] < BURSTS:
        missing = suspect(clock, elapsed, delay)
        lateness -= missing * period
    learn_regularity(clock, elapsed * clock['mean_rate'] - 1.0 - missing)
    if clock['verdict_samples'] > 0:
        lateness -= judge_suspicion(clock, lateness - clock['earliest']) * period
    clock['lateness'] = lateness
    clock['earliest'] = min(clock['earliest'], lateness)
    clock['stretch_samples'] += 1
    if lateness < clock['stretch_least_lateness']:
        clock['stretch_least_lateness'] = lateness
        clock['least_steps'], clock['least_missing'] = clock['steps'], clock['missing']
        clock['least_gap_steps'] = clock['gap_steps']
    return missing


@kernel
def _end_stretch(clock: Clock, sample_rate: float, workspace: ClockWorkspace) -> None:
    """Learn from the stretch what there is to learn, and start the next one."""
    starting, period = clock['blocks'] == 0, clock['mean_period']
    regular, samples = clock['irregularity'] < REGULAR, clock['stretch_samples']
    # Who is found regular so early has next to no jitter, and the period is known.
    if clock['anchored'] or (regular and samples == ANCHOR_SAMPLES):
        learn_delays(clock)
    full = (
        clock['steps'] * period + clock['lateness'] >= PERIOD_BLOCK_SECONDS
        and clock['steps'] - clock['missing'] >= BLOCK_SAMPLES
    )
    found = 0.0
    if full and clock['irregularity'] < BURSTS:
        found = period_of_stamps(clock, workspace)
    if found > 0.0 and abs(found / period - 1.0) >= SAME_PERIOD:
        _correct_period(clock, found, sample_rate)
        return
    if full or starting:
        learn_period(clock, sample_rate, full, found)
    change = clock['mean_period'] - period
    clock['lateness'] -= change * clock['steps']
    clock['stretch_least_lateness'] -= change * clock['least_steps']
    if found > 0.0 and clock['anchored']:
        correct_count(clock)
    if full or (regular and not clock['anchored'] and samples >= ANCHOR_SAMPLES):
        # The block starts at the point of the envelope that ends the last one.
        clock['anchored'] = True
        clock['lateness'] -= clock['stretch_least_lateness']
        clock['stretch_least_lateness'] = 0.0
        clock['steps'] -= clock['least_steps']
        clock['missing'] -= clock['least_missing']
        clock['gap_steps'] -= clock['least_gap_steps']
        clock['long_steps'] = 0
    clock['earliest'] = clock['stretch_least_lateness']
    if abs(change) > OTHER_PERIOD * period:
        forget_delays(clock)
        drop_suspicion(clock)
        if not starting:
            _start_envelope(clock)
            return
    _start_stretch(clock)


@kernel
def _correct_period(clock: Clock, period: float, sample_rate: float) -> None:
    """Take the period (s) in place of what was learned, and start anew at the last stamp."""
    for i in range(BLOCKS):
        clock['block_periods'][i] = period
    clock['blocks'] += 1
    take_period(clock, period, sample_rate)
    if clock['suspicious'] < math.inf:
        limit_delays(clock)
    _start_envelope(clock)
