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

"""Models of the drift against simulated truth and against statsmodels."""

import numpy as np
import pytest
from scipy import signal
from statsmodels.tsa.arima.model import ARIMA

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.identify.models import (
    choose,
    fit_arma,
    fit_drift_and_white,
    fit_filter_noise,
    is_stable,
    paper_noise,
)

pytestmark = pytest.mark.slow


def arma(n, phi, theta, seed, deviation=1.0):
    driving = deviation * np.random.default_rng([seed, 17]).standard_normal(n + 500)
    numerator, denominator = np.r_[1.0, -np.array(theta)], np.r_[1.0, -np.array(phi)]
    return signal.lfilter(numerator, denominator, driving)[500:]


@pytest.mark.parametrize('order', range(1, 6))
def test_what_is_stable_has_all_roots_within_the_unit_circle(order, random):
    stable = 0
    for _ in range(500):
        roots = random.uniform(-1.1, 1.1, order).astype(complex)
        if order >= 2 and random.random() < 0.5:
            roots[1] = roots[0] * np.exp(1j * random.uniform(0.0, np.pi))
            roots[0] = roots[1].conjugate()
        coefficients = -np.poly(roots)[1:].real
        within = bool((np.abs(np.roots(np.r_[1.0, -coefficients])) < 1.0).all())
        assert is_stable(coefficients) == within
        stable += within
    assert 100 < stable < 500
    assert is_stable(coefficients[:0])
    assert not is_stable(np.append(coefficients, np.nan))


@pytest.mark.parametrize(
    ('phi', 'theta'), [([0.2134], []), ([0.5, -0.3], []), ([0.9], [0.5]), ([0.3, 0.2], [-0.4])]
)
def test_agrees_with_statsmodels(phi, theta):
    """Its exact likelihood in the time domain, on the same data."""
    data = arma(4000, phi, theta, seed=1)
    order = (len(phi), len(theta))
    (ours,) = fit_arma([data], [order])
    theirs = ARIMA(data, order=(order[0], 0, order[1]), trend='n').fit()
    np.testing.assert_allclose(ours.phi, theirs.arparams, atol=0.5 * ours.phi_deviation.max())
    np.testing.assert_allclose(
        ours.theta, -theirs.maparams, atol=0.5 * max([*ours.theta_deviation, 0.0])
    )
    np.testing.assert_allclose(ours.phi_deviation, theirs.bse[: order[0]], rtol=0.25)
    assert ours.variance == pytest.approx(theirs.params[-1], rel=0.01)
    assert ours.ljung_box > 1e-3


@pytest.mark.parametrize(
    ('phi', 'theta'), [([0.5], []), ([0.5, -0.3], []), ([0.9], [0.5]), ([], [])]
)
def test_the_order_is_found(phi, theta):
    found = [choose(fit_arma([arma(50_000, phi, theta, seed)])).order for seed in range(3)]
    assert found == 3 * [(len(phi), len(theta))]


@pytest.mark.parametrize('scale', [1e-4, 1.0])
def test_pieces_and_scale_make_no_difference(scale):
    data = scale * arma(60_000, [0.6], [], seed=3)
    (whole,) = fit_arma([data], [(1, 0)])
    (parts,) = fit_arma([data[:20_000], data[20_000:25_000], data[25_000:]], [(1, 0)])
    assert whole.phi[0] == pytest.approx(parts.phi[0], abs=0.003)
    assert parts.variance == pytest.approx(scale**2, rel=0.03)


@pytest.mark.parametrize(('phi', 'ratio'), [(0.2134, 4.0), (0.2134, 1.0), (0.9, 1.0), (0.9, 0.25)])
def test_drift_is_told_from_white_noise(phi, ratio):
    """Intervals of 95 % over 20 seeds: fewer than 15 hits happen once in 3,000 tries."""
    hits, estimates = np.zeros(3), []
    white = 1.0 / ratio
    for seed in range(20):
        drift = arma(20_000, [phi], [], seed, deviation=np.sqrt(1 - phi * phi))
        noise = white * np.random.default_rng([seed, 5]).standard_normal(20_000)
        found = fit_drift_and_white([drift + noise])
        assert found.identifiable
        estimates.append(found.phi)
        intervals = (
            (found.phi_interval, phi),
            (found.drift_variance_interval, 1.0),
            (found.white_variance_interval, white**2),
        )
        hits += [low <= truth <= high for (low, high), truth in intervals]
    assert (hits >= 15).all()
    spread = np.std(estimates) / np.sqrt(len(estimates))
    assert np.mean(estimates) == pytest.approx(phi, abs=0.02 * phi + 3 * spread)


@pytest.mark.parametrize('ratio', [0.5, 0.25])
def test_a_weak_drift_in_white_noise_is_called_not_identifiable(ratio):
    phi = 0.2134
    for seed in range(8):
        drift = arma(20_000, [phi], [], seed, deviation=np.sqrt(1 - phi * phi))
        noise = np.random.default_rng([seed, 5]).standard_normal(20_000) / ratio
        assert not fit_drift_and_white([drift + noise]).identifiable


@pytest.mark.parametrize(
    ('phi', 'theta'),
    [([0.05], [-0.6]), ([0.2], [-0.4]), ([-0.2], [0.4]), ([1.1, -0.4], [])],
)
def test_a_drift_of_more_variance_than_the_data_is_another_model(phi, theta):
    """As of samples that are sent twice, or that have passed a low-pass of second order."""
    for seed in range(3):
        assert not fit_drift_and_white([arma(20_000, phi, theta, seed)]).identifiable


@pytest.mark.parametrize('phi', [0.9, 0.5, -0.3])
def test_a_drift_alone_may_seem_to_have_more_variance_than_the_data_by_chance(phi):
    shares = []
    for seed in range(10):
        data = arma(20_000, [phi], [], seed)
        found = fit_drift_and_white([data])
        assert found.identifiable
        shares.append(found.drift_variance / np.var(data))
    assert min(shares) < 1.0 < max(shares)


def quantised(values, step):
    return step * np.round(values / step)


def low_passed(values, share):
    for _ in range(2):
        values = signal.lfilter([share], [1.0, share - 1.0], values)
    return values


# Noise (n,) of a sensor from white noise (n,) and other white noise.
SENSORS = {
    'white': lambda e, _: e,
    'drift': lambda e, _: signal.lfilter([1.0], [1.0, -0.9], e),
    'negative drift': lambda e, _: signal.lfilter([1.0], [1.0, 0.3], e),
    'faint drift': lambda e, _: signal.lfilter([1.0], [1.0, -0.05], e),
    'drift and white': lambda e, f: signal.lfilter([1.0], [1.0, -0.95], e) + 3 * f,
    'slow drift and white': lambda e, f: signal.lfilter([0.05], [1.0, -0.999], e) + f,
    'walk': lambda e, _: np.cumsum(e),
    'walk and white': lambda e, f: 0.02 * np.cumsum(e) + f,
    'quantised': lambda e, _: quantised(e, 1.5),
    'low-passed': lambda e, _: low_passed(e, 0.45),
    'far low-passed': lambda e, _: low_passed(e, 0.15),
    'resonant': lambda e, _: signal.lfilter([1.0], [1.0, -0.223, 0.383, 0.075], e),
}


@pytest.mark.parametrize('kind', SENSORS)
@pytest.mark.parametrize('seed', range(2))
def test_every_interval_holds_its_estimate(kind, seed):
    """Whatever the sensor, also where the model does not fit it."""
    random = np.random.default_rng([seed, 11])
    data = SENSORS[kind](*random.standard_normal((2, 3000)))
    found = fit_drift_and_white([data - data.mean()])
    for estimate, (low, high) in (
        (found.phi, found.phi_interval),
        (found.drift_variance, found.drift_variance_interval),
        (found.white_variance, found.white_variance_interval),
    ):
        assert low <= estimate <= high


def test_the_filters_own_model_is_found():
    """Data made by equations (3) and (4)."""
    phi, q, r = 0.5, 1e-4, 1.0
    random = np.random.default_rng(4)
    drift = signal.lfilter([1.0], [1.0, -phi], np.sqrt(q) * random.standard_normal(100_000))
    z = np.concatenate([[0.0], np.cumsum(drift[:-1])]) + np.sqrt(r) * random.standard_normal(
        100_000
    )
    found = fit_filter_noise([z], phi)
    assert found.measurement_noise == pytest.approx(r, rel=0.02)
    assert found.process_noise == pytest.approx(q, rel=0.2)


def test_the_likeliest_noise_smooths_where_the_papers_hardly_does():
    """A motionless sensor: Q and R as the paper takes them, and the likeliest ones."""
    data = arma(20_000, [0.218], [], seed=6, deviation=0.005)
    (drift,) = fit_arma([data], [(1, 0)])
    phi, paper = drift.phi[0], paper_noise(drift, data.std())
    assert phi == pytest.approx(0.218, abs=0.02)
    assert paper.process_noise == pytest.approx(0.005**2, rel=0.03)
    assert paper.measurement_noise == pytest.approx(data.var(), rel=1e-3)
    ratios = []
    for noise in (paper, fit_filter_noise([data], phi)):
        parameters = Parameters(
            method='kalman',
            outlier_enabled=False,
            bias_enabled=False,
            model_phi=(phi,) * 3,
            model_process_noise=(noise.process_noise,) * 3,
            model_measurement_noise=(noise.measurement_noise,) * 3,
        )
        z = np.column_stack([data] * 3)
        stamps = 10**18 + 10_000_000 * np.arange(len(z))
        out = Filter(parameters).run(stamps, z, np.zeros_like(z))['angular_velocity']
        ratios.append(out[5000:, 0].std() / data[5000:].std())
    assert ratios[0] == pytest.approx(0.756, abs=0.02)
    assert ratios[1] < 0.25
