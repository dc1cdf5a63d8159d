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

"""Slow turns and swings, told from a bias that jumps or warms up, and undone."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmark.bias import rolled, scanning, tilted, tilting, to_and_fro
from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.carried_gravity import TiltEvidence
from gyro_drift_filter.core.bias.swing import SWING, forget_swing, note_swing, variance_of_swing
from gyro_drift_filter.core.rest.records import (
    HALF,
    REST,
    REST_LENGTHS,
    SIGNALS,
)
from gyro_drift_filter.core.rest.stationarity import MEAN_DEVIATIONS
from support.messages import START
from support.rests import moving_and_resting, run
from support.sensor import DEGREE, at_rest, by_hand


@pytest.mark.slow
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


@pytest.mark.parametrize('below', [0.02, 0.05])
def test_a_turn_just_below_the_largest_bias_is_no_bias(below, random):
    """Some of its blocks lie above by noise, and counted as a faster turn in between."""
    speed = Parameters().bias_max - below * DEGREE
    parts = [at_rest(random, 10), at_rest(random, 80, (0.0, 0.0, speed))]
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][:, 2]).max() < 0.2 * DEGREE  # 9.97 before


@pytest.mark.slow
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


@pytest.mark.parametrize('speed', [1.0, 3.0, 5.0])
def test_a_turn_from_power_on_is_unlearned_by_a_quieter_stand(speed, random):
    """It was the bias for 90 s of rest, in which the heading lost up to 450 degrees."""
    bias = np.array([0.4, -0.7, 0.5]) * DEGREE
    turn = bias + np.array([0.0, 0.0, speed * DEGREE])
    parts = [shaken(random, 10, turn), at_rest(random, 50, bias), shaken(random, 20, turn)]
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    results = run(Filter(), rates, accelerations)
    np.testing.assert_allclose(results['bias'][800], turn, atol=0.2 * DEGREE)
    off = np.abs(results['bias'] - bias).max(axis=1)
    assert off[4500:].max() < 0.1 * DEGREE  # nor does the same turn bring it back


@pytest.mark.parametrize('speed', [1.0, 3.0, 5.0])
@pytest.mark.parametrize(('loud', 'quiet', 'lasts'), [(20, 0, 27), (3, 5, 60), (3, 20, 60)])
def test_a_turn_behind_the_noise_of_a_machine_is_no_bias(speed, loud, quiet, lasts, random):
    """It is as quiet as rest was when the machine had stopped, or does not last."""
    turn = (0.0, 0.0, speed * DEGREE)
    parts = [shaken(random, loud), at_rest(random, quiet), at_rest(random, lasts, turn)]
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][500:, 2]).max() < 0.2 * DEGREE


def shaken(random, seconds, rate=(0.0, 0.0, 0.0)):
    """Return rates and accelerations of a body that a machine shakes, evenly."""
    rates, accelerations = at_rest(random, seconds, rate)
    shake = random.standard_normal((len(rates), 3))
    return rates + 0.03 * shake, accelerations + 0.5 * shake


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


@pytest.mark.slow
@pytest.mark.parametrize(
    ('sector', 'fast', 'left'),
    [(100, -30, 1.0), (100, -30, 0.5), (60, -45, 1.0), (270, -40, 1.0), (120, 40, 1.0)],
)
def test_a_head_that_scans_slowly_and_turns_back_fast_shows_no_bias(sector, fast, left, random):
    """It has the same slow rate again and again, as a bias that has jumped has."""
    rates, accelerations = at_rest(random, 200.0)
    turn = scanning(sector * DEGREE, 5.0 * DEGREE, fast * DEGREE, 100.0)
    turn = np.roll(turn, -round((1.0 - left) * sector / 5.0 * 100))
    rates[1500:, 2] += np.resize(turn, len(rates) - 1500)
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][1500:, 2]).max() < 0.2 * DEGREE


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


@pytest.mark.parametrize(
    ('speed', 'seconds', 'stop'), [(4.0, 8.0, 2.0), (2.0, 10.0, 1.8), (3.0, 30.0, 2.5)]
)
def test_a_turn_that_stops_again_and_again_is_no_bias(speed, seconds, stop, random):
    """As of an indexing table: its turns were summed up, and taken for the bias after 90 s."""
    parts = [at_rest(random, 20)]
    for _ in range(round(200 / seconds)):
        parts += [at_rest(random, seconds, (0.0, 0.0, speed * DEGREE)), at_rest(random, stop)]
    rates, accelerations = (np.concatenate(part) for part in zip(*parts, strict=True))
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias']).max() < 0.1 * DEGREE


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


@pytest.mark.slow
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


@pytest.mark.slow
@pytest.mark.parametrize(('speed', 'period'), [(0.3, 6.0), (0.3, 10.0), (0.5, 20.0), (1.0, 40.0)])
def test_a_slow_swing_moves_the_bias_by_little(speed, period, random):
    """Where its rate is largest it passes for rest; it lost up to 20 deg of heading in 100 s."""
    lost = []
    for _ in range(5):
        moved, angle = to_and_fro(random, speed, period, 100.0)
        assert moved < 0.4 * speed
        lost.append(angle)
    assert np.median(lost) < 4.0


@pytest.mark.slow
@pytest.mark.parametrize(('size', 'period'), [(0.2, 8.0), (0.3, 14.0), (1.0, 30.0)])
def test_a_slow_roll_that_gravity_shows_is_no_bias(size, period, random):
    """Where its rate is largest it passed for rest; half of them lost more than 20 deg."""
    lost = [rolled(random, size, period, 100.0) for _ in range(5)]
    assert np.median(lost) < 4.0
    assert max(lost) < 8.0


@pytest.mark.slow
@pytest.mark.parametrize('speed', [0.2, 0.3])
def test_a_slow_tilt_that_gravity_shows_is_no_bias(speed, random):
    """Some 20 s after a rest the bias may have come to its rate; all lost more than 60 deg."""
    lost = [tilted(random, speed, 100.0, loud=True) for _ in range(5)]
    assert np.median(lost) < 4.0
    assert max(lost) < 8.0


@pytest.mark.slow
@pytest.mark.parametrize('seed', [26, 36, 42])
def test_a_rest_that_a_tilt_has_put_out_of_reach_is_found(seed):
    """By what was learned of it, for certain: 18 to 29 deg were lost."""
    assert tilted(np.random.default_rng(seed), 0.2, 100.0, loud=True) < 8.0


@pytest.mark.slow
def test_what_was_learned_of_a_tilt_is_taken_back(random):
    """Once gravity shows that it was one, to the last bit; its first seconds show nothing yet."""
    taken_back = 0
    for _ in range(5):
        rates, accelerations = tilting(random, 0.3, 100.0, loud=True)
        filter_, before, undecided = Filter(), None, False
        state = filter_.state['bias']
        for k in range(0, len(rates), 12):
            part, bias = slice(k, k + 12), state['bias'].copy()
            run(filter_, rates[part], accelerations[part], start=START + k * 10**7)
            if not undecided and state['carried']['undecided']:
                before = bias
            tilts = state['carried']['evidence'] == TiltEvidence.TILT
            if tilts and undecided and not state['carried']['undecided']:
                np.testing.assert_array_equal(state['bias'], before)
                taken_back += 1
            undecided = bool(state['carried']['undecided'])
    assert taken_back > 0


def leaning(random, stand, speed, seconds, after, noise=0.02):
    """Return rates and accelerations of a stand, a slow lean about x, and another stand, in s."""
    speeds = np.zeros(round(100 * (stand + seconds + after)))
    lean = slice(round(100 * stand), round(100 * (stand + seconds)))
    speeds[lean] = 2.0 * speed * DEGREE * np.hanning(round(100 * seconds))
    angle = np.cumsum(speeds) / 100
    rates, accelerations = at_rest(random, len(speeds) / 100)
    rates *= noise
    rates[:, 0] += speeds
    accelerations += 9.81 * np.column_stack([0 * angle, np.sin(angle), np.cos(angle) - 1])
    return rates, accelerations


@pytest.mark.slow
def test_a_stand_after_a_slow_lean_is_rest(random):
    """Where the bias was given a little wrong: what is too slow for gravity to show is no tilt."""
    for _ in range(6):
        rates, accelerations = leaning(random, 60, 0.05, 40, 200)
        filter_ = Filter()
        off = random.standard_normal(3)
        off *= 0.006 * DEGREE / np.linalg.norm(off)
        filter_.set_bias(off, np.full(3, (0.02 * DEGREE) ** 2))
        results = run(filter_, rates, accelerations)
        assert np.mean(results['at_rest'][10_500:] > 0.0) > 0.98


@pytest.mark.slow
def test_a_bias_that_jumped_in_motion_is_found_in_short_stops(random):
    """Each is too short for gravity to tell of a tilt: 1 deg/s stayed in for ever."""
    jump = np.array([0.3, -0.4, 0.8]) * DEGREE
    spells = [(20, False)] + 25 * [(15, True), (3.3, False)]
    rates, accelerations = moving_and_resting(
        random, spells, lambda time: np.outer(time > 100.0, jump)
    )
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][-1] - jump).max() < 0.03 * DEGREE


@pytest.mark.slow
def test_a_turn_about_the_vertical_after_a_stop_is_no_end_of_a_tilt(random):
    """A bias that warms up is apart from the one before, as if the body tilted in each stop."""
    truth, lost = np.array([0.3, -0.3, 0.2]) * DEGREE, []
    for _ in range(4):
        spells = [(20, False)] + 5 * [(40, True), (40, False)]
        rates, accelerations = moving_and_resting(random, spells, lambda time: np.zeros(3))
        rates *= 0.25
        for stop in range(6500, len(rates), 8000):
            rates[stop : stop + 3500, 2] += random.choice([-0.2, 0.2]) * DEGREE
        bias = truth * (1.0 - np.exp(-np.arange(len(rates)) / 30_000))[:, None]
        results = run(Filter(), rates + bias, accelerations)
        lost.append(np.abs(np.sum(results['bias'] - bias, axis=0)).max() / 100.0 / DEGREE)
    assert np.median(lost) < 20.0


@pytest.mark.slow
def test_a_tilt_takes_no_stop_back_that_came_before_it():
    """The stop is apart from the bias before, as that warms up, but has another rate than the tilt.

    Without it the tilt back was learned: 17 to 32 deg were lost in three of these runs.
    """
    lost = []
    for seed in range(8):
        random = np.random.default_rng(seed)
        rates, accelerations = moving_and_resting(
            random, [(20, False)] + 8 * [(50, True), (30, False)], lambda time: np.zeros(3)
        )
        rates *= 0.25
        speeds = np.zeros(len(rates))
        for stop in range(7000, len(rates), 8000):
            begin = stop + round(100 * random.uniform(4.5, 8.0))
            n = round(100 * random.uniform(3.0, 8.0))
            speed = random.uniform(0.1, 0.3) * DEGREE * random.choice([-1.0, 1.0])
            speeds[begin : begin + n] = speed
            speeds[begin + n : begin + 2 * n] = -speed
        rates[:, 0] += speeds
        angle = np.cumsum(speeds) / 100.0
        accelerations += 9.81 * np.column_stack([0 * angle, np.sin(angle), np.cos(angle) - 1])
        accelerations += 0.2 * random.standard_normal(accelerations.shape)
        warming = 1.0 - np.exp(-np.arange(len(rates)) / 30_000)
        bias = np.outer(warming, (0.3, -0.3, 0.2)) * DEGREE
        results = run(Filter(), rates + bias, accelerations)
        lost.append(np.abs(np.sum(results['bias'] - bias, axis=0)).max() / 100.0 / DEGREE)
    assert max(lost) < 16.0


@pytest.mark.slow
def test_a_stand_after_a_lean_is_found_where_the_bias_wanders(random):
    """Gravity has moved, but not at the rate that the bias has come to meanwhile."""
    for _ in range(6):
        rates, accelerations = leaning(random, 40, 0.2, 5, 40, noise=0.25)
        rates[:, 0] += np.linspace(0.0, 0.03, len(rates)) * DEGREE
        results = run(Filter(), rates, accelerations)
        assert np.mean(results['at_rest'][4800:] > 0.0) > 0.97


@pytest.mark.slow
def test_a_lean_after_a_hinted_stand_brings_no_earlier_bias_back(random):
    """Nothing that a robot has said to be rest is taken back for what came before it."""
    for _ in range(6):
        rates, accelerations = leaning(random, 60, 0.1, 40, 60)
        time = np.arange(len(rates)) / 100
        truth = 0.5 + 0.05 * np.sin(2.0 * np.pi * (time + random.uniform(0.0, 100.0)) / 100.0)
        rates[:, 0] += truth * DEGREE
        filter_ = Filter()
        for k in range(0, len(rates), 50):
            if k < 6000:
                filter_.hint(moves=False)
            part = slice(k, k + 50)
            run(filter_, rates[part], accelerations[part], start=START + k * 10**7)
            if k > 1000:
                error = filter_.state['bias']['bias'][0] / DEGREE - truth[part][-1]
                assert abs(error) < 0.15


@pytest.mark.slow
def test_a_sample_that_is_held_back_does_not_hide_a_slow_tilt(random):
    """As where the tilt turns back at once: most of these were learned."""
    speeds = 0.3 * DEGREE * np.repeat([0, 1, -1, 1, -1, 0], [2000, 3000, 3000, 3000, 3000, 500])
    angle = np.cumsum(speeds) / 100
    for _ in range(8):
        rates, accelerations = at_rest(random, len(speeds) / 100)
        rates *= 0.25
        rates[:, 0] += speeds
        accelerations += 9.81 * np.column_stack([0 * angle, np.sin(angle), np.cos(angle) - 1])
        accelerations += 0.1 * random.standard_normal(accelerations.shape)
        results = run(Filter(), rates, accelerations)
        assert np.abs(results['bias'][2000:]).max() < 0.1 * DEGREE


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


@pytest.mark.slow
def test_the_swing_is_measured_by_its_means(random):
    """Against the variance and the correlation of a sine."""
    rest, lengths, swing = (zeroed(kind)[0] for kind in (REST, REST_LENGTHS, SWING))
    rest['known'], noise, blocks = True, 1e-3, 16_000
    lengths['block'], lengths['block_seconds'] = 12, 0.125
    amplitude, period = 0.01, 20.0
    truth = amplitude * np.sin(2.0 * np.pi * 0.125 * np.arange(blocks) / period)
    values = noise * random.standard_normal((blocks, SIGNALS, 12))
    values[:, 0] += truth[:, None]
    sums, squares = values.sum(axis=2), np.square(values).sum(axis=2)
    signals = rest['signals']
    signals['variance'], signals['scatter'] = noise**2, noise**2 / 12
    rest['count'] = 12
    variances, steps = [], []
    for block in range(blocks):
        signals['sum'], signals['squares'] = sums[block], squares[block]
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


@pytest.mark.parametrize('speed', [0.5, 2.0, 5.0])
def test_a_turn_from_power_on_is_unlearned_at_the_first_rest(speed, random):
    """About the vertical, for a second and a half: nothing tells it from a bias before."""
    rates, accelerations = at_rest(random, 20, (0.0, 0.5 * DEGREE, 0.0))
    rates[:150, 2] += speed * DEGREE
    results = run(Filter(), rates, accelerations)
    assert np.abs(results['bias'][:150, 2]).max() < speed * DEGREE + 2e-3
    truth = (0.0, 0.5 * DEGREE, 0.0)
    np.testing.assert_allclose(results['bias'][500], truth, atol=0.2 * DEGREE)


def test_a_turn_learned_at_the_start_is_unlearned(random):
    """Two minutes of rest tell that it was none."""
    filter_ = Filter()
    run(filter_, *at_rest(random, 10, (0.0, 0.0, 5.0 * DEGREE)))
    assert filter_.state['bias']['bias'][2] == pytest.approx(5.0 * DEGREE, rel=0.05)
    run(filter_, *at_rest(random, 120), start=START + 10 * 10**9)
    assert abs(filter_.state['bias']['bias'][2]) < 0.05 * DEGREE


def test_a_remembered_bias_comes_back_after_a_turn_from_the_first_sample_on(random):
    remembered = np.array([0.2, -0.1, 0.3]) * DEGREE
    turning = at_rest(random, 10, remembered + np.array([0.0, 0.0, 3.0]) * DEGREE)
    resting = at_rest(random, 10, remembered)
    filter_ = Filter()
    filter_.set_bias(remembered, (0.0087,) * 3)
    run(filter_, *turning)
    results = run(filter_, *resting, start=START + 10 * 10**9)
    np.testing.assert_allclose(results['bias'][400], remembered, atol=0.05 * DEGREE)


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
