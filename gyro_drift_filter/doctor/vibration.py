"""Vibration: lines in the spectrum of the whole recording, at rest and in motion."""

import math

import numpy as np
from scipy import signal

from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.findings import Finding, Verdict
from gyro_drift_filter.identify.series import LARGEST_PART, Values
from gyro_drift_filter.identify.tones import Tone, find_tones

# Neither hands nor legs move faster, in Hz: what is above is vibration or noise.
_FASTEST_MOTION = 20.0
# Of half the sample rate: the band has to hold some of what is above.
_LARGEST_CUT = 0.6


def judge_vibration(rates: tuple[Values, ...], period: float) -> Finding:
    """Say at which frequencies the rates, three columns (n,) in rad/s, vibrate.

    A line is a fault where it is as strong as all other noise above the frequencies of motion: it
    then is what the rates show at rest, and shifts the bias by its rectification in the sensor.
    """
    name, nyquist = 'vibration', 0.5 / period
    if _LARGEST_CUT * nyquist < _FASTEST_MOTION:
        return Finding(
            name,
            Verdict.UNKNOWN,
            f'{1.0 / period:.3g} Hz are too few to tell vibration from motion',
        )
    sections = signal.butter(4, _FASTEST_MOTION, 'highpass', fs=1.0 / period, output='sos')
    lines: list[tuple[Tone, str, float]] = []
    for axis, column in zip(AXES, rates, strict=True):
        values = np.nan_to_num(np.asarray(column[:LARGEST_PART], float))
        fast = signal.sosfilt(sections, values - values[0])
        power = float(np.mean(fast**2))
        for tone in find_tones([fast], period):
            if tone.frequency < _FASTEST_MOTION:  # on the edge of the high-pass
                continue
            other = math.sqrt(max(power - 0.5 * tone.amplitude**2, 0.0))
            lines.append((tone, axis, tone.amplitude / max(math.sqrt(2.0) * other, 1e-12)))
    lines.sort(key=lambda line: -line[0].amplitude)
    values_of = {
        'lines': [
            {'axis': axis, 'frequency': tone.frequency, 'amplitude': tone.amplitude}
            for tone, axis, _ in lines
        ]
    }
    strong = [(tone, axis) for tone, axis, ratio in lines if ratio > 1.0]
    listed = _listed(strong or [(tone, axis) for tone, axis, _ in lines])
    if strong:
        return Finding(
            name,
            Verdict.FAULT,
            f'the rates vibrate: {listed}',
            f'a motor, fan or loose mount at that frequency, or at one folded about '
            f'{nyquist:.4g} Hz: damp the mount, and switch a low-pass of the sensor on above the '
            'motion',
            dict(values_of),
        )
    text = f'no line above the noise from {_FASTEST_MOTION:.0f} to {nyquist:.4g} Hz'
    if lines:
        text += f' (weak ones: {listed})'
    return Finding(name, Verdict.SOUND, text, values=dict(values_of))


def _listed(lines: list[tuple[Tone, str]]) -> str:
    """Return the strongest lines in words."""
    return ', '.join(
        f'{axis} at {tone.frequency:.1f} Hz with {math.degrees(tone.amplitude):.2g} deg/s'
        for tone, axis in lines[:3]
    )
