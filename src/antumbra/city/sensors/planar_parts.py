"""Planar parts: coplanar faces that share edges, joined to walls, roofs and floors.

The normal of a sliver is mostly rounding, so a sliver takes the plane of a neighbour in which it lies.
"""

import numpy as np
from numpy.typing import NDArray

from ...kernels.elementary import cos

FLAT = 0.1
"""Degrees between the normals of joined faces."""

SLIVER = 0.05
"""Metres: a face that is nowhere wider is a sliver."""

IN_PLANE = 0.001
"""Metres from a neighbour's plane within which a sliver lies in it."""

_NO_NORMAL = 0.0001  # metres: the normal of a narrower face says nothing
_SIMILAR = 0.5  # cosine of the largest angle between the normals of other slivers and of their planes
_SAME_PLANE = float(cos(np.radians(FLAT)))
_ACROSS = np.array([0.5257, 0.3129, 0.7911])  # a direction in which different normals have different components


def planar_parts(
    corners: NDArray[np.float64], objects: NDArray[np.int64], unit: float = 1.0
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The planar parts of objects: faces that share an edge, and whose normals differ by less than `FLAT`.

    A sliver takes the normal of a neighbour within 60 degrees of its own if all of its corners lie within `IN_PLANE` of
    the neighbour's plane; of several, the most similar one. So slivers neither separate parts of a wall nor join the
    walls of a corner.

    Parameters
    ----------
    corners : (n, 3, 3) float64
        Faces are joined where corners are equal.
    objects : (n,) int64
        The object of each face; parts belong to one object.
    unit : float
        World units in a metre.

    Returns
    -------
    labels : (n,) int32
        The part of each face. Parts are ordered by object and by their corners, so their numbers do not depend on the
        order of the faces, except those of parts with the same corners.
    first : (parts,) int64
        A face of each part.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    n = len(corners)
    vertices = np.unique(corners.reshape(-1, 3), axis=0, return_inverse=True)[1].reshape(-1, 3)
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1, keepdims=True)
    normals = np.divide(across, length, out=np.zeros_like(across), where=length > 0.0)
    a, b = _neighbours(vertices, objects, normals)
    normals = _slivers_in_planes(corners, normals, length[:, 0], a, b, unit)
    flat = (normals[a] * normals[b]).sum(1) > _SAME_PLANE
    joined = coo_array((np.ones(int(flat.sum()), bool), (a[flat], b[flat])), shape=(n, n))
    labels = connected_components(joined, directed=False)[1]
    return _in_order(labels, vertices, objects)


def _neighbours(
    vertices: NDArray[np.integer], objects: NDArray[np.int64], normals: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Pairs of faces of an object that share an edge: (pairs,) and (pairs,) int64."""
    ends = np.sort(np.stack([vertices, np.roll(vertices, -1, 1)], -1).reshape(-1, 2), axis=1)
    face = np.repeat(np.arange(len(vertices)), 3)
    keys = np.column_stack([objects[face], ends])
    order = np.lexsort([(normals @ _ACROSS)[face], *keys.T[::-1]])  # the sides of coincident faces, one after the other
    before, after = order[:-1], order[1:]
    same = (keys[before] == keys[after]).all(1)
    return face[before[same]], face[after[same]]


def _slivers_in_planes(
    corners: NDArray[np.float64], normals: NDArray[np.float64], doubled_areas: NDArray[np.float64],
    a: NDArray[np.int64], b: NDArray[np.int64], unit: float,
) -> NDArray[np.float64]:  # fmt: skip
    """(n, 3) float64: the normals of faces; of slivers, those of neighbours in whose planes they lie.

    a, b : (pairs,) int64, neighbours
    """
    longest = np.linalg.norm(np.roll(corners, -1, 1) - corners, axis=2).max(1, initial=0.0)
    widths = np.divide(doubled_areas, longest, out=np.zeros_like(longest), where=longest > 0.0)
    known, out = widths > SLIVER * unit, normals.copy()
    thin, other = np.concatenate([a, b]), np.concatenate([b, a])
    while True:
        open_pairs = np.flatnonzero(~known[thin] & known[other])
        face, beside = thin[open_pairs], other[open_pairs]
        away = corners[face] - corners[beside, :1]
        distances = np.abs(np.einsum("ijk,ik->ij", away, out[beside])).max(1, initial=0.0)
        similar = (normals[face] * out[beside]).sum(1)
        lies = (distances <= IN_PLANE * unit) & ((similar >= _SIMILAR) | (widths[face] < _NO_NORMAL * unit))
        if not lies.any():
            return out
        face, beside, similar = face[lies], beside[lies], similar[lies]
        order = np.lexsort([widths[beside], similar, face])
        last = np.append(face[order][1:] != face[order][:-1], True)  # the most similar one, then the widest
        chosen = order[last]
        out[face[chosen]], known[face[chosen]] = out[beside[chosen]], True


def _in_order(
    labels: NDArray[np.integer], vertices: NDArray[np.integer], objects: NDArray[np.int64]
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """The labels of parts by object and by their corners, whose numbers ascend with their coordinates."""
    first = np.unique(labels, return_index=True)[1]
    least = np.full(len(first), np.iinfo(np.int64).max)
    greatest = np.full(len(first), -1)
    np.minimum.at(least, labels, vertices.min(1))
    np.maximum.at(greatest, labels, vertices.max(1))
    order = np.lexsort([first, greatest, least, objects[first]])
    ranks = np.empty(len(first), np.int32)
    ranks[order] = np.arange(len(first), dtype=np.int32)
    return ranks[labels], first[order]
