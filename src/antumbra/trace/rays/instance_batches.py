"""Ray lists through instances: 64 rays at a time advance in rounds, as in `interleaved_rays`.

A ray is either in the tree over the copies, or in the tree of a copy's mesh. Its stack holds the entries of the first
tree, and above them those of the second. Each ray has two columns of numbers, one per frame; the second is written when
it enters a copy. Both have the rows of a `RayBlock` that box tests and packets read. A round pushes the children of
nodes in both trees, tests leaves, settles the triangles that rays may meet one by one (`instance_traversal`), moves
rays into copies, and pops the next entry of each.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.instance_trees import CORNERS, GROUPS, MESH_WORDS, NODES, InstanceTrees, instance_pointers
from ...bvh.nodes import EMPTY, GROUP_WORDS, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import BEYOND, lines_may_pass
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined, kernel
from ...kernels.parallel import STOP, items, new_ticket
from ...kernels.simd import (
    as_f32,
    bits,
    broadcast8,
    f32_at,
    f64_at,
    get,
    lowest_bit,
    prefetch,
    ptr_at,
    put,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
)
from ...query.ray_list import HitArrays, RayArguments
from .hit_reports import CORNER_WORDS as REPORT_CORNERS
from .hit_reports import REPORT_WORDS, Report, write_nearest
from .instance_traversal import (
    EARLIER,
    LATER,
    InstanceHit,
    InstanceQuery,
    copy_limit,
    filter_bounds,
    map_ray,
    slab,
    slab_margins,
    test_triangle,
)
from .interleaved_rays import begin_tree, pop, push
from .ray_batches import read_batch, run_batches, share_ends, write_blocked
from .row_tiles import line_of
from .wide_traversal import (
    BLOCK_WORDS,
    BLOCKS,
    DX,
    FAR,
    FLOOR,
    INVERSE,
    LANES,
    LIMIT,
    LOWER,
    NEAR,
    NONE,
    OX,
    PRECISE_WORDS,
    STACK,
    TMIN,
    UNIT,
    Query,
    RayBlock,
    WideHit,
    block_of,
    fetch_from,
    filter_ray8,
    group_of,
    ray_of,
)

# --- Columns of rays in copies ----------------------------------------------------------------------------------------


RAYS = BLOCKS * LANES
WORLD = BLOCKS * BLOCK_WORDS  # words of all rays in the scene's frame; those in copies follow
COLUMN_WORDS, CORNER_WORDS, ID_WORDS = 2 * WORLD, 9 * (RAYS + 1), 3 * RAYS  # sizes of memory
SLACK = LOWER  # row of rays in copies, see `lines_may_pass`


class CopyFrames(NamedTuple):
    """The frames of the copies that 64 rays are in: pointers to scratch memory."""

    starts: F64Ptr  # float64 *: t of each ray where it enters its copy
    scales: F64Ptr  # float64 *: t in the copy's frame, per t; 0: hits do not limit the search


class BatchHits(NamedTuple):
    """The hits of 64 rays, as a tree for `hit_reports`: the triangle of ray i is in slot i."""

    prim_ids: I32Ptr  # int32 *: scene index of each ray's face
    slots: I32Ptr  # not used
    corners: F32Ptr  # float32 *, 9 per ray, then 9 of the triangle that is tested
    t: F64Ptr  # float64 *: see `InstanceHit`
    ids: I64Ptr  # int64 *, 3 per ray: see `InstanceHit`


@inlined
def column_of(i):
    """The word of ray i in the rows of its frame."""
    return i // LANES * BLOCK_WORDS + i % LANES


@inlined
def fill_column(scene, blocks, i, copy, start, hits, frames):
    """Write the column of ray i in a copy, from t = `start` on, or from its tmin."""
    ray = ray_of(block_of(blocks, i // LANES), i % LANES)
    r, rows = map_ray(scene, copy, ray, max(ray.tmin, start)), ptr_at(blocks.rows, WORLD + column_of(i))
    fits, along, pad = slab_margins(r.o, r.d, r.reach, r.shift)
    for k in range(3):
        inverse, near, far = slab(r.o[k], r.d[k], along, pad, fits)
        put(rows, INVERSE + LANES * k, inverse)
        put(rows, NEAR + LANES * k, near)
        put(rows, FAR + LANES * k, far)
        put(rows, OX + LANES * k, r.o[k])
        put(rows, DX + LANES * k, r.d[k])
    unit, floor, slack = filter_bounds(r)
    put(rows, UNIT, unit)
    put(rows, FLOOR, floor)
    put(rows, SLACK, slack)
    put(rows, TMIN, np.float32(0.0))
    put(rows, LIMIT, copy_limit(r, get(hits.t, i)))
    put(frames.starts, i, r.start)
    put(frames.scales, i, r.scale if r.tame else np.float64(0.0))


@inlined
def settle_lanes(scene, blocks, i, copy, first, lanes, query, hits, frames):
    """Test ray i against triangles of a copy, exactly. Return whether this ends the ray's any-hit query.

    lanes : bits of the triangles of the mesh's tree from lane `first` on
    """
    block = block_of(blocks, i // LANES)
    hit = InstanceHit(hits.corners, np.int64(RAYS), np.int64(i), ptr_at(hits.t, i), ptr_at(hits.ids, 3 * i))
    question = InstanceQuery(np.int64(get(block.skip, i % LANES)), query.cull_faces, query.any_hit)
    ray = ray_of(block, i % LANES)
    while lanes:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        if test_triangle(scene, copy, first + lane, ray, question, hit, None):
            if query.any_hit:
                return True
            _shorten(blocks.rows, i, get(hits.t, i), frames)
    return False


@inlined
def _shorten(rows, i, t, frames):
    """Limit the search of ray i to triangles that may be nearer than t."""
    put(rows, column_of(i) + LIMIT, np.float32(t * BEYOND))
    scale = get(frames.scales, i)
    if scale != 0.0:
        local = (t * BEYOND - get(frames.starts, i)) * scale
        put(rows, WORLD + column_of(i) + LIMIT, np.float32(local * LATER))


# --- The state of 64 rays ---------------------------------------------------------------------------------------------


_LEVEL = STACK + 2 * WIDTH  # entries of one tree; the lowest eight mark their end
_ROOM = 2 * _LEVEL
_STACKS = RAYS * _ROOM
_PRECISE = BLOCKS * PRECISE_WORDS
_LINE = 16  # float32 of a cache line


class _CopyRays(NamedTuple):
    """The state of up to 64 rays: pointers to scratch memory."""

    keys: I32Ptr  # int32 *, stacks: keys of `sorted_keys`
    links: I32Ptr  # int32 *, stacks: nodes and leaves; in the tree over the copies, ~copy
    tops: I32Ptr  # int32 *: index of the next entry of each ray's stack
    bottoms: I32Ptr  # int32 *: index of the first entry of the tree that it is in
    next: I32Ptr  # int32 *: link of each ray's next node or leaf
    columns: I32Ptr  # int32 *: word of each ray in the rows of its frame
    copies: I64Ptr  # int64 *: the copy that each ray is in
    nodes: I64Ptr  # int64 *: address of the nodes of the tree that it is in
    groups: I64Ptr  # int64 *: address of the groups of its mesh
    corners: I64Ptr  # int64 *: address of the corners of its mesh
    lanes: I32Ptr  # int32 *: bits of the triangles that it may meet
    frames: CopyFrames


# --- Steps of a ray ---------------------------------------------------------------------------------------------------


@inlined
def _test_leaf(rows, i, rays):
    """Test ray i against its leaf. Return whether it may meet a triangle."""
    group, n = wide_leaf(np.int64(get(rays.next, i)))
    column, groups = ptr_at(rows, get(rays.columns, i)), f32_at(get(rays.groups, i))
    possible = lines_may_pass(filter_ray8(column, 0), group_of(groups, group * GROUP_WORDS), broadcast8(column, SLACK))
    lanes = bits(possible) & ((1 << n) - 1)
    put(rays.lanes, i, lanes)
    prefetch(ptr_at(f64_at(get(rays.corners, i)), 9 * (group * WIDTH + lowest_bit(lanes))), 0)
    return lanes != 0


@inlined
def _begin(rays, i, bottom):
    """`begin_tree`, with the first entry of the tree that ray i is in."""
    begin_tree(rays, i, bottom)
    put(rays.bottoms, i, bottom + WIDTH)


@inlined
def _enter_copy(scene, blocks, i, hits, rays):
    """Move ray i to the root of the tree of its next copy."""
    copy, top = ~np.int64(get(rays.next, i)), np.int64(get(rays.tops, i))
    fill_column(scene, blocks, i, copy, np.float64(get(as_f32(rays.keys), top)) * EARLIER, hits, rays.frames)
    mesh = np.int64(get(scene.mesh, copy)) * MESH_WORDS
    put(rays.columns, i, WORLD + column_of(i))
    put(rays.copies, i, copy)
    put(rays.nodes, i, get(scene.meshes, mesh + NODES))
    put(rays.groups, i, get(scene.meshes, mesh + GROUPS))
    put(rays.corners, i, get(scene.meshes, mesh + CORNERS))
    _begin(rays, i, top)


@inlined
def _leave_copy(rays, i):
    """Return ray i to the tree over the copies."""
    put(rays.tops, i, get(rays.bottoms, i) - WIDTH)
    put(rays.bottoms, i, i * _ROOM + WIDTH)
    put(rays.columns, i, column_of(i))


@inlined
def _settle_leaf(scene, blocks, i, query, hits, rays):
    """Settle the triangles that ray i may meet in its leaf. Return whether this ends the ray's any-hit query."""
    lanes, first = np.int64(get(rays.lanes, i)), wide_leaf(np.int64(get(rays.next, i))).group * WIDTH
    return settle_lanes(scene, blocks, i, get(rays.copies, i), first, lanes, query, hits, rays.frames)


# --- Rounds -----------------------------------------------------------------------------------------------------------


@inlined
def _walk(scene, blocks, alive, query, hits, rays):
    """Trace the rays in `alive` (bits). Return bits of the rays whose any-hit query has ended with a hit."""
    rows, blocked, is_sorted = blocks.rows, np.int64(0), not query.any_hit
    outer, inner, leaves, copies, inside = alive, np.int64(0), np.int64(0), np.int64(0), np.int64(0)
    while alive:
        while outer:
            i = lowest_bit(outer)
            outer &= outer - 1
            push(scene.nodes, rows, i, True, rays)
        while inner:
            i = lowest_bit(inner)
            inner &= inner - 1
            push(f32_at(get(rays.nodes, i)), rows, i, is_sorted, rays)
        possible = np.int64(0)
        while leaves:
            i = lowest_bit(leaves)
            leaves &= leaves - 1
            possible |= np.int64(_test_leaf(rows, i, rays)) << i
        while possible:
            i = lowest_bit(possible)
            possible &= possible - 1
            if _settle_leaf(scene, blocks, i, query, hits, rays):
                blocked |= np.int64(1) << i
        alive &= ~blocked
        inner = copies
        while copies:
            i = lowest_bit(copies)
            copies &= copies - 1
            _enter_copy(scene, blocks, i, hits, rays)
        turn, left = alive & ~inner & inside, np.int64(0)
        above = alive & ~inner & ~inside
        inside |= inner
        while turn:
            i = lowest_bit(turn)
            turn &= turn - 1
            link, top = pop(rows, i, is_sorted, rays)
            more = top >= get(rays.bottoms, i)
            fetch_from(f32_at(get(rays.nodes, i)), f32_at(get(rays.groups, i)), link)
            left |= np.int64(not more) << i
            inner |= np.int64(more and link >= 0) << i
            leaves |= np.int64(more and link < 0) << i
        inside &= ~left
        above |= left
        while left:
            i = lowest_bit(left)
            left &= left - 1
            _leave_copy(rays, i)
        while above:
            i = lowest_bit(above)
            above &= above - 1
            link, top = pop(rows, i, True, rays)
            more = top >= get(rays.bottoms, i)
            prefetch(ptr_at(scene.nodes, link * NODE_WORDS if link >= 0 else 0), 0)
            alive &= ~(np.int64(not more) << i)
            outer |= np.int64(more and link >= 0) << i
            copies |= np.int64(more and link < 0 and link != EMPTY) << i
    return blocked


@inlined
def _trace(scene, blocks, alive, query, hits, rays):
    """Trace the rays in `alive` (bits) of a batch. Return bits of the rays that hit."""
    for i in range(RAYS):
        put(hits.ids, 3 * i, np.int64(-1))
        put(hits.t, i, ray_of(block_of(blocks, i // LANES), i % LANES).tmax)
        put(rays.columns, i, column_of(i))
        _begin(rays, i, i * _ROOM)
    if query.any_hit:
        return _walk(scene, blocks, alive, Query(query.cull_faces, True), hits, rays)
    _walk(scene, blocks, alive, Query(query.cull_faces, False), hits, rays)
    found = np.int64(0)
    for i in range(RAYS):
        face = get(hits.ids, 3 * i)
        put(hits.prim_ids, i, np.int32(face))
        found |= np.int64(face >= 0) << i
    return found


# --- Batches ----------------------------------------------------------------------------------------------------------


_CHUNK = 8  # batches that a thread takes at a time
_LISTED = RAYS + LANES


@kernel
def _batches(ticket, arrays, rays, any_hit, out, faults):
    """Worker: trace batches of 64 rays."""
    scene = instance_pointers(arrays)
    rows, precise, skip = stack_f32(COLUMN_WORDS), stack_f64(_PRECISE), stack_i32(RAYS)
    batch, query = RayBlock(rows, precise, skip, rays.segments), Query(rays.cull_faces, any_hit)
    hits = BatchHits(stack_i32(RAYS), stack_i32(1), stack_f32(CORNER_WORDS), stack_f64(RAYS), stack_i64(ID_WORDS))
    state = _CopyRays(
        stack_i32(_STACKS), stack_i32(_STACKS), stack_i32(RAYS), stack_i32(RAYS), stack_i32(RAYS), stack_i32(RAYS),
        stack_i64(RAYS), stack_i64(RAYS), stack_i64(RAYS), stack_i64(RAYS), stack_i32(RAYS),
        CopyFrames(stack_f64(RAYS), stack_f64(RAYS)),
    )  # fmt: skip
    report = Report(
        stack_f32(REPORT_CORNERS),
        stack_f32(BLOCK_WORDS),
        stack_f64(REPORT_WORDS),
        stack_i32(_LISTED),
        stack_i64(_LISTED),
    )
    found = WideHit(stack_i32(RAYS), stack_i32(1))
    sound = share_ends(rays, batch)
    for b in items(ticket):
        n, alive, good = read_batch(scene, rays, line_of(b * RAYS), batch)
        if not (sound and good):
            faults[0], ticket[STOP] = True, 1
            break
        hit = _trace(scene, batch, alive, query, hits, state)
        if any_hit:
            write_blocked(hit, n, line_of(b * RAYS), out.blocked)
        else:
            for i in range(RAYS):
                put(found.lane, i, np.int32(-2 - i if hit >> i & 1 else NONE))
            write_nearest(hits, batch, found, n, report, out, line_of(b * RAYS))


def trace_list(
    trees: InstanceTrees, rays: RayArguments, any_hit: bool, out: HitArrays, threads: int | None = None
) -> bool:
    """Trace rays and fill `out`. Return False, with `out` incomplete, if a ray is invalid."""
    faults, ticket = np.zeros(1, np.bool_), new_ticket(-(-rays.n // RAYS), _CHUNK)
    run_batches(_batches, threads, ticket, trees.arrays, rays.packed(), any_hit, out.packed(), faults)
    return not faults[0]
