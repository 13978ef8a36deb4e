"""Packets that multi-frusta tracing is compared with [Benthin and Wald 2009, Sec. 5.1 and 5.2].

`packet256` traces 16 packets of 16 shadow rays together through the shallow tree. Packets of 16 primary rays are the
baseline of the primary rows of Table 1.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.block_tree import BlockTree, block_pointers, block_tree
from ...bvh.nodes import block_leaf, box_at, slot_at
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
    Near,
    Uniform,
    Waiting,
    endless_slabs_of,
    left,
    next_block,
    popped,
    rays_as_shafts,
    root,
    save,
    saved,
    slabs_of,
    span_mixed,
    span_uniform,
    visited,
)
from ...trace.packets.ray_tile import (
    SCRATCH_FLOATS,
    SCRATCH_INTS,
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
from ...trace.triangle_tests import DEFERRED, length1, seen_from, triangle_in
from .published_frusta import FRUSTA_FLOATS, WORK, entered_nearer, make_frusta, open_frusta, prefers_right, trace_block

# ---------------------------------------------------------------------------------------------------------------------
# `packet256`: traces 16 packets of 16 shadow rays together through the shallow tree [Benthin and Wald 2009, Sec.
# 5.2].
#
# At each node, the rays of every active packet are tested against both children. This gives two new masks of packets.
# The
# child that more rays enter first comes first. The tree, corner culling and the ray tests at leaves are those of
# `multifrusta:paper`; only the traversal differs. A packet holds one receiver's rays to its samples.


_PACKET = 24 * 16  # float32 words of a packet: r and k of its slab bounds
_WAYS = 4  # int32 words of a packet: whether all rays have the same signs, and the near plane of each axis
_ALL_PACKETS, _ALL_WAYS = 16 * _PACKET, 16 * _WAYS


@inlined
def _keep_bounds(packet, at, bounds):
    for k in range(len(bounds)):
        store(packet, at + 32 * k, bounds[k].r)
        store(packet, at + 32 * k + 16, bounds[k].k)


@inlined
def _bound(packet, at):
    return Bound(load16(packet, at), load16(packet, at + 16))


@inlined
def _uniform(packet, ways, axis):
    plane = np.int64(get(ways, 1 + axis))
    return Uniform(_bound(packet, 64 * axis), _bound(packet, 64 * axis + 32), plane, 2 - plane)


@inlined
def _mixed(packet, axis):
    at = 128 * axis
    return Mixed(_bound(packet, at), _bound(packet, at + 32), _bound(packet, at + 64), _bound(packet, at + 96))


@kernel
def _prepare_packet(rays, r, packet, ways):
    """Store the constants of the slab tests of packet r."""
    s = slabs_of(rays_as_shafts(origins_of(rays, r), directions_of(rays, r)), open_rays(rays, r))
    put(ways, 0, 1 if s.uniform else 0)
    if s.uniform:
        put(ways, 1, s.ux.near_plane)
        put(ways, 2, s.uy.near_plane)
        put(ways, 3, s.uz.near_plane)
        _keep_bounds(packet, 0, (s.ux.near, s.ux.far, s.uy.near, s.uy.far, s.uz.near, s.uz.far))
    else:
        _keep_bounds(packet, 0, s.mx)
        _keep_bounds(packet, 128, s.my)
        _keep_bounds(packet, 256, s.mz)


@kernel
def _prepare(rays, alive, packets, ways):
    while alive != 0:
        r = lowest_bit(alive)
        alive &= alive - 1
        _prepare_packet(rays, r, ptr_at(packets, r * _PACKET), ptr_at(ways, r * _WAYS))


@inlined
def _entry(nodes, at, packet, ways):
    """(bits of a packet's rays that meet a box, the entry t of each ray). at: index in `nodes` of the box's lower x."""
    end = splat16(np.float32(1.0))
    if get(ways, 0) != 0:
        x, y, z = _uniform(packet, ways, 0), _uniform(packet, ways, 1), _uniform(packet, ways, 2)
        near, far = span_uniform(nodes, at, x, y, z, end)
    else:
        near, far = span_mixed(nodes, at, _mixed(packet, 0), _mixed(packet, 1), _mixed(packet, 2), end)
    return bits(near <= far), near


@inlined
def _packets_in(tree, at, rays, packets, ways, counters):
    """(left, right, turn): bits of the packets with an unblocked ray that meets each child's box; right child first?"""
    waiting, in_left, in_right, votes = at.mask, np.int64(0), np.int64(0), np.int64(0)
    count(counters, NODES, 1)
    while waiting != 0:
        r = lowest_bit(waiting)
        waiting &= waiting - 1
        count(counters, BOX_TESTS, 2)
        packet, way, alive = ptr_at(packets, r * _PACKET), ptr_at(ways, r * _WAYS), open_rays(rays, r)
        a, near_a = _entry(tree.nodes, box_at(at.link, 0), packet, way)
        b, near_b = _entry(tree.nodes, box_at(at.link, 1), packet, way)
        if a & alive != 0:
            in_left |= np.int64(1) << r
        if b & alive != 0:
            in_right |= np.int64(1) << r
        votes += prefers_right(near_a, near_b, a & b & alive)
    return in_left, in_right, votes > 0


@kernel
def _walk(tree, rays, frusta, packets, ways, facing, work, scratch, counters):
    """Continue the traversal. Return whether it must go on after deferred tests are settled."""
    alive = open_frusta(rays)
    at = popped(tree.links, saved(scratch.at, alive), scratch.stack, alive)
    while at.mask != 0:
        if at.link >= 0:
            in_left, in_right, turn = _packets_in(tree, at, rays, packets, ways, counters)
            at = entered_nearer(tree.links, at, in_left, in_right, turn, scratch.stack)
        else:
            if np.int64(get(scratch.deferred, 0)) > DEFERRED:
                save(scratch.at, at)
                return True
            leaf = trace_block(tree, at.link, at.mask, rays, frusta, facing, work, scratch.deferred, counters)
            alive &= ~leaf.done
            at = left(at)
        at = popped(tree.links, at, scratch.stack, alive)
    return False


@kernel
def _trace_packets(ticket, arrays, query, samples, job, out, counters):
    """Worker: trace tiles."""
    scratch = scratch_in(stack_f32(SCRATCH_FLOATS), stack_i32(SCRATCH_INTS))
    own, work = stack_f32(FRUSTA_FLOATS), stack_f32(WORK)
    packets, ways = stack_f32(_ALL_PACKETS), stack_i32(_ALL_WAYS)
    tree, mine = block_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    for n in items(ticket):
        rays = start_tile(job, chunk, n, scratch, places, mine)
        frusta, alive = make_frusta(chunk, samples, job, rays, own), open_frusta(rays)
        _prepare(rays, alive, packets, ways)
        save(scratch.at, root(alive))
        while _walk(tree, rays, frusta, packets, ways, chunk.query.facing, work, scratch, mine):
            settle(tree, chunk, rays, scratch, mine)
        settle(tree, chunk, rays, scratch, mine)
        finish_tile(chunk, rays, places)
    add_counters(counters, mine)


def trace_shadow(tree, query, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    tree : BlockTree
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_tiles(_trace_packets, tree, query, True, bits, threads, counters, progress)


# --- Packets of 16 primary rays: the baseline of the primary rows of Table 1 [Benthin and Wald 2009, Sec. 5.1] --------
#
# A packet holds the rays of 4 x 4 pixels. It goes down the builder's own deep tree, the nearer child first. Each ray
# goes only as far as its nearest hit so far. Triangles are tested one by one, each against the 16 rays. Float32 leaves
# out what surely misses. Float64 computes the t of hits, and the contract's predicate decides the rest. So the hits
# are those of `trace.primary.primary_rays.trace_primary`, bit for bit.


_F = np.float32
_FAR = 48
_FLOATS = 64
_BEYOND = GROW * GROW  # once for rounding t, once as exits grow


class PrimaryPacket(NamedTuple):
    """The rays of 4 x 4 pixels and their nearest hits so far, as pointers to memory of 16 lanes."""

    rows: F32Ptr  # float32, 4 rows: directions x, y, z; t beyond which nothing is nearer
    t: F64Ptr  # float64, inf: no hit
    face: I32Ptr  # int32, -1: no hit
    x0: int  # first pixel
    y0: int


@inlined
def _pixel(packet, lane):
    return packet.x0 + (lane & 3), packet.y0 + (lane >> 2)


@kernel
def _load(rays, packet):
    """Write the rays of a packet. Return bits of its rays; the others repeat the first."""
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
    """(bits of the rays that surely meet a triangle's line of sight, bits of those that may be nearer than `far`)."""
    # Eq. (7) of docs/design/exactness.md, for rays without an end
    e2, e1, dn = dot(d, lanes.cp), dot(d, lanes.qc), dot(d, lanes.n)
    e0, t, e, te = dn - e1 - e2, lanes.t, lanes.e, lanes.te
    low, high = minimum(minimum(e0, e1), e2), maximum(maximum(e0, e1), e2)
    up, down, above, below = low > e, high < -e, t > te, t < -te
    missed = ((low < -e) & (high > e)) | (up & below) | (down & above)
    beyond = absolute(t) - te > (absolute(dn) + te + te) * far
    return bits((up & above) | (down & below)), bits(missed | beyond) ^ 0xFFFF


@kernel
def _keep_hits(tree, slot, rays, packet, sure, maybe):
    """Keep a triangle for those rays in `maybe` (bits) that it is nearest to; those in `sure` meet it."""
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
        slot = np.int64(get(tree.slots, slot_at(leaf.block, i)))
        count(counters, TRIANGLES, 1)
        count(counters, CANDIDATES, 1)
        count(counters, TRIANGLE_TESTS, 1)
        lanes = seen_from(o, span, triangle_in(tree.corners, slot))
        sure, maybe = _signs(d, lanes, load16(packet.rows, _FAR))
        if maybe & mask != 0:
            _keep_hits(tree, slot, rays, packet, sure, maybe & mask)


@kernel
def _trace_packet(tree, alive, rays, packet, waiting, counters):
    """Trace the rays in `alive` through the tree."""
    slabs = endless_slabs_of(rays_as_shafts(_origins(rays), rows(packet.rows, 0, 16)), alive)
    at = Near(np.int64(0), alive, np.int64(0))
    at = next_block(tree, slabs, at, waiting, load16(packet.rows, _FAR), counters)
    while at.mask != 0:
        _trace_leaf(tree, at.link, at.mask, rays, packet, counters)
        at = next_block(tree, slabs, visited(at), waiting, load16(packet.rows, _FAR), counters)


@kernel
def _trace_primary_packets(ticket, arrays, rays, face, t, counters):
    """Worker: trace packets."""
    tree, mine, across = block_pointers(arrays), cleared(stack_i64(N_COUNTERS)), (rays.width + 3) // 4
    memory, ts, faces = stack_f32(_FLOATS), stack_f64(16), stack_i32(16)
    waiting = Waiting(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    for n in items(ticket):
        packet = PrimaryPacket(memory, ts, faces, n % across * 4, n // across * 4)
        alive = _load(rays, packet)
        _trace_packet(tree, alive, rays, packet, waiting, mine)
        while alive != 0:
            lane = lowest_bit(alive)
            alive &= alive - 1
            x, y = _pixel(packet, lane)
            count(mine, RAYS, 1)
            put(ptr(face), y * rays.width + x, get(faces, lane))
            put(ptr(t), y * rays.width + x, get(ts, lane))
    add_counters(counters, mine)


def deep_tree(bvh, threads=None) -> BlockTree:
    """The tree of a `Bvh`, with its own leaves as blocks."""
    return block_tree(bvh, threads, block=1)


def trace_packets(tree: BlockTree, rays: CameraRays, threads=None, counters=None) -> tuple[np.ndarray, np.ndarray]:
    """The nearest hits (face, t) of the pixel-centre rays, as `trace_primary` gives them."""
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    ticket = new_ticket(-(-rays.width // 4) * -(-rays.height // 4), 64)
    counters = new_counters() if counters is None else counters
    run(_trace_primary_packets, thread_count(threads), ticket, tree, rays, face, t, counters)
    return face, t
