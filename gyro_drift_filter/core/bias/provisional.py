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

"""A provisional bias in the first seconds, from what is steady though not still."""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.in_motion import take_direction
from gyro_drift_filter.core.bias.records import Bias, bias_variance
from gyro_drift_filter.core.bias.shared import limit_shift, start_motion_bias
from gyro_drift_filter.core.bias.slow_turn import GATE
from gyro_drift_filter.core.rest.records import Rest
from gyro_drift_filter.core.rest.segment import segment_mean, segment_scatter, value_variance

# Robots are switched on while they stand. In the first seconds a bias is taken from less than rest,
# as of a drone that idles, until the first rest replaces it. Such vibration moves the bias by some
# 1e-3 rad/s, and so does the start of the motors.
PROVISIONAL_SECONDS = 3.0
PROVISIONAL_BLOCKS = 23  # as many as that holds at 100 Hz: they take longer at low rates
PROVISIONAL_DEVIATION = 1.5e-3  # rad/s, besides that of the mean
LESS_STEADY = 9.0  # times the variance of its mean: not by chance
SIGNIFICANT = 2.0  # deviations from the initial bias: below, a rest in a second or two does better


@kernel
def take_provisional(state: Bias, block_seconds: float, largest: float) -> None:
    """Take the mean of the steady segment under way for the bias, until there is a rest."""
    rest = state['rest']
    seconds = max(PROVISIONAL_SECONDS, PROVISIONAL_BLOCKS * block_seconds)
    if state['segments'] > 0 or state['rest_seconds'] > seconds:
        return
    total = before = 0.0
    significant = state['provisional'][0] > 0.0 or state['known']
    for axis in range(3):
        mean = segment_mean(rest, axis)
        if abs(mean) > largest:
            return
        variance = _provisional_variance(rest, axis)
        distance = mean - state['bias'][axis]
        if state['known'] and distance * distance > GATE * GATE * (
            variance + bias_variance(state, axis)
        ):
            return  # it turns: the bias of the last run is another one
        significant = significant or distance * distance > SIGNIFICANT * SIGNIFICANT * variance
        total += variance
        before += bias_variance(state, axis)
    if total >= before or not significant:
        return
    for axis in range(3):
        state['bias'][axis] = segment_mean(rest, axis)
        state['provisional'][axis] = segment_scatter(rest, axis)
        state['variance'][axis] = _provisional_variance(rest, axis)
        limit_shift(state['motion'], axis, value_variance(rest, axis))
    start_motion_bias(state['motion'], state['bias'], state['variance'])
    # The direction of gravity has turned with the bias so far.
    take_direction(state['motion'], rest)
    state['known'] = False
    state['growth'] = 0.0
    state['reach'] = 0.0


@kernel
def _provisional_variance(rest: Rest, axis: int) -> float:
    """Return the variance in (rad/s)^2 of a bias that is the mean of the steady segment."""
    return segment_scatter(rest, axis) + PROVISIONAL_DEVIATION * PROVISIONAL_DEVIATION


@kernel
def is_far_from_provisional(state: Bias) -> bool:
    """Return whether the segment lies where the provisional bias, if there is one, can't be."""
    for axis in range(3):
        distance = segment_mean(state['rest'], axis) - state['bias'][axis]
        far = distance * distance > GATE * GATE * bias_variance(state, axis)
        if far and state['provisional'][axis] > 0.0:
            return True
    return False


@kernel
def is_less_steady(state: Bias) -> bool:
    """Return whether the segment is far less steady than that of the provisional bias was."""
    for axis in range(3):
        if segment_scatter(state['rest'], axis) > LESS_STEADY * state['provisional'][axis]:
            return True
    return False
