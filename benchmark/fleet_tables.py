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

"""Tables of fleets, drawn by a model without any bag: how sensors scatter, and what is planted."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.fleet.columns import schema
from gyro_drift_filter.simulation.sensor import START

_DAY = 86_400 * 10**9  # ns
_MESSAGES = 6000
_OWN = math.radians(0.003)  # rad/s, that a bias is uncertain by


@dataclass(frozen=True)
class World:
    """How the sensors of a fleet scatter that does well.

    Attributes:
        robots: How many.
        bags: Least and most of a robot, a day apart.
        noise: By which part of it noise differs from day to day.
        bias: By how many deg/s a bias does, as it is turned on.
        tails: Degrees of freedom of Student's t that all of that has; 0 for Gaussian.
        alike: Correlation of a day with the one before.
        season: By how many K the temperature swings in a year; a bias goes with it by 0.02 deg/s/K,
            as the deviation between sensors.
        worse: One robot in five scatters by so many times more.
        spread: Factor by which the scatter of the sensors differs, as their deviation.
        quiet: Part of the bags without any outlier or gap.
        rough: Outliers are so many times more on the worse one of two roads, for five bags each.
        missing: Part of the bags that are missing.
        repaired: Part of the robots that were bad for a while.
    """

    robots: int = 20
    bags: tuple[int, int] = (5, 30)
    noise: float = 0.02
    bias: float = 0.01
    tails: float = 0.0
    alike: float = 0.0
    season: float = 0.0
    worse: float = 1.0
    spread: float = 1.0
    quiet: float = 0.0
    rough: float = 1.0
    missing: float = 0.0
    repaired: float = 0.0


WORLDS = {
    'Gaussian, 4 bags': World(bags=(4, 4)),
    'Gaussian, 10 bags': World(bags=(10, 10)),
    'Gaussian, 2 to 200 bags, a third missing': World(bags=(2, 200), missing=0.33),
    'noise 10 %, bias 1 deg/s from day to day': World(noise=0.1, bias=1.0),
    "Student's t of 3": World(tails=3.0),
    'days correlated by 0.8': World(noise=0.1, bias=0.1, alike=0.8),
    'days correlated by 0.95': World(bags=(10, 60), noise=0.1, bias=0.1, alike=0.95),
    'seasons of 10 K': World(bags=(10, 200), robots=10, season=10.0),
    'one robot in five scatters by 10 times more': World(noise=0.03, bias=0.05, worse=10.0),
    'scatter differs by a factor of 2': World(noise=0.05, bias=0.05, spread=2.0),
    'nine bags in ten without outliers and gaps': World(quiet=0.9),
    'roads, outliers three times more': World(bags=(20, 60), rough=3.0),
    'one robot in five was repaired': World(bags=(8, 40), repaired=0.2),
    'one robot, 10 to 30 bags': World(robots=1, bags=(10, 30)),
    'all of it, scatter by a factor of 1.3': World(
        bags=(4, 60), noise=0.05, bias=0.1, tails=4.0, alike=0.5, spread=1.3, rough=2.0,
        missing=0.1,
    ),
}  # fmt: skip


class Planted(NamedTuple):
    """What gets worse with the first three robots, from half of their bags on.

    Attributes:
        quantity: Of the table.
        size: Factor of the noise, deg/s of the bias of y, shares of the outliers and gaps.
        slowly: Whether it grows from there on up to this size.
        bags: From so many before the last on instead; 0 for half.
    """

    quantity: str
    size: float
    slowly: bool = False
    bags: int = 0


FAULTS = (
    *(Planted('noise', size) for size in (1.2, 1.5, 2.0, 3.0)),
    *(Planted('bias', size) for size in (0.03, 0.1, 0.3, 1.0)),
    *(Planted('outliers', size) for size in (0.005, 0.02, 0.05)),
    *(Planted('gaps', size) for size in (0.002, 0.01)),
    Planted('noise', 3.0, bags=2),
    Planted('noise', 3.0, bags=1),
    Planted('bias', 1.0, bags=2),
    Planted('noise', 2.0, slowly=True),
    Planted('bias', 0.5, slowly=True),
)
GETTING_WORSE = 3


def draw_fleet(world: World, seed: int, planted: Planted | None = None) -> pa.Table:
    """Return the table of a fleet."""
    random = np.random.default_rng(seed)
    rows = []
    for robot in range(world.robots):
        days = int(random.integers(*world.bags, endpoint=True))
        figures = _robot(world, random, robot, days)
        if planted is not None and robot < GETTING_WORSE:
            _plant(planted, figures)
        outliers = random.binomial(_MESSAGES, np.clip(figures['outliers'], 0.0, 1.0))
        gaps = random.poisson(np.minimum(figures['gaps'][0], 1.0) * _MESSAGES)
        there = np.flatnonzero(random.random(days) >= world.missing)
        rows += [
            {
                'robot': f'{robot:03}', 'source': f'{robot:03}/{day:03}', 'content': '',
                'topic': '/imu', 'frame_id': 'imu', 'axis': name,
                'start': START + int(day) * _DAY, 'duration': 60.0,
                'messages': _MESSAGES, 'gaps': int(gaps[day]),
                'noise': math.exp(figures['noise'][axis, day]), 'noise_samples': _MESSAGES // 2,
                'bias': figures['bias'][axis, day], 'bias_deviation': _OWN,
                'outlier_share': outliers[axis, day] / _MESSAGES,
            }
            for axis, name in enumerate('xyz')
            for day in there
        ]  # fmt: skip
    return pa.Table.from_pylist(rows, schema())


def _robot(
    world: World, random: np.random.Generator, robot: int, days: int
) -> Mapping[str, Floats]:
    """Return of the three axes (3, days) what is compared: noise as its logarithm."""

    def scatter(axes: int = 3) -> Floats:
        shape = axes, days
        values = (
            random.standard_t(world.tails, shape) * math.sqrt(1.0 - 2.0 / world.tails)
            if world.tails
            else random.standard_normal(shape)
        )
        for day in range(1, days):
            values[:, day] *= math.sqrt(1.0 - world.alike**2)
            values[:, day] += world.alike * values[:, day - 1]
        return factor[:axes] * values

    factor = np.exp(math.log(world.spread) * random.standard_normal((3, 1)))
    if robot % 5 == 4:
        factor *= world.worse
    own = random.standard_normal((4, 3, 1))
    warmer = world.season * np.sin(2.0 * np.pi * np.arange(days) / 365.0)
    rough = np.repeat(random.random(days // 5 + 1) < 0.5, 5)[:days]
    share = np.log(0.005) + 0.3 * own[2] + 0.2 * scatter() + math.log(world.rough) * rough
    quiet = random.random(days) < world.quiet
    figures = {
        'noise': math.log(2e-3) + 0.2 * own[0] + world.noise * scatter(),
        'bias': np.radians(own[1] + world.bias * scatter() + 0.02 * own[3] * warmer),
        'outliers': np.where(quiet, 0.0, np.exp(np.minimum(share, 0.0))),
        'gaps': np.where(quiet, 0.0, 1e-4 * np.exp(0.3 * scatter(1))),
    }
    # Half of the samples at rest, of which the deviation is uncertain by itself.
    figures['noise'] += random.standard_normal((3, days)) / math.sqrt(_MESSAGES)
    figures['bias'] += _OWN * random.standard_normal((3, days))
    if random.random() < world.repaired:
        figures['noise'][:, days // 4 : days // 2] += 1.0
        figures['bias'][0, days // 4 : days // 2] += math.radians(5.0)
    return figures


def _plant(planted: Planted, figures: Mapping[str, Floats]) -> None:
    """Make figures worse."""
    days = figures['noise'].shape[1]
    late = np.arange(days) - (days - planted.bags if planted.bags else days // 2)
    grown = np.where(late < 0, 0.0, 1.0)
    if planted.slowly:
        grown *= (late + 1.0) / (late[-1] + 1.0)
    if planted.quantity == 'noise':
        figures['noise'][:] += math.log(planted.size) * grown
    elif planted.quantity == 'bias':
        figures['bias'][1] += math.radians(planted.size) * grown
    else:
        figures[planted.quantity][:] += planted.size * grown
