"""Packets of 16 primary rays: the baseline of the primary rows of Table 1 [Benthin and Wald 2009, Sec. 5.1].

A packet holds the rays of 4 x 4 pixels. It goes down the builder's own deep tree, the nearer child first. Each ray goes
only as far as its nearest hit so far. Triangles are tested one by one, each against the 16 rays. Float32 leaves out
what surely misses. Float64 computes the t of hits, and the contract's predicate decides the rest. So the hits are those
of `trace.primary.primary_rays.trace_primary`, bit for bit.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.blocks import BlockTree, block_pointers, block_tree
from ...bvh.links import block_leaf, slot_at
from ...kernels.fields import F32Ptr, F64Ptr, I32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.predicate.filters import is_nearer, meets
from ...kernels.simd import (
    absolute,
    bits,
    get,
    load16,
    lowest_bit,
    maximum,
    minimum,
    ptr,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
)
from ...kernels.vec import Vec, dot, rows
from ...query.gbuffer import pixel_direction, pixel_ray
from ...query.raster_setup import eye_plane, plane_t
from ...scene.camera import CameraRays
from ...trace.counters import (
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
from ...trace.descent import (
    GROW,
    WAITING_FLOATS,
    WAITING_INTS,
    Near,
    Waiting,
    endless_slabs_of,
    next_block,
    rays_as_shafts,
    visited,
)
from ...trace.triangle_tests import length1, seen_from, triangle_in

_F = np.float32
_FAR = 48
_FLOATS = 64
_BEYOND = GROW * GROW  # once for rounding t, once as exits grow


class Packet(NamedTuple):
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
    return Vec(splat16(o[0]), splat16(o[1]), splat16(o[2]))


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
def _trace_packets(ticket, arrays, rays, face, t, counters):
    """Worker: trace packets."""
    tree, mine, across = block_pointers(arrays), cleared(stack_i64(N_COUNTERS)), (rays.width + 3) // 4
    memory, ts, faces = stack_f32(_FLOATS), stack_f64(16), stack_i32(16)
    waiting = Waiting(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    for n in items(ticket):
        packet = Packet(memory, ts, faces, n % across * 4, n // across * 4)
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
    run(_trace_packets, thread_count(threads), ticket, tree, rays, face, t, counters)
    return face, t
