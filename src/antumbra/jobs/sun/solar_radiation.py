"""Solar radiation per time interval, from an EPW weather file or for a clear sky."""

from collections.abc import Iterable
from datetime import date, timedelta, timezone
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...checks import path_of
from ...errors import InputError
from ...extras import import_extra
from ...files import checked_file
from .location import Place, checked_place
from .sun_positions import Times, intervals, month_days, zone_of

TYPICAL_YEAR = 2025
"""Year assigned to the suns of a typical year, whose months come from several years. It has no 29 February."""

_MISSING = 9999.0  # marks missing radiation in EPW files
_HOUR = 3600


class Weather(NamedTuple):
    """Radiation per time interval."""

    times: Times  # n intervals
    dni: np.ndarray  # (n,) float64, direct normal irradiance, W/m2
    dhi: np.ndarray  # (n,) float64, diffuse horizontal irradiance, W/m2


def read_epw(path: str | PathLike[str], place: Place | None = None) -> tuple[Weather, Place]:
    """Read an EPW file with one row per hour. A row covers the hour before its time stamp.

    Parameters
    ----------
    path : str or path-like
    place : Place, optional
        None: the file's position and time zone. If the place has no time zone, that of the file is used.

    Returns
    -------
    weather : Weather
        The 8760 or 8784 hours of a year. A typical year (TMY) gets the suns of `TYPICAL_YEAR`.
    place : Place

    Raises
    ------
    InputError
        If pvlib is missing, the file is not an EPW file, it has several rows per hour, or radiation is missing.
    """
    import_extra("pvlib", "an EPW file", "sun")
    from pvlib.iotools import read_epw as read

    path = path_of(path, "epw")
    checked_file(path, path.name)
    try:
        table, head = read(path)
        table = table[["year", "month", "day", "hour", "dni", "dhi"]].astype(np.float64)
        file_place = Place(head["latitude"], head["longitude"], head["altitude"], 0.0, _offset_text(float(head["TZ"])))
    except Exception as error:  # pvlib does not validate: each kind of damage raises a different exception
        reason = " ".join(str(error).split())[:100] or type(error).__name__
        raise InputError(f"{path.name}: not an EPW file ({reason}); download it again") from None
    _check(table, path.name)
    place = checked_place(
        file_place if place is None else place._replace(timezone=place.timezone or file_place.timezone)
    )
    starts = _starts(table, float(head["TZ"]), path.name)
    times = intervals(starts, starts + _HOUR, zone_of(place))
    return Weather(times, table["dni"].to_numpy(), table["dhi"].to_numpy()), place


def on_days(weather: Weather, days: Iterable[date]) -> Weather:
    """The intervals of a year's weather that fall on some days, regardless of their year.

    days : iterable of datetime.date

    Raises
    ------
    InputError
        If the weather covers none of the days.
    """
    day_numbers = [100 * day.month + day.day for day in days]
    selected = np.isin(month_days(weather.times.local), day_numbers)
    if not selected.any():
        raise InputError("the weather file has none of these days; choose others")
    return Weather(Times(*(column[selected] for column in weather.times)), weather.dni[selected], weather.dhi[selected])


def clear_sky(place: Place, times: Times) -> Weather:
    """Clear-sky radiation at the middle of each interval.

    This is pvlib's clear-sky model [Ineichen and Perez 2002] with pvlib's monthly climatology of Linke turbidity.

    Raises
    ------
    InputError
        If pvlib is missing.
    """
    import_extra("pvlib", "a clear sky", "sun")
    import pandas
    from pvlib.location import Location

    index = pandas.DatetimeIndex(times.middle).tz_localize("UTC")
    sky = Location(place.latitude, place.longitude, altitude=place.elevation).get_clearsky(index)
    return Weather(times, sky["dni"].to_numpy(np.float64), sky["dhi"].to_numpy(np.float64))


def _check(table: Any, file: str) -> None:
    keys = table[["year", "month", "day", "hour"]].to_numpy()
    if len(np.unique(keys, axis=0)) < len(keys) or not np.isin(table["hour"], np.arange(1, 25)).all():
        raise InputError(f"{file}: there is not one row for each hour; use an hourly EPW file")
    bad = int((~((table[["dni", "dhi"]] >= 0) & (table[["dni", "dhi"]] < _MISSING)).all(axis=1)).sum())
    if bad:
        raise InputError(
            f"{file}: {bad} of {len(table)} rows lack direct or diffuse radiation; use a complete EPW file"
        )


def _starts(table: Any, offset: float, file: str) -> NDArray[np.int64]:
    """(n,) int64: start of each row's hour, in seconds since 1970 UTC."""
    year = table["year"].to_numpy(np.int64)
    if (year != year[0]).any():  # a typical year
        year = np.full(len(year), TYPICAL_YEAR)
    month, day, hour = (table[name].to_numpy(np.int64) for name in ("month", "day", "hour"))
    months = ((year - 1970) * 12 + month - 1).astype("datetime64[M]")
    days = months.astype("datetime64[D]") + (day - 1)
    if not ((month >= 1) & (month <= 12) & (day >= 1) & (days.astype("datetime64[M]") == months)).all():
        raise InputError(f"{file}: some rows have a day that does not exist; download the file again")
    starts = days.astype("datetime64[s]").astype(np.int64) + _HOUR * (hour - 1) - round(_HOUR * offset)
    if (np.diff(starts) <= 0).any():
        raise InputError(f"{file}: its rows are not in the order of time; use an EPW file of one year")
    return np.asarray(starts)


def _offset_text(hours: float) -> str:
    """A fixed offset, as `parse_zone` reads it."""
    text = timezone(timedelta(minutes=round(60 * hours))).tzname(None)
    return "+00:00" if text == "UTC" else text[3:]
