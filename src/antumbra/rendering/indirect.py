"""Light that bounces once: the irradiance at each pixel's surface from the surfaces around it."""

import numpy as np

from ..query.diffuse import diffuse_rays
from ..query.picture import Surfaces
from ..trace.rays.bounce import Nearest
from .state import FrameState, ask_all, picture, queries_of

_BLACK = np.zeros(3, np.float32)


def indirect_light(state: FrameState, surfaces: Surfaces, origins, nearest: Nearest) -> np.ndarray:
    """(H, W, 3) float32: irradiance after one bounce, estimated with one diffuse ray per pass.

    origins : (H, W, 3) float32, the receivers of the surfaces
    nearest : finds the surfaces that the rays of a pass meet first

    The density of the rays is proportional to the cosine to the normal. So the irradiance is pi times the mean radiance
    of the surfaces they meet. These surfaces are diffuse; the lights alone illuminate them, with shadows. Rays that
    leave the scene contribute zero.
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
