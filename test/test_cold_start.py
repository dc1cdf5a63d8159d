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
import time

import pytest

from gyro_drift_filter.ros import cold_start
from gyro_drift_filter.ros.cold_start import ColdStart


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
    monkeypatch.setattr(cold_start, 'is_extension_missing', lambda: False)
    return FakeNode()


def executable(tmp_path, monkeypatch, script):
    path = tmp_path / 'python'
    path.write_text(f'#!/bin/sh\n{script}\n')
    path.chmod(0o755)
    monkeypatch.setattr(sys, 'executable', str(path))


def test_what_arrives_is_taken_later_in_its_order(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'exit 0')
    start, taken = ColdStart(node), []

    def take(value):
        taken.append(value)
        time.sleep(0.001)
        if value == 50:
            start.take(taken.append, 'hint')

    for k in range(100):
        start.take(take, k)
    assert taken == []
    node.turn(lambda: bool(taken))
    assert len(taken) < 100, 'the node has to answer in between'
    start.take(take, 100)
    node.turn(lambda: start.waiting is None)
    assert taken == [*range(101), 'hint']
    assert node.timers == []
    start.take(take, 'now')
    assert taken[-1] == 'now'
    assert 'compiled; 100 messages were kept, 0 were too many' in node.log


def test_the_oldest_go_where_there_are_too_many(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'exit 0')
    monkeypatch.setattr(cold_start, 'LARGEST_QUEUE', 10)
    start, taken = ColdStart(node), []
    for k in range(15):
        start.take(taken.append, k)
    node.turn(lambda: start.waiting is None)
    assert taken == [*range(5, 15)]
    assert 'compiled; 10 messages were kept, 5 were too many' in node.log


def test_a_compiler_that_fails_is_told(node, tmp_path, monkeypatch):
    executable(tmp_path, monkeypatch, 'echo "some trace" >&2; echo "no space left" >&2; exit 3')
    start, taken = ColdStart(node), []
    start.take(taken.append, 1)
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
    start.take(taken.append, 1)
    assert taken == [1]
    assert node.timers == node.log == []


def test_what_is_kept_does_not_wait_for_the_extension_module(node, tmp_path, monkeypatch):
    """The compiler goes on when all kernels are in the cache, for the starts to come."""
    executable(tmp_path, monkeypatch, 'exec sleep 60')
    start, taken = ColdStart(node), []
    start.take(taken.append, 1)
    node.turn(lambda: len(node.timers) == 1)
    assert taken == []
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: False)
    node.turn(lambda: start.waiting is None)
    assert taken == [1]
    start.stop()


def test_where_the_extension_module_alone_is_missing_it_is_built_beside(
    node, tmp_path, monkeypatch
):
    monkeypatch.setattr(cold_start, 'is_cache_cold', lambda: False)
    monkeypatch.setattr(cold_start, 'is_extension_missing', lambda: True)
    executable(tmp_path, monkeypatch, f'echo "$@" > {tmp_path}/called')
    start, taken = ColdStart(node), []
    start.take(taken.append, 1)
    assert taken == [1]
    node.turn(lambda: not node.timers)
    assert (tmp_path / 'called').read_text().strip().endswith('gyro_drift_filter.cli.main compile')
    assert node.log == []
    start.stop()
