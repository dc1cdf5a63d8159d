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

State and turn are taken here with every value, which lasts a hundredth of a second or so.
`motion_filter.py` carries the covariance and measures, once in a block of `MOTION_BLOCK_SECONDS`.

With a wide prior, for a bias of which nothing is known, it runs a second time (`without_rest.py`).
What it shares with the bias at rest, of which each rest is a measurement, is in `shared.py`.
"""

import numpy as np

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.motion_filter import (
    LARGEST_SPEED,
    MotionWorkspace,
    expect_mean_velocity,
    expected_speed,
    normalise_direction,
    predict_covariance,
    velocity_left,
)
from gyro_drift_filter.core.bias.motion_state import (
    ACCELERATION,
    BIAS,
    DIRECTION,
    MEAN_VELOCITY,
    SCALE,
    SPEED,
    STATES,
    UNKNOWN_SECONDS,
    VELOCITY,
    MotionBias,
    PerState,
    tracks_scale,
)
from gyro_drift_filter.core.bias.shared import limit_prior
from gyro_drift_filter.core.bias.shift import widen_shift
from gyro_drift_filter.core.bias.vibration import interrupt_vibration, note_vibration
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.matrices import Matrix, multiply, rotation_terms, vector_length
from gyro_drift_filter.core.rest.records import Rest, RestLengths
from gyro_drift_filter.core.rest.stationarity import MEAN_DEVIATIONS
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, Sample
from gyro_drift_filter.gravity import GRAVITY

# A mean acceleration between these shares of it is gravity: else there is no accelerometer, or it
# is in other units.
LEAST_GRAVITY_SHARE, LARGEST_GRAVITY_SHARE = 0.7, 1.3
MOTION_BLOCK_SECONDS = 0.4
# Without rates for so long, in s, a body's turn is known well enough by those before and behind.
# Beyond that they say how far it may have turned, until half a swing of an arm has passed.
KNOWN_TURN_SECONDS, LONGEST_UNMEASURED = 0.05, 0.5
# Standard deviations at the start: of the direction, the velocity in m/s and the accelerometer's
# bias in m/s^2; the second direction is that of a rest, beside what the bias makes of it.
START_DIRECTION, REST_DIRECTION, START_SPEED, ACCELERATION_BIAS = 0.3, 0.003, 1.0, 0.1
# With a wide prior the first direction is that of the mean acceleration over so many s; that of a
# rest has a wider deviation, and goes with nothing.
WIDE_DIRECTION_SECONDS, WIDE_REST_DIRECTION = 1.0, 0.03
# A velocity beyond that of all robots is forgotten after so many s of motion without another one.
CONTRADICTION_SECONDS = 300.0
# At rest the direction follows the accelerometer with this time constant, in s.
REST_SECONDS = 1.0


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
    state['unmeasured_turn'] = state['unmeasured_seconds'] = 0.0
    interrupt_vibration(state['vibration'])
    _forget_accelerations(state)
    _start_value(state)


@kernel
def take_unmeasured_turn(state: MotionBias, workspace: MotionWorkspace) -> None:
    """Take in that the body may have turned further than the rates of the workspace have shown.

    How far it may have turned without rates, the first rate behind that time says as well.
    """
    state['unmeasured_turn'] += workspace['unmeasured_turn']
    state['unmeasured_seconds'] += workspace['unmeasured_seconds']
    seconds = state['unmeasured_seconds']
    missed = max(state['unmeasured_turn'], workspace['fastest'] * seconds)
    if missed > START_DIRECTION or seconds > LONGEST_UNMEASURED:
        lose_direction(state)
    elif workspace['unmeasured_turn'] == 0.0:
        for axis in range(3):
            state['covariance'][DIRECTION + axis, DIRECTION + axis] += missed * missed
        state['unmeasured_turn'] = state['unmeasured_seconds'] = 0.0


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
    known = seconds <= LONGEST_UNMEASURED and (workspace['sound'] or state['directed'])
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
    left = velocity_left(state, seconds)
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
    predict_covariance(state, workspace, rest, lengths)
    expect_mean_velocity(state, workspace)
    normalise_direction(state, workspace)
    if state['wide']:
        return
    state['sound_seconds'] += state['block_seconds']
    if state['sound_seconds'] > CONTRADICTION_SECONDS:
        state['contradictions'] = 0
    if state['speed_deviation'] > LARGEST_SPEED:
        state['speed_deviation'] = SPEED
        state['contradictions'] += tracks_scale(state)  # else a bias explains it
        state['sound_seconds'] = 0.0
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
    deviations = direction, START_SPEED, 0.0, ACCELERATION_BIAS, expected_speed(state)
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
        _doubt_direction(state, ACCELERATION_BIAS * ACCELERATION_BIAS)
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
            cross_covariance = variance / GRAVITY * across
            covariance[i, k] += cross_covariance / GRAVITY
            covariance[i, ACCELERATION + k] = covariance[ACCELERATION + k, i] = -cross_covariance


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
