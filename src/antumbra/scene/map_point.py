"""The geometry of a map at a point: scale, convergence, and the curvature of the ellipsoid there."""

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from ..base.extras import import_extra
from ..kernels.elementary import cos, sin
from .crs import parts_of_crs
from .units import METRE, LengthUnit

MEAN_RADIUS = 6_371_000.0
"""Metres: the mean radius of the earth, where no CRS names an ellipsoid."""

_EARTH = 6_378_137.0  # metres, equatorial radius
_STEP = 100.0  # metres: length of geodesics, well above the rounding of PROJ, and far below the curvature of a map
_DEGENERATE = 89.999  # degrees: closer to a pole, north is undefined
_MARGIN = 1.0  # degrees around the area of use of a CRS
_BODY = 0.01  # relative difference of the equatorial radii of all ellipsoids of the earth, and of a sphere


class MapPoint(NamedTuple):
    """A point on the map of a projected CRS."""

    longitude: float  # degrees, in the datum of the CRS; NaN: the point is not on the map
    latitude: float
    inside: bool  # in the CRS's area of use, or up to a degree beside it
    scale: float  # length on the map per length on the ellipsoid, in the direction in which it differs most from 1
    convergence: float  # degrees: grid north, clockwise from true north
    radius: float  # metres: mean radius of curvature of the ellipsoid, sqrt(M N)


@lru_cache(maxsize=256)
def map_point(crs: str, easting: float, northing: float) -> MapPoint:
    """The geometry of the map of a projected CRS at a point; off the map, NaN and the radius of the whole ellipsoid."""
    parts = parts_of_crs(crs)
    plan = parts.plan
    project = import_extra("pyproj", "crs", "gis").Proj(plan)
    longitude, latitude = project(easting, northing, inverse=True)
    a, b = plan.ellipsoid.semi_major_metre, plan.ellipsoid.semi_minor_metre
    if not np.isfinite([longitude, latitude]).all():
        return MapPoint(np.nan, np.nan, False, np.nan, np.nan, float(np.sqrt(a * b)))
    squared, sine = 1.0 - (b / a) ** 2, float(sin(np.radians(latitude)))
    radius = float(b / (1.0 - squared * sine * sine))  # with w^2 = 1 - e^2 sin^2: M = a (1 - e^2) / w^3, N = a / w
    scale = _scale(project, plan.get_geod(), (easting, northing), parts.unit or METRE)
    convergence = project.get_factors(longitude, latitude).meridian_convergence
    inside = _inside(plan.area_of_use, longitude, latitude)
    return MapPoint(longitude, latitude, inside, scale, convergence, radius)


def _scale(project: Any, ellipsoid: Any, place: tuple[float, float], unit: LengthUnit) -> float:
    """The scale of a map in the direction in which it differs most from 1, from short geodesics along both axes.

    The scale factors of PROJ are those of a sphere for Web Mercator, up to 0.7 % from those of its ellipsoid.
    """
    half = unit.of_metres(_STEP / 2.0)
    ends = np.array([[-half, 0.0], [0.0, -half], [half, 0.0], [0.0, half]]) + place
    longitudes, latitudes = (np.asarray(each) for each in project(*ends.T, inverse=True))
    first, last, lengths = ellipsoid.inv(longitudes[:2], latitudes[:2], longitudes[2:], latitudes[2:])
    bearings = first + (last - first) % 360.0 / 2.0 - 90.0  # in the middle; `last` looks back
    ground = np.stack([lengths * sin(np.radians(bearings)), lengths * cos(np.radians(bearings))]) / _STEP
    if not np.isfinite(ground).all():
        return float("nan")
    scales = 1.0 / np.linalg.svd(ground, compute_uv=False)  # of the axes of Tissot's ellipse
    return float(max(scales, key=lambda scale: abs(scale - 1.0)))


def _inside(area: Any, longitude: float, latitude: float) -> bool:
    """Whether a position is in an area of use, up to its margin, and not at a pole."""
    if area is None or abs(latitude) > _DEGENERATE:
        return abs(latitude) <= _DEGENERATE
    span = (area.east - area.west) % 360.0 or 360.0  # an area may cross the antimeridian
    across = (longitude - area.west + _MARGIN) % 360.0 <= span + 2.0 * _MARGIN
    return bool(across and area.south - _MARGIN <= latitude <= area.north + _MARGIN)


def on_earth(crs: str) -> bool:
    """Whether the ellipsoid of a validated CRS is one of the earth, rather than of the Moon or a planet."""
    ellipsoid = parts_of_crs(crs).plan.ellipsoid
    return ellipsoid is None or abs(ellipsoid.semi_major_metre - _EARTH) <= _BODY * _EARTH
