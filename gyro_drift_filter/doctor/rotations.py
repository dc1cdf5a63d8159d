"""Rotations as unit quaternions (..., 4) in the order w, x, y, z; many at once."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def product(left: Floats, right: Floats) -> Floats:
    """Return the rotations `left` after `right`."""
    w, x, y, z = np.moveaxis(left, -1, 0)
    a, b, c, d = np.moveaxis(right, -1, 0)
    parts = (
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    )
    return np.stack(parts, axis=-1)


def inverse(rotation: Floats) -> Floats:
    """Return the rotations back."""
    return np.asarray(rotation * np.array([1.0, -1.0, -1.0, -1.0]))


def from_vector(vector: Floats) -> Floats:
    """Return the rotations about vectors (..., 3) by their length in radians."""
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    # sinc(x) of numpy is sin(pi x) / (pi x).
    half = 0.5 * np.sinc(angle / (2.0 * np.pi)) * vector
    return np.concatenate([np.cos(0.5 * angle), half], axis=-1)


def to_vector(rotation: Floats) -> Floats:
    """Return the vectors (..., 3) of the shorter way round, as `from_vector` takes them."""
    rotation = np.where(rotation[..., :1] < 0.0, -rotation, rotation)
    size = np.linalg.norm(rotation[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(size, rotation[..., :1])
    return np.asarray(rotation[..., 1:] * angle / np.maximum(size, 1e-300))


def rotate(rotation: Floats, vector: Floats) -> Floats:
    """Return vectors (..., 3) rotated."""
    w, axis = rotation[..., :1], rotation[..., 1:]
    across = 2.0 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def running_product(steps: Floats) -> Floats:
    """Return the products of the first 0, 1, ... n rotations (..., n, 4) as (..., n + 1, 4).

    The first one is the innermost to the left: orientations of a body that turns by the steps in
    its own axes.
    """
    n = steps.shape[-2]
    out: Any = np.empty((*steps.shape[:-2], n + 1, 4))
    out[..., 0, :] = [1.0, 0.0, 0.0, 0.0]
    out[..., 1:, :] = steps
    reach = 1
    while reach <= n:  # after each round an element is the product of twice as many steps
        out[..., reach:, :] = product(out[..., :-reach, :], out[..., reach:, :])
        reach *= 2
    return np.asarray(out)
