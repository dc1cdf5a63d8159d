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

"""How far errors of a gyroscope's scale and alignment move the bias in motion.

    python -m benchmark.scale [--seeds N]

A body that rolls one way between two rests, and the vehicles of `simulation/vehicles.py`, for five
minutes each. The table has the error of the bias while they move, root mean square over time and
axes, mean over the seeds, in 1e-3 rad/s, with `bias.in_motion` off and on. The scale of each axis,
and what it shows of each other one, are wrong by so much (standard deviation).
"""

import argparse
from collections.abc import Sequence

import numpy as np

from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.rotations import from_vectors
from gyro_drift_filter.simulation.vehicles import VEHICLES, Driven, Ride, Vehicle, ride

ERRORS = (0.001, 0.01, 0.03)
SECONDS, REST = 300.0, 10.0


def rolling(rate: float) -> Vehicle:
    """Return a body that rolls about a horizontal axis at a rate in rad/s, between two rests."""

    def roll(random: np.random.Generator, seconds: float, sample_rate: float) -> Driven:
        time = np.arange(round(seconds * sample_rate)) / sample_rate
        turning = np.clip(time - REST, 0.0, 1.0) * np.clip(seconds - REST - time, 0.0, 1.0)
        angle = rate * np.cumsum(turning) / sample_rate
        nothing = np.zeros((len(time), 3))
        attitudes = from_vectors(np.outer(angle, [1.0, 0.0, 0.0]))
        return Driven(nothing, attitudes, nothing, nothing, 0.0 * time, turning > 0.0)

    return roll


BODIES = {f'rolls at {rate:g} rad/s': rolling(rate) for rate in (0.5, 3.0, 10.0)} | VEHICLES


def bias_error(of: Ride, *, in_motion: bool) -> float:
    """Return the error of the bias while the body moves, root mean square in rad/s."""
    filter_ = Filter(Parameters(bias_in_motion=in_motion))
    bias = filter_.run(of.stamps, of.rates, of.accelerations)['bias']
    return float(np.sqrt(np.mean(np.square((bias - of.bias)[of.moving]))))


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seeds', type=int, default=6, help='default %(default)s')
    parser.add_argument('--only', nargs='+', choices=BODIES, default=list(BODIES))
    options = parser.parse_args(arguments)
    rows = [['', *(f'{100.0 * error:g} %: off  on' for error in ERRORS)]]
    for name in options.only:
        tell(f'moving: {name} ...')
        row = [name]
        for error in ERRORS:
            rides = [
                ride(BODIES[name], seed, SECONDS, warm_up=0.0, scale=error, misalignment=error)
                for seed in range(options.seeds)
            ]
            off, on = (
                1e3 * np.mean([bias_error(of, in_motion=in_motion) for of in rides])
                for in_motion in (False, True)
            )
            row.append(f'{off:.2f}  {on:.2f}')
        rows.append(row)
    print(table(rows))


if __name__ == '__main__':
    main()
