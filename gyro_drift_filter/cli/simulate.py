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

"""`gyro_drift simulate`: a bag with known truth, as in the paper's section 4."""

import argparse
from pathlib import Path

from gyro_drift_filter.cli.printing import say
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate

_FEWEST_SAMPLES = 10


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    default = SimulationSettings()
    command.description = (
        "Simulate the paper's experiments: a motionless part, then a sinusoid with "
        'isolated outliers and runs of them. The truth goes into a numpy archive beside the bag: '
        'the rates without noise and outliers, but with the bias.'
    )
    command.add_argument('-o', '--output', type=Path, required=True, help='folder to be made')
    command.add_argument(
        '--seed', type=int, default=default.seed, help='of the random numbers, default %(default)s'
    )
    command.add_argument(
        '--rate',
        type=float,
        default=default.sample_rate,
        help='sample rate in Hz, default %(default)s',
    )
    command.add_argument(
        '--static',
        type=float,
        default=default.static_seconds,
        help='length of the motionless part in s, default %(default)s',
    )
    command.add_argument(
        '--dynamic',
        type=float,
        default=default.dynamic_seconds,
        help='length of the part with the sinusoid in s, default %(default)s',
    )


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.simulation.bag import write_simulation

    if not 1.0 <= options.rate <= 10_000.0:
        raise GyroDriftFilterError(f'--rate must be 1 to 10000 Hz, not {options.rate:g}')
    if options.seed < 0:
        raise GyroDriftFilterError(f'--seed must not be negative, not {options.seed}')
    seconds = options.static + options.dynamic
    if not (min(options.static, options.dynamic) >= 0 and 1.0 <= seconds <= 86_400.0):
        raise GyroDriftFilterError(
            '--static and --dynamic must not be negative, and 1 to 86400 s together'
        )
    if seconds * options.rate < _FEWEST_SAMPLES:
        raise GyroDriftFilterError(
            f'{seconds:g} s at {options.rate:g} Hz are fewer than {_FEWEST_SAMPLES} samples'
        )
    settings = SimulationSettings(
        seed=options.seed,
        sample_rate=options.rate,
        static_seconds=options.static,
        dynamic_seconds=options.dynamic,
    )
    simulation = simulate(settings)
    archive = write_simulation(options.output, simulation)
    say(
        f'wrote {options.output}: {len(simulation.stamps)} samples, '
        f'{int(simulation.outliers.sum())} outliers on three axes; truth in {archive}'
    )
