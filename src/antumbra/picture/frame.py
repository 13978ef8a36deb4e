"""`Frame`, the result of a `Renderer`, and the state and steps that the passes of one frame share."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.progress import PhaseClock
from ..base.wording import counted
from ..devices.device import OutOfDeviceMemory
from ..engine.auto.strategies import StrategyChoice
from ..engine.engine import Engine
from ..engine.tree_choice import TreeChoice
from ..kernels.small_matrices import dot
from ..query.equal_samples import with_distinct_samples
from ..query.gbuffer import GBuffer
from ..query.shadow_query import ShadowQuery, Surfaces, ray_count, surface_queries
from ..query.surface_links import PictureSurfaces
from ..scene.camera import Camera
from ..scene.height_tints import height_tints
from ..scene.lights import Light
from ..scene.sky import Sky
from ..scene.triangles import Triangles
from ..trace.counters import new_counters
from ..trace.transmission import TracedQuery
from .frame_request import Request
from .image_files import LUMINANCE
from .irradiance import PixelNormals, pixel_normals
from .light_visibility import irradiance_shares
from .pixel_appearance import albedo, eye_of, shading_normals, surface_points
from .pixel_materials import with_materials
from .render_options import PBR, RenderOptions
from .seen_appearance import SeenAppearance, seen_appearance
from .shading import Illumination, arriving_irradiance, shade

# --- Results: frame, layers, ground and timings -----------------------------------------------------------------------


PHASES = ("evaluate", "gbuffer", "cull", "build", "trace", "filter", "shade")


class Layers(NamedTuple):
    """The parts of a frame's image. Except at refined edges, they, ambient and emitted light add up to the image."""

    albedo: NDArray[np.float32]  # (H, W, 3) float32, linear: the base colour of the surface; 0 in the background
    lights: list[NDArray[np.float32]]  # per light (H, W, 3): the image lit by this light alone, with its shadows
    indirect: NDArray[np.float32] | None  # (H, W, 3): the image lit by bounced light alone; None without `bounce`
    object: NDArray[np.int32]  # (H, W) int32: index in `Scene.objects`; -1 in the background

    @property
    def images(self) -> list[np.ndarray]:
        """The images of single lights, and that of bounced light."""
        return self.lights if self.indirect is None else [*self.lights, self.indirect]


class Ground(NamedTuple):
    """The shadow-catcher plane, at pixels whose centre sees no surface but this plane.

    Lights are in the order of `Frame`, without those that stand for bounced light.
    """

    height: float  # along the scene's up axis, world space
    mask: NDArray[np.bool_]  # (H, W) bool: pixels whose centre sees the ground
    position: NDArray[np.float32]  # (H, W, 3) float32, recentred frame, as `GBuffer.position`; 0 elsewhere
    visibility: list[NDArray[np.float32]]  # per light (H, W) float32 in [0, 1]: share of the light seen; 1 elsewhere
    bits: list[NDArray[np.uint64]]  # per light (H, W, ceil(n / 64)) uint64: bit s = sample s occluded; 0 elsewhere
    share: NDArray[np.float32]  # (H, W, 3): light with shadows over light without, behind the surfaces; 1 elsewhere

    @property
    def lost(self) -> NDArray[np.float32]:
        """(H, W) float32: the share of the light's luminance that shadows take away; 0 where there is no shadow."""
        lost: NDArray[np.float32] = (1.0 - dot(self.share, LUMINANCE)).astype(np.float32)
        return lost


class Frame(NamedTuple):
    """A rendered frame. H, W: the camera's height and width.

    Examples
    --------
    >>> room = at.procedural("atrium", triangles=5_000)
    >>> frame = at.render(room, room.cameras[0].resized(64, 48), room.lights[0], spp=16)
    >>> in_light = frame.mask & (frame.visibility[0] == 1)  # surfaces that see the whole light
    >>> in_light.shape, frame.bits[0].shape, frame.names
    ((48, 64), (48, 64, 1), ('quad',))
    >>> frame.save("room.png")  # doctest: +SKIP
    """

    image: NDArray[np.float32]  # (H, W, 3) float32, linear
    visibility: list[NDArray[np.float32]]  # per light (H, W) in [0, 1]: share of the light seen; 1 in the background
    bits: list[NDArray[np.uint64]]  # per light (H, W, ceil(n / 64)): bit s = sample s occluded; 0 in the background
    gbuffer: GBuffer  # the surface that each pixel sees
    rays: int  # shadow rays traced, with those of bounced light; equal samples of a receiver share one
    timings: dict[str, float]  # seconds of each phase in PHASES, and "total"; compilation is never included
    counters: dict[str, int] | None  # sums over the shadow rays (see trace.counters); None unless requested
    refined: NDArray[np.bool_] | None = None  # (H, W): refined pixels in penumbrae and at edges; None unless requested
    indirect: NDArray[np.float32] | None = None  # (H, W, 3) float32: irradiance of bounced light; None unless requested
    scheduled: list[dict[str, Any]] | None = None  # CHC+RT only: statistics of each query, see `Statistics.as_dict`
    paging: dict[str, int] | None = None  # stores only: chunks read and evicted, see `store.chunk_residency.Paging`
    plan: str = ""  # the methods that ran; for the plan "auto", those that it chose
    tree: TreeChoice | None = None  # the plan "auto" only: what was built for the frame, and why
    choices: list[StrategyChoice] | None = None  # the plan "auto" only: the method of each query, and why it was chosen
    divided: NDArray[np.float32] | None = None  # (H, W): share of each pixel that shows surfaces; None: unsmoothed
    names: tuple[str, ...] = ()  # unique names of the lights: their own, or their kinds, such as "sun"
    backdrop: NDArray[np.float32] | None = None  # (H, W, 3) float32, shares of white: background of a PNG, with shadows
    layers: Layers | None = None  # the image light by light, base colours and objects; None unless requested
    ambient: NDArray[np.float32] | None = None  # (3,): ambient irradiance of surfaces that face up; 0 with `indirect`
    ground: Ground | None = None  # the shadows on the ground; None unless requested
    camera: Camera | None = None  # that of the call
    lights: tuple[Light, ...] = ()  # those of the call, as drawn for its seed
    options: RenderOptions | None = None  # those of the call, with the time clamped to the scene's duration
    seen_on: str | None = None  # the device that found the visible surfaces, such as "cuda:0"; None: the CPU

    @property
    def coverage(self) -> NDArray[np.float32]:
        """(H, W) float32: the share of each pixel that shows surfaces: 0 or 1, or between them at smoothed edges."""
        return self.mask.astype(np.float32) if self.divided is None else self.divided

    @property
    def mask(self) -> NDArray[np.bool_]:
        """(H, W) bool: whether the pixel sees a surface. Elsewhere `visibility` is 1, since nothing hides the light.

        ``np.where(frame.mask, frame.visibility[0], np.nan)`` leaves the background out of means and plots.
        """
        return self.gbuffer.face >= 0

    def save(
        self, path: str | os.PathLike[str], exposure: float | None = None, background: str | ArrayLike | None = None
    ) -> None:
        """Write the frame as ``.png`` (sRGB) or ``.exr`` (linear).

        An ``.exr`` has the channels R, G, B and A; ``shadow.NAME``, the visible share of each light; depth.Z,
        normal.X/Y/Z, position.X/Y/Z and triangle.id. A ground adds ground.R/G/B, which is `Ground.share`, and A is
        then `Ground.lost` where no surface is seen. With ``layers=True``, the frame has the further channels that the
        files of ``antumbra render`` have: ``light.NAME.R/G/B``, albedo.R/G/B, indirect.R/G/B and object.id. The
        attribute ``antumbra`` of the header has the version, the camera, the lights and the options as JSON.

        Parameters
        ----------
        path : str or path-like
            Ends in ``.png`` or ``.exr``.
        exposure : float or None
            Exposure of a PNG; None: automatic. An EXR has none.
        background : None, "transparent" or (3,) float
            Background of a PNG: an alpha channel, or an sRGB colour in [0, 1]. Render with ``background=False``.

        Raises
        ------
        InputError
            If the suffix is unknown or the path cannot be written; no partial file is left.
        """
        from .image_files import save_frame

        save_frame(self, path, exposure, background=background)

    def _repr_png_(self) -> bytes:
        """The contents of the PNG that `save` writes, for notebooks."""
        from .image_files import frame_exposure, png_bytes, screen_picture

        return png_bytes(screen_picture(self, frame_exposure(self)))

    def __repr__(self) -> str:
        height, width = self.image.shape[:2]
        lights, seconds = len(self.visibility), self.timings["total"]
        about = f"{width}x{height}, {counted(lights, 'light')}, {counted(self.rays, 'ray')}, {1000 * seconds:,.0f} ms"
        return f"Frame({about}, plan {self.plan!r}; {', '.join(self._fields)})"


# --- State of a frame, and steps that several passes share ------------------------------------------------------------


class TracedBits(NamedTuple):
    """The occlusion bits and bounced light of a picture."""

    bits: list[NDArray[np.uint64]]  # per light (H, W, words) uint64
    finer: list[NDArray[np.uint64]]  # per light (H, W, words) uint64, in refined penumbrae; empty without refinement
    edges: list[NDArray[np.uint64]]  # per light (edges, 4, 4, words) uint64: sub-pixels of edges, row by row
    indirect: NDArray[np.float32] | None  # (H, W, 3) float32, irradiance of bounced light, unfiltered


@contextmanager
def cpu_sees_if_full(engine: Engine) -> Iterator[None]:
    """End early where a device runs out of memory, so that a loop repeats it; from now on, the CPU finds surfaces.

    If it does so already, the error is raised. Its memory is free once this context has ended.
    """
    try:
        yield
    except OutOfDeviceMemory:
        if not engine.source.see_on_cpu():
            raise


class FrameState:
    """The state of one frame during rendering.

    tracer : FrameTracer
        The engine's tracer.
    request : Request
    clock : PhaseClock
        Each pass adds its seconds.
    tally : (n,) int64 or None
        Counters, if requested.
    rays : int
        Shadow rays traced so far.
    known : TracedBits or None
        The results of all rays, if they were traced before.
    """

    def __init__(self, engine: Engine, request: Request, known: TracedBits | None = None):
        self.tracer, self.request = engine.frame_tracer(), request
        self.clock, self.threads, self.rays = PhaseClock(*PHASES), engine.threads, 0
        self.tally = new_counters() if request.options.counters else None
        self.known = known
        self._seen: tuple[Triangles, SeenAppearance | None] | None = None

    def appearance_of(self, triangles: Triangles) -> SeenAppearance | None:
        """The appearance of triangles that pixels see, as `seen_appearance`; the last one is kept."""
        if self._seen is None or self._seen[0] is not triangles:
            tracer = self.tracer
            found = seen_appearance(tracer.scene, tracer.memory, triangles, self.request.options, self.threads)
            self._seen = triangles, found
        return self._seen[1]


def queries_of(state: FrameState, surfaces: Surfaces, samples: list[np.ndarray]) -> list[ShadowQuery]:
    """One query per light at these surfaces; `samples`: for each light, as from `light_samples`."""
    return surface_queries(surfaces, state.request.lights, samples, state.request.facing, state.threads)


def trace_query(state: FrameState, query: ShadowQuery) -> TracedQuery:
    """Trace a query."""
    return trace_queries(state, [query])[0]


def trace_queries(state: FrameState, queries: list[ShadowQuery]) -> list[TracedQuery]:
    """Trace several queries of pictures of the same shape."""
    tracer, request = state.tracer, state.request
    return with_known_bits(
        state, queries, tracer.accelerator.answer_all(tracer.tree, queries, state.tally, request.progress)
    )


def with_known_bits(state: FrameState, queries: list[ShadowQuery], bits: list[np.ndarray]) -> list[TracedQuery]:
    """Pair queries with their answers, and count their rays."""
    state.rays += sum(ray_count(with_distinct_samples(query)) for query in queries)
    return [state.tracer.traced_query(*each) for each in zip(queries, bits)]


def arriving_light(
    state: FrameState, surfaces: Surfaces, traced: list[TracedQuery], visible: PictureSurfaces | None = None
) -> list[np.ndarray]:
    """The irradiance from each light at each pixel's surface; see `picture.shading.arriving_irradiance`.

    visible : the visible surfaces, for lights whose irradiance is smoothed; None: no smoothing
    """
    request = state.request
    return [
        arriving_irradiance(
            surfaces.gbuffer,
            light,
            each,
            visible if smooths_light(request, light) else None,
            surfaces.shading,
            state.threads,
        )
        for light, each in zip(request.lights, traced)
    ]


def smooths_light(request: Request, light: Light) -> bool:
    """Whether to smooth the irradiance from a list of lights."""
    return request.smooth or (request.smooth_skies and isinstance(light, Sky))


def surface_facing(surfaces: Surfaces) -> PixelNormals:
    """The normals of these surfaces."""
    return pixel_normals(surfaces.gbuffer, surfaces.shading)


def shade_surfaces(state: FrameState, surfaces: Surfaces, illumination: Illumination) -> NDArray[np.float32]:
    """Shade these surfaces as diffuse ones: (H, W, 3) float32."""
    return shade(*shading_inputs(surfaces), illumination, state.tracer.scene.up, state.threads)


def shading_inputs(surfaces: Surfaces) -> tuple[GBuffer, np.ndarray]:
    """A G-buffer with shading normals, and the colours ((m, 3) float32) that its faces index, for `shade`.

    With textures, each pixel has its own colour.
    """
    gbuffer, albedo = surfaces.gbuffer, surfaces.albedo
    if surfaces.shading is not None:
        gbuffer = gbuffer._replace(normal=surfaces.shading.normal)
    if albedo is None:
        return gbuffer, surfaces.triangles.colour
    pixel_ids = np.arange(gbuffer.face.size, dtype=np.int32).reshape(gbuffer.face.shape)
    return gbuffer._replace(face=np.where(surfaces.ids >= 0, pixel_ids, np.int32(-1))), albedo.reshape(-1, 3)


def with_appearance(state: FrameState, surfaces: Surfaces, parts: int = 1) -> Surfaces:
    """Add base colours, shading normals and materials of pixels, if the scene has any.

    parts : sub-pixels along a side of a pixel
    """
    scene, request = state.tracer.scene, state.request
    seen = state.appearance_of(surfaces.triangles)
    if seen is None:
        if request.options.textures and request.options.materials == PBR:
            tints = height_tints(scene, surfaces.gbuffer.position)
            if tints is not None:
                surfaces = surfaces._replace(albedo=np.where(surfaces.ids[..., None] >= 0, tints, np.float32(0.0)))
        return surfaces
    appearance, places = seen.appearance, surface_points(surfaces, seen.of_pixels(surfaces))
    if request.options.textures and seen.is_varied:
        eye = eye_of(state.tracer.view, parts)
        surfaces = surfaces._replace(albedo=albedo(places, surfaces.triangles.colour, appearance, eye, state.threads))
    if request.options.smooth_normals and appearance.normals is not None:
        surfaces = surfaces._replace(shading=shading_normals(places, appearance, state.threads))
    if request.options.materials == PBR and appearance.pbr is not None:
        surfaces = with_materials(surfaces, places, appearance, eye_of(state.tracer.view, parts), state.threads)
    state.clock.lap("shade")
    return surfaces


def unfiltered_light(
    state: FrameState,
    surfaces: Surfaces,
    traced: list[TracedQuery],
    ambient: np.ndarray,
    indirect: np.ndarray | None = None,
) -> Illumination:
    """The light that reaches these surfaces, from unfiltered bits. The arguments are those of `Illumination`."""
    facing = surface_facing(surfaces)
    shares = [irradiance_shares(facing, each, state.threads) for each in traced]
    return Illumination(state.request.lights, arriving_light(state, surfaces, traced), shares, ambient, indirect)


def edge_colours(state: FrameState) -> NDArray[np.float32]:
    """(n, 3) float32: colours of faces for finding edges; all faces of a textured material have the same colour."""
    triangles = state.tracer.triangles
    colour, seen = triangles.colour, state.appearance_of(triangles)
    if seen is None or not state.request.options.textures:
        return colour
    appearance, rows = seen.appearance, seen.rows(triangles)
    factors = np.array([material.factor[:3] for material in appearance.materials], np.float32)
    materials = appearance.material_of_face[rows]
    varied = appearance.textured[rows] | (appearance.colours is not None)
    return np.where((varied & (materials >= 0))[:, None], factors[materials], colour)
