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

"""The shift: by how much the bias in motion is above that at rest.

A sensor rectifies vibration, so how large the shift may be follows from how much the sensor
vibrates in motion.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gyro_drift_filter.accelerate import PerAxis, kernel
from gyro_drift_filter.core.bias.motion_state import (
    BIAS,
    LARGEST_PRIOR,
    SPEED,
    UNKNOWN_PRIOR,
    MotionBias,
)

# A sensor rectifies vibration, so the deviation of the shift grows with the variance of the
# vibration in motion: in rad/s per (rad/s)^2 of the rates, and per (m/s^2)^2 of all three
# accelerations. The smaller one counts, as motors shake both, but a quick hand little more than the
# rates, and a road little more than the accelerations. On nine flights of EuRoC shifts were up to
# 2.2e-3 rad/s, at some 5e-3 rad/s and 0.24 m/s^2 in the calmest windows.
RATE_RECTIFICATION, ACCELERATION_RECTIFICATION = 50.0, 0.03
# It is at least this share of the deviation of the noise at rest, which does no harm.
NOISE_SHARE = 0.1


class BiasShift(NamedTuple):
    """The bias in motion less that at rest.

    Attributes:
        shift: (3,) in rad/s.
        deviation: (3,) its standard deviation in rad/s, infinite where nothing is known.
    """

    shift: Sequence[float]
    deviation: Sequence[float]


NO_SHIFT = BiasShift((0.0, 0.0, 0.0), (math.inf, math.inf, math.inf))


@kernel
def shift_of(state: MotionBias, axis: int) -> float:
    """Return by how much the bias in motion of an axis is above that at rest, in rad/s."""
    return float(state['state_vector'][BIAS + axis] - state['bias_at_rest']['bias'][axis])


@kernel
def shift_variance(state: MotionBias, axis: int) -> float:
    """Return the variance of the shift of an axis, in (rad/s)^2."""
    bias_at_rest, in_motion = state['bias_at_rest'], state['covariance'][BIAS + axis, BIAS + axis]
    at_rest, both = bias_at_rest['variance'][axis], bias_at_rest['cross_covariance'][axis]
    return float(max(in_motion - 2.0 * both + at_rest, 0.0))


@kernel
def set_shift(state: MotionBias, shift: PerAxis, variance: PerAxis) -> None:
    """Begin with a shift (3,) in rad/s and its variance (3,), infinite where it is not known."""
    state['speed_deviation'] = SPEED
    for axis in range(3):
        known = variance[axis] < np.inf
        largest_prior = LARGEST_PRIOR if known else UNKNOWN_PRIOR
        prior = min(variance[axis], largest_prior * largest_prior)
        state['bias_at_rest']['known'][axis] = known
        state['rectified'][axis] = prior if known else 0.0
        replace_shift(state, axis, shift[axis], prior)


@kernel
def replace_shift(state: MotionBias, axis: int, shift: float, variance: float) -> None:
    """Take another shift of an axis; the bias in motion has to be started anew after it."""
    bias_at_rest, i = state['bias_at_rest'], BIAS + axis
    state['state_vector'][i] = bias_at_rest['bias'][axis] + shift
    state['covariance'][i, i] = variance
    bias_at_rest['variance'][axis] = bias_at_rest['cross_covariance'][axis] = 0.0


@kernel
def forget_shift(state: MotionBias) -> None:
    """Forget the shift but for how far it may go; start the bias in motion anew after it."""
    for axis in range(3):
        replace_shift(state, axis, 0.0, state['rectified'][axis])


@kernel
def limit_shift(state: MotionBias, axis: int, variance: float) -> bool:
    """Let the variance of the shift be what vibration and the noise at rest let it be.

    `variance` is that of the noise, in (rad/s)^2.
    Return whether that is another one, so that the bias in motion has to be started anew.
    """
    before = shift_variance(state, axis)
    by_noise = min(NOISE_SHARE * NOISE_SHARE * variance, LARGEST_PRIOR * LARGEST_PRIOR)
    largest_variance = max(by_noise, state['rectified'][axis])
    if state['bias_at_rest']['known'][axis] and before <= largest_variance:
        return False
    shift = shift_of(state, axis)
    if largest_variance < before:
        # What was learned with the larger one shrinks with it.
        shift *= largest_variance / before
    replace_shift(state, axis, shift, largest_variance)
    state['bias_at_rest']['known'][axis] = 1
    return True


@kernel
def widen_shift(state: MotionBias) -> None:
    """Widen the shift where the vibration of the last period lets it be larger than before."""
    calmest = state['vibration']['calmest']
    shaken = ACCELERATION_RECTIFICATION * (calmest[3] + calmest[4] + calmest[5])
    for axis in range(3):
        deviation = min(RATE_RECTIFICATION * calmest[axis], shaken)
        let_shift_vary(state, axis, deviation * deviation)


@kernel
def let_shift_vary(state: MotionBias, axis: int, variance: float) -> None:
    """Let the shift of an axis have a variance of up to so much, in (rad/s)^2."""
    variance = min(variance, LARGEST_PRIOR * LARGEST_PRIOR)
    more = variance - max(state['rectified'][axis], shift_variance(state, axis))
    if more > 0.0:
        state['covariance'][BIAS + axis, BIAS + axis] += more
    state['rectified'][axis] = max(state['rectified'][axis], variance)
