"""Areas from GeoJSON and Python, their cells, and the report of BR 209 on them."""

import json

import numpy as np
import pyproj
import pytest
import rasterio

import antumbra as at
from antumbra.city.sensors.ground_areas import read_areas
from city_files import CUBE, CUBE_FACES, building, city, put, solid

FACES = np.array([corners for a, b, c, d in CUBE_FACES for corners in ([a, b, c], [a, c, d])])
CORNER = np.array([85000.0, 447000.0, 0.0])
HERE = at.Place(52.0, 4.37, timezone="Europe/Amsterdam")
SQUARE = [(0, 0), (4, 0), (4, 4), (0, 4)]


def town(folder, crs="EPSG:7415"):
    """A house of 8 x 8 x 8 on a ground from -20 to 28."""
    vertices = np.concatenate([CUBE * 8, CUBE * [48, 48, 0] - [20, 20, 0]]) + CORNER
    ground = {"type": "MultiSurface", "lod": "1", "boundaries": [[[8, 9, 10, 11]]]}
    things = {"house": building(solid()), "ground": building(ground, kind="TINRelief")}
    system = None if crs is None else f"https://www.opengis.net/def/crs/EPSG/0/{crs[5:]}"
    return at.load(put(folder, city(things, vertices, crs=system)))


def placed(*rings):
    return [[(x + CORNER[0], y + CORNER[1]) for x, y in ring] for ring in rings]


def feature(name, *rings):
    return {"type": "Feature", "properties": {"name": name}, "geometry": {"type": "Polygon", "coordinates": [*rings]}}


def collection(*features, crs="urn:ogc:def:crs:EPSG::28992"):
    named = {} if crs is None else {"crs": {"type": "name", "properties": {"name": crs}}}
    return {"type": "FeatureCollection", **named, "features": [*features]}


def rings_of(areas):
    return [(area.name, [ring.tolist() for ring in area.rings]) for area in areas]


def test_forms_of_areas(tmp_path):
    class Shape:
        @property
        def __geo_interface__(self):
            return {"type": "Polygon", "coordinates": [SQUARE]}

    given = collection(feature("a", SQUARE), crs=None)
    (tmp_path / "a.geojson").write_text(json.dumps(given))
    ring = [[float(x), float(y)] for x, y in SQUARE]
    for form, name in (
        (tmp_path / "a.geojson", "a"), (given, "a"), (given["features"][0], "a"), ({"a": SQUARE}, "a"),
        (Shape(), "area 1"), ([Shape()], "area 1"), ([np.array(SQUARE)], "area 1"),
    ):  # fmt: skip
        assert rings_of(read_areas(form, None)) == [(name, [ring])], form
    both = {"type": "MultiPolygon", "coordinates": [[SQUARE], [SQUARE, SQUARE]]}
    assert rings_of(read_areas(both, None)) == [("area 1", [ring] * 3)]


def test_areas_in_other_systems():
    world = pyproj.Transformer.from_crs("EPSG:28992", "EPSG:4326", always_xy=True)
    (local,) = placed(SQUARE)
    degrees = [world.transform(*corner) for corner in local]
    for given in (collection(feature("a", degrees), crs=None), collection(feature("a", local))):
        (area,) = read_areas(given, "EPSG:7415")
        np.testing.assert_allclose(area.rings[0], local, atol=1e-3)
    (area,) = read_areas(collection(feature("a", local), crs=None), "EPSG:7415")  # numbers that are no degrees
    np.testing.assert_array_equal(area.rings[0], local)
    with pytest.raises(at.InputError, match="in degrees, and the scene's CRS is unknown; give it, such as --crs"):
        list(read_areas(collection(feature("a", degrees), crs="urn:ogc:def:crs:OGC:1.3:CRS84"), None))


@pytest.mark.parametrize(
    "areas, words",
    [
        ([], "areas are empty"),
        (3, "areas are a int"),
        ("none.geojson", "no such file"),
        ([[(0, 0), (1, 1)]], "at least three corners"),
        ([[(0, 0), (1, 1), (2, np.nan)]], "finite"),
        ({"type": "Point", "coordinates": [0, 0]}, "area 1 is a Point; areas are Polygons"),
        ({"type": "Polygon", "coordinates": 3}, "not a list of rings"),
        ({"type": "Feature", "geometry": None}, "area 1 is a None"),
        (collection(), "areas are empty"),
        ({"type": "FeatureCollection", "features": 3}, "features are not a list"),
        (placed([(0, 10), (0.1, 10), (0, 10.1)]), "area 1: contains no centre of a cell of 0.5"),
        (placed([(20, 20), (40, 20), (40, 25)]), "cells have no surface below; give the height of the ground"),
    ],
)
def test_bad_areas(tmp_path, areas, words):
    with pytest.raises(at.InputError, match=words):
        at.area_sensors(town(tmp_path), areas)


def test_cells_lie_on_the_ground_and_outside_the_house(tmp_path):
    scene = town(tmp_path)
    garden = [(-4, -4), (12, -4), (12, 12), (-4, 12)]
    sensors = at.area_sensors(scene, placed(garden, [(8, 8), (12, 8), (12, 12)]), 1.0)
    assert [(z.name, z.cells, z.left_out) for z in sensors.zones] == [("area 1", 256, 64), ("area 2", 10, 0)]
    x, y, z = (sensors.points - CORNER).T
    assert (z == 0.0).all() and not ((x > 0) & (x < 8) & (y > 0) & (y < 8)).any()
    assert np.bincount(sensors.zone).tolist() == [192, 10] and sensors.areas.sum() == 202
    low = at.area_sensors(scene, placed(garden), 1.0, 1.5)
    assert (low.points[:, 2] == 1.5).all() and len(low) == 192
    roof = at.area_sensors(scene, placed(garden), 1.0, 8.1, follow=False)  # a terrace: nothing is inside
    assert (roof.points[:, 2] == 8.1).all() and len(roof) == 256
    hole = at.area_sensors(
        scene, {"type": "Polygon", "coordinates": placed(garden, [(0, 0), (8, 0), (8, 8), (0, 8)])}, 1.0
    )
    np.testing.assert_array_equal(hole.points, sensors.points[sensors.zone == 0])
    assert hole.zones[0][1:] == (192, 0)


def test_pavements_are_ground_and_houses_are_not():
    """A pavement of 0.2, a house that stands on it, and a table of 0.8; nothing below the pavement."""
    boxes = [
        ([0, 0, 0], [20, 20, 0.2]),
        ([4, 4, 0.2], [4, 4, 6]),
        ([12, 12, 0.2], [2, 2, 0.7]),
        ([16, 0, 9], [4, 20, 1]),
    ]
    corners = np.concatenate([(CUBE * size + np.array(place))[FACES] for place, size in boxes])
    scene = at.Scene.from_arrays(corners, up="z")
    sensors = at.area_sensors(scene, {"a": [(0, 0), (20, 0), (20, 20), (0, 20)]}, 1.0)
    assert sensors.zones == (("a", 400, 16),)
    x, y, z = sensors.points.T
    assert not ((x > 4) & (x < 8) & (y > 4) & (y < 8)).any()
    table = (x > 12) & (x < 14) & (y > 12) & (y < 14)
    np.testing.assert_allclose(z, np.where(table, 0.9, 0.2), atol=1e-6)
    assert (x > 16).sum() == 80  # below a bridge


def test_neighbours_share_no_cell(tmp_path):
    rng = np.random.default_rng(1)
    corners = rng.integers(0, 17, (2, 2)) / 2.0 + [[9, 9], [9, 9]]  # on cells' middles
    whole = [(9, 9), (25, 9), (25, 25), (9, 25)]
    a, b = [(9, 9), *corners.tolist(), (25, 25), (9, 25)], [(9, 9), (25, 9), (25, 25), *corners[::-1].tolist()]
    scene = town(tmp_path)
    count = lambda ring: at.area_sensors(scene, placed(ring), 1.0).zones[0].cells
    if len({(9, 9), *map(tuple, corners.tolist())}) == 3:
        assert count(a) + count(b) == count(whole) == 256


def test_the_report_judges_each_area(tmp_path):
    scene = town(tmp_path)
    strip = [(-4, 8), (12, 8), (12, 14), (-4, 14)]  # north of the house: a part lies in its shade
    at_cells = at.area_sensors(scene, placed(strip), 0.5)
    points = at.point_sensors(at_cells.points, at_cells.normals)
    alone = at.sun_hours(scene, points, "2025-03-21", step=5, place=HERE)
    lit = alone["sun_hours"] > 2.0 - 1e-9
    assert 10 < (~lit).sum() < len(lit) - 10
    areas = dict(zip(("strip", "sunny"), placed(strip, [(-20, -20), (0, -20), (0, 0)])))
    table = at.sun_hours(scene, rule="br209-amenity", areas=areas, place=HERE)
    own = table.sensors.zone == 0
    np.testing.assert_array_equal(table["sun_hours"][own], alone["sun_hours"])
    np.testing.assert_array_equal(table["br209_amenity_passes"][own], lit)
    first, second = table.about["areas"]
    assert first["share"] == lit.mean() and first["passes"] == (lit.mean() >= 0.5)
    assert (first["name"], first["cells"], first["left_out"]) == ("strip", 384, 0)
    assert second["share"] == 1.0 and second["passes"] and second["name"] == "sunny"
    assert table.about["step"] == 5 and table.about["crs"] == "EPSG:7415"


def test_the_up_axis_changes_nothing(tmp_path):
    scene, areas = town(tmp_path), placed([(-4, -4), (12, -4), (12, 12), (-4, 12)])
    world = scene.triangles().vertices.astype(np.float64) + scene.origin
    turned = at.Scene.from_arrays(world[..., [0, 2, 1]] * [1, 1, -1], up="y", crs=scene.crs)
    one, other = (at.sun_hours(s, "raster:1", rule="br209-amenity", areas=areas, place=HERE) for s in (scene, turned))
    assert one.about["areas"] == other.about["areas"] and one.about["areas"][0]["left_out"] == 64
    np.testing.assert_array_equal(one["sun_hours"], other["sun_hours"])
    np.testing.assert_array_equal(one.sensors.cells, other.sensors.cells)


@pytest.mark.parametrize("turns", [0, 1, 3])
@pytest.mark.parametrize("unit, feet", [("m", 1.0), ("ft", 1 / 0.3048)])
def test_gardens_on_stores_in_feet_and_turned_by_quarters(tmp_path, unit, feet, turns):
    """A garden of 16 x 16 m around a house of 8 x 8 m: 256 cells of 1 m, without the 64 of the house."""
    turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), turns)  # counter-clockwise, from above
    faces = town(tmp_path, None).triangles().vertices.astype(np.float64) - [4, 4, 0]  # about the house's middle
    faces += town(tmp_path, None).origin - CORNER
    faces[..., :2] = faces[..., :2] @ turn.T
    scene = at.Scene.from_arrays(faces * feet, up="z", unit=unit)
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    corners = np.array([(-8, -8), (8, -8), (8, 8), (-8, 8)]) @ turn.T * feet
    place = at.Place(52.0, 4.37, timezone="Europe/Amsterdam", north=-90.0 * turns)
    options = {"rule": "br209-amenity", "areas": [corners.tolist()], "place": place}
    one, other = (at.sun_hours(each, f"raster:{feet}", **options) for each in (scene, at.load(tmp_path / "a.antumbra")))
    assert one.about["areas"] == other.about["areas"]
    np.testing.assert_array_equal(one["sun_hours"], other["sun_hours"])
    np.testing.assert_array_equal(one.sensors.cells, other.sensors.cells)
    (area,) = other.about["areas"]
    assert (area["cells"], area["left_out"]) == (192, 64)
    areas = placed([(-4, -4), (12, -4), (12, 12), (-4, 12)])
    whole = at.sun_hours(town(tmp_path), "raster:1", rule="br209-amenity", areas=areas, place=HERE).about["areas"][0]
    assert area["share"] == pytest.approx(whole["share"], abs=2 / 192)  # the sun is turned, too
    assert 0.0 < area["share"] < 1.0


def test_half_of_an_area_is_enough(tmp_path):
    scene = town(tmp_path)
    cells = at.area_sensors(scene, placed([(-4, 8), (12, 8), (12, 14), (-4, 14)]), 0.5)
    table = at.sun_hours(scene, cells, place=HERE, rule="br209-amenity")
    dark, lit = (np.flatnonzero(table["br209_amenity_passes"] == value) for value in (False, True))

    def judged(dark, lit):
        """The report on an area of some cells."""
        around = np.array([(-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2)])
        squares = [[(around + cells.points[k, :2]).tolist()] for k in (*dark, *lit)]
        shape = {"type": "MultiPolygon", "coordinates": squares}
        return at.sun_hours(scene, areas=shape, place=HERE, rule="br209-amenity").about["areas"][0]

    assert judged(dark[:8], lit[:8])["passes"] and not judged(dark[:9], lit[:8])["passes"]


def test_files_have_the_judged_cells_alone(cli, tmp_path):
    town(tmp_path)
    garden = feature("garden", *placed([(-4, -4), (12, -4), (12, 12), (-4, 12)]))
    (tmp_path / "gardens.geojson").write_text(json.dumps(collection(garden)))
    asked = "sun", "a.city.json", "--rule", "br209-amenity", "--areas", "gardens.geojson", "--sensors", "raster:1"
    told = cli(*asked, "-o", "a.tif", "-o", "a.png", "-o", "a.csv", "--column", "br209_amenity_passes", "--json").json()
    (area,) = told["areas"]
    assert (area["name"], area["cells"], area["left_out"]) == ("garden", 192, 64)
    with rasterio.open(tmp_path / "a.tif") as file:
        hours, passes = (
            file.read(file.descriptions.index(f"br209_amenity_{name}") + 1) for name in ("hours", "passes")
        )
        assert file.descriptions[0] == "br209_amenity_passes"  # what viewers show
    assert hours.shape == (16, 16) and np.isnan(hours[4:12, 4:12]).all() and np.isfinite(hours).sum() == 192
    assert area["share"] == np.nanmean(passes) and area["sun_hours"] == pytest.approx(np.nanmean(hours))
    shown = cli(*asked, "-o", "a.csv").out
    assert "garden" in shown and f"{100 * area['share']:.1f} %" in shown and "inside buildings" in shown


@pytest.mark.parametrize(
    "given, words",
    [
        (("--areas", "gardens.geojson", "--days", "2026-06-21"), ["about 21 March; leave the days out"]),
        (("--areas", "gardens.geojson", "--days", "2026-03-21,2027-03-21"), ["about 21 March"]),
        ((), ["judges gardens", "--areas gardens.geojson"]),
        (("--sensors", "raster:1"), ["--areas gardens.geojson"]),
        (("--areas", "gardens.geojson", "--sensors", "face"), ["in areas it must be raster[:SPACING]"]),
        (("--areas", "gardens.csv"), ["--areas is 'gardens.csv'; it must be a .geojson"]),
        (("--areas", "none.geojson"), ["none.geojson: no such file"]),
        (("--areas", "bad.geojson"), ["bad.geojson: is not GeoJSON"]),
    ],
)
def test_bad_commands(cli, tmp_path, given, words):
    town(tmp_path)
    (tmp_path / "gardens.geojson").write_text(json.dumps(collection(feature("a", *placed(SQUARE)))))
    (tmp_path / "bad.geojson").write_text("{")
    cli("sun", "a.city.json", "--rule", "br209-amenity", *given).refused(*words)
