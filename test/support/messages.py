"""Serialized messages, made on the spot."""

import struct
from typing import Any

from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.messages.cdr import read_imu
from gyro_drift_filter.simulation.bag import imu_message
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate

START = 10**18
STORE: Any = get_typestore(Stores.ROS2_JAZZY)
TEXT = 'std_msgs/msg/String'
TEMPERATURE = 'sensor_msgs/msg/Temperature'


def text(value: str) -> bytes:
    """Return a serialized String."""
    return bytes(STORE.serialize_cdr(STORE.types[TEXT](value), TEXT))


def simulated(n: int = 600) -> list[bytes]:
    """Return n Imu messages of both experiments of the paper, half of them at rest."""
    data = simulate(SimulationSettings(static_seconds=n / 200, dynamic_seconds=n / 200))
    return [
        imu_message(stamp, rate, acceleration)
        for stamp, rate, acceleration in zip(
            data.stamps.tolist(), data.angular_velocity, data.linear_acceleration, strict=True
        )
    ]


def big_endian(data: bytes) -> bytes:
    """Return an Imu message of the simulation in the other byte order."""
    offset = read_imu(data).offset
    head = struct.unpack_from('<iII', data, 4)
    doubles = struct.unpack_from('<37d', data, offset)
    frame = data[16:offset]
    return b'\x00\x00\x00\x00' + struct.pack('>iII', *head) + frame + struct.pack('>37d', *doubles)
