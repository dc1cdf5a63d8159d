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

"""What the stamps of a recording say: the sample period, bursts, gaps.

Samples are taken to be evenly spaced between gaps, as a sensor takes them, whatever the stamps say:
drivers deliver in bursts, and stamp what they deliver.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.identify.errors import IdentificationError
from gyro_drift_filter.identify.series import LARGEST_PART, Values, value_at

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

# A step of the stamps beyond both is a gap. Bursty delivery waits up to half a second.
GAP_PERIODS = 10.0
GAP_SECONDS = 0.6
# s, begin of 2007: ROS is not older, so a clock that tells less has not been set. Boards begin in
# 1970, in 1980 (the epochs of GPS and FAT) or in 2000 (clock chips with two digits for the year).
EARLIEST = 1_167_609_600
BLOCK_SECONDS, LEAST_BLOCK = 2.0, 10
# A step is uneven where it is off by more than this share of the period.
UNEVEN = 0.5


@dataclass(frozen=True)
class Timing:
    """How the samples lie in time.

    Attributes:
        period: In s.
        breaks: (g,) index of each sample before which time is missing, or the clock was set.
        set_back: (g,) by how much it was set back there, or if negative forward, in s; 0 where
            time is missing.
        uneven: Share of the other steps that are off by more than half a period.
    """

    period: float
    breaks: Integers
    set_back: Floats
    uneven: float

    def seconds_at(self, stamps: Integers | Values, index: int) -> float:
        """Return the time of a sample in s since the first; it goes on where the clock was set."""
        since = float(value_at(stamps, index) - value_at(stamps, 0)) * 1e-9
        return since + float(self.set_back[self.breaks <= index].sum())


def learn_timing(stamps: Integers | Values, log_times: Integers | Values | None = None) -> Timing:
    """Learn the sample period from blocks of two seconds, and find the gaps.

    A gap that the log times do not have is none: there the clock of the stamps was set forward. So
    was that of both, where the gap begins before any recording could be made.

    Args:
        stamps: (n,) in ns.
        log_times: (n,) in ns, where they are known.

    Raises:
        IdentificationError: The stamps don't advance.
    """
    medians = [float(np.median(steps)) for _, steps in _steps(stamps)]
    usual = float(np.median(medians)) if medians else 0.0
    periods = [_periods(np.where(_jumps(steps, usual), 0.0, steps)) for _, steps in _steps(stamps)]
    if not any(map(len, periods)):
        raise IdentificationError(_why_no_period(stamps))
    period = float(np.median(np.concatenate(periods)))
    breaks, set_back, uneven, even = [np.zeros(0, np.int64)], [np.zeros(0)], 0, 0
    logs = _steps(stamps if log_times is None else log_times)
    for (first, steps), (_, logged) in zip(_steps(stamps), logs, strict=True):
        jumps = _jumps(steps, period)
        was_set = (steps < 0.0) | ~_jumps(logged, period)
        times = value_at(stamps, first) * 1e-9 + np.cumsum(steps)
        was_set |= (times > EARLIEST) & (times - steps < EARLIEST)
        breaks.append(first + 1 + np.flatnonzero(jumps))
        set_back.append(np.where(was_set, period - steps, 0.0)[jumps])
        off = np.abs(steps[~jumps] - period) > UNEVEN * period
        uneven, even = uneven + int(off.sum()), even + len(off)
    share = uneven / even if even else 0.0
    return Timing(period, np.concatenate(breaks), np.concatenate(set_back), share)


def _why_no_period(stamps: Integers | Values) -> str:
    """Return in words why stamps (n,) tell no sample period, and what to do."""
    if len(stamps) == 1:
        return 'the stamps do not advance, as there is one message only: record for longer'
    if len(stamps) > 1 and stamps[-1:][0] < stamps[:1][0]:
        return 'the stamps go back: record again with a driver whose stamps advance'
    return (
        'the stamps do not advance: there is no sample rate to be learned; record again with a '
        'driver that stamps its messages, or, where the stamps are zero, name the rate with '
        '--sample-rate'
    )


def _steps(stamps: Integers | Values) -> Iterator[tuple[int, Floats]]:
    """Yield the steps between stamps in s, part by part, each with the index of its first."""
    n = len(stamps)
    for first in range(0, n - 1, LARGEST_PART):
        yield first, np.diff(stamps[first : min(first + LARGEST_PART + 1, n)]) * 1e-9


def _jumps(steps: Floats, period: float) -> Bools:
    return np.abs(steps) > max(GAP_PERIODS * period, GAP_SECONDS)


def _periods(steps: Floats) -> Floats:
    """Return the time per sample in s of blocks (b,); a block is longer than a burst."""
    seconds = np.maximum.accumulate(np.concatenate([[0.0], np.cumsum(steps)]))
    if not seconds[-1] > 0.0:
        return np.zeros(0)
    edges = np.searchsorted(seconds, np.arange(0.0, seconds[-1], BLOCK_SECONDS))
    edges = np.append(edges[np.append(True, np.diff(edges) >= LEAST_BLOCK)], len(seconds) - 1)
    counts = np.diff(edges)
    used = counts > 0
    if not used.any():
        return np.array([seconds[-1] / len(steps)])
    return np.asarray(np.diff(seconds[edges])[used] / counts[used])
