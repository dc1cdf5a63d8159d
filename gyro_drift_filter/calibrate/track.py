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

"""A recording of turns by hand as samples in time: where it is broken by a gap or a clipped rate.

Stamps may be those of arrival, and the clock may have been set back. Unlike `identify/timing.py`,
which takes samples to be evenly spaced, this keeps the time of each one, as turns are sums over it.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.phrases import without_rate

LEAST_SAMPLES = 10  # fewer hold no rest
GAP_PERIODS = 5
# So many messages in a row behind one that goes back show whether the clock was set back.
FOLLOWING = 5
# Stamps of which more steps than this share are off by half a period are those of arrival.
UNEVEN = 0.05
LONGEST_BURST = 0.6  # s, that a driver or the network holds messages back
# No gyroscope is read out more often, in Hz.
FASTEST_SENSOR = 32_000
# So many equal values in a row at the largest rate of an axis are the end of its range.
PLATEAU = 5


@dataclass(frozen=True)
class Track:
    """A recording: n samples, all finite.

    Attributes:
        start: Stamp of its first sample in ns.
        seconds: (n,) since then.
        rates: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2, or None where there is no accelerometer.
        broken: (n - 1,) True where between two samples there is a gap, or the range has ended.
        clipped: (n - 1,) True where it is for the range.
        even: Whether the time is that of evenly spaced samples, in place of stamps of arrival.
        period: From one sample to the next in s, gaps apart.
        set_back: When the clock of the stamps was set back, in s since the start, and by how many
            s. The seconds go on there, and the samples before and behind are broken apart.
    """

    start: int
    seconds: Floats
    rates: Floats
    accelerations: Floats | None
    broken: Bools
    clipped: Bools
    even: bool
    period: float
    set_back: tuple[tuple[float, float], ...]


def make_track(stamps: Integers, rates: Floats, accelerations: Floats) -> Track:
    """Return a track of samples (n,), (n, 3) and (n, 3); stamps in ns, NaN where unknown.

    Raises:
        CalibrationError: There are too few samples, or their stamps do not advance.
    """
    measured = np.isfinite(accelerations).all(axis=1)
    alive = np.mean(measured) > 0.5 and np.ptp(accelerations[measured], axis=0).any()
    used = np.isfinite(rates).all(axis=1) & (measured | (not alive))
    begins = _where_set_back(stamps, rates)
    seconds, stretches = _going_on(stamps, begins)
    # What is repeated or late is left out: its time is not beyond all before it.
    advancing = np.concatenate([[True], seconds[1:] > np.maximum.accumulate(seconds)[:-1]])
    used &= advancing
    if used.sum() < LEAST_SAMPLES:
        why = _why_so_few(rates) if len(stamps) >= LEAST_SAMPLES else ''
        raise CalibrationError(f'only {used.sum()} of {len(stamps)} samples can be used{why}')
    # Samples without a rate tell of the stamps as well: without them, these would seem uneven.
    even = _are_of_arrival(seconds[advancing])
    since, stretches = (seconds - seconds[used][0])[advancing], stretches[advancing]
    longest = LONGEST_BURST
    if even:
        since = _evenly(since, stretches)
    since, stretches = since[used[advancing]], stretches[used[advancing]]
    if not even:
        longest = GAP_PERIODS * float(np.median(np.diff(since)))
    gaps = (np.diff(since) > longest) | (np.diff(stretches) > 0)
    period = float(np.median(np.diff(since)))
    at_end = _at_the_end_of_the_range(rates[used])
    clipped = at_end[1:] | at_end[:-1]
    return Track(
        start=int(stamps[used][0]),
        seconds=since,
        rates=rates[used],
        accelerations=accelerations[used] if alive else None,
        broken=gaps | clipped,
        clipped=clipped,
        even=even,
        period=period,
        set_back=tuple(
            (float(seconds[k] - seconds[used][0]), float(stamps[k - 1] - stamps[k]) * 1e-9 + period)
            for k in begins
        ),
    )


def _where_set_back(stamps: Integers, rates: Floats) -> list[int]:
    """Return the first samples after the clock of the stamps (n,) was set back.

    Where stamps go back, those that follow tell why:

    - a message was late, or came twice: the next one goes on;
    - stamps are uneven by many periods: those that follow are in no order;
    - messages were held back together: they lie in the past by no more than a burst lasts, and fill
      a time that was empty, as a sensor does not measure twice at a time;
    - the clock was set back: they lie in the past and in order, by more than a burst lasts, or in a
      time that was measured already.
    """
    found: list[int] = []
    fresh = np.flatnonzero(~_are_repeated(stamps, rates))
    times = stamps[fresh]
    begin = checked = newest = 0
    for k in (np.flatnonzero(np.diff(times) < 0) + 1).tolist():
        latest = int(times[checked:k].max())
        newest = latest if checked == begin else max(newest, latest)
        checked = k
        late = times[k : k + FOLLOWING + 1]
        if len(late) <= FOLLOWING or (late > newest).any() or (np.diff(late) < 0).any():
            continue
        earlier = times[max(begin, k - round(LONGEST_BURST * FASTEST_SENSOR)) : k]
        again = (earlier >= late.min()) & (earlier <= late.max())
        if newest - late[0] > LONGEST_BURST * 1e9 or again.sum() >= 0.5 * len(late):
            found.append(int(fresh[k]))
            begin = checked = k
    return found


def _are_repeated(stamps: Integers, rates: Floats) -> Bools:
    """Tell which samples (n,) have stamp and rates of an earlier one, or the stamp before."""
    order = np.argsort(stamps, kind='stable')
    same = np.diff(stamps[order]) == 0
    same &= (np.diff(rates[order], axis=0) == 0.0).all(axis=1)
    repeated = np.zeros(len(stamps), bool)
    repeated[order[1:]] = same
    repeated[1:] |= np.diff(stamps) == 0
    return repeated


def _going_on(stamps: Integers, begins: list[int]) -> tuple[Floats, Integers]:
    """Return the time in s since the first of stamps (n,), and how often it was set back (n,).

    How long it took to set the clock back is not known: it counts as no time.
    """
    back, count = np.zeros(len(stamps), np.int64), np.zeros(len(stamps), np.int64)
    for begin in begins:
        back[begin:] = (stamps[:begin] + back[:begin]).max() + 1 - stamps[begin]
        count[begin:] += 1
    return np.asarray((stamps + back - stamps[:1]) * 1e-9, float), count


def _why_so_few(rates: Floats) -> str:
    """Return in words why hardly a sample can be used."""
    known = np.isfinite(rates)
    if known.all(axis=1).sum() >= LEAST_SAMPLES:
        return ': are the stamps zero?'
    why = without_rate([bool(axis.any()) for axis in known.T], LARGEST_RATE)
    return f': {why or "hardly a sample has a rate on all axes"}'


def _are_of_arrival(seconds: Floats) -> bool:
    """Tell whether stamps (n,) in s that advance are those of arrival."""
    steps = np.diff(seconds)
    period = float(np.median(steps))
    return bool(np.mean(np.abs(steps - period) > 0.5 * period) > UNEVEN)


def _evenly(seconds: Floats, stretches: Integers) -> Floats:
    """Return evenly spaced times between gaps, and where the clock was set back."""
    gaps = (np.diff(seconds) > LONGEST_BURST) | (np.diff(stretches) > 0)
    out = seconds.copy()
    edges = [0, *(np.flatnonzero(gaps) + 1).tolist(), len(seconds)]
    for first, stop in pairwise(edges):
        out[first:stop] = np.linspace(seconds[first], seconds[stop - 1], stop - first)
    return out


def _at_the_end_of_the_range(rates: Floats) -> Bools:
    """Tell which samples (n,) lie on a plateau of the largest rate of an axis."""
    clipped = np.zeros(len(rates), bool)
    for axis in rates.T:
        for end in (axis.max(), axis.min()):
            run = axis == end
            long = np.convolve(run, np.ones(PLATEAU), 'valid') > PLATEAU - 0.5
            for k in range(PLATEAU):
                clipped[k : len(long) + k] |= long & (abs(end) > 0.5)
    return clipped
