"""Pre-BVH culling: find and pack the triangles that overlap a marked cell [Selgrad et al. 2015, Sec. 3].

Also what trees and tracers without a tree get of a scene: its solid triangles, without holes or zero area.

Relevance. The paper looks at all cells that a triangle overlaps. Here a summed-volume table answers for any range of
cells with eight numbers. So a huge triangle costs no more than a small one.

Steps:

1. Sources and targets are boxes of the receivers and of the lights.
2. Hulls mark the cells between these boxes.
3. `find_relevant` drops the triangles that overlap no marked cell.

The paper's grid lies over the whole scene. This grid lies over the box of all segments, so its cells are smaller.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...bvh.nodes import Bvh
from ...bvh.triangle_bounds import corners_of
from ...kernels.jit import I32Ptr, U8Ptr, inlined, kernel
from ...kernels.parallel import CHUNK, items, new_ticket, run, shares, thread_count
from ...kernels.simd import all_lanes, extract, get, load4, load8, mask_from_bits4, maximum, minimum, ptr, put, store
from ...query.query_bounds import bounds
from ...scene.triangle_setup import solid_vertices
from ...scene.triangles import Triangles
from .culling_grid import (
    FINEST,
    CellGrid,
    GridPointers,
    ReceiverTiles,
    bounds_of,
    cell_number,
    cells_at,
    grid_over,
    mark_hulls,
    pointers_of,
    sources_of,
    targets_of,
    tiles_of,
)

# --- Finds the triangles that overlap a marked cell, and packs them together [Selgrad et al. 2015, Sec. 3.3] ----------
#
# The paper looks at all cells that a triangle overlaps. Here a summed-volume table answers for any range of cells with
# eight numbers. So a huge triangle costs no more than a small one.


_CHUNK = 8192  # triangles


class MarkedCells(NamedTuple):
    """Marked cells, and their summed-volume table, which counts the marked cells of any range."""

    cells: np.ndarray  # (n, n, n) uint8: 1 marked, 0 not
    sums: np.ndarray  # (n + 1, n + 1, n + 1) int32: [x, y, z] is the number of marked cells below x, y and z


@kernel
def _sum_slabs(ticket, cells, sums):
    """Worker: sum the marks within each layer of x."""
    n = len(cells)
    for x in items(ticket):
        for y in range(n):
            row = np.int32(0)
            for z in range(n):
                row += np.int32(cells[x, y, z])
                sums[x + 1, y + 1, z + 1] = sums[x + 1, y, z + 1] + row


@kernel
def _sum_across(ticket, sums):
    """Worker: add the sums of the layers before, row by row."""
    n = len(sums)
    for y in items(ticket):
        for x in range(1, n):
            for z in range(1, n):
                sums[x, y, z] += sums[x - 1, y, z]


def marked_cells_of(cells: np.ndarray, threads: int) -> MarkedCells:
    """The `Marks` of cells, (n, n, n) uint8."""
    n = len(cells)
    sums = np.zeros((n + 1, n + 1, n + 1), np.int32)
    run(_sum_slabs, threads, new_ticket(n, 1), cells, sums)
    run(_sum_across, threads, new_ticket(n + 1, 1), sums)
    return MarkedCells(cells, sums)


class _Table(NamedTuple):
    """Pointers to the arrays of `Marks` and of the grid. The arrays must outlive them."""

    cells: U8Ptr  # uint8 *
    sums: I32Ptr  # int32 *
    grid: GridPointers


@inlined
def _sum(table, x, y, z):
    """The number of marked cells below x, y and z."""
    side = table.grid.n + 1
    return get(table.sums, (x * side + y) * side + z)


@inlined
def _any_marked(table, low, high):
    """Whether any cell from `low` to `high` (i32x4 each, both included) is marked."""
    x0, y0, z0 = np.int64(extract(low, 0)), np.int64(extract(low, 1)), np.int64(extract(low, 2))
    x1, y1, z1 = np.int64(extract(high, 0)) + 1, np.int64(extract(high, 1)) + 1, np.int64(extract(high, 2)) + 1
    t = table
    above = _sum(t, x1, y1, z1) - _sum(t, x1, y1, z0) - _sum(t, x1, y0, z1) + _sum(t, x1, y0, z0)
    return above != _sum(t, x0, y1, z1) - _sum(t, x0, y1, z0) - _sum(t, x0, y0, z1) + _sum(t, x0, y0, z0)


@inlined
def _is_relevant(corners, i, table):
    """Whether the box of triangle i overlaps the grid and a marked cell."""
    a, b, c = corners_of(corners, i)
    low, high = minimum(minimum(a, b), c), maximum(maximum(a, b), c)
    inside = (low <= load4(table.grid.bounds, 4)) & (high >= load4(table.grid.bounds, 0)) | mask_from_bits4(
        8
    )  # the fourth lanes always pass
    if not all_lanes(inside):
        return False
    first, last = cells_at(table.grid, low), cells_at(table.grid, high)
    number = cell_number(table.grid, first)
    if number == cell_number(table.grid, last):
        return get(table.cells, number) != 0
    return _any_marked(table, first, last)


@kernel
def _find(ticket, corners, grid, marks, found, counts):
    """Worker: write the relevant triangles of each chunk to `found`, from the chunk's first place on."""
    values, out = ptr(corners), ptr(found)
    table = _Table(ptr(marks.cells), ptr(marks.sums), pointers_of(grid))
    for first, last in shares(ticket):
        n = first
        for i in range(first, last):
            put(out, n, i)
            if _is_relevant(values, i, table):
                n += 1
        counts[first // ticket[CHUNK]] = n - first


@kernel
def _pack(ticket, corners, found, counts, starts, kept, packed):
    """Worker: copy the relevant triangles of each chunk to their places in `kept` and `packed`."""
    source, target = ptr(corners), ptr(packed)
    for chunk in items(ticket):
        for k in range(counts[chunk]):
            i, place = np.int64(found[chunk * _CHUNK + k]), starts[chunk] + k
            kept[place] = i
            store(target, place * 9, load8(source, i * 9))
            put(target, place * 9 + 8, get(source, i * 9 + 8))


class RelevantTriangles(NamedTuple):
    """The triangles that overlap a marked cell, chunk by chunk."""

    ids: np.ndarray  # (n,) int32: indices, those of each chunk from the chunk's first place on
    counts: np.ndarray  # (chunks,) int64: how many there are in each chunk


def find_relevant(corners: np.ndarray, grid, marks: MarkedCells, threads: int) -> RelevantTriangles:
    """Find the triangles, (n, 9) float32, that overlap a marked cell."""
    found = RelevantTriangles(np.empty(len(corners), np.int32), np.zeros(-(-len(corners) // _CHUNK), np.int64))
    run(_find, threads, new_ticket(len(corners), _CHUNK), corners, grid, marks, *found)
    return found


def pack_relevant(corners: np.ndarray, found: RelevantTriangles, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices, (m,) int32 and ascending, and corners, (m, 9) float32, of the triangles that were found."""
    counts, total = found.counts, int(found.counts.sum())
    kept, packed = np.empty(total, np.int32), np.empty((total, 9), np.float32)
    starts = np.cumsum(counts) - counts
    run(_pack, threads, new_ticket(len(counts), 1), corners, found.ids, counts, starts, kept, packed)
    return kept, packed


# --- Pre-BVH culling [Selgrad et al. 2015, Sec. 3]: finds the triangles that the queries' segments can meet -----------
#
# 1. `sources` and `targets` make boxes of the receivers and of the lights.
# 2. `swept` marks the cells between these boxes.
# 3. `relevance` drops the triangles that overlap no marked cell.
#
# The paper's grid lies over the whole scene. This grid lies over the box of all segments, so its cells are smaller.


STEPS = ("sources", "mark", "triangles", "pack")
"""The steps of culling: sort receivers into cells, mark cells, find the triangles that are left, pack them together."""


class CullResult(NamedTuple):
    """The triangles that are left of a scene, and how culling found them."""

    kept: np.ndarray  # (m,) int32, ascending: indices of the triangles that are left
    vertices: np.ndarray  # (m, 3, 3) float32: their vertices
    grid: CellGrid | None  # None: there is no segment, or no segment can meet a triangle
    marked: np.ndarray | None  # (n, n, n) uint8: 1 where segments can be
    sources: int  # number of boxes of receivers
    targets: int  # number of boxes of lights


def cull(
    triangles, queries, threads: int | None = None, *, n: int = 32, mark: Callable = mark_hulls, whole: bool = False,
    lap: Callable[[str], None] = lambda step: None,
) -> CullResult:  # fmt: skip
    """Find all triangles that a segment of the queries can meet, and perhaps some more.

    Answers over the culled triangles equal answers over all triangles, bit for bit.

    Parameters
    ----------
    triangles : Triangles
        All triangles of the scene.
    queries : list of ShadowQuery
        They must hold every sample that will be asked.
    threads : int or None
        None: all cores.
    n : int
        Cells of the grid along an axis.
    mark : function of (sources, targets, grid, marked, threads)
        Marks the cells between sources and targets.
    whole : bool
        Whether the grid lies over the whole scene and all lights.
    lap : function of str
        Called after each step, with its name from STEPS.
    """
    threads, corners = thread_count(threads), triangles.vertices.reshape(-1, 9)
    groups = _groups(queries, threads)
    box = _box_of(groups, corners, whole, threads)
    if box is None:
        return CullResult(np.empty(0, np.int32), np.empty((0, 3, 3), np.float32), None, None, 0, 0)
    grid, coarse = grid_over(*box, n), grid_over(*box, min(n, FINEST))
    marked, counts = np.zeros((n, n, n), np.uint8), np.zeros(2, np.int64)
    for tiles, asked in groups:
        sources = sources_of(tiles, coarse, threads)
        lap("sources")
        ends = [targets_of(query, (box[1] - box[0]) / n) for query in asked]
        for targets in ends:
            mark(sources, targets, grid, marked, threads)
        counts += len(sources), sum(len(targets.boxes) for targets in ends)
        lap("mark")
    found = find_relevant(corners, grid, marked_cells_of(marked, threads), threads)
    lap("triangles")
    kept, packed = pack_relevant(corners, found, threads)
    lap("pack")
    return CullResult(kept, packed.reshape(-1, 3, 3), grid, marked, *counts.tolist())


def _groups(queries, threads) -> list[tuple[ReceiverTiles, list]]:
    """Group the queries that share their receivers; leave out queries without receivers.

    The receivers of a group are sorted into tiles once.
    """
    groups: dict[tuple[int, int], tuple[ReceiverTiles, list]] = {}
    for query in queries:
        key = id(query.origins), id(query.sides)
        if key not in groups:
            groups[key] = tiles_of(query, threads), []
        groups[key][1].append(query)
    return [group for group in groups.values() if bounds_of(group[0]) is not None]


def _box_of(groups, corners, whole: bool, threads) -> tuple[np.ndarray, np.ndarray] | None:
    """Lower and upper corner, (3,) float64, of the grid's box; None if it is empty.

    The box is the overlap of the box of all segments and the box of all triangles. With `whole`, it is the box of all
    triangles, receivers and lights.
    """
    if not groups or not len(corners):
        return None
    everywhere = np.full(3, np.inf)
    low, high = everywhere, -everywhere
    for tiles, queries in groups:
        near, far = bounds_of(tiles)
        for query in queries:
            targets = targets_of(query, everywhere)
            if whole and targets.relative:
                continue
            ends = targets.boxes[0] + ([near, far] if targets.relative else 0.0)
            low, high = np.minimum(low, np.minimum(near, ends[0])), np.maximum(high, np.maximum(far, ends[1]))
    lower, upper = bounds(corners.reshape(-1, 3), threads)
    if whole:
        return np.minimum(low, lower), np.maximum(high, upper)
    low, high = np.maximum(low, lower), np.minimum(high, upper)
    return (low, high) if (low <= high).all() else None


# --- The solid triangles of a scene, which a plan's tree holds: they have an area, and no hole ------------------------


def solid_of(triangles: Triangles, culled: CullResult | None, threads: int | None) -> CullResult | None:
    """What culling left, without cut-outs, clear faces and triangles without area; None: all triangles."""
    own = triangles.solid
    if own is None:
        return culled
    if culled is None:
        return CullResult(own, solid_vertices(triangles, threads), None, None, 0, 0)
    left = np.isin(culled.kept, own, assume_unique=True)
    return culled._replace(kept=culled.kept[left], vertices=np.ascontiguousarray(culled.vertices[left]))


def solid_count(triangles: Triangles) -> int:
    """The number of solid triangles."""
    return len(triangles.vertices if triangles.solid is None else triangles.solid)


def solid_tree(build: Callable, triangles: Triangles, threads: int | None) -> Bvh:
    """A tree of the solid triangles, by a builder's function."""
    bvh = build(solid_vertices(triangles, threads), threads)
    own = triangles.solid
    return bvh if own is None else bvh._replace(prim_ids=own[bvh.prim_ids])


# --- The input of tracers without a BVH: the unsorted triangles -------------------------------------------------------


class Soup(NamedTuple):
    """All or some triangles of a scene, in scene order."""

    corners: np.ndarray  # (n, 9) float32, recentred frame, C-contiguous
    ids: np.ndarray  # (n,) int32, ascending: index of each triangle in the scene


def soup_of(triangles: Triangles, culled: CullResult | None = None, threads: int | None = None) -> Soup:
    """The `Soup` of the solid triangles of a scene, or of those left by culling; without copies if all are solid."""
    if culled is not None:
        return Soup(culled.vertices.reshape(-1, 9), culled.kept)
    if triangles.solid is not None:
        return Soup(solid_vertices(triangles, threads).reshape(-1, 9), triangles.solid)
    return Soup(triangles.vertices.reshape(-1, 9), np.arange(len(triangles.vertices), dtype=np.int32))
