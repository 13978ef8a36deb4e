"""A CRS goes from a scene to every file made of it, and rasters have the cells that were asked for."""

import json
import re
import struct
from typing import get_type_hints

import numpy as np
import pyarrow.parquet
import pyproj
import pytest
import rasterio
from rasterio.transform import from_origin

import antumbra as at
from antumbra.city.sight.sightlines import PairList, sight_model, sight_table
from antumbra.cli.app import program
from antumbra.scene.crs import reproject
from city_files import CUBE, building, city, put, solid
from study_cases import study_cases

CRS = "EPSG:7415"
CORNER = np.array([85000.0, 447000.0, 0.0])


def of_city_file(folder):
    return at.load(put(folder, city({"a": building(solid())}, CUBE * 4 + CORNER)))


def of_option(folder):
    return at.load(put(folder, city({"a": building(solid())}, CUBE * 4 + CORNER, crs=None)), crs=CRS)


def of_arrays(folder):
    """+Y up: the same place with axes east, up, south."""
    corners = at.load(put(folder, city({"a": building(solid())}, CUBE * 4 + CORNER, crs=None))).triangles()
    world = corners.vertices.astype(np.float64) + corners.origin
    return at.Scene.from_arrays(world[..., [0, 2, 1]] * [1, 1, -1], crs=pyproj.CRS(CRS))


def of_mesh(folder):
    import trimesh

    return at.Scene.from_mesh(trimesh.creation.box((4, 4, 4)).apply_translation(CORNER + 2), up="z", crs=CRS)


def of_store(folder):
    at.build_store(of_city_file(folder), folder / "a.antumbra")
    return at.load(folder / "a.antumbra")


def above(scene, east, north, height):
    """World coordinates of a point over the south-west corner."""
    x, y, z = CORNER + [east, north, height]
    return [x, y, z] if scene.up == "z" else [x, z, -y]


def sun(scene, sensors):
    place = at.Place(52.0, 4.4, timezone="+01:00")  # a place of its own: the CRS must not depend on it
    return at.sun_hours(scene, sensors, "2026-03-21", step=240, place=place)


def sun_of_crs(scene, sensors):
    return at.sun_hours(scene, sensors, "2026-03-21", step=240)


def viewshed(scene, sensors):
    return at.viewshed(scene, sensors, above(scene, 1, 1, 9)).table


def matrix(scene, sensors):
    counts = at.visibility_matrix(scene, sensors, [above(scene, 1, 1, 9)]).counts
    return at.Table(sensors, {"seen": at.Column(counts, "", "targets")}, {"job": "matrix"}, scene)


def lines(scene, sensors):
    pairs = PairList(sensors.points, np.roll(sensors.points, 1, 0), None, None, None, None)
    return sight_table(scene, pairs, at.line_of_sight(scene, pairs.observers, pairs.targets))


def sky(scene, sensors):
    return at.sky_view(scene, sensors, directions=16)


JOBS = [sun, sun_of_crs, sky, viewshed, matrix, lines]


def crs_of(path):
    """The CRS that a file says, as GIS programs read it."""
    suffix = path.suffix
    if suffix == ".tif":
        with rasterio.open(path) as file:
            return file.crs.to_string()
    if suffix == ".parquet":
        told = json.loads(pyarrow.parquet.read_schema(path).metadata[b"geo"])
        found = pyproj.CRS.from_json_dict(told["columns"]["geometry"]["crs"])
        return ":".join(found.to_authority())
    if suffix == ".npz":
        with np.load(path) as arrays:
            return json.loads(str(arrays["about"]))["about"]["crs"]
    if suffix == ".glb":
        data = path.read_bytes()
        return json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]])["asset"]["extras"]["crs"]
    return json.loads(path.read_text())["about"]["crs"]


@pytest.mark.parametrize(
    "source, job",
    [
        (source, job)
        for source in (of_city_file, of_option, of_arrays, of_mesh, of_store)
        for job in JOBS
        if (source, job) != (of_store, lines)  # which need a scene in memory
    ],
)
def test_every_file_of_every_job_carries_the_crs(tmp_path, source, job):
    scene = source(tmp_path)
    assert scene.crs == CRS
    sensors = at.raster_sensors(scene, 2.0, 1.5)
    table = job(scene, sensors)
    assert len(table) == 4 and table.about["crs"] == CRS
    suffixes = [".json", ".npz", ".parquet", *([".tif"] if job is not lines else [])]
    suffixes += [".glb"] if source is not of_store else []
    for suffix in suffixes:
        table.save(tmp_path / f"b{suffix}")
        assert crs_of(tmp_path / f"b{suffix}") == CRS, suffix


def test_models_of_lines_carry_it(tmp_path):
    scene = of_city_file(tmp_path)
    at_ends = np.array([above(scene, -1, 1, 1)]), np.array([above(scene, 9, 1, 1)])
    pairs = PairList(*at_ends, None, None, None, None)
    (tmp_path / "a.glb").write_bytes(sight_model(scene, pairs, at.line_of_sight(scene, *at_ends)))
    assert crs_of(tmp_path / "a.glb") == CRS


def test_commands_take_it(cli, tmp_path):
    put(tmp_path, city({"a": building(solid())}, CUBE * 4 + CORNER, crs=None))
    common = "a.city.json", "--crs", CRS, "--quiet"
    assert (
        cli("sun", *common, "--days", "2026-03-21", "--step", 240, "--sensors", "raster:2", "-o", "sun.tif").code == 0
    )
    assert cli("viewshed", *common, "--observer", "85001,447001,9", "--sensors", "raster:2", "-o", "seen.tif").code == 0
    assert cli("matrix", *common, "--sensors", "raster:2", "--counts", "counts.tif").code == 0
    assert cli("los", *common, "--from", "85001,447001,9", "--to", "85001,447001,-9", "-o", "lines.parquet").code == 0
    for name in "sun.tif", "seen.tif", "counts.tif", "lines.parquet":
        assert crs_of(tmp_path / name) == CRS, name
    assert cli("info", "a.city.json", "--json").json()["crs"] is None
    cli("viewshed", "a.city.json", "--crs", "EPSG:1", "--observer", "0,0,0").refused("crs 'EPSG:1' is unknown")
    cli("los", "procedural:atrium", "--crs", CRS, "--from", "0,0,0", "--to", "1,0,0").refused("--crs are for files")


@pytest.mark.parametrize("up", ["y", "z"])
def test_geometry_is_easting_northing_and_height(tmp_path, up):
    scene = of_arrays(tmp_path) if up == "y" else of_city_file(tmp_path)
    sensors = at.point_sensors([above(scene, 1, 2, 9)])
    viewshed(scene, sensors).save(tmp_path / "a.parquet")
    found = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    order, kind, *at_place = struct.unpack("<BI3d", found["geometry"][0].as_py())
    assert (order, kind) == (1, 1001) and at_place == (CORNER + [1, 2, 9]).tolist()
    assert [found[name][0].as_py() for name in "xyz"] == above(scene, 1, 2, 9)


def test_stores_of_two_systems_are_refused(tmp_path):
    one, other = of_city_file(tmp_path), of_city_file(tmp_path)
    other.crs = "EPSG:25832"
    with pytest.raises(at.InputError, match="have the CRS EPSG:25832, EPSG:7415; reproject"):
        at.build_store([one, other], tmp_path / "b.antumbra")
    other.crs = None
    at.build_store([other, one], tmp_path / "b.antumbra")
    assert at.load(tmp_path / "b.antumbra").crs == CRS
    assert at.load(tmp_path / "b.antumbra", crs="EPSG:28992").crs == "EPSG:28992"


@pytest.mark.parametrize("crs", ["EPSG:1", "", 3.5, [], object(), {"a": 1}])
def test_an_unknown_crs_is_refused(tmp_path, crs):
    for make in (
        lambda: at.load(put(tmp_path, city()), crs=crs),
        lambda: at.Scene.from_arrays(np.eye(3)[None], crs=crs),
    ):
        with pytest.raises(at.InputError, match="is unknown; write an EPSG code"):
            make()


def heights(folder, west=84000.0, north=447020.0, spacing=0.5, shape=(20, 30), crs="EPSG:28992", **more):
    """A GeoTIFF of heights, and the surface through the middles of its cells."""
    values = np.random.default_rng(7).random(shape).astype(np.float32)
    place = more.pop("transform", from_origin(west, north, spacing, spacing))
    profile = {"width": shape[1], "height": shape[0], "count": 1, "dtype": "float32", "crs": crs, "transform": place}
    with rasterio.open(folder / "dem.tif", "w", driver="GTiff", **profile) as file:
        file.write(values, 1)
    x, y = west + (np.arange(shape[1]) + 0.5) * spacing, north - (np.arange(shape[0]) + 0.5) * spacing
    vertices = np.stack([*np.meshgrid(x, y), values.astype(np.float64)], -1).reshape(-1, 3)
    i = np.arange(len(vertices)).reshape(shape)
    a, b, c, d = i[:-1, :-1].ravel(), i[:-1, 1:].ravel(), i[1:, 1:].ravel(), i[1:, :-1].ravel()
    faces = np.concatenate([np.stack([a, d, c], 1), np.stack([a, c, b], 1)])
    return values, at.Scene.from_arrays(vertices, faces, up="z")


def over_the_surface(scene, sensors):
    return at.viewshed(scene, sensors, [84005.0, 447015.0, 9.0]).table


@pytest.mark.parametrize("job", [sun, sky, over_the_surface, matrix])
@pytest.mark.parametrize("west, text", [(84000.0, "raster:0.5"), (84000.0, "file"), (84000.2, "file")])
def test_rasters_have_the_cells_of_the_heights_they_come_from(tmp_path, job, west, text):
    values, scene = heights(tmp_path, west)
    scene.crs = CRS
    text = f"raster:{tmp_path}/dem.tif" if text == "file" else text
    sensors = at.sensors_of(text, scene)
    job(scene, sensors).save(tmp_path / "made.tif")
    with rasterio.open(tmp_path / "dem.tif") as dem, rasterio.open(tmp_path / "made.tif") as made:
        assert made.transform.almost_equals(dem.transform, 1e-9) and made.shape == dem.shape
        assert np.isfinite(made.read(1)).all() and made.crs.to_string() == CRS
    np.testing.assert_allclose(sensors.points[:, 2], values.ravel(), atol=1e-6)
    assert (sensors.faces >= 0).all()


def test_cells_of_a_file_bring_their_crs(tmp_path):
    values, scene = heights(tmp_path)
    sensors = at.raster_sensors(scene, tmp_path / "dem.tif", 1.6)
    np.testing.assert_allclose(sensors.points[:, 2], values.ravel() + 1.6, atol=1e-6)
    over_the_surface(scene, sensors).save(tmp_path / "made.tif")
    assert crs_of(tmp_path / "made.tif") == "EPSG:28992"
    scene.crs = "EPSG:25832"
    with pytest.raises(at.InputError, match="its CRS is EPSG:28992, and the scene's is EPSG:25832"):
        at.raster_sensors(scene, tmp_path / "dem.tif")


def test_edges_of_cells_are_multiples_of_the_spacing():
    scene = at.Scene.from_arrays([[[-0.3, 1.2, 0], [2.9, 1.2, 0], [0, 4.00000001, 0]]], up="z")
    assert at.raster_sensors(scene, 0.5).raster == (-0.5, 4.0, 0.5, 7, 6, None)
    assert at.raster_sensors(scene, 10).raster == (-10.0, 10.0, 10.0, 2, 1, None)
    assert at.raster_sensors(scene, 0.5, bounds=(0.2, 1.1, 1.2, 2.2)).raster == (0.2, 2.2, 0.5, 2, 3, None)
    bounds = 0.1, 0.1, 0.1 + 0.1 + 0.1, 0.7  # 0.2 / 0.1 and 0.6 / 0.1 with rounding
    assert at.raster_sensors(scene, 0.1, bounds=bounds).raster[3:5] == (2, 6)


@pytest.mark.parametrize(
    "more, words",
    [
        ({"transform": rasterio.Affine(0.5, 0.1, 84000, 0.1, -0.5, 447020)}, "not square with north up"),
        ({"transform": rasterio.Affine(0.5, 0, 84000, 0, -0.6, 447020)}, "gdalwarp .* -tr SIZE"),
        ({"transform": rasterio.Affine(0.5, 0, 84000, 0, 0.5, 447020)}, "north up"),
    ],
)
def test_other_cells_are_refused(tmp_path, more, words):
    _, scene = heights(tmp_path, **more)
    with pytest.raises(at.InputError, match=words):
        at.raster_sensors(scene, tmp_path / "dem.tif")


def test_bad_raster_files(tmp_path):
    _, scene = heights(tmp_path)
    with pytest.raises(at.InputError, match=r"none\.tif: no such file"):
        at.sensors_of(f"raster:{tmp_path}/none.tif", scene)
    (tmp_path / "bad.tif").write_bytes(b"II*\0")
    with pytest.raises(at.InputError, match=r"bad\.tif: cannot be read"):
        at.raster_sensors(scene, tmp_path / "bad.tif")
    with pytest.raises(at.InputError, match="exclude each other"):
        at.raster_sensors(scene, tmp_path / "dem.tif", bounds=(0, 0, 1, 1))
    with pytest.raises(at.InputError, match="bounds of the raster must be"):
        at.raster_sensors(scene, 1.0, bounds=3)


# --- points from GeoParquet -------------------------------------------------------------------------------------------


def points_file(folder, crs, name="points.parquet", columns="x y z", moved="EPSG:28992"):
    """GeoParquet with two points near the south-west corner, or pairs of them; `crs`: as in its metadata, if any.

    moved : CRS to which the points are moved
    """
    plan = reproject(np.array([[85001.0, 447001.0], [85009.0, 447001.0]]), "EPSG:28992", moved)
    rows = dict(zip(columns.split(), np.tile(np.array([*plan.T, [9.0] * 2]), (2, 1))))
    column = {"encoding": "WKB", "geometry_types": ["Point Z"], **crs}
    geo = {"version": "1.1.0", "primary_column": "geometry", "columns": {"geometry": column}}
    table = pyarrow.table(rows).replace_schema_metadata({"geo": json.dumps(geo)})
    pyarrow.parquet.write_table(table, folder / name)
    return name


def own(name):
    return {"crs": pyproj.CRS(name).to_json_dict()}


READERS = {
    "sun --sensors": ("points.parquet", "--days", "2026-03-21", "--step", 240, "-o", "a.csv"),
    "matrix --sensors": ("points.parquet", "--counts", "a.csv"),
    "matrix --targets": ("points.parquet", "--counts", "a.csv"),
    "visible --sensors": (
        "points.parquet",
        "--turbine",
        "85001,447001,9",
        "--hub-height",
        5,
        "--rotor",
        2,
        "-o",
        "a.csv",
    ),
    "skyline --points": ("points.parquet", "-o", "a.csv"),
    "viewshed --sensors": ("points.parquet", "--observer", "85001,447001,9", "-o", "a.csv"),
    "viewshed --observers": ("points.parquet", "--sensors", "face", "-o", "a.csv"),
    "los --observers": ("points.parquet", "--to", "85001,447001,19", "-o", "a.csv"),
    "los --targets": ("points.parquet", "--from", "85001,447001,19", "-o", "a.csv"),
    "calendar --points": ("points.parquet", "--days", "2026-06-21", "--step", "60", "-o", "a.csv"),
    "pv --modules": ("points.parquet", "--days", "2026-06-21", "-o", "a.csv"),
    "visible --turbines": ("points.parquet", "--hub-height", "9", "--rotor", "5", "-o", "a.csv"),
    "los --pairs": ("pairs.parquet", "-o", "a.csv"),
}
READERS |= {
    f"{case.command} --{case.points}": ("points.parquet", *case.words_without(f"--{case.points}"))
    for case in study_cases()
    if case.command and case.points
}
"""Command and option that reads points -> the file, and the rest of a command line."""
FILE_OF_POINTS = re.compile(
    r"file of (points|observers|targets|modules|the feet of turbines)|forms as --sensors|\|FILE$"
)
"""What the help of such options says."""


@pytest.mark.parametrize("reader", READERS)
def test_points_of_another_crs_are_moved(cli, tmp_path, reader):
    """Points in the zone of UTM give what they give in the CRS of the scene. Files of pairs are refused."""
    put(tmp_path, city({"a": building(solid())}, CUBE * 4 + CORNER))
    command, option = reader.split()
    words = command, "a.city.json", option, *READERS[reader], "--json"
    answers = list[dict]()
    for name in "EPSG:28992", "EPSG:25831":
        points_file(tmp_path, own(name), moved=name)
        points_file(tmp_path, own(name), "pairs.parquet", "x1 y1 z1 x2 y2 z2")
        done = cli(*words)
        if name != "EPSG:28992" and option == "--pairs":
            done.refused(f"pairs.parquet: its CRS is {name}, and the scene's is {CRS}; reproject")
            return
        assert "2 of 2" not in done.err
        answers.append({k: v for k, v in done.json().items() if isinstance(v, int) and not isinstance(v, bool)})
    assert answers[0] == answers[1] and answers[0]


def test_all_options_that_read_points_are_tested():
    found = set()
    for command in program().registered_commands:
        for name, kind in get_type_hints(command.callback, include_extras=True).items():
            for info in getattr(kind, "__metadata__", ()):
                if FILE_OF_POINTS.search(f"{info.help} {info.metavar}"):
                    found.add(f"{command.name} --{name}")
    assert found == set(READERS)


@pytest.mark.parametrize(
    "crs, words",
    [
        ({}, "its CRS is OGC:CRS84"),  # what the format says if there is none
        ({"crs": None}, None),  # unknown
        ({"crs": {"type": "?"}}, r"crs {'type': '\?'} is unknown"),
        (own("EPSG:4326"), r"points\.parquet: its CRS is EPSG:4326, and places in EPSG:4326 have no coordinates"),
        (own(CRS), None),
    ],
)
def test_the_crs_that_geoparquet_names(tmp_path, crs, words):
    scene = of_city_file(tmp_path)
    text = str(tmp_path / points_file(tmp_path, crs))
    if words is None:
        assert len(at.sensors_of(text, scene)) == 2
    else:
        with pytest.raises(at.InputError, match=words):
            at.sensors_of(text, scene)
    scene.crs = None
    assert len(at.sensors_of(text, scene)) == 2


def test_bad_metadata_of_geoparquet(tmp_path):
    scene = of_city_file(tmp_path)
    for geo in (b"{", b"[]", b'{"primary_column": "a", "columns": {}}', b'{"primary_column": [], "columns": 3}'):
        table = pyarrow.table({"x": [85001.0], "y": [447001.0], "z": [1.0]}).replace_schema_metadata({"geo": geo})
        pyarrow.parquet.write_table(table, tmp_path / "a.parquet")
        with pytest.raises(at.InputError, match=r"a\.parquet: cannot be read .*write it again$"):
            at.sensors_of(str(tmp_path / "a.parquet"), scene)
