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

"""The bias from one recording of a robot to the next, in a file like that of the node."""

import logging
from pathlib import Path
from typing import Any

from gyro_drift_filter.bags.recording import Piece
from gyro_drift_filter.messages.imu import frame_of
from gyro_drift_filter.messages.memory_file import (
    MemoryFileError,
    RememberedBias,
    is_free_for_bias,
    recall,
    remember,
    why_not_kept,
)
from gyro_drift_filter.messages.message_filter import MessageFilter

_log = logging.getLogger(__name__)


def check_replaceable(path: Path) -> None:
    """Make sure that no other file of the user's is lost where the bias is to be kept.

    Raises:
        MemoryFileError: There is a folder, a device, or a file that is not of this kind.
    """
    if path.is_dir():
        raise MemoryFileError(f'{path} is a folder: name a file for the bias')
    if not is_free_for_bias(path):
        raise MemoryFileError(
            f'{path} holds something else than a bias, and is not replaced: name another file'
        )


class ReplayBiasMemory:
    """Recall the bias at the first message that can be read, and remember it at the end.

    Its times are the log times of the recordings.
    """

    def __init__(self, path: Path, node: str, messages: MessageFilter) -> None:
        self._path, self._node = path, node
        self._messages, self._filter = messages, messages.filter
        self._frame: str | None = None
        self._time = 0.0
        self._before: RememberedBias | None = None

    def note(self, piece: Piece, imus: Any) -> None:
        """Recall the bias before the Imu messages of a piece go through the filter."""
        rows = imus['row'].tolist()
        for row in rows if self._frame is None else ():
            self._frame = frame_of(piece.message(row))
            if self._frame is not None:
                self._recall(self._frame, int(piece.rows[row]['log_time']) * 1e-9)
                break
        if rows:
            self._time = int(piece.rows[rows[-1]]['log_time']) * 1e-9

    def _recall(self, frame: str, now: float) -> None:
        largest = self._filter.parameters.bias_max
        try:
            self._before = recall(self._path, None, frame, largest, now)
        except MemoryFileError as error:
            _log.warning('the bias of the last recording is not used: %s', error)
            return
        if self._before is None:
            return
        if self._before.age < 0.0:
            _log.warning(
                'the bias of %s is from %.0f s after the start of this recording: remove the file '
                'to begin without it, as it is used all the same',
                *(self._path, -self._before.age),
            )
        self._before.give(self._filter)

    def save(self) -> None:
        """Write what was learned, if anything was.

        Raises:
            MemoryFileError: The disk does not take it.
        """
        learned = RememberedBias.of(self._filter, self._before)
        if self._frame is None or learned is None:
            return
        if why := why_not_kept(learned, self._messages.report(), self._frame):
            _log.warning('the bias is not kept: %s', why)
            return
        remember(self._path, self._node, self._frame, learned, self._time)
