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

"""Samples that a driver sends twice: all six values are those of the sample before."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.identify.series import LARGEST_PART, Values, stacked

# Chance gives a count its root; beyond so many of them, and so many, it was not chance.
_DEVIATIONS, _LEAST = 5.0, 5.0
# Samples that are compared at once: six columns of them are one part's worth.
_TOGETHER = LARGEST_PART // 6


@dataclass(frozen=True)
class Repeats:
    """How often samples are repeated.

    Attributes:
        samples: All of them.
        repeated: Those whose values are those of the one before.
        runs: How often one or more came in a row.
        by_chance: Those that are repeated in a coarse sensor, by how often a sample is that before
            the last one.
    """

    samples: int
    repeated: int
    runs: int
    by_chance: int

    @property
    def are_repeats(self) -> bool:
        """Whether they are more than chance has."""
        chance = self.by_chance
        return self.repeated > chance + _LEAST + _DEVIATIONS * math.sqrt(chance)

    @property
    def share(self) -> float:
        """The share of the samples that is repeated."""
        return self.repeated / self.samples if self.samples else 0.0


def count_repeats(rates: tuple[Values, ...], accelerations: tuple[Values, ...]) -> Repeats:
    """Count the repeated samples of rates and accelerations, three columns (n,) each."""
    repeated = runs = chance = 0
    for ahead, values in _parts((*rates, *accelerations), 2):
        same, before, between = np.zeros((3, len(values)), np.bool_)
        same[1:] = _are_equal(values, 1)
        before[1:] = same[:-1]
        between[2:] = _are_equal(values, 2)
        repeated += int(same[ahead:].sum())
        runs += int((same & ~before)[ahead:].sum())
        chance += int((between & ~same & ~before)[ahead:].sum())
    return Repeats(len(rates[0]), repeated, runs, chance)


def without_repeats(stamps: Values, values: tuple[Values, ...]) -> Floats:
    """Return the stamps (m,) of samples (n,) that have other values than the one before."""
    others = [np.zeros(0, np.bool_)]
    for ahead, rows in _parts(values, 1):
        first = np.ones(1 - ahead, np.bool_)
        others.append(np.concatenate([first, ~_are_equal(rows, 1)]))
    return np.asarray(stamps[:][np.concatenate(others)])


def _parts(columns: Sequence[Values], before: int) -> Iterator[tuple[int, Floats]]:
    """Yield samples (m, number of columns) part by part.

    Those of the part before, up to so many of its last ones, go ahead: how many is yielded, too.
    """
    for first in range(0, len(columns[0]), _TOGETHER):
        ahead = min(first, before)
        yield ahead, np.nan_to_num(stacked(columns, slice(first - ahead, first + _TOGETHER)))


def _are_equal(rows: Floats, apart: int) -> Bools:
    """Tell for rows (m, c), but the first `apart` ones, if they equal those so many before them."""
    return np.asarray((rows[apart:] == rows[:-apart]).all(axis=1))
