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

"""The bias in motion: beside flights and walks with a known truth, and by its own bookkeeping."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.in_motion import (
    MOTION_BLOCK_SECONDS,
    START_DIRECTION,
    _take_value,
    lose_direction,
)
from gyro_drift_filter.core.bias.motion_filter import (
    MOTION_WORKSPACE,
    SPEED_SECONDS,
    expect_mean_velocity,
    normalise_direction,
    predict_covariance,
)
from gyro_drift_filter.core.bias.motion_state import (
    ACCELERATION,
    BIAS,
    DIRECTION,
    MEAN_VELOCITY,
    MOTION_BIAS,
    SCALE,
    SCALE_ERROR,
    SHARED_BIAS,
    SPEED,
    STATES,
    VELOCITY,
    motion_variance,
)
from gyro_drift_filter.core.bias.shared import keep_shared, learn_at_rest, restore_shared
from gyro_drift_filter.core.bias.shift import BiasShift, shift_of, shift_variance
from gyro_drift_filter.core.rest.records import REST, REST_LENGTHS, VALUE_SECONDS
from gyro_drift_filter.core.sample import SampleStatus
from gyro_drift_filter.core.sensor_changes import doubt_sensor
from gyro_drift_filter.rotations import from_vectors, running_products
from gyro_drift_filter.simulation.vehicles import VEHICLES, ride
from support.messages import START, even_stamps
from support.paths import FLIGHTS, recorded
from support.rests import run
from support.sensor import DEGREE, at_rest, by_hand, motion_below, turning_gravity

# The states of the motion, and the three biases at rest.
ALL = STATES + 3


def motion_variances(motion):
    """Return the variances (3,) of the bias in motion, with what is not tracked of them."""
    return np.array([motion_variance(motion, axis) for axis in range(3)])


def flown(random, seconds, bias, shift, rest=10.0, rate=100.0, noise=0.005):
    """Return rates and accelerations of a body that tilts to and fro after a rest.

    In flight the bias is another one by `shift` (3,) in rad/s.
    """
    time = np.arange(round(seconds * rate)) / rate
    flies = time >= rest
    tilt = [sum(0.15 * np.sin(f * (time - rest) + p) for f, p in terms) for terms in _TILTS]
    angles = np.column_stack([*tilt, 0.3 * (time - rest)])
    angles *= np.clip(time - rest, 0.0, 1.0)[:, None]
    attitude = Rotation.from_euler('xyz', angles)
    true = np.zeros_like(angles)
    true[:-1] = (attitude[:-1].inv() * attitude[1:]).as_rotvec() * rate
    # Speeds of some 0.5 m/s, as of who flies about.
    speed = 0.5 * np.column_stack([np.sin(0.7 * time), np.cos(0.5 * time), np.sin(0.9 * time)])
    speed *= np.clip(time - rest, 0.0, 1.0)[:, None]
    push = np.gradient(speed, 1.0 / rate, axis=0)
    force = attitude.inv().apply(push + np.array([0.0, 0.0, 9.81]))
    off = np.asarray(bias) + np.outer(flies, shift)
    rates = true + off + noise * random.standard_normal(true.shape)
    return rates, force + 0.05 * random.standard_normal(force.shape)


_TILTS = ((0.9, 0.3), (2.1, 1.0)), ((1.1, 2.0), (1.7, 0.5))


@pytest.mark.slow
def test_gravity_shows_the_shift_of_the_bias_where_the_body_tilts(random):
    """The noise at rest is strong enough that the bias may move by so much."""
    bias, shift = np.array([0.01, -0.02, 0.005]), np.array([1e-3, -1e-3, 0.0])
    left = {False: [], True: []}
    for _ in range(3):
        rates, accelerations = flown(random, 400, bias, shift)
        rates[:, :2] += 0.01 * random.standard_normal((len(rates), 2))
        for followed, errors in left.items():
            results = run(Filter(Parameters(bias_in_motion=followed)), rates, accelerations)
            errors.append(np.linalg.norm((results['bias'][-1] - bias - shift)[:2]))
    assert np.mean(left[True]) < 0.8 * np.mean(left[False])


@pytest.mark.slow
def test_who_has_stood_for_long_follows_the_bias_in_motion_all_the_same(random):
    """It stands in its dock for half an hour, and warms up as it is carried about.

    The longer it had stood, the less the bias was expected to move: gravity showed nothing of it,
    and the accelerometer was said to contradict the gyroscope.
    """
    stood, carried, rate = 1800.0, 600.0, 100.0
    motion = motion_below(2.0, random, round(carried * rate), rate)
    motion *= 1.2 / motion.std() * np.minimum(1.0, np.arange(len(motion)) / rate)[:, None]
    rates = np.vstack([np.zeros((round(stood * rate), 3)), motion])
    force = turning_gravity(rates, rate) + 0.02 * random.standard_normal(rates.shape)
    warmth = 1.0 - np.exp(-np.clip(np.arange(len(rates)) / rate - stood, 0.0, None) / 300.0)
    bias = 0.3 * DEGREE * np.outer(warmth, [1.0, 0.7, -1.0])
    filter_ = Filter()
    results = run(filter_, rates + bias + 5e-4 * random.standard_normal(rates.shape), force)
    assert not filter_.state['bias']['contradicts']
    assert np.abs(results['bias'] - bias).max() < 0.15 * DEGREE


@pytest.mark.parametrize(('noise', 'largest'), [(1e-5, 3e-6), (1e-4, 1e-4)])
def test_what_speeds_up_and_brakes_moves_no_bias_of_a_good_sensor(noise, largest, random):
    """It drives at one to two m/s for ten minutes, and such a gyroscope does not walk so far."""
    rates, accelerations = at_rest(random, 610.0)
    time = np.arange(len(rates)) / 100.0
    drives = np.clip(time - 10.0, 0.0, 1.0)
    rates = noise * random.standard_normal(rates.shape)
    rates[:, 2] += 0.4 * np.sin(0.5 * time) * drives
    speed = (1.5 + 0.5 * np.sin(2.0 * np.pi * time / 20.0)) * drives
    accelerations[:, 0] += np.gradient(speed, 0.01)
    accelerations[:, 1] += speed * rates[:, 2]
    accelerations += drives[:, None] * 0.2 * random.standard_normal(accelerations.shape)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias']).max() < largest


@pytest.mark.parametrize('speed', [1.0, 3.0])
def test_a_robot_that_drives_forward_keeps_its_tilt(speed, random):
    """In its turns it is pressed outwards, which is no tilt: it has a mean velocity."""
    tilts = {}
    rates, accelerations = at_rest(random, 310.0)
    time = np.arange(len(rates)) / 100.0
    drives = np.clip(time - 10.0, 0.0, 1.0)
    turn = 0.4 * np.sin(0.5 * time) * drives
    forward = speed * (1.0 + 0.5 * np.sin(2.0 * np.pi * time / 9.0)) * drives
    rates = 1e-3 * random.standard_normal(rates.shape)
    rates[:, 2] += turn
    accelerations[:, 0] += np.gradient(forward, 0.01)
    accelerations[:, 1] += forward * turn
    for followed in (False, True):
        parameters = Parameters(bias_in_motion=followed)
        turned = run(Filter(parameters), rates, accelerations)['angular_velocity']
        tilts[followed] = _tilt(turned, 100.0)
    assert tilts[True] < tilts[False] < 0.8 * DEGREE


@pytest.mark.parametrize('at_rest_too', [False, True])
def test_what_is_no_gravity_at_rest_tilts_nothing(at_rest_too, random):
    """A push that ends the rest at any place in a block, and wrong values at rest."""
    directions = []
    for start in range(1000, 1013):
        rates, accelerations = at_rest(random, start / 100.0 + 0.01)
        accelerations[start:, 0] += 3.0
        if at_rest_too:
            accelerations[600::30, 1] = 490.0
        accelerations = np.concatenate([accelerations, np.tile(accelerations[-1:], (20, 1))])
        rates = np.concatenate([rates, at_rest(random, 0.2)[0]])
        filter_ = Filter()
        run(filter_, rates, accelerations + 0.02 * random.standard_normal(accelerations.shape))
        directions.append(filter_.state['bias']['motion']['state_vector'][:2].copy())
    assert np.abs(directions).max() < 0.003


def _tilt(rates, rate):
    """Return the largest tilt in rad of what turns at rates (n, 3) in rad/s."""
    attitudes = Rotation.from_quat(running_products(from_vectors(rates / rate)))
    return np.arccos(attitudes.as_matrix()[:, 2, 2]).max()


def test_a_landing_brings_the_bias_at_rest_back(random):
    bias, shift = np.array([0.01, -0.02, 0.005]), np.array([8e-4, -8e-4, 0.0])
    rates, accelerations = flown(random, 190, bias, shift)
    still_rates, still_accelerations = at_rest(random, 20, bias)
    filter_ = Filter()
    run(filter_, rates, accelerations)
    in_flight = filter_.state['bias']['motion']['state_vector'][BIAS : BIAS + 3].copy()
    results = run(filter_, still_rates, still_accelerations, start=10**18 + 190 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], bias, atol=5e-4)
    after = filter_.state['bias']['motion']['state_vector'][BIAS : BIAS + 3]
    np.testing.assert_allclose(after - results['bias'][-1], in_flight - bias, atol=5e-4)


@pytest.mark.slow
def test_the_deviation_of_the_bias_is_honest_in_flight(random):
    shares = []
    for _ in range(10):
        bias = 0.02 * random.standard_normal(3)
        shift = 3e-4 * random.standard_normal(3)
        rates, accelerations = flown(random, 90, bias, shift)
        results = run(Filter(), rates, accelerations)
        error = results['bias'] - bias - shift
        deviation = np.sqrt(results['angular_velocity_variance'])
        shares.append((np.abs(error) < 2.0 * deviation)[1500:].mean())
    assert np.mean(shares) > 0.85


def test_without_an_accelerometer_it_is_the_bias_at_rest(random):
    """But for what it keeps of the provisional one before the first rest."""
    rates, accelerations = flown(random, 60, (0.01, -0.02, 0.005), (0.0, 0.0, 0.0))
    for silent in (0.0 * accelerations, np.full_like(accelerations, np.nan)):
        a, b = (
            run(Filter(Parameters(bias_in_motion=followed)), rates, silent)
            for followed in (False, True)
        )
        np.testing.assert_allclose(a['bias'], b['bias'], atol=1e-4)


@pytest.mark.parametrize('size', [1e160, 1e300, 3e4])
def test_an_acceleration_beyond_all_sensors_is_none(size, random):
    """In flight, for one sample: a velocity of 1e160 m/s ended as a rate that was no number."""
    rates, accelerations = flown(random, 30, np.zeros(3), np.zeros(3))
    accelerations[2000] = size
    results = run(Filter(), rates, accelerations)
    assert np.isfinite(results['angular_velocity']).all()
    assert np.isfinite(results['angular_velocity_covariance']).all()
    assert np.abs(results['bias']).max() < 0.01


def test_the_covariance_stays_one(random):
    """Through starts, rests, gaps, spikes and turns that are taken back."""
    filter_, start = Filter(), 10**18
    for part in range(12):
        rates, accelerations = flown(random, 20, (0.01, 0.0, 0.0), (0.0, 1e-3, 0.0), 8.0)
        rates[900 + 50 * part] += 5.0
        rates[: 60 * part] += 0.5 * DEGREE
        run(filter_, rates, accelerations, start=start)
        start += 20 * 10**9 + part * 10**8
        motion = filter_.state['bias']['motion']
        assert np.linalg.eigvalsh(motion['covariance']).min() > -1e-12
        assert np.linalg.norm(motion['state_vector'][DIRECTION : DIRECTION + 3]) == pytest.approx(
            1, abs=0.1
        )
        assert np.abs(motion['state_vector'][ACCELERATION:]).max() < 1.0
        for axis in range(3):
            common = motion['bias_at_rest']['cross_covariance'][axis]
            variances = (
                motion['covariance'][BIAS + axis, BIAS + axis],
                motion['bias_at_rest']['variance'][axis],
            )
            assert common**2 <= variances[0] * variances[1] * 1.0001
            assert common <= variances[1] * 1.0001  # what the biases share is in both of them
            assert motion['bias_at_rest']['untracked_variance'][axis] >= 0.0


@pytest.mark.slow
def test_what_is_left_out_of_a_long_flight_is_in_the_published_variance(random):
    """A gap of 3 s starts the motion anew, with less than its variance tracked from there on."""
    filter_ = Filter()
    before = run(filter_, *flown(random, 600, (0.01, 0.0, 0.0), (0.0, 1e-3, 0.0), 8.0))
    motion = filter_.state['bias']['motion']
    total = motion_variances(motion)
    rates, accelerations = flown(random, 1, (0.01, 0.0, 0.0), (0.0, 1e-3, 0.0), 0.0)
    run(filter_, rates, accelerations, start=10**18 + 603 * 10**9)
    assert (motion['bias_at_rest']['untracked_variance'] > 0.5 * total).all()
    assert (motion_variances(motion) > 0.95 * total).all()
    assert before['at_rest'][-50000:].sum() == 0


@pytest.mark.parametrize('doubt', ['warmer', 'alive'])
def test_the_covariance_stays_one_where_the_bias_becomes_uncertain_in_motion(doubt):
    """What is left out of a variance has to be left out of its covariances, too."""
    for seed in range(6):
        random = np.random.default_rng([seed, 77])
        rates, accelerations = at_rest(random, 72)
        moving = by_hand(random, 60)
        if doubt == 'alive':
            rates *= 0.07
        rates[1000:7000] += 0.6 * moving[0]
        accelerations[1000:7000] += moving[1] / 2.0
        if doubt == 'alive':
            # At rest some axes never change, as a count is ten times the noise.
            count = DEGREE / 4.0
            rates = np.round(rates / count + random.uniform(-3.0, 3.0, 3)) * count
        filter_ = Filter()
        for second in range(72):
            if doubt == 'warmer':
                filter_.note_temperature(20.0 + min(max(2.5 * (second - 10), 0.0), 30.0))
            part = slice(100 * second, 100 * second + 100)
            start = START + 10**9 * second
            results = run(filter_, rates[part], accelerations[part], start=start)
            assert (results['angular_velocity_variance'] > 0.0).all()
            eigenvalues = np.linalg.eigvalsh(filter_.state['bias']['motion']['covariance'])
            assert eigenvalues.min() > -1e-9 * eigenvalues.max()


def swing(plateau):
    """Return rates and accelerations of a body that swings about the vertical at up to 3.3 rad/s.

    One swing stops at some 3 rad/s for so many samples, as if that were the end of the range.
    """
    time = np.arange(1000) / 100.0
    rates = np.zeros((len(time), 3))
    rates[:, 2] = np.round(3.3 * np.sin(2.0 * np.pi * time), 3)
    rates[::2, :2] = 0.001  # the other axes live
    begin = 800 + int(np.argmax(rates[800:, 2] >= 3.0))
    rates[begin : begin + plateau, 2] = rates[begin, 2]
    return rates[: begin + plateau + 1], np.tile([0.0, 0.0, 9.81], (begin + plateau + 1, 1))


def test_a_rate_that_comes_twice_leaves_the_direction_of_gravity():
    """By chance it does, and looks like the end of the range: what may be missed is an angle."""
    before, after = (Filter() for _ in range(2))
    rates, accelerations = swing(2)
    run(before, rates[:-1], accelerations[:-1])
    run(after, rates, accelerations)
    motion = after.state['bias']['motion']
    assert motion['directed']
    added = np.diag(motion['covariance'] - before.state['bias']['motion']['covariance'])[:3]
    np.testing.assert_allclose(added, 0.03**2, rtol=0.1)
    assert motion['unmeasured_turn'] == 0.0


def test_after_a_long_stay_at_the_end_of_the_range_the_direction_of_gravity_is_taken_anew():
    filter_ = Filter()
    rates, accelerations = swing(12)
    run(filter_, rates, accelerations)
    variance = np.diag(filter_.state['bias']['motion']['covariance'])[:3]
    # What was missed after that is less than what takes the direction anew.
    assert np.all((variance > 0.99 * START_DIRECTION**2) & (variance < 2.0 * START_DIRECTION**2))


def test_a_shift_of_the_last_run_stays_as_certain_at_the_first_rest(random):
    """Its noise was that of the last run: this one's is no reason to doubt it."""
    bias, shift = np.array([0.01, -0.02, 0.005]), (2e-4, -3e-4, 1e-4)
    filter_ = Filter()
    filter_.set_bias(bias, (1e-3, 1e-3, 1e-3), BiasShift(shift, (2e-5, 2e-5, 2e-5)))
    assert run(filter_, *at_rest(random, 10.0, bias))['at_rest'][-1]
    np.testing.assert_allclose(filter_.bias_shift.deviation, 2e-5, rtol=0.01)
    np.testing.assert_allclose(filter_.bias_shift.shift, shift, rtol=0.01)


def test_a_shift_of_the_last_run_is_taken_up(random):
    bias, shift = np.array([0.01, -0.02, 0.005]), (4e-4, -2e-4, 0.0)
    filter_ = Filter()
    filter_.set_bias(bias, (1e-4,) * 3, BiasShift(shift, (1e-4,) * 3))
    rates, accelerations = flown(random, 1, bias, shift, 0.0)
    results = run(filter_, rates, accelerations)
    np.testing.assert_allclose(results['bias'][5], bias + shift, atol=1e-4)


def joint(random):
    """Return a state with random values and covariances, and the same as dense arrays.

    The latter are the states of the motion and, after them, the three biases at rest, which are
    correlated with the others by the bias in motion of their axis alone.
    """
    state = zeroed(MOTION_BIAS)[0]
    root = random.standard_normal((STATES, STATES))
    state['state_vector'] = random.standard_normal(STATES)
    state['covariance'] = root @ root.T
    bias_at_rest = state['bias_at_rest']
    bias_at_rest['bias'] = random.standard_normal(3)
    own = np.diag(state['covariance'])[BIAS : BIAS + 3]
    bias_at_rest['cross_covariance'] = 0.5 * own
    bias_at_rest['variance'] = 0.7 * own
    values = np.concatenate([state['state_vector'], bias_at_rest['bias']])
    covariance = np.zeros((ALL, ALL))
    covariance[:STATES, :STATES] = state['covariance']
    covariance[STATES:, STATES:] = 0.25 * state['covariance'][BIAS : BIAS + 3, BIAS : BIAS + 3]
    covariance[STATES:, :STATES] = 0.5 * state['covariance'][BIAS : BIAS + 3]
    covariance[:STATES, STATES:] = covariance[STATES:, :STATES].T
    covariance[range(STATES, ALL), range(STATES, ALL)] = bias_at_rest['variance']
    return state, values, covariance


def measure(values, covariance, row, measured, noise):
    """Return values and covariance (n, n) after a measurement row @ values of a Kalman filter."""
    gain = covariance @ row / (row @ covariance @ row + noise)
    values = values + gain * (measured - row @ values)
    return values, covariance - np.outer(gain, row @ covariance)


def check(state, values, covariance):
    bias_at_rest = state['bias_at_rest']
    np.testing.assert_allclose(state['state_vector'], values[:STATES], atol=1e-12)
    np.testing.assert_allclose(state['covariance'], covariance[:STATES, :STATES], atol=1e-12)
    np.testing.assert_allclose(bias_at_rest['bias'], values[STATES:], atol=1e-12)
    for axis in range(3):
        own, bias = STATES + axis, BIAS + axis
        assert bias_at_rest['variance'][axis] == pytest.approx(covariance[own, own])
        assert bias_at_rest['cross_covariance'][axis] == pytest.approx(covariance[own, bias])
        difference = np.zeros(ALL)
        difference[bias], difference[own] = 1.0, -1.0
        assert shift_of(state, axis) == pytest.approx(difference @ values)
        assert shift_variance(state, axis) == pytest.approx(difference @ covariance @ difference)


def test_motion_and_rest_are_one_kalman_filter(random):
    """Beside a dense one of all states: the velocity is the mean one within its deviation."""
    state, values, covariance = joint(random)
    state['wide'], state['block_seconds'] = True, MOTION_BLOCK_SECONDS
    state['moving_seconds'] = 60.0
    expect_mean_velocity(state, zeroed(MOTION_WORKSPACE)[0])
    noise = SPEED * SPEED * 2.0 * SPEED_SECONDS / MOTION_BLOCK_SECONDS
    for axis in range(3):
        row = np.zeros(ALL)
        row[VELOCITY + axis], row[MEAN_VELOCITY + axis] = 1.0, -1.0
        values, covariance = measure(values, covariance, row, 0.0, noise)
    check(state, values, covariance)


@pytest.mark.parametrize('seed', [2, 3, 4])
def test_a_coarse_gyroscope_in_slow_motion_is_no_bus_that_hangs(seed):
    """It gives the same rates for most of the time, and gravity shows its bias all the same."""
    random = np.random.default_rng(seed)
    seconds = np.arange(18_000) / 100.0
    moving = np.clip(seconds - 8.0, 0.0, 1.0)[:, None]
    rates = 0.05 * moving * motion_below(0.2, random, len(seconds), 100.0)
    rates *= 0.05 / rates[1000:].std()
    accelerations = turning_gravity(rates, 100.0) + 0.03 * random.standard_normal(rates.shape)
    bias = np.outer(1.0 - np.exp(-np.maximum(seconds - 8.0, 0.0) / 60.0), (6e-3, -6e-3, 0.0))
    count = 0.25 * DEGREE
    given = count * np.round((rates + bias + 0.5e-3 * random.standard_normal(rates.shape)) / count)
    assert (np.diff(given, axis=0) == 0.0).all(axis=1).mean() > 0.5
    error = run(Filter(), given, accelerations)['bias'] - bias
    assert np.sqrt(np.mean(error[1000:, :2] ** 2)) < 2.3e-3  # 2.8 to 3.4e-3 if the bus hangs


def test_below_20_hz_no_bias_is_followed_in_motion(random):
    """From one sample to the next the body turns by nobody knows what."""
    rates, accelerations = at_rest(random, 60)
    turn, push = by_hand(random, 50)
    rates[1000:] += turn
    accelerations[1000:] += push
    stamps = even_stamps(len(rates))
    for every, is_followed in ((10, False), (4, True)):
        filter_ = Filter()
        filter_.run(stamps[::every], rates[::every], accelerations[::every])
        assert (filter_.state['bias']['motion']['moving_seconds'] > 0.0) == is_followed


def test_the_length_of_the_direction_moves_nothing_else(random):
    """Beside a dense projection: nothing is uncertain along a direction of length one."""
    state, values, covariance = joint(random)
    own = slice(DIRECTION, DIRECTION + 3)
    state['state_vector'][own] = direction = 1.2 * np.array([0.6, 0.0, 0.8])
    normalise_direction(state, zeroed(MOTION_WORKSPACE)[0])
    np.testing.assert_allclose(state['state_vector'][own], direction / 1.2, rtol=1e-15)
    np.testing.assert_array_equal(state['state_vector'][3:], values[3:STATES])
    projection = np.eye(STATES)
    projection[own, own] -= np.outer(direction, direction) / 1.2**2
    expected = projection @ covariance[:STATES, :STATES] @ projection
    np.testing.assert_allclose(state['covariance'], expected, atol=1e-12)
    np.testing.assert_array_equal(state['covariance'], state['covariance'].T)


@pytest.mark.parametrize(
    ('vehicle', 'seed', 'begin', 'count'), [('legged', 6, 3000, 500), ('hand', 0, 260, 60)]
)
def test_garbage_leaves_the_bias_in_motion_as_it_is(vehicle, seed, begin, count):
    """From a serial link that has slipped.

    The direction became four times as long, by which the bias was moved by 47e-3 rad/s for good.
    """
    of = ride(VEHICLES[vehicle], seed, 100.0, warm_up=0.0)
    random = np.random.default_rng(seed)
    rates, accelerations = of.rates[::2].copy(), of.accelerations[::2].copy()
    garbage = slice(begin, begin + count)
    rates[garbage] = random.uniform(-35.0, 35.0, (count, 3))
    accelerations[garbage] = random.uniform(-40.0, 40.0, (count, 3))
    results = Filter().run(of.stamps[::2], rates, accelerations)
    errors = np.abs(results['bias'] - of.bias[::2])
    assert errors[begin + count + 500 :].max() < 1e-3


def moved(vector, rate, force):
    """Return the record of a motion that starts at a state vector, nearly one block later."""
    state, workspace = zeroed(MOTION_BIAS)[0], zeroed(MOTION_WORKSPACE)[0]
    rest, lengths = zeroed(REST)[0], zeroed(REST_LENGTHS)[0]
    lengths['value'] = 1
    state['state_vector'] = vector
    state['directed'] = state['moving'] = True
    state['speed_deviation'] = 1.5
    state['turn'] = np.eye(3)
    for _ in range(int(MOTION_BLOCK_SECONDS / VALUE_SECONDS) - 1):
        state['samples'], state['seconds'] = 1, VALUE_SECONDS
        state['angle'], state['speed'] = rate * VALUE_SECONDS, force * VALUE_SECONDS
        _take_value(state, workspace, rest, lengths)
    predict_covariance(state, workspace, rest, lengths)
    return state, workspace


_SCALE = 0.01, -0.02, 0.015, -0.01, 0.02, 0.005, -0.015, 0.01, 0.02


@pytest.mark.slow
def test_the_transition_is_the_derivative_of_the_motion():
    """By differences; that a velocity turns and decays while it grows is left out."""
    rate, force = np.array([0.4, -0.3, 0.8]), np.array([0.5, -0.4, 9.7])
    vector = np.array([0.05, -0.03, 0.998, 1.0, -0.5, 0.2, *(6 * [0.01]), 0.8, -0.2, 0.1, *_SCALE])
    transition = moved(vector, rate, force)[1]['transition'].copy()
    for i in range(STATES):
        step = np.zeros(STATES)
        step[i] = 1e-4
        higher, lower = (
            moved(vector + sign * step, rate, force)[0]['state_vector'].copy() for sign in (1, -1)
        )
        derivative = (higher - lower) / 2e-4
        tolerance = 0.1 * max(1.0, np.abs(derivative).max())
        np.testing.assert_allclose(transition[:, i], derivative, atol=tolerance)


def test_a_rest_measures_both_biases(random):
    for axis in range(3):
        state, values, covariance = joint(random)
        # Each axis of the biases is by itself at rest.
        own = [BIAS + axis, STATES + axis]
        alone = covariance[np.ix_(own, own)]
        learn_at_rest(state, axis, 0.4, 0.3)
        values[own], alone = measure(values[own], alone, np.array([0.0, 1.0]), 0.4, 0.3)
        covariance[BIAS + axis] = covariance[:, BIAS + axis] = 0.0
        covariance[STATES + axis] = covariance[:, STATES + axis] = 0.0
        covariance[np.ix_(own, own)] = alone
        check(state, values, covariance)


def test_what_is_taken_back_in_motion_leaves_a_covariance(random):
    """Rests that were a turn were told before the body moved, and by now all goes together."""
    state, _, _ = joint(random)
    calm, kept = zeroed(MOTION_BIAS)[0], zeroed(SHARED_BIAS)[0]
    for axis in range(3):
        calm['covariance'][BIAS + axis, BIAS + axis] = 1e-3
    keep_shared(calm, kept, 0.0)
    restore_shared(state, kept, 0.0)
    assert np.linalg.eigvalsh(state['covariance']).min() > 0.0


def test_a_rest_undoes_what_misled_in_motion(random):
    """As a speed that lasts: gravity seems to have been elsewhere. The bias has not moved."""
    bias = np.array([0.01, -0.02, 0.005])
    flight = flown(random, 60, bias, np.zeros(3), noise=2e-3)
    time = np.arange(len(flight[0])) / 100.0
    flight[1][:, 0] += np.where((time > 12.0) & (time < 55.0), 0.5, 0.0)
    filter_ = Filter()
    in_motion = run(filter_, *flight)['bias'][-1]
    assert np.abs(in_motion - bias).max() > 2e-4
    rates, accelerations = flown(random, 60, bias, np.zeros(3), rest=60.0, noise=2e-3)
    run(filter_, rates, accelerations, start=START + 60 * 10**9)
    after = filter_.state['bias']['motion']['state_vector'][BIAS : BIAS + 3]
    np.testing.assert_allclose(after, bias, atol=6e-5)


def rolled(random, scale, rate=0.5):
    """Return rates and accelerations of a body that rolls one way, between two rests of 10 s.

    `scale` (3, 3) are the errors of the gyroscope's scale and alignment.
    """
    time = np.arange(10_000) / 100.0
    turning = np.clip(time - 10.0, 0.0, 1.0) * np.clip(90.0 - time, 0.0, 1.0)
    angle = np.cumsum(rate * turning) / 100.0
    attitude = Rotation.from_rotvec(np.outer(angle, [1.0, 0.0, 0.0]))
    rates = np.outer(rate * turning, (np.eye(3) + scale)[:, 0])
    rates += 2e-3 * random.standard_normal(rates.shape)
    force = attitude.inv().apply([0.0, 0.0, 9.81])
    return rates, force + 0.03 * random.standard_normal(force.shape)


@pytest.mark.parametrize('rate', [0.5, 3.0])
def test_errors_of_the_scale_are_not_taken_for_a_bias(rate, random):
    """Gravity shows by how much the rates are off while the body rolls, but not at rest."""
    scale = 0.01 * random.standard_normal((3, 3))
    bias = run(Filter(), *rolled(random, scale, rate))['bias']
    assert np.abs(bias).max() < 5e-4


def test_gravity_shows_errors_of_the_scale(random):
    """That of the axis about which the body rolls; how the others are aligned it shows less."""
    scale = 0.01 * random.standard_normal((3, 3))
    filter_ = Filter()
    run(filter_, *rolled(random, scale))
    motion = filter_.state['bias']['motion']
    first = [SCALE, SCALE + 3, SCALE + 6]
    deviations = np.sqrt(np.diag(motion['covariance']))[first]
    assert deviations[0] < 0.25 * SCALE_ERROR
    assert (np.abs(motion['state_vector'][first] - scale[:, 0]) < 3.0 * deviations).all()


def test_errors_of_the_scale_are_states_from_where_the_bias_is_known(random):
    """Before that each would be taken for the other."""
    filter_ = Filter()
    turn, push = by_hand(random, 20.0)
    rates, accelerations = at_rest(random, 20.0)
    run(filter_, rates + turn, accelerations + push)
    assert not filter_.state['bias']['known']
    assert not filter_.state['bias']['motion']['covariance'][SCALE:].any()
    run(filter_, rates[:500], accelerations[:500], start=START + 20 * 10**9)
    assert filter_.state['bias']['known']
    for motion, variance in (('motion', SCALE_ERROR**2), ('wide_prior', 0.0)):
        own = np.diag(filter_.state['bias'][motion]['covariance'])[SCALE:]
        np.testing.assert_array_equal(own, variance)


def test_another_sensor_has_another_scale(random):
    filter_ = Filter()
    run(filter_, *rolled(random, 0.01 * random.standard_normal((3, 3))))
    doubt_sensor(filter_.record[0])
    motion = filter_.state['bias']['motion']
    assert not motion['state_vector'][SCALE:].any()
    np.testing.assert_array_equal(
        motion['covariance'][SCALE:], SCALE_ERROR**2 * np.eye(STATES)[SCALE:]
    )


@pytest.mark.slow
@pytest.mark.parametrize(('sensor', 'mean', 'worst'), [('euroc', 3.0, 6.0), ('room', 1.30, 1.8)])
def test_the_heading_holds_on_flights_and_walks(sensor, mean, worst):
    """From a cold start; root mean square of the angle to the truth in deg."""
    files = sorted(recorded(FLIGHTS).glob(f'{sensor}_*.npz'))
    assert files
    errors = []
    for file in files:
        data = np.load(file)
        stamps, times = data['t'], data['tq']
        results = Filter().run(stamps, data['rate'].astype(float), data['acc'].astype(float))
        rates = results['angular_velocity']
        first = int(np.searchsorted(stamps, times[0]))
        step = np.minimum(np.diff(stamps[first:]) * 1e-9, 0.1)[:, None]
        turns = from_vectors(0.5 * (rates[first:-1] + rates[first + 1 :]) * step)
        begin = Rotation.from_quat(data['q'][0].astype(float), scalar_first=True).as_quat()
        whole = Rotation.from_quat(running_products(np.vstack([begin, turns])))
        after = np.clip(np.searchsorted(stamps, times), first + 1, len(stamps) - 1)
        at = after - (times - stamps[after - 1] < stamps[after] - times)
        near = np.abs(stamps[at] - times) <= 3_000_000
        truth = Rotation.from_quat(data['q'].astype(float)[near], scalar_first=True)
        turned = whole[at[near] - first] * truth.inv()
        errors.append(np.degrees(np.sqrt(np.mean(turned.magnitude() ** 2))))
    assert np.mean(errors) <= mean
    assert max(errors) <= worst


def moving_filter(random):
    """Return a filter of a body that has begun to move, and the stamp of its last sample."""
    filter_ = Filter()
    rates, accelerations = at_rest(random, 10)
    turn, push = by_hand(random, 10)
    stamps = even_stamps(1500)
    filter_.run(stamps[:1000], rates, accelerations)
    filter_.run(stamps[1000:], rates[:500] + turn[:500], accelerations[:500] + push[:500])
    assert filter_.state['bias']['motion']['directed']
    return filter_, int(stamps[-1])


def test_a_direction_that_is_lost_is_not_found_by_a_sample_without_a_rate(random):
    filter_, stamp = moving_filter(random)
    lose_direction(filter_.state['bias']['motion'])
    filter_.step(stamp + 10_000_000, (np.nan, 0.0, 0.0), (9.81, 0.0, 0.0))
    assert not filter_.state['bias']['motion']['directed']


def test_an_axis_that_has_no_rate_for_a_minute_teaches_nothing(random):
    """Nobody knows how the body turns meanwhile."""
    bias = np.array([0.03, -0.02, 0.01])
    rates, accelerations = flown(random, 120.0, bias, (0.0, 0.0, 0.0))
    rates[4000:10_000, 1] = np.nan
    results = run(Filter(), rates, accelerations)
    assert (results['status'][4500:10_000] == SampleStatus.REFUSED).all()
    before = np.abs(results['bias'][2000:4000] - bias).max()
    after = np.abs(results['bias'][4000:] - bias).max()
    assert after < before + 2e-4


def test_what_turned_while_the_bias_in_motion_was_off_is_not_known(random):
    filter_, _ = moving_filter(random)
    filter_.configure(Parameters(bias_in_motion=False))
    filter_.configure(Parameters())
    assert not filter_.state['bias']['motion']['directed']
