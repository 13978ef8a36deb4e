"""Cells and bundles of each kind of rays: shadow segments, passes of one ray per pixel, and camera rays.

Segments. A cell's segments to a lamp or the sun form one ray set; for ambient light, the segments of each hemisphere
direction form a set of their own [Mattausch et al. 2015, Sec. 5.3].

Passes. Each ray has a *length*, a power of two: the ray leaves the scene within this multiple of its direction.

Camera rays. As for passes, but all rays share one length.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.elementary import power_of_two_above
from ...kernels.exact.filters import BEYOND
from ...kernels.jit import inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import (
    as_i32,
    bits,
    fma,
    get,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    stack_f32,
    store,
)
from ...kernels.vec3 import Vec3, largest, rows, store3
from ...query.gbuffer import pixel_direction
from ...query.raster_setup import direction_error
from ...query.ray_passes import RayPass
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, patch_of, query_pointers, sample_of, set_of
from ...scene.camera import CameraRays
from ...scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from ...trace.tree_list import Hits, no_hits
from .occlusion_queries import (
    BUNDLE_FLOATS,
    CELL,
    FAR,
    NONE,
    WORDS,
    PictureCells,
    bundle_in,
    bundles_in,
    first_receiver,
    load_bundle,
    new_cells,
    no_cell,
    nothing_yet,
    put_cell,
    receiver_in,
    region_in,
    regions_in,
    wider,
)

# --- Shadow segments to some samples of one light ---------------------------------------------------------------------

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

_F = np.float32
_BOXES = 96
_PADDING = np.float32(2.0**-20)  # relative to the largest coordinate; exceeds rounding errors of light samples


class Ends(NamedTuple):
    """The box that holds the ends of all receivers' rays, in space or relative to the receiver."""

    low: np.ndarray  # (3,) float32
    high: np.ndarray  # (3,) float32
    moves: bool  # the box is relative to the receiver


class SegmentBundles(NamedTuple):
    """The segments of a query to some samples. Bundle k of a cell has its receivers' segments to sample k."""

    query: ShadowQuery
    bits: np.ndarray  # (h, w, words) uint64: blocked segments
    first: int  # the first sample
    n_samples: int  # number of samples
    sets: int  # 1, or one for each sample


def ends_of(query: ShadowQuery, first: int, count: int) -> Ends:
    """The `Ends` of a query's segments to `count` of its samples, starting at `first`."""
    light = query.light
    if light.kind == SPHERE:
        low, high = light.base - light.radius, light.base + light.radius
    elif light.kind == AMBIENT:
        low, high = np.full(3, -light.radius), np.full(3, light.radius)
    else:
        points = light.base + query.samples[:, first : first + count] @ np.stack([light.u, light.v, light.w])
        low, high = points.min((0, 1)), points.max((0, 1))
    pad = _PADDING * np.maximum(np.abs(low), np.abs(high)).max() + 1e-30
    return Ends((low - pad).astype(_F), (high + pad).astype(_F), light.kind in (DIRECTIONAL, AMBIENT))


@kernel
def _bound_receivers(query, picture, corner):
    """The box of a cell's receivers, and whether there are any."""
    (low, high), any_ = nothing_yet(), False
    for lane in range(16):
        y, x, inside = receiver_in(picture, corner, lane)
        if inside and query.sides[y, x] != NOTHING:
            o = query.origins[y, x]
            low, high = wider(low, high, (o[0], o[1], o[2]))
            any_ = True
    return low, high, any_


@kernel
def _bound_ends(query, picture, corner, samples, ends):
    """For each of 16 hemisphere directions, write the box of the ends of a cell's segments.

    samples : pointer to (16, 3, 16) float32
    ends : pointer to six rows of 16 float32: low x, y, z and high x, y, z, rounded by less than `_PADDING`
    """
    pointers, inf = query_pointers(query), splat16(_F(np.inf))
    lows, highs = (inf, inf, inf), (-inf, -inf, -inf)
    for lane in range(16):
        y, x, inside = receiver_in(picture, corner, lane)
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
def _bound_segments(ticket, query, picture, ends, pad, samples, cells):
    """Worker: write the cells of regions, for each set of `cells`."""
    # In: query, picture, ends, pad, samples. Out: cells.
    sets, regions, boxes = cells.shape[0], cells.shape[1], stack_f32(_BOXES)
    for region in items(ticket):
        for g in range(16):
            corner = first_receiver(picture, region, g)
            o_low, o_high, any_ = _bound_receivers(query, picture, corner)
            if sets > 1 and any_:
                _bound_ends(query, picture, corner, ptr(samples), boxes)
            for s in range(sets):
                out = ptr_at(ptr(cells), (s * regions + region) * WORDS)
                if not any_:
                    no_cell(out, g)
                    continue
                low, high = (ends.low[0], ends.low[1], ends.low[2]), (ends.high[0], ends.high[1], ends.high[2])
                if sets > 1:
                    low = get(boxes, s) - pad, get(boxes, 16 + s) - pad, get(boxes, 32 + s) - pad
                    high = get(boxes, 48 + s) + pad, get(boxes, 64 + s) + pad, get(boxes, 80 + s) + pad
                if not ends.moves or sets > 1:
                    low = low[0] - o_low[0], low[1] - o_low[1], low[2] - o_low[2]
                    high = high[0] - o_high[0], high[1] - o_high[1], high[2] - o_high[2]
                put_cell(out, g, o_low, o_high, low, high, _F(1.0))


def bound_cells(
    query: ShadowQuery, picture: PictureCells, first: int, count: int, sets: int, threads: int
) -> NDArray[np.float32]:
    """The cells of a query's segments to `count` samples, starting at `first`.

    sets : 1, or one for each sample: then at most 16 samples, all of them hemisphere directions
    """
    cells, ends, pad = new_cells(picture, sets), ends_of(query, first, count), 0.0
    if ends.moves:  # sums with receivers are rounded
        pad = _PADDING * (np.abs(query.origins).max(initial=0.0) + (query.light.radius if sets > 1 else 0.0))
        ends = Ends(ends.low - _F(pad), ends.high + _F(pad), True)
    samples = np.zeros((16, 3, 16), _F)
    if sets > 1:
        samples[..., :count] = query.samples[:, first : first + count].swapaxes(1, 2)
    run(_bound_segments, threads, new_ticket(cells.shape[1], 1), query, picture, ends, _F(pad), samples, cells)
    return cells


@inlined
def _is_blocked(bits, at, words, sample):
    return get(bits, at * words + (sample >> 6)) >> np.uint64(sample & 63) & np.uint64(1) != 0


@overload(bundles_in)
def _segment_bundles_in(source):
    if source.instance_class is SegmentBundles:
        return lambda source: 1 if source.sets > 1 else source.n_samples


@overload(load_bundle)
def _load_segment_bundle(source, picture, corner, s, k, bundle):
    if source.instance_class is SegmentBundles:
        return lambda source, picture, corner, s, k, bundle: _load_segments(
            source, picture, corner, source.first + (s if source.sets > 1 else k), bundle
        )


@kernel
def _load_segments(source, picture, corner, sample, bundle):
    """`load_bundle` of segments: the vector from each receiver to a sample, rounded once, as in the tracers."""
    query, live = query_pointers(source.query), 0
    for lane in range(16):
        y, x, active = receiver_in(picture, corner, lane)
        i = y * query.w + x
        active = active and source.query.sides[y, x] != NOTHING
        active = active and not _is_blocked(ptr(source.bits), i, query.words, sample)
        o, end = (_F(0.0), _F(0.0), _F(0.0)), (_F(1.0), _F(1.0), _F(1.0))
        if active:
            o = get(query.origins, 3 * i), get(query.origins, 3 * i + 1), get(query.origins, 3 * i + 2)
            end = sample_of(query, patch_of(query, i), i, sample)
        for axis in range(3):
            put(bundle.rays, 16 * axis + lane, o[axis])
            put(bundle.rays, 48 + 16 * axis + lane, end[axis] - o[axis])
        put(bundle.limits, lane, _F(1.0) if active else _F(-1.0))
        live |= np.int64(active) << lane
    return live


@kernel
def _find_open(query, picture, corner, bits, words, first):
    """Bits of the 16 samples from `first`, a multiple of 16, to which a cell has an unblocked segment."""
    open_ = 0
    for lane in range(16):
        y, x, inside = receiver_in(picture, corner, lane)
        if inside and query.sides[y, x] != NOTHING:
            open_ |= ~np.int64(get(bits, (y * picture.w + x) * words + (first >> 6)) >> np.uint64(first & 63))
    return open_ & 0xFFFF


@kernel
def _shorten_segments(ticket, spans, tiles, columns, segments, picture, cells):
    """Worker: close the cells of some tiles whose segments are all blocked."""
    # In: spans, tiles, columns, segments, picture. Out: cells.
    query, bits, words, regions = segments.query, ptr(segments.bits), segments.bits.shape[2], cells.shape[1]
    end = segments.first + segments.n_samples
    for t in items(ticket):
        span = spans[tiles[t]]
        for k in range(regions_in(span)):
            region = region_in(span, k, columns)
            for g in range(16):
                corner, any_ = first_receiver(picture, region, g), 0
                for first in range(segments.first, end, 16):
                    n = min(16, end - first)
                    open_ = _find_open(query, picture, corner, bits, words, first) & ((1 << n) - 1)
                    any_ |= open_
                    for s in range(n if segments.sets > 1 else 0):
                        if open_ >> s & 1 == 0:
                            put(ptr(cells), (s * regions + region) * WORDS + FAR * 16 + g, NONE)
                if segments.sets == 1 and any_ == 0:
                    put(ptr(cells), region * WORDS + FAR * 16 + g, NONE)


def shorten(
    cells: NDArray[np.float32],
    spans: NDArray[np.int32],
    tiles: NDArray[np.int32],
    segments: SegmentBundles,
    picture: PictureCells,
    threads: int,
) -> None:
    """Update the cells of some tiles, of which those without unblocked segments are no longer active."""
    ticket = new_ticket(len(tiles), 1)
    run(_shorten_segments, threads, ticket, spans, tiles, picture.layout.columns, segments, picture, cells)


# --- Passes of one ray per pixel --------------------------------------------------------------------------------------

_SMALLEST = _F(2.0**-126)  # lengths are not denormal
_EXPONENT = 0x7F800000  # bits of a float32's exponent
_ROWS = 8  # rows of pixels per row that `is_spread` samples


class PassRays(NamedTuple):
    """One ray per pixel, and its nearest hit so far. An any-hit ray with a hit is no longer active."""

    origins: np.ndarray  # (h, w, 3) float32
    directions: np.ndarray  # (h, w, 3) float32; zero: no ray; of segments: rounded differences of their ends
    skip: np.ndarray  # (h, w) int32: triangles to skip, -1: none
    hits: Hits
    reach: float  # upper bound of a ray's length inside the scene
    spans: np.ndarray  # (h * w, 2) float64: tmin and tmax, in lengths of the direction; or (1, 2) for all rays
    each: int  # 1: each ray has its own span; 0: all share one
    cull_faces: int  # a value of CULL_FACES
    any_hit: bool
    targets: np.ndarray  # (h, w, 3) float32, the ends of segments; (1, 1, 3) for rays
    segments: bool


EVERYWHERE = np.array([[0.0, np.inf]])
"""The span of unbounded rays."""

NO_TARGETS = np.zeros((1, 1, 3), np.float32)


def pass_rays(rays: RayPass, h: int, w: int, reach: float) -> PassRays:
    """`PassRays` of a pass over an (h, w) image."""
    origins, directions, skip = (a.reshape(h, w, *a.shape[1:]) for a in rays)
    return PassRays(origins, directions, skip, no_hits((h, w)), reach, EVERYWHERE, 0, 0, False, NO_TARGETS, False)


def is_spread(rays: PassRays) -> bool:
    """Whether cells should be spread: directions of every fourth pixel are more similar than those of adjacent ones."""
    if min(rays.skip.shape) <= 4:
        return False
    d = rays.directions[::_ROWS].astype(np.float64)
    d /= np.maximum(np.linalg.norm(d, axis=2, keepdims=True), 1e-30)
    return bool((d[:, :-4] * d[:, 4:]).sum() > (d[:, :-4] * d[:, 1:-3]).sum())


@inlined
def _load_ray(rays, picture, corner, lane, bundle):
    """Load the ray of a lane, with its limit in lengths of its direction. Return whether it is active."""
    y, x, inside = receiver_in(picture, corner, lane)
    y, x = (y, x) if inside else corner
    d, far = rays.directions[y, x], _F(rays.hits.t[y, x])
    for k in range(3):
        put(bundle.rays, 16 * k + lane, rays.origins[y, x, k])
        put(bundle.rays, 48 + 16 * k + lane, d[k])
    put(bundle.limits, lane, min(far, _F(span_of(rays, y, x)[1])))
    return inside and not (rays.any_hit and rays.hits.face[y, x] >= 0)


@kernel
def load_rays(rays, picture, corner, bundle):
    """Fill the bundle of a cell. Return bits of its active rays."""
    live = 0
    for lane in range(16):
        live |= np.int64(_load_ray(rays, picture, corner, lane, bundle)) << lane
    d = rows(bundle.rays, 48, 16)
    size = largest(d)
    live &= bits(size > _F(0.0))
    lanes = mask_from_bits16(live)
    ratio = splat16(_F(rays.reach)) / select(lanes, size, splat16(_F(1.0))) * _F(4.0)
    store(bundle.lengths, 0, maximum(ratio, splat16(_SMALLEST)))
    store(as_i32(bundle.lengths), 0, load16(as_i32(bundle.lengths), 0) & splat16(np.int32(_EXPONENT)))
    lengths = load16(bundle.lengths, 0)
    store3(bundle.rays, 48, 16, Vec3(d.x * lengths, d.y * lengths, d.z * lengths))
    limits = minimum(load16(bundle.limits, 0) / lengths * _F(BEYOND), splat16(_F(1.0)))
    store(bundle.limits, 0, select(lanes, limits, splat16(_F(-1.0))))
    return live


@inlined
def span_of(rays, y, x):
    """(tmin, tmax) of a ray, float64."""
    i = (y * rays.skip.shape[1] + x) * rays.each
    return rays.spans[i, 0], rays.spans[i, 1]


@inlined
def limit_of(t, bundle, lane):
    """The limit of a ray with a hit at t, as a fraction of its length; as from `load_rays`."""
    return min(_F(t) / get(bundle.lengths, lane) * _F(BEYOND), _F(1.0))


@overload(bundles_in)
def _pass_bundles_in(source):
    if source.instance_class is PassRays:
        return lambda source: 1


@overload(load_bundle)
def _load_pass_bundle(source, picture, corner, s, k, bundle):
    if source.instance_class is PassRays:
        return lambda source, picture, corner, s, k, bundle: load_rays(source, picture, corner, bundle)


@inlined
def _box(vectors, live):
    """The corners of the box around the vectors in three rows, in the lanes of `live`."""
    lanes, v, inf = mask_from_bits16(live), rows(vectors, 0, 16), splat16(_F(np.inf))
    low = Vec3(select(lanes, v.x, inf), select(lanes, v.y, inf), select(lanes, v.z, inf))
    high = Vec3(select(lanes, v.x, -inf), select(lanes, v.y, -inf), select(lanes, v.z, -inf))
    return (
        (reduce_min(low.x), reduce_min(low.y), reduce_min(low.z)),
        (reduce_max(high.x), reduce_max(high.y), reduce_max(high.z)),
    )


@kernel
def _bound_pass(ticket, picture, rays, cells):
    """Worker: write the cells of regions."""
    bundle = bundle_in(stack_f32(BUNDLE_FLOATS))
    for region in items(ticket):
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            corner = first_receiver(picture, region, g)
            inside = corner[0] < picture.h and corner[1] < picture.w
            live = load_rays(rays, picture, corner, bundle) if inside else 0
            if live == 0:
                no_cell(out, g)
            else:
                (low, high), (d_low, d_high) = _box(bundle.rays, live), _box(ptr_at(bundle.rays, 48), live)
                put_cell(out, g, low, high, d_low, d_high, _F(1.0))


def bound_rays(picture: PictureCells, rays: PassRays, threads: int) -> NDArray[np.float32]:
    """The cells of a pass, (1, regions, ROWS, 16)."""
    cells = new_cells(picture, 1)
    run(_bound_pass, threads, new_ticket(cells.shape[1], 1), picture, rays, cells)
    return cells


@kernel
def _shorten_pass(ticket, spans, tiles, columns, picture, rays, cells):
    """Worker: update the limits of the cells of some tiles after tracing."""
    # In: spans, tiles, columns, picture, rays. Out: cells.
    bundle = bundle_in(stack_f32(BUNDLE_FLOATS))
    for i in items(ticket):
        span = spans[tiles[i]]
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            out = ptr_at(ptr(cells), region * WORDS)
            for g in range(16):
                corner = first_receiver(picture, region, g)
                if corner[0] < picture.h and corner[1] < picture.w:
                    load_rays(rays, picture, corner, bundle)
                    put(out, FAR * 16 + g, reduce_max(load16(bundle.limits, 0)))


def shorten_pass(
    cells: NDArray[np.float32],
    spans: NDArray[np.int32],
    tiles: NDArray[np.int32],
    picture: PictureCells,
    rays: PassRays,
    threads: int,
) -> None:
    """Update the cells of some tiles, as `nearest_hits.trace_nearest` does."""
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_shorten_pass, threads, ticket, spans, tiles, columns, picture, rays, cells)


# --- Camera rays: cells of 4 x 4 pixels; the tracer is `trace.primary` ------------------------------------------------

_REGION = 4 * CELL  # side of a region in pixels


class CameraBundles(NamedTuple):
    """The rays of a camera, and their limits."""

    rays: CameraRays
    t: np.ndarray  # (h, w) float64: the nearest hits so far
    length: float  # see `length_of`


@overload(bundles_in)
def _camera_bundles_in(source):
    if source.instance_class is CameraBundles:
        return lambda source: 1


@overload(load_bundle)
def _load_camera_bundle(source, picture, corner, s, k, bundle):
    if source.instance_class is CameraBundles:
        return lambda source, picture, corner, s, k, bundle: _load_camera_rays(source, picture, corner, bundle)


@kernel
def _load_camera_rays(source, picture, corner, bundle):
    """`load_bundle` of a camera."""
    rays, live = source.rays, 0
    for lane in range(16):
        y, x, inside = receiver_in(picture, corner, lane)
        d = pixel_direction(rays, x, y)
        for k in range(3):
            put(bundle.rays, 16 * k + lane, rays.origin[k])
        put(bundle.rays, 48 + lane, d[0] * _F(source.length))
        put(bundle.rays, 64 + lane, d[1] * _F(source.length))
        put(bundle.rays, 80 + lane, d[2] * _F(source.length))
        far = source.t[y, x] / source.length * BEYOND if inside else -1.0
        put(bundle.limits, lane, _F(min(far, 1.0)))
        live |= np.int64(inside) << lane
    return live


def length_of(reach: float) -> float:
    """The length of camera rays: the least power of two that is at least 2 * `reach`.

    The component of directions along the view axis is 1.
    """
    return power_of_two_above(2.0 * reach)


@inlined
def _ends(rays, error, length, x, y, k):
    """Bounds of coordinate k of the vectors from origin to end of the rays of the cell at pixel (x, y)."""
    half = 1.5 * abs(rays.dx[k]) + 1.5 * abs(rays.dy[k]) + 2.0 * error[k]
    middle = rays.corner[k] + (x + 2.0) * rays.dx[k] + (y + 2.0) * rays.dy[k]
    return (middle - half) * length, (middle + half) * length


@kernel
def _bound_camera(ticket, picture, rays, error, length, cells):
    """Worker: write the cells of regions."""
    eye = (rays.origin[0], rays.origin[1], rays.origin[2])
    for region in items(ticket):
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            y, x = first_receiver(picture, region, g)
            if y >= picture.h or x >= picture.w:
                no_cell(out, g)
                continue
            lx, hx = _ends(rays, error, length, x, y, 0)
            ly, hy = _ends(rays, error, length, x, y, 1)
            lz, hz = _ends(rays, error, length, x, y, 2)
            put_cell(out, g, eye, eye, (lx, ly, lz), (hx, hy, hz), _F(1.0))


def bound_camera(
    picture: PictureCells, rays: CameraRays, rows: slice, length: float, threads: int
) -> NDArray[np.float32]:
    """The cells of camera rays through some rows of pixels, (1, regions, ROWS, 16); other cells have no rays."""
    cells, columns = new_cells(picture, 1), picture.layout.columns
    run(_bound_camera, threads, new_ticket(cells.shape[1], 1), picture, rays, direction_error(rays), length, cells)
    first, end = rows.start // _REGION * columns, -(-rows.stop // _REGION) * columns
    cells[0, :first, FAR], cells[0, end:, FAR] = NONE, NONE
    return cells


@kernel
def _shorten_camera(ticket, spans, tiles, columns, picture, t, length, cells):
    """Worker: update the limits of the cells of some tiles after tracing."""
    for i in items(ticket):
        span = spans[tiles[i]]
        for j in range(regions_in(span)):
            region = region_in(span, j, columns)
            out = ptr_at(ptr(cells), region * WORDS)
            for g in range(16):
                y0, x0 = first_receiver(picture, region, g)
                far = -1.0
                for y in range(y0, min(y0 + CELL, picture.h)):
                    for x in range(x0, min(x0 + CELL, picture.w)):
                        far = max(far, t[y, x])
                put(out, FAR * 16 + g, min(far / length * BEYOND, 1.0))


def shorten_camera(
    cells: NDArray[np.float32],
    spans: NDArray[np.int32],
    tiles: NDArray[np.int32],
    picture: PictureCells,
    hits: Hits,
    length: float,
    threads: int,
) -> None:
    """Update the cells of some tiles: the limit of a cell is the farthest of its rays' nearest hits."""
    ticket, columns = new_ticket(len(tiles), 1), picture.layout.columns
    run(_shorten_camera, threads, ticket, spans, tiles, columns, picture, hits.t, length, cells)
