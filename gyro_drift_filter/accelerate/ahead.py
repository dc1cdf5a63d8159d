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

"""Compile all kernels ahead: into numba's cache, and into an extension module.

The extension module needs a C++ compiler. The registry of entry kernels says what is compiled.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from gyro_drift_filter.accelerate import cache, numba_internals
from gyro_drift_filter.accelerate.kernels import ENTRY_KERNELS, complete_note
from gyro_drift_filter.errors import GyroDriftFilterError, printable, reason


def compile_all() -> None:
    """Compile every kernel that Python calls, and keep it.

    Raises:
        GyroDriftFilterError: It can't be kept.
    """
    for name in cache.kernel_modules():
        import_module(name)
    for entry in ENTRY_KERNELS.values():
        numba_internals.compile_declared(entry.compiled, entry.types)
        if why := cache.why_unusable():
            raise GyroDriftFilterError(f'compiled kernels can not be kept: {why}')
    cache.make_note(complete_note())
    cache.remove_old()


def build_extension() -> None:
    """Build the extension module of the kernels, after `compile_all`.

    Raises:
        GyroDriftFilterError: There is no C++ compiler, no Python header, or the like. That is
            noted, so that no start of the node tries it again.
    """
    kernels = {name: (entry.function, entry.types) for name, entry in ENTRY_KERNELS.items()}
    with tempfile.TemporaryDirectory(prefix=cache.BUILD_PREFIX, dir=cache.folder()) as folder:
        output = Path(folder, 'output')
        try:
            with _output_into(output):
                built = numba_internals.build_extension(kernels, Path(folder))
            cache.keep_extension(built)
        except Exception as error:  # whatever compilers and linkers raise
            cache.make_note(cache.NO_EXTENSION)
            lines = output.read_text(errors='replace').splitlines()
            first = next((line for line in lines if 'error' in line), reason(error))
            raise GyroDriftFilterError(
                'no extension module: it needs a C++ compiler, the headers of Python and '
                f'setuptools ({printable(first)})'
            ) from error


@contextmanager
def _output_into(path: Path) -> Iterator[None]:
    """Have what compilers print, processes of their own, written to a file."""
    kept = os.dup(1), os.dup(2)
    with path.open('wb') as file:
        for number in (1, 2):
            os.dup2(file.fileno(), number)
    try:
        yield
    finally:
        for number, descriptor in enumerate(kept, 1):
            os.dup2(descriptor, number)
            os.close(descriptor)
