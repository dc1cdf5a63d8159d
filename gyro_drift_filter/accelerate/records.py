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

"""Records: what kernels work on, declared once for numpy and for the type checker.

A record is declared as a `TypedDict`, so that the type checker knows each field and its type, and
`record` makes the numpy type of it:

    class Clock(TypedDict):
        period: float  # s
        started: bool
        block_periods: Floats5

    CLOCK = record(Clock)

Fields are float, int and bool (of 64 bits, and one byte), arrays, other declarations, of which
records are made with this one, and arrays of records. Arrays are declared by an alias that says
type and shape:

    Floats5 = Annotated[NDArray[np.float64], np.float64, (5,)]
    Signals = Annotated[Sequence[Signal], SIGNAL, (6,)]
"""

from typing import Annotated, Any, get_args, get_origin, get_type_hints, is_typeddict

import numpy as np
from numpy.typing import DTypeLike, NDArray

CACHE_LINE = 64  # bytes

# One value for each axis of the sensor.
PerAxis = Annotated[NDArray[np.float64], np.float64, (3,)]
CountPerAxis = Annotated[NDArray[np.int64], np.int64, (3,)]

_SCALARS: dict[Any, Any] = {float: np.float64, int: np.int64, bool: np.bool_}
_RECORDS: dict[Any, np.dtype[Any]] = {}


def record(declaration: type[Any], *, in_cache_lines: bool = False) -> np.dtype[Any]:
    """Return the numpy type of a record that is declared as a `TypedDict`.

    Fields of later records that are declared as the same `TypedDict` have this type.

    Args:
        declaration: The `TypedDict`.
        in_cache_lines: Whether fields that fill cache lines begin at one, and the record itself
            fills them: vector instructions are slow where they reach across two.
    """
    fields = get_type_hints(declaration, include_extras=True)
    kinds = {name: _numpy_type(annotation) for name, annotation in fields.items()}
    aligned = np.dtype(list(kinds.items()), align=True)
    _RECORDS[declaration] = _in_cache_lines(kinds) if in_cache_lines else aligned
    return _RECORDS[declaration]


def _numpy_type(annotation: Any) -> np.dtype[Any]:
    if get_origin(annotation) is Annotated:
        _, element, shape = get_args(annotation)
        return np.dtype((element, shape))
    if is_typeddict(annotation) and annotation not in _RECORDS:
        record(annotation)
    return np.dtype(_RECORDS.get(annotation) or _SCALARS[annotation])


def _in_cache_lines(kinds: dict[str, np.dtype[Any]]) -> np.dtype[Any]:
    offset, offsets = 0, []
    # The fields that do not fill lines come behind those that do, in their order.
    for name in sorted(kinds, key=lambda name: kinds[name].itemsize % CACHE_LINE > 0):
        fills = kinds[name].itemsize % CACHE_LINE == 0
        alignment = CACHE_LINE if fills else kinds[name].base.alignment
        offset = -(-offset // alignment) * alignment
        offsets.append((name, offset))
        offset += kinds[name].itemsize
    return np.dtype(
        {
            'names': [name for name, _ in offsets],
            'formats': [kinds[name] for name, _ in offsets],
            'offsets': [offset for _, offset in offsets],
            'itemsize': -(-offset // CACHE_LINE) * CACHE_LINE,
        }
    )


def zeroed(kind: DTypeLike) -> NDArray[Any]:
    """Return an array (1,) of a record, all zero, that begins at a cache line."""
    size = np.dtype(kind).itemsize
    buffer = np.zeros(size + CACHE_LINE, np.uint8)
    offset = -buffer.ctypes.data % CACHE_LINE
    return buffer[offset : offset + size].view(kind)
