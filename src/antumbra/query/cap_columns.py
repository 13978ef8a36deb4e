"""Columns of caps: along each of fourteen directions, the depth beyond which a ray from a point meets no cap.

Most points see no caps in most directions, and a look into a table is faster than a ray. Opposite directions share a
line. Across each line of seven, a grid divides space into columns, and each column holds the range of depths of the
caps that reach it. A ray from a point beyond this range meets no cap. The converse does not hold: ranges are those of
boxes around pieces of caps, and large pieces are entered into larger columns.

Rounding. A point's column and depth are computed in float32, from coordinates of at most M in magnitude, the largest of
the scene's bounds. Across a line, at most two coordinates and a constant of at most 2 M are multiplied and added: with
u = 2**-24, this takes less than 20 u M. Caps are entered with a margin of ``_MARGIN`` M = 64 u M.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

AXES, ALL = 6, 14  # directions along the axes, and with the space diagonals
LINES = ALL // 2
SIDE = 128  # columns along each side of a grid; those at the rims stay empty
_MARGIN = 2.0**-18
_PARTS = 2, 4, 8, 16, 32  # of the scene's extent; the largest piece of a cap is one of these
_MANY = 1 << 14  # pieces
_LEVELS = SIDE.bit_length()  # of grids, each of half as many columns per side as the one before
_WIDE = 8  # columns along each side of a piece, above which it is entered into a coarser grid

_AXES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
_DIAGONALS = np.array(list(product((-1.0, 1.0), repeat=3)), np.float32)


class CapColumns(NamedTuple):
    """Columns of caps along seven lines; a point's coordinates are the rows of `frames` times it, plus `starts`."""

    directions: np.ndarray  # (14, 3) float32 of -1, 0 and 1: the first one, the other axes, the diagonals
    ends: np.ndarray  # (7, 2) int64: the numbers of the two directions of each line
    frames: np.ndarray  # (7, 3, 3) float32: across each line, in columns; and along the first of its directions
    starts: np.ndarray  # (7, 3) float32
    depths: np.ndarray  # (7, SIDE, SIDE, 2) float32: least and greatest depth of the caps; inf, -inf: none


def all_directions(axis: NDArray[np.floating]) -> NDArray[np.float32]:
    """(14, 3): an axis, the other axes, and the diagonals."""
    others = _AXES[(axis != _AXES).any(axis=1)]
    order = np.argsort(-(_DIAGONALS @ axis), kind="stable")  # along the axis first
    return np.concatenate([axis[None], others, _DIAGONALS[order]]).astype(np.float32)


def cap_columns(corners: NDArray[np.float32], axis: NDArray[np.floating], box: NDArray[np.float32]) -> CapColumns:
    """The columns of caps, (n, 3, 3).

    axis : (3,), the first direction
    box : (2, 3), bounds of the points and of the caps
    """
    unknown, margin = unknown_columns(axis), max(_MARGIN * float(np.abs(box).max()), 1e-30)
    pieces = _pieces(corners, float(np.ptp(box, axis=0).max()))
    frames, starts = np.empty((LINES, 3, 3)), np.zeros((LINES, 3))
    depths = np.empty((LINES, SIDE, SIDE, 2), np.float32)
    for line, (k, _) in enumerate(unknown.ends):
        along = unknown.directions[k]
        frame = np.stack([*_across(along), along]).astype(np.float64)
        places = (pieces.reshape(-1, 3) @ frame.T).reshape(-1, 3, 3)
        low, high = _extremes(places)
        low, high = low - margin, high + margin
        first, extent = low.min(axis=0)[:2], np.ptp([low.min(axis=0), high.max(axis=0)], axis=0)[:2]
        scale = (SIDE - 2) / extent
        frames[line], starts[line, :2] = frame * [[scale[0]], [scale[1]], [1.0]], 1.0 - first * scale
        begin, end = ((1 + (each[:, :2] - first) * scale).astype(np.int64).clip(1, SIDE - 2) for each in (low, high))
        depths[line] = _entered(begin, end, np.stack([low[:, 2], high[:, 2]], axis=1))
    return unknown._replace(frames=frames.astype(np.float32), starts=starts.astype(np.float32), depths=depths)


def unknown_columns(axis: NDArray[np.floating]) -> CapColumns:
    """Columns in which caps may be anywhere; axis : (3,), the first direction."""
    directions = all_directions(axis)
    ends = [(k, other) for k in range(ALL) if (other := _opposite(directions, k)) > k]
    depths = np.empty((LINES, SIDE, SIDE, 2), np.float32)
    depths[:] = -np.inf, np.inf
    frames, starts = np.zeros((LINES, 3, 3), np.float32), np.zeros((LINES, 3), np.float32)
    return CapColumns(directions, np.array(ends), frames, starts, depths)


def _pieces(corners: NDArray[np.float32], extent: float) -> NDArray[np.float64]:
    """(m, 3, 3): caps, of which large ones are split into four until they are small, or become too many.

    extent : of the scene
    """
    pieces, most = corners.astype(np.float64), len(corners) + _MANY
    for parts in _PARTS:
        while (large := np.subtract(*_extremes(pieces)[::-1]).max(axis=1) > extent / parts).any():
            a = pieces[large]
            if len(pieces) + 3 * len(a) > most:
                return pieces
            middles = (a + a[:, [1, 2, 0]]) / 2.0
            inner = [np.stack([a[:, k], middles[:, k], middles[:, k - 1]], axis=1) for k in range(3)]
            pieces = np.concatenate([pieces[~large], middles, *inner])
    return pieces


def _extremes(triangles: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n, 3) each: the least and greatest coordinates of (n, 3, 3); several times as fast as along an axis of three."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    return np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)


def _opposite(directions: NDArray[np.float32], k: int) -> int:
    return int((directions == -directions[k]).all(axis=1).argmax())


def _across(direction: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Two vectors across a direction, with up to two components, of 1 and -1."""
    along = np.flatnonzero(direction)
    if len(along) == 1:
        return [row for k, row in enumerate(np.eye(3, dtype=np.float32)) if k != along[0]]
    x, y, z = direction
    return [np.array([x, 0, -z]), np.array([0, y, -z])]


def _entered(begin: NDArray[np.int64], end: NDArray[np.int64], ranges: NDArray[np.float64]) -> NDArray[np.float32]:
    """(SIDE, SIDE, 2): the range of depths in each column.

    begin, end : (n, 2), the first and the last column of each piece of a cap
    ranges : (n, 2), its least and greatest depth
    """
    level = np.zeros(len(begin), np.int64)
    for k in range(_LEVELS):
        wide = (end >> k) - (begin >> k) >= _WIDE
        level[wide[:, 0] | wide[:, 1]] = k + 1
    found = np.empty((0, 0, 2))
    for k in reversed(range(int(level.max()) + 1)):
        coarser, side = found, SIDE >> k
        found = np.full((side, side, 2), (np.inf, -np.inf))
        if coarser.size:
            found[:] = coarser.repeat(2, axis=0).repeat(2, axis=1)
        which = np.flatnonzero(level == k)
        low, size = begin[which] >> k, (end[which] >> k) - (begin[which] >> k) + 1
        counts = size.prod(axis=1)
        cap = np.repeat(np.arange(len(which)), counts)
        row, column = np.divmod(np.arange(len(cap)) - np.repeat(np.cumsum(counts) - counts, counts), size[cap, 1])
        cells = (low[cap, 0] + row) * side + low[cap, 1] + column
        for end_, reduce in enumerate((np.minimum, np.maximum)):
            depths = found[..., end_].ravel()  # contiguous, as `at` is fast only there
            reduce.at(depths, cells, ranges[which[cap], end_])
            found[..., end_] = depths.reshape(side, side)
    for rim in (found[0], found[-1], found[:, 0], found[:, -1]):  # beyond all caps, but not beyond coarser columns
        rim[:] = np.inf, -np.inf
    return found.astype(np.float32)
