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

"""The Imu messages of a piece of a recording, read all at once."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, read_only
from gyro_drift_filter.mcap.message_kernels import ROW, Row
from gyro_drift_filter.messages.imu import IMU, Imu, read_imu

if TYPE_CHECKING:  # `gyro_drift compile` imports this where rosbags is not installed
    from gyro_drift_filter.bags.recording import Piece


@entry_kernel(read_only(np.uint8), ROW, np.bool_, IMU)
def list_imus(
    data: NDArray[np.uint8], rows: Sequence[Row], is_imu: NDArray[np.bool_], imus: Sequence[Imu]
) -> int:
    """Read the messages of those channels that are Imu; return how many there are."""
    count = 0
    for i in range(len(rows)):
        row = rows[i]
        if is_imu[row['channel']]:
            read_imu(data, row['start'], row['size'], imus[count])
            imus[count]['row'] = i
            count += 1
    return count


def read_imus(piece: 'Piece', is_imu: NDArray[np.bool_]) -> Any:
    """Return an IMU for each message of those channels that are Imu, without a result.

    `is_imu` says so by the `id` of a connection, as `channels_of` does.
    """
    imus: Any = np.empty(len(piece.rows), IMU)
    return imus[: list_imus(piece.data, piece.rows, is_imu, imus)]
