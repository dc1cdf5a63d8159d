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

"""A sensor that is turned by hand and laid down again, with scale, misalignment and bias."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.simulation.sensor import DEGREE, Faults, Motion, Noise, even_stamps, measure

# An MPU6050 by its data sheet, with counts of the ranges that are fast enough for a hand.
SENSOR_NOISE = Noise(
    rate_density=0.005 * DEGREE,
    acceleration_density=400e-6 * GRAVITY,
    rate_count=DEGREE / 65.5,
    acceleration_count=GRAVITY / 16384,
)
# From the point about which a hand turns it, in m.
_LEVER = np.array([0.08, -0.03, 0.05])
_STEP = 1e-4  # s, for differences


@dataclass(frozen=True)
class Turns:
    """A recording and its truth, n samples.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) raw in rad/s.
        accelerations: (n, 3) raw in m/s^2.
        orientations: (n, 4) from the sensor's axes to the world's, x, y, z, w.
        faults: Of the sensor.
    """

    stamps: Integers
    rates: Floats
    accelerations: Floats
    orientations: Floats
    faults: Faults


def random_faults(random: np.random.Generator) -> Faults:
    """Return a MEMS sensor as they are sold: scale to 3 %, misalignment to 2 deg."""

    def matrix() -> Floats:
        return np.asarray(
            np.diag(1.0 + random.uniform(-0.03, 0.03, 3))
            + random.uniform(-2.0, 2.0, (3, 3)) * DEGREE * (1.0 - np.eye(3))
        )

    return Faults(
        matrix=matrix(),
        bias=random.uniform(-3.0, 3.0, 3) * DEGREE,
        wander=0.002 * DEGREE,
        accelerometer=np.triu(matrix()),
        accelerometer_bias=random.uniform(-0.05, 0.05, 3) * GRAVITY,
    )


def sides(random: np.random.Generator) -> list[Rotation]:
    """Return twelve poses: on the six faces of the case and on six of its edges, headings any."""
    directions = np.vstack(
        [
            np.eye(3),
            -np.eye(3),
            1.0 - np.eye(3),
            (1.0 - np.eye(3)) * [[1, 1, -1], [1, 1, -1], [-1, 1, 1]],
        ]
    )
    out = []
    for up in random.permutation(directions):
        heading = Rotation.from_rotvec([0.0, 0.0, random.uniform(-np.pi, np.pi)])
        # A table is level to a degree or so, which nobody needs to know.
        out.append(heading * Rotation.align_vectors([[0.01, 0.02, 1.0]], [up])[0])
    return out


def lay_down(
    random: np.random.Generator,
    poses: Sequence[Rotation],
    faults: Faults,
    *,
    rest: float = 4.0,
    way: float = 2.5,
    rate: float = 100.0,
    turns: Sequence[Floats] | None = None,
    wobble: float = 0.3,
) -> Turns:
    """Return a sensor that is laid down in poses, one after the other.

    Args:
        random: Noise and the way of the hand.
        poses: From the sensor's axes to the world's.
        faults: Of the sensor.
        rest: In each pose, s.
        way: Between two, s.
        rate: Of the samples, Hz.
        wobble: Of the hand on the way, rad.
        turns: Rotation vector of each way in rad, in the axes of the pose before it; None for the
            shortest ways.
    """
    period = rest + way
    count = round((len(poses) * period - way) * rate)
    times = np.arange(count) / rate
    wobbles = random.normal(0.0, 1.0, (len(poses), 3)) * wobble
    if turns is None:
        turns = [(a.inv() * b).as_rotvec() for a, b in pairwise(poses)]
    vectors = np.vstack([np.reshape(turns, (-1, 3)), np.zeros(3)])
    quaternions = np.array([pose.as_quat() for pose in poses])

    def orientation(at: Floats) -> Rotation:
        number = np.clip((at // period).astype(int), 0, len(poses) - 1)
        share = np.clip((at - number * period - rest) / way, 0.0, 1.0)
        # Least jerk: rate and acceleration begin and end with zero. The hand wobbles by a bump.
        smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
        bump = (4.0 * share * (1.0 - share)) ** 3
        return (
            Rotation.from_quat(quaternions[number])
            * Rotation.from_rotvec(smooth[:, None] * vectors[number])
            * Rotation.from_rotvec(bump[:, None] * wobbles[number] * (share[:, None] < 1.0))
        )

    def angular(at: Floats) -> Floats:
        step = orientation(at - _STEP).inv() * orientation(at + _STEP)
        return np.asarray(step.as_rotvec() / (2.0 * _STEP))

    now, omega = orientation(times), angular(times)
    slope = (angular(times + _STEP) - angular(times - _STEP)) / (2.0 * _STEP)
    force = now.inv().apply([0.0, 0.0, GRAVITY]) + np.cross(slope, _LEVER)
    force += np.cross(omega, np.cross(omega, _LEVER))
    motion = Motion(rate, omega, force, now.as_quat())
    measured = measure(random, motion, faults, SENSOR_NOISE)
    return Turns(
        even_stamps(count, rate),
        measured.rates,
        measured.accelerations,
        motion.orientations,
        faults,
    )
