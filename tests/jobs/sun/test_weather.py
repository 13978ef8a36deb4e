"""EPW files that the test writes, and clear skies."""

from datetime import date, timedelta

import numpy as np
import pytest

import antumbra as at
from antumbra.jobs.sun.location import Place
from antumbra.jobs.sun.solar_radiation import TYPICAL_YEAR, clear_sky, on_days, read_epw
from antumbra.jobs.sun.sun_positions import parse_days, zone_of

HEAD = """LOCATION,Delft,-,NLD,IWEC,063440,52.0,4.4,1.0,-2.0
DESIGN CONDITIONS,0
TYPICAL/EXTREME PERIODS,0
GROUND TEMPERATURES,0
HOLIDAYS/DAYLIGHT SAVINGS,No,0,0,0
COMMENTS 1,none
COMMENTS 2,none
DATA PERIODS,1,1,Data,Sunday, 1/ 1,12/31
"""


def row(day, hour, dni, dhi, year=None):
    fields = ["0"] * 35
    fields[:6] = str(year or day.year), str(day.month), str(day.day), str(hour), "60", "?9"
    fields[14], fields[15] = str(dni), str(dhi)
    return ",".join(fields)


def year_of(number):
    return [date(number, 1, 1) + timedelta(days=k) for k in range(366 if number % 4 == 0 else 365)]


def epw(folder, rows=None, head=HEAD, name="a.epw"):
    """Each row's direct radiation is 100 * month + hour, its diffuse radiation the day of the month."""
    if rows is None:
        rows = [row(d, h, 100 * d.month + h, d.day) for d in year_of(2023) for h in range(1, 25)]
    path = folder / name
    path.write_text(head + "\n".join(rows) + "\n")
    return path


def test_rows_are_the_hours_before_their_time_stamps(tmp_path):
    weather, place = read_epw(epw(tmp_path))
    assert place == Place(52.0, 4.4, -2.0, 0.0, "+01:00")
    assert weather.times.local[0] == np.datetime64("2023-01-01T00:30")
    assert weather.times.middle[0] == np.datetime64("2022-12-31T23:30")
    assert len(weather.dni) == 8760 and (weather.times.hours == 1.0).all()
    for local, dni, dhi in zip(weather.times.local.tolist()[::97], weather.dni[::97], weather.dhi[::97]):
        assert dni == 100 * local.month + local.hour + 1 and dhi == local.day


def test_a_given_place_keeps_its_own_position_and_clock(tmp_path):
    mine = Place(51.0, 5.0, 7.0, 2.0, "Europe/Amsterdam")
    weather, place = read_epw(epw(tmp_path), mine)
    assert place == mine
    assert weather.times.middle[0] == np.datetime64("2022-12-31T23:30")  # rows follow the file's clock
    summer = weather.times.middle == np.datetime64("2023-06-21T11:30")
    assert weather.times.local[summer] == np.datetime64("2023-06-21T13:30") and weather.dni[summer] == 613
    assert read_epw(epw(tmp_path), mine._replace(timezone=None))[1].timezone == "+01:00"


def test_years(tmp_path):
    typical = [row(d, h, 5, 5, 1990 + d.month) for d in year_of(2023) for h in range(1, 25)]
    times = read_epw(epw(tmp_path, typical))[0].times
    assert set(times.local.astype("datetime64[Y]").astype(str)) == {str(TYPICAL_YEAR)} and len(times.hours) == 8760
    leap = [row(d, h, 5, 5) for d in year_of(2024) for h in range(1, 25)]
    times = read_epw(epw(tmp_path, leap))[0].times
    assert len(times.hours) == 8784 and (np.diff(times.middle) == np.timedelta64(3600, "s")).all()


def test_zones_of_half_an_hour(tmp_path):
    weather, place = read_epw(epw(tmp_path, head=HEAD.replace("1.0,-2.0", "-3.5,-2.0")))
    assert place.timezone == "-03:30" and weather.times.middle[0] == np.datetime64("2023-01-01T04:00")


def test_days_are_chosen_without_their_year(tmp_path):
    weather = on_days(read_epw(epw(tmp_path))[0], parse_days("2026-03-21,2030-12-31"))
    assert len(weather.dni) == 48 and set((weather.dni // 100).tolist()) == {3.0, 12.0}
    assert (weather.dhi[:24] == 21).all() and (weather.dhi[24:] == 31).all()
    with pytest.raises(at.InputError, match="none of these days"):
        on_days(weather, parse_days("2026-03-22"))


def test_radiation_goes_with_the_suns(tmp_path):
    weather, place = read_epw(epw(tmp_path))
    suns = at.suns_of(place, weather.times, "z", weather.dni)
    assert 4200 < len(suns.times) < 4600
    months, hours = ([getattr(t, name) for t in suns.local.tolist()] for name in ("month", "hour"))
    np.testing.assert_array_equal(suns.dni, 100 * np.array(months) + np.array(hours) + 1)


@pytest.mark.parametrize(
    "rows, words",
    [
        (["nonsense"], "not an EPW file"),
        ([row(date(2023, 1, 1), 1, 9999, 0), row(date(2023, 1, 1), 2, 5, 5)], "1 of 2 rows lack direct or diffuse"),
        ([row(date(2023, 1, 1), 1, 5, 5)] * 2, "not one row for each hour"),
        ([row(date(2023, 1, 1), 25, 5, 5)], "not one row for each hour|not an EPW file"),
        ([row(date(2024, 2, 29), 1, 5, 5, 2023)], "a day that does not exist|not an EPW file"),
        ([row(date(2023, 1, 2), 1, 5, 5), row(date(2023, 1, 1), 1, 5, 5)], "not in the order of time"),
    ],
)
def test_files_that_are_refused(tmp_path, rows, words):
    with pytest.raises(at.InputError, match=words) as caught:
        read_epw(epw(tmp_path, rows))
    assert str(caught.value).startswith("a.epw: ") and "\n" not in str(caught.value)


def test_other_files_are_refused(tmp_path):
    (tmp_path / "a.epw").write_text("hello\n")
    with pytest.raises(at.InputError, match="not an EPW file"):
        read_epw(tmp_path / "a.epw")
    with pytest.raises(at.InputError, match="no such file"):
        read_epw(tmp_path / "gone.epw")


def test_a_clear_sky():
    place = Place(52.0, 4.4, 0.0, 0.0, "Europe/Amsterdam")
    times = at.times_of(parse_days("2026-06-21,2026-12-21"), zone_of(place))
    sky = clear_sky(place, times)
    suns = at.suns_of(place, times, "z", sky.dni)
    assert (sky.dni >= 0).all() and 700 < sky.dni.max() < 1000 and sky.dhi.max() < 250
    night = np.setdiff1d(np.arange(len(times.hours)), suns.kept)
    assert sky.dni[night].sum() < 0.01 * sky.dni.sum() and suns.dni.max() == sky.dni.max()
    assert sky.dni[:24].sum() > 2 * sky.dni[24:].sum() > 0
