"""Packet tracers, the baselines of multi-frusta tracing [Benthin and Wald 2009, Sec. 5.1 and 5.2].

`packet256` traces 16 packets of 16 shadow rays together through the shallow tree. Packets of 16 primary rays are the
baseline of the primary rows of Table 1.
"""

from typing import Any, NamedTuple

import numpy as np

from ...bvh.block_tree import BlockTree, block_pointers, block_tree
from ...bvh.nodes import Bvh, block_leaf, box_at, slot_at
from ...kernels.exact.filters import is_nearer, meets
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import (
    absolute,
    bits,
    get,
    load16,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
)
from ...kernels.vec3 import Vec3, dot, rows
from ...query.gbuffer import pixel_direction, pixel_ray
from ...query.raster_setup import eye_plane, plane_t
from ...query.shadow_query import ShadowQuery
from ...scene.camera import CameraRays
from ...trace.counters import (
    BOX_TESTS,
    CANDIDATES,
    N_COUNTERS,
    NODES,
    RAYS,
    TRIANGLE_TESTS,
    TRIANGLES,
    add_counters,
    cleared,
    count,
    new_counters,
)
from ...trace.descent import (
    GROW,
    WAITING_FLOATS,
    WAITING_INTS,
    Bound,
    Mixed,
    NearestStack,
    NearestTraversal,
    Uniform,
    after_leaf,
    after_visit,
    endless_slabs_of,
    load_saved,
    next_block,
    pop_node,
    rays_as_shafts,
    root,
    save,
    slabs_of,
    span_mixed,
    span_uniform,
)
from ...trace.packets.ray_tile import (
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
from ...trace.triangle_tests import DEFERRED, lanes_from, length1, triangle_in
from .published_frusta import FRUSTA_FLOATS, WORK, entered_nearer, make_frusta, open_frusta, prefers_right, trace_block

# --- `packet256`: 16 packets of 16 shadow rays (Sec. 5.2) -------------------------------------------------------------
#
# At each node, the rays of every active packet are tested against both children, which gives two new packet masks. The
# child that more rays enter first is traversed first. The tree, corner culling and the ray tests at leaves are those of
# `multifrusta:paper`; only the traversal differs. A packet holds one receiver's rays to its samples.


_PACKET = 24 * 16  # float32 words of a packet: r and k of its slab bounds
_PLANES = 4  # int32 words of a packet: whether all rays have the same signs, and the near plane of each axis
_ALL_PACKETS, _ALL_PLANES = 16 * _PACKET, 16 * _PLANES


@inlined
def _keep_bounds(packet, at, bounds):
    for k in range(len(bounds)):
        store(packet, at + 32 * k, bounds[k].r)
        store(packet, at + 32 * k + 16, bounds[k].k)


@inlined
def _bound(packet, at):
    return Bound(load16(packet, at), load16(packet, at + 16))


@inlined
def _uniform(packet, planes, axis):
    plane = get(planes, 1 + axis)
    return Uniform(_bound(packet, 64 * axis), _bound(packet, 64 * axis + 32), plane, 2 - plane)


@inlined
def _mixed(packet, axis):
    at = 128 * axis
    return Mixed(_bound(packet, at), _bound(packet, at + 32), _bound(packet, at + 64), _bound(packet, at + 96))


@kernel
def _prepare_packet(rays, r, packet, planes):
    """Store the constants of the slab tests of packet r."""
    s = slabs_of(rays_as_shafts(origins_of(rays, r), directions_of(rays, r)), open_rays(rays, r))
    put(planes, 0, 1 if s.uniform else 0)
    if s.uniform:
        put(planes, 1, s.ux.near_plane)
        put(planes, 2, s.uy.near_plane)
        put(planes, 3, s.uz.near_plane)
        _keep_bounds(packet, 0, (s.ux.near, s.ux.far, s.uy.near, s.uy.far, s.uz.near, s.uz.far))
    else:
        _keep_bounds(packet, 0, s.mx)
        _keep_bounds(packet, 128, s.my)
        _keep_bounds(packet, 256, s.mz)


@kernel
def _prepare(rays, alive, packets, planes):
    while alive != 0:
        r = lowest_bit(alive)
        alive &= alive - 1
        _prepare_packet(rays, r, ptr_at(packets, r * _PACKET), ptr_at(planes, r * _PLANES))


@inlined
def _entry(nodes, at, packet, planes):
    """(bits of a packet's rays that hit a box, entry t of each ray); `at`: index in `nodes` of the box's lower x."""
    end = splat16(np.float32(1.0))
    if get(planes, 0) != 0:
        x, y, z = _uniform(packet, planes, 0), _uniform(packet, planes, 1), _uniform(packet, planes, 2)
        t_near, t_far = span_uniform(nodes, at, x, y, z, end)
    else:
        t_near, t_far = span_mixed(nodes, at, _mixed(packet, 0), _mixed(packet, 1), _mixed(packet, 2), end)
    return bits(t_near <= t_far), t_near


@inlined
def _packets_in(tree, at, rays, packets, planes, counters):
    """(left, right, turn): bits of the packets with an open ray in each child; whether the right one comes first."""
    waiting, in_left, in_right, votes = at.mask, np.int64(0), np.int64(0), np.int64(0)
    count(counters, NODES, 1)
    while waiting != 0:
        r = lowest_bit(waiting)
        waiting &= waiting - 1
        count(counters, BOX_TESTS, 2)
        packet, packet_planes, alive = ptr_at(packets, r * _PACKET), ptr_at(planes, r * _PLANES), open_rays(rays, r)
        a, near_a = _entry(tree.nodes, box_at(at.link, 0), packet, packet_planes)
        b, near_b = _entry(tree.nodes, box_at(at.link, 1), packet, packet_planes)
        if a & alive != 0:
            in_left |= np.int64(1) << r
        if b & alive != 0:
            in_right |= np.int64(1) << r
        votes += prefers_right(near_a, near_b, a & b & alive)
    return in_left, in_right, votes > 0


@kernel
def _walk(tree, rays, frusta, packets, planes, facing, work, scratch, counters):
    """Continue the traversal. Return whether it must resume after the deferred tests are resolved."""
    alive = open_frusta(rays)
    at = pop_node(tree.links, load_saved(scratch.at, alive), scratch.stack, alive)
    while at.mask != 0:
        if at.link >= 0:
            in_left, in_right, turn = _packets_in(tree, at, rays, packets, planes, counters)
            at = entered_nearer(tree.links, at, in_left, in_right, turn, scratch.stack)
        else:
            if get(scratch.deferred, 0) > DEFERRED:
                save(scratch.at, at)
                return True
            leaf = trace_block(tree, at.link, at.mask, rays, frusta, facing, work, scratch.deferred, counters)
            alive &= ~leaf.done
            at = after_leaf(at)
        at = pop_node(tree.links, at, scratch.stack, alive)
    return False


@kernel
def _trace_packets(ticket, arrays, query, samples, job, out, counters):
    """Worker: trace tiles."""
    scratch = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS))
    memory, work = stack_f32(FRUSTA_FLOATS), stack_f32(WORK)
    packets, planes = stack_f32(_ALL_PACKETS), stack_i32(_ALL_PLANES)
    tree, totals = block_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, totals)
        frusta, alive = make_frusta(chunk, samples, job, rays, memory), open_frusta(rays)
        _prepare(rays, alive, packets, planes)
        save(scratch.at, root(alive))
        while _walk(tree, rays, frusta, packets, planes, chunk.query.facing, work, scratch, totals):
            settle(tree, chunk, rays, scratch, totals)
        settle(tree, chunk, rays, scratch, totals)
        finish_tile(chunk, rays, places)
    add_counters(counters, totals)


def trace_shadow(
    tree: BlockTree,
    query: ShadowQuery,
    bits: np.ndarray,
    threads: int | None = None,
    counters: np.ndarray | None = None,
    progress: Any = None,
) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(TileRun(_trace_packets, True, threads, counters, progress), tree, query, bits)


# --- Packets of 16 primary rays (Sec. 5.1) ----------------------------------------------------------------------------
#
# A packet holds the rays of 4 x 4 pixels. It traverses the builder's own deep tree, nearer child first, with each ray
# clipped at its nearest hit so far. Triangles are tested one by one against the 16 rays: float32 rejects certain
# misses, float64 computes the t of hits, and the contract's predicate decides the rest. The hits are therefore those of
# `trace.primary.primary_rays.trace_primary`, bit for bit.


_F = np.float32
_FAR = 48
_FLOATS = 64
_BEYOND = GROW * GROW  # one factor for the rounding of t, one because exit t are enlarged


class PrimaryPacket(NamedTuple):
    """The rays of 4 x 4 pixels and their nearest hits so far, as pointers to memory of 16 lanes."""

    rows: F32Ptr  # float32, 4 rows: directions x, y, z; t beyond which no hit is nearer
    t: F64Ptr  # float64, inf: no hit
    face: I32Ptr  # int32, -1: no hit
    x0: int  # first pixel
    y0: int


@inlined
def _pixel(packet, lane):
    return packet.x0 + (lane & 3), packet.y0 + (lane >> 2)


@kernel
def _load(rays, packet):
    """Write the rays of a packet. Return the bits of its rays; other lanes repeat the first ray."""
    alive = np.int64(0)
    for lane in range(16):
        x, y = _pixel(packet, lane)
        there = x < rays.width and y < rays.height
        d = pixel_direction(rays, x if there else packet.x0, y if there else packet.y0)
        for k in range(3):
            put(packet.rows, 16 * k + lane, d[k])
        put(packet.rows, _FAR + lane, _F(np.inf))
        put(packet.t, lane, np.inf)
        put(packet.face, lane, -1)
        alive |= np.int64(there) << lane
    return alive


@inlined
def _origins(rays):
    o = rays.origin
    return Vec3(splat16(o[0]), splat16(o[1]), splat16(o[2]))


@inlined
def _signs(d, lanes, far):
    """(bits of the rays whose lines certainly hit a triangle, bits of those with a possible hit nearer than `far`)."""
    # Eq. (7) of docs/design/exactness.md, for infinite rays
    e2, e1, dn = dot(d, lanes.cp), dot(d, lanes.qc), dot(d, lanes.n)
    e0, t, e, te = dn - e1 - e2, lanes.t, lanes.e, lanes.te
    low, high = minimum(minimum(e0, e1), e2), maximum(maximum(e0, e1), e2)
    up, down, above, below = low > e, high < -e, t > te, t < -te
    missed = ((low < -e) & (high > e)) | (up & below) | (down & above)
    beyond = absolute(t) - te > (absolute(dn) + te + te) * far
    return bits((up & above) | (down & below)), bits(missed | beyond) ^ 0xFFFF


@kernel
def _keep_hits(tree, slot, rays, packet, sure, maybe):
    """Record a triangle for the rays in `maybe` (bits) whose nearest hit it is; those in `sure` certainly hit it."""
    plane, prim = eye_plane(tree.corners, slot, rays.origin), get(tree.prim_ids, slot)
    while maybe != 0:
        lane = lowest_bit(maybe)
        maybe &= maybe - 1
        x, y = _pixel(packet, lane)
        ray = pixel_ray(rays, x, y)
        if sure >> lane & 1 == 0 and meets(ray, tree.corners, slot) == 0:
            continue
        t = plane_t(plane, ray, tree.corners)
        if is_nearer(t, prim, get(packet.t, lane), get(packet.face, lane)):
            put(packet.t, lane, t)
            put(packet.face, lane, prim)
            put(packet.rows, _FAR + lane, _F(t) * _BEYOND)


@kernel
def _trace_leaf(tree, link, mask, rays, packet, counters):
    """Test the triangles of a leaf against the rays in `mask`."""
    o, d = _origins(rays), rows(packet.rows, 0, 16)
    span = length1(d)
    leaf = block_leaf(link)
    for i in range(leaf.count):
        slot = get(tree.slots, slot_at(leaf.block, i))
        count(counters, TRIANGLES, 1)
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        lanes = lanes_from(o, span, triangle_in(tree.corners, slot))
        sure, maybe = _signs(d, lanes, load16(packet.rows, _FAR))
        if maybe & mask != 0:
            _keep_hits(tree, slot, rays, packet, sure, maybe & mask)


@kernel
def _trace_packet(tree, alive, rays, packet, waiting, counters):
    """Trace the rays in `alive` through the tree."""
    slabs = endless_slabs_of(rays_as_shafts(_origins(rays), rows(packet.rows, 0, 16)), alive)
    at = NearestTraversal(np.int64(0), alive, np.int64(0))
    at = next_block(tree, slabs, at, waiting, load16(packet.rows, _FAR), counters)
    while at.mask != 0:
        _trace_leaf(tree, at.link, at.mask, rays, packet, counters)
        at = next_block(tree, slabs, after_visit(at), waiting, load16(packet.rows, _FAR), counters)


@kernel
def _trace_primary_packets(ticket, arrays, rays, face, t, counters):
    """Worker: trace packets."""
    tree, totals, across = block_pointers(arrays), cleared(stack_i64(N_COUNTERS)), (rays.width + 3) // 4
    memory, ts, faces = stack_f32(_FLOATS), stack_f64(16), stack_i32(16)
    waiting = NearestStack(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    for n in items(ticket):
        packet = PrimaryPacket(memory, ts, faces, n % across * 4, n // across * 4)
        alive = _load(rays, packet)
        _trace_packet(tree, alive, rays, packet, waiting, totals)
        while alive != 0:
            lane = lowest_bit(alive)
            alive &= alive - 1
            x, y = _pixel(packet, lane)
            count(totals, RAYS, 1)
            put(ptr(face), y * rays.width + x, get(faces, lane))
            put(ptr(t), y * rays.width + x, get(ts, lane))
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
