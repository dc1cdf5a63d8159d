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

"""Whether stamps are those of samples taken at even steps, or of messages as they arrived."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.identify.series import LARGEST_PART, Values
from gyro_drift_filter.phrases import plain

# Even steps are drawn through so many stamps at once: few enough for the sensor's own clock to keep
# its pace, many enough to average what single stamps are off by.
_WINDOW = 200
_LEAST_WINDOW = 20
# In a millisecond a robot that turns with 1 rad/s turns by 0.06 deg, which a camera beside it can
# see. Of a fast sensor a quarter of the period mixes up which sample is which.
_JITTER_SECONDS, _JITTER_PERIODS = 1e-3, 0.25
# Delays have a least value and a tail: an exponential one has a skewness of 2, jitter about the
# time of the sample none. The mean over windows of 200 is known to some 0.1.
_SKEWED = 0.8
# A driver that empties a buffer stamps all but the first of its samples with nearly no step between
# them, or with none at all. Exponential delays of a third of the period give 2 % of so short steps.
_SHORT_STEP, _SHORT_SHARE = 0.25, 0.15


@dataclass(frozen=True)
class Evenness:
    """How stamps lie about even steps.

    Attributes:
        jitter: Their standard deviation from there in s, median over the windows.
        skewness: Of what they are off by: 0 symmetric, positive with a tail of late ones.
        short: Share of the steps that are below a quarter of the period, but not zero.
        shared: Share of the steps that are zero.
    """

    jitter: float
    skewness: float
    short: float
    shared: float


def measure_evenness(stamps: Values, period: float) -> Evenness | None:
    """Return how stamps (n,) in ns lie about even steps of about `period` s; None for too few."""
    deviations, skews, short, shared, steps_seen = [], [], 0, 0, 0
    for window in _windows(stamps):
        steps = np.diff(window) * 1e-9
        steps_seen += len(steps)
        shared += int((steps == 0.0).sum())
        short += int(((steps > 0.0) & (steps < _SHORT_STEP * period)).sum())
        if len(window) < _LEAST_WINDOW:
            continue
        # Where samples are missing steps are of several periods, where messages are late not.
        counted = np.maximum(np.round(steps / period), 1.0)
        off = min(
            (_about_line(steps, counts) for counts in (counted, np.ones(len(steps)))),
            key=np.std,
        )
        deviations.append(float(np.std(off)))
        if deviations[-1] > 0.0:
            skews.append(float(np.mean(off**3)) / deviations[-1] ** 3)
    if not deviations:
        return None
    skewness = float(np.mean(skews)) if skews else 0.0
    return Evenness(float(np.median(deviations)), skewness, short / steps_seen, shared / steps_seen)


def judge_evenness(stamps: Values, period: float) -> Finding:
    """Say whether stamps (n,) in ns of samples every `period` s are even."""
    found = measure_evenness(stamps, period)
    if found is None:
        return unknown('stamp times', 'too few samples to tell how stamps lie')
    values = {
        'jitter_seconds': found.jitter,
        'skewness': found.skewness,
        'share_of_short_steps': found.short,
        'share_of_shared_stamps': found.shared,
    }
    milliseconds = f'{plain(1e3 * found.jitter, 2)} ms'
    if found.short > _SHORT_SHARE:
        return fault(
            'bursts',
            f'messages come in bursts: {100.0 * found.short:.0f} % of the steps between stamps are '
            f'below a quarter of the {plain(1e3 * period)} ms between samples',
            'the driver empties a buffer and stamps on arrival: have it count back from the newest '
            'sample, one period each. Do not integrate by these stamps',
            values,
        )
    if found.shared > _SHORT_SHARE:
        return fault(
            'shared stamps',
            f'{100.0 * found.shared:.3g} % of the messages have the stamp of the message before',
            'the driver stamps a whole buffer at once, or by a clock of coarse steps: have it give '
            'each sample its own time, one period apart. Do not integrate by these stamps',
            values,
        )
    if found.jitter <= min(_JITTER_SECONDS, _JITTER_PERIODS * period):
        return sound(
            'stamp times',
            f'stamps are even to {plain(max(1e3 * found.jitter, 0.001), 2)} ms',
            values,
        )
    if found.skewness > _SKEWED:
        return fault(
            'arrival stamps',
            f'stamps are those of arrival, not of the samples: late by a delay that varies by '
            f'{milliseconds}',
            "stamp on the sensor's data-ready signal or by its own clock; else a fusion with "
            'cameras or wheels sees turns late',
            values,
        )
    return fault(
        'jitter',
        f'stamps jitter by {milliseconds} (standard deviation) about even steps of '
        f'{1e3 * period:.4g} ms',
        "stamp on the sensor's data-ready signal, not by a timer of the driver",
        values,
    )


def _windows(stamps: Values) -> Iterator[Integers]:
    """Yield the stamps in stretches of a window, each beginning with the last one of before."""
    largest = LARGEST_PART // _WINDOW * _WINDOW
    for first in range(0, len(stamps), largest):
        part = np.asarray(stamps[first : first + largest + 1], np.int64)
        for k in range(0, len(part) - 1, _WINDOW):
            yield part[k : k + _WINDOW + 1]


def _about_line(steps: Floats, counts: Floats) -> Floats:
    """Return by how much stamps are off the line through them, with so many periods a step."""
    seconds = np.concatenate([[0.0], np.cumsum(steps)])
    places = np.concatenate([[0.0], np.cumsum(counts)])
    seconds, places = seconds - seconds.mean(), places - places.mean()
    slope = float(places @ seconds) / float(places @ places)
    return np.asarray(seconds - slope * places)
