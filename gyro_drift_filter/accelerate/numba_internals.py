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

"""All that uses what numba does not promise to keep, and what happens where it is gone.

setup.py says which versions of numba have been tested. Where a later one lacks

- the option `_nrt`: kernels count references to arrays, and are slower;
- `no_cpython_wrapper` or `no_cfunc_wrapper`: compiling takes a fifth longer;
- `NullCache`, `CompileResult` or `dumps`: nothing is kept, each start compiles, and that is logged;
- `_compile_for_args`: a call with other types than the declared ones compiles another version, and
  a process that has waited for the extension module compiles for itself;
- `numba.pycc`, pending deprecation since 0.57 without a successor: no extension module is built, as
  without a C++ compiler;
- what `_inner_compiler` takes of `numba.core`: compiling takes a quarter longer;
- `numba.np.arraymath`: see `spare_linear_algebra`, which then spares nothing;
- `config.SLP_VECTORIZE`: see `_joining_scalars`; the method adaptive is a sixth slower.
"""

import functools
import hashlib
import os
import pickle
import sys
import tempfile
import threading
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

import numba
import numpy as np

from gyro_drift_filter.accelerate import cache
from gyro_drift_filter.accelerate.argument_types import ReadOnly

# LLVM's version from which on it may join scalars: that with which all kernels have been compared
# with plain Python, bit for bit.
_LEAST_LLVM = 22

_LOCK = threading.Lock()
_dispatchers: list[Any] = []  # of all kernels


def options(inner: bool) -> dict[str, Any]:
    """Return options for numba: not to make what the kernels do not need.

    That is to count references to arrays, of which no kernel makes any, and a function for C, and,
    of a kernel that kernels alone call, one for Python and machine code of its own.
    """
    wanted = {'_nrt': False, 'no_cfunc_wrapper': True, 'no_cpython_wrapper': inner}
    known = getattr(import_module('numba.core.options'), 'DefaultOptions', None)
    found: dict[str, Any] = {name: on for name, on in wanted.items() if hasattr(known, name)}
    compiler = _inner_compiler() if inner else None
    return found if compiler is None else found | {'pipeline_class': compiler}


@functools.cache
def _inner_compiler() -> Any:
    """Return a compiler for kernels that kernels alone call, None where numba has changed too much.

    numba makes machine code of each function, with all that it calls. Of these kernels it would be
    made once more with each of their callers, and the own one never run. What is left out is to
    optimise them before their callers hold them, and to translate them.
    """
    try:
        from numba.core.codegen import JITCodeLibrary
        from numba.core.compiler import CompilerBase, DefaultPassBuilder
        from numba.core.compiler_machinery import register_pass
        from numba.core.typed_passes import NativeLowering
    except ImportError:
        return None
    for name in ('_optimize_final_module', '_finalize_final_module', '_finalize_dynamic_globals'):
        if not hasattr(JITCodeLibrary, name):
            return None

    class InnerLibrary(JITCodeLibrary):  # type: ignore[misc]
        """The code of one kernel as it is to be linked into its callers."""

        def _optimize_final_module(self) -> None:
            pass

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()
            self._finalized = True

    @register_pass(mutates_CFG=True, analysis_only=False)
    class InnerLowering(NativeLowering):  # type: ignore[misc]
        """numba's own pass, but for the library and the machine code."""

        _name = 'inner_lowering'

        def run_pass(self, state: Any) -> bool:
            """Translate the kernel, and tell its callers where it is."""
            codegen = state.targetctx.codegen()
            state.library = InnerLibrary(codegen, state.func_id.func_qualname)
            state.flags.no_compile = True
            super().run_pass(state)
            state.flags.no_compile = False
            found = state.cr._replace(cfunc=object())  # which callers know it by
            state.targetctx.insert_user_function(found.cfunc, found.fndesc, [state.library])
            state.cr = found
            return True

    class InnerCompiler(CompilerBase):  # type: ignore[misc]
        """numba's own compiler with that pass."""

        def define_pipelines(self) -> list[Any]:
            """Return the passes."""
            manager = DefaultPassBuilder.define_nopython_pipeline(self.state)
            manager.passes = [
                (InnerLowering if kind is NativeLowering else kind, name)
                for kind, name in manager.passes
            ]
            manager.finalize()
            return [manager]

    return InnerCompiler


def signature(types: Iterable[Any]) -> tuple[Any, ...]:
    """Return numba's types for those that `entry_kernel` takes."""
    return tuple(_numba_type(kind) for kind in types)


def _numba_type(kind: Any) -> Any:
    scalars = {int: numba.int64, float: numba.float64, bool: numba.boolean}
    if isinstance(kind, type) and kind in scalars:
        return scalars[kind]
    if isinstance(kind, ReadOnly):
        return _array(kind.array, readonly=True)
    if isinstance(kind, tuple) and not isinstance(kind[1], int):
        return numba.types.Tuple(signature(kind))
    return _array(kind, readonly=False)


def _array(kind: Any, readonly: bool) -> Any:
    element, dimensions = kind if isinstance(kind, tuple) else (kind, 1)
    element = numba.from_dtype(np.dtype(element))
    return numba.types.Array(element, dimensions, 'C', readonly=readonly)


def declare(dispatcher: Any, types: tuple[Any, ...], find_built: Callable[[], Any]) -> None:
    """Have a kernel compiled for these types at its first call, and for no others.

    `find_built` returns the function of an extension module that was built since the start of this
    process, which is called instead, None where there is none.
    """

    def compile_at_first_call(*arguments: Any) -> Any:
        if (built := find_built()) is not None:
            return built  # which is called now; the next call comes here again
        compile_declared(dispatcher, types)
        return dispatcher  # which is called once more

    dispatcher._compile_for_args = compile_at_first_call


def compile_for_kernels_alone(dispatcher: Any) -> None:
    """Have a kernel run as plain Python where Python calls it, as it does without numba."""

    def add_overload(compiled: Any) -> None:
        # Not into the table for Python's calls, as there is no function for them.
        dispatcher.overloads[tuple(compiled.signature.args)] = compiled

    dispatcher._compile_for_args = lambda *_: dispatcher.py_func  # which is called then
    dispatcher.add_overload = add_overload


@contextmanager
def _joining_scalars() -> Iterator[None]:
    """Have LLVM make vector instructions of what is alike side by side, not of loops alone.

    numba leaves this off since LLVM 14, which made wrong code by it (numba's issue 8705). The
    results are the same to the last bit, as no operation changes its order.
    """
    config = numba.config
    before = getattr(config, 'SLP_VECTORIZE', None)
    # llvmlite is a part of numba.
    version = getattr(import_module('llvmlite.binding'), 'llvm_version_info', (0,))
    if before is None or version[0] < _LEAST_LLVM:
        yield
        return
    config.SLP_VECTORIZE = 1
    try:
        yield
    finally:
        config.SLP_VECTORIZE = before


def compile_declared(dispatcher: Any, types: tuple[Any, ...]) -> None:
    """Compile a kernel for its declared types, or load it from the cache, if not done yet."""
    with _LOCK, _joining_scalars():
        wanted = signature(types)
        if wanted not in dispatcher.overloads:
            dispatcher.compile(wanted)
            dispatcher.disable_compile()


def keep_on_disk(dispatcher: Any) -> None:
    """Have what numba compiles of a kernel kept in the cache's folder, and loaded from there.

    Unlike numba's option `cache`, this makes no folder before there is something to keep, and works
    on where nothing can be kept.
    """
    kernel_cache = _cache_class()
    if kernel_cache is not None:
        dispatcher._cache = kernel_cache(dispatcher.py_func)


def count_in(dispatcher: Any) -> None:
    """Have a kernel counted by `share_compiled`."""
    _dispatchers.append(dispatcher)


def share_compiled() -> float:
    """Return the share of all kernels so far that are compiled in this process."""
    done = sum(bool(dispatcher.overloads) for dispatcher in _dispatchers)
    return done / max(len(_dispatchers), 1)


@functools.cache
def _cache_class() -> Any:
    """Return the class of our cache for one kernel, None where numba has changed too much."""
    try:
        from numba.core.caching import NullCache
        from numba.core.compiler import CompileResult
        from numba.core.serialize import dumps
    except ImportError as error:
        cache.report_unusable(str(error))
        return None

    class KernelCache(NullCache):  # type: ignore[misc]
        """A file for each kernel and the types that it is compiled for."""

        def __init__(self, function: Any) -> None:
            self._function = function

        def _path(self, types: Any, codegen: Any) -> Path:
            code = self._function.__code__
            # The folder's name stands for the files of this package alone.
            kind = numba.__version__, codegen.magic_tuple(), _checksum(code.co_filename), types
            name = f'{self._function.__module__}.{self._function.__name__}'
            return cache.folder() / f'{name}.{hashlib.sha256(str(kind).encode()).hexdigest()[:16]}'

        def load_overload(self, types: Any, context: Any) -> Any:
            """Return a compiled kernel, None where there is none, or a damaged one."""
            context.refresh()
            with suppress(Exception):  # whatever unpickling raises
                kept = self._path(types, context.codegen()).read_bytes()
                return CompileResult._rebuild(context, *pickle.loads(kept))
            if why := cache.why_unusable():
                cache.report_unusable(why)
            return None

        def save_overload(self, types: Any, compiled: Any) -> None:
            """Keep a compiled kernel, if it can be."""
            if cache.why_unusable():
                return
            unfinished = cache.folder() / f'unfinished.{os.getpid()}'
            try:
                path = self._path(types, compiled.codegen)
                unfinished.write_bytes(dumps(compiled._reduce()))
                unfinished.replace(path)
            except (OSError, AttributeError) as error:  # a full disk, or another numba
                cache.report_unusable(str(error))
                unfinished.unlink(missing_ok=True)

    return KernelCache


@functools.cache
def _checksum(file: str) -> str:
    return hashlib.sha256(Path(file).read_bytes()).hexdigest()


def spare_linear_algebra() -> None:
    """Keep numba from loading scipy's linear algebra.

    It does so where scipy is installed, for products of matrices alone, which no kernel here has;
    it takes a quarter of a second and 17 MB.
    """
    name = 'scipy.linalg.cython_blas'
    if name in sys.modules:
        return
    sys.modules[name] = None  # type: ignore[assignment]  # its import fails
    try:
        with suppress(ImportError):
            import_module('numba.np.arraymath')  # where numba looks for it, once
    finally:
        del sys.modules[name]


def build_extension(kernels: Mapping[str, tuple[Any, tuple[Any, ...]]], folder: Path) -> Path:
    """Return an extension module, built in a folder.

    Args:
        kernels: By their names in the module: functions, and their types as for `entry_kernel`.
        folder: For the module, and for what is left of the build.

    Raises:
        Exception: Whatever compilers and linkers raise.
    """
    from unittest.mock import patch  # here, as it loads much

    with warnings.catch_warnings():
        warnings.simplefilter('ignore')  # numba has been about to replace pycc for years
        from numba.pycc import CC, compiler
    # pycc has no option for what `kernel` asks for, and leaves its folder behind where it fails.
    with (
        patch.object(compiler, 'Flags', functools.partial(_flags_of_kernels, compiler.Flags)),
        patch.object(tempfile, 'tempdir', str(folder)),
        _LOCK,
        _joining_scalars(),
    ):
        library = CC(cache.EXTENSION)
        library.output_dir = str(folder)
        library.use_nrt = False
        library.target_cpu = 'host' if cache.processor() else ''
        for name, (function, types) in kernels.items():
            library.export(name, signature(types))(function)
        library.compile()
    return folder / str(library.output_file)


def _flags_of_kernels(flags: Callable[[], Any]) -> Any:
    """Return numba's flags with those that `kernel` sets."""
    made = flags()
    made.release_gil = True
    made.error_model = 'numpy'
    return made
