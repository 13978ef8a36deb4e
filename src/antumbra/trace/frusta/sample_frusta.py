"""`multifrusta:by-sample`: frusta of 16 receivers and one light sample [Benthin and Wald 2009, Sec. 4.1 and 6.1].

Interleaved sampling gives 16 receivers, one from each 4 x 4 block of 16 x 16 pixels, the same virtual point light or
the same direction of an environment map. Their rays form a frustum, which starts at the light and not at the receivers,
or a beam of parallel rays. The 16 sets of samples give 16 frusta, whose lights are near each other, so they traverse
the tree together. Without interleaving, a frustum has the 16 receivers of a block, and all frusta start at the same
light: these are the paper's hard shadow rays.

Lanes of the traversal are frusta. Each has a box of starts, a box of ends, and bounds of its directions. In leaves,
triangles are tested against all frusta side by side, then against the 16 rays of the remaining ones.
"""

from typing import Any, NamedTuple

import numpy as np

from ...base.progress import ProgressCallback
from ...bvh.block_tree import BlockTree, block_pointers
from ...bvh.nodes import block_leaf, bounds_at, rows_at, slot_at
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items
from ...kernels.simd import (
    bits,
    broadcast16,
    fma,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
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
from ...kernels.vec3 import (
    Vec3,
    abs_dot,
    crosses,
    dot,
    get3,
    largest,
    middles_and_halves,
    rows,
    splats,
    store3,
    subtract3,
)
from ...query.shadow_query import ShadowQuery
from ...scene.lights import is_list
from ..counters import (
    BOX_TESTS,
    CANDIDATES,
    COVERED,
    N_COUNTERS,
    TRIANGLE_TESTS,
    TRIANGLES,
    add_counters,
    cleared,
    count,
)
from ..descent import Shafts, after_leaf, load_saved, next_leaf, root, save, slabs_of
from ..packets.packet16 import BlockPackets
from ..packets.ray_tile import STACK, TileRun, is_far, is_incoherent, query_chunk_in, trace_tiles
from ..shafts import box_at, segments_in_box, store_inverses
from ..tile import (
    TILE_FLOATS,
    tile_at,
    write_bits,
)
from ..tracer import BLOCKS, Bits, Box, Counters, Tracer
from ..tracer_cost import Cost
from ..triangle_tests import (
    DEFERRED,
    LANES,
    Lanes,
    decide,
    defer,
    deferred_ints,
    error_bounds,
    lanes_from,
    length1,
    resolve_deferred,
    store_lanes,
    stored_lane,
    triangle_along,
)
from .frusta_areas import (
    PART_INTS,
    TILES,
    FrustaArea,
    SampleFrusta,
    SampleScratch,
    divide_area,
    first_pixel_of,
    gather_points,
    gather_receivers,
    read_open,
    start_area,
    write_blocked,
)
from .shaft_culling import MORE, verdict

# --- Bounds of the frusta ---------------------------------------------------------------------------------------------


_F = np.float32
_STARTS, _ENDS, _DIRECTIONS = 0, 96, 192  # rows of lower x, y, z and upper x, y, z; lanes are frusta
_MIDDLES, _SPAN, _TWIST = 288, 480, 496  # rows of middles and half extents of starts and of directions
_INVERSES, _REACH = 512, 512 + 768  # reciprocals of the rays' directions, rows x, y, z per frustum, see `trace.shafts`
_BOUNDS = _REACH + 16
_FLOATS = 2 * 768 + _BOUNDS + LANES
_PARTS_AT = 368
_STACK_AT = _PARTS_AT + PART_INTS
_INTS = _STACK_AT + STACK
_TILE_MEMORY = TILES * TILE_FLOATS
_DEFERRED_INTS = deferred_ints(1)


@inlined
def _bound_row(bounds, at, lane, v, there):
    """Write the box of the vectors in the mask `there` to a lane."""
    far = splat16(_F(np.inf))
    for k in range(3):
        put(bounds, at + 16 * k + lane, reduce_min(select(there, v[k], far)))
        put(bounds, at + 48 + 16 * k + lane, reduce_max(select(there, v[k], -far)))


@inlined
def _bound_frustum(frusta, k):
    """Write the bounds of frustum k over its unblocked rays, and the reciprocals of its rays."""
    there, b = mask_from_bits16(get(frusta.open, k)), frusta.bounds
    starts, ends = rows(frusta.starts, 48 * k, 16), rows(frusta.ends, 48 * k, 16)
    put(b, _REACH + k, store_inverses(b, _INVERSES + 48 * k, starts, ends))
    _bound_row(b, _ENDS, k, ends, there)
    _bound_row(b, _STARTS, k, starts, there)
    _bound_row(b, _DIRECTIONS, k, subtract3(ends, starts), there)


@kernel
def _bound_frusta(frusta, alive):
    """Write the bounds of the frusta in `alive` (bits). The middle of a common start is the start itself."""
    b = frusta.bounds
    while alive != 0:
        _bound_frustum(frusta, lowest_bit(alive))
        alive &= alive - 1
    c, x = middles_and_halves(rows(b, _STARTS, 16), rows(b, _STARTS + 48, 16))
    d, w = middles_and_halves(rows(b, _DIRECTIONS, 16), rows(b, _DIRECTIONS + 48, 16))
    if frusta.shared:
        none = splat16(_F(0.0))
        c, x = rows(b, _STARTS, 16), Vec3(none, none, none)
    store3(b, _MIDDLES, 16, c)
    store3(b, _MIDDLES + 48, 16, x)
    store3(b, _MIDDLES + 96, 16, d)
    store3(b, _MIDDLES + 144, 16, w)
    store(b, _SPAN, length1(d) + length1(w))
    store(b, _TWIST, w.x * (x.y + x.z) + w.y * (x.x + x.z) + w.z * (x.x + x.y))


@inlined
def _shafts(b):
    """The frusta as `Shafts`."""
    low, high = rows(b, _STARTS, 16), rows(b, _STARTS + 48, 16)
    d_low, d_high = subtract3(rows(b, _ENDS, 16), low), subtract3(rows(b, _ENDS + 48, 16), high)
    return Shafts(
        low.x, low.y, low.z, high.x, high.y, high.z, d_low.x, d_low.y, d_low.z, d_high.x, d_high.y, d_high.z
    )  # fmt: skip


# --- Leaf tests -------------------------------------------------------------------------------------------------------
#
# Let a = v0 - c, with c the middle of the starts and x their half extents, and d and w the same of the directions. For
# an edge g at v0 and N = a x g, the edge function of a ray differs from d . N by at most
#
#     w . |N| + x . |g x d| + |g| sum of w_i (x_j + x_k)
#
# and the distances from the triangle's plane, with normal n, by x . |n| at the start and w . |n| along the ray.


@inlined
def _lanes_of(b, triangle):
    """`Lanes` of a triangle for the middles of the starts; the error bounds hold for all rays."""
    c, half = rows(b, _MIDDLES, 16), rows(b, _MIDDLES + 48, 16)
    a = Vec3(triangle.v.x - c.x, triangle.v.y - c.y, triangle.v.z - c.z)
    e, te = error_bounds(largest(a) + largest(half), splat16(triangle.size), load16(b, _SPAN))
    n, q = triangle.n, triangle.q
    qc, n = crosses(a, Vec3(-q.x, -q.y, -q.z)), splats(n)
    return Lanes(crosses(a, triangle.p), qc, n, dot(a, n), e, te)


@inlined
def _sideways(b, g):
    """x . |g x d|, for an edge g."""
    return abs_dot(crosses(rows(b, _MIDDLES + 96, 16), g), rows(b, _MIDDLES + 48, 16))


@inlined
def _cull(frusta, triangle, lanes, facing):
    """`Verdict` of a triangle on all frusta."""
    b, cp, qc, n, more = frusta.bounds, lanes.cp, lanes.qc, lanes.n, splat16(MORE)
    d, w = rows(b, _MIDDLES + 96, 16), rows(b, _MIDDLES + 144, 16)
    dn, e2, e1 = dot(d, n), dot(d, cp), dot(d, qc)
    third = Vec3(n.x - qc.x - cp.x, n.y - qc.y - cp.y, n.z - qc.z - cp.z)
    k0, k1, k2, kf, kt = abs_dot(third, w), abs_dot(qc, w), abs_dot(cp, w), abs_dot(n, w), splat16(_F(0.0))
    if not frusta.shared:
        p, q, twist = triangle.p, triangle.q, load16(b, _TWIST) * triangle.size
        k1, k2 = k1 + _sideways(b, q) + twist, k2 + _sideways(b, p) + twist
        k0 = k0 + _sideways(b, subtract3(q, p)) + twist + twist
        kt = abs_dot(n, rows(b, _MIDDLES + 48, 16))
        kf = kf + kt
    k0, k1, k2 = fma(k0, more, lanes.e), fma(k1, more, lanes.e), fma(k2, more, lanes.e)
    kt, kf = fma(kt, more, lanes.te), fma(kf, more, lanes.te)
    return verdict(dn - e1 - e2, e1, e2, k0, k1, k2, lanes.t, kt, lanes.t - dn, kf, facing)


class _LeafTriangle(NamedTuple):
    """A triangle of a leaf."""

    slot: int
    prim: int
    numbers: Any  # `triangle_tests.Triangle`
    place: int  # of the first ray of frustum 0, see `triangle_tests.defer`
    row_place: int  # step of the place from frustum to frustum
    lane_place: int  # step from ray to ray


@inlined
def _test_rays(frusta, k, tested, t, facing, deferred):
    """Test the rays of frustum k in `tested` (bits) against a triangle. Return bits of the blocked rays."""
    starts = rows(frusta.starts, 48 * k, 16)
    d = subtract3(rows(frusta.ends, 48 * k, 16), starts)
    if frusta.shared:
        hit, unsure = decide(d, stored_lane(frusta.work, k), facing)
    else:
        hit, unsure = decide(d, lanes_from(starts, length1(d), t.numbers), facing)
    if unsure & tested != 0:
        defer(deferred, t.slot, t.place + k * t.row_place, t.lane_place, unsure & tested)
    return hit & tested


@kernel
def _trace_triangle(frusta, mask, t, facing, deferred, counters):
    """Test a triangle against the frusta in `mask`. Return bits of the frusta without unblocked rays."""
    lanes, done = _lanes_of(frusta.bounds, t.numbers), np.int64(0)
    v = _cull(frusta, t.numbers, lanes, facing)
    active = mask & ~v.miss
    if active == 0:
        return done
    store_lanes(frusta.work, lanes)
    count(counters, CANDIDATES, 1)
    while active != 0:
        k = lowest_bit(active)
        active &= active - 1
        unblocked = get(frusta.open, k)
        tested = unblocked & ~bits(load16(frusta.faces, 16 * k) == np.int32(t.prim))
        if tested == 0:
            continue
        if v.cover >> k & 1:
            count(counters, COVERED, 1)
            hit = tested
        else:
            count(counters, TRIANGLE_TESTS, 1)
            hit = _test_rays(frusta, k, tested, t, facing, deferred)
        if hit != 0:
            put(frusta.open, k, unblocked & ~hit)
            if unblocked & ~hit == 0:
                done |= np.int64(1) << k
    return done


@inlined
def _reach_box(frusta, box, mask, counters):
    """Bits of the frusta in `mask` with an unblocked ray that may meet a `Box`."""
    reached = np.int64(0)
    while mask != 0:
        k = lowest_bit(mask)
        mask &= mask - 1
        count(counters, BOX_TESTS, 1)
        starts, inverses = rows(frusta.starts, 48 * k, 16), rows(frusta.bounds, _INVERSES + 48 * k, 16)
        met = segments_in_box(starts, inverses, broadcast16(frusta.bounds, _REACH + k), box)
        if met & get(frusta.open, k) != 0:
            reached |= np.int64(1) << k
    return reached


@kernel
def _trace_leaf(tree, link, mask, frusta, places, facing, deferred, counters):
    """Test a block against the frusta in `mask`. Return bits of the frusta without unblocked rays."""
    leaf, done = block_leaf(link), np.int64(0)
    if leaf.count == 0:
        return done
    mask = _reach_box(frusta, box_at(ptr_at(tree.bounds, bounds_at(leaf.block))), mask, counters)
    if mask == 0:
        return done
    block = ptr_at(tree.blocks, rows_at(leaf.block))
    for i in range(leaf.count):
        slot = get(tree.slots, slot_at(leaf.block, i))
        count(counters, TRIANGLES, 1)
        triangle = triangle_along(get3(block, i, 16), get3(block, 48 + i, 16), get3(block, 96 + i, 16))
        t = _LeafTriangle(slot, get(tree.prim_ids, slot), triangle, places[0], places[1], places[2])
        done |= _trace_triangle(frusta, mask & ~done, t, facing, deferred, counters)
        if mask & ~done == 0:
            break
    return done


# --- Tracing ----------------------------------------------------------------------------------------------------------


@kernel
def _walk(tree, alive, frusta, places, facing, scratch, counters):
    """Continue the traversal. Return whether it must resume after the deferred tests are resolved."""
    slabs = slabs_of(_shafts(frusta.bounds), alive)
    at = next_leaf(tree, slabs, load_saved(scratch.at, alive), scratch.stack, alive, counters)
    while at.mask != 0 and get(scratch.deferred, 0) <= DEFERRED:
        alive &= ~_trace_leaf(tree, at.link, at.mask, frusta, places, facing, scratch.deferred, counters)
        at = next_leaf(tree, slabs, after_leaf(at), scratch.stack, alive, counters)
    save(scratch.at, at)
    return at.mask != 0


@kernel
def _trace_part(tree, chunk, s, area, frusta, part, scratch, counters):
    """Trace the rays of a part to stratum s; the frusta's light samples are filled."""
    facing = -chunk.query.facing if area.shared else chunk.query.facing
    places = (s << 4, 256, 1) if area.by_tile else (s << 4, 1, 256)
    alive = read_open(area, frusta, chunk, s, part, scratch.words)
    if alive == 0:
        return
    _bound_frusta(frusta, alive)
    save(scratch.at, root(alive))
    while _walk(tree, alive, frusta, places, facing, scratch, counters):
        write_blocked(area, frusta, chunk, s, part, scratch.words)
        resolve_deferred(tree.corners, chunk, area.tiles, area.pixels, scratch.deferred, counters)
        alive = read_open(area, frusta, chunk, s, part, scratch.words)
    write_blocked(area, frusta, chunk, s, part, scratch.words)


@inlined
def _is_first(n, shape):
    """Whether tile n is the first one of an area."""
    y, x = n // shape.columns, n % shape.columns
    return x & 15 == 0 if shape.height == 1 else (x | y) & 3 == 0


@kernel
def _trace_areas(ticket, arrays, query, samples, job, out, counters, by_tile):
    """Worker: trace areas."""
    tiles, numbers = stack_f32(_TILE_MEMORY), stack_f32(_FLOATS)
    ints, deferred = stack_i32(_INTS), stack_i32(_DEFERRED_INTS)
    tree, totals = block_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    chunk, places = query_chunk_in(query, samples, job), ptr(out)
    area = FrustaArea(tiles, ints, ptr_at(ints, 32), by_tile, chunk.fixed, job.fresh)
    bounds, work = ptr_at(numbers, 2 * 768), ptr_at(numbers, 2 * 768 + _BOUNDS)
    frusta = SampleFrusta(numbers, ptr_at(numbers, 768), ptr_at(ints, 64), ptr_at(ints, 48), bounds, work, chunk.fixed)
    scratch = SampleScratch(
        ptr_at(ints, _STACK_AT), ptr_at(ints, 352), ptr_at(ints, 320), ptr_at(ints, _PARTS_AT), deferred
    )
    for n in items(ticket):
        if not _is_first(n, job.shape):
            continue
        y0, x0 = n // job.shape.columns * job.shape.height, n % job.shape.columns * job.shape.width
        put(deferred, 0, 0)
        there = start_area(chunk, y0, x0, area, scratch, places, totals)
        if there == 0:
            continue
        gather_receivers(area, frusta, chunk, there)
        parts = divide_area(area, frusta, scratch)
        for s in range(chunk.n_samples):
            gather_points(area, frusta, chunk, there, s)
            for k in range(parts):
                _trace_part(tree, chunk, s, area, frusta, ptr_at(scratch.parts, 16 * k), scratch, totals)
        resolve_deferred(tree.corners, chunk, tiles, area.pixels, deferred, totals)
        for g in range(TILES):
            if there >> g & 1:
                y, x = first_pixel_of(chunk, y0, x0, g)
                write_bits(chunk, y, x, get(area.valid, g), tile_at(tiles, g, chunk), places)
    add_counters(counters, totals)


_BESIDE_PACKETS = 1.2  # mean time relative to packets of blocks: 0.4 indoors, up to 2.8 where surfaces are small


class SampleFrustaTracer(Tracer):
    """The tracer `multifrusta:by-sample`."""

    description = "16 frusta of 16 rays at once, one light sample each; for lists of lights, skies and large lights"
    paper = "Benthin and Wald 2009, Sec. 6.1"
    form = BLOCKS
    cost = Cost(
        rate=lambda features: _BESIDE_PACKETS * BlockPackets.cost.rate(features),
        form=BlockPackets.cost.form,
        quick_overhead=0.4,
        guided=1.9,
        load=0.03,
        saving=0.2,
    )

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        return is_list(query.light) and is_incoherent(query) and not is_far(query, box)

    def trace(
        self,
        prepared: BlockTree,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        by_tile = bool((query.samples == query.samples[:1]).all())  # all sets have the same samples
        trace_tiles(TileRun(_trace_areas, False, threads, counters, progress, fresh), prepared, query, bits, by_tile)
