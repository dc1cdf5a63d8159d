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

"""Bags, made on the spot by other projects' writers, and read by their readers."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from mcap.writer import Writer as McapWriter
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

from gyro_drift_filter.bags.message_types import message_type, serialize
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message, imu_messages
from support.messages import (
    NOT_REPORTED,
    START,
    STORE,
    TEMPERATURE,
    TEXT,
    big_endian,
    stamped,
    text,
)

OTHER_QOS = Qos(
    QosHistory.KEEP_ALL,
    7,
    QosReliability.BEST_EFFORT,
    QosDurability.TRANSIENT_LOCAL,
    QosTime(1, 2),
    QosTime(3, 4),
    QosLiveliness.AUTOMATIC,
    QosTime(5, 6),
    avoid_ros_namespace_conventions=False,
)

Row = tuple[str, str, int, bytes]
Messages = list[tuple[int, bytes]]


def simulated(n: int = 300) -> Messages:
    """Return (log time, data) of n Imu messages of both experiments of the paper."""
    return list(stamped(n))


def write(
    path: Path,
    topics: Mapping[tuple[str, str], Iterable[tuple[int, bytes]]],
    plugin: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode | None = None,
    version: Literal[8, 9] = 9,
) -> Path:
    """Write a bag; topics is {(topic, type): [(log time, data), ...]}, in order of log time."""
    writer = Writer(path, version=version, storage_plugin=plugin)
    if mode is not None:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        rows = []
        for (topic, kind), messages in topics.items():
            connection = writer.add_connection(
                topic, kind, typestore=STORE, offered_qos_profiles=[OTHER_QOS]
            )
            rows += [(time, connection, data) for time, data in messages]
        for time, connection, data in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, time, data)
    return path


def write_imus(path: Path, stamps: NDArray[np.int64], rates: Any, accelerations: Any) -> Path:
    """Write a bag of Imu messages, which are logged as they are stamped."""
    return write(path, {(TOPIC, IMU_TYPE): imu_messages(stamps, rates, accelerations)})


def read(path: Path) -> tuple[dict[str, Messages], list[tuple[str, int]]]:
    """Return {topic: [(log time, data), ...]} and the order of all messages."""
    topics: dict[str, Messages] = {}
    order = []
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection in reader.connections:
            topics[connection.topic] = []
        for connection, time, data in reader.messages():
            topics[connection.topic].append((time, bytes(data)))
            order.append((connection.topic, time))
    return topics, order


def write_mcap(path: Path, rows: Sequence[Row], **options: Any) -> Path:
    """Write (topic, type, log time, data) in this order, by the MCAP project's own writer."""
    with path.open('wb') as stream:
        writer = McapWriter(stream, **options)
        writer.start(profile='ros2', library='test')
        channels: dict[tuple[str, str], int] = {}
        for topic, kind, time, data in rows:
            if (topic, kind) not in channels:
                definition, _ = STORE.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, 'ros2msg', definition.encode())
                channels[topic, kind] = writer.register_channel(topic, 'cdr', schema)
            writer.add_message(channels[topic, kind], time, data, time + 7, 3)
        writer.finish()
    return path


def mixed(random: np.random.Generator, seconds: int = 6) -> list[Row]:
    """Return rows with all that a recorder may have met, in order of log time."""
    rows: list[Row] = []
    for k in range(100 * seconds):
        time = START + 10_000_000 * k
        data = imu_message(time, 0.01 * random.standard_normal(3), (0, 0, 9.8))
        kind = k % 97
        if kind == 10:
            data = data[:50]
        elif kind == 20:
            data = imu_message(time, (np.nan, 0.1, np.inf), (0, 0, 9.8))
        elif kind == 30:
            data = imu_message(time, (1, 2, 3), (0, 0, 9.8), covariance=NOT_REPORTED)
        elif kind == 40:
            data = big_endian(data)
        elif kind == 50:
            data = imu_message(time, (0.1, 0.1, 0.1), (0, 0, 9.8), frame='')
        elif kind == 60:
            data = imu_message(time, (5.0, 0.1, 0.1), (0, 0, 9.8), frame='a longer name')
        elif kind == 70:
            data = data + b'\x00\x00\x00'
        rows.append((TOPIC, IMU_TYPE, time, data))
        if k % 7 == 0:
            rows.append(('/words', TEXT, time, text('word' * (k % 50))))
        if k % 33 == 0:
            header = message_type('std_msgs/msg/Header')
            moment = message_type('builtin_interfaces/msg/Time')(*divmod(time, 10**9))
            warm = message_type(TEMPERATURE)(header(moment, ''), 20.0 + k / 20, 0.0)
            rows.append(('/imu/temperature', TEMPERATURE, time, serialize(warm, TEMPERATURE)))
    return rows


def simulated_folder(folder: Path) -> Path:
    """Write the bags that the documentation names: drive, motionless, turns; return the folder."""
    from gyro_drift_filter.simulation.bag import write_simulation
    from gyro_drift_filter.simulation.drive import simulate_drive
    from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
    from gyro_drift_filter.simulation.turns import lay_down, random_faults, sides

    write_simulation(folder / 'drive', simulate_drive(motions=2).recording)
    settings = SimulationSettings(static_seconds=60.0, dynamic_seconds=0.0)
    write_simulation(folder / 'motionless', simulate(settings))
    random = np.random.default_rng(0)
    turns = lay_down(random, sides(random), random_faults(random), rate=50.0)
    write_imus(folder / 'turns', turns.stamps, turns.rates, turns.accelerations)
    return folder


def with_damage(whole: bytes, place: int) -> bytes:
    """Return the content of a file with another byte at a place."""
    return whole[:place] + bytes([whole[place] ^ 0xFF]) + whole[place + 1 :]
