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
from numpy.typing import NDArray

from gyro_drift_filter.core.sample import LARGEST_RATE

Floats = NDArray[np.float64]


class SteadyRates:
    """Raw rates from report to report; of all messages only the last ones are kept."""

    def __init__(self) -> None:
        """Start before the first message."""
        self._rates: Floats = np.empty((0, 3))
        self._begin = 0  # messages before the ones that are kept
        self._sum, self._squares, self._count = np.zeros(3), np.zeros(3), 0

    def take(self, imus: Any) -> None:
        """See the next messages (n,) IMU."""
        self._begin += len(self._rates)
        self._rates = imus['sample']['angular_velocity'].copy()

    def note(self, before: int, now: int) -> None:
        """Add the messages between two reports, by how many messages had come until each."""
        rates = self._rates[max(before - self._begin, 0) : max(now - self._begin, 0)]
        usable = rates[(np.abs(rates) <= LARGEST_RATE).all(axis=1)]
        if len(usable):
            # Not the mean: the sensor may have begun to move, or a spike have come.
            rate = np.median(usable, axis=0)
            self._sum += rate
            self._squares += rate * rate
            self._count += 1

    @property
    def mean(self) -> Floats:
        """The mean rates (3,) in rad/s of all that was added; NaN where nothing was."""
        return self._sum / self._count if self._count else np.full(3, np.nan)

    @property
    def deviation(self) -> Floats:
        """Standard deviation (3,) in rad/s of the rates from report to report; NaN likewise."""
        variance = self._squares / max(self._count, 1) - self.mean**2
        return np.sqrt(np.maximum(variance, 0.0))
