"""A series cut into blocks, and statistics of all blocks at once."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def block_rows(values: Floats, first: Integers, stop: Integers) -> Floats:
    """Return one block a row, (w, length of the longest), the shorter ones filled up with NaN.

    Args:
        values: (n,); may hold NaN.
        first: (w,) index of each block's first sample.
        stop: (w,) index behind its last.
    """
    if not len(first):
        return np.empty((0, 0))
    index = first[:, None] + np.arange(int((stop - first).max()))
    inside = index < stop[:, None]
    return np.where(inside, values[np.where(inside, index, 0)], np.nan)


def row_medians(rows: Floats) -> Floats:
    """Return the median of what is finite in each row, NaN where nothing is: (w,)."""
    ordered = np.sort(rows, axis=1)  # NaN goes to the end
    count = np.isfinite(rows).sum(axis=1)
    number = np.arange(len(rows))
    upper = ordered[number, np.maximum(count // 2, 0)] if rows.size else np.empty(0)
    lower = ordered[number, np.maximum((count - 1) // 2, 0)] if rows.size else np.empty(0)
    return np.where(count > 0, 0.5 * (lower + upper), np.nan)


def row_means(rows: Floats) -> Floats:
    """Return the mean of what is finite in each row, NaN where nothing is: (w,)."""
    count = np.isfinite(rows).sum(axis=1)
    total = np.nansum(rows, axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
