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

"""Allan deviation: coefficients of simulated noise come back, and a real sensor's figures."""

import numpy as np
import pytest

from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.allan import allan_deviation
from gyro_drift_filter.identify.preprocess import preprocess
from gyro_drift_filter.identify.quiet import find_quiet
from gyro_drift_filter.identify.timing import learn_timing

PERIOD = 0.01
DEGREES_PER_HOUR = np.degrees(1.0) * 3600
WALK = 1e-3  # rad/s/sqrt(Hz)


def white(random, n):
    return WALK / np.sqrt(PERIOD) * random.standard_normal(n)


def rate_walk(random, n, coefficient):
    return np.cumsum(coefficient * np.sqrt(PERIOD) * random.standard_normal(n))


def test_white_noise_gives_its_angle_random_walk(random):
    allan = allan_deviation([white(random, 100_000)], PERIOD)
    np.testing.assert_allclose(allan.angle_random_walk.value, WALK, rtol=0.03)
    assert allan.angle_random_walk.shortest <= 1.0 <= allan.angle_random_walk.longest
    np.testing.assert_allclose(allan.at(1.0), WALK, rtol=0.05)
    assert allan.rate_random_walk is None
    assert any('rate random walk' in text for text in allan.warnings)


def test_a_rate_random_walk_is_read_behind_the_minimum(random):
    allan = allan_deviation([white(random, 400_000) + rate_walk(random, 400_000, 2e-4)], PERIOD)
    np.testing.assert_allclose(allan.angle_random_walk.value, WALK, rtol=0.1)
    np.testing.assert_allclose(allan.rate_random_walk.value, 2e-4, rtol=0.3)
    bottom = allan.bias_instability
    np.testing.assert_allclose(bottom.value, allan.deviations.min() / 0.664)
    assert 2.0 < bottom.shortest < 20.0
    assert allan.warnings == ()


def test_a_short_recording_warns_that_the_instability_is_a_bound(random):
    allan = allan_deviation([white(random, 2_000)], PERIOD)
    assert any('too short for the bias instability' in text for text in allan.warnings)


def test_a_walk_alone_has_no_angle_random_walk(random):
    allan = allan_deviation([rate_walk(random, 20_000, 1e-3)], PERIOD)
    assert allan.angle_random_walk is None
    np.testing.assert_allclose(allan.rate_random_walk.value, 1e-3, rtol=0.3)


def test_the_overlapping_variance_by_its_definition(random):
    values = white(random, 500)
    allan = allan_deviation([values], PERIOD)
    for tau, deviation, count in zip(allan.taus, allan.deviations, allan.counts, strict=True):
        m = round(tau / PERIOD)
        means = np.convolve(values, np.full(m, 1 / m), 'valid')
        differences = means[m:] - means[:-m]
        assert count == len(differences)
        np.testing.assert_allclose(deviation, np.sqrt(0.5 * (differences**2).mean()))


def test_spans_are_combined_without_a_step_between(random):
    spans = [white(random, 20_000) + offset for offset in (0.0, 1.0, -1.0)]
    allan = allan_deviation([*spans, np.zeros(3)], PERIOD)
    np.testing.assert_allclose(allan.at(1.0), WALK, rtol=0.05)
    alone = allan_deviation(spans[:1], PERIOD)
    np.testing.assert_array_equal(allan.taus, alone.taus)
    assert (allan.counts > 2 * alone.counts).all()


@pytest.mark.parametrize(
    ('spans', 'text'),
    [([], 'too few'), ([np.ones(63)], 'too few'), ([np.ones(1000)], 'constant')],
)
def test_nothing_to_read_is_an_error(spans, text):
    with pytest.raises(IdentificationError, match=text):
        allan_deviation(spans, PERIOD)


def test_a_tau_beyond_the_curve_is_an_error(random):
    with pytest.raises(IdentificationError, match='at 100 s can not be read'):
        allan_deviation([white(random, 1000)], PERIOD).at(100.0)


@pytest.mark.slow
def test_a_real_sensor_has_its_known_figures(real):
    stamps, rates, accelerations = real('static_adis16405')
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    begins = [span.first * PERIOD for span in spans]
    curves = [
        allan_deviation(preprocess(rates[:, axis], spans, PERIOD, begins).cleaned, PERIOD)
        for axis in range(3)
    ]
    at_one = [curve.at(1.0) * DEGREES_PER_HOUR for curve in curves]
    at_hundred = [curve.at(100.0) * DEGREES_PER_HOUR for curve in curves]
    np.testing.assert_allclose(at_one, 150, rtol=0.1)
    np.testing.assert_allclose(at_hundred, [19, 35, 37], rtol=0.1)
    assert all(curve.angle_random_walk is not None for curve in curves)
