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

"""Drones, cars, trains, robots on legs and hands with known truth: what an Imu on them shows.

A vehicle is where its motion puts it: velocities and attitudes are laid down first, and rates and
specific forces follow from them. What shakes the sensor besides (rotors, road, feet) comes on top.
Each function takes random numbers, a length in s and a sample rate in Hz; all numbers are SI.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import signal
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.rotations import from_vectors, inverse, multiply, rotate, to_vectors
from gyro_drift_filter.simulation.sensor import (
    DEGREE,
    Faults,
    Motion,
    Noise,
    even_stamps,
    measure,
    smooth,
)

# A small MEMS sensor for robots, as their data sheets have it, and its range.
NOISE = Noise(rate_density=0.007 * DEGREE, acceleration_density=180e-6 * GRAVITY)
ACCELERATION_RANGE = 4.0 * GRAVITY
# What is left of its faults after calibration, and of its bias from one day to the next.
SCALE, MISALIGNMENT, TURN_ON = 1e-3, 1e-3, 0.5 * DEGREE
WANDER = 1e-5  # rad/s per root of a second: 50 deg/h within ten minutes
# By 8 K, at 0.015 deg/s per K, within some minutes.
WARM_UP, WARM_UP_SECONDS = 2e-3, 240.0  # rad/s, s
ACCELEROMETER_BIAS = 0.05  # m/s^2
# By how much strong vibration moves the bias: rectification.
RECTIFIED = 0.7e-3  # rad/s


@dataclass(frozen=True)
class Ride:
    """A recording and its truth, n samples.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) as measured, in rad/s.
        accelerations: (n, 3) as measured, in m/s^2.
        orientations: (n, 4) x, y, z, w, from the sensor's axes to the world's.
        bias: (n, 3) true bias of the rates at each time, in rad/s, with what vibration adds.
        moving: (n,), True while the vehicle moves.
    """

    stamps: Integers
    rates: Floats
    accelerations: Floats
    orientations: Floats
    bias: Floats
    moving: Bools


@dataclass(frozen=True)
class Driven:
    """Where a vehicle goes and what shakes it, n times.

    Attributes:
        velocities: (n, 3) in the world, in m/s.
        attitudes: (n, 4) x, y, z, w, from the body's axes to the world's.
        shaken: (n, 3) rates of vibration, in rad/s.
        pushed: (n, 3) specific forces of vibration in the body's axes, in m/s^2.
        rectified: (n,) share of the largest shift of the bias.
        moving: (n,), True while it moves.
    """

    velocities: Floats
    attitudes: Floats
    shaken: Floats
    pushed: Floats
    rectified: Floats
    moving: Bools


Vehicle = Callable[[np.random.Generator, float, float], Driven]


def ride(
    vehicle: Vehicle,
    seed: int,
    seconds: float = 600.0,
    sample_rate: float = 200.0,
    warm_up: float = WARM_UP,
    turn_on: float = TURN_ON,
    scale: float = SCALE,
    misalignment: float = MISALIGNMENT,
) -> Ride:
    """Return what an Imu shows on a vehicle.

    Args:
        vehicle: One of VEHICLES, or `train`.
        seed: Of all random numbers.
        seconds: Length.
        sample_rate: In Hz.
        warm_up: Deviation of what the bias moves by while the sensor warms up, in rad/s.
        turn_on: Deviation of its bias at the start, in rad/s.
        scale: Deviation of the errors of its axes' scale.
        misalignment: Deviation of what an axis shows of each other one, as a share of it.
    """
    random = np.random.default_rng(seed)
    driven = vehicle(random, seconds, sample_rate)
    motion = _motion(driven, sample_rate)
    matrix = np.eye(3) + misalignment * random.standard_normal((3, 3))
    matrix[np.diag_indices(3)] = 1.0 + scale * random.standard_normal(3)
    faults = Faults(
        bias=turn_on * random.standard_normal(3),
        wander=WANDER,
        matrix=matrix,
        accelerometer_bias=ACCELEROMETER_BIAS * random.standard_normal(3),
    )
    time = np.arange(len(motion.rates)) / sample_rate
    warmth = 1.0 - np.exp(-time / WARM_UP_SECONDS)
    moved = np.outer(driven.rectified, RECTIFIED * random.standard_normal(3))
    moved += warm_up * np.outer(warmth, random.standard_normal(3))
    measured = measure(random, motion, faults, NOISE, moved)
    return Ride(
        even_stamps(len(motion.rates), sample_rate),
        measured.rates,
        np.clip(measured.accelerations, -ACCELERATION_RANGE, ACCELERATION_RANGE),
        motion.orientations,
        measured.bias,
        driven.moving,
    )


def drone(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
    """Return a drone: it idles on the ground, flies from place to place with hovers, and lands.

    Thrust lies along its z axis, so that it tilts to gain speed, and against drag and wind.
    """
    start, end = 10.0, seconds - 12.0
    knots, at, place = [(0.0, np.zeros(3)), (start, np.zeros(3))], start, np.array([0.0, 0.0, 3.0])
    at += 4.0
    knots.append((at, place))
    home = end - 12.0
    while at < home:
        goal = random.uniform([-40.0, -40.0, 2.0], [40.0, 40.0, 8.0])
        way = np.linalg.norm(goal - place) / random.uniform(1.0, 6.0)
        goal = place + (goal - place) * min(1.0, (home - at) / way)
        at, place = min(at + float(way), home), goal
        knots.append((at, place))
        at = min(at + random.uniform(1.0, 8.0), home + 1e-3)
        knots.append((at, place))
    ground = place * [1.0, 1.0, 0.0]
    knots += [(end, ground), (seconds, ground)]
    time = _times(seconds, sample_rate)
    velocities = np.gradient(_path(knots, time, 2.0), 1.0 / sample_rate, axis=0)
    flies = _hann((time > start) & (time < end), 1.0, sample_rate)
    runs = _hann((time > 4.0) & (time < end + 2.0), 1.0, sample_rate) * (0.3 + 0.7 * flies)
    gusts = smooth(random, len(time), sample_rate, 1.0) + random.uniform(-3.0, 3.0, 3)
    wind = velocities - gusts * [1.0, 1.0, 0.3]
    thrust = np.gradient(velocities, 1.0 / sample_rate, axis=0) + 0.25 * wind * flies[:, None]
    thrust[:, 2] += GRAVITY
    lean = thrust / np.linalg.norm(thrust, axis=1)[:, None]
    tilt = np.cross([0.0, 0.0, 1.0], lean)
    sine = np.linalg.norm(tilt, axis=1)
    tilt *= (np.arctan2(sine, lean[:, 2]) / np.maximum(sine, 1e-12))[:, None]
    yaw = _turns(random, time, (start + 5.0, home), (2.0, 15.0), 0.6)
    attitudes = multiply(from_vectors(tilt), from_vectors(np.outer(yaw, [0.0, 0.0, 1.0])))
    shaken, pushed = np.zeros((2, len(time), 3))
    for rotor in 2.0 * np.pi * random.uniform(80.0, 100.0, 4):
        # Faster with more thrust; also twice as fast, by two blades. Both are aliased.
        speed = rotor * np.sqrt(np.linalg.norm(thrust, axis=1) / GRAVITY) * np.sqrt(0.5 + runs)
        phase = np.cumsum(speed) / sample_rate
        for order in (1, 2):
            wave = np.sin(order * phase[:, None] + random.uniform(0.0, 2.0 * np.pi, 3))
            shaken += 0.02 * runs[:, None] * wave
            pushed += 0.8 * runs[:, None] * wave[:, ::-1]
    return Driven(velocities, attitudes, shaken, pushed, runs, flies > 0.0)


def car(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
    """Return a car: long straight roads, turns, potholes, and lights at which it stops."""
    speeds, bends, at = [(0.0, 0.0), (8.0, 0.0)], [(0.0, 0.0)], 8.0
    while at < seconds - 10.0:
        cruise, slow = random.uniform(8.0, 25.0), float(random.choice([0.0, 6.0]))
        at += (cruise - speeds[-1][1]) / random.uniform(1.5, 2.5)
        speeds.append((at, cruise))
        curve = random.uniform(-0.004, 0.004)
        bends += [(at, 0.0), (at + 2.0, curve * random.choice([0.0, 1.0]))]
        at += random.uniform(10.0, 60.0)
        speeds.append((at, cruise))
        bends += [(at, bends[-1][1]), (at + 2.0, 0.0)]
        at += (cruise - slow) / random.uniform(1.5, 3.0) + 2.0
        speeds.append((at, slow))
        if slow > 0.0:
            turn = random.choice([-1.0, 1.0]) * random.uniform(0.05, 0.08)
            bends += [(at, 0.0), (at + 1.0, turn)]
            at += random.uniform(2.0, 5.0)
            bends += [(at, turn), (at + 1.0, 0.0)]
        else:
            at += random.uniform(5.0, 30.0)
        speeds.append((at, slow))
    time = _times(seconds, sample_rate)
    speed, bend = _path(speeds, time, 1.0), _path(bends, time, 1.0)
    yaw = np.cumsum(bend * speed) / sample_rate
    drive = np.clip(speed / 10.0, 0.0, 1.0)[:, None]
    road = drive * smooth(random, len(time), sample_rate, 5.0) * [0.2, 0.2, 0.0] * DEGREE
    holes = _bumps(random, time, drive[:, 0] > 0.5, 20.0)
    shock = _ring(holes, 8.0, 0.1, sample_rate)
    hills = _slopes(random, speed, sample_rate, 100.0, np.array([1.0, 2.0]) * DEGREE)
    push = np.gradient(speed, 1.0 / sample_rate)
    roll = hills[:, 0] + 0.6 * DEGREE * speed * speed * bend + road[:, 0]
    pitch = hills[:, 1] - 0.4 * DEGREE * push + road[:, 1] + 0.5 * DEGREE * shock
    attitudes = _attitudes(yaw, pitch, roll)
    climb = -np.sin(hills[:, 1])
    heading = np.column_stack([np.cos(yaw), np.sin(yaw), climb])
    rough = random.standard_normal((len(time), 3))
    rough = drive * signal.lfilter([1.0, -1.0], [1.0, -0.7], rough, axis=0)
    engine = np.sin(2.0 * np.pi * 27.0 * time)[:, None] * random.uniform(0.5, 1.0, 3)
    pushed = 0.5 * rough + 0.15 * engine
    pushed[:, 2] += 6.0 * shock
    shaken = 0.005 * rough[::-1] + 0.001 * engine
    return Driven(
        speed[:, None] * heading,
        attitudes.as_quat(),
        shaken,
        pushed,
        np.zeros(len(time)),
        speed > 0.0,
    )


def train(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
    """Return a train: up to a minute of speeding up, curves with some cant, and stations."""
    speeds, bends, at = [(0.0, 0.0), (12.0, 0.0)], [(0.0, 0.0)], 12.0
    while at < seconds - 40.0:
        cruise = random.uniform(15.0, 35.0)
        at += cruise / random.uniform(0.3, 0.7)
        speeds.append((at, cruise))
        end = at + random.uniform(30.0, 120.0)
        at += 5.0
        while at < end - 15.0:
            curve = random.uniform(-0.001, 0.001)
            bends += [(at, 0.0), (at + 4.0, curve)]
            at += random.uniform(8.0, 25.0)
            bends += [(at, curve), (at + 4.0, 0.0)]
            at += 4.0 + random.uniform(3.0, 20.0)
        at = max(at, end)
        speeds.append((at, cruise))
        at += cruise / random.uniform(0.4, 0.8)
        speeds.append((at, 0.0))
        at += random.uniform(20.0, 40.0)
        speeds.append((at, 0.0))
    time = _times(seconds, sample_rate)
    speed, bend = _path(speeds, time, 2.0), _path(bends, time, 1.0)
    drive = np.clip(speed / 10.0, 0.0, 1.0)[:, None]
    sway = drive * smooth(random, len(time), sample_rate, 3.0) * [0.15, 0.1, 0.0] * DEGREE
    hills = _slopes(random, speed, sample_rate, 300.0, np.array([0.0, 0.5]) * DEGREE)[:, 1]
    yaw = np.cumsum(bend * speed) / sample_rate
    roll = sway[:, 0] - np.arctan(0.6 * speed * speed * bend / GRAVITY)
    attitudes = _attitudes(yaw, hills + sway[:, 1], roll)
    rough = drive * random.standard_normal((len(time), 3))
    return Driven(
        speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw), -np.sin(hills)]),
        attitudes.as_quat(),
        0.002 * rough[::-1],
        0.15 * rough,
        np.zeros(len(time)),
        speed > 0.0,
    )


def legged(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
    """Return a robot on legs: a cycle of 2 Hz with blows of the feet, turns, stands, slopes."""
    speeds, at = [(0.0, 0.0), (6.0, 0.0)], 6.0
    while at < seconds - 12.0:
        pace = random.uniform(0.4, 1.2)
        walk = min(random.uniform(30.0, 120.0), seconds - 10.0 - at)
        stand = random.uniform(4.0, 12.0)
        speeds += [(at + 1.0, pace), (at + walk, pace), (at + walk + 1.0, 0.0)]
        at += walk + 1.0 + stand
        speeds.append((at, 0.0))
    time = _times(seconds, sample_rate)
    speed = _path(speeds, time, 1.0)
    walks = np.clip(speed / 0.4, 0.0, 1.0)
    phase = 2.0 * np.pi * np.cumsum(1.6 + 0.4 * speed) / sample_rate
    cycle = walks[:, None] * np.column_stack(
        [3.0 * np.sin(0.5 * phase), 2.0 * np.sin(phase + 1.0), 1.5 * np.sin(0.5 * phase + 0.5)]
    )
    sway = walks[:, None] * smooth(random, len(time), sample_rate, 3.0)
    slopes = _slopes(random, speed, sample_rate, 15.0, np.array([3.0, 6.0]) * DEGREE)
    yaw = _turns(random, time, (8.0, seconds - 14.0), (3.0, 20.0), 0.5, walks)
    angles = (cycle + sway) * DEGREE
    angles[:, :2] += slopes
    angles[:, 2] += yaw
    attitudes = _attitudes(*angles.T[::-1])
    velocities = speed[:, None] * np.column_stack([np.cos(yaw), np.sin(yaw), 0.0 * yaw])
    velocities[:, 2] += walks * 0.15 * np.cos(phase)
    steps = np.diff(np.floor(phase / np.pi), prepend=0.0) * walks
    blow = _ring(steps * random.uniform(0.5, 1.5, len(time)), 45.0, 0.015, sample_rate)
    pushed = blow[:, None] * [10.0, 8.0, 40.0]
    shaken = blow[:, None] * [0.2, 0.3, 0.1]
    return Driven(velocities, attitudes.as_quat(), shaken, pushed, 0.5 * walks, speed > 0.0)


def hand(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
    """Return a sensor that is carried about in the hand, which tilts and turns it all the time."""
    time = _times(seconds, sample_rate)
    carried = _hann((time > 6.0) & (time < seconds - 8.0), 1.0, sample_rate)[:, None]
    angles = carried * smooth(random, len(time), sample_rate, 0.3) * [0.5, 0.4, 0.8]
    angles[:, 2] += _turns(random, time, (8.0, seconds - 10.0), (2.0, 10.0), 1.0)
    velocities = carried * smooth(random, len(time), sample_rate, 0.5) * [0.5, 0.5, 0.2]
    nothing = np.zeros_like(velocities)
    return Driven(
        velocities,
        _attitudes(*angles.T[::-1]).as_quat(),
        nothing,
        nothing,
        np.zeros(len(time)),
        carried[:, 0] > 0.0,
    )


def _motion(driven: Driven, sample_rate: float) -> Motion:
    """Return rates and specific forces of a vehicle in its own axes, by central differences."""
    attitudes = driven.attitudes
    rates = np.zeros_like(driven.velocities)
    steps = to_vectors(multiply(inverse(attitudes[:-1]), attitudes[1:])) * sample_rate
    rates[1:-1] = 0.5 * (steps[:-1] + steps[1:])
    push = np.gradient(driven.velocities, 1.0 / sample_rate, axis=0)
    forces = rotate(inverse(attitudes), push + np.array([0.0, 0.0, GRAVITY]))
    return Motion(sample_rate, rates + driven.shaken, forces + driven.pushed, attitudes)


def _times(seconds: float, sample_rate: float) -> Floats:
    return np.arange(round(seconds * sample_rate)) / sample_rate


def _hann(values: Floats | Bools, width: float, sample_rate: float) -> Floats:
    """Return values (n, ...) smoothed over a width in s; what is constant stays exactly so."""
    half = round(0.5 * width * sample_rate)
    weights = np.hanning(2 * half + 3)[1:-1]
    columns = np.asarray(values, float).reshape(len(values), -1).T
    padded = [np.pad(column, half, mode='edge') for column in columns]
    smoothed = [np.convolve(column, weights / weights.sum(), 'valid') for column in padded]
    return np.array(smoothed).T.reshape(values.shape)


def _attitudes(yaw: Floats, pitch: Floats, roll: Floats) -> Rotation:
    """Return attitudes (n,) from angles (n,) in rad; scipy's own function takes far longer."""
    turns = zip((yaw, pitch, roll), np.eye(3)[::-1], strict=True)
    yawed, pitched, rolled = (from_vectors(np.outer(angle, axis)) for angle, axis in turns)
    return Rotation.from_quat(multiply(multiply(yawed, pitched), rolled))


def _path(knots: Sequence[tuple[float, Floats | float]], time: Floats, width: float) -> Floats:
    """Return a path (n, ...) from knot to knot (time and value), smoothed over a width in s."""
    at = np.array([knot[0] for knot in knots])
    values = np.array([knot[1] for knot in knots], float).reshape(len(at), -1)
    path = np.column_stack([np.interp(time, at, column) for column in values.T])
    smoothed = _hann(path, width, 1.0 / (time[1] - time[0]))
    return smoothed if np.ndim(knots[0][1]) else smoothed[:, 0]


def _slopes(
    random: np.random.Generator, speed: Floats, sample_rate: float, apart: float, size: Floats
) -> Floats:
    """Return roll and pitch (n, 2) of the ground in rad, other ones so many m apart.

    They go by with the way, not with time. `size` (2,) are their deviations in rad.
    """
    way = np.cumsum(speed) / sample_rate
    at = np.arange(0.0, way[-1] + 2.0 * apart, apart)
    ground = size * random.standard_normal((len(at), 2))
    return _hann(
        np.column_stack([np.interp(way, at, column) for column in ground.T]), 1.0, sample_rate
    )


def _turns(
    random: np.random.Generator,
    time: Floats,
    between: tuple[float, float],
    apart: tuple[float, float],
    rate: float,
    share: Floats | float = 1.0,
) -> Floats:
    """Return a heading (n,) in rad that turns now and then at up to a rate in rad/s.

    Turns begin within `between`, at the least and the most so many s `apart`; the rate is
    multiplied by a share (n,).
    """
    rates = np.zeros_like(time)
    at = between[0]
    while at < between[1] - 5.0:
        span = random.uniform(1.0, 5.0)
        rates[(time > at) & (time < at + span)] = random.uniform(-rate, rate)
        at += span + random.uniform(*apart)
    period = time[1] - time[0]
    return np.asarray(np.cumsum(_hann(rates, 0.5, 1.0 / period) * share) * period)


def _bumps(random: np.random.Generator, time: Floats, where: Bools, apart: float) -> Floats:
    """Return blows (n,) of sizes about 1, on the average so many s apart, where they may be."""
    hit = random.uniform(size=len(time)) < (time[1] - time[0]) / apart
    return np.asarray(hit * where * random.uniform(0.3, 1.5, len(time)))


def _ring(blows: Floats, frequency: float, decay: float, sample_rate: float) -> Floats:
    """Return what a body does after blows (n,): it rings, at Hz, and the ringing decays in s."""
    time = np.arange(round(8.0 * decay * sample_rate)) / sample_rate
    wave = np.sin(2.0 * np.pi * frequency * time) * np.exp(-time / decay)
    # It ends where it was, with no speed left.
    wave -= np.exp(-time / decay) * wave.sum() / np.exp(-time / decay).sum()
    return np.asarray(np.convolve(blows, wave)[: len(blows)])


VEHICLES: dict[str, Vehicle] = {'drone': drone, 'car': car, 'legged': legged, 'hand': hand}
