"""Light that bounces once: the irradiance at each pixel's surface from the surfaces around it."""

from collections.abc import Iterable, Iterator
from itertools import islice

import numpy as np

from ..query.ray_passes import diffuse_rays
from ..query.shadow_query import Surfaces
from ..trace.rays.ray_hits import Nearest
from .memory import LIGHT_BYTES, PASS_BYTES, SURFACE_BYTES
from .state import FrameState, TracedLights, ask_all, picture, queries_of

_BLACK = np.zeros(3, np.float32)


def indirect_light(state: FrameState, surfaces: Surfaces, origins, nearest: Nearest) -> np.ndarray:
    """(H, W, 3) float32: irradiance after one bounce, estimated with one diffuse ray per pass.

    origins : (H, W, 3) float32, the receivers of the surfaces
    nearest : finds the surfaces that the rays of passes meet first

    The density of the rays is proportional to the cosine to the normal. So the irradiance is pi times the mean radiance
    of the surfaces they meet. These surfaces are diffuse; the lights alone illuminate them, with shadows. Rays that
    leave the scene contribute zero: a sky that they would meet is a light, so its light has arrived directly.

    A store traces as many passes together as memory allows, and then their shadow rays [Mattausch et al. 2015].
    """
    passes, gbuffer, ids = state.request.passes, surfaces.gbuffer, surfaces.ids.reshape(-1)
    assert passes is not None
    radiance = np.zeros((*gbuffer.face.shape, 3))
    together, shape, n_lights = state.tracer.passes_at_once, gbuffer.face.shape, len(passes.lights)
    for some in _batches(range(len(passes.directions)), together(PASS_BYTES * gbuffer.face.size)):
        rays = [diffuse_rays(gbuffer, origins, passes.directions[k], state.threads)._replace(skip=ids) for k in some]
        met = zip(some, nearest(rays, shape))
        for few in _batches(met, together((SURFACE_BYTES + LIGHT_BYTES * n_lights) * gbuffer.face.size)):
            queries = [queries_of(state, each, [of_light[k] for of_light in passes.lights]) for k, each in few]
            traced = ask_all(state, [query for of_pass in queries for query in of_pass])
            for i, (_, each) in enumerate(few):
                own = slice(i * n_lights, (i + 1) * n_lights)
                radiance += picture(state, each, TracedLights(traced.queries[own], traced.bits[own]), _BLACK)
    return (np.pi / len(passes.directions) * radiance).astype(np.float32)


def _batches(items: Iterable, n: int) -> Iterator[list]:
    """Lists of up to n items, in order."""
    rest = iter(items)
    while some := list(islice(rest, n)):
        yield some
