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

"""`gyro_drift doctor`: planted faults are found, none in sound ones, real ones are known."""

import ast
import json
import math
import re
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.cli.doctor import page
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.doctor import examination, live_rules
from gyro_drift_filter.doctor.axes import AS_IT_IS, WAYS, Carried, carry_gravity, judge_axes
from gyro_drift_filter.doctor.clipping import is_clipped
from gyro_drift_filter.doctor.clocks import judge_log_clock
from gyro_drift_filter.doctor.covariances import QUANTITIES, Stated, judge_covariances
from gyro_drift_filter.doctor.examination import examine
from gyro_drift_filter.doctor.findings import Finding, FindingVerdict, fault
from gyro_drift_filter.doctor.live_rules import starts_anew
from gyro_drift_filter.doctor.publishers import judge_publishers
from gyro_drift_filter.doctor.repeats import judge_repeats
from gyro_drift_filter.doctor.rests import (
    judge_accelerometer,
    judge_resolution,
    look_at_rests,
)
from gyro_drift_filter.doctor.vibration import judge_vibration
from gyro_drift_filter.identify import repeats as identify_repeats
from gyro_drift_filter.identify.series import LARGEST_PART
from gyro_drift_filter.messages.filter_rules import FILTER_RULES
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.input_rules import INPUT_RULES
from gyro_drift_filter.recordings.examined import read_recording
from gyro_drift_filter.rotations import from_vectors, multiply, running_products
from gyro_drift_filter.simulation.bag import TOPIC, write_simulation
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from gyro_drift_filter.simulation.sensor import START
from support.bags import write as write_rows
from support.doctored import handled, messages, write
from support.messages import without_rates
from support.paths import RECORDINGS, recorded
from support.sensor import turning_gravity

POSE = 'geometry_msgs/msg/PoseStamped'
TIME = 'builtin_interfaces/msg/Time'


def examined(bag):
    """Return the findings on a bag."""
    _, seen = read_recording(bag, None, (0.0, math.inf), lambda done, total: None)
    return examine(seen)


def of_verdict(findings, verdict):
    return {finding.name for finding in findings if finding.verdict == verdict}


def faults(findings):
    return of_verdict(findings, FindingVerdict.FAULT)


@pytest.fixture
def found(tmp_path):
    """Return what is found in a simulation; options are those of `write`."""

    def of(simulation, **options):
        return examined(write(tmp_path / 'bag', simulation, **options))

    return of


def rates_of(simulation, rates):
    return replace(simulation, angular_velocity=rates)


def again(simulation, index):
    """Return a simulation whose samples are those of these indexes, with the stamps as they are."""
    return replace(
        simulation,
        angular_velocity=simulation.angular_velocity[index],
        linear_acceleration=simulation.linear_acceleration[index],
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ('seed', 'settings'),
    [
        (0, {}),
        (1, {'sample_rate': 200.0, 'motions': 3}),
        (2, {'turning': 2.0, 'frequency': 2.0}),
        (3, {'pushing': 3.0, 'bias': (0.08, -0.05, 0.03)}),
    ],
)
def test_a_sound_recording_has_no_faults(found, seed, settings):
    findings = found(handled(seed, **settings))
    assert faults(findings) == set()
    sound = of_verdict(findings, FindingVerdict.SOUND)
    assert {'axes', 'accelerometer', 'stamp times', 'clock', 'covariances', 'rests'} <= sound


WRONG_AXES = {
    'sign of z': (([1, 0, 0], [0, 1, 0], [0, 0, -1]), '(x, y, -z)'),
    'signs of x and z': (([-1, 0, 0], [0, 1, 0], [0, 0, -1]), '(-x, y, -z)'),
    'all signs': (([-1, 0, 0], [0, -1, 0], [0, 0, -1]), '(-x, -y, -z)'),
    'x and y swapped': (([0, 1, 0], [1, 0, 0], [0, 0, 1]), '(y, x, z)'),
    'turned round': (([0, 1, 0], [0, 0, 1], [1, 0, 0]), '(z, x, y)'),
}


@pytest.mark.slow
@pytest.mark.parametrize('name', WRONG_AXES)
def test_wrong_signs_and_axes_are_found_by_gravity(found, name):
    matrix, way = WRONG_AXES[name]
    simulation = handled()
    findings = found(rates_of(simulation, simulation.angular_velocity @ np.transpose(matrix)))
    assert faults(findings) == {'axes'}
    assert findings[0].values['way'] == way, findings[0].text
    assert findings[0].values['share_left_then'] < 0.2 < findings[0].values['share_left']


def test_turns_to_and_fro_are_told_to_cancel_out():
    """They may be far larger than what is asked for."""
    still = judge_axes(Carried(np.zeros(0), np.zeros((len(WAYS), 0))))
    assert still.verdict == FindingVerdict.UNKNOWN
    assert 'never by 15 deg from its mean over 2 or 6 s, in which swings cancel out' in still.text


def about_y(simulation, signs=(1.0, 1.0, 1.0)):
    """Return the same turned about y alone, which lies level."""
    only = np.array([0.0, 1.0, 0.0]) * (simulation.truth - simulation.bias)
    noise = simulation.angular_velocity - simulation.truth
    gravity = turning_gravity(only, 100.0)
    return replace(
        simulation,
        angular_velocity=only * signs + simulation.bias + noise,
        linear_acceleration=gravity + 10.0 * noise,
    )


@pytest.mark.parametrize('seconds', [0.6, 2.0])
@pytest.mark.parametrize('signs', [(1, 1, 1), (-1, 1, 1), (1, 1, -1), (-1, -1, 1), (-1, -1, -1)])
def test_turns_about_one_axis_after_the_other_tell_the_signs_of_all(seconds, signs, random):
    """By 90 deg each, as the advice says: of each axis only a third of the stretches tells."""
    still, profile = np.zeros(500), np.hanning(round(100 * seconds))
    turns = np.zeros((0, 3))
    for axis, sign in zip('xxyyxzzxyzzy', (1, -1, 1, -1, 1, 1, -1, -1, 1, 1, -1, -1), strict=True):
        turn = np.append(np.radians(90.0) * sign * 100 * profile / profile.sum(), still)
        turns = np.concatenate([turns, np.outer(turn, np.eye(3)['xyz'.index(axis)])])
    rates = turns * signs + 2e-3 * random.standard_normal(turns.shape)
    forces = turning_gravity(turns, 100.0) + 0.03 * random.standard_normal(turns.shape)
    carried = carry_gravity(
        START + 10_000_000 * np.arange(len(rates)),
        tuple(rates.T),
        tuple(forces.T),
        0.01,
        np.zeros(3),
    )
    axes = judge_axes(carried)
    if min(signs) > 0:
        assert axes.text.startswith('signs, axes and unit of the rates fit: ')
    else:
        assert axes.values['way'] == str(AS_IT_IS._replace(signs=signs))


UP = np.array([0.0, 0.0, 9.81])


def test_an_axis_about_which_it_was_not_turned_is_named(found):
    findings = found(about_y(handled()), deviations=(2e-3, 0.02))
    assert faults(findings) == set()
    axes = next(finding for finding in findings if finding.name == 'axes')
    assert 'except that of x and z' in axes.text


def test_of_ways_that_are_as_good_the_smallest_change_is_told(found):
    """Turned about y alone, signs of x and z may be either way; only that of y is surely wrong."""
    findings = found(about_y(handled(), (1.0, -1.0, 1.0)), deviations=(2e-3, 0.02))
    assert faults(findings) == {'axes'}
    assert findings[0].values['way'] == '(x, -y, z)'


def test_degrees_are_found_though_no_rate_is_beyond_what_gyroscopes_measure(found):
    simulation = handled(turning=0.3)
    degrees = np.degrees(simulation.angular_velocity)
    assert np.median(np.abs(degrees)) < 35.0
    assert faults(found(rates_of(simulation, degrees))) == {'degrees'}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('factor', 'unit', 'divisor'),
    [
        (1000.0, 'milliradians per second', '1000'),
        (180e3 / np.pi, 'thousandths of a degree per second', '180000 / pi'),
        (131.0 * 180 / np.pi, 'counts, some 131 for each degree per second', '131 * 180 / pi'),
        (16.4 * 180 / np.pi, 'counts, some 16 for each degree per second', '16 * 180 / pi'),
    ],
)
def test_thousandths_and_counts_are_not_taken_for_degrees(factor, unit, divisor, found):
    """Half of their rates are beyond what gyroscopes measure, so that a rule spoke of degrees."""
    simulation = handled()
    findings = found(rates_of(simulation, factor * simulation.angular_velocity))
    assert faults(findings) == {'unit of rates'}
    assert unit in findings[0].text
    assert f'divide by {divisor} in the driver' in findings[0].advice


def test_degrees_are_found_where_their_noise_leaves_no_rest(found, random):
    """A sensor that stands still would else be asked to stand still."""
    simulation = handled()
    still = replace(
        simulation,
        angular_velocity=np.degrees(0.003 * random.standard_normal((len(simulation.stamps), 3))),
        linear_acceleration=UP + 0.02 * random.standard_normal((len(simulation.stamps), 3)),
    )
    findings = found(still)
    assert 'noise in degrees' in faults(findings)
    assert 'rests' not in {finding.name for finding in findings}


def test_a_rate_that_is_steady_and_too_large_for_a_bias(found):
    """Of a bias of 1 deg/s in deg/s nothing but its size tells that it is no turn."""
    simulation = handled()
    still = replace(
        simulation,
        angular_velocity=simulation.angular_velocity - simulation.truth + [0.0, 0.0, 1.0],
        linear_acceleration=np.tile(UP, (len(simulation.stamps), 1))
        + 0.01 * (simulation.angular_velocity - simulation.truth),
    )
    findings = found(still)
    assert faults(findings) == {'beyond bias.max'}
    fault = next(finding for finding in findings if finding.name == 'beyond bias.max')
    assert 'are the rates in deg/s (REP-103 asks for rad/s)?' in fault.advice
    assert 'rests' not in {finding.name for finding in findings}


@pytest.mark.slow
def test_a_wrong_measuring_range_is_found_by_gravity(found):
    simulation = handled()
    findings = found(rates_of(simulation, 0.5 * simulation.angular_velocity))
    assert 'scale' in faults(findings)
    assert findings[0].values['factor'] == pytest.approx(2.0, rel=0.1)


@pytest.mark.slow
def test_a_wrong_scale_beside_zero_stamps_asks_for_the_log_times(found):
    simulation = handled()
    log_times = simulation.stamps + 200_000
    half = rates_of(simulation, 0.5 * simulation.angular_velocity)
    unstamped = found(replace(half, stamps=0 * simulation.stamps), log_times=log_times)
    (scale,) = (finding for finding in unstamped if finding.name == 'scale')
    assert scale.advice.startswith('are the log times right? Time that runs too fast or too slowly')
    assert 'Hz' not in scale.advice


@pytest.mark.slow
@pytest.mark.parametrize('pace', [1.5, 0.5])
def test_a_wrong_pace_of_the_stamps_looks_like_a_scale_and_is_named_first(found, pace):
    """As where numbers of packets, or a rate from a data sheet, were taken for the time."""
    simulation = handled()
    first = int(simulation.stamps[0])
    stamps = first + (pace * (simulation.stamps - first)).astype(np.int64)
    (scale,) = (
        finding
        for finding in found(replace(simulation, stamps=stamps), log_times=stamps + 200_000)
        if finding.name == 'scale'
    )
    assert scale.values['factor'] == pytest.approx(1.0 / pace, rel=0.1)
    assert scale.advice.startswith('are the stamps right?')
    stamped, fitting = map(float, re.findall(r'(\S+) Hz', scale.advice))
    assert stamped == pytest.approx(100.0 / pace, rel=0.01)
    assert fitting == pytest.approx(100.0, rel=0.1)


def test_the_rate_of_stamps_beside_a_wrong_scale_is_that_of_the_line_of_stamps():
    """Rounded to two digits it was 120 Hz here, and 125 Hz there."""
    errors = np.full((len(WAYS), 9), 0.5)
    errors[[way.factor > 1.9 and way.factor < 2.0 for way in WAYS]] = 0.01
    scale = judge_axes(Carried(np.full(9, 1.0), errors, period=0.008))
    assert scale.name == 'scale'
    assert '(they say 125 Hz, and about 64 Hz would fit)' in scale.advice


def test_milliseconds_of_jitter_are_no_gaps(found, random):
    simulation = handled()
    off = (3e6 * random.standard_normal(len(simulation.stamps))).astype(np.int64)
    findings = found(replace(simulation, stamps=simulation.stamps + off))
    assert faults(findings) == {'jitter'}
    jitter = next(finding for finding in findings if finding.name == 'jitter')
    assert jitter.values['jitter_seconds'] == pytest.approx(3e-3, rel=0.1)


@pytest.mark.slow
def test_stamps_of_arrival(found, random):
    simulation = handled()
    late = (2e6 * random.exponential(1.0, len(simulation.stamps))).astype(np.int64)
    stamps = simulation.stamps + late
    findings = found(replace(simulation, stamps=stamps), log_times=stamps + 200_000)
    assert faults(findings) == {'arrival stamps'}


@pytest.mark.slow
def test_bursts(found):
    simulation = handled()
    arrival = simulation.stamps[7::8].repeat(8)[: len(simulation.stamps)]
    stamps = arrival + 1_000_000 * (np.arange(len(arrival)) % 8)
    bursts = again(replace(simulation, stamps=stamps), np.arange(len(stamps)))
    assert faults(found(bursts, log_times=stamps + 200_000)) == {'bursts'}


@pytest.mark.slow
@pytest.mark.parametrize('size', [2, 8, 10**6])
def test_stamps_that_messages_share(size, found):
    """Of a buffer, and of a driver that has never stamped anew."""
    simulation = handled()
    stamps = simulation.stamps[np.arange(len(simulation.stamps)) // size * size]
    findings = found(replace(simulation, stamps=stamps), log_times=simulation.stamps + 200_000)
    (shared,) = (finding for finding in findings if finding.name == 'shared stamps')
    assert shared.values['share_of_shared_stamps'] == pytest.approx(1.0 - 1.0 / size, abs=0.01)
    assert not {'bursts', 'jitter', 'arrival stamps'} & faults(findings)


def test_repeats_count_from_the_second_sample_on(random):
    values = random.standard_normal((6, 100))
    values[:, 1:41] = values[:, :1]
    found = judge_repeats(tuple(values[:3]), tuple(values[3:]))
    assert (found.values['repeated'], found.values['times']) == (40, 1)
    # There are three values without an accelerometer, and six with one.
    assert found.text.startswith('every value is that of the sample before in 40 samples')


@pytest.mark.slow
@pytest.mark.parametrize(
    'look',
    [
        pytest.param(lambda rates: judge_publishers(rates, 1), id='publishers'),
        pytest.param(lambda rates: judge_repeats(rates, rates), id='repeats'),
    ],
)
def test_many_samples_are_looked_at_in_parts_of_a_few_megabytes(look, random):
    rates = tuple(random.standard_normal((3, 1 << 20)))
    tracemalloc.start()
    found = look(rates)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert found.verdict == 'sound'
    assert peak < 60e6


@pytest.mark.slow
def test_a_driver_that_polls_repeats_samples(found):
    simulation = handled()
    index = np.arange(len(simulation.stamps))
    index[index % 5 == 4] -= 1
    assert faults(found(again(simulation, index))) == {'repeated samples'}


@pytest.mark.slow
@pytest.mark.parametrize('stamped', [True, False])
def test_a_driver_that_polls_five_times_as_fast_has_no_other_fault(found, stamped):
    """Its stamps, the turns of gravity and the rests are judged by the time between messages."""
    simulation = handled()
    n = len(simulation.stamps)
    simulation = again(simulation, np.repeat(np.arange(n), 5))
    even = simulation.stamps[0] + 2_000_000 * np.arange(5 * n)
    simulation = replace(simulation, stamps=even)
    late = np.random.default_rng(0).exponential(4e5, 5 * n).astype(np.int64)
    if not stamped:
        simulation = replace(simulation, stamps=np.zeros(5 * n, np.int64))
    findings = found(simulation, log_times=np.maximum.accumulate(even + late))
    named = {finding.name: finding for finding in findings}
    assert faults(findings) == {'repeated samples'} | (set() if stamped else {'zero stamps'})
    assert named['axes'].verdict == FindingVerdict.SOUND
    assert named['rests'].values['seconds'] < 0.01 * n
    assert ('clock' in named) == stamped


def test_a_slow_sensor_has_to_stand_still_for_longer(found):
    simulation = handled(motions=1)
    tenth = slice(None, 1000, 10)
    slow = replace(
        simulation,
        stamps=simulation.stamps[tenth],
        angular_velocity=simulation.angular_velocity[tenth],
        linear_acceleration=simulation.linear_acceleration[tenth],
    )
    (rests,) = (finding for finding in found(slow) if finding.name == 'rests')
    assert 'too short for a rest of 15 s' in rests.text
    assert rests.advice.startswith('let it stand still for 23 seconds at the start')


@pytest.mark.parametrize('period', [1.0, 2.0])
def test_a_sensor_that_is_slower_than_gap_limit_allows_is_one_fault(period, found, random):
    simulation = again(handled(motions=1), slice(None, 1000, 10))
    late = np.abs(0.01 * random.standard_normal(100))
    stamps = START + (1e9 * (period * np.arange(100) + late)).astype(np.int64)
    findings = found(replace(simulation, stamps=stamps))
    assert {'slow sensor'} == faults(findings) & {
        *('slow sensor', 'restarted', 'always restarted', 'gaps', 'rests'),
    }
    (finding,) = (finding for finding in findings if finding.name == 'slow sensor')
    assert finding.advice.startswith('raise gap_limit')


@pytest.mark.slow
def test_clocks_of_two_drivers_in_turns_are_no_lack_of_stillness(found):
    """It stood still, and no rest could be found."""
    simulation = handled(motions=1)
    other = 3 * 10**9 * (np.arange(len(simulation.stamps)) % 2)
    told = faults(found(replace(simulation, stamps=simulation.stamps + other)))
    assert 'always restarted' in told
    assert 'rests' not in told


@pytest.mark.parametrize(('share', 'explains'), [(0.1, False), (0.9, True)])
def test_clocks_that_mix_for_a_while_explain_no_missing_rest(share, explains):
    values = {'seconds': 400.0 * share, 'first_at': 0.0, 'share': share}
    assert starts_anew([fault('always restarted', '', '', values)]) == explains


def of_samples(simulation, kept):
    """Return what is measured of the samples that are kept."""
    return replace(
        simulation,
        stamps=simulation.stamps[kept],
        angular_velocity=simulation.angular_velocity[kept],
        linear_acceleration=simulation.linear_acceleration[kept],
    )


@pytest.mark.slow
def test_a_driver_that_lowers_its_rate_has_no_gaps(found):
    """With a little jitter some are counted until that is known, and then none."""
    simulation = handled()
    index = np.arange(len(simulation.stamps))
    kept = (index < len(index) // 2) | (index % 2 == 0)
    late = np.random.default_rng(3).normal(0.0, 2e5, len(index)).astype(np.int64)
    findings = found(of_samples(replace(simulation, stamps=simulation.stamps + late), kept))
    assert 'gaps' not in faults(findings)
    (stamps,) = (finding for finding in findings if finding.name == 'stamps')
    assert ' 0 gaps, 0 samples missing' in stamps.text


@pytest.mark.slow
@pytest.mark.parametrize('rate', [50, 20])
def test_a_rate_that_changes_is_told_and_rests_last_as_long_as_they_do(rate, found):
    """Lengths were samples times the last period: 89 s of rest in a recording of a minute."""
    data = simulate(SimulationSettings(static_seconds=40, dynamic_seconds=0))
    kept = np.concatenate([np.arange(2000), np.arange(2000, 4000, 100 // rate)])
    findings = found(of_samples(data, kept))
    # `write` states the noise of another sensor.
    assert faults(findings) <= {'invented covariance of angular velocity'}
    told = {finding.name: finding for finding in findings}
    said = f'the sensor changed its rate from 100 to {rate} Hz at 20.0 s'
    assert told['sample rate'].text == said
    assert 25.0 < told['rests'].values['seconds'] < 40.0
    assert 'even to' in told['stamp times'].text


@pytest.mark.slow
def test_the_simulation_of_the_package_has_no_fault(tmp_path):
    """Gravity did not follow the turns, as of a sensor that stands without a rest."""
    write_simulation(tmp_path / 'bag', simulate(SimulationSettings(dynamic_seconds=120.0)))
    assert faults(examined(tmp_path / 'bag')) == set()


@pytest.mark.slow
def test_one_missing_sample_is_no_fault_and_told_as_one(found):
    simulation = handled()
    kept = np.arange(len(simulation.stamps)) != len(simulation.stamps) // 2
    findings = found(of_samples(simulation, kept))
    (stamps,) = (finding for finding in findings if finding.name == 'stamps')
    assert ' 1 gap, 1 sample missing, 0 stamps backward' in stamps.text


@pytest.mark.slow
def test_a_pause_is_no_wrong_rate(found):
    """A recording that was stopped for half a minute, and went on."""
    simulation = handled()
    later = np.arange(len(simulation.stamps)) > len(simulation.stamps) // 2
    paused = replace(simulation, stamps=simulation.stamps + 30 * 10**9 * later)
    assert 'wrong rate' not in faults(found(paused))


@pytest.mark.slow
@pytest.mark.parametrize('behind', [0, 1_000_000])
def test_messages_without_rates_between_others(behind, tmp_path, random):
    """An orientation alone in place of every fourth message or so, or a millisecond behind each."""
    simulation = handled()
    alone, rows = random.random(len(simulation.stamps)) < 0.25, []
    for stamp, data, is_alone in zip(simulation.stamps, messages(simulation), alone, strict=True):
        time = int(stamp) + behind
        if behind or not is_alone:
            rows.append((int(stamp), data))
        if behind or is_alone:
            rows.append((time, without_rates(time)))
    findings = examined(write_rows(tmp_path / 'bag', {(TOPIC, IMU_TYPE): rows}))
    told = {finding.name: finding for finding in findings if finding.is_fault}
    share = 0.5 if behind else float(alone.mean())
    assert f'messages, {100.0 * share:.2g} %' in told['not reported'].text
    assert not {'wrong rate', 'publishers', 'restarted'} & told.keys()
    if not behind:
        assert told['gaps'].advice.startswith('messages come without rates')
        assert 'if it is not that: look for what loses them' in told['gaps'].advice


@pytest.mark.slow
def test_a_rate_that_comes_late_in_the_recording_is_a_share_without_exponent(tmp_path):
    """Of 1000 messages 999 reported no rate, which was 1e+02 %."""
    simulation = handled()
    rows = [(int(stamp), without_rates(int(stamp))) for stamp in simulation.stamps[:999]]
    rows.append((int(simulation.stamps[999]), messages(simulation)[999]))
    findings = examined(write_rows(tmp_path / 'bag', {(TOPIC, IMU_TYPE): rows}))
    told = next(finding for finding in findings if finding.name == 'not reported')
    assert '999 of 1000 messages, 100 %' in told.text


def test_rates_that_are_no_numbers_answer_no_question_about_rates(found):
    """All axes were said to live, within their range, and no sample to be repeated."""
    simulation = handled()
    rates = np.full_like(simulation.angular_velocity, np.nan)
    findings = found(rates_of(simulation, rates))
    assert faults(findings) == {'no usable rate'}
    assert not {'alive', 'range', 'outliers', 'repeats', 'axes', 'vibration'} & {
        finding.name for finding in findings
    }


def test_messages_that_come_twice_are_told_as_that(found):
    simulation = handled()
    twice = np.repeat(np.arange(len(simulation.stamps)), 2)
    doubled = replace(
        simulation,
        stamps=simulation.stamps[twice],
        angular_velocity=simulation.angular_velocity[twice],
        linear_acceleration=simulation.linear_acceleration[twice],
    )
    findings = found(doubled)
    assert faults(findings) == {'doubled messages'}
    assert findings[0].text.startswith(f'{len(simulation.stamps)} of {len(twice)} messages come')


def test_a_covariance_is_not_compared_with_what_is_not_measured(found):
    simulation = handled()
    none = replace(simulation, linear_acceleration=0.0 * simulation.linear_acceleration)
    assert 'invented covariance of linear acceleration' not in faults(found(none))


@pytest.mark.parametrize('together', [6, 7, 50])
def test_stamps_of_repeats_are_left_out_wherever_parts_end(together, random, monkeypatch):
    monkeypatch.setattr(identify_repeats, '_TOGETHER', together)
    rates = random.standard_normal((3, 50))
    rates[0, 40:] = np.nan
    again = np.array([6, 7, 12, 13, 41])
    for k in again:
        rates[:, k] = rates[:, k - 1]
    left = identify_repeats.without_repeats(np.arange(50), tuple(rates))
    assert left.tolist() == [k for k in range(50) if k not in again]


def test_a_bus_that_hangs_now_and_then_repeats_all_values(found, random):
    simulation = handled()
    index = np.arange(len(simulation.stamps))
    for k in random.integers(10, len(index) - 10, 15):
        index[k : k + 4] = k
    findings = found(again(simulation, index))
    assert faults(findings) == {'repeats'}
    assert 10 <= findings[0].values['times'] <= 15


@pytest.mark.slow
@pytest.mark.parametrize(('jitter', 'expected'), [(0.0, 'gaps'), (3e6, 'jitter')])
def test_a_sample_that_takes_the_place_of_a_lost_one_is_no_jitter(found, random, jitter, expected):
    """It comes once more, with its stamp."""
    simulation = handled()
    index = np.arange(len(simulation.stamps))
    lost = np.unique(random.integers(10, len(index) - 10, len(index) // 20))
    index[lost] += 1
    off = (jitter * random.standard_normal(len(index))).astype(np.int64)
    stamps = (simulation.stamps + off)[index]
    told = faults(found(again(replace(simulation, stamps=stamps), index)))
    assert told == {'repeats', expected}


def test_the_stamps_of_a_sensor_that_is_stuck_are_judged_with_its_repeats(found, random):
    """Without these there are none left to judge."""
    simulation = handled()
    off = (3e6 * random.standard_normal(len(simulation.stamps))).astype(np.int64)
    stuck = again(simulation, np.zeros(len(simulation.stamps), int))
    told = faults(found(replace(stuck, stamps=simulation.stamps + off)))
    assert 'jitter' in told
    assert 'wrong order' not in told


def test_a_share_of_all_has_no_exponent(found):
    simulation = handled()
    findings = found(again(simulation, np.zeros(len(simulation.stamps), int)))
    (repeats,) = (finding for finding in findings if finding.name == 'repeats')
    assert '(100 %)' in repeats.text


# Rates that come from afar and land near zero tell of counts: it takes more than a hundred.
LONG = {'motions': 5, 'motion_seconds': 20.0, 'frequency': 3.0}


@pytest.mark.slow
def test_truncated_counts(found):
    simulation = handled(**LONG)
    count = math.radians(0.25)
    rates = simulation.angular_velocity / count
    assert faults(found(rates_of(simulation, np.trunc(rates) * count))) == {'truncated'}


@pytest.mark.slow
def test_counts_that_turn_less_than_the_bias_are_no_fault(tmp_path):
    """Half a count, that is, beside the error of a bias that is known."""
    simulation = handled(**LONG)
    count = math.radians(0.25)
    rates = np.trunc(simulation.angular_velocity / count) * count
    bag = write(tmp_path / 'bag', rates_of(simulation, rates))
    _, seen = read_recording(bag, None, (0.0, math.inf), lambda done, total: None)

    def told(known=True, **changes):
        last = seen.rules.last
        telemetry = last.now.telemetry._replace(**changes)
        rules = replace(seen.rules, last=last._replace(now=last.now._replace(telemetry=telemetry)))
        if not known:
            rules.bias_deviation = np.full(3, np.inf)
        return rules.findings(set(), truncation_refuted=False)

    deviation = seen.rules.bias_deviation.min()
    half_as_large, twice_as_large = ([share * 2.0 * deviation] * 3 for share in (0.5, 2.0))
    (sound,) = (f for f in told(count_size=half_as_large) if f.name == 'truncation')
    assert sound.verdict == FindingVerdict.SOUND
    assert 'turns less than the error of the bias' in sound.text
    assert 'truncated' in faults(told(count_size=twice_as_large))
    assert 'truncated' in faults(told(count_size=half_as_large, known=False))
    # A recording may end in motion, long after the last rest.
    assert 'truncated' in faults(told(count_size=twice_as_large, bias_deviation=[1.0] * 3))


@pytest.mark.slow
def test_counts_that_are_rounded_are_sound(found):
    simulation = handled(1, **LONG)
    count = math.radians(0.25)
    findings = found(rates_of(simulation, np.round(simulation.angular_velocity / count) * count))
    assert faults(findings) == set()
    assert 'truncation' in of_verdict(findings, FindingVerdict.SOUND)


def test_the_noise_of_a_rest_that_is_shorter_than_a_second_is_not_known(random):
    columns = tuple(0.01 * random.standard_normal((6, 500)))
    resting = np.zeros(500)
    resting[100:220] = 1.0
    seen = look_at_rests(resting, columns[:3], columns[3:], 0.01)
    assert seen.samples > 0
    finding = judge_resolution(np.full(3, 1e-3), seen)
    assert finding.verdict == FindingVerdict.UNKNOWN
    assert 'nan' not in finding.text


def test_values_that_are_missing_now_and_then_hide_no_noise_of_a_rest(random):
    gravity = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.8])
    values = gravity + 0.01 * random.standard_normal((1000, 6))
    values[::50, 1] = np.nan
    values[7::40, 5] = np.nan
    columns = tuple(values.T)
    seen = look_at_rests(np.ones(1000), columns[:3], columns[3:], 0.01)
    assert [*seen.noise, *seen.force_noise] == pytest.approx(6 * [0.01], rel=0.1)
    assert seen.forces == pytest.approx(gravity[None, 3:], abs=0.01)
    # An axis that is hardly ever there has none.
    values[:, 1] = np.where(np.arange(1000) % 3, np.nan, values[:, 1])
    seen = look_at_rests(np.ones(1000), columns[:3], columns[3:], 0.01)
    assert np.isfinite(seen.noise).tolist() == [True, False, True]


def test_the_accelerations_of_a_foot_that_never_rests_are_no_fault(random):
    columns = tuple(30.0 * random.standard_normal((3, 500)))
    seen = look_at_rests(np.zeros(500), columns, columns, 0.01)
    assert judge_accelerometer(seen, columns).verdict == FindingVerdict.UNKNOWN


@pytest.mark.slow
def test_counts_that_are_coarse(found):
    simulation = handled(motions=4)
    count = math.radians(1.0)
    findings = found(rates_of(simulation, np.round(simulation.angular_velocity / count) * count))
    assert faults(findings) == {'resolution'}


@pytest.mark.slow
@pytest.mark.parametrize('is_damaged', [False, True])
def test_rates_at_the_end_of_the_range(found, is_damaged):
    simulation = handled()
    rates = np.clip(simulation.angular_velocity, -2.1, 2.1)
    if is_damaged:
        rates[500, 0] = 30.0  # of one message, beyond the end of the range
    assert faults(found(rates_of(simulation, rates))) == {'clipped'}


@pytest.mark.slow
def test_rates_at_the_end_of_the_range_that_the_driver_has_calibrated(found):
    simulation = handled()
    rates = np.clip(simulation.angular_velocity, -2.1, 2.1)
    matrix = np.eye(3) + 0.005 * np.array([[1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [-1.0, 1.0, 1.0]])
    assert faults(found(rates_of(simulation, rates @ matrix.T))) == {'clipped'}


def test_the_top_of_a_turn_is_no_end_of_the_range(found):
    """The live rule takes a top that stays for three samples for it; larger rates refute that."""
    simulation = handled()
    rates = simulation.angular_velocity.copy()
    fast = np.flatnonzero(np.abs(rates[:, 0]) > 2.05)
    top = fast[np.argmin(np.abs(rates[fast, 0]))]
    rates[top : top + 3, 0] = rates[top, 0]
    rates[top - 1, 0] -= 0.1
    assert np.abs(rates[:, 0]).max() > 1.1 * np.abs(rates[top, 0])
    assert faults(found(rates_of(simulation, rates))) == set()


def test_a_larger_rate_refutes_an_end_of_the_range_unless_it_is_an_outlier():
    rates, outliers = np.sin(np.arange(200.0)), np.zeros(200)
    rates[50:54] = 1.5
    assert is_clipped(rates, outliers)
    for larger in (0, 100, 199):
        rates[larger] = 1.51
        assert not is_clipped(rates, outliers)
        outliers[larger] = 1
        assert is_clipped(rates, outliers)
    assert not is_clipped(rates, np.ones(200))


def test_a_low_pass_of_the_sensor(found):
    simulation = handled()
    share = 1.0 - math.exp(-2.0 * math.pi * 4.0 / 100.0)
    slow = signal.lfilter([share], [1.0, share - 1.0], simulation.angular_velocity, axis=0)
    findings = found(rates_of(simulation, slow), deviations=(8e-4, 0.03))
    assert faults(findings) == {'low-pass'}


def slow_noise_until(simulation, sample):
    """Return a simulation whose noise has passed a low-pass of 4 Hz before a sample (n,)."""
    noise = simulation.angular_velocity - simulation.truth
    noise[:sample] = 3.0 * signal.lfilter(*signal.butter(1, 4.0, fs=100.0), noise[:sample], axis=0)
    return rates_of(simulation, simulation.truth + noise)


@pytest.mark.slow
@pytest.mark.parametrize(('share', 'expected'), [(0.5, set()), (1.0, {'low-pass'})])
def test_a_low_pass_of_one_rest_and_not_of_the_next_is_none_of_the_sensor(share, expected, found):
    """As a motor that runs, or the wind, shakes what stands still."""
    simulation = handled()
    sample = round(share * len(simulation.stamps))
    assert faults(found(slow_noise_until(simulation, sample))) == expected


@pytest.mark.slow
def test_a_low_pass_is_not_withdrawn_where_the_filter_starts_anew(found):
    simulation = handled()
    stamps = simulation.stamps.copy()
    stamps[-100:] += 10_000_000_000
    slow = slow_noise_until(replace(simulation, stamps=stamps), len(stamps))
    assert {'low-pass', 'restarted'} <= faults(found(slow, log_times=stamps + 200_000))


def test_vibration_has_its_frequency(found):
    simulation = handled()
    line = 0.01 * np.sin(2.0 * np.pi * 37.0 * np.arange(len(simulation.stamps)) / 100.0)
    findings = found(rates_of(simulation, simulation.angular_velocity + line[:, None]))
    assert faults(findings) == {'vibration'}
    strongest = findings[0].values['lines'][0]
    assert strongest.frequency == pytest.approx(37.0, abs=0.1)
    assert strongest.amplitude == pytest.approx(0.01, rel=0.1)


@pytest.mark.slow
def test_vibration_is_found_wherever_it_begins(random):
    """Of more samples than are looked at at once."""
    seconds = np.arange(LARGEST_PART + 200_000) * 1e-3
    rates = tuple(3e-3 * random.standard_normal(len(seconds)) for _ in range(3))
    rates[1][-150_000:] += 0.1 * np.sin(2.0 * np.pi * 117.0 * seconds[-150_000:])
    finding = judge_vibration(rates, 1e-3)
    assert finding.verdict == FindingVerdict.FAULT
    (line,) = finding.values['lines']
    assert (line.axis, line.frequency) == ('y', pytest.approx(117.0, abs=0.1))


@pytest.mark.slow
@pytest.mark.parametrize(
    ('deviations', 'expected'),
    [
        ((0.0, 0.03), {'zero covariance'}),
        ((0.0, 0.0), {'zero covariance'}),
        ((1.0, 0.03), {'invented covariance of angular velocity'}),
        ((2e-3, 1e-4), {'invented covariance of linear acceleration'}),
        ((math.nan, 0.03), {'impossible covariance'}),
    ],
)
def test_covariances_that_are_zero_or_invented(found, deviations, expected):
    assert faults(found(handled(), deviations=deviations)) == expected


def test_a_variance_that_is_missing_is_told_of_its_axis():
    """It was held against those of the others, so that 0.002 was told to be wrong beside 0.002."""
    stated = Stated(), Stated(), Stated()
    stated[1].add(np.tile(np.diag([4e-6, 0.0, 4e-6]).ravel(), (10, 1)))
    findings = judge_covariances(stated, np.full(3, 2e-3), np.full(3, np.nan))
    told = next(finding for finding in findings if finding.is_fault)
    assert 'says a deviation of 0 rad/s on y, at rest it is 0.002' in told.text


@pytest.mark.parametrize(
    ('factor', 'expected'),
    [(1.0 / 9.80665, 'unit of acceleration'), (0.0, ''), (0.7, 'scale of acceleration')],
)
def test_units_of_the_accelerometer(found, factor, expected):
    simulation = handled()
    findings = found(
        replace(simulation, linear_acceleration=factor * simulation.linear_acceleration)
    )
    assert expected in {*faults(findings), ''}
    if not expected:
        assert {'axes', 'accelerometer'} <= of_verdict(findings, FindingVerdict.UNKNOWN)


@pytest.mark.parametrize('factor', [1.0 / 9.80665, 1000.0 / 9.80665, 1.0 / 9.80665**2, 0.7])
def test_an_accelerometer_in_another_unit_is_one_fault(found, factor):
    simulation = handled()
    scaled = factor * simulation.linear_acceleration
    findings = found(replace(simulation, linear_acceleration=scaled))
    of_accelerometer = {'unit of acceleration', 'scale of acceleration', 'gravity'}
    assert len(of_accelerometer & faults(findings)) == 1
    assert not {'no gravity', 'beyond gravity'} & faults(findings)


@pytest.mark.slow
def test_gravity_that_was_taken_off(found):
    simulation = handled()
    random = np.random.default_rng(1)
    pushes = 0.03 * random.standard_normal(simulation.linear_acceleration.shape)
    assert 'gravity' in faults(found(replace(simulation, linear_acceleration=pushes)))


def test_stamps_that_count_from_the_start_or_overflow_are_told_as_such():
    """A distance of 1.76e+09 s told nobody what was wrong, and no NTP has set a clock to 1901."""
    logged = START + 10_000_000 * np.arange(2000)
    logged += np.random.default_rng(0).integers(0, 500_000, 2000)
    since_start = judge_log_clock(5_000_000_000 + 10_000_000 * np.arange(2000), logged)
    assert since_start.name == 'clock offset'
    assert since_start.text == (
        'stamps begin at 5 s: they count from the start of sensor or driver'
    )
    stamps = (2**31 - 10) * 10**9 + 10_000_000 * np.arange(2000)
    late = judge_log_clock(np.where(stamps < 2**31 * 10**9, stamps, stamps - 2**32 * 10**9), logged)
    assert late.name == 'clock steps'
    assert late.advice.startswith('seconds of stamps have 32 bits and overflow in January 2038')


def test_distances_of_clocks_have_no_exponent_and_one_that_was_not_set_is_told():
    since = 10_000_000 * np.arange(2000)
    delays = np.random.default_rng(0).integers(0, 500_000, 2000)
    hour = judge_log_clock(START + since, START + since + delays + 3600 * 10**9)
    assert hour.text == 'stamps are 3600 s before the log times'
    unset = judge_log_clock(START + since, 10**10 + since + delays)
    assert unset.name == 'clock offset'
    assert unset.text.endswith('the clock of the recorder was not set')
    # A recorder whose clock begins in 2000, and a sensor that counts from its start.
    counted = judge_log_clock(5 * 10**9 + since, 946_684_800 * 10**9 + since + delays)
    assert counted.text == 'stamps begin at 5 s: they count from the start of sensor or driver'
    late = judge_log_clock(START + since, START + since + delays + 340_000_000)
    assert late.text.startswith('logged 340 ms after the stamp')
    both = judge_log_clock(10**10 + since, 10**10 + since + delays)
    assert both.verdict == FindingVerdict.SOUND
    assert both.text.endswith('both before 2007, as in a simulation or where none was set')


def test_a_recording_that_is_played_again_and_again_has_a_clock_that_steps_and_no_drift():
    logged = 10**18 + 10_000_000 * np.arange(40_000)
    looped = judge_log_clock(10**18 + 10_000_000 * (np.arange(40_000) % 8000), logged)
    assert looped.name == 'clock steps'
    assert looped.text.endswith('by 80 s at once, 4 times')
    assert 'played again and again' in looped.advice


@pytest.mark.parametrize('seed', range(5))
def test_delays_that_wander_are_no_steps_of_a_clock(seed):
    wander = np.cumsum(np.random.default_rng(seed).normal(0.0, 0.2, 100))
    stamps = 10**18 + 10_000_000 * np.arange(40_000)
    logged = stamps + np.repeat(1e9 * (wander - wander.min() + 0.01), 400).astype(np.int64)
    assert judge_log_clock(stamps, logged).name != 'clock steps'


@pytest.mark.slow
@pytest.mark.parametrize(
    ('drift', 'offset', 'step', 'expected'),
    [
        (1e-3, 0, 0, 'clock drift'),
        (0.0, 5_000_000_000, 0, 'clock offset'),
        (0.0, -20_000_000, 0, 'clock offset'),
        (0.0, 0, 300_000_000, 'clock steps'),
    ],
)
def test_the_clock_of_the_stamps_beside_the_log_times(found, drift, offset, step, expected):
    simulation = handled()
    since = simulation.stamps - simulation.stamps[0]
    log = simulation.stamps + 300_000 + offset + np.round(drift * since).astype(np.int64)
    log[len(log) // 2 :] += step
    assert faults(found(simulation, log_times=log)) == {expected}


@pytest.mark.slow
def test_two_sensors_that_take_turns(found):
    simulation = handled()
    rates = simulation.angular_velocity.copy()
    rates[1::2] += [0.02, 0.0, -0.03]
    assert faults(found(rates_of(simulation, rates))) == {'publishers'}


def test_lost_samples(found, random):
    simulation = handled()
    kept = random.random(len(simulation.stamps)) > 0.02
    lossy = again(replace(simulation, stamps=simulation.stamps[kept]), kept)
    assert faults(found(lossy)) == {'gaps'}


def test_values_beyond_numbers_and_messages_that_are_none(found):
    simulation = handled()
    rates, forces = simulation.angular_velocity.copy(), simulation.linear_acceleration.copy()
    rates[::970, 0], rates[500::970, 1] = np.nan, 1e300
    forces[300::970] = np.inf
    findings = found(replace(simulation, angular_velocity=rates, linear_acceleration=forces))
    assert faults(findings) == {'unusable'}
    assert 'rests' in of_verdict(findings, FindingVerdict.SOUND)


def test_an_acceleration_that_the_filter_does_not_use_is_not_examined(tmp_path):
    simulation = handled()
    forces = simulation.linear_acceleration.copy()
    forces[5, 0], forces[6, 0] = 1e5, 1e4
    bag = write(tmp_path / 'bag', replace(simulation, linear_acceleration=forces))
    _, seen = read_recording(bag, None, (0.0, math.inf), lambda done, total: None)
    assert [math.isnan(force) for force in seen.accelerations[0][4:8]] == [
        False,
        True,
        False,
        False,
    ]


def test_rates_that_never_change_are_not_said_to_live(found):
    """Nor to be dead: at rest a coarse gyroscope shows no noise either."""
    simulation = simulate(SimulationSettings(static_seconds=20.0, dynamic_seconds=0.0))
    findings = found(rates_of(simulation, np.zeros_like(simulation.angular_velocity)))
    (alive,) = [finding for finding in findings if finding.name == 'alive']
    assert alive.verdict == FindingVerdict.UNKNOWN
    assert 'always the same rate about x, y, z: dead' in alive.text


@pytest.mark.slow
def test_an_axis_that_never_changes_is_told_beside_a_dead_one(found):
    """A rate that is not 0 may be that of a coarse sensor for the rule of dead axes."""
    simulation = handled()
    rates = simulation.angular_velocity.copy()
    rates[:, 0], rates[:, 1] = 0.0, 0.05
    findings = found(rates_of(simulation, rates))
    (dead,) = [finding for finding in findings if finding.name == 'dead axis']
    assert dead.text.startswith('axis x of the gyroscope')
    (alive,) = [finding for finding in findings if finding.name == 'alive']
    assert alive.verdict == FindingVerdict.UNKNOWN
    assert 'always the same rate about y: dead' in alive.text


def test_a_tenth_of_a_second_says_next_to_nothing(found):
    simulation = handled()
    first = slice(0, 10)
    findings = found(again(replace(simulation, stamps=simulation.stamps[first]), first))
    assert faults(findings) == {'rests'}
    assert {'axes', 'stamp times', 'clock', 'vibration'} <= of_verdict(
        findings, FindingVerdict.UNKNOWN
    )
    assert not any('nan' in finding.text for finding in findings)


def test_stamps_of_zero(found):
    simulation = handled()
    stamps = np.zeros_like(simulation.stamps)
    findings = found(replace(simulation, stamps=stamps), log_times=simulation.stamps)
    assert faults(findings) == {'zero stamps'}


def at_another_rate(rate, stamps_of):
    """Return a recording of so many Hz, and its log times; the filter counts at 100 Hz."""
    simulation = handled()
    times = START + np.arange(len(simulation.stamps)) * 10**9 // rate
    # It turned as far within another time.
    faster = (simulation.truth - simulation.bias) * (rate / 100.0 - 1.0)
    rates = simulation.angular_velocity + faster
    return replace(simulation, stamps=stamps_of(times), angular_velocity=rates), times


@pytest.mark.slow
@pytest.mark.parametrize('rate', [50, 200])
@pytest.mark.parametrize(
    ('stamps_of', 'name'),
    [
        (np.zeros_like, 'zero stamps'),
        (lambda times: times // 1000, 'standing stamps'),
        (lambda times: np.full_like(times, START), 'standing stamps'),
    ],
)
def test_stamps_that_tell_no_time_are_the_only_fault_and_the_log_times_tell_the_rate(
    rate, stamps_of, name, found, tmp_path
):
    simulation, times = at_another_rate(rate, stamps_of)
    findings = found(simulation, log_times=times)
    assert faults(findings) - {'shared stamps'} == {name}
    (finding,) = [finding for finding in findings if finding.name == name]
    assert finding.advice.endswith(f'or set sample_rate: {rate}')
    (summary,) = replay(tmp_path / 'bag', tmp_path / 'out', parameters=Parameters())
    assert 'so that samples are counted at' in summary.status[0].message


@pytest.mark.slow
def test_no_rest(found):
    simulation = handled(rest_seconds=0.0, motions=1, motion_seconds=40.0)
    assert 'rests' in faults(found(simulation))


def orientations(simulation):
    """Return the true orientations of the sensor (n, 4): x, y, z, w."""
    return running_products(from_vectors((simulation.truth - simulation.bias) / 100.0))


def poses(simulation, rotations):
    """Return a topic of poses with these rotations (n, 4), every fourth sample."""
    header, time = (message_type(kind) for kind in ('std_msgs/msg/Header', TIME))
    topic = []
    for stamp, rotation in zip(simulation.stamps[::4].tolist(), rotations[::4], strict=True):
        x, y, z, w = map(float, rotation)
        pose = message_type('geometry_msgs/msg/Pose')(
            message_type('geometry_msgs/msg/Point')(0.0, 0.0, 0.0),
            message_type('geometry_msgs/msg/Quaternion')(x, y, z, w),
        )
        message = message_type(POSE)(header(time(*divmod(stamp, 10**9)), 'map'), pose)
        topic.append((stamp + 2_000_000, serialize(message, POSE)))
    return {('/mocap', POSE): topic}


@pytest.mark.slow
def test_the_orientation_of_the_messages_themselves(found):
    simulation = handled()
    own = orientations(simulation)
    findings = found(simulation, orientations=own)
    assert faults(findings) == set()
    assert 'orientation /imu/data_raw' in of_verdict(findings, FindingVerdict.SOUND)


@pytest.mark.slow
def test_an_orientation_that_turns_the_other_way(found):
    """Without an accelerometer it is what tells of a wrong sign."""
    simulation = handled()
    wrong = replace(
        simulation,
        angular_velocity=simulation.angular_velocity * [1.0, -1.0, 1.0],
        linear_acceleration=np.full_like(simulation.linear_acceleration, np.nan),
    )
    own = orientations(simulation)
    findings = found(wrong, orientations=own)
    assert faults(findings) == {'orientation /imu/data_raw'}
    assert findings[0].values['way'] == '(x, -y, z)'


@pytest.mark.slow
def test_an_orientation_that_nobody_measures(found):
    simulation = handled()
    constant = np.tile([0.0, 0.0, 0.0, 1.0], (len(simulation.stamps), 1))
    assert faults(found(simulation, orientations=constant)) == {'invented orientation'}


@pytest.mark.slow
@pytest.mark.parametrize(
    ('signs', 'accelerometer', 'expected'),
    [
        ((1.0, 1.0, 1.0), True, FindingVerdict.SOUND),
        ((1.0, 1.0, 1.0), False, FindingVerdict.SOUND),
        ((1.0, 1.0, -1.0), False, FindingVerdict.FAULT),
    ],
)
def test_poses_of_a_body_that_the_sensor_is_mounted_on(found, signs, accelerometer, expected):
    simulation = handled()
    mount = from_vectors(np.array([0.3, 1.2, -0.7]))
    topics = poses(simulation, multiply(orientations(simulation), mount))
    force = simulation.linear_acceleration * (1.0 if accelerometer else np.nan)
    turned = replace(
        simulation,
        angular_velocity=simulation.angular_velocity * signs,
        linear_acceleration=force,
    )
    assert 'orientation /mocap' in of_verdict(found(turned, topics=topics), expected)


@pytest.mark.slow
@pytest.mark.parametrize(
    ('sign', 'expected'), [(1.0, FindingVerdict.SOUND), (-1.0, FindingVerdict.FAULT)]
)
def test_a_robot_on_a_floor_is_told_by_its_odometry(found, sign, expected):
    """Gravity says nothing of turns about the vertical; the sensor hangs upside down."""
    simulation = handled()
    upright = (simulation.truth - simulation.bias) * [0.0, 0.0, 1.0]
    noise = simulation.angular_velocity - simulation.truth
    down = replace(
        simulation,
        angular_velocity=sign * upright * [1.0, -1.0, -1.0] + simulation.bias + noise,
        linear_acceleration=np.array([0.0, 0.0, -9.81]) + 10.0 * noise,
    )
    topics = poses(simulation, running_products(from_vectors(upright / 100.0)))
    findings = found(down, topics=topics, deviations=(2e-3, 0.02))
    assert 'orientation /mocap' in of_verdict(findings, expected)
    assert 'axes' in of_verdict(findings, FindingVerdict.UNKNOWN)


REAL = {
    'broad_09_fast_rotation_with_breaks': {'truncated'},
    'broad_24_tapping': {'truncated', 'repeats'},
    # Twice in its last seconds a rate stays at 5.05 and at 5.2 rad/s, without noise.
    'multiposition_xsens': {'scale', 'scale of acceleration', 'clipped'},
    'static_adis16405': set(),
    'static_mpu6050_bursty': {'bursts'},
    'xio_fusion': {'gaps'},
}


@pytest.mark.slow
@pytest.mark.parametrize('name', REAL)
def test_real_recordings_are_told_as_they_are(name):
    """All state zeros for covariances; their log times are their stamps."""
    findings = examined(recorded(RECORDINGS / name))
    assert faults(findings) == REAL[name] | {'zero covariance'}
    assert 'clock' in of_verdict(findings, FindingVerdict.UNKNOWN)


def test_the_command_prints_a_page_and_writes_json(tmp_path, capsys):
    bag = write(tmp_path / 'bag', handled(motions=2))
    file = tmp_path / 'out.json'
    assert main(['doctor', str(bag), '--json', str(file)]) == 0
    text = capsys.readouterr().out
    assert text.startswith('bag, topic /imu/data_raw: sound\n')
    assert max(map(len, text.splitlines())) <= 100
    written = json.loads(file.read_text())
    assert written['sound'] is True
    assert {line['verdict'] for line in written['findings']} <= {'sound', 'unknown'}


def test_a_recording_with_faults_ends_with_status_3(tmp_path, capsys):
    bag = write(tmp_path / 'bag', handled(motions=2), deviations=(0.0, 0.0))
    assert main(['doctor', str(bag), '--topic', '/imu/data_raw', '--end', '30']) == 3
    text = capsys.readouterr().out
    assert text.startswith('bag, topic /imu/data_raw: 1 fault\n')
    assert 'FAULT zero covariance' in text


def test_wrong_options_are_told_before_the_work(tmp_path, capsys):
    bag = tmp_path / 'nothing'
    taken = tmp_path / 'taken.json'
    taken.write_text('')
    for options, text in (
        ([str(bag)], f'no such bag: {bag}'),
        ([str(bag), '--start', '5', '--end', '5'], '--start 5 is not before --end 5'),
        ([str(bag), '--json', str(taken)], f'{taken} exists already'),
        ([str(bag), '--json', str(tmp_path / 'no' / 'x.json')], 'there is no folder'),
    ):
        assert main(['doctor', *options]) == 1
        assert text in capsys.readouterr().err


def test_a_recording_too_short_for_a_rest_is_not_said_to_move(tmp_path, capsys):
    bag = write(tmp_path / 'bag', handled(motions=1))
    assert main(['doctor', str(bag), '--end', '0.05']) == 3
    text = ' '.join(capsys.readouterr().out.split())
    assert 's is too short for a rest of 3 s: its bias is not known' in text


def test_a_time_without_messages_is_told(tmp_path, capsys):
    bag = write(tmp_path / 'bag', handled(motions=1))
    assert main(['doctor', str(bag), '--start', '1000']) == 1
    assert 'no message with an angular velocity' in capsys.readouterr().err


def test_control_characters_do_not_reach_the_terminal():
    assert '\x1b' not in page('\x1b[2J', [Finding('a', FindingVerdict.SOUND, 'b\x1b[1m')])


def test_findings_named_in_tables_exist():
    """A name with a slip in it would leave a consequence beside its fault, and nobody would see."""
    made: set[object] = {rule.name for rule in (*INPUT_RULES, *FILTER_RULES)}
    made |= {f'invented covariance of {quantity}' for quantity in QUANTITIES}
    for module in Path(examination.__file__).parent.glob('*.py'):
        for node in ast.parse(module.read_text()).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                made |= {part.value for part in ast.walk(node) if isinstance(part, ast.Constant)}
    consequences = examination.CONSEQUENCES
    named = examination.OF_UNITS.union(consequences, *consequences.values(), live_rules.LEFT_OUT)
    assert named <= made
