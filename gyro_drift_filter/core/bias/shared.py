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

"""What the bias at rest and that in motion share: both, their covariances, and the shift.

The two biases differ by a shift, but most of what moves one moves the other, too. So both are in
one filter, and each rest measures the bias at rest. That corrects the bias in motion as well, and
leaves what motion has shown of the shift. What motion shows of the bias at rest counts in here
alone: `at_rest.py` learns that bias from rests, so that a flight does not change what is subtracted
after the landing.
"""

import math
from collections.abc import Sequence
from typing import Annotated, NamedTuple, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.bias.vibration import Vibration
from gyro_drift_filter.core.matrices import Matrix

STATES = 24
DIRECTION, VELOCITY, BIAS, ACCELERATION, MEAN_VELOCITY, SCALE = 0, 3, 6, 9, 12, 15
# Deviation of the errors of scale and alignment that a factory leaves: data sheets of gyroscopes
# give 0.5 to 3 % for the scale, and 0.5 to 2 % for what an axis shows of the others.
SCALE_ERROR = 0.01

# A sensor rectifies vibration, so the deviation of the shift grows with the variance of the
# vibration in motion: in rad/s per (rad/s)^2 of the rates, and per (m/s^2)^2 of all three
# accelerations. The smaller one counts, as motors shake both, but a quick hand little more than the
# rates, and a road little more than the accelerations. On nine flights of EuRoC shifts were up to
# 2.2e-3 rad/s, at some 5e-3 rad/s and 0.24 m/s^2 in the calmest windows.
RATE_RECTIFICATION, ACCELERATION_RECTIFICATION = 50.0, 0.03
# It is at least this share of the deviation of the noise at rest, which does no harm.
NOISE_SHARE = 0.1
# With a larger prior of shift or bias, errors of the model would move the bias about the vertical,
# of which gravity shows nothing.
LARGEST_PRIOR = 1.5e-3  # rad/s
# A bias less certain than UNKNOWN (rad/s) is better left to the next rest, as most robots have one
# soon: in the first UNKNOWN_SECONDS of motion its prior is UNKNOWN_PRIOR, then LATER_PRIOR.
UNKNOWN, UNKNOWN_SECONDS, UNKNOWN_PRIOR, LATER_PRIOR = 0.02, 15.0, 5e-4, 2e-3

# The velocity in m/s that a robot or a hand has until it shows a larger one.
SPEED = 0.7


class BiasShift(NamedTuple):
    """The bias in motion less that at rest.

    Attributes:
        shift: (3,) in rad/s.
        deviation: (3,) its standard deviation in rad/s, infinite where nothing is known.
    """

    shift: Sequence[float]
    deviation: Sequence[float]


NO_SHIFT = BiasShift((0.0, 0.0, 0.0), (math.inf, math.inf, math.inf))

PerState = Annotated[NDArray[np.float64], np.float64, (STATES,)]
Covariance = Annotated[NDArray[np.float64], np.float64, (STATES, STATES)]


class BiasAtRest(TypedDict):
    """The bias at rest, as the bias in motion knows it: covariances in (rad/s)^2."""

    bias: PerAxis  # rad/s
    variance: PerAxis
    common: PerAxis  # covariance with the bias in motion
    untracked_variance: PerAxis  # more of all three, which motion teaches nothing of
    known: CountPerAxis  # 1 where the shift's variance is by memory or by the noise at rest, else 0


BIAS_AT_REST = record(BiasAtRest)


class MotionBias(TypedDict):
    """The filter of the bias in motion."""

    # direction, velocity (m/s), bias (rad/s), accelerometer's bias (m/s^2), mean velocity (m/s),
    # and the rows of the errors of the gyroscope's scale and alignment
    state_vector: PerState
    covariance: Covariance
    bias_at_rest: BiasAtRest
    pending_process_noise: float  # (rad/s)^2, of both biases, since it was last added
    untracked_share: float  # of the process noise: what motion teaches nothing of
    speed_deviation: float  # m/s, of the velocity from zero
    moving_seconds: float  # since the start, of motion
    # sums over it
    vertical_angle: float  # rad, by which the body has turned about the vertical
    carried: float  # m/s, of the acceleration along the vertical: gravity, on the mean
    wide: bool  # all of the bias is tracked, whatever its variance, at the speed of a hand
    directed: bool  # the direction of gravity is known
    moving: bool  # the covariance is that of a motion
    missed_turn: float  # rad, that the rates may not have shown since they were at their limit
    vibration: Vibration
    rectified: PerAxis  # (rad/s)^2, variance of the shift by vibration so far, or by memory
    # the value under way
    samples: int
    seconds: float
    angle: PerAxis  # rad
    speed: PerAxis  # m/s
    # the block under way
    block_seconds: float
    block_angle: PerAxis  # rad
    turn: Matrix  # T
    turn_integral: Matrix  # M, in s


class SharedBias(TypedDict):
    """What a segment of rest changes of it."""

    bias: PerAxis  # rad/s
    variance: PerAxis  # (rad/s)^2
    bias_at_rest: BiasAtRest
    added_process_noise: float  # (rad/s)^2, that is in the variance, since the last segment


SHARED_BIAS = record(SharedBias)
MOTION_BIAS = record(MotionBias)


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
        _replace_shift(state, axis, shift[axis], prior)


@kernel
def tracks_scale(state: MotionBias) -> bool:
    """Return whether errors of the scale are states; else they are noise of each turn."""
    return bool(state['covariance'][SCALE, SCALE] > 0.0)


@kernel
def _start_scale(state: MotionBias, variance: PerAxis) -> None:
    """Track errors of the scale from where the bias is known, as each would be taken for the other.

    `variance` (3,) is that of the bias, in (rad/s)^2.
    """
    if state['wide'] or tracks_scale(state):
        return
    for axis in range(3):
        if variance[axis] > UNKNOWN * UNKNOWN:
            return
    _expect_any_scale(state)


@kernel
def forget_scale(state: MotionBias) -> None:
    """Forget what is known of the errors of the scale: another sensor measures from now on."""
    if tracks_scale(state):
        _expect_any_scale(state)


@kernel
def _expect_any_scale(state: MotionBias) -> None:
    """Expect the errors of scale and alignment that a factory leaves."""
    vector, covariance = state['state_vector'], state['covariance']
    for i in range(SCALE, STATES):
        vector[i] = 0.0
        for k in range(STATES):
            covariance[i, k] = covariance[k, i] = 0.0
        covariance[i, i] = SCALE_ERROR * SCALE_ERROR


@kernel
def _replace_shift(state: MotionBias, axis: int, shift: float, variance: float) -> None:
    """Take another shift of an axis; the bias in motion has to be started anew after it."""
    bias_at_rest, i = state['bias_at_rest'], BIAS + axis
    state['state_vector'][i] = bias_at_rest['bias'][axis] + shift
    state['covariance'][i, i] = variance
    bias_at_rest['variance'][axis] = bias_at_rest['common'][axis] = 0.0


@kernel
def shift_of(state: MotionBias, axis: int) -> float:
    """Return by how much the bias in motion of an axis is above that at rest, in rad/s."""
    return float(state['state_vector'][BIAS + axis] - state['bias_at_rest']['bias'][axis])


@kernel
def shift_variance(state: MotionBias, axis: int) -> float:
    """Return the variance of the shift of an axis, in (rad/s)^2."""
    bias_at_rest, i = state['bias_at_rest'], BIAS + axis
    common = bias_at_rest['common'][axis]
    return float(
        max(state['covariance'][i, i] - 2.0 * common + bias_at_rest['variance'][axis], 0.0)
    )


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
    _replace_shift(state, axis, shift, largest_variance)
    state['bias_at_rest']['known'][axis] = 1
    return True


@kernel
def widen_shift(state: MotionBias) -> None:
    """Widen the shift where the vibration of the last period lets it be larger than before."""
    calmest = state['vibration']['calmest']
    shaken = ACCELERATION_RECTIFICATION * (calmest[3] + calmest[4] + calmest[5])
    for axis in range(3):
        deviation = min(RATE_RECTIFICATION * calmest[axis], shaken, LARGEST_PRIOR)
        variance = deviation * deviation
        more = variance - max(state['rectified'][axis], shift_variance(state, axis))
        if more > 0.0:
            state['covariance'][BIAS + axis, BIAS + axis] += more
        state['rectified'][axis] = max(state['rectified'][axis], variance)


@kernel
def start_motion_bias(state: MotionBias, bias: PerAxis, variance: PerAxis) -> None:
    """Begin with the bias at rest (3,) in rad/s and its variance (3,); the shift is kept."""
    bias_at_rest = state['bias_at_rest']
    for axis in range(3):
        i = BIAS + axis
        shift, of_shift = shift_of(state, axis), shift_variance(state, axis)
        for k in range(STATES):
            state['covariance'][i, k] = state['covariance'][k, i] = 0.0
        state['state_vector'][i] = bias[axis] + shift
        state['covariance'][i, i] = variance[axis] + of_shift
        bias_at_rest['bias'][axis] = bias[axis]
        bias_at_rest['variance'][axis] = bias_at_rest['common'][axis] = variance[axis]
        bias_at_rest['untracked_variance'][axis] = 0.0
    state['pending_process_noise'] = 0.0
    state['moving_seconds'] = state['vertical_angle'] = state['carried'] = 0.0
    state['moving'] = False
    _start_scale(state, variance)


@kernel
def start_wide_prior(state: MotionBias, bias: PerAxis, variance: PerAxis) -> None:
    """Begin with a bias (3,) in rad/s, all of its variance (3,) tracked and no shift."""
    for axis in range(3):
        _replace_shift(state, axis, 0.0, 0.0)
    state['wide'] = True
    start_motion_bias(state, bias, variance)
    state['speed_deviation'] = SPEED


@kernel
def learn_at_rest(state: MotionBias, axis: int, mean: float, noise: float) -> None:
    """Take the mean rate of a rest, in rad/s, with the variance of its noise, in (rad/s)^2, in."""
    add_bias_process_noise(state)
    track_all(state, axis)
    bias_at_rest, i = state['bias_at_rest'], BIAS + axis
    variance, common = bias_at_rest['variance'][axis], bias_at_rest['common'][axis]
    innovation, spread = mean - bias_at_rest['bias'][axis], variance + noise
    gain, gain_in_motion = variance / spread, common / spread
    bias_at_rest['bias'][axis] += gain * innovation
    bias_at_rest['variance'][axis] -= gain * variance
    bias_at_rest['common'][axis] -= gain * common
    state['state_vector'][i] += gain_in_motion * innovation
    left = state['covariance'][i, i] - gain_in_motion * common
    # Each axis by itself, as the bias at rest is.
    for k in range(STATES):
        state['covariance'][i, k] = state['covariance'][k, i] = 0.0
    state['covariance'][i, i] = left


@kernel
def keep_shared(state: MotionBias, kept: SharedBias, process_noise: float) -> None:
    """Keep what a segment of rest may change, before it does.

    `process_noise` is that of the bias at rest since the last segment.
    """
    kept['added_process_noise'] = process_noise - state['pending_process_noise']
    for axis in range(3):
        i = BIAS + axis
        kept['bias'][axis] = state['state_vector'][i]
        kept['variance'][axis] = state['covariance'][i, i]
    kept['bias_at_rest'] = state['bias_at_rest']


@kernel
def restore_shared(state: MotionBias, kept: SharedBias, process_noise: float) -> None:
    """Undo what segments of rest have changed since; `process_noise` as for `keep_shared`."""
    state['pending_process_noise'] = process_noise - kept['added_process_noise']
    for axis in range(3):
        i = BIAS + axis
        before = state['covariance'][i, i]
        state['state_vector'][i] = kept['bias'][axis]
        state['covariance'][i, i] = kept['variance'][axis]
        _correlate_less(state, axis, before)
    state['bias_at_rest'] = kept['bias_at_rest']


@kernel
def motion_variance(state: MotionBias, axis: int) -> float:
    """Return the variance of the bias in motion at present, in (rad/s)^2."""
    i = BIAS + axis
    untracked = state['bias_at_rest']['untracked_variance'][axis]
    return float(state['covariance'][i, i] + state['pending_process_noise'] + untracked)


@kernel
def track_all(state: MotionBias, axis: int) -> None:
    """Track what was left out."""
    untracked = state['bias_at_rest']['untracked_variance'][axis]
    widen_both(state, axis, untracked)
    state['bias_at_rest']['untracked_variance'][axis] = 0.0


@kernel
def widen_both(state: MotionBias, axis: int, variance: float) -> None:
    """Add a variance in (rad/s)^2 of what moves both biases."""
    state['covariance'][BIAS + axis, BIAS + axis] += variance
    state['bias_at_rest']['variance'][axis] += variance
    state['bias_at_rest']['common'][axis] += variance


@kernel
def add_bias_process_noise(state: MotionBias) -> None:
    """Add the process noise of both biases since the last time."""
    untracked = state['untracked_share'] * state['pending_process_noise']
    for axis in range(3):
        widen_both(state, axis, state['pending_process_noise'] - untracked)
        state['bias_at_rest']['untracked_variance'][axis] += untracked
    state['pending_process_noise'] = 0.0


@kernel
def limit_prior(state: MotionBias) -> None:
    """Leave out of what is tracked in motion what is beyond the largest prior."""
    added = (1.0 - state['untracked_share']) * state['pending_process_noise']
    add_bias_process_noise(state)
    if state['wide']:
        return
    bias_at_rest = state['bias_at_rest']
    for axis in range(3):
        i = BIAS + axis
        # What the bias has just walked, or was left out before, goes with no other state yet.
        correlated = state['covariance'][i, i] - added
        largest_prior = LARGEST_PRIOR
        if state['covariance'][i, i] + bias_at_rest['untracked_variance'][axis] > UNKNOWN * UNKNOWN:
            track_all(state, axis)
            waits = state['moving_seconds'] < UNKNOWN_SECONDS
            largest_prior = UNKNOWN_PRIOR if waits else LATER_PRIOR
        beyond = state['covariance'][i, i] - largest_prior * largest_prior
        beyond = min(beyond, bias_at_rest['common'][axis])
        if beyond > 0.0:
            widen_both(state, axis, -beyond)
            bias_at_rest['untracked_variance'][axis] += beyond
        _correlate_less(state, axis, correlated)


@kernel
def _correlate_less(state: MotionBias, axis: int, before: float) -> None:
    """Leave what goes with a bias to the share of its variance that is left of the one before.

    Else its covariances with other states would be more than its variance allows.
    """
    covariance, i = state['covariance'], BIAS + axis
    if covariance[i, i] >= before:
        return
    share = covariance[i, i] / before
    for k in range(STATES):
        if k != i:
            covariance[i, k] *= share
            covariance[k, i] *= share
