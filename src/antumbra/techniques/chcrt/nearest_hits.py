"""Nearest hits of one ray per pixel through lists of parts [Mattausch et al. 2015, Sec. 5.2].

Hits are also marked in the slots of parts, and numbered among the marked slots.

The 16 rays of a cell go down each part together, the nearer child first. Each ray goes only as far as its nearest hit
so far. At a block, each ray is tested against all triangles side by side. If float32 cannot decide a test, float64
does. The rounded t decides which hit is nearest, as everywhere (`trace.rays.ray_traversal.walk`). The lowest triangle
index wins ties.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import block_leaf, box_at, rows_at, slot_at
from ...kernels.exact.filters import is_nearer, meets, rounded_t
from ...kernels.exact.predicate import ray_along, segment
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import bits, get, load16, lowest_bit, ptr, ptr_at, put, reduce_max, stack_f32, stack_f64, stack_i32
from ...kernels.vec3 import broadcasts
from ...trace.descent import WAITING_FLOATS, WAITING_INTS, Near, Waiting, entry, next_block, slabs_of, visited
from ...trace.frusta.bundle import shafts_of
from ...trace.tree_list import Hits, item, list_of, root_in, tree_in, tree_list_pointers
from ...trace.triangle_tests import ray_meets
from .occlusion_queries import (
    BUNDLE_FLOATS,
    FAR,
    WORDS,
    PictureCells,
    RayBundle,
    bundle_in,
    first_receiver,
    receiver_in,
    slabs_in,
)
from .ray_bundles import PassRays, limit_of, load_rays, span_of

# --- Hits of pictures as marks in the slots of parts, and their numbers among the marked slots ------------------------


@kernel
def _mark(ticket, part, slot, first, marks):
    """Worker: mark the slots of hits, row by row of pixels."""
    for y in items(ticket):
        for x in range(part.shape[1]):
            k = part[y, x]
            if k >= 0 and first[k] >= 0:
                marks[first[k] + slot[y, x]] = 1


def mark_hits(hits: Hits, first: np.ndarray, marks: np.ndarray, threads: int) -> None:
    """Set ``marks[first[part] + slot]`` of each hit in a part with first[part] >= 0. `marks`: (n,) uint8."""
    run(_mark, threads, new_ticket(len(hits.part), 8), hits.part, hits.slot, first, marks)


@kernel
def _number(ticket, part, slot, first, numbers, out):
    """Worker: write the numbers of hits, row by row of pixels."""
    for y in items(ticket):
        for x in range(part.shape[1]):
            k = part[y, x]
            if k >= 0 and first[k] >= 0:
                out[y, x] = numbers[first[k] + slot[y, x]]


def number_hits(hits: Hits, first: np.ndarray, numbers: np.ndarray, out: np.ndarray, threads: int) -> None:
    """Write ``numbers[first[part] + slot]`` of each hit in a part with first[part] >= 0 to `out`, (h, w) int32."""
    run(_number, threads, new_ticket(len(hits.part), 8), hits.part, hits.slot, first, numbers, out)


# --- The nearest hits of one ray a pixel, through lists of parts [Mattausch et al. 2015, Sec. 5.2] --------------------
#
# The 16 rays of a cell go down each part together, the nearer child first. Each ray goes only as far as its nearest
# hit so far. At a block, each ray is tested against all triangles side by side. If float32 cannot decide a test,
# float64 does. The rounded t decides which hit is nearest, as everywhere (`trace.rays.ray_traversal.walk`). The lowest
# triangle index wins ties.


# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)


_F = np.float32


class CellHits(NamedTuple):
    """The nearest hits of the 16 rays of a cell: pointers to scratch memory."""

    bundle: RayBundle
    t: F64Ptr  # float64
    face: I32Ptr  # int32
    part: I32Ptr  # int32: -1 if there is no new hit
    slot: I32Ptr  # int32
    own: I32Ptr  # int32: the triangle that does not count, -1 for none
    span: F64Ptr  # float64: tmin of 16 rays, then tmax
    ways: F32Ptr  # float32: rows x, y, z of the directions, or of the targets of segments
    cull_faces: int  # a value of CULL_FACES
    any_hit: bool
    segments: bool


@inlined
def _load(picture, rays, y0, x0, found):
    """Load the rays of a cell and their hits. Return bits of its rays."""
    live = load_rays(rays, picture, y0, x0, found.bundle)
    for lane in range(16):
        if live >> lane & 1 != 0:
            y, x, _ = receiver_in(picture, y0, x0, lane)
            put(found.t, lane, rays.hits.t[y, x])
            put(found.face, lane, rays.hits.face[y, x])
            put(found.own, lane, rays.skip[y, x])
            put(found.part, lane, -1)
            if rays.each != 0:
                _put_span(found, lane, span_of(rays, y, x))
            ways = rays.targets if rays.segments else rays.directions
            for k in range(3):
                put(found.ways, 16 * k + lane, ways[y, x, k])
    return live


@inlined
def _put_span(found, lane, span):
    put(found.span, lane, span[0])
    put(found.span, 16 + lane, span[1])


@inlined
def _write(picture, hits, y0, x0, live, found):
    """Write the new hits of a cell. Return how far its rays look."""
    while live != 0:
        lane = lowest_bit(live)
        live &= live - 1
        if get(found.part, lane) >= 0:
            y, x, _ = receiver_in(picture, y0, x0, lane)
            hits.t[y, x], hits.face[y, x] = get(found.t, lane), get(found.face, lane)
            hits.part[y, x], hits.slot[y, x] = get(found.part, lane), get(found.slot, lane)
    return reduce_max(load16(found.bundle.limits, 0))


@kernel
def _meets(found, lane, corners, slot):
    """Whether a ray meets a triangle that counts, exactly."""
    c, e = found.bundle.rays, found.ways
    if found.segments:
        ray = segment(
            get(c, lane), get(c, 16 + lane), get(c, 32 + lane), get(e, lane), get(e, 16 + lane), get(e, 32 + lane)
        )
    else:
        ray = _ray(found, lane)
    side = meets(ray, corners, slot)
    return side != 0 and (found.cull_faces == 0 or side != found.cull_faces)


@inlined
def _ray(found, lane):
    c, d = found.bundle.rays, found.ways  # the bundle's own directions have underflowed where they are much shorter
    return ray_along(
        get(c, lane), get(c, 16 + lane), get(c, 32 + lane), get(d, lane), get(d, 16 + lane), get(d, 32 + lane),
        get(found.span, lane), get(found.span, 16 + lane),
    )  # fmt: skip


@kernel
def _keep(found, lane, tree, k, slot):
    """Keep a triangle that a ray meets, if it is the nearest so far. Of segments any one will do."""
    prim, t = get(tree.prim_ids, slot), np.float64(0.0)
    if not found.any_hit:
        t = rounded_t(_ray(found, lane), tree.corners, slot)
    if is_nearer(t, prim, get(found.t, lane), get(found.face, lane)):
        put(found.t, lane, t)
        put(found.face, lane, prim)
        put(found.part, lane, k)
        put(found.slot, lane, slot)
        put(found.bundle.limits, lane, _F(-1.0) if found.any_hit else limit_of(t, found.bundle, lane))


@kernel
def _trace_block(tree, k, link, mask, found):
    """Test the rays in `mask` against a block."""
    block, triangles = block_leaf(link)
    numbers, present = ptr_at(tree.blocks, rows_at(block)), (np.int64(1) << triangles) - 1
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        o, d = broadcasts(found.bundle.rays, lane, 16), broadcasts(found.bundle.rays, 48 + lane, 16)
        hit, unsure = ray_meets(o, d, numbers, found.cull_faces, get(found.bundle.limits, lane))
        hit, unsure = hit & present, unsure & present
        if get(found.span, lane) > 0.0 or get(found.span, 16 + lane) < np.inf:
            hit, unsure = np.int64(0), hit | unsure  # float32 decides nothing about the ends of a span
        while hit | unsure != 0:
            i = lowest_bit(hit | unsure)
            slot = np.int64(get(tree.slots, slot_at(block, i)))
            own = get(tree.prim_ids, slot) == get(found.own, lane)
            if not own and (hit >> i & 1 != 0 or _meets(found, lane, tree.corners, slot)):
                _keep(found, lane, tree, k, slot)
            hit, unsure = hit & ~(np.int64(1) << i), unsure & ~(np.int64(1) << i)


@kernel
def _walk(tree, k, link, mask, slabs, found, waiting):
    """Trace the rays in `mask` through a tree, from a link on."""
    # In: tree, k, link, mask, slabs. Out: found. Scratch: waiting.
    at = next_block(tree, slabs, Near(link, mask, np.int64(0)), waiting, load16(found.bundle.limits, 0), None)
    while at.mask != 0:
        _trace_block(tree, k, at.link, at.mask, found)
        at = next_block(tree, slabs, visited(at), waiting, load16(found.bundle.limits, 0), None)


@inlined
def _trace_cell(forest, begin, end, live, found, waiting):
    """Trace the rays of a cell through the parts of a list."""
    # In: forest, begin, end, live. Out: found. Scratch: waiting.
    slabs = slabs_in(found.bundle, live)
    for i in range(begin, end):
        k = item(forest, i)
        mask = entry(forest.heads, box_at(k, 0), slabs, load16(found.bundle.limits, 0))[0] & live
        if mask != 0:
            _walk(tree_in(forest, k), k, root_in(forest, k), mask, slabs, found, waiting)


@inlined
def _cells_that_meet(forest, begin, end, cells):
    """Bits of the cells of a region whose shafts enter a tree of a list, before their rays' hits so far."""
    far, met = load16(cells, FAR * 16), np.int64(0)
    live = bits(far >= _F(0.0))
    slabs = slabs_of(shafts_of(cells), live)
    for i in range(begin, end):
        met |= entry(forest.heads, box_at(item(forest, i), 0), slabs, far)[0] & live
        if met == live:
            break
    return met


@kernel
def _trace_region(forest, picture, rays, region, cells, found, waiting):
    """Trace the cells of a region, and update how far they look."""
    # In: forest, picture, region. In and out: rays, cells. Scratch: found, waiting.
    y0, x0 = first_receiver(picture, region, 0)
    begin, end = list_of(forest, y0, x0, np.int64(0))
    met = _cells_that_meet(forest, begin, end, cells) if begin < end else np.int64(0)
    while met != 0:
        g = lowest_bit(met)
        met &= met - 1
        y, x = first_receiver(picture, region, g)
        live = _load(picture, rays, y, x, found)
        _trace_cell(forest, begin, end, live, found, waiting)
        put(cells, FAR * 16 + g, _write(picture, rays.hits, y, x, live, found))


@kernel
def _trace(ticket, arrays, picture, rays, cells):
    """Worker: trace regions."""
    # In: arrays, picture. In and out: rays, cells.
    bundle = bundle_in(stack_f32(BUNDLE_FLOATS))
    found = CellHits(
        bundle, stack_f64(16), stack_i32(16), stack_i32(16), stack_i32(16), stack_i32(16), stack_f64(32), stack_f32(48),
        np.int64(rays.cull_faces), rays.any_hit, rays.segments,
    )  # fmt: skip
    for lane in range(16):
        _put_span(found, lane, (rays.spans[0, 0], rays.spans[0, 1]))
    waiting = Waiting(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    forest = tree_list_pointers(arrays)
    for region in items(ticket):
        _trace_region(forest, picture, rays, region, ptr_at(ptr(cells), region * WORDS), found, waiting)


def trace_nearest(forest, picture: PictureCells, rays: PassRays, cells, threads) -> None:
    """Trace the rays of a picture through the lists of its tiles, and update their hits and cells."""
    run(_trace, threads, new_ticket(len(cells), 8), forest, picture, rays, cells)
