"""Hits of ray lists: the surfaces that diffuse rays meet, and all triangles that segments meet.

One diffuse bounce starts from the surfaces that the camera sees. The builder `srdh` [Feltman et al. 2012, Sec. 3.4] and
the alpha test need all intersections of their rays.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...bvh.nodes import LEFT_FIRST, Bvh, tree_of
from ...kernels.elementary import cos, sin
from ...kernels.exact.predicate import ray_along, segment
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import atomic_add, get, ptr, put, stack_i32
from ...query.gbuffer import GBuffer, face_normal, fill_point, surface_of
from ...query.ray_passes import RayPass, diffuse_rays
from ...query.receivers import NOTHING, surface_receivers
from ...query.shadow_query import Surfaces, surfaces_of
from ...scene.triangles import Triangles
from .ray_traversal import CLOSEST, HitList, walk


class Intersections(NamedTuple):
    """Segments, and all triangles that each segment meets."""

    origins: np.ndarray  # (m, 3) float32
    ends: np.ndarray  # (m, 3) float32
    first: np.ndarray  # (m + 1,) int64: segment i has `prims` from first[i] to first[i + 1]
    prims: np.ndarray  # (h,) int32, triangle indices


# --- All triangles that segments meet ---------------------------------------------------------------------------------


MOST_HITS = 1 << 14
"""Largest number of triangles stored per segment; others are dropped."""

_CHUNK = 64
_A_RAY = 16  # hits per segment for which memory is first allocated


@kernel
def _collect(ticket, bvh, origins, ends, skip, cull_faces, next_free, prims, spans):
    """Worker: write the triangles that each segment meets to `prims`, up to its size, and their `spans`."""
    # In: bvh, origins, ends, skip, cull_faces. Out: next_free, prims, spans.
    tree, slots, n = tree_of(bvh), stack_i32(MOST_HITS), stack_i32(1)
    hits = HitList(slots, n, np.int64(MOST_HITS))
    for i in items(ticket):
        put(n, 0, 0)
        o, e = origins[i], ends[i]
        ray = segment(o[0], o[1], o[2], e[0], e[1], e[2])
        if ray.dx != 0.0 or ray.dy != 0.0 or ray.dz != 0.0:
            walk(tree, ray, np.int64(skip[i]), cull_faces, np.int64(LEFT_FIRST), hits, None)
        start, count = 0, get(n, 0)
        if count > 0:
            start = atomic_add(next_free, 0, count)
        for k in range(min(count, len(prims) - start)):
            prims[start + k] = get(slots, k)
        spans[i, 0], spans[i, 1] = start, count


def intersections(
    bvh: Bvh,
    origins: NDArray[np.float32],
    ends: NDArray[np.float32],
    skip: NDArray[np.int32],
    threads: int | None = None,
    cull_faces: int = 0,
) -> Intersections:
    """All triangles that segments meet, by exact tests.

    origins, ends : (m, 3) float32
    skip : (m,) int32, a triangle to ignore per segment, or -1
    cull_faces : a value of `query.shadow_query.CULL_FACES`
    """
    m, room = len(origins), _A_RAY * len(origins)
    spans = np.empty((m, 2), np.int64)
    while True:
        next_free, prims = np.zeros(1, np.int64), np.empty(room, np.int32)
        ticket = new_ticket(m, _CHUNK)
        run(_collect, thread_count(threads), ticket, bvh, origins, ends, skip, cull_faces, next_free, prims, spans)
        if next_free[0] <= room:
            break
        room = int(next_free[0])
    starts, counts = spans.T
    first = np.concatenate([[0], np.cumsum(counts)])
    # threads write to `prims` in any order; sort by segment, so that the result does not depend on threads
    order = np.repeat(starts - first[:-1], counts) + np.arange(first[-1])
    return Intersections(origins, ends, first, prims[order])


# --- One diffuse bounce -----------------------------------------------------------------------------------------------


Nearest = Callable[[Sequence[RayPass], tuple[int, int]], Iterator[Surfaces]]
"""A function of passes and the height and width of their picture, which yields each pass's nearest surfaces."""

Show = Callable[[RayPass, np.ndarray, np.ndarray], None]
"""A function of a pass and the face and t of its hits, (m,) each, which replaces hits by nearer ones."""


@kernel
def _nearest(ticket, bvh, rays, faces, ts):
    """Worker: find the nearest hit of each ray."""
    tree = tree_of(bvh)
    for i in items(ticket):
        o, d = rays.origins[i], rays.directions[i]
        if d[0] == 0.0 and d[1] == 0.0 and d[2] == 0.0:
            continue
        ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
        slot, t = walk(tree, ray, np.int64(rays.skip[i]), 0, np.int64(CLOSEST), None, None)
        if slot >= 0:
            faces[i], ts[i] = bvh.prim_ids[slot], t


def nearest_hits(
    bvh: Bvh,
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    skip: NDArray[np.int32],
    threads: int | None = None,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """The nearest triangle that each ray of a `RayPass` meets: (face, t).

    face : (m,) int32, the first one among equal t, as `filters.precedes` states; -1 on a miss
    t : (m,) float64, in lengths of the direction; inf on a miss
    """
    m = len(origins)
    face, t = np.full(m, -1, np.int32), np.full(m, np.inf)
    rays = RayPass(origins, directions, skip)
    run(_nearest, thread_count(threads), new_ticket(m, 1024), bvh, rays, face, t)
    return face, t


@kernel
def _surfaces(ticket, rays, ts, out, corners):
    """Worker: write the point and the surface of each ray's hit."""
    surface, triangles = surface_of(out), ptr(corners)
    for i in items(ticket):
        face = np.int64(out.face[i])
        if face >= 0:
            o, d = rays.origins[i], rays.directions[i]
            start = np.float64(o[0]), np.float64(o[1]), np.float64(o[2])
            along = np.float64(d[0]), np.float64(d[1]), np.float64(d[2])
            out.depth[i] = np.float32(ts[i])
            fill_point(start, along, face_normal(triangles, face), ts[i], surface, i)


def hit_surfaces(
    rays: RayPass,
    face: NDArray[np.int32],
    t: NDArray[np.float64],
    shape: tuple[int, ...],
    triangles: Triangles,
    threads: int | None = None,
) -> GBuffer:
    """The G-buffer of a picture's rays; its depth is t.

    face, t : from `nearest_hits`
    shape : of the picture
    triangles : the triangles that `face` indexes
    """
    m, zeros = len(face), np.zeros((len(face), 3), np.float32)
    nothing = np.full(m, np.inf, np.float32), np.full(m, NOTHING, np.int8)
    out = GBuffer(zeros, zeros.copy(), face, *nothing, triangles.origin)
    corners = triangles.vertices.reshape(-1, 9)
    run(_surfaces, thread_count(threads), new_ticket(m, 4096), rays, t, out, corners)
    return GBuffer._make((*(a.reshape(*shape, *a.shape[1:]) for a in out[:5]), triangles.origin))


def nearest_surfaces(
    passes: Sequence[RayPass],
    shape: tuple[int, ...],
    bvh: Bvh,
    triangles: Triangles,
    threads: int | None = None,
    show: Show | None = None,
) -> Iterator[Surfaces]:
    """Yield the nearest surfaces of each pass, in a picture of this shape and a BVH of all triangles.

    show : called with each pass and the face and t of its hits, to replace some of them
    """
    for rays in passes:
        hits = nearest_hits(bvh, *rays, threads)
        if show is not None:
            show(rays, *hits)
        yield surfaces_of(hit_surfaces(rays, *hits, shape, triangles, threads), triangles)


def bounce_surfaces(
    gbuffer: GBuffer, triangles: Triangles, bvh: Bvh, seed: int = 0, threads: int | None = None
) -> GBuffer:
    """The G-buffer of one random diffuse ray from each pixel's surface [Feltman et al. 2012, Sec. 4].

    It has the shape of `gbuffer`, and its depth is the length of the ray.

    triangles : `Triangles`, all triangles of `bvh`
    """
    shape, m = gbuffer.face.shape, gbuffer.face.size
    points, normals = gbuffer.position.reshape(m, 3), gbuffer.normal.reshape(m, 3)
    corners = triangles.vertices.reshape(-1, 9)
    origins = surface_receivers(points, normals, gbuffer.face.reshape(m), gbuffer.side.reshape(m), corners, threads)
    origins = origins.reshape(*shape, 3)
    u, v = np.random.default_rng(seed).random((m, 2)).T
    r, angle = np.sqrt(u), 2.0 * np.pi * v
    samples = np.stack([r * cos(angle), r * sin(angle), np.sqrt(1.0 - u)], 1).reshape(*shape, 3)
    rays = diffuse_rays(gbuffer, origins, samples, threads)
    return hit_surfaces(rays, *nearest_hits(bvh, *rays, threads), shape, triangles, threads)
