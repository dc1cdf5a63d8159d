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


class SampleTimes(TypedDict):
    """Where in time a run is."""

    started: bool
    stamp: int  # of the last sample, ns
    ahead: float  # s, that samples since the last forward stamp counted for beyond the stamps


SAMPLE_TIMES = record(SampleTimes)


@kernel
def sample_seconds(stamp: int, period: float, longest: float, times: SampleTimes) -> float:
    """Return the time in s that the next sample stands for.

    A stamp that does not advance, as of samples that are stamped as one batch, or that goes
    backward counts for one period. The next one that advances covers that time, too, so it counts
    for the rest of its step only. Otherwise the time would count twice.

    Args:
        stamp: Of the sample in ns, 0 where there is none.
        period: Of the samples in s, for steps that the stamps do not tell.
        longest: Step in s beyond which stamps have jumped.
        times: Where the run is; it moves on to the sample.
    """
    step = (stamp - times['stamp']) * 1e-9
    follows = times['started'] and stamp != 0 and abs(step) <= longest
    times['started'], times['stamp'] = True, stamp
    if not follows:
        times['ahead'] = 0.0
        return period
    if step <= 0.0:
        times['ahead'] += period - step
        return period
    seconds = max(step - times['ahead'], 0.0)
    times['ahead'] = 0.0
    return seconds


@entry_kernel(read_only(np.int64), float, float, SAMPLE_TIMES, np.float64)
def each_sample_seconds(
    stamps: NDArray[np.int64],
    period: float,
    longest: float,
    all_times: Sequence[SampleTimes],
    seconds: NDArray[np.float64],
) -> None:
    """Write the time in s that each of many samples stands for.

    Args:
        stamps: (n,) in ns.
        period: Of the samples in s, for steps that the stamps do not tell.
        longest: Step in s beyond which stamps have jumped.
        all_times: (1,).
        seconds: (n,) to be written.
    """
    for i in range(len(stamps)):
        seconds[i] = sample_seconds(stamps[i], period, longest, all_times[0])


def no_sample_times() -> Any:
    """Return SAMPLE_TIMES (1,) of a run that has not begun."""
    return np.zeros(1, SAMPLE_TIMES)
