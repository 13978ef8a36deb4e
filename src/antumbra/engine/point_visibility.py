"""`visibility`: which samples of lights are visible from points, without a camera."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array
from ..base.progress import ProgressCallback, with_quiet_progress
from ..query.point_list import MAX_COORDINATE
from ..query.receivers import NOTHING, Receivers
from ..scene.lights import Light
from .plan import Plan
from .scene import AnyScene
from .scene_loading import SceneLike, scene_of
from .visibility import Visibility, mark_failed


@with_quiet_progress
def visibility(
    scene: SceneLike,
    points: "ArrayLike",
    light: Light | Sequence[Light],
    normals: "ArrayLike | None" = None,
    *,
    spp: int = 16,
    plan: str | Plan | None = None,
    time: float = 0.0,
    threads: int | None = None,
    sampler: str = "larcher-pillichshammer",
    seed: int = 0,
    cull_faces: str | None = None,
    max_memory: int | None = None,
    progress: ProgressCallback | bool | None = None,
) -> Visibility:
    """Compute which samples of lights are visible from arbitrary points, such as mesh vertices or sensors.

    Sample s is occluded if a triangle intersects the segment from the point to the sample strictly between its ends.

    Parameters
    ----------
    scene : Scene, PagedScene, or anything that `antumbra.load` accepts
    points : (..., 3) float
        World coordinates, in any array type that supports DLPack.
    light : a light, or a list of lights
        For a list, the results have an additional axis, the lights, which share a tree. Ambient occlusion needs
        `normals`. With `PointLights` or `DirectionalLights`, each point tests every light: bit s is light s.
    normals : (..., 3) float or None
        For points on surfaces: surface normals of any length, pointing to the tested side. They broadcast against the
        points. Each point is offset from its surface by a few units in the last place, and samples below its horizon
        are occluded. None: the points lie in free space and are used unchanged. A point that is NaN, infinite or
        beyond float32, or whose normal is zero or not finite, fails alone, unless all do: its `fraction` is NaN, and
        it sees no sample.
    spp, plan, time, threads, sampler, seed, cull_faces
        As in `antumbra.render`. Point i uses sample set i mod 4.
    max_memory : int or None
        For a scene in a store, the limit in bytes on the memory of the process; None: its `max_memory`. The chunks read
        stay in memory for the next query with the same plan, threads and limit.
    progress : function of (done, total), or bool, optional
        Called about ten times a second. False: nothing is shown. None: terminals and notebooks show a bar after a
        second.

    Returns
    -------
    Visibility
        `bits` (..., ceil(n / 64)) uint64 and `fraction` (...) float32; for a list of lights,
        (..., lights, ceil(n / 64)) and (..., lights). `seen` and `seen_samples` are bool arrays.

    Raises
    ------
    InputError
        If a shape or dtype is wrong, the plan is unknown, or all points fail.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
    >>> lamp = at.PointLight((1, 1, 2), intensity=1)
    >>> at.visibility(roof, [[1, 1, 0], [8, 8, 0]], lamp).fraction
    array([0., 1.], dtype=float32)
    """
    scene = scene_of(scene)
    engine = scene.engine.with_options(plan, threads, max_memory)
    points = as_array(points, "points")
    single = isinstance(light, Light)
    receivers, failed = _receivers_of(points, normals, scene)
    answer = engine.visibility(
        receivers,
        light,
        spp=spp,
        sampler=sampler,
        seed=seed,
        cull_faces=cull_faces,
        time=time,
        progress=progress,
    )
    return mark_failed(answer, failed).reshaped(points.shape[:-1], single)


def _receivers_of(
    points: NDArray[Any], normals: "ArrayLike | None", scene: AnyScene
) -> tuple[Receivers, NDArray[np.intp]]:
    """The receivers at points, and the indices of those that fail, at which there is none."""
    if normals is None and np.abs(points).max(initial=0.0) < MAX_COORDINATE:
        return Receivers.in_space(points, scene.origin), _NONE  # at once: usually no point fails
    good = (np.abs(points) < MAX_COORDINATE).all(-1) if points.ndim and points.shape[-1] == 3 else np.ones(0, bool)
    if normals is not None:
        normals = as_array(normals, "normals")
        with suppress(ValueError):  # `Receivers` refuses shapes that do not broadcast
            good = good & (np.isfinite(normals).all(-1) & normals.any(-1))
    if good.shape == points.shape[:-1] and good.any() and not good.all():
        first = tuple(np.argwhere(good)[0])
        if normals is not None:
            normals = np.broadcast_to(normals, points.shape)
            normals = np.where(good[..., None], normals, normals[first])
        points = np.where(good[..., None], points, points[first])
        receivers, failed = Receivers.of(points, normals, scene.origin, scene.middle), np.flatnonzero(~good)
        receivers.sides[0, failed] = NOTHING
        return receivers, failed
    return Receivers.of(points, normals, scene.origin, scene.middle), _NONE


_NONE = np.empty(0, np.intp)
