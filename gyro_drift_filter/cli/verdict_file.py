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

"""Verdicts for programs, as JSON in SI units; `report/verdict.py` says what each figure is."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.result_files import as_plain, write_json

if TYPE_CHECKING:
    from gyro_drift_filter.report.verdict import Verdict


def write_verdicts(path: Path, bags: Iterable[tuple[Path, Iterable['Verdict']]]) -> None:
    """Write the verdicts on the Imu topics of bags.

    Raises:
        GyroDriftFilterError: They can't be written.
    """
    plain = [
        {'bag': str(bag), **as_plain(verdict)} for bag, verdicts in bags for verdict in verdicts
    ]
    write_json(path, {'verdicts': plain})
