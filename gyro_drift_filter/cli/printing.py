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

"""Print results, tables and remarks; a stream that takes nothing does not undo what was done."""

import io
import os
import sys
from collections.abc import Sequence
from contextlib import suppress

from gyro_drift_filter.errors import GyroDriftFilterError

# Of ECMA-48: bold green, bold yellow, bold red.
_COLOURS = {'helped': '1;32', 'unsure': '1;33', 'useless': '1;33', 'harmed': '1;31'}


def table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of cells as aligned text: the first column to the left, the others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    lines = []
    for row in rows:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        lines.append('  '.join(cells).rstrip())
    return '\n'.join(lines)


def say(text: str, *, after_files: bool = True) -> None:
    """Print a result, when all else is done.

    Args:
        text: To be printed.
        after_files: Whether files have been written before, which a user may else take for lost.

    Raises:
        GyroDriftFilterError: The standard output can't be written.
        BrokenPipeError: Its reader has left, as `| head` does.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        # Else Python itself tries once more at its end, and fails loudly.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        what = 'the standard output can not be written'
        if after_files:
            what = 'all is written, but the standard output can not be'
        raise GyroDriftFilterError(f'{what}: {error.strerror}') from error


def in_colour(text: str, outcome: str) -> str:
    """Return text in the colour of an outcome, where a terminal shows it that wants colours."""
    plain = os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb'
    if plain or sys.stdout is None or not sys.stdout.isatty():
        return text
    return f'\x1b[{_COLOURS[outcome]}m{text}\x1b[0m'


def take_any_name() -> None:
    """Have the standard output escape what its alphabet lacks: a name must not end the work."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors='backslashreplace')


def tell(text: str, end: str = '\n') -> None:
    """Print a remark on stderr, if that can be written."""
    if sys.stderr is not None:  # where it is closed
        with suppress(OSError, ValueError):  # a ValueError where another thread has just closed it
            print(text, end=end, file=sys.stderr, flush=True)


def is_terminal() -> bool:
    """Tell whether somebody reads remarks as they are made, where a line can be written over."""
    return sys.stderr is not None and sys.stderr.isatty() and os.environ.get('TERM') != 'dumb'


def terminal_columns() -> int:
    """Return how wide the terminal of remarks is; endless where it does not say so."""
    with suppress(OSError, ValueError):
        return os.get_terminal_size(sys.stderr.fileno()).columns or sys.maxsize
    return sys.maxsize
