"""`tl-lbvh`: treelet restructuring [Karras and Aila 2013, "Fast parallel construction of high-quality bounding volume
hierarchies"] of a BVH whose leaves have one triangle each.

A treelet is a node and what is below it, opened at the largest box until seven boxes are left. Of all trees over these
seven the cheapest is found by dynamic programming over their 127 subsets, and takes the treelet's place. Nodes are
treated after all below them, in a few rounds, the later ones only where there are more triangles.

Departures from the paper: the dynamic programming of sixteen treelets is done side by side, one a lane, where the paper
gives each to a warp of threads; areas are those of the halves {0, 1, 2} and {3, .., 6} joined.
"""

import math
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take
from ..simd import (
    bits,
    extract,
    get,
    iota8,
    load4,
    load16,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    select,
    shuffle,
    splat8,
    splat16,
    stack_f32,
    stack_i32,
    store,
)
from .cut import cut
from .nodes import MAX_DEPTH, Bvh
from .relayout import relayout

LEAVES = 7
_LANES = 16
_SUBSETS = 1 << LEAVES
_ALL = _SUBSETS - 1
_ROW = 6 * _LANES  # words of one box of each lane: lower x, y, z, upper x, y, z
_BOXES = LEAVES * _ROW
_PLANS = _SUBSETS * _LANES
_UNIONS = (8 + 16) * _ROW
_LISTS = 8 * _LANES
_INF = np.float32(np.inf)
_LESS = np.float32(1.0 - 2.0**-18)  # a new treelet must cost less than this times the old: more than rounding


class Part(NamedTuple):
    """Some nodes of a tree, all those below one of them: pointers, to be indexed by the number of the node."""

    nodes: object  # float32 *, 16 a node
    links: object  # int32 *, the same memory
    counts: object  # int32 *: leaves below a node
    costs: object  # float32 *: SAH cost of the subtree, times half the area of the root
    heights: object  # int32 *: inner nodes on the longest path down, the node's own included
    rooms: object  # int32 *: the most that the height may be
    parents: object  # int32 *: the node's parent in this round; -1 for the root
    pending: object  # int32 *: children to be treated before the node in this round


class Batch(NamedTuple):
    """Sixteen treelets, one a lane; a subset is the set of the bits of its index."""

    boxes: object  # float32 *: [leaf][lower and upper x, y, z][lane]
    costs: object  # float32 *, [subset][lane]: half the area, then the least cost of a tree
    counts: object  # float32 *, [subset][lane]: triangles
    lefts: object  # int32 *, [subset][lane]: the subset that becomes the left child
    places: object  # int32 *, [lane][leaf]: index of the link to a leaf of the treelet
    inner: object  # int32 *, [lane][0..5]: the nodes of the treelet; the root is the first


class Rules(NamedTuple):
    """What all treelets of a tree are made by."""

    max_leaf: object  # int64: up to so many triangles become one leaf where that is cheaper
    scale: object  # float32, a power of two: makes the largest coordinate about 1, so that no area overflows
    rounds: object  # int64


@inlined
def _areas_of_children(nodes, node, scale):
    """Half the area of the box of the left child, of the right child, and twice something else."""
    x, y, z = load4(nodes, node * 16), load4(nodes, node * 16 + 4), load4(nodes, node * 16 + 8)
    x = (shuffle(x, 2, 3, 0, 1) - x) * scale
    y = (shuffle(y, 2, 3, 0, 1) - y) * scale
    z = (shuffle(z, 2, 3, 0, 1) - z) * scale
    return x * (y + z) + y * z


@inlined
def _area_of_node(nodes, node, scale):
    """Half the area of the box around both children."""
    b = node * 16
    x = (max(get(nodes, b + 2), get(nodes, b + 3)) - min(get(nodes, b), get(nodes, b + 1))) * scale
    y = (max(get(nodes, b + 6), get(nodes, b + 7)) - min(get(nodes, b + 4), get(nodes, b + 5))) * scale
    z = (max(get(nodes, b + 10), get(nodes, b + 11)) - min(get(nodes, b + 8), get(nodes, b + 9))) * scale
    return x * (y + z) + y * z


@kernel
def _measure(part, first, last, rules):
    """Fill counts, costs and heights; children have higher numbers than their parents."""
    for node in range(last - 1, first - 1, -1):
        areas = _areas_of_children(part.nodes, node, rules.scale)
        count, cost, height = np.int64(0), np.float32(0.0), np.int64(0)
        for side in range(2):
            link = np.int64(get(part.links, node * 16 + 12 + side))
            if link < 0:
                count += 1
                cost += extract(areas, side)
            else:
                count += get(part.counts, link)
                cost += get(part.costs, link)
                height = max(height, np.int64(get(part.heights, link)))
        area = _area_of_node(part.nodes, node, rules.scale)
        cost += area
        put(part.counts, node, count)
        put(part.costs, node, min(cost, area * np.float32(count)) if count <= rules.max_leaf else cost)
        put(part.heights, node, height + 1)


@inlined
def _counts_at_least(part, link, least):
    return link >= 0 and get(part.counts, max(link, np.int64(0))) >= least


@kernel
def _schedule(part, first, room, least, queue, waiting):
    """Put the nodes that no other has to be treated before into the queue; how many.

    Nodes with less than `least` leaves below are not treated in this round.
    """
    if get(part.counts, first) < least:
        return 0
    put(waiting, 0, first)
    put(part.parents, first, -1)
    put(part.rooms, first, room)
    height, n = 1, 0
    while height > 0:
        height -= 1
        node, pending = np.int64(get(waiting, height)), 0
        for side in range(2):
            child = np.int64(get(part.links, node * 16 + 12 + side))
            if _counts_at_least(part, child, least):
                put(part.parents, child, node)
                put(part.rooms, child, get(part.rooms, node) - 1)
                put(waiting, height, child)
                height += 1
                pending += 1
        put(part.pending, node, pending)
        if pending == 0:
            put(queue, n, node)
            n += 1
    return n


@kernel
def _form(part, root, lane, batch, rules):
    """The treelet of a node: its largest box is opened until it has LEAVES leaves [Karras and Aila 2013, Sec. 4.2]."""
    places, inner = ptr_at(batch.places, lane * 8), ptr_at(batch.inner, lane * 8)
    node, hole, areas = np.int64(root), np.int64(0), splat8(np.float32(-1.0))
    for k in range(1, LEAVES):
        put(inner, k - 1, node)
        put(places, hole, node * 16 + 12)
        put(places, k, node * 16 + 13)
        both = _areas_of_children(part.nodes, node, rules.scale)
        left = extract(both, 0) if get(part.links, node * 16 + 12) >= 0 else np.float32(-1.0)
        right = extract(both, 1) if get(part.links, node * 16 + 13) >= 0 else np.float32(-1.0)
        areas = select(iota8() == np.int32(hole), left, select(iota8() == np.int32(k), right, areas))
        hole = lowest_bit(bits(areas == reduce_max(areas)))
        node = np.int64(get(part.links, np.int64(get(places, hole))))
    for leaf in range(LEAVES):
        _add_leaf(part, np.int64(get(places, leaf)), leaf, lane, batch, rules)


@inlined
def _add_leaf(part, place, leaf, lane, batch, rules):
    """Box, cost and count of a leaf of the treelet in this lane."""
    nodes, box, link = part.nodes, (place >> 4) * 16 + (place & 1), np.int64(get(part.links, place))
    row = leaf * _ROW + lane
    for k in range(3):
        put(batch.boxes, row + k * _LANES, get(nodes, box + 4 * k))
        put(batch.boxes, row + (k + 3) * _LANES, get(nodes, box + 4 * k + 2))
    cost, count = np.float32(-1.0), np.float32(1.0)
    if link >= 0:
        cost, count = get(part.costs, link), np.float32(get(part.counts, link))
    put(batch.costs, (1 << leaf) * _LANES + lane, cost)
    put(batch.counts, (1 << leaf) * _LANES + lane, count)


@kernel
def _unite(boxes, first, n, scale, unions):
    """The scaled box of every subset of the n leaves from `first` on."""
    for k in range(6):
        store(unions, k * _LANES, splat16(_INF if k < 3 else -_INF))
    for subset in range(1, 1 << n):
        rest, leaf = subset & (subset - 1), first + lowest_bit(subset)
        for k in range(6):
            here, there = load16(boxes, leaf * _ROW + k * _LANES) * scale, load16(unions, rest * _ROW + k * _LANES)
            store(unions, subset * _ROW + k * _LANES, minimum(here, there) if k < 3 else maximum(here, there))


@kernel
def _price_subsets(batch, scale, unions):
    """Half the area of every subset's box to `costs`; those of single leaves only where they have no cost yet."""
    high = ptr_at(unions, 8 * _ROW)
    _unite(batch.boxes, 0, 3, scale, unions)
    _unite(batch.boxes, 3, 4, scale, high)
    for h in range(16):
        a = h * _ROW
        x0, y0, z0 = load16(high, a), load16(high, a + _LANES), load16(high, a + 2 * _LANES)
        x1, y1, z1 = load16(high, a + 3 * _LANES), load16(high, a + 4 * _LANES), load16(high, a + 5 * _LANES)
        for low in range(1 if h == 0 else 0, 8):
            b = low * _ROW
            x = maximum(x1, load16(unions, b + 3 * _LANES)) - minimum(x0, load16(unions, b))
            y = maximum(y1, load16(unions, b + 4 * _LANES)) - minimum(y0, load16(unions, b + _LANES))
            z = maximum(z1, load16(unions, b + 5 * _LANES)) - minimum(z0, load16(unions, b + 2 * _LANES))
            area, subset = x * (y + z) + y * z, 8 * h + low
            if subset & (subset - 1) == 0:
                given = load16(batch.costs, subset * _LANES)
                area = select(given < np.float32(0.0), area, given)
            store(batch.costs, subset * _LANES, area)


@kernel
def _plan(batch, rules):
    """The best tree over each subset, of all there are [Karras and Aila 2013, Algorithm 2]."""
    costs, max_leaf = batch.costs, np.float32(rules.max_leaf)
    for subset in range(3, _SUBSETS):
        low = subset & -subset
        rest = subset ^ low
        if rest == 0:
            continue
        best, left = load16(costs, low * _LANES) + load16(costs, rest * _LANES), splat16(np.int32(low))
        part = (rest - 1) & rest
        while part != 0:
            both = load16(costs, (low | part) * _LANES) + load16(costs, (rest ^ part) * _LANES)
            left = select(both < best, np.int32(low | part), left)
            best = minimum(best, both)
            part = (part - 1) & rest
        area, count = load16(costs, subset * _LANES), load16(batch.counts, low * _LANES)
        count += load16(batch.counts, rest * _LANES)
        best += area
        store(costs, subset * _LANES, select(count <= max_leaf, minimum(best, area * count), best))
        store(batch.counts, subset * _LANES, count)
        store(batch.lefts, subset * _LANES, left)


@inlined
def _copy_box(boxes, leaf, lane, nodes, at):
    """The box of a treelet's leaf to the child box whose first word is `at`."""
    row = leaf * _ROW + lane
    for k in range(3):
        put(nodes, at + 4 * k, get(boxes, row + k * _LANES))
        put(nodes, at + 4 * k + 2, get(boxes, row + (k + 3) * _LANES))


@inlined
def _join_box(nodes, node, at):
    """The box around both children of a node to the child box whose first word is `at`."""
    for k in range(node * 16, node * 16 + 12, 4):
        put(nodes, at, min(get(nodes, k), get(nodes, k + 1)))
        put(nodes, at + 2, max(get(nodes, k + 2), get(nodes, k + 3)))
        at += 4


@kernel
def _unfold(batch, lane, subsets, children):
    """The inner nodes of the best tree, parents first: their subsets, and their children.

    A child is the number of an inner node, or ~leaf.
    """
    put(subsets, 0, _ALL)
    n = 1
    for i in range(LEAVES - 1):
        subset = np.int64(get(subsets, i))
        half = np.int64(get(batch.lefts, subset * _LANES + lane))
        for side in range(2):
            if half & (half - 1) == 0:
                put(children, 2 * i + side, ~lowest_bit(half))
            else:
                put(children, 2 * i + side, n)
                put(subsets, n, half)
                n += 1
            half = subset ^ half


@inlined
def _height(part, links, children, heights, i):
    """Inner nodes on the longest path down from inner node `i` of a new treelet."""
    height = np.int64(0)
    for side in range(2):
        child = np.int64(get(children, 2 * i + side))
        if child >= 0:
            height = max(height, np.int64(get(heights, child)))
        else:
            link = np.int64(get(links, ~child))
            if link >= 0:
                height = max(height, np.int64(get(part.heights, link)))
    return height + 1


@kernel
def _replace(part, lane, batch):
    """Put the best tree in the treelet's place, unless a path would become too long."""
    subsets, children, heights, links = stack_i32(8), stack_i32(16), stack_i32(8), stack_i32(8)
    inner, places = ptr_at(batch.inner, lane * 8), ptr_at(batch.places, lane * 8)
    _unfold(batch, lane, subsets, children)
    for leaf in range(LEAVES):
        put(links, leaf, get(part.links, np.int64(get(places, leaf))))
    for i in range(LEAVES - 2, -1, -1):
        put(heights, i, _height(part, links, children, heights, i))
    if get(heights, 0) > get(part.rooms, np.int64(get(inner, 0))):
        return
    for i in range(LEAVES - 2, -1, -1):
        node, subset = np.int64(get(inner, i)), np.int64(get(subsets, i))
        for side in range(2):
            child, at = np.int64(get(children, 2 * i + side)), node * 16 + side
            if child < 0:
                _copy_box(batch.boxes, ~child, lane, part.nodes, at)
                put(part.links, at + 12, get(links, ~child))
            else:
                _join_box(part.nodes, np.int64(get(inner, child)), at)
                put(part.links, at + 12, get(inner, child))
        put(part.heights, node, get(heights, i))
        put(part.costs, node, get(batch.costs, subset * _LANES + lane))
        put(part.counts, node, get(batch.counts, subset * _LANES + lane))


@kernel
def _round(part, queue, n, batch, unions, rules):
    """Treat the `n` nodes in the queue, sixteen at once, and then those that have waited for them."""
    done = 0
    while done < n:
        lanes = min(_LANES, n - done)
        for lane in range(lanes):
            _form(part, get(queue, done + lane), lane, batch, rules)
        _price_subsets(batch, rules.scale, unions)
        _plan(batch, rules)
        for lane in range(lanes):
            node = np.int64(get(queue, done + lane))
            if get(batch.costs, _ALL * _LANES + lane) < get(part.costs, node) * _LESS:
                _replace(part, lane, batch)
            parent = np.int64(get(part.parents, node))
            if parent >= 0:
                put(part.pending, parent, get(part.pending, parent) - 1)
                if get(part.pending, parent) == 0:
                    put(queue, n, parent)
                    n += 1
        done += lanes


class _Scratch(NamedTuple):
    """A thread's own memory, for a part of up to m nodes."""

    numbers: np.ndarray  # (6, m) int32: of each node what `Part` has, and the queue
    costs: np.ndarray  # (m,) float32
    waiting: np.ndarray  # (2 * MAX_DEPTH + 2,) int32


@kernel
def _scratch(m):
    return _Scratch(np.empty((6, m), np.int32), np.empty(m, np.float32), np.empty(2 * MAX_DEPTH + 2, np.int32))


@kernel
def _restructure(nodes, links, first, last, room, rules, scratch):
    """Treat the nodes from `first` to `last` - 1, all those below `first`, a tree at most `room` high; its height."""
    m, numbers = len(scratch.costs), ptr(scratch.numbers)
    part = Part(
        nodes, links, ptr_at(numbers, -first), ptr_at(ptr(scratch.costs), -first), ptr_at(numbers, m - first),
        ptr_at(numbers, 2 * m - first), ptr_at(numbers, 3 * m - first), ptr_at(numbers, 4 * m - first),
    )  # fmt: skip
    batch = Batch(
        stack_f32(_BOXES), stack_f32(_PLANS), stack_f32(_PLANS), stack_i32(_PLANS), stack_i32(_LISTS), stack_i32(_LISTS)
    )
    unions, queue = stack_f32(_UNIONS), ptr_at(numbers, 5 * m)
    for k in range(0, _BOXES, _LANES):
        store(batch.boxes, k, splat16(np.float32(0.0)))  # lanes that a batch leaves out
    _measure(part, first, last, rules)
    least = LEAVES
    for _ in range(rules.rounds):
        ready = _schedule(part, first, room, least, queue, ptr(scratch.waiting))
        _round(part, queue, ready, batch, unions, rules)
        least *= 2
    return np.int64(get(part.heights, first))


@kernel
def _restructure_parts(ticket, bvh, parts, rules, heights):
    """Worker: treat the nodes of each part; how high it then is."""
    scratch = _scratch(np.max(parts[:, 1] - parts[:, 0]))
    nodes, links = ptr(bvh.nodes), ptr(bvh.links)
    p = take(ticket)
    while p >= 0:
        root, end, depth = parts[p]
        if root >= 0:
            heights[p] = _restructure(nodes, links, root, end, MAX_DEPTH - depth, rules, scratch)
        p = take(ticket)


@kernel
def _restructure_top(top, links, room, rules):
    _restructure(ptr(top), ptr(links), 0, len(top), room, rules, _scratch(len(top)))


def _scale_of(bvh) -> np.float32:
    largest = float(np.abs(bvh.nodes[0, :12]).max())
    return np.float32(2.0 ** min(126, -math.frexp(largest)[1]))


def restructure(bvh: Bvh, max_leaf: int, threads: int, rounds: int = 3) -> Bvh:
    """A cheaper tree, by treelets of a BVH of two triangles or more, depth first and with one triangle a leaf.

    `bvh` is changed on the way and of no more use.
    """
    pieces = cut(bvh)
    heights = np.zeros(len(pieces.parts), np.int64)
    rules = Rules(np.int64(max_leaf), _scale_of(bvh), np.int64(rounds))
    run(_restructure_parts, threads, new_ticket(len(heights), 1), bvh, pieces.parts, rules, heights)
    if len(pieces.top):
        room = MAX_DEPTH - heights.max()
        _restructure_top(pieces.top, pieces.top.view(np.int32), room, rules._replace(max_leaf=np.int64(0)))
    return relayout(bvh, pieces, max_leaf, threads)
