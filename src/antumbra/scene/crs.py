"""Coordinate reference systems (CRS) of scenes, as strings that pyproj accepts: their units, and reprojection."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.checks import quoted
from ..base.errors import InputError
from ..base.extras import import_extra
from .units import METRE, LengthUnit, unit_of_factor


def checked_crs(crs: object) -> str:
    """A validated CRS as a string: a string unchanged, anything else as pyproj formats it.

    crs : str, or anything else that ``pyproj.CRS.from_user_input`` accepts

    Raises
    ------
    InputError
        If pyproj is missing, or cannot interpret the CRS.
    """
    pyproj = import_extra("pyproj", "crs", "gis")
    try:
        parsed = pyproj.CRS.from_user_input(crs)
    except Exception:  # wrong types raise all kinds of exceptions
        raise InputError(f"crs {quoted(crs)} is unknown; write an EPSG code such as EPSG:7415") from None
    return crs if isinstance(crs, str) else parsed.to_string()


def check_horizontal_crs(name: str, crs: str | None, scene: str | None) -> None:
    """Raise InputError if the horizontal CRS of a file differs from the scene's.

    name : the file, for the message
    crs, scene : the validated CRS of file and scene; None: unknown, which matches everything
    """
    if crs and scene and not _plan(crs).equals(_plan(scene), ignore_axis_order=True):
        raise InputError(f"{name}: its CRS is {crs}, and the scene's is {scene}; reproject one of them")


def reproject(plan: np.ndarray, source: str, target: str) -> NDArray[np.float64]:
    """(n, 2) float64: points transformed between the horizontal parts of two validated CRS, as (easting, northing).

    Raises
    ------
    InputError
        If a point has no coordinates in the target CRS.
    """
    transformer = import_extra("pyproj", "crs", "gis").Transformer.from_crs(
        _plan(source), _plan(target), always_xy=True
    )
    points = np.stack(transformer.transform(*plan.T), -1)
    if not np.isfinite(points).all():
        raise InputError(f"places in {source} have no coordinates in {target}; check both")
    return points


def _plan(crs: str) -> Any:
    """The horizontal part of a compound CRS; any other CRS unchanged."""
    full = import_extra("pyproj", "crs", "gis").CRS.from_user_input(crs)
    return full.sub_crs_list[0] if full.is_compound else full


# --- Units ------------------------------------------------------------------------------------------------------------


class CrsParts(NamedTuple):
    """What the axes of a CRS mean."""

    plan: Any  # pyproj.CRS: the horizontal part
    unit: LengthUnit | None  # of the plan; None: it has angles, or names no unit
    height_unit: LengthUnit | None  # None: the CRS has no heights

    @property
    def mixed(self) -> bool:
        """Whether heights have another unit than the plan."""
        return self.unit is not None and self.height_unit is not None and not self.unit.same_as(self.height_unit)


_UNDEFINED = "Undefined"  # name of the CRS that GeoPackage writes where there is none


@lru_cache(maxsize=64)
def parts_of_crs(crs: str) -> CrsParts:
    """The horizontal part of a validated CRS, and its units."""
    full = import_extra("pyproj", "crs", "gis").CRS.from_user_input(checked_crs(crs))
    parts = full.sub_crs_list if full.is_compound else [full]
    plan = parts[0].source_crs if parts[0].is_bound else parts[0]
    axes = [axis for part in [plan, *parts[1:]] for axis in part.axis_info]
    angular = plan.is_geographic or plan.is_vertical or not axes or plan.name.startswith(_UNDEFINED)
    heights = axes if plan.is_vertical else axes[2:]
    return CrsParts(plan, None if angular else _unit_of_axis(axes[0]), _unit_of_axis(heights[0]) if heights else None)


def _unit_of_axis(axis: Any) -> LengthUnit:
    return unit_of_factor(axis.unit_name, axis.unit_conversion_factor)


def unit_of_crs(crs: str | None, given: LengthUnit | None = None) -> LengthUnit:
    """The length unit of a scene: that of the plan of its CRS, or else of its heights; without a CRS that given, or m.

    Raises
    ------
    InputError
        If the unit given is not that of the CRS.
    """
    if crs is None:
        return given or METRE
    parts = parts_of_crs(crs)
    unit = parts.unit or parts.height_unit or given or METRE
    if given is not None and not given.same_as(unit):
        raise InputError(
            f"unit is {given.name}, and the coordinates of the crs {crs} are in {unit.name}; leave one out"
        )
    return unit


def in_one_unit(crs: str) -> tuple[str, float]:
    """A CRS without heights in another unit than the plan, and the factor that converts heights to the plan's unit.

    A compound CRS with two units is reduced to its plan, since no converted height belongs to its vertical part.
    """
    parts = parts_of_crs(crs)
    if not parts.mixed:
        return crs, 1.0
    assert parts.unit is not None and parts.height_unit is not None
    return parts.plan.to_2d().to_string(), parts.height_unit.metres / parts.unit.metres
