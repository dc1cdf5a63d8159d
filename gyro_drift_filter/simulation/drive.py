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

"""A simulated robot that drives and stands, with a gyroscope as they are."""

from typing import NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.simulation.experiments import Simulation
from gyro_drift_filter.simulation.sensor import even_stamps

SAMPLE_RATE = 100.0  # Hz
NOISE, ACCELERATION_NOISE = 2e-3, 0.03  # of an MPU6050: rad/s, m/s^2
# In rad/s: when it is switched on, and by how much more when it is warm, with this time constant
# in s.
COLD_BIAS, WARMING, WARMING_SECONDS = (0.01, -0.02, 0.015), (0.004, -0.003, 0.006), 60.0
# Shares of the samples: spikes of each axis while it drives, as motors make them, of this size in
# rad/s; and messages that repeat the rates before them, as of a driver that polls too early.
SPIKES, SPIKE_SIZE, REPEATS = 0.005, (1.0, 5.0), 0.02
_SHAKE = 0.01  # rad/s, of roll and pitch while it drives


class Drive(NamedTuple):
    """A recording of n samples, and the rates without the bias, (n, 3) in rad/s."""

    recording: Simulation
    rates: Floats


def simulate_drive(
    seed: int = 0, *, rest: float = 10.0, motion: float = 20.0, motions: int = 4
) -> Drive:
    """Return a robot that stands, drives through turns, stands, and so on.

    Args:
        seed: Of the random numbers.
        rest: Length of each rest in s; one is at each end.
        motion: Length of each drive in s.
        motions: How many drives there are.
    """
    random = np.random.default_rng(seed)
    n = round((rest + motions * (motion + rest)) * SAMPLE_RATE)
    time = np.arange(n) / SAMPLE_RATE
    into = time % (rest + motion) - rest
    moving = (into >= 0.0) & (time < n / SAMPLE_RATE - rest)
    # Each drive begins and ends gently: turns to either side, which do not cancel.
    gentle = np.where(moving, np.sin(np.pi * np.clip(into / motion, 0.0, 1.0)) ** 2, 0.0)
    rates = _SHAKE * np.sin(2 * np.pi * np.outer(time, (1.7, 2.3, 0.0)))
    rates[:, 2] = 0.3 + 0.6 * np.sin(2 * np.pi * 0.15 * time)
    rates *= gentle[:, None]
    bias = COLD_BIAS + np.outer(1.0 - np.exp(-time / WARMING_SECONDS), WARMING)
    measured = rates + bias + NOISE * random.standard_normal((n, 3))
    for k in np.flatnonzero(random.random(n - 1) < REPEATS) + 1:
        measured[k] = measured[k - 1]
    outliers = (random.random((n, 3)) < SPIKES) & moving[:, None]
    sizes = random.choice([-1.0, 1.0], (n, 3)) * random.uniform(*SPIKE_SIZE, (n, 3))
    forces = np.array([0.0, 0.0, GRAVITY]) + ACCELERATION_NOISE * random.standard_normal((n, 3))
    forces[:, 0] += 0.5 * gentle * np.sin(2 * np.pi * 0.4 * time)
    recording = Simulation(
        stamps=even_stamps(n, SAMPLE_RATE),
        angular_velocity=measured + np.where(outliers, sizes, 0.0),
        linear_acceleration=forces,
        truth=rates + bias,
        outliers=outliers,
        moving=moving,
        bias=np.array(COLD_BIAS),
    )
    return Drive(recording, rates)
