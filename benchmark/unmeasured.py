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

"""The bias that gravity shows of vehicles that never rest, where no rate is measured for a while.

    python -m benchmark.unmeasured [--seeds N] [--only NAME ...] [--check]

Vehicles that have no bias are switched on while they move, as in `benchmark.without_rest`. Thirty
times within four minutes no rate is measured: the rates are no usable numbers, a bus that hangs
sends the same ones again, samples are missing, or are missing between the bursts of a FIFO. The
table has the largest bias that is found at any time on any axis, in 1e-3 rad/s.
"""

import sys
from collections.abc import Sequence

import numpy as np

from benchmark.figures import tell_misses
from benchmark.vehicles import vehicle_parser
from benchmark.without_rest import SAMPLE_RATE, SOON_KNOWN, started_in_motion
from gyro_drift_filter.arrays import Bools
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter
from gyro_drift_filter.simulation.vehicles import Ride

KINDS = ('unusable', 'held', 'missing', 'missing between bursts')
SECONDS = (0.1, 0.2, 0.4)
TIMES, FIRST_SECONDS, LAST_SECONDS = 30, 5.0, 1.0
BURST = 4  # samples
LARGEST = 5.0  # 1e-3 rad/s, up to 0.2 s


def unmeasured(count: int, seconds: float, seed: int) -> Bools:
    """Return which of `count` samples are not measured: for so many s each time."""
    lost = np.zeros(count, bool)
    first, last = round(FIRST_SECONDS * SAMPLE_RATE), count - round(LAST_SECONDS * SAMPLE_RATE)
    for start in np.random.default_rng(seed).choice(np.arange(first, last), TIMES, replace=False):
        lost[start : start + round(seconds * SAMPLE_RATE)] = True
    return lost


def largest_bias(of: Ride, lost: Bools, kind: str) -> float:
    """Return the largest error of the bias in 1e-3 rad/s, where samples are lost so."""
    count = len(lost)
    stamps, rates, kept = of.stamps, of.rates.copy(), np.ones(count, bool)
    if kind == 'unusable':
        rates[lost] = np.nan
    elif kind == 'held':
        rates = rates[np.maximum.accumulate(np.where(lost, 0, np.arange(count)))]
    else:
        kept = ~lost
    if kind == 'missing between bursts':
        stamps = stamps[np.minimum(np.arange(count) // BURST * BURST + BURST - 1, count - 1)]
    biases = Filter().run(stamps[kept], rates[kept], of.accelerations[kept])['bias']
    return float(1e3 * np.abs(biases - of.bias[kept]).max())


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 where a bar is checked and does not hold."""
    options = vehicle_parser(__doc__, SOON_KNOWN).parse_args(arguments)
    rides = []
    for name in options.only:
        tell(f'riding: {name} ...')
        rides += [started_in_motion(name, seed, 0.0) for seed in range(options.seeds)]
    rows, missed = [['no rate for', *(f'{seconds} s' for seconds in SECONDS)]], []
    for kind in KINDS:
        largest = [
            max(
                largest_bias(of, unmeasured(len(of.stamps), seconds, seed), kind)
                for seed, of in enumerate(rides)
            )
            for seconds in SECONDS
        ]
        rows.append([kind, *(f'{error:.1f}' for error in largest)])
        if max(largest[:2]) > LARGEST:
            missed.append(f'{kind}: a bias of {max(largest[:2]):.1f}e-3 rad/s is found')
    print(table(rows))
    return tell_misses(missed, check=options.check)


if __name__ == '__main__':
    sys.exit(main())
