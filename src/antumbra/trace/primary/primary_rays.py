"""Primary rays by multi-frusta tracing: the nearest hits of camera rays, bit-identical to the rasteriser's.

Frusta. A frustum contains the rays o + t d of its pixels, with d_low <= d <= d_high along each axis. So a frustum is an
endless shaft (`trace.descent`) [Benthin and Wald 2009, Sec. 4.1].

Tiles. A tile of 32 x 16 pixels is 16 frusta of 8 x 4 pixels [Benthin and Wald 2009, Sec. 4], which traverse a
`BlockTree` together, front to back. Each frustum ends at the farthest hit of its pixels. Blocks are culled and tested
by halves of frusta, *cells* of 4 x 4 pixels, with one pixel per lane. For each pixel, the tile stores the nearest
triangle and an interval of its depth key 1 / t. A test that float32 cannot decide is deferred, and settled by the
contract's own predicates after the block. The float64 t of a visible triangle is computed once, after the tree
(`pixel_hits.resolve`).

Tree lists (`trace.tree_list`). Each tile traverses the trees of its list one after the other. In a later call it may
traverse another list, starting from its hits so far.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.block_tree import BlockTree, block_tree
from ...bvh.nodes import Bvh, box_at, boxes_of
from ...kernels.elementary import power_of_two_above
from ...kernels.exact.filters import signed_t
from ...kernels.jit import F32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import f32_at, get, load16, ptr, put, splat16, stack_f32, stack_f64, stack_i32, stack_i64
from ...kernels.vec3 import rows
from ...query.gbuffer import pixel_ray
from ...query.raster_setup import RasterView, direction_error, make_view
from ...scene.camera import CameraRays
from ..counters import N_COUNTERS, add_counters, cleared, new_counters
from ..descent import (
    WAITING_FLOATS,
    WAITING_INTS,
    NearestStack,
    NearestTraversal,
    Shafts,
    Slabs,
    after_visit,
    endless_slabs_of,
    entry,
    next_block,
)
from ..tree_list import CORNERS, Hits, TreeList, list_of, root_in, single_tree, tree_in, tree_list_pointers, tree_number
from .pixel_hits import (
    KNOWN_FLOATS,
    KNOWN_PLANES,
    MARK_WORDS,
    PLANE_FLOATS,
    ResolveScratch,
    keep,
    resolve,
    resume,
    settle,
    shorten,
    start,
)
from .pixel_tests import CELLS, DEFERRED, HEIGHT, PIXELS, WIDTH, WORK, Pixels, TileFrame, frame_of, trace_block

# --- Frusta of a tile -------------------------------------------------------------------------------------------------


_LOW, _HIGH = 0, 48  # rows of 16: d_low (x, y, z), d_high
FLOATS = 96


@kernel
def bound_directions(rays, error, x0, y0, directions):
    """Write d_low and d_high of the frusta of the tile at pixel (x0, y0), including frusta beyond the picture.

    error : (3,) float64, error bound of `pixel_direction`
    """
    for axis in range(3):
        dx, dy = rays.dx[axis], rays.dy[axis]
        half = 3.5 * abs(dx) + 1.5 * abs(dy) + 2.0 * error[axis]
        for f in range(16):
            middle = rays.corner[axis] + (x0 + 8 * (f & 3) + 4.0) * dx + (y0 + 4 * (f >> 2) + 2.0) * dy
            put(directions, _LOW + 16 * axis + f, middle - half)
            put(directions, _HIGH + 16 * axis + f, middle + half)


@inlined
def slabs_from(eye, directions):
    """`Slabs` of the 16 frusta."""
    x, y, z = splat16(np.float32(eye.x)), splat16(np.float32(eye.y)), splat16(np.float32(eye.z))
    low, high = rows(directions, _LOW, 16), rows(directions, _HIGH, 16)
    shafts = Shafts(x, y, z, x, y, z, low.x, low.y, low.z, high.x, high.y, high.z)
    return endless_slabs_of(shafts, np.int64(0xFFFF))


# --- Tracing tiles ----------------------------------------------------------------------------------------------------


_F = np.float32
_SUPER = 4  # tiles per side of a square that is traced in Morton order


class PrimaryPicture(NamedTuple):
    """A camera's picture: its rays and their hits so far."""

    rays: CameraRays
    hits: Hits
    camera: RasterView
    error: np.ndarray  # (3,) float64: error bound of directions
    scale: float  # see `_scale`


class _Tile(NamedTuple):
    """A tile of frusta."""

    x0: int  # first pixel
    y0: int
    frame: TileFrame
    alive: int  # bits of the frusta that have pixels
    slabs: Slabs


class _PrimaryScratch(NamedTuple):
    """Pointers to a thread's memory."""

    pixels: Pixels
    resolution: ResolveScratch
    directions: F32Ptr  # float32, FLOATS: see `bound_directions`
    work: F32Ptr  # float32, WORK: for a block
    waiting: NearestStack


@kernel
def _walk(tree_list, k, alive, picture, tile, scratch, counters):
    """Trace the frusta in `alive` (bits) through tree k. Blocks are prefetched, and tested once the next is reached."""
    tree, hits, pixels, scale = tree_in(tree_list, k), picture.hits, scratch.pixels, picture.scale
    at, last = (
        NearestTraversal(root_in(tree_list, k), alive, 0),
        NearestTraversal(0, 0, 0),
    )
    while True:
        at = next_block(tree, tile.slabs, at, scratch.waiting, load16(pixels.far, 0), counters)
        if last.mask != 0:
            changed = trace_block(tile.frame, tree, last.link, last.mask, pixels, scratch.work, counters)
            if get(pixels.deferred, 0) != 0:
                settle(pixels, tree_list, k, picture.rays, tile.x0, tile.y0, scale, hits)
                changed = True
            if changed:
                shorten(pixels, _F(scale))
        if at.mask == 0:
            return
        last, at = at, after_visit(at)


@inlined
def _place(k, across):
    """First pixel (x0, y0) of tile k: squares of _SUPER x _SUPER tiles, each in Morton order."""
    square, k = k // (_SUPER * _SUPER), k % (_SUPER * _SUPER)
    x, y = square % across * _SUPER, square // across * _SUPER
    return WIDTH * (x + (k & 1) + (k >> 1 & 2)), HEIGHT * (y + (k >> 1 & 1) + (k >> 2 & 2))


@inlined
def _start(picture, x0, y0, fresh, scratch):
    """Start the tile at pixel (x0, y0): without hits if `fresh`, otherwise from its hits so far."""
    rays, hits = picture.rays, picture.hits
    if fresh:
        alive = start(scratch.pixels, x0, y0, rays)
    else:
        alive = resume(scratch.pixels, x0, y0, rays, ptr(hits.face), ptr(hits.t), picture.scale)
    bound_directions(rays, picture.error, x0, y0, scratch.directions)
    frame = frame_of(picture.camera, x0, y0, picture.scale)
    return _Tile(x0, y0, frame, alive, slabs_from(frame.eye, scratch.directions))


@kernel
def _trace_tile(tree_list, begin, end, picture, tile, scratch, counters):
    """Trace the frusta of a tile through the trees begin .. end of the lists."""
    pixels, new = scratch.pixels, tree_list.fresh
    for i in range(begin, end):
        k = tree_number(tree_list, i)
        met = entry(tree_list.heads, box_at(k, 0), tile.slabs, load16(pixels.far, 0))[0] & tile.alive
        if met != 0:
            _walk(tree_list, k, met, picture, tile, scratch, counters)
            new |= keep(pixels, k)
    if new:
        resolve(pixels, tree_list, picture.rays, tile.x0, tile.y0, scratch.resolution, picture.hits)


@kernel
def _trace_tiles(ticket, arrays, picture, across, counters):
    """Worker: trace whole tiles."""
    pixels = Pixels(
        stack_f32(PIXELS),
        stack_f32(PIXELS),
        stack_i32(PIXELS),
        stack_f32(CELLS),
        stack_f32(16),
        stack_i32(PIXELS),
        stack_i32(PIXELS),
        stack_i32(DEFERRED),
    )
    resolution = ResolveScratch(
        stack_f64(PLANE_FLOATS),
        stack_i32(PIXELS),
        stack_f64(KNOWN_FLOATS),
        stack_i32(KNOWN_PLANES),
        stack_i32(MARK_WORDS),
    )
    waiting = NearestStack(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    scratch = _PrimaryScratch(pixels, resolution, stack_f32(FLOATS), stack_f32(WORK), waiting)
    tree_list, mine = tree_list_pointers(arrays), cleared(stack_i64(N_COUNTERS))
    for k in items(ticket):
        x0, y0 = _place(k, across)
        if x0 < picture.rays.width and y0 < picture.rays.height:
            begin, end = list_of(tree_list, y0, x0, 0)
            if begin < end:
                tile = _start(picture, x0, y0, tree_list.fresh, scratch)
                _trace_tile(tree_list, begin, end, picture, tile, scratch, mine)
    add_counters(counters, mine)


def _scale(box: NDArray[np.float32], view: RasterView) -> float:
    """A power of two that scales pixel coordinates to about 1; 0 if float32 cannot represent the result."""
    eye = np.array([view.eye_x, view.eye_y, view.eye_z])
    reach = np.abs(box.astype(np.float64) - eye).max() * max(view.norm_x, view.norm_y, view.norm_z)
    if not 1e-30 < reach < 1e30:
        return 0.0
    return 1.0 / power_of_two_above(float(reach))


def trace_primary(
    tree: BlockTree | Bvh, rays: CameraRays, threads: int | None = None, counters: NDArray[np.int64] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nearest hits of the pixel-centre rays.

    Parameters
    ----------
    tree : BlockTree, or Bvh
        A Bvh is first converted to a `BlockTree`.
    rays : CameraRays
    threads : int, optional
        None: all cores. Does not affect the result.
    counters : (N_COUNTERS,) int64, optional
        From `new_counters`; nodes, box tests and triangles are added.

    Returns
    -------
    face : (H, W) int32
        -1 on a miss. Among triangles at the same real t, rounded to float64, one whose front faces the eye wins, then
        the lowest index.
    t : (H, W) float64
        In lengths of the pixel's direction; inf on a miss.

    Raises
    ------
    InputError
        If the directions of neighbouring pixels are too close, as in `rasterise`.
    """
    if not isinstance(tree, BlockTree):
        tree = block_tree(tree, threads)
    shape, empty = (rays.height, rays.width), np.empty((0, 0), np.int32)
    hits = Hits(np.empty(shape, np.int32), np.empty(shape), empty, empty, np.empty((0, 0)))
    trace_hits(
        single_tree(tree), primary_picture(rays, boxes_of(tree.nodes[:1])[0], hits), thread_count(threads), counters
    )
    return hits.face, hits.t


def primary_picture(rays: CameraRays, box: NDArray[np.float32], hits: Hits) -> PrimaryPicture:
    """A camera's picture, prepared for tracing.

    Parameters
    ----------
    rays : CameraRays
    box : (2, 3) float32
        Bounds of all triangles.
    hits : Hits
        The hits so far, updated in place by tracing.
    """
    view = make_view(rays)
    return PrimaryPicture(rays, hits, view, direction_error(rays), _scale(box, view))


def trace_hits(
    tree_list: TreeList, picture: PrimaryPicture, threads: int, counters: NDArray[np.int64] | None = None
) -> None:
    """Trace pixel-centre rays through a tree list. Unless it is fresh, start from the rays' hits so far.

    Parameters
    ----------
    tree_list : TreeList
        Its tiles are at least 32 pixels wide and 16 high. If it is fresh, only tiles with trees write their hits.
    picture : PrimaryPicture
        Its hits are updated in place.
    counters : (N_COUNTERS,) int64, optional
        From `new_counters`.
    """
    width, height = picture.rays.width, picture.rays.height
    across, down = -(-width // (WIDTH * _SUPER)), -(-height // (HEIGHT * _SUPER))
    ticket = new_ticket(across * down * _SUPER * _SUPER, 1)
    run(_trace_tiles, threads, ticket, tree_list, picture, across, new_counters() if counters is None else counters)


@kernel
def _sign(ticket, trees, picture, first):
    """Worker: write the signed t of hits, row by row of pixels."""
    hits = picture.hits
    for y in items(ticket):
        for x in range(picture.rays.width):
            k = hits.part[y, x]
            if k >= 0 and first[k] >= 0:
                ray, corners = pixel_ray(picture.rays, x, y), f32_at(trees[k, CORNERS])
                hits.signed_t[y, x] = signed_t(ray, corners, np.int64(hits.slot[y, x]))


def sign_hits(trees: NDArray[np.int64], picture: PrimaryPicture, first: NDArray[np.int64], threads: int) -> None:
    """Write the signed t of each hit in a tree with first[k] >= 0, which is about to leave memory.

    trees : the table of a `TreeList`
    """
    run(_sign, threads, new_ticket(picture.rays.height, 8), trees, picture, first)
