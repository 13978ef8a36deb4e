"""Rays one at a time: the tracer `single`, and exact step counts.

Tracer. `single` is the baseline, with which every other tracer must agree bit for bit. Variants such as `single:random`
differ only in the child order (`ray_traversal`). Scenes of instances are traced by the same loop.

Steps [Feltman et al. 2012, Sec. 4.1]. A step is a test of a ray against the box of a child that the traversal reaches.
The root's box is not tested. There are three classes of steps:

- path to the hit: for a blocked ray, the steps from the root to the leaf of its blocker
- false hits (faux hits): for a blocked ray, all other steps
- unoccluded: the steps of unoccluded rays

Rays are traced one by one, and the last blocker is not tested first.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.nodes import (
    LINK,
    Bvh,
    Tree,
    bvh_leaf,
    parents_first,
    tree_of,
)
from ...kernels.exact.predicate import segment
from ...kernels.jit import F32Ptr, I32Ptr, inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import (
    atomic_add,
    get,
    ptr,
    stack_array,
    stack_i64,
)
from ...kernels.vec3 import get3
from ...query.receivers import NOTHING
from ...query.shadow_query import (
    ShadowQuery,
    has_bit,
    horizon_of,
    is_above,
    patch_of,
    query_pointers,
    sample_of,
    set_bit,
)
from ..counters import (
    BELOW_HORIZON,
    BOX_TESTS,
    N_COUNTERS,
    RAYS,
    REPEAT_HITS,
    TRIANGLE_TESTS,
    add_counters,
    cleared_if,
    count,
)
from ..tracer import Bits, Counters, Form, Tracer
from ..tracer_cost import Cost, FittedRate
from .ray_traversal import BUILT, Ordered, triangle_hit, walk

# --- The tracer `single` ----------------------------------------------------------------------------------------------


TILE = 16  # side of a tile in pixels; a tile is traced by one thread


def as_built(bvh: Bvh, threads: int | None = None) -> Ordered:
    """A `Bvh` with the child order of its builder."""
    return Ordered(bvh, BUILT)


class OrderedTree(NamedTuple):
    """Pointers to the arrays of an `Ordered`'s BVH, and its child order."""

    tree: Tree
    prim_ids: I32Ptr  # int32 *
    corners: F32Ptr  # float32 *, 9 per triangle
    order: int


def pointers(prepared):
    """In kernels: the `OrderedTree` of an `Ordered`; other modules add theirs."""


@inlined
def _ordered_tree(prepared):
    tree = tree_of(prepared.bvh)
    return OrderedTree(tree, tree.prim_ids, tree.corners, np.int64(prepared.order))


@overload(pointers)
def _pointers(prepared):
    if prepared.instance_class is Ordered:
        return lambda prepared: _ordered_tree(prepared)
    return None


def blocker(tree, ray, skip, cull_faces, last, counters):
    """In kernels: a triangle that blocks the ray, as a number, or -1; `last`, that of the previous ray, comes first."""


@overload(blocker)
def _blocker(tree, ray, skip, cull_faces, last, counters):
    if tree.instance_class is OrderedTree:
        return lambda tree, ray, skip, cull_faces, last, counters: _blocked(tree, ray, skip, cull_faces, last, counters)
    return None


@inlined
def _blocked(tree, ray, skip, cull_faces, last, counters):
    """Slot of a triangle that blocks the ray, or -1; `last`, which blocked the previous ray, is tested first."""
    if last >= 0 and get(tree.prim_ids, last) != skip:
        o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
        d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
        if triangle_hit(tree.corners, last, ray, o, d, cull_faces, counters):
            count(counters, REPEAT_HITS, 1)
            return last
    return walk(tree.tree, ray, skip, cull_faces, tree.order, None, counters)[0]


@inlined
def _shadow_pixel(tree, query, i, bits, last, counters):
    """Trace the samples of receiver i whose bits are not set yet. Return the last blocker."""
    o, skip = get3(query.origins, 3 * i, 1), get(query.ids, i)
    patch, horizon = patch_of(query, i), horizon_of(query, i)
    count(counters, RAYS, query.spp)
    for s in range(query.spp):
        if has_bit(query, bits, i, s):
            continue
        lx, ly, lz = sample_of(query, patch, i, s)
        if not is_above(horizon, lx, ly, lz, query.corners):
            count(counters, BELOW_HORIZON, 1)
        else:
            ray = segment(o.x, o.y, o.z, lx, ly, lz)
            if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:  # an empty segment is not blocked
                continue
            slot = blocker(tree, ray, skip, query.facing, last, counters)
            if slot < 0:
                continue
            last = slot
        set_bit(query, bits, i, s)
    return last


@kernel
def _shadow_tiles(ticket, prepared, query, bits, counters):
    chunk, out = query_pointers(query), ptr(bits)
    h, w = chunk.h, chunk.w
    columns = (w + TILE - 1) // TILE
    mine, tree = cleared_if(counters, stack_i64(N_COUNTERS)), pointers(prepared)
    for tile in items(ticket):
        y0, x0 = tile // columns * TILE, tile % columns * TILE
        last = -1  # reset for each tile, so that counts do not depend on threads
        for y in range(y0, min(y0 + TILE, h)):
            for x in range(x0, min(x0 + TILE, w)):
                if get(chunk.sides, y * w + x) != NOTHING:
                    last = _shadow_pixel(tree, chunk, y * w + x, out, last, mine)
    add_counters(counters, mine)


def trace_shadow(
    prepared: Any,
    query: ShadowQuery,
    bits: NDArray[np.uint64],
    threads: int | None = None,
    counters: NDArray[np.int64] | None = None,
    progress: ProgressCallback | None = None,
) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    prepared : an `Ordered`, or what other modules add to `pointers`
    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    h, w = query.sides.shape
    tiles = -(-h // TILE) * -(-w // TILE)
    run(
        _shadow_tiles,
        thread_count(threads),
        new_ticket(tiles, 1),
        prepared,
        query,
        bits,
        counters,
        progress=progress,
    )


ORDERED = Form("ordered", as_built)
"""A `Bvh` whose children are traversed in the order of its builder, else nearest first."""


class SingleRays(Tracer):
    """The tracer `single`."""

    description = "one ray at a time, children in the builder's order, else nearest first; tests the last blocker first"
    paper = "Ize 2013, Robust BVH ray traversal"
    form = ORDERED
    cost: Cost | None = Cost(
        rate=FittedRate(
            1.52195, 0.384577, 0.244792, -0.456946, 0.225509, -0.00848352, -0.337287, 0.603732, 0.00764349,
            -0.0071068, -0.0152039, -0.0503218, 0.00998581, -0.00770681, -0.00238311, 0.0047104, 0.00467824,
            0.0199031, 0.030838, -0.0483014, -0.0020627, -0.00713901, 0.706669, 0.132148,
        ),
        reference=160.7,
    )  # fmt: skip

    @property
    def counts_apart(self) -> bool:
        return True

    def trace(
        self,
        prepared: Ordered,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        trace_shadow(prepared, query, bits, threads, counters, progress)


# --- Step counts of any-hit rays [Feltman et al. 2012, Sec. 4.1] ------------------------------------------------------


CLASSES = ("path to the hit", "false hits", "unoccluded")
PATH, FALSE, UNOCCLUDED = range(3)


class Steps(NamedTuple):
    """Step counts of a query with (H, W) receivers."""

    boxes: np.ndarray  # (H, W, 3) int64, boxes tested, by class
    triangles: np.ndarray  # (H, W) int64, triangles tested
    rays: np.ndarray  # (H, W) int64, rays traced: samples above the horizon
    blocked: np.ndarray  # (H, W) int64, traced rays that are blocked
    hits: np.ndarray  # (n,) int64, for each triangle of the scene, the number of rays that it blocked


@kernel
def _count_boxes(bvh, order, inner, depths):
    """Fill `leaf_depths`; order: nodes with parents first; inner: zeros, for the depth of each node."""
    for node in order:
        for side in range(2):
            link, depth = bvh.links[node, LINK + side], inner[node] + 1
            if link >= 0:
                inner[link] = depth
            else:
                leaf = bvh_leaf(np.int64(link))
                for slot in range(leaf.first, min(leaf.first + leaf.count, len(depths))):
                    depths[slot] = depth


def leaf_depths(bvh: Bvh) -> NDArray[np.int32]:
    """(n,) int32: for each slot, the number of boxes on the path from the root to its leaf, including the leaf's."""
    depths = np.zeros(len(bvh.prim_ids), np.int32)
    _count_boxes(bvh, parents_first(bvh.links), np.zeros(len(bvh.nodes), np.int32), depths)
    return depths


@inlined
def _walk_pixel(bvh, order, query, y, x, depths, counters, steps):
    """Trace the rays to all samples of one receiver and count their steps."""
    tree, i = tree_of(bvh), y * query.w + x
    o, skip = get3(query.origins, 3 * i, 1), get(query.ids, i)
    patch, horizon = patch_of(query, i), horizon_of(query, i)
    for s in range(query.spp):
        lx, ly, lz = sample_of(query, patch, i, s)
        ray = segment(o.x, o.y, o.z, lx, ly, lz)
        if (ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0) or not is_above(horizon, lx, ly, lz, query.corners):
            continue
        counters[:] = 0
        slot = walk(tree, ray, skip, query.facing, order, None, counters)[0]
        tested = counters[BOX_TESTS]
        steps.rays[y, x] += 1
        steps.triangles[y, x] += counters[TRIANGLE_TESTS]
        if slot < 0:
            steps.boxes[y, x, UNOCCLUDED] += tested
        else:
            steps.blocked[y, x] += 1
            steps.boxes[y, x, PATH] += depths[slot]
            steps.boxes[y, x, FALSE] += tested - depths[slot]
            atomic_add(steps.hits, bvh.prim_ids[slot], 1)


@kernel
def _walk_rows(ticket, bvh, order, query, depths, steps):
    counters, chunk = stack_array(np.int64, N_COUNTERS), query_pointers(query)
    for y in items(ticket):
        for x in range(chunk.w):
            if get(chunk.sides, y * chunk.w + x) != NOTHING:
                _walk_pixel(bvh, order, chunk, y, x, depths, counters, steps)


def count_steps(
    ordered: Ordered,
    query: ShadowQuery,
    n_triangles: int,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> Steps:
    """Trace all rays of a ShadowQuery and count their steps. The BVH holds some of the scene's `n_triangles`."""
    bvh, shape = ordered.bvh, query.sides.shape
    triangles, rays, blocked = (np.zeros(shape, np.int64) for _ in range(3))
    steps = Steps(np.zeros((*shape, 3), np.int64), triangles, rays, blocked, np.zeros(n_triangles, np.int64))
    ticket = new_ticket(shape[0], 1)
    order, depths = np.int64(ordered.order), leaf_depths(bvh)
    run(_walk_rows, thread_count(threads), ticket, bvh, order, query, depths, steps, progress=progress)
    return steps


def add_steps(all_steps: list[Steps]) -> Steps:
    """The sum of the step counts of several queries with the same receivers."""
    return Steps(*(np.sum(arrays, axis=0) for arrays in zip(*all_steps)))


def hit_depths(bvh: Bvh, hits: NDArray[np.int64]) -> NDArray[np.int64]:
    """(k,) int64: the number of rays blocked at each depth of the BVH; hits: as in `Steps`."""
    depths = leaf_depths(bvh)
    return np.bincount(depths, weights=hits[bvh.prim_ids]).astype(np.int64)
