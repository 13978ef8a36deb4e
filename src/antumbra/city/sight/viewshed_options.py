"""The options of a viewshed: the keywords of `antumbra.viewshed`, with the limits of distance and direction."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...base.checks import flag, listed, number
from ...base.errors import InputError
from ...base.option_fields import RealNumber, check_fields, option, same_option
from ...engine.plan import Plan
from ...kernels.elementary import atan2
from ...picture.render_options import EngineOptions, RenderOptions
from ..sensors.curvature_options import CurvatureOptions


def _azimuth(value: Any, what: str) -> tuple[float, float]:
    return _angles(value, what, 360.0)


def _elevation(value: Any, what: str) -> tuple[float, float]:
    low, high = _angles(value, what, 90.0)
    if low > high:
        raise InputError(f"{what} is from {low:g} to {high:g}; give the lower angle first")
    return low, high


def _angles(value: Any, what: str, most: float) -> tuple[float, float]:
    first, last = (number(angle, f"{what} (degrees)", -most, most, "[]") for angle in listed(value, what, 2))
    return first, last


@dataclass(frozen=True, kw_only=True)
class ViewshedOptions:
    """The options of a viewshed, checked and immutable. Raises InputError."""

    eye_height: float = option(
        0.0, RealNumber(-np.inf, np.inf), "Height of the eyes above the observers, in world units."
    )
    """Height of the eyes above the observers, world units."""
    on_surface: bool = option(False, flag, "First place observers on the highest surface.")
    """First move each observer to the highest surface above or below it. Without a surface, it is an error."""
    min_distance: float = option(
        0.0, RealNumber(0.0, np.inf, "[)"), "Nearest distance of visible sensors, in world units."
    )
    """World units, in a straight line from eye to sensor; the limits are included."""
    max_distance: float | None = option(
        None,
        RealNumber(0.0, np.inf, "(]", optional=True),
        "Farthest distance of visible sensors, in world units.",
        note="no limit",
    )
    """None: no limit."""
    azimuth: tuple[float, float] = option(
        (0.0, 360.0),
        _azimuth,
        "Compass directions, degrees clockwise from north.",
        kind=str,
        start="0:360",
        metavar="FROM:TO",
        is_value=False,
        doc_type="(float, float)",
    )
    """Compass directions in degrees, clockwise from north (+Y if Z is up, else -Z): (350, 10) looks north."""
    elevation: tuple[float, float] = option(
        (-90.0, 90.0),
        _elevation,
        "Degrees above the horizontal.",
        kind=str,
        start="-90:90",
        metavar="LOWEST:HIGHEST",
        is_value=False,
        doc_type="(float, float)",
    )
    """Degrees above the horizontal."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    bits: bool = option(False, flag)
    """Also return which observer sees which sensor."""
    each: bool = option(False, flag, "Add a column, or a band, for each observer: seen_NAME.")
    """Add a column for each observer: whether it sees the sensor."""
    least_height: bool = option(
        False, flag, "Add how tall a target must be to be seen. For rasters of heights: the height above each cell."
    )
    """For the cells of a scene that is a raster of heights: also find how tall a thing must be in each to be seen."""
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    time: float = same_option(RenderOptions, "time")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)
        if self.min_distance >= self.reach:
            raise InputError(
                f"min_distance is {self.min_distance:g} and max_distance {self.reach:g}; nothing lies between them"
            )

    @property
    def reach(self) -> float:
        """The greatest distance; inf: no limit."""
        return np.inf if self.max_distance is None else self.max_distance

    def includes(self, away: NDArray[np.float64], distance: NDArray[np.float64], up: str) -> NDArray[np.bool_]:
        """(...) bool: whether points are within the limits; away: (..., 3), from the observer to the points."""
        within = np.asarray((distance >= self.min_distance) & (distance <= self.reach))
        width = self.azimuth[1] - self.azimuth[0]
        if abs(width) >= 360.0 and self.elevation == (-90.0, 90.0):
            return within
        north = away[..., 1] if up == "z" else -away[..., 2]
        horizontal = np.sqrt(away[..., 0] * away[..., 0] + north * north)
        elevation = np.degrees(atan2(away[..., "xyz".index(up)], horizontal))
        within &= (elevation >= self.elevation[0]) & (elevation <= self.elevation[1])
        if abs(width) < 360.0:
            bearing = np.degrees(atan2(away[..., 0], north)) - self.azimuth[0]
            within &= (bearing % 360.0 <= width % 360.0) | (horizontal == 0.0)
        return within
