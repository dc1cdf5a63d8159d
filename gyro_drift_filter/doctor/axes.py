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

"""Whether rates and accelerations mean the same axes, signs and units: gravity tells.

The integrated rates turn the accelerations back into a frame that is fixed in the world, where
gravity stands still. So the mean over some seconds equals that over the next ones, but for changes
of speed, whose mean is small beside gravity. With a wrong sign or axis it does not. All 48 ways in
which three axes can be named and signed are tried. One that is not the recording's own is told only
where it is clearly better.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.identify.series import Values, stacked, value_at
from gyro_drift_filter.rotations import from_vectors, rotate, running_products

# Two means are compared that are taken over so many s each: a change of speed by 1 m/s in two
# seconds moves one by 3 deg, and a bias of 1 deg/s turns it by 2. What turns too slowly for that
# changes its speed less.
_HALF_SECONDS = (2.0, 6.0)
# Steps of a stretch in which it is integrated: fifty a second follow any hand.
_MOST_STEPS = 200
# Stretches that are looked at, all over the recording. Those in which gravity turns by so many rad
# tell something; there have to be a few of them, and more than so many say no more.
_MOST_WINDOWS, _USED_WINDOWS = 1000, 40
_LEAST_TURN = math.radians(15.0)
_LEAST_WINDOWS = 5
# Clearly better: the errors are half as large, and smaller in four of five stretches that tell.
_BETTER, _MAJORITY = 0.5, 0.8
# A stretch tells two ways apart where their errors differ by this share of its turn. An axis counts
# where so many tell its sign.
_TELLING, _LEAST_TELLING = 0.25, 3
# Rates carry gravity where less than this share of its turns is left. A scale that is off by a
# third leaves a third.
_CARRIED = 0.5
# Ways that are about as good as the best one can't be told from it, as of axes that never turned.
_AS_GOOD = 1.5


class Way(NamedTuple):
    """How the rates might be meant: which rate, with which sign, each axis takes; and a factor."""

    axes: tuple[int, ...]
    signs: tuple[int, ...]
    factor: float

    def matrix(self) -> Floats:
        """Return the matrix (3, 3) by which rates are multiplied."""
        matrix = np.zeros((3, 3))
        matrix[range(3), self.axes] = np.multiply(self.signs, self.factor)
        return matrix

    @property
    def changes(self) -> int:
        """How many axes are others, or have another sign, than as they are."""
        return sum(a != b for a, b in zip(self.axes, range(3), strict=True)) + self.signs.count(-1)

    def __str__(self) -> str:
        """Return the way as the three rates to take, such as (y, x, -z)."""
        rates = zip(self.axes, self.signs, strict=True)
        return f'({", ".join(("-" if sign < 0 else "") + AXES[axis] for axis, sign in rates)})'


AS_IT_IS = Way((0, 1, 2), (1, 1, 1), 1.0)
_FLIPPED = tuple(
    AS_IT_IS._replace(signs=tuple(-1 if axis == flipped else 1 for axis in range(3)))
    for flipped in range(3)
)
FROM_DEGREES = AS_IT_IS._replace(factor=math.pi / 180.0)
# Sensors and drivers give out thousandths, too.
OTHER_UNITS = {
    AS_IT_IS._replace(factor=1e-3): ('milliradians per second', '1000'),
    AS_IT_IS._replace(factor=1e-3 * math.pi / 180.0): (
        'thousandths of a degree per second',
        '180000 / pi',
    ),
    # Counts of 16 bits, for ranges of 250 to 2000 deg/s.
    **{
        AS_IT_IS._replace(factor=math.radians(full / 2**15)): (
            f'counts, some {2**15 / full:.0f} for each degree per second',
            f'{2**15 / full:.0f} * 180 / pi',
        )
        for full in (250, 500, 1000, 2000)
    },
}
# A driver may take the counts for those of another range than is set in the sensor, or of another
# scale than its maker's: from a quarter to four times, in steps of a tenth.
OTHER_SCALES = tuple(AS_IT_IS._replace(factor=1.1**k) for k in range(-15, 16) if k)
WAYS = (
    AS_IT_IS,
    *(
        Way(axes, signs, 1.0)
        for axes in itertools.permutations(range(3))
        for signs in itertools.product((1, -1), repeat=3)
        if (axes, signs) != AS_IT_IS[:2]
    ),
    FROM_DEGREES,
    *OTHER_UNITS,
    *OTHER_SCALES,
)


@dataclass(frozen=True)
class Carried:
    """How well rates carry gravity, of w stretches in which it turns.

    Attributes:
        turns: (w,) by how much gravity turns in the axes of the sensor, in rad.
        errors: (m, w) by how much it seems to turn in the world, for each way.
        period: Of the samples by their stamps in s, NaN where these tell none.
    """

    turns: Floats
    errors: Floats
    period: float = math.nan


def carry_gravity(
    stamps: Values,
    rates: tuple[Values, ...],
    accelerations: tuple[Values, ...],
    period: float,
    bias: Sequence[float],
) -> Carried:
    """Return how well the rates carry gravity if they are meant in each of the WAYS.

    Args:
        stamps: (n,) in ns.
        rates: Three columns (n,) in rad/s.
        accelerations: Three columns (n,) in m/s^2.
        period: Of the samples in s.
        bias: (3,) of the rates in rad/s.
    """
    matrices = np.array([way.matrix() for way in WAYS])
    for seconds in _HALF_SECONDS:
        turning = _turning(stamps, accelerations, period, max(round(seconds / period), 2))
        if len(turning) >= _LEAST_WINDOWS:
            break
    turns, errors = [], []
    for where, turn in turning[:: -(-len(turning) // _USED_WINDOWS) or 1]:
        rate = stacked(rates, where) - np.asarray(bias)
        force = stacked(accelerations, where)
        if np.isfinite(rate).all():
            turns.append(turn)
            lasting = _mean_step(stamps, where)
            errors.append(_errors(0.5 * (rate[:-1] + rate[1:]) * lasting, force, matrices))
    return Carried(np.array(turns), np.array(errors).reshape(len(turns), len(WAYS)).T, period)


def _turning(
    stamps: Values, accelerations: tuple[Values, ...], period: float, half: int
) -> list[tuple[slice, float]]:
    """Return stretches of two halves in which gravity turns, and by how much in rad."""
    n, found = len(stamps), []
    count = min(max(n // half - 1, 0), _MOST_WINDOWS)
    for k in range(count):
        first = k * (n - 2 * half) // max(count - 1, 1)
        where = slice(first, first + 2 * half)
        turn = _turn_of_gravity(stamps, accelerations, where, period)
        if turn >= _LEAST_TURN:
            found.append((where, turn))
    return found


def _turn_of_gravity(
    stamps: Values, accelerations: tuple[Values, ...], where: slice, period: float
) -> float:
    """Return by how much the mean acceleration turns in a stretch in rad, 0 where it has a gap."""
    # Messages that came late or in bursts are of even steps all the same.
    if abs(_mean_step(stamps, where) / period - 1.0) > 0.2:
        return 0.0
    force = stacked(accelerations, where)
    half = len(force) // 2
    turn = float(_angles(force[:half].mean(axis=0), force[half:].mean(axis=0)))
    return turn if math.isfinite(turn) else 0.0


def _mean_step(stamps: Values, where: slice) -> float:
    """Return the mean step of the stamps of a stretch in s."""
    first, last = (int(value_at(stamps, k)) for k in (where.start, where.stop - 1))
    steps: int = where.stop - 1 - where.start
    return (last - first) * 1e-9 / steps


def _errors(turned: Floats, force: Floats, matrices: Floats) -> Floats:
    """Return by how much gravity seems to turn (m,) with rates multiplied by matrices (m, 3, 3).

    `turned` (n - 1, 3) is what they turn from each sample to the next, `force` (n, 3).
    """
    stride = -(-len(turned) // _MOST_STEPS)
    edges = np.arange(0, len(turned), stride)
    steps = np.add.reduceat(turned, edges, axis=0)
    force = force[::stride][: len(steps) + 1]
    steps = steps[: len(force) - 1]
    half = len(force) // 2
    steps = np.vstack([np.zeros(3), steps])
    turns = from_vectors(np.einsum('mij,nj->mni', matrices, steps))
    world = rotate(running_products(turns), force)
    return _angles(world[:, :half].mean(axis=1), world[:, half:].mean(axis=1))


def _angles(left: Floats, right: Floats) -> Floats:
    """Return the angles between vectors (..., 3) in rad."""
    across = np.linalg.norm(np.cross(left, right), axis=-1)
    return np.asarray(np.arctan2(across, (left * right).sum(axis=-1)))


def judge_axes(
    carried: Carried, name: str = 'axes', match: str = 'carry gravity as the accelerometer shows it'
) -> Finding:
    """Say whether the rates carry gravity, or whatever else `match` says that they should do."""
    turns, errors = carried.turns, carried.errors
    values: dict[str, Any] = {'stretches': len(turns)}
    if len(turns) < _LEAST_WINDOWS:
        return unknown(
            name,
            f'gravity turns too little to tell signs and axes: {_times(len(turns))} by '
            f'{math.degrees(_LEAST_TURN):.0f} deg from its mean over '
            f'{" or ".join(f"{seconds:g}" for seconds in _HALF_SECONDS)} s, in which swings cancel '
            'out, to the next',
            'record the sensor turned by hand about each axis, by 90 deg and more',
            values,
        )
    medians = _medians(turns, errors)
    shares = medians / np.median(turns)
    values['share_left'] = float(shares[0])
    good = medians <= _AS_GOOD * medians.min()
    candidates = [int(k) for k in np.flatnonzero(good) if shares[k] < _CARRIED]
    if candidates and not good[0]:
        best = min(candidates, key=lambda k: (WAYS[k].changes, medians[k]))
        clearly = medians[best] < _BETTER * medians[0]
        tells = np.abs(errors[best] - errors[0]) > _TELLING * turns
        if clearly and tells.any() and np.mean((errors[best] < errors[0])[tells]) > _MAJORITY:
            values |= {'way': str(WAYS[best]), 'factor': WAYS[best].factor}
            values['share_left_then'] = float(shares[best])
            return _otherwise(WAYS[best], carried.period, name, match, values)
    turn = f'turns of {math.degrees(float(np.median(turns))):.0f} deg'
    # An axis about which it was not turned may have either sign.
    still = [AXES[axis] for axis in range(3) if good[WAYS.index(_FLIPPED[axis])]]
    if shares[0] < _CARRIED and len(still) < 3:
        exception = f' except that of {" and ".join(still)}, about which it was hardly turned'
        return sound(
            name,
            f'signs, axes and unit of the rates fit{exception if still else ""}: they {match} '
            f'({100.0 * shares[0]:.2g} % of {turn} are left)',
            values,
        )
    return unknown(
        name,
        f'the rates do not {match}, neither as they are nor with other signs and axes ({turn})',
        'are both of the same body, and are their scales right? Accelerations that last hide '
        'gravity, too',
        values,
    )


def _medians(turns: Floats, errors: Floats) -> Floats:
    """Return the median error (m,) of each way, as a mean over the axes whose signs stretches tell.

    Who turns a sensor about one axis after the other tells the sign of each in a third of them.
    """
    flips = errors[[WAYS.index(way) for way in _FLIPPED]] - errors[0]
    told = np.where(np.abs(flips).max(axis=0) > _TELLING * turns, np.abs(flips).argmax(axis=0), -1)
    parts = [errors[:, told == axis] for axis in range(3)]
    parts = [part for part in parts if part.shape[1] >= _LEAST_TELLING] or [errors]
    return np.asarray(np.mean([np.median(part, axis=1) for part in parts], axis=0))


def _otherwise(way: Way, period: float, name: str, match: str, values: dict[str, Any]) -> Finding:
    """Return the finding that the rates are meant in another way."""
    if way == FROM_DEGREES:
        return fault(
            'degrees',
            f'the rates are degrees per second: as such they {match}, as rad/s they do not',
            'multiply by pi / 180 in the driver (REP-103 asks for rad/s)',
            values,
        )
    if way in OTHER_UNITS:
        unit, divisor = OTHER_UNITS[way]
        return fault(
            'unit of rates',
            f'the rates are {unit}: as such they {match}, as rad/s they do not',
            f'divide by {divisor} in the driver (REP-103 asks for rad/s)',
            values,
        )
    if way in OTHER_SCALES:
        return fault(
            'scale',
            f'the rates {match} only if multiplied by about {way.factor:.2g}',
            f'{_question_of_time(period, way.factor)} If they are, a factor near 2 or 4 is another '
            'measuring range than the driver converts by; any other one is the scale of the '
            'sensor: find it for each axis with `gyro_drift calibrate`',
            values,
        )
    flipped = [AXES[axis] for axis in range(3) if way.signs[axis] < 0]
    if way.axes == (0, 1, 2):
        are = 'signs of {} are' if len(flipped) > 1 else 'sign of {} is'
        what = f'the {are.format(" and ".join(flipped))} wrong'
    else:
        what = 'axes are swapped' + (' and signs wrong' if flipped else '')
    mirrored = ' (the rates are left-handed)' if np.linalg.det(way.matrix()) < 0.0 else ''
    return fault(
        name,
        f'{what}: the rates {match} only if taken as {way}{mirrored}',
        'correct it in the driver, or find out whether the other one is wrong; a turned mounting '
        'belongs into the transform of the frame, for both sensors alike',
        values,
    )


def _question_of_time(period: float, factor: float) -> str:
    """Ask for the times, and name the rate that would do what the factor does.

    An angle is a rate times a time. The period is that of `Carried`.
    """
    looks = 'right? Time that runs too fast or too slowly looks the same'
    if math.isnan(period):
        return f'are the log times {looks}.'
    stamped, fitting = 1.0 / period, float(f'{1.0 / period / factor:.2g}')
    return (
        f'are the stamps {looks} (they say {stamped:.4g} Hz, and about {fitting:g} Hz would fit).'
    )


def _times(count: int) -> str:
    return 'never' if count == 0 else 'once' if count == 1 else f'{count} times'
