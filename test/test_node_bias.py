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

"""The bias in the real node: remembered over a kill, calibrated, hinted at, warmed, reported."""

import json
import re
import time

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Twist
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import Imu, Temperature
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.memory_file import file_of, recall
from gyro_drift_filter.messages.motion_hint import HINT_TYPES
from gyro_drift_filter.simulation.bag import FRAME, imu_messages
from harness.live_node import LOSSLESS, LiveNode
from support.messages import START, doubles_of, imu_fields, serialized
from support.node import NODE, TRUTH, call, diagnostics, set_parameters, values
from support.sensor import DEGREE, at_rest, by_hand, taking_off

pytestmark = pytest.mark.node

FILTER = '/gyro_drift_filter: filter'
INPUT = '/gyro_drift_filter: input'


def rates_of(messages):
    return np.array([imu_fields(message).angular_velocity for message in messages])


def bias_of(live):
    """Return the bias in rad/s that the node knows of, from its diagnostics."""
    found = values(diagnostics(live, lambda statuses: FILTER in statuses)[FILTER])
    return np.array([float(found[f'Bias at rest (rad/s) {axis}']) for axis in 'xyz'])


def deviations_of(messages):
    """Return what the messages claim of their rates, (n, 3) in rad/s."""
    return np.sqrt([doubles_of(message)[16:25:4] for message in messages])


@pytest.fixture
def home(tmp_path, monkeypatch):
    """Return a folder for ROS_HOME, here and in the node."""
    folder = tmp_path / 'ros_home'
    monkeypatch.setenv('ROS_HOME', str(folder))
    return folder


def test_after_a_kill_the_first_output_has_the_bias_off(home, random):
    path = file_of(NODE, FRAME)
    with LiveNode(home=home) as live:
        unknown = live.play(serialized(*at_rest(random, 20, TRUTH)))
        live.wait(path.exists, 'the file of the bias')
        live.process.kill()
        live.process.wait()
    assert live.returncode == -9
    remembered = recall(path, NODE, FRAME, 0.2)
    np.testing.assert_allclose(remembered.bias, TRUTH, atol=0.03 * DEGREE)

    data = serialized(*at_rest(random, 1, TRUTH), start=1000)
    with LiveNode(home=home) as live:
        out = live.play(data)
    degrees = ', '.join(f'{value:.3f}' for value in np.degrees(remembered.bias))
    assert re.search(f'bias of [0-2] min ago, {re.escape(degrees)} deg/s', live.log)
    first = rates_of(data[:1])[0] - rates_of(out[:1])[0]
    np.testing.assert_allclose(first, remembered.bias, atol=1e-6)
    turn_on_deviation = Parameters().bias_turn_on_deviation
    assert (np.abs(rates_of(unknown)) <= 2.0 * deviations_of(unknown)).mean() > 0.9
    assert (deviations_of(unknown[:80]) > turn_on_deviation).all()  # not even provisional
    # The first samples tell what the noise is.
    later = deviations_of(out[50:])
    assert ((later > 8e-3) & (later < 0.5 * turn_on_deviation)).all()


def test_an_end_by_interrupt_saves_what_came_since_the_last_time(home, random):
    with LiveNode(home=home) as live:
        live.play(serialized(*at_rest(random, 10, TRUTH)))
        live.wait(file_of(NODE, FRAME).exists, 'the file of the bias')
        before = file_of(NODE, FRAME).read_text()
        live.play(serialized(*at_rest(random, 10, TRUTH), start=10))
    assert live.returncode == 0
    assert file_of(NODE, FRAME).read_text() != before


def test_a_flight_without_a_rest_is_remembered_at_its_end(home, random):
    with LiveNode(home=home) as live:
        live.play(serialized(*taking_off(random, 5, TRUTH)))
    remembered = recall(file_of(NODE, FRAME), NODE, FRAME, 0.2)
    assert remembered.provisional
    np.testing.assert_allclose(remembered.bias, TRUTH, atol=0.3 * DEGREE)
    data = serialized(*at_rest(random, 0.1, TRUTH), start=1000)
    with LiveNode(home=home) as live:
        out = live.play(data)
        status = diagnostics(live, lambda statuses: FILTER in statuses)[FILTER]
    first = rates_of(data[:1])[0] - rates_of(out[:1])[0]
    # In motion what is known of the shift counts, too.
    np.testing.assert_allclose(first, remembered.bias, atol=1e-4)
    assert status.message == 'no bias known yet: stand still for 3 seconds'


def test_the_bias_of_another_frame_is_not_kept_as_that_of_this_one(home, random):
    """The driver restarts with another sensor while the node runs on."""
    with LiveNode(home=home) as live:
        live.play(serialized(*at_rest(random, 10, TRUTH)))
        live.wait(file_of(NODE, FRAME).exists, 'the file of the bias')
        before = file_of(NODE, FRAME).read_text()
        rates, accelerations = at_rest(random, 10, (-0.05, 0.05, 0.05))
        stamps = START + 10_000_000 * (1100 + np.arange(len(rates)))
        other = imu_messages(stamps, rates, accelerations, frame='other_imu')
        live.play([message for _, message in other])
    assert file_of(NODE, FRAME).read_text() == before
    assert len(list(file_of(NODE, FRAME).parent.iterdir())) == 1


def test_what_a_second_publisher_may_have_shown_is_not_kept(home, random):
    """As of a recording that is played beside the driver."""
    path = file_of(NODE, FRAME)
    with LiveNode(home=home) as live:
        live.play(serialized(*at_rest(random, 10, TRUTH)))
        live.wait(path.exists, 'the file of the bias')
        before = path.read_text()
        second = live.node.create_publisher(Imu, 'imu/data_raw', 10)
        diagnostics(live, lambda s: '2 publishers on' in s[INPUT].message)
        live.play(serialized(*at_rest(random, 30, -TRUTH), start=10))
        diagnostics(live, lambda s: INPUT in s)
        live.node.destroy_publisher(second)
        diagnostics(live, lambda s: '2 publishers on' not in s[INPUT].message)
    assert path.read_text() == before
    assert live.log.count('the input has had several publishers') == 1


def test_without_memory_nothing_is_kept(home, random):
    with LiveNode([*LOSSLESS, '-p', 'bias.memory:=false'], home=home) as live:
        live.play(serialized(*at_rest(random, 10, TRUTH)))
        assert np.abs(bias_of(live) - TRUTH).max() < 0.1 * DEGREE
    assert not home.exists() or not list(home.rglob('*.json'))


FOREIGN = {
    'format': 2,
    'node': '/other',
    'frame': FRAME,
    'bias': [0.1, 0.1, 0.1],
    'deviation': [1e-4, 1e-4, 1e-4],
    'shift': [0.0, 0.0, 0.0],
    'shift_deviation': [1e-4, 1e-4, 1e-4],
    'time': 2e9,
}


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('', 'is damaged'),
        ('{"bias": [0.1', 'is damaged'),
        (json.dumps(FOREIGN), 'is of another node'),
    ],
)
def test_a_file_that_does_not_fit_is_ignored_and_replaced(content, message, home, random):
    path = file_of(NODE, FRAME)
    path.parent.mkdir(parents=True)
    path.write_text(content)
    data = serialized(*at_rest(random, 10, TRUTH))
    with LiveNode(home=home) as live:
        out = live.play(data)
        live.wait(lambda: path.read_text() != content, 'a new file')
    assert f'the bias of the last run is not used: {path} {message}' in live.log
    np.testing.assert_allclose(rates_of(out[:1]), rates_of(data[:1]), rtol=1e-12)
    np.testing.assert_allclose(recall(path, NODE, FRAME, 0.2).bias, TRUTH, atol=0.1 * DEGREE)


def test_a_disk_that_takes_nothing_costs_a_warning(home, random):
    file_of(NODE, FRAME).parent.parent.mkdir()
    file_of(NODE, FRAME).parent.write_text('a file where the folder should be')
    with LiveNode(home=home) as live:
        out = live.play(serialized(*at_rest(random, 10, TRUTH)))
        diagnostics(live, lambda statuses: FILTER in statuses)
        out += live.play(serialized(*at_rest(random, 10, TRUTH), start=10))
    assert live.returncode == 0
    assert len(out) == 2000
    assert live.log.count('the bias will not be remembered') == 1
    assert 'set bias.memory to false' in live.log


@pytest.fixture(scope='module')
def live():
    with LiveNode([*LOSSLESS, '-p', 'bias.memory:=false', '-p', 'motion_hint:=twist']) as node:
        yield node


@pytest.fixture
def fresh(live):
    """Return the node without a bias and without a sample."""
    for initial in ([0.1, 0.1, 0.1], [0.0, 0.0, 0.0]):
        assert set_parameters(live, bias__initial=initial)[0].successful
    assert call(live, Trigger, 'reset', Trigger.Request()).success
    return live


def test_rest_is_told_when_it_changes(fresh, random):
    told = []
    latched = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    still, (turn, push) = at_rest(random, 10), by_hand(random, 3)
    moving = at_rest(random, 3)
    fresh.play(serialized(*still))
    subscription = fresh.node.create_subscription(
        Bool, f'{NODE}/at_rest', lambda message: told.append(message.data), latched
    )
    fresh.wait(lambda: told, 'what was last said of rest')
    fresh.play(serialized(moving[0] + turn, moving[1] + push, start=10))
    fresh.wait(lambda: len(told) > 1, 'the begin of motion')
    fresh.play(serialized(*still, start=13))
    fresh.wait(lambda: len(told) > 2, 'the next rest')
    fresh.node.destroy_subscription(subscription)
    assert told == [True, False, True]


def test_calibrate(fresh, random):
    def calibrate():
        return call(fresh, Trigger, 'calibrate', Trigger.Request())

    answer = calibrate()
    assert not answer.success
    assert answer.message.startswith('no rate has come yet that can be used')
    fresh.play(serialized(*at_rest(random, 4)))
    answer = calibrate()
    assert not answer.success
    assert 'has stood still for' in answer.message
    # About the vertical a bias that jumps is a turn, until somebody says that it is none.
    truth = np.array([0.0, 0.0, -1.0]) * DEGREE
    fresh.play(serialized(*at_rest(random, 20, truth), start=4))
    assert np.abs(bias_of(fresh)).max() < 0.1 * DEGREE
    answer = calibrate()
    assert answer.success
    found = np.array([float(word) for word in answer.message[5:-6].split(',')]) * DEGREE
    np.testing.assert_allclose(found, truth, atol=0.06 * DEGREE)
    np.testing.assert_allclose(bias_of(fresh), found, atol=1e-5)


def test_a_hint_of_motion_keeps_a_slow_turn_out(fresh, random):
    hints = fresh.node.create_publisher(Twist, 'motion_hint', 10)
    fresh.wait(lambda: hints.get_subscription_count() > 0, 'the node to listen')
    turning, word = Twist(), serialized(*at_rest(random, 20, (0.0, 0.0, 2.0 * DEGREE)))
    turning.angular.z = 0.03
    for start in range(0, len(word), 40):
        hints.publish(turning)
        fresh.play(word[start : start + 40])
    assert (bias_of(fresh) == 0.0).all()
    for start in range(0, len(word), 40):
        hints.publish(Twist())
        fresh.play(
            serialized(*at_rest(random, 0.4, (0.0, 0.0, 2.0 * DEGREE)), start=20 + start / 100)
        )
    assert bias_of(fresh)[2] == pytest.approx(2.0 * DEGREE, rel=0.1)
    fresh.node.destroy_publisher(hints)


def test_the_type_of_the_hint_changes_while_it_runs(fresh):
    """DDS refuses a second type of a topic: the node ended with a traceback."""

    def types():
        endpoints = fresh.node.get_subscriptions_info_by_topic('/motion_hint')
        return [endpoint.topic_type for endpoint in endpoints]

    for kind in ('odometry', 'none', 'twist_stamped', 'twist'):
        assert set_parameters(fresh, motion_hint=kind)[0].successful
        expected = [HINT_TYPES[kind]] if kind in HINT_TYPES else []
        fresh.wait(lambda expected=expected: types() == expected, f'the node to listen to {kind}')


def test_a_hint_that_can_not_come_is_told(fresh, random):
    """The robot would turn slowly at what is taken for rest, and nobody knew why."""
    messages, seen, sent = serialized(*at_rest(random, 120)), [], 0
    listener = fresh.node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda array: seen.extend(array.status), 10
    )
    begin = time.monotonic()

    def is_told(*words):
        nonlocal sent
        while sent < 100.0 * (time.monotonic() - begin):  # as a driver does
            fresh.publish(messages[sent])
            sent += 1
        texts = [status.message for status in seen if status.name == INPUT]
        return bool(texts) and all(word in texts[-1] for word in words)

    nobody = 'motion_hint is twist, but nobody publishes /motion_hint: is the topic'
    fresh.wait(lambda: is_told(nobody), 'a hint that nobody publishes')
    wheels = fresh.node.create_publisher(Odometry, 'motion_hint', 10)
    other = fresh.node.create_publisher(Twist, 'cmd_vel', 10)
    wrong = '/player publishes nav_msgs/msg/Odometry on /motion_hint: set motion_hint to'
    fresh.wait(lambda: is_told('motion_hint is twist, but', wrong), 'a hint of another type')
    fresh.node.destroy_publisher(wheels)
    fresh.wait(lambda: is_told(nobody, 'geometry_msgs/msg/Twist is on: /cmd_vel'), 'who has it')
    fresh.node.destroy_publisher(other)
    # A command that does not come while the robot stands is no fault.
    commands = fresh.node.create_publisher(Twist, 'motion_hint', 10)
    fresh.wait(lambda: is_told('receiving'), 'no fault')
    fresh.node.destroy_publisher(commands)
    fresh.node.destroy_subscription(listener)


def test_warmth_widens_the_bias(fresh, random):
    def deviation():
        found = values(diagnostics(fresh, lambda statuses: FILTER in statuses)[FILTER])
        return float(found['Deviation of the bias at rest (rad/s) x'])

    thermometer = fresh.node.create_publisher(Temperature, 'imu/temperature', 10)
    fresh.wait(lambda: thermometer.get_subscription_count() > 0, 'the node to listen')
    fresh.play(serialized(*at_rest(random, 10)))
    thermometer.publish(Temperature(temperature=20.0))
    assert deviation() < 1e-3
    thermometer.publish(Temperature(temperature=float('nan')))
    thermometer.publish(Temperature(temperature=60.0))
    fresh.wait(lambda: deviation() > 0.9 * 40 * 5e-4, 'a wider bias')
    fresh.node.destroy_publisher(thermometer)


def test_a_bias_beyond_the_largest_stays_in_and_is_told(fresh, random):
    data = serialized(*at_rest(random, 15, (0.0, 12.0 * DEGREE, 0.0)))
    out = fresh.play(data)
    assert rates_of(out)[500:, 1].mean() == pytest.approx(12.0 * DEGREE, rel=0.01)
    status = diagnostics(fresh, lambda s: s[FILTER].level == b'\x01')[FILTER]
    assert status.message == (
        'the mean rate at rest is beyond bias.max (10 deg/s) and is not subtracted: are '
        'the rates in deg/s (REP-103 asks for rad/s)? If they are not and the robot does not turn, '
        'raise bias.max, and have the sensor looked at'
    )
    assert int(values(status)['Segments of rest with a rate beyond bias.max']) > 0
