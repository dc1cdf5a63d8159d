"""Types of the arguments of kernels that Python calls, as `entry_kernel` takes them."""

from typing import Any, NamedTuple


class ReadOnly(NamedTuple):
    """An array that the kernel does not write, so that it may be a view of bytes."""

    array: Any


def read_only(array: Any) -> ReadOnly:
    """Return the type of an array that the kernel does not write.

    Args:
        array: A numpy type, or a pair of one and a number of dimensions.
    """
    return ReadOnly(array)
