"""The jobs whose kernels can be compiled ahead of time: all that the package does."""

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from ..kernels import needs
from ..plan import Plan, covering_plans, parse_plan
from .ready import Job, fixed_job, make_ready, small_scene, small_view


def warm_up(plan: Plan, gbuffer: str, counters: bool = False) -> None:
    """All that rendering by this plan calls. `counters`: with those that count, if a tracer has them apart."""
    make_ready(rendering, plan, gbuffer, counters and plan.tracer.counts_apart)
    if plan.trace == "cones":
        make_ready(wide_lights)


def warm_up_quality() -> None:
    """The filter and adaptive sampling; they are the same for every plan."""
    make_ready(quality)


def warm_up_bounce() -> None:
    """The diffuse rays that `SrdhRays` can ask for."""
    make_ready(bounce)


def warm_up_indirect(gbuffer: str) -> None:
    """Light that bounces; it is the same for every plan."""
    make_ready(indirect, gbuffer)


def warm_up_steps() -> None:
    """What `antumbra explain` counts."""
    make_ready(steps)


def warm_up_rays() -> None:
    """`Scene.occluded` and `Scene.closest_hit`."""
    make_ready(rays)


def warm_up_store() -> None:
    """Building a store."""
    make_ready(store)


def warm_up_paged() -> None:
    """What rendering a scene in a store takes besides."""
    make_ready(paged)


def rendering(plan: Plan, gbuffer: str = "raster", counters: bool = False) -> Job:
    """Rendering by a plan. Of a plan that nobody recorded the kernels are those of plans that share its methods."""
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
        for field in ("cull", "build", "optimise", "update"):
            method = getattr(plan, field)
            if method not in (None, getattr(Plan(), field)):
                with_it = plain(Plan(**{"trace": "single", field: method}))
                tracing = (tracing - (usual - with_it)) | (with_it - usual)
        return tracing

    return Job(name(plan), lambda: _render_small(plan, gbuffer, counters=counters), kernels)


def quality() -> Job:
    return fixed_job("filter and refinement", lambda: _render_small(Plan(), "raster", True))


def bounce() -> Job:
    return fixed_job("a diffuse bounce", lambda: _render_small(parse_plan("srdh+single"), "raster", bounce=True))


def wide_lights() -> Job:
    def work():
        from ..scene.camera import Camera
        from ..scene.lights import QuadLight

        light = QuadLight((-1, 0.5, -1), (2, 0, 0), (0, 0, 2))
        view = Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]
        _render_small(Plan(trace="cones"), "raster", view=view, spp=16)

    return fixed_job("cones, wide lights", work)


def indirect(gbuffer: str = "raster") -> Job:
    return fixed_job(f"light that bounces ({gbuffer})", lambda: _render_small(Plan(), gbuffer, passes=1))


def steps() -> Job:
    def work():
        from .explanation import Moment, explain_compiled

        camera, lights = small_view()
        explain_compiled(small_scene(), [Moment(0.0, camera, lights)], [parse_plan("bsah+single")], 1, 2)

    return fixed_job("counted steps", work)


def rays() -> Job:
    def work():
        from ..query.rays import ray_arguments
        from .queries import trace_list

        arguments = ray_arguments(np.zeros(3), np.ones(3), 0.0, 1.0, None, None, np.zeros(3))[0]
        scene = small_scene()
        for any_hit in True, False:
            trace_list(scene, arguments, any_hit, 0, 0.0, 1)

    return fixed_job("ray queries", work)


def store() -> Job:
    def work():
        from ..store.build import build_compiled

        with TemporaryDirectory() as folder:
            build_compiled([small_scene()], Path(folder) / "small.antumbra", threads=2, chunk=64)

    return fixed_job("building stores", work)


def paged() -> Job:
    def work():
        from ..bvh.radix_sort import radix_sort

        radix_sort(np.zeros(2, np.int64), np.zeros(2, np.int32), 40, 2)

    return fixed_job("scenes in a store", work)


def jobs(plans: Iterable[Plan] | None = None, papers: bool = False) -> list[Job]:
    """The jobs of plans, of all methods if None, and those that are the same for every plan.

    papers : of the methods that packages add, too; theirs come last
    """
    plans = list(dict.fromkeys(covering_plans(papers) if plans is None else plans))
    found = [rays(), quality(), indirect("raster"), indirect("rays"), steps(), store(), paged()]
    found += [wide_lights()] if any(plan.trace == "cones" for plan in plans) else []
    found += [bounce()] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                found.append(rendering(plan, gbuffer, counters))
    return found


def _render_small(plan, gbuffer, quality=False, bounce=False, passes=0, counters=False, view=None, spp=1):
    from ..query.diffuse import diffuse_passes
    from ..query.refine import finer_samples
    from ..query.sampling import light_samples
    from . import renderer
    from .srdh_rays import SrdhRays

    camera, lights = view or small_view(quality, sky=not passes)
    samples = [light_samples(light, spp) for light in lights]
    finer = finer_samples(lights, 2, "hammersley") if quality else None
    made = renderer.Renderer(small_scene(), plan, 2, gbuffer, SrdhRays(bounce=True) if bounce else None)
    if made.showing is None:
        made.accelerate()  # of all triangles: culling leaves too few for all of a builder; the frame refits this tree
    diffuse = diffuse_passes(lights, passes, "hammersley") if passes else None
    made.frame(camera, lights, samples, counters=counters, smooth=quality, finer=finer, passes=diffuse)
