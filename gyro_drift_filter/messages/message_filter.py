"""Serialized Imu in, serialized Imu out: what the node and `replay` share."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.sample import SampleStatus
from gyro_drift_filter.errors import printable
from gyro_drift_filter.messages.cdr import (
    Imu,
    MalformedMessageError,
    frame_id,
    patch_imu,
    read_imu,
    vector3_stamped,
)
from gyro_drift_filter.messages.imu_kernels import (
    FILTERED,
    IMU,
    LONGEST_FRAME,
    NEW_FRAME,
    PASSED_ON,
    PUBLISH,
    TALLY,
    Tally,
    filter_imus,
    filter_message,
    no_frame,
    room_for_doubles,
)
from gyro_drift_filter.messages.telemetry import (
    TELEMETRY,
    MessageReport,
    Telemetry,
    as_telemetry,
    read_telemetry,
)

# Topics with one Vector3Stamped per sample, below the node's name; each is a field of RESULT.
SAMPLE_TOPICS = (
    'innovation',
    'innovation_variance',
    'process_noise',
    'measurement_noise',
    'bias',
    'outlier',
)


class Outcome(NamedTuple):
    """What became of one message.

    Attributes:
        data: The serialized message to publish, or None where there is none.
        imu: The fields read, or None where the message is malformed.
        result: A record of RESULT, or None where the message did not go through the filter. From
            `process` it is valid until the next call.
    """

    data: bytes | None
    imu: Imu | None
    result: Any


class MessageFilter:
    """Filter one Imu topic, and count what does not pass through the filter.

    Attributes:
        filter: The filter itself.
        received: Messages taken in.
        malformed: Messages that are no Imu; nothing is published for them.
        last_malformed: Why the last of them was refused.
        not_reported: Messages without angular velocity (covariance starts with -1); passed on.
        frame_changes: Messages with another frame_id than the one before.
        frame: The frame_id after the last change.
        output: What `step` has to publish.
    """

    def __init__(self, parameters: Parameters) -> None:
        self.filter = Filter(parameters)
        self.received = 0
        self.malformed = 0
        self.last_malformed = ''
        self.not_reported = 0
        self.frame_changes = 0
        self.frame = ''
        self.output = b''
        self._frame_before: tuple[int, bytes] | None = None  # of `process_batch`
        self._last_frame = no_frame()
        self._room = room_for_doubles()
        self._imu = np.zeros(1, IMU)
        self._out = np.empty(1024, np.uint8)

    def report(self) -> MessageReport:
        """Return what it is like now; what is done later does not change it."""
        record = np.zeros(1, TELEMETRY)
        read_telemetry(self.filter.state, record[0])
        return self._report(as_telemetry(record)[0])

    def _report(self, state: Telemetry) -> MessageReport:
        return MessageReport(
            self.received,
            self.malformed,
            self.last_malformed,
            self.not_reported,
            self.frame_changes,
            self.frame,
            self.filter.parameters,
            state,
        )

    def step(self, data: bytes) -> int:
        """Filter one message at once: the live path.

        Returns:
            Flags of `imu_kernels`: 0 where the message is malformed. With PUBLISH, `output` is what
            to publish; with FILTERED, `filter.state['result']` is what the filter made of it.
        """
        self.received += 1
        if len(data) > len(self._out):
            self._out = np.empty(2 * len(data), np.uint8)
        message = np.frombuffer(data, np.uint8)
        flags: int = filter_message(
            message,
            self._out,
            self._room,
            self._last_frame,
            self._imu,
            self.filter.record,
        )
        if flags & PUBLISH:
            self.output = self._out[: len(data)].tobytes()
        if flags & NEW_FRAME:
            self.frame_changes += 1
            self._explain_frame(data)
        if flags & PASSED_ON:
            self.not_reported += 1
        elif flags == 0:
            self.malformed += 1
            self._explain_malformed(data)
        return flags

    def process(self, data: bytes) -> Outcome:
        """Filter one message by `step`, and tell all about it."""
        flags = self.step(data)
        if flags == 0:
            return Outcome(None, None, None)
        return Outcome(
            self.output if flags & PUBLISH else None,
            read_imu(data),
            self.filter.state['result'] if flags & FILTERED else None,
        )

    def process_batch(self, messages: Sequence[bytes]) -> list[Outcome]:
        """Filter messages in their order: the offline path, with the same outcome."""
        imus = [self._read(data) for data in messages]
        rows = [imu for imu in imus if imu is not None and imu.angular_velocity_reported]
        results = iter(
            self.filter.run(
                np.array([imu.stamp for imu in rows], np.int64),
                np.array([imu.angular_velocity for imu in rows], np.float64).reshape(-1, 3),
                np.array([imu.linear_acceleration for imu in rows], np.float64).reshape(-1, 3),
            )
        )
        return [
            _unfiltered(data, imu)
            if imu is None or not imu.angular_velocity_reported
            else _filtered(data, imu, next(results))
            for data, imu in zip(messages, imus, strict=True)
        ]

    def process_imus(
        self,
        imus: NDArray[Any],
        part: range,
        payload: Callable[[int], bytes],
        results: NDArray[Any],
        marks: Sequence[int] = (),
    ) -> list[MessageReport]:
        """Filter messages that have been read already: `process_batch` for the fast path.

        Args:
            imus: (n,) IMU of `imu_kernels`.
            part: Which of them.
            payload: Returns one of them as it came, by its place in `imus`.
            results: (n,) RESULT; written for those that go through the filter.
            marks: Places in `imus` within the part or at its end, in their order.

        Returns:
            What the message filter was like before each of the marks.
        """
        ends = np.array(marks, np.int64)
        states, tallies = np.empty(len(ends), TELEMETRY), np.zeros(len(ends), TALLY)
        tally = np.zeros(1, TALLY)
        arrays = self.filter.record, results, tally, ends, states, tallies
        filter_imus(part.start, part.stop, imus, *arrays)
        reports: list[MessageReport] = []
        tallies_by_end = map(Tally._make, [*tallies.tolist(), *tally.tolist()])
        place, counted = part.start, Tally(0, 0, 0, 0, 0)
        for end, tally_then, state in zip(
            [*marks, part.stop], tallies_by_end, [*as_telemetry(states), None], strict=True
        ):
            self._count(end - place, tally_then, counted, payload)
            place, counted = end, tally_then
            if state is not None:
                reports.append(self._report(state))
        return reports

    def _count(
        self, received: int, tally: Tally, before: Tally, payload: Callable[[int], bytes]
    ) -> None:
        """Count messages that have gone through, and what was told of them since `before`."""
        self.received += received
        if tally == before:
            return
        self.malformed += tally.malformed - before.malformed
        self.not_reported += tally.not_reported - before.not_reported
        self.frame_changes += tally.frame_changes - before.frame_changes
        if tally.malformed > before.malformed:
            self._explain_malformed(payload(tally.last_malformed))
        if tally.frame_changes > before.frame_changes:
            self._explain_frame(payload(tally.last_frame))

    def _explain_malformed(self, data: bytes) -> None:
        """Note why a message was refused that has been counted already."""
        try:
            read_imu(data)
        except MalformedMessageError as error:
            self.last_malformed = str(error)

    def _explain_frame(self, data: bytes) -> None:
        """Note the frame_id of a message that has been counted already."""
        self._note_frame(frame_id(data, read_imu(data)))

    def _note_frame(self, frame: bytes) -> None:
        self.frame = printable(frame.decode('utf-8', 'replace'))

    def _read(self, data: bytes) -> Imu | None:
        self.received += 1
        try:
            imu = read_imu(data)
        except MalformedMessageError as error:
            self.malformed += 1
            self.last_malformed = str(error)
            return None
        frame = frame_id(data, imu)
        compared = len(frame), frame[:LONGEST_FRAME]
        if self._frame_before not in (None, compared):
            self.frame_changes += 1
            self._note_frame(frame)
        self._frame_before = compared
        if not imu.angular_velocity_reported:
            self.not_reported += 1
        return imu


def _unfiltered(data: bytes, imu: Imu | None) -> Outcome:
    return Outcome(None if imu is None else data, imu, None)


def _filtered(data: bytes, imu: Imu, result: Any) -> Outcome:
    if result['status'] == SampleStatus.REFUSED:
        return Outcome(None, imu, result)
    patched = patch_imu(
        data,
        imu,
        result['angular_velocity'].tolist(),
        result['angular_velocity_variance'].tolist(),
    )
    return Outcome(patched, imu, result)


def sample_message(data: bytes, imu: Imu, result: Any, topic: str) -> bytes:
    """Return the serialized Vector3Stamped of one of `SAMPLE_TOPICS` for a filtered message."""
    return vector3_stamped(imu.stamp, frame_id(data, imu), result[topic].tolist())
