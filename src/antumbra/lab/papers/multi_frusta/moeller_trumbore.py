"""Packets of 16 rays with Moeller and Trumbore's test: the paper's baseline [Benthin and Wald 2009, Sec. 5 and 5.1].

A packet traverses the builder's own deep tree with one slab test per box for all 16 rays. A triangle's edges are
computed when it is tested, and the test ends early when no ray can hit it [Moeller and Trumbore 1997]. Float32 decides
only the certain cases. The products are those of the edge functions in another order, so the bounds of
docs/design/exactness.md hold for them.

`packet16:paper` traces the shadow rays of one receiver in a packet; `trace_packets` traces the primary rays of 4 x 4
pixels.
"""

from typing import Any, NamedTuple

import numpy as np

from ....bvh.block_tree import BlockTree, block_pointers, block_tree
from ....bvh.nodes import EMPTY, Bvh, block_leaf, bvh_leaf, slot_at, tree_of
from ....kernels.jit import F32Ptr, inlined, kernel
from ....kernels.parallel import items, new_ticket, run, thread_count
from ....kernels.simd import (
    bits,
    flip_sign,
    get,
    load16,
    lowest_bit,
    popcount,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
)
from ....kernels.vec3 import Vec3, crosses, dot, dots, get3, largest, rows, subtract3
from ....query.gbuffer import pixel_direction
from ....query.shadow_query import ShadowQuery
from ....scene.camera import CameraRays
from ....trace.counters import (
    CANDIDATES,
    N_COUNTERS,
    RAYS,
    TRIANGLE_TESTS,
    TRIANGLES,
    add_counters,
    cleared,
    count,
    new_counters,
)
from ....trace.descent import (
    GROW,
    WAITING_FLOATS,
    WAITING_INTS,
    NearestStack,
    NearestTraversal,
    after_leaf,
    after_visit,
    endless_slabs_of,
    load_saved,
    next_block,
    next_leaf,
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
from ....trace.triangle_tests import DEFERRED, decide_signs, defer, error_bounds, length1
from .hit_intervals import LineTest, PixelRow, direction_bound, keep_hits, start_row, write_hits

# --- Moeller and Trumbore's test --------------------------------------------------------------------------------------
#
# With a = v0 - origin and the edges p and q, the numerators of u, v and t are a . (d x q), d . (a x p) and q . (a x p),
# apart from signs, and the determinant is -p . (d x q). They are compared without division.


_F = np.float32


class _Edges(NamedTuple):
    """A triangle, and its first test: everything that the cross product d x q gives."""

    a: Vec3  # f32x16
    p: Vec3  # scalars
    q: Vec3
    test: LineTest  # `e2` and `t` are missing


@inlined
def _largest_of(v):
    x, y, z = abs(v.x), abs(v.y), abs(v.z)
    y = y if y > z else z
    return x if x > y else y


@inlined
def _first_half(corners, slot, o, d, span):
    """The determinant and the first edge function."""
    v = get3(corners, 9 * slot, 1)
    p, q = subtract3(get3(corners, 9 * slot + 3, 1), v), subtract3(get3(corners, 9 * slot + 6, 1), v)
    a, normal = Vec3(v.x - o.x, v.y - o.y, v.z - o.z), crosses(d, q)
    long_p, long_q = _largest_of(p), _largest_of(q)
    size, none = splat16(long_p if long_p > long_q else long_q), splat16(_F(0.0))
    e, te = error_bounds(largest(a), size, span)
    return _Edges(a, p, q, LineTest(dot(a, normal), none, -dots(normal, p), none, e, te, direction_bound(size, span)))


@inlined
def _may_hit(test):
    """Bits of the rays that the first edge function does not exclude."""
    size, u = test.dn, test.e1
    outside = ((size > test.de) & ((u < -test.e) | (u > size + test.e + test.de))) | (
        (size < -test.de) & ((u > test.e) | (u < size - test.e - test.de))
    )
    return bits(outside) ^ 0xFFFF


@inlined
def _whole_test(edges, d):
    """The complete `LineTest`."""
    c, test = crosses(edges.a, edges.p), edges.test
    return LineTest(test.e1, dot(d, c), test.dn, dots(c, edges.q), test.e, test.te, test.de)


# --- `packet16:paper`: shadow rays ------------------------------------------------------------------------------------


@inlined
def _turned_away(test, facing):
    """Bits of the rays that certainly meet the side of a triangle that does not block."""
    return bits(flip_sign(test.dn, splat16(_F(facing))) > test.de) if facing != 0 else np.int64(0)


@kernel
def _trace_leaf(tree, link, mask, rays, r, facing, scratch, counters):
    """Test the rays of row r in `mask` against a leaf. Return bits of the blocked rays."""
    hits = np.int64(0)
    if link == EMPTY:
        return hits
    o, d, leaf = origins_of(rays, r), directions_of(rays, r), bvh_leaf(link)
    span, own = length1(d), get(rays.tile.faces, r)
    for slot in range(leaf.first, leaf.first + leaf.count):
        count(counters, TRIANGLES, 1)
        if get(tree.prim_ids, slot) == own:
            continue
        edges = _first_half(tree.corners, slot, o, d, span)
        tested = mask & ~hits & ~_turned_away(edges.test, facing)
        if tested == 0:
            continue
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        tested &= _may_hit(edges.test)
        if tested == 0:
            continue
        test = _whole_test(edges, d)
        hit, unsure = decide_signs(test.e1, test.e2, test.dn, test.t, test.e, test.te, facing)
        if unsure & tested != 0:
            defer(scratch.deferred, slot, r * rays.row_place, rays.lane_place, unsure & tested)
        hits |= hit & tested
        if hits == mask:
            break
    return hits


@kernel
def _walk(tree, rays, r, facing, scratch, counters):
    """Continue the traversal of row r. Return whether it must resume after the deferred tests are settled."""
    alive = open_rays(rays, r)
    slabs = slabs_of(rays_as_shafts(origins_of(rays, r), directions_of(rays, r)), alive)
    at = next_leaf(tree, slabs, load_saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0 and get(scratch.deferred, 0) <= DEFERRED:
        alive &= ~_trace_leaf(tree, at.link, at.mask, rays, r, facing, scratch, counters)
        at = next_leaf(tree, slabs, after_leaf(at), scratch.stack, alive, counters)
    put(rays.dead, r, get(rays.dead, r) | (rays.lanes & ~alive))
    save(scratch.at, at)
    return at.mask != 0


@kernel
def _trace_shadow_packets(ticket, bvh, query, samples, job, out, counters):
    """Worker: trace tiles, packet by packet."""
    scratch = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS))
    tree, totals = tree_of(bvh), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, totals)
        left_rows = rays.rows
        while left_rows != 0:
            r = lowest_bit(left_rows)
            left_rows &= left_rows - 1
            save(scratch.at, root(open_rays(rays, r)))
            while _walk(tree, rays, r, chunk.query.facing, scratch, totals):
                settle(tree, chunk, rays, scratch, totals)
        settle(tree, chunk, rays, scratch, totals)
        finish_tile(chunk, rays, places)
    add_counters(counters, totals)


def trace_shadow(
    bvh: Bvh,
    query: ShadowQuery,
    bits: np.ndarray,
    threads: int | None = None,
    counters: np.ndarray | None = None,
    progress: Any = None,
) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(TileRun(_trace_shadow_packets, True, threads, counters, progress), bvh, query, bits)


# --- Primary rays -----------------------------------------------------------------------------------------------------


class PrimaryPacket(NamedTuple):
    """The rays of 4 x 4 pixels."""

    directions: F32Ptr  # float32: rows x, y, z of 16 rays
    row: PixelRow


@inlined
def _origins(rays):
    o = rays.origin
    return Vec3(splat16(o[0]), splat16(o[1]), splat16(o[2]))


@inlined
def _packet_at(floats, slots, x0, y0):
    """The `PrimaryPacket` at pixel (x0, y0), in 80 float32 and 16 int32."""
    return PrimaryPacket(floats, PixelRow(ptr_at(floats, 48), ptr_at(floats, 64), slots, x0, y0))


@kernel
def _load(rays, packet):
    """Fill a packet. Return bits of its rays; other lanes repeat the first ray."""
    row = packet.row
    alive = start_row(rays, row)
    for lane in range(16):
        there = lane if alive >> lane & 1 else 0
        d = pixel_direction(rays, row.x0 + (there & 3), row.y0 + (there >> 2))
        for k in range(3):
            put(packet.directions, 16 * k + lane, d[k])
    return alive


@kernel
def _trace_primary_leaf(tree, link, mask, rays, packet, counters):
    """Test the triangles of a leaf against the rays in `mask`."""
    o, d = _origins(rays), rows(packet.directions, 0, 16)
    span, leaf = length1(d), block_leaf(link)
    for i in range(leaf.count):
        slot = get(tree.slots, slot_at(leaf.block, i))
        count(counters, TRIANGLES, 1)
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        edges = _first_half(tree.corners, slot, o, d, span)
        may = mask & _may_hit(edges.test)
        if may != 0:
            keep_hits(tree, slot, rays, packet.row, _whole_test(edges, d), may, counters)


@inlined
def _far(packet):
    return load16(packet.row.high, 0) * GROW


@kernel
def _trace_primary_packet(tree, alive, rays, packet, waiting, counters):
    """Trace the rays in `alive` through the tree, each clipped at its nearest hit so far."""
    slabs = endless_slabs_of(rays_as_shafts(_origins(rays), rows(packet.directions, 0, 16)), alive)
    at = NearestTraversal(np.int64(0), alive, np.int64(0))
    at = next_block(tree, slabs, at, waiting, _far(packet), counters)
    while at.mask != 0:
        _trace_primary_leaf(tree, at.link, at.mask, rays, packet, counters)
        at = next_block(tree, slabs, after_visit(at), waiting, _far(packet), counters)


@kernel
def _trace_primary_packets(ticket, arrays, rays, face, t, counters):
    """Worker: trace packets."""
    tree, totals, across = block_pointers(arrays), cleared(stack_i64(N_COUNTERS)), (rays.width + 3) // 4
    floats, slots = stack_f32(80), stack_i32(16)
    waiting = NearestStack(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    for n in items(ticket):
        packet = _packet_at(floats, slots, n % across * 4, n // across * 4)
        alive = _load(rays, packet)
        count(totals, RAYS, popcount(alive))
        _trace_primary_packet(tree, alive, rays, packet, waiting, totals)
        write_hits(tree, rays, packet.row, alive, ptr(face), ptr(t))
    add_counters(counters, totals)


def deep_tree(bvh: Bvh, threads: int | None = None) -> BlockTree:
    """The tree of a `Bvh`, with the BVH's leaves as blocks."""
    return block_tree(bvh, threads, block=1)


def trace_packets(
    tree: BlockTree, rays: CameraRays, threads: int | None = None, counters: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The nearest hits (face, t) of the pixel-centre rays, as from `trace_primary`."""
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    ticket = new_ticket(-(-rays.width // 4) * -(-rays.height // 4), 64)
    counters = new_counters() if counters is None else counters
    run(_trace_primary_packets, thread_count(threads), ticket, tree, rays, face, t, counters)
    return face, t
