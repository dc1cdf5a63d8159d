"""Mean and standard deviation of rates, summed up sample by sample in compiled code."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel
from gyro_drift_filter.core.sample import LARGEST_RATE, RESULT, SampleStatus
from gyro_drift_filter.messages.cdr import GOOD
from gyro_drift_filter.messages.imu_kernels import IMU

_SUMS = np.dtype(
    [('count', np.int64), ('mean', np.float64, (3,)), ('squares', np.float64, (3,))], align=True
)


@entry_kernel((np.float64, 2), (np.float64, 2), _SUMS, _SUMS)
def add_samples(raw: Any, filtered: Any, raw_sums: Any, filtered_sums: Any) -> None:
    """Add rates (n, 3) as they came and filtered, where the former are usable."""
    for i in range(len(raw)):
        _add(raw[i], filtered[i], raw_sums[0], filtered_sums[0])


@entry_kernel(IMU, RESULT, _SUMS, _SUMS)
def add_results(imus: Any, results: Any, raw_sums: Any, filtered_sums: Any) -> None:
    """Add the rates of IMUs (n,) and of their RESULTs (n,), where there is one."""
    for i in range(len(imus)):
        if imus[i]['kind'] == GOOD and results[i]['status'] != SampleStatus.REFUSED:
            _add(
                imus[i]['sample']['angular_velocity'],
                results[i]['angular_velocity'],
                raw_sums[0],
                filtered_sums[0],
            )


@kernel
def _add(raw: Any, filtered: Any, raw_sums: Any, filtered_sums: Any) -> None:
    if not (
        abs(raw[0]) <= LARGEST_RATE and abs(raw[1]) <= LARGEST_RATE and abs(raw[2]) <= LARGEST_RATE
    ):
        return
    _add_values(raw, raw_sums)
    _add_values(filtered, filtered_sums)


@kernel
def _add_values(values: Any, sums: Any) -> None:
    """Add values (3,), by Welford's formulas."""
    sums['count'] += 1
    share = 1.0 / sums['count']
    for axis in range(3):
        distance = values[axis] - sums['mean'][axis]
        sums['mean'][axis] += share * distance
        sums['squares'][axis] += distance * (values[axis] - sums['mean'][axis])


@dataclass(frozen=True)
class Statistics:
    """Mean and standard deviation per axis in rad/s; NaN where there was no sample."""

    mean: NDArray[np.float64]
    deviation: NDArray[np.float64]


class Moments:
    """Of rates as they came and filtered, however the samples are cut into batches."""

    def __init__(self) -> None:
        self._sums = np.zeros(1, _SUMS), np.zeros(1, _SUMS)

    def add(self, raw: NDArray[np.float64], filtered: NDArray[np.float64]) -> None:
        """Add samples (n, 3) in rad/s as they came, where they are usable rates, and filtered."""
        add_samples(np.ascontiguousarray(raw), np.ascontiguousarray(filtered), *self._sums)

    def add_results(self, imus: NDArray[Any], results: NDArray[Any]) -> None:
        """Add IMUs (n,) of `imu_kernels`, and the RESULT (n,) of those that have one."""
        add_results(imus, results, *self._sums)

    def statistics(self) -> tuple[Statistics, Statistics]:
        """Return what they come to: as they came, and filtered."""
        raw, filtered = self._sums
        return _statistics(raw[0]), _statistics(filtered[0])


def _statistics(sums: Any) -> Statistics:
    if sums['count'] == 0:
        return Statistics(np.full(3, np.nan), np.full(3, np.nan))
    return Statistics(sums['mean'].copy(), np.sqrt(sums['squares'] / sums['count']))
