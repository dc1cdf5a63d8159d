"""Ctrl-C, even where it comes while a library swallows all exceptions, as numba's loader does."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_asked = threading.Event()


@contextmanager
def noted_interrupts() -> Iterator[None]:
    """Note an interrupt beside raising it, for `check`."""

    def note(number: int, frame: Any) -> None:
        _asked.set()
        raise KeyboardInterrupt

    _asked.clear()
    before = signal.getsignal(signal.SIGINT)
    # Else it is ignored, as behind nohup, or somebody else's.
    if before is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def check() -> None:
    """Raise what was swallowed.

    Raises:
        KeyboardInterrupt: There was an interrupt.
    """
    if _asked.is_set():
        raise KeyboardInterrupt
