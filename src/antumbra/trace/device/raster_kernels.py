"""The kernels of a rasteriser on a device: it finds, per pixel, what the ray of the pixel meets first.

They bound triangles by the functions of the CPU's rasteriser (`query.raster_bins`, `query.raster_setup`), and test the
pixels within these bounds by the filter of the walk (`filters.filter_hits`), with the rays that `trace_nearest` would
trace. So what they leave undecided takes the same later stages.

1. `tag_seen` tags the triangles whose bounds hold a pixel centre; prefix sums place their indices (`keep_tagged`).
2. BOUND: each sure hit lowers the bound of its pixel, by an atomic minimum on the bits of the largest t it may have. A
   thread draws one small triangle (`draw_triangles`); others are listed in parts, whose cells of CELL x CELL pixels are
   drawn by one thread each, unless an edge surely excludes the cell (`draw_parts`).
3. CLAIM: among the hits that may lie before the bound, the first one to come claims the pixel. All others, and
   undecided tests, are listed, as rivals are in the walk: the order of threads does not matter.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import atomic_add, atomic_min, thread_index
from ...kernels.exact.filters import filter_hits, larger, smaller
from ...kernels.jit import inlined, kernel
from ...kernels.simd import extract, f32_at, f32_bits, get, i32_at, put, stack_f32
from ...kernels.toolchain.device_code import DeviceKernel
from ...query.raster_bins import Padding, careful_box
from ...query.raster_setup import RasterView, edge_functions
from .build_kernels import Source, face_of
from .device_kernels import RAYS, TREE, WORK, add_kernels, copy_corners
from .device_rays import listed_point
from .device_traversal import PAIRS, PARTS, TreeBuffers, filter_ray, filter_triangle, list_pair

BOUND, CLAIM = 0, 1
"""Steps."""

CELL = 8  # pixels along the side of a cell
CELLS = 64  # of a part, in a square
PART = 64  # pixels along the side of a part
SMALL = CELL * CELL  # pixels of the largest box that one thread draws
ENTRY = 5  # words of a part: its slot, and its first and last pixel, x0, y0, x1, y1
UNBOUNDED = 0x7F  # all bytes of a pixel's bound that no hit has lowered

_F = np.float32
_INF, _LARGEST = _F(np.inf), _F(3.3e38)  # less than the float32 of UNBOUNDED bytes
_SLACK = _F(1.0 + 2.0**-10)  # so that the nearest hit of a pixel is surely within its limit


class RasterCamera(NamedTuple):
    """A perspective camera, and some of its pixels, row by row."""

    view: RasterView
    padding: Padding
    first: int
    n: int


class DrawnTriangles(NamedTuple):
    """The triangles that a camera may see."""

    tree: TreeBuffers  # without nodes
    n: int


class RasterTargets(NamedTuple):
    """What drawing writes besides the buffers of `Work`: addresses on the device, and numbers."""

    bounds: int  # float32 per pixel: t of its nearest hit, at most; the bytes UNBOUNDED if none is known
    claims: int  # int32 per pixel: 0: no hit has claimed it
    parts: int  # int32, ENTRY per part
    capacity: int  # in parts
    across: int  # PART // CELL, not as a constant: LLVM's back end for SPIR-V makes invalid code of masks in loops
    step: int


# --- Bounds -----------------------------------------------------------------------------------------------------------


@kernel
def tag_seen(source, camera, tags):  # source: Source, camera: RasterCamera, tags: address of int32
    """Write 1 for each triangle whose bounds hold the centre of a pixel, 0 for the others, and 0 after the last one."""
    i, tag = thread_index(), np.int32(0)
    if i > source.n:
        return
    if i < source.n:
        x0, y0, x1, y1 = careful_box(camera.view, camera.padding, f32_at(source.vertices), face_of(source, i))
        tag = np.int32(x0 <= x1 and y0 <= y1)
    put(i32_at(tags), i, tag)


@inlined
def _box_of(drawn, camera, slot):
    """First and last pixel (x0, y0, x1, y1) of a triangle, in the rows of the camera's pixels."""
    corners, width = stack_f32(9), camera.view.width
    copy_corners(drawn.tree, slot, corners)
    x0, y0, x1, y1 = careful_box(camera.view, camera.padding, corners, 0)
    return x0, max(y0, camera.first // width), x1, min(y1, (camera.first + camera.n - 1) // width)


@inlined
def _surely_misses(drawn, camera, slot, x0, y0, x1, y1):
    """Whether all pixels of a cell surely lie outside of one edge of a triangle."""
    corners, right, down = stack_f32(9), _F(x1 - x0), _F(y1 - y0)
    copy_corners(drawn.tree, slot, corners)
    turn, f = edge_functions(camera.view, corners, 0, x0, y0, CELL, CELL)
    if turn == 0:
        return False
    zero = _F(0.0)
    most0 = f.c0 + larger(f.a0 * right, zero) + larger(f.b0 * down, zero)
    most1 = f.c1 + larger(f.a1 * right, zero) + larger(f.b1 * down, zero)
    most2 = f.c2 + larger(f.a2 * right, zero) + larger(f.b2 * down, zero)
    return smaller(smaller(most0, most1), most2) < _F(-1.0)


# --- Pixels -----------------------------------------------------------------------------------------------------------


@inlined
def _list(work, j, slot):
    """List an undecided test, unless the list is full; so its count never wraps, however many tests there are."""
    if atomic_add(i32_at(work.counts), PAIRS, 0) <= work.capacity:
        list_pair(work, j, slot)


@inlined
def _test_pixel(drawn, triangle, slot, j, rays, work, targets):
    """Test a triangle with the ray of pixel j."""
    bound = get(f32_at(targets.bounds), j)
    bound = bound if bound < _LARGEST else _INF
    o, d = listed_point(rays.origins, j), listed_point(rays.ends, j)
    tests = filter_hits(filter_ray(drawn.tree, o, d, _F(0.0), bound * _SLACK), triangle)
    if targets.step == BOUND:
        if tests.hits != 0 and extract(tests.far, 0) < bound:
            atomic_min(i32_at(targets.bounds), j, extract(f32_bits(tests.far), 0))
    elif tests.hits != 0:
        if extract(tests.near, 0) <= bound:
            if atomic_add(i32_at(targets.claims), j, 1) == 0:
                put(i32_at(work.out), j, slot)
            else:
                _list(work, j, slot)
    elif tests.unsure != 0:
        _list(work, j, slot)


@inlined
def _draw(drawn, slot, box, camera, rays, work, targets):
    """Test a triangle with the pixels of a box."""
    x0, y0, x1, y1 = box
    triangle, _ = filter_triangle(drawn.tree.triangles, slot)
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            j = y * camera.view.width + x - camera.first
            if j >= 0 and j < camera.n:
                _test_pixel(drawn, triangle, slot, j, rays, work, targets)


# --- Triangles and parts ----------------------------------------------------------------------------------------------


@inlined
def _list_parts(slot, box, work, targets):
    """List the parts of a triangle with a large box; its count, too, never wraps."""
    x0, y0, x1, y1 = box
    across, counts, out = (x1 - x0) // PART + 1, i32_at(work.counts), i32_at(targets.parts)
    n = across * ((y1 - y0) // PART + 1)
    if atomic_add(counts, PARTS, 0) > targets.capacity:
        return
    at = np.int64(atomic_add(counts, PARTS, n))
    for k in range(min(n, targets.capacity - at)):
        x, y = x0 + PART * (k % across), y0 + PART * (k // across)
        put(out, ENTRY * (at + k), slot)
        put(out, ENTRY * (at + k) + 1, x)
        put(out, ENTRY * (at + k) + 2, y)
        put(out, ENTRY * (at + k) + 3, min(x + PART - 1, x1))
        put(out, ENTRY * (at + k) + 4, min(y + PART - 1, y1))


@kernel
def draw_triangles(drawn, camera, rays, work, targets):
    """Draw the small ones among the triangles; list the parts of the others in the step BOUND."""
    # In: drawn: DrawnTriangles, camera: RasterCamera, rays: RayBuffers, work: Work, targets: RasterTargets
    slot = thread_index()
    if slot >= drawn.n:
        return
    box = _box_of(drawn, camera, slot)
    x0, y0, x1, y1 = box
    if x0 > x1 or y0 > y1:
        return
    if (x1 - x0 + 1) * (y1 - y0 + 1) <= SMALL:
        _draw(drawn, slot, box, camera, rays, work, targets)
    elif targets.step == BOUND:
        _list_parts(slot, box, work, targets)


@kernel
def draw_parts(drawn, camera, rays, work, targets, n):
    """Draw n parts, each thread one of their cells."""
    # In: drawn: DrawnTriangles, camera: RasterCamera, rays: RayBuffers, work: Work, targets: RasterTargets
    k, entries = thread_index(), i32_at(targets.parts)
    if k >= n * CELLS:
        return
    at, cell = ENTRY * (k // CELLS), k % CELLS
    slot = np.int64(get(entries, at))
    x0 = np.int64(get(entries, at + 1)) + CELL * (cell % targets.across)
    y0 = np.int64(get(entries, at + 2)) + CELL * (cell // targets.across)
    x1 = min(x0 + CELL - 1, np.int64(get(entries, at + 3)))
    y1 = min(y0 + CELL - 1, np.int64(get(entries, at + 4)))
    if x0 <= x1 and y0 <= y1 and not _surely_misses(drawn, camera, slot, x0, y0, x1, y1):
        _draw(drawn, slot, (x0, y0, x1, y1), camera, rays, work, targets)


# --- The list ---------------------------------------------------------------------------------------------------------


_VIEW = RasterView._make([0.0] * 12 + [0] * 3 + [0.0] * 8)
_CAMERA = RasterCamera(_VIEW, Padding._make([0.0] * 9 + [False]), 0, 0)
_DRAWN, _TARGETS = DrawnTriangles(TREE, 0), RasterTargets(0, 0, 0, 0, 0, 0)

RASTER_KERNELS = {
    "tag_seen": DeviceKernel(tag_seen, (Source(0, 0, 0), _CAMERA, 0)),
    "draw_triangles": DeviceKernel(draw_triangles, (_DRAWN, _CAMERA, RAYS, WORK, _TARGETS)),
    "draw_parts": DeviceKernel(draw_parts, (_DRAWN, _CAMERA, RAYS, WORK, _TARGETS, 0)),
}
"""Name -> kernel."""

add_kernels(RASTER_KERNELS)
