"""Passes of one ray a pixel: their cells and their bundles.

A ray's *length* is a power of two. This multiple of its direction takes the ray out of the scene.
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel, overload
from ..kernels.parallel import items, new_ticket, run
from ..kernels.predicate.filters import BEYOND
from ..kernels.simd import (
    as_i32,
    bits,
    get,
    load16,
    mask_from_bits16,
    maximum,
    minimum,
    popcount,
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
from ..kernels.vec import Vec, keep, largest, rows
from ..query.ray_passes import RayPass
from ..trace.tree_list import Hits, no_hits
from .bundles import BUNDLE_FLOATS, bundle_in, bundles_in, load_bundle
from .cells import WORDS, Picture, first_receiver, new_cells, no_cell, put_cell, receiver_in

_F = np.float32
_SMALLEST = _F(2.0**-126)  # a length is not denormal
_EXPONENT = 0x7F800000  # bits of a float32's exponent
_ROWS = 8  # every so many rows of pixels are looked at


class PassRays(NamedTuple):
    """One ray a pixel, and its nearest hit so far. If any hit will do, a ray with a hit looks no further."""

    origins: np.ndarray  # (h, w, 3) float32
    directions: np.ndarray  # (h, w, 3) float32; zero: there is no ray; of segments, rounded differences of their ends
    skip: np.ndarray  # (h, w) int32: triangles that do not count, -1 for none
    hits: Hits
    reach: float  # no ray is longer inside the scene
    spans: np.ndarray  # (h * w, 2) float64: tmin and tmax, in lengths of the direction; or (1, 2) for all rays
    each: int  # 1: each ray has its own span; 0: all have the same
    cull_faces: int  # a value of CULL_FACES
    any_hit: bool
    targets: np.ndarray  # (h, w, 3) float32, the ends of segments; (1, 1, 3) for rays
    segments: bool


EVERYWHERE = np.array([[0.0, np.inf]])
"""The span of rays without ends."""

NO_TARGETS = np.zeros((1, 1, 3), np.float32)


def pass_rays(rays: RayPass, h: int, w: int, reach: float) -> PassRays:
    """`PassRays` of a pass over a picture."""
    arrays = (a.reshape(h, w, *a.shape[1:]) for a in rays)
    return PassRays(*arrays, no_hits((h, w)), reach, EVERYWHERE, 0, 0, False, NO_TARGETS, False)


def is_spread(rays: PassRays) -> bool:
    """Whether cells should be spread: directions of every fourth pixel are more alike than those of neighbours."""
    if min(rays.skip.shape) <= 4:
        return False
    d = rays.directions[::_ROWS].astype(np.float64)
    d /= np.maximum(np.linalg.norm(d, axis=2, keepdims=True), 1e-30)
    return bool((d[:, :-4] * d[:, 4:]).sum() > (d[:, :-4] * d[:, 1:-3]).sum())


@inlined
def _load_ray(rays, picture, y0, x0, lane, bundle):
    """Load the ray of a lane, and how far it looks in lengths of its direction. Return whether it looks."""
    y, x, inside = receiver_in(picture, y0, x0, lane)
    y, x = (y, x) if inside else (y0, x0)
    d, far = rays.directions[y, x], _F(rays.hits.t[y, x])
    for k in range(3):
        put(bundle.rays, 16 * k + lane, rays.origins[y, x, k])
        put(bundle.rays, 48 + 16 * k + lane, d[k])
    put(bundle.limits, lane, min(far, _F(span_of(rays, y, x)[1])))
    return inside and not (rays.any_hit and rays.hits.face[y, x] >= 0)


@kernel
def load_rays(rays, picture, y0, x0, bundle):
    """Fill the bundle of a cell. Return bits of its rays that look."""
    live = np.int64(0)
    for lane in range(16):
        live |= np.int64(_load_ray(rays, picture, y0, x0, lane, bundle)) << lane
    d = rows(bundle.rays, 48, 16)
    size = largest(d)
    live &= bits(size > _F(0.0))
    lanes = mask_from_bits16(live)
    whole = splat16(_F(rays.reach)) / select(lanes, size, splat16(_F(1.0))) * _F(4.0)
    store(bundle.lengths, 0, maximum(whole, splat16(_SMALLEST)))
    store(as_i32(bundle.lengths), 0, load16(as_i32(bundle.lengths), 0) & splat16(np.int32(_EXPONENT)))
    lengths = load16(bundle.lengths, 0)
    keep(bundle.rays, 48, 16, Vec(d.x * lengths, d.y * lengths, d.z * lengths))
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
    """How far a ray with a hit at t looks, as a share of its whole length."""
    return _F(min(t / np.float64(get(bundle.lengths, lane)) * BEYOND, 1.0))


@overload(bundles_in)
def _bundles_in(source):
    if source.instance_class is PassRays:
        return lambda source: 1


@overload(load_bundle)
def _load_bundle(source, picture, y0, x0, s, k, blind, bundle):
    if source.instance_class is PassRays:
        return lambda source, picture, y0, x0, s, k, blind, bundle: load_rays(source, picture, y0, x0, bundle)


@inlined
def _box(vectors, live):
    """The corners of the box of the vectors in three rows, in the lanes of `live`."""
    lanes, v, inf = mask_from_bits16(live), rows(vectors, 0, 16), splat16(_F(np.inf))
    low = Vec(select(lanes, v.x, inf), select(lanes, v.y, inf), select(lanes, v.z, inf))
    high = Vec(select(lanes, v.x, -inf), select(lanes, v.y, -inf), select(lanes, v.z, -inf))
    return (
        (reduce_min(low.x), reduce_min(low.y), reduce_min(low.z)),
        (reduce_max(high.x), reduce_max(high.y), reduce_max(high.z)),
    )


@kernel
def _bound(ticket, picture, rays, cells):
    """Worker: write the cells of regions."""
    bundle = bundle_in(stack_f32(BUNDLE_FLOATS))
    for region in items(ticket):
        out = ptr_at(ptr(cells), region * WORDS)
        for g in range(16):
            y0, x0 = first_receiver(picture, region, g)
            live = load_rays(rays, picture, y0, x0, bundle) if y0 < picture.h and x0 < picture.w else np.int64(0)
            if live == 0:
                no_cell(out, g)
            else:
                (low, high), (d_low, d_high) = _box(bundle.rays, live), _box(ptr_at(bundle.rays, 48), live)
                put_cell(out, g, low, high, d_low, d_high, _F(1.0), _F(popcount(live)))


def bound_rays(picture: Picture, rays: PassRays, threads: int) -> np.ndarray:
    """The cells of a pass, (1, regions, ROWS, 16)."""
    cells = new_cells(picture, 1)
    run(_bound, threads, new_ticket(cells.shape[1], 1), picture, rays, cells)
    return cells
