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

"""A simulated sensor that a hand turns about all axes, with rests between."""

from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.rotations import from_vectors, inverse, multiply, rotate, running_products
from gyro_drift_filter.simulation.experiments import Simulation
from gyro_drift_filter.simulation.sensor import (
    Faults,
    Motion,
    Noise,
    even_stamps,
    measure,
    smooth,
)


@dataclass(frozen=True)
class HandlingSettings:
    """What is simulated; the noise is that of an MPU6050.

    Attributes:
        seed: Of the random numbers.
        sample_rate: In Hz.
        rest_seconds: Length of each rest; one is at each end.
        motion_seconds: Length of each motion.
        motions: How many there are.
        turning: Standard deviation of the rates in motion, in rad/s.
        frequency: Up to which they vary, in Hz.
        pushing: Standard deviation of the accelerations in motion, in m/s^2.
        noise: Standard deviation of the noise of the rates, in rad/s.
        acceleration_noise: The same of the accelerations, in m/s^2.
        bias: (3,) in rad/s.
    """

    seed: int = 0
    sample_rate: float = 100.0
    rest_seconds: float = 6.0
    motion_seconds: float = 12.0
    motions: int = 4
    turning: float = 1.0
    frequency: float = 1.0
    pushing: float = 1.0
    noise: float = 2e-3
    acceleration_noise: float = 0.03
    bias: tuple[float, float, float] = (0.01, -0.02, 0.005)


def simulate_handling(settings: HandlingSettings = HandlingSettings()) -> Simulation:
    """Return a sensor that rests, is turned about all axes at once, rests, and so on."""
    random = np.random.default_rng(settings.seed)
    rest, motion = (
        round(seconds * settings.sample_rate)
        for seconds in (settings.rest_seconds, settings.motion_seconds)
    )
    n = rest + settings.motions * (motion + rest)
    rates, pushes, moving = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n, bool)
    frequency, rate = settings.frequency, settings.sample_rate
    for k in range(settings.motions):
        where = slice((k + 1) * rest + k * motion, (k + 1) * (rest + motion))
        rates[where] = settings.turning * smooth(random, motion, rate, frequency)
        pushes[where] = settings.pushing * smooth(random, motion, rate, frequency)
        moving[where] = True
    # Half of a turn before each sample, half behind it, as rates are those at the sample.
    half = from_vectors(rates / (2.0 * rate))
    turns = half.copy()
    turns[1:] = multiply(half[:-1], half[1:])
    orientations = running_products(turns)
    forces = rotate(inverse(orientations), np.array([0.0, 0.0, GRAVITY])) + pushes
    root = np.sqrt(0.5 * rate)
    measured = measure(
        random,
        Motion(rate, rates, forces, orientations),
        Faults(np.array(settings.bias)),
        Noise(settings.noise / root, settings.acceleration_noise / root),
    )
    return Simulation(
        stamps=even_stamps(n, rate),
        angular_velocity=measured.rates,
        linear_acceleration=measured.accelerations,
        truth=rates + measured.bias,
        outliers=np.zeros((n, 3), bool),
        moving=moving,
        bias=np.array(settings.bias),
    )
