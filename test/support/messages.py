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

"""Serialized messages, made on the spot."""

import struct
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import imu_message, imu_messages
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate

START = 10**18
STORE: Any = get_typestore(Stores.ROS2_JAZZY)
TEXT = 'std_msgs/msg/String'
# A covariance by which a driver says that it does not report a quantity (REP-145).
NOT_REPORTED = [-1.0] + 8 * [0.0]
# A name that would run in a page, were it taken for HTML.
EVIL = '</script><script>alert(1)</script><img src=x onerror=alert(2)>'
TEMPERATURE = 'sensor_msgs/msg/Temperature'


class ImuFields(NamedTuple):
    """Fields of an Imu, as rosbags reads them; stamp in ns."""

    stamp: int
    angular_velocity: tuple[float, float, float]
    linear_acceleration: tuple[float, float, float]


def imu_fields(data: bytes) -> ImuFields:
    """Return fields of a serialized Imu."""
    imu = STORE.deserialize_cdr(data, IMU_TYPE)
    rate, force, stamp = imu.angular_velocity, imu.linear_acceleration, imu.header.stamp
    return ImuFields(
        stamp.sec * 10**9 + stamp.nanosec, (rate.x, rate.y, rate.z), (force.x, force.y, force.z)
    )


def fault_of(data: bytes) -> str | None:
    """Return why a message is no Imu, or None where it is one: in plain words, by struct alone."""
    if len(data) < 16:
        return f'{len(data)} bytes are too few for a message header'
    if data[:2] not in (b'\x00\x00', b'\x00\x01'):
        return f'encoding 0x{data[:2].hex()} is not plain CDR'
    _, nanoseconds, length = struct.unpack_from('<iII' if data[1] else '>iII', data, 4)
    expected = 4 + -(-(12 + length) // 8) * 8 + 37 * 8
    if not 0 <= len(data) - expected <= 7:
        return (
            f'{len(data)} bytes are not the length of an Imu with a frame_id of {length} bytes '
            f'({expected})'
        )
    if length and data[15 + length] != 0:
        return 'frame_id does not end with a zero byte'
    if nanoseconds >= 1_000_000_000:
        return f'header.stamp.nanosec {nanoseconds} is a second or more'
    return None


def doubles_of(data: bytes) -> tuple[float, ...]:
    """Return the 37 doubles of an Imu."""
    order = '<' if data[1] else '>'
    (length,) = struct.unpack_from(order + 'I', data, 12)
    doubles: tuple[float, ...] = struct.unpack_from(
        order + '37d', data, 4 + -(-(12 + length) // 8) * 8
    )
    return doubles


def offset_of_doubles(data: bytes) -> int:
    """Return where the 37 doubles of a little-endian Imu start."""
    length: int = struct.unpack_from('<I', data, 12)[0]
    return 4 + -(-(12 + length) // 8) * 8


def without_rates(stamp: int) -> bytes:
    """Return an Imu that reports no angular velocity."""
    return imu_message(stamp, (0, 0, 0), (0, 0, 9.8), covariance=NOT_REPORTED)


def text(value: str) -> bytes:
    """Return a serialized String."""
    return bytes(STORE.serialize_cdr(STORE.types[TEXT](value), TEXT))


def even_stamps(n: int, rate: float = 100.0, start: int = START) -> NDArray[np.int64]:
    """Return n stamps in ns at a rate in Hz."""
    return start + np.round(np.arange(n) * 1e9 / rate).astype(np.int64)


@lru_cache(maxsize=8)
def stamped(n: int) -> tuple[tuple[int, bytes], ...]:
    """Return stamps in ns and Imu messages of both experiments of the paper, half at rest."""
    data = simulate(SimulationSettings(static_seconds=n / 200, dynamic_seconds=n / 200))
    return tuple(imu_messages(data.stamps, data.angular_velocity, data.linear_acceleration))


def simulated(n: int = 600) -> list[bytes]:
    """Return n Imu messages of both experiments of the paper, half of them at rest."""
    return [message for _, message in stamped(n)]


def serialized(
    rates: NDArray[np.float64], accelerations: Any, start: float = 0.0, rate: int = 100
) -> list[bytes]:
    """Return Imu messages at a rate in Hz, the first of them `start` s after START."""
    stamps = START + int(start * 1e9) + np.arange(len(rates)) * 10**9 // rate
    return [message for _, message in imu_messages(stamps, rates, accelerations)]


def quiet(
    n: int, deviation: float, random: np.random.Generator, rate: float = 100.0
) -> list[bytes]:
    """Return messages of a sensor at rest."""
    noise = random.standard_normal((n, 2, 3))
    stamps = 10**18 + (np.arange(n) * 1e9 / rate).astype(np.int64)
    samples = imu_messages(stamps, deviation * noise[:, 0], [0, 0, 9.8] + 0.02 * noise[:, 1])
    return [message for _, message in samples]


def big_endian(data: bytes) -> bytes:
    """Return an Imu message of the simulation in the other byte order."""
    offset = offset_of_doubles(data)
    head = struct.unpack_from('<iII', data, 4)
    doubles = struct.unpack_from('<37d', data, offset)
    frame = data[16:offset]
    return b'\x00\x00\x00\x00' + struct.pack('>iII', *head) + frame + struct.pack('>37d', *doubles)
