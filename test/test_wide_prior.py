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

"""The filter of a bias of which nothing is known: its equations, and whether its errors fit."""

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from benchmark.without_rest import HINT_EVERY, SAMPLE_RATE, started_in_motion
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.motion_state import ACCELERATION, BIAS
from gyro_drift_filter.core.bias.without_rest import _across, _error_variance
from gyro_drift_filter.simulation.vehicles import VEHICLES
from support.sensor import DEGREE

GRAVITY, SPEED, SPEED_SECONDS, BLOCK, VALUE = 9.80665, 0.7, 2.1, 40, 0.01
UP, VELOCITY, GYROSCOPE, ACCELEROMETER, MEAN = (slice(3 * i, 3 * i + 3) for i in range(5))


def cross(vector):
    return np.cross(np.eye(3), vector)


def transcribed(rates, accelerations, turn_on):
    """Return the states (15,) and covariance after values (n, 3) of 10 ms, by dense matrices."""
    up = np.zeros(3)
    for rate, acceleration in zip(rates[:100], accelerations[:100], strict=True):
        up = expm(-cross(rate) * VALUE) @ up + acceleration
    x, remembered = np.zeros(15), np.exp(-BLOCK * VALUE / 120.0)
    x[UP] = up / np.linalg.norm(up)
    variances = np.square([0.3, 1.0, turn_on, 0.1, SPEED])
    covariance = np.diag(np.repeat(variances, 3))
    for first in range(100, len(rates) - BLOCK + 1, BLOCK):
        turn, integral = np.eye(3), np.zeros((3, 3))
        for i in range(first, first + BLOCK):
            step = expm(-cross(rates[i] - x[GYROSCOPE]) * VALUE)
            x[UP] = step @ x[UP]
            force = accelerations[i] - x[ACCELEROMETER] - GRAVITY * x[UP]
            faster = step @ x[VELOCITY] + force * VALUE - x[MEAN]
            x[VELOCITY] = x[MEAN] + faster * np.exp(-VALUE / SPEED_SECONDS)
            turn, integral = step @ turn, step @ integral + VALUE * np.eye(3)
        seconds = BLOCK * VALUE
        left = np.exp(-seconds / SPEED_SECONDS)
        across = cross(x[UP]) @ integral
        transition = block_diag(turn, left * turn, np.eye(6), remembered * np.eye(3))
        transition[UP, GYROSCOPE] = -across
        transition[VELOCITY, UP] = -GRAVITY * seconds * turn
        transition[VELOCITY, GYROSCOPE] = 0.5 * GRAVITY * seconds * across
        transition[VELOCITY, GYROSCOPE] -= cross(x[VELOCITY]) @ integral
        transition[VELOCITY, ACCELEROMETER] = -integral
        transition[VELOCITY, MEAN] = (1.0 - left) * np.eye(3)
        x[MEAN] *= remembered
        turned = 1e-6 * seconds + 1e-4 * (3.0 - np.trace(turn))
        noise = turned, 0.05**2 * seconds, 0.0, 0.0, SPEED**2 * (1.0 - remembered**2)
        covariance = transition @ covariance @ transition.T + np.diag(np.repeat(noise, 3))
        # The velocity is the mean one.
        row = np.zeros((3, 15))
        row[:, VELOCITY], row[:, MEAN] = np.eye(3), -np.eye(3)
        variance = SPEED**2 * 2.0 * SPEED_SECONDS / seconds * np.eye(3)
        gain = covariance @ row.T @ np.linalg.inv(row @ covariance @ row.T + variance)
        x = x - gain @ row @ x
        covariance = covariance - gain @ row @ covariance
        # The direction stays one of length one.
        x[UP] /= np.linalg.norm(x[UP])
        projection = np.eye(15)
        projection[UP, UP] -= np.outer(x[UP], x[UP])
        covariance = projection @ covariance @ projection
    return x, covariance


@pytest.mark.slow
def test_it_is_its_equations():
    """Beside dense matrices, over a minute of a hand with a bias of which nothing is known."""
    of = started_in_motion('hand', 3, 2.0 * DEGREE)
    count = round(61.0 * SAMPLE_RATE)
    filter_ = Filter(Parameters(bias_random_walk=1e-8))
    results = filter_.run(of.stamps[:count], of.rates[:count], of.accelerations[:count])
    assert not results['outlier'].any()
    rates, accelerations = (
        part[:count].reshape(-1, 2, 3).mean(axis=1) for part in (of.rates, of.accelerations)
    )
    turn_on = filter_.parameters.bias_turn_on_deviation
    x, covariance = transcribed(rates, accelerations, turn_on)
    motion = filter_.state['bias']['wide_prior']
    np.testing.assert_allclose(motion['state_vector'][:15], x, atol=1e-4)
    deviations = np.sqrt(np.diag(covariance))
    difference = motion['covariance'][:15, :15] - covariance
    assert np.abs(difference / np.outer(deviations, deviations)).max() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize('vehicle', VEHICLES)
def test_its_errors_are_within_its_deviation(vehicle):
    """What a correction lengthened the direction by was taken for measured.

    An accelerometer's bias of up to 3.2 m/s^2 came of it, and errors were up to twice as large.
    """
    squares = {12.0: [], 20.0: [], 30.0: [], 60.0: []}
    length = round(HINT_EVERY * SAMPLE_RATE)
    for seed in range(6):
        of, filter_ = started_in_motion(vehicle, seed, 2.0 * DEGREE), Filter()
        motion = filter_.state['bias']['wide_prior']
        for begin in range(0, round(60.0 * SAMPLE_RATE), length):
            filter_.hint(True)
            part = slice(begin, begin + length)
            filter_.run(of.stamps[part], of.rates[part], of.accelerations[part])
            found = squares.get(part.stop / SAMPLE_RATE)
            if found is not None:
                vector, own = motion['state_vector'], slice(BIAS, BIAS + 3)
                assert np.abs(vector[ACCELERATION : ACCELERATION + 3]).max() < 0.5
                error = vector[own] - of.bias[part.stop - 1]
                for axis in _across(tuple(vector[:3])):
                    own_variance = axis @ motion['covariance'][own, own] @ axis
                    found.append((axis @ error) ** 2 / _error_variance(motion, own_variance))
    assert all(np.mean(found) < 2.5 for found in squares.values())
