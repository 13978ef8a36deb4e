"""`bsah`: binned SAH, in parallel [Wald 2007, "On fast construction of SAH-based bounding volume hierarchies"].

The boxes of all triangles become records; all threads together split the first levels (`top`); each then takes
ranges to build alone (`subtree`), largest first; and the nodes are put in one array (`assemble`). Departures from the
paper: few bins for few records, and for four records or fewer the best of all trees (`smallest`).
"""

import math
from functools import cache

import numpy as np

from ..errors import InputError
from ..jit import kernel
from ..parallel import new_ticket, run, take, thread_count
from ..simd import as_i32, atomic_add, get, load8, load16, ptr, store
from .assemble import Subtrees, assemble
from .bounds import MAX_COORDINATE, MAX_TRIANGLES, PART, write_records
from .nodes import EMPTY, MAX_LEAF, Bvh, Tree, aligned_empty
from .subtree import Settings, build_subtree
from .top import BLOCK, build_top

_SUBTREES = 64  # the top splits ranges of more than a 64th of all records, so that threads finish together ...
_SMALL = 4096  # ... but none of fewer records than this, which one thread builds before others are awake
_CORNERS = [0, 1, 2, 4, 5, 6]  # the words of a box that are coordinates


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


def _checked(vertices, max_leaf) -> np.ndarray:
    """The vertices as (n, 9) float32."""
    vertices = np.asarray(vertices)
    if vertices.ndim != 3 or vertices.shape[1:] != (3, 3) or vertices.dtype != np.float32:
        raise InputError(f"vertices is {vertices.dtype} {vertices.shape}; it must be float32 (n, 3, 3)")
    if len(vertices) > MAX_TRIANGLES:
        raise InputError(f"vertices has {len(vertices)} triangles; a BVH holds at most {MAX_TRIANGLES}")
    if max_leaf not in range(1, MAX_LEAF + 1):
        raise InputError(f"max_leaf is {max_leaf!r}; it must be a whole number from 1 to {MAX_LEAF}")
    return np.ascontiguousarray(vertices).reshape(-1, 9)


def _write_records(flat, records, threads):
    """Fill `records`; (box, centroid box) of them all."""
    parts = np.empty((-(-len(flat) // BLOCK), PART), np.float32)
    run(write_records, threads, new_ticket(len(flat), BLOCK), flat, records, parts)
    bounds = parts[:, :16].min(axis=0, initial=np.inf)
    if not ((parts[:, 16:] == 0).all() and (bounds[_CORNERS] > -MAX_COORDINATE).all()):
        row = int(np.argmin((np.abs(flat) < MAX_COORDINATE).all(axis=1)))
        raise InputError(f"triangle {row} has a coordinate that is not finite, or not below {MAX_COORDINATE:.1e}")
    return bounds[:8], bounds[8:]


def _power_of_two_for(box) -> np.float32:
    """A power of two by which the largest coordinate becomes about 1."""
    largest = float(np.abs(box[_CORNERS]).max())
    return np.float32(2.0 ** min(126, -math.frexp(largest)[1]))


def _tiny(flat) -> Bvh:
    """The BVH of no triangle or one."""
    n = len(flat)
    nodes = aligned_empty((1, 16), "f4")
    nodes[0, :12] = [np.inf, np.inf, -np.inf, -np.inf] * 3
    nodes[0, 12:] = 0
    links = nodes.view(np.int32)
    links[0, 12:14] = EMPTY
    if n:
        corners = flat.reshape(3, 3)
        nodes[0, [0, 4, 8]], nodes[0, [2, 6, 10]], links[0, 12] = corners.min(axis=0), corners.max(axis=0), ~0
    return Bvh(nodes, links, np.zeros(n, np.int32), flat.copy())


@cache
def _compile_top() -> None:
    """Compile, or load, what only large scenes run too, so that the first build of a process readies all later ones."""
    pair = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[2, 2, 2], [3, 2, 2], [2, 3, 2]]], np.float32).reshape(2, 9)
    records, spare = aligned_empty((2, 8), "f4"), aligned_empty((2, 8), "f4")
    build_top(records, spare, *_write_records(pair, records, 1), np.float32(1.0), 1, 1)


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
    flat, threads = _checked(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    _compile_top()
    if n < 2:
        _write_records(flat, np.empty((n, 8), np.float32), 1)
        return _tiny(flat)
    sources = aligned_empty((n, 8), "f4"), aligned_empty((n, 8), "f4")
    box, centroids = _write_records(flat, sources[0], threads)
    settings = Settings(np.int64(max_leaf), _power_of_two_for(box))
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
