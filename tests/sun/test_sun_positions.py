"""Positions of the sun, against pvlib's own output, a closed form, and another algorithm."""

from datetime import UTC, date

import numpy as np
import pandas
import pytest
from pvlib import solarposition

import antumbra as at
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import directions_of, parse_days, solar_angles, zone_of

DELFT = Place(52.0122, 4.3658, 2.0, 0.806, "Europe/Amsterdam")


def suns(place=DELFT, days="2026-03-21,2026-06-21", step=60, up="z", **more):
    return at.suns_of(place, at.times_of(parse_days(days), zone_of(place), step), up, **more)


def test_angles_are_pvlibs():
    found = suns(days="2026-01-01:2026-12-31:9")
    index = pandas.DatetimeIndex(found.times).tz_localize("UTC")
    truth = solarposition.get_solarposition(index, DELFT.latitude, DELFT.longitude, DELFT.elevation)
    np.testing.assert_array_equal(found.altitude, truth["elevation"])
    np.testing.assert_array_equal(found.azimuth, truth["azimuth"])
    assert (found.altitude > 0).all() and 450 < len(found.times) < 550


def almanac(place, instants):
    """Altitude and azimuth by the low-precision formulas of the Astronomical Almanac [Michalsky 1988]; 0.01 degrees."""
    days = (instants - np.datetime64("2000-01-01T12:00:00")) / np.timedelta64(86400, "s")
    anomaly, latitude = np.radians(357.528 + 0.9856003 * days), np.radians(place.latitude)
    along = np.radians(280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly) + 0.020 * np.sin(2 * anomaly))
    tilt = np.radians(23.439 - 4e-7 * days)
    right_ascension = np.arctan2(np.cos(tilt) * np.sin(along), np.cos(along))
    declination = np.arcsin(np.sin(tilt) * np.sin(along))
    sidereal = np.radians(15.0 * (18.697374558 + 24.06570982441908 * days) + place.longitude)
    hour = sidereal - right_ascension
    up = np.sin(latitude) * np.sin(declination) + np.cos(latitude) * np.cos(declination) * np.cos(hour)
    east = -np.cos(declination) * np.sin(hour)
    north = np.cos(latitude) * np.sin(declination) - np.sin(latitude) * np.cos(declination) * np.cos(hour)
    return np.degrees(np.arcsin(up)), np.degrees(np.arctan2(east, north)) % 360.0


@pytest.mark.parametrize("place", [DELFT, Place(-35.3, 149.1), Place(1.3, 103.8), Place(69.6, 18.9)])
def test_angles_are_those_of_another_algorithm(place):
    found = suns(place, "2026-01-01:2026-12-31:9")
    altitude, azimuth = almanac(place, found.times)
    np.testing.assert_allclose(found.altitude, altitude, atol=0.02)
    apart = ((found.azimuth - azimuth + 180) % 360 - 180) * np.cos(np.radians(altitude))
    np.testing.assert_allclose(apart, 0.0, atol=0.02)
    assert len(altitude) > 300


def test_many_instants_are_asked_in_pieces():
    times = at.times_of(parse_days("year:2026"), UTC, 20)
    altitude, azimuth = solar_angles(DELFT, times.middle)
    some = slice(16_380, 16_390)
    few = solar_angles(DELFT, times.middle[some])
    np.testing.assert_array_equal([altitude[some], azimuth[some]], few)
    assert len(altitude) == 365 * 72


@pytest.mark.parametrize("latitude", [0.0, 23.0, 52.0, -35.0, 66.0])
def test_noon_at_the_equinox(latitude):
    """At the equinox the declination is nearly 0, so the sun culminates at 90 degrees less the latitude."""
    place = Place(latitude, 0.0, timezone="+00:00")
    found = at.suns_of(place, at.times_of([date(2026, 3, 20)], UTC, 2), "z")
    top = found.altitude.argmax()
    assert found.altitude[top] == pytest.approx(90.0 - abs(latitude), abs=0.2)
    assert abs(found.times[top] - np.datetime64("2026-03-20T12:07:30")) < np.timedelta64(180, "s")  # equation of time
    if latitude > 1:
        assert found.azimuth[top] == pytest.approx(180.0, abs=1.0)
        np.testing.assert_allclose(found.directions[top][1], -np.sin(np.radians(latitude)), atol=5e-3)
    assert found.hours.sum() == pytest.approx(12.0, abs=0.15)  # geometric: without refraction


@pytest.mark.parametrize("north", [0.0, 0.806, -30.0])
def test_directions_are_turned_to_true_north(north):
    found = suns(DELFT._replace(north=north))
    np.testing.assert_allclose(np.linalg.norm(found.directions, axis=1), 1.0, rtol=1e-14)
    x, y, z = found.directions.T
    np.testing.assert_allclose(np.degrees(np.arcsin(z)), found.altitude, atol=1e-9)
    turned = np.degrees(np.arctan2(x, y)) - north
    np.testing.assert_allclose((turned - found.azimuth + 180) % 360 - 180, 0.0, atol=1e-9)
    other = suns(DELFT._replace(north=north), up="y").directions
    np.testing.assert_array_equal(other, np.stack([x, z, -y], axis=1))


def test_the_shadow_of_a_pole_at_noon_points_to_true_north():
    """Where true north is 90 degrees clockwise from +Y, it is +X. At noon the sun stands in the south, at -X."""
    place = Place(45.0, 0.0, 0.0, 90.0, "+00:00")
    noon = suns(place, "2026-06-21", 2)
    x, y, z = noon.directions[noon.altitude.argmax()]
    assert x < -0.3 and abs(y) < 0.02 and z > 0.9
    np.testing.assert_allclose(
        directions_of(np.zeros(4), np.array([0, 90, 180, 270]), "z").round(9) + 0.0,
        [[0, 1, 0], [1, 0, 0], [0, -1, 0], [-1, 0, 0]],
    )


def test_intervals_of_the_night_are_dropped():
    times = at.times_of(parse_days("2026-06-21"), zone_of(DELFT), 60)
    radiation = np.arange(24.0)
    found = at.suns_of(DELFT, times, "z", radiation)
    assert found.dropped + len(found.times) == 24 and 5 < found.dropped < 9
    np.testing.assert_array_equal(found.dni, radiation[found.kept])
    np.testing.assert_array_equal(found.local, times.local[found.kept])
    high = at.suns_of(DELFT, times, "z", lowest=10.0)
    assert high.altitude.min() > 10.0 and high.dropped > found.dropped and high.dni is None
    assert [len(column) for column in found[:7]] == [len(found.times)] * 7


def test_the_polar_night_has_no_suns():
    found = suns(Place(80.0, 20.0), "2026-12-21")
    assert found.directions.shape == (0, 3) and found.dropped == 24


def test_radiation_must_fit():
    with pytest.raises(at.InputError, match=r"dni has shape \(3,\) for 24 intervals"):
        suns(days="2026-06-21", dni=np.zeros(3))
