"""The checked request of a frame, its memory estimate, and its surfaces and shadow queries at one time sample.

The memory estimate is subtracted from the limit; the chunks of a store get the rest.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..engine.accelerator import Accelerated, Accelerator
from ..engine.frame_tracer import CELL_BYTES, FrameMemory, ray_set_count
from ..engine.plan import Plan
from ..engine.primary_visibility import primary_visibility
from ..query.gbuffer import GBuffer
from ..query.light_samples import light_samples
from ..query.pixel_refinement import FinerSamples, finer_samples
from ..query.ray_passes import Passes, diffuse_passes
from ..query.shadow_query import CULL_FACES, ShadowQuery, shadow_queries, surface_queries
from ..scene.camera import Camera
from ..scene.triangles import Triangles
from ..techniques.srdh.representative_rays import bounced_queries
from .render_options import RenderOptions
from .shading import skies_of

# --- The request of a frame: its checked arguments --------------------------------------------------------------------


class Request(NamedTuple):
    """The checked arguments of a frame, and the samples that its options ask for."""

    camera: Camera
    lights: list
    options: RenderOptions  # its time is a moment of the scene
    samples: list[np.ndarray]  # per light (16, n, 3), from `light_samples`
    finer: FinerSamples | None = None  # samples of refined pixels; None: no refinement
    passes: Passes | None = None  # passes of diffuse rays; None: no bounced light
    ground: float | None = None  # height of the ground that catches shadows, world; None: there is none
    progress: Callable | None = None

    @property
    def facing(self) -> int:
        """The value of CULL_FACES."""
        return CULL_FACES[self.options.cull_faces]

    @property
    def smooth(self) -> bool:
        """Whether the visibility of all lights is smoothed."""
        return bool(self.options.filter)

    @property
    def smooth_skies(self) -> bool:
        """Whether the light of skies is smoothed, as that of all lights is if `smooth`."""
        return self.options.filter is not False and bool(skies_of(self.lights))


def request_of(camera: Camera, lights: list, options: RenderOptions, ground: float | None = None) -> Request:
    """The request of a picture, with the samples of its lights.

    lights : checked
    ground : height of the ground, world; None: there is none
    """
    samples = [light_samples(light, options.spp, options.sampler) for light in lights]
    finer = None if options.adaptive is None else finer_samples(lights, options.adaptive, options.sampler)
    passes = None if options.bounce is None else diffuse_passes(lights, options.bounce, options.sampler)
    return Request(camera, lights, options, samples, finer, passes, ground)


def ray_counts(request: Request) -> tuple[int, int]:
    """At most so many shadow rays of the picture; and rays of bounced light, with their shadow rays."""
    pixels = request.camera.width * request.camera.height
    bounced = 0 if request.passes is None else len(request.passes.directions) * (1 + len(request.lights))
    return pixels * sum(samples.shape[1] for samples in request.samples), pixels * bounced


# --- The memory of a frame: an estimate by what is asked, so that the chunks of a store get all the rest --------------


PASS_BYTES = 48  # of a pass of diffuse rays, for each pixel: directions, hits, cells, numbers of triangles
SURFACE_BYTES = 48  # of the surfaces that a pass meets, for each pixel
LIGHT_BYTES = 44  # of a shadow query with one word of bits, and its share, for each pixel
SUBPIXELS = 16
_EDGES = 4  # every so manieth pixel is divided, as a guess
_PICTURE_BYTES = 72  # of rays, hits, surfaces, receivers, the triangles that pixels see, the image and its inputs
_BAND_BYTES = 40  # of surfaces in bands, while they are put together
_SMOOTH_BYTES = 64
_EDGE_BYTES = 40  # of smoothed edges: their boundaries, and the shares of neighbours
_FINER_BYTES = 96  # of the pixels whose penumbrae are refined
_BOUNCE_BYTES = 80


def frame_memory(request: Request) -> FrameMemory:
    """The memory of a frame."""
    pixels, bytes_ = request.camera.width * request.camera.height, _PICTURE_BYTES + _BAND_BYTES
    bytes_ += sum(LIGHT_BYTES + 16 * (-(-samples.shape[1] // 64)) for samples in request.samples)
    bytes_ += _SMOOTH_BYTES * request.smooth + PASS_BYTES * request.camera.listed
    bytes_ += _EDGE_BYTES * request.options.smooths_edges
    cells = sum(CELL_BYTES * ray_set_count(light, samples) for light, samples in zip(request.lights, request.samples))
    passes = 0
    if request.finer is not None:
        bytes_ += _FINER_BYTES * len(request.samples)
        passes = edge_bytes(len(request.lights)) // _EDGES
    if request.passes is not None:
        bytes_ += _BOUNCE_BYTES
        each = PASS_BYTES + SURFACE_BYTES + LIGHT_BYTES * len(request.lights)
        passes = max(passes, each * len(request.passes.directions))
    return FrameMemory(bytes_ * pixels, cells * pixels, passes * pixels)


def edge_bytes(lights: int) -> int:
    """The memory of the sub-pixels of a pixel."""
    return SUBPIXELS * (PASS_BYTES + SURFACE_BYTES + _PICTURE_BYTES // 2 + LIGHT_BYTES * lights)


# --- The surfaces and shadow queries of a picture at one moment, and the tree of a plan for them ----------------------


class TimeSample(NamedTuple):
    """Camera and lights at one time."""

    time: float  # seconds into the animation
    camera: Camera
    lights: list


class PictureQueries(NamedTuple):
    """The surfaces and shadow queries of a moment; they are the same for every plan."""

    source: Any  # a `RenderSource` of a store; None: the scene is in memory
    triangles: Triangles
    gbuffer: GBuffer
    lights: list
    samples: list[np.ndarray]
    queries: list[ShadowQuery]


def picture_queries(
    scene, moment: TimeSample, options: RenderOptions, threads: int, plan: Plan | None = None
) -> PictureQueries:
    """The surfaces and queries of a moment, whose lights are checked already.

    options : those of shadow rays; refinement and bounced light are left out
    plan : the plan whose tracer a store is prepared for; None: the default
    """
    request = request_of(moment.camera, moment.lights, replace(options, adaptive=None, bounce=None))
    if scene.engine.source.in_store:
        return _picture_of_store(scene, request, threads, plan)
    triangles = scene.triangles(moment.time, threads)
    gbuffer = primary_visibility(triangles, moment.camera, None, threads)
    queries = shadow_queries(triangles, gbuffer, request.lights, request.samples, request.facing, threads)
    return PictureQueries(None, triangles, gbuffer, request.lights, request.samples, queries)


def _picture_of_store(scene, request: Request, threads: int, plan: Plan | None) -> PictureQueries:
    source = scene.engine.with_options(plan, threads, None).source
    source.begin(frame_memory(request))
    surfaces = source.look(request.camera, *source.moment(0.0))
    queries = surface_queries(surfaces, request.lights, request.samples, request.facing, threads)
    return PictureQueries(source, surfaces.triangles, surfaces.gbuffer, request.lights, request.samples, queries)


def build_for(accelerator: Accelerator, picture: PictureQueries) -> Accelerated:
    """Cull and build for the queries of a picture in memory, as a frame does."""
    _, triangles, gbuffer, lights, samples, queries = picture
    bounce = bounced_queries(accelerator.showing, triangles, gbuffer, lights, samples)
    training_rays = accelerator.show(triangles, queries, bounce=bounce)
    return accelerator.build(triangles, accelerator.culled(triangles, queries), training_rays)
