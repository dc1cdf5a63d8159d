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

"""The whole of `gyro_drift`: choose the subcommand, and report a known error in one line."""

import argparse
import logging
from collections.abc import Sequence
from importlib import import_module

from gyro_drift_filter.cli import signals
from gyro_drift_filter.cli.printing import take_any_name, tell
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.version import package_version

# Modules of this package, and what each is for. They are loaded only where they are needed.
_SUBCOMMANDS = {
    'replay': 'filter a recorded bag',
    'report': 'draw what the filter does to a recording, with a verdict',
    'identify': 'find the noise model of a gyroscope from a motionless recording',
    'calibrate': 'find scale and misalignment of a gyroscope that was turned by hand',
    'tune': 'find the settings worth changing for a robot, from a recording of it',
    'doctor': 'tell whether a recording can be trusted',
    'explain': 'say why samples were flagged as outliers',
    'fleet': 'measure many bags of many robots, and tell whose gyroscope gets worse',
    'fleet-report': 'draw which gyroscopes of a fleet get worse',
    'simulate': 'make a bag with known truth',
    'compile': 'compile ahead of the first start',
}


def parser(loaded: str | None = None) -> argparse.ArgumentParser:
    """Return the parser of the whole command; only `loaded` has its arguments, or with None all."""
    command = argparse.ArgumentParser(
        prog='gyro_drift',
        description='Take the noise and the outliers out of a recorded gyroscope.',
    )
    command.add_argument('--version', action='version', version=package_version())
    subcommands = command.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name, purpose in _SUBCOMMANDS.items():
        subcommand = subcommands.add_parser(name, help=purpose)
        if loaded in (None, name):
            module = import_module(f'{__package__}.{name.replace("-", "_")}')
            module.add_arguments(subcommand)
            subcommand.set_defaults(run=module.run)
    return command


def run(arguments: Sequence[str]) -> int:
    """Run the command.

    Returns:
        0 done, or what the subcommand returns; 1 a known error, which is one line on stderr, or the
        reader of the output has left; as shells have it 128 and the number of the signal that has
        ended it, 130 interrupted. Bad usage exits with 2 from within argparse.
    """
    logging.addLevelName(logging.WARNING, 'warning')
    # By force: each run has its own stderr, as in the tests.
    logging.basicConfig(format='%(levelname)s: %(message)s', force=True)
    take_any_name()
    named = next((word for word in arguments if word in _SUBCOMMANDS), '')
    options = parser(named).parse_args(arguments)
    name = f'gyro_drift {options.command}'
    try:
        with signals.raising():
            status: int | None = options.run(options)
    except BrokenPipeError:
        return 1
    except (GyroDriftFilterError, OSError) as error:
        tell(f'{name}: {error}')
        return 1
    except MemoryError:
        tell(f'{name}: there is not enough memory for so many samples')
        return 1
    except KeyboardInterrupt:
        tell(f'{name}: interrupted{_left_out(options)}')
        return 130
    except signals.EndedBySignal as error:
        tell(f'{name}: ended by {error}{_left_out(options)}')
        return 128 + error.number
    return status or 0


def _left_out(options: argparse.Namespace) -> str:
    """Return what became of the files that were to be written, as the end of a sentence."""
    if all(str(getattr(options, name, None)) in ('None', '-') for name in ('output', 'json')):
        return ''
    # Of several files some may stand already: each is written whole, or not at all.
    return ': what was not complete is not written'
