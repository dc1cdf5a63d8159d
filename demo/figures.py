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

"""The heading with and without the filter; the paper's figures 2 and 3, axis x."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.simulation.drive import Drive
from gyro_drift_filter.simulation.experiments import Simulation

Rates = Mapping[str, Floats]
# In the order of METHOD_NAMES, the last ones for methods to come; matplotlib chooses any further.
_OF_METHODS = ('#d1722b', '#1f5fa8', '#2a8a57', '#8a4fb0', '#b03a48')
_COLOURS = {'raw': '#b8c0cc', **dict(zip(METHOD_NAMES, _OF_METHODS, strict=False))}


def draw_heading(path: Path, drive: Drive, turned: Rates) -> None:
    """Draw the rate about the vertical, and below it by how much the heading is off, in deg."""
    recording = drive.recording
    time = _seconds(recording)
    figure = Figure(figsize=(9, 5.5), layout='constrained')
    above, below = figure.subplots(2, 1, sharex=True)
    above.plot(time, recording.angular_velocity[:, 2], linewidth=0.6, color=_COLOURS['raw'])
    above.plot(time, drive.rates[:, 2], 'k--', linewidth=0.8)
    above.set_ylabel('rate about z (rad/s)')
    above.set_title('measured, and the true rate (dashed)', fontsize=10, loc='left')
    for name, error in turned.items():
        below.plot(
            time, error, color=_COLOURS.get(name), label=f'{name}: {error[-1]:.2f} at the end'
        )
    below.set_ylabel('heading off by (deg)')
    below.set_xlabel('time (s)')
    below.legend(fontsize=9)
    figure.suptitle('A robot that drives and stands: the heading with and without the filter')
    figure.savefig(path, dpi=110)


def draw_static(path: Path, simulation: Simulation, rates: Rates) -> None:
    """Draw figure 2: the motionless part before and after each filter, one panel each."""
    time, still = _seconds(simulation), ~simulation.moving
    figure = Figure(figsize=(9, 6.5), layout='constrained')
    panels = figure.subplots(len(rates), 1, sharex=True, sharey=True)
    for panel, (name, rate) in zip(panels, rates.items(), strict=True):
        panel.plot(time[still], rate[still, 0], linewidth=0.6, color=_COLOURS.get(name))
        panel.axhline(simulation.bias[0], color='black', linewidth=0.8, linestyle='--')
        panel.set_title(
            f'{name}: std {rate[still, 0].std():.5f} rad/s, mean {rate[still, 0].mean():.5f} rad/s',
            fontsize=10,
            loc='left',
        )
        panel.set_ylabel('rad/s')
    panels[-1].set_xlabel('time (s)')
    figure.suptitle('Static experiment, axis x (dashed: the bias, which stays)')
    figure.savefig(path, dpi=110)


def draw_dynamic(path: Path, simulation: Simulation, rates: Rates) -> None:
    """Draw figure 3: the sinusoid with outliers before and after, then the error of each filter."""
    time, moving = _seconds(simulation)[simulation.moving], simulation.moving
    truth = simulation.truth[moving, 0]
    filtered = {name: rate for name, rate in rates.items() if name != 'raw'}
    figure = Figure(figsize=(9, 7), layout='constrained')
    above, *below = figure.subplots(1 + len(filtered), 1, sharex=True)
    for name, rate in rates.items():
        colour = _COLOURS.get(name)
        above.plot(time, rate[moving, 0], linewidth=0.8, color=colour, label=name)
    above.plot(time, truth, 'k--', linewidth=0.8, label='truth and bias')
    limit = 4 * np.abs(truth).max()
    above.set_ylim(-limit, limit)
    above.set_ylabel('rate (rad/s)')
    figure.legend(loc='outside lower center', ncols=5, fontsize=9)
    for panel, (name, rate) in zip(below, filtered.items(), strict=True):
        error = rate[moving, 0] - truth
        panel.plot(time, error, linewidth=0.8, color=_COLOURS.get(name))
        panel.set_ylim(-limit / 2, limit / 2)
        panel.set_ylabel('error (rad/s)')
        panel.set_title(f'{name}: rms error {np.sqrt((error**2).mean()):.5f} rad/s', loc='left')
    below[-1].set_xlabel('time (s)')
    figure.suptitle('Dynamic experiment, axis x: raw outliers reach beyond the frame')
    figure.savefig(path, dpi=110)


def _seconds(simulation: Simulation) -> Floats:
    return np.asarray((simulation.stamps - simulation.stamps[0]) * 1e-9)
