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

"""Kernels: from the extension module, by numba, or as the plain Python that they are.

All three give the same results (test/test_compiled.py). A process that finds the extension module
does not load numba, which is two thirds of the node's memory and half of its start. Importing a
module with kernels compiles nothing and writes nothing.
"""

import os
from collections.abc import Callable
from importlib import import_module
from typing import Any, NamedTuple, TypeVar

from gyro_drift_filter.accelerate import cache

Function = TypeVar('Function', bound=Callable[..., Any])


class EntryKernel(NamedTuple):
    """A kernel that Python calls.

    Attributes:
        function: As it is written.
        types: Of its arguments, as `entry_kernel` takes them.
        compiled: What Python calls.
    """

    function: Callable[..., Any]
    types: tuple[Any, ...]
    compiled: Any


# By their names in the extension module; each module with kernels adds its own.
ENTRY_KERNELS: dict[str, EntryKernel] = {}

_extension = (
    cache.load_extension() if os.environ.get('NUMBA_DISABLE_JIT', '0') in ('', '0') else None
)
numba: Any = None
_why_plain = 'NUMBA_DISABLE_JIT is set'
if _extension is None:
    try:
        numba = import_module('numba')
        from gyro_drift_filter.accelerate import numba_internals
    except Exception as error:  # whatever it raises beside a numpy that it was not made for
        numba = None  # slower without, the same results
        is_absent = isinstance(error, ModuleNotFoundError) and error.name == 'numba'
        reason = ' '.join(str(error).split())
        _why_plain = 'install numba for speed' if is_absent else f'numba fails here ({reason})'


def is_extension() -> bool:
    """Tell whether the kernels come from the extension module."""
    return _extension is not None


def use_extension() -> bool:
    """Use the extension module if there is one by now; return whether there is.

    Entry kernels that numba has compiled in this process stay as they are, with the same results.
    """
    global _extension
    if _extension is None:
        _extension = cache.load_extension()
    return is_extension()


def is_compiled() -> bool:
    """Tell whether kernels are compiled in this process."""
    return is_extension() or (numba is not None and not numba.config.DISABLE_JIT)


def why_plain() -> str:
    """Return why kernels run as plain Python in this process, empty where they do not."""
    return '' if is_compiled() else _why_plain


def kernel(function: Function) -> Function:
    """Return a function that kernels call, ready to be compiled by numba with its caller.

    In the extension module it is a part of its callers. Called from Python, as tests do, it runs as
    plain Python.
    """
    return _compilable(function, inner=True)


def inlined_kernel(function: Function) -> Function:
    """Return a `kernel` that its callers hold a copy of: for those called often and in few places.

    It saves the call, a fifth of the time of a step where the step is short. numba hands this on to
    the kernels that it calls, but for those that are compiled already.
    """
    return _compilable(function, inner=True, forceinline=True)


def _compilable(function: Function, inner: bool, **options: bool) -> Function:
    if is_extension() or not is_compiled():
        return function
    compiled: Function = numba.njit(
        error_model='numpy',
        nogil=True,  # so that `replay` reads and packs chunks meanwhile
        **options,
        **numba_internals.options(inner),
    )(function)
    numba_internals.count_in(compiled)
    if inner:
        numba_internals.compile_for_kernels_alone(compiled)
    else:
        numba_internals.keep_on_disk(compiled)
    return compiled


def entry_kernel(*types: Any) -> Callable[[Function], Function]:
    """Return a decorator for a kernel that Python calls, with these types and no others.

    numba compiles it at the first call or, as the extension module, ahead. With numba, arguments
    of other types raise a TypeError; the extension module does not check the types of arrays.

    Args:
        types: One for each argument: int, float or bool for a number; a numpy type for a
            contiguous array (n,) of it, as np.uint8 or a record; a pair of a numpy type and a
            number of dimensions for others, as (np.int64, 2); `read_only` of one of these for an
            array that the kernel does not write, and that may be a view of bytes.
    """

    def decorate(function: Function) -> Function:
        name = f'{function.__module__}.{function.__name__}'.replace('.', '_')
        compiled = getattr(_extension, name, None) or _compilable(function, inner=False)
        if not is_extension() and is_compiled():
            numba_internals.declare(compiled, types, lambda: getattr(_extension, name, None))
        ENTRY_KERNELS[name] = EntryKernel(function, types, compiled)
        return compiled

    return decorate


def has_to_compile() -> bool:
    """Tell whether kernels have to be compiled first; use the extension module if it is there."""
    return is_compiled() and not use_extension() and not cache.is_noted(complete_note())


def is_cache_cold() -> bool:
    """Tell whether the kernels have to be compiled first, and can be kept then."""
    return has_to_compile() and not cache.why_unusable()


def complete_note() -> str:
    """Return the note that says that numba's cache holds all kernels; other versions have own."""
    return f'complete_{numba.__version__}'


def spare_linear_algebra() -> None:
    """Keep numba from loading scipy's linear algebra: for programs whose kernels are all ours."""
    if numba is not None:
        numba_internals.spare_linear_algebra()
