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

"""Rates and accelerations that are not of one motion, beside a bias that is known."""

import numpy as np
import pytest

from benchmark.contradictions import ACCELEROMETERS
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sensor_changes import doubt_sensor
from gyro_drift_filter.simulation.vehicles import VEHICLES, ride, train
from support.messages import START, even_stamps
from support.paths import FLIGHTS, recorded
from support.sensor import DEGREE, at_rest, by_hand

RATE = 200.0  # Hz
OTHER_AXES_NAMES = ('axes y, z, x', 'axes y, x, z', 'axes -x, y, z')
OTHER_AXES = ACCELEROMETERS['axes y, z, x']


def told(filter_, stamps, rates, accelerations):
    """Return for each second whether a contradiction is told at its end."""
    out = []
    for first in range(0, len(stamps), round(RATE)):
        part = slice(first, first + round(RATE))
        filter_.run(stamps[part], rates[part], accelerations[part])
        out.append(bool(filter_.state['bias']['contradicts']))
    return np.array(out)


@pytest.fixture(scope='module')
def walk():
    """A hand, after a rest."""
    return ride(VEHICLES['hand'], 1, 700.0, RATE, 0.0)


@pytest.mark.slow
@pytest.mark.parametrize('name', OTHER_AXES_NAMES)
def test_other_axes_are_told_within_a_minute_in_a_hand(name, walk):
    part, filter_ = slice(0, round(120 * RATE)), Filter()
    accelerations = ACCELEROMETERS[name](walk.accelerations)
    seconds = told(filter_, walk.stamps[part], walk.rates[part], accelerations[part])
    assert seconds[60:].all()
    assert filter_.state['bias']['known']


@pytest.mark.slow
@pytest.mark.parametrize('vehicle', [*VEHICLES.values(), train])
def test_the_motion_of_one_body_is_no_contradiction(vehicle):
    of = ride(vehicle, 1, 300.0, RATE, 0.0)
    filter_ = Filter()
    assert not told(filter_, of.stamps, of.rates, of.accelerations).any()
    assert filter_.state['bias']['motion']['contradictions'] == 0


@pytest.mark.slow
def test_on_real_flights_other_axes_are_told_within_90_s_and_sound_ones_are_not():
    """Nor are those of walks."""
    files = sorted(recorded(FLIGHTS).glob('*.npz'))
    assert files
    for file in files:
        data = np.load(file)
        stamps, rates, forces = data['t'], data['rate'].astype(float), data['acc'].astype(float)
        assert not told(Filter(), stamps, rates, forces).any()
        for name in OTHER_AXES_NAMES if file.name.startswith('euroc') else ():
            assert told(Filter(), stamps, rates, ACCELEROMETERS[name](forces))[:90].any()


@pytest.mark.slow
def test_then_the_bias_is_that_at_rest():
    """A car with such an accelerometer lost 0.18 deg/s to what gravity seemed to show."""
    of = ride(VEHICLES['car'], 1, 300.0, RATE, 0.0, 0.5 * DEGREE)
    on, off = Filter(), Filter(Parameters(bias_in_motion=False))
    biases = [
        filter_.run(of.stamps, of.rates, OTHER_AXES(of.accelerations))['bias'][-round(60 * RATE) :]
        for filter_ in (on, off)
    ]
    assert on.state['bias']['contradicts']
    np.testing.assert_array_equal(*biases)
    np.testing.assert_array_equal(on.bias_deviation, off.bias_deviation)
    np.testing.assert_array_equal(on.bias_shift.shift, 0.0)  # for the next run


@pytest.mark.slow
def test_once_they_are_sound_again_it_is_told_no_more(walk):
    change, filter_ = round(100 * RATE), Filter()
    accelerations = walk.accelerations.copy()
    accelerations[:change] = OTHER_AXES(accelerations[:change])
    seconds = told(filter_, walk.stamps, walk.rates, accelerations)
    assert seconds[60:100].all()
    assert not seconds[500:].any()
    error = filter_.run(walk.stamps[-1:] + 5_000_000, walk.rates[-1:], accelerations[-1:])['bias']
    assert np.linalg.norm(error - walk.bias[-1]) < 0.1 * DEGREE


@pytest.mark.slow
def test_garbage_for_a_while_is_no_contradiction(walk):
    """It may have a velocity beyond all robots once."""
    accelerations = walk.accelerations.copy()
    accelerations[round(60 * RATE) : round(66 * RATE)] = OTHER_AXES(
        accelerations[round(60 * RATE) : round(66 * RATE)]
    )
    assert not told(Filter(), walk.stamps, walk.rates, accelerations).any()


@pytest.mark.slow
def test_a_driver_that_raises_its_rate_in_motion_is_no_contradiction(walk):
    """For up to ten seconds gravity was turned by four times the angle."""
    changes, end = round(60 * RATE), round(200 * RATE)
    kept = np.r_[0:changes:4, changes:end]
    of = walk.stamps[kept], walk.rates[kept], walk.accelerations[kept]
    assert not told(Filter(), *of).any()


def test_it_is_forgotten_with_the_sensor(walk):
    part, filter_ = slice(0, round(100 * RATE)), Filter()
    accelerations = OTHER_AXES(walk.accelerations[part])
    assert told(filter_, walk.stamps[part], walk.rates[part], accelerations)[-1]
    kept = filter_.snapshot()
    doubt_sensor(filter_.record[0])
    assert not filter_.state['bias']['contradicts']
    filter_.restore(kept)
    assert filter_.state['bias']['contradicts']
    filter_.set_bias((0.0, 0.0, 0.0))
    assert not filter_.state['bias']['contradicts']


def test_without_gravity_to_show_a_bias_nothing_is_told(walk):
    """Where `bias.in_motion` is switched off, or the accelerometer falls silent."""
    part, later = slice(0, round(100 * RATE)), slice(round(100 * RATE), round(102 * RATE))
    other_axes = OTHER_AXES(walk.accelerations)
    filter_ = Filter()
    assert told(filter_, walk.stamps[part], walk.rates[part], other_axes[part])[-1]
    kept = filter_.snapshot()
    filter_.configure(Parameters(bias_in_motion=False))
    assert not told(filter_, walk.stamps[later], walk.rates[later], other_axes[later]).any()
    filter_ = Filter()
    filter_.restore(kept)
    silent = np.full_like(other_axes[later], np.nan)
    assert not told(filter_, walk.stamps[later], walk.rates[later], silent)[-1]


def test_beside_a_dead_axis_nothing_is_told(walk):
    """Nobody knows how the body turns about it, and a warning says that it is dead."""
    rates = walk.rates * [0.0, 1.0, 1.0]
    part = slice(0, round(200 * RATE))
    assert not told(Filter(), walk.stamps[part], rates[part], walk.accelerations[part]).any()


@pytest.mark.slow
@pytest.mark.parametrize('drift', [0.0, 0.35])
def test_a_rest_ends_a_contradiction_that_the_bias_explains(drift, random):
    """As of a sensor that warms up on the way, by less than the filter allows for."""
    still, moving, after = at_rest(random, 20), at_rest(random, 300), at_rest(random, 20)
    turn, push = by_hand(random, 300)  # gravity does not turn with it
    bias = np.array([drift, -0.4 * drift, 0.0]) * DEGREE
    rates = np.vstack([still[0], moving[0] + turn, after[0] + bias])
    accelerations = np.vstack([still[1], moving[1] + push, after[1]])
    filter_ = Filter()
    filter_.run(even_stamps(32_000), rates[:32_000], accelerations[:32_000])
    assert filter_.state['bias']['contradicts']
    later = slice(32_000, None)
    stamps = START + 10**7 * (32_000 + np.arange(2000))
    filter_.run(stamps, rates[later], accelerations[later])
    assert filter_.state['bias']['contradicts'] == (drift == 0.0)


@pytest.mark.slow
def test_a_rest_that_finds_another_bias_ends_the_contradiction():
    """A bias that had jumped on the way was told as one for minutes after it was known again."""
    of, jump = ride(VEHICLES['car'], 2, 330.0, RATE, 0.0), round(80 * RATE)
    of.rates[jump:] += 1.2 * DEGREE
    seconds = told(Filter(), of.stamps, of.rates, of.accelerations)
    assert seconds.any()
    assert not seconds[-30:].any()
