"""Compile kernels before anything is timed, by all cores, and tell the user.

A *job* calls kernels: rendering by a plan, ray queries, building a store. `kernels.needs` has recorded which kernels
a job calls. Several processes compile the ones that are not on disk. Then the job runs on a small scene, which
compiles kernels that nobody recorded. If all are on disk, as they are in every later process, nothing runs.

Each module owns the jobs of its work; `warm` lists them all.
"""

from collections.abc import Callable, Iterable
from functools import cache
from typing import NamedTuple

import numpy as np

from ..kernels import needs
from ..kernels.arguments import named
from ..kernels.crew import Wanted, compile_all
from ..kernels.loading import events, is_kept, user_cache
from ..kernels.progress import told
from ..scene.camera import Camera
from ..scene.lights import AmbientOcclusion, PointLight, SphereLight
from ..scene.point_lights import PointLights
from ..scene.scene import Scene


class Job(NamedTuple):
    """Something that calls kernels, done on a small scene."""

    name: str  # under which its kernels are recorded
    work: Callable[[], object]
    kernels: Callable[[], set[Wanted] | None]  # that are known to be called; None: nobody has recorded it


def fixed_job(name: str, work: Callable[[], object]) -> Job:
    """A job that calls the kernels that are recorded under its name."""
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


def small_scene() -> Scene:
    """Hills of about 10 000 triangles: enough for builders to take every path that large scenes take."""
    x, z = np.meshgrid(np.linspace(-1, 1, 73), np.linspace(-1, 1, 73))
    a = (np.arange(72)[:, None] * 73 + np.arange(72)).ravel()
    faces = np.concatenate([np.stack([a, a + 73, a + 1], 1), np.stack([a + 1, a + 73, a + 74], 1)])
    return Scene.from_arrays(np.stack([x, np.sin(5 * x) * np.cos(4 * z) / 4, z], -1).reshape(-1, 3), faces)


def small_view(quality=False, sky=True) -> tuple[Camera, list]:
    """(camera, lights) for the small scene; `quality`: lights with penumbrae, `sky`: light from everywhere, too."""
    above = np.array([0, 2, 0])
    light = SphereLight(above, 0.1) if quality else PointLight(above)
    lights = [light, PointLights(above[None], interleave=quality), *([AmbientOcclusion(1.0)] if sky else [])]
    return Camera((0, 2, 3), (0, 0, 0), width=8, height=8), lights
