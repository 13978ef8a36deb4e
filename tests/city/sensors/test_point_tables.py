"""Points of files by block: those of the whole file, to the last bit, whatever the blocks."""

import os

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import antumbra as at
from antumbra.city.sensors import sensor_files, table_rows, vector_points
from antumbra.city.sensors.point_tables import FileBlocks, point_table
from antumbra.city.sensors.sensor_files import read_point_file, sensor_blocks

N = 40
SUFFIXES = ".csv", ".parquet", ".npy", ".gpkg", ".geo.parquet"


@pytest.fixture(autouse=True)
def small_batches(monkeypatch):
    monkeypatch.setattr(table_rows, "CSV_ROWS", 7)
    monkeypatch.setattr(table_rows, "BATCH", 6)
    monkeypatch.setattr(vector_points, "BATCH", 6)
    monkeypatch.setattr(sensor_files, "_AT_ONCE", 0)


def floor(crs=None):
    corners = np.array([[[0.0, 0, 0], [60, 0, 0], [60, 60, 0]], [[0.0, 0, 0], [60, 60, 0], [0, 60, 0]]])
    return at.Scene.from_arrays(corners + (0 if crs is None else (85_000, 447_000, 0)), up="z", crs=crs)


def columns(normals=True):
    """Coordinates, and columns whose types the last rows decide."""
    rng = np.random.default_rng(3)
    found = dict(zip("xyz", np.round(rng.uniform(1, 59, (3, N)), 3)))
    if normals:
        found |= dict(zip(("nx", "ny", "nz"), rng.normal(size=(3, N)))) | {"area": rng.uniform(0, 2, N)}
    found["whole"] = list(range(N))
    found["late"] = [*range(N - 1), 0.5]
    found["gap"] = [*range(N - 1), None]
    found["code"] = [*(str(k) for k in range(1, N)), "007"]
    found["name"] = [f'a "{k}",\nb' if k % 3 else None for k in range(N)]
    return found


def written(folder, suffix, found):
    path = folder / f"points{suffix}"
    xyz = np.stack([found[name] for name in "xyz"], 1)
    if suffix in (".gpkg", ".geo.parquet"):
        geopandas = pytest.importorskip("geopandas", reason="needs geopandas: geometries are NOT checked")
        others = {name: v for name, v in found.items() if name not in ("x", "y", "z", "nx", "ny", "nz", "area")}
        frame = geopandas.GeoDataFrame(others, geometry=geopandas.points_from_xy(*xyz.T), crs="EPSG:28992")
        if suffix == ".gpkg":
            frame.to_file(path, engine="pyogrio")
            remove_feature(path, 5)
        else:
            frame.to_parquet(path, row_group_size=17)
    elif suffix == ".npy":
        np.save(path, np.hstack([xyz, np.stack([found[n] for n in ("nx", "ny", "nz")], 1)]) if "nx" in found else xyz)
    elif suffix == ".parquet":
        pyarrow.parquet.write_table(pyarrow.table(found), path, row_group_size=17)
    else:
        text = lambda value: "" if value is None else '"' + str(value).replace('"', '""') + '"'
        rows = [",".join(map(text, row)) for row in zip(*found.values())]
        rows[20:20] = [""] * 9
        path.write_text("\n".join([",".join(found), *rows]) + "\n\n", encoding="utf-8-sig")
    return path


def remove_feature(path, feature):
    """Remove a feature, so that numbers of features are not numbers of rows."""
    import sqlite3

    with sqlite3.connect(path) as database:
        database.create_function("ST_IsEmpty", 1, lambda _: 0)
        for name in ("ST_MinX", "ST_MaxX", "ST_MinY", "ST_MaxY"):
            database.create_function(name, 1, lambda _: 0.0)
        database.execute("DELETE FROM points WHERE fid = ?", (feature,))


def equal(a, b):
    for name in ("points", "normals", "areas"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert a.kind == b.kind == "points" and list(a.attributes) == list(b.attributes)
    for name, values in a.attributes.items():
        other = b.attributes[name]
        assert values.dtype == other.dtype, name
        assert values.tolist() == other.tolist() or np.array_equal(values, other, equal_nan=True), name


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("normals", [True, False])
def test_blocks_are_the_points_read_at_once(tmp_path, suffix, normals):
    scene = floor("EPSG:28992" if suffix in (".gpkg", ".geo.parquet") else None)
    path = written(tmp_path, suffix, columns(normals))
    whole, described = read_point_file(path).within(scene), sensor_blocks(str(path), scene)
    n = N - (suffix == ".gpkg")
    assert isinstance(described, FileBlocks) and len(described) == len(whole) == n
    assert described.sided == (whole.normals is not None)
    assert len(whole.attributes) == (0 if suffix == ".npy" else 5)
    equal(described.whole(), whole)
    for size in (1, 4, 11, n):
        starts = np.random.default_rng(size).permutation(range(0, n, size))
        for first in starts.tolist():
            some = np.arange(first, min(first + size, n))
            equal(described.block(first, min(first + size, n)), whole.take(some))
    none = described.block(3, 3)
    assert len(none) == 0 and {k: v.dtype for k, v in none.attributes.items()} == {
        k: v.dtype for k, v in whole.attributes.items()
    }


def test_types_are_those_of_all_rows(tmp_path):
    kinds = sensor_blocks(str(written(tmp_path, ".csv", columns())), floor()).block(0, 3).attributes
    assert {name: values.dtype.kind for name, values in kinds.items()} == {
        "whole": "i", "late": "f", "gap": "f", "code": "O", "name": "O"
    }  # fmt: skip
    assert kinds["code"].tolist() == ["1", "2", "3"] and kinds["late"].tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize("suffix", [".csv", ".parquet", ".npy"])
@pytest.mark.parametrize(
    "name, value, words",
    [("y", np.nan, "row 31"), ("z", np.inf, "row 31"), ("nx", 0.0, "the normal of sensor 31 is zero"),
     ("area", -1.0, "areas of sensors must be .* finite and not negative")],
)  # fmt: skip
def test_bad_values_are_named_before_the_work_as_by_the_whole(tmp_path, suffix, name, value, words):
    if suffix == ".npy" and name == "area":
        return
    found = columns()
    found[name] = np.array(found[name])
    found[name][31] = value
    if name == "nx":
        found["ny"][31] = found["nz"][31] = 0.0
    path = written(tmp_path, suffix, found)
    told = []
    for read in (sensor_blocks, at.sensors_of):
        with pytest.raises(at.InputError, match=words) as caught:
            read(str(path), floor())
        told.append(str(caught.value))
    assert told[0] == told[1] and told[0].startswith(f"{path.name}: ")


@pytest.mark.parametrize("text", ["x,y,z\n1,2,3\n1,zwei,3\n", "x,y\n1,2\n", "x,y,z\n1,2,3\n" + 9 * "1,2,3,4\n"])
def test_bad_lines_are_named_as_by_the_whole(tmp_path, text):
    path, told = tmp_path / "a.csv", []
    path.write_text(text)
    for read in (sensor_blocks, at.sensors_of):
        with pytest.raises(at.InputError) as caught:
            read(str(path), floor())
        told.append(str(caught.value))
    assert told[0] == told[1] and ("line" in told[0] or "'z'" in told[0])


def test_the_description_is_that_of_the_numbers(tmp_path):
    found, scene = columns(), floor()
    digests = [sensor_blocks(str(written(tmp_path, suffix, found)), scene).digest for suffix in (".csv", ".parquet")]
    assert digests[0] == digests[1]
    found["y"][33] += 1e-9
    other = sensor_blocks(str(written(tmp_path, ".parquet", found)), scene)
    assert other.digest != digests[0]
    assert repr(other.description) != repr(sensor_blocks(str(written(tmp_path, ".npy", found)), scene).description)


def test_columns_without_plain_values_are_named_once(tmp_path):
    found = columns() | {"open": [True] * (N - 1) + [None], "list": [[1]] * N}
    path = written(tmp_path, ".parquet", found)
    with pytest.warns(UserWarning, match="left out the columns open, list, without") as told:
        described = sensor_blocks(str(path), floor())
    assert len(told) == 1 and not {"open", "list"} & described.block(0, 9).attributes.keys()


def test_a_file_that_changes_is_refused(tmp_path):
    path = written(tmp_path, ".csv", columns())
    described = sensor_blocks(str(path), floor())
    path.write_text(path.read_text(encoding="utf-8-sig"), encoding="utf-8-sig")
    os.utime(path, ns=(0, 0))
    with pytest.raises(at.InputError, match=r"points\.csv: was changed while it was read"):
        described.block(0, 5)


def test_points_in_degrees_are_moved_by_block(tmp_path):
    pytest.importorskip("pyproj", reason="needs pyproj: CRS by block are NOT checked")
    rng = np.random.default_rng(1)
    found = {"lon": 4.38 + 0.001 * rng.random(N), "lat": 52.0 + 0.001 * rng.random(N), "z": rng.random(N)}
    pyarrow.parquet.write_table(pyarrow.table(found), tmp_path / "a.parquet", row_group_size=17)
    scene = floor("EPSG:28992")
    whole, described = (
        at.sensors_of(str(tmp_path / "a.parquet"), scene),
        sensor_blocks(str(tmp_path / "a.parquet"), scene),
    )
    assert len(described) == N and whole.points[:, 0].min() > 80_000
    for first in (0, 13, 26):
        assert np.array_equal(described.block(first, first + 13).points, whole.points[first : first + 13])
    with pytest.raises(at.InputError, match=r"is in degrees, and .* has no CRS"):
        sensor_blocks(str(tmp_path / "a.parquet"), floor())


def test_rounded_coordinates_are_noted(tmp_path):
    xyz = (np.random.default_rng(0).random((N, 3)) * 10 + (447_000, 85_000, 0)).astype(np.float32)
    np.save(tmp_path / "a.npy", xyz)
    with pytest.warns(UserWarning, match=r"a\.npy: .* rounded to steps of .* by float32; write it in float64"):
        sensor_blocks(str(tmp_path / "a.npy"), floor())


def test_parquet_is_large_by_its_rows_not_its_bytes(tmp_path, monkeypatch):
    monkeypatch.setattr(table_rows, "BATCH", 1 << 16)
    monkeypatch.setattr(sensor_files, "_AT_ONCE", 1 << 25)
    for n in 1000, 1_100_000:
        pyarrow.parquet.write_table(pyarrow.table(dict.fromkeys("xyz", np.ones(n))), tmp_path / "a.parquet")
        assert (tmp_path / "a.parquet").stat().st_size < 1 << 20
        found = sensor_blocks(str(tmp_path / "a.parquet"), floor())
        assert len(found) == n and isinstance(found, FileBlocks) == (n > 1000)


def test_a_row_group_larger_than_memory_is_refused(tmp_path, monkeypatch):
    pyarrow.parquet.write_table(pyarrow.table(columns()), tmp_path / "a.parquet")
    table = point_table(tmp_path / "a.parquet")
    with at.base.memory.reading_limit(1000), pytest.raises(at.InputError, match="of memory, more than the limit"):
        table.rows.survey()


SUN = ("--latitude", 52, "--longitude", 4, "--days", "2026-06-21", "--step", 120)
JOBS = {
    "sun": (*SUN,),
    "viewshed": ("--observer", "30,30,9"),
    "visible": ("--turbine", "30,30,0", "--hub-height", 9, "--rotor", 4),
}


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@pytest.mark.parametrize("job", JOBS)
def test_results_by_block_and_by_shards_are_those_of_the_whole(tmp_path, cli, monkeypatch, job, suffix):
    from antumbra.city.sight import targets, viewshed
    from antumbra.city.sun import sun_visibility

    for module in sun_visibility, targets, viewshed:
        monkeypatch.setattr(module, "SENSORS_PER_PART", 9)
    points = written(tmp_path, suffix, columns())
    (tmp_path / "floor.obj").write_text("v 0 0 0\nv 60 0 0\nv 60 60 0\nv 20 20 9\nf 1 2 3\nf 1 2 4\n")
    words = job, "floor.obj", "--up", "z", "--sensors", points, *JOBS[job], "-o", "a.csv", "-o", "a.parquet", "-q"
    monkeypatch.setattr(sensor_files, "_AT_ONCE", 1 << 25)
    assert cli(*words).code == 0
    whole = [(tmp_path / name).read_bytes() for name in ("a.csv", "a.parquet")]
    assert b"late" in whole[0] and whole[0].count(b"\n") > N
    monkeypatch.setattr(sensor_files, "_AT_ONCE", 0)
    assert cli(*words).code == 0
    assert [(tmp_path / name).read_bytes() for name in ("a.csv", "a.parquet")] == whole
    for i in range(3):
        assert cli(*words, "--shard", f"{i}/3").code == 0
    (tmp_path / "a.csv").unlink()
    assert cli("merge", "a.shards", "-q").code == 0
    assert [(tmp_path / name).read_bytes() for name in ("a.csv", "a.parquet")] == whole
