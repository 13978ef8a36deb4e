"""Sensors: the sample points of a study, with normals and areas, and the sightline ends made from them.

Sensors lie on faces, at vertices, on surface grids, in horizontal rasters, or at arbitrary points. Fields are validated
once, when a `Sensors` is created.
"""

from dataclasses import dataclass, field, replace
from os import PathLike
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...base.checks import as_array, choice, flag, items, number, path_of, points, quoted, unit_vectors, whole_number
from ...base.checks import points as checked_points
from ...base.errors import InputError
from ...base.wording import counted
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike, scene_of
from ...kernels.elementary import acos
from ...kernels.parallel import thread_count
from ...query.receivers import Receivers, receivers_above
from ...scene.crs import check_horizontal_crs
from ...scene.raster import CellWindow, Raster, window_of
from .raster_grid import aligned_raster, check_memory, checked_raster, plan_of, raster_in, raster_of_file

# --- Checked fields of `Sensors` --------------------------------------------------------------------------------------


NEEDED = {"face": "faces", "grid": "faces", "vertex": "corners", "raster": "raster"}
"""Kind of sensors -> the field that it requires."""

NORMAL_CURE = "leave normals out for points in free space"
"""What helps against normals without a direction."""

_STEEP = 1e-3  # slope of a normal below which a face is nearly upright
_ROUNDED = 2.0**-48  # relative distance in plan that float64 rounding explains
_ROWS = 1 << 20  # positions at a time
_UNIT = 1e-5  # tolerance of a unit length, from float32 rounding


def checked_normals(values: ArrayLike, n: int) -> NDArray[np.float64]:
    """(n, 3) float64: finite vectors of any length, normalized."""
    normals = _checked_array(values, (n, 3), "normals").astype(np.float64, copy=False)
    different = normals[:1] if normals.strides[0] == 0 else normals  # broadcast rows are all the same
    with np.errstate(over="ignore", invalid="ignore"):
        squares = np.einsum("ij,ij->i", different, different)
        if (np.abs(squares - 1.0) <= 2.0 * _UNIT).all():
            return normals
    return unit_vectors(normals, "the normal of sensor", NORMAL_CURE)


def checked_areas(values: ArrayLike, n: int) -> NDArray[np.float64]:
    """(n,) float64, finite and not negative."""
    areas = _checked_array(values, (n,), "areas").astype(np.float64, copy=False)
    if not (np.isfinite(areas) & (areas >= 0.0)).all():
        raise InputError("areas of sensors must be finite and not negative")
    return areas


def checked_indices(
    values: ArrayLike, shape: tuple[int, ...], name: str, low: int, count: int | None = None
) -> NDArray[np.int64]:
    """int64 indices of a shape, from `low` to `count` - 1; None: no upper limit."""
    indices = _checked_array(values, shape, name)
    if indices.dtype.kind == "f":
        raise InputError(f"{name} of sensors must be whole numbers, not {indices.dtype}")
    if indices.size and (indices.min() < low or (count is not None and indices.max() >= count)):
        wrong = indices.min() if indices.min() < low else indices.max()
        end = f"at least {low}" if count is None else f"from {low} to {count - 1}" if count else "left out"
        raise InputError(f"{name} of sensors hold {wrong}; they must be {end}")
    return indices.astype(np.int64, copy=False)


def checked_corners(values: ArrayLike, n: int) -> NDArray[np.int64]:
    """(faces, 3) int64, from -1 to n - 1."""
    corners = as_array(values, "corners of sensors")
    if corners.ndim != 2 or corners.shape[1] != 3:
        raise InputError(f"corners of sensors must be whole numbers (faces, 3), not {corners.shape}")
    return checked_indices(corners, corners.shape, "corners", -1, n)


def check_on_scene(sensors: "Sensors", scene: AnyScene) -> None:
    """Raise an InputError if sensors lie on faces that a scene does not have, so belong to another scene."""
    n, faces, corners = scene.n_triangles, sensors.faces, sensors.corners
    last = -1 if faces is None or not len(faces) else int(faces.max())
    if last >= n:
        raise InputError(
            f"sensors lie on face {last}, and {scene.name} has {counted(n, 'face')}; make them for this scene"
        )
    if corners is not None and len(corners) != n:
        raise InputError(
            f"corners of sensors are of {counted(len(corners), 'face')}, and {scene.name} has {n}; make them for it"
        )


def _checked_array(values: ArrayLike, shape: tuple[int, ...], name: str) -> np.ndarray:
    array = as_array(values, f"{name} of sensors", strided=True)
    if array.shape != shape:
        raise InputError(f"{name} of {shape[0]} sensors must be numbers {shape}, not {array.dtype} {array.shape}")
    return array if 0 in array.strides else np.asarray(array, order="C")  # one normal of all takes no memory


# --- Sensors ----------------------------------------------------------------------------------------------------------


KINDS = "face", "vertex", "grid", "raster", "points"
"""The kinds of `Sensors`."""

LOW = 1.0
"""Metres: lower surfaces belong to the ground, such as a pavement; higher ones may be buildings."""


class Zone(NamedTuple):
    """An area with sensors."""

    name: str
    cells: int  # all cells of its raster
    left_out: int  # cells inside buildings, which have no sensor


@dataclass(frozen=True, eq=False)
class Sensors:
    """The sample points of a study.

    points : (n, 3) float64
        World coordinates.
    normals : (n, 3) float64 or None
        Vectors towards the tested side; they are normalized. None: points in free space.
    areas : (n,) float64 or None
        Area that each sensor represents, square world units. None: points without area.
    faces : (n,) int64 or None
        The face of the scene on which each sensor lies, -1: none. None: on no faces.
    kind : str
        "face", "vertex", "grid", "raster" or "points".
    raster : Raster or None
        For the kind "raster": sensor ``row * columns + column`` is in the centre of this cell if `cells` is None.
    corners : (faces, 3) int64 or None
        For the kind "vertex": the sensor at each corner of each face, -1 for faces without area or without a sensor at
        a corner.
    cells : (n,) int64 or None
        For the kind "raster": ``row * columns + column`` of each sensor's cell. None: all cells have a sensor.
    zone : (n,) int64 or None
        For sensors in areas: the area of each, an index into `zones`.
    zones : tuple of Zone
        The areas.
    attributes : dict of str to (n,) array
        Other columns of the user's table: numbers, times, bool, or object for texts. They come through to tables of
        results.
    on_surfaces : bool or None
        For the kind "raster": whether cells without a face lie off the surfaces that the raster follows. None: if any
        cell has a face.

    Raises
    ------
    InputError
        If a field does not have one row per point, a number is out of range, or the kind needs another field: "face"
        and "grid" need `faces`, "vertex" needs `corners`, and "raster" needs `raster`.

    Examples
    --------
    >>> temple = at.examples.temple()
    >>> at.raster_sensors(temple, 2.0, height=1.6)
    Sensors(96 of kind 'raster')
    >>> sensors = at.face_sensors(temple)
    >>> sensors.points.shape, sensors.normals.shape
    ((51784, 3), (51784, 3))
    """

    points: np.ndarray
    normals: np.ndarray | None
    areas: np.ndarray | None
    faces: np.ndarray | None
    kind: str
    raster: Raster | None = None
    corners: np.ndarray | None = None
    cells: np.ndarray | None = None
    zone: np.ndarray | None = None
    zones: tuple[Zone, ...] = ()
    attributes: dict[str, np.ndarray] = field(default_factory=dict)
    on_surfaces: bool | None = None

    def __post_init__(self) -> None:
        positions = points(self.points, "points of sensors")
        n = len(positions)
        self._set("points", positions)
        self._set("zones", tuple(items(self.zones, Zone, "zones of sensors")))
        choice(self.kind, "the kind of sensors", KINDS)
        needs = NEEDED.get(self.kind)
        if needs and getattr(self, needs) is None:
            raise InputError(f'sensors of kind "{self.kind}" have no {needs}; give it, or the kind "points"')
        if self.normals is not None:
            self._set("normals", checked_normals(self.normals, n))
        if self.areas is not None:
            self._set("areas", checked_areas(self.areas, n))
        if self.faces is not None:
            self._set("faces", checked_indices(self.faces, (n,), "faces", -1))
        if self.corners is not None:
            self._set("corners", checked_corners(self.corners, n))
        if self.zone is not None:
            self._set("zone", checked_indices(self.zone, (n,), "zone", 0, len(self.zones)))
        if not isinstance(self.attributes, dict) or not all(isinstance(name, str) for name in self.attributes):
            raise InputError(f"attributes of sensors are {quoted(self.attributes)}; they must be a dict of arrays")
        for name, values in self.attributes.items():
            if not isinstance(values, np.ndarray) or values.shape != (n,):
                raise InputError(
                    f"the attribute {name!r} of sensors must be an array of {counted(n, 'value')}, one for each"
                )
        self._check_cells()

    def _set(self, name: str, value: object) -> None:
        """Set a field during initialization, since the class is frozen."""
        object.__setattr__(self, name, value)

    def _check_cells(self) -> None:
        if self.raster is None:
            if self.cells is not None:
                raise InputError("cells of sensors need a raster; give it, or leave cells out")
            return
        count = checked_raster(self.raster).n_cells
        if self.cells is not None:
            self._set("cells", checked_indices(self.cells, (len(self),), "cells", 0, count))
        elif len(self) != count:
            raise InputError(f"{counted(len(self), 'sensor')} for {counted(count, 'cell')} of the raster; give cells")

    def __len__(self) -> int:
        return len(self.points)

    def __repr__(self) -> str:
        return f"Sensors({len(self)} of kind {self.kind!r})"

    @property
    def covered(self) -> np.ndarray:
        """(n,) bool: False for raster cells off the surfaces that the raster follows; True otherwise."""
        if self.kind != "raster" or self.zone is not None or self.faces is None:
            return np.ones(len(self), bool)
        return self.faces >= 0 if self._follows else np.ones(len(self), bool)

    @property
    def _follows(self) -> bool:
        """Whether cells without a face lie off the surfaces that the raster follows."""
        if self.on_surfaces is not None or self.faces is None:
            return bool(self.on_surfaces)
        return bool((self.faces >= 0).any())

    def on_raster(self, values: np.ndarray) -> np.ndarray:
        """(rows, columns) float64: the values ((n,) numbers) of `covered` cells; NaN elsewhere.

        Raises
        ------
        InputError
            If the sensors form no raster, or there is not one number per sensor.
        """
        if self.raster is None:
            raise InputError(f"sensors of kind {self.kind!r} form no raster; make them with raster_sensors")
        numbers = values if isinstance(values, np.ndarray) and values.dtype == bool else as_array(values, "values")
        if numbers.shape != (len(self),):
            raise InputError(f"values must be ({len(self)},) numbers, one for each sensor, not {numbers.shape}")
        raster_values = np.full(self.raster.rows * self.raster.columns, np.nan)
        cells = np.arange(len(self)) if self.cells is None else self.cells
        raster_values[cells[self.covered]] = numbers[self.covered]
        return raster_values.reshape(self.raster.rows, self.raster.columns)

    def take(self, index: NDArray[np.integer]) -> "Sensors":
        """Some of the sensors, of the same kind; `index`: (m,) int, ascending."""
        corners, cells = self.corners, self.cells
        if corners is not None:
            places = np.full(len(self) + 1, -1)  # the last one is that of -1
            places[index] = np.arange(len(index))
            corners = places[corners]
            corners[(corners < 0).any(1)] = -1
        if self.raster is not None:
            cells = index if cells is None else cells[index]
        fields = self.normals, self.areas, self.faces, self.zone
        normals, areas, faces, zone = (None if array is None else array[index] for array in fields)
        return Sensors(
            self.points[index], normals, areas, faces, self.kind, self.raster, corners, cells, zone, self.zones,
            self._attributes(index), self._follows if self.kind == "raster" else None,
        )  # fmt: skip

    def part(self, first: int, last: int) -> "Sensors":
        """The sensors from `first` to `last`, exclusive, as single points."""
        first, last = (whole_number(each, "a number of sensors", 0, len(self)) for each in (first, last))
        fields = self.normals, self.areas, self.faces, self.zone
        normals, areas, faces, zone = (None if array is None else array[first:last] for array in fields)
        attributes = self._attributes(slice(first, last))
        return Sensors(
            self.points[first:last], normals, areas, faces, "points", zone=zone, zones=self.zones, attributes=attributes
        )

    @property
    def sided(self) -> bool:
        """Whether the sensors have normals."""
        return self.normals is not None

    @property
    def description(self) -> list[np.ndarray]:
        """What determines rays from the sensors, for digests."""
        return [self.points] if self.normals is None else [self.points, self.normals]

    def block(self, first: int, last: int) -> "Sensors":
        """As `part`, but cells remain cells: sensors in memory are their own `SensorBlocks`."""
        some = self.part(first, last)
        if self.raster is None:
            return some
        cells = np.arange(first, last) if self.cells is None else self.cells[first:last]
        return replace(some, kind=self.kind, raster=self.raster, cells=cells, on_surfaces=self._follows)

    def _attributes(self, which: NDArray[np.integer] | slice) -> dict[str, np.ndarray]:
        return {name: values[which] for name, values in self.attributes.items()}


def corners_of(scene: AnyScene, time: float = 0.0) -> NDArray[np.float64]:
    """(n, 3, 3) float64: the corners of all faces, world. InputError for a store that exceeds memory."""
    return scene.data.corners(time)


def areas_of(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit normals, NaN for faces without area; and areas."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(across, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return across / length[:, None], length / 2.0


def face_sensors(scene: SceneLike, time: float = 0.0, *, lift: float = 0.0) -> Sensors:
    """One sensor at the centre of each face with an area, on the side from which its corners run counterclockwise.

    lift : float
        World units along the normal, off the surface: more than the distance at which other surfaces are drawn on it.
    """
    scene, lift = scene_of(scene), checked_lift(lift)
    return sensors_on_faces(scene, range(scene.n_triangles), lift, time)


def sensors_on_faces(scene: AnyScene, faces: range, lift: float, time: float = 0.0) -> Sensors:
    """The sensors of `face_sensors` on some faces."""
    corners = scene.data.corners(time, None if len(faces) == scene.n_triangles else np.arange(faces.start, faces.stop))
    normals, areas = areas_of(corners)
    sound = np.flatnonzero(areas > 0.0)
    corners, normals, areas = corners[sound], normals[sound], areas[sound]
    return Sensors(corners.mean(1) + lift * normals, normals, areas, sound + faces.start, "face")


def checked_lift(lift: float) -> float:
    """The lift of sensors, if it is a finite number that is not negative; otherwise an InputError."""
    return number(lift, "the lift of sensors", 0.0, np.inf, "[)")


def vertex_sensors(scene: SceneLike, time: float = 0.0, *, lift: float = 0.0) -> Sensors:
    """One sensor at each distinct corner position, with the angle-weighted mean normal of its faces.

    Normals that cancel out (both sides of a sheet) are replaced by the normal of one of the faces. A sensor's area is a
    third of its faces' areas.

    lift : float
        As for `face_sensors`.
    """
    scene, lift = scene_of(scene), checked_lift(lift)
    corners = corners_of(scene, time)
    normals, areas = areas_of(corners)
    sound = np.flatnonzero(areas > 0.0)
    places, index = np.unique(corners[sound].reshape(-1, 3), axis=0, return_inverse=True)
    index = index.reshape(-1, 3)
    sums, shares = np.zeros_like(places), np.zeros(len(places))
    angles = _angles(corners[sound])
    for k in range(3):
        np.add.at(sums, index[:, k], normals[sound] * angles[:, k, None])
        np.add.at(shares, index[:, k], areas[sound] / 3.0)
    length = np.linalg.norm(sums, axis=1)
    opposed = length < 1e-6
    one_face = np.zeros(len(places), np.int64)
    one_face[index.ravel()] = np.repeat(sound, 3)
    sums[opposed], length[opposed] = normals[one_face[opposed]], 1.0
    every = np.full((len(corners), 3), -1, np.int64)
    every[sound] = index
    means = sums / length[:, None]
    return Sensors(places + lift * means, means, shares, one_face, "vertex", corners=every)


def _angles(corners: np.ndarray) -> np.ndarray:
    """(n, 3) float64: the angles at the corners of faces, radians."""
    after, before = np.roll(corners, -1, 1) - corners, np.roll(corners, 1, 1) - corners
    cosines = (after * before).sum(-1) / (np.linalg.norm(after, axis=-1) * np.linalg.norm(before, axis=-1))
    return np.asarray(acos(np.clip(cosines, -1.0, 1.0)))


def raster_sensors(
    scene: SceneLike, spacing: float | str | PathLike[str] | None, height: float = 0.0, *, follow: bool = True,
    bounds: ArrayLike | None = None, time: float = 0.0, threads: int | None = None,
) -> Sensors:  # fmt: skip
    """A horizontal raster of sensors that face up, at the centres of its cells.

    spacing : float, str or path-like
        Side of a cell, world units. Cell edges are multiples of it, so rasters of several scenes fit together. A path
        names a raster file, such as a GeoTIFF of heights, whose cells are used; this needs ``antumbra[gis]``. None: the
        cells of the scene's own raster, `Scene.raster`.
    height : float
        World units above the highest surface at each cell's centre if `follow`, else the coordinate on the up axis.
        Where there is no surface, `follow` uses the scene's lowest coordinate.
    bounds : ((x0, n0), (x1, n1)), or (x0, n0, x1, n1), optional
        World units along X and towards north (Y if Z is up, else -Z). Cells begin at the north-west corner. None: the
        scene's bounds.

    Raises
    ------
    InputError
        If a number is invalid, the raster file cannot be read, its cells are not square with north up, or its CRS
        differs from the scene's.
    """
    scene, follow = scene_of(scene), flag(follow, "follow")
    height = number(height, "the height of sensors")
    time, threads = scene.clamped(time), thread_count(threads)
    if bounds is None:
        raster = raster_of(scene, spacing)
    elif spacing is None or isinstance(spacing, (str, PathLike)):
        raise InputError(f"bounds and the cells of {spacing or 'a raster'} exclude each other; leave bounds out")
    else:
        raster = raster_in(bounds, number(spacing, "the spacing of sensors", 0.0, np.inf))
    return raster_cells(scene, raster, height, follow, spacing is None, time=time, threads=threads)


def raster_cells(
    scene: AnyScene, raster: Raster, height: float, follow: bool, own: bool, cells: range | None = None,
    time: float = 0.0, threads: int | None = None, window: CellWindow | None = None,
) -> Sensors:  # fmt: skip
    """Some cells of `raster_sensors`, the same to the last bit; None: all.

    own : whether the cells are those of the scene's own raster
    window : the part of the raster in which `cells` are numbered, which becomes that of the sensors; None: all
    """
    part = window or CellWindow(0, 0, raster.rows, raster.columns)
    if cells is None:
        check_memory(part.n_cells)
    up = "xyz".index(scene.up)
    numbers = np.arange(part.n_cells) if cells is None else np.arange(cells.start, cells.stop)
    at, faces = raster.places(_of_whole(numbers, part, raster), scene.up), np.full(len(numbers), -1, np.int64)
    tops = _tops_of_own_cells(scene, numbers, part) if follow and own else None
    if tops is not None:
        at[:, up], faces = tops
        at[:, up] += height
    elif follow:
        at[:, up], faces = on_top(scene, at, time, threads)
        at[:, up] += height
    else:
        at[:, up] = height
    upwards = np.broadcast_to(np.eye(3)[up], at.shape)
    areas = np.broadcast_to(raster.area, len(at))
    of = raster if window is None else window_of(raster, window)
    return Sensors(at, upwards, areas, faces, "raster", of, cells=None if cells is None else numbers)


def _of_whole(numbers: NDArray[np.int64], part: CellWindow, raster: Raster) -> NDArray[np.int64]:
    """The numbers of cells in a raster, from those in a part of it."""
    if part.columns == raster.columns:
        return numbers + part.row * raster.columns
    row, column = np.divmod(numbers, part.columns)
    return (row + part.row) * raster.columns + column + part.column


def raster_of(scene: AnyScene, spacing: float | str | PathLike[str] | None, plan: np.ndarray | None = None) -> Raster:
    """The cells of `raster_sensors` over a scene, or over bounds such as those of `plan_of`."""
    if spacing is None:
        if scene.raster is None:
            raise InputError(f"{scene.name} has no raster of its own with square cells; give a spacing: raster:SPACING")
        return scene.raster
    if not isinstance(spacing, (str, PathLike)):
        side = number(spacing, "the spacing of sensors", 0.0, np.inf)
        return aligned_raster(plan_of(scene) if plan is None else plan, side)
    raster = raster_of_file(path_of(spacing, "the raster file"))
    check_horizontal_crs(str(spacing), raster.crs, scene.crs)
    return raster


def _tops_of_own_cells(
    scene: AnyScene, numbers: NDArray[np.int64], part: CellWindow
) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Surface heights at cells of a scene of one raster, as by `on_top` but without rays; None for other scenes.

    A cell's height is that of a vertex, so the result is the same up to the rounding of rays.

    numbers : consecutive ones, in a part of the raster
    """
    first, last = (0, 0) if not len(numbers) else (int(numbers[0]), int(numbers[-1]) + 1)
    row, end = first // part.columns, -(-last // part.columns)
    if (tops := scene.data.cell_tops(part._replace(row=part.row + row, rows=end - row))) is None:
        return None
    heights, faces = (each[first - row * part.columns : last - row * part.columns] for each in tops)
    return np.where(faces >= 0, heights, scene.bounds[0, 2]), faces.astype(np.int64)


def on_top(
    scene: AnyScene, at: NDArray[np.float64], time: float = 0.0, threads: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The highest surface at each position: (n,) coordinates on the up axis, and (n,) faces, -1 where there is none.

    Without a surface, the coordinate is the lowest of the scene.
    """
    lowest, highest = scene.bounds[:, "xyz".index(scene.up)]
    start = np.full(len(at), highest + max(highest - lowest, 1.0))
    return _first_surface(scene, at, start, -1.0, time, threads)


def ground_at(
    scene: AnyScene, at: NDArray[np.float64], time: float = 0.0, threads: int | None = None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The ground at each position, in the form of `on_top`: the highest surface less than `LOW` above the lowest one.

    The ground is therefore the top of pavements and other low slabs.
    """
    lowest, highest = scene.bounds[:, "xyz".index(scene.up)]
    start = np.full(len(at), lowest - max(highest - lowest, 1.0))
    bottom, none = _first_surface(scene, at, start, 1.0, time, threads)
    ground, faces = _first_surface(scene, at, bottom + scene.unit.of_metres(LOW), -1.0, time, threads)
    return np.where(none < 0, bottom, ground), np.where(none < 0, none, faces)


def _first_surface(
    scene: AnyScene, at: np.ndarray, start: np.ndarray, sign: float, time: float, threads: int | None
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The first surface that rays hit from the heights `start`, upwards (sign 1) or downwards (-1)."""
    up = "xyz".index(scene.up)
    begin, along = at.copy(), np.zeros(3)
    begin[:, up], along[up] = start, sign
    hit = scene.closest_hit(begin, along, time=time, threads=threads)
    heights = np.where(hit.mask, start + sign * np.where(hit.mask, hit.t, 0.0), scene.bounds[0, up])
    if scene.data.terrain is None:  # whose triangles would be made for this
        hits = np.flatnonzero(hit.mask)
        for some in np.split(hits, range(_ROWS, len(hits), _ROWS)):
            corners = scene.data.corners(time, hit.face[some]) if scene.data.resident else hit.corners[some]
            heights[some] = _heights_on(corners, at[some], heights[some], up)
    return heights, hit.face.astype(np.int64)


def _heights_on(corners: np.ndarray, at: np.ndarray, heights: np.ndarray, up: int) -> NDArray[np.float64]:
    """(n,) float64: the heights of faces, (n, 3, 3), at positions: in float64, independent of the scene's frame.

    heights : those from rays in float32, which stay for faces that are nearly upright

    Positions at a corner have its height, to the last bit: cells of a raster, whichever of its triangles a ray meets.
    """
    away, normals = at - corners[:, 0], np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    plan = [axis for axis in range(3) if axis != up]
    steep = np.abs(normals[:, up]) <= _STEEP * np.abs(normals[:, plan]).max(1)  # also without area, rounded away
    rise = -(away[:, plan] * normals[:, plan]).sum(1) / np.where(steep, 1.0, normals[:, up])
    on = np.clip(corners[:, 0, up] + rise, corners[..., up].min(1), corners[..., up].max(1))
    same = (np.abs(corners - at[:, None]) <= _ROUNDED * np.abs(at[:, None]))[..., plan].all(2)
    on = np.where(same.any(1), corners[np.arange(len(at)), same.argmax(1), up], on)
    return np.where(steep, heights, on)


def point_sensors(at: ArrayLike, normals: ArrayLike | None = None, areas: ArrayLike | None = None) -> Sensors:
    """Sensors at arbitrary points.

    at : (n, 3) float
        World coordinates.
    normals : (n, 3) float, optional
        Vectors of any length. None: the points lie in free space.
    areas : (n,) float, optional
        Square world units.
    """
    where, unit, sizes = points(at, "points of sensors"), None, None
    if normals is not None:
        directions = points(normals, "normals of sensors")
        if directions.shape != where.shape:
            raise InputError(
                f"normals of sensors must be one for each of {counted(len(where), 'point')}, not {directions.shape}"
            )
        unit = unit_vectors(directions, "the normal of sensor", NORMAL_CURE)
    if areas is not None:
        sizes = as_array(areas, "areas of sensors").astype(np.float64)
        if sizes.shape != where.shape[:1] or not (np.isfinite(sizes) & (sizes >= 0.0)).all():
            raise InputError("areas of sensors must be one for each point, finite and not negative")
    return Sensors(where, unit, sizes, None, "points")


# --- Sightline ends, in the float32 frame in which sightlines are exact -----------------------------------------------


def sightline_ends(scene: AnyScene, sensors: Sensors) -> Receivers:
    """Sensors as sightline ends. Those with normals lie on surfaces and are moved off them (docs/design/receivers.md).

    Raster cells are moved up from the surface below but have no horizon, since that surface may be steep.
    """
    axis, normals = "xyz".index(scene.up), sensors.normals
    if sensors.kind == "raster" and normals is not None and normals.strides[0] == 0 and normals[:1, axis].all():
        return receivers_above(
            sensors.points, axis, scene.origin, scene.middle
        )  # those of `raster_sensors`: one normal for all
    ends = Receivers.of(sensors.points, sensors.normals, scene.origin, scene.middle)
    return ends.seeing_all_around() if sensors.kind == "raster" else ends


def sensors_from(scene: AnyScene, sensors: ArrayLike | Sensors, normals: ArrayLike | None, what: str) -> Sensors:
    """`sensors` if they are `Sensors` of the scene, else sensors made of points; `what` names them in errors."""
    if isinstance(sensors, Sensors):
        check_on_scene(sensors, scene)
        return sensors
    where = checked_points(sensors, what)
    if normals is not None:
        normals = np.atleast_2d(as_array(normals, f"normals of {what}"))
        if len(normals) not in (1, len(where)):
            raise InputError(f"normals of {what} must be one, or one for each of {len(where)}, not {normals.shape}")
        normals = np.broadcast_to(checked_points(normals, f"normals of {what}"), where.shape)
    return point_sensors(where, normals)
