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

"""Figures of a calibration as PNG files; needs matplotlib."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from gyro_drift_filter.calibrate.calibration import Samples
from gyro_drift_filter.calibrate.results import Calibration
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.whole_file import draw_whole

_COLOURS = '#d1722b', '#2a8a57', '#1f5fa8'
_BEFORE, _AFTER = '#8a94a6', '#1f5fa8'


def draw(folder: Path, result: Calibration, recordings: Sequence[Samples]) -> list[Path]:
    """Draw the rates with the turns shaded, and how they close; return the files written.

    Files of the same names in the folder, which is made if it is missing, are replaced.
    """
    drawn = {'turns.png': _turns(result, recordings), 'closures.png': _closures(result)}
    for name, figure in drawn.items():
        draw_whole(folder / name, figure)
    return [folder / name for name in drawn]


def _turns(result: Calibration, recordings: Sequence[Samples]) -> Figure:
    """Return the raw rates of each recording, with the turns shaded."""
    figure = Figure(figsize=(9, 3.5 * len(recordings)), layout='constrained')
    panels = figure.subplots(len(recordings), 1, squeeze=False)
    for number, (panel, samples) in enumerate(zip(panels[:, 0], recordings, strict=True)):
        seconds = (samples.stamps - samples.stamps[0]) * 1e-9
        for axis, (name, colour) in enumerate(zip(AXES, _COLOURS, strict=True)):
            rate = np.degrees(samples.rates[:, axis])
            panel.plot(seconds, rate, linewidth=0.5, color=colour, label=name)
        for _, begin, length in result.legs[result.legs[:, 0] == number]:
            panel.axvspan(begin, begin + length, color=_BEFORE, alpha=0.2, linewidth=0)
        panel.set_xlabel('time (s)')
        panel.set_ylabel('raw rate (deg/s)')
        panel.legend(loc='best', fontsize=8)
    figure.suptitle('Turns, shaded, between rests')
    return figure


def _closures(result: Calibration) -> Figure:
    """Return by how much each turn misses gravity, before and after."""
    figure = Figure(figsize=(9, 4), layout='constrained')
    closures = figure.subplots()
    place = np.arange(len(result.legs))
    for closed, colour, label, shift in (
        (result.before, _BEFORE, 'before', -0.2),
        (result.after, _AFTER, 'after', 0.2),
    ):
        angles = np.maximum(np.degrees(closed.angles), 1e-3)
        closures.bar(place + shift, angles, 0.4, color=colour, label=label)
    closures.set_yscale('log')
    closures.set_xlabel('turn')
    closures.set_ylabel('gravity missed by (deg)')
    closures.legend()
    closures.grid(alpha=0.3, axis='y')
    figure.suptitle('How the turns close')
    return figure
