"""Packing of receivers into leaves: in any order, or for lights too wide for one apex. `pixel_blocks` packs pictures.

Wide lights. Adjacent pixels use different sample sets, sixteen in all. A leaf therefore has nearby receivers of one
set and a single sample, so that all its segments end at nearly the same point. Leaves follow a space-filling curve over
receivers and samples, which makes a node's shaft equally narrow at both ends.
"""

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run_short
from ...kernels.simd import bits as bits_of
from ...kernels.simd import (
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
from ...query.shadow_query import ShadowQuery
from .light_beams import PARALLEL, PERSPECTIVE, Beam, origins_of, query_bits_of
from .ray_leaves import Empty, LeafCut, LeafRays, block_pointers, new_blocks, rays_in
from .receiver_order import Order

# --- Leaves of receivers in any order, and removal of finished receivers ----------------------------------------------


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
def _fill_block(query_bits, ids, lanes, blocks, block):
    """Write a block's receivers. The set bits of `lanes` are receivers; the other lanes repeat one of them."""
    ways, at = blocks.ways, block * blocks.ways
    integers, floats = stack_i32(16), stack_f32(16)
    mask, some_id = mask_from_bits16(lanes), np.int32(get(ids, lowest_bit(lanes)) if lanes != 0 else 0)
    there = select(mask, load16(ids, 0), some_id)
    o = origins_of(query_bits, there)
    _put_lanes(blocks.ids, at, ways, select(mask, there, np.int32(-1)), integers)
    _put_lanes(blocks.own, at, ways, gather(query_bits.query.faces, there), integers)
    _put_lanes(blocks.origins, 3 * at, ways, o.x, floats)
    _put_lanes(blocks.origins, 3 * at + ways, ways, o.y, floats)
    _put_lanes(blocks.origins, 3 * at + 2 * ways, ways, o.z, floats)


@kernel
def _fill(ticket, query, order, starts, bits, arrays, lanes_of):
    """Worker: fill blocks with consecutive receivers of the order; starts: each face's first block."""
    query_bits, part, places = query_bits_of(query, bits), 0, stack_i32(16)
    blocks, ways = block_pointers(arrays), np.int64(arrays.ways)
    for block in items(ticket):
        part = part if starts[part] <= block else 0
        while starts[part + 1] <= block:
            part += 1
        at = order.starts[part] + (block - starts[part]) * ways
        n, ids = min(ways, order.starts[part + 1] - at), ptr_at(order.ids, at)
        if at + 16 > len(order.ids):  # a load of 16 would read beyond the end
            for lane in range(n):
                put(places, lane, get(ids, lane))
            ids = places
        lanes = bits_of(load16(ids, 0) >= np.int32(0)) & (1 << n) - 1
        put(lanes_of, block, lanes)
        _fill_block(query_bits, ids, lanes, blocks, block)


def rays_of(
    query: ShadowQuery,
    beam: Beam,
    order: Order,
    ways: int,
    bits: NDArray[np.uint64],
    threads: int,
    empty: Empty = np.empty,
) -> LeafRays:
    """Make the `LeafRays` of the receivers in an order; no leaf has receivers of two faces."""
    starts = np.append(0, np.cumsum(-(-np.diff(order.starts) // ways)))
    n = int(starts[-1])
    blocks = new_blocks(n, ways, empty)
    lanes = np.empty(n, np.int32)
    run_short(_fill, threads, new_ticket(n, 256), query, order, starts, bits, blocks, lanes)
    cut = LeafCut(np.arange(n, dtype=np.int32), lanes, starts, order.faces, order.placed)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)


def unfinished_rays(
    query: ShadowQuery, beam: Beam, rays: LeafRays, bits: NDArray[np.uint64], threads: int, empty: Empty = np.empty
) -> LeafRays:
    """Make the `LeafRays` of the unfinished receivers after a traversal [Olsson and Assarsson 2011, Sec. 3.4].

    If leaves are `placed`, finished leaves become empty. Otherwise the unfinished receivers are packed without gaps.
    """
    lanes = rays.lanes & ~np.bitwise_and.reduce(rays.dead, 1)
    if rays.placed:
        return rays._replace(lanes=lanes)
    unfinished = (lanes[:, None] >> np.arange(rays.ways) & 1).astype(bool)
    counts = np.add.reduceat(unfinished.sum(1), rays.starts[:-1]) if len(unfinished) else np.zeros(0, np.int64)
    starts = np.append(0, np.cumsum(counts)).astype(np.int64)
    some = np.flatnonzero(counts)
    ids = rays.ids[: unfinished.size].reshape(unfinished.shape)[rays.blocks]
    order = Order(ids[unfinished], np.append(starts[some], starts[-1]), rays.faces[some], False)
    return rays_of(query, beam, order, rays.ways, bits, threads, empty)


# --- Leaves of shafts, for lights too wide for one apex ---------------------------------------------------------------

_BITS = 10  # per coordinate of the receivers' Morton codes


def receivers_of(
    query: ShadowQuery, beam: Beam, rays: LeafRays, bits: NDArray[np.uint64], threads: int, empty: Empty
) -> LeafRays:
    """Make the `LeafRays` of the unfinished receivers: each leaf has sixteen nearby receivers of one sample set."""
    w = query.sides.shape[1]
    unfinished = (rays.lanes & ~np.bitwise_and.reduce(rays.dead, 1))[:, None] >> np.arange(rays.ways) & 1
    places = rays.blocks[:, None] * rays.ways + np.arange(rays.ways)
    ids = rays.ids[places[unfinished.astype(bool)]]
    sets = (ids % w & 3) + 4 * (ids // w & 3)
    key = sets.astype(np.int64) << 3 * _BITS | _morton(query.origins.reshape(-1, 3)[ids], _BITS)
    order = np.argsort(key, kind="stable")
    counts = np.bincount(sets, minlength=1)
    some = np.flatnonzero(counts)
    starts = np.append(0, np.cumsum(counts[some])).astype(np.int64)
    return rays_of(query, beam, Order(ids[order], starts, some, False), 16, bits, threads, empty)


def shafts_of(query: ShadowQuery, beam: Beam, rays: LeafRays) -> tuple[LeafRays, NDArray[np.int64]]:
    """(leaves of one sample each, their indices in the flat `dead` of the rays from `receivers_of`)."""
    live = rays.lanes[:, None] & ~rays.dead  # leaf, sample
    leaf, sample = np.nonzero(live)
    sets = np.repeat(rays.faces, np.diff(rays.starts))
    spread = query.samples[:, beam.first : beam.first + beam.n_samples, :2]
    at = _rank(_morton(spread.reshape(-1, 2), 16)).reshape(spread.shape[:2])[sets[leaf], sample]
    points = rays.origins[: 48 * len(rays.blocks)].reshape(-1, 3, 16)[rays.blocks, :, _first_lane(rays.lanes)]
    size = float(np.ptp(points.astype(np.float64), axis=0).max()) if len(points) else 0.0
    key = _interleaved_keys(
        _rank(_morton(points, 16))[leaf], at, len(points), at.max(initial=0) + 1, size, _width(beam, size)
    )
    order = np.argsort(key, kind="stable")
    leaf, sample = leaf[order].astype(np.int32), sample[order].astype(np.int32)
    dead = rays.dead[leaf, sample][:, None]
    shafts = rays._replace(
        blocks=rays.blocks[leaf], lanes=rays.lanes[leaf] & ~dead[:, 0], dead=dead, n_samples=1, samples=sample,
        starts=np.array([0, len(leaf)]), faces=np.zeros(1, np.int64),
    )  # fmt: skip
    return shafts, leaf.astype(np.int64) * rays.n_samples + sample


def _first_lane(lanes: NDArray[np.int32]) -> NDArray[np.uint8]:
    lane: NDArray[np.uint8] = np.bitwise_count((lanes & -lanes) - 1) & 15
    return lane


def _width(beam: Beam, size: float) -> float:
    """The width of the light as seen from receivers of extent `size`."""
    if beam.kind == PERSPECTIVE:
        return 2.0 * beam.radius / beam.unit
    if beam.kind == PARALLEL:
        return 2.0 * beam.radius * size
    return 2.0 * min(beam.radius / beam.unit, size)


def _morton(points: NDArray[np.float32] | NDArray[np.float64], bits: int) -> NDArray[np.int64]:
    """(n,) int64: Morton codes of (n, d) points, with cubic cells and `bits` bits per coordinate."""
    points = points.astype(np.float64)
    low = points.min(0, initial=np.inf)
    side = max(float((points - low).max(initial=0.0)), 1e-300)
    cells = np.minimum((points - low) / side * 2**bits, 2**bits - 1).astype(np.int64)
    code, d = np.zeros(len(points), np.int64), points.shape[1]
    for k in range(bits):
        for axis in range(d):
            code |= (cells[:, axis] >> k & 1) << d * k + axis
    return code


def _rank(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The rank of each code."""
    rank = np.empty(len(codes), np.int64)
    rank[np.argsort(codes, kind="stable")] = np.arange(len(codes))
    return rank


def _interleaved_keys(
    a: NDArray[np.int64], b: NDArray[np.int64], n: int, m: int, size: float, width: float
) -> NDArray[np.int64]:
    """Sorting keys that interleave the bits of receivers a < n and samples b < m, highest first.

    Each bit is taken from the wider of the receivers, of extent `size`, and the light, of extent `width`. A bit halves
    an area, so two bits halve a width.
    """
    key, bits_a, bits_b = np.zeros(len(a), np.int64), max(n - 1, 0).bit_length(), int(m - 1).bit_length()
    while bits_a or bits_b:
        if bits_b == 0 or (bits_a and size >= width):
            bits_a, size = bits_a - 1, size * 0.5**0.5
            key = key << 1 | (a >> bits_a & 1)
        else:
            bits_b, width = bits_b - 1, width * 0.5**0.5
            key = key << 1 | (b >> bits_b & 1)
    return key
