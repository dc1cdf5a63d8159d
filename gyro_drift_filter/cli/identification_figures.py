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

"""Figures of an identification as PNG files; needs matplotlib."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from statsmodels.tsa.arima_process import ArmaProcess
from statsmodels.tsa.stattools import acf

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.identify.allan import BIAS_INSTABILITY, Coefficient
from gyro_drift_filter.identify.identification import AxisModel, DeadAxis, Identification
from gyro_drift_filter.identify.series import LARGEST_PART, Stored, all_parts
from gyro_drift_filter.identify.spectrum import spectrum
from gyro_drift_filter.identify.timing import Timing
from gyro_drift_filter.whole_file import draw_whole

_RAW, _MODEL, _CHOSEN, _REST = '#8a94a6', '#d1722b', '#1f5fa8', '#2a8a57'
_INSTABILITY = '#8d3c7f'
_LAGS = 40
# A recording is drawn with the least and largest of so many parts, which look like all of them.
_DRAWN = 4000
# As `identify` leaves out a second or two at a knock, a motionless recording may lack some.
_MOTIONLESS = 0.97


def draw(
    folder: Path,
    result: Identification,
    stamps: Stored,
    rates: Sequence[Stored],
) -> list[Path]:
    """Draw a recording, its Allan deviation, autocorrelation and spectrum; return the files.

    Files of the same names in the folder, which is made if it is missing, are replaced. Stamps
    are (n,) in ns, rates three columns (n,) in rad/s.
    """
    period = result.timing.period
    motionless = sum(map(len, result.quiet.spans)) > _MOTIONLESS * len(stamps)
    title = 'Static output (figure 1 of the paper)' if motionless else 'Recording, rests shaded'

    def recording(panel: Axes, axis: AxisModel, index: int) -> None:
        _recording(panel, axis, *_envelope(result.timing, stamps, rates[index]), result)

    drawn: tuple[tuple[str, str, Callable[[Axes, AxisModel, int], None], str], ...] = (
        ('recording', title, recording, 'time (s)'),
        ('allan', 'Overlapping Allan deviation', _allan, 'averaging time tau (s)'),
        ('autocorrelation', 'Autocorrelation at rest', _autocorrelation, 'lag (samples)'),
        (
            'spectrum',
            'Power spectral density at rest',
            lambda panel, axis, _: _spectrum(panel, axis, period),
            'frequency (Hz)',
        ),
    )
    written = []
    for name, title, draw_panel, label in drawn:
        figure = Figure(figsize=(9, 8.5), layout='constrained')
        panels = figure.subplots(3, 1, sharex=True)
        for index, (panel, axis) in enumerate(zip(panels, result.axes, strict=True)):
            panel.set_title(f'axis {AXES[index]}', fontsize=10, loc='left')
            if isinstance(axis, DeadAxis):
                what = f'dead: {np.degrees(axis.value):.6g} deg/s throughout'
                panel.text(0.5, 0.5, what, ha='center', transform=panel.transAxes)
                continue
            draw_panel(panel, axis, index)
            panel.grid(alpha=0.3)
            panel.legend(loc='best', fontsize=8)
        panels[-1].set_xlabel(label)
        figure.suptitle(title)
        path = folder / f'{name}.png'
        draw_whole(path, figure)
        written.append(path)
    return written


def _envelope(timing: Timing, stamps: Stored, rate: Stored) -> tuple[Floats, Floats]:
    """Return times in s and rates in deg/s, the least and largest of `_DRAWN` parts."""
    size = max(1, len(stamps) // _DRAWN)
    times, values = [], []
    for k in range(0, len(stamps), size):
        part = rate[k : k + size]
        some = part[np.isfinite(part)]
        if len(some):
            times += 2 * [timing.seconds_at(stamps, k)]
            values += [some.min(), some.max()]
    return np.array(times), np.degrees(values)


def _recording(
    panel: Axes,
    axis: AxisModel,
    seconds: Floats,
    rate: Floats,
    result: Identification,
) -> None:
    panel.plot(seconds, rate, linewidth=0.4, color=_RAW, label='raw')
    for begin, end in zip(result.begins, result.ends, strict=True):
        panel.axvspan(begin, end, color=_REST, alpha=0.12, linewidth=0)
    bias = float(np.degrees(axis.preprocessed.bias))
    panel.axhline(bias, color=_MODEL, linewidth=1.0, label='bias')
    # The rests are the subject: motion may leave the frame.
    reach = 1.2 * max(
        float(np.abs(np.degrees(part) - bias).max())
        for part in all_parts(axis.preprocessed.cleaned)
    )
    panel.set_ylim(bias - reach, bias + reach)
    panel.set_ylabel('deg/s')


def _allan(panel: Axes, axis: AxisModel, _: int) -> None:
    allan = axis.allan
    panel.loglog(
        allan.taus, 3600 * np.degrees(allan.deviations), '.-', color=_CHOSEN, label='measured'
    )
    lines: tuple[tuple[str, Coefficient | None, float, str], ...] = (
        ('angle random walk', allan.angle_random_walk, -0.5, 'deg/sqrt(h)'),
        ('rate random walk', allan.rate_random_walk, 0.5, 'deg/h/sqrt(h)'),
    )
    for (label, reading, slope, unit), colour in zip(lines, (_MODEL, _REST), strict=True):
        if reading is None:
            continue
        taus = np.array([reading.shortest, reading.longest])
        # K is defined at tau = 3 s, N at 1 s.
        value = reading.value * (taus if slope < 0 else taus / 3.0) ** slope
        shown = np.degrees(reading.value) * (60.0 if slope < 0 else 3600.0 * 60.0)
        panel.plot(
            taus,
            3600 * np.degrees(value),
            color=colour,
            linewidth=3,
            label=f'{label}, {shown:.3g} {unit}',
        )
    instability = allan.bias_instability
    size = 3600 * np.degrees(instability.value)
    bound = 'at most ' if allan.still_falls else ''
    panel.axhline(
        BIAS_INSTABILITY * size,
        color=_INSTABILITY,
        linestyle='--',
        linewidth=1,
        label=f'0.664 bias instability, which is {bound}{size:.3g} deg/h',
    )
    panel.plot(instability.shortest, BIAS_INSTABILITY * size, 'o', color=_INSTABILITY)
    panel.set_ylabel('deg/h')


def _autocorrelation(panel: Axes, axis: AxisModel, _: int) -> None:
    piece = max(axis.preprocessed.residuals, key=len)[:LARGEST_PART]
    lags = np.arange(1, _LAGS + 1)
    measured = np.asarray(acf(piece, nlags=_LAGS, fft=True))[1:]
    limit = 1.96 / np.sqrt(len(piece))
    panel.axhspan(-limit, limit, color=_RAW, alpha=0.3, linewidth=0, label='95 % of white noise')
    panel.vlines(lags, 0.0, measured, color=_RAW)
    panel.plot(lags, measured, '.', color=_CHOSEN, label='measured')
    drift = ArmaProcess([1.0, -axis.phi], [1.0]).acf(_LAGS + 1)[1:]
    panel.plot(lags, drift, color=_MODEL, linewidth=1, label='AR(1) of the filters')
    if axis.chosen.order not in ((0, 0), (1, 0)):
        chosen = ArmaProcess(np.r_[1.0, -axis.chosen.phi], np.r_[1.0, -axis.chosen.theta])
        panel.plot(lags, chosen.acf(_LAGS + 1)[1:], '--', color=_REST, linewidth=1, label='chosen')
    panel.set_ylabel('correlation')


def _spectrum(panel: Axes, axis: AxisModel, period: float) -> None:
    data = spectrum(axis.preprocessed.residuals)
    frequency = data.frequency / (2.0 * np.pi * period)
    # One-sided, (deg/s)^2 per Hz.
    scale = 2.0 * period * np.degrees(1.0) ** 2
    panel.loglog(frequency, scale * data.power, color=_RAW, linewidth=0.7, label='measured')
    drift = next(fitted for fitted in axis.fits if fitted.order == (1, 0))
    for label, fitted, colour in (
        ('chosen model', axis.chosen, _REST),
        ('AR(1) of the filters', drift, _MODEL),
    ):
        panel.plot(frequency, scale * fitted.density(data.frequency), color=colour, label=label)
    for tone in axis.tones:
        panel.axvline(
            tone.frequency,
            color=_INSTABILITY,
            linestyle=':',
            label=f'tone of {np.degrees(tone.amplitude):.3g} deg/s at {tone.frequency:.4g} Hz',
        )
    panel.set_ylabel('(deg/s)^2/Hz')
