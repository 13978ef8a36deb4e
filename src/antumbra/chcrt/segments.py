"""Shadow segments: their cells and their bundles, for one light and some of its samples.

A cell's segments to a lamp or the sun are one ray set. The segments to each direction of the hemisphere are a set of
their own [Mattausch et al. 2015, Sec. 5.3].
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel, overload
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import (
    fma,
    get,
    mask_from_bits16,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    splat16,
    stack_f32,
    store,
)
from ..kernels.vec import rows
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, patch_of, query_pointers, sample_of, set_of
from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from .bundles import bundles_in, load_bundle
from .cells import (
    BLOCKED,
    COUNT,
    FAR,
    WORDS,
    Picture,
    first_receiver,
    new_cells,
    no_cell,
    nothing_yet,
    put_cell,
    receiver_in,
    region_in,
    regions_in,
    wider,
)

_F = np.float32
_BOXES = 96
_MORE = np.float32(2.0**-20)  # of the largest coordinate: more than rounding a box of light samples loses
_MOST_BUNDLES = 64  # of a cell: with more samples, its shaft alone decides


class Ends(NamedTuple):
    """The box in which the rays of all receivers end. It may move with the receiver."""

    low: np.ndarray  # (3,) float32
    high: np.ndarray  # (3,) float32
    moves: bool  # the box is relative to the receiver


class SegmentBundles(NamedTuple):
    """The segments of a query to some samples. Bundle k of a cell has its receivers' segments to a sample."""

    query: ShadowQuery
    bits: np.ndarray  # (h, w, words) uint64: the segments that are blocked
    first: int  # the first sample
    count: int  # number of samples
    sets: int  # 1, or one for each sample


def ends_of(query: ShadowQuery, first: int, count: int) -> Ends:
    """The `Ends` of a query's segments to `count` of its samples, from the `first` on."""
    light = query.light
    if light.kind == SPHERE:
        low, high = light.base - light.radius, light.base + light.radius
    elif light.kind == AMBIENT:
        low, high = np.full(3, -light.radius), np.full(3, light.radius)
    else:
        points = light.base + query.samples[:, first : first + count] @ np.stack([light.u, light.v, light.w])
        low, high = points.min((0, 1)), points.max((0, 1))
    pad = _MORE * np.maximum(np.abs(low), np.abs(high)).max() + 1e-30
    return Ends((low - pad).astype(_F), (high + pad).astype(_F), light.kind in (DIRECTIONAL, AMBIENT))


@kernel
def _bound_receivers(query, picture, y0, x0):
    """The box of a cell's receivers, and their number."""
    (low, high), n = nothing_yet(), np.int64(0)
    for lane in range(16):
        y, x, inside = receiver_in(picture, y0, x0, lane)
        if inside and query.sides[y, x] != NOTHING:
            o = query.origins[y, x]
            low, high = wider(low, high, (o[0], o[1], o[2]))
            n += 1
    return low, high, n


@kernel
def _bound_ends(query, picture, y0, x0, samples, ends):
    """Write, for each of 16 directions of the hemisphere, the box of the points that a cell's receivers look at.

    samples : pointer to (16, 3, 16) float32
    ends : pointer to six rows of 16 float32: low x, y, z and high x, y, z, rounded by less than `_MORE`
    """
    pointers, inf = query_pointers(query), splat16(_F(np.inf))
    lows, highs = (inf, inf, inf), (-inf, -inf, -inf)
    for lane in range(16):
        y, x, inside = receiver_in(picture, y0, x0, lane)
        if inside and query.sides[y, x] != NOTHING:
            i = y * pointers.w + x
            p, abc = patch_of(pointers, i), rows(samples, 48 * set_of(pointers, i), 16)
            ex = _end(abc, p.bx, p.ux, p.vx, p.wx)
            ey = _end(abc, p.by, p.uy, p.vy, p.wy)
            ez = _end(abc, p.bz, p.uz, p.vz, p.wz)
            lows = minimum(lows[0], ex), minimum(lows[1], ey), minimum(lows[2], ez)
            highs = maximum(highs[0], ex), maximum(highs[1], ey), maximum(highs[2], ez)
    for k in range(3):
        store(ends, 16 * k, lows[k])
        store(ends, 48 + 16 * k, highs[k])


@inlined
def _end(abc, base, u, v, w):
    """One coordinate of 16 points of a patch."""
    return fma(abc.x, splat16(_F(u)), fma(abc.y, splat16(_F(v)), fma(abc.z, splat16(_F(w)), splat16(_F(base)))))


@kernel
def _bound(ticket, query, picture, ends, pad, samples, spp, cells):
    """Worker: write the cells of regions, for each set of `cells`."""
    # In: query, picture, ends, pad, samples, spp. Out: cells.
    sets, regions, boxes = cells.shape[0], cells.shape[1], stack_f32(_BOXES)
    for region in items(ticket):
        for g in range(16):
            y, x = first_receiver(picture, region, g)
            o_low, o_high, n = _bound_receivers(query, picture, y, x)
            if sets > 1 and n > 0:
                _bound_ends(query, picture, y, x, ptr(samples), boxes)
            for s in range(sets):
                out = ptr_at(ptr(cells), (s * regions + region) * WORDS)
                if n == 0:
                    no_cell(out, g)
                    continue
                low, high = (ends.low[0], ends.low[1], ends.low[2]), (ends.high[0], ends.high[1], ends.high[2])
                if sets > 1:
                    low = get(boxes, s) - pad, get(boxes, 16 + s) - pad, get(boxes, 32 + s) - pad
                    high = get(boxes, 48 + s) + pad, get(boxes, 64 + s) + pad, get(boxes, 80 + s) + pad
                if not ends.moves or sets > 1:
                    low = low[0] - o_low[0], low[1] - o_low[1], low[2] - o_low[2]
                    high = high[0] - o_high[0], high[1] - o_high[1], high[2] - o_high[2]
                put_cell(out, g, o_low, o_high, low, high, _F(1.0), _F(n if sets > 1 else n * spp))


def bound_cells(query: ShadowQuery, picture: Picture, first: int, count: int, sets: int, threads: int) -> np.ndarray:
    """The cells of a query's segments to `count` samples from the `first` on.

    sets : 1, or one for each sample; then there are at most 16 samples, all of them directions of the hemisphere
    """
    cells, ends, pad = new_cells(picture, sets), ends_of(query, first, count), 0.0
    if ends.moves:  # sums with receivers are rounded
        pad = _MORE * (np.abs(query.origins).max(initial=0.0) + (query.light.radius if sets > 1 else 0.0))
        ends = Ends(ends.low - _F(pad), ends.high + _F(pad), True)
    samples = np.zeros((16, 3, 16), _F)
    if sets > 1:
        samples[..., :count] = query.samples[:, first : first + count].swapaxes(1, 2)
    run(_bound, threads, new_ticket(cells.shape[1], 1), query, picture, ends, _F(pad), samples, count, cells)
    return cells


@inlined
def _is_blocked(bits, at, words, sample):
    return get(bits, at * words + (sample >> 6)) >> np.uint64(sample & 63) & np.uint64(1) != 0


@overload(bundles_in)
def _bundles_in(source):
    if source.instance_class is SegmentBundles:
        return lambda source: 1 if source.sets > 1 else (source.count if source.count <= _MOST_BUNDLES else 0)


@overload(load_bundle)
def _load_bundle(source, picture, y0, x0, s, k, blind, bundle):
    if source.instance_class is SegmentBundles:
        return lambda source, picture, y0, x0, s, k, blind, bundle: _load(
            source, picture, y0, x0, source.first + (s if source.sets > 1 else k), blind, bundle
        )


@kernel
def _load(source, picture, y0, x0, sample, blind, bundle):
    """`load_bundle` of segments: the way from each receiver to a sample, rounded once, as tracers take it."""
    query, live = query_pointers(source.query), np.int64(0)
    for lane in range(16):
        y, x, there = receiver_in(picture, y0, x0, lane)
        i = y * query.w + x
        there = there and source.query.sides[y, x] != NOTHING
        there = there and (blind or not _is_blocked(ptr(source.bits), i, query.words, sample))
        o, end = (_F(0.0), _F(0.0), _F(0.0)), (_F(1.0), _F(1.0), _F(1.0))
        if there:
            o = get(query.origins, 3 * i), get(query.origins, 3 * i + 1), get(query.origins, 3 * i + 2)
            end = sample_of(query, patch_of(query, i), i, sample)
        for axis in range(3):
            put(bundle.rays, 16 * axis + lane, o[axis])
            put(bundle.rays, 48 + 16 * axis + lane, end[axis] - o[axis])
        put(bundle.limits, lane, _F(1.0) if there else _F(-1.0))
        live |= np.int64(there) << lane
    return live


@kernel
def _count_left(query, picture, y0, x0, bits, words, first, left):
    """Write the number of a cell's unblocked receivers for each of 16 samples, side by side; 16 divides `first`."""
    counts = splat16(_F(0.0))
    for lane in range(16):
        y, x, inside = receiver_in(picture, y0, x0, lane)
        if inside and query.sides[y, x] != NOTHING:
            word = get(bits, (y * picture.w + x) * words + (first >> 6)) >> np.uint64(first & 63)
            blocked = mask_from_bits16(np.int64(word & np.uint64(0xFFFF)))
            counts += select(blocked, splat16(_F(0.0)), splat16(_F(1.0)))
    store(left, 0, counts)


@inlined
def _put_left(out, g, n):
    """Note that n rays of cell g still look."""
    if get(out, FAR * 16 + g) >= _F(0.0):
        put(out, COUNT * 16 + g, n)
        if n == _F(0.0):
            put(out, FAR * 16 + g, BLOCKED)


@kernel
def _shorten(ticket, spans, tiles, columns, segments, picture, cells):
    """Worker: update the numbers of unblocked rays of all cells of some tiles."""
    # In: spans, tiles, columns, segments, picture. Out: cells.
    query, bits, words, regions = segments.query, ptr(segments.bits), segments.bits.shape[2], cells.shape[1]
    left = stack_f32(16)
    for t in items(ticket):
        span = spans[tiles[t]]
        for k in range(regions_in(span)):
            region = region_in(span, k, columns)
            for g in range(16):
                (y, x), n = first_receiver(picture, region, g), _F(0.0)
                for first in range(segments.first, segments.first + segments.count, 16):
                    _count_left(query, picture, y, x, bits, words, first, left)
                    for s in range(min(16, segments.first + segments.count - first)):
                        if segments.sets > 1:
                            _put_left(ptr_at(ptr(cells), (s * regions + region) * WORDS), g, get(left, s))
                        n += get(left, s)
                if segments.sets == 1:
                    _put_left(ptr_at(ptr(cells), region * WORDS), g, n)


def shorten(cells, spans, tiles, segments: SegmentBundles, picture: Picture, threads: int) -> None:
    """Update the cells of some tiles. A segment that is blocked looks no further."""
    ticket = new_ticket(len(tiles), 1)
    run(_shorten, threads, ticket, spans, tiles, picture.layout.columns, segments, picture, cells)
