"""Leaves of receivers in any order, each with its own block, and removal of finished receivers after a traversal."""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import bits as bits_of
from ..kernels.simd import (
    gather,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    ptr_at,
    put,
    select,
    stack_f32,
    stack_i32,
    store,
)
from .asking import asking_of, origins_of
from .beams import Beam
from .memory import Empty
from .order import Order
from .rays import LeafCut, LeafRays, block_pointers, new_blocks, rays_in


@inlined
def _put_lanes(p, at, ways, v, scratch):
    """Write the lanes of a block: 4 or 16."""
    if ways == 16:
        store(p, at, v)
        return
    store(scratch, 0, v)
    for lane in range(ways):
        put(p, at + lane, get(scratch, lane))


@kernel
def _fill_block(asking, ids, lanes, blocks, block):
    """Write a block's receivers. The set bits of `lanes` are receivers; the other lanes repeat one of them."""
    ways, at = blocks.ways, block * blocks.ways
    whole, floats = stack_i32(16), stack_f32(16)
    mask, anyone = mask_from_bits16(lanes), np.int32(get(ids, lowest_bit(lanes)) if lanes != 0 else 0)
    there = select(mask, load16(ids, 0), anyone)
    o = origins_of(asking, there)
    _put_lanes(blocks.ids, at, ways, select(mask, there, np.int32(-1)), whole)
    _put_lanes(blocks.own, at, ways, gather(asking.query.faces, there), whole)
    _put_lanes(blocks.origins, 3 * at, ways, o.x, floats)
    _put_lanes(blocks.origins, 3 * at + ways, ways, o.y, floats)
    _put_lanes(blocks.origins, 3 * at + 2 * ways, ways, o.z, floats)


@kernel
def _fill(ticket, query, order, starts, bits, arrays, lanes_of):
    """Worker: fill blocks with consecutive receivers of the order; starts: each face's first block."""
    asking, part, places = asking_of(query, bits), np.int64(0), stack_i32(16)
    blocks, ways = block_pointers(arrays), np.int64(arrays.ways)
    for block in items(ticket):
        part = part if starts[part] <= block else np.int64(0)
        while starts[part + 1] <= block:
            part += 1
        at = order.starts[part] + (block - starts[part]) * ways
        n, ids = min(ways, order.starts[part + 1] - at), ptr_at(order.ids, at)
        if at + 16 > len(order.ids):  # a load of 16 would read beyond the end
            for lane in range(n):
                put(places, lane, get(ids, lane))
            ids = places
        lanes = bits_of(load16(ids, 0) >= np.int32(0)) & (np.int64(1) << n) - 1
        put(lanes_of, block, lanes)
        _fill_block(asking, ids, lanes, blocks, block)


def rays_of(
    query, beam: Beam, order: Order, ways: int, bits: np.ndarray, threads: int, empty: Empty = np.empty
) -> LeafRays:
    """Make the `LeafRays` of the receivers in an order; no leaf has receivers of two faces."""
    starts = np.append(0, np.cumsum(-(-np.diff(order.starts) // ways)))
    n = int(starts[-1])
    blocks = new_blocks(n, ways, empty)
    lanes = np.empty(n, np.int32)
    run(_fill, threads, new_ticket(n, 256), query, order, starts, bits, blocks, lanes)
    cut = LeafCut(np.arange(n, dtype=np.int32), lanes, starts, order.faces, order.placed)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)


def left_of(query, beam: Beam, rays: LeafRays, bits: np.ndarray, threads: int, empty: Empty = np.empty) -> LeafRays:
    """Make the `LeafRays` of the unfinished receivers after a traversal [Olsson and Assarsson 2011, Sec. 3.4].

    If leaves are `placed`, finished leaves become empty. Otherwise the unfinished receivers are packed without gaps.
    """
    lanes = rays.lanes & ~np.bitwise_and.reduce(rays.dead, 1)
    if rays.placed:
        return rays._replace(lanes=lanes)
    left = (lanes[:, None] >> np.arange(rays.ways) & 1).astype(bool)
    counts = np.add.reduceat(left.sum(1), rays.starts[:-1]) if len(left) else np.zeros(0, np.int64)
    starts = np.append(0, np.cumsum(counts)).astype(np.int64)
    some = np.flatnonzero(counts)
    ids = rays.ids[: left.size].reshape(left.shape)[rays.blocks]
    order = Order(ids[left], np.append(starts[some], starts[-1]), rays.faces[some], False)
    return rays_of(query, beam, order, rays.ways, bits, threads, empty)
