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

"""Bodies that are hit: how far what is held back turns the orientation.

    python -m benchmark.impacts [--data FOLDER]

A simulated foot that swings and strikes the ground, a body that is swung against a table, one that
a motor spins up about an axis near the sensor (`scenarios.py`), and recordings. The raw rates and
the filtered ones, with the bias added, are both integrated; the table has the largest angle between
the two orientations in deg, and the one in the end, with `outlier.enabled` on and off.

FOLDER holds a `.npz` for each recording, with `stamps` (n,) in ns, `rates` (n, 3) in rad/s and
`accelerations` (n, 3) in m/s^2.
"""

import argparse
from collections.abc import Iterator
from itertools import product
from pathlib import Path

import numpy as np

from benchmark.scenarios import foot, spun_up, stamps, stopped
from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    running_products,
    to_vectors,
)

SAMPLE_RATES = (100.0, 200.0, 400.0, 1000.0)
SHAKES = (1.0, 10.0, 30.0)  # m/s^2, of the strike
LEVERS = (0.01, 0.02, 0.05)  # m, from the axis of the motor
LONGEST_STEP = 3.0  # median steps of the stamps: what lasts longer is a gap, in which nobody knows


def worlds(folder: Path | None) -> Iterator[tuple[str, Integers, Floats, Floats]]:
    """Yield a name, stamps, rates and accelerations of each."""
    bodies = (
        ('foot', foot, SHAKES, 'm/s^2', 1.0),
        ('stopped', stopped, SHAKES, 'm/s^2', 1.0),
        ('spun up', spun_up, LEVERS, 'cm', 100.0),
    )
    for body, move, sizes, unit, scale in bodies:
        for rate, size in product(SAMPLE_RATES, sizes):
            name = f'{body}, {rate:g} Hz, {scale * size:g} {unit}'
            rates, accelerations = move(np.random.default_rng(0), rate, size)
            yield name, stamps(len(rates), rate), rates, accelerations
    for path in sorted(folder.glob('*.npz')) if folder else []:
        with np.load(path, allow_pickle=False) as data:
            yield path.stem, data['stamps'], data['rates'] * 1.0, data['accelerations'] * 1.0


def lost(times: Integers, rates: Floats, accelerations: Floats, *, enabled: bool) -> Floats:
    """Return the angle between the orientations by filtered and by raw rates, (n,) in deg."""
    results = Filter(Parameters(outlier_enabled=enabled)).run(times, rates, accelerations)
    filtered = results['angular_velocity'] + results['bias']
    filtered = np.where(np.isfinite(filtered), filtered, rates)
    steps = np.diff(times, prepend=times[0]) * 1e-9
    seconds = np.clip(steps, 0.0, LONGEST_STEP * np.median(steps))[:, None]
    raw, ours = (running_products(from_vectors(turned * seconds)) for turned in (rates, filtered))
    between = to_vectors(multiply(inverse(raw), ours))
    return np.asarray(np.degrees(np.linalg.norm(between, axis=1)))


def main() -> None:
    """Tell a table of all worlds."""
    parser = argparse.ArgumentParser(prog='python -m benchmark.impacts', description=__doc__)
    parser.add_argument('--data', type=Path, help='folder of recordings')
    rows = [['', 'largest, deg', 'in the end', 'largest, rule off', 'in the end']]
    for name, times, rates, accelerations in worlds(parser.parse_args().data):
        rows.append([name])
        for enabled in (True, False):
            angle = lost(times, rates, accelerations, enabled=enabled)
            rows[-1] += [f'{angle.max():.2f}', f'{angle[-1]:.2f}']
    tell(table(rows))


if __name__ == '__main__':
    main()
