"""Traversal of a wide BVH: tests of eight boxes or eight triangles at a time, and the results of queries.

Ray blocks. A *block* is scratch memory of 21 rows of 16 float32, with one column per ray. The caller fills origins,
directions, tmin and tmax, rounded to nearest; `prepare` fills the remaining rows. A ray reaches a plane x = c at t = c
* inverse + offset, in one instruction. The error is absolute, a fraction of the largest coordinate involved. So the
offsets move the planes outwards by more than this error, both where a ray enters and where it leaves. Proof:
docs/design/wide.md.

Nearest hits. The float32 filter bounds the t of each hit. LOWER and LIMIT are the bounds of a ray's nearest hit so far.
A hit surely nearer than LOWER replaces it, and one surely beyond LIMIT is ignored. Others are its rivals: their tests
are deferred, like undecided ones, and float64 decides among them when the traversal has ended.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import GROUP_WORDS, MAX_DEPTH, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import FilterRays, FilterTriangles, comes_first, error_unit, filter_hits, hit_t
from ...kernels.exact.predicate import Ray, ray_along
from ...kernels.jit import F32Ptr, F32x8, F64Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    absolute,
    all_lanes,
    broadcast8,
    f32_bits,
    fma,
    get,
    iota8,
    load8,
    load16,
    lowest_bit,
    mask_from_bits8,
    mask_from_bits16,
    maximum,
    minimum,
    prefetch,
    ptr_at,
    put,
    select,
    shuffle,
    splat8,
    splat16,
    stack_f32,
    store,
)
from ..counters import TRIANGLE_TESTS, count
from .ray_traversal import BUILT, CLOSEST, settle, walk

# --- Ray blocks -------------------------------------------------------------------------------------------------------


LANES = 16
BLOCKS = 4  # consecutive blocks in memory
OX, OY, OZ, DX, DY, DZ, TMIN, TMAX = (LANES * k for k in range(8))  # filled by the caller
INVERSE, NEAR, FAR = 8 * LANES, 11 * LANES, 14 * LANES  # three rows each: x, y, z
LOWER, LIMIT, UNIT, FLOOR = 17 * LANES, 18 * LANES, 19 * LANES, 20 * LANES
BLOCK_WORDS = 21 * LANES
ENDS, DIRECTION, REMAINDER = (
    0,
    2 * LANES,
    5 * LANES,
)  # float64 rows of `RayBlock.precise`: tmin, tmax; three rows each: x, y, z
PRECISE_WORDS = 8 * LANES

SMALL, LARGE = np.float32(2.0**-40), np.float32(2.0**40)
_LEAST_REACH, _LEAST_LENGTH, _MOST = np.float32(2.0**-100), np.float32(2.0**-80), np.float32(2.0**120)
_LEAST_T, _MOST_T = np.float32(2.0**-100), np.float32(2.0**80)
_ALONG = np.float32(2.0**-40)  # a direction's components are raised to at least this fraction of the largest one
PAD = np.float32(2.0**-20)  # planes are moved outwards by this fraction of the largest coordinate along their axis,
TURN = np.float32(2.0**-38)  # and by this fraction of the largest one, since components of a direction are raised
_INF = np.float32(np.inf)


class RayBlock(NamedTuple):
    """A block of rays: pointers to scratch memory."""

    rows: F32Ptr  # float32 *, BLOCK_WORDS
    precise: F64Ptr  # float64 *, PRECISE_WORDS: tmin and tmax; for segments also the direction and its remainder
    skip: I32Ptr  # int32 *, 16: index of a triangle to ignore, or -1
    segments: bool  # the rays are segments between float32 points; False: the float32 direction is exact


@inlined
def block_of(rays, j):
    """Block j of a `RayBlock` that holds several consecutive blocks."""
    rows, precise = ptr_at(rays.rows, j * BLOCK_WORDS), ptr_at(rays.precise, j * PRECISE_WORDS)
    return RayBlock(rows, precise, ptr_at(rays.skip, j * LANES), rays.segments)


@inlined
def first_block(rays):
    """The block of the first ray in `rays` (bits) of several blocks."""
    return lowest_bit(rays) // LANES


@inlined
def rays_of_block(j):
    """Bits of the rays of block j, among those of several blocks."""
    return np.int64((1 << LANES) - 1) << (j * LANES)


@inlined
def rays_in(rays, j):
    """The rays in `rays` (bits) of several blocks that are in block j, as bits of this block."""
    return (rays >> (j * LANES)) & ((1 << LANES) - 1)


@inlined
def ray_of(rays, i):
    """Ray i in float64."""
    f, b, p = np.float64, rays.rows, rays.precise
    ox, oy, oz, tmin, tmax = get(b, OX + i), get(b, OY + i), get(b, OZ + i), get(p, ENDS + i), get(p, ENDS + LANES + i)
    if not rays.segments:
        return ray_along(ox, oy, oz, get(b, DX + i), get(b, DY + i), get(b, DZ + i), tmin, tmax)
    return Ray(
        f(ox), f(oy), f(oz), get(p, DIRECTION + i), get(p, DIRECTION + LANES + i), get(p, DIRECTION + 2 * LANES + i),
        get(p, REMAINDER + i), get(p, REMAINDER + LANES + i), get(p, REMAINDER + 2 * LANES + i), tmin, tmax, 1.0,
    )  # fmt: skip


@inlined
def largest_of(reach):
    """The largest component of a `Reach`."""
    return max(max(reach[0], reach[1]), reach[2])


@inlined
def boxes_fit(largest, reach):
    """Where float32 suffices for box tests, so that no product of an inverse overflows or vanishes. False for NaN.

    largest, reach : largest component of the direction, and largest coordinate; scalars or vectors
    """
    # Eq. (6) of docs/design/wide.md
    tame = (largest > _LEAST_LENGTH) & (largest < _MOST) & (reach > _LEAST_REACH) & (reach < _MOST)
    return tame & (reach < largest * _MOST_T) & (reach > largest * _LEAST_T)


@inlined
def triangles_fit(largest, reach):
    """Where no product of three factors in a triangle's test overflows; arguments as in `boxes_fit`. False for NaN."""
    return (reach > SMALL) & (reach < LARGE) & (largest > _LEAST_LENGTH) & (largest * reach * reach < _MOST)


@inlined
def raised_to(largest, reach):
    """(least magnitude of a direction's components, padding for raising them); arguments as in `boxes_fit`."""
    return largest * _ALONG, reach * TURN


@inlined
def plane_offsets(o, d, tree_reach, along, turn, fits):
    """(inverse, near offset, far offset): where rays meet planes along one axis, see (2) and (3). Vectors.

    along, turn : from `raised_to`
    fits : mask of the rays for which float32 suffices
    """
    # Eq. (2) and (3) of docs/design/wide.md
    pad = fma(maximum(absolute(o), tree_reach), PAD, turn)
    inverse = np.float32(1.0) / select(absolute(d) > along, d, along)
    offset, grow = -(o * inverse), pad * absolute(inverse)
    return select(fits, inverse, np.float32(0.0)), select(fits, offset - grow, -_INF), select(fits, offset + grow, _INF)


@inlined
def _put_prepared(block, tree_reach, largest, reach, fit):
    """`prepare` where `fit` are the masks of the rays whose triangle tests, and whose box tests, suit float32."""
    tame, fits = fit
    along, turn = raised_to(largest, reach)
    for k in range(3):
        o, d = load16(block, OX + LANES * k), load16(block, DX + LANES * k)
        inverse, near, far = plane_offsets(o, d, splat16(tree_reach[k]), along, turn, fits)
        store(block, INVERSE + LANES * k, inverse)
        store(block, NEAR + LANES * k, near)
        store(block, FAR + LANES * k, far)
    dx, dy, dz = load16(block, DX), load16(block, DY), load16(block, DZ)
    unit, floor = error_unit(tame, dx, dy, dz, reach)
    store(block, UNIT, unit)
    store(block, FLOOR, floor)


@inlined
def prepare(block, tree_reach):
    """Fill the rows from INVERSE on. Rays too long, too short or too far away for float32 enter every box."""
    ox, oy, oz = load16(block, OX), load16(block, OY), load16(block, OZ)
    dx, dy, dz = load16(block, DX), load16(block, DY), load16(block, DZ)
    largest = maximum(maximum(absolute(dx), absolute(dy)), absolute(dz))
    reach = maximum(maximum(maximum(absolute(ox), absolute(oy)), absolute(oz)), splat16(largest_of(tree_reach)))
    common = (largest > SMALL) & (largest < LARGE) & (reach > SMALL) & (reach < LARGE)
    if all_lanes(common):  # which implies the other conditions, and selects nothing
        everywhere = mask_from_bits16(np.int64(-1))
        _put_prepared(block, tree_reach, largest, reach, (everywhere, everywhere))
    else:
        fit = triangles_fit(largest, reach), boxes_fit(largest, reach)
        _put_prepared(block, tree_reach, largest, reach, fit)
    store(block, LIMIT, load16(block, TMAX))
    store(block, LOWER, splat16(_INF))


@inlined
def filter_ray8(block, lane):
    """`FilterRays` of one ray of a block, in eight lanes; its tmax is the limit of the search."""
    b = lane
    return FilterRays(
        broadcast8(block, OX + b), broadcast8(block, OY + b), broadcast8(block, OZ + b),
        broadcast8(block, DX + b), broadcast8(block, DY + b), broadcast8(block, DZ + b),
        broadcast8(block, TMIN + b), broadcast8(block, LIMIT + b), broadcast8(block, UNIT + b),
        broadcast8(block, FLOOR + b),
    )  # fmt: skip


@inlined
def filter_rays16(block):
    """`FilterRays` of all rays of a block."""
    return FilterRays(
        load16(block, OX), load16(block, OY), load16(block, OZ), load16(block, DX), load16(block, DY),
        load16(block, DZ), load16(block, TMIN), load16(block, LIMIT), load16(block, UNIT), load16(block, FLOOR),
    )  # fmt: skip


# --- Tests of boxes and triangles -------------------------------------------------------------------------------------


STACK = (MAX_DEPTH + 2) * WIDTH
DEFERRED = 128  # largest number of deferred tests per block of rays
DEFERRED_WORDS = 2 + 2 * DEFERRED
NONE = -1
_LINE = 16  # float32 of a cache line
_BOUNDS = 2 * WIDTH


class Query(NamedTuple):
    """The kind of query."""

    cull_faces: int  # a value of CULL_FACES
    any_hit: bool  # any hit, not the nearest


class WideHit(NamedTuple):
    """Pointers to the hit of each ray of a block, and to the deferred tests."""

    lane: I32Ptr  # int32 *: group * 8 + lane of the triangle; NONE: no hit; below NONE: -2 - its slot
    deferred: I32Ptr  # int32 *, DEFERRED_WORDS: count; bits of rays whose tests overflowed; each test's ray and lane


@inlined
def hits_of(hits, j):
    """The `WideHit` of block j, where `hits` has memory for several consecutive blocks."""
    return WideHit(ptr_at(hits.lane, j * LANES), ptr_at(hits.deferred, j * DEFERRED_WORDS))


@inlined
def slot_of(tree, hits, i):
    """Slot of the triangle that ray i hits, or -1."""
    lane = get(hits.lane, i)
    return get(tree.slots, lane) if lane >= 0 else -2 - lane


@inlined
def start(hits):
    """Reset `hits` of a block."""
    put(hits.deferred, 0, 0)
    put(hits.deferred, 1, 0)
    store(hits.lane, 0, splat16(np.int32(NONE)))


@inlined
def _defer_lanes(hits, i, first, lanes):
    """Defer the tests of ray i against the triangles in `lanes` (bits) of a group; `first`: the group's first lane."""
    n = get(hits.deferred, 0)
    while lanes:
        k = lowest_bit(lanes)
        lanes &= lanes - 1
        if n == DEFERRED:
            put(hits.deferred, 1, get(hits.deferred, 1) | 1 << i)
            break
        put(hits.deferred, 2 + 2 * n, i)
        put(hits.deferred, 3 + 2 * n, first + k)
        n += 1
    put(hits.deferred, 0, n)


@inlined
def _settle_hit(tree, rays, i, at, query, hits):
    """Store the hit of ray i on the triangle in lane `at`, unless the best one so far comes first."""
    slot, best = np.int64(get(tree.slots, at)), slot_of(tree, hits, i)
    prim = np.int64(get(tree.prim_ids, slot))
    if prim == get(rays.skip, i):
        return
    if best >= 0:
        ray, best_prim = ray_of(rays, i), np.int64(get(tree.prim_ids, best))
        t, best_t = hit_t(ray, tree.corners, slot), hit_t(ray, tree.corners, best)
        if not comes_first(ray, tree.corners, slot, prim, t, tree.corners, best, best_prim, best_t):
            return
    put(hits.lane, i, at)


@kernel
def settle_block(tree, rays, query, hits, counters):
    """Settle the deferred tests. Rays whose tests overflowed are traced again, through the binary BVH."""
    overflowed, order = get(hits.deferred, 1), np.int64(BUILT if query.any_hit else CLOSEST)
    for k in range(get(hits.deferred, 0)):
        i, at = get(hits.deferred, 2 + 2 * k), get(hits.deferred, 3 + 2 * k)
        if overflowed >> i & 1 or (query.any_hit and get(hits.lane, i) != NONE):
            continue
        side = settle(ray_of(rays, i), tree.corners, get(tree.slots, at), counters)
        if side != 0 and side != query.cull_faces:
            _settle_hit(tree, rays, i, at, query, hits)
    while overflowed:
        i = lowest_bit(overflowed)
        overflowed &= overflowed - 1
        skip = np.int64(get(rays.skip, i))
        slot = walk(tree.binary, ray_of(rays, i), skip, query.cull_faces, order, None, counters)[0]
        put(hits.lane, i, -2 - slot)


@inlined
def group_of(groups, at):
    """The `FilterTriangles` of the group that starts at word `at`."""
    return FilterTriangles(
        load8(groups, at), load8(groups, at + 8), load8(groups, at + 16), load8(groups, at + 24),
        load8(groups, at + 32), load8(groups, at + 40), load8(groups, at + 48), load8(groups, at + 56),
        load8(groups, at + 64), load8(groups, at + 72),
    )  # fmt: skip


@inlined
def facing(hits, positive, cull_faces):
    """The hits that face culling keeps."""
    if cull_faces == 0:
        return hits
    return hits & (~positive if cull_faces > 0 else positive)


@inlined
def without_skipped(tree, first, lanes, skip):
    """The `lanes` (bits) of a group, without that of the triangle `skip`; first: the group's first lane."""
    remaining = lanes
    while remaining:
        k = lowest_bit(remaining)
        remaining &= remaining - 1
        if np.int64(get(tree.prim_ids, get(tree.slots, first + k))) == skip:
            lanes &= ~(1 << k)
    return lanes


@inlined
def keep_lanes(tree, rays, i, first, lanes, bounds, any_hit, hits):
    """Store the nearest of ray i's hits in a group, and defer its rivals and undecided tests.

    lanes : bits of hits and, from bit 8 on, of undecided tests
    bounds : `near` and `far` of the tests, 8 float32 each
    """
    rows, skip = rays.rows, np.int64(get(rays.skip, i))
    unsure, lanes = lanes >> WIDTH, lanes & ((1 << WIDTH) - 1)
    if lanes and skip >= 0:
        lanes = without_skipped(tree, first, lanes, skip)
    if any_hit and lanes:
        put(hits.lane, i, first + lowest_bit(lanes))
        return True
    while lanes:
        k = lowest_bit(lanes)
        lanes &= lanes - 1
        low, high, lower, limit = get(bounds, k), get(bounds, WIDTH + k), get(rows, LOWER + i), get(rows, LIMIT + i)
        if low > limit:
            continue
        if high < lower:
            put(hits.lane, i, first + k)
            prefetch(ptr_at(tree.slots, first + k), 0)  # it is read when the traversal has ended
        else:
            unsure |= np.int64(1) << k
        put(rows, LOWER + i, low if low < lower else lower)
        put(rows, LIMIT + i, high if high < limit else limit)
    if unsure:
        _defer_lanes(hits, i, first, unsure)
    return False


@inlined
def visit_leaf(tree, rays, i, link, query, hits, counters):
    """Test ray i against the triangles of a leaf. Return whether this ends the ray's any-hit query."""
    group, n = wide_leaf(link)
    count(counters, TRIANGLE_TESTS, n)
    tests = filter_hits(filter_ray8(rays.rows, i), group_of(tree.groups, group * GROUP_WORDS))
    there, bounds = np.int64((1 << n) - 1), stack_f32(_BOUNDS)
    lanes = (facing(tests.hits, tests.positive, query.cull_faces) & there) | (tests.unsure & there) << WIDTH
    store(bounds, 0, tests.near)
    store(bounds, WIDTH, tests.far)
    return lanes != 0 and keep_lanes(tree, rays, i, group * WIDTH, lanes, bounds, query.any_hit, hits)


@inlined
def defer(hits, rays, at):
    """Defer the tests of some rays (bits) against the triangle in lane `at`."""
    while rays:
        i = lowest_bit(rays)
        rays &= rays - 1
        _defer_lanes(hits, i, at, 1)


@inlined
def fetch(tree, link):
    """Prefetch the memory of a node or a leaf."""
    fetch_from(tree.nodes, tree.groups, link)


@inlined
def fetch_from(nodes, groups, link):
    """`fetch` from the nodes and the groups of a tree."""
    node, group = ptr_at(nodes, link * NODE_WORDS), ptr_at(groups, wide_leaf(link).group * GROUP_WORDS)
    p = node if link >= 0 else group
    prefetch(p, 0)
    prefetch(p, _LINE)
    prefetch(p, 2 * _LINE)
    prefetch(p, 3 * _LINE)
    prefetch(p, 4 * _LINE)


class WideSlabs(NamedTuple):
    """A ray prepared for eight boxes: broadcast rows of its block, and words of the planes through which it enters."""

    ix: F32x8
    iy: F32x8
    iz: F32x8
    near_x: F32x8
    near_y: F32x8
    near_z: F32x8
    far_x: F32x8
    far_y: F32x8
    far_z: F32x8
    tmin: F32x8
    x: int
    y: int
    z: int


@inlined
def slabs_of(block, i):
    """The slabs of rays i to i + 7 of a block."""
    b = block
    upper = np.int64(WIDTH)
    return WideSlabs(
        broadcast8(b, INVERSE + i), broadcast8(b, INVERSE + LANES + i), broadcast8(b, INVERSE + 2 * LANES + i),
        broadcast8(b, NEAR + i), broadcast8(b, NEAR + LANES + i), broadcast8(b, NEAR + 2 * LANES + i),
        broadcast8(b, FAR + i), broadcast8(b, FAR + LANES + i), broadcast8(b, FAR + 2 * LANES + i),
        broadcast8(b, TMIN + i),
        upper if get(b, INVERSE + i) < 0 else 0,
        2 * upper + (upper if get(b, INVERSE + LANES + i) < 0 else 0),
        4 * upper + (upper if get(b, INVERSE + 2 * LANES + i) < 0 else 0),
    )  # fmt: skip


@inlined
def enter(nodes, at, r, limit):
    """Test the eight boxes of the node at word `at`: (mask of the boxes entered before `limit`, vector of entry t)."""
    x, y, z = load8(nodes, at + r.x), load8(nodes, at + r.y), load8(nodes, at + r.z)
    t_near = maximum(maximum(fma(x, r.ix, r.near_x), fma(y, r.iy, r.near_y)), maximum(fma(z, r.iz, r.near_z), r.tmin))
    x, y, z = load8(nodes, at + (r.x ^ WIDTH)), load8(nodes, at + (r.y ^ WIDTH)), load8(nodes, at + (r.z ^ WIDTH))
    t_far = minimum(minimum(fma(x, r.ix, r.far_x), fma(y, r.iy, r.far_y)), minimum(fma(z, r.iz, r.far_z), limit))
    return t_near <= t_far, t_near


# --- Sorted children --------------------------------------------------------------------------------------------------


LANE = np.int32(WIDTH - 1)  # bits of a key that hold the child's lane
NO_KEY = np.int32(-(2**31))  # the least key, for boxes that are not entered
_T = np.int32(0x7FFFFFFF - (WIDTH - 1))  # bits that hold t, which is not negative


@inlined
def _exchange(v, other, upper):
    """The maximum with `other` in the lanes of `upper` (bits), the minimum elsewhere."""
    return select(mask_from_bits8(np.int64(upper)), maximum(v, other), minimum(v, other))


@inlined
def sorted_keys(entered, t_near):
    """Keys of the children entered, in descending order of t, then NO_KEY; entered, t_near : from `enter`.

    A key is the bits of t, an int32 that orders like t, with the child's lane in its lowest bits.
    """
    v = select(entered, (f32_bits(t_near) & _T) | iota8(), splat8(NO_KEY))
    v = _exchange(v, shuffle(v, 1, 0, 3, 2, 5, 4, 7, 6), 0b01010101)  # a bitonic network
    v = _exchange(v, shuffle(v, 3, 2, 1, 0, 7, 6, 5, 4), 0b00110011)
    v = _exchange(v, shuffle(v, 1, 0, 3, 2, 5, 4, 7, 6), 0b01010101)
    v = _exchange(v, shuffle(v, 7, 6, 5, 4, 3, 2, 1, 0), 0b00001111)
    v = _exchange(v, shuffle(v, 2, 3, 0, 1, 6, 7, 4, 5), 0b00110011)
    return _exchange(v, shuffle(v, 1, 0, 3, 2, 5, 4, 7, 6), 0b01010101)
