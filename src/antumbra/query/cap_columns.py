"""Columns of caps: along each of fourteen directions, the depth beyond which a ray from a point meets no cap.

Most points see no caps in most directions, and a look into a table is faster than a ray. Opposite directions share a
line. Across each line of seven, a grid divides space into columns, and each column holds the range of depths of the
caps that reach it. A ray from a point beyond this range meets no cap. The converse does not hold: ranges are those of
boxes around pieces of caps.

Rounding. A point's column and depth are computed in float32, from coordinates of at most M in magnitude, the largest of
the scene's bounds. Across a line, at most two coordinates and a constant of at most 2 M are multiplied and added: with
u = 2**-24, this takes less than 20 u M. Caps are entered with a margin of ``_MARGIN`` M = 64 u M.

Around a cell of points, caps are entered with half its side more, along each axis. Then what its centre meets, or not,
holds for the whole cell.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count

AXES, ALL = 6, 14  # directions along the axes, and with the space diagonals
LINES = ALL // 2
SIDE = 128  # columns along each side of a grid; those at the rims stay empty
_MARGIN = 2.0**-18
_PARTS = 2, 4, 8, 16, 32  # of the scene's extent; the largest piece of a cap is one of these
_MANY = 1 << 14  # pieces
_MOST_ENTERED = 1 << 25  # columns of all pieces of a line, which take milliseconds

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


def cap_columns(
    corners: NDArray[np.float32],
    axis: NDArray[np.floating],
    box: NDArray[np.float32],
    around: float | NDArray[np.float64] = 0.0,
    threads: int | None = None,
) -> CapColumns:
    """The columns of caps, (n, 3, 3).

    axis : (3,), the first direction
    box : (2, 3), bounds of the points and of the caps
    around : half the sides of the cells whose centres are looked up, (3,), or one number
    """
    unknown = unknown_columns(axis)
    margins = np.full(3, max(_MARGIN * float(np.abs(box).max()), 1e-30)) + around
    pieces = _pieces(corners, float(np.ptp(box, axis=0).max()))
    along = unknown.directions[unknown.ends[:, 0]]
    axes = np.array([[*_across(each), each] for each in along], np.float64)
    columns = unknown._replace(
        frames=np.empty((LINES, 3, 3), np.float32), depths=np.empty((LINES, SIDE, SIDE, 2), np.float32)
    )
    run(_enter_pieces, thread_count(threads), new_ticket(LINES, 1), pieces, axes, margins, columns)
    return columns


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


# --- Columns of one line ----------------------------------------------------------------------------------------------


@inlined
def _range(pieces, i, axis, margins):
    """(least, greatest) coordinate of piece i along an axis, with a margin for each component of the axis."""
    reach = abs(axis[0]) * margins[0] + abs(axis[1]) * margins[1] + abs(axis[2]) * margins[2]
    least, greatest = np.float64(np.inf), np.float64(-np.inf)
    for k in range(3):
        place = pieces[i, k, 0] * axis[0] + pieces[i, k, 1] * axis[1] + pieces[i, k, 2] * axis[2]
        least, greatest = min(least, place), max(greatest, place)
    return least - reach, greatest + reach


@inlined
def _scale_of(pieces, axis, margins):
    """(least coordinate of all pieces along an axis, columns per unit of length)."""
    least, greatest = np.float64(np.inf), np.float64(-np.inf)
    for i in range(len(pieces)):
        low, high = _range(pieces, i, axis, margins)
        least, greatest = min(least, low), max(greatest, high)
    return least, (SIDE - 2) / (greatest - least)


@inlined
def _columns_of(pieces, i, axis, margins, scale):
    """(first, last) column of piece i across an axis; scale: from `_scale_of`."""
    low, high = _range(pieces, i, axis, margins)
    first, last = np.int64(1.0 + (low - scale[0]) * scale[1]), np.int64(1.0 + (high - scale[0]) * scale[1])
    return max(first, 1), min(last, SIDE - 2)


@inlined
def _fill(depths, least, greatest):
    """Set the range of depths in all columns."""
    for u in range(SIDE):
        for v in range(SIDE):
            depths[u, v, 0], depths[u, v, 1] = least, greatest


@kernel
def _enter_pieces(ticket, pieces, axes, margins, out):
    """Worker: fill the columns of a line. If too many are entered, caps may be anywhere in all of them."""
    # In: pieces (n, 3, 3) float64, axes (LINES, 3, 3) float64, margins (3,) float64. Out: out (`CapColumns`)
    nothing = np.float32(np.inf)
    for line in items(ticket):
        axis, depths, entered = axes[line], out.depths[line], 0
        across = _scale_of(pieces, axis[0], margins), _scale_of(pieces, axis[1], margins)
        for k in range(3):
            out.frames[line, 0, k], out.frames[line, 1, k] = axis[0, k] * across[0][1], axis[1, k] * across[1][1]
            out.frames[line, 2, k] = axis[2, k]
        out.starts[line, 0] = 1.0 - across[0][0] * across[0][1]
        out.starts[line, 1] = 1.0 - across[1][0] * across[1][1]
        _fill(depths, nothing, -nothing)
        for i in range(len(pieces)):
            u0, u1 = _columns_of(pieces, i, axis[0], margins, across[0])
            v0, v1 = _columns_of(pieces, i, axis[1], margins, across[1])
            low, high = _range(pieces, i, axis[2], margins)
            least, greatest = np.float32(low), np.float32(high)
            entered += (u1 - u0 + 1) * (v1 - v0 + 1)
            for u in range(u0, u1 + 1):
                for v in range(v0, v1 + 1):
                    depths[u, v, 0], depths[u, v, 1] = min(depths[u, v, 0], least), max(depths[u, v, 1], greatest)
            if entered > _MOST_ENTERED:
                _fill(depths, -nothing, nothing)
                break
