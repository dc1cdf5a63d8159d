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

"""When the node recalls and saves its bias."""

import time

import numpy as np
from rclpy.node import Node

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.imu import frame_of
from gyro_drift_filter.messages.memory_file import (
    MemoryFileError,
    RememberedBias,
    file_of,
    recall,
    remember,
    why_not_kept,
)
from gyro_drift_filter.messages.message_filter import MessageFilter

# Seldom, to spare the memory card: the first rest of a run, and then this often, in s.
_SAVE_SECONDS = 60.0
# Segments of rest that show a sensor's bias after messages of another one were among its own: the
# first two may overlap, and hold some of these.
_OWN_SEGMENTS = 3


class NodeBiasMemory:
    """Recall the bias at the first message, which names the frame, and save it seldom.

    Attributes:
        recalled: True once a message has been seen that can be read.
    """

    def __init__(self, node: Node, messages: MessageFilter) -> None:
        self.recalled = False
        self._node = node
        self._messages = messages
        self._filter = messages.filter
        self._frame = ''
        self._before: RememberedBias | None = None
        self._saved: RememberedBias | None = None
        self._saved_segments = self._needed_segments = 0
        self._is_mixed = False
        self._saved_at = time.monotonic()
        self._told: set[str] = set()

    def recall(self, data: bytes) -> None:
        """Take the bias of the last run, before a serialized Imu goes through the filter."""
        frame = frame_of(data)
        if frame is None:
            return
        self.recalled, self._frame = True, frame
        parameters = self._filter.parameters
        if not parameters.bias_memory:
            return
        log = self._node.get_logger()
        try:
            name = self._node.get_fully_qualified_name()
            path = file_of(name, self._frame)
            found = recall(path, name, self._frame, parameters.bias_max)
        except (MemoryFileError, RuntimeError) as error:  # RuntimeError: a user without a home
            log.warning(f'the bias of the last run is not used: {error}')
            return
        if found is None:
            return
        self._before = found
        found.give(self._filter)
        degrees = ', '.join(f'{value:.3f}' for value in np.degrees(found.bias))
        hours = max(found.age, 0.0) / 3600.0  # a clock may have been set back
        ago = f'{hours:.1f} h' if hours >= 1.0 else f'{60.0 * hours:.0f} min'
        log.info(f'bias of {ago} ago, {degrees} deg/s, from {path}')

    def configure(self, parameters: Parameters) -> None:
        """Give the filter new parameters; another `bias.initial` replaces what was recalled."""
        if parameters.bias_initial != self._filter.parameters.bias_initial:
            self._before, self._saved_segments = None, 0
            self._needed_segments = min(self._needed_segments, _OWN_SEGMENTS)
        self._filter.configure(parameters)

    def note_publishers(self, count: int) -> None:
        """Note how many publishers the input has; several may be several sensors."""
        if self._is_mixed:  # until now, as far as is known
            self._needed_segments = self._filter.state['bias']['segments'] + _OWN_SEGMENTS
        self._is_mixed = count > 1

    def save_if_due(self) -> None:
        """Save what was learned, if this is the first rest, or the last time is long enough ago."""
        is_first_rest = self._saved_segments == 0 < self._filter.state['bias']['segments']
        if is_first_rest or time.monotonic() - self._saved_at >= _SAVE_SECONDS:
            self.save()

    def save(self) -> None:
        """Save what was learned since the last time, if anything was."""
        if not self._filter.parameters.bias_memory:
            return
        learned = RememberedBias.of(self._filter, self._before)
        if learned in (None, self._saved):
            return
        why = why_not_kept(learned, self._messages.report(), self._frame)
        if self._is_mixed:
            why = 'the input has several publishers, which may be several sensors: remap one'
        elif self._filter.state['bias']['segments'] < self._needed_segments:
            why = 'the input has had several publishers, and there was no rest since it has one'
        if why:
            self._warn(why)
            return
        self._saved_segments = int(self._filter.state['bias']['segments'])
        self._saved, self._saved_at = learned, time.monotonic()
        try:
            name = self._node.get_fully_qualified_name()
            path = file_of(name, self._frame)
            remember(path, name, self._frame, learned)
        except (MemoryFileError, RuntimeError) as error:
            self._warn(f'{error}; set bias.memory to false if that is intended')

    def _warn(self, why: str) -> None:
        """Tell once of each reason why the bias is not saved."""
        if why not in self._told:
            self._node.get_logger().warning(f'the bias will not be remembered: {why}')
        self._told.add(why)
