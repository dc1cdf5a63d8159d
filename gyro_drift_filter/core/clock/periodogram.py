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

"""The sample period that the stamps agree with best, wherever samples are missing between them.

With the true period the phases of even stamps are all alike, whether samples are missing or not.
With another one they go round, and cancel out. The squared length of the mean of their unit vectors
is the Rayleigh periodogram of event times, by which pulsars are found: K. T. S. Brazier,
"Confidence intervals from the Rayleigh test", MNRAS 268, 1994. It is 1 for even stamps.

A bus that is asked every 8 ms for samples of every 10 ms has stamps that agree with 8 ms, too,
although none is missing. But what is missing at random makes stamps walk away from the line of
their mean step, so this walk says how many may be missing at most.
"""

import math
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.clock.periods import LONGEST_PERIOD, SHORTEST_PERIOD
from gyro_drift_filter.core.clock.records import STAMPS, Clock

# Fewer stamps agree with some period by chance.
LEAST_STAMPS = 64
# The walk is that over so many steps, where delays add little to it, and it is as uncertain as the
# number of such stretches says: so many times what it shows may be missing.
WALK_STEPS, WALK_MARGIN = 8, 1.5
# A smaller share of missing samples lengthens the period by less than the clock looks at.
LEAST_MISSING = 0.01
# Of the mean step: a stamp that comes so soon is that of a sample that was held up. It says when
# the driver came to read it, and as many as were held up agree with any period.
HELD_UP = 0.25
# If a larger share were missing, half of the period would come in question, with which even stamps
# agree as well.
MOST_MISSING = 0.4
# In periods. With a longer step among the stamps, over a gap or while a driver was blocked, their
# mean step says nothing of the period.
LONGEST_STEP = 16.0
# So many frequencies are looked at in each 1 / T, which is what stamps over a time T tell apart.
OVERSAMPLING = 3
# A power that stamps without a period have by chance once in so many times shows one. Where steps
# are so even that it would be more than the second value, that is enough.
CHANCE, CERTAIN_POWER = 1e6, 0.5


PerStamp = Annotated[NDArray[np.float64], np.float64, (STAMPS,)]


class ClockWorkspace(TypedDict):
    """What is needed to find the period of the stamps: them, and their phases at one frequency."""

    seconds: PerStamp  # in order, less the newest one
    cosine: PerStamp
    sine: PerStamp
    # of what the phases turn by from one frequency to the next
    turn_cosine: PerStamp
    turn_sine: PerStamp


@kernel
def keep_stamp(clock: Clock, stamp: int) -> None:
    """Keep a stamp in ns, in place of the oldest one."""
    clock['stamps'][clock['kept'] % STAMPS] = stamp
    clock['kept'] += 1


@kernel
def period_of_stamps(clock: Clock, workspace: ClockWorkspace) -> float:
    """Return the sample period in s where samples are missing.

    It is 0 where none or hardly any are, and where the stamps agree with no period.
    """
    seconds, count = workspace['seconds'], _list_seconds(clock, workspace)
    if count < LEAST_STAMPS:
        return 0.0
    span = -seconds[0]
    step = span / (count - 1)
    if step < SHORTEST_PERIOD:
        return 0.0
    if _longest_step(seconds, count) > LONGEST_STEP * clock['mean_period']:
        return 0.0
    most = min(WALK_MARGIN * _share_by_walk(seconds, count, step), MOST_MISSING)
    if most < LEAST_MISSING:
        return 0.0
    frequency, change = 1.0 / step, 1.0 / (OVERSAMPLING * span)
    read = _start_phases(workspace, count, frequency, change)
    if read < LEAST_STAMPS:
        return 0.0
    frequencies = int(frequency * most / (1.0 - most) / change) + 2
    power, index, shift = _strongest(workspace, count, read, frequencies)
    # By chance the power has an exponential distribution with this mean.
    by_chance = max(_power_of_varying_steps(seconds, count, frequency + index * change), 1.0)
    if power < min(math.log(CHANCE) * by_chance / read, CERTAIN_POWER):
        return 0.0
    period = 1.0 / (frequency + (index + shift) * change)
    longest = min((1.0 - LEAST_MISSING) * step, LONGEST_PERIOD)
    return float(period) if SHORTEST_PERIOD <= period <= longest else 0.0


@kernel
def _list_seconds(clock: Clock, workspace: ClockWorkspace) -> int:
    """List the kept stamps in the workspace, and return how many there are."""
    stamps, kept = clock['stamps'], clock['kept']
    count = min(kept, STAMPS)
    for i in range(count):
        age = stamps[(kept - 1) % STAMPS] - stamps[(kept - count + i) % STAMPS]
        workspace['seconds'][i] = -1e-9 * age
    return int(count)


@kernel
def _longest_step(seconds: PerStamp, count: int) -> float:
    """Return the longest step in s from one stamp to the next."""
    longest = 0.0
    for i in range(1, count):
        longest = max(longest, seconds[i] - seconds[i - 1])
    return longest


@kernel
def _share_by_walk(seconds: PerStamp, count: int, step: float) -> float:
    """Return the share of samples that are missing, by how the stamps leave their mean step (s).

    The number of periods from one sample to the next is geometric. Its variance is the share that
    is missing times the square of its mean, and such variances add up from step to step.
    """
    squares = 0.0
    for i in range(WALK_STEPS, count):
        squares += (seconds[i] - seconds[i - WALK_STEPS] - WALK_STEPS * step) ** 2
    return squares / ((count - WALK_STEPS) * WALK_STEPS * step * step)


@kernel
def _power_of_varying_steps(seconds: PerStamp, count: int, frequency: float) -> float:
    """Return the mean power of one stamp at a frequency (Hz), if each step varied by itself.

    A driver that sleeps between two readings has such steps: their errors add up, so that stamps
    agree with one period for a while and with another one later. It is the spectrum of a renewal
    process, by the characteristic function of its steps (D. R. Cox, P. A. W. Lewis, "The
    Statistical Analysis of Series of Events", 1966).
    """
    x, y = 0.0, 0.0
    for i in range(1, count):
        phase = 2.0 * math.pi * frequency * (seconds[i] - seconds[i - 1])
        x += math.cos(phase)
        y += math.sin(phase)
    x, y = x / (count - 1), y / (count - 1)
    differ = (1.0 - x) ** 2 + y * y
    return (1.0 - x * x - y * y) / differ if differ > 0.0 else math.inf


@kernel
def _start_phases(workspace: ClockWorkspace, count: int, frequency: float, change: float) -> int:
    """Set the phase of each stamp, one change of the frequency (Hz) before the first one.

    Those of samples that were held up have none. Returns how many are left.
    """
    seconds, read = workspace['seconds'], 0
    for i in range(count):
        held_up = i > 0 and seconds[i] - seconds[i - 1] < HELD_UP / frequency
        length = 0.0 if held_up else 1.0
        read += 0 if held_up else 1
        phase = 2.0 * math.pi * (frequency - change) * seconds[i]
        turn = 2.0 * math.pi * change * seconds[i]
        workspace['cosine'][i] = length * math.cos(phase)
        workspace['sine'][i] = length * math.sin(phase)
        workspace['turn_cosine'][i], workspace['turn_sine'][i] = math.cos(turn), math.sin(turn)
    return read


@kernel
def _strongest(
    workspace: ClockWorkspace, count: int, read: int, frequencies: int
) -> tuple[float, int, float]:
    """Return the largest power, the number of its frequency, and how far off the peak is.

    Of `count` stamps `read` have a phase. The peak is that of the parabola through the largest
    power and its neighbours.
    """
    best, best_index, before, below, above = 0.0, 0, 0.0, 0.0, 0.0
    for index in range(frequencies):
        power = _turn_phases(workspace, count) / (read * read)
        if power > best:
            best, best_index, below, above = power, index, before, 0.0
        elif index == best_index + 1:
            above = power
        before = power
    if below == 0.0 or above == 0.0:
        return best, best_index, 0.0
    return best, best_index, 0.5 * (above - below) / (2.0 * best - above - below)


@kernel
def _turn_phases(workspace: ClockWorkspace, count: int) -> float:
    """Turn the phases to the next frequency; return the squared length of their sum."""
    cosine, sine = workspace['cosine'], workspace['sine']
    turn_cosine, turn_sine = workspace['turn_cosine'], workspace['turn_sine']
    x, y = 0.0, 0.0
    for i in range(count):
        c, s = cosine[i], sine[i]
        cosine[i] = c * turn_cosine[i] - s * turn_sine[i]
        sine[i] = s * turn_cosine[i] + c * turn_sine[i]
        x += cosine[i]
        y += sine[i]
    return x * x + y * y
