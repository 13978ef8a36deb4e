"""The surfaces and shadow queries of a picture at one moment, and the tree of a plan for them."""

from typing import Any, NamedTuple

import numpy as np

from ..engine.accelerate import Accelerated, Accelerator
from ..engine.see import see
from ..engine.srdh_rays import bounced_queries
from ..plan import Plan
from ..query.gbuffer import GBuffer
from ..query.picture import shadow_queries, surface_queries
from ..query.rays import cull_value
from ..query.sampling import light_samples
from ..query.shadow import ShadowQuery
from ..scene.camera import Camera
from ..scene.triangles import Triangles
from .memory import frame_memory
from .request import Request


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


def picture_of(
    scene, moment: Moment, spp: int, threads: int, sampler: str = "larcher-pillichshammer", plan: Plan | None = None,
    cull_faces: str | None = None,
) -> Picture:  # fmt: skip
    """The surfaces and queries of a moment, whose lights are checked already.

    plan : the plan whose tracer a store is prepared for; None: the default
    """
    samples, facing = [light_samples(light, spp, sampler) for light in moment.lights], cull_value(cull_faces)
    if scene.engine.source.in_store:
        return _picture_of_store(scene, moment, samples, facing, threads, plan)
    triangles = scene.triangles(moment.time, threads)
    gbuffer = see(triangles, moment.camera, None, threads)
    queries = shadow_queries(triangles, gbuffer, moment.lights, samples, facing, threads)
    return Picture(None, triangles, gbuffer, moment.lights, samples, queries)


def _picture_of_store(scene, moment: Moment, samples: list[np.ndarray], facing: int, threads: int, plan) -> Picture:
    source = scene.engine.with_options(plan, threads, None).source
    source.begin(frame_memory(Request(moment.camera, moment.lights, samples)))
    surfaces = source.look(moment.camera, *source.moment(0.0))
    queries = surface_queries(surfaces, moment.lights, samples, facing, threads)
    return Picture(source, surfaces.triangles, surfaces.gbuffer, moment.lights, samples, queries)


def build_for(accelerator: Accelerator, picture: Picture) -> Accelerated:
    """Cull and build for the queries of a picture in memory, as a frame does."""
    _, triangles, gbuffer, lights, samples, queries = picture
    bounce = bounced_queries(accelerator.showing, triangles, gbuffer, lights, samples)
    shown = accelerator.show(triangles, queries, bounce=bounce)
    return accelerator.build(triangles, accelerator.culled(triangles, queries), shown)
