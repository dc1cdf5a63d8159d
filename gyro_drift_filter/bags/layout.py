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

"""Lay out the messages of a new bag: the copies, and what the filter makes of each Imu."""

from collections.abc import Sequence
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only, record
from gyro_drift_filter.accelerate.byte_kernels import copy_bytes, put_integer
from gyro_drift_filter.bags.report_times import REPORT_TIME, ReportTime
from gyro_drift_filter.mcap.message_kernels import ROW, Row, begin_message
from gyro_drift_filter.messages.imu import IMU, Imu, ImuKind, is_published, patch_imu
from gyro_drift_filter.messages.sample_messages import (
    SAMPLE_TOPICS,
    put_sample_message,
    size_of_sample_message,
)

BOOL_BYTES = 5  # of a serialized Bool

_PerTopic = Annotated[NDArray[np.int64], np.int64, (len(SAMPLE_TOPICS),)]


class OutputState(TypedDict):
    """The channels of the filter's own topics, 0 where one is not written, and what went there."""

    filtered: int
    reports: int
    samples: _PerTopic
    at_rest: int
    written: int  # messages on the filtered topic
    last_at_rest: float  # what the last message on that topic said, -1 before the first


OUTPUT_STATE = record(OutputState)


@entry_kernel(
    read_only(np.uint8),
    ROW,
    IMU,
    OUTPUT_STATE,
    REPORT_TIME,
    np.uint8,
    np.uint8,
    np.int64,
)
def lay_out(
    data: NDArray[np.uint8],
    rows: Sequence[Row],
    imus: Sequence[Imu],
    states: Sequence[OutputState],
    reports: Sequence[ReportTime],
    texts: NDArray[np.uint8],
    out: NDArray[np.uint8],
    ends: NDArray[np.int64],
) -> int:
    """Write the message records of a piece, and of what the filter makes of it.

    Args:
        data: What the messages stand in.
        rows: The messages; the channel is the one that they are copied to, 0 where they are not.
        imus: Those of Imu topics, filtered, in the order of the messages.
        states: (m,) of the output, one for each Imu topic; they are moved on. Reports go to the
            channel of the first.
        reports: Those among the messages.
        texts: The messages of the reports, one behind the other.
        out: Bytes to write to, enough of them.
        ends: Gets the offset behind each record; long enough for all.

    Returns:
        How many records there are.
    """
    offset = count = imu = report = text = 0
    for i in range(len(rows) + 1):
        while report < len(reports) and reports[report]['row'] == i:
            size, time = reports[report]['end'] - text, reports[report]['time']
            offset = begin_message(out, offset, states[0]['reports'], time, size)
            offset = copy_bytes(out, offset, texts, text, size)
            text, report = text + size, report + 1
            ends[count], count = offset, count + 1
        if i == len(rows):
            break
        row = rows[i]
        if row['channel'] > 0:
            offset = _copy_message(out, offset, row['channel'], data, row)
            ends[count], count = offset, count + 1
        if imu < len(imus) and imus[imu]['row'] == i:
            if is_published(imus[imu]):
                state = states[imus[imu]['topic']]
                count = _put_filtered(out, offset, ends, count, data, row, imus[imu], state)
                offset = ends[count - 1]
            imu += 1
    return count


@kernel
def _copy_message(
    out: NDArray[np.uint8], offset: int, channel: int, data: NDArray[np.uint8], row: Row
) -> int:
    offset = begin_message(out, offset, channel, row['log_time'], row['size'])
    return copy_bytes(out, offset, data, row['start'], row['size'])


@kernel
def _put_filtered(
    out: NDArray[np.uint8],
    offset: int,
    ends: NDArray[np.int64],
    count: int,
    data: NDArray[np.uint8],
    row: Row,
    imu: Imu,
    state: OutputState,
) -> int:
    """Write all that the filter makes of a message; return how many records there are then."""
    time = row['log_time']
    offset = _copy_message(out, offset, state['filtered'], data, row)
    ends[count], count = offset, count + 1
    state['written'] += 1
    if imu['kind'] != ImuKind.GOOD:
        return count
    patch_imu(out, offset - row['size'], imu)
    for topic in range(len(SAMPLE_TOPICS)):
        channel = state['samples'][topic]
        if channel > 0:
            offset = begin_message(out, offset, channel, time, size_of_sample_message(imu))
            offset = put_sample_message(out, offset, data, imu, topic)
            ends[count], count = offset, count + 1
    at_rest = imu['result']['at_rest']
    if state['at_rest'] > 0 and at_rest != state['last_at_rest']:
        state['last_at_rest'] = at_rest
        offset = begin_message(out, offset, state['at_rest'], time, BOOL_BYTES)
        offset = put_integer(out, offset, 0x0100, BOOL_BYTES - 1)  # plain CDR, little endian
        offset = put_integer(out, offset, 1 if at_rest > 0.0 else 0, 1)
        ends[count], count = offset, count + 1
    return count
