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
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from gyro_drift_filter.calibrate.rests import Rest, Track
from gyro_drift_filter.rotations import from_vectors, multiply, running_products

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Leg:
    """The way from a rest to the next one.

    Attributes:
        track: Index of its recording.
        rests: Indexes of the two rests among all.
        time: Of its start in s.
        seconds: Its length.
        steps: (n,) times between samples in s.
        raw: (n + 1, 3) rates less the bias that goes from that of one rest to that of the other,
            in rad/s.
        share: (n,) of the way from the one bias to the other.
        push: (3,) the acceleration beside one that goes straight from rest to rest, summed up, in
            m/s: what the dependence of the bias on it has done.
    """

    track: int
    rests: tuple[int, int]
    time: float
    seconds: float
    steps: Floats
    raw: Floats
    share: Floats
    push: Floats


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
    """Return the leg between two rests of a track.

    Args:
        track: Of the recording.
        number: Index of the recording.
        rests: Indexes of the two rests.
        ends: The rests themselves.
        sensitivity: (3, 3) what the acceleration adds to the rates, in rad/s per m/s^2.
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
    return Leg(
        track=number,
        rests=rests,
        time=float(seconds[0]),
        seconds=float(np.ptp(seconds)),
        steps=steps,
        raw=track.rates[span] - bias,
        share=0.5 * (share[1:] + share[:-1]),
        push=steps @ beside[1:],
    )


def step_vectors(rates: Floats, steps: Floats) -> Floats:
    """Return the rotation vector (n, 3) of each step between rates (n + 1, 3) in rad/s.

    The rate is taken to go straight from sample to sample (Magnus expansion to its second term).
    """
    vectors = 0.5 * steps[:, None] * (rates[1:] + rates[:-1])
    return np.asarray(vectors + (steps**2 / 12.0)[:, None] * np.cross(rates[:-1], rates[1:]))


def rotations(raw: Floats, steps: Floats, matrix: Floats) -> tuple[Floats, Floats]:
    """Return the rotation since the start, before (n + 1, 4) and in the middle of (n, 4) steps.

    Args:
        raw: (n + 1, 3) in rad/s, with the bias off.
        steps: (n,) in s.
        matrix: (3, 3).
    """
    vectors = step_vectors(raw @ matrix.T, steps)
    before = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], running_products(from_vectors(vectors))])
    return before, multiply(before[:-1], from_vectors(0.5 * vectors))


def turn(leg: Leg, matrix: Floats) -> tuple[Turn, Derivatives]:
    """Return what a leg is with a matrix (3, 3), and how that depends on matrix and biases."""
    before, middle = rotations(leg.raw, leg.steps, matrix)
    mean = 0.5 * (leg.raw[1:] + leg.raw[:-1]) * leg.steps[:, None]
    axes = Rotation.from_quat(middle).as_matrix()
    # Of the axis i of the turned sensor, times the raw rate j, in the axes of the start.
    by_matrix = (axes.reshape(-1, 9).T @ mean).reshape(3, 9)
    weighted = -leg.steps[:, None, None] * axes
    behind = np.tensordot(leg.share, weighted, 1) @ matrix
    whole = weighted.sum(axis=0) @ matrix
    way = Turn(Rotation.from_quat(before[-1]).as_matrix(), _angle(mean @ matrix.T))
    return way, Derivatives(by_matrix, (whole - behind, behind))


def turn_alone(leg: Leg, matrix: Floats) -> Turn:
    """Return what a leg is with a matrix (3, 3)."""
    vectors = step_vectors(leg.raw @ matrix.T, leg.steps)
    rotation = running_products(from_vectors(vectors))[-1]
    return Turn(Rotation.from_quat(rotation).as_matrix(), _angle(vectors))


def _angle(vectors: Floats) -> float:
    return float(np.linalg.norm(vectors, axis=1).sum())
