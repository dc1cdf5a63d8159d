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

"""When a replay reports: about once a second of log time, between two batches of messages."""

from collections.abc import Sequence
from typing import Any, Literal, TypedDict

import numpy as np

from gyro_drift_filter.accelerate import entry_kernel, record
from gyro_drift_filter.mcap.message_kernels import ROW, Row

# A batch of messages ends before the one that comes so many ns of log time after its first one, or
# is one more than these.
BATCH_SPAN = 1_000_000_000
LARGEST_BATCH = 4096


class Schedule(TypedDict):
    """The batch under way, and when there was a report. Times are log times in ns."""

    started: bool
    start: int  # of the recording
    reported: int  # last
    first: int  # of the batch
    last: int
    count: int


SCHEDULE = record(Schedule)


class ReportTime(TypedDict):
    """When a report is made."""

    row: int  # index of the message that it stands before
    time: int  # log time in ns
    seconds: float  # since the report before
    end: int  # where its message ends among those of all reports, once they are made


REPORT_TIME = record(ReportTime)


@entry_kernel(ROW, SCHEDULE, REPORT_TIME)
def list_report_times(
    rows: Sequence[Row], schedule: Sequence[Schedule], reports: Sequence[ReportTime]
) -> int:
    """Go through messages in the order of their log times; write when to report.

    `schedule` is (1,); there are no more reports than messages. Returns how many there are.
    """
    now, count = schedule[0], 0
    for i in range(len(rows)):
        time = rows[i]['log_time']
        if not now['started']:
            now['started'] = True
            now['start'] = now['reported'] = now['first'] = time
        elif now['count'] == LARGEST_BATCH or time - now['first'] >= BATCH_SPAN:
            passed = now['last'] - now['reported']
            if passed >= BATCH_SPAN // 2:
                report = reports[count]
                report['row'], report['time'], report['seconds'] = i, now['last'], passed * 1e-9
                now['reported'] = now['last']
                count += 1
            now['first'], now['count'] = time, 0
        now['last'] = time
        now['count'] += 1
    return count


class ReportTimes:
    """The times of the reports on a recording."""

    def __init__(self) -> None:
        self._schedules: Any = np.zeros(1, SCHEDULE)
        self._schedule: Schedule = self._schedules[0]

    def among(self, rows: Any) -> Any:
        """Return the REPORT_TIMEs among the next messages, of which these are the ROWs."""
        reports: Any = np.zeros(len(rows), REPORT_TIME)
        count = list_report_times(rows, self._schedules, reports)
        return reports[:count]

    def at_end(self) -> Any:
        """Return the REPORT_TIMEs behind the last message: one or none."""
        now, seconds = self._schedule, self._seconds_since('reported')
        is_due = now['started'] and (seconds > 0.0 or now['last'] == now['start'])
        return np.array([(0, now['last'], seconds, 0)] if is_due else [], REPORT_TIME)

    @property
    def start(self) -> int:
        """The log time of the first message in ns."""
        return int(self._schedule['start'])

    @property
    def seconds(self) -> float:
        """The time from the first message to the last one in s."""
        return self._seconds_since('start')

    def _seconds_since(self, time: Literal['start', 'reported']) -> float:
        return (int(self._schedule['last']) - int(self._schedule[time])) % 2**64 * 1e-9
