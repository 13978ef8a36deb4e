"""`bsah`: binned SAH, in parallel [Wald 2007, "On fast construction of SAH-based bounding volume hierarchies"].

The boxes of all triangles become records; all threads together split the first levels (`top`); each then takes
ranges to build alone (`subtree`), largest first; and the nodes are put in one array (`assemble`). Departures from the
paper: few bins for few records, and for four records or fewer the best of all trees (`smallest`).
"""

from functools import cache

import numpy as np

from ..jit import kernel
from ..parallel import new_ticket, run, take, thread_count
from ..simd import as_i32, atomic_add, get, load8, load16, ptr, store
from .assemble import Subtrees, assemble
from .nodes import Bvh, Tree, aligned_empty
from .prepare import checked, make_records, power_of_two_for, tiny
from .subtree import Settings, build_subtree
from .top import build_top

_SUBTREES = 64  # the top splits ranges of more than a 64th of all records, so that threads finish together ...
_SMALL = 4096  # ... but none of fewer records than this, which one thread builds before others are awake


@kernel
def _build_subtrees(ticket, vertices, sources, top, order, settings, bvh, subtrees, next_free):
    """Worker: build the subtrees, in the order given, and put the nodes of each where there is room."""
    largest = top.ranges[order[0], 1] - top.ranges[order[0], 0]
    room = np.empty((largest, 16), np.float32)
    out = Tree(ptr(room), as_i32(room), ptr(bvh.prim_ids), ptr(bvh.corners))
    k = take(ticket)
    while k >= 0:
        s = order[k]
        first, last, depth, where = top.ranges[s]
        box, centroids = load8(top.range_boxes, s * 16), load8(top.range_boxes, s * 16 + 8)
        count = build_subtree(ptr(vertices), ptr(sources[where]), first, last, depth, box, centroids, settings, out)
        at = atomic_add(next_free, 0, count)
        for i in range(count):
            store(subtrees.nodes, (at + i) * 16, load16(room, (i + 1) * 16))
        subtrees.shares[s, 0], subtrees.shares[s, 1], subtrees.shares[s, 2] = at, count, get(out.links, 12)
        k = take(ticket)


@cache
def _compile_top() -> None:
    """Compile, or load, what only large scenes run too, so that the first build of a process readies all later ones."""
    pair = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2, 2, 2], [3, 2, 2], [2, 3, 2]]], np.float32).reshape(2, 9)
    records, spare = aligned_empty((2, 8), "f4"), aligned_empty((2, 8), "f4")
    build_top(records, spare, *make_records(pair, records, 1), np.float32(1.0), 1, 1)


def build(vertices: np.ndarray, threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH by binned SAH; the same, bit for bit, for any number of threads.

    Parameters
    ----------
    vertices : (n, 3, 3) float32
        Corners of triangles, of magnitude less than MAX_COORDINATE. Triangles may be equal, or have no area.
    threads : int or None
        None: all cores.
    max_leaf : int
        Triangles in a leaf, 1 to MAX_LEAF.

    Returns
    -------
    Bvh
        Boxes are the exact bounds of the vertices, not padded. A left child comes right behind its parent.

    Raises
    ------
    InputError
        On another shape or dtype, too many triangles, or a coordinate that is not finite or too large.

    Notes
    -----
    Visiting a node costs 1 and a triangle 1. A range is halved where no split has a finite cost, since all its
    centroids are in one point, and where it has so many records at its depth that MAX_DEPTH is in danger.
    """
    flat, threads = checked(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    _compile_top()
    if n < 2:
        make_records(flat, np.empty((n, 8), np.float32), 1)
        return tiny(flat)
    sources = aligned_empty((n, 8), "f4"), aligned_empty((n, 8), "f4")
    box, centroids = make_records(flat, sources[0], threads)
    settings = Settings(np.int64(max_leaf), power_of_two_for(box))
    top = build_top(*sources, box, centroids, settings.scale, max(_SMALL, n // _SUBTREES), threads)
    s = len(top.ranges)
    subtrees = Subtrees(aligned_empty((n, 16), "f4"), np.empty((s, 3), np.int64))
    bvh = Bvh(subtrees.nodes, subtrees.nodes.view(np.int32), np.empty(n, np.int32), np.empty((n, 9), np.float32))
    order = np.argsort(top.ranges[:, 0] - top.ranges[:, 1], kind="stable")
    next_free = np.zeros(1, np.int64)
    run(_build_subtrees, threads, new_ticket(s, 1), flat, sources, top, order, settings, bvh, subtrees, next_free)
    del sources  # room for the final nodes
    nodes = assemble(top, subtrees, threads)
    return bvh._replace(nodes=nodes, links=nodes.view(np.int32))
