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

"""`gyro_drift compile`: compile the kernels ahead, so that no start has to wait for it."""

import argparse
import time

from gyro_drift_filter.accelerate.kernels import is_extension, why_plain
from gyro_drift_filter.cli.printing import say
from gyro_drift_filter.cli.progress import compile_kernels
from gyro_drift_filter.errors import GyroDriftFilterError


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Compile all kernels and keep them in ~/.cache/gyro_drift_filter, so that the '
        'first start of the node does not have to. Needed once after an installation.'
    )


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    if why := why_plain():
        raise GyroDriftFilterError(
            f'there is nothing to compile, as the filter runs as plain Python: {why}, see '
            'docs/installation.md'
        )
    if is_extension():
        say('compiled already', after_files=False)
        return
    start = time.monotonic()
    compile_kernels()
    say(f'compiled in {time.monotonic() - start:.0f} s')
