"""Points of vector files and of tables in degrees: their way into scenes, heights, attributes and faults."""

import json
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensor_files import read_point_file

geopandas = pytest.importorskip("geopandas")

CRS = "EPSG:28992"
PLACES = np.array([[85001.0, 447002.0], [85005.0, 447008.0]])


def floor(up, crs=CRS):
    corners = np.array([[85000, 447000, 0], [85010, 447000, 0], [85010, 447010, 0], [85000, 447010, 0]], float)
    corners = corners if up == "z" else np.stack([corners[:, 0], corners[:, 2], -corners[:, 1]], 1)
    return at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up=up, crs=crs)


@pytest.fixture
def points(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def write(name, crs=CRS, z=(3.0, 4.5), columns=None):
        shapes = geopandas.points_from_xy(*PLACES.T, z=z, crs=CRS).to_crs(crs)
        geopandas.GeoDataFrame({"id": ["a", "b"], **(columns or {})}, geometry=shapes).to_file(name)
        return Path(name)

    return write


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("name, crs", [("p.gpkg", CRS), ("p.geojson", "EPSG:4326"), ("p.fgb", "EPSG:32631")])
def test_points_come_to_their_places(points, up, name, crs):
    points(name, crs)
    sensors = at.sensors_of(name, floor(up))
    expected = np.column_stack([PLACES, [3.0, 4.5]])
    expected = expected if up == "z" else expected[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
    order = np.argsort(sensors.attributes["id"])  # FlatGeobuf sorts rows by place
    assert np.abs(sensors.points[order] - expected).max() < 0.002 and sorted(sensors.attributes["id"]) == ["a", "b"]
    assert sensors.normals is None and sensors.kind == "points"


@pytest.mark.parametrize("names", ["longitude,latitude", "lon,lat"])
def test_tables_in_degrees_are_projected(points, names):
    degrees = geopandas.points_from_xy(*PLACES.T, crs=CRS).to_crs("EPSG:4326")
    rows = "".join(f"{p.x!r},{p.y!r},3\n" for p in degrees).replace("np.float64(", "").replace(")", "")
    Path("p.csv").write_text(f"{names},z\n{rows}")
    assert np.abs(at.sensors_of("p.csv", floor("z")).points[:, :2] - PLACES).max() < 0.002
    with pytest.raises(at.InputError, match=r"p\.csv: is in degrees, and arrays has no CRS; give it"):
        at.sensors_of("p.csv", floor("z", None))
    Path("q.csv").write_text(f"x,y,z,{names}\n85001,447002,3,far,away\n")  # as attributes
    sensors = at.sensors_of("q.csv", floor("z"))
    assert sensors.points.tolist() == [[85001.0, 447002.0, 3.0]] and list(sensors.attributes) == names.split(",")


def test_numbers_of_geojson_that_are_no_degrees_are_those_of_the_scene(points):
    geometry = {"type": "Point", "coordinates": [85001.0, 447002.0, 3.0]}
    feature = {"type": "Feature", "properties": {"k": 1}, "geometry": geometry}
    Path("p.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    assert at.sensors_of("p.geojson", floor("z")).points.tolist() == [[85001.0, 447002.0, 3.0]]
    line = {"type": "LineString", "coordinates": [[85001.0, 447002.0], [85005.0, 447002.0]]}
    Path("l.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [{**feature, "geometry": line}]}))
    assert at.points_along("l.geojson", 1.0, crs=CRS).points[0].tolist() == [85001.5, 447002.0, 0.0]


def test_heights_are_those_of_a_column_where_points_have_none(points):
    path = points("p.gpkg", z=None, columns={"z": [1.5, 2.5]})
    assert read_point_file(path).sensors.points[:, 2].tolist() == [1.5, 2.5]
    path = points("q.gpkg", z=None)
    assert read_point_file(path, flat=True).sensors.points[:, 2].tolist() == [0.0, 0.0]
    with pytest.raises(at.InputError, match=r"q\.gpkg: its points have no heights; add a column z"):
        read_point_file(path)


def test_normals_do_not_come_from_another_crs(points):
    Path("p.csv").write_text("lon,lat,z,nx,ny,nz\n4.37,52.0,1,0,0,1\n")
    with pytest.raises(at.InputError, match=r"p\.csv: has normals, and its CRS is OGC:CRS84"):
        at.sensors_of("p.csv", floor("z"))


@pytest.mark.parametrize(
    "geometry, told",
    [
        ({"type": "Polygon", "coordinates": [[[4, 52], [5, 52], [5, 53], [4, 52]]]}, "write one layer of points"),
        (None, "row 2 is nothing, not a point"),
    ],
)
def test_other_geometries_are_refused(points, geometry, told):
    first = {"type": "Point", "coordinates": [4.37, 52.0, 1.0]} if geometry is None else geometry
    features = [{"type": "Feature", "properties": {"k": 1}, "geometry": each} for each in (first, geometry)]
    Path("p.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    with pytest.raises(at.InputError, match=told):
        read_point_file(Path("p.geojson"))
