"""Ground areas, such as gardens, from GeoJSON or Python; their sensors, and a test for points inside buildings.

Exact rays towards the sky find points inside solids: along a ray that leaves a closed surface, back faces outnumber
front faces. The difference is the winding number, which stays correct where solids overlap or share walls. Real models
have holes, missing floors and sheets such as canopies, so several rays vote, all of them upwards: missing floors and
hillsides then do no harm. Horizontal rays that count only walls find the roofs of buildings with neither a floor nor
ground below them.
"""

import json
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.checks import flag, number, path_of
from ...base.errors import InputError
from ...base.files import checked_file
from ...base.wording import some_of
from ...engine.measured_scenes import measured_scene
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike
from ...kernels.elementary import cos, sin
from ...kernels.parallel import thread_count
from ...query.receivers import Receivers
from ...scene.crs import checked_crs, reproject
from ...scene.raster import Raster
from ...scene.units import Metres
from .sensors import LOW, Sensors, Zone, ground_at, raster_of

# --- Points inside solids ---------------------------------------------------------------------------------------------


_RAYS = 16
_SHARE = 0.75  # share of the rays that must leave a solid
_LOWEST = 0.2  # height of the lowest ray's unit vector
_DEPTHS = 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 9.0, 13.0, 20.0, 40.0  # metres below a roof, of horizontal rays
_STEEP = 0.5  # height of a unit normal: steeper faces are walls
_AT_A_TIME = 1 << 12  # points


def covered_by_solids(scene: AnyScene, points: NDArray[np.float64], threads: int | None = None) -> NDArray[np.bool_]:
    """(n,) bool: whether ground points, or the points `LOW` above them, lie inside solids.

    The second test is needed because floors of buildings often lie a little above or below the ground.

    points : (n, 3) float64, world
    """
    above = scene.unit.of_metres(LOW) * np.eye(3)["xyz".index(scene.up)]
    return inside_solids(scene, points, threads) | inside_solids(scene, points + above, threads)


def inside_solids(scene: AnyScene, points: NDArray[np.float64], threads: int | None = None) -> NDArray[np.bool_]:
    """(n,) bool: whether points lie inside closed surfaces. Points on surfaces that face up lie above them.

    Alpha-masked faces do not count: they are leaves and fences.

    points : (n, 3) float64, world
    """
    begin = Receivers.on_surface(points, np.eye(3)["xyz".index(scene.up)], scene.origin, scene.middle)
    return _leaves_solid(scene, begin.origins[0], _rays(scene.up, _LOWEST, 1.0), False, threads)


def below_roofs(
    scene: AnyScene, points: NDArray[np.float64], floor: NDArray[np.float64], threads: int | None = None
) -> NDArray[np.bool_]:
    """(n,) bool: whether surfaces are roofs of buildings with neither a floor nor ground below them.

    The roof is then the lowest surface, but somewhere below it there are walls all around.

    points : (n, 3) float64, world, on the surfaces
    floor : (n,) float64, the height of the lowest ground around
    """
    up = "xyz".index(scene.up)
    roofs, rays = np.zeros(len(points), bool), _rays(scene.up, 0.01, 0.05)
    lowest = floor + scene.unit.of_metres(LOW)
    for depth in _DEPTHS:
        at = points.copy()
        at[:, up] = np.maximum(points[:, up] - scene.unit.of_metres(depth), lowest)
        high = np.flatnonzero((points[:, up] > lowest) & ~roofs)
        if len(high):
            roofs[high] = _leaves_solid(
                scene, Receivers.in_space(at[high], scene.origin).origins[0], rays, True, threads
            )
    return roofs


def _leaves_solid(scene: AnyScene, begin: np.ndarray, rays: np.ndarray, walls: bool, threads: int | None) -> np.ndarray:
    """(n,) bool: whether most rays from each point leave a solid.

    begin : (n, 3) float32, recentred
    rays : (_RAYS, 3) float64, unit vectors
    walls : count only steep faces
    """
    reach = 2.0 * float(np.linalg.norm(np.ptp(scene.bounds, axis=0))) + 1.0
    inside = np.zeros(len(begin), bool)
    for first in range(0, len(begin), _AT_A_TIME):
        batch = begin[first : first + _AT_A_TIME]
        origins = np.repeat(batch, _RAYS, 0)
        ends = (origins + np.tile(reach * rays, (len(batch), 1))).astype(np.float32)
        hits = scene.all_hits(origins + scene.origin, targets=ends + scene.origin, merge="surface", threads=threads)
        normals, ray = _solid_normals(scene, hits.face, walls), hits.ray
        signs = np.sign((normals * (ends.astype(np.float64) - origins)[ray]).sum(1))
        winding = np.bincount(ray, signs, len(origins)).reshape(-1, _RAYS)
        inside[first : first + _AT_A_TIME] = (winding != 0.0).mean(1) >= _SHARE
    return inside


def _solid_normals(scene: AnyScene, faces: NDArray[np.integer], walls: bool) -> NDArray[np.float64]:
    """(k, 3) float64: normals of faces, of any length; zero for alpha-masked faces, and for flat ones if `walls`."""
    each, of = np.unique(faces, return_inverse=True)
    corners = scene.data.corners(faces=each)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if walls:
        flat = np.abs(normals[:, "xyz".index(scene.up)]) > _STEEP * np.linalg.norm(normals, axis=1)
        normals[flat] = 0.0
    if (cutouts := scene.data.cutouts) is not None:
        normals[np.isin(each, cutouts.faces)] = 0.0
    return normals[of]


def _rays(up: str, lowest: float, highest: float) -> np.ndarray:
    """(_RAYS, 3) float64: unit vectors on a spiral, none of them along an axis, since edges of models often are."""
    i = np.arange(_RAYS)
    height, angle = lowest + (highest - lowest) * (i + 0.5) / _RAYS, 0.3 + i * np.pi * (3.0 - np.sqrt(5.0))
    width = np.sqrt(1.0 - height * height)
    east, north = width * cos(angle), width * sin(angle)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=1)


# --- Polygons and their sensors ---------------------------------------------------------------------------------------


SPACING = Metres(0.5)
"""Default cell size of areas."""

SUFFIXES = (".geojson", ".json")
_WORLD = "EPSG:4326"  # CRS of GeoJSON that names none [RFC 7946]


class Area(NamedTuple):
    """A ground area."""

    name: str
    rings: list[np.ndarray]  # (k, 2) float64 each: easting and northing; includes holes and further polygons


AreaLike: TypeAlias = Any
"""What `area_sensors` accepts as areas: a path, GeoJSON, an object with ``__geo_interface__``, or rings."""


def area_sensors(
    scene: SceneLike, areas: AreaLike, spacing: float | str | PathLike[str] | None = SPACING, height: float = 0.0, *,
    follow: bool = True, threads: int | None = None,
) -> Sensors:  # fmt: skip
    """Place sensors on the ground of areas, such as gardens: raster cells whose centres lie inside the areas.

    The ground is the lowest surface, or the top of a slab there that is less than 1 m thick, so no sensor lies on a
    roof. Cells inside buildings are left out.

    Parameters
    ----------
    scene : Scene, or anything that `antumbra.load` takes
    areas : str, path-like, dict, or sequence
        A GeoJSON file or object of Polygons and MultiPolygons; an object with ``__geo_interface__``, such as a shapely
        polygon or a GeoDataFrame; a sequence of (k, 2) rings, in easting and northing of the scene; or a dict from
        names to any of these. GeoJSON is in WGS 84 unless it names a CRS or its numbers cannot be degrees.
    spacing : float, str or path-like
        As in `raster_sensors`; half a metre by default, in any unit of the scene.
    height : float
        World units above the ground if `follow`, else the coordinate on the up axis.
    threads : int, optional
        None: all cores.

    Raises
    ------
    InputError
        If areas cannot be read, hold no cell, or have no ground below them.
    """
    scene, follow, threads = measured_scene(scene), flag(follow, "follow"), thread_count(threads)
    height = number(height, "the height of sensors")
    polygons = list(read_areas(areas, scene.crs))
    if not polygons:
        raise InputError("areas are empty; give at least one polygon")
    corners = np.concatenate([ring for area in polygons for ring in area.rings])
    spacing = scene.unit.of_metres(spacing) if isinstance(spacing, Metres) else spacing
    raster = raster_of(scene, spacing, np.stack([corners.min(0), corners.max(0)]))
    cells = [_cells_in(area, raster) for area in polygons]
    cell, zone = np.concatenate(cells), np.repeat(np.arange(len(polygons)), [len(each) for each in cells])
    at, faces, up = raster.places(cell, scene.up), np.full(len(cell), -1, np.int64), "xyz".index(scene.up)
    if follow:
        at[:, up], faces = ground_at(scene, at, 0.0, threads)
        _check_ground(polygons, zone, faces)
        floor = np.array([at[zone == k, up].min() for k in range(len(polygons))])
        excluded = below_roofs(scene, at, floor[zone], threads)
        at[:, up] += height
    else:
        at[:, up], excluded = height, np.zeros(len(at), bool)
    excluded |= covered_by_solids(scene, at, threads)
    zones = [
        Zone(area.name, len(each), int(excluded[zone == k].sum()))
        for k, (area, each) in enumerate(zip(polygons, cells))
    ]
    normals, sizes = np.broadcast_to(np.eye(3)[up], at.shape), np.full(len(at), raster.area)
    included = ~excluded
    return Sensors(
        at[included], normals[included], sizes[included], faces[included], "raster", raster,
        cells=cell[included], zone=zone[included], zones=tuple(zones),
    )  # fmt: skip


def default_cells(scene: AnyScene) -> str:
    """The text of the default sensors in areas, as in `sensors_of`."""
    return f"raster:{scene.unit.of_metres(SPACING):.9g}"


def check_areas(path: Path) -> None:
    """Raise an InputError, before a scene is read, unless a path names a GeoJSON file."""
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"--areas is {str(path)!r}; it must be a {' or '.join(SUFFIXES)} file")
    checked_file(path, path.name)


def read_areas(areas: AreaLike, crs: str | None) -> Iterator[Area]:
    """Yield the areas of any input of `area_sensors`, in the coordinates of a scene with this CRS."""
    if isinstance(areas, (str, PathLike)):
        path = path_of(areas, "areas")
        checked_file(path, path.name)
        try:
            yield from _of_json(json.loads(path.read_bytes()), crs, path.name, None)
        except ValueError as error:
            if isinstance(error, InputError):
                raise
            raise InputError(f"{path.name}: is not GeoJSON ({str(error)[:80]}); export it again") from None
    elif hasattr(areas, "__geo_interface__"):
        data_crs = getattr(areas, "crs", None)
        yield from _of_json(areas.__geo_interface__, crs, "areas", crs if data_crs is None else checked_crs(data_crs))
    elif isinstance(areas, Mapping) and "type" in areas:
        yield from _of_json(areas, crs, "areas", None)
    elif isinstance(areas, Mapping):
        for name, each in areas.items():
            yield Area(str(name), [ring for area in read_areas([each], crs) for ring in area.rings])
    elif isinstance(areas, (list, tuple)):
        for k, each in enumerate(areas):
            if hasattr(each, "__geo_interface__") or isinstance(each, Mapping):
                yield from (area._replace(name=f"area {k + 1}") for area in read_areas(each, crs))
            else:
                yield Area(f"area {k + 1}", [_ring(each, f"area {k + 1}")])
    else:
        raise InputError(f"areas are a {type(areas).__name__}; give GeoJSON, or a list of rings ((k, 2) numbers)")


def _of_json(root: Any, crs: str | None, where: str, data_crs: str | None) -> Iterator[Area]:
    """Yield the areas of GeoJSON. data_crs: the CRS of its numbers; None: the CRS that the file names."""
    if not isinstance(root, Mapping):
        raise InputError(f"{where}: is not a GeoJSON object; export it again")
    features = root.get("features") or [] if root.get("type") == "FeatureCollection" else [root]
    if not isinstance(features, list | tuple):
        raise InputError(f"{where}: its features are not a list; export it again")
    areas = [_of_feature(each, k, where) for k, each in enumerate(features)]
    corners = np.concatenate([np.empty((0, 2)), *(ring for area in areas for ring in area.rings)])
    source = data_crs or _named_crs(root)
    if source is None and crs is not None and (np.abs(corners) <= [180.0, 90.0]).all():
        source = _WORLD
    if source is not None and crs is None and _is_world(source):
        raise InputError(f"{where}: is in degrees, and the scene's CRS is unknown; give it, such as --crs EPSG:7415")
    if source is not None and crs is not None:
        areas = [area._replace(rings=[reproject(ring, source, crs) for ring in area.rings]) for area in areas]
    yield from areas


def _of_feature(feature: Any, k: int, where: str) -> Area:
    """The area of a Feature or a geometry."""
    shape, name = feature, None
    if isinstance(feature, Mapping) and feature.get("type") == "Feature":
        properties = feature.get("properties") or {}
        shape, name = feature.get("geometry"), properties.get("name") or properties.get("id") or feature.get("id")
    name = f"area {k + 1}" if name is None else str(name)
    kind = shape.get("type") if isinstance(shape, Mapping) else None
    if kind not in ("Polygon", "MultiPolygon"):
        raise InputError(f"{where}: {name} is a {kind}; areas are Polygons and MultiPolygons")
    boundaries = shape.get("coordinates")
    polygons = [boundaries] if kind == "Polygon" else boundaries
    try:
        return Area(name, [_ring(ring, name) for polygon in polygons for ring in polygon])
    except TypeError:
        raise InputError(f"{where}: the coordinates of {name} are not a list of rings; export it again") from None


def _ring(coordinates: Any, name: str) -> NDArray[np.float64]:
    try:
        ring = np.array([[float(x), float(y)] for x, y, *_ in coordinates])
    except (TypeError, ValueError, OverflowError):
        ring = np.empty((0, 2))
    if len(ring) < 3 or not np.isfinite(ring).all():
        raise InputError(f"{name}: a ring needs at least three corners, each a finite easting and northing")
    return ring


def _named_crs(root: Mapping[str, Any]) -> str | None:
    """The CRS that GeoJSON names, in the member that GIS programs write."""
    member = root.get("crs")
    if not isinstance(member, Mapping):
        return None
    name = (member.get("properties") or {}).get("name")
    return None if name is None else checked_crs(str(name))


def _is_world(crs: str) -> bool:
    from pyproj import CRS

    return bool(CRS.from_user_input(crs).is_geographic)


def _cells_in(area: Area, raster: Raster) -> np.ndarray:
    """The cells whose centres lie in an area, by the even-odd rule; centres on an edge belong to one side of it."""
    a = np.concatenate(area.rings)
    b = np.concatenate([np.roll(ring, -1, 0) for ring in area.rings])
    east, north = raster.middles()
    rows = np.flatnonzero((north >= a[:, 1].min()) & (north <= a[:, 1].max()))
    cells = [np.empty(0, np.int64)]
    for row in rows.tolist():
        y = north[row]
        spans = (a[:, 1] <= y) != (b[:, 1] <= y)
        (x0, y0), (x1, y1) = a[spans].T, b[spans].T
        crossed = np.sort(x0 + (y - y0) / (y1 - y0) * (x1 - x0))
        inside = np.searchsorted(crossed, east, side="right") % 2 == 1
        cells.append(row * raster.columns + np.flatnonzero(inside))
    if not sum(map(len, cells)):
        raise InputError(f"{area.name}: contains no centre of a cell of {raster.spacing:g}; use a finer spacing")
    return np.concatenate(cells)


def _check_ground(areas: list[Area], zone: np.ndarray, faces: np.ndarray) -> None:
    for k, area in enumerate(areas):
        missing = int((faces[zone == k] < 0).sum())
        if missing:
            raise InputError(
                f"{area.name}: {some_of(missing, (zone == k).sum(), 'cell', 'have')} no surface below; "
                "give the height of the ground, such as raster:0.5@12.3, or a scene with terrain"
            )
