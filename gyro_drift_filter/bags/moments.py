"""Mean and standard deviation of rates, summed up sample by sample in compiled code."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core.compiled import compiled
from gyro_drift_filter.core.filter import LARGEST_RATE

_SUMS = np.dtype(
    [('count', np.int64), ('mean', np.float64, (3,)), ('squares', np.float64, (3,))], align=True
)


@compiled
def add_samples(raw: Any, values: Any, sums: Any) -> None:
    """Add rows of values (n, 3) where those of `raw` (n, 3) are usable rates (Welford)."""
    counted = sums[0]
    for i in range(len(values)):
        if not (
            abs(raw[i, 0]) <= LARGEST_RATE
            and abs(raw[i, 1]) <= LARGEST_RATE
            and abs(raw[i, 2]) <= LARGEST_RATE
        ):
            continue
        counted['count'] += 1
        share = 1.0 / counted['count']
        for axis in range(3):
            distance = values[i, axis] - counted['mean'][axis]
            counted['mean'][axis] += share * distance
            counted['squares'][axis] += distance * (values[i, axis] - counted['mean'][axis])


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation per axis in rad/s; NaN where there was no sample."""

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class Moments:
    """Mean and standard deviation per axis, however the samples are cut into batches."""

    def __init__(self) -> None:
        self._sums = np.zeros(1, _SUMS)

    def add(self, raw: NDArray[np.float64], values: NDArray[np.float64]) -> None:
        """Add values (n, 3) in rad/s of the samples whose raw rates (n, 3) are all usable."""
        add_samples(np.ascontiguousarray(raw), np.ascontiguousarray(values), self._sums)

    def statistics(self) -> Statistics:
        """Return what they come to."""
        sums = self._sums[0]
        if sums['count'] == 0:
            return Statistics(np.full(3, np.nan), np.full(3, np.nan))
        return Statistics(sums['mean'].copy(), np.sqrt(sums['squares'] / sums['count']))
