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

"""Results: whether they can be written, looked at before the work, and the telling after it."""

import argparse
import dataclasses
import json
import os
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np

from gyro_drift_filter.cli.printing import say, tell
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.report.verdict import Verdict

_PICTURES = ('.png', '.svg', '.pdf', '.ps', '.eps', '.jpg', '.jpeg', '.tif', '.tiff', '.webp')
_NONE: Mapping[str, Path | None] = MappingProxyType({})
# What `--json` takes for the standard output.
_STANDARD_OUTPUT = Path('-')


def add_json_option(command: argparse.ArgumentParser, what: str) -> None:
    """Add the option `--json`, by which programs get the results."""
    command.add_argument(
        '--json',
        type=Path,
        metavar='FILE',
        help=f'write {what}, for programs; - for the standard output, in place of the text',
    )


def check_targets(
    files: Mapping[str, Path | None],
    pictures: Mapping[str, Path | None] = _NONE,
    others: Mapping[str, Path | None] = _NONE,
    page: Path | None = None,
) -> None:
    """Make sure that what is to be written can be, before the work and not after it.

    Args:
        files: By the options that name them; they must not exist.
        pictures: Folders that pictures are written into; there must be none in them.
        others: Paths whose writers look themselves at what is there, as they replace some of it.
            What is in a folder of these is theirs alone.
        page: HTML file that `--output` names; as `files`.

    Raises:
        GyroDriftFilterError: It can't, or two of the options name the same path, or one lies within
            another.
    """
    if files.get('--json') == _STANDARD_OUTPUT:
        files = {**files, '--json': None}
    if page is not None:
        if page.suffix.lower() in _PICTURES:
            raise GyroDriftFilterError(
                f'--output {page}: what is written is an HTML page: name it .html'
            )
        files = {'--output': page, **files}
    named: dict[str, str] = {}
    for option, path in (*files.items(), *pictures.items(), *others.items()):
        if path is None:
            continue
        first = named.setdefault(os.path.realpath(path), option)
        if first != option:
            raise GyroDriftFilterError(f'{first} and {option} name the same path, {path}')
        _check_lies_beside(path, option, others)
    for path in filter(None, files.values()):
        _check_file(path)
    for option, folder in pictures.items():
        if folder is not None:
            _check_picture_folder(option, folder)
    for option, path in others.items():
        if path is not None:
            _check_can_be_made(option, path.absolute().parent)


def _check_file(path: Path) -> None:
    if path.is_dir():
        raise GyroDriftFilterError(f'{path} is a folder: name a file')
    if path.exists() or path.is_symlink():
        raise GyroDriftFilterError(f'{path} exists already: remove it or choose another name')
    if not path.parent.is_dir():
        raise GyroDriftFilterError(f'{path}: there is no folder {path.parent}')
    _check_writable(path.parent)


def _check_picture_folder(option: str, folder: Path) -> None:
    if folder.suffix.lower() in _PICTURES and not folder.is_dir():
        raise GyroDriftFilterError(
            f'{option} {folder}: name a folder; several PNG files are written into it'
        )
    _check_can_be_made(option, folder)
    check_no_pictures(option, folder)


def _check_lies_beside(path: Path, option: str, folders: Mapping[str, Path | None]) -> None:
    for name, folder in folders.items():
        if folder and Path(os.path.realpath(folder)) in Path(os.path.realpath(path)).parents:
            raise GyroDriftFilterError(
                f'{option} {path} lies within {name} {folder}, which holds nothing else than what '
                'is made there: choose another name'
            )


def check_no_pictures(option: str, folder: Path) -> None:
    """Make sure that no picture is written over.

    Raises:
        GyroDriftFilterError: The folder holds some.
    """
    if any(folder.glob('*.png')):
        raise GyroDriftFilterError(
            f'{option} {folder}: it holds PNG files already: remove them or choose another folder'
        )


def _check_can_be_made(option: str, folder: Path) -> None:
    above = folder.absolute()
    while not above.exists():
        above = above.parent
    if not above.is_dir():
        raise GyroDriftFilterError(f'{option} {folder}: {above} is no folder')
    _check_writable(above)


def _check_writable(folder: Path) -> None:
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise GyroDriftFilterError(f'{folder} can not be written: {error.strerror}') from error


@contextmanager
def saying(
    report: str, json_file: Path | None, value: Any, remarks: Iterable[str] = ()
) -> Iterator[list[Path]]:
    """Write results into the file that `--json` names, and say them and which files were written.

    The list yielded takes the other files. Where one could not be written, as the disk is full, the
    results are told all the same, as they took long to find. The standard output comes last, as its
    reader may have left.

    Args:
        report: The results as text; empty where nothing is to be said.
        json_file: What `--json` names: `-` has the value said in place of the text.
        value: The results for programs.
        remarks: What is told of the results on stderr, after them.

    Raises:
        GyroDriftFilterError: The results can't be written or said.
    """
    written: list[Path] = []
    try:
        try:
            yield written
        finally:
            if json_file is not None and json_file != _STANDARD_OUTPUT:
                write_whole(json_file, f'{_as_json(value)}\n')
                written.append(json_file)
    finally:
        try:
            if json_file == _STANDARD_OUTPUT:
                say(_as_json(value), after_files=bool(written))
            elif report:
                say(with_files(report, written), after_files=bool(written))
        finally:
            for remark in remarks:
                tell(remark)


def with_files(report: str, written: Sequence[Path]) -> str:
    """Return a text with the files that were written at its end, if there are any."""
    listed = '\n      '.join(map(str, written))
    return f'{report}\n\nwrote {listed}' if written else report


def _as_json(value: Any) -> str:
    """Return what `as_plain` makes of a value as JSON; what is not known is null."""
    return json.dumps(as_plain(value), indent=1, allow_nan=False)


def verdicts_of(bags: Iterable[tuple[Path, Iterable['Verdict']]]) -> dict[str, Any]:
    """Return verdicts on bags for programs, in SI units; `Verdict` says what each figure is."""
    plain = [
        {'bag': str(bag), **as_plain(verdict)} for bag, verdicts in bags for verdict in verdicts
    ]
    return {'verdicts': plain}


def as_plain(value: Any) -> Any:
    """Return records and arrays as what JSON knows, without fields that are not `in_json`."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: as_plain(getattr(value, field.name))
            for field in dataclasses.fields(value)
            if field.metadata.get('in_json', True)
        }
    if hasattr(value, '_asdict'):  # a NamedTuple
        return as_plain(value._asdict())
    if isinstance(value, dict):
        return {key: as_plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_plain(item) for item in value]
    if isinstance(value, np.ndarray):
        return as_plain(value.tolist())
    if isinstance(value, np.generic):
        return as_plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value
