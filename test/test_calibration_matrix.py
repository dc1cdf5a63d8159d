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

"""Parameter `calibration.matrix`: applied last, to rate and covariance, and to nothing else."""

import numpy as np
import pytest

from gyro_drift_filter.core import Filter, ParameterError, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.sample import RESULT
from gyro_drift_filter.messages.imu import read_message
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.simulation.bag import imu_message
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate

MATRIX = (1.02, 0.01, -0.02, 0.03, 0.97, 0.005, -0.01, 0.02, 1.31)
OUTPUT = ('angular_velocity', 'angular_velocity_variance', 'angular_velocity_covariance')


def recording():
    return simulate(SimulationSettings(static_seconds=15, dynamic_seconds=5))


def run(filter_, data, span=slice(None)):
    return filter_.run(
        data.stamps[span], data.angular_velocity[span], data.linear_acceleration[span]
    )


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_rate_and_covariance_are_mapped_and_nothing_else(method):
    data, matrix = recording(), np.reshape(MATRIX, (3, 3))
    plain = run(Filter(Parameters(method=method)), data)
    mapped = run(Filter(Parameters(method=method, calibration_matrix=MATRIX)), data)
    for name in RESULT.names:
        if name not in OUTPUT:
            np.testing.assert_array_equal(mapped[name], plain[name])
    assert not plain['angular_velocity_covariance'].any()
    expected = plain['angular_velocity'] @ matrix.T
    np.testing.assert_allclose(mapped['angular_velocity'], expected, rtol=0, atol=1e-15)
    for k in (0, 700, 1999):
        whole = matrix @ np.diag(plain['angular_velocity_variance'][k]) @ matrix.T
        np.testing.assert_allclose(mapped['angular_velocity_variance'][k], np.diag(whole))
        above = whole[np.triu_indices(3, 1)]
        np.testing.assert_allclose(mapped['angular_velocity_covariance'][k], above)


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_it_is_set_while_running_without_touching_what_was_learned(method):
    data = recording()
    parameters = Parameters(method=method)
    plain, changing = Filter(parameters), Filter(parameters)
    for matrix, span in (
        (MATRIX, slice(0, 900)),
        (parameters.calibration_matrix, slice(900, 1700)),
    ):
        changing.configure(parameters.with_names({'calibration.matrix': matrix}))
        expected, got = run(plain, data, span), run(changing, data, span)
        np.testing.assert_array_equal(got['bias'], expected['bias'])
        np.testing.assert_array_equal(got['innovation'], expected['innovation'])
    np.testing.assert_array_equal(got['angular_velocity'], expected['angular_velocity'])
    assert not got['angular_velocity_covariance'].any()


@pytest.mark.parametrize('then', METHOD_NAMES)
def test_another_method_takes_over_in_the_axes_of_the_sensor(then):
    data = recording()
    results = []
    for matrix in ((1.0, 0, 0, 0, 1.0, 0, 0, 0, 1.0), MATRIX):
        filter_ = Filter(Parameters(calibration_matrix=matrix))
        run(filter_, data, slice(0, 1000))
        filter_.configure(filter_.parameters.with_names({'method': then}))
        results.append(run(filter_, data, slice(1000, 1100)))
    np.testing.assert_array_equal(results[0]['innovation'], results[1]['innovation'])


def test_the_message_holds_the_whole_covariance():
    filter_ = MessageFilter(Parameters(calibration_matrix=MATRIX))
    for k in range(50):
        message = filter_.take(
            imu_message(10**18 + k * 10**7, (0.1, 0.2, 0.3 + 1e-3 * (k % 3)), (0, 0, 9.8))
        )
    data = np.frombuffer(message, '<f8', offset=int(read_message(message)['doubles']))
    covariance = data[16:25].reshape(3, 3)
    result = filter_.filter.state['result']
    np.testing.assert_array_equal(np.diag(covariance), result['angular_velocity_variance'])
    above = covariance[np.triu_indices(3, 1)]
    np.testing.assert_array_equal(above, result['angular_velocity_covariance'])
    np.testing.assert_array_equal(covariance, covariance.T)
    assert above.all()
    assert (np.linalg.eigvalsh(covariance) > 0).all()
    assert filter_.report().parameters.calibration_matrix == MATRIX


@pytest.mark.parametrize(
    ('matrix', 'message'),
    [
        ([0.0] * 9, 'is singular'),
        ([1, 1, 0, 1, 1, 0, 0, 0, 1], 'is singular'),
        ([1, 0, 0, 0, 0.4, 0, 0, 0, 1], 'scales axis y by 0.4'),
        ([1, 0, 0, 0, 1, 0, 0, 0, 2.1], 'scales axis z by 2.1'),
        ([0, 1, 0, 1, 0, 0, 0, 0, 1], 'turns axis x by 90 deg'),
        ([-1, 0, 0, 0, 1, 0, 0, 0, 1], 'turns axis x by 180 deg'),
        ([1, 0, 0, 0, 0.9, -0.4359, 0, 0.4359, 0.9], 'turns axis y by 25.8 deg'),
        ([57.3, 0, 0, 0, 57.3, 0, 0, 0, 57.3], r'\(row x, column x\) must be at least -2.5'),
        ([1, 0, 0, 0, float('nan'), 0, 0, 0, 1], r'\(row y, column y\)'),
        ([1.0, 1.0, 1.0], 'a list of nine numbers, row by row'),
    ],
)
def test_what_is_no_calibration_is_refused(matrix, message):
    with pytest.raises(ParameterError, match=message):
        Parameters.from_names({'calibration.matrix': matrix})
