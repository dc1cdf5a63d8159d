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

"""The bias, learned at rest: real motion and rests, slow turns, warm-up, what can't be known."""

from itertools import product

import numpy as np
import pytest
from scipy import signal
from scipy.spatial.transform import Rotation

from benchmark.bias import on_other_sides, to_and_fro, warm_up, warm_up_standing
from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
from gyro_drift_filter.core.bias import at_rest as bias_at_rest
from gyro_drift_filter.core.bias.motion_state import BIAS, DIRECTION
from gyro_drift_filter.core.bias.records import BIAS_RECORD
from gyro_drift_filter.core.bias.segments import note_segment, take_back
from gyro_drift_filter.core.bias.swing import SWING, forget_swing, note_swing, variance_of_swing
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.rest.detection import close_block
from gyro_drift_filter.core.rest.force import note_force
from gyro_drift_filter.core.rest.noise import doubt_noise
from gyro_drift_filter.core.rest.records import (
    HALF,
    REST,
    REST_LENGTHS,
    SEGMENT_BLOCKS,
    SIGNALS,
    Obstacle,
)
from gyro_drift_filter.core.rest.segment import (
    add_waiting_block,
    drop_early_half,
    mean_square_step,
    scatter_of_means,
    segment_mean,
    start_segment,
    value_variance,
)
from gyro_drift_filter.core.rest.spikes import WAITING, let_wait, note_next
from gyro_drift_filter.core.rest.standing import (
    standing_mean,
    standing_scatter,
    variance_of_standing_mean,
)
from gyro_drift_filter.core.rest.stationarity import MEAN_DEVIATIONS
from gyro_drift_filter.core.sample import SAMPLE
from gyro_drift_filter.simulation.experiments import autoregressive
from support.messages import START
from support.sensor import DEGREE, NOISE, PHI, at_rest, by_hand, idling, motion_below, taking_off


def run(filter_, rates, accelerations, rate=100.0, start=START):
    stamps = start + np.round(np.arange(len(rates)) * 1e9 / rate).astype(np.int64)
    return filter_.run(stamps, rates, accelerations)


def moving_and_resting(random, spells, bias):
    """Return rates and accelerations of spells (seconds, whether it moves)."""
    parts = []
    for seconds, moves in spells:
        rates, accelerations = at_rest(random, seconds)
        if moves:
            turn, push = by_hand(random, seconds)
            rates, accelerations = rates + turn, accelerations + push
        parts.append((rates, accelerations))
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    return rates + bias(np.arange(len(rates)) / 100.0), accelerations


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


def test_rests_between_motion_are_found_and_motion_is_none(random):
    spells = [(10, False), (20, True), (6, False), (20, True), (6, False)]
    truth = np.array([0.3, -0.2, 0.5]) * DEGREE
    rates, accelerations = moving_and_resting(random, spells, lambda time: truth)
    results = run(Filter(), rates, accelerations)
    moving = np.repeat([moves for _, moves in spells], [100 * s for s, _ in spells])
    assert results['at_rest'][~moving].mean() > 0.5
    # Rest is known to be over an eighth of a second after its end.
    assert results['at_rest'][moving].mean() < 0.02
    assert np.abs(results['bias'][1000:] - truth).max() < 0.06 * DEGREE


@pytest.mark.parametrize('accelerometer', [True, False])
def test_a_start_in_motion_invents_no_bias(accelerometer, random):
    rates, accelerations = moving_and_resting(random, [(120, True)], lambda time: 0.0)
    results = run(Filter(), rates, accelerations if accelerometer else 0.0 * accelerations)
    # By gravity, where there is an accelerometer, it is known that it is none.
    assert np.abs(results['bias']).max() < (1e-3 if accelerometer else 1e-9)
    assert (results['at_rest'] == 0.0).all()


def swaying(random, n, turn, push):
    """Return rates and accelerations (n, 3) of a hand that holds still, by their deviations."""
    sections = signal.butter(2, (0.5, 3.0), 'bandpass', fs=100.0, output='sos')
    sway = signal.sosfiltfilt(sections, random.standard_normal((n, 6)), axis=0)
    sway /= sway.std()
    return turn * sway[:, :3], push * sway[:, 3:]


@pytest.mark.parametrize('seed', range(8))
def test_a_hand_that_holds_still_is_no_rest(seed):
    """It sways by some degrees a second, without a mean that wanders, as noise does."""
    random = np.random.default_rng(seed)
    rates, accelerations = at_rest(random, 30)
    turn, push = swaying(random, len(rates), 0.03, 0.1)
    results = run(Filter(), 0.3 * rates + turn, accelerations + push)
    assert not results['at_rest'].any()
    assert np.abs(results['bias']).max() < 1e-3


@pytest.mark.parametrize('seed', range(8))
def test_the_first_rest_begins_where_the_hand_has_come_to_rest(seed):
    random = np.random.default_rng(seed)
    rates, accelerations = at_rest(random, 12)
    turn, push = swaying(random, len(rates), 0.1, 0.5)
    left = np.exp(-np.maximum(np.arange(len(rates)) - 200 - 10 * seed, 0) / 20.0)[:, None]
    results = run(Filter(), 0.1 * rates + left * turn, accelerations + left * push)
    first = np.flatnonzero(results['at_rest'])[0]
    assert np.abs(results['bias'][first:]).max() < 1e-3


@pytest.mark.parametrize('hint', [False, True])
@pytest.mark.parametrize('speed', [0.3, 0.5, 1.0, 2.0, 5.0])
def test_a_slow_turn_about_the_vertical_is_no_bias(speed, hint, random):
    """A minute of it after 10 s of rest: no more than a fifth is learned, with a hint nothing."""
    for _ in range(3):
        filter_ = Filter()
        run(filter_, *at_rest(random, 10))
        before = filter_.state['bias']['bias'].copy()
        for second in range(60):
            if hint:
                filter_.hint(moves=True)
            turning = at_rest(random, 1, (0.0, 0.0, speed * DEGREE))
            run(filter_, *turning, start=START + (10 + second) * 10**9)
        change = np.abs(filter_.state['bias']['bias'] - before) / (speed * DEGREE)
        assert change[2] < (0.01 if hint else 0.2)


def test_a_turn_that_only_several_segments_tell_is_taken_back(random):
    """0.5 deg/s for 30 s after 20 s of rest, in ten times the noise."""
    learned = []
    for _ in range(20):
        rates, accelerations = at_rest(random, 50)
        rates *= 10.0
        rates[2000:, 2] += 0.5 * DEGREE
        bias = run(Filter(), rates, accelerations)['bias'][:, 2]
        learned.append((bias[2000:].mean() - bias[1999]) / (0.5 * DEGREE))
    assert np.mean(learned) < 0.15
    assert max(learned) < 0.5


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


JUMPS = [(1.0, -0.6, 0.8), (-2.5, 0.0, 1.0), (0.0, 0.5, 0.0), (0.0, 8.0, -9.0)]  # deg/s


@pytest.mark.parametrize('jump', JUMPS)
@pytest.mark.parametrize('meanwhile', ['nothing', 'motion', 'silence'])
def test_a_bias_that_jumps_is_learned_within_seconds(jump, meanwhile, random):
    """As of a sensor that is switched on anew, or that takes its own bias off at rest."""
    filter_, jump = Filter(), np.array(jump) * DEGREE
    run(filter_, *at_rest(random, 20))
    now = START + 20 * 10**9
    if meanwhile == 'motion':
        turn, push = by_hand(random, 5)
        rates, accelerations = at_rest(random, 5, jump)
        run(filter_, rates + turn, accelerations + push, start=now)
    now += 0 if meanwhile == 'nothing' else 5 * 10**9
    results = run(filter_, *at_rest(random, 12, jump), start=now)
    np.testing.assert_allclose(results['bias'][-1], jump, atol=0.08 * DEGREE)
    assert results['at_rest'][-1]


@pytest.mark.parametrize('jump', [(0.0, 0.0, 2.0), (0.9, 0.0, 2.0)])
def test_a_jump_that_may_be_a_turn_about_the_vertical_is_taken_for_one(jump, random):
    filter_ = Filter()
    run(filter_, *at_rest(random, 20))
    jumped = at_rest(random, 85, np.array(jump) * DEGREE)
    results = run(filter_, *jumped, start=START + 20 * 10**9)
    assert np.abs(results['bias']).max() < 0.2 * DEGREE
    rest = at_rest(random, 10, np.array(jump) * DEGREE)
    results = run(filter_, *rest, start=START + 105 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], np.array(jump) * DEGREE, atol=0.08 * DEGREE)


def constant(accelerations):
    """An accelerometer that hangs."""
    return np.broadcast_to(accelerations[0], accelerations.shape)


def absent(accelerations):
    return 0.0 * accelerations


def without_gravity(accelerations):
    """What some drivers publish."""
    return accelerations - accelerations.mean(axis=0)


@pytest.mark.parametrize('accelerometer', [constant, absent, without_gravity])
def test_gravity_that_is_not_measured_denies_no_turn(accelerometer, random):
    filter_ = Filter()
    rates, accelerations = at_rest(random, 40)
    rates[2000:, 0] += 1.0 * DEGREE
    results = run(filter_, rates, accelerometer(accelerations))
    assert np.abs(results['bias']).max() < 0.2 * DEGREE


@pytest.mark.parametrize('speed', [0.3, 1.0, 3.0])
def test_a_turn_about_an_axis_that_leans_moves_gravity_and_is_no_bias(speed, random):
    filter_ = Filter()
    rates, accelerations = at_rest(random, 60)
    axis = np.array([0.6, 0.0, 0.8])
    angle = speed * DEGREE * np.clip(np.arange(len(rates)) / 100 - 20, 0, None)
    rates[2000:] += speed * DEGREE * axis
    gravity = Rotation.from_rotvec(-np.outer(angle, axis)).apply([0.0, 0.0, 9.81])
    results = run(filter_, rates, accelerations + gravity - [0.0, 0.0, 9.81])
    assert np.abs(results['bias']).max() < 0.1 * DEGREE


def stands_between_turns(random, stand_rates, turn_rate):
    """Return rates, accelerations and the last sample of each stand of 8 s, with turns between.

    The body stands with each of `stand_rates` (rad/s, about the vertical), and turns to and fro
    about all axes for 8 s before each but the first.
    """
    rates, accelerations, ends = [], [], []
    for k, stand_rate in enumerate(stand_rates):
        if k > 0:
            turn, push = by_hand(random, 8.0)
            still = at_rest(random, 8.0)
            rates.append(still[0] + turn_rate * turn)
            accelerations.append(still[1] + push)
        still = at_rest(random, 8.0, (0.0, 0.0, stand_rate))
        rates.append(still[0])
        accelerations.append(still[1])
        ends.append(sum(map(len, rates)) - 1)
    return np.concatenate(rates), np.concatenate(accelerations), ends


def test_a_rate_that_is_met_again_behind_a_turn_is_the_bias(random):
    """As that of a sensor that warms up: nothing turns as slowly at two stands by chance."""
    jump = 0.6 * DEGREE
    rates, accelerations, ends = stands_between_turns(random, [0.0, jump, jump], 1.0)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][ends[1], 2]) < 0.2 * jump  # a turn, for all that is known
    np.testing.assert_allclose(results['bias'][ends[2], 2], jump, atol=0.1 * jump)


def test_a_slow_turn_that_is_met_again_behind_little_motion_is_no_bias(random):
    """It has gone on meanwhile, as nothing has turned the body elsewhere."""
    turn = 0.6 * DEGREE
    rates, accelerations, ends = stands_between_turns(random, [0.0, turn, turn], 0.1)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][ends, 2]).max() < 0.2 * turn


def test_a_slow_turn_that_is_met_again_is_undone_when_it_ends(random):
    """As of a camera that looks around again and again: the first true stand has the bias."""
    turn = 0.6 * DEGREE
    rates, accelerations, ends = stands_between_turns(random, [0.0, turn, turn, 0.0], 1.0)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][ends[3], 2]) < 0.1 * turn


def test_slow_turns_that_were_taken_for_the_bias_once_are_not_again(random):
    """The stand that has shown the mistake has shown that the body turns slowly at times."""
    turn = 0.6 * DEGREE
    rates, accelerations, ends = stands_between_turns(
        random, [0.0, turn, turn, 0.0, turn, turn, turn, 0.0], 1.0
    )
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'][ends[2], 2], turn, atol=0.1 * turn)
    assert np.abs(results['bias'][ends[3:], 2]).max() < 0.1 * turn


def test_a_bias_that_warms_up_about_the_vertical_is_found(random):
    """Each stand has another rate: further the same way, and by less each time."""
    warming = DEGREE * np.array([0.0, 0.4, 0.75, 1.05, 1.3, 1.5])
    rates, accelerations, ends = stands_between_turns(random, warming, 1.0)
    results = run(Filter(), rates, accelerations)
    errors = results['bias'][ends, 2] - warming
    assert np.abs(errors[1:3] + warming[1:3]).max() < 0.1 * DEGREE  # turns, for all that is known
    assert np.abs(errors[3:]).max() < 0.1 * DEGREE


@pytest.mark.parametrize(
    'turns', [(0.4, 1.2, 1.6), (0.4, 0.75, 0.5), (0.4, 0.75, -0.5), (1.2, 1.6, 2.0)]
)
def test_slow_turns_that_are_faster_each_time_are_no_warm_up(turns, random):
    """Nor are those that turn back, nor what no sensor warms up by."""
    rates, accelerations, ends = stands_between_turns(
        random, DEGREE * np.array([0.0, *turns, 0.0]), 1.0
    )
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][ends, 2]).max() < 0.1 * DEGREE


@pytest.mark.parametrize('speed', [1.0, 3.0, 9.0])
def test_a_turn_that_has_been_taken_for_the_bias_is_undone_when_it_ends(speed, random):
    """After a minute and a half nothing tells the one from the other; the end of it does."""
    bias = np.array([0.01, -0.02, 0.015])
    filter_, turn = Filter(), np.array([0.0, 0.0, speed * DEGREE])
    run(filter_, *at_rest(random, 20, bias))
    results = run(filter_, *at_rest(random, 150, bias + turn), start=START + 20 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], bias + turn, atol=1e-3)
    results = run(filter_, *at_rest(random, 10, bias), start=START + 170 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], bias, atol=1e-3)
    # And a bias that has jumped indeed is one from then on.
    results = run(filter_, *at_rest(random, 150, bias + turn), start=START + 180 * 10**9)
    results = run(filter_, *at_rest(random, 60, bias + 2.0 * turn), start=START + 330 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], bias + turn, atol=1e-3)


def test_a_sensor_that_feels_gravity_finds_its_bias_on_each_side(random):
    """Where it lies otherwise its bias is another one, and no turn."""
    error, lost = on_other_sides(random, 0.1, 100.0)
    assert error < 0.02
    assert lost < 10.0


def humming(random, seconds):
    """Return rates and accelerations (n, 3) that a motor adds at 37 Hz."""
    time = np.arange(round(100 * seconds)) / 100.0
    tone = np.sin(2 * np.pi * 37.3 * time)[:, None]
    return 0.03 * tone * [1.0, 0.5, 0.7], 0.6 * tone * [0.3, 1.0, 0.4]


def noisier(random, seconds):
    """Return what makes a sensor three times as noisy, and its accelerometer twice."""
    n = round(100 * seconds)
    return 0.017 * random.standard_normal((n, 3)), 0.035 * random.standard_normal((n, 3))


def shaken(random, seconds):
    """Return what makes the accelerometer alone five times as noisy."""
    n = round(100 * seconds)
    return np.zeros((n, 3)), 0.1 * random.standard_normal((n, 3))


@pytest.mark.parametrize('machine', [humming, noisier, shaken])
def test_a_machine_that_is_switched_on_after_the_first_rest_hides_no_rest(machine, random):
    """A robot that stands for five seconds now and then, as its bias warms up by a degree a second.

    It does so within ten minutes.
    """
    rates, accelerations = at_rest(random, 190)
    bias = np.linspace(0.0, 190 * DEGREE / 600, len(rates))[:, None] * [1.0, -1.0, 0.5]
    more, shake = machine(random, 180)
    rates[1000:] += more
    accelerations[1000:] += shake
    stands = np.ones(len(rates), bool)
    for begin in range(1500, 18_500, 1000):
        part = slice(begin, begin + 500)
        turn, push = by_hand(random, 5.0)
        rates[part] += turn
        accelerations[part] += push
        stands[part] = False
    results = run(Filter(), rates + bias, accelerations)
    late = np.arange(len(rates)) > 6000
    assert results['at_rest'][late & stands].mean() > 0.4
    assert results['at_rest'][late & ~stands].mean() < 0.05
    assert np.abs(results['bias'] - bias)[late].max() < 2.5e-3


@pytest.mark.parametrize('machine', [humming, noisier, shaken])
def test_a_machine_that_stays_on_between_long_drives_hides_no_rest(machine, random):
    """No three segments of rest come after one another, and none within ten seconds of another."""
    spells = [(10, False)] + 12 * [(20, True), (5, False)]
    rates, accelerations = moving_and_resting(random, spells, lambda time: np.zeros(3))
    more, shake = machine(random, len(rates) / 100 - 10.5)
    rates[1050:] += more
    accelerations[1050:] += shake
    seconds = np.arange(len(rates)) / 100
    truth = np.outer(1.0 - np.exp(-seconds / 240), (0.2, -0.3, 1.0)) * DEGREE
    results = run(Filter(), rates + truth, accelerations)
    late, stands = seconds > 100.0, (seconds - 10.0) % 25.0 >= 20.0
    assert results['at_rest'][late & stands].mean() > 0.4
    assert results['at_rest'][late & ~stands].mean() < 0.01
    assert np.abs(results['bias'] - truth)[late].max() < 0.3 * DEGREE


@pytest.mark.parametrize('speed', [0.5, 1.5])
def test_vibration_in_a_curve_that_is_driven_again_and_again_is_no_rest(speed, random):
    """As in laps: the noise is the same each time, and so is the rate."""
    parts = [at_rest(random, 10)]
    for _ in range(10):
        for seconds in (16, 4, 8):
            rates, accelerations = at_rest(random, seconds)
            if seconds == 4:
                rates += 0.01 * random.standard_normal(rates.shape) + [0, 0, speed * DEGREE]
                accelerations += 0.1 * random.standard_normal(rates.shape)
            else:
                turn, push = by_hand(random, seconds)
                rates, accelerations = rates + turn, accelerations + push
                rates[:, 2] += 0.4 if seconds == 16 else 0.0
            parts.append((rates, accelerations))
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    results = run(Filter(), rates, accelerations)
    assert results['at_rest'][1500:].mean() < 0.01
    assert np.abs(results['bias'][1000:, 2]).max() < 0.1 * DEGREE


def test_a_machine_that_runs_now_and_then_hides_no_rest(random):
    rates, accelerations = at_rest(random, 120)
    runs = (np.arange(len(rates)) % 2000 < 600) & (np.arange(len(rates)) > 1000)
    more, shake = humming(random, 120)
    rates[runs] += more[runs]
    accelerations[runs] += shake[runs]
    results = run(Filter(), rates, accelerations)
    assert results['at_rest'][6000:].mean() > 0.7


def test_after_a_slow_turn_short_rests_are_believed_again(random):
    """Each of them is one segment long."""
    filter_ = Filter()
    run(filter_, *at_rest(random, 10))
    run(filter_, *at_rest(random, 10, (0.0, 0.0, 5.0 * DEGREE)), start=START + 10 * 10**9)
    assert filter_.state['bias']['segments_turning'] > 0
    truth = np.array([0.1, -0.1, 0.1]) * DEGREE
    spells = 4 * [(20, True), (3, False)] + [(1, True)]
    rates, accelerations = moving_and_resting(random, spells, lambda time: truth)
    results = run(filter_, rates, accelerations, start=START + 20 * 10**9)
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.06 * DEGREE)


@pytest.mark.parametrize('stop', [1.75, 2.2])
def test_short_stops_keep_a_bias_that_warms_up(stop, random):
    """None of them is a whole segment of rest, with the blocks that begin and end it."""
    spells = [(6, False)] + 20 * [(15, True), (stop, False)]
    rates, accelerations = moving_and_resting(random, spells, lambda time: np.zeros(3))
    seconds = np.arange(len(rates)) / 100
    truth = np.outer(1.0 - np.exp(-seconds / 120), (0.2, -0.3, 1.0)) * DEGREE
    error = run(Filter(), rates + truth, accelerations)['bias'] - truth
    assert np.abs(error[-1]).max() < 0.06 * DEGREE
    assert np.abs(error.sum(axis=0) / 100).max() < 40.0 * DEGREE  # 240 without the stops


def test_one_signal_that_vibrates_shows_where_a_short_stop_begins(random):
    """The rates do, by little more than noise; the accelerations change smoothly at its ends."""
    seconds = np.arange(33_600) / 100
    since = np.where(seconds < 6.0, 0.0, (seconds - 6.0) % 22.0)
    window = np.clip(np.minimum(since, 20.0 - since) / 0.5, 0.0, 1.0)[:, None]
    sway = 0.3 * window * np.sin(0.7 * seconds)[:, None]
    truth = np.outer(1.0 - np.exp(-seconds / 120), (0.2, -0.3, 1.0)) * DEGREE
    lost = []
    for _ in range(5):
        rates, accelerations = at_rest(random, 336)
        rates += sway + 0.01 * (window > 0.0) * random.standard_normal(rates.shape)
        error = run(Filter(), rates + truth, accelerations + sway)['bias'] - truth
        lost.append(np.abs(error.sum(axis=0) / 100).max() / DEGREE)
    assert np.median(lost) < 30.0


def test_where_a_slow_turn_stops_to_differ_from_noise_is_no_short_stop(random):
    """What shows such a turn is that the means move, and they do so for long parts of it alone."""
    changed = []
    for _ in range(20):
        rates, accelerations = at_rest(random, 70)
        angle = 0.2 * DEGREE * np.clip(np.arange(len(rates)) / 100 - 10, 0, None)
        rates[1000:, 0] += 0.2 * DEGREE
        accelerations[:, 1] += 9.81 * np.sin(angle)
        bias = run(Filter(), rates, accelerations)['bias'][:, 0]
        changed.append(abs(bias[-1] - bias[999]) / DEGREE)
    assert np.median(changed) < 0.03


def test_a_turn_to_and_fro_passes_the_bias_and_is_none(random):
    """For a minute; docs/bias_measurements.md says how often it is learned, and for how long."""
    learned = []
    for _ in range(9):
        rates, accelerations = at_rest(random, 80)
        time = np.arange(len(rates)) / 100
        rates[:, 2] += 0.5 * DEGREE * np.sin(2 * np.pi * 0.1 * time) * (time > 20)
        bias = run(Filter(), rates, accelerations)['bias'][:, 2]
        learned.append(np.abs(bias[2000:] - bias[1999]).max())
    assert np.quantile(learned, 0.75) < 0.05 * DEGREE
    assert max(learned) < 0.25 * DEGREE


@pytest.mark.parametrize(('speed', 'period'), [(0.3, 6.0), (0.3, 10.0), (0.5, 20.0), (1.0, 40.0)])
def test_a_slow_swing_moves_the_bias_by_little(speed, period, random):
    """Where its rate is largest it passes for rest; it lost up to 20 deg of heading in 100 s."""
    lost = []
    for _ in range(5):
        moved, angle = to_and_fro(random, speed, period, 100.0)
        assert moved < 0.4 * speed
        lost.append(angle)
    assert np.median(lost) < 4.0


def test_a_rest_after_a_slow_swing_is_learned(random):
    """Although it might be the swing for as long as that takes."""
    rates, accelerations = at_rest(random, 180)
    time = np.arange(len(rates)) / 100
    rates[:, 2] += 0.5 * DEGREE * np.sin(0.1 * np.pi * time) * ((time > 20) & (time < 80))
    truth = 0.1 * DEGREE * np.clip((time - 20) / 60, 0.0, 1.0)
    results = run(Filter(), rates + truth[:, None], accelerations)
    errors = np.abs(results['bias'] - truth[:, None]) / DEGREE
    assert errors[-1].max() < 0.03
    within = errors < 2.0 * np.sqrt(results['angular_velocity_variance']) / DEGREE
    assert within[2000:].mean() > 0.95


def test_the_swing_is_measured_by_its_means(random):
    """Against the variance and the correlation of a sine."""
    rest, lengths, swing = (zeroed(kind)[0] for kind in (REST, REST_LENGTHS, SWING))
    rest['known'], noise, blocks = True, 1e-3, 16_000
    lengths['block'], lengths['block_seconds'] = 12, 0.125
    amplitude, period = 0.01, 20.0
    truth = amplitude * np.sin(2.0 * np.pi * 0.125 * np.arange(blocks) / period)
    variances, steps = [], []
    for rate in truth:
        for index in range(SIGNALS):
            values = noise * random.standard_normal(12) + (rate if index == 0 else 0.0)
            signal_ = rest['signals'][index]
            signal_['variance'], signal_['scatter'] = noise**2, noise**2 / 12
            signal_['sum'], signal_['squares'] = values.sum(), np.square(values).sum()
        rest['count'] = 12
        note_swing(swing, rest, lengths)
        variances.append(swing['variance'][0])
        steps.append(swing['step_variance'][0])
    correlation = np.cos(2.0 * np.pi * HALF * 0.125 / period)
    expected = amplitude**2 / 2.0
    assert np.mean(variances[800:]) == pytest.approx(expected, rel=0.3)
    assert np.mean(steps[800:]) == pytest.approx(2.0 * expected * (1.0 - correlation), rel=0.1)
    assert variance_of_swing(swing, rest, 0) == swing['variance'][0]  # so slow that any may pass
    assert variance_of_swing(swing, rest, 1) < 1e-3 * expected
    swing['variance'][0], swing['step_variance'][0] = expected, expected  # a correlation of 0.5
    bend = MEAN_DEVIATIONS**2 * noise**2 / 12
    assert variance_of_swing(swing, rest, 0) == pytest.approx(min(expected, bend))
    swing['step_variance'][0] = 2.0 * expected  # of 0: it is seen
    assert variance_of_swing(swing, rest, 0) == 0.0
    rest['at_rest'] = True
    note_swing(swing, rest, lengths)
    assert 0.0 < swing['variance'][0] < expected
    forget_swing(swing)
    assert swing['variance'][0] == swing['step_variance'][0] == 0.0


def test_a_turn_that_tilts_gravity_is_seen_by_the_accelerometer(random):
    """From the start, where no bias is known that it could be compared with."""
    rates, accelerations = at_rest(random, 60, (1.0 * DEGREE, 0.0, 0.0))
    angle = 1.0 * DEGREE * np.arange(len(rates)) / 100
    accelerations += 9.81 * np.column_stack([0 * angle, np.sin(angle), np.cos(angle) - 1])
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias']).max() < 1e-4


@pytest.mark.parametrize('begins', [1.5, 2.0])
def test_a_drone_that_takes_off_at_once_has_a_bias(begins, random):
    """Its motors run, and it never rests: its first second has to do."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = taking_off(random, 60, truth, begins)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][125:] - truth).max() < 6e-3
    deviations = np.sqrt(results['angular_velocity_variance'][[20, 125]]).max(axis=1)
    assert deviations[1] < 0.3 * deviations[0]


def test_a_zero_that_the_first_seconds_confirm_is_kept_and_known(random):
    """Where the driver subtracts the bias, a noisy mean is no better, but it says so."""
    filter_ = Filter()
    results = run(filter_, *taking_off(random, 60, np.zeros(3)))
    assert (filter_.state['bias']['bias'] == 0.0).all()
    assert np.abs(results['bias']).max() < 2e-3
    deviations = np.sqrt(results['angular_velocity_variance'][[20, 200]]).max(axis=1)
    assert deviations[1] < 0.3 * deviations[0]


@pytest.mark.parametrize('off', [1e-3, 3e-2])
def test_an_initial_bias_is_replaced_by_the_mean_of_the_first_seconds(off, random):
    """It has changed since it was identified, by more than that mean is off."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = taking_off(random, 60, truth)
    known, unknown = Filter(Parameters(bias_initial=tuple(truth + off))), Filter()
    biases = [run(filter_, rates, accelerations)['bias'][200] for filter_ in (known, unknown)]
    np.testing.assert_allclose(biases[0], biases[1], atol=1e-4)


def test_with_a_provisional_bias_gravity_is_where_the_accelerometer_says(random):
    """Until then the direction has turned with the bias: by 6 degrees in the first second."""
    rates, accelerations = idling(random, 1.4, np.array([0.1, -0.1, 0.0]))
    filter_ = Filter()
    results = run(filter_, rates, accelerations)
    assert np.abs(results['bias'][-1]).max() > 0.08
    direction = filter_.state['bias']['motion']['state_vector'][DIRECTION : DIRECTION + 3]
    np.testing.assert_allclose(direction, [0.0, 0.0, 1.0], atol=0.02)


def test_a_take_off_is_no_rest(random):
    """It goes up with a slow drift of the rates, less steady than it stood before."""
    truth = np.array([-0.002, 0.021, 0.077])
    rates, accelerations = idling(random, 60, truth)
    turn, push = by_hand(random, 56)
    rates[200:400] += 0.012 * random.standard_normal((16, 3)).repeat(13, axis=0)[:200] - 0.009
    rates[400:] += turn
    accelerations[400:] += push
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][125:] - truth).max() < 6e-3


def test_noise_that_is_correlated_over_seconds_hides_no_bias_at_low_rates(random):
    """A phone at 10 Hz, whose noise has passed a low-pass of 0.1 Hz: a rest takes a minute."""
    section = signal.butter(2, 0.12, fs=10.0, output='sos')
    bias = np.radians([2.0, -1.2, 0.7])
    for _ in range(6):
        noise = signal.sosfilt(section, 0.012 * random.standard_normal((800, 3)), axis=0)[300:]
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((500, 3))
        stamps = START + 100_000_000 * np.arange(500)
        results = Filter().run(stamps, noise + bias, acceleration)
        assert np.abs(results['bias'][200:] - bias).max() < np.radians(0.4)


def slow_noise(random, count):
    """Return noise (count, 3) at 10 Hz that has passed two low-passes of 0.08 Hz."""
    share = 0.05
    lags = [share**2], np.convolve([1.0, share - 1.0], [1.0, share - 1.0])
    return signal.lfilter(*lags, 0.012 * random.standard_normal((count + 300, 3)), axis=0)[300:]


def test_a_bias_is_provisional_later_too_while_gravity_has_stood(random):
    """With noise as slow as this minutes may pass without any stretch that is steady."""
    bias = np.radians([2.0, -1.2, 0.7])
    stamps, late = START + 100_000_000 * np.arange(1200), []
    for _ in range(12):
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((1200, 3))
        results = Filter().run(stamps, slow_noise(random, 1200) + bias, acceleration)
        late.append(not results['bias'][190].any())
        assert np.abs(results['bias'][1100:] - bias).max() < np.radians(0.3)
    assert any(late)


def test_the_mean_while_gravity_stands_is_that_of_plain_blocks(random):
    rates = slow_noise(random, 400) + np.array([0.03, -0.02, 0.01])
    acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((400, 3))
    filter_ = Filter()
    filter_.run(START + 100_000_000 * np.arange(400), rates, acceleration)
    rest = filter_.state['bias']['rest']
    # The first block says where gravity is.
    blocks = rates.reshape(50, 8, 3).mean(axis=1)[1:]
    assert rest['standing_blocks'] == len(blocks)
    for axis in range(3):
        means = blocks[:, axis]
        scatter = means.var(ddof=1)
        assert standing_mean(rest, axis) == pytest.approx(means.mean(), rel=1e-12)
        assert standing_scatter(rest, axis) == pytest.approx(scatter, rel=1e-9)
        # A correlation beyond this one is none of noise that falls off.
        correlation = min(1.0 - 0.5 * np.square(np.diff(means)).mean() / scatter, 0.9)
        longer = (1.0 + correlation) / (1.0 - correlation)
        expected = longer * scatter / len(means)
        assert variance_of_standing_mean(rest, axis) == pytest.approx(expected, rel=1e-2)


def test_a_doubt_after_a_long_drive_keeps_its_bound_for_some_time():
    rest, lengths = zeroed(REST)[0], zeroed(REST_LENGTHS)[0]
    lengths['block'], lengths['block_seconds'] = 8, 0.125
    rest['known'], rest['restless'] = True, 10_000
    doubt_noise(rest)
    for _ in range(2400):
        close_block(rest, lengths)
        assert rest['calm_known']
    close_block(rest, lengths)
    assert not rest['calm_known']


@pytest.mark.parametrize('more', [0, 3])
def test_the_later_half_of_a_segment_stands_for_itself(more, random):
    """Nothing of the half before it is left in its sums, nor the step from that half to it."""
    rest = np.zeros(1, REST)[0]
    start_segment(rest)
    means = 3.0 * random.standard_normal(SEGMENT_BLOCKS + more)
    means[:HALF] += 50.0
    for number, mean in enumerate(means):
        for axis in range(SIGNALS):
            rest['signals'][axis]['waiting_mean'] = mean
            rest['signals'][axis]['waiting_variance'] = number
        add_waiting_block(rest)
        if number == SEGMENT_BLOCKS - 1:
            drop_early_half(rest)
    kept, signal_ = means[HALF:], rest['signals'][0]
    sums = signal_['segment']
    assert rest['blocks'] == len(kept)
    assert sums['first'] == kept[0]
    assert segment_mean(rest, 0) == pytest.approx(kept.mean())
    assert scatter_of_means(sums, len(kept)) == pytest.approx(kept.var(ddof=1))
    assert mean_square_step(sums, len(kept)) == pytest.approx(np.square(np.diff(kept)).mean())
    assert value_variance(rest, signal_) == np.arange(HALF, len(means)).mean()


def test_the_first_rest_is_compared_with_a_mean_of_as_many_blocks(random):
    """That since the start has more of them: by its own scatter every rest was less steady."""
    stamps, taken = START + 100_000_000 * np.arange(400), 0
    acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((400, 3))
    filters = [Filter() for _ in range(8)]
    rates = slow_noise(random, 3200).reshape(8, 400, 3) + np.array([0.03, -0.02, 0.01])
    for number, first in product(range(8), range(0, 400, 8)):
        filter_ = filters[number]
        state = filter_.state['bias']
        before = state['provisional_variance'].copy()
        part = slice(first, first + 8)
        filter_.run(stamps[part], rates[number, part], acceleration[part])
        if (
            first >= 8 * 24
            and state['segments'] == 0
            and (state['provisional_variance'] != before).any()
        ):
            taken += 1
            blocks = state['rest']['standing_blocks']
            for axis in range(3):
                mean = variance_of_standing_mean(state['rest'], axis)
                assert state['provisional_variance'][axis] == pytest.approx(mean * blocks / 16)
    assert taken > 0


def test_who_has_moved_gets_no_provisional_bias_later(random):
    """The noise is too slow for a rest, and the turn that follows is steady."""
    stamps, count = START + 100_000_000 * np.arange(600), 0
    for _ in range(12):
        rates = slow_noise(random, 600)
        acceleration = np.array([0.3, -0.2, 9.8]) + 0.02 * random.standard_normal((600, 3))
        rates[50:60, 0] += 0.2  # it is laid down anew
        acceleration[55:, 1] += 2.0
        rates[250:, 2] += 3.0 * DEGREE
        filter_ = Filter()
        results = filter_.run(stamps[:400], rates[:400], acceleration[:400])
        if filter_.state['bias']['segments'] == 0:
            count += 1
            assert np.abs(results['bias'][-1]).max() < 0.5 * DEGREE
    assert count > 0


def rattling(random, count, deviation):
    """Return rates and accelerations (count, 3) at 100 Hz of a body that shakes at 0.5 to 4 Hz."""
    section = signal.butter(3, (0.5, 4.0), 'bandpass', fs=100.0, output='sos')
    shake = signal.sosfilt(section, random.standard_normal((count, 3)), axis=0)
    rates = deviation * shake / shake.std() + 0.002 * random.standard_normal((count, 3))
    return rates, 0.02 * random.standard_normal((count, 3)) + [0.0, 0.0, 9.81]


def test_a_turn_beside_a_rattle_is_no_provisional_bias(random):
    """To and fro about the vertical, on a rough floor: the other axes scatter as much."""
    rates, acceleration = rattling(random, 6000, 0.02)
    rates[:, 2] += 4.0 * DEGREE * np.where(np.arange(6000) % 2000 < 1000, 1.0, -1.0)
    results = run(Filter(), rates, acceleration)
    assert np.abs(results['bias']).max() < 0.5 * DEGREE


def test_a_hand_gives_no_provisional_bias(random):
    """It holds the sensor, as well as hands do, from the start."""
    rates, accelerations = at_rest(random, 3)
    rates += np.cumsum(random.standard_normal(rates.shape), axis=0) * 0.004
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias']).max() < 1e-4


@pytest.mark.parametrize('speed', [0.5, 2.0, 5.0])
def test_a_turn_from_power_on_is_unlearned_at_the_first_rest(speed, random):
    """About the vertical, for a second and a half: nothing tells it from a bias before."""
    rates, accelerations = at_rest(random, 20, (0.0, 0.5 * DEGREE, 0.0))
    rates[:150, 2] += speed * DEGREE
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][:150, 2]).max() < speed * DEGREE + 2e-3
    truth = (0.0, 0.5 * DEGREE, 0.0)
    np.testing.assert_allclose(results['bias'][500], truth, atol=0.2 * DEGREE)


@pytest.mark.parametrize('speed', [3.0, 6.0, 9.0])
@pytest.mark.parametrize('stands', [1.2, 1.6])
def test_a_turn_that_replaces_the_provisional_bias_is_undone_at_the_next_rest(
    stands, speed, random
):
    """The robot turns about the vertical for 30 s after a second, as to look around, and drives."""
    truth = np.array([1.0, -2.0, 0.5]) * DEGREE
    standing, turning = round(stands * 100), slice(round(stands * 100), round(stands * 100) + 3000)
    rates, accelerations = at_rest(random, 90, truth)
    rates[turning, 2] += speed * DEGREE
    turn, push = by_hand(random, 20)
    rates[5000:7000] += 0.3 * turn
    accelerations[5000:7000] += push
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'][standing - 1], truth, atol=0.3 * DEGREE)
    np.testing.assert_allclose(results['bias'][turning.stop + 500], truth, atol=0.1 * DEGREE)
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.1 * DEGREE)


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


def test_a_turn_learned_at_the_start_is_unlearned(random):
    """Two minutes of rest tell that it was none."""
    filter_ = Filter()
    run(filter_, *at_rest(random, 10, (0.0, 0.0, 5.0 * DEGREE)))
    assert filter_.state['bias']['bias'][2] == pytest.approx(5.0 * DEGREE, rel=0.05)
    run(filter_, *at_rest(random, 120), start=START + 10 * 10**9)
    assert abs(filter_.state['bias']['bias'][2]) < 0.05 * DEGREE


def test_a_rate_beyond_the_largest_bias_is_left_in_and_counted(random):
    filter_ = Filter()
    results = run(filter_, *at_rest(random, 60, (0.0, 0.0, 12.0 * DEGREE)))
    assert np.abs(results['bias']).max() < 1e-3
    assert filter_.state['bias']['segments_beyond_max'] > 20
    filter_ = Filter(Parameters(bias_max=0.3))
    results = run(filter_, *at_rest(random, 60, (0.0, 0.0, 12.0 * DEGREE)))
    assert results['bias'][-1, 2] == pytest.approx(12.0 * DEGREE, rel=0.01)


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


@pytest.mark.parametrize('nothing', [0.0, np.nan])
def test_without_an_accelerometer(nothing, random):
    truth = np.array([0.3, -0.2, 0.5]) * DEGREE
    spells = [(10, False), (20, True), (6, False)]
    rates, accelerations = moving_and_resting(random, spells, lambda time: truth)
    results = run(Filter(), rates, np.full_like(accelerations, nothing))
    assert np.isfinite(results['angular_velocity']).all()
    assert np.abs(results['bias'][1000:] - truth).max() < 0.06 * DEGREE


def test_outliers_missing_samples_and_bursts_do_not_hide_a_rest(random):
    truth = np.array([0.3, -0.2, 0.5]) * DEGREE
    rates, accelerations = at_rest(random, 60, truth)
    spikes = random.choice(len(rates), 60, replace=False)
    rates[spikes, 0] += 10.0
    rates[random.choice(len(rates), 60, replace=False)] = np.nan
    filter_ = Filter(Parameters(sample_rate=100.0))
    stamps = START + 10_000_000 * (np.arange(len(rates)) // 45 * 45)
    results = filter_.run(stamps, rates, accelerations)
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.05 * DEGREE)
    assert results['at_rest'][1000:].mean() > 0.3


def rests_in_poses(random, count=8):
    """Return rates, accelerations (n, 3) and the ends of rests of 7 s, each in another pose."""
    spells = [(7.0, False), (6.0, True)] * count
    rates, accelerations = moving_and_resting(random, spells, lambda time: np.zeros(3))
    for k in range(count):
        pose = Rotation.from_euler('xyz', random.uniform(-0.5, 0.5, 3))
        accelerations[1300 * k :] = pose.apply(accelerations[1300 * k :])
    return rates, accelerations, 1300 * np.arange(count) + 690


@pytest.mark.parametrize('failed', [np.nan, 0.0, np.inf, -0.0024, 39.2])
def test_reads_of_the_accelerometer_that_fail_hide_no_rest(failed, random):
    """An error code that a driver takes for a value is -1 count, or the end of the range."""
    rates, accelerations, ends = rests_in_poses(random)
    accelerations[random.random(len(rates)) < 0.05] = failed
    results = run(Filter(), rates, accelerations)
    assert (results['at_rest'][ends] == 1.0).all()


def with_spikes(random, accelerations, size, share, held=1):
    """Return accelerations of which an axis is wrong now and then; each is repeated `held` times.

    It is `size` in m/s^2, or 0.
    """
    wrong = accelerations[::held].copy()
    rows = np.flatnonzero(random.random(len(wrong)) < share)
    wrong[rows, random.integers(0, 3, len(rows))] = size * random.choice([-1.0, 1.0], len(rows))
    return np.repeat(wrong, held, axis=0)[: len(accelerations)]


@pytest.mark.parametrize('held', [1, 4])
@pytest.mark.parametrize('share', [0.005, 0.02])
@pytest.mark.parametrize('size', [0.0, 15.0, 40.0, 490.0])
def test_an_axis_of_the_accelerometer_that_is_wrong_now_and_then_hides_no_rest(
    size, share, held, random
):
    """Two in a row that are wrong do hide a segment."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    results = run(Filter(), rates, with_spikes(random, accelerations, size, share, held))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


def test_what_stands_in_for_a_spike_of_the_accelerometer_is_its_last_value(random):
    """What stays is no spike from the second sample on, nor is what shakes all the time."""
    _, accelerations = at_rest(random, 5)
    shaken = accelerations + 0.5 * (np.arange(len(accelerations)) % 3 == 0)[:, None]
    spikes = accelerations.copy()
    spikes[100::50, 2] += 15.0
    moved = accelerations.copy()
    moved[300:, 0] += 3.0
    for given, axis, wrong in (
        (accelerations, 0, []),
        (spikes, 2, range(100, 500, 50)),
        (moved, 0, [300]),
    ):
        expected = given.copy()
        expected[wrong, axis] = given[np.array(wrong, dtype=int) - 1, axis]
        np.testing.assert_array_equal(felt_in(given), expected)
    differs = (felt_in(shaken) != shaken).any(axis=1)
    assert not differs[50:].any()


LONGEST = 6  # samples: half a block at 100 Hz


def felt_in(accelerations):
    """Return the accelerations that rest sees."""
    force = Filter().state['bias']['rest']['force']
    felt = []
    for acceleration in accelerations:
        note_force(force, acceleration, LONGEST)
        felt.append(force['felt'].copy())
    return np.array(felt)


@pytest.mark.parametrize('held', [3, 6])
def test_an_acceleration_that_is_repeated_is_a_spike_for_less_than_a_block(held, random):
    """Of an accelerometer that is slow; one that stays after that is that of a simulator."""
    _, accelerations = at_rest(random, 12)
    accelerations = np.repeat(accelerations[::held], held, axis=0)
    accelerations[900 : 900 + held, 2] = 30.0
    accelerations[1100:] = 0.0, 1.0, 2.0
    felt = felt_in(accelerations)
    assert felt[:1100, 2].max() < 10.0
    assert np.flatnonzero(felt[:, 2] == 2.0).tolist() == list(range(1100 + LONGEST, 1200))


def measured_at(numbers, accelerations, between):
    """Return accelerations at these numbers of samples, with what a driver sends `between`."""
    if between is None:
        last = np.zeros(len(accelerations), int)
        last[numbers] = numbers
        return accelerations[np.maximum.accumulate(last)]
    sent = np.full_like(accelerations, between)
    sent[numbers] = accelerations[numbers]
    return sent


@pytest.mark.parametrize('between', [None, np.nan, 0.0])
@pytest.mark.parametrize('every', [7, 8, 13, 20, 33, 50, 100, 200])
def test_a_slow_accelerometer_hides_no_rest(every, between, random):
    """It shows no noise within a block, or a jump, so that rest sees none."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    numbers = np.arange(0, len(rates), every)
    results = run(Filter(), rates, measured_at(numbers, accelerations, between))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


@pytest.mark.parametrize(('every', 'delay'), [(6, 1), (7, 1), (8, 2), (10, 4)])
def test_delays_do_not_make_an_accelerometer_slow_and_fast_by_turns(every, delay, random):
    rates, accelerations, ends = rests_in_poses(random, 16)
    numbers = np.arange(0, len(rates), every)
    numbers[1:] += random.integers(-delay, delay + 1, len(numbers) - 1)
    numbers = numbers[numbers < len(rates)]
    results = run(Filter(), rates, measured_at(numbers, accelerations, None))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


def test_what_a_slow_accelerometer_has_shown_long_ago_is_no_gravity_that_stands(random):
    """Until it is fast: else the mean rate of a motion would be that of a body that stands."""
    rates, accelerations = moving_and_resting(random, [(60.0, True)], lambda time: np.zeros(3))
    filter_ = Filter()
    slow = measured_at(np.arange(0, len(rates), 200), accelerations, None)
    results = run(filter_, rates, slow)
    rest = filter_.state['bias']['rest']
    assert rest['steady_seconds'] == 0.0
    assert rest['standing_blocks'] == 0
    assert not results['at_rest'].any()
    _, later = at_rest(random, 1.0)
    felt = felt_in(np.concatenate([slow, later]))
    np.testing.assert_array_equal(felt[:6000], np.tile(slow[0], (6000, 1)))
    np.testing.assert_array_equal(felt[6020:], later[20:])


def test_an_accelerometer_that_measures_every_fourth_sample_hides_no_rest(random):
    rates, accelerations, ends = rests_in_poses(random)
    accelerations[np.arange(len(rates)) % 4 > 0] = np.nan
    results = run(Filter(), rates, accelerations)
    assert (results['at_rest'][ends] == 1.0).mean() > 0.8


@pytest.mark.parametrize('count', [0.15, 0.3, 0.6])
def test_a_coarse_accelerometer_hides_no_rest(count, random):
    """An axis that shows one count in one pose toggles between two of them in the next one."""
    rates, accelerations, ends = rests_in_poses(random, 16)
    results = run(Filter(), rates, count * np.round(accelerations / count))
    assert (results['at_rest'][ends] == 1.0).mean() > 0.85


@pytest.mark.parametrize('rate', [100.0, 200.0, 400.0])
@pytest.mark.parametrize('size', [0.1, 0.5])
def test_spikes_from_power_on_hide_no_rest(size, rate, random):
    """Of a size that a body may reach in motion, of which nobody knows yet that there is none."""
    truth = np.array([1.0, -2.0, 0.5]) * DEGREE
    rates, accelerations = at_rest(random, 20, truth, rate)
    spikes = random.random(rates.shape) < 1.0 / 500.0
    spikes[::60, 1] = True
    spikes[1::60] = False
    results = run(Filter(), rates + size * spikes, accelerations, rate)
    assert results['at_rest'][round(4.0 * rate)] == 1.0
    np.testing.assert_allclose(results['bias'][-1], truth, atol=0.1 * DEGREE)
    late = slice(round(5.0 * rate), None)
    assert results['outlier'][late][spikes[late]].mean() > 0.9


@pytest.mark.parametrize('share', [0.02, 0.1, 0.3])
def test_the_single_counts_of_a_coarse_sensor_are_no_spikes(share, random):
    """Its bias shows in how often the next count comes: left out they would leave it in."""
    rates, accelerations = at_rest(random, 60)
    count = 1.0 * DEGREE
    rates = count * (random.random(rates.shape) < share)
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'][-1], share * count, atol=0.05 * count)


def test_no_motion_and_no_noise_is_a_spike(random):
    """Not by hand, not where it begins or ends, not in a vibration; but what is back at once is."""
    rates, _ = at_rest(random, 60)
    moved = rates + 0.3 * by_hand(random, 60)[0]
    shaken = rates + 0.05 * np.sin(0.3 * 2.0 * np.pi * np.arange(6000))[:, None]
    steps = rates + 0.5 * (np.arange(6000) // 300 % 2)[:, None]
    assert [spikes_in(given) for given in (rates, moved, shaken, steps)] == [[], [], [], []]
    moved[np.arange(500, 6000, 500), 2] += 0.5
    assert spikes_in(moved) == list(range(500, 6000, 500))


def spikes_in(rates):
    """Return the indexes of the spikes."""
    waiting, sample = zeroed(WAITING)[0], zeroed(SAMPLE)[0]
    found = []
    for k, rate in enumerate(rates):
        sample['angular_velocity'] = rate
        if note_next(waiting, sample, True, 0):
            found.append(k - 1)
        let_wait(waiting, sample, True, 0)
    return found


def shaken_later(rates, accelerations, random):
    rates[1500:, 1] *= 5.0


def turned_later(rates, accelerations, random):
    rates[1500:, 2] += 0.05


def turning_faster_and_faster(rates, accelerations, random):
    rates[:, 2] += 0.0005 * np.arange(3000)


def without_rates(rates, accelerations, random):
    rates[1500:] = np.nan


def jumping(rates, accelerations, random):
    rates[:, 0] += np.repeat(0.1 * random.standard_normal(30), 100)


def shaken_from_the_second_second_on(rates, accelerations, random):
    rates[130:, 1] *= 8.0


@pytest.mark.parametrize(
    ('change', 'obstacle', 'signal'),
    [
        (shaken_later, Obstacle.VARIES, 1),
        (turned_later, Obstacle.NO_BIAS, 0),
        (turning_faster_and_faster, Obstacle.DRIFTS, 2),
        (without_rates, Obstacle.FEW_SAMPLES, 0),
        (jumping, Obstacle.SCATTERS, 0),
        (shaken_from_the_second_second_on, Obstacle.UNEVEN, 1),
    ],
)
def test_it_is_noted_why_a_stretch_is_no_rest(change, obstacle, signal, random):
    rates, accelerations = at_rest(random, 30)
    change(rates, accelerations, random)
    filter_, noted = Filter(), set()
    rest = filter_.state['bias']['rest']
    for first in range(0, 3000, 10):
        part = slice(first, first + 10)
        run(filter_, rates[part], accelerations[part], start=START + first * 10_000_000)
        if rest['at_rest']:
            assert rest['obstacle'] == Obstacle.NONE
        noted.add((Obstacle(rest['obstacle']), int(rest['obstacle_signal'])))
    assert (obstacle, signal) in noted


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


def test_a_remembered_bias_comes_back_after_a_turn_from_the_first_sample_on(random):
    remembered = np.array([0.2, -0.1, 0.3]) * DEGREE
    turning = at_rest(random, 10, remembered + np.array([0.0, 0.0, 3.0]) * DEGREE)
    resting = at_rest(random, 10, remembered)
    filter_ = Filter()
    filter_.set_bias(remembered, (0.0087,) * 3)
    run(filter_, *turning)
    results = run(filter_, *resting, start=START + 10 * 10**9)
    np.testing.assert_allclose(results['bias'][400], remembered, atol=0.05 * DEGREE)


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


@pytest.mark.parametrize('name', ['static_adis16405', 'static_mpu6050_bursty'])
def test_the_mean_of_a_real_sensor_goes(name, real):
    stamps, rates, accelerations = real(name)
    out = Filter().run(stamps, rates, accelerations)['angular_velocity'][3000:]
    left, raw = out.mean(axis=0), rates[3000:].mean(axis=0)
    assert np.sqrt((left**2).mean()) < 0.01 * np.sqrt((raw**2).mean())


@pytest.mark.parametrize(
    'seed',
    [
        pytest.param(97, id='what ended a rest put later ones in doubt: off by 0.18 deg/s'),
        pytest.param(345, id='halves of a segment lie 4.6 deviations apart: off by 0.16'),
        pytest.param(88, id='a block varies 4.7 times as usual: off by 0.12'),
    ],
)
def test_no_short_rest_is_missed_by_chance(seed):
    """A bias that warms up, with a rest of 3 s a minute."""
    assert np.abs(warm_up(np.random.default_rng(seed), 100.0)).max() < 0.1


def test_garbage_is_forgotten(random):
    """Accelerations beyond all numbers, then rest: after five minutes the noise is learned anew."""
    rates, accelerations = at_rest(random, 400, (0.0, 0.0, 1.0 * DEGREE))
    accelerations[:800] *= 1e200
    results = run(Filter(), rates, accelerations)
    assert results['at_rest'][-1]
    assert results['bias'][-1, 2] == pytest.approx(1.0 * DEGREE, abs=0.03 * DEGREE)


def test_a_rest_that_begins_with_a_slow_turn(random):
    """The later half of the segment in which the turn ends is learned from at the rest's end."""
    truth = np.array([0.0, 0.3, 0.1]) * DEGREE
    for speed, rest in ((0.35, 3.2), (-0.35, 4.0), (0.4, 4.6)):
        spells = [(10, False), (5, True), (rest, False), (2, True)]
        rates, accelerations = moving_and_resting(random, spells, lambda time: truth)
        rates[1500:1625, 2] += speed * DEGREE
        results = run(Filter(), rates, accelerations)
        learned = np.flatnonzero(np.abs(np.diff(results['bias'], axis=0)).sum(axis=1) > 0)
        assert learned[-1] > 1800
        np.testing.assert_allclose(results['bias'][-1], truth, atol=0.06 * DEGREE)


def test_calibrate_without_stamps(random):
    filter_ = Filter(Parameters(sample_rate=100.0))
    rates, accelerations = at_rest(random, 20, (0.0, 0.0, 1.0 * DEGREE))
    filter_.run(np.zeros(len(rates), np.int64), rates, accelerations)
    filter_.calibrate()
    np.testing.assert_allclose(filter_.state['bias']['bias'][2], 1.0 * DEGREE, atol=0.05 * DEGREE)


@pytest.mark.parametrize('how', ['reset', 'gap'])
def test_a_new_rest_is_not_compared_with_one_of_another_time(how, random):
    """The sensor was tilted meanwhile, so that gravity is elsewhere, and the bias has moved."""
    filter_ = Filter()
    rates, accelerations = at_rest(random, 30)
    run(filter_, rates, accelerations)
    ratio = float(filter_.state['bias']['rest']['variance_ratio'])
    if how == 'reset':
        filter_.reset()
    results = run(
        filter_, rates[:600] + 1e-3, accelerations[:600, [2, 0, 1]], start=START + 3600 * 10**9
    )
    assert np.flatnonzero(results['at_rest'])[0] < 260
    assert filter_.state['bias']['rest']['variance_ratio'] < 1.3 * ratio


def driving(random, moves, rate, level=1.0):
    """Return rates and accelerations of a vehicle, on the road where `moves` (n,) is 1, not 0.

    It turns about the vertical, and the road shakes it, both at a level of 0 to 1.
    """
    n = len(moves)

    def shaking(lowest, highest):
        band = signal.butter(2, (lowest, highest), 'bandpass', fs=rate, output='sos')
        noise = signal.sosfiltfilt(band, random.standard_normal((n, 3)), axis=0)
        return moves[:, None] * noise / noise.std()

    turns = motion_below(0.2, random, n, rate)[:, 2] * moves
    rates = level * np.array([0.03, 0.03, 0.01]) * shaking(1.0, 12.0)
    rates[:, 2] += level * 0.5 * turns / turns.std()
    push = 0.6 * shaking(2.0, 20.0) + 0.3 * shaking(0.1, 0.5)
    return rates, np.array([0.0, 0.0, 9.81]) + level * push + 0.03 * random.standard_normal((n, 3))


def between(seconds, rate, spans):
    """Return (n,) from 0 to 1, which is 1 in the spans of time, and takes a second to change."""
    time = np.arange(round(seconds * rate)) / rate
    return np.max([np.clip(np.minimum(time - a, b - time), 0.0, 1.0) for a, b in spans], axis=0)


@pytest.mark.parametrize('rate', [50.0, 100.0])
def test_a_bias_that_was_learned_on_the_road_is_replaced_where_the_robot_stops(rate):
    """A smooth curve may pass for rest where there was none yet; what is far quieter shows it."""
    bias, fooled = np.array([0.02, -0.01, 0.015]), 0
    for seed in range(8):
        random = np.random.default_rng(seed)
        truth, accelerations = driving(random, between(100.0, rate, [(-2.0, 70.0)]), rate, 0.3)
        rates = truth + bias + 0.002 * random.standard_normal(truth.shape)
        results = run(Filter(Parameters()), rates, accelerations, rate)
        fooled += results['at_rest'][: round(69.0 * rate)].any()
        assert np.abs(results['bias'][round(80.0 * rate)] - bias).max() < 0.1 * DEGREE
    assert fooled >= 3


@pytest.mark.parametrize('rate', [50.0, 100.0])
@pytest.mark.parametrize('starts', ['at rest', 'on the road'])
def test_a_simulator_without_noise_learns_no_bias_on_the_road(starts, rate):
    """It measures a rest to the last bit, so that what varies is none."""
    first = 15.0 if starts == 'at rest' else -2.0
    for seed in range(8):
        random = np.random.default_rng(seed)
        moves = between(110.0, rate, [(first, 50.0), (65.0, 100.0)])
        rates, accelerations = driving(random, moves, rate, 0.3)
        accelerations[moves == 0.0] = 0.0, 0.0, 9.81
        results = run(Filter(Parameters()), rates, accelerations, rate)
        stood = round(65.0 * rate)
        assert np.abs(results['bias'][stood:]).max() < 0.05 * DEGREE
        turned = (results['angular_velocity'] - rates)[stood:].sum(axis=0) / rate
        assert np.abs(turned).max() < 2.0 * DEGREE
        assert starts == 'on the road' or not results['at_rest'].any()


def test_a_device_that_is_not_ready_keeps_the_bias_of_the_last_run(random):
    """Its rates are zeros, and its accelerometer gives one value."""
    filter_ = Filter()
    filter_.set_bias((0.01, -0.02, 0.03), (1e-4, 1e-4, 1e-4))
    n = 500
    run(filter_, np.zeros((n, 3)), np.tile((0.0, 0.0, 9.81), (n, 1)))
    np.testing.assert_allclose(filter_.state['bias']['bias'], (0.01, -0.02, 0.03), atol=1e-6)


@pytest.mark.parametrize('rate', [50.0, 100.0])
@pytest.mark.parametrize('band', ['dead', 'rounded'])
def test_a_driver_that_shows_no_noise_at_rest_learns_no_bias_on_the_road(band, rate):
    """Its rates come alive when the robot starts, which is no device that was not ready."""
    for seed in range(8):
        random = np.random.default_rng(seed)
        spans = [(15.0, 50.0), (65.0, 100.0)]
        truth, accelerations = driving(random, between(110.0, rate, spans), rate, 0.3)
        rates = truth + 0.002 + 0.0012 * random.standard_normal(truth.shape)
        given = np.where(np.abs(rates) < 0.01, 0.0, rates) if band == 'dead' else np.round(rates, 2)
        results = run(Filter(Parameters()), given, accelerations, rate)
        assert np.abs(results['bias'][-1]).max() < 0.3 * DEGREE
        turned = (results['angular_velocity'] - given).sum(axis=0) / rate
        assert np.abs(turned).max() < 20.0 * DEGREE
