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

"""Progress of long work: on a terminal a line that is written over, elsewhere lines."""

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Self

from gyro_drift_filter.accelerate.kernels import has_to_compile, spare_linear_algebra
from gyro_drift_filter.cli.printing import is_terminal, tell, terminal_columns
from gyro_drift_filter.cli.signals import ending_at_once
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.phrases import plain

# Between two remarks on how far work is: on a terminal, and where each is a line of its own.
_TERMINAL_SECONDS, _LINE_SECONDS = 0.2, 10.0


class Progress:
    """How far work is, how fast, and what is left: a line that is written over on a terminal.

    Elsewhere it is a line now and then, so that a log tells of long work and of no other.
    """

    def __init__(self, *, enabled: bool, unit: str = 'messages') -> None:
        self._enabled = enabled
        self._unit = unit
        self._terminal = is_terminal()
        self._start = self._last = time.monotonic()
        self._shown = False

    def __call__(self, done: int, total: int) -> None:
        """Show how many are done; the total is 0 where it is not known."""
        now = time.monotonic()
        pause = _TERMINAL_SECONDS if self._terminal else _LINE_SECONDS
        if not self._enabled or now - self._last < pause:
            return
        self._last = now
        pace = _pace(done, now - self._start)
        text = f'{done} {self._unit}, {pace}'
        if 0 < done <= total:
            text = f'{100 * done // total} % of {total} {self._unit}, {pace}'
        if 0 < done < total:
            left = (total - done) * (now - self._start) / done
            text += f', {_duration(left)} left'
        _tell_over(text, terminal=self._terminal)
        self._shown = True

    def __enter__(self) -> Self:
        """Begin."""
        return self

    def __exit__(self, *_: object) -> None:
        """Clear the line."""
        if self._shown and self._terminal:
            tell('\r\x1b[K', end='')


def _tell_over(text: str, *, terminal: bool) -> None:
    """Tell in a line that the next one is written over; elsewhere than on a terminal in its own."""
    if not terminal:
        tell(text)
        return
    # What is wider takes two rows, of which only the last one would be written over.
    tell(f'\r{text[: terminal_columns() - 1]}\x1b[K', end='')


def _pace(done: int, seconds: float) -> str:
    """Return how fast work is, in the shortest unit of time that has one or more of it."""
    units = ('a second', 1.0), ('a minute', 60.0), ('an hour', 3600.0)
    unit, longer = next((u for u in units if done * u[1] >= seconds), units[0])
    return f'{plain(done * longer / seconds, 2)} {unit}'


def _duration(seconds: float) -> str:
    """Return a time that is not over in words: 8 s, 3 min 20 s, 2 h 5 min."""
    whole = max(round(seconds), 1)
    if whole < 60:
        return f'{whole} s'
    if whole < 3600:
        return f'{whole // 60} min {whole % 60} s'
    return f'{whole // 3600} h {whole % 3600 // 60} min'


def prepare_kernels(*, quiet: bool = False) -> None:
    """Compile all kernels, saying so, where that has not been done: it takes minutes.

    Where nothing is to be said, they are compiled as they are needed. So they are where they can't
    be kept, of which a warning has been logged.
    """
    spare_linear_algebra()
    if quiet or not has_to_compile():
        return
    tell('compiling the filter for this machine: once, for one to three minutes')
    start = time.monotonic()
    with suppress(GyroDriftFilterError):
        compile_kernels()
        tell(f'compiled in {time.monotonic() - start:.0f} s')


def compile_kernels() -> None:
    """Compile all kernels, telling how far that is, and whether later starts will be slower.

    Raises:
        GyroDriftFilterError: They can't be kept.
    """
    from gyro_drift_filter.accelerate import cache
    from gyro_drift_filter.accelerate.ahead import compile_all
    from gyro_drift_filter.accelerate.numba_internals import share_compiled

    with ending_at_once(cache.remove_own_builds), _telling(share_compiled):
        missing = compile_all()
    if missing:
        tell(f'{missing}; without, each start loads numba')


@contextmanager
def _telling(share: Callable[[], float]) -> Iterator[None]:
    """Tell from time to time, in a thread, which share is done."""
    terminal, start, over = is_terminal(), time.monotonic(), threading.Event()

    def tell_on() -> None:
        while not over.wait(_TERMINAL_SECONDS if terminal else _LINE_SECONDS):
            text = f'compiled: {100.0 * share():.0f} % in {time.monotonic() - start:.0f} s'
            _tell_over(text, terminal=terminal)

    thread = threading.Thread(target=tell_on)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()
        if terminal:
            tell('\r\x1b[K', end='')
