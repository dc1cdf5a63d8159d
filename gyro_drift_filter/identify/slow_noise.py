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

"""Noise that changes as slowly as a body moves, told from motion by gravity.

A sensor behind its own low-pass at a few hertz gives rates as smooth as those of a hand. If they
were a turn, gravity would turn with them; noise leaves it where it is. So the rates are integrated
over each window, the movement of gravity that follows from them is compared with the one that the
accelerometer shows, and the noise is taken for noise where gravity moves by less than half of it.

Without an accelerometer there is one sign left: a body that does not turn on and on comes back, so
its angles stay within bounds, while those that noise makes walk away with the root of time.
"""

import math
from collections.abc import Sequence
from enum import Enum

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify.series import Values
from gyro_drift_filter.identify.timing import Timing
from gyro_drift_filter.identify.windows import AxisNoise, Windows, cut, measure_noise, rows_of

# Where the quietest windows have a smaller share of their variance in differences over 20 ms than
# this they are smooth: a body's motion up to 3 Hz, and no low-pass that gyroscopes have at 100 Hz.
LEAST_ROUGHNESS = 0.08
# The filter is the same on all axes: what is this much rougher on another one is motion.
ALIKE = 3.0
# Noise has forgotten itself where differences are this share of those of white noise.
FORGOTTEN = 0.5
# Noise that is correlated over longer times than a window can't be told from a bias that wanders.
LONGEST_WINDOW = 32.0  # s
LEAST_WINDOWS = 3
# Angles are compared at so many points of a window, in windows up to this length: those that noise
# makes grow with the square root of time, while the accelerometer's own noise averages out.
_POINTS = 16
_LONGEST_COMPARED = 256.0  # s
# No gyroscope's noise turns faster: 70 degrees in the root of an hour, where data sheets of the
# cheapest say 1 to 2, and a phone behind its slow filter has 15.
_LARGEST_WALK = 0.02  # rad in the root of a second
# Without an accelerometer: the angles of noise are twice as large over four times the time, those
# of a body that comes back no larger.
_WALK_TIMES, _WALK_GROWTH = 4, math.sqrt(2.0)
# Gravity stays where it moves by less than this share of what the rates say, were they a turn.
_SHARE = 0.5
# The same about the vertical, where gravity says nothing: as large as the others, to this ratio.
_VERTICAL = 3.0

_Measured = tuple[Windows, list[AxisNoise]]


class Cause(Enum):
    """What smooth rates are."""

    NOISE = 'noise'
    MOTION = 'motion'
    OPEN = 'open'  # the recording does not tell


def is_smooth(noise: AxisNoise) -> bool:
    """Tell whether the quietest windows of an axis are smooth: motion, or slow noise."""
    return noise.roughness < LEAST_ROUGHNESS


def judge_slow_rates(
    noises: Sequence[AxisNoise], windows: Windows, axes: Sequence[Values], timing: Timing
) -> tuple[Cause, _Measured]:
    """Return what slow rates are, and windows long enough for them with the noise in these.

    Args:
        noises: Of three axes of the gyroscope, and three of the accelerometer if there is one.
        windows: That they were measured in.
        axes: Samples of the same three or six.
        timing: Of the samples.
    """
    measured = windows, list(noises)
    smooth = any(map(is_smooth, noises[:3]))
    if all(map(_is_forgotten, noises)) and not smooth:
        return Cause.NOISE, measured
    rough = [noise.roughness for noise in noises[:3] if np.isfinite(noise.roughness)]
    if smooth and max(rough) > ALIKE * LEAST_ROUGHNESS:
        return Cause.MOTION, measured
    longer = _lengthen(measured, axes, timing)
    return (Cause.OPEN, measured) if longer is None else (_judge(longer, axes, timing), longer)


def _is_forgotten(noise: AxisNoise) -> bool:
    """Tell whether the noise forgets itself within a part of a window."""
    return not noise.slow_roughness < FORGOTTEN  # NaN where nothing changes


def _lengthen(measured: _Measured, axes: Sequence[Values], timing: Timing) -> _Measured | None:
    """Double the windows until the noise forgets itself within a part of one."""
    windows, noises = measured
    while not all(map(_is_forgotten, noises)):
        longer = _doubled(windows, axes, timing, LONGEST_WINDOW)
        if longer is None:
            return None
        windows, noises = longer
    return windows, noises


def _doubled(
    windows: Windows, axes: Sequence[Values], timing: Timing, longest: float
) -> _Measured | None:
    """Return windows of twice the size, up to so many s, and their noise; None without enough."""
    size = 2 * windows.size
    windows = cut(timing.parts(len(axes[0])), size)
    if size * timing.period > longest or len(windows.first) < LEAST_WINDOWS:
        return None
    return windows, [measure_noise(axis, windows, timing.period) for axis in axes]


def _judge(measured: _Measured, axes: Sequence[Values], timing: Timing) -> Cause:
    """Tell whether gravity stays where the rates, were they a turn, would move it."""
    longer: _Measured | None = measured
    first_size, first, before = measured[0].size, math.inf, 0.0
    while longer is not None:
        windows, noises = longer
        turned, moved, vertical = _movements(windows, noises, axes, timing.period)
        if turned > _walked(windows.size * timing.period) or vertical > _VERTICAL:
            return Cause.MOTION
        # Turns to and fro average out over longer times; what noise makes goes on to grow.
        if not turned > before:
            return Cause.OPEN
        if moved < _SHARE * turned:
            return Cause.NOISE
        first = min(first, turned)
        if len(axes) == 3 and windows.size == _WALK_TIMES * first_size:
            return Cause.NOISE if turned > _WALK_GROWTH * first else Cause.OPEN
        before = turned
        longer = _doubled(windows, axes, timing, _LONGEST_COMPARED)
    return Cause.OPEN


def _walked(seconds: float) -> float:
    """Return the angle in rad by which two walks depart from a straight line, at the most."""
    return _LARGEST_WALK * math.sqrt(2.0 * seconds / 15.0)


def _movements(
    windows: Windows, noises: Sequence[AxisNoise], axes: Sequence[Values], period: float
) -> tuple[float, float, float]:
    """Return medians over calm windows of what moves gravity.

    Returns:
        The movement that follows from the rates, the one that the accelerometer shows, both as
        parts of gravity, and the rate about the vertical over that about a horizontal axis.
        Without an accelerometer the second is infinite and the third 1.
    """
    calm = np.logical_and.reduce([noise.calm for noise in noises])
    found = []
    for group in windows.groups():
        six = np.stack([rows_of(axis, windows, group)[:, : windows.size] for axis in axes], axis=2)
        six = six[calm[group] & np.isfinite(six).all(axis=(1, 2))]
        if not len(six):
            continue
        rates = six[..., :3] - six[..., :3].mean(axis=1, keepdims=True)
        angles = np.cumsum(rates, axis=1) * period
        if len(axes) == 3:
            size = _size(angles) * math.sqrt(2.0 / 3.0)  # of two axes, as gravity shows
            found.append(np.column_stack([size, np.full_like(size, math.inf), np.ones_like(size)]))
            continue
        gravity = six[..., 3:].mean(axis=1, keepdims=True)
        length = np.maximum(np.linalg.norm(gravity, axis=2, keepdims=True), 1e-300)
        moved = np.stack([_size(np.cross(gravity, angles)), _size(six[..., 3:])], axis=1)
        whole = (rates**2).sum(axis=(1, 2))
        along = ((rates * gravity / length).sum(axis=2) ** 2).sum(axis=1)
        across = np.maximum(0.5 * (whole - along), 1e-300)
        found.append(np.column_stack([moved / length[:, 0], np.sqrt(along / across)]))
    if not found:
        return 0.0, 0.0, 1.0
    turned_by, moved_by, vertical = np.median(np.concatenate(found), axis=0)
    return float(turned_by), float(moved_by), float(vertical)


def _size(vectors: Floats) -> Floats:
    """Return how far vectors (w, n, 3) move about a straight line in each window: (w,)."""
    n = vectors.shape[1] // _POINTS * _POINTS
    points = vectors[:, :n].reshape(len(vectors), _POINTS, -1, 3).mean(axis=2)
    # An unknown bias turns at a constant rate, so a line is taken out of both.
    time = np.linspace(-1.0, 1.0, _POINTS)[:, None]
    points = points - points.mean(axis=1, keepdims=True)
    slope = (points * time).sum(axis=1, keepdims=True) / (time**2).sum()
    return np.asarray(np.sqrt(((points - slope * time) ** 2).sum(axis=2).mean(axis=1)))
