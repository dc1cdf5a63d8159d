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

"""Where machine code is kept on disk: one folder for each content of the files with kernels.

numba's own cache looks only at the file that a kernel stands in, so that a kernel would keep the
old code of one that it calls from another file. Here the folder is named after the content of all
files that hold kernels, of those that they import, and after what the machine code depends on
besides. It also works where the package is installed read-only, as by apt.

In a folder is the extension module, with its checksum at the end. Where none could be built there
are numba's own files instead, one for each kernel that Python calls, and an empty file as a note,
`complete_<version of numba>`.
Only `why_unusable` and what keeps something write to the disk.
"""

import functools
import hashlib
import os
import platform
import re
import sys
import time
from contextlib import suppress
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import numpy as np

EXTENSION = 'gyro_drift_filter_kernels'

_PACKAGE = Path(__file__).parent.parent
# Plain text in front, as each start looks for it in all files.
_KERNEL = re.compile(rb'\n@(?:entry_|inlined_)?kernel\b')
_IMPORT = re.compile(rb'from (gyro_drift_filter[\w.]*) import (\([^)]*\)|.*)')
_OTHERS_KEPT = 3  # other versions of the package, and the one before an update
_BUILD_SECONDS = 3600.0  # a folder of a build that is older belongs to one that was killed

_unusable = ''  # why nothing can be kept, where that has been found


def kernel_modules() -> list[str]:
    """Return the names of the modules that hold kernels."""
    return [name for name, path in _modules().items() if _KERNEL.search(path.read_bytes())]


def covered_files() -> dict[Path, bytes]:
    """Return the files after which the folder is named, and their contents.

    They are those that hold kernels and, as constants and records that they import become a part
    of kernels, all of this package that these import in their turn.
    """
    modules = _modules()
    contents = {path: path.read_bytes() for path in modules.values()}
    waiting = [path for path, content in contents.items() if _KERNEL.search(content)]
    covered = set()
    while waiting:
        path = waiting.pop()
        if path in covered:
            continue
        covered.add(path)
        for source, names in _IMPORT.findall(contents[path]):
            for name in re.findall(r'\w+', names.decode()):
                module = source.decode()
                found = modules.get(f'{module}.{name}') or modules.get(module)
                if found is not None:
                    waiting.append(found)
    return {path: contents[path] for path in sorted(covered)}


def _modules() -> dict[str, Path]:
    """Return the files of this package by the names of their modules."""
    modules = {}
    for folder, _, files in os.walk(_PACKAGE):
        package = _PACKAGE.name + folder[len(str(_PACKAGE)) :].replace(os.sep, '.')
        for file in files:
            if file.endswith('.py'):
                name = f'{package}.{file[:-3]}'.removesuffix('.__init__')
                modules[name] = Path(folder, file)
    return modules


@functools.cache
def processor() -> str:
    """Return what tells which machine code this machine can run, empty where that is not known."""
    names = 'flags', 'Features', 'model name', 'CPU part'
    with suppress(OSError), Path('/proc/cpuinfo').open() as file:
        first, _, _ = file.read(16_384).partition('\n\n')  # the others are as the first one
        return '\n'.join(line for line in first.split('\n') if line.startswith(names))
    return ''


def _root() -> Path:
    """Return the folder of all versions."""
    for place in (os.environ.get('NUMBA_CACHE_DIR'), os.environ.get('XDG_CACHE_HOME')):
        if place and Path(place).is_absolute():
            return Path(place) / _PACKAGE.name
    with suppress(RuntimeError):
        if os.environ.get('HOME') != '':  # else the home would be the root folder
            return Path.home() / '.cache' / _PACKAGE.name
    return Path(os.devnull, 'no home')  # where nothing can be made


@functools.cache
def folder() -> Path:
    """Return where this version of the kernels is kept; it need not be there."""
    key = hashlib.sha256(
        f'{sys.version} {np.__version__} {platform.machine()} {processor()}'.encode()
    )
    for path, content in covered_files().items():
        key.update(f'{path.relative_to(_PACKAGE)} {len(content)} '.encode())
        key.update(content)
    return _root() / key.hexdigest()[:16]


def why_unusable() -> str:
    """Make the folder, and return why nothing can be kept in it, empty where it can be."""
    if _unusable:
        return _unusable
    try:
        folder().mkdir(parents=True, exist_ok=True)
    except OSError as error:
        return str(error)
    return '' if os.access(folder(), os.W_OK) else 'no permission to write'


def report_unusable(reason: str) -> None:
    """Log once that nothing can be kept; it is not tried again in this process."""
    global _unusable
    if not _unusable:
        import logging  # here, as hardly any process needs it

        logging.getLogger(_PACKAGE.name).warning(
            f'kernels can not be kept in {folder()}: {reason}; each start compiles them anew'
        )
    _unusable = reason


def is_noted(note: str) -> bool:
    """Tell whether there is a note of this name."""
    return (folder() / note).exists()


def make_note(note: str) -> None:
    """Leave a note of this name where later processes find it."""
    with suppress(OSError):
        (folder() / note).touch()


def build_prefix(process: int | None = None) -> str:
    """Return what names of folders for builds begin with, all or those of a process."""
    return 'build_' if process is None else f'build_{process}_'


def remove_own_builds() -> None:
    """Remove what this process has begun to build, as it is to be ended."""
    import shutil

    for path in folder().glob(f'{build_prefix(os.getpid())}*'):
        shutil.rmtree(path, ignore_errors=True)


def remove_old() -> None:
    """Remove the folders of other versions but the newest, and what killed builds have left."""
    import shutil  # here, as it loads all kinds of compression, and hardly any process needs it

    with suppress(OSError):  # another process does the same
        folders = [
            (path.stat().st_mtime, path)
            for path in folder().parent.iterdir()
            if re.fullmatch('[0-9a-f]{16}', path.name) and path != folder() and path.is_dir()
        ]
        oldest = time.time() - _BUILD_SECONDS
        builds = [
            path for path in folder().glob(f'{build_prefix()}*') if path.stat().st_mtime < oldest
        ]
        for path in [path for _, path in sorted(folders)[:-_OTHERS_KEPT]] + builds:
            shutil.rmtree(path, ignore_errors=True)


def _extension_path() -> Path:
    return folder() / f'{EXTENSION}.so'


def keep_extension(built: Path) -> None:
    """Put a new extension module where later processes find it, with its checksum at the end.

    Raises:
        OSError: It can't be kept.
    """
    content = built.read_bytes()
    built.write_bytes(content + hashlib.sha256(content).digest())
    built.replace(_extension_path())


def is_extension_whole() -> bool:
    """Tell whether it is there and undamaged: a cut-off one would kill the process."""
    try:
        content = _extension_path().read_bytes()
    except OSError:
        return False
    size = hashlib.sha256().digest_size
    return len(content) > size and content[-size:] == hashlib.sha256(content[:-size]).digest()


def load_extension() -> ModuleType | None:
    """Return the extension module, None where there is none that can be used."""
    if not is_extension_whole():
        return None
    path = str(_extension_path())
    spec = spec_from_file_location(EXTENSION, path, loader=ExtensionFileLoader(EXTENSION, path))
    assert spec is not None
    assert spec.loader is not None
    with suppress(ImportError):  # of libraries that are gone
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module
    return None
