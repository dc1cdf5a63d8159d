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

"""Many rotations at once, as unit quaternions (..., 4) in the order x, y, z, w of scipy and ROS.

Here is what is done to thousands of them in a row, for which scipy's `Rotation` is many times
slower or has nothing; all else is done with that.
"""

from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats


def multiply(left: Floats, right: Floats) -> Floats:
    """Return the rotations `left` after `right`; their shapes are broadcast."""
    ax, ay, az, aw = left[..., 0], left[..., 1], left[..., 2], left[..., 3]
    bx, by, bz, bw = right[..., 0], right[..., 1], right[..., 2], right[..., 3]
    x = aw * bx + ax * bw + ay * bz - az * by
    out = np.empty((*x.shape, 4))
    out[..., 0] = x
    out[..., 1] = aw * by - ax * bz + ay * bw + az * bx
    out[..., 2] = aw * bz + ax * by - ay * bx + az * bw
    out[..., 3] = aw * bw - ax * bx - ay * by - az * bz
    return out


def inverse(rotations: Floats) -> Floats:
    """Return the rotations back."""
    return np.asarray(rotations * np.array([-1.0, -1.0, -1.0, 1.0]))


def from_vectors(vectors: Floats) -> Floats:
    """Return the rotations about vectors (..., 3) by their length in rad."""
    half = 0.5 * np.linalg.norm(vectors, axis=-1, keepdims=True)
    # sinc(x) of numpy is sin(pi x) / (pi x).
    return np.concatenate([0.5 * np.sinc(half / np.pi) * vectors, np.cos(half)], axis=-1)


def to_vectors(rotations: Floats) -> Floats:
    """Return the rotation vectors (..., 3) in rad, none longer than pi."""
    rotations = np.where(rotations[..., 3:] < 0.0, -rotations, rotations)
    sine = np.linalg.norm(rotations[..., :3], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, rotations[..., 3:])
    factor = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    return np.asarray(factor * rotations[..., :3])


def rotate(rotations: Floats, vectors: Floats) -> Floats:
    """Return vectors (..., 3) rotated; the shapes are broadcast."""
    axes = rotations[..., :3]
    across = 2.0 * np.cross(axes, vectors)
    return np.asarray(vectors + rotations[..., 3:] * across + np.cross(axes, across))


def running_products(rotations: Floats) -> Floats:
    """Return r[0], r[0] r[1], r[0] r[1] r[2] and so on of rotations (..., n, 4).

    As orientations of a body that turns by them in its own axes. It takes about 2 n products, but
    few calls.
    """
    n = rotations.shape[-2]
    if n < 2:
        return rotations.copy()
    pairs = running_products(multiply(rotations[..., : n - 1 : 2, :], rotations[..., 1::2, :]))
    out: Any = np.empty_like(rotations)
    out[..., 0, :] = rotations[..., 0, :]
    out[..., 1::2, :] = pairs
    out[..., 2::2, :] = multiply(pairs[..., : (n - 1) // 2, :], rotations[..., 2::2, :])
    return np.asarray(out / np.linalg.norm(out, axis=-1, keepdims=True))
