"""The shadow catcher: an invisible ground plane that shows only the shadows cast on it, also called a *matte*.

The plane is not geometry. Its points are the receivers of additional queries, which the frame's tracer answers, so
trees and the bits of surfaces do not change, and the plane blocks no ray.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..query.gbuffer import GBuffer
from ..query.pixel_refinement import block_means, subpixel_rays
from ..query.query_bounds import place, reach_of
from ..query.ray_passes import GroundHits, ground_hits, plane_below, rays_through
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, Surfaces, below_horizon
from ..query.surface_links import PictureSurfaces, picture_surfaces
from ..scene.light_lists import LightList
from ..scene.lights import DIRECTIONAL, Light, is_indirect
from ..techniques.culling.culling_grid import targets_of
from ..trace.transmission import TracedQuery
from .discontinuity_filter import smooth_irradiance
from .frame import FrameState, Ground, smooths_light, trace_queries, trace_query
from .irradiance import pixel_normals
from .light_visibility import finer_query, irradiance_shares, light_fractions, refine_fractions
from .shading import Illumination, arriving_irradiance, shade

_WHITE = np.ones((1, 3), np.float32)


class ShadowCatcher:
    """The shadow-catcher plane of a frame.

    Parameters
    ----------
    state : FrameState
        Its request must have a ground.
    ambient : (3,) float32
        Ambient irradiance of surfaces that face up. It also stands for bounced light, which the plane ignores.
    """

    def __init__(self, state: FrameState, ambient: np.ndarray) -> None:
        height = state.request.ground
        assert height is not None
        up, origin = state.tracer.scene.up, state.tracer.triangles.origin
        self._state, self._ambient, self._up, self._height = state, ambient, up, height
        self._box = state.tracer.box()
        self._plane = plane_below(self._box, up, height - origin["xyz".index(up)])
        self._chosen = [k for k, light in enumerate(state.request.lights) if not is_indirect(light)]
        self._lights = [state.request.lights[k] for k in self._chosen]

    def ground(self, surfaces: Surfaces) -> Ground:
        """The ground at pixels whose centre sees no surface."""
        state, request = self._state, self._state.request
        free = surfaces.ids < 0
        rays = rays_through(state.tracer.view, free, state.threads)
        hits = ground_hits(self._plane, rays, free, surfaces.gbuffer.origin, state.threads)
        gbuffer = hits.gbuffer
        state.clock.lap("gbuffer")
        queries = self._queries(hits, request.samples)
        finer = [] if request.finer is None else [request.finer.penumbra[k] for k in self._chosen]
        finest = [q._replace(samples=s) for q, s in zip(queries, finer)]
        state.tracer.prepare_again([*queries, *finest], state.clock.lap)
        traced = trace_queries(state, queries)
        state.clock.lap("trace")
        visible, facing = picture_surfaces(gbuffer, state.tracer.view), pixel_normals(gbuffer, None)
        fractions = [light_fractions(visible, facing, each, request.smooth, state.threads) for each in traced]
        state.clock.lap("filter")
        for i, (each, samples) in enumerate(zip(traced, finer)):
            more = trace_query(state, finer_query(visible, each, samples, state.threads))
            fractions[i] = refine_fractions(fractions[i], visible, facing, more, request.smooth, state.threads)
            state.clock.lap("trace")
        visibility = [one.fraction for one in fractions]
        lit, unshadowed = self._irradiances(gbuffer, traced, [one.share for one in fractions], visible)
        share = np.float32(1.0) - hits.kept[..., None] * (np.float32(1.0) - _ratio(lit, unshadowed))
        state.clock.lap("shade")
        bits = [each.bits for each in traced]
        return Ground(self._height, gbuffer.side != NOTHING, gbuffer.position, visibility, bits, share)

    def edge_shares(self, edge: np.ndarray, pixels: Surfaces) -> NDArray[np.float32]:
        """(E, 3) float32: `Ground.share` of edge pixels, where they see no surface; `pixels`: their sub-pixels."""
        state, finer = self._state, self._state.request.finer
        assert finer is not None
        count = int(np.count_nonzero(edge))
        rays, shape = subpixel_rays(state.tracer.view, edge, state.threads)
        free = (pixels.ids < 0) & rays.directions.any(-1).reshape(shape)
        rays = type(rays)(*(part[free.reshape(-1)] for part in rays))
        hits = ground_hits(self._plane, rays, free, pixels.gbuffer.origin, state.threads)
        state.clock.lap("gbuffer")
        queries = self._queries(hits, finer.edges)
        state.tracer.prepare_again(queries, state.clock.lap)
        traced = trace_queries(state, queries)
        state.clock.lap("trace")
        facing = pixel_normals(hits.gbuffer, None)
        shares = [irradiance_shares(facing, each, state.threads) for each in traced]
        lit, unshadowed = (block_means(part, count) for part in self._irradiances(hits.gbuffer, traced, shares, None))
        strength = block_means(hits.kept, count) / np.maximum(
            block_means(free.astype(np.float32), count), np.float32(1e-6)
        )
        share: np.ndarray = np.float32(1.0) - strength[:, None] * (np.float32(1.0) - _ratio(lit, unshadowed))
        return share

    def _queries(self, hits: GroundHits, samples: list[np.ndarray]) -> list[ShadowQuery]:
        """A query per light at the points of the ground; `samples`: for all lights of the request."""
        state, (gbuffer, origins, _) = self._state, hits
        points = origins[gbuffer.side != NOTHING]
        reach = reach_of(self._box, points, state.threads) if len(points) else 1.0
        normals = gbuffer.normal.astype(np.float64)
        patches = [place(light, state.tracer.triangles.origin, self._box, reach) for light in self._lights]
        return [
            ShadowQuery(
                origins=origins,
                faces=gbuffer.face,
                sides=gbuffer.side,
                normals=normals,
                corners=np.empty((0, 9), np.float32),  # the ground has no faces
                light=patch,
                samples=samples[k],
                cull_faces=state.request.facing,
                ids=gbuffer.face,
            )
            for k, patch in zip(self._chosen, patches)
        ]

    def _irradiances(
        self, gbuffer: GBuffer, traced: list[TracedQuery], shares: list[np.ndarray], visible: PictureSurfaces | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The light of all lights that arrives, (H, W, 3) float32, and the light that would arrive without shadows."""
        arrived, unshadowed = zip(
            *(self._irradiance(gbuffer, light, each, visible) for light, each in zip(self._lights, traced))
        )
        above = [self._unshadowed_shares(gbuffer, light, each.query) for light, each in zip(self._lights, traced)]
        return self._shade(gbuffer, arrived, shares), self._shade(gbuffer, unshadowed, above)

    def _irradiance(
        self, gbuffer: GBuffer, light: Light, traced: TracedQuery, visible: PictureSurfaces | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """The irradiance from one light, as from `arriving_irradiance`, and the irradiance without shadows."""
        threads = self._state.threads
        if not smooths_light(self._state.request, light):
            visible = None
        if traced.query.light.kind == DIRECTIONAL and isinstance(light, LightList):
            return self._distant_irradiance(gbuffer, light, traced, visible)
        arrived = arriving_irradiance(gbuffer, light, traced, visible, None, threads)
        if light.domain != "list":
            return arrived, arrived
        return arrived, arriving_irradiance(gbuffer, light, _unshadowed(traced), visible, None, threads)

    def _distant_irradiance(
        self,
        gbuffer: GBuffer,
        light: LightList,
        traced: TracedQuery,
        visible: PictureSurfaces | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """`_irradiance` for a list of distant lights. Without shadows, all blocks of 4 x 4 pixels are equal.

        The light that shadows take away is smoothed, rather than the light that remains, so that nothing changes away
        from shadows.
        """
        (h, w), threads = gbuffer.side.shape, self._state.threads
        one = np.ones((4, 4), np.int8)
        normal = np.zeros((4, 4, 3), np.float32)
        normal[..., self._plane.axis] = 1.0
        block = GBuffer(
            np.zeros_like(normal), normal, one.astype(np.int32), one.astype(np.float32), one, gbuffer.origin
        )
        no_bits = np.zeros((4, 4, traced.bits.shape[-1]), np.uint64)
        irradiance = arriving_irradiance(block, light, TracedQuery(traced.query, no_bits), None, None, threads)
        unshadowed = np.tile(irradiance, (-(-h // 4), -(-w // 4), 1))[:h, :w]
        arrived = arriving_irradiance(gbuffer, light, traced, None, None, threads)
        if visible is None or not light.interleave:
            return arrived, unshadowed
        mean = irradiance.mean((0, 1))
        return mean - smooth_irradiance(visible, unshadowed - arrived, threads), np.ascontiguousarray(
            np.broadcast_to(mean, arrived.shape)
        )

    def _shade(self, gbuffer: GBuffer, arrived: Sequence[np.ndarray], shares: list[np.ndarray]) -> np.ndarray:
        """Shade the ground as a white surface."""
        white = gbuffer._replace(face=gbuffer.side.astype(np.int32) - np.int32(1))  # face 0 where the ground is seen
        illumination = Illumination(self._lights, arrived, shares, self._ambient)
        return shade(white, _WHITE, illumination, self._up, self._state.threads)

    def _unshadowed_shares(self, gbuffer: GBuffer, light: Light, query: ShadowQuery) -> NDArray[np.float32]:
        """(H, W) float32: the share of a light's irradiance that arrives without shadows: its part above the ground."""
        boxes, relative = targets_of(query, np.full(3, np.inf))
        lowest = boxes[:, 0, self._plane.axis].min()
        if light.domain in ("list", "hemisphere") or lowest > (0.0 if relative else self._plane.height):
            return np.ones(query.sides.shape, np.float32)
        below = below_horizon(query, self._state.threads)
        return irradiance_shares(pixel_normals(gbuffer, None), TracedQuery(query, below), self._state.threads)


def _unshadowed(traced: TracedQuery) -> TracedQuery:
    """The query, with all light."""
    return TracedQuery(traced.query, np.zeros_like(traced.bits))


def _ratio(lit: np.ndarray, unshadowed: np.ndarray) -> np.ndarray:
    """Light over the light without shadows, at most 1; 1 where there is no light."""
    share = np.divide(lit, unshadowed, out=np.ones_like(lit), where=unshadowed > 0.0)
    ratio: np.ndarray = np.minimum(share, np.float32(1.0))
    return ratio
