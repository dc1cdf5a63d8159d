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

"""Heading and attitude of simulated vehicles, with the bias in motion and without it.

    python -m benchmark.vehicles [--seeds N] [--only NAME ...] [--check] [--data FOLDER]

A drone, a car, a legged robot, a sensor in the hand and a train (`simulation/vehicles.py`) are
integrated by the filtered rates alone for ten minutes, each with `bias.in_motion` off and on, and
with the best constant bias, known in hindsight:

    heading   error about the vertical in the end, deg, where gravity keeps the tilt
    attitude  root mean square of the angle to the true orientation, deg, with no correction at all
    tilt      root mean square of the error of the bias across the vertical, 1e-3 rad/s
    inside    share of time in which the bias of an axis lies within two of its published deviations

FOLDER holds recordings of flights and walks with a known bias, of which `inside` is told, too.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.figures import rms, tell_misses
from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    rotate,
    running_products,
    to_vectors,
)
from gyro_drift_filter.simulation.vehicles import VEHICLES, WARM_UP, Ride, ride, train

# Other benchmarks and tests have no train: it is where `bias.in_motion` has most to tell apart.
ALL_VEHICLES = {**VEHICLES, 'train': train}
# Nowhere worse: the mean of the differences, over all seeds, is at most so many of its standard
# errors above zero, or this share of the error without.
STANDARD_ERRORS, NOISE = 2.0, 0.05
# Where the body tilts, gravity shows the bias: at most this share of the error without is left.
# What stays level, or leans into what speeds it up, shows less.
BETTER = {('drone', 'tilt'): 0.8, ('hand', 'tilt'): 0.8}
# What speeds up for a minute looks like a tilt, and costs a steady sensor at most so many times the
# error without (docs/tuning.md says who had better switch it off).
COSTS = {('car', 'tilt'): 2.0, ('car', 'attitude'): 1.3, ('train', 'tilt'): 2.5}
# Shares of time within two deviations, on the mean of all.
INSIDE = (0.85, 0.99)
# A sensor at its temperature, and one that warms up: deviation of what its bias moves by, in rad/s.
SENSORS = {'steady': 0.0, 'warming up': WARM_UP}
FIGURES = ('heading', 'attitude', 'tilt')


@dataclass(frozen=True)
class Judged:
    """One ride: three errors (see above) without the bias in motion, with it, and the best."""

    off: Floats
    on: Floats
    best: Floats
    inside: float


def judge(of: Ride) -> Judged:
    """Filter a ride with the bias in motion and without it."""
    given = of.stamps, of.rates, of.accelerations
    off, on = (
        Filter(Parameters(bias_in_motion=followed)).run(*given) for followed in (False, True)
    )
    best = np.broadcast_to(of.bias.mean(axis=0), of.bias.shape)
    return Judged(
        _errors(of, off['angular_velocity'], off['bias']),
        _errors(of, on['angular_velocity'], on['bias']),
        _errors(of, of.rates - best, best),
        share_inside(given, on, of.bias),
    )


def _errors(of: Ride, rates: Floats, bias: Floats) -> Floats:
    """Return heading and attitude in deg, tilt in 1e-3 rad/s, by rates and bias (n, 3) in rad/s."""
    period = np.gradient(of.stamps * 1e-9)[:, None]
    steps = to_vectors(multiply(inverse(of.orientations[:-1]), of.orientations[1:]))
    true = np.zeros_like(rates)
    true[1:-1] = 0.5 * (steps[:-1] + steps[1:]) / period[1:-1]
    heading = (rotate(of.orientations, rates - true) * period)[:, 2].sum()
    turns = from_vectors(0.5 * (rates[1:] + rates[:-1]) * period[1:])
    whole = np.vstack([of.orientations[:1], multiply(of.orientations[:1], running_products(turns))])
    angles = np.linalg.norm(to_vectors(multiply(whole, inverse(of.orientations))), axis=1)
    across = rotate(of.orientations, bias - of.bias)[:, :2]
    moving = np.linalg.norm(across[of.moving], axis=1)
    return np.array([abs(np.degrees(heading)), np.degrees(rms(angles)), 1e3 * rms(moving)])


def share_inside(
    given: tuple[Integers, Floats, Floats], results: NDArray[Any], bias: Floats
) -> float:
    """Return in which share of time the bias of an axis lies within two published deviations.

    Args:
        given: Stamps (n,), rates and accelerations (n, 3) that were filtered.
        results: (n,) of the filter.
        bias: The true one, (3,) or (n, 3) in rad/s.
    """
    # The rest of the variance is the same where the bias is left in.
    without = Filter(Parameters(bias_enabled=False)).run(*given)
    variance = results['angular_velocity_variance'] - without['angular_velocity_variance']
    return float(np.mean(np.square(results['bias'] - bias) <= 4.0 * variance))


def recorded(folder: Path) -> Iterator[tuple[str, float]]:
    """Yield names of real flights and walks with their share within two deviations.

    Their bias is the constant one that explains the orientation best, in hindsight.
    """
    for path in sorted((folder / 'dead_reckoning').glob('*.npz')):
        data = np.load(path)
        given = data['t'], data['rate'].astype(float), data['acc'].astype(float)
        yield path.stem, share_inside(given, Filter().run(*given), data['hindsight_bias'])


def misses(name: str, of_vehicle: Sequence[Judged]) -> list[str]:
    """Return the bars that do not hold for the rides of a vehicle, in words."""
    found = []
    off, on = (np.array([getattr(one, which) for one in of_vehicle]) for which in ('off', 'on'))
    for k, figure in enumerate(FIGURES):
        worse, share = on[:, k] - off[:, k], on[:, k].mean() / off[:, k].mean()
        error = worse.std(ddof=1) / np.sqrt(len(worse)) if len(worse) > 1 else np.inf
        is_worse = worse.mean() > max(STANDARD_ERRORS * error, NOISE * off[:, k].mean())
        if is_worse and share > COSTS.get((name, figure), 1.0):
            found.append(f'{name}: {figure} is worse')
        if share > BETTER.get((name, figure), np.inf):
            found.append(f'{name}: {100 * share:.0f} % of the error of {figure} is left')
    return found


def vehicle_parser(description: str | None, names: Sequence[str]) -> argparse.ArgumentParser:
    """Return the parser of a benchmark on some of the vehicles with these names."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--seeds', type=int, default=6, help='default %(default)s')
    parser.add_argument('--only', nargs='+', choices=names, default=list(names))
    parser.add_argument('--check', action='store_true', help='exit 1 where a bar does not hold')
    return parser


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 where a bar is checked and does not hold."""
    parser = vehicle_parser(__doc__, list(ALL_VEHICLES))
    parser.add_argument('--data', type=Path, metavar='FOLDER', help='real recordings')
    options = parser.parse_args(arguments)
    rows = [['', *(f'{name}: off  on  best' for name in FIGURES), 'inside, %']]
    missed, inside = [], []
    for name in options.only:
        for kind, warm_up in SENSORS.items():
            tell(f'riding: {name}, {kind} ...')
            judged = [
                judge(ride(ALL_VEHICLES[name], seed, warm_up=warm_up))
                for seed in range(options.seeds)
            ]
            missed += misses(name, judged)
            inside.append(float(np.mean([one.inside for one in judged])))
            means = [
                np.mean([getattr(one, which) for one in judged], axis=0)
                for which in ('off', 'on', 'best')
            ]
            cells = (
                f'{off:.2f}  {on:.2f}  {best:.2f}' for off, on, best in zip(*means, strict=True)
            )
            rows.append([f'{name}, {kind}', *cells, f'{100.0 * inside[-1]:.1f}'])
    for name, share in recorded(options.data) if options.data else ():
        inside.append(share)
        rows.append([name, '', '', '', f'{100.0 * share:.1f}'])
    print(table(rows))
    # Simulated sensors are steadier than `bias.random_walk`: alone they show no deviation as too
    # large.
    most = INSIDE[1] if options.data else 1.0
    if not INSIDE[0] <= np.mean(inside) <= most:
        missed.append(f'{100.0 * np.mean(inside):.1f} % of the time within two deviations')
    return tell_misses(missed, check=options.check)


if __name__ == '__main__':
    sys.exit(main())
