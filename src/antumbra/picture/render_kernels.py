"""Compile jobs of rendering: kernels of a plan's frames, filters, refinement, appearance and bounced light.

The `*_job` functions describe the jobs, and the `precompile_*` functions run them.
"""

from dataclasses import replace

from ..engine.engine import Engine
from ..engine.plan import Plan
from ..engine.plan_kernels import record_name, recorded, trace_all_strategies, wide_lights_warm_up
from ..engine.precompilation import WarmUp, fixed_warm_up, precompile, small_scene, small_view
from ..scene.camera import Camera
from ..scene.lights import Light
from ..techniques.srdh.representative_rays import SrdhRays
from .frame_passes import render_frame
from .frame_request import request_of
from .render_options import RenderOptions

PLAIN = RenderOptions(spp=1, sampler="hammersley", filter=False, antialias=False)
"""Options of a frame that calls as few kernels as possible."""

QUALITY = replace(PLAIN, filter=True, adaptive=2)
"""The same, with the kernels of the filter and of refinement."""


def precompile_plan(plan: Plan, gbuffer: str, counters: bool = False) -> None:
    """Compile the kernels with which a plan renders. `counters`: include a tracer's separate counting kernels."""
    precompile(rendering_warm_up, plan, gbuffer, counters and plan.tracer.counts_apart)
    if plan.trace == "cones":
        precompile(wide_lights_warm_up)


def precompile_quality() -> None:
    """Compile the kernels of the filter and of adaptive sampling; they are the same for every plan."""
    precompile(quality_warm_up)


def precompile_antialias() -> None:
    """Compile the kernels of anti-aliasing; they are the same for every plan."""
    precompile(antialias_warm_up)


def precompile_appearance() -> None:
    """Compile the kernels of textures and smooth normals; they are the same for every plan."""
    precompile(appearance_warm_up)


def precompile_bounce() -> None:
    """Compile the kernels of the diffuse rays that `SrdhRays` can request."""
    precompile(bounce_warm_up)


def precompile_indirect(gbuffer: str) -> None:
    """Compile the kernels of bounced light; they are the same for every plan."""
    precompile(indirect_warm_up, gbuffer)


def precompile_explicit_rays() -> None:
    """Compile the kernels of non-perspective cameras; they are the same for every plan."""
    precompile(explicit_rays_warm_up)


def precompile_ground() -> None:
    """Compile the kernels of the shadow catcher; they are the same for every plan."""
    precompile(ground_warm_up)


def rendering_warm_up(plan: Plan, gbuffer: str = "raster", counters: bool = False) -> WarmUp:
    """The job of rendering by a plan. Plans without a record use the kernels of recorded plans with their methods."""

    def work() -> None:
        if plan.tracer.chooses:
            trace_all_strategies(counters)
        _render_small(plan, gbuffer, replace(PLAIN, counters=counters))

    return WarmUp(record_name(plan, gbuffer, counters), work, recorded(plan, gbuffer, counters))


def quality_warm_up() -> WarmUp:
    """The job of the filter and of adaptive sampling."""
    return fixed_warm_up("filter and refinement", lambda: _render_small(Plan(), options=QUALITY))


def antialias_warm_up() -> WarmUp:
    """The job of anti-aliasing."""
    return fixed_warm_up("anti-aliasing", lambda: _render_small(Plan(), options=replace(PLAIN, antialias=True)))


def bounce_warm_up() -> WarmUp:
    """The job of the diffuse rays that a builder takes as sample rays."""
    plan = Plan(build="srdh", trace="single", sample=SrdhRays(bounce=True))
    return fixed_warm_up("a diffuse bounce", lambda: _render_small(plan))


def appearance_warm_up() -> WarmUp:
    """The job of textures and smooth normals."""
    return fixed_warm_up("textures and normals", lambda: _render_small(Plan(), textured=True))


def indirect_warm_up(gbuffer: str = "raster") -> WarmUp:
    """The job of bounced light."""
    return fixed_warm_up(
        f"light that bounces ({gbuffer})", lambda: _render_small(Plan(), gbuffer, replace(PLAIN, bounce=1))
    )


def explicit_rays_warm_up() -> WarmUp:
    """The job of cameras with explicit rays."""

    def work() -> None:
        camera, lights = small_view(True)
        above = Camera(camera.position, camera.target, width=8, height=8, projection="orthographic", extent=3.0)
        _render_small(Plan(), view=(above, lights))

    return fixed_warm_up("orthographic and panoramic cameras", work)


def ground_warm_up() -> WarmUp:
    """The job of the shadow catcher, with lights that are partly below it."""
    return fixed_warm_up("a ground", lambda: _render_small(Plan(), options=replace(QUALITY, ground=1.95)))


def _render_small(
    plan: Plan,
    gbuffer: str = "raster",
    options: RenderOptions = PLAIN,
    *,
    view: tuple[Camera, list[Light]] | None = None,
    textured: bool = False,
) -> None:
    """Render a frame of the small scene; `view`: camera and lights, `textured`: with textures and smooth normals."""
    scene = small_scene(textured)
    engine = Engine(scene, plan, 2, gbuffer=gbuffer)
    camera, lights = view or small_view(bool(options.filter), sky=options.bounce is None)
    request = request_of(camera, lights, options, None if options.ground is False else options.ground)
    if (
        engine.accelerator.ray_selector is None
    ):  # build over all triangles: culling leaves too few to run every builder kernel
        engine.accelerator.build(scene.triangles(0.0, 2))
    render_frame(engine, request)
