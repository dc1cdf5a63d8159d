"""Compile the kernels where numba is installed; elsewhere the same functions are plain Python."""

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar

try:
    import numba
except ImportError:  # Slower, the same results: see test/test_compiled.py.
    numba = None

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


_DIRECTORY = None if numba is None else _cache_directory()


def compiled(function: Function) -> Function:
    """Return `function` compiled and cached on disk, or as it is where numba is missing."""
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


def is_compiled() -> bool:
    """Tell whether kernels are compiled in this process."""
    return numba is not None and not numba.config.DISABLE_JIT


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
    if not is_compiled() or _DIRECTORY is None:
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
