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

"""The recording that the doctor examines: through the filter once, and kept in files."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.bags.imu_arrays import usable
from gyro_drift_filter.bags.imus import read_imus
from gyro_drift_filter.bags.message_types import read_message
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.orientations import PLACES, orientation_of
from gyro_drift_filter.bags.recording import BagError, Piece, Recording, are_among, is_cdr
from gyro_drift_filter.bags.replay_run import NO_MESSAGES, TopicFilter, small_parts
from gyro_drift_filter.bags.report_times import ReportTimes
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION
from gyro_drift_filter.doctor.covariances import Stated
from gyro_drift_filter.doctor.examination import Examined
from gyro_drift_filter.doctor.live_rules import RuleLog, is_truncation_refuted
from gyro_drift_filter.doctor.reference import Reference
from gyro_drift_filter.identify.series import Stored, append_rows, stored_columns
from gyro_drift_filter.messages.health import Health
from gyro_drift_filter.messages.imu import (
    ACCELERATION_COVARIANCE,
    IMU_TYPE,
    ORIENTATION_COVARIANCE,
    RATE_COVARIANCE,
    ImuKind,
    all_doubles,
)

# In the order of QUANTITIES.
_COVARIANCES = (ORIENTATION_COVARIANCE, RATE_COVARIANCE, ACCELERATION_COVARIANCE)


class _Orientations:
    """Orientations of one topic, kept as they come."""

    def __init__(self, name: str, *, own: bool) -> None:
        self.name, self.own = name, own
        self._stamps = Stored(np.int64)
        self._columns = stored_columns(4)

    def add(self, stamps: Integers, quaternions: Floats) -> None:
        """Add stamps (n,) in ns and quaternions (n, 4) in the order x, y, z, w."""
        self._stamps.append(stamps)
        append_rows(self._columns, quaternions)

    def reference(self) -> Reference | None:
        """Return what was added, None where nothing was."""
        if not len(self._stamps):
            return None
        return Reference(self.name, self._stamps, self._columns, self.own)


class Reading:
    """One pass through a recording for one Imu topic: all that there is to be examined."""

    def __init__(self, recording: Recording, topic: str, names: Topics) -> None:
        self._rules = RuleLog()
        # It undoes nothing that is to be found.
        parameters = Parameters(input_quantisation='none')
        self._filter = TopicFilter(recording, parameters, topic, names, lambda _: self._rules)
        # What `Examined` says of them.
        self._stamps, self._log_times = Stored(np.int64), Stored(np.int64)
        self._rates, self._accelerations = stored_columns(3), stored_columns(3)
        self._outliers = stored_columns(3, np.uint8)
        self._resting = Stored(np.uint8)
        self._stated = (Stated(), Stated(), Stated())
        self._report_times = ReportTimes()
        self._own = _Orientations(topic, own=True)
        self._others = {
            connection.id: (connection, _Orientations(connection.topic, own=False))
            for connection in recording.connections
            if connection.msgtype in PLACES.keys() - {IMU_TYPE} and is_cdr(connection)
        }
        self._is_other = are_among(recording, self._others)

    def take(self, piece: Piece) -> None:
        """Take a piece of the recording in."""
        for part in small_parts(piece):
            # Without what other topics hold, so that reports are about the time of the Imu alone.
            imus_alone = Piece(part.data, part.rows[self._filter.is_imu[part.rows['channel']]])
            self._take_imus(imus_alone, self._report_times.among(imus_alone.rows))
            for index in np.flatnonzero(self._is_other[part.rows['channel']]):
                self._note_orientation(int(part.rows['channel'][index]), part.message(int(index)))

    def _take_imus(self, piece: Piece, reports: Any) -> None:
        imus = read_imus(piece, self._filter.is_imu)
        self._filter.judge(self._filter.take(piece, imus, reports), reports)
        good = imus[imus['kind'] == ImuKind.GOOD]
        sample = good['sample']
        self._stamps.append(sample['stamp'])
        self._log_times.append(piece.rows['log_time'][good['row']])
        append_rows(self._rates, usable(sample['angular_velocity']))
        forces = usable(sample['linear_acceleration'], LARGEST_ACCELERATION)
        append_rows(self._accelerations, forces)
        append_rows(self._outliers, good['result']['outlier'] > 0.0)
        self._resting.append(good['result']['at_rest'] > 0.0)
        doubles = all_doubles(piece.data, good)
        for stated, first in zip(self._stated, _COVARIANCES, strict=True):
            stated.add(doubles[:, first : first + 9])
        reported = doubles[:, ORIENTATION_COVARIANCE] != -1.0
        self._own.add(sample['stamp'][reported], doubles[reported, :4])

    def _note_orientation(self, channel: int, data: bytes) -> None:
        """Keep the orientation of another topic, passing over what can't be read."""
        connection, orientations = self._others[channel]
        stamp, quaternion = 0, np.zeros((1, 4))
        with suppress(Exception):
            message = read_message(data, connection)
            stamp, quaternion[0] = orientation_of(message, connection.msgtype)
        if stamp:
            orientations.add(np.array([stamp]), quaternion)

    def finish(self) -> Examined:
        """Make the last report; return what is to be examined."""
        self._take_imus(NO_MESSAGES, self._report_times.at_end())
        return Examined(
            stamps=self._stamps,
            log_times=self._log_times,
            rates=self._rates,
            accelerations=self._accelerations,
            outliers=self._outliers,
            resting=self._resting,
            stated=self._stated,
            references=self._references(),
            connections=int(np.count_nonzero(self._filter.is_imu)),
            rules=self._rules,
            telemetry=self._filter.messages.report().telemetry,
            truncation_refuted=is_truncation_refuted(self._filter.messages.filter),
        )

    def why_nothing(self) -> str:
        """Return why no message had an angular velocity, as the end of a sentence."""
        report = self._filter.messages.report()
        if not report.received:
            return ', and no other one'
        return f': {Health().judge(report, 0.0, paced=False)[0].message}'

    def _references(self) -> tuple[Reference, ...]:
        """Return all orientations that were found."""
        found = [self._own, *(orientations for _, orientations in self._others.values())]
        references = (orientations.reference() for orientations in found)
        return tuple(reference for reference in references if reference is not None)


def read_recording(
    bag: Path, topic: str | None, between: tuple[float, float], progress: Callable[[int, int], None]
) -> tuple[str, Examined]:
    """Send a recording through the filter; return the Imu topic, and what is to be examined.

    Args:
        bag: rosbag2 folder, bare .mcap or .db3 file, or .bag file of ROS 1.
        topic: Needed where there are several Imu topics.
        between: First and last time, in s since the first message of the recording.
        progress: Called with the number of messages done and their total.

    Raises:
        BagError: The bag can't be read, or holds no message with an angular velocity in that time.
    """
    wanted = () if topic is None else (topic,)
    selection = Selection(imu_topics=wanted, start=between[0], end=between[1])
    with open_bag(bag) as recording:
        ((chosen, names),) = selection.inputs(recording).items()
        reading = Reading(recording, chosen, names)
        for piece in selection.pieces(recording, progress):
            reading.take(piece)
        examined = reading.finish()
    if not len(examined.stamps):
        raise BagError(
            f'topic {chosen} has no message with an angular velocity{selection.when}'
            f'{reading.why_nothing()}'
        )
    return chosen, examined
