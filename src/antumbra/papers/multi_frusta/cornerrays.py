"""The frusta of the paper: one from each of 16 receivers to all of its samples [Benthin and Wald 2009, Sec. 4].

A receiver's samples lie in a rectangle [a_low, a_high] x [b_low, b_high] of the light's patch, with points
base + a u + b v. The segments to its four corners are the *corner rays* (Sec. 4.2, 4.4). The box of the samples bounds
the directions for the traversal (Sec. 4.1). Lanes are receivers.

Rounding moves samples and corners off their exact positions on the patch. The error along every axis is a few units in
the last place of |base| + |u| + |v|. `OFF` bounds both errors together (16 units). A corner ray culls samples only by a
margin that exceeds this error. Lists of lights and ambient light have no rectangle. Then `OFF` is infinite, corner rays
cull nothing, and only the box bounds the frusta.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.fields import F32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    absolute,
    fma,
    get,
    load16,
    lowest_bit,
    mask_from_bits16,
    maximum,
    ptr,
    ptr_at,
    put,
    reduce_max,
    reduce_min,
    select,
    splat16,
    store,
)
from ...kernels.vec import Vec, keep, magnitudes, minus, rows
from ...query.shadow_query import patch_of
from ...scene.lights import AMBIENT, LIST
from ...trace.counters import SHRINKS, count
from ...trace.descent import Shafts
from ...trace.packets.ray_tile import open_rays
from ...trace.tile import first_pixel, place_of
from ...trace.triangle_tests import length1

_F = np.float32
_BASE, _U, _V, _A_LOW, _A_HIGH, _B_LOW, _B_HIGH = (16 * i for i in (0, 3, 6, 9, 10, 11, 12))
CORNERS, SPAN, OFF, _D_LOW, _D_HIGH = (16 * i for i in (13, 25, 26, 27, 30))
FRUSTA_FLOATS = 33 * 16


class Frusta(NamedTuple):
    """16 frusta, as pointers to float32."""

    own: F32Ptr  # float32 *, rows of 16 lanes: patch, rectangle, corner rays (x, y, z of each), their lengths, box
    parameters: F32Ptr  # float32 *, rows of 16 samples: a and b of each receiver's samples


@kernel
def _load_patches(chunk, rays, own):
    """Store the light's patch for each receiver, and `OFF`."""
    y0, x0 = first_pixel(rays.pixel, 0)
    for lane in range(16):
        there = lane if rays.rows >> lane & 1 else lowest_bit(rays.rows)
        patch = patch_of(chunk.query, place_of(chunk, y0, x0, there))
        for k in range(9):
            put(own, _BASE + 16 * k + lane, _F(patch[k]))
    off = splat16(_F(0.0))
    for k in range(0, 48, 16):
        size = absolute(load16(own, _BASE + k)) + absolute(load16(own, _U + k)) + absolute(load16(own, _V + k))
        off = maximum(off, size)
    store(own, OFF, off * _F(16 * 2.0**-24) if _is_flat(chunk.query.light) else splat16(_F(np.inf)))


@inlined
def _corner(own, a, b, origins):
    """Directions from the receivers to the points (a, b) of the patches."""
    base, u, v = rows(own, _BASE, 16), rows(own, _U, 16), rows(own, _V, 16)
    point = Vec(fma(b, v.x, fma(a, u.x, base.x)), fma(b, v.y, fma(a, u.y, base.y)), fma(b, v.z, fma(a, u.z, base.z)))
    return minus(point, origins)


@inlined
def _is_flat(light):
    w = light.w  # not zero: a list of distant lights
    return light.kind != LIST and light.kind != AMBIENT and w[0] == 0.0 and w[1] == 0.0 and w[2] == 0.0


@inlined
def _box_span(own):
    low, high = magnitudes(rows(own, _D_LOW, 16)), magnitudes(rows(own, _D_HIGH, 16))
    return length1(Vec(maximum(low.x, high.x), maximum(low.y, high.y), maximum(low.z, high.z)))


@inlined
def _aim(own, tile):
    """Compute corner rays and their lengths from the rectangles."""
    origins, span = rows(tile.origins, 0, 16), splat16(_F(0.0))
    for corner in range(4):
        a = load16(own, _A_LOW if corner & 1 == 0 else _A_HIGH)
        b = load16(own, _B_LOW if corner & 2 == 0 else _B_HIGH)
        d = _corner(own, a, b, origins)
        keep(own, CORNERS + 48 * corner, 16, d)
        span = maximum(span, length1(d))
    off = load16(own, OFF)
    store(own, SPAN, select(off < _F(np.inf), fma(off, splat16(_F(3.0)), span), _box_span(own)))


@inlined
def _range(values, there):
    """(least, largest) of those of 16 numbers whose lanes are set in the mask `there`."""
    far = _F(np.inf)
    return reduce_min(select(there, values, splat16(far))), reduce_max(select(there, values, splat16(-far)))


@inlined
def _bound_rectangle(frusta, r, samples):
    """Store the rectangle of the samples (bits) of receiver r."""
    there = mask_from_bits16(samples)
    low, high = _range(load16(frusta.parameters, r * 32), there)
    put(frusta.own, _A_LOW + r, low)
    put(frusta.own, _A_HIGH + r, high)
    low, high = _range(load16(frusta.parameters, r * 32 + 16), there)
    put(frusta.own, _B_LOW + r, low)
    put(frusta.own, _B_HIGH + r, high)


@inlined
def _bound_directions(rays, frusta, r, samples):
    """Store the box of the samples (bits) of receiver r, relative to the receiver."""
    there = mask_from_bits16(samples)
    for k in range(3):
        o = get(rays.tile.origins, 16 * k + r)
        low, high = _range(load16(rays.points, r * 48 + 16 * k), there)
        put(frusta.own, _D_LOW + 16 * k + r, low - o)
        put(frusta.own, _D_HIGH + 16 * k + r, high - o)


@kernel
def make_frusta(chunk, samples, job, rays, own):
    """Make the `Frusta` of a tile, to all samples of the chunk, in the memory `own`."""
    frusta = Frusta(own, ptr_at(ptr(samples.parameters), job.chunk * 512))
    if rays.rows != 0:
        _load_patches(chunk, rays, own)
        for r in range(16):
            _bound_rectangle(frusta, r, rays.lanes)
            _bound_directions(rays, frusta, r, rays.lanes)
        _aim(own, rays.tile)
    return frusta


@kernel
def shrink(rays, frusta, which, directions, counters):
    """Shrink the frusta `which` (bits, at least one) to their unblocked rays (Sec. 5.3).

    This always shrinks the corner rays (*CR*). With `directions`, it shrinks the bounds of the directions too (*FS*).
    """
    while which != 0:
        r = lowest_bit(which)
        which &= which - 1
        samples = open_rays(rays, r)
        count(counters, SHRINKS, 1)
        _bound_rectangle(frusta, r, samples)
        if directions:
            _bound_directions(rays, frusta, r, samples)
    _aim(frusta.own, rays.tile)


@inlined
def frusta_as_shafts(rays, frusta):
    """The 16 frusta as `Shafts`."""
    o, low, high = rows(rays.tile.origins, 0, 16), rows(frusta.own, _D_LOW, 16), rows(frusta.own, _D_HIGH, 16)
    return Shafts(o.x, o.y, o.z, o.x, o.y, o.z, low.x, low.y, low.z, high.x, high.y, high.z)
