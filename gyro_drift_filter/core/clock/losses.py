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

"""Suspicions that samples are missing, and the verdicts on them."""

import numpy as np

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core.clock.delays import REGULAR
from gyro_drift_filter.core.clock.records import Clock

# Late by so little, in periods, a sample shows that none is missing before it.
MADE_UP = 0.6
# Samples until the verdict, and as many more for each period of delay: what was only held up comes
# in at once, or at twice the pace at least.
VERDICT_SAMPLES = 16
VERDICT_PACE = 2.0
# Samples after a gap by which one that was made up for would show: at twice the pace they are early
# by two periods. So losses that come often do not put the verdict off for ever.
SETTLED_SAMPLES = 4
SHARE_WEIGHT = 0.125  # of a verdict in the share of suspicions that were right
# Steps are equally long up to this share.
EQUALLY_LONG = 0.25
# In periods: behind a longer step samples may be missing. The jitter of a timer stays below 0.3 at
# either end of a step, and one over a missing sample lasts two periods less that.
LATE_STEP = 1.4
# A delay lasts until the envelope has followed, so only one that is being made up for may stand for
# more than so many that are missing. A step that is longer by as many is rare enough to be one over
# a gap, however long delays were.
MOST_BY_DELAY = 5
# A driver that reads a buffer when it is full has equally long steps between its bursts. One whose
# delays are long now and then has not. The weight is that of a step in the mean.
BURST_WEIGHT = 1.0 / 16.0


@kernel
def note_long_step(clock: Clock, elapsed: float) -> None:
    """Note a step in s, if it is one over which samples may be missing."""
    if elapsed <= LATE_STEP * clock['mean_period']:
        return
    if clock['burst_step'] == 0.0:
        clock['burst_step'], clock['burst_deviation'] = elapsed, 1.0
    mean = clock['burst_step']
    deviation = min(max(elapsed / mean - 1.0, -1.0), 1.0)
    clock['burst_step'] += BURST_WEIGHT * deviation * mean
    clock['burst_deviation'] += BURST_WEIGHT * (abs(deviation) - clock['burst_deviation'])


@kernel
def _is_between_bursts(clock: Clock, elapsed: float) -> bool:
    """Return whether a step (s) is one of those between bursts, which are as long each time."""
    if clock['burst_deviation'] > EQUALLY_LONG:
        return False
    return bool(abs(elapsed - clock['burst_step']) <= EQUALLY_LONG * clock['burst_step'])


@inlined_kernel
def possibly_missing(clock: Clock, elapsed: float, period: float) -> int:
    """Return how many samples may be missing before one for which `advance_clock` found none.

    Delays may hide a loss until later stamps show it. So each period (s) may stand for one

    - of a step, `elapsed` s, that is longer than delays explain, or that comes where there were
      losses before; also in the first block, which has no delays yet;
    - of a step that is not one of those between bursts, where stamps are so irregular that losses
      do not show: there one may be missing before any sample;
    - of the delay, from `MADE_UP` periods on, where there were losses before;
    - of a gap, all samples of which were counted as missing when it was found, if the first of
      them have come in since. They were held up, and the others may have been lost meanwhile. So
      may those behind a delay that was just taken for a loss, as most were of late.
    """
    starting, possible = clock['blocks'] == 0, _missing_anywhere(clock)
    loses = clock['missing_samples'] > 0 or clock['overtaken'] > 0
    if possible > 0:
        counts = not _is_between_bursts(clock, elapsed)
    else:
        counts = loses or elapsed - period > min(clock['longest_delay'], MOST_BY_DELAY * period)
    if elapsed > LATE_STEP * period and (counts or starting):
        possible = max(int(elapsed / period - LATE_STEP) + 1, possible)
    if loses and not starting:
        delay = clock['lateness'] - clock['earliest']
        by_delay = int(delay / period + 1.0 - MADE_UP)
        # What was held up comes in at once, and what held it up may have lost what follows.
        if elapsed > MADE_UP * period:
            by_delay = min(by_delay, MOST_BY_DELAY)
        possible = max(by_delay, possible)
    if clock['suspect_missing'] > 0 and (_has_taken_back(clock) or _may_be_mistaken(clock)):
        possible = max(clock['suspect_missing'], possible)
    return possible


@kernel
def possibly_in_gap(clock: Clock, possible: int) -> int:
    """Return how many samples may be missing in a gap right before the last stamp.

    `possible` is what `possibly_missing` says of it; what may be missing before any does not count.
    """
    return max(possible - _missing_anywhere(clock), 0)


@kernel
def may_follow_gap(clock: Clock, possible: int) -> bool:
    """Return whether samples may be missing right before the last stamp, as some have been earlier.

    `possible` is as for `possibly_in_gap`.
    """
    return bool(clock['missing_samples'] > 0 and possibly_in_gap(clock, possible) > 0)


@kernel
def _missing_anywhere(clock: Clock) -> int:
    """Return how many samples may be missing before any stamp, whatever it is."""
    return 1 if clock['irregularity'] >= REGULAR else 0


@kernel
def _has_taken_back(clock: Clock) -> bool:
    """Return whether some of the samples that were counted as missing have come in since."""
    period = clock['mean_period']
    not_missing = clock['suspect_delay'] - clock['suspect_missing'] * period
    return bool(not_missing > clock['mean_delay'] + 0.5 * period)


@kernel
def _may_be_mistaken(clock: Clock) -> bool:
    """Return whether the samples that were just counted as missing may only be late."""
    delays_explain = clock['suspect_delay'] <= clock['delay_limit']
    return bool(delays_explain and clock['suspect_samples'] < SETTLED_SAMPLES)


@kernel
def suspect(clock: Clock, elapsed: float, delay: float) -> int:
    """Start a suspicion that samples are missing; return how many if it is taken for sure."""
    period, missing = clock['mean_period'], 0
    if clock['irregularity'] < REGULAR:
        sure = delay > clock['delay_limit'] or clock['lost_share'] > 0.5
    else:
        sure = delay > clock['delay_limit'] and clock['longest_delay'] > period
    if sure:
        if clock['suspect_missing'] > 0 and clock['suspect_samples'] >= SETTLED_SAMPLES:
            _conclude(clock, True)
        missing = max(int(np.rint((delay - clock['mean_delay']) / period)), 1)
        _count_missing(clock, missing, elapsed - period)
    elif clock['verdict_samples'] > 0 and elapsed - period < clock['suspect_step']:
        return 0
    clock['suspect_delay'] = delay + clock['suspect_missing'] * period
    clock['suspect_step'] = elapsed - period
    clock['suspect_least'] = delay
    clock['suspect_samples'] = 0
    if missing > 0:
        clock['suspect_missing'] += missing
        clock['suspect_gaps'] += 1
    longest = max(clock['suspect_delay'], clock['longest_delay'])
    clock['verdict_samples'] = VERDICT_SAMPLES + int(VERDICT_PACE * longest / period)
    return missing


@kernel
def judge_suspicion(clock: Clock, delay: float) -> int:
    """Judge the suspicion by the sample's delay (s); return how many more samples were missing.

    The number is below zero where some that were counted were not.
    """
    period, counted = clock['mean_period'], clock['suspect_missing']
    clock['verdict_samples'] -= 1
    clock['suspect_samples'] += 1
    if counted > 0:
        if delay < (MADE_UP - 1.0) * period:
            return -_take_back(clock, -delay)
        if clock['verdict_samples'] == 0:
            _conclude(clock, True)
        return 0
    clock['suspect_least'] = min(clock['suspect_least'], delay)
    if clock['suspect_least'] < MADE_UP * period:
        clock['stretch_longest_delay'] = max(clock['stretch_longest_delay'], clock['suspect_delay'])
        _conclude(clock, False)
    elif clock['verdict_samples'] == 0:
        _conclude(clock, True)
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
    clock['stretch_longest_delay'] = max(clock['stretch_longest_delay'], made_up)
    _learn_verdict(clock, False)
    if clock['suspect_missing'] == 0:
        clock['gaps'] -= clock['suspect_gaps']
        drop_suspicion(clock)
    return found


@kernel
def _count_missing(clock: Clock, missing: int, step: float) -> None:
    """Count missing samples, over which the step was by `step` s longer than the period."""
    clock['steps'] += missing
    clock['missing'] += missing
    clock['gap_steps'] += step
    clock['missing_samples'] += missing
    clock['gaps'] += 1


@kernel
def correct_count(clock: Clock) -> None:
    """Correct the count of samples that are missing in a block whose period is known.

    By so many periods its least late stamp is late, counted from the one before the block: more
    were missing than were found, or fewer if it is early.
    """
    more = int(np.rint(clock['stretch_least_lateness'] / clock['mean_period']))
    clock['missing_samples'] = max(clock['missing_samples'] + more, 0)
    if more > 0:
        clock['gaps'] += more  # one in each, most likely
        _conclude(clock, True)


@kernel
def _learn_verdict(clock: Clock, was_lost: bool) -> None:
    clock['lost_share'] += SHARE_WEIGHT * (was_lost - clock['lost_share'])


@kernel
def _conclude(clock: Clock, was_lost: bool) -> None:
    """End the suspicion by the verdict on it."""
    _learn_verdict(clock, was_lost)
    drop_suspicion(clock)


@kernel
def drop_suspicion(clock: Clock) -> None:
    """Suspect nothing any more."""
    clock['verdict_samples'] = clock['suspect_missing'] = clock['suspect_gaps'] = 0
