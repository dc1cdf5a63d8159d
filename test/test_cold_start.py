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

"""What arrives while the kernels are compiled is kept, in bounds, and worked off in its order."""

import sys
import tempfile
import time

import numpy as np
import pytest
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.ros import cold_start
from gyro_drift_filter.ros import node as node_module
from gyro_drift_filter.ros.cold_start import ColdStart
from gyro_drift_filter.simulation.bag import imu_message
from harness.live_node import own_domain


class FakeNode:
    """A node's timers and log; time goes by as `turn` is called."""

    def __init__(self):
        self.timers = []
        self.log = []

    def create_timer(self, seconds, function, clock):
        self.timers.append(function)
        return function

    def destroy_timer(self, timer):
        self.timers.remove(timer)

    def get_logger(self):
        return self

    info = warning = property(lambda self: self.log.append)

    def turn(self, until):
        end = time.monotonic() + 60
        while not until():
            for timer in list(self.timers):
                timer()
            assert time.monotonic() < end


@pytest.fixture
def node(monkeypatch):
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: True)
    return FakeNode()


@pytest.fixture
def ros_node(tmp_path, monkeypatch):
    """Return the real node in this process, whose compiler does not end."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: True)
    monkeypatch.setattr(node_module, 'is_cache_cold', lambda: True)
    executable(tmp_path, monkeypatch, 'exec sleep 60')
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain())
    created = node_module.GyroDriftFilterNode(context=context)
    yield created
    created.destroy_node()
    rclpy.shutdown(context=context)


def executable(tmp_path, monkeypatch, script):
    path = tmp_path / 'python'
    path.write_text(f'#!/bin/sh\n{script}\n')
    path.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(path))


def test_the_compiler_runs_where_there_is_no_room_for_its_errors(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'echo broken >&2; exit 3')
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'missing'))
    start = ColdStart(node)
    node.turn(lambda: start.waiting is None)
    assert any('the compiler ended with 3' in line for line in node.log)


def test_what_arrives_is_taken_later_in_its_order(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'exit 0')
    start, taken = ColdStart(node), []

    def take(value):
        taken.append(value)
        time.sleep(0.001)
        if value == 50:
            start.call(taken.append, 'hint')

    for k in range(100):
        start.call(take, k)
    assert taken == []
    node.turn(lambda: bool(taken))
    assert len(taken) < 100, 'the node has to answer in between'
    start.call(take, 100)
    node.turn(lambda: start.waiting is None)
    assert taken == [*range(101), 'hint']
    assert node.timers == []
    start.call(take, 'now')
    assert taken[-1] == 'now'
    assert 'compiled; 100 messages kept, 0 too many' in node.log


def test_the_oldest_go_where_there_are_too_many(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'exit 0')
    monkeypatch.setattr(cold_start, 'LARGEST_QUEUE', 10)
    start, taken = ColdStart(node), []
    start.call(taken.append, 'set', is_command=True)
    for k in range(15):
        start.call(taken.append, k)
    start.call(taken.append, 'reset', is_command=True)
    node.turn(lambda: start.waiting is None)
    # Whoever gives a command is told that it was taken.
    assert taken == ['set', *range(5, 15), 'reset']
    assert 'compiled; 10 messages kept, 5 too many' in node.log


def test_a_compiler_that_fails_is_told(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'echo "some trace" >&2; echo "no space left" >&2; exit 3')
    start, taken = ColdStart(node), []
    start.call(taken.append, 1)
    node.turn(lambda: start.waiting is None)
    assert taken == [1]
    assert 'the compiler ended with 3: no space left' in node.log[-1]


def test_the_compiler_ends_with_the_node(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'exec sleep 60')
    start = ColdStart(node)
    process = start._compiler
    start.stop()
    assert process.returncode == -9
    start.stop()


def test_a_warm_start_takes_at_once(node, monkeypatch):
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: False)
    start, taken = ColdStart(node), []
    start.call(taken.append, 1)
    assert taken == [1]
    assert node.timers == node.log == []


def test_what_is_kept_does_not_wait_for_an_own_compiler(node, tmp_path, monkeypatch):
    """Another process may have compiled all kernels before, and the own compiler goes on."""
    executable(tmp_path, monkeypatch, 'exec sleep 60')
    start, taken = ColdStart(node), []
    start.call(taken.append, 1)
    node.turn(lambda: len(node.timers) == 1)
    assert taken == []
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: False)
    node.turn(lambda: start.waiting is None)
    assert taken == [1]
    start.stop()


@pytest.mark.node
def test_the_node_answers_while_the_filter_is_compiled(ros_node, monkeypatch):
    """No request and no report may compile a kernel in the node's own process."""
    filter_ = ros_node._messages.filter

    def compiled_here(*arguments):
        raise AssertionError('this kernel is compiled now, and nobody is answered meanwhile')

    with monkeypatch.context() as patched:
        patched.setattr(MessageFilter, 'report', compiled_here)
        patched.setattr(filter_, 'reset', compiled_here)
        ros_node._report()
        assert ros_node.set_parameters([Parameter('method', value='kalman')])[0].successful
        assert ros_node._reset(None, Trigger.Response()).success
        answer = ros_node._calibrate(None, Trigger.Response())
    assert not answer.success
    assert 'being compiled for its first start' in answer.message
    assert filter_.parameters.method == 'adaptive'
    ros_node._receive(imu_message(10**18, np.zeros(3), np.zeros(3)))
    assert len(ros_node._cold_start.waiting) == 3
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: False)
    executor = SingleThreadedExecutor(context=ros_node.context)
    executor.add_node(ros_node)
    end = time.monotonic() + 60
    while ros_node._cold_start.waiting is not None:
        executor.spin_once(timeout_sec=1.0)
        assert time.monotonic() < end
    executor.shutdown()
    assert filter_.parameters.method == 'kalman'
    assert ros_node._messages.report().received == 1
