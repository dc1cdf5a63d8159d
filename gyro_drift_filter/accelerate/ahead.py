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

"""Compile all kernels ahead: into an extension module or, without a C++ compiler, numba's cache.

The registry of entry kernels says what is compiled.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, suppress
from importlib import import_module
from pathlib import Path

from gyro_drift_filter.accelerate import cache, numba_internals
from gyro_drift_filter.accelerate.kernels import ENTRY_KERNELS, complete_note, use_extension
from gyro_drift_filter.errors import GyroDriftFilterError, printable, reason


def compile_all() -> str:
    """Compile every kernel that Python calls, and keep it.

    Returns:
        Why there is no extension module, so that each start loads numba; empty where there is one.

    Raises:
        GyroDriftFilterError: Nothing can be kept.
    """
    if why := cache.why_unusable():
        raise GyroDriftFilterError(f'compiled kernels can not be kept: {why}')
    for name in cache.kernel_modules():
        import_module(name)
    missing = _build_extension()
    if missing:
        fill_cache()
    cache.remove_old()
    return missing


def _build_extension() -> str:
    """Build the extension module, and return why it can not be used, empty where it can."""
    kernels = {name: (entry.function, entry.types) for name, entry in ENTRY_KERNELS.items()}
    prefix = cache.build_prefix(os.getpid())
    with tempfile.TemporaryDirectory(prefix=prefix, dir=cache.folder()) as folder:
        output = Path(folder, 'output')
        try:
            with _output_into(output):
                built = numba_internals.build_extension(kernels, Path(folder))
            cache.keep_extension(built)
        except Exception as error:  # whatever compilers and linkers raise
            lines = output.read_text(errors='replace').splitlines() if output.exists() else []
            first = next((line for line in lines if 'error' in line), reason(error))
            return (
                'no extension module: it needs a C++ compiler, the headers of Python and '
                f'setuptools ({printable(first)})'
            )
    return '' if use_extension() else f'no extension module: {cache.folder()} can not hold one'


def fill_cache() -> None:
    """Compile every entry kernel into numba's cache.

    Raises:
        GyroDriftFilterError: Nothing can be kept.
    """
    for entry in ENTRY_KERNELS.values():
        numba_internals.compile_declared(entry.compiled, entry.types)
        if why := cache.why_unusable():
            raise GyroDriftFilterError(f'compiled kernels can not be kept: {why}')
    cache.make_note(complete_note())


def _open_if_closed(number: int) -> None:
    """Have a descriptor that is closed lead nowhere: else a file would get its number."""
    try:
        os.fstat(number)
    except OSError:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        if nowhere != number:
            os.dup2(nowhere, number)
            os.close(nowhere)


@contextmanager
def _output_into(path: Path) -> Iterator[None]:
    """Have what compilers print, processes of their own, written to a file.

    What this process tells of its progress is printed all the same.
    """
    for number in (1, 2):
        _open_if_closed(number)
    kept = os.dup(1), os.dup(2)
    with path.open('wb') as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    told = os.fdopen(kept[1], 'w', closefd=False)
    try:
        with redirect_stderr(told):
            yield
    finally:
        with suppress(OSError):  # where its reader has left
            told.close()
        for number, descriptor in enumerate(kept, 1):
            os.dup2(descriptor, number)
            os.close(descriptor)
