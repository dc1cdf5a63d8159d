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

"""Open a bag for reading: the one place that knows all readers."""

import logging
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePath
from typing import Any

from gyro_drift_filter.bags.definitions import LibraryOfRos1, LibraryOfRos2
from gyro_drift_filter.bags.library import DirectoryReader, McapReader
from gyro_drift_filter.bags.mcap_reader import chunk_reader
from gyro_drift_filter.bags.recording import ROSBAG2_SUFFIXES, BagError, Recording, StoredPath
from gyro_drift_filter.bags.ros1_reader import Ros1Reader
from gyro_drift_filter.bags.rosbags_reader import RosbagsReader
from gyro_drift_filter.bags.unreadable import (
    CUT_OFF,
    DAMAGED_SUMMARY,
    advice_for,
    advice_on,
    advice_on_others,
    fault_at_end,
    files_in,
    why_unreadable,
)
from gyro_drift_filter.errors import reason
from gyro_drift_filter.mcap.records import McapError
from gyro_drift_filter.mcap.recovery import has_damaged_summary, recover

_log = logging.getLogger(__name__)
_LARGEST_METADATA = 2**22  # bytes: those of 4,000 topics with their QoS, or of 16,000 files
# What the name of a bag ends with that is a single file.
FILE_SUFFIXES = (*ROSBAG2_SUFFIXES, '.bag')


@contextmanager
def open_bag(path: Path | StoredPath) -> Iterator[Recording]:
    """Open a rosbag2 folder, a bare .mcap or .db3 file, or a .bag file of ROS 1 for reading.

    Instead of a path it may be what stands for one in a store that is no file system.

    Raises:
        BagError: The path is missing, or is no bag that rosbags can read.
    """
    check_path(path)
    with ExitStack() as stack:
        library = _opened(_recovered(path, stack), path)
        stack.callback(library.close)
        _check_summaries(library, path)
        _note_unlisted(library, path)
        yield choose_reader(library)


def choose_reader(library: LibraryOfRos1 | LibraryOfRos2) -> Recording:
    """Return the fastest reader that there is for what rosbags has opened."""
    if isinstance(library, LibraryOfRos1):
        return Ros1Reader(library)
    return chunk_reader(library) or RosbagsReader(library)


def _opened(path: Path | StoredPath, name: Path | StoredPath) -> LibraryOfRos1 | LibraryOfRos2:
    # A file that lies raises nearly anything out of the parser: all of it is a bag that can't be
    # read. Errors of the caller's own pass, as the reader is open by then.
    try:
        library = (LibraryOfRos1 if path.suffix == '.bag' else LibraryOfRos2)(path)
        library.open()
    except Exception as error:
        why = why_unreadable(path, error, FILE_SUFFIXES)
        raise BagError(f'{name} can not be read as a bag: {why}') from error
    return library


def _check_summaries(library: LibraryOfRos1 | LibraryOfRos2, folder: Path | StoredPath) -> None:
    """Look whether the files of a folder have the summaries by which they were written.

    Raises:
        BagError: One has not, so that messages might be lost without a word.
    """
    for file in _files_of(library):
        if isinstance(file, McapReader) and has_damaged_summary(file.path):
            advice = advice_on(PurePath(str(file.path)).name, DAMAGED_SUMMARY)
            raise BagError(f'{folder} can not be read as a bag: {advice}{advice_on_others(folder)}')


def _files_of(library: LibraryOfRos1 | LibraryOfRos2) -> Sequence[Any]:
    """Return the readers of the files of a folder; none where a single file is read."""
    storage = getattr(library, 'storage', None)
    return storage.storages if isinstance(storage, DirectoryReader) else ()


def _note_unlisted(library: LibraryOfRos1 | LibraryOfRos2, folder: Path | StoredPath) -> None:
    """Tell of the files of a folder that its metadata.yaml does not list, so that nobody reads."""
    listed = {PurePath(str(file.path)).name for file in _files_of(library)}
    if not listed:
        return
    with suppress(OSError):
        if unlisted := [name for name in files_in(folder) if name not in listed]:
            _log.warning(
                '%s: left out, as metadata.yaml does not list it: %s; `ros2 bag reindex` writes it '
                'anew',
                folder,
                ', '.join(unlisted),
            )


def _recovered(path: Path | StoredPath, stack: ExitStack) -> Path | StoredPath:
    """Return a path to open: where an MCAP file is not whole, to a copy of what is whole of it.

    The copy is removed with the stack.
    """
    try:
        fault = fault_at_end(path) if path.suffix == '.mcap' and not path.is_dir() else ''
    except OSError as error:
        raise BagError(f'{path} can not be opened: {reason(error)}') from error
    if not fault:
        return path
    try:
        copy = Path(stack.enter_context(tempfile.TemporaryDirectory())) / path.name
        count = recover(path, copy)
    except McapError as error:
        raise BagError(f'{path} {fault}, and what is there {error}') from error
    except OSError as error:
        raise BagError(
            f'{path} {fault}, and what is whole of it can not be copied: {reason(error)}'
        ) from error
    if count == 0 and fault == CUT_OFF:
        raise BagError(f'{path} was cut off before its first whole message')
    if count == 0:
        raise BagError(f'{path} {fault}, and holds no whole message')
    why = ', as when the recorder is killed' if fault == CUT_OFF else ''
    _log.warning('%s %s%s: read to its last whole message (%d)', path, fault, why, count)
    return copy


def check_path(path: Path | StoredPath) -> None:
    """Look whether a path can be that of a bag.

    Raises:
        BagError: It is missing, or is something else.
    """
    try:
        if not path.exists():
            raise BagError(f'no such bag: {path}')
        if isinstance(path, Path) and not (path.is_file() or path.is_dir()):
            raise BagError(f'{path} is no bag: it is neither a file nor a folder')
        if path.is_dir() and not (path / 'metadata.yaml').exists():
            raise BagError(
                f'{path} is no rosbag2 folder: it holds no metadata.yaml{advice_for(path)}'
            )
        if path.is_dir() and (path / 'metadata.yaml').stat().st_size > _LARGEST_METADATA:
            raise BagError(
                f'{path} can not be read as a bag: its metadata.yaml is longer than '
                f'{_LARGEST_METADATA} bytes{advice_for(path)}'
            )
        if path.suffix == '.bag' and path.is_dir():
            # rosbags judges by the name.
            raise BagError(f'{path}: rename the folder, as names in .bag are taken for ROS 1')
    except OSError as error:
        raise BagError(f'{path} can not be opened: {error.strerror}') from error
