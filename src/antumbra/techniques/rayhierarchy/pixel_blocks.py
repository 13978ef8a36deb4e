"""Blocks of 4 x 4 pixels as leaves of a ray hierarchy.

Pixels adjacent on the screen are nearly always close on a surface, so most blocks make leaves as tight as sorting each
ray does, with a sixteenth of the keys to sort. Blocks that see several surfaces are cut into groups: first by face of
the cube around the apex, then at gaps wider than half of the rays' extent in u or v (a flat surface has gaps of a
third). Each group is a leaf, so some of its lanes are empty.

Receivers are stored side by side, block by block. Rays to one point are stored *projected* on their face instead, as
(u, v, q), which is all that planes and boxes need (`projected_rays`).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import CHUNK, items, new_ticket, run_short, shares
from ...kernels.simd import bits as bits_of
from ...kernels.simd import (
    broadcast16,
    extract,
    gather,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    ptr,
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
from ...trace.tile import sides_in_rows
from .light_beams import (
    PERSPECTIVE,
    Beam,
    ConeSamples,
    active_receivers,
    new_light_sides,
    origins_of,
    query_bits_of,
    relative16,
    sides_of,
    view_of,
)
from .projected_rays import new_projected_blocks
from .ray_leaves import HUGE, PAD, Empty, LeafCut, LeafRays, block_pointers, new_blocks, pixels_of_block, rays_in
from .receiver_order import at_apex, cells_of, keys_of, scale_of, sort_by_keys, split_by_face

GROUPS = 8  # groups per block, at most; there are six faces
_PART = 256  # blocks per work item
_ROOM = _PART * GROUPS + PAD
_CENTRES = 2 * _ROOM
_LANES = 16  # bits of a group's lanes, below the number of its block
_DROPPED = 1  # levels of the Hilbert curve that keys of blocks leave out: three passes sort them instead of four
_F = np.float32
_INF = _F(np.inf)
_HALF = _F(0.5)


class BlockGroups(NamedTuple):
    """Groups of lanes in blocks. The groups of part i start at i _ROOM."""

    keys: np.ndarray  # (parts _ROOM,) int32: the sorting key of each group
    lanes: np.ndarray  # (parts _ROOM,) int32: bits of its lanes, and the number of its block in the part from bit 16 on
    counts: np.ndarray  # (parts,) int64: number of groups


# --- Groups of a block ------------------------------------------------------------------------------------------------


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
def _cut(face, u, v, lanes, whole):
    """(bits of the lanes to cut off a group, centre of the group in u and v if there are none).

    face, u, v : of all lanes, as from `_projected`
    whole : cut by face only
    """
    others = lanes & ~bits_of(face == extract(face, lowest_bit(lanes)))
    if others != 0:
        return others, _F(0.0), _F(0.0)
    across, along = _extent(u, lanes), _extent(v, lanes)
    if not whole and lanes & (lanes - 1) != 0:
        if across[1] - across[0] > along[1] - along[0]:
            others = _beyond_gap(u, lanes, across)
        else:
            others = _beyond_gap(v, lanes, along)
    return others, (across[0] + across[1]) * _HALF, (along[0] + along[1]) * _HALF


class _PartGroups(NamedTuple):
    """Pointers to the groups of a part."""

    lanes: I32Ptr  # int32: bits of lanes
    faces: I32Ptr  # int32
    centres: F32Ptr  # float32: u of all groups, and from _ROOM on v


@kernel
def _groups(face, u, v, active, first, out):
    """Write the groups of a block's active lanes as group `first` and later ones. Return their number."""
    n, i = 1, 0
    put(out.lanes, first, active)
    while i < n:
        lanes = np.int64(get(out.lanes, first + i))
        others, across, along = _cut(face, u, v, lanes, n > GROUPS - 6)
        if others != 0:
            put(out.lanes, first + i, lanes & ~others)
            put(out.lanes, first + n, others)
            n += 1
        else:
            put(out.faces, first + i, extract(face, lowest_bit(lanes)))
            put(out.centres, first + i, across)
            put(out.centres, first + i + _ROOM, along)
            i += 1
    return n


@inlined
def _projected(view, d):
    """(face, u, v, q) of 16 receivers; d: from `relative16`. The coordinates are those of `projected16`."""
    if view.kind == PERSPECTIVE:
        face, a, b, depth = split_by_face(d)
        q = _F(1.0) / depth
        return face, a * q, b * q, q
    return splat16(np.int32(0)), d.x, d.y, d.z


@inlined
def _write_keys(view, scale, groups, n, keys, at):
    """Write the sorting keys of a part's n groups, from position `at` on."""
    for i in range(0, n, 16):
        u, v = load16(groups.centres, i), load16(groups.centres, i + _ROOM)
        if view.kind == PERSPECTIVE:
            u, v = u * _HALF + _HALF, v * _HALF + _HALF
        else:
            u, v = (u - _F(scale.u)) * _F(scale.factor), (v - _F(scale.v)) * _F(scale.factor)
        store(keys, at + i, keys_of(cells_of(load16(groups.faces, i), u, v)) >> np.int32(2 * _DROPPED))


# --- Receivers of a block ---------------------------------------------------------------------------------------------


@inlined
def _keep(query_bits, blocks, block, ids, o, active):
    """Write a block's active receivers. The other lanes repeat the position of one of them."""
    there, one = mask_from_bits16(active), lowest_bit(active) & 15
    store(blocks.ids, 16 * block, select(there, ids, np.int32(-1)))
    store(blocks.own, 16 * block, gather(query_bits.query.faces, ids))
    for k in range(3):
        at = 16 * (3 * block + k)
        store(blocks.origins, at, o[k])
        store(blocks.origins, at, select(there, o[k], broadcast16(blocks.origins, at + one)))


@inlined
def _keep_projected(points, block, u, v, q):
    """Write a block's projected receivers; NaN, which decides no test, for those too close to the apex."""
    known, nan = (q > _F(0.0)) & (q < HUGE), _F(np.nan)
    store(points, 48 * block, select(known, u, nan))
    store(points, 48 * block + 16, select(known, v, nan))
    store(points, 48 * block + 32, select(known, q, nan))


@kernel
def _write_groups(ticket, query, beam, scale, bits, arrays, block_groups, light_sides, counters):
    """Worker: write each block's receivers and its groups (`BlockGroups`); arrays: `Blocks`."""
    query_bits, view, known = query_bits_of(query, bits), view_of(beam), ptr(light_sides)
    samples, (h, w) = ConeSamples(beam.first, beam.n_samples, beam.set), query.sides.shape
    blocks, groups = block_pointers(arrays), _PartGroups(stack_i32(_ROOM), stack_i32(_ROOM), stack_f32(_CENTRES))
    keys, lanes, mine = ptr(block_groups.keys), ptr(block_groups.lanes), cleared(stack_i64(N_COUNTERS))
    columns = (w + 3) >> 2
    for first, end in shares(ticket):
        part, total = first // ticket[CHUNK], 0
        for block in range(first, end):
            y, x = block // columns * 4, block % columns * 4
            ids, there = pixels_of_block(y, x, h, w)
            if there == 0xFFFF and samples.set < 0:
                sides = sides_in_rows(query_bits.query.sides, y * w + x, w)
            else:
                sides = sides_of(query_bits, samples, ids, there)
            o = origins_of(query_bits, ids)
            d = relative16(view, o)
            active = active_receivers(query_bits, view, samples, ids, sides, known, mine) & ~at_apex(view, d)
            if active == 0:
                if blocks.width == 0:
                    store(blocks.ids, 16 * block, splat16(np.int32(-1)))
                continue
            face, u, v, q = _projected(view, d)
            if blocks.width > 0:
                _keep_projected(blocks.points, block, u, v, q)
            else:
                _keep(query_bits, blocks, block, ids, o, active)
            n = _groups(face, u, v, active, total, groups)
            for i in range(total, total + n):
                put(lanes, part * _ROOM + i, get(groups.lanes, i) | block - first << _LANES)
            total += n
        _write_keys(view, scale, groups, total, keys, part * _ROOM)
        block_groups.counts[part] = total
    add_counters(counters, mine)


# --- Leaves of a picture ----------------------------------------------------------------------------------------------


@kernel
def _gather_groups(ticket, block_groups, starts, keys, places):
    """Worker: write the keys and the places of all groups without gaps; starts: output position of each part."""
    from_keys, to_keys, to_places = ptr(block_groups.keys), ptr(keys), ptr(places)
    for part in items(ticket):
        at, place = starts[part], part * _ROOM
        for i in range(block_groups.counts[part]):
            put(to_keys, at + i, get(from_keys, place + i))
            put(to_places, at + i, place + i)


@kernel
def _write_cut(ticket, block_groups, places, blocks, lanes):
    """Worker: write the block and the lanes of each leaf, a group at one of the places."""
    groups = ptr(block_groups.lanes)
    for leaf in items(ticket):
        place = np.int64(places[leaf])
        group = np.int64(get(groups, place))
        blocks[leaf], lanes[leaf] = place // _ROOM * _PART + (group >> _LANES), group & (1 << _LANES) - 1


def rays_by_blocks(
    query: ShadowQuery,
    beam: Beam,
    bits: NDArray[np.uint64],
    threads: int,
    tally: NDArray[np.int64] | None = None,
    empty: Empty = np.empty,
    projected: bool = False,
) -> LeafRays:
    """Make the `LeafRays` of a picture's active receivers, selected as in `order_of`.

    projected : whether to store (u, v, q) instead of positions, see `projected_rays`; only for one ray to one point
    """
    h, w = query.sides.shape
    n = -(-h // 4) * -(-w // 4)
    parts = -(-n // _PART)
    blocks = new_projected_blocks(n, query, empty) if projected else new_blocks(n, 16, empty)
    groups = BlockGroups(empty(parts * _ROOM, np.int32), empty(parts * _ROOM, np.int32), np.zeros(parts, np.int64))
    args = query, beam, scale_of(beam), bits, blocks, groups, new_light_sides(query), tally
    run_short(_write_groups, threads, new_ticket(n, _PART), *args)
    starts = np.append(0, np.cumsum(groups.counts))
    leaves = int(starts[-1])
    keys, places = empty(leaves, np.int32), empty(leaves, np.int32)
    run_short(_gather_groups, threads, new_ticket(parts, 16), groups, starts, keys, places)
    order = sort_by_keys(keys, places, threads, _DROPPED)
    cut = LeafCut(empty(leaves, np.int32), empty(leaves, np.int32), order.starts, order.faces, True)
    run_short(_write_cut, threads, new_ticket(leaves, 4096), groups, order.ids, cut.blocks, cut.lanes)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)
