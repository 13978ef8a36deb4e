"""Sensors from text and from files of points."""

import io
import zipfile

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import antumbra as at
from antumbra.base import memory
from antumbra.city.sensors import table_rows
from antumbra.city.sensors.sensor_files import check_sensors, kind_of, read_points, sensors_of
from mutations import mutated

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
@pytest.mark.parametrize("normals, areas", [(True, True), (False, True), (True, False), (False, False)])
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
    "text, kind, count",
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
    with pytest.raises(at.InputError, match=r"^sensors is"):
        check_sensors(text)


@pytest.mark.parametrize(
    "name, text, words",
    [
        ("a.csv", "x,y\n1,2\n", "column 'z' is missing"),
        ("a.csv", "x,y,z\n1,2,3\n1,zwei,3\n", "line 3: '1,zwei,3'"),
        ("a.csv", "x,y,z\n1,2\n", "line 2"),
        ("a.csv", "x,y,z\n1,2,nan\n", "NaN"),
        ("a.csv", "", "empty"),
        ("a.npy", "no array", "not a numpy array file"),
        ("a.npz", "no archive", "cannot be read"),
        ("a.parquet", "no table", "does not begin as a .parquet file"),
        ("a.parquet", "PAR1, and no table", "cannot be read"),
    ],
)
def test_bad_files(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(at.InputError, match=words):
        read_points(tmp_path / name)


@pytest.mark.parametrize("array", [np.zeros(3), np.zeros((2, 4))])
def test_bad_arrays(tmp_path, array):
    np.save(tmp_path / "a.npy", array)
    with pytest.raises(at.InputError, match="points are"):
        read_points(tmp_path / "a.npy")


def test_columns_that_are_no_numbers(tmp_path):
    np.savez(tmp_path / "a.npz", x=np.zeros((2, 2)), y=np.zeros(2), z=np.zeros(2))
    with pytest.raises(at.InputError, match="column 'x' must hold numbers"):
        read_points(tmp_path / "a.npz")


def test_texts_are_no_points(tmp_path):
    np.save(tmp_path / "a.npy", np.array([["a"] * 3]))
    with pytest.raises(at.InputError, match=r"a\.npy holds <U1; only plain numbers are read"):
        read_points(tmp_path / "a.npy")
    pyarrow.parquet.write_table(pyarrow.table({"x": ["a"], "y": [1.0], "z": [1.0]}), tmp_path / "a.parquet")
    with pytest.raises(at.InputError, match="column 'x' must hold numbers, not object"):
        read_points(tmp_path / "a.parquet")


def test_long_tables(tmp_path, monkeypatch):
    monkeypatch.setattr(table_rows, "CSV_ROWS", 3)
    for n in 0, 1, 3, 7:
        points = np.arange(3.0 * n).reshape(n, 3)
        (tmp_path / "a.csv").write_text("x,y,z\n" + "".join(f"{x},{y},{z}\n" for x, y, z in points))
        assert np.array_equal(read_points(tmp_path / "a.csv").points, points) if n else True


# --- damage ------------------------------------------------------------------------------------------------------


def refused(path, words):
    with pytest.raises(at.InputError, match=words) as caught:
        read_points(path)
    assert path.name in str(caught.value) and "\n" not in str(caught.value)


def test_a_very_long_cell(tmp_path):
    (tmp_path / "a.csv").write_text("x,y,z\n1,2," + "3" * 131_073)
    refused(tmp_path / "a.csv", "cannot be read")


def test_a_header_without_an_end(tmp_path):
    np.save(tmp_path / "a.npy", POINTS)
    (tmp_path / "a.npy").write_bytes((tmp_path / "a.npy").read_bytes().replace(b"}", b" "))
    refused(tmp_path / "a.npy", "not a numpy array file")


def test_a_corrupt_deflate_stream(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", **dict(zip("xyz", np.random.default_rng(0).random((3, 1000)))))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[200:300] = bytes(100)
    (tmp_path / "a.npz").write_bytes(data)
    refused(tmp_path / "a.npz", "cannot be read|not a numpy array file")


def test_an_array_larger_than_its_file(tmp_path):
    np.save(tmp_path / "a.npy", POINTS)
    data = (tmp_path / "a.npy").read_bytes()
    (tmp_path / "a.npy").write_bytes(data.replace(b"(2, 3), }      ", b"(1 << 40, 3), }")[: len(data)])
    refused(tmp_path / "a.npy", "not a numpy array file")
    (tmp_path / "a.npy").write_bytes(data.replace(b"(2, 3), }      ", b"(999999999, 3)}"))
    refused(tmp_path / "a.npy", "says 23999999976 bytes of data, but has 48")


def bomb(path, suffix, n=1 << 27):
    """Write a file whose columns take 3 GB, of a few megabytes."""
    if suffix == ".parquet":
        column = pyarrow.array(np.zeros(1 << 10))
        with pyarrow.parquet.ParquetWriter(path, pyarrow.schema([(c, "float64") for c in "xyz"])) as writer:
            writer.write_table(pyarrow.table({c: pyarrow.chunked_array([column] * (n >> 10)) for c in "xyz"}))
        return
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (n,)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in "xyz":
            archive.writestr(f"{name}.npy", header.getvalue() + bytes(1 << 16))
    data = bytearray(path.read_bytes())  # lie: a small file that says that it is large is refused just as well
    for name in b"x.npy", b"y.npy", b"z.npy":
        at_name = data.rindex(name)
        data[at_name - 22 : at_name - 18] = (8 * n - 1).to_bytes(4, "little")
    path.write_bytes(data)


def test_files_that_expand_are_refused_before_they_do(tmp_path, monkeypatch):
    bomb(tmp_path / "a.npz", ".npz")
    refused(tmp_path / "a.npz", "takes about 9.7 GB of memory, more than .* raise max_memory")
    monkeypatch.setattr(memory, "LEAST_LIMIT", 1 << 16)
    bomb(tmp_path / "a.parquet", ".parquet", 1 << 17)
    refused(tmp_path / "a.parquet", "of memory, more than files of .* need at most")


def test_a_checksum_that_is_wrong(tmp_path):
    path = written(tmp_path, ".npz", columns())
    data = bytearray(path.read_bytes())
    at_data = data.index(POINTS[:, 1].tobytes())
    data[at_data] ^= 1
    path.write_bytes(data)
    refused(path, "CRC|not a numpy array file")


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".npy", ".deflated.npz"])
def test_mutated_files_are_read_or_refused(tmp_path, suffix):
    path = tmp_path / f"points{suffix}"
    if suffix == ".npy":
        np.save(path, POINTS)
    elif suffix == ".deflated.npz":
        np.savez_compressed(path, **columns())
    else:
        written(tmp_path, suffix, columns())
    data, rng, told = path.read_bytes(), np.random.default_rng(0), []
    for _ in range(300):
        path.write_bytes(mutated(data, rng))
        try:
            read_points(path)
            told.append("")
        except at.InputError as error:
            told.append(str(error))
    assert 0 < told.count("") < 300 and not any("\n" in line for line in told)


def test_no_file(tmp_path):
    with pytest.raises(at.InputError, match="no such file"):
        read_points(tmp_path / "a.csv")
