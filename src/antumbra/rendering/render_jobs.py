"""The jobs of rendering: frames by a plan, and the extra kernels of filter, refinement and bounced light."""

from dataclasses import replace

import numpy as np

from ..auto.rates import GOOD, QUICK
from ..auto.ways import WAYS, Forms, answer
from ..kernels import needs
from ..methods import BUILDERS, UPDATERS
from ..plan import Plan, parse_plan
from ..query.picture import shadow_queries
from ..query.sampling import light_samples
from ..scene.camera import Camera
from ..scene.lights import QuadLight
from ..trace.counters import new_counters
from .choosing import accelerator_of
from .in_memory import InMemory
from .options import RenderOptions
from .passes import draw
from .ready import Job, fixed_job, make_ready, small_scene, small_view
from .request import request_of
from .see import see
from .srdh_rays import SrdhRays

PLAIN = RenderOptions(spp=1, sampler="hammersley", filter=False, antialias=False)
"""Options of pictures that call no kernel without need."""

QUALITY = replace(PLAIN, filter=True, adaptive=2)
"""... of the kernels of the filter and of refinement too."""


def warm_up(plan: Plan, gbuffer: str, counters: bool = False) -> None:
    """Compile the kernels of rendering by a plan. `counters`: include a tracer's separate counting kernels."""
    make_ready(rendering_job, plan, gbuffer, counters and plan.tracer.counts_apart)
    if plan.trace == "cones":
        make_ready(wide_lights_job)


def warm_up_quality() -> None:
    """Compile the kernels of the filter and of adaptive sampling; they are the same for every plan."""
    make_ready(quality_job)


def warm_up_antialias() -> None:
    """Compile the kernels of anti-aliasing; they are the same for every plan."""
    make_ready(antialias_job)


def warm_up_dressed() -> None:
    """Compile the kernels of textures and smooth normals; they are the same for every plan."""
    make_ready(dressed_job)


def warm_up_bounce() -> None:
    """Compile the kernels of the diffuse rays that `SrdhRays` can request."""
    make_ready(bounce_job)


def warm_up_indirect(gbuffer: str) -> None:
    """Compile the kernels of bounced light; they are the same for every plan."""
    make_ready(indirect_job, gbuffer)


def warm_up_listed() -> None:
    """Compile the kernels of cameras that are not perspective; they are the same for every plan."""
    make_ready(listed_job)


def warm_up_ground() -> None:
    """Compile the kernels of a ground that catches shadows; they are the same for every plan."""
    make_ready(ground_job)


def rendering_job(plan: Plan, gbuffer: str = "raster", counters: bool = False) -> Job:
    """The job of rendering by a plan. A plan without a record gets the kernels of recorded plans with its methods."""
    name = lambda p: f"{p} ({gbuffer}{', counted' if counters else ''})"
    plain = lambda p: needs.of_job(f"{p} ({gbuffer})") or set()

    def kernels():
        found = needs.of_job(name(plan))
        if found is not None:
            return found
        tracing = needs.of_job(name(Plan(trace=plan.trace)))
        if tracing is None:
            return None
        usual = plain(Plan(trace="single"))
        for methods in _parts(plan):
            with_it = plain(Plan(trace="single", **methods))
            tracing = (tracing - (usual - with_it)) | (with_it - usual)
        return tracing

    def work():
        if plan.tracer.chooses:
            _trace_small_all_ways(counters)
        _render_small(plan, gbuffer, replace(PLAIN, counters=counters))

    return Job(name(plan), work, kernels)


def _parts(plan: Plan) -> list[dict[str, str]]:
    """Methods whose kernels are recorded together, as fields of a plan, for all methods that the plan adds."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts


def quality_job() -> Job:
    """The job of the filter and of adaptive sampling."""
    return fixed_job("filter and refinement", lambda: _render_small(Plan(), options=QUALITY))


def antialias_job() -> Job:
    """The job of anti-aliasing."""
    return fixed_job("anti-aliasing", lambda: _render_small(Plan(), options=replace(PLAIN, antialias=True)))


def bounce_job() -> Job:
    """The job of the diffuse rays that a builder is shown."""
    plan = parse_plan("srdh+single")
    return fixed_job("a diffuse bounce", lambda: _render_small(plan, srdh_rays=SrdhRays(bounce=True)))


def wide_lights_job() -> Job:
    """The job of `cones` with lights too wide for one apex."""

    def work():
        light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
        view = Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]
        _render_small(Plan(trace="cones"), options=replace(PLAIN, spp=16), view=view)

    return fixed_job("cones, wide lights", work)


def dressed_job() -> Job:
    """The job of textures and smooth normals."""
    return fixed_job("textures and normals", lambda: _render_small(Plan(), dressed=True))


def indirect_job(gbuffer: str = "raster") -> Job:
    """The job of bounced light."""
    return fixed_job(
        f"light that bounces ({gbuffer})", lambda: _render_small(Plan(), gbuffer, replace(PLAIN, bounce=1))
    )


def listed_job() -> Job:
    """The job of cameras whose rays are listed."""

    def work():
        camera, lights = small_view(True)
        above = Camera(camera.position, camera.target, width=8, height=8, projection="orthographic", extent=3.0)
        _render_small(Plan(), view=(above, lights))

    return fixed_job("orthographic and panoramic cameras", work)


def ground_job() -> Job:
    """The job of a ground that catches shadows, with lights that are partly below it."""
    return fixed_job("a ground", lambda: _render_small(Plan(), options=replace(QUALITY, ground=1.95)))


def _render_small(
    plan: Plan, gbuffer: str = "raster", options: RenderOptions = PLAIN, *, srdh_rays: SrdhRays | None = None,
    view: tuple[Camera, list] | None = None, dressed: bool = False,
) -> None:  # fmt: skip
    """Render a frame of the small scene; `view`: camera and lights, `dressed`: with textures and smooth normals."""
    scene, accelerator = small_scene(dressed), accelerator_of(plan, 2, srdh_rays)
    camera, lights = view or small_view(bool(options.filter), sky=options.bounce is None)
    request = request_of(camera, lights, options, None if options.ground is False else options.ground)
    if accelerator.showing is None:  # all triangles: culling leaves too few to reach all of a builder
        accelerator.build(scene.triangles(0.0, 2))
    draw(InMemory(scene, accelerator, gbuffer), accelerator, request)


def _trace_small_all_ways(counters: bool) -> None:
    """Trace the lights of the small scene in each way that `auto` may choose, over the trees that it may build."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    queries = shadow_queries(triangles, see(triangles, camera, None, 2), lights, [light_samples(s, 1) for s in lights])
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = Forms(build(triangles.vertices, 2), 2)
        for name, way in WAYS.items():
            for query in queries:
                if way.suits(query, forms.box):
                    answer(name, forms, query, 2, new_counters() if counters else None)
