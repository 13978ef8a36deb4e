"""Days and time zones: lengths of days, wall clocks, and the text of days."""

from datetime import UTC, date, datetime, timedelta, timezone
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import antumbra as at
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import instant_of, month_days, parse_days, zone_notes, zone_of

AMSTERDAM = ZoneInfo("Europe/Amsterdam")


@pytest.mark.parametrize(
    "day, hours, zone",
    [
        ("2026-03-29", 23, AMSTERDAM),
        ("2026-10-25", 25, AMSTERDAM),
        ("2026-06-21", 24, AMSTERDAM),
        ("2026-04-05", 24.5, ZoneInfo("Australia/Lord_Howe")),
        ("2018-11-04", 23, ZoneInfo("America/Sao_Paulo")),  # a day without midnight
        ("2026-10-25", 25, ZoneInfo("Atlantic/Azores")),  # a day with two midnights
        ("2026-03-29", 24, timezone(timedelta(hours=1))),
    ],
)
@pytest.mark.parametrize("step", [60, 30, 7, 1440])
def test_days_have_all_their_hours(day, hours, zone, step):
    times = at.times_of(parse_days(day), zone, step)
    assert times.hours.sum() == pytest.approx(hours) and (times.hours[:-1] == times.hours[0]).all()
    starts = times.middle - (times.hours * 1800).astype("timedelta64[s]")
    ends = times.middle + np.ceil(times.hours * 1800).astype("timedelta64[s]")
    assert (abs(starts[1:] - ends[:-1]) <= np.timedelta64(1, "s")).all()
    assert set(times.local.astype("datetime64[D]").astype(str)) == {day}
    assert times.middle.dtype == times.local.dtype == np.dtype("datetime64[s]")


def test_clocks_jump_over_an_hour_and_repeat_one():
    hours = lambda day: [t.hour for t in at.times_of(parse_days(day), AMSTERDAM).local.tolist()]
    assert hours("2026-03-29") == [0, 1, *range(3, 24)]
    assert hours("2026-10-25") == [0, 1, 2, *range(2, 24)]


def test_the_wall_clock_is_the_zones():
    times = at.times_of(parse_days("2026-03-28:2026-03-30,2026-10-24:2026-10-26"), AMSTERDAM, 17)
    for utc, local in zip(times.middle.tolist(), times.local.tolist()):
        assert utc.replace(tzinfo=UTC).astimezone(AMSTERDAM).replace(tzinfo=None) == local
    assert len(times.middle) > 500 and (np.diff(times.middle) > np.timedelta64(0, "s")).all()


def test_a_sun_is_in_the_middle_of_its_interval():
    times = at.times_of([date(2026, 6, 21)], UTC, 20)
    assert times.middle[0] == np.datetime64("2026-06-21T00:10:00") and times.hours[0] == pytest.approx(1 / 3)


@pytest.mark.parametrize(
    "text, first, last, count",
    [
        ("2026-06-21", "2026-06-21", "2026-06-21", 1),
        ("2026-03-21:2026-09-21", "2026-03-21", "2026-09-21", 185),
        ("2026-01-01:2026-01-31:7", "2026-01-01", "2026-01-29", 5),
        ("year:2026", "2026-01-01", "2026-12-31", 365),
        ("year:2028", "2028-01-01", "2028-12-31", 366),
        ("2026-06-21, 2026-01-01:2026-01-03,2026-01-02", "2026-01-01", "2026-06-21", 4),
    ],
)
def test_days_in_text(text, first, last, count):
    days = parse_days(text)
    assert (str(days[0]), str(days[-1]), len(days)) == (first, last, count) and days == sorted(set(days))


@pytest.mark.parametrize(
    "text",
    ["", "2026", "2026-02-30", "2026-06-21:", "2026-06-22:2026-06-21", "2026-01-01:2026-01-03:0", "year:26", ",",
     "1026-01-01", "2026-01-01:2026-01-03:x", "2026-01-01:2026-01-03:1:2", "year:2026:2027", "2026-6-1",
     "２０２６-01-01"],
)  # fmt: skip
def test_days_that_are_refused(text):
    with pytest.raises(at.InputError, match=r"^days ") as caught:
        parse_days(text)
    assert "\n" not in str(caught.value)


def test_steps_that_are_refused():
    for step in (0, -5, 1441, float("nan")):
        with pytest.raises(at.InputError, match=r"step .minutes. is"):
            at.times_of([date(2026, 1, 1)], UTC, step)
    with pytest.raises(at.InputError, match="there are no days; write 2026-06-21"):
        at.times_of([], UTC)


@pytest.mark.parametrize(
    "days",
    [
        3,
        1.5,
        True,
        b"2026",
        [1],
        ["2026-06-21"],
        [None],
        {"a": 1},
        datetime(2026, 6, 21),
        [datetime(2026, 6, 21)],
        date,
        np.datetime64("2026-06-21"),
        np.array(["2026-06-21"], "datetime64[D]"),
        np.array(3),
        object(),
        [[date(2026, 6, 21)]],
        "",
        "x",
        "2026-02-30",
        "year:x",
        [],
        {},
        date(1, 1, 1),
        [date(1, 1, 1)],
    ],
)
def test_days_of_wrong_types_are_refused_in_one_line(days):
    scene = at.Scene.from_arrays(np.eye(3))
    with pytest.raises(at.InputError) as caught:
        at.sun_hours(scene, "face", days, place=Place(52.0, 4.0))
    message = str(caught.value)
    assert "\n" not in message and "day" in message
    assert any(cure in message for cure in ("datetime.date", "write 2026-06-21", "exists", "choose a year"))
    if not isinstance(days, str | list | dict | np.ndarray):
        assert "give a text such as 2026-06-21, or a list of datetime.date" in message


def test_days_are_checked_before_the_scene_is_read(cli):
    for words in ("--days", "2026-02-30"), ("--step", "0"), ("--days", "x", "--rule", "en17037-medium"):
        cli("sun", "none.glb", "--latitude", 52, "--longitude", 4, *words).refused(
            "days" if "--days" in words else "step"
        )


def test_zones_of_places():
    noon = datetime(2026, 6, 1, 12)
    offset = lambda place: zone_of(place).utcoffset(noon) / timedelta(hours=1)
    assert offset(Place(52.0, 4.4)) == 0 and offset(Place(35.0, 139.7)) == 9 and offset(Place(40.0, -74.0)) == -5
    assert offset(Place(0.0, -179.9)) == -12 and offset(Place(52.0, 4.4, timezone="Europe/Amsterdam")) == 2


def test_days_of_the_year_as_numbers():
    local = np.array(["2026-01-01T00:00", "2024-02-29T23:59", "2026-12-31T12:00", "1969-03-21"], "datetime64[s]")
    np.testing.assert_array_equal(month_days(local), [101, 229, 1231, 321])


def test_local_times_that_clocks_skip_or_repeat_are_refused():
    for text, what in (("2026-03-29T02:30", "does not exist"), ("2026-10-25T02:30", "is there twice")):
        with pytest.raises(at.InputError, match=f"^{text} {what}.* in Europe/Amsterdam; add the offset"):
            instant_of(datetime.fromisoformat(text), AMSTERDAM)
        assert instant_of(datetime.fromisoformat(text + "+01:00"), AMSTERDAM).hour == 1
    for text, hour in (("2026-03-29T01:59", 0), ("2026-03-29T03:00", 1), ("2026-10-25T03:00", 2)):
        assert instant_of(datetime.fromisoformat(text), AMSTERDAM).hour == hour


@pytest.mark.parametrize(
    "longitude, zone, noted",
    [
        (4.4, "Europe/Amsterdam", False),
        (76.0, "Asia/Shanghai", False),  # 3 h ahead of the sun
        (-157.4, "Pacific/Kiritimati", False),  # a day ahead
        (-8.5, "Europe/Madrid", False),
        (103.8, "Europe/Amsterdam", True),
        (4.4, "America/New_York", True),
    ],
)
def test_a_time_zone_of_elsewhere_is_noted(longitude, zone, noted):
    notes = zone_notes(Place(10.0, longitude, timezone=zone), np.datetime64("2026-06-21T12:00", "s"))
    assert len(notes) == noted and all(zone in note and "check the time zone" in note for note in notes)


def test_studies_and_shadows_warn_of_a_time_zone_of_elsewhere():
    tower = at.Scene.from_arrays([[[-1, -1, 0], [1, -1, 0], [0, 1, 9.0]]], up="z")
    place = Place(1.35, 103.8, timezone="America/New_York")
    for ask in (
        lambda: at.sun_hours(tower, [[0.0, 0.0, 20.0]], "2026-06-21", place=place),
        lambda: at.shadow(tower, at="2026-06-21T02:00", place=place),
    ):
        with pytest.warns(UserWarning, match="noon at the longitude 103.8 is at about 01:00"):
            ask()
