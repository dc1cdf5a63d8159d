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

"""Bags in, bags out."""

import os
import shutil
import sqlite3
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    QosReliability,
)
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer

from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.mcap.writer import McapWriter as OurWriter
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from gyro_drift_filter.simulation.bag import TOPIC, imu_message, imu_messages, write_simulation
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from support.bags import OTHER_QOS, read, simulated, write
from support.messages import STORE, TEXT, doubles_of, imu_fields, offset_of_doubles, text


def expected(messages):
    filter_ = MessageFilter(Parameters())
    filtered = [(time, filter_.take(data)) for time, data in messages]
    return [(time, data) for time, data in filtered if data is not None]


def run(source, destination, **options):
    return replay(source, destination, parameters=Parameters(), **options)[0]


def check_unchanged_but_rate(before, after):
    """Compare Imu messages by bytes, outside the twelve doubles that the filter writes."""
    assert len(before) == len(after)
    for (time, old), (new_time, new) in zip(before, after, strict=True):
        assert time == new_time
        begin = offset_of_doubles(old) + 13 * 8
        assert old[:begin] == new[:begin]
        assert old[begin + 96 :] == new[begin + 96 :]


def test_topics_times_and_fields_are_kept(tmp_path):
    imu = simulated()
    words = [(imu[0][0] + 5 * k, text(f'word {k}')) for k in range(20)]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words})
    summary = run(source, tmp_path / 'out', diagnostics=True)
    topics, _ = read(tmp_path / 'out')
    assert topics[TOPIC] == imu
    assert topics['/words'] == words
    assert topics['/imu/data_filtered'] == expected(imu)
    check_unchanged_but_rate(imu, topics['/imu/data_filtered'])
    for name in SAMPLE_TOPICS:
        assert [t for t, _ in topics[f'/gyro_drift_filter/{name}']] == [t for t, _ in imu]
    assert len(topics['/diagnostics']) >= 2
    assert summary.received == summary.written == len(imu)


def test_qos_and_definitions_are_kept(tmp_path):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(10)})
    run(source, tmp_path / 'out')
    with AnyReader([source]) as before, AnyReader([tmp_path / 'out']) as after:
        old = before.connections[0]
        new = next(c for c in after.connections if c.topic == TOPIC)
        assert old.ext.offered_qos_profiles == new.ext.offered_qos_profiles == [OTHER_QOS]
        assert (old.digest, old.msgdef) == (new.digest, new.msgdef)
        ours = next(c for c in after.connections if c.topic == '/imu/data_filtered')
        assert ours.ext.offered_qos_profiles[0].reliability == QosReliability.RELIABLE


def test_output_opens_with_the_mcap_reader(tmp_path):
    imu = simulated()
    run(write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}), tmp_path / 'out')
    with (tmp_path / 'out' / 'out.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        counts = {
            channel.topic: reader.get_summary().statistics.channel_message_counts[channel.id]
            for channel in reader.get_summary().channels.values()
        }
        assert counts[TOPIC] == counts['/imu/data_filtered'] == len(imu)
        filtered = [
            (message.log_time, message.data)
            for _, _, message in reader.iter_messages(topics=['/imu/data_filtered'])
        ]
    assert filtered == expected(imu)


@pytest.mark.parametrize('plugin', list(StoragePlugin))
@pytest.mark.parametrize('mode', [None, CompressionMode.FILE, CompressionMode.MESSAGE])
def test_storage_and_compression(plugin, mode, tmp_path):
    imu = simulated()
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}, plugin, mode)
    run(source, tmp_path / 'out')
    assert read(tmp_path / 'out')[0]['/imu/data_filtered'] == expected(imu)


def test_compressed_chunks_and_a_bare_file(tmp_path):
    imu = simulated()
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}, mode=CompressionMode.STORAGE)
    run(tmp_path / 'in' / 'in.mcap', tmp_path / 'out')
    assert read(tmp_path / 'out')[0]['/imu/data_filtered'] == expected(imu)


def test_a_split_bag(tmp_path):
    """Two files under one metadata.yaml, as `ros2 bag record --max-bag-duration` leaves them."""
    imu = simulated()
    first = write(tmp_path / 'first', {(TOPIC, IMU_TYPE): imu[:200]})
    second = write(tmp_path / 'second', {(TOPIC, IMU_TYPE): imu[200:]})
    shutil.copy(second / 'second.mcap', first)
    metadata = (first / 'metadata.yaml').read_text()
    metadata = metadata.replace('  - first.mcap\n', '  - first.mcap\n  - second.mcap\n')
    metadata = metadata.replace('message_count: 200', f'message_count: {len(imu)}')
    (first / 'metadata.yaml').write_text(metadata)
    run(first, tmp_path / 'out')
    assert read(tmp_path / 'out')[0]['/imu/data_filtered'] == expected(imu)


@pytest.mark.slow
def test_overlapping_chunks_come_in_the_order_of_log_times(tmp_path):
    """A writer that flushes late: log times go back by a second, across the chunk's border."""
    imu = simulated(6000)
    times = [time for time, _ in imu]
    shuffled = imu[:2500] + imu[2600:2700] + imu[2500:2600] + imu[2700:]
    with Writer(tmp_path / 'in', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(TOPIC, IMU_TYPE, typestore=STORE)
        for time, data in shuffled:
            writer.write(connection, time, data)
    run(tmp_path / 'in', tmp_path / 'out')
    filtered = read(tmp_path / 'out')[0]['/imu/data_filtered']
    assert [time for time, _ in filtered] == times
    assert filtered == expected(imu)


def test_bad_messages_in_a_bag(tmp_path):
    imu = simulated()
    imu[100] = (imu[100][0], imu[100][1][:60])
    imu[101] = (imu[101][0], imu_message(imu[101][0], (np.nan, 0.0, 0.0), (0, 0, 9.8)))
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    summary = run(source, tmp_path / 'out')
    topics, _ = read(tmp_path / 'out')
    assert topics[TOPIC] == imu
    assert len(topics['/imu/data_filtered']) == len(imu) - 1
    assert summary.written == len(imu) - 1
    for _, data in topics['/imu/data_filtered']:
        assert np.isfinite(imu_fields(data).angular_velocity).all()


def test_the_choice_among_several_imu_topics(tmp_path):
    imu = simulated(20)
    source = write(tmp_path / 'in', {('/left/imu', IMU_TYPE): imu, ('/right/imu', IMU_TYPE): imu})
    with pytest.raises(BagError, match=r'several Imu topics.*--topic: /left/imu, /right/imu'):
        run(source, tmp_path / 'out')
    summary = run(source, tmp_path / 'out', selection=Selection(('right/imu',)))
    assert summary.output_topic == '/right/imu_filtered'
    assert read(tmp_path / 'out')[0]['/right/imu_filtered'] == expected(imu)


def test_an_imu_topic_without_messages_is_no_choice(tmp_path):
    imu = simulated(20)
    spare = ('/imu/spare', IMU_TYPE)
    source = write(tmp_path / 'in', {spare: [], (TOPIC, IMU_TYPE): imu})
    assert run(source, tmp_path / 'out').topic == TOPIC
    source = write(tmp_path / 'empty', {spare: [], (TOPIC, IMU_TYPE): []})
    with pytest.raises(BagError, match=r'the Imu topics have no messages: /imu/data_raw, /imu/sp'):
        run(source, tmp_path / 'none')


def test_a_bag_that_holds_our_own_output_is_filtered_anew(tmp_path):
    imu = simulated(300)
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    run(source, tmp_path / 'once')
    summary = run(tmp_path / 'once', tmp_path / 'twice')
    assert summary.topic == TOPIC
    assert summary.left_out == {
        '/imu/data_filtered': 'the filter writes this topic itself',
        '/diagnostics': 'what an earlier run of this filter has reported',
    }
    assert read(tmp_path / 'twice') == read(tmp_path / 'once')


@pytest.mark.parametrize(
    ('topic', 'node'),
    [(TOPIC, '/gyro_drift_filter'), ('/robot1/imu/data_raw', '/robot1/gyro_drift_filter')],
)
def test_diagnostics_name_node_and_gyroscope_as_the_node_does(topic, node, tmp_path):
    source = write(tmp_path / 'in', {(topic, IMU_TYPE): simulated(300)})
    summary = run(source, tmp_path / 'out')
    names = [f'{node}: input', f'{node}: filter']
    assert [status.name for status in summary.status] == names
    _, data = read(tmp_path / 'out')[0]['/diagnostics'][-1]
    statuses = STORE.deserialize_cdr(data, 'diagnostic_msgs/msg/DiagnosticArray').status
    assert [status.name for status in statuses] == names
    assert {status.hardware_id for status in statuses} == {'imu_link'}


@pytest.mark.slow
def test_recorded_sample_topics_are_kept_unless_they_are_written_anew(tmp_path):
    imu = simulated(100)
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    run(source, tmp_path / 'once', diagnostics=True)
    summary = run(tmp_path / 'once', tmp_path / 'kept')
    assert len(read(tmp_path / 'kept')[0]['/gyro_drift_filter/innovation']) == len(imu)
    assert set(summary.left_out) == {'/imu/data_filtered', '/diagnostics'}
    summary = run(tmp_path / 'once', tmp_path / 'anew', diagnostics=True)
    assert len(read(tmp_path / 'anew')[0]['/gyro_drift_filter/innovation']) == len(imu)
    # the filtered topic, at_rest, diagnostics
    assert len(summary.left_out) == 3 + len(SAMPLE_TOPICS)


def test_diagnostics_of_another_type_are_left_alone(tmp_path):
    imu, words = simulated(300), [(10**18, text('hello'))]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu, ('/diagnostics', TEXT): words})
    run(source, tmp_path / 'out')
    with AnyReader([tmp_path / 'out']) as reader:
        types = {c.msgtype: c.msgcount for c in reader.connections if c.topic == '/diagnostics'}
    assert types[TEXT] == 1
    assert types['diagnostic_msgs/msg/DiagnosticArray'] >= 2


def write_mcap(path, channels):
    """Write a bare MCAP with the official writer; channels is [(topic, encoding, schema, rows)]."""
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2')
        for topic, encoding, (name, definition), rows in channels:
            schema = writer.register_schema(name, 'ros2msg', definition.encode())
            channel = writer.register_channel(topic, encoding, schema)
            for time, data in rows:
                writer.add_message(channel, time, data, time)
        writer.finish()
    return path


IMU_SCHEMA = (IMU_TYPE, STORE.generate_msgdef(IMU_TYPE, ros_version=2)[0])


def test_two_publishers_of_one_topic_become_one(tmp_path):
    imu = simulated()
    source = write_mcap(
        tmp_path / 'two.mcap',
        [(TOPIC, 'cdr', IMU_SCHEMA, imu[::2]), (TOPIC, 'cdr', IMU_SCHEMA, imu[1::2])],
    )
    run(source, tmp_path / 'out')
    topics, _ = read(tmp_path / 'out')
    assert topics[TOPIC] == imu
    assert topics['/imu/data_filtered'] == expected(imu)


def test_topics_that_are_not_cdr_are_left_out_and_named(tmp_path):
    imu = simulated()
    source = write_mcap(
        tmp_path / 'json.mcap',
        [
            (TOPIC, 'cdr', IMU_SCHEMA, imu),
            ('/notes', 'json', ('std_msgs/msg/String', 'string data\n'), [(imu[0][0], b'{}')]),
        ],
    )
    summary = run(source, tmp_path / 'out')
    assert summary.left_out == {'/notes': 'its messages are not in CDR'}
    assert read(tmp_path / 'out')[0]['/imu/data_filtered'] == expected(imu)


def test_a_type_without_definition_passes(tmp_path):
    """As in bags from before definitions stood in them: sqlite, metadata version 5."""
    imu = simulated()
    source = write(
        tmp_path / 'in',
        {(TOPIC, IMU_TYPE): imu, ('/foo', TEXT): [(imu[5][0], text('opaque'))]},
        StoragePlugin.SQLITE3,
        version=8,
    )
    metadata = source / 'metadata.yaml'
    lines = metadata.read_text().replace(TEXT, 'my_msgs/msg/Foo').splitlines()
    lines = [line for line in lines if 'RIHS01' not in line and 'type_description_hash' not in line]
    lines = ['  version: 5' if line == '  version: 8' else line for line in lines]
    metadata.write_text('\n'.join(lines))
    with sqlite3.connect(source / 'in.db3') as database:
        database.execute('UPDATE topics SET type = ? WHERE type = ?', ('my_msgs/msg/Foo', TEXT))
        database.execute('DROP TABLE message_definitions')
        database.execute('UPDATE schema SET schema_version = 3')
    database.close()
    run(source, tmp_path / 'out')
    topics, _ = read(tmp_path / 'out')
    assert topics['/foo'] == [(imu[5][0], text('opaque'))]
    assert topics['/imu/data_filtered'] == expected(imu)


def test_the_summary_tells_of_the_whole_bag(tmp_path):
    """Degrees for a minute, then a rest: the end of the bag is not all of it."""
    stamps = 10**18 + 10**7 * np.arange(1000)
    rates = [(90.0 + k % 7 if k < 800 else 0.0, 0, k % 3 * 1e-3) for k in range(1000)]
    imu = list(imu_messages(stamps, rates, (0, 0, 9.8)))
    imu[3] = (imu[3][0], b'junk')
    words = [(imu[-1][0] + k * 10**9, text('late')) for k in range(1, 5)]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words})
    status = run(source, tmp_path / 'out').status[0]
    assert 'messages refused, the last because 4 bytes are too few' in status.message
    imu[3] = imu[4]
    source = write(tmp_path / 'in2', {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words})
    status = run(source, tmp_path / 'out2').status[0]
    assert 'the driver may publish degrees' in status.message


@pytest.mark.slow
def test_an_imu_that_comes_late_or_ends_early_loses_no_messages(tmp_path, random):
    """The other topics go on: no warning of a rate that is off."""
    stamps = 10**18 + 10**7 * np.arange(800)
    rates = 0.005 * random.standard_normal((800, 3))
    gravity = 9.8 / 3.0**0.5  # on each axis
    imu = list(imu_messages(stamps, rates, rates + gravity))
    for name, begin in (('late', -12), ('early', 0)):
        words = [(10**18 + k * 10**9, text('word')) for k in range(begin, begin + 20)]
        source = write(tmp_path / name, {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words})
        assert run(source, tmp_path / f'{name}_out').status[0].message == 'receiving'


def test_log_times_beyond_what_a_stamp_holds(tmp_path):
    late = 2**31 * 10**9
    imu = [(late + time - 10**18, data) for time, data in simulated(50)]
    run(write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}), tmp_path / 'out')
    assert read(tmp_path / 'out')[0][TOPIC] == imu


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path, monkeypatch):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})

    def full(self):
        raise OSError(28, 'No space left on device')

    monkeypatch.setattr('gyro_drift_filter.bags.writer.Writer.close', full)
    with pytest.raises(BagError, match='can not be written: No space left'):
        run(source, tmp_path / 'out')
    assert [path.name for path in tmp_path.iterdir()] == ['in']


@pytest.mark.parametrize('output', ['.', '/', 'in', 250 * 'x'])
def test_odd_outputs_are_refused(output, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    with pytest.raises(BagError, match=r'exists already|can not be written'):
        run(Path('in'), Path(output))


@pytest.mark.parametrize(
    ('topics', 'topic', 'message'),
    [
        ({('/words', TEXT): [(1, text('a'))]}, None, r'no topic of type .*Imu.*/words \(std_msgs'),
        ({('/words', TEXT): [(1, text('a'))]}, '/words', 'is of type std_msgs/msg/String, not'),
        ({(TOPIC, IMU_TYPE): simulated(9)}, '/none', 'no topic /none in the bag; Imu topics: /imu'),
        ({(TOPIC, IMU_TYPE): []}, None, 'topic /imu/data_raw has no messages'),
        ({}, None, 'the bag is empty'),
    ],
)
def test_bags_without_what_is_needed(topics, topic, message, tmp_path):
    source = write(tmp_path / 'in', topics)
    with pytest.raises(BagError, match=message):
        run(source, tmp_path / 'out', selection=Selection((topic,) if topic else ()))
    assert sorted(path.name for path in tmp_path.iterdir()) == ['in']


def test_a_folder_that_is_named_like_a_file_is_read(tmp_path):
    """As `ros2 bag record -o drive.mcap` makes it."""
    source = write(tmp_path / 'drive.mcap', {(TOPIC, IMU_TYPE): simulated(9)})
    run(source, tmp_path / 'out')
    assert len(read(tmp_path / 'out')[0]['/imu/data_filtered']) == len(simulated(9))


def test_paths_that_are_no_file(tmp_path):
    """A link to itself; a pipe, which would be waited for."""
    (tmp_path / 'loop').symlink_to('loop')
    with pytest.raises(BagError, match='no such bag'):
        run(tmp_path / 'loop', tmp_path / 'out')
    os.mkfifo(tmp_path / 'pipe.mcap')
    with pytest.raises(BagError, match='neither a file nor a folder'):
        run(tmp_path / 'pipe.mcap', tmp_path / 'out')
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    with pytest.raises(BagError, match='can not be written'):
        run(tmp_path / 'in', tmp_path / 'loop')


def test_paths_that_are_no_bag(tmp_path):
    with pytest.raises(BagError, match='no such bag'):
        run(tmp_path / 'none', tmp_path / 'out')
    (tmp_path / 'folder').mkdir()
    with pytest.raises(BagError, match=r'no metadata\.yaml, and no \.mcap or \.db3'):
        run(tmp_path / 'folder', tmp_path / 'out')
    (tmp_path / 'folder' / 'bag_0.mcap').touch()
    with pytest.raises(BagError, match=r'name a file in it, as .*bag_0\.mcap'):
        run(tmp_path / 'folder', tmp_path / 'out')
    for damaged in ('', 'rosbag2_bagfile_information:\n  version: 9\n  storage_id: "mca', 'a: 1'):
        (tmp_path / 'folder' / 'metadata.yaml').write_text(damaged)
        with pytest.raises(BagError, match=r'yaml is damaged.*name a file in it, as .*bag_0\.mcap'):
            run(tmp_path / 'folder', tmp_path / 'out')
    with pytest.raises(BagError, match='can not be opened'):
        run(tmp_path / (300 * 'x'), tmp_path / 'out')
    write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    with pytest.raises(BagError, match='lies within the bag to be read'):
        run(tmp_path / 'in', tmp_path / 'in' / 'out')
    with pytest.raises(BagError, match='lies within the bag to be read'):
        run(next((tmp_path / 'in').glob('*.mcap')), tmp_path / 'in' / 'out')
    assert not (tmp_path / 'in' / 'out').exists()
    for name in ('junk.mcap', 'junk.db3', 'junk.txt'):
        (tmp_path / name).write_bytes(b'not a bag' * 100)
        with pytest.raises(BagError, match='can not be read as a bag'):
            run(tmp_path / name, tmp_path / 'out')
    with pytest.raises(BagError, match=r'ends with none of \.mcap, \.db3, \.bag: name such'):
        run(tmp_path / 'junk.txt', tmp_path / 'out')
    (tmp_path / 'empty.mcap').touch()
    with pytest.raises(BagError, match='can not be read as a bag'):
        run(tmp_path / 'empty.mcap', tmp_path / 'out')
    write(tmp_path / 'rec.bag', {(TOPIC, IMU_TYPE): simulated(9)})
    with pytest.raises(BagError, match='rename the folder'):
        run(tmp_path / 'rec.bag', tmp_path / 'out')
    (tmp_path / 'old.bag').touch()
    with pytest.raises(BagError, match='can not be read as a bag'):
        run(tmp_path / 'old.bag', tmp_path / 'out')
    # Long enough for a magic number, and no longer.
    (tmp_path / 'short.mcap').write_bytes(b'\x89MCAP0\r\n')
    with pytest.raises(BagError, match='can not be read as a bag: it is damaged'):
        run(tmp_path / 'short.mcap', tmp_path / 'out')
    for name in ('out.mcap', 'out.db3'):
        with pytest.raises(BagError, match=f'is a folder: name it without .{name[4:]}'):
            run(tmp_path / 'in', tmp_path / name)


@pytest.mark.parametrize(
    ('storage', 'suffix'), [(StoragePlugin.SQLITE3, 'db3'), (StoragePlugin.MCAP, 'mcap')]
)
def test_compressed_messages_without_their_metadata_are_told(tmp_path, storage, suffix):
    """The file itself does not say so."""
    topics = {(TOPIC, IMU_TYPE): simulated(9)}
    source = write(tmp_path / 'in', topics, storage, CompressionMode.MESSAGE)
    with pytest.raises(BagError, match=r'holds compressed messages.*name the folder'):
        run(source / f'in.{suffix}', tmp_path / 'out')


def test_nothing_to_write_is_an_error_with_the_reason(tmp_path):
    """A bag without a filtered message would look like success."""
    imu = [(time, data[:60]) for time, data in simulated(9)]
    source = write(tmp_path / 'garbage', {(TOPIC, IMU_TYPE): imu})
    with pytest.raises(BagError, match=r'can be filtered: .* 60 bytes are not the length'):
        run(source, tmp_path / 'out')
    imu = [(10**18 + k, imu_message(10**18 + k, (0, np.nan, 0), (0, 0, 9.8))) for k in range(9)]
    source = write(tmp_path / 'nan', {(TOPIC, IMU_TYPE): imu})
    with pytest.raises(BagError, match='nothing of topic /imu/data_raw can be filtered: '):
        run(source, tmp_path / 'out')
    assert not (tmp_path / 'out').exists()


def test_diagnostics_of_other_nodes_are_kept(tmp_path):
    imu = simulated(300)
    others = [(imu[5][0], diagnostics_of('motor')), (imu[9][0], diagnostics_of('motor', 'pump'))]
    ours = [(imu[7][0], diagnostics_of(f'/gyro_drift_filter: {x}')) for x in ('input', 'filter')]
    mixed = [(imu[8][0], diagnostics_of('motor', '/gyro_drift_filter: input'))]
    recorded = {
        (TOPIC, IMU_TYPE): imu,
        ('/diagnostics', 'diagnostic_msgs/msg/DiagnosticArray'): others + ours + mixed,
    }
    run(write(tmp_path / 'in', recorded), tmp_path / 'out')
    run(write(tmp_path / 'in2', {(TOPIC, IMU_TYPE): imu}), tmp_path / 'out2')
    found, new = (read(tmp_path / name)[0]['/diagnostics'] for name in ('out', 'out2'))
    assert sorted(found) == sorted(others + mixed + new)


def diagnostics_of(*names):
    """Return a serialized DiagnosticArray with a status of each name."""
    kind, types = 'diagnostic_msgs/msg/DiagnosticArray', STORE.types
    status = types['diagnostic_msgs/msg/DiagnosticStatus']
    header = types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](1, 2), '')
    message = types[kind](header, [status(0, name, 'well', '', []) for name in names])
    return bytes(STORE.serialize_cdr(message, kind))


def test_an_output_that_exists_is_left_alone(tmp_path):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    (tmp_path / 'out').mkdir()
    with pytest.raises(BagError, match='exists already'):
        run(source, tmp_path / 'out')
    assert list((tmp_path / 'out').iterdir()) == []


def test_an_output_that_can_not_be_written(tmp_path):
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    (tmp_path / 'file').touch()
    with pytest.raises(BagError, match='can not be written'):
        run(source, tmp_path / 'file' / 'out')


def test_a_failure_leaves_nothing_that_looks_like_a_bag(tmp_path):
    def fail():
        with BagWriter(tmp_path / 'out') as writer:
            connection = writer.add_connection(TOPIC, IMU_TYPE)
            writer.write(connection, 1, simulated(9)[0][1])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ('topic', 'filtered', 'node', 'temperature'),
    [
        ('/imu/data_raw', '/imu/data_filtered', '/gyro_drift_filter', '/imu/temperature'),
        ('imu/data_raw', '/imu/data_filtered', '/gyro_drift_filter', '/imu/temperature'),
        (
            '/robot1/imu/data_raw',
            '/robot1/imu/data_filtered',
            '/robot1/gyro_drift_filter',
            '/robot1/imu/temperature',
        ),
        ('/camera/imu', '/camera/imu_filtered', '/camera/gyro_drift_filter', '/camera/temperature'),
        (
            '/os_cloud_node/data_raw',
            '/os_cloud_node/data_filtered',
            '/os_cloud_node/gyro_drift_filter',
            '/os_cloud_node/temperature',
        ),
        ('/imu', '/imu_filtered', '/gyro_drift_filter', '/temperature'),
    ],
)
def test_names_of_the_outputs(topic, filtered, node, temperature):
    assert Topics.of(topic) == Topics(filtered, node, temperature)


def test_simulated_bag_and_truth(tmp_path):
    data = simulate(SimulationSettings(seed=3, static_seconds=2, dynamic_seconds=20))
    archive = np.load(write_simulation(tmp_path / 'bag', data))
    topics, _ = read(tmp_path / 'bag')
    rates = np.array([imu_fields(message).angular_velocity for _, message in topics[TOPIC]])
    assert (rates == data.angular_velocity).all()
    stated = STORE.deserialize_cdr(topics[TOPIC][0][1], IMU_TYPE).angular_velocity_covariance
    noise = (rates - data.truth)[~data.outliers.any(axis=1)]
    np.testing.assert_allclose(np.sqrt(stated[::4]), noise.std(axis=0))
    assert (archive['truth'] == data.truth).all()
    assert (archive['outliers'] == data.outliers).all()
    error = np.abs(rates - archive['truth'])
    assert error[archive['outliers']].min() > 0.4
    assert error[~archive['outliers']].max() < 0.05
    assert not archive['outliers'][: 2 * 100].any()
    runs = np.diff(np.flatnonzero(archive['outliers'][:, 0]))
    assert (runs == 1).sum() >= 4 * 2
    again = simulate(SimulationSettings(seed=3, static_seconds=2, dynamic_seconds=20))
    assert (again.angular_velocity == data.angular_velocity).all()


@pytest.mark.slow
def test_real_recordings(recording, tmp_path):
    before, order = read(recording)
    summary = run(recording, tmp_path / 'out')
    after, new_order = read(tmp_path / 'out')
    for topic, messages in before.items():
        assert after[topic] == messages
    check_unchanged_but_rate(before[TOPIC], after['/imu/data_filtered'])
    assert summary.written == len(before[TOPIC])
    assert [row for row in new_order if row[0] in before] == order
    rates = [doubles_of(data)[13:16] for _, data in after['/imu/data_filtered']]
    assert np.isfinite(rates).all()
    with next(Path(tmp_path / 'out').glob('*.mcap')).open('rb') as stream:
        statistics = make_reader(stream).get_summary().statistics
        assert statistics.message_count == len(new_order)


def test_a_file_that_could_not_be_written_once_is_not_written_on(tmp_path, monkeypatch):
    writer = OurWriter(tmp_path / 'out.mcap', 'zstd')
    writer.add_schema(1, b'')
    writer.add_channel(1, b'')

    def full(parts):
        raise OSError('no space left on device')

    for k in range(3):
        writer.write_message(1, k, b'a message')
        with monkeypatch.context() as patch:
            if k == 0:
                patch.setattr(writer, '_file', Mock(wraps=writer._file, write=full))
            with pytest.raises(OSError, match='no space'):
                writer.flush()
    writer.abort()
