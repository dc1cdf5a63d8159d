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

"""What the rests of a recording and the turns between them say of a sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag, solve_triangular
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.calibrate.rests import Rest, Rests
from gyro_drift_filter.calibrate.sensitivity import AccelerationSensitivity
from gyro_drift_filter.calibrate.turning import Leg, Turn, make_leg, turn, turn_alone
from gyro_drift_filter.calibrate.unknowns import (
    MATRIX,
    OFFSET,
    UNKNOWNS,
    UPPER,
    UPPER_ENTRIES,
    Residuals,
    upper,
)
from gyro_drift_filter.gravity import GRAVITY

# A case of ten centimetres, set against an edge by hand, lies there to half a millimetre.
EDGE_DEVIATION = float(np.radians(0.3))
# What comes back to the same side of a table, in rad, after a turn of more than this, in rad.
SAME_SIDE, WHOLE_TURN = float(np.radians(5.0)), float(np.radians(180.0))


@dataclass(frozen=True)
class Closures:
    """How well legs close with a matrix, n legs.

    Attributes:
        angles: (n,) between gravity as it was carried and as it is, in rad; for a turn back to
            the same place that between the two orientations.
        turned: (n,) by how much in all, in rad.
    """

    angles: Floats
    turned: Floats


def cross(vector: Floats) -> Floats:
    """Return the matrix (3, 3) that a vector product with a vector (3,) from the left is."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


class RestsOfOneRecording:
    """The rests of a recording, and the ways between them.

    At rest the acceleration has the size of gravity, and a leg's rotation carries gravity from one
    rest to the next. Errors: the noise of both sensors at the rests, which the legs beside a rest
    have in common; the noise of the gyroscope on the way; a bias that has moved, no one knows when
    on the way, by more than the acceleration moves it. With `turns`, whole turns by hand have led
    back to the same edge.

    Attributes:
        legs: Those that are unbroken and tell something.
        gaps: Times in s of the rests before those that a gap breaks.
        clipped: The same of those that are faster than the range of the gyroscope.
        turns: Whether whole turns led back to the same edge.
        excess: (m + l,) variances beside the noise, of the sizes of gravity at m rests and of l
            legs: what does not fit is trusted less.
    """

    def __init__(
        self,
        number: int,
        found: Rests,
        sensitivity: AccelerationSensitivity,
        *,
        turns: bool,
    ) -> None:
        """Take a recording by its number and rests, and what acceleration does to its rates."""
        self._rests: Sequence[Rest] = found.rests
        self._found = found
        self.turns = turns
        self.measured = found.track.accelerations is not None
        self._sensitivity = sensitivity
        self.legs: list[Leg] = []
        self.gaps: list[float] = []
        self.clipped: list[float] = []
        for k, (before, behind) in enumerate(pairwise(self._rests)):
            span = slice(before.stop - 1, behind.first)
            if found.track.clipped[span].any():
                self.clipped.append(before.time)
            elif found.track.broken[span].any():
                self.gaps.append(before.time)
            else:
                leg = make_leg(
                    found.track, number, (k, k + 1), (before, behind), sensitivity.matrix
                )
                if self.measured or (turns and turn_alone(leg, np.eye(3)).angle > WHOLE_TURN):
                    self.legs.append(leg)
        self.excess = np.zeros((len(self._rests) if self.measured else 0) + len(self.legs))
        self._steps = self._bias_steps()

    def _bias_steps(self) -> Floats:
        """Return the mean square (3,) by which the bias moves from rest to rest, without noise."""
        density, steps = self._found.rate_density, [np.zeros(3)]
        for before, behind in pairwise(self._rests):
            noise = density * (1.0 / before.seconds + 1.0 / behind.seconds)
            step = behind.rate - before.rate
            if self.measured:
                step = step - self._sensitivity.matrix @ (behind.acceleration - before.acceleration)
            steps.append(step**2 - noise)
        return np.asarray(np.maximum(np.mean(steps[1:] or steps, axis=0), 0.0))

    @property
    def bias_walk(self) -> float:
        """The variance by which the bias walks in a second, on the worst axis, in (rad/s)^2 / s."""
        times = [rest.time for rest in self._rests]
        return float(self._steps.max() / np.mean(np.diff(times)))

    def gravity(self, unknowns: Floats) -> Floats:
        """Return the acceleration at each rest by the unknowns (UNKNOWNS,): (m, 3) in m/s^2."""
        means = np.array([rest.acceleration for rest in self._rests])
        return np.asarray((means - unknowns[OFFSET]) @ upper(unknowns).T)

    def closures(self, unknowns: Floats) -> Closures:
        """Return how well the legs close by the unknowns (UNKNOWNS,)."""
        gravity = self.gravity(unknowns) if self.measured else None
        turns = [turn_alone(leg, unknowns[MATRIX].reshape(3, 3)) for leg in self.legs]
        angles = []
        for leg, way in zip(self.legs, turns, strict=True):
            if gravity is None or self._is_back(leg, way, gravity):
                angles.append(float(np.linalg.norm(_vector(way.rotation))))
            else:
                before, behind = _directions(gravity, leg)
                angles.append(float(np.linalg.norm(_between(before, way.rotation @ behind))))
        return Closures(np.array(angles), np.array([way.angle for way in turns]))

    def _is_back(self, leg: Leg, way: Turn, gravity: Floats) -> bool:
        """Tell whether a leg was whole turns by hand, back to the same edge."""
        if not self.turns or way.angle < WHOLE_TURN:
            return False
        return bool(np.linalg.norm(np.cross(*_directions(gravity, leg))) < SAME_SIDE)

    @property
    def has_whole_turns(self) -> bool:
        """Whether some leg was whole turns, back to the same side."""
        if not self.measured:
            return self.turns and bool(self.legs)
        means = np.array([rest.acceleration for rest in self._rests])
        return any(self._is_back(leg, turn_alone(leg, np.eye(3)), means) for leg in self.legs)

    def residuals(self, unknowns: Floats) -> Residuals:
        """Return all residuals at the unknowns (UNKNOWNS,)."""
        blocks = self._blocks(unknowns)
        covariance, values, jacobian = blocks.covariance, blocks.values, blocks.jacobian
        for rows, excess in zip(blocks.rows, self.excess, strict=True):
            covariance[rows, rows] += excess
        if not len(values):
            return Residuals(values, jacobian)
        factor = np.linalg.cholesky(covariance)
        whitened = solve_triangular(factor, np.column_stack([values, jacobian]), lower=True)
        return Residuals(whitened[:, 0], whitened[:, 1:])

    def misfits(self, unknowns: Floats) -> tuple[Floats, Floats, Floats]:
        """Return how badly rests and legs fit: three values for each, (m + l,).

        They are the sum of its squared residuals divided by their variances, which are those
        without any excess; the mean of its squared residuals; and the number of its residuals.
        """
        blocks = self._blocks(unknowns)
        squares, variances, counts = np.zeros((3, len(self.excess)))
        for k, rows in enumerate(blocks.rows):
            values, covariance = blocks.values[rows], blocks.covariance[np.ix_(rows, rows)]
            counts[k] = len(rows)
            if len(rows):
                squares[k] = values @ np.linalg.solve(covariance, values)
                variances[k] = float(values @ values) / len(rows)
        return squares, variances, counts

    def _blocks(self, unknowns: Floats) -> '_Blocks':
        rests, size = self._rests, len(self._rests)
        blocks = _Blocks(size)
        gravity, by_unknowns = None, np.zeros((size, 3, UNKNOWNS))
        if self.measured:
            gravity, by_unknowns = self.gravity(unknowns), self._gravity_by_unknowns(unknowns)
            self._add_sizes(gravity, by_unknowns, upper(unknowns), blocks)
        for leg in self.legs:
            self._add_leg(leg, unknowns, gravity, by_unknowns, blocks)
        variances = np.concatenate(  # in the order of `Source`
            [
                [self._found.rate_density / rest.seconds for rest in rests],
                [self._found.acceleration_density / rest.seconds for rest in rests],
                np.full((size, 3), EDGE_DEVIATION**2),
            ]
        ).ravel()
        return blocks.finished(np.nan_to_num(variances))

    def _gravity_by_unknowns(self, unknowns: Floats) -> Floats:
        """Return the derivatives of `gravity` by the unknowns, (m, 3, UNKNOWNS)."""
        out = np.zeros((len(self._rests), 3, UNKNOWNS))
        out[:, :, OFFSET] = -upper(unknowns)
        for by_unknowns, rest in zip(out, self._rests, strict=True):
            raw = rest.acceleration - unknowns[OFFSET]
            for entry, (i, j) in enumerate(zip(*UPPER_ENTRIES, strict=True)):
                by_unknowns[i, UPPER.start + entry] = raw[j]
        return out

    def _add_sizes(
        self, gravity: Floats, by_unknowns: Floats, matrix: Floats, blocks: '_Blocks'
    ) -> None:
        """Add by how much gravity (m, 3) is larger at each rest than it is on earth."""
        for rest, vector in enumerate(gravity):
            length = np.linalg.norm(vector)
            direction = vector / length
            by_errors = blocks.no_errors(1)
            by_errors[0, Source.ACCELERATION, rest] = direction @ matrix / GRAVITY
            value = np.array([length / GRAVITY - 1.0])
            jacobian = (direction @ by_unknowns[rest] / GRAVITY)[None]
            blocks.add(value, jacobian, by_errors.reshape(1, -1), np.zeros((1, 1)))

    def _add_leg(
        self,
        leg: Leg,
        unknowns: Floats,
        gravity: Floats | None,
        by_unknowns: Floats,
        blocks: '_Blocks',
    ) -> None:
        """Add by which rotation vector a leg does not close, in the axes of its start.

        With gravity (m, 3) and its derivatives (m, 3, UNKNOWNS) that is across gravity, unless it
        was whole turns back to the same edge.
        """
        matrix = unknowns[MATRIX].reshape(3, 3)
        way, derivatives = turn(leg, matrix)
        jacobian, by_errors, by_edges = np.zeros((3, UNKNOWNS)), *blocks.no_errors(2, 3)
        jacobian[:, MATRIX] = derivatives.by_matrix
        for rest, by_bias, sign in zip(leg.rests, derivatives.by_biases, (1.0, -1.0), strict=True):
            by_errors[:, Source.RATE, rest] = by_bias
            by_edges[:, Source.EDGE, rest] = sign * np.eye(3)
        if gravity is None:
            rows, vector = np.eye(3), _vector(way.rotation)
            by_errors += by_edges
        else:
            before, behind = directions = _directions(gravity, leg)
            vector = _between(before, way.rotation @ behind)
            by_directions = -cross(before), cross(before) @ way.rotation
            for rest, direction, by in zip(leg.rests, directions, by_directions, strict=True):
                length, of_rest = np.linalg.norm(gravity[rest]), by_unknowns[rest]
                jacobian += by @ ((of_rest - np.outer(direction, direction @ of_rest)) / length)
                across = (np.eye(3) - np.outer(direction, direction)) / length
                by_errors[:, Source.ACCELERATION, rest] = by @ across @ upper(unknowns)
            rows = np.linalg.svd(before[None])[2][1:]
            if self._is_back(leg, way, gravity):  # and about the vertical the edge tells
                rows = np.vstack([rows, before])
                vector = vector + before * float(before @ _vector(way.rotation))
                by_errors += np.tensordot(np.outer(before, before), by_edges, 1)
        own = self._variance_on_the_way(leg, matrix) * np.eye(len(rows))
        blocks.add(rows @ vector, rows @ jacobian, rows @ by_errors.reshape(3, -1), own)

    def _variance_on_the_way(self, leg: Leg, matrix: Floats) -> float:
        """Return the variance in rad^2 that noise and bias add to each axis between the rests."""
        on_the_way = self._found.rate_density * leg.seconds
        on_the_way = on_the_way + self._steps * leg.seconds**2 / 12.0
        at_rest = self._found.rate_density / np.mean([rest.seconds for rest in self._rests])
        on_the_way = on_the_way + (leg.push @ self._sensitivity.spread @ leg.push) * at_rest
        return float(on_the_way.mean() * np.abs(np.linalg.det(matrix)) ** (2.0 / 3.0))


class Source(IntEnum):
    """What is off by an error of three axes at each rest."""

    RATE = 0  # its mean, which is the bias
    ACCELERATION = 1
    EDGE = 2  # how it lies against the edge of the table


class _Blocks:
    """Residuals as they are gathered: values, what they depend on, their covariance."""

    def __init__(self, rests: int) -> None:
        self._rests = rests
        self.rows: list[Integers] = []
        # Of no residuals, so that there is something to concatenate.
        no_errors = np.zeros((0, self.no_errors().size))
        nothing = np.zeros(0), np.zeros((0, UNKNOWNS)), no_errors, np.zeros((0, 0))
        self._parts: list[tuple[Floats, Floats, Floats, Floats]] = [nothing]
        self._count = 0

    def no_errors(self, *shape: int) -> Floats:
        """Return derivatives by the errors of all sources at m rests, zero: (..., 3, m, 3)."""
        return np.zeros((*shape, len(Source), self._rests, 3))

    def add(self, values: Floats, jacobian: Floats, by_errors: Floats, own: Floats) -> None:
        """Add r residuals, their derivatives by unknowns and e errors, and their own covariance."""
        self.rows.append(np.arange(self._count, self._count + len(values)))
        self._count += len(values)
        self._parts.append((values, jacobian, by_errors, own))

    def finished(self, variances: Floats) -> '_Blocks':
        """Put all together, by the variances (e,) of the errors."""
        values, jacobians, by_errors, own = zip(*self._parts, strict=True)
        self.values, self.jacobian = np.concatenate(values), np.concatenate(jacobians)
        each = np.concatenate(by_errors)
        self.covariance = (each * variances) @ each.T + block_diag(*own)
        return self


def _directions(gravity: Floats, leg: Leg) -> tuple[Floats, Floats]:
    """Return the directions (3,) of gravity (m, 3) at the rests before and behind a leg."""
    before, behind = (gravity[k] / np.linalg.norm(gravity[k]) for k in leg.rests)
    return before, behind


def _vector(rotation: Floats) -> Floats:
    """Return the rotation vector (3,) of a matrix."""
    return np.asarray(Rotation.from_matrix(rotation).as_rotvec())


def _between(a: Floats, b: Floats) -> Floats:
    """Return the shortest rotation vector (3,) from a direction to another."""
    axis = np.cross(a, b)
    sine, cosine = float(np.linalg.norm(axis)), float(a @ b)
    return axis * (np.arctan2(sine, cosine) / sine) if sine > 1e-12 else axis
