"""Tiles: 16 receivers and a chunk of up to 16 light samples per receiver, prepared for tracing.

Queries are cut into tiles and chunks, the form in which hot kernels read them. Lane i of a tile is a receiver. Its
segments are traced stratum by stratum. The 16 segments to one stratum start and end near each other, so they lie in one
shaft.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..bvh.nodes import middle_and_half
from ..kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel
from ..kernels.simd import (
    as_i32,
    bits,
    broadcast16,
    get,
    iota16,
    join,
    load4,
    load16,
    load16x3,
    lowest_bit,
    mask_from_bits16,
    minimum,
    prefetch,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat4,
    splat16,
    stack_f32,
    stack_f64,
    store,
    to_f32,
)
from ..query.receivers import FREE, NOTHING
from ..query.shadow_query import QueryPointers, ShadowQuery, patch_of, query_pointers
from .light_table import ALL_GROUPS, GROUPS, POINTS, STRATA, TARGETS, bound_strata, bound_targets, is_fixed
from .shafts import BEAM_FLOATS, INVERSE_FLOATS, SHAFT_FLOATS

# --- Queries as tiles and chunks --------------------------------------------------------------------------------------


_F = np.float32
_LIGHT = _F(2.0**-8)


class TileShape(NamedTuple):
    """How receivers are cut into tiles: 4 x 4 pixels, or 16 receivers of a row."""

    width: int  # receivers per row of a tile
    height: int  # rows of receivers in a tile
    columns: int  # tiles per row
    rows: int  # rows of tiles


def tile_shape(query: ShadowQuery) -> TileShape:
    """The `TileShape` of a query: 4 x 4 pixels, or 16 receivers if they form a single row."""
    h, w = query.sides.shape
    width, height = (4, 4) if h > 1 else (16, 1)
    return TileShape(width, height, -(-w // width), -(-h // height))


def sets_of(shape: TileShape) -> NDArray[np.int64]:
    """(16,) int: the sample set of each lane of a tile."""
    lane = np.arange(16)
    sets: NDArray[np.int64] = (lane % shape.width & 3) + 4 * (lane // shape.width)
    return sets


class QueryChunk(NamedTuple):
    """A chunk of a query for hot kernels."""

    query: QueryPointers
    points: F32Ptr  # float32 * into the chunk's light table, like the next three; unused if the light moves
    groups: F32Ptr  # float32 *
    targets: F32Ptr  # float32 *
    by_lane: F32Ptr  # float32 *
    samples: F64Ptr  # float64 * into the chunk's light table, like the next; unused if the light is fixed
    samples_by_lane: F64Ptr  # float64 *
    fixed: bool  # the light does not move with the receiver
    shape: TileShape
    first: int  # first sample
    n_samples: int
    light: float  # a small fraction of the sum of the light's extents


@inlined
def query_chunk_of(query, table, shape, chunk, n_samples):
    """The `QueryChunk` of one chunk of a query."""
    groups, light, fixed = ptr_at(ptr(table.groups), chunk * GROUPS), _F(0.0), is_fixed(query.light)
    moving = 0 if fixed else POINTS
    if fixed:
        for k in range(3):
            light += get(groups, (3 + k) * ALL_GROUPS + 1) - get(groups, k * ALL_GROUPS + 1)
    return QueryChunk(
        query_pointers(query), ptr_at(ptr(table.points), chunk * POINTS), groups,
        ptr_at(ptr(table.targets), chunk * TARGETS), ptr_at(ptr(table.by_lane), chunk * POINTS),
        ptr_at(ptr(table.samples), chunk * moving), ptr_at(ptr(table.samples_by_lane), chunk * moving), fixed, shape,
        chunk * STRATA, n_samples, light * _LIGHT,
    )  # fmt: skip


@inlined
def place_of(chunk, y0, x0, lane):
    """Index of a lane's receiver among all receivers, row by row."""
    if chunk.shape.height == 1:
        return y0 * chunk.query.w + x0 + lane
    return (y0 + (lane >> 2)) * chunk.query.w + x0 + (lane & 3)  # a division by the width would take longer


# --- The tile ---------------------------------------------------------------------------------------------------------


_FACES, _SIDES, _INFO, _DEAD, _SHAFTS = 48, 64, 80, 96, 112
RECEIVER_FLOATS = 80  # float32 of a tile's receivers, at its beginning: origins, faces and sides
_BEAMS = _SHAFTS + SHAFT_FLOATS
_SAMPLES = _BEAMS + BEAM_FLOATS  # offset of the light samples
_INVERSES = _SAMPLES + 2 * POINTS + GROUPS + TARGETS
TILE_FLOATS = _INVERSES + INVERSE_FLOATS
SPLIT = _F(0.75)


class Tile(NamedTuple):
    """Pointers to a tile's numbers in float32 scratch memory, or in the light table."""

    number: int  # in its bundle
    origins: F32Ptr  # float32: x, y, z of 16 receivers; lanes without a receiver repeat another one
    info: F32Ptr  # float32: 0..2 centre, 3..5 half extents, 6..8, 9..11 corners of the receivers' box; 12: see `shafts`
    faces: I32Ptr  # int32: the receivers' own triangles, by the trees' indices
    sides: F32Ptr  # float32: their visible sides, 1 or -1; 0: a point in free space
    dead: I32Ptr  # int32, one per stratum: bits of receivers whose segment is blocked; all bits if it has no sample
    shafts: F32Ptr  # float32, see `shafts`, like the beams
    beams: F32Ptr  # float32
    points: F32Ptr  # float32, see `light_table`, like the next three
    groups: F32Ptr  # float32
    targets: F32Ptr  # float32
    by_lane: F32Ptr  # float32
    inverses: F32Ptr  # float32, reciprocals of segments, see `shafts`


@inlined
def tile_at(scratch, g, chunk):
    """`Tile` number g of a bundle."""
    memory = ptr_at(scratch, g * TILE_FLOATS)
    points, groups, targets = (
        ptr_at(memory, _SAMPLES),
        ptr_at(memory, _SAMPLES + POINTS),
        ptr_at(memory, _SAMPLES + POINTS + GROUPS),
    )
    by_lane = ptr_at(memory, _SAMPLES + POINTS + GROUPS + TARGETS)
    if chunk.fixed:
        points, groups, targets, by_lane = (
            chunk.points,
            chunk.groups,
            chunk.targets,
            chunk.by_lane,
        )
    return Tile(
        np.int64(g), memory, ptr_at(memory, _INFO), as_i32(ptr_at(memory, _FACES)), ptr_at(memory, _SIDES),
        as_i32(ptr_at(memory, _DEAD)), ptr_at(memory, _SHAFTS), ptr_at(memory, _BEAMS), points, groups, targets,
        by_lane, ptr_at(memory, _INVERSES),
    )  # fmt: skip


@inlined
def with_receivers_at(tile, memory):
    """The tile with its receivers in other memory, RECEIVER_FLOATS float32."""
    return Tile(
        tile.number, memory, tile.info, as_i32(ptr_at(memory, _FACES)), ptr_at(memory, _SIDES), tile.dead, tile.shafts,
        tile.beams, tile.points, tile.groups, tile.targets, tile.by_lane, tile.inverses,
    )  # fmt: skip


@inlined
def copy_receivers(memory, tile):
    """Copy receivers from `memory`, RECEIVER_FLOATS float32, to a tile."""
    for at in range(0, RECEIVER_FLOATS, 16):
        store(tile.origins, at, load16(memory, at))


@inlined
def first_pixel(pixels, g):
    """(y, x) of the first pixel of tile g of a bundle; `pixels`: int32, y and x of each tile."""
    return get(pixels, 2 * g), get(pixels, 2 * g + 1)


@inlined
def fetch_receivers(chunk, y0, x0):
    """Prefetch what `load_receivers` reads, because the rows of a tile are far apart in memory."""
    for y in range(y0, y0 + chunk.shape.height):
        at = y * chunk.query.w + x0
        prefetch(chunk.query.sides, at)
        prefetch(chunk.query.ids, at)
        prefetch(chunk.query.origins, at * 3)
        prefetch(chunk.query.origins, at * 3 + 11)


@inlined
def _quarters(chunk, y0, x0):
    """Indices of the receivers in lanes 0, 4, 8 and 12 of a tile, each followed by those of the next three lanes."""
    return (
        place_of(chunk, y0, x0, 0),
        place_of(chunk, y0, x0, 4),
        place_of(chunk, y0, x0, 8),
        place_of(chunk, y0, x0, 12),
    )


@inlined
def _bytes_at(p, at):
    """Four bytes as an int32, in 4 lanes."""
    return splat4(get(as_i32(ptr_at(p, at)), 0))


@inlined
def rows_of_block(first, w):
    """The quarters of the 4 x 4 pixels from pixel `first` on, in rows of w."""
    return first, first + w, first + 2 * w, first + 3 * w


@inlined
def sides_in_quarters(p, quarters):
    """The sides of 16 receivers, as `points_in_quarters`, i32x16; p: pointer to int8."""
    a, b, c, d = quarters
    words = join(join(_bytes_at(p, a), _bytes_at(p, b)), join(_bytes_at(p, c), _bytes_at(p, d)))
    left = (splat16(np.int32(3)) - (iota16() & splat16(np.int32(3)))) << splat16(np.int32(3))
    return (words << left) >> splat16(np.int32(24))  # byte i of each word, with its sign


@inlined
def points_in_quarters(p, quarters, scratch):
    """16 points, three f32x16; quarters: indices of points 0, 4, 8 and 12, each followed by those of the next three.

    scratch : pointer to 48 float32
    """
    a, b, c, d = quarters
    for k in range(0, 12, 4):
        store(scratch, k, load4(p, 3 * a + k))
        store(scratch, 12 + k, load4(p, 3 * b + k))
        store(scratch, 24 + k, load4(p, 3 * c + k))
        store(scratch, 36 + k, load4(p, 3 * d + k))
    return load16x3(scratch, 0)


@inlined
def integers_in_quarters(p, quarters):
    """16 int32, as `points_in_quarters`, i32x16."""
    a, b, c, d = quarters
    return join(join(load4(p, a), load4(p, b)), join(load4(p, c), load4(p, d)))


@kernel
def _load_full(chunk, y0, x0, tile):
    """`load_receivers` of a tile that lies entirely within the picture."""
    query, quarters = chunk.query, _quarters(chunk, y0, x0)
    x, y, z = points_in_quarters(query.origins, quarters, stack_f32(48))
    store(tile.origins, 0, x)
    store(tile.origins, 16, y)
    store(tile.origins, 32, z)
    ids, sides = integers_in_quarters(query.ids, quarters), sides_in_quarters(query.sides, quarters)
    store(tile.faces, 0, ids)
    store(tile.sides, 0, select(sides == np.int32(FREE), splat16(_F(0.0)), to_f32(sides)))
    return bits(sides != np.int32(NOTHING))


@kernel
def load_receivers(chunk, y0, x0, tile):
    """Fill origins, faces and sides. Return bits of the lanes with a receiver; the other lanes may hold any values."""
    if y0 + chunk.shape.height <= chunk.query.h and x0 + chunk.shape.width <= chunk.query.w:
        return _load_full(chunk, y0, x0, tile)
    valid, lane = 0, 0
    for y in range(y0, y0 + chunk.shape.height):
        for x in range(x0, x0 + chunk.shape.width):
            at = y * chunk.query.w + x
            if y < chunk.query.h and x < chunk.query.w and get(chunk.query.sides, at) != NOTHING:
                valid |= 1 << lane
                side = get(chunk.query.sides, at)
                put(tile.origins, lane, get(chunk.query.origins, at * 3))
                put(tile.origins, 16 + lane, get(chunk.query.origins, at * 3 + 1))
                put(tile.origins, 32 + lane, get(chunk.query.origins, at * 3 + 2))
                put(tile.faces, lane, get(chunk.query.ids, at))
                put(tile.sides, lane, _F(0.0) if side == FREE else _F(side))
            lane += 1
    return valid


@inlined
def fill_lanes(tile, valid):
    """Copy one of the `valid` receivers (bits), at least one, to the other lanes."""
    if valid == 0xFFFF:
        return
    there, any_lane = mask_from_bits16(valid), lowest_bit(valid)
    for k in range(3):
        o = select(there, load16(tile.origins, 16 * k), broadcast16(tile.origins, 16 * k + any_lane))
        store(tile.origins, 16 * k, o)
    store(tile.faces, 0, select(there, load16(tile.faces, 0), splat16(np.int32(-1))))


@inlined
def bound_receivers(tile, valid):
    """`fill_lanes`, and fill `info`, which shafts need."""
    fill_lanes(tile, valid)
    for k in range(3):
        o = load16(tile.origins, 16 * k)
        low, high = reduce_min(o), reduce_max(o)
        middle, half = middle_and_half(low, high)
        put(tile.info, k, middle)
        put(tile.info, 3 + k, half)
        put(tile.info, 6 + k, low)
        put(tile.info, 9 + k, high)


@inlined
def _extent(tile, lanes, k):
    """(lower, upper bound) of the receivers in `lanes` (bits) along axis k."""
    o, there = load16(tile.origins, 16 * k), mask_from_bits16(lanes)
    return reduce_min(select(there, o, splat16(_F(np.inf)))), reduce_max(select(there, o, splat16(_F(-np.inf))))


@inlined
def _size_and_axis(tile, lanes):
    """(sum of the extents of the receivers' box, its longest axis)."""
    size, longest, axis = _F(0.0), _F(-1.0), 0
    for k in range(3):
        low, high = _extent(tile, lanes, k)
        size += high - low
        if high - low > longest:
            longest, axis = high - low, k
    return size, axis


@kernel
def _below_gap(tile, lanes, axis):
    """Bits of the receivers in `lanes` below the widest gap between their coordinates along an axis."""
    infinite = splat16(_F(np.inf))
    x = select(mask_from_bits16(lanes), load16(tile.origins, 16 * axis), infinite)
    above, remaining = infinite, lanes  # above: the next larger coordinate
    while remaining != 0:
        other = broadcast16(tile.origins, 16 * axis + lowest_bit(remaining))
        remaining &= remaining - 1
        above = minimum(above, select(other > x, other, infinite))
    gap = select(above < infinite, above - x, splat16(_F(-1.0)))
    widest = gap >= splat16(reduce_max(gap))
    return bits(x <= splat16(reduce_min(select(widest, x, infinite)))) & lanes


@kernel
def coherent_part(tile, lanes, light):
    """Bits of the receivers to trace together with the first of `lanes`: all, or those near it.

    A receivers' box of size s and a light's box of size l span a shaft of width s + l. The box is divided while the
    shafts of its parts are clearly narrower in sum. It is divided at the widest gap between receivers: of three distant
    places, two in one half would make it almost as wide as the whole. Receivers on one triangle are not divided.

    light : the light's size, or a fraction of it, because most blocks are close to the receivers
    """
    face = get(tile.faces, lowest_bit(lanes))
    if face >= 0 and bits(load16(tile.faces, 0) == face) & lanes == lanes:
        return lanes
    size, axis = _size_and_axis(tile, lanes)
    while _F(2.0) * light <= SPLIT * (size + light):
        lower = _below_gap(tile, lanes, axis)
        upper = lanes & ~lower
        if upper == 0:
            return lanes
        (a, a_axis), (b, b_axis) = _size_and_axis(tile, lower), _size_and_axis(tile, upper)
        if a + b + _F(2.0) * light > SPLIT * (size + light):
            return lanes
        if lanes & -lanes & lower != 0:
            lanes, size, axis = lower, a, a_axis
        else:
            lanes, size, axis = upper, b, b_axis
    return lanes


@inlined
def _patches_of(chunk, y0, x0, valid, patches):
    """Write the patches of a tile's receivers: rows of base, u, v, w of 16 lanes. Other lanes repeat a valid one."""
    for lane in range(16):
        there = lane if valid >> lane & 1 else lowest_bit(valid)
        patch = patch_of(chunk.query, place_of(chunk, y0, x0, there))
        for k in range(12):
            put(patches, 16 * k + lane, patch[k])


@inlined
def _points(samples, at, p, u, v, w):
    """One coordinate of 16 samples of patches, f32x16, as `sample_point` computes it; f64x16."""
    a, b, c = load16(samples, at), load16(samples, at + 16), load16(samples, at + 32)
    return to_f32(((p + a * u) + b * v) + c * w)


@kernel
def move_light(chunk, y0, x0, valid, tile):
    """Write the sample points of a light that moves with the receiver to the tile's own memory.

    Each point is computed twice, by stratum and by lane, because a transposition would take longer. The sums are those
    of `sample_point`.
    """
    patches = stack_f64(12 * 16)
    _patches_of(chunk, y0, x0, valid, patches)
    for k in range(3):
        p, u = load16(patches, 16 * k), load16(patches, 16 * (3 + k))
        v, w = load16(patches, 16 * (6 + k)), load16(patches, 16 * (9 + k))
        for at in range(0, 48 * chunk.n_samples, 48):
            store(tile.points, at + 16 * k, _points(chunk.samples, at, p, u, v, w))
    for lane in range(16):
        for k in range(3):
            p, u = broadcast16(patches, 16 * k + lane), broadcast16(patches, 16 * (3 + k) + lane)
            v, w = broadcast16(patches, 16 * (6 + k) + lane), broadcast16(patches, 16 * (9 + k) + lane)
            store(tile.by_lane, 48 * lane + 16 * k, _points(chunk.samples_by_lane, 48 * lane, p, u, v, w))
    bound_strata(tile.by_lane, tile.groups)
    bound_targets(tile.points, tile.targets, chunk.n_samples)


@inlined
def with_blocked(dead, lanes, one):
    """A row of `dead` with the bits `one` (splat) added in some lanes (bits).

    Rows are written as a whole, never number by number: reading the row next would stall on the narrow stores.
    """
    return dead | select(mask_from_bits16(lanes), one, splat16(np.int32(0)))


@inlined
def finished_strata(tile, valid):
    """Bits of the strata to which all segments from `valid` receivers (bits) are blocked."""
    v = splat16(np.int32(valid))
    return bits((load16(tile.dead, 0) & v) == v)


@inlined
def transpose_bits(source, target):
    """Transpose 16 x 16 bits, stored as 16 int32."""
    words = splat16(np.int32(0))
    for r in range(16):
        there = mask_from_bits16(get(source, r))
        words = words | select(there, splat16(np.int32(1 << r)), splat16(np.int32(0)))
    store(target, 0, words)


@kernel
def read_bits(chunk, y0, x0, valid, tile, known):
    """Initialise `dead` from the known blocked segments of a chunk, receivers -> strata: the inverse of `write_bits`.

    known : pointer to the bits of all receivers
    """
    shift, word, absent = (
        np.uint64(chunk.first & 63),
        chunk.first >> 6,
        ~((1 << chunk.n_samples) - 1),
    )
    store(tile.dead, 0, splat16(np.int32(-1)))
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        at = place_of(chunk, y0, x0, lane) * chunk.query.words + word
        put(tile.dead, lane, np.int64(get(known, at) >> shift) & 0xFFFF | absent)
    transpose_bits(tile.dead, tile.dead)


@kernel
def write_bits(chunk, y0, x0, valid, tile, out):
    """Set the bits of a chunk's blocked segments, strata -> receivers.

    out : pointer to the bits of all receivers, `chunk.query.words` uint64 each
    """
    shift, word, known = (
        np.uint64(chunk.first & 63),
        chunk.first >> 6,
        (1 << chunk.n_samples) - 1,
    )
    if bits((load16(tile.dead, 0) & splat16(np.int32(valid))) != 0) & known == 0:
        return
    if chunk.n_samples == 1:
        valid &= get(tile.dead, 0)
        store(tile.dead, 0, splat16(np.int32(1)))
    else:
        transpose_bits(tile.dead, tile.dead)
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        at = place_of(chunk, y0, x0, lane) * chunk.query.words + word
        put(out, at, get(out, at) | np.uint64(get(tile.dead, lane) & known) << shift)
