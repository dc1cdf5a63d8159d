"""Build the kernels that Python calls into an extension module, where a C compiler is installed.

By numba's ahead-of-time compiler, numba.pycc. Types are not checked in its functions: they take
contiguous arrays as `compile_all` passes them, which is how they are called everywhere.
"""

import tempfile
import warnings
from pathlib import Path
from typing import Any

from gyro_drift_filter.bags.chunk_kernels import lay_out, list_messages
from gyro_drift_filter.bags.imu_kernels import filter_imus, filter_message, read_imus
from gyro_drift_filter.bags.moments import add_samples
from gyro_drift_filter.core.compiled import (
    EXTENSION,
    checksum,
    checksum_path,
    extension_name,
    extension_path,
    processor_features,
)
from gyro_drift_filter.core.errors import GyroDriftFilterError, reason
from gyro_drift_filter.core.filter import run_samples, step_sample

_KERNELS: tuple[Any, ...] = (
    add_samples,
    filter_imus,
    filter_message,
    lay_out,
    list_messages,
    read_imus,
    run_samples,
    step_sample,
)


def build_extension() -> None:
    """Build the extension module of the kernels, each of which has been called already.

    Raises:
        GyroDriftFilterError: There is no C compiler, no Python header, or the like.
    """
    path = extension_path()
    if path is None:
        return
    try:
        with tempfile.TemporaryDirectory(dir=path.parent) as folder, warnings.catch_warnings():
            warnings.simplefilter('ignore')  # numba has been about to replace pycc for years
            from numba.pycc import CC

            library = CC(EXTENSION)
            library.output_dir = folder
            library.target_cpu = 'host' if processor_features() else ''
            for kernel in _KERNELS:
                signature = kernel.nopython_signatures[0]
                library.export(extension_name(kernel.py_func), signature)(kernel.py_func)
            library.compile()
            built = Path(folder, library.output_file)
            checksum_path(path).write_text(checksum(built))
            built.replace(path)
    except Exception as error:  # whatever compilers and linkers raise
        raise GyroDriftFilterError(f'no extension module: {reason(error)}') from error
