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

"""Rates of exactly zero: reads that failed, and others."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.bias.shift import shift_variance
from gyro_drift_filter.core.sensor_changes import doubt_sensor
from gyro_drift_filter.core.zeros import RATES
from support.messages import START
from support.rests import moving_and_resting, run
from support.sensor import DEGREE, at_rest

BIAS = np.array([0.8, -0.5, 0.6]) * DEGREE
SPELLS = [(12, False), (15, True), (12, False), (15, True), (12, False), (15, True), (12, False)]


@pytest.fixture
def hand(random):
    """Rates and accelerations of a hand that rests now and then, and its bias."""
    return moving_and_resting(random, SPELLS, lambda time: BIAS)


def zero(random, share, count):
    """Return (count,) where a read fails: one in so many, or every second one for a half."""
    if share == 0.5:
        return np.arange(count) % 2 == 1
    return random.random(count) < share


@pytest.mark.parametrize('share', [0.02, 0.1, 0.5])
@pytest.mark.parametrize('forces', [False, True])
def test_reads_that_fail_at_rest_move_no_bias(share, forces, hand, random):
    """The bias was pulled towards zero by their share, and its deviation did not say so."""
    rates, accelerations = hand
    failed = zero(random, share, len(rates))
    given = np.where(failed[:, None], 0.0, rates)
    if forces:  # a driver that sends one message for each of its two sensors
        accelerations = np.where(failed[:, None] | (share < 0.5), accelerations, 0.0)
    filter_ = Filter()
    results = run(filter_, given, accelerations)
    assert results['outlier'][200:][failed[200:]].mean() > 0.95
    assert results['at_rest'][-200:].mean() > 0.9
    assert np.abs(results['bias'][-1] - BIAS).max() < 0.05 * DEGREE


def test_a_sensor_that_is_zero_by_chance_has_not_failed_to_read(random):
    """Its count is larger than its noise, and it has hardly a bias."""
    rates, accelerations = at_rest(random, 120)
    given = np.round(rates / 0.01) * 0.01
    results = run(Filter(), given, accelerations)
    assert (given == 0.0).all(axis=1).sum() > 1000
    assert not results['outlier'][(given == 0.0).all(axis=1)].any()


def test_counts_that_a_frame_has_mixed_have_not_failed_to_read(random):
    """A driver that turns the rates into another frame leaves no counts, but zeros now and then."""
    rates, accelerations = at_rest(random, 60)
    counts = np.round(0.4 * rates / rates.std() + [0.2, 0.0, 0.0]) * 1e-3
    given = Rotation.from_euler('xyz', [10.0, 20.0, 30.0], degrees=True).apply(counts)
    results = run(Filter(), given, accelerations)
    assert (given == 0.0).all(axis=1).mean() > 0.2
    assert results['outlier'].mean() < 1e-3
    assert results['at_rest'][-3000:].mean() > 0.9


def test_a_driver_that_zeroes_slow_rates_of_all_axes_has_not_failed_to_read(random):
    rates, accelerations = at_rest(random, 60)
    rates *= 0.003 / rates.std()
    given = np.where(np.linalg.norm(rates, axis=1)[:, None] < 0.005, 0.0, rates)
    results = run(Filter(), given, accelerations)
    assert results['outlier'].mean() < 1e-3
    assert results['at_rest'][-3000:].mean() > 0.9


@pytest.mark.parametrize('hard', [False, True])
def test_the_stops_of_a_simulator_without_noise_are_no_failed_reads(hard):
    turn = np.ones(40) if hard else 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(40) / 40)
    rates = np.tile(np.r_[turn, np.zeros(20)], 30)[:, None] * [0.3, -0.5, 1.0]
    accelerations = np.tile([0.0, 0.0, 9.81], (len(rates), 1))
    results = run(Filter(), rates, accelerations, rate=10.0)
    assert np.abs(results['angular_velocity'] - rates).max() < 0.05


def test_gravity_may_show_what_rounding_hides(random):
    """The bias at rest is that of the nearest count; it was off by as much in motion for good."""
    spells = [(20, False), (20, True)]
    bias = np.array([0.004, -0.0035, 0.003])
    rates, accelerations = moving_and_resting(random, spells, lambda time: bias)
    rates[:2000] = bias + 1e-3 * random.standard_normal((2000, 3))
    filter_ = Filter()
    results = run(filter_, np.round(rates / 0.01) * 0.01, accelerations)
    motion = filter_.state['bias']['motion']
    assert np.abs(results['bias'][1900] - bias).max() > 2e-3
    assert all(shift_variance(motion, axis) > 1e-3**2 for axis in range(3))


def test_the_rates_of_another_sensor_say_nothing(hand):
    rates, accelerations = hand
    filter_ = Filter()
    run(filter_, rates[:1000], accelerations[:1000])
    assert filter_.state['checks']['living_rates']['count'] == RATES
    doubt_sensor(filter_.record[0])
    run(filter_, rates[1000:1005], accelerations[1000:1005], start=START + 10_000_000_000)
    assert filter_.state['checks']['living_rates']['count'] == 5
