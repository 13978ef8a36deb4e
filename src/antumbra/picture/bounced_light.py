"""Light that bounces between surfaces before it reaches a picture's surfaces: paths of diffuse rays, with shadow rays.

Rays are traced pass by pass [Mattausch et al. 2015, Sec. 5.3]: each pass has one path of each pixel. The paths of a
pass keep the order of pixels at all bounces: those in memory are traced together, so that sorting them [Sec. 6] reads
no less, and it scatters the tiles of shadow rays.
"""

from collections.abc import Iterable, Iterator
from itertools import islice
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..query.ray_passes import diffuse_rays
from ..query.shadow_query import Surfaces
from ..trace.rays.ray_hits import Nearest
from .frame import FrameState, queries_of, shade_surfaces, trace_queries, unfiltered_light
from .frame_request import PASS_BYTES, group_bytes

_BLACK = np.zeros(3, np.float32)
_T = TypeVar("_T")


class _Paths(NamedTuple):
    """The paths of one pass, at the surfaces that they have reached."""

    number: int  # of the pass
    surfaces: Surfaces  # (H, W)
    share: NDArray[np.float32] | float  # (H, W, 3): of the light that leaves these surfaces, what arrives at the pixel


def indirect_light(state: FrameState, surfaces: Surfaces, origins: np.ndarray, nearest: Nearest) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance of bounced light, estimated with one path of diffuse rays per pixel and pass.

    origins : (H, W, 3) float32, the receivers of the surfaces
    nearest : finds the closest hits of the rays of passes

    Rays have cosine density, so the irradiance is pi times the mean radiance that arrives along them. The surfaces they
    meet are diffuse and lit by the lights, with shadows, and by further bounces. Rays that leave the scene contribute
    zero: a sky is one of the lights, so its light has already arrived directly.

    A store traces as many passes at once as memory allows, and then their shadow rays [Mattausch et al. 2015].
    """
    request, gbuffer, ids = state.request, surfaces.gbuffer, surfaces.ids.reshape(-1)
    shape, at_once = gbuffer.face.shape, state.tracer.passes_at_once
    directions, group_size = request.passes[0].directions, at_once(group_bytes(request) * gbuffer.face.size)
    radiance = np.zeros((*shape, 3))
    for batch in _batches(range(len(directions)), at_once(PASS_BYTES * gbuffer.face.size)):
        rays = [diffuse_rays(gbuffer, origins, directions[k], state.threads)._replace(skip=ids) for k in batch]
        hits = (_Paths(k, hit, 1.0) for k, hit in zip(batch, nearest(rays, shape)))
        for group in _batches(hits, group_size):
            for arriving in _along(state, group, nearest):  # one by one: sums do not depend on groups
                radiance += arriving
    return (np.pi / len(directions) * radiance).astype(np.float32)


def _along(state: FrameState, paths: list[_Paths], nearest: Nearest) -> list[NDArray[np.float64]]:
    """(H, W, 3) float64 for each pass of a group: the radiance that arrives at pixels along the paths."""
    passes = state.request.passes
    radiance = [np.zeros((*path.surfaces.ids.shape, 3)) for path in paths]
    for bounce, step in enumerate(passes):
        queries = [
            queries_of(state, path.surfaces, [of_light[path.number] for of_light in step.lights]) for path in paths
        ]
        traced = iter(trace_queries(state, [query for of_pass in queries for query in of_pass]))
        for path, of_pass, arriving in zip(paths, queries, radiance):
            light = unfiltered_light(state, path.surfaces, list(islice(traced, len(of_pass))), _BLACK)
            arriving += path.share * shade_surfaces(state, path.surfaces, light)
        if bounce + 1 < len(passes):
            origins, directions = [of_pass[0].origins for of_pass in queries], passes[bounce + 1].directions
            paths = _continued(state, paths, origins, directions, nearest)
    return radiance


def _continued(
    state: FrameState, paths: list[_Paths], origins: list[np.ndarray], directions: np.ndarray, nearest: Nearest
) -> list[_Paths]:
    """The paths at the surfaces that one more diffuse ray of each meets.

    origins : of the receivers on their surfaces
    directions : of all passes, as in `Passes`
    """
    rays, shares = [], list[NDArray[np.float32]]()
    for path, starts in zip(paths, origins):
        gbuffer, ids = path.surfaces.gbuffer, path.surfaces.ids.reshape(-1)
        rays.append(diffuse_rays(gbuffer, starts, directions[path.number], state.threads)._replace(skip=ids))
        shares.append(path.share * path.surfaces.triangles.colour[gbuffer.face])
    met = nearest(rays, paths[0].surfaces.ids.shape)
    return [_Paths(path.number, surfaces, share) for path, surfaces, share in zip(paths, met, shares)]


def _batches(items: Iterable[_T], n: int) -> Iterator[list[_T]]:
    """Lists of up to n items, in order."""
    iterator = iter(items)
    while some := list(islice(iterator, n)):
        yield some
