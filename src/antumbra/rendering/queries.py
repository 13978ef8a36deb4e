"""Queries without a camera: arrays of rays, and the visibility of lights from points."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..checks import as_array, unit_vectors
from ..errors import InputError
from ..kernels.parallel import thread_count
from ..kernels.progress import hushed, in_turn, shown
from ..loading import SceneLike, scene_of
from ..plan import DEFAULT_PLAN, Plan
from ..query.rays import cull_value, ray_arguments
from ..query.receivers import point_receivers
from ..query.sampling import light_samples
from ..query.shadow import fraction_lit
from ..scene.hit import Hit, HitFaces
from ..scene.light_list import in_full
from ..scene.lights import Light, check_lights
from ..scene.recentre import settled
from ..scene.triangles import Triangles
from .accelerate import Accelerated
from .memory import FrameMemory, points_memory
from .points import AskingPoints
from .ray_trees import PLAN, plan_at
from .ready import Job, fixed_job, make_ready, small_scene
from .renderer import Progress, Renderer, source_kind
from .source import RenderSource
from .srdh_rays import SrdhRays


class Visibility(NamedTuple):
    """What points see of a light, or of several; (...) is the points' leading shape, and (..., lights) for several."""

    bits: np.ndarray  # (..., ceil(n / 64)) uint64: bit s = sample s occluded; 0 beyond the samples of a light
    fraction: np.ndarray  # (...) float32 in [0, 1]: share of the samples that are not occluded
    samples: np.ndarray  # int64, () or (lights,): number of samples of each light

    @property
    def seen(self) -> np.ndarray:
        """(...) bool: whether the point sees any sample. For a light of one sample, whether it sees the light."""
        return self.fraction > 0.0

    @property
    def seen_samples(self) -> np.ndarray:
        """(..., n) bool: whether the point sees sample s. n: the most samples of a light; False beyond its own."""
        words = np.ascontiguousarray(self.bits).astype("<u8", copy=False)
        n = int(self.samples.max(initial=0))
        occluded = np.unpackbits(words.view(np.uint8), axis=-1, count=n, bitorder="little")
        return (occluded == 0) & (np.arange(n) < self.samples[..., None])

    def __repr__(self) -> str:
        samples = "/".join(map(str, np.unique(self.samples)))
        mean = f", {self.fraction.mean():.3g} of the samples seen" if self.fraction.size else ""
        return f"Visibility({self.fraction.shape}, {samples} samples{mean}; bits, fraction, samples, seen)"


def accelerated(scene, time=0.0, threads=None, plan=DEFAULT_PLAN) -> Accelerated:
    """The scene's triangles and BVH at a time in seconds; the scene caches them, per plan, for the latest time.

    Plans that differ only in their tracer share the triangles and the BVH, if they have one.

    plan : a plan whose tree does not depend on the query

    Raises
    ------
    InputError
        If the scene is in a store and the plan needs all triangles.
    """
    _, ready = Renderer(scene, plan, threads).source.for_points(time)
    assert ready is not None
    return ready


def surfaces_hit(scene, origins, directions, time, threads) -> tuple[np.ndarray, Triangles, np.ndarray]:
    """The nearest hits of rays in world coordinates: (t, triangles, index of each ray's triangle in them or -1)."""
    arguments = ray_arguments(origins, directions, 0.0, np.inf, None, None, scene.origin, scene.n_triangles)[0]
    return _ray_source(scene, threads, time).surfaces_hit(arguments, time)


def _ray_source(scene, threads, time) -> RenderSource:
    """The source that traces the rays of a scene at a time. Its kernels are compiled."""
    if source_kind(scene).keeps_read:
        source = renderer_of(scene, None, threads, None, None).source
        source.warm_up()
        return source
    warm_up_rays()
    return Renderer(scene, plan_at(scene, scene.clamped(time)), threads).source


def warm_up_rays() -> None:
    """Compile the kernels of `Scene.occluded` and `Scene.closest_hit`."""
    make_ready(rays_job)


def rays_job() -> Job:
    """The job of ray queries."""

    def work():
        arguments = ray_arguments(np.zeros(3), np.ones(3), 0.0, 1.0, None, None, np.zeros(3), 1)[0]
        source = Renderer(small_scene(), PLAN, 1).source
        for any_hit in True, False:
            source.trace_rays(arguments, any_hit, 0, 0.0)

    return fixed_job("ray queries", work)


def ask(scene, any_hit: bool, rays: tuple[Any, Any, Any, Any, Any], targets, time, cull_faces, threads):
    """Trace an array of rays: (...) bool for any-hit, a `Hit` for closest hit.

    rays : the first five arguments of `Scene.occluded`
    targets : its argument of this name; None for closest hit
    """
    time, threads = scene.clamped(time), thread_count(threads)
    arguments, shape, facing = ray_arguments(*rays, cull_faces, scene.origin, scene.n_triangles, targets)
    source = _ray_source(scene, threads, time)
    out = source.trace_rays(arguments, any_hit, facing, time)
    if any_hit:
        return out.blocked.reshape(shape)
    faces = HitFaces(*(array.reshape(shape) for array in (out.t, out.face, out.u, out.v)))
    return Hit.of_scene(faces, _corners_of(source, scene, arguments, faces.face, facing, time), _objects_of(scene))


def _corners_of(source, scene, arguments, face, facing, time) -> Callable[[], np.ndarray]:
    """A function that gives the world corners of the faces that were hit, (m, 3, 3) float64."""
    if source_kind(scene).keeps_read:  # a store has no triangles in memory: the same rays find them again
        own = arguments.part(np.arange(len(arguments.origins)))  # a copy
        found = lambda: source.surfaces_hit(own, time, facing)[1:]
    else:
        triangles = source.accelerated(time).triangles
        found = lambda: (triangles, face)

    def corners() -> np.ndarray:
        triangles, index = found()
        return triangles.vertices[index[index >= 0]].astype(np.float64) + triangles.origin

    return corners


def _objects_of(scene) -> Callable[[], np.ndarray]:
    return lambda: scene.object_of_face


@hushed
def visibility(
    scene: SceneLike, points: ArrayLike, light: Light | Sequence[Light], normals: ArrayLike | None = None, *,
    spp: int = 16, plan: str | Plan | None = None, time: float = 0.0, threads: int | None = None,
    sampler: str = "larcher-pillichshammer", cull_faces: str | None = None, srdh_rays: SrdhRays | None = None,
    max_memory: int | None = None, progress: Progress | bool | None = None,
) -> Visibility:  # fmt: skip
    """Find which samples of lights are visible from arbitrary points, such as mesh vertices or sensors.

    Sample s is occluded if a triangle meets the segment from the point to the sample strictly between its ends.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` takes
    points : (..., 3) float
        World coordinates, in any array type that supports DLPack.
    light : a light, or a list of lights
        Of a list, the results have one more axis, the lights. One tree serves all of them. Ambient occlusion needs
        `normals`. With `PointLights` or `DirectionalLights` each point tests every light: bit s is light s.
    normals : (..., 3) float or None
        For points on surfaces: the surface normals towards the tested side, of any length. They are broadcast against
        the points. Each point is moved off its surface by a few units in the last place, and samples below its horizon
        are occluded. None: the points lie in free space and are used unchanged.
    spp, plan, time, threads, sampler, cull_faces
        As in `antumbra.render`. Point i uses sample set i mod 4.
    srdh_rays : SrdhRays or None
        The rays that the builder `srdh` is shown; None: the rays of 256 of the points.
    max_memory : int or None
        Limit in bytes on the memory of the process, for a scene in a store; None: 4 GiB. The scene keeps the chunks
        that were read for the next query with the same plan, threads and memory.
    progress : function of (done, total), or bool, optional
        Called about ten times a second. False: nothing is shown. None: terminals and notebooks show a bar after a
        second.

    Returns
    -------
    Visibility
        `bits` (..., ceil(n / 64)) uint64 and `fraction` (...) float32; of a list (..., lights, ceil(n / 64)) and
        (..., lights). `seen` and `seen_samples` are bool arrays.

    Raises
    ------
    InputError
        If a shape or dtype is wrong, a number is NaN, infinite or beyond float32, a normal is zero, or the plan is
        unknown.
    """
    scene = scene_of(scene)
    time, threads = scene.clamped(time), thread_count(threads)
    renderer = renderer_of(scene, plan, threads, srdh_rays, max_memory)
    points = as_array(points, "points")
    if points.ndim < 1 or points.shape[-1] != 3:
        raise InputError(f"points must have shape (..., 3), not {points.shape}")
    alone = isinstance(light, Light)
    lights = [in_full(each) for each in check_lights(light, scene.up)]
    samples = [light_samples(each, spp, sampler) for each in lights]
    for each in lights:
        if normals is None and each.domain == "hemisphere":
            raise InputError(f"{type(each).__name__} is seen around a normal; give the points' normals")
    receivers = receivers_of(scene, points, normals)
    asked = _Asked(receivers, lights, samples, cull_value(cull_faces), time)
    with shown("tracing shadow rays", progress) as heard:
        found = _answers(renderer, asked, in_turn(heard, len(lights)))
    counts = np.array([each.shape[1] for each in samples], np.int64)
    shares = [fraction_lit(bits, n) for bits, n in zip(found, counts.tolist())]
    words = max(bits.shape[-1] for bits in found)
    shape = points.shape[:-1] if alone else (*points.shape[:-1], len(lights))
    bits, fraction = _side_by_side(found, words), np.stack(shares, axis=-1)
    return Visibility(bits.reshape(*shape, words), fraction.reshape(shape), counts.reshape(()) if alone else counts)


def _side_by_side(found: list[np.ndarray], words: int) -> np.ndarray:
    """The bits of the lights, (1, m, lights, words)."""
    if len(found) == 1:
        return found[0][:, :, None]
    bits = np.zeros((*found[0].shape[:2], len(found), words), np.uint64)
    for k, of_light in enumerate(found):
        bits[:, :, k, : of_light.shape[-1]] = of_light
    return bits


class _Asked(NamedTuple):
    """The checked arguments of `visibility`."""

    receivers: tuple[np.ndarray, np.ndarray | None]  # from `receivers_of`
    lights: list[Light]
    samples: list[np.ndarray]  # per light (16, n, 3)
    facing: int  # a value of CULL_FACES
    time: float  # seconds


def _answers(renderer: Renderer, asked: _Asked, progress: Progress | None) -> list[np.ndarray]:
    """The bits of each light, (1, m, ceil(n / 64)) uint64."""
    origins, unit = asked.receivers
    needs = [points_memory(len(origins), light, samples) for light, samples in zip(asked.lights, asked.samples)]
    rays = len(origins) * sum(samples.shape[1] for samples in asked.samples)
    asking = AskingPoints(renderer, asked.time, rays, FrameMemory(*map(sum, zip(*needs))))
    rows = [asking.row(origins, unit, *each, asked.facing) for each in zip(asked.lights, asked.samples)]
    return asking.answer_all(rows, progress)


def renderer_of(scene, plan, threads, srdh_rays, max_memory) -> Renderer:
    """A renderer of this scene; for a store, the renderer of this thread's previous query if the options agree."""
    if not source_kind(scene).keeps_read:
        return Renderer(scene, plan, threads, srdh_rays=srdh_rays, max_memory=max_memory)
    most = scene.max_memory if max_memory is None else max_memory
    wanted, own = (plan, threads, most, srdh_rays), scene.own  # each Python thread keeps its chunks
    if getattr(own, "wanted", None) != wanted:
        own.renderer = Renderer(scene, plan, threads, srdh_rays=srdh_rays, max_memory=most)
        own.wanted = wanted
    return own.renderer


def receivers_of(scene, points: np.ndarray, normals) -> tuple[np.ndarray, np.ndarray | None]:
    """(n, 3) float32 receivers of world points in the recentred frame; and (n, 3) float64 unit normals.

    Points with normals are moved off their surface. Without normals, there are no unit normals either.
    """
    world = points.astype(np.float64).reshape(-1, 3)
    if not np.isfinite(world).all():
        raise InputError("points hold NaN or infinity")
    local = world - scene.origin
    with np.errstate(over="ignore"):
        single = local.astype(np.float32)
    if not np.isfinite(single).all():
        raise InputError("points lie beyond float32, farther than 3.4e38 from the scene; move them closer")
    if normals is None:
        return settled(single), None
    unit = _unit_normals(normals, points.shape)
    return point_receivers(local, unit, world, points.dtype == np.float32), unit


def _unit_normals(normals, shape) -> np.ndarray:
    normals = as_array(normals, "normals").astype(np.float64)
    if normals.ndim < 1 or normals.shape[-1] != 3:
        raise InputError(f"normals must have shape (..., 3), not {normals.shape}")
    try:
        normals = np.broadcast_to(normals, shape).reshape(-1, 3)
    except ValueError:
        raise InputError(f"normals {normals.shape} do not broadcast to the points {shape}") from None
    unit = unit_vectors(normals, "the normal of point", "leave normals out for points in free space")
    return np.ascontiguousarray(unit)
