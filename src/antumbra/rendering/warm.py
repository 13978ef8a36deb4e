"""Kernels are compiled before anything is timed, by all cores, and the user is told.

A *job* calls kernels: rendering by a plan, ray queries, building a store. `kernels.needs` has recorded which kernels
a job calls. Several processes compile those that are not on disk. Then the job is done on a small scene, which
compiles kernels that are not recorded. If all are on disk, as they are in every later process, nothing runs.
"""

from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from ..kernels import needs
from ..kernels.arguments import named
from ..kernels.crew import Wanted, compile_all
from ..kernels.loading import events, is_kept, user_cache
from ..kernels.progress import told
from ..plan import Plan, covering_plans, parse_plan


class Job(NamedTuple):
    """Something that calls kernels, done on a small scene."""

    name: str
    work: Callable[[], object]
    kernels: Callable[[], set[Wanted] | None]  # that are known to be called; None: nobody has recorded it


def _fixed(name: str, work: Callable[[], object]) -> Job:
    return Job(name, work, lambda: needs.of_job(name))


@cache
def make_ready(job_of: Callable[..., Job], *about) -> None:
    """Compile the kernels of the job ``job_of(*about)`` that are not on disk; once in a process."""
    job = job_of(*about)
    wanted = job.kernels()
    if wanted is None:
        job.work()
    elif missing := missing_of(wanted):
        compile_missing(missing)
        job.work()


def make_ready_all(wanted: Iterable[Job]) -> int:
    """Compile what jobs call and is not on disk, all together; how many kernels that were."""
    wanted = list(wanted)
    missing = missing_of({each for job in wanted for each in job.kernels() or ()})
    if missing:
        compile_missing(missing)
    before = len(events)
    for job in wanted:
        job.work()
    return len(missing) + sum(event.source == "compiled" for event in events[before:])


def missing_of(wanted: Iterable[Wanted]) -> set[Wanted]:
    """The kernels that are not on disk."""
    return {each for each in wanted if not is_kept(named(each.kernel), each.key)}


def compile_missing(missing: set[Wanted]) -> None:
    """Compile kernels by all cores; the user is told. Where none can be kept, nothing is done: `loading` says so."""
    if not user_cache().is_writable():
        return
    with told(f"compiling {len(missing)} kernels for this machine, once") as progress:
        compile_all(missing, progress)


# --- jobs --------------------------------------------------------------------------------------------------------


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
    return _fixed("filter and refinement", lambda: _render_small(Plan(), "raster", True))


def bounce() -> Job:
    return _fixed("a diffuse bounce", lambda: _render_small(parse_plan("srdh+single"), "raster", bounce=True))


def wide_lights() -> Job:
    def work():
        from ..scene.camera import Camera
        from ..scene.lights import QuadLight

        light = QuadLight((-1, 0.5, -1), (2, 0, 0), (0, 0, 2))
        view = Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]
        _render_small(Plan(trace="cones"), "raster", view=view, spp=16)

    return _fixed("cones, wide lights", work)


def indirect(gbuffer: str = "raster") -> Job:
    return _fixed(f"light that bounces ({gbuffer})", lambda: _render_small(Plan(), gbuffer, passes=1))


def steps() -> Job:
    def work():
        from .explanation import Moment, explain_compiled

        camera, lights = _small_view()
        explain_compiled(_small_scene(), [Moment(0.0, camera, lights)], [parse_plan("bsah+single")], 1, 2)

    return _fixed("counted steps", work)


def rays() -> Job:
    def work():
        from ..query.rays import ray_arguments
        from .queries import trace_list

        arguments = ray_arguments(np.zeros(3), np.ones(3), 0.0, 1.0, None, None, np.zeros(3))[0]
        scene = _small_scene()
        for any_hit in True, False:
            trace_list(scene, arguments, any_hit, 0, 0.0, 1)

    return _fixed("ray queries", work)


def store() -> Job:
    def work():
        from ..store.build import build_compiled

        with TemporaryDirectory() as folder:
            build_compiled([_small_scene()], Path(folder) / "small.antumbra", threads=2, chunk=64)

    return _fixed("building stores", work)


def paged() -> Job:
    def work():
        from ..bvh.radix_sort import radix_sort

        radix_sort(np.zeros(2, np.int64), np.zeros(2, np.int32), 40, 2)

    return _fixed("scenes in a store", work)


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


# --- a small scene -----------------------------------------------------------------------------------------------


def _small_scene():
    """Hills of about 10 000 triangles: enough for builders to take every path that large scenes take."""
    from ..scene.scene import Scene

    x, z = np.meshgrid(np.linspace(-1, 1, 73), np.linspace(-1, 1, 73))
    a = (np.arange(72)[:, None] * 73 + np.arange(72)).ravel()
    faces = np.concatenate([np.stack([a, a + 73, a + 1], 1), np.stack([a + 1, a + 73, a + 74], 1)])
    return Scene.from_arrays(np.stack([x, np.sin(5 * x) * np.cos(4 * z) / 4, z], -1).reshape(-1, 3), faces)


def _small_view(quality=False, sky=True):
    """(camera, lights) for the small scene; `sky`: light from everywhere, too."""
    from ..scene.camera import Camera
    from ..scene.lights import AmbientOcclusion, PointLight, SphereLight
    from ..scene.point_lights import PointLights

    light = SphereLight((0, 2, 0), 0.1) if quality else PointLight((0, 2, 0))
    lights = [light, PointLights([(0, 2, 0)], interleave=quality), *([AmbientOcclusion(1.0)] if sky else [])]
    return Camera((0, 2, 3), (0, 0, 0), width=8, height=8), lights


def _render_small(plan, gbuffer, quality=False, bounce=False, passes=0, counters=False, view=None, spp=1):
    from ..query.diffuse import diffuse_passes
    from ..query.refine import finer_samples
    from ..query.sampling import light_samples
    from . import renderer
    from .srdh_rays import SrdhRays

    camera, lights = view or _small_view(quality, sky=not passes)
    samples = [light_samples(light, spp) for light in lights]
    finer = finer_samples(lights, 2, "hammersley") if quality else None
    made = renderer.Renderer(_small_scene(), plan, 2, gbuffer, SrdhRays(bounce=True) if bounce else None)
    if made.showing is None:
        made.accelerate()  # of all triangles: culling leaves too few for all of a builder; the frame refits this tree
    diffuse = diffuse_passes(lights, passes, "hammersley") if passes else None
    made.frame(camera, lights, samples, counters=counters, smooth=quality, finer=finer, passes=diffuse)
