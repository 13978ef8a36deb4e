"""How far and where observers look: distances, compass directions, and angles above the horizon."""

from typing import NamedTuple

import numpy as np

from ...checks import listed, number
from ...errors import InputError


class Limits(NamedTuple):
    """The part of space that each observer looks at.

    min_distance, max_distance : float
        World units, in a straight line; both ends count.
    azimuth : (float, float)
        Degrees clockwise from north (+Y if Z is up, else -Z), from the first to the second: (350, 10) is 20 degrees
        wide. (0, 360): all around.
    elevation : (float, float)
        Degrees above the horizontal, lowest and highest.
    """

    min_distance: float = 0.0
    max_distance: float = np.inf
    azimuth: tuple[float, float] = (0.0, 360.0)
    elevation: tuple[float, float] = (-90.0, 90.0)

    @property
    def all_around(self) -> bool:
        """Do the angles leave nothing out?"""
        return abs(self.azimuth[1] - self.azimuth[0]) >= 360.0 and self.elevation == (-90.0, 90.0)

    def near(self, distance: np.ndarray) -> np.ndarray:
        """Are distances within the limits?"""
        return (distance >= self.min_distance) & (distance <= self.max_distance)

    def inside(self, away: np.ndarray, distance: np.ndarray, up: str) -> np.ndarray:
        """(...) bool: are points within the limits? away: (..., 3) from the observer to them."""
        found = self.near(distance)
        if self.all_around:
            return found
        z = away[..., "xyz".index(up)]
        north = away[..., 1] if up == "z" else -away[..., 2]
        level = np.hypot(away[..., 0], north)
        elevation = np.degrees(np.arctan2(z, level))
        found &= (elevation >= self.elevation[0]) & (elevation <= self.elevation[1])
        wide = self.azimuth[1] - self.azimuth[0]
        if abs(wide) < 360.0:
            turned = np.degrees(np.arctan2(away[..., 0], north)) - self.azimuth[0]
            found &= (turned % 360.0 <= wide % 360.0) | (level == 0.0)
        return found


def checked_limits(min_distance, max_distance, azimuth, elevation) -> Limits:
    """The `Limits`; InputError names what is wrong."""
    least = number(min_distance, "min_distance", 0.0, np.inf, "[)")
    most = np.inf if max_distance is None else number(max_distance, "max_distance", 0.0, np.inf, "(]")
    if least >= most:
        raise InputError(f"min_distance is {least:g} and max_distance {most:g}; nothing lies between them")
    around = _angles(azimuth, "azimuth", 360.0)
    low, high = _angles(elevation, "elevation", 90.0)
    if low > high:
        raise InputError(f"elevation is from {low:g} to {high:g}; give the lower angle first")
    return Limits(least, most, around, (low, high))


def _angles(value, what: str, most: float) -> tuple[float, float]:
    first, last = (number(angle, f"{what} (degrees)", -most, most, "[]") for angle in listed(value, what, 2))
    return first, last
