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

"""The bias in motion, as gravity shows it.

Running motors move the bias (rectified vibration), so that of a flight is not that of the rest
before it. A Kalman filter in the body frame tracks it, with nothing but gravity to go by: its state
is the direction of gravity s (of length one, upwards), the velocity u, the bias b of the gyroscope
and that of the accelerometer a, both as measured, the mean velocity m, and the errors E (3, 3) of
the gyroscope's scale and alignment:

    s' = -v x s,        u' = -v x u + (f - a) - g s,        v = (1 - E) (w - b)

with the rates w and the accelerations f. Its one measurement is that no robot gets away: the
velocity is the mean one within `SPEED`, anew every `SPEED_SECONDS`, or within as much as it has
been of late, and anew as much later. A robot drives forward, which is one direction in its own
axes, and without m what presses outwards in its turns would be a tilt. The heading is not in the
state, so that nothing leaks into it: a bias about the vertical is left as it is.

An acceleration that lasts, as of a train, is told from a tilt by what the gyroscope knows. At the
end of a rest the accelerometer has shown the direction of gravity but for its own bias, with which
it is correlated, so that the two together explain no acceleration. From there on the direction is
as uncertain as the rates leave it, and what a tilt of that size does not explain is speed.

State and measurement are taken every hundredth of a second or so, covariances every
`MOTION_BLOCK_SECONDS` by the transition over the block. As directions turn with the body,
R = exp(-[angle]) of each value, it needs their product T over the block and the integral M of what
is left of it to the end:

    ds = T ds0 - [s]x M db
    du = l T du0 - g t T ds0 + (g t [s]x M / 2 - [u]x M) db - M da + (1 - l) dm

where l is what is left of a velocity after the time t of the block: all of it once a bias is known.
Until then it decays, as the bias would be taken for speed. An error of E counts as one of the bias,
in proportion to the mean of w - b over the block. It tilts what turns one way, and leaves what
turns to and fro; as noise of each turn it would hide the bias of a hand. What is subtracted is b
alone: the rates keep their scale.

With a wide prior, for a bias of which nothing is known, it runs a second time (`without_rest.py`).
What it shares with the bias at rest, of which each rest is a measurement, is in `shared.py`.
"""

import math
from typing import TypedDict

import numpy as np

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.bias.shared import (
    ACCELERATION,
    BIAS,
    DIRECTION,
    MEAN_VELOCITY,
    SCALE,
    SCALE_ERROR,
    SPEED,
    STATES,
    UNKNOWN_SECONDS,
    VELOCITY,
    Covariance,
    MotionBias,
    PerState,
    add_bias_process_noise,
    limit_prior,
    tracks_scale,
    widen_shift,
)
from gyro_drift_filter.core.bias.vibration import interrupt_vibration, note_vibration
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.matrices import Matrix, multiply, rotation_terms, vector_length
from gyro_drift_filter.core.rest.noise import random_walk_of
from gyro_drift_filter.core.rest.records import Rest, RestLengths
from gyro_drift_filter.core.rest.stationarity import MEAN_DEVIATIONS
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, Sample
from gyro_drift_filter.gravity import GRAVITY

# A mean acceleration between these shares of it is gravity: else there is no accelerometer, or it
# is in other units.
LEAST_GRAVITY_SHARE, LARGEST_GRAVITY_SHARE = 0.7, 1.3
MOTION_BLOCK_SECONDS = 0.4
# The largest time without samples over which the body's turn is known well enough, in s.
LONGEST_GAP = 0.05

# A velocity is another one after SPEED_SECONDS; above `SPEED` it lasts longer in proportion, as a
# car accelerates no more than a hand. A higher speed, and the mean velocity, are remembered for
# SPEED_MEMORY s, or for MEMORY_VELOCITIES times as long as a velocity lasts where that is longer.
# The deviation is the largest velocity over SPEED_DEVIATIONS, as a swing or a constant velocity
# goes no further. A deviation of LARGEST_SPEED (m/s) is beyond robots on the road and in the air:
# there a tilt has been taken for speed, so that the direction is looked for anew.
SPEED_SECONDS, SPEED_MEMORY, MEMORY_VELOCITIES = 2.1, 120.0, 10.0
SPEED_DEVIATIONS, LARGEST_SPEED = 1.4, 50.0
# Standard deviations at the start: of the direction, the velocity in m/s and the accelerometer's
# bias in m/s^2; the second direction is that of a rest, beside what the bias makes of it.
START_DIRECTION, REST_DIRECTION, START_SPEED, ACCELERATION_BIAS = 0.3, 0.003, 1.0, 0.1
# Random walks of direction and velocity, per square root of a second: of what is in no model. That
# of the noise at rest comes on top, and that of vibration. A motor's may be aliased to rates and
# accelerations that are as slow as motion: those of the simulated drones, at up to 200 Hz, are
# noise with the spectral density of the vibration's variance over a quarter of a second.
DIRECTION_WALK, VELOCITY_WALK, VIBRATION_SECONDS = 1e-3, 0.05, 0.3
# What a turn leaves beside a constant error of scale, as a share of it. Data sheets have gyroscopes
# linear within 0.1 to 0.2 %.
NONLINEARITY = 0.002
LENGTH_VARIANCE = 1e-6  # of the direction's length, which is one
# With a wide prior a bias would be taken for speed, so the velocity stays within `SPEED`, and the
# speed that shows is only noted, as a mean over WIDE_SPEED_MEMORY s. A body that walks and turns
# has an acceleration that is constant in its own axes, like an accelerometer's bias: the deviation
# in m/s^2, of 0.7 m/s at 0.7 rad/s.
WIDE_SPEED_MEMORY, WIDE_ACCELERATION_BIAS = 30.0, 0.5
# The first direction is that of the mean acceleration over so many s; that of a rest has a wider
# deviation, and goes with nothing.
WIDE_DIRECTION_SECONDS, WIDE_REST_DIRECTION = 1.0, 0.03
# At rest the direction follows the accelerometer with this time constant, in s.
REST_SECONDS = 1.0


class MotionWorkspace(TypedDict):
    """What is needed within one sample."""

    transition: Covariance
    product: Covariance
    gain: PerState
    turn: Matrix
    turn_product: Matrix
    rate: PerAxis  # rad/s, of the sample or, where that is an outlier, of the filter
    sound: bool  # the sample is no outlier on any axis, so that its acceleration is believed


MOTION_WORKSPACE = record(MotionWorkspace)


@kernel
def take_direction(state: MotionBias, x: float, y: float, z: float, seconds: float) -> None:
    """Take an acceleration in m/s^2, summed up over `seconds`, for gravity, if it can be that."""
    size = vector_length(x, y, z)
    if LEAST_GRAVITY_SHARE * GRAVITY * seconds < size < LARGEST_GRAVITY_SHARE * GRAVITY * seconds:
        vector = state['state_vector']
        vector[DIRECTION] = x / size
        vector[DIRECTION + 1] = y / size
        vector[DIRECTION + 2] = z / size
        state['directed'] = True


@kernel
def lose_direction(state: MotionBias) -> None:
    """Forget how the body lies: time has jumped, or it has turned by nobody knows what."""
    state['directed'] = state['moving'] = False
    state['missed_turn'] = 0.0
    interrupt_vibration(state['vibration'])
    _forget_accelerations(state)
    _start_value(state)


@kernel
def miss_turn(state: MotionBias, angle: float) -> None:
    """Note that the body may have turned further by an angle in rad: a rate is at its limit."""
    missed = state['missed_turn']
    if missed + angle > START_DIRECTION:
        lose_direction(state)
    elif angle > 0.0:
        state['missed_turn'] = missed + angle
    else:
        for axis in range(3):
            state['covariance'][DIRECTION + axis, DIRECTION + axis] += missed * missed
        state['missed_turn'] = 0.0


@kernel
def track_motion(
    state: MotionBias,
    workspace: MotionWorkspace,
    sample: Sample,
    seconds: float,
    rest: Rest,
    lengths: RestLengths,
) -> None:
    """Take the rate of the workspace and the acceleration of a sample in, which last `seconds`."""
    rate, acceleration = workspace['rate'], sample['linear_acceleration']
    # Where the direction is not known, nothing stands in for gravity.
    known = seconds <= LONGEST_GAP and (workspace['sound'] or state['directed'])
    for axis in range(3):
        force = acceleration[axis]
        if not workspace['sound']:
            force = GRAVITY * state['state_vector'][DIRECTION + axis]
        state['angle'][axis] += rate[axis] * seconds
        state['speed'][axis] += force * seconds
        known = known and abs(rate[axis]) < np.inf and abs(force) <= LARGEST_ACCELERATION
    state['seconds'] += seconds
    state['samples'] += 1
    if not known:
        lose_direction(state)
    elif state['samples'] >= lengths['value']:
        _take_value(state, workspace, rest, lengths)
        _start_value(state)


@kernel
def _start_value(state: MotionBias) -> None:
    state['samples'] = 0
    state['seconds'] = 0.0
    for axis in range(3):
        state['angle'][axis] = state['speed'][axis] = 0.0


@kernel
def _take_value(
    state: MotionBias, workspace: MotionWorkspace, rest: Rest, lengths: RestLengths
) -> None:
    """Take in the value that is complete."""
    seconds, speed = state['seconds'], state['speed']
    if not state['directed']:
        _look_for_direction(state, workspace)
        return
    _turn_by_value(state, workspace)
    if rest['at_rest']:
        state['moving'] = False
        interrupt_vibration(state['vibration'])
        _follow_accelerometer(state, rest)
        return
    if not state['wide'] and note_vibration(state['vibration'], state['angle'], speed, seconds):
        widen_shift(state)
    if not state['moving']:
        _start_motion(state, True)
        return
    _turn_block(state, workspace)
    _take_acceleration(state)
    state['block_seconds'] += seconds
    if state['block_seconds'] >= MOTION_BLOCK_SECONDS:
        _end_block(state, workspace, rest, lengths)
        _start_block(state)


@kernel
def _follow_accelerometer(state: MotionBias, rest: Rest) -> None:
    """Let the direction follow the acceleration of the value, as at rest that is gravity.

    What noise does not reach is none: a spike, or the motion that is about to end the rest.
    """
    vector, speed, seconds = state['state_vector'], state['speed'], state['seconds']
    for axis in range(3):
        if rest['force']['late'] > 0:
            break  # rest sees nothing of it
        signal = rest['signals'][3 + axis]
        distance = speed[axis] / seconds - signal['waiting_mean']
        spread = signal['variance'] + signal['scatter']
        if is_beyond_gate(distance, MEAN_DEVIATIONS, spread):
            return
    size = vector_length(speed[0], speed[1], speed[2])
    if size > 0.0:
        for axis in range(3):
            step = speed[axis] / size - vector[DIRECTION + axis]
            vector[DIRECTION + axis] += min(seconds / REST_SECONDS, 1.0) * step


@kernel
def _take_acceleration(state: MotionBias) -> None:
    """Take the acceleration of the value into the velocity, and note what of it is vertical."""
    vector, seconds, speed = state['state_vector'], state['seconds'], state['speed']
    left = _velocity_left(state, seconds)
    for axis in range(3):
        state['vertical_angle'] += state['angle'][axis] * vector[DIRECTION + axis]
        state['carried'] += speed[axis] * vector[DIRECTION + axis]
        i = VELOCITY + axis
        gained = speed[axis] - vector[ACCELERATION + axis] * seconds
        gained -= GRAVITY * vector[DIRECTION + axis] * seconds
        mean = vector[MEAN_VELOCITY + axis]
        vector[i] = mean + (vector[i] + gained - mean) * left


@kernel
def _end_block(
    state: MotionBias, workspace: MotionWorkspace, rest: Rest, lengths: RestLengths
) -> None:
    """Carry the covariance over the block, and measure at its end."""
    before = state['moving_seconds']
    state['moving_seconds'] += state['block_seconds']
    if before < UNKNOWN_SECONDS <= state['moving_seconds']:
        limit_prior(state)
    _predict_covariance(state, workspace, rest, lengths)
    _expect_mean_velocity(state, workspace)
    _expect_length(state, workspace)
    if not state['wide'] and state['speed_deviation'] > LARGEST_SPEED:
        state['speed_deviation'] = SPEED
        lose_direction(state)


@kernel
def _look_for_direction(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Take the acceleration of the value for gravity, or with a wide prior a mean of many.

    There a direction that is wrong by a blow would be explained by a bias.
    """
    vector, speed, seconds = state['state_vector'], state['speed'], state['seconds']
    if not state['wide']:
        take_direction(state, speed[0], speed[1], speed[2], seconds)
    else:
        _turn_by_value(state, workspace)
        for axis in range(3):
            vector[VELOCITY + axis] += speed[axis]
        state['block_seconds'] += seconds
        if state['block_seconds'] < WIDE_DIRECTION_SECONDS:
            return
        x, y, z = vector[VELOCITY], vector[VELOCITY + 1], vector[VELOCITY + 2]
        take_direction(state, x, y, z, state['block_seconds'])
        _forget_accelerations(state)
    if state['directed']:
        _start_motion(state, False)


@kernel
def _forget_accelerations(state: MotionBias) -> None:
    state['block_seconds'] = 0.0
    for axis in range(3):
        state['state_vector'][VELOCITY + axis] = 0.0


@kernel
def _start_motion(state: MotionBias, rested: bool) -> None:
    """Begin to track, with the direction of a rest or of any one acceleration.

    The deviation of the bias is kept.
    """
    vector, covariance = state['state_vector'], state['covariance']
    direction = START_DIRECTION
    if rested:
        direction = WIDE_REST_DIRECTION if state['wide'] else REST_DIRECTION
    own = WIDE_ACCELERATION_BIAS if state['wide'] else ACCELERATION_BIAS
    deviations = direction, START_SPEED, 0.0, own, _expected_speed(state)
    for part in range(5):
        if 3 * part == BIAS:
            continue
        for axis in range(3):
            i = 3 * part + axis
            for k in range(STATES):
                covariance[i, k] = covariance[k, i] = 0.0
            covariance[i, i] = deviations[part] * deviations[part]
            if part != 0:
                vector[i] = 0.0
    if rested and not state['wide']:
        _doubt_direction(state, own * own)
    state['moving'] = True
    limit_prior(state)
    _start_block(state)


@kernel
def _doubt_direction(state: MotionBias, variance: float) -> None:
    """Let a direction at rest be wrong by what the accelerometer's bias has across it.

    `variance` is that of this bias, in (m/s^2)^2: the two make up for each other.
    """
    vector, covariance = state['state_vector'], state['covariance']
    for i in range(3):
        for k in range(3):
            across = (1.0 if i == k else 0.0) - vector[DIRECTION + i] * vector[DIRECTION + k]
            common = variance / GRAVITY * across
            covariance[i, k] += common / GRAVITY
            covariance[i, ACCELERATION + k] = covariance[ACCELERATION + k, i] = -common


@kernel
def _start_block(state: MotionBias) -> None:
    state['block_seconds'] = 0.0
    for i in range(3):
        state['block_angle'][i] = 0.0
        for k in range(3):
            state['turn'][i, k] = 1.0 if i == k else 0.0
            state['turn_integral'][i, k] = 0.0


@kernel
def _turn_by_value(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Turn what is in the body frame against the body (Rodrigues)."""
    vector, seconds, turn = state['state_vector'], state['seconds'], workspace['turn']
    a = state['angle'][0] - vector[BIAS] * seconds
    b = state['angle'][1] - vector[BIAS + 1] * seconds
    c = state['angle'][2] - vector[BIAS + 2] * seconds
    x = a - vector[SCALE] * a - vector[SCALE + 1] * b - vector[SCALE + 2] * c
    y = b - vector[SCALE + 3] * a - vector[SCALE + 4] * b - vector[SCALE + 5] * c
    z = c - vector[SCALE + 6] * a - vector[SCALE + 7] * b - vector[SCALE + 8] * c
    square = x * x + y * y + z * z
    across, within = rotation_terms(square)
    turn[0, 0] = 1.0 - within * (square - x * x)
    turn[1, 1] = 1.0 - within * (square - y * y)
    turn[2, 2] = 1.0 - within * (square - z * z)
    turn[0, 1], turn[1, 0] = within * x * y + across * z, within * x * y - across * z
    turn[0, 2], turn[2, 0] = within * x * z - across * y, within * x * z + across * y
    turn[1, 2], turn[2, 1] = within * y * z + across * x, within * y * z - across * x
    _turn_vector(turn, vector, DIRECTION)
    _turn_vector(turn, vector, VELOCITY)


@kernel
def _turn_block(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Take the turn of the value into T and M of the block."""
    turn, product = workspace['turn'], workspace['turn_product']
    _turn_matrix(turn, state['turn'], product)
    _turn_matrix(turn, state['turn_integral'], product)
    for axis in range(3):
        state['turn_integral'][axis, axis] += state['seconds']
        state['block_angle'][axis] += state['angle'][axis]


@kernel
def _turn_vector(turn: Matrix, vector: PerState, first: int) -> None:
    x, y, z = vector[first], vector[first + 1], vector[first + 2]
    for i in range(3):
        vector[first + i] = turn[i, 0] * x + turn[i, 1] * y + turn[i, 2] * z


@kernel
def _turn_matrix(turn: Matrix, matrix: Matrix, product: Matrix) -> None:
    multiply(turn, matrix, product)
    for i in range(3):
        for k in range(3):
            matrix[i, k] = product[i, k]


@kernel
def _cross(vector: PerState, first: int, matrix: Matrix, i: int, k: int) -> float:
    """Return an element of [v]x M for the vector v that begins at `first`."""
    after, behind = (i + 1) % 3, (i + 2) % 3
    return float(
        vector[first + after] * matrix[behind, k] - vector[first + behind] * matrix[after, k]
    )


@kernel
def _fill_transition(state: MotionBias, forward: Covariance, mean_left: float) -> None:
    """Fill in the transition over the block; `mean_left` is of the mean velocity."""
    vector, turn, integral = state['state_vector'], state['turn'], state['turn_integral']
    seconds = state['block_seconds']
    left = _velocity_left(state, seconds)
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
def _predict_covariance(
    state: MotionBias, workspace: MotionWorkspace, rest: Rest, lengths: RestLengths
) -> None:
    """Carry the covariance over the block, (8)."""
    forward, product, covariance = (
        workspace['transition'],
        workspace['product'],
        state['covariance'],
    )
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
def _add_process_noise(
    state: MotionBias, mean_left: float, rest: Rest, lengths: RestLengths
) -> None:
    """Add to the covariance what the block makes uncertain of direction and velocities."""
    covariance, turn = state['covariance'], state['turn']
    mean, seconds = _expected_speed(state), state['block_seconds']
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
def _speed_seconds(state: MotionBias) -> float:
    """Return for how long a velocity lasts, in s."""
    return SPEED_SECONDS * _expected_speed(state) / SPEED


@kernel
def _velocity_left(state: MotionBias, seconds: float) -> float:
    """Return what share of a velocity is left after so many s."""
    if tracks_scale(state):
        return 1.0
    return math.exp(-seconds / _speed_seconds(state))  # else a bias would be taken for speed


@kernel
def _memory_seconds(state: MotionBias) -> float:
    """Return for how long a higher speed, and the mean velocity, are remembered, in s."""
    return max(SPEED_MEMORY, MEMORY_VELOCITIES * _speed_seconds(state))


@kernel
def _expected_speed(state: MotionBias) -> float:
    """Return the deviation of the velocity, in m/s."""
    return SPEED if state['wide'] else float(state['speed_deviation'])


@kernel
def _expect_mean_velocity(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Measure that the velocity is the mean one, within what it has been of late."""
    vector, covariance = state['state_vector'], state['covariance']
    seconds = state['block_seconds']
    if state['wide']:
        _note_wide_speed(state, seconds)
    else:
        _note_speed(state, seconds)
    deviation = _expected_speed(state)
    # A velocity that lasts is measured once in its time.
    variance = deviation * deviation * 2.0 * _speed_seconds(state) / seconds
    for axis in range(3):
        i, mean = VELOCITY + axis, MEAN_VELOCITY + axis
        spread = covariance[i, i] - 2.0 * covariance[i, mean] + covariance[mean, mean] + variance
        for k in range(STATES):
            workspace['gain'][k] = (covariance[k, i] - covariance[k, mean]) / spread
        _correct(state, workspace, vector[mean] - vector[i], spread)


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
    share = seconds / min(state['moving_seconds'], WIDE_SPEED_MEMORY)
    before = state['speed_deviation'] * state['speed_deviation']
    state['speed_deviation'] = math.sqrt(before + share * (mean - before))


@kernel
def _expect_length(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Measure that the direction is of length one."""
    vector, covariance, gain = state['state_vector'], state['covariance'], workspace['gain']
    x, y, z = vector[DIRECTION], vector[DIRECTION + 1], vector[DIRECTION + 2]
    length = vector_length(x, y, z)
    x, y, z = x / length, y / length, z / length
    for k in range(STATES):
        gain[k] = covariance[k, 0] * x + covariance[k, 1] * y + covariance[k, 2] * z
    spread = gain[0] * x + gain[1] * y + gain[2] * z + LENGTH_VARIANCE
    for k in range(STATES):
        gain[k] /= spread
    _correct(state, workspace, 1.0 - length, spread)


@kernel
def _correct(
    state: MotionBias, workspace: MotionWorkspace, innovation: float, spread: float
) -> None:
    """Correct state and covariance by an innovation, (11) and (12); the gain is there."""
    vector, covariance, gain = state['state_vector'], state['covariance'], workspace['gain']
    bias_at_rest = state['bias_at_rest']
    for i in range(STATES):
        vector[i] += gain[i] * innovation
    for axis in range(3):
        i = BIAS + axis
        removed = gain[i] * gain[i] * spread / covariance[i, i]
        # The bias at rest follows by what is common to both.
        weight = bias_at_rest['common'][axis] / covariance[i, i]
        bias_at_rest['bias'][axis] += weight * gain[i] * innovation
        bias_at_rest['variance'][axis] -= weight * bias_at_rest['common'][axis] * removed
        bias_at_rest['common'][axis] *= 1.0 - removed
    for i in range(STATES):
        weighted = gain[i] * spread
        for k in range(STATES):
            covariance[i, k] -= weighted * gain[k]
