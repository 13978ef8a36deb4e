"""Columns of caps: along each of fourteen directions, whether rays from points cross caps an odd number of times.

A look into a table is faster than a ray. Opposite directions share a line. Across each of seven lines, a grid divides
space into columns. Where no open edge of the caps passes through a column above a point, moving the point within the
column changes what its ray upwards crosses only by an even number, unless the point itself passes through a cap. So a
column holds the depths between which points may pass through caps, as a few intervals, and whether one line through it
crosses the caps of each an odd number of times. A last interval holds the open edges: about rays that may pass them,
columns say nothing.

Rounding. A point's column and depth are computed in float32, from coordinates of at most M in magnitude, the largest of
the scene's bounds. Across a line, at most two coordinates and a constant of at most 2 M are multiplied and added: with
u = 2**-24, this takes less than 20 u M. Caps are entered with a margin of ``_MARGIN`` M = 64 u M. Corners are projected
in float64, which moves caps by less than 2**-50 M and leaves them joined, so it changes no parity outside the margin.

Around a cell of points, caps are entered with half its side more, along each axis. Then what its centre meets, or not,
holds for the whole cell.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import bits, get, load16, popcount, ptr, ptr_at, put, splat16, store

AXES, ALL = 6, 14  # directions along the axes, and with the space diagonals
LINES = ALL // 2
AWAY = (ALL - AXES) // 2  # diagonals that lead away from most caps, and vote after the first ray
_MARGIN = 2.0**-18
_MOST_ENTERED = 1 << 23  # columns of all caps of a line, which take a tenth of a second

WORDS = 16  # float32 of a column, a cache line
_STEPS = 6  # intervals; their least depths come first, then their greatest ones, in ascending order; inf: there is none
_LEAST, _GREATEST, _FLIPS = 2 * _STEPS, 2 * _STEPS + 1, 2 * _STEPS + 2  # of open edges; bits of odd intervals
_ALL_STEPS = (1 << _STEPS) - 1
_STEEP = 2.0**-10  # area of a triangle across a line, relative to its extent, from which on its plane is used
_U, _V = 0.513, 0.471  # where the line is in a column; in the middle, it would often meet the diagonals of squares
_ROUNDING = 2.0**-50  # relative, of differences of two products

_AXES = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
_DIAGONALS = np.array(list(product((-1.0, 1.0), repeat=3)), np.float32)


class CapColumns(NamedTuple):
    """Columns of caps along seven lines; a point's coordinates are the rows of `frames` times it, plus `starts`."""

    directions: np.ndarray  # (14, 3) float32 of -1, 0 and 1, in the order of their votes, see `_in_order_of_votes`
    ends: np.ndarray  # (7, 2) int64: the numbers of the two directions of each line
    frames: np.ndarray  # (7, 3, 3) float32: across each line, in columns; and a depth, see `_depth_along`
    starts: np.ndarray  # (7, 3) float32
    depths: np.ndarray  # (7, side, side, WORDS) float32; columns at the rims stay empty


def all_directions(axis: NDArray[np.floating]) -> NDArray[np.float32]:
    """(14, 3): an axis, the other axes, and the diagonals."""
    others = _AXES[(axis != _AXES).any(axis=1)]
    order = np.argsort(-(_DIAGONALS @ axis), kind="stable")  # along the axis first
    return np.concatenate([axis[None], others, _DIAGONALS[order]]).astype(np.float32)


def _in_order_of_votes(directions: NDArray[np.float32]) -> NDArray[np.float32]:
    """(14, 3): of `all_directions`, the first one, diagonals that lead away from caps, other axes, other diagonals."""
    first, axes, diagonals = np.split(directions, [1, AXES])
    return np.concatenate([first, diagonals[:AWAY], axes, diagonals[AWAY:]])


class CapMesh(NamedTuple):
    """Caps, for kernels."""

    corners: np.ndarray  # (n, 3, 3) float32
    rims: np.ndarray  # (m, 2, 3) float32: their open edges


def cap_columns(
    caps: CapMesh,
    axis: NDArray[np.floating],
    box: NDArray[np.float32],
    side: int,
    around: float | NDArray[np.float64] = 0.0,
    threads: int | None = None,
) -> CapColumns:
    """The columns of caps.

    axis : (3,), the first direction
    box : (2, 3), bounds of the points and of the caps
    side : columns along each side of a grid
    around : half the sides of the cells whose centres are looked up, (3,), or one number
    """
    columns = unknown_columns(axis, side)
    margins = np.full(3, max(_MARGIN * float(np.abs(box).max()), 1e-30)) + around
    along = columns.directions[columns.ends[:, 0]]
    axes = np.array([[*_across(each), _depth_along(each, axis)] for each in along], np.float64)
    run(_enter_caps, thread_count(threads), new_ticket(LINES, 1), caps, axes, margins, columns)
    return columns


def unknown_columns(axis: NDArray[np.floating], side: int = 1) -> CapColumns:
    """Columns that say nothing.

    axis : (3,), the first direction
    side : columns along each side of a grid; all points are in the first one
    """
    directions = _in_order_of_votes(all_directions(axis))
    ends = [(k, other) for k in range(ALL) if (other := _opposite(directions, k)) > k]
    depths = np.empty((LINES, side, side, WORDS), np.float32)
    depths[:, 0, 0] = np.inf
    depths[:, 0, 0, [_LEAST, _FLIPS]] = -np.inf, 0.0
    frames, starts = np.zeros((LINES, 3, 3), np.float32), np.zeros((LINES, 3), np.float32)
    return CapColumns(directions, np.array(ends), frames, starts, depths)


def _opposite(directions: NDArray[np.float32], k: int) -> int:
    return int((directions == -directions[k]).all(axis=1).argmax())


def _across(direction: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    """Two vectors across a direction, with up to two components, of 1 and -1."""
    along = np.flatnonzero(direction)
    if len(along) == 1:
        return [row for k, row in enumerate(np.eye(3, dtype=np.float32)) if k != along[0]]
    x, y, z = direction
    return [np.array([x, 0, -z]), np.array([0, y, -z])]


def _depth_along(direction: NDArray[np.float32], axis: NDArray[np.floating]) -> NDArray[np.floating]:
    """The vector whose product with points is their depth along a direction, which must only increase.

    Along diagonals, it is the coordinate along the axis. So caps across the axis, such as below a city, are flat.
    """
    return direction if np.count_nonzero(direction) == 1 else direction * np.abs(axis)


# --- Looking columns up -----------------------------------------------------------------------------------------------


@inlined
def look_up(row, depth):
    """What a column says about the rays from a point: four bits.

    They are whether it knows about the ray along the first direction of its line, and along the second; and whether
    these rays cross caps an odd number of times. row : float32 *, the column; depth : of the point
    """
    below, flips = bits(load16(row, 0) < depth), np.int64(get(row, _FLIPS))
    begun, ended = below & _ALL_STEPS, (below >> _STEPS) & _ALL_STEPS
    behind, all_ = popcount(flips & begun) & 1, popcount(flips) & 1
    known = ((below >> _GREATEST) & 1) | (~(below >> _LEAST) & 1) << 1
    known &= -np.int64(begun == ended)  # otherwise, the point is within an interval
    return known | (((all_ ^ behind) | behind << 1) & known) << 2


# --- Intervals of a column --------------------------------------------------------------------------------------------


@inlined
def _silence(row, low, high):
    """Let a column say nothing about rays that may pass depths from low to high."""
    put(row, _LEAST, min(get(row, _LEAST), np.float32(low)))
    put(row, _GREATEST, max(get(row, _GREATEST), np.float32(high)))


@inlined
def _move(row, n, last, after):
    """Move the intervals of a column, of which it has n, from `last` on to `after` and further."""
    for at in range(2):
        words = ptr_at(row, at * _STEPS)
        if after > last:
            for k in range(n - 1, last - 1, -1):
                put(words, k + after - last, get(words, k))
        else:
            for k in range(last, n):
                put(words, k + after - last, get(words, k))
            for k in range(n + after - last, n):
                put(words, k, np.float32(np.inf))


@inlined
def _insert(row, low, high, odd):
    """Add an interval to a column, joined with those that it meets, or with the nearest one if there are too many.

    odd : whether the caps in it are crossed an odd number of times
    """
    low, high, n = np.float32(low), np.float32(high), np.int64(0)
    while n < _STEPS and get(row, n) < np.inf:
        n += 1
    first = np.int64(0)
    while first < n and get(row, _STEPS + first) < low:
        first += 1
    last = first
    while last < n and get(row, last) <= high:
        last += 1
    if first == last and n == _STEPS:
        if first == n or (first > 0 and low - get(row, _STEPS + first - 1) < get(row, first) - high):
            first -= 1
        last = first + 1
    if last > first:
        low, high = min(low, get(row, first)), max(high, get(row, _STEPS + last - 1))
    flips = np.int64(get(row, _FLIPS))
    joined = (flips >> first) & ((1 << (last - first)) - 1)
    odd = (popcount(joined) + odd) & 1
    rest = flips >> last << (first + 1)
    if last != first + 1:
        _move(row, n, last, first + 1)
    put(row, first, low)
    put(row, _STEPS + first, high)
    put(row, _FLIPS, np.float32((flips & ((1 << first) - 1)) | odd << first | rest))


# --- Columns of one line ----------------------------------------------------------------------------------------------


class _Line(NamedTuple):
    """The columns of a line: how points are projected, and margins."""

    axes: np.ndarray  # (3, 3) float64
    depths: F32Ptr  # float32 *: the columns
    side: int  # columns along each side
    u: float  # least coordinate across the line, minus the margin
    v: float
    u_scale: float  # columns per unit of length
    v_scale: float
    u_reach: float  # margins: in columns, and along the line
    v_reach: float
    depth_reach: float


@inlined
def _place(point, axis):
    return point[0] * axis[0] + point[1] * axis[1] + point[2] * axis[2]


@inlined
def _projected(point, line):
    """(column across a line, column, depth) of a point: float64."""
    u, v = _place(point, line.axes[0]), _place(point, line.axes[1])
    return 1.0 + (u - line.u) * line.u_scale, 1.0 + (v - line.v) * line.v_scale, _place(point, line.axes[2])


@inlined
def _reach(axis, margins):
    return abs(axis[0]) * margins[0] + abs(axis[1]) * margins[1] + abs(axis[2]) * margins[2]


@inlined
def _scale_of(corners, axis, reach, side):
    """(least coordinate of all corners along an axis, with a margin; columns per unit of length)."""
    least, greatest = np.float64(np.inf), np.float64(-np.inf)
    for i in range(len(corners)):
        for k in range(3):
            place = _place(corners[i, k], axis)
            least, greatest = min(least, place), max(greatest, place)
    return least - reach, (side - 2) / (greatest - least + 2.0 * reach)


@inlined
def _line_of(corners, axes, margins, depths, side):
    """The `_Line` of axes, (3, 3)."""
    u_reach, v_reach, reach = _reach(axes[0], margins), _reach(axes[1], margins), _reach(axes[2], margins)
    u, u_scale = _scale_of(corners, axes[0], u_reach, side)
    v, v_scale = _scale_of(corners, axes[1], v_reach, side)
    return _Line(axes, depths, side, u, v, u_scale, v_scale, u_reach * u_scale, v_reach * v_scale, reach)


@inlined
def _row_of(line, u, v):
    """The words of a column."""
    return ptr_at(line.depths, (u * line.side + v) * WORDS)


@inlined
def _columns_of(low, high, reach, line):
    """(first, last) column that a range of coordinates reaches."""
    return max(np.int64(low - reach), 1), min(np.int64(high + reach), line.side - 2)


@inlined
def _part(a, b, low, high):
    """(first, last) parameter, within 0 .. 1, between which a segment from a to b is between low and high.

    The first one is greater where no part is.
    """
    if a == b:
        return np.float64(0.0), np.float64(1.0) if low <= a <= high else np.float64(-1.0)
    s, t = (low - a) / (b - a), (high - a) / (b - a)
    return max(min(s, t), 0.0), min(max(s, t), 1.0)


@inlined
def _range_of_part(a, b, part):
    """(least, greatest) coordinate of a part of a segment from a to b."""
    s, t = a + (b - a) * part[0], a + (b - a) * part[1]
    return min(s, t), max(s, t)


@inlined
def _enter_rim(rim, line):
    """Enter an open edge into the columns that it passes."""
    (a_u, a_v, a), (b_u, b_v, b) = _projected(rim[0], line), _projected(rim[1], line)
    u0, u1 = _columns_of(min(a_u, b_u), max(a_u, b_u), line.u_reach, line)
    for u in range(u0, u1 + 1):
        part = _part(a_u, b_u, u - line.u_reach, u + 1 + line.u_reach)
        if part[0] > part[1]:
            continue
        low, high = _range_of_part(a_v, b_v, part)
        v0, v1 = _columns_of(low, high, line.v_reach, line)
        for v in range(v0, v1 + 1):
            other = _part(a_v, b_v, v - line.v_reach, v + 1 + line.v_reach)
            within = max(part[0], other[0]), min(part[1], other[1])
            if within[0] <= within[1]:
                low, high = _range_of_part(a, b, within)
                _silence(_row_of(line, u, v), low - line.depth_reach, high + line.depth_reach)


@inlined
def _side(a, b, u, v):
    """On which side of the line from a to b, in columns, a point is: 1 or -1; 0: float64 cannot decide."""
    p, q = (a[0] - u) * (b[1] - v), (a[1] - v) * (b[0] - u)
    error = _ROUNDING * (abs(p) + abs(q))
    return (p - q > error) - (q - p > error)


class _Slope(NamedTuple):
    """The plane of a triangle over columns, and the depths of its corners."""

    u: float  # depth per column
    v: float
    half: float  # greatest distance of the plane in a column, with its margin, from the middle; inf: it is steep
    least: float
    greatest: float


@inlined
def _slope_of(a, b, c, line):
    """The `_Slope` of a triangle."""
    b_u, b_v, b_d, c_u, c_v, c_d = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
    area, least, greatest = b_u * c_v - b_v * c_u, min(a[2], b[2], c[2]), max(a[2], b[2], c[2])
    extent = max(abs(b_u), abs(b_v)) + max(abs(c_u), abs(c_v))
    if abs(area) <= _STEEP * extent * extent:
        return _Slope(0.0, 0.0, np.float64(np.inf), least, greatest)
    u, v = (b_d * c_v - c_d * b_v) / area, (c_d * b_u - b_d * c_u) / area
    half = abs(u) * (0.5 + line.u_reach) + abs(v) * (0.5 + line.v_reach)
    return _Slope(u, v, half, least, greatest)


@inlined
def _enter_column(triangle, slope, line, u, v):
    """Enter a triangle into a column."""
    a, b, c = triangle
    middle = a[2] + (u + 0.5 - a[0]) * slope.u + (v + 0.5 - a[1]) * slope.v
    low = max(middle - slope.half, slope.least) - line.depth_reach
    high = min(middle + slope.half, slope.greatest) + line.depth_reach
    if low > high:
        return
    row = _row_of(line, u, v)
    sides = _side(a, b, u + _U, v + _V), _side(b, c, u + _U, v + _V), _side(c, a, u + _U, v + _V)
    least, greatest = min(sides[0], sides[1], sides[2]), max(sides[0], sides[1], sides[2])
    if least * greatest == 0 or (high >= get(row, _LEAST) and low <= get(row, _GREATEST)):
        _silence(row, low, high)
    else:
        _insert(row, low, high, np.int64(least == greatest))


@inlined
def _range_between(a, b, low, high):
    """(least, greatest) second coordinate of a segment where the first one is between low and high.

    (inf, -inf): it is not.
    """
    part = _part(a[0], b[0], low, high)
    if part[0] > part[1]:
        return np.float64(np.inf), np.float64(-np.inf)
    return _range_of_part(a[1], b[1], part)


@inlined
def _range_across(a, b, c, low, high):
    """`_range_between`, of a triangle."""
    p, q, r = _range_between(a, b, low, high), _range_between(b, c, low, high), _range_between(c, a, low, high)
    return min(p[0], q[0], r[0]), max(p[1], q[1], r[1])


@inlined
def _enter_cap(corners, line):
    """Enter a triangle into the columns that it meets. Return how many these are."""
    a, b, c = _projected(corners[0], line), _projected(corners[1], line), _projected(corners[2], line)
    slope, entered = _slope_of(a, b, c, line), np.int64(0)
    u0, u1 = _columns_of(min(a[0], b[0], c[0]), max(a[0], b[0], c[0]), line.u_reach, line)
    for u in range(u0, u1 + 1):
        low, high = _range_across(a, b, c, u - line.u_reach, u + 1 + line.u_reach)
        if low <= high:
            v0, v1 = _columns_of(low, high, line.v_reach, line)
            entered += v1 - v0 + 1
            for v in range(v0, v1 + 1):
                _enter_column((a, b, c), slope, line, u, v)
    return entered


@inlined
def _clear(line, least, greatest):
    """Empty all columns, except for an interval of open edges."""
    nothing = splat16(np.float32(np.inf))
    for at in range(0, line.side * line.side * WORDS, WORDS):
        store(line.depths, at, nothing)
        put(line.depths, at + _LEAST, least)
        put(line.depths, at + _GREATEST, greatest)
        put(line.depths, at + _FLIPS, np.float32(0.0))


@kernel
def _enter_caps(ticket, caps, axes, margins, out):
    """Worker: fill the columns of a line. If too many are entered, none of them says anything."""
    # In: caps (`CapMesh`), axes (LINES, 3, 3) float64, margins (3,) float64. Out: out (`CapColumns`)
    nothing, side = np.float32(np.inf), out.depths.shape[1]
    for number in items(ticket):
        depths = ptr_at(ptr(out.depths), number * side * side * WORDS)
        line, entered = _line_of(caps.corners, axes[number], margins, depths, side), np.int64(0)
        for k in range(3):
            out.frames[number, 0, k] = line.axes[0, k] * line.u_scale
            out.frames[number, 1, k] = line.axes[1, k] * line.v_scale
            out.frames[number, 2, k] = line.axes[2, k]
        out.starts[number, 0], out.starts[number, 1] = 1.0 - line.u * line.u_scale, 1.0 - line.v * line.v_scale
        _clear(line, nothing, -nothing)
        for i in range(len(caps.rims)):
            _enter_rim(caps.rims[i], line)
        for i in range(len(caps.corners)):
            entered += _enter_cap(caps.corners[i], line)
            if entered > _MOST_ENTERED:
                _clear(line, -nothing, nothing)
                break
