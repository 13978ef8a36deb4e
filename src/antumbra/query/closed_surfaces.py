"""Closed surfaces of triangle soups: open edges, and surfaces drawn twice.

An edge is open if an odd number of faces share it; corners with equal coordinates are one. A ray from a point crosses a
surface without open edges an odd number of times inside and an even number outside, in every direction.

Many exporters draw each face twice, once per side, so that rays cross every surface twice. A shared wall of two bodies
is there twice, too, but each copy closes one of them. Faces that exist an even number of times form patches, which end
where faces that exist once, or more than two of their own kind, meet. A patch counts once if this closes at least as
many edges of other faces as it opens. So a patch without other faces at its rim is a surface drawn twice, and a shared
wall stays.

Most surfaces are closed and have no face twice. Hashes show this without sorting edges: those of edges that all occur
an even number of times cancel out in an exclusive or. Faces with equal hashes are compared by their coordinates.
"""

from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_AT_A_TIME = 1 << 14  # faces
_ODD = np.uint64(0x9E3779B97F4A7C15)  # a multiplier that spreads bits


class ClosedSurfaces(NamedTuple):
    """How the faces of a soup bound bodies."""

    open_edges: int  # 0: rays in all directions agree
    once: NDArray[np.int32] | None = None  # (k,) int32, ascending: the faces without repetitions; None: all


def closed_surfaces(corners: NDArray[np.floating]) -> ClosedSurfaces:
    """The `ClosedSurfaces` of triangles, (n, 3, 3) float32 or float64."""
    if (odd_edges := _open_edges_without_repetitions(corners)) is not None:
        return ClosedSurfaces(odd_edges)
    points = _point_numbers(corners)
    faces, groups, copies = _distinct(np.sort(points, axis=1), int(points.max()) + 1)
    odd = (copies % 2 == 1) | (faces[:, :-1] == faces[:, 1:]).any(axis=1)  # faces without area change nothing
    edge_of_side = _edges_of(faces)
    n_edges = int(edge_of_side.max()) + 1
    open_edges = _odd_ones(edge_of_side[odd], n_edges)
    once = odd.copy()
    even = np.flatnonzero(~odd)
    if len(even):
        once[even] = _counts_once(edge_of_side[even], np.bincount(edge_of_side[edge_of_side >= 0]), open_edges)
    if not (once & ~odd).any():
        return ClosedSurfaces(int(open_edges.sum()))
    first = np.full(len(faces), len(groups))
    np.minimum.at(first, groups, np.arange(len(groups)))
    kept = ~(once & ~odd)[groups]
    kept[first[once]] = True
    return ClosedSurfaces(int(_odd_ones(edge_of_side[once], n_edges).sum()), np.flatnonzero(kept).astype(np.int32))


def _counts_once(
    sides: NDArray[np.int64], n_faces: NDArray[np.int64], open_edges: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Which faces that exist an even number of times belong to a patch that counts once.

    sides : (m, 3), the edges of their sides
    n_faces : (e,), the number of distinct faces at each edge
    open_edges : (e,), the edges that are open if all patches count as drawn
    """
    order = np.argsort(sides, axis=None, kind="stable")
    face, edge = order // 3, sides.reshape(-1)[order]
    number = np.bincount(edge, minlength=len(open_edges))
    pairs = np.flatnonzero(number[edge] == 2)[::2]
    patch = _components(len(sides), face[pairs], face[pairs + 1])
    rims, times = np.unique(patch[face] * np.int64(len(open_edges)) + edge, return_counts=True)
    rims, times = rims[times % 2 == 1], times[times % 2 == 1]
    patch_of_rim, rim = np.divmod(rims, len(open_edges))
    closes = np.where(open_edges[rim], 1, np.where(n_faces[rim] > times, -1, 0))
    gain = np.bincount(patch_of_rim, closes, minlength=len(sides))
    return np.asarray(gain[patch] >= 0)


def _components(n: int, a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,): the lowest member of the component of each of n nodes, for links between nodes a[i] and b[i]."""
    label = np.arange(n)
    while True:
        low = np.minimum(label[a], label[b])
        linked = label.copy()
        for ends in (label[a], label[b]):
            np.minimum.at(linked, ends, low)
        while not np.array_equal(linked, linked[linked]):
            linked = linked[linked]
        if np.array_equal(linked, label):
            return label
        label = linked


# --- Numbers of points, edges and faces -------------------------------------------------------------------------------


def _point_numbers(corners: NDArray[np.floating]) -> NDArray[np.int64]:
    """(n, 3): a number of each corner, equal for equal coordinates."""
    rows = corners.reshape(-1, 3)
    for salt in count():  # until no two points have the same hash
        _, first, number = np.unique(_hashes(corners, salt).reshape(-1), return_index=True, return_inverse=True)
        if np.array_equal(rows[first][number], rows):
            return number.reshape(-1, 3).astype(np.int64)
    raise AssertionError


def _distinct(
    faces: NDArray[np.int64], n_points: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Distinct rows of (n, 3), the distinct row of each row, and their frequencies."""
    pair = np.unique(faces[:, 0] * n_points + faces[:, 1], return_inverse=True)[1]
    _, first, group, times = np.unique(
        pair * n_points + faces[:, 2], return_index=True, return_inverse=True, return_counts=True
    )
    return faces[first], group, times


def _edges_of(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n, 3): a number of the edge of each side of faces with ascending corners; -1: it has no length."""
    a, b = faces[:, [0, 0, 1]], faces[:, [1, 2, 2]]
    edge = np.unique(a * (faces.max() + 1) + b, return_inverse=True)[1].reshape(-1, 3)
    return np.where(a == b, -1, edge)


def _odd_ones(sides: NDArray[np.int64], n_edges: int) -> NDArray[np.bool_]:
    """(n_edges,): which edges an odd number of sides have."""
    return np.asarray(np.bincount(sides[sides >= 0], minlength=n_edges) % 2 == 1)


# --- Open edges -------------------------------------------------------------------------------------------------------


def open_edges(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """(m, 2, 3): the ends of the edges that an odd number of triangles, (n, 3, 3), share, without negative zeros."""
    hashes = _hashes(corners)
    edges = _edge_hashes(hashes).reshape(-1)
    odd = _odd_hashes(edges)
    if not len(odd):
        return np.empty((0, 2, 3), np.float32)
    place = np.searchsorted(odd, edges)
    place[place == len(odd)] = 0
    sides = np.flatnonzero(odd[place] == edges)
    face, side = np.divmod(sides[np.unique(edges[sides], return_index=True)[1]], 3)
    return np.stack([corners[face, side], corners[face, (side + 1) % 3]], axis=1) + np.float32(0.0)


# --- Hashes -----------------------------------------------------------------------------------------------------------


def _mixed(words: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Hashes of 64 bits."""
    out = words * _ODD
    out ^= out >> np.uint64(32)
    out *= _ODD
    out ^= out >> np.uint64(29)
    return out


def _hashes(corners: NDArray[np.floating], salt: int = 0) -> NDArray[np.uint64]:
    """(n, 3): a hash of each corner's coordinates."""
    words = (corners + corners.dtype.type(0.0)).view(np.uint32).reshape(*corners.shape[:2], -1)  # no negative zeros
    out = np.full(corners.shape[:2], salt, np.uint64)
    for k in range(words.shape[-1]):
        out = _mixed(out ^ words[..., k])
    return out


def _edge_hashes(hashes: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(n, 3): a hash of each side, from those of its ends; 0: it has no length."""
    after = np.roll(hashes, -1, axis=1)
    return np.where(hashes == after, np.uint64(0), _mixed(hashes + after))


def _odd_hashes(edges: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """The hashes, ascending and without 0, that occur an odd number of times."""
    ordered = np.sort(edges[edges != 0])
    ends = np.flatnonzero(np.append(ordered[1:] != ordered[:-1], True))[: len(ordered)]
    return np.asarray(ordered[ends[np.diff(ends, prepend=-1) % 2 == 1]])


def _open_edges_without_repetitions(corners: NDArray[np.floating]) -> int | None:
    """The number of open edges; None if a face may exist several times."""
    edges, faces = np.empty((len(corners), 3), np.uint64), np.empty(len(corners), np.uint64)
    for first in range(0, len(corners), _AT_A_TIME):
        part = slice(first, first + _AT_A_TIME)
        hashes = _hashes(corners[part])
        edges[part] = _edge_hashes(hashes)
        faces[part] = hashes.sum(axis=1)
    faces.sort()
    if (faces[1:] == faces[:-1]).any():
        return None
    if np.bitwise_xor.reduce(edges, axis=None) == 0:
        return 0
    return len(_odd_hashes(edges))
