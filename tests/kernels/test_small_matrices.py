"""Products of small matrices: one order of sums, and the values of NumPy's functions."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.kernels.small_matrices import determinant, dot, inverse, length, product, tangents_of

RNG = np.random.default_rng(8)


def test_sums_are_made_in_order():
    a, b = RNG.normal(size=(5, 4, 3)), RNG.normal(size=(5, 3, 2))
    found = product(a, b)
    for m in range(5):
        for i in range(4):
            for j in range(2):
                total = a[m, i, 0] * b[m, 0, j]
                for k in (1, 2):
                    total += a[m, i, k] * b[m, k, j]
                assert found[m, i, j] == total
    x, y, z = a.reshape(-1, 3).T
    assert (length(a).ravel() == np.sqrt((x * x + y * y) + z * z)).all()
    assert dot([1.0, 2.0], [3.0, 4.0]) == 11.0 and length([3.0, 4.0]) == 5.0


@pytest.mark.parametrize("shape", [(3, 3), (7, 3, 3), (0, 3, 3)])
def test_values(shape):
    m = RNG.normal(size=shape) + 3.0 * np.eye(3)
    np.testing.assert_allclose(determinant(m), np.linalg.det(m), rtol=1e-12)
    np.testing.assert_allclose(inverse(m), np.linalg.inv(m), rtol=1e-9, atol=1e-12)


def test_float32_is_widened():
    points, turn = RNG.normal(size=(9, 3)).astype(np.float32), RNG.normal(size=(3, 3)).astype(np.float32)
    found = product(points, turn.T)
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, points.astype(np.float64) @ turn.T.astype(np.float64), rtol=1e-12)


@pytest.mark.parametrize("n, k, m", [(2, 0, 3), (0, 3, 2), (4, 1, 0)])
def test_empty_matrices(n, k, m):
    assert product(np.ones((n, k)), np.ones((k, m))).tolist() == np.full((n, m), float(k)).tolist()


@given(st.integers(0, 1 << 32))
def test_tangents_are_orthonormal(seed):
    normals = np.random.default_rng(seed).normal(size=(8, 3))
    normals[:3] = np.eye(3) * (-1) ** (seed % 2)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    frames = np.stack([*tangents_of(normals), normals], 1)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (8, 3, 3)), atol=1e-14)
