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

"""The figures as PNG files, for papers and pull requests; needs matplotlib."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Drawn

from gyro_drift_filter.report.figures import Figure, Trace
from gyro_drift_filter.report.page import DrawnRecording
from gyro_drift_filter.whole_file import draw_whole

# The palette of Okabe and Ito, which the colour-blind can tell apart.
_COLOURS = {
    'raw': '#9a9a9a',
    'recorded': '#56b4e9',
    'outlier': '#d55e00',
    'q': '#d55e00',
    'r': '#0072b2',
    'band': '#0072b2',
    'deviation': '#0072b2',
    'expected': '#1a1a1a',
}
METHOD_COLOURS = ('#0072b2', '#cc79a7', '#e69f00', '#6a51a3')
_REST = '#009e73'


def draw(folder: Path, recording: DrawnRecording) -> None:
    """Draw each figure; files of the same names in the folder, made if missing, are replaced."""
    methods = enumerate(recording.verdicts)
    colours = _COLOURS | {m: METHOD_COLOURS[k % len(METHOD_COLOURS)] for k, m in methods}
    names = recording.roles | {
        'q': 'Q',
        'r': 'R',
        'expected': 'normal',
        'band': 'band',
        'deviation': '+-',
    }
    for figure in recording.figures:
        draw_whole(folder / f'{figure.name}.png', _drawn(figure, recording.rests, colours, names))


def _drawn(
    figure: Figure,
    rests: Sequence[tuple[float, float]],
    colours: Mapping[str, str],
    names: Mapping[str, str],
) -> Drawn:
    """Return a figure as matplotlib has it; colours and names are by role."""
    drawn = Drawn(figsize=(9, 1.2 + 2.4 * len(figure.panels)), layout='constrained')
    panels = drawn.subplots(len(figure.panels), 1, sharex=True, squeeze=False)
    for panel, (axis, traces) in zip(panels[:, 0], figure.panels.items(), strict=True):
        for begin, end in rests if figure.in_time else ():
            panel.axvspan(begin, end, color=_REST, alpha=0.12, linewidth=0)
        for trace in traces:
            _draw_trace(panel, trace, color=colours[trace.role], label=names[trace.role])
        if 'x' in figure.logarithmic:
            panel.set_xscale('log')
        if 'y' in figure.logarithmic:
            panel.set_yscale('log')
        if figure.limits is not None:
            panel.set_ylim(figure.limits)
        panel.set_ylabel(f'{axis}, {figure.y}')
        panel.grid(alpha=0.3)
    panels[-1, 0].set_xlabel(figure.x)
    handles, labels = panels[0, 0].get_legend_handles_labels()
    drawn.legend(handles, labels, loc='outside upper right', ncols=max(len(labels), 1), fontsize=9)
    drawn.suptitle(figure.title, x=0.01, ha='left')
    return drawn


def _draw_trace(panel: Axes, trace: Trace, **style: Any) -> None:
    if trace.style == 'band':
        middle = np.zeros(len(trace.y)) if trace.middle is None else trace.middle
        low, high = middle - trace.y, middle + trace.y
        panel.fill_between(trace.x, low, high, alpha=0.2, linewidth=0, **style)
    elif trace.style == 'bars':
        width = 0.9 * float(np.diff(trace.x).min())
        panel.bar(trace.x, trace.y, width, alpha=0.75, **style)
    elif trace.style == 'marks':
        panel.plot(trace.x, trace.y, 'x', markersize=5, **style)
    else:
        panel.plot(trace.x, trace.y, linewidth=0.8, **style)
