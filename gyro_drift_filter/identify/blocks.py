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

"""A series cut into blocks, and statistics of all blocks at once."""

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats, Integers

# Deviation of Gaussian noise per median absolute deviation.
PER_MEDIAN_DEVIATION = 1.4826


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


def runs_of(flags: Bools) -> Integers:
    """Return the first index of each run of True in flags (n,), and that behind it: (r, 2)."""
    return np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)


def row_medians(rows: Floats) -> Floats:
    """Return the median of what is finite in each of rows (w, n), NaN where nothing is: (w,)."""
    ordered = np.sort(rows, axis=1)  # NaN goes to the end
    count = np.isfinite(rows).sum(axis=1)
    number = np.arange(len(rows))
    upper = ordered[number, count // 2] if rows.size else np.empty(0)
    lower = ordered[number, np.maximum((count - 1) // 2, 0)] if rows.size else np.empty(0)
    return np.where(count > 0, 0.5 * (lower + upper), np.nan)


def row_means(rows: Floats) -> Floats:
    """Return the mean of what is finite in each of rows (w, n), NaN where nothing is: (w,)."""
    count = np.isfinite(rows).sum(axis=1)
    total = np.nansum(rows, axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
