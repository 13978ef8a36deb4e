"""The final layout of a modified tree, and the frontier that cuts a tree into parts for threads.

`relayout` turns a modified tree into a `Bvh` in depth-first order with cheaper leaves, by all threads; optimisers of
finished trees use it. A subtree of few triangles becomes a leaf if that costs no more, by SAH, than the best trees of
its children [Wald 2007, Sec. 2]. The numbers of nodes and triangles in each part determine the parts' positions.

`cut_tree` cuts a tree into a top and many parts below it, which threads process independently.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import get, load8, load16, prefetch, ptr, put, splat4, stack_array, store
from .child_order import surface
from .nodes import (
    CHILDREN,
    LINK,
    MAX_DEPTH,
    ORDER,
    Bvh,
    aligned_empty,
    box_at,
    bvh_leaf,
    bvh_link,
    line_at,
    link_at,
    tree_of,
)
from .top_levels import place

# --- Frontiers --------------------------------------------------------------------------------------------------------


PART = 4096  # maximum nodes in a part, which fit in an L2 cache
_FRONTIER_STACK = MAX_DEPTH + 2


class TreeFrontier(NamedTuple):
    """The top of a tree: itself a tree, whose leaves are the parts, with the links ``bvh_link(part, 1)``."""

    numbers: NDArray[np.int64]  # (t,) int64: nodes of the top, parents first; empty if there is only one part
    top: NDArray[np.float32]  # (t, 16) float32, 64-byte aligned: copies of these nodes, with links within the top
    parts: NDArray[np.int64]  # (s, 3) int64: link to the part's root (a leaf if < 0), end of its nodes, depth


@kernel
def _cut_tree(bvh, sizes, largest, cut):
    """Fill `cut`, and return (number of nodes of the top, number of parts)."""
    nodes, lines, links = ptr(bvh.nodes), ptr(cut.top), cut.top.view(np.int32)
    stack = stack_array(np.int64, _FRONTIER_STACK, 4)  # link, end of nodes, depth, 2 * parent in the top + side
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0, len(bvh.nodes), 0, -1
    height, n_top, n_parts = 1, 0, 0
    while height > 0:
        height -= 1
        node, end, depth, place = stack[height]
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
            stack[height, 0] = bvh.links[node, LINK + side]
            stack[height, 1] = right if side == 0 and right >= 0 else end
            stack[height, 2], stack[height, 3] = depth + 1, 2 * n_top + side
            height += 1
        n_top += 1
    return n_top, n_parts


def cut_tree(bvh: Bvh, sizes: NDArray[np.integer] | None = None, largest: int | None = None) -> TreeFrontier:
    """Cut a BVH into parts of at most `largest` nodes; None: `PART`.

    sizes : (n_nodes,) number of nodes in each node's subtree; None if the nodes are in depth-first order

    With None, a part's nodes are consecutive, from its root to its end.
    """
    n, largest = len(bvh.nodes), PART if largest is None else largest
    capacity = min(
        n, MAX_DEPTH * (n // largest)
    )  # for the top: the large subtrees of one depth have at most n nodes together
    top = aligned_empty((capacity, 16), "f4")
    frontier = TreeFrontier(np.empty(capacity, np.int64), top, np.empty((capacity + 1, 3), np.int64))
    n_top, n_parts = _cut_tree(bvh, sizes, largest, frontier)
    return TreeFrontier(frontier.numbers[:n_top], top[:n_top], frontier.parts[:n_parts])


def children_of_top(cut: TreeFrontier) -> NDArray[np.int64]:
    """(t, 2) int64: children of the top's nodes, each a node of the top or ~part."""
    links = cut.top.view(np.int32)[:, CHILDREN].astype(np.int64)
    return np.where(links >= 0, links, ~bvh_leaf(links).first)


# --- Relayout ---------------------------------------------------------------------------------------------------------


_ZERO = np.float32(0.0)
_LEVELS = MAX_DEPTH + 2
_STACK_SIZE = 2 * MAX_DEPTH + 2


class LeafChoice(NamedTuple):
    """The chosen leaves and the resulting sizes of a tree that is cut into s parts."""

    is_leaf: NDArray[np.bool_]  # (n_nodes,) bool: the subtree becomes a leaf; undefined below such a node
    sizes: NDArray[np.int64]  # (s, 2) int64: nodes and triangles of each part with these leaves


class _CostStack(NamedTuple):
    """A stack of subtrees: minimum SAH cost, triangles, nodes."""

    costs: NDArray[np.float64]  # (k,) float64: SAH cost times half the area of the tree's root
    triangles: NDArray[np.int64]  # (k,) int64
    nodes: NDArray[np.int64]  # (k,) int64


@kernel
def _price_node(tree, node, best, top, max_leaf):
    """Replace a node's children on the stack by the node, and return (whether it becomes a leaf, new height)."""
    cost, triangles, nodes = surface(tree.nodes, box_at(node, 0), box_at(node, 1)), 0, 1
    area = cost
    for side in range(2):
        link, box = get(tree.links, link_at(node, side)), box_at(node, side)
        if link < 0:
            count = bvh_leaf(link).count
            cost += surface(tree.nodes, box, box) * count
            triangles += count
        else:
            top -= 1
            cost += best.costs[top]
            triangles += best.triangles[top]
            nodes += best.nodes[top]
    is_leaf = triangles <= max_leaf and area * triangles <= cost and node != 0  # the root is never a leaf
    best.costs[top] = area * triangles if is_leaf else cost
    best.triangles[top], best.nodes[top] = triangles, 0 if is_leaf else nodes
    return is_leaf, top + 1


@kernel
def _price(tree, root, max_leaf, is_leaf):
    """Choose which nodes of a subtree become leaves, and return its resulting (nodes, triangles)."""
    stack, height = stack_array(np.int64, _STACK_SIZE), 1
    costs, triangles = stack_array(np.float64, _LEVELS), stack_array(np.int64, _LEVELS)
    best, top = _CostStack(costs, triangles, stack_array(np.int64, _LEVELS)), 0
    stack[0] = root
    while height > 0:
        node = stack[height - 1]
        if node < 0:
            height -= 1
            is_leaf[~node], top = _price_node(tree, ~node, best, top, max_leaf)
            continue
        stack[height - 1] = ~node  # to be visited again after its children
        for side in range(2):
            link = get(tree.links, link_at(node, side))
            if link >= 0:
                stack[height] = link
                height += 1
    return best.nodes[0], best.triangles[0]


@kernel
def _price_parts(ticket, bvh, parts, max_leaf, choice):
    """Worker: choose the leaves of each part, and store its (nodes, triangles)."""
    tree = tree_of(bvh)
    for p in items(ticket):
        root = parts[p, 0]
        if root < 0:
            choice.sizes[p, 0], choice.sizes[p, 1] = 0, bvh_leaf(root).count
        else:
            choice.sizes[p, 0], choice.sizes[p, 1] = _price(tree, root, max_leaf, choice.is_leaf)


@inlined
def _copy_slot(source, old, target, new):
    put(target.prim_ids, new, get(source.prim_ids, old))
    store(target.corners, new * 9, load8(source.corners, old * 9))
    put(target.corners, new * 9 + 8, get(source.corners, old * 9 + 8))


@kernel
def _copy_leaf(source, link, stack, height, target, slot):
    """Copy the triangles below a link to the slots from `slot` on, and return the next free slot.

    It uses the stack above `height`.
    """
    base = height
    stack[height, 0] = link
    height += 1
    while height > base:
        height -= 1
        link = stack[height, 0]
        if link >= 0:
            stack[height, 0] = get(source.links, link_at(link, 1))
            stack[height + 1, 0] = get(source.links, link_at(link, 0))
            height += 2
            continue
        first, count = bvh_leaf(link)
        for old in range(first, first + count):
            _copy_slot(source, np.int64(old), target, slot)
            slot += 1
    return slot


@kernel
def _fetch_part(source, root, queue):
    """Prefetch a part's memory breadth first, well before `_copy_part` needs it."""
    queue[0] = root
    n, done = 1 if root >= 0 else 0, 0
    while done < n:
        node = np.int64(queue[done])
        done += 1
        for side in range(2):
            link = get(source.links, link_at(node, side))
            if link >= 0:
                prefetch(source.nodes, line_at(link))
                queue[n] = link
                n += 1
            else:
                slot = bvh_leaf(link).first
                prefetch(source.prim_ids, slot)
                prefetch(source.corners, slot * 9)
                prefetch(source.corners, slot * 9 + 8)


@kernel
def _copy_part(source, root, is_leaf, target, node, slot):
    """Write a part from the given node and slot on, and return the link to it."""
    stack = stack_array(np.int64, _STACK_SIZE, 2)  # link; word that takes the new link
    stack[0, 0], stack[0, 1] = root, -1
    height, first = 1, np.int64(node)
    while height > 0:
        height -= 1
        link, word = stack[height]
        if link < 0 or is_leaf[link]:
            end = _copy_leaf(source, link, stack, height, target, slot)
            new = bvh_link(slot, end - slot)
            slot = end
        else:
            new = node
            store(target.nodes, line_at(node), load16(source.nodes, line_at(link)))
            store(target.nodes, link_at(node, 0), splat4(_ZERO))
            for side in (1, 0):
                stack[height, 0] = get(source.links, link_at(link, side))
                stack[height, 1] = link_at(node, side)
                height += 1
            node += 1
        if word >= 0:
            put(target.links, word, new)
        else:
            first = new
    return first


@kernel
def _copy_parts(ticket, bvh, parts, choice, at, new, links, queue):
    """Worker: write each part to its place, and store the link to it."""
    # In: bvh; parts, of `TreeFrontier`; choice; at, (s, 2) first node and first slot of each part
    # Out: new, `Bvh`; links, (s,) int64 link to each part
    # Scratch: queue, per thread, an int32 for each triangle of the largest part
    source, target, is_leaf = tree_of(bvh), tree_of(new), choice.is_leaf
    for p in items(ticket):
        _fetch_part(source, parts[p, 0], queue)
        links[p] = _copy_part(source, parts[p, 0], is_leaf, target, at[p, 0], at[p, 1])


def _slots_before(children: NDArray[np.int64], triangles: NDArray[np.int64]) -> NDArray[np.int64]:
    """The first slot of each part, in depth-first order."""
    ranks = np.empty(len(triangles), np.int64)
    place(children, np.ones(len(triangles), np.int64), np.empty(len(children), np.int64), ranks)
    order = np.argsort(ranks)
    slots = np.empty_like(triangles)
    slots[order] = np.cumsum(triangles[order]) - triangles[order]
    return slots


def _links_of_top(
    children: NDArray[np.int64], node_at: NDArray[np.int64], to_parts: NDArray[np.int64]
) -> NDArray[np.int64]:
    links = np.empty(children.shape, np.int64)
    links[children >= 0] = node_at[children[children >= 0]]
    links[children < 0] = to_parts[~children[children < 0]]
    return links


def cheapest_leaves(bvh: Bvh, cut: TreeFrontier, max_leaf: int, threads: int) -> LeafChoice:
    """The leaves of at most `max_leaf` triangles that minimise the cost of a tree of two triangles or more."""
    choice = LeafChoice(np.empty(len(bvh.nodes), np.bool_), np.empty((len(cut.parts), 2), np.int64))
    run(_price_parts, threads, new_ticket(len(cut.parts), 1), bvh, cut.parts, max_leaf, choice)
    return choice


def relayout(bvh: Bvh, cut: TreeFrontier, choice: LeafChoice, threads: int) -> Bvh:
    """The final form of a tree of two triangles or more, in depth-first order.

    Parameters
    ----------
    bvh : Bvh
        Its nodes may be in any order. Unused words may have any value.
    cut : TreeFrontier
        The frontier of this tree. The nodes within a part, or within the top, may have been rearranged since.
    """
    children = children_of_top(cut)
    node_at, nodes_at = np.empty(len(children), np.int64), np.empty(len(cut.parts), np.int64)
    count = place(children, np.ascontiguousarray(choice.sizes[:, 0]), node_at, nodes_at)
    at = np.column_stack([nodes_at, _slots_before(children, choice.sizes[:, 1])])
    n = len(bvh.prim_ids)
    nodes = aligned_empty((count, 16), "f4")
    new = Bvh(nodes, nodes.view(np.int32), np.empty(n, np.int32), np.empty((n, 9), np.float32))
    to_parts = np.empty(len(cut.parts), np.int64)
    make_queue = lambda: (np.empty(choice.sizes[:, 1].max(), np.int32),)
    run(_copy_parts, threads, new_ticket(len(cut.parts), 1), bvh, cut.parts, choice, at, new, to_parts, own=make_queue)
    nodes[node_at] = cut.top
    new.links[node_at, CHILDREN] = _links_of_top(children, node_at, to_parts)
    new.links[node_at, ORDER:] = 0
    return new
