"""What a device cannot decide, decided on the CPU: by the exact predicate, and by the walk that CPU tracers use.

A device leaves records of tests, see `device_kernels`, and of rays that would fill the list of tests again and again.
"""

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import Bvh, tree_of
from ...kernels.exact.filters import comes_first, hit_t, meets, rounded_t, single_weights
from ...kernels.exact.predicate import Ray
from ...kernels.jit import inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr, ptr_at
from ...query.shadow_query import ResidentQuery, ShadowQuery, horizon_of, is_above, patch_of, query_pointers, sample_of
from ..rays.ray_traversal import BUILT, CLOSEST, walk
from .device_kernels import RECORD

_CHUNK = 64
RAY, SLOT, BEST = range(3)  # int32 words of a record of a test; SLOT -1: of the receiver's own surface
SKIP, STATE = 1, 2  # instead, in a record of a ray

Records = NDArray[np.float64]
"""(m, RECORD) float64, as `device_kernels` writes them."""


def heads_of(records: Records) -> NDArray[np.int32]:
    """(m, 4) int32: the words RAY, SLOT and BEST of each record, and an unused one."""
    return records.view(np.int32)[:, :4]


def renumber(records: Records) -> NDArray[np.int32]:
    """The slots in records of tests, ascending, each once; the records then hold indices in this list, or -1."""
    heads = heads_of(records)[:, SLOT : BEST + 1]
    slots, places = np.unique(heads, return_inverse=True)
    none = int(np.searchsorted(slots, 0))
    heads[...] = places.reshape(heads.shape) - none
    return slots[none:]


@inlined
def ray_of(records, k):
    """The ray of a record."""
    p = ptr_at(ptr(records), RECORD * k + 2)
    return Ray(
        get(p, 0), get(p, 1), get(p, 2), get(p, 3), get(p, 4), get(p, 5), get(p, 6), get(p, 7), get(p, 8), get(p, 9),
        get(p, 10), get(p, 11),
    )  # fmt: skip


@inlined
def _is_below(query, at):
    """Whether the receiver's own surface blocks segment `at` of a query."""
    i, s = at // query.spp, at % query.spp
    x, y, z = sample_of(query, patch_of(query, i), i, s)
    return not is_above(horizon_of(query, i), x, y, z, query.corners)


def example_records(n: int) -> Records:
    """Records of n tests, or rays, that find nothing: for compiling the kernels here."""
    records = np.zeros((n, RECORD))
    heads_of(records)[:, [SLOT, BEST]] = 0, -1
    records[:, 2:] = 0.0, 100.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0
    return records


# --- Tests ------------------------------------------------------------------------------------------------------------


@kernel
def _decide_tests(ticket, records, heads, corners, cull_faces, blocked):
    # In: records and their heads, corners of triangles, cull_faces. Out: blocked
    triangles = ptr(corners)
    for k in items(ticket):
        if heads[k, SLOT] >= 0:
            side = meets(ray_of(records, k), triangles, np.int64(heads[k, SLOT]))
            blocked[k] = side != 0 and side != cull_faces


def are_hits(records: Records, corners: NDArray[np.float32], cull_faces: int, threads: int) -> NDArray[np.bool_]:
    """(m,) bool: whether the rays of records meet the triangles in their slots; False: also for slots < 0.

    corners : (n, 9) float32, by slot
    """
    blocked, n = np.zeros(len(records), np.bool_), len(records)
    run(_decide_tests, threads, new_ticket(n, _CHUNK), records, heads_of(records), corners, cull_faces, blocked)
    return blocked


def blocked_rays(
    records: Records, bvh: Bvh, cull_faces: int, query: ShadowQuery | None, first: int, threads: int
) -> NDArray[np.int32]:
    """The rays that are blocked by the tests in the records.

    query : the shadow query; None: the rays are of a list, and no test is of a receiver's own surface
    first : number of the ray that records call ray 0
    """
    heads, blocked = heads_of(records), are_hits(records, bvh.corners, cull_faces, threads)
    if query is not None:
        own = heads[:, SLOT] < 0
        blocked[own] = below_horizon(first + heads[own, RAY].astype(np.int64), query, threads)
    return np.unique(heads[blocked, RAY])


@kernel
def _decide_nearest(records, heads, bvh, cull_faces, slots):
    # In: records and their heads, sorted by ray, the bvh, cull_faces. Out: slots
    tree, best, best_t, last = tree_of(bvh), np.int64(-1), np.float64(0.0), np.int64(-1)
    for k in range(len(heads)):
        ray, i, slot = ray_of(records, k), np.int64(heads[k, RAY]), np.int64(heads[k, SLOT])
        if i != last:
            last, best = i, np.int64(heads[k, BEST])
            if best >= 0:
                best_t = hit_t(ray, tree.corners, best)
        side = meets(ray, tree.corners, slot)
        if side != 0 and side != cull_faces:
            t, prim = hit_t(ray, tree.corners, slot), np.int64(get(tree.prim_ids, slot))
            if best < 0 or comes_first(
                ray, tree.corners, slot, prim, t, tree.corners, best, np.int64(get(tree.prim_ids, best)), best_t
            ):
                best, best_t = slot, t
        slots[k] = best


def nearest_slots(records: Records, bvh: Bvh, cull_faces: int) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """(rays, slots of their nearest hits): the first one among the records' tests and the best hit so far."""
    records = records[np.argsort(heads_of(records)[:, RAY], kind="stable")]
    heads, slots = heads_of(records), np.empty(len(records), np.int32)
    _decide_nearest(records, heads, bvh, cull_faces, slots)
    rays = heads[:, RAY]
    last = np.append(rays[1:] != rays[:-1], True)
    return rays[last], slots[last]


@kernel
def _compute_numbers(ticket, records, heads, corners, t, u, v):
    # In: records and their heads, corners of triangles. Out: t, u, v
    triangles = ptr(corners)
    for k in items(ticket):
        ray, slot = ray_of(records, k), np.int64(heads[k, SLOT])
        t[k] = rounded_t(ray, triangles, slot)
        u[k], v[k] = single_weights(ray, triangles, slot)


def numbers_of(
    records: Records, bvh: Bvh, threads: int
) -> tuple[NDArray[np.float64], NDArray[np.float32], NDArray[np.float32]]:
    """(t, u, v) of the hits in the records."""
    n = len(records)
    t, u, v = np.empty(n), np.empty(n, np.float32), np.empty(n, np.float32)
    run(_compute_numbers, threads, new_ticket(n, _CHUNK), records, heads_of(records), bvh.corners, t, u, v)
    return t, u, v


# --- Rays -------------------------------------------------------------------------------------------------------------


@kernel
def _trace_rays(ticket, records, heads, bvh, cull_faces, order, slots):
    # In: records and their heads, the bvh, cull_faces, order of children. Out: slots
    tree = tree_of(bvh)
    for k in items(ticket):
        skip = np.int64(heads[k, SKIP])
        slots[k] = walk(tree, ray_of(records, k), skip, cull_faces, order, None, None)[0]


def traced_rays(records: Records, bvh: Bvh, cull_faces: int, any_hit: bool, threads: int) -> NDArray[np.int32]:
    """(m,) int32: the slot of a triangle that each ray meets, or of the nearest one; -1: none."""
    slots, order = np.empty(len(records), np.int32), np.int64(BUILT if any_hit else CLOSEST)
    heads, ticket = heads_of(records), new_ticket(len(records), _CHUNK)
    run(_trace_rays, threads, ticket, records, heads, bvh, cull_faces, order, slots)
    return slots


@kernel
def _decide_horizons(ticket, rays, query, below):
    # In: indices of rays of the query. Out: below
    pointers = query_pointers(query)
    for k in items(ticket):
        below[k] = _is_below(pointers, rays[k])


def below_horizon(rays: NDArray[np.int64], query: ShadowQuery, threads: int) -> NDArray[np.bool_]:
    """(m,) bool: whether the receivers' own surfaces block some segments of a query, by their numbers."""
    if isinstance(query, ResidentQuery):
        query = query.with_corners_of(rays // query.samples.shape[1])
    below = np.empty(len(rays), np.bool_)
    run(_decide_horizons, threads, new_ticket(len(rays), _CHUNK), rays, query, below)
    return below
