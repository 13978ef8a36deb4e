"""Exact answers for float32 rays and triangles in integer arithmetic: the reference of `wrong_elsewhere`.

Every float32 is a multiple of 2^-149, so all sums and products are exact in Python integers, and signs of determinants
decide. This file shares no code with the package.
"""

import numpy as np

_SCALE = 2**149
_PAIRS = 200_000  # in memory at once

_to_steps = np.frompyfunc(lambda x: int(x.as_integer_ratio()[0] * (_SCALE // x.as_integer_ratio()[1])), 1, 1)


def _integers(values) -> np.ndarray:
    """The float32 values in steps of 2^-149, as an object array of int."""
    return _to_steps(np.asarray(values, np.float32).astype(float))


def _det(a, b, c):
    return a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def _columns(rows: np.ndarray) -> list:
    return [rows[..., k] for k in range(3)]


def blocked(vertices: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) bool: whether the ray origin + t direction, t > 0, hits a closed triangle, in real arithmetic.

    vertices : (m, 3, 3) float32
    origins, directions : (n, 3) float32
    """
    corners, starts, vectors = _integers(vertices), _integers(origins), _integers(directions)
    step = max(1, _PAIRS // len(corners))
    parts = [_some(corners, starts[i : i + step], vectors[i : i + step]) for i in range(0, len(starts), step)]
    return np.concatenate(parts)


def _some(corners, starts, vectors) -> np.ndarray:
    a, b, c = (_columns(corners[None, :, k] - starts[:, None]) for k in range(3))
    d = _columns(vectors[:, None])
    edges = np.stack([_det(d, b, c), _det(d, c, a), _det(d, a, b)])
    low, high, total = edges.min(0), edges.max(0), edges.sum(0)
    ahead = _det(a, b, c) * total > 0  # the sign of t; total is 0 where the line is edge-on
    return (((low >= 0) | (high <= 0)) & ahead).astype(bool).any(1)


def above(triangles: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) bool: whether each direction points to the front side of its triangle ((n, 3, 3) float32)."""
    corners, d = _integers(triangles), _columns(_integers(directions))
    edges = (_columns(corners[:, k] - corners[:, 0]) for k in (1, 2))
    return (_det(d, *edges) > 0).astype(bool)
