"""Pre-BVH culling: find and pack the triangles that segments of the queries can meet [Selgrad et al. 2015, Sec. 3].

1. `mark_segments` makes boxes of receivers and lights (`culling_grid.sources_of`, `targets_of`), and marks the cells
   between them (`culling_grid.mark_hulls`).
2. `select_relevant` drops the triangles that overlap no marked cell, and packs the others.

Two differences from the paper: its grid covers the whole scene, while this one covers the box of all segments, so that
cells are smaller. And it visits all cells that a triangle overlaps, while this module queries a summed-volume table,
which takes eight numbers for any range of cells; a huge triangle costs no more than a small one.

The module also selects the input of builders and of tracers without a tree: the solid triangles of a scene, without
cut-outs, clear faces and triangles of zero area.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import Bvh
from ...bvh.triangle_bounds import corners_of
from ...kernels.jit import I32Ptr, U8Ptr, inlined, kernel
from ...kernels.parallel import CHUNK, items, new_ticket, run, shares, thread_count
from ...kernels.simd import all_lanes, extract, get, load4, load8, mask_from_bits4, maximum, minimum, ptr, put, store
from ...query.query_bounds import triangle_box
from ...query.shadow_query import ShadowQuery
from ...scene.triangle_setup import solid_vertices
from ...scene.triangles import Triangles
from .culling_grid import (
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

# --- The triangles that overlap a marked cell [Selgrad et al. 2015, Sec. 3.3] -----------------------------------------

_CHUNK = 8192  # triangles per work item
_SAMPLE = 4096  # triangles in the sample of `relevant_share`
_KEPT = 1 << 24  # indices of triangles that outlive their scene: 64 MB, as much as `recycled_empty` keeps


class MarkedCells(NamedTuple):
    """Marked cells, and their summed-volume table, which gives the number of marked cells in any range."""

    cells: np.ndarray  # (n, n, n) uint8: 1: marked
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
    """Worker: add the sums of the preceding layers, row by row."""
    n = len(sums)
    for y in items(ticket):
        for x in range(1, n):
            for z in range(1, n):
                sums[x, y, z] += sums[x - 1, y, z]


def marked_cells_of(cells: NDArray[np.uint8], threads: int) -> MarkedCells:
    """The `MarkedCells` of cells, (n, n, n) uint8."""
    n = len(cells)
    sums = np.zeros((n + 1, n + 1, n + 1), np.int32)
    run(_sum_slabs, threads, new_ticket(n, 1), cells, sums)
    run(_sum_across, threads, new_ticket(n + 1, 1), sums)
    return MarkedCells(cells, sums)


class Table(NamedTuple):
    """Pointers to the arrays of `MarkedCells` and of the grid, which must outlive them."""

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
def overlaps_marked(table, low, high):
    """Whether a box that overlaps the grid (f32x4 each) overlaps a marked cell."""
    first, last = cells_at(table.grid, low), cells_at(table.grid, high)
    number = cell_number(table.grid, first)
    if number == cell_number(table.grid, last):
        return get(table.cells, number) != 0
    return _any_marked(table, first, last)


@inlined
def _is_relevant(corners, i, table):
    """Whether the box of triangle i overlaps the grid and a marked cell."""
    a, b, c = corners_of(corners, i)
    low, high = minimum(minimum(a, b), c), maximum(maximum(a, b), c)
    fourth = mask_from_bits4(8)  # the fourth lanes always pass
    inside = (low <= load4(table.grid.bounds, 4)) & (high >= load4(table.grid.bounds, 0)) | fourth
    return overlaps_marked(table, low, high) if all_lanes(inside) else False


@kernel
def _find(ticket, corners, grid, marks, ids, counts):
    """Worker: write the relevant triangles of each chunk to `ids`, starting at the chunk's first index."""
    values, out = ptr(corners), ptr(ids)
    table = Table(ptr(marks.cells), ptr(marks.sums), pointers_of(grid))
    for first, last in shares(ticket):
        n = first
        for i in range(first, last):
            put(out, n, i)
            if _is_relevant(values, i, table):
                n += 1
        counts[first // ticket[CHUNK]] = n - first


@kernel
def _pack(ticket, corners, relevant, counts, starts, ids, packed):
    """Worker: copy the relevant triangles of each chunk to `ids` and `packed`, without gaps."""
    source, target = ptr(corners), ptr(packed)
    for chunk in items(ticket):
        for k in range(counts[chunk]):
            i, place = np.int64(relevant[chunk * _CHUNK + k]), starts[chunk] + k
            ids[place] = i
            store(target, place * 9, load8(source, i * 9))
            put(target, place * 9 + 8, get(source, i * 9 + 8))


class RelevantTriangles(NamedTuple):
    """The triangles that overlap a marked cell, chunk by chunk."""

    ids: np.ndarray  # (n,) int32: indices; those of a chunk start at the chunk's first index
    counts: np.ndarray  # (chunks,) int64: number of them in each chunk


def find_relevant(corners: NDArray[np.float32], grid: CellGrid, marks: MarkedCells, threads: int) -> RelevantTriangles:
    """Find the triangles, (n, 9) float32, that overlap a marked cell."""
    relevant = RelevantTriangles(np.empty(len(corners), np.int32), np.zeros(-(-len(corners) // _CHUNK), np.int64))
    run(_find, threads, new_ticket(len(corners), _CHUNK), corners, grid, marks, *relevant)
    return relevant


def pack_relevant(
    corners: NDArray[np.float32], relevant: RelevantTriangles, threads: int
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Indices, (m,) int32 and ascending, and corners, (m, 9) float32, of the relevant triangles."""
    counts, total = relevant.counts, int(relevant.counts.sum())
    ids, packed = np.empty(total, np.int32), np.empty((total, 9), np.float32)
    starts = np.cumsum(counts) - counts
    run(_pack, threads, new_ticket(len(counts), 1), corners, relevant.ids, counts, starts, ids, packed)
    return ids, packed


# --- Culling ----------------------------------------------------------------------------------------------------------

STEPS = ("sources", "mark", "triangles", "pack")
"""The steps of culling: sort receivers into cells, mark cells, find the relevant triangles, pack them."""


QueryGroup: TypeAlias = tuple[ReceiverTiles, list[ShadowQuery]]
"""Receivers, and the queries that share them."""

Box: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Lower and upper corner, (3,) float64."""


def segment_box(groups: Sequence[QueryGroup], triangles: NDArray[np.float32]) -> Box | None:
    """The intersection of the box of all segments and the box of all triangles, (2, 3); None if it is empty."""
    return box_of_segments([(np.array(bounds_of(tiles)), queries) for tiles, queries in groups], triangles)


def box_of_segments(
    groups: Iterable[tuple[NDArray[np.float64], Sequence[ShadowQuery]]], triangles: NDArray[np.float32]
) -> Box | None:
    """`segment_box` of groups of receivers' boxes and queries; `triangles`: box of all triangles; (2, 3) each."""
    everywhere = np.full(3, np.inf)
    low, high = everywhere, -everywhere
    for receivers, queries in groups:
        for query in queries:
            targets = targets_of(query, everywhere)
            ends = targets.boxes[0] + (receivers if targets.relative else 0.0)
            low = np.minimum(low, np.minimum(receivers[0], ends[0]))
            high = np.maximum(high, np.maximum(receivers[1], ends[1]))
    low, high = np.maximum(low, triangles[0]), np.minimum(high, triangles[1])
    return (low, high) if (low <= high).all() else None


class MarkingMethod(NamedTuple):
    """A way to mark the cells between receivers and lights, in three functions."""

    box: Callable[[Sequence[QueryGroup], NDArray[np.float32]], Box | None]
    """The grid's box, from groups with receivers, and the box of all triangles, (2, 3); None: nothing to keep."""
    sources: Callable[[ReceiverTiles, CellGrid, int], NDArray[Any]]
    """The places of receivers in the grid, one per row, as `mark` takes them."""
    mark: Callable[[NDArray[Any], ShadowQuery, CellGrid, NDArray[np.uint8], int], int]
    """Marks the cells between sources and the light of a query, as `mark_hulls`; returns the number of targets."""


HULLS = MarkingMethod(segment_box, sources_of, mark_hulls)
"""Hulls of boxes of receivers and of light samples, in a grid over the segments."""


class CullResult(NamedTuple):
    """The remaining triangles of a scene, with the grid that culling used."""

    kept: np.ndarray  # (m,) int32, ascending: indices of the remaining triangles
    vertices: np.ndarray  # (m, 3, 3) float32: their vertices
    grid: CellGrid | None  # None: there is no segment, or no segment can meet a triangle
    marked: np.ndarray | None  # (n, n, n) uint8: 1: segments may enter the cell
    sources: int  # number of source boxes or cells
    targets: int  # number of target boxes or cells


class CullRequest(NamedTuple):
    """What a tracer needs to do what `cull` does by the method HULLS."""

    queries: Sequence[ShadowQuery]
    n: int  # cells of the grid per axis
    threads: int
    lap: Callable[[str], None]  # called with "cull" afterwards


class Marking(NamedTuple):
    """The grid of a set of queries, with the cells that their segments may enter marked."""

    grid: CellGrid
    cells: MarkedCells
    sources: int  # number of source boxes or cells
    targets: int  # number of target boxes or cells


def mark_segments(
    triangles: Triangles,
    queries: Sequence[ShadowQuery],
    threads: int | None = None,
    *,
    n: int = 32,
    method: MarkingMethod = HULLS,
    lap: Callable[[str], None] = lambda step: None,
) -> Marking | None:
    """Mark the cells that segments of the queries may enter; None: no segment can meet a triangle.

    The parameters are those of `cull`.
    """
    threads = thread_count(threads)
    groups = _groups(queries, threads)
    grid = _grid_of(groups, triangles, threads, n, method.box)
    if grid is None:
        return None
    marked, counts = np.zeros((n, n, n), np.uint8), np.zeros(2, np.int64)
    for tiles, group_queries in groups:
        sources = method.sources(tiles, grid, threads)
        lap("sources")
        counts += len(sources), sum(method.mark(sources, query, grid, marked, threads) for query in group_queries)
        lap("mark")
    return Marking(grid, marked_cells_of(marked, threads), *counts.tolist())


def select_relevant(
    triangles: Triangles,
    marking: Marking | None,
    threads: int | None = None,
    lap: Callable[[str], None] = lambda step: None,
) -> CullResult:
    """The triangles that overlap a marked cell."""
    if marking is None:
        return CullResult(np.empty(0, np.int32), np.empty((0, 3, 3), np.float32), None, None, 0, 0)
    threads, corners = thread_count(threads), triangles.vertices.reshape(-1, 9)
    relevant = find_relevant(corners, marking.grid, marking.cells, threads)
    lap("triangles")
    ids, packed = pack_relevant(corners, relevant, threads)
    lap("pack")
    vertices = packed.reshape(-1, 3, 3)
    return CullResult(ids, vertices, marking.grid, marking.cells.cells, marking.sources, marking.targets)


def relevant_share(triangles: Triangles, marking: Marking | None) -> float:
    """The share of the triangles that overlap a marked cell, estimated from an evenly spaced sample of them."""
    if marking is None:
        return 0.0
    sample = np.ascontiguousarray(triangles.vertices[:: -(-len(triangles.vertices) // _SAMPLE)]).reshape(-1, 9)
    return int(find_relevant(sample, marking.grid, marking.cells, 1).counts.sum()) / len(sample)


def cull(
    triangles: Triangles,
    queries: Sequence[ShadowQuery],
    threads: int | None = None,
    *,
    n: int = 32,
    method: MarkingMethod = HULLS,
    lap: Callable[[str], None] = lambda step: None,
) -> CullResult:
    """Find a superset of the triangles that the segments of the queries meet.

    Answers for the remaining triangles equal those for all triangles, bit for bit.

    Parameters
    ----------
    triangles : Triangles
        All triangles of the scene.
    queries : list of ShadowQuery
        They must have every sample that will be traced.
    threads : int or None
        None: all cores.
    n : int
        Cells of the grid per axis.
    method : MarkingMethod
        Marks the cells between receivers and lights.
    lap : function of str
        Called after each step, with its name from STEPS.
    """
    marking = mark_segments(triangles, queries, threads, n=n, method=method, lap=lap)
    return select_relevant(triangles, marking, threads, lap)


def _grid_of(
    groups: Sequence[QueryGroup],
    triangles: Triangles,
    threads: int,
    n: int,
    box_of: Callable[[Sequence[QueryGroup], NDArray[np.float32]], Box | None],
) -> CellGrid | None:
    """The grid of groups of queries; None: no segment can meet a triangle."""
    box = box_of(groups, triangle_box(triangles, threads)) if groups and len(triangles.vertices) else None
    return None if box is None else grid_over(*box, n)


def _groups(queries: Sequence[ShadowQuery], threads: int) -> list[QueryGroup]:
    """Group the queries that share their receivers, and skip queries without receivers.

    The receivers of a group are divided into tiles only once.
    """
    groups = [(tiles_of(group[0], threads), group) for group in with_shared_receivers(queries)]
    return [group for group in groups if bounds_of(group[0]) is not None]


def with_shared_receivers(queries: Sequence[ShadowQuery]) -> list[list[ShadowQuery]]:
    """The queries, in groups that share their receivers."""
    groups: dict[tuple[int, ...], list[ShadowQuery]] = {}
    for query in queries:
        groups.setdefault(tuple(map(id, query.receivers)), []).append(query)
    return list(groups.values())


# --- Solid triangles: the triangles of a plan's tree ------------------------------------------------------------------


def solid_of(triangles: Triangles, culled: CullResult | None, threads: int | None) -> CullResult | None:
    """The result of culling without cut-outs, clear faces and triangles of zero area; None: all triangles."""
    solid = triangles.solid
    if solid is None:
        return culled
    if culled is None:
        return CullResult(solid, solid_vertices(triangles, threads), None, None, 0, 0)
    is_solid = np.isin(culled.kept, solid, assume_unique=True)
    return culled._replace(kept=culled.kept[is_solid], vertices=np.ascontiguousarray(culled.vertices[is_solid]))


def solid_count(triangles: Triangles) -> int:
    """The number of solid triangles."""
    return len(triangles.vertices if triangles.solid is None else triangles.solid)


def solid_tree(
    build: Callable[[NDArray[np.float32], int | None], Bvh], triangles: Triangles, threads: int | None
) -> Bvh:
    """Build a tree of the solid triangles."""
    bvh = build(solid_vertices(triangles, threads), threads)
    solid = triangles.solid
    return bvh if solid is None else bvh._replace(prim_ids=solid[bvh.prim_ids])


# --- Triangle soup: the input of tracers without a BVH ----------------------------------------------------------------


class Soup(NamedTuple):
    """All or some triangles of a scene, in scene order."""

    corners: np.ndarray  # (n, 9) float32, recentred frame, C-contiguous
    ids: np.ndarray  # (n,) int32, ascending: index of each triangle in the scene


def soup_of(triangles: Triangles, culled: CullResult | None = None, threads: int | None = None) -> Soup:
    """The `Soup` of a scene's solid triangles, or of those that culling kept; copies nothing if all are solid."""
    if culled is not None:
        return Soup(culled.vertices.reshape(-1, 9), culled.kept)
    if triangles.solid is not None:
        return Soup(solid_vertices(triangles, threads).reshape(-1, 9), triangles.solid)
    return Soup(triangles.vertices.reshape(-1, 9), indices_of(len(triangles.vertices)))


def indices_of(n: int) -> NDArray[np.int32]:
    """(n,) int32: 0 to n - 1, kept for the next frame unless they are many, since new memory takes long.

    Do not write to it.
    """
    return _kept_indices(n) if n <= _KEPT else np.arange(n, dtype=np.int32)


@lru_cache(1)
def _kept_indices(n: int) -> NDArray[np.int32]:
    return np.arange(n, dtype=np.int32)
