"""A simulated sensor that a hand turns about all axes, with rests between."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.simulation.experiments import GRAVITY, START, Simulation

Floats = NDArray[np.float64]


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
    for k in range(settings.motions):
        where = slice((k + 1) * rest + k * motion, (k + 1) * (rest + motion))
        rates[where] = settings.turning * _smooth(random, motion, settings)
        pushes[where] = settings.pushing * _smooth(random, motion, settings)
        moving[where] = True
    gravity = _gravity(rates / settings.sample_rate)
    bias = np.array(settings.bias)
    accelerations = gravity + pushes
    return Simulation(
        stamps=START + np.round(np.arange(n) * (1e9 / settings.sample_rate)).astype(np.int64),
        angular_velocity=rates + bias + settings.noise * random.standard_normal((n, 3)),
        linear_acceleration=accelerations
        + settings.acceleration_noise * random.standard_normal((n, 3)),
        truth=rates + bias,
        outliers=np.zeros((n, 3), bool),
        moving=moving,
        bias=bias,
    )


def _smooth(random: np.random.Generator, n: int, settings: HandlingSettings) -> Floats:
    """Return (n, 3) of motion of deviation 1 that begins and ends gently, with a mean of 0."""
    spectrum = np.fft.rfft(random.standard_normal((n, 3)), axis=0)
    spectrum[np.fft.rfftfreq(n, 1.0 / settings.sample_rate) > settings.frequency] = 0.0
    spectrum[0] = 0.0
    motion = np.fft.irfft(spectrum, n, axis=0)
    ramp = min(n // 2, round(0.5 * settings.sample_rate))
    edge = 0.5 - 0.5 * np.cos(np.pi * np.arange(ramp) / ramp)
    motion[:ramp] *= edge[:, None]
    motion[n - ramp :] *= edge[::-1, None]
    return np.asarray(motion / motion.std())


def _gravity(turns: Floats) -> Floats:
    """Return what an accelerometer shows of gravity (n, 3) that turns by vectors (n, 3) in rad."""
    gravity, now = np.empty_like(turns), np.array([0.0, 0.0, GRAVITY])
    # Half of a turn before each sample, half behind it, as rates are those at the sample.
    for k, turn in enumerate(turns):
        now = _turned(now, -0.5 * turn)
        gravity[k] = now
        now = _turned(now, -0.5 * turn)
    return gravity


def _turned(vector: Floats, turn: Floats) -> Floats:
    """Return a vector (3,) turned by a rotation vector (3,), after Rodrigues."""
    angle = float(np.sqrt(turn @ turn))
    if angle == 0.0:
        return vector
    axis = turn / angle
    x, y, z = axis
    a, b, c = vector
    across = np.array([y * c - z * b, z * a - x * c, x * b - y * a])
    along = axis * (axis @ vector) * (1.0 - np.cos(angle))
    return np.asarray(vector * np.cos(angle) + across * np.sin(angle) + along)
