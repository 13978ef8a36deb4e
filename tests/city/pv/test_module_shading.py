"""The shading of many modules: closed forms of pvlib for rows and trackers, strings, and single modules."""

import numpy as np
import pandas
import pytest

import antumbra as at

pvlib = pytest.importorskip("pvlib")

HERE = at.Place(40.0, -3.7, timezone="Europe/Madrid")
DAY = pandas.date_range("2026-12-21 08:00", periods=40, freq="15min", tz="Europe/Madrid")
FAR = at.Scene.from_arrays([[[9e4, 9e4, 0], [9e4 + 1, 9e4, 0], [9e4, 9e4 + 1, 0]]], up="z")
"""A scene with nothing that shades."""


def sun(times=DAY):
    return pvlib.solarposition.get_solarposition(times, HERE.latitude, HERE.longitude, 0.0, method="nrel_numpy")


def rows(count, pitch, axis, tilt, azimuth, lattice=(1, 64)):
    """Rows of 2 km, 2 m wide, a pitch apart perpendicular to their axis (degrees)."""
    across = np.radians(axis + 90.0)
    step = pitch * np.array([np.sin(across), np.cos(across), 0.0])
    places = [step * k + [0.0, 0.0, 3.0] for k in range(count)]
    return {f"row {k}": at.PvModule(p, 2000.0, 2.0, tilt, azimuth, lattice=lattice) for k, p in enumerate(places)}


@pytest.mark.parametrize("north, up", [(0.0, "z"), (90.0, "z"), (0.0, "y")])
def test_fixed_rows_shade_each_other_as_in_pvlib(north, up):
    """Rows that face south, 25 degrees steep: the shaded fraction of the second is that of the closed form."""
    place, scene = HERE._replace(north=north), FAR
    modules = rows(2, 4.0, 90.0, 25.0, 180.0)
    if up == "y":
        scene = at.Scene.from_arrays([[[9e4, 0, 9e4], [9e4 + 1, 0, 9e4], [9e4, 0, 9e4 - 1]]], up="y")
        turned = lambda x, y, z: (x, z, -y)
        modules = {n: m._replace(position=turned(*m.position)) for n, m in modules.items()}
    if north:  # true north points along +X
        modules = {n: m._replace(position=(m.position[1], -m.position[0], m.position[2])) for n, m in modules.items()}
    table = at.pvlib_shading(scene, modules, DAY, place=place, samples=1)
    shaded = table["shaded_fraction"].unstack("module")
    angles = sun()
    expected = pvlib.shading.shaded_fraction1d(
        90.0 - angles["elevation"], angles["azimuth"], 90.0, shaded_row_rotation=25.0, collector_width=2.0, pitch=4.0
    )
    up = angles["elevation"] > 2.0
    assert np.abs(shaded["row 0"] - expected)[up].max() < 1.01 / 64 and expected[up].max() > 0.3
    assert (shaded["row 1"][up] == 0.0).all() and 5 < (expected[up] > 0.0).sum() < up.sum()


def test_trackers_shade_each_other_as_in_pvlib():
    """True tracking about a north-south axis, without backtracking: the planes turn with time."""
    angles = sun()
    found = pvlib.tracking.singleaxis(
        90.0 - angles["elevation"], angles["azimuth"], axis_azimuth=180.0, backtrack=False
    )
    modules = rows(3, 3.0, 180.0, found["surface_tilt"].to_numpy(), found["surface_azimuth"].to_numpy())
    table = at.pvlib_shading(FAR, modules, DAY, place=HERE, samples=1)
    shaded = table["shaded_fraction"].unstack("module")["row 1"]
    expected = pvlib.shading.shaded_fraction1d(
        90.0 - angles["elevation"], angles["azimuth"], 180.0, found["tracker_theta"], collector_width=2.0, pitch=3.0
    )
    up = (angles["elevation"] > 2.0) & found["tracker_theta"].notna()
    assert np.abs(shaded - expected)[up].max() < 1.01 / 64 and (expected[up] > 0.1).sum() > 5
    backtracked = pvlib.tracking.singleaxis(
        90.0 - angles["elevation"], angles["azimuth"], axis_azimuth=180.0, backtrack=True, gcr=2.0 / 3.0
    )
    modules = rows(3, 3.0, 180.0, backtracked["surface_tilt"].to_numpy(), backtracked["surface_azimuth"].to_numpy())
    shaded = at.pvlib_shading(FAR, modules, DAY, place=HERE, samples=1)["shaded_fraction"].unstack("module")["row 1"]
    assert shaded[up].max() <= 1.01 / 64


def test_the_sky_of_a_row_behind_another_is_that_of_pvlib():
    """The row in front hides the sky up to its upper edge; pvlib's diffuse loss is that of a band of sky."""
    table = at.pvlib_shading(FAR, rows(2, 4.0, 90.0, 25.0, 180.0, (1, 16)), DAY[:1], place=HERE, samples=1)
    factors = table["sky_view_factor"].groupby(level="module").first()
    tilt, open_sky = np.radians(25.0), (1.0 + np.cos(np.radians(25.0))) / 2.0
    assert factors["row 1"] == pytest.approx(open_sky, abs=2e-3)
    along = (np.arange(16) + 0.5) / 16.0 - 0.5  # of the sloped side
    away = 4.0 - 2.0 * (0.5 + along * -1.0) * 0.0 - 2.0 * np.cos(tilt) * (0.5 - along)
    rise = 2.0 * np.sin(tilt) * (0.5 - along)
    masked = np.arctan2(rise, 4.0 - 2.0 * np.cos(tilt) * (0.5 - along))
    assert (away > 0.0).all()
    expected = (1.0 + np.cos(tilt + masked)) / 2.0  # pvlib.shading: the sky between the mask and the plane
    assert factors["row 0"] == pytest.approx(expected.mean(), abs=4e-3) and expected.mean() < open_sky - 0.01


def test_many_modules_have_what_each_has_alone():
    wall = at.Scene.from_arrays([[[-10, -1e4, 0], [-10, 1e4, 0], [-10, 0, 10]]], up="z")
    places = np.random.default_rng(3).uniform([-9, -9, 0.5], [9, 9, 4], (40, 3))
    sites = {f"site {k}": at.PvModule(p, tilt=20.0 + k % 30, azimuth=150.0 + k) for k, p in enumerate(places)}
    table = at.pvlib_shading(wall, sites, DAY, place=HERE)
    assert table.index.names == ["module", "time"] and len(table) == 40 * len(DAY)
    for name in ("site 0", "site 17", "site 39"):
        alone = at.pvlib_shading(wall, sites[name], DAY, place=HERE).loc["1"]
        assert np.array_equal(alone.to_numpy(), table.loc[name].to_numpy())
    free = at.pvlib_shading(wall, places[17], DAY, place=HERE, tilt=37.0, azimuth=167.0)
    front = np.sin(np.radians(free["solar_elevation"])) * 0 + np.asarray(
        pvlib.irradiance.aoi(37.0, 167.0, 90.0 - free["solar_elevation"], free["solar_azimuth"])
    )
    lit = (front < 89.0) & (free["solar_elevation"] > 1.0)
    assert np.allclose(free["shaded_fraction"][lit], table.loc["site 17"]["shaded_fraction"][lit])
    assert free["sky_view_factor"].iloc[0] == pytest.approx(table.loc["site 17"]["sky_view_factor"].iloc[0], abs=2e-3)


def test_modules_without_a_string_are_noted():
    modules = rows(3, 4.0, 90.0, 25.0, 180.0)
    modules["row 0"] = modules["row 0"]._replace(string="a")
    with pytest.warns(UserWarning, match="2 of 3 modules have no string: left out"):
        assert at.module_shading(FAR, modules, DAY[:2], place=HERE, samples=1, per="string").names == ["a"]


def test_strings_have_the_mean_and_the_most_of_their_modules():
    modules = {n: m._replace(string="a" if n != "row 2" else "b") for n, m in rows(3, 4.0, 90.0, 25.0, 180.0).items()}
    each = at.module_shading(FAR, modules, DAY, place=HERE, samples=1)
    found = at.module_shading(FAR, modules, DAY, place=HERE, samples=1, per="string")
    assert found.names == ["a", "b"] and found.frame().index.names == ["string", "time"]
    assert np.allclose(found.shaded_fraction[0], each.shaded_fraction[:2].mean(0))
    assert np.array_equal(found.most_shaded[0], each.shaded_fraction[:2].max(0))
    assert np.array_equal(found.most_shaded[1], each.shaded_fraction[2]) and found.most_shaded[0].max() > 0.2


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: at.PvModule((0, 0, 0), 1.0), "a width and a height, or neither"),
        (lambda: at.PvModule((0, 0, 0), tilt=120.0), "tilt of a module .* is 120; it must be from 0 to 90"),
        (lambda: at.PvModule((0, 0, 0), tilt=np.nan), "is NaN"),
        (
            lambda: at.pvlib_shading(FAR, {"a": at.PvModule((0, 0, 0), tilt=[1.0, 2.0])}, DAY, place=HERE),
            "2 tilts at 40",
        ),
        (lambda: at.pvlib_shading(FAR, {}, DAY, place=HERE), "modules are"),
        (lambda: at.pvlib_shading(FAR, at.PvModule((0, 0, 0)), DAY, place=HERE, tilt=9.0), "planes of their own"),
        (
            lambda: at.module_shading(FAR, at.PvModule((0, 0, 0)), DAY, place=HERE, per="string"),
            "no module has a string",
        ),
    ],
)
def test_bad_modules(call, words):
    with pytest.raises(at.InputError, match=words):
        call()
