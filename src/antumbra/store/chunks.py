"""Chunks out of sorted triangles: cut along Morton cells, each with a tree of its own."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from ..bvh import binned_sah
from ..bvh.lbvh import cut_top
from .columns import Columns
from .palette import palette_of
from .sort import Group
from .write import Encoded, encode_chunk

_TINY = 8  # a chunk has at least an 8th of the triangles that it may have, if a neighbour has room for it


def cut(codes: np.ndarray, most: int) -> list[tuple[int, int]]:
    """First and last + 1 of the chunks of sorted codes: the largest cells of at most so many triangles.

    A tiny cell is joined to one beside it where both together are still small enough.
    """
    chunks: list[tuple[int, int]] = []
    for first, last in cut_top(codes, np.int64(0), most)[1].tolist():
        if chunks and last - chunks[-1][0] <= most and min(last - first, first - chunks[-1][0]) < most // _TINY:
            first, _ = chunks.pop()
        chunks.append((first, last))
    return chunks


def built(triangles: Columns, which: np.ndarray) -> Encoded:
    """The chunk of some of the triangles, with a tree by the SAH [Wald 2007]."""
    bvh = binned_sah.build(triangles.corners[which].reshape(-1, 3, 3), 1)
    slots = which[bvh.prim_ids]
    return encode_chunk(bvh._replace(prim_ids=triangles.ids[slots]), *palette_of(triangles.colours[slots]))


def chunks_of(groups: Iterable[Group], most: int, threads: int) -> Iterator[Encoded]:
    """All chunks, in the order of the groups; each is built by one thread, `threads` at a time."""
    waiting: deque[Future[Encoded]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for group in groups:
                for first, last in cut(group.codes, most):
                    waiting.append(pool.submit(built, group.triangles, group.order[first:last]))
                    while len(waiting) > 2 * threads:
                        yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
