"""Tables in files: each format gives the numbers back."""

import csv
import json

import numpy as np
import pyarrow.parquet
import pytest
import rasterio

import antumbra as at
from antumbra.city.tables.result_table import Column, writer_of
from result_tables import table


def same(read, wanted):
    return np.array_equal(np.asarray(read, np.float64), wanted.astype(np.float64), equal_nan=True)


def test_csv_gives_the_same_numbers(tmp_path):
    made = table()
    made.columns["name"] = Column(np.array(["a", "b, c", 'd "e"', ""]), "", "names")
    made.save(tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["x", "y", "z", "nx", "ny", "nz", "area", "face", "hours", "first", "count", "name"]
    assert rows[0]["hours"] == rows[0]["first"] == "" and rows[1]["first"] == "2025-06-21T04:01"
    assert same([row["hours"] or "nan" for row in rows], made["hours"])
    assert same([row["y"] for row in rows], made.sensors.points[:, 1])
    assert [row["name"] for row in rows] == ["a", "b, c", 'd "e"', ""]


def test_json_has_units_and_no_nan(tmp_path):
    made = table(crs="EPSG:7415")
    made.save(tmp_path / "a.json")
    read = json.loads((tmp_path / "a.json").read_text(), parse_constant=pytest.fail)
    assert read["about"] == {"job": "test", "crs": "EPSG:7415", "length_unit": "m", "up": "z"}
    units = {name: column["unit"] for name, column in read["columns"].items()}
    assert units.keys() == read["rows"].keys()
    assert (units["hours"], units["x"], units["area"], units["nx"]) == ("h", "m", "m2", "")
    assert read["rows"]["hours"][0] is None and read["rows"]["first"][0] is None
    assert same(read["rows"]["hours"][1:], made["hours"][1:]) and read["rows"]["count"] == [-1, 0, 1, 2]


def test_npz(tmp_path):
    made = table("vertex")
    made.save(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as read:
        assert same(read["hours"], made["hours"]) and np.isnat(read["first"][0])
        assert json.loads(str(read["about"]))["columns"]["hours"]["about"] == "hours of sun"


def test_parquet_and_geoparquet(tmp_path):
    made = table("grid", crs="EPSG:7415")
    made.save(tmp_path / "a.parquet")
    read = pyarrow.parquet.read_table(tmp_path / "a.parquet")
    assert same(read["hours"].to_numpy(), made["hours"]) and len(read) == len(made)
    geo = json.loads(read.schema.metadata[b"geo"])
    assert geo["primary_column"] == "geometry" and geo["columns"]["geometry"]["encoding"] == "WKB"
    first = read["geometry"][0].as_py()
    assert len(first) == 29 and same(np.frombuffer(first, "<f8", offset=5), made.sensors.points[0])
    table().save(tmp_path / "b.parquet")
    assert b"geo" not in pyarrow.parquet.read_table(tmp_path / "b.parquet").schema.metadata


def test_geotiff_is_north_up_and_has_no_data_beside_the_surfaces(tmp_path):
    made = table("raster", crs="EPSG:28992")
    made.save(tmp_path / "a.tif")
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.descriptions == ("hours", "count") and file.units[0] == "h"
        assert file.crs.to_epsg() == 28992 and file.bounds == (-2, 0, 10, 10)
        hours = file.read(1)
    wanted = made["hours"].reshape(10, 12).astype(np.float32)
    assert np.isnan(hours[:, :2]).all() and np.array_equal(hours[:, 2:], wanted[:, 2:])


@pytest.mark.parametrize(
    "name, kind, words",
    [("a.tif", "face", "holds a raster"), ("a.txt", "face", "unknown suffix"), ("no/a.csv", "face", "does not exist")],
)
def test_refused_before_work_begins(tmp_path, name, kind, words):
    with pytest.raises(at.InputError, match=words):
        writer_of(tmp_path / name, kind)


def test_unknown_columns(tmp_path):
    for name, words in (("hour", "there are hours, first, count"), ("first", "holds times")):
        with pytest.raises(at.InputError, match=words):
            table().save(tmp_path / "a.png", name)
    assert not list(tmp_path.iterdir())
