"""The state of a tile's pixels: the triangle that each pixel of primary rays has seen so far.

A pixel's slot is the slot of a triangle in the current tree. A triangle of an earlier tree is `KNOWN`. The pixel then
keeps the number of that tree, and the slot there. If an earlier call found the triangle, its face and its t are in the
picture.
"""

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.predicate.filters import is_nearer, meets
from ...kernels.simd import bits, get, iota16, load16, lowest_bit, minimum, put, reduce_min, select, splat16, store
from ...query.gbuffer import pixel_ray
from ...query.raster_setup import NO_PLANE, eye_plane, plane_t
from ..forest import tree_in
from ..slabs import GROW
from .pixelblock import CELLS, first_pixel

_F = np.float32
NOTHING, KNOWN = np.int32(-1), np.int32(-2)  # instead of a slot
_NEXT_BELOW, _NEXT_ABOVE, _TINY = 1.0 - 2.0**-22, 1.0 + 2.0**-22, 1e-37  # exceed the rounding of a key to float32
_BEYOND = GROW * GROW  # once for rounding t, once as exits grow
_LARGEST = 1e30  # more than a depth key that float32 computes


@inlined
def start(pixels, x0, y0, rays):
    """Reset the pixels: nothing is seen yet. Return bits of the frusta that have pixels."""
    alive = np.int64(0)
    for cell in range(CELLS):
        x, y = first_pixel(cell)
        inside = ((iota16() & 3) < rays.width - x0 - x) & ((iota16() >> 2) < rays.height - y0 - y)
        store(pixels.low, 16 * cell, select(inside, splat16(_F(-np.inf)), splat16(_F(np.inf))))
        store(pixels.high, 16 * cell, splat16(_F(-np.inf)))
        store(pixels.slot, 16 * cell, splat16(NOTHING))
        store(pixels.part, 16 * cell, splat16(NOTHING))
        put(pixels.least, cell, _F(-np.inf) if bits(inside) != 0 else _F(np.inf))
        if bits(inside) != 0:
            alive |= np.int64(1) << (cell & 15)
    store(pixels.far, 0, splat16(_F(np.inf)))
    put(pixels.deferred, 0, 0)
    return alive


@inlined
def _see(pixels, at, slot, t, scale):
    """Note that pixel `at` sees the triangle in `slot` at t."""
    key = 1.0 / (t * scale) if scale > 0.0 else 0.0
    low = key * _NEXT_BELOW - _TINY if scale > 0.0 else -np.inf
    put(pixels.low, at, low if low < _LARGEST else _LARGEST)
    put(pixels.high, at, key * _NEXT_ABOVE + _TINY if scale > 0.0 else np.inf)
    put(pixels.slot, at, slot)


@inlined
def _update_least(pixels, touched):
    """Update `least` of the cells in `touched` (bits)."""
    while touched != 0:
        cell = lowest_bit(touched)
        touched &= touched - 1
        put(pixels.least, cell, reduce_min(load16(pixels.low, 16 * cell)))


@kernel
def resume(pixels, x0, y0, rays, face, t, scale):
    """`start` for a tile whose picture already holds hits of earlier calls."""
    alive, touched = start(pixels, x0, y0, rays), np.int64(0)
    for cell in range(CELLS):
        across, down = first_pixel(cell)
        for y in range(y0 + down, min(y0 + down + 4, rays.height)):
            for x in range(x0 + across, min(x0 + across + 4, rays.width)):
                at = y * rays.width + x
                if get(face, at) >= 0:
                    _see(pixels, 16 * cell + 4 * (y - y0 - down) + x - x0 - across, KNOWN, get(t, at), scale)
                    touched |= np.int64(1) << cell
    if touched != 0:
        _update_least(pixels, touched)
        shorten(pixels, _F(scale))
    return alive


@inlined
def shorten(pixels, scale):
    """Shorten the frusta (`far`), after some of their pixels have seen nearer triangles."""
    least, far = minimum(load16(pixels.least, 0), load16(pixels.least, 16)), load16(pixels.far, 0)
    store(pixels.far, 0, select(least > _F(0.0), _F(1.0) / (least * scale) * _BEYOND, far))


@inlined
def keep(pixels, number):
    """Finish the current tree, `number`: its visible triangles become KNOWN. Return whether there are any."""
    any_ = np.int64(0)
    for cell in range(CELLS):
        slot, part = load16(pixels.slot, 16 * cell), load16(pixels.part, 16 * cell)
        new = slot >= np.int32(0)
        any_ |= bits(new)
        store(pixels.kept, 16 * cell, select(new, slot, load16(pixels.kept, 16 * cell)))
        store(pixels.part, 16 * cell, select(new, splat16(np.int32(number)), part))
        store(pixels.slot, 16 * cell, select(new, splat16(KNOWN), slot))
    return any_ != 0


@inlined
def _plane_of(forest, known, part, slot, o):
    """(the plane of a triangle, its part). `known`: the last plane and its part, reused if the triangle is the same."""
    plane, of = known
    if slot != plane.triangle or part != of:
        plane = eye_plane(tree_in(forest, part).corners, slot, o)
    return plane, part


@inlined
def _best_of(pixels, at, forest, other, part, ray, o, pixel, face, t):
    """((the last plane, its part), t, face) of the triangle that pixel `at` sees."""
    slot = np.int64(get(pixels.slot, at))
    if slot == KNOWN:
        part, slot = np.int64(get(pixels.part, at)), np.int64(get(pixels.kept, at))
        if part < 0:
            return other, get(t, pixel), np.int64(get(face, pixel))
    tree, other = tree_in(forest, part), _plane_of(forest, other, part, slot, o)
    return other, plane_t(other[0], ray, tree.corners), np.int64(get(tree.prim_ids, slot))


@kernel
def settle(pixels, forest, part, rays, x0, y0, scale, face, t):
    """Settle the deferred pixels of tree `part` by the contract's predicates.

    face, t : pointers to the picture, with the triangles that are `KNOWN` from earlier calls
    """
    # In: forest, part, rays, x0, y0, scale, face, t. In and out: pixels.
    o, touched, tree = rays.origin, np.int64(0), tree_in(forest, part)
    mine, other = (NO_PLANE, np.int64(-1)), (NO_PLANE, np.int64(-1))
    for k in range(np.int64(get(pixels.deferred, 0))):
        slot, entry = np.int64(get(pixels.deferred, 2 + 2 * k)), np.int64(get(pixels.deferred, 3 + 2 * k))
        at = entry >> 1
        (across, down), lane = first_pixel(at >> 4), at & 15
        x, y = x0 + across + (lane & 3), y0 + down + (lane >> 2)
        ray = pixel_ray(rays, x, y)
        if entry & 1 == 0 and meets(ray, tree.corners, slot) == 0:
            continue
        mine = _plane_of(forest, mine, part, slot, o)
        new_t = plane_t(mine[0], ray, tree.corners)
        if get(pixels.slot, at) != NOTHING:
            pixel = y * rays.width + x
            other, best_t, best = _best_of(pixels, at, forest, other, part, ray, o, pixel, face, t)
            if is_nearer(best_t, best, new_t, get(tree.prim_ids, slot)):
                continue
        _see(pixels, at, slot, new_t, scale)
        touched |= np.int64(1) << (at >> 4)
    put(pixels.deferred, 0, 0)
    _update_least(pixels, touched)
