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

"""Both readers of recordings give the same pieces, and what is done with files that lie."""

import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, event, given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter

from gyro_drift_filter.bags import opening
from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.bags.mcap_reader import ChunkReader
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.output import Output
from gyro_drift_filter.bags.recording import BagError, messages
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.rosbags_reader import RosbagsReader
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.mcap.message_kernels import rows_of
from gyro_drift_filter.mcap.reader import read_layout
from gyro_drift_filter.mcap.records import MESSAGE, PREFIX
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.recordings.examined import read_recording
from gyro_drift_filter.recordings.samples import read_samples
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from support.bags import mixed, read, write, write_mcap
from support.chunks import EACH_CHANNEL
from support.messages import NOT_REPORTED, START, STORE, TEMPERATURE, TEXT, doubles_of, fault_of

WHOLE = 0.0, np.inf  # s


def by_both(source, folder, monkeypatch, chunks=True, **options):
    """Replay by the reader of chunks and by rosbags; return both files' bytes and summaries."""
    with open_bag(source) as recording:
        assert isinstance(recording, ChunkReader) == chunks
    results = []
    for name in ('chunks', 'rosbags'):
        out = folder / name / 'out'
        with monkeypatch.context() as patch:
            if name == 'rosbags':
                patch.setattr(opening, 'choose_reader', RosbagsReader)
            (summary,) = replay(source, out, parameters=Parameters(), **options)
        files = [(out / 'out.mcap').read_bytes(), (out / 'metadata.yaml').read_text()]
        results.append((files, summary))
    return results


def check_same(results):
    (chunks, a), (rosbags, b) = results
    assert chunks == rosbags
    assert a.status == b.status
    assert (a.outliers == b.outliers).all()
    for name in ('received', 'written', 'not_reported', 'left_out', 'period'):
        assert getattr(a, name) == getattr(b, name)


@pytest.mark.slow
@pytest.mark.parametrize('diagnostics', [False, True])
@pytest.mark.parametrize(
    'options',
    [
        {'compression': CompressionType.NONE},
        {'compression': CompressionType.LZ4, 'chunk_size': 10_000},
        {'compression': CompressionType.ZSTD, 'chunk_size': 30_000},
        {'chunk_size': 1},
    ],
)
def test_both_readers_lead_to_the_same_bytes(options, diagnostics, tmp_path, monkeypatch, random):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random), **options)
    check_same(by_both(source, tmp_path, monkeypatch, diagnostics=diagnostics))


@pytest.mark.slow
def test_the_same_of_real_recordings(recording, tmp_path, monkeypatch):
    check_same(by_both(recording, tmp_path, monkeypatch))


@pytest.mark.slow
def test_chunks_of_the_output_end_where_messages_end(tmp_path, monkeypatch, random):
    """More than a chunk of output; another reader finds all of it, checksums and counts."""
    source = write_mcap(tmp_path / 'in.mcap', mixed(random, 30))
    results = by_both(source, tmp_path, monkeypatch, diagnostics=True)
    check_same(results)
    with (tmp_path / 'chunks' / 'out' / 'out.mcap').open('rb') as stream:
        reader = make_reader(stream, validate_crcs=True)
        summary = reader.get_summary()
        assert len(summary.chunk_indexes) > 2
        counts = dict.fromkeys(summary.channels, 0)
        for _, channel, message in reader.iter_messages():
            counts[channel.id] += 1
            assert message.publish_time == message.log_time
        assert counts == summary.statistics.channel_message_counts
        assert sum(counts.values()) == summary.statistics.message_count
        assert results[0][1].written == next(
            counts[key] for key, c in summary.channels.items() if c.topic == '/imu/data_filtered'
        )


@pytest.mark.slow
def test_batches_of_many_messages(tmp_path, monkeypatch):
    """More than fit in a batch, all within a second."""
    rows = [
        (TOPIC, IMU_TYPE, START + 1000 * k, imu_message(START + 1000 * k, (0, 0, 0.1), (0, 0, 9)))
        for k in range(10_000)
    ]
    source = write_mcap(tmp_path / 'in.mcap', rows)
    check_same(by_both(source, tmp_path, monkeypatch))


@pytest.mark.slow
def test_messages_that_are_seconds_apart(tmp_path, monkeypatch, random):
    """A report for nearly each message; not many are kept at a time."""
    write, most = Output.write, []

    def counted(output, piece, imus, reports, statuses):
        most.append(len(reports))
        write(output, piece, imus, reports, statuses)

    rows, time = [], START
    for topic, kind, _, data in mixed(random, 6):
        time += int(random.integers(0, 2 * 10**9))
        rows.append((topic, kind, time, data))
    source = write_mcap(tmp_path / 'in.mcap', rows)
    monkeypatch.setattr(Output, 'write', counted)
    results = by_both(source, tmp_path, monkeypatch)
    check_same(results)
    assert sum(most) > 300
    assert max(most) < 150


MESSAGES = st.lists(
    st.tuples(
        st.sampled_from([TOPIC, '/words', '/imu/temperature']),
        st.integers(0, 700_000_000),
        st.one_of(
            st.binary(max_size=400),
            st.floats(-40, 40).map(lambda v: imu_message(START, (v, 0.0, -v), (0, 0, 9.8))),
        ),
    ),
    min_size=1,
    max_size=60,
)


@pytest.mark.slow
@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(MESSAGES, st.integers(1, 5000), st.booleans())
def test_both_readers_agree_on_anything(
    tmp_path_factory, monkeypatch, messages, chunk_size, diagnostics
):
    """Any bytes, in chunks of any size; within a chunk in any order."""
    folder = tmp_path_factory.mktemp('any')
    kinds = {TOPIC: IMU_TYPE, '/words': TEXT, '/imu/temperature': TEMPERATURE}
    time, rows = START, [(TOPIC, IMU_TYPE, START, imu_message(START, (0, 0, 0), (0, 0, 9.8)))]
    for topic, step, data in messages:
        time += step
        rows.append((topic, kinds[topic], time, data))
    source = write_mcap(folder / 'in.mcap', rows, chunk_size=chunk_size)
    check_same(by_both(source, folder, monkeypatch, diagnostics=diagnostics))


def test_a_damaged_message_that_looks_compressed_ends_nothing(tmp_path, monkeypatch, random):
    rows = mixed(random)
    rows[10] = (*rows[10][:3], b'\x28\xb5\x2f\xfd' + bytes(40))
    source = write_mcap(tmp_path / 'in.mcap', rows)
    check_same(by_both(source, tmp_path, monkeypatch))


def test_out_of_order_within_a_chunk(tmp_path, monkeypatch, random):
    rows = mixed(random)
    order = np.arange(len(rows)) + random.integers(0, 20, len(rows))
    rows = [rows[k] for k in np.argsort(order, kind='stable')]
    source = write_mcap(tmp_path / 'in.mcap', rows)
    check_same(by_both(source, tmp_path, monkeypatch))


@pytest.mark.slow
def test_what_is_left_to_rosbags(tmp_path, monkeypatch, random):
    rows = mixed(random)
    overlapping = rows[50:100] + rows[:50]
    for name, arguments in (
        ('overlap', {'rows': overlapping, 'chunk_size': 1000}),
        ('flat', {'rows': rows, 'use_chunking': False}),
    ):
        source = write_mcap(tmp_path / f'{name}.mcap', **arguments)
        results = by_both(source, tmp_path / name, monkeypatch, chunks=False)
        check_same(results)
    imus = [(time, data) for topic, _, time, data in rows if topic == TOPIC]
    from rosbags.rosbag2 import CompressionMode, StoragePlugin

    for mode, plugin in (
        (CompressionMode.MESSAGE, StoragePlugin.MCAP),
        (None, StoragePlugin.SQLITE3),
    ):
        source = write(tmp_path / f'bag{plugin.name}', {(TOPIC, IMU_TYPE): imus}, plugin, mode)
        check_same(by_both(source, tmp_path / plugin.name, monkeypatch, chunks=False))


def test_log_times_near_the_end_of_time(tmp_path, monkeypatch):
    """The end of a batch may lie where no 63 bits reach."""
    rows = [
        (TOPIC, IMU_TYPE, time, imu_message(START, (0, 0, 0.1), (0, 0, 9.8)))
        for time in (2**63 - 10**9 + 5, 2**63 - 7, 2**63 - 1)
    ]
    check_same(by_both(write_mcap(tmp_path / 'in.mcap', rows), tmp_path, monkeypatch))
    rows.append((TOPIC, IMU_TYPE, 2**63 + 5, rows[0][3]))
    late = write_mcap(tmp_path / 'late.mcap', rows)
    with open_bag(late) as recording:
        assert isinstance(recording, RosbagsReader)
        assert not isinstance(recording, ChunkReader)
    replay(late, tmp_path / 'late', parameters=Parameters())
    assert [time for time, _ in read(tmp_path / 'late')[0][TOPIC]] == [row[2] for row in rows]


def test_chunks_without_an_index_are_left_to_rosbags(tmp_path, random):
    options = {'index_types': IndexType.ALL & ~IndexType.MESSAGE}
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **options)
    assert read_layout(path) is None


@pytest.mark.parametrize('first', ['json', 'cdr'])
def test_an_imu_topic_in_two_encodings(first, tmp_path, monkeypatch):
    """What is not in CDR is left out, and named."""
    path = tmp_path / 'in.mcap'
    encodings = [first, *({'json', 'cdr'} - {first})]
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2', library='test')
        definition, _ = STORE.generate_msgdef(IMU_TYPE, ros_version=2)
        schema = writer.register_schema(IMU_TYPE, 'ros2msg', definition.encode())
        channels = {name: writer.register_channel(TOPIC, name, schema) for name in encodings}
        for k in range(100):
            time = START + 10_000_000 * k
            message = imu_message(time, (0.001 * k, 0, 0), (0, 0, 9.8))
            for name in encodings:
                data = b'{"angular_velocity": {}}' if name == 'json' else message
                writer.add_message(channels[name], time, data, time)
        writer.finish()
    results = by_both(path, tmp_path, monkeypatch)
    check_same(results)
    assert results[0][1].received == results[0][1].written == 100
    assert results[0][1].left_out == {TOPIC: 'its messages are not in CDR'}
    arrays = read_imu_arrays(path)
    assert (len(arrays.stamps), arrays.refused) == (100, 0)
    _, examined = read_recording(path, None, WHOLE, lambda done, total: None)
    assert (len(examined.stamps), examined.connections) == (100, 1)


def test_an_imu_topic_that_is_not_in_cdr_at_all(tmp_path):
    path = tmp_path / 'in.mcap'
    with path.open('wb') as stream:
        writer = McapWriter(stream)
        writer.start(profile='ros2', library='test')
        definition, _ = STORE.generate_msgdef(IMU_TYPE, ros_version=2)
        schema = writer.register_schema(IMU_TYPE, 'ros2msg', definition.encode())
        writer.add_message(writer.register_channel(TOPIC, 'json', schema), START, b'{}', START)
        writer.finish()
    refused = 'the messages of topic /imu/data_raw are not in CDR'
    check_refused(path, tmp_path, refused)
    with pytest.raises(BagError, match=refused):
        read_imu_arrays(path)
    with pytest.raises(BagError, match=refused):
        read_recording(path, None, WHOLE, lambda done, total: None)


def places_of(path):
    return list(read_layout(path).chunks())


def check_refused(path, folder, reason):
    with pytest.raises(BagError, match=reason) as error:
        replay(path, folder / 'out', parameters=Parameters())
    assert '\n' not in str(error.value)
    assert not (folder / 'out').exists()
    assert not list(folder.glob('.out*'))


def test_a_damaged_chunk_is_one_line(tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), chunk_size=30_000)
    data = bytearray(path.read_bytes())
    place = places_of(path)[1]
    data[place.start + place.length // 2] ^= 0xFF
    path.write_bytes(data)
    check_refused(path, tmp_path, 'is damaged and can be read no further: the chunk at byte')


@pytest.mark.parametrize('library', [False, True])
@pytest.mark.parametrize('number', [0, 1, -1])
def test_only_damage_within_the_time_matters(number, library, tmp_path, monkeypatch, random):
    """And where messages are lost is told; rosbags reads nothing behind the damage."""
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), chunk_size=30_000)
    whole, places = path.read_bytes(), places_of(path)
    place, begin = places[number], places[0].first
    first, last = (1e-9 * (time - begin) for time in (place.first, place.last))
    if library:
        monkeypatch.setattr(opening, 'choose_reader', RosbagsReader)
    data = bytearray(whole)
    data[place.start + place.length // 2] ^= 0xFF
    parts = [Selection(start=0.0, end=first - 0.02)] if number else []
    if place != places[-1] and not library:
        parts.append(Selection(start=last + 0.005, end=5.0))
    for selection in parts:
        found = []
        for content in (whole, bytes(data)):
            path.write_bytes(content)
            with open_bag(path) as recording:
                pieces = selection.pieces(recording, lambda done, total: None)
                found.append([p.message(row) for p in pieces for row in range(len(p.rows))])
        assert found[0] == found[1]
        assert len(found[0]) > 50
    path.write_bytes(data)
    told = rf'from {first:.3f} s to {last:.3f} s, counted from the first message'
    if library:
        told = r'from \d+\.\d+ s on, counted from the first' if number else 'read no further'
    check_refused(path, tmp_path, told)
    with pytest.raises(BagError, match=told), open_bag(path) as recording:
        list(messages(recording))


@pytest.mark.parametrize('size', [2**62, 2**31, 17])
@pytest.mark.parametrize('compression', list(CompressionType))
def test_a_chunk_that_lies_about_its_size(size, compression, tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), compression=compression)
    data = bytearray(path.read_bytes())
    struct.pack_into('<Q', data, places_of(path)[0].start + 9 + 16, size)
    path.write_bytes(data)
    check_refused(path, tmp_path, r'can not be as long as it says|size or checksum is wrong')


def test_a_record_that_lies_about_its_length(tmp_path, random):
    options = {'compression': CompressionType.NONE, 'enable_crcs': False}
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **options)
    data = bytearray(path.read_bytes())
    first = places_of(path)[0].start
    message = data.index(b'\x05', data.index(IMU_TYPE.encode(), first) + 6000)
    for length in (2**63, 2**40, 5):
        struct.pack_into('<Q', data, message + 1, length)
        path.write_bytes(data)
        check_refused(path, tmp_path, 'is damaged|no messages|can not be read')


def test_an_index_that_lies_is_no_plain_file(tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random))
    whole = path.read_bytes()
    assert read_layout(path) is not None
    for cut in (len(whole) - 1, len(whole) // 2, 20, 8, 0):
        path.write_bytes(whole[:cut])
        assert read_layout(path) is None
    for _ in range(300):
        data = bytearray(whole)
        data[random.integers(len(data) - 600, len(data))] ^= 1 << random.integers(8)
        path.write_bytes(data)
        read_layout(path)  # no exception
    assert read_layout(Path(tmp_path)) is None


MESSAGE_RECORDS = st.builds(
    lambda length, rest: PREFIX.pack(MESSAGE, max(length + len(rest), 0)) + rest,
    st.sampled_from([0] * 20 + [-3, 1, 2**63]),
    st.one_of(st.binary(min_size=22, max_size=80), st.binary(max_size=24)),
)


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(st.lists(MESSAGE_RECORDS, max_size=4), st.binary(max_size=12))
def test_any_bytes_as_a_chunk(records, rest):
    """No record is found outside of the chunk."""
    data = b''.join(records) + rest
    rows = rows_of(np.frombuffer(bytearray(data), np.uint8), EACH_CHANNEL)
    event('no sound chunk' if rows is None else f'{min(len(rows), 2)} messages or more')
    for row in [] if rows is None else rows:
        assert 0 <= row['start'] <= row['start'] + row['size'] <= len(data)


def test_messages_of_a_chunk_are_found_among_other_records():
    body = bytes(22) + b'content'
    message = PREFIX.pack(MESSAGE, len(body)) + body
    data = message + PREFIX.pack(0x7F, 5) + b'other' + message
    rows = rows_of(np.frombuffer(bytearray(data), np.uint8), EACH_CHANNEL)
    found = [data[row['start'] : row['start'] + row['size']] for row in rows]
    assert found == [b'content', b'content']


def test_arrays_are_those_of_the_good_messages(tmp_path, monkeypatch, random):
    """As `identify` has them, by both readers."""
    rows = mixed(random)
    source = write_mcap(tmp_path / 'in.mcap', rows, chunk_size=30_000)
    done = []
    by_chunks = read_imu_arrays(source, progress=lambda *numbers: done.append(numbers))
    assert done[-1] == (len(rows), len(rows))
    monkeypatch.setattr(opening, 'choose_reader', RosbagsReader)
    by_rosbags = read_imu_arrays(source)
    imus = [data for topic, _, _, data in rows if topic == TOPIC]
    sound = [data for data in imus if fault_of(data) is None]
    good = [data for data in sound if doubles_of(data)[16] != -1.0]
    for arrays in (by_chunks, by_rosbags):
        assert (arrays.topic, arrays.frame) == (TOPIC, 'imu_link')
        assert arrays.refused == len(imus) - len(good) > 0
        wanted = np.array([doubles_of(data) for data in good])
        np.testing.assert_array_equal(arrays.angular_velocity, wanted[:, 13:16])
        np.testing.assert_array_equal(arrays.linear_acceleration, wanted[:, 25:28])
        assert (np.diff(arrays.stamps) > 0).all()


def test_a_message_that_is_left_out_is_told(tmp_path):
    """In all commands that read samples alone."""
    times = [START + 10_000_000 * k for k in range(10)]
    rows = [(time, imu_message(time, (0, 0, 0), (0, 0, 9.8))) for time in times]
    rows[4] = times[4], imu_message(times[4], (0, 0, 0), (0, 0, 9.8), covariance=NOT_REPORTED)
    bag = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): rows})
    samples = read_samples(bag, None, WHOLE, lambda done, total: None)
    assert len(samples.stamps) == 9
    assert samples.notes() == ['1 message left out, as damaged or without an angular velocity']
