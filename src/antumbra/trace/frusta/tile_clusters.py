"""Tile clusters: which tiles are traced together.

Clusters. Neighbouring pixels may have distant surfaces, at silhouettes and at grazing angles. So the tiles of an area
are cut into coherent parts, and the parts are sorted by position. Sixteen consecutive parts are a *cluster*, which is
traced together.

Tile groups. Tiles are close together if the light is large compared with the bounding box of their receivers. How large
it must be depends on the scene: a wide box meets more triangles, above all near receivers in foliage. So each thread
measures it. Groups are classified by the ratio of the light's size to the box's: 4 to 8, 8 to 16, 16 to 32, or more.
Two moving averages per class hold the cost of a tile in clusters with such a group, and in clusters without one that
could have had it. The cheaper choice is made, and the other one is tried occasionally. Costs are operation counts, so
that nothing depends on time.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    as_f32,
    broadcast16,
    gather,
    get,
    iota16,
    load16,
    lowest_bit,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_i32,
    store,
)
from ..counters import COVERED, GROUP_STRATA, NODES, TILE_GROUP_TILES, TRIANGLE_TESTS, TRIANGLES
from ..light_table import ALL_GROUPS
from ..tile import (
    RECEIVER_FLOATS,
    TileShape,
    coherent_part,
    copy_receivers,
    fetch_receivers,
    load_receivers,
    tile_at,
    with_receivers_at,
)

# --- Regions of 16 tiles ----------------------------------------------------------------------------------------------


MAX_TILES = 16  # tiles per region
RUN = 64  # regions per run: a square of 8 x 8, or a part of a row


class RegionLayout(NamedTuple):
    """How tiles are cut into regions: 4 x 4 tiles, or 16 tiles of a row."""

    across: int  # tiles per row of a region
    down: int  # rows of tiles per region
    columns: int  # regions per row
    rows: int  # rows of regions


def layout_of(shape: TileShape) -> RegionLayout:
    """The `RegionLayout` of a query."""
    across = MAX_TILES if shape.height == 1 else 4
    down = MAX_TILES // across
    return RegionLayout(across, down, -(-shape.columns // across), -(-shape.rows // down))


def runs(layout: RegionLayout) -> int:
    """The number of runs of RUN regions: squares of 8 x 8, or parts of a row."""
    return -(-layout.columns // RUN) if layout.rows == 1 else -(-layout.columns // 8) * -(-layout.rows // 8)


@inlined
def even_bits(code):
    """Bits 0, 2 and 4 of a number, compacted."""
    return code & 1 | code >> 1 & 2 | code >> 2 & 4


@inlined
def corner_of(layout, at):
    """(row, column) of the first tile of region `at`. Regions of a square are in Z order, for cache locality."""
    if layout.rows == 1:
        return 0, at * layout.across
    square, code, across = at >> 6, at & 63, (layout.columns + 7) >> 3
    by, bx = square // across * 8 + even_bits(code >> 1), square % across * 8 + even_bits(code)
    return by * layout.down, bx * layout.across


@inlined
def tile_in(layout, g):
    """(row, column) of tile g in its region, or in four consecutive regions. Tiles are in Z order, too."""
    if layout.down == 1:
        return 0, np.int64(g)
    if layout.rows == 1:  # consecutive regions form a row
        return even_bits((g & 15) >> 1), even_bits(g & 15) + (g >> 4) * layout.across
    return even_bits(g >> 1), even_bits(g)


# --- Coherent parts of an area's tiles --------------------------------------------------------------------------------


_F = np.float32
REGIONS = 4  # most regions per area
_MOST = 2 * REGIONS * MAX_TILES  # most parts in a list; the remaining parts of an area go to later lists
_ROW = _MOST + 16  # length of a row: a vector may extend beyond the last part
_AHEAD = 8  # prefetch distance of receivers, in tiles
_FEW = 4  # so few parts are not sorted
_UNLISTED, _TILES, _LANES, _ORDER, _SORTED, _KEYS, _RANKS, _PLACES, _RECEIVERS = (i * _ROW for i in (*range(8), 10))
PARTS_INTS = _RECEIVERS + RECEIVER_FLOATS * REGIONS * MAX_TILES
_PLACE_BITS = 255  # at least _MOST - 1


class TileParts(NamedTuple):
    """Pointers to an area's parts in PARTS_INTS int32."""

    unlisted: I32Ptr  # int32, one per tile: bits of the receivers that are not in a list yet
    tiles: I32Ptr  # int32, one per part: its tile
    lanes: I32Ptr  # int32, one per part: bits of its receivers
    order: I32Ptr  # int32: the parts in tracing order
    sorted: I32Ptr  # int32: a segment of `order` during sorting
    keys: I32Ptr  # int32: its keys
    ranks: I32Ptr  # int32: its ranks
    places: F32Ptr  # float32, rows x, y, z: one receiver of each part
    receivers: F32Ptr  # float32, RECEIVER_FLOATS per tile


@inlined
def parts_at(memory):
    """The `TileParts` in PARTS_INTS int32."""
    return TileParts(
        ptr_at(memory, _UNLISTED),
        ptr_at(memory, _TILES),
        ptr_at(memory, _LANES),
        ptr_at(memory, _ORDER),
        ptr_at(memory, _SORTED),
        ptr_at(memory, _KEYS),
        ptr_at(memory, _RANKS),
        as_f32(ptr_at(memory, _PLACES)),
        as_f32(ptr_at(memory, _RECEIVERS)),
    )


@inlined
def mark_unlisted(parts, n_tiles, receivers):
    """Mark `receivers` (bits) of each tile as not listed yet."""
    for g in range(n_tiles):
        put(parts.unlisted, g, np.int32(receivers))


@inlined
def _place_in(chunk, layout, y, x, g):
    """(y, x) of the first pixel of tile g of the area whose first tile is (y, x)."""
    row, column = tile_in(layout, g)
    return (y + row) * chunk.shape.height, (x + column) * chunk.shape.width


@inlined
def _receivers_at(parts, g):
    """Pointer to the receivers of tile g of the area."""
    return ptr_at(parts.receivers, RECEIVER_FLOATS * g)


@kernel
def list_parts(chunk, layout, y, x, n_tiles, tile, parts):
    """List coherent parts of an area's tiles, as many as fit. Return their number, 0 once all have been listed.

    tile : any `Tile`
    """
    n = 0
    for g in range(n_tiles):
        fetch_receivers(chunk, *_place_in(chunk, layout, y, x, g + _AHEAD))
        remaining = get(parts.unlisted, g)
        if remaining != 0 and n < _MOST:
            y0, x0 = _place_in(chunk, layout, y, x, g)
            receivers = with_receivers_at(tile, _receivers_at(parts, g))
            remaining &= load_receivers(chunk, y0, x0, receivers)
            while remaining != 0 and n < _MOST:
                part = coherent_part(receivers, remaining, chunk.light)
                put(parts.tiles, n, g)
                put(parts.lanes, n, part)
                for k in range(3):
                    put(parts.places, k * _ROW + n, get(receivers.origins, 16 * k + lowest_bit(part)))
                remaining &= ~part
                n += 1
            put(parts.unlisted, g, remaining)
    return n


@inlined
def _extent(parts, k, first, count):
    """(least coordinate k of a segment of `order`, extent along axis k)."""
    low = high = gather(parts.places, splat16(np.int32(k * _ROW)) + broadcast16(parts.order, first))
    for at in range(0, count, 16):
        x = gather(parts.places, _load_parts(parts, first, at, count) + splat16(np.int32(k * _ROW)))
        low, high = minimum(low, x), maximum(high, x)
    low = reduce_min(low)
    return low, reduce_max(high) - low


@inlined
def _load_parts(parts, first, at, count):
    """16 parts of a segment of `order`, from index `at` on. Lanes beyond its end repeat the first part."""
    there = iota16() + splat16(np.int32(at)) < splat16(np.int32(count))
    return select(there, load16(parts.order, first + at), broadcast16(parts.order, first))


@kernel
def _sort_piece(parts, first, count):
    """Sort a segment of `order` along its longest axis.

    Keys are the bits of distances from the lowest part, which sort like the distances. Their last bits are replaced by
    the index, so that no two keys are equal.
    """
    x, dx = _extent(parts, 0, first, count)
    y, dy = _extent(parts, 1, first, count)
    z, dz = _extent(parts, 2, first, count)
    low, row = (x, 0) if dx >= dy and dx >= dz else ((y, _ROW) if dy >= dz else (z, 2 * _ROW))
    for at in range(0, count, 16):
        place = gather(parts.places, _load_parts(parts, first, at, count) + splat16(np.int32(row)))
        store(as_f32(parts.keys), at, place - splat16(low))
        key = load16(parts.keys, at) & splat16(np.int32(~_PLACE_BITS))
        store(parts.keys, at, key | (iota16() + splat16(np.int32(at))))
    for at in range(0, count, 16):
        key, rank = load16(parts.keys, at), splat16(np.int32(0))
        for i in range(count):
            rank = rank + select(broadcast16(parts.keys, i) < key, splat16(np.int32(1)), splat16(np.int32(0)))
        store(parts.ranks, at, rank)
    for i in range(count):
        put(parts.sorted, get(parts.ranks, i), get(parts.order, first + i))
    for i in range(count):
        put(parts.order, first + i, get(parts.sorted, i))


@inlined
def _half(count):
    """About half of `count` parts: a multiple of full clusters if there is more than one, otherwise of full bundles."""
    unit = MAX_TILES if count > MAX_TILES else (8 if count > 8 else _FEW)
    return (count + unit) // (2 * unit) * unit


@kernel
def order_parts(parts, n):
    """Sort n listed parts by repeated halving along the longest axis."""
    waiting, height, first, count = stack_i32(2 * 16), 0, 0, np.int64(n)
    for i in range(n):
        put(parts.order, i, np.int32(i))
    while True:
        while count > _FEW:
            half = _half(count)
            _sort_piece(parts, first, count)
            put(waiting, height, np.int32(first + half))
            put(waiting, height + 1, np.int32(count - half))
            height += 2
            count = half
        if height == 0:
            return
        height -= 2
        first, count = get(waiting, height), get(waiting, height + 1)


@kernel
def load_cluster(chunk, layout, y, x, first, n, scratch):
    """Load n parts, from index `first` of the order on, as tiles 0 to n - 1 of a bundle."""
    parts = parts_at(scratch.parts)
    for g in range(n):
        k = get(parts.order, first + g)
        number, tile = get(parts.tiles, k), tile_at(scratch.tiles, g, chunk)
        y0, x0 = _place_in(chunk, layout, y, x, number)
        copy_receivers(_receivers_at(parts, number), tile)
        put(scratch.valid, g, get(parts.lanes, k))
        put(scratch.places, 2 * g, y0)
        put(scratch.places, 2 * g + 1, x0)


# --- Choice of tile groups --------------------------------------------------------------------------------------------


_CLASSES = 4
_SMALLEST = _F(4.0)  # least ratio of the light's size to the box's in class 0; it doubles from class to class
_FEW_TILES = 8  # least number of tiles in a tile group; fewer do not pay for its wider shafts
_FEW_SAMPLES = 8  # least number of samples in a chunk for a tile group
_USUAL = 2  # first class whose groups usually pay
_WAIT = 32  # clusters of a class before the first trial: trials do not pay for short queries
_FIRST = 8  # clusters of a class after these that are all trials
_OFTEN, _SELDOM = 16, 64  # afterwards, trials are 2 of 16 clusters, or 2 of 64 if costs differ by a factor of _CLEAR
_CLEAR = _F(1.5)
_NEW = _F(0.0625)  # weight of a trial in the moving average
_TOGETHER, _APART, _CLUSTERS = 0, _CLASSES, 2 * _CLASSES  # average costs of a tile, and the number of clusters
TRIAL_FLOATS = 3 * _CLASSES


class Grouping(NamedTuple):
    """How a cluster is traced."""

    members: int  # bits of the tiles in its tile group; 0: there is none
    trial_class: int  # the group's class if it is a trial, else -1
    declined: int  # bits of the classes of possible groups that are omitted as a trial


@inlined
def _light_size(tile):
    """The sum of the extents of the light's box."""
    size = _F(0.0)
    for k in range(3):
        size += get(tile.groups, (3 + k) * ALL_GROUPS + 1) - get(tile.groups, k * ALL_GROUPS + 1)
    return size


@inlined
def _union(low, high, info):
    """(lower, upper corner) of the union of a box and the box of a tile's receivers."""
    return (
        (min(low[0], get(info, 6)), min(low[1], get(info, 7)), min(low[2], get(info, 8))),
        (max(high[0], get(info, 9)), max(high[1], get(info, 10)), max(high[2], get(info, 11))),
    )


@kernel
def _near_each_other(chunk, tiles, numbers, most):
    """(bits of the tiles in `numbers` near the first one, sum of the extents of their box, at most `most`)."""
    i = tile_at(tiles, lowest_bit(numbers), chunk).info
    low, high = (get(i, 6), get(i, 7), get(i, 8)), (get(i, 9), get(i, 10), get(i, 11))
    members, size = numbers & -numbers, _F(0.0)
    numbers &= numbers - 1
    while numbers != 0:
        g = lowest_bit(numbers)
        numbers &= numbers - 1
        a, b = _union(low, high, tile_at(tiles, g, chunk).info)
        extents = b[0] - a[0] + b[1] - a[1] + b[2] - a[2]
        if extents < most:
            low, high, size = a, b, extents
            members |= 1 << g
    return members, size


@inlined
def _enough_near(chunk, tiles, numbers, most):
    """`_near_each_other` for the first tile in `numbers` that has enough tiles near it; (0, 0) if there is none."""
    while popcount(numbers) >= _FEW_TILES:
        members, size = _near_each_other(chunk, tiles, numbers, most)
        if popcount(members) >= _FEW_TILES:
            return members, size
        numbers &= ~members
    return 0, _F(0.0)


@inlined
def group_pays(trials, c):
    """(whether to form a group of class c, whether this is a trial)."""
    clusters = np.int64(get(trials, _CLUSTERS + c))
    put(trials, _CLUSTERS + c, _F(clusters + 1))
    together, apart = get(trials, _TOGETHER + c), get(trials, _APART + c)
    clear = together > _CLEAR * apart or apart > _CLEAR * together
    if clusters < _WAIT:
        return c >= _USUAL, False
    if clusters < _WAIT + _FIRST or clusters % (_SELDOM if clear else _OFTEN) < 2:
        return clusters % 2 == 0, True
    return together < apart, False


@inlined
def reset_trials(trials):
    """Reset the averages."""
    for i in range(TRIAL_FLOATS):
        put(trials, i, _F(0.0))


@kernel
def choose_group(chunk, tiles, live, trials):
    """The `Grouping` of a cluster whose tiles in `live` (bits) have segments to trace, with at most one group."""
    declined, c = 0, 0
    if live == 0 or chunk.n_samples < _FEW_SAMPLES:
        return Grouping(0, -1, declined)
    light = _light_size(tile_at(tiles, lowest_bit(live), chunk))
    while c < _CLASSES:
        members, size = _enough_near(chunk, tiles, live, light / (_SMALLEST * _F(1 << c)))
        if members == 0:
            break
        while c < _CLASSES - 1 and size * _SMALLEST * _F(2 << c) < light:
            c += 1
        pays, trial = group_pays(trials, c)
        if pays:
            return Grouping(members, np.int64(c) if trial else -1, declined)
        if trial:
            declined |= 1 << c
        c += 1
    return Grouping(0, -1, declined)


@inlined
def work_of(counters):
    """The counted work so far, roughly in nanoseconds."""
    return (
        57 * get(counters, NODES)
        + 3 * get(counters, TRIANGLES)
        + 27 * get(counters, TRIANGLE_TESTS)
        + 53 * get(counters, COVERED)
        + 24 * get(counters, GROUP_STRATA)
        + 346 * get(counters, TILE_GROUP_TILES)
    )


@inlined
def _average(trials, at, cost):
    """Add a trial's cost to a moving average."""
    old = get(trials, at)
    put(trials, at, cost if old == _F(0.0) else old + (cost - old) * _NEW)


@kernel
def record_costs(trials, grouping, work, live):
    """Record the work of a cluster whose tiles in `live` (bits) had segments to trace."""
    cost = _F(work + 1) / _F(max(popcount(live), 1))
    if grouping.trial_class >= 0:
        _average(trials, _TOGETHER + grouping.trial_class, cost)
    declined = grouping.declined
    while declined != 0:
        _average(trials, _APART + lowest_bit(declined), cost)
        declined &= declined - 1
