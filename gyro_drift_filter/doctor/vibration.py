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

"""Vibration: lines in the spectrum of the whole recording, at rest and in motion."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy import signal

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.identify.preprocess import bridged
from gyro_drift_filter.identify.series import Values, parts
from gyro_drift_filter.identify.tones import find_tones
from gyro_drift_filter.phrases import plain

# Neither hands nor legs move faster, in Hz: what is above is vibration or noise.
_FASTEST_MOTION = 20.0
# Of half the sample rate: the band has to hold some of what is above.
_LARGEST_CUT = 0.6
# Spectra of a second or two are averaged; fewer of them in s tell no line.
_SHORTEST = 15.0
# A motor keeps its speed, as a share of it.
_SAME_FREQUENCY = 0.02


@dataclass(frozen=True)
class Line:
    """A line in the spectrum: frequency in Hz, amplitude in rad/s, and whether it is a fault."""

    axis: str
    frequency: float
    amplitude: float
    strong: bool


def judge_vibration(rates: tuple[Values, ...], period: float) -> Finding:
    """Say at which frequencies the rates, three columns (n,) in rad/s, vibrate.

    A line is a fault where it is as strong as all other noise above the frequencies of motion: the
    rates at rest then show little else, and the sensor rectifies it, which shifts the bias.
    """
    name, nyquist = 'vibration', 0.5 / period
    if len(rates[0]) * period < _SHORTEST:
        return unknown(name, 'too short to tell lines from noise')
    if _LARGEST_CUT * nyquist < _FASTEST_MOTION:
        return unknown(name, f'{1.0 / period:.3g} Hz are too few to tell vibration from motion')
    sections = signal.butter(4, _FASTEST_MOTION, 'highpass', fs=1.0 / period, output='sos')
    found = [
        line
        for axis, column in zip(AXES, rates, strict=True)
        for part in parts(column)
        for line in _lines(axis, _filled(np.asarray(part, float)), sections, period)
    ]
    found.sort(key=lambda line: -line.amplitude)
    lines: list[Line] = []
    for line in found:
        if not any(_are_one(line, other) for other in lines):
            lines.append(line)
    strong = [line for line in lines if line.strong]
    if strong:
        return fault(
            name,
            f'the rates vibrate: {_listed(strong)}',
            'look for a motor, a fan or a loose mount of that frequency, or of one above '
            f'{nyquist:.4g} Hz that is folded down to it: damp the mount, and let the sensor '
            'low-pass above the motion',
            {'lines': lines},
        )
    text = f'no line above the noise from {_FASTEST_MOTION:.0f} to {nyquist:.4g} Hz'
    if lines:
        text += f' (weak ones: {_listed(lines)})'
    return sound(name, text, values={'lines': lines})


def _lines(axis: str, values: Floats, sections: Floats, period: float) -> Iterator[Line]:
    """Yield the lines of a part of the rates (n,) of an axis, in rad/s, above the motion."""
    fast = signal.sosfilt(sections, values - values[0])
    power = float(np.mean(fast**2))
    for tone in find_tones([fast], period):
        if tone.frequency > _FASTEST_MOTION:  # not on the edge of the high-pass
            is_strong = tone.amplitude**2 > power  # its own power is half of that
            yield Line(axis, tone.frequency, tone.amplitude, is_strong)


def _are_one(line: Line, other: Line) -> bool:
    """Return whether two lines, of two parts of the recording, are of the same vibration."""
    near = abs(line.frequency - other.frequency) < _SAME_FREQUENCY * other.frequency
    return line.axis == other.axis and near


def _filled(values: Floats) -> Floats:
    """Return values (n,) with lines drawn over those that are NaN."""
    good = np.isfinite(values)
    return bridged(values, good) if good.any() else np.zeros(len(values))


def _listed(lines: list[Line]) -> str:
    """Return the strongest lines in words."""
    return ', '.join(
        f'{line.axis} at {line.frequency:.1f} Hz with '
        f'{plain(math.degrees(line.amplitude), 2)} deg/s'
        for line in lines[:3]
    )
