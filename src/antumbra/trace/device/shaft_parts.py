"""Tiles of 16 receivers on a device, and their coherent parts, which shafts are made of.

The rule is the CPU's (`tile.coherent_part`): a tile whose receivers lie in several places, as at silhouettes, is cut at
the widest gaps between them. The first part of each tile is in the order of the tiles, a Z curve, so that parts that
are traced together are neighbours. The other parts follow, in the order in which threads find them.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import Reach
from ...kernels.device import atomic_add, thread_index
from ...kernels.exact.filters import larger, smaller
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import get, i32_at, lowest_bit, put, stack_f32, stack_i32
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery
from ...scene.lights import FIXED
from ..frusta.tile_clusters import even_bits
from ..packets.ray_tile import is_huge, is_incoherent, sample_extents
from ..tile import SPLIT
from .device_rays import receiver_at
from .device_traversal import PARTS

SQUARE = 8  # tiles in a row of a square, which is in Z order; a tile of a picture is 4 x 4 pixels
PART = 2  # int32 of a part: the tile's first receiver, counted from the chunk's first one, and bits of the receivers

_SIDE = 4 * SQUARE  # receivers
_LIGHT = 2.0**-8  # as in `tile.query_chunk_of`
_INF = np.float32(np.inf)


class ShaftTiles(NamedTuple):
    """How the receivers of a chunk are cut into tiles, and the list of parts: an address on the device, and numbers."""

    parts: int  # int32, PART per part
    n: int  # number of tiles, or of parts
    columns: int  # squares per row; 0: the receivers form a single row, and tiles are 16 of them
    first: int  # the chunk's first receiver
    receivers: int  # number of receivers in the chunk
    light: float  # a small fraction of the light's size, or 0


@inlined
def receiver_of(tiles, width, at, lane):
    """The receiver of a lane of the tile whose first receiver is `at`; width: receivers per row of the query."""
    return at + lane if tiles.columns == 0 else at + (lane >> 2) * width + (lane & 3)


def suits_shafts(reach: Reach, query: ShadowQuery) -> bool:
    """Whether shafts are narrow enough, by the CPU's rules for `multifrusta`; reach: of the tree."""
    extents = 2 * np.array(reach)  # of a box around the frame's origin
    return not (is_incoherent(query) or is_huge(query, extents))


def tiles_of(query: ShadowQuery, first: int, receivers: int) -> ShaftTiles:
    """The tiles of some receivers of a query, from the `first` on, without the memory of their parts."""
    h, w = query.shape
    light = float(_LIGHT * sample_extents(query)[1]) if query.light.kind == FIXED else 0.0
    if h == 1:
        return ShaftTiles(0, -(-receivers // 16), 0, first, receivers, light)
    columns, rows = -(-w // _SIDE), (first + receivers - 1) // w - first // w + 1
    return ShaftTiles(0, columns * -(-rows // _SIDE) * SQUARE * SQUARE, columns, first, receivers, light)


def parts_bytes(tiles: ShaftTiles) -> int:
    """The memory of the parts of tiles, however many there are: one per tile, or at most one per receiver beyond."""
    return 4 * PART * (tiles.n + tiles.receivers)


def whole_squares(receivers: int, query: ShadowQuery) -> int:
    """At most this number of receivers, such that chunks of them end between squares of tiles, if that is possible."""
    h, w = query.shape
    unit = 16 if h == 1 else _SIDE * w
    return max(receivers // unit * unit, 1) if receivers >= unit else receivers


class _Points(NamedTuple):
    """The receivers of a tile."""

    places: F32Ptr  # float32, rows of x, y, z
    ids: I32Ptr  # int32: their triangles


@inlined
def _extent(points, lanes, axis):
    low, high = _INF, -_INF
    while lanes != 0:
        x = get(points.places, 16 * axis + lowest_bit(lanes))
        lanes &= lanes - 1
        low, high = smaller(low, x), larger(high, x)
    return high - low


@inlined
def _size_and_axis(points, lanes):
    """(sum of the extents of the receivers' box, its longest axis)."""
    x, y, z = _extent(points, lanes, 0), _extent(points, lanes, 1), _extent(points, lanes, 2)
    return x + y + z, 0 if x >= y and x >= z else (1 if y >= z else 2)


@inlined
def _below_gap(points, lanes, axis):
    """Bits of the receivers below the widest gap between their coordinates along an axis."""
    widest, limit, left = np.float32(-1.0), -_INF, lanes
    while left != 0:
        x, above, others = get(points.places, 16 * axis + lowest_bit(left)), _INF, lanes
        left &= left - 1
        while others != 0:
            other = get(points.places, 16 * axis + lowest_bit(others))
            others &= others - 1
            above = smaller(above, other) if other > x else above
        if above < _INF and above - x > widest:
            widest, limit = above - x, x
    below, left = 0, lanes
    while left != 0:
        lane = lowest_bit(left)
        left &= left - 1
        if get(points.places, 16 * axis + lane) <= limit:
            below |= 1 << lane
    return below


@inlined
def _share_triangle(points, lanes):
    face = get(points.ids, lowest_bit(lanes))
    while lanes != 0:
        if face < 0 or get(points.ids, lowest_bit(lanes)) != face:
            return False
        lanes &= lanes - 1
    return True


@inlined
def _coherent_part(points, lanes, light):
    """`tile.coherent_part`, by one thread."""
    if _share_triangle(points, lanes):
        return lanes
    size, axis = _size_and_axis(points, lanes)
    while np.float32(2.0) * light <= SPLIT * (size + light):
        lower = _below_gap(points, lanes, axis)
        upper = lanes & ~lower
        if lower == 0 or upper == 0:
            return lanes
        (a, a_axis), (b, b_axis) = _size_and_axis(points, lower), _size_and_axis(points, upper)
        if a + b + np.float32(2.0) * light > SPLIT * (size + light):
            return lanes
        if lanes & -lanes & lower != 0:
            lanes, size, axis = lower, a, a_axis
        else:
            lanes, size, axis = upper, b, b_axis
    return lanes


@inlined
def _corner_of(tiles, width, tile):
    """(the first receiver of a tile, its column)."""
    if tiles.columns == 0:
        return tiles.first + 16 * tile, 0
    square, code = tile >> 6, tile & 63
    y = tiles.first // width + 4 * (square // tiles.columns * SQUARE + even_bits(code >> 1))
    x = 4 * (square % tiles.columns * SQUARE + even_bits(code))
    return y * width + x, x


@inlined
def _load(rays, tiles, at, column, points):
    """Load the receivers of a tile. Return bits of the lanes that have one."""
    there = 0
    for lane in range(16):
        i = receiver_of(tiles, rays.w, at, lane)
        in_row = tiles.columns == 0 or column + (lane & 3) < rays.w
        if in_row and i >= tiles.first and i < tiles.first + tiles.receivers:
            r = receiver_at(rays, i)
            if r.side != NOTHING:
                there |= 1 << lane
                put(points.ids, lane, r.id)
                for axis in range(3):
                    put(points.places, 16 * axis + lane, r.o[axis])
    return there


@inlined
def _put_part(tiles, k, at, lanes):
    put(i32_at(tiles.parts), PART * k, at - tiles.first)
    put(i32_at(tiles.parts), PART * k + 1, lanes)


@kernel
def find_parts(rays, work, tiles):  # rays: SampleBuffers, work: Work, tiles: ShaftTiles
    """List the parts of each tile: its last one at its own place, perhaps empty, and others behind those of all tiles.

    How many of the latter there are is counted (`Work.counts`).
    """
    tile, points = thread_index(), _Points(stack_f32(48), stack_i32(16))
    if tile >= tiles.n:
        return
    at, column = _corner_of(tiles, rays.w, tile)
    left = _load(rays, tiles, at, column, points)
    while left != 0:
        part = _coherent_part(points, left, np.float32(tiles.light))
        if part == left:
            break
        _put_part(tiles, tiles.n + np.int64(atomic_add(i32_at(work.counts), PARTS, 1)), at, part)
        left &= ~part
    _put_part(tiles, tile, at, left)
