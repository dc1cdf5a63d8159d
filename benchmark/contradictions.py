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

"""The bias beside an accelerometer that contradicts the gyroscope, and whether that is told.

    python -m benchmark.contradictions [--seeds N] [--only NAME ...] [--check]

Vehicles that have no bias are switched on while they move, as in `benchmark.without_rest`. Their
accelerometer has other axes than the gyroscope, or is late. What explains that best is a bias. The
first table has the largest mean over the last minute of any ride, in deg/s, and in the last row
that of the same rides with sound accelerometers.

The second table is of rides that begin with a rest, so that the bias is known. It has the rides
that were told to contradict, the largest mean of the error as above with `bias.in_motion`, and the
same without it.
"""

import sys
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmark.figures import tell_misses
from benchmark.vehicles import vehicle_parser
from benchmark.without_rest import SAMPLE_RATE, SOON_KNOWN, started_in_motion
from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.simulation.sensor import DEGREE
from gyro_drift_filter.simulation.vehicles import VEHICLES, Ride, ride

LAST = round(60.0 * SAMPLE_RATE)
LARGEST = 1.0  # deg/s


def late(accelerations: Floats, seconds: float) -> Floats:
    """Return accelerations (n, 3) so many s later."""
    index = np.arange(len(accelerations)) - round(seconds * SAMPLE_RATE)
    return accelerations[np.maximum(index, 0)]


ACCELEROMETERS: Mapping[str, Callable[[Floats], Floats]] = {
    'axes y, z, x': lambda accelerations: accelerations[:, [1, 2, 0]],
    'axes y, x, z': lambda accelerations: accelerations[:, [1, 0, 2]],
    'axes -x, y, z': lambda accelerations: accelerations * [-1.0, 1.0, 1.0],
    'late by 0.15 s': lambda accelerations: late(accelerations, 0.15),
    'sound': lambda accelerations: accelerations,
}


def last_bias(of: Ride, accelerations: Floats, filter_: Filter | None = None) -> float:
    """Return the size of the mean error of the bias over the last minute, in deg/s."""
    biases = (filter_ or Filter()).run(of.stamps, of.rates, accelerations)['bias']
    return float(np.linalg.norm((biases - of.bias)[-LAST:].mean(axis=0))) / DEGREE


def _after_a_rest(vehicles: Sequence[str], seeds: int) -> tuple[list[list[str]], list[str]]:
    """Return the rows of the second table, and what does not hold of them."""
    rows, missed = [['accelerometer', *vehicles]], []
    rides = {
        vehicle: [ride(VEHICLES[vehicle], seed, 300.0, SAMPLE_RATE, 0.0) for seed in range(seeds)]
        for vehicle in vehicles
    }
    for name, accelerometer in ACCELEROMETERS.items():
        row = [name]
        for vehicle in vehicles:
            told, on, off = 0, 0.0, 0.0
            for of in rides[vehicle]:
                accelerations, filter_ = accelerometer(of.accelerations), Filter()
                on = max(on, last_bias(of, accelerations, filter_))
                told += bool(filter_.state['bias']['contradicts'])
                without = Filter(Parameters(bias_in_motion=False))
                off = max(off, last_bias(of, accelerations, without))
            row.append(f'{told} of {seeds}, {on:.2f} / {off:.2f}')
            if name == 'sound' and told > 0:
                missed.append(f'{vehicle}: {told} of {seeds} sound accelerometers are doubted')
        rows.append(row)
    return rows, missed


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the tables; return 1 where a bar is checked and does not hold."""
    options = vehicle_parser(__doc__, SOON_KNOWN).parse_args(arguments)
    rows, missed = [['accelerometer', *options.only]], []
    found: dict[str, list[float]] = {name: [] for name in ACCELEROMETERS}
    for vehicle in options.only:
        tell(f'riding: {vehicle} ...')
        rides = [started_in_motion(vehicle, seed, 0.0) for seed in range(options.seeds)]
        for name, accelerometer in ACCELEROMETERS.items():
            biases = [last_bias(of, accelerometer(of.accelerations)) for of in rides]
            found[name].append(max(biases))
    for name, largest in found.items():
        rows.append([name, *(f'{bias:.2f}' for bias in largest)])
        if max(largest) > LARGEST:
            missed.append(f'{name}: a bias of {max(largest):.2f} deg/s is found')
    print(table(rows))
    tell('riding after a rest ...')
    rows, doubted = _after_a_rest(options.only, options.seeds)
    print(table(rows))
    return tell_misses([*missed, *doubted], check=options.check)


if __name__ == '__main__':
    sys.exit(main())
