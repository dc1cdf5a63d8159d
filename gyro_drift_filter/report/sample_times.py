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

"""How much time each sample of a run stands for, by its stamp as far as stamps tell it."""

from collections.abc import Sequence
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only, record
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.clock.periods import LEAST_STAMPED_SHARE, STALLED_SECONDS


class SampleTimes(TypedDict):
    """Where in time a run is, and what its filter knows of the time between samples."""

    period: float  # s, for steps that nothing tells
    longest: float  # s: by a longer step time has jumped
    standing: bool  # whether stamps tell no time: they stand, or are in another unit
    rate_is_given: bool  # by the parameters, for samples whose stamps tell no time
    started: bool
    clock: int  # that told the time of the last sample, one of those below
    time: int  # of it, ns
    ahead: float  # s, that samples since the last forward step counted for beyond it
    samples: int
    logged: int  # samples whose step is told by the log
    logged_seconds: float  # that they stand for


SAMPLE_TIMES = record(SampleTimes)

# Which clock tells the time of a sample.
_STAMPS, _LOG, _GIVEN_RATE = 0, 1, 2


@kernel
def sample_seconds(stamp: int, log_time: int, times: SampleTimes) -> float:
    """Return the time in s that the next sample stands for.

    By its stamp; where that is 0 or stamps stand, by the rate that was given, or else by its log
    time, as the rate that a filter assumes then is that of no sensor in particular.

    Args:
        stamp: Of the sample in ns, 0 where there is none.
        log_time: In ns.
        times: Where the run is; it moves on to the sample.
    """
    clock, time = _STAMPS, stamp
    if stamp == 0 or times['standing']:
        clock, time = (_GIVEN_RATE if times['rate_is_given'] else _LOG), log_time
    times['samples'] += 1
    return _step_seconds(clock, time, times)


@kernel
def _step_seconds(clock: int, time: int, times: SampleTimes) -> float:
    """Return the time in s that a sample stands for whose time in ns is that of a clock.

    A time that does not advance, as of samples that are stamped as one batch, or that goes
    backward counts for one period. The next one that advances covers that time, too, so it counts
    for the rest of its step only. Otherwise the time would count twice.
    """
    step, period = (time - times['time']) * 1e-9, times['period']
    is_told = clock != _GIVEN_RATE and times['started'] and clock == times['clock']
    times['started'], times['clock'], times['time'] = True, clock, time
    if not is_told or abs(step) > times['longest']:
        times['ahead'] = 0.0
        return period
    seconds = period
    if step > 0.0:
        seconds = max(step - times['ahead'], 0.0)
        times['ahead'] = 0.0
    else:
        times['ahead'] += period - step
    if clock == _LOG:
        times['logged'] += 1
        times['logged_seconds'] += seconds
    return seconds


@entry_kernel(read_only(np.int64), read_only(np.int64), SAMPLE_TIMES, np.float64)
def each_sample_seconds(
    stamps: NDArray[np.int64],
    log_times: NDArray[np.int64],
    all_times: Sequence[SampleTimes],
    seconds: NDArray[np.float64],
) -> None:
    """Write the time in s that each of many samples stands for.

    Args:
        stamps: (n,) in ns.
        log_times: (n,) in ns.
        all_times: (1,).
        seconds: (n,) to be written.
    """
    for i in range(len(stamps)):
        seconds[i] = sample_seconds(stamps[i], log_times[i], all_times[0])


def no_sample_times() -> Any:
    """Return SAMPLE_TIMES (1,) of a run that has not begun."""
    return np.zeros(1, SAMPLE_TIMES)


def note_pace(times: Any, filter_: Filter) -> None:
    """Note in SAMPLE_TIMES (1,) what a filter knows of the time between the samples it has seen."""
    clock, parameters = filter_.state['clock'], filter_.parameters
    times['period'] = clock['period']
    times['longest'] = parameters.gap_limit
    times['standing'] = clock['unstamped'] >= LEAST_STAMPED_SHARE * STALLED_SECONDS
    times['rate_is_given'] = parameters.sample_rate > 0.0


def is_by_log(times: Any) -> bool:
    """Return whether log times tell most of the time of a run, by its SAMPLE_TIMES (1,)."""
    return bool(2 * times['logged'][0] > times['samples'][0])


def sample_period(times: Any, filter_: Filter) -> float:
    """Return the time in s between samples, as the filter has learned it, or by the log times."""
    if is_by_log(times):
        return float(times['logged_seconds'][0] / times['logged'][0])
    return float(filter_.state['clock']['mean_period'])
