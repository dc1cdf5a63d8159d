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

"""What is forgotten where the sensor turns out to be another than it seemed.

The driver polls it faster than it measures, an axis that seemed dead comes alive, it measures rest
exactly, or the messages come from another sensor.
"""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core import methods
from gyro_drift_filter.core.bias.at_rest import forget_bias, leave_rest
from gyro_drift_filter.core.bias.in_motion import lose_direction
from gyro_drift_filter.core.bias.records import (
    follows_wide_prior,
    forget_contradiction,
    has_learned_bias,
    has_provisional,
    is_remembered,
    widen,
)
from gyro_drift_filter.core.bias.shared import doubt_wide_prior, forget_scale, limit_prior
from gyro_drift_filter.core.bias.slow_turn import give_up_bias
from gyro_drift_filter.core.clock.envelope import lengthen_period
from gyro_drift_filter.core.out_of_sequence import forget_history
from gyro_drift_filter.core.records import FilterRecord
from gyro_drift_filter.core.rest.noise import doubt_noise, expect_no_noise, forget_noise


@kernel
def adopt_sensor_period(filter_: FilterRecord) -> None:
    """Adopt the sensor's own sample period, and start over: each repeat counted as a sample."""
    state, sample_rate = filter_['state'], filter_['settings']['sample_rate']
    lengthen_period(state['clock'], 1.0 / state['polling']['samples_per_message'], sample_rate)
    methods.start_over(filter_)
    leave_rest(state['bias'])
    forget_noise(state['bias']['rest'])


@kernel
def doubt_rest(filter_: FilterRecord) -> None:
    """Doubt what was learned at rest: an axis has changed for the first time.

    Its device may not have been ready when the driver was, so that it has not measured so far.
    """
    bias, deviation = filter_['state']['bias'], filter_['settings']['bias_turn_on_deviation']
    # A bias that is kept from the last run does not depend on it.
    if bias['segments'] > 0 or has_provisional(bias):
        methods.start_over(filter_)
        doubt_noise(bias['rest'])
        # Axes come alive one by one: once between two rests is enough.
        lacking = deviation * deviation - bias['process_noise']
        if lacking > 0.0:
            give_up_bias(bias)
            widen(bias, lacking)
        # It comes alive where the robot starts: gravity tells no more than at any start of motion.
        limit_prior(bias['motion'])


@kernel
def doubt_sensor(filter_: FilterRecord) -> None:
    """Doubt the bias, and forget how the body lies: another sensor measures from now on."""
    bias, deviation = filter_['state']['bias'], filter_['settings']['bias_turn_on_deviation']
    forget_history(filter_)
    lose_direction(bias['motion'])
    lose_direction(bias['wide_prior'])
    forget_scale(bias['motion'])
    filter_['state']['checks']['living_rates']['count'] = 0
    # Of sensors that alternate each message is another one's: once between two rests is enough.
    lacking = deviation * deviation - bias['process_noise']
    if lacking > 0.0 and has_learned_bias(bias):
        leave_rest(bias)
        widen(bias, lacking)
        limit_prior(bias['motion'])
    if is_remembered(bias):
        bias['corrected'] = 0
        bias['restored'] = False
    if follows_wide_prior(bias):
        doubt_wide_prior(bias['wide_prior'], bias['bias'], bias['variance'], deviation)
    forget_contradiction(bias)


@kernel
def forget_rest(filter_: FilterRecord) -> None:
    """Forget the rests there were: a sensor that measures rest exactly has no noise in one."""
    bias = filter_['state']['bias']
    # A device that is not ready may do so, too, and a bias of the last run does not depend on it.
    if is_remembered(bias):
        return
    if has_learned_bias(bias):
        methods.start_over(filter_)
        forget_bias(bias, filter_['settings']['bias_turn_on_deviation'])
    expect_no_noise(bias['rest'])
