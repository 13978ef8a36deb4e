"""A tracer that tests each ray against every triangle, which pays off in scenes of a few triangles."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antumbra.bvh.nodes import Bvh
from antumbra.engine.method_registry import Cost, Form, QueryFeatures, Tracer
from antumbra.kernels.jit import F32Ptr, I32Ptr, inlined, overload
from antumbra.kernels.simd import get, ptr
from antumbra.query.shadow_query import ShadowQuery
from antumbra.trace.rays import single_rays
from antumbra.trace.rays.ray_traversal import triangle_hit


class Triangles(NamedTuple):
    """The form of the tracer: the triangles of a BVH in the order of its leaves."""

    corners: np.ndarray  # (n, 9) float32
    prim_ids: np.ndarray  # (n,) int32


class TrianglePointers(NamedTuple):
    """The same in kernels."""

    corners: F32Ptr  # float32 *, 9 per triangle
    prim_ids: I32Ptr  # int32 *
    n: int


def triangles_of(bvh: Bvh, threads: int | None = None) -> Triangles:
    """The form of a BVH."""
    return Triangles(bvh.corners, bvh.prim_ids)


def rate(features: QueryFeatures) -> float:
    """Nanoseconds per ray on one thread, as measured. A wrong rate makes `auto` slower, but no answer wrong."""
    return 10.0 + 6.0 * features.triangles


class EveryTriangle(Tracer):
    """The tracer `every-triangle`."""

    description = "tests each ray against every triangle"
    form = Form("triangle list", triangles_of)
    cost = Cost(rate)

    def trace(
        self,
        prepared: Triangles,
        query: ShadowQuery,
        bits: NDArray[np.uint64],
        threads: int | None = None,
        counters: NDArray[np.int64] | None = None,
        progress: Any = None,
        fresh: bool = True,
    ) -> None:
        # the loop of `single` over receivers and samples, which calls the kernels below for this form
        single_rays.trace_shadow(prepared, query, bits, threads, counters, progress)


# --- Kernels ----------------------------------------------------------------------------------------------------------


@overload(single_rays.pointers)
def _pointers(prepared):
    if prepared.instance_class is Triangles:
        return lambda prepared: TrianglePointers(
            ptr(prepared.corners), ptr(prepared.prim_ids), np.int64(len(prepared.prim_ids))
        )
    return None


@overload(single_rays.blocker)
def _blocker(tree, ray, skip, cull_faces, last, counters):
    if tree.instance_class is TrianglePointers:
        return lambda tree, ray, skip, cull_faces, last, counters: first_blocker(tree, ray, skip, cull_faces, counters)
    return None


@inlined
def first_blocker(tree, ray, skip, cull_faces, counters):
    """The slot of a triangle that the ray meets, or -1; `skip`: the triangle that the ray starts on."""
    o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
    d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
    for slot in range(tree.n):
        if get(tree.prim_ids, slot) != skip and triangle_hit(tree.corners, slot, ray, o, d, cull_faces, counters):
            return slot
    return -1
