"""The geometry of maps: scale, convergence and the curvature of the ellipsoid, against closed forms."""

import numpy as np
import pytest

from antumbra.scene.map_point import map_point, on_earth


def transformed(crs, longitude, latitude):
    pyproj = pytest.importorskip("pyproj")
    return pyproj.Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(longitude, latitude)


def curvatures(latitude):
    """The radii of curvature of the meridian and of the prime vertical of WGS 84."""
    a, f = 6378137.0, 1.0 / 298.257223563
    e2, sine = f * (2.0 - f), np.sin(np.radians(latitude))
    return a * (1.0 - e2) / (1.0 - e2 * sine**2) ** 1.5, a / np.sqrt(1.0 - e2 * sine**2)


@pytest.mark.parametrize("latitude", [0.0, 30.0, 52.0, -60.0])
def test_web_mercator_stretches_by_the_secant_of_the_latitude(latitude):
    """A sphere of the equatorial radius a over an ellipsoid: a / (M cos) along the meridian, where it is greatest."""
    point = map_point("EPSG:3857", *transformed("EPSG:3857", 4.0, latitude))
    m, n = curvatures(latitude)
    assert m < n and point.scale == pytest.approx(6378137.0 / (m * np.cos(np.radians(latitude))), rel=1e-7)
    assert (point.longitude, point.latitude) == pytest.approx((4.0, latitude)) and point.convergence == 0.0


@pytest.mark.parametrize("latitude", [0.0, 35.0, 60.0])
@pytest.mark.parametrize("units", ["m", "us-ft", "km"])
def test_equal_areas_have_reciprocal_scales(latitude, units):
    """The cylindrical equal-area map: cos along the meridian and its reciprocal along the parallel, on a sphere."""
    crs = f"+proj=cea +R=6371000 +units={units}"
    scale = map_point(crs, *transformed(crs, 4.0, latitude)).scale
    assert scale == pytest.approx(1.0 / np.cos(np.radians(latitude)), rel=1e-6)


@pytest.mark.parametrize(
    "crs, place", [("EPSG:32631", (3.0, 52.0)), ("EPSG:2263", (-74.0, 40.7)), ("EPSG:28992", (5, 52))]
)
def test_maps_of_a_country_have_the_scale_of_the_ground(crs, place):
    assert map_point(crs, *transformed(crs, *place)).scale == pytest.approx(1.0, abs=5e-4)


def test_the_central_meridian_of_utm():
    point = map_point("EPSG:32631", *transformed("EPSG:32631", 3.0, 52.0))
    assert point.scale == pytest.approx(0.9996, abs=1e-7) and abs(point.convergence) < 1e-9
    east = map_point("EPSG:32631", *transformed("EPSG:32631", 4.0, 52.0))
    closed = np.degrees(np.arctan(np.tan(np.radians(1.0)) * np.sin(np.radians(52.0))))
    assert east.convergence == pytest.approx(closed, rel=1e-3)


@pytest.mark.parametrize("latitude", [0.0, 35.0, 52.0, 89.0])
def test_the_radius_is_the_geometric_mean_of_both_curvatures(latitude):
    m, n = curvatures(latitude)
    crs = f"+proj=stere +lat_0={latitude} +lon_0=3 +datum=WGS84"
    assert map_point(crs, 0.0, 0.0).radius == pytest.approx(np.sqrt(m * n), rel=1e-12)


def test_the_moon_has_its_own_radius():
    assert map_point("IAU_2015:30110", 0.0, 0.0).radius == 1737400.0
    assert not on_earth("IAU_2015:30110") and on_earth("EPSG:28992") and on_earth("EPSG:3857")
    assert on_earth("+proj=stere +lat_0=52 +lon_0=5 +R=6371000") and on_earth('LOCAL_CS["Undefined Cartesian SRS"]')


def test_points_off_the_map_and_beside_its_area():
    nowhere = map_point("EPSG:32631", 1e30, 0.0)
    assert not nowhere.inside and np.isnan(nowhere.scale) and nowhere.radius == pytest.approx(6_367_436, abs=1.0)
    beside = map_point("EPSG:31467", 0.0, 0.0)
    assert not beside.inside and beside.scale > 1.1
    assert map_point("EPSG:31467", 3_500_000.0, 5_500_000.0).inside
