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

"""Bags of which some topics have message definitions that nobody can read."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest
from mcap.reader import make_reader
from mcap.writer import IndexType
from mcap.writer import Writer as McapWriter
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.bags.message_types import message_type, read_message, serialize
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.orientations import read_orientations
from gyro_drift_filter.bags.recording import BagError, messages
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.replay_run import TEMPERATURE_TYPE
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC
from support.bags import simulated, write
from support.messages import STORE, TEXT, text

IMU_DEFINITION = STORE.generate_msgdef(IMU_TYPE, ros_version=2)[0]
STORE_OF_ROS1 = get_typestore(Stores.ROS1_NOETIC)
OPAQUE = b'\0\1\0\0opaque'
# Type, language and text; the last two are what `ros2 bag` writes where it finds no definition.
ODD = {
    'Garbage': ('ros2msg', b'what is this !!\n'),
    'Bounded': ('ros2msg', b'wstring<=10 name "abc"\n'),
    'OfWindows': ('ros2msg', '\ufefffloat64 x  # with a mark\r\nfloat64 y\r\n'.encode()),
    'Latin': ('ros2msg', b'float64 x  # \xb0\n'),
    'Idl': (
        'ros2idl',
        b'=' * 80 + b'\nIDL: a/msg/Idl\n#include "std_msgs/msg/Header.idl"\nmodule ?\n',
    ),
    'Protobuf': ('protobuf', b'\n\xff\x00binary'),
    'Json': ('jsonschema', b'{"type": "object"}'),
    'Unknown': ('unknown', b''),
    'Empty': ('', b''),
}
# Their texts in a copy: what is not UTF-8 is in a comment, and other languages are not ROS's.
KEPT = {name: text for name, (language, text) in ODD.items() if language.startswith('ros2')}
KEPT['Latin'] = b'float64 x  # ?\n'


def of_mcap(path, imu, **options):
    """Write a bare file with Imu messages, and one message of each odd topic."""
    with (path / 'odd.mcap').open('wb') as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile='ros2')
        topics = {TOPIC: (IMU_TYPE, 'ros2msg', IMU_DEFINITION.encode(), imu)}
        rows = [(imu[-1][0], OPAQUE)]
        topics |= {f'/{name}': (f'a/msg/{name}', *of, rows) for name, of in ODD.items()}
        for topic, (kind, language, definition, contents) in topics.items():
            schema = writer.register_schema(kind, language, definition)
            channel = writer.register_channel(topic, 'cdr', schema)
            for time, data in contents:
                writer.add_message(channel, time, data, time)
        writer.finish()
    return path / 'odd.mcap'


WITHOUT_DEFINITIONS = {'repeat_channels': False, 'repeat_schemas': False}
WITHOUT_SUMMARY = WITHOUT_DEFINITIONS | {
    'use_statistics': False,
    'use_summary_offsets': False,
    'index_types': IndexType.NONE,
}
of_mcap_without_summary = partial(of_mcap, **WITHOUT_SUMMARY)
of_mcap_without_chunks = partial(of_mcap, use_chunking=False, **WITHOUT_SUMMARY)
of_mcap_without_definitions = partial(of_mcap, **WITHOUT_DEFINITIONS)
of_mcap_without_schemas = partial(of_mcap, repeat_schemas=False)


def of_sqlite(path, imu):
    """Write the same as a folder with an sqlite file."""
    with Writer(path / 'odd', version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        to = writer.add_connection(TOPIC, IMU_TYPE, typestore=STORE)
        for time, data in imu:
            writer.write(to, time, data)
        for name in ODD:
            kind = f'a/msg/{name}'
            to = writer.add_connection(f'/{name}', kind, msgdef='', rihs01=f'RIHS01_{"0" * 64}')
            writer.write(to, imu[-1][0], OPAQUE)
    with sqlite3.connect(path / 'odd' / 'odd.db3') as database:
        for name, (language, definition) in ODD.items():
            database.execute(
                'UPDATE message_definitions SET encoding = ?, encoded_message_definition = '
                'CAST(? AS TEXT) WHERE topic_type = ?',
                (language, definition, f'a/msg/{name}'),
            )
    database.close()
    return path / 'odd'


def of_sqlite_alone(path, imu):
    return of_sqlite(path, imu) / 'odd.db3'


def contents_of(bag):
    found = {}
    with open_bag(bag) as recording:
        for connection, _, data in messages(recording):
            found.setdefault(connection.topic, []).append(data)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    'make',
    [
        of_mcap,
        of_mcap_without_summary,
        of_mcap_without_chunks,
        of_mcap_without_definitions,
        of_mcap_without_schemas,
        of_sqlite,
        of_sqlite_alone,
    ],
)
def test_topics_that_nobody_can_read_are_copied(make, tmp_path):
    imu = simulated(20)
    source = make(tmp_path, imu)
    (summary,) = replay(source, tmp_path / 'out', parameters=Parameters())
    assert not summary.left_out
    assert summary.written == len(imu)
    before, after = contents_of(source), contents_of(tmp_path / 'out')
    assert before.keys() == {TOPIC} | {f'/{name}' for name in ODD}
    assert {topic: after[topic] for topic in before} == before
    with (tmp_path / 'out' / 'out.mcap').open('rb') as stream:
        schemas = {
            schema.name: schema.data
            for schema in make_reader(stream).get_summary().schemas.values()
        }
    assert schemas[IMU_TYPE].decode() == IMU_DEFINITION
    for name in ODD:
        assert schemas[f'a/msg/{name}'] == KEPT.get(name, b'')


@pytest.mark.parametrize('version', [8, 9])
def test_an_imu_that_is_of_another_type_is_refused(version, tmp_path):
    """Its messages would be read as what they are not."""
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): simulated(9)}, version=version)
    metadata = source / 'metadata.yaml'
    digest = STORE.hash_rihs01(IMU_TYPE)
    metadata.write_text(metadata.read_text().replace(digest, f'RIHS01_{"1" * 64}'))
    with pytest.raises(BagError, match='is not that of ROS 2, as its hash is RIHS01_111'):
        read_imu_arrays(source)


def swapped(kind, first, second):
    """Return the definition of a type with two fields in the order of each other."""
    definition = STORE.generate_msgdef(kind, ros_version=2)[0]
    return definition.replace(first, '?').replace(second, first).replace('?', second)


def of_one_topic(path, kind, definition, data):
    """Write a bare file with a message of a topic beside Imu messages."""
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2')
        for topic, of, text_, rows in (
            ('/it', kind, definition, [(1, data)]),
            (TOPIC, IMU_TYPE, IMU_DEFINITION, simulated(9)),
        ):
            schema = writer.register_schema(of, 'ros2msg', text_.encode())
            channel = writer.register_channel(topic, 'cdr', schema)
            for time, content in rows:
                writer.add_message(channel, time, content, time)
        writer.finish()
    return path


def message_of(bag):
    with open_bag(bag) as recording:
        of_topic = (row for row in messages(recording) if row[0].topic == '/it')
        connection, _, data = next(of_topic)
        return read_message(data, connection)


def header():
    stamp = message_type('builtin_interfaces/msg/Time')(1, 2)
    return message_type('std_msgs/msg/Header')(stamp, '')


TEMPERATURE = message_type(TEMPERATURE_TYPE)(header(), 21.0, 0.5)


def test_a_type_that_the_bag_has_with_other_fields_is_read_by_them(tmp_path):
    definition = swapped(TEMPERATURE_TYPE, 'float64 temperature', 'float64 variance')
    data = serialize(TEMPERATURE, TEMPERATURE_TYPE)
    found = message_of(of_one_topic(tmp_path / 'in.mcap', TEMPERATURE_TYPE, definition, data))
    assert (found.temperature, found.variance) == (0.5, 21.0)
    kind = 'geometry_msgs/msg/QuaternionStamped'
    definition = swapped(kind, 'float64 x', 'float64 w')
    quaternion = message_type('geometry_msgs/msg/Quaternion')(0.1, 0.2, 0.3, 0.9)
    data = serialize(message_type(kind)(header(), quaternion), kind)
    source = of_one_topic(tmp_path / 'body.mcap', kind, definition, data)
    assert read_orientations(source, '/it').orientations.tolist() == [[0.9, 0.2, 0.3, 0.1]]


@pytest.mark.parametrize('definition', ['float64 angle', 'builtin_interfaces/Time stamp'])
def test_an_orientation_without_what_it_is_read_for_is_told_in_a_line(definition, tmp_path):
    kind, data = 'geometry_msgs/msg/QuaternionStamped', b'\0\1\0\0' + bytes(8)
    source = of_one_topic(tmp_path / 'in.mcap', kind, definition, data)
    with pytest.raises(BagError, match=r'^1 message of /it can not be read$'):
        read_orientations(source, '/it')


@pytest.mark.parametrize('definition', ['', '# none', 'what is this !!', 'std_msgs/Header header'])
def test_a_type_that_the_bag_does_not_define_is_that_of_ros_2(definition, tmp_path):
    data = serialize(TEMPERATURE, TEMPERATURE_TYPE)
    found = message_of(of_one_topic(tmp_path / 'in.mcap', TEMPERATURE_TYPE, definition, data))
    assert (found.temperature, found.variance) == (21.0, 0.5)


def test_a_type_of_which_nothing_is_known_but_that_it_is_another_one_is_not_read(tmp_path):
    data = serialize(TEMPERATURE, TEMPERATURE_TYPE)
    topics = {(TOPIC, IMU_TYPE): simulated(9), ('/it', TEMPERATURE_TYPE): [(1, data)]}
    source = write(tmp_path / 'in', topics)
    assert message_of(source).temperature == 21.0
    path = source / 'metadata.yaml'
    path.write_text(path.read_text().replace(STORE.hash_rihs01(TEMPERATURE_TYPE), 'RIHS01_1'))
    (file,) = source.glob('*.mcap')
    file.write_bytes(file.read_bytes().replace(b'float64 variance', b'what is this !!!'))
    with pytest.raises(KeyError):
        message_of(source)


@pytest.mark.parametrize(
    ('old', 'new', 'messages', 'refused'),
    [
        ('Vector3 angular_velocity', 'Vector3 linear_acceleration', 9, True),
        # That of ROS 1.
        ('builtin_interfaces/Time stamp', 'uint32 seq\nbuiltin_interfaces/Time stamp', 9, True),
        ('builtin_interfaces/Time stamp', 'uint32 seq\nbuiltin_interfaces/Time stamp', 0, False),
        ('string frame_id', 'string<=64 frame_id', 9, False),
        ('float64[9] orientation_covariance', 'float64[9] orientation_cov', 9, True),
        ('float64[9] orientation_covariance', 'float64[] orientation_covariance', 9, True),
        ('float64[9] orientation_covariance', 'float32[9] orientation_covariance', 9, True),
    ],
)
def test_only_the_imu_that_is_read_has_to_be_that_of_ros_2(old, new, messages, refused, tmp_path):
    odd = swapped(IMU_TYPE, old, new) if new in IMU_DEFINITION else IMU_DEFINITION.replace(old, new)
    assert odd != IMU_DEFINITION
    path = tmp_path / 'in.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2')
        for topic, text, count in (('/good', IMU_DEFINITION, 9), ('/odd', odd, messages)):
            schema = writer.register_schema(IMU_TYPE, 'ros2msg', text.encode())
            channel = writer.register_channel(topic, 'cdr', schema)
            for time, data in simulated(count):
                writer.add_message(channel, time, data, time)
        writer.finish()
    assert len(read_imu_arrays(path, '/good').stamps) == len(simulated(9))
    if refused:
        with pytest.raises(BagError, match='the sensor_msgs/msg/Imu of /odd is not that of ROS 2'):
            read_imu_arrays(path, '/odd')
    elif messages:
        assert len(read_imu_arrays(path, '/odd').stamps) == len(simulated(9))


def test_a_hash_that_is_null_is_not_known(tmp_path):
    imu = simulated(9)
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}, version=9)
    metadata = source / 'metadata.yaml'
    metadata.write_text(metadata.read_text().replace(STORE.hash_rihs01(IMU_TYPE), 'null'))
    assert len(read_imu_arrays(source).stamps) == len(imu)


@pytest.mark.slow
def test_bags_of_sqlite_are_opened_by_several_threads(tmp_path):
    source = of_sqlite(tmp_path, simulated(9))
    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(contents_of, [source] * 40))
    assert all(one == found[0] for one in found)


def test_a_copy_has_one_definition_of_a_type_that_was_defined_twice(tmp_path):
    """As two versions of a package were recorded: readers compare hashes with the definition."""
    imu = simulated(9)
    with (tmp_path / 'two.mcap').open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2')
        for topic, kind, definition, data in (
            (TOPIC, IMU_TYPE, IMU_DEFINITION, None),
            ('/new', 'a/msg/Twice', 'float64 x\nfloat64 y\n', OPAQUE),
            ('/old', 'a/msg/Twice', 'float64 x\n', OPAQUE),
        ):
            schema = writer.register_schema(kind, 'ros2msg', definition.encode())
            channel = writer.register_channel(topic, 'cdr', schema)
            for time, content in imu:
                writer.add_message(channel, time, data or content, time)
        writer.finish()
    replay(tmp_path / 'two.mcap', tmp_path / 'out', parameters=Parameters())
    with AnyReader([tmp_path / 'out']) as reader:
        digests = {c.topic: c.digest for c in reader.connections}
    assert digests['/new'] == digests['/old']


def of_ros1(path, imu, definition):
    """Write a bag of ROS 1 with an Imu of a definition, and topics of odd ones."""
    types = STORE_OF_ROS1.types
    digests = {kind: STORE_OF_ROS1.generate_msgdef(kind)[1] for kind in (IMU_TYPE, TEXT)}
    with Ros1Writer(path) as writer:
        to = writer.add_connection(TOPIC, IMU_TYPE, msgdef=definition, md5sum=digests[IMU_TYPE])
        for k, (time, data) in enumerate(imu):
            of_ros2 = STORE.deserialize_cdr(data, IMU_TYPE)
            stamp = types['builtin_interfaces/msg/Time'](*divmod(time, 10**9))
            header = types['std_msgs/msg/Header'](k, stamp, of_ros2.header.frame_id)
            names = [name for name in vars(of_ros2) if name[0] != '_' and name != 'header']
            message = types[IMU_TYPE](header, *(getattr(of_ros2, name) for name in names))
            writer.write(to, time, STORE_OF_ROS1.serialize_ros1(message, IMU_TYPE))
        for topic, kind, written, digest in (
            ('/garbage', 'a/msg/Foo', 'what is this !!', '1' * 32),
            ('/other', 'a/msg/Bar', 'string data', '1' * 32),
            ('/of_windows', TEXT, 'string data\r\n', digests[TEXT]),
            ('/latin', TEXT, 'string data # ~\n', digests[TEXT]),
        ):
            to = writer.add_connection(topic, kind, msgdef=written, md5sum=digest)
            writer.write(to, imu[3][0], b'\4\0\0\0word')
    path.write_bytes(path.read_bytes().replace(b'data # ~', b'data # \xb0'))
    return path


@pytest.mark.slow
def test_topics_of_ros_1_that_can_not_be_converted_are_left_out(tmp_path):
    imu, definition = simulated(20), STORE_OF_ROS1.generate_msgdef(IMU_TYPE)[0]
    source = of_ros1(tmp_path / 'old.bag', imu, definition)
    (summary,) = replay(source, tmp_path / 'out', parameters=Parameters())
    assert summary.left_out.keys() == {'/garbage', '/other'}
    assert set(summary.left_out.values()) == {
        'its messages can not be converted to ROS 2: their definition can not be read, or is '
        'another one'
    }
    found = contents_of(tmp_path / 'out')
    assert found[TOPIC] == [data for _, data in imu]
    assert found['/of_windows'] == found['/latin'] == [text('word')]
    assert not {'/garbage', '/other'} & found.keys()


@pytest.mark.slow
def test_an_imu_of_ros_1_that_can_not_be_converted_is_told(tmp_path):
    source = of_ros1(tmp_path / 'old.bag', simulated(9), 'what is this !!')
    with pytest.raises(BagError, match='/imu/data_raw can not be converted to ROS 2: their defin'):
        read_imu_arrays(source)
