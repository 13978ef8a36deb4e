"""Collapse a binary BVH to a wide one by choosing which boxes to keep, and refit the wide one with the binary one.

Dynamic programming finds the choice of minimum SAH cost [Ylitie et al. 2017, Sec. 3], where testing eight boxes or
eight triangles costs one.

Each child of a wide node has the box of a child of a binary node, and the wide node stores which. After `refit` of the
binary BVH, the wide one needs no new choice and no bottom-up pass: threads copy boxes and triangles independently.
"""

import numpy as np
from numpy.typing import NDArray

from ..kernels.array_pool import ArrayPool
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, shares, thread_count
from ..kernels.simd import (
    absolute,
    get,
    load8,
    load16,
    maximum,
    ptr,
    ptr_at,
    put,
    select,
    stack_array,
    stack_f32,
    store,
)
from ..kernels.transposition import transposed8
from .child_order import order_wide_children, triangle_area
from .nodes import (
    BINARY,
    EMPTY,
    GROUP_WORDS,
    LINK,
    LINKS,
    MAX_DEPTH,
    NO_CHILD,
    NODE_WORDS,
    WIDTH,
    Bvh,
    Reach,
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
_SUMMED = 1024  # nodes whose areas a thread sums at a time
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


@inlined
def _fill_node(source, child, lane, words, at):
    """Copy the box of a child of the binary BVH to a lane of the wide node that starts at word `at`."""
    b = box_at(child >> 1, child & 1)
    for axis in range(3):
        put(words, at + 16 * axis + lane, get(source, b + 4 * axis))
        put(words, at + 16 * axis + 8 + lane, get(source, b + 4 * axis + 2))


@kernel
def _collapse(bvh, costs, counts, nodes, links, slots):
    """Write the nodes, and the slots of each group's lanes; return (number of nodes, number of groups)."""
    source, words = ptr(bvh.nodes), ptr(nodes)
    stack = stack_array(np.int64, _NODES, 2)  # binary node, wide node
    children = stack_array(np.int64, WIDTH)
    stack[0] = 0
    height, n_nodes, n_groups = 1, 1, 0
    while height > 0:
        height -= 1
        node, at = stack[height, 0], stack[height, 1] * NODE_WORDS
        n = _children(bvh, costs, node, children)
        for lane in range(WIDTH):
            links[at + LINKS + lane], links[at + BINARY + lane] = NO_CHILD, 0
            for axis in range(3):
                put(words, at + 16 * axis + lane, _NOWHERE)
                put(words, at + 16 * axis + 8 + lane, -_NOWHERE)
        for lane in range(n):
            child = children[lane]
            link = np.int64(bvh.links[child >> 1, LINK + (child & 1)])
            _fill_node(source, child, lane, words, at)
            links[at + BINARY + lane] = child
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


@inlined
def _corners_of(corners, slots, lane):
    """The first eight numbers of the triangle in a lane; those of any triangle if the lane is unused."""
    return load8(corners, 9 * max(np.int64(get(slots, lane)), 0))


@inlined
def _fill_group(corners, slots, last, words):
    """Write the triangles in eight slots to a group's rows; unused lanes are zero, and `last` is scratch memory."""
    for lane in range(WIDTH):
        put(last, lane, get(corners, 9 * max(np.int64(get(slots, lane)), 0) + 8))
    x, y, z, x1, y1, z1, x2, y2 = transposed8(
        _corners_of(corners, slots, 0), _corners_of(corners, slots, 1),
        _corners_of(corners, slots, 2), _corners_of(corners, slots, 3),
        _corners_of(corners, slots, 4), _corners_of(corners, slots, 5),
        _corners_of(corners, slots, 6), _corners_of(corners, slots, 7),
    )  # fmt: skip
    x1, y1, z1, x2, y2, z2 = x1 - x, y1 - y, z1 - z, x2 - x, y2 - y, load8(last, 0) - z
    a, b = maximum(maximum(absolute(x1), absolute(y1)), absolute(z1)), maximum(absolute(x2), absolute(y2))
    largest, used, zero = maximum(maximum(a, b), absolute(z2)), load8(slots, 0) >= np.int32(0), np.float32(0.0)
    rows = x, y, z, x1, y1, z1, x2, y2, z2, largest
    for k in range(10):
        store(words, WIDTH * k, select(used, rows[k], zero))


@kernel
def _fill_groups(ticket, corners, slots, groups, areas):
    """Worker: write each group's triangles, lane by lane, and add their area to `areas` unless it is None."""
    values, lanes, words, last = ptr(corners), ptr(slots), ptr(groups), stack_f32(WIDTH)
    for group in items(ticket):
        of_group = ptr_at(lanes, group * WIDTH)
        if get(of_group, 0) < 0:  # only the group of a tree without triangles
            for k in range(GROUP_WORDS):
                groups[group, k] = np.float32(0.0)
            continue
        _fill_group(values, of_group, last, ptr_at(words, group * GROUP_WORDS))
        if areas is not None:
            lane = 0
            while lane < WIDTH and get(of_group, lane) >= 0:
                areas[group] += triangle_area(values, np.int64(get(of_group, lane)))
                lane += 1


@kernel
def _refit_nodes(ticket, binary, wide, new):
    """Worker: copy each wide node, with the boxes of the refitted binary BVH."""
    # In: binary, its nodes; wide, nodes before. Out: new, nodes
    source, old, words = ptr(binary), ptr(wide), ptr(new)
    links = ptr(wide.view(np.int32))
    for node in items(ticket):
        at = node * NODE_WORDS
        for word in range(0, NODE_WORDS, 16):
            store(words, at + word, load16(old, at + word))
        lane = 0
        while lane < WIDTH and get(links, at + LINKS + lane) != NO_CHILD:
            _fill_node(source, np.int64(get(links, at + BINARY + lane)), lane, words, at)
            lane += 1


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
    return WideBvh(nodes, nodes.view(np.int32), groups, group_slots, _reach(nodes), bvh)


@kernel
def _sum_areas(ticket, nodes, sums):
    """Worker: sum half the areas of the boxes of children, per share of the nodes."""
    links, planes = nodes.view(np.int32), ptr(nodes)
    for first, last in shares(ticket):
        total = 0.0
        for node in range(first, last):
            lane = 0
            while lane < WIDTH and links[node, LINKS + lane] != NO_CHILD:
                at = node * NODE_WORDS + lane
                x = np.float64(get(planes, at + WIDTH)) - get(planes, at)
                y = np.float64(get(planes, at + 3 * WIDTH)) - get(planes, at + 2 * WIDTH)
                z = np.float64(get(planes, at + 5 * WIDTH)) - get(planes, at + 4 * WIDTH)
                total += x * y + y * z + z * x
                lane += 1
        sums[first // ticket[CHUNK]] = total


def wide_cost(wide: WideBvh, threads: int) -> float:
    """The SAH cost: the expected number of nodes and groups that a ray enters if it hits the root's box.

    The result is bitwise identical for any number of threads. It is 1 if the box has no area.
    """
    sums = np.zeros(-(-len(wide.nodes) // _SUMMED))
    run(_sum_areas, threads, new_ticket(len(wide.nodes), _SUMMED), wide.nodes, sums)
    planes = wide.nodes[0, :LINKS].reshape(3, 2, WIDTH).astype(np.float64)
    planes = planes[:, :, planes[0, 0] <= planes[0, 1]]
    if planes.size == 0:
        return 1.0
    x, y, z = planes[:, 1].max(1) - planes[:, 0].min(1)
    area = x * y + y * z + z * x
    return 1.0 + float(sums.sum() / area) if area > 0.0 else 1.0


def reach_of(boxes: NDArray[np.float32]) -> Reach:
    """The `Reach` of boxes, (n, 2, 3) float32; 0 without boxes."""
    x, y, z = np.abs(boxes).max(axis=(0, 1), initial=np.float32(0.0))
    return x, y, z


def _reach(nodes: NDArray[np.float32]) -> Reach:
    """`WideBvh.reach`."""
    planes = nodes[0, :LINKS].reshape(3, 2, WIDTH)
    is_child = planes[0, 0] <= planes[0, 1]
    return reach_of(planes[:, :, is_child].T)


def refit_wide(wide: WideBvh, bvh: Bvh, threads: int, pool: ArrayPool) -> WideBvh:
    """The same wide BVH with the boxes and triangles of `bvh`, its refitted binary BVH. Children keep their order.

    The result is identical for any number of threads. Its arrays are in recycled memory.
    """
    nodes, groups = pool.empty(wide.nodes.shape, np.float32), pool.empty(wide.groups.shape, np.float32)
    run(_refit_nodes, threads, new_ticket(len(nodes), 256), bvh.nodes, wide.nodes, nodes)
    run(_fill_groups, threads, new_ticket(len(groups), 1024), bvh.corners, wide.slots, groups, None)
    return WideBvh(nodes, nodes.view(np.int32), groups, wide.slots, _reach(nodes), bvh)
