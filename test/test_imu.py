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

"""Fields straight from serialized messages, against rosbags' own serializer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, diagnostic_arrays
from gyro_drift_filter.messages.imu import (
    IMU_TYPE,
    ImuKind,
    fault_text,
    frame_id,
    patch_imu,
    read_message,
)
from gyro_drift_filter.messages.sample_messages import (
    SAMPLE_TOPICS,
    VECTOR_TYPE,
    write_sample_message,
)
from gyro_drift_filter.simulation.bag import imu_message, imu_messages
from support.chunks import imus_of, piece_of
from support.messages import STORE, doubles_of, fault_of

HEADER = STORE.types['std_msgs/msg/Header']
TIME = STORE.types['builtin_interfaces/msg/Time']
VECTOR = STORE.types['geometry_msgs/msg/Vector3']
QUATERNION = STORE.types['geometry_msgs/msg/Quaternion']

numbers = st.floats(allow_nan=False)
vectors = st.tuples(numbers, numbers, numbers)
covariances = st.lists(numbers, min_size=9, max_size=9)
frames = st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=40)
words = st.text(st.characters(exclude_categories=['Cs']), max_size=9)
lines = st.text(st.characters(exclude_categories=['Cs'], exclude_characters='\0'), max_size=9)
stamps = st.tuples(st.integers(-(2**31), 2**31 - 1), st.integers(0, 10**9 - 1))


def message(stamp, frame, rate, rate_covariance, acceleration, acceleration_covariance):
    return STORE.types[IMU_TYPE](
        HEADER(TIME(*stamp), frame),
        QUATERNION(0.1, 0.2, 0.3, 0.4),
        np.arange(9.0),
        VECTOR(*rate),
        np.array(rate_covariance),
        VECTOR(*acceleration),
        np.array(acceleration_covariance),
    )


@settings(max_examples=50, deadline=None)
@given(stamps, frames, vectors, covariances, vectors)
def test_messages_that_are_made_together_are_those_made_alone(
    stamp, frame, rate, covariance, acceleration
):
    stamp = stamp[0] * 10**9 + stamp[1]
    options = {'frame': frame, 'covariance': covariance}
    made = imu_messages(np.array([stamp, 7]), [rate, acceleration], [acceleration, rate], **options)
    assert list(made) == [
        (stamp, imu_message(stamp, rate, acceleration, **options)),
        (7, imu_message(7, acceleration, rate, **options)),
    ]


@pytest.mark.slow
@settings(max_examples=300, deadline=None)
@given(stamps, frames, vectors, covariances, vectors, covariances, st.booleans(), vectors, vectors)
def test_agrees_with_rosbags(
    stamp, frame, rate, covariance, acceleration, acceleration_covariance, little, new, variance
):
    original = message(stamp, frame, rate, covariance, acceleration, acceleration_covariance)
    data = bytes(STORE.serialize_cdr(original, IMU_TYPE, little_endian=little))
    imu = read_message(data)
    assert imu['kind'] == (ImuKind.GOOD if covariance[0] != -1 else ImuKind.NOT_REPORTED)
    sample = imu['sample']
    assert sample['stamp'] == stamp[0] * 10**9 + stamp[1]
    assert sample['angular_velocity'].tolist() == list(rate)
    if acceleration_covariance[0] != -1:
        assert sample['linear_acceleration'].tolist() == list(acceleration)
    else:
        assert np.isnan(sample['linear_acceleration']).all()
    assert frame_id(data, imu) == frame

    expected = message(
        stamp, frame, new, np.diag(variance).ravel(), acceleration, acceleration_covariance
    )
    patched = patched_with(data, imu, new, variance)
    assert patched == bytes(STORE.serialize_cdr(expected, IMU_TYPE, little_endian=little))

    vector = STORE.types[VECTOR_TYPE](HEADER(TIME(*stamp), frame), VECTOR(*new))
    assert sample_message(data, imu, 'bias', new) == bytes(STORE.serialize_cdr(vector, VECTOR_TYPE))


def patched_with(data, imu, rate, variance):
    """Return the message with another rate and variance of it."""
    imu['result']['angular_velocity'] = rate
    imu['result']['angular_velocity_variance'] = variance
    out = np.frombuffer(bytearray(data), np.uint8)
    patch_imu(out, 0, imu)
    return out.tobytes()


def sample_message(data, imu, topic, vector):
    """Return the message on a sample topic for a result that has this vector there."""
    imus, out = np.array([imu]), np.zeros(len(data), np.uint8)
    imus['result'][topic] = vector
    array = np.frombuffer(bytearray(data), np.uint8)
    return out[: write_sample_message(out, array, imus, SAMPLE_TOPICS.index(topic))].tobytes()


@pytest.mark.parametrize('topic', SAMPLE_TOPICS)
def test_each_sample_topic_has_its_field(topic):
    data = imu_message(10**18, (1.0, 2.0, 3.0), (0.0, 0.0, 9.8), 'imu_link')
    written = sample_message(data, read_message(data), topic, (1.0, 2.0, 3.0))
    vector = STORE.deserialize_cdr(written, VECTOR_TYPE).vector
    assert (vector.x, vector.y, vector.z) == (1.0, 2.0, 3.0)


GOOD = imu_message(10**18, (1.0, 2.0, 3.0), (0.0, 0.0, 9.8), 'imu_link')


def with_bytes(offset, replacement):
    return GOOD[:offset] + replacement + GOOD[offset + len(replacement) :]


@pytest.mark.parametrize(
    ('data', 'reason'),
    [
        (b'', '0 bytes are too few for a message header'),
        (GOOD[:15], '15 bytes are too few'),
        (GOOD[:-1], 'are not the length of an Imu with a frame_id of 9 bytes'),
        (GOOD[:100], 'are not the length of an Imu'),
        (GOOD + bytes(8), 'are not the length of an Imu'),
        (with_bytes(0, b'\x00\x03'), 'encoding 0x0003 is not plain CDR'),
        (with_bytes(0, b'\x00\x07'), 'encoding 0x0007 is not plain CDR'),
        (with_bytes(12, b'\xff\xff\xff\xff'), 'are not the length of an Imu'),
        (with_bytes(12, b'\x08\x00\x00\x00'), 'does not end with a zero byte'),
        (with_bytes(8, b'\xff\xff\xff\xff'), 'nanosec 4294967295 is a second or more'),
        (GOOD[:64], 'are not the length of an Imu'),
    ],
)
def test_malformed_messages_are_told_with_a_reason(data, reason):
    imu = read_message(data)
    assert imu['kind'] == ImuKind.MALFORMED
    assert reason in fault_text(imu['fault'])
    assert fault_text(imu['fault']) == fault_of(data)


def test_padding_behind_the_message_is_kept():
    data = GOOD + bytes(4)
    patched = patched_with(data, read_message(data), (4.0, 5.0, 6.0), (0.0, 0.0, 0.0))
    assert len(patched) == len(data)
    assert doubles_of(patched)[13:16] == (4.0, 5.0, 6.0)


@pytest.mark.slow
@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=400), st.integers(0, len(GOOD)), st.integers(0, 255))
def test_any_bytes_are_read_as_struct_reads_them_or_told_why_not(garbage, cut, byte):
    changed = bytearray(GOOD)
    changed[cut % len(GOOD)] = byte
    messages = [garbage, GOOD[:cut] + garbage, b'\x00\x01\x00\x00' + garbage, bytes(changed)]
    piece = piece_of(messages)
    for data, imu in zip(messages, imus_of(piece), strict=True):
        fault = fault_of(data)
        assert (imu['kind'] == ImuKind.MALFORMED) == (fault is not None)
        if fault is not None:
            assert fault_text(imu['fault']) == fault
            continue
        doubles = doubles_of(data)
        assert (imu['kind'] == ImuKind.GOOD) == (doubles[16] != -1.0)
        np.testing.assert_array_equal(imu['sample']['angular_velocity'], doubles[13:16])
        if doubles[28] != -1.0:
            np.testing.assert_array_equal(imu['sample']['linear_acceleration'], doubles[25:28])
        assert len(patched_with(data, imu, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) == len(data)
        frame_id(data, imu)


statuses = st.lists(
    st.tuples(st.integers(0, 3), lines, lines, lines, st.dictionaries(lines, lines, max_size=5)),
    max_size=3,
)


@pytest.mark.slow
@settings(deadline=None)  # the first one may compile
@given(st.lists(st.tuples(st.integers(0, 2**31 * 10**9 - 1), statuses), max_size=3))
def test_diagnostics_are_what_rosbags_writes(reports):
    types = STORE.types
    wanted, found = [], []
    for stamp, of_report in reports:
        message = types['diagnostic_msgs/msg/DiagnosticArray'](
            types['std_msgs/msg/Header'](
                types['builtin_interfaces/msg/Time'](*divmod(stamp, 10**9)), ''
            ),
            [
                types['diagnostic_msgs/msg/DiagnosticStatus'](
                    level,
                    name,
                    text,
                    hardware_id,
                    [types['diagnostic_msgs/msg/KeyValue'](*pair) for pair in values.items()],
                )
                for level, name, text, hardware_id, values in of_report
            ],
        )
        wanted.append(bytes(STORE.serialize_cdr(message, 'diagnostic_msgs/msg/DiagnosticArray')))
        listed = [
            DiagnosticStatus(
                level,
                name,
                text,
                hardware_id,
                ''.join(f'{key}\0{value}\0' for key, value in values.items()),
            )
            for level, name, text, hardware_id, values in of_report
        ]
        assert [status.values for status in listed] == [values for *_, values in of_report]
        found.append((stamp, listed))
    data, ends = diagnostic_arrays(found)
    assert data.tobytes() == b''.join(wanted)
    assert ends.tolist() == np.cumsum([len(message) for message in wanted], dtype=int).tolist()
