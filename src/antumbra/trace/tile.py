"""A tile: 16 receivers and a chunk of light samples, prepared for tracing.

Lane i of a tile is a receiver. Their segments are asked stratum by stratum: those of one stratum are 16 rays that start
and end near each other, and lie in one shaft.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..query.receivers import FREE, NOTHING
from ..query.samples import sample_point
from ..query.shadow import patch_of
from ..simd import (
    absolute,
    as_i32,
    bits,
    broadcast16,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    popcount,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    store,
)
from .counters import BELOW_HORIZON, RAYS, count
from .lighttable import ALL_GROUPS, GROUPS, POINTS, STRATA, bound_groups
from .shafts import SHAFT_FLOATS

_F = np.float32
_INFO, _FACES, _DEAD, _SHAFTS = 48, 64, 80, 96
_OWN = _SHAFTS + SHAFT_FLOATS  # floats of a tile besides its light samples
TILE_FLOATS = _OWN + POINTS + GROUPS
_U = _F(64 * 2.0**-24)
_TINY = _F(1e-37)
SPLIT, _LIGHT = _F(0.75), _F(2.0**-6)


class Tile(NamedTuple):
    """Where a tile's numbers are: pointers into float32 scratch memory, or the light table's."""

    number: int  # in its bundle
    origins: object  # x, y, z of 16 receivers; lanes without one repeat another
    info: object  # 0..2 centre, 3..5 half extents of the receivers' box, 6..8 its lower, 9..11 upper corner
    faces: object  # int32: the receivers' own triangles
    dead: object  # int32, one a stratum: bits of the receivers whose segment is blocked
    shafts: object  # see `shafts`
    points: object  # see `lighttable`
    groups: object


class TileShape(NamedTuple):
    """How receivers are cut into tiles: 4 x 4 pixels, or 16 of a row."""

    width: int
    height: int
    columns: int  # tiles in a row of tiles
    rows: int


def tile_shape(query) -> TileShape:
    """4 x 4 pixels; receivers that form a row are taken 16 at a time."""
    h, w = query.sides.shape
    width, height = (4, 4) if h > 1 else (16, 1)
    return TileShape(width, height, -(-w // width), -(-h // height))


def sets_of(shape) -> np.ndarray:
    """(16,) int: the sample set of each lane of a tile."""
    lane = np.arange(16)
    return (lane % shape.width & 3) + 4 * (lane // shape.width)


class Asked(NamedTuple):
    """A query's chunk for hot kernels: pointers, for each array passed on costs a reference count."""

    origins: object  # float32
    faces: object  # int32
    sides: object  # int8
    normals: object  # float64
    corners: object  # float32
    points: object  # of the chunk's light table, if the light does not move
    groups: object
    fixed: bool  # the light does not move
    h: int
    w: int
    shape: TileShape
    first: int  # sample
    count: int  # samples
    facing: int  # a value of CULL_FACES
    words: int  # uint64 of a receiver's bits
    light: float  # a small part of the sum of the light's extents


@inlined
def asked_of(query, table, shape, chunk, n_samples, fixed):
    """The `Asked` of a chunk of a query."""
    groups, light = ptr_at(ptr(table.groups), chunk * GROUPS), _F(0.0)
    if fixed:
        for k in range(3):
            light += get(groups, (3 + k) * ALL_GROUPS + 1) - get(groups, k * ALL_GROUPS + 1)
    h, w = query.sides.shape
    return Asked(
        ptr(query.origins), ptr(query.faces), ptr(query.sides), ptr(query.normals), ptr(query.corners),
        ptr_at(ptr(table.points), chunk * POINTS), groups, fixed, h, w, shape, chunk * STRATA, n_samples,
        query.cull_faces, (query.samples.shape[1] + 63) >> 6, light * _LIGHT,
    )  # fmt: skip


@inlined
def tile_at(scratch, g, asked):
    """`Tile` number g of a bundle."""
    own = ptr_at(scratch, g * TILE_FLOATS)
    points, groups = ptr_at(own, _OWN), ptr_at(own, _OWN + POINTS)
    if asked.fixed:
        points, groups = asked.points, asked.groups
    faces, dead = as_i32(ptr_at(own, _FACES)), as_i32(ptr_at(own, _DEAD))
    return Tile(np.int64(g), own, ptr_at(own, _INFO), faces, dead, ptr_at(own, _SHAFTS), points, groups)


@inlined
def middle_and_half(low, high):
    """(middle, half extent) of an interval of float32, so that middle -+ half holds it."""
    middle = _F(0.5) * low + _F(0.5) * high
    half = high - middle if high - middle > middle - low else middle - low
    return middle, half * _F(1.0 + 2.0**-22)


@kernel
def load_receivers(asked, y0, x0, tile):
    """Fill origins and faces; bits of the lanes that hold a receiver."""
    valid, lane = np.int64(0), np.int64(0)
    for y in range(y0, y0 + asked.shape.height):
        for x in range(x0, x0 + asked.shape.width):
            at = y * asked.w + x
            if y < asked.h and x < asked.w and np.int64(get(asked.sides, at)) != NOTHING:
                valid |= np.int64(1) << lane
                put(tile.origins, lane, get(asked.origins, at * 3))
                put(tile.origins, 16 + lane, get(asked.origins, at * 3 + 1))
                put(tile.origins, 32 + lane, get(asked.origins, at * 3 + 2))
                put(tile.faces, lane, get(asked.faces, at))
            lane += 1
    return valid


@inlined
def bound_receivers(tile, valid):
    """Fill info from some of the lanes, at least one; the others repeat one of them."""
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
    """(sum of the extents of the receivers' box, the lanes in its lower half along its longest axis)."""
    size, longest, at, middle = _F(0.0), _F(-1.0), 0, _F(0.0)
    for k in range(3):
        low, high = _extent(tile, lanes, k)
        size += high - low
        if high - low > longest:
            longest, at, middle = high - low, k, _F(0.5) * low + _F(0.5) * high
    return size, bits(load16(tile.origins, 16 * at) <= middle) & lanes


@kernel
def coherent_part(tile, lanes, light):
    """The receivers to trace with the first of `lanes`: all, or, where they lie in places far apart, those near it.

    One shaft of width s + l (s: the receivers' box, l: the light's) is split where two, of the receivers in either
    half of the box, would be clearly narrower together.
    """
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


@kernel
def move_light(query, y0, x0, shape, chunk, valid, tile, n_strata):
    """The samples of a light that moves with the receiver, into the tile's own memory."""
    for lane in range(16):
        there = lane if valid >> lane & 1 else lowest_bit(valid)
        y, x = y0 + there // shape.width, x0 + there % shape.width
        patch = patch_of(query, y, x)
        for s in range(n_strata):
            a, b, c = query.samples[(x & 3) + 4 * (y & 3), chunk * STRATA + s]
            px, py, pz = sample_point(patch, a, b, c)
            put(tile.points, s * 48 + lane, px)
            put(tile.points, s * 48 + 16 + lane, py)
            put(tile.points, s * 48 + 32 + lane, pz)
    bound_groups(tile.points, tile.groups, n_strata)


@inlined
def place_of(asked, y0, x0, lane):
    """Index of a lane's receiver among all, row by row."""
    return (y0 + lane // asked.shape.width) * asked.w + x0 + lane % asked.shape.width


@kernel
def _gather_planes(asked, y0, x0, valid, planes):
    """Rows of `planes`: a point of each receiver's plane (3), a normal (3), the side seen, what scales its error."""
    corners, lanes = asked.corners, valid
    while lanes != 0:
        lane = lowest_bit(lanes)
        lanes &= lanes - 1
        at = place_of(asked, y0, x0, lane)
        side, face = np.int64(get(asked.sides, at)), np.int64(get(asked.faces, at))
        nx, ny, nz, size = _F(0.0), _F(0.0), _F(0.0), _F(0.0)
        k = face * 9
        if face >= 0:
            vx, vy, vz = get(corners, k), get(corners, k + 1), get(corners, k + 2)
            px, py, pz = get(corners, k + 3) - vx, get(corners, k + 4) - vy, get(corners, k + 5) - vz
            qx, qy, qz = get(corners, k + 6) - vx, get(corners, k + 7) - vy, get(corners, k + 8) - vz
            nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
            size = abs(px) + abs(py) + abs(pz) + abs(qx) + abs(qy) + abs(qz)
            size *= size
        else:
            k = at * 3
            vx, vy, vz = get(asked.origins, k), get(asked.origins, k + 1), get(asked.origins, k + 2)
            if side != FREE:
                nx, ny, nz = _F(get(asked.normals, k)), _F(get(asked.normals, k + 1)), _F(get(asked.normals, k + 2))
                size = abs(nx) + abs(ny) + abs(nz)
        put(planes, lane, vx)
        put(planes, 16 + lane, vy)
        put(planes, 32 + lane, vz)
        put(planes, 48 + lane, nx)
        put(planes, 64 + lane, ny)
        put(planes, 80 + lane, nz)
        put(planes, 96 + lane, _F(0.0) if side == FREE else _F(side))
        put(planes, 112 + lane, size)


@inlined
def _height(planes, lx, ly, lz):
    """(height of light points over the lanes' planes on the seen side, bound of its error)."""
    ax, ay, az = lx - load16(planes, 0), ly - load16(planes, 16), lz - load16(planes, 32)
    h = load16(planes, 48) * ax + load16(planes, 64) * ay + load16(planes, 80) * az
    reach = maximum(maximum(absolute(ax), absolute(ay)), absolute(az))
    return h * load16(planes, 96), load16(planes, 112) * _U * reach + _TINY * (reach + _F(1.0))


@inlined
def _whole_light(tile, k):
    return middle_and_half(get(tile.groups, k * ALL_GROUPS + 1), get(tile.groups, (3 + k) * ALL_GROUPS + 1))


@kernel
def apply_horizon(asked, y0, x0, valid, tile, planes, aside, counters):
    """Start `dead`: segments to samples that are not above the receiver's own surface are blocked by it.

    What float32 cannot say is put aside.
    """
    blank = splat16(np.int32(0))
    store(tile.dead, 0, blank)
    count(counters, RAYS, asked.count * popcount(valid))
    _gather_planes(asked, y0, x0, valid, planes)
    sided = bits(load16(planes, 96) != _F(0.0)) & valid
    if sided == 0:
        return
    lx, rx = _whole_light(tile, 0)
    ly, ry = _whole_light(tile, 1)
    lz, rz = _whole_light(tile, 2)
    h, error = _height(planes, splat16(lx), splat16(ly), splat16(lz))
    reach = absolute(load16(planes, 48)) * rx + absolute(load16(planes, 64)) * ry + absolute(load16(planes, 80)) * rz
    spread = rx + ry + rz
    far = reach * _F(1.0001) + error + load16(planes, 112) * (_U * spread)
    crossing = sided & ~bits(h > far)
    if crossing == 0:
        return
    for s in range(asked.count):
        at = s * 48
        h, error = _height(planes, load16(tile.points, at), load16(tile.points, at + 16), load16(tile.points, at + 32))
        below = bits(h < -error) & crossing
        put_aside(aside, tile, np.int64(-1), s, crossing & ~below & ~bits(h > error))
        count(counters, BELOW_HORIZON, popcount(below))
        put(tile.dead, s, below)


@inlined
def put_aside(aside, tile, slot, s, unsure):
    """Note the segments from the `unsure` receivers (bits) to stratum s, and the triangle in `slot`, for later.

    slot -1 asks whether the sample is above the receiver's own surface.
    """
    n = np.int64(get(aside, 0))
    while unsure != 0:
        put(aside, 2 + 2 * n, slot)
        put(aside, 3 + 2 * n, tile.number << 8 | s << 4 | lowest_bit(unsure))
        unsure &= unsure - 1
        n += 1
    put(aside, 0, n)


@kernel
def write_bits(asked, y0, x0, valid, tile, finished, out):
    """Set the bits of a chunk's blocked segments, strata -> receivers; all of the `finished` strata's are blocked.

    out : pointer to the bits of all receivers, `asked.words` uint64 each
    """
    words = splat16(np.int32(0))
    for s in range(asked.count):
        blocked = mask_from_bits16(np.int64(get(tile.dead, s)) | -(finished >> s & 1))
        words = words | select(blocked, splat16(np.int32(1 << s)), splat16(np.int32(0)))
    store(tile.dead, 0, words)
    shift, word = np.uint64(asked.first & 63), asked.first >> 6
    while valid != 0:
        lane = lowest_bit(valid)
        valid &= valid - 1
        at = place_of(asked, y0, x0, lane) * asked.words + word
        put(out, at, get(out, at) | np.uint64(np.int64(get(tile.dead, lane)) & 0xFFFF) << shift)
