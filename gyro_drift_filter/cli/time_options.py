"""The options `--start` and `--end`: which part of a recording a command looks at."""

import argparse
import math

from gyro_drift_filter.core import GyroDriftFilterError


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
    seconds = float(text)
    if not seconds >= 0.0:
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
