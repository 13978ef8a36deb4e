"""`multifrusta:paper`: multi-frusta tracing as published [Benthin and Wald 2009, Sec. 3 and 4, Appendix A].

A frustum holds the 16 rays from one receiver to all of its light samples, bounded by corner rays. 16 frusta traverse
the tree at once, nearer child first. In a leaf, each triangle is tested against all of them (Sec. 4.2, Fig. 2).
Variants shrink the frusta to their unblocked rays (Sec. 5.3).
"""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ....bvh.block_tree import BlockTree, block_pointers
from ....bvh.nodes import block_leaf, box_at, box_of_link_at, link_at, rows_at, slot_at
from ....kernels.jit import F32Ptr, inlined, kernel
from ....kernels.parallel import items
from ....kernels.simd import (
    absolute,
    bits,
    fma,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ....kernels.vec3 import Vec3, dot, get3, largest, magnitudes, rows, store3, subtract3
from ....query.shadow_query import ShadowQuery, patch_of
from ....scene.lights import AMBIENT, LIST
from ....trace.counters import (
    BOX_TESTS,
    CANDIDATES,
    N_COUNTERS,
    NODES,
    SHRINKS,
    TRIANGLE_TESTS,
    TRIANGLES,
    add_counters,
    cleared,
    count,
)
from ....trace.descent import (
    Shafts,
    after_leaf,
    enter_first,
    entry,
    least_direction,
    load_saved,
    meets_mixed,
    mixed_axis,
    pop_node,
    rays_as_shafts,
    root,
    save,
    slabs_of,
)
from ....trace.packets.ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
    TileRun,
    directions_of,
    finish_tile,
    open_rays,
    origins_of,
    query_chunk_in,
    scratch_in,
    settle,
    start_tile,
    trace_tiles,
)
from ....trace.tile import first_pixel, place_of
from ....trace.triangle_tests import (
    DEFERRED,
    LANES,
    decide,
    defer,
    lanes_from,
    length1,
    store_lanes,
    stored_lane,
    triangle_along,
)

# --- Child order: nearer child first (Appendix A) ---------------------------------------------------------------------


@inlined
def prefers_right(near_left, near_right, both):
    """The number of lanes of `both` (bits) that enter the right child's box first, minus the number of the others.

    near_left, near_right : f32x16, entry t of the children's boxes
    """
    return 2 * popcount(bits(near_right < near_left) & both) - popcount(both)


@inlined
def entered_nearer(links, at, in_left, in_right, turn, stack):
    """Go to the left child, or the right one if `turn`, and push the other; `in_...`: bits of the lanes that hit it."""
    if turn:
        return enter_first(links, at, link_at(at.link, 1), in_right, in_left, stack)
    return enter_first(links, at, link_at(at.link, 0), in_left, in_right, stack)


# --- Frusta from 16 receivers to all of their samples (Sec. 4) --------------------------------------------------------
#
# A receiver's samples lie in a rectangle [a_low, a_high] x [b_low, b_high] of the light's patch, with points
# base + a u + b v. The segments to its four corners are the *corner rays* (Sec. 4.2, 4.4). The box of the samples
# bounds the directions for the traversal (Sec. 4.1). Lanes are receivers.
#
# Rounding moves samples and corners off their exact positions on the patch, along every axis by a few units in the last
# place of |base| + |u| + |v|. `OFF` bounds both errors together (16 units), and a corner ray culls samples only by a
# margin that exceeds it. Lists of lights and ambient light have no rectangle: `OFF` is then infinite, corner rays cull
# nothing, and only the box bounds the frusta.


_F = np.float32
_BASE, _U, _V, _A_LOW, _A_HIGH, _B_LOW, _B_HIGH = (16 * i for i in (0, 3, 6, 9, 10, 11, 12))
CORNERS, SPAN, OFF, _D_LOW, _D_HIGH = (16 * i for i in (13, 25, 26, 27, 30))
FRUSTA_FLOATS = 33 * 16


class Frusta(NamedTuple):
    """16 frusta, as pointers to float32."""

    memory: F32Ptr  # float32 *, rows of 16 lanes: patch, rectangle, corner rays (x, y, z of each), their lengths, box
    parameters: F32Ptr  # float32 *, rows of 16 samples: a and b of each receiver's samples


@kernel
def _load_patches(chunk, rays, memory):
    """Store the light's patch for each receiver, and `OFF`."""
    y0, x0 = first_pixel(rays.pixel, 0)
    for lane in range(16):
        there = lane if rays.rows >> lane & 1 else lowest_bit(rays.rows)
        patch = patch_of(chunk.query, place_of(chunk, y0, x0, there))
        for k in range(9):
            put(memory, _BASE + 16 * k + lane, _F(patch[k]))
    off = splat16(_F(0.0))
    for k in range(0, 48, 16):
        size = absolute(load16(memory, _BASE + k)) + absolute(load16(memory, _U + k)) + absolute(load16(memory, _V + k))
        off = maximum(off, size)
    store(memory, OFF, off * _F(16 * 2.0**-24) if _is_flat(chunk.query.light) else splat16(_F(np.inf)))


@inlined
def _corner(memory, a, b, origins):
    """Directions from the receivers to the points (a, b) of the patches."""
    base, u, v = rows(memory, _BASE, 16), rows(memory, _U, 16), rows(memory, _V, 16)
    point = Vec3(fma(b, v.x, fma(a, u.x, base.x)), fma(b, v.y, fma(a, u.y, base.y)), fma(b, v.z, fma(a, u.z, base.z)))
    return subtract3(point, origins)


@inlined
def _is_flat(light):
    w = light.w  # not zero: a list of distant lights
    return light.kind != LIST and light.kind != AMBIENT and w[0] == 0.0 and w[1] == 0.0 and w[2] == 0.0


@inlined
def _box_span(memory):
    low, high = magnitudes(rows(memory, _D_LOW, 16)), magnitudes(rows(memory, _D_HIGH, 16))
    return length1(Vec3(maximum(low.x, high.x), maximum(low.y, high.y), maximum(low.z, high.z)))


@inlined
def _aim(memory, tile):
    """Compute corner rays and their lengths from the rectangles."""
    origins, span = rows(tile.origins, 0, 16), splat16(_F(0.0))
    for corner in range(4):
        a = load16(memory, _A_LOW if corner & 1 == 0 else _A_HIGH)
        b = load16(memory, _B_LOW if corner & 2 == 0 else _B_HIGH)
        d = _corner(memory, a, b, origins)
        store3(memory, CORNERS + 48 * corner, 16, d)
        span = maximum(span, length1(d))
    off = load16(memory, OFF)
    store(memory, SPAN, select(off < _F(np.inf), fma(off, splat16(_F(3.0)), span), _box_span(memory)))


@inlined
def _range(values, there):
    """(minimum, maximum) of 16 numbers over the lanes in the mask `there`."""
    far = _F(np.inf)
    return reduce_min(select(there, values, splat16(far))), reduce_max(select(there, values, splat16(-far)))


@inlined
def _bound_rectangle(frusta, r, samples):
    """Store the rectangle of the samples (bits) of receiver r."""
    there = mask_from_bits16(samples)
    low, high = _range(load16(frusta.parameters, r * 32), there)
    put(frusta.memory, _A_LOW + r, low)
    put(frusta.memory, _A_HIGH + r, high)
    low, high = _range(load16(frusta.parameters, r * 32 + 16), there)
    put(frusta.memory, _B_LOW + r, low)
    put(frusta.memory, _B_HIGH + r, high)


@inlined
def _bound_directions(rays, frusta, r, samples):
    """Store the box of the samples (bits) of receiver r, relative to the receiver."""
    there = mask_from_bits16(samples)
    for k in range(3):
        o = get(rays.tile.origins, 16 * k + r)
        low, high = _range(load16(rays.points, r * 48 + 16 * k), there)
        put(frusta.memory, _D_LOW + 16 * k + r, low - o)
        put(frusta.memory, _D_HIGH + 16 * k + r, high - o)


@kernel
def make_frusta(chunk, samples, job, rays, memory):
    """Make the `Frusta` of a tile, to all samples of the chunk, in `memory`."""
    frusta = Frusta(memory, ptr_at(ptr(samples.parameters), job.chunk * 512))
    if rays.rows != 0:
        _load_patches(chunk, rays, memory)
        for r in range(16):
            _bound_rectangle(frusta, r, rays.lanes)
            _bound_directions(rays, frusta, r, rays.lanes)
        _aim(memory, rays.tile)
    return frusta


@kernel
def shrink(rays, frusta, which, directions, counters):
    """Shrink the frusta `which` (bits, at least one) to their unblocked rays (Sec. 5.3).

    This always shrinks the corner rays (*CR*). With `directions`, it shrinks the bounds of the directions too (*FS*).
    """
    while which != 0:
        r = lowest_bit(which)
        which &= which - 1
        samples = open_rays(rays, r)
        count(counters, SHRINKS, 1)
        _bound_rectangle(frusta, r, samples)
        if directions:
            _bound_directions(rays, frusta, r, samples)
    _aim(frusta.memory, rays.tile)


@inlined
def frusta_as_shafts(rays, frusta):
    """The 16 frusta as `Shafts`."""
    o, low, high = rows(rays.tile.origins, 0, 16), rows(frusta.memory, _D_LOW, 16), rows(frusta.memory, _D_HIGH, 16)
    return Shafts(o.x, o.y, o.z, o.x, o.y, o.z, low.x, low.y, low.z, high.x, high.y, high.z)


# --- Leaf tests: a block of triangles against 16 frusta, one triangle at a time (Sec. 4.2, Fig. 2) --------------------
#
# 1. Test the triangle's plane against all frusta side by side, to find the sides of the receiver and of the light. This
#    culls back faces if only one side blocks.
# 2. Test the four corner rays against the triangle's edges. The receiver's side of the plane determines the sign of a
#    hit's edge functions, so one edge with all corner rays on the wrong side culls a frustum. If float32 cannot decide
#    the side, two edges with opposite signs cull it.
# 3. Test the 16 rays of every remaining frustum.


WORK = LANES  # float32 words of scratch memory


class LeafOutcome(NamedTuple):
    """The frusta that a block changed."""

    done: int  # bits of the frusta without unblocked rays
    struck: int  # bits of the frusta with newly blocked and still unblocked rays


@inlined
def _triangle(block, i):
    """Triangle i of a block, as a `raytest.Triangle`."""
    return triangle_along(get3(block, i, 16), get3(block, 48 + i, 16), get3(block, 96 + i, 16))


@inlined
def _turned_away(lanes, facing):
    """Bits of the frusta whose receivers certainly face the side of a triangle that does not block."""
    return bits(lanes.t * _F(facing) > lanes.te) if facing != 0 else np.int64(0)


@inlined
def _missed(frusta, lanes, triangle, wide):
    """mask16 of the frusta that certainly miss a triangle."""
    off, size, t, n = load16(frusta.memory, OFF), triangle.size, lanes.t, lanes.n
    e = fma(off * wide, splat16(size * _F(18.1)), lanes.e)
    te = fma(off, splat16(size * size * _F(6.1)), lanes.te)
    far = splat16(_F(np.inf))
    low0, low1, low2, low_f, high0, high1, high2, high_f = far, far, far, far, -far, -far, -far, -far
    for corner in range(4):
        d = rows(frusta.memory, CORNERS + 48 * corner, 16)
        e2, e1, dn = dot(d, lanes.cp), dot(d, lanes.qc), dot(d, n)
        e0, f = dn - e1 - e2, t - dn
        low0, low1, low2, low_f = minimum(low0, e0), minimum(low1, e1), minimum(low2, e2), minimum(low_f, f)
        high0, high1, high2, high_f = maximum(high0, e0), maximum(high1, e1), maximum(high2, e2), maximum(high_f, f)
    some_up = maximum(maximum(low0, low1), low2) > e
    some_down = minimum(minimum(high0, high1), high2) < -e
    above, below = t > lanes.te, t < -lanes.te
    return (above & (some_down | (low_f > te))) | (below & (some_up | (high_f < -te))) | (some_up & some_down)


@kernel
def _cull(tree, slot, block, i, mask, rays, frusta, facing, work):
    """Bits of the frusta in `mask` that may hit triangle i of a block; writes data for their ray tests to `work`."""
    on_triangle = bits(load16(rays.tile.faces, 0) == get(tree.prim_ids, slot))
    origins, triangle = rows(rays.tile.origins, 0, 16), _triangle(block, i)
    lanes = lanes_from(origins, load16(frusta.memory, SPAN), triangle)
    active = mask & ~on_triangle & ~_turned_away(lanes, facing)
    if active == 0:
        return active
    v = triangle.v
    a = Vec3(v.x - origins.x, v.y - origins.y, v.z - origins.z)
    wide = maximum(largest(a), splat16(triangle.size))
    active &= ~bits(_missed(frusta, lanes, triangle, wide))
    if active != 0:
        store_lanes(work, lanes)
    return active


@inlined
def _test_frustum(slot, rays, r, facing, work, deferred, counters):
    """Test the rays of frustum r against a triangle; return the bits of the blocked rays."""
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = decide(directions_of(rays, r), stored_lane(work, r), facing)
    unblocked = open_rays(rays, r)
    if unsure & unblocked != 0:
        defer(deferred, slot, r * rays.row_place, rays.lane_place, unsure & unblocked)
    return hit & unblocked


@kernel
def trace_block(tree, link, mask, rays, frusta, facing, work, deferred, counters):
    """Test the frusta in `mask` against a block; return a `LeafOutcome`. The lanes of `rays` are samples."""
    leaf, done, struck = block_leaf(link), np.int64(0), np.int64(0)
    block = ptr_at(tree.blocks, rows_at(leaf.block))
    for i in range(leaf.count):
        slot = get(tree.slots, slot_at(leaf.block, i))
        count(counters, TRIANGLES, 1)
        active = _cull(tree, slot, block, i, mask, rays, frusta, facing, work)
        if active == 0:
            continue
        count(counters, CANDIDATES, 1)
        while active != 0:
            r = lowest_bit(active)
            active &= active - 1
            hit = _test_frustum(slot, rays, r, facing, work, deferred, counters)
            if hit != 0:
                dead = get(rays.dead, r) | hit
                put(rays.dead, r, dead)
                struck |= np.int64(1) << r
                if dead & rays.lanes == rays.lanes:
                    done |= np.int64(1) << r
        mask &= ~done
        if mask == 0:
            break
    return LeafOutcome(done, struck & ~done)


# --- Traversal (Sec. 3 and 4) -----------------------------------------------------------------------------------------
#
# The tracer `multifrusta` is this package's own variant. Here, 16 frusta traverse a shallow tree together; each starts
# at one receiver and spans the whole light. At leaves, corner rays cull frusta, then the 16 rays of a frustum are
# tested side by side. A frustum ends when all its rays are blocked.
#
# Differences from the paper:
#
# - Either side of a triangle blocks, unless the query culls faces. The paper always culls back faces.
# - The nearer child is decided by a majority of the frusta. Appendix A does not specify what happens if lanes disagree.
# - Direction intervals that contain zero need no second test (see `trace.descent`).
# - Float32 decides only the certain cases.
#
# Sec. 5.3 and Table 2 shrink frusta to their unblocked rays in three ways, each a tracer: by testing rays against leaf
# boxes, by shrinking the rectangles on the light, and by shrinking the direction bounds as well.


BLOCK = 4  # triangles in a leaf of the shallow tree, at most


class Shrinking(NamedTuple):
    """How a frustum shrinks to its unblocked rays (Sec. 5.3)."""

    leaf_boxes: bool = False  # test rays against leaf boxes (*Ray-AABB*)
    corners: bool = False  # after a leaf, recompute corner rays from the unblocked rays (*CR*)
    directions: bool = False  # recompute the direction bounds from them too (*FS*)


@inlined
def open_frusta(rays):
    """Bits of the frusta with an unblocked ray."""
    alive, left_rows = np.int64(0), rays.rows
    while left_rows != 0:
        r = lowest_bit(left_rows)
        left_rows &= left_rows - 1
        if open_rays(rays, r) != 0:
            alive |= np.int64(1) << r
    return alive


@kernel
def _reach_box(tree, place, mask, rays, counters):
    """Bits of the frusta in `mask` with an unblocked ray that hits a leaf's box."""
    reached, box = np.int64(0), box_of_link_at(place)
    while mask != 0:
        r = lowest_bit(mask)
        mask &= mask - 1
        s = rays_as_shafts(origins_of(rays, r), directions_of(rays, r))
        limit = least_direction(s)
        x = mixed_axis(s.ox_low, s.ox_high, s.dx_low, s.dx_high, limit, False)
        y = mixed_axis(s.oy_low, s.oy_high, s.dy_low, s.dy_high, limit, False)
        z = mixed_axis(s.oz_low, s.oz_high, s.dz_low, s.dz_high, limit, False)
        count(counters, BOX_TESTS, 1)
        if bits(meets_mixed(tree.nodes, box, x, y, z)) & open_rays(rays, r) != 0:
            reached |= np.int64(1) << r
    return reached


@inlined
def _next_leaf(tree, slabs, at, stack, alive, counters):
    """Descend from `at` to the next leaf that a frustum in `alive` hits, nearer child first."""
    end = splat16(np.float32(1.0))
    at = pop_node(tree.links, at, stack, alive)
    while at.mask != 0 and at.link >= 0:
        count(counters, NODES, 1)
        count(counters, BOX_TESTS, 2)
        in_left, near_left = entry(tree.nodes, box_at(at.link, 0), slabs, end)
        in_right, near_right = entry(tree.nodes, box_at(at.link, 1), slabs, end)
        in_left, in_right = in_left & at.mask, in_right & at.mask
        turn = prefers_right(near_left, near_right, in_left & in_right) > 0
        at = pop_node(tree.links, entered_nearer(tree.links, at, in_left, in_right, turn, stack), stack, alive)
    return at


@kernel
def _walk(tree, rays, frusta, shrinking, facing, work, scratch, counters):
    """Continue the traversal. Return whether it must resume, with new bounds or after deferred tests are resolved."""
    alive = open_frusta(rays)
    slabs = slabs_of(frusta_as_shafts(rays, frusta), alive)
    at = _next_leaf(tree, slabs, load_saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0:
        if get(scratch.deferred, 0) > DEFERRED:
            save(scratch.at, at)
            return True
        mask = at.mask
        if shrinking.leaf_boxes and block_leaf(at.link).count != 0:
            mask = _reach_box(tree, at.place, mask, rays, counters)
        if mask != 0:
            leaf = trace_block(tree, at.link, mask, rays, frusta, facing, work, scratch.deferred, counters)
            alive &= ~leaf.done
            if shrinking.corners and leaf.struck != 0:
                shrink(rays, frusta, leaf.struck, shrinking.directions, counters)
                if shrinking.directions:
                    save(scratch.at, after_leaf(at))
                    return True
        at = _next_leaf(tree, slabs, after_leaf(at), scratch.stack, alive, counters)
    return False


@kernel
def _trace_frusta(ticket, arrays, query, samples, job, out, counters, shrinking):
    """Worker: trace tiles."""
    scratch = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS))
    memory, work = stack_f32(FRUSTA_FLOATS), stack_f32(WORK)
    tree, totals = block_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, totals)
        frusta = make_frusta(chunk, samples, job, rays, memory)
        save(scratch.at, root(open_frusta(rays)))
        while _walk(tree, rays, frusta, shrinking, chunk.query.facing, work, scratch, totals):
            if get(scratch.deferred, 0) > DEFERRED:
                settle(tree, chunk, rays, scratch, totals)
        settle(tree, chunk, rays, scratch, totals)
        finish_tile(chunk, rays, places)
    add_counters(counters, totals)


def trace_shadow(
    shrinking: Shrinking,
    tree: BlockTree,
    query: ShadowQuery,
    bits: np.ndarray,
    threads: int | None = None,
    counters: np.ndarray | None = None,
    progress: Any = None,
) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    shrinking : Shrinking
    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(TileRun(_trace_frusta, True, threads, counters, progress), tree, query, bits, shrinking)


as_published = partial(trace_shadow, Shrinking())
with_leaf_boxes = partial(trace_shadow, Shrinking(leaf_boxes=True))
with_corners = partial(trace_shadow, Shrinking(corners=True))
with_all = partial(trace_shadow, Shrinking(corners=True, directions=True))
