"""Compiled kernels: from an extension module, by numba, or as the plain Python that they are.

All three give the same results (test/test_compiled.py). `gyro_drift compile` makes the extension
module where a C compiler is installed (cli/extension.py): a process that finds it does not load
numba, which is two thirds of the node's memory and half of its start.
"""

import hashlib
import os
import platform
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from importlib.machinery import ExtensionFileLoader
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import numpy as np

EXTENSION = 'gyro_drift_filter_kernels'

Function = TypeVar('Function', bound=Callable[..., Any])


def _cache_directory() -> str | None:
    """Return where compiled kernels are kept, or None where no directory can be written.

    numba's own cache looks only at the file that a kernel stands in, so a kernel would keep the
    old code of one that it calls from another file. Here the directory is named after the content
    of all files that hold kernels, in core and bags: any edit starts a new cache. It also works
    where the package is installed read-only, as by apt.
    """
    content = hashlib.sha256()
    package = Path(__file__).parent.parent
    for path in sorted([*package.glob('core/*.py'), *package.glob('bags/*.py')]):
        content.update(path.read_bytes())
    try:
        user_cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
        root = Path(os.environ.get('NUMBA_CACHE_DIR') or user_cache / 'gyro_drift_filter')
        directory = root / content.hexdigest()[:16]
        directory.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # read-only, or a user without a home
        return None
    return str(directory) if os.access(directory, os.W_OK) else None


_DIRECTORY = _cache_directory()


def processor_features() -> str:
    """Return what tells which machine code this machine can run, empty where that is not known."""
    with suppress(OSError):
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith(('flags', 'Features')):
                return line
    return ''


def extension_path() -> Path | None:
    """Return where the extension module is or is to be; None where nothing can be kept."""
    if _DIRECTORY is None:
        return None
    kind = f'{sys.version} {np.__version__} {platform.machine()} {processor_features()}'
    return Path(_DIRECTORY) / f'{EXTENSION}_{hashlib.sha256(kind.encode()).hexdigest()[:16]}.so'


def checksum_path(extension: Path) -> Path:
    """Return where the checksum of the extension module is."""
    return extension.with_suffix('.sha256')


def checksum(extension: Path) -> str:
    """Return the checksum of the extension module."""
    return hashlib.sha256(extension.read_bytes()).hexdigest()


def _is_whole(extension: Path) -> bool:
    """Tell whether it is there and undamaged: a cut-off one would kill the process."""
    try:
        return checksum_path(extension).read_text() == checksum(extension)
    except (OSError, UnicodeDecodeError):
        return False


def _load_extension() -> ModuleType | None:
    path = extension_path()
    wanted = os.environ.get('NUMBA_DISABLE_JIT', '0') in ('', '0')
    if not wanted or path is None or not _is_whole(path):
        return None
    loader = ExtensionFileLoader(EXTENSION, str(path))
    spec = spec_from_file_location(EXTENSION, path, loader=loader)
    assert spec is not None
    with suppress(ImportError):  # of libraries that are gone
        module = module_from_spec(spec)
        loader.exec_module(module)
        return module
    return None


_EXTENSION = _load_extension()
numba: Any = None
if _EXTENSION is None:
    with suppress(ImportError):  # Slower without, the same results.
        numba = import_module('numba')


def extension_name(function: Callable[..., Any]) -> str:
    """Return the name of a kernel in the extension module."""
    return f'{function.__module__}.{function.__name__}'.replace('.', '_')


def compiled(function: Function) -> Function:
    """Return `function` compiled and cached on disk, or as it is where that can't be done.

    In the extension module are the kernels that Python calls often, with those that they call.
    """
    if _EXTENSION is not None:
        ready: Function = getattr(_EXTENSION, extension_name(function), function)
        return ready
    if numba is None:
        return function
    # numba picks a function's cache directory when it is decorated; other users of numba in this
    # process keep theirs.
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = _DIRECTORY or before
    try:
        # Without the interpreter's lock, so that `replay` packs chunks meanwhile.
        decorated: Function = numba.njit(
            cache=_DIRECTORY is not None, error_model='numpy', nogil=True
        )(function)
    finally:
        numba.config.CACHE_DIR = before
    return decorated


def is_extension() -> bool:
    """Tell whether the kernels come from the extension module."""
    return _EXTENSION is not None


def is_compiled() -> bool:
    """Tell whether kernels are compiled in this process."""
    return is_extension() or (numba is not None and not numba.config.DISABLE_JIT)


def spare_linear_algebra() -> None:
    """Keep numba from loading scipy's linear algebra: for programs whose kernels are all ours.

    It does so where scipy is installed, for products of matrices alone, which no kernel here has;
    it takes a quarter of a second and 17 MB.
    """
    name = 'scipy.linalg.cython_blas'
    if numba is None or name in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment]  # its import fails
    try:
        import_module('numba.np.arraymath')  # where numba looks for it, once
    finally:
        del sys.modules[name]


def _mark() -> Path | None:
    """Return the file that says that all kernels are in the cache, as this machine compiles them.

    None where there is nothing to compile, or nowhere to keep it.
    """
    if is_extension() or not is_compiled() or _DIRECTORY is None:
        return None
    from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

    # As numba does, a cache apart for each place of the package, version and processor.
    kind = f'{Path(__file__).parent} {numba.__version__} {sys.version} {get_host_cpu_name()}'
    return Path(_DIRECTORY) / f'complete_{hashlib.sha256(kind.encode()).hexdigest()[:16]}'


def is_cache_cold() -> bool:
    """Tell whether the kernels have to be compiled first, and can be kept then."""
    mark = _mark()
    return mark is not None and not mark.exists()


def note_all_compiled() -> None:
    """Note that all kernels are in the cache now."""
    mark = _mark()
    if mark is not None:
        with suppress(OSError):
            mark.touch()
