"""`gyro_drift compile`: compile the kernels ahead, so that no start has to wait for it."""

import argparse
import time
from typing import Any

from gyro_drift_filter.accelerate.kernels import is_compiled, is_extension
from gyro_drift_filter.cli.printing import say, tell
from gyro_drift_filter.cli.progress import telling
from gyro_drift_filter.cli.signals import ending_at_once
from gyro_drift_filter.errors import GyroDriftFilterError


def add_parser(subcommands: Any) -> None:
    """Add the subcommand to the parser of `gyro_drift`."""
    command = subcommands.add_parser(
        'compile',
        help='compile ahead of the first start',
        description='Compile all kernels and keep them in ~/.cache/gyro_drift_filter, so that the '
        'first start of the node does not have to. Needed once after an installation.',
    )
    command.set_defaults(run=run)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    if not is_compiled():
        raise GyroDriftFilterError('numba is not installed: there is nothing to compile')
    if is_extension():
        say('compiled already')
        return
    from gyro_drift_filter.accelerate.ahead import build_extension, compile_all
    from gyro_drift_filter.accelerate.numba_internals import share_compiled

    start = time.monotonic()
    with ending_at_once(), telling(share_compiled):
        compile_all()
    try:
        build_extension()
    except GyroDriftFilterError as error:
        tell(f'{error}; without, each start loads numba')
    say(f'compiled in {time.monotonic() - start:.0f} s')
