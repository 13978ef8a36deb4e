"""EPW files that tests write."""

from datetime import date, timedelta

import numpy as np

from antumbra.city.sun.solar_radiation import clear_sky
from antumbra.sun.sun_positions import intervals, parse_days, times_of, zone_of

HEAD = """LOCATION,Delft,-,NLD,IWEC,063440,52.0,4.4,1.0,-2.0
DESIGN CONDITIONS,0
TYPICAL/EXTREME PERIODS,0
GROUND TEMPERATURES,0
HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0
COMMENTS 1,none
COMMENTS 2,none
DATA PERIODS,1,1,Data,Sunday, 1/ 1,12/31
"""

LIT = range(10, 17)
"""Hours of `epw` with radiation: centred on noon in Delft, and by day also in winter."""


def row(day, hour, dni, dhi, year=None):
    fields = ["0"] * 35
    fields[:6] = str(year or day.year), str(day.month), str(day.day), str(hour), "60", "?9"
    fields[14], fields[15] = str(dni), str(dhi)
    return ",".join(fields)


def year_of(number):
    return [date(number, 1, 1) + timedelta(days=k) for k in range(366 if number % 4 == 0 else 365)]


def epw(folder, rows=None, head=HEAD, name="a.epw"):
    """In `LIT`, each row's direct radiation is 100 * month + hour, its diffuse radiation the day of the month."""
    if rows is None:
        hours = [(d, h, h in LIT) for d in year_of(2023) for h in range(1, 25)]
        rows = [row(d, h, (100 * d.month + h) * lit, d.day * lit) for d, h, lit in hours]
    path = folder / name
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def clear_year(folder, place, *, days="2023-01-01:2023-12-31", hours=0.0, zone=None, latitude=None, years=None):
    """A file of clear skies at a place, in the place's own fixed zone.

    hours : by which the radiation comes too late
    zone : hours, written into the file instead of the place's; latitude : likewise
    years : day -> the year written in its rows
    """
    offset = zone_of(place).utcoffset(None).total_seconds()
    times = times_of(parse_days(days), zone_of(place))
    starts = times.middle.astype(np.int64) - 1800 - round(3600 * hours)
    sky = clear_sky(place, intervals(starts, starts + 3600, zone_of(place)))
    local = times.local.tolist()
    rows = [
        row(when, when.hour + 1, round(dni), round(dhi), years and years(when))
        for when, dni, dhi in zip(local, sky.dni, sky.dhi)
    ]
    lines = HEAD.splitlines()
    where = latitude or place.latitude, place.longitude, offset / 3600.0 if zone is None else zone
    lines[0] = f"LOCATION,Here,-,X,IWEC,0,{where[0]},{where[1]},{where[2]},{place.elevation}"
    return epw(folder, rows, "\n".join(lines) + "\n")
