"""The common frame of top-down builders.

The first levels are split by all threads (`top`); each then takes ranges to build alone (`subtree`), largest first; and
the nodes are put in one array (`assemble`). How ranges are split is the method's affair (`splits`).
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import new_ticket, run, take
from ..kernels.simd import as_i32, atomic_add, get, load8, load16, ptr, store
from .assemble import Subtrees
from .nodes import Bvh, Tree, aligned_empty
from .splits import source_of
from .subtree import build_range
from .top import Top

_SUBTREES = 64  # the top splits ranges of more than a 64th of all records, so that threads finish together ...
_SMALL = 4096  # ... but none of fewer records than this, which one thread builds before others are awake


def largest_subtree(n: int) -> int:
    """Ranges of more than this many of `n` records are split by all threads."""
    return max(_SMALL, n // _SUBTREES)


class _Memory(NamedTuple):
    """What a thread builds a subtree in."""

    nodes: np.ndarray  # (largest, 16) float32: nodes of a subtree
    scratch: np.ndarray  # (words,) float32, for `source_of`


@kernel
def _build_subtrees(ticket, vertices, method, top, order, settings, bvh, subtrees, next_free, memory):
    """Worker: build the subtrees, in the order given, and put the nodes of each where there is room."""
    room, scratch = memory.nodes, memory.scratch
    out = Tree(ptr(room), as_i32(room), ptr(bvh.prim_ids), ptr(bvh.corners))
    k = take(ticket)
    while k >= 0:
        s = order[k]
        first, last, depth = top.ranges[s]
        box, centroids = load8(top.range_boxes, s * 16), load8(top.range_boxes, s * 16 + 8)
        source = source_of(method, depth, ptr(scratch))
        count = build_range(ptr(vertices), source, first, last, depth, box, centroids, settings, s, out)
        at = atomic_add(next_free, 0, count)
        for i in range(count):
            store(subtrees.nodes, (at + i) * 16, load16(room, (i + 1) * 16))
        subtrees.shares[s, 0], subtrees.shares[s, 1], subtrees.shares[s, 2] = at, count, get(out.links, 12)
        k = take(ticket)


def build_below(flat, method, words: int, top: Top, settings, threads: int) -> tuple[Bvh, Subtrees]:
    """What comes below the top, over the triangles `flat`, (n, 9) float32, for `assemble` to complete.

    `words` is how many float32 of scratch memory `source_of` asks for.
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
