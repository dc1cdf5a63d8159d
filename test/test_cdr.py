"""Fields straight from serialized messages, against rosbags' own serializer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.messages.cdr import (
    IMU_TYPE,
    VECTOR_TYPE,
    MalformedMessageError,
    frame_id,
    patch_imu,
    read_imu,
    read_imus,
    vector3_stamped,
)
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, diagnostic_arrays
from gyro_drift_filter.simulation.bag import imu_message

STORE = get_typestore(Stores.ROS2_JAZZY)
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


@settings(max_examples=300, deadline=None)
@given(stamps, frames, vectors, covariances, vectors, covariances, st.booleans(), vectors, vectors)
def test_agrees_with_rosbags(
    stamp, frame, rate, covariance, acceleration, acceleration_covariance, little, new, variance
):
    original = message(stamp, frame, rate, covariance, acceleration, acceleration_covariance)
    data = bytes(STORE.serialize_cdr(original, IMU_TYPE, little_endian=little))
    imu = read_imu(data)
    assert imu.stamp == stamp[0] * 10**9 + stamp[1]
    assert imu.angular_velocity == rate
    assert imu.angular_velocity_reported == (covariance[0] != -1)
    if acceleration_covariance[0] != -1:
        assert imu.linear_acceleration == acceleration
    else:
        assert np.isnan(imu.linear_acceleration).all()
    assert frame_id(data, imu) == frame.encode()

    patched = patch_imu(data, imu, new, variance)
    expected = message(
        stamp, frame, new, np.diag(variance).ravel(), acceleration, acceleration_covariance
    )
    assert patched == bytes(STORE.serialize_cdr(expected, IMU_TYPE, little_endian=little))

    vector = STORE.types[VECTOR_TYPE](HEADER(TIME(*stamp), frame), VECTOR(*new))
    assert vector3_stamped(imu.stamp, frame.encode(), new) == bytes(
        STORE.serialize_cdr(vector, VECTOR_TYPE)
    )


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
        (vector3_stamped(0, b'imu_link', (1.0, 2.0, 3.0)), 'are not the length of an Imu'),
    ],
)
def test_malformed_messages_are_refused_with_a_reason(data, reason):
    with pytest.raises(MalformedMessageError, match=reason):
        read_imu(data)


def test_padding_behind_the_message_is_kept():
    data = GOOD + bytes(4)
    patched = patch_imu(data, read_imu(data), (4.0, 5.0, 6.0), (0.0, 0.0, 0.0))
    assert len(patched) == len(data)
    assert read_imu(patched).angular_velocity == (4.0, 5.0, 6.0)


@settings(max_examples=500, deadline=None)
@given(st.binary(max_size=400), st.integers(0, len(GOOD)))
def test_garbage_is_read_or_refused_but_never_crashes(garbage, cut):
    for data in (garbage, GOOD[:cut] + garbage, b'\x00\x01\x00\x00' + garbage):
        try:
            imu = read_imu(data)
        except MalformedMessageError:
            continue
        assert len(patch_imu(data, imu, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))) == len(data)
        frame_id(data, imu)


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.tuples(stamps, vectors, covariances, vectors, covariances), max_size=5),
    frames,
    st.booleans(),
)
def test_many_at_once_are_what_they_are_one_by_one(parts, frame, little):
    data = [
        bytes(
            STORE.serialize_cdr(
                message(stamp, frame, rate, covariance, acceleration, its_covariance),
                IMU_TYPE,
                little_endian=little,
            )
        )
        for stamp, rate, covariance, acceleration, its_covariance in parts
    ]
    found = read_imus(data)
    if not data:
        assert found is None
        return
    for imu, row in zip(map(read_imu, data), found, strict=True):
        assert row['stamp'] == imu.stamp
        assert tuple(row['angular_velocity']) == imu.angular_velocity
        assert (row['angular_velocity_variance'] != -1) == imu.angular_velocity_reported
        if row['linear_acceleration_variance'] != -1:
            assert tuple(row['linear_acceleration']) == imu.linear_acceleration


@pytest.mark.parametrize('place', [0, 1, 9, 15, 17, 20])
def test_many_that_differ_in_form_are_left_to_be_read_one_by_one(place):
    data = imu_message(10**18, (1, 2, 3), (0, 0, 9.8))
    other = bytearray(data)
    other[place] ^= 0xFF
    assert read_imus([data, data]) is not None
    same_form = place == 9  # the middle of the nanoseconds, which then are too many or fine
    result = read_imus([data, bytes(other)])
    assert (result is None) or same_form
    assert read_imus([data, data + bytes(4)]) is None
    assert read_imus([data[:40]]) is None


statuses = st.lists(
    st.tuples(st.integers(0, 3), lines, lines, st.dictionaries(lines, lines, max_size=5)),
    max_size=3,
)


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
                    '',
                    [types['diagnostic_msgs/msg/KeyValue'](*pair) for pair in values.items()],
                )
                for level, name, text, values in of_report
            ],
        )
        wanted.append(bytes(STORE.serialize_cdr(message, 'diagnostic_msgs/msg/DiagnosticArray')))
        listed = [
            DiagnosticStatus(*status, ''.join(f'{key}\0{value}\0' for key, value in values.items()))
            for *status, values in of_report
        ]
        assert [status.values for status in listed] == [values for *_, values in of_report]
        found.append((stamp, listed))
    data, ends = diagnostic_arrays(found)
    assert data.tobytes() == b''.join(wanted)
    assert ends.tolist() == np.cumsum([len(message) for message in wanted], dtype=int).tolist()
