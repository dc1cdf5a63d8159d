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

"""What is done to a filter between two samples, as kernels on its record (1,)."""

import math

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel
from gyro_drift_filter.core import methods, out_of_sequence
from gyro_drift_filter.core.bias.at_rest import calibrate_bias, leave_rest, start_bias, warm_bias
from gyro_drift_filter.core.bias.in_motion import lose_direction
from gyro_drift_filter.core.bias.records import (
    forget_contradiction,
    has_learned_bias,
    widen,
)
from gyro_drift_filter.core.bias.shift import set_shift, shift_of, shift_variance
from gyro_drift_filter.core.clock.envelope import give_rate, start_clock
from gyro_drift_filter.core.polling import start_polling
from gyro_drift_filter.core.quantisation import needs_half_counts, variance_of_cut
from gyro_drift_filter.core.records import FILTER
from gyro_drift_filter.core.sample import SampleStatus
from gyro_drift_filter.core.sensor_checks import start_checks
from gyro_drift_filter.core.settings import SETTINGS, Settings
from gyro_drift_filter.core.step import derive
from gyro_drift_filter.gravity import GRAVITY

# A method takes over from another's output where that is no more than so many deviations from the
# last sample, as noise hardly ever is: farther off, it was held for an outlier or lags.
TAKE_OVER_GATE = 4.0


@entry_kernel(FILTER)
def forget_history(filter_: NDArray[np.void]) -> None:
    """Never go back behind this moment for a message that was overtaken."""
    out_of_sequence.forget_history(filter_[0])


@entry_kernel(FILTER, SETTINGS)
def prepare_for_settings(filter_: NDArray[np.void], settings: NDArray[np.void]) -> None:
    """Prepare the state for new settings, before they take the place of those of the filter.

    They replace what was learned of the sample period and of the method's model where they give
    another value, and widen the bias by what they change of the rates that it was learned from.
    """
    state, before, after = filter_[0]['state'], filter_[0]['settings'], settings[0]
    period = state['clock']['period']
    if after['sample_rate'] != before['sample_rate']:
        give_rate(state['clock'], after['sample_rate'])
    if state['clock']['period'] != period:
        methods.change_period(filter_[0], state['clock']['period'] / period)
    methods.change_model(filter_[0], after)
    bias = state['bias']
    if not after['bias_in_motion']:
        forget_contradiction(bias)
    if after['bias_in_motion'] and not before['bias_in_motion']:
        # Nobody knows how the body has turned meanwhile.
        lose_direction(bias['motion'])
        lose_direction(bias['wide_prior'])
    if has_learned_bias(bias):
        widen(bias, _change_of_bias(before, after))
        quantisation = state['quantisation']
        was_needed = needs_half_counts(quantisation, before['input_quantisation'])
        if needs_half_counts(quantisation, after['input_quantisation']) != was_needed:
            widen(bias, variance_of_cut(quantisation))


@kernel
def _change_of_bias(before: Settings, after: Settings) -> float:
    """Return the variance in (rad/s)^2 by which a change of what gravity adds moves the bias."""
    largest = 0.0
    for axis in range(3):
        total = 0.0
        for k in range(3):
            entry = 3 * axis + k
            change = (
                after['calibration_acceleration_sensitivity'][entry]
                - before['calibration_acceleration_sensitivity'][entry]
            )
            total += change * change
        largest = max(largest, total)
    return largest * GRAVITY * GRAVITY


@entry_kernel(FILTER)
def take_over(filter_: NDArray[np.void]) -> None:
    """Start the method of the settings where another one has ended.

    So the output does not jump, unless it lags behind the samples or there is none: then the method
    starts at the next sample.
    """
    state = filter_[0]['state']
    result, tracking = state['result'], state['methods']['tracking']
    derive(filter_[0], state['clock']['period'])
    for axis in range(3):
        rate = state['filtered'][axis]
        distance = abs(state['taken'][axis] - rate)
        near = distance <= TAKE_OVER_GATE * math.sqrt(result['innovation_variance'][axis])
        was_tracking = tracking[axis] == 1 and result['status'] != SampleStatus.REFUSED
        tracking[axis] = 0
        if was_tracking and near:
            methods.take_over(filter_[0], axis, rate)


@entry_kernel(FILTER)
def start_state(filter_: NDArray[np.void]) -> None:
    """Set a state up that is zero but for the bias."""
    state = filter_[0]['state']
    leave_rest(state['bias'])
    start_checks(state['checks'])
    start_polling(state['polling'])
    start_clock(state['clock'], filter_[0]['settings']['sample_rate'])


@entry_kernel(FILTER, bool, np.float64, np.float64, np.float64, np.float64)
def set_bias(
    filter_: NDArray[np.void],
    known: bool,
    bias: NDArray[np.float64],
    variance: NDArray[np.float64],
    shift: NDArray[np.float64],
    variance_of_shift: NDArray[np.float64],
) -> None:
    """Start a zeroed bias at rest, and its shift in motion: (3,) in rad/s.

    The variances are infinite where nothing is known; what is not `known` the first rest replaces.
    """
    state, settings = filter_[0]['state']['bias'], filter_[0]['settings']
    set_shift(state['motion'], shift, variance_of_shift)
    start_bias(state, bias, variance, known, settings['bias_turn_on_deviation'])


@entry_kernel(FILTER, np.float64, np.float64)
def read_shift(
    filter_: NDArray[np.void], shift: NDArray[np.float64], variance: NDArray[np.float64]
) -> None:
    """Write the shift of the bias in motion, (3,) in rad/s, and its variance.

    While rates and accelerations contradict each other the shift is 0.
    """
    bias = filter_[0]['state']['bias']
    motion = bias['motion']
    for axis in range(3):
        shift[axis], variance[axis] = shift_of(motion, axis), shift_variance(motion, axis)
        if bias['contradicts']:
            shift[axis], variance[axis] = 0.0, motion['rectified'][axis]


@entry_kernel(FILTER, float)
def note_temperature(filter_: NDArray[np.void], temperature: float) -> None:
    """Take the sensor's temperature in deg C."""
    settings = filter_[0]['settings']
    warm_bias(filter_[0]['state']['bias'], temperature, settings)
    warm_bias(filter_[0]['history']['state']['bias'], temperature, settings)


@entry_kernel(FILTER)
def calibrate(filter_: NDArray[np.void]) -> None:
    """Take the mean rate of the rest under way for the bias."""
    calibrate_bias(filter_[0]['state']['bias'])
