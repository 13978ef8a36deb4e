"""Solar radiation per time interval, measured or for a clear sky."""

from collections.abc import Iterable
from datetime import date
from typing import NamedTuple

import numpy as np

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.wording import counted
from ...sun.location import Place
from ...sun.sun_positions import Times, month_days


class Weather(NamedTuple):
    """Radiation per time interval."""

    times: Times  # n intervals
    dni: np.ndarray  # (n,) float64, direct normal irradiance, W/m2
    dhi: np.ndarray  # (n,) float64, diffuse horizontal irradiance, W/m2
    notes: tuple[str, ...] = ()  # what may be wrong with it


def on_days(weather: Weather, days: Iterable[date]) -> Weather:
    """The intervals of a year's weather that fall on some days, regardless of their year.

    days : iterable of datetime.date

    A note counts the days that the weather does not cover, such as 29 February of a typical year.

    Raises
    ------
    InputError
        If the weather covers none of the days.
    """
    numbers, wanted = month_days(weather.times.local), {100 * day.month + day.day: day for day in days}
    selected = np.isin(numbers, list(wanted))
    if not selected.any():
        raise InputError("the weather file has none of these days; choose others")
    there = set(numbers.tolist())
    missing = [day for number, day in sorted(wanted.items()) if number not in there]
    more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
    notes = [f"the weather file lacks {missing[0]:%d %B}{more} of the {counted(len(wanted), 'day')}"] if missing else []
    return Weather(
        Times(*(column[selected] for column in weather.times)), weather.dni[selected], weather.dhi[selected],
        (*weather.notes, *notes),
    )  # fmt: skip


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
