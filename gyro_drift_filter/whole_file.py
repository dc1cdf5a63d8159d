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

"""Files that are there whole or not at all, whatever ends the run, a power cut included."""

import fcntl
import glob
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, BinaryIO

from gyro_drift_filter.errors import GyroDriftFilterError, reason

_LONG_AGO = 3600.0  # s


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield where to write a file, which is there with the end of the block; so are its folders.

    Where the path is a symbolic link, it is what that leads to.

    Raises:
        GyroDriftFilterError: It can't be written.
    """
    target = _target(path)
    unfinished = target.with_name(f'.{target.name}.{os.getpid()}.incomplete')
    try:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            with _locked(unfinished):
                yield unfinished
                # Else a power cut may leave the new name without the content.
                _put_on_disk(unfinished)
                unfinished.replace(target)
            with suppress(OSError):  # not every file system does this with folders
                _put_on_disk(target.parent)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        why = error.strerror or reason(error)
        raise GyroDriftFilterError(f'{path} can not be written: {why}') from error


def _target(path: Path) -> Path:
    """Return what a path leads to where it is a symbolic link; one to itself is that itself."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _locked(path: Path) -> BinaryIO:
    """Return a file that is open, empty, and locked, which tells others that the process writes.

    It gets its name when the lock is held, as in `bags/unfinished.py`: else who looks in between
    removes it.
    """
    unheld = path.with_name(f'{path.name}.new')
    file = unheld.open('wb')
    with suppress(OSError):  # a disk without locks: nobody removes it then
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    unheld.rename(path)
    return file


def remove_abandoned(path: Path) -> None:
    """Remove what killed processes have left of a file that they were writing.

    Each lock tells whether its process still writes, as for `bags/unfinished.py`.
    """
    target = _target(path)
    pattern = f'.{glob.escape(target.name)}.[0-9]*.incomplete'
    for left in target.parent.glob(pattern):
        with suppress(OSError), left.open('rb+') as lock:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            left.unlink()
    for left in target.parent.glob(f'{pattern}.new'):
        with suppress(OSError):  # no lock tells, but it has this name for a moment alone
            if left.stat().st_mtime < time.time() - _LONG_AGO:
                left.unlink()


def _put_on_disk(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_whole(path: Path, text: str) -> None:
    """Write a text as `whole_file` does."""
    with whole_file(path) as unfinished:
        unfinished.write_text(text, encoding='utf-8')


def draw_whole(path: Path, figure: Any) -> None:
    """Write a figure of matplotlib as a PNG file, as `whole_file` does."""
    with whole_file(path) as unfinished:
        figure.savefig(unfinished, format='png', dpi=110)
