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
from ...kernels.vec3 import Vec3
from ...query.shadow_query import ShadowQuery
from ...trace.counters import N_COUNTERS, add_counters, cleared
from ...trace.tile import integers_in_quarters, points_in_quarters, rows_of_block, sides_in_quarters
from .light_beams import (
    PERSPECTIVE,
    Beam,
    ConeSamples,
    SixteenReceivers,
    active_receivers,
    new_light_sides,
    origins_of,
    query_bits_of,
    relative16,
    sides_of,
    view_of,
)
from .projected_rays import new_projected_blocks
from .ray_leaves import (
    BLOCK_BOX,
    HUGE,
    PAD,
    Empty,
    LeafCut,
    LeafRays,
    block_pointers,
    new_blocks,
    pixels_of_block,
    rays_in,
)
from .receiver_order import at_apex, cells_of, keys_of, scale_of, sort_by_keys, split_by_face

GROUPS = 8  # groups per block, at most; there are six faces
_PART = 256  # blocks per work item
_ROOM = _PART * GROUPS + PAD
_BOXES = 4 * _ROOM
_LANES = 16  # bits of a group's lanes, below the number of its block
_FEW = 1 << 18  # keys that one thread sorts sooner than several, which write to the same cache lines
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
    """(bits of the lanes to cut off a group, extents of the group in u and v if there are none).

    face, u, v : of all lanes, as from `_projected`
    whole : cut by face only
    """
    others = lanes & ~bits_of(face == extract(face, lowest_bit(lanes)))
    if others != 0:
        return others, (_INF, -_INF), (_INF, -_INF)
    across, along = _extent(u, lanes), _extent(v, lanes)
    if not whole and lanes & (lanes - 1) != 0:
        if across[1] - across[0] > along[1] - along[0]:
            others = _beyond_gap(u, lanes, across)
        else:
            others = _beyond_gap(v, lanes, along)
    return others, across, along


class _PartGroups(NamedTuple):
    """Pointers to the groups of a part."""

    lanes: I32Ptr  # int32: bits of lanes
    faces: I32Ptr  # int32
    boxes: F32Ptr  # float32: the lowest u of all groups, from _ROOM on the highest u, then the lowest and highest v


@kernel
def _groups(face, u, v, active, first, out):
    """Write the groups of a block's active lanes as group `first` and later ones. Return their number."""
    # In: face, u, v: of the lanes. Out: out (`_PartGroups`)
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
            put(out.boxes, first + i, across[0])
            put(out.boxes, first + i + _ROOM, across[1])
            put(out.boxes, first + i + 2 * _ROOM, along[0])
            put(out.boxes, first + i + 3 * _ROOM, along[1])
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
def _middle(boxes, i):
    """f32x16: the middles of extents, whose ends are _ROOM numbers apart."""
    return (load16(boxes, i) + load16(boxes, i + _ROOM)) * _HALF


@inlined
def _write_keys(view, scale, groups, n, keys, at):
    """Write the sorting keys of a part's n groups, from position `at` on."""
    for i in range(0, n, 16):
        u, v = _middle(groups.boxes, i), _middle(groups.boxes, i + 2 * _ROOM)
        if view.kind == PERSPECTIVE:
            u, v = u * _HALF + _HALF, v * _HALF + _HALF
        else:
            u, v = (u - _F(scale.u)) * _F(scale.factor), (v - _F(scale.v)) * _F(scale.factor)
        store(keys, at + i, keys_of(cells_of(load16(groups.faces, i), u, v)) >> np.int32(2 * _DROPPED))


# --- Receivers of a block ---------------------------------------------------------------------------------------------


class _ReadBlock(NamedTuple):
    """The receivers of a block, and their positions."""

    receivers: SixteenReceivers
    origins: Vec3


@inlined
def _read_full(query, y, x, ids, scratch):
    """The `_ReadBlock` of the pixels at (y, x), which must all exist; scratch: pointer to 48 float32."""
    rows = rows_of_block(y * query.w + x, query.w)
    o = points_in_quarters(query.origins, rows, scratch)
    faces, sides = integers_in_quarters(query.faces, rows), sides_in_quarters(query.sides, rows)
    return _ReadBlock(SixteenReceivers(ids, sides, faces), Vec3(o[0], o[1], o[2]))


@inlined
def _read_some(query_bits, samples, ids, there):
    """The `_ReadBlock` of receivers, of which only some (bits) may exist, or be of the beam's sample set."""
    receivers = SixteenReceivers(ids, sides_of(query_bits, samples, ids, there), gather(query_bits.query.faces, ids))
    return _ReadBlock(receivers, origins_of(query_bits, ids))


@inlined
def _keep(blocks, block, read, active):
    """Write a block's active receivers. The other lanes repeat the position of one of them."""
    there, one = mask_from_bits16(active), lowest_bit(active) & 15
    store(blocks.ids, 16 * block, select(there, read.receivers.ids, np.int32(-1)))
    store(blocks.own, 16 * block, read.receivers.faces)
    for k in range(3):
        at, o = 16 * (3 * block + k), read.origins[k]
        store(blocks.origins, at, o)
        store(blocks.origins, at, select(there, o, broadcast16(blocks.origins, at + one)))


@inlined
def _keep_projected(blocks, block, faces, u, v, q):
    """Write a block's projected receivers; NaN, which decides no test, for those too close to the apex."""
    points = blocks.points
    store(blocks.own, 16 * block, faces)
    known, nan = (q > _F(0.0)) & (q < HUGE), _F(np.nan)
    store(points, 48 * block, select(known, u, nan))
    store(points, 48 * block + 16, select(known, v, nan))
    store(points, 48 * block + 32, select(known, q, nan))


@inlined
def _keep_box(blocks, block, group, boxes, q, active):
    """Write the box of a block that is a single group. A receiver too close to the apex leaves it without one."""
    low, high = _extent(q, active)
    known = low > _F(0.0) and high < HUGE
    put(blocks.boxes, BLOCK_BOX * block, get(boxes, group) if known else _INF)
    for k in range(1, 4):
        put(blocks.boxes, BLOCK_BOX * block + k, get(boxes, group + k * _ROOM))
    put(blocks.boxes, BLOCK_BOX * block + 4, low)
    put(blocks.boxes, BLOCK_BOX * block + 5, high)


@kernel
def _write_groups(ticket, query, beam, scale, bits, arrays, block_groups, light_sides, counters):
    """Worker: write each block's receivers and its groups (`BlockGroups`); arrays: `Blocks`."""
    # In: query, beam, scale (of the keys), bits. Out: bits, block_groups, light_sides (int8, by triangle)
    query_bits, view, known = query_bits_of(query, bits), view_of(beam), ptr(light_sides)
    samples, (h, w) = ConeSamples(beam.first, beam.n_samples, beam.set), query.sides.shape
    blocks, groups = block_pointers(arrays), _PartGroups(stack_i32(_ROOM), stack_i32(_ROOM), stack_f32(_BOXES))
    keys, lanes, mine = ptr(block_groups.keys), ptr(block_groups.lanes), cleared(stack_i64(N_COUNTERS))
    columns, scratch = (w + 3) >> 2, stack_f32(48)
    for first, end in shares(ticket):
        part, total = first // ticket[CHUNK], 0
        for block in range(first, end):
            y, x = block // columns * 4, block % columns * 4
            ids, there = pixels_of_block(y, x, h, w)
            if there == 0xFFFF and samples.set < 0:
                read = _read_full(query_bits.query, y, x, ids, scratch)
            else:
                read = _read_some(query_bits, samples, ids, there)
            d = relative16(view, read.origins)
            active = active_receivers(query_bits, view, samples, read.receivers, known, mine) & ~at_apex(view, d)
            if active == 0:
                if blocks.width == 0:
                    store(blocks.ids, 16 * block, splat16(np.int32(-1)))
                continue
            face, u, v, q = _projected(view, d)
            if blocks.width > 0:
                _keep_projected(blocks, block, read.receivers.faces, u, v, q)
            else:
                _keep(blocks, block, read, active)
            n = _groups(face, u, v, active, total, groups)
            if blocks.width > 0 and n == 1:
                _keep_box(blocks, block, total, groups.boxes, q, active)
            elif blocks.width > 0:
                put(blocks.boxes, BLOCK_BOX * block, _INF)
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
    # In: block_groups
    from_keys, to_keys, to_places = ptr(block_groups.keys), ptr(keys), ptr(places)
    for part in items(ticket):
        at, place = starts[part], part * _ROOM
        for i in range(block_groups.counts[part]):
            put(to_keys, at + i, get(from_keys, place + i))
            put(to_places, at + i, place + i)


@kernel
def _write_cut(ticket, block_groups, places, blocks, lanes):
    """Worker: write the block and the lanes of each leaf, a group at one of the places."""
    # In: block_groups. Out: blocks
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
    order = sort_by_keys(keys, places, threads if leaves > _FEW else 1, _DROPPED)
    cut = LeafCut(empty(leaves, np.int32), empty(leaves, np.int32), order.starts, order.faces, True)
    run_short(_write_cut, threads, new_ticket(leaves, 4096), groups, order.ids, cut.blocks, cut.lanes)
    return rays_in(query, beam, blocks, cut, bits, threads, empty)
