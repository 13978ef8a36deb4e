"""Packing of receivers into leaves: in any order, by blocks of 4 x 4 pixels, or for lights too wide for one apex.

Blocks of pixels. Pixels adjacent on the screen are nearly always close on a surface, so most blocks make leaves as
tight as sorting each ray does, with a sixteenth of the keys to sort. Blocks that see several surfaces are cut into
groups: first by face of the cube around the apex, then at gaps wider than half of the rays' extent in u or v (a flat
surface has gaps of a third). Each group is a leaf, so some of its lanes are empty.

Wide lights. Adjacent pixels use different sample sets, sixteen in all. A leaf therefore has nearby receivers of one
set and a single sample, so that all its segments end at nearly the same point. Leaves follow a space-filling curve over
receivers and samples, which makes a node's shaft equally narrow at both ends.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import inlined, kernel
from ...kernels.parallel import CHUNK, items, new_ticket, run_short, shares
from ...kernels.simd import bits as bits_of
from ...kernels.simd import (
    broadcast16,
    gather,
    get,
    iota16,
    load16,
    lowest_bit,
    mask_from_bits16,
    minimum,
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
from ...query.shadow_query import ShadowQuery
from ...trace.counters import N_COUNTERS, add_counters, cleared
from .light_beams import (
    PARALLEL,
    PERSPECTIVE,
    Beam,
    ConeSamples,
    active_receivers,
    origins_of,
    query_bits_of,
    relative16,
    view_of,
)
from .ray_leaves import PAD, Empty, LeafCut, LeafRays, block_pointers, new_blocks, rays_in
from .receiver_order import Order, at_apex, cells_of, places_on, scale_of, sort_cells

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


# --- Blocks of 4 x 4 pixels as leaves ---------------------------------------------------------------------------------

GROUPS = 8  # groups per block, at most; there are six faces
_PART = 256  # blocks per work item
_ROOM = _PART * GROUPS + PAD
_INF = np.float32(np.inf)
_HALF = np.float32(0.5)


class BlockGroups(NamedTuple):
    """Groups of lanes in blocks. The groups of part i start at i _ROOM."""

    cells: np.ndarray  # (parts _ROOM,) int32: the cell of each group
    lanes: np.ndarray  # (parts _ROOM,) int32: bits of its lanes
    blocks: np.ndarray  # (parts _ROOM,) int32: its block


@inlined
def _extent(x, lanes):
    """(lowest, highest) value of some lanes (bits)."""
    mask = mask_from_bits16(lanes)
    return reduce_min(select(mask, x, _INF)), reduce_max(select(mask, x, -_INF))


@inlined
def _beyond_gap(x, lanes, extent):
    """Bits of the lanes beyond a gap wider than half of the extent, which contains its middle; 0: no gap."""
    beyond = bits_of(x > (extent[0] + extent[1]) * _HALF) & lanes
    gap = _extent(x, beyond)[0] - _extent(x, lanes & ~beyond)[1]
    return beyond if gap > (extent[1] - extent[0]) * _HALF else 0


@kernel
def _cut(face, places, lanes, full, centre):
    """Bits of the lanes to cut off a group. If none, write the group's centre (u, v) and return 0.

    full : cut by face only
    """
    others = lanes & ~bits_of(load16(face, 0) == np.int32(get(face, lowest_bit(lanes))))
    if others != 0:
        return others
    u, v = _extent(load16(places, 0), lanes), _extent(load16(places, 16), lanes)
    if not full and lanes & (lanes - 1) != 0:
        along_u = u[1] - u[0] > v[1] - v[0]
        others = _beyond_gap(load16(places, 0 if along_u else 16), lanes, u if along_u else v)
    if others == 0:
        put(centre, 0, (u[0] + u[1]) * _HALF)
        put(centre, 16, (v[0] + v[1]) * _HALF)
    return others


@kernel
def _groups(face, places, lanes, groups, centres):
    """Cut a block's lanes into groups. Write each group's bits, face and centre (u, v); return the number of groups.

    face : pointer to 16 int32; places: to 32 float32, u and v; groups: to 32 int32, bits and faces
    """
    n, i = np.int64(lanes != 0), 0
    put(groups, 0, lanes)
    while i < n:
        group = get(groups, i)
        apart = _cut(face, places, group, n > GROUPS - 6, ptr_at(centres, i))
        if apart != 0:
            put(groups, i, group & ~apart)
            put(groups, n, apart)
            n += 1
        else:
            put(groups, 16 + i, get(face, lowest_bit(group)))
            i += 1
    return n


@inlined
def _block_ids(block, w, h, ids):
    """Write the ids of a block's receivers; return bits of the receivers inside the image."""
    columns = (w + 3) >> 2
    y, x = (block // columns * 4) + (iota16() >> 2), (block % columns * 4) + (iota16() & 3)
    store(ids, 0, minimum(y, np.int32(h - 1)) * np.int32(w) + minimum(x, np.int32(w - 1)))
    return bits_of((x < np.int32(w)) & (y < np.int32(h)))


@inlined
def _keep(query_bits, blocks, block, ids, o, active):
    """Write a block's active receivers. The other lanes repeat the position of one of them."""
    there, one, of = mask_from_bits16(active), lowest_bit(active) & 15, load16(ids, 0)
    store(blocks.ids, 16 * block, select(there, of, np.int32(-1)))
    store(blocks.own, 16 * block, gather(query_bits.query.faces, of))
    for k in range(3):
        at = 16 * (3 * block + k)
        store(blocks.origins, at, o[k])
        store(blocks.origins, at, select(there, o[k], broadcast16(blocks.origins, at + one)))


@kernel
def _write_groups(ticket, query, beam, scale, bits, arrays, block_groups, counts, tally):
    """Worker: write each block's receivers and its groups (`BlockGroups`)."""
    query_bits, view = query_bits_of(query, bits), view_of(beam)
    samples = ConeSamples(beam.first, beam.n_samples, beam.set)
    h, w = query.sides.shape
    ids, face, groups, places, centres = stack_i32(16), stack_i32(16), stack_i32(32), stack_f32(32), stack_f32(32)
    last, blocks = stack_i64(2), block_pointers(arrays)
    out = BlockGroups(ptr(block_groups.cells), ptr(block_groups.lanes), ptr(block_groups.blocks))
    thread_counters = cleared(stack_i64(N_COUNTERS))
    for k in range(0, 32, 16):  # unused lanes are computed too; denormal numbers in them would be slow
        store(centres, k, splat16(_HALF))
    put(last, 0, -1)
    for first, end in shares(ticket):
        part, total = first // ticket[CHUNK], 0
        for block in range(first, end):
            there = _block_ids(np.int32(block), w, h, ids)
            o = origins_of(query_bits, load16(ids, 0))
            d = relative16(view, o)
            active = active_receivers(query_bits, view, samples, ids, there, last, thread_counters) & ~at_apex(view, d)
            _keep(query_bits, blocks, block, ids, o, active)
            faces, u, v = places_on(view, scale, d)
            store(face, 0, faces)
            store(places, 0, u)
            store(places, 16, v)
            n = _groups(face, places, active, groups, centres)
            at = part * _ROOM + total
            store(out.cells, at, cells_of(load16(groups, 16), load16(centres, 0), load16(centres, 16)))
            store(out.lanes, at, load16(groups, 0))
            store(out.blocks, at, splat16(np.int32(block)))
            total += n
        counts[part] = total
    add_counters(tally, thread_counters)


def rays_by_blocks(
    query: ShadowQuery,
    beam: Beam,
    bits: NDArray[np.uint64],
    threads: int,
    tally: NDArray[np.int64] | None = None,
    empty: Empty = np.empty,
) -> LeafRays:
    """Make the `LeafRays` of an image's active receivers, selected as in `order_of`."""
    h, w = query.sides.shape
    n = -(-h // 4) * -(-w // 4)
    blocks = new_blocks(n, 16, empty)
    parts, ticket = -(-n // _PART), new_ticket(n, _PART)
    block_groups, counts = BlockGroups(*(empty(parts * _ROOM, np.int32) for _ in range(3))), np.zeros(parts, np.int64)
    run_short(_write_groups, threads, ticket, query, beam, scale_of(beam), bits, blocks, block_groups, counts, tally)
    gaps = np.arange(parts) * _ROOM - (np.cumsum(counts) - counts)
    at = np.arange(counts.sum(), dtype=np.int32) + np.repeat(gaps.astype(np.int32), counts)
    cells = np.zeros(len(at) + PAD, np.int32)
    np.take(block_groups.cells, at, out=cells[: len(at)])
    order = sort_cells(cells, at, threads)
    cut = LeafCut(block_groups.blocks[order.ids], block_groups.lanes[order.ids], order.starts, order.faces, True)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)


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
