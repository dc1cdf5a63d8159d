"""How a sensor turned between two rests, by its rates and a matrix, and what that depends on.

With the rate M x, x = raw - bias, the rotation R from the first rest to the second changes by

    dR = [dphi] R,   dphi = sum R(t) dM x(t) dt

in the axes of the first rest, so one pass over the samples gives rotation and sensitivities.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.calibrate.rests import Rest, Track
from gyro_drift_filter.calibrate.rotations import (
    from_vectors,
    multiply,
    running_products,
    to_matrices,
)

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
    """

    track: int
    rests: tuple[int, int]
    time: float
    seconds: float
    steps: Floats
    raw: Floats
    share: Floats


@dataclass(frozen=True)
class Turn:
    """What a leg is with a matrix.

    Attributes:
        rotation: (3, 3) from the axes at its end to those at its start.
        by_matrix: (3, 9) of its rotation vector, by the entries of the matrix row by row.
        by_biases: Two (3, 3), by the bias of the rest before and of the one behind, in s.
        angle: By how much it was turned in all, in rad.
    """

    rotation: Floats
    by_matrix: Floats
    by_biases: tuple[Floats, Floats]
    angle: float


def make_leg(
    track: Track,
    number: int,
    rests: tuple[int, int],
    ends: tuple[Rest, Rest],
    by_force: Floats,
) -> Leg:
    """Return the leg between two rests of a track.

    Args:
        track: Of the recording.
        number: Index of the recording.
        rests: Indexes of the two rests.
        ends: The rests themselves.
        by_force: (3, 3) how the bias depends on the acceleration, in rad/s for each m/s^2.
    """
    before, behind = ends
    span = slice(before.stop - 1, behind.first + 1)
    seconds = track.seconds[span]
    share = np.clip((seconds - before.time) / (behind.time - before.time), 0.0, 1.0)
    bias = before.rate + share[:, None] * (behind.rate - before.rate)
    if track.accelerations is not None:
        ahead, later = before.acceleration, behind.acceleration
        straight = ahead + share[:, None] * (later - ahead)
        bias = bias + (track.accelerations[span] - straight) @ by_force.T
    return Leg(
        number,
        rests,
        float(seconds[0]),
        float(np.ptp(seconds)),
        np.diff(seconds),
        track.rates[span] - bias,
        0.5 * (share[1:] + share[:-1]),
    )


def rotations(raw: Floats, steps: Floats, matrix: Floats) -> tuple[Floats, Floats]:
    """Return the rotation since the start, before (n + 1, 4) and in the middle of (n, 4) steps.

    The rate is taken to go straight from sample to sample (Magnus expansion to its second term).

    Args:
        raw: (n + 1, 3) in rad/s, with the bias off.
        steps: (n,) in s.
        matrix: (3, 3).
    """
    rate = raw @ matrix.T
    vectors = 0.5 * steps[:, None] * (rate[1:] + rate[:-1])
    vectors += (steps**2 / 12.0)[:, None] * np.cross(rate[:-1], rate[1:])
    before = np.concatenate([[[0.0, 0.0, 0.0, 1.0]], running_products(from_vectors(vectors))])
    return before, multiply(before[:-1], from_vectors(0.5 * vectors))


def turn(leg: Leg, matrix: Floats) -> Turn:
    """Return what a leg is with a matrix (3, 3)."""
    before, middle = rotations(leg.raw, leg.steps, matrix)
    mean = 0.5 * (leg.raw[1:] + leg.raw[:-1]) * leg.steps[:, None]
    axes = to_matrices(middle)
    # Of the axis i of the turned sensor, times the raw rate j, in the axes of the start.
    by_matrix = (axes.reshape(-1, 9).T @ mean).reshape(3, 9)
    weighted = -leg.steps[:, None, None] * axes
    behind = np.tensordot(leg.share, weighted, 1) @ matrix
    whole = weighted.sum(axis=0) @ matrix
    return Turn(
        to_matrices(before[-1:])[0],
        by_matrix,
        (whole - behind, behind),
        float(np.linalg.norm(mean @ matrix.T, axis=1).sum()),
    )
