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

"""Integers and doubles in arrays of bytes, for kernels that read and write files and messages."""

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate.kernels import kernel

# Indexes are unsigned in loops over bytes: as they might be negative otherwise, which counts from
# the end, compilers would move bytes one by one instead of in words.


@kernel
def unsigned(data: NDArray[np.uint8], offset: int, size: int, big_endian: bool) -> int:
    """Return an unsigned integer of up to seven bytes; of eight, from 2**63 on, it is negative."""
    value, start = np.int64(0), np.uint64(offset)
    if big_endian:
        for i in range(size):
            value = (value << 8) | np.int64(data[start + np.uint64(i)])
    else:
        for i in range(size):
            value |= np.int64(data[start + np.uint64(i)]) << (8 * i)
    return int(value)


@kernel
def double(data: NDArray[np.uint8], offset: int, big_endian: bool) -> float:
    """Return a number of eight bytes."""
    return np.int64(unsigned(data, offset, 8, big_endian)).view(np.float64)


@kernel
def copy_bytes(
    out: NDArray[np.uint8], offset: int, data: NDArray[np.uint8], start: int, size: int
) -> int:
    """Copy `size` bytes of `data` from `start` on to an offset; return the offset behind them."""
    to, source = np.uint64(offset), np.uint64(start)
    for i in range(size):
        out[to + np.uint64(i)] = data[source + np.uint64(i)]
    return offset + size


@kernel
def put_integer(out: NDArray[np.uint8], offset: int, value: int, size: int) -> int:
    """Write a little-endian integer; return the offset behind it."""
    to = np.uint64(offset)
    for i in range(size):
        out[to + np.uint64(i)] = (value >> (8 * i)) & 0xFF
    return offset + size


@kernel
def put_double(out: NDArray[np.uint8], offset: int, value: float, big_endian: bool) -> int:
    """Write a number of eight bytes; return the offset behind it."""
    bits = np.float64(value).view(np.int64)
    if not big_endian:
        return put_integer(out, offset, int(bits), 8)
    to = np.uint64(offset)
    for i in range(8):
        out[to + np.uint64(i)] = (bits >> (56 - 8 * i)) & 0xFF
    return offset + 8
