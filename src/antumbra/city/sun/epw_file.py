"""EPW weather files: direct and diffuse radiation for each hour, checked against the sun at the file's position."""

from datetime import timedelta, timezone
from os import PathLike
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import path_of
from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.files import checked_file
from ...base.wording import percent, some_of
from ...kernels.elementary import asin, atan2, cos, sin
from ...scene.map_point import MEAN_RADIUS
from ...sun.location import Place, checked_place
from ...sun.sun_positions import intervals, solar_angles, zone_of
from .solar_radiation import Weather

TYPICAL_YEAR = 2025
"""Year assigned to the suns of a typical year, whose months come from several years. It has no 29 February."""

_TYPICAL_YEARS = (
    TYPICAL_YEAR,
    2024,
    2023,
)  # the first year of rows that may have a 29 February before or after a January
_HEADER = 8  # lines
_COLUMNS = 0, 1, 2, 3, 14, 15  # year, month, day, hour, direct normal and diffuse horizontal radiation
_MONTH = 720  # hours
_MISSING = 9999.0  # marks missing radiation
_HOUR, _DAY = 3600, 86400  # seconds
_LIT = 10.0  # W/m2: less is twilight, or the noise of an instrument
_DARK = -9.0  # degrees: the sun stays below the horizon for an hour around an altitude this low, also by refraction
_MOST_CLOCK_ERROR = 0.4  # hours: less than the half hour by which time zones differ
_MOST_IN_THE_DARK = 0.01  # of the radiation, in hours without sun
_FAR = 100.0  # km between a scene and its weather


def read_epw(path: str | PathLike[str], place: Place | None = None) -> tuple[Weather, Place]:
    """Read an EPW file with one row per hour. A row covers the hour before its time stamp.

    Parameters
    ----------
    path : str or path-like
        In UTF-8 or Latin-1.
    place : Place, optional
        None: the file's position and time zone. If the place has no time zone, that of the file is used.

    Returns
    -------
    weather : Weather
        The rows of at most a year, which may begin in any month. Rows whose years follow each other keep them; other
        files are typical years (TMY), which get the suns of `TYPICAL_YEAR`, or of the nearest leap year before it if
        they have a 29 February.
    place : Place

    Raises
    ------
    InputError
        If pvlib is missing, the file is not an EPW file or has no rows, it has several rows per hour, radiation is
        missing, or more than 1 % of the radiation falls in the night in any time zone.

    Notes
    -----
    The hours with radiation must be centred on solar noon at the file's position. `Weather.notes` names the time zone
    that fits if they are not, and a place far from the file's position. The time of light does not depend on clouds.
    """
    import_extra("pvlib", "an EPW file", "sun")
    path = path_of(path, "epw")
    checked_file(path, path.name)
    rows, measured_at = _parsed(path)
    if not len(rows.hour):
        raise InputError(f"{path.name}: has no rows below its header; download it again")
    _check(rows, path.name)
    place = checked_place(
        measured_at if place is None else place._replace(timezone=place.timezone or measured_at.timezone)
    )
    starts = _starts(rows, _offset(measured_at), path.name)
    weather = Weather(intervals(starts, starts + _HOUR, zone_of(place)), rows.dni, rows.dhi)
    notes = [*_clock_notes(weather, measured_at, path.name), *_distance_notes(place, measured_at, path.name)]
    return weather._replace(notes=tuple(notes)), place


class _EpwRows(NamedTuple):
    """The columns of n rows, as they are written."""

    year: NDArray[np.int64]
    month: NDArray[np.int64]
    day: NDArray[np.int64]
    hour: NDArray[np.int64]  # 1 to 24
    dni: NDArray[np.float64]
    dhi: NDArray[np.float64]


def _parsed(path: Path) -> tuple[_EpwRows, Place]:
    """The rows of a file, and its place."""
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("latin-1")  # any bytes are; only the names of places are not ASCII
    lines = text.splitlines()
    try:
        latitude, longitude, zone, elevation = (float(field) for field in lines[0].split(",")[6:10])
        place = Place(latitude, longitude, elevation, 0.0, _offset_text(zone))
        rows = [line.split(",") for line in lines[_HEADER:] if line.strip()]
        table = np.array([[float(row[k]) for k in _COLUMNS] for row in rows], np.float64).reshape(-1, len(_COLUMNS))
        if not (table[:, :4] == (whole := table[:, :4].astype(np.int64))).all():
            raise ValueError("fractions of an hour")
    except (ValueError, IndexError, OverflowError) as error:  # InputError is a ValueError
        raise InputError(f"{path.name}: not an EPW file ({str(error)[:100]}); download it again") from None
    return _EpwRows(*whole.T, *table[:, 4:].T), place


def _check(rows: _EpwRows, file: str) -> None:
    hours = np.stack(rows[1:4], 1)
    if len(np.unique(np.stack(rows[:4], 1), axis=0)) < len(hours) or not ((rows.hour >= 1) & (rows.hour <= 24)).all():
        raise InputError(f"{file}: there is not one row for each hour; use an hourly EPW file")
    if len(np.unique(hours, axis=0)) < len(hours):
        raise InputError(f"{file}: some days are there in several years; use an EPW file of one year")
    good = [(values >= 0.0) & (values < _MISSING) for values in (rows.dni, rows.dhi)]
    if bad := int((~(good[0] & good[1])).sum()):
        raise InputError(
            f"{file}: {some_of(bad, len(hours), 'row', 'lack')} direct or diffuse radiation; use a complete EPW file"
        )


# --- Time -------------------------------------------------------------------------------------------------------------


def _starts(rows: _EpwRows, offset: int, file: str) -> NDArray[np.int64]:
    """(n,) int64: start of each row's hour, in seconds since 1970 UTC; `offset`: seconds ahead of UTC."""
    year, month, day, hour, *_ = rows
    turn = np.diff(month) < 0  # from December to January
    later = np.append(0, np.cumsum(turn))
    firsts = [*([year[0]] if (np.diff(year) == turn).all() else []), *_TYPICAL_YEARS]
    for first in firsts:
        months = ((first + later - 1970) * 12 + month - 1).astype("datetime64[M]")
        days = months.astype("datetime64[D]") + (day - 1)
        if ((month >= 1) & (month <= 12) & (day >= 1) & (days.astype("datetime64[M]") == months)).all():
            break
    else:
        raise InputError(f"{file}: some rows have a day that does not exist; download the file again")
    starts = days.astype("datetime64[s]").astype(np.int64) + _HOUR * (hour - 1) - offset
    if (np.diff(starts) <= 0).any():
        raise InputError(f"{file}: its rows are not in the order of time; use an EPW file of one year")
    return np.asarray(starts)


def _offset_text(hours: float) -> str:
    """A fixed offset, as `parse_zone` reads it."""
    text = timezone(timedelta(minutes=round(60 * hours))).tzname(None)
    return "+00:00" if text == "UTC" else text[3:]


def _offset(place: Place) -> int:
    """Seconds that the clocks of a place with a fixed offset are ahead of UTC."""
    return int(zone_of(place).utcoffset(None).total_seconds())  # type: ignore[union-attr]


# --- Agreement of radiation and sun -----------------------------------------------------------------------------------


def _clock_notes(weather: Weather, place: Place, file: str) -> list[str]:
    """What is wrong with the file's time zone, if anything is.

    Raises
    ------
    InputError
        If the radiation falls in the night whatever the time zone is.
    """
    radiation = weather.dni + weather.dhi
    lit = radiation > _LIT
    if not lit.any():
        return [f"{file}: has no radiation in any hour"]
    middle = weather.times.middle
    error = _clock_error(middle[lit], place.longitude)
    fitted = (middle.astype(np.int64) - round(_HOUR * error)).astype("datetime64[s]")
    altitude, _ = solar_angles(place, fitted)
    dark = radiation[lit & (altitude < _DARK)].sum() / radiation.sum()
    where = f"{place.latitude:g}, {place.longitude:g}"
    if dark > _MOST_IN_THE_DARK:
        raise InputError(
            f"{file}: {percent(dark)} of its radiation falls in the night at {where}, whatever the time zone; correct "
            "the latitude, longitude and time zone in its first line"
        )
    step = 1.0 if len(middle) < _MONTH else 0.25  # hours: in whole hours, the light of a day has no better centre
    if abs(error) <= max(_MOST_CLOCK_ERROR, 0.75 * step):
        return []
    hours = _offset(place) / 3600.0 + error
    fitting = _offset_text(step * round(((hours + 12.0) % 24.0 - 12.0) / step))
    side = "before" if error < 0.0 else "after"
    return [
        f"{file}: its radiation is centred {abs(error):.1f} h {side} noon at {where} in its time zone, "
        f"{place.timezone}; {fitting} fits, so correct the time zone, or the longitude, in its first line"
    ]


def _clock_error(lit: NDArray[np.datetime64], longitude: float) -> float:
    """Hours from solar noon to the centre of the instants with light, from -12 to 12."""
    from pvlib.solarposition import equation_of_time_spencer71

    second, day = lit.astype(np.int64), lit.astype("datetime64[D]")
    day_of_year = (day - lit.astype("datetime64[Y]")).astype(np.int64) + 1
    minutes = np.asarray(equation_of_time_spencer71(day_of_year))
    angle = 2.0 * np.pi * ((second % _DAY) / _DAY - 0.5 + longitude / 360.0 + minutes / 1440.0)
    return float(atan2(sin(angle).sum(), cos(angle).sum()) * 12.0 / np.pi)


def _distance_notes(place: Place, measured_at: Place, file: str) -> list[str]:
    """A note if the place is not that of the weather."""
    (a, along), (b, other) = (np.radians((each.latitude, each.longitude)) for each in (place, measured_at))
    half = float(sin((b - a) / 2.0) ** 2 + cos(a) * cos(b) * sin((other - along) / 2.0) ** 2)
    distance = 2.0 * MEAN_RADIUS / 1000.0 * float(asin(np.sqrt(min(half, 1.0))))
    if distance <= _FAR:
        return []
    where = f"{measured_at.latitude:g}, {measured_at.longitude:g}"
    return [f"{file}: is the weather at {where}, {distance:,.0f} km from the scene; use a file of a nearer station"]
