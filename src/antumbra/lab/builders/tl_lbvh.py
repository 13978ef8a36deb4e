"""`tl-lbvh`: an LBVH optimised by treelet restructuring [Karras and Aila 2013].

After [Karras and Aila 2013, "Fast parallel construction of high-quality bounding volume hierarchies"]. The input is an
LBVH with one triangle per leaf. Several rounds restructure its nodes, each node after all nodes below it. Each round
doubles the minimum number of triangles below a treated node. Finally, subtrees of few triangles become leaves where
this is cheaper.

The tree is cut into parts, which are treated by one thread each, and a top, which follows once all parts are done. In
each, nodes are queued when the nodes below them are done. Nodes in the queue at the same time have no triangle in
common, so sixteen are treated at once.

Treelets. A treelet grows from one node by opening its largest box until there are seven boxes, the treelet's leaves.
Dynamic programming over their 127 subsets finds the optimal tree over them, which replaces the treelet.

Departure from the paper: there, a warp of threads treats one treelet. Here, each treelet takes one lane of a vector,
since the dynamic programming visits the subsets in the same order for all treelets.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh import lbvh, tree_layout
from ...bvh.nodes import MAX_DEPTH, Bvh, box_at, line_at, link_at, sides
from ...bvh.tree_layout import PART, LeafChoice, cut_tree, relayout
from ...bvh.triangle_bounds import area_scale_of, checked_vertices
from ...kernels.jit import BoolPtr, F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import (
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
    ptr,
    ptr_at,
    put,
    reduce_max,
    select,
    shuffle,
    splat4,
    splat8,
    splat16,
    stack_array,
    stack_f32,
    stack_i32,
    store,
)

# --- Treelets, sixteen at once ----------------------------------------------------------------------------------------


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
    """A subtree: pointers to arrays that are indexed by node."""

    nodes: F32Ptr  # float32 *, 16 per node
    links: I32Ptr  # int32 *, the same memory
    facts: I32Ptr  # int32 *, 4 per node, about its subtree: COST, COUNT, NODES, HEIGHT
    is_leaf: BoolPtr  # bool *: whether one leaf is cheaper than the subtree
    rooms: I32Ptr  # int32 *: maximum inner nodes on a path down from the node
    parents: I32Ptr  # int32 *: the node's parent in this round; -1 for the root
    pending: I32Ptr  # int32 *: children to be treated before the node in this round


COST = 0  # SAH cost, times half the area of the tree's root: a float32
COUNT = 1  # triangles
NODES = 2  # nodes that stay nodes
HEIGHT = 3  # inner nodes on the longest path down, including the node itself


class TreeletBatch(NamedTuple):
    """Sixteen treelets, one per lane. The bits of a subset's index are its leaves."""

    pairs: F32Ptr  # float32 *, [lane][node][side]: boxes as eight words: lower x, y, z, -, upper x, y, z, -
    links: I32Ptr  # int32 *, [lane][node][side]
    inner: I32Ptr  # int32 *, [lane][node]: the opened nodes, the root first
    places: I32Ptr  # int32 *, [lane][leaf]: 2 * node + side
    areas: F32Ptr  # float32 *, [lane][leaf]: half the area of the box; _CLOSED for a triangle
    facts: I32Ptr  # int32 *, [lane][leaf]: as in `TreePart`; a negative cost marks a single triangle, not yet priced
    boxes: F32Ptr  # float32 *: [leaf][lower and upper x, y, z][lane]
    costs: F32Ptr  # float32 *, [subset][lane]: half the area, then the minimum cost of a tree
    counts: F32Ptr  # float32 *, [subset][lane]: triangles
    lefts: I32Ptr  # int32 *, [subset][lane]: subset of the left child, plus _LEAF if a leaf is cheaper
    unions: F32Ptr  # float32 *: boxes of all subsets of the first three leaves, then of the last four


@inlined
def batch_at(memory):
    """A batch in memory of BATCH float32."""
    words = as_i32(memory)
    boxes = ptr_at(memory, _BOXES)
    for k in range(0, _ROW * LEAVES, LANES):
        store(boxes, k, splat16(np.float32(0.0)))  # for lanes without a treelet
    return TreeletBatch(
        memory,
        ptr_at(words, _LINKS),
        ptr_at(words, _NODES),
        ptr_at(words, _PLACES),
        ptr_at(memory, _AREAS),
        ptr_at(words, _FACTS),
        boxes,
        ptr_at(memory, _COSTS),
        ptr_at(memory, _COUNTS),
        ptr_at(words, _LEFTS),
        ptr_at(memory, _UNIONS),
    )


class TreeletSettings(NamedTuple):
    """Settings for all treelets of a tree."""

    max_leaf: np.int64  # maximum triangles in a leaf
    scale: np.float32  # a power of two that scales the largest coordinate to about 1, so that no area overflows
    rounds: np.int64  # rounds treat nodes with at least 7, 14, 28, ... triangles


@inlined
def areas_of_children(nodes, node, scale):
    """Half the area of the left and right child's box in lanes 0 and 1. Lanes 2 and 3 are meaningless."""
    x, y, z = load4(nodes, line_at(node)), load4(nodes, line_at(node) + 4), load4(nodes, line_at(node) + 8)
    x = (shuffle(x, 2, 3, 0, 1) - x) * scale
    y = (shuffle(y, 2, 3, 0, 1) - y) * scale
    z = (shuffle(z, 2, 3, 0, 1) - z) * scale
    return x * (y + z) + y * z


@inlined
def _open_largest_box(part, k, lane, batch, rules):
    """Open the largest box of a treelet with k + 1 leaves."""
    links, places = ptr_at(batch.links, lane * 16), ptr_at(batch.places, lane * 8)
    areas = load8(batch.areas, lane * 8)
    opened_leaf = lowest_bit(bits(areas == reduce_max(areas)))
    node = get(links, get(places, opened_leaf))
    line = load16(part.nodes, line_at(node))
    store(batch.pairs, (lane * _INNER + k) * 16, shuffle(line, 0, 4, 8, 0, 2, 6, 10, 2, 1, 5, 9, 1, 3, 7, 11, 3))
    both = areas_of_children(part.nodes, node, rules.scale)
    left_link, right_link = get(part.links, link_at(node, 0)), get(part.links, link_at(node, 1))
    put(batch.inner, lane * 8 + k, node)
    put(links, 2 * k, left_link)
    put(links, 2 * k + 1, right_link)
    put(places, opened_leaf, 2 * k)
    put(places, k + 1, 2 * k + 1)
    put(batch.areas, lane * 8 + opened_leaf, extract(both, 0) if left_link >= 0 else _CLOSED)
    put(batch.areas, lane * 8 + k + 1, extract(both, 1) if right_link >= 0 else _CLOSED)


@kernel
def form_treelets(part, roots, lanes, batch, rules):
    """Form the treelets of `roots`: open the largest box until there are LEAVES [Karras and Aila 2013, Sec. 4.2]."""
    for lane in range(lanes):
        store(batch.areas, lane * 8, splat8(_CLOSED))
        put(batch.places, lane * 8, 2 * _INNER)  # a free place for the root, which is opened first
        put(batch.links, lane * 16 + 2 * _INNER, get(roots, lane))
    for k in range(_INNER):
        for lane in range(lanes):  # interleaved, since a step depends only on its own lane's previous step
            _open_largest_box(part, k, lane, batch, rules)


@kernel
def spread_treelets(part, root, lane, batch):
    """Copy the facts and boxes of a treelet's leaves to the arrays of the dynamic programming."""
    pairs, links = ptr_at(batch.pairs, lane * _INNER * 16), ptr_at(batch.links, lane * 16)
    facts = ptr_at(batch.facts, lane * 32)
    single = select(iota4() == np.int32(COUNT), splat4(np.int32(1)), np.int32(0))
    single = select(iota4() == np.int32(COST), _MINUS_ONE, single)
    for leaf in range(LEAVES):
        place = get(batch.places, lane * 8 + leaf)
        row = leaf * _ROW + lane
        for k in range(3):
            put(batch.boxes, row + k * LANES, get(pairs, place * 8 + k))
            put(batch.boxes, row + (k + 3) * LANES, get(pairs, place * 8 + k + 4))
        link = get(links, place)
        fact = load4(part.facts, (link if link >= 0 else root) * 4)  # any node for a triangle, which avoids a branch
        fact = select(splat4(np.int32(link)) >= 0, fact, single)
        store(facts, leaf * 4, fact)
        put(batch.costs, (1 << leaf) * LANES + lane, get(as_f32(facts), leaf * 4 + COST))
        put(batch.counts, (1 << leaf) * LANES + lane, np.float32(extract(fact, COUNT)))


@kernel
def _union_boxes(boxes, first, n, scale, unions):
    """Write the scaled box of every subset of the n leaves from `first` on to `unions`."""
    for k in range(6):
        store(unions, k * LANES, splat16(_INF if k < 3 else -_INF))
    for subset in range(1, 1 << n):
        others, leaf = subset & (subset - 1), first + lowest_bit(subset)
        for k in range(6):
            leaf_plane, union_plane = (
                load16(boxes, leaf * _ROW + k * LANES) * scale,
                load16(unions, others * _ROW + k * LANES),
            )
            store(
                unions,
                subset * _ROW + k * LANES,
                minimum(leaf_plane, union_plane) if k < 3 else maximum(leaf_plane, union_plane),
            )


@kernel
def price_subsets(batch, scale):
    """Write half the area of every subset's box to `costs`. Single leaves keep their cost if it is known."""
    unions, high = batch.unions, ptr_at(batch.unions, 8 * _ROW)
    _union_boxes(batch.boxes, 0, 3, scale, unions)
    _union_boxes(batch.boxes, 3, 4, scale, high)
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
                known = load16(batch.costs, subset * LANES)
                area = select(known < np.float32(0.0), area, known)
            store(batch.costs, subset * LANES, area)


@kernel
def plan_treelets(batch, rules):
    """Find the optimal tree over each subset [Karras and Aila 2013, Algorithm 2]."""
    costs, max_leaf = batch.costs, np.float32(rules.max_leaf)
    for subset in range(3, _SUBSETS):
        low = subset & -subset
        others = subset ^ low
        if others == 0:
            continue
        best, best_half = load16(costs, low * LANES) + load16(costs, others * LANES), splat16(np.int32(low))
        part = (others - 1) & others
        while part != 0:
            both = load16(costs, (low | part) * LANES) + load16(costs, (others ^ part) * LANES)
            best_half = select(both < best, np.int32(low | part), best_half)
            best = minimum(best, both)
            part = (part - 1) & others
        area, count = load16(costs, subset * LANES), load16(batch.counts, low * LANES)
        count += load16(batch.counts, others * LANES)
        best, as_leaf = best + area, area * count
        is_leaf = (count <= max_leaf) & (as_leaf <= best)
        store(costs, subset * LANES, select(is_leaf, as_leaf, best))
        store(batch.counts, subset * LANES, count)
        store(batch.lefts, subset * LANES, select(is_leaf, best_half | _LEAF, best_half))


@inlined
def cost_of_best(batch, lane):
    """The cost of the optimal tree over a treelet's leaves."""
    return get(batch.costs, _ALL * LANES + lane)


@kernel
def _list_inner_nodes(batch, lane, subsets, children):
    """Write the subsets and children of the optimal tree's inner nodes, parents first.

    A child is a leaf of the treelet, or LEAVES plus the index of an inner node.
    """
    put(subsets, 0, _ALL)
    n = 1
    for i in range(_INNER):
        subset = get(subsets, i)
        half = get(batch.lefts, subset * LANES + lane) & _ALL
        for side in range(2):
            is_leaf = half & (half - 1) == 0
            put(children, 2 * i + side, lowest_bit(half) if is_leaf else LEAVES + n)
            put(subsets, n, half)
            n += 0 if is_leaf else 1
            half = subset ^ half


@kernel
def replace_treelets(part, lane, batch):
    """Replace the treelet by the optimal tree, unless a path would become too long."""
    subsets, children, links, facts = stack_i32(8), stack_i32(16), stack_i32(16), stack_i32(64)
    boxes, pair = stack_f32(128), stack_f32(16)
    inner = ptr_at(batch.inner, lane * 8)
    _list_inner_nodes(batch, lane, subsets, children)
    for leaf in range(LEAVES):
        place = get(batch.places, lane * 8 + leaf)
        store(boxes, leaf * 8, load8(batch.pairs, lane * _INNER * 16 + place * 8))
        store(facts, leaf * 4, load4(batch.facts, lane * 32 + leaf * 4))
        put(links, leaf, get(batch.links, lane * 16 + place))
    for i in range(_INNER - 1, -1, -1):
        left_child, right_child = get(children, 2 * i), get(children, 2 * i + 1)
        subset, at = get(subsets, i), (LEAVES + i) * 4
        is_leaf = get(batch.lefts, subset * LANES + lane) & _LEAF != 0 and get(inner, i) != 0  # never the root
        n_nodes = 1 + get(facts, left_child * 4 + NODES) + get(facts, right_child * 4 + NODES)
        put(as_f32(facts), at + COST, get(batch.costs, subset * LANES + lane))
        put(facts, at + COUNT, get(batch.counts, subset * LANES + lane))
        put(facts, at + NODES, 0 if is_leaf else n_nodes)
        put(facts, at + HEIGHT, 1 + max(get(facts, left_child * 4 + HEIGHT), get(facts, right_child * 4 + HEIGHT)))
        put(links, LEAVES + i, get(inner, i))
    if get(facts, LEAVES * 4 + HEIGHT) > get(part.rooms, get(inner, 0)):
        return
    lower = mask_from_bits8(15)
    for i in range(_INNER - 1, -1, -1):
        node, at = get(inner, i), LEAVES + i
        left_child, right_child = get(children, 2 * i), get(children, 2 * i + 1)
        a, b = load8(boxes, left_child * 8), load8(boxes, right_child * 8)
        store(boxes, at * 8, select(lower, minimum(a, b), maximum(a, b)))
        store(pair, 0, a)
        store(pair, 8, b)
        line = shuffle(load16(pair, 0), 0, 8, 4, 12, 1, 9, 5, 13, 2, 10, 6, 14, 3, 3, 3, 3)
        store(part.nodes, line_at(node), line)
        put(part.links, link_at(node, 0), get(links, left_child))
        put(part.links, link_at(node, 1), get(links, right_child))
        store(part.facts, node * 4, load4(facts, at * 4))
        put(part.is_leaf, node, get(facts, at * 4 + NODES) == 0)


# --- The builder ------------------------------------------------------------------------------------------------------


_LESS = np.float32(1.0 - 2.0**-18)  # a new treelet must cost less than this times the old cost, a rounding margin
_TOP = 4  # multiplies the rounds in the top, whose nodes are few and large
_STACK_SIZE = 2 * MAX_DEPTH + 2


@inlined
def _area_of_node(nodes, node, scale):
    """Half the area of the box around both children."""
    x, y, z = sides(nodes, box_at(node, 0), box_at(node, 1))
    x, y, z = x * scale, y * scale, z * scale
    return x * (y + z) + y * z


@kernel
def _update_facts(part, node, rules):
    """Compute a node's facts from those of its children, and return its cost."""
    costs, areas = as_f32(part.facts), areas_of_children(part.nodes, node, rules.scale)
    count, cost, n_nodes, height = 0, np.float32(0.0), 1, 0
    for side in range(2):
        link = get(part.links, link_at(node, side))
        if link < 0:
            count += 1
            cost += extract(areas, side)
        else:
            cost += get(costs, link * 4 + COST)
            count += get(part.facts, link * 4 + COUNT)
            n_nodes += get(part.facts, link * 4 + NODES)
            height = max(height, get(part.facts, link * 4 + HEIGHT))
    area = _area_of_node(part.nodes, node, rules.scale)
    cost, as_leaf = cost + area, area * np.float32(count)
    if count <= rules.max_leaf and as_leaf <= cost and node != 0:  # the root is never a leaf
        cost, n_nodes = as_leaf, 0
    put(costs, node * 4 + COST, cost)
    put(part.facts, node * 4 + COUNT, count)
    put(part.facts, node * 4 + NODES, n_nodes)
    put(part.facts, node * 4 + HEIGHT, height + 1)
    put(part.is_leaf, node, n_nodes == 0)
    return cost


@kernel
def _schedule(part, first, room, least, queue, stack):
    """Queue the nodes of this round that have none below them, and return their number.

    A round treats only nodes above at least `least` triangles.
    """
    if get(part.facts, first * 4 + COUNT) < least:
        return 0
    put(stack, 0, first)
    put(part.parents, first, -1)
    put(part.rooms, first, room)
    height, n = 1, 0
    while height > 0:
        height -= 1
        node, pending = get(stack, height), 0
        for side in range(2):
            child = get(part.links, link_at(node, side))
            if child >= 0 and get(part.facts, child * 4 + COUNT) >= least:
                put(part.parents, child, node)
                put(part.rooms, child, get(part.rooms, node) - 1)
                put(stack, height, child)
                height += 1
                pending += 1
        put(part.pending, node, pending)
        if pending == 0:
            put(queue, n, node)
            n += 1
    return n


@kernel
def _treat_queue(part, queue, n, batch, rules):
    """Treat the `n` nodes in the queue, sixteen at once, and then the nodes that they block."""
    done = 0
    while done < n:
        lanes = min(LANES, n - done)
        form_treelets(part, ptr_at(queue, done), lanes, batch, rules)
        for lane in range(lanes):
            spread_treelets(part, get(queue, done + lane), lane, batch)
        price_subsets(batch, rules.scale)
        plan_treelets(batch, rules)
        for lane in range(lanes):
            node = get(queue, done + lane)
            if cost_of_best(batch, lane) < _update_facts(part, node, rules) * _LESS:
                replace_treelets(part, lane, batch)
            parent = get(part.parents, node)
            if parent >= 0:
                put(part.pending, parent, get(part.pending, parent) - 1)
                if get(part.pending, parent) == 0:
                    put(queue, n, parent)
                    n += 1
        done += lanes


class TreeletTree(NamedTuple):
    """A tree under optimisation."""

    nodes: NDArray[np.float32]  # (n, 16) float32
    facts: NDArray[np.int32]  # (n, 4) int32: see `TreePart`
    is_leaf: NDArray[np.bool_]  # (n,) bool


@inlined
def _part_of(work, numbers, first):
    """The `TreePart` of a tree's nodes from `first` on; `numbers` is scratch memory, 3 int32 per node."""
    return TreePart(
        ptr(work.nodes),
        as_i32(ptr(work.nodes)),
        ptr(work.facts),
        ptr(work.is_leaf),
        ptr_at(numbers, -first),
        ptr_at(numbers, numbers.shape[1] - first),
        ptr_at(numbers, 2 * numbers.shape[1] - first),
    )


@kernel
def _run_rounds(part, root, room, least, growth, queue, rules):
    """Treat the nodes above at least `least` triangles, then those above `growth` times as many, and so on."""
    batch, stack = batch_at(stack_f32(BATCH)), stack_i32(_STACK_SIZE)
    for _ in range(rules.rounds):
        ready = _schedule(part, root, room, least, queue, stack)
        _treat_queue(part, queue, ready, batch, rules)
        least *= growth


@kernel
def _restructure_parts(ticket, work, parts, rules):
    """Worker: treat the nodes of each part, which are in depth-first order."""
    numbers = stack_array(np.int32, 4, PART)
    queue = ptr_at(numbers, 3 * numbers.shape[1])
    for p in items(ticket):
        root, end, depth = parts[p]
        if root >= 0:
            part = _part_of(work, numbers, root)
            for node in range(end - 1, root - 1, -1):  # children have higher numbers than their parents
                _update_facts(part, node, rules)
            _run_rounds(part, root, MAX_DEPTH - depth, LEAVES, 2, queue, rules)


@kernel
def _restructure_top(work, nodes, least, rules, numbers):
    """Treat the nodes of the top, which are all above at least `least` triangles.

    nodes : (t,) int64, parents first
    numbers : scratch memory, 4 int32 per node of the tree
    """
    part = _part_of(work, numbers, 0)
    for node in nodes[::-1]:
        _update_facts(part, node, rules)
    _run_rounds(part, 0, MAX_DEPTH, least, 1, ptr_at(numbers, 3 * numbers.shape[1]), rules)


def restructure(bvh: Bvh, max_leaf: int, threads: int, rounds: int = 3) -> Bvh:
    """Restructure the treelets of a BVH, and return the cheaper tree.

    `bvh` must have two triangles or more, one triangle per leaf, and nodes in depth-first order. Its arrays are
    overwritten.
    """
    n = len(bvh.nodes)
    work = TreeletTree(bvh.nodes, np.empty((n, 4), np.int32), np.empty(n, np.bool_))
    rules = TreeletSettings(np.int64(max_leaf), area_scale_of(bvh), np.int64(rounds))
    pieces = cut_tree(bvh)
    run(_restructure_parts, threads, new_ticket(len(pieces.parts), 1), work, pieces.parts, rules)
    if len(pieces.numbers):
        numbers = np.empty((4, n), np.int32)  # most of it stays untouched
        longer = rules._replace(rounds=np.int64(_TOP * rounds))
        _restructure_top(work, pieces.numbers, tree_layout.PART + 2, longer, numbers)
        pieces = cut_tree(bvh, work.facts[:, COUNT])
    roots = pieces.parts[:, 0]
    sizes = np.where(roots[:, None] < 0, [0, 1], work.facts[np.maximum(roots, 0)][:, [NODES, COUNT]])
    return relayout(bvh, pieces, LeafChoice(work.is_leaf, sizes), threads)


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build an LBVH and restructure its treelets. The tree is bitwise identical for any number of threads.

    Parameters, errors and boxes are as for `binned_sah.build`.
    """
    checked_vertices(vertices, max_leaf)
    bvh = lbvh.build(vertices, threads, 1)
    return restructure(bvh, max_leaf, thread_count(threads)) if len(bvh.prim_ids) > 1 else bvh
