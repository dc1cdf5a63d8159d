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

"""Prediction and correction of the filter of the bias in motion, over a block of values.

The covariance is carried by the transition over the block. As directions turn with the body,
R = exp(-[angle]) of each value, that needs their product T over the block and the integral M of
what is left of it to the end:

    ds = T ds0 - [s]x M db
    du = l T du0 - g t T ds0 + (g t [s]x M / 2 - [u]x M) db - M da + (1 - l) dm

where l is what is left of a velocity after the time t of the block: all of it once a bias is known.
Until then it decays, as the bias would be taken for speed. An error of E counts as one of the bias,
in proportion to the mean of w - b over the block. It tilts what turns one way, and leaves what
turns to and fro; as noise of each turn it would hide the bias of a hand. What is subtracted is b
alone: the rates keep their scale.
"""

import math
from typing import TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.bias.motion_state import (
    ACCELERATION,
    BIAS,
    DIRECTION,
    MEAN_VELOCITY,
    SCALE,
    SCALE_ERROR,
    SPEED,
    STATES,
    VELOCITY,
    Covariance,
    MotionBias,
    PerState,
    add_bias_process_noise,
    tracks_scale,
)
from gyro_drift_filter.core.matrices import Matrix, vector_length
from gyro_drift_filter.core.rest.noise import random_walk_of
from gyro_drift_filter.core.rest.records import Rest, RestLengths
from gyro_drift_filter.gravity import GRAVITY

# A velocity is another one after SPEED_SECONDS; above `SPEED` it lasts longer in proportion, as a
# car accelerates no more than a hand. A higher speed, and the mean velocity, are remembered for
# SPEED_MEMORY s, or for MEMORY_VELOCITIES times as long as a velocity lasts where that is longer.
# The deviation is the largest velocity over SPEED_DEVIATIONS, as a swing or a constant velocity
# goes no further. A deviation of LARGEST_SPEED (m/s) is beyond robots on the road and in the air:
# there a tilt has been taken for speed, so that the direction is looked for anew.
SPEED_SECONDS, SPEED_MEMORY, MEMORY_VELOCITIES = 2.1, 120.0, 10.0
SPEED_DEVIATIONS, LARGEST_SPEED = 1.4, 50.0
# Random walks of direction and velocity, per square root of a second: of what is in no model. That
# of the noise at rest comes on top, and that of vibration. A motor's may be aliased to rates and
# accelerations that are as slow as motion: those of the simulated drones, at up to 200 Hz, are
# noise with the spectral density of the vibration's variance over 0.3 s.
DIRECTION_WALK, VELOCITY_WALK, VIBRATION_SECONDS = 1e-3, 0.05, 0.3
# What a turn leaves beside a constant error of scale, as a share of it. Data sheets have gyroscopes
# linear within 0.1 to 0.2 %.
NONLINEARITY = 0.002
# With a wide prior a bias would be taken for speed, so the velocity stays within `SPEED`, and the
# speed that shows is only noted, as a mean over WIDE_SPEED_MEMORY s, and so are the innovations
# over INNOVATION_MEMORY s.
WIDE_SPEED_MEMORY, INNOVATION_MEMORY = 30.0, 10.0


class MotionWorkspace(TypedDict):
    """What is needed within one sample."""

    transition: Covariance
    product: Covariance
    gain: PerState
    turn: Matrix
    turn_product: Matrix
    rate: PerAxis  # rad/s, of the sample or, where that is an outlier, of the filter
    sound: bool  # the sample is no outlier on any axis, so that its acceleration is believed
    fastest: float  # rad/s, largest rate of the sample
    unmeasured_turn: float  # rad, that the body may have turned by unmeasured up to the sample
    unmeasured_seconds: float  # s, for which it did


MOTION_WORKSPACE = record(MotionWorkspace)


@kernel
def predict_covariance(
    state: MotionBias, workspace: MotionWorkspace, rest: Rest, lengths: RestLengths
) -> None:
    """Carry the covariance over the block, (8)."""
    forward, product = workspace['transition'], workspace['product']
    covariance = state['covariance']
    mean_left = math.exp(-state['block_seconds'] / _memory_seconds(state))
    _fill_transition(state, forward, mean_left)
    for axis in range(3):
        state['state_vector'][MEAN_VELOCITY + axis] *= mean_left
    for i in range(STATES):
        for k in range(STATES):
            product[i, k] = 0.0
        for m in range(STATES):
            factor = forward[i, m]
            if factor != 0.0:
                for k in range(STATES):
                    product[i, k] += factor * covariance[m, k]
    for i in range(STATES):
        for k in range(min(i + 1, BIAS)):
            total = 0.0
            for m in range(STATES):
                total += product[i, m] * forward[k, m]
            covariance[i, k] = covariance[k, i] = total
        # From the biases on, no state depends on another one.
        for k in range(BIAS, i + 1):
            covariance[i, k] = covariance[k, i] = product[i, k] * forward[k, k]
    _add_process_noise(state, mean_left, rest, lengths)
    add_bias_process_noise(state)


@kernel
def _fill_transition(state: MotionBias, forward: Covariance, mean_left: float) -> None:
    """Fill in the transition over the block; `mean_left` is of the mean velocity."""
    vector, turn, integral = state['state_vector'], state['turn'], state['turn_integral']
    seconds = state['block_seconds']
    left = velocity_left(state, seconds)
    for i in range(STATES):
        for k in range(STATES):
            forward[i, k] = 1.0 if i == k else 0.0
    for i in range(3):
        for k in range(3):
            along = _cross(vector, DIRECTION, integral, i, k)
            by_bias = 0.5 * GRAVITY * seconds * along - _cross(vector, VELOCITY, integral, i, k)
            forward[i, k] = turn[i, k]
            forward[i, BIAS + k] = -along
            forward[VELOCITY + i, k] = -GRAVITY * seconds * turn[i, k]
            forward[VELOCITY + i, VELOCITY + k] = left * turn[i, k]
            forward[VELOCITY + i, BIAS + k] = by_bias
            forward[VELOCITY + i, ACCELERATION + k] = -integral[i, k]
            for other in range(3):
                scale = SCALE + 3 * k + other
                rate = state['block_angle'][other] / seconds - vector[BIAS + other]
                forward[i, scale] = -along * rate
                forward[VELOCITY + i, scale] = by_bias * rate
        forward[VELOCITY + i, MEAN_VELOCITY + i] = 1.0 - left
        forward[MEAN_VELOCITY + i, MEAN_VELOCITY + i] = mean_left


@kernel
def _cross(vector: PerState, first: int, matrix: Matrix, i: int, k: int) -> float:
    """Return an element of [v]x M for the vector v that begins at `first`."""
    after, behind = (i + 1) % 3, (i + 2) % 3
    return float(
        vector[first + after] * matrix[behind, k] - vector[first + behind] * matrix[after, k]
    )


@kernel
def _add_process_noise(
    state: MotionBias, mean_left: float, rest: Rest, lengths: RestLengths
) -> None:
    """Add to the covariance what the block makes uncertain of direction and velocities."""
    covariance, turn = state['covariance'], state['turn']
    mean, seconds = expected_speed(state), state['block_seconds']
    # 2 (1 - cos(angle)), about the square of the angle that the body has turned by
    angle_square = 3.0 - turn[0, 0] - turn[1, 1] - turn[2, 2]
    share = NONLINEARITY if tracks_scale(state) else SCALE_ERROR
    calmest = state['vibration']['calmest']
    turned = VIBRATION_SECONDS * (calmest[0] + calmest[1] + calmest[2]) / 3.0
    pushed = VIBRATION_SECONDS * (calmest[3] + calmest[4] + calmest[5]) / 3.0
    for axis in range(3):
        walk = DIRECTION_WALK * DIRECTION_WALK + random_walk_of(rest, axis, lengths) + turned
        covariance[axis, axis] += walk * seconds
        covariance[axis, axis] += share * share * angle_square
        i = VELOCITY + axis
        covariance[i, i] += (VELOCITY_WALK * VELOCITY_WALK + pushed) * seconds
        i = MEAN_VELOCITY + axis
        covariance[i, i] += mean * mean * (1.0 - mean_left * mean_left)


@kernel
def expect_mean_velocity(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Measure that the velocity is the mean one, within what it has been of late."""
    vector, covariance = state['state_vector'], state['covariance']
    seconds = state['block_seconds']
    if state['wide']:
        _note_wide_speed(state, seconds)
    else:
        _note_speed(state, seconds)
    deviation = expected_speed(state)
    # A velocity that lasts is measured once in its time.
    variance = deviation * deviation * 2.0 * _speed_seconds(state) / seconds
    for axis in range(3):
        i, mean = VELOCITY + axis, MEAN_VELOCITY + axis
        innovation_variance = (
            covariance[i, i] - 2.0 * covariance[i, mean] + covariance[mean, mean] + variance
        )
        for k in range(STATES):
            workspace['gain'][k] = (covariance[k, i] - covariance[k, mean]) / innovation_variance
        innovation = vector[mean] - vector[i]
        if state['wide']:
            square = innovation * innovation / innovation_variance - state['innovation_square']
            state['innovation_square'] += seconds / INNOVATION_MEMORY * square / 3.0
        _correct(state, workspace, innovation, innovation_variance)


@kernel
def _note_speed(state: MotionBias, seconds: float) -> None:
    """Note how fast the body has been of late, at the end of so many s of motion."""
    deviation = max((1.0 - seconds / _memory_seconds(state)) * state['speed_deviation'], SPEED)
    for axis in range(3):
        i = VELOCITY + axis
        # What the velocity itself is uncertain by shows nothing.
        square = state['state_vector'][i] * state['state_vector'][i] - state['covariance'][i, i]
        deviation = max(deviation, math.sqrt(max(square, 0.0)) / SPEED_DEVIATIONS)
    state['speed_deviation'] = deviation


@kernel
def _note_wide_speed(state: MotionBias, seconds: float) -> None:
    """Note how fast the body has been on the mean, beside what is expected of it."""
    mean, square = 0.0, SPEED * SPEED
    for axis in range(3):
        i = VELOCITY + axis
        velocity, variance = state['state_vector'][i], state['covariance'][i, i]
        mean += velocity * velocity * square / (variance + square) / 3.0
    share = seconds / WIDE_SPEED_MEMORY
    before = state['speed_deviation'] * state['speed_deviation']
    state['speed_deviation'] = math.sqrt(before + share * (mean - before))


@kernel
def normalise_direction(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Make the direction one of length one, which nothing is uncertain along.

    Measured, the length would move the bias: a correction tilts the direction along a tangent, and
    what it is longer by then says nothing of the bias.
    """
    vector, covariance, along = state['state_vector'], state['covariance'], workspace['gain']
    x, y, z = vector[DIRECTION], vector[DIRECTION + 1], vector[DIRECTION + 2]
    length = vector_length(x, y, z)
    x, y, z = x / length, y / length, z / length
    vector[DIRECTION], vector[DIRECTION + 1], vector[DIRECTION + 2] = x, y, z
    for k in range(STATES):
        along[k] = covariance[0, k] * x + covariance[1, k] * y + covariance[2, k] * z
    total = along[0] * x + along[1] * y + along[2] * z
    for i in range(3):
        part = vector[DIRECTION + i]
        for k in range(i + 1):
            removed = part * along[k] + (along[i] - total * part) * vector[DIRECTION + k]
            covariance[i, k] -= removed
            covariance[k, i] = covariance[i, k]
        for k in range(3, STATES):
            covariance[i, k] -= part * along[k]
            covariance[k, i] = covariance[i, k]


@kernel
def _correct(
    state: MotionBias, workspace: MotionWorkspace, innovation: float, innovation_variance: float
) -> None:
    """Correct state and covariance by an innovation, (11) and (12); the gain is there."""
    vector, covariance, gain = state['state_vector'], state['covariance'], workspace['gain']
    bias_at_rest = state['bias_at_rest']
    for i in range(STATES):
        vector[i] += gain[i] * innovation
    for axis in range(3):
        i = BIAS + axis
        removed = gain[i] * gain[i] * innovation_variance / covariance[i, i]
        # The bias at rest follows by what is common to both.
        weight = bias_at_rest['cross_covariance'][axis] / covariance[i, i]
        bias_at_rest['bias'][axis] += weight * gain[i] * innovation
        bias_at_rest['variance'][axis] -= weight * bias_at_rest['cross_covariance'][axis] * removed
        bias_at_rest['cross_covariance'][axis] *= 1.0 - removed
    for i in range(STATES):
        weighted = gain[i] * innovation_variance
        for k in range(STATES):
            covariance[i, k] -= weighted * gain[k]


@kernel
def _speed_seconds(state: MotionBias) -> float:
    """Return for how long a velocity lasts, in s."""
    return SPEED_SECONDS * expected_speed(state) / SPEED


@kernel
def velocity_left(state: MotionBias, seconds: float) -> float:
    """Return what share of a velocity is left after so many s."""
    if tracks_scale(state):
        return 1.0
    return math.exp(-seconds / _speed_seconds(state))  # else a bias would be taken for speed


@kernel
def _memory_seconds(state: MotionBias) -> float:
    """Return for how long a higher speed, and the mean velocity, are remembered, in s."""
    return max(SPEED_MEMORY, MEMORY_VELOCITIES * _speed_seconds(state))


@kernel
def expected_speed(state: MotionBias) -> float:
    """Return the deviation of the velocity, in m/s."""
    return SPEED if state['wide'] else float(state['speed_deviation'])
