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

"""How a sensor turned between two rests, by its rates and a matrix, and what that depends on.

With the rate M x, x = raw - bias, the rotation R from the first rest to the second changes by

    dR = [dphi] R,   dphi = sum R(t) dM x(t) dt

in the axes of the first rest, so one pass over the samples gives the rotation and its derivatives.
Many matrices are tried. So what does not depend on them is summed up once, over steps of several
samples where these come faster than hands move.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.calibrate.rests import Rest
from gyro_drift_filter.calibrate.track import Track
from gyro_drift_filter.rotations import from_vectors, multiply, running_products

# s: in less a hand, which trembles at 10 Hz, turns the axis of its rate by too little to tell
# a third term of the Magnus expansion.
STEP_SECONDS = 0.01


@dataclass(frozen=True)
class Leg:
    """The way from a rest to the next one.

    Attributes:
        track: Index of its recording.
        rests: Indexes of the two rests among all.
        time: Of its start in s.
        seconds: Its length.
        steps: (n,) lengths of its steps, of one or more samples each, in s.
        angles: (n, 3) integral over each step of the raw rate less the bias, which goes from that
            of one rest to that of the other, in rad.
        coning: (n, 3) by how much the rotation is another one as the axis turns meanwhile, in rad.
        share: (n,) of the way from the one bias to the other.
        push: (3,) the acceleration beside one that goes straight from rest to rest, summed up, in
            m/s: what the dependence of the bias on it has done.
    """

    track: int
    rests: tuple[int, int]
    time: float
    seconds: float
    steps: Floats
    angles: Floats
    coning: Floats
    share: Floats
    push: Floats

    @property
    def fastest(self) -> float:
        """The largest rate by the raw rates, in rad/s."""
        return float((np.linalg.norm(self.angles, axis=1) / self.steps).max())


@dataclass(frozen=True)
class Turn:
    """What a leg is with a matrix.

    Attributes:
        rotation: (3, 3) from the axes at its end to those at its start.
        angle: By how much it was turned in all, in rad.
    """

    rotation: Floats
    angle: float


@dataclass(frozen=True)
class Derivatives:
    """Derivatives of the rotation vector of a leg, in the axes of its start.

    Attributes:
        by_matrix: (3, 9) by the entries of the matrix row by row.
        by_biases: Two (3, 3), by the bias of the rest before and of the one behind, in s.
    """

    by_matrix: Floats
    by_biases: tuple[Floats, Floats]


def make_leg(
    track: Track,
    number: int,
    rests: tuple[int, int],
    ends: tuple[Rest, Rest],
    sensitivity: Floats,
) -> Leg:
    """Return the leg between two rests of the track of a recording, by its number.

    `rests` are their indexes, `ends` they themselves. `sensitivity` (3, 3) is what the acceleration
    adds to the rates, in rad/s per m/s^2.
    """
    before, behind = ends
    span = slice(before.stop - 1, behind.first + 1)
    seconds = track.seconds[span]
    share = np.clip((seconds - before.time) / (behind.time - before.time), 0.0, 1.0)
    bias = before.rate + share[:, None] * (behind.rate - before.rate)
    beside = np.zeros((len(seconds), 3))
    if track.accelerations is not None:
        ahead, later = before.acceleration, behind.acceleration
        beside = track.accelerations[span] - ahead - share[:, None] * (later - ahead)
    bias += beside @ sensitivity.T
    steps = np.diff(seconds)
    parts = grouped_steps(steps, track.period, *integrals(track.rates[span] - bias, steps))
    middle = 0.5 * (share[1:] + share[:-1]) * steps
    return Leg(
        track=number,
        rests=rests,
        time=float(seconds[0]),
        seconds=float(np.ptp(seconds)),
        steps=parts.lengths,
        angles=parts.angles,
        coning=parts.coning,
        share=np.add.reduceat(middle, parts.first) / parts.lengths,
        push=steps @ beside[1:],
    )


def integrals(rates: Floats, steps: Floats) -> tuple[Floats, Floats]:
    """Return two terms (n, 3) of the rotation vector of each step between rates (n + 1, 3).

    The rate in rad/s is taken to go straight from sample to sample (Magnus expansion to its second
    term, by which the axis turns).
    """
    angles = 0.5 * steps[:, None] * (rates[1:] + rates[:-1])
    return angles, (steps**2 / 12.0)[:, None] * np.cross(rates[:-1], rates[1:])


@dataclass(frozen=True)
class GroupedSteps:
    """Steps that are taken together, m of n.

    Attributes:
        first: (m,) index of the first step of each.
        lengths: (m,) in s.
        angles: (m, 3) and coning (m, 3): the two terms of each.
        angles_before: (n, 3) and coning_before (n, 3): those from such a first step up to a step.
    """

    first: Integers
    lengths: Floats
    angles: Floats
    coning: Floats
    angles_before: Floats
    coning_before: Floats


def grouped_steps(steps: Floats, period: float, angles: Floats, coning: Floats) -> GroupedSteps:
    """Take steps (n,) in s of samples that come in a period together, with their two terms."""
    first = np.arange(0, len(steps), max(1, round(STEP_SECONDS / period)))
    sizes = np.diff(first, append=len(steps))

    def before(each: Floats) -> Floats:
        since = np.cumsum(each, axis=0) - each
        return np.asarray(since - np.repeat(since[first], sizes, axis=0))

    angles_before = before(angles)
    coning = coning + 0.5 * np.cross(angles_before, angles)
    return GroupedSteps(
        first=first,
        lengths=np.add.reduceat(steps, first),
        angles=np.add.reduceat(angles, first),
        coning=np.add.reduceat(coning, first),
        angles_before=angles_before,
        coning_before=before(coning),
    )


def step_vectors(angles: Floats, coning: Floats, matrix: Floats) -> Floats:
    """Return the rotation vectors (n, 3) of steps with a matrix, from the two terms without."""
    cofactors = np.cross(matrix[[1, 2, 0]], matrix[[2, 0, 1]])  # M a x M b = cofactors (a x b)
    return np.asarray(angles @ matrix.T + coning @ cofactors.T)


def rotations(vectors: Floats) -> tuple[Floats, Floats]:
    """Return the rotation since the start, before (n + 1, 4) and in the middle of (n, 4) steps."""
    before = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], running_products(from_vectors(vectors))])
    return before, multiply(before[:-1], from_vectors(0.5 * vectors))


def turn(leg: Leg, matrix: Floats) -> tuple[Turn, Derivatives]:
    """Return what a leg is with a matrix (3, 3), and how that depends on matrix and biases."""
    vectors = step_vectors(leg.angles, leg.coning, matrix)
    before, middle = rotations(vectors)
    axes = Rotation.from_quat(middle).as_matrix()
    # Of the axis i of the turned sensor, times the raw rate j, in the axes of the start.
    by_matrix = (axes.reshape(-1, 9).T @ leg.angles).reshape(3, 9)
    weighted = -leg.steps[:, None, None] * axes
    behind = np.tensordot(leg.share, weighted, 1) @ matrix
    whole = weighted.sum(axis=0) @ matrix
    way = Turn(Rotation.from_quat(before[-1]).as_matrix(), _angle(vectors))
    return way, Derivatives(by_matrix, (whole - behind, behind))


def turn_alone(leg: Leg, matrix: Floats) -> Turn:
    """Return what a leg is with a matrix (3, 3)."""
    vectors = step_vectors(leg.angles, leg.coning, matrix)
    rotation = running_products(from_vectors(vectors))[-1]
    return Turn(Rotation.from_quat(rotation).as_matrix(), _angle(vectors))


def _angle(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).sum())
