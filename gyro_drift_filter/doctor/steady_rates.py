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

"""The raw rates at the times that a rule of `/diagnostics` tells of."""

from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.sample import LARGEST_RATE


class SteadyRates:
    """Raw rates by the rules that apply to reports; of all messages only the last ones are kept."""

    def __init__(self) -> None:
        """Start before the first message."""
        self._rates: Floats = np.empty((0, 3))
        self._begin = 0  # messages before the ones that are kept
        # By rules, over reports: the sum of rates (3,), of their squares, and of ones.
        self._sums: dict[str, Floats] = {}

    def take(self, imus: Any) -> None:
        """See the next messages (n,) IMU."""
        self._begin += len(self._rates)
        self._rates = imus['sample']['angular_velocity'].copy()

    def note(self, rule: str, before: int, now: int) -> None:
        """Add the messages between two reports to a rule, by how many had come until each."""
        rates = self._rates[max(before - self._begin, 0) : max(now - self._begin, 0)]
        usable = rates[(np.abs(rates) <= LARGEST_RATE).all(axis=1)]
        if len(usable):
            # Not the mean: the sensor may have begun to move, or a spike have come.
            rate = np.median(usable, axis=0)
            sums = self._sums.setdefault(rule, np.zeros((3, 3)))
            sums += (rate, rate * rate, np.ones(3))

    def mean(self, rule: str) -> Floats:
        """Return the mean rates (3,) in rad/s while a rule applied; NaN where it did not."""
        return self._means(rule)[0]

    def deviation(self, rule: str) -> Floats:
        """Return the standard deviation (3,) in rad/s of these rates over reports; NaN likewise."""
        mean, square = self._means(rule)
        deviation: Floats = np.sqrt(np.maximum(square - mean**2, 0.0))
        return deviation

    def _means(self, rule: str) -> tuple[Floats, Floats]:
        rates, squares, count = self._sums.get(rule, np.full((3, 3), np.nan))
        return rates / count, squares / count
