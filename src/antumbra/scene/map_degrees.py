"""Longitudes and latitudes given as coordinates of a scene on a map: refused, with their place on the map."""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from .crs import reproject

_WORLD = "EPSG:4326"


def check_no_degrees(
    plan: NDArray[np.float64], what: str, scene: str, crs: str | None, bounds: NDArray[np.float64]
) -> None:
    """Raise an InputError if points may be degrees, and lie farther beside a scene with a CRS than it is wide.

    plan : (n, 2) float64, easting and northing
    what, scene : names of the points, in the plural, and of the scene, for the message
    bounds : (2, 2) float64, of the scene, in easting and northing
    """
    if not crs:
        return
    low, high = bounds
    width = float((high - low).max())
    wrong = (np.abs(plan) <= [180.0, 90.0]).all(1) | (np.abs(plan) <= [90.0, 180.0]).all(1)
    wrong &= ((plan < low - width) | (plan > high + width)).any(1)
    if wrong.any():
        first = plan[wrong.argmax()]
        x, y = _on_map(first, crs, (low + high) / 2.0)
        words = f"{what} are in degrees ({first[0]:.10g},{first[1]:.10g}), and {scene} is in {crs}"
        raise InputError(f"{words}; project them: this one is at {x:.2f},{y:.2f}")


def _on_map(degrees: NDArray[np.float64], crs: str, middle: NDArray[np.float64]) -> NDArray[np.float64]:
    """(2,) float64: a longitude and a latitude in a CRS, in the order that is nearer to the middle of a scene."""
    found = list[NDArray[np.float64]]()
    for pair in (degrees, degrees[::-1]):
        with suppress(InputError):
            found.append(reproject(pair[None], _WORLD, crs)[0])
    return min(found, key=lambda point: float(np.abs(point - middle).max()), default=np.full(2, np.nan))
