"""The checked request of a frame, its memory estimate, and its surfaces and shadow queries at one time sample.

A store may use for its chunks whatever the memory estimate leaves of the limit.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..base.errors import InputError
from ..base.progress import ProgressCallback
from ..engine.accelerator import Accelerated, Accelerator
from ..engine.plan import Plan
from ..engine.primary_visibility import primary_visibility
from ..engine.scene import AnyScene
from ..engine.sources.source_protocols import CELL_BYTES, CameraView, FrameMemory, moment_of, ray_set_count
from ..query.equal_samples import traced_samples, with_distinct_samples
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.pixel_refinement import FinerSamples, finer_samples
from ..query.ray_passes import Passes, diffuse_passes, path_passes
from ..query.shadow_query import CULL_FACES, ShadowQuery, shadow_queries, surface_queries
from ..scene.camera import Camera
from ..scene.lights import Light
from ..scene.triangles import Triangles
from ..techniques.srdh.representative_rays import bounced_queries
from .render_options import RenderOptions
from .sky_background import skies_of


class Request(NamedTuple):
    """The checked arguments of a frame, and its samples."""

    camera: Camera
    lights: list[Light]
    options: RenderOptions  # with the time clamped to the scene's duration
    samples: list[np.ndarray]  # per light (16, n, 3), from `light_samples`
    finer: FinerSamples | None = None  # samples of refined pixels; None: no refinement
    passes: Sequence[Passes] = ()  # passes of diffuse rays, of each bounce; empty: no bounced light
    ground: float | None = None  # height of the shadow-catcher plane, world space; None: no plane
    progress: ProgressCallback | None = None
    frames: int = 1  # estimated number of frames from this one on

    @property
    def facing(self) -> int:
        """The value of `cull_faces` in CULL_FACES."""
        return CULL_FACES[self.options.cull_faces]

    @property
    def smooth(self) -> bool:
        """Whether to smooth the visibility of all lights."""
        return bool(self.options.filter)

    @property
    def smooth_skies(self) -> bool:
        """Whether to smooth the irradiance from skies; `smooth` includes them."""
        return self.options.filter is not False and bool(skies_of(self.lights))


def request_of(camera: Camera, lights: list[Light], options: RenderOptions, ground: float | None = None) -> Request:
    """The request of a frame, with the samples of its lights.

    lights : checked lights
    ground : height of the shadow-catcher plane, world space; None: no plane
    """
    if not options.ambient and any(light.domain == "hemisphere" for light in lights):
        raise InputError("ambient=False leaves out the ambient light that AmbientOcclusion dims; leave one of them out")
    sampler, seed = options.sampler, options.seed
    lights = [light.drawn(seed) for light in lights]
    samples = [light_samples(light, options.spp, sampler, seed) for light in lights]
    finer = None if options.adaptive is None else finer_samples(lights, options.adaptive, sampler, seed)
    return Request(camera, lights, options, samples, finer, _passes_of(lights, options), ground)


def _passes_of(lights: list[Light], options: RenderOptions) -> list[Passes]:
    """The passes of each bounce."""
    n, sampler, seed = options.bounce, options.sampler, options.seed
    if n is not None:
        first = diffuse_passes(lights, n, sampler, seed)
        return [first, *path_passes(lights, n, sampler, options.bounces, seed, 1)]
    if options.bounces > 1:
        raise InputError(f"bounces is {options.bounces}, but there are no diffuse rays; add bounce, such as bounce=16")
    return []


def ray_counts(request: Request) -> tuple[int, int]:
    """Upper bounds for the shadow rays of a frame's pixels, and for its later rays.

    Later rays are those of bounced light with their shadow rays, of refined edges, and of the ground.
    """
    pixels = request.camera.width * request.camera.height
    rays = pixels * sum(map(traced_samples, request.lights, request.samples))
    bounced = sum(len(passes.directions) * (1 + len(request.lights)) for passes in request.passes)
    others = (request.finer is not None) + (request.ground is not None)
    return rays, _grid_pixels(request) * bounced + rays * others


def _grid_pixels(request: Request) -> int:
    """The number of pixels that trace diffuse rays."""
    step = request.options.bounce_step
    return -(-request.camera.width // step) * -(-request.camera.height // step)


# --- Memory estimate --------------------------------------------------------------------------------------------------


# Bytes per pixel
PASS_BYTES = 56  # a pass of diffuse rays: directions, hits, cells, triangle indices
SURFACE_BYTES = 48  # the surfaces that a pass meets
LIGHT_BYTES = 44  # a shadow query with one word of bits, and its share
_PICTURE_BYTES = 80  # rays, hits, surfaces, receivers, visible triangles, the image and its inputs
_BAND_BYTES = 40  # surfaces of bands, while they are concatenated
_SMOOTH_BYTES = 64
_EDGE_BYTES = 40  # smoothed edges: their boundaries, and the shares of neighbours
_FINER_BYTES = 96  # refined penumbrae
_GROUND_BYTES = 64  # points on the ground, and its shares; beyond what the passes before it have freed
_GROUND_HIT_BYTES = 160  # rays to the ground, and points on it in both precisions
PATH_BYTES = 24  # the light that arrives along a path, until it is added to the pixel's
SHARE_BYTES = 12  # of the light at a hit, which arrives at the pixel
_BOUNCE_BYTES = 80

SUBPIXELS = 16
_EDGES = 4  # one pixel in four is assumed to be an edge pixel


def frame_memory(request: Request) -> FrameMemory:
    """Estimate the memory of a frame."""
    pixels, bytes_ = request.camera.width * request.camera.height, _PICTURE_BYTES + _BAND_BYTES
    words = [-(-samples.shape[1] // 64) for samples in request.samples]
    bytes_ += sum(LIGHT_BYTES + 16 * n for n in words)
    bytes_ += 0 if request.ground is None else _GROUND_BYTES + sum(4 + 8 * n for n in words)
    bytes_ += _SMOOTH_BYTES * request.smooth + PASS_BYTES * request.camera.listed
    bytes_ += _EDGE_BYTES * request.options.smooths_edges
    cells = sum(CELL_BYTES * ray_set_count(light, samples) for light, samples in zip(request.lights, request.samples))
    passes = 0
    if request.finer is not None:
        bytes_ += _FINER_BYTES * len(request.samples)
        passes = edge_bytes(request) // _EDGES
    if request.passes:
        bytes_ += _BOUNCE_BYTES
        traced = (PASS_BYTES + group_bytes(request)) * len(request.passes[0].directions) * _grid_pixels(request)
        return FrameMemory(bytes_ * pixels, cells * pixels, max(passes * pixels, traced))
    return FrameMemory(bytes_ * pixels, cells * pixels, passes * pixels)


def group_bytes(request: Request) -> int:
    """Bytes per pixel for the surfaces that a pass meets, and for what follows from there."""
    later = PASS_BYTES + SHARE_BYTES if len(request.passes) > 1 else 0
    return SURFACE_BYTES + PATH_BYTES + LIGHT_BYTES * len(request.lights) + later


def edge_bytes(request: Request) -> int:
    """Bytes for the sub-pixels of one edge pixel."""
    lights = LIGHT_BYTES * len(request.lights)
    ground = 0 if request.ground is None else _GROUND_HIT_BYTES + lights
    return SUBPIXELS * (PASS_BYTES + SURFACE_BYTES + _PICTURE_BYTES // 2 + lights + ground)


# --- Surfaces and shadow queries at one time, and the tree for them ---------------------------------------------------


class TimeSample(NamedTuple):
    """Camera and lights at one time."""

    time: float  # seconds into the animation
    camera: Camera
    lights: list[Light]


class PictureQueries(NamedTuple):
    """The surfaces and shadow queries of a time sample; they are the same for every plan."""

    source: Any  # the `RenderSource` of a store; None: the scene is in memory
    triangles: Triangles
    gbuffer: GBuffer
    lights: list[Light]
    samples: list[np.ndarray]
    queries: list[ShadowQuery]  # of one sample where all samples of a receiver are equal


def picture_queries(
    scene: AnyScene, moment: TimeSample, options: RenderOptions, threads: int, plan: Plan | None = None
) -> PictureQueries:
    """The surfaces and shadow queries of a time sample, whose lights are checked already.

    options : options of the shadow rays; refinement and bounced light are ignored
    plan : the plan for whose tracer a store is prepared; None: the default
    """
    request = request_of(moment.camera, moment.lights, replace(options, adaptive=None, bounce=None))
    if scene.engine.source.memory is not None:
        return _picture_of_store(scene, request, threads, plan)
    triangles = scene.triangles(moment.time, threads)
    gbuffer = primary_visibility(triangles, moment.camera, None, threads)
    queries = shadow_queries(triangles, gbuffer, request.lights, request.samples, request.facing, threads)
    return PictureQueries(
        None, triangles, gbuffer, request.lights, request.samples, list(map(with_distinct_samples, queries))
    )


def _picture_of_store(scene: AnyScene, request: Request, threads: int, plan: Plan | None) -> PictureQueries:
    source = scene.engine.with_options(plan, threads, None).source
    assert source.memory is not None
    source.memory.begin(frame_memory(request))
    camera, (triangles, tree) = request.camera, moment_of(source, 0.0)
    surfaces = source.look(CameraView(camera, triangles, tree, slice(0, camera.height)))
    queries = surface_queries(surfaces, request.lights, request.samples, request.facing, threads)
    return PictureQueries(
        source,
        surfaces.triangles,
        surfaces.gbuffer,
        request.lights,
        request.samples,
        list(map(with_distinct_samples, queries)),
    )


def build_for(accelerator: Accelerator, picture: PictureQueries) -> Accelerated:
    """Cull and build for the queries of a scene in memory, as a frame does."""
    _, triangles, gbuffer, lights, samples, queries = picture
    bounce = bounced_queries(accelerator.ray_selector, triangles, gbuffer, lights, samples)
    return accelerator.tree_for(triangles, queries, accelerator.sample_rays(triangles, queries, bounce=bounce))
