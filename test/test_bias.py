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

"""The bias, learned at rest: real motion and rests, warm-up, calibration, what can not be known."""

import numpy as np
import pytest

from benchmark.bias import on_other_sides, warm_up_standing
from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
from gyro_drift_filter.core.bias import at_rest as bias_at_rest
from gyro_drift_filter.core.bias.motion_state import BIAS
from gyro_drift_filter.core.bias.records import BIAS_RECORD
from gyro_drift_filter.core.bias.segments import note_segment, take_back
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.simulation.experiments import autoregressive
from support.messages import START
from support.rests import moving_and_resting, run
from support.sensor import DEGREE, NOISE, PHI, at_rest


@pytest.mark.parametrize('method', METHOD_NAMES)
@pytest.mark.parametrize('rate', [50.0, 100.0, 1000.0])
def test_the_bias_is_taken_off_after_the_first_rest(method, rate, random):
    truth = np.array([4.5, -3.0, 1.0]) * DEGREE
    results = run(
        Filter(Parameters(method=method, epsilon=1.0)), *at_rest(random, 30, truth, rate), rate
    )
    assert (results['bias'][0] == 0.0).all()
    late = results[len(results) // 2 :]
    np.testing.assert_allclose(late['bias'], np.tile(truth, (len(late), 1)), atol=0.04 * DEGREE)
    assert np.abs(late['angular_velocity'].mean(axis=0)).max() < 0.03 * DEGREE
    assert late['at_rest'].mean() > 0.9
    assert (late['angular_velocity_variance'] > 0).all()


def test_off_it_is_learned_but_left_in(random):
    truth = np.array([1.0, 2.0, -1.0]) * DEGREE
    filter_ = Filter(Parameters(bias_enabled=False))
    data = at_rest(random, 20, truth)
    results = run(filter_, *data)
    assert (results['bias'] == 0.0).all()
    np.testing.assert_allclose(results['angular_velocity'].mean(axis=0), truth, atol=2e-3)
    filter_.configure(Parameters())
    result = filter_.step(START + 20 * 10**9, data[0][-1], data[1][-1])
    np.testing.assert_allclose(result['bias'], truth, atol=0.05 * DEGREE)


@pytest.mark.parametrize('accelerometer', [True, False])
def test_a_start_in_motion_invents_no_bias(accelerometer, random):
    rates, accelerations = moving_and_resting(random, [(120, True)], lambda time: 0.0)
    results = run(Filter(), rates, accelerations if accelerometer else 0.0 * accelerations)
    # By gravity, where there is an accelerometer, it is known that it is none.
    assert np.abs(results['bias']).max() < (1e-3 if accelerometer else 1e-9)
    assert (results['at_rest'] == 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize('noise', [5e-4, 2e-3, 5e-3])
def test_a_sensor_that_warms_up_while_it_stands_is_followed(noise, random):
    """By 1 deg/s within ten minutes, with a time constant of five."""
    rates, accelerations = at_rest(random, 600)
    time = np.arange(len(rates)) / 100.0
    bias = np.outer(1.0 - np.exp(-time / 300.0), (1.0, -1.0, 1.0)) * DEGREE
    results = run(Filter(), bias + noise * random.standard_normal(rates.shape), accelerations)
    left, deviation = results['angular_velocity'], results['angular_velocity_variance'] ** 0.5
    assert np.abs(left[500:].sum(axis=0)).max() / 100.0 < 9.0 * DEGREE
    assert (np.abs(left) < 2.0 * deviation)[500:].mean() > 0.8


@pytest.mark.slow
def test_a_sensor_that_feels_gravity_finds_its_bias_on_each_side(random):
    """Where it lies otherwise its bias is another one, and no turn."""
    error, lost = on_other_sides(random, 0.1, 100.0)
    assert error < 0.02
    assert lost < 10.0


def test_standing_still_by_the_robots_own_word_is_believed_at_once(random):
    """After a slow turn the filter would wait for a second segment that agrees."""
    filter_ = Filter()
    run(filter_, *at_rest(random, 10))
    shift = np.array([0.0, 0.0, 0.6]) * DEGREE
    for second in range(5):
        filter_.hint(moves=False)
        run(filter_, *at_rest(random, 1, shift), start=START + (10 + second) * 10**9)
    np.testing.assert_allclose(filter_.state['bias']['bias'][2], shift[2], atol=0.1 * DEGREE)


@pytest.mark.parametrize('seed', [1, 2, 6, 7])
def test_a_bias_that_jumped_by_the_robots_own_word_is_that_in_motion_as_well(seed):
    """The bias in motion was not said to have jumped, and was off by 0.07 to 0.09 deg/s."""
    random, filter_ = np.random.default_rng(seed), Filter()
    run(filter_, *moving_and_resting(random, [(10, False), (20, True)], lambda time: np.zeros(3)))
    jump = np.array([0.5, -0.5, 1.0]) * DEGREE
    for second in range(30, 38):
        filter_.hint(moves=False)
        run(filter_, *at_rest(random, 1, jump), start=START + second * 10**9)
    rates, accelerations = moving_and_resting(random, [(20, True)], lambda time: jump)
    results = run(filter_, rates, accelerations, start=START + 38 * 10**9)
    assert np.abs(results['bias'][1000] - jump).max() < 0.05 * DEGREE


def test_a_rate_beyond_the_largest_bias_is_left_in_and_counted(random):
    filter_ = Filter()
    results = run(filter_, *at_rest(random, 60, (0.0, 0.0, 12.0 * DEGREE)))
    assert np.abs(results['bias']).max() < 1e-3
    assert filter_.state['bias']['segments_beyond_max'] > 20
    filter_ = Filter(Parameters(bias_max=0.3))
    results = run(filter_, *at_rest(random, 60, (0.0, 0.0, 12.0 * DEGREE)))
    assert results['bias'][-1, 2] == pytest.approx(12.0 * DEGREE, rel=0.01)


@pytest.mark.slow
def test_warm_up_is_followed_from_rest_to_rest(random):
    """A degree a second in ten minutes, three seconds of rest a minute."""
    errors, slope = [], DEGREE / 600.0
    for _ in range(3):
        spells = [(57, True), (3, False)] * 10 + [(1, True)]
        spells[:1] = [(3, False), (54, True)]
        rates, accelerations = moving_and_resting(
            random, spells, lambda time: (slope * time)[:, None]
        )
        results = run(Filter(), rates, accelerations)
        after = 6000 * np.arange(1, 11) + 50
        errors.append(results['bias'][after] - (slope * after / 100.0)[:, None])
    assert np.sqrt(np.mean(np.square(errors))) < 0.03 * DEGREE
    assert np.abs(errors).max() < 0.1 * DEGREE


@pytest.mark.slow
def test_warm_up_is_followed_standing(random):
    """It was a steady bias for long."""
    steady, moving = zip(*(warm_up_standing(random, 100.0) for _ in range(3)), strict=True)
    assert np.sqrt(np.mean(np.square(steady))) < 0.008
    assert np.sqrt(np.mean(np.square(moving))) < 0.06
    assert np.abs(moving).max() < 0.15


def test_slow_noise_of_a_quiet_sensor_is_no_bias(random):
    """A tenth of the noise, and a slow part as large as that of a segment."""
    errors = []
    for _ in range(5):
        rates, accelerations = at_rest(random, 60)
        rates *= 0.1
        drift = autoregressive(random, len(rates), np.exp(-0.01 / 3.0), 1.0)
        rates += 0.006 * DEGREE * drift / drift.std()
        errors.append(run(Filter(), rates, accelerations)['bias'][3000:])
    assert np.sqrt(np.mean(np.square(errors))) < 0.0038 * DEGREE


@pytest.mark.slow
@pytest.mark.parametrize('slow', [0.0, 2.0, 3.0])
def test_slow_noise_is_seen_from_segment_to_segment(slow, random):
    """It is as large as so many times the white noise of a segment."""
    seconds, blocks, segment = 600, 12, 192
    rates, accelerations = at_rest(random, seconds)
    drift = autoregressive(random, len(rates), np.exp(-0.01 / 3.0), 1.0)
    scale = NOISE * np.sqrt((1 + PHI) / (1 - PHI) / segment)
    rates += slow * scale * drift / drift.std()
    filter_ = Filter()
    run(filter_, rates, accelerations)
    ratio = filter_.state['bias']['rest']['variance_ratio']

    def allan_variance(length):
        means = rates[: len(rates) // length * length].reshape(-1, length, 3).mean(axis=1)
        return 0.5 * np.square(np.diff(means, axis=0)).mean(axis=0)

    expected = np.mean(allan_variance(segment) / allan_variance(blocks)) * segment / blocks
    assert ratio == pytest.approx(max(expected, 1.0), rel=0.35)
    assert (ratio > 1.5) == (slow > 0.0)


def set_segment(state, means, noises):
    """Make a segment of 16 blocks of a BIAS."""
    rest = state['rest']
    rest['blocks'], rest['variance_ratio'] = 16, 1.0
    for axis in range(3):
        rest['signals'][axis]['segment']['first'] = means[axis]
        rest['signals'][axis]['scatter'] = 16 * noises[axis]


def test_what_is_taken_back_leaves_no_trace():
    state = np.zeros(1, BIAS_RECORD)[0]
    bias_at_rest.start_bias(state, np.zeros(3), np.full(3, 1e-6), True, np.nan)
    known = 'bias', 'variance'
    before = []
    for step in (0.0, 2e-3, 4e-3):
        set_segment(state, np.full(3, step), np.full(3, 1e-7))
        state['process_noise'], state['largest_process_noise'] = 1e-6, 3e-6
        before.append({name: np.copy(state[name]) for name in known})
        note_segment(state)
        bias_at_rest._learn(state)
        assert (state['variance'] != before[-1]['variance']).all()
    note_segment(state)
    take_back(state, 3)  # the one that has been noted, and two that were learned
    for name in known:
        assert (state[name] == before[1][name]).all()
        # Nor in what the segments say of the time before them: they may be taken back with others.
        assert (state['recent'][:3][name] == before[1][name]).all()
    assert state['process_noise'] == pytest.approx(2e-6)
    assert state['largest_process_noise'] == pytest.approx(6e-6)


def test_a_change_of_temperature_widens_the_bias(random):
    filter_ = Filter()
    run(filter_, *at_rest(random, 30))

    filter_.note_temperature(25.0)
    before = filter_.bias_deviation
    filter_.note_temperature(26.0)
    filter_.note_temperature(float('nan'))
    assert (filter_.bias_deviation == before).all()
    filter_.note_temperature(35.0)
    np.testing.assert_allclose(filter_.bias_deviation**2, before**2 + (10 * 5e-4) ** 2)


@pytest.mark.parametrize('step', [0.5, 1.0, 2.5, 30.0])
def test_a_change_of_temperature_counts_as_a_whole_however_many_messages_tell_it(step, random):
    """The squares of its steps were added, as if they were independent: 2.5 K apart a third."""
    filter_ = Filter()
    filter_.note_temperature(20.0)
    run(filter_, *at_rest(random, 30))
    before = filter_.bias_deviation
    for kelvin in np.arange(step, 30.0 + step / 2.0, step):
        filter_.note_temperature(20.0 + kelvin)
    np.testing.assert_allclose(filter_.bias_deviation**2, before**2 + (30 * 5e-4) ** 2)
    # On the way back it counts anew: motion may have shown the bias meanwhile.
    there = filter_.bias_deviation
    filter_.note_temperature(20.0)
    np.testing.assert_allclose(filter_.bias_deviation**2, there**2 + (30 * 5e-4) ** 2)
    # What a rest has shown is the bias at its temperature.
    run(filter_, *at_rest(random, 30), start=START + 30 * 10**9)
    before = filter_.bias_deviation
    filter_.note_temperature(21.0)
    np.testing.assert_allclose(filter_.bias_deviation, before)
    filter_.note_temperature(10.0)
    np.testing.assert_allclose(filter_.bias_deviation**2, before**2 + (10 * 5e-4) ** 2)


def test_a_sensor_that_warms_up_as_it_stands_is_followed_by_its_temperature(random):
    """At 0.25 deg/s per minute at first: a rest that forgot each kelvin was off by 0.17 deg/s."""
    seconds = 300
    rates, accelerations = at_rest(random, seconds)
    temperature = 20.0 + 30.0 * (1.0 - np.exp(-np.maximum(np.arange(seconds) - 60, 0) / 60.0))
    truth = 5e-4 * (np.repeat(temperature, 100) - 20.0)
    filter_, errors = Filter(), []
    for second in range(seconds):
        filter_.note_temperature(temperature[second])
        part = slice(100 * second, 100 * second + 100)
        start = START + second * 10**9
        results = run(filter_, rates[part] + truth[part, None], accelerations[part], start=start)
        errors.append(results['bias'] - truth[part, None])
    assert np.abs(errors[60:]).max() < 0.12 * DEGREE


def test_a_temperature_beyond_all_leaves_the_bias_finite(random):
    filter_ = Filter()
    run(filter_, *at_rest(random, 30))
    for temperature in (1e200, -1e300, 20.0):
        filter_.note_temperature(temperature)
    assert (filter_.bias_deviation < 2.0).all()
    results = run(filter_, *at_rest(random, 10), start=START + 30 * 10**9)
    assert np.abs(results['bias']).max() < 0.1 * DEGREE
    assert np.isfinite(results['angular_velocity']).all()
    assert (filter_.bias_deviation < 0.1 * DEGREE).all()


def test_a_known_bias_is_taken_off_the_first_sample(random):
    truth = np.array([2.0, -1.0, 0.5]) * DEGREE
    guessed = Filter(Parameters(bias_initial=tuple(truth + 0.1)))
    known = Filter()
    known.set_bias(truth, (0.002,) * 3)
    data = at_rest(random, 20, truth)
    np.testing.assert_allclose(
        run(guessed, *data)['bias'][[0, -1]], [truth + 0.1, truth], atol=1e-3
    )
    np.testing.assert_allclose(run(known, *data)['bias'][[0, -1]], [truth, truth], atol=1e-3)


@pytest.mark.parametrize('moved', [1.0, 2.0, 5.0])
def test_a_remembered_bias_that_is_another_one_now(moved, random):
    """About the vertical, so that gravity does not tell it from a turn."""
    remembered = np.array([0.2, -0.1, 0.3]) * DEGREE
    truth = remembered + np.array([0.0, 0.0, moved]) * DEGREE
    filter_ = Filter()
    filter_.set_bias(remembered, (0.0087,) * 3)
    results = run(filter_, *at_rest(random, 10, truth))
    np.testing.assert_allclose(results['bias'][400], truth, atol=0.05 * DEGREE)


def test_calibrate(random):
    truth = np.array([0.0, 0.0, -1.0]) * DEGREE
    filter_ = Filter()
    with pytest.raises(GyroDriftFilterError, match='no rate has come yet'):
        filter_.calibrate()
    run(filter_, *at_rest(random, 2))
    with pytest.raises(GyroDriftFilterError, match='leave it alone for 5 s and try again'):
        filter_.calibrate()
    run(filter_, *at_rest(random, 10), start=START + 2 * 10**9)
    run(filter_, *at_rest(random, 20, truth), start=START + 10 * 10**9)
    assert np.abs(filter_.state['bias']['bias']).max() < 0.1 * DEGREE  # a turn, for all it knows
    filter_.calibrate()
    np.testing.assert_allclose(filter_.state['bias']['bias'], truth, atol=0.05 * DEGREE)
    in_motion = filter_.state['bias']['motion']['state_vector'][BIAS : BIAS + 3]
    np.testing.assert_allclose(in_motion, truth, atol=0.05 * DEGREE)
    rates, accelerations = moving_and_resting(random, [(5, True)], lambda time: 0.0)
    run(filter_, rates, accelerations, start=START + 30 * 10**9)
    with pytest.raises(GyroDriftFilterError, match='the sensor moves or has only just stopped'):
        filter_.calibrate()
    run(filter_, *at_rest(random, 20, (0, 0, 0.3)), start=START + 35 * 10**9)
    with pytest.raises(
        GyroDriftFilterError, match=r'17\.\d\d deg/s, are beyond bias.max, 10 deg/s'
    ):
        filter_.calibrate()


@pytest.mark.parametrize('how', ['reset', 'gap'])
def test_calibrate_in_motion_after_a_reset_or_a_gap(how, random):
    """The rest before is no rest under way."""
    filter_, now = Filter(), START
    run(filter_, *at_rest(random, 30))
    if how == 'reset':
        filter_.reset()
        now += 30 * 10**9
    else:
        now += 600 * 10**9
    rates, accelerations = moving_and_resting(random, [(10, True)], lambda time: 0.0)
    run(filter_, rates, accelerations, start=now)
    with pytest.raises(GyroDriftFilterError, match='the sensor moves or has only just stopped'):
        filter_.calibrate()


def test_a_calibration_is_not_taken_back(random):
    """The segments before it tell of another bias: the user knows better."""
    rates, accelerations = at_rest(random, 95)
    seconds = np.arange(len(rates)) / 100.0
    rates[:, 0] += 1.5e-4 * np.clip(seconds - 60.0, 0.0, 30.0)
    filter_ = Filter()
    run(filter_, rates[:9000], accelerations[:9000])
    state = filter_.state['bias']
    before = float(state['bias'][0])
    filter_.calibrate()
    calibrated = float(state['bias'][0])
    assert abs(calibrated - before) > 0.1 * DEGREE
    run(filter_, rates[9000:], accelerations[9000:], start=START + 90 * 10**9)
    assert abs(float(state['bias'][0]) - calibrated) < 0.05 * DEGREE


@pytest.mark.slow
@pytest.mark.parametrize('name', ['static_adis16405', 'static_mpu6050_bursty'])
def test_the_mean_of_a_real_sensor_goes(name, real):
    stamps, rates, accelerations = real(name)
    out = Filter().run(stamps, rates, accelerations)['angular_velocity'][3000:]
    left, raw = out.mean(axis=0), rates[3000:].mean(axis=0)
    assert np.sqrt((left**2).mean()) < 0.01 * np.sqrt((raw**2).mean())


def test_calibrate_without_stamps(random):
    filter_ = Filter(Parameters(sample_rate=100.0))
    rates, accelerations = at_rest(random, 20, (0.0, 0.0, 1.0 * DEGREE))
    filter_.run(np.zeros(len(rates), np.int64), rates, accelerations)
    filter_.calibrate()
    np.testing.assert_allclose(filter_.state['bias']['bias'][2], 1.0 * DEGREE, atol=0.05 * DEGREE)
