"""The first start after an installation: the kernels are compiled in a process of their own.

That takes from half a minute to some minutes on a small board. The node is there meanwhile: what
arrives is kept, and filtered in its order as soon as it can be.
"""

import os
import subprocess
import sys
from collections import deque
from collections.abc import Callable
from contextlib import suppress

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node

from gyro_drift_filter.core.compiled import is_cache_cold

# A minute at 1 kHz, about 25 MB; beyond that the oldest messages go, and are counted.
LARGEST_QUEUE = 60_000
_POLL_SECONDS = 0.2
_NICENESS = 5


class ColdStart:
    """Keep what arrives while the kernels are compiled, if they are not in the cache.

    Attributes:
        waiting: Messages kept, None where the filter is ready.
        dropped: Messages that were too many.
    """

    def __init__(self, node: Node, ready: Callable[[deque[bytes]], None]) -> None:
        """Begin.

        Args:
            node: Whose timers and log are used.
            ready: Called once, with the messages kept, when the kernels are in the cache. Not
                called where they are there from the begin.
        """
        self.waiting: deque[bytes] | None = None
        self.dropped = 0
        self._compiler: subprocess.Popen[bytes] | None = None
        if not is_cache_cold():
            return
        self._node, self._ready = node, ready
        self.waiting = deque(maxlen=LARGEST_QUEUE)
        # -P, as a package in the working directory may not be the one that is running here.
        self._compiler = subprocess.Popen(
            [sys.executable, '-P', '-m', 'gyro_drift_filter.cli.main', 'compile'],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,  # what goes wrong there goes wrong here once more
        )
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, self._compiler.pid, _NICENESS)
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(_POLL_SECONDS, self._poll, clock=clock)
        node.get_logger().warning(
            'first start: compiling the filter, for half a minute or more. Messages are kept until '
            "then. 'ros2 run gyro_drift_filter gyro_drift compile' does it ahead"
        )

    def keep(self, data: bytes) -> None:
        """Keep a message until the filter is ready."""
        assert self.waiting is not None
        self.dropped += len(self.waiting) == LARGEST_QUEUE
        self.waiting.append(data)

    def _poll(self) -> None:
        if self._compiler is None or self._compiler.poll() is None:
            return
        self._compiler = None
        self._node.destroy_timer(self._timer)
        waiting, self.waiting = self.waiting, None
        assert waiting is not None
        self._node.get_logger().info(
            f'compiled; {len(waiting)} messages were kept, {self.dropped} were too many'
        )
        self._ready(waiting)

    def stop(self) -> None:
        """End the compiler, if it runs."""
        if self._compiler is not None:
            self._compiler.kill()
            self._compiler.wait()
            self._compiler = None
