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

"""Numbers that may be too many for memory: they lie in a temporary file and are read in parts.

What takes a series takes an array as well; both know their length and give slices.
"""

import errno
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify import IdentificationError

# What is worked on at once. A million samples are 8 MB, and an hour and a half at 200 Hz.
LARGEST_PART = 1 << 20
# A series that is smaller than this needs no file.
IN_MEMORY = 1 << 20  # bytes


class Stored:
    """Numbers (n,) in a temporary file without a name, which goes with this object."""

    def __init__(self, kind: type[np.generic] = np.float64) -> None:
        self._kind = np.dtype(kind)
        self._length = 0
        self._file: Any = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115
        weakref.finalize(self, self._file.close)

    def append(self, values: NDArray[Any]) -> None:
        """Add values (m,) at the end.

        Raises:
            IdentificationError: There is no room for them.
        """
        try:
            self._file.seek(0, 2)
            self._file.write(np.ascontiguousarray(values, self._kind).data)
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise IdentificationError(
                f'no space left in {tempfile.gettempdir()}, where the samples are kept meanwhile: '
                'name another folder in the environment variable TMPDIR'
            ) from error
        self._length += len(values)

    def __len__(self) -> int:
        """Return how many there are."""
        return self._length

    def __getitem__(self, where: slice) -> NDArray[Any]:
        """Read the numbers of a slice without a step."""
        first, stop, _ = where.indices(self._length)
        out = np.empty(max(stop - first, 0), self._kind)
        self._file.seek(first * self._kind.itemsize)
        self._file.readinto(out.data.cast('B'))
        return out

    def __array__(
        self,
        dtype: Any = None,
        copy: bool | None = None,  # noqa: FBT001  # numpy's protocol
    ) -> NDArray[Any]:
        """Read all of them."""
        return np.asarray(self[:], dtype)


class Ramp:
    """Times (n,) of evenly spaced samples in s, made as they are asked for."""

    def __init__(self, begin: float, period: float, length: int) -> None:
        self._begin, self._period, self._length = begin, period, length

    def __len__(self) -> int:
        """Return how many there are."""
        return self._length

    def __getitem__(self, where: slice) -> Floats:
        """Return the times of a slice without a step."""
        first, stop, _ = where.indices(self._length)
        return np.asarray(self._begin + np.arange(first, stop) * self._period, float)


class Stretch:
    """The samples from `first` up to, and without, `stop` of another series."""

    def __init__(self, values: 'Values', first: int, stop: int) -> None:
        self._values, self._first, self._stop = values, first, stop

    def __len__(self) -> int:
        """Return how many there are."""
        return self._stop - self._first

    def __getitem__(self, where: slice) -> Floats:
        """Return the samples of a slice without a step."""
        first, stop, _ = where.indices(len(self))
        return self._values[self._first + first : self._first + stop]


Values = Floats | Stored | Ramp | Stretch


def parts(values: Values, largest: int = LARGEST_PART) -> Iterator[Floats]:
    """Yield a series (n,) in parts of about equal length, none longer than `largest` samples."""
    count = -(-len(values) // largest)
    for k in range(count):
        yield values[k * len(values) // count : (k + 1) * len(values) // count]


def all_parts(spans: Sequence[Values]) -> Iterator[Floats]:
    """Yield the parts of several series one after the other."""
    for span in spans:
        yield from parts(span)


def thinned(spans: Sequence[Values]) -> Floats:
    """Return samples (m,) of several series: all, or every so many that it is one part's worth."""
    step = -(-sum(map(len, spans)) // LARGEST_PART)
    return np.concatenate([part[::step] for part in all_parts(spans)] or [np.zeros(0)])


def mean_square(spans: Sequence[Values]) -> float:
    """Return the mean of the squares of several series together."""
    total = sum(float(np.dot(part, part)) for part in all_parts(spans))
    return total / sum(map(len, spans))


def mean_of(spans: Sequence[Values]) -> float:
    """Return the mean of several series together."""
    return sum(float(part.sum()) for part in all_parts(spans)) / sum(map(len, spans))


def block_means(spans: Sequence[Values], blocks: int) -> Floats:
    """Return the means of `blocks` parts of equal length, to a sample, of all series: (blocks,)."""
    edges = np.arange(blocks + 1) * sum(map(len, spans)) // blocks
    sums, offset = np.zeros(blocks), 0
    for part in all_parts(spans):
        running = np.concatenate([[0.0], np.cumsum(part)])
        sums += np.diff(running[np.clip(edges - offset, 0, len(part))])
        offset += len(part)
    return np.asarray(sums / np.diff(edges))


def stacked(columns: Iterable[Values], where: slice = slice(None)) -> Floats:
    """Return the same slice (n,) of several series side by side: (n, number of them)."""
    return np.column_stack([column[where] for column in columns])


def stored_columns(count: int, kind: type[np.generic] = np.float64) -> tuple[Stored, ...]:
    """Return so many series that nothing was added to yet."""
    return tuple(Stored(kind) for _ in range(count))


def append_rows(columns: Sequence[Stored], rows: NDArray[Any]) -> None:
    """Add rows (m, number of columns) at the end of series, one for each column.

    Raises:
        IdentificationError: There is no room for them.
    """
    for column, values in zip(columns, rows.T, strict=True):
        column.append(values)


def value_at(values: NDArray[Any] | Values, index: int) -> Any:
    """Return one number of a series."""
    return values[index : index + 1][0]


def columns(values: Floats | tuple[Values, ...]) -> tuple[Values, ...]:
    """Return the columns of an array (n, 3), or what is given as columns."""
    return values if isinstance(values, tuple) else tuple(values.T)
