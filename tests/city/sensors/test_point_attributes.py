"""Columns of the user's tables: in the results of every job with a row per point, or named in a note."""

import csv
import json
import warnings

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensor_files import read_points
from antumbra.city.sensors.sensors import point_sensors
from antumbra.city.tables.result_table import WRITERS, Column, Table

CSV = 'id,x,y,z,name,code,floor,rent,sun_hours,fid\n7,0.5,1,0.5,"a, b",007,2,1.5,9,1\n8,0.25,1,0.5,c,012,3,,8,2\n'
FLOOR = "v -1 0 -1\nv 1 0 -1\nv 1 0 1\nv -1 0 1\nf 3 2 1\nf 4 3 1\n"


@pytest.fixture
def points(tmp_path):
    path = tmp_path / "points.csv"
    path.write_text(CSV)
    return path


def test_csv_columns_keep_their_kinds(points):
    read = read_points(points).attributes
    assert list(read) == ["id", "name", "code", "floor", "rent", "sun_hours", "fid"]
    assert {name: values.dtype.kind for name, values in read.items()} == {
        "id": "i", "name": "O", "code": "O", "floor": "i", "rent": "f", "sun_hours": "i", "fid": "i"
    }  # fmt: skip
    assert read["name"].tolist() == ["a, b", "c"] and read["code"].tolist() == ["007", "012"]
    assert read["rent"][0] == 1.5 and np.isnan(read["rent"][1])


def test_other_files_have_the_same_columns(points, tmp_path):
    pandas = pytest.importorskip("pandas", reason="needs pandas: .parquet is NOT checked")
    frame = pandas.read_csv(points, dtype={"code": str})
    frame["when"], frame["list"] = pandas.to_datetime(["2026-01-01", "2026-01-02"]), [[1], [2]]
    frame.to_parquet(tmp_path / "a.parquet")
    with pytest.warns(
        UserWarning, match=r"^a\.parquet: left out the column list, without a plain value for each point$"
    ):
        read = read_points(tmp_path / "a.parquet").attributes
    assert list(read) == ["id", "name", "code", "floor", "rent", "sun_hours", "fid", "when"]
    assert read["code"].tolist() == ["007", "012"] and read["when"].dtype.kind == "M"
    xyz = dict.fromkeys("xyz", np.zeros(2))
    np.savez(tmp_path / "a.npz", **xyz, floor=np.array([2, 3], np.uint8), size=np.ones(3), name=np.array(["a", "b"]))
    with pytest.warns(UserWarning, match=r"^a\.npz: left out the columns size, name, without"):
        read = read_points(tmp_path / "a.npz").attributes
    assert list(read) == ["floor"] and read["floor"].tolist() == [2, 3]


def test_texts_and_categories_of_parquet(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs pyarrow: .parquet is NOT checked")
    import pyarrow

    n = 1000
    columns = {axis: np.arange(float(n)) for axis in "xyz"}
    columns["street"] = pyarrow.array([None, "High St", "Low St", ""] * (n // 4))
    columns["use"] = pyarrow.array(["home", None] * (n // 2)).dictionary_encode()
    columns["long"] = pyarrow.array([str(k) for k in range(n)], pyarrow.large_string())
    columns["step"] = pyarrow.array(range(n), pyarrow.int16())
    columns["level"] = pyarrow.array([1, None] * (n // 2))
    columns["open"] = pyarrow.array([True, None] * (n // 2))
    columns["codes"] = pyarrow.array([1, 2] * (n // 2)).dictionary_encode()
    columns["blob"] = pyarrow.array([b"a"] * n)
    parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet", row_group_size=300)
    with pytest.warns(UserWarning, match="left out the columns open, blob, without"):
        read = read_points(tmp_path / "a.parquet").attributes
    assert list(read) == ["street", "use", "long", "step", "level", "codes"]
    assert read["street"][:5].tolist() == ["", "High St", "Low St", "", ""] and read["use"][-2:].tolist() == [
        "home",
        "",
    ]
    assert read["long"][999] == "999" and read["step"][999] == 999 and read["step"].dtype == np.int64
    assert read["level"][0] == 1.0 and np.isnan(read["level"][1])


def test_a_repeated_column_is_named(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z,a,b,a\n1,2,3,4,5,6\n")
    with pytest.warns(UserWarning, match=r"^a\.csv: left out the column a, without"):
        assert list(read_points(tmp_path / "a.csv").attributes) == ["b"]


def test_names_that_are_taken_are_changed(points):
    sensors = read_points(points)
    table = Table(sensors, {"sun_hours": Column(np.array([1.0, 2.0]), "h", "")})
    rows = table.rows()
    assert list(rows) == [
        "x",
        "y",
        "z",
        "id",
        "name",
        "code",
        "floor",
        "rent",
        "sun_hours_given",
        "fid_given",
        "sun_hours",
    ]
    assert rows["sun_hours"].tolist() == [1.0, 2.0] and rows["sun_hours_given"].tolist() == [9, 8]
    again = Table(point_sensors(np.zeros((1, 3))), {})
    again.sensors.attributes.update({"X": np.ones(1), "x_given": np.zeros(1), "Geometry": np.ones(1)})
    assert list(again.rows()) == ["x", "y", "z", "X_given", "x_given_given", "Geometry_given"]


@pytest.mark.parametrize(
    "suffix", [suffix for suffix in WRITERS if suffix not in (".tif", ".zarr", ".png", ".glb", ".html")]
)
def test_every_table_format_has_them(suffix, points, tmp_path):
    sensors = read_points(points)
    path = tmp_path / f"out{suffix}"
    table = Table(sensors, {"sun_hours": Column(np.array([1.0, 2.0]), "h", "")})
    table.save(path)
    if suffix == ".npz":
        names = list(np.load(path))
    elif suffix == ".json":
        names = list(json.loads(path.read_text())["rows"])
    elif suffix == ".csv":
        names = path.read_text().partition("\n")[0].split(",")
        assert '"a, b",007,2,1.5' in path.read_text()
    elif suffix in (".parquet", ".parquets"):
        pyarrow = pytest.importorskip("pyarrow", reason="NOT checked")
        names = pytest.importorskip("pyarrow.dataset", reason="NOT checked").dataset(path).schema.names
        assert pyarrow.types.is_string(pyarrow.dataset.dataset(path).schema.field("code").type)
    else:
        names = list(pytest.importorskip("pyogrio", reason="NOT checked").read_info(path)["fields"])
    assert set(table.rows()) <= set(names)


JOBS = {
    "sun": ["--sensors", "points.csv", "--latitude", 52, "--longitude", 4, "--days", "2026-06-21", "--step", 240],
    "viewshed": ["--sensors", "points.csv", "--observer", "0,2,0"],
    "visible": ["--sensors", "points.csv", "--turbine", "3,0,0", "--hub-height", 1, "--rotor", 1],
    "matrix": ["--sensors", "points.csv"],
}


@pytest.mark.parametrize("name", JOBS)
def test_they_come_through_every_job_with_a_row_per_sensor(name, cli, points):
    (points.parent / "floor.obj").write_text(FLOOR)
    output = ["--counts", "out.csv", "-o", "m.npy"] if name == "matrix" else ["-o", "out.csv"]
    done = cli(name, "floor.obj", *JOBS[name], *output)
    assert done.code == 0 and "come through" not in done.err, done
    head, *rows = (points.parent / "out.csv").read_text().splitlines()
    assert "id,name,code,floor,rent" in head and '7,"a, b",007,2,1.5' in rows[0] and "8,c,012,3,," in rows[1]


def test_lines_of_sight_have_the_columns_of_both_ends_or_of_the_pairs(cli, points):
    (points.parent / "floor.obj").write_text(FLOOR)
    (points.parent / "signs.csv").write_text("x,y,z,text\n0,2,0,stop\n")
    assert cli("los", "floor.obj", "--observers", "points.csv", "--targets", "signs.csv", "-o", "out.csv").code == 0
    head, first, _ = (points.parent / "out.csv").read_text().splitlines()
    assert "from_id,from_name,from_code" in head and "to_text" in head and ",stop," in first
    (points.parent / "pairs.csv").write_text("from,to,why\n1,0,test\n")
    more = "--observers", "points.csv", "--targets", "signs.csv", "--pairs", "pairs.csv", "-o", "out.csv"
    assert cli("los", "floor.obj", *more).code == 0
    head, row = (points.parent / "out.csv").read_text().splitlines()
    assert ",why," in head and ",test," in row and ",c,012," in row
    (points.parent / "both.csv").write_text("x1,y1,z1,x2,y2,z2,street\n0,1,0,0,2,0,High St\n")
    assert cli("los", "floor.obj", "--pairs", "both.csv", "-o", "out.csv").code == 0
    assert (
        ",street," in (points.parent / "out.csv").read_text() and ",High St," in (points.parent / "out.csv").read_text()
    )


@pytest.mark.parametrize(
    "words",
    [
        ("viewshed", "floor.obj", "--observers", "points.csv", "--sensors", "face", "-o", "a.csv"),
        ("visible", "floor.obj", "--points", "points.csv", "--sensors", "face", "-o", "a.csv"),
        ("matrix", "floor.obj", "--sensors", "face", "--targets", "points.csv", "-o", "a.npy"),
    ],
)
def test_columns_without_a_place_in_the_results_are_named(words, cli, points):
    (points.parent / "floor.obj").write_text(FLOOR)
    done = cli(*words)
    told = (
        "note: points.csv: the columns id, name, code, floor, rent, sun_hours, fid do not come through to the results"
    )
    assert done.code == 0 and told in done.err, done
    assert "come through" not in cli(*words, "--quiet").err


def test_parts_of_sensors_have_parts_of_the_columns(points):
    sensors = read_points(points)
    assert sensors.part(1, 2).attributes["id"].tolist() == [8]
    assert sensors.take(np.array([1])).attributes["name"].tolist() == ["c"]
    with pytest.raises(at.InputError, match="the attribute 'a' of sensors must be an array of 1 value"):
        at.Sensors(np.zeros((1, 3)), None, None, None, "points", attributes={"a": np.zeros(2)})


def test_files_without_other_columns_warn_of_nothing(tmp_path):
    (tmp_path / "a.csv").write_text("X, Y ,z,nx,ny,nz,area\n1,2,3,0,0,1,2\n")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert read_points(tmp_path / "a.csv").attributes == {}


@pytest.mark.parametrize("before", [(), ("--add", "box.obj", "--before")])
@pytest.mark.parametrize("suffix", ["csv", "json", "npz"])
def test_skylines_have_the_columns_of_their_points(cli, points, suffix, before):
    (points.parent / "floor.obj").write_text(FLOOR)
    (points.parent / "box.obj").write_text("v 0 0 -1\nv 1 0 -1\nv 0.5 4 -1\nf 1 2 3\n")
    done = cli("skyline", "floor.obj", "--points", "points.csv", "--azimuth-step", 90, *before, "-o", f"a.{suffix}")
    assert done.code == 0, done.err
    path = points.parent / f"a.{suffix}"
    if suffix == "csv":
        with open(path, newline="", encoding="utf-8") as file:
            found = {name: list(values) for name, *values in zip(*csv.reader(file))}
        assert found["name"] == ["a, b"] * 4 + ["c"] * 4 and found["code"] == ["007"] * 4 + ["012"] * 4
    elif suffix == "json":
        document = json.loads(path.read_text())
        found = document["rows" if before else "attributes"]
        assert list(dict.fromkeys(found["name"])) == ["a, b", "c"]
    else:
        assert list(dict.fromkeys(np.load(path)["name"].tolist())) == ["a, b", "c"]
    if before and suffix == "csv":
        loss = [float(row) for row in found["elevation_loss"]]
        assert (
            loss == [float(b) - float(a) for b, a in zip(found["elevation_before"], found["elevation"])]
            and min(loss) < 0
        )
