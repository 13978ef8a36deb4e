"""Exact step counts of any-hit rays, by class and receiver [Feltman et al. 2012, Sec. 4.1].

A step is a test of a ray against the box of a child that the walk comes to. The root's box is not tested. There are
three classes of steps:

- path to the hit: for a blocked ray, the steps from the root to the leaf of its blocker
- false hits (faux hits): for a blocked ray, all other steps
- unoccluded: the steps of rays that nothing blocks

Rays are walked one by one, and the last blocker is not tested first.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.links import LINK, bvh_leaf
from ...bvh.nodes import Bvh, parents_first, tree_of
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.predicate.exact import segment
from ...kernels.simd import atomic_add, get, stack_array
from ...kernels.vec import scalars
from ...query.receivers import NOTHING
from ...query.shadow_query import horizon_of, is_above, patch_of, query_pointers, sample_of
from ..counters import BOX_TESTS, N_COUNTERS, TRIANGLE_TESTS
from .orders import Ordered
from .traverse import walk

CLASSES = ("path to the hit", "false hits", "unoccluded")
PATH, FALSE, UNOCCLUDED = range(3)


class Steps(NamedTuple):
    """The steps of the rays of a query with (H, W) receivers."""

    boxes: np.ndarray  # (H, W, 3) int64, boxes tested, by class
    triangles: np.ndarray  # (H, W) int64, triangles tested
    rays: np.ndarray  # (H, W) int64, rays walked: samples above the horizon
    blocked: np.ndarray  # (H, W) int64, walked rays that are blocked
    hits: np.ndarray  # (n,) int64, for each triangle of the scene, rays whose blocker it was


@kernel
def _count_boxes(bvh, order, inner, depths):
    """Fill `leaf_depths`; `order`: parents first, `inner`: zeros for the depth of each node."""
    for node in order:
        for side in range(2):
            link, depth = bvh.links[node, LINK + side], inner[node] + 1
            if link >= 0:
                inner[link] = depth
            else:
                leaf = bvh_leaf(np.int64(link))
                for slot in range(leaf.first, min(leaf.first + leaf.count, len(depths))):
                    depths[slot] = depth


def leaf_depths(bvh: Bvh) -> np.ndarray:
    """(n,) int32: for each slot, the number of boxes on the path from the root to its leaf, with the leaf's own."""
    depths = np.zeros(len(bvh.prim_ids), np.int32)
    _count_boxes(bvh, parents_first(bvh.links), np.zeros(len(bvh.nodes), np.int32), depths)
    return depths


@inlined
def _walk_pixel(bvh, order, query, y, x, depths, counters, steps):
    """Walk the rays to all samples of one receiver, and count their steps."""
    tree, i = tree_of(bvh), y * query.w + x
    o, skip = scalars(query.origins, 3 * i, 1), np.int64(get(query.ids, i))
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


def count_steps(ordered: Ordered, query, n_triangles: int, threads=None, progress=None) -> Steps:
    """Walk all rays of a ShadowQuery and count their steps. The BVH holds some of the scene's `n_triangles`."""
    bvh, shape = ordered.bvh, query.sides.shape
    planes = [np.zeros((*shape, 3), np.int64), *(np.zeros(shape, np.int64) for _ in range(3))]
    steps = Steps(*planes, np.zeros(n_triangles, np.int64))
    ticket = new_ticket(shape[0], 1)
    order, depths = np.int64(ordered.order), leaf_depths(bvh)
    run(_walk_rows, thread_count(threads), ticket, bvh, order, query, depths, steps, progress=progress)
    return steps


def add_steps(all_steps: list[Steps]) -> Steps:
    """The sums of the steps of several queries with the same receivers."""
    return Steps(*(np.sum(arrays, axis=0) for arrays in zip(*all_steps)))


def hit_depths(bvh: Bvh, hits: np.ndarray) -> np.ndarray:
    """(k,) int64: the number of rays blocked at each depth of the BVH; `hits` as in `Steps`."""
    depths = leaf_depths(bvh)
    return np.bincount(depths, weights=hits[bvh.prim_ids]).astype(np.int64)
