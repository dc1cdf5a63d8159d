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

"""How well `identify` knows what it says: simulated drift with truth, and a million samples timed.

    python -m benchmark.identification [--seeds N] [--bag BAG]

Coverage: how often the 95 % intervals hold the truth, for AR(1) drift of deviation 1 and white
noise beside it. Choice: how often the order of the model is found. With --bag also the time of
`gyro_drift identify` beside that of reading the bag with rosbags and deserializing each message.
"""

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy import signal

from benchmark.measure import median_costs
from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.identify.models import choose, fit_arma, fit_drift_and_white
from gyro_drift_filter.simulation.experiments import autoregressive

SAMPLES, CHOICE_SAMPLES = 20_000, 50_000
RATIOS = (4.0, 2.0, 1.0, 0.5, 0.25)
CHOICES = {
    'AR(1)': ([0.5], []),
    'AR(2)': ([0.5, -0.3], []),
    'ARMA(1, 1)': ([0.9], [0.5]),
    'white noise': ([], []),
}
_NORMAL_95 = 1.959964
_REPETITIONS = 5
_DESERIALIZE = """
import sys
from pathlib import Path
from rosbags.highlevel import AnyReader
with AnyReader([Path(sys.argv[1])]) as reader:
    for connection, _, data in reader.messages():
        reader.deserialize(data, connection.msgtype)
"""


def drift(seed: int, phi: float) -> Floats:
    """Return AR(1) noise (n,) of deviation 1."""
    random = np.random.default_rng([seed, 1])
    return autoregressive(random, SAMPLES, phi, np.sqrt(1.0 - phi * phi))[:, 0]


def alone(phi: float, seeds: int) -> list[str]:
    """Return a row of the coverage table for AR(1) without white noise."""
    estimates, hits = [], 0
    for seed in range(seeds):
        (fitted,) = fit_arma([drift(seed, phi)], [(1, 0)])
        estimates.append(fitted.phi[0])
        hits += abs(fitted.phi[0] - phi) <= _NORMAL_95 * fitted.phi_deviation[0]
    share = f'{hits / seeds:.3f}'
    return [f'{phi:g} alone', '1.000', f'{np.mean(estimates) / phi:.4f}', share, '-', '-']


def with_white(phi: float, ratio: float, seeds: int) -> list[str]:
    """Return a row of the coverage table for AR(1) and white noise of deviation 1 / ratio."""
    estimates, hits = [], np.zeros(3)
    truth = np.array([phi, 1.0, 1.0 / ratio**2])
    for seed in range(seeds):
        white = np.random.default_rng([seed, 2]).standard_normal(SAMPLES) / ratio
        found = fit_drift_and_white([drift(seed, phi) + white])
        if not found.identifiable:
            continue
        estimates.append(found.phi)
        intervals = np.array(
            [
                found.phi_interval,
                found.drift_variance_interval,
                found.white_variance_interval,
            ]
        )
        hits += (intervals[:, 0] <= truth) & (truth <= intervals[:, 1])
    row = [f'{phi:g}, {ratio:g} to 1', f'{len(estimates) / seeds:.3f}']
    if not estimates:
        return [*row, '-', '-', '-', '-']
    shares = [f'{share:.3f}' for share in hits / len(estimates)]
    return [*row, f'{np.mean(estimates) / phi:.4f}', *shares]


def choice(name: str, phi: Sequence[float], theta: Sequence[float], seeds: int) -> list[str]:
    """Return a row of the table of model choice."""
    right = 0
    for seed in range(seeds):
        driving = np.random.default_rng([seed, 3]).standard_normal(CHOICE_SAMPLES + 500)
        data = signal.lfilter(np.r_[1.0, -np.array(theta)], np.r_[1.0, -np.array(phi)], driving)
        right += choose(fit_arma([data[500:]])).order == (len(phi), len(theta))
    return [name, f'{right} of {seeds}']


def timed(bag: Path) -> list[list[str]]:
    """Return the rows of the speed table: medians of interleaved runs of whole processes."""
    command, path = str(Path(sys.executable).with_name('gyro_drift')), str(bag.absolute())
    with tempfile.TemporaryDirectory() as folder:
        model = Path(folder, 'model.yaml')
        commands = {
            'identify': [command, 'identify', path, '-o', str(model)],
            'read and deserialize': [sys.executable, '-c', _DESERIALIZE, path],
        }
        costs = median_costs(commands, _REPETITIONS, lambda: model.unlink(missing_ok=True))
    rows = [[name, f'{cost.seconds:.2f}'] for name, cost in costs.items()]
    ratio = costs['identify'].seconds / costs['read and deserialize'].seconds
    return [*rows, ['ratio', f'{ratio:.2f}']]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--seeds', type=int, default=500, help='default %(default)s')
    parser.add_argument('--bag', type=Path, help='a long motionless recording, to be timed')
    options = parser.parse_args()
    heads = ['phi, drift to white', 'identifiable', 'mean / true phi', 'phi', 'drift', 'white']
    rows = [heads]
    for phi in (0.2134, 0.9):
        rows.append(alone(phi, options.seeds))
        rows += [with_white(phi, ratio, options.seeds) for ratio in RATIOS]
    print(f'coverage of the 95 % intervals of phi and the two variances, {SAMPLES} samples\n')
    print(table(rows), end='\n\n')
    seeds = max(1, options.seeds // 5)
    rows = [[f'choice, {CHOICE_SAMPLES} samples', 'right']]
    rows += [choice(name, phi, theta, seeds) for name, (phi, theta) in CHOICES.items()]
    print(table(rows))
    if options.bag:
        print('\n' + table([['s', 'median'], *timed(options.bag)]))


if __name__ == '__main__':
    main()
