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

"""Topics with one `geometry_msgs/msg/Vector3Stamped` for each sample, of what the filter makes."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel
from gyro_drift_filter.accelerate.byte_kernels import copy_bytes, put_double, put_integer
from gyro_drift_filter.messages.imu import DOUBLES, ENCAPSULATION, HEADER, IMU, Imu

VECTOR_TYPE = 'geometry_msgs/msg/Vector3Stamped'

# Names below that of the node, each of a field of RESULT, in the order of `put_sample_message`.
SAMPLE_TOPICS = (
    'innovation',
    'innovation_variance',
    'process_noise',
    'measurement_noise',
    'bias',
    'outlier',
)

_VECTOR = 24  # bytes
# By at least so many bytes a message on one of these topics is shorter than its Imu.
SHORTER = 8 * DOUBLES - _VECTOR


@kernel
def size_of_sample_message(imu: Imu) -> int:
    """Return how many bytes each message on a sample topic has: the frame_id is in it."""
    return ENCAPSULATION + (HEADER + imu['frame_id_size'] + 8) // 8 * 8 + _VECTOR


@kernel
def put_sample_message(
    out: NDArray[np.uint8], offset: int, data: NDArray[np.uint8], imu: Imu, topic: int
) -> int:
    """Write the message for one of `SAMPLE_TOPICS`, little endian; return the offset behind it.

    Args:
        out: Bytes to write to.
        offset: Where it starts there.
        data: What the Imu was read from.
        imu: A good one, with its result.
        topic: Index in `SAMPLE_TOPICS`.
    """
    result, stamp, size = imu['result'], imu['sample']['stamp'], imu['frame_id_size']
    end = offset + size_of_sample_message(imu)
    offset = put_integer(out, offset, 0x0100, ENCAPSULATION)
    offset = put_integer(out, offset, stamp // 1_000_000_000, 4)
    offset = put_integer(out, offset, stamp % 1_000_000_000, 4)
    offset = put_integer(out, offset, size + 1, 4)
    offset = copy_bytes(out, offset, data, imu['start'] + imu['frame_id'], size)
    offset = put_integer(out, offset, 0, end - _VECTOR - offset)
    vectors = (
        result['innovation'],
        result['innovation_variance'],
        result['process_noise'],
        result['measurement_noise'],
        result['bias'],
        result['outlier'],
    )
    for axis in range(3):
        offset = put_double(out, offset, vectors[topic][axis], False)
    return offset


@entry_kernel(np.uint8, np.uint8, IMU, int)
def write_sample_message(
    out: NDArray[np.uint8], message: NDArray[np.uint8], imus: Sequence[Imu], topic: int
) -> int:
    """Write the message for one of `SAMPLE_TOPICS` to the start of `out`; return its size.

    `imus` is (1,) IMU, read from the message.
    """
    return put_sample_message(out, 0, message, imus[0], topic)
