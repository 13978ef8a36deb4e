"""Blocks of 4 x 4 pixels as leaves: sorted block by block, and cut where their rays are far apart.

Neighbours on the screen are nearly always neighbours on a surface. So most blocks make leaves as tight as sorting each
ray does, with a sixteenth of the keys to sort. Blocks that see several surfaces are cut into groups: first by face of
the cube around the apex, then at gaps. A gap is wider than half of the rays' extent in u or v; a flat surface leaves
gaps of a third. Each group is a leaf, so some of its lanes are empty.
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, new_ticket, run, shares
from ..kernels.simd import bits as bits_of
from ..kernels.simd import (
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
from ..trace.counters import N_COUNTERS, add_counters, cleared
from .asking import ConeSamples, asking_of, origins_of, who_asks
from .beams import Beam
from .keys import cells_of
from .memory import Empty
from .order import at_apex, places_on, scale_of, sort_cells
from .rays import PAD, LeafCut, LeafRays, block_pointers, new_blocks, rays_in
from .view import relative16, view_of

GROUPS = 8  # groups per block, at most; there are six faces
_PART = 256  # blocks per work item
_ROOM = _PART * GROUPS + PAD
_INF = np.float32(np.inf)
_HALF = np.float32(0.5)


class FoundBlocks(NamedTuple):
    """Groups of lanes. The groups of part i begin at i _ROOM."""

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
    """Bits of the lanes beyond a gap wider than half of the extent; 0: no gap. Such a gap holds the extent's middle."""
    beyond = bits_of(x > (extent[0] + extent[1]) * _HALF) & lanes
    gap = _extent(x, beyond)[0] - _extent(x, lanes & ~beyond)[1]
    return beyond if gap > (extent[1] - extent[0]) * _HALF else np.int64(0)


@kernel
def _cut(face, places, lanes, full, centre):
    """Bits of the lanes to cut off a group. If there are none, write the group's centre (u, v) and return 0.

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
    """Write the ids of a block's receivers; return bits of the receivers inside the image."""
    columns = (w + 3) >> 2
    y, x = (block // columns * 4) + (iota16() >> 2), (block % columns * 4) + (iota16() & 3)
    store(ids, 0, minimum(y, np.int32(h - 1)) * np.int32(w) + minimum(x, np.int32(w - 1)))
    return bits_of((x < np.int32(w)) & (y < np.int32(h)))


@inlined
def _keep(asking, blocks, block, ids, o, asks):
    """Write a block's active receivers. The other lanes repeat the position of one of them."""
    there, one, of = mask_from_bits16(asks), lowest_bit(asks) & 15, load16(ids, 0)
    store(blocks.ids, 16 * block, select(there, of, np.int32(-1)))
    store(blocks.own, 16 * block, gather(asking.query.faces, of))
    for k in range(3):
        at = 16 * (3 * block + k)
        store(blocks.origins, at, o[k])
        store(blocks.origins, at, select(there, o[k], broadcast16(blocks.origins, at + one)))


@kernel
def _write_groups(ticket, query, beam, scale, bits, arrays, found, counts, tally):
    """Worker: write each block's receivers and its groups (`FoundBlocks`)."""
    asking, view, samples = asking_of(query, bits), view_of(beam), ConeSamples(beam.first, beam.count, beam.set)
    h, w = query.sides.shape
    ids, face, groups, places, centres = stack_i32(16), stack_i32(16), stack_i32(32), stack_f32(32), stack_f32(32)
    last, blocks = stack_i64(2), block_pointers(arrays)
    out, mine = FoundBlocks(ptr(found.cells), ptr(found.lanes), ptr(found.blocks)), cleared(stack_i64(N_COUNTERS))
    for k in range(0, 32, 16):  # unused lanes are computed too; denormal numbers in them would be slow
        store(centres, k, splat16(_HALF))
    put(last, 0, -1)
    for first, end in shares(ticket):
        part, total = first // ticket[CHUNK], 0
        for block in range(first, end):
            there = _block_ids(np.int32(block), w, h, ids)
            o = origins_of(asking, load16(ids, 0))
            d = relative16(view, o)
            asks = who_asks(asking, view, samples, ids, there, last, mine) & ~at_apex(view, d)
            _keep(asking, blocks, block, ids, o, asks)
            faces, u, v = places_on(view, scale, d)
            store(face, 0, faces)
            store(places, 0, u)
            store(places, 16, v)
            n = _groups(face, places, asks, groups, centres)
            at = part * _ROOM + total
            store(out.cells, at, cells_of(load16(groups, 16), load16(centres, 0), load16(centres, 16)))
            store(out.lanes, at, load16(groups, 0))
            store(out.blocks, at, splat16(np.int32(block)))
            total += n
        counts[part] = total
    add_counters(tally, mine)


def rays_by_blocks(query, beam: Beam, bits: np.ndarray, threads: int, tally=None, empty: Empty = np.empty) -> LeafRays:
    """Make the `LeafRays` of an image's active receivers, selected as by `order_of`."""
    h, w = query.sides.shape
    n = -(-h // 4) * -(-w // 4)
    blocks = new_blocks(n, 16, empty)
    parts, ticket = -(-n // _PART), new_ticket(n, _PART)
    found, counts = FoundBlocks(*(empty(parts * _ROOM, np.int32) for _ in range(3))), np.zeros(parts, np.int64)
    run(_write_groups, threads, ticket, query, beam, scale_of(beam), bits, blocks, found, counts, tally)
    gaps = np.arange(parts) * _ROOM - (np.cumsum(counts) - counts)
    at = np.arange(counts.sum()) + np.repeat(gaps, counts)
    order = sort_cells(np.append(found.cells[at], np.zeros(PAD, np.int32)), at.astype(np.int32), threads)
    cut = LeafCut(found.blocks[order.ids], found.lanes[order.ids], order.starts, order.faces, True)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)
