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

"""Method `adaptive`: never locked out, never not a number, prompt in motion."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import signal
from scipy.linalg import solve_discrete_lyapunov

from benchmark.quality import make_world
from benchmark.scenarios import foot, stamps, stopped
from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.clock.periods import LONGEST_PERIOD
from gyro_drift_filter.core.methods.compensation import (
    COMPENSATION_SECONDS,
    COMPENSATION_SHARE,
    LARGEST_COMPENSATION,
    SMOOTHING_DEVIATIONS,
    SMOOTHING_SECONDS,
)
from gyro_drift_filter.core.methods.mode_set import (
    DERIVATION,
    MODE_SET,
    MODES,
    Transition,
    derive_mode_set,
)
from gyro_drift_filter.core.methods.noise import largest_variance
from gyro_drift_filter.core.methods.reasons import Decision, Reason, decision_of
from gyro_drift_filter.simulation.experiments import autoregressive
from support.messages import START, even_stamps
from support.paths import FLIGHTS, recorded
from support.sensor import by_hand, motion_below

RATES = (50.0, 100.0, 400.0, 1000.0, 4000.0)


def run(z, rate=100.0, **parameters):
    z = np.asarray(z, float)
    stamps = even_stamps(len(z), rate)
    filter_ = Filter(Parameters(sample_rate=rate, bias_enabled=False, **parameters))
    return filter_.run(stamps, z, np.zeros_like(z))


@pytest.mark.parametrize(('before', 'after'), [(400, 100), (1000, 200), (200, 50), (50, 4000)])
def test_a_rate_that_changes_in_motion_does_no_harm(before, after, random):
    """The clock takes it for missing samples at first: the gains must not drive each other."""
    steps = np.concatenate([np.full(20 * before, 1 / before), np.full(10 * after, 1 / after)])
    time = np.cumsum(steps)
    truth = np.column_stack([2 * np.sin(2 * np.pi * f * time) for f in (0.5, 1.0, 1.5)])
    z = truth + 0.005 * random.standard_normal(truth.shape)
    out = Filter().run(START + np.round(time * 1e9).astype(np.int64), z, np.zeros_like(z))
    assert np.abs(out['angular_velocity'] - truth).max() < 0.05


def test_most_samples_missing_on_an_axis_do_no_harm(random):
    time = np.arange(4000) / 100
    truth = np.sin(2 * np.pi * 0.5 * time)[:, None] * np.ones(3)
    z = truth + 0.005 * random.standard_normal(truth.shape)
    z[np.arange(4000) % 4 > 0, 0] = np.nan
    out = run(z)['angular_velocity']
    assert np.abs(out - truth)[10:, 0].max() < 0.3
    assert np.abs(out - truth)[10:, 1:].max() < 0.03


@pytest.mark.parametrize('mean', [(0.0, 0.0, 0.0), (0.3, 0.5, 0.1), (0.5, 0.5, 0.5)])
@pytest.mark.parametrize('rate', [100.0, 1000.0])
@pytest.mark.parametrize('steps', [3, 4, 6])
def test_a_sensor_of_coarse_steps_is_not_amplified(steps, rate, mean, random):
    """Noise far below the resolution: zeros on all axes are samples, not drop-outs."""
    resolution = 0.004
    analogue = resolution * (np.array(mean) + random.standard_normal((8000, 3)) / steps)
    z = resolution * np.round(analogue / resolution)
    results = run(z, rate)
    assert np.abs(results['angular_velocity'] - analogue).max() < 2.5 * resolution
    assert results['outlier'].mean() < 0.002


@pytest.mark.parametrize(('rate', 'loss'), [(100.0, 0.1), (1000.0, 0.05), (4000.0, 0.005)])
def test_noise_is_learned_anew_in_spite_of_losses(rate, loss, random):
    """Handled when switched on, then still: R must fall, though blocks are interrupted."""
    n = int(15 * rate)
    z = 0.002 * random.standard_normal((n, 3))
    z[:20] *= 50
    kept = random.random(n) > loss
    stamps = even_stamps(n, rate)
    filter_ = Filter(Parameters(sample_rate=rate))
    results = filter_.run(stamps[kept], z[kept], np.zeros_like(z[kept]))
    learned = np.sqrt(results['measurement_noise'][-1])
    np.testing.assert_allclose(learned, 0.002, rtol=0.2)


@pytest.mark.parametrize(('rate', 'hertz', 'size'), [(400.0, 100.0, 0.3), (100.0, 25.0, 1.5)])
def test_a_vibration_is_not_held_for_ever(rate, hertz, size, random):
    n = int(8 * rate)
    time = np.arange(n) / rate
    tone = np.where(time > 4, size * np.sin(2 * np.pi * hertz * time + 0.3), 0.0)
    z = tone[:, None] + 0.002 * random.standard_normal((n, 3))
    results = run(z, rate)
    late = time > 5
    assert results['outlier'][late].mean() < 0.05
    gain = (results['angular_velocity'][late] * tone[late, None]).sum() / (
        3 * (tone[late] ** 2).sum()
    )
    assert gain > 0.9


def with_accelerations(z, accelerations):
    stamps = even_stamps(len(z))
    return Filter(Parameters(sample_rate=100.0)).run(stamps, z, accelerations)


def still_accelerations(random, n=3000):
    return np.array([0.0, 0.0, 9.81]) + 0.02 * random.standard_normal((n, 3))


@pytest.mark.parametrize('size', [1.0, 8.0])
@pytest.mark.parametrize('rate', [50.0, 100.0, 200.0, 1000.0])
def test_a_vibration_is_followed_however_strong_it_is(rate, size, random):
    """Motors that start shake the sensor by any rate with each sample, beyond what a body does."""
    z = at_rest(random, 3000)
    z[2000:] = size * random.standard_normal((1000, 3))
    results = run(z, rate)
    assert not results['outlier'][2200:].any()
    assert np.abs(results['angular_velocity'] - z)[2200:].max() < 0.05 * size


def test_a_knock_is_believed_with_the_second_sample(random):
    """The accelerometer was shaken, and the next sample agrees: no need to wait for three more."""
    z, accelerations = at_rest(random), still_accelerations(random)
    ringing = 3.0 * np.exp(-np.arange(12) / 4) * np.cos(np.arange(12) / 2)
    z[2000:2012, 0] += ringing
    accelerations[2000:2012] += 30.0 * ringing[:, None]
    without = run(z)['outlier'][2000:2012, 0].sum()
    results = with_accelerations(z, accelerations)
    assert results['outlier'][2000:2012, 0].sum() <= 1 < without
    # What the first sample turned is given back.
    held = 0.01 * z[2000, 0]
    given_back = held / COMPENSATION_SECONDS
    assert abs(results['angular_velocity'][2001, 0] - z[2001, 0] - given_back) < 0.05


@pytest.mark.parametrize('missing', [0, 2])
def test_what_is_given_back_turns_with_the_body_while_samples_are_missing(random, missing):
    """It belongs to an orientation of the past, and turned by one sample period over a gap."""
    period, rate = 0.01, 5.0
    rates = 1e-3 * random.standard_normal((500, 3)) + [0.0, 0.0, rate]
    times, still = even_stamps(500), np.zeros((500, 3))
    filter_ = Filter()
    filter_.run(times, rates, still)
    axes = filter_.state['methods']['adaptive']
    axes[0]['compensation'] = 0.05
    filter_.run(times[-1:] + (1 + missing) * 10_000_000, rates[-1:], still[-1:])
    x, y = axes[0]['compensation'], axes[1]['compensation']
    assert np.arctan2(y, x) == pytest.approx(-rate * (1 + missing) * period, abs=2e-3)


# The largest angle that is lost for some time, in deg: at 100 Hz a sample is 14 deg.
@pytest.mark.parametrize(('rate', 'largest'), [(100, 18), (200, 5), (400, 2), (1000, 0.5)])
@pytest.mark.parametrize('shake', [1.0, 10.0, 30.0])
def test_a_foot_that_strikes_the_ground_is_followed(rate, largest, shake, random):
    rates, accelerations = foot(random, rate, shake)
    results = Filter().run(stamps(len(rates), rate), rates, accelerations)
    lost = np.cumsum(results['angular_velocity'] + results['bias'] - rates, axis=0) / rate
    assert np.degrees(np.abs(lost)).max() < largest
    assert np.degrees(np.abs(lost[-1])).max() < 0.1 * largest + 0.3


# A sample turns it by 10 deg at 100 Hz; eight of them, which is the longest hold, by 73 deg.
@pytest.mark.parametrize(('rate', 'largest'), [(100, 20), (200, 10), (400, 14)])
def test_a_body_that_is_stopped_and_rings_is_followed(rate, largest, random):
    """Its rates change by no like steps, and never stay the same."""
    rates, accelerations = stopped(random, rate, 20.0)
    results = Filter().run(stamps(len(rates), rate), rates, accelerations)
    lost = np.cumsum(results['angular_velocity'] + results['bias'] - rates, axis=0) / rate
    assert np.degrees(np.abs(lost)).max() < largest
    assert np.degrees(np.abs(lost[-1])).max() < 0.1 * largest + 0.3


@pytest.mark.parametrize(
    ('shake', 'sign', 'held'),
    [(1.0, -1.0, 5), (12.0, -1.0, 1), (12.0, 1.0, 6)],
)
def test_a_foot_that_shakes_the_sensor_is_followed_from_its_second_step_on(
    shake, sign, held, random
):
    """By the rates alone, or if the body gained speed, it may be two outliers in a row."""
    rates, accelerations = at_rest(random), still_accelerations(random)
    rates[1000:, 1] += np.minimum(0.05 * np.arange(2000), 12.0)
    accelerations[1000:] += random.uniform(-5.0, 5.0, (2000, 3))
    rates[2000:, 1] = 12.0 + sign * np.minimum(8.0 * np.arange(1, 1001), 17.0)
    accelerations[2000] = accelerations[1999]
    accelerations[2001] = accelerations[2000] + [shake, 0.0, 0.0]
    results = with_accelerations(rates, accelerations)
    assert np.flatnonzero(results['outlier'][1990:2020, 1]).tolist() == list(range(10, 10 + held))


@pytest.mark.parametrize('noise', [0.02, 0.05, 0.1])
def test_a_burst_whose_last_sample_meets_the_prediction_is_held(noise, random):
    """The motion turns back meanwhile, while the extrapolation goes on towards the burst."""
    time = np.arange(2000) / 100.0
    rates = np.outer(4.0 * np.sin(2 * np.pi * 1.5 * time), [1.0, 0.7, 0.5])
    rates = np.concatenate([rates, np.linspace(rates[-1], [-4.0, 0.0, 0.0], 20)])
    bend = [-4.9, -5.8, -10.2, -9.9, -9.5, -4.0, -3.4, -3.2, -3.2, -3.4, -3.7]
    rates = np.concatenate([rates, np.outer(bend, [1.0, 0.0, 0.0])])
    rates += noise * random.standard_normal(rates.shape)
    results = with_accelerations(rates, still_accelerations(random, len(rates)))
    assert results['outlier'][-9:-6, 0].all()


@pytest.mark.parametrize('noise', [0.005, 0.02])
def test_a_motion_that_turns_back_beside_outliers_is_found_at_once(noise, random):
    """The extrapolation runs away from the rate meanwhile, which is back where it was before."""
    time = np.arange(2000) / 100.0
    rates = np.outer(3.0 * np.sin(2 * np.pi * 1.5 * time), [1.0, 0.7, 0.5])
    bend = [-0.5, -0.6, 0.0, 1.9, 4.8, 6.3, 5.9, 4.3, 2.3, 0.9, 0.9, 2.3, 5.0, 5.5, 4.0]
    truth = np.concatenate([rates, np.outer(bend, [1.0, 0.0, 0.0])])
    z = truth + noise * random.standard_normal(truth.shape)
    z[-10:-7, 0] -= 10.4
    results = with_accelerations(z, still_accelerations(random, len(z)))
    assert results['outlier'][-10:-7, 0].all()
    assert not results['outlier'][-7:, 0].any()
    assert np.abs(results['angular_velocity'] + results['bias'] - truth)[-6:, 0].max() < 2.0


@pytest.mark.parametrize('sizes', [(24.0, -29.0), (-30.0, 32.0), (-16.0, 25.0)])
@pytest.mark.parametrize('moving', [False, True])
def test_bursts_that_overlap_are_no_motion(moving, sizes, random):
    """Their steps are alike, as those of a body that is stopped, but lead back to the rate."""
    z = at_rest(random)
    if moving:
        z += np.outer(0.5 * np.sin(2 * np.pi * 0.5 * np.arange(len(z)) / 100.0), [1.0, 0.7, 0.5])
    truth = z.copy()
    z[2000:2003, 0] += sizes[0]
    z[2002:2005, 0] += sizes[1]
    results = run(z)
    assert results['outlier'][2000:2005, 0].all()
    out = results['angular_velocity'] + results['bias']
    assert np.abs(out - truth)[1990:2020].max() < 0.1


def test_a_shake_is_that_of_one_sample(random):
    """Axes that change in turn were taken for one change, which explained larger jumps."""
    z, accelerations = at_rest(random), still_accelerations(random)
    moving = 2.0 * np.sin(2 * np.pi * 0.7 * np.arange(2000) / 100.0)
    z[:2000] += moving[:, None]
    accelerations[1500:, 0] += 9.0
    accelerations[1501:, 1] += 8.0
    filter_ = Filter(Parameters(sample_rate=100.0))
    filter_.run(even_stamps(1502), z[:1502], accelerations[:1502])
    circumstances = filter_.record[0]['workspace']['methods']['adaptive']['circumstances']
    assert not circumstances['still']
    assert circumstances['shake'] == pytest.approx(9.0, abs=0.2)  # 12.0 before


def test_a_message_that_is_corrupted_as_a_whole_is_held(random):
    z, accelerations = at_rest(random), still_accelerations(random)
    z[2000, 0] += 5.0
    accelerations[2000] += 20.0
    results = with_accelerations(z, accelerations)
    assert results['outlier'][2000, 0] == 1
    assert np.abs(results['angular_velocity'][1990:2010]).max() < 0.02


def test_whole_drop_outs_cost_no_smoothing(random):
    z, accelerations = at_rest(random), still_accelerations(random)
    clean = with_accelerations(z, accelerations)['angular_velocity'][1000:].std()
    for k in range(1000, 3000, 50):
        z[k : k + 2] = 0.0
        accelerations[k : k + 2] = 0.0
    dropped = with_accelerations(z, accelerations)['angular_velocity'][1000:].std()
    assert dropped < 1.2 * clean


def test_the_variance_is_not_too_small_while_bridging(random):
    time = np.arange(3000) / 100
    truth = 2 * np.sin(2 * np.pi * time)[:, None] * np.ones(3)
    for missing in (1, 5, 20):
        errors, claimed = [], []
        for begin in range(2000, 2900, 90):
            z = truth + 0.005 * random.standard_normal(truth.shape)
            z[begin : begin + missing] = np.nan
            result = run(z[: begin + missing])[-1]
            errors.append(result['angular_velocity'] - truth[begin + missing - 1])
            claimed.append(result['angular_velocity_variance'])
        ratio = np.sqrt(np.mean(claimed)) / np.sqrt(np.mean(np.square(errors)))
        assert 0.7 < ratio < 5


values = st.one_of(
    st.floats(-1e6, 1e6, allow_nan=False),
    st.floats(-40.0, 40.0, allow_nan=False),
    st.floats(-1e-3, 1e-3, allow_nan=False),
)
pieces = st.lists(
    st.tuples(
        st.tuples(values, values, values),
        st.integers(1, 60),
        st.sampled_from(['constant', 'alternate', 'ramp', 'noise', 'sparse']),
    ),
    max_size=12,
)


def sequence(parts):
    """Return (n, 3) of pieces that are constant, alternate, grow, are random or mostly zero."""
    random = np.random.default_rng(len(parts))
    out = []
    for level, length, shape in parts:
        k = np.arange(length)[:, None]
        scale = {
            'constant': np.ones((length, 1)),
            'alternate': np.where(k % 2, 1.0, -1.0),
            'ramp': (k + 1) / length,
            'noise': random.uniform(-1, 1, (length, 3)),
            'sparse': 1.0 * (random.random((length, 3)) < 0.1),
        }[shape]
        out.append(np.array(level) * scale * np.ones((length, 3)))
    return np.concatenate(out) if out else np.zeros((0, 3))


@pytest.mark.slow
@settings(max_examples=400, deadline=None)
@given(parts=pieces, last=st.tuples(values, values, values), rate=st.sampled_from(RATES))
@example(
    parts=[((0.0, 0.0, 0.0), 1, 'constant'), ((0.0, 0.0, 5.0), 39, 'noise')],
    last=(0, 1, 0),
    rate=50,
)
def test_never_locked_out_and_always_finite(parts, last, rate):
    """After any input, 20 samples of a constant rate bring the output within 5 % of it.

    But for the angle of held samples that is made up for meanwhile, which takes three seconds.
    """
    begin = sequence(parts)
    z = np.concatenate([begin, np.tile(last, (max(20, round(3 * rate)), 1))])
    results = run(z, rate)
    for name in results.dtype.names:
        assert np.isfinite(results[name]).all(), name
    for name in ('innovation_variance', 'angular_velocity_variance', 'measurement_noise'):
        assert (results[name] > 0).all(), name
    assert (results['process_noise'] >= 0).all()
    # Held samples are extrapolated, but no further than a body could turn.
    reach = np.abs(z).max() + 20 * max(500 / rate, 0.1 * np.abs(z).max())
    assert np.abs(results['angular_velocity']).max() <= reach
    tolerance = 0.05 * np.abs(last) + 1e-9 * np.abs(z).max()
    off = np.abs(results['angular_velocity'] - last)
    assert (off[len(begin) + 19] <= tolerance + LARGEST_COMPENSATION / COMPENSATION_SECONDS).all()
    left = LARGEST_COMPENSATION / COMPENSATION_SECONDS * np.exp(-3.0 * rate * COMPENSATION_SHARE)
    # What smoothing has not put out, of the size of the noise, is given back slowly; and where the
    # noise is found to be less, at once. On a body that turns it comes to the other axes.
    noise = results['measurement_noise'][-round(rate) :]
    angle = SMOOTHING_DEVIATIONS * np.sqrt(0.5 * noise.max(axis=0) * SMOOTHING_SECONDS / rate)
    at_once = min(1.0 / COMPENSATION_SECONDS, COMPENSATION_SHARE * rate)
    falls = noise[-1] < 0.999 * noise.max(axis=0)
    given_back = angle * np.where(falls, at_once, 1.0 / SMOOTHING_SECONDS)
    left = left + (given_back.max() if np.any(last) else given_back)
    assert (off[-1] <= tolerance + 1e-3 + left).all()


def test_an_axis_that_is_constant_at_first_has_noise_all_the_same(random):
    """Where its variance was taken for 0, the errors of the modes were not computed for it."""
    z = motion_below(4.0, random, 400, 100.0) + 0.003 * random.standard_normal((400, 3))
    z[:60, 1] = 0.0
    still, filter_ = still_accelerations(random, 400), Filter()
    for k in range(0, 400, 20):
        part = slice(k, k + 20)
        filter_.run(stamps(400, 100.0)[part], z[part], still[part])
        noise = filter_.state['methods']['adaptive'][1]['noise']
        assert largest_variance(noise) >= noise['variance'] > 0.0


@pytest.mark.parametrize('deviation', [1e-4, 0.005, 0.05])
@pytest.mark.parametrize('rate', [100.0, 400.0, 1000.0])
@pytest.mark.parametrize('size', [1.0, 5.0, 30.0, 1e4])
def test_a_step_is_followed_within_a_few_samples(size, rate, deviation, random):
    """Five samples at most; two more where no body could turn so suddenly.

    What they turned is given back meanwhile, a sixteenth of it with each sample at most.
    """
    n, at = int(6 * rate), int(4 * rate)
    z = deviation * random.standard_normal((n, 3))
    z[at:] += size
    out = run(z, rate)['angular_velocity'][at : at + int(rate)]
    held = 5 if size * rate <= 1000 else 7
    seconds = max(COMPENSATION_SECONDS, 1 / (COMPENSATION_SHARE * rate))
    giving_back = held / (rate * seconds) * np.exp(-(np.arange(int(rate)) - held) / rate / seconds)
    allowed = (0.05 + giving_back) * size + 3.5 * deviation
    assert (np.abs(out - size).max(axis=1) <= allowed)[held:].all()


@pytest.mark.parametrize('hertz', [2.0, 5.0])
@pytest.mark.parametrize('deviation', [1e-4, 0.005, 0.05])
def test_a_sinusoid_lags_less_than_a_sample(hertz, deviation, random):
    rate = 100.0
    time = np.arange(3000) / rate
    wave = np.where(time > 10, np.sin(2 * np.pi * hertz * (time - 10)), 0.0)
    z = wave[:, None] + deviation * random.standard_normal((len(time), 3))
    out = run(z, rate)['angular_velocity']
    settled = time > 12
    turn = np.exp(-2j * np.pi * hertz * time[settled])
    response = (out[settled] * turn[:, None]).sum(axis=0) / (wave[settled] * turn).sum()
    lag = -np.angle(response) / (2 * np.pi * hertz) * rate
    assert (np.abs(lag) < 0.5).all()
    assert (np.abs(np.abs(response) - 1) < 0.05).all()


def at_rest(random, n=3000, deviation=0.005):
    return deviation * random.standard_normal((n, 3))


def test_a_spike_leaves_no_trace(random):
    z = at_rest(random)
    clean = run(z)['angular_velocity']
    z[2000, 0] += 5.0
    results = run(z)
    assert results['outlier'][2000].tolist() == [1, 0, 0]
    assert np.abs(results['angular_velocity'] - clean).max() < 0.005


def test_a_burst_of_three_leaves_no_trace(random):
    z = at_rest(random)
    clean = run(z)['angular_velocity']
    z[2000:2003, 1] += 8.0
    results = run(z)
    assert results['outlier'][2000:2003, 1].all()
    assert results['outlier'].sum() == 3
    assert np.abs(results['angular_velocity'] - clean).max() < 0.01


def test_a_drop_out_to_zero_is_held(random):
    z = np.array([1.0, -0.5, 0.2]) + at_rest(random)
    z[2000:2002] = 0.0
    results = run(z)
    assert results['outlier'][2000:2002].all()
    assert np.abs(results['angular_velocity'][1990:2010] - [1.0, -0.5, 0.2]).max() < 0.02


def test_outliers_pass_where_they_are_to_be_taken_as_they_are(random):
    z = at_rest(random)
    z[2000, 0] += 5.0
    results = run(z, outlier_enabled=False)
    assert not results['outlier'].any()
    assert results['angular_velocity'][2000, 0] > 4.0


def test_the_variance_is_fixed_before_the_sample_is_seen(random):
    z = at_rest(random)
    before = run(z)['innovation_variance'][2000]
    z[2000] += 100.0
    np.testing.assert_array_equal(run(z)['innovation_variance'][2000], before)


def test_a_known_noise_level_is_used_from_the_first_sample(random):
    z = at_rest(random, 200, 0.05)
    results = run(z, model_noise_deviation=(0.05, 0.05, 0.05))
    np.testing.assert_allclose(results['measurement_noise'][0], 0.05**2)
    np.testing.assert_allclose(np.sqrt(results['measurement_noise'][-1]), 0.05, rtol=0.2)


def test_a_known_noise_level_is_never_less_than_that_of_any_sensor(random):
    """The square of the smallest numbers that can be set is zero."""
    z = at_rest(random, 200)
    results = run(z, model_noise_deviation=(1e-300, 1e-160, 1e-9))
    assert np.isfinite(results['angular_velocity']).all()
    assert (results['angular_velocity_variance'] > 0.0).all()
    np.testing.assert_allclose(results['measurement_noise'][0], 1e-4**2)


def test_a_known_noise_level_survives_a_start_in_motion(random):
    """The first changes between samples are motion then, not the sensor's resolution."""
    turn = 5.0 * np.sin(2 * np.pi * np.arange(300) / 100.0)[:, None]
    z = turn + at_rest(random, 300, 0.005)
    results = run(z, model_noise_deviation=(0.005, 0.005, 0.005))
    assert np.sqrt(results['measurement_noise'].max()) < 0.0075
    error = results['angular_velocity'] - turn
    assert np.sqrt((error**2).mean()) < 1.1 * np.sqrt(((z - turn) ** 2).mean())


@pytest.mark.slow
@pytest.mark.parametrize(('phi', 'correlation'), [(0.01, 0.8), (0.8, 0.0)])
def test_the_correlation_of_a_known_noise_is_taken_out_from_the_first_sample(
    phi, correlation, random
):
    """The late innovations of a start at rest, before any block of noise has been judged."""
    starts = autoregressive(random, 40_000, 0.8, 0.005).reshape(-1, 16, 3)[:500]
    known = {'model_noise_deviation': (0.0083,) * 3, 'model_phi': (phi,) * 3}
    innovations = np.array([run(z, **known)['innovation'][8:] for z in starts])
    products = innovations[:, 1:] * innovations[:, :-1]
    assert products.mean() / (innovations**2).mean() == pytest.approx(correlation, abs=0.3)


@pytest.mark.parametrize('deviation', [1e-4, 1e-3, 1e-2, 1e-1])
def test_the_noise_level_is_learned_at_rest(deviation, random):
    results = run(at_rest(random, 3000, deviation))
    learned = np.sqrt(results['measurement_noise'][-1])
    np.testing.assert_allclose(learned, deviation, rtol=0.1)


@pytest.mark.parametrize('rate', [200.0, 1000.0])
def test_a_sensor_with_less_noise_than_any_of_mems_comes_to_rest_at_once(rate, random):
    """R is larger than its noise, as of a fibre-optic gyroscope, which is white nevertheless."""
    n, deviation = int(80 * rate), 1e-5
    truth = np.zeros((n, 3))
    for start in (10, 32, 58):
        moving = slice(int(start * rate), int((start + 15) * rate))
        truth[moving] = by_hand(random, 15, rate)[0]
    z = truth + deviation * random.standard_normal((n, 3))
    error = run(z, rate)['angular_velocity'] - truth
    for stop in (25, 47, 73):
        assert error[int((stop + 0.3) * rate) : int((stop + 5) * rate)].std() < 0.8 * deviation


@pytest.mark.slow
@pytest.mark.parametrize('rate', RATES)
def test_the_modes_have_what_the_riccati_recursion_settles_to(rate):
    """Against the plain recursion of equations (8), (9) and (12), run until it stands."""
    filter_ = Filter(Parameters(sample_rate=rate))
    filter_.step(10**18, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    modes = filter_.record[0]['coefficients']['methods']['adaptive']['modes']
    for j in range(0, MODES, 3):
        r, q = modes['lag_ratio'][j], modes['process_ratio'][j]
        # At 4 kHz the steps of the slowest mode would drown in the rounding of doubles.
        a = np.array([[1.0, 1.0, 0.0], [0.0, r, 1.0], [0.0, 0.0, r]], np.longdouble)
        drive = np.array([1.0, 2 * r, r * r], np.longdouble)
        p = np.outer(drive, drive) * q
        for _ in range(200_000):
            gain = p[:, 0] / (p[0, 0] + 1.0)
            grown = a @ (p - np.outer(gain, p[0])) @ a.T + q * np.outer(drive, drive)
            settled = np.abs(grown - p).max() <= 1e-18 * np.abs(p).max()
            p = grown
            if settled:
                break
        gains = [modes[f'gain_{name}'][j] for name in ('rate', 'acceleration', 'jerk')]
        np.testing.assert_allclose(gains, p[:, 0] / (p[0, 0] + 1.0), rtol=1e-5)
        np.testing.assert_allclose(modes['innovation_ratio'][j], p[0, 0] + 1.0, rtol=1e-9)
    assert (np.diff(modes['gain_rate'][:MODES]) > 0).all()
    stay = modes['transitions']['stay'][:, :MODES]
    assert ((stay > 0) & (stay < 1)).all()


def error_of_a_mode(modes, j, first, second):
    """Return the variance of a mode's rate: of mode and AR(2) noise as one linear system."""
    b = (second - first**2) / (1.0 - first**2)
    a = first * (1.0 - b)
    r = modes['lag_ratio'][j]
    gains = np.array([modes[f'gain_{name}'][j] for name in ('rate', 'acceleration', 'jerk')])
    together = np.zeros((5, 5))
    together[:3, :3] = np.array([[1.0, 1.0, 0.0], [0.0, r, 1.0], [0.0, 0.0, r]])
    together[:3, :3] -= np.outer(gains, together[0, :3])
    together[:3, 3:] = np.outer(gains, (a, b))
    together[3, 3:], together[4, 3] = (a, b), 1.0
    drive = np.concatenate([gains, [1.0, 0.0]])
    innovation = 1.0 - a * first - b * second
    return solve_discrete_lyapunov(together, innovation * np.outer(drive, drive))[0, 0]


@pytest.mark.parametrize('rate', [10.0, 100.0, 1000.0])
@pytest.mark.parametrize(
    ('first', 'second'),
    # White; AR(1); a low-pass of second order; vibrations of 0.18 and 0.37 of the sample rate.
    [(0.0, 0.0), (0.6, 0.36), (-0.4, 0.16), (0.945, 0.81), (0.41, -0.61), (-0.67, -0.02)],
)
def test_the_error_of_a_mode_is_that_of_correlated_noise(rate, first, second):
    """The larger one of what AR(1) and AR(2) noise leave."""
    filter_ = Filter(Parameters(sample_rate=rate))
    filter_.step(10**18, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    filter_.state['methods']['adaptive'][0]['noise']['autocorrelation'][:] = first, second
    filter_.step(10**18 + round(1e9 / rate), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    modes = filter_.record[0]['coefficients']['methods']['adaptive']['modes']
    error = filter_.record[0]['workspace']['methods']['adaptive']['axes'][0]['error']
    ratios = error / error[-1]
    expected = [
        max(error_of_a_mode(modes, j, first, second), error_of_a_mode(modes, j, first, first**2))
        for j in range(MODES)
    ]
    np.testing.assert_allclose(ratios, np.array(expected) / expected[-1], rtol=1e-6)
    np.testing.assert_allclose(expected[-1], 1.0, rtol=1e-3)


@pytest.mark.parametrize('rate', RATES)
def test_the_transition_matrices_keep_the_probability(rate):
    """The matrices that the geometric shares stand for, written out, have columns of sum one."""
    filter_ = Filter(Parameters(sample_rate=rate))
    filter_.step(10**18, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    modes = filter_.record[0]['coefficients']['methods']['adaptive']['modes']
    further = modes['up_further']
    for transitions in modes['transitions']:
        down_further = transitions['down_further']
        matrix = np.diag(transitions['stay'][:MODES])
        for j in range(MODES):
            share = transitions['up_first'][j]
            for k in range(j + 1, MODES):
                matrix[k, j] = share = share * further[k] if k > j + 1 else share
            share = transitions['down_first'][j, 0]
            for k in range(j - 1, -1, -1):
                matrix[k, j] = share = share * down_further[k, 0] if k < j - 1 else share
        assert (matrix >= 0).all()
        np.testing.assert_allclose(matrix.sum(axis=0), 1.0, rtol=1e-12)
        # Of acceleration and jerk a part is kept on the way down.
        kept = transitions['down_first'][1:MODES, 2:] / transitions['down_first'][1:MODES, :1]
        assert ((kept > 0) & (kept < 1)).all()


@pytest.mark.parametrize('knock', [True, False])
def test_a_knock_that_was_held_back_does_not_turn_the_heading(knock, random):
    """One sample of 3 rad/s: real where the accelerometer feels it, else an outlier."""
    z = at_rest(random, 3000, 0.002)
    z[2000, 1] += 3.0
    acceleration = np.tile([0.0, 0.0, 9.81], (3000, 1)) + 0.02 * random.standard_normal((3000, 3))
    if knock:
        acceleration[2000:2004] += 60.0 * random.standard_normal((4, 3))
    stamps = START + 3_500_000 * np.arange(3000)
    out = Filter(Parameters(bias_enabled=False)).run(stamps, z, acceleration)
    assert out['outlier'][2000, 1] == 1.0
    turned = (out['angular_velocity'] - z)[1900:2600, 1].sum() * 0.0035
    assert turned == pytest.approx(0.0 if knock else -3.0 * 0.0035, abs=6e-4)
    assert np.abs(out['angular_velocity'][2000:, 1]).max() < 0.06


@pytest.mark.slow
def test_fast_motion_from_power_on_is_not_taken_for_noise():
    """At 50 Hz a jerk in a block of few samples looks like noise; calmer blocks tell otherwise."""
    worst = []
    for seed in range(8):
        world = make_world(50.0, 0.005, 'autoregressive', seed)
        for trial in world.trials:
            first = np.flatnonzero(~trial.rest)[0] + 75
            truth, resting = trial.truth[first:], trial.rest[first:]
            z = truth + world.noise[: len(truth)]
            results = Filter(Parameters()).run(stamps(len(z), 50.0), z, trial.acceleration[first:])
            until = np.flatnonzero(resting)[0]
            error = (results['angular_velocity'] - truth)[100:until]
            worst.append(np.sqrt(np.mean(error**2, axis=0)).max() / 0.005)
    assert max(worst) < 1.5
    assert np.median(worst) < 1.1


@pytest.mark.slow
def test_motion_is_not_taken_for_the_noise_of_a_coarse_sensor_at_its_first_rest():
    """Where noise is a part of a count, rates stay the same at rest, as if the bus had hung."""
    step, deviation = 0.005, 0.001
    for seed in range(8):
        world = make_world(50.0, deviation, 'autoregressive', seed)
        for trial in world.trials:
            first = np.flatnonzero(~trial.rest)[0] + 75
            z = trial.truth[first:] + world.noise[: len(trial.truth) - first]
            z = step * np.round(z / step)
            results = Filter(Parameters()).run(stamps(len(z), 50.0), z, trial.acceleration[first:])
            assert results['at_rest'].any()
            noise = np.sqrt(results['measurement_noise'][-1]).max()
            assert noise < 1.5 * np.hypot(deviation, step / np.sqrt(12.0)), seed


@pytest.mark.parametrize('rate', [50.0, 100.0, 200.0])
def test_the_noise_of_a_motor_that_has_stopped_is_forgotten(rate, random):
    """It was ten times the sensor's own; four seconds later little of it is left in R."""
    loud, still = round(10 * rate), round(4 * rate)
    z = 0.005 * random.standard_normal((loud + still, 3))
    z[:loud] *= 10.0
    out = Filter(Parameters()).run(stamps(len(z), rate), z, still_accelerations(random, len(z)))
    assert np.sqrt(out['measurement_noise'][loud - 1]).min() > 0.045
    assert np.sqrt(out['measurement_noise'][-1]).max() < 0.0125


@pytest.fixture
def stops(random):
    """Motion that ends after 25 s, on a gyroscope that has stood still for 20 s before."""
    truth = np.zeros((40, 2800, 3))
    time = np.arange(500) / 100
    truth[:, 2000:2500] = np.sin(2 * np.pi * 1.7 * time)[:, None]
    z = truth + 0.005 * random.standard_normal(truth.shape)
    return z, truth, still_accelerations(random, 2800)


def error_after_the_stop(stops, turning):
    """Return the rms error of the first axis from 0.2 to 1 s after; another may go on turning."""
    z, truth, accelerations = stops
    z = z.copy()
    z[:, 2000:, 2] += turning
    out = np.array([with_accelerations(one, accelerations)['angular_velocity'] for one in z])
    return np.sqrt(np.mean((out - truth)[:, 2520:2600, 0] ** 2))


@pytest.mark.slow
def test_a_stop_is_seen_sooner_where_all_axes_stand(stops):
    assert error_after_the_stop(stops, 0.0) < 0.7 * error_after_the_stop(stops, 0.5)


@pytest.mark.parametrize('frequency', [1.0, 2.0, 3.0])
@pytest.mark.parametrize('amplitude', [0.15, 0.5, 1.0])
def test_before_the_first_rest_motion_is_hardly_booked_as_noise(amplitude, frequency):
    """Blocks that look like noise still hold some motion: they had R up to 3.6 times too large."""
    deviation, learned = 0.05, []
    time = np.arange(3000) / 100.0
    for seed in range(5):
        random = np.random.default_rng(seed)
        shaken = amplitude * np.sin(2 * np.pi * frequency * time[:, None] + np.arange(3))
        rates = shaken + deviation * random.standard_normal((len(time), 3))
        accelerations = (0.0, 0.0, 9.81) + 0.5 * random.standard_normal((len(time), 3))
        filter_ = Filter()
        results = filter_.run(even_stamps(len(time)), rates, accelerations)
        learned.append(results['measurement_noise'][-1] / deviation**2)
    assert 0.7 < np.median(learned) < 2.0


@pytest.mark.slow
def test_a_shake_announces_a_motion(random):
    """What turns a body shakes its accelerometer: the filter follows the rate sooner."""
    begin = np.concatenate([np.zeros(2000), 0.5 * np.arange(10) / 100])[:, None] * np.ones(3)
    shaken, calm = [], []
    for _ in range(40):
        z, accelerations = begin + at_rest(random, 2010), still_accelerations(random, 2010)
        calm.append(with_accelerations(z, accelerations)['angular_velocity'][2000:])
        accelerations[2000:, 0] += 0.3 * random.standard_normal(10)
        shaken.append(with_accelerations(z, accelerations)['angular_velocity'][2000:])
    error, of_calm = (
        np.sqrt(np.mean((np.array(out) - begin[2000:]) ** 2)) for out in (shaken, calm)
    )
    assert error < 0.9 * of_calm


@pytest.mark.parametrize('nothing', [0.0, np.nan])
def test_a_robot_without_an_accelerometer_is_not_always_shaken(nothing, random):
    z, still = at_rest(random), still_accelerations(random)
    with_one = with_accelerations(z, still)['angular_velocity'][1500:].std()
    without = with_accelerations(z, np.full_like(still, nothing))['angular_velocity'][1500:].std()
    assert without < 1.1 * with_one


@pytest.mark.slow
def test_a_slow_turn_that_begins_in_motor_vibration_is_given_back(random):
    """It is half of the vibration, so it shows only when it has become a fast turn."""
    rate = np.radians(np.repeat([0.0, 0.55, 20.0], [6000, 200, 3000]))
    rate = np.convolve(np.pad(rate, 10, mode='edge'), np.full(21, 1 / 21), 'valid')
    lacking = []
    for _ in range(16):
        z = rate[:, None] * [1.0, 0.0, 0.0] + np.radians(1.0) * random.standard_normal((9200, 3))
        stamps = even_stamps(len(z), 200.0)
        results = Filter(Parameters()).run(stamps, z, still_accelerations(random, len(z)))
        difference = (z - results['bias'] - results['angular_velocity'])[6000:, 0]
        lacking.append(np.degrees(np.cumsum(difference) * 0.005))
    when_seen, later = np.mean(lacking, axis=0)[[199, -1]]
    assert when_seen > 0.1
    assert abs(later) < 0.75 * when_seen


def reasons_of(stamps, rates, accelerations):
    """Return all reasons; what is held back, and nothing else, has to be flagged."""
    filter_, found = Filter(), set()
    axes = filter_.record[0]['workspace']['methods']['adaptive']['axes']
    states = filter_.state['methods']['adaptive']
    for stamp, rate, acceleration in zip(stamps, rates, accelerations, strict=True):
        axes['reason'] = -1
        result = filter_.step(int(stamp), rate, acceleration)
        for axis in np.flatnonzero(axes['reason'] >= 0).tolist():
            reason = Reason(axes['reason'][axis])
            found.add(reason)
            # The next noise is predicted by what was accepted, and measured, alone.
            decision, run = decision_of(reason), states[axis]['noise']['block']['run']
            measured = decision == Decision.ACCEPT and not axes['hangs'][axis]
            assert (run > 0) == measured
            assert (result['outlier'][axis] > 0.0) == (decision == Decision.HOLD)
    return found


def test_each_reason_is_given_for_some_sample(random):
    n = 5000
    rates = 0.005 * random.standard_normal((n, 3))
    accelerations = np.array([0.0, 0.0, 9.8]) + 0.02 * random.standard_normal((n, 3))
    rates[0] += 20.0  # corrupted, and nothing speaks for it
    in_motion = slice(2000, 3000)
    rates[in_motion] += 8.0 * np.sin(np.outer(np.arange(1000) / 100.0, [25.0, 20.0, 30.0]))
    rates[2600:2800:5] = rates[2599:2799:5]  # polled faster than it measures
    rates[1200:1500:3, 0] += 2.0  # so often that it can't be outliers
    rates[2520:2600:10] = 0.0  # nothing to report
    rates[2810:2822] = 0.0  # ... for longer than samples are held back
    rates[1700:1712, 1] += 1.5 * np.sin(np.linspace(0.0, np.pi, 12))  # a motion from rest
    rates[1800, 0] += 0.5  # a knock
    accelerations[1800] += 30.0
    rates[1850, 1] += 1.5  # one that is over at once
    accelerations[1850] += 30.0
    rates[1900:1903, 0] += [1.5, 1.2, 0.8]  # a harder one
    accelerations[1900] += 30.0
    for first in range(2100, 2500, 40):  # faster and faster, the way it turns
        way = np.sign(rates[first, 0] - rates[first - 1, 0])
        size = (first // 40 % 4 + 2) / 3
        rates[first : first + 5, 0] += way * size * np.array([2.0, 3.5, 6.0, 8.0, 10.0])
    rates[2900:3000] = rates[2900:3000].clip(-7.5, 7.5)  # the end of the range
    rates[3500:3520, 2] += 5.0 * (-1.0) ** np.arange(20)  # no motion, and no outliers either
    rates[3700:3740, 1] = 3.0  # a constant
    kept = np.ones(n, bool)
    kept[4000:4004] = False
    rates[4004:4020] += 1.0  # what went on meanwhile
    rates[4300:4400, 0] += 13.0 - 13.0 * np.cos(np.linspace(0.0, np.pi, 100))  # a swing ...
    rates[4400:4404, 0] += [20.0, 14.0, 8.0, 2.0]  # ... that ends in a strike
    rates[4600:4650, 2] += np.linspace(0.0, 50.0, 50)  # a body that spins up, until it is held
    rates[4650:4800, 2] += 50.0
    stamps = even_stamps(n)
    found = reasons_of(stamps[kept], rates[kept], accelerations[kept])
    assert found == set(Reason)


@pytest.mark.parametrize('period', [1e-4, 0.01, 0.2, 0.5, LONGEST_PERIOD])
def test_no_transition_is_less_likely_than_never(period):
    """At a few samples a second a mode would be left upwards and downwards more than always."""
    modes = zeroed(MODE_SET)[0]
    derive_mode_set(period, modes, zeroed(DERIVATION)[0])
    for transition in Transition:
        for name in ('stay', 'up_first', 'down_first', 'down_further'):
            assert modes['transitions'][transition][name].min() >= 0.0


@pytest.mark.parametrize('seed', range(4))
def test_a_simulated_body_without_noise_is_followed_when_it_is_shaken(seed):
    """It stands for 5 s, and is then shaken by some 500 deg/s for 20 s."""
    random = np.random.default_rng(seed)
    sections = signal.butter(3, 8.0, fs=100.0, output='sos')
    shaken = signal.sosfiltfilt(sections, random.standard_normal((2000, 3)), axis=0)
    shaken *= np.minimum(np.arange(2000) / 100.0, 1.0)[:, None] / shaken.std()
    rates = np.concatenate([np.zeros((500, 3)), 8.0 * shaken])
    accelerations = np.tile((0.0, 0.0, 9.81), (len(rates), 1))
    accelerations[500:] += 20.0 * shaken[:, [1, 2, 0]]
    results = Filter().run(even_stamps(len(rates)), rates, accelerations)
    assert np.abs(results['angular_velocity'] - rates)[500:].max() < 0.05


@pytest.mark.parametrize('rate', [100.0, 200.0, 400.0])
def test_a_vibration_near_half_the_sample_rate_hides_no_slow_motion(rate, random):
    """It alternates from sample to sample, and was taken for noise that wanders as slowly."""
    n = round(60 * rate)
    time = np.arange(n) / rate
    hand = motion_below(2.0, random, n, rate)
    truth = hand / hand.std() * np.clip(time - 20.0, 0.0, 1.0)[:, None]
    tone = np.outer(0.05 * np.sin(2 * np.pi * 0.49 * rate * time + 1.0), [1.0, -0.7, 0.5])
    z = truth + tone + 0.004 * random.standard_normal((n, 3))
    results = at_rate(rate, z, still_accelerations(random, n))
    sections = signal.butter(3, 8.0, fs=rate, output='sos')
    errors = signal.sosfiltfilt(sections, results['angular_velocity'] - truth, axis=0)
    assert np.sqrt(np.mean(errors[round(25 * rate) :] ** 2)) < 0.015
    deviation = np.sqrt(results['angular_velocity_variance'][round(25 * rate) :])
    inside = np.abs(results['angular_velocity'] - truth)[round(25 * rate) :] < 2.0 * deviation
    assert inside.mean() > 0.92


def test_slow_rates_that_a_driver_takes_for_none_are_no_drop_out(random):
    """It sends zeros where no axis turns by 0.3 deg/s, which noise exceeds now and then."""
    rates = 0.002 * random.standard_normal((6000, 3))
    turn, push = by_hand(random, 30)
    rates[1500:4500] += turn
    rates[np.abs(rates).max(axis=1) < 0.005] = 0.0
    accelerations = np.tile((0.0, 0.0, 9.81), (len(rates), 1))
    accelerations += 0.02 * random.standard_normal(accelerations.shape)
    accelerations[1500:4500] += push
    results = Filter().run(even_stamps(len(rates)), rates, accelerations)
    assert np.abs(results['angular_velocity'] - rates).max() < 0.02
    assert not results['outlier'].any()


@pytest.mark.parametrize('limit', [0.7, 0.9, 1.1, 1.5])
def test_zeros_of_a_driver_that_takes_more_than_the_noise_for_none_are_no_drop_out(limit, random):
    """At rest one axis now and then has a rate between zeros, and none is led away by it."""
    rates = 0.006 * random.standard_normal((9000, 3))
    turn, push = by_hand(random, 30)
    rates[3000:6000] += turn
    given = np.where(np.abs(rates) < np.radians(limit), 0.0, rates)
    accelerations = [0.0, 0.0, 9.81] + 0.02 * random.standard_normal(rates.shape)
    accelerations[3000:6000] += push
    results = Filter().run(even_stamps(len(rates)), given, accelerations)
    still = np.r_[1000:2900, 6600:9000]
    assert results['outlier'][still].mean() < 0.001
    led_away = np.abs(results['angular_velocity'])[still].max()
    assert led_away < 1.5 * max(np.abs(given[still]).max(), 0.03)


@pytest.mark.parametrize('deviation', [1e-4, 5e-3])
@pytest.mark.parametrize('rate', [20.0, 25.0, 30.0])
def test_a_hand_is_followed_at_a_low_rate(rate, deviation, random):
    """It turns back within two or three samples, as if it jumped."""
    hand = motion_below(5.0, random, 9000, 300.0)
    hand *= 6.0 * np.minimum(np.arange(9000) / 900.0, 1.0)[:, None] / hand.std()
    still = np.zeros((round(20 * rate), 3))
    truth = np.concatenate([still, hand[:: round(300.0 / rate)]])
    z = truth + deviation * random.standard_normal(truth.shape)
    results = at_rate(rate, z, still_accelerations(random, len(z)))
    later = slice(len(still) + round(5 * rate), None)
    assert not results['outlier'][later].any()
    error = (results['angular_velocity'] - truth)[later]
    assert np.sqrt(np.mean(error**2)) < 1.1 * deviation


def hand_without_rest(random, rate):
    """Return rates (n, 3) of a hand that moves at up to some 8 Hz from power-on, faster or not."""
    n = 300 * 60
    sections = signal.butter(2, [0.3, 8.0], 'bandpass', fs=300.0, output='sos')
    hand = signal.sosfiltfilt(sections, random.standard_normal((n, 3)), axis=0)
    pace = 0.3 + np.sin(np.arange(n) / 300.0 / 7.0) ** 2
    return (hand * pace[:, None] / hand.std())[:: round(300 / rate)]


@pytest.mark.parametrize('rate', [10.0, 15.0, 20.0, 30.0])
def test_a_hand_that_never_rests_is_no_noise_at_a_low_rate(rate, random):
    """Its samples are as white as noise is, and lie far apart."""
    truth = hand_without_rest(random, rate)
    z = truth + 2e-3 * random.standard_normal(truth.shape)
    results = run(z, rate)
    error = results['angular_velocity'] + results['bias'] - truth
    assert np.sqrt(np.mean(error**2)) < 1.4 * 2e-3
    assert not results['outlier'].any()


@pytest.mark.parametrize(
    ('rate', 'deviation'),
    [(20.0, 5e-4), (33.0, 5e-4), (20.0, 5e-3), (50.0, 5e-3), (60.0, 5e-3), (75.0, 5e-3)],
)
def test_motion_up_to_25_hz_from_power_on_is_no_noise(rate, deviation, random):
    """A block of it looks like noise now and then, so that R was 20 to 30 times the noise."""
    ratios = []
    for _ in range(8):
        n = round(30 * rate)
        frequencies = np.fft.rfftfreq(n, 1.0 / rate)[:, None]
        spectrum = random.standard_normal((len(frequencies), 3, 2)) @ [1.0, 1j]
        shape = (frequencies > 0.0) * (frequencies <= 25.0) * (1.0 + frequencies**2) ** -0.75
        truth = np.fft.irfft(shape * spectrum, n, axis=0)
        truth *= 2.0 / truth.std(axis=0)
        z = truth + deviation * random.standard_normal(truth.shape)
        results = run(z, rate)
        error = results['angular_velocity'] + results['bias'] - truth
        ratios.append(np.sqrt(np.mean(error**2)) / deviation)
    assert max(ratios) < 1.05


@pytest.mark.parametrize('rate', [10.0, 20.0, 30.0])
def test_a_sensor_that_never_rests_at_a_low_rate_has_an_honest_deviation(rate, random):
    seconds = np.arange(60 * rate) / rate
    truth = 0.5 * np.sin(2 * np.pi * 0.2 * seconds + np.arange(3)[:, None]).T
    z = truth + 6e-3 * random.standard_normal(truth.shape)
    filter_ = Filter()
    filter_.set_bias([0.0, 0.0, 0.0], 3 * [1e-4])
    stamps_ = START + np.round(seconds * 1e9).astype(np.int64)
    results = filter_.run(stamps_, z, np.zeros_like(z))[len(z) // 4 :]
    error = results['angular_velocity'] - truth[len(z) // 4 :]
    inside = error**2 < 4.0 * results['angular_velocity_variance']
    assert 0.85 < inside.mean() < 0.99


@pytest.mark.parametrize('every', [4, 8, 12, 20])
def test_real_walks_in_the_hand_are_followed_at_a_low_rate(every):
    paths = sorted(recorded(FLIGHTS).glob('room_*.npz'))
    assert paths
    for path in paths:
        with np.load(path) as data:
            t, z, acceleration = (data[name][::every] for name in ('t', 'rate', 'acc'))
        results = Filter().run(t, z.astype(float), acceleration.astype(float))
        change = results['angular_velocity'] + results['bias'] - z
        assert np.sqrt(np.mean(change[len(t) // 10 :] ** 2)) < np.radians(0.1), path.stem


def test_at_a_low_rate_the_accelerometer_sees_a_part_of_a_push(random):
    """A blow turns a sensor 3 cm from the axis; two thirds of the push show with the sample."""
    n, lever, jump = 4000, 0.03, 3.0
    time = np.arange(n) / 50.0
    truth = np.column_stack([np.sin(2 * np.pi * time), np.cos(2 * np.pi * time), 0.0 * time])
    truth[2000:, 2] = jump
    acceleration = still_accelerations(random, n)
    acceleration[2000, 0] += 2.0 / 3.0 * lever * jump / 0.02
    z = truth + 1e-3 * random.standard_normal(truth.shape)
    results = Filter().run(even_stamps(n, 50.0), z, acceleration)
    assert not results['outlier'][1000:].any()


def at_rate(rate, rates, accelerations):
    stamps = even_stamps(len(rates), rate)
    return Filter().run(stamps, rates, accelerations)


@pytest.mark.parametrize('rate', [5.0, 10.0, 25.0, 33.0])
def test_at_a_low_rate_outliers_at_rest_are_judged_as_at_others(rate, random):
    """A message that is corrupted as a whole, and two equal spikes."""
    z, accelerations = at_rest(random), still_accelerations(random)
    z[2000, 0] += 10.0
    accelerations[2000] += 6.0
    z[2500:2502, 1] += 8.0
    results = at_rate(rate, z, accelerations)
    assert results['outlier'][2000, 0]
    assert results['outlier'][2500, 1]
    if rate > 20.0:  # else the second one confirms a motion that any robot can make in 0.1 s
        assert results['outlier'][2501, 1]
        assert np.abs(results['angular_velocity'][1990:2600]).max() < 0.02


@pytest.mark.parametrize(('rate', 'size'), [(20.0, 18.0), (10.0, 20.0), (5.0, 25.0)])
def test_at_a_low_rate_large_spikes_in_motion_are_held(rate, size, random):
    time = np.arange(3000)[:, None] / rate
    z = at_rest(random) + 0.5 * np.sin(0.6 * time * [1.0, 0.7, 1.3] + [0.0, 1.0, 2.0])
    z[1000::50, 0] += size
    results = at_rate(rate, z, still_accelerations(random))
    assert results['outlier'][1000::50, 0].mean() > 0.9


def moved_about(random):
    """Return rates and accelerations (n, 3) at 100 Hz of a body that is turned about all axes."""
    n = 3000
    time = np.arange(n)[:, None] / 100.0
    rates = np.sin(2 * np.pi * time * [1.0, 0.7, 1.3] + [0.0, 1.0, 2.0])
    return rates + 0.002 * random.standard_normal((n, 3)), still_accelerations(random, n)


@pytest.mark.parametrize('length', [1, 2, 3])
def test_spikes_behind_a_push_are_held(length, random):
    """The push is believed at once, so that the modes expect anything of the samples after it."""
    rates, accelerations = moved_about(random)
    rates[2000:, 0] += 5.0
    accelerations[2000, 1] += 25.0
    rates[2001 : 2001 + length, 0] += 25.0
    results = with_accelerations(rates, accelerations)
    held = np.flatnonzero(results['outlier'][1990:2015, 0])
    assert held.tolist() == list(range(11, 11 + length))


def test_a_jolt_within_a_burst_is_no_knock(random):
    """The burst has begun with a jump that no knock makes."""
    rates, accelerations = moved_about(random)
    clean = with_accelerations(rates, accelerations)['angular_velocity']
    rates[2000:2003, 0] -= 11.0
    accelerations[2002] += [0.0, 5.0, 0.0]
    results = with_accelerations(rates, accelerations)
    assert results['outlier'][2000:2003, 0].all()
    assert np.abs(results['angular_velocity'] - clean).max() < 0.2


@pytest.mark.parametrize(
    ('before', 'shake', 'is_burst'), [(0.0, 10.0, True), (0.0, 20.0, False), (9.0, 10.0, False)]
)
def test_a_rate_that_stays_where_it_has_jumped_to(before, shake, is_burst, random):
    """A body that vibrates is shaken now and then: that makes no motion of a burst of outliers.

    But what stops a body may act close to the sensor, so that it is shaken less.
    """
    rates, accelerations = moved_about(random)
    rates[:2000, 0] += np.minimum(0.05 * np.arange(2000), before)
    rates[2000:2003, 0] -= 8.0 - before
    rates[2003:, 0] += before
    accelerations[2001:, 1] += shake
    results = with_accelerations(rates, accelerations)
    assert results['outlier'][2000:2003, 0].tolist() == [1, is_burst, is_burst]


def test_a_spike_before_a_motion_turns_nothing(random):
    """It comes with a jolt, and the next sample is back: its angle is not given back as motion."""
    rates = at_rest(random, 3000, 1e-4)
    accelerations = still_accelerations(random)
    time = np.arange(1000) / 100.0
    rates[2000:] += np.outer(np.sin(2 * np.pi * 1.5 * time), [0.0, 0.0, 3.0])
    clean = with_accelerations(rates, accelerations)['angular_velocity']
    rates[2000, 2] -= 33.0
    accelerations[1999:] += [5.0, 0.0, 0.0]
    results = with_accelerations(rates, accelerations)
    assert results['outlier'][2000, 2]
    lost = 0.01 * np.sum(results['angular_velocity'] - clean, axis=0)
    assert np.abs(lost).max() < 0.01


@pytest.mark.parametrize('rate', [25.0, 100.0])
def test_a_quiet_sensor_that_never_rests_is_not_said_to_be_noisy(rate, random):
    """R is at its floor from the start, but how noisy the sensor may be falls from sample on."""
    time = np.arange(int(60 * rate)) / rate
    truth = np.column_stack(
        [0.6 * np.sin(2 * time), 0.5 * np.sin(1.7 * time + 1), 0.4 * np.sin(time)]
    )
    rates = truth + 2e-4 * random.standard_normal(truth.shape)
    accelerations = [0.0, 0.0, 9.8] + 0.3 * random.standard_normal(truth.shape)
    results = Filter(Parameters(bias_enabled=False)).run(
        stamps(len(rates), rate), rates, accelerations
    )
    assert np.sqrt(results['angular_velocity_variance'][-1000:].mean()) < 0.005
