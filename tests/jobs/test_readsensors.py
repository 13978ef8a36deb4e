"""Sensors from text and from files of points."""

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import antumbra as at
from antumbra.jobs.readsensors import check_sensors, kind_of, read_points, sensors_of

POINTS = np.array([[1.0, 2.0, 3.0], [4.5, -5.0, 6e3]])
NORMALS = np.array([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
AREAS = np.array([2.0, 0.5])


def scene():
    return at.Scene.from_arrays([[0, 0, 0], [4, 0, 0], [4, 4, 1], [0, 4, 1]], [[0, 1, 2], [0, 2, 3]], up="z")


def columns(normals=True, areas=True):
    found = dict(zip("xyz", POINTS.T))
    if normals:
        found |= dict(zip(("nx", "ny", "nz"), NORMALS.T))
    return found | ({"area": AREAS} if areas else {})


def written(folder, suffix, found):
    path = folder / f"points{suffix}"
    if suffix == ".npz":
        np.savez(path, **found, name=np.array(["a", "b"]))
    elif suffix == ".parquet":
        pyarrow.parquet.write_table(pyarrow.table({"name": ["a", "b"], **found}), path)
    else:
        rows = [",".join(["name", *found]), *(",".join(["a b", *map(str, row)]) for row in zip(*found.values()))]
        path.write_text("\n".join(rows) + "\n\n", encoding="utf-8-sig")
    return path


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet"])
@pytest.mark.parametrize(("normals", "areas"), [(True, True), (False, True), (True, False), (False, False)])
def test_columns_of_points(tmp_path, suffix, normals, areas):
    read = read_points(written(tmp_path, suffix, columns(normals, areas)))
    assert np.array_equal(read.points, POINTS) and read.kind == "points"
    assert np.allclose(read.normals, NORMALS) if normals else read.normals is None
    assert np.array_equal(read.areas, AREAS) if areas else read.areas is None


def test_arrays_of_points(tmp_path):
    np.save(tmp_path / "a.npy", POINTS)
    np.save(tmp_path / "b.npy", np.hstack([POINTS, 2 * NORMALS]).astype(np.float32))
    assert read_points(tmp_path / "a.npy").normals is None
    read = read_points(tmp_path / "b.npy")
    assert np.array_equal(read.points, POINTS) and np.allclose(read.normals, NORMALS)


@pytest.mark.parametrize(
    ("text", "kind", "count"),
    [("face", "face", 2), ("vertex", "vertex", 4), ("grid:1", "grid", 16), ("raster:2", "raster", 4)],
)
def test_forms(text, kind, count):
    check_sensors(text)
    found = sensors_of(text, scene())
    assert found.kind == kind == kind_of(text) and abs(len(found) - count) <= 2


def test_heights_of_rasters():
    heights = [sensors_of(text, scene()).points[:, 2] for text in ("raster:2", "raster:2+1.5", "raster:2@7")]
    assert np.allclose(heights[1], heights[0] + 1.5) and np.ptp(heights[0]) > 0.4 and (heights[2] == 7.0).all()


@pytest.mark.parametrize("text", ["faces", "grid", "grid:", "raster:1+", "raster:-1", "points.txt", "grid:1:2"])
def test_unknown_forms(text):
    with pytest.raises(at.InputError, match="--sensors is"):
        check_sensors(text)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.csv", "x,y\n1,2\n", "column 'z' is missing"),
        ("a.csv", "x,y,z\n1,2,3\n1,zwei,3\n", "line 3: '1,zwei,3'"),
        ("a.csv", "x,y,z\n1,2\n", "line 2"),
        ("a.csv", "x,y,z\n1,2,nan\n", "NaN"),
        ("a.csv", "", "empty"),
        ("a.npy", "no array", "cannot be read"),
        ("a.npz", "no archive", "cannot be read"),
        ("a.parquet", "no table", "cannot be read"),
    ],
)
def test_bad_files(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(at.InputError, match=words):
        read_points(tmp_path / name)


@pytest.mark.parametrize("array", [np.zeros(3), np.zeros((2, 4)), np.array([["a"] * 3])])
def test_bad_arrays(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(at.InputError, match="points are"):
        read_points(tmp_path / "a.npy")


def test_columns_that_are_no_numbers(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros((2, 2)), y=np.zeros(2), z=np.zeros(2))
    with pytest.raises(at.InputError, match="column 'x' must hold numbers"):
        read_points(tmp_path / "a.npz")


def test_no_file(tmp_path):
    with pytest.raises(at.InputError, match="no such file"):
        read_points(tmp_path / "a.csv")
