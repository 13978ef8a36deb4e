"""Stencils of parallel rays over terrain: which edges the rays towards a distant light cross, from any vertex.

Parallel rays from the vertices of an even grid cross its edges at the same offsets, weights and rises. One list, the
stencil, therefore serves all vertices. Over a heightfield, a ray is decided by the heights at these crossings alone:
between them, its height above the surface is linear.

Two quantities differ from the even grid. Vertices are rounded to float32, by which the surface moves sideways by at
most `Relief.shift` squares; and the far end of each segment is rounded, by which the ray deviates in proportion to its
length. Both are bounded here, times the steepest edge, so that a comparison outside the tolerance is certain for the
exact float32 segment and the exact float32 triangles (docs/design/terrain.md).
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .terrain_rays import TerrainTree

LANES = 16
ROW_PAD, COLUMN_PAD = 4, 20  # around the heights: rays are followed until they are a square or two outside
NO_SURFACE = np.float32(-1e30)
BLOCKS = 8, 32  # cells along the side of a block of each level of `Relief.tops`; rays skip twice as many steps
_UNIT = 2.0**-23  # twice the relative error of rounding to float32
_ARITHMETIC = 2.0**-20  # relative error of the kernel's float32 arithmetic, with a margin
_MOST_SHIFT = 2.0**-6  # squares, beyond which vertices are too coarse for stencils
_SAME = 1e-9  # steps: crossings this close to a receiver are the receiver's vertex

# --- Heights for lanes ------------------------------------------------------------------------------------------------


class Relief(NamedTuple):
    """The heights of a `TerrainTree` with a border, for kernels that read 16 neighbours of a row at once."""

    high: NDArray[np.float32]  # (rows + 8, columns + 40): NO_SURFACE off the surface, whose border is one square wider
    low: NDArray[np.float32]  # likewise, NO_SURFACE also at vertices that lack one of their six triangles
    tops: NDArray[np.float32]  # greatest heights that rays may reach from each block, by quadrant and level
    starts: NDArray[np.int64]  # (8,) first number of 4 quadrants x 2 levels in `tops`
    widths: NDArray[np.int64]  # (2,) blocks per row
    whole: int  # 1: there are no holes
    steepest: float  # greatest difference of neighbouring heights
    shift: float  # squares: greatest difference of a vertex from the even grid
    holes: NDArray[np.uint8]  # as `tops`: whether vertices, or triangles beside them, may be missing there
    bordered: int  # 1: `high` and `low` are those of the tree, which has the border, and `holes` is not empty


def shift_of(tree: TerrainTree) -> float:
    """The field `shift` of a `Relief`."""
    columns = (tree.x.astype(np.float64) - tree.west) * tree.per_x - np.arange(len(tree.x))
    rows = (tree.north - tree.y.astype(np.float64)) * tree.per_y - np.arange(len(tree.y))
    return float(max(np.abs(columns).max(), np.abs(rows).max())) + 1e-12


def relief_of(tree: TerrainTree) -> Relief:
    """The `Relief` of a surface."""
    holes = np.pad(np.isnan(tree.z), ((ROW_PAD, ROW_PAD), (COLUMN_PAD, COLUMN_PAD)), constant_values=True)
    high = np.pad(tree.z, ((ROW_PAD, ROW_PAD), (COLUMN_PAD, COLUMN_PAD)), constant_values=NO_SURFACE)
    high[holes] = NO_SURFACE
    low = np.where(_lacks_triangle(holes), NO_SURFACE, high)
    _widen(high, holes)
    tops = reached([block_maxima(high, side) for side in BLOCKS])
    whole = int(not np.isnan(tree.z).any())
    return Relief(high, low, *tops, whole, _steepest(high), shift_of(tree), np.empty(0, np.uint8), 0)


def _lacks_triangle(holes: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether any of the six neighbours that share a triangle with a vertex, or the vertex itself, is a hole."""
    out = holes.copy()
    out[1:] |= holes[:-1]
    out[:-1] |= holes[1:]
    out[:, 1:] |= holes[:, :-1]
    out[:, :-1] |= holes[:, 1:]
    out[1:, 1:] |= holes[:-1, :-1]
    out[:-1, :-1] |= holes[1:, 1:]
    return out


def _widen(high: NDArray[np.float32], holes: NDArray[np.bool_]) -> None:
    """Give holes beside the surface the greatest height of their neighbours, since rounding moves its border."""
    rows, columns = np.nonzero(holes[1:-1, 1:-1])
    greatest = np.full(len(rows), NO_SURFACE)
    for i in range(3):
        for j in range(3):
            np.maximum(greatest, high[rows + i, columns + j], out=greatest)
    high[rows + 1, columns + 1] = greatest


def _steepest(high: NDArray[np.float32]) -> float:
    """The greatest difference of heights along a side of a square."""
    most = 0.0
    for a, b in ((high[1:], high[:-1]), (high[:, 1:], high[:, :-1])):
        there = (a > NO_SURFACE) & (b > NO_SURFACE)
        most = max(most, float(np.abs(a - b).max(initial=0.0, where=there)))
    return most


def reached(blocks: list[NDArray[Any]]) -> tuple[NDArray[Any], NDArray[np.int64], NDArray[np.int64]]:
    """The greatest values that rays may reach from each block; `starts` and `widths` of a `Relief`.

    blocks : of each level of `BLOCKS`, the greatest value of each block
    """
    tables = list[np.ndarray]()
    for quadrant in range(4):
        # From a block b, a ray of 2 x side steps, 16 lanes wide, reaches these blocks before and after b.
        above, below = (3, 1) if quadrant & 1 else (1, 3)
        before, after = (3, 2) if quadrant & 2 else (1, 4)
        tables += [_dilated(_dilated(each, above, below, 0), before, after, 1) for each in blocks]
    widths = [each.shape[1] for each in blocks]
    starts = np.cumsum([0, *(each.size for each in tables[:-1])])
    return np.concatenate([each.reshape(-1) for each in tables]), starts.astype(np.int64), np.array(widths, np.int64)


def block_maxima(high: NDArray[Any], side: int) -> NDArray[Any]:
    """(rows, columns): the greatest value of each block of side x side cells."""
    rows, columns = (np.arange(0, n, side) for n in high.shape)
    out: NDArray[Any] = np.maximum.reduceat(np.maximum.reduceat(high, columns, axis=1), rows, axis=0)
    return out


def _dilated(blocks: NDArray[Any], before: int, after: int, axis: int) -> NDArray[Any]:
    """The greatest of the blocks from `before` before to `after` after each one along an axis."""
    out, n = blocks.copy(), blocks.shape[axis]
    for k in range(-before, after + 1):
        there = [slice(None), slice(None)]
        here = [slice(None), slice(None)]
        there[axis], here[axis] = slice(max(k, 0), n + min(k, 0)), slice(max(-k, 0), n - max(k, 0))
        if n > abs(k):
            np.maximum(out[tuple(here)], blocks[tuple(there)], out=out[tuple(here)])
    return out


# --- Stencils ---------------------------------------------------------------------------------------------------------


class Stencils(NamedTuple):
    """The stencils of several directions. A step is a column or row of squares, whichever the ray crosses more of.

    Direction s has the steps ``steps[s]`` to ``steps[s + 1]``, exclusive, and step k the crossings ``first[k]`` to
    ``first[k + 1]``. A direction without steps has no stencil. Heights are relative to the receiver.
    """

    steps: NDArray[np.int64]  # (directions + 1,)
    quadrant: NDArray[np.int64]  # (directions,) bit 0: towards row 0, bit 1: towards column 0
    per_step: NDArray[np.float64]  # (directions, 2) columns and rows per step
    place: NDArray[np.int32]  # (steps, 2) whole columns and rows from the receiver, rounded down
    rise: NDArray[np.float32]  # (steps,) of the ray when the step begins, less the tolerance
    first: NDArray[np.int64]  # (steps + 1,)
    ends: NDArray[np.int32]  # (crossings, 2) ends of the edge, as offsets in the arrays of a `Relief`
    weights: NDArray[np.float32]  # (crossings, 2) of the ends
    above: NDArray[np.float32]  # (crossings,) a ray with this rise that is above the edge certainly passes it
    below: NDArray[np.float32]  # (crossings,) a ray with this rise that is below the edge is certainly below ground


class _Stencil(NamedTuple):
    """The stencil of a direction, as in `Stencils`."""

    quadrant: int
    per_step: tuple[float, float]
    place: NDArray[np.int32]
    rise: NDArray[np.float32]
    counts: NDArray[np.int64]
    ends: NDArray[np.int32]
    weights: NDArray[np.float32]
    above: NDArray[np.float32]
    below: NDArray[np.float32]


def stencils_of(tree: TerrainTree, relief: Relief, offsets: NDArray[np.float64]) -> Stencils | None:
    """The stencils of segments that end at the receiver plus an offset each, (n, 3).

    None if none has one, or if float32 moves the vertices too far from an even grid.
    """
    if relief.shift > _MOST_SHIFT:
        return None
    each = [_stencil(tree, relief, offset) for offset in offsets]
    there = [one for one in each if one is not None]
    if not there:
        return None
    steps = np.cumsum([0, *(0 if one is None else len(one.rise) for one in each)])
    counts = np.concatenate([one.counts for one in there])
    return Stencils(
        steps.astype(np.int64), np.array([0 if one is None else one.quadrant for one in each], np.int64),
        np.array([(0.0, 0.0) if one is None else one.per_step for one in each]),
        np.concatenate([one.place for one in there]), np.concatenate([one.rise for one in there]),
        np.append(0, np.cumsum(counts)).astype(np.int64), np.concatenate([one.ends for one in there]),
        np.concatenate([one.weights for one in there]), np.concatenate([one.above for one in there]),
        np.concatenate([one.below for one in there]),
    )  # fmt: skip


def _stencil(tree: TerrainTree, relief: Relief, offset: NDArray[np.float64]) -> _Stencil | None:
    """The stencil of a segment; None if it does not rise clearly, or is too steep."""
    du, dv, dz = float(offset[0]) * tree.per_x, -float(offset[1]) * tree.per_y, float(offset[2])
    along = max(abs(du), abs(dv))  # squares
    far = float(np.abs(offset).max() + max(np.abs(tree.x).max(), np.abs(tree.y).max(), 4.0 * tree.reach))
    sideways = _UNIT * far * (tree.per_x + tree.per_y)
    if not (dz > 2.0**-12 * far and along > 2.0**10 * sideways):
        return None
    rise = dz / along
    per_step = (_UNIT * far + relief.steepest * sideways) / along + _ARITHMETIC * rise
    if per_step > rise / 8.0:
        return None
    tolerance = 4.0 * relief.steepest * relief.shift + _ARITHMETIC * (5.0 * tree.reach + relief.steepest)
    height = tree.highest + 4.0 * tree.reach  # receivers are higher than -4 reach
    count = int(min(max(tree.z.shape) + LANES, height / rise + 2.0))
    by_columns = abs(du) >= abs(dv)
    slope = (dv if by_columns else du) / along
    k, crossings = np.arange(count), _crossings(count, slope, (du if by_columns else dv) > 0.0)
    at = crossings.at
    lift = 2.0 * (tolerance + per_step * at)
    start = rise * k - 2.0 * (tolerance + per_step * k)
    sign = 1 if (du if by_columns else dv) > 0.0 else -1
    major, minor = sign * k, np.floor(slope * k).astype(np.int64)
    place = np.stack([major, minor] if by_columns else [minor, major], 1).astype(np.int32)
    stride = relief.high.shape[1]
    strides = (sign, stride) if by_columns else (sign * stride, 1)
    ends = crossings.ends @ np.array(strides)
    if ends.size and max(int(ends.max()), -int(ends.min())) > np.iinfo(np.int32).max:  # of a grid beyond 2^31 cells
        return None
    return _Stencil(
        int(dv < 0.0) | int(du < 0.0) << 1, (du / along, dv / along), place, start.astype(np.float32),
        np.bincount(crossings.step, minlength=count), ends.astype(np.int32), crossings.weights.astype(np.float32),
        (rise * at - lift).astype(np.float32), (rise * at + lift).astype(np.float32),
    )  # fmt: skip


class _Crossings(NamedTuple):
    """The crossings of a ray from (0, 0) with the edges of the unit grid, in order of steps."""

    step: NDArray[np.int64]  # (n,)
    at: NDArray[np.float64]  # (n,) steps along the ray
    ends: NDArray[np.int64]  # (n, 2, 2): of the edge: steps and minor coordinate
    weights: NDArray[np.float64]  # (n, 2)


def _crossings(count: int, slope: float, main: bool) -> _Crossings:
    """The crossings of the ray along the major axis with a minor slope of -1 to 1.

    main : whether diagonals ascend along both axes; otherwise they descend along the minor axis
    """
    k = np.arange(count)
    y = slope * k
    m = np.floor(y).astype(np.int64)
    f = y - m
    parts = [_part(k, np.zeros(count), (0, m), (0, m + 1), f, k > 0)]
    with np.errstate(divide="ignore", invalid="ignore"):
        for r in (m, m + 1):  # lines between steps
            t = (r - y) / slope
            parts.append(_part(k, t, (0, r), (1, r), t, (t >= 0.0) & (t <= 1.0)))
        for r in (m - 1, m, m + 1):  # diagonals of the squares from r to r + 1
            t = (y - r) / (1.0 - slope) if main else (1.0 + r - y) / (1.0 + slope)
            inside = (t >= 0.0) & (t <= 1.0)
            first, last = (r, r + 1) if main else (r + 1, r)
            parts.append(_part(k, t, (0, first), (1, last), t, inside))
    step, at, ends, weights = (np.concatenate(each) for each in zip(*parts))
    order = np.lexsort((at, step))
    return _Crossings(step[order], at[order], ends[order], weights[order])


def _part(
    k: NDArray[np.int64], t: NDArray[np.float64], first: tuple[int, NDArray[np.int64]],
    last: tuple[int, NDArray[np.int64]], share: NDArray[np.float64], there: NDArray[np.bool_],
) -> _Crossings:  # fmt: skip
    """The crossings of one kind, where they are `there`; `share`: weight of the last end."""
    there = there & (k + t > _SAME)
    k, t, share = k[there], t[there], share[there]
    ends = np.stack([np.stack([k + s, row[there]], 1) for s, row in (first, last)], 1)
    return _Crossings(k, k + t, ends, np.stack([1.0 - share, share], 1))
