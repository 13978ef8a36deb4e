"""The state of a frame during rendering, and the steps that several passes share: trace, accelerate, shade."""

from typing import NamedTuple

import numpy as np

from ..engine.engine import Engine
from ..picture.irradiance import Facing, facing_of
from ..picture.light_visibility import irradiance_shares
from ..picture.pixel_appearance import albedo, eye_of, places_of, shading_normals
from ..picture.shading import arriving_irradiance, shade
from ..query.gbuffer import GBuffer
from ..query.shadow_query import ShadowQuery, Surfaces, ray_count, surface_queries
from ..scene.lights import Light
from ..scene.sky import Sky
from ..trace.counters import new_counters
from .frame import Clock
from .request import Request


class TracedLights(NamedTuple):
    """The queries of all lights, and their bits."""

    queries: list[ShadowQuery]  # one per light
    bits: list[np.ndarray]  # per light (H, W, ceil(n / 64)) uint64


class KeptRows(NamedTuple):
    """What the rays of a picture found."""

    bits: list[np.ndarray]  # per light (H, W, words) uint64
    finer: list[np.ndarray]  # per light (H, W, words) uint64, of refined penumbrae; empty without refinement
    edges: list[np.ndarray]  # per light (edges, 4, 4, words) uint64, of the sub-pixels of edges, row by row
    indirect: np.ndarray | None  # (H, W, 3) float32, irradiance after one bounce, unfiltered


class FrameState:
    """The state of one frame during rendering.

    tracer : FrameTracer
        Of the engine.
    request : Request
    clock : Clock
        Each pass adds its seconds.
    tally : (n,) int64 or None
        Counters, if requested.
    rays : int
        Shadow rays traced so far.
    kept : KeptRows or None
        What the rays found, if all of them were traced before.
    """

    def __init__(self, engine: Engine, request: Request, kept: KeptRows | None = None):
        self.tracer, self.request = engine.frame_tracer(), request
        self.clock, self.threads, self.rays = Clock(), engine.threads, 0
        self.tally = new_counters() if request.options.counters else None
        self.kept = kept


def queries_of(state: FrameState, surfaces: Surfaces, samples) -> list[ShadowQuery]:
    """One query per light at these surfaces, with the given samples of each light."""
    return surface_queries(surfaces, state.request.lights, samples, state.request.facing, state.threads)


def ask(state: FrameState, query: ShadowQuery) -> np.ndarray:
    """Trace a query: (h, w, ceil(n / 64)) uint64."""
    return ask_all(state, [query]).bits[0]


def ask_all(state: FrameState, queries: list[ShadowQuery]) -> TracedLights:
    """Trace several queries of pictures of the same shape."""
    return traced_before(state, queries, state.tracer.trace(queries, state.tally, state.request.progress))


def traced_before(state: FrameState, queries: list[ShadowQuery], bits: list[np.ndarray]) -> TracedLights:
    """Queries whose bits are known. Their rays are counted."""
    state.rays += sum(ray_count(query) for query in queries)
    return TracedLights(queries, bits)


def arriving_at(state: FrameState, surfaces: Surfaces, traced: TracedLights, seen=None) -> list[np.ndarray]:
    """The light that each light source sends to each pixel's surface; see `picture.shading.arriving_irradiance`.

    seen : the surfaces, for lights whose irradiance is smoothed; None: nothing is smoothed
    """
    request = state.request
    return [
        arriving_irradiance(
            surfaces.gbuffer, light, query, b, seen if smooths(request, light) else None, surfaces.shading,
            state.threads,
        )
        for light, query, b in zip(request.lights, *traced)
    ]  # fmt: skip


def smooths(request: Request, light: Light) -> bool:
    """Whether the irradiance from a list of lights is smoothed."""
    return request.smooth or (request.smooth_skies and isinstance(light, Sky))


def facing_at(surfaces: Surfaces) -> Facing:
    """The normals of these surfaces."""
    return facing_of(surfaces.gbuffer, surfaces.shading)


def shaded(state: FrameState, surfaces: Surfaces, arrived, shares_of, ambient, indirect=None) -> np.ndarray:
    """The shaded image of these surfaces, (H, W, 3) float32."""
    up, lights = state.tracer.scene.up, state.request.lights
    return shade(*coloured(surfaces), lights, arrived, shares_of, ambient, up, indirect, state.threads)


def coloured(surfaces: Surfaces) -> tuple[GBuffer, np.ndarray]:
    """A G-buffer with shading normals, and the colours ((m, 3) float32) that its faces index, for `shade`.

    With textures each pixel has a colour of its own.
    """
    gbuffer, albedo = surfaces.gbuffer, surfaces.albedo
    if surfaces.shading is not None:
        gbuffer = gbuffer._replace(normal=surfaces.shading.normal)
    if albedo is None:
        return gbuffer, surfaces.triangles.colour
    own = np.arange(gbuffer.face.size, dtype=np.int32).reshape(gbuffer.face.shape)
    return gbuffer._replace(face=np.where(surfaces.ids >= 0, own, np.int32(-1))), albedo.reshape(-1, 3)


def dressed(state: FrameState, surfaces: Surfaces, parts: int = 1) -> Surfaces:
    """The surfaces with the base colours and normals that pixels see, if the scene has textures or smooth normals.

    parts : sub-pixels along a side of a pixel
    """
    appearance, request = state.tracer.scene.appearance, state.request
    if appearance is None:
        return surfaces
    places = places_of(surfaces)
    if request.options.textures and (appearance.textured.any() or appearance.colours is not None):
        eye = eye_of(state.tracer.view, parts)
        surfaces = surfaces._replace(albedo=albedo(places, surfaces.triangles.colour, appearance, eye, state.threads))
    if request.options.smooth_normals and appearance.normals is not None:
        surfaces = surfaces._replace(shading=shading_normals(places, appearance, state.threads))
    state.clock.lap("shade")
    return surfaces


def picture(state: FrameState, surfaces: Surfaces, traced: TracedLights, ambient, indirect=None) -> np.ndarray:
    """The image of these surfaces, (H, W, 3) float32, shaded with unfiltered bits."""
    facing = facing_at(surfaces)
    shown = [irradiance_shares(facing, query, bits, state.threads) for query, bits in zip(*traced)]
    return shaded(state, surfaces, arriving_at(state, surfaces, traced), shown, ambient, indirect)


def edge_colours(state: FrameState) -> np.ndarray:
    """(n, 3) float32: colours of faces that differ at edges; the faces of a texture all have the same."""
    colour, appearance = state.tracer.triangles.colour, state.tracer.scene.appearance
    if appearance is None or not state.request.options.textures:
        return colour
    factors = np.array([material.factor[:3] for material in appearance.materials], np.float32)
    own = appearance.material_of_face[state.tracer.triangles.face_id]
    varied = appearance.textured[state.tracer.triangles.face_id] | (appearance.colours is not None)
    return np.where((varied & (own >= 0))[:, None], factors[own], colour)
