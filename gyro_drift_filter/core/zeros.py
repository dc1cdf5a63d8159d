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

"""Reads that fail at rest, so that a driver gives zeros.

In motion `methods/circumstances.py` tells them by the jump. At rest a bias may be so small that
there is none, but zeros would pull it towards zero.
"""

from typing import TYPE_CHECKING, TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel
from gyro_drift_filter.core.bias.records import Bias
from gyro_drift_filter.core.sample import is_usable, is_zero, smallest_change

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord

# Mean and variance are those of so many rates, each with the weight of one.
RATES = 20
# Zeros on all axes have not been measured where they lie beyond nine of ten rates: the squared
# distance from the mean in variances is that of the chi-squared distribution with three degrees of
# freedom. Exact zeros are far less likely still, unless counts are coarse, and then hardly matter.
LARGEST_DISTANCE = 6.0
# A simulator without noise gives zeros where it stands. In (rad/s)^2: no MEMS gyroscope has less.
LEAST_VARIANCE = 1e-8


class LivingRates(TypedDict):
    """The last rates of which not all were zero."""

    count: int  # up to `RATES`
    last: PerAxis  # rad/s
    mean: PerAxis  # rad/s
    variance: PerAxis  # (rad/s)^2
    resolution: PerAxis  # rad/s, the smallest change so far; 0 before the first


@kernel
def note_living_rates(living: LivingRates, rate: PerAxis) -> None:
    """Take rates (3,) in rad/s in, unless all are zero or one is no usable number."""
    if is_zero(rate) or not (is_usable(rate[0]) and is_usable(rate[1]) and is_usable(rate[2])):
        return
    living['count'] = min(living['count'] + 1, RATES)
    weight = 1.0 / living['count']
    for axis in range(3):
        change = abs(rate[axis] - living['last'][axis])
        living['resolution'][axis] = smallest_change(living['resolution'][axis], change)
        living['last'][axis] = rate[axis]
        distance = rate[axis] - living['mean'][axis]
        living['mean'][axis] += weight * distance
        square = (1.0 - weight) * distance * distance
        living['variance'][axis] += weight * (square - living['variance'][axis])


@kernel
def has_failed_to_read(filter_: 'FilterRecord') -> bool:
    """Return whether the last rates are zero on all axes because nothing was read at rest."""
    state, checks = filter_['state'], filter_['state']['checks']
    if checks['gives_zeros'] or not is_zero(checks['measured']):
        return False
    value_samples = filter_['coefficients']['rest']['value']
    return _are_beyond_rest(checks['living_rates'], state['bias'], value_samples)


@kernel
def _are_beyond_rest(living: LivingRates, bias: Bias, value_samples: int) -> bool:
    """Return whether zeros on all axes are no rates that the sensor has at rest.

    What rates at rest are is known by the bias and by the noise of values of so many samples, or
    by the last rates before the first rest.
    """
    if living['count'] < RATES:
        return False
    known, distance = bias['known'] and bias['rest']['known'], 0.0
    for axis in range(3):
        mean, variance = living['mean'][axis], living['variance'][axis]
        if known:
            mean = bias['bias'][axis]
            variance = bias['rest']['signals'][axis]['variance'] * value_samples
        if variance < LEAST_VARIANCE:
            return False
        # Coarse counts vary by more than a few of them show.
        count = living['resolution'][axis]
        distance += mean * mean / (variance + count * count)
    return bool(distance > LARGEST_DISTANCE)
