"""The surfaces that rays see, found by CHC+RT: for the camera's rays, and for passes of diffuse rays."""

from collections.abc import Iterator, Sequence

import numpy as np

from ..query.ray_passes import RayPass
from ..query.shadow_query import Surfaces, surfaces_of
from ..scene.camera import CameraRays
from ..trace.rays.ray_hits import Show, surfaces_met
from .trace import Scheduled, camera_hits, nearest_hits


def primary_hits(scheduled: Scheduled, rays: CameraRays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """The (face, t) that a camera sees, in the format of `trace.primary.primary_rays.trace_primary`."""
    hits = camera_hits(scheduled, rays, threads)
    return hits.face, hits.t


def nearest_scheduled(
    passes: Sequence[RayPass], shape, scheduled: Scheduled, triangles, threads=None, show: Show | None = None
) -> Iterator[Surfaces]:
    """Yield the surfaces that passes of a picture of this shape meet first; `triangles`: all triangles of the scene.

    show : as for `trace.rays.ray_hits.nearest_surfaces`
    """
    for rays in passes:
        (hits,) = nearest_hits(scheduled, [rays], shape, threads)
        found = hits.face.reshape(-1), hits.t.reshape(-1)
        if show is not None:
            show(rays, *found)
        met = surfaces_met(rays, *found, shape, triangles, threads)
        yield surfaces_of(met, triangles)
