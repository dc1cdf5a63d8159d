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

"""The options that say how a recording is filtered: parameters, method, and hints at motion."""

import argparse
from pathlib import Path

from gyro_drift_filter.cli.bag_options import Once
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.printing import tell
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES


def add_params_option(command: argparse.ArgumentParser, purpose: str = 'of the filter') -> None:
    """Add the option `--params` to a subcommand; `purpose` says what it does with the file."""
    command.add_argument('--params', type=Path, action=Once, help=f'ROS 2 parameter file {purpose}')


def add_method_option(command: argparse.ArgumentParser) -> None:
    """Add the option `--method` to a subcommand."""
    command.add_argument('--method', choices=METHOD_NAMES, help='overrides the parameter file')


def add_hint_option(command: argparse.ArgumentParser) -> None:
    """Add the option `--motion-hint` to a subcommand."""
    command.add_argument(
        '--motion-hint',
        metavar='TOPIC',
        help='Twist, TwistStamped or Odometry topic that tells whether the robot moves; the '
        'parameter motion_hint need not be set for it',
    )


def chosen_parameters(options: argparse.Namespace) -> Parameters:
    """Return the parameters of `--params`, or the default ones, with `--method` if it is given.

    A warning tells where they have the robot hint at motion, and no topic with hints is named.

    Raises:
        GyroDriftFilterError: The file can't be read, see `read_parameters`.
    """
    given = vars(options)
    parameters = read_parameters(options.params) if options.params else Parameters()
    if method := given.get('method'):
        parameters = parameters.with_names({'method': method})
    if parameters.motion_hint != 'none' and given.get('motion_hint') is None:
        why = 'no topic is named by --motion-hint'
        if 'motion_hint' not in given:
            why = f'gyro_drift {options.command} takes no hints'
        tell(
            f'warning: motion_hint is {parameters.motion_hint}, but {why}: the bias may be another '
            'one than on the robot, where hints came'
        )
    return parameters
