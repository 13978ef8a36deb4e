"""Scenes whose heights and distances in plan are lengths in one unit, as studies of angles and distances need.

All studies open their scene with `measured_scene`, which refuses degrees, mixed units, and maps that stretch lengths.
Pictures and ray queries take coordinates as they are.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.extras import MissingPackage
from ..formats.format_registry import format_of
from ..formats.reprojection import projected_crs, warp_command
from ..scene.crs import in_one_unit, parts_of_crs
from ..scene.map_degrees import check_no_degrees
from ..scene.map_point import MEAN_RADIUS, map_point
from ..scene.scene_bounds import plan_bounds, plan_points
from ..scene.terrain import TERRAIN_TYPE
from .scene_loading import SceneLike, scene_of

if TYPE_CHECKING:
    from .paged_scene import PagedScene
    from .scene import AnyScene, Scene

MOST_STRETCH = 0.01
"""How much the scale of a map may differ from 1. A shadow is then wrong by 1 %, as for a height measured to 10 cm on a
house of 10 m. National grids and UTM zones stay within 0.2 %; Web Mercator keeps within 1 % up to 4.6 degrees from the
equator.
"""

_DEGREES = 90.0, 180.0  # the greatest latitude and longitude
_STEEP = 1000.0  # heights per extent in plan: 150,000 of a house in degrees, 300 of a lone mast of 30 m in metres
_CELLS = 100.0  # cells of a raster in metres, over which no ground rises `_STEEP` times as much


def measured_scene(value: SceneLike) -> "Scene | PagedScene":
    """The scene of a study that measures lengths, loaded if necessary.

    Raises
    ------
    InputError
        If it cannot be read, its coordinates are degrees, its heights have another unit than its plan, or the scale of
        its map differs from 1 by more than `MOST_STRETCH`. The message has the command that reprojects it.
    """
    scene = scene_of(value, stacklevel=4)
    if (fault := measuring_fault(scene)) is not None:
        raise InputError(fault)
    return scene


def measuring_fault(scene: "AnyScene") -> str | None:
    """Why lengths cannot be measured in a scene, and the remedy, in one line; None if they can.

    A unit that is given says that coordinates are lengths, even if they cannot be those of the CRS.
    """
    if scene.crs is None:
        return _degrees_fault(scene)
    parts, name = parts_of_crs(scene.crs), f"its CRS, {scene.crs[:60]},"
    if parts.plan.is_geographic:
        return f"{scene.name}: {name} is in degrees; {_remedy(scene, _position(scene))}"
    if parts.plan.is_geocentric:
        return f"{scene.name}: {name} is geocentric, so no axis points up; reproject it to a projected CRS"
    if parts.mixed:
        assert parts.unit is not None and parts.height_unit is not None
        return (
            f"{scene.name}: {name} has heights in {parts.height_unit.name} and a plan in {parts.unit.name}; multiply "
            f"heights by {in_one_unit(scene.crs)[1]:.10g}, and give the CRS {in_one_unit(scene.crs)[0][:60]}"
        )
    if not parts.plan.is_projected:
        return None
    point = map_point(scene.crs, *middle_of(scene))
    if abs(point.scale - 1.0) <= MOST_STRETCH or (not point.inside and scene.data.given_unit is not None):
        return None
    stretched = f"{scene.name}: {name} has the scale {point.scale:.4g} in plan at the middle of the scene"
    if not point.inside:
        return f"{stretched}, outside its area; if coordinates were shifted, {_give_unit(scene)}"
    return f"{stretched}, and heights have 1; {_remedy(scene, (point.longitude, point.latitude))}"


def notes_of(scene: "AnyScene") -> list[str]:
    """The notes of the loader, and why studies would refuse the scene, of which pictures can be made."""
    try:
        fault = measuring_fault(scene)
    except MissingPackage as error:
        return [*scene.notes, f"the scale of the map is unknown: {error}"]
    return list(scene.notes) if fault is None else [*scene.notes, f"pictures only; {fault}"]


def check_degrees(scene: "AnyScene", at: NDArray[np.float64], what: str) -> None:
    """Raise an InputError if points, (n, 3) world, are longitudes and latitudes, and the scene is far from them."""
    bounds = plan_bounds(scene.bounds, scene.up)
    check_no_degrees(plan_points(at, scene.up), what, scene.name, scene.crs, bounds)


def earth_radius_of(scene: "AnyScene") -> float:
    """The mean radius of curvature of the ellipsoid of a scene's CRS at its middle; without one, that of the earth.

    In world units.
    """
    metres = MEAN_RADIUS
    if scene.crs is not None and parts_of_crs(scene.crs).plan.is_projected:
        metres = map_point(scene.crs, *middle_of(scene)).radius
    return scene.unit.of_metres(metres)


def middle_of(scene: "AnyScene") -> tuple[float, float]:
    """Easting and northing of the middle of a scene's bounds."""
    x, y, z = ((scene.bounds[0] + scene.bounds[1]) / 2.0).tolist()
    return (x, y) if scene.up == "z" else (x, -z)


def _degrees_fault(scene: "AnyScene") -> str | None:
    """The fault of coordinates that can only be degrees: a scene whose heights exceed its plan a thousandfold."""
    if scene.data.given_unit is not None:
        return None
    (x, y), up = middle_of(scene), "xyz".index(scene.up)
    size = np.ptp(scene.bounds, axis=0)
    height, width = float(size[up]), float(np.delete(size, up).max())
    if scene.raster is not None:
        width = min(width, _CELLS * scene.raster.spacing)
    near, far = sorted((abs(x), abs(y)))
    if near > _DEGREES[0] or far > _DEGREES[1] or far < width or height < _STEEP * width:
        return None
    return (
        f"{scene.name}: its coordinates, such as {x:.6g}, {y:.6g}, look like degrees beside heights of {height:.3g}; "
        f"{_remedy(scene, _position(scene))}, or if they are lengths, {_give_unit(scene)}"
    )


# --- Remedies ---------------------------------------------------------------------------------------------------------


def _give_unit(scene: "AnyScene") -> str:
    return f"give their unit: unit={scene.unit.name!r}, or --unit {scene.unit.name}"


def _position(scene: "AnyScene") -> tuple[float, float]:
    """Longitude and latitude of the middle of a scene in degrees: in the order of the CRS, unless out of range."""
    x, y = middle_of(scene)
    if max(abs(x), abs(y)) > _DEGREES[0]:
        return (x, y) if abs(x) > abs(y) else (y, x)
    north_first = scene.crs is not None and parts_of_crs(scene.crs).plan.axis_info[0].direction == "north"
    return (y, x) if north_first else (x, y)


def _remedy(scene: "AnyScene", position: tuple[float, float]) -> str:
    """The command that reprojects the file of a scene, or the CRS to which its coordinates are to be reprojected."""
    target = projected_crs(scene.crs, *position)
    if not scene.data.resident:
        return f"reproject the files that it was built from to {target}, and build it again"
    suffix = Path(getattr(getattr(scene.data, "source", None), "file", "")).suffix.lower()
    file_format = format_of(Path(f"file{suffix}"))
    if file_format is not None and file_format.reproject is not None:
        command = file_format.reproject(target, bool(scene.crs))
    elif scene.city is None and any(each.type == TERRAIN_TYPE for each in scene.objects):
        command = warp_command(target)
    else:
        return f"reproject its coordinates to {target}, for example with pyproj"
    return f"reproject it, for example with: {command}"
