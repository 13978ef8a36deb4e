"""Treelet restructuring [Karras and Aila 2013, "Fast parallel construction of high-quality bounding volume
hierarchies"] of sixteen treelets at once, one a lane.

A treelet starts with one node. Its largest box is opened until seven boxes are left, the treelet's leaves. Dynamic
programming over their 127 subsets finds the cheapest of all trees over them, which takes the treelet's place.

Departure from the paper: it gives a treelet to a warp of threads. Here the dynamic programming goes through the subsets
in the same order for all treelets, so each treelet takes one lane of a vector.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import BoolPtr, F32Ptr, I32Ptr, inlined, kernel
from ..kernels.simd import (
    as_f32,
    as_i32,
    bits,
    extract,
    get,
    iota4,
    load4,
    load8,
    load16,
    lowest_bit,
    mask_from_bits8,
    maximum,
    minimum,
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
from .links import line_at, link_at

LEAVES = 7
_INNER = LEAVES - 1
LANES = 16
_SUBSETS = 1 << LEAVES
_ALL = _SUBSETS - 1
_LEAF = _SUBSETS
_ROW = 6 * LANES  # words of one box in all lanes: lower x, y, z, upper x, y, z
_PAIRS = 0  # first words of the arrays of a `Batch`
_BOXES = _PAIRS + 16 * _INNER * LANES
_COSTS = _BOXES + _ROW * LEAVES
_COUNTS = _COSTS + _SUBSETS * LANES
_LEFTS = _COUNTS + _SUBSETS * LANES
_UNIONS = _LEFTS + _SUBSETS * LANES
_FACTS = _UNIONS + _ROW * (8 + 16)
_LINKS = _FACTS + 32 * LANES
_NODES = _LINKS + 16 * LANES
_PLACES = _NODES + 8 * LANES
_AREAS = _PLACES + 8 * LANES
BATCH = _AREAS + 8 * LANES
_CLOSED = np.float32(-1.0)
_INF = np.float32(np.inf)
_MINUS_ONE = np.float32(-1.0).view(np.int32)


class TreePart(NamedTuple):
    """A subtree: pointers to arrays that the index of a node indexes."""

    nodes: F32Ptr  # float32 *, 16 a node
    links: I32Ptr  # int32 *, the same memory
    facts: I32Ptr  # int32 *, 4 a node, of its subtree: COST, COUNT, KEPT, HEIGHT
    is_leaf: BoolPtr  # bool *: whether one leaf is cheaper than the subtree
    rooms: I32Ptr  # int32 *: most inner nodes that a path down may have
    parents: I32Ptr  # int32 *: the node's parent in this round; -1 for the root
    pending: I32Ptr  # int32 *: children still to be treated before the node in this round


COST = 0  # SAH cost, times half the area of the tree's root: a float32
COUNT = 1  # triangles
KEPT = 2  # nodes that stay nodes
HEIGHT = 3  # inner nodes on the longest path down, the node's own included


class Batch(NamedTuple):
    """Sixteen treelets, one a lane. The bits of a subset's index are its leaves."""

    pairs: F32Ptr  # float32 *, [lane][node][side]: boxes as eight words: lower x, y, z, -, upper x, y, z, -
    links: I32Ptr  # int32 *, [lane][node][side]
    inner: I32Ptr  # int32 *, [lane][node]: the opened nodes, the root first
    places: I32Ptr  # int32 *, [lane][leaf]: 2 * node + side
    areas: F32Ptr  # float32 *, [lane][leaf]: half the area of the box; _CLOSED for a triangle
    facts: I32Ptr  # int32 *, [lane][leaf]: as in `TreePart`; the cost of a single triangle is negative: not yet known
    boxes: F32Ptr  # float32 *: [leaf][lower and upper x, y, z][lane]
    costs: F32Ptr  # float32 *, [subset][lane]: half the area, then the least cost of a tree
    counts: F32Ptr  # float32 *, [subset][lane]: triangles
    lefts: I32Ptr  # int32 *, [subset][lane]: subset of the left child, plus _LEAF if a leaf is cheaper
    unions: F32Ptr  # float32 *: boxes of all subsets of the first three leaves, then of the last four


@inlined
def batch_at(memory):
    """A batch in BATCH float32 of memory."""
    words = as_i32(memory)
    boxes = ptr_at(memory, _BOXES)
    for k in range(0, _ROW * LEAVES, LANES):
        store(boxes, k, splat16(np.float32(0.0)))  # for lanes without a treelet
    return Batch(
        memory, ptr_at(words, _LINKS), ptr_at(words, _NODES), ptr_at(words, _PLACES), ptr_at(memory, _AREAS),
        ptr_at(words, _FACTS), boxes,
        ptr_at(memory, _COSTS), ptr_at(memory, _COUNTS), ptr_at(words, _LEFTS), ptr_at(memory, _UNIONS),
    )  # fmt: skip


class Rules(NamedTuple):
    """Settings for all treelets of a tree."""

    max_leaf: int  # most triangles of a leaf
    scale: np.float32  # a power of two: scales the largest coordinate to about 1, so no area overflows
    rounds: int  # they treat nodes with at least 7, 14, 28, ... triangles


@inlined
def areas_of_children(nodes, node, scale):
    """Lanes 0 and 1: half the area of the left and right child's box. Lanes 2 and 3 have no meaning."""
    x, y, z = load4(nodes, line_at(node)), load4(nodes, line_at(node) + 4), load4(nodes, line_at(node) + 8)
    x = (shuffle(x, 2, 3, 0, 1) - x) * scale
    y = (shuffle(y, 2, 3, 0, 1) - y) * scale
    z = (shuffle(z, 2, 3, 0, 1) - z) * scale
    return x * (y + z) + y * z


@inlined
def _open(part, k, lane, batch, rules):
    """Open the largest box of a treelet of k + 1 leaves."""
    links, places = ptr_at(batch.links, lane * 16), ptr_at(batch.places, lane * 8)
    areas = load8(batch.areas, lane * 8)
    hole = lowest_bit(bits(areas == reduce_max(areas)))
    node = np.int64(get(links, np.int64(get(places, hole))))
    line = load16(part.nodes, line_at(node))
    store(batch.pairs, (lane * _INNER + k) * 16, shuffle(line, 0, 4, 8, 0, 2, 6, 10, 2, 1, 5, 9, 1, 3, 7, 11, 3))
    both = areas_of_children(part.nodes, node, rules.scale)
    left, right = get(part.links, link_at(node, 0)), get(part.links, link_at(node, 1))
    put(batch.inner, lane * 8 + k, node)
    put(links, 2 * k, left)
    put(links, 2 * k + 1, right)
    put(places, hole, 2 * k)
    put(places, k + 1, 2 * k + 1)
    put(batch.areas, lane * 8 + hole, extract(both, 0) if left >= 0 else _CLOSED)
    put(batch.areas, lane * 8 + k + 1, extract(both, 1) if right >= 0 else _CLOSED)


@kernel
def form(part, roots, lanes, batch, rules):
    """Form the treelets of `roots`: open the largest box until LEAVES are left [Karras and Aila 2013, Sec. 4.2]."""
    for lane in range(lanes):
        store(batch.areas, lane * 8, splat8(_CLOSED))
        put(batch.places, lane * 8, 2 * _INNER)  # a free place for the root, which is opened first
        put(batch.links, lane * 16 + 2 * _INNER, get(roots, lane))
    for k in range(_INNER):
        for lane in range(lanes):  # interleaved: a step depends on its own lane's last step only
            _open(part, k, lane, batch, rules)


@kernel
def spread(part, root, lane, batch):
    """Copy facts and boxes of a treelet's leaves to the arrays of the dynamic programming."""
    pairs, links = ptr_at(batch.pairs, lane * _INNER * 16), ptr_at(batch.links, lane * 16)
    facts = ptr_at(batch.facts, lane * 32)
    single = select(iota4() == np.int32(COUNT), splat4(np.int32(1)), np.int32(0))
    single = select(iota4() == np.int32(COST), _MINUS_ONE, single)
    for leaf in range(LEAVES):
        place = np.int64(get(batch.places, lane * 8 + leaf))
        row = leaf * _ROW + lane
        for k in range(3):
            put(batch.boxes, row + k * LANES, get(pairs, place * 8 + k))
            put(batch.boxes, row + (k + 3) * LANES, get(pairs, place * 8 + k + 4))
        link = np.int64(get(links, place))
        fact = load4(part.facts, (link if link >= 0 else root) * 4)  # for a triangle any node, without a branch
        fact = select(splat4(np.int32(link)) >= 0, fact, single)
        store(facts, leaf * 4, fact)
        put(batch.costs, (1 << leaf) * LANES + lane, get(as_f32(facts), leaf * 4 + COST))
        put(batch.counts, (1 << leaf) * LANES + lane, np.float32(extract(fact, COUNT)))


@kernel
def _unite(boxes, first, n, scale, unions):
    """Write the scaled box of every subset of the n leaves from `first` on to `unions`."""
    for k in range(6):
        store(unions, k * LANES, splat16(_INF if k < 3 else -_INF))
    for subset in range(1, 1 << n):
        rest, leaf = subset & (subset - 1), first + lowest_bit(subset)
        for k in range(6):
            here, there = load16(boxes, leaf * _ROW + k * LANES) * scale, load16(unions, rest * _ROW + k * LANES)
            store(unions, subset * _ROW + k * LANES, minimum(here, there) if k < 3 else maximum(here, there))


@kernel
def price_subsets(batch, scale):
    """Write half the area of every subset's box to `costs`. Single leaves keep a known cost."""
    unions, high = batch.unions, ptr_at(batch.unions, 8 * _ROW)
    _unite(batch.boxes, 0, 3, scale, unions)
    _unite(batch.boxes, 3, 4, scale, high)
    for h in range(16):
        a = h * _ROW
        x0, y0, z0 = load16(high, a), load16(high, a + LANES), load16(high, a + 2 * LANES)
        x1, y1, z1 = load16(high, a + 3 * LANES), load16(high, a + 4 * LANES), load16(high, a + 5 * LANES)
        for low in range(1 if h == 0 else 0, 8):
            b = low * _ROW
            x = maximum(x1, load16(unions, b + 3 * LANES)) - minimum(x0, load16(unions, b))
            y = maximum(y1, load16(unions, b + 4 * LANES)) - minimum(y0, load16(unions, b + LANES))
            z = maximum(z1, load16(unions, b + 5 * LANES)) - minimum(z0, load16(unions, b + 2 * LANES))
            area, subset = x * (y + z) + y * z, 8 * h + low
            if subset & (subset - 1) == 0:
                given = load16(batch.costs, subset * LANES)
                area = select(given < np.float32(0.0), area, given)
            store(batch.costs, subset * LANES, area)


@kernel
def plan(batch, rules):
    """Find the best of all trees over each subset [Karras and Aila 2013, Algorithm 2]."""
    costs, max_leaf = batch.costs, np.float32(rules.max_leaf)
    for subset in range(3, _SUBSETS):
        low = subset & -subset
        rest = subset ^ low
        if rest == 0:
            continue
        best, left = load16(costs, low * LANES) + load16(costs, rest * LANES), splat16(np.int32(low))
        part = (rest - 1) & rest
        while part != 0:
            both = load16(costs, (low | part) * LANES) + load16(costs, (rest ^ part) * LANES)
            left = select(both < best, np.int32(low | part), left)
            best = minimum(best, both)
            part = (part - 1) & rest
        area, count = load16(costs, subset * LANES), load16(batch.counts, low * LANES)
        count += load16(batch.counts, rest * LANES)
        best, as_leaf = best + area, area * count
        is_leaf = (count <= max_leaf) & (as_leaf <= best)
        store(costs, subset * LANES, select(is_leaf, as_leaf, best))
        store(batch.counts, subset * LANES, count)
        store(batch.lefts, subset * LANES, select(is_leaf, left | _LEAF, left))


@inlined
def cost_of_best(batch, lane):
    """The cost of the best tree over the leaves of a treelet."""
    return get(batch.costs, _ALL * LANES + lane)


@kernel
def _unfold(batch, lane, subsets, children):
    """Write subsets and children of the best tree's inner nodes, parents first.

    A child is a leaf of the treelet, or LEAVES + the index of an inner node.
    """
    put(subsets, 0, _ALL)
    n = 1
    for i in range(_INNER):
        subset = np.int64(get(subsets, i))
        half = np.int64(get(batch.lefts, subset * LANES + lane)) & _ALL
        for side in range(2):
            is_leaf = half & (half - 1) == 0
            put(children, 2 * i + side, lowest_bit(half) if is_leaf else LEAVES + n)
            put(subsets, n, half)
            n += 0 if is_leaf else 1
            half = subset ^ half


@kernel
def replace(part, lane, batch):
    """Put the best tree in the treelet's place, unless a path becomes too long."""
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
        is_leaf = get(batch.lefts, subset * LANES + lane) & _LEAF != 0 and get(inner, i) != 0  # never the root
        kept = 1 + get(facts, left * 4 + KEPT) + get(facts, right * 4 + KEPT)
        put(as_f32(facts), at + COST, get(batch.costs, subset * LANES + lane))
        put(facts, at + COUNT, get(batch.counts, subset * LANES + lane))
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
        store(part.nodes, line_at(node), line)
        put(part.links, link_at(node, 0), get(links, left))
        put(part.links, link_at(node, 1), get(links, right))
        store(part.facts, node * 4, load4(facts, at * 4))
        put(part.is_leaf, node, get(facts, at * 4 + KEPT) == 0)
