"""`pvlib_shading`: closed forms of a wall, exact rays, and pandas indexes."""

import numpy as np
import pandas
import pytest

import antumbra as at

HERE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
DAY = pandas.date_range("2026-06-21", periods=96, freq="15min", tz="Europe/Amsterdam")


def wall(up="z", easting=-10.0, height=10.0):
    """A long wall along north."""
    corners = np.array([[easting, -1e4, 0], [easting, 1e4, 0], [easting, 1e4, height], [easting, -1e4, height]])
    corners = corners if up == "z" else np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], 1)
    return at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up=up)


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_wall_in_the_west_hides_the_sun_in_the_afternoon(up):
    found = at.pvlib_shading(wall(up), [[0.0, 0.0, 0.0]], DAY, place=HERE, samples=1)
    assert found.index is DAY or found.index.equals(DAY)
    elevation, azimuth = np.radians(found["solar_elevation"]), np.radians(found["solar_azimuth"])
    profile = np.degrees(np.arctan2(np.tan(elevation), -np.sin(azimuth)))  # of the sun, seen along the wall
    clear = np.abs(profile - 45.0) > 0.1
    hidden = (elevation <= 0.0) | ((np.sin(azimuth) < 0.0) & (profile < 45.0))
    assert np.array_equal(found["shaded_fraction"][clear], hidden[clear].astype(float))
    day = elevation > 0.0
    assert 0 < hidden[day].sum() < day.sum()


def test_the_disk_sets_behind_the_wall_gradually():
    fine = pandas.date_range("2026-06-21 15:00", periods=180, freq="1min", tz="Europe/Amsterdam")
    shaded = at.pvlib_shading(wall(), [0.0, 0.0, 0.0], fine, place=HERE, samples=64)["shaded_fraction"]
    partly = (shaded > 0.0) & (shaded < 1.0)
    assert shaded.iloc[0] == 0.0 and shaded.iloc[-1] == 1.0 and 2 <= partly.sum() <= 8
    assert (np.diff(shaded) >= -0.05).all()


def test_a_module_has_the_mean_of_its_points():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 20.0]])  # the upper one sees over the wall
    both = at.pvlib_shading(wall(), points, DAY, place=HERE)
    each = [at.pvlib_shading(wall(), point, DAY, place=HERE) for point in points]
    for name in ("shaded_fraction", "sky_view_factor"):
        assert np.allclose(both[name], (each[0][name] + each[1][name]) / 2.0)
    assert not np.allclose(each[0]["shaded_fraction"], each[1]["shaded_fraction"])


def test_the_share_of_the_sky_is_that_of_the_plane():
    # A wall of 45 degrees hides (1 - cos 45) / 2 of the light of a uniform sky.
    flat = at.pvlib_shading(wall(), [0.0, 0.0, 0.0], DAY[:2], place=HERE)["sky_view_factor"]
    assert np.allclose(flat, 1.0 - (1.0 - np.cos(np.pi / 4.0)) / 2.0, atol=1e-3)
    away = at.pvlib_shading(wall(), [0.0, 0.0, 0.0], DAY[:2], place=HERE, tilt=90.0, azimuth=90.0)["sky_view_factor"]
    assert np.allclose(away, 0.5, atol=1e-3)
    assert (
        at.pvlib_shading(wall(), [0, 0, 0], DAY[:2], place=HERE, tilt=90, azimuth=270)["sky_view_factor"] < 0.25
    ).all()


def test_north_turns_the_sun():
    turned = at.pvlib_shading(wall(), [0.0, 0.0, 0.0], DAY, place=HERE._replace(north=180.0), samples=1)
    day = turned["solar_elevation"] > 1.0
    morning = turned[day & (turned["solar_azimuth"] < 80.0)]
    assert len(morning) > 3 and morning["shaded_fraction"].mean() > 0.5


def test_bad_input():
    scene, point = wall(), [0.0, 0.0, 1.0]
    for words, call in {
        "time zone; tz_localize": lambda: at.pvlib_shading(scene, point, DAY.tz_localize(None), place=HERE),
        "^times must be": lambda: at.pvlib_shading(scene, point, ["2026-06-21"], place=HERE),
        "NaT": lambda: at.pvlib_shading(scene, point, DAY.insert(1, pandas.NaT), place=HERE),
        "the place is unknown": lambda: at.pvlib_shading(scene, point, DAY),
        "^samples": lambda: at.pvlib_shading(scene, point, DAY, place=HERE, samples=0),
        "^tilt": lambda: at.pvlib_shading(scene, point, DAY, place=HERE, tilt=-1),
        "there is no point": lambda: at.pvlib_shading(scene, np.empty((0, 3)), DAY, place=HERE),
    }.items():
        with pytest.raises(at.InputError, match=words):
            call()
