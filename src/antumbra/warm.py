"""Kernels are compiled before anything is timed, once for each machine, and the user is told."""

import sys
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from .kernels.jit import CACHE_DIR


def tell(line: str) -> None:
    """Where the line about compiling goes: standard error."""
    print(line, file=sys.stderr, flush=True)


def _marker(name: str):
    from llvmlite import binding

    return CACHE_DIR / "compiled" / f"{name}-{binding.get_host_cpu_name()}"


compiled: list[str] = []
"""What this process has compiled, not loaded; that takes some 100 MB of memory, which it keeps."""


def _once(name: str, work: Callable[[], None], say: Callable[[str], None]) -> None:
    """Do `work`, which makes Numba compile or load kernels; say so if they have not been compiled here before."""
    marker = _marker(name)
    known = marker.exists()
    if not known:
        compiled.append(name)
        say(f"antumbra: compiling the kernels of {name} for this machine (once; a minute or two) ...")
    work()
    if not known:
        try:
            marker.parent.mkdir(parents=True, exist_ok=True)
            marker.touch()
        except OSError:
            say(f"antumbra: {CACHE_DIR} cannot be written, so kernels are compiled each time; set NUMBA_CACHE_DIR")


@cache
def warm_up(plan, gbuffer: str, counters: bool = False) -> None:
    """Compile, or load from the cache, all kernels that rendering by this plan calls: by rendering a small scene.

    `counters`: what counts, where a tracer has kernels of its own for that.
    """
    counters = counters and plan.tracer.counts_apart
    name = f"{plan} ({gbuffer}{', counted' if counters else ''})"
    _once(name, lambda: _render_small(plan, gbuffer, counters=counters), tell)


@cache
def warm_up_quality(plan, gbuffer: str) -> None:
    """The same for the filter and for adaptive sampling; they are the same for every plan."""
    _once("filter and refinement", lambda: _render_small(plan, gbuffer, True), tell)


@cache
def warm_up_bounce() -> None:
    """The same for the diffuse rays that `SrdhRays` can ask for."""
    _once("a diffuse bounce", lambda: _render_small("srdh+single", "raster", bounce=True), tell)


@cache
def warm_up_indirect(plan, gbuffer: str) -> None:
    """The same for light that bounces; it is the same for every plan."""
    _once("light that bounces", lambda: _render_small(plan, gbuffer, passes=1), tell)


@cache
def warm_up_steps() -> None:
    """The same for what `antumbra explain` counts."""

    def work():
        from .explanation import Moment, explain_compiled
        from .plan import parse_plan

        camera, lights = _small_view()
        explain_compiled(_small_scene(), [Moment(0.0, camera, lights)], [parse_plan("bsah+single")], 1, 2)

    _once("counted steps", work, tell)


@cache
def warm_up_rays() -> None:
    """The same for `Scene.occluded` and `Scene.closest_hit`."""

    def work():
        from .queries import trace_list
        from .query.rays import ray_arguments

        arguments = ray_arguments(np.zeros(3), np.ones(3), 0.0, 1.0, None, None, np.zeros(3))[0]
        trace_list(_small_scene(), arguments, True, 0, 0.0, 1)

    _once("ray queries", work, tell)


@cache
def warm_up_store() -> None:
    """The same for building a store."""

    def work():
        from .store.build import build_compiled

        with TemporaryDirectory() as folder:
            build_compiled([_small_scene()], Path(folder) / "small.antumbra", threads=2, chunk=64)

    _once("building stores", work, tell)


@cache
def warm_up_paged() -> None:
    """The same for what rendering a scene in a store takes besides."""

    def work():
        from .bvh.radix_sort import radix_sort

        radix_sort(np.zeros(2, np.int64), np.zeros(2, np.int32), 40, 2)

    _once("scenes in a store", work, tell)


def _small_scene():
    """Hills of about 10 000 triangles: enough for builders to take every path that large scenes take."""
    from .scene.scene import Scene

    x, z = np.meshgrid(np.linspace(-1, 1, 73), np.linspace(-1, 1, 73))
    a = (np.arange(72)[:, None] * 73 + np.arange(72)).ravel()
    faces = np.concatenate([np.stack([a, a + 73, a + 1], 1), np.stack([a + 1, a + 73, a + 74], 1)])
    return Scene.from_arrays(np.stack([x, np.sin(5 * x) * np.cos(4 * z) / 4, z], -1).reshape(-1, 3), faces)


def _small_view(quality=False, sky=True):
    """(camera, lights) for the small scene; `sky`: light from everywhere, too."""
    from .scene.camera import Camera
    from .scene.lights import AmbientOcclusion, PointLight, SphereLight
    from .scene.point_lights import PointLights

    light = SphereLight((0, 2, 0), 0.1) if quality else PointLight((0, 2, 0))
    lights = [light, PointLights([(0, 2, 0)], interleave=quality), *([AmbientOcclusion(1.0)] if sky else [])]
    return Camera((0, 2, 3), (0, 0, 0), width=8, height=8), lights


def _render_small(plan, gbuffer, quality=False, bounce=False, passes=0, counters=False):
    from . import renderer
    from .query.diffuse import diffuse_passes
    from .query.refine import finer_samples
    from .query.sampling import light_samples
    from .srdh_rays import SrdhRays

    camera, lights = _small_view(quality, sky=not passes)
    samples = [light_samples(light, 1) for light in lights]
    finer = finer_samples(lights, 2, "hammersley") if quality else None
    made = renderer.Renderer(_small_scene(), plan, 2, gbuffer, SrdhRays(bounce=True) if bounce else None)
    if made.showing is None:
        made.accelerate()  # of all triangles: culling leaves too few for all of a builder; the frame refits this tree
    diffuse = diffuse_passes(lights, passes, "hammersley") if passes else None
    made.frame(camera, lights, samples, counters=counters, smooth=quality, finer=finer, passes=diffuse)


def kernels_of(plans: Iterable) -> list[tuple[str, Callable[[], None]]]:
    """(name, function that compiles) of everything the given plans need, for `antumbra warmup`."""
    plans = list(plans)
    work: list[tuple[str, Callable[[], None]]] = [("ray queries", warm_up_rays)]
    work += [("filter and refinement", lambda p=plan: warm_up_quality(p, "raster")) for plan in plans[:1]]
    work += [("light that bounces", lambda p=plan: warm_up_indirect(p, "raster")) for plan in plans[:1]]
    work += [("counted steps", warm_up_steps), ("building stores", warm_up_store)]
    work += [("a diffuse bounce", warm_up_bounce)] if any(plan.wants_rays for plan in plans) else []
    for plan in plans:
        for gbuffer in ("raster", "rays"):
            for counters in (False, True)[: 1 + plan.tracer.counts_apart]:
                name = f"{plan} ({gbuffer}{', counted' if counters else ''})"
                work.append((name, lambda p=plan, g=gbuffer, c=counters: warm_up(p, g, c)))
    return work
