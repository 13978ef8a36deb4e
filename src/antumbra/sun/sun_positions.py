"""Time intervals of days in a time zone, and the sun position of each interval as a direction in the scene."""

import re
from collections.abc import Iterable
from datetime import UTC, date, datetime, time, timedelta, timezone, tzinfo
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, checked_instance, choice, number, parts_of, quoted
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.wording import counted
from ..kernels.elementary import cos, sin
from .location import Place, checked_place, parse_zone

# --- Time intervals ---------------------------------------------------------------------------------------------------


FORMS = "2026-06-21, 2026-03-21:2026-09-21, 2026-01-21:2026-12-21:7 (every 7th day), year:2026, or several with commas"
"""Text forms of days."""

YEARS = 1900, 2199
"""First and last supported year."""

_MOST_MINUTES = 24 * 60
_DAYS_AT_MOST = 366 * 100
_MOST_ZONE_ERROR = 4.0  # hours from solar time: clocks in the west of China are 3.3 h ahead


class Times(NamedTuple):
    """Time intervals in ascending order, each identified by its middle."""

    middle: np.ndarray  # (n,) datetime64[s], UTC
    local: np.ndarray  # (n,) datetime64[s], the same in local time
    hours: np.ndarray  # (n,) float64, length of the interval


def times_of(days: Iterable[date], zone: tzinfo, step: float = 60) -> Times:
    """Divide each day into intervals, from midnight to midnight local time.

    A day on which clocks change has 23 or 25 hours. If the step does not divide a day, its last interval is shorter.

    Parameters
    ----------
    days : iterable of datetime.date
    zone : tzinfo
        As from `zone_of`.
    step : float
        Minutes, at least 1 second and at most a day.

    Raises
    ------
    InputError
        If there are no days, or the step is out of range.

    Examples
    --------
    >>> from datetime import date
    >>> from zoneinfo import ZoneInfo
    >>> times = at.times_of([date(2026, 6, 21)], ZoneInfo("Europe/Amsterdam"), step=60)
    >>> len(times.local), times.local[0].item().isoformat()
    (24, '2026-06-21T00:30:00')
    """
    days = sorted(set(checked_days(days)))
    if not days:
        raise InputError(f"there are no days; write {FORMS}")
    if not isinstance(zone, tzinfo):
        raise InputError(f"zone is {quoted(zone)}; it must be a tzinfo, such as zoneinfo.ZoneInfo('Europe/Amsterdam')")
    step = checked_step(step)
    seconds = round(60.0 * step)
    starts, ends = list[np.ndarray](), list[np.ndarray]()
    for day in days:
        first, last = _midnight(day, zone), _midnight(day + timedelta(days=1), zone)
        start = np.arange(first, last, seconds)
        starts.append(start)
        ends.append(np.minimum(start + seconds, last))
    return intervals(np.concatenate(starts), np.concatenate(ends), zone)


def checked_step(step: float) -> float:
    """Minutes of an interval; InputError unless `step` is from a second to a day."""
    return number(step, "step (minutes)", 1.0 / 60.0, _MOST_MINUTES, "[]")


def days_of(days: str | Iterable[date]) -> list[date]:
    """The days of a text (`parse_days`) or of an iterable of dates; otherwise an InputError."""
    return parse_days(days) if isinstance(days, str) else checked_days(days, "a text such as 2026-06-21, or ")


def checked_days(days: Iterable[date], instead: str = "") -> list[date]:
    """The days of an iterable; InputError unless all are dates. `instead`: an alternative to suggest in the message."""
    dates = parts_of(days)
    if dates is None:
        raise InputError(f"days are {quoted(days)}; give {instead}a list of datetime.date")
    for day in dates:
        if not isinstance(day, date) or isinstance(day, datetime):
            raise InputError(f"a day is {quoted(day)}; it must be a datetime.date")
        if not YEARS[0] <= day.year <= YEARS[1]:
            raise InputError(f"a day is {day}; choose a year from {YEARS[0]} to {YEARS[1]}")
    return dates


def intervals(starts: np.ndarray, ends: np.ndarray, zone: tzinfo) -> Times:
    """`Times` of intervals in seconds since 1970 UTC ((n,) int64)."""
    middle = starts + (ends - starts) // 2
    local = middle + np.array([_offset(second, zone) for second in middle.tolist()], np.int64)
    return Times(middle.astype("datetime64[s]"), local.astype("datetime64[s]"), (ends - starts) / 3600.0)


def parse_days(text: str) -> list[date]:
    """The distinct days that a text names, in ascending order.

    The forms are ``2026-06-21``; ``FIRST:LAST`` or ``FIRST:LAST:STEP``, with LAST included and STEP in days;
    ``year:2026``; or several of these separated by commas.

    Raises
    ------
    InputError
        If the text has another form, a day does not exist, or LAST is before FIRST.
    """
    days: set[date] = set()
    for part in text.split(","):
        days.update(_range(part.strip()))
    return sorted(days)


def zone_of(place: Place) -> tzinfo:
    """The time zone of a place: its own, or the whole-hour offset of its longitude, without daylight saving time.

    Raises
    ------
    InputError
        If the zone is unknown.
    """
    if place.timezone is None:
        return timezone(timedelta(hours=round(place.longitude / 15.0)))
    return parse_zone(place.timezone)


def zone_notes(place: Place, instant: np.datetime64) -> list[str]:
    """A note if the place's clocks are further from solar time than those of any country.

    instant : datetime64[s], UTC
    """
    offset = _offset(int(instant.astype(np.int64)), zone_of(place))
    hours = (offset / 3600.0 - place.longitude / 15.0 + 12.0) % 24.0 - 12.0
    if abs(hours) <= _MOST_ZONE_ERROR:
        return []
    noon = round(12.0 + hours) % 24
    return [
        f"noon at the longitude {place.longitude:g} is at about {noon:02d}:00 in the time zone {place.timezone}; check "
        "the time zone and the place"
    ]


def instant_of(when: datetime, zone: tzinfo) -> datetime:
    """A moment in UTC; without an offset of its own it is local time in `zone`.

    Raises
    ------
    InputError
        If clocks skip this local time, or show it twice.
    """
    if when.tzinfo is not None:
        return when.astimezone(UTC)
    first, second = (when.replace(tzinfo=zone, fold=fold) for fold in (0, 1))
    if first.utcoffset() != second.utcoffset():
        skipped = first.astimezone(UTC).astimezone(zone).replace(tzinfo=None) != when.replace(fold=0)
        what = "does not exist, since clocks skip it" if skipped else "is there twice, since clocks are set back"
        raise InputError(f"{when.isoformat(timespec='minutes')} {what} in {zone}; add the offset, such as +02:00")
    return first.astimezone(UTC)


def months_of(local: NDArray[np.datetime64]) -> NDArray[np.int64]:
    """(n,) int64: the months of (n,) datetime64, 0 to 11."""
    return np.asarray(local.astype("datetime64[M]").astype(np.int64) % 12)


def month_days(local: NDArray[np.datetime64]) -> NDArray[np.int64]:
    """(n,) int64: 100 * month + day of (n,) datetime64."""
    months = local.astype("datetime64[M]")
    days = (local.astype("datetime64[D]") - months.astype("datetime64[D]")).astype(np.int64) + 1
    return np.asarray(100 * (months_of(local) + 1) + days)


def _offset(second: int, zone: tzinfo) -> int:
    """Seconds that local time is ahead of UTC, at an instant in seconds since 1970."""
    return int((datetime.fromtimestamp(second, zone).utcoffset() or timedelta()).total_seconds())


def _midnight(day: date, zone: tzinfo) -> int:
    """Seconds since 1970 UTC at which a day begins in local time."""
    return int(datetime.combine(day, time(), zone).timestamp())


def _range(text: str) -> list[date]:
    parts = text.split(":")
    if parts[0] == "year" and len(parts) == 2:
        return _days(_day(f"{parts[1]}-01-01", text), _day(f"{parts[1]}-12-31", text), 1)
    ends = [_day(part, text) for part in parts[:2]]
    step = parts[2] if len(parts) == 3 else "1"
    if len(parts) > 3 or ends[-1] < ends[0] or not (step.isdecimal() and int(step)):
        raise InputError(
            f"days {text[:60]!r}: write FIRST:LAST:STEP, with FIRST before LAST and at least 1 day as STEP"
        )
    return _days(ends[0], ends[-1], int(step))


def _days(first: date, last: date, step: int) -> list[date]:
    count = (last - first).days // step + 1
    if count > _DAYS_AT_MOST:
        raise InputError(f"days {first}:{last} are {counted(count, 'day')}; take at most 100 years")
    return [first + timedelta(days=step * k) for k in range(count)]


def _day(text: str, full_text: str) -> date:
    reason = "write " + FORMS
    if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", text):
        try:
            day = date.fromisoformat(text)
            if YEARS[0] <= day.year <= YEARS[1]:
                return day
            reason = f"choose a year from {YEARS[0]} to {YEARS[1]}"
        except ValueError as error:
            reason = f"{error}; choose a day that exists"
    raise InputError(f"days {full_text[:60]!r}: {text[:30]!r} is not a day; {reason}")


# --- Sun positions ----------------------------------------------------------------------------------------------------


_AT_A_TIME = 16384  # instants: pvlib needs about 1 kB for each


class Suns(NamedTuple):
    """Suns above the horizon, in chronological order; each represents an interval."""

    times: np.ndarray  # (k,) datetime64[s], UTC, middle of the interval
    local: np.ndarray  # (k,) datetime64[s], the same in local time
    hours: np.ndarray  # (k,) float64, length of the interval
    directions: np.ndarray  # (k, 3) float64, unit vectors towards the sun in the scene's axes
    altitude: np.ndarray  # (k,) float64, degrees above the horizon, geometric: without refraction
    azimuth: np.ndarray  # (k,) float64, degrees, clockwise from true north
    dni: np.ndarray | None = None  # (k,) float64, direct normal irradiance, W/m2
    dropped: int = 0  # number of intervals in the middle of which the sun is not above the horizon
    kept: np.ndarray | None = None  # (k,) int64, index of the sun's interval in `Times`


def suns_of(place: Place, times: Times, up: str, dni: ArrayLike | None = None, *, lowest: float = 0.0) -> Suns:
    """The suns of intervals, by NREL's Solar Position Algorithm (SPA) in pvlib [Reda and Andreas 2004].

    Parameters
    ----------
    place : Place
    times : Times
    up : "y" or "z"
        The scene's up axis.
    dni : (n,) float, optional
        Direct normal irradiance of each interval, W/m2.
    lowest : float
        Degrees. Only suns higher than this are returned.

    Raises
    ------
    InputError
        If pvlib is missing, or `dni` does not fit `times`.

    Examples
    --------
    >>> from datetime import date
    >>> from zoneinfo import ZoneInfo
    >>> times = at.times_of([date(2026, 6, 21)], ZoneInfo("Europe/Amsterdam"))
    >>> suns = at.suns_of(at.Place(52.0, 4.36), times, up="z")
    >>> len(suns.times), round(suns.altitude.max().item(), 1)
    (17, 61.3)
    """
    place, up = checked_place(checked_instance(place, Place, "place")), choice(up, "up", ("y", "z"))
    checked_instance(times, Times, "times", "times_of makes them")
    lowest = number(lowest, "lowest (degrees)", -90.0, 90.0, "[]")
    if dni is not None:
        dni = as_array(dni, "dni")
        if dni.shape != times.middle.shape:
            raise InputError(
                f"dni has shape {dni.shape} for {counted(len(times.middle), 'interval')}; give one value for each"
            )
    altitude, azimuth = solar_angles(place, times.middle)
    above = np.flatnonzero(altitude > lowest)
    altitude, azimuth = altitude[above], azimuth[above]
    directions = directions_of(altitude, azimuth + place.north, up)
    radiation = None if dni is None else np.asarray(dni, np.float64)[above]
    middle, local, hours = (column[above] for column in times)
    dropped = len(times.middle) - len(above)
    return Suns(middle, local, hours, directions, altitude, azimuth, radiation, dropped, above)


def solar_angles(place: Place, instants: NDArray[np.datetime64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(geometric altitude, azimuth clockwise from true north) in degrees, for (n,) datetime64 instants in UTC."""
    import_extra("pvlib", "the position of the sun", "sun")
    import pandas
    from pvlib.solarposition import get_solarposition

    angles = np.empty((2, len(instants)))
    for first in range(0, len(instants), _AT_A_TIME):
        index = pandas.DatetimeIndex(instants[first : first + _AT_A_TIME]).tz_localize("UTC")
        positions = get_solarposition(index, place.latitude, place.longitude, place.elevation, method="nrel_numpy")
        angles[:, first : first + _AT_A_TIME] = positions["elevation"], positions["azimuth"]
    return angles[0], angles[1]


def directions_of(altitude: ArrayLike, bearing: ArrayLike, up: str) -> NDArray[np.float64]:
    """(n, 3) float64: unit vectors in the scene's axes.

    altitude, bearing : (n,) degrees; the bearing is clockwise from the scene's own north axis
    """
    altitude, bearing = np.radians(altitude), np.radians(bearing)
    east, north, height = sin(bearing) * cos(altitude), cos(bearing) * cos(altitude), sin(altitude)
    return np.stack([east, north, height] if up == "z" else [east, height, -north], axis=-1)
