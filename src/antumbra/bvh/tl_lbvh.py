"""`tl-lbvh`: an LBVH made better by treelets [Karras and Aila 2013, "Fast parallel construction of high-quality
bounding volume hierarchies"].

The nodes of an LBVH of one triangle a leaf are treated after all nodes below them, in a few rounds, each of which
treats those of twice as many triangles as the last. Leaves of more triangles are made in the end, where they are
cheaper.

The tree is cut in parts, which threads treat alone, and a top, which is treated when they are done. Within a part nodes
wait in a queue until those below them are done, so any that stand there at once have no triangle in common, and sixteen
are taken at a time.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..simd import as_f32, as_i32, extract, get, ptr, ptr_at, put, stack_f32
from . import lbvh
from .cut import cut
from .nodes import MAX_DEPTH, Bvh
from .prepare import checked, power_of_two_for
from .relayout import Choice, relayout
from .treelet import (
    BATCH,
    COST,
    COUNT,
    HEIGHT,
    KEPT,
    LANES,
    LEAVES,
    Part,
    Rules,
    areas_of_children,
    batch_at,
    cost_of_best,
    form,
    plan,
    price_subsets,
    replace,
    spread,
)

_LESS = np.float32(1.0 - 2.0**-18)  # a new treelet must cost less than this times the old: more than rounding


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
    costs, areas = as_f32(part.facts), areas_of_children(part.nodes, node, rules.scale)
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
def _round(part, queue, n, batch, rules):
    """Treat the `n` nodes in the queue, sixteen at once, and then those that have waited for them."""
    done = 0
    while done < n:
        lanes = min(LANES, n - done)
        for lane in range(lanes):
            root = np.int64(get(queue, done + lane))
            form(part, root, lane, batch, rules)
            spread(part, root, lane, batch)
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
        nodes, as_i32(nodes), ptr_at(ptr(scratch.facts), -4 * first), is_leaf,
        ptr_at(numbers, -first), ptr_at(numbers, m - first), ptr_at(numbers, 2 * m - first),
    )  # fmt: skip
    batch = batch_at(stack_f32(BATCH))
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
    """See `Rules`."""
    largest = np.abs(bvh.nodes[0, :12].reshape(3, 4)).max(axis=1)
    return power_of_two_for(np.resize(np.append(largest, 0), 8))


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


def build(vertices: np.ndarray, threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build an LBVH and restructure its treelets; the same, bit for bit, for any number of threads.

    Parameters, errors and what the boxes are: as for `binned_sah.build`.
    """
    checked(vertices, max_leaf)
    bvh = lbvh.build(vertices, threads, 1)
    return restructure(bvh, max_leaf, thread_count(threads)) if len(bvh.prim_ids) > 1 else bvh
