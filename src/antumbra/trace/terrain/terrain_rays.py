"""Shadow rays over terrain: the surface of a raster of heights, whose triangles are never stored.

A pyramid holds the greatest height of each square of four vertices, and of 2 x 2, 4 x 4, ... squares. A ray that stays
above such a height cannot meet the triangles below it. Nodes of the pyramid are visited in the order of a Z-curve that
follows the ray: with axes turned so that the ray ascends along both, a square that the ray reaches later has a larger
number. So a traversal needs no stack and begins at the square of the receiver.

Squares are enlarged, and heights raised, by more than all rounding: that of the float32 vertices, and that of the
float64 arithmetic. The triangles of a square that is reached are decided by the exact predicate, so the bits are those
of every other tracer.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...kernels.exact.filters import BEYOND, comes_first, dot, hit_t, larger, max_magnitude, meets, plane, smaller
from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr, put, stack_f32, stack_i64
from ...kernels.vec3 import get3
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, horizon_of, is_above, patch_of, query_pointers, sample_of, set_bit
from ...scene.scene_bounds import flush_to_zero
from ...scene.terrain import GridPoints, HeightGrid

RECEIVERS = 256  # receivers that a thread takes at a time
PAD = 2.0**-21  # squares are enlarged by this many times the longer side of the grid, in squares
_RAISE = 2.0**-40  # heights are raised by this fraction of the largest coordinate along the up axis
BLOCKERS = 64  # samples whose latest blockers are remembered
_LEAST_UNDER = 1e-30  # so that a flat surface is not below itself
_PARALLEL = 1e-300  # smallest component of a direction, in squares


class TerrainTree(NamedTuple):
    """A surface in the recentred frame, with its pyramid of heights."""

    x: NDArray[np.float32]  # (columns,) of the vertices, ascending
    y: NDArray[np.float32]  # (rows,) descending
    z: NDArray[np.float32]  # (rows, columns) NaN: no vertex
    tops: NDArray[np.float32]  # greatest heights of all nodes, level by level, row by row; -inf: no triangle
    starts: NDArray[np.int64]  # (levels + 1,) first node of each level in `tops`, and their number
    widths: NDArray[np.int64]  # (levels,) columns of nodes of each level
    west: float  # float64, of column 0
    north: float  # of row 0
    per_x: float  # columns per unit of length
    per_y: float
    pad: float  # by which squares are enlarged, in squares
    highest: float  # greatest height
    reach: float  # largest magnitude of a height
    under: float  # a segment that begins above the surface and is this far below it somewhere has met it; inf: holes
    base: int = 0  # the lowest level in `tops`; each node below has the height of the one there that contains it


def terrain_tree(surface: HeightGrid, origin: NDArray[np.float64]) -> TerrainTree:
    """The `TerrainTree` of a surface in the frame at `origin`; its vertices have the bits of the scene's triangles."""
    grid = surface.grid
    x, y, z = (
        flush_to_zero((world - o).astype(np.float32))
        for world, o in zip((grid.eastings(), grid.northings(), surface.heights.astype(np.float64)), origin)
    )
    tops = [_tops_of_squares(z)]
    while max(tops[-1].shape) > 1:
        tops.append(halved(tops[-1]))
    sizes = np.array([level.size for level in tops], np.int64)
    heights = z[~np.isnan(z)]
    return TerrainTree(
        x, y, z, np.concatenate([level.reshape(-1) for level in tops]), np.append(0, np.cumsum(sizes)),
        np.array([level.shape[1] for level in tops], np.int64),
        grid.west - origin[0], grid.north - origin[1], 1.0 / grid.dx, 1.0 / grid.dy,
        PAD * max(grid.rows, grid.columns), float(heights.max()), float(np.abs(heights).max()),
        _under(grid, x, y, z, origin),
    )  # fmt: skip


def _under(grid: GridPoints, x: np.ndarray, y: np.ndarray, z: np.ndarray, origin: NDArray[np.float64]) -> float:
    """The field `under` of a `TerrainTree`.

    The surface lies within (shift_x + shift_y) x the steepest edge of the surface over the even grid, if float32 moves
    vertices by these parts of a cell. Twice as much covers the float64 arithmetic.
    """
    if np.isnan(z).any():
        return np.inf
    steepest = max(float(np.abs(np.diff(z, axis=k)).max(initial=0.0)) for k in range(2))
    return under_of(grid, x, y, origin, steepest, float(np.abs(z).max()))


def under_of(
    grid: GridPoints, x: np.ndarray, y: np.ndarray, origin: NDArray[np.float64], steepest: float, reach: float
) -> float:
    """The field `under` of a `TerrainTree` without holes; `steepest`: greatest difference of neighbouring heights."""
    shift_x = np.abs((x.astype(np.float64) + origin[0] - grid.west) / grid.dx - np.arange(grid.columns)).max()
    shift_y = np.abs((grid.north - origin[1] - y.astype(np.float64)) / grid.dy - np.arange(grid.rows)).max()
    shift = float(shift_x + shift_y) + 1e-9
    return np.inf if shift > 0.1 else 2.0 * shift * steepest + _RAISE * reach + _LEAST_UNDER


def _tops_of_squares(z: NDArray[np.float32]) -> NDArray[np.float32]:
    """(rows - 1, columns - 1) float32: the greatest height of the triangles of each square; -inf: it has none."""
    there = ~np.isnan(z)
    low = np.where(there, z, np.float32(-np.inf))
    diagonal = there[:-1, :-1] & there[1:, 1:]
    ends = np.maximum(low[:-1, :-1], low[1:, 1:])
    south = np.where(there[1:, :-1], np.maximum(ends, low[1:, :-1]), np.float32(-np.inf))
    east = np.where(there[:-1, 1:], np.maximum(ends, low[:-1, 1:]), np.float32(-np.inf))
    return np.where(diagonal, np.maximum(south, east), np.float32(-np.inf))


def halved(level: NDArray[np.float32]) -> NDArray[np.float32]:
    """The maxima of 2 x 2 nodes."""
    rows, columns = level.shape
    padded = np.pad(level, ((0, rows & 1), (0, columns & 1)), constant_values=-np.inf)
    pairs = np.maximum(padded[::2], padded[1::2])
    return np.maximum(pairs[:, ::2], pairs[:, 1::2])


# --- Traversal --------------------------------------------------------------------------------------------------------


class _Pointers(NamedTuple):
    """Pointers to a `TerrainTree`, free of reference counts."""

    x: F32Ptr
    y: F32Ptr
    z: F32Ptr
    tops: F32Ptr
    starts: I64Ptr
    widths: I64Ptr
    columns: int
    root: int  # level
    west: float
    north: float
    per_x: float
    per_y: float
    pad: float
    highest: float
    reach: float
    rows: int
    under: float
    base: int


@inlined
def terrain_pointers(tree):
    """The `_Pointers` of a `TerrainTree`, which must outlive them."""
    return _Pointers(
        ptr(tree.x), ptr(tree.y), ptr(tree.z), ptr(tree.tops), ptr(tree.starts), ptr(tree.widths),
        np.int64(len(tree.x)), np.int64(tree.base + len(tree.widths) - 1),
        tree.west, tree.north, tree.per_x, tree.per_y, tree.pad, tree.highest, tree.reach,
        np.int64(len(tree.y)), tree.under, np.int64(tree.base),
    )  # fmt: skip


class _GridRay(NamedTuple):
    """A segment in squares, along axes turned so that it ascends: t = (line - begin) * per."""

    u: float  # begin, along columns
    v: float
    per_u: float  # t per square
    per_v: float
    z: float
    dz: float
    end: float  # t after which the ray is above all heights or has left the grid; at most tmax
    raised: float  # by which heights are raised
    west: bool  # whether columns are turned
    north: bool
    side: int  # squares along each side of the root, a power of two


@inlined
def _grid_ray(tree, ray):
    """The `_GridRay` of a segment, or of a ray along a direction."""
    side = np.int64(1) << tree.root
    u, du = (ray.ox - tree.west) * tree.per_x, ray.dx * tree.per_x
    v, dv = (tree.north - ray.oy) * tree.per_y, -ray.dy * tree.per_y
    west, north = du < 0.0, dv < 0.0
    u, v = (side - u if west else u), (side - v if north else v)
    # A ray that has risen or sunk by more than twice its height and `reach` is far from the surface.
    spread = abs(ray.dz) if ray.real == 1.0 else 3.0 * (abs(ray.oz) + tree.reach)
    raised = _RAISE * (abs(ray.oz) + spread + tree.reach)
    per_u, per_v = 1.0 / larger(abs(du), _PARALLEL), 1.0 / larger(abs(dv), _PARALLEL)
    end = smaller(ray.tmax, smaller((side + tree.pad - u) * per_u, (side + tree.pad - v) * per_v))
    if ray.dz > 0.0:
        end = smaller(end, (tree.highest + raised - ray.oz) / ray.dz)
    elif ray.dz < 0.0:
        end = smaller(end, (ray.oz + tree.reach + raised) / -ray.dz)
    return _GridRay(u, v, per_u, per_v, ray.oz, ray.dz, end, raised, west, north, side)


@inlined
def _corner_top(tree, top, i, j):
    """The greatest height of the corners of a square, at most `top`; -inf outside the grid."""
    if i >= tree.rows - 1 or j >= tree.columns - 1:
        return np.float32(-np.inf)
    at, highest = i * tree.columns + j, np.float32(-np.inf)
    for k in range(4):
        z = get(tree.z, at + (k >> 1) * tree.columns + (k & 1))
        highest = z if z > highest else highest  # not NaN
    return highest if highest < top else top


@inlined
def _top(tree, r, level, a, b):
    """The greatest height of node (a, b) of a level, in turned axes, or more below `base`; -inf outside the grid."""
    below = tree.base - level if level < tree.base else np.int64(0)
    nodes, k = r.side >> (level + below), level + below - tree.base
    column, row, columns = a >> below, b >> below, get(tree.widths, k)
    column, row = (nodes - 1 - column if r.west else column), (nodes - 1 - row if r.north else row)
    at = get(tree.starts, k) + row * columns + column
    top = get(tree.tops, at) if column < columns and at < get(tree.starts, k + 1) else np.float32(-np.inf)
    if level == 0 and below > 0:
        return _corner_top(tree, top, r.side - 1 - b if r.north else b, r.side - 1 - a if r.west else a)
    return top


@inlined
def _reaches(tree, r, level, a, b):
    """Whether a segment may meet triangles of node (a, b) of a level, in turned axes."""
    width = np.float64(np.int64(1) << level)
    first = larger((a * width - tree.pad - r.u) * r.per_u, (b * width - tree.pad - r.v) * r.per_v)
    first, last = larger(first, np.float64(0.0)), smaller(_exit(tree, r, level, a, b, tree.pad), r.end)
    if not first <= last:
        return False
    lowest = r.z + (first if r.dz > 0.0 else last) * r.dz
    return lowest <= _top(tree, r, level, a, b) + r.raised


@inlined
def _exit(tree, r, level, a, b, pad):
    """The t at which a segment leaves node (a, b) of a level. It reaches no later node of the curve before."""
    width = np.float64(np.int64(1) << level)
    return smaller(((a + 1) * width + pad - r.u) * r.per_u, ((b + 1) * width + pad - r.v) * r.per_v)


@inlined
def _is_above(tree, r, level, a, b, t):
    """Whether a segment passes above all of node (a, b) of a level from t on, until it leaves the node."""
    if r.dz <= 0.0:
        t = smaller(_exit(tree, r, level, a, b, tree.pad), r.end)
    return r.z + larger(t, np.float64(0.0)) * r.dz > _top(tree, r, level, a, b) + r.raised


@inlined
def _put_vertex(tree, corners, at, i, j):
    put(corners, at, get(tree.x, j))
    put(corners, at + 1, get(tree.y, i))
    put(corners, at + 2, get(tree.z, i * tree.columns + j))


@inlined
def _moves_away(ray, corners, i):
    """Whether a segment surely moves away from the plane of triangle i."""
    a, n, error = plane(corners, i, ray.ox, ray.oy, ray.oz)
    d = (ray.dx, ray.dy, ray.dz)
    height, rise = -dot(a, n), dot(d, n)
    sure_height, sure_rise = error * max_magnitude(a), error * max_magnitude(d)
    return (height > sure_height and rise > sure_rise) or (height < -sure_height and rise < -sure_rise)


@inlined
def _meets_triangle(tree, ray, corners, i, j, triangle, facing):
    """Whether a ray meets the first (0) or second (1) triangle of a square, which is written to this slot; exact."""
    k = 9 * triangle
    _put_vertex(tree, corners, k, i, j)
    _put_vertex(tree, corners, k + 3, i + 1, j + triangle)
    _put_vertex(tree, corners, k + 6, i + 1 - triangle, j + 1)
    heights = get(corners, k + 2) + get(corners, k + 5) + get(corners, k + 8)
    if heights != heights or _moves_away(ray, corners, triangle):  # a vertex has no data
        return False
    found = meets(ray, corners, triangle)
    return found != 0 and found != facing


@inlined
def meets_square(tree, ray, corners, i, j, facing):
    """Whether a ray meets one of the triangles of a square; exact. `corners`: scratch memory of 18 float32."""
    return _meets_triangle(tree, ray, corners, i, j, 0, facing) or _meets_triangle(tree, ray, corners, i, j, 1, facing)


class NearestHit(NamedTuple):
    """The nearest hit of a ray so far: pointers. Its triangle is in slot 2 of the corners."""

    t: F64Ptr  # float64 *, by `hit_t`
    face: I64Ptr  # int64 *, -1: none
    squares: I32Ptr  # int32 *: the first triangle of each square, row by row; -1: none


@inlined
def _take_nearest(tree, ray, corners, square, facing, nearest):
    """Whether a triangle of a square, (row, column), precedes the nearest hit so far, which it then replaces."""
    i, j = square
    face, found = np.int64(get(nearest.squares, i * (tree.columns - 1) + j)), False
    for triangle in range(2):
        if _meets_triangle(tree, ray, corners, i, j, triangle, facing):
            t, best = hit_t(ray, corners, triangle), get(nearest.face, 0)
            if best < 0 or comes_first(ray, corners, triangle, face, t, corners, 2, best, get(nearest.t, 0)):
                for k in range(9):
                    put(corners, 18 + k, get(corners, 9 * triangle + k))
                put(nearest.t, 0, t)
                put(nearest.face, 0, face)
                found = True
        south_west = get(tree.z, (i + 1) * tree.columns + j)
        face += south_west == south_west  # with NaN there, the square has no first triangle
    return found


@inlined
def _ending_at(r, t):
    """A `_GridRay` that ends at t, if not before."""
    end = smaller(r.end, t * BEYOND)
    return _GridRay(r.u, r.v, r.per_u, r.per_v, r.z, r.dz, end, r.raised, r.west, r.north, r.side)


@inlined
def _first_node(tree, place):
    """The first square along a turned axis that a segment from a place may reach."""
    return np.int64(smaller(larger(np.floor(place - tree.pad), np.float64(0.0)), np.float64(1 << 40)))


@inlined
def find_square(tree, ray, corners, facing, nearest):
    """A square of which a triangle blocks a ray, as row * columns + column; -1: none.

    nearest : a `NearestHit`, which is found instead, and the result is -1; None: any hit ends the ray
    """
    r, level = _grid_ray(tree, ray), np.int64(0)
    a, b = _first_node(tree, r.u), _first_node(tree, r.v)
    if a >= r.side or b >= r.side or r.end < 0.0:
        return np.int64(-1)
    while True:
        if _reaches(tree, r, level, a, b):
            if level > 0:
                level, a, b = level - 1, 2 * a, 2 * b
                continue
            i, j = (r.side - 1 - b if r.north else b), (r.side - 1 - a if r.west else a)
            if nearest is None:
                if meets_square(tree, ray, corners, i, j, facing):
                    return i * tree.columns + j
            elif _take_nearest(tree, ray, corners, (i, j), facing, nearest):
                r = _ending_at(r, get(nearest.t, 0))
        while True:
            t = _exit(tree, r, level, a, b, -tree.pad)
            if level >= tree.root or t > r.end:
                return np.int64(-1)
            if not (a & 1 and b & 1) and not _is_above(tree, r, level + 1, a >> 1, b >> 1, t):
                break
            level, a, b = level + 1, a >> 1, b >> 1
        if a & 1:
            b += 1
        a ^= 1


@inlined
def forget_blockers(last):
    """Empty the memory of latest blockers."""
    for s in range(BLOCKERS):
        put(last, s, np.int64(-1))


@inlined
def _surface_height(tree, u, v):
    """The height of the even surface without holes at a fractional column and row inside it."""
    j, i = min(np.int64(u), tree.columns - 2), min(np.int64(v), tree.rows - 2)
    a, b, at = u - j, v - i, i * tree.columns + j
    first, last = np.float64(get(tree.z, at)), np.float64(get(tree.z, at + tree.columns + 1))
    corner = np.float64(get(tree.z, at + tree.columns if b > a else at + 1))
    return first + max(a, b) * (corner - first) + min(a, b) * (last - corner)


@inlined
def starts_above(tree, o):
    """Whether a float32 point surely lies above a surface without holes."""
    u, v = (np.float64(o.x) - tree.west) * tree.per_x, (tree.north - np.float64(o.y)) * tree.per_y
    if not (tree.under < np.inf and 0.0 <= u <= tree.columns - 1 and 0.0 <= v <= tree.rows - 1):
        return False
    j, i = np.int64(np.rint(u)), np.int64(np.rint(v))
    if o.x == get(tree.x, j) and o.y == get(tree.y, i):
        return o.z > get(tree.z, i * tree.columns + j)
    return np.float64(o.z) > _surface_height(tree, u, v) + tree.under


@inlined
def _square_above(tree, ray, square):
    """A square near another one in which a segment is certainly below the surface; -1: none.

    The segment begins above the surface, so it has met it. `square`: that of the deepest point of a neighbour's segment
    """
    u, v = (ray.ox - tree.west) * tree.per_x, (tree.north - ray.oy) * tree.per_y
    du, dv = ray.dx * tree.per_x, -ray.dy * tree.per_y
    length = du * du + dv * dv
    deepest, found = tree.under, np.int64(-1)
    if length > 0.0:
        row, column = square // tree.columns, square % tree.columns
        middle = ((column + 0.5 - u) * du + (row + 0.5 - v) * dv) / length
        step = 1.0 / max(abs(du), abs(dv))
        for k in range(-1, 2):
            t = middle + k * step
            x, y = u + t * du, v + t * dv
            if 0.0 < t < 1.0 and 1.0 <= x <= tree.columns - 2 and 1.0 <= y <= tree.rows - 2:
                depth = _surface_height(tree, x, y) - (ray.oz + t * ray.dz)
                if depth > deepest:
                    deepest, found = depth, np.int64(y) * tree.columns + np.int64(x)
    return found


@inlined
def is_blocked(tree, ray, above, scratch, facing, s):
    """Whether the surface blocks a segment; exact.

    above : whether it `starts_above` the surface, and no triangles are culled
    scratch : (corners, latest blockers of samples, which are tested first)
    """
    corners, last = scratch
    square = get(last, s & (BLOCKERS - 1))
    if square >= 0:
        if above:
            square = _square_above(tree, ray, square)
            if square >= 0:
                put(last, s & (BLOCKERS - 1), square)
                return True
        elif meets_square(tree, ray, corners, square // tree.columns, square % tree.columns, facing):
            return True
    square = find_square(tree, ray, corners, facing, None)
    if square >= 0:
        put(last, s & (BLOCKERS - 1), square)
    return square >= 0


@inlined
def shadow_receiver(tree, query, i, scratch, bits):
    """Set the bits of receiver i; `scratch`: (corners, latest blockers)."""
    o, patch, horizon = get3(query.origins, 3 * i, 1), patch_of(query, i), horizon_of(query, i)
    above = query.facing == 0 and starts_above(tree, o)
    for s in range(query.spp):
        lx, ly, lz = sample_of(query, patch, i, s)
        if is_above(horizon, lx, ly, lz, query.corners):
            ray = segment(o.x, o.y, o.z, lx, ly, lz)
            if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:  # an empty segment is not blocked
                continue
            if not is_blocked(tree, ray, above, scratch, query.facing, s):
                continue
        set_bit(query, bits, i, s)


@kernel
def _shadow_receivers(ticket, tree, query, bits):
    """Worker: set the bits of all receivers."""
    chunk, out, surface = query_pointers(query), ptr(bits), terrain_pointers(tree)
    corners, last = stack_f32(18), stack_i64(BLOCKERS)
    for k in items(ticket):
        forget_blockers(last)
        for i in range(k * RECEIVERS, min((k + 1) * RECEIVERS, chunk.h * chunk.w)):
            if get(chunk.sides, i) != NOTHING:
                shadow_receiver(surface, chunk, i, (corners, last), out)


def trace_terrain(
    tree: TerrainTree, query: ShadowQuery, bits: NDArray[np.uint64], threads: int, progress: ProgressCallback | None
) -> None:
    """Answer a query whose receivers have no faces: set bit s of ``bits[y, x]`` where sample s is occluded."""
    shares = -(-query.sides.size // RECEIVERS)
    run(_shadow_receivers, threads, new_ticket(shares, 1), tree, query, bits, progress=progress)
