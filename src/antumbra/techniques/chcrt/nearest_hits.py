"""Nearest hits of one ray per pixel through lists of parts [Mattausch et al. 2015, Sec. 5.2].

The 16 rays of a cell traverse each part together, nearer child first, and each ray is clipped at its nearest hit so
far. At a block, each ray is tested against all triangles in parallel lanes; where float32 cannot decide, float64 does.
Hits are compared as in `trace.rays.ray_traversal.walk`, by `kernels.exact.filters.precedes`.

Other functions mark the triangles of hits in the slots of their parts, and number the marked slots.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import block_leaf, box_at, rows_at, slot_at
from ...kernels.exact.filters import meets, precedes, signed_t
from ...kernels.exact.predicate import ray_along, segment
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import bits, get, load16, lowest_bit, ptr, ptr_at, put, reduce_max, stack_f32, stack_f64, stack_i32
from ...kernels.vec3 import broadcasts
from ...trace.descent import (
    WAITING_FLOATS,
    WAITING_INTS,
    NearestStack,
    NearestTraversal,
    after_visit,
    entry,
    next_block,
    slabs_of,
)
from ...trace.frusta.bundle import shafts_of
from ...trace.tree_list import Hits, TreeList, list_of, root_in, tree_in, tree_list_pointers, tree_number
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

# --- Marks in the slots of parts for the triangles of hits, and their numbers among the marked slots ------------------


@kernel
def _mark(ticket, part, slot, first, marks):
    """Worker: mark the slots of hits, row by row of pixels."""
    for y in items(ticket):
        for x in range(part.shape[1]):
            k = part[y, x]
            if k >= 0 and first[k] >= 0:
                marks[first[k] + slot[y, x]] = 1


def mark_hits(hits: Hits, first: NDArray[np.int64], marks: NDArray[np.uint8], threads: int) -> None:
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


def number_hits(
    hits: Hits, first: NDArray[np.int64], numbers: NDArray[np.int32], out: NDArray[np.int32], threads: int
) -> None:
    """Write ``numbers[first[part] + slot]`` of each hit in a part with first[part] >= 0 to `out`, (h, w) int32."""
    run(_number, threads, new_ticket(len(hits.part), 8), hits.part, hits.slot, first, numbers, out)


# --- Nearest hits of one ray per pixel through lists of parts [Mattausch et al. 2015, Sec. 5.2] -----------------------


# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

_F = np.float32


class CellHits(NamedTuple):
    """The nearest hits of the 16 rays of a cell: pointers to scratch memory."""

    bundle: RayBundle
    t: F64Ptr  # float64, signed
    face: I32Ptr  # int32
    part: I32Ptr  # int32; -1: no new hit
    slot: I32Ptr  # int32
    skip: I32Ptr  # int32: the triangle to skip, -1: none
    span: F64Ptr  # float64: tmin of 16 rays, then tmax
    directions: F32Ptr  # float32: rows x, y, z of the directions; of segments: of their ends
    cull_faces: int  # a value of CULL_FACES
    any_hit: bool
    segments: bool


@inlined
def _load(picture, rays, corner, cell):
    """Load the rays of a cell and their hits. Return bits of the active rays."""
    live = load_rays(rays, picture, corner, cell.bundle)
    for lane in range(16):
        if live >> lane & 1 != 0:
            y, x, _ = receiver_in(picture, corner, lane)
            put(cell.t, lane, rays.hits.signed_t[y, x] if rays.hits.face[y, x] >= 0 else np.inf)
            put(cell.face, lane, rays.hits.face[y, x])
            put(cell.skip, lane, rays.skip[y, x])
            put(cell.part, lane, -1)
            if rays.each != 0:
                _put_span(cell, lane, span_of(rays, y, x))
            vectors = rays.targets if rays.segments else rays.directions
            for k in range(3):
                put(cell.directions, 16 * k + lane, vectors[y, x, k])
    return live


@inlined
def _put_span(cell, lane, span):
    put(cell.span, lane, span[0])
    put(cell.span, 16 + lane, span[1])


@inlined
def _write(picture, hits, corner, live, cell):
    """Write the new hits of a cell. Return the largest limit of its rays."""
    while live != 0:
        lane = lowest_bit(live)
        live &= live - 1
        if get(cell.part, lane) >= 0:
            y, x, _ = receiver_in(picture, corner, lane)
            t = get(cell.t, lane)
            hits.t[y, x], hits.signed_t[y, x], hits.face[y, x] = abs(t), t, get(cell.face, lane)
            hits.part[y, x], hits.slot[y, x] = get(cell.part, lane), get(cell.slot, lane)
    return reduce_max(load16(cell.bundle.limits, 0))


@kernel
def _is_hit(cell, lane, corners, slot):
    """Exact test: whether a ray hits a triangle, with face culling."""
    c, e = cell.bundle.rays, cell.directions
    if cell.segments:
        ray = segment(
            get(c, lane), get(c, 16 + lane), get(c, 32 + lane), get(e, lane), get(e, 16 + lane), get(e, 32 + lane)
        )
    else:
        ray = _ray(cell, lane)
    side = meets(ray, corners, slot)
    return side != 0 and (cell.cull_faces == 0 or side != cell.cull_faces)


@inlined
def _ray(cell, lane):
    c, d = cell.bundle.rays, cell.directions  # very short directions have underflowed in the bundle
    return ray_along(
        get(c, lane), get(c, 16 + lane), get(c, 32 + lane), get(d, lane), get(d, 16 + lane), get(d, 32 + lane),
        get(cell.span, lane), get(cell.span, 16 + lane),
    )  # fmt: skip


@kernel
def _keep_if_nearest(cell, lane, tree, k, slot):
    """Record a hit if it is the nearest so far; any hit of an any-hit ray will do."""
    prim, t = get(tree.prim_ids, slot), np.float64(0.0)
    if not cell.any_hit:
        t = signed_t(_ray(cell, lane), tree.corners, slot)
    if precedes(t, prim, get(cell.t, lane), get(cell.face, lane)):
        put(cell.t, lane, t)
        put(cell.face, lane, prim)
        put(cell.part, lane, k)
        put(cell.slot, lane, slot)
        put(cell.bundle.limits, lane, _F(-1.0) if cell.any_hit else limit_of(abs(t), cell.bundle, lane))


@kernel
def _trace_block(tree, k, link, mask, cell):
    """Test the rays in `mask` against a block."""
    block, triangles = block_leaf(link)
    numbers, present = ptr_at(tree.blocks, rows_at(block)), (1 << triangles) - 1
    while mask != 0:
        lane = lowest_bit(mask)
        mask &= mask - 1
        o, d = broadcasts(cell.bundle.rays, lane, 16), broadcasts(cell.bundle.rays, 48 + lane, 16)
        hit, unsure = ray_meets(o, d, numbers, cell.cull_faces, get(cell.bundle.limits, lane))
        hit, unsure = hit & present, unsure & present
        if get(cell.span, lane) > 0.0 or get(cell.span, 16 + lane) < np.inf:
            hit, unsure = 0, hit | unsure  # float32 cannot decide whether a hit lies within a span
        while hit | unsure != 0:
            i = lowest_bit(hit | unsure)
            slot = get(tree.slots, slot_at(block, i))
            is_skipped = get(tree.prim_ids, slot) == get(cell.skip, lane)
            if not is_skipped and (hit >> i & 1 != 0 or _is_hit(cell, lane, tree.corners, slot)):
                _keep_if_nearest(cell, lane, tree, k, slot)
            hit, unsure = hit & ~(1 << i), unsure & ~(1 << i)


@kernel
def _walk(tree, k, link, mask, slabs, cell, waiting):
    """Trace the rays in `mask` through the subtree at a link."""
    # In: tree, k, link, mask, slabs. Out: cell. Scratch: waiting.
    at = next_block(tree, slabs, NearestTraversal(link, mask, 0), waiting, load16(cell.bundle.limits, 0), None)
    while at.mask != 0:
        _trace_block(tree, k, at.link, at.mask, cell)
        at = next_block(tree, slabs, after_visit(at), waiting, load16(cell.bundle.limits, 0), None)


@inlined
def _trace_cell(forest, begin, end, live, cell, waiting):
    """Trace the rays of a cell through the parts of a list."""
    # In: forest, begin, end, live. Out: cell. Scratch: waiting.
    slabs = slabs_in(cell.bundle, live)
    for i in range(begin, end):
        k = tree_number(forest, i)
        mask = entry(forest.heads, box_at(k, 0), slabs, load16(cell.bundle.limits, 0))[0] & live
        if mask != 0:
            _walk(tree_in(forest, k), k, root_in(forest, k), mask, slabs, cell, waiting)


@inlined
def _cells_entering(forest, begin, end, cells):
    """Bits of the cells of a region whose shafts enter a part of a list before their rays' hits so far."""
    far, met = load16(cells, FAR * 16), 0
    live = bits(far >= _F(0.0))
    slabs = slabs_of(shafts_of(cells), live)
    for i in range(begin, end):
        met |= entry(forest.heads, box_at(tree_number(forest, i), 0), slabs, far)[0] & live
        if met == live:
            break
    return met


@kernel
def _trace_region(forest, picture, rays, region, cells, cell, waiting):
    """Trace the cells of a region, and update their limits."""
    # In: forest, picture, region. In and out: rays, cells. Scratch: cell, waiting.
    y0, x0 = first_receiver(picture, region, 0)
    begin, end = list_of(forest, y0, x0, 0)
    met = _cells_entering(forest, begin, end, cells) if begin < end else 0
    while met != 0:
        g = lowest_bit(met)
        met &= met - 1
        corner = first_receiver(picture, region, g)
        live = _load(picture, rays, corner, cell)
        _trace_cell(forest, begin, end, live, cell, waiting)
        put(cells, FAR * 16 + g, _write(picture, rays.hits, corner, live, cell))


@kernel
def _trace(ticket, arrays, picture, rays, cells):
    """Worker: trace regions."""
    # In: arrays, picture. In and out: rays, cells.
    bundle = bundle_in(stack_f32(BUNDLE_FLOATS))
    cell = CellHits(
        bundle, stack_f64(16), stack_i32(16), stack_i32(16), stack_i32(16), stack_i32(16), stack_f64(32), stack_f32(48),
        np.int64(rays.cull_faces), rays.any_hit, rays.segments,
    )  # fmt: skip
    for lane in range(16):
        _put_span(cell, lane, (rays.spans[0, 0], rays.spans[0, 1]))
    waiting = NearestStack(stack_i32(WAITING_INTS), stack_f32(WAITING_FLOATS))
    forest = tree_list_pointers(arrays)
    for region in items(ticket):
        _trace_region(forest, picture, rays, region, ptr_at(ptr(cells), region * WORDS), cell, waiting)


def trace_nearest(
    forest: TreeList, picture: PictureCells, rays: PassRays, cells: NDArray[np.float32], threads: int
) -> None:
    """Trace the rays of an image through the lists of its tiles, and update their hits and cells."""
    run(_trace, threads, new_ticket(len(cells), 8), forest, picture, rays, cells)
