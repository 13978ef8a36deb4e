"""The nearest hit of each pixel of a tile: the candidate so far, and the final face and canonical `t`.

State. A pixel's slot is that of a triangle in the current tree. For a triangle of an earlier tree it is `KNOWN`, and
the pixel stores the number of that tree and the slot in it. If the triangle is a hit of an earlier call, its face and t
are in the picture.

Resolution. Computed from a triangle's corners, the float64 `hit_t` costs more than all tests of a pixel together. So
the plane of each visible triangle is computed once per tile, and 16 pixels divide side by side.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.exact.filters import comes_first, hit_t, meets, precedes, signed_t
from ...kernels.jit import F64Ptr, I32Ptr, inlined, kernel
from ...kernels.simd import (
    as_f32,
    bits,
    get,
    iota16,
    load4,
    load8,
    load16,
    lowest_bit,
    minimum,
    ptr,
    ptr_at,
    put,
    reduce_min,
    select,
    splat16,
    store,
)
from ...query.gbuffer import pixel_ray
from ...query.raster_setup import NO_PLANE, EyePlane, eye_plane, plane_t, quick_t
from ...scene.camera import CameraRays
from ..descent import GROW
from ..tree_list import is_in_memory, tree_in
from .pixel_tests import CELLS, PIXELS, first_pixel

# --- State of the pixels ----------------------------------------------------------------------------------------------


_F = np.float32
NOTHING, KNOWN = np.int32(-1), np.int32(-2)  # instead of a slot
_NEXT_BELOW, _NEXT_ABOVE, _TINY = 1.0 - 2.0**-22, 1.0 + 2.0**-22, 1e-37  # exceed the rounding of a key to float32
_BEYOND = GROW * GROW  # once for the rounding of t, once as for exits
_LARGEST = 1e30  # more than any depth key computed in float32


@inlined
def start(pixels, x0, y0, rays):
    """Reset the pixels to no hit. Return bits of the frusta that have pixels."""
    alive = 0
    for cell in range(CELLS):
        x, y = first_pixel(cell)
        inside = ((iota16() & 3) < rays.width - x0 - x) & ((iota16() >> 2) < rays.height - y0 - y)
        store(pixels.low, 16 * cell, select(inside, splat16(_F(-np.inf)), splat16(_F(np.inf))))
        store(pixels.high, 16 * cell, splat16(_F(-np.inf)))
        store(pixels.slot, 16 * cell, splat16(NOTHING))
        store(pixels.part, 16 * cell, splat16(NOTHING))
        put(pixels.least, cell, _F(-np.inf) if bits(inside) != 0 else _F(np.inf))
        if bits(inside) != 0:
            alive |= 1 << (cell & 15)
    store(pixels.far, 0, splat16(_F(np.inf)))
    put(pixels.deferred, 0, 0)
    return alive


@inlined
def _set_hit(pixels, at, slot, t, scale):
    """Set the hit of pixel `at`: the triangle in `slot` at t."""
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
    """`start` for a tile whose picture already has hits of earlier calls."""
    alive, touched = start(pixels, x0, y0, rays), 0
    for cell in range(CELLS):
        across, down = first_pixel(cell)
        for y in range(y0 + down, min(y0 + down + 4, rays.height)):
            for x in range(x0 + across, min(x0 + across + 4, rays.width)):
                at = y * rays.width + x
                if get(face, at) >= 0:
                    _set_hit(pixels, 16 * cell + 4 * (y - y0 - down) + x - x0 - across, KNOWN, get(t, at), scale)
                    touched |= 1 << cell
    if touched != 0:
        _update_least(pixels, touched)
        shorten(pixels, _F(scale))
    return alive


@inlined
def shorten(pixels, scale):
    """Shorten the frusta (`far`) after some of their pixels have nearer hits."""
    least, far = minimum(load16(pixels.least, 0), load16(pixels.least, 16)), load16(pixels.far, 0)
    store(pixels.far, 0, select(least > _F(0.0), _F(1.0) / (least * scale) * _BEYOND, far))


@inlined
def keep(pixels, number):
    """Finish the current tree, `number`, by making its visible triangles KNOWN. Return whether there are any."""
    any_ = 0
    for cell in range(CELLS):
        slot, part = load16(pixels.slot, 16 * cell), load16(pixels.part, 16 * cell)
        new = slot >= np.int32(0)
        any_ |= bits(new)
        store(pixels.known_slot, 16 * cell, select(new, slot, load16(pixels.known_slot, 16 * cell)))
        store(pixels.part, 16 * cell, select(new, splat16(np.int32(number)), part))
        store(pixels.slot, 16 * cell, select(new, splat16(KNOWN), slot))
    return any_ != 0


@inlined
def _plane_of(tree_list, known, part, slot, o):
    """(plane of a triangle, its part); `known`: the previous result, reused if the triangle is the same."""
    plane, of = known
    if slot != plane.triangle or part != of:
        plane = eye_plane(tree_in(tree_list, part).corners, slot, o)
    return plane, part


@inlined
def _place_of_best(pixels, at, part, known, pixel):
    """(tree, slot) of the hit of pixel `at` so far, during tree `part`; known: pointers to those of earlier calls."""
    slot = get(pixels.slot, at)
    if slot != KNOWN:
        return part, slot
    if get(pixels.part, at) >= 0:
        return get(pixels.part, at), get(pixels.known_slot, at)
    return get(known[0], pixel), get(known[1], pixel)


@kernel
def settle(pixels, tree_list, part, rays, x0, y0, scale, hits):
    """Settle the deferred pixels of tree `part` by the contract's predicates.

    hits : `Hits` of the picture, which holds those of earlier calls
    """
    # In: tree_list, part, rays, x0, y0, scale, hits. In and out: pixels.
    o, touched, tree = rays.origin, 0, tree_in(tree_list, part)
    known, face, signed = (ptr(hits.part), ptr(hits.slot)), ptr(hits.face), ptr(hits.signed_t)
    mine, other = (NO_PLANE, -1), (NO_PLANE, -1)
    for k in range(get(pixels.deferred, 0)):
        slot, entry = get(pixels.deferred, 2 + 2 * k), get(pixels.deferred, 3 + 2 * k)
        at = entry >> 1
        (across, down), lane = first_pixel(at >> 4), at & 15
        x, y = x0 + across + (lane & 3), y0 + down + (lane >> 2)
        ray, prim = pixel_ray(rays, x, y), get(tree.prim_ids, slot)
        if entry & 1 == 0 and meets(ray, tree.corners, slot) == 0:
            continue
        mine = _plane_of(tree_list, mine, part, slot, o)
        new_t = plane_t(mine[0], ray, tree.corners)
        if get(pixels.slot, at) != NOTHING:
            pixel = y * rays.width + x
            of, best = _place_of_best(pixels, at, part, known, pixel)
            if is_in_memory(tree_list, of):
                there, other = tree_in(tree_list, of), _plane_of(tree_list, other, of, best, o)
                best_t, best_prim = plane_t(other[0], ray, there.corners), get(there.prim_ids, best)
                if not comes_first(ray, tree.corners, slot, prim, new_t, there.corners, best, best_prim, best_t):
                    continue
            elif not precedes(signed_t(ray, tree.corners, slot), prim, get(signed, pixel), get(face, pixel)):
                continue
        _set_hit(pixels, at, slot, new_t, scale)
        touched |= 1 << (at >> 4)
    put(pixels.deferred, 0, 0)
    _update_least(pixels, touched)


# --- Resolution of a tile ---------------------------------------------------------------------------------------------


_CELL = 6 * 16  # float64 of 16 pixels: five rows for their planes, one row for t
_T = 5 * 16
PLANE_FLOATS = CELLS * _CELL
KNOWN_PLANES = PIXELS + 1
KNOWN_FLOATS = 5 * KNOWN_PLANES
_MARKS = 64  # a power of two
MARK_WORDS = 3 * _MARKS


class ResolveScratch(NamedTuple):
    """Pointers to scratch memory."""

    planes: F64Ptr  # float64, PLANE_FLOATS: per cell, five rows of 16 pixels for their planes, one row for t
    face: I32Ptr  # int32, PIXELS: in the order of cells, like all of `Pixels`
    known: F64Ptr  # float64, KNOWN_FLOATS: five numbers per plane; plane 0 stands for no plane
    ids: I32Ptr  # int32, KNOWN_PLANES: faces of these planes
    marks: I32Ptr  # int32, MARK_WORDS: hash table by the last bits of a slot: slots, parts, numbers of planes


@inlined
def _by_value(rays):
    """The same `CameraRays` without arrays, so that LLVM can rule out that stores change them."""
    o, c, dx, dy = rays.origin, rays.corner, rays.dx, rays.dy
    return CameraRays(
        (o[0], o[1], o[2]), (c[0], c[1], c[2]), (dx[0], dx[1], dx[2]), (dy[0], dy[1], dy[2]), rays.width, rays.height
    )


@inlined
def _put_plane(p, at, stride, plane):
    put(p, at, plane.nx)
    put(p, at + stride, plane.ny)
    put(p, at + 2 * stride, plane.nz)
    put(p, at + 3 * stride, plane.volume)
    put(p, at + 4 * stride, plane.least)


@inlined
def _get_plane(p, at, stride):
    return EyePlane(
        0, get(p, at), get(p, at + stride), get(p, at + 2 * stride), get(p, at + 3 * stride), get(p, at + 4 * stride)
    )


@kernel
def _find_planes(pixels, tree_list, o, scratch):
    """Write the face and the plane of each pixel. A plane is recomputed only if its mark was overwritten."""
    for k in range(0, 2 * _MARKS, 16):
        store(scratch.marks, k, splat16(np.int32(-1)))
    _put_plane(scratch.known, 0, 1, NO_PLANE)
    put(scratch.ids, 0, np.int32(-1))
    n = 1
    for k in range(PIXELS):
        part, number = get(pixels.part, k), 0
        if part >= 0:
            slot = get(pixels.known_slot, k)
            mark = slot & (_MARKS - 1)
            number = get(scratch.marks, 2 * _MARKS + mark)
            if get(scratch.marks, mark) != slot or get(scratch.marks, _MARKS + mark) != part:
                tree, number = tree_in(tree_list, part), n
                _put_plane(scratch.known, 5 * n, 1, eye_plane(tree.corners, slot, o))
                put(scratch.ids, n, get(tree.prim_ids, slot))
                put(scratch.marks, mark, slot)
                put(scratch.marks, _MARKS + mark, part)
                put(scratch.marks, 2 * _MARKS + mark, n)
                n += 1
        _put_plane(scratch.planes, _CELL * (k >> 4) + (k & 15), 16, _get_plane(scratch.known, 5 * number, 1))
        put(scratch.face, k, get(scratch.ids, number))


@inlined
def _find_t(planes, face, rays, x, y):
    """Write t of the 16 pixels of a cell, or -1 where float64 may be inaccurate. Return whether there is such a pixel.

    LLVM vectorises the loop.
    """
    # Eq. (4) of docs/design/exactness.md
    unsure = False
    for i in range(16):
        t = quick_t(_get_plane(planes, i, 16), pixel_ray(rays, x + (i & 3), y + (i >> 2)))
        t = np.inf if get(face, i) < 0 else t
        unsure |= t < 0.0
        put(planes, _T + i, t)
    return unsure


@kernel
def _correct_t(pixels, tree_list, rays, x, y, cell, planes):
    """Compute t by `hit_t` where float64 may be inaccurate."""
    for i in range(16):
        if get(planes, _T + i) < 0.0:
            at = 16 * cell + i
            ray, tree = pixel_ray(rays, x + (i & 3), y + (i >> 2)), tree_in(tree_list, get(pixels.part, at))
            put(planes, _T + i, hit_t(ray, tree.corners, get(pixels.known_slot, at)))


@inlined
def _write_cell(scratch, cell, known, face, t, at, width, columns, rows):
    """Copy a cell to the picture, except its pixels in `known` (bits). The bits of t are copied as float32 words.

    at : index in the picture of the cell's first pixel
    """
    # In: seen, cell, known, at, width, columns, rows. Out: face, t.
    source, bits64, ids = ptr_at(scratch.planes, _CELL * cell + _T), as_f32(t), ptr_at(scratch.face, 16 * cell)
    for k in range(0, 4 * rows, 4):
        if columns == 4 and known == 0:
            store(bits64, 2 * at, load8(as_f32(source), 2 * k))
            store(face, at, load4(ids, k))
        else:
            for i in range(columns):
                if known >> (k + i) & 1 == 0:
                    put(t, at + i, get(source, k + i))
                    put(face, at + i, get(ids, k + i))
        at += width


@inlined
def _write_place(pixels, cell, part, slot, at, width, columns, rows):
    """Write the part and slot of each pixel's visible triangle in a cell."""
    # In: pixels, cell, at, width, columns, rows. Out: part, slot.
    for k in range(0, 4 * rows, 4):
        for i in range(columns):
            mine = get(pixels.part, 16 * cell + k + i)
            if mine >= 0:
                put(part, at + i, mine)
                put(slot, at + i, get(pixels.known_slot, 16 * cell + k + i))
        at += width


@kernel
def resolve(pixels, tree_list, rays, x0, y0, scratch, hits):
    """Write this call's hits in the tile at pixel (x0, y0), and misses for pixels without any hit.

    scratch : ResolveScratch
    hits : Hits of the picture
    """
    camera, face, t, part, slot = _by_value(rays), ptr(hits.face), ptr(hits.t), ptr(hits.part), ptr(hits.slot)
    _find_planes(pixels, tree_list, camera.origin, scratch)
    for cell in range(CELLS):
        across, down = first_pixel(cell)
        x, y, planes = x0 + across, y0 + down, ptr_at(scratch.planes, _CELL * cell)
        columns, rows = min(4, camera.width - x), min(4, camera.height - y)
        before = load16(pixels.part, 16 * cell) < np.int32(0)
        known = bits((load16(pixels.slot, 16 * cell) == KNOWN) & before)
        if columns > 0 and rows > 0 and known != 0xFFFF:
            if _find_t(planes, ptr_at(scratch.face, 16 * cell), camera, x, y):
                _correct_t(pixels, tree_list, camera, x, y, cell, planes)
            at = y * camera.width + x
            _write_cell(scratch, cell, known, face, t, at, camera.width, columns, rows)
            if len(hits.part) > 0:
                _write_place(pixels, cell, part, slot, at, camera.width, columns, rows)
