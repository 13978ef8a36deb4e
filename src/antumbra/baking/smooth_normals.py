"""Normals of vertices from the faces around them, for parts without normals.

The faces around a position are averaged, whether or not they share vertices. Where faces lie on others that face the
opposite way, such as the two sides of a sheet, all of them together would cancel. There each side is averaged by
itself: a face belongs with the faces across its edges that continue its surface.
"""

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import atan2, cos

_FOLDED = -float(cos(np.radians(0.1)))  # cosine of the angle between the normals of two sides of a surface
_MOST_SIDES = 16  # faces at an edge that are compared with each other


def face_vectors(positions: NDArray[np.float64], faces: NDArray[np.integer]) -> NDArray[np.float64]:
    """(f, 3) float64: the normals of faces, with twice their area as length."""
    a, b, c = (positions[faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def smooth_normals(positions: NDArray[np.float64], faces: NDArray[np.integer], keys: np.ndarray) -> NDArray[np.float64]:
    """(v, 3) float64: the mean normal of the faces around each vertex; vertices with equal keys are merged.

    Faces are weighted by their angle at the vertex, so the triangulation of a polygon does not matter. A vertex of
    faces on both sides of a surface gets the normal of the side of its first face.
    """
    _, same = np.unique(np.ascontiguousarray(keys), axis=0, return_inverse=True)
    same, vectors = same.reshape(-1), face_vectors(positions, faces)
    vectors = vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)
    group = _groups(same[faces], vectors)
    sums = np.zeros((max(int(same.max()), int(group.max(initial=0))) + 1, 3))
    for k in range(3):
        weighted = _angles(positions, faces, k)[:, None] * vectors
        sums += np.stack([np.bincount(group[:, k], weighted[:, i], len(sums)) for i in range(3)], 1)
    of_vertex = same.copy()
    used, first = np.unique(faces, return_index=True)
    of_vertex[used] = group.reshape(-1)[first]
    return sums[of_vertex]


def _angles(positions: NDArray[np.float64], faces: NDArray[np.integer], k: int) -> NDArray[np.float64]:
    """(f,) float64: the angle of each face at its corner k."""
    a, b, c = (positions[faces[:, (k + i) % 3]] for i in range(3))
    return np.asarray(atan2(np.linalg.norm(np.cross(b - a, c - a), axis=1), ((b - a) * (c - a)).sum(1)))


def _groups(places: NDArray[np.integer], normals: NDArray[np.float64]) -> NDArray[np.int64]:
    """(f, 3) int64: equal for corners whose faces are averaged: their places, (f, 3), unless sides coincide there."""
    corner, other, consistent = _pairs_at_edges(places)
    turn = (normals[corner // 3] * normals[other // 3]).sum(1)
    flat = places.reshape(-1).astype(np.int64)
    layered = np.zeros(int(flat.max(initial=-1)) + 1, bool)
    layered[flat[corner[turn < _FOLDED]]] = True
    if not layered.any():
        return flat.reshape(places.shape)
    joined = consistent & (turn >= _FOLDED) & layered[flat[corner]]
    sides = _connected(corner[joined], other[joined], len(flat))
    return np.where(layered[flat], len(layered) + sides, flat).reshape(places.shape)


def _connected(a: NDArray[np.int64], b: NDArray[np.int64], n: int) -> NDArray[np.int64]:
    """(n,) int64: the least of the elements that pairs (a, b) connect with each element."""
    least = np.arange(n)
    while len(a):
        lower = np.minimum(least[a], least[b])
        before = least.copy()
        np.minimum.at(least, least[a], lower)
        np.minimum.at(least, least[b], lower)
        least = least[least]
        if (least == before).all():
            break
    return least


def _pairs_at_edges(places: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """(corners, corners of other faces at the same place and edge, whether the faces run along the edge either way).

    Corner k of face f is 3 f + k. Of more than `_MOST_SIDES` faces at an edge, not all are paired.
    """
    index = np.arange(places.size).reshape(-1, 3)
    start, end = places.reshape(-1), np.roll(places, -1, 1).reshape(-1)
    corners = np.stack([index.reshape(-1), np.roll(index, -1, 1).reshape(-1)], 1)  # at both ends of each edge
    ahead = start < end
    corners[~ahead] = corners[~ahead, ::-1]  # the lower place comes first
    low, high = np.minimum(start, end), np.maximum(start, end)
    order = np.lexsort([high, low])
    order = order[low[order] != high[order]]
    found = list[tuple[np.ndarray, np.ndarray]]()
    for step in range(1, _MOST_SIDES):
        a, b = order[:-step], order[step:]
        together = (low[a] == low[b]) & (high[a] == high[b])
        if not together.any():
            break
        found.append((a[together], b[together]))
    one, two = (np.concatenate([np.empty(0, np.int64), *(pair[k] for pair in found)]) for k in range(2))
    return corners[one].reshape(-1), corners[two].reshape(-1), np.repeat(ahead[one] != ahead[two], 2)
