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

"""How late stamps come of late, and from where on a delay is a gap."""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.clock.records import Clock

# In periods. A missing sample makes all those after it late by one. Stamps that are off by up to
# 40 % of the period either way are late by up to 0.8: what is later may be a gap.
SUSPICIOUS = 0.95
# Where one is missing, such stamps are at least 1.2 periods apart. Shorter steps are no sign of it:
# the sensor may have become slower.
LONG_STEP = 1.05
# Where steps are even, one over a gap is nearer to two periods than to one, so that the small
# deviations of a driver that sleeps between two readings add up to no gap. The first of these is
# the mean deviation up to which that is asked for, the second the one from which on no more than
# `LONG_STEP` is.
EVEN, UNEVEN, EVEN_LONG_STEP = 0.1, 0.2, 1.5
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
# The share of suspicions that were right, before there is any verdict: as most were, a gap is taken
# for one at once.
FIRST_SHARE = 0.75
# The longest delay of late counts for so long, in s. It is no more than doubled, and grows by no
# more than a period beyond, in one stretch: a driver that hung once is not one that often does.
DELAY_MEMORY = 10.0
MEAN_DELAY_WEIGHT = 0.25
# In periods: the longest delay that was seen is a little below the longest possible.
LIMIT_MARGIN = 0.05


@kernel
def forget_delays(clock: Clock) -> None:
    """Suspect no delay until a stretch has shown what the period is."""
    clock['mean_delay'] = clock['longest_delay'] = 0.0
    clock['suspicious'] = clock['delay_limit'] = math.inf
    clock['lost_share'] = FIRST_SHARE
    clock['irregularity'], clock['irregularity_steps'] = 1.0, 0


@kernel
def learn_regularity(clock: Clock, deviation: float) -> None:
    """Learn from a step that is off by this share of the period how regular stamps are."""
    weight = 1.0 / MEMORY_STEPS
    if clock['irregularity_steps'] < MEMORY_STEPS - PRIOR_STEPS:
        clock['irregularity_steps'] += 1
        weight = 1.0 / (PRIOR_STEPS + clock['irregularity_steps'])
    limited = min(max(abs(deviation), LEAST_DEVIATION), LARGEST_DEVIATION)
    clock['irregularity'] += weight * (limited - clock['irregularity'])


@kernel
def long_step(clock: Clock) -> float:
    """Return beyond how many periods a step may be one over a gap, by how even steps are."""
    evenness = min(max((UNEVEN - clock['irregularity']) / (UNEVEN - EVEN), 0.0), 1.0)
    return LONG_STEP + evenness * (EVEN_LONG_STEP - LONG_STEP)


@kernel
def learn_delays(clock: Clock) -> None:
    """Learn from the delays of the stretch how long they are, and how long one is a gap."""
    period, samples = clock['mean_period'], clock['stretch_samples']
    if clock['suspicious'] < math.inf:
        longest, mean = clock['stretch_longest_delay'], clock['stretch_delay_sum'] / samples
        if clock['blocks'] > 0:
            before = clock['longest_delay']
            remembered = before * max(1.0 - samples * period / DELAY_MEMORY, 0.0)
            longest = max(remembered, min(longest, 2.0 * before + period))
            before = clock['mean_delay']
            mean = before + MEAN_DELAY_WEIGHT * (min(mean, longest) - before)
        clock['longest_delay'], clock['mean_delay'] = longest, mean
    limit_delays(clock)


@kernel
def limit_delays(clock: Clock) -> None:
    """Say by what is known of the delays how long one is suspicious, and how long it is a gap."""
    period, longest, mean = clock['mean_period'], clock['longest_delay'], clock['mean_delay']
    # Jitter of a timer is even: it ends at twice its mean. What is beyond is a tail, of which one
    # may yet see twice as much; and delays of more than a period are those of a queue, which may
    # grow to twice its length.
    tail = longest if longest >= period else max(longest - 2.0 * mean, 0.0)
    clock['suspicious'] = SUSPICIOUS * period
    clock['delay_limit'] = max(longest + tail + LIMIT_MARGIN * period, clock['suspicious'])
