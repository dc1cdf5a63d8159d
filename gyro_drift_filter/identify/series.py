"""Numbers that may be too many for memory: they lie in a temporary file and are read in parts.

What takes a series takes an array as well; both know their length and give slices.
"""

import errno
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.identify.errors import IdentificationError

Floats = NDArray[np.float64]

# What is worked on at once. A million samples are 8 MB, and an hour and a half at 200 Hz.
LARGEST_PART = 1 << 20
# A series that is smaller than this needs no file.
IN_MEMORY = 1 << 20  # bytes


class Stored:
    """Numbers (n,) in a temporary file without a name, which goes with this object."""

    def __init__(self, kind: type[np.generic] = np.float64) -> None:
        self._kind = np.dtype(kind)
        self._length = 0
        # It is closed as this object goes.
        self._file: Any = tempfile.SpooledTemporaryFile(IN_MEMORY)  # noqa: SIM115

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

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        """Read all of them."""
        return np.asarray(self[:], dtype)


Values = Floats | Stored


def parts(values: Values, largest: int = LARGEST_PART) -> Iterator[Floats]:
    """Yield a series in parts of about equal length, none longer than `largest`."""
    count = -(-len(values) // largest)
    for k in range(count):
        yield values[k * len(values) // count : (k + 1) * len(values) // count]


def columns(values: Floats | tuple[Values, ...]) -> tuple[Values, ...]:
    """Return the columns of an array (n, 3), or what is given as columns."""
    return values if isinstance(values, tuple) else tuple(values.T)
