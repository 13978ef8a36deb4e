"""Blocks of 4 x 4 pixels as leaves: sorted block by block, cut where their rays are far from each other.

Neighbours on the screen nearly always are neighbours on a surface, so most blocks make leaves as tight as sorting each
ray does, and only a sixteenth of the keys is left to sort. Blocks that see several surfaces are cut into groups: by the
face of the cube around the apex, then where the rays, sorted by u or v, leave a gap of more than half of their extent.
A leaf is a group, so some of its lanes are empty.
"""

import numpy as np

from ..jit import inlined, kernel
from ..parallel import CHUNK, N, new_ticket, run, take
from ..simd import bits as bits_of
from ..simd import (
    broadcast16,
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
    store,
)
from ..trace.counters import add_counters, private_counters
from .asking import Samples, asking_of, places_of, who_asks
from .beams import Beam
from .keys import cells_of
from .order import Order, at_apex, pack, places_on, scale_of, sort_cells
from .view import view_of

GROUPS = 8  # of a block, at most; there are six faces
_PART = 256  # blocks
_F = np.float32
_INF = np.float32(np.inf)
_GAP = np.float32(0.5)  # of the extent; rays from a flat surface have a third


@inlined
def _extent(x, lanes):
    """(lowest, highest) of some lanes."""
    mask = mask_from_bits16(lanes)
    return reduce_min(select(mask, x, _INF)), reduce_max(select(mask, x, -_INF))


@kernel
def _beyond_gap(p, lanes, extent):
    """Bits of the lanes above the widest gap between the numbers of `lanes` at p; 0 if it is not wide."""
    x, mask = load16(p, 0), mask_from_bits16(lanes)
    following, some = splat16(_INF), lanes
    while some != 0:
        other = broadcast16(p, lowest_bit(some))
        some &= some - 1
        following = select(other > x, minimum(following, other), following)
    gap = select(mask & (following < _INF), following - x, _F(0.0))
    widest = reduce_max(gap)
    if not widest > (extent[1] - extent[0]) * _GAP:
        return np.int64(0)
    edge = broadcast16(p, lowest_bit(bits_of(gap == widest)))
    return bits_of(x > edge) & lanes


@kernel
def _cut(face, places, lanes, full, centre):
    """Bits of the lanes that should part from the others of a group; 0: none, and then its centre (u, v) is written.

    full : only faces may part them
    """
    others = lanes & ~bits_of(load16(face, 0) == np.int32(get(face, lowest_bit(lanes))))
    if others != 0:
        return others
    u, v = _extent(load16(places, 0), lanes), _extent(load16(places, 16), lanes)
    if not full and lanes & (lanes - 1) != 0:
        along_u = u[1] - u[0] > v[1] - v[0]
        others = _beyond_gap(places if along_u else ptr_at(places, 16), lanes, u if along_u else v)
    if others == 0:
        put(centre, 0, (u[0] + u[1]) * _F(0.5))
        put(centre, 16, (v[0] + v[1]) * _F(0.5))
    return others


@kernel
def _groups(face, places, lanes, groups, centres):
    """Write bits of each group of a block's lanes, its face, and u and v of its centre; how many there are.

    face : pointer to 16 int32; places: to 32 float32, u and v; groups: to 32 int32, bits and faces
    """
    n, i = np.int64(lanes != 0), np.int64(0)
    put(groups, 0, lanes)
    while i < n:
        group = np.int64(get(groups, i))
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
    """Write which receivers a block has; bits of those within the picture."""
    columns = (w + 3) >> 2
    y, x = (block // columns * 4) + (iota16() >> 2), (block % columns * 4) + (iota16() & 3)
    store(ids, 0, minimum(y, np.int32(h - 1)) * np.int32(w) + minimum(x, np.int32(w - 1)))
    return bits_of((x < np.int32(w)) & (y < np.int32(h)))


@kernel
def _write_groups(ticket, query, beam, scale, bits, cells, lanes_of, counts, tally):
    """Worker: the cell and the lanes of each group of each block; cells are -1 where there is none."""
    asking, view, samples = asking_of(query, bits), view_of(beam), Samples(beam.first, beam.count, beam.set)
    h, w = query.sides.shape
    ids, face, groups, places, centres = stack_i32(16), stack_i32(16), stack_i32(32), stack_f32(32), stack_f32(32)
    out, out_lanes, mine = ptr(cells), ptr(lanes_of), private_counters(tally)
    first = take(ticket)
    while first >= 0:
        total = 0
        for block in range(first, min(first + ticket[CHUNK], ticket[N])):
            there = _block_ids(np.int32(block), w, h, ids)
            d = places_of(asking, view, ids)
            asks = who_asks(asking, view, samples, ids, there, mine) & ~at_apex(view, d)
            faces, u, v = places_on(view, scale, d)
            store(face, 0, faces)
            store(places, 0, u)
            store(places, 16, v)
            n = _groups(face, places, asks, groups, centres)
            cell = cells_of(load16(groups, 16), load16(centres, 0), load16(centres, 16))
            store(face, 0, select(iota16() < np.int32(n), cell, np.int32(-1)))
            for i in range(GROUPS):
                put(out, block * GROUPS + i, get(face, i))
                put(out_lanes, block * GROUPS + i, get(groups, i))
            total += n
        counts[first // ticket[CHUNK]] = total
        first = take(ticket)
    add_counters(tally, mine)


@kernel
def _expand(ticket, groups, lanes_of, w, h, ids):
    """Worker: the receivers of each leaf, -1 for lanes without one."""
    scratch, out = stack_i32(16), ptr(ids)
    first = take(ticket)
    while first >= 0:
        for leaf in range(first, min(first + ticket[CHUNK], ticket[N])):
            group = np.int64(groups[leaf])
            _block_ids(np.int32(group // GROUPS), w, h, scratch)
            store(out, 16 * leaf, select(mask_from_bits16(np.int64(lanes_of[group])), load16(scratch, 0), np.int32(-1)))
        first = take(ticket)


def order_by_blocks(query, beam: Beam, bits: np.ndarray, threads: int, tally=None) -> Order:
    """The `Order` of the receivers that ask a beam, as `order_of`; for leaves of 16 of a picture's pixels."""
    h, w = query.sides.shape
    blocks = -(-h // 4) * -(-w // 4)
    cells, lanes_of = np.empty(blocks * GROUPS, np.int32), np.empty(blocks * GROUPS, np.int32)
    counts = np.zeros(-(-blocks // _PART) + 1, np.int64)
    ticket = new_ticket(blocks, _PART)
    run(_write_groups, threads, ticket, query, beam, scale_of(beam), bits, cells, lanes_of, counts[1:], tally)
    order = sort_cells(*pack(cells, len(cells), _PART * GROUPS, counts, threads), threads)
    ids = np.empty(16 * len(order.ids), np.int32)
    run(_expand, threads, new_ticket(len(order.ids), 1024), order.ids, lanes_of, w, h, ids)
    return Order(ids, 16 * order.starts, order.faces, True)
