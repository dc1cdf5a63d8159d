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

"""A simulated fleet: robots that drive and stand once a day, some that get worse, broken bags."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

import numpy as np

from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_messages
from gyro_drift_filter.simulation.sensor import even_stamps

_DAY = 86_400 * 10**9  # ns
# Of an MPU6050, in rad/s: noise, and by how much it and the bias differ from day to day.
_NOISE, _NOISE_SCATTER = 2e-3, 0.02
_BIAS, _TURN_ON = 0.01, 2e-4
_ACCELERATION_NOISE = 0.03  # m/s^2
# Shares of the samples in motion, and sizes in rad/s, of spikes that motors make.
_SPIKES, _SPIKE_SIZE = 0.002, (1.0, 5.0)
# Samples that are lost in one gap.
_GAP = 5


class Fault(StrEnum):
    """How a gyroscope gets worse, from half time on."""

    BIAS = 'bias'  # it jumps, on one axis
    NOISE = 'noise'  # it is three times as large
    OUTLIERS = 'outliers'  # their share in motion grows, to a tenth
    DRIFT = 'drift'  # the bias moves on, by 0.1 deg/s a bag, on one axis
    WEAR = 'wear'  # the noise grows by a tenth a bag
    GAPS = 'gaps'  # they come more often, up to one in a second
    FROZEN = 'frozen'  # one axis says the same at all times

    @property
    def quantity(self) -> str:
        """What the table shows it by."""
        return {Fault.DRIFT: 'bias', Fault.WEAR: 'noise'}.get(self, str(self))


@dataclass(frozen=True)
class FleetSettings:
    """What is simulated.

    Attributes:
        robots: How many.
        bags: Of each, a day apart.
        seconds: Of each bag: a third each of rest, drive and rest.
        sample_rate: In Hz.
        faults: By the number of the robot.
        broken_every: One bag of each so many is broken; 0 for none.
        seed: Of the random numbers.
    """

    robots: int = 20
    bags: int = 10
    seconds: float = 60.0
    sample_rate: float = 100.0
    faults: Mapping[int, Fault] = field(
        default_factory=lambda: {3: Fault.BIAS, 8: Fault.NOISE, 15: Fault.OUTLIERS}
    )
    broken_every: int = 10
    seed: int = 0


def robot_name(number: int) -> str:
    """Return the name of a robot, which is that of the folder with its bags."""
    return f'robot_{number:02}'


def write_fleet(folder: Path, settings: FleetSettings) -> list[Path]:
    """Write the bags of a fleet below a folder: robot_00/day_00 and so on.

    Returns:
        Those that are broken.

    Raises:
        BagError: One can't be written.
    """
    broken: list[Path] = []
    for robot in range(settings.robots):
        for day in range(settings.bags):
            bag = folder / robot_name(robot) / f'day_{day:02}'
            _write_bag(bag, settings, robot, day)
            number = robot * settings.bags + day
            # Not the same day of each robot.
            if settings.broken_every and (number + robot) % settings.broken_every == 0:
                _break(bag, len(broken))
                broken.append(bag)
    return broken


def _write_bag(bag: Path, settings: FleetSettings, robot: int, day: int) -> None:
    random = np.random.default_rng((settings.seed, robot, day))
    of_robot = np.random.default_rng((settings.seed, robot))
    n = round(settings.seconds * settings.sample_rate)
    fault, late = settings.faults.get(robot), day - settings.bags // 2
    noise = _NOISE * of_robot.uniform(0.8, 1.2) * np.exp(_NOISE_SCATTER * random.standard_normal())
    bias = _BIAS * of_robot.standard_normal(3) + _TURN_ON * random.standard_normal(3)
    spikes, gaps, is_frozen = _SPIKES, 0.0, False
    grown = (late + 1) / (settings.bags - settings.bags // 2)
    if fault is not None and late >= 0:
        match fault:
            case Fault.BIAS:
                bias[1] += 0.03
            case Fault.NOISE:
                noise *= 3.0
            case Fault.OUTLIERS:
                spikes += 0.1 * grown
            case Fault.DRIFT:
                bias[1] += math.radians(0.1) * (late + 1)
            case Fault.WEAR:
                noise *= 1.1 ** (late + 1)
            case Fault.GAPS:
                gaps = grown / settings.sample_rate
            case Fault.FROZEN:
                is_frozen = True
    time = np.arange(n) / settings.sample_rate
    third = settings.seconds / 3.0
    moving = (time >= third) & (time < 2.0 * third)
    gentle = np.where(moving, np.sin(np.pi * np.clip((time - third) / third, 0.0, 1.0)) ** 2, 0.0)
    rates = bias + noise * random.standard_normal((n, 3))
    rates[:, 2] += gentle * (0.3 + 0.6 * np.sin(2 * np.pi * 0.15 * time))
    flagged = (random.random((n, 3)) < spikes) & moving[:, None]
    signs = random.choice([-1.0, 1.0], (n, 3))
    rates += np.where(flagged, signs * random.uniform(*_SPIKE_SIZE, (n, 3)), 0.0)
    forces = np.array([0.0, 0.0, GRAVITY]) + _ACCELERATION_NOISE * random.standard_normal((n, 3))
    stamps = even_stamps(n, settings.sample_rate) + day * _DAY
    if is_frozen:
        rates[:, 0] = bias[0]
    if gaps:
        lost = np.flatnonzero(random.random(n) < gaps)[:, None] + np.arange(_GAP)
        there = ~np.isin(np.arange(n), lost)
        stamps, rates, forces = stamps[there], rates[there], forces[there]
    with BagWriter(bag) as writer:
        connection = writer.add_connection(TOPIC, IMU_TYPE)
        for stamp, message in imu_messages(stamps, rates, forces):
            writer.write(connection, stamp, message)


def _break(bag: Path, kind: int) -> None:
    """Break a bag in one of five ways."""
    file = bag / f'{bag.name}.mcap'
    data = file.read_bytes()
    match kind % 5:
        case 0:
            file.write_bytes(b'')
        case 1:
            file.write_bytes(b'this is no bag\n' * 100)
        case 2:  # within the first chunk
            file.write_bytes(data[:500] + bytes(200) + data[700:])
        case 3:
            (bag / 'metadata.yaml').write_text('no: metadata\n', encoding='utf-8')
        case 4:
            file.unlink()
