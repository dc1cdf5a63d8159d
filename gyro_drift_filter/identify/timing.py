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

Some sensors change their rate, as those that lower it while they stand still. Each rate then has a
timing of its own, as the noise of a sample depends on the rate. Only where stamps are even can that
be seen: lost messages and bursts make steps of several lengths, a rate makes steps of one.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.core.clock.periods import BLOCK_SAMPLES, OTHER_PERIOD
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.series import LARGEST_PART, Values, value_at
from gyro_drift_filter.phrases import counted

# A step of the stamps beyond both is a gap. Bursty delivery waits up to half a second.
GAP_PERIODS = 10.0
GAP_SECONDS = 0.6
# s, begin of 2007: ROS is not older, so a clock that tells less has not been set. Boards begin in
# 1970, in 1980 (the epochs of GPS and FAT) or in 2000 (clock chips with two digits for the year).
EARLIEST = 1_167_609_600
BLOCK_SECONDS, LEAST_BLOCK = 2.0, 10
# A step is uneven where it is off by more than this share of the period.
UNEVEN = 0.5
# A block is even where so many of its steps are not uneven: a loss of every second one leaves less.
EVEN_SHARE = 0.75
# One even block alone may hold a change of the rate, or a message that was late.
LEAST_BLOCKS = 2


@dataclass(frozen=True)
class OneRate:
    """A stretch at one rate: samples from `first` up to, and without, `stop`; `period` in s."""

    first: int
    stop: int
    period: float


@dataclass(frozen=True)
class Timing:
    """How the samples lie in time, those of one rate where the sensor changed it.

    Attributes:
        period: In s.
        breaks: (g,) index of each sample before which time is missing, or the clock was set.
        set_back: (g,) by how much it was set back there, or if negative forward, in s; 0 where
            time is missing.
        uneven: Share of the other steps that are off by more than half a period.
        stretches: At which rate the sensor was when, in order; empty where it had one rate only.
    """

    period: float
    breaks: Integers
    set_back: Floats
    uneven: float
    stretches: tuple[OneRate, ...] = ()

    def parts(self, n: int) -> list[tuple[int, int]]:
        """Return where n samples lie at even steps of this period: first ones, and before which."""
        kept = [(s.first, s.stop) for s in self.stretches if s.period == self.period] or [(0, n)]
        out: list[tuple[int, int]] = []
        for first, stop in kept:
            inside = self.breaks[(self.breaks > first) & (self.breaks < stop)].tolist()
            out += pairwise([first, *inside, stop])
        return out

    def seconds_of(self, stamps: Integers | Values, first: int, stop: int) -> float:
        """Return how long samples from `first` to before `stop` last in s, by stamps (n,) in ns."""
        if stop <= first:
            return 0.0
        between = self.seconds_at(stamps, stop - 1) - self.seconds_at(stamps, first)
        return between + self.period

    def rate_changes(self, stamps: Integers | Values) -> str:
        """Return in words how the rate changed by stamps (n,) in ns; empty where it did not."""
        if not self.stretches:
            return ''
        before, behind, *more = self.stretches
        again = f', and {counted(len(more), "time")} more' if more else ''
        return (
            f'the sensor changed its rate from {1.0 / before.period:.4g} to '
            f'{1.0 / behind.period:.4g} Hz at {self.seconds_at(stamps, behind.first):.1f} s{again}'
        )

    def seconds_at(self, stamps: Integers | Values, index: int) -> float:
        """Return the time of a sample in s since the first one, by stamps (n,) in ns.

        It goes on where the clock was set.
        """
        since = float(value_at(stamps, index) - value_at(stamps, 0)) * 1e-9
        return since + float(self.set_back[self.breaks <= index].sum())


def learn_timing(stamps: Integers | Values, log_times: Integers | Values | None = None) -> Timing:
    """Learn the timing of the rate that the sensor had for longest, as `learn_timings` does."""
    return learn_timings(stamps, log_times)[0]


def learn_timings(
    stamps: Integers | Values, log_times: Integers | Values | None = None
) -> list[Timing]:
    """Learn the sample period from blocks of two seconds, and find the gaps.

    A gap that the log times do not have is none: there the clock of the stamps was set forward. So
    was that of both, where the gap begins before any recording could be made.

    Args:
        stamps: (n,) in ns.
        log_times: (n,) in ns, where they are known.

    Returns:
        One for each rate of the sensor, that of the longest time first.

    Raises:
        IdentificationError: The stamps don't advance.
    """
    medians = [float(np.median(steps)) for _, steps in _steps(stamps)]
    usual = float(np.median(medians)) if medians else 0.0
    blocks = np.concatenate(
        [
            np.zeros((0, 4)),
            *(_blocks(first, np.where(_jumps(s, usual), 0.0, s)) for first, s in _steps(stamps)),
        ]
    )
    if not len(blocks):
        raise IdentificationError(_why_no_period(stamps))
    stretches = _stretches(blocks, stamps)
    if not stretches:
        return [_timing(float(np.median(blocks[:, 2])), (), stamps, log_times)]
    lasting: dict[float, float] = {}
    for s in stretches:
        lasting[s.period] = lasting.get(s.period, 0.0) + (s.stop - s.first) * s.period
    periods = sorted(lasting, key=lambda period: -lasting[period])
    return [_timing(period, stretches, stamps, log_times) for period in periods]


def _timing(
    period: float,
    stretches: tuple[OneRate, ...],
    stamps: Integers | Values,
    log_times: Integers | Values | None,
) -> Timing:
    """Return how samples lie in time, of which those of this period in s count."""
    kept = [(s.first, s.stop) for s in stretches if s.period == period] or [(0, len(stamps))]
    breaks, set_back, uneven, even = [np.zeros(0, np.int64)], [np.zeros(0)], 0, 0
    logs = _steps(stamps if log_times is None else log_times)
    for (first, steps), (_, logged) in zip(_steps(stamps), logs, strict=True):
        jumps = _jumps(steps, period)
        was_set = (steps < 0.0) | ~_jumps(logged, period)
        times = value_at(stamps, first) * 1e-9 + np.cumsum(steps)
        was_set |= (times > EARLIEST) & (times - steps < EARLIEST)
        own = np.zeros(len(steps), bool)
        for begin, stop in kept:
            # A step leads to the sample behind it.
            own[max(begin - first, 0) : max(stop - first - 1, 0)] = True
        breaks.append(first + 1 + np.flatnonzero(jumps))
        set_back.append(np.where(was_set, period - steps, 0.0)[jumps])
        off = np.abs(steps - period)[own & ~jumps] > UNEVEN * period
        uneven, even = uneven + int(off.sum()), even + len(off)
    share = uneven / even if even else 0.0
    return Timing(period, np.concatenate(breaks), np.concatenate(set_back), share, stretches)


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


def _blocks(first: int, steps: Floats) -> Floats:
    """Return blocks (b, 4), longer than a burst, of steps in s, the first of which has an index.

    Each has the sample that it begins with and the one that it ends with, the time per sample in s,
    and whether it is even.
    """
    seconds = np.maximum.accumulate(np.concatenate([[0.0], np.cumsum(steps)]))
    if not seconds[-1] > 0.0:
        return np.zeros((0, 4))
    edges = np.searchsorted(seconds, np.arange(0.0, seconds[-1], BLOCK_SECONDS))
    edges = np.append(edges[np.append(True, np.diff(edges) >= LEAST_BLOCK)], len(seconds) - 1)
    edges = edges[np.append(True, np.diff(edges) > 0)]
    if len(edges) < 2:
        edges = np.array([0, len(steps)])
    periods = np.diff(seconds[edges]) / np.diff(edges)
    even = [_is_even(steps[i:k], OTHER_PERIOD) for i, k in pairwise(edges)]
    return np.column_stack([first + edges[:-1], first + edges[1:], periods, even])


def _is_even(steps: Floats, margin: float) -> bool:
    """Tell whether most steps are about their mean, and the middle ones within a share of it.

    Where messages are lost most steps are shorter, as that is the mean of short ones and long ones.
    """
    period = float(steps.mean())
    few = len(steps) // 4
    middle = float(np.sort(steps)[few : len(steps) - few].mean())
    share = float((np.abs(steps - period) <= UNEVEN * period).mean())
    return abs(middle - period) < margin * period and share >= EVEN_SHARE


def _is_even_run(blocks: Floats, stamps: Integers | Values) -> bool:
    """Tell whether blocks (b, 4) are even all together: few steps may be so by chance."""
    first = int(blocks[0, 0])
    stop = min(int(blocks[-1, 1]), first + LARGEST_PART)
    steps = np.diff(stamps[first : stop + 1]) * 1e-9
    steps = steps[~_jumps(steps, float(np.median(blocks[:, 2])))]
    # Losses that would pass for another rate move the mean by twice as much.
    return len(steps) >= BLOCK_SAMPLES and _is_even(steps, 0.5 * OTHER_PERIOD)


def _stretches(blocks: Floats, stamps: Integers | Values) -> tuple[OneRate, ...]:
    """Return the stretches of one rate each by blocks (b, 4); none where all have the same."""
    blocks = blocks[(blocks[:, 3] > 0.0) & (blocks[:, 1] - blocks[:, 0] >= LEAST_BLOCK)]
    runs = [
        run
        for run in np.split(blocks, 1 + np.flatnonzero(_differ(blocks[:-1, 2], blocks[1:, 2])))
        if len(run) >= LEAST_BLOCKS and _is_even_run(run, stamps)
    ]
    medians = np.array([float(np.median(run[:, 2])) for run in runs])
    order = np.argsort(medians)
    kinds = np.zeros(len(runs), int)
    kinds[order[1:]] = np.cumsum(_differ(medians[order[:-1]], medians[order[1:]]))
    if not kinds.any():
        return ()
    periods = [
        float(
            np.median(
                np.concatenate([r[:, 2] for r, k in zip(runs, kinds, strict=True) if k == kind])
            )
        )
        for kind in kinds
    ]
    borders, found = [0], [periods[0]]
    for (before, behind), (old, new) in zip(pairwise(runs), pairwise(periods), strict=True):
        if old != new:
            borders.append(_change(stamps, (int(before[-1, 0]), int(behind[0, 1])), old, new))
            found.append(new)
    spans = pairwise([*borders, len(stamps)])
    return tuple(OneRate(*span, period) for span, period in zip(spans, found, strict=True))


def _differ(some: Floats, others: Floats) -> Bools:
    """Tell which periods are not the same but for the drift of an oscillator."""
    return np.asarray(np.abs(np.log(some / others)) > np.log1p(OTHER_PERIOD))


def _change(stamps: Integers | Values, between: tuple[int, int], old: float, new: float) -> int:
    """Return the sample between two from which on the steps are those of the new period."""
    first, last = between
    steps = np.diff(stamps[first : min(last, first + LARGEST_PART) + 1]) * 1e-9
    gain = np.cumsum(np.abs(steps - new) - np.abs(steps - old))
    return first + 1 + int(np.argmax(gain))
