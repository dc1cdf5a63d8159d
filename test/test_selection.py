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

"""Parts of a recording: several Imu topics, a time, some topics; and bags of ROS 1."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.bags import rosbags_reader
from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.orientations import read_orientations
from gyro_drift_filter.bags.output import DIAGNOSTICS_TYPE
from gyro_drift_filter.bags.recording import BagError, Piece, messages
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.mcap.message_kernels import ROW
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.message_filter import MessageFilter
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from support.bags import read, simulated, with_damage, write
from support.messages import STORE, TEXT, text

HINT = '/odom'


def filtered(messages):
    filter_ = MessageFilter(Parameters())
    return [(time, filter_.take(data)) for time, data in messages]


def run(source, destination, *arguments, **options):
    return replay(
        source, destination, parameters=Parameters(), selection=Selection(*arguments, **options)
    )


def odometry(time):
    """Return an Odometry of that time in ns, of a robot that stands."""
    types = STORE.types
    point, vector, quaternion = (
        types[f'geometry_msgs/msg/{name}'] for name in ('Point', 'Vector3', 'Quaternion')
    )
    covariance = np.zeros(36)
    pose = types['geometry_msgs/msg/Pose'](point(0, 0, 0), quaternion(0, 0, 0, 1))
    twist = types['geometry_msgs/msg/Twist'](vector(0, 0, 0), vector(0, 0, 0))
    stamp = types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
    message = types['nav_msgs/msg/Odometry'](
        types['std_msgs/msg/Header'](stamp, 'odom'),
        'base',
        types['geometry_msgs/msg/PoseWithCovariance'](pose, covariance),
        types['geometry_msgs/msg/TwistWithCovariance'](twist, covariance),
    )
    return bytes(STORE.serialize_cdr(message, 'nav_msgs/msg/Odometry'))


def late(messages, nanoseconds):
    return [(time + nanoseconds, data) for time, data in messages]


@pytest.fixture
def two(tmp_path):
    """Return a bag with two Imu topics of different data, and words; and what is in it."""
    imu = simulated(900)
    topics = {
        ('/left/imu', IMU_TYPE): imu[:400],
        ('/right/imu', IMU_TYPE): late(imu[300:], -3_000_000_007),
        ('/words', TEXT): [(imu[0][0] + k * 10**8, text(f'{k}')) for k in range(30)],
    }
    return write(tmp_path / 'two', topics), {name: rows for (name, _), rows in topics.items()}


@pytest.mark.slow
def test_several_topics_have_a_filter_each(two, tmp_path):
    """What each writes is what it writes alone."""
    source, topics = two
    left, right = run(source, tmp_path / 'out', ('/left/imu', 'right/imu'))
    found, order = read(tmp_path / 'out')
    assert found['/left/imu_filtered'] == filtered(topics['/left/imu'])
    assert found['/right/imu_filtered'] == filtered(topics['/right/imu'])
    assert [time for _, time in order] == sorted(time for _, time in order)
    assert (left.written, right.written) == (400, 600)
    assert left.status[0].name == '/left/gyro_drift_filter: input'
    statuses = STORE.deserialize_cdr(found['/diagnostics'][-1][1], DIAGNOSTICS_TYPE).status
    assert [status.name for status in statuses] == [
        f'/{side}/gyro_drift_filter: {part}'
        for side in ('left', 'right')
        for part in ('input', 'filter')
    ]
    run(source, tmp_path / 'alone', ('/right/imu',))
    alone, _ = read(tmp_path / 'alone')
    assert alone['/right/imu_filtered'] == found['/right/imu_filtered']


@pytest.mark.slow
def test_all_imu_topics_but_those_that_were_written(two, tmp_path):
    source, _ = two
    summaries = run(source, tmp_path / 'once', all_imu=True)
    assert [summary.topic for summary in summaries] == ['/left/imu', '/right/imu']
    again = run(tmp_path / 'once', tmp_path / 'twice', all_imu=True)
    assert [summary.topic for summary in again] == ['/left/imu', '/right/imu']
    assert read(tmp_path / 'twice') == read(tmp_path / 'once')


@pytest.mark.slow
def test_sample_topics_of_two_sensors_in_one_namespace(tmp_path):
    imu = simulated(300)
    source = write(tmp_path / 'in', {('/imu', IMU_TYPE): imu, ('/gyro', IMU_TYPE): imu[:200]})
    replay(
        source,
        tmp_path / 'out',
        parameters=Parameters(),
        selection=Selection(all_imu=True),
        diagnostics=True,
    )
    found, _ = read(tmp_path / 'out')
    for name in SAMPLE_TOPICS:
        assert len(found[f'/gyro_drift_filter_imu/{name}']) == 300
        assert len(found[f'/gyro_drift_filter_gyro/{name}']) == 200
    assert found['/imu_filtered'] == filtered(imu)


def test_an_output_topic_of_another_name(two, tmp_path):
    source, topics = two
    (summary,) = run(source, tmp_path / 'out', ('/left/imu',), output_topic='mine/imu')
    assert summary.output_topic == '/mine/imu'
    assert read(tmp_path / 'out')[0]['/mine/imu'] == filtered(topics['/left/imu'])
    for options, reason in (
        ({'all_imu': True, 'output_topic': '/x'}, 'one output topic for several'),
        ({'imu_topics': ('/left/imu',), 'output_topic': '/right/imu'}, 'there is a topic /right'),
        ({'imu_topics': ('/left/imu',), 'output_topic': '/diagnostics'}, 'there is a topic /diag'),
        ({'imu_topics': ('/left/imu',), 'output_topic': 'a b'}, "'a b' is no name of a topic"),
        ({'imu_topics': ('/left/imu',), 'output_topic': ''}, "'' is no name of a topic"),
    ):
        with pytest.raises(BagError, match=reason):
            run(source, tmp_path / 'none', **options)


def test_a_topic_that_gives_nothing_does_not_stop_the_others(tmp_path, capsys):
    imu = simulated(300)
    topics = {
        ('/a/imu', IMU_TYPE): imu,
        ('/b/imu', IMU_TYPE): [],
        ('/c/imu', IMU_TYPE): [(t, imu_message(t, (0, np.nan, 1), (0, 0, 9.8))) for t, _ in imu],
    }
    source = write(tmp_path / 'in', topics)
    assert main(['replay', str(source), '-o', str(tmp_path / 'out'), '--all-imu']) == 0
    assert read(tmp_path / 'out')[0]['/a/imu_filtered'] == filtered(imu)
    printed = capsys.readouterr()
    assert 'warning: /b/imu: no message: ' in printed.err
    assert 'warning: /c/imu: no usable rate on some axis' in printed.err
    assert printed.out.count('no figures: no message had a usable rate on all axes') == 2
    assert re.search(r'^y +no usable rate +-', printed.out, re.MULTILINE)
    assert 'nan' not in printed.out


def test_names_that_meet_are_refused(tmp_path):
    imu = simulated(9)
    source = write(tmp_path / 'in', {('/a/data', IMU_TYPE): imu, ('/a/data_raw', IMU_TYPE): imu})
    names = {Topics.of(topic).filtered for topic in ('/a/data', '/a/data_raw')}
    assert names == {'/a/data_filtered'}
    with pytest.raises(BagError, match='would be /a/data_filtered, which is another one'):
        run(source, tmp_path / 'out', all_imu=True)


@pytest.mark.parametrize(
    ('kept', 'topics'),
    [
        (('/words',), {'/words'}),
        (('words', '/imu/data_raw'), {'/words', TOPIC}),
        ((), set()),
    ],
)
def test_only_some_topics_are_kept(kept, topics, tmp_path):
    imu = simulated(300)
    words = [(imu[9][0], text('word'))]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words})
    run(source, tmp_path / 'out', kept=kept)
    found, _ = read(tmp_path / 'out')
    assert set(found) == topics | {'/imu/data_filtered', '/diagnostics'}
    assert found['/imu/data_filtered'] == filtered(imu)
    with pytest.raises(BagError, match='no topic /none in the bag; it holds /imu/data_raw, /words'):
        run(source, tmp_path / 'out2', kept=('/none',))


@pytest.mark.slow
def test_a_part_of_the_time_is_as_a_shorter_recording(tmp_path):
    imu = simulated(6000)
    begin = imu[0][0] - 10**9
    words = [(begin + k * 10**8, text(f'{k}')) for k in range(300)]
    topics = {(TOPIC, IMU_TYPE): imu, ('/words', TEXT): words}
    source = write(tmp_path / 'in', topics)
    short = {
        name: [(t, data) for t, data in rows if 2.5 <= (t - begin) * 1e-9 <= 20.0]
        for name, rows in topics.items()
    }
    assert 0 < len(short[TOPIC, IMU_TYPE]) < 2000
    run(source, tmp_path / 'part', start=2.5, end=20.0)
    run(write(tmp_path / 'short', short), tmp_path / 'other')
    assert read(tmp_path / 'part') == read(tmp_path / 'other')
    with pytest.raises(BagError, match='no messages from 100 s on, counted from'):
        run(source, tmp_path / 'none', start=100.0)


def test_the_files_of_a_folder_are_read_in_the_order_of_time(tmp_path):
    """And not in that in which metadata.yaml lists them."""
    first = write(tmp_path / 'a', {(TOPIC, IMU_TYPE): simulated(300)[:150]})
    second = write(tmp_path / 'b', {(TOPIC, IMU_TYPE): simulated(300)[150:]})
    with open_bag(first) as one, open_bag(second) as other:
        expected = [time for bag in (one, other) for _, time, _ in messages(bag)]
    (second / 'b.mcap').rename(first / 'b.mcap')
    metadata = yaml.safe_load((first / 'metadata.yaml').read_text())
    information = metadata['rosbag2_bagfile_information']
    information['relative_file_paths'] = ['b.mcap', 'a.mcap']
    information['message_count'] = 2 * information['message_count']
    (first / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    with open_bag(first) as bag:
        assert [time for _, time, _ in messages(bag)] == expected


@pytest.mark.slow
@pytest.mark.parametrize('first', [0, 1])
def test_publishers_of_one_topic_that_do_not_agree_on_its_type(first, tmp_path):
    """The messages of the type that is meant are taken, whichever was recorded first."""
    imu, kind = simulated(100), 'nav_msgs/msg/Odometry'
    others = [
        ((TOPIC, TEXT), [(time, text('word')) for time, _ in imu]),
        ((HINT, TEXT), [(imu[0][0], text('word'))]),
    ]
    wanted = [
        ((TOPIC, IMU_TYPE), imu),
        ((HINT, kind), [(time, odometry(time)) for time, _ in imu]),
    ]
    source = write(tmp_path / 'in', dict([*wanted, *others] if first else [*others, *wanted]))
    summary = run(source, tmp_path / 'out', hint=HINT)[0]
    run(write(tmp_path / 'alone', dict(wanted)), tmp_path / 'of_alone', hint=HINT)
    assert summary.received == summary.written == 100
    found, expected = (read(tmp_path / name)[0] for name in ('out', 'of_alone'))
    assert found['/imu/data_filtered'] == expected['/imu/data_filtered']
    assert sorted(found[TOPIC]) == sorted(imu + others[0][1])
    assert len(read_imu_arrays(source).stamps) == len(read_orientations(source, HINT).stamps) == 100
    with pytest.raises(BagError, match=f'is of type {kind} and {TEXT}, not {IMU_TYPE}'):
        run(source, tmp_path / 'none', (HINT,))


def test_files_in_another_order_than_that_of_time_lose_nothing():
    """As where the files of one bag overlap in time."""
    for begins in ((2, 0), (0, 5, 1)):
        pieces = []
        for begin in begins:
            rows = np.zeros(20, ROW)
            rows['log_time'] = 10**18 + 10**9 * begin + 10**8 * np.arange(20)
            pieces.append(Piece(np.zeros(0, np.uint8), rows))
        together = Piece(pieces[0].data, np.concatenate([piece.rows for piece in pieces]))
        whole, part = 20 * len(begins), 3 * (len(begins) - 1)
        for parts in (pieces, [together]):
            recording = SimpleNamespace(
                pieces=lambda parts=parts: iter(parts), message_count=whole, in_order=False
            )
            for selection, count in ((Selection(), whole), (Selection(start=0.95, end=1.25), part)):
                found = selection.pieces(recording, lambda done, total: None)
                assert sum(len(piece.rows) for piece in found) == count


def two_files(tmp_path, later):
    """Return a folder of two files, each of one topic with 400 messages in 4 s."""
    folder, second = tmp_path / 'a', tmp_path / 'b'
    write(folder, {('/left/imu', IMU_TYPE): simulated(400)})
    topic = [(time + later, data) for time, data in simulated(400)]
    write(second, {('/right/imu', IMU_TYPE): topic})
    (second / 'b.mcap').rename(folder / 'b.mcap')
    metadata = yaml.safe_load((folder / 'metadata.yaml').read_text())
    other = yaml.safe_load((second / 'metadata.yaml').read_text())
    information, more = (m['rosbag2_bagfile_information'] for m in (metadata, other))
    for name in ('relative_file_paths', 'files', 'topics_with_message_count'):
        information[name] += more[name]
    information['message_count'] += more['message_count']
    (folder / 'metadata.yaml').write_text(yaml.safe_dump(metadata))
    return folder


@pytest.mark.parametrize(('later', 'found', 'read'), [(0, 200, 13), (4 * 10**9, 100, 3)])
def test_no_more_is_read_than_may_lie_within_the_time(later, found, read, tmp_path, monkeypatch):
    """All of one file comes before the other, which may begin before the end that is asked."""
    monkeypatch.setattr(rosbags_reader, '_PIECE_MESSAGES', 64)
    with open_bag(two_files(tmp_path, later)) as bag:
        assert bag.in_order == (later > 0)
        seen, pieces = [], bag.pieces

        def noted():
            for piece in pieces():
                seen.append(piece)
                yield piece

        monkeypatch.setattr(bag, 'pieces', noted)
        parts = Selection(end=0.995).pieces(bag, lambda done, total: None)
        rows = np.concatenate([piece.rows for piece in parts])
    assert len(rows) == found
    assert len(seen) == read


def test_messages_that_can_not_be_read_are_counted(tmp_path, caplog):
    """As where the file of a bag was exchanged: rosbags passes over what has another QoS."""
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)})
    metadata = source / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace('best_effort', 'reliable'))
    with pytest.raises(BagError, match='has no messages'):
        run(source, tmp_path / 'out')
    assert '0 of 8 messages could be read' in caplog.text
    caplog.clear()
    run(source / 'in.mcap', tmp_path / 'out')
    assert not caplog.text


def test_the_options_of_the_command(two, tmp_path, capsys):
    source, topics = two
    arguments = ['replay', str(source), '-o', str(tmp_path / 'out'), '--topic', '/left/imu']
    options = ['--output-topic', '/mine', '--start', '1', '--end', '2', '--topics']
    assert main([*arguments, *options]) == 0
    found, _ = read(tmp_path / 'out')
    assert set(found) == {'/mine', '/diagnostics'}
    begin = read(source)[1][0][1]
    assert [t for t, _ in found['/mine']] == [
        t for t, _ in topics['/left/imu'] if 1.0 <= (t - begin) * 1e-9 <= 2.0
    ]
    capsys.readouterr()
    assert main(['replay', str(source), '-o', str(tmp_path / 'all'), '--all-imu']) == 0
    printed = capsys.readouterr().out
    assert '/left/imu -> /left/imu_filtered: 400 messages' in printed
    assert '/right/imu -> /right/imu_filtered: 600 messages' in printed
    assert main([*arguments, '--start', '3', '--end', '3', '--force']) == 1
    assert '--start 3 is not before --end 3' in capsys.readouterr().err
    for wrong in ('-5', 'nan', 'inf', 'soon'):
        with pytest.raises(SystemExit):
            main([*arguments, '--start', wrong, '--force'])
        assert f'--start: {wrong} is no time since the first' in capsys.readouterr().err


def ros1_bag(path, imu):
    """Write a ROS 1 bag with Imu messages, latched transforms under their old name, and words."""
    store = get_typestore(Stores.ROS1_NOETIC)
    types = store.types
    header = types['std_msgs/msg/Header']
    with Ros1Writer(path) as writer:
        to = writer.add_connection('/imu/data_raw', IMU_TYPE, typestore=store)
        words = writer.add_connection('/words', TEXT, typestore=store, latching=1)
        for k, (time, data) in enumerate(imu):
            of_ros2 = STORE.deserialize_cdr(data, IMU_TYPE)
            stamp = types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
            message = types[IMU_TYPE](
                header(k, stamp, of_ros2.header.frame_id),
                *(getattr(of_ros2, name) for name in list(vars(of_ros2))[1:] if name[0] != '_'),
            )
            writer.write(to, time, store.serialize_ros1(message, IMU_TYPE))
        word = store.serialize_ros1(types[TEXT]('word'), TEXT)
        writer.write(words, imu[3][0], word)
    return path


@pytest.mark.slow
def test_a_bag_of_ros_1_is_read_as_one_of_ros_2(tmp_path):
    imu = simulated(300)
    source = ros1_bag(tmp_path / 'old.bag', imu)
    run(source, tmp_path / 'out')
    run(write(tmp_path / 'new', {(TOPIC, IMU_TYPE): imu}), tmp_path / 'of_new')
    found, _ = read(tmp_path / 'out')
    assert found[TOPIC] == imu
    assert found['/imu/data_filtered'] == read(tmp_path / 'of_new')[0]['/imu/data_filtered']
    assert found['/words'] == [(imu[3][0], text('word'))]
    with open_bag(tmp_path / 'out') as recording:
        qos = {
            c.topic: c.ext.offered_qos_profiles[0].durability.name for c in recording.connections
        }
    assert (qos['/words'], qos[TOPIC]) == ('TRANSIENT_LOCAL', 'VOLATILE')


def test_what_is_no_whole_bag_of_ros_1_is_told_with_what_to_do(tmp_path):
    """The texts of the library were those of its own code."""
    whole = ros1_bag(tmp_path / 'old.bag', simulated(300)).read_bytes()
    for content, message in (
        (b'\x89MCAP0\r\n' + bytes(99), r'it is no bag of ROS 1, though .*the \.mcap or \.db3 file'),
        (b'#ROS', r'can not be read as a bag: '),
        (whole[:5000], r'its index is missing or damaged.* run `rosbag reindex` of ROS 1'),
        (whole[:-100], r'its index is missing or damaged.* run `rosbag reindex` of ROS 1'),
        (with_damage(whole, 69), r'it is damaged, or .* run `rosbag reindex` of ROS 1'),
        (with_damage(whole, whole.index(b'conn=', 9000)), r'a part of it is damaged: run `rosbag'),
        (b'#ROSBAG V1.2\n' + whole[13:], r'version .* is not supported'),
    ):
        (tmp_path / 'no.bag').write_bytes(content)
        with pytest.raises(BagError, match=message):
            run(tmp_path / 'no.bag', tmp_path / 'out')


def test_a_message_of_ros_1_that_lies_is_one_line(tmp_path):
    source = ros1_bag(tmp_path / 'old.bag', simulated(9))
    data = source.read_bytes()
    frame = data.index(b'\x08\x00\x00\x00imu_link')
    source.write_bytes(data[:frame] + b'\xff\xff\xff\x7f' + data[frame + 4 :])
    with pytest.raises(BagError, match='of /imu/data_raw can not be converted to ROS 2'):
        run(source, tmp_path / 'out')
