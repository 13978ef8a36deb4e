"""One diffuse bounce: the surfaces whose light falls on those that a camera sees [Feltman et al. 2012, Sec. 4]."""

import numpy as np

from ..bvh.nodes import Bvh, tree_of
from ..jit import inlined, kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..predicate.exact import ray_along
from ..query.gbuffer import GBuffer, fill_point, surface_of
from ..query.receivers import NOTHING, surface_receivers
from ..query.samples import tangents64
from ..simd import ptr
from .orders import CLOSEST
from .traverse import walk


@inlined
def _cosine_direction(normal, u, v):
    """The direction of random numbers u, v in [0, 1) around a float32 unit normal, as dense as its cosine is large."""
    n = np.float64(normal[0]), np.float64(normal[1]), np.float64(normal[2])
    a, b = tangents64(n[0], n[1], n[2])
    r, angle, up = np.sqrt(u), 2.0 * np.pi * v, np.sqrt(1.0 - u)
    x, y = r * np.cos(angle), r * np.sin(angle)
    return (
        x * a[0] + y * b[0] + up * n[0],
        x * a[1] + y * b[1] + up * n[1],
        x * a[2] + y * b[2] + up * n[2],
    )


@kernel
def _bounce(ticket, bvh, origins, seen, random, out, corners):
    """Worker: what one ray from each receiver meets."""
    tree, surface, triangles = tree_of(bvh), surface_of(out), ptr(corners)
    first = take(ticket)
    while first >= 0:
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            if seen.side[i] == NOTHING:
                continue
            o, d = origins[i], _cosine_direction(seen.normal[i], random[i, 0], random[i, 1])
            ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
            slot, t = walk(tree, ray, np.int64(seen.face[i]), 0, np.int64(CLOSEST), None, None)
            if slot >= 0:
                face = np.int64(bvh.prim_ids[slot])
                out.face[i], out.depth[i] = face, np.float32(t)
                start = np.float64(o[0]), np.float64(o[1]), np.float64(o[2])
                fill_point(start, d, face, t, triangles, surface, i)
        first = take(ticket)


def bounced(gbuffer: GBuffer, triangles, bvh: Bvh, seed: int = 0, threads: int | None = None) -> GBuffer:
    """What one diffuse ray from each pixel's surface sees, as a G-buffer of the same shape; depth: length of the ray.

    triangles : `Triangles`, all that `bvh` is of
    """
    shape, m = gbuffer.face.shape, gbuffer.face.size
    corners = triangles.vertices.reshape(-1, 9)
    seen = GBuffer(*(a.reshape(m, *a.shape[2:]) for a in gbuffer[:5]), gbuffer.origin)
    origins = surface_receivers(seen.position, seen.normal, seen.face, seen.side, corners, threads)
    random = np.random.default_rng(seed).random((m, 2))
    zeros = np.zeros((m, 3), np.float32)
    out = GBuffer(
        zeros, zeros.copy(), np.full(m, -1, np.int32), np.full(m, np.inf, np.float32), np.full(m, NOTHING, np.int8),
        gbuffer.origin,
    )  # fmt: skip
    run(_bounce, thread_count(threads), new_ticket(m, 1024), bvh, origins, seen, random, out, corners)
    return GBuffer(*(a.reshape(*shape, *a.shape[1:]) for a in out[:5]), gbuffer.origin)
