"""Many rotations at once, as unit quaternions (n, 4) in the order x, y, z, w."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Floats = NDArray[np.float64]


def multiply(a: Floats, b: Floats) -> Floats:
    """Return the products a b, (n, 4)."""
    ax, ay, az, aw = a.T
    bx, by, bz, bw = b.T
    return np.stack(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        ),
        axis=1,
    )


def inverse(a: Floats) -> Floats:
    """Return the inverse of each."""
    return a * (-1.0, -1.0, -1.0, 1.0)


def from_vectors(vectors: Floats) -> Floats:
    """Return the rotations by rotation vectors (n, 3) in rad."""
    half = 0.5 * np.linalg.norm(vectors, axis=1)
    out = np.empty((len(vectors), 4))
    out[:, :3] = 0.5 * np.sinc(half / np.pi)[:, None] * vectors
    out[:, 3] = np.cos(half)
    return out


def to_vectors(rotations: Floats) -> Floats:
    """Return the rotation vectors (n, 3) in rad, none longer than pi."""
    sign = np.where(rotations[:, 3] < 0.0, -1.0, 1.0)
    sine = np.linalg.norm(rotations[:, :3], axis=1)
    angle = 2.0 * np.arctan2(sine, sign * rotations[:, 3])
    factor = np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 2.0)
    return np.asarray((sign * factor)[:, None] * rotations[:, :3])


def to_matrices(rotations: Floats) -> Floats:
    """Return the matrices (n, 3, 3)."""
    x, y, z, w = rotations.T
    out = np.empty((len(rotations), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w)
    out[:, 0, 2], out[:, 1, 0] = 2 * (x * z + y * w), 2 * (x * y + z * w)
    out[:, 1, 1], out[:, 1, 2] = 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    out[:, 2, 0], out[:, 2, 1] = 2 * (x * z - y * w), 2 * (y * z + x * w)
    out[:, 2, 2] = 1 - 2 * (x * x + y * y)
    return out


def from_matrix(matrix: Floats) -> Floats:
    """Return the unit quaternion (4,) of a rotation matrix (3, 3)."""
    return np.asarray(Rotation.from_matrix(matrix).as_quat())


def product(rotations: Floats) -> Floats:
    """Return the product (4,) of all, in their order."""
    while len(rotations) > 1:
        last = rotations[2 * (len(rotations) // 2) :]
        rotations = np.vstack([multiply(rotations[:-1:2], rotations[1::2]), last])
    return np.asarray(rotations[0] / np.linalg.norm(rotations[0]))


def running_products(rotations: Floats) -> Floats:
    """Return r[0], r[0] r[1], r[0] r[1] r[2] and so on, in about 2 n products but few calls."""
    n = len(rotations)
    if n < 2:
        return rotations.copy()
    pairs = running_products(multiply(rotations[: n - 1 : 2], rotations[1::2]))
    out = np.empty_like(rotations)
    out[0] = rotations[0]
    out[1::2] = pairs
    out[2::2] = multiply(pairs[: (n - 1) // 2], rotations[2::2])
    return np.asarray(out / np.linalg.norm(out, axis=1)[:, None])
