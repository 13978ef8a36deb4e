"""Triangles through a hierarchy of rays: breadth first as long as there is room, in bounded memory.

Each level of the hierarchy has a queue of pairs, a triangle and a group of nodes that it may block [Olsson and
Assarsson 2011, Sec. 3.1]. A queue is worked off before the one below it, so that many pairs are there to be tested one
after the other; but when the queue below has no room left, that one is worked off first (Sec. 4.2). So memory is a
fixed number of pairs a level and thread, whatever the triangles are.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..parallel import CHUNK, N, take
from ..simd import (
    as_i32,
    atomic_and,
    compress,
    get,
    iota16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr,
    ptr_at,
    put,
    splat16,
    store,
)
from ..trace.counters import COVERED, NODES, add_counters, count, private_counters
from .boxes import COVERS, TRIANGLE
from .leaf import block_rays
from .nodes import covered, possible, write_row
from .planes import shape_of
from .rays import leaves_of
from .soup import Soup
from .tree import LEVELS, group_at, groups_of, size_of, tree_pointers
from .view import relative, view_of

BATCH = 128
"""Triangles that are traversed together."""

ROW = 64
"""Numbers of a triangle's row, see `boxes` and `cones`."""

PAIRS = 2048
"""Pairs a level holds, at most; at least BATCH and 16."""


class How(NamedTuple):
    """Options of a traversal."""

    spheres: bool  # test spheres around triangles, not these
    early_accept: bool  # mark nodes that a triangle covers
    facing: int  # triangles with this sign of d . n do not block, a value of CULL_FACES
    backface: bool  # and are dropped before they are traversed
    pairs: int  # that a level holds


class _Queues(NamedTuple):
    """A thread's pairs: pointers to int32."""

    rows: object  # which row of the batch, LEVELS x (pairs + 16)
    groups: object
    counts: object  # LEVELS
    step: int


@inlined
def _kill_below(tree, part, level, node, leaves):
    """Nothing is asked any more of the rays under a node."""
    low, high, k = node, node + 1, level
    while k > 0:
        k -= 1
        low <<= tree.shift
        high = min(high << tree.shift, size_of(tree, part, k))
        start = groups_of(tree, part, k)
        for g in range(low >> tree.shift, (high + tree.ways - 1) >> tree.shift):
            put(tree.alive, start + g, 0)
    everyone = (np.int64(1) << tree.ways) - 1
    first = get(tree.leaves, part)
    for i in range((first + low) * leaves.count, (first + high) * leaves.count):
        put(leaves.dead, i, everyone)


@kernel
def _kill(tree, part, level, node, leaves):
    """Mark a node as finished, and those above it that have no other left [Olsson and Assarsson 2011, Sec. 3.3]."""
    if level >= 0:
        _kill_below(tree, part, level, node, leaves)
    while level < get(tree.heights, part):
        group, bit = groups_of(tree, part, level) + (node >> tree.shift), np.int64(1) << (node & (tree.ways - 1))
        if np.int64(atomic_and(tree.alive, group, ~bit)) & ~bit != 0:
            return
        node >>= tree.shift
        level += 1


@inlined
def _push(queues, level, row, first, found):
    """Queue a triangle for the children of those nodes of a group that it may block."""
    at = level * queues.step + np.int64(get(queues.counts, level))
    store(queues.rows, at, splat16(np.int32(row)))
    store(queues.groups, at, compress(mask_from_bits16(found), iota16() + np.int32(first)))
    put(queues.counts, level, get(queues.counts, level) + popcount(found))


@kernel
def _visit(tree, part, leaves, soup, rows, queues, level, how, counters):
    """Test the last pair of a level's queue."""
    n = np.int64(get(queues.counts, level)) - 1
    put(queues.counts, level, n)
    row, g = np.int64(get(queues.rows, level * queues.step + n)), np.int64(get(queues.groups, level * queues.step + n))
    numbers, group = ptr_at(rows, row * ROW), groups_of(tree, part, level) + g
    alive = np.int64(get(tree.alive, group))
    if alive == 0:
        return
    count(counters, NODES, popcount(alive))
    nodes = group_at(tree, group)
    found = possible(tree.nodes, nodes, numbers, tree.ways, how.spheres) & alive
    if how.early_accept and found != 0:
        full = covered(tree.nodes, nodes, numbers, tree.ways) & found
        found &= ~full
        count(counters, COVERED, popcount(full))
        while full != 0:
            _kill(tree, part, level, g * tree.ways + lowest_bit(full), leaves)
            full &= full - 1
    if level > 0:
        _push(queues, level - 1, row, g * tree.ways, found)
        return
    slot = np.int64(get(as_i32(numbers), TRIANGLE))
    prim = np.int64(get(soup.ids, slot))
    while found != 0:
        node = g * tree.ways + lowest_bit(found)
        found &= found - 1
        finished = block_rays(leaves, get(tree.leaves, part) + node, soup.corners, slot, prim, how.facing, counters)
        if finished and how.early_accept:
            _kill(tree, part, np.int64(0), node, leaves)


@kernel
def _traverse(tree, part, leaves, soup, rows, n_rows, queues, how, counters):
    """All triangles of a batch through the hierarchy of one face."""
    top = get(tree.heights, part) - 1
    for row in range(n_rows):
        put(queues.rows, top * queues.step + row, row)
        put(queues.groups, top * queues.step + row, 0)
    put(queues.counts, top, n_rows)
    level = top
    while level <= top:
        while get(queues.counts, level) > 0 and (level == 0 or get(queues.counts, level - 1) <= how.pairs - tree.ways):
            _visit(tree, part, leaves, soup, rows, queues, level, how, counters)
        level += -1 if level > 0 and get(queues.counts, level - 1) > 0 else 1


@inlined
def _corner(view, corners, at):
    x, y, z = get(corners, at), get(corners, at + 1), get(corners, at + 2)
    return relative(view, (np.float64(x), np.float64(y), np.float64(z)))


@kernel
def _write_rows(tree, parts, view, soup, slot, how, rows, counts):
    """The rows of a triangle for all faces in which it may block something."""
    corners = ptr_at(soup.corners, 9 * slot)
    shape = shape_of(view, _corner(view, corners, 0), _corner(view, corners, 3), _corner(view, corners, 6))
    if how.backface and how.facing != 0 and shape.facing == how.facing:
        return
    for part in range(parts):
        row = ptr_at(rows, (part * BATCH + np.int64(get(counts, part))) * ROW)
        if write_row(tree.nodes, view, get(tree.faces, part), tree.ways, shape, how.spheres, row):
            put(as_i32(row), TRIANGLE, slot)
            if how.facing != 0 and shape.facing != -how.facing:
                put(as_i32(row), COVERS, 0)
            put(counts, part, get(counts, part) + 1)


@kernel
def trace_triangles(ticket, triangles, picks, beam, arrays, rays, how, counters):
    """Worker: batches of the picked triangles through the hierarchies of all faces."""
    tree, parts, view, leaves = tree_pointers(arrays), len(arrays.faces), view_of(beam), leaves_of(rays)
    soup = Soup(ptr(triangles.corners), ptr(triangles.ids))
    mine, step = private_counters(counters), how.pairs + 16
    memory, marks = np.empty(parts * BATCH * ROW, np.float32), np.zeros(LEVELS + parts, np.int32)
    pairs = np.empty(2 * LEVELS * step, np.int32)
    queues = _Queues(ptr(pairs), ptr_at(pairs, LEVELS * step), ptr(marks), step)
    rows, counts = ptr(memory), ptr_at(marks, LEVELS)
    first = take(ticket)
    while first >= 0:
        for part in range(parts):
            put(counts, part, 0)
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            _write_rows(tree, parts, view, soup, np.int64(picks[i]), how, rows, counts)
        for part in range(parts):
            of_part = ptr_at(rows, part * BATCH * ROW)
            _traverse(tree, part, leaves, soup, of_part, np.int64(get(counts, part)), queues, how, mine)
        first = take(ticket)
    add_counters(counters, mine)
    pairs[0] = marks[0] = 0  # they live until here
    memory[0] = np.float32(0.0)
