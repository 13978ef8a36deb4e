"""Collapse a binary BVH to a wide one by choosing which boxes to keep.

Dynamic programming finds the choice of minimum SAH cost [Ylitie et al. 2017, Sec. 3], where testing eight boxes or
eight triangles costs one.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, ptr_at, stack_array
from .child_order import order_wide_children, triangle_area
from .nodes import (
    EMPTY,
    GROUP_WORDS,
    LINK,
    LINKS,
    MAX_DEPTH,
    NO_CHILD,
    NODE_WORDS,
    WIDTH,
    Bvh,
    WideBvh,
    aligned_empty,
    box_at,
    bvh_leaf,
    parents_first,
    sides,
    slots_below,
    wide_link,
)

_PARTS, _NODES = WIDTH + 1, MAX_DEPTH * WIDTH  # stack sizes
_NOWHERE = np.float32(3e38)  # lower planes of a missing child's box; its upper planes are the negative


@inlined
def _area_of_child(nodes, child):
    """Half the area of the box of a child, given as 2 * node + side."""
    b = box_at(child >> 1, child & 1)
    x, y, z = sides(nodes, b, b)
    return x * (y + z) + y * z


@inlined
def _divide(costs, node, parts):
    """(cost, parts on the left) of the cheapest division of a node's children into `parts` (>= 2) wide subtrees."""
    best, at = np.float32(np.inf), 1
    for n_left in range(1, parts):
        cost = costs[2 * node, n_left] + costs[2 * node + 1, parts - n_left]
        if cost < best:
            best, at = cost, n_left
    return best, at


@kernel
def _price(bvh, order, costs, counts):
    """Fill each child's (2 * node + side) triangle count, and costs[child, k], its cost as up to k wide subtrees."""
    nodes = ptr(bvh.nodes)
    for i in range(len(order) - 1, -1, -1):
        for child in range(2 * order[i], 2 * order[i] + 2):
            link, area = np.int64(bvh.links[child >> 1, LINK + (child & 1)]), _area_of_child(nodes, child)
            if link < 0:
                counts[child] = 0 if link == EMPTY else bvh_leaf(link).count
                costs[child, :] = np.float32(0.0) if link == EMPTY else area
                continue
            counts[child] = counts[2 * link] + counts[2 * link + 1]
            costs[child, 1] = area if counts[child] <= WIDTH else area + _divide(costs, link, WIDTH)[0]
            for parts in range(2, WIDTH):
                divided = _divide(costs, link, parts)[0]
                costs[child, parts] = divided if divided < costs[child, parts - 1] else costs[child, parts - 1]


@kernel
def _children(bvh, costs, node, children):
    """Write the children (2 * node + side) of a binary node's wide node to `children`, and return their number."""
    stack, parts = stack_array(np.int64, _PARTS), stack_array(np.int64, _PARTS)
    n_left = _divide(costs, node, WIDTH)[1]
    stack[0], parts[0], stack[1], parts[1] = 2 * node + 1, WIDTH - n_left, 2 * node, n_left
    height, n = 2, 0
    while height > 0:
        height -= 1
        child, k = stack[height], parts[height]
        link = np.int64(bvh.links[child >> 1, LINK + (child & 1)])
        while k > 1 and costs[child, k] == costs[child, k - 1]:
            k -= 1
        if link < 0 or k == 1:
            if link != EMPTY:
                children[n] = child
                n += 1
            continue
        n_left = _divide(costs, link, k)[1]
        stack[height], parts[height], stack[height + 1], parts[height + 1] = 2 * link + 1, k - n_left, 2 * link, n_left
        height += 2
    return n


@kernel
def _fill_node(bvh, child, lane, words, at):
    """Copy the box of a child of the binary BVH to a lane of the wide node that starts at word `at`."""
    source = ptr(bvh.nodes)
    b = box_at(child >> 1, child & 1)
    for axis in range(3):
        words[at + 16 * axis + lane] = get(source, b + 4 * axis)
        words[at + 16 * axis + 8 + lane] = get(source, b + 4 * axis + 2)


@kernel
def _collapse(bvh, costs, counts, words, links, slots):
    """Write the nodes, and the slots of each group's lanes; return (number of nodes, number of groups)."""
    stack = stack_array(np.int64, _NODES, 2)  # binary node, wide node
    children = stack_array(np.int64, WIDTH)
    stack[0] = 0
    height, n_nodes, n_groups = 1, 1, 0
    while height > 0:
        height -= 1
        node, at = stack[height, 0], stack[height, 1] * NODE_WORDS
        n = _children(bvh, costs, node, children)
        for lane in range(WIDTH):
            links[at + LINKS + lane], links[at + LINKS + WIDTH + lane] = NO_CHILD, 0
            for axis in range(3):
                words[at + 16 * axis + lane], words[at + 16 * axis + 8 + lane] = _NOWHERE, -_NOWHERE
        for lane in range(n):
            child = children[lane]
            link = np.int64(bvh.links[child >> 1, LINK + (child & 1)])
            _fill_node(bvh, child, lane, words, at)
            if counts[child] <= WIDTH:
                count = slots_below(link, ptr(bvh.links), ptr_at(ptr(slots), n_groups * WIDTH))
                for k in range(count, WIDTH):
                    slots[n_groups * WIDTH + k] = -1
                links[at + LINKS + lane] = wide_link(n_groups, count)
                n_groups += 1
                continue
            links[at + LINKS + lane] = n_nodes
            stack[height, 0], stack[height, 1] = link, n_nodes
            height += 1
            n_nodes += 1
    return n_nodes, n_groups


@kernel
def _fill_groups(ticket, corners, slots, groups, areas):
    """Worker: write each group's triangles, lane by lane, and their total area."""
    values = ptr(corners)
    for group in items(ticket):
        for lane in range(WIDTH):
            slot, largest = slots[group, lane], np.float32(0.0)
            for k in range(9):
                x = np.float32(0.0)
                if slot >= 0:
                    x = corners[slot, k] if k < 3 else corners[slot, k] - corners[slot, k % 3]
                groups[group, k * WIDTH + lane] = x
                if k >= 3 and abs(x) > largest:
                    largest = abs(x)
            groups[group, 9 * WIDTH + lane] = largest
            if slot >= 0:
                areas[group] += triangle_area(values, np.int64(slot))


def widen(bvh: Bvh, threads: int | None = None) -> WideBvh:
    """The wide BVH of a binary one, identical for any number of threads."""
    n = len(bvh.nodes)
    costs, counts = np.empty((2 * n, WIDTH), np.float32), np.empty(2 * n, np.int32)
    _price(bvh, parents_first(bvh.links), costs, counts)
    max_nodes = 1 + int(np.count_nonzero(counts > WIDTH))  # unused memory stays untouched
    words = aligned_empty((max_nodes * NODE_WORDS,), "f4")
    slots = np.empty((n + 1) * WIDTH, np.int32)
    n_nodes, n_groups = _collapse(bvh, costs, counts, words, words.view(np.int32), slots)
    nodes = words[: n_nodes * NODE_WORDS].reshape(-1, NODE_WORDS)
    if n_groups == 0:
        slots[:WIDTH] = -1
    group_slots = slots[: max(1, n_groups) * WIDTH].reshape(-1, WIDTH).copy()
    del slots
    groups = aligned_empty((len(group_slots), GROUP_WORDS), "f4")
    areas = np.zeros(len(group_slots))
    run(
        _fill_groups, thread_count(threads), new_ticket(len(group_slots), 1024), bvh.corners, group_slots, groups, areas
    )
    order_wide_children(nodes, areas)
    planes = nodes[0, :LINKS].reshape(3, 2, WIDTH)
    is_child = planes[0, 0] <= planes[0, 1]
    reach = np.abs(planes[:, :, is_child]).max(initial=np.float32(0.0))
    return WideBvh(nodes, nodes.view(np.int32), groups, group_slots, reach, bvh)
