"""Single rays through scenes of instances: all hits of ray lists, and shadow queries."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.instance_trees import (
    InstanceArrays,
    InstancePointers,
    InstanceTrees,
    instance_pointers,
    mesh_pointers,
)
from ...kernels.exact.filters import plane_side, signed_t, single_weights
from ...kernels.exact.predicate import exact_touches
from ...kernels.exact.surface_crossing import crosses_surface
from ...kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import get, ptr, put, stack_f32, stack_f64, stack_i64
from ...query.ray_list import RayArrays, hit_arrays
from ...scene.triangles import AllHits
from ..counters import REPEAT_HITS, count
from .all_hits import INSIDE, ON_SURFACE, TRIANGLES, sorted_hits
from .instance_traversal import (
    BEST,
    HIT_FLOATS,
    HIT_IDS,
    TESTED,
    InstanceHit,
    InstanceQuery,
    face_of,
    meets_triangle,
    place_triangle,
    test_triangle,
    walk_instances,
)
from .local_rays import local_ray, local_rays
from .ray_traversal import triangle_hit
from .single_rays import blocker, pointers

_CHUNK = 64

# --- All hits ---------------------------------------------------------------------------------------------------------


class InstanceHitList(NamedTuple):
    """Records all hits of a ray: pointers, and numbers."""

    corners: F32Ptr  # float32 *, HIT_FLOATS: the triangle that is tested
    t: F64Ptr  # float64 *, 1: the ray's tmax
    ids: I64Ptr  # int64 *, 1: not used
    count: I64Ptr  # int64 *, 1: number of hits; ON_SURFACE is added as in `all_hits`
    first: int  # element of the arrays below for the first hit; -1: hits are only counted
    rule: int  # of `all_hits`
    out_t: F64Ptr
    out_face: I32Ptr
    out_u: F32Ptr
    out_v: F32Ptr


@inlined
def _touches(ray, o, corners):
    """Whether a ray's origin is on the triangle that is tested; o: the origin in float32."""
    on_plane = plane_side(o[0], o[1], o[2], corners, TESTED) == 0
    return on_plane and exact_touches(ray.ox, ray.oy, ray.oz, corners, TESTED)


@kernel
def _record_triangle(scene, i, source, ray, query, hits, counters):
    """`test_triangle` for all hits. Return False, since no hit ends the query."""
    mesh, corners = mesh_pointers(scene, get(scene.mesh, i)), hits.corners
    place_triangle(scene, i, mesh, source, corners, TESTED)
    face, n = face_of(scene, i, mesh, source), get(hits.count, 0)
    if face == query.skip:
        return False
    o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
    d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
    if triangle_hit(corners, TESTED, ray, o, d, query.cull_faces, counters):
        if hits.rule != TRIANGLES and not crosses_surface(ray, corners, TESTED):
            return False
        if hits.first >= 0:
            at, (u, v) = hits.first + n, single_weights(ray, corners, TESTED)
            put(hits.out_t, at, signed_t(ray, corners, TESTED))
            put(hits.out_face, at, face)
            put(hits.out_u, at, u)
            put(hits.out_v, at, v)
        put(hits.count, 0, n + 1)
    elif hits.rule == INSIDE and _touches(ray, o, corners):
        put(hits.count, 0, n | ON_SURFACE)
    return False


@overload(test_triangle)
def _test_triangle(scene, i, source, ray, query, hit, counters):
    if hit.instance_class is InstanceHitList:
        return lambda scene, i, source, ray, query, hit, counters: _record_triangle(
            scene, i, source, ray, query, hit, counters
        )
    return None


@kernel
def _list_hits(ticket, arrays, rays, rule, offsets, counts, out):
    """Worker: count the hits of each ray; where there are offsets, write them from there on, unsorted."""
    scene, corners, t = instance_pointers(arrays), stack_f32(HIT_FLOATS), stack_f64(1)
    ids, n = stack_i64(HIT_IDS), stack_i64(1)
    for i in items(ticket):
        ray, first = local_ray(rays, i), offsets[i] if len(offsets) > 0 else np.int64(-1)
        hits = InstanceHitList(
            corners, t, ids, n, first, rule, ptr(out.t), ptr(out.face), ptr(out.u), ptr(out.v)
        )  # fmt: skip
        put(n, 0, np.int64(0))
        if ray.dx != 0.0 or ray.dy != 0.0 or ray.dz != 0.0:
            query = InstanceQuery(np.int64(rays.skip[i]), rays.cull_faces, True)
            walk_instances(scene, ray, query, hits, None)
        counts[i] = get(n, 0)


def count_all(
    trees: InstanceTrees, rays: RayArrays, cull_faces: int, rule: int, threads: int | None = None
) -> NDArray[np.int64]:
    """(n,) int64: the number of hits of valid rays, by a rule of `all_hits`."""
    counts, none = np.empty(len(rays.origins), np.int64), np.empty(0, np.int64)
    local, ticket = local_rays(rays, cull_faces), new_ticket(len(counts), _CHUNK)
    run(_list_hits, thread_count(threads), ticket, trees.arrays, local, rule, none, counts, hit_arrays(1, False))
    return counts


def find_all(
    trees: InstanceTrees,
    rays: RayArrays,
    cull_faces: int,
    rule: int,
    max_hits: int | None = None,
    threads: int | None = None,
) -> AllHits:
    """All hits of valid rays, or the first `max_hits` of each, by a rule of `all_hits`. Rays are traced twice."""
    counts = count_all(trees, rays, cull_faces, rule, threads)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    out, local = hit_arrays(max(int(offsets[-1]), 1), False), local_rays(rays, cull_faces)
    ticket = new_ticket(len(counts), _CHUNK)
    run(_list_hits, thread_count(threads), ticket, trees.arrays, local, rule, offsets[:-1].copy(), counts, out)
    columns = [array[: offsets[-1]] for array in (out.t, out.face, out.u, out.v)]
    return sorted_hits(np.repeat(np.arange(len(counts)), counts), columns, len(counts), max_hits)


# --- Shadow queries ---------------------------------------------------------------------------------------------------


class InstanceForest(NamedTuple):
    """The input of the tracer `wide` for instances, whose `InstanceTrees` must outlive it."""

    arrays: InstanceArrays


class ForestPointers(NamedTuple):
    """Pointers to the arrays of an `InstanceForest`."""

    scene: InstancePointers


@inlined
def _forest_pointers(prepared):
    return ForestPointers(instance_pointers(prepared.arrays))


@overload(pointers)
def _pointers(prepared):
    if prepared.instance_class is InstanceForest:
        return lambda prepared: _forest_pointers(prepared)
    return None


@kernel
def _blocked(scene, ray, skip, cull_faces, last, counters):
    """A triangle that blocks the ray, as 2^32 times its copy, plus its lane in the mesh's tree; -1: none."""
    hit = InstanceHit(stack_f32(HIT_FLOATS), TESTED, BEST, stack_f64(1), stack_i64(HIT_IDS))
    query = InstanceQuery(np.int64(skip), np.int64(cull_faces), True)
    if last >= 0 and meets_triangle(scene, last >> 32, last & 0xFFFFFFFF, ray, query, hit, counters):
        count(counters, REPEAT_HITS, 1)
        return last
    walk_instances(scene, ray, query, hit, counters)
    return get(hit.ids, 1) << 32 | get(hit.ids, 2) if get(hit.ids, 0) >= 0 else np.int64(-1)


@overload(blocker)
def _blocker(tree, ray, skip, cull_faces, last, counters):
    if tree.instance_class is ForestPointers:
        return lambda tree, ray, skip, cull_faces, last, counters: _blocked(
            tree.scene, ray, skip, cull_faces, np.int64(last), counters
        )
    return None
