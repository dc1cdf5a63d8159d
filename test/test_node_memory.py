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

"""What the node's memory of its bias keeps, beside a node that is none."""

import dataclasses
import logging
from types import SimpleNamespace

import numpy as np
import pytest

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.bias.shift import BiasShift
from gyro_drift_filter.messages.memory_file import RememberedBias, file_of, recall, remember
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.ros.bias_memory import NodeBiasMemory
from gyro_drift_filter.simulation.bag import FRAME
from support.messages import serialized
from support.node import NODE, TRUTH
from support.sensor import DEGREE, at_rest

pytestmark = pytest.mark.node

OF_A_REST = RememberedBias(TRUTH.tolist(), 3 * [1e-4], BiasShift(3 * [0.0], 3 * [1e-3]))
WITH_INITIAL = dataclasses.replace(Parameters(), bias_initial=(0.0, 0.0, 0.001))


class Run:
    """A filter with its memory, as the node has them."""

    def __init__(self):
        self.messages = MessageFilter(Parameters())
        node = SimpleNamespace(
            get_logger=lambda: logging.getLogger('node'), get_fully_qualified_name=lambda: NODE
        )
        self.memory = NodeBiasMemory(node, self.messages)

    def take(self, rates, accelerations, start):
        for message in serialized(rates, accelerations, start=start):
            if not self.memory.recalled:
                self.memory.recall(message)
            self.messages.take(message)


@pytest.fixture
def path(tmp_path, monkeypatch):
    """Return the path of the memory."""
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    return file_of(NODE, FRAME)


def kept(path):
    return recall(path, NODE, FRAME, Parameters().bias_max)


def test_a_bias_that_is_set_replaces_what_was_recalled(path, random):
    """Else a slow turn after it would be kept as a bias that a rest has shown."""
    remember(path, NODE, FRAME, OF_A_REST)
    run = Run()
    run.take(*at_rest(random, 0.1, TRUTH), start=0)
    run.memory.configure(WITH_INITIAL)
    turn = np.array([0.0, 0.0, 3.0 * DEGREE])
    run.take(*at_rest(random, 1.8, TRUTH + turn), start=0.1)
    run.memory.save()
    assert kept(path).bias == pytest.approx(TRUTH + turn, abs=0.3 * DEGREE)
    assert kept(path).provisional


def test_the_first_rest_after_a_bias_was_set_is_saved_at_once(path, random):
    run = Run()
    run.take(*at_rest(random, 10, TRUTH), start=0)
    run.memory.save_if_due()
    assert kept(path).bias == pytest.approx(TRUTH, abs=0.03 * DEGREE)
    run.memory.configure(WITH_INITIAL)
    run.take(*at_rest(random, 10, -TRUTH), start=10)
    run.memory.save_if_due()
    assert kept(path).bias == pytest.approx(-TRUTH, abs=0.03 * DEGREE)


@pytest.mark.slow
def test_what_several_publishers_have_shown_is_not_kept_before_a_rest_of_one(path, random, caplog):
    run = Run()
    run.memory.note_publishers(1)
    run.take(*at_rest(random, 10, TRUTH), start=0)
    run.memory.save()
    before = path.read_text()
    run.memory.note_publishers(2)
    run.take(*at_rest(random, 30, -TRUTH), start=10)
    run.memory.save()
    run.memory.note_publishers(1)
    run.memory.save()
    assert path.read_text() == before
    why = 'the bias will not be remembered: the input has '
    assert caplog.messages == [
        f'{why}several publishers, which may be several sensors: remap one',
        f'{why}had several publishers, and there was no rest since it has one',
    ]
    run.take(*at_rest(random, 60, TRUTH), start=40)
    run.memory.note_publishers(1)
    run.memory.save()
    assert path.read_text() != before
    assert kept(path).bias == pytest.approx(TRUTH, abs=0.03 * DEGREE)


def test_a_segment_that_is_partly_of_two_publishers_does_not_make_the_bias_that_of_one(
    path, random
):
    run = Run()
    run.memory.note_publishers(2)
    run.take(*at_rest(random, 10, TRUTH), start=0)
    run.memory.note_publishers(1)
    run.memory.configure(WITH_INITIAL)
    run.take(*at_rest(random, 3, TRUTH), start=10)
    assert run.messages.filter.state['bias']['segments'] > 0
    run.memory.save()
    assert not path.exists()
    run.take(*at_rest(random, 10, TRUTH), start=13)
    run.memory.save()
    assert kept(path).bias == pytest.approx(TRUTH, abs=0.03 * DEGREE)
