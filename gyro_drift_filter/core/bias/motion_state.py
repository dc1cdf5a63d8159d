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

"""The state of the filter of the bias in motion, and of the bias at rest that goes with it.

The two biases differ by a shift, but most of what moves one moves the other, too.
"""

from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.bias.vibration import Vibration
from gyro_drift_filter.core.matrices import Matrix

STATES = 24
DIRECTION, VELOCITY, BIAS, ACCELERATION, MEAN_VELOCITY, SCALE = 0, 3, 6, 9, 12, 15
# The velocity in m/s that a robot or a hand has until it shows a larger one.
SPEED = 0.7
# Deviation of the errors of scale and alignment that a factory leaves: data sheets of gyroscopes
# give 0.5 to 3 % for the scale, and 0.5 to 2 % for what an axis shows of the others.
SCALE_ERROR = 0.01
# With a larger prior of shift or bias, errors of the model would move the bias about the vertical,
# of which gravity shows nothing.
LARGEST_PRIOR = 1.5e-3  # rad/s
# A bias less certain than UNKNOWN (rad/s) is better left to the next rest, as most robots have one
# soon: in the first UNKNOWN_SECONDS of motion its prior is UNKNOWN_PRIOR, then LATER_PRIOR.
UNKNOWN, UNKNOWN_SECONDS, UNKNOWN_PRIOR, LATER_PRIOR = 0.02, 15.0, 5e-4, 2e-3

PerState = Annotated[NDArray[np.float64], np.float64, (STATES,)]
Covariance = Annotated[NDArray[np.float64], np.float64, (STATES, STATES)]


class BiasAtRest(TypedDict):
    """The bias at rest, as the bias in motion knows it: covariances in (rad/s)^2."""

    bias: PerAxis  # rad/s
    variance: PerAxis
    cross_covariance: PerAxis  # with the bias in motion
    untracked_variance: PerAxis  # to be added to all three; gravity corrects nothing of this part
    known: CountPerAxis  # 1 where the shift's variance is by memory or by the noise at rest, else 0


class MotionBias(TypedDict):
    """The filter of the bias in motion."""

    # direction, velocity (m/s), bias (rad/s), accelerometer's bias (m/s^2), mean velocity (m/s),
    # and the rows of the errors of the gyroscope's scale and alignment
    state_vector: PerState
    covariance: Covariance
    bias_at_rest: BiasAtRest
    pending_process_noise: float  # (rad/s)^2, of both biases, since it was last added
    untracked_share: float  # of the process noise: the part that gravity corrects nothing of
    speed_deviation: float  # m/s, of the velocity from zero
    moving_seconds: float  # since the start, of motion
    # sums over it
    vertical_angle: float  # rad, by which the body has turned about the vertical
    carried: float  # m/s, of the acceleration along the vertical: gravity, on the mean
    wide: bool  # all of the bias is tracked, whatever its variance, at the speed of a hand
    # mean of the last normalised innovations squared, of a wide prior: 1 and less where rates and
    # accelerations are of one motion
    innovation_square: float
    # times that a velocity was beyond that of all robots, and s of motion since the last one
    contradictions: int
    sound_seconds: float
    directed: bool  # the direction of gravity is known
    moving: bool  # the covariance is that of a motion
    unmeasured_turn: float  # rad, that the rates may not have shown since they were last sound
    unmeasured_seconds: float  # s, for which they were not measured since then
    vibration: Vibration
    # (rad/s)^2, variance of the shift by vibration or rounding so far, or by memory
    rectified: PerAxis
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
    """What a segment of rest changes of the bias in motion, kept so that it can be undone."""

    bias: PerAxis  # rad/s
    variance: PerAxis  # (rad/s)^2
    bias_at_rest: BiasAtRest
    added_process_noise: float  # (rad/s)^2, that is in the variance, since the last segment


SHARED_BIAS = record(SharedBias)
MOTION_BIAS = record(MotionBias)


@kernel
def motion_variance(state: MotionBias, axis: int) -> float:
    """Return the variance of the bias in motion at present, in (rad/s)^2."""
    i = BIAS + axis
    untracked = state['bias_at_rest']['untracked_variance'][axis]
    return float(state['covariance'][i, i] + state['pending_process_noise'] + untracked)


@kernel
def tracks_scale(state: MotionBias) -> bool:
    """Return whether errors of the scale are states; else they are noise of each turn."""
    return bool(state['covariance'][SCALE, SCALE] > 0.0)


@kernel
def widen_both(state: MotionBias, axis: int, variance: float) -> None:
    """Add a variance in (rad/s)^2 of what moves both biases."""
    state['covariance'][BIAS + axis, BIAS + axis] += variance
    state['bias_at_rest']['variance'][axis] += variance
    state['bias_at_rest']['cross_covariance'][axis] += variance


@kernel
def track_all(state: MotionBias, axis: int) -> None:
    """Let gravity correct the untracked variance, too."""
    untracked = state['bias_at_rest']['untracked_variance'][axis]
    widen_both(state, axis, untracked)
    state['bias_at_rest']['untracked_variance'][axis] = 0.0


@kernel
def add_bias_process_noise(state: MotionBias) -> None:
    """Add the process noise of both biases since the last time."""
    untracked = state['untracked_share'] * state['pending_process_noise']
    for axis in range(3):
        widen_both(state, axis, state['pending_process_noise'] - untracked)
        state['bias_at_rest']['untracked_variance'][axis] += untracked
    state['pending_process_noise'] = 0.0


@kernel
def scale_covariances(state: MotionBias, axis: int, before: float) -> None:
    """Scale the covariances of a bias with other states as its variance has fallen from `before`.

    Else they would be more than the variance allows.
    """
    covariance, i = state['covariance'], BIAS + axis
    if covariance[i, i] >= before:
        return
    share = covariance[i, i] / before
    for k in range(STATES):
        if k != i:
            covariance[i, k] *= share
            covariance[k, i] *= share
