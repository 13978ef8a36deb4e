"""Exact answers for float32 rays and triangles in integer arithmetic: the reference of `wrong_elsewhere` and `drop_in`.

Every float32 is a multiple of 2^-149, so all sums and products are exact in Python integers, and signs of determinants
decide. This file shares no code with the package.
"""

from fractions import Fraction

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
    return _hits(corners, starts, vectors)[0].any(1)


def _hits(corners, starts, vectors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(hit, height, total), each (n, m): whether ray and triangle meet at t > 0; t is height / total."""
    a, b, c = (_columns(corners[None, :, k] - starts[:, None]) for k in range(3))
    d = _columns(vectors[:, None])
    edges = np.stack([_det(d, b, c), _det(d, c, a), _det(d, a, b)])
    low, high, total = edges.min(0), edges.max(0), edges.sum(0)
    height = _det(a, b, c)
    ahead = height * total > 0  # the sign of t; total is 0 where the line is edge-on
    return (((low >= 0) | (high <= 0)) & ahead).astype(bool), height, total


def above(triangles: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) bool: whether each direction points to the front side of its triangle ((n, 3, 3) float32)."""
    corners, d = _integers(triangles), _columns(_integers(directions))
    edges = (_columns(corners[:, k] - corners[:, 0]) for k in (1, 2))
    return (_det(d, *edges) > 0).astype(bool)


def crossings(vertices: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(n,) int64: at how many points with t > 0 each ray meets the closed triangles, however many meet in a point.

    vertices : (m, 3, 3) float32
    origins, directions : (n, 3) float32
    """
    corners, starts, vectors = _integers(vertices), _integers(origins), _integers(directions)
    step = max(1, _PAIRS // len(corners))
    counts = []
    for i in range(0, len(starts), step):
        hit, height, total = _hits(corners, starts[i : i + step], vectors[i : i + step])
        counts += [len(set(map(Fraction, height[j, each], total[j, each]))) for j, each in enumerate(hit)]
    return np.array(counts, np.int64)


def in_a_plane(vertices: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(n,) bool: whether each of the points, (n, 3) float32, lies in the plane of a triangle ((m, 3, 3) float32)."""
    corners, at = _integers(vertices), _integers(points)
    step = max(1, _PAIRS // len(corners))
    heights = [
        _det(*(_columns(corners[None, :, k] - at[i : i + step, None]) for k in range(3)))
        for i in range(0, len(at), step)
    ]
    return (np.concatenate(heights) == 0).any(1)
