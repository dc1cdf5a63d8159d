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

"""What is a rest where the accelerometer is absent, slow, coarse, or wrong now and then."""

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.rest.force import note_force
from support.rests import moving_and_resting, run
from support.sensor import DEGREE, at_rest


@pytest.mark.parametrize('nothing', [0.0, np.nan])
def test_without_an_accelerometer(nothing, random):
    truth = np.array([0.3, -0.2, 0.5]) * DEGREE
    spells = [(10, False), (20, True), (6, False)]
    rates, accelerations = moving_and_resting(random, spells, lambda time: truth)
    results = run(Filter(), rates, np.full_like(accelerations, nothing))
    assert np.isfinite(results['angular_velocity']).all()
    assert np.abs(results['bias'][1000:] - truth).max() < 0.06 * DEGREE


def rests_in_poses(random, count=8):
    """Return rates, accelerations (n, 3) and the ends of rests of 7 s, each in another pose."""
    spells = [(7.0, False), (6.0, True)] * count
    rates, accelerations = moving_and_resting(random, spells, lambda time: np.zeros(3))
    for k in range(count):
        pose = Rotation.from_euler('xyz', random.uniform(-0.5, 0.5, 3))
        accelerations[1300 * k :] = pose.apply(accelerations[1300 * k :])
    return rates, accelerations, 1300 * np.arange(count) + 690


@pytest.mark.parametrize('failed', [np.nan, 0.0, np.inf, -0.0024, 39.2])
def test_reads_of_the_accelerometer_that_fail_hide_no_rest(failed, random):
    """An error code that a driver takes for a value is -1 count, or the end of the range."""
    rates, accelerations, ends = rests_in_poses(random)
    accelerations[random.random(len(rates)) < 0.05] = failed
    results = run(Filter(), rates, accelerations)
    assert (results['at_rest'][ends] == 1.0).all()


def with_spikes(random, accelerations, size, share, held=1):
    """Return accelerations of which an axis is wrong now and then; each is repeated `held` times.

    It is `size` in m/s^2, or 0.
    """
    wrong = accelerations[::held].copy()
    rows = np.flatnonzero(random.random(len(wrong)) < share)
    wrong[rows, random.integers(0, 3, len(rows))] = size * random.choice([-1.0, 1.0], len(rows))
    return np.repeat(wrong, held, axis=0)[: len(accelerations)]


@pytest.mark.slow
@pytest.mark.parametrize('held', [1, 4])
@pytest.mark.parametrize('share', [0.005, 0.02])
@pytest.mark.parametrize('size', [0.0, 15.0, 40.0, 490.0])
def test_an_axis_of_the_accelerometer_that_is_wrong_now_and_then_hides_no_rest(
    size, share, held, random
):
    """Two in a row that are wrong do hide a segment."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    results = run(Filter(), rates, with_spikes(random, accelerations, size, share, held))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


@pytest.mark.parametrize('noise', ['aliased', 'correlated'])
def test_slow_noise_of_the_accelerometer_hides_few_rests(noise, random):
    """The halves of a segment differ by more than their blocks say, and the body stands."""
    rates, accelerations = at_rest(random, 300)
    n = len(rates)
    slow = 0.03 * np.sin(0.4 * np.pi * np.arange(n)[:, None] / 100 + random.uniform(0.0, 6.0, 3))
    if noise == 'correlated':  # over 2 s
        slow = signal.lfilter([1.0], [1.0, -0.995], 0.002 * random.standard_normal((n, 3)), axis=0)
    results = run(Filter(), rates, accelerations + slow)
    assert results['at_rest'].mean() > 0.5


def test_what_stands_in_for_a_spike_of_the_accelerometer_is_its_last_value(random):
    """What stays is no spike from the second sample on, nor is what shakes all the time."""
    _, accelerations = at_rest(random, 5)
    shaken = accelerations + 0.5 * (np.arange(len(accelerations)) % 3 == 0)[:, None]
    spikes = accelerations.copy()
    spikes[100::50, 2] += 15.0
    moved = accelerations.copy()
    moved[300:, 0] += 3.0
    for given, axis, wrong in (
        (accelerations, 0, []),
        (spikes, 2, range(100, 500, 50)),
        (moved, 0, [300]),
    ):
        expected = given.copy()
        expected[wrong, axis] = given[np.array(wrong, dtype=int) - 1, axis]
        np.testing.assert_array_equal(felt_in(given), expected)
    differs = (felt_in(shaken) != shaken).any(axis=1)
    assert not differs[50:].any()


LONGEST = 6  # samples: half a block at 100 Hz


def felt_in(accelerations):
    """Return the accelerations that rest sees."""
    force = Filter().state['bias']['rest']['force']
    felt = []
    for acceleration in accelerations:
        note_force(force, acceleration, LONGEST)
        felt.append(force['felt'].copy())
    return np.array(felt)


@pytest.mark.parametrize('held', [3, 6])
def test_an_acceleration_that_is_repeated_is_a_spike_for_less_than_a_block(held, random):
    """Of an accelerometer that is slow; one that stays after that is that of a simulator."""
    _, accelerations = at_rest(random, 12)
    accelerations = np.repeat(accelerations[::held], held, axis=0)
    accelerations[900 : 900 + held, 2] = 30.0
    accelerations[1100:] = 0.0, 1.0, 2.0
    felt = felt_in(accelerations)
    assert felt[:1100, 2].max() < 10.0
    assert np.flatnonzero(felt[:, 2] == 2.0).tolist() == list(range(1100 + LONGEST, 1200))


def measured_at(numbers, accelerations, between):
    """Return accelerations at these numbers of samples, with what a driver sends `between`."""
    if between is None:
        last = np.zeros(len(accelerations), int)
        last[numbers] = numbers
        return accelerations[np.maximum.accumulate(last)]
    sent = np.full_like(accelerations, between)
    sent[numbers] = accelerations[numbers]
    return sent


@pytest.mark.slow
@pytest.mark.parametrize('between', [None, np.nan, 0.0])
@pytest.mark.parametrize('every', [7, 8, 13, 20, 33, 50, 100, 200])
def test_a_slow_accelerometer_hides_no_rest(every, between, random):
    """It shows no noise within a block, or a jump, so that rest sees none."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    numbers = np.arange(0, len(rates), every)
    results = run(Filter(), rates, measured_at(numbers, accelerations, between))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


@pytest.mark.parametrize(('every', 'delay'), [(6, 1), (7, 1), (8, 2), (10, 4)])
def test_delays_do_not_make_an_accelerometer_slow_and_fast_by_turns(every, delay, random):
    rates, accelerations, ends = rests_in_poses(random, 16)
    numbers = np.arange(0, len(rates), every)
    numbers[1:] += random.integers(-delay, delay + 1, len(numbers) - 1)
    numbers = numbers[numbers < len(rates)]
    results = run(Filter(), rates, measured_at(numbers, accelerations, None))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


def test_what_a_slow_accelerometer_has_shown_long_ago_is_no_gravity_that_stands(random):
    """Until it is fast: else the mean rate of a motion would be that of a body that stands."""
    rates, accelerations = moving_and_resting(random, [(60.0, True)], lambda time: np.zeros(3))
    filter_ = Filter()
    slow = measured_at(np.arange(0, len(rates), 200), accelerations, None)
    results = run(filter_, rates, slow)
    rest = filter_.state['bias']['rest']
    assert rest['standing_seconds'] == 0.0
    assert rest['standing_blocks'] == 0
    assert not results['at_rest'].any()
    _, later = at_rest(random, 1.0)
    felt = felt_in(np.concatenate([slow, later]))
    np.testing.assert_array_equal(felt[:6000], np.tile(slow[0], (6000, 1)))
    np.testing.assert_array_equal(felt[6020:], later[20:])


def test_an_accelerometer_that_measures_every_fourth_sample_hides_no_rest(random):
    rates, accelerations, ends = rests_in_poses(random)
    accelerations[np.arange(len(rates)) % 4 > 0] = np.nan
    results = run(Filter(), rates, accelerations)
    assert (results['at_rest'][ends] == 1.0).mean() > 0.8


@pytest.mark.parametrize('count', [0.15, 0.3, 0.6])
def test_a_coarse_accelerometer_hides_no_rest(count, random):
    """An axis that shows one count in one pose toggles between two of them in the next one."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    results = run(Filter(), rates, count * np.round(accelerations / count))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85
