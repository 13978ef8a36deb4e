"""Light that bounces once: what arrives at each pixel's surface from the surfaces around it."""

import numpy as np

from .job import Job
from .query.diffuse import Passes, diffuse_rays
from .trace.bounce import Nearest, surfaces_met

_BLACK = np.zeros(3, np.float32)


def indirect_light(job: Job, gbuffer, origins, passes: Passes, nearest: Nearest) -> np.ndarray:
    """(H, W, 3) float32: irradiance by light that has bounced once, from as many diffuse rays as there are passes.

    origins : (H, W, 3) float32, the receivers of the G-buffer's surfaces
    nearest : what finds the nearest hits of a pass

    The rays of a pass are as dense as the cosine to the normal is large, so what arrives is pi times the mean of the
    radiance where they end: of diffuse surfaces that only lights shine on, with their shadows. Rays that end nowhere
    bring nothing.
    """
    radiance = np.zeros((*gbuffer.face.shape, 3))
    for k, directions in enumerate(passes.directions):
        rays = diffuse_rays(gbuffer, origins, directions, job.threads)
        face, t = nearest(*rays)
        met = surfaces_met(rays, face, t, gbuffer.face.shape, job.triangles, job.threads)
        queries = job.queries(met, [of_light[k] for of_light in passes.lights])
        radiance += job.picture(met, queries, [job.ask(query) for query in queries], _BLACK)
    return (np.pi / len(passes.directions) * radiance).astype(np.float32)
