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

"""A long bag, from a short one laid end to end.

    python -m benchmark.tiled 17280000 FOLDER

writes as many messages as a day at 200 Hz has.
"""

import argparse
from pathlib import Path

import numpy as np

from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import messages
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.mcap.message_kernels import RECORD_BYTES
from gyro_drift_filter.messages.imu import IMU_TYPE, read_message
from gyro_drift_filter.simulation.bag import TOPIC, imu_messages
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate

RECORDING = Path(__file__).parents[2] / 'shared' / 'bags' / 'static_adis16405'
_PIECE = 100_000  # messages
_STAMP = RECORD_BYTES + 4  # offset of header.stamp in a record


def short_one() -> tuple[str, list[tuple[int, bytes]]]:
    """Return name and messages (log time, data) of a real recording, or of a simulated one."""
    if RECORDING.exists():
        with open_bag(RECORDING) as reader:
            rows = [(time, data) for c, time, data in messages(reader) if c.msgtype == IMU_TYPE]
        return RECORDING.name, rows
    data = simulate(SimulationSettings(static_seconds=1000.0, dynamic_seconds=0.0))
    samples = imu_messages(data.stamps, data.angular_velocity, data.linear_acceleration)
    return 'simulated', list(samples)


def write_tiled(rows: list[tuple[int, bytes]], count: int, destination: Path) -> Path:
    """Write `count` messages as a bag: `rows` again and again, with stamps that go on."""
    size = len(rows[0][1])
    assert all(len(data) == size for _, data in rows)
    record = np.dtype(
        {
            'names': ['opcode', 'length', 'channel', 'log', 'publish', 'data', 'sec', 'nanosec'],
            'formats': ['u1', '<u8', '<u2', '<u8', '<u8', f'V{size}', '<i4', '<u4'],
            'offsets': [0, 1, 9, 15, 23, RECORD_BYTES, _STAMP, _STAMP + 4],
            'itemsize': RECORD_BYTES + size,
        }
    )
    times = np.array([time for time, _ in rows])
    stamps = np.array([read_message(data)['sample']['stamp'] for _, data in rows])
    content = np.frombuffer(b''.join(data for _, data in rows), f'V{size}')
    span = int((times[-1] - times[0]) * len(rows) // (len(rows) - 1))
    with BagWriter(destination) as writer:
        channel = writer.add_connection(TOPIC, IMU_TYPE).id
        for first in range(0, count, _PIECE):
            number = np.arange(first, min(first + _PIECE, count))
            tile, row = np.divmod(number, len(rows))
            records = np.zeros(len(number), record)
            records['opcode'], records['length'] = 5, record.itemsize - 9
            records['channel'] = channel
            records['log'] = records['publish'] = times[row] + tile * span
            records['data'] = content[row]
            records['sec'], records['nanosec'] = np.divmod(stamps[row] + tile * span, 10**9)
            ends = record.itemsize * np.arange(1, len(number) + 1)
            writer.write_records(records.view(np.uint8), ends)
    return destination


def main() -> None:
    """Write a long bag."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('count', type=int, help='messages')
    parser.add_argument('destination', type=Path, help='folder to be made')
    options = parser.parse_args()
    name, rows = short_one()
    write_tiled(rows, options.count, options.destination)
    print(f'wrote {options.destination}: {options.count} messages of {name}')


if __name__ == '__main__':
    main()
