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

"""The verdict on a run of the filter: right where the truth is known, and in plain words."""

import json
import re
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.bags import replay_run
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.replay_run import Watch
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.doctor.live_rules import RuleLog
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.report.flagged import FlaggedLog
from gyro_drift_filter.report.held_back import HeldBack
from gyro_drift_filter.report.run_sums import REST_BLOCK_SECONDS, add_run, end_run, no_sums
from gyro_drift_filter.report.verdict import RunWatch
from gyro_drift_filter.report.wording import as_text, headline
from gyro_drift_filter.simulation.bag import TOPIC, imu_messages
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from gyro_drift_filter.simulation.sensor import START
from gyro_drift_filter.simulation.vehicles import VEHICLES, ride
from support.bags import write, write_imus
from support.chunks import filtered_imus
from support.handling import HandlingSettings, simulate_handling
from support.messages import even_stamps
from support.paths import RECORDINGS, recorded
from support.sensor import NOISE, at_rest, by_hand, motion_below, taking_off, turning_gravity

DEGREE = np.pi / 180


def bag(path, rates, accelerations, stamps=None):
    """Write a bag of Imu messages at 100 Hz."""
    if stamps is None:
        stamps = START + 10**7 * np.arange(len(rates))
    return write_imus(path, stamps, rates, accelerations)


def judged(source, folder, parameters=None, memory=None):
    """Return the verdict of a replay."""
    watches = []

    def watcher(topic, filter_):
        watches.append(RunWatch(filter_))
        return watches[-1]

    (summary,) = replay(
        source,
        folder / 'out',
        parameters=parameters or Parameters(),
        memory=memory,
        force=True,
        watch=Watch(watcher=watcher),
    )
    return watches[0].verdict(summary)


def of_samples(folder, rates, accelerations, stamps=None):
    """Return the verdict of a replay of these samples."""
    return judged(bag(folder / 'in', rates, accelerations, stamps), folder)


def of_simulation(data, folder):
    return of_samples(folder, data.angular_velocity, data.linear_acceleration, data.stamps)


def heading_drift(data):
    """Return the mean of the bias about the true vertical in rad/s."""
    seconds = np.diff(data.stamps, append=data.stamps[-1]) * 1e-9
    rotation, about = Rotation.identity(), 0.0
    for rate, step in zip(data.truth - data.bias, seconds, strict=True):
        about += data.bias @ rotation.inv().apply([0.0, 0.0, 1.0]) * step
        rotation = rotation * Rotation.from_rotvec(rate * step)
    return about / seconds.sum()


@pytest.mark.slow
def test_a_gap_without_messages_is_no_time_with_an_uncertain_bias(tmp_path, random):
    """What the bias may have become in ten minutes turned nothing that was recorded."""
    rates, accelerations = at_rest(random, 60, (0.0, 0.0, 3.0 * DEGREE))
    stamps = START + 10**7 * np.arange(len(rates))
    left = judged(bag(tmp_path / 'in', rates, accelerations, stamps), tmp_path).heading.left
    stamps[3000:] += 600 * 10**9
    verdict = judged(bag(tmp_path / 'gap', rates, accelerations, stamps), tmp_path)
    assert verdict.rests.count == 2
    assert left < verdict.heading.left < 8.0 * left
    assert verdict.seconds == pytest.approx(660, abs=0.1)
    assert verdict.sampled_seconds == pytest.approx(60, abs=0.1)
    text = ' '.join(as_text(verdict).split())
    assert re.search(r'it stood still for 5\d of 60 s, in 2 rests', text)
    assert 'with its pauses the recording lasts for 660 s' in text
    assert re.search(r'gap_limit \(1 time; for [12] of 6[012] s, first at 30 s\)', text)


@pytest.mark.slow
def test_a_slow_sensor_is_told_that_short_rests_are_passed_over(tmp_path, random):
    """At 4 Hz a rest takes 36 s, so that one of 24 s behind a turn is not found."""
    rates, accelerations = at_rest(random, 120, rate=4)
    rates[240:384, 2] += 0.3 * np.sin(np.arange(144) / 4.0)
    stamps = START + 250_000_000 * np.arange(len(rates))
    verdict = of_samples(tmp_path, rates, accelerations, stamps)
    assert verdict.rests.count == 1
    text = ' '.join(as_text(verdict).split())
    assert 'At 4 Hz rests of less than 36 s may be passed over' in text
    rates, accelerations = at_rest(random, 20)
    assert 'passed over' not in as_text(of_samples(tmp_path / 'fast', rates, accelerations))


def test_a_slow_sensor_is_recorded_all_the_time(random):
    """Of one message in five seconds, too, each report is about five seconds."""
    log, filter_, health = RuleLog(), MessageFilter(Parameters()), Health()
    rates, accelerations = at_rest(random, 100, rate=0.2)
    stamps = START + 5 * 10**9 * np.arange(len(rates))
    for _, data in imu_messages(stamps, rates, accelerations):
        filter_.take(data)
        span, of_input, _ = health.rules(filter_.report(), 5.0)
        log.judge(span, of_input, 5.0)
    assert log.judged_seconds == pytest.approx(100.0, abs=10.0)


def test_a_clock_that_is_set_adds_no_time(tmp_path, random):
    rates, accelerations = at_rest(random, 20, rate=20)
    stamps = START + 50_000_000 * np.arange(len(rates))
    stamps[200:] += 3600 * 10**9
    text = ' '.join(as_text(of_samples(tmp_path, rates, accelerations, stamps)).split())
    assert '(1 time; for 1 of 20 s, first at 10 s)' in text
    # It tells why the drift is told to be more uncertain than the bias at the end.
    assert 'From there to the next rest the bias is uncertain' in text


@pytest.mark.parametrize('apart', [0.0, 0.03])
def test_two_sensors_that_take_turns_are_not_sound(apart, tmp_path, random):
    """The filter learns the mean of both, and makes both quieter."""
    rates, accelerations = at_rest(random, 60)
    rates[1::2, 0] += apart
    verdict = of_samples(tmp_path, rates, accelerations)
    text = ' '.join(as_text(verdict).split())
    assert ('two sensors or drivers take turns on the topic' in text) == (apart > 0.0)


@pytest.mark.slow
@pytest.mark.parametrize(('hertz', 'is_told'), [(0.3, False), (5.0, True)])
def test_a_robot_that_turns_on_a_smooth_floor_is_no_stand_without_a_rest(
    hertz, is_told, tmp_path, random
):
    """Gravity stands beside a loose mount, too, but no bias wanders by more than its limit."""
    rates, accelerations = at_rest(random, 200, rate=50)
    turns = motion_below(hertz, random, 9500, 50)
    rates[500:] += 0.3 * turns / turns.std()
    stamps = START + 20_000_000 * np.arange(len(rates))
    verdict = of_samples(tmp_path, rates, accelerations, stamps)
    assert ('no rest' in [finding.name for finding in verdict.findings]) == is_told


def test_log_times_that_stand_contradict_nothing(tmp_path, random):
    rates, accelerations = at_rest(random, 60, (0.0, 0.0, 3.0 * DEGREE))
    rates[[1000, 2000, 3000], 0] += 100.0 * DEGREE
    stamps = START + 10**7 * np.arange(len(rates))
    messages = [(START, data) for _, data in imu_messages(stamps, rates, accelerations)]
    verdict = judged(write(tmp_path / 'in', {(TOPIC, IMU_TYPE): messages}), tmp_path)
    assert verdict.seconds == pytest.approx(60, abs=0.1)
    assert verdict.bias.known_at is None
    text = ' '.join(as_text(verdict).split())
    assert re.search(r'it stood still for 5\d of 60 s, in 1 rest', text)
    assert 'pauses' not in text
    assert 'deg/s, found at rest; at the end known to' in text
    assert '3 samples flagged as outliers (x 3, y 0, z 0), 3 of them at rest' in text
    assert 'from 0.0' not in text


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('kind', ['level', 'turned', 'handled'])
def test_the_drift_of_the_heading_is_that_of_the_truth(kind, seed, tmp_path):
    if kind == 'level':
        # Gravity stays on z there, whatever the rates are.
        data = simulate(SimulationSettings(seed=seed, static_seconds=15, dynamic_seconds=15))
        noise = 0.02 * np.random.default_rng(seed).standard_normal((len(data.stamps), 3))
        data = replace(data, linear_acceleration=np.array([0.0, 0.0, 9.80665]) + noise)
        truth = data.bias[2]
    elif kind == 'turned':
        settings = SimulationSettings(seed=seed, static_seconds=15, dynamic_seconds=15)
        data = simulate(replace(settings, bias=(0.01, -0.02, 0.03)))
        truth = heading_drift(data)
    else:
        bias = (0.03, -0.02, 0.04)
        data = simulate_handling(HandlingSettings(seed=seed, motions=1, bias=bias))
        truth = heading_drift(data)
    verdict = of_simulation(data, tmp_path)
    heading = verdict.heading
    assert heading.raw == pytest.approx(truth, rel=0.25)
    assert abs(heading.raw - truth) < 3.0 * heading.left
    assert heading.left < 0.25 * abs(truth)
    assert (np.abs(verdict.bias.rates - data.bias) < 3.5 * verdict.bias.deviations).all()
    turned = np.linalg.norm(data.truth - data.bias, axis=1).sum() * 0.01
    assert heading.turned == pytest.approx(turned, rel=0.1)
    assert verdict.outcome == 'helped'


def test_the_bias_counts_from_before_it_was_known(tmp_path, random):
    rates, accelerations = at_rest(random, 10, (0.0, 0.0, 3.0 * DEGREE))
    verdict = of_samples(tmp_path, rates, accelerations)
    known = verdict.bias.known_at
    assert 2.0 < known < 4.0
    assert verdict.heading.raw == pytest.approx(3.0 * DEGREE, rel=0.02)
    assert 0.0 < verdict.heading.before < 3.0 * DEGREE * known + 1e-3
    text = ' '.join(as_text(verdict).split())
    assert 'found at rest after' in text
    # A bias that is smaller than its deviation would else seem to grow by the filter.
    assert re.search(r'raw rates drift by 180 \+- .* the filtered ones by 0 \+- ', text)
    assert re.search(r'after a turn of \d\.\d deg while the bias was not known', text)


@pytest.mark.slow
def test_the_drift_is_judged_from_when_the_bias_was_known_however_a_bag_is_cut(
    tmp_path, random, monkeypatch
):
    """Reports before the first rest counted unless that lay in the same part of the bag."""
    rates, accelerations = at_rest(random, 40, (0.0, 0.0, 0.5 * DEGREE))
    turn, push = by_hand(random, 20)
    rates[:2000] += turn
    accelerations[:2000] += push
    source, left = bag(tmp_path / 'in', rates, accelerations), []
    for part in (100_000, 700, 100):
        monkeypatch.setattr(replay_run, '_PART', part)
        verdict = judged(source, tmp_path)
        left.append(verdict.heading.left)
        assert verdict.bias.known_at > 20.0
    assert left[0] < 0.05 * DEGREE
    assert left == pytest.approx([left[0]] * 3, rel=1e-3)
    assert 'the bias turns the heading by some 1.2 deg/min instead of 31' in headline(verdict)


def test_noise_is_that_of_each_rest_without_its_last_second(tmp_path, random):
    """A motion that begins gently, and a bias that moves between rests, are no noise."""
    parts = [at_rest(random, 10, (0.0, 0.0, b)) for b in (0.0, 5e-4)]
    turn, push = by_hand(random, 5)
    moved = at_rest(random, 5)
    rates = np.vstack([parts[0][0], moved[0] + turn, parts[1][0]])
    accelerations = np.vstack([parts[0][1], moved[1] + push, parts[1][1]])
    verdict = of_samples(tmp_path, rates, accelerations)
    expected = np.vstack([part[0][200:] - part[0][200:].mean(0) for part in parts]).std(axis=0)
    np.testing.assert_allclose(verdict.rests.raw_deviation, expected, rtol=0.05)
    assert verdict.rests.count >= 2
    assert (verdict.rests.ratio < 0.5).all()
    assert 13.0 < verdict.rests.seconds < 18.0


@pytest.mark.slow
def test_a_sensor_that_is_picked_up_at_the_end_is_as_quiet_as_before(tmp_path, random):
    """Of its own motion 80 ms come before the recording ends, too few to end the rest."""
    rates, accelerations = at_rest(random, 60)
    lifted = rates.copy(), accelerations.copy()
    lifted[0][-8:, 0] += np.radians(60) * np.arange(1, 9) / 8
    lifted[1][-8:, 1] += 0.3 * np.arange(1, 9)
    expected = of_samples(tmp_path / 'still', rates, accelerations).rests
    rests = of_samples(tmp_path / 'lifted', *lifted).rests
    np.testing.assert_allclose(rests.raw_deviation, expected.raw_deviation, rtol=0.01)
    np.testing.assert_allclose(rests.ratio, expected.ratio, rtol=0.01)


@pytest.mark.slow
def test_a_rest_of_a_moment_tells_no_noise(tmp_path, random):
    """Half of it may be motion already, so nothing is said of noise: not that there is none."""
    verdict = of_samples(tmp_path, *at_rest(random, 4))
    assert verdict.rests.count == 1
    assert np.isnan(verdict.rests.ratio).all()
    assert 'too short to tell the noise' in as_text(verdict)
    assert verdict.outcome == 'useless'
    assert 'there is hardly any noise' not in headline(verdict)
    assert 'the rest was too short to tell the noise' in headline(verdict)


@pytest.mark.slow
def test_a_rest_without_any_noise_is_not_called_short(tmp_path, random):
    """Where the counts are so coarse that they never change at rest."""
    turn, push = by_hand(random, 6)
    rates, accelerations = at_rest(random, 20)
    rates[:] = 0.0
    rates[1400:] += turn
    accelerations[1400:] += push
    verdict = of_samples(tmp_path, rates, accelerations)
    assert verdict.rests.seconds > 5.0
    assert 'there is no noise' in as_text(verdict)
    assert 'there is hardly any noise at rest to take away' in ' '.join(headline(verdict).split())


@pytest.mark.slow
@pytest.mark.parametrize('rate', [50, 100, 1000])
def test_noise_falls_by_as_much_in_short_rests_as_in_a_long_one(rate, tmp_path, random):
    """What a smoothed rate is off by for longer than a rest is in the mean of that rest."""
    stamps = START + 10**9 // rate * np.arange(60 * rate)
    rates, accelerations = at_rest(random, 60, rate=rate)
    expected = of_samples(tmp_path / 'long', rates, accelerations, stamps).rests.ratio
    turn, push = by_hand(random, 2, rate)
    for k in range(5 * rate, 60 * rate, 7 * rate):
        moved = slice(k, k + 2 * rate)
        rates[moved] += turn[: len(rates[moved])]
        accelerations[moved] += push[: len(rates[moved])]
    rests = of_samples(tmp_path / 'short', rates, accelerations, stamps).rests
    assert rests.count >= 8
    assert rests.samples < 20 * rate
    np.testing.assert_allclose(rests.ratio, expected, rtol=0.4)


def test_it_stands_still_no_longer_than_it_is_recorded_where_stamps_come_in_batches(
    tmp_path, random
):
    """A driver that empties a buffer of ten samples and stamps them once."""
    rates, accelerations = at_rest(random, 30, (0.0, 0.0, 0.01))
    even = START + 10**7 * np.arange(len(rates))
    verdict = of_samples(tmp_path, rates, accelerations, np.repeat(even[9::10], 10))
    assert 26.0 < verdict.rests.seconds <= verdict.seconds


def unstamped(path, stamp_scale, rate=20, parameters=None):
    """Write and judge a bag that rests for 40 of 60 s, and turns by 1 rad/s between.

    Its log times are right, and its stamps are the time since the first message on a scale.
    """
    random = np.random.default_rng(0)
    rates, accelerations = at_rest(random, 60, rate=rate)
    rates[20 * rate : 40 * rate, 2] += 1.0
    accelerations[20 * rate : 40 * rate] += 0.5 * random.standard_normal((20 * rate, 3))
    log_times = START + 10**9 // rate * np.arange(len(rates))
    stamps = ((log_times - START) * stamp_scale).astype(np.int64)
    stamped = imu_messages(stamps, rates, accelerations)
    messages = [(int(time), data) for time, (_, data) in zip(log_times, stamped, strict=True)]
    return judged(write(path / 'in', {(TOPIC, IMU_TYPE): messages}), path, parameters)


@pytest.mark.parametrize(
    'stamp_scale', [pytest.param(0.0, id='zero'), pytest.param(1e-3, id='in microseconds')]
)
def test_time_is_that_of_the_log_where_stamps_tell_none(stamp_scale, tmp_path):
    verdict = unstamped(tmp_path, stamp_scale)
    assert verdict.period == pytest.approx(0.05, rel=1e-3)
    # At the 100 Hz that the filter assumes it takes five times as long to find a rest.
    assert verdict.rests.needed == 12
    assert 12.0 < verdict.rests.seconds < 41.0
    assert verdict.heading.turned == pytest.approx(20.0, rel=0.1)


def test_a_rate_that_was_given_counts_where_stamps_tell_none(tmp_path):
    verdict = unstamped(tmp_path, 0.0, parameters=Parameters(sample_rate=40.0))
    assert verdict.period == pytest.approx(0.025)
    assert verdict.heading.turned == pytest.approx(10.0, rel=0.1)


def filtered(rates, accelerations):
    """Return the stamps of samples at 100 Hz, and their messages with the filter's results."""
    stamps = START + 10**7 * np.arange(len(rates))
    return stamps, filtered_imus(Filter(), stamps, rates, accelerations)


def test_the_sums_are_those_of_plain_arrays_however_they_are_cut(random):
    parts = [at_rest(random, 8), by_hand(random, 4), at_rest(random, 6)]
    rates, accelerations = (np.vstack(column) for column in zip(*parts, strict=True))
    accelerations[800:1200] += [0.0, 0.0, 9.8]
    rates[1500, 1] += 1.0
    stamps, imus = filtered(rates, accelerations)
    results, matrix = imus['result'], np.eye(3).ravel()
    both = []
    for cuts in ([0, len(imus)], [0, 1, 333, 334, 901, len(imus)]):
        sums = no_sums()
        sums['times']['period'], sums['times']['longest'] = 0.01, 1.0
        for first, stop in pairwise(cuts):
            add_run(imus[first:stop], stamps[first:stop], matrix, sums)
        end_run(sums)
        both.append(sums)
    assert both[0].tobytes() == both[1].tobytes()
    got = both[0][0]
    resting = results['at_rest'] > 0.0
    up = accelerations / np.linalg.norm(accelerations, axis=1)[:, None]
    assert got['samples'] == len(rates)
    assert got['rest_seconds'] == pytest.approx(0.01 * resting.sum())
    np.testing.assert_allclose(got['up_seconds'], 0.01 * up.sum(axis=0), rtol=1e-9)
    assert got['taken'] == pytest.approx(0.01 * (up * results['bias']).sum(), rel=1e-9)
    changed = results['angular_velocity'] + results['bias'] - rates
    changed = changed[~resting & ~(results['outlier'] > 0.0).any(axis=1)]
    np.testing.assert_allclose(got['changed'], (changed**2).sum(axis=0), rtol=1e-9)
    assert got['outliers']['at_rest'] == (resting & (results['outlier'] > 0).any(axis=1)).sum()
    squares, block = np.zeros(3), round(REST_BLOCK_SECONDS / 0.01)
    edges = np.flatnonzero(np.diff(np.r_[0, resting, 0]))
    for first, stop in edges.reshape(-1, 2):
        # What was flagged is no noise.
        of_rest = rates[first:stop][~(results['outlier'][first:stop] > 0.0).any(axis=1)]
        # What is kept of a rest: whole blocks but the last one.
        of_rest = of_rest[: max(len(of_rest) // block - 1, 0) * block]
        squares += of_rest.var(axis=0) * len(of_rest) if len(of_rest) else 0.0
    np.testing.assert_allclose(got['noise']['raw_squares'], squares, rtol=1e-6)


def test_an_acceleration_that_the_filter_does_not_use_is_no_gravity(random):
    rates, accelerations = at_rest(random, 2)
    accelerations[:], accelerations[100] = [0.0, 0.0, 9.8], [1e5, 0.0, 0.0]
    stamps, imus = filtered(rates, accelerations)
    sums = no_sums()
    sums['times']['period'], sums['times']['longest'] = 0.01, 1.0
    add_run(imus, stamps, np.eye(3).ravel(), sums)
    np.testing.assert_allclose(sums[0]['up_seconds'], [0.0, 0.0, 2.0], rtol=1e-9)


def test_a_recording_without_rest_is_told_to_gain_nothing(tmp_path, random):
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 12)
    verdict = of_samples(tmp_path, rates + turn, accelerations + push)
    assert (verdict.outcome, verdict.gains) == ('useless', [])
    text = as_text(verdict)
    assert text.startswith('This filter did nothing useful here: the sensor never stood still')
    assert 'Let it stand still for ten seconds' in text
    assert 'the filter can not tell' in text
    assert verdict.bias.source == 'unknown'


def test_a_recording_that_is_too_short_for_a_rest_is_not_said_to_move(tmp_path, random):
    rates, accelerations = at_rest(random, 0.02)
    text = ' '.join(as_text(of_samples(tmp_path, rates, accelerations)).split())
    assert text.startswith(
        'This filter did nothing useful here: the recording of 0.02 s is too short for a rest of 3'
    )
    assert 'rest none: the recording of 0.02 s is too short' in text
    assert 'stood still for' not in text


def test_one_message_has_no_rate(tmp_path, random, capsys):
    rates, accelerations = at_rest(random, 0.01)
    source = bag(tmp_path / 'in', rates, accelerations)
    assert main(['replay', str(source), '-o', str(tmp_path / 'out')]) == 0
    text = ' '.join(capsys.readouterr().out.split())
    assert '1 message, 1 written, too short to know the rate This filter did' in text
    assert text.count('one message is too short a recording for a rest of 3 s') == 2
    main(['doctor', str(source)])
    text = ' '.join(capsys.readouterr().out.split())
    assert 'messages: 1 message, all whole' in text
    assert 'rests: one message is too short a recording for a rest of 3 s' in text


def test_a_recording_that_is_long_enough_for_a_rest_is_not_said_to_be_too_short(tmp_path, random):
    """A rest takes less than the three seconds that are told."""
    turn, push = by_hand(random, 2.9)
    rates, accelerations = at_rest(random, 2.9)
    text = as_text(of_samples(tmp_path, rates + turn, accelerations + push))
    assert 'the sensor never stood still for 3 s' in ' '.join(text.split())


def test_why_there_was_no_rest_is_the_same_for_replay_and_doctor(tmp_path, random, capsys):
    """A rest takes more than the 14 s that there are."""
    rates, accelerations = at_rest(random, 14, rate=10.0)
    stamps = START + 10**8 * np.arange(len(rates))
    text = ' '.join(as_text(of_samples(tmp_path, rates, accelerations, stamps)).split())
    why = 'the recording of 14 s is too short for a rest of 15 s'
    assert f'rest none: {why}' in text
    main(['doctor', str(tmp_path / 'in')])
    assert f'rests: {why}' in capsys.readouterr().out


def test_motion_in_degrees_is_not_said_to_be_outliers(tmp_path, random):
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 12)
    spikes = (np.arange(len(rates)) % 100 == 50)[:, None] * 300.0
    verdict = of_samples(tmp_path, np.degrees(rates + turn) + spikes, accelerations + push)
    assert verdict.outliers.samples
    assert (verdict.outcome, verdict.gains) == ('useless', [])
    text = ' '.join(as_text(verdict).split())
    assert text.startswith(
        'This filter did nothing useful here: the driver may publish degrees per second where '
        'REP-103 asks for radians.'
    )
    assert 'flagged as outliers' in text


@pytest.mark.slow
@pytest.mark.parametrize(('period', 'every_other'), [(2.0, 0.01), (0.01, 3.0)])
def test_stamps_beyond_gap_limit_are_no_lack_of_stillness(period, every_other, tmp_path, random):
    """It was told to stand still, which it did: a slow sensor, and the clocks of two drivers."""
    rates, accelerations = at_rest(random, 12)
    index = np.arange(len(rates))
    stamps = START + (1e9 * (period * index + every_other * (index % 2))).astype(np.int64)
    logged = START + (1e9 * period * index).astype(np.int64)
    sent = imu_messages(stamps, rates, accelerations)
    rows = [(time, data) for time, (_, data) in zip(logged.tolist(), sent, strict=True)]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): rows})
    told = ' '.join(as_text(judged(source, tmp_path)).split())
    why = 'the filter starts anew all the time, as stamps lie gap_limit or more apart'
    assert told.startswith(f'This filter did nothing useful here: {why}, so there was no rest')
    assert f'rest none: {why} bias' in told
    assert 'still' not in told


def test_a_rate_beyond_the_largest_bias_is_no_lack_of_stillness(tmp_path, random):
    rates, accelerations = at_rest(random, 12, (0.0, 0.0, 1.0))
    verdict = of_samples(tmp_path, rates, accelerations)
    text = as_text(verdict)
    assert text.startswith(
        'This filter did nothing useful here: while the sensor was steady, its rate was beyond '
        'bias.max'
    )
    assert 'are the rates in deg/s' in text
    assert 'stood still' not in text


@pytest.mark.slow
def test_a_bias_that_moved_is_said_to_be_that_of_the_end(tmp_path, random):
    """It was told as that of the recording; one that stands is."""
    rates, accelerations = at_rest(random, 90)
    still = of_samples(tmp_path, rates, accelerations)
    assert not still.bias.moved.any()
    assert 'deg/s, found at rest after' in ' '.join(as_text(still).split())
    rates[:, 2] += np.linspace(0.0, 0.5 * DEGREE, len(rates))
    moved = judged(bag(tmp_path / 'moved', rates, accelerations), tmp_path)
    np.testing.assert_allclose(moved.bias.moved, [0.0, 0.0, 0.5 * DEGREE], rtol=0.2)
    text = ' '.join(as_text(moved).split())
    assert re.search(r'deg/s at the end, after moves of up to 0\.[45]\d? deg/s, found at', text)


def test_calibration_is_recommended_until_there_is_one(tmp_path, random):
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 24)
    half = len(turn)
    source = bag(
        tmp_path / 'in',
        rates + np.vstack([np.zeros((len(rates) - half, 3)), turn]),
        accelerations + np.vstack([np.zeros((len(rates) - half, 3)), push]),
    )
    found = Parameters(calibration_matrix=(1.01, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.99))
    for parameters, recommended in ((None, True), (found, False)):
        text = as_text(judged(source, tmp_path, parameters))
        assert ("'gyro_drift calibrate'" in text) == recommended


def test_calibration_is_recommended_after_a_day_as_after_a_minute(tmp_path, random):
    """What is left of the bias is another error after each rest, but counted as one of the day."""
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 24)
    half = len(turn)
    rates[half:] += turn
    accelerations[half:] += push
    verdict = of_samples(tmp_path, rates, accelerations)
    rests = replace(verdict.rests, count=400)
    for left, recommended in ((0.8, True), (8.0, False)):
        of_all = left * 0.01 * verdict.heading.turned / verdict.sampled_seconds
        day = replace(verdict, rests=rests, heading=replace(verdict.heading, left=of_all))
        assert ("'gyro_drift calibrate'" in as_text(day)) == recommended


def test_a_provisional_bias_is_that_of_this_recording_not_of_the_one_before(tmp_path, random):
    for name in ('first', 'second'):
        flight = bag(tmp_path / name, *taking_off(random, 20, (0.0, 0.02, 0.08)))
        verdict = judged(flight, tmp_path, memory=tmp_path / 'bias.json')
        assert verdict.bias.source == 'provisional'


def test_a_bias_from_less_than_rest_is_called_provisional(tmp_path, random):
    """As of a drone that idles, and then flies."""
    flight = taking_off(random, 20, (0.0, 0.02, 0.08))
    verdict = of_samples(tmp_path, *flight)
    assert verdict.bias.source == 'provisional'
    assert 'provisional: x' in as_text(verdict)
    np.testing.assert_allclose(verdict.bias.rates, (0.0, 0.02, 0.08), atol=6e-3)


@pytest.mark.slow
def test_a_bias_is_known_as_well_as_coarse_counts_show_it(tmp_path, random):
    """Noise of a tenth of a count leaves up to a half of one in the mean of a rest."""
    count, bias = DEGREE / 8.0, np.array([3.3, -4.8, 4.2])
    _, accelerations = at_rest(random, 60)
    counts = np.round(0.12 * random.standard_normal(accelerations.shape) + bias)
    verdict = of_samples(tmp_path, count * counts, accelerations)
    assert (np.abs(verdict.bias.rates - count * bias) < 2.0 * verdict.bias.deviations).all()
    assert (verdict.bias.deviations > 0.2 * count).all()


def test_a_bias_that_only_motion_has_shown_is_told_with_what_it_lacks(tmp_path):
    walk = ride(VEHICLES['legged'], 3, 70.0, 100.0, 0.0, 0.0)
    walks = slice(1000, 5500)
    bias = np.array([0.03, -0.03, 0.0])
    rates = walk.rates[walks] + bias
    source = bag(tmp_path / 'in', rates, walk.accelerations[walks], walk.stamps[walks])
    verdict = judged(source, tmp_path)
    text = as_text(verdict)
    assert (verdict.bias.source, verdict.gains) == ('motion', ['bias'])
    assert headline(verdict) == 'It helped: what gravity shows of the bias is subtracted.'
    assert 'as gravity has shown in motion' in text
    assert 'of which motion shows little' in ' '.join(text.split())
    np.testing.assert_allclose(verdict.bias.rates, bias, atol=6e-3)
    assert verdict.bias.deviations[2] > 3.0 * verdict.bias.deviations[:2].max()


@pytest.mark.slow
@pytest.mark.parametrize('enabled', [True, False])
def test_a_bias_that_is_subtracted_unsurely_is_neither_a_help_nor_nothing(
    enabled, tmp_path, random
):
    """As on a ship in a swell, where gravity shows it to a third of a degree per second."""
    time = np.arange(12000) / 100.0
    sizes, periods = np.array([0.08, 0.035, 0.005]), np.array([8.0, 6.3, 23.0])
    truth = sizes * np.sin(2.0 * np.pi * time[:, None] / periods + [0.0, 1.0, 2.0])
    bias = np.array([0.4, -0.6, 0.5]) * DEGREE
    rates = truth + bias + NOISE * random.standard_normal(truth.shape)
    forces = turning_gravity(truth, 100.0) + 0.05 * random.standard_normal(truth.shape)
    source = bag(tmp_path / 'in', rates, forces)
    verdict = judged(source, tmp_path, Parameters(bias_enabled=enabled))
    assert (verdict.rests.count, verdict.gains) == (0, [])
    if not enabled:
        assert verdict.outcome == 'useless'
        return
    assert (verdict.outcome, verdict.bias.source) == ('unsure', 'motion')
    left = np.abs(verdict.bias.rates - bias)
    assert (left[:2] < 0.3 * np.abs(bias[:2])).all()
    assert (left < verdict.bias.deviations).all()
    assert re.fullmatch(
        'This filter can not tell whether it helped: it subtracts a bias of x [0-9.]+, y -[0-9.]+, '
        'z [-0-9.]+ deg/s, as gravity has shown it in motion, and knows it to x 0.[0-9]+, '
        'y 0.[0-9]+, z 2.3 deg/s only. Let it stand still for ten seconds at the start; if it did, '
        "'gyro_drift doctor' looks closer.",
        headline(verdict),
    )


def test_a_dead_gyroscope_is_told_as_that_beside_a_kept_bias(tmp_path, random):
    memory, small = tmp_path / 'bias.json', (0.007, -0.01, 0.008)
    judged(bag(tmp_path / 'first', *at_rest(random, 20, small)), tmp_path, memory=memory)
    forces = 2.0 * random.standard_normal((2000, 3)) + [0.0, 0.0, 9.8]
    later = even_stamps(2000, start=START + 3600 * 10**9)
    dead = bag(tmp_path / 'dead', np.tile((5e-3, -8e-3, 6e-3), (2000, 1)), forces, later)
    verdict = judged(dead, tmp_path, memory=memory)
    assert (verdict.bias.source, verdict.outcome) == ('given', 'useless')
    assert 'all three axes are dead' in headline(verdict)


@pytest.mark.slow
@pytest.mark.parametrize('times', [1, 4])
def test_a_bias_beyond_its_limit_is_told_with_what_the_rests_show(times, tmp_path, random):
    """It was said to be anything up to 2.3 deg/s, and gravity to contradict the axes."""
    bias = np.array([11.0, -15.0, 12.0]) * DEGREE
    parts = []
    for _ in range(times):
        turn, push = by_hand(random, 15)
        noise, gravity = at_rest(random, 15)
        parts += [at_rest(random, 25), (noise + turn, gravity + push)]
    rates, accelerations = (np.vstack(part) for part in zip(*parts, strict=True))
    verdict = of_samples(tmp_path, rates + bias, accelerations)
    text = ' '.join(as_text(verdict).split())
    assert verdict.bias.source == 'unknown'
    np.testing.assert_allclose(verdict.bias.beyond_max, bias, atol=0.1 * DEGREE)
    assert re.search(r'its rates were x 11(\.\d)?, y -15(\.\d)?, z 12(\.\d)? deg/s, beyond', text)
    assert re.search(r'heading drifts by up to 13\d\d deg/min, if it did not turn there', text)
    assert [finding.name for finding in verdict.findings] == ['beyond bias.max']


@pytest.mark.slow
def test_a_filter_that_lags_is_told_to_do_harm(tmp_path, random):
    rest, (turn, push) = at_rest(random, 30), by_hand(random, 25)
    rates, accelerations = rest[0], rest[1]
    rates[500:] += turn
    accelerations[500:] += push
    source = bag(tmp_path / 'in', rates, accelerations)
    verdict = judged(source, tmp_path, Parameters(method='kalman'))
    assert verdict.outcome == 'harmed'
    assert 'Take the default method, adaptive' in headline(verdict)
    assert 'nothing unsound' not in as_text(verdict)
    assert judged(source, tmp_path).outcome == 'helped'


@pytest.mark.slow
@pytest.mark.parametrize('method', ['kalman', 'sage_husa'])
def test_a_filter_that_takes_motion_for_outliers_is_told_to_do_harm(method, tmp_path, random):
    """As of a robot that drives about: it is held back, so that innovations are hardly large."""
    rates, accelerations = at_rest(random, 130, (0.014, -0.021, 0.026))
    turn = motion_below(0.5, random, 11_000, 100)[:, 2]
    rates[1500:12500, 2] += 0.5 * turn / turn.std() * np.hanning(11_000) ** 0.1
    source = bag(tmp_path / 'in', rates, accelerations)
    verdict = judged(source, tmp_path, Parameters(method=method))
    assert verdict.lagging < 0.15
    assert verdict.held_back > 0.05
    assert verdict.outcome == 'harmed'
    assert re.search(
        rf'harm here: method {method} .*takes \d+ % of the motion for outliers. Take the default',
        headline(verdict),
    )
    # What it flags says nothing of the recording, nor what gravity makes of its rates.
    assert not {'outliers', 'diverged', 'contradicts gravity'} & {
        finding.name for finding in verdict.findings
    }
    sound = judged(source, tmp_path)
    assert (sound.outcome, sound.held_back) == ('helped', 0.0)


@pytest.mark.parametrize('length', [1, 3, 10])
def test_many_spikes_are_no_motion_that_is_held_back(length, tmp_path, random):
    """However many they are: a row of them is over soon."""
    rates, accelerations = at_rest(random, 60)
    turn, push = by_hand(random, 40)
    rates[1500:5500] += turn
    accelerations[1500:5500] += push
    for k in np.flatnonzero(random.random(len(rates)) < 0.1 / length):
        rates[k : k + length, 2] += random.choice((-15.0, 15.0))
    verdict = of_samples(tmp_path, rates, accelerations)
    assert verdict.outliers.samples > 100
    assert verdict.held_back < 0.01


@pytest.mark.slow
def test_motion_that_is_held_back_is_counted_alike_however_it_is_cut_up(random):
    filter_ = Filter(Parameters(method='kalman'))
    rates, accelerations = at_rest(random, 40)
    rates[1000:3000, 1] += np.sin(np.arange(2000) / 200)
    rates[::50] = np.nan
    imus = filtered_imus(filter_, even_stamps(len(rates)), rates, accelerations)
    counts = []
    for size in (len(imus), 100, 7, 1):
        held_back = HeldBack()
        for k in range(0, len(imus), size):
            held_back.take(imus[k : k + size], 0.01)
        counts.append(held_back.samples.tolist())
    assert counts[0][1] > 100
    assert counts[0][0] == counts[0][2] == 0
    assert all(count == counts[0] for count in counts)


@pytest.mark.slow
@pytest.mark.parametrize('rate', [50, 100])
def test_fast_motion_of_a_quiet_sensor_is_no_lag(rate, tmp_path, random):
    """Its innovations are many times what is expected, and `adaptive` follows all the same."""
    (rates, accelerations), motion = at_rest(random, 40, rate=rate), slice(15 * rate, 35 * rate)
    rates *= 0.02
    turn = motion_below(0.3 * rate, random, 20 * rate, rate)
    window = np.minimum(1.0, np.minimum(np.arange(20 * rate), np.arange(20 * rate)[::-1]) / rate)
    rates[motion] += 5.0 * window[:, None] * turn / turn.std()
    accelerations[motion] += window[:, None] * by_hand(random, 20, rate)[1]
    stamps = START + 10**9 // rate * np.arange(40 * rate)
    source = bag(tmp_path / 'in', rates, accelerations, stamps)
    verdict = judged(source, tmp_path)
    assert verdict.lagging == 0.0
    assert verdict.outcome == 'helped'
    assert judged(source, tmp_path, Parameters(method='kalman')).outcome == 'harmed'


def test_outliers_are_counted_where_they_are(tmp_path, random):
    rates, accelerations = at_rest(random, 30)
    for k in (500, 1500, 1520, 1540, 2500):
        rates[k, 2] += 2.0
    verdict = of_samples(tmp_path, rates, accelerations)
    outliers = verdict.outliers
    assert outliers.axes.tolist() == [0, 0, 5]
    assert (outliers.first, outliers.last) == pytest.approx((5.0, 25.0))
    assert outliers.in_busiest == 3
    assert outliers.at_rest + outliers.in_motion == 5
    assert 'outliers' in verdict.gains


@pytest.mark.slow
def test_motion_that_was_flagged_is_no_outlier_that_was_taken_out(tmp_path, random):
    """A jump that lasts is followed as soon as no outliers are as long."""
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 12)
    for k in range(200, 1200, 200):
        turn[k : k + 100, 2] += 15.0
    source = bag(tmp_path / 'in', rates + turn, accelerations + push)
    verdict = judged(source, tmp_path)
    assert verdict.outliers.samples >= 10
    assert (verdict.outliers.confirmed, verdict.outliers.knocks) == (0, 0)
    assert verdict.outliers.motion == verdict.outliers.samples
    assert (verdict.outcome, verdict.gains) == ('useless', [])
    text = ' '.join(as_text(verdict).split())
    assert 'nothing that it flagged turned out to be an outlier. Let it' in text
    assert '0 of them at rest; all turned out to be motion; from 2.0 to' in text
    # One spike more is an outlier.
    turn[350, 1] += 15.0
    verdict = judged(bag(tmp_path / 'spike', rates + turn, accelerations + push), tmp_path)
    assert (verdict.outliers.confirmed, verdict.gains) == (1, ['outliers'])
    assert headline(verdict) == 'It helped: 1 outlier was taken out.'
    motion = verdict.outliers.motion
    assert f'; {motion} turned out to be motion; from 2.0 to' in ' '.join(as_text(verdict).split())


def test_a_sample_that_was_flagged_is_what_explain_says_of_it(random):
    """A spike, a knock that the accelerometer feels, motion, and one that nothing follows."""
    rates, accelerations = at_rest(random, 10)
    rates[[500, 501, 999], 1] += 3.0
    rates[700, 2] += 3.0
    accelerations[700:704] += 60.0 * random.standard_normal((4, 3))
    rates[900:, 0] += 15.0
    stamps = START + 3_500_000 * np.arange(len(rates))
    imus = filtered_imus(Filter(), stamps, rates, accelerations)
    log, sums = FlaggedLog(Filter()), no_sums()
    log.take(imus, stamps)
    add_run(imus, stamps, np.eye(3).ravel(), sums)
    explained = Counter()
    for sequence in log.sequences:
        explained[sequence.outcome_name] += sequence.samples
    assert explained['RETURNED'] == 2
    assert explained['KNOCKED'] == explained[None] == 1
    found = sums[0]['outliers']
    assert (found['were_outliers'], found['were_knocks']) == (2, 1)
    assert found['were_motion'] == explained.total() - 4


def test_what_is_no_number_is_no_outlier(tmp_path, random):
    """The samples that were flagged were those without a rate, and on each axis none."""
    rates, accelerations = at_rest(random, 30)
    rates[::10] = np.nan
    for k, axis in ((1505, 1), (2005, 0), (2505, 1)):
        rates[k, axis] += 2.0
    verdict = of_samples(tmp_path, rates, accelerations)
    assert verdict.outliers.axes.tolist() == [1, 2, 0]
    assert verdict.outliers.samples == 3
    assert '3 samples flagged as outliers (x 1, y 2, z 0)' in ' '.join(as_text(verdict).split())


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_outliers_that_nobody_looks_for_are_not_called_none(method, tmp_path, random):
    source = bag(tmp_path / 'in', *at_rest(random, 12))
    looked_for = as_text(judged(source, tmp_path, Parameters(method=method)))
    assert '  outliers none' in looked_for
    text = as_text(judged(source, tmp_path, Parameters(method=method, outlier_enabled=False)))
    assert '  outliers not looked for: outlier.enabled is false' in text


def test_a_useless_filter_that_looks_for_no_outliers_says_so(tmp_path, random):
    turn, push = by_hand(random, 12)
    rates, accelerations = at_rest(random, 12)
    source = bag(tmp_path / 'in', rates + turn, accelerations + push)
    assert 'no outlier came' in headline(judged(source, tmp_path))
    verdict = judged(source, tmp_path, Parameters(outlier_enabled=False))
    assert verdict.outcome == 'useless'
    assert 'outliers were not looked for: outlier.enabled is false' in headline(verdict)
    assert 'no outlier came' not in headline(verdict)


def test_a_filter_that_lags_now_and_then_is_told(tmp_path, random):
    verdict = of_samples(tmp_path, *at_rest(random, 5))
    assert 'nothing unsound' in as_text(verdict)
    lagging = SimpleNamespace(**vars(verdict))
    lagging.lagging = 0.04
    said = as_text(lagging)
    assert 'for 4 % of the time the rates changed more than method adaptive expects' in said
    assert 'nothing unsound' not in said


def test_what_is_unsound_is_told_with_what_to_do(tmp_path, random):
    rates, accelerations = at_rest(random, 20)
    stamps = START + 10**7 * np.arange(2000)
    stamps[500:] += np.repeat(np.arange(15), 100) * 5 * 10**7
    verdict = of_samples(tmp_path, rates, accelerations, stamps)
    assert 'gaps' in [finding.name for finding in verdict.findings]
    assert 'a slow disk' in as_text(verdict)


@pytest.mark.slow
def test_a_bias_that_was_kept_is_not_called_found(tmp_path, random):
    memory, rates = tmp_path / 'bias.yaml', at_rest(random, 10, (0.0, 0.0, 0.05))
    judged(bag(tmp_path / 'first', *rates), tmp_path, memory=memory)
    turn, push = by_hand(random, 8)
    rest = at_rest(random, 8, (0.0, 0.0, 0.05))
    source = bag(tmp_path / 'second', rest[0] + turn, rest[1] + push)
    verdict = judged(source, tmp_path, memory=memory)
    assert verdict.bias.source == 'given'
    assert 'kept from the recording before' in as_text(verdict)
    assert verdict.heading.raw == pytest.approx(0.05, rel=0.25)


def test_the_verdict_for_programs_says_the_same(tmp_path, random, capsys):
    source = bag(tmp_path / 'in', *at_rest(random, 10, (0.0, 0.0, 0.05)))
    arguments = ['replay', str(source), '-o', str(tmp_path / 'out'), '--json']
    assert main([*arguments, str(tmp_path / 'v.json')]) == 0
    printed = capsys.readouterr().out
    assert printed.endswith(f'\n\nwrote {tmp_path}/out\n      {tmp_path}/v.json\n')
    (verdict,) = json.loads((tmp_path / 'v.json').read_text())['verdicts']
    assert f'z {np.degrees(verdict["bias"]["rates"][2]):.3f} deg/s' in printed
    assert verdict['outcome'] == 'helped'
    assert main([*arguments, str(tmp_path / 'v.json')]) == 1
    assert 'exists already' in capsys.readouterr().err


def test_what_the_bag_names_can_not_write_on_the_terminal(tmp_path, random):
    verdict = of_samples(tmp_path, *at_rest(random, 5))
    loud = SimpleNamespace(**vars(verdict))
    loud.silent = ['\x1b[2J'] * 3
    assert '\x1b' not in as_text(loud)


EXPECTED = {
    # rests at least, and deg/min by the raw rates
    'broad_09_fast_rotation_with_breaks': (4, 8, 16),
    'broad_24_tapping': (2, 2, 10),
    'multiposition_xsens': (20, 25, 45),
    'static_adis16405': (1, 12, 20),
    'static_mpu6050_bursty': (1, 50, 65),
    'xio_fusion': (2, 0, 3),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', EXPECTED)
def test_real_recordings(name, tmp_path):
    verdict = judged(recorded(RECORDINGS / name), tmp_path)
    rests, low, high = EXPECTED[name]
    assert verdict.outcome == 'helped'
    assert verdict.rests.count >= rests
    assert low <= abs(np.degrees(verdict.heading.raw)) * 60 <= high
    assert np.degrees(verdict.heading.left) * 60 < 4
    assert (verdict.rests.ratio < 0.2).all()
