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

"""Draw docs/images/poses.svg, the twelve poses of a box in which a sensor is calibrated.

python -m tools.draw_poses
"""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from gyro_drift_filter.arrays import Floats

PICTURE = Path(__file__).parent.parent / 'docs' / 'images' / 'poses.svg'

# The box in its own axes, half of its lengths: no two are alike, so that faces can be told apart.
HALF = np.array([1.0, 0.7, 0.4])
AXES = 'x', 'y', 'z'
# What RViz takes for them, dark enough on white.
COLOURS = '#c62828', '#1b7f3b', '#1f5fa8'
# Seen from the front, from the right and from above: across, up, and towards the eye.
_TURN, _RISE = np.radians([30.0, 24.0])
_ACROSS = np.array([np.cos(_TURN), np.sin(_TURN), 0.0])
_EYE = np.array([np.sin(_TURN) * np.cos(_RISE), -np.cos(_TURN) * np.cos(_RISE), np.sin(_RISE)])
_UP = np.cross(_EYE, _ACROSS)

# Of each pose its name, and the axes of the box that point across, to the wall and up: so that all
# of x, y and z can be seen.
FACES = {
    'z up': ('+y', '-x'),
    'z down': ('+x', '-y'),
    'x up': ('+z', '-y'),
    'x down': ('+y', '-z'),
    'y up': ('+x', '-z'),
    'y down': ('+z', '-x'),
}
EDGES = {
    'x and y up': ('+z', '+x', '+y'),
    'y and z up': ('+x', '+y', '+z'),
    'x and z up': ('+y', '+z', '+x'),
    'x up, y down': ('+z', '-y', '+x'),
    'y up, z down': ('+x', '-z', '+y'),
    'z up, x down': ('+y', '-x', '+z'),
}


def axis(name: str) -> Floats:
    """Return an axis of the box (3,) by its sign and letter."""
    return np.asarray(np.eye(3)[AXES.index(name[1])] * (1.0 if name[0] == '+' else -1.0))


def on_a_face(across: str, back: str) -> Floats:
    """Return the rotation (3, 3) from the axes of a box on a face to the room's."""
    return np.array([axis(across), axis(back), np.cross(axis(across), axis(back))])


def on_an_edge(across: str, back: str, front: str) -> Floats:
    """Return the rotation of a box on an edge: two of its axes point up, to the wall and away."""
    a, b = axis(back), axis(front)
    return np.array([axis(across), (a - b) / np.sqrt(2.0), (a + b) / np.sqrt(2.0)])


def seen(points: Floats) -> Floats:
    """Return where points (..., 3) of the room stand in the picture, (..., 2)."""
    return np.stack([points @ _ACROSS, points @ _UP], axis=-1)


def draw_pose(panel: Axes, title: str, rotation: Floats, *, leans: bool) -> None:
    """Draw a box on a table, and the wall that it leans against."""
    signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
    corners = signs * HALF @ rotation.T
    low, back = corners[:, 2].min(), corners[:, 1].max()
    wide, deep, high = 1.5, 1.3, 1.1
    far = back if leans else deep
    table = np.array([[-wide, -deep, low], [wide, -deep, low], [wide, far, low], [-wide, far, low]])
    panel.fill(*seen(table).T, color='#e9e2d6', linewidth=0, zorder=0)
    if leans:
        wall = np.array(
            [[-wide, far, low], [wide, far, low], [wide, far, high], [-wide, far, high]]
        )
        panel.fill(*seen(wall).T, color='#d3dae3', linewidth=0, zorder=0)
    draw_axes(panel, rotation, towards=False)
    for k in range(3):
        for side in (-1.0, 1.0):
            normal = side * rotation[:, k]
            if normal @ _EYE <= 0.0:
                continue
            u, v = (HALF[j] * rotation[:, j] for j in range(3) if j != k)
            face = side * HALF[k] * rotation[:, k] + np.array([u + v, u - v, -u - v, v - u])
            light = 0.80 + 0.17 * max(0.0, float(normal @ [0.25, -0.35, 0.9]))
            panel.fill(
                *seen(face).T, facecolor=str(light), edgecolor='#555555', linewidth=0.8, zorder=3
            )
    draw_axes(panel, rotation, towards=True)
    foot = float(seen(table).min(axis=0)[1])
    panel.text(0.0, foot - 0.85, title, fontsize=12, ha='center', va='center', color='#222222')
    panel.set(xlim=(-1.85, 1.85), ylim=(foot - 1.1, foot + 3.7), aspect='equal')
    panel.axis('off')


def draw_axes(panel: Axes, rotation: Floats, *, towards: bool) -> None:
    """Draw those axes that point towards the eye, before the box, or the others, behind it."""
    for k, (name, colour) in enumerate(zip(AXES, COLOURS, strict=True)):
        direction = rotation[:, k]
        if (direction @ _EYE > 0.0) != towards:
            continue
        start, along = seen(direction * HALF[k]), seen(direction)
        length = float(np.linalg.norm(along))
        # Longer than it would look where it points towards the eye.
        drawn = max(0.8 * length, 0.6)
        end, label = (start + along / length * reach for reach in (drawn, drawn + 0.28))
        panel.annotate(
            '',
            (end[0], end[1]),
            (start[0], start[1]),
            zorder=4 if towards else 2,
            annotation_clip=False,
            arrowprops={'arrowstyle': '-|>', 'color': colour, 'linewidth': 2, 'shrinkA': 0},
        )
        style = {'fontsize': 13, 'fontweight': 'bold', 'ha': 'center', 'va': 'center'}
        panel.text(label[0], label[1], name, color=colour, zorder=5, **style)


def main() -> None:
    """Write the picture."""
    mpl.rcParams.update(
        {'svg.fonttype': 'none', 'svg.hashsalt': 'poses', 'font.family': 'sans-serif'}
    )
    figure = Figure(figsize=(9.0, 4.7), facecolor='white')
    panels = figure.subplots(2, 6)
    for panel, (name, face) in zip(panels[0], FACES.items(), strict=True):
        draw_pose(panel, name, on_a_face(*face), leans=False)
    for panel, (name, edge) in zip(panels[1], EDGES.items(), strict=True):
        draw_pose(panel, name, on_an_edge(*edge), leans=True)
    figure.subplots_adjust(0.005, 0.0, 0.995, 0.95, 0.0, 0.2)
    for height, text in ((0.945, 'flat on the table'), (0.465, 'leaning against a wall or a book')):
        figure.text(0.015, height, text, fontsize=13, fontweight='bold', color='#222222')
    PICTURE.parent.mkdir(exist_ok=True)
    figure.savefig(PICTURE, metadata={'Date': None})


if __name__ == '__main__':
    main()
