"""Compiled kernels: from an extension module, by numba, or as the plain Python that they are.

All three give the same results (test/test_compiled.py). `gyro_drift compile` makes the extension
module where a C++ compiler is installed (cli/extension.py): a process that finds it does not load
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


def _cache_place() -> Path | None:
    """Return where compiled kernels are kept, or None for a user without a home.

    numba's own cache looks only at the file that a kernel stands in, so a kernel would keep the
    old code of one that it calls from another file. Here the directory is named after the content
    of all files that hold kernels, in core and bags, and of the one that builds the extension: any
    edit starts a new cache. It also works where the package is installed read-only, as by apt.
    """
    content = hashlib.sha256()
    package = Path(__file__).parent.parent
    layers = ('accelerate', 'core', 'core/methods', 'messages', 'mcap', 'bags')
    for path in sorted(path for layer in layers for path in package.glob(f'{layer}/*.py')):
        content.update(path.read_bytes())
    try:
        user_cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    except RuntimeError:
        return None
    root = Path(os.environ.get('NUMBA_CACHE_DIR') or user_cache / 'gyro_drift_filter')
    return root / content.hexdigest()[:16]


def _writable(place: Path | None) -> str | None:
    """Return the directory where it can be made and written, else None."""
    if place is None:
        return None
    with suppress(OSError):
        place.mkdir(parents=True, exist_ok=True)
        if os.access(place, os.W_OK):
            return str(place)
    return None


_PLACE = _cache_place()
_DIRECTORY = _writable(_PLACE)


def cache_directory() -> Path | None:
    """Return the directory of the compiled kernels, None where none can be written."""
    return None if _DIRECTORY is None else Path(_DIRECTORY)


def processor_features() -> str:
    """Return what tells which machine code this machine can run, empty where that is not known."""
    with suppress(OSError):
        for line in Path('/proc/cpuinfo').read_text().splitlines():
            if line.startswith(('flags', 'Features')):
                return line
    return ''


def _extension_path() -> Path | None:
    if _PLACE is None:
        return None
    kind = f'{sys.version} {np.__version__} {platform.machine()} {processor_features()}'
    return _PLACE / f'{EXTENSION}_{hashlib.sha256(kind.encode()).hexdigest()[:16]}.so'


def keep_extension(built: Path) -> None:
    """Put a new extension module where later processes find it, with its checksum at the end.

    Raises:
        OSError: Nothing can be kept there.
    """
    path = _extension_path()
    if path is None or _DIRECTORY is None:
        raise OSError('no directory to keep it in can be written')
    with built.open('ab') as file:
        file.write(_checksum(built.read_bytes()))
    built.replace(path)


def note_no_extension() -> None:
    """Note that an extension module can't be built, so that no start tries it again."""
    path = _extension_path()
    if path is not None:
        with suppress(OSError):
            path.with_suffix('.none').touch()


def is_extension_missing() -> bool:
    """Tell whether later processes would gain by an extension module, which can be kept."""
    path = _extension_path()
    if is_extension() or not is_compiled() or path is None or _DIRECTORY is None:
        return False
    return not _is_whole(path) and not path.with_suffix('.none').exists()


def _checksum(content: bytes) -> bytes:
    return hashlib.sha256(content).digest()


def _is_whole(extension: Path) -> bool:
    """Tell whether it is there and undamaged: a cut-off one would kill the process."""
    try:
        content = extension.read_bytes()
    except OSError:
        return False
    size = len(_checksum(b''))
    return len(content) > size and content[-size:] == _checksum(content[:-size])


def _load_extension() -> ModuleType | None:
    path = _extension_path()
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


def _uncounted() -> dict[str, bool]:
    """Return the option not to count references to arrays, of which no kernel makes any.

    Its name has an underscore: a numba without it goes on counting.
    """
    options = getattr(import_module('numba.core.options'), 'DefaultOptions', None)
    return {'_nrt': False} if hasattr(options, '_nrt') else {}


def kernel(function: Function) -> Function:
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
        decorated: Function = numba.njit(
            cache=_DIRECTORY is not None,
            error_model='numpy',
            nogil=True,  # so that `replay` reads and packs chunks meanwhile
            **_uncounted(),
        )(function)
    finally:
        numba.config.CACHE_DIR = before
    return decorated


def entry_kernel(*types: Any) -> Callable[[Function], Function]:
    """Return a decorator for a kernel that Python calls: it is compiled ahead for these types.

    Args:
        types: One for each argument: int, float or bool for a number; a numpy type for a
            contiguous array (n,) of it, as np.uint8 or a record; a pair of a numpy type and a
            number of dimensions for others, as (np.int64, 2).
    """
    return kernel


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
