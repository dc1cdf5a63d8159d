"""What a replay writes: the topics of the recording, and those of the filter beside them."""

from collections.abc import Sequence
from typing import Annotated, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only, record
from gyro_drift_filter.accelerate.byte_kernels import copy_bytes, put_integer
from gyro_drift_filter.bags.recording import BagError, Piece, Recording, by_connection, is_cdr
from gyro_drift_filter.bags.report_times import REPORT_TIME, ReportTime
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.mcap.message_kernels import RECORD_BYTES, ROW, Row, begin_message
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, diagnostic_arrays
from gyro_drift_filter.messages.imu import IMU, IMU_TYPE, Imu, ImuKind, is_published, patch_imu
from gyro_drift_filter.messages.sample_messages import (
    SAMPLE_TOPICS,
    VECTOR_TYPE,
    put_sample_message,
    size_of_sample_message,
)

DIAGNOSTICS = '/diagnostics'
DIAGNOSTICS_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'
BOOL_TYPE = 'std_msgs/msg/Bool'
AT_REST = 'at_rest'
_BOOL = 5  # bytes of a serialized Bool
_LATEST_STAMP = 2**31 * 10**9 - 1  # ns: a stamp's seconds have 31 bits

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
    read_only(np.uint8), ROW, np.int64, IMU, OUTPUT_STATE, REPORT_TIME, np.uint8, np.uint8
)
def lay_out(
    data: NDArray[np.uint8],
    rows: Sequence[Row],
    copies: NDArray[np.int64],
    imus: Sequence[Imu],
    state: Sequence[OutputState],
    reports: Sequence[ReportTime],
    texts: NDArray[np.uint8],
    out: NDArray[np.uint8],
) -> int:
    """Write the message records of a piece, and of what the filter makes of it.

    Args:
        data: What the messages stand in.
        rows: The messages.
        copies: By their channel, which channel they are copied to; 0 where they are not.
        imus: Those of the Imu topic, filtered.
        state: (1,) of the output; it is moved on.
        reports: Those among the messages.
        texts: The messages of the reports, one behind the other.
        out: Bytes to write to, enough of them.

    Returns:
        How many bytes there are.
    """
    offset = imu = report = text = 0
    for i in range(len(rows) + 1):
        while report < len(reports) and reports[report]['row'] == i:
            size, time = reports[report]['end'] - text, reports[report]['time']
            offset = begin_message(out, offset, state[0]['reports'], time, size)
            offset = copy_bytes(out, offset, texts, text, size)
            text, report = text + size, report + 1
        if i == len(rows):
            break
        row = rows[i]
        if copies[row['channel']] > 0:
            offset = _copy_message(out, offset, copies[row['channel']], data, row)
        if imu < len(imus) and imus[imu]['row'] == i:
            if is_published(imus[imu]):
                offset = _put_filtered(out, offset, data, row, imus[imu], state[0])
            imu += 1
    return offset


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
    data: NDArray[np.uint8],
    row: Row,
    imu: Imu,
    state: OutputState,
) -> int:
    """Write all that the filter makes of a message; return the offset behind it."""
    time = row['log_time']
    offset = _copy_message(out, offset, state['filtered'], data, row)
    state['written'] += 1
    if imu['kind'] != ImuKind.GOOD:
        return offset
    patch_imu(out, offset - row['size'], imu)
    for topic in range(len(SAMPLE_TOPICS)):
        channel = state['samples'][topic]
        if channel > 0:
            offset = begin_message(out, offset, channel, time, size_of_sample_message(imu))
            offset = put_sample_message(out, offset, data, imu, topic)
    at_rest = imu['result']['at_rest']
    if state['at_rest'] > 0 and at_rest != state['last_at_rest']:
        state['last_at_rest'] = at_rest
        offset = begin_message(out, offset, state['at_rest'], time, _BOOL)
        offset = put_integer(out, offset, 0x0100, _BOOL - 1)  # plain CDR, little endian
        offset = put_integer(out, offset, 1 if at_rest > 0.0 else 0, 1)
    return offset


class Output:
    """The bag that a replay writes.

    Attributes:
        is_imu: By the `id` of a connection of the recording, whether it is filtered.
        left_out: Topics that are not copied, and why.
    """

    def __init__(
        self, recording: Recording, writer: BagWriter, topic: str, diagnostics: bool
    ) -> None:
        """Add all topics; `diagnostics` says whether those of every sample are among them.

        Raises:
            BagError: The messages of the Imu topic are in no form that can be read.
        """
        topics = Topics.of(topic)
        own = {topics.filtered}
        if diagnostics:
            own |= {topics.sample(name) for name in (*SAMPLE_TOPICS, AT_REST)}
        self._writer = writer
        self.left_out: dict[str, str] = {}
        self._copies = np.zeros(by_connection(recording), np.int64)
        self.is_imu = np.zeros(len(self._copies), np.bool_)
        report_channel = 0
        for connection in recording.connections:
            if connection.topic in own:
                self.left_out[connection.topic] = 'the filter writes this topic itself'
            elif not is_cdr(connection):
                self.left_out[connection.topic] = 'its messages are not in CDR'
            else:
                copy = writer.copy_connection(connection, recording)
                self._copies[connection.id] = copy.id
                self.is_imu[connection.id] = connection.topic == topic
                if (copy.topic, copy.msgtype) == (DIAGNOSTICS, DIAGNOSTICS_TYPE):
                    report_channel = report_channel or copy.id
        if not self.is_imu.any():
            raise BagError(f'the messages of topic {topic} are not in CDR')
        self._states: Any = np.zeros(1, OUTPUT_STATE)
        self._state: OutputState = self._states[0]
        self._state['last_at_rest'] = -1.0
        self._state['filtered'] = writer.add_connection(topics.filtered, IMU_TYPE).id
        self._state['reports'] = (
            report_channel or writer.add_connection(DIAGNOSTICS, DIAGNOSTICS_TYPE).id
        )
        if diagnostics:
            for k, name in enumerate(SAMPLE_TOPICS):
                connection = writer.add_connection(topics.sample(name), VECTOR_TYPE)
                self._state['samples'][k] = connection.id
            self._state['at_rest'] = writer.add_connection(topics.sample(AT_REST), BOOL_TYPE).id

    @property
    def written(self) -> int:
        """Messages on the filtered topic so far."""
        return int(self._state['written'])

    def write(
        self,
        piece: Piece,
        imus: Any,
        reports: Any,
        statuses: Sequence[Sequence[DiagnosticStatus]],
    ) -> None:
        """Write a piece of the recording, what the filter makes of it, and reports.

        Args:
            piece: The piece.
            imus: (n,) IMU of it, filtered.
            reports: (m,) REPORT_TIME.
            statuses: (m,) what each report says.

        Raises:
            BagError: The disk is full or the like.
        """
        stamps = [min(time % 2**64, _LATEST_STAMP) for time in reports['time'].tolist()]
        texts, reports['end'] = diagnostic_arrays(list(zip(stamps, statuses, strict=True)))
        # For an Imu, beside the copy of it, no message is longer than itself.
        sizes, made = piece.rows['size'], 1 + np.count_nonzero(self._state['samples']) + 1
        count = len(sizes) + made * len(imus) + len(reports)
        size = int(sizes.sum() + made * sizes[imus['row']].sum()) + len(texts)
        out = np.empty(size + count * RECORD_BYTES, np.uint8)
        data, rows = piece
        size = lay_out(data, rows, self._copies, imus, self._states, reports, texts, out)
        if size:
            self._writer.write_records(out[:size])
