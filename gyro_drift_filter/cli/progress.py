"""Progress on a terminal."""

import sys
import time


class Progress:
    """A line on stderr that is written over, a few times a second."""

    def __init__(self, enabled: bool) -> None:
        self._enabled = enabled
        self._last = 0.0
        self._shown = False

    def __call__(self, done: int, total: int) -> None:
        """Show how many of the messages are done."""
        now = time.monotonic()
        if not self._enabled or now - self._last < 0.2:
            return
        self._last = now
        share = f' ({100 * done // total} %)' if total else ''
        print(f'\r{done} messages{share}', end='', file=sys.stderr, flush=True)
        self._shown = True

    def finish(self) -> None:
        """Clear the line."""
        if self._shown:
            print('\r\x1b[K', end='', file=sys.stderr, flush=True)
