"""Views over terrain: which cells an eye surely sees, and which it surely does not, in one sweep away from the eye.

The grid is divided into four quadrants by the diagonals through the eye, and each into fans of narrow wedges. A wedge
carries two slopes outwards, column by column: the greatest at which any surface in it crosses the plane through the eye
(``upper``), and the greatest that the surface reaches all across it (``lower``). A cell below ``lower`` is hidden. A
cell above ``upper`` is seen if its own line of sight passes the last few columns, which ``upper`` does not include yet.
The other cells, a few per cent, follow their own line towards the eye and skip blocks of cells below it.

Slopes are computed in float64 from the float32 vertices, and all comparisons leave a tolerance for the arithmetic. A
cell whose slope lies within it remains undecided, and exact lines of sight decide it (docs/design/terrain.md). So do
cells beyond holes through which a line of sight may have passed below the surface.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, F64Ptr, I64Ptr, U8Ptr, inlined, kernel
from ...kernels.parallel import items
from ...kernels.simd import get, ptr, put, stack_f32
from ...query.receivers import SHIFT
from .terrain_rays import meets_square, terrain_pointers

HIDDEN, SEEN, UNDECIDED = 0, 1, 2

RECENT = 6  # columns before a cell in which its own line of sight is followed
_NEAREST = 8.0  # cells: nearer ones are followed to the eye, since columns there are wide
WEDGES_AT_A_TIME = 64  # that a thread takes at a time
LEVELS = 6, 3  # binary logarithms of the sides of blocks, whose greatest heights are known
_CLOSE = 2.0**-20  # cells: lines of sight this close to a vertex may meet it
_NONE = np.float64(-np.inf)


class Blocks(NamedTuple):
    """The greatest heights of blocks of cells, level by level in the order of `LEVELS`; -inf: no height."""

    tops: NDArray[np.float32]
    holes: NDArray[np.uint8]  # whether a block has cells without a height
    starts: NDArray[np.int64]  # (levels,)
    widths: NDArray[np.int64]  # (levels,) blocks per row


class Quadrant(NamedTuple):
    """The cells of a quadrant, along axes turned so that both ascend away from its first corner.

    Cell (m, n) has the height ``z[start + m * per_along + n * per_across]``.
    """

    along: NDArray[np.float64]  # (m,) cells from the eye; the first one lies at the eye or behind it
    across: NDArray[np.float64]  # (n,)
    far_along: NDArray[np.float64]  # (m,) `SHIFT` times the magnitude of the coordinate, as of receivers
    far_across: NDArray[np.float64]
    start: int
    per_along: int
    per_across: int
    column: int  # of cell (0, 0) along `along` and `across`, and its steps, in blocks
    row: int
    turn: int


class Level(NamedTuple):
    """What does not depend on the quadrant."""

    eye: float  # height
    height: float  # of the sensors above the cells
    lift: float  # greatest one of receivers
    slack: float  # by which sensors may be higher or lower
    sure: float  # tolerance of heights of the surface
    whole: int  # 1: no cell lacks a height


class View(NamedTuple):
    """A quadrant of the ground, as an eye sees it."""

    quadrant: Quadrant
    level: Level
    blocks: Blocks


class _Pointers(NamedTuple):
    """Pointers to all of these, free of reference counts."""

    z: F32Ptr
    along: F64Ptr
    across: F64Ptr
    far_along: F64Ptr
    far_across: F64Ptr
    tops: F32Ptr
    holes: U8Ptr
    starts: I64Ptr
    widths: I64Ptr
    out: U8Ptr
    columns: int
    rows: int
    start: int
    per_along: int
    per_across: int
    column: int
    row: int
    turn: int
    by_columns: int
    eye: float
    height: float
    lift: float
    slack: float
    sure: float
    whole: int


@inlined
def _pointers(z, view, out):
    quadrant, level, blocks = view
    return _Pointers(
        ptr(z), ptr(quadrant.along), ptr(quadrant.across), ptr(quadrant.far_along), ptr(quadrant.far_across),
        ptr(blocks.tops), ptr(blocks.holes), ptr(blocks.starts), ptr(blocks.widths), ptr(out),
        np.int64(len(quadrant.along)), np.int64(len(quadrant.across)), np.int64(quadrant.start),
        np.int64(quadrant.per_along), np.int64(quadrant.per_across), np.int64(quadrant.column),
        np.int64(quadrant.row), np.int64(quadrant.turn), np.int64(abs(quadrant.per_along) == 1),
        level.eye, level.height, level.lift, level.slack, level.sure, np.int64(level.whole),
    )  # fmt: skip


@inlined
def _z(v, m, n):
    return np.float64(get(v.z, v.start + m * v.per_along + n * v.per_across))


@inlined
def _from(v, y):
    """The first row at or beyond a place; `v.rows`: there is none."""
    n = min(max(np.int64(np.ceil(min(max(y - get(v.across, 0), np.float64(-1.0)), np.float64(v.rows)))), 0), v.rows)
    while n > 0 and get(v.across, n - 1) >= y:
        n -= 1
    while n < v.rows and get(v.across, n) < y:
        n += 1
    return n


# --- Slopes of the surface along a line of sight ----------------------------------------------------------------------


class _Slopes(NamedTuple):
    """The greatest slopes of a part of the surface: with the tolerance above it, and below it. -inf: no surface."""

    over: float
    under: float
    solid: int  # whether no height is missing


@inlined
def _joined(v, a, height, x):
    """The greatest of slopes and that of a height at a distance; NaN: there is none."""
    over, under = (height + v.sure - v.eye) / x, (height - v.sure - v.eye) / x
    solid = a.solid if height == height else np.int64(0)
    return _Slopes(over if over > a.over else a.over, under if under > a.under else a.under, solid)


@inlined
def _on_edge(a, b, t):
    """The height at a part t of an edge between two heights. Where one is missing, only the other end is there."""
    if a != a:
        return b if t > 1.0 - _CLOSE else a
    if b != b:
        return a if t < _CLOSE else b
    return a + t * (b - a)


@inlined
def _on_column(v, m, y, n):
    """The height of the surface at a place of column m; NaN outside. n: `_from` of the place."""
    if n >= v.rows:
        return np.float64(np.nan)
    last, z = get(v.across, n), _z(v, m, n)
    if n == 0:
        return z if last == y else np.float64(np.nan)
    first, before = get(v.across, n - 1), _z(v, m, n - 1)
    return _on_edge(before, z, (y - first) / (last - first))


@inlined
def _between(v, m, s, y, ends):
    """The `_Slopes` of a line of the slope s in plan, between columns m - 1 and m.

    y : places on both
    ends : `_from` of these
    """
    found, x, wide = _Slopes(_NONE, _NONE, np.int64(1)), get(v.along, m - 1), get(v.along, m) - get(v.along, m - 1)
    low, high = min(ends[0], ends[1]), max(ends[0], ends[1])
    for n in range(max(low - 1, 0), min(max(high, 1), v.rows)):
        near, far, place = _z(v, m - 1, n), _z(v, m, n), get(v.across, n)
        if n + 1 < v.rows:
            side = get(v.across, n + 1) - place
            corner, steep = _z(v, m, n + 1), side - s * wide
            t = (y[0] - place) / steep if abs(steep) > 1e-300 else np.float64(-1.0)
            if 0.0 <= t <= 1.0 and x + t * wide > 0.0:
                found = _joined(v, found, _on_edge(near, corner, t), x + t * wide)
            if v.whole == 0 and not (abs(near + far + corner + _z(v, m - 1, n + 1)) < np.inf):
                found = _Slopes(found.over, found.under, np.int64(0))
        if n >= low:
            t = (place - y[0]) / (y[1] - y[0]) if y[1] != y[0] else np.float64(-1.0)
            if 0.0 <= t <= 1.0 and x + t * wide > 0.0:
                found = _joined(v, found, _on_edge(near, far, t), x + t * wide)
    return found


# --- Cells ------------------------------------------------------------------------------------------------------------


@inlined
def _cell_slopes(v, m, n):
    """The lowest and the highest slope at which the sensor of a cell may lie; NaN: it may lie in the ground."""
    z, x = _z(v, m, n) + v.height, get(v.along, m)
    lift = max(max(get(v.far_along, m), get(v.far_across, n)), SHIFT * abs(z))
    if not v.height + lift > v.slack + v.sure:
        return np.float64(np.nan), np.float64(np.nan)
    return (z + lift - v.slack - v.eye) / x, (z + lift + v.slack - v.eye) / x


@inlined
def _strip(v, m, s, at_cell):
    """The `_Slopes` between columns m - 1 and m, and on column m unless the line begins there."""
    y = s * get(v.along, m - 1), s * get(v.along, m)
    ends = _from(v, y[0]), _from(v, y[1])
    found = _between(v, m, s, y, ends)
    return found if at_cell else _joined(v, found, _on_column(v, m, y[1], ends[1]), get(v.along, m))


@inlined
def _passes_recent(v, m, n, lowest):
    """Whether the line of sight of a cell surely passes above the surface in the last columns."""
    s = get(v.across, n) / get(v.along, m)
    for k in range(min(RECENT, m)):
        if not lowest > _strip(v, m - k, s, k == 0).over:
            return False
    return True


@inlined
def _top_of(v, columns, rows, level):
    """The greatest height of all blocks that have cells in a part of a quadrant, and whether holes are there.

    columns, rows : (first, last) of the part
    level : its index, and the binary logarithm of its side
    """
    index, shift = level
    along_a, along_b = v.column + v.turn * columns[0], v.column + v.turn * columns[1]
    across_a, across_b = v.row + v.turn * rows[0], v.row + v.turn * rows[1]
    along_low, along_high = min(along_a, along_b) >> shift, max(along_a, along_b) >> shift
    across_low, across_high = min(across_a, across_b) >> shift, max(across_a, across_b) >> shift
    start, width = get(v.starts, index), get(v.widths, index)
    top, holes = np.float32(-np.inf), np.int64(0)
    for i in range(along_low, along_high + 1):
        for j in range(across_low, across_high + 1):
            at = start + (j * width + i if v.by_columns != 0 else i * width + j)
            top = max(top, get(v.tops, at))
            holes |= np.int64(get(v.holes, at))
    return np.float64(top), holes


@inlined
def _rows_between(v, low, high):
    """The first and the last row of all edges between two places."""
    first = np.int64(np.floor(low - get(v.across, 0))) - 1
    last = np.int64(np.ceil(high - get(v.across, 0))) + 1
    return min(max(first, 0), v.rows - 1), max(min(last, v.rows - 1), 0)


@inlined
def _block_top(v, m, s, level):
    """`_top_of` the blocks that a line of sight meets in the columns before m, and the last of these columns."""
    end = max(m - (np.int64(1) << level[1]), 0)
    a, b = s * get(v.along, m), s * get(v.along, end)
    top, holes = _top_of(v, (end, m), _rows_between(v, min(a, b), max(a, b)), level)
    return top, holes, end


@kernel
def _follow(v, m, n):
    """What is certain of cell (m, n), whose line of sight is followed to the eye. v: `_Pointers`."""
    x, s = get(v.along, m), get(v.across, n) / get(v.along, m)
    low, high = _cell_slopes(v, m, n)
    if not low <= high:
        return UNDECIDED
    clear, solid, k, steps = True, True, m, 0
    while k > 0:
        if steps >= RECENT:
            skipped = False
            for index in range(2):
                shift = LEVELS[0] if index == 0 else LEVELS[1]
                top, holes, end = _block_top(v, k, s, (index, shift))
                nearest = max(get(v.along, end), np.float64(0.0)) if low > 0.0 else get(v.along, k)
                if low * nearest + v.eye > top + v.sure:
                    k, skipped = end, True
                    solid = solid and holes == 0
                    break
            if skipped:
                continue
            steps = 0
        part = _strip(v, k, s, k == m)
        solid = solid and part.solid != 0
        if part.over >= low:
            clear = False
            if part.under > high and solid:
                return HIDDEN
        k, steps = k - 1, steps + 1
    return SEEN if clear and x > 0.0 else UNDECIDED


@inlined
def _meets_strip(v, surface, ray, corners, m, s):
    """Whether a segment meets a triangle between columns m - 1 and m; exact."""
    a, b = _from(v, s * get(v.along, m - 1)), _from(v, s * get(v.along, m))
    along = v.column + (v.turn * m if v.turn < 0 else m - 1)
    for n in range(max(min(a, b) - 2, 0), min(max(a, b) + 2, v.rows - 1)):
        across = v.row + (v.turn * (n + 1) if v.turn < 0 else n)
        i, j = (across, along) if v.by_columns != 0 else (along, across)
        if meets_square(surface, ray, corners, i, j, 0):
            return True
    return False


@inlined
def _is_met(v, surface, ray, corners, m, n):
    """Whether the surface meets the segment from the sensor of a cell to the eye; exact."""
    s, k, steps, slope = get(v.across, n) / get(v.along, m), m, 0, (ray.oz - v.eye) / get(v.along, m)
    while k > 0:
        if steps >= RECENT:
            top, _, end = _block_top(v, k, s, (1, LEVELS[1]))
            nearest = max(get(v.along, end), np.float64(0.0)) if slope > 0.0 else get(v.along, k)
            if slope * nearest + v.eye > top + v.sure:
                k = end
                continue
            steps = 0
        if _meets_strip(v, surface, ray, corners, k, s):
            return True
        k, steps = k - 1, steps + 1
    return False


@kernel
def decide(ticket, tree, view, cells, points, eye, seen):
    """Worker: decide sensors."""
    # In: tree: of the terrain; view: `View`; cells, (k, 2) along and across the quadrant; points, (k, 3) their sensors;
    #     eye, (3,)
    # Out: seen, (k,) uint8: whether the eye sees them
    v, surface, corners = _pointers(tree.z, view, seen), terrain_pointers(tree), stack_f32(18)
    for i in items(ticket):
        ray = segment(points[i, 0], points[i, 1], points[i, 2], eye[0], eye[1], eye[2])
        seen[i] = np.uint8(not _is_met(v, surface, ray, corners, cells[i, 0], cells[i, 1]))


# --- Wedges -----------------------------------------------------------------------------------------------------------


@inlined
def _classify(v, m, n, lower, upper):
    """What is certain of a cell, by the slopes of its wedge."""
    low, high = _cell_slopes(v, m, n)
    if get(v.along, m) >= _NEAREST:
        if high < lower:
            return HIDDEN
        if low > upper and _passes_recent(v, m, n, low):
            return SEEN
    return _follow(v, m, n)


class _Side(NamedTuple):
    """The side of a wedge at a column."""

    ends: tuple[int, int]  # `_from` on the column before, and on this one
    height: float  # of the surface on the column
    slopes: _Slopes


@inlined
def _side(v, m, s):
    y = s * get(v.along, m - 1), s * get(v.along, m)
    ends = _from(v, y[0]), _from(v, y[1])
    return _Side(ends, _on_column(v, m, y[1], ends[1]), _between(v, m, s, y, ends))


@inlined
def _widen_wedge(v, m, left, right, wedge):
    """Classify the cells of a wedge on a column, and add the column to its slopes.

    wedge : pointers to its lower and upper slopes, those of recent columns, whether it is solid; and its index
    """
    lower, upper, recent, solid, b = wedge
    slot, x = b * RECENT + m % RECENT, get(v.along, m)
    put(upper, b, max(get(upper, b), get(recent, slot)))
    least, most = min(left.height, right.height), max(left.height, right.height)
    if left.height != left.height or right.height != right.height:
        least, most = np.float64(np.nan), left.height if right.height != right.height else right.height
    top, missing = max(left.slopes.over, right.slopes.over), left.height != left.height or right.height != right.height
    for n in range(left.ends[1], right.ends[1]):
        z = _z(v, m, n)
        at = v.start + m * v.per_along + n * v.per_across
        put(v.out, at, np.uint8(_classify(v, m, n, get(lower, b), get(upper, b)) if z == z else UNDECIDED))
        missing = missing or z != z
        least = z if z < least else least
        top = max(top, (z + v.sure - v.eye) / x) if z == z else top
    if most == most:
        top = max(top, (most + v.sure - v.eye) / x)
    put(recent, slot, top)
    if left.slopes.solid == 0 or right.slopes.solid == 0 or missing:
        put(solid, b, np.uint8(0))
    if get(solid, b) != 0 and least == least:
        put(lower, b, max(get(lower, b), (least - v.sure - v.eye) / x))


class Wedges(NamedTuple):
    """The wedges of a quadrant, from one side to the other."""

    lower: NDArray[np.float64]  # (wedges,) slope that the surface reaches all across, in columns so far; -inf: none
    upper: NDArray[np.float64]  # (wedges,) greatest slope, without recent columns
    recent: NDArray[np.float64]  # (wedges * RECENT,) greatest slopes of recent columns
    solid: NDArray[np.uint8]  # (wedges,) whether no height was missing so far

    def halved(self) -> "Wedges":
        """Two wedges for each one."""
        recent = np.repeat(self.recent.reshape(-1, RECENT), 2, axis=0).reshape(-1)
        return Wedges(np.repeat(self.lower, 2), np.repeat(self.upper, 2), recent, np.repeat(self.solid, 2))


class Part(NamedTuple):
    """Some columns and wedges of a quadrant; ends are exclusive."""

    column: int
    end_column: int
    wedge: int
    end_wedge: int
    slope: float  # in plan, of the first side of wedge 0
    per_wedge: float


@inlined
def _hides_all(v, part, begin, end, lower):
    """Whether wedges hide all that lies in a part of the columns, which then also leaves their slopes as they are."""
    near, far = get(v.along, part.column - 1), get(v.along, part.end_column - 1)
    if near < _NEAREST:
        return False
    left, right = part.slope + begin * part.per_wedge, part.slope + end * part.per_wedge
    rows = _rows_between(v, min(left * near, left * far), max(right * near, right * far))
    top, holes = _top_of(v, (part.column - 1, part.end_column - 1), rows, (0, LEVELS[0]))
    if holes != 0:
        return False
    highest = top + max(v.height, np.float64(0.0)) + v.lift + v.slack + v.sure - v.eye
    slope = highest / (near if highest > 0.0 else far)
    for b in range(begin, end):
        if not slope < get(lower, b):
            return False
    return True


@inlined
def _hide_all(v, part, begin, end, wedges):
    """Set the cells of some wedges and columns as hidden. wedges: pointers to their upper and recent slopes."""
    upper, recent = wedges
    for m in range(part.column, part.end_column):
        first = _from(v, (part.slope + begin * part.per_wedge) * get(v.along, m))
        last = _from(v, (part.slope + end * part.per_wedge) * get(v.along, m))
        for n in range(first, last):
            put(v.out, v.start + m * v.per_along + n * v.per_across, np.uint8(HIDDEN))
    for b in range(begin, end):
        for k in range(b * RECENT, (b + 1) * RECENT):
            put(upper, b, max(get(upper, b), get(recent, k)))
            put(recent, k, _NONE)


@kernel
def sweep(ticket, z, view, out, wedges, part):
    """Worker: classify the cells of some columns, wedge by wedge."""
    # In: z, heights of all cells; view: `View`; wedges: `Wedges`, changed; part: `Part`
    # Out: out, HIDDEN, SEEN or UNDECIDED of all cells
    v = _pointers(z, view, out)
    lower, upper, recent, solid = ptr(wedges.lower), ptr(wedges.upper), ptr(wedges.recent), ptr(wedges.solid)
    for item in items(ticket):
        begin = part.wedge + item * WEDGES_AT_A_TIME
        end = min(begin + WEDGES_AT_A_TIME, part.end_wedge)
        if _hides_all(v, part, begin, end, lower):
            _hide_all(v, part, begin, end, (upper, recent))
            continue
        for m in range(part.column, part.end_column):
            left = _side(v, m, part.slope + begin * part.per_wedge)
            for b in range(begin, end):
                right = _side(v, m, part.slope + (b + 1) * part.per_wedge)
                gone = (left.ends[0] >= v.rows and left.ends[1] >= v.rows) or (
                    right.ends[0] <= 0 and right.ends[1] <= 0
                )
                if not gone:
                    _widen_wedge(v, m, left, right, (lower, upper, recent, solid, b))
                left = right
