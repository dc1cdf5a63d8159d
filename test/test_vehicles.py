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

"""Simulated vehicles: what their sensors show fits how they move, and the bias in motion helps."""

import numpy as np
import pytest

pytest.importorskip('scipy', reason='scipy is not installed')

from benchmark import vehicles as benchmark
from benchmark.scale import bias_error, rolling
from benchmark.vehicles import Judged, judge, misses
from gyro_drift_filter.core import Filter
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    rotate,
    running_products,
    to_vectors,
)
from gyro_drift_filter.simulation.vehicles import VEHICLES, ride, train
from support.paths import REPOSITORY

PERIOD = 0.005


@pytest.mark.parametrize('name', VEHICLES)
def test_rates_and_forces_are_those_of_the_motion(name):
    """Integrated without the bias they lead to the attitude, and gravity is left of the forces."""
    found = ride(VEHICLES[name], 1, seconds=90.0, warm_up=0.0)
    turns = from_vectors((found.rates - found.bias)[1:] * PERIOD)
    after = multiply(found.orientations[0], running_products(turns))
    off = np.linalg.norm(to_vectors(multiply(after, inverse(found.orientations[1:]))), axis=1)
    # What is left of the faults of a calibrated sensor, its noise, and what clips.
    assert np.degrees(off.max()) < 2.0
    mean = rotate(found.orientations, found.accelerations).mean(axis=0)
    np.testing.assert_allclose(mean, [0.0, 0.0, GRAVITY], atol=0.25)
    assert found.moving.mean() > 0.5


@pytest.mark.parametrize('name', VEHICLES)
def test_they_begin_with_a_rest_and_are_those_of_their_seed(name):
    first, again, other = (ride(VEHICLES[name], seed, seconds=40.0) for seed in (3, 3, 4))
    assert (first.rates == again.rates).all()
    assert (first.accelerations == again.accelerations).all()
    assert (first.rates != other.rates).mean() > 0.9
    still = first.orientations[: round(3.0 / PERIOD)]
    np.testing.assert_allclose(still, still[:1] * np.ones((len(still), 1)), atol=1e-12)
    assert not first.moving[: len(still)].any()
    assert first.moving.any()


@pytest.mark.slow
def test_gravity_shows_the_bias_of_a_drone():
    judged = [judge(ride(VEHICLES['drone'], seed, 300.0)) for seed in range(3)]
    off, on = (np.mean([getattr(one, which)[2] for one in judged]) for which in ('off', 'on'))
    assert on < 0.8 * off


@pytest.mark.slow
def test_a_car_on_a_straight_road_does_not_stand():
    """Its vibration is that of a machine, but for how it sways."""
    for seed in range(3):
        of = ride(VEHICLES['car'], seed, 300.0, warm_up=0.0)
        results = Filter().run(of.stamps, of.rates, of.accelerations)
        assert results['at_rest'][of.moving].mean() < 0.02


@pytest.mark.slow
def test_a_car_that_does_not_stop_for_long_does_not_stand_either():
    """After five minutes without a rest a smooth road was taken for one, and a curve for bias."""
    of = ride(VEHICLES['car'], 1, 600.0, warm_up=0.0)
    results = Filter().run(of.stamps, of.rates, of.accelerations)
    assert results['at_rest'][of.moving].mean() < 0.01
    assert np.abs(results['bias'] - of.bias)[of.moving].max() < np.radians(0.2)


@pytest.mark.slow
def test_a_car_that_keeps_its_speed_is_not_taken_for_one_that_tilts():
    """Speed that lasts was taken for tilt, and moved the bias by 1.7e-3 rad/s."""
    judged = [judge(ride(VEHICLES['car'], seed, 300.0, warm_up=0.0)) for seed in range(4)]
    assert np.mean([one.on[2] for one in judged]) < 1.0


@pytest.mark.slow
def test_a_train_that_speeds_up_for_a_minute_is_not_taken_for_one_that_tilts():
    """What it had gained in speed was a tilt of 0.1 rad, and moved the bias by 0.8e-3 rad/s."""
    judged = [judge(ride(train, seed, 300.0, warm_up=0.0)) for seed in range(4)]
    assert np.mean([one.on[2] for one in judged]) < 0.5


def made(off, on):
    return Judged(np.full(3, off), np.full(3, on), np.zeros(3), 0.9)


def test_what_is_worse_or_hardly_better_is_told():
    worse = [made(1.0, 2.0), made(1.1, 2.0), made(1.0, 2.1)]
    assert [line for line in misses('car', worse) if 'attitude is worse' in line]
    assert misses('car', [made(2.0, 1.9), made(2.0, 2.0), made(1.0, 1.1)]) == []
    assert misses('drone', worse[:1] * 2) != []
    assert misses('drone', [made(2.0, 1.0), made(2.0, 1.2)]) == []
    hardly = misses('drone', [made(2.0, 1.8), made(2.0, 1.7)])
    assert hardly == ['drone: 88 % of the error of tilt is left']


def test_what_speeds_up_for_a_minute_may_cost_what_is_told_and_no_more():
    twice = [made(1.0, 2.4), made(1.1, 2.4), made(1.0, 2.5)]
    assert misses('train', twice) == ['train: heading is worse', 'train: attitude is worse']
    assert 'train: tilt is worse' in misses('train', [made(1.0, 2.6), made(1.0, 2.7)])


def test_the_benchmark_fails_where_a_bar_does_not_hold(monkeypatch, capsys):
    monkeypatch.setattr(benchmark, 'ride', lambda *arguments, **options: None)
    monkeypatch.setattr(benchmark, 'judge', lambda of: made(1.0, 2.0))
    assert benchmark.main(['--only', 'car', '--seeds', '2', '--check']) == 1
    assert 'FALLS SHORT  car: heading is worse' in capsys.readouterr().out
    monkeypatch.setattr(benchmark, 'judge', lambda of: made(1.0, 1.0))
    assert benchmark.main(['--only', 'car', '--seeds', '2', '--check']) == 0
    assert 'benchmark.vehicles --check' in (REPOSITORY / 'Makefile').read_text()


@pytest.mark.parametrize('rate', [0.5, 3.0])
def test_errors_of_the_scale_move_no_bias_of_a_body_that_rolls(rate):
    """By more than it is off by itself, which is 0.2e-3 rad/s."""
    of = ride(rolling(rate), 1, 120.0, warm_up=0.0, scale=0.01, misalignment=0.01)
    assert bias_error(of, in_motion=True) < 3e-4
    assert 'benchmark.scale' in (REPOSITORY / 'Makefile').read_text()
