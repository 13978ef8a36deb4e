"""Join the nodes of the top and of the subtrees in one array, in depth-first order."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import load8, load16, minimum, ptr, store
from .links import CHILDREN, LINK, ORDER, line_at
from .nodes import Bvh, aligned_empty
from .top import UpperLevels


class Subtrees(NamedTuple):
    """The subtrees that threads have built below the top."""

    nodes: np.ndarray  # (m, 16) float32: subtree by subtree, depth first; in links, a subtree's first node is 1
    shares: np.ndarray  # (s, 3) int64: first node, number of nodes (0 for a leaf), link to it, of each subtree


@kernel
def _place(children, counts, node_at, subtree_at, waiting):
    """`place`; `waiting` is scratch memory for one link more than the top has nodes."""
    waiting[0] = 0 if len(children) else -1
    height, position = 1, 0
    while height > 0:
        height -= 1
        child = waiting[height]
        if child < 0:
            subtree_at[~child] = position
            position += counts[~child]
            continue
        node_at[child] = position
        position += 1
        waiting[height], waiting[height + 1] = children[child, 1], children[child, 0]
        height += 2
    return position


def place(children, counts, node_at, subtree_at) -> int:
    """Number all nodes in depth-first order, and return how many they are.

    children : links of the top, as in `UpperLevels`
    counts : (s,) nodes of each subtree
    node_at, subtree_at : filled with the index of each node of the top, and of the first node of each subtree
    """
    return _place(children, counts, node_at, subtree_at, np.empty(len(children) + 1, np.int64))


@kernel
def join_boxes(children, roots, boxes):
    """Fill the boxes of the top's children from the boxes of the subtrees' roots.

    children : as in `UpperLevels`, parents first
    roots : (s, 8) float32
    boxes : (t, 2, 8) float32, filled
    """
    for t in range(len(children) - 1, -1, -1):
        for side in range(2):
            child = children[t, side]
            if child < 0:
                box = load8(roots, ~child * 8)
            else:
                box = minimum(load8(boxes, child * 16), load8(boxes, child * 16 + 8))
            store(boxes, (t * 2 + side) * 8, box)


@kernel
def _copy_subtrees(ticket, subtrees, subtree_at, nodes, links):
    """Worker: copy the nodes of each subtree to their place, and shift their links."""
    source, target = ptr(subtrees.nodes), ptr(nodes)
    for s in items(ticket):
        first, count, at = subtrees.shares[s, 0], subtrees.shares[s, 1], subtree_at[s]
        for i in range(count):
            store(target, line_at(at + i), load16(source, line_at(first + i)))
            for side in range(2):
                if links[at + i, LINK + side] >= 0:
                    links[at + i, LINK + side] += at - 1


def top_lines(top: UpperLevels, node_at, subtree_links) -> np.ndarray:
    """(t, 16) float32: the nodes of the top."""
    t = len(top.children)
    lines = np.zeros((t, 16), np.float32)
    corners = np.concatenate([top.boxes[:, :, 0:3], -top.boxes[:, :, 4:7]], axis=1)
    lines[:, :12] = corners.transpose(0, 2, 1).reshape(t, 12)
    is_node = top.children >= 0
    links = np.empty((t, 2), np.int64)
    links[is_node] = node_at[top.children[is_node]]
    links[~is_node] = subtree_links[~top.children[~is_node]]
    lines.view(np.int32)[:, CHILDREN] = links
    if top.orders is not None:
        lines.view(np.int32)[:, ORDER] = top.orders
    return lines


def assemble(bvh: Bvh, top: UpperLevels, subtrees: Subtrees, threads: int) -> Bvh:
    """`bvh` with all nodes, aligned to 64 bytes. Every left child follows its parent in memory."""
    node_at, subtree_at = np.empty(len(top.children), np.int64), np.empty(len(subtrees.shares), np.int64)
    count = place(top.children, subtrees.shares[:, 1], node_at, subtree_at)
    nodes = aligned_empty((count, 16), "f4")
    ticket = new_ticket(len(subtree_at), 1)
    run(_copy_subtrees, threads, ticket, subtrees, subtree_at, nodes, nodes.view(np.int32))
    links = np.where(subtrees.shares[:, 2] >= 0, subtree_at, subtrees.shares[:, 2])
    nodes[node_at] = top_lines(top, node_at, links)
    return bvh._replace(nodes=nodes, links=nodes.view(np.int32))
