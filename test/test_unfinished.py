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

"""What a run that is ended leaves on the disk, and what the next one makes of it."""

import signal
import subprocess
import sys
from functools import partial

import pytest

from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.unfinished import UnfinishedFolder, remove_abandoned
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.cli import command
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC
from support.bags import simulated, write

# Begins a bag in the folder that it is given, says so, and works on without end.
WORK = """
import sys, time
from pathlib import Path
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.cli import command

def work(options):
    with BagWriter(Path(options.output)):
        print('begun', flush=True)
        time.sleep(600)

class Parser:
    def parse_args(self, arguments):
        from argparse import Namespace
        return Namespace(command='replay', run=work, output=arguments[0])

command.parser = lambda name: Parser()
sys.exit(command.run(sys.argv[1:]))
"""


def begin(output, **options):
    """Start a process that writes a bag, and return it when it has begun."""
    process = subprocess.Popen(
        [sys.executable, '-c', WORK, output],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    assert process.stdout.readline() == 'begun\n'
    return process


@pytest.mark.slow
@pytest.mark.parametrize('name', ['SIGTERM', 'SIGHUP'])
def test_a_signal_ends_it_and_leaves_nothing(name, tmp_path):
    number = signal.Signals[name]
    # Whoever runs the tests may have it ignored.
    process = begin(tmp_path / 'out', preexec_fn=partial(signal.signal, number, signal.SIG_DFL))
    assert len(list(tmp_path.iterdir())) == 1
    process.send_signal(number)
    _, log = process.communicate(timeout=60)
    assert process.returncode == 128 + number
    left_out = 'what was not complete is not written'
    assert log == f'gyro_drift replay: ended by {name}: {left_out}\n'
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_signal_that_is_ignored_stays_so(tmp_path):
    """As by nohup."""
    process = begin(
        tmp_path / 'out', preexec_fn=partial(signal.signal, signal.SIGHUP, signal.SIG_IGN)
    )
    process.send_signal(signal.SIGHUP)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert process.returncode == 128 + signal.SIGTERM


def test_handlers_of_signals_are_given_back(tmp_path):
    before = signal.getsignal(signal.SIGTERM)
    assert command.run(['replay', str(tmp_path / 'none'), '-o', str(tmp_path / 'out')]) == 1
    assert signal.getsignal(signal.SIGTERM) == before


@pytest.mark.slow
def test_what_a_killed_run_has_left_is_removed_and_told(tmp_path, caplog):
    out = tmp_path / 'out'
    process = begin(out)
    (left,) = tmp_path.iterdir()
    with BagWriter(out) as writer:  # while it runs
        writer.add_connection(TOPIC, IMU_TYPE)
    assert left.exists()
    assert caplog.text == ''
    process.kill()
    process.communicate(timeout=60)
    with BagWriter(out, replace=True):
        assert not left.exists()
    assert f'removed {left}, which a killed run has left' in caplog.text
    assert list(tmp_path.iterdir()) == [out]


def test_only_what_was_to_become_this_output_is_removed(tmp_path):
    for name in (
        '.out.more.abc.incomplete',
        '.other.abc.incomplete',
        '.out.abc',
        '.out.new.incomplete',
    ):
        (tmp_path / name).mkdir()
        if 'new' not in name:  # one that has just been made has no lock yet
            (tmp_path / name / 'lock').touch()
    (tmp_path / '.out.link.incomplete').symlink_to(tmp_path / '.out.abc')
    before = sorted(tmp_path.iterdir())
    remove_abandoned(tmp_path / 'out')
    assert sorted(tmp_path.iterdir()) == before
    with UnfinishedFolder(tmp_path / 'out') as folder:
        remove_abandoned(tmp_path / 'out')
        assert folder.path.exists()


def test_a_bag_that_was_about_to_be_replaced_gets_its_name_back(tmp_path, caplog):
    """Killed between the two renames, its only copy is in the hidden folder."""
    old = write(tmp_path / 'out', {(TOPIC, IMU_TYPE): simulated(9)})
    left = tmp_path / '.out.abc.incomplete'
    left.mkdir()
    (left / 'lock').touch()
    old.rename(left / 'replaced')
    with pytest.raises(BagError, match='exists already'):
        BagWriter(tmp_path / 'out')
    assert (old / 'metadata.yaml').exists()
    assert 'was about to be replaced by a killed run: kept' in caplog.text
    assert list(tmp_path.iterdir()) == [old]
