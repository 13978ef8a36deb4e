"""Compile kernels on all cores before anything is timed, and report it.

A *job* calls kernels: rendering by a plan, ray queries, building a store. `kernels.toolchain.kernel_manifest` records
which kernels a job calls. Several processes compile those that are missing on disk. Then the job runs on a small scene,
which compiles any unrecorded kernels. If all kernels are on disk, as in every later process, nothing runs.

Each module defines its own jobs; `jobs.warm_ups` lists all of them.
"""

from collections.abc import Callable, Hashable, Iterable, Sequence
from functools import cache
from typing import NamedTuple

import numpy as np

from ..base.progress import report_progress
from ..formats.library_meshes import data_of_arrays
from ..kernels.marshalling import import_object
from ..kernels.toolchain import kernel_manifest
from ..kernels.toolchain.compile_pool import KernelRequest, compile_kernels
from ..kernels.toolchain.device_code import FORMS, DeviceKernel
from ..kernels.toolchain.kernel_cache import user_cache
from ..kernels.toolchain.kernel_loading import events, has_compiler, is_on_disk
from ..scene.camera import Camera
from ..scene.light_lists import PointLights
from ..scene.lights import AmbientOcclusion, Light, PointLight, SphereLight
from ..scene.materials import MASK, Material, Texture
from ..scene.mesh import StaticMeshes, VertexAttributes, make_mesh, textured_mesh
from ..scene.scene_data import MemoryData


class WarmUp(NamedTuple):
    """Work that calls kernels, run on a small scene."""

    name: str  # key of the record of its kernels
    work: Callable[[], object]  # runs the job
    kernels: Callable[[], set[KernelRequest] | None]  # returns the recorded kernels; None: the job has no record


def fixed_warm_up(name: str, work: Callable[[], object]) -> WarmUp:
    """A job whose kernels are recorded under its name."""
    return WarmUp(name, work, lambda: kernel_manifest.kernels_of_warm_up(name))


@cache
def precompile(job_of: Callable[..., WarmUp], *arguments: Hashable) -> None:
    """Compile those kernels of the job ``job_of(*arguments)`` that are missing on disk, once per process."""
    job = job_of(*arguments)
    kernels = job.kernels()
    if kernels is None:
        job.work()
    elif missing := missing_of(kernels):
        compile_missing(missing)
        job.work()


def precompile_all(jobs: Iterable[WarmUp]) -> int:
    """Compile the missing kernels of several jobs together. Returns the number of kernels compiled."""
    jobs = list(jobs)
    missing = missing_of({each for job in jobs for each in job.kernels() or ()})
    if missing:
        compile_missing(missing)
    before = len(events)
    for job in jobs:
        job.work()
    return len(missing) + sum(event.source == "compiled" for event in events[before:])


def precompile_devices(kernels: Iterable[DeviceKernel]) -> None:
    """Compile the kernels of devices that are missing on disk."""
    missing = {KernelRequest(each.kernel.name, each.key) for each in kernels if not each.is_on_disk()}
    if missing:
        compile_missing(missing, FORMS, "devices")


def missing_of(kernels: Iterable[KernelRequest]) -> set[KernelRequest]:
    """The kernels that are not on disk."""
    return {each for each in kernels if _is_missing(each)}


def _is_missing(request: KernelRequest) -> bool:
    try:
        return not is_on_disk(import_object(request.kernel), request.key)
    except (AttributeError, ModuleNotFoundError):  # a name has changed since the record; the job compiles what it calls
        return False


def are_on_disk(kernels: Iterable[KernelRequest] | None) -> bool:
    """Whether all kernels of a job are on disk; False if the job has no record."""
    return kernels is not None and not missing_of(kernels)


def compile_missing(
    missing: set[KernelRequest], levels: Sequence[str] | None = None, what: str = "this machine"
) -> None:
    """Compile kernels on all cores with a progress message. No-op if the cache is read-only; `loading` warns then.

    levels : as for `compile_kernels`
    what : what they are for, in the message
    """
    if not has_compiler() or not user_cache().is_writable():
        return
    with report_progress(f"compiling {len(missing)} kernels for {what}, once") as progress:
        compile_kernels(missing, progress, levels=levels)


def small_scene(dressed: bool = False) -> MemoryData:
    """Hills of about 10,000 triangles, enough for builders to take every code path of large scenes.

    dressed : whether they have a texture, vertex colours and normals
    """
    x, z = np.meshgrid(np.linspace(-1, 1, 73), np.linspace(-1, 1, 73))
    a = (np.arange(72)[:, None] * 73 + np.arange(72)).ravel()
    faces = np.concatenate([np.stack([a, a + 73, a + 1], 1), np.stack([a + 1, a + 73, a + 74], 1)])
    vertices = np.stack([x, np.sin(5 * x) * np.cos(4 * z) / 4, z], -1).reshape(-1, 3)
    if not dressed:
        return data_of_arrays(vertices, faces)
    white, up = np.full((2, 2, 3), 255, np.uint8), np.broadcast_to((0.0, 1.0, 0.0), vertices.shape)
    return data_of_arrays(
        vertices, faces, vertex_colours=np.ones(vertices.shape), uv=vertices[:, ::2], texture=white, normals=up
    )


def small_view(quality: bool = False, sky: bool = True) -> tuple[Camera, list[Light]]:
    """(camera, lights) for the small scene; `quality`: lights with penumbrae, `sky`: add ambient occlusion."""
    above = np.array([0, 2, 0])
    light = SphereLight(above, 0.1) if quality else PointLight(above)
    lights: list[Light] = [light, PointLights(above[None], interleave=quality)]
    if sky:
        lights.append(AmbientOcclusion(1.0))
    return Camera((0, 2, 3), (0, 0, 0), width=8, height=8), lights


def small_scene_with_cutouts() -> MemoryData:
    """The small scene below a perforated sheet of paper."""
    corners = np.array([[[-1, 1, -1], [1, 1, -1], [1, 1, 1]], [[-1, 1, -1], [1, 1, 1], [-1, 1, 1]]], np.float32)
    pixels = np.full((8, 8, 4), 255, np.uint8)
    pixels[..., 3] = 255 * np.eye(8)
    material = Material(texture=Texture("paper", pixels, has_alpha=True), alpha_mode=MASK)
    sheet = make_mesh("paper", corners.reshape(-1, 3), None, None, "paper")
    paper = textured_mesh(sheet, None, 6, material, "paper", VertexAttributes(corners[..., ::2].reshape(-1, 2)))
    hills = make_mesh("hills", small_scene().triangles().vertices.reshape(-1, 3), None, None, "hills")
    return MemoryData(StaticMeshes([hills, paper], "small"))
