"""Sort any number of triangles by Morton code, cut them into chunks along Morton cells, and build a tree for each.

Runs of triangles that fit in memory are sorted by the leading bits of their codes, and written to files with the number
of triangles of each cell, that is, of all codes that share these bits. A bucket is the largest cell with few enough
triangles in all runs, and the counts give its place in each. A cell that is still too large is distributed to buckets
of its own by its next bits, which a first pass counts. The groups depend on the triangles alone, not on the amount of
memory.
"""

from collections import deque
from collections.abc import Generator, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..bvh import binned_sah
from ..bvh.block_tree import block_tree
from ..bvh.compact_tree import compact
from ..bvh.lbvh import split_top
from ..bvh.morton_sort import Grid, radix_sort, write_codes
from ..bvh.triangle_bounds import TRIANGLES_PER_SHARE
from ..kernels.parallel import new_ticket, run
from .staging_files import Batches, Buckets, TriangleColumns, empty_columns, palette_of
from .store_writer import EncodedChunk, encode_chunk

# --- Sorting by Morton code -------------------------------------------------------------------------------------------


AXIS_BITS = 21
CODE_BITS = 3 * AXIS_BITS
LEVEL_BITS = 21  # bits per pass: 128 cells along each axis


class Group(NamedTuple):
    """Triangles with consecutive codes."""

    triangles: TriangleColumns
    codes: NDArray[np.int64]  # (n,), ascending
    order: NDArray[np.int32]  # (n,): the index of each code's triangle


class SortSettings(NamedTuple):
    """The settings of a sort."""

    grid: Grid
    folder: Path  # folder of temporary files
    max_triangles: int  # in a group
    threads: int


def grid_over(box: np.ndarray) -> Grid:
    """The Morton grid over the bounds of all vertices, (2, 3) float32."""
    lower, upper = box.astype(np.float64)
    extent = (upper - lower).max()
    factor = np.float32(2.0**AXIS_BITS / (2.0 * extent)) if extent > 0.0 else np.float32(0.0)
    origin = np.append(2.0 * lower, 0.0).astype(np.float32)
    return Grid(origin, factor if np.isfinite(factor) else np.float32(0.0), np.int32(2**AXIS_BITS - 1))


def sorted_by_cell(settings: SortSettings, triangles: TriangleColumns) -> tuple[TriangleColumns, NDArray[np.int32]]:
    """(the triangles by ascending cell, the cell of each). The sort is stable; a cell is the first LEVEL_BITS bits."""
    codes, numbers = _codes(settings, triangles.corners)
    cells = (codes >> (CODE_BITS - LEVEL_BITS)).astype(np.int32)
    ordered, order = radix_sort(cells, numbers, LEVEL_BITS, settings.threads)
    return triangles.rows(order), cast(NDArray[np.int32], ordered)


def sorted_groups(settings: SortSettings, batches: Batches, n: int, shared_bits: int = LEVEL_BITS) -> Iterator[Group]:
    """Yield at most `n` triangles in groups, sorted by code across and within groups. The sort is stable.

    shared_bits : number of leading bits that the codes of all these triangles share, unless they form one group
    """
    if n <= settings.max_triangles or shared_bits == CODE_BITS:
        for batch in [_concatenated(batches(), n)] if n <= settings.max_triangles else batches():
            yield _sort(settings, batch)
        return
    shift = CODE_BITS - shared_bits - LEVEL_BITS
    counts = _count_cells(settings, batches, shift)
    cells = bucket_cells(counts, settings.max_triangles)
    sizes = np.array([counts[first:last].sum() for first, last in cells])
    buckets = Buckets(settings.folder, sizes)
    try:
        _distribute(settings, batches, shift, cells, buckets)
        for k, size in enumerate(sizes.tolist()):
            of_bucket = partial(buckets.batches, k, settings.max_triangles)
            yield from sorted_groups(settings, of_bucket, size, shared_bits + LEVEL_BITS)
    finally:
        buckets.close()


def _concatenated(batches: Iterator[TriangleColumns], n: int) -> TriangleColumns:
    """Concatenate batches of at most `n` triangles in total."""
    columns, at = empty_columns(n), 0
    for batch in batches:
        if len(batch.ids) == n:
            return batch
        for column, part in zip(columns, batch):
            column[at : at + len(part)] = part
        at += len(batch.ids)
    return columns.rows(slice(at))


def _codes(settings: SortSettings, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(codes, numbers from 0 to n - 1) of triangles."""
    codes, numbers = np.empty(len(corners), np.int64), np.empty(len(corners), np.int32)
    ticket = new_ticket(len(corners), TRIANGLES_PER_SHARE)
    run(write_codes, settings.threads, ticket, corners, settings.grid, codes, numbers)
    return codes, numbers


def _sort(settings: SortSettings, triangles: TriangleColumns) -> Group:
    codes, numbers = _codes(settings, triangles.corners)
    ordered, order = radix_sort(codes, numbers, CODE_BITS, settings.threads)
    return Group(triangles, cast(NDArray[np.int64], ordered), order)


def _count_cells(settings: SortSettings, batches: Batches, shift: int) -> np.ndarray:
    """(2 ** LEVEL_BITS,) int64: the number of triangles in each cell."""
    counts = np.zeros(1 << LEVEL_BITS, np.int64)
    for batch in batches():
        codes, _ = _codes(settings, batch.corners)
        counts += np.bincount(codes >> shift & (len(counts) - 1), minlength=len(counts))
    return counts


def bucket_cells(counts: np.ndarray, max_triangles: int) -> list[tuple[int, int]]:
    """The largest cells with at most `max_triangles` triangles, and the smallest cells that have more, in order.

    Each is a half-open range of indices in `counts`.
    """
    before = np.concatenate([[0], np.cumsum(counts)])
    stack, cells = [(0, len(counts))], []
    while stack:
        first, last = stack.pop()
        n = before[last] - before[first]
        if n > max_triangles and last - first > 1:
            middle = (first + last) // 2
            stack += [(middle, last), (first, middle)]
        elif n:
            cells.append((first, last))
    return cells


def _distribute(
    settings: SortSettings, batches: Batches, shift: int, cells: list[tuple[int, int]], buckets: Buckets
) -> None:
    """Write each triangle to the bucket of its cell. All codes have the same bits above those of the cells."""
    n_cells = 1 << LEVEL_BITS
    bucket_of = np.zeros(n_cells, np.uint16 if len(cells) <= 1 << 16 else np.int32)  # 16 bits sort fast
    for k, (first, last) in enumerate(cells):
        bucket_of[first:last] = k
    for batch in batches():
        codes, _ = _codes(settings, batch.corners)
        bucket = bucket_of[codes >> shift & (n_cells - 1)]
        order = np.argsort(bucket, kind="stable")
        sizes = np.bincount(bucket, minlength=1)
        ends = np.cumsum(sizes)
        for k in np.flatnonzero(sizes).tolist():
            buckets.add(k, batch.rows(order[ends[k] - sizes[k] : ends[k]]))


# --- Chunks -----------------------------------------------------------------------------------------------------------


_TINY = 8  # a chunk of fewer than max_triangles // 8 triangles is merged with a neighbour if the limit allows


def cut_chunks(codes: np.ndarray, max_triangles: int) -> list[tuple[int, int]]:
    """Cut sorted codes into chunks: the largest Morton cells of at most `max_triangles` triangles.

    A tiny cell is merged with a neighbour if the two have at most `max_triangles` triangles in total. Each chunk is a
    half-open range of indices of codes.
    """
    chunks: list[tuple[int, int]] = []
    for first, last in split_top(codes, np.int64(0), max_triangles)[1].tolist():
        if (
            chunks
            and last - chunks[-1][0] <= max_triangles
            and min(last - first, first - chunks[-1][0]) < max_triangles // _TINY
        ):
            first, _ = chunks.pop()
        chunks.append((first, last))
    return chunks


def build_chunk(triangles: TriangleColumns, rows: np.ndarray) -> EncodedChunk:
    """Build the chunk of the triangles `rows`, with a binned-SAH tree [Wald 2007]."""
    tree = compact(block_tree(binned_sah.build(triangles.corners[rows].reshape(-1, 3, 3), 1), 1))
    slots = rows[tree.prim_ids]
    return encode_chunk(tree._replace(prim_ids=triangles.ids[slots]), *palette_of(triangles.colours[slots]))


def chunks_of(groups: Iterable[Group], max_triangles: int, threads: int) -> Generator[EncodedChunk, None, None]:
    """Yield the chunks of all groups in order. Each chunk is built by one thread, up to `threads` of them at a time."""
    futures: deque[Future[EncodedChunk]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for group in groups:
                for first, last in cut_chunks(group.codes, max_triangles):
                    futures.append(pool.submit(build_chunk, group.triangles, group.order[first:last]))
                    while len(futures) > 2 * threads:
                        yield futures.popleft().result()
            while futures:
                yield futures.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
