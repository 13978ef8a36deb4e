"""Finds the triangles that overlap a marked cell, and packs them together [Selgrad et al. 2015, Sec. 3.3].

The paper looks at all cells that a triangle overlaps. Here a summed-volume table answers for any range of cells with
eight numbers. So a huge triangle costs no more than a small one.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.bounds import corners_of
from ..kernels.fields import I32Ptr, U8Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, shares
from ..kernels.simd import all_lanes, extract, get, load4, load8, mask_from_bits4, maximum, minimum, ptr, put, store
from .grid import GridPointers, cell_number, cells_at, pointers_of

_CHUNK = 8192  # triangles


class Marks(NamedTuple):
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


def marks_of(cells: np.ndarray, threads: int) -> Marks:
    """The `Marks` of cells, (n, n, n) uint8."""
    n = len(cells)
    sums = np.zeros((n + 1, n + 1, n + 1), np.int32)
    run(_sum_slabs, threads, new_ticket(n, 1), cells, sums)
    run(_sum_across, threads, new_ticket(n + 1, 1), sums)
    return Marks(cells, sums)


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


class Found(NamedTuple):
    """The triangles that overlap a marked cell, chunk by chunk."""

    ids: np.ndarray  # (n,) int32: indices, those of each chunk from the chunk's first place on
    counts: np.ndarray  # (chunks,) int64: how many there are in each chunk


def find(corners: np.ndarray, grid, marks: Marks, threads: int) -> Found:
    """Find the triangles, (n, 9) float32, that overlap a marked cell."""
    found = Found(np.empty(len(corners), np.int32), np.zeros(-(-len(corners) // _CHUNK), np.int64))
    run(_find, threads, new_ticket(len(corners), _CHUNK), corners, grid, marks, *found)
    return found


def pack(corners: np.ndarray, found: Found, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices, (m,) int32 and ascending, and corners, (m, 9) float32, of the triangles that were found."""
    counts, total = found.counts, int(found.counts.sum())
    kept, packed = np.empty(total, np.int32), np.empty((total, 9), np.float32)
    starts = np.cumsum(counts) - counts
    run(_pack, threads, new_ticket(len(counts), 1), corners, found.ids, counts, starts, kept, packed)
    return kept, packed
