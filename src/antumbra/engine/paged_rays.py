"""Ray lists through a store: batches of rays in an order in which neighbours are alike, each batch one question."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.predicate.exact import ray_along
from ..kernels.predicate.hits import single_weights
from ..query.query_bounds import morton_codes
from ..query.ray_list import RayArrays, changed
from ..query.ray_passes import RayPass
from ..scene.triangles import Triangles
from ..techniques.chcrt.chc_rt import ray_hits
from ..trace.tree_list import Hits

RAY_BYTES = 160
"""Memory of a ray while it is traced."""

LEAST = 1 << 16
"""Rays of a batch, if there are so many: with fewer, each chunk would be read for few rays."""

_LEAST_EXPONENT = 0  # shorter directions are lengthened


class Batch(NamedTuple):
    """Some rays of a list, and their hits."""

    places: np.ndarray  # (n,) int64: index of each ray in the list
    rays: RayPass
    hits: Hits  # (1, n)
    triangles: Triangles  # the triangles that they hit; empty for any-hit
    faces: np.ndarray  # (n,) int32: index of each hit's triangle in `triangles`, or -1


def batches(paged, arguments: RayArrays, any_hit: bool, cull_faces: int, most: int) -> Iterator[Batch]:
    """Trace the rays of a list, at most `most` at a time."""
    order = _alike(arguments)
    for begin in range(0, len(order), most):
        places = order[begin : begin + most]
        some = arguments.part(places)
        rays, spans = some.rays(), np.concatenate([some.tmin, some.tmax], 1, dtype=np.float64)
        rays, factors = _lengthened(rays)
        targets = some.local()[1] if some.segments else None
        if not (np.isfinite(rays.origins).all() and np.isfinite(some.local()[1]).all()):
            raise changed()  # they were checked before
        with np.errstate(over="ignore", under="ignore"):  # no t is as large or as small
            spans = spans / factors
        hits = ray_hits(paged.accelerated.prepared, rays, spans, cull_faces, any_hit, paged.threads, targets)
        hits = hits._replace(t=hits.t * factors.T)
        if any_hit:
            yield Batch(places, rays, hits, paged.accelerated.triangles, hits.face[0])
        else:
            triangles, (faces,) = paged.hit_triangles([hits])
            yield Batch(places, rays, hits, triangles, faces[0])


def _alike(arguments: RayArrays) -> np.ndarray:
    """The order of rays by the cells of their origins, then of their directions, both in Morton order."""
    with np.errstate(invalid="ignore", over="ignore"):
        directions = arguments.directions.astype(np.float32)
        if arguments.segments:
            directions -= arguments.origins.astype(np.float32)
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-30)
        return np.lexsort((morton_codes(directions), morton_codes(arguments.origins)))


def _lengthened(rays: RayPass) -> tuple[RayPass, np.ndarray]:
    """The rays with short directions times a power of two, which is exact; and these powers, (n, 1) float64.

    Tracers take multiples of directions that are as long as the scene, which float32 might not hold.
    """
    exponents = np.frexp(np.abs(rays.directions).max(1, initial=0.0, keepdims=True))[1]
    factors = np.ldexp(1.0, np.maximum(_LEAST_EXPONENT - exponents, 0))
    return rays._replace(directions=(rays.directions * factors).astype(np.float32)), factors


@kernel
def _write_weights(ticket, rays, faces, corners, u, v):
    """Worker: write the weights of the second and the third corner at each hit."""
    for i in items(ticket):
        if faces[i] >= 0:
            o, d = rays.origins[i], rays.directions[i]
            ray = ray_along(o[0], o[1], o[2], d[0], d[1], d[2], 0.0, np.inf)
            u[i], v[i] = single_weights(ray, corners, np.int64(faces[i]))


def weights(batch: Batch, threads: int) -> tuple[np.ndarray, np.ndarray]:
    """(u, v) of a batch's hits, (n,) float32 each; 0 on a miss."""
    u, v = np.zeros(len(batch.places), np.float32), np.zeros(len(batch.places), np.float32)
    corners = batch.triangles.vertices.reshape(-1, 9)
    run(_write_weights, threads, new_ticket(len(u), 4096), batch.rays, batch.faces, corners, u, v)
    return u, v
