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
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path, PurePath
from typing import Protocol, Self

from gyro_drift_filter.bags.library import (
    AnyReader,
    AnyReaderError,
    DirectoryReader,
    McapReader,
    RPath,
)
from gyro_drift_filter.bags.mcap_reader import chunk_reader
from gyro_drift_filter.bags.message_types import all_types
from gyro_drift_filter.bags.recording import ROSBAG2_SUFFIXES, BagError, Recording
from gyro_drift_filter.bags.ros1_reader import REINDEX, Ros1Reader, is_of_the_system
from gyro_drift_filter.bags.rosbags_reader import RosbagsReader, reason_of_library
from gyro_drift_filter.errors import reason
from gyro_drift_filter.mcap.records import McapError
from gyro_drift_filter.mcap.recovery import has_damaged_summary, is_cut_off, recover


class StoredPath(RPath, Protocol):
    """What stands for a path in a store that is no file system."""

    @property
    def name(self) -> str:
        """Its last part."""

    def iterdir(self) -> Iterator[Self]:
        """Yield what a folder holds."""

    def glob(self, pattern: str) -> Iterator[Self]:
        """Yield what matches a pattern in a folder."""


_log = logging.getLogger(__name__)
# What the name of a bag ends with that is a single file.
FILE_SUFFIXES = (*ROSBAG2_SUFFIXES, '.bag')
_INFORMATION = 'rosbag2_bagfile_information'  # the key of all that a metadata.yaml says
# What may be wrong with the end of an MCAP file.
_CUT_OFF, _DAMAGED_SUMMARY = 'was cut off', 'has a damaged summary at its end'
_MAGIC_OF_ROS1 = b'#ROSBAG V'  # whatever the version, which rosbags judges


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
        yield choose_reader(library)


def choose_reader(library: AnyReader) -> Recording:
    """Return the fastest reader that there is for what rosbags has opened."""
    if not library.is2:
        return Ros1Reader(library)
    return chunk_reader(library) or RosbagsReader(library)


def _opened(path: Path | StoredPath, name: Path | StoredPath) -> AnyReader:
    # A file that lies raises nearly anything out of the parser: all of it is a bag that can't be
    # read. Errors of the caller's own pass, as the reader is open by then.
    try:
        reader = AnyReader([path])
        try:
            reader.open()
        except AnyReaderError:  # as of a bag that holds no definitions
            reader = AnyReader([path], default_typestore=all_types())
            reader.open()
    except Exception as error:
        why = _why_not_by_name(path) or _why_not_of_ros1(path, error)
        why = why or _why_not_by_metadata(path) or reason_of_library(error)
        raise BagError(f'{name} can not be read as a bag: {why}{_fault_in(path)}') from error
    return reader


def _check_summaries(library: AnyReader, folder: Path | StoredPath) -> None:
    """Look whether the files of a folder have the summaries by which they were written.

    Raises:
        BagError: One has not, so that messages might be lost without a word.
    """
    storage = getattr(library.readers[0], 'storage', None)
    for file in storage.storages if isinstance(storage, DirectoryReader) else ():
        if isinstance(file, McapReader) and has_damaged_summary(file.path):
            advice = _advice_on(PurePath(str(file.path)).name, _DAMAGED_SUMMARY)
            raise BagError(f'{folder} can not be read as a bag: {advice}')


def _advice_on(name: str, fault: str) -> str:
    """Return what to do about a file in a folder that is not whole."""
    return f'{name} {fault}: name that file, to read it as far as it goes'


def _why_not_by_name(path: Path | StoredPath) -> str:
    """Return why a path can't be read whose name is that of no bag."""
    if path.suffix in FILE_SUFFIXES or path.is_dir():
        return ''
    return (
        f'its name ends with none of {", ".join(FILE_SUFFIXES)}: name such a file, or the folder '
        'that ROS 2 has recorded'
    )


def _why_not_by_metadata(path: Path | StoredPath) -> str:
    """Return why a folder can't be read whose metadata.yaml is not that of a bag."""
    if not path.is_dir():
        return ''
    import yaml

    try:
        with (path / 'metadata.yaml').open('rb') as file:
            found = yaml.safe_load(file)
    except (OSError, UnicodeDecodeError, RecursionError, yaml.YAMLError):
        found = None
    if isinstance(found, dict) and isinstance(found.get(_INFORMATION), dict):
        return ''
    return f'its metadata.yaml is damaged, as where the recorder was killed{_advice_for(path)}'


def _advice_for(folder: Path | StoredPath) -> str:
    """Return what to name instead of a folder without its metadata."""
    files = sorted(file.name for file in folder.iterdir() if file.suffix in ROSBAG2_SUFFIXES)
    return f': name a file in it, as {folder / files[0]}' if files else ', and no .mcap or .db3'


def _why_not_of_ros1(path: Path | StoredPath, error: Exception) -> str:
    """Return why a file in .bag can't be read, where what rosbags has said of it helps nobody."""
    begin = b''
    if path.suffix == '.bag':
        with suppress(OSError), path.open('rb') as file:
            begin = file.read(len(_MAGIC_OF_ROS1))
    if begin and not _MAGIC_OF_ROS1.startswith(begin):
        return (
            'it is no bag of ROS 1, though its name ends so: name the folder that ROS 2 has '
            'recorded, or the .mcap or .db3 file in it'
        )
    said = str(error)
    if not begin or is_of_the_system(error):
        return ''
    if any(words in said for words in ('index', 'could not be read')):
        return f'its index is missing or damaged, as where the recorder was killed: {REINDEX}'
    if 'not supported' in said:
        return ''
    return f'it is damaged, or the definition of a message in it is unknown: {REINDEX}'


def _fault_of(file: Path | StoredPath) -> str:
    """Return what is wrong with the end of an MCAP file, nothing where it is whole.

    Raises:
        OSError: It can't be read.
    """
    if is_cut_off(file):
        return _CUT_OFF
    return _DAMAGED_SUMMARY if has_damaged_summary(file) else ''


def _fault_in(path: Path | StoredPath) -> str:
    """Return a hint to the file of a folder that is not whole, if there is one."""
    with suppress(OSError):
        for file in path.glob('*.mcap') if path.is_dir() else ():
            if fault := _fault_of(file):
                return f' ({_advice_on(file.name, fault)})'
    return ''


def _recovered(path: Path | StoredPath, stack: ExitStack) -> Path | StoredPath:
    """Return a path to open: where an MCAP file is not whole, to a copy of what is whole of it.

    The copy is removed with the stack.
    """
    try:
        fault = _fault_of(path) if path.suffix == '.mcap' and not path.is_dir() else ''
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
    if count == 0 and fault == _CUT_OFF:
        raise BagError(f'{path} was cut off before its first whole message')
    if count == 0:
        raise BagError(f'{path} {fault}, and holds no whole message')
    why = ', as when the recorder is killed' if fault == _CUT_OFF else ''
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
                f'{path} is no rosbag2 folder: it holds no metadata.yaml{_advice_for(path)}'
            )
        if path.suffix == '.bag' and path.is_dir():
            # rosbags judges by the name.
            raise BagError(f'{path}: rename the folder, as names in .bag are taken for ROS 1')
    except OSError as error:
        raise BagError(f'{path} can not be opened: {error.strerror}') from error
