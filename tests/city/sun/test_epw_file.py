"""EPW files that the tests write: their hours, years, encodings, and their agreement with the sun."""

from datetime import date

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sun.epw_file import TYPICAL_YEAR, read_epw
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import zone_of
from weather_files import HEAD, LIT, clear_year, epw, row, year_of


def test_rows_are_the_hours_before_their_time_stamps(tmp_path):
    weather, place = read_epw(epw(tmp_path))
    assert place == Place(52.0, 4.4, -2.0, 0.0, "+01:00")
    assert weather.times.local[0] == np.datetime64("2023-01-01T00:30")
    assert weather.times.middle[0] == np.datetime64("2022-12-31T23:30")
    assert len(weather.dni) == 8760 and (weather.times.hours == 1.0).all()
    for local, dni, dhi in zip(weather.times.local.tolist()[::97], weather.dni[::97], weather.dhi[::97]):
        hour = local.hour + 1
        assert (dni, dhi) == ((100 * local.month + hour, local.day) if hour in LIT else (0, 0))


def test_a_given_place_keeps_its_own_position_and_clock(tmp_path):
    mine = Place(51.0, 5.0, 7.0, 2.0, "Europe/Amsterdam")
    weather, place = read_epw(epw(tmp_path), mine)
    assert place == mine
    assert weather.times.middle[0] == np.datetime64("2022-12-31T23:30")  # rows follow the file's clock
    summer = weather.times.middle == np.datetime64("2023-06-21T11:30")
    assert weather.times.local[summer] == np.datetime64("2023-06-21T13:30") and weather.dni[summer] == 613
    assert read_epw(epw(tmp_path), mine._replace(timezone=None))[1].timezone == "+01:00"


def test_years(tmp_path):
    typical = [row(d, h, 5, 5 * (h in LIT), 1990 + d.month) for d in year_of(2023) for h in range(1, 25)]
    times = read_epw(epw(tmp_path, typical))[0].times
    assert set(times.local.astype("datetime64[Y]").astype(str)) == {str(TYPICAL_YEAR)} and len(times.hours) == 8760
    leap = [row(d, h, 5, 5) for d in year_of(2024) for h in range(1, 25)]
    times = read_epw(epw(tmp_path, leap))[0].times
    assert len(times.hours) == 8784 and (np.diff(times.middle) == np.timedelta64(3600, "s")).all()


def test_zones_of_half_an_hour(tmp_path):
    weather, place = read_epw(epw(tmp_path, head=HEAD.replace("1.0,-2.0", "-3.5,-2.0")))
    assert place.timezone == "-03:30" and weather.times.middle[0] == np.datetime64("2023-01-01T04:00")


def test_radiation_goes_with_the_suns(tmp_path):
    weather, place = read_epw(epw(tmp_path))
    suns = at.suns_of(place, weather.times, "z", weather.dni)
    assert 4200 < len(suns.times) < 4600
    months, hours = ([getattr(t, name) for t in suns.local.tolist()] for name in ("month", "hour"))
    lit = np.isin(np.array(hours) + 1, LIT)
    np.testing.assert_array_equal(suns.dni, np.where(lit, 100 * np.array(months) + np.array(hours) + 1, 0))


@pytest.mark.parametrize(
    "rows, words",
    [
        (["nonsense"], "not an EPW file"),
        ([row(date(2023, 1, 1), 1, 9999, 0), row(date(2023, 1, 1), 2, 5, 5)], "1 of 2 rows lacks direct or diffuse"),
        ([row(date(2023, 1, 1), 1, 5, 5)] * 2, "not one row for each hour"),
        ([row(date(2023, 1, 1), 25, 5, 5)], "not one row for each hour|not an EPW file"),
        ([row(date(2023, 2, 28), 1, 5, 5).replace(",28,", ",30,")], "a day that does not exist"),
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


# --- Years and encodings ----------------------------------------------------------------------------------------------


@pytest.fixture
def delft():
    return Place(52.0, 4.4, 0.0, 0.0, "+01:00")


def test_the_suns_of_a_leap_year_are_there_in_a_typical_year_with_29_february(tmp_path, delft):
    """The typical year takes February from a leap year and all other months from another one."""
    years = lambda when: 2004 if when.month == 2 else 2011
    typical, _ = read_epw(clear_year(tmp_path, delft, days="year:2020", years=years))
    leap, _ = read_epw(clear_year(tmp_path, delft, days="year:2020"))
    assert len(typical.dni) == 8784 and set(typical.times.local.astype("datetime64[Y]").astype(str)) == {"2024"}
    days = [weather.times.local.astype("datetime64[s]").astype(str) for weather in (typical, leap)]
    assert [day[4:] for day in days[0]] == [day[4:] for day in days[1]]
    np.testing.assert_array_equal(typical.dni, leap.dni)


@pytest.mark.parametrize(
    "days, years, expected",
    [
        ("2019-07-01:2020-06-30", None, ("2019-07-01", "2020-06-30")),
        ("2019-07-01:2020-06-30", 2010, ("2023-07-01", "2024-06-30")),  # one year in all rows, with 29 February
        ("2018-07-01:2019-06-30", 2010, ("2025-07-01", "2026-06-30")),
        ("2019-06-21", None, ("2019-06-21", "2019-06-21")),
        ("2019-12-31,2020-01-01", None, ("2019-12-31", "2020-01-01")),
    ],
)
def test_years_may_begin_in_any_month(tmp_path, delft, days, years, expected):
    weather, _ = read_epw(clear_year(tmp_path, delft, days=days, years=years and (lambda when: years)))
    local = weather.times.local.astype("datetime64[D]").astype(str)
    assert (local[0], local[-1]) == expected and (np.diff(weather.times.middle) > np.timedelta64(0)).all()
    assert weather.notes == () and weather.dni.max() > 600


def test_a_leap_year_may_lack_29_february(tmp_path, delft):
    path = clear_year(tmp_path, delft, days="2020-02-01:2020-02-28,2020-03-01:2020-03-31")
    weather, _ = read_epw(path)
    assert len(weather.dni) == 59 * 24 and "2020-03-01" in weather.times.local.astype("datetime64[D]").astype(str)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-8-sig"])
def test_names_of_places_may_have_accents(tmp_path, encoding):
    path = epw(tmp_path)
    plain = read_epw(path)[0]
    path.write_bytes(path.read_text().replace("Delft", "Málaga").encode(encoding))
    np.testing.assert_array_equal(read_epw(path)[0].dni, plain.dni)


def test_the_days_of_several_years_are_refused(tmp_path):
    rows = [row(day, hour, 5, 5) for year in (2022, 2023) for day in year_of(year)[:40] for hour in range(1, 25)]
    with pytest.raises(at.InputError, match="some days are there in several years; use an EPW file of one year"):
        read_epw(epw(tmp_path, rows))


def test_a_file_without_rows_is_refused(tmp_path):
    with pytest.raises(at.InputError, match=r"^a\.epw: has no rows below its header; download it again$"):
        read_epw(epw(tmp_path, []))


# --- Agreement of radiation and sun -----------------------------------------------------------------------------------


PLACES = {
    "Delft": Place(52.0, 4.4, 0.0, 0.0, "+01:00"),
    "Singapore": Place(1.35, 103.8, 0.0, 0.0, "+08:00"),
    "Sydney": Place(-33.9, 151.2, 0.0, 0.0, "+10:00"),
    "Kolkata": Place(22.57, 88.36, 0.0, 0.0, "+05:30"),
    "Kathmandu": Place(27.7, 85.3, 1300.0, 0.0, "+05:45"),
    "Denver": Place(39.7, -105.0, 1600.0, 0.0, "-07:00"),
    "Tromso": Place(69.6, 19.0, 0.0, 0.0, "+01:00"),
    "Kashgar": Place(39.5, 76.0, 1300.0, 0.0, "+08:00"),  # noon is at 15:00
}
EVERY_WEEK = "2023-01-01:2023-12-31:7"


@pytest.mark.parametrize("name", PLACES)
def test_the_time_zone_of_the_radiation_is_found(tmp_path, name):
    place = PLACES[name]
    assert read_epw(clear_year(tmp_path, place, days=EVERY_WEEK))[0].notes == ()
    offset = zone_of(place).utcoffset(None).total_seconds() / 3600.0
    for zone in (offset + 1.0, offset - 0.5, offset - 6.0):
        (note,) = read_epw(clear_year(tmp_path, place, days=EVERY_WEEK, zone=zone))[0].notes
        assert f"; {place.timezone} fits, so correct the time zone" in note
    (note,) = read_epw(clear_year(tmp_path, place, days=EVERY_WEEK, hours=-offset))[0].notes  # in UTC
    assert "; +00:00 fits" in note


def test_a_day_is_enough_to_find_the_time_zone(tmp_path):
    place = PLACES["Denver"]
    for day in ("2023-02-10", "2023-11-03"):  # solar time is 14 minutes behind the mean, and 16 ahead
        assert read_epw(clear_year(tmp_path, place, days=day))[0].notes == ()
        assert "-07:00 fits" in read_epw(clear_year(tmp_path, place, days=day, zone=0.0))[0].notes[0]


@pytest.mark.parametrize("name", ["Delft", "Sydney", "Denver", "Tromso"])
def test_radiation_in_the_night_is_refused(tmp_path, name):
    place = PLACES[name]
    path = clear_year(tmp_path, place, days=EVERY_WEEK, latitude=-place.latitude)
    with pytest.raises(
        at.InputError, match=r"^a.epw: \d+.\d % of its radiation falls in the night at .*; correct the lat"
    ):
        read_epw(path)


def test_clouds_do_not_move_the_time_zone(tmp_path):
    """Each afternoon is overcast: its light is diffuse and a tenth, and its centre is in the morning."""
    place, lines = PLACES["Singapore"], []
    for line in clear_year(tmp_path, place, days=EVERY_WEEK).read_text().splitlines():
        fields = line.split(",")
        if fields[0] == "2023" and int(fields[3]) > 13:
            fields[14], fields[15] = "0", str(round(0.3 * float(fields[15])))
        lines.append(",".join(fields))
    (tmp_path / "a.epw").write_text("\n".join(lines) + "\n")
    assert read_epw(tmp_path / "a.epw")[0].notes == ()


def test_darkness_and_other_places_are_noted(tmp_path, delft):
    dark = epw(tmp_path, [row(day, hour, 0, 0) for day in year_of(2023)[:9] for hour in range(1, 25)])
    assert read_epw(dark)[0].notes == ("a.epw: has no radiation in any hour",)
    assert read_epw(epw(tmp_path), Place(52.5, 4.0))[0].notes == ()
    (note,) = read_epw(epw(tmp_path), Place(48.9, 2.3))[0].notes
    assert note == "a.epw: is the weather at 52, 4.4, 375 km from the scene; use a file of a nearer station"


def test_studies_tell_what_is_wrong_with_the_weather(tmp_path):
    floor = at.Scene.from_arrays(9.0 * np.array([[[-1, -1, 0], [1, -1, 0], [0, 1, 0.0]]]), up="z")
    path = clear_year(tmp_path, PLACES["Singapore"], days="2023-06-21", zone=0.0)
    with pytest.warns(UserWarning, match=r"centred 7.9 h after noon at 1.35, 103.8 .* \+08:00 fits"):
        table = at.sun_hours(floor, [[0.0, 0.0, 1.0]], epw=path)
    assert [note for note in table.about["warnings"] if "+08:00 fits" in note]
    path = clear_year(tmp_path, PLACES["Singapore"], days="2023-06-21")
    assert "warnings" not in at.sun_hours(floor, [[0.0, 0.0, 1.0]], epw=path).about
