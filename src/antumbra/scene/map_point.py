"""The geometry of a map at a point: scale, convergence, and the curvature of the ellipsoid there."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..extras import import_extra
from .crs import parts_of_crs

MEAN_RADIUS = 6_371_000.0
"""Metres: the mean radius of the earth, where no CRS names an ellipsoid."""

_EARTH = 6_378_137.0  # metres, equatorial radius
_BODY = 0.01  # relative difference of the equatorial radii of all ellipsoids of the earth, and of a sphere


class MapPoint(NamedTuple):
    """A point on the map of a projected CRS."""

    longitude: float  # degrees, in the datum of the CRS
    latitude: float
    scale: float  # length on the map per length on the ellipsoid, in the direction in which it differs most from 1
    convergence: float  # degrees: grid north, clockwise from true north
    radius: float  # metres: mean radius of curvature of the ellipsoid, sqrt(M N)


@lru_cache(maxsize=256)
def map_point(crs: str, easting: float, northing: float) -> MapPoint:
    """The geometry of the map of a projected CRS at a point.

    Raises
    ------
    InputError
        If the point has no longitude and latitude.
    """
    pyproj, plan = import_extra("pyproj", "crs", "gis"), parts_of_crs(crs).plan
    project = pyproj.Proj(plan)
    longitude, latitude = project(easting, northing, inverse=True)
    factors = project.get_factors(longitude, latitude) if np.isfinite([longitude, latitude]).all() else None
    if factors is None or not np.isfinite(factors.tissot_semimajor):
        raise InputError(f"crs {crs}: {easting:.6g}, {northing:.6g} has no longitude and latitude; check the CRS")
    scales = factors.tissot_semimajor, factors.tissot_semiminor
    a, b = plan.ellipsoid.semi_major_metre, plan.ellipsoid.semi_minor_metre
    flat, sine = 1.0 - (b / a) ** 2, np.sin(np.radians(latitude))
    radius = float(b / (1.0 - flat * sine * sine))  # M = a (1 - e^2) / w^3 and N = a / w, with w^2 = 1 - e^2 sin^2
    furthest = max(scales, key=lambda scale: abs(scale - 1.0))
    return MapPoint(longitude, latitude, furthest, factors.meridian_convergence, radius)


def on_earth(crs: str) -> bool:
    """Whether the ellipsoid of a validated CRS is one of the earth, rather than of the Moon or a planet."""
    ellipsoid = parts_of_crs(crs).plan.ellipsoid
    return ellipsoid is None or abs(ellipsoid.semi_major_metre - _EARTH) <= _BODY * _EARTH
