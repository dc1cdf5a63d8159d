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

"""Gravity that the rates carry on in a stillness, beside rotations of scipy, and what it says."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.bias.carried_gravity import (
    CARRIED_GRAVITY,
    carry_gravity,
    carry_on_with,
)
from gyro_drift_filter.core.rest.records import REST, REST_LENGTHS
from support.rests import run
from support.sensor import DEGREE, at_rest

SECONDS, BLOCKS = 0.125, 200


def test_gravity_is_carried_on_as_rotations_turn_it(random):
    rest, lengths, carried = (zeroed(kind)[0] for kind in (REST, REST_LENGTHS, CARRIED_GRAVITY))
    gravity, bias = 9.81 * np.array([0.6, 0.0, 0.8]), 0.02 * random.standard_normal(3)
    rates = (
        bias
        + 0.5 * DEGREE * np.array([1.0, -0.5, 0.3])
        + 0.003 * random.standard_normal((BLOCKS, 3))
    )
    lengths['block_seconds'], rest['count'] = SECONDS, 1
    carry_on_with(carried, bias)
    carried['known'], carried['gravity'], carried['rate'] = True, gravity, bias
    # The last block is not counted yet.
    for block in [*rates, np.zeros(3)]:
        rest['signals']['origin'][:3] = block
        carry_gravity(carried, rest, lengths)
    for turn in Rotation.from_rotvec((rates - bias) * SECONDS):
        gravity = turn.inv().apply(gravity)
    assert carried['seconds'] == pytest.approx((BLOCKS + 1) * SECONDS)
    assert carried['gravity'] == pytest.approx(gravity, abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize('noise', [0.02, 0.3])
@pytest.mark.parametrize(('size', 'period'), [(0.02, 120.0), (0.03, 120.0), (0.05, 60.0)])
def test_a_bias_that_sways_while_the_sensor_stands_hides_no_rest(size, period, noise, random):
    """As by a thermostat: the rates carry gravity away and back again, and it stands."""
    rates, accelerations = at_rest(random, 600)
    time = np.arange(len(rates)) / 100
    rates = 0.1 * rates
    rates[:, 0] += size * DEGREE * np.sin(2.0 * np.pi * time / period)
    accelerations += noise * random.standard_normal(accelerations.shape)
    results = run(Filter(), rates, accelerations)
    assert np.mean(results['at_rest'][1000:] > 0.0) > 0.99
