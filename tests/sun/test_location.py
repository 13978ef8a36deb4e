"""Places: positions and convergence of reference systems, against projection of points to the north."""

import subprocess
import sys

import numpy as np
import pytest

import antumbra as at
from antumbra.sun.location import Place, checked_place, place_of_crs
from city_files import city, put


def box(x, y, z=0.0, half=50.0):
    return np.array([[x - half, y - half, z], [x + half, y + half, z + 30.0]])


def refused(call, *words):
    with pytest.raises(at.InputError) as caught:
        call()
    message = str(caught.value)
    assert "\n" not in message and all(word in message for word in words), message


def bearing_of_north(crs, x, y):
    """Degrees clockwise from grid north, from the positions of two points on a meridian."""
    from pyproj import Transformer

    project = Transformer.from_crs("EPSG:4326", crs, always_xy=True)
    longitude, latitude = project.transform(x, y, direction="INVERSE")
    (x0, x1), (y0, y1) = project.transform([longitude] * 2, [latitude - 1e-5, latitude + 1e-5])
    return np.degrees(np.arctan2(x1 - x0, y1 - y0))


@pytest.mark.parametrize(
    "crs, x, y",
    [
        ("EPSG:28992", 84878.0, 447586.0),
        ("EPSG:7415", 240000.0, 580000.0),
        ("EPSG:2056", 2682812.0, 1248058.0),
        ("EPSG:32631", 700000.0, 5_700_000.0),
        ("EPSG:32731", 700000.0, 5_700_000.0),
        ("EPSG:2263", 980000.0, 200000.0),
        ("EPSG:31467", 3450000.0, 5_500_000.0),
        ("EPSG:28992+5709", 84878.0, 447586.0),
    ],
)
def test_true_north_is_where_the_meridian_goes(crs, x, y):
    place = place_of_crs(crs, box(x, y))
    assert place.north == pytest.approx(bearing_of_north(crs.split("+")[0], x, y), abs=2e-3)  # the datums differ
    assert abs(place.north) > 0.005


def test_convergence_of_utm():
    """Spherical closed form: tan(convergence) = tan(longitude - central meridian) * sin(latitude)."""
    east, west = (place_of_crs("EPSG:32631", box(x, 5_700_000.0)) for x in (700_000.0, 300_000.0))
    closed = np.degrees(np.arctan(np.tan(np.radians(east.longitude - 3.0)) * np.sin(np.radians(east.latitude))))
    assert east.north == pytest.approx(-closed, abs=2e-3) and east.north == pytest.approx(-west.north)
    assert east.north < -2.0  # east of the central meridian in the north, meridians lean to the west
    assert place_of_crs("EPSG:32631", box(500_000.0, 5_700_000.0)).north == pytest.approx(0.0, abs=1e-9)


def test_positions():
    church = place_of_crs("EPSG:28992", box(155_000.0, 463_000.0, 2.0), timezone="Europe/Amsterdam")
    assert church.latitude == pytest.approx(52.15517, abs=1e-4)  # the tower in Amersfoort, origin of the grid
    assert church.longitude == pytest.approx(5.38721, abs=1e-4)
    assert church.north == pytest.approx(0.0, abs=1e-3) and church.elevation == 2.0
    assert church.timezone == "Europe/Amsterdam"
    on_side = np.array([[154_950.0, 2.0, -463_050.0], [155_050.0, 32.0, -462_950.0]])
    assert place_of_crs("EPSG:28992", on_side, "y") == church._replace(timezone=None)


def test_elevations_are_in_metres_whatever_the_unit_of_heights():
    place = place_of_crs("EPSG:2263", box(980000.0, 200000.0, 100.0))
    assert place.elevation == pytest.approx(30.48, abs=1e-3)
    assert (place.latitude, place.longitude) == pytest.approx((40.7156, -74.0153), abs=1e-3)
    place_of_crs("EPSG:2263+6360", box(980000.0, 200000.0))
    mixed = place_of_crs("EPSG:2263+5703", box(980000.0, 200000.0, 100.0))  # heights in metres
    assert mixed.elevation == 100.0 and mixed[:2] == place[:2]


@pytest.mark.parametrize(
    "crs, x, y, words",
    [
        ("EPSG:4326", 4.3, 52.0, ["no plan in metres (it is a Geographic 2D CRS)", "reproject"]),
        ("EPSG:4978", 4e6, 3e5, ["no plan in metres", "reproject"]),
        ("EPSG:2048", 0.0, 0.0, ["axes that do not point east and north"]),
        ("EPSG:28992", 0.0, 0.0, ["the middle of the scene, 0, 0, is outside its area", "give latitude, longitude"]),
        ("EPSG:28992", 1e9, 0.0, ["outside its area"]),
        ("EPSG:32631", np.inf, 0.0, ["outside its area"]),
        ("EPSG:99", 0.0, 0.0, ["crs 'EPSG:99' is unknown; write an EPSG code"]),
        ("", 0.0, 0.0, ["is unknown"]),
        (7415.5, 0.0, 0.0, ["is unknown"]),
    ],
)
def test_systems_that_are_refused(crs, x, y, words):
    refused(lambda: place_of_crs(crs, box(x, y)), *words)


@pytest.mark.parametrize(
    "field, value", [("latitude", 90.5), ("longitude", 361.0), ("north", np.nan), ("elevation", 1e5), ("latitude", "x")]
)
def test_numbers_out_of_range(field, value):
    place = Place(52.0, 4.0)
    assert checked_place(place) == place
    refused(lambda: checked_place(place._replace(**{field: value})), field, "must be a number from")


def test_longitudes_are_wrapped():
    assert [checked_place(Place(0.0, x)).longitude for x in (190.0, -180.0, 359.0)] == [-170.0, -180.0, -1.0]


def test_the_place_of_a_scene(tmp_path):
    vertices = [[84878 + x, 447586 + y, z] for x, y, z in ((0, 0, 0), (9, 0, 0), (0, 9, 0), (0, 0, 9))]
    faces = {
        "a": {"type": "Building", "geometry": [{"type": "MultiSurface", "lod": "1", "boundaries": [[[0, 1, 2, 3]]]}]}
    }
    delft = at.load(put(tmp_path, city(faces, vertices)))
    found = at.place_of(delft, timezone="Europe/Amsterdam", elevation=3)
    assert (found.latitude, found.longitude) == pytest.approx((52.0122, 4.3658), abs=1e-3)
    assert found.north == pytest.approx(0.806, abs=1e-2) and found[2] == 3.0 and found[4] == "Europe/Amsterdam"
    assert at.place_of(delft, north=-12.0).north == -12.0
    assert at.place_of(delft, latitude=10, longitude=20) == Place(10.0, 20.0)
    bare = at.Scene.from_arrays(np.array(vertices)[[0, 1, 2]] - [84878, 447586, 0], up="z")
    assert at.place_of(bare) is None
    refused(lambda: at.place_of(bare, crs="EPSG:28992"), "outside its area")
    refused(lambda: at.place_of(bare, latitude=3.0), "give both")
    wide = at.Scene.from_arrays(np.array(vertices)[[0, 1, 2]], up="z")
    assert at.place_of(wide, crs="EPSG:28992").latitude == pytest.approx(52.0122, abs=1e-3)


@pytest.mark.parametrize("zone", ["x", "", "Europe", "+99", "two\nlines", 3, b"UTC"])
def test_unknown_zones_are_refused_at_construction(zone):
    bare = at.Scene.from_arrays(np.eye(3), up="z")
    words = "timezone", "write a name such as Europe/Amsterdam, or +01:00"
    refused(lambda: Place(52.0, 4.0, timezone=zone), *words)
    refused(lambda: at.place_of(bare, latitude=52.0, longitude=4.0, timezone=zone), *words)
    refused(lambda: at.place_of(bare, timezone=zone), *words)  # also where there is no place


@pytest.mark.parametrize("crs", ["x", "", "EPSG:1", "two\nlines", 3, b"EPSG:28992"])
def test_an_unknown_crs_is_refused_before_the_scene_is_read(crs):
    for more in ({}, {"latitude": 52.0, "longitude": 4.0}):
        refused(lambda more=more: at.place_of("none.glb", crs=crs, **more), "crs")


def test_wrong_positions_are_refused_before_the_scene_is_read(cli):
    for words, message in (
        (("--latitude", 52), "give both"),
        (("--latitude", 91, "--longitude", 4), "latitude is 91"),
        (("--timezone", "x"), "timezone 'x' is unknown; write a name such as Europe/Amsterdam"),
        (("--north", 999), "north is 999"),
    ):
        for command in "sun", "view":
            cli(command, "none.glb", *words).refused(message)


def test_places_import_nothing_heavy():
    program = """
import sys
import antumbra as at

scene = at.Scene.from_arrays([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]])
assert at.place_of(scene) is None
at.place_of(scene, latitude=52, longitude=4, timezone="Europe/Amsterdam")
print({"pyproj", "pvlib", "pandas", "scipy", "rasterio"} & set(sys.modules))
"""
    assert subprocess.run([sys.executable, "-c", program], capture_output=True, text=True).stdout == "set()\n"
