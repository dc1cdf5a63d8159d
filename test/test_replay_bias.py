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

"""Bias in a replay: what the bag's other topics say of motion and temperature, and `at_rest`."""

import json
import os
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from gyro_drift_filter.bags.bias_memory import check_replaceable
from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.memory_file import MemoryFileError, recall
from gyro_drift_filter.messages.motion_hint import HINT_TYPES, moves
from gyro_drift_filter.messages.sample_messages import VECTOR_TYPE
from gyro_drift_filter.simulation.bag import FRAME, TOPIC, imu_messages
from support.bags import read, write
from support.messages import START, STORE, even_stamps
from support.sensor import DEGREE, at_rest, by_hand, taking_off


def imus(rates, accelerations):
    return list(imu_messages(even_stamps(len(rates)), rates, accelerations))


def header(stamp):
    time = message_type('builtin_interfaces/msg/Time')(*divmod(stamp, 10**9))
    return message_type('std_msgs/msg/Header')(stamp=time, frame_id='base_link')


def hint(kind, turn):
    vector = message_type('geometry_msgs/msg/Vector3')
    twist = message_type('geometry_msgs/msg/Twist')(vector(0.0, 0.0, 0.0), vector(0.0, 0.0, turn))
    if kind == 'twist':
        return twist
    if kind == 'twist_stamped':
        return message_type('geometry_msgs/msg/TwistStamped')(header(START), twist)
    pose = message_type('geometry_msgs/msg/Pose')(
        message_type('geometry_msgs/msg/Point')(0.0, 0.0, 0.0),
        message_type('geometry_msgs/msg/Quaternion')(0.0, 0.0, 0.0, 1.0),
    )
    return message_type('nav_msgs/msg/Odometry')(
        header(START),
        'base_link',
        message_type('geometry_msgs/msg/PoseWithCovariance')(pose, np.zeros(36)),
        message_type('geometry_msgs/msg/TwistWithCovariance')(twist, np.zeros(36)),
    )


@pytest.mark.parametrize('kind', HINT_TYPES)
def test_what_counts_as_motion(kind):
    assert moves(hint(kind, 0.1))
    assert moves(hint(kind, float('nan')))
    assert not moves(hint(kind, 0.0))


@pytest.mark.slow
@pytest.mark.parametrize('kind', HINT_TYPES)
def test_a_hint_in_the_bag_is_taken_as_the_node_takes_it(kind, tmp_path, random):
    """From the first sample on the robot turns slowly, and says so for 20 of 40 s."""
    data = at_rest(random, 40, (0.0, 0.0, 2.0 * DEGREE))
    hints = [
        (START + second * 10**9 + 1, serialize(hint(kind, 0.03), HINT_TYPES[kind]))
        for second in range(20)
    ]
    source = write(
        tmp_path / 'in', {(TOPIC, IMU_TYPE): imus(*data), ('/odom', HINT_TYPES[kind]): hints}
    )
    selection = Selection(hint='odom')
    replay(
        source,
        tmp_path / 'out',
        parameters=Parameters(),
        selection=selection,
        diagnostics=True,
    )
    filter_ = Filter()
    biases, rests = [], []
    for k, (rate, acceleration) in enumerate(zip(*data, strict=True)):
        result = filter_.step(START + 10_000_000 * k, rate, acceleration)
        biases.append(result['bias'].copy())
        if not rests or result['at_rest'] != rests[-1]:
            rests.append(result['at_rest'])
        if k % 100 == 0 and k < 2000:
            filter_.hint(moves=True)
    written, _ = read(tmp_path / 'out')
    found = [
        STORE.deserialize_cdr(data, VECTOR_TYPE).vector
        for _, data in written['/gyro_drift_filter/bias']
    ]
    assert [(v.x, v.y, v.z) for v in found] == [tuple(bias) for bias in biases]
    told = [
        STORE.deserialize_cdr(data, 'std_msgs/msg/Bool').data
        for _, data in written['/gyro_drift_filter/at_rest']
    ]
    assert told == [rest > 0 for rest in rests] == [False, True]
    assert abs(biases[2000][2]) < 1e-6
    assert biases[-1][2] == pytest.approx(2.0 * DEGREE, rel=0.05)


def test_a_fault_of_the_filter_is_not_passed_over_as_a_hint_that_can_not_be_read(
    tmp_path, random, monkeypatch
):
    def broken(*_):
        raise ZeroDivisionError

    monkeypatch.setattr(Filter, 'hint', broken)
    kind = HINT_TYPES['twist']
    hints = [(START + 1, b'cut off'), (START + 2, serialize(hint('twist', 0.03), kind))]
    source = write(
        tmp_path / 'in',
        {(TOPIC, IMU_TYPE): imus(*at_rest(random, 1)), ('/cmd_vel', kind): hints[:1]},
    )
    replay_it = partial(replay, parameters=Parameters(), selection=Selection(hint='cmd_vel'))
    replay_it(source, tmp_path / 'unread')
    source = write(
        tmp_path / 'both', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 1)), ('/cmd_vel', kind): hints}
    )
    with pytest.raises(ZeroDivisionError):
        replay_it(source, tmp_path / 'out')


def test_hints_that_do_not_fit_are_refused(tmp_path, random):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 1))})
    with pytest.raises(BagError, match='no topic odom in the bag'):
        replay(source, tmp_path / 'out', parameters=Parameters(), selection=Selection(hint='odom'))
    with pytest.raises(BagError, match='is of type sensor_msgs/msg/Imu, not one of geometry_msgs'):
        replay(source, tmp_path / 'out', parameters=Parameters(), selection=Selection(hint=TOPIC))


@pytest.mark.slow
def test_the_temperature_beside_the_imu_widens_the_bias(tmp_path, random):
    name = 'sensor_msgs/msg/Temperature'
    data = imus(*at_rest(random, 30))
    warm = [
        (START + seconds * 10**9, serialize(message_type(name)(header(START), kelvin, 0.0), name))
        for seconds, kelvin in ((1, 20.0), (28, 60.0))
    ]
    for folder, topics in (('cold', {}), ('warm', {('/imu/temperature', name): warm})):
        source = write(tmp_path / folder, {(TOPIC, IMU_TYPE): data, **topics})
        replay(source, tmp_path / f'{folder}_out', parameters=Parameters())
    variance = {}
    for folder in ('cold', 'warm'):
        messages, _ = read(tmp_path / f'{folder}_out')
        _, message = messages['/imu/data_filtered'][2810]
        filtered = STORE.deserialize_cdr(message, IMU_TYPE)
        variance[folder] = filtered.angular_velocity_covariance[0]
    assert variance['warm'] > variance['cold'] + 0.5 * (40 * 5e-4) ** 2


@pytest.mark.slow
def test_a_chain_of_recordings_keeps_the_bias(tmp_path, random):
    """As the node does from one run to the next: the same bits."""
    truth = (0.01, -0.02, 0.005)
    first = write(tmp_path / 'first', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 20, truth))})
    rates, accelerations = at_rest(random, 5, truth)
    turn, push = by_hand(random, 5)
    moved = rates + turn, accelerations + push
    second = write(tmp_path / 'second', {(TOPIC, IMU_TYPE): imus(*moved)})
    memory = tmp_path / 'bias.json'
    replay(first, tmp_path / 'a', parameters=Parameters(), memory=memory, diagnostics=True)
    recalled = recall(memory, None, FRAME, 1.0, START * 1e-9)
    replay(second, tmp_path / 'b', parameters=Parameters(), memory=memory, diagnostics=True)
    topic = '/gyro_drift_filter/bias'
    learned, _ = read(tmp_path / 'a')
    written, _ = read(tmp_path / 'b')
    last, *found = (
        STORE.deserialize_cdr(data, VECTOR_TYPE).vector
        for _, data in (learned[topic][-1], *written[topic])
    )
    at_end = last.x, last.y, last.z
    first_bias = np.add(at_end, recalled.shift.shift)  # until it is found at rest
    np.testing.assert_allclose((found[0].x, found[0].y, found[0].z), first_bias, atol=1e-9)
    filter_ = Filter()
    recalled.give(filter_)
    for k, (rate, acceleration) in enumerate(zip(*moved, strict=True)):
        result = filter_.step(START + 10_000_000 * k, rate, acceleration)
        assert (found[k].x, found[k].y, found[k].z) == tuple(result['bias'])


@pytest.mark.slow
def test_a_chain_of_flights_without_a_rest_keeps_what_the_first_seconds_show(tmp_path, random):
    """The first flight begins with all of the turn-on bias, the next one with next to none."""
    truth, memory = np.array([-0.002, 0.021, 0.077]), tmp_path / 'bias.json'
    lost = []
    for name in ('first', 'second'):
        flight = taking_off(random, 20, truth)
        source = write(tmp_path / name, {(TOPIC, IMU_TYPE): imus(*flight)})
        out = tmp_path / f'{name}_filtered'
        replay(source, out, parameters=Parameters(), memory=memory, diagnostics=True)
        assert recall(memory, None, FRAME, 1.0, START * 1e-9).provisional
        written, _ = read(out)
        found = (
            STORE.deserialize_cdr(data, VECTOR_TYPE).vector
            for _, data in written['/gyro_drift_filter/bias']
        )
        lost.append(np.abs([np.array((v.x, v.y, v.z)) - truth for v in found]).mean(axis=0).max())
    assert lost[0] > 3e-3
    assert lost[1] < 0.5 * lost[0]


def test_a_memory_that_does_not_fit_is_told_and_replaced(tmp_path, random, caplog):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 20))})
    memory = tmp_path / 'bias.json'
    memory.write_text('{\n "format": 2,')
    replay(source, tmp_path / 'out', parameters=Parameters(), memory=memory)
    assert 'the bias of the last recording is not used' in caplog.text
    assert recall(memory, None, FRAME, 1.0, START * 1e-9) is not None
    with pytest.raises(MemoryFileError, match='is a folder: name a file'):
        replay(source, tmp_path / 'other', parameters=Parameters(), memory=tmp_path)
    assert not (tmp_path / 'other').exists()


def test_a_bias_that_a_later_recording_has_left_is_told(tmp_path, random, caplog):
    """As where a chain of recordings is replayed once more with the file of the first time."""
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 20))})
    memory = tmp_path / 'bias.json'
    for name in ('first', 'again'):
        assert 'after the start of this recording' not in caplog.text
        replay(source, tmp_path / name, parameters=Parameters(), memory=memory)
    assert 'is from 20 s after the start of this recording: remove the file' in caplog.text
    assert 'to begin without it, as it is used all the same' in caplog.text


def test_the_bias_of_another_frame_is_not_kept(tmp_path, random, caplog):
    first = imus(*at_rest(random, 10, (0.01, 0.02, 0.03)))
    stamps = START + 10_000_000 * (1100 + np.arange(1000))
    later = imu_messages(stamps, *at_rest(random, 10, (-0.05, 0.05, 0.05)), frame='other_imu')
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): [*first, *later]})
    replay(bag, tmp_path / 'out', parameters=Parameters(), memory=tmp_path / 'bias.json')
    assert not (tmp_path / 'bias.json').exists()
    assert f'frame_id is no longer {FRAME}' in caplog.text


@pytest.mark.parametrize('rests', [pytest.param(True, id='rest'), pytest.param(False, id='motion')])
def test_the_bias_is_kept_where_a_rest_follows_another_frame(rests, tmp_path, random, caplog):
    """A single message with another frame_id, as when a driver starts."""
    bias = (0.01, 0.02, 0.03)
    first = imus(*at_rest(random, 10, bias))
    stamps = START + 10_000_000 * (1001 + np.arange(1001))
    rates, accelerations = at_rest(random, 10.01, bias)
    if not rests:
        turn, push = by_hand(random, 10.01)
        rates, accelerations = rates + turn, accelerations + push
    other = imu_messages(stamps[:1], rates[:1], accelerations[:1], frame='other_imu')
    later = imu_messages(stamps[1:], rates[1:], accelerations[1:])
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): [*first, *other, *later]})
    memory = tmp_path / 'bias.json'
    replay(bag, tmp_path / 'out', parameters=Parameters(), memory=memory)
    assert memory.exists() == rests
    if rests:
        np.testing.assert_allclose(json.loads(memory.read_text())['bias'], bias, atol=2e-3)
    else:
        assert f'no rest since it is {FRAME} again' in caplog.text


def test_no_other_file_is_replaced_by_the_bias(tmp_path, random):
    """Least of all a bag, named there by mistake."""
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imus(*at_rest(random, 20))})
    (tmp_path / 'verdict.json').write_text('{"verdicts": []}')
    os.mkfifo(tmp_path / 'pipe')
    others = source / 'in.mcap', source / 'metadata.yaml', tmp_path / 'verdict.json'
    for other in (*others, tmp_path / 'pipe', Path(os.devnull)):
        before = other.read_bytes() if other.is_file() else b''
        with pytest.raises(MemoryFileError, match='is not replaced'):
            check_replaceable(other)
        with pytest.raises(MemoryFileError, match='is not replaced'):
            replay(source, tmp_path / 'out', parameters=Parameters(), memory=other)
        assert not other.is_file() or other.read_bytes() == before
    assert not (tmp_path / 'out').exists()
    (tmp_path / 'new').touch()  # as mktemp makes it
    replay(source, tmp_path / 'out', parameters=Parameters(), memory=tmp_path / 'new')
    assert recall(tmp_path / 'new', None, FRAME, 1.0, START * 1e-9) is not None


def test_a_memory_is_of_one_gyroscope(tmp_path, random):
    messages = imus(*at_rest(random, 1))
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): messages, ('/b', IMU_TYPE): messages})
    with pytest.raises(BagError, match='name one Imu topic'):
        replay(
            source,
            tmp_path / 'out',
            parameters=Parameters(),
            selection=Selection(all_imu=True),
            memory=tmp_path / 'bias.json',
        )
