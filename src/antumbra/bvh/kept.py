"""The part of a tree that holds some of its triangles: the tree without all others.

A tree that is kept from frame to frame has all triangles of the scene, and culling leaves others in each frame. A
rebuilt tree of these takes longer than this part: the splits are there, and only boxes change.

Nodes stay in their order, and so do slots. So their new numbers are running sums, and threads write them apart.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import get, load16, put, store
from . import binned_sah
from .links import box_at, bvh_leaf, bvh_link, line_at, link_at
from .nodes import MAX_LEAF, Bvh, aligned_empty, tree_of
from .refit import boxes_of_kept

_NODES = 4096  # nodes that a thread writes at a time


@inlined
def _is_empty(nodes, node, side):
    """Whether the box of a child is the empty one."""
    return get(nodes, box_at(node, side)) == np.float32(np.inf)


@kernel
def _find_branches(ticket, bvh, branches):
    """Worker: mark the nodes both of whose children have triangles that are kept."""
    tree = tree_of(bvh)
    for node in items(ticket):
        branches[node] = not (_is_empty(tree.nodes, node, 0) or _is_empty(tree.nodes, node, 1))


@inlined
def _new_link(tree, link, node_at, slot_at):
    """The link to the first node with two children, or to the leaf, that `link` leads to."""
    while link >= 0 and (_is_empty(tree.nodes, link, 0) or _is_empty(tree.nodes, link, 1)):
        link = np.int64(get(tree.links, link_at(link, 1 if _is_empty(tree.nodes, link, 0) else 0)))
    if link >= 0:
        return np.int64(node_at[link])
    first, count = bvh_leaf(link)
    start, end = np.int64(slot_at[first]), np.int64(slot_at[first + count])
    return bvh_link(start, end - start)


@kernel
def _write_branches(ticket, bvh, branches, node_at, slot_at, new):
    """Worker: write the marked nodes to their new places, with new links."""
    # In: bvh, of `boxes_of_kept`; branches, bool; node_at, slot_at, int32: new number of each node and slot
    tree, out = tree_of(bvh), tree_of(new)
    for node in items(ticket):
        if branches[node]:
            new_node = np.int64(node_at[node])
            store(out.nodes, line_at(new_node), load16(tree.nodes, line_at(node)))
            for side in range(2):
                link = _new_link(tree, np.int64(get(tree.links, link_at(node, side))), node_at, slot_at)
                put(out.links, link_at(new_node, side), link)


def _numbers(chosen: np.ndarray) -> np.ndarray:
    """(n + 1,) int32: how many of the flags before each place are set."""
    numbers = np.zeros(len(chosen) + 1, np.int32)
    np.cumsum(chosen, out=numbers[1:])
    return numbers


def part_of(bvh: Bvh, kept: np.ndarray, threads: int) -> Bvh:
    """The tree without the triangles that are not kept, and without the nodes that then have less than two children.

    Parameters
    ----------
    bvh : Bvh
        Its nodes are in depth-first order. It is not changed.
    kept : (m,) int
        Indices of triangles of the tree.

    Returns
    -------
    Bvh
        Its `prim_ids` are indices in the whole scene, as those of `bvh`. Splits and orders of children are those of
        `bvh`. A part of few triangles is built anew by `bsah`.
    """
    chosen = np.zeros(bvh.prim_ids.max(initial=-1) + 1, np.bool_)
    chosen[kept] = True
    slots = chosen[bvh.prim_ids]
    prim_ids, corners = bvh.prim_ids[slots], bvh.corners[slots]
    if len(prim_ids) <= MAX_LEAF:  # they may lie in one leaf, which cannot be a tree
        few = binned_sah.build(corners.reshape(-1, 3, 3), threads)
        return few._replace(prim_ids=prim_ids[few.prim_ids])
    bounded = boxes_of_kept(bvh, slots, threads)
    branches = np.empty(len(bvh.nodes), np.bool_)
    run(_find_branches, threads, new_ticket(len(branches), _NODES), bounded, branches)
    node_at, slot_at = _numbers(branches), _numbers(slots)
    nodes = aligned_empty((int(node_at[-1]), 16), "f4")
    new = Bvh(nodes, nodes.view(np.int32), prim_ids, corners)
    ticket = new_ticket(len(branches), _NODES)
    run(_write_branches, threads, ticket, bounded, branches, node_at, slot_at, new)
    return new
