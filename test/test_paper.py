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

"""The paper's filters against a dense transcription, their claims, and any input."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sample import RESULT, SampleStatus
from gyro_drift_filter.simulation.experiments import SimulationSettings, autoregressive, simulate
from support.dense import dense_filter

METHODS = ('kalman', 'sage_husa')


def run(z, **parameters):
    stamps = 10**18 + 10_000_000 * np.arange(len(z))
    filter_ = Filter(Parameters(**({'bias_enabled': False} | parameters)))
    return filter_, filter_.run(stamps, z, np.zeros_like(z))


PHIS = (0.218, 0.9, -0.3, 0.0)
NOISE = (2e-5, 3e-5, 1e-6), (2.5e-5, 1e-5, 4e-5)  # of the model and of the measurement


@cache
def transcribed(method, outliers):
    """Return rates (n, 3), and by phi what the dense transcription makes of them."""
    n = 10_000
    settings_ = SimulationSettings(
        static_seconds=n / 200,
        dynamic_seconds=n / 200,
        isolated=0.01 if outliers else 0.0,
        runs=5 if outliers else 0,
    )
    z = simulate(settings_).angular_velocity
    found = dense_filter(
        np.tile(z, len(PHIS)),
        np.repeat(PHIS, 3),
        *(np.tile(values, len(PHIS)) for values in NOISE),
        adaptive=method == 'sage_husa',
        b=0.97,
        epsilon=0.02 if outliers else np.inf,
    )
    parts = zip(*(np.split(values, len(PHIS), axis=1) for values in found), strict=True)
    return z, dict(zip(PHIS, parts, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize('method', METHODS)
@pytest.mark.parametrize('outliers', [False, True])
@pytest.mark.parametrize('phi', PHIS)
def test_agrees_with_the_dense_transcription(method, outliers, phi):
    z, expected = transcribed(method, outliers)
    q0, r0 = NOISE
    _, results = run(
        z,
        method=method,
        outlier_enabled=outliers,
        epsilon=0.02,
        forgetting_factor=0.97,
        model_phi=(phi,) * 3,
        model_process_noise=q0,
        model_measurement_noise=r0,
    )
    rates, flags, q, r = expected[phi]
    largest = np.abs(z).max(axis=0)
    assert (np.abs(results['angular_velocity'] - rates).max(axis=0) <= 1e-12 * largest).all()
    assert (results['outlier'] == flags).all()
    assert (flags.any(axis=0) == outliers).all()
    np.testing.assert_allclose(results['process_noise'], q, rtol=1e-9)
    np.testing.assert_allclose(results['measurement_noise'], r, rtol=1e-9)


def test_static_experiment_keeps_the_mean_and_reduces_the_deviation():
    simulation = simulate(SimulationSettings(static_seconds=200, dynamic_seconds=0))
    raw = simulation.angular_velocity
    blocks = np.array([block.mean(axis=0) for block in np.array_split(raw, 30)])
    standard_error = blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks))
    for method, largest_ratio in (('kalman', 0.8), ('sage_husa', 0.95)):
        _, results = run(raw, method=method)
        rate = results['angular_velocity']
        assert (np.abs(rate.mean(axis=0) - raw.mean(axis=0)) < 3 * standard_error).all()
        assert (rate.std(axis=0) < largest_ratio * raw.std(axis=0)).all()


def test_conventional_filter_gives_the_published_order_of_reduction(random):
    """AR(1) noise alone, Q and R as the paper sets them: 0.756 was measured of the equations."""
    phi, deviation = 0.218, 0.005
    noise = autoregressive(random, 20_000, phi, deviation)
    q = deviation**2
    _, results = run(
        noise,
        method='kalman',
        outlier_enabled=False,
        model_process_noise=(q,) * 3,
        model_measurement_noise=(q / (1 - phi**2),) * 3,
    )
    ratio = results['angular_velocity'].std(axis=0) / noise.std(axis=0)
    np.testing.assert_allclose(ratio, 0.756, atol=0.01)


def test_anti_outlier_step_keeps_outliers_out():
    simulation = simulate(SimulationSettings())
    error = {}
    for enabled in (False, True):
        _, results = run(simulation.angular_velocity, method='kalman', outlier_enabled=enabled)
        error[enabled] = np.abs(results['angular_velocity'] - simulation.truth).max()
        assert results['outlier'][simulation.outliers].all() == enabled
    assert error[True] < 0.1 * error[False]


def test_outlier_towards_zero_is_flagged_and_used_unchanged():
    """Equation (18) flags it, (19) gives f = 1: the sample passes, as the paper has it."""
    z = np.full((50, 3), 1.0)
    z[40] = 0.2
    _, results = run(z, method='kalman', epsilon=0.02)
    assert (results['outlier'][40] == 1).all()
    _, without = run(z, method='kalman', outlier_enabled=False)
    np.testing.assert_array_equal(results['angular_velocity'][40], without['angular_velocity'][40])


rates = st.one_of(st.floats(-1e6, 1e6), st.just(np.nan), st.just(np.inf))
# Runs of equal values and jumps between them reach states that independent samples do not.
sequences = st.lists(
    st.tuples(rates, st.integers(1, 40), st.sampled_from([0, 1, 1, 1, 30, 400, -5])),
    min_size=1,
    max_size=30,
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(
    pieces=sequences,
    method=st.sampled_from(METHODS),
    forgetting_factor=st.floats(0.9, 0.9999),
    phi=st.floats(-1.0, 1.0, exclude_min=True, exclude_max=True),
    q=st.floats(1e-12, 1e6),
    r=st.floats(1e-12, 1e6),
    enabled=st.booleans(),
)
def test_no_input_breaks_a_covariance_or_the_output(
    pieces, method, forgetting_factor, phi, q, r, enabled
):
    """Jumps, NaN, gaps, restarts and backward stamps; and every model that is allowed."""
    z = np.repeat([rate for rate, *_ in pieces], [length for _, length, _ in pieces])
    z = np.column_stack([z, -z[::-1], z * np.where(np.arange(len(z)) % 2, 1, -1)])
    steps = np.concatenate([[step, *([1] * (length - 1))] for _, length, step in pieces])
    filter_: Any = Filter(
        Parameters(
            method=method,
            forgetting_factor=forgetting_factor,
            model_phi=(phi,) * 3,
            model_process_noise=(q,) * 3,
            model_measurement_noise=(r,) * 3,
            outlier_enabled=enabled,
        )
    )
    results = np.empty(len(z), RESULT)
    states = np.empty(len(z), filter_.state['methods'].dtype)
    stamps = 10**18 + 10_000_000 * np.cumsum(steps)
    for k, (stamp, sample) in enumerate(zip(stamps, z, strict=True)):
        results[k] = filter_.step(int(stamp), sample, (0.0, 0.0, 0.0))
        states[k] = filter_.state['methods']
    tracked = states['paper'][states['tracking'] == 1]
    for name in results.dtype.names:
        assert np.isfinite(results[name]).all(), name
    p00, p01, p11 = (tracked[name] for name in ('rate_variance', 'covariance', 'drift_variance'))
    assert (p00 >= 0).all()
    assert (p11 >= 0).all()
    assert (p01 * p01 <= p00 * p11 * (1 + 1e-12) + 1e-300).all()
    assert (tracked['process_noise'] > 0).all()
    assert (tracked['measurement_noise'] > 0).all()
    filtered = results[results['status'] == SampleStatus.FILTERED]
    assert (filtered['innovation_variance'] > 0).all()
    assert (filtered['angular_velocity_variance'] >= 0).all()


@pytest.mark.slow
def test_agrees_with_the_dense_transcription_through_divergence():
    """Outliers taken as they are: r and q drive each other until the safeguard restarts."""
    z = simulate(SimulationSettings(static_seconds=50, dynamic_seconds=50)).angular_velocity
    q0, r0 = 2e-5, 2.5e-5
    filter_, results = run(
        z,
        method='sage_husa',
        outlier_enabled=False,
        forgetting_factor=0.97,
        model_phi=(0.0,) * 3,
        model_process_noise=(q0,) * 3,
        model_measurement_noise=(r0,) * 3,
    )
    assert filter_.state['methods']['paper']['divergences'].any()
    rates, *_ = dense_filter(
        z, [0.0] * 3, [q0] * 3, [r0] * 3, adaptive=True, b=0.97, epsilon=np.inf
    )
    largest = np.abs(z).max(axis=0)
    assert (np.abs(results['angular_velocity'] - rates).max(axis=0) <= 1e-12 * largest).all()


def test_divergence_restarts_from_the_sample():
    """R and q feed each other on growing motion; the safeguard must fire, and be counted."""
    filter_: Any = Filter(Parameters(method='sage_husa', outlier_enabled=False))
    filter_.step(10**18, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    filter_.state['methods']['paper'][0]['drift'] = 1e5
    result = filter_.step(10**18 + 10_000_000, (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    assert filter_.state['methods']['paper']['divergences'].tolist() == [1, 0, 0]
    assert result['angular_velocity'][0] == 1.0


def test_phi_keeps_its_correlation_time_at_another_rate(random):
    """Phi belongs to 100 Hz; at 50 Hz it is its square, and the drift's variance stays."""
    z = 0.005 * random.standard_normal((2000, 3))
    filter_ = Filter(Parameters(method='kalman', sample_rate=100.0, model_phi=(0.5, -0.5, 0.0)))
    filter_.run(10**18 + 20_000_000 * np.arange(2000), z, np.zeros_like(z))
    coefficients = filter_.record[0]['coefficients']['methods']['paper']
    np.testing.assert_allclose(coefficients['phi'], [0.25, -0.5, 0.0])
    q = 2.38e-5
    np.testing.assert_allclose(
        coefficients['process_noise'][0] / (1 - 0.25**2), q / (1 - 0.5**2), rtol=1e-12
    )


def test_a_model_that_is_set_on_the_way_keeps_its_correlation_time(random):
    """Q, which sage_husa adapts from there on, is for the period that the stamps tell."""
    z = 0.005 * random.standard_normal((2000, 3))
    phi, q = (0.5, 0.5, 0.5), (1e-4, 1e-4, 1e-4)
    filter_: Any = Filter(Parameters(method='sage_husa', sample_rate=100.0, model_phi=phi))
    filter_.run(10**18 + 20_000_000 * np.arange(2000), z, np.zeros_like(z))
    filter_.configure(filter_.parameters.with_names({'model.process_noise': q}))
    np.testing.assert_allclose(
        filter_.state['methods']['paper']['process_noise'],
        1e-4 * (1 - 0.25**2) / (1 - 0.5**2),
        rtol=1e-12,
    )
