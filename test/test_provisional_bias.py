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

"""The provisional bias: of who moves right after power-on, or never comes to rest."""

import numpy as np
import pytest
from scipy import signal

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.motion_state import DIRECTION
from gyro_drift_filter.core.rest.standing import (
    standing_mean,
    standing_scatter,
    variance_of_standing_mean,
)
from support.messages import even_stamps
from support.rests import run, slow_noise
from support.sensor import DEGREE, at_rest, by_hand, idling, taking_off


@pytest.mark.parametrize('begins', [1.5, 2.0])
def test_a_drone_that_takes_off_at_once_has_a_bias(begins, random):
    """Its motors run, and it never rests: its first second has to do."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = taking_off(random, 60, truth, begins)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][125:] - truth).max() < 6e-3
    deviations = np.sqrt(results['angular_velocity_variance'][[20, 125]]).max(axis=1)
    assert deviations[1] < 0.3 * deviations[0]


def test_a_zero_that_the_first_seconds_confirm_is_kept_and_known(random):
    """Where the driver subtracts the bias, a noisy mean is no better, but it says so."""
    filter_ = Filter()
    results = run(filter_, *taking_off(random, 60, np.zeros(3)))
    assert (filter_.state['bias']['bias'] == 0.0).all()
    assert np.abs(results['bias']).max() < 2e-3
    deviations = np.sqrt(results['angular_velocity_variance'][[20, 200]]).max(axis=1)
    assert deviations[1] < 0.3 * deviations[0]


@pytest.mark.parametrize('off', [1e-3, 3e-2])
def test_an_initial_bias_is_replaced_by_the_mean_of_the_first_seconds(off, random):
    """It has changed since it was identified, by more than that mean is off."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = taking_off(random, 60, truth)
    known, unknown = Filter(Parameters(bias_initial=tuple(truth + off))), Filter()
    biases = [run(filter_, rates, accelerations)['bias'][200] for filter_ in (known, unknown)]
    np.testing.assert_allclose(biases[0], biases[1], atol=1e-4)


def test_with_a_provisional_bias_gravity_is_where_the_accelerometer_says(random):
    """Until then the direction has turned with the bias: by 6 degrees in the first second."""
    rates, accelerations = idling(random, 1.4, np.array([0.1, -0.1, 0.0]))
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert np.abs(results['bias'][-1]).max() > 0.08
    direction = filter_.state['bias']['motion']['state_vector'][DIRECTION : DIRECTION + 3]
    np.testing.assert_allclose(direction, [0.0, 0.0, 1.0], atol=0.02)


def test_a_take_off_is_no_rest(random):
    """It goes up with a slow drift of the rates, less steady than it stood before."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = idling(random, 60, truth)
    turn, push = by_hand(random, 56)
    rates[200:400] += 0.012 * random.standard_normal((16, 3)).repeat(13, axis=0)[:200] - 0.009
    rates[400:] += turn
    accelerations[400:] += push
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][125:] - truth).max() < 6e-3


def test_noise_that_is_correlated_over_seconds_hides_no_bias_at_low_rates(random):
    """A phone at 10 Hz, whose noise has passed a low-pass of 0.1 Hz: a rest takes a minute."""
    section = signal.butter(2, 0.12, fs=10.0, output='sos')
    bias = np.radians([2.0, -1.2, 0.7])
    for _ in range(6):
        noise = signal.sosfilt(section, 0.012 * random.standard_normal((800, 3)), axis=0)[300:]
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((500, 3))
        stamps = even_stamps(500, 10.0)
        results = Filter().run(stamps, noise + bias, acceleration)
        assert np.abs(results['bias'][200:] - bias).max() < np.radians(0.4)


def test_a_bias_is_provisional_later_too_while_gravity_has_stood(random):
    """With noise as slow as this minutes may pass without any stretch that is steady."""
    bias = np.radians([2.0, -1.2, 0.7])
    stamps, late = even_stamps(1200, 10.0), []
    for _ in range(12):
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((1200, 3))
        results = Filter().run(stamps, slow_noise(random, 1200) + bias, acceleration)
        late.append(not results['bias'][95].any())
        assert results['bias'][115].any()
        assert np.abs(results['bias'][1100:] - bias).max() < np.radians(0.3)
    assert any(late)


def test_the_mean_while_gravity_stands_is_that_of_plain_blocks(random):
    rates = slow_noise(random, 400) + np.array([0.03, -0.02, 0.01])
    acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((400, 3))
    filter_ = Filter()
    filter_.run(even_stamps(400, 10.0), rates, acceleration)
    rest = filter_.state['bias']['rest']
    # The first block says where gravity is.
    blocks = rates.reshape(50, 8, 3).mean(axis=1)[1:]
    assert rest['standing_blocks'] == len(blocks)
    for axis in range(3):
        means = blocks[:, axis]
        scatter = means.var(ddof=1)
        assert standing_mean(rest, axis) == pytest.approx(means.mean(), rel=1e-12)
        assert standing_scatter(rest, axis) == pytest.approx(scatter, rel=1e-9)
        # A correlation beyond this one is none of noise that falls off.
        correlation = min(1.0 - 0.5 * np.square(np.diff(means)).mean() / scatter, 0.9)
        longer = (1.0 + correlation) / (1.0 - correlation)
        expected = longer * scatter / len(means)
        assert variance_of_standing_mean(rest, axis) == pytest.approx(expected, rel=1e-2)


def test_who_has_moved_gets_no_provisional_bias_later(random):
    """The noise is too slow for a rest, and the turn that follows is steady."""
    stamps, count = even_stamps(600, 10.0), 0
    for _ in range(12):
        rates = slow_noise(random, 600)
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((600, 3))
        rates[50:60, 0] += 0.2  # it is laid down anew
        acceleration[55:, 1] += 2.0
        rates[250:, 2] += 3.0 * DEGREE
        filter_ = Filter()
        results = filter_.run(stamps[:400], rates[:400], acceleration[:400])
        if filter_.state['bias']['segments'] == 0:
            count += 1
            assert np.abs(results['bias'][-1]).max() < 0.5 * DEGREE
    assert count > 0


def rattling(random, count, deviation):
    """Return rates and accelerations (count, 3) at 100 Hz of a body that shakes at 0.5 to 4 Hz."""
    section = signal.butter(3, (0.5, 4.0), 'bandpass', fs=100.0, output='sos')
    shake = signal.sosfilt(section, random.standard_normal((count, 3)), axis=0)
    rates = deviation * shake / shake.std() + 0.002 * random.standard_normal((count, 3))
    return rates, 0.02 * random.standard_normal((count, 3)) + [0.0, 0.0, 9.81]


def test_a_turn_beside_a_rattle_is_no_provisional_bias(random):
    """To and fro about the vertical, on a rough floor: the other axes scatter as much."""
    rates, acceleration = rattling(random, 6000, 0.02)
    rates[:, 2] += 4.0 * DEGREE * np.where(np.arange(6000) % 2000 < 1000, 1.0, -1.0)
    results = run(Filter(), rates, acceleration)
    assert np.abs(results['bias']).max() < 0.5 * DEGREE


def test_a_hand_gives_no_provisional_bias(random):
    """It holds the sensor, as well as hands do, from the start."""
    rates, accelerations = at_rest(random, 3)
    rates += np.cumsum(random.standard_normal(rates.shape), axis=0) * 0.004
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias']).max() < 1e-4


@pytest.mark.parametrize('speed', [3.0, 6.0, 9.0])
@pytest.mark.parametrize('stands', [1.2, 1.6])
def test_a_turn_that_replaces_the_provisional_bias_is_undone_at_the_next_rest(
    stands, speed, random
):
    """The robot turns about the vertical for 30 s after a second, as to look around, and drives."""
    truth = np.array([1.0, -2.0, 0.5]) * DEGREE
    standing, turning = round(stands * 100), slice(round(stands * 100), round(stands * 100) + 3000)
    rates, accelerations = at_rest(random, 90, truth)
    rates[turning, 2] += speed * DEGREE
    turn, push = by_hand(random, 20)
    rates[5000:7000] += 0.3 * turn
    accelerations[5000:7000] += push
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'][standing - 1], truth, atol=0.3 * DEGREE)
    np.testing.assert_allclose(results['bias'][turning.stop + 500], truth, atol=0.1 * DEGREE)
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.1 * DEGREE)


@pytest.mark.parametrize(('rate', 'stands'), [(10.0, 9.0), (12.5, 7.0), (20.0, 5.0), (30.0, 3.5)])
@pytest.mark.parametrize('speed', [1.5, -2.0])
def test_a_turn_at_low_rates_is_no_rest_after_seconds_that_were_steady(rate, stands, speed, random):
    """A first rest takes longer than the stand, and the turn about the vertical is as steady."""
    truth = np.array([0.3, -0.4, 0.5]) * DEGREE
    first, turns = round(stands * rate), round(30 * rate)
    rates, accelerations = at_rest(random, stands + 60.0, truth, rate)
    rates[first : first + turns, 2] += speed * DEGREE
    results = run(Filter(), rates, accelerations, rate)
    assert np.abs(results['bias'][first - 1 :] - truth).max() < 0.1 * DEGREE
    assert results['at_rest'][-1]


@pytest.mark.parametrize(('rate', 'seconds'), [(10.0, 9.0), (15.0, 7.0)])
def test_a_robot_that_says_that_it_stands_shows_its_bias_at_low_rates(rate, seconds, random):
    """Also where it has turned steadily since it was switched on."""
    truth = np.array([0.3, -0.4, 0.5]) * DEGREE
    rates, accelerations = at_rest(random, 60.0, truth, rate)
    turns, times = round(seconds * rate), even_stamps(len(rates), rate)
    rates[:turns, 2] += 1.5 * DEGREE
    filter_ = Filter()
    for first in range(0, len(rates), 5):
        if first >= 2 * turns:
            filter_.hint(False)
        part = slice(first, first + 5)
        results = filter_.run(times[part], rates[part], accelerations[part])
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.1 * DEGREE)


@pytest.mark.parametrize(('rate', 'seconds'), [(10.0, 9.0), (20.0, 5.0)])
@pytest.mark.parametrize('bias', [(0.0, 0.0, 0.7), (0.4, 0.4, 0.4)])
def test_a_driver_may_take_the_bias_off_before_the_first_rest(rate, seconds, bias, random):
    """It has measured the bias since power-on, and leaves zero."""
    rates, accelerations = at_rest(random, 60.0, rate=rate)
    rates *= 0.2
    rates[: round(seconds * rate)] += np.array(bias) * DEGREE
    results = run(Filter(), rates, accelerations, rate)
    assert np.abs(results['bias'][-1]).max() < 0.1 * DEGREE


def test_a_bias_that_warms_up_before_the_first_rest_is_followed(random):
    """About the vertical, where gravity does not show it."""
    rates, accelerations = at_rest(random, 60.0, rate=20.0)
    warm_up = 2.0 * DEGREE * (1.0 - np.exp(-np.arange(len(rates)) / 20.0 / 60.0))
    rates *= 0.1
    rates[:, 2] += warm_up
    results = run(Filter(), rates, accelerations, 20.0)
    assert abs(results['bias'][-1, 2] - warm_up[-1]) < 0.4 * DEGREE
