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

"""The bias, remembered from one run to the next in a small text file.

That of a node stands under ROS_HOME (~/.ros where that is not set), named after node and frame. It
is written whole beside the old one and then renamed, so that a crash or a power cut leaves one or
the other.
"""

import json
import math
import os
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self
from urllib.parse import quote

import numpy as np

from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.bias.shift import BiasShift
from gyro_drift_filter.errors import GyroDriftFilterError, printable, reason
from gyro_drift_filter.messages.telemetry import MessageReport
from gyro_drift_filter.whole_file import remove_abandoned, write_whole

FORMAT = 2
# The standard deviation of the bias from one power-up to the next, in rad/s: 0.5 deg/s.
REPEATABILITY = 8.7e-3
# Older than this it is not taken any more, in s: 30 days.
LONGEST_AGE = 30 * 86_400.0
# A clock may be wrong by this much before a file from the future is refused, in s.
CLOCK_ERROR = 86_400.0
# A change of the frame_id leaves a bias as uncertain as at power-on. Any rest makes it less than
# this share of that.
_SHOWN_AGAIN = 0.5
_LONGEST_TIME = 1e11  # s: some thousand years
_LONGEST_NAME = 200
LARGEST_FILE = 100_000  # bytes
_LONGEST_BEGINNING = 100  # bytes, of which the first key is


class MemoryFileError(GyroDriftFilterError):
    """A file can't be used or written; the text says why."""


@dataclass(frozen=True)
class RememberedBias:
    """A bias as it was at the end of a run.

    Attributes:
        bias: (3,) in rad/s.
        deviation: (3,) its standard deviation in rad/s.
        shift: Of the bias in motion from that at rest.
        provisional: No rest has shown it, neither in that run nor before.
        age: Since it was written, in s; negative where that lies ahead.
    """

    bias: Sequence[float]
    deviation: Sequence[float]
    shift: BiasShift
    provisional: bool = False
    age: float = 0.0

    @classmethod
    def of(cls, filter_: Filter, before: Self | None = None) -> Self | None:
        """Return what a filter has learned that was started with `before`, None if nothing."""
        state = filter_.state['bias']
        at_rest, in_motion = state['segments'] > 0, state['corrected'] > 0
        if state['restored'] and not at_rest:
            return before  # in place of what motion had shown meanwhile
        if not (at_rest or in_motion or state['provisional_variance'][0] > 0.0):
            return None
        # A provisional one is taken only if it fits what a rest has shown before, and what motion
        # shows only if it does not.
        shown = at_rest or (before is not None and not before.provisional and not in_motion)
        bias, deviation = state['bias'].tolist(), filter_.bias_deviation.tolist()
        return cls(bias, deviation, filter_.bias_shift, provisional=not shown)

    def give(self, filter_: Filter) -> None:
        """Start a filter with it, less certain, as it changes when the sensor is switched on.

        A provisional one may have been a slow turn, so it is as uncertain as if it were not known.
        """
        turn_on_deviation = filter_.parameters.bias_turn_on_deviation
        added = turn_on_deviation if self.provisional else REPEATABILITY
        deviation = np.hypot(self.deviation, added).tolist()
        filter_.set_bias(self.bias, deviation, self.shift, known=not self.provisional)


def why_not_kept(learned: RememberedBias, report: MessageReport, frame: str) -> str:
    """Return why a bias is not kept as that of the sensor of a frame_id; empty where it is.

    Since the last change of the frame_id, a rest has to have shown that of the sensor again.
    """
    if not report.frame_changes:
        return ''
    if report.frame != printable(frame):
        return f'frame_id is no longer {frame}, so the sensor may be another one'
    if max(learned.deviation) > _SHOWN_AGAIN * report.parameters.bias_turn_on_deviation:
        return f'frame_id has changed, and there was no rest since it is {frame} again'
    return ''


def file_of(node: str, frame: str) -> Path:
    """Return the path for a node's full name and the frame_id of its gyroscope."""
    home = os.environ.get('ROS_HOME')
    root = Path(home) if home else Path.home() / '.ros'
    name = quote(f'{node.strip("/")} {frame}', safe=' ').replace(' ', '@')[:_LONGEST_NAME]
    return root / 'gyro_drift_filter' / f'{name}.json'


def is_free_for_bias(path: Path) -> bool:
    """Tell whether a path is free for a bias: nothing there, an empty file, or one from before.

    Raises:
        MemoryFileError: It can't be read.
    """
    if not path.exists():
        return True
    if not path.is_file():  # a pipe would be waited for, a device be replaced by a file
        return False
    try:
        with path.open('rb') as file:
            beginning = file.read(_LONGEST_BEGINNING)
    except OSError as error:
        raise MemoryFileError(f'{path} can not be read: {error.strerror}') from error
    return re.fullmatch(rb'\s*(\{\s*"format":.*)?', beginning, re.DOTALL) is not None


def recall(
    path: Path, node: str | None, frame: str, largest: float, now: float | None = None
) -> RememberedBias | None:
    """Return what a file holds, or None where there is none.

    Args:
        path: Of the file.
        node: Full name of the node; None where any will do.
        frame: frame_id of its gyroscope.
        largest: bias.max in rad/s.
        now: Time in s since 1970, None for that of this machine.

    Raises:
        MemoryFileError: The file is damaged, of another version, node or frame, stale, or its bias
            is beyond `largest`.
    """
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise MemoryFileError(f'{path} can not be read: it is no file')
    found, why = None, 'is of another version of this package'
    try:
        with path.open('rb') as file:
            content = json.loads(file.read(LARGEST_FILE))
        if content['format'] == FORMAT:
            owner = node and content['node'], content['frame']
            found = _remembered(content, time.time() if now is None else now)
            is_own = owner == (node, frame)
            why = _why_not_used(found, largest) if is_own else 'is of another node or frame'
    except FileNotFoundError:
        return None
    except OSError as error:
        raise MemoryFileError(f'{path} can not be read: {error.strerror}') from error
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        why = f'is damaged: {reason(error)}'
    if why:
        raise MemoryFileError(f'{path} {why} (it is replaced once a bias is learned)')
    return found


def _remembered(content: Any, now: float) -> RememberedBias:
    """Return the bias that a file holds, at a time in s since 1970.

    Raises:
        ValueError: A value is impossible. What is missing, or of another type, raises as it comes.
    """
    bias, deviation = _three(content['bias']), _three(content['deviation'])
    shift = BiasShift(_three(content['shift']), _three(content['shift_deviation']))
    if min(*deviation, *shift.deviation) < 0.0:
        raise ValueError('a deviation is negative')
    provisional = content.get('provisional', False)
    if not isinstance(provisional, bool):
        raise ValueError('provisional is neither true nor false')
    age = now - float(content['time'])
    if not math.isfinite(age):
        raise ValueError('its time is not finite')
    if abs(age) > _LONGEST_TIME:
        raise ValueError('its time is no date')
    return RememberedBias(bias, deviation, shift, provisional, age)


def _why_not_used(found: RememberedBias, largest: float) -> str:
    """Return why a bias is not that of the sensor now; empty where it may be."""
    if found.age < -CLOCK_ERROR:
        return f'is from {-found.age / 86_400.0:.1f} days ahead: is the clock of this machine set?'
    if found.age > LONGEST_AGE:
        return (
            f'is from {found.age / 86_400.0:.1f} days ago, which is too old, unless the clock of '
            'this machine is wrong'
        )
    if max(map(abs, found.bias)) > largest:
        return f'holds {list(found.bias)} rad/s, which is beyond bias.max'
    return ''


def remember(
    path: Path, node: str, frame: str, bias: RememberedBias, now: float | None = None
) -> None:
    """Write a bias; path, node, frame and `now` are those of `recall`.

    Raises:
        MemoryFileError: The disk does not take it.
    """
    content = {
        'format': FORMAT,
        'node': node,
        'frame': frame,
        'bias': list(bias.bias),
        'deviation': list(bias.deviation),
        'shift': list(bias.shift.shift),
        'shift_deviation': list(bias.shift.deviation),
        'provisional': bias.provisional,
        'unit': 'rad/s',
        'time': time.time() if now is None else now,
    }
    try:
        remove_abandoned(path)
        write_whole(path, json.dumps(content, indent=1) + '\n')
    except (GyroDriftFilterError, OSError) as error:
        raise MemoryFileError(str(error)) from error


def _three(values: object) -> tuple[float, ...]:
    if not isinstance(values, list) or len(values) != 3:
        raise ValueError('not three numbers')
    numbers = tuple(float(value) for value in values)
    if not all(math.isfinite(number) for number in numbers):
        raise ValueError('not finite')
    return numbers
