"""`packet256`: 16 packets of 16 shadow rays through the shallow tree [Benthin and Wald 2009, Sec. 5.2].

At each node, the rays of every active packet are tested against both children, which gives two new packet masks. The
child that more rays enter first is traversed first. The tree, corner culling and the ray tests at leaves are those of
`multifrusta:paper`; only the traversal differs. A packet holds one receiver's rays to its samples.
"""

from typing import Any

import numpy as np

from ....bvh.block_tree import BlockTree, block_pointers
from ....bvh.nodes import box_at
from ....kernels.jit import inlined, kernel
from ....kernels.parallel import items
from ....kernels.simd import (
    bits,
    get,
    load16,
    lowest_bit,
    ptr,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_i32,
    stack_i64,
    store,
)
from ....query.shadow_query import ShadowQuery
from ....trace.counters import (
    BOX_TESTS,
    N_COUNTERS,
    NODES,
    add_counters,
    cleared,
    count,
)
from ....trace.descent import (
    Bound,
    Mixed,
    Uniform,
    after_leaf,
    load_saved,
    pop_node,
    rays_as_shafts,
    root,
    save,
    slabs_of,
    span_mixed,
    span_uniform,
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
from ....trace.triangle_tests import DEFERRED
from .published_frusta import FRUSTA_FLOATS, WORK, entered_nearer, make_frusta, open_frusta, prefers_right, trace_block

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
