"""Shading by the metallic-roughness model of glTF: GGX lobes, mirrored skies and emitted light.

Pixels without a lobe stay as `picture.shading` shades them. In the others:

- Each light that is not a list has a lobe: the mean over the samples that the pixel sees, times the light that arrives.
- Skies light the diffuse part through their lights. In the mirror direction, they are blurred by roughness, and seen to
  the share of `MIRROR_RAYS` exact rays in a cone as wide as the lobe.
- Where the mirrored sky is hidden, the lobe mirrors grey surfaces in the mean light of the picture, without rays.
- Ambient and bounced light reach the diffuse part. Further lists of lights arrive as if from all sides.
- Occlusion maps dim light that is not traced: ambient, bounced and grey.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..query.light_samples import sample_sets
from ..query.receivers import NOTHING
from ..query.shadow_query import (
    ShadowQuery,
    Surfaces,
    below_horizon,
    fraction_lit,
    surface_queries,
)
from ..query.surface_links import PictureSurfaces
from ..scene.lights import AmbientOcclusion, Light
from ..scene.rough_mirrors import ROUGHNESSES, mirror_cone
from ..scene.sky import Sky
from ..trace.transmission import TracedQuery, lit_fraction
from .discontinuity_filter import smooth_irradiance
from .frame import FrameState, shading_inputs, trace_queries
from .ggx import DIELECTRIC, LobePoints, alpha_of, mean_lobes, uniform_lobes
from .pixel_appearance import eye_of
from .shading import AMBIENT, Illumination, shade
from .sky_background import skies_of

MIRROR_RAYS = 4
"""Rays of a pixel to the mirrored sky; one at the smallest roughness."""

_PI, _GREY = np.float32(np.pi), np.float32(0.5)
_WHITE = np.ones((1, 3), np.float32)


class _Mirrored(NamedTuple):
    """What pixels with a lobe mirror of the skies."""

    seen: NDArray[np.float32]  # (n, 1): the visible share
    radiance: list[NDArray[np.float32]]  # of each sky (n, 3)


class MaterialShading:
    """Shades the pixels of surfaces that have materials.

    Parameters
    ----------
    state : FrameState
    surfaces : Surfaces
        With `materials`.
    traced : list of TracedQuery
        The query of each light and its answer.
    visible : PictureSurfaces or None
        For smoothing over 4 x 4 pixels; None: no smoothing.
    parts : int
        Sub-pixels along a side of a pixel.
    """

    def __init__(
        self,
        state: FrameState,
        surfaces: Surfaces,
        traced: Sequence[TracedQuery],
        visible: PictureSurfaces | None = None,
        parts: int = 1,
    ) -> None:
        materials = surfaces.materials
        assert materials is not None
        self._state, self._surfaces, self._traced, self._materials = state, surfaces, traced, materials
        gbuffer, colour = shading_inputs(surfaces)
        self._at, rows = np.flatnonzero(materials.lobe & (surfaces.ids >= 0)), self._rows
        towards = np.array(eye_of(state.tracer.view, parts)[:3]) - rows(gbuffer.position)
        view = (towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-30)).astype(np.float32)
        self._roughness = rows(materials.roughness)
        self._points = LobePoints(self._at, rows(gbuffer.normal), view, alpha_of(self._roughness))
        base, metallic = colour[rows(gbuffer.face)], rows(materials.metallic)[:, None]
        self._f0 = DIELECTRIC + metallic * (base - DIELECTRIC)
        self._diffuse = base * (np.float32(1.0) - metallic) * (np.float32(1.0) - self._f0)
        occlusion = materials.occlusion
        self._unoccluded = np.ones((1, 1), np.float32) if occlusion is None else rows(occlusion)[:, None]
        self._gbuffer = gbuffer
        self._lobes: dict[int, NDArray[np.float32]] = {}  # of lights, by their number
        self._around = uniform_lobes(self._points, self._roughness)
        self._mirrored = self._mirror(visible) if len(self._at) and skies_of(state.request.lights) else None

    def shade(
        self, image: NDArray[np.float32], numbers: Sequence[int], light: Illumination, fill: NDArray[np.float32]
    ) -> None:
        """Write the pixels with a lobe to an image, (H, W, 3) float32.

        numbers : of the lights, in the request
        fill : (3,) float32, `ambient_light` of the picture, also if bounced light replaces it
        """
        if not len(self._at):
            return
        out = self._ambient(light) * (self._diffuse * self._around[:, 2:])
        mirrored = self._unoccluded * (fill * (_GREY / (np.float32(AMBIENT) * _PI)))
        if self._mirrored is not None:
            mirrored = mirrored * (np.float32(1.0) - self._mirrored.seen)
        for k, each, arrived, share in zip(numbers, light.lights, light.arrived, light.shares):
            if isinstance(each, Sky):
                out += self._rows(arrived) / _PI * (self._diffuse * self._around[:, 2:])
                mirrored = mirrored + self._sky(k)
            elif each.domain == "list":
                radiance = self._rows(arrived) / _PI
                out += radiance * (self._diffuse * self._around[:, 2:])
                mirrored = mirrored + radiance
            elif each.domain != "hemisphere":
                out += self._direct(k, each, arrived, share)
        lobe, edge = self._around[:, :1], self._around[:, 1:2]
        out += mirrored * (self._f0 * (lobe - edge) + edge)
        image.reshape(-1, 3)[self._at] = out

    def emit(self, image: NDArray[np.float32]) -> None:
        """Add the light that surfaces emit to an image."""
        if self._materials.emission is not None:
            image += np.where(self._surfaces.ids[..., None] >= 0, self._materials.emission, np.float32(0.0))

    def _rows(self, image: np.ndarray) -> np.ndarray:
        """(n, ...): the values of an image, (H, W, ...), at the pixels with a lobe."""
        return np.take(image.reshape(image.shape[0] * image.shape[1], *image.shape[2:]), self._at, axis=0)

    def _ambient(self, light: Illumination) -> NDArray[np.float32]:
        """(n, 3): ambient and bounced light over pi, dimmed by occlusion maps."""
        open_skies = [k for k, each in enumerate(light.lights) if each.domain == "hemisphere"]
        gbuffer = self._gbuffer._replace(face=np.where(self._surfaces.ids >= 0, np.int32(0), np.int32(-1)))
        rest, up = light.only(open_skies), self._state.tracer.scene.up
        around: NDArray[np.float32] = self._rows(shade(gbuffer, _WHITE, rest, up, self._state.threads))
        return around * self._unoccluded

    def _direct(self, k: int, light: Light, arrived: np.ndarray, share: np.ndarray) -> NDArray[np.float32]:
        """(n, 3): the light of a light that is no list, reflected."""
        if k not in self._lobes:
            self._lobes[k] = mean_lobes(self._points, self._traced[k], self._state.threads)
        tint = np.asarray(light.intensity * np.asarray(light.colour), np.float32)
        share = self._rows(share)
        irradiance = self._rows(arrived)[:, None] * (share if share.ndim == 2 else share[:, None]) * tint
        lobe, edge, grazing = (self._lobes[k][:, c, None] for c in range(3))
        diffuse = self._diffuse * ((np.float32(1.0) - grazing) / _PI)
        reflected: NDArray[np.float32] = irradiance * (diffuse + self._f0 * (lobe - edge) + edge)
        return reflected

    # --- Skies in the mirror direction --------------------------------------------------------------------------------

    def _sky(self, k: int) -> NDArray[np.float32]:
        """(n, 3): the visible radiance of sky k in the mirror direction."""
        assert self._mirrored is not None
        skies = [i for i, light in enumerate(self._state.request.lights) if isinstance(light, Sky)]
        return self._mirrored.radiance[skies.index(k)] * self._mirrored.seen

    def _mirror(self, visible: PictureSurfaces | None) -> _Mirrored:
        """Trace the rays to the mirrored sky, and look up its radiance."""
        n, v = self._points.normal, self._points.view
        directions = 2.0 * (n * v).sum(1, dtype=np.float64)[:, None] * n - v
        directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-30)
        level = self._roughness * np.float32(len(ROUGHNESSES) - 1)
        seen = np.ones(len(n), np.float32)
        nearest = np.rint(level).astype(np.int64)
        levels = np.unique(nearest).tolist()
        queries = self._queries(directions, nearest, levels)
        self._state.tracer.prepare_again(queries, self._state.clock.lap)
        for k, traced in zip(levels, trace_queries(self._state, queries)):
            fraction = self._visible_share(traced, visible)
            seen[nearest == k] = self._rows(fraction)[nearest == k]
        self._state.clock.lap("trace")
        radiance = [_blurred_radiance(sky, directions, level) for sky in skies_of(self._state.request.lights)]
        return _Mirrored(seen[:, None], radiance)

    def _queries(self, directions: np.ndarray, nearest: np.ndarray, levels: list[int]) -> list[ShadowQuery]:
        """A query of each roughness: hemispheres around the mirror directions, of which a cone is sampled."""
        request, shape = self._state.request, self._surfaces.ids.shape
        samples = []
        for k in levels:
            square = sample_sets(MIRROR_RAYS if k else 1, request.options.sampler, request.options.seed)[..., :2]
            samples.append(mirror_cone(ROUGHNESSES[k], square if k else np.zeros_like(square)))
        lights = [AmbientOcclusion()] * len(levels)
        queries = surface_queries(self._surfaces, lights, samples, request.facing, self._state.threads)
        normals = queries[0].normals.copy()
        normals.reshape(-1, 3)[self._at] = directions
        out = []
        for k, query in zip(levels, queries):
            chosen = np.zeros(shape, np.bool_)
            chosen.reshape(-1)[self._at[nearest == k]] = True
            out.append(query._replace(normals=normals, sides=np.where(chosen, query.sides, np.int8(NOTHING))))
        return out

    def _visible_share(self, traced: TracedQuery, visible: PictureSurfaces | None) -> NDArray[np.float32]:
        """(H, W) float32: the share of the rays above the surface that reach the sky; 0 if there is none.

        It is smoothed where there are several rays.
        """
        query, threads = traced.query, self._state.threads
        below = below_horizon(query, threads)
        above = fraction_lit(below, traced.spp, threads)
        lit = lit_fraction(traced._replace(bits=traced.bits | below), threads)
        if visible is not None and traced.spp > 1:
            image = np.stack([lit, above, above], -1)
            lit, above, _ = np.moveaxis(smooth_irradiance(visible.with_side(query.sides), image, threads), -1, 0)
        return np.divide(lit, above, out=np.zeros_like(lit), where=above > 0.0)


def _blurred_radiance(sky: Sky, directions: NDArray[np.float64], level: NDArray[np.float32]) -> NDArray[np.float32]:
    """(n, 3) float32: a sky along directions, as surfaces mirror it; level: roughness in steps of `ROUGHNESSES`."""
    out = np.zeros((len(directions), 3), np.float32)
    for k, blurred in enumerate(sky.blurred):
        weight = np.float32(1.0) - np.abs(level - np.float32(k))
        rows = np.flatnonzero(weight > 0.0)
        if len(rows):
            out[rows] += weight[rows, None] * blurred.radiance(directions[rows].astype(np.float32))
    return out
