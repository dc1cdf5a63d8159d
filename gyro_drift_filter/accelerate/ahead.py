"""Build the kernels that Python calls into an extension module, where a C++ compiler is installed.

By numba's ahead-of-time compiler, numba.pycc. Types are not checked in its functions: they take
contiguous arrays as `compile_all` passes them, which is how they are called everywhere.
"""

import os
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from gyro_drift_filter.accelerate.kernels import (
    EXTENSION,
    cache_directory,
    extension_name,
    keep_extension,
    processor_features,
)
from gyro_drift_filter.bags.chunk_kernels import (
    end_batches,
    group_index,
    lay_out,
    list_messages,
    times_of,
)
from gyro_drift_filter.bags.statistics import add_results, add_samples
from gyro_drift_filter.core import commands
from gyro_drift_filter.core.step import step_sample, step_samples
from gyro_drift_filter.errors import GyroDriftFilterError, printable, reason
from gyro_drift_filter.messages.diagnostics import lay_out_arrays
from gyro_drift_filter.messages.imu_kernels import filter_imus, filter_message, read_imus

_KERNELS: tuple[Any, ...] = (
    add_results,
    add_samples,
    end_batches,
    filter_imus,
    filter_message,
    group_index,
    lay_out,
    lay_out_arrays,
    list_messages,
    read_imus,
    step_sample,
    step_samples,
    commands.change_model,
    commands.take_over,
    commands.start_state,
    commands.set_bias,
    commands.give_hint,
    commands.note_temperature,
    commands.calibrate,
    times_of,
)
_PREFIX = 'build_'
_LEFT_SECONDS = 3600.0  # a folder of a build that is older is one that was killed


def build_extension() -> None:
    """Build the extension module of the kernels, each of which has been called already.

    Raises:
        GyroDriftFilterError: There is no C++ compiler, no Python header, or the like.
    """
    place = cache_directory()
    if place is None:
        raise GyroDriftFilterError('no extension module: there is no directory to keep it in')
    for folder in place.glob(f'{_PREFIX}*'):
        if time.time() - folder.stat().st_mtime > _LEFT_SECONDS:
            shutil.rmtree(folder, ignore_errors=True)
    with tempfile.TemporaryDirectory(prefix=_PREFIX, dir=place) as folder_name:
        chatter = Path(folder_name, 'chatter')
        try:
            with _told_to(chatter):
                built = _build(Path(folder_name))
            keep_extension(built)
        except Exception as error:  # whatever compilers and linkers raise
            lines = chatter.read_text(errors='replace').splitlines()
            first = next((line for line in lines if 'error' in line), reason(error))
            raise GyroDriftFilterError(
                'no extension module: it needs a C++ compiler, the headers of Python and '
                f'setuptools ({printable(first)})'
            ) from error


def _build(folder: Path) -> Path:
    """Return the extension module, built in a folder."""
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # numba has been about to replace pycc for years
        from unittest.mock import patch  # here, as it loads much

        from numba.pycc import CC, compiler

        library = CC(EXTENSION)
        library.output_dir = str(folder)
        library.use_nrt = False  # as in `compiled`
        library.target_cpu = 'host' if processor_features() else ''
        for kernel in _KERNELS:
            signature = kernel.nopython_signatures[0]
            library.export(extension_name(kernel.py_func), signature)(kernel.py_func)
        # pycc leaves its folder behind where it fails.
        with (
            patch.object(tempfile, 'tempdir', str(folder)),
            patch.object(compiler, 'Flags', partial(_without_lock, compiler.Flags)),
        ):
            library.compile()
        return folder / str(library.output_file)


def _without_lock(flags: Callable[[], Any]) -> Any:
    """Return numba's flags with one more: to let go of the interpreter's lock, as `compiled` does.

    pycc has no option for it.
    """
    made = flags()
    made.release_gil = True
    return made


@contextmanager
def _told_to(path: Path) -> Iterator[None]:
    """Have what compilers say, processes of their own, written to a file."""
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
