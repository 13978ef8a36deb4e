"""Cut a tree into a top and many parts below it, on which threads can work apart."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.simd import load16, ptr, stack_array, store
from .links import CHILDREN, LINK, bvh_leaf, bvh_link, line_at
from .nodes import MAX_DEPTH, Bvh, aligned_empty

PART = 4096  # nodes in a part, at most; they fit in a second-level cache
_WAITING = MAX_DEPTH + 2


class Cut(NamedTuple):
    """The top of a tree. It is a tree itself, whose leaves are the parts: ``links.bvh_link(part, 1)``."""

    numbers: np.ndarray  # (t,) int64: nodes of the top, parents first; empty if there is one part
    top: np.ndarray  # (t, 16) float32, 64-byte aligned: copies of these nodes, with links within the top
    parts: np.ndarray  # (s, 3) int64: link to the part's root (< 0: a leaf), end of its nodes, depth


@kernel
def _cut(bvh, sizes, largest, cut):
    """Fill `cut`, and return (number of nodes of the top, number of parts)."""
    nodes, lines, links = ptr(bvh.nodes), ptr(cut.top), cut.top.view(np.int32)
    waiting = stack_array(np.int64, _WAITING, 4)  # link, end of nodes, depth, 2 * parent in the top + side
    waiting[0, 0], waiting[0, 1], waiting[0, 2], waiting[0, 3] = 0, len(bvh.nodes), 0, -1
    height, n_top, n_parts = 1, 0, 0
    while height > 0:
        height -= 1
        node, end, depth, place = waiting[height]
        large = node >= 0 and (end - node if sizes is None else sizes[node]) > largest
        if place >= 0:
            links[place >> 1, LINK + (place & 1)] = n_top if large else bvh_link(n_parts, 1)
        if not large:
            cut.parts[n_parts, 0], cut.parts[n_parts, 1], cut.parts[n_parts, 2] = node, end, depth
            n_parts += 1
            continue
        cut.numbers[n_top] = node
        store(lines, line_at(n_top), load16(nodes, line_at(node)))
        right = np.int64(bvh.links[node, LINK + 1])
        for side in (1, 0):
            waiting[height, 0] = bvh.links[node, LINK + side]
            waiting[height, 1] = right if side == 0 and right >= 0 else end
            waiting[height, 2], waiting[height, 3] = depth + 1, 2 * n_top + side
            height += 1
        n_top += 1
    return n_top, n_parts


def cut(bvh: Bvh, sizes: np.ndarray | None = None) -> Cut:
    """Cut a BVH into parts of at most `PART` nodes.

    sizes : (n_nodes,) number of nodes in each node's subtree, or None if nodes are in depth-first order

    With None, a part's nodes are consecutive, from its root to its end.
    """
    n = len(bvh.nodes)
    room = min(n, MAX_DEPTH * (n // PART))  # for the top: the large subtrees of one depth have at most n nodes together
    top = aligned_empty((room, 16), "f4")
    cut = Cut(np.empty(room, np.int64), top, np.empty((room + 1, 3), np.int64))
    n_top, n_parts = _cut(bvh, sizes, PART, cut)
    return Cut(cut.numbers[:n_top], top[:n_top], cut.parts[:n_parts])


def children_of_top(cut: Cut) -> np.ndarray:
    """(t, 2) int64: children of the top's nodes, each a node of the top or ~part."""
    links = cut.top.view(np.int32)[:, CHILDREN].astype(np.int64)
    return np.where(links >= 0, links, ~bvh_leaf(links).first)
