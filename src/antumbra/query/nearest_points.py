"""Nearest points: which of many points is nearest to each of many places, in any dimension, exactly.

The points are in the leaves of a balanced tree of boxes without links: a level of the tree is an array of boxes. All
places descend together, one level at a time, so NumPy does all of the work.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

_LEAF = 8  # least number of points in a leaf; at most twice as many
_BATCH = 1 << 12  # places that descend together
_NONE = np.iinfo(np.int64).max


class Nearest(NamedTuple):
    """The nearest points of places."""

    indices: NDArray[np.int64]  # (m,): of equally near points, the first
    distances: NDArray[np.float64]  # (m,)


class PointTree:
    """A tree of points, (n, d) float64 with n > 0.

    Parameters
    ----------
    points : (n, d) float64
        Finite.
    """

    def __init__(self, points: NDArray[np.float64]):
        n = len(points)
        depth = max((n // _LEAF).bit_length() - 1, 0)
        leaf = -(-n >> depth)
        order = np.minimum(np.arange(leaf << depth), n - 1)  # the last point fills the last leaf
        levels = []
        for level in range(depth + 1):
            order = order.reshape(1 << level, -1)
            part = points[order]  # (nodes, points of a node, d)
            lower, upper = part.min(1), part.max(1)
            levels.append((lower, upper))
            if level < depth:
                widest = (upper - lower).argmax(1)
                along = np.take_along_axis(part, widest[:, None, None], 2)[..., 0]
                order = np.take_along_axis(order, np.argpartition(along, order.shape[1] // 2, axis=1), 1)
        self._levels, self._members, self._points = levels, order, points

    def nearest(self, places: NDArray[np.float64], *, others: bool = False) -> Nearest:
        """The nearest point of each place, (m, d) float64.

        others : place i is point i, and the nearest *other* point is sought; its distance is inf if there is none.
        """
        excluded = np.arange(len(places)) if others else np.full(len(places), -1)
        batches = [Nearest(np.empty(0, np.int64), np.empty(0))]
        for first in range(0, len(places), _BATCH):
            batch = slice(first, first + _BATCH)
            batches.append(self._nearest_of(places[batch], excluded[batch]))
        return Nearest(*(np.concatenate(parts) for parts in zip(*batches)))

    def _nearest_of(self, places: NDArray[np.float64], excluded: NDArray[np.int64]) -> Nearest:
        place, node = np.arange(len(places)), np.zeros(len(places), np.int64)
        for level in range(1, len(self._levels)):  # one leaf close to each place bounds the distance
            children = 2 * node[:, None] + (0, 1)
            node = children[place, self._to_boxes(level, places[:, None], children).argmin(1)]
        bound, _ = self._in_leaves(places, place, node, excluded)
        node = np.zeros(len(places), np.int64)
        for level in range(1, len(self._levels)):  # all boxes that are no farther
            place, node = np.repeat(place, 2), (2 * node[:, None] + (0, 1)).reshape(-1)
            reached = self._to_boxes(level, places[place], node) <= bound[place]
            place, node = place[reached], node[reached]
        squares, indices = self._in_leaves(places, place, node, excluded)
        return Nearest(indices, np.sqrt(squares))

    def _to_boxes(self, level: int, places: NDArray[np.float64], node: NDArray[np.int64]) -> NDArray[np.float64]:
        """The squared distances of places to boxes; never more than those to points in the boxes."""
        lower, upper = self._levels[level]
        return _square(np.maximum(np.maximum(lower[node] - places, places - upper[node]), 0.0))

    def _in_leaves(
        self,
        places: NDArray[np.float64],
        place: NDArray[np.int64],
        node: NDArray[np.int64],
        excluded: NDArray[np.int64],
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Squared distance and index of the nearest point of each place, in some leaves of each; `place` is sorted."""
        members = self._members[node]
        squares = _square(self._points[members] - places[place, None])
        squares[members == excluded[place, None]] = np.inf
        first = np.searchsorted(place, np.arange(len(places)))
        least = np.minimum.reduceat(squares.min(1), first)
        indices = np.where(squares == least[place, None], members, _NONE).min(1)
        return least, np.minimum.reduceat(indices, first)


def _square(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """The squared lengths of (..., d) vectors, summed in the order of their components."""
    total = vectors[..., 0] * vectors[..., 0]
    for k in range(1, vectors.shape[-1]):
        total += vectors[..., k] * vectors[..., k]
    return total
