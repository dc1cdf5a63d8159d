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

"""The options `--start` and `--end`: which part of a recording a command looks at."""

import argparse
import math
from contextlib import suppress

from gyro_drift_filter.errors import GyroDriftFilterError


def add_time_options(command: argparse.ArgumentParser) -> None:
    """Add both options to a subcommand."""
    for name, default in (('--start', 0.0), ('--end', math.inf)):
        command.add_argument(
            name,
            type=_seconds,
            default=default,
            metavar='S',
            help='s since the first message of the recording',
        )


def _seconds(text: str) -> float:
    seconds = math.nan
    with suppress(ValueError):
        seconds = float(text)
    if not 0.0 <= seconds < math.inf:
        raise argparse.ArgumentTypeError(f'{text} is no time since the first message, in s')
    return seconds


def between(options: argparse.Namespace) -> tuple[float, float]:
    """Return both times in s, infinity where there is no end.

    Raises:
        GyroDriftFilterError: The end is not after the start.
    """
    start, end = options.start, options.end
    if not start < end:
        raise GyroDriftFilterError(f'--start {start:g} is not before --end {end:g}')
    return start, end
