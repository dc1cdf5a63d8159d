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

"""Parameter `calibration.acceleration_sensitivity`: found by the rests, taken off first."""

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from gyro_drift_filter.calibrate.calibration import Samples, calibrate
from gyro_drift_filter.calibrate.exchange import Noise, from_kalibr, to_kalibr
from gyro_drift_filter.core import Filter, ParameterError, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides
from support.handling import simulate_handling

# In rad/s per m/s^2: 0.1 deg/s for 1 g and less, as data sheets have it.
SENSITIVITY = 1e-4 * np.array([[0.1, 0.5, 0.9], [-2.0, 0.04, 1.4], [-1.0, -1.2, 0.3]])
NAME = 'calibration.acceleration_sensitivity'


def parameters(method='adaptive'):
    return Parameters.from_names({'method': method, NAME: SENSITIVITY.ravel().tolist()})


def sensitive(data):
    return data.angular_velocity + data.linear_acceleration @ SENSITIVITY.T


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_what_accelerations_add_is_gone(method):
    data = simulate_handling()
    force = data.linear_acceleration
    plain = Filter(Parameters(method=method)).run(data.stamps, data.angular_velocity, force)
    raw = sensitive(data)
    found = Filter(parameters(method)).run(data.stamps, raw, force)
    for name in ('angular_velocity', 'innovation', 'bias'):
        np.testing.assert_allclose(found[name], plain[name], rtol=0, atol=1e-9)
    np.testing.assert_array_equal(found['outlier'], plain['outlier'])
    # Without it the bias is that of one side, and wrong on the next by 1e-3 rad/s.
    wrong = Filter(Parameters(method=method)).run(data.stamps, raw, force)
    assert np.abs(wrong['angular_velocity'] - plain['angular_velocity']).max() > 5e-4


def test_an_acceleration_that_is_none_is_that_of_the_sample_before():
    data = simulate_handling()
    raw, force = sensitive(data), data.linear_acceleration.copy()
    good = Filter(parameters()).run(data.stamps, raw, force)
    held = force.copy()
    for first, value in ((200, np.nan), (500, np.inf), (900, 3e4)):
        force[first : first + 5, 1] = value
        held[first : first + 5] = held[first - 1]
    found = Filter(parameters()).run(data.stamps, raw, force)
    assert np.isfinite(found['angular_velocity']).all()
    wrong = np.abs(found['angular_velocity'] - good['angular_velocity'])
    assert wrong[200:].max() < 2e-3
    # Before the first acceleration, and without an accelerometer, nothing is taken off.
    none = np.full_like(force, np.nan)
    plain = Filter(Parameters()).run(data.stamps, data.angular_velocity, none)
    found = Filter(parameters()).run(data.stamps, data.angular_velocity, none)
    np.testing.assert_array_equal(found['angular_velocity'], plain['angular_velocity'])


def test_zeros_on_all_axes_are_still_a_drop_out():
    data = simulate_handling()
    raw = sensitive(data)
    start = int(np.flatnonzero(data.moving)[300])
    raw[start : start + 3] = 0.0
    found = Filter(parameters()).run(data.stamps, raw, data.linear_acceleration)
    assert found['outlier'][start : start + 3].all()


def test_the_sample_of_the_caller_stays_as_it_is():
    filter_ = Filter(parameters())
    rate, force = np.array([0.1, 0.2, 0.3]), np.array([0.0, 0.0, GRAVITY])
    filter_.step(10**18, rate, force)
    np.testing.assert_array_equal(rate, [0.1, 0.2, 0.3])
    np.testing.assert_array_equal(filter_.state['checks']['measured'], rate)


def test_set_while_running_the_bias_is_found_anew():
    data = simulate_handling()
    raw, n = sensitive(data), 500
    assert not data.moving[:n].any()
    filter_ = Filter(Parameters())
    filter_.run(data.stamps[:n], raw[:n], data.linear_acceleration[:n])
    before = filter_.bias_deviation.copy()
    filter_.configure(parameters())
    moved = GRAVITY * np.linalg.norm(SENSITIVITY, axis=1).max()
    np.testing.assert_allclose(filter_.bias_deviation, np.hypot(before, moved), rtol=1e-3)
    # The sensor stands for ten seconds more.
    stamps = data.stamps[n - 1] + 10**7 * np.arange(1, 1001)
    again = np.resize(np.arange(100, n), 1000)
    filter_.run(stamps, raw[again], data.linear_acceleration[again])
    np.testing.assert_allclose(filter_.state['bias']['bias'], data.bias, atol=2e-4)


@pytest.mark.parametrize(
    ('value', 'message'),
    [
        ([0.0] * 8 + [0.02], r'\(row z, column z\) must be at least -0.01 and at most 0.01'),
        ([float('nan')] + [0.0] * 8, r'\(row x, column x\)'),
        ([1e-4] * 3, 'a list of nine numbers, row by row'),
    ],
)
def test_what_no_gyroscope_has_is_refused(value, message):
    with pytest.raises(ParameterError, match=message):
        Parameters.from_names({NAME: value})


def laid_down(random, sensitivity, poses=None, **options):
    turns = lay_down(random, poses or sides(random), random_faults(random), rate=50.0, **options)
    rates = turns.rates + turns.accelerations @ sensitivity.T
    return Samples(turns.stamps, rates, turns.accelerations), turns.faults


@pytest.mark.slow
def test_calibrate_finds_it(random):
    recording, faults = laid_down(random, SENSITIVITY)
    found = calibrate([recording])
    assert found.sensitivity is not None
    wrong = found.sensitivity.matrix - SENSITIVITY
    assert np.abs(wrong).max() < 2e-5
    assert (np.abs(wrong) < 5.0 * found.sensitivity.deviation).all()
    assert (np.abs(found.matrix - faults.matrix) < 5.0 * found.deviation).all()


@pytest.mark.slow
def test_two_recordings_tell_more_than_one(random):
    poses = sides(random)
    first, _ = laid_down(random, SENSITIVITY, poses[:7])
    second, _ = laid_down(random, SENSITIVITY, poses[5:])
    both, alone = calibrate([first, second]), calibrate([first])
    assert both.sensitivity.deviation.sum() < alone.sensitivity.deviation.sum()
    assert np.abs(both.sensitivity.matrix - SENSITIVITY).max() < 4e-5


@pytest.mark.slow
def test_a_sensor_without_it_is_not_given_any(random):
    for _ in range(5):
        recording, _ = laid_down(random, np.zeros((3, 3)))
        assert calibrate([recording]).sensitivity is None


def test_few_rests_do_not_tell(random):
    poses = [Rotation.from_rotvec([1.5 * k, 0.0, 0.0]) for k in range(4)]
    recording, _ = laid_down(random, SENSITIVITY, poses)
    assert calibrate([recording]).sensitivity is None


def test_kalibr_has_it_in_axes_of_its_own(random):
    matrix = np.eye(3) + 0.03 * random.standard_normal((3, 3))
    accelerometer = np.triu(np.eye(3) + 0.02 * random.standard_normal((3, 3)))
    noise = Noise(1e-4, None, None, 100.0)
    text = to_kalibr(noise, '/imu', matrix, accelerometer, SENSITIVITY)
    imu = yaml.safe_load(text)['imu0']
    gyroscopes = imu['gyroscopes']
    turned = np.array(gyroscopes['C_gyro_i'])
    # What Kalibr predicts of a true rate and acceleration, in the axes of its body.
    force = np.array([1.0, -2.0, GRAVITY])
    added = np.array(gyroscopes['A']) @ turned @ force
    raw = np.array(imu['accelerometers']['M']) @ force
    np.testing.assert_allclose(added, SENSITIVITY @ raw, atol=1e-12)
    np.testing.assert_allclose(np.array(imu['Tg']) @ force, added, atol=1e-12)
    np.testing.assert_allclose(from_kalibr(yaml.safe_load(text)).sensitivity, SENSITIVITY)
