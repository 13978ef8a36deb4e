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
    as_f32,
    as_i32,
    bits,
    extract,
    get,
    iota4,
    iota8,
    load4,
    load8,
    load16,
    lowest_bit,
    mask_from_bits8,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    select,
    shuffle,
    splat4,
    splat8,
    splat16,
    stack_f32,
    stack_i32,
    store,
)
from .cut import cut
from .nodes import MAX_DEPTH, Bvh
from .relayout import Choice, relayout

LEAVES = 7
_INNER = LEAVES - 1
_LANES = 16
_SUBSETS = 1 << LEAVES
_ALL = _SUBSETS - 1
_LEAF = _SUBSETS
_ROW = 6 * _LANES  # words of one box of each lane: lower x, y, z, upper x, y, z
_BOXES = LEAVES * _ROW
_PLANS = _SUBSETS * _LANES
_UNIONS = (8 + 16) * _ROW
_LISTS = 8 * _LANES
_LINKS = 16 * _LANES
_PAIRS = 16 * _INNER * _LANES
_FACTS = 4 * 8 * _LANES
_INF = np.float32(np.inf)
_MINUS_ONE = np.float32(-1.0).view(np.int32)
_LESS = np.float32(1.0 - 2.0**-18)  # a new treelet must cost less than this times the old: more than rounding


class Part(NamedTuple):
    """Some nodes of a tree, all those below one of them: pointers, to be indexed by the number of the node."""

    nodes: object  # float32 *, 16 a node
    links: object  # int32 *, the same memory
    facts: object  # int32 *, 4 a node, of what is below it: see below
    is_leaf: object  # bool *: whether it is cheaper to make one leaf of all that
    rooms: object  # int32 *: the most inner nodes that a path down may have
    parents: object  # int32 *: the node's parent in this round; -1 for the root
    pending: object  # int32 *: children to be treated before the node in this round


COST = 0  # SAH cost, times half the area of the tree's root: a float32
COUNT = 1  # triangles
KEPT = 2  # nodes that stay nodes
HEIGHT = 3  # inner nodes on the longest path down, the node's own included


class Batch(NamedTuple):
    """Sixteen treelets, one a lane; a subset is the set of the bits of its index."""

    pairs: object  # float32 *, [lane][node][side]: boxes as eight words: lower x, y, z, -, upper x, y, z, -
    links: object  # int32 *, [lane][node][side]
    inner: object  # int32 *, [lane][node]: the nodes opened; the root is the first
    places: object  # int32 *, [lane][leaf]: 2 * node + side
    facts: object  # int32 *, [lane][leaf]: as in `Part`; a single triangle has no cost yet, but a negative number
    boxes: object  # float32 *: [leaf][lower and upper x, y, z][lane]
    costs: object  # float32 *, [subset][lane]: half the area, then the least cost of a tree
    counts: object  # float32 *, [subset][lane]: triangles
    lefts: object  # int32 *, [subset][lane]: the subset that becomes the left child, _LEAF added if a leaf is cheaper
    unions: object  # float32 *: boxes of all subsets of the first three leaves, and of the last four


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
def _measure(part, node, rules):
    """The facts of a node, from those of its children; its cost."""
    costs, areas = as_f32(part.facts), _areas_of_children(part.nodes, node, rules.scale)
    count, cost, kept, height = np.int64(0), np.float32(0.0), np.int64(1), np.int64(0)
    for side in range(2):
        link = np.int64(get(part.links, node * 16 + 12 + side))
        if link < 0:
            count += 1
            cost += extract(areas, side)
        else:
            cost += get(costs, link * 4 + COST)
            count += get(part.facts, link * 4 + COUNT)
            kept += get(part.facts, link * 4 + KEPT)
            height = max(height, np.int64(get(part.facts, link * 4 + HEIGHT)))
    area = _area_of_node(part.nodes, node, rules.scale)
    cost, as_leaf = cost + area, area * np.float32(count)
    if count <= rules.max_leaf and as_leaf <= cost and node != 0:  # the root never is a leaf
        cost, kept = as_leaf, np.int64(0)
    put(costs, node * 4 + COST, cost)
    put(part.facts, node * 4 + COUNT, count)
    put(part.facts, node * 4 + KEPT, kept)
    put(part.facts, node * 4 + HEIGHT, height + 1)
    put(part.is_leaf, node, kept == 0)
    return cost


@kernel
def _schedule(part, first, room, least, queue, waiting):
    """Put the nodes that no other has to be treated before into the queue; how many.

    Nodes with less than `least` triangles below are not treated in this round.
    """
    if get(part.facts, first * 4 + COUNT) < least:
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
            if child >= 0 and get(part.facts, child * 4 + COUNT) >= least:
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
    pairs, links = ptr_at(batch.pairs, lane * _INNER * 16), ptr_at(batch.links, lane * 16)
    inner, places = ptr_at(batch.inner, lane * 8), ptr_at(batch.places, lane * 8)
    node, hole, areas = np.int64(root), np.int64(0), splat8(np.float32(-1.0))
    for k in range(_INNER):
        line = load16(part.nodes, node * 16)
        store(pairs, k * 16, shuffle(line, 0, 4, 8, 0, 2, 6, 10, 2, 1, 5, 9, 1, 3, 7, 11, 3))
        both = _areas_of_children(part.nodes, node, rules.scale)
        left, right = get(part.links, node * 16 + 12), get(part.links, node * 16 + 13)
        put(inner, k, node)
        put(links, 2 * k, left)
        put(links, 2 * k + 1, right)
        put(places, hole, 2 * k)
        put(places, k + 1, 2 * k + 1)
        left_area = extract(both, 0) if left >= 0 else np.float32(-1.0)
        right_area = extract(both, 1) if right >= 0 else np.float32(-1.0)
        areas = select(iota8() == np.int32(hole), left_area, select(iota8() == np.int32(k + 1), right_area, areas))
        hole = lowest_bit(bits(areas == reduce_max(areas)))
        node = np.int64(get(links, np.int64(get(places, hole))))


@kernel
def _spread(part, root, lane, batch):
    """Facts and boxes of a treelet's leaves to where the dynamic programming reads them."""
    pairs, links = ptr_at(batch.pairs, lane * _INNER * 16), ptr_at(batch.links, lane * 16)
    facts = ptr_at(batch.facts, lane * 32)
    single = select(iota4() == np.int32(COUNT), splat4(np.int32(1)), np.int32(0))
    single = select(iota4() == np.int32(COST), _MINUS_ONE, single)
    for leaf in range(LEAVES):
        place = np.int64(get(batch.places, lane * 8 + leaf))
        row = leaf * _ROW + lane
        for k in range(3):
            put(batch.boxes, row + k * _LANES, get(pairs, place * 8 + k))
            put(batch.boxes, row + (k + 3) * _LANES, get(pairs, place * 8 + k + 4))
        link = np.int64(get(links, place))
        fact = load4(part.facts, (link if link >= 0 else root) * 4)  # some node's where there is none: no branch to mispredict
        fact = select(splat4(np.int32(link)) >= 0, fact, single)
        store(facts, leaf * 4, fact)
        put(batch.costs, (1 << leaf) * _LANES + lane, get(as_f32(facts), leaf * 4 + COST))
        put(batch.counts, (1 << leaf) * _LANES + lane, np.float32(extract(fact, COUNT)))


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
def _price_subsets(batch, scale):
    """Half the area of every subset's box to `costs`; those of single leaves only where they have no cost yet."""
    unions, high = batch.unions, ptr_at(batch.unions, 8 * _ROW)
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
        best, as_leaf = best + area, area * count
        is_leaf = (count <= max_leaf) & (as_leaf <= best)
        store(costs, subset * _LANES, select(is_leaf, as_leaf, best))
        store(batch.counts, subset * _LANES, count)
        store(batch.lefts, subset * _LANES, select(is_leaf, left | _LEAF, left))


@kernel
def _unfold(batch, lane, subsets, children):
    """The inner nodes of the best tree, parents first: their subsets, and their children.

    A child is a leaf of the treelet, or LEAVES + the number of an inner node.
    """
    put(subsets, 0, _ALL)
    n = 1
    for i in range(_INNER):
        subset = np.int64(get(subsets, i))
        half = np.int64(get(batch.lefts, subset * _LANES + lane)) & _ALL
        for side in range(2):
            is_leaf = half & (half - 1) == 0
            put(children, 2 * i + side, lowest_bit(half) if is_leaf else LEAVES + n)
            put(subsets, n, half)
            n += 0 if is_leaf else 1
            half = subset ^ half


@kernel
def _replace(part, lane, batch):
    """Put the best tree in the treelet's place, unless a path would become too long."""
    subsets, children, links, facts = stack_i32(8), stack_i32(16), stack_i32(16), stack_i32(64)
    boxes, pair = stack_f32(128), stack_f32(16)
    inner = ptr_at(batch.inner, lane * 8)
    _unfold(batch, lane, subsets, children)
    for leaf in range(LEAVES):
        place = np.int64(get(batch.places, lane * 8 + leaf))
        store(boxes, leaf * 8, load8(batch.pairs, lane * _INNER * 16 + place * 8))
        store(facts, leaf * 4, load4(batch.facts, lane * 32 + leaf * 4))
        put(links, leaf, get(batch.links, lane * 16 + place))
    for i in range(_INNER - 1, -1, -1):
        left, right = np.int64(get(children, 2 * i)), np.int64(get(children, 2 * i + 1))
        subset, at = np.int64(get(subsets, i)), (LEAVES + i) * 4
        is_leaf = get(batch.lefts, subset * _LANES + lane) & _LEAF != 0 and get(inner, i) != 0  # the root never is
        kept = 1 + get(facts, left * 4 + KEPT) + get(facts, right * 4 + KEPT)
        put(as_f32(facts), at + COST, get(batch.costs, subset * _LANES + lane))
        put(facts, at + COUNT, get(batch.counts, subset * _LANES + lane))
        put(facts, at + KEPT, 0 if is_leaf else kept)
        put(facts, at + HEIGHT, 1 + max(get(facts, left * 4 + HEIGHT), get(facts, right * 4 + HEIGHT)))
        put(links, LEAVES + i, get(inner, i))
    if get(facts, LEAVES * 4 + HEIGHT) > get(part.rooms, np.int64(get(inner, 0))):
        return
    lower = mask_from_bits8(15)
    for i in range(_INNER - 1, -1, -1):
        node, at = np.int64(get(inner, i)), LEAVES + i
        left, right = np.int64(get(children, 2 * i)), np.int64(get(children, 2 * i + 1))
        a, b = load8(boxes, left * 8), load8(boxes, right * 8)
        store(boxes, at * 8, select(lower, minimum(a, b), maximum(a, b)))
        store(pair, 0, a)
        store(pair, 8, b)
        line = shuffle(load16(pair, 0), 0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 3, 3, 3)
        store(part.nodes, node * 16, line)
        put(part.links, node * 16 + 12, get(links, left))
        put(part.links, node * 16 + 13, get(links, right))
        store(part.facts, node * 4, load4(facts, at * 4))
        put(part.is_leaf, node, get(facts, at * 4 + KEPT) == 0)


@kernel
def _round(part, queue, n, batch, rules):
    """Treat the `n` nodes in the queue, sixteen at once, and then those that have waited for them."""
    done = 0
    while done < n:
        lanes = min(_LANES, n - done)
        for lane in range(lanes):
            root = np.int64(get(queue, done + lane))
            _form(part, root, lane, batch, rules)
            _spread(part, root, lane, batch)
        _price_subsets(batch, rules.scale)
        _plan(batch, rules)
        for lane in range(lanes):
            node = np.int64(get(queue, done + lane))
            if get(batch.costs, _ALL * _LANES + lane) < _measure(part, node, rules) * _LESS:
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

    facts: np.ndarray  # (m, 4) int32
    numbers: np.ndarray  # (4, m) int32: what else `Part` has of each node, and the queue
    waiting: np.ndarray  # (2 * MAX_DEPTH + 2,) int32


@kernel
def _scratch(m):
    return _Scratch(np.empty((m, 4), np.int32), np.empty((4, m), np.int32), np.empty(2 * MAX_DEPTH + 2, np.int32))


@kernel
def _restructure(nodes, first, last, room, rules, is_leaf, scratch):
    """Treat the nodes from `first` to `last` - 1, all those below `first`, a tree at most `room` high.

    (nodes to keep, triangles, height) that it then has.
    """
    m, numbers = len(scratch.facts), ptr(scratch.numbers)
    part = Part(
        nodes, as_i32(nodes), ptr_at(ptr(scratch.facts), -4 * first), is_leaf, ptr_at(numbers, -first),
        ptr_at(numbers, m - first), ptr_at(numbers, 2 * m - first),
    )  # fmt: skip
    batch = Batch(
        stack_f32(_PAIRS), stack_i32(_LINKS), stack_i32(_LISTS), stack_i32(_LISTS), stack_i32(_FACTS),
        stack_f32(_BOXES), stack_f32(_PLANS), stack_f32(_PLANS), stack_i32(_PLANS), stack_f32(_UNIONS),
    )  # fmt: skip
    for k in range(0, _BOXES, _LANES):
        store(batch.boxes, k, splat16(np.float32(0.0)))  # lanes that a batch leaves out
    for node in range(last - 1, first - 1, -1):  # children have higher numbers than their parents
        _measure(part, node, rules)
    least = LEAVES
    for _ in range(rules.rounds):
        ready = _schedule(part, first, room, least, ptr_at(numbers, 3 * m), ptr(scratch.waiting))
        _round(part, ptr_at(numbers, 3 * m), ready, batch, rules)
        least *= 2
    return get(part.facts, first * 4 + KEPT), get(part.facts, first * 4 + COUNT), get(part.facts, first * 4 + HEIGHT)


@kernel
def _restructure_parts(ticket, bvh, parts, rules, choice, heights):
    """Worker: treat the nodes of each part; how high it then is."""
    scratch, nodes, is_leaf = _scratch(np.max(parts[:, 1] - parts[:, 0])), ptr(bvh.nodes), ptr(choice.is_leaf)
    p = take(ticket)
    while p >= 0:
        root, end, depth = parts[p]
        kept, count, height = np.int32(0), np.int32(1), np.int32(0)
        if root >= 0:
            kept, count, height = _restructure(nodes, root, end, MAX_DEPTH - depth, rules, is_leaf, scratch)
        choice.sizes[p, 0], choice.sizes[p, 1], heights[p] = kept, count, height
        p = take(ticket)


@kernel
def _restructure_top(top, room, rules):
    is_leaf = np.empty(len(top), np.bool_)
    _restructure(ptr(top), 0, len(top), room, rules, ptr(is_leaf), _scratch(len(top)))
    return is_leaf  # so that it lives until here


def _scale_of(bvh) -> np.float32:
    largest = float(np.abs(bvh.nodes[0, :12]).max())
    return np.float32(2.0 ** min(126, -math.frexp(largest)[1]))


def restructure(bvh: Bvh, max_leaf: int, threads: int, rounds: int = 3) -> Bvh:
    """A cheaper tree, by treelets of a BVH of two triangles or more, depth first and with one triangle a leaf.

    `bvh` is changed on the way and of no more use.
    """
    pieces = cut(bvh)
    heights = np.empty(len(pieces.parts), np.int64)
    choice = Choice(np.empty(len(bvh.nodes), np.bool_), np.empty((len(pieces.parts), 2), np.int64))
    rules = Rules(np.int64(max_leaf), _scale_of(bvh), np.int64(rounds))
    run(_restructure_parts, threads, new_ticket(len(heights), 1), bvh, pieces.parts, rules, choice, heights)
    if len(pieces.top):
        _restructure_top(pieces.top, MAX_DEPTH - heights.max(), rules._replace(max_leaf=np.int64(0)))
    return relayout(bvh, pieces, choice, threads)
