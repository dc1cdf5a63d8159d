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

"""Mean and standard deviation of rates, summed up sample by sample."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, entry_kernel, kernel, record
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.messages.imu import IMU, Imu, ImuKind, is_published


class Sums(TypedDict):
    """What Welford's formulas need of rates."""

    count: int
    mean: PerAxis  # rad/s
    squares: PerAxis  # sum of squared distances from the mean, (rad/s)^2


SUMS = record(Sums)


@entry_kernel(IMU, SUMS, SUMS)
def add_rates(imus: Sequence[Imu], raw_sums: Sequence[Sums], filtered_sums: Sequence[Sums]) -> None:
    """Add the rates of messages as they came and filtered, where there are both, to sums (1,)."""
    for i in range(len(imus)):
        imu = imus[i]
        if imu['kind'] == ImuKind.GOOD and is_published(imu):
            raw, result = imu['sample']['angular_velocity'], imu['result']
            if (
                abs(raw[0]) <= LARGEST_RATE
                and abs(raw[1]) <= LARGEST_RATE
                and abs(raw[2]) <= LARGEST_RATE
            ):
                _add(raw, raw_sums[0])
                _add(result['angular_velocity'], filtered_sums[0])


@kernel
def _add(values: NDArray[np.float64], sums: Sums) -> None:
    """Add values (3,), by Welford's formulas."""
    sums['count'] += 1
    share = 1.0 / sums['count']
    for axis in range(3):
        distance = values[axis] - sums['mean'][axis]
        sums['mean'][axis] += share * distance
        sums['squares'][axis] += distance * (values[axis] - sums['mean'][axis])


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation per axis in rad/s, of `count` samples; NaN where that is 0."""

    count: int
    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class RateStatistics:
    """Of rates as they came and filtered, however the messages are cut into pieces.

    Attributes:
        known_at: Log time in ns of the first message at rest, whose bias had been learned; None
            before.
    """

    def __init__(self) -> None:
        self._raw: Any = np.zeros(1, SUMS)
        self._filtered: Any = np.zeros(1, SUMS)
        self.known_at: int | None = None

    def add(self, imus: Any, log_times: NDArray[np.int64]) -> None:
        """Add filtered messages (n,) IMU with their log times (n,), where they have a rate."""
        add_rates(imus, self._raw, self._filtered)
        good = np.flatnonzero(imus['kind'] == ImuKind.GOOD)
        if self.known_at is None and len(good):
            known = imus['result']['at_rest'][good] > 0.0
            if known.any():
                self.known_at = int(log_times[good[np.argmax(known)]])

    def rates(self) -> tuple[Statistics, Statistics]:
        """Return the statistics of the rates as they came, and of the filtered ones."""
        return _statistics(self._raw[0]), _statistics(self._filtered[0])


def _statistics(sums: Sums) -> Statistics:
    if sums['count'] == 0:
        return Statistics(0, np.full(3, np.nan), np.full(3, np.nan))
    deviation = np.sqrt(sums['squares'] / sums['count'])
    return Statistics(int(sums['count']), sums['mean'].copy(), deviation)
