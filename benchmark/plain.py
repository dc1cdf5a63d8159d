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

"""What one would write by hand: a loop over messages, and a copy of a file chunk by chunk.

python -m benchmark.plain loop BAG OUT [--diagnostics]
python -m benchmark.plain copy MCAP OUT
"""

import argparse
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from gyro_drift_filter.core import Filter
from gyro_drift_filter.mcap.records import ZSTD_LEVEL, zstd
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS, VECTOR_TYPE

_STORE = get_typestore(Stores.ROS2_JAZZY)


def loop(source: Path, destination: Path, *, diagnostics: bool) -> None:
    """Read, deserialize, step, serialize and write message by message, with rosbags."""
    filter_ = Filter()
    vector, stamped = (
        _STORE.types[f'geometry_msgs/msg/{n}'] for n in ('Vector3', 'Vector3Stamped')
    )
    with AnyReader([source]) as reader:
        writer = Writer(destination, version=9, storage_plugin=StoragePlugin.MCAP)
        writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        with writer:
            copies = {
                c.id: writer.add_connection(c.topic, c.msgtype, typestore=_STORE)
                for c in reader.connections
            }
            output = writer.add_connection('/imu/data_filtered', IMU_TYPE, typestore=_STORE)
            samples = {
                name: writer.add_connection(f'/{name}', VECTOR_TYPE, typestore=_STORE)
                for name in SAMPLE_TOPICS * diagnostics
            }
            for connection, log_time, data in reader.messages():
                writer.write(copies[connection.id], log_time, data)
                if connection.msgtype != IMU_TYPE:
                    continue
                imu: Any = reader.deserialize(data, IMU_TYPE)
                stamp = imu.header.stamp.sec * 10**9 + imu.header.stamp.nanosec
                rate, push = imu.angular_velocity, imu.linear_acceleration
                result: Any = filter_.step(
                    stamp, (rate.x, rate.y, rate.z), (push.x, push.y, push.z)
                )
                rate.x, rate.y, rate.z = result['angular_velocity'].tolist()
                variance = np.diag(result['angular_velocity_variance']).ravel()
                imu = replace(imu, angular_velocity_covariance=variance)
                writer.write(output, log_time, _STORE.serialize_cdr(imu, IMU_TYPE))
                for name, sample in samples.items():
                    message = stamped(imu.header, vector(*result[name].tolist()))
                    writer.write(sample, log_time, _STORE.serialize_cdr(message, VECTOR_TYPE))


def copy(source: Path, destination: Path) -> None:
    """Decompress and compress each chunk of an MCAP file and write it; all else as it is."""
    with source.open('rb') as file, destination.open('wb') as out:
        out.write(file.read(8))
        while len(head := file.read(9)) == 9:
            opcode, length = struct.unpack('<BQ', head)
            content = file.read(length)
            if opcode == 6:
                place = 28 + 8  # behind times, size, checksum and the name of the compression
                assert content[28:place] == b'\x04\x00\x00\x00zstd'
                packed = zstd.compress(zstd.decompress(content[place + 8 :]), ZSTD_LEVEL)
                content = content[:place] + struct.pack('<Q', len(packed)) + packed
            out.write(struct.pack('<BQ', opcode, len(content)) + content)
        out.write(head)


def main() -> None:
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('what', choices=('loop', 'copy'))
    parser.add_argument('source', type=Path)
    parser.add_argument('destination', type=Path)
    parser.add_argument('--diagnostics', action='store_true')
    options = parser.parse_args()
    if options.what == 'copy':
        copy(options.source, options.destination)
    else:
        loop(options.source, options.destination, diagnostics=options.diagnostics)


if __name__ == '__main__':
    main()
