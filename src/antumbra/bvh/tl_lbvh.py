"""`tl-lbvh`: an LBVH optimised by treelet restructuring [Karras and Aila 2013, "Fast parallel construction of
high-quality bounding volume hierarchies"].

The input is an LBVH of one triangle a leaf. Several rounds restructure its nodes, each node after all nodes below it.
Each round doubles the least number of triangles below a treated node. In the end, subtrees of few triangles become
leaves where this is cheaper.

The tree is cut into parts, which threads treat alone, and a top, which follows when all parts are done. In each, nodes
wait in a queue until the nodes below them are done. Nodes in the queue at the same time share no triangle, so sixteen
are treated at once.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import as_f32, as_i32, extract, get, ptr, ptr_at, put, stack_array, stack_f32, stack_i32
from . import cut as cutting
from . import lbvh
from .cut import PART, cut
from .links import box_at, link_at
from .nodes import MAX_DEPTH, Bvh, sides
from .prepare import checked, scale_of
from .relayout import Choice, relayout
from .treelet import (
    BATCH,
    COST,
    COUNT,
    HEIGHT,
    KEPT,
    LANES,
    LEAVES,
    Rules,
    TreePart,
    areas_of_children,
    batch_at,
    cost_of_best,
    form,
    plan,
    price_subsets,
    replace,
    spread,
)

_LESS = np.float32(1.0 - 2.0**-18)  # a new treelet must cost less than this times the old: a margin above rounding
_TOP = 4  # factor of the rounds in the top, whose nodes are few and large
_WAITING = 2 * MAX_DEPTH + 2


@inlined
def _area_of_node(nodes, node, scale):
    """Half the area of the box around both children."""
    x, y, z = sides(nodes, box_at(node, 0), box_at(node, 1))
    x, y, z = x * scale, y * scale, z * scale
    return x * (y + z) + y * z


@kernel
def _measure(part, node, rules):
    """Compute the facts of a node from its children's facts, and return its cost."""
    costs, areas = as_f32(part.facts), areas_of_children(part.nodes, node, rules.scale)
    count, cost, kept, height = np.int64(0), np.float32(0.0), np.int64(1), np.int64(0)
    for side in range(2):
        link = np.int64(get(part.links, link_at(node, side)))
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
    if count <= rules.max_leaf and as_leaf <= cost and node != 0:  # the root is never a leaf
        cost, kept = as_leaf, np.int64(0)
    put(costs, node * 4 + COST, cost)
    put(part.facts, node * 4 + COUNT, count)
    put(part.facts, node * 4 + KEPT, kept)
    put(part.facts, node * 4 + HEIGHT, height + 1)
    put(part.is_leaf, node, kept == 0)
    return cost


@kernel
def _schedule(part, first, room, least, queue, waiting):
    """Queue the nodes without treated nodes below them, and return how many.

    This round treats only nodes with at least `least` triangles below.
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
            child = np.int64(get(part.links, link_at(node, side)))
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
def _round(part, queue, n, batch, rules):
    """Treat the `n` nodes in the queue, sixteen at once, then the nodes that waited for them."""
    done = 0
    while done < n:
        lanes = min(LANES, n - done)
        form(part, ptr_at(queue, done), lanes, batch, rules)
        for lane in range(lanes):
            spread(part, np.int64(get(queue, done + lane)), lane, batch)
        price_subsets(batch, rules.scale)
        plan(batch, rules)
        for lane in range(lanes):
            node = np.int64(get(queue, done + lane))
            if cost_of_best(batch, lane) < _measure(part, node, rules) * _LESS:
                replace(part, lane, batch)
            parent = np.int64(get(part.parents, node))
            if parent >= 0:
                put(part.pending, parent, get(part.pending, parent) - 1)
                if get(part.pending, parent) == 0:
                    put(queue, n, parent)
                    n += 1
        done += lanes


class Work(NamedTuple):
    """A tree under optimisation."""

    nodes: np.ndarray  # (n, 16) float32
    facts: np.ndarray  # (n, 4) int32: see `TreePart`
    is_leaf: np.ndarray  # (n,) bool


@inlined
def _part_of(work, numbers, first):
    """The `TreePart` of a tree's nodes from `first` on; `numbers` is scratch memory, 3 int32 a node."""
    return TreePart(
        ptr(work.nodes), as_i32(ptr(work.nodes)), ptr(work.facts), ptr(work.is_leaf),
        ptr_at(numbers, -first), ptr_at(numbers, numbers.shape[1] - first),
        ptr_at(numbers, 2 * numbers.shape[1] - first),
    )  # fmt: skip


@kernel
def _rounds(part, root, room, least, growth, queue, rules):
    """Treat the nodes with at least `least` triangles below, then with `growth` times as many, and so on."""
    batch, waiting = batch_at(stack_f32(BATCH)), stack_i32(_WAITING)
    for _ in range(rules.rounds):
        ready = _schedule(part, root, room, least, queue, waiting)
        _round(part, queue, ready, batch, rules)
        least *= growth


@kernel
def _restructure_parts(ticket, work, parts, rules):
    """Worker: treat the nodes of each part. They are in depth-first order."""
    numbers = stack_array(np.int32, 4, PART)
    queue = ptr_at(numbers, 3 * numbers.shape[1])
    for p in items(ticket):
        root, end, depth = parts[p]
        if root >= 0:
            part = _part_of(work, numbers, root)
            for node in range(end - 1, root - 1, -1):  # children have higher numbers than their parents
                _measure(part, node, rules)
            _rounds(part, root, MAX_DEPTH - depth, LEAVES, 2, queue, rules)


@kernel
def _restructure_top(work, nodes, least, rules, numbers):
    """Treat the nodes of the top, all with at least `least` triangles below.

    nodes : (t,) int64, parents first
    numbers : scratch memory, 4 int32 for each node of the tree
    """
    part = _part_of(work, numbers, 0)
    for node in nodes[::-1]:
        _measure(part, node, rules)
    _rounds(part, 0, MAX_DEPTH, least, 1, ptr_at(numbers, 3 * numbers.shape[1]), rules)


def restructure(bvh: Bvh, max_leaf: int, threads: int, rounds: int = 3) -> Bvh:
    """Restructure the treelets of a BVH, and return the cheaper tree.

    `bvh` has two triangles or more, one triangle a leaf, and nodes in depth-first order. Its arrays are overwritten.
    """
    n = len(bvh.nodes)
    work = Work(bvh.nodes, np.empty((n, 4), np.int32), np.empty(n, np.bool_))
    rules = Rules(np.int64(max_leaf), scale_of(bvh), np.int64(rounds))
    pieces = cut(bvh)
    run(_restructure_parts, threads, new_ticket(len(pieces.parts), 1), work, pieces.parts, rules)
    if len(pieces.numbers):
        numbers = np.empty((4, n), np.int32)  # most of it is never touched
        longer = rules._replace(rounds=np.int64(_TOP * rounds))
        _restructure_top(work, pieces.numbers, cutting.PART + 2, longer, numbers)
        pieces = cut(bvh, work.facts[:, COUNT])
    roots = pieces.parts[:, 0]
    sizes = np.where(roots[:, None] < 0, [0, 1], work.facts[np.maximum(roots, 0)][:, [KEPT, COUNT]])
    return relayout(bvh, pieces, Choice(work.is_leaf, sizes), threads)


def build(vertices: np.ndarray, threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build an LBVH and restructure its treelets; the same, bit for bit, for any number of threads.

    Parameters, errors and boxes are as for `binned_sah.build`.
    """
    checked(vertices, max_leaf)
    bvh = lbvh.build(vertices, threads, 1)
    return restructure(bvh, max_leaf, thread_count(threads)) if len(bvh.prim_ids) > 1 else bvh
