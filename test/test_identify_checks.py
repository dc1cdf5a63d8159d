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

"""The assumptions of the model: each passes on what it is for, and fails on its fault."""

import tracemalloc

import numpy as np
import pytest
from scipy.signal import lfilter

from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.checks import (
    check_normality,
    check_quantisation,
    check_stationarity,
    check_zero_mean,
    find_step,
    require_noise,
)

NOISE = 0.005
N = 20_000


@pytest.fixture
def values(random):
    return NOISE * random.standard_normal(N)


def failed(check):
    assert check.passed is False
    assert check.consequence.endswith('.')
    assert '\n' not in check.detail + check.consequence
    return check


def passed(check):
    assert check.passed is True
    assert check.consequence == ''
    return check


def test_white_noise_passes_all(values):
    passed(check_zero_mean([values]))
    passed(check_stationarity([values]))
    passed(check_normality([values]))
    passed(check_quantisation([values], NOISE))
    require_noise([values], 'x')


def test_spans_of_different_means_fail(values):
    halves = [values[: N // 4] + NOISE / 4, values[N // 4 :] - NOISE / 12]
    assert check_zero_mean(halves).statistic > check_zero_mean([values]).statistic
    many = [part + NOISE * (k == 3) for k, part in enumerate(np.split(values, 20))]
    failed(check_zero_mean(many))


def test_a_random_walk_fails_by_both(random):
    check = failed(check_stationarity([np.cumsum(random.standard_normal(N))]))
    assert 'random walk' in check.detail


def test_noise_about_a_wandering_level_fails_by_kpss(values):
    level = 0.1 * NOISE * np.sin(2 * np.pi * np.arange(N) / (1.3 * N))
    check = failed(check_stationarity([values + level]))
    assert 'wanders' in check.detail


@pytest.mark.slow
def test_a_steady_bias_is_not_said_to_move():
    """Of recordings of three good axes: at most one in ten, where chance makes one of 33 fail."""
    random, failures = np.random.default_rng(0), 0
    for _ in range(100):
        axes = random.standard_normal((3, 4000))
        failures += not all(check_stationarity([axis]).passed for axis in axes)
    assert failures <= 10


def test_short_slow_processes_are_mostly_undecided():
    """Sixty samples of noise with a time constant of ten samples: neither test can tell."""
    verdicts = []
    for seed in range(40):
        drive = np.random.default_rng(seed).standard_normal(60)
        check = check_stationarity([lfilter([1.0], [1.0, -0.9], drive)])
        verdicts.append('undecided' in check.detail)
        if verdicts[-1]:
            failed(check)
    assert sum(verdicts) > 20


@pytest.mark.parametrize('span', [np.zeros(10), np.zeros(1000)])
def test_stationarity_of_nothing_is_an_error(span):
    with pytest.raises(IdentificationError, match='stationarity'):
        check_stationarity([span])


def test_normality_goes_by_the_effect_and_not_by_p(random):
    large = random.standard_normal(1_000_000)
    barely = passed(check_normality([large + 0.01 * (large**2 - 1)]))
    assert barely.statistic > 100
    failed(check_normality([random.laplace(size=N)]))
    failed(check_normality([random.exponential(size=N)]))


@pytest.mark.parametrize('ratio', [0.05, 0.14, 0.6, 1.5])
@pytest.mark.parametrize('bias', [0.0, 0.0123])
def test_the_step_is_found(ratio, bias, values):
    step = ratio * NOISE
    coarse = step * np.round((values + bias) / step)
    np.testing.assert_allclose(find_step([coarse]), step, rtol=1e-6)
    check = check_quantisation([coarse], NOISE)
    np.testing.assert_allclose(check.statistic, ratio, rtol=1e-6)
    assert check.passed == (ratio < 0.5)


def test_no_step_is_found_where_there_is_none(values):
    assert find_step([values]) == 0.0
    assert find_step([np.zeros(10)]) == 0.0
    assert find_step([]) == 0.0


@pytest.mark.parametrize(
    ('fault', 'text'),
    [
        (lambda x: 0 * x, 'zero throughout'),
        (lambda x: 0 * x + 0.02, 'constant at 1.14592 deg/s'),
        (lambda x: x * np.nan, 'no finite sample'),
        (lambda x: np.where(np.abs(x) < NOISE, 0.0, x), 'dead band'),
        (lambda x: 10 * NOISE * np.round(x / NOISE / 5), 'too coarse'),
    ],
)
def test_an_axis_that_measures_nothing_is_an_error(fault, text, values):
    with pytest.raises(IdentificationError, match=f'axis y .*{text}'):
        require_noise([fault(values)], 'y')


def test_a_dead_band_of_a_quantised_axis_is_an_error(values):
    step = 0.2 * NOISE
    coarse = step * np.round(values / step)
    require_noise([coarse], 'x')
    with pytest.raises(IdentificationError, match='dead band'):
        require_noise([np.where(np.abs(coarse) < 5 * step, 0.0, coarse)], 'x')


def test_a_coarse_axis_passes_as_it_still_measures(values):
    step = 2 * NOISE
    require_noise([step * np.round(values / step)], 'x')


def test_a_million_samples_take_little_memory(random):
    million = [random.standard_normal(1_000_000)]
    tracemalloc.start()
    check_stationarity(million)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 200e6


@pytest.mark.slow
def test_a_real_sensor(real):
    _, rates, _ = real('static_adis16405')
    for axis in range(3):
        values = [rates[:, axis]]
        require_noise(values, 'xyz'[axis])
        np.testing.assert_allclose(np.degrees(find_step(values)), 0.05, rtol=1e-3)
        passed(check_normality([values[0] - values[0].mean()]))
