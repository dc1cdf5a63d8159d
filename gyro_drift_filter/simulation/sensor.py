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

"""What a gyroscope and an accelerometer make of a motion: their faults, noise and counts."""

from dataclasses import dataclass, field

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers

START = 1_600_000_000_000_000_000  # ns
DEGREE = float(np.radians(1.0))


@dataclass(frozen=True)
class Motion:
    """What a sensor goes through, at n even times.

    Attributes:
        sample_rate: In Hz.
        rates: (n, 3) true angular velocities in its own axes, in rad/s.
        forces: (n, 3) true specific forces there, in m/s^2.
        orientations: (n, 4) unit quaternions x, y, z, w from its axes to the world's.
    """

    sample_rate: float
    rates: Floats
    forces: Floats
    orientations: Floats


@dataclass(frozen=True)
class Faults:
    """What is wrong with a sensor: raw = inverse(matrix) true + bias, for both its halves.

    Attributes:
        bias: (3,) in rad/s.
        wander: Of the bias, in rad/s per root of a second.
        matrix: (3, 3) of the gyroscope.
        accelerometer: (3, 3) upper triangular.
        accelerometer_bias: (3,) in m/s^2.
    """

    bias: Floats
    wander: float = 0.0
    matrix: Floats = field(default_factory=lambda: np.eye(3))
    accelerometer: Floats = field(default_factory=lambda: np.eye(3))
    accelerometer_bias: Floats = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True)
class Noise:
    """White noise, as densities per root of Hz, and counts.

    Attributes:
        rate_density: In rad/s.
        acceleration_density: In m/s^2.
        rate_count: In rad/s, 0 where it is too small to matter.
        acceleration_count: In m/s^2, 0 where it is too small to matter.
    """

    rate_density: float
    acceleration_density: float
    rate_count: float = 0.0
    acceleration_count: float = 0.0


@dataclass(frozen=True)
class Measured:
    """What a sensor shows, n samples.

    Attributes:
        rates: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2.
        bias: (n, 3) of the rates at each time, in rad/s.
    """

    rates: Floats
    accelerations: Floats
    bias: Floats


def measure(
    random: np.random.Generator,
    motion: Motion,
    faults: Faults,
    noise: Noise,
    moved: Floats | float = 0.0,
) -> Measured:
    """Return what a sensor with faults and noise shows of a motion.

    Its bias is another one by `moved` (n, 3) at each time, in rad/s.
    """
    of_rates, of_accelerations, steps = random.standard_normal((3, *motion.rates.shape))
    root = np.sqrt(0.5 * motion.sample_rate)
    bias = faults.bias + moved
    bias = bias + faults.wander * np.cumsum(steps, axis=0) / np.sqrt(motion.sample_rate)
    rates = motion.rates @ np.linalg.inv(faults.matrix).T + bias
    rates += noise.rate_density * root * of_rates
    accelerations = motion.forces @ np.linalg.inv(faults.accelerometer).T
    accelerations += faults.accelerometer_bias
    accelerations += noise.acceleration_density * root * of_accelerations
    return Measured(
        _counted(rates, noise.rate_count),
        _counted(accelerations, noise.acceleration_count),
        bias,
    )


def _counted(values: Floats, count: float) -> Floats:
    return count * np.round(values / count) if count > 0.0 else values


def even_stamps(count: int, sample_rate: float) -> Integers:
    """Return (count,) stamps in ns at a rate in Hz."""
    return START + np.round(np.arange(count) * (1e9 / sample_rate)).astype(np.int64)


def smooth(random: np.random.Generator, n: int, sample_rate: float, frequency: float) -> Floats:
    """Return (n, 3) of motion of deviation 1 up to a frequency, both in Hz.

    It begins and ends gently, and has a mean of about zero.
    """
    spectrum = np.fft.rfft(random.standard_normal((n, 3)), axis=0)
    spectrum[np.fft.rfftfreq(n, 1.0 / sample_rate) > frequency] = 0.0
    spectrum[0] = 0.0
    motion = np.fft.irfft(spectrum, n, axis=0)
    ramp = min(n // 2, round(0.5 * sample_rate))
    edge = 0.5 - 0.5 * np.cos(np.pi * np.arange(ramp) / ramp)
    motion[:ramp] *= edge[:, None]
    motion[n - ramp :] *= edge[::-1, None]
    return np.asarray(motion / motion.std())
