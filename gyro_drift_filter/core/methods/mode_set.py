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

"""The mode set of method `adaptive`: one model of motion at many strengths.

The model of one axis. The change of the true rate from one sample to the next is white noise that
has passed twice through a first-order lag; the sensor adds noise v of variance R:

    [rate        ]     [1  1  0] [rate        ]   [1     ]
    [acceleration]  =  [0  r  1] [acceleration] + [2 r   ] w,    r = exp(-period / lag)
    [jerk        ]     [0  0  r] [jerk        ]   [r ** 2]
    z = rate + v

This is the paper's X = A X + Gamma w, Z = H X + v, equations (5) and (6), for motion in place of
drift. What differs between rest and motion is one number, the variance Q of w. So Q takes one of
MODES values. Each mode is a Kalman filter with the gain that the paper's equations (8), (9) and
(12) settle to with its Q. A mode is named by the time over which it averages:
Q = R (period / time) ** 6.

Which mode holds is a hidden Markov chain: motion grows without warning, and dies away from mode to
mode. Its transition matrix depends on what the sensor as a whole shows before the sample
(`Transition`). The probabilities of going several modes up or down are geometric, so that one pass
over the modes each way multiplies by the whole matrix.

Rates are in rad/s and times in s. Acceleration and jerk are angular, in rad/s per sample and per
sample squared. Variances are relative to R.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import kernel, record
from gyro_drift_filter.core.matrices import Matrix, invert, multiply, multiply_transposed

MODES = 24  # a multiple of four: arrays over the modes fill vector registers

# The slowest mode averages over this time in s: a longer one would lag behind a slow turn in strong
# noise. The fastest mode follows changes of FASTEST ** 3 times the noise per sample.
SLOWEST = 0.95
FASTEST = 25.0
# A motion of a hand is foreseen from one sample to the next, by acceleration and jerk, up to this
# sample period. Over a longer one what is not foreseen grows as its third power, until nothing is
# foreseen; and the fastest mode has to follow a larger change.
FORESEEN_SECONDS = 0.02

# How long acceleration and jerk last: a multiple of the mode's time, but no shorter than a movement
# of a hand, and no longer than it takes to know that a robot is not turning after all, in s.
LAG_PER_TIME = 8.0
SHORTEST_LAG = 0.03
LONGEST_LAG = 1.2

# UP_RATE motions begin in a second, as the fastest modes see it. Slower modes last for about their
# own time, so the probability to leave one upwards is at most that times UP_PER_TIME * period /
# time; likewise downwards, where DOWN is the probability per sample, and again for each further
# mode. By `Transition`: when a motion begins, any mode may be left at once; a body that stands has
# come to rest from whatever mode it was in.
UP_RATE = 3.0
UP_PER_TIME = (0.65, 3.0, math.inf)
DOWN = (0.1, 0.6, 0.1)
DOWN_PER_TIME = (0.6, 2.3, 0.6)

# A transition upwards goes one mode further with this probability, times the ratio of the
# innovation variances to this power. A power above one keeps the predicted variance finite with any
# number of modes.
UP_FURTHER = 0.8
UP_FURTHER_POWER = 1.2

PerMode = Annotated[NDArray[np.float64], np.float64, (MODES,)]
# By mode: of probability, rate, acceleration and jerk, side by side as all are moved alike.
Terms = Annotated[NDArray[np.float64], np.float64, (MODES, 4)]


class Transition(IntEnum):
    """Which transition matrix holds: what is known of the motion before the sample."""

    MOVING = 0  # the body moves, or nothing tells that it does not
    # All three rates are about what they are at rest, and the accelerometer is calm. A body that
    # stands turns about no axis, so motion may have died away on all three.
    SETTLING = 1
    # The accelerometer has just been shaken, as it is by what turns a body: a motion begins.
    SHAKEN = 2


class Transitions(TypedDict):
    """A transition matrix; probabilities per sample."""

    # To stay in a mode; to leave it upwards and end one mode above.
    stay: PerMode
    up_first: PerMode
    # To leave a mode downwards and end one mode below, for acceleration and jerk times the share
    # that is kept on the way; and the share that goes on from the mode above.
    down_first: Terms
    down_further: Terms


TRANSITIONS = record(Transitions, in_cache_lines=True)


class ModeSet(TypedDict):
    """Constants of all modes for one sample period."""

    lag_ratio: PerMode  # r
    # Steady-state gains, Q and innovation variance; the variances relative to R.
    gain_rate: PerMode
    gain_acceleration: PerMode
    gain_jerk: PerMode
    process_ratio: PerMode
    innovation_ratio: PerMode
    innovation_logarithm: PerMode
    # What white noise leaves in the state after a sample, relative to R: the variance of its rate,
    # and its covariances with acceleration and jerk.
    noise_rate: PerMode
    noise_acceleration: PerMode
    noise_jerk: PerMode
    # The variance of the lag behind a motion that nobody sees, relative to R.
    unseen_lag: PerMode
    up_further: PerMode  # of what reaches the mode below, the share that goes on to this one
    transitions: Annotated[Sequence[Transitions], TRANSITIONS, (len(Transition),)]


class Derivation(TypedDict):
    """Matrices that are needed while a mode set is derived."""

    forward: Matrix
    covariance: Matrix
    information: Matrix
    weight: Matrix
    carried: Matrix
    product: Matrix
    change: Matrix
    # by mode: variances of the errors after a sample, relative to R
    acceleration_error: PerMode
    jerk_error: PerMode
    kept: Terms  # shares that are kept in a transition to the mode below


MODE_SET = record(ModeSet, in_cache_lines=True)
DERIVATION = record(Derivation)


@kernel
def derive_mode_set(period: float, modes: ModeSet, scratch: Derivation) -> None:
    """Fill the constants of all modes for a sample period in s."""
    for j in range(MODES):
        time = _time(period, j)
        lag = max(SHORTEST_LAG, min(LAG_PER_TIME * time, LONGEST_LAG))
        lag_ratio, process_ratio = math.exp(-period / lag), (period / time) ** 6.0
        modes['lag_ratio'][j] = lag_ratio
        modes['process_ratio'][j] = process_ratio
        _settle_covariance(lag_ratio, process_ratio, scratch)
        covariance = scratch['covariance']
        innovation = covariance[0, 0] + 1.0  # (9), with R = 1
        modes['innovation_ratio'][j] = innovation
        modes['innovation_logarithm'][j] = math.log(innovation)
        gain = covariance[0, 0] / innovation
        modes['gain_rate'][j] = gain
        # By (12) a mode's rate has the variance gain * R: noise, and lag behind the mode's own
        # motion. But innovations show a lag only where it exceeds the noise, so in real motion the
        # unseen lag has about the variance of the noise that the mode lets through.
        modes['unseen_lag'][j] = gain * (1.0 - gain)
        modes['gain_acceleration'][j] = covariance[0, 1] / innovation
        modes['gain_jerk'][j] = covariance[0, 2] / innovation
        scratch['acceleration_error'][j] = _error(covariance, 1, innovation)
        scratch['jerk_error'][j] = _error(covariance, 2, innovation)
        _settle_noise(modes, j, scratch)  # the covariance above is overwritten
    _derive_kept_motion(modes, scratch)
    ratio, up_further = modes['innovation_ratio'], modes['up_further']
    up_further[0] = UP_FURTHER
    for j in range(1, MODES):
        up_further[j] = UP_FURTHER * (ratio[j - 1] / ratio[j]) ** UP_FURTHER_POWER
    for kind in range(len(DOWN)):
        _derive_transitions(modes['transitions'][kind], period, kind, up_further, scratch)


@kernel
def _time(period: float, mode: int) -> float:
    """Return the time in s over which a mode averages."""
    # The cube of it goes with the square of the period, by which a jerk changes the rate.
    fastest = period / FASTEST * max(period / FORESEEN_SECONDS, 1.0) ** (-2.0 / 3.0)
    return float(SLOWEST * (fastest / SLOWEST) ** (mode / (MODES - 1.0)))


@kernel
def _error(covariance: Matrix, i: int, innovation: float) -> float:
    """Return the variance of a part of the state after a sample."""
    return float(covariance[i, i] - covariance[0, i] * covariance[0, i] / innovation)


@kernel
def _derive_transitions(
    transitions: Transitions,
    period: float,
    kind: int,
    up_further: PerMode,
    scratch: Derivation,
) -> None:
    """Write a transition matrix; `kind` is a member of `Transition`."""
    unforeseen, down = 1.0 - math.exp(-UP_RATE * period), DOWN[kind]
    for j in range(MODES):
        time = _time(period, j)
        up = unforeseen * min(1.0, UP_PER_TIME[kind] * period / time) if j < MODES - 1 else 0.0
        leave = down * min(1.0, DOWN_PER_TIME[kind] * period / time) if j > 0 else 0.0
        up = min(up, 1.0 - leave)  # below 6 Hz both together would be more than one
        transitions['stay'][j] = max(1.0 - up - leave, 0.0)
        # The shares of all modes above add up to one, and those of all modes below.
        shares, share = 1.0, 1.0
        for k in range(j + 2, MODES):
            share *= up_further[k]
            shares += share
        transitions['up_first'][j] = up / shares
        first = leave * (1.0 - down) / (1.0 - down ** float(max(j, 1)))
        for term in range(4):
            kept = scratch['kept'][j, term]
            transitions['down_first'][j, term] = first * kept
            if j > 0:
                transitions['down_further'][j - 1, term] = down * kept


@kernel
def _derive_kept_motion(modes: ModeSet, scratch: Derivation) -> None:
    """Write what is kept in a transition downwards: of acceleration and jerk a part.

    The slower mode's own values are the prior there, and the faster mode's value is a measurement
    with the faster mode's error, (12).
    """
    for j in range(1, MODES):
        r, process = modes['lag_ratio'][j - 1], modes['process_ratio'][j - 1]
        # The stationary covariance of [acceleration, jerk] of the mode below.
        jerk = r**4.0 * process / (1.0 - r * r)
        both = (r * jerk + 2.0 * r**3.0 * process) / (1.0 - r * r)
        acceleration = (2.0 * r * both + jerk + 4.0 * r * r * process) / (1.0 - r * r)
        kept = scratch['kept'][j]
        kept[0] = kept[1] = 1.0
        kept[2] = acceleration / (acceleration + scratch['acceleration_error'][j])
        kept[3] = jerk / (jerk + scratch['jerk_error'][j])


@kernel
def _settle_covariance(lag_ratio: float, process_ratio: float, scratch: Derivation) -> None:
    """Write what P(k|k-1) of equations (8), (9) and (12) settles to, divided by R.

    The doubling algorithm squares the number of steps in each turn (Anderson and Moore, Optimal
    Filtering, 1979, section 6.7), so that half a second at 4 kHz takes twelve turns.
    """
    forward, covariance = scratch['forward'], scratch['covariance']  # A', P
    information, weight = scratch['information'], scratch['weight']
    carried, product, change = scratch['carried'], scratch['product'], scratch['change']
    for i in range(3):
        drive_i = _drive(lag_ratio, i)
        for k in range(3):
            forward[i, k] = information[i, k] = 0.0
            covariance[i, k] = drive_i * _drive(lag_ratio, k) * process_ratio
    forward[0, 0] = forward[1, 0] = forward[2, 1] = 1.0
    forward[1, 1] = forward[2, 2] = lag_ratio
    information[0, 0] = 1.0
    for _ in range(60):
        multiply(information, covariance, product)
        for i in range(3):
            product[i, i] += 1.0
        invert(product, weight)
        multiply(weight, forward, carried)
        multiply(covariance, carried, product)
        multiply_transposed(forward, product, change)
        multiply(forward, weight, product)
        multiply(product, information, weight)
        for i in range(3):
            for k in range(3):
                for m in range(3):
                    information[i, k] += weight[i, m] * forward[k, m]
        multiply(forward, carried, product)
        if _has_settled(covariance, change, forward, product):
            break


@kernel
def _has_settled(covariance: Matrix, change: Matrix, forward: Matrix, doubled: Matrix) -> bool:
    """Close a turn of doubling: add the change, take F doubled; return whether it was the last."""
    largest = largest_change = 0.0
    for i in range(3):
        for k in range(3):
            largest = max(largest, abs(covariance[i, k]))
            largest_change = max(largest_change, abs(change[i, k]))
            covariance[i, k] += change[i, k]
            forward[i, k] = doubled[i, k]
    return largest_change <= 1e-13 * largest


@kernel
def _settle_noise(modes: ModeSet, mode: int, scratch: Derivation) -> None:
    """Write what white noise of variance 1 leaves in the state of a mode after a sample.

    Its covariance C = F C F' + K K' with F = (I - K H) A, equations (7), (10) and (11), is a sum
    of powers of F that is doubled in each turn.
    """
    transposed, covariance = scratch['forward'], scratch['covariance']  # F', C
    carried, change = scratch['carried'], scratch['change']
    gain_rate, lag_ratio = modes['gain_rate'][mode], modes['lag_ratio'][mode]
    gain_acceleration, gain_jerk = modes['gain_acceleration'][mode], modes['gain_jerk'][mode]
    gains = gain_rate, gain_acceleration, gain_jerk
    for i in range(3):
        for k in range(3):
            covariance[i, k] = gains[i] * gains[k]
        transposed[0, i] = transposed[1, i] = -gains[i]
        transposed[2, i] = 0.0
    transposed[0, 0] += 1.0
    transposed[1, 0] += 1.0
    transposed[1, 1] += lag_ratio
    transposed[2, 1] = 1.0
    transposed[2, 2] = lag_ratio
    for _ in range(60):
        multiply(covariance, transposed, carried)
        multiply_transposed(transposed, carried, change)
        multiply(transposed, transposed, carried)
        if _has_settled(covariance, change, transposed, carried):
            break
    modes['noise_rate'][mode] = covariance[0, 0]
    modes['noise_acceleration'][mode] = covariance[0, 1]
    modes['noise_jerk'][mode] = covariance[0, 2]


@kernel
def _drive(lag_ratio: float, i: int) -> float:
    """Return an element of Gamma."""
    if i == 0:
        return 1.0
    return 2.0 * lag_ratio if i == 1 else lag_ratio * lag_ratio
