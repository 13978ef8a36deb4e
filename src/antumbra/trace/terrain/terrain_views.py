"""What an eye sees of the cells of a raster of heights: `view_from` in one sweep, `decided` for those that it leaves.

`terrain_sweep` has the kernels. Here, the raster is divided into quadrants, and those into wedges.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.parallel import new_ticket, run
from ...query.receivers import SHIFT
from .terrain_rays import TerrainTree
from .terrain_sweep import (
    HIDDEN,
    LEVELS,
    RECENT,
    SEEN,
    UNDECIDED,
    WEDGES_AT_A_TIME,
    Blocks,
    Level,
    Part,
    Quadrant,
    View,
    Wedges,
    decide,
    sweep,
)

__all__ = ["HIDDEN", "SEEN", "UNDECIDED", "Ground", "decided", "ground_of", "height_over", "view_from"]

_FIRST = 64  # wedges about the eye
_WIDE = 1.0  # cells: width of a wedge at most
_STRIP = 64  # columns between which the wedges of a thread stay in the cache
WIDEST = 1.0 + 2.0**-6  # slope of the outermost wedges; the diagonal has 1
_SURE = 2.0**-32  # tolerance, relative to the greatest height: covers weights from coordinates of 10^5 cells
_ROUNDED = 2.0**-22  # of float32, with a margin


class Ground(NamedTuple):
    """The heights of a raster in the recentred frame."""

    x: NDArray[np.float32]  # (columns,) of the vertices, ascending
    y: NDArray[np.float32]  # (rows,) descending
    z: NDArray[np.float32]  # (rows, columns), C order; NaN: no vertex
    blocks: Blocks
    reach: float  # largest magnitude of a height


class KnownHeights(NamedTuple):
    """What is known of heights, (rows, columns), before their blocks are found."""

    whole: NDArray[np.bool_]  # (rows,): rows without a missing vertex; more may have none
    reach: float  # largest magnitude of a height


def ground_of(
    x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], known: "KnownHeights | None" = None
) -> Ground:
    """A `Ground`, with the blocks of its heights."""
    fine, side, reach = LEVELS[1], 1 << LEVELS[0], 0.0 if known is None else known.reach
    tops, holes = list[NDArray[Any]](), list[NDArray[Any]]()
    for first in range(0, len(z), side):
        part = z[first : first + side]
        whole = not np.isnan(part.min()) if known is None else bool(known.whole[first : first + side].all())
        tops.append(_greatest(part, np.maximum if whole else np.fmax, fine))
        holes.append(np.zeros(tops[-1].shape, np.uint8))
        if not whole:
            holes[-1] = _greatest(np.isnan(part).view(np.uint8), np.maximum, fine)
        if known is None:
            ends = (np.minimum, np.maximum) if whole else (np.fmin, np.fmax)
            reach = max(reach, *(abs(float(each.reduce(part, None))) for each in ends))
    top, hole = np.concatenate(tops), np.concatenate(holes)
    top[np.isnan(top)] = -np.inf
    wide = [_greatest(each, np.maximum, LEVELS[0] - fine) for each in (top, hole)]
    flat = [np.concatenate([a.reshape(-1), b.reshape(-1)]) for a, b in zip(wide, (top, hole))]
    starts, widths = (np.array(each, np.int64) for each in ((0, wide[0].size), (wide[0].shape[1], top.shape[1])))
    return Ground(x, y, z, Blocks(flat[0], flat[1], starts, widths), reach)


def _greatest(values: NDArray[Any], maximum: np.ufunc, shift: int) -> NDArray[Any]:
    """The greatest values of blocks of 2^shift x 2^shift."""
    rows, columns = (np.arange(0, n, 1 << shift) for n in values.shape)
    out: NDArray[Any] = maximum.reduceat(maximum.reduceat(values, rows, axis=0), columns, axis=1)
    return out


class Over(NamedTuple):
    """Sensors above cells of a raster."""

    height: float  # of most sensors above their cells, without the lift of receivers
    there: NDArray[np.bool_]  # (n,) which have this height, within a part of the slack of `view_from`


def height_over(
    ground: Ground, points: NDArray[np.float32], cells: NDArray[np.int64] | None, height: float | None = None
) -> Over | None:
    """How receivers, (n, 3) float32, lie above cells of a raster; None if they do not lie over their vertices.

    Receivers elsewhere, such as those of cells without a surface, are not `there`.

    cells : (n,) row * columns + column; None: all
    height : that of sensors seen before; None: find it
    """
    rows, columns = ground.z.shape
    if cells is None:
        x, y, z = np.tile(ground.x, rows), np.repeat(ground.y, columns), ground.z.reshape(-1)
    else:
        x, y, z = ground.x[cells % columns], ground.y[cells // columns], ground.z.reshape(-1)[cells]
    if not ((points[:, 0] == x).all() and (points[:, 1] == y).all()):
        return None
    lifts = SHIFT * np.maximum(np.abs(x.astype(np.float64)), np.abs(y.astype(np.float64)))
    z = z.astype(np.float64)
    above = points[:, 2] - z
    if height is None:
        some = (above - np.maximum(lifts, SHIFT * np.abs(points[:, 2].astype(np.float64))))[:: len(points) // 1001 + 1]
        if np.isnan(some).all():
            return None
        height = float(np.nanmedian(some))
    lifts = np.maximum(lifts, SHIFT * np.abs(z + height))
    slack = _ROUNDED * (ground.reach + abs(height)) / 2.0
    return Over(height, np.abs(above - height - lifts) <= slack)


class _Axis(NamedTuple):
    """An axis of the grid from an eye."""

    places: NDArray[np.float64]  # (n,) cells from the eye, ascending
    lifts: NDArray[np.float64]  # (n,) `SHIFT` times the magnitude of the coordinate
    step: int  # in the heights
    far: float  # cells: greatest distance

    @property
    def turned(self) -> "_Axis":
        """The axis with the opposite direction."""
        return _Axis(-self.places[::-1], self.lifts[::-1], -self.step, self.far)


def view_from(
    ground: Ground, eye: NDArray[np.float32], height: float, threads: int, far: float = np.inf
) -> NDArray[np.uint8] | None:
    """(rows, columns) uint8: `HIDDEN`, `SEEN` or `UNDECIDED`, of each cell from an eye above the surface.

    The sensor of a cell is `height` above it, and lifted as receivers on surfaces are. Cells without a height are
    undecided.

    eye : (3,) float32, recentred
    far : cells farther away than this are undecided

    None if the eye is not inside the grid and surely above the surface.
    """
    found = _around(ground, eye, height, far)
    if not float(eye[2]) > _height_at(ground.z, found.east.places, found.south.places) + found.level.sure:
        return None
    out = np.full(ground.z.shape, UNDECIDED, np.uint8)
    for quadrant in found.quadrants:
        _sweep_quadrant(ground, quadrant, found.level, out, threads)
    return out


def decided(
    ground: Ground, eye: NDArray[np.float32], cells: NDArray[np.int64], points: NDArray[np.float32], threads: int
) -> NDArray[np.bool_]:
    """(k,) bool: whether an eye inside the grid and above the surface sees receivers above cells; exact.

    cells : (k,) row * columns + column, of cells with a height
    points : (k, 3) float32, over their vertices
    """
    found, seen = _around(ground, eye, 0.0, np.inf), points[:, 2] > ground.z.reshape(-1)[cells]
    empty, one = np.zeros(1, np.float32), np.ones(1, np.int64)
    tree = TerrainTree(
        ground.x, ground.y, ground.z, empty, np.array([0, 1]), one, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, np.inf
    )
    row, column = np.divmod(cells, ground.z.shape[1])
    east, south = found.east.places[column], found.south.places[row]
    level = np.abs(east) >= np.abs(south)
    which = np.where(level, np.where(east > 0.0, 0, 1), np.where(south > 0.0, 2, 3))
    which[(east == 0.0) & (south == 0.0)] = -1  # below the eye
    for k, quadrant in enumerate(found.quadrants):
        here = np.flatnonzero(which == k)
        along, across = (column, row) if k < 2 else (row, column)
        at = np.stack([along[here] - quadrant.column, across[here] - quadrant.row], 1) * quadrant.turn
        bits, ticket = np.empty(len(here), np.uint8), new_ticket(len(here), 64)
        view = View(quadrant, found.level, ground.blocks)
        run(decide, threads, ticket, tree, view, at, points[here], eye, bits)
        seen[here] = bits == 1
    return seen


class _Around(NamedTuple):
    """The grid from an eye."""

    east: _Axis
    south: _Axis
    level: Level
    quadrants: tuple[Quadrant, ...]  # to the east, west, south and north; none if the eye is beside the grid


def _around(ground: Ground, eye: NDArray[np.float32], height: float, far: float) -> _Around:
    """The grid from an eye, as for `view_from`."""
    rows, columns = ground.z.shape
    x, y = ground.x.astype(np.float64), ground.y.astype(np.float64)
    per_x, per_y = (columns - 1) / (x[-1] - x[0]), (rows - 1) / (y[0] - y[-1])
    east = _Axis((x - float(eye[0])) * per_x, SHIFT * np.abs(x), 1, far * per_x)
    south = _Axis((float(eye[1]) - y) * per_y, SHIFT * np.abs(y), columns, far * per_y)
    sure = _SURE * (ground.reach + abs(float(eye[2])))
    lift = float(max(east.lifts.max(), south.lifts.max(), SHIFT * (ground.reach + abs(height))))
    slack, whole = _ROUNDED * (ground.reach + abs(height) + lift), int(not ground.blocks.holes.any())
    level = Level(float(eye[2]), height, lift, slack, sure, whole)
    inside = all(axis.places[0] <= 0.0 < axis.places[-1] for axis in (east, south))
    axes = ((east, south), (south, east)) if inside else ()
    quadrants = tuple(_quadrant(along, across, turn) for along, across in axes for turn in (1, -1))
    return _Around(east, south, level, quadrants)


def _height_at(z: NDArray[np.float32], east: NDArray[np.float64], south: NDArray[np.float64]) -> float:
    """The height of the surface at the eye, the zero of both axes; inf outside the grid, NaN in a hole."""
    j, i = int(np.searchsorted(east, 0.0, "right")) - 1, int(np.searchsorted(south, 0.0, "right")) - 1
    if not (0 <= j < len(east) - 1 and 0 <= i < len(south) - 1):
        return np.inf
    a, b = -east[j] / (east[j + 1] - east[j]), -south[i] / (south[i + 1] - south[i])
    first, last = float(z[i, j]), float(z[i + 1, j + 1])
    corner = float(z[i + 1, j] if b > a else z[i, j + 1])
    return float(first + max(a, b) * (corner - first) + min(a, b) * (last - corner))


def _quadrant(along: _Axis, across: _Axis, turn: int) -> Quadrant:
    """The quadrant along an axis. turn: -1 to turn both axes."""
    if turn < 0:
        along, across = along.turned, across.turned
    first = int(np.searchsorted(along.places, 0.0, "right")) - 1
    end = int(np.searchsorted(along.places, along.far + 1.0))
    places = np.ascontiguousarray(along.places[first:end])
    low, high = np.searchsorted(across.places, np.array([-1.0, 1.0]) * (WIDEST * places[-1] + 2.0))
    n = len(along.places), len(across.places)
    column, row = (first, int(low)) if turn > 0 else (n[0] - 1 - first, n[1] - 1 - int(low))
    start = column * abs(along.step) + row * abs(across.step)
    rows, lifts, row_lifts = map(
        np.ascontiguousarray, (across.places[low:high], along.lifts[first:end], across.lifts[low:high])
    )
    return Quadrant(places, rows, lifts, row_lifts, start, along.step, across.step, column, row, turn)


def _sweep_quadrant(ground: Ground, quadrant: Quadrant, level: Level, out: NDArray[np.uint8], threads: int) -> None:
    """Classify the cells of a quadrant, in strips of columns away from the eye, with ever more wedges."""
    along, across, n = quadrant.along, quadrant.across, _FIRST
    wedges = Wedges(np.full(n, -np.inf), np.full(n, -np.inf), np.full(n * RECENT, -np.inf), np.ones(n, np.uint8))
    column = 1
    while column < len(along):
        while _WIDE * n < 2.0 * WIDEST * along[column]:
            n, wedges = 2 * n, wedges.halved()
        widest = _WIDE * n / (2.0 * WIDEST)
        end = min(column + _STRIP, max(int(np.searchsorted(along, widest, "right")), column + 1), len(along))
        step = 2.0 * WIDEST / n
        before = max(along[column - 1], 1e-3)
        first, last = (np.clip(across[[0, -1]] / before, -WIDEST, WIDEST) + WIDEST) / step
        part = Part(column, end, int(first), min(int(last) + 1, n), -WIDEST, step)
        ticket = new_ticket(-(-(part.end_wedge - part.wedge) // WEDGES_AT_A_TIME), 1)
        run(sweep, threads, ticket, ground.z, View(quadrant, level, ground.blocks), out, wedges, part)
        column = end
