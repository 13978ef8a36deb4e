"""Traversal of a ray hierarchy by triangles: breadth-first while the queues have room, in bounded memory.

Queues. Each level of the hierarchy has a queue of pairs of a triangle and a group of nodes that it may block [Olsson
and Assarsson 2011, Sec. 3.1]. A queue is processed before the queue below it, so that many pairs are tested in
sequence. If the queue below is full, it is processed first (Sec. 4.2). Each thread therefore stores a fixed number of
pairs per level, independent of the number of triangles.

Blocks. Triangles that follow each other are usually close, so 16 of them are queued as one pair where they meet fewer
nodes than they are: each node is then tested against the 16 triangles at once, instead of each triangle against the 16
nodes of a group.

Occluders. In a two-pass traversal, good occluders go first (Sec. 3.4). The report does not define good occluders.
Several rules were measured (docs/design/rayhierarchy.md): what matters is the share of the light's directions that a
triangle hides.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run, shares
from ...kernels.simd import (
    atomic_and,
    get,
    iota16,
    lowest_bit,
    mask_from_bits16,
    popcount,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_i64,
    store,
    store_compressed,
)
from ...trace.counters import CANDIDATES, COVERED, N_COUNTERS, NODES, add_counters, cleared, count
from ...trace.triangle_tests import triangle_in
from ..culling.pre_bvh_culling import Soup
from .box_nodes import write_point_rows
from .light_beams import PERSPECTIVE, Beam, relative, view_of
from .projected_rays import block_projected
from .ray_leaves import block_rays, fetch_leaf, leaves_of
from .ray_tree import (
    LEVELS,
    covered,
    group_at,
    groups_of,
    meet_union,
    possible,
    possible_triangles,
    size_of,
    tree_pointers,
    union_of,
    write_row,
    writes_sixteen,
)
from .shadow_planes import BLOCK, COVERS, LANES, NUMBERS, TRIANGLE, integer, put_integer, shape_of

# --- Good occluders, the first triangles of a two-pass traversal [Olsson and Assarsson 2011, Sec. 3.4] ----------------

AREA, SOLID_ANGLE, NEAREST = 0, 1, 2
"""Rules: largest area; largest solid angle as seen from the light; smallest distance to the light."""

SHARE = 1.0 / 64.0
"""Share of the triangles that are good occluders."""

FINISHED = 1.0 / 16.0
"""Minimum share of finished rays for rebuilding the hierarchy before the second pass."""


@kernel
def _write_scores(ticket, soup, beam, rule, scores):
    """Worker: score each triangle as an occluder by a rule."""
    c, apex, w, has_apex = ptr(soup.corners), beam.apex, beam.axes[2], beam.kind == PERSPECTIVE
    for i in items(ticket):
        k = 9 * i
        px, py, pz = get(c, k + 3) - get(c, k), get(c, k + 4) - get(c, k + 1), get(c, k + 5) - get(c, k + 2)
        qx, qy, qz = get(c, k + 6) - get(c, k), get(c, k + 7) - get(c, k + 1), get(c, k + 8) - get(c, k + 2)
        nx, ny, nz = np.float64(py * qz - pz * qy), np.float64(pz * qx - px * qz), np.float64(px * qy - py * qx)
        x, y, z = w[0], w[1], w[2]
        if has_apex:
            x, y, z = get(c, k) - apex[0], get(c, k + 1) - apex[1], get(c, k + 2) - apex[2]
        squared = x * x + y * y + z * z
        score = nx * nx + ny * ny + nz * nz
        if rule == SOLID_ANGLE:
            score = abs(nx * x + ny * y + nz * z) / max(squared * np.sqrt(squared), 1e-30)
        elif rule == NEAREST:
            score = -squared if has_apex else x * get(c, k) + y * get(c, k + 1) + z * get(c, k + 2)
        put(ptr(scores), i, score)


def occluders_first(
    soup: Soup, beam: Beam, threads: int, rule: int = SOLID_ANGLE
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(good occluders, all others): int32 indices into the soup."""
    n = len(soup.corners)
    scores, k = np.empty(n), int(n * SHARE)
    run(_write_scores, threads, new_ticket(n, 4096), soup, beam, rule, scores)
    order = np.argpartition(-scores, k).astype(np.int32) if k else np.arange(n, dtype=np.int32)
    return np.sort(order[:k]), np.sort(order[k:])


# --- Traversal --------------------------------------------------------------------------------------------------------

BATCH = 128
"""Triangles per batch; a power of two, at least 16. A batch is traversed together."""

BLOCKS = BATCH // LANES

PAIRS = 2048
"""Maximum number of pairs in a queue; at least BATCH and at least 16."""

BLOCK_BITS = BATCH.bit_length() - 1  # of a row in a batch; the bits above them are the triangles of a queued block
FEW = 3  # triangles of a block that are queued together

QUEUES = LEVELS + 1
_AHEAD = 8  # leaves to prefetch ahead of the tested leaf


class TraversalOptions(NamedTuple):
    """Options of a traversal."""

    spheres: bool  # test bounding spheres instead of the triangles
    early_accept: bool  # finish nodes that one triangle covers
    facing: int  # value of CULL_FACES: triangles with this sign of d . n do not block
    backface: bool  # drop these triangles before the traversal
    pairs: int  # capacity of a queue


class Queues(NamedTuple):
    """A thread's pairs, as pointers to int32.

    Queue 0 pairs triangles with leaves. Queue k + 1 pairs triangles with groups of level k.
    """

    rows: I32Ptr  # (QUEUES, pairs + 16): the triangle's row in the batch; of a block, its first row, and bits of its
    # triangles from BLOCK_BITS on
    groups: I32Ptr  # (QUEUES, pairs + 16): the group, or the leaf in queue 0
    counts: I32Ptr  # (QUEUES,): pairs in each queue
    step: int  # pairs + 16
    union: F32Ptr  # (6,) float32: scratch memory
    blocks: bool  # whether triangles are queued as blocks, see `queues_blocks`


class TraversalMemory(NamedTuple):
    """A thread's scratch memory for `trace_triangles`."""

    rows: np.ndarray  # float32: the triangle rows of a batch for each face
    marks: np.ndarray  # int32, zeros: pairs in each queue; bits of triangles per block and face; slots
    pairs: np.ndarray  # int32: the queues


def memory_for(parts: int, how: TraversalOptions) -> TraversalMemory:
    """Allocate the memory for a traversal of the hierarchies of `parts` faces."""
    return TraversalMemory(
        np.empty(parts * BATCH * NUMBERS, np.float32),
        np.zeros(QUEUES + parts * BLOCKS + LANES, np.int32),
        np.empty(2 * QUEUES * (how.pairs + LANES), np.int32),
    )


@inlined
def row_at(rows, row):
    """Pointer to the numbers of one triangle in a batch."""
    return ptr_at(rows, (row >> 4) * BLOCK + (row & 15))


@inlined
def _kill_below(tree, part, level, node, leaves):
    """Mark everything below a node as finished: its rays need no further tests."""
    low, high, k = node, node + 1, level
    while k > 0:
        k -= 1
        low <<= tree.shift
        high = min(high << tree.shift, size_of(tree, part, k))
        start = groups_of(tree, part, k)
        for g in range(low >> tree.shift, (high + tree.ways - 1) >> tree.shift):
            put(tree.alive, start + g, 0)
    all_lanes = (1 << tree.ways) - 1
    first = get(tree.leaves, part)
    for i in range((first + low) * leaves.n_samples, (first + high) * leaves.n_samples):
        put(leaves.dead, i, all_lanes)


@kernel
def _kill(tree, part, level, node, leaves):
    """Mark a node as finished, and its ancestors without other live children [Olsson and Assarsson 2011, Sec. 3.3]."""
    if level >= 0:
        _kill_below(tree, part, level, node, leaves)
    while level < get(tree.heights, part):
        group, bit = groups_of(tree, part, level) + (node >> tree.shift), 1 << (node & (tree.ways - 1))
        if np.int64(atomic_and(tree.alive, group, ~bit)) & ~bit != 0:
            return
        node >>= tree.shift
        level += 1


@kernel
def finish(tree, leaf, leaves):
    """Mark a leaf as finished: its rays need no further tests. The hierarchy must have one part."""
    _kill(tree, 0, 0, leaf, leaves)


@kernel
def _kill_all(tree, part, level, first, full, leaves, counters):
    """Mark the nodes that a triangle covers as finished. Bit i of `full` is node `first` + i."""
    count(counters, COVERED, popcount(full))
    while full != 0:
        _kill(tree, part, level, first + lowest_bit(full), leaves)
        full &= full - 1


@inlined
def _visit(tree, part, leaves, level, group, first, numbers, how, counters):
    """Bits of the nodes of a group that a triangle may block but does not cover.

    Covered nodes are marked as finished. The group starts at node `first`.
    """
    alive = get(tree.alive, group)
    count(counters, NODES, popcount(alive))
    candidates = possible(tree.nodes, group_at(tree, group), numbers, tree.ways, alive, how.spheres)
    count(counters, CANDIDATES, popcount(candidates))
    if how.early_accept and candidates != 0:
        full = covered(tree.nodes, group_at(tree, group), numbers, tree.ways, candidates)
        if full != 0:
            candidates &= ~full
            _kill_all(tree, part, level, first, full, leaves, counters)
    return candidates


@inlined
def queues_blocks(tree, how):
    """Whether blocks are queued: the nodes must allow it, and a queue must hold all pairs of one block and group."""
    return tree.ways == LANES and how.pairs >= 2 * LANES * LANES and writes_sixteen(tree.nodes)


class QueuedBlock(NamedTuple):
    """Some triangles of a block, paired with a group."""

    row: int  # the first row of the block
    lanes: int  # bits of the triangles
    group: int


@kernel
def _visit_block(tree, place, pair, rows, queues, below, counters):
    """Test the nodes that a block's triangles meet, each against all of them; return the new length of the next queue.

    -1: each triangle should be tested alone, because they meet as many nodes as there are triangles.
    """
    # In: tree; place, (part, level) of the group; pair, a `QueuedBlock`; rows, of the batch; queues, a `Queues`;
    # below, the length of the next queue. Out: counters
    (part, level), (row, lanes, group) = place, pair
    at, block = groups_of(tree, part, level) + group, row_at(rows, row)
    numbers = group_at(tree, at)
    union_of(tree.nodes, block, lanes, queues.union)
    met = meet_union(tree.nodes, numbers, queues.union, tree.ways) & get(tree.alive, at)
    if popcount(met) >= popcount(lanes):
        return np.int64(-1)
    to_rows, to_groups = ptr_at(queues.rows, level * queues.step), ptr_at(queues.groups, level * queues.step)
    count(counters, NODES, popcount(met) * popcount(lanes))
    while met != 0:
        node = lowest_bit(met)
        met &= met - 1
        some = possible_triangles(tree.nodes, numbers, node, block, tree.ways) & lanes
        count(counters, CANDIDATES, popcount(some))
        store(to_groups, below, splat16(np.int32(group * tree.ways + node)))
        below += _queue(to_rows, below, row, some, level > 0)
    return np.int64(below)


@inlined
def _queue(rows, at, row, lanes, as_block):
    """Write some triangles of a block to a queue's rows; return their number there: 1 if they stay together."""
    if as_block and popcount(lanes) >= FEW:
        put(rows, at, lanes << BLOCK_BITS | row)
        return 1
    store_compressed(rows, at, mask_from_bits16(lanes), iota16() + np.int32(row))
    return popcount(lanes)


@kernel
def _process_queue(tree, part, level, leaves, rows, queues, how, counters):
    """Test a level's pairs, last first, until the queue is empty or the next queue is full.

    The counts of both queues stay in registers, so that a pair does not wait for the previous pair.
    """
    n, below = get(queues.counts, level + 1), get(queues.counts, level)
    to_rows, to_groups = ptr_at(queues.rows, level * queues.step), ptr_at(queues.groups, level * queues.step)
    from_rows, from_groups = ptr_at(to_rows, queues.step), ptr_at(to_groups, queues.step)
    start = groups_of(tree, part, level)
    room = how.pairs - (LANES * LANES if queues.blocks else tree.ways)
    while n > 0 and below <= room:
        n -= 1
        row, g = get(from_rows, n), get(from_groups, n)
        if row >= BATCH:
            block = QueuedBlock(np.int64(row & (BATCH - 1)), np.int64(row >> BLOCK_BITS), np.int64(g))
            after = _visit_block(tree, (part, level), block, rows, queues, below, counters)
            if after < 0:
                store(from_groups, n, splat16(g))
                n += _queue(from_rows, n, block.row, block.lanes, False)
            else:
                below = after
            continue
        first = g * tree.ways
        candidates = _visit(tree, part, leaves, level, start + g, first, row_at(rows, row), how, counters)
        store(to_rows, below, splat16(np.int32(row)))
        store_compressed(to_groups, below, mask_from_bits16(candidates), iota16() + np.int32(first))
        below += popcount(candidates)
    put(queues.counts, level + 1, n)
    put(queues.counts, level, below)


@kernel
def _test_rays(tree, part, leaves, soup, rows, queues, how, counters):
    """Test the rays of the queued leaves, and prefetch later leaves."""
    first, slot, triangle = get(tree.leaves, part), -1, triangle_in(soup.corners, 0)
    for i in range(get(queues.counts, 0) - 1, -1, -1):
        fetch_leaf(leaves, first + get(queues.groups, max(i - _AHEAD, 0)))
        node, last = get(queues.groups, i), slot
        row = row_at(rows, get(queues.rows, i))
        slot = integer(row, TRIANGLE)
        if leaves.width > 0:
            finished = block_projected(leaves, first + node, row, soup, how.facing, counters)
        else:
            if slot != last:
                triangle = triangle_in(soup.corners, slot)
            prim = get(soup.ids, slot)
            finished = block_rays(leaves, first + node, soup.corners, slot, triangle, prim, how.facing, counters)
        if finished and how.early_accept:
            _kill(tree, part, 0, node, leaves)
    put(queues.counts, 0, 0)


@kernel
def traverse_queues(tree, part, leaves, soup, rows, queues, how, counters):
    """Traverse the hierarchy of one face with the queued triangles, down to its rays."""
    queue, last = 0, get(tree.heights, part)
    while queue <= last:
        if queue > 0:
            _process_queue(tree, part, queue - 1, leaves, rows, queues, how, counters)
        else:
            _test_rays(tree, part, leaves, soup, rows, queues, how, counters)
        queue += -1 if queue > 0 and get(queues.counts, queue - 1) > 0 else 1


@inlined
def _corner(view, corners, at):
    x, y, z = get(corners, at), get(corners, at + 1), get(corners, at + 2)
    return relative(view, (np.float64(x), np.float64(y), np.float64(z)))


@kernel
def _write_row(tree, parts, view, soup, slot, how, row, lane, face_lanes):
    """Write the row of one triangle for each face where it may block a ray; set bit `lane` of `face_lanes`."""
    corners = ptr_at(soup.corners, 9 * slot)
    shape = shape_of(view, _corner(view, corners, 0), _corner(view, corners, 3), _corner(view, corners, 6))
    if how.backface and how.facing != 0 and shape.facing == how.facing:
        return
    for part in range(parts):
        numbers = ptr_at(row, part * BATCH * NUMBERS)
        if write_row(tree.nodes, view, get(tree.faces, part), tree.ways, shape, how.spheres, numbers):
            put_integer(numbers, TRIANGLE, slot)
            if how.facing != 0 and shape.facing != -how.facing:
                put_integer(numbers, COVERS, 0)
            put(face_lanes, part, get(face_lanes, part) | 1 << lane)


@kernel
def write_rows(tree, parts, view, soup, slots, n, how, rows, face_lanes):
    """Write the rows of n <= 16 triangles for each face; `face_lanes`: bits of those that may block a ray."""
    if view.kind == PERSPECTIVE and view.radius == 0.0 and writes_sixteen(tree.nodes):
        lanes = (1 << n) - 1
        step = BATCH * NUMBERS
        write_point_rows(view, tree.faces, parts, tree.ways, slots, soup.corners, lanes, how, rows, step, face_lanes)
        return
    for part in range(parts):
        put(face_lanes, part, 0)
    for lane in range(n):
        slot = get(slots, lane)
        _write_row(tree, parts, view, soup, slot, how, ptr_at(rows, lane), lane, face_lanes)


@kernel
def _start(tree, part, block, lanes, union):
    """(level, group) where the traversal of a block of triangles starts; group -1 if they meet no node.

    It is the deepest group that contains all nodes that the triangles meet.
    """
    level, g = get(tree.heights, part) - 1, 0
    if not union_of(tree.nodes, block, lanes, union):
        return level, g
    while True:
        group = groups_of(tree, part, level) + g
        met = meet_union(tree.nodes, group_at(tree, group), union, tree.ways) & get(tree.alive, group)
        if met == 0:
            return level, -1
        if level == 0 or met & (met - 1) != 0:
            return level, g
        level, g = level - 1, g * tree.ways + lowest_bit(met)


@inlined
def queue_block(tree, part, block, rows, lanes, queues):
    """Queue the triangles of a block that may block rays of a face. They are close together and start at one group."""
    if lanes == 0:
        return
    level, g = _start(tree, part, ptr_at(rows, block * BLOCK), lanes, queues.union)
    if g < 0:
        return
    queue = level + 1
    at = queue * queues.step + get(queues.counts, queue)
    store(queues.groups, at, splat16(np.int32(g)))
    n = _queue(queues.rows, at, block * LANES, lanes, queues.blocks)
    put(queues.counts, queue, get(queues.counts, queue) + n)


@kernel
def trace_triangles(ticket, triangles, picks, beam, arrays, rays, how, counters, memory):
    """Worker: traverse the hierarchies of all faces with batches of the picked triangles."""
    tree, parts, view, leaves = tree_pointers(arrays), len(arrays.faces), view_of(beam), leaves_of(rays)
    soup, step = Soup(ptr(triangles.corners), ptr(triangles.ids)), how.pairs + LANES
    thread_counters = cleared(stack_i64(N_COUNTERS))
    marks, pairs = memory.marks, memory.pairs
    blocks = queues_blocks(tree, how)
    queues = Queues(ptr(pairs), ptr_at(pairs, QUEUES * step), ptr(marks), step, stack_f32(LANES), blocks)
    rows, face_lanes, slots = ptr(memory.rows), ptr_at(marks, QUEUES), ptr_at(marks, QUEUES + parts * BLOCKS)
    for first, last in shares(ticket):
        for i in range(first, last, LANES):
            for lane in range(LANES):
                put(slots, lane, picks[min(i + lane, last - 1)])
            block, n = (i - first) // LANES, min(last - i, LANES)
            numbers, to = ptr_at(rows, block * BLOCK), ptr_at(face_lanes, block * parts)
            write_rows(tree, parts, view, soup, slots, n, how, numbers, to)
        for part in range(parts):
            of_part = ptr_at(rows, part * BATCH * NUMBERS)
            for block in range((last - first + LANES - 1) // LANES):
                queue_block(tree, part, block, of_part, np.int64(get(face_lanes, block * parts + part)), queues)
            traverse_queues(tree, part, leaves, soup, of_part, queues, how, thread_counters)
    add_counters(counters, thread_counters)
