"""Finely tessellated smooth surfaces, which xatlas takes for flat ones, split by direction.

xatlas first joins neighbouring faces whose normals differ by less than about 0.8 degrees to a flat chart. On a finely
tessellated sphere or pipe these steps add up to all directions. The chart then has no edge, which crashes xatlas, or
it folds onto itself.
"""

import numpy as np
from numpy.typing import NDArray

from .smooth_normals import face_vectors

_SAME_DIRECTION = 2e-4  # xatlas: cosines within 1e-4 of 1, between float32 normals
_WIDEST = 0.5  # cosine of 60 degrees, between a face and the mean normal of a flat chart


def directions_of_bent(positions: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.int64]:
    """(f,) int64: 0 for a face that a flat chart suits, else 1 to 6: the axis direction nearest to its normal.

    positions : (v, 3) float64
    faces : (f, 3) int
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    vectors = face_vectors(positions, faces)
    normals = _unit(vectors)
    one, other = _neighbours(positions, faces)
    same = (normals[one] * normals[other]).sum(1) > 1.0 - _SAME_DIRECTION
    links = coo_array((np.ones(same.sum(), bool), (one[same], other[same])), (len(faces), len(faces)))
    count, chart = connected_components(links, directed=False)
    mean = _unit(np.stack([np.bincount(chart, vectors[:, k], count) for k in range(3)], 1))
    steep = ((normals * mean[chart]).sum(1) < _WIDEST) & (vectors != 0.0).any(1)
    bent = np.bincount(chart, steep, count)[chart] > 0
    axis = np.abs(normals).argmax(1)
    direction = 1 + 2 * axis + (normals[np.arange(len(faces)), axis] < 0.0)
    return np.where(bent, direction, 0)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unit vectors; zero stays zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300))


def _neighbours(positions: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of faces with a common edge. Vertices at the same place count as one."""
    _, place = np.unique(positions, axis=0, return_inverse=True)
    corner = place.reshape(-1)[faces]
    ends = np.sort(np.concatenate([corner[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    key = ends[:, 0] * (int(corner.max(initial=0)) + 1) + ends[:, 1]
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    return order[same] % len(faces), order[same + 1] % len(faces)
