"""Small scenes for lines of sight, and the oracle's answers for all pairs of points."""

import numpy as np

import antumbra as at
import oracle
from receivers import receivers_of


def scene_of(seed, n=24):
    """Triangles of middling size in a cube."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform(-1, 1, (n, 1, 3)) + rng.uniform(-0.5, 0.5, (n, 3, 3))
    return at.Scene.from_arrays(corners.astype(np.float32)), rng


def expected(scene, rows, columns):
    """(n, m) bool by the oracle; rows, columns: (points, normals or None)."""
    (a, na), (b, nb) = (receivers_of(scene, points, normals) for points, normals in (rows, columns))
    origins, ends = (x.reshape(-1, 3) for x in np.broadcast_arrays(a[:, None], b[None]))
    blocked = oracle.occluded(scene.triangles().vertices, origins, ends=ends).reshape(len(a), len(b))
    away = b[None].astype(np.float64) - a[:, None]
    if na is not None:
        blocked |= (away * na[:, None]).sum(-1) <= 0.0
    if nb is not None:
        blocked |= (-away * nb[None]).sum(-1) <= 0.0
    return ~blocked
