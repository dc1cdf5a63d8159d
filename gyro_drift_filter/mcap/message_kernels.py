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

"""Message records of MCAP files, in arrays of bytes: found, put in order, begun."""

from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only, record
from gyro_drift_filter.accelerate.byte_kernels import put_integer, unsigned

CHANNELS = 2**16  # there may be
_PREFIX = 9  # opcode and length
_MESSAGE = 0x05
_MESSAGE_HEADER = 22  # channel, sequence, log time, publish time
RECORD_BYTES = _PREFIX + _MESSAGE_HEADER  # of a message, beside its payload


class Row(TypedDict):
    """Where a message stands in an array of bytes."""

    log_time: int  # ns; from 2**63 on negative
    channel: int
    start: int  # offset of its payload
    size: int  # of the payload


ROW = record(Row)


@entry_kernel(read_only(np.uint8), np.int64, ROW)
def list_messages(data: NDArray[np.uint8], numbers: NDArray[np.int64], rows: Sequence[Row]) -> int:
    """Write a ROW for each message among records; return how many, or -1 for broken records.

    Args:
        data: (bytes,) of the records.
        numbers: (CHANNELS,) by channel: what stands for it in the rows, or -1 where its messages do
            not count.
        rows: (n,) as many as could be there, one for each `RECORD_BYTES` of data.
    """
    offset, count = 0, 0
    while offset < len(data):
        if offset + _PREFIX > len(data):
            return -1
        size = unsigned(data, offset + 1, 8, False)
        content = offset + _PREFIX
        if size < 0 or size > len(data) - content:
            return -1
        if data[offset] == _MESSAGE:
            if size < _MESSAGE_HEADER:
                return -1
            row = rows[count]
            row['channel'] = numbers[unsigned(data, content, 2, False)]
            row['log_time'] = unsigned(data, content + 6, 8, False)
            row['start'] = content + _MESSAGE_HEADER
            row['size'] = size - _MESSAGE_HEADER
            if row['channel'] >= 0:
                count += 1
        offset = content + size
    return count


def rows_of(data: NDArray[np.uint8], numbers: NDArray[np.int64]) -> Any:
    """Return a ROW for each message among records, or None for broken records.

    `numbers` is as for `list_messages`.
    """
    rows: Any = np.empty(len(data) // RECORD_BYTES, ROW)
    count = list_messages(data, numbers, rows)
    return None if count < 0 else rows[:count]


@entry_kernel(ROW)
def times_of(rows: Sequence[Row]) -> tuple[int, int, bool]:
    """Return the earliest and latest log time of ROWs (n >= 1), and whether they ascend."""
    first = last = before = rows[0]['log_time']
    ascend = True
    for i in range(len(rows)):
        time = rows[i]['log_time']
        first, last = min(first, time), max(last, time)
        ascend = ascend and time >= before
        before = time
    return first, last, ascend


@entry_kernel(ROW, np.int64, (np.uint64, 2), np.uint64)
def group_index(
    rows: Sequence[Row],
    positions: NDArray[np.int64],
    index: NDArray[np.uint64],
    times: NDArray[np.uint64],
) -> None:
    """Write what MESSAGE_INDEX records hold: log times and offsets of messages, by channel.

    Args:
        rows: (n,) messages of a chunk, in the order in which they stand there.
        positions: By channel, where its first message goes in the index; moved on.
        index: (n, 2) log time and offset of the record.
        times: (2,) earliest and latest log time; they are widened.
    """
    for i in range(len(rows)):
        row = rows[i]
        position = positions[row['channel']]
        time = np.int64(row['log_time']).view(np.uint64)
        index[position, 0] = time
        index[position, 1] = row['start'] - RECORD_BYTES
        positions[row['channel']] = position + 1
        times[0] = min(times[0], time)
        times[1] = max(times[1], time)


@kernel
def begin_message(
    out: NDArray[np.uint8], offset: int, channel: int, log_time: int, size: int
) -> int:
    """Write a message record up to its payload of `size` bytes; return the offset behind."""
    offset = put_integer(out, offset, _MESSAGE, 1)
    offset = put_integer(out, offset, _MESSAGE_HEADER + size, 8)
    offset = put_integer(out, offset, channel, 2)
    offset = put_integer(out, offset, 0, 4)
    offset = put_integer(out, offset, log_time, 8)
    return put_integer(out, offset, log_time, 8)
