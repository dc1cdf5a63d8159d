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

"""Results of single bags, kept as they come: what an interrupted run has done is not lost."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.fleet.columns import MEASURED
from gyro_drift_filter.fleet.measuring import Result, Row
from gyro_drift_filter.fleet.sources import Bag
from gyro_drift_filter.version import package_version
from gyro_drift_filter.whole_file import write_whole


class Results:
    """A folder with a file for each content that was measured, by one version with one filter."""

    def __init__(self, folder: Path, parameters: Parameters) -> None:
        """Take a folder, that need not be there.

        Of other parameters, or another version, results are others: they have folders of their own.
        """
        made_by = [package_version(), repr(parameters), *(column.name for column in MEASURED)]
        self._folder = folder / hashlib.sha256('\n'.join(made_by).encode()).hexdigest()[:16]

    def keep(self, bag: Bag, result: Result) -> None:
        """Keep the result of a bag: it is there whole or not at all.

        Raises:
            GyroDriftFilterError: It can't be written.
        """
        plain = {'checksum': bag.checksum, 'rows': result.rows}
        write_whole(self._path(result.content), json.dumps(plain, allow_nan=False))

    def rows(self, content: str) -> list[Row]:
        """Return the rows of a content that was kept."""
        rows: list[Row] = json.loads(self._path(content).read_text(encoding='utf-8'))['rows']
        return rows

    def has(self, content: str) -> bool:
        """Tell whether a content was kept."""
        return bool(content) and self._path(content).exists()

    def checksums(self) -> dict[str, str]:
        """Return the contents that were kept by what their stores said of them."""
        return {
            checksum: path.stem
            for path in self._paths()
            if (checksum := json.loads(path.read_text(encoding='utf-8'))['checksum'])
        }

    def are_there(self) -> bool:
        """Tell whether anything was kept."""
        return next(self._paths(), None) is not None

    def _path(self, content: str) -> Path:
        return self._folder / content[:2] / f'{content}.json'

    def _paths(self) -> Iterator[Path]:
        return self._folder.glob('??/*.json')
