"""Caps: triangles that close open surfaces, so that one ray in the scene tells the parity of rays in all directions.

A surface and its caps together share every edge an even number of times, so all rays from a point cross them equally
often, modulo 2. So once one ray has been traced through the surface, the parity of another differs from it by what the
two rays cross of the caps, which are few. Where the caps lie does not matter.

Every point has an even number of open edges, so they form loops. A loop is closed by cutting off every second corner,
again and again: small triangles at the edges, and half as many larger ones each time.
"""

import numpy as np
from numpy.typing import NDArray

from .closed_surfaces import open_edges

_WORTH = 2  # faces per open edge; with fewer, the rays through the caps take as long as those through the surface


def surface_caps(corners: NDArray[np.float32]) -> NDArray[np.float32] | None:
    """(m, 3, 3): triangles that close the surface of others, (n, 3, 3), some perhaps without area.

    None if the surface has so many open edges that caps would not help.
    """
    edges = open_edges(corners)
    if len(edges) * _WORTH > len(corners):
        return None
    points, numbers = np.unique(edges.reshape(-1, 3), axis=0, return_inverse=True)
    numbers = numbers.reshape(-1)
    if (np.bincount(numbers) % 2 == 1).any():  # hashes of two edges were equal
        return None
    return points[_triangles_of(*_loops(numbers))]


def _loops(numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """(points of all loops, in order; number of points of each loop).

    numbers : (2 m,) int, of the points at the ends of edges: those of edge e are elements 2 e and 2 e + 1
    """
    ends, partner = np.arange(len(numbers)), np.empty(len(numbers), np.int64)
    pairs = np.argsort(numbers, kind="stable").reshape(-1, 2)  # of ends at the same point
    partner[pairs] = pairs[:, ::-1]
    after = partner[ends ^ 1]  # where the next edge begins
    loop, further = ends, after
    for _ in range(len(ends).bit_length()):  # twice as many ends each time
        loop, further = np.minimum(loop, loop[further]), further[further]
    one_way = np.flatnonzero(loop < loop[ends ^ 1])
    is_last = after == loop
    left, further = (~is_last).astype(np.int64), np.where(is_last, ends, after)  # ends until the last of the loop
    for _ in range(len(ends).bit_length()):
        left, further = left + left[further], further[further]
    order = one_way[np.lexsort((-left[one_way], loop[one_way]))]
    return numbers[order], np.unique(loop[order], return_counts=True)[1]


def _triangles_of(points: NDArray[np.int64], lengths: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 3): points of triangles that close loops, from `_loops`."""
    found = [np.empty((0, 3), np.int64)]
    while len(lengths):
        first = np.repeat(np.cumsum(lengths) - lengths, lengths)
        length, place = np.repeat(lengths, lengths), np.arange(len(points)) - first
        kept = place % 2 == 0
        cut = np.flatnonzero(kept & (place + 1 < length) & (length > 2))
        beyond = first[cut] + (place[cut] + 2) % length[cut]
        found.append(np.stack([points[cut], points[cut + 1], points[beyond]], axis=1))
        points, lengths = points[kept & (length > 2)], (lengths[lengths > 2] + 1) // 2
    return np.concatenate(found)
