"""Weather on days, and clear skies."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sun.epw_file import read_epw
from antumbra.city.sun.solar_radiation import clear_sky, on_days
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import parse_days, zone_of
from weather_files import epw


def test_days_are_chosen_without_their_year(tmp_path):
    weather = on_days(read_epw(epw(tmp_path))[0], parse_days("2026-03-21,2030-12-31"))
    assert len(weather.dni) == 48 and set((weather.dni // 100).tolist()) == {0.0, 3.0, 12.0}
    assert set(weather.dhi[:24].tolist()) == {0, 21} and set(weather.dhi[24:].tolist()) == {0, 31}
    with pytest.raises(at.InputError, match="none of these days"):
        on_days(weather, parse_days("2026-03-22"))


def test_days_that_the_weather_lacks_are_noted(tmp_path):
    weather = read_epw(epw(tmp_path))[0]
    assert on_days(weather, parse_days("2024-02-28,2024-03-01")).notes == ()
    leap = on_days(weather, parse_days("2024-02-27:2024-03-02"))
    assert len(leap.dni) == 4 * 24 and leap.notes == ("the weather file lacks 29 February of the 5 days",)
    day = on_days(weather, parse_days("2026-06-21"))
    (note,) = on_days(day, parse_days("year:2026")).notes
    assert note == "the weather file lacks 01 January and 363 more of the 365 days"


def test_a_clear_sky():
    place = Place(52.0, 4.4, 0.0, 0.0, "Europe/Amsterdam")
    times = at.times_of(parse_days("2026-06-21,2026-12-21"), zone_of(place))
    sky = clear_sky(place, times)
    suns = at.suns_of(place, times, "z", sky.dni)
    assert (sky.dni >= 0).all() and 700 < sky.dni.max() < 1000 and sky.dhi.max() < 250
    night = np.setdiff1d(np.arange(len(times.hours)), suns.kept)
    assert sky.dni[night].sum() < 0.01 * sky.dni.sum() and suns.dni.max() == sky.dni.max()
    assert sky.dni[:24].sum() > 2 * sky.dni[24:].sum() > 0
