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

"""Figures that are held against a bar: how they are made, their table, and what falls short."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.cli.printing import table


@dataclass(frozen=True)
class Figure:
    """A measured figure.

    Attributes:
        name: What was measured.
        value: Of ours.
        other: Of what it is compared with.
        against: What that is.
        ratio: What is judged.
        bar: Its limit.
        at_least: Whether the limit is the least instead of the largest.
    """

    name: str
    value: str
    other: str
    against: str
    ratio: float
    bar: float
    at_least: bool = False

    @classmethod
    def of_ratio(
        cls,
        name: str,
        form: str,
        numbers: tuple[float, float],
        against: str,
        bar: float,
        *,
        at_least: bool = False,
    ) -> Self:
        """Return a figure that is judged by the ratio of two numbers: ours, and the other one.

        `form` says how they are written, with their unit, such as '{:.0f} MB'.
        """
        ours, other = numbers
        texts = form.format(ours), form.format(other)
        return cls(name, *texts, against, ours / other, bar, at_least=at_least)

    @property
    def holds(self) -> bool:
        """Whether the bar holds."""
        return self.ratio >= self.bar if self.at_least else self.ratio <= self.bar


def rms(values: Floats) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def tell_figures(figures: Sequence[Figure], json_file: Path | None) -> int:
    """Print the table of figures and write them as JSON; return 1 where one falls short."""
    rows = [['figure', 'ours', 'other', 'against', 'ratio', 'bar', '']]
    for figure in figures:
        limit = f'{">=" if figure.at_least else "<="} {figure.bar:g}'
        verdict = 'holds' if figure.holds else 'FALLS SHORT'
        texts = [figure.name, figure.value, figure.other, figure.against]
        rows.append([*texts, f'{figure.ratio:.3g}', limit, verdict])
    print(table(rows))
    if json_file:
        plain = [asdict(figure) | {'holds': figure.holds} for figure in figures]
        json_file.write_text(json.dumps(plain, indent=1) + '\n')
    return int(not all(figure.holds for figure in figures))


def tell_misses(missed: Sequence[str], *, check: bool) -> int:
    """Print the bars that do not hold; return 1 where there are any and they are checked."""
    for line in missed:
        print(f'FALLS SHORT  {line}')
    return int(check and bool(missed))
