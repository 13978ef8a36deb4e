"""The surfaces and shadow queries of a picture at one moment, and the tree of a plan for them."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..engine.accelerator import Accelerated, Accelerator
from ..engine.plan import Plan
from ..engine.primary_visibility import primary_visibility
from ..query.gbuffer import GBuffer
from ..query.shadow_query import ShadowQuery, shadow_queries, surface_queries
from ..scene.camera import Camera
from ..scene.triangles import Triangles
from ..techniques.srdh.representative_rays import bounced_queries
from .memory import frame_memory
from .options import RenderOptions
from .request import Request, request_of


class Moment(NamedTuple):
    """Camera and lights at one time."""

    time: float  # seconds into the animation
    camera: Camera
    lights: list


class Picture(NamedTuple):
    """The surfaces and shadow queries of a moment; they are the same for every plan."""

    source: Any  # a `RenderSource` of a store; None: the scene is in memory
    triangles: Triangles
    gbuffer: GBuffer
    lights: list
    samples: list[np.ndarray]
    queries: list[ShadowQuery]


def picture_of(scene, moment: Moment, options: RenderOptions, threads: int, plan: Plan | None = None) -> Picture:
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
    return Picture(None, triangles, gbuffer, request.lights, request.samples, queries)


def _picture_of_store(scene, request: Request, threads: int, plan: Plan | None) -> Picture:
    source = scene.engine.with_options(plan, threads, None).source
    source.begin(frame_memory(request))
    surfaces = source.look(request.camera, *source.moment(0.0))
    queries = surface_queries(surfaces, request.lights, request.samples, request.facing, threads)
    return Picture(source, surfaces.triangles, surfaces.gbuffer, request.lights, request.samples, queries)


def build_for(accelerator: Accelerator, picture: Picture) -> Accelerated:
    """Cull and build for the queries of a picture in memory, as a frame does."""
    _, triangles, gbuffer, lights, samples, queries = picture
    bounce = bounced_queries(accelerator.showing, triangles, gbuffer, lights, samples)
    shown = accelerator.show(triangles, queries, bounce=bounce)
    return accelerator.build(triangles, accelerator.culled(triangles, queries), shown)
