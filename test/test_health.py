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

"""Health: each rule by itself, and what is said of messages that have gone through a filter."""

import math
from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, lfilter

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.methods import ADVICE, METHOD_NAMES, METHODS, Method
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.rest.records import Obstacle
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.filter_rules import FILTER_RULES
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.input_rules import INPUT_RULES
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.messages.rest_obstacle import why_not_at_rest
from gyro_drift_filter.messages.rules import applying
from gyro_drift_filter.messages.span import span_of, usable_outliers
from gyro_drift_filter.messages.telemetry import (
    TELEMETRY,
    MessageReport,
    Telemetry,
    as_telemetry,
)
from gyro_drift_filter.simulation.bag import imu_message
from gyro_drift_filter.simulation.drive import simulate_drive
from support.messages import imu_fields, quiet, serialized, simulated, without_rates
from support.sensor import DEGREE, at_rest, by_hand

RULES = {rule.name: rule for rule in INPUT_RULES + FILTER_RULES}

# Of each rule: what in the present report makes it apply, what does not, and some of its text.
KALMAN = Parameters(method='kalman')
LEARNED = {'noise_blocks': [4, 4, 4], 'measurement_noise': [1e-6, 1e-6, 1e-6]}
CASES = {
    'silent': ({'received': 900}, {'received': 901}, 'is the driver running'),
    'own output': ({'own_outputs': 1}, {}, 'come back on the input'),
    'malformed': ({'malformed': 1, 'last_malformed': 'of dust'}, {}, 'the last because of dust'),
    'no usable rate': ({'refused': 100}, {'refused': 99}, 'nothing is published'),
    'repeated': ({'duplicates': 100}, {'duplicates': 99}, 'again and again'),
    'zero': ({'stuck': True, 'all_zero': True}, {'all_zero': True}, 'exactly 0'),
    'stuck': ({'stuck': True}, {}, 'stayed the same'),
    'frozen axis': ({'faults': [0, 1, 1]}, {'faults': [0, 2, 0]}, 'axes y, z of the gyroscope'),
    'dead axis': ({'faults': [0, 2, 0]}, {'faults': [0, 1, 0]}, 'axis y of the gyroscope'),
    'repeated samples': ({'not_measured': 60}, {'not_measured': 10}, 'at the rate of the sensor'),
    'truncated': (
        {'truncated': True, 'parameters': Parameters(input_quantisation='none')},
        {'truncated': True},
        'to auto or truncate',
    ),
    'low-pass': (
        {
            'noise_correlation': [0.0, 0.0, 0.7],
            'noise_correlation_two_apart': [0.0, 0.0, 0.5],
            **LEARNED,
        },
        {'noise_correlation': [0.3, 0.3, 0.3], **LEARNED},
        'a higher cut-off frequency',
    ),
    'changing frame': ({'frame_changes': 1}, {'frame': 'imu'}, 'two sensors on one topic'),
    'not reported': (
        {'samples': 900, 'not_reported': 100},
        {'samples': 990, 'not_reported': 5},
        'no angular velocity reported (covariance starts with -1)',
    ),
    'degrees': ({'beyond_range': 51}, {'beyond_range': 50}, 'above 35 rad/s'),
    'noise in degrees': (
        {'rate_deviation_at_rest': 3 * [0.06], 'acceleration_deviation_at_rest': 3 * [0.03]},
        {'rate_deviation_at_rest': 3 * [0.06], 'acceleration_deviation_at_rest': 3 * [0.3]},
        'of more than 0.03 rad/s beside a calm accelerometer',
    ),
    'clipped': ({'clipped': [0, 1, 0]}, {}, 'end of the measuring range'),
    'unusable': ({'unusable': [0, 0, 1]}, {}, 'no usable number'),
    'lost': ({'lost': 1}, {}, 'before the node took them'),
    'slow sensor': (
        {'restarts': 5, 'parameters': Parameters(gap_limit=0.012), 'period_blocks': 0},
        {'restarts': 5, 'parameters': Parameters(gap_limit=0.013), 'period_blocks': 0},
        'raise gap_limit',
    ),
    'always restarted': ({'restarts': 501}, {'restarts': 500}, 'in another unit'),
    'restarted': ({'restarts': 1}, {'gaps': 1}, 'jumped by more than gap_limit'),
    'backward': ({'backward_stamps': 51}, {'backward_stamps': 50}, 'stamps go backward'),
    'wrong order': ({'gaps': 5, 'backward_stamps': 3}, {'gaps': 5}, 'in the wrong order'),
    'zero stamps': (
        {'zero_stamps': 1000},
        {'zero_stamps': 1000, 'parameters': Parameters(sample_rate=100.0)},
        'set sample_rate',
    ),
    'standing stamps': ({'stamp': 990_000_000}, {'stamp': 10**9}, 'the stamps hardly advance'),
    'wrong rate': ({'received': 1300}, {'received': 1090}, 'more messages come than their stamps'),
    'gaps': (
        {'gaps': 6, 'backward_stamps': 3},
        {'gaps': 6, 'backward_stamps': 6},
        'lost before they come here',
    ),
    'diverged': ({'divergences': [0, 0, 1]}, {}, 'started anew: look at the raw rates'),
    'outliers': ({'outliers': [0, 110, 0]}, {'outliers': [40, 0, 0]}, 'raise outlier.threshold'),
    'large innovations': (
        {'nis_sum': [0.0, 4100.0, 0.0], 'residual_sum': [0.0, 2100.0, 0.0]},
        {'nis_sum': [9900.0, 0.0, 0.0], 'residual_sum': [900.0, 9900.0, 0.0]},
        'is it a vibration',
    ),
    'small innovations': (
        {'nis_sum': [1000.0, 90.0, 1000.0], 'parameters': KALMAN},
        {'nis_sum': [1000.0, 90.0, 1000.0]},
        'lower model.process_noise',
    ),
    'frozen accelerometer': (
        {'accelerometer_hangs': True},
        {'acceleration_at_rest': 9.8},
        'the accelerometer hangs',
    ),
    'beyond gravity': ({'beyond_gravity': 501}, {'beyond_gravity': 500}, 'mg or counts'),
    'no gravity': (
        {'acceleration_at_rest': 1.0},
        {'acceleration_at_rest': 9.9},
        'the acceleration at rest is 1, where gravity is 9.81 m/s^2',
    ),
    'contradicts gravity': (
        {'contradicts_gravity': True},
        {'contradicts_gravity': True, 'zero_stamps': 1000},
        'are the axes of both sensors the same, with the same signs, and does neither come late? '
        'In free fall no gravity is felt',
    ),
    'no rest': ({'standing_seconds': 130.0}, {'standing_seconds': 110.0}, 'no rest is found'),
    'taken for a turn': (
        {'rest_obstacle': Obstacle.NOT_ACCEPTED, 'seconds_since_rest': 121.0},
        {'rest_obstacle': Obstacle.NOT_ACCEPTED, 'seconds_since_rest': 119.0},
        'call ~/calibrate now',
    ),
    'beyond bias.max': (
        {'rest_beyond_max': True, 'seconds_since_rest': 121.0},
        {'rest_beyond_max': True, 'seconds_since_rest': 119.0},
        'bias.max (10 deg/s)',
    ),
    'no bias for long': (
        {'bias_known': False, 'seconds_since_rest': 11.0},
        {'bias_known': False, 'seconds_since_rest': 9.0},
        'stand still for 3 seconds (the heading drifts until then)',
    ),
    'no bias': (
        {'bias_known': False},
        {'bias_known': False, 'parameters': Parameters(bias_enabled=False)},
        'no bias known yet: stand still for 3 seconds',
    ),
    'little rest': (
        {'noise_blocks': [20, 5, 20]},
        {'noise_blocks': [20, 5, 20], 'bias_known': False},
        'known from 2.5 s of rest only',
    ),
}
# Between the two limits of an alarm.
BETWEEN = {
    'not reported': {'not_reported': 15},
    'wrong rate': {'received': 1150},
    'gaps': {'gaps': 2},
    'repeated samples': {'not_measured': 30},
    'outliers': {'outliers': [70, 0, 0]},
    'large innovations': {'nis_sum': [0.0, 3000.0, 0.0], 'parameters': KALMAN},
    'small innovations': {'nis_sum': [1000.0, 150.0, 1000.0], 'parameters': KALMAN},
}


def report_of(count, **changes):
    """Return the report of a sound filter on so many messages at 100 Hz, with these changes."""
    telemetry = as_telemetry(np.zeros(1, TELEMETRY))[0]._replace(
        samples=count,
        stamp=10_000_000 * count,
        period=0.01,
        samples_per_message=1.0,
        period_blocks=1,
        nis_samples=3 * [count],
        nis_sum=3 * [float(count)],
        bias_known=True,
        noise_blocks=[20, 20, 20],
        noise_block_seconds=0.5,
        least_rest_seconds=2.34,
    )
    of_state = {name: changes.pop(name) for name in Telemetry._fields if name in changes}
    telemetry = telemetry._replace(**of_state)
    return MessageReport(count, 0, '', 0, 0, 0, 0, '', Parameters(), telemetry)._replace(**changes)


def span(**changes):
    """Return ten seconds of a sound filter, with these changes at their end."""
    return span_of(
        report_of(0), report_of(900), report_of(1000, **changes), 10.0, is_rate_judged=True
    )


@pytest.mark.parametrize('name', RULES)
def test_a_rule_applies_where_it_should_and_nowhere_else(name):
    applies, applies_not, text = CASES[name]
    rule, found = RULES[name], span(**applies)
    assert rule.applies(found) is True
    assert rule.applies(span(**applies_not)) is False
    assert text in (rule.text if isinstance(rule.text, str) else rule.text(found))


def test_advice_of_a_method_without_its_own_says_what_to_do():
    texts = Advice().outliers, Advice().large_innovations, Advice().small_innovations
    assert not [text for text in texts if '?' in text]


def test_rules_have_names_of_their_own_and_leave_a_sound_filter_alone():
    assert len(RULES) == len(INPUT_RULES) + len(FILTER_RULES)
    assert CASES.keys() == RULES.keys()
    assert not [rule for rule in RULES.values() if rule.applies(span())]


@pytest.mark.parametrize('name', BETWEEN)
def test_between_two_limits_an_alarm_stays_as_it_was(name):
    rule, between = RULES[name], span(**BETWEEN[name])
    assert rule.applies(between) is None
    assert applying([rule], between, set()) == []
    assert applying([rule], between, {name}) == [rule]


def test_the_worst_comes_first():
    found = applying(INPUT_RULES, span(malformed=1, stuck=True, gaps=3, restarts=1), set())
    assert [rule.name for rule in found] == ['malformed', 'stuck', 'restarted', 'gaps']


@pytest.mark.parametrize(
    ('changes', 'text'),
    [
        ({'received': 700}, 'fewer messages come than their stamps say: are some lost'),
        ({'received': 1300}, 'more messages come than their stamps say: are there two'),
        (
            {'received': 700, 'parameters': Parameters(sample_rate=100.0)},
            'fewer messages come than sample_rate says',
        ),
    ],
)
def test_the_text_of_a_rate_that_is_off(changes, text):
    rule = RULES['wrong rate'].text
    assert callable(rule)
    assert rule(span(**changes)).startswith(text)


def told_each_second(messages):
    """Return the texts of the input's rules by name, after each hundred of messages of 100 Hz."""
    health, filter_, told = Health(), MessageFilter(Parameters()), []
    for first in range(0, len(messages), 100):
        filter_all(filter_, messages[first : first + 100])
        span, of_input, _ = health.rules(filter_.report(), 1.0)
        told.append({rule.name: rule.message(span) for rule in of_input})
    return told


@pytest.mark.parametrize('every', [2, 3, 10])
def test_messages_without_rates_between_others_are_told_as_that(every, random):
    """The rates come as often as their stamps say, whatever comes between them."""
    messages = quiet(2000, 5e-3, random)
    for k in range(0, 2000, every):
        messages[k] = without_rates(imu_fields(messages[k]).stamp)
    told = {text for said in told_each_second(messages) for text in said.values()}
    assert any(text.startswith('some messages report no angular velocity') for text in told)
    assert not any('more messages come' in text or 'fewer messages' in text for text in told)
    assert not [text for text in told if 'gaps' in text and 'without rates' not in text]


def test_a_time_without_rates_is_not_said_to_be_a_clock_that_was_set(random):
    messages = quiet(4200, 5e-3, random)
    for k in range(1500, 3000):
        messages[k] = without_rates(imu_fields(messages[k]).stamp)
    told = told_each_second(messages)
    assert len(told) == 42
    assert all(said.keys() == {'not reported'} for said in told[15:30])
    assert told[30]['restarted'].startswith('stamps of rates jumped by more than gap_limit: mess')
    assert 'come without rates' in told[30]['restarted']
    assert not any('wrong rate' in said for said in told)
    assert told[-1] == {}


@pytest.mark.parametrize('silent', [1, 2, 15])
def test_a_driver_that_paused_is_not_said_to_have_set_its_clock(silent, random):
    """It has been told before that no message came."""
    messages = quiet(4000, 1e-2, random)
    health, filter_, told = Health(), MessageFilter(Parameters()), []
    for second in range(40):
        if not 12 <= second < 12 + silent:
            filter_all(filter_, messages[100 * second : 100 * (second + 1)])
        span, of_input, _ = health.rules(filter_.report(), 1.0)
        told.append({rule.name: rule.message(span) for rule in of_input})
    text = 'no message came for longer than gap_limit: the filter has started anew from there'
    assert [said['restarted'] for said in told if 'restarted' in said] == [text]
    assert all('silent' in said for said in told[12 : 12 + silent])


@pytest.mark.parametrize(('begin', 'end', 'seconds'), [(0, 20, 0), (0, 200, 2), (1000, 2000, 10)])
def test_a_time_without_rates_is_told_for_as_long_as_it_lasts(begin, end, seconds, random):
    """And not for as long as the window holds some of it, nor where a driver starts up."""
    messages = quiet(3000, 1e-2, random)
    for k in range(begin, end):
        messages[k] = without_rates(imu_fields(messages[k]).stamp)
    told = [said['not reported'] for said in told_each_second(messages) if 'not reported' in said]
    assert len(told) == seconds
    assert all(text.startswith('no angular velocity') for text in told)


@pytest.mark.parametrize('untold', [{'zero_stamps': 1000}, {'stamp': 990_000_000}])
def test_gravity_contradicts_nothing_whose_time_nobody_knows(untold):
    """Whoever has told the rate knows for how long the sensor turned, whatever the stamps."""
    rule = RULES['contradicts gravity']
    assert not rule.applies(span(contradicts_gravity=True, **untold))
    told = Parameters(sample_rate=100.0)
    assert rule.applies(span(contradicts_gravity=True, parameters=told, **untold))


@pytest.mark.parametrize(('size', 'text'), [(0.979, '1'), (1.02, '1'), (0.36, '0.4')])
def test_the_acceleration_at_rest_is_told_as_well_as_it_is_known(size, text):
    rule = RULES['no gravity']
    assert callable(rule.text)
    assert rule.applies(span(acceleration_at_rest=size))
    told = rule.text(span(acceleration_at_rest=size))
    assert told.startswith(f'the acceleration at rest is {text}, where')


def test_gravity_that_is_taken_off_or_in_another_unit_is_told_once():
    """Of gravity that is taken off a motion leaves some on the mean that is known."""
    rule = RULES['no gravity']
    assert not rule.applies(span(acceleration_at_rest=0.21))
    assert not rule.applies(span(acceleration_at_rest=1000.0, beyond_gravity=1000))


def test_gravity_contradicts_nothing_while_a_bias_beyond_its_limit_is_left_in():
    rule = RULES['contradicts gravity']
    left_in = {'contradicts_gravity': True, 'segments_beyond_max': 1}
    assert not rule.applies(span(bias_known=False, **left_in))
    assert rule.applies(span(bias_known=True, **left_in))


def test_a_bias_that_only_motion_has_shown_still_asks_for_a_rest():
    rule = RULES['no bias'].text
    assert callable(rule)
    text = rule(span(bias_known=False, bias_corrected=True))
    assert text == 'the bias is known by motion alone: stand still for 3 seconds'


def test_noise_without_any_rest_is_said_to_be_unknown():
    text = RULES['little rest'].text
    assert callable(text)
    assert 'the noise is not known yet: stand' in text(span(noise_blocks=[0, 5, 5]))


def test_a_low_pass_is_not_told_by_what_another_method_has_learned(random):
    """Only `adaptive` learns how samples correlate; after a switch that is of another time."""
    filter_ = MessageFilter(Parameters())
    rates, forces = at_rest(random, 20)
    rates = lfilter([0.1], [1.0, -0.9], rates, axis=0)
    messages = serialized(rates, forces)
    filter_all(filter_, messages[:-100])
    assert Health().rules(filter_.report(), 1.0)[0].low_pass < 5.0
    filter_.filter.configure(Parameters(method='kalman'))
    filter_all(filter_, messages[-100:])
    assert math.isnan(Health().rules(filter_.report(), 1.0)[0].low_pass)


@pytest.mark.parametrize(
    ('order', 'rate', 'cut_off'),
    [
        *((1, 200, 8.0), (1, 400, 20.0), (1, 1000, 42.0)),
        *((2, 200, 20.0), (2, 400, 47.0), (2, 1000, 42.0)),
    ],
)
def test_the_cut_off_of_a_low_pass_is_told_whatever_its_order(order, rate, cut_off, random):
    """One of second order was told at a third of its frequency, with a warning."""
    rates, forces = at_rest(random, 12, rate=rate)
    noise = 2e-3 * random.standard_normal(rates.shape)
    kept = np.exp(-2.0 * np.pi * cut_off / rate)
    low_pass = ([1.0], [1.0, -kept]) if order == 1 else butter(2, cut_off, fs=rate)
    rates = lfilter(*low_pass, noise, axis=0)
    filter_ = MessageFilter(Parameters())
    filter_all(filter_, serialized(rates, forces, rate=rate))
    assert Health().rules(filter_.report(), 1.0)[0].low_pass == pytest.approx(cut_off, rel=0.25)


def test_rates_without_sense_are_told_however_large_they_are():
    """As of a driver that sends memory that it has never written; squares would overflow."""
    filter_ = MessageFilter(Parameters())
    rates = np.full((200, 3), 1e300)
    rates[::2] *= -1.0
    filter_all(filter_, serialized(rates, np.tile([0.0, 0.0, 9.81], (200, 1))))
    assert 'no usable rate' in Health().judge(filter_.report(), 2.0)[0].message


@pytest.mark.parametrize('bias', [0.1, 0.4, 0.5])
def test_a_sensor_of_whole_degrees_is_not_said_to_have_a_low_pass(bias, random):
    """At rest it hardly changes, which says nothing of how its noise is correlated."""
    rates, forces = at_rest(random, 15)
    rates = np.radians(bias) + 0.1 * rates
    moving = by_hand(random, 5)
    rates[1000:] += moving[0]
    forces[1000:] += moving[1]
    rates = np.radians(np.round(np.degrees(rates)))
    filter_, health = MessageFilter(Parameters()), Health()
    messages = serialized(rates, forces)
    for start in range(0, len(messages), 100):
        filter_all(filter_, messages[start : start + 100])
        assert math.isnan(health.rules(filter_.report(), 1.0)[0].low_pass)


def test_a_provisional_bias_is_called_so_and_asks_for_a_rest(random):
    """It is subtracted already, so that it would be wrong to say that none is known."""
    filter_, health = MessageFilter(Parameters()), Health()
    rates, forces = at_rest(random, 2)
    bias = np.array([0.02, -0.01, 0.015])
    filter_all(filter_, serialized(rates + bias, forces))
    subtracted = filter_.filter.state['result']['bias']
    np.testing.assert_allclose(subtracted, bias, atol=2e-3)
    status = health.judge(filter_.report(), 1.0)[1]
    assert status.message == 'the bias is provisional: stand still for 3 seconds'


def test_each_method_has_advice_and_a_new_one_general_advice():
    assert all(all(method.advice[:3]) for method in METHODS)
    assert Method('a new one', 'of its own').advice == Advice()


def filter_all(filter_, messages):
    for data in messages:
        filter_.take(data)


def report(messages, seconds=1.0):
    filter_ = MessageFilter(Parameters())
    health = Health()
    filter_all(filter_, messages)
    return health.judge(filter_.report(), seconds)


@pytest.mark.parametrize('obstacle', Obstacle)
def test_why_there_is_no_rest_is_told_of_each_obstacle(obstacle):
    found = [
        why_not_at_rest(span(rest_obstacle=obstacle, rest_obstacle_signal=k).now.telemetry)
        for k in range(6)
    ]
    of_a_signal = Obstacle.FEW_SAMPLES < obstacle < Obstacle.NOT_ACCEPTED
    assert len(set(found)) == (6 if of_a_signal else 1)
    if of_a_signal:
        assert 'the angular velocity about y' in found[1]
        assert 'the acceleration along z' in found[5]
    assert why_not_at_rest(span(rest_obstacle=obstacle, at_rest=True).now.telemetry) == 'at rest'


def test_a_reason_against_rest_is_told_with_the_warning():
    found = span(standing_seconds=200.0, rest_obstacle=Obstacle.SCATTERS, rest_obstacle_signal=2)
    text = RULES['no rest'].text
    assert not isinstance(text, str)
    assert 'as the mean of the angular velocity about z wanders more than that of noise' in text(
        found
    )


def test_health_of_a_sound_input():
    input_, filter_ = report(simulated(600), seconds=6.0)
    assert (input_.level, filter_.level) == (Level.OK, Level.OK)
    assert input_.values['Actual frequency (Hz)'] == '100'
    assert input_.values['Events since startup'] == '600'
    assert filter_.values['Method'] == Parameters().method
    for key in ('Outliers', 'Process noise Q ((rad/s)^2)', 'Measurement noise R ((rad/s)^2)'):
        for axis in 'xyz':
            assert float(filter_.values[f'{key} {axis}']) >= 0


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_health_says_how_long_the_noise_was_learned(method):
    filter_ = MessageFilter(Parameters(method=method))
    filter_all(filter_, simulated(1200))
    values = Health().judge(filter_.report(), 12.0)[1].values
    key = 'Rest the noise was learned from (s)'
    if ADVICE[method].learns_noise:
        assert all(float(values[f'{key} {axis}']) > 1.0 for axis in 'xyz')
    else:
        assert values[key] == 'not learned from rest'


@pytest.mark.parametrize(
    ('messages', 'level', 'text'),
    [
        ([], Level.STALE, 'no message: is the driver running'),
        ([b'junk'], Level.ERROR, 'messages refused, the last because 4 bytes are too few'),
        (
            [without_rates(10**18)],
            Level.WARN,
            'no angular velocity reported',
        ),
        (
            [imu_message(10**18 + k * 10**7, (90.0, 1, 1), (0, 0, 9.8)) for k in range(50)],
            Level.WARN,
            'the driver may publish degrees per second',
        ),
    ],
)
def test_health_says_what_is_wrong(messages, level, text):
    input_, _ = report(messages)
    assert input_.level == level
    assert text in input_.message


@pytest.mark.parametrize(('unit', 'told'), [(1.0, False), (1.0 / 9.81, True), (0.0, False)])
def test_an_accelerometer_in_other_units_is_told(unit, told, random):
    """Without any, all zeros, there is nothing to be told."""
    filter_ = MessageFilter(Parameters())
    rates, accelerations = at_rest(random, 10)
    filter_all(filter_, serialized(rates, unit * accelerations))
    input_, _ = Health().judge(filter_.report(), 10.0)
    assert ('publish m/s^2' in input_.message) == told


@pytest.mark.parametrize(('unit', 'told'), [(1000.0, True), (2048.0, True), (9.81, False)])
def test_an_accelerometer_in_counts_is_told_although_no_rest_is_found(unit, told, random):
    """Its noise is motion by what accelerometers have."""
    filter_ = MessageFilter(Parameters())
    rates, accelerations = at_rest(random, 10)
    rates += 0.03
    filter_all(filter_, serialized(rates, accelerations * unit / 9.81))
    input_, _ = Health().judge(filter_.report(), 10.0)
    assert filter_.report().telemetry.bias_known != told
    assert ('mg or counts' in input_.message) == told


@pytest.mark.parametrize('value', [0.0, np.nan])
def test_an_axis_of_the_accelerometer_that_does_not_measure_is_asked_for(value, random):
    """What the others show of gravity is too little, and m/s^2 all the same."""
    filter_ = MessageFilter(Parameters())
    rates, accelerations = at_rest(random, 10)
    accelerations += (5.0, 0.0, 8.4 - 9.81)
    accelerations[:, 2] = value
    filter_all(filter_, serialized(rates, accelerations))
    input_, _ = Health().judge(filter_.report(), 10.0)
    assert 'whether each of its axes measures' in input_.message


def test_a_robot_that_turns_steadily_is_not_told_to_have_other_units():
    """Its bias is known from a rest before, so that its rates are in rad/s."""
    text = RULES['beyond bias.max'].text
    assert callable(text)
    assert 'is taken for a turn' in text(span(rest_beyond_max=True))
    assert 'rates in deg/s' in text(span(rest_beyond_max=True, bias_known=False))


@pytest.mark.slow
def test_a_turret_that_slews_evenly_draws_no_warning(random):
    """It turns at 20 deg/s for eight seconds, and stands: a third of the time was a warning."""
    filter_, health = MessageFilter(Parameters()), Health()
    rates, accelerations = at_rest(random, 90)
    seconds = np.arange(len(rates)) / 100.0
    slews = np.clip(np.minimum((seconds - 10.0) % 16.0, 8.0 - (seconds - 10.0) % 16.0), 0.0, 1.0)
    rates[:, 2] += np.where(seconds > 10.0, 20.0 * DEGREE * slews, 0.0)
    for first in range(0, len(rates), 100):
        part, begin = slice(first, first + 100), first / 100.0
        filter_all(filter_, serialized(rates[part], accelerations[part], begin))
        _, judged = health.judge(filter_.report(), begin + 1.0)
        assert judged.level == Level.OK


def test_units_are_doubted_at_once_where_no_bias_is_known():
    rule = RULES['beyond bias.max']
    assert rule.applies(span(rest_beyond_max=True, bias_known=False, seconds_since_rest=3.0))


@pytest.mark.slow
@pytest.mark.parametrize(('warming', 'is_told'), [(0.006, False), (0.03, False), (0.08, True)])
def test_stands_that_are_taken_for_turns_are_told(warming, is_told, monkeypatch):
    """A bias that changes faster than any that is expected leaves each short rest behind."""
    monkeypatch.setattr('gyro_drift_filter.simulation.drive.WARMING', (0.0, 0.0, warming))
    recording = simulate_drive(1, rest=10.0, motion=20.0, motions=6).recording
    messages = serialized(recording.angular_velocity, recording.linear_acceleration)
    filter_, health, found = MessageFilter(Parameters()), Health(), set()
    for start in range(0, len(messages), 100):
        filter_all(filter_, messages[start : start + 100])
        found.add(health.judge(filter_.report(), 1.0)[1].message)
    assert any('is taken for a slow turn' in text for text in found) == is_told


def test_at_a_low_rate_a_rest_takes_longer():
    late = {'standing_seconds': 150.0, 'least_rest_seconds': 144.0}
    assert not RULES['no rest'].applies(span(**late))
    assert RULES['no rest'].applies(span(**(late | {'standing_seconds': 300.0})))


def test_a_single_spike_is_no_sign_of_degrees():
    messages = simulated(100)
    messages[50] = imu_message(imu_fields(messages[50]).stamp, (90.0, 1, 1), (0, 0, 9.8))
    assert report(messages)[0].level == Level.OK


@pytest.mark.parametrize(('unit', 'told'), [(1.0, False), (180.0 / np.pi, True)])
def test_slow_rates_in_degrees_are_told_by_their_noise(unit, told, random):
    """A robot that stands, and whose driver has taken the bias off: no rate is too large."""
    rates = unit * np.radians(0.06) * random.standard_normal((1000, 3))
    accelerations = np.array([0.0, 0.0, 9.81]) + 0.03 * random.standard_normal((1000, 3))
    input_, _ = report(serialized(rates, accelerations), 10.0)
    assert ('degrees per second' in input_.message) == told
    assert input_.level == (Level.WARN if told else Level.OK)


def test_health_reports_unusable_rates():
    messages = simulated(100)
    messages[50] = imu_message(imu_fields(messages[50]).stamp, (np.nan, 1, 1), (0, 0, 9.8))
    input_, _ = report(messages)
    assert input_.level == Level.WARN
    assert 'no usable number' in input_.message


def test_health_reports_a_band_that_is_too_tight():
    """A moving robot under the paper's filter: most samples count as outliers."""
    messages = [
        imu_message(10**18 + k * 10**7, (10 * np.sin(k / 10), 0, 0), (0, 0, 9.8))
        for k in range(400)
    ]
    filter_ = MessageFilter(Parameters(method='kalman', epsilon=1e-3))
    health = Health()
    filter_all(filter_, messages)
    _, status = health.judge(filter_.report(), 4.0)
    assert status.level == Level.WARN
    assert 'set method to adaptive' in status.message


def test_health_reports_a_filter_that_is_inert(random):
    """The paper's filter with its own model, on a sensor a hundred times as quiet."""
    messages = quiet(1500, 5e-5, random)
    filter_ = MessageFilter(Parameters(method='kalman'))
    health = Health()
    filter_all(filter_, messages[:500])
    _, status = health.judge(filter_.report(), 5.0)
    assert status.level == Level.WARN
    assert 'far smaller than the filter expects' in status.message
    assert float(status.values['Normalised innovation squared x']) < 0.1
    filter_.filter.configure(Parameters(method='adaptive'))
    for k in range(5, 15):
        filter_all(filter_, messages[100 * k : 100 * k + 100])
        _, status = health.judge(filter_.report(), 1.0)
    assert (status.level, status.message) == (Level.OK, 'filtering')


def test_levels_do_not_flicker(random):
    """A share of outliers between the two limits keeps the level that there was."""
    filter_ = MessageFilter(Parameters(method='kalman', epsilon=1e-3))
    health = Health()
    state, levels = filter_.filter.state, []
    filter_all(filter_, quiet(300, 5e-3, random))
    state['counts']['samples'] = 0
    for share in [0.0] * 12 + [0.08] * 12 + [0.15] * 12 + [0.08] * 12 + [0.02] * 12:
        state['counts']['samples'] += 1000
        state['counts']['nis_samples'] += 1000
        state['counts']['nis_sum'] += 1000.0
        state['counts']['outliers'][0] += round(1000 * share)
        _, status = health.judge(filter_.report(), 1.0)
        levels.append(status.level)
    assert levels[23] == Level.OK
    assert levels[35] == levels[47] == Level.WARN
    assert levels[59] == Level.OK
    assert sum(a != b for a, b in pairwise(levels)) == 2


def test_a_warning_of_lost_messages_stays_until_there_are_none(random):
    """A gap now and then is a busy machine; many are a bad link, and do not flicker."""
    messages = quiet(6000, 5e-3, random)
    lost = {700, 1700, *range(2000, 3000, 60)}
    health, filter_, warned = Health(), MessageFilter(Parameters()), []
    for second in range(60):
        part = [messages[k] for k in range(100 * second, 100 * second + 100) if k not in lost]
        filter_all(filter_, part)
        warned.append('gaps in the stamps' in health.judge(filter_.report(), 1.0)[0].message)
    assert warned == 20 * [False] + 20 * [True] + 20 * [False]


@pytest.mark.slow
def test_stamps_of_arrival_are_sound(random):
    """200 Hz, late by 1.5 ms on the mean: both rates are right, and nothing is lost."""
    stamps = 10**18 + np.arange(6000) * 5_000_000 + random.exponential(1.5e6, 6000).astype(int)
    messages = [
        imu_message(int(stamp), 0.005 * random.standard_normal(3), (0, 0, 9.8))
        for stamp in np.maximum.accumulate(stamps)
    ]
    health, filter_ = Health(), MessageFilter(Parameters())
    for k in range(30):
        filter_all(filter_, messages[200 * k : 200 * k + 200])
        status, _ = health.judge(filter_.report(), 1.0)
        assert (status.level, status.message) == (Level.OK, 'receiving')
    for key in ('Actual frequency (Hz)', 'Expected frequency (Hz)'):
        assert float(status.values[key]) == pytest.approx(200.0, rel=0.002)


@pytest.mark.parametrize('sample_rate', [0.0, 10.0])
def test_messages_of_a_sensor_that_is_polled_are_expected_as_often_as_they_come(sample_rate):
    """100 Hz for 10 Hz: `sample_rate` is that of the sensor, whether given or learned."""
    polled = span(
        parameters=Parameters(sample_rate=sample_rate), period=0.1, samples_per_message=0.1
    )
    assert polled.expected_rate == pytest.approx(100.0)


def test_a_rate_that_is_off_is_reported(random):
    messages = quiet(3000, 5e-3, random)
    for parameters, part, message in (
        (Parameters(sample_rate=200.0), 100, 'fewer messages come than sample_rate says'),
        (Parameters(sample_rate=100.0), 100, 'receiving'),
        (Parameters(), 50, 'fewer messages come than their stamps say: are some lost'),
        (Parameters(), 200, 'more messages come than their stamps say'),
    ):
        filter_ = MessageFilter(parameters)
        health = Health()
        for k in range(14):
            filter_all(filter_, messages[part * k : part * (k + 1)])
            status, _ = health.judge(filter_.report(), 1.0)
        assert status.message.startswith(message)
        assert status.level == (Level.OK if message == 'receiving' else Level.WARN)


def texts(health, parts, filter_):
    """Return the messages of the input after each part, a second each."""
    messages = []
    for part in parts:
        filter_all(filter_, part)
        messages.append(health.judge(filter_.report(), 1.0)[0].message)
    return messages


@pytest.mark.slow
@pytest.mark.parametrize(('before', 'after'), [(100, 200), (200, 100), (100, 400), (400, 50)])
def test_a_driver_that_changes_its_rate_has_no_second_publisher(before, after, random):
    """Its messages are as many as their stamps say, whatever the period learned is so far."""
    rates = np.repeat([before, after], [20 * before, 25 * after])
    stamps = 10**18 + np.cumsum(10**9 // rates)
    data = [
        imu_message(stamp, 5e-3 * random.standard_normal(3), [0.0, 0.0, 9.8])
        for stamp in stamps.tolist()
    ]
    parts = [data[before * k : before * (k + 1)] for k in range(20)]
    parts += [data[20 * before + after * k : 20 * before + after * (k + 1)] for k in range(25)]
    found = texts(Health(), parts, MessageFilter(Parameters()))
    assert found == len(found) * ['receiving']


def test_a_silence_is_no_wrong_rate(random):
    """Before the driver starts, while it pauses, and what was kept meanwhile."""
    data = quiet(4000, 5e-3, random)
    seconds = [data[100 * k : 100 * k + 100] for k in range(40)]
    for parameters in (Parameters(), Parameters(sample_rate=100.0)):
        filter_ = MessageFilter(parameters)
        parts = [*[[]] * 15, data[:40], *seconds[1:12], [], [], data[1200:1230], *seconds[13:20]]
        found = texts(Health(), parts, filter_)
        assert not [text for text in found if 'messages come' in text]
        filter_ = MessageFilter(parameters)
        found = texts(Health(), [*[[]] * 9, data[:2000], *seconds[20:]], filter_)
        assert not [text for text in found if 'messages come' in text]


def test_a_message_that_comes_again_and_again(random):
    data = quiet(300, 5e-3, random)
    filter_ = MessageFilter(Parameters())
    found = texts(Health(), [data[:100], data[100:200], 100 * [data[199]]], filter_)
    assert found[1] == 'receiving'
    assert found[2].startswith('the same message comes again and again')


def test_messages_that_come_after_the_next_one_are_not_lost(random):
    """One in forty does, as behind a relay that runs its callbacks in several threads."""
    messages = quiet(2000, 5e-3, random)
    for k in range(400, 2000, 40):
        messages[k], messages[k + 1] = messages[k + 1], messages[k]
    parts = [messages[k : k + 100] for k in range(0, 2000, 100)]
    found = texts(Health(), parts, MessageFilter(Parameters()))
    assert found[-1].startswith('stamps leave gaps and go back')
    assert not [text for text in found if 'lost' in text]


def test_stamps_that_go_to_and_fro_or_are_none(random):
    """Two sensors of one name; a driver that does not stamp."""
    a, b = quiet(1200, 5e-3, random), quiet(1200, 5e-3, random)
    late = [
        imu_message(imu_fields(m).stamp - 20_000_000, imu_fields(m).angular_velocity, (0, 0, 9.8))
        for m in b
    ]
    both = [message for pair in zip(a, late, strict=True) for message in pair]
    filter_ = MessageFilter(Parameters())
    found = texts(Health(), [both[200 * k : 200 * k + 200] for k in range(12)], filter_)
    assert found[-1].startswith('many stamps go backward')
    none = [imu_message(0, imu_fields(m).angular_velocity, (0, 0, 9.8)) for m in a]
    for rate, text in ((0.0, 'the driver does not stamp'), (100.0, 'receiving')):
        filter_ = MessageFilter(Parameters(sample_rate=rate))
        found = texts(Health(), [none[100 * k : 100 * k + 100] for k in range(12)], filter_)
        assert found[-1].startswith(text)
    polled = [none[k // 4] for k in range(2400)]
    one_in_60 = [none[k // 60 * 59 + min(k % 60, 58)] for k in range(1200)]
    for given, expected in (
        (polled, {'zero stamps', 'repeated samples'}),
        (one_in_60, {'zero stamps'}),
    ):
        health = Health()
        filter_ = MessageFilter(Parameters())
        for k in range(len(given) // 200):
            filter_all(filter_, given[200 * k : 200 * k + 200])
            _, rules, _ = health.rules(filter_.report(), 1.0)
        assert expected <= {rule.name for rule in rules}


@pytest.mark.slow
def test_stamps_that_stand_or_are_in_another_unit(random):
    """Whole seconds, and a whole buffer with one stamp, tell the time all the same."""
    messages = quiet(2000, 5e-3, random)
    starts = range(0, len(messages), 100)

    def last_text(stamp_of):
        given = [
            imu_message(stamp_of(imu_fields(m).stamp), imu_fields(m).angular_velocity, (0, 0, 9.8))
            for m in messages
        ]
        filter_ = MessageFilter(Parameters())
        return texts(Health(), [given[start : start + 100] for start in starts], filter_)[-1]

    for stamp_of in (lambda stamp: 10**18, lambda stamp: stamp // 1000):
        assert last_text(stamp_of).startswith('the stamps hardly advance')
    too_large = last_text(lambda stamp: 10**18 + (stamp - 10**18) * 1000)
    assert too_large.startswith('most stamps are farther than gap_limit from the one before')
    for step in (10**8, 10**9):
        assert last_text(lambda stamp, step=step: stamp // step * step) == 'receiving'


@pytest.mark.slow
def test_a_dead_band_and_coarse_steps_are_no_fault(random):
    """Zeros at rest are noise that is not there; a flat top of a turn is not the range's end."""
    step = np.radians(0.061)
    seconds = np.arange(6000) / 200.0
    turn = 2.5 + 0.5 * np.sin(2 * np.pi * 0.3 * seconds)
    rates = turn[:, None] + np.radians(0.05) * random.standard_normal((6000, 3))
    rates = np.round(rates / step) * step
    filter_ = MessageFilter(Parameters())
    messages = [
        imu_message(10**18 + 5_000_000 * k, rate, [0, 0, 9.8] + 0.02 * random.standard_normal(3))
        for k, rate in enumerate(rates)
    ]
    health = Health()
    found = texts(health, [messages[200 * k : 200 * k + 200] for k in range(30)], filter_)
    assert set(found) == {'receiving'}
    still = [
        imu_message(2 * 10**18 + 5_000_000 * k, (0, 0, 0), 0.02 * random.standard_normal(3))
        for k in range(4000)
    ]
    for k in range(20):
        filter_all(filter_, still[200 * k : 200 * k + 200])
        input_, status = health.judge(filter_.report(), 1.0)
        said = input_.message, status.message.partition(';')[0]
        assert k < 2 or said == ('receiving', 'filtering')


def test_what_another_method_did_is_no_fault_of_the_new_one():
    """The advice was to change the new method, for what the one before it had flagged."""
    health = Health()
    for second in range(1, 21):
        changed = second > 10
        outliers = [50 * min(second, 10), 0, 0]
        parameters = Parameters(method='adaptive' if changed else 'sage_husa')
        now = report_of(100 * second, outliers=outliers, parameters=parameters)
        _, of_filter = health.judge(now, 1.0)
        assert second not in range(8, 11) or 'outliers' in of_filter.message
        assert not changed or of_filter.message == 'filtering'


def test_telemetry_is_that_of_the_state():
    filter_ = MessageFilter(Parameters())
    filter_all(filter_, [*simulated(500), b'junk'])
    state, telemetry = filter_.filter.state, filter_.report().telemetry
    counts, clock, bias = state['counts'], state['clock'], state['bias']
    checks, noise = (
        state['checks'],
        filter_.filter.record[0]['state']['methods']['adaptive']['noise'],
    )
    ends = checks['range_end']
    deviations = [math.sqrt(signal['variance']) for signal in bias['rest']['signals']]
    wander = np.sqrt(np.maximum(bias['wander'], 0.0))
    expected = {
        **{name: counts[name] for name in ('samples', 'duplicates', 'refused')},
        **{name: ends[name] for name in ('at_limit', 'clipped', 'clipped_calibrated')},
        **{name: checks[name] for name in ('beyond_range', 'beyond_gravity', 'times_stuck')},
        'unusable': checks['unusable'],
        'not_measured': state['polling']['not_measured'],
        'samples_per_message': 1.0,
        'faults': checks['fault'],
        'truncated': state['quantisation']['truncated'],
        'count_size': np.zeros(3),
        'noise_correlation': noise['autocorrelation'][:, 0],
        'noise_correlation_two_apart': noise['autocorrelation'][:, 1],
        'noise_blocks': noise['blocks'],
        'noise_block_seconds': pytest.approx(0.5, rel=1e-3),
        'rate_deviation_at_rest': deviations[:3],
        'acceleration_deviation_at_rest': deviations[3:],
        'standing_seconds': bias['rest']['standing_seconds'],
        'rest_obstacle': bias['rest']['obstacle'],
        'rest_obstacle_signal': bias['rest']['obstacle_signal'],
        # Sixteen blocks of 13 samples, one before them, and one after them.
        'least_rest_seconds': pytest.approx(18 * 0.13),
        'outliers': counts['outliers'],
        'outlier_reason': counts['outlier_reason'],
        'last_outlier': counts['last_outlier'],
        'outlier_method': counts['outlier_method'],
        **{name: counts[name] for name in ('nis_samples', 'nis_sum', 'residual_sum')},
        'period_blocks': clock['blocks'],
        **{name: clock[name] for name in ('gaps', 'missing_samples')},
        'period': clock['mean_period'],
        **{name: clock[name] for name in ('restarts', 'zero_stamps', 'same_stamps')},
        'backward_stamps': clock['backward_stamps'],
        'overtaken': clock['overtaken'],
        'stamp': clock['stamp'],
        'divergences': [axis['divergences'] for axis in state['methods']['paper']],
        'stuck': checks['stuck'],
        'accelerometer_hangs': checks['accelerometer_hangs'],
        'contradicts_gravity': bias['contradicts'],
        'all_zero': not checks['measured'].any(),
        'process_noise': state['result']['process_noise'],
        'measurement_noise': state['result']['measurement_noise'],
        'rest_beyond_max': bias['rest_beyond_max'] or bias['shaken_stand']['beyond_max'],
        **{name: bias[name] for name in ('bias', 'seconds_since_rest', 'segments')},
        **{name: bias[name] for name in ('segments_beyond_max', 'segments_turning')},
        'bias_known': bias['known'],
        'bias_corrected': bias['corrected'] > 0,
        'bias_provisional': bias['provisional_variance'][0] > 0.0,
        'bias_deviation': np.hypot(filter_.filter.bias_deviation, wander),
        'at_rest': bias['rest']['at_rest'],
        'acceleration_at_rest': bias['rest']['at_rest'] * np.linalg.norm(bias['rest']['gravity']),
    }
    assert expected.keys() == telemetry._asdict().keys(), 'each value needs a line in `expected`'
    for name, value in telemetry._asdict().items():
        np.testing.assert_array_equal(value, expected[name], err_msg=name)
    assert telemetry.samples == 500
    assert telemetry.segments > 0


@pytest.mark.parametrize(('rate', 'seconds'), [(10, 5.0), (50, 1.0), (100, 0.5), (333, 0.5)])
def test_blocks_of_noise_are_longer_at_low_rates(rate, seconds, random):
    """They have 50 samples or more."""
    filter_ = MessageFilter(Parameters())
    filter_all(filter_, serialized(*at_rest(random, 40, rate=rate), rate=rate))
    telemetry = filter_.report().telemetry
    np.testing.assert_allclose(telemetry.noise_block_seconds, seconds, rtol=1e-3)
    learned = np.array(telemetry.noise_blocks) * telemetry.noise_block_seconds
    assert (learned > 10.0).all()
    assert (learned < 40.0).all()


@pytest.mark.parametrize(
    ('rate', 'seconds'), [(5, 29), (10, 15), (20, 8), (50, 3), (100, 3), (400, 3)]
)
def test_the_first_rest_takes_as_long_as_it_is_said_to(rate, seconds, random):
    filter_, health = MessageFilter(Parameters()), Health()
    rates, forces = at_rest(random, 40, rate=rate)
    messages = serialized(rates, forces, rate=rate)
    early = (seconds - 1) * rate
    filter_all(filter_, messages[:early])
    status = health.judge(filter_.report(), 1.0)[1]
    assert status.message == f'no bias known yet: stand still for {seconds} seconds'
    filter_all(filter_, messages[early : early + rate])
    assert filter_.report().telemetry.bias_known


def test_before_the_first_rest_the_values_are_those_of_a_sensor_that_was_switched_on(random):
    """Moving, and then at rest: no value is nan, and no rest is counted from that never was."""
    filter_, health, statuses = MessageFilter(Parameters()), Health(), []
    (rates, forces), (turn, push) = at_rest(random, 20), by_hand(random, 12)
    rates[:1200] += turn
    forces[:1200] += push
    messages = serialized(rates, forces)
    for k in range(20):
        filter_all(filter_, messages[100 * k : 100 * k + 100])
        statuses.append(health.judge(filter_.report(), 1.0)[1])
    text = 'no bias known yet: stand still for 3 seconds'
    assert (statuses[0].level, statuses[0].message) == (Level.OK, text)
    assert statuses[10].level == Level.WARN
    assert statuses[10].message.startswith(text)
    assert statuses[10].values['Time since rest (s)'] == 'no rest yet'
    for axis in 'xyz':
        deviation = float(statuses[10].values[f'Deviation of the bias at rest (rad/s) {axis}'])
        assert deviation == pytest.approx(Parameters().bias_turn_on_deviation, rel=1e-3)
    assert (statuses[-1].level, statuses[-1].message) == (Level.OK, 'filtering')
    assert float(statuses[-1].values['Time since rest (s)']) < 1.0


def test_counts_that_a_reset_clears_are_no_fault(random):
    filter_, health = MessageFilter(Parameters()), Health()
    messages = quiet(500, 5e-3, random)
    for k in range(88, 100):
        stamp = imu_fields(messages[k]).stamp
        rates = (8.7 if k < 97 else np.nan, 0.01 + 0.001 * k, 0.02)
        messages[k] = imu_message(stamp, rates, (0, 0, 9.8))
    filter_all(filter_, messages[:100])
    assert 'end of the measuring range' in health.judge(filter_.report(), 1.0)[0].message
    assert any(filter_.report().telemetry.unusable)
    filter_.filter.reset()
    filter_all(filter_, messages[100:300])
    assert health.judge(filter_.report(), 2.0)[0].message == 'receiving'


@pytest.mark.parametrize(
    ('none', 'axes'), [(slice(500, None, 8), slice(0, 3)), (slice(0, None), slice(0, 1))]
)
def test_what_is_no_number_is_no_outlier_whose_cause_is_a_bad_cable(none, axes, random):
    rates, forces = at_rest(random, 10)
    rates[none, axes] = np.nan
    filter_ = MessageFilter(Parameters())
    filter_all(filter_, serialized(rates, forces))
    span, of_input, of_filter = Health().rules(filter_.report(), 10.0)
    assert span.outlier_shares == pytest.approx(3 * [0.0], abs=2e-3)
    assert 'unusable' in {rule.name for rule in of_input}
    assert 'outliers' not in {rule.name for rule in of_filter}


def test_spikes_beside_what_is_no_number_are_outliers_still(random):
    rates, forces = at_rest(random, 10)
    rates[:5] = np.nan  # refused, as nothing was predicted
    rates[500::8, 1] = np.nan
    spikes = slice(503, None, 6)
    rates[spikes, 2] += random.choice((-1.0, 1.0), len(rates[spikes]))
    filter_ = MessageFilter(Parameters())
    filter_all(filter_, serialized(rates, forces))
    x, y, z = usable_outliers(filter_.report().telemetry)
    assert max(x, y) <= 5
    assert z > 40


def test_health_survives_a_reset():
    filter_ = MessageFilter(Parameters())
    health = Health()
    filter_all(filter_, simulated(300))
    health.judge(filter_.report(), 3.0)
    filter_.filter.reset()
    filter_all(filter_, simulated(100))
    input_, status = health.judge(filter_.report(), 1.0)
    assert (input_.level, status.level) == (Level.OK, Level.OK)
    assert status.values['Outliers of late (%) x'] == 'nan'  # too few to tell
    filter_all(filter_, simulated(400)[100:])
    _, status = health.judge(filter_.report(), 3.0)
    assert 0 < float(status.values['Outliers of late (%) x']) < 10
