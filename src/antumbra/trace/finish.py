"""The faces and the canonical t of what a tile of primary rays sees.

`hit_t` is float64 and costs more than all tests of a pixel together if it is computed from the corners. So the plane of
each triangle that the tile sees is computed once, and 16 pixels divide side by side.
"""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from ..predicate.filters import hit_t
from ..query.pixels import pixel_ray
from ..query.raster_depth import NO_PLANE, EyePlane, eye_plane, quick_t
from ..scene.camera import CameraRays
from ..simd import as_f32, get, load4, load8, ptr_at, put, splat16, store
from .pixelblock import CELLS, PIXELS, first_pixel

_CELL = 6 * 16  # float64 of 16 pixels: five rows for their planes, and t
_T = 5 * 16
PLANE_FLOATS = CELLS * _CELL
KNOWN = PIXELS + 1
KNOWN_FLOATS = 5 * KNOWN
_MARKS = 64  # a power of two
MARK_WORDS = 2 * _MARKS


class Seen(NamedTuple):
    """Pointers to scratch memory."""

    planes: object  # float64, PLANE_FLOATS: of each cell five rows of 16 pixels for their planes, and one for their t
    face: object  # int32, PIXELS: in the order of cells, like all of `Pixels`
    known: object  # float64, KNOWN_FLOATS: five numbers a plane; number 0 is no plane
    ids: object  # int32, KNOWN: faces of these planes
    marks: object  # int32, MARK_WORDS: by the last bits of a slot, the slot; then the number of its plane


@inlined
def _by_value(rays):
    """The same `CameraRays` without arrays, so that LLVM sees that no store changes them."""
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
def _find_planes(pixels, tree, o, seen):
    """Write the face and the plane of each pixel. A triangle's plane is computed again only if its mark was lost."""
    for k in range(0, _MARKS, 16):
        store(seen.marks, k, splat16(np.int32(-1)))
    _put_plane(seen.known, 0, 1, NO_PLANE)
    put(seen.ids, 0, np.int32(-1))
    n = np.int64(1)
    for k in range(PIXELS):
        slot, number = np.int64(get(pixels.slot, k)), np.int64(0)
        if slot >= 0:
            mark = slot & (_MARKS - 1)
            number = np.int64(get(seen.marks, _MARKS + mark))
            if np.int64(get(seen.marks, mark)) != slot:
                number = n
                _put_plane(seen.known, 5 * n, 1, eye_plane(tree.corners, slot, o))
                put(seen.ids, n, get(tree.prim_ids, slot))
                put(seen.marks, mark, slot)
                put(seen.marks, _MARKS + mark, n)
                n += 1
        _put_plane(seen.planes, _CELL * (k >> 4) + (k & 15), 16, _get_plane(seen.known, 5 * number, 1))
        put(seen.face, k, get(seen.ids, number))


@inlined
def _find_t(planes, face, rays, x, y):
    """Write t of the 16 pixels of a cell, -1 where float64 is not surely accurate; whether there is such a pixel.

    LLVM makes vectors of this.
    """
    unsure = False
    for i in range(16):
        t = quick_t(_get_plane(planes, i, 16), pixel_ray(rays, x + (i & 3), y + (i >> 2)))
        t = np.inf if get(face, i) < 0 else t
        unsure |= t < 0.0
        put(planes, _T + i, t)
    return unsure


@kernel
def _correct_t(pixels, tree, rays, x, y, cell, planes):
    """Let `hit_t` decide where float64 is not surely accurate."""
    for i in range(16):
        if get(planes, _T + i) < 0.0:
            ray, slot = pixel_ray(rays, x + (i & 3), y + (i >> 2)), np.int64(get(pixels.slot, 16 * cell + i))
            put(planes, _T + i, hit_t(ray, tree.corners, slot))


@inlined
def _write_cell(seen, cell, face, t, at, width, columns, rows):
    """Copy a cell to the picture, of which pixel `at` is its first; t bit by bit, as float32."""
    source, bits, ids = ptr_at(seen.planes, _CELL * cell + _T), as_f32(t), ptr_at(seen.face, 16 * cell)
    for k in range(0, 4 * rows, 4):
        if columns == 4:
            store(bits, 2 * at, load8(as_f32(source), 2 * k))
            store(face, at, load4(ids, k))
        else:
            for i in range(columns):
                put(t, at + i, get(source, k + i))
                put(face, at + i, get(ids, k + i))
        at += width


@kernel
def finish(pixels, tree, rays, x0, y0, seen, face, t):
    """Write the faces and t of the tile at pixel (x0, y0).

    seen : Seen, scratch memory
    face, t : pointers to the picture's int32 and float64
    """
    camera = _by_value(rays)
    _find_planes(pixels, tree, camera.origin, seen)
    for cell in range(CELLS):
        across, down = first_pixel(cell)
        x, y, planes = x0 + across, y0 + down, ptr_at(seen.planes, _CELL * cell)
        columns, rows = min(4, camera.width - x), min(4, camera.height - y)
        if columns > 0 and rows > 0:
            if _find_t(planes, ptr_at(seen.face, 16 * cell), camera, x, y):
                _correct_t(pixels, tree, camera, x, y, cell, planes)
            _write_cell(seen, cell, face, t, y * camera.width + x, camera.width, columns, rows)
