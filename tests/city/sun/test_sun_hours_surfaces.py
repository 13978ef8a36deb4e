"""Surfaces in tables of sun hours: names, azimuths, choices, and rows per surface and building."""

import csv
import json

import numpy as np
import pytest

import antumbra as at
import city_files

PLACE = at.Place(52.0, 4.4, north=10.0, timezone="+01:00")
STUDY = {"days": "2026-03-21", "step": 60, "place": PLACE}


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    return at.load(city_files.put(tmp_path_factory.mktemp("city"), city_files.everything()))


@pytest.fixture(scope="module")
def table(city):
    return at.sun_hours(city, "grid:0.25", **STUDY, energy=True)


def test_each_sensor_has_its_surface(city, table):
    faces = table.sensors.faces
    named, normals = city.city.surface_types(faces), table.sensors.normals
    built = np.array([each.startswith("Building") for each in city.city.types])[city.city.object_of_face[faces]]
    by_normal = np.where(
        np.abs(normals[:, 2]) < 0.5, "WallSurface", np.where(normals[:, 2] > 0, "RoofSurface", "GroundSurface")
    )
    assert table["type"].tolist() == np.where((named == "") & built, by_normal, named).tolist()
    assert ((named == "") & built).any() and ((named == "") & ~built).any() and (named != "").any()
    assert (table["surface"] == city.city.surface_of_face[faces]).all()
    names = [city.city.objects[k] for k in city.city.object_of_face[faces]]
    assert table["building"].tolist() == ["house" if name == "part" else name for name in names]
    assert {"", "GroundSurface", "RoofSurface", "WallSurface"} == set(table["type"]) and "part" in names
    x, y, z = table.sensors.normals.T
    walls = np.abs(z) < 0.5
    expected = (np.degrees(np.arctan2(x, y)) - 10.0) % 360.0
    np.testing.assert_allclose(table["azimuth"], np.where(walls, expected, np.nan))
    assert set(np.round(table["tilt"])) == {0.0, 90.0, 180.0} and 0 < walls.mean() < 1


@pytest.mark.parametrize("suffix", ["csv", "json", "npz", "parquet"])
def test_names_are_written(table, suffix, tmp_path):
    path = tmp_path / f"a.{suffix}"
    table.save(path)
    if suffix == "csv":
        with open(path, newline="") as file:
            names = [row["type"] for row in csv.DictReader(file)]
    elif suffix == "json":
        names = json.loads(path.read_text())["rows"]["type"]
    elif suffix == "npz":
        names = np.load(path)["type"].tolist()
    else:
        import pyarrow.parquet

        names = pyarrow.parquet.read_table(path)["type"].to_pylist()
    assert names == table["type"].tolist()


def test_a_picture_cannot_show_names(table):
    with pytest.raises(at.InputError, match="column 'type' holds names"):
        table.shown("type")


def test_cells_of_a_raster_on_surfaces_of_a_type(tmp_path):
    roofed = city_files.solid(semantics={"surfaces": [{"type": "RoofSurface"}], "values": [[None, 0, *[None] * 4]]})
    shed = city_files.CUBE + (3, 0, 0)
    plain = city_files.building(
        {**city_files.solid(), "boundaries": [[[[8 + i for i in f]] for f in city_files.CUBE_FACES]]}, kind="WaterBody"
    )
    document = city_files.city({"a": city_files.building(roofed), "b": plain}, np.concatenate([city_files.CUBE, shed]))
    scene = at.load(city_files.put(tmp_path, document))
    every = at.sun_hours(scene, "raster:0.25", **STUDY)
    some = at.sun_hours(scene, "raster:0.25", **STUDY, surfaces="RoofSurface")
    assert len(every) == 64 and len(some) == 16 and set(some["building"]) == {"a"}
    grid = some.sensors.on_raster(some["sun_hours"])
    assert grid.shape == (4, 16) and np.isfinite(grid).sum() == 16 and np.isfinite(grid[:, :4]).all()


@pytest.mark.parametrize("sensors", ["face", "grid:0.25"])
def test_surfaces_of_a_type_alone(city, sensors):
    every = at.sun_hours(city, sensors, **STUDY)
    some = at.sun_hours(city, sensors, **STUDY, surfaces="WallSurface, RoofSurface")
    chosen = np.isin(every["type"], ["WallSurface", "RoofSurface"])
    assert 0 < chosen.mean() < 1 and some["sun_hours"].tolist() == every["sun_hours"][chosen].tolist()
    assert (some.sensors.points == every.sensors.points[chosen]).all() and some.sensors.kind == every.sensors.kind
    assert some.about["surfaces"] == ["WallSurface", "RoofSurface"]


@pytest.mark.parametrize("facing", ["150:210", (150, 210), "165:175"])
def test_surfaces_that_face_south(table, city, facing):
    south = at.sun_hours(city, "grid:0.25", **STUDY, facing=facing)
    assert len(south) == (table["azimuth"] == 170.0).sum() > 0 and set(south["azimuth"]) == {170.0}


def test_a_range_wraps_at_north(city):
    north = at.sun_hours(city, "vertex", **STUDY, facing="300:60")
    assert ((north["azimuth"] >= 300) | (north["azimuth"] <= 60)).all() and len(north) > 0
    faces = north.sensors.corners
    assert (faces >= 0).any() and (faces < 0).any() and ((faces < 0).any(1) == (faces < 0).all(1)).all()


def test_rows_per_building_are_means_over_the_area(city, table):
    rows = at.sun_hours(city, "grid:0.25", **STUDY, energy=True, per="building")
    assert rows["building"].tolist() == ["house"] and "azimuth" not in rows.columns  # neither tree nor pond
    for k, name in enumerate(rows["building"]):
        on = table["building"] == name
        areas = table.sensors.areas[on]
        assert rows["sensors"][k] == on.sum() and np.isclose(rows.sensors.areas[k], areas.sum())
        assert np.isclose(rows["sun_hours"][k], (table["sun_hours"][on] * areas).sum() / areas.sum())
        assert np.isclose(rows["direct_kwh"][k], (table["direct_kwh_m2"][on] * areas).sum())
        known = table["first"][on][~np.isnat(table["first"][on])]
        assert (known.min() == rows["first"][k]) if len(known) else np.isnat(rows["first"][k])
        known = table["last"][on][~np.isnat(table["last"][on])]
        assert (known.max() == rows["last"][k]) if len(known) else np.isnat(rows["last"][k])
    assert not np.isnat(rows["first"]).any()


def test_rows_per_surface(city, table):
    rows = at.sun_hours(city, "face", **STUDY, per="surface")
    assert rows["surface"].tolist() == np.unique(city.city.surface_of_face).tolist()
    named = [city.city.surfaces[k].type for k in rows["surface"]]
    assert [kind for kind, name in zip(rows["type"], named) if name] == [name for name in named if name]
    assert "WallSurface" in [kind for kind, name in zip(rows["type"], named) if not name]
    assert {170.0, 80.0} <= set(rows["azimuth"]) and np.isnan(rows["azimuth"]).any()
    assert rows.about["per"] == "surface"


def test_rows_of_other_scenes_are_planar_parts():
    faces = np.array([t for a, b, c, d in city_files.CUBE_FACES for t in ((a, b, c), (a, c, d))])
    scene = at.Scene.from_arrays(city_files.CUBE * 3.0, faces, up="z", name="box")
    rows = at.sun_hours(scene, "grid:0.5", **STUDY, per="surface")
    assert len(rows) == 6 and rows["building"].tolist() == ["box"] * 6 and rows["surface"].tolist() == list(range(6))
    np.testing.assert_allclose(rows.sensors.areas, 9.0)
    assert sorted(rows["tilt"]) == [0.0, 90.0, 90.0, 90.0, 90.0, 180.0]
    roof = rows["type"].tolist().index("RoofSurface")
    assert rows["tilt"][roof] == 0.0 and np.isclose(rows["sun_hours"][roof], rows.about["hours"])
    assert [rows["type"].tolist().count(f"{kind}Surface") for kind in ("Roof", "Wall", "Ground")] == [1, 4, 1]


def test_pictures_and_models_show_the_rows_on_their_faces(city, tmp_path):
    rows = at.sun_hours(city, "grid:0.25", **STUDY, per="building")
    of_face, there = rows.of_faces("sun_hours"), rows.row_of_face >= 0
    assert (of_face[there] == rows["sun_hours"][0]).all() and there.any() and np.isnan(of_face[~there]).all()
    rows.save(tmp_path / "a.glb")
    rows.save(tmp_path / "a.png")
    assert (tmp_path / "a.png").stat().st_size > 1000
    colours = at.load(tmp_path / "a.glb").colours
    assert len(colours) == city.n_triangles
    assert len(np.unique(colours.round(3), axis=0)) == 2  # the house, and the grey of faces without a row


@pytest.mark.parametrize(
    "keywords, message",
    [
        ({"surfaces": "WallSurfaces"}, "no surfaces of type 'WallSurfaces'; did you mean 'WallSurface'"),
        ({"surfaces": ""}, "write types such as WallSurface,RoofSurface"),
        ({"facing": "south"}, "write FROM:TO in degrees, such as 150:210"),
        ({"facing": "a:b"}, "write two numbers from -360 to 360"),
        ({"facing": (0, 500)}, "write two numbers from -360 to 360"),
        ({"facing": "11:12"}, "no sensors facing 11:12"),
        ({"per": "surfaces"}, "per is 'surfaces', and sensors have no such column; did you mean 'surface'. use sensor"),
        ({"per": "facade", "tilt": "0:10"}, "per is 'facade', and no sensor lies on a wall"),
        ({"per": "building", "sensors": "vertex"}, "need sensors on faces, unlike 'vertex'"),
        ({"facing": "0:90", "sensors": "raster:0.5"}, "facing needs sensors with normals, unlike 'raster'"),
        ({"surfaces": "RoofSurface", "sensors": "vertex"}, "surfaces need sensors on faces, unlike 'vertex'"),
    ],
)
def test_errors(city, keywords, message):
    with pytest.raises(at.InputError, match=message):
        at.sun_hours(city, **STUDY, **keywords)


def test_types_follow_from_normals_without_semantics():
    scene = at.procedural("city", 2000)
    roofs = at.sun_hours(scene, "face", **STUDY, surfaces="RoofSurface")
    every = at.sun_hours(scene, "face", **STUDY)
    assert (roofs["tilt"] < 60.0).all() and len(roofs) == (every["tilt"] < 60.0).sum() > 0
    flat = at.sun_hours(scene, "raster:40", **STUDY, surfaces="RoofSurface")
    assert len(flat) > 0 and (flat.sensors.faces >= 0).all()
    with pytest.raises(at.InputError, match="no surfaces of type 'RoofSurfaces'; did you mean 'RoofSurface'"):
        at.sun_hours(scene, "face", **STUDY, surfaces="RoofSurfaces")


# --- One row per value of the user's column ---------------------------------------------------------------------------

WINDOWS = """id,dwelling,floor,x,y,z,nx,ny,nz
w1,ground,0,0.25,0,0.5,0,-1,0
w2,top,1,0.75,0,0.75,0,-1,0
w3,ground,0,0.5,1,0.5,0,1,0
w4,"attic, left",1,1,0.5,0.5,1,0,0
"""


@pytest.fixture
def windows(tmp_path):
    path = tmp_path / "windows.csv"
    path.write_text(WINDOWS)
    return at.sensors_of(str(path), cube())


def cube():
    faces = [face for a, b, c, d in city_files.CUBE_FACES for face in ((a, b, c), (a, c, d))]
    return at.Scene.from_arrays(city_files.CUBE.astype(float), faces, up="z")


def test_windows_of_a_dwelling_make_one_row_with_their_mean(windows):
    table = at.sun_hours(cube(), windows, **STUDY, energy=True, by=["hour"])
    rows = at.sun_hours(cube(), windows, **STUDY, energy=True, by=["hour"], per="dwelling")
    given = rows.sensors.attributes
    assert given["dwelling"].tolist() == ["ground", "top", "attic, left"] and given["floor"].tolist() == [0, 1, 1]
    assert "id" not in given and rows["sensors"].tolist() == [2, 1, 1]
    for name in ("sun_hours", "direct_kwh_m2", "hours_12"):
        one, two, three, four = table[name].tolist()
        assert rows[name].tolist() == [(one + three) / 2.0, two, four]
    assert rows["first"][0] == np.nanmin(table["first"][[0, 2]]) and "direct_kwh" not in rows.columns
    assert len(set(rows["sun_hours"].tolist())) == 3 and rows.about["per"] == "dwelling"


def test_the_best_window_of_a_dwelling_decides_and_the_share_that_passes_is_told(windows):
    keywords = {"rule": "en17037-minimum", "place": STUDY["place"]}
    table, rows = (at.sun_hours(cube(), windows, **keywords, per=per) for per in ("sensor", "dwelling"))
    assert rows["en17037_minimum_share"][0] == table["en17037_minimum_passes"][[0, 2]].mean() == 0.5
    assert rows["en17037_minimum_passes"][0]


def test_rows_per_column_are_in_every_output(windows, tmp_path):
    rows = at.sun_hours(cube(), windows, **STUDY, per="dwelling")
    for suffix in (".csv", ".json", ".npz", ".parquet", ".gpkg", ".png"):
        rows.save(tmp_path / f"rows{suffix}")
    with open(tmp_path / "rows.csv", newline="") as file:
        assert [row["dwelling"] for row in csv.DictReader(file)] == ["ground", "top", "attic, left"]
    assert np.load(tmp_path / "rows.npz")["dwelling"].tolist() == ["ground", "top", "attic, left"]
    gpd = pytest.importorskip("geopandas")
    assert gpd.read_file(tmp_path / "rows.gpkg")["dwelling"].tolist() == ["ground", "top", "attic, left"]


def test_an_unknown_column_is_refused_with_those_there_are(windows):
    with pytest.raises(at.InputError, match=r"per is 'dweling', .* did you mean 'dwelling'"):
        at.sun_hours(cube(), windows, **STUDY, per="dweling")
    with pytest.raises(at.InputError, match="rows per building need sensors on faces, unlike 'points'"):
        at.sun_hours(cube(), windows, **STUDY, per="building")
