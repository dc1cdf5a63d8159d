"""The whole of `gyro_drift`: choose the subcommand, and report a known error in one line."""

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from importlib import import_module

from gyro_drift_filter.core import GyroDriftFilterError
from gyro_drift_filter.messages.health import package_version

# Modules of this package.
_SUBCOMMANDS = ('replay', 'identify', 'simulate', 'compile')


def parser(subcommand: str = '') -> argparse.ArgumentParser:
    """Return the parser of the whole command, or of one subcommand: others are not loaded then."""
    command = argparse.ArgumentParser(
        prog='gyro_drift',
        description='Take the noise and the outliers out of a recorded gyroscope.',
    )
    command.add_argument('--version', action='version', version=package_version())
    subcommands = command.add_subparsers(dest='command', metavar='COMMAND', required=True)
    for name in (subcommand,) if subcommand in _SUBCOMMANDS else _SUBCOMMANDS:
        import_module(f'{__package__}.{name}').add_parser(subcommands)
    return command


def run(arguments: Sequence[str]) -> int:
    """Run the command.

    Returns:
        0 done, 1 a known error, which is one line on stderr, 130 interrupted. Bad usage exits with
        2 from within argparse.
    """
    logging.addLevelName(logging.WARNING, 'warning')
    # By force: each run has its own stderr, as in the tests.
    logging.basicConfig(format='%(levelname)s: %(message)s', force=True)
    options = parser(arguments[0] if arguments else '').parse_args(arguments)
    try:
        options.run(options)
        sys.stdout.flush()
    except GyroDriftFilterError as error:
        print(f'gyro_drift {options.command}: {error}', file=sys.stderr)
        return 1
    except OSError as error:
        if isinstance(error, BrokenPipeError):  # the reader of our output has left, as `| head`
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        print(f'gyro_drift {options.command}: {error}', file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f'gyro_drift {options.command}: interrupted, nothing written', file=sys.stderr)
        return 130
    return 0
