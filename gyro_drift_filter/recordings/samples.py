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

"""The samples of one topic of a bag, unfiltered: in temporary files, as there may be many."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Integers
from gyro_drift_filter.bags.imu_arrays import ImuPart, imu_parts, usable
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.core.sample import LARGEST_ACCELERATION, LARGEST_RATE, SAMPLE
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.series import Stored, append_rows, stored_columns
from gyro_drift_filter.identify.timing import learn_timing
from gyro_drift_filter.phrases import counted, plain

# s: what is left of the time by which a clock was set forward, a gap to all who look for one.
_LEFT = 1.0
# Units differ by a power of 1000; lost messages and a clock that drifts change their ratio by less.
_UNIT_MARGIN = 0.02


@dataclass(frozen=True)
class StoredSamples:
    """The samples of one topic, n of them, in temporary files.

    Attributes:
        topic: Its name.
        refused: Messages that were malformed or did not report an angular velocity.
        stamps: (n,) in ns.
        log_times: (n,) in ns.
        rates: Three columns (n,) in rad/s; NaN where the filter would not use them.
        accelerations: Three columns (n,) in m/s^2; NaN likewise.
        beyond: Samples with a rate that is too large to be one.
        doubled: Messages that came once more, with the same stamp and rates, and are left out.
        clock: Where the time was taken from in place of stamps, in words; empty where stamps told.
    """

    topic: str
    refused: int
    stamps: Stored
    log_times: Stored
    rates: tuple[Stored, ...]
    accelerations: tuple[Stored, ...]
    beyond: int
    doubled: int
    clock: str

    def notes(self) -> list[str]:
        """Return in words what was not taken as it is."""
        notes = []
        if self.clock:
            notes.append(f'the stamps are zero: the time is that of {self.clock}')
        if self.beyond:
            notes.append(
                f'{counted(self.beyond, "sample")} with a rate beyond {LARGEST_RATE:.0f} rad/s, '
                'which no gyroscope measures and which counts as no number'
            )
        if self.doubled:
            notes.append(
                f'{counted(self.doubled, "message")} left out that came once more, with the same '
                'stamp and rates: is the topic published twice, or recorded twice?'
            )
        if self.refused:
            left_out = counted(self.refused, 'message')
            notes.append(f'{left_out} left out, as damaged or without an angular velocity')
        return notes

    def going_on(self) -> Callable[[Integers], Integers]:
        """Return what makes times in ns of the stamps' clock as if that was never set forward.

        How long it took to set it is not known: a gap stays in place of it. A single stamp of the
        future is no clock that was set, as the stamps come back.
        """
        stamps = self.stamps[:]
        later = np.minimum.accumulate(stamps[::-1])[::-1]
        middles, steps = [], [0]
        with suppress(IdentificationError):  # the stamps do not advance
            timing = learn_timing(stamps, self.log_times)
            for index, back in zip(timing.breaks, timing.set_back, strict=True):
                before, forward = int(stamps[index - 1]), int(-1e9 * (back + _LEFT))
                if forward > 0 and later[index] > before + forward // 2:
                    middles.append(before + forward // 2)
                    steps.append(forward)
        total = np.cumsum(steps)
        return lambda times: times - total[np.searchsorted(middles, times)]


def read_samples(
    bag: Path,
    topic: str | None,
    between: tuple[float, float],
    progress: Callable[[int, int], None],
    sample_rate: float | None = None,
) -> StoredSamples:
    """Read the samples of a bag.

    Args:
        bag: rosbag2 folder, bare .mcap or .db3 file, or .bag file of ROS 1.
        topic: Needed where there are several Imu topics.
        between: First and last time to be used, in s since the first message of the recording.
        progress: Called with the number of messages done and their total.
        sample_rate: In Hz, for messages whose stamps are zero; without it their log times count.

    Raises:
        BagError: The bag can't be read or holds no usable Imu message in that time, or the stamps
            are in another unit.
    """
    stamps, log_times, edges = Stored(np.int64), Stored(np.int64), []
    rates, accelerations = stored_columns(3), stored_columns(3)
    name, clock, refused, count, beyond, doubled = '', '', 0, 0, 0, 0
    last: Any = np.empty(0, SAMPLE)
    for whole in imu_parts(bag, topic, progress, between=between):
        part = _without_doubles(whole, last)
        last = whole.samples[-1:] if len(whole.samples) else last
        doubled += len(whole.samples) - len(part.samples)
        name, refused = part.topic, refused + part.refused
        if not len(part.samples):
            continue
        if not count and not part.samples['stamp'].any():
            clock = f'{sample_rate:g} Hz as named' if sample_rate else 'log times'
        times = _times(part, clock, sample_rate, count)
        edges += [(times[0], part.log_times[0]), (times[-1], part.log_times[-1])]
        count += len(times)
        stamps.append(times)
        log_times.append(part.log_times)
        rate, force = part.samples['angular_velocity'], part.samples['linear_acceleration']
        beyond += int((np.abs(rate) > LARGEST_RATE).any(axis=1).sum())
        append_rows(rates, usable(rate))
        append_rows(accelerations, usable(force, LARGEST_ACCELERATION))
    if not clock:
        _check_unit(*(1e-9 * float(np.ptp(times)) for times in zip(*edges, strict=True)))
    return StoredSamples(
        name, refused, stamps, log_times, rates, accelerations, beyond, doubled, clock
    )


def _without_doubles(part: ImuPart, last: Any) -> ImuPart:
    """Return a part without messages that came once more, as the filter leaves them out.

    `last` is the last sample before it, (1,) or (0,) of SAMPLE.
    """
    samples = np.concatenate([last, part.samples])
    stamps, rates = samples['stamp'], samples['angular_velocity']
    again = np.zeros(len(samples), np.bool_)
    again[1:] = (stamps[1:] != 0) & (stamps[1:] == stamps[:-1])
    again[1:] &= (rates[1:] == rates[:-1]).all(axis=1)
    new = ~again[len(last) :]
    return replace(part, samples=part.samples[new], log_times=part.log_times[new])


def _check_unit(stamped: float, logged: float) -> None:
    """Make sure that stamps, which last for so many s, are in the unit of the log times.

    A recording of a recording that is played slowly or fast has true stamps, but not a thousand
    times as long.

    Raises:
        BagError: They are not.
    """
    if stamped <= 0.0 or logged <= 0.0:
        return
    thousands = math.log(stamped / logged, 1000.0)
    if abs(thousands) > 0.5 and abs(thousands - round(thousands)) < _UNIT_MARGIN:
        raise BagError(
            f'the stamps last for {plain(stamped)} s and the log times for {plain(logged)} s: the '
            'driver fills sec and nanosec of the stamp with another unit; `gyro_drift doctor` '
            'examines it'
        )


def _times(part: ImuPart, clock: str, sample_rate: float | None, before: int) -> Integers:
    """Return the time of each sample in ns: stamps, or what takes their place."""
    if not clock:
        return np.asarray(part.samples['stamp'])
    if sample_rate is None:
        return part.log_times
    return np.round((before + np.arange(len(part.samples))) * 1e9 / sample_rate).astype(np.int64)
