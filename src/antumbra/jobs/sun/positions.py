"""Positions of the sun, as directions in a scene."""

from typing import NamedTuple

import numpy as np

from ...checks import as_array, choice, instance, number
from ...errors import InputError
from ...extras import import_extra
from .place import Place, checked_place
from .times import Times

_AT_A_TIME = 16384  # instants: pvlib needs about 1 kB for each


class Suns(NamedTuple):
    """Suns above the horizon, in the order of time; each stands for an interval."""

    times: np.ndarray  # (k,) datetime64[s], UTC, middle of the interval
    local: np.ndarray  # (k,) datetime64[s], the same on the wall clock
    hours: np.ndarray  # (k,) float64, length of the interval
    directions: np.ndarray  # (k, 3) float64, unit vectors towards the sun in the scene's axes
    altitude: np.ndarray  # (k,) float64, degrees above the horizon, geometric: without refraction
    azimuth: np.ndarray  # (k,) float64, degrees, clockwise from true north
    dni: np.ndarray | None = None  # (k,) float64, direct normal irradiance, W/m2
    dropped: int = 0  # intervals in whose middle the sun is not above the horizon
    kept: np.ndarray | None = None  # (k,) int64, index of the sun's interval in the `Times` asked for


def suns_of(place: Place, times: Times, up: str, dni=None, *, lowest: float = 0.0) -> Suns:
    """The suns of intervals, by the algorithm of NREL's SPA in pvlib [Reda and Andreas 2004].

    Parameters
    ----------
    place : Place
    times : Times
    up : "y" or "z"
        The scene's up axis.
    dni : (n,) float, optional
        Direct normal irradiance of each interval, W/m2.
    lowest : float
        Degrees. Only suns higher than this are kept.

    Raises
    ------
    InputError
        If pvlib is missing, or `dni` does not fit `times`.
    """
    place, up = checked_place(instance(place, Place, "place")), choice(up, "up", ("y", "z"))
    instance(times, Times, "times", "times_of makes them")
    lowest = number(lowest, "lowest (degrees)", -90.0, 90.0, "[]")
    if dni is not None:
        dni = as_array(dni, "dni")
        if dni.shape != times.middle.shape:
            raise InputError(f"dni has shape {dni.shape} for {len(times.middle)} intervals; give one value for each")
    altitude, azimuth = solar_angles(place, times.middle)
    kept = np.flatnonzero(altitude > lowest)
    altitude, azimuth = altitude[kept], azimuth[kept]
    directions = directions_of(altitude, azimuth + place.north, up)
    radiation = None if dni is None else np.asarray(dni, np.float64)[kept]
    middle, local, hours = (column[kept] for column in times)
    dropped = len(times.middle) - len(kept)
    return Suns(middle, local, hours, directions, altitude, azimuth, radiation, dropped, kept)


def solar_angles(place: Place, instants: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(geometric altitude, azimuth clockwise from true north), degrees, of (n,) datetime64 instants in UTC."""
    import_extra("pvlib", "the position of the sun", "sun")
    import pandas
    from pvlib.solarposition import get_solarposition

    angles = np.empty((2, len(instants)))
    for first in range(0, len(instants), _AT_A_TIME):
        index = pandas.DatetimeIndex(instants[first : first + _AT_A_TIME]).tz_localize("UTC")
        found = get_solarposition(index, place.latitude, place.longitude, place.elevation, method="nrel_numpy")
        angles[:, first : first + _AT_A_TIME] = found["elevation"], found["azimuth"]
    return angles[0], angles[1]


def directions_of(altitude, bearing, up: str) -> np.ndarray:
    """Unit vectors ((n, 3) float64) in the scene's axes.

    altitude, bearing : (n,) degrees; the bearing is clockwise from the scene's own north axis
    """
    altitude, bearing = np.radians(altitude), np.radians(bearing)
    east, north, height = np.sin(bearing) * np.cos(altitude), np.cos(bearing) * np.cos(altitude), np.sin(altitude)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=-1)
