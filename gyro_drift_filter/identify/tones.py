"""Tones in the noise: a motor, the mains, a sensor's own clock."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage, signal

from gyro_drift_filter.identify.series import LARGEST_PART, Values

# Length of the periodograms that are averaged, and the least number of them.
_SEGMENT, _LEAST_SEGMENTS = 8192, 8
# The noise about a tone is the median of so many ordinates; a tone fills so many on each side of
# its own behind a Hann window.
_AROUND, _FILLED = 101, 2
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
    if length < 2 * _AROUND:
        return ()
    frequency, power = signal.welch(values, 1.0 / period, nperseg=length)
    noise = ndimage.median_filter(power, _AROUND, mode='nearest')
    limit = max(_LEAST_RATIO, 1.0 + _DEVIATIONS / math.sqrt(2 * len(values) / length - 1))
    # What lies below is drift, whose spectrum falls steeply.
    ratio = np.where(np.arange(len(power)) > _AROUND // 10, power / np.maximum(noise, 1e-300), 0.0)
    tones: list[Tone] = []
    while len(tones) < _MOST and ratio.max() > limit:
        top = int(np.argmax(ratio))
        near = slice(max(top - _FILLED, 0), top + _FILLED + 1)
        excess = np.maximum(power[near] - noise[near], 0.0)
        tones.append(
            Tone(
                float((frequency[near] * excess).sum() / excess.sum()),
                math.sqrt(2.0 * float(excess.sum()) * float(frequency[1])),
            )
        )
        ratio[max(top - 2 * _FILLED, 0) : top + 2 * _FILLED + 1] = 0.0
    return tuple(tones)
