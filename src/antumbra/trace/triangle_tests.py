"""Ray-triangle tests in float32, 16 rays at a time, and deferred tests for what float32 cannot decide.

A test is decided only beyond the error bounds of `predicate.filters`. Coordinates are not limited, so bounds are
arranged to overflow before any number that they bound, and an infinite bound leaves the test undecided.
docs/design/exactness.md derives the bounds.

Undecided tests are deferred until their tile is finished or their memory runs low, which keeps exact code out of the
hot kernels. A ray that another triangle blocks in the meantime needs no exact test.
"""

from typing import NamedTuple

import numpy as np

from ..bvh.block_tree import BlockPointers
from ..bvh.nodes import ROWS, block_leaf, line_at, row_at, rows_at, slot_at, slots_at
from ..kernels.exact.predicate import segment
from ..kernels.jit import F32Ptr, F32x16, I32Ptr, inlined, kernel
from ..kernels.simd import (
    absolute,
    bits,
    broadcast16,
    flip_sign,
    fma,
    get,
    lowest_bit,
    maximum,
    minimum,
    prefetch,
    ptr_at,
    put,
    splat16,
    store,
)
from ..kernels.vec3 import (
    Vec3,
    broadcasts,
    cross,
    crosses,
    dot,
    dots,
    get3,
    largest,
    rows,
    splats,
    store3,
    subtract3,
    total,
)
from ..query.shadow_query import horizon_of, is_above
from .counters import TRIANGLE_TESTS, UNCERTAIN, count
from .rays.ray_traversal import settle
from .tile import first_pixel, place_of, tile_at

# --- One triangle against 16 rays -------------------------------------------------------------------------------------


_F = np.float32
UNITS = 80  # units of 2^-24 in the error bounds: errors of an edge function and of D together, see `decide_signs`
_ROOM = _F(8.0)  # a product times this is at least any sum of such products
_U = _F(UNITS * 2.0**-24 / 8.0)  # relative error bound, for products multiplied by _ROOM
_TINY = _F(1e-37)
LANES = 12 * 16  # float32 of stored `Lanes`


class Triangle(NamedTuple):
    """A triangle's first corner, the edges at it, their cross product, and their largest component; float32 scalars."""

    v: Vec3
    p: Vec3
    q: Vec3
    n: Vec3
    size: float


class Lanes(NamedTuple):
    """A triangle relative to the origins of 16 rays; f32x16."""

    cp: Vec3  # a x p, where a = v0 - origin
    qc: Vec3  # q x a
    n: Vec3
    t: F32x16  # a . n
    e: F32x16  # error bound of the three edge functions
    te: F32x16  # error bound of t, and of the distance of the ray's end from the plane


@inlined
def _wider(size, v):
    x, y, z = abs(v.x), abs(v.y), abs(v.z)
    size = x if x > size else size
    size = y if y > size else size
    return z if z > size else size


@inlined
def triangle_along(v, p, q):
    """The `Triangle` of a corner and its two edges."""
    n = Vec3(p.y * q.z - p.z * q.y, p.z * q.x - p.x * q.z, p.x * q.y - p.y * q.x)
    return Triangle(v, p, q, n, _wider(_wider(_F(0.0), p), q))


@inlined
def triangle_in(corners, slot):
    """The `Triangle` in a slot of a BVH's corners."""
    k = slot * 9
    v = get3(corners, k, 1)
    return triangle_along(v, subtract3(get3(corners, k + 3, 1), v), subtract3(get3(corners, k + 6, 1), v))


@inlined
def error_bounds(reach, size, span):
    """(error bound of the edge functions, error bound of the distances from the plane), f32x16.

    reach, size : at least the largest component of v0 - origin, and of the edges at v0
    span : at least the sum of the magnitudes of a direction's components
    """
    # Eq. (12) to (14) of docs/design/exactness.md
    room, wide = size * _ROOM, maximum(reach, size)
    far = fma(span, splat16(_F(2.0)), room + _F(1.0))
    floor = fma(reach + room, far, far) * _TINY  # covers underflow; infinite wherever a product of two could overflow
    return fma(room * wide * span, splat16(_U), floor), fma(room * size * (reach + span), splat16(_U), floor)


@inlined
def lanes_from(origins, span, triangle):
    """`Lanes` of a triangle for 16 origins; span: as in `error_bounds`, f32x16."""
    a = Vec3(triangle.v.x - origins.x, triangle.v.y - origins.y, triangle.v.z - origins.z)
    e, te = error_bounds(largest(a), splat16(triangle.size), span)
    n = triangle.n
    q = triangle.q
    return Lanes(crosses(a, triangle.p), crosses(a, Vec3(-q.x, -q.y, -q.z)), splats(n), dots(a, n), e, te)


@inlined
def length1(d):
    """Sum of the magnitudes of the components, rounded up."""
    return total(d) * _F(1.0 + 2.0**-21)


@inlined
def decide_signs(e1, e2, dn, t, e, te, facing):
    """(bits of the lanes whose ray surely meets its triangle, bits of the lanes undecided in float32).

    e1, e2 : two edge functions
    dn, t : the ray's direction times the triangle's normal, and the distance of the ray's start from its plane
    e, te : error bounds of the edge functions, and of the distances
    """
    # Eq. (15) of docs/design/exactness.md
    e1, e2, t, size = flip_sign(e1, dn), flip_sign(e2, dn), flip_sign(t, dn), absolute(dn)
    low, inside = minimum(minimum(e1, e2), size - e1 - e2), minimum(t, size - t)
    hit, undecided = bits((low > e) & (inside > te)), bits((low < -e) | (inside < -te)) ^ 0xFFFF
    if facing != 0:
        wrong = bits((low > e) & (flip_sign(splat16(_F(facing)), dn) > _F(0.0)))
        return hit & ~wrong, undecided & ~hit & ~wrong
    return hit, undecided & ~hit


@inlined
def decide(d, lanes, facing):
    """(bits of the rays along d that surely meet the triangle, bits of the rays undecided in float32)."""
    # Eq. (7) of docs/design/exactness.md
    e1, e2, dn = dot(d, lanes.qc), dot(d, lanes.cp), dot(d, lanes.n)
    return decide_signs(e1, e2, dn, lanes.t, lanes.e, lanes.te, facing)


@inlined
def store_lanes(memory, lanes):
    """Write `Lanes` to LANES float32."""
    store3(memory, 0, 16, lanes.cp)
    store3(memory, 48, 16, lanes.qc)
    store3(memory, 96, 16, lanes.n)
    store(memory, 144, lanes.t)
    store(memory, 160, lanes.e)
    store(memory, 176, lanes.te)


@inlined
def stored_lane(memory, k):
    """Lane k of stored `Lanes`, in all lanes."""
    return Lanes(
        broadcasts(memory, k, 16),
        broadcasts(memory, 48 + k, 16),
        broadcasts(memory, 96 + k, 16),
        broadcast16(memory, 144 + k),
        broadcast16(memory, 160 + k),
        broadcast16(memory, 176 + k),
    )


@inlined
def ray_meets(o, d, numbers, facing, limit):
    """Test a ray from o along d against the 16 triangles of a block.

    Return (bits of the triangles that it surely meets, bits of the triangles undecided in float32).

    o, d : the same ray in all lanes
    numbers : the block's corners and edges
    limit : t beyond which triangles are ignored if they surely lie there; None: no limit
    """
    # Eq. (6) and (7) of docs/design/exactness.md
    a, p, q = subtract3(rows(numbers, 0, 16), o), rows(numbers, 48, 16), rows(numbers, 96, 16)
    n, r = cross(p, q), cross(d, a)
    e1, e2, dn, t = -dot(q, r), dot(p, r), dot(d, n), dot(a, n)
    e, te = error_bounds(largest(a), maximum(largest(p), largest(q)), total(d))
    hit, unsure = decide_signs(e1, e2, dn, t, e, te, facing)
    if limit is None:
        return hit, unsure
    beyond = bits(absolute(t) - te > (absolute(dn) + te + te) * limit)
    return hit & ~beyond, unsure & ~beyond


# --- Deferred tests ---------------------------------------------------------------------------------------------------


DEFERRED = 16 * 16 * 16  # most tests that one block and one tile can defer: triangles * strata * receivers


def deferred_ints(tiles: int) -> int:
    """Size of the memory, in int32, for DEFERRED tests and all tests of one more block with `tiles` tiles.

    Layout: the count, an unused word, then slot and place of each test.
    """
    return 2 + 2 * (1 + tiles) * DEFERRED


@inlined
def defer(deferred, slot, place, step, unsure):
    """Defer the tests of the triangle in `slot` against the `unsure` lanes (bits) of a row.

    Lane i is at ``place + i step``. A place is ``tile << 8 | stratum << 4 | receiver``. Slot -1 stands for the horizon
    test of the receiver's own surface.
    """
    n = get(deferred, 0)
    while unsure != 0:
        put(deferred, 2 + 2 * n, slot)
        put(deferred, 3 + 2 * n, place + lowest_bit(unsure) * step)
        unsure &= unsure - 1
        n += 1
    put(deferred, 0, n)


@inlined
def defer_triangles(deferred, tree, block, face, place, unsure):
    """Defer the tests of a block's triangles (bits) against the ray at `place`, except the receiver's own, `face`."""
    while unsure != 0:
        slot = get(tree.slots, slot_at(block, lowest_bit(unsure)))
        unsure &= unsure - 1
        if get(tree.prim_ids, slot) != face:
            defer(deferred, slot, place, 0, 1)


@kernel
def _is_blocked(corners, chunk, y0, x0, tile, slot, s, lane, counters):
    """Decide exactly whether the triangle in `slot`, or the receiver's own surface (slot -1), blocks a segment."""
    l = ptr_at(tile.points, s * 48 + lane)
    if slot < 0:
        count(counters, UNCERTAIN, 1)
        horizon = horizon_of(chunk.query, place_of(chunk, y0, x0, lane))
        return not is_above(horizon, get(l, 0), get(l, 16), get(l, 32), chunk.query.corners)
    o = ptr_at(tile.origins, lane)
    ray = segment(get(o, 0), get(o, 16), get(o, 32), get(l, 0), get(l, 16), get(l, 32))
    side = settle(ray, corners, slot, counters)
    return side != 0 and side != chunk.query.facing


@kernel
def resolve_deferred(corners, chunk, tiles, pixels, deferred, counters):
    """Decide the deferred tests of some tiles exactly, and update the tiles' `dead`.

    tiles, pixels : as `tile.tile_at` and `tile.first_pixel` read them
    """
    for k in range(get(deferred, 0)):
        slot, place = get(deferred, 2 + 2 * k), get(deferred, 3 + 2 * k)
        g, s, lane = place >> 8, place >> 4 & 15, place & 15
        y0, x0 = first_pixel(pixels, g)
        tile = tile_at(tiles, g, chunk)
        dead = get(tile.dead, s)
        if dead >> lane & 1 == 0 and _is_blocked(corners, chunk, y0, x0, tile, slot, s, lane, counters):
            put(tile.dead, s, dead | 1 << lane)
    put(deferred, 0, 0)


# --- Blocks of triangles ----------------------------------------------------------------------------------------------


class Block(NamedTuple):
    """A block, with the data that its tests against a tile's segments need."""

    tree: BlockPointers
    number: int
    present: int  # bits of its triangles
    valid: int  # bits of the tile's receivers
    facing: int  # a value of CULL_FACES
    work: F32Ptr | None  # float32 scratch memory; None: no test needs it
    deferred: I32Ptr  # int32, deferred tests, see `deferred_ints`


@inlined
def fetch(tree, link):
    """Prefetch the node or block behind a link. In large scenes, memory latency dominates."""
    if link >= 0:
        prefetch(tree.nodes, line_at(link))
        return
    block = block_leaf(link).block
    for row in range(ROWS):
        prefetch(tree.blocks, row_at(block, row))
    prefetch(tree.slots, slots_at(block))


@inlined
def numbers_of(b):
    """A pointer to the rows of a block of triangles."""
    return ptr_at(b.tree.blocks, rows_at(b.number))


@inlined
def slot_of(b, i):
    """The slot of triangle i: its index in the BVH's arrays."""
    return get(b.tree.slots, slot_at(b.number, i))


@inlined
def blocks_ray(b, o, d, face, place, counters):
    """True if a triangle of a block surely blocks the ray from o along d, the same in all lanes.

    Otherwise, defer the undecided tests at the ray's `place`, except that of the receiver's triangle `face`.
    """
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = ray_meets(o, d, numbers_of(b), b.facing, None)
    if hit & b.present != 0:
        return True
    if unsure & b.present != 0:
        defer_triangles(b.deferred, b.tree, b.number, face, place, unsure & b.present)
    return False
