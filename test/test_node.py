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

"""The real node as a process, over ROS 2."""

import os
import signal
import subprocess
import sys
import threading
import time
import types
from types import SimpleNamespace

import numpy as np
import pytest
import rclpy
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu, MagneticField
from std_srvs.srv import Trigger

from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import messages
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.parameters import DESCRIPTIONS
from gyro_drift_filter.errors import ParameterError
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from gyro_drift_filter.ros import command, neighbours
from gyro_drift_filter.ros.parameters import LiveParameters
from gyro_drift_filter.simulation.bag import imu_message
from harness.live_node import EXECUTABLE, LOSSLESS, LiveNode, environment, own_domain
from support.messages import NOT_REPORTED, imu_fields, simulated
from support.node import call, diagnostics, get_parameter, offline, set_parameters, values
from support.paths import PARAMETER_FILE
from support.processes import run_command

pytestmark = pytest.mark.node


@pytest.fixture(scope='module')
def live():
    """Start a node with the shipped parameters; tests set it back to its start by `fresh`."""
    with LiveNode(['--params-file', str(PARAMETER_FILE), *LOSSLESS]) as node:
        yield node


@pytest.fixture
def fresh(live):
    """Return the node as it is after its start."""
    # A bias that is given replaces the one that was learned.
    assert set_parameters(live, bias__initial=[0.1, 0.1, 0.1])[0].successful
    for name, value in Parameters().names().items():
        value = list(value) if isinstance(value, tuple) else value
        assert set_parameters(live, **{name.replace('.', '__'): value})[0].successful
    answer = call(live, Trigger, 'reset', Trigger.Request())
    assert answer.success
    assert answer.message.endswith('parameters and bias are kept')
    return live


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_publishes_the_same_bits_as_replay(fresh, method):
    set_parameters(fresh, method=method)
    data = simulated(3000)
    assert fresh.play(data) == offline(data, method=method)


def test_a_calibration_gives_the_same_bits_as_replay(fresh):
    matrix = [1.02, 0.01, -0.02, 0.03, 0.97, 0.005, -0.01, 0.02, 1.31]
    data = simulated(1000)
    plain = offline(data)
    assert fresh.play(data[:500]) == plain[:500]
    assert set_parameters(fresh, calibration__matrix=matrix)[0].successful
    mapped = fresh.play(data[500:])
    assert mapped == offline(data, calibration_matrix=tuple(matrix))[500:]
    assert mapped != plain[500:]
    result = set_parameters(fresh, calibration__matrix=[0.0] * 9)[0]  # and the old one stays
    assert not result.successful
    assert 'is singular' in result.reason


def test_what_accelerations_add_is_taken_off_as_in_replay(fresh):
    sensitivity = [1e-4, 2e-4, 0.0, 0.0, -1e-4, 0.0, 3e-4, 0.0, 1e-4]
    data = simulated(1000)
    assert set_parameters(fresh, calibration__acceleration_sensitivity=sensitivity)[0].successful
    found = fresh.play(data)
    assert found == offline(data, calibration_acceleration_sensitivity=tuple(sensitivity))
    assert found != offline(data)


def test_real_recordings_give_the_same_bits_as_replay(fresh, recording):
    with open_bag(recording) as reader:
        data = [d for c, _, d in messages(reader) if c.msgtype == 'sensor_msgs/msg/Imu'][:5000]
    assert fresh.play(data) == offline(data)


def test_sample_topics_only_while_somebody_listens(fresh):
    data = simulated(200)
    received = {name: [] for name in SAMPLE_TOPICS}
    subscriptions = [
        fresh.node.create_subscription(
            Vector3Stamped, f'/gyro_drift_filter/{name}', received[name].append, 1000, raw=True
        )
        for name in SAMPLE_TOPICS
    ]
    fresh.wait(
        lambda: all(
            fresh.node.count_publishers(f'/gyro_drift_filter/{name}') for name in SAMPLE_TOPICS
        ),
        'the sample topics',
    )
    # Matched on the node's side, too, only when a message arrives.
    probe = MessageFilter(Parameters())
    sent = 0
    while not all(received.values()):
        published = fresh.play(data[sent : sent + 1])
        probe.take(data[sent])
        sent += 1
        assert published
        assert sent < len(data) - 50
        end = time.monotonic() + 0.1
        fresh.wait(lambda end=end: all(received.values()) or time.monotonic() > end, 'samples')
    counts = {name: len(messages_) for name, messages_ in received.items()}
    fresh.play(data[sent:], in_flight=5)
    expected = len(data) - sent
    fresh.wait(
        lambda: all(len(received[n]) >= counts[n] + expected for n in SAMPLE_TOPICS), 'samples'
    )
    for message in data[sent:]:
        probe.take(message)
        for name in SAMPLE_TOPICS:
            assert received[name][counts[name]] == probe.sample_message(name)
            counts[name] += 1
    for subscription in subscriptions:
        fresh.node.destroy_subscription(subscription)


def test_bad_messages_do_no_harm(fresh):
    """Truncated and foreign bytes, NaN, covariance -1; then all is as before."""
    data = simulated(400)
    stamp = imu_fields(data[200]).stamp
    bad = [
        data[200][:50],
        imu_message(stamp, (np.nan, 0.1, np.inf), (0, 0, 9.8)),
        imu_message(stamp + 1000, (1.0, 2.0, 3.0), (0, 0, 9.8), covariance=NOT_REPORTED),
    ]
    sequence = data[:200] + bad + data[201:]
    expected = [out for out in offline(sequence) if out is not None]
    first = len(fresh.received)
    for message in sequence[:200]:
        fresh.play([message])
    for message in bad:
        fresh.publish(message)
    fresh.wait(lambda: len(fresh.received) == first + 202, 'the messages that pass')
    fresh.play(data[201:])
    assert fresh.received[first:] == expected
    for message in fresh.received[first : first + 201]:
        assert np.isfinite(imu_fields(message).angular_velocity).all()


def test_output_that_comes_back_through_another_node_is_told(fresh):
    data = simulated(300)
    wanted = offline(data)
    first = fresh.play(data[:200])
    name, to_return = '/gyro_drift_filter: input', list(first)

    def is_told(statuses):
        while to_return:  # with the first report, as one report alone has the error
            fresh.publish(to_return.pop(0))
        told = values(statuses[name]).get('Returned (own output)') == '200'
        return told and statuses[name].level == b'\x02'

    status = diagnostics(fresh, is_told)[name]
    assert 'come back on the input' in status.message
    assert values(status)['Returned (own output)'] == '200'
    assert first + fresh.play(data[200:]) == wanted


def test_diagnostics_count_what_comes_in(fresh):
    data = simulated(300)
    fresh.play(data)
    statuses = diagnostics(
        fresh, lambda s: values(s['/gyro_drift_filter: input']).get('Samples') == '300'
    )
    filter_ = values(statuses['/gyro_drift_filter: filter'])
    assert filter_['Method'] == Parameters().method
    flagged = [int(filter_[f'Outliers {axis}']) for axis in 'xyz']
    probe = MessageFilter(Parameters())
    for message in data:
        probe.take(message)
    assert {status.hardware_id for status in statuses.values()} == {'imu_link'}
    assert flagged == probe.filter.state['counts']['outliers'].tolist()


def test_a_reset_is_no_sign_of_degrees(fresh):
    fresh.play(simulated(300))
    assert call(fresh, Trigger, 'reset', Trigger.Request()).success
    statuses = diagnostics(
        fresh, lambda s: values(s['/gyro_drift_filter: input']).get('Samples') == '0'
    )
    assert 'degrees' not in statuses['/gyro_drift_filter: input'].message


def test_degrees_draw_a_warning(fresh):
    stamp = 10**18

    def warned(statuses):
        nonlocal stamp
        stamp += 10**7
        fresh.publish(imu_message(stamp, (90.0, 1e-12 * stamp % 1, 0.1), (0, 0, 9.8)))
        return statuses['/gyro_drift_filter: input'].level == b'\x01'

    for _ in range(100):
        stamp += 10**7
        fresh.play([imu_message(stamp, (90.0, 1e-12 * stamp % 1, 0.1), (0, 0, 9.8))])
    status = diagnostics(fresh, warned)['/gyro_drift_filter: input']
    assert 'degrees' in status.message


def test_parameters_are_described(live):
    names = [description.name for description in DESCRIPTIONS]
    request = DescribeParameters.Request(names=names)
    for descriptor, description in zip(
        call(live, DescribeParameters, 'describe_parameters', request).descriptors,
        DESCRIPTIONS,
        strict=True,
    ):
        assert descriptor.description == description.meaning
        assert descriptor.additional_constraints == description.limits
        if description.kind == 'double':
            assert descriptor.type == ParameterType.PARAMETER_DOUBLE
            (limits,) = descriptor.floating_point_range
            assert (limits.from_value, limits.to_value) == (description.low, description.high)
            assert abs(limits.from_value) < 1e5
            assert abs(limits.to_value) < 1e9, 'a slider needs an end'
        if description.kind == 'integer':
            (limits,) = descriptor.integer_range
            assert (limits.from_value, limits.to_value) == (description.low, description.high)


def test_a_valid_set_takes_effect(fresh):
    data = simulated(1000)
    fresh.play(data[:500])
    assert set_parameters(fresh, forgetting_factor=0.95)[0].successful
    assert set_parameters(fresh, gap_limit=2)[0].successful
    assert get_parameter(fresh, 'gap_limit').double_value == 2.0
    assert set_parameters(fresh, model__phi=[0, 0, 0])[0].successful
    live = fresh.play(data[500:])
    filter_ = MessageFilter(Parameters())
    for message in data[:500]:
        filter_.take(message)
    filter_.filter.configure(
        Parameters(forgetting_factor=0.95, gap_limit=2.0, model_phi=(0.0, 0.0, 0.0))
    )
    assert live == [filter_.take(message) for message in data[500:]]


@pytest.mark.parametrize(
    ('name', 'value', 'reason'),
    [
        ('forgetting_factor', 0.5, '0.9'),
        ('epsilon', 0.0, 'must be greater than 0'),
        ('epsilon', 'wide', ''),
        ('method', 'magic', 'must be one of kalman, sage_husa'),
        ('model__phi', [0.1, 0.1], 'must be a list of three numbers'),
        ('model__measurement_noise', [1.0, -1.0, 1.0], r'(axis y) must be greater than 0'),
    ],
)
def test_an_invalid_set_is_refused_with_a_reason(fresh, name, value, reason):
    before = get_parameter(fresh, name.replace('__', '.'))
    result = set_parameters(fresh, **{name: value})[0]
    assert not result.successful
    assert result.reason
    assert reason in result.reason
    assert get_parameter(fresh, name.replace('__', '.')) == before


def start(*arguments, until=None, domain=None):
    """Run the node until it ends by itself or has logged a text; return status and stderr."""
    lines = []
    with subprocess.Popen(
        [EXECUTABLE, '--ros-args', *arguments],
        env=environment(domain or own_domain()) | {'PYTHONFAULTHANDLER': '1'},
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        # Where it hangs, it says in which line.
        watchdog = threading.Timer(120, process.send_signal, [signal.SIGABRT])
        watchdog.start()
        try:
            for line in process.stderr:
                lines.append(line)
                if until and until in line:
                    process.send_signal(signal.SIGINT)
            status = process.wait()
        finally:
            watchdog.cancel()
            process.kill()
    return status, ''.join(lines)


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('epsilon: wide', "parameter 'epsilon' must be a number, not 'wide'"),
        ('forgetting_factor: 0.5', "'forgetting_factor' must be at least 0.9"),
        ('method: magic', "'method' must be one of"),
        ('model: {phi: [0.1, 0.2]}', "'model.phi' must be a list of three numbers"),
        ('model: {phi: []}', 'a parameter was given no value'),
        ('model: {fi: [0.0, 0.1, 0.2]}', "unknown parameter 'model.fi': did you mean 'model.phi'?"),
        ('bias: 3', "'bias' is a group of parameters, such as 'bias.enabled', and has no value of"),
        ('wheel_radius: 0.3', "unknown parameter 'wheel_radius'"),
        ('model: {phi: [0, 0.1, 0.2]}', 'Sequence should be of same type'),
        (
            'qos_overrides: {/imu/data_raw: {subscription: {reliability: maybe}}}',
            'imu/data_raw can not be set up with its qos_overrides: Unexpected QoS override',
        ),
        (
            'qos_overrides: {/imu/data_filtered: {publisher: {depth: deep}}}',
            'imu/data_filtered can not be set up with its qos_overrides: wrong type',
        ),
        (
            'qos_overrides: {/imu/data_raw: {subscription: {depth: -3}}}',
            'imu/data_raw can not be set up with its qos_overrides: depth must be at least 0, not',
        ),
        ('use_sim_time: "true"', "'use_sim_time' must be true or false without quotes, not 'true'"),
    ],
)
def test_a_wrong_parameter_file_ends_the_node_with_one_line(content, message, tmp_path):
    path = tmp_path / 'p.yaml'
    path.write_text(f'gyro_drift_filter:\n  ros__parameters:\n    {content}\n')
    status, log = start('--params-file', str(path))
    assert status == 1
    assert message in log
    assert 'Traceback' not in log


def test_an_unknown_parameter_on_the_command_line_ends_the_node_with_one_line():
    known = ['-p', 'use_sim_time:=true', '-p', 'start_type_description_service:=false']
    status, log = start(*known, '-p', 'methd:=kalman')
    assert status == 1
    assert log == "gyro_drift_filter_node: unknown parameter 'methd': did you mean 'method'?\n"


def test_files_for_other_nodes_and_parameters_of_theirs_are_told(tmp_path):
    """In the log of a node that runs; what is for it is taken."""
    shared, other, empty = (tmp_path / f'{name}.yaml' for name in ('shared', 'other', 'empty'))
    shared.write_text('/**: {ros__parameters: {wheel_radius: 0.3, method: sage_husa}}')
    other.write_text('gyro_drift_filter: {ros__parameters: {method: kalman}}')
    empty.write_text('# nothing')
    files = [text for path in (shared, other, empty) for text in ('--params-file', str(path))]
    status, log = start('-r', '__ns:=/robot1', *files, until='filtering /robot1')
    assert status == 0
    assert "unknown parameter 'wheel_radius': taken to be for another node" in log
    assert f'parameter file {shared} is' not in log
    assert (
        f'parameter file {other} is not used: it has parameters for /gyro_drift_filter, but this '
        'node is /robot1/gyro_drift_filter'
    ) in log
    assert f'parameter file {empty} holds no node names' in log
    assert 'into /robot1/imu/data_filtered by sage_husa' in log


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        (b'/**:\n\tros__parameters:\n', r"found character '\t' that cannot start any token"),
        (b'/**: {ros__parameters: {method: kalman}}\n---\n/**: {}\n', 'found another document'),
        ('/**: {ros__parameters: {method: kalman}}'.encode('utf-16'), "'utf-8' codec can't decode"),
        (b'/**:\n  # f\xfcr\n  ros__parameters: {method: kalman}', "'utf-8' codec can't decode"),
    ],
)
def test_a_parameter_file_that_is_no_yaml_ends_the_node(content, message, tmp_path):
    """Also where rcl has read part of it: of that nothing would be told."""
    path = tmp_path / 'p.yaml'
    path.write_bytes(content)
    status, log = start('--params-file', str(path), until='filtering /imu')
    assert status == 1
    assert log.startswith(f'gyro_drift_filter_node: parameter file {path} is no YAML: ')
    assert message in log
    assert log.count('\n') == 1


def test_help_and_options_that_do_not_exist():
    def run(*arguments):
        done = run_command(EXECUTABLE, *arguments)
        return done.returncode, done.stdout, done.stderr

    status, out, _ = run('--help', '--ros-args', '-p', 'method:=kalman')
    assert status == 0
    for name in (
        'imu/data_raw',
        'imu/data_filtered',
        'motion_hint',
        '--params-file',
        'parameters.md',
    ):
        assert name in out
    for arguments in (['--verbose', 'now'], ['--ros-args', '--verbose']):
        status, out, log = run(*arguments)
        assert (status, out, log.count('\n')) == (2, '', 1)
        assert '--verbose' in log


def test_a_missing_parameter_file_ends_the_node_with_one_line(tmp_path):
    status, log = start('--params-file', str(tmp_path / 'none.yaml'))
    assert status == 1
    assert 'none.yaml' in log
    assert 'Traceback' not in log


@pytest.mark.parametrize(
    'arguments',
    [
        ['-r', 'imu/data_filtered:=/imu/data_raw'],
        ['-r', '__ns:=/robot1', '-r', 'imu/data_raw:=imu', '-r', 'imu/data_filtered:=/robot1/imu'],
    ],
)
def test_a_node_on_its_own_output_does_not_start(arguments):
    status, log = start(*arguments)
    assert status == 1
    (line,) = [line for line in log.splitlines() if line.startswith('gyro_drift_filter_node: ')]
    assert 'input and output are both /' in line
    assert 'Traceback' not in log


def test_topics_that_are_one_by_mistake_are_told():
    """DDS refuses a second type of a topic: it was a traceback."""
    status, log = start('-r', 'imu/temperature:=imu/data_raw')
    assert status == 1
    assert 'imu/data_raw and imu/temperature are both /imu/data_raw: each needs a topic' in log
    assert 'Traceback' not in log


def test_of_several_sections_the_node_and_replay_take_the_same(tmp_path):
    own = 'gyro_drift_filter: {ros__parameters: {epsilon: 7.0}}\n'
    of_all = '/**: {ros__parameters: {epsilon: 3.0}}\n'
    context, file = rclpy.Context(), tmp_path / 'p.yaml'
    rclpy.init(context=context, domain_id=own_domain())
    try:
        for text in (of_all + own, own + of_all):
            file.write_text(text)
            node = Node(
                'gyro_drift_filter',
                context=context,
                cli_args=['--ros-args', '--params-file', str(file)],
                automatically_declare_parameters_from_overrides=True,
            )
            assert LiveParameters(node, print, [file]).current == read_parameters(file)
            node.destroy_node()
    finally:
        context.try_shutdown()


_GROUP = '/**: {ros__parameters: {bias: {%s}}}\n'


@pytest.mark.parametrize(
    'text',
    [
        # Given twice: a group, a section, a value, a name with and without its group.
        '/**: {ros__parameters: {bias: {max: 0.1, memory: false}, bias: {max: 0.2}}}',
        _GROUP % 'max: 0.1' + _GROUP % 'memory: false' + _GROUP % 'max: 0.2',
        _GROUP % 'max: 0.1, max: 0.2',
        '/**: {ros__parameters: {bias.max: 0.1, bias: {max: 0.2}}}',
        '/**: {ros__parameters: {bias: {max: 0.1}, bias.max: 0.2}}',
        _GROUP % 'initial: [0.1, 0.2, 0.3], initial: [0.3, 0.2, 0.1]',
        '/**: {ros__parameters: {method: kalman}, ros__parameters: {method: sage_husa}}',
        # In a section whose name is there twice, with another one between.
        'gyro_drift_filter: {ros__parameters: {epsilon: 7.0}}\n'
        '/**: {ros__parameters: {epsilon: 3.0}}\n'
        'gyro_drift_filter: {ros__parameters: {epsilon: 5.0, method: kalman}}',
        # Of other types than they look.
        _GROUP % 'initial: [0, 0.0, 1]',
        _GROUP % 'initial: [0, 0, 1]',
        *(_GROUP % f'max: {value}' for value in ('!!float "0.1"', '!!float 0.1', "'0.1'", '+.1')),
        *(_GROUP % f'max: {value}' for value in ('1e-1', '0x1', '1_0', '08', '0:1.5', '{}', '')),
        *(_GROUP % f'enabled: {value}' for value in ('y', 'N', 'Off', 'on', 'nO', '!!bool 3')),
        _GROUP % '<<: {enabled: false}',
        '/**: {ros__parameters: {outlier.run: 010}}',
        '/**:\n  ros__parameters:\n    bias.max: |\n      0.1\n',
        '/**: {ros__parameters: {method: !ours kalman}}',
        '/**: {ros__parameters: {wheels: {}}}',
        # Outside of what holds parameters.
        '/**: {ros__parameters: {}, ros__params: {epsilon: 7.0}}',
        '/**: {ros__parameters: }',
        '/**: {ros__parameters: {}, other: [1]}',
        '/**: {ros__parameters: {}, other: {}}',
        'other: \n/**: {ros__parameters: {}}',
        # In a section of another node.
        '/**: {ros__parameters: {epsilon: 7.0}}\nother: {ros__parameters: {speed: 1, speed: 2.0}}',
        '/**: {ros__parameters: {epsilon: 7.0}}\nother: {ros__parameters: {wheels: {}}}',
        '/**: {ros__parameters: {epsilon: 7.0}}\nother: {ros__parameters: {wheels: }}',
        '/**: {ros__parameters: {epsilon: 7.0}}\nother: {ros__parameters: {sizes: [1, 2.0]}}',
    ],
)
def test_the_node_and_replay_read_the_same_in_a_file(text, tmp_path):
    """Or both refuse it."""
    context, file = rclpy.Context(), tmp_path / 'p.yaml'
    rclpy.init(context=context, domain_id=own_domain())
    file.write_text(text)

    def live():
        node = Node(
            'gyro_drift_filter',
            context=context,
            cli_args=['--ros-args', '--params-file', str(file)],
            automatically_declare_parameters_from_overrides=True,
        )
        try:
            return LiveParameters(node, print, [file]).current
        finally:
            node.destroy_node()

    def taken(read):
        try:
            return read()
        # What rclpy finds without a value is a ValueError.
        except (ParameterError, ValueError, rclpy_implementation.RCLInvalidROSArgsError):
            return 'refused'

    try:
        assert taken(live) == taken(lambda: read_parameters(file))
    finally:
        context.try_shutdown()


def test_an_endpoint_whose_node_is_not_known_yet_has_words():
    unknown = SimpleNamespace(node_name='_NODE_NAME_UNKNOWN_', node_namespace='_UNKNOWN_')
    assert 'UNKNOWN' not in neighbours.node_name(unknown)


def test_an_interrupt_while_the_node_loads_is_one_line(monkeypatch, capsys):
    class Loading(types.ModuleType):
        def __getattr__(self, name):
            raise KeyboardInterrupt

    monkeypatch.setitem(sys.modules, 'gyro_drift_filter.ros.main', Loading('main'))
    assert command.main() == 130
    assert capsys.readouterr().err == 'gyro_drift_filter_node: interrupted while it loaded\n'


def test_wrong_type_on_the_topic_is_reported():
    context, domain = rclpy.Context(), own_domain()
    rclpy.init(context=context, domain_id=domain)
    other = rclpy.create_node('magnetometer', context=context)
    other.create_publisher(MagneticField, '/imu/wrong_type', 10)
    message = '/magnetometer publishes sensor_msgs/msg/MagneticField on /imu/wrong_type, not'
    try:
        status, log = start('-r', 'imu/data_raw:=imu/wrong_type', until=message, domain=domain)
    finally:
        other.destroy_node()
        context.try_shutdown()
    assert f'{message} sensor_msgs/msg/Imu: remap imu/data_raw' in log
    assert status == 0, log


def test_two_instances_side_by_side(tmp_path):
    """As the launch file starts them: one shipped file, each in its namespace, in one domain."""
    domain = own_domain()
    arguments = ['--params-file', str(PARAMETER_FILE), '-r', '__node:=gyro', '-r', '__ns:=/robot1']
    environment_ = environment(domain) | {'ROS_HOME': str(tmp_path)}
    with subprocess.Popen(
        [EXECUTABLE, '--ros-args', *arguments], env=environment_, stderr=subprocess.PIPE, text=True
    ) as first:
        arguments[-1] = '__ns:=/robot2'
        status, log = start(*arguments, until='nobody publishes /robot2/imu', domain=domain)
        first.send_signal(signal.SIGINT)
        _, other_log = first.communicate(timeout=60)
    assert (status, first.returncode) == (0, 0)
    assert 'is not used' not in log + other_log
    assert 'filtering /robot1/imu/data_raw into /robot1/imu/data_filtered' in other_log
    assert 'filtering /robot2/imu/data_raw into /robot2/imu/data_filtered' in log
    assert 'is called' not in log + other_log


class Other:
    """A node beside the filter, in its domain."""

    def __init__(self, live, name):
        self.context = rclpy.Context()
        rclpy.init(context=self.context, domain_id=live.domain)
        self.node = rclpy.create_node(name, context=self.context)

    def __enter__(self):
        return self.node

    def __exit__(self, *error):
        self.node.destroy_node()
        self.context.try_shutdown()


def input_status(live, other, text):
    """Return the first status of the input with a text, soon after another node is known."""
    reports = []
    live.wait(lambda: other.get_name() in live.node.get_node_names(), 'the other node')

    def told(statuses):
        reports.append(statuses['/gyro_drift_filter: input'])
        return text in reports[-1].message

    diagnostics(live, told)
    # As a rule the second; but on a busy machine the node knows later of the other one than we do.
    assert len(reports) <= 10, [report.message for report in reports]
    return reports[-1]


def test_a_second_publisher_is_named(fresh):
    with Other(fresh, 'camera') as camera:
        camera.create_publisher(Imu, '/imu/data_raw', 10)
        status = input_status(fresh, camera, '2 publishers on /imu/data_raw: /camera, /player')
        assert status.level in (b'\x01', b'\x03')
    diagnostics(fresh, lambda s: 'publishers on' not in s['/gyro_drift_filter: input'].message)


def test_a_second_publisher_is_named_before_what_its_messages_look_like(fresh):
    rear = [
        imu_message(imu_fields(message).stamp, (0.0, 0.1, 0.2), (0, 0, 9.8), frame='rear')
        for message in simulated(20)
    ]
    mixed = [message for pair in zip(simulated(20), rear, strict=True) for message in pair]
    with Other(fresh, 'camera') as camera:
        camera.create_publisher(Imu, '/imu/data_raw', 10)
        input_status(fresh, camera, '2 publishers on')
        fresh.play(mixed[::3])
        told = 'remap all but one; frame_id changes'
        status = input_status(fresh, camera, told)
        assert status.message.startswith('2 publishers on /imu/data_raw: /camera, /player. ')
        assert status.level == b'\x01'


def test_a_second_publisher_of_the_output_is_named(fresh):
    with Other(fresh, 'camera') as camera:
        camera.create_publisher(Imu, '/imu/data_filtered', 10)
        status = input_status(fresh, camera, '/camera publishes /imu/data_filtered, too')
        assert status.level in (b'\x01', b'\x03')


def test_a_second_node_of_the_same_name_is_told(fresh):
    with Other(fresh, 'gyro_drift_filter') as other:
        input_status(fresh, other, 'another node is called /gyro_drift_filter, too')


def test_a_subscriber_that_asks_for_too_much_is_named(fresh):
    with Other(fresh, 'logger') as logger:
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        logger.create_subscription(Imu, '/imu/data_filtered', print, latched)
        input_status(fresh, logger, '/logger gets nothing of /imu/data_filtered: ')


def test_a_publisher_that_offers_too_little_is_named(fresh):
    """The tests' node asks for reliable input."""
    with Other(fresh, 'radio') as radio:
        radio.create_publisher(Imu, '/imu/data_raw', qos_profile_sensor_data)
        status = input_status(fresh, radio, 'nothing comes from /radio on /imu/data_raw: ')
        assert 'qos_overrides./imu/data_raw.subscription' in status.message


def test_a_frame_that_changes_is_told(fresh):
    data = simulated(20)
    other = [
        imu_message(imu_fields(message).stamp, (0.0, 0.1, 0.2), (0, 0, 9.8), frame='rear\n')
        for message in data
    ]
    mixed = [message for pair in zip(data[::2], other[1::2], strict=True) for message in pair]

    def told(statuses):
        return 'frame_id changes' in statuses['/gyro_drift_filter: input'].message

    before = values(diagnostics(fresh, lambda s: True)['/gyro_drift_filter: input'])
    fresh.play(mixed)
    status = diagnostics(fresh, told)['/gyro_drift_filter: input']
    changes = int(values(status)['Changes of frame_id']) - int(before['Changes of frame_id'])
    assert changes in (19, 20)
    assert values(status)['Last frame_id it changed to'] == 'rear'


def test_runs_in_plain_python_without_an_events_executor(tmp_path):
    """The parts that a robot may lack: numba, and EventsExecutor in rclpy.experimental."""
    program = tmp_path / 'node'
    program.write_text(
        f'#!{sys.executable}\n'
        'import os, sys\n'
        "sys.modules['numba'] = None\n"
        "os.environ['NUMBA_DISABLE_JIT'] = '1'\n"  # nor the extension module
        "sys.modules['rclpy.experimental'] = None\n"
        'from gyro_drift_filter.ros.main import main\n'
        'sys.exit(main())\n'
    )
    program.chmod(0o755)
    data = simulated(200)
    with LiveNode([*LOSSLESS, '-r', '__ns:=/', '-p', 'method:=kalman'], node=program) as node:
        out = node.play(data)
    wanted = offline(data, method='kalman')
    for got, expected in zip(out, wanted, strict=True):
        a, b = (np.array(imu_fields(message).angular_velocity) for message in (got, expected))
        np.testing.assert_allclose(a, b, rtol=1e-12)
    assert node.returncode == 0
    assert 'no EventsExecutor: falling back' in node.log
    assert 'in plain Python: install numba' in node.log


@pytest.mark.skipif('RMW_IMPLEMENTATION' in os.environ, reason='the test chooses no middleware')
def test_the_output_is_a_message_that_ros_reads(fresh):
    out = fresh.play(simulated(100))
    message = deserialize_message(out[-1], Imu)
    assert message.header.frame_id == 'imu_link'
    assert message.angular_velocity_covariance[0] > 0


def test_no_other_node_gets_the_domain_of_one_that_runs(live):
    """Else it would find one of its own name, and tell that instead of what is looked for."""
    assert live.domain not in {own_domain() for _ in range(100)}
