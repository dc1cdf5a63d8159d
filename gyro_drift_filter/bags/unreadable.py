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

"""Why a path can't be read as a bag, in words, and what to do about it."""

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from gyro_drift_filter.bags.recording import ROSBAG2_SUFFIXES, StoredPath
from gyro_drift_filter.bags.ros1_reader import REINDEX, is_of_the_system
from gyro_drift_filter.bags.rosbags_reader import reason_of_library
from gyro_drift_filter.mcap.recovery import has_damaged_summary, is_cut_off

_INFORMATION = 'rosbag2_bagfile_information'  # the key of all that a metadata.yaml says
# What may be wrong with the end of an MCAP file.
CUT_OFF, DAMAGED_SUMMARY = 'was cut off', 'has a damaged summary at its end'
_MAGIC_OF_ROS1 = b'#ROSBAG V'  # whatever the version, which rosbags judges


def why_unreadable(path: Path | StoredPath, error: Exception, suffixes: Sequence[str]) -> str:
    """Return why rosbags could not open a path, and what to do about it.

    Args:
        path: Of the bag.
        error: What rosbags has raised.
        suffixes: What the name of a bag ends with that is a single file.
    """
    why = _why_not_by_name(path, suffixes) or _why_not_of_ros1(path, error)
    if why := why or _why_not_by_metadata(path):
        return why + _fault_in(path)
    why, fault = reason_of_library(error).rstrip('.'), _fault_in(path)
    is_missing = 'files are missing' in why
    is_of_a_file = is_missing or 'seems to be empty' in why or fault
    return why + fault + (advice_on_others(path, 1 if is_missing else 2) if is_of_a_file else '')


def _why_not_by_name(path: Path | StoredPath, suffixes: Sequence[str]) -> str:
    """Return why a path can't be read whose name is that of no bag."""
    if path.suffix in suffixes or path.is_dir():
        return ''
    return (
        f'its name ends with none of {", ".join(suffixes)}: name such a file, or the folder '
        'that ROS 2 has recorded'
    )


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
    return f'its metadata.yaml is damaged, as where the recorder was killed{advice_for(path)}'


def _fault_in(path: Path | StoredPath) -> str:
    """Return a hint to the file of a folder that is not whole, if there is one."""
    with suppress(OSError):
        for file in path.glob('*.mcap') if path.is_dir() else ():
            if fault := fault_at_end(file):
                return f' ({advice_on(file.name, fault)})'
    return ''


def fault_at_end(file: Path | StoredPath) -> str:
    """Return what is wrong with the end of an MCAP file, nothing where it is whole.

    Raises:
        OSError: It can't be read.
    """
    if is_cut_off(file):
        return CUT_OFF
    return DAMAGED_SUMMARY if has_damaged_summary(file) else ''


def advice_on(name: str, fault: str) -> str:
    """Return what to do about a file in a folder that is not whole."""
    return f'{name} {fault}: name that file, to read it as far as it goes'


def advice_on_others(folder: Path | StoredPath, least: int = 2) -> str:
    """Return how to read the other files of a folder, where it holds so many at least."""
    with suppress(OSError):
        if folder.is_dir() and len(files_in(folder)) >= least:
            return (
                '. To read other files of the folder name them one by one, or move what is not '
                'whole out of it and let `ros2 bag reindex` write its metadata.yaml anew'
            )
    return ''


def advice_for(folder: Path | StoredPath) -> str:
    """Return what to name instead of a folder without its metadata."""
    files = files_in(folder)
    return f': name a file in it, as {folder / files[0]}' if files else ', and no .mcap or .db3'


def files_in(folder: Path | StoredPath) -> list[str]:
    """Return the names of the files with messages in a folder."""
    return sorted(file.name for file in folder.iterdir() if file.suffix in ROSBAG2_SUFFIXES)
