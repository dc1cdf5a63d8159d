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

"""Outliers, bias with its uncertainty, and trend: simulated data with known truth."""

import numpy as np
import pytest
from scipy.signal import lfilter

from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.preprocess import mean_deviation, preprocess
from gyro_drift_filter.identify.quiet import SampleSpan, find_quiet
from gyro_drift_filter.identify.timing import learn_timing

PERIOD = 0.01
NOISE = 0.005
N = 20_000
TIME = np.arange(N) * PERIOD
WHOLE = [SampleSpan(0, N)]


def without_gaps(values, spans):
    """Preprocess spans of a recording in which no sample is missing."""
    return preprocess(values, spans, PERIOD, [span.first * PERIOD for span in spans])


def noise(random, n=N):
    return NOISE * random.standard_normal(n)


def test_bias_without_trend(random):
    result = without_gaps(0.01 + noise(random), WHOLE)
    assert abs(result.bias - 0.01) < 4 * result.bias_deviation
    assert result.trend_order == 0
    assert result.trend == ()
    assert result.outliers == 0
    assert abs(np.concatenate(result.residuals).mean()) < 1e-15


@pytest.mark.slow
@pytest.mark.parametrize('phi', [0.0, 0.9])
def test_the_uncertainty_of_the_bias_covers_the_truth(phi):
    hits, ratios = 0, []
    for seed in range(200):
        values = lfilter([1.0], [1.0, -phi], noise(np.random.default_rng(seed)))
        result = without_gaps(values, WHOLE)
        hits += abs(result.bias) < 1.96 * result.bias_deviation
        ratios.append(result.bias_deviation * (1 - phi) * np.sqrt(N) / NOISE)
    assert hits >= 184
    assert 0.9 < np.median(ratios) < 1.5


def test_the_uncertainty_grows_where_the_bias_wanders(random):
    wander = 1e-5 * np.cumsum(random.standard_normal(N))
    still = mean_deviation([noise(random)])
    assert mean_deviation([noise(random) + wander]) > 3 * still


def test_a_linear_trend_is_found_in_its_units(random):
    result = without_gaps(0.01 + 2e-5 * TIME + noise(random), WHOLE)
    assert result.trend_order == 1
    np.testing.assert_allclose(result.trend, [2e-5], rtol=0.05)
    np.testing.assert_allclose(result.bias, 0.01 + 2e-5 * TIME.mean(), atol=2e-4)
    np.testing.assert_allclose(result.trend_centre, TIME.mean())
    np.testing.assert_allclose(np.std(result.residuals[0]), NOISE, rtol=0.03)


def test_warm_up_takes_order_two(random):
    result = without_gaps(0.02 * np.exp(-TIME / 100) + noise(random), WHOLE)
    assert result.trend_order == 2
    np.testing.assert_allclose(np.std(result.residuals[0]), NOISE, rtol=0.1)


@pytest.mark.slow
def test_no_trend_is_made_up():
    orders = [
        without_gaps(noise(np.random.default_rng(seed)), WHOLE).trend_order for seed in range(100)
    ]
    assert np.count_nonzero(orders) <= 3


def test_outliers_are_replaced_and_counted(random):
    values = 0.01 + 1e-5 * TIME + noise(random)
    clean = without_gaps(values, WHOLE)
    where = random.choice(N, 100, replace=False)
    values[where] += random.choice([-0.5, 5.0], 100)
    result = without_gaps(values, WHOLE)
    assert result.outliers == 100
    np.testing.assert_allclose(result.bias, clean.bias, atol=1e-5)
    np.testing.assert_allclose(np.std(result.residuals[0]), NOISE, rtol=0.03)
    np.testing.assert_allclose(np.mean(result.cleaned[0]), result.bias)


def test_noise_of_a_coarse_sensor_is_no_outlier(random):
    step = 3 * NOISE
    result = without_gaps(step * np.round(noise(random) / step), WHOLE)
    assert result.outliers == 0


def test_samples_that_are_not_finite_are_replaced_and_counted(random):
    values = noise(random)
    values[[5, 100, 101, N - 1]] = np.nan, np.inf, -np.inf, np.nan
    result = without_gaps(values, WHOLE)
    assert result.missing == 4
    assert np.isfinite(result.residuals[0][:]).all()
    assert len(result.residuals[0]) == N


def test_spans_share_bias_and_trend(random):
    values = 0.01 + 2e-5 * TIME + noise(random)
    values[8000:12000] = 3.0
    result = without_gaps(values, [SampleSpan(0, 8000), SampleSpan(12000, N)])
    assert [len(span) for span in result.residuals] == [8000, 8000]
    np.testing.assert_allclose(result.trend, [2e-5], rtol=0.05)


def test_the_trend_counts_a_gap_of_time(random):
    pieces = [SampleSpan(0, N // 2), SampleSpan(N // 2, N)]
    time = np.where(TIME < 100, TIME, TIME + 500)
    values = 1e-5 * time + noise(random)
    result = preprocess(values, pieces, PERIOD, begins=[0.0, 600.0])
    assert result.trend_order == 1
    np.testing.assert_allclose(result.trend, [1e-5], rtol=0.05)


@pytest.mark.parametrize(
    ('values', 'text'),
    [(np.zeros(63), 'too few'), (np.full(200, np.nan), 'not finite')],
)
def test_too_little_is_an_error(values, text):
    with pytest.raises(IdentificationError, match=text):
        without_gaps(values, [SampleSpan(0, len(values))])


@pytest.mark.slow
def test_the_bias_of_a_real_sensor(real):
    stamps, rates, accelerations = real('static_adis16405')
    spans = find_quiet(learn_timing(stamps), rates, accelerations).spans
    biases = [without_gaps(rates[:, axis], spans).bias for axis in range(3)]
    np.testing.assert_allclose(np.degrees(biases), [0.401, -0.388, -0.276], atol=0.01)


@pytest.mark.slow
def test_the_bias_is_that_of_the_longest_rest_and_its_error_covers_the_others(random):
    """The mean of a day whose bias moves is that of no time, and was given as known."""
    values = 0.01 + 1e-4 * TIME + noise(random)
    spans = [SampleSpan(0, 2000), SampleSpan(6000, 12000), SampleSpan(N - 2000, N)]
    result = without_gaps(values, spans)
    middles, lengths = np.array([10.0, 90.0, N * PERIOD - 10.0]), [2000, 6000, 2000]
    np.testing.assert_allclose(result.bias, 0.01 + 1e-4 * 90.0, atol=1e-4)
    moves = np.sqrt(np.average((1e-4 * (middles - 90.0)) ** 2, weights=lengths))
    np.testing.assert_allclose(result.bias_deviation, moves, rtol=0.05)
    alone = without_gaps(values, [spans[1]])
    assert alone.bias == result.bias
    assert alone.bias_deviation < 0.1 * moves


@pytest.mark.slow
def test_rests_of_one_bias_show_it_together():
    """What the errors of their means explain is no move of the bias."""
    spans = [SampleSpan(k, k + 1000) for k in range(0, N, 2000)] + [SampleSpan(N - 900, N)]
    ratios, moves = [], 0
    for seed in range(100):
        values = noise(np.random.default_rng(seed))
        result = without_gaps(values, spans)
        moves += result.bias_moves
        ratios.append(result.bias_deviation * np.sqrt(sum(map(len, spans))) / NOISE)
    assert moves <= 2
    assert 0.9 < np.median(ratios) < 1.5
