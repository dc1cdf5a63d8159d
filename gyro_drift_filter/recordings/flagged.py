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

"""A recording through the filter, with the samples that it flags."""

from collections.abc import Callable
from pathlib import Path

from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.output import NoOutput
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.replay_run import ReplayRun, why_nothing
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.report.flagged import FlaggedLog


def read_flagged(
    bag: Path,
    parameters: Parameters,
    selection: Selection,
    progress: Callable[[int, int], None],
) -> tuple[Summary, FlaggedLog]:
    """Send one Imu topic of a recording through the filter; return what was done, and flagged.

    Raises:
        BagError: The bag can't be read, or holds no message with an angular velocity.
    """
    logs: list[FlaggedLog] = []

    def watched(topic: str, filter_: Filter) -> FlaggedLog:
        logs.append(FlaggedLog(filter_))
        return logs[-1]

    with open_bag(bag) as recording:
        inputs, hint = selection.inputs(recording), selection.hint_topic(recording)
        output = NoOutput(1)
        run = ReplayRun(recording, output, parameters, inputs, watched, hint, is_judged=False)
        for piece in selection.pieces(recording, progress):
            run.take(piece)
        (summary,) = run.finish()
    if not logs[0].samples:
        raise BagError(why_nothing(summary))
    return summary, logs[0]
