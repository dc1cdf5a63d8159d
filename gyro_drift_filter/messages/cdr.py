"""The few fields that the filter needs, straight from a serialized `sensor_msgs/msg/Imu`.

ROS 2 sends messages in the plain CDR encoding (OMG DDSI-RTPS, section 10; XCDR version 1): four
bytes that name the encoding, then the fields in order, each aligned to its own size counted from
behind those four bytes. After the header of an Imu come 37 doubles:

    orientation 4, its covariance 9, angular velocity 3, its covariance 9,
    linear acceleration 3, its covariance 9

Their place depends on the length of the frame name alone, so nothing has to be deserialized.
"""

import math
import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.errors import GyroDriftFilterError

IMU_TYPE = 'sensor_msgs/msg/Imu'
VECTOR_TYPE = 'geometry_msgs/msg/Vector3Stamped'

_ENCAPSULATION = 4
_BYTE_ORDERS = {b'\x00\x00': '>', b'\x00\x01': '<'}
_DOUBLE = 8
_IMU_DOUBLES = 37
_ANGULAR_VELOCITY = 13 * _DOUBLE
_ANGULAR_VELOCITY_COVARIANCE = 16 * _DOUBLE
# Writers may pad a message to a multiple of their word.
LARGEST_PADDING = 7

_HEADER = {order: struct.Struct(order + 'iII') for order in '<>'}
# Angular velocity, first element of its covariance, (eight more), acceleration and the first
# element of its covariance.
_FIELDS = {order: struct.Struct(order + '4d64x4d') for order in '<>'}
# Angular velocity and its covariance, which lie side by side.
_RATE_AND_COVARIANCE = {order: struct.Struct(order + '12d') for order in '<>'}


# Of the 37 doubles: name, kind and place.
_VECTOR_FIELDS = (
    ('angular_velocity', '3f8', 13 * _DOUBLE),
    ('angular_velocity_variance', 'f8', 16 * _DOUBLE),
    ('linear_acceleration', '3f8', 25 * _DOUBLE),
    ('linear_acceleration_variance', 'f8', 28 * _DOUBLE),
)
IMUS = np.dtype([('stamp', 'i8'), *((name, kind) for name, kind, _ in _VECTOR_FIELDS)])


# A serialized Imu of zeros, with an empty frame_id.
EXAMPLE = b'\x00\x01\x00\x00' + bytes(12 + 4 + _IMU_DOUBLES * _DOUBLE)

# What a message on the Imu topic is.
GOOD, NOT_REPORTED, MALFORMED = 0, 1, 2


class MalformedMessageError(GyroDriftFilterError):
    """The bytes are no `sensor_msgs/msg/Imu`; the text says why."""


class Imu(NamedTuple):
    """What the filter takes from a message.

    Attributes:
        stamp: header.stamp in ns.
        angular_velocity: (3,) in rad/s.
        angular_velocity_reported: False where the covariance starts with -1 (REP-145): the sensor
            has no gyroscope.
        linear_acceleration: (3,) in m/s^2, NaN where its covariance starts with -1.
        byte_order: '<' or '>'.
        offset: Where the 37 doubles begin.
    """

    stamp: int
    angular_velocity: tuple[float, float, float]
    angular_velocity_reported: bool
    linear_acceleration: tuple[float, float, float]
    byte_order: str
    offset: int


_NOT_REPORTED = (math.nan, math.nan, math.nan)


def read_imu(data: bytes) -> Imu:
    """Return the fields of a serialized Imu.

    Raises:
        MalformedMessageError: The encoding is not plain CDR, or the length is not that of an Imu.
    """
    if len(data) < _ENCAPSULATION + 12:
        raise MalformedMessageError(f'{len(data)} bytes are too few for a message header')
    order = _BYTE_ORDERS.get(bytes(data[:2]))
    if order is None:
        raise MalformedMessageError(f'encoding 0x{bytes(data[:2]).hex()} is not plain CDR')
    seconds, nanoseconds, name_length = _HEADER[order].unpack_from(data, _ENCAPSULATION)
    doubles = -(-(12 + name_length) // _DOUBLE) * _DOUBLE + _ENCAPSULATION
    surplus = len(data) - doubles - _IMU_DOUBLES * _DOUBLE
    if not 0 <= surplus <= LARGEST_PADDING:
        raise MalformedMessageError(
            f'{len(data)} bytes are not the length of an Imu with a frame_id of {name_length} '
            f'bytes ({len(data) - surplus})'
        )
    if name_length and data[_ENCAPSULATION + 12 + name_length - 1] != 0:
        raise MalformedMessageError('frame_id does not end with a zero byte')
    if nanoseconds >= 1_000_000_000:
        raise MalformedMessageError(f'header.stamp.nanosec {nanoseconds} is a second or more')
    x, y, z, covariance, *acceleration, acceleration_covariance = _FIELDS[order].unpack_from(
        data, doubles + _ANGULAR_VELOCITY
    )
    ax, ay, az = acceleration
    return Imu(
        seconds * 1_000_000_000 + nanoseconds,
        (x, y, z),
        covariance != -1.0,
        (ax, ay, az) if acceleration_covariance != -1.0 else _NOT_REPORTED,
        order,
        doubles,
    )


def read_imus(messages: Sequence[bytes]) -> NDArray[np.void] | None:
    """Return the fields of serialized Imus of one frame all at once, or None: take `read_imu` then.

    None is returned wherever the messages differ in length, byte order or frame_id, or one of them
    is malformed.

    Returns:
        (n,) with `stamp` in ns, `angular_velocity` and `linear_acceleration` (3,), and the first
        elements of their covariances, `angular_velocity_variance` and
        `linear_acceleration_variance`.
    """
    try:
        first = read_imu(messages[0])
    except (IndexError, MalformedMessageError):
        return None
    size, n = len(messages[0]), len(messages)
    if any(len(message) != size for message in messages):
        return None
    rows = np.frombuffer(b''.join(messages), np.uint8).reshape(n, size)
    encapsulation, frame = slice(0, _ENCAPSULATION), slice(_ENCAPSULATION + 8, first.offset)
    if (rows[:, encapsulation] != rows[0, encapsulation]).any():
        return None
    if (rows[:, frame] != rows[0, frame]).any():
        return None
    order, offset = first.byte_order, first.offset
    fields = np.dtype(
        {
            'names': ['seconds', 'nanoseconds'] + [name for name, _, _ in _VECTOR_FIELDS],
            'formats': [order + 'i4', order + 'u4']
            + [kind.replace('f', order + 'f') for _, kind, _ in _VECTOR_FIELDS],
            'offsets': [_ENCAPSULATION, _ENCAPSULATION + 4]
            + [offset + place for _, _, place in _VECTOR_FIELDS],
            'itemsize': size,
        }
    )
    raw = rows.reshape(-1).view(fields)
    if (raw['nanoseconds'] >= 1_000_000_000).any():
        return None
    out = np.empty(n, IMUS)
    out['stamp'] = raw['seconds'].astype(np.int64) * 1_000_000_000 + raw['nanoseconds']
    for name, _, _ in _VECTOR_FIELDS:
        out[name] = raw[name]
    return out


def patch_imu(
    data: bytes,
    imu: Imu,
    angular_velocity: tuple[float, float, float],
    variance: tuple[float, float, float],
) -> bytes:
    """Return a copy of `data` with another angular velocity and a diagonal covariance of it.

    Args:
        data: The message that `imu` was read from.
        imu: Its fields.
        angular_velocity: (3,) in rad/s.
        variance: (3,) in (rad/s)^2.
    """
    copy = bytearray(data)
    x, y, z = variance
    _RATE_AND_COVARIANCE[imu.byte_order].pack_into(
        copy, imu.offset + _ANGULAR_VELOCITY, *angular_velocity, x, 0, 0, 0, y, 0, 0, 0, z
    )
    return bytes(copy)


def frame_id(data: bytes, imu: Imu) -> bytes:
    """Return header.frame_id of a serialized message, without its closing zero byte."""
    (length,) = struct.unpack_from(imu.byte_order + 'I', data, _ENCAPSULATION + 8)
    return bytes(data[_ENCAPSULATION + 12 : _ENCAPSULATION + 12 + max(0, length - 1)])


def vector3_stamped(stamp: int, frame: bytes, vector: tuple[float, float, float]) -> bytes:
    """Return a serialized `geometry_msgs/msg/Vector3Stamped`, little endian.

    Args:
        stamp: header.stamp in ns.
        frame: header.frame_id.
        vector: (3,).
    """
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    length = len(frame) + 1
    padding = -(12 + length) % _DOUBLE
    return b'\x00\x01\x00\x00' + struct.pack(
        f'<iII{length}s{padding}x3d', seconds, nanoseconds, length, frame, *vector
    )
