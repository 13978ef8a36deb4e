"""A tile: 16 receivers and a chunk of up to 16 light samples per receiver, prepared for tracing.

Queries are cut into tiles and chunks; this is the form in which the hot kernels read them.

Lane i of a tile is a receiver. Its segments are traced stratum by stratum. The 16 segments to one stratum start and end
near each other, so they lie in one shaft.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import middle_and_half
from ..kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel
from ..kernels.simd import (
    as_i32,
    bits,
    broadcast16,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    prefetch,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_f64,
    store,
    to_f32,
)
from ..query.receivers import NOTHING
from ..query.shadow_query import QueryPointers, patch_of, query_pointers
from .light_table import ALL_GROUPS, GROUPS, POINTS, STRATA, TARGETS, bound_strata, bound_targets, stays
from .shafts import BEAM_FLOATS, INVERSE_FLOATS, SHAFT_FLOATS

# --- A query in the form of the hot kernels: cut into tiles of 16 receivers and chunks of 16 samples ------------------


_F = np.float32
_LIGHT = _F(2.0**-6)


class TileShape(NamedTuple):
    """How receivers are cut into tiles: 4 x 4 pixels, or 16 of a row."""

    width: int  # receivers in a row of a tile
    height: int  # rows of receivers in a tile
    columns: int  # tiles in a row
    rows: int  # rows of tiles


def tile_shape(query) -> TileShape:
    """The `TileShape` of a query: 4 x 4 pixels, or 16 receivers if they form a single row."""
    h, w = query.sides.shape
    width, height = (4, 4) if h > 1 else (16, 1)
    return TileShape(width, height, -(-w // width), -(-h // height))


def sets_of(shape) -> np.ndarray:
    """(16,) int: the sample set of each lane of a tile."""
    lane = np.arange(16)
    return (lane % shape.width & 3) + 4 * (lane // shape.width)


class QueryChunk(NamedTuple):
    """A query's chunk for hot kernels."""

    query: QueryPointers
    points: F32Ptr  # float32 * into the chunk's light table, like the next three; unused if the light moves
    groups: F32Ptr  # float32 *
    targets: F32Ptr  # float32 *
    by_lane: F32Ptr  # float32 *
    samples: F64Ptr  # float64 * into the chunk's light table, like the next; unused if the light stays
    turned: F64Ptr  # float64 *
    fixed: bool  # the light does not move with the receiver
    shape: TileShape
    first: int  # first sample
    count: int  # number of samples
    light: float  # a small part of the sum of the light's extents


@inlined
def query_chunk_of(query, table, shape, chunk, n_samples):
    """The `QueryChunk` of a chunk of a query."""
    groups, light, fixed = ptr_at(ptr(table.groups), chunk * GROUPS), _F(0.0), stays(query.light)
    moving = 0 if fixed else POINTS
    if fixed:
        for k in range(3):
            light += get(groups, (3 + k) * ALL_GROUPS + 1) - get(groups, k * ALL_GROUPS + 1)
    return QueryChunk(
        query_pointers(query), ptr_at(ptr(table.points), chunk * POINTS), groups,
        ptr_at(ptr(table.targets), chunk * TARGETS), ptr_at(ptr(table.by_lane), chunk * POINTS),
        ptr_at(ptr(table.samples), chunk * moving), ptr_at(ptr(table.turned), chunk * moving), fixed, shape,
        chunk * STRATA, n_samples, light * _LIGHT,
    )  # fmt: skip


@inlined
def place_of(chunk, y0, x0, lane):
    """Index of a lane's receiver among all receivers, row by row."""
    if chunk.shape.height == 1:
        return y0 * chunk.query.w + x0 + lane
    return (y0 + (lane >> 2)) * chunk.query.w + x0 + (lane & 3)  # a division by the width would take longer


# --- A tile: 16 receivers and a chunk of light samples, prepared for tracing ------------------------------------------
#
# Lane i of a tile is a receiver. Its segments are traced stratum by stratum. The 16 segments to one stratum start and
# end near each other, so they lie in one shaft.


_INFO, _FACES, _DEAD, _SHAFTS = 48, 64, 80, 96
_BEAMS = _SHAFTS + SHAFT_FLOATS
_OWN = _BEAMS + BEAM_FLOATS  # floats of a tile besides its light samples
_INVERSES = _OWN + 2 * POINTS + GROUPS + TARGETS
TILE_FLOATS = _INVERSES + INVERSE_FLOATS
SPLIT = _F(0.75)


class Tile(NamedTuple):
    """Pointers to a tile's numbers in float32 scratch memory, or in the light table."""

    number: int  # in its bundle
    origins: F32Ptr  # float32: x, y, z of 16 receivers; lanes without a receiver repeat another one
    info: F32Ptr  # float32: 0..2 centre, 3..5 half extents, 6..8, 9..11 corners of the receivers' box; 12: see `shafts`
    faces: I32Ptr  # int32: the receivers' own triangles, by the trees' indices
    dead: I32Ptr  # int32, one a stratum: bits of the receivers whose segment is blocked; all bits if it has no sample
    shafts: F32Ptr  # float32, see `shafts`
    beams: F32Ptr  # float32, see `beams`
    points: F32Ptr  # float32, see `lighttable`, like the next three
    groups: F32Ptr  # float32
    targets: F32Ptr  # float32
    by_lane: F32Ptr  # float32
    inverses: F32Ptr  # float32, see `segmentbox`


@inlined
def tile_at(scratch, g, chunk):
    """`Tile` number g of a bundle."""
    own = ptr_at(scratch, g * TILE_FLOATS)
    points, groups, targets = ptr_at(own, _OWN), ptr_at(own, _OWN + POINTS), ptr_at(own, _OWN + POINTS + GROUPS)
    by_lane = ptr_at(own, _OWN + POINTS + GROUPS + TARGETS)
    if chunk.fixed:
        points, groups, targets, by_lane = (
            chunk.points,
            chunk.groups,
            chunk.targets,
            chunk.by_lane,
        )
    return Tile(
        np.int64(g), own, ptr_at(own, _INFO), as_i32(ptr_at(own, _FACES)), as_i32(ptr_at(own, _DEAD)),
        ptr_at(own, _SHAFTS), ptr_at(own, _BEAMS), points, groups, targets, by_lane, ptr_at(own, _INVERSES),
    )  # fmt: skip


@inlined
def first_pixel(pixels, g):
    """(y, x) of the first pixel of tile g of a bundle; `pixels`: int32, y and x of each tile."""
    return np.int64(get(pixels, 2 * g)), np.int64(get(pixels, 2 * g + 1))


@inlined
def fetch_receivers(chunk, y0, x0):
    """Prefetch what `load_receivers` reads. A tile's rows are far apart in memory."""
    for y in range(y0, y0 + chunk.shape.height):
        at = y * chunk.query.w + x0
        prefetch(chunk.query.sides, at)
        prefetch(chunk.query.ids, at)
        prefetch(chunk.query.origins, at * 3)
        prefetch(chunk.query.origins, at * 3 + 11)


@kernel
def load_receivers(chunk, y0, x0, tile):
    """Fill origins and faces. Return bits of the lanes that hold a receiver."""
    valid, lane = np.int64(0), np.int64(0)
    for y in range(y0, y0 + chunk.shape.height):
        for x in range(x0, x0 + chunk.shape.width):
            at = y * chunk.query.w + x
            if y < chunk.query.h and x < chunk.query.w and np.int64(get(chunk.query.sides, at)) != NOTHING:
                valid |= np.int64(1) << lane
                put(tile.origins, lane, get(chunk.query.origins, at * 3))
                put(tile.origins, 16 + lane, get(chunk.query.origins, at * 3 + 1))
                put(tile.origins, 32 + lane, get(chunk.query.origins, at * 3 + 2))
                put(tile.faces, lane, get(chunk.query.ids, at))
            lane += 1
    return valid


@inlined
def bound_receivers(tile, valid):
    """Fill `info` from the `valid` lanes, at least one. The other lanes then repeat one of them."""
    there, any_lane = mask_from_bits16(valid), lowest_bit(valid)
    for k in range(3):
        o = select(there, load16(tile.origins, 16 * k), broadcast16(tile.origins, 16 * k + any_lane))
        store(tile.origins, 16 * k, o)
        low, high = reduce_min(o), reduce_max(o)
        middle, half = middle_and_half(low, high)
        put(tile.info, k, middle)
        put(tile.info, 3 + k, half)
        put(tile.info, 6 + k, low)
        put(tile.info, 9 + k, high)
    store(tile.faces, 0, select(there, load16(tile.faces, 0), splat16(np.int32(-1))))


@inlined
def _extent(tile, lanes, k):
    """(lower, upper bound) of the receivers in some lanes along axis k."""
    o, there = load16(tile.origins, 16 * k), mask_from_bits16(lanes)
    return reduce_min(select(there, o, splat16(_F(np.inf)))), reduce_max(select(there, o, splat16(_F(-np.inf))))


@kernel
def _size_and_halves(tile, lanes):
    """(sum of the extents of the receivers' box, bits of the lanes in its lower half along its longest axis)."""
    size, longest, at, middle = _F(0.0), _F(-1.0), 0, _F(0.0)
    for k in range(3):
        low, high = _extent(tile, lanes, k)
        size += high - low
        if high - low > longest:
            longest, at, middle = high - low, k, _F(0.5) * low + _F(0.5) * high
    return size, bits(load16(tile.origins, 16 * at) <= middle) & lanes


@kernel
def coherent_part(tile, lanes, light):
    """Bits of the receivers to trace together with the first of `lanes`: all, or those near it.

    The receivers' box of size s and the light's box of size l give one shaft of width s + l. The box is halved while
    the two shafts of its halves are clearly narrower together. Receivers on one triangle need no halves.
    """
    face = get(tile.faces, lowest_bit(lanes))
    if face >= 0 and bits(load16(tile.faces, 0) == face) & lanes == lanes:
        return lanes
    while lanes & (lanes - 1) != 0:
        size, lower = _size_and_halves(tile, lanes)
        upper = lanes & ~lower
        if lower == 0 or upper == 0:
            return lanes
        a, b = _size_and_halves(tile, lower)[0], _size_and_halves(tile, upper)[0]
        if a + b + _F(2.0) * light > SPLIT * (size + light):
            return lanes
        lanes = lower if lanes & -lanes & lower != 0 else upper
    return lanes


@inlined
def _patches_of(chunk, y0, x0, valid, patches):
    """Write the patches of a tile's receivers: rows of base, u, v, w, 16 lanes each. Other lanes repeat a valid one."""
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
    """Write the samples of a light that moves with the receiver to the tile's own memory.

    Each point is computed twice, for its stratum and for its lane: a transposition would take longer. The sums are
    those of `sample_point`.
    """
    patches = stack_f64(12 * 16)
    _patches_of(chunk, y0, x0, valid, patches)
    for k in range(3):
        p, u = load16(patches, 16 * k), load16(patches, 16 * (3 + k))
        v, w = load16(patches, 16 * (6 + k)), load16(patches, 16 * (9 + k))
        for at in range(0, 48 * chunk.count, 48):
            store(tile.points, at + 16 * k, _points(chunk.samples, at, p, u, v, w))
    for lane in range(16):
        for k in range(3):
            p, u = broadcast16(patches, 16 * k + lane), broadcast16(patches, 16 * (3 + k) + lane)
            v, w = broadcast16(patches, 16 * (6 + k) + lane), broadcast16(patches, 16 * (9 + k) + lane)
            store(tile.by_lane, 48 * lane + 16 * k, _points(chunk.turned, 48 * lane, p, u, v, w))
    bound_strata(tile.by_lane, tile.groups)
    bound_targets(tile.points, tile.targets, chunk.count)


@inlined
def with_blocked(dead, lanes, one):
    """A row of `dead` with the bits `one` (splat) added in some lanes (bits).

    Whole rows are written, never single numbers of them: a row that is read next would wait until they are in memory.
    """
    return dead | select(mask_from_bits16(lanes), one, splat16(np.int32(0)))


@inlined
def finished_strata(tile, valid):
    """Bits of the strata to which the segments from all `valid` receivers (bits) are blocked."""
    v = splat16(np.int32(valid))
    return bits((load16(tile.dead, 0) & v) == v)


@inlined
def turn_bits(source, target):
    """Transpose 16 x 16 bits, kept as 16 int32."""
    words = splat16(np.int32(0))
    for r in range(16):
        there = mask_from_bits16(np.int64(get(source, r)))
        words = words | select(there, splat16(np.int32(1 << r)), splat16(np.int32(0)))
    store(target, 0, words)


@kernel
def read_bits(chunk, y0, x0, valid, tile, known):
    """Start `dead` from the segments of a chunk known to be blocked, receivers -> strata: the inverse of `write_bits`.

    known : pointer to the bits of all receivers
    """
    shift, word, absent = (
        np.uint64(chunk.first & 63),
        chunk.first >> 6,
        ~((np.int64(1) << chunk.count) - 1),
    )
    store(tile.dead, 0, splat16(np.int32(-1)))
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        at = place_of(chunk, y0, x0, lane) * chunk.query.words + word
        put(tile.dead, lane, np.int64(get(known, at) >> shift) & 0xFFFF | absent)
    turn_bits(tile.dead, tile.dead)


@kernel
def write_bits(chunk, y0, x0, valid, tile, out):
    """Set the bits of a chunk's blocked segments, strata -> receivers.

    out : pointer to the bits of all receivers, `chunk.query.words` uint64 each
    """
    shift, word, known = (
        np.uint64(chunk.first & 63),
        chunk.first >> 6,
        (np.int64(1) << chunk.count) - 1,
    )
    if bits((load16(tile.dead, 0) & splat16(np.int32(valid))) != 0) & known == 0:
        return
    turn_bits(tile.dead, tile.dead)
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        at = place_of(chunk, y0, x0, lane) * chunk.query.words + word
        put(out, at, get(out, at) | np.uint64(np.int64(get(tile.dead, lane)) & known) << shift)
