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

"""What must not take node and tools down, as far as no other test has it: docs/robustness.md."""

import os
import signal
import time
from types import SimpleNamespace

import numpy as np
import pytest
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu

from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.memory_file import file_of
from gyro_drift_filter.ros.losses import Losses
from gyro_drift_filter.simulation.bag import FRAME, TOPIC, imu_message
from harness.live_node import LOSSLESS, LiveNode
from support.bags import mixed, write, write_mcap
from support.messages import imu_fields, serialized, simulated
from support.node import NODE, TRUTH, diagnostics, offline, values
from support.sensor import at_rest


@pytest.mark.parametrize('gap', [0.1, 0.9, 10.0, 3600.0, 86400.0 * 365])
def test_a_gap_in_motion(gap, random):
    """A short one is bridged, after a long one the filter begins at the sample at hand."""
    n = 2000
    seconds = np.arange(n) / 100.0
    seconds[1000:] += gap
    rates = np.sin(0.5 * seconds)[:, None] + 0.005 * random.standard_normal((n, 3))
    stamps = 10**18 + np.round(seconds * 1e9).astype(np.int64)
    filter_ = Filter()
    out = filter_.run(stamps, rates, np.full_like(rates, 9.8))
    error = np.abs(out['angular_velocity'] - np.sin(0.5 * seconds)[:, None])
    assert error[900:1000].max() < 0.05
    assert error[1010:1100].max() < 0.05
    assert error[1000:1010].max() < (0.2 if gap < 1.0 else 0.05)
    clock = filter_.state['clock']
    assert clock['gaps'] == 1
    assert clock['restarts'] == (gap > 1.0)


@pytest.mark.parametrize('size', [8.0, 35.0])
@pytest.mark.parametrize('behind', ['power-on', 'a gap'])
@pytest.mark.parametrize('speed', [0.0, 1.0])
def test_a_corrupted_message_that_the_filter_starts_at_costs_one_sample(
    speed, behind, size, random
):
    """Nothing speaks for it, so it is not believed against all that follow."""
    n = 2000
    seconds = np.arange(n) / 100.0
    truth = speed * np.sin(0.5 * seconds)[:, None] * np.ones(3)
    rates = truth + 0.005 * random.standard_normal((n, 3))
    accelerations = np.tile([0.0, 0.0, 9.8], (n, 1)) + 0.02 * random.standard_normal((n, 3))
    begin = 0 if behind == 'power-on' else 1000
    seconds[begin:] += 2.0
    rates[begin] += [size, -size, size]
    stamps = 10**18 + np.round(seconds * 1e9).astype(np.int64)
    out = Filter(Parameters(bias_enabled=False)).run(stamps, rates, accelerations)
    after = slice(begin + 1, begin + 300)
    assert np.abs(out['angular_velocity'] - truth)[after].max() < 0.03
    assert not out['outlier'][after].any()


@pytest.mark.parametrize(('first', 'then'), [(100.0, 400.0), (400.0, 100.0)])
def test_the_rate_changes_in_mid_stream(first, then, random):
    """The period is learned anew within seconds; motion is followed meanwhile."""
    seconds = np.concatenate([np.arange(0, 20, 1 / first), np.arange(20, 60, 1 / then)])
    rates = np.sin(2.0 * seconds)[:, None] + 0.005 * random.standard_normal((len(seconds), 3))
    stamps = 10**18 + np.round(seconds * 1e9).astype(np.int64)
    filter_ = Filter()
    out = filter_.run(stamps, rates, np.full_like(rates, 9.8))['angular_velocity']
    assert filter_.state['clock']['period'] == pytest.approx(1 / then, rel=0.01)
    error = np.abs(out - np.sin(2.0 * seconds)[:, None])
    assert error[100:].max() < 0.1
    assert np.sqrt((error[-1000:] ** 2).mean()) < 0.005


@pytest.mark.node
def test_a_publisher_that_dies_and_returns():
    data = simulated(600)
    with LiveNode(LOSSLESS) as live:
        first = live.play(data[:300])
        live.restart_player()
        rest = live.play(data[300:])
    assert live.returncode == 0
    assert first + rest == offline(data)


class Waiting:
    """A subscription with one waiting message at a time, by its publisher's number."""

    msg_type, raw = Imu, True

    def __init__(self):
        self.handle, self.number = self, None

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def take_message(self, kind, raw):
        return None if self.number is None else (b'', {'publication_sequence_number': self.number})


def test_losses_are_counted_by_the_numbers_of_one_publisher():
    taken, waiting, received = [], Waiting(), [0]
    losses = Losses(taken.append, lambda: received[0])
    # The publisher's number, how many have been received with it, and how many are lost by then.
    for number, received[0], lost in [
        (1000, 10, 0),  # what went before the node was there
        (1050, 60, 0),
        (None, 70, 0),  # nothing waits
        (1200, 110, 100),
        (20, 130, 100),  # another publisher
        (50, 150, 110),
    ]:
        waiting.number = number
        losses.count(waiting)
        assert losses.total == lost
    assert len(taken) == 5
    losses.forget()
    waiting.number = 10_000
    losses.count(waiting)
    assert losses.total == 110
    losses.note_event(SimpleNamespace(total_count=200, total_count_change=1))
    assert losses.total == 200


@pytest.mark.node
def test_what_a_starved_node_misses_is_counted():
    """It stands still while more is sent than its queue holds."""
    data, sent, name = simulated(20_000), 0, '/gyro_drift_filter: input'
    with LiveNode([]) as live:

        def starve(statuses):
            nonlocal sent
            if int(values(statuses[name])['Dropped by the middleware']):
                return True
            live.process.send_signal(signal.SIGSTOP)
            for message in data[sent : sent + 400]:
                live.publish(message)
            sent += 400
            live.process.send_signal(signal.SIGCONT)
            return False

        status = diagnostics(live, starve)[name]
        assert 'before the node took them' in status.message
        assert status.level == b'\x01'
        received = int(values(status)['Events since startup'])
        assert 0 < int(values(status)['Dropped by the middleware']) <= sent - received
    assert live.returncode == 0


@pytest.mark.node
@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_the_node_and_keeps_the_bias(number, tmp_path, monkeypatch, random):
    monkeypatch.setenv('ROS_HOME', str(tmp_path))
    if signal.getsignal(number) == signal.SIG_IGN:
        pytest.skip(f'these tests ignore {number.name}, as under nohup, and so does their node')
    with LiveNode(LOSSLESS, home=tmp_path) as live:
        live.play(serialized(*at_rest(random, 20, TRUTH)))
        live.wait(file_of(NODE, FRAME).exists, 'the first file')
        file_of(NODE, FRAME).unlink()
        # What is learned from here on is not on the disk yet: it is saved once a minute.
        live.play(serialized(*at_rest(random, 20, TRUTH), start=20))
        assert not file_of(NODE, FRAME).exists()
        live.process.send_signal(number)
        assert live.process.wait(timeout=20) == 0
    assert file_of(NODE, FRAME).exists()
    assert 'Traceback' not in live.log


@pytest.mark.node
@pytest.mark.parametrize('pause', [0.0, 0.05, 0.1, 0.2, 0.3, 0.4])
def test_a_second_interrupt_while_the_node_ends_changes_nothing(pause, tmp_path):
    """Ctrl-C beneath `ros2 launch` sends two."""
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        pytest.skip('these tests ignore interrupts, and so does their node')
    with LiveNode(LOSSLESS, home=tmp_path) as live:
        live.process.send_signal(signal.SIGINT)
        time.sleep(pause)
        live.process.send_signal(signal.SIGINT)
        assert live.process.wait(timeout=20) == 0


@pytest.mark.node
def test_sim_time_that_stands_jumps_and_runs_fast():
    """Nothing in the node waits for it: filter, reports and stamps of the output go on."""
    data = simulated(900)
    with LiveNode([*LOSSLESS, '-p', 'use_sim_time:=true']) as live:
        clock = live.node.create_publisher(Clock, '/clock', 10)
        live.wait(clock.get_subscription_count, 'the node to listen to /clock')
        expected = iter(offline(data))

        def play(part):
            assert live.play(part) == [next(expected) for _ in part]

        name = '/gyro_drift_filter: input'
        play(data[:300])  # no time yet
        diagnostics(live, lambda s: values(s[name])['Samples'] == '300')
        times = [1000.0] * 100 + [5.0, 1e6, 3.0] * 30 + list(np.arange(110) * 0.1)
        for k, (message, seconds) in enumerate(zip(data[300:600], times, strict=True)):
            moment = Clock()
            moment.clock.sec, moment.clock.nanosec = int(seconds), int(seconds % 1 * 1e9)
            clock.publish(moment)
            if k % 10 == 0:
                play(data[300 + k : 310 + k])
            assert imu_fields(message).stamp
        diagnostics(live, lambda s: values(s[name])['Samples'] == '600')
        play(data[600:])
    assert live.returncode == 0


def metadata(folder, change):
    """Edit the metadata.yaml of a bag."""
    path = folder / 'metadata.yaml'
    path.write_text(change(path.read_text()))


HOSTILE = {
    'a path out of the folder': lambda s: s.replace('- in.mcap', '- ../../../../etc/passwd'),
    'an absolute path': lambda s: s.replace('- in.mcap', '- /dev/zero'),
    'a folder': lambda s: s.replace('- in.mcap', '- .'),
    'no such file': lambda s: s.replace('- in.mcap', '- other.mcap'),
    'a deep document': lambda s: s + 'x: ' + '[' * 1000,
    'no document': lambda s: '\x00\x01',
    'another version': lambda s: s.replace('version: 9', 'version: 99'),
}


@pytest.mark.slow
@pytest.mark.parametrize('what', HOSTILE)
def test_a_hostile_metadata_file(what, tmp_path):
    imu = [(10**18 + k, imu_message(10**18 + k, (0, 0, 0), (0, 0, 9.8))) for k in range(5)]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    with open_bag(source):
        pass
    metadata(source, HOSTILE[what])
    begin = time.monotonic()
    with pytest.raises(BagError) as error:
        replay(source, tmp_path / 'out', parameters=Parameters())
    assert '\n' not in str(error.value)
    assert len(str(error.value)) < 1000
    assert time.monotonic() - begin < 20
    assert [path.name for path in tmp_path.iterdir()] == ['in']


def test_a_metadata_file_of_a_gigabyte_is_not_read(tmp_path):
    source = write(
        tmp_path / 'in', {(TOPIC, IMU_TYPE): [(1, imu_message(1, (0, 0, 0), (0, 0, 9)))]}
    )
    os.truncate(source / 'metadata.yaml', 2**30)
    begin = time.monotonic()
    with pytest.raises(BagError, match='longer than 4194304 bytes: name a file in it'):
        replay(source, tmp_path / 'out', parameters=Parameters())
    assert time.monotonic() - begin < 1.0


def test_control_characters_in_names(tmp_path, random, capsys):
    """Of topics and frames: nothing that a terminal would act on is printed."""
    from gyro_drift_filter.cli.main import main

    rows = [
        (topic, kind, stamp, data) for topic, kind, stamp, data in mixed(random) if kind == IMU_TYPE
    ]
    evil = '/imu\x1b[2J\n'
    source = write_mcap(
        tmp_path / 'in.mcap',
        [(evil, *row[1:]) for row in rows] + [(TOPIC, *row[1:]) for row in rows],
    )
    assert main(['replay', str(source), '-o', str(tmp_path / 'out')]) == 1
    told = capsys.readouterr()
    assert 'several Imu topics' in told.err
    main(['replay', str(source), '-o', str(tmp_path / 'out'), '--topic', evil])
    main(['identify', str(source), '-o', str(tmp_path / 'f.yaml')])
    told_later = capsys.readouterr()
    for text in (told.err, told.out, told_later.err, told_later.out):
        assert '\x1b' not in text
