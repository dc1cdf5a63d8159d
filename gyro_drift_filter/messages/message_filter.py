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

"""Serialized Imu in, serialized Imu out: what the node and `replay` share.

Both take a message the same way: `read_imu`, `_count_and_filter`, `patch_imu`. The node has one
message at a time, a replay many that stand in one array of bytes.
"""

from collections.abc import Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Annotated, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, entry_kernel, kernel, read_only, record
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.records import FILTER, FilterRecord
from gyro_drift_filter.core.sensor_changes import doubt_sensor
from gyro_drift_filter.core.step import step
from gyro_drift_filter.errors import printable
from gyro_drift_filter.messages.imu import (
    IMU,
    Fault,
    Imu,
    ImuKind,
    fault_text,
    is_published,
    patch_imu,
    rate_variance,
    read_imu,
)
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS, write_sample_message
from gyro_drift_filter.messages.telemetry import (
    TELEMETRY,
    MessageReport,
    as_telemetry,
    read_telemetry,
)

# What is longer is cut off.
LONGEST_FRAME_ID = 256
# Published messages that are known again: more than queues hold. A prime, so that regular stamps do
# not share a place.
REMEMBERED = 1021


class MessageOutcome(IntEnum):
    """What there is to publish for a message, and whether the sensor is at rest."""

    NOTHING = 0
    PASSED_ON = 1  # it as it came
    MOVING = 2  # its rates filtered; the sensor is not at rest, as far as is known
    AT_REST = 3  # its rates filtered; the sensor is at rest


Text = Annotated[NDArray[np.uint8], np.uint8, (LONGEST_FRAME_ID,)]


class Reception(TypedDict):
    """What has come in on the Imu topic."""

    received: int  # messages
    malformed: int  # messages that are no Imu; nothing is published for them
    last_fault: Fault  # of the last of these
    not_reported: int  # messages without angular velocity, which are passed on as they came
    own_outputs: int  # messages that this filter had published, and does not filter again
    lost: int  # messages that never came in, as far as the node knows
    frame_changes: int  # messages with another frame_id than the one before
    has_frame_id: bool  # whether there was a message with a header
    frame_id_size: int  # of the last header, without its closing zero byte
    frame_id: Text


RECEPTION = record(Reception)


class Published(TypedDict):
    """A filtered message, as far as it takes to know it again."""

    stamp: int  # ns
    angular_velocity: PerAxis  # rad/s
    angular_velocity_variance: PerAxis  # (rad/s)^2


PUBLISHED = record(Published)


class Note(TypedDict):
    """What a report needs, noted between two messages."""

    index: int  # of the Imu that it is noted before
    reception: Reception
    telemetry: Annotated[Any, TELEMETRY, ()]


NOTE = record(Note)


@kernel
def _note_frame_id(data: NDArray[np.uint8], imu: Imu, reception: Reception) -> bool:
    """Keep the frame_id of a message; count and return whether it is another one than before."""
    size, text = imu['frame_id_size'], reception['frame_id']
    changed = reception['frame_id_size'] != size
    start = imu['start'] + imu['frame_id']
    for i in range(min(size, LONGEST_FRAME_ID)):
        if text[i] != data[start + i]:
            changed = True
            text[i] = data[start + i]
    changed = changed and reception['has_frame_id']
    if changed:
        reception['frame_changes'] += 1
    reception['frame_id_size'] = size
    reception['has_frame_id'] = True
    return bool(changed)


@kernel
def _is_own_output(data: NDArray[np.uint8], imu: Imu, published: Published) -> bool:
    """Tell whether a message is one that was published: by rates and variances, to the last bit.

    Equal stamps alone are no sign, as a driver may repeat itself, but it does not know the filter's
    variance.
    """
    sample = imu['sample']
    if sample['stamp'] != published['stamp']:
        return False
    for axis in range(3):
        if sample['angular_velocity'][axis] != published['angular_velocity'][axis]:
            return False
        if rate_variance(data, imu, axis) != published['angular_velocity_variance'][axis]:
            return False
    return True


@kernel
def _remember(imu: Imu, published: Published) -> None:
    """Note what is published for a message."""
    result = imu['result']
    published['stamp'] = imu['sample']['stamp']
    for axis in range(3):
        published['angular_velocity'][axis] = result['angular_velocity'][axis]
        published['angular_velocity_variance'][axis] = result['angular_velocity_variance'][axis]


@kernel
def _count_and_filter(
    data: NDArray[np.uint8],
    imu: Imu,
    reception: Reception,
    published: Sequence[Published],
    filter_: FilterRecord,
) -> None:
    """Count a message that has been read from the data; if it is good, filter it."""
    reception['received'] += 1
    if imu['kind'] == ImuKind.MALFORMED:
        reception['malformed'] += 1
        reception['last_fault'] = imu['fault']
        return
    remembered = published[imu['sample']['stamp'] % REMEMBERED]
    if imu['kind'] == ImuKind.GOOD and _is_own_output(data, imu, remembered):
        imu['kind'] = ImuKind.OWN_OUTPUT
        reception['own_outputs'] += 1
        return
    if imu['kind'] == ImuKind.NOT_REPORTED:
        # Its frame is no other gyroscope's: it may be that of an accelerometer beside it.
        reception['not_reported'] += 1
        return
    if _note_frame_id(data, imu, reception):
        doubt_sensor(filter_)
    step(imu['sample'], filter_)
    imu['result'] = filter_['state']['result']
    if is_published(imu):
        _remember(imu, remembered)


@entry_kernel(np.uint8, int, IMU, RECEPTION, PUBLISHED, FILTER)
def filter_message(
    message: NDArray[np.uint8],
    size: int,
    imus: Sequence[Imu],
    reception: Sequence[Reception],
    published: Sequence[Published],
    filter_: NDArray[np.void],
) -> int:
    """Filter the message in the first `size` bytes, in place.

    `imus`, `reception` and `filter_` are (1,), `published` is (REMEMBERED,), and written. Returns
    a member of MessageOutcome.
    """
    imu = imus[0]
    read_imu(message, 0, size, imu)
    _count_and_filter(message, imu, reception[0], published, filter_[0])
    if not is_published(imu):
        return MessageOutcome.NOTHING
    if imu['kind'] != ImuKind.GOOD:
        return MessageOutcome.PASSED_ON
    patch_imu(message, 0, imu)
    return MessageOutcome.AT_REST if imu['result']['at_rest'] > 0.0 else MessageOutcome.MOVING


@entry_kernel(read_only(np.uint8), IMU, NOTE, RECEPTION, PUBLISHED, FILTER)
def filter_imus(
    data: NDArray[np.uint8],
    imus: Sequence[Imu],
    notes: Sequence[Note],
    reception: Sequence[Reception],
    published: Sequence[Published],
    filter_: NDArray[np.void],
) -> None:
    """Filter messages that were read from the data, and write what is to be noted on the way.

    The notes (m,) are in the order of their indexes; `reception` and `filter_` are (1,), and
    `published` is (REMEMBERED,).
    """
    noted = 0
    for i in range(len(imus) + 1):
        while noted < len(notes) and notes[noted]['index'] == i:
            notes[noted]['reception'] = reception[0]
            read_telemetry(filter_[0], notes[noted]['telemetry'])
            noted += 1
        if i < len(imus):
            _count_and_filter(data, imus[i], reception[0], published, filter_[0])


class MessageFilter:
    """Filter one Imu topic, and count what does not pass through the filter.

    Attributes:
        filter: The filter itself.
        reception: A record of RECEPTION: what has come in.
        outcome: A member of MessageOutcome, of the last message of `take`.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.filter = Filter(parameters)
        self._reception: Any = np.zeros(1, RECEPTION)
        self._imus: Any = np.zeros(1, IMU)
        self._published: Any = np.zeros(REMEMBERED, PUBLISHED)
        self._published['angular_velocity_variance'] = np.nan  # as nothing has
        self.reception: Reception = self._reception[0]
        self.outcome = int(MessageOutcome.NOTHING)
        self._make_room(1024)

    def _make_room(self, size: int) -> None:
        self._message, self._sample_message = np.empty((2, size), np.uint8)
        # Faster to fill and to read than the array.
        self._bytes = self._message.data

    def take(self, message: bytes) -> bytes | None:
        """Filter one message; return the message to publish for it, if there is one."""
        size = len(message)
        if size > len(self._bytes):
            self._make_room(2 * size)
        self._bytes[:size] = message
        self.outcome = filter_message(
            self._message, size, self._imus, self._reception, self._published, self.filter.record
        )
        return self._bytes[:size].tobytes() if self.outcome else None

    def sample_message(self, topic: str) -> bytes:
        """Return the message on one of `SAMPLE_TOPICS` for the last one that `take` filtered."""
        index = SAMPLE_TOPICS.index(topic)
        size = write_sample_message(self._sample_message, self._message, self._imus, index)
        return self._sample_message[:size].tobytes()

    def take_imus(self, data: NDArray[np.uint8], imus: Any, notes: Any) -> None:
        """Filter messages that were read from the data, as `take` does one by one.

        Args:
            data: What they stand in, bytes.
            imus: (n,) IMU; their results are written.
            notes: (m,) NOTE in the order of their indexes, from 0 to n; the rest is written.
        """
        filter_imus(data, imus, notes, self._reception, self._published, self.filter.record)

    def report(self) -> MessageReport:
        """Return what it is like now; what is done later does not change it."""
        # With no message, as notes are taken where messages are filtered.
        notes = np.zeros(1, NOTE)
        self.take_imus(self._message[:0], self._imus[:0], notes)
        return self.reports(notes)[0]

    def reports(self, notes: Any) -> list[MessageReport]:
        """Return what it was like when notes (m,) were taken; the parameters are today's."""
        return [
            MessageReport(
                int(reception['received']),
                int(reception['malformed']),
                fault_text(reception['last_fault']) if reception['malformed'] else '',
                int(reception['not_reported']),
                int(reception['own_outputs']),
                int(reception['lost']),
                int(reception['frame_changes']),
                _shown(reception['frame_id'][: reception['frame_id_size']].tobytes()),
                self.filter.parameters,
                telemetry,
            )
            for reception, telemetry in zip(
                notes['reception'], as_telemetry(notes['telemetry']), strict=True
            )
        ]


@lru_cache(maxsize=16)
def _shown(text: bytes) -> str:
    return printable(text.decode('utf-8', 'replace'))
