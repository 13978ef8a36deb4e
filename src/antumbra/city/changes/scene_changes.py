"""Scenes with objects added and removed: their states before and after, and what both have.

All states have the same frame, faces and objects. Those that a state lacks are hidden in it, so the sensors of one
state are those of all, and the bits of a sensor change only where something new blocks it, or something is gone.
"""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import replace
from difflib import get_close_matches
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import items, quoted, vector
from ...base.errors import InputError
from ...base.wording import counted, place_text, some_of
from ...engine.scene import AnyScene, Scene
from ...engine.scene_loading import SceneLike, load, scene_of
from ...formats.example_files import scene_path
from ...formats.format_registry import format_of
from ...formats.scene_format import Contents
from ...scene.crs import check_horizontal_crs
from ...scene.instance_data import InstanceData
from ...scene.joined_scenes import PlacedSource, join_data
from ...scene.mesh import Source
from ...scene.scene_bounds import plan_bounds
from ...scene.scene_data import MemoryData
from ...scene.units import METRE
from ..gis.footprint_solids import BuildingSolids
from ..gis.gis_scenes import from_footprints
from ..sensors.ground_areas import AreaLike, covered_by_solids, inside_solids
from ..sensors.point_checks import tell
from ..sensors.sensor_files import kind_of, sensors_of
from ..sensors.sensors import LOW, Sensors, ground_at, sensors_from
from ..tables.result_table import Table
from .before_and_after import before_and_after

Addition: TypeAlias = "SceneLike | tuple[SceneLike, ArrayLike]"
"""An object to add: a scene, or anything that `load` takes; or a pair of this and the world position of its origin."""

_METRES = ".glb", ".gltf"  # formats that prescribe metres
_MOST_NAMES = 3  # in errors
_REACH = 0.01  # metres before a wall: what covers it is nearer
_LEVEL = 0.7  # height of a unit normal: floors and roofs are less steep

# --- Changes ----------------------------------------------------------------------------------------------------------


class SceneChange(NamedTuple):
    """A scene before and after a change, made by `scene_change`."""

    before: Scene  # without what is added
    after: Scene  # without what is removed
    kept: Scene | None  # without both: what the two states share, on which sensors lie; None: nothing
    changed: Scene | None  # only what is added and removed; None: nothing
    n_faces: int  # of the scene itself; those of the added objects follow
    notes: tuple[str, ...]  # what was placed where, and what was removed

    def sensors(
        self, sensors: Sensors | ArrayLike | str = "face", areas: AreaLike | None = None, threads: int | None = None
    ) -> Sensors:
        """The sensors for studies of both states.

        Sensors that a text such as ``grid:1`` makes lie on the surfaces of both states; those inside an object that is
        added or removed, such as the ground below a new building, are left out. Points from a file or an array are all
        kept.

        Parameters
        ----------
        sensors : Sensors, str, or (n, 3) float
            As in `antumbra.sun_hours`.
        areas : optional
            As in `antumbra.area_sensors`.
        threads : int, optional
            None: all cores.
        """
        if not isinstance(sensors, str):
            frame = self.before if self.kept is None else self.kept
            return self.exposed(sensors_from(frame, sensors, None, "sensors"), threads, "points")
        return self.exposed(sensors_of(sensors, self.shared(), threads, areas), threads, kind_of(sensors))

    def shared(self) -> Scene:
        """What the two states share. Raises an InputError if that is nothing."""
        if self.kept is None:
            raise InputError(f"{self.after.name}: both states share no surface for sensors or trees; keep one")
        return self.kept

    def exposed(self, sensors: Sensors, threads: int | None = None, kind: str = "") -> Sensors:
        """The sensors that no added or removed object covers; those of the kind "points" are all kept, with a note.

        A sensor is covered if it lies inside a closed object, from its surface, or for floors from 1 m above it.
        """
        if self.changed is None:
            return sensors
        normals = np.zeros_like(sensors.points) if sensors.normals is None else sensors.normals
        covered = _covered(self.changed, sensors.points, normals, threads)
        if not covered.any():
            return sensors
        told = f"{some_of(covered.sum(), len(sensors), 'sensor', 'lie')} inside what is added or removed, "
        if (kind or sensors.kind) == "points" or sensors.normals is None:
            first = place_text(sensors.points[covered.argmax()])
            tell([f"{told}so one state means nothing there; the first is {first}"])
            return sensors
        tell([f"{told}so left out"])
        zones = sensors.zones
        if sensors.zone is not None:
            more = np.bincount(sensors.zone[covered], minlength=len(zones))
            zones = tuple(each._replace(left_out=each.left_out + int(n)) for each, n in zip(zones, more))
        return replace(sensors.take(np.flatnonzero(~covered)), zones=zones)

    def state(self, scene: AnyScene, name: str) -> Scene:
        """A state, "before" or "after", of the kept scene with further objects, such as the plants of `from_trees`."""
        data = cast(MemoryData, scene.data)
        hidden = ~_shown(cast(MemoryData, getattr(self, name).data))
        return Scene.of_data(data.hiding(np.concatenate([hidden, np.zeros(data.n_triangles - len(hidden), bool)])))

    def compare(self, study: Callable[..., Any], sensors: Any = "face", **keywords: Any) -> Table:
        """Run a study of both states on the same sensors.

        Parameters
        ----------
        study : function
            `antumbra.sun_hours`, `antumbra.sky_view`, `antumbra.visible_share`, or another function of a scene and
            sensors that returns a `Table`; or `antumbra.viewshed`, whose table counts.
        sensors
            As for `sensors`.
        **keywords
            Further arguments of the study; with `areas`, the sensors lie in these.

        Returns
        -------
        Table
            As `antumbra.before_and_after` joins the tables of the two states. ``about["change"]`` lists what was added
            and removed.

        Raises
        ------
        InputError
            As the study does.
        """
        if not callable(study):
            raise InputError(f"study is {quoted(study)}; give a function such as antumbra.sun_hours")
        areas = keywords.pop("areas", None)
        on = self.sensors(sensors, areas, keywords.get("threads"))
        with warnings.catch_warnings(action="ignore", category=UserWarning):  # the same notes follow
            before = study(self.before, on, **keywords)
        after = study(self.after, on, **keywords)
        table = before_and_after(getattr(before, "table", before), getattr(after, "table", after))
        table.about["change"] = list(self.notes)
        return table


def _covered(
    changed: Scene, points: NDArray[np.float64], normals: NDArray[np.float64], threads: int | None
) -> NDArray[np.bool_]:
    """(n,) bool: whether points on surfaces with these unit normals, or none (0), lie inside the objects of a scene."""
    up = "xyz".index(changed.up)
    reach, out = changed.unit.of_metres(_REACH), np.zeros(len(points), bool)
    corners = changed.data.corners(0.0, np.flatnonzero(_shown(cast(MemoryData, changed.data)))).reshape(-1, 3)
    margin = changed.unit.of_metres(2.0 * LOW)
    near = np.flatnonzero(((points >= corners.min(0) - margin) & (points <= corners.max(0) + margin)).all(1))
    level = normals[near, up] > _LEVEL
    floors, others = near[level], near[~level]
    if len(floors):
        out[floors] = covered_by_solids(changed, points[floors], threads)
    if len(others):
        out[others] = inside_solids(changed, points[others] + reach * normals[others], threads)
    return out


def _shown(data: MemoryData) -> NDArray[np.bool_]:
    """(n,) bool: the faces that are not hidden."""
    return np.ones(data.n_triangles, bool) if data.hidden is None else ~data.hidden


# --- Making them ------------------------------------------------------------------------------------------------------


def changed_scene(
    scene: SceneLike, add: "Addition | list[Addition] | None" = None, remove: str | Iterable[str] = ()
) -> Scene:
    """A scene with objects added and removed: `SceneChange.after` of `scene_change`, with the same parameters."""
    return scene_change(scene, add, remove).after


def scene_change(
    scene: SceneLike, add: "Addition | list[Addition] | None" = None, remove: str | Iterable[str] = ()
) -> SceneChange:
    """Make the states of a scene before and after objects are added and removed.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
        It stays unchanged. It must be in memory.
    add : scene, path, mesh, or a list of these, optional
        What is added, each a scene or anything that `load` takes, or a pair of it and the world position, (x, y, z), of
        its origin. Without a position, its coordinates are those of the scene. Another axis that points up is turned
        up; lengths with a unit, a CRS or in glTF are converted to the unit of the scene. Buildings of
        `antumbra.from_footprints` without a base, at 0, stand on the lowest ground below them, if no position is given.
    remove : str or list of str, optional
        Names of objects of `scene`, such as ids of CityJSON or of footprints, or nodes of glTF. A building includes its
        parts.

    Returns
    -------
    SceneChange

    Raises
    ------
    InputError
        If something cannot be read, an object is unknown, nothing is left, or a scene is in a store; or if an addition
        has a CRS whose horizontal part differs from that of the scene, lies farther beside the scene than this is wide,
        or is a footprint without a base and without ground below it.

    Examples
    --------
    >>> scene = at.procedural("city", triangles=5_000)
    >>> box = at.Scene.from_arrays([[0, 0, 0], [9, 0, 0], [0, 40, 0]], [[0, 1, 2]])
    >>> change = at.scene_change(scene, add=[(box, (0, 0, 0))])
    >>> table = change.compare(at.sky_view, "raster:20", directions=64)
    >>> list(table.columns)
    ['sky_view_loss', 'sky_view_before', 'sky_view', 'sky_share_loss', 'sky_share_before', 'sky_share']
    """
    base = _in_memory(scene_of(scene))
    removed, notes = _named(base, [remove] if isinstance(remove, str) else items(remove, str, "remove")), list[str]()
    if removed.any():
        names = _names_of(base, removed)
        notes.append(f"removed {', '.join(names[:_MOST_NAMES])}{', ...' if len(names) > _MOST_NAMES else ''}")
    data = base
    for each in add if isinstance(add, list) else [] if add is None else [add]:
        part, note = _placed(each, base)
        notes.append(note)
        data = join_data(data, part, base.name)
    removed = np.concatenate([removed, np.zeros(data.n_triangles - base.n_triangles, bool)])
    return _change(data, base.n_triangles, removed, notes)


def scene_variant(scene: SceneLike, variant: Addition) -> SceneChange:
    """Make the states of a scene and of a variant, such as another design, like `scene_change`.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
        The state before.
    variant : scene, path, mesh, or a pair of one of these and the world position of its origin
        The state after, placed as what `scene_change` adds. Its faces with the corners, the colour, the texture and the
        normals of a face of the scene, to the bit, are that face.

    Raises
    ------
    InputError
        As `scene_change` does.

    Examples
    --------
    >>> scene = at.procedural("city", triangles=5_000)
    >>> change = at.scene_variant(scene, scene)
    >>> change.changed is None
    True
    """
    base = _in_memory(scene_of(scene))
    part, note = _placed(variant, base)
    data, n = join_data(base, part, base.name), base.n_triangles
    triangles = data.triangles()
    rows = np.concatenate([triangles.vertices.reshape(-1, 9), triangles.colour, _looks(data)], axis=1)
    _, kind = np.unique(rows.view(np.dtype((np.void, rows.shape[1] * 4))).ravel(), return_inverse=True)
    shared = np.isin(kind[n:], kind[:n][_shown(base)])
    removed = np.concatenate([~np.isin(kind[:n], kind[n:][_shown(part)]), np.zeros(len(shared), bool)])
    repeated = np.concatenate([np.zeros(n, bool), shared])
    return _change(data.hiding(repeated | ~_shown(data)), n, removed, [note.replace("added", "variant", 1)])


def _looks(data: MemoryData) -> NDArray[np.float32]:
    """(n, k) float32: what faces show besides their colour: the image and tint of textures, and values of corners."""
    appearance, n = data.appearance, data.n_triangles
    if appearance is None:
        return np.zeros((n, 0), np.float32)
    images: dict[Any, int] = {}
    tints = np.zeros((len(appearance.materials) + 1, 4), np.float32)  # the last row is that of faces without material
    for k, (_, factor, texture, *_) in enumerate(appearance.materials):
        picture = None if texture is None or texture.picture is None else bytes(texture.picture)
        image = texture and (picture, texture.opacity, texture.wrap_s, texture.wrap_t, texture.nearest)
        tints[k] = images.setdefault(image, len(images)), *factor[:3]
    shows = appearance.textured if appearance.colours is None else np.ones(n, bool)
    corners = [appearance.uv, appearance.colours, appearance.normals]
    columns = [each.reshape(n, -1) for each in corners if each is not None]
    return np.concatenate([tints[appearance.material_of_face] * shows[:, None], *columns], axis=1)


def _change(data: MemoryData, n_faces: int, removed: NDArray[np.bool_], notes: list[str]) -> SceneChange:
    """The states of joined data whose faces from `n_faces` on are added. Faces that it hides are in no state."""
    added, gone = np.arange(data.n_triangles) >= n_faces, ~_shown(data)
    if data.animated and removed.any() | added.any():
        raise InputError(f"{data.name}: is animated, and objects are added and removed in static scenes")
    before, after = (Scene.of_data(data.hiding(each | gone)) for each in (added, removed))
    parts = added | removed | gone, gone | ~(added | removed)
    kept, changed = (None if hidden.all() else Scene.of_data(data.hiding(hidden)) for hidden in parts)
    return SceneChange(before, after, kept, changed, n_faces, tuple(notes))


def _in_memory(scene: AnyScene) -> MemoryData:
    """The data of a scene with all its triangles."""
    if not scene.data.resident:
        raise InputError(f"{scene.name} is in a store, and objects are added to scenes in memory; load its source file")
    data = scene.data
    return data.flattened() if isinstance(data, InstanceData) else cast(MemoryData, data)


def _named(data: MemoryData, names: list[str]) -> NDArray[np.bool_]:
    """(n,) bool: the faces of objects with these names, or whose outermost object has one of them."""
    chosen = np.zeros(len(data.objects), bool)
    for name in names:
        these = np.array([name in (each.name, each.parent) for each in data.objects], bool)
        if not name or not these.any():
            known = list({word for each in data.objects for word in (each.parent, each.name) if word})
            near = get_close_matches(name, known, _MOST_NAMES, 0.4) or sorted(known)[:_MOST_NAMES]
            hint = f"similar ones are {', '.join(near)}" if near else "its objects have no names"
            raise InputError(f"remove is {quoted(name)}, and {data.name} has no such object; {hint}")
        chosen |= these
    return np.asarray(chosen[data.object_of_face])


def _names_of(data: MemoryData, faces: NDArray[np.bool_]) -> list[str]:
    """The outermost objects of faces."""
    used = np.unique(data.object_of_face[faces]).tolist()
    return list(dict.fromkeys(data.objects[k].parent or data.objects[k].name for k in used))


# --- Placing additions ------------------------------------------------------------------------------------------------


def _placed(addition: Any, base: MemoryData) -> tuple[MemoryData, str]:
    """The data of an addition in the coordinates of a scene, and a note on where it is."""
    what, at = addition if isinstance(addition, tuple) and len(addition) == 2 else (addition, None)
    scene = _loaded(what, base)
    part = _in_memory(scene)
    check_horizontal_crs(part.name, part.crs, base.crs)
    turn = np.eye(3) if part.up == base.up else _UPRIGHT if base.up == "z" else _UPRIGHT.T
    offsets = np.zeros(3) if at is None else vector(at, f"the position of {part.name}")
    source: Source = PlacedSource(part.source, _scale(part, base) * turn, offsets)
    words = "" if part.up == base.up else f", turned from {part.up} up"
    if at is None and _on_ground(part):
        grounds = _grounds(source, part, base)
        source = PlacedSource(part.source, _scale(part, base) * turn, grounds)
        words = f"{words}, on the ground"
    data = MemoryData(
        source, name=part.name, up=base.up, notes=part.notes, city=part.city, crs=base.crs, unit=base.given_unit
    )
    data.cutouts = part.cutouts
    _check_beside(data, base)
    low, high = data.bounds.tolist()
    spans = (f"{axis} {a:.9g} to {b:.9g}" for axis, a, b in zip("xyz", low, high))
    return data.hiding(
        ~_shown(part)
    ), f"added {part.name}: {counted(part.n_triangles, 'triangle')}, {', '.join(spans)}{words}"


_UPRIGHT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Turns +Y up to +Z up."""


def _loaded(what: Any, base: MemoryData) -> AnyScene:
    """The scene that an addition is, or that is read: footprints in the CRS of the scene to which they are added."""
    if isinstance(what, (str, PathLike)):
        path = scene_path(what, "add")
        known = format_of(path)
        if known is not None and known.contents is Contents.FOOTPRINTS:
            return from_footprints(path, crs=base.crs)
        return load(path, instances=False if path.suffix.lower() in _METRES else None)
    return scene_of(what)


def _scale(part: MemoryData, base: MemoryData) -> float:
    """World units of a scene per unit of an addition; without any unit, they are the same."""
    known = part.given_unit is not None or part.crs is not None
    prescribed = Path(part.source.file).suffix.lower() in _METRES
    return (part.unit if known else METRE if prescribed else base.unit).metres / base.unit.metres


def _on_ground(part: MemoryData) -> bool:
    """Whether an addition is footprints whose floors have no heights of their own."""
    solids = part.source
    return isinstance(solids, BuildingSolids) and solids.terrain is None and float(part.bounds[0, 2]) == 0.0


def _grounds(source: Source, part: MemoryData, base: MemoryData) -> NDArray[np.float64]:
    """(objects, 3) float64: the ways up from 0 to the lowest ground of a scene below each object.

    Raises
    ------
    InputError
        If there is no ground below an object.
    """
    up, flat = "xyz".index(base.up), MemoryData(source, up=base.up)
    places = np.einsum("pk,nkj->npj", _WITHIN, flat.corners()).reshape(-1, 3)
    heights, faces = ground_at(Scene.of_data(base), places)
    heights[faces < 0] = np.inf
    lowest = np.full(len(part.objects), np.inf)
    np.minimum.at(lowest, np.repeat(flat.object_of_face, len(_WITHIN)), heights)
    if np.isinf(lowest).any():
        name = part.objects[int(np.argmax(lowest))].name
        raise InputError(
            f"{part.name}: {quoted(name)} has no ground of {base.name} below it; give its base, such as base=12.5"
        )
    out = np.zeros((len(lowest), 3))
    out[:, up] = lowest
    return out


_STEPS = np.arange(5) / 4.0
_WITHIN = np.array([(1.0 - a - b, a, b) for a in _STEPS for b in _STEPS if a + b <= 1.0])
"""(15, 3): weights of the corners of a face for places in it, among them its corners."""


def _check_beside(part: MemoryData, base: MemoryData) -> None:
    """Raise an InputError if an addition lies farther beside the scene than this is wide: it was not placed there."""
    (low, high), (first, last) = plan_bounds(base.bounds, base.up), plan_bounds(part.bounds, base.up)
    width = float((high - low).max())
    if ((first > high + width) | (last < low - width)).any():
        here, there = (place_text(xy) for xy in ((first + last) / 2.0, (low + high) / 2.0))
        raise InputError(
            f"{part.name}: would lie at {here}, far beside {base.name} at {there}; give the position of its origin, or "
            "the axis of the file that points up"
        )
