"""`line_of_sight`: sightlines between pairs of points, and what blocks them; pair files, result tables and models."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, ParamSpec

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array
from ...base.errors import InputError
from ...base.option_fields import Given, with_keywords
from ...base.progress import Progress, with_progress
from ...base.wording import counted, some_of
from ...engine.engine import Engine
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...formats.gltf.gltf_writer import LINES
from ...kernels.parallel import thread_count
from ...query.receivers import Receivers
from ...work.executors import Keep, checked_keep, executor_of
from ...work.result_summary import Summary, SummaryTable, heading
from ...work.scene_records import scene_digest
from ...work.work_parts import Parts, about_parts
from ..sensors.point_attributes import Attributes
from ..sensors.point_checks import notes_on_points, notes_on_sensors, tell
from ..sensors.sensor_files import SUFFIXES, check_point_file, read_array
from ..sensors.sensors import Sensors, corners_of, point_sensors
from ..sensors.table_rows import read_table
from ..tables.false_colours import ColouredMesh, coloured_glb
from ..tables.result_table import Column, Table
from .sight_options import SightOptions

_P = ParamSpec("_P")

# --- Sightlines -------------------------------------------------------------------------------------------------------


PAIRS_PER_PART = 1 << 16


class Sightlines(NamedTuple):
    """Visibility of pairs of points, and what blocks it; the leading shape (...) is that of the pairs."""

    visible: np.ndarray  # (...) bool: the two points see each other
    face: np.ndarray  # (...) int32: the blocking face nearest to the observer; -1 if visible, or if none is known
    object: np.ndarray  # (...) int32: its object, an index into `Scene.objects`; -1 where `face` is
    point: np.ndarray  # (..., 3) float64, world: where it blocks; NaN if visible
    distance: np.ndarray  # (...) float64, world units: from the observer to this point; NaN if visible
    length: np.ndarray  # (...) float64, world units: from the observer to the target


_WEIGHTS = np.sqrt([2.0, 3.0, 5.0, 7.0, 11.0, 13.0])  # by which different points have different sums


class _Ends(NamedTuple):
    """The observers, or the targets, as `line_of_sight` receives them."""

    points: ArrayLike
    normals: ArrayLike | None
    faces: ArrayLike | None


class _Pairs(NamedTuple):
    """Flat arrays of pairs."""

    begin: np.ndarray  # (n, 3) float32, recentred, moved off surfaces
    end: np.ndarray  # (n, 3) float32
    begin_unit: np.ndarray | None  # (n, 3) float64
    end_unit: np.ndarray | None
    begin_face: np.ndarray  # (n,) int64, -1: none
    end_face: np.ndarray

    def part(self, first: int, last: int) -> "_Pairs":
        some: list[Any] = [None if array is None else array[first:last] for array in self]
        return _Pairs(*some)


@with_keywords(SightOptions, 3)
@with_progress
def line_of_sight(
    given: Given[_P], scene: SceneLike, observers: ArrayLike, targets: ArrayLike, normals: ArrayLike | None = None,
    target_normals: ArrayLike | None = None, faces: ArrayLike | None = None, target_faces: ArrayLike | None = None,
    keep: Keep = None, progress: Progress = None, *args: _P.args, **keywords: _P.kwargs,
) -> Sightlines:  # fmt: skip
    """Find whether observers see targets, and the face, object and point that block the others.

    A triangle blocks if it meets the segment between the two points, strictly between its ends. The result is exact.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    observers, targets : (..., 3) float
        World coordinates. They broadcast: ``a[:, None], b[None]`` tests all pairs.
    normals, target_normals : (..., 3) float, optional
        For ends on surfaces, towards the visible side. Such an end is moved off its surface by a few units in the last
        place, and its own surface blocks everything below its horizon. None: the points are used unchanged.
    faces, target_faces : (...) int, optional
        The faces of the scene on which ends lie, -1: none. They do not block this pair, except by the horizon of a
        normal. An end on a face, such as the centre of a window pane, needs its face or its normal, since float32 can
        round it to either side of the face.
    keep : str, path-like or executor, optional
        Folder for the finished parts of an interrupted study, or an executor for the parts; see
        `antumbra.work.executors`.
    progress : function of (text, done, total), or bool, optional
        Called during the work. False: show nothing. None: terminals and notebooks show a bar after a second.

    Returns
    -------
    Sightlines
        None if the executor leaves parts to other shards.

    Raises
    ------
    InputError
        If shapes do not broadcast, a number is NaN or infinite, a normal is zero, or points are in degrees.

    Warns
    -----
    UserWarning
        If points lie beside the scene, below the ground, on a surface without a normal, or closely behind another one.

    Notes
    -----
    Among faces with the same t in float64, the one that `Scene.closest_hit` would report blocks. For a pair that only a
    horizon blocks, the result has the face from `faces` or `target_faces`, and the end on it as the blocking point.

    Examples
    --------
    >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
    >>> at.line_of_sight(roof, [1, 1, 0], [[1, 1, 2], [8, 8, 2]]).visible
    array([False,  True])
    """
    options, scene = SightOptions(**given(*args, **keywords)), measured_scene(scene)
    threads, time, keep = thread_count(options.threads), options.time, checked_keep(keep)
    begin, end = _Ends(observers, normals, faces), _Ends(targets, target_normals, target_faces)
    pairs, shape = _checked(scene, begin, end)
    for each, what in ((begin, "observers"), (end, "targets")):
        tell(_notes(scene, each, what, time, threads))
    n = len(pairs.begin)
    work = lambda first, last: _blocks(pairs.part(first, last), scene.engine, time, threads)
    executor, about = executor_of(keep), None
    if executor.folder is not None:
        given_arrays = [array for array in pairs if array is not None]
        present = [array is not None for array in pairs]
        about = about_parts("sight lines", scene_digest(scene, scene.clamped(time), threads), present, *given_arrays)
    parts = Parts(f"{counted(n, 'line')} of sight", n, PAIRS_PER_PART, work, executor.folder, about)
    if not executor.finish([parts]):
        return None  # type: ignore[return-value]  # a shard, of a command
    blocks = parts.joined(("t", "face")) if n else _blocks(pairs, scene.engine, time, threads)
    executor.end([parts])
    away = pairs.end.astype(np.float64) - pairs.begin
    length, t, face = np.linalg.norm(away, axis=1), blocks["t"], blocks["face"]
    point = pairs.begin + t[:, None] * away + scene.origin
    objects = np.where(face >= 0, scene.object_of_face[face], -1).astype(np.int32)
    visible = np.isnan(t)
    fields = visible, face, objects, point, t * length, length
    return Sightlines(*(array.reshape((*shape, *array.shape[1:])) for array in fields))


def _checked(scene: AnyScene, begin: _Ends, end: _Ends) -> tuple[_Pairs, tuple[int, ...]]:
    """The pairs and their leading shape."""
    at = [as_array(begin.points, "observers"), as_array(end.points, "targets")]
    for points, what in zip(at, ("observers", "targets")):
        if points.ndim < 1 or points.shape[-1] != 3:
            raise InputError(f"{what} must have shape (..., 3), not {points.shape}")
    faces = [as_array(-1 if each.faces is None else each.faces, "faces") for each in (begin, end)]
    try:
        shape = np.broadcast_shapes(at[0].shape[:-1], at[1].shape[:-1], faces[0].shape, faces[1].shape)
    except ValueError:
        raise InputError(
            f"shapes do not broadcast: observers {at[0].shape}, targets {at[1].shape}, "
            f"faces {faces[0].shape}, target_faces {faces[1].shape}"
        ) from None
    ends, units, face_lists = list[np.ndarray](), list[np.ndarray | None](), list[np.ndarray]()
    for points, each, face in zip(at, (begin, end), faces):
        positions, normals = np.broadcast_to(points, (*shape, 3)).reshape(-1, 3), None
        if each.normals is not None:
            normals = np.broadcast_to(_as_normals(each.normals, shape), (*shape, 3)).reshape(-1, 3)
        receivers = Receivers.of(positions, normals, scene.origin, scene.middle)
        ends.append(receivers.origins[0])
        units.append(None if normals is None else receivers.normals[0])
        face_lists.append(_as_faces(np.broadcast_to(face, shape).ravel(), scene.n_triangles))
    return _Pairs(*ends, *units, *face_lists), shape


def _notes(scene: AnyScene, ends: _Ends, what: str, time: float, threads: int) -> list[str]:
    """Notes on checked ends, before they are paired."""
    parts = [as_array(each, what).astype(np.float64) for each in (ends.points, ends.normals) if each is not None]
    rows = np.concatenate(np.broadcast_arrays(*parts), -1).reshape(-1, 3 * len(parts))
    _, first = np.unique(rows @ _WEIGHTS[: rows.shape[1]], return_index=True)  # ten times as fast as by rows
    rows = rows[np.sort(first)]
    if ends.normals is None and ends.faces is not None:
        return notes_on_points(scene, rows, what, time, threads)
    some = point_sensors(rows[:, :3], None if ends.normals is None else rows[:, 3:])
    return notes_on_sensors(scene, some, what, time, threads)


def _as_normals(normals: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    array = as_array(normals, "normals")
    if array.ndim < 1 or array.shape[-1] != 3:
        raise InputError(f"normals must have shape (..., 3), not {array.shape}")
    try:
        return np.broadcast_to(array, (*shape, 3))
    except ValueError:
        raise InputError(f"normals {array.shape} do not broadcast to pairs of shape {shape}") from None


def _as_faces(faces: np.ndarray, count: int) -> np.ndarray:
    if faces.dtype.kind == "f" or (faces < -1).any() or (faces >= count).any():
        raise InputError(f"faces of ends must be whole numbers from -1 to {count - 1}, the scene's last face")
    return faces.astype(np.int64)


def _blocks(pairs: _Pairs, engine: Engine, time: float, threads: int) -> dict[str, np.ndarray]:
    """The block of each pair: t (n,) float64 from 0 to 1, NaN if visible; face (n,), as in `AllHits`."""
    n = len(pairs.begin)
    hits = engine.segment_hits(pairs.begin, pairs.end, pairs.begin_face, time, threads)
    ray = hits.ray
    other = hits.face != pairs.end_face[ray]
    blocked, nearest = np.unique(ray[other], return_index=True)  # hits are sorted
    first_t, face = np.full(n, np.nan), np.full(n, -1, hits.face.dtype)
    first_t[blocked], face[blocked] = hits.t[other][nearest], hits.face[other][nearest]
    for unit, surface_face, place, sign in (
        (pairs.end_unit, pairs.end_face, 1.0, -1.0),
        (pairs.begin_unit, pairs.begin_face, 0.0, 1.0),
    ):
        if unit is None:
            continue
        away = sign * (pairs.end.astype(np.float64) - pairs.begin)
        hidden = ~((away[:, 0] * unit[:, 0] + away[:, 1] * unit[:, 1]) + away[:, 2] * unit[:, 2] > 0.0)
        hidden &= np.isnan(first_t) if place else True
        first_t[hidden], face[hidden] = place, surface_face[hidden]
    return {"t": first_t, "face": face}


# --- Pairs from files -------------------------------------------------------------------------------------------------


_ENDS = "x1", "y1", "z1", "x2", "y2", "z2"
_NORMALS = "nx1", "ny1", "nz1", "nx2", "ny2", "nz2"
_FACES = "face1", "face2"
_INDICES = "from", "to"


class PairList(NamedTuple):
    """Pairs of points: keywords of `line_of_sight`, and what their rows say besides."""

    observers: np.ndarray  # (n, 3) float64
    targets: np.ndarray  # (n, 3) float64
    normals: np.ndarray | None  # (n, 3) float64
    target_normals: np.ndarray | None
    faces: np.ndarray | None  # (n,) int64
    target_faces: np.ndarray | None
    attributes: Attributes | None = None  # other columns of the tables of points or pairs, (n,) each

    def keywords(self) -> dict[str, Any]:
        """Those of `line_of_sight`."""
        return {name: value for name, value in self._asdict().items() if name != "attributes"}


def check_pairs(text: str) -> None:
    """Raise an InputError, before a scene is read, unless `--pairs` is "all", "zip" or a readable file."""
    if text in ("all", "zip"):
        return
    check_point_file(text, "--pairs", f"all, zip, or a {', '.join(SUFFIXES)} file")


def read_pairs(path: Path) -> PairList:
    """Read pairs from a file with both points of each pair.

    - CSV with a header, Parquet, NPZ: columns x1, y1, z1, x2, y2, z2, and optionally nx1 to nz1, nx2 to nz2 (normals of
      ends on surfaces) and face1, face2 (the faces on which ends lie, -1: none)
    - NPY: (n, 6)

    Raises
    ------
    InputError
        If the file cannot be read, or a column is missing or holds anything but numbers.
    """
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        if array.ndim != 2 or array.shape[1] != 6 or array.dtype.kind not in "fiu":
            raise InputError(
                f"{path.name}: the array is {array.dtype} {array.shape}; pairs of points are (n, 6) numbers"
            )
        ends = array.astype(np.float64)
        return PairList(ends[:, :3], ends[:, 3:], None, None, None, None)
    columns, others = read_table(path, (*_ENDS, *_NORMALS, *_FACES))
    missing = [name for name in _ENDS if name not in columns]
    if missing:
        raise InputError(f"{path.name}: column {missing[0]!r} is missing; pairs need the columns {', '.join(_ENDS)}")
    first, second = (columns[n].astype(np.int64) if n in columns else None for n in _FACES)
    observers, targets = _vectors(columns, _ENDS[:3]), _vectors(columns, _ENDS[3:])
    assert observers is not None and targets is not None
    normals, target_normals = _vectors(columns, _NORMALS[:3]), _vectors(columns, _NORMALS[3:])
    return PairList(observers, targets, normals, target_normals, first, second, others)


def _vectors(columns: dict[str, np.ndarray], names: tuple[str, ...]) -> NDArray[np.float64] | None:
    """(n, 3) float64: three columns; None if one is missing."""
    return np.stack([columns[n] for n in names], 1) if all(n in columns for n in names) else None


def pairs_of(text: str, observers: Sensors, targets: Sensors) -> PairList:
    """Pairs of two lists of points: "all", "zip" (element-wise), or a file of their indices.

    The file has the columns ``from`` and ``to``, or is a .npy file of (n, 2) integers; indices start at 0.
    """
    own: Attributes = {}
    if text == "all":
        first, second = (index.ravel() for index in np.indices((len(observers), len(targets))))
    elif text == "zip":
        if len(observers) != len(targets):
            raise InputError(
                f"--pairs zip: there are {counted(len(observers), 'observer')} and "
                f"{counted(len(targets), 'target')}; use all"
            )
        first = second = np.arange(len(observers))
    else:
        first, second, own = _indices(Path(text), len(observers), len(targets))
    fields = (observers.normals, first), (targets.normals, second), (observers.faces, first), (targets.faces, second)
    normals, target_normals, faces, target_faces = (None if array is None else array[k] for array, k in fields)
    sides = ("from", observers, first), ("to", targets, second)
    others = own | {f"{side}_{name}": v[k] for side, ends, k in sides for name, v in ends.attributes.items()}
    ends = observers.points[first], targets.points[second]
    return PairList(*ends, normals, target_normals, faces, target_faces, others)


def _indices(path: Path, observers: int, targets: int) -> tuple[np.ndarray, np.ndarray, Attributes]:
    others: Attributes = {}
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        columns = dict(zip(_INDICES, array.T)) if array.ndim == 2 and array.shape[1] == 2 else {}
    else:
        columns, others = read_table(path, _INDICES)
    if len(columns) < 2:
        raise InputError(f"{path.name}: pairs of points need the columns from and to, indices from 0")
    for name, count in zip(_INDICES, (observers, targets)):
        values = columns[name]
        if (values != np.floor(values)).any() or (values < 0).any() or (values >= count).any():
            raise InputError(f"{path.name}: column {name!r} must hold whole numbers from 0 to {count - 1}")
    return columns["from"].astype(np.int64), columns["to"].astype(np.int64), others


# --- Tables, and models with lines that are green up to the block and red beyond it -----------------------------------


_MOST_LINES = 20  # most pairs in a summary
_SUMMARISED = "observer", "target", "visible", "blocked_by", "face", "distance"  # in the table of a summary
_GREEN, _RED, _GREY = (0.05, 0.6, 0.1), (0.7, 0.03, 0.03), (0.35, 0.35, 0.35)  # linear


def sight_table(scene: AnyScene, pairs: PairList, sightlines: Sightlines) -> Table:
    """A table with one row per pair; the sensor of a row is the observer."""
    names = np.array([each.name for each in scene.objects] + [""])
    targets = zip(("x2", "y2", "z2"), pairs.targets.T)
    columns = {name: Column(values, scene.unit.name, f"{name[0]} of the target") for name, values in targets}
    columns |= {
        "visible": Column(sightlines.visible, "", "the two points see each other"),
        "length": Column(sightlines.length, scene.unit.name, "distance from the observer to the target"),
        "face": Column(sightlines.face, "", "the blocking face nearest to the observer"),
        "object": Column(sightlines.object, "", "the object of this face"),
        "name": Column(names[sightlines.object], "", "the object's name"),
        **_city_columns(scene, sightlines),
        "distance": Column(sightlines.distance, scene.unit.name, "distance from the observer to the block"),
    }
    for name, values in zip(("px", "py", "pz"), sightlines.point.T):
        columns[name] = Column(values, scene.unit.name, f"{name[1]} of the point that blocks")
    observers = replace(point_sensors(pairs.observers), attributes=pairs.attributes or {})
    return Table(observers, columns, {"job": "los"}, scene)


def sight_summary(scene: AnyScene, pairs: PairList, sightlines: Sightlines, seconds: float) -> Summary:
    """How many pairs see each other, and what blocks each other one, if they are few; `seconds`: of the study."""
    n, visible = len(pairs.observers), int(sightlines.visible.sum())
    values = {"scene": scene.name, "pairs": n, "visible": visible, "seconds": seconds}
    lines = [("visible", f"{some_of(visible, n, 'pair')}")]
    if n > _MOST_LINES:
        return Summary(values, lines)
    records = [_record(scene, pairs, sightlines, k) for k in range(n)]
    rows = [[str(record[name]) for name in _SUMMARISED] for record in records]
    table = SummaryTable([heading(name) for name in _SUMMARISED], rows, leads=True)
    return Summary(values, lines, {"lines": records}, table)


def _record(scene: AnyScene, pairs: PairList, sightlines: Sightlines, k: int) -> dict[str, Any]:
    """A pair as names and values."""
    visible, face, blocker = bool(sightlines.visible[k]), int(sightlines.face[k]), int(sightlines.object[k])
    record = {
        "observer": ",".join(f"{x:g}" for x in pairs.observers[k]),
        "target": ",".join(f"{x:g}" for x in pairs.targets[k]),
        "visible": "yes" if visible else "no",
        "blocked_by": scene.objects[blocker].name if blocker >= 0 else "",
        "face": face if face >= 0 else "",
        "distance": "" if visible else round(float(sightlines.distance[k]), 4),
    }
    if not _has_types(scene) or blocker < 0:
        return record
    thing = scene.objects[blocker]
    surface = {} if scene.city is None else {"surface": str(scene.city.surface_types(face))}
    return record | {"type": thing.type, "parent": thing.parent} | surface


def _city_columns(scene: AnyScene, sightlines: Sightlines) -> dict[str, Column]:
    """Attributes of the blocking face from a city model."""
    if not _has_types(scene):
        return {}
    types, parents = (np.array([*(getattr(each, of) for each in scene.objects), ""]) for of in ("type", "parent"))
    columns = {
        "type": Column(types[sightlines.object], "", "the object's type"),
        "parent": Column(parents[sightlines.object], "", "the object that it is a part of"),
    }
    if scene.city is not None:
        surfaces = scene.city.surface_types(sightlines.face)
        columns["surface"] = Column(surfaces, "", "type of the face's semantic surface")
    return columns


def _has_types(scene: AnyScene) -> bool:
    """Whether objects have types: those of a city model, also in a store."""
    return scene.city is not None or scene.data.lacks_surfaces


def sight_model(scene: AnyScene, pairs: PairList, sightlines: Sightlines) -> bytes:
    """A GLB file of the scene and the lines."""
    corners = (corners_of(scene) - scene.origin).reshape(-1, 3)
    soup = np.arange(len(corners), dtype=np.uint32).reshape(-1, 3)
    parts = [ColouredMesh(scene.name, corners, np.broadcast_to(_GREY, corners.shape), soup)]
    hidden = ~sightlines.visible
    stop = np.where(hidden[:, None], sightlines.point, pairs.targets)
    for name, colour, begin, end in (
        ("seen", _GREEN, pairs.observers, stop),
        ("hidden", _RED, sightlines.point[hidden], pairs.targets[hidden]),
    ):
        if len(begin):
            ends = np.stack([begin, end], 1).reshape(-1, 3) - scene.origin
            lines = np.arange(len(ends), dtype=np.uint32).reshape(-1, 2)
            parts.append(ColouredMesh(name, ends, np.broadcast_to(colour, ends.shape), lines, LINES))
    known = {} if scene.crs is None else {"crs": scene.crs}
    return coloured_glb(parts, scene, {"origin": scene.origin.tolist(), "job": "los", **known})
