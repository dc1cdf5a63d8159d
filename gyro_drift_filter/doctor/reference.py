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

"""Whether the rates turn as an orientation in the same recording does."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.doctor.axes import WAYS, Carried, judge_axes
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.identify.series import Values, stacked, value_at
from gyro_drift_filter.rotations import inverse, multiply, rotate, to_vectors

# Turns over so many s are compared: many times the delays between two sources, and short enough
# for the axis of a turn to stay.
_SECONDS = 0.3
_MOST_BLOCKS = 1000
# A turn that is compared is of so many rad, of these there have to be so many.
_LEAST_TURN, _LEAST_BLOCKS = math.radians(3.0), 20
_LARGEST_TURN = math.radians(90.0)
# Turns about the vertical are the same, or of opposite sign, where they are correlated so much.
_ALIKE = 0.9
# Wheels slip, and their odometry may be off by a fifth; a wrong range or degrees by a factor of 2.
_SCALE = 1.5
# A mirrored frame is told where the fit with one leaves half of the error, in all three axes.
_BETTER, _LEAST_SPREAD = 0.5, 0.1


@dataclass(frozen=True)
class Reference:
    """Orientations, m of them.

    Attributes:
        name: Of the topic.
        stamps: (m,) in ns.
        orientations: Four columns (m,): x, y, z, w of the rotation from the body into the world.
        own: Whether it is that of the Imu messages, in the axes of the rates.
    """

    name: str
    stamps: Values
    orientations: tuple[Values, ...]
    own: bool


@dataclass(frozen=True)
class Turns:
    """Turns of both, b of them, in rad.

    Attributes:
        reference: (b, 3) in the axes of the reference's body.
        vertical: (b,) of the reference about the vertical of the world.
        rates: (b, 3) in the axes of the rates.
        up: (b, 3) the vertical there, by the accelerometer; NaN without one.
    """

    reference: Floats
    vertical: Floats
    rates: Floats
    up: Floats


def compare_turns(
    reference: Reference,
    stamps: Values,
    rates: tuple[Values, ...],
    accelerations: tuple[Values, ...],
    bias: Sequence[float],
) -> Turns:
    """Return the turns of a reference and of rates over the same time.

    Args:
        reference: The reference.
        stamps: (n,) of the rates in ns.
        rates: Three columns (n,) in rad/s.
        accelerations: Three columns (n,) in m/s^2.
        bias: (3,) of the rates in rad/s.
    """
    rows, imu = [], (stamps, rates, accelerations, np.asarray(bias))
    begin = max(value_at(stamps, 0), value_at(reference.stamps, 0))
    end = min(
        value_at(stamps, len(stamps) - 1), value_at(reference.stamps, len(reference.stamps) - 1)
    )
    span = round(_SECONDS * 1e9)
    for start in np.linspace(begin, end - span, _MOST_BLOCKS if end > begin + span else 0):
        row = _turn(reference, imu, int(start), int(start) + span)
        if row is not None and _LEAST_TURN < np.linalg.norm(row[:3]) < _LARGEST_TURN:
            rows.append(row)
    table = np.array(rows).reshape(-1, 10)
    return Turns(table[:, :3], table[:, 3], table[:, 4:7], table[:, 7:])


def _turn(reference: Reference, imu: Any, start: int, stop: int) -> Floats | None:
    """Return reference, vertical, rates and up of one turn (10,); None where samples are missing.

    `imu` are stamps, rates, accelerations and bias; `start` and `stop` in ns.
    """
    stamps, rates, accelerations, bias = imu
    first, last = _find(reference.stamps, start), _find(reference.stamps, stop)
    since, until = value_at(reference.stamps, first), value_at(reference.stamps, last)
    if last <= first or abs((until - since) / (stop - start) - 1.0) > 0.5:
        return None
    where = slice(_find(stamps, since), _find(stamps, until) + 1)
    steps = np.diff(np.asarray(stamps[where], np.int64)) * 1e-9
    if len(steps) < 2 or abs(1e9 * steps.sum() / (until - since) - 1.0) > 0.2:
        return None
    rate = stacked(rates, where) - bias
    force = np.mean(stacked(accelerations, where), axis=0)
    ends = [
        np.array([value_at(column, k) for column in reference.orientations]) for k in (first, last)
    ]
    size = [np.linalg.norm(end) for end in ends]
    if not (np.isfinite(rate).all() and min(size) > 0.0):
        return None
    before, after = ends[0] / size[0], ends[1] / size[1]
    # The mean rate, which is no angle that goes round, also where it is in degrees.
    turned = 0.5 * (rate[:-1] + rate[1:]).mean(axis=0) * (until - since) * 1e-9
    inside = to_vectors(multiply(inverse(before), after))
    vertical = rotate(before, inside)[2]
    up = force / max(float(np.linalg.norm(force)), 1e-12)
    return np.concatenate([inside, [vertical], turned, up])


def judge_reference(reference: Reference, turns: Turns) -> Finding:
    """Say whether the rates turn as the reference does."""
    name, title = f'orientation {reference.name}', f'the orientation of {reference.name}'
    count = len(turns.reference)
    if reference.own and _is_invented(reference):
        return fault(
            'invented orientation',
            'an orientation is stated, but it is always the identity, or zeros',
            'set orientation_covariance[0] to -1 in the driver: not reported (REP-145)',
        )
    if count < _LEAST_BLOCKS:
        return unknown(name, f'{title} turns too little to be compared')
    if reference.own:
        ways = np.array([way.matrix() for way in WAYS])
        meant = np.einsum('mij,bj->mbi', ways, turns.rates)
        errors = np.linalg.norm(meant - turns.reference, axis=-1)
        carried = Carried(np.linalg.norm(turns.reference, axis=-1), errors)
        return judge_axes(carried, name, f'turn as {title} does')
    return _about_vertical(turns, name, title) or _mirrored(turns, name, title)


def _about_vertical(turns: Turns, name: str, title: str) -> Finding | None:
    """Compare turns about the vertical, which needs no common axes; None where they say nothing."""
    mine = (turns.rates * turns.up).sum(axis=1)
    if not np.isfinite(mine).all() or np.std(turns.vertical) < _LEAST_TURN:
        return None
    alike = float(np.corrcoef(mine, turns.vertical)[0, 1])
    scale = float(mine @ turns.vertical) / float(mine @ mine)
    values: dict[str, Any] = {'correlation': alike, 'scale': scale}
    if alike < -_ALIKE:
        return fault(
            name,
            f'about the vertical the rates turn the other way round than {title}',
            'the sign of the rates, or of the acceleration that tells what is up, is wrong; or the '
            'reference turns clockwise (REP-103: counter-clockwise is positive)',
            values,
        )
    if alike < _ALIKE:
        return None
    if not 1.0 / _SCALE < scale < _SCALE:
        return fault(
            name,
            f'the rates have to be multiplied by {scale:.3g} to turn as {title}',
            'degrees, milliradians, or the scale of another measuring range?',
            values,
        )
    return sound(
        name,
        f'about the vertical the rates turn as {title}, which turns {scale:.2f} times as far',
        values,
    )


def _mirrored(turns: Turns, name: str, title: str) -> Finding:
    """Tell whether the axes of the rates are a mirrored set of those of the reference."""
    left, size, right = np.linalg.svd(turns.rates.T @ turns.reference)
    if size[2] < _LEAST_SPREAD * size[0]:
        return unknown(name, f'{title} turns about too few axes to be compared')
    handed = np.sign(np.linalg.det(left @ right))
    errors = []
    for sign in (handed, -handed):  # rotations where the first one has the sign of `handed`
        turn = left @ np.diag([1.0, 1.0, handed * sign]) @ right
        errors.append(np.linalg.norm(turns.rates @ turn - turns.reference, axis=1))
    best, other = (float(np.median(error)) for error in errors)
    share = best / float(np.median(np.linalg.norm(turns.reference, axis=1)))
    values: dict[str, Any] = {'share_left': share, 'mirrored': bool(handed < 0)}
    if handed < 0 and best < _BETTER * other:
        return fault(
            name,
            f'the axes of the rates are mirrored against {title}',
            'one sign is wrong, or two axes are swapped: compare each axis by hand',
            values,
        )
    if share < _BETTER:
        return sound(name, f'the rates turn as {title} ({100.0 * share:.0f} % are left)', values)
    return unknown(
        name,
        f'the rates do not turn as {title}',
        'are both on the same body, and their clocks the same?',
        values,
    )


def _is_invented(reference: Reference) -> bool:
    """Tell whether orientations are always the identity or zeros, which nobody measures."""
    step = max(len(reference.stamps) // 1000, 1)
    *others, w = (
        np.array([value_at(column, k) for k in range(0, len(reference.stamps), step)])
        for column in reference.orientations
    )
    return bool(not np.any(others) and (np.all(w == 1.0) or not np.any(w)))


def _find(stamps: Values, stamp: int) -> int:
    """Return the index of the last of ascending stamps up to `stamp`, or 0."""
    return bisect_right(range(len(stamps)), stamp, 1, key=partial(value_at, stamps)) - 1
