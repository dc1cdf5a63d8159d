"""Records laid out by cache lines: vector instructions are slow where they reach across two."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

LINE = 64  # bytes


def in_lines(fields: list[tuple[Any, ...]]) -> np.dtype[Any]:
    """Return a record with these fields, each that fills lines at the begin of one.

    The record itself fills lines, too, so that it can be in an array or another record.
    """
    kinds = {name: np.dtype((kind, *(shape or [()]))) for name, kind, *shape in fields}
    place, places = 0, []
    # The others close the ranks, in their order, behind those that fill lines.
    for name in sorted(kinds, key=lambda name: kinds[name].itemsize % LINE > 0):
        alignment = LINE if kinds[name].itemsize % LINE == 0 else kinds[name].base.alignment
        place = -(-place // alignment) * alignment
        places.append((name, place))
        place += kinds[name].itemsize
    return np.dtype(
        {
            'names': [name for name, _ in places],
            'formats': [kinds[name] for name, _ in places],
            'offsets': [offset for _, offset in places],
            'itemsize': -(-place // LINE) * LINE,
        }
    )


def zeroed(kind: DTypeLike) -> NDArray[Any]:
    """Return (1,) of a record, all zero, that begins with a line."""
    size = np.dtype(kind).itemsize
    room = np.zeros(size + LINE, np.uint8)
    begin = -room.ctypes.data % LINE
    return room[begin : begin + size].view(kind)
