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

"""Products and inverses of 3 by 3 matrices: kernels can't make arrays, so results go to `out`.

And the length of a vector, and what a rotation is made of.
"""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import kernel

SMALL_ANGLE = 0.1  # rad: below, a series is right to 1e-9

Matrix = Annotated[NDArray[np.float64], np.float64, (3, 3)]


@kernel
def multiply(a: Matrix, b: Matrix, out: Matrix) -> None:
    """Write a b."""
    for i in range(3):
        for k in range(3):
            out[i, k] = a[i, 0] * b[0, k] + a[i, 1] * b[1, k] + a[i, 2] * b[2, k]


@kernel
def multiply_transposed(a: Matrix, b: Matrix, out: Matrix) -> None:
    """Write a' b."""
    for i in range(3):
        for k in range(3):
            out[i, k] = a[0, i] * b[0, k] + a[1, i] * b[1, k] + a[2, i] * b[2, k]


@kernel
def invert(a: Matrix, out: Matrix) -> None:
    """Write the inverse of `a`, which is overwritten: Gauss and Jordan's method with pivots."""
    for i in range(3):
        for k in range(3):
            out[i, k] = 1.0 if i == k else 0.0
    for column in range(3):
        pivot = column
        for i in range(column + 1, 3):
            if abs(a[i, column]) > abs(a[pivot, column]):
                pivot = i
        for k in range(3):
            a[column, k], a[pivot, k] = a[pivot, k], a[column, k]
            out[column, k], out[pivot, k] = out[pivot, k], out[column, k]
        share = 1.0 / a[column, column]
        for k in range(3):
            a[column, k] *= share
            out[column, k] *= share
        for i in range(3):
            if i != column:
                factor = a[i, column]
                for k in range(3):
                    a[i, k] -= factor * a[column, k]
                    out[i, k] -= factor * out[column, k]


@kernel
def vector_length(x: float, y: float, z: float) -> float:
    """Return the length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@kernel
def cross_product(
    x: float, y: float, z: float, a: float, b: float, c: float
) -> tuple[float, float, float]:
    """Return the cross product of the vectors (x, y, z) and (a, b, c)."""
    return y * c - z * b, z * a - x * c, x * b - y * a


@kernel
def rotation_terms(square: float) -> tuple[float, float]:
    """Return sin(angle) / angle and (1 - cos(angle)) / angle^2 for the square of an angle in rad.

    The terms of a rotation's matrix (Rodrigues).
    """
    if square <= SMALL_ANGLE * SMALL_ANGLE:
        across = 1.0 - square / 6.0 * (1.0 - square / 20.0)
        return across, 0.5 - square / 24.0 * (1.0 - square / 30.0)
    angle = math.sqrt(square)
    return math.sin(angle) / angle, (1.0 - math.cos(angle)) / square
