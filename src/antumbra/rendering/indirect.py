"""Light that bounces once: what arrives at each pixel's surface from the surfaces around it."""

import numpy as np

from ..query.diffuse import diffuse_rays
from ..query.picture import Surfaces
from ..trace.rays.bounce import Nearest
from .state import FrameState, ask_all, picture, queries_of

_BLACK = np.zeros(3, np.float32)


def indirect_light(state: FrameState, surfaces: Surfaces, origins, nearest: Nearest) -> np.ndarray:
    """(H, W, 3) float32: irradiance by light that has bounced once, from as many diffuse rays as there are passes.

    origins : (H, W, 3) float32, the receivers of the surfaces
    nearest : what finds the surfaces that a pass meets

    The rays of a pass are as dense as the cosine to the normal is large, so what arrives is pi times the mean of the
    radiance where they end: of diffuse surfaces that only lights shine on, with their shadows. Rays that end nowhere
    bring nothing.
    """
    passes, gbuffer, ids = state.request.passes, surfaces.gbuffer, surfaces.ids.reshape(-1)
    assert passes is not None
    radiance = np.zeros((*gbuffer.face.shape, 3))
    for k, directions in enumerate(passes.directions):
        rays = diffuse_rays(gbuffer, origins, directions, state.threads)._replace(skip=ids)
        met = nearest(rays, gbuffer.face.shape)
        queries = queries_of(state, met, [of_light[k] for of_light in passes.lights])
        radiance += picture(state, met, ask_all(state, queries), _BLACK)
    return (np.pi / len(passes.directions) * radiance).astype(np.float32)
