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

"""The report on one bag of a fleet: the page of `gyro_drift report`, with fewer points."""

from pathlib import Path

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.summary import Summary
from gyro_drift_filter.report.figures import Drawer
from gyro_drift_filter.report.page import DrawnRecording, when_recorded
from gyro_drift_filter.report.signals import Signals

# Of all traces of one topic: a page is then some two thirds larger than the library on it.
_POINTS = 60_000


def report_path(reports: Path, content: str) -> Path:
    """Return where the report on a bag is written, by the hash of what it holds."""
    return reports / f'{content}.html'


def shown_topic(
    name: str, signals: Signals, summary: Summary, parameters: Parameters
) -> DrawnRecording:
    """Return what the page shows of one Imu topic of a bag."""
    method = parameters.method
    drawer = Drawer({method: signals}, summary.start, _POINTS)
    facts = [('topic', summary.topic), when_recorded(summary, signals.watch.period)]
    return DrawnRecording(name, drawer, {method: summary}, parameters, facts)
