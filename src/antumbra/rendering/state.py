"""One frame while it is made, and the steps that several of its passes take: ask, accelerate, shade."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..image.shade import arriving, shade
from ..query.diffuse import Passes
from ..query.picture import Surfaces, surface_queries
from ..query.receivers import NOTHING
from ..query.refine import FinerSamples
from ..query.shadow import ShadowQuery, fraction_lit
from ..scene.camera import Camera, CameraRays
from ..scene.triangles import Triangles
from ..trace.counters import new_counters
from .accelerate import Accelerated, Accelerator
from .frame import Clock
from .source import RenderSource
from .srdh_rays import Shown


class Request(NamedTuple):
    """What a frame is asked for, checked."""

    camera: Camera
    lights: list
    samples: list[np.ndarray]  # of each light, from `light_samples`
    facing: int = 0  # a value of CULL_FACES
    time: float = 0.0
    counters: bool = False
    progress: Callable | None = None
    smooth: bool = False  # filter
    finer: FinerSamples | None = None  # the samples of refined pixels; None: nothing is refined
    passes: Passes | None = None  # of diffuse rays; None: no light bounces


class TracedLights(NamedTuple):
    """Queries, one a light, and their answers."""

    queries: list[ShadowQuery]
    bits: list[np.ndarray]


class FrameState:
    """One frame while it is made.

    source : RenderSource
    accelerator : Accelerator
    request : Request
    clock : Clock
        Each pass adds its seconds.
    tally : (n,) int64 or None
        Counters, if the request wants them.
    rays : int
        Shadow rays asked so far.
    triangles : Triangles
        All of the scene; of a store the ones that are seen.
    view : CameraRays
        The camera's rays, in the frame of the triangles.
    whole : Accelerated or None
        All triangles in a tree, if there is one; it may be for the camera's rays only.
    shown : Shown or None
        The rays that the builder is shown for this frame; None if it wants none.
    ready : Accelerated
        Answers the shadow queries that `accelerate` was given last.
    """

    triangles: Triangles
    view: CameraRays
    ready: Accelerated

    def __init__(self, source: RenderSource, accelerator: Accelerator, request: Request):
        self.source, self.accelerator, self.request = source, accelerator, request
        self.clock, self.threads, self.rays = Clock(), accelerator.threads, 0
        self.tally = new_counters() if request.counters else None
        self.whole: Accelerated | None = None
        self.shown: Shown | None = None


def queries_of(state: FrameState, surfaces: Surfaces, samples) -> list[ShadowQuery]:
    """The query of each light for some surfaces, with these samples of each."""
    return surface_queries(surfaces, state.request.lights, samples, state.request.facing, state.threads)


def accelerate(state: FrameState, queries, ready: Accelerated | None) -> None:
    """Make ready for these queries; `ready`: traces them if nothing is culled, None: to be built."""
    culled = state.accelerator.culled(state.triangles, queries)
    if culled is not None:
        state.clock.lap("cull")
    if culled is not None or ready is None:
        ready = state.accelerator.build(state.triangles, culled, state.shown)
    state.ready = ready
    state.clock.lap("build")


def ask(state: FrameState, query: ShadowQuery) -> np.ndarray:
    """The bits of a query."""
    state.rays += int(np.count_nonzero(query.sides != NOTHING)) * query.samples.shape[1]
    return state.accelerator.answer(state.ready, query, state.tally, state.request.progress)


def ask_all(state: FrameState, queries: list[ShadowQuery]) -> TracedLights:
    """The bits of all these queries."""
    return TracedLights(queries, [ask(state, query) for query in queries])


def arriving_at(state: FrameState, surfaces: Surfaces, traced: TracedLights, seen=None) -> list[np.ndarray]:
    """The light that each lamp sends to each pixel's surface; see `image.shade.arriving`."""
    of_lights = zip(state.request.lights, *traced)
    return [arriving(surfaces.gbuffer, light, query, b, seen, state.threads) for light, query, b in of_lights]


def shaded(state: FrameState, surfaces: Surfaces, arrived, visibility, ambient, indirect=None) -> np.ndarray:
    """The image of some surfaces, (H, W, 3) float32."""
    colour, up, lights = surfaces.triangles.colour, state.source.scene.up, state.request.lights
    return shade(surfaces.gbuffer, colour, lights, arrived, visibility, ambient, up, indirect, state.threads)


def picture(state: FrameState, surfaces: Surfaces, traced: TracedLights, ambient, indirect=None) -> np.ndarray:
    """The image of some surfaces by these bits, as they are."""
    shares = [fraction_lit(b, query.samples.shape[1], state.threads) for query, b in zip(*traced)]
    return shaded(state, surfaces, arriving_at(state, surfaces, traced), shares, ambient, indirect)
