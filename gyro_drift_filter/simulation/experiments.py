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

"""Simulated gyroscope data with truth: the two experiments of the paper's section 4."""

from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.rotations import from_vectors, rotate
from gyro_drift_filter.simulation.sensor import even_stamps


@dataclass(frozen=True)
class Simulation:
    """A recording and its truth, n samples.

    Attributes:
        stamps: (n,) in ns.
        angular_velocity: (n, 3) as the gyroscope measures it, in rad/s.
        linear_acceleration: (n, 3) in m/s^2: gravity, as the true rates turn it, and noise.
        truth: (n, 3) true rate plus bias, in rad/s: what a filter that leaves the bias in can
            reach.
        outliers: (n, 3), True where an outlier was added.
        moving: (n,), True in the dynamic part.
        bias: (3,) in rad/s.
    """

    stamps: Integers
    angular_velocity: Floats
    linear_acceleration: Floats
    truth: Floats
    outliers: Bools
    moving: Bools
    bias: Floats


@dataclass(frozen=True)
class SimulationSettings:
    """What is simulated; the defaults fit the filter's default model.

    Attributes:
        seed: Of the random numbers.
        sample_rate: In Hz.
        static_seconds: Length of the motionless part, which comes first.
        dynamic_seconds: Length of the part with the sinusoid.
        phi: Coefficient of the AR(1) drift, equation (2).
        drift_deviation: Standard deviation of the noise that drives it, in rad/s.
        white_deviation: Standard deviation of the white noise beside it, in rad/s.
        bias: (3,) in rad/s.
        amplitude: Of the sinusoid, in rad/s.
        frequency: Of the sinusoid, in Hz.
        isolated: Share of samples of the dynamic part, per axis, with an isolated outlier.
        runs: Number of runs of consecutive outliers in the dynamic part, per axis.
        run_length: Samples in a run.
        outlier_size: Smallest and largest size of an outlier, in rad/s.
    """

    seed: int = 0
    sample_rate: float = 100.0
    static_seconds: float = 60.0
    dynamic_seconds: float = 60.0
    phi: float = 0.218
    drift_deviation: float = 4.0e-3
    white_deviation: float = 2.8e-3
    bias: tuple[float, float, float] = (0.01, -0.02, 0.005)
    amplitude: float = 0.1
    frequency: float = 0.1
    isolated: float = 0.005
    runs: int = 5
    run_length: int = 3
    outlier_size: tuple[float, float] = (1.0, 5.0)


def simulate(settings: SimulationSettings) -> Simulation:
    """Return a static part followed by a sinusoid with isolated and consecutive outliers."""
    random = np.random.default_rng(settings.seed)
    static = round(settings.static_seconds * settings.sample_rate)
    n = static + round(settings.dynamic_seconds * settings.sample_rate)
    time = np.arange(n) / settings.sample_rate
    moving = np.arange(n) >= static
    bias = np.array(settings.bias)

    phase = 2 * np.pi * settings.frequency * (time - time[static] if static < n else time)
    rate = np.where(moving, settings.amplitude * np.sin(phase), 0.0)
    truth = rate[:, None] + bias
    # All axes have one rate, so that the body turns about one axis.
    angles = np.cumsum(rate) / settings.sample_rate
    back = from_vectors(-angles[:, None] * np.ones(3))
    gravity = rotate(back, np.array([0.0, 0.0, GRAVITY]))
    drift = autoregressive(random, n, settings.phi, settings.drift_deviation)
    white = settings.white_deviation * random.standard_normal((n, 3))
    measured = truth + drift + white
    outliers = np.zeros((n, 3), bool)
    for axis in range(3):
        outliers[:, axis] = _add_outliers(random, measured[:, axis], static, settings)
    return Simulation(
        stamps=even_stamps(n, settings.sample_rate),
        angular_velocity=measured,
        linear_acceleration=gravity + 0.02 * random.standard_normal((n, 3)),
        truth=truth,
        outliers=outliers,
        moving=moving,
        bias=bias,
    )


def autoregressive(random: np.random.Generator, n: int, phi: float, deviation: float) -> Floats:
    """Return (n, 3) of the stationary process x(k) = phi x(k-1) + w(k), equation (2)."""
    driving = deviation * random.standard_normal((n, 3))
    if n:
        driving[0] /= np.sqrt(1.0 - phi * phi)
    # As plain numbers: numpy would take ten times as long over three of them.
    axes = [accumulate(axis, lambda last, value: phi * last + value) for axis in driving.T.tolist()]
    return np.array([list(axis) for axis in axes]).T.copy()


def _add_outliers(
    random: np.random.Generator,
    rate: Floats,
    first: int,
    settings: SimulationSettings,
) -> Bools:
    """Add outliers to one axis from sample `first` on, in place; return where."""
    where = np.zeros(len(rate), bool)
    count = len(rate) - first
    low, high = settings.outlier_size

    def size() -> float:
        return float(random.choice([-1.0, 1.0]) * random.uniform(low, high))

    for k in random.choice(count, round(settings.isolated * count), replace=False):
        rate[first + k] += size()
        where[first + k] = True
    last = count - settings.run_length
    for k in random.choice(last, settings.runs, replace=False) if last > settings.runs else ():
        run = slice(first + k, first + k + settings.run_length)
        rate[run] += size()
        where[run] = True
    return where
