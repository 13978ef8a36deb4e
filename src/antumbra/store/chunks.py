"""Cuts sorted triangles into chunks along Morton cells, and builds a tree for each chunk."""

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

_TINY = 8  # a chunk with fewer than an 8th of the most triangles joins a neighbour that has room


def cut(codes: np.ndarray, most: int) -> list[tuple[int, int]]:
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


def built(triangles: Columns, which: np.ndarray) -> Encoded:
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
                for first, last in cut(group.codes, most):
                    waiting.append(pool.submit(built, group.triangles, group.order[first:last]))
                    while len(waiting) > 2 * threads:
                        yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
