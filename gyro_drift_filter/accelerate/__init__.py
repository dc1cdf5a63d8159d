"""Compiled kernels: the decorators, their cache on disk, the module made ahead of time.

`kernel` marks a function that other kernels call, `entry_kernel` one that Python calls.
"""

from gyro_drift_filter.accelerate.argument_types import read_only
from gyro_drift_filter.accelerate.kernels import entry_kernel, inlined_kernel, kernel
from gyro_drift_filter.accelerate.records import (
    CountPerAxis,
    PerAxis,
    record,
    zeroed,
)

__all__ = [
    'CountPerAxis',
    'PerAxis',
    'entry_kernel',
    'inlined_kernel',
    'kernel',
    'read_only',
    'record',
    'zeroed',
]
