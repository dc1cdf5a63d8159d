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

"""What a replay writes: the topics of the recording, and those of the filter beside them."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from gyro_drift_filter.bags.layout import BOOL_BYTES, OUTPUT_STATE, lay_out
from gyro_drift_filter.bags.message_types import types_with
from gyro_drift_filter.bags.recording import Piece, Recording, is_cdr, length_by_id, why_not_cdr
from gyro_drift_filter.bags.topics import DIAGNOSTICS, Topics
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.mcap.message_kernels import RECORD_BYTES
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, diagnostic_arrays
from gyro_drift_filter.messages.imu import IMU_TYPE, ImuKind
from gyro_drift_filter.messages.names import FILTER_STATUS, INPUT_STATUS
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS, SHORTER, VECTOR_TYPE

DIAGNOSTICS_TYPE = 'diagnostic_msgs/msg/DiagnosticArray'
BOOL_TYPE = 'std_msgs/msg/Bool'
AT_REST = 'at_rest'
_LATEST_STAMP = 2**31 * 10**9 - 1  # ns: a stamp's seconds have 31 bits


class NoOutput:
    """What stands in for an output where a run is watched, and nothing written.

    Attributes:
        left_out: No topic, as none is copied.
        written: 0 for each Imu topic.
    """

    def __init__(self, topics: int) -> None:
        """Begin with the number of Imu topics."""
        self.left_out: dict[str, str] = {}
        self.written = [0] * topics

    def write(self, piece: Piece, imus: Any, reports: Any, statuses: Any) -> None:
        """Write nothing."""


class Output:
    """The bag that a replay writes.

    Attributes:
        left_out: Topics that are not copied, and why.
    """

    def __init__(
        self,
        recording: Recording,
        writer: BagWriter,
        inputs: Mapping[str, Topics],
        kept: Collection[str],
        *,
        diagnostics: bool,
    ) -> None:
        """Add all topics.

        Args:
            recording: What is replayed.
            writer: Of the new bag.
            inputs: The names of the outputs by the Imu topic that they belong to.
            kept: The topics that are copied.
            diagnostics: Whether those of every sample are written, too.
        """
        own = {names.filtered for names in inputs.values()}
        if diagnostics:
            own |= {n.sample(x) for n in inputs.values() for x in (*SAMPLE_TOPICS, AT_REST)}
        self._writer = writer
        self.left_out: dict[str, str] = {}
        # The channels that messages are copied to, by their connections; 0 where they are not.
        self._copies = np.zeros(length_by_id(recording), np.int64)
        self._is_report = np.zeros_like(self._copies, np.bool_)
        report_channel = self._copy_topics(recording, kept, own)
        self._states: Any = np.zeros(len(inputs), OUTPUT_STATE)
        self._states['last_at_rest'] = -1.0
        for state, names in zip(self._states, inputs.values(), strict=True):
            state['filtered'] = writer.add_connection(names.filtered, IMU_TYPE).id
            if not report_channel:
                report_channel = writer.add_connection(DIAGNOSTICS, DIAGNOSTICS_TYPE).id
            state['reports'] = report_channel
            if diagnostics:
                self._add_sample_topics(state, names)
        self._own_statuses = {
            n.node + part for n in inputs.values() for part in (INPUT_STATUS, FILTER_STATUS)
        }

    def _copy_topics(
        self, recording: Recording, kept: Collection[str], own: Collection[str]
    ) -> int:
        """Add the topics that are copied, and note those that are left out.

        Returns:
            The channel of the reports in the recording, 0 where none are copied.
        """
        report_channel = 0
        for connection in recording.connections:
            topic = connection.topic
            if topic in own:
                self.left_out[topic] = 'the filter writes this topic itself'
                continue
            if not is_cdr(connection):
                self.left_out[topic] = f'its messages {why_not_cdr(connection)}'
                continue
            if topic not in kept:
                continue
            copy = self._writer.copy_connection(connection)
            self._copies[connection.id] = copy.id
            if (topic, copy.msgtype) == (DIAGNOSTICS, DIAGNOSTICS_TYPE):
                report_channel = report_channel or copy.id
                self._is_report[connection.id] = True
        return report_channel

    def _add_sample_topics(self, state: Any, names: Topics) -> None:
        """Add the topics of every sample of an Imu topic."""
        for k, name in enumerate(SAMPLE_TOPICS):
            state['samples'][k] = self._writer.add_connection(names.sample(name), VECTOR_TYPE).id
        state['at_rest'] = self._writer.add_connection(names.sample(AT_REST), BOOL_TYPE).id

    @property
    def written(self) -> list[int]:
        """Messages on the filtered topics so far, in the order of the Imu topics."""
        return [int(count) for count in self._states['written']]

    def write(
        self,
        piece: Piece,
        imus: Any,
        reports: Any,
        statuses: Iterable[Sequence[DiagnosticStatus]],
    ) -> None:
        """Write a piece of the recording, what the filter makes of it, and reports.

        Args:
            piece: The piece.
            imus: (n,) IMU of it, of all Imu topics, filtered.
            reports: (m,) REPORT_TIME.
            statuses: (m,) what each report says.

        Raises:
            BagError: The disk is full or the like.
        """
        stamps = [min(time % 2**64, _LATEST_STAMP) for time in reports['time'].tolist()]
        texts, reports['end'] = diagnostic_arrays(list(zip(stamps, statuses, strict=True)))
        sizes, topics = piece.rows['size'], np.count_nonzero(self._states[0]['samples'])
        good = imus['row'][imus['kind'] == ImuKind.GOOD]
        count = len(sizes) + len(imus) + (topics + 1) * len(good) + len(reports)
        # Each message may be copied; of an Imu there is the filtered one, and of a good one those
        # on the sample topics, too, and what is said of rest.
        size = sizes.sum() + sizes[imus['row']].sum() + len(texts)
        size += topics * (sizes[good] - SHORTER).sum() + BOOL_BYTES * len(good)
        out, ends = np.empty(int(size) + count * RECORD_BYTES, np.uint8), np.empty(count, np.int64)
        rows = self._rows_to_copy(piece)
        written = lay_out(piece.data, rows, imus, self._states, reports, texts, out, ends)
        self._writer.write_records(out, ends[:written])

    def _rows_to_copy(self, piece: Piece) -> Any:
        """Return the rows of a piece with the channels that they are copied to.

        What an earlier run, or the node itself, has reported is passed over.
        """
        rows, channels = piece.rows.copy(), piece.rows['channel']
        rows['channel'] = self._copies[channels]
        for row in np.flatnonzero(self._is_report[channels]).tolist():
            if self._is_own_report(piece.message(row)):
                rows['channel'][row] = 0
                self.left_out[DIAGNOSTICS] = 'what an earlier run of this filter has reported'
        return rows

    def _is_own_report(self, data: bytes) -> bool:
        if not any(name.encode() in data for name in self._own_statuses):
            return False
        with suppress(Exception):  # whatever the bytes of others bring about
            message: Any = types_with(DIAGNOSTICS_TYPE).deserialize_cdr(data, DIAGNOSTICS_TYPE)
            return all(status.name in self._own_statuses for status in message.status)
        return False
