"""Collapse a binary BVH to a wide one by choosing which boxes to keep.

Dynamic programming finds the choice of minimum SAH cost [Ylitie et al. 2017, Sec. 3], where testing eight boxes or
eight triangles costs one. Below the top levels, threads price and collapse one subtree each. Subtrees are counted
first and then written to their final position, so the result does not depend on the number of threads.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, items, new_ticket, run, run_short, shares, thread_count
from ..kernels.simd import (
    absolute,
    broadcast8,
    extract,
    get,
    load8,
    mask_from_bits8,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    shuffle,
    splat8,
    stack_array,
    stack_f32,
    stack_f64,
    store,
    to_f64,
)
from ..kernels.transposition import transposed8
from .child_order import WideParts, order_wide_children, triangle_area
from .nodes import (
    BINARY,
    CHILDREN,
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
    link_at,
    sides,
    slots_below,
    wide_link,
    write_parents_first,
)

_PARTS, _NODES, _SHIFTED = WIDTH + 1, MAX_DEPTH * WIDTH, 2 * WIDTH  # stack sizes
_SUBTREES = 128  # threads share this many subtrees, or more, of unequal sizes
_PER_THREAD = 16384  # triangles: with fewer, waking a thread takes longer than its work
_SUMMED = 1024  # nodes whose areas a thread sums at a time
_INF = np.float32(np.inf)
NOWHERE = np.float32(3e38)  # lower planes of a missing child's box; its upper planes are the negative


@inlined
def _area_of_child(nodes, child):
    """Half the area of the box of a child, given as 2 * node + side."""
    b = box_at(child >> 1, child & 1)
    x, y, z = sides(nodes, b, b)
    return x * (y + z) + y * z


class WidePrices(NamedTuple):
    """What dynamic programming finds. Children are those of binary nodes: 2 * node + side."""

    costs: NDArray[np.float32]  # (2n, 8) float32: [child, k], its cost as up to k + 1 wide subtrees
    counts: NDArray[np.int32]  # (2n,) int32: triangles below a child
    picked: NDArray[np.int32]  # (n, 8) int32: children of the wide node over a binary node, then NO_CHILD


class WideArrays(NamedTuple):
    """The arrays of a wide BVH to be written, as in `WideBvh`, and one slot per lane of a group."""

    nodes: NDArray[np.float32]
    links: NDArray[np.int32]
    slots: NDArray[np.int32]


@inlined
def _divided(costs, node, shifted):
    """The costs of a node's children together, as 1 to 8 wide subtrees; vector. `shifted`: scratch, begins with INF."""
    left, right, best = 2 * node * WIDTH, (2 * node + 1) * WIDTH, splat8(_INF)
    store(shifted, WIDTH, load8(costs, right))
    for i in range(WIDTH - 1):  # i + 1 of them on the left
        best = minimum(best, broadcast8(costs, left + i) + load8(shifted, WIDTH - 1 - i))
    return best


@inlined
def _price_child(nodes, links, child, shifted, costs, counts):
    """Fill the costs and the triangle count of a child, whose own children have theirs."""
    link, area = np.int64(get(links, link_at(child >> 1, child & 1))), _area_of_child(nodes, child)
    if link < 0:
        put(counts, child, 0 if link == EMPTY else bvh_leaf(link).count)
        store(costs, child * WIDTH, splat8(np.float32(0.0) if link == EMPTY else area))
        return
    count, cost = get(counts, 2 * link) + get(counts, 2 * link + 1), _divided(costs, link, shifted)
    whole = area if count <= WIDTH else area + extract(cost, WIDTH - 1)
    cost = select(mask_from_bits8(np.int64(1)), splat8(whole), cost)
    cost = minimum(cost, shuffle(cost, 0, 0, 1, 2, 3, 4, 5, 6))  # the least of this and all lanes before it
    cost = minimum(cost, shuffle(cost, 0, 0, 0, 1, 2, 3, 4, 5))
    cost = minimum(cost, shuffle(cost, 0, 0, 0, 0, 0, 1, 2, 3))
    put(counts, child, count)
    store(costs, child * WIDTH, cost)


@kernel
def _price(bvh, order, n, prices):
    """Fill the prices of the children of the first n nodes in `order`, which has parents first."""
    # In: bvh, `Bvh`; order, (>= n,) int32; n. Out: prices, costs and counts
    nodes, links, costs, counts = ptr(bvh.nodes), ptr(bvh.links), ptr(prices.costs), ptr(prices.counts)
    shifted = stack_f32(_SHIFTED)
    store(shifted, 0, splat8(_INF))
    for i in range(n - 1, -1, -1):
        for child in range(2 * order[i], 2 * order[i] + 2):
            _price_child(nodes, links, child, shifted, costs, counts)


@kernel
def _price_subtrees(ticket, bvh, roots, prices, order):
    """Worker: fill the prices of the subtrees at `roots`; `order`: scratch memory for each node of a subtree."""
    # In: bvh; roots, (s,) int32 nodes. Out: prices
    for k in items(ticket):
        _price(bvh, order, write_parents_first(bvh.links, roots[k], order), prices)


@inlined
def _parts_on_left(costs, node, parts):
    """The share of the left child in the cheapest division of a node's children into `parts` (>= 2) wide subtrees."""
    best, at = _INF, 1
    for n_left in range(1, parts):
        cost = costs[2 * node, n_left - 1] + costs[2 * node + 1, parts - n_left - 1]
        if cost < best:
            best, at = cost, n_left
    return at


@inlined
def _link_of(bvh, child):
    """The link to a child of the binary BVH."""
    return np.int64(bvh.links[child >> 1, LINK + (child & 1)])


@kernel
def _pick_children(bvh, prices, node):
    """Fill the row of `picked` of a binary node."""
    # In: bvh; prices, costs; node. Out: prices.picked
    stack, parts = stack_array(np.int64, _PARTS), stack_array(np.int64, _PARTS)
    costs, picked = prices.costs, ptr_at(ptr(prices.picked), node * WIDTH)
    store(picked, 0, splat8(NO_CHILD))
    n_left = _parts_on_left(costs, node, WIDTH)
    stack[0], parts[0], stack[1], parts[1] = 2 * node + 1, WIDTH - n_left, 2 * node, n_left
    height, n = 2, 0
    while height > 0:
        height -= 1
        child, k = stack[height], parts[height]
        link = _link_of(bvh, child)
        while k > 1 and costs[child, k - 1] == costs[child, k - 2]:
            k -= 1
        if link < 0 or k == 1:
            if link != EMPTY:
                put(picked, n, child)
                n += 1
            continue
        n_left = _parts_on_left(costs, link, k)
        stack[height], parts[height], stack[height + 1], parts[height + 1] = 2 * link + 1, k - n_left, 2 * link, n_left
        height += 2


@inlined
def fill_node(source, child, lane, words, at):
    """Copy the box of a child of the binary BVH to a lane of the wide node that starts at word `at`."""
    b = box_at(child >> 1, child & 1)
    for axis in range(3):
        put(words, at + 16 * axis + lane, get(source, b + 4 * axis))
        put(words, at + 16 * axis + 8 + lane, get(source, b + 4 * axis + 2))


@kernel
def _write_node(bvh, prices, node, number, next_node, next_group, out):
    """Write the wide node over a binary one, numbering inner children from `next_node` on, groups from `next_group`."""
    # In: bvh; prices; node, the binary one; number, the wide one. Out: out, `WideArrays`
    source, links, at = ptr(bvh.nodes), ptr(out.links), number * NODE_WORDS
    words, slots = ptr(out.nodes), ptr(out.slots)
    for axis in range(3):
        store(words, at + 16 * axis, splat8(NOWHERE))
        store(words, at + 16 * axis + 8, splat8(-NOWHERE))
    store(links, at + LINKS, splat8(NO_CHILD))
    store(links, at + BINARY, splat8(np.int32(0)))
    lane = 0
    while lane < WIDTH and prices.picked[node, lane] >= 0:
        child = np.int64(prices.picked[node, lane])
        fill_node(source, child, lane, words, at)
        put(links, at + BINARY + lane, child)
        if prices.counts[child] > WIDTH:
            put(links, at + LINKS + lane, next_node)
            next_node += 1
        else:
            group = ptr_at(slots, next_group * WIDTH)
            store(group, 0, splat8(np.int32(-1)))
            count = slots_below(_link_of(bvh, child), ptr(bvh.links), group)
            put(links, at + LINKS + lane, wide_link(next_group, count))
            next_group += 1
        lane += 1


@inlined
def _visit(bvh, prices, node, number, next_node, next_group, out):
    """Pick the children of a binary node, or write its wide node; see `_collapse`."""
    if out is None:
        _pick_children(bvh, prices, node)
    else:
        _write_node(bvh, prices, node, number, next_node, next_group, out)


@kernel
def _collapse_top(bvh, prices, most, todo, out):
    """Collapse the top levels, breadth first, until `most` subtrees wait. Return (their first root, next node, group).

    todo : output, (n,) int32, the binary node of each wide node before the next
    bvh, prices, out : as for `_collapse`
    """
    number, next_node, next_group, todo[0] = 0, 1, 0, 0
    while 0 < next_node - number < most:
        node, lane = np.int64(todo[number]), 0
        _visit(bvh, prices, node, number, next_node, next_group, out)
        while lane < WIDTH and prices.picked[node, lane] >= 0:
            child = np.int64(prices.picked[node, lane])
            if prices.counts[child] > WIDTH:
                todo[next_node] = _link_of(bvh, child)
                next_node += 1
            else:
                next_group += 1
            lane += 1
        number += 1
    return number, next_node, next_group


@kernel
def _collapse(bvh, prices, root, number, next_node, next_group, out):
    """Collapse the subtree of a binary node to wide node `number` and those from `next_node` on.

    Return (the next node, the next group).

    bvh, root : the `Bvh` and the binary node
    prices : with costs and counts; `picked` is output
    next_node, next_group : numbers of the first node below the root, and of the first group
    out : `WideArrays`; None: only pick children and count, which comes first
    """
    stack = stack_array(np.int64, _NODES, 2)
    stack[0, 0], stack[0, 1] = root, number
    height = 1
    while height > 0:
        height -= 1
        (node, number), lane = stack[height], 0
        _visit(bvh, prices, node, number, next_node, next_group, out)
        while lane < WIDTH and prices.picked[node, lane] >= 0:
            child = np.int64(prices.picked[node, lane])
            if prices.counts[child] > WIDTH:
                stack[height, 0], stack[height, 1] = _link_of(bvh, child), next_node
                height += 1
                next_node += 1
            else:
                next_group += 1
            lane += 1
    return next_node, next_group


@kernel
def _count_subtrees(ticket, bvh, prices, roots, sizes):
    """Worker: count the wide nodes below the root of each subtree, and the groups."""
    # In: bvh; prices; roots, (s,) int32 binary nodes. Out: sizes, (s, 2) int64; prices.picked
    for k in items(ticket):
        sizes[k, 0], sizes[k, 1] = _collapse(bvh, prices, np.int64(roots[k]), 0, 0, 0, None)


@kernel
def _collapse_subtrees(ticket, bvh, prices, roots, first, starts, out):
    """Worker: write each subtree; its root is wide node `first` + k, its other nodes and groups begin at `starts`."""
    # In: bvh; prices; roots, (s,) int32 binary nodes; first; starts, (s, 2) int64. Out: out, `WideArrays`
    for k in items(ticket):
        _collapse(bvh, prices, np.int64(roots[k]), first + k, starts[k, 0], starts[k, 1], out)


@inlined
def _corners_of(corners, slots, lane):
    """The first eight numbers of the triangle in a lane; those of any triangle if the lane is unused."""
    return load8(corners, 9 * max(np.int64(get(slots, lane)), 0))


@inlined
def group_box(columns, z2, used):
    """The lower and the upper corner of the triangles in the `used` lanes (mask), as for `write_group`, per lane."""
    x, y, z, x1, y1, z1, x2, y2 = columns
    return (
        (
            select(used, minimum(minimum(x, x1), x2), _INF),
            select(used, minimum(minimum(y, y1), y2), _INF),
            select(used, minimum(minimum(z, z1), z2), _INF),
        ),
        (
            select(used, maximum(maximum(x, x1), x2), -_INF),
            select(used, maximum(maximum(y, y1), y2), -_INF),
            select(used, maximum(maximum(z, z1), z2), -_INF),
        ),
    )


@inlined
def write_group(columns, z2, used, words):
    """Write triangles to a group's rows, zero in lanes that are not `used` (mask); columns, z2: their nine numbers."""
    x, y, z, x1, y1, z1, x2, y2 = columns
    x1, y1, z1, x2, y2, z2 = x1 - x, y1 - y, z1 - z, x2 - x, y2 - y, z2 - z
    a, b = maximum(maximum(absolute(x1), absolute(y1)), absolute(z1)), maximum(absolute(x2), absolute(y2))
    largest, zero = maximum(maximum(a, b), absolute(z2)), np.float32(0.0)
    rows = x, y, z, x1, y1, z1, x2, y2, z2, largest
    for k in range(10):
        store(words, WIDTH * k, select(used, rows[k], zero))


@inlined
def _fill_group(corners, slots, last, words):
    """Write the triangles in eight slots to a group's rows; `last` is scratch memory."""
    for lane in range(WIDTH):
        put(last, lane, get(corners, 9 * max(np.int64(get(slots, lane)), 0) + 8))
    columns = transposed8(
        _corners_of(corners, slots, 0), _corners_of(corners, slots, 1),
        _corners_of(corners, slots, 2), _corners_of(corners, slots, 3),
        _corners_of(corners, slots, 4), _corners_of(corners, slots, 5),
        _corners_of(corners, slots, 6), _corners_of(corners, slots, 7),
    )  # fmt: skip
    write_group(columns, load8(last, 0), load8(slots, 0) >= np.int32(0), words)


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


def _priced(bvh: Bvh, threads: int) -> WidePrices:
    """The prices of all children."""
    n, top = len(bvh.nodes), []
    costs, counts = np.empty((2 * n, WIDTH), np.float32), np.empty(2 * n, np.int32)
    prices = WidePrices(costs, counts, np.empty((n, WIDTH), np.int32))
    roots = np.zeros(1, np.int32)
    while 0 < len(roots) < _SUBTREES:
        top.append(roots)
        links = bvh.links[roots, CHILDREN].reshape(-1)
        roots = links[links >= 0]
    scratch = lambda: (np.empty(n, np.int32),)
    run_short(_price_subtrees, threads, new_ticket(len(roots), 1), bvh, roots, prices, own=scratch)
    order = np.concatenate(top)
    _price(bvh, order, len(order), prices)
    return prices


def _collapsed(bvh: Bvh, prices: WidePrices, threads: int) -> tuple[WideArrays, WideParts]:
    """The nodes of the wide BVH, and which of them lie in which subtree."""
    todo = np.empty(len(bvh.nodes), np.int32)
    first, next_node, next_group = _collapse_top(bvh, prices, _SUBTREES, todo, None)
    roots, starts = todo[first:next_node], np.empty((next_node - first + 1, 2), np.int64)
    starts[0] = next_node, next_group
    run_short(_count_subtrees, threads, new_ticket(len(roots), 1), bvh, prices, roots, starts[1:])
    starts = np.cumsum(starts, axis=0)
    nodes = aligned_empty((int(starts[-1, 0]), NODE_WORDS), "f4")
    slots = np.full((1, WIDTH), -1, np.int32) if starts[-1, 1] == 0 else np.empty((starts[-1, 1], WIDTH), np.int32)
    out = WideArrays(nodes, nodes.view(np.int32), slots)
    _collapse_top(bvh, prices, _SUBTREES, todo, out)
    run_short(_collapse_subtrees, threads, new_ticket(len(roots), 1), bvh, prices, roots, first, starts, out)
    return out, WideParts(first, starts[:, 0].copy())


def widen(bvh: Bvh, threads: int | None = None) -> WideBvh:
    """The wide BVH of a binary one, identical for any number of threads."""
    threads = min(thread_count(threads), 1 + len(bvh.prim_ids) // _PER_THREAD)
    (nodes, links, slots), parts = _collapsed(bvh, _priced(bvh, threads), threads)
    groups, areas = aligned_empty((len(slots), GROUP_WORDS), "f4"), np.zeros(len(slots))
    run_short(_fill_groups, threads, new_ticket(len(slots), 256), bvh.corners, slots, groups, areas)
    order_wide_children(nodes, areas, parts, threads)
    return WideBvh(nodes, links, groups, slots, reach_of_root(nodes), bvh)


@inlined
def child_areas(nodes, at):
    """Half the areas of the boxes of the children of the node at word `at`, one per lane, as float64; 0 for none."""
    lower, upper = load8(nodes, at), load8(nodes, at + WIDTH)
    is_child, zero = lower <= upper, np.float32(0.0)
    x = to_f64(select(is_child, upper, zero)) - to_f64(select(is_child, lower, zero))
    lower, upper = load8(nodes, at + 2 * WIDTH), load8(nodes, at + 3 * WIDTH)
    y = to_f64(select(is_child, upper, zero)) - to_f64(select(is_child, lower, zero))
    lower, upper = load8(nodes, at + 4 * WIDTH), load8(nodes, at + 5 * WIDTH)
    z = to_f64(select(is_child, upper, zero)) - to_f64(select(is_child, lower, zero))
    return x * y + y * z + z * x


@inlined
def sum_of_lanes(areas, scratch):
    """The sum of eight float64; scratch: float64 *."""
    store(scratch, 0, areas)
    total = 0.0
    for lane in range(WIDTH):
        total += get(scratch, lane)
    return total


@kernel
def _sum_areas(ticket, nodes, sums):
    """Worker: sum `child_areas`, per share of the nodes."""
    words, scratch = ptr(nodes), stack_f64(WIDTH)
    for first, last in shares(ticket):
        total = to_f64(splat8(np.float32(0.0)))
        for node in range(first, last):
            total = total + child_areas(words, node * NODE_WORDS)
        sums[first // ticket[CHUNK]] = sum_of_lanes(total, scratch)


def wide_cost(wide: WideBvh, threads: int) -> float:
    """The SAH cost: the expected number of nodes and groups that a ray enters if it hits the root's box.

    The result is bitwise identical for any number of threads. It is 1 if the box has no area.
    """
    sums = np.zeros(-(-len(wide.nodes) // _SUMMED))
    run(_sum_areas, threads, new_ticket(len(wide.nodes), _SUMMED), wide.nodes, sums)
    return cost_of_areas(wide.nodes, float(sums.sum()))


def cost_of_areas(nodes: NDArray[np.float32], areas: float) -> float:
    """`wide_cost` of nodes whose `child_areas` have this sum."""
    planes = nodes[0, :LINKS].reshape(3, 2, WIDTH).astype(np.float64)
    planes = planes[:, :, planes[0, 0] <= planes[0, 1]]
    if planes.size == 0:
        return 1.0
    x, y, z = planes[:, 1].max(1) - planes[:, 0].min(1)
    area = x * y + y * z + z * x
    return 1.0 + float(areas / area) if area > 0.0 else 1.0


def reach_of(boxes: NDArray[np.float32]) -> Reach:
    """The `Reach` of boxes, (n, 2, 3) float32; 0 without boxes."""
    x, y, z = np.abs(boxes).max(axis=(0, 1), initial=np.float32(0.0))
    return x, y, z


def reach_of_root(nodes: NDArray[np.float32]) -> Reach:
    """`WideBvh.reach`."""
    planes = nodes[0, :LINKS].reshape(3, 2, WIDTH)
    is_child = planes[0, 0] <= planes[0, 1]
    return reach_of(planes[:, :, is_child].T)
