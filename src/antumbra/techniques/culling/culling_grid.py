"""The grid of pre-BVH culling, and the marking of the cells that shadow rays can meet [Selgrad et al. 2015, Sec. 3].

Sources are boxes around the receivers of each cell, and targets are boxes around light samples: the source and
destination cells of Sec. 3.1.

Hulls (Sec. 3.2). The paper walks along the line between the centres of each source cell and each destination cell, and
marks the cells on the line and all their neighbours. This module marks the cells that overlap the convex hull of a
source box S and a target box T, one layer of the grid at a time. The hull is the union of the boxes B(t) =
(1 - t) S + t T, 0 <= t <= 1 (equation 1 of docs/design/culling.md), whose bounds are linear in t. The part of the hull
inside a layer therefore lies in a rectangle, bounded by two values of t. Adding a rectangle to the layer's table of
differences takes four additions, regardless of its size.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import F32Ptr, F64Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import (
    broadcast4,
    extract,
    get,
    load4,
    mask_from_bits4,
    maximum,
    minimum,
    ptr,
    put,
    select,
    splat4,
    store,
    to_i32,
)
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery
from ...scene.lights import AMBIENT, DIRECTIONAL, SPHERE

# --- The grid over the part of the scene where rays can be [Selgrad et al. 2015, Sec. 3.1] ----------------------------

PAD = 2.0**-20  # relative to the largest coordinate; far above the errors of float32 samples and float64 arithmetic


class CellGrid(NamedTuple):
    """A box of n x n x n equal cells.

    One monotone function (`cells_at`) maps float32 coordinates to cells, for triangles and rays alike. If a point of a
    triangle lies within the bounds marked for a ray, its cell is therefore marked too, regardless of rounding.
    """

    bounds: np.ndarray  # (2, 4) float32: lower, upper corner; the fourth number is unused
    scale: np.ndarray  # (4,) float32: cells per unit of length; 0 along an axis without extent
    n: int  # cells per axis


class GridPointers(NamedTuple):
    """A `CellGrid` with pointers instead of arrays, which must outlive them. Kernels accept both types."""

    bounds: F32Ptr  # float32 *
    scale: F32Ptr  # float32 *
    n: int


@inlined
def pointers_of(grid):
    """The `GridPointers` of a `CellGrid`."""
    return GridPointers(ptr(grid.bounds), ptr(grid.scale), np.int64(grid.n))


def grid_over(lower: NDArray[np.float64], upper: NDArray[np.float64], n: int) -> CellGrid:
    """The `CellGrid` over the box from `lower` to `upper`, (3,) float64 each, rounded outwards."""
    bounds = np.zeros((2, 4), np.float32)
    bounds[0, :3] = np.nextafter(np.asarray(lower, np.float32), np.float32(-np.inf))
    bounds[1, :3] = np.nextafter(np.asarray(upper, np.float32), np.float32(np.inf))
    return divided(bounds, n)


def divided(bounds: NDArray[np.float32], n: int) -> CellGrid:
    """The `CellGrid` of n x n x n cells with these bounds."""
    extent = bounds[1].astype(np.float64) - bounds[0]
    scale = np.divide(n, extent, out=np.zeros(4), where=extent > n * np.finfo(np.float32).tiny)
    return CellGrid(bounds, scale.astype(np.float32), n)


def cell_size(grid: CellGrid) -> NDArray[np.float64]:
    """(3,) float64: the extent of a cell."""
    size: NDArray[np.float64] = (grid.bounds[1, :3].astype(np.float64) - grid.bounds[0, :3]) / grid.n
    return size


@inlined
def cells_at(grid, point):
    """The cells (i32x4, one for each axis) of an f32x4 of coordinates, clamped to the grid."""
    place = (point - load4(grid.bounds, 0)) * load4(grid.scale, 0)
    return to_i32(minimum(maximum(place, np.float32(0.0)), np.float32(grid.n - 1)))


@inlined
def cell_at(grid, axis, x):
    """The cell of one float32 coordinate along an axis, equal to that of `cells_at`."""
    place = (x - get(grid.bounds, axis)) * get(grid.scale, axis)
    return np.int64(min(max(place, np.float32(0.0)), np.float32(grid.n - 1)))


@inlined
def cell_number(grid, cell):
    """The number of a cell given as an i32x4: (x n + y) n + z."""
    n = np.int64(grid.n)
    return (np.int64(extract(cell, 0)) * n + np.int64(extract(cell, 1))) * n + np.int64(extract(cell, 2))


# --- Sources: a box around the receivers in each cell -----------------------------------------------------------------

FINEST = 32  # maximum number of cells per axis for sorting receivers; the boxes around them are exact
TILE = 8  # a tile has 8 x 8 receivers, or 1 x 64 if there are fewer than 8 rows

_PARTS = 16  # maximum number of cell tables, of one megabyte each
_INF = np.float32(np.inf)


class ReceiverTiles(NamedTuple):
    """Receivers in tiles, with the box of each tile."""

    origins: np.ndarray  # (h, w, 3) float32
    sides: np.ndarray  # (h, w) int8
    rows: int  # rows of receivers per tile
    columns: int  # columns of receivers per tile
    boxes: np.ndarray  # (tiles, 8) float32: lower and upper corner, fourth numbers unused; inf and -inf: no receiver


@inlined
def receiver_at(tiles, y, x):
    """Receiver (y, x) as an f32x4; the fourth lane repeats z."""
    i = (y * tiles.sides.shape[1] + x) * 3
    a, b, c = broadcast4(tiles.origins, i), broadcast4(tiles.origins, i + 1), broadcast4(tiles.origins, i + 2)
    return select(mask_from_bits4(1), a, select(mask_from_bits4(2), b, c))


@inlined
def tile_range(tiles, tile):
    """(y, x) of the first receiver of a tile, and (y, x) one past its last one."""
    h, w = tiles.sides.shape
    across = (w + tiles.columns - 1) // tiles.columns
    y, x = tile // across * tiles.rows, tile % across * tiles.columns
    return y, x, min(y + tiles.rows, h), min(x + tiles.columns, w)


@kernel
def _bound_tiles(ticket, tiles):
    """Worker: find the box of each tile."""
    for i in items(ticket):
        y0, x0, y1, x1 = tile_range(tiles, i)
        low, high = splat4(_INF), splat4(-_INF)
        for y in range(y0, y1):
            for x in range(x0, x1):
                if tiles.sides[y, x] != NOTHING:
                    point = receiver_at(tiles, y, x)
                    low, high = minimum(low, point), maximum(high, point)
        store(tiles.boxes, i * 8, low)
        store(tiles.boxes, i * 8 + 4, high)


@inlined
def _grow(boxes, i, low, high):
    """Grow box i of an array to enclose the box from `low` to `high`."""
    store(boxes, i * 8, minimum(load4(boxes, i * 8), low))
    store(boxes, i * 8 + 4, maximum(load4(boxes, i * 8 + 4), high))


@kernel
def _bound_cells(ticket, tiles, grid, cells):
    """Worker: fill the rows of `cells`: for each cell, the box of the receivers in the share of tiles of the row."""
    for part in items(ticket):
        boxes = cells[part]
        for cell in range(len(boxes)):
            store(boxes, cell * 8, splat4(_INF))
            store(boxes, cell * 8 + 4, splat4(-_INF))
        for i in range(part, len(tiles.boxes), len(cells)):
            low, high = load4(tiles.boxes, i * 8), load4(tiles.boxes, i * 8 + 4)
            if not tiles.boxes[i, 0] <= tiles.boxes[i, 4]:
                continue
            first = cell_number(grid, cells_at(grid, low))
            if first == cell_number(grid, cells_at(grid, high)):
                _grow(boxes, first, low, high)
                continue
            y0, x0, y1, x1 = tile_range(tiles, i)
            for y in range(y0, y1):
                for x in range(x0, x1):
                    if tiles.sides[y, x] != NOTHING:
                        point = receiver_at(tiles, y, x)
                        _grow(boxes, cell_number(grid, cells_at(grid, point)), point, point)


def tiles_of(query: ShadowQuery, threads: int) -> ReceiverTiles:
    """The receivers of a ShadowQuery, in tiles."""
    h, w = query.sides.shape
    rows = TILE if h >= TILE else 1
    columns = TILE * TILE // rows
    count = -(-h // rows) * -(-w // columns)
    tiles = ReceiverTiles(query.origins, query.sides, rows, columns, np.empty((count, 8), np.float32))
    run(_bound_tiles, threads, new_ticket(count, 64), tiles)
    return tiles


def bounds_of(tiles: ReceiverTiles) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Lower and upper corner, (3,) float64, of all receivers; None if there are none."""
    if not (tiles.boxes[:, 0] <= tiles.boxes[:, 4]).any():
        return None
    return _extreme(np.minimum, tiles.boxes)[:3].astype(np.float64), _extreme(np.maximum, tiles.boxes)[4:7].astype(
        np.float64
    )


_FOLD = 128  # boxes reduced side by side: NumPy is slow for rows as short as a box


def _extreme(function: np.ufunc, boxes: NDArray[np.float32]) -> NDArray[np.float32]:
    """(8,) float32: the minimum or maximum of (n, 8) float32 boxes, n > 0."""
    whole = len(boxes) // _FOLD * _FOLD
    folded = function.reduce(boxes[:whole].reshape(-1, 8 * _FOLD)) if whole else np.empty(0, np.float32)
    rest: NDArray[np.float32] = function.reduce(np.concatenate([folded.reshape(-1, 8), boxes[whole:]]))
    return rest


def sources_of(tiles: ReceiverTiles, grid: CellGrid, threads: int) -> NDArray[np.float64]:
    """(m, 2, 3) float64: the box around the receivers of each cell, in a grid of at most FINEST cells per axis."""
    grid = divided(grid.bounds, min(grid.n, FINEST))
    parts = min(threads, _PARTS)
    cells = np.empty((parts, grid.n**3, 8), np.float32)
    run(_bound_cells, threads, new_ticket(parts, 1), tiles, grid, cells)
    boxes = cells[:, (cells[:, :, 0] <= cells[:, :, 4]).any(0)]
    return np.stack([boxes.min(0)[:, :3], boxes.max(0)[:, 4:7]], 1).astype(np.float64)


# --- Targets: boxes around the samples of a light ---------------------------------------------------------------------

MOST = 4  # maximum number of boxes per light; twelve cost more time than they saved


class Targets(NamedTuple):
    """Boxes that enclose the far ends of a query's segments.

    A light with a position has boxes there. A distant or ambient light has boxes relative to the receiver: a segment
    from o ends in o + box. A distant light of any angular size is therefore a box of directions times a length that
    reaches beyond the scene, and needs no destination cells.
    """

    boxes: np.ndarray  # (k, 2, 3) float64: lower, upper
    relative: bool  # whether the boxes are relative to the receiver


def targets_of(query: ShadowQuery, cell: NDArray[np.float64]) -> Targets:
    """The `Targets` of a ShadowQuery; ``cell``: (3,) extent of a cell of about the grid's size.

    They enclose the samples of the query, not the whole light. Samples whose box is larger than a cell along every
    axis, such as those of tilted lights and lists, are split into several boxes.
    """
    light = query.light
    if light.kind in (SPHERE, AMBIENT):  # tangent disks lie in the sphere
        points = light.base + light.radius * np.array([[-1.0], [1.0]])
        return Targets(_padded(points[None]), light.kind == AMBIENT)
    points = sample_points(query)
    relative = light.kind == DIRECTIONAL
    return Targets(_padded(_boxes(points, cell, 1 if relative else MOST)), relative)


def sample_points(query: ShadowQuery) -> NDArray[np.float64]:
    """(k, 3) float64: all samples of a flat light, a list or a distant light.

    Samples of a distant light are relative to the receiver.
    """
    light = query.light
    points: NDArray[np.float64] = light.base + query.samples.reshape(-1, 3) @ np.stack([light.u, light.v, light.w])
    return points


def _boxes(points: NDArray[np.float64], cell: NDArray[np.float64], most: int) -> NDArray[np.float64]:
    """At most `most` boxes, (k, 2, 3), around groups of nearby points."""
    lower, upper = points.min(0), points.max(0)
    if most == 1 or (upper - lower <= cell).any():
        return np.array([[lower, upper]])
    size = np.maximum(cell, (upper - lower) / 64.0)
    while True:
        key = np.floor((points - lower) / size).astype(np.int64) @ [1 << 20, 1 << 10, 1]
        keys, group = np.unique(key, return_inverse=True)
        if len(keys) <= most:
            break
        size = 2.0 * size
    boxes = np.empty((len(keys), 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    np.minimum.at(boxes[:, 0], group, points)
    np.maximum.at(boxes[:, 1], group, points)
    return boxes


def _padded(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """The boxes, padded by more than the rounding error of float32 samples."""
    pad = PAD * np.abs(boxes).max()
    padded: NDArray[np.float64] = boxes + np.array([[-pad], [pad]])
    return padded


# --- Hulls: mark the cells between sources and targets [Selgrad et al. 2015, Sec. 3.2] --------------------------------

_SOURCES = 8192  # source boxes whose pairs are in memory at once


class Hulls(NamedTuple):
    """Pairs of a source box S and a target box T, sorted by their main axis.

    The main axis is the one along which S and T are farthest apart, in cells.
    """

    lower: np.ndarray  # (m, 3) float64: lower corner of S
    upper: np.ndarray  # (m, 3) float64: upper corner of S
    grow: np.ndarray  # (m, 3) float64: lower corner of T minus lower corner of S; B(t) begins at lower + t grow
    swell: np.ndarray  # (m, 3) float64: upper corner of T minus upper corner of S; B(t) ends at upper + t swell
    start: np.ndarray  # (4,) int64: pairs start[k] to start[k + 1] - 1 have the main axis k


def hulls_between(sources: NDArray[np.float64], targets: Targets, grid: CellGrid) -> Hulls:
    """The `Hulls` of all pairs of (m, 2, 3) source boxes and `Targets`.

    Equations 1 and 5 of docs/design/culling.md.
    """
    s, t = sources[:, None], targets.boxes[None]
    t = s + t if targets.relative else np.broadcast_to(t, (len(s), *t.shape[1:]))
    grow, swell = t[:, :, 0] - s[:, :, 0], t[:, :, 1] - s[:, :, 1]
    axis = (np.abs(grow + swell) * grid.scale[:3]).argmax(-1).ravel()
    order, of = np.argsort(axis, kind="stable"), np.repeat(np.arange(len(s)), t.shape[1])
    return Hulls(
        sources[of[order], 0], sources[of[order], 1], grow.reshape(-1, 3)[order], swell.reshape(-1, 3)[order],
        np.searchsorted(axis[order], np.arange(4)),
    )  # fmt: skip


class HullPointers(NamedTuple):
    """Pointers to the arrays of `Hulls`, which must outlive them. Arrays would cost reference counts."""

    lower: F64Ptr  # float64 *: 3 numbers per pair, in all fields
    upper: F64Ptr  # float64 *
    grow: F64Ptr  # float64 *
    swell: F64Ptr  # float64 *


@inlined
def _while_at_least(start, slope, limit, low, high):
    """The part of [low, high] where start + t slope >= limit, as (low, high); empty if low > high."""
    if slope == 0.0:
        return (low, high) if start >= limit else (np.float64(1.0), np.float64(0.0))
    t = (limit - start) / slope
    return (max(low, t), high) if slope > 0.0 else (low, min(high, t))


@inlined
def while_within(bounds, k, lower, upper):
    """(low, high): the t in [0, 1] for which B(t) meets the slab from `lower` to `upper`; empty if low > high.

    `k` is the index of the pair and the axis in the arrays. Equation 3 of docs/design/culling.md.
    """
    low, high = np.float64(0.0), np.float64(1.0)
    low, high = _while_at_least(get(bounds.upper, k), get(bounds.swell, k), lower, low, high)
    return _while_at_least(-get(bounds.lower, k), -get(bounds.grow, k), -upper, low, high)


@inlined
def cells_between(bounds, k, axis, low, high, pad, grid):
    """First and last cell along an axis that B(t) overlaps for t in [low, high].

    `k` is the index of the pair and the axis in the arrays. Equation 4 of docs/design/culling.md.
    """
    a, b = get(bounds.lower, k), get(bounds.upper, k)
    least = min(a + low * get(bounds.grow, k), a + high * get(bounds.grow, k)) - pad
    most = max(b + low * get(bounds.swell, k), b + high * get(bounds.swell, k)) + pad
    return cell_at(grid, axis, np.float32(least)), cell_at(grid, axis, np.float32(most))


@inlined
def _add(table, place, x):
    put(table, place, get(table, place) + np.int32(x))


@inlined
def _add_rectangle(table, side, first_u, last_u, first_v, last_v):
    """Add 1 to a rectangle of cells in a table of differences with `side` numbers per row."""
    _add(table, first_u * side + first_v, 1)
    _add(table, (last_u + 1) * side + first_v, -1)
    _add(table, first_u * side + last_v + 1, -1)
    _add(table, (last_u + 1) * side + last_v + 1, 1)


@inlined
def walls_of(grid, axis, layer, pad):
    """(lower, upper): the coordinates that bound a layer. The outermost layers are unbounded on their outer sides."""
    scale, begin = np.float64(get(grid.scale, axis)), np.float64(get(grid.bounds, axis))
    size = 1.0 / scale if scale > 0.0 else np.inf
    lower = begin + layer * size - pad if layer > 0 else -np.inf
    upper = begin + (layer + 1) * size + pad if layer < grid.n - 1 else np.inf
    return lower, upper


@inlined
def other_axes(axis):
    """The two axes along a layer across an axis, in ascending order."""
    return 1 - min(axis, 1), 2 - axis // 2


@kernel
def _mark_layers(ticket, hulls, grid, pad, marked, table):
    """Worker: mark the cells of layers along each axis in turn.

    table : (n + 1, n + 1) int32, scratch memory of the thread
    """
    n = grid.n
    bounds = HullPointers(ptr(hulls.lower), ptr(hulls.upper), ptr(hulls.grow), ptr(hulls.swell))
    grid_pointers = pointers_of(grid)
    for item in items(ticket):
        axis, layer = item // n, item % n
        u, v = other_axes(axis)
        layer_lower, layer_upper = walls_of(grid_pointers, axis, layer, pad)
        table[:] = 0
        for i in range(hulls.start[axis], hulls.start[axis + 1]):
            low, high = while_within(bounds, i * 3 + axis, layer_lower, layer_upper)
            if low <= high:
                u0, u1 = cells_between(bounds, i * 3 + u, u, low, high, pad, grid_pointers)
                v0, v1 = cells_between(bounds, i * 3 + v, v, low, high, pad, grid_pointers)
                _add_rectangle(ptr(table), n + 1, u0, u1, v0, v1)
        _mark_sums(table, axis, layer, marked)


@inlined
def _mark_sums(table, axis, layer, marked):
    """Integrate the table's differences, and mark the cells of the layer with a non-zero sum."""
    n = len(marked)
    for i in range(n):
        row = np.int32(0)
        for j in range(n):
            row += table[i, j]
            table[i, j] = row + (table[i - 1, j] if i > 0 else np.int32(0))
            if table[i, j] > 0:
                if axis == 0:
                    marked[layer, i, j] = 1
                elif axis == 1:
                    marked[i, layer, j] = 1
                else:
                    marked[i, j, layer] = 1


def mark_hulls(
    sources: NDArray[np.float64], query: ShadowQuery, grid: CellGrid, marked: NDArray[np.uint8], threads: int
) -> int:
    """Set to 1 the cells of ``marked``, (n, n, n) uint8, that a segment from a source to the query's light can meet.

    Returns the number of target boxes.
    """
    targets = targets_of(query, cell_size(grid))
    mark_between(sources, targets, grid, marked, threads)
    return len(targets.boxes)


def pad_of(grid: CellGrid) -> np.float64:
    """By how much layers and hulls are padded, above all rounding errors."""
    return np.float64(PAD * np.abs(grid.bounds).max())


def mark_between(
    sources: NDArray[np.float64], targets: Targets, grid: CellGrid, marked: NDArray[np.uint8], threads: int
) -> None:
    """Set to 1 the cells of ``marked`` between sources and targets.

    Each layer is marked by one thread. Threads can only share a cell of layers along different axes, and all of them
    write 1, so their order does not matter, as in the paper.
    """
    pad = pad_of(grid)
    new_table = lambda: (np.empty((grid.n + 1, grid.n + 1), np.int32),)
    for first in range(0, len(sources), _SOURCES):
        hulls = hulls_between(sources[first : first + _SOURCES], targets, grid)
        run(_mark_layers, threads, new_ticket(3 * grid.n, 1), hulls, grid, pad, marked, own=new_table)
