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

"""Signals that end the command: what it has begun is cleaned up, as at an interrupt."""

import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from types import FrameType

from gyro_drift_filter.cli.printing import tell

_SIGNALS = signal.SIGTERM, signal.SIGHUP


class EndedBySignal(BaseException):
    """The command was asked to end, by the signal `number`."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


@contextmanager
def ending_at_once(clean: Callable[[], None]) -> Iterator[None]:
    """Have an interrupt, SIGTERM and SIGHUP end the process with one line and no exception.

    For what calls back from compiled code, as LLVM does, where an exception is lost. `clean` is
    called instead of what an exception would have cleaned up.
    """

    def end(number: int, _: FrameType | None) -> None:
        why = (
            'interrupted' if number == signal.SIGINT else f'ended by {signal.Signals(number).name}'
        )
        tell(f'gyro_drift: {why}, nothing written')
        clean()
        os._exit(128 + number)

    with _handling((signal.SIGINT, *_SIGNALS), end):
        yield


@contextmanager
def raising() -> Iterator[None]:
    """Have SIGTERM and SIGHUP raise `EndedBySignal`, unless they are ignored, as by nohup."""

    def end(number: int, _: FrameType | None) -> None:
        for other in _SIGNALS:  # another one would interrupt the cleaning up
            signal.signal(other, signal.SIG_IGN)
        raise EndedBySignal(number)

    with _handling(_SIGNALS, end):
        yield


@contextmanager
def _handling(
    numbers: Iterable[int], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Have a function called for each of these signals that is not ignored."""
    if threading.current_thread() is not threading.main_thread():  # which alone may set handlers
        yield
        return
    before = {
        number: signal.signal(number, handler)
        for number in numbers
        if signal.getsignal(number) != signal.SIG_IGN
    }
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
