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

"""The step and the class around it: live against batch, snapshots, unusable rates."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
from gyro_drift_filter.core.bias.records import Hint
from gyro_drift_filter.core.filter import layout_of
from gyro_drift_filter.core.methods import (
    METHOD_NAMES,
    METHOD_STATES,
    METHODS,
    is_noise_known,
    learned_noise,
    noise_block_seconds,
    start_over,
)
from gyro_drift_filter.core.quantisation import QUANTISATION, note_counts
from gyro_drift_filter.core.sample import RESULT, SampleStatus
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from support.messages import even_stamps

ZERO = (0.0, 0.0, 0.0)


def recording(n=2000):
    return simulate(SimulationSettings(static_seconds=n / 200, dynamic_seconds=n / 200))


def largest_change(before, after):
    """Return the largest change of a field of results, as a share of its largest value."""
    largest = np.abs(before).max()
    change = np.abs(before - after).max()
    return change / largest if largest > 0.0 else change


def same(a, b):
    return all(np.array_equal(a[name], b[name]) for name in RESULT.names)


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_batch_is_the_live_step_bit_for_bit(method):
    data = recording()
    stamps = data.stamps.copy()
    stamps[500:] += 200_000_000
    stamps[700] = stamps[699]
    rates = data.angular_velocity.copy()
    rates[900, 1] = np.nan
    batch = Filter(Parameters(method=method)).run(stamps, rates, data.linear_acceleration)
    live = Filter(Parameters(method=method))
    for k in range(len(stamps)):
        result = live.step(int(stamps[k]), rates[k], data.linear_acceleration[k])
        assert same(result, batch[k])


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(
    cuts=st.lists(st.integers(0, 2000), min_size=1, max_size=5),
    method=st.sampled_from(METHOD_NAMES),
    share_of_noise=st.sampled_from([1.0, 1e-3]),
)
def test_restore_continues_bit_for_bit(cuts, method, share_of_noise):
    """Also of a sensor with less noise than R is ever taken for."""
    data = recording()
    noise = data.angular_velocity - data.truth
    data = replace(data, angular_velocity=data.truth + share_of_noise * noise)
    whole = Filter(Parameters(method=method)).run(
        data.stamps, data.angular_velocity, data.linear_acceleration
    )
    filter_ = Filter(Parameters(method=method))
    parts = []
    for begin, end in zip([0, *sorted(cuts)], [*sorted(cuts), 2000], strict=True):
        span = slice(begin, end)
        parts.append(
            filter_.run(
                data.stamps[span], data.angular_velocity[span], data.linear_acceleration[span]
            )
        )
        snapshot = filter_.snapshot()
        filter_ = Filter(Parameters(method=method))
        filter_.restore(snapshot)
    assert same(np.concatenate(parts), whole)


def test_a_provisional_bias_of_the_last_run_is_kept_where_a_parameter_changes():
    filter_ = Filter()
    filter_.set_bias((0.01, -0.02, 0.0), (0.02, 0.02, 0.02), known=False)
    filter_.configure(Parameters(bias_turn_on_deviation=0.05))
    np.testing.assert_array_equal(filter_.state['bias']['bias'], (0.01, -0.02, 0.0))


def test_restore_refuses_another_version():
    snapshot = Filter().snapshot()
    Filter().restore(snapshot)
    # Fields in another order are of the same size.
    for other in (b'short', b'', snapshot[:-1], snapshot + b'x', bytes(32) + snapshot[32:]):
        with pytest.raises(GyroDriftFilterError, match='another version'):
            Filter().restore(other)


def test_a_snapshot_of_other_reasons_is_one_of_another_version():
    """It holds their numbers, which a new one moves."""
    *others, adaptive = METHODS
    moved = {number + 1: text for number, text in adaptive.reasons.items()}
    layout = layout_of([*others, adaptive._replace(reasons=moved)])
    snapshot = Filter().snapshot()
    assert snapshot.startswith(layout_of(METHODS))
    with pytest.raises(GyroDriftFilterError, match='another version'):
        Filter().restore(layout + snapshot[len(layout) :])


def test_restore_refuses_another_method():
    """Its state is not set up, so that every rate would be NaN."""
    with pytest.raises(GyroDriftFilterError, match='of another method than adaptive'):
        Filter().restore(Filter(Parameters(method='kalman')).snapshot())


@pytest.mark.parametrize('wrong', [1.0, (1.0,), (1.0, 2.0), np.ones((3, 1)), np.ones(4)])
def test_a_sample_of_another_shape_is_refused(wrong):
    for rate, acceleration in ((wrong, ZERO), (ZERO, wrong)):
        with pytest.raises(GyroDriftFilterError, match='three numbers'):
            Filter().step(1, rate, acceleration)


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_reset_starts_afresh_but_for_the_bias(method):
    data = recording()
    filter_ = Filter(Parameters(method=method))
    filter_.run(data.stamps, data.angular_velocity, data.linear_acceleration)
    learned = filter_.state['bias']['bias'].copy()
    assert (learned != 0.0).all()
    filter_.reset()
    assert (filter_.state['bias']['bias'] == learned).all()
    fresh = Filter(Parameters(method=method))
    fresh.record['state']['bias'] = filter_.record['state']['bias']
    again, first = (
        one.run(data.stamps, data.angular_velocity, data.linear_acceleration)
        for one in (filter_, fresh)
    )
    assert same(again, first)


def test_a_new_bias_does_not_end_what_the_robot_says_of_its_motion():
    filter_ = Filter()
    filter_.hint(moves=True)
    filter_.configure(Parameters(bias_turn_on_deviation=0.05))
    assert filter_.state['bias']['hint'] == Hint.MOVES


def test_an_axis_without_a_result_keeps_its_last_rate():
    """And does not grow by the bias with each sample, out of which the bias in motion is told."""
    data = recording(3000)
    rates = data.angular_velocity.copy()
    rates[2000:, 1] = np.nan
    results = Filter().run(data.stamps, rates, data.linear_acceleration)
    refused = results['status'] == SampleStatus.REFUSED
    assert refused.any()
    kept = results['angular_velocity'][refused][:, 1]
    assert (kept == kept[0]).all()
    assert np.abs(kept).max() < 2.0 * np.abs(data.angular_velocity).max()


def test_configure_keeps_the_state():
    data = recording()
    filter_ = Filter()
    filter_.run(data.stamps, data.angular_velocity, data.linear_acceleration)
    before = filter_.snapshot()
    filter_.configure(Parameters(forgetting_factor=0.99, outlier_run=4, epsilon=1.0))
    assert filter_.snapshot() == before


@pytest.mark.parametrize(('first', 'then'), [('adaptive', 'sage_husa'), ('kalman', 'adaptive')])
def test_a_method_that_takes_over_again_starts_from_the_sample(first, then):
    """Not from where it was when it was left."""
    n = 1000
    stamps = 10**18 + 10_000_000 * np.arange(3 * n)
    turn = np.concatenate([np.zeros(n), np.linspace(0, 3, n), np.full(n, 3.0)])
    z = turn[:, None] + 0.002 * np.random.default_rng(1).standard_normal((3 * n, 3))
    filter_ = Filter(Parameters(method=first))
    for k, method in enumerate((first, then, first)):
        part = slice(k * n, (k + 1) * n)
        filter_.configure(filter_.parameters.with_names({'method': method}))
        out = filter_.run(stamps[part], z[part], np.zeros_like(z[part]))
    assert np.abs(out['angular_velocity'][0] - 3.0).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ('first', 'then', 'moves'),
    [(first, then, False) for first in METHOD_NAMES for then in METHOD_NAMES if first != then]
    + [('adaptive', 'kalman', True), ('adaptive', 'sage_husa', True)],
)
def test_a_method_that_takes_over_does_not_make_the_output_jump(first, then, moves, random):
    """Where the output is near the samples, as adaptive's always is and the others' is at rest."""
    n = 2000
    stamps = 10**18 + 10_000_000 * np.arange(n)
    turn = 0.5 * np.sin(2 * np.pi * 0.2 * np.arange(n) / 100) * moves
    z = turn[:, None] + 0.005 * random.standard_normal((n, 3))
    noisy = np.abs(np.diff(z, axis=0)).max()
    for k in range(1000, 1030):
        filter_ = Filter(Parameters(method=first))
        before = filter_.run(stamps[:k], z[:k], np.zeros_like(z[:k]))['angular_velocity'][-1]
        filter_.configure(filter_.parameters.with_names({'method': then}))
        out = filter_.run(stamps[k:], z[k:], np.zeros_like(z[k:]))['angular_velocity']
        jump = np.abs(out[0] - before).max()
        assert jump < (1.2 * noisy if moves else 0.02), k
        assert jump > 0.0


def test_a_sensor_that_is_stuck_or_at_the_end_of_its_range(random):
    n = 600
    stamps = 10**18 + 10_000_000 * np.arange(n)
    rates = 0.01 * random.standard_normal((n, 3))
    rates[:, 1] = np.clip(rates[:, 1] + 12.0 * np.sin(np.arange(n) / 30.0), -8.73, 8.73)
    clipped = int((np.abs(rates[:300, 1]) == 8.73).sum())
    accelerations = 9.8 + 0.02 * random.standard_normal((n, 3))
    rates[300:450], accelerations[300:450] = rates[300], accelerations[300]
    filter_ = Filter()
    filter_.run(stamps[:300], rates[:300], accelerations[:300])
    counts = filter_.state['checks']
    assert 0.8 * clipped < counts['range_end']['clipped'][1] <= clipped
    assert counts['range_end']['clipped'][[0, 2]].tolist() == [0, 0]
    assert counts['times_stuck'] == 0
    filter_.run(stamps[300:450], rates[300:450], accelerations[300:450])
    assert filter_.state['checks']['stuck']
    filter_.run(stamps[450:], rates[450:], accelerations[450:])
    assert not filter_.state['checks']['stuck']
    assert counts['times_stuck'] == 1


def test_a_stuck_sensor_tells_nothing_of_the_bias(random):
    """It stands at some rate of a turn, for minutes."""
    n = 6000
    stamps = 10**18 + 10_000_000 * np.arange(2 * n)
    rates, accelerations = 0.005 * random.standard_normal((2 * n, 3)), np.full((2 * n, 3), 9.8)
    accelerations += 0.02 * random.standard_normal((2 * n, 3))
    rates[n:], accelerations[n:] = (0.05, 0.0, 0.0), accelerations[n]
    filter_ = Filter()
    out = filter_.run(stamps, rates, accelerations)
    assert np.abs(out['bias'][-1] - out['bias'][n - 1]).max() < 1e-3
    for nan in (False, True):
        other = accelerations * (np.nan if nan else 1.0)
        filter_ = Filter()
        filter_.run(stamps, rates, other)
        assert filter_.state['checks']['stuck']


@pytest.mark.parametrize('rate', [1e-300, 1e-6, 0.5])
def test_a_rate_below_all_sense_is_bounded(rate):
    data = recording(200)
    out = Filter(Parameters(sample_rate=rate)).run(
        np.zeros(200, np.int64), data.angular_velocity, data.linear_acceleration
    )
    assert np.isfinite(out['angular_velocity']).all()


@pytest.mark.parametrize('bad', [np.nan, np.inf, -np.inf, 1e300, -2e6])
@pytest.mark.parametrize('method', METHOD_NAMES)
def test_an_unusable_rate_is_bridged_by_the_prediction(bad, method):
    data = recording()
    filter_ = Filter(Parameters(method=method))
    filter_.run(data.stamps, data.angular_velocity, data.linear_acceleration)
    kept = data.angular_velocity[-1, 0]
    stamp = int(data.stamps[-1])
    for k in range(1, 20):
        result: Any = filter_.step(stamp + k * 10_000_000, (kept, bad, kept), ZERO)
        assert result['status'] == SampleStatus.FILTERED
        for name in RESULT.names:
            assert np.isfinite(result[name]).all()
        assert result['outlier'].tolist()[1] == 1.0
        assert abs(result['angular_velocity'][1]) < 1.0
    assert filter_.state['checks']['unusable'].tolist() == [0, 19, 0]


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_bridging_stays_near_and_ends_at_the_limit(method):
    """After fast motion the prediction must not run away; after `gap_limit` there is none."""
    time = np.arange(1000) / 100
    z = np.column_stack([3 * np.sin(2 * np.pi * f * time) for f in (0.5, 1.0, 2.0)])
    stamps = 10**18 + 10_000_000 * np.arange(1000)
    filter_ = Filter(Parameters(method=method, gap_limit=0.5))
    filter_.run(stamps, z, np.zeros_like(z))
    for k in range(1, 100):
        result = filter_.step(int(stamps[-1]) + k * 10_000_000, (np.nan, 0.0, 0.0), ZERO)
        assert (result['status'] == SampleStatus.REFUSED) == (k > 50)
        assert abs(result['angular_velocity'][0]) < 15.0
    result = filter_.step(int(stamps[-1]) + 10**9, (0.5, 0.0, 0.0), ZERO)
    assert result['status'] == SampleStatus.FILTERED
    assert abs(result['angular_velocity'][0] - 0.5) < 1e-9


EFFECTS = [
    ('method', 'kalman', 'adaptive'),
    ('forgetting_factor', 0.9, 'adaptive'),
    ('forgetting_factor', 0.9, 'sage_husa'),
    ('epsilon', 1e-6, 'kalman'),
    ('outlier.enabled', False, 'adaptive'),
    ('outlier.threshold', 100.0, 'adaptive'),
    ('outlier.acceleration', 1e5, 'adaptive'),
    ('outlier.run', 1, 'adaptive'),
    ('sample_rate', 50.0, 'adaptive'),
    ('gap_limit', 0.005, 'kalman'),
    ('model.phi', (0.9, 0.9, 0.9), 'kalman'),
    ('model.process_noise', (1e-4, 1e-4, 1e-4), 'sage_husa'),
    ('model.measurement_noise', (1e-4, 1e-4, 1e-4), 'sage_husa'),
    ('model.noise_deviation', (0.05, 0.05, 0.05), 'adaptive'),
]


def test_every_parameter_of_a_method_has_a_case():
    """Those of other files' tests are about the bias, the calibration, counts and hints."""
    elsewhere = ('bias.', 'calibration.', 'input.', 'motion_hint')
    methods = {name for name in Parameters().names() if not name.startswith(elsewhere)}
    assert {name for name, _, _ in EFFECTS} == methods, 'EFFECTS has a case for each parameter'


@pytest.mark.parametrize(('name', 'value', 'method'), EFFECTS)
def test_every_parameter_takes_effect_at_once(name, value, method):
    data = recording(3000)
    # The adaptive method learns its noise at rest: at the start, and where the bias is one.
    learns_at_rest = (name, method) == ('forgetting_factor', 'adaptive')
    rates = (1.0 if learns_at_rest else 10.0) * data.angular_velocity
    change_at = 500 if learns_at_rest else 2000
    rates[2500] += 1.5
    rates[2700:] += 3.0
    stamps = np.zeros(3000, np.int64) if name == 'sample_rate' else data.stamps.copy()
    stamps[2200:] += 200_000_000 * (name == 'gap_limit')
    outs = []
    for change in (False, True):
        filter_ = Filter(Parameters(method=method))
        parts = [slice(0, change_at), slice(change_at, 3000)]
        for part in parts:
            if change and part.start:
                filter_.configure(filter_.parameters.with_names({name: value}))
            out = filter_.run(stamps[part], rates[part], data.linear_acceleration[part])
        outs.append(out)
    assert any(largest_change(outs[0][field], outs[1][field]) > 1e-6 for field in RESULT.names), (
        f'{name} = {value} changes no result of {method} from sample {change_at} on: no code reads '
        'it, or the recording needs another value in EFFECTS'
    )


def test_nothing_is_published_before_every_axis_had_a_usable_rate():
    filter_ = Filter()
    stamp = 10**18
    assert filter_.step(stamp, (np.nan, 0.0, 0.0), ZERO)['status'] == SampleStatus.REFUSED
    assert filter_.step(stamp + 10**7, (np.nan, 0.0, 0.0), ZERO)['status'] == SampleStatus.REFUSED
    result = filter_.step(stamp + 2 * 10**7, (0.5, 0.0, 0.0), ZERO)
    assert result['status'] == SampleStatus.FILTERED
    assert result['angular_velocity'][0] == pytest.approx(0.5, rel=1e-15)
    assert filter_.state['counts']['refused'] == 2


def test_an_unusable_rate_after_a_restart_is_refused():
    """A rate from before an hour's pause is no prediction."""
    filter_ = Filter()
    filter_.step(10**18, (0.1, 0.1, 0.1), ZERO)
    result = filter_.step(10**18 + 3600 * 10**9, (np.nan, 0.1, 0.1), ZERO)
    assert result['status'] == SampleStatus.REFUSED


def test_run_refuses_shapes_that_do_not_agree():
    with pytest.raises(GyroDriftFilterError, match='shapes'):
        Filter().run(np.zeros(3, np.int64), np.zeros((4, 3)), np.zeros((3, 3)))


def test_unknown_acceleration_changes_nothing_in_the_papers_filters():
    data = recording()
    unknown = np.full_like(data.linear_acceleration, np.nan)
    for method in ('kalman', 'sage_husa'):
        parameters = Parameters(method=method, bias_in_motion=False)
        a, b = (
            Filter(parameters).run(data.stamps, data.angular_velocity, acceleration)
            for acceleration in (data.linear_acceleration, unknown)
        )
        assert same(a, b)


@pytest.mark.parametrize('method', METHODS, ids=METHOD_NAMES)
def test_a_method_works_on_its_own_state_alone(method, random):
    """Start, gaps, rates that are no number, and other samples: each verb has to choose it."""
    n = 300
    rates = 0.1 + 0.005 * random.standard_normal((n, 3))
    rates[150:155, 1] = np.nan
    stamps = 10**18 + 10_000_000 * np.arange(n)
    stamps[200:] += 50_000_000
    filter_ = Filter(Parameters(method=method.name, bias_enabled=False))
    results = filter_.run(stamps, rates, np.zeros((n, 3)))
    assert filter_.state['clock']['missing_samples'] == 5
    assert (results['innovation_variance'] > 0.0).all()
    np.testing.assert_allclose(results['angular_velocity'][100:], 0.1, atol=0.05)
    states = filter_.record[0]['state']['methods']
    assert states[method.state].tobytes().strip(b'\0')
    for name in set(METHOD_STATES.names) - {method.state, 'tracking'}:
        assert not states[name].tobytes().strip(b'\0'), f'{method.name} changes the state of {name}'


def at_rest_with(deviation, rate, begin, random):
    """Return (stamps, rates, accelerations) of a rest at 100 Hz, from the sample `begin` on."""
    n = 2000
    rates = rate + deviation * random.standard_normal((n, 3))
    accelerations = [0.0, 0.0, 9.8] + 0.02 * random.standard_normal((n, 3))
    return 10**18 + 10_000_000 * np.arange(begin, begin + n), rates, accelerations


@pytest.mark.parametrize('method', METHODS, ids=METHOD_NAMES)
def test_a_method_that_starts_over_forgets_what_it_has_learned(method, random):
    loud, quiet = (at_rest_with(0.02, 0.1, 0, random), at_rest_with(0.001, 0.3, 2000, random))
    again, fresh = Filter(Parameters(method=method.name)), Filter(Parameters(method=method.name))
    again.run(*loud)
    # Only the method is fresh: clock, sensor checks, rest and bias are the same in both.
    fresh.restore(again.snapshot())
    fresh.record['state']['methods'] = np.zeros(1, METHOD_STATES)
    start_over(again.record[0])
    got, expected = again.run(*quiet), fresh.run(*quiet)
    needed = (
        f'{method.name} needs a line in `start_over` of core/methods/__init__.py, or that function '
        'and `start` of its module together leave a part of its state as it was'
    )
    for name in ('angular_velocity', 'innovation_variance', 'process_noise', 'measurement_noise'):
        # The accelerometer's usual changes, which adaptive keeps, are no noise of the gyroscope.
        np.testing.assert_allclose(
            got[name], expected[name], rtol=0.01, atol=1e-9, err_msg=f'{name}: {needed}'
        )
    for axis in range(3):
        assert learned_noise(again.record[0], axis) == learned_noise(fresh.record[0], axis), needed


# They are given a model of the noise, so that the first innovation can be judged by it.
GIVEN_A_MODEL = ('kalman', 'sage_husa')


@pytest.mark.parametrize('method', METHODS, ids=METHOD_NAMES)
def test_innovations_are_judged_only_where_the_noise_is_known(method, random):
    filter_ = Filter(Parameters(method=method.name))
    samples, counts = at_rest_with(0.005, 0.1, 0, random), filter_.state['counts']

    def known():
        return [bool(is_noise_known(filter_.record[0], axis)) for axis in range(3)]

    filter_.run(*(part[:20] for part in samples))
    is_given = method.name in GIVEN_A_MODEL
    assert known() == [is_given] * 3, (
        f'{method.name} needs a branch in `is_noise_known` of core/methods/__init__.py, or belongs '
        'to GIVEN_A_MODEL'
    )
    assert (counts['nis_samples'] > 0).all() == is_given
    filter_.run(*(part[20:] for part in samples))
    assert known() == [True] * 3
    assert (counts['nis_samples'] > 1000).all()
    blocks = [learned_noise(filter_.record[0], axis)[0] for axis in range(3)]
    assert [count > 0 for count in blocks] == [method.advice.learns_noise] * 3, (
        f'{method.name} needs a branch in `learned_noise` of core/methods/__init__.py'
    )
    assert (noise_block_seconds(filter_.record[0]) > 0.0) == method.advice.learns_noise, (
        f'{method.name} needs a branch in `noise_block_seconds` of core/methods/__init__.py'
    )


def test_an_infinite_first_rate_leaves_the_size_of_counts_open():
    state, before = zeroed(QUANTISATION)[0], np.zeros(3)
    for rate in (np.inf, 0.01, np.inf, 0.02, 0.015):
        now = np.array([rate, 0.0, 0.0])
        note_counts(state, now, before)
        before = now
    assert np.isfinite(state['count']).all()


@pytest.mark.parametrize('seed', range(6))
def test_a_snapshot_continues_through_missing_rates_after_repeats(seed):
    """What an earlier sample left in the workspace has no part in it."""
    random = np.random.default_rng(seed)
    rates = 0.3 * np.cumsum(random.standard_normal((600, 3)), axis=0)
    rates[3::4] = rates[2::4]
    rates[596:] = np.nan
    accelerations = (0.0, 0.0, 9.81) + 0.02 * random.standard_normal(rates.shape)
    stamps = even_stamps(len(rates))
    continued, restored = Filter(), Filter()
    continued.run(stamps[:596], rates[:596], accelerations[:596])
    restored.restore(continued.snapshot())
    end = stamps[596:], rates[596:], accelerations[596:]
    assert continued.run(*end).tobytes() == restored.run(*end).tobytes()
