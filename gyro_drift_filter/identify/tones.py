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

"""Tones in the noise: a motor, the mains, a sensor's own clock."""

import math
from bisect import bisect_left, insort
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify.series import LARGEST_PART, Values

# Length of the periodograms that are averaged, and the least number of them.
_SEGMENT, _LEAST_SEGMENTS = 8192, 8
# The noise about a tone is the larger of the medians from 1.2 to 1.5 times as far up and down, so
# that neither the edge of a low-pass nor drift, which fall to one side, is a tone.
_NEAR, _FAR = 1.2, 1.5
# A tone that wanders fills all ordinates about its top that are this many times the noise.
_FILLED = 2.0
# Drift lies below, and too few ordinates to take a median of.
_LOWEST = 30
# An average of k periodograms departs from the noise by a share of 1 / sqrt(k): by so many of these
# once in 1e9 ordinates. Beyond that a tone has to stand out to the eye.
_DEVIATIONS, _LEAST_RATIO = 7.0, 4.0
_MOST = 3


@dataclass(frozen=True)
class Tone:
    """A sine in the noise: frequency in Hz, amplitude in rad/s."""

    frequency: float
    amplitude: float


def find_tones(spans: Sequence[Values], period: float) -> tuple[Tone, ...]:
    """Return the strongest tones, the largest first.

    Args:
        spans: Each (n,) in rad/s without mean, at rest; the longest is searched.
        period: In s.
    """
    values = max(spans, key=len)[:LARGEST_PART]
    length = min(_SEGMENT, len(values) // _LEAST_SEGMENTS)
    if length < 4 * _LOWEST:
        return ()
    frequency, power = signal.welch(values, 1.0 / period, nperseg=length)
    limit = max(_LEAST_RATIO, 1.0 + _DEVIATIONS / math.sqrt(2 * len(values) / length - 1))
    noise = _noise_about(power)
    ratio = power / np.maximum(noise, 1e-300)
    tones: list[Tone] = []
    while len(tones) < _MOST and ratio.max() > limit:
        top = int(np.argmax(ratio))
        first, last = top, top
        while power[first - 1] > _FILLED * noise[top]:
            first -= 1
        while last + 1 < len(power) and power[last + 1] > _FILLED * noise[top]:
            last += 1
        # The nearest ones hold what the window spreads.
        near = slice(first - 2, last + 3)
        excess = np.maximum(power[near] - noise[top], 0.0)
        tones.append(
            Tone(
                float((frequency[near] * excess).sum() / excess.sum()),
                math.sqrt(2.0 * float(excess.sum()) * float(frequency[1])),
            )
        )
        ratio[near] = 0.0
    return tuple(tones)


def _noise_about(power: Floats) -> Floats:
    """Return the noise about each ordinate (m,), infinite below the lowest."""
    k: Floats = np.arange(_LOWEST, len(power), dtype=np.float64)
    below = _running_medians(power, k / _FAR, k / _NEAR)
    above = _running_medians(power, k * _NEAR, k * _FAR)
    return np.concatenate([np.full(_LOWEST, np.inf), np.maximum(below, above)])


def _running_medians(values: Floats, firsts: Floats, ends: Floats) -> Floats:
    """Return the medians of windows whose ends only go up; minus infinity of one that is empty."""
    # What stays in the window stays sorted: that is twenty times as fast as to sort each anew.
    rows, window = values.tolist(), list[float]()
    medians = np.full(len(firsts), -np.inf)
    left = right = round(firsts[0])
    for k, (first, end) in enumerate(zip(np.rint(firsts), np.rint(ends), strict=True)):
        for value in rows[right : int(end)]:
            insort(window, value)
        for value in rows[left : int(first)]:
            del window[bisect_left(window, value)]
        left, right = int(first), int(end)
        if window:
            medians[k] = 0.5 * (window[len(window) // 2] + window[(len(window) - 1) // 2])
    return medians
