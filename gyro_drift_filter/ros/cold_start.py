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

"""The first start after an installation: the kernels are compiled in a process of their own.

That takes from half a minute to some minutes on a small board. The node is there meanwhile: it
keeps what arrives, and takes it in its order as soon as the kernels are there.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.node import Node
from rclpy.timer import Timer

from gyro_drift_filter.accelerate.kernels import is_cache_cold
from gyro_drift_filter.phrases import counted

# A minute at 1 kHz, about 25 MB; beyond that the oldest messages go, and are counted.
LARGEST_QUEUE = 60_000
_POLL_SECONDS = 0.2
# What was kept is worked off in slices, so that the node answers in between.
_SLICE_SECONDS, _PAUSE_SECONDS = 0.02, 0.001
_NICENESS = 5


def _any_file() -> IO[bytes]:
    """Return a file to write to and read again; where there is room for none, one that is empty."""
    try:
        return tempfile.TemporaryFile()
    except OSError:
        return Path(os.devnull).open('w+b')


class _Call(NamedTuple):
    """A call that is kept for later."""

    function: Callable[[Any], None]
    argument: Any
    is_command: bool


class ColdStart:
    """Take what arrives at once, or keep it while the kernels are compiled.

    Attributes:
        waiting: Calls that are kept; None where the filter is ready.
        messages: How many of them are no commands.
        dropped: How many messages were too many.
    """

    def __init__(self, node: Node) -> None:
        """Begin to compile if kernels are not in the cache; `stop` has to be called then."""
        self.waiting: deque[_Call] | None = None
        self.messages = self.dropped = 0
        self._node = node
        self._compiler: subprocess.Popen[bytes] | None = None
        self._keeping = False
        if not is_cache_cold():
            return
        self._errors = _any_file()
        # -P, as a package in the working directory may not be the one that is running here. In a
        # session of its own, so that `stop` reaches the C++ compiler, too.
        self._compiler = subprocess.Popen(
            [sys.executable, '-P', '-m', 'gyro_drift_filter.cli.main', 'compile'],
            stdout=subprocess.DEVNULL,
            stderr=self._errors,
            start_new_session=True,
        )
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, self._compiler.pid, _NICENESS)
        self._timer = self._repeat(_POLL_SECONDS, self._poll)
        self.waiting = deque()
        self._keeping = True
        node.get_logger().warning(
            'first start: compiling the filter, for one to three minutes. Messages are kept until '
            "then. 'ros2 run gyro_drift_filter gyro_drift compile' does it ahead"
        )

    @property
    def is_ready(self) -> bool:
        """Whether the filter takes what arrives at once."""
        return self.waiting is None

    def call(
        self, function: Callable[[Any], None], argument: Any, *, is_command: bool = False
    ) -> None:
        """Call a function with an argument: now, or after all that came before.

        When there is no more room the oldest message is dropped, but never a command, as whoever
        gave it has been told that it was accepted.
        """
        if self.waiting is None:
            function(argument)
            return
        self.waiting.append(_Call(function, argument, is_command))
        self.messages += not is_command
        if self.messages > LARGEST_QUEUE:
            oldest = next(k for k, kept in enumerate(self.waiting) if not kept.is_command)
            del self.waiting[oldest]
            self.messages -= 1
            self.dropped += 1

    def _repeat(self, seconds: float, function: Callable[[], None]) -> Timer:
        clock = Clock(clock_type=ClockType.STEADY_TIME)
        return self._node.create_timer(seconds, function, clock=clock)

    def _poll(self) -> None:
        if self._compiler is None:
            return
        status = self._compiler.poll()
        if self._keeping and (status is not None or not is_cache_cold()):
            self._keeping = False
            self._tell(status or 0)
            self._worker = self._repeat(_PAUSE_SECONDS, self._work_off)
        if status is not None:
            self._compiler = None
            self._errors.close()
            self._node.destroy_timer(self._timer)

    def _tell(self, status: int) -> None:
        """Log how the compiler has done."""
        assert self.waiting is not None
        log = self._node.get_logger()
        if status == 0:
            log.info(f'compiled; {counted(self.messages, "message")} kept, {self.dropped} too many')
            return
        self._errors.seek(0)
        lines = self._errors.read().decode(errors='replace').split('\n')
        reason = next((line for line in reversed(lines) if line.strip()), '')
        log.warning(
            f'the compiler ended with {status}: {reason}. The filter is compiled here now, and '
            'takes no message until then'
        )

    def _work_off(self) -> None:
        """Take what was kept, for a moment; what arrives meanwhile goes behind it."""
        assert self.waiting is not None
        end = time.monotonic() + _SLICE_SECONDS
        while self.waiting:
            kept = self.waiting.popleft()
            self.messages -= not kept.is_command
            kept.function(kept.argument)
            if time.monotonic() > end:
                return
        self.waiting = None
        self._node.destroy_timer(self._worker)

    def stop(self) -> None:
        """End the compiler, if it runs."""
        if self._compiler is not None:
            with suppress(ProcessLookupError):
                os.killpg(self._compiler.pid, signal.SIGKILL)
            self._compiler.wait()
            self._compiler = None
            self._errors.close()
