"""The kernel for nearest hits in tree lists: each ray of a screen tile is traced through the trees that its tile lists.

One thread takes a ray through the trees of a list, from its nearest hit of earlier launches on. A test that float32
does not exclude is decided in float64 at once, and hits are ordered by their exact t. A test that float64 leaves
undecided becomes a record (`device_kernels`) with the triangle's index and corners; the ray goes on without it. A ray
that finds the list of records full stops, and is traced again later; so the list's count never wraps.
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import atomic_add, thread_index
from ...kernels.exact.filters import BEYOND, END_FLOOR, MISS, UNKNOWN, UNSURE, precedes, smaller
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel, overload
from ...kernels.simd import f32_at, f64_at, get, i32_at, put, stack_f32, stack_f64, stack_i32
from ...kernels.toolchain.device_code import DeviceKernel
from .device_kernels import RAYS, RECORD, WORK, add_kernels, copy_corners, exact_t, picture_t, put_record, side_of_hit
from .device_rays import AGAIN, TRACED, RayBuffers, pixel_in_tile, place_in_tiles, ray_at
from .device_traversal import GO_ON, REST, WON, TreeBuffers, Work, visit, walk_candidates
from .tree_list_kernels import CORNERS, TreeListBuffers, tree_at

HIT_WORDS = 8
"""int32 of a new hit: its exact t in float64, negative at a back, and its t by `filters.hit_t`, with which pictures are
made; ray, face, place of its tree in the lists, slot."""

STATE_WORDS = 4
"""int32 of a ray's nearest hit so far: its t in float64, as in a new hit; face plus one, or 0 for none; unused."""


class ListedRays(NamedTuple):
    """Rays of some rows of pixels, one each, in screen tiles as in `TileSegments`, and their nearest hits so far."""

    rays: RayBuffers
    hits: int  # int32, STATE_WORDS per ray
    tiles: int  # int32: numbers of the tiles, row by row of the screen
    pixels: int  # side of a tile
    rows: int  # rows of pixels in a tile: `pixels`, or as many as the picture has
    across: int  # tiles per row of the screen
    width: int  # pixels per row of the picture
    first: int  # the rows of pixels that have rays
    end: int
    count: int = 1  # type: ignore[assignment]  # rays per pixel; hides tuple.count


@inlined
def _ray_of(tiled, k):
    """The ray at place k of the tiles; -1: there is none."""
    place = place_in_tiles(tiled, k)
    y, x = pixel_in_tile(tiled, np.int64(get(i32_at(tiled.tiles), place.at)), place)
    inside = y >= tiled.first and y < tiled.end and x < tiled.width
    return (y - tiled.first) * tiled.width + x if inside else np.int64(-1)


_FACE, _ITEM, _SLOT = range(3)  # of `_NearestListed.best`


class _NearestListed(NamedTuple):
    """Finds the nearest hit in a listed tree, and lists undecided tests."""

    tree: TreeBuffers
    work: Work
    ray: int
    item: int  # place of the tree in the lists
    tests: int  # corners of the triangles of records: address of float32
    limit: F32Ptr  # at or behind the t of the best hit
    corners: F32Ptr  # 9 float32
    t: F64Ptr  # of the best hit so far: exact, negative at a back, inf if there is none; and by `hit_t`
    best: I32Ptr  # its face; place of its tree, or -1 if it is of an earlier launch; slot


@inlined
def _leave(visitor, ray, slot, prim):
    """Leave a test to the CPU, as a record; AGAIN if there is no room."""
    work = visitor.work
    at = np.int64(atomic_add(i32_at(work.counts), REST, 1))
    if at >= work.rest_capacity:
        return np.int64(AGAIN)
    put_record(work, at, visitor.ray, slot, visitor.item, ray)
    put(i32_at(work.rest), 2 * RECORD * at + 3, prim)
    for k in range(CORNERS):
        put(f32_at(visitor.tests), CORNERS * at + k, get(visitor.corners, k))
    return np.int64(GO_ON)


@inlined
def _visit_listed(visitor, r, slot, prim):
    copy_corners(visitor.tree, slot, visitor.corners)
    side = side_of_hit(r.ray, visitor.corners, visitor.work.cull_faces)
    if side == MISS:
        return GO_ON
    t = UNKNOWN if side == UNSURE else exact_t(r.ray, visitor.corners)
    if t == UNKNOWN:
        return _leave(visitor, r.ray, slot, prim)
    signed = t if side < 0 else -t
    if precedes(signed, prim, get(visitor.t, 0), np.int64(get(visitor.best, _FACE))):
        put(visitor.t, 0, signed)
        put(visitor.t, 1, picture_t(r.ray, visitor.corners, t))
        put(visitor.best, _FACE, prim)
        put(visitor.best, _ITEM, visitor.item)
        put(visitor.best, _SLOT, slot)
        put(visitor.limit, 0, smaller(get(visitor.limit, 0), np.float32(t * BEYOND) + END_FLOOR))
    return GO_ON


@overload(visit)
def _visit(visitor, r, slot, prim):
    if visitor.instance_class is _NearestListed:
        return lambda visitor, r, slot, prim: _visit_listed(visitor, r, slot, prim)
    return None


@inlined
def _keep(tiled, work, i, t, best):
    """Keep the new hit of ray i, and add it to the list at `Work.out`."""
    put(f64_at(tiled.hits), STATE_WORDS // 2 * i, get(t, 0))
    put(i32_at(tiled.hits), STATE_WORDS * i + 2, get(best, _FACE) + 1)
    at = np.int64(atomic_add(i32_at(work.counts), WON, 1))
    put(f64_at(work.out), HIT_WORDS // 2 * at, get(t, 0))
    put(f64_at(work.out), HIT_WORDS // 2 * at + 1, get(t, 1))
    put(i32_at(work.out), HIT_WORDS * at + 4, i)
    for k in range(3):
        put(i32_at(work.out), HIT_WORDS * at + 5 + k, get(best, k))


@kernel
def find_listed(lists, tiled, work):  # lists: TreeListBuffers, tiled: ListedRays, work: Work
    """Trace rays through the trees of their lists: keep and list their new nearest hits; records for undecided tests.

    It may be repeated: the hits of the first time are not new in the second.
    """
    k, f = thread_index(), np.float32
    limit, corners, t, best = stack_f32(1), stack_f32(9), stack_f64(2), stack_i32(3)
    if k >= work.n:
        return
    i = _ray_of(tiled, work.first + k)
    if i < 0:
        return
    r = ray_at(tiled.rays, i)
    if r.state != TRACED:
        return
    face = np.int64(get(i32_at(tiled.hits), STATE_WORDS * i + 2)) - 1
    known = get(f64_at(tiled.hits), STATE_WORDS // 2 * i) if face >= 0 else np.float64(np.inf)
    put(t, 0, known)
    put(best, _FACE, face)
    put(best, _ITEM, -1)
    put(best, _SLOT, -1)
    put(limit, 0, smaller(f(r.ray.tmax), f(abs(known) * BEYOND) + END_FLOOR))
    tile = np.int64(get(i32_at(tiled.tiles), (work.first + k) // (tiled.pixels * tiled.rows)))
    for item in range(get(i32_at(lists.starts), tile), get(i32_at(lists.starts), tile + 1)):
        tree = tree_at(lists, np.int64(item))
        visitor = _NearestListed(tree, work, i, np.int64(item), lists.corners, limit, corners, t, best)
        if walk_candidates(tree, r, visitor) != GO_ON:
            break
    if get(best, _ITEM) >= 0:
        _keep(tiled, work, i, t, best)


_TILED = ListedRays(RAYS, 0, 0, 0, 0, 0, 0, 0, 0)
_LISTS = TreeListBuffers(0, 0, 0, 0, 0, 0)

NEAREST_LIST_KERNELS = {"find_listed": DeviceKernel(find_listed, (_LISTS, _TILED, WORK))}
add_kernels(NEAREST_LIST_KERNELS)
