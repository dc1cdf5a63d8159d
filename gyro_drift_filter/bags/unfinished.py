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

"""The hidden folder that a bag is written in until it is complete, and what killed runs have left.

Whether a process still writes in such a folder is known by a lock on a file in it. The system
releases the lock however the process ends. The number of the process would not tell: numbers are
given again, and processes of other containers and hosts that share a disk have their own.
"""

import fcntl
import logging
import re
import shutil
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

_log = logging.getLogger(__name__)

_LOCK, _REPLACED = 'lock', 'replaced'


class UnfinishedFolder:
    """A hidden folder beside a path that is to be written; it is removed at the end.

    Attributes:
        path: Of the folder.
        replaced: Where in it that is kept which is about to be replaced.
    """

    def __init__(self, target: Path) -> None:
        """Make it.

        Raises:
            OSError: It can't be made.
        """
        self._folder = tempfile.TemporaryDirectory(
            prefix=f'.{target.name}.', suffix='.incomplete', dir=target.parent
        )
        self.path = Path(self._folder.name)
        self.replaced = self.path / _REPLACED
        # The name is given when the lock is held: a folder with a lock that nobody holds is dead.
        unheld = self.path / f'{_LOCK}.new'
        self._lock = unheld.open('xb')
        with suppress(OSError):  # a disk without locks: nobody removes this folder then
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            unheld.rename(self.path / _LOCK)

    def __enter__(self) -> 'UnfinishedFolder':
        """Return the folder itself."""
        return self

    def __exit__(self, *_: Any) -> None:
        """Remove it with all that is in it."""
        self._lock.close()  # before, as some network disks keep files that are open
        self._folder.cleanup()


def remove_abandoned(target: Path) -> None:
    """Remove the hidden folders that killed processes have left beside a path, and log that.

    What one of them had been replacing gets its name back, where nothing has taken it.

    Raises:
        OSError: The folder that the path is in can't be read.
    """
    pattern = re.compile(rf'\.{re.escape(target.name)}\.[^.]+\.incomplete')
    for folder in sorted(target.parent.iterdir()):
        if not pattern.fullmatch(folder.name) or folder.is_symlink():
            continue
        with suppress(OSError):  # no lock, one that is held, or a disk without locks: it stays
            with (folder / _LOCK).open('rb+') as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if (folder / _REPLACED).exists() and not target.exists():
                    (folder / _REPLACED).rename(target)
                    _log.warning('%s was about to be replaced by a killed run: kept', target)
            shutil.rmtree(folder)
            _log.warning('removed %s, which a killed run has left', folder)
