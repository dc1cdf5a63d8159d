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

"""The file that remembers the bias: what is damaged, foreign, stale or can't be written."""

import dataclasses
import json
import os
import time

import numpy as np
import pytest

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.records import has_provisional
from gyro_drift_filter.core.bias.shift import BiasShift
from gyro_drift_filter.messages.memory_file import (
    MemoryFileError,
    RememberedBias,
    file_of,
    recall,
    remember,
)
from support.messages import START
from support.rests import run
from support.sensor import at_rest, idling

NODE, FRAME = '/robot1/gyro_drift_filter', 'imu_link'
BIAS, DEVIATION = [0.01, -0.02, 0.005], [1e-4, 2e-4, 3e-4]
SHIFT = BiasShift((2e-4, -8e-4, 1e-3), (3e-4, 2e-4, 1e-4))
REMEMBERED = RememberedBias(BIAS, DEVIATION, SHIFT)


@pytest.fixture
def path(tmp_path, monkeypatch):
    monkeypatch.setenv('ROS_HOME', str(tmp_path / 'ros'))
    return file_of(NODE, FRAME)


def test_what_is_remembered_is_recalled(path):
    assert recall(path, NODE, FRAME, 0.1) is None
    remember(path, NODE, FRAME, REMEMBERED)
    found = recall(path, NODE, FRAME, 0.1)
    assert (found.bias, found.deviation, found.shift) == (tuple(BIAS), tuple(DEVIATION), SHIFT)
    assert 0.0 <= found.age < 60.0
    remember(path, NODE, FRAME, RememberedBias(DEVIATION, DEVIATION, SHIFT))
    assert recall(path, NODE, FRAME, 0.1).bias == tuple(DEVIATION)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_what_a_kill_has_left_beside_it_is_removed(path):
    remember(path, NODE, FRAME, REMEMBERED)
    path.with_name(f'.{path.name}.12.incomplete').write_text('{')
    remember(path, NODE, FRAME, REMEMBERED)
    assert list(path.parent.iterdir()) == [path]


def test_a_file_from_before_there_were_provisional_ones_is_of_a_rest(path):
    remember(path, NODE, FRAME, dataclasses.replace(REMEMBERED, provisional=True))
    assert recall(path, NODE, FRAME, 0.1).provisional
    content = json.loads(path.read_text())
    del content['provisional']
    path.write_text(json.dumps(content))
    assert not recall(path, NODE, FRAME, 0.1).provisional


def test_what_no_rest_has_shown_is_a_guess_in_the_next_run(random):
    """A provisional bias may be a slow turn; that of a rest is believed within half a deg/s."""
    truth = np.array([-0.002, 0.021, 0.077])
    fresh = Filter()
    assert RememberedBias.of(fresh) is None
    run(fresh, *idling(random, 2.0, truth))
    provisional = RememberedBias.of(fresh)
    assert provisional is not None
    assert provisional.provisional
    np.testing.assert_allclose(provisional.bias, truth, atol=3e-3)
    started = Filter()
    provisional.give(started)
    assert started.state['bias']['bias'].tolist() == provisional.bias
    assert (started.bias_deviation >= Parameters().bias_turn_on_deviation).all()
    assert not started.state['bias']['known']
    # What fits the rest of a run before is as good as that.
    of_rest = dataclasses.replace(provisional, provisional=False)
    of_rest.give(started)
    assert (started.bias_deviation < 0.3 * Parameters().bias_turn_on_deviation).all()
    run(started, *idling(random, 2.0, truth))
    assert has_provisional(started.state['bias'])
    assert not RememberedBias.of(started, of_rest).provisional
    assert RememberedBias.of(started, provisional).provisional
    run(started, *at_rest(random, 5, truth), start=START + 10**10)
    assert not RememberedBias.of(started, provisional).provisional


@pytest.mark.parametrize(
    ('node', 'frame'),
    [('/a/b', ''), ('/../../etc', '../../passwd'), ('/n', 'x' * 5000), ('/n', '\x00\n')],
)
def test_any_name_gives_a_file_within_the_folder(node, frame, path):
    other = file_of(node, frame)
    assert other.parent == path.parent
    remember(other, node, frame, REMEMBERED)
    assert recall(other, node, frame, 0.1).bias == tuple(BIAS)


def test_without_ros_home_it_is_in_the_users_home(tmp_path, monkeypatch):
    monkeypatch.delenv('ROS_HOME', raising=False)
    monkeypatch.setenv('HOME', str(tmp_path))
    assert file_of(NODE, FRAME).parent == tmp_path / '.ros' / 'gyro_drift_filter'


@pytest.mark.parametrize(
    'content',
    [
        b'',
        b'{',
        b'null',
        b'[1, 2]',
        b'\xff\xfe\x00',
        b'[' * 100_000,
        b'{"format": 2}',
    ],
)
def test_a_damaged_file_is_refused(content, path):
    path.parent.mkdir(parents=True)
    path.write_bytes(content)
    with pytest.raises(MemoryFileError, match='is damaged') as error:
        recall(path, NODE, FRAME, 0.1)
    assert '\n' not in str(error.value)


@pytest.mark.parametrize(
    ('change', 'message'),
    [
        ({'bias': [0.1, 0.2]}, 'is damaged'),
        ({'bias': [0.1, float('nan'), 0.2]}, 'is damaged'),
        ({'deviation': 'abc'}, 'is damaged'),
        ({'deviation': [1e-4, -1e-4, 1e-4]}, 'is damaged: a deviation is negative'),
        ({'shift_deviation': [1e-4, 1e-4, -1e-4]}, 'is damaged: a deviation is negative'),
        ({'shift': None}, 'is damaged'),
        ({'time': 10**400}, 'is damaged'),
        ({'bias': [10**400, 0, 0]}, 'is damaged'),
        ({'time': None}, 'is damaged'),
        ({'time': float('nan')}, 'is damaged: its time is not finite'),
        ({'time': 1e300}, 'is damaged: its time is no date'),
        ({'provisional': 'no'}, 'is damaged: provisional is neither true nor false'),
        ({'node': '/other'}, 'of another node or frame'),
        ({'frame': 'other'}, 'of another node or frame'),
        ({'format': 1, 'shift': None}, 'of another version of this package'),
        ({'time': time.time() - 40 * 86_400}, 'is from 40.0 days ago'),
        ({'time': time.time() + 40 * 86_400}, 'is from 40.0 days ahead: is the clock'),
        ({'bias': [0.0, 5.0, 0.0]}, 'beyond bias.max'),
    ],
)
def test_what_does_not_fit_is_refused(change, message, path):
    remember(path, NODE, FRAME, REMEMBERED)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(MemoryFileError, match=message) as error:
        recall(path, NODE, FRAME, 0.1)
    assert str(error.value).endswith('(it is replaced once a bias is learned)')


def test_a_folder_that_can_not_be_written(path):
    path.parent.parent.write_text('a file where the folder should be')
    with pytest.raises(MemoryFileError, match='can not be written'):
        remember(path, NODE, FRAME, REMEMBERED)


def test_what_can_not_be_read(path):
    path.mkdir(parents=True)
    with pytest.raises(MemoryFileError, match='can not be read'):
        recall(path, NODE, FRAME, 0.1)
    path.rmdir()
    os.mkfifo(path)
    with pytest.raises(MemoryFileError, match='can not be read: it is no file'):
        recall(path, NODE, FRAME, 0.1)
