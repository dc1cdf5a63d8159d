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

"""A provisional bias before there is a rest, from what is steady though not still.

Either from a few blocks of the first seconds, as of a drone that idles, or from all blocks since
the start, where gravity has stood for so long that no noise of the rates can be motion.
"""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.in_motion import take_direction
from gyro_drift_filter.core.bias.records import Bias, bias_variance, has_provisional
from gyro_drift_filter.core.bias.shared import start_motion_bias
from gyro_drift_filter.core.bias.shift import limit_shift
from gyro_drift_filter.core.bias.slow_turn import FASTEST_WARM_UP, GATE, give_up_bias
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.rest.noise import segment_variance
from gyro_drift_filter.core.rest.records import SEGMENT_BLOCKS, Rest
from gyro_drift_filter.core.rest.segment import (
    LEAST_VARIANCE,
    segment_mean,
    segment_scatter,
    value_variance,
)
from gyro_drift_filter.core.rest.standing import (
    LARGEST_TILT,
    LEAST_GRAVITY,
    is_noise,
    standing_mean,
    standing_scatter,
    variance_of_standing_mean,
)
from gyro_drift_filter.core.sample import is_zero

# Robots are switched on while they stand. In the first seconds a bias is taken from less than rest,
# as of a drone that idles, until the first rest replaces it. On seven flights of EuRoC such a bias
# was off by 0.8e-3 rad/s, root mean square, beside what its scatter explains.
PROVISIONAL_SECONDS = 3.0
PROVISIONAL_BLOCKS = 23  # as many as that holds at 100 Hz: they take longer at low rates
PROVISIONAL_DEVIATION = 0.8e-3  # rad/s, beside that of the mean
LESS_STEADY = 9.0  # times the variance of its mean: not by chance
# At 64 Hz and more a first rest takes so many s. Rates that were steady for as long, where blocks
# are longer, have shown the bias as well.
FIRST_REST_SECONDS = 2.0
# Where the driver subtracts the bias, zero is closer to it than the mean of a second. It is kept
# within so many deviations of that mean.
SIGNIFICANT = 2.0
# Gravity has to stand for so many s that a tilt too small to show is a small rate, and for so many
# blocks that these show how far they are correlated. It is not looked at in so many blocks: the
# first ones and the one under way.
STANDING_SECONDS, STANDING_BLOCKS, SKIPPED_BLOCKS = 10.0, 12, 3


@kernel
def take_provisional(state: Bias, block_seconds: float, bias_max: float) -> None:
    """Take the mean of the steady segment under way for the bias, until there is a rest."""
    seconds = max(PROVISIONAL_SECONDS, PROVISIONAL_BLOCKS * block_seconds)
    if state['segments'] == 0 and state['seconds_since_rest'] <= seconds:
        _take_mean(state, state['rest']['blocks'] * block_seconds, 0.0, bias_max)


@kernel
def take_standing(state: Bias, block_seconds: float, bias_max: float) -> None:
    """Take the mean since the start for the bias, while gravity has stood and there is no rest."""
    rest = state['rest']
    seconds = rest['standing_blocks'] * block_seconds
    if state['segments'] > 0 or state['known'] or seconds < STANDING_SECONDS:
        return
    since_start = state['seconds_since_rest'] <= seconds + SKIPPED_BLOCKS * block_seconds
    if since_start and rest['standing_blocks'] >= STANDING_BLOCKS and is_noise(rest):
        _take_mean(state, 0.0, LARGEST_TILT / seconds, bias_max)


@kernel
def _take_mean(state: Bias, steady_seconds: float, hidden_rate: float, bias_max: float) -> None:
    """Take a mean for the bias, if that tells more than what is known.

    It is of the segment under way, which has been steady for `steady_seconds`, or, where that is 0,
    of all blocks since gravity stands. In these the body may have turned at `hidden_rate` in rad/s,
    by a tilt too small to show.
    """
    standing = steady_seconds == 0.0
    is_far, fits_zero = False, is_zero(state['bias']) and not state['known']
    total = total_before = 0.0
    for axis in range(3):
        mean, variance = _measure(state['rest'], axis, standing, hidden_rate)
        if abs(mean) > bias_max:
            return
        before, distance = bias_variance(state, axis), mean - state['bias'][axis]
        total += variance
        total_before += before
        is_far = is_far or is_beyond_gate(distance, GATE, variance + before)
        fits_zero = fits_zero and not is_beyond_gate(mean, SIGNIFICANT, variance)
    if not total < total_before:
        return
    if is_far:
        if state['known']:
            return  # it turns: the bias of the last run is another one
        if has_provisional(state):
            give_up_bias(state)
    for axis in range(3):
        mean, variance = _measure(state['rest'], axis, standing, hidden_rate)
        if fits_zero:
            variance += mean * mean  # the bias stays zero, as certain as the mean lets it be
        else:
            state['bias'][axis] = mean
        state['variance'][axis] = variance
    state['provisional_seconds'] = steady_seconds
    _begin_provisional(state, standing)
    _replace_direction(state, standing)


@kernel
def _begin_provisional(state: Bias, standing: bool) -> None:
    """Begin to track the provisional bias in motion, and to count what it may have done since."""
    rest = state['rest']
    for axis in range(3):
        # Scaled to the length of a segment, as later segments are compared with it.
        share = rest['standing_blocks'] / SEGMENT_BLOCKS if standing else 1.0
        state['provisional_variance'][axis] = _scatter(rest, axis, standing) * share
        signal = rest['signals'][axis]
        noise = standing_scatter(rest, axis) if standing else value_variance(rest, signal)
        limit_shift(state['motion'], axis, noise)
    start_motion_bias(state['motion'], state['bias'], state['variance'])
    state['known'] = False
    state['process_noise'] = state['largest_process_noise'] = 0.0


@kernel
def _replace_direction(state: Bias, standing: bool) -> None:
    """Take the mean acceleration for gravity, whose direction has turned with the bias so far."""
    rest = state['rest']
    if rest['force']['late'] > 0:
        return  # rest sees an acceleration of long ago
    x, y, z = rest['gravity'][0], rest['gravity'][1], rest['gravity'][2]
    if not standing:
        x, y, z = segment_mean(rest, 3), segment_mean(rest, 4), segment_mean(rest, 5)
    take_direction(state['motion'], x, y, z, 1.0)


@kernel
def _measure(rest: Rest, axis: int, standing: bool, hidden_rate: float) -> tuple[float, float]:
    """Return the mean of an axis in rad/s, and the variance in (rad/s)^2 of a bias that it is."""
    mean = standing_mean(rest, axis) if standing else segment_mean(rest, axis)
    besides = PROVISIONAL_DEVIATION * PROVISIONAL_DEVIATION + hidden_rate * hidden_rate
    return mean, _scatter(rest, axis, standing) + besides


@kernel
def _scatter(rest: Rest, axis: int, standing: bool) -> float:
    """Return the variance of the mean in (rad/s)^2, by the scatter of its blocks."""
    scatter = variance_of_standing_mean(rest, axis) if standing else segment_scatter(rest, axis)
    return max(scatter, LEAST_VARIANCE)


@kernel
def is_far_from_provisional(state: Bias) -> bool:
    """Return whether the segment lies where the provisional bias, if there is one, can't be."""
    if not has_provisional(state):
        return False
    for axis in range(3):
        distance = segment_mean(state['rest'], axis) - state['bias'][axis]
        if is_beyond_gate(distance, GATE, bias_variance(state, axis)):
            return True
    return False


@kernel
def turns_about_vertical(state: Bias) -> bool:
    """Return whether the first rest is a slow turn about the vertical, and no other bias.

    Rates that were steady for long enough have to have shown the bias before. A turn about the
    vertical changes nothing across it. A bias that warms up can't have come so far yet, and where a
    driver takes the bias off, the rates are about zero.
    """
    if state['provisional_seconds'] < FIRST_REST_SECONDS:
        return False
    rest, about_zero = state['rest'], True
    square = along = size = variance = 0.0
    for axis in range(3):
        rate, gravity = segment_mean(rest, axis), segment_mean(rest, 3 + axis)
        distance, noise = rate - state['bias'][axis], segment_variance(rest, axis)
        square += distance * distance
        along += distance * gravity
        size += gravity * gravity
        variance = max(variance, bias_variance(state, axis) + noise)
        noise += PROVISIONAL_DEVIATION * PROVISIONAL_DEVIATION
        about_zero = about_zero and not is_beyond_gate(rate, GATE, noise)
    warmed_up = FASTEST_WARM_UP * state['seconds_since_rest']
    if about_zero or size < LEAST_GRAVITY * LEAST_GRAVITY or square <= warmed_up * warmed_up:
        return False
    return bool(square - along * along / size <= GATE * GATE * variance)


@kernel
def is_less_steady(state: Bias) -> bool:
    """Return whether the segment is far less steady than that of the provisional bias was."""
    for axis in range(3):
        if segment_scatter(state['rest'], axis) > LESS_STEADY * state['provisional_variance'][axis]:
            return True
    return False
