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

"""The bias of a robot that has moved since power-on: gravity alone shows a part of it.

`in_motion.py` corrects a bias of which something is known. Here nothing is, so that the same filter
runs a second time with a wide prior: all of the turn-on deviation. What it finds misleads where the
body is faster than a hand, as an acceleration that lasts looks like a tilt. About the vertical it
finds nothing, and a body that leans by some degrees shows hardly more. So what it finds counts

- across the vertical of the body, as it was on the mean of the motion, unless it leans far;
- after so much motion that accelerations have come and gone;
- where it is far enough from what is subtracted: by more, the faster the body is, and the more it
  turns one way;
- without a memory, while rates and accelerations are those of one motion (`contradiction.py`).

A bias of an earlier run may have moved since. So the filter runs beside it, too, but what it finds
counts only where rates and accelerations contradict each other, and once: if they go on to do so,
it was not the bias.
"""

import math

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.contradiction import (
    LEAST_MOTION,
    note_contradiction_without_bias,
)
from gyro_drift_filter.core.bias.in_motion import (
    LARGEST_GRAVITY_SHARE,
    LEAST_GRAVITY_SHARE,
    MOTION_BLOCK_SECONDS,
)
from gyro_drift_filter.core.bias.motion_state import BIAS, DIRECTION, SPEED, MotionBias
from gyro_drift_filter.core.bias.records import (
    Bias,
    forget_contradiction,
    is_remembered,
    take_process_noise_in,
)
from gyro_drift_filter.core.bias.shared import start_motion_bias
from gyro_drift_filter.core.bias.shift import forget_shift
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.matrices import vector_length
from gyro_drift_filter.gravity import GRAVITY

# The gates in standard deviations: the second one once a first correction, also along one axis
# alone, has shown that the assumed bias is wrong.
FIRST_GATE, NEXT_GATE = 3.0, 1.0
# The error is the filter's own standard deviation, and so many where the velocity that shows is
# `SPEED`, in proportion to it: it decays in the filter, so that hardly more than half of it shows.
ERROR_SHARE = 2.0
# Who speeds up and brakes, and turns one way on the mean, has accelerations that look like a tilt
# which lasts, by so much in rad: the rate that keeps it there is taken for a bias.
LASTING_TILT = 0.05
# The vertical is the mean direction of gravity over so many s of motion. It is that much shorter
# than one where the body leans to all sides: by 26 degrees on the mean, about which gravity shows
# the bias about the vertical, too.
VERTICAL_MEMORY, LEANING = 120.0, 0.9
Vector = tuple[float, float, float]


@kernel
def correct_unknown_bias(state: Bias, bias_max: float) -> None:
    """Take the part of the bias that gravity has shown, where it is not the one subtracted.

    On no axis beyond `bias_max`, in rad/s.
    """
    wide_prior = state['wide_prior']
    # Once for each block of motion, as it has ended.
    if not wide_prior['moving'] or wide_prior['samples'] > 0 or wide_prior['block_seconds'] > 0.0:
        return
    seconds = min(wide_prior['moving_seconds'], VERTICAL_MEMORY)
    share = MOTION_BLOCK_SECONDS / max(seconds, MOTION_BLOCK_SECONDS)
    for axis in range(3):
        step = wide_prior['state_vector'][DIRECTION + axis] - state['vertical'][axis]
        state['vertical'][axis] += share * step
    remembered = is_remembered(state)
    if remembered:
        if not state['contradicts'] or state['corrected'] > 0 or state['restored']:
            return
    else:
        note_contradiction_without_bias(state)
        if state['contradicts']:
            return
    x, y, z = state['vertical'][0], state['vertical'][1], state['vertical'][2]
    length = vector_length(x, y, z)
    if wide_prior['moving_seconds'] < LEAST_MOTION or length == 0.0:
        return
    # At rest, too, it is more than a bias can be; or the driver takes gravity off.
    if state['segments_beyond_max'] > 0 or not _is_carried(wide_prior):
        return
    up = (x / length, y / length, z / length)
    first, second = _across(up)
    # The axes of the ellipse that the covariance is across the vertical.
    along, both, across = (
        _covariance(wide_prior, first, first),
        _covariance(wide_prior, first, second),
        _covariance(wide_prior, second, second),
    )
    angle = 0.5 * math.atan2(2.0 * both, along - across)
    sine, cosine = math.sin(angle), math.cos(angle)
    axes = _combine(cosine, first, sine, second), _combine(-sine, first, cosine, second), up
    leans = length < LEANING
    if _correct(state, axes, leans, bias_max):
        state['corrected'] += 1
        _correct(state, axes, leans, bias_max)
        if remembered:
            forget_contradiction(state)
            forget_shift(state['motion'])
        _start_anew(state, (0.0, 0.0, 0.0) if leans else up)


@kernel
def _is_carried(state: MotionBias) -> bool:
    """Return whether it is gravity, on the mean, what the acceleration has along the vertical."""
    carried = state['carried'] / (GRAVITY * state['moving_seconds'])
    return bool(LEAST_GRAVITY_SHARE < carried < LARGEST_GRAVITY_SHARE)


@kernel
def _across(up: Vector) -> tuple[Vector, Vector]:
    """Return two directions across one, and across each other."""
    x, y, z = up
    if abs(x) < 0.5:
        size = math.sqrt(y * y + z * z)
        first = (0.0, z / size, -y / size)
    else:
        size = math.sqrt(x * x + z * z)
        first = (-z / size, 0.0, x / size)
    second = (
        y * first[2] - z * first[1],
        z * first[0] - x * first[2],
        x * first[1] - y * first[0],
    )
    return first, second


@kernel
def _combine(a: float, first: Vector, b: float, second: Vector) -> Vector:
    return (
        a * first[0] + b * second[0],
        a * first[1] + b * second[1],
        a * first[2] + b * second[2],
    )


@kernel
def _covariance(state: MotionBias, first: Vector, second: Vector) -> float:
    """Return the covariance of the bias along two directions, in (rad/s)^2."""
    total = 0.0
    for i in range(3):
        for k in range(3):
            total += first[i] * state['covariance'][BIAS + i, BIAS + k] * second[k]
    return total


@kernel
def _error_variance(state: MotionBias, variance: float) -> float:
    """Return the variance of an error in (rad/s)^2, by what the filter takes it for."""
    share = max(ERROR_SHARE * state['speed_deviation'] / SPEED, 1.0)
    turning = LASTING_TILT * state['vertical_angle'] / state['moving_seconds']
    own = max(state['innovation_square'], 1.0) * variance
    return share * share * own + turning * turning


@kernel
def _correct(
    state: Bias, axes: tuple[Vector, Vector, Vector], leans: bool, bias_max: float
) -> bool:
    """Take the bias along two axes, and where the body `leans` along its vertical, too."""
    changed = _correct_along(state, axes[0], bias_max)
    changed = _correct_along(state, axes[1], bias_max) or changed
    return (leans and _correct_along(state, axes[2], bias_max)) or changed


@kernel
def _correct_along(state: Bias, direction: Vector, bias_max: float) -> bool:
    """Take the bias along a direction, if it is not the one subtracted; return whether it is."""
    wide_prior, bias = state['wide_prior'], state['bias']
    distance = 0.0
    for axis in range(3):
        distance += direction[axis] * (wide_prior['state_vector'][BIAS + axis] - bias[axis])
    gate = FIRST_GATE if state['corrected'] == 0 else NEXT_GATE
    variance = _error_variance(wide_prior, _covariance(wide_prior, direction, direction))
    if not is_beyond_gate(distance, gate, variance):
        return False
    for axis in range(3):
        if abs(bias[axis] + distance * direction[axis]) > bias_max:
            return False
    for axis in range(3):
        bias[axis] += distance * direction[axis]
    return True


@kernel
def _start_anew(state: Bias, unseen: Vector) -> None:
    """Follow the bias in motion from the corrected one, and by the direction that led to it.

    About the direction `unseen`, of length one or zero, it is as uncertain as before: each axis by
    its share of that direction, as the variances are those of axes.
    """
    motion, wide_prior = state['motion'], state['wide_prior']
    take_process_noise_in(state)
    for axis in range(3):
        variance = _error_variance(wide_prior, wide_prior['covariance'][BIAS + axis, BIAS + axis])
        variance += unseen[axis] * unseen[axis] * state['variance'][axis]
        state['variance'][axis] = min(state['variance'][axis], variance)
    start_motion_bias(motion, state['bias'], state['variance'])
    motion['speed_deviation'] = SPEED
    for axis in range(3):
        motion['state_vector'][DIRECTION + axis] = wide_prior['state_vector'][DIRECTION + axis]
    motion['directed'] = True
