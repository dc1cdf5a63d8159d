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

"""Pieces of recordings without a recording, and their Imu messages."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.recording import Piece
from gyro_drift_filter.core import Filter
from gyro_drift_filter.mcap.message_kernels import CHANNELS, ROW
from gyro_drift_filter.mcap.reader import Layout, read_chunk
from gyro_drift_filter.simulation.bag import imu_messages

EACH_CHANNEL = np.arange(CHANNELS)


def read_messages(path: Path, layout: Layout, numbers: Any) -> Iterator[tuple[Any, Any]]:
    """Yield what `read_chunk` returns, for each chunk of a file."""
    with path.open('rb') as file:
        for chunk in layout.chunks():
            yield read_chunk(file, chunk, numbers)


def piece_of(messages: Sequence[bytes]) -> Piece:
    """Return a piece that consists of these messages, all of one channel."""
    rows = np.zeros(len(messages), ROW)
    sizes = np.array([len(message) for message in messages], np.int64)
    rows['size'], rows['start'] = sizes, np.cumsum(sizes) - sizes
    return Piece(np.frombuffer(bytearray().join(messages), np.uint8), rows)


def imus_of(piece: Piece) -> Any:
    """Return an IMU for each message of a piece, whatever its channel."""
    imus = read_imus(piece, np.ones(CHANNELS, np.bool_))
    assert imus['row'].tolist() == list(range(len(piece.rows)))
    return imus


def filtered_imus(
    filter_: Filter,
    stamps: NDArray[np.int64],
    rates: NDArray[np.float64],
    accelerations: NDArray[np.float64],
) -> Any:
    """Return an IMU for each of n samples, with what a filter makes of it."""
    messages = imu_messages(stamps, rates, accelerations)
    imus = imus_of(piece_of([message for _, message in messages]))
    imus['result'] = filter_.run(stamps, rates, accelerations)
    return imus
