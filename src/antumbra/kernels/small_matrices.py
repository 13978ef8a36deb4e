"""Products of small matrices and vectors in NumPy, with the same bits everywhere.

NumPy gives ``@``, `numpy.dot`, `numpy.linalg` and the length of a single vector to BLAS and LAPACK, and sums in
`numpy.einsum` in the order of the processor's registers. Their last bits depend on the processor. These functions add
in a fixed order, one operation of NumPy each, which IEEE 754 defines to the bit. They suit sums of a few terms.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def dot(a: ArrayLike, b: ArrayLike) -> Any:
    """Dot products along the last axis, (...) float64."""
    products = np.asarray(a, np.float64) * np.asarray(b, np.float64)
    total = products[..., 0]
    for k in range(1, products.shape[-1]):
        total = total + products[..., k]
    return total


def length(v: ArrayLike) -> Any:
    """Lengths of vectors along the last axis, (...) float64."""
    return np.sqrt(dot(v, v))


def product(a: ArrayLike, b: ArrayLike) -> NDArray[np.float64]:
    """The matrix product ``a @ b`` in float64: (..., n, k) times (..., k, m); leading axes broadcast.

    ``product(points, matrix.T)`` transforms points (n, 3) by a matrix (3, 3).
    """
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    if b.shape[-2] == 0:
        return np.asarray(a @ b)  # zeros
    total = a[..., :, 0, None] * b[..., None, 0, :]
    for k in range(1, b.shape[-2]):
        total += a[..., :, k, None] * b[..., None, k, :]
    return np.asarray(total)


def determinant(m: ArrayLike) -> Any:
    """Determinants of 3 x 3 matrices, (...) float64."""
    m = np.asarray(m, np.float64)
    return dot(m[..., 0, :], np.cross(m[..., 1, :], m[..., 2, :]))


def inverse(m: ArrayLike) -> NDArray[np.float64]:
    """Inverses of regular 3 x 3 matrices, (..., 3, 3) float64, by Cramer's rule."""
    m = np.asarray(m, np.float64)
    a, b, c = m[..., 0, :], m[..., 1, :], m[..., 2, :]
    columns = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], -1)
    return np.asarray(columns / determinant(m)[..., None, None])


def tangents_of(normals: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Two unit vectors perpendicular to each of the unit vectors, (n, 3), and to each other [Duff et al. 2017]."""
    x, y, z = normals.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    return np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], 1), np.stack([b, sign + y * y * a, -y], 1)
