"""Sort any number of triangles by Morton code, cut them into chunks along Morton cells, and build a tree for each.

Sorting. If the triangles do not fit in memory, they are distributed to buckets in files, by the leading bits of their
codes. These bits are counted first, so the place of each bucket in the files is known. A cell is all codes with the
same first bits. A bucket is the largest cell with few enough triangles. A cell that is still too large is distributed
by its next bits. The triangles alone decide the groups; the amount of memory does not.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..bvh import binned_sah
from ..bvh.lbvh import cut_top
from ..bvh.morton_sort import Grid, radix_sort, write_codes
from ..bvh.triangle_bounds import TRIANGLES_PER_SHARE
from ..kernels.parallel import new_ticket, run
from .staging_files import Batches, Buckets, TriangleColumns, empty_columns, palette_of
from .store_file import Encoded, encode_chunk

# --- Sorts any number of triangles by their Morton codes --------------------------------------------------------------
#
# If the triangles do not fit in memory, they are distributed to buckets in files, by the leading bits of their codes.
# These bits are counted first, so the place of each bucket in the files is known. A cell is all codes with the same
# first bits. A bucket is the largest cell with few enough triangles. A cell that is still too large is distributed by
# its next bits. The triangles alone decide the groups; the amount of memory does not.


AXIS_BITS = 21
CODE_BITS = 3 * AXIS_BITS
_LEVEL_BITS = 21  # bits that are counted at a time: 128 cells along each axis


class Group(NamedTuple):
    """Triangles with consecutive codes."""

    triangles: TriangleColumns
    codes: np.ndarray  # (n,) int64, ascending
    order: np.ndarray  # (n,) int32: the index of each code's triangle


class Sorting(NamedTuple):
    """The settings of a sort."""

    grid: Grid
    folder: Path  # folder of temporary files
    most: int  # most triangles in a group
    batch: int  # triangles that are distributed at a time
    threads: int
    heard: Callable[[int], None]  # called with the number of triangles just counted or distributed


def grid_over(box: np.ndarray) -> Grid:
    """The Morton grid over the bounds of all vertices, (2, 3) float32."""
    lower, upper = box.astype(np.float64)
    extent = (upper - lower).max()
    factor = np.float32(2.0**AXIS_BITS / (2.0 * extent)) if extent > 0.0 else np.float32(0.0)
    origin = np.append(2.0 * lower, 0.0).astype(np.float32)
    return Grid(origin, factor if np.isfinite(factor) else np.float32(0.0), np.int32(2**AXIS_BITS - 1))


def groups(sorting: Sorting, batches: Batches, n: int, done: Callable[[], None], used: int = 0) -> Iterator[Group]:
    """Yield at most `n` triangles in groups. Groups, and the triangles of each group, are in the order of their codes.

    Triangles of equal codes keep their order. `done` is called when the batches are not needed any more. `used` is the
    number of leading bits that the codes of all these triangles share.
    """
    if n <= sorting.most or used == CODE_BITS:
        for batch in [_joined(batches(), n)] if n <= sorting.most else batches():
            yield _sorted(sorting, batch)
        done()
        return
    shift = CODE_BITS - used - _LEVEL_BITS
    counts = _counted(sorting, batches, shift)
    cells = _cells(counts, sorting.most)
    sizes = np.array([counts[first:last].sum() for first, last in cells])
    buckets = Buckets(sorting.folder, sizes)
    try:
        _distribute(sorting, batches, shift, cells, buckets)
        done()
        for k, size in enumerate(sizes.tolist()):
            yield from groups(
                sorting, lambda k=k: buckets.batches(k, sorting.most), size, lambda: None, used + _LEVEL_BITS
            )
    finally:
        buckets.close()


def _joined(batches: Iterator[TriangleColumns], n: int) -> TriangleColumns:
    """All batches of at most `n` triangles as one."""
    whole, at = empty_columns(n), 0
    for batch in batches:
        if len(batch.ids) == n:
            return batch
        for column, part in zip(whole, batch):
            column[at : at + len(part)] = part
        at += len(batch.ids)
    return whole.rows(slice(at))


def _codes(sorting: Sorting, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(codes, 0 to n - 1) of triangles."""
    codes, numbers = np.empty(len(corners), np.int64), np.empty(len(corners), np.int32)
    ticket = new_ticket(len(corners), TRIANGLES_PER_SHARE)
    run(write_codes, sorting.threads, ticket, corners, sorting.grid, codes, numbers)
    return codes, numbers


def _sorted(sorting: Sorting, triangles: TriangleColumns) -> Group:
    codes, numbers = _codes(sorting, triangles.corners)
    return Group(triangles, *radix_sort(codes, numbers, CODE_BITS, sorting.threads))


def _counted(sorting: Sorting, batches: Batches, shift: int) -> np.ndarray:
    """(2 ** _LEVEL_BITS,) int64: the number of triangles of each cell."""
    counts = np.zeros(1 << _LEVEL_BITS, np.int64)
    for batch in batches():
        codes, _ = _codes(sorting, batch.corners)
        counts += np.bincount(codes >> shift & (len(counts) - 1), minlength=len(counts))
        sorting.heard(len(codes))
    return counts


def _cells(counts: np.ndarray, most: int) -> list[tuple[int, int]]:
    """The largest cells with at most `most` triangles, and the smallest cells that have more, in order.

    Each is a pair of indices in `counts`: the first, and the one behind the last.
    """
    before = np.concatenate([[0], np.cumsum(counts)])
    waiting, found = [(0, len(counts))], []
    while waiting:
        first, last = waiting.pop()
        n = before[last] - before[first]
        if n > most and last - first > 1:
            middle = (first + last) // 2
            waiting += [(middle, last), (first, middle)]
        elif n:
            found.append((first, last))
    return found


def _distribute(sorting: Sorting, batches: Batches, shift: int, cells: list[tuple[int, int]], buckets: Buckets):
    """Write each triangle to the bucket of its cell. All codes have the same bits above those of the cells."""
    n_cells = 1 << _LEVEL_BITS
    bucket_of = np.zeros(n_cells, np.uint16 if len(cells) <= 1 << 16 else np.int32)  # 16 bits sort fast
    for k, (first, last) in enumerate(cells):
        bucket_of[first:last] = k
    for batch in batches():
        codes, _ = _codes(sorting, batch.corners)
        bucket = bucket_of[codes >> shift & (n_cells - 1)]
        order = np.argsort(bucket, kind="stable")
        sizes = np.bincount(bucket, minlength=1)
        ends = np.cumsum(sizes)
        for k in np.flatnonzero(sizes).tolist():
            buckets.add(k, batch.rows(order[ends[k] - sizes[k] : ends[k]]))
        sorting.heard(len(codes))


# --- Cuts sorted triangles into chunks along Morton cells, and builds a tree for each chunk ---------------------------


_TINY = 8  # a chunk with fewer than an 8th of the most triangles joins a neighbour that has room


def cut_chunks(codes: np.ndarray, most: int) -> list[tuple[int, int]]:
    """Cut sorted codes into chunks: the largest Morton cells of at most `most` triangles.

    A tiny cell is joined to a neighbour if both together have at most `most` triangles. Each chunk is a pair: the index
    of its first code, and the index behind its last one.
    """
    chunks: list[tuple[int, int]] = []
    for first, last in cut_top(codes, np.int64(0), most)[1].tolist():
        if chunks and last - chunks[-1][0] <= most and min(last - first, first - chunks[-1][0]) < most // _TINY:
            first, _ = chunks.pop()
        chunks.append((first, last))
    return chunks


def build_chunk(triangles: TriangleColumns, which: np.ndarray) -> Encoded:
    """Make the chunk of the triangles `which`, with a tree by binned SAH [Wald 2007]."""
    bvh = binned_sah.build(triangles.corners[which].reshape(-1, 3, 3), 1)
    slots = which[bvh.prim_ids]
    return encode_chunk(bvh._replace(prim_ids=triangles.ids[slots]), *palette_of(triangles.colours[slots]))


def chunks_of(groups: Iterable[Group], most: int, threads: int) -> Iterator[Encoded]:
    """Yield all chunks, in the order of the groups. One thread builds a chunk; `threads` are built at a time."""
    waiting: deque[Future[Encoded]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for group in groups:
                for first, last in cut_chunks(group.codes, most):
                    waiting.append(pool.submit(build_chunk, group.triangles, group.order[first:last]))
                    while len(waiting) > 2 * threads:
                        yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
