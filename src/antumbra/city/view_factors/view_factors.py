"""`view_factors`: view factors between the surfaces of a scene, by counting where exact rays arrive."""

from typing import NamedTuple, ParamSpec

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.parallel import thread_count
from ...work.executors import Keep, checked_keep, executor_of
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts
from ..sensors.point_checks import notes_on_faces, tell
from ..sensors.surface_groups import Grouping, SurfaceGroups, notes_on_buildings, surface_groups
from .hemisphere_rays import REPLICATES, HemisphereRays
from .view_factor_matrix import OUTSIDE, ViewFactors
from .view_factor_options import ViewFactorKeywords, ViewFactorOptions

_P = ParamSpec("_P")

RAYS_PER_PART = 1 << 19  # if a surface does not have more
_FACE_BYTES = 1000  # of memory, with the normals and tangents from which rays are made


@with_keywords(ViewFactorKeywords, 2)
@with_progress
def view_factors(
    given: Given[_P],
    scene: SceneLike,
    per: Grouping = "surface",
    keep: Keep = None,
    progress: Progress = None,
    *args: _P.args,
    **keywords: _P.kwargs,
) -> ViewFactors:
    """Find the view factors between the surfaces of a scene, with exact visibility.

    F_ij is the share of the diffuse radiation leaving surface i that arrives at surface j, both directly and without
    obstruction. Rays leave points on surface i, uniformly distributed, in directions distributed as the cosine. The
    share of the rays whose closest hit is on surface j is an unbiased estimate of F_ij.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    per : str or (faces,) int
        What a surface is. "surface": a semantic surface of a city model; otherwise a planar part of an object, whose
        faces are joined by edges. "face", "object", or "building": the outermost objects of a city model that are
        buildings. Or a number for each face, which is equal for the faces of a surface; -1: the face belongs to none,
        and only blocks, as do trees and roads beside buildings.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    ViewFactors
        A sparse matrix with a row for each surface that has an area, standard errors, and shares of sky and ground.
        Each row sums to exactly 1. In a closed room, `sky`, `ground` and `other` are 0. None if the executor leaves
        parts to other shards.

    Raises
    ------
    InputError
        If an argument is invalid, no surface has an area, or a store has more triangles
        than fit in memory.

    Warns
    -----
    UserWarning
        If faces lie closely behind others that face the same way.

    Notes
    -----
    A surface sees itself if it is not convex: its own factor F_ii is then positive. Alpha masks and panes block rays as
    in `Scene.closest_hit`.

    Examples
    --------
    >>> floor, ceiling = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0, 1], [0, 1, 1], [1, 1, 1], [1, 0, 1]]
    >>> plates = at.Scene.from_arrays(floor + ceiling, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], up="z")
    >>> factors = at.view_factors(plates, per=[0, 0, 1, 1])
    >>> factors.matrix.toarray()[:, :2].round(1)
    array([[0. , 0.2],
           [0.2, 0. ]])
    """
    options, scene = ViewFactorOptions(per=per, **given(*args, **keywords)), measured_scene(scene)
    threads, time = thread_count(options.threads), scene.clamped(options.time)
    keep = checked_keep(keep)
    side, seed, samples = options.side, options.seed, 1 << (options.samples - 1).bit_length()
    scene.data.check_all(_FACE_BYTES)
    sign = -1.0 if side == "back" else 1.0
    sampling = _Sampling.of(scene, per, samples, side, seed, time)
    warned = tell([*notes_on_buildings(scene, per), *notes_on_faces(scene, sign, time, threads)])
    n, executor, parts_about = len(sampling.groups.names), executor_of(keep), None
    if executor.folder is not None:
        settings = samples, side, seed, sampling.groups.of_face
        parts_about = about_parts("view factors", scene_digest(scene, time, threads), *settings)
    work = lambda first, last: _counts(scene, sampling, first, last, time, threads)._asdict()
    title = f"view factors: {counted(n, 'surface')} x {counted(samples, 'ray')}"
    parts = Parts(title, n, max(1, RAYS_PER_PART // samples), work, executor.folder, parts_about)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    counts = _Counts(**parts.taken(_Counts._fields))
    executor.end([parts])
    about = {"job": "view factors", "scene": scene.name, "samples": samples, "side": side, "seed": seed, "time": time}
    about |= {"per": per if isinstance(per, str) else "numbers", **warned}
    return _result(sampling, counts, about, scene.unit.square_metres)


class _Sampling(NamedTuple):
    """The surfaces with an area, and their rays."""

    groups: SurfaceGroups
    rays: HemisphereRays
    samples: int
    side: str

    @classmethod
    def of(cls, scene: AnyScene, per: Grouping, samples: int, side: str, seed: int, time: float) -> "_Sampling":
        groups, triangles = surface_groups(scene, per), scene.triangles(time)
        corners = triangles.vertices.astype(np.float64)
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        of_face = np.where((across != 0.0).any(1), groups.of_face, -1)
        used, numbers = np.unique(of_face, return_inverse=True)
        none = int(np.count_nonzero(used < 0))
        if len(used) == none:
            raise InputError(f"{scene.name}: no surface has an area, so there are no view factors; choose other faces")
        names, types = ([values[k] for k in used[none:]] for values in (groups.names, groups.types))
        of_face = (numbers - none).astype(np.int32)
        rays = HemisphereRays(triangles, of_face, samples, -1.0 if side == "back" else 1.0, seed, used[none:])
        return cls(SurfaceGroups(names, types, of_face), rays, samples, side)


class _Counts(NamedTuple):
    """Numbers of rays that arrive, of some surfaces."""

    row: NDArray[np.int64]  # (k,)
    column: NDArray[np.int64]  # (k,), as in `ViewFactors.matrix`
    rays: NDArray[np.int64]  # (k,)
    error: NDArray[np.float64]  # (k,) standard error of `rays`


def _counts(scene: AnyScene, sampling: _Sampling, first: int, last: int, time: float, threads: int) -> _Counts:
    """Where the rays of the surfaces from `first` to `last` arrive."""
    of_face, n = sampling.groups.of_face, len(sampling.groups.names)
    origins, directions, faces = sampling.rays.of_groups(first, last)
    hit = scene.closest_hit(origins, directions, skip_face=faces, time=time, threads=threads)
    met = hit.mask
    column = np.where(directions[:, "xyz".index(scene.up)] > 0.0, n, n + 1)
    column[met] = n + 2
    receives = met & (np.einsum("ij,ij->i", sampling.rays.normals[hit.face], directions) < 0.0)
    arrivals = [(np.flatnonzero(receives), hit.face[receives])]
    if sampling.side == "back":  # of coincident faces, the nearest hit is on one whose front faces the ray
        rest = np.flatnonzero(met & ~receives)
        ways, own, beyond = directions[rest], faces[rest], np.nextafter(hit.t[rest], np.inf)
        backs = scene.closest_hit(origins[rest], ways, 0.0, beyond, own, time, cull_faces="front", threads=threads)
        there = backs.t == hit.t[rest]
        arrivals.append((rest[there], backs.face[there]))
    for rays_there, face in arrivals:
        column[rays_there] = np.where(of_face[face] >= 0, of_face[face], n + 2)
    width, per_replicate = n + len(OUTSIDE), sampling.samples // REPLICATES
    replicate = np.arange(len(column)) // per_replicate  # of all surfaces, in their order
    keys, rays = np.unique(replicate * width + column, return_counts=True)
    pairs = keys // width // REPLICATES * width + keys % width  # without the replicate
    pairs, index = np.unique(pairs, return_inverse=True)
    total = np.bincount(index, rays).astype(np.int64)
    squares = np.bincount(index, rays.astype(np.float64) ** 2)
    variance = np.maximum(squares - total**2 / REPLICATES, 0.0) / (REPLICATES - 1)
    return _Counts(first + pairs // width, pairs % width, total, np.sqrt(REPLICATES * variance))


def _result(sampling: _Sampling, counts: _Counts, about: dict[str, object], square: float) -> ViewFactors:
    """The view factors; `square`: square metres per square unit."""
    from scipy.sparse import csr_array

    groups, samples = sampling.groups, sampling.samples
    n = len(groups.names)
    rows, columns, rays, errors = counts
    starts = np.concatenate([[0], np.cumsum(np.bincount(rows, minlength=n))])
    shape = n, n + len(OUTSIDE)
    matrix, deviations = (csr_array((each / samples, columns, starts), shape=shape) for each in (rays, errors))
    return ViewFactors(groups.names, groups.types, sampling.rays.areas * square, matrix, deviations, about)
