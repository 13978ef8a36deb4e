"""The common frame of top-down builders.

All threads split the first levels together (`top`). Then each thread builds ranges alone, largest first (`subtree`).
`assemble` puts the nodes in one array. The method splits ranges (`splits`).
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import as_i32, atomic_add, get, load8, load16, ptr, store
from .assemble import Subtrees
from .links import LINK, line_at
from .nodes import Bvh, Tree, aligned_empty
from .splits import source_of
from .subtree import build_range
from .top import UpperLevels

_SUBTREES = 64  # the top splits ranges of more than a 64th of all records, so threads finish together
_SMALL = 4096  # the top splits no range of fewer records: one thread builds it before others are awake


def largest_subtree(n: int) -> int:
    """The most records of a range that one thread builds alone, for `n` records in all."""
    return max(_SMALL, n // _SUBTREES)


class _Memory(NamedTuple):
    """A thread's memory for building a subtree."""

    nodes: np.ndarray  # (largest, 16) float32: nodes of a subtree
    scratch: np.ndarray  # (words,) float32, for `source_of`


@kernel
def _build_subtrees(ticket, vertices, method, top, order, settings, bvh, subtrees, next_free, memory):
    """Worker: build the subtrees in `order`, and copy the nodes of each to the next free place."""
    # In: vertices; method, `Binned` or `Swept`; top, `UpperLevels`; order, (s,) int64; settings, of `build_range`
    # Out: bvh, prim_ids and corners; subtrees, `Subtrees`; next_free, (1,) int64, counts nodes
    # Scratch: memory, the thread's own `_Memory`
    room, scratch = memory.nodes, memory.scratch
    out = Tree(ptr(room), as_i32(room), ptr(bvh.prim_ids), ptr(bvh.corners))
    for k in items(ticket):
        s = order[k]
        first, last, depth = top.ranges[s]
        box, centroids = load8(top.range_boxes, s * 16), load8(top.range_boxes, s * 16 + 8)
        source = source_of(method, depth, ptr(scratch))
        count = build_range(ptr(vertices), source, first, last, depth, box, centroids, settings, s, out)
        at = atomic_add(next_free, 0, count)
        for i in range(count):
            store(subtrees.nodes, line_at(at + i), load16(room, line_at(i + 1)))
        subtrees.shares[s, 0], subtrees.shares[s, 1], subtrees.shares[s, 2] = at, count, get(out.links, LINK)


def build_below(flat, method, words: int, top: UpperLevels, settings, threads: int) -> tuple[Bvh, Subtrees]:
    """Build the subtrees below the top over the triangles `flat`, (n, 9) float32. `assemble` completes the tree.

    words : float32 of scratch memory that `source_of` needs
    """
    n, s = len(flat), len(top.ranges)
    subtrees = Subtrees(aligned_empty((n, 16), "f4"), np.empty((s, 3), np.int64))
    bvh = Bvh(subtrees.nodes, subtrees.nodes.view(np.int32), np.empty(n, np.int32), np.empty((n, 9), np.float32))
    sizes = top.ranges[:, 1] - top.ranges[:, 0]
    order, largest = np.argsort(-sizes, kind="stable"), int(sizes.max())
    next_free, args = np.zeros(1, np.int64), (flat, method, top, order, settings, bvh, subtrees)
    own = lambda: (_Memory(aligned_empty((largest, 16), "f4"), np.empty(words, np.float32)),)
    run(_build_subtrees, threads, new_ticket(s, 1), *args, next_free, own=own)
    return bvh, subtrees
