"""Tables by block: the files and the sums of tables in memory, whatever the blocks."""

from collections import namedtuple

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sun.sun_hours import sun_blocks
from antumbra.city.sun.sun_options import SunOptions
from antumbra.city.tables import parquet_files, result_table
from antumbra.city.tables.column_totals import totals_of
from antumbra.city.tables.table_blocks import WRITTEN_BY_BLOCK, TableBlocks, file_bytes

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
OPTIONS = SunOptions(days="2026-03-21", place=PLACE, step=60, energy=True)


def town():
    """Boxes on a floor, which the raster exceeds."""
    rng = np.random.default_rng(0)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])
    soup = [cube[faces] * rng.uniform(1, 5, 3) + (*rng.uniform(-12, 12, 2), 0) for _ in range(9)]
    return at.Scene.from_arrays(np.concatenate(soup), up="z", crs="EPSG:28992")


def in_blocks(monkeypatch, size, sensors="raster:0.5", options=OPTIONS):
    """The study in blocks of a size."""
    monkeypatch.setattr("antumbra.city.sun.sun_visibility.SENSORS_PER_PART", size)
    found = sun_blocks(town(), options, sensors, None, None, None)
    assert isinstance(found, TableBlocks)
    return found


FILES = [
    (form, suffix) for form in ("raster:0.5", "raster:0.5@3", "grid:0.7") for suffix in (".csv", ".parquet", ".tif")
]
FILES = [pair for pair in FILES if pair != ("grid:0.7", ".tif")] + [("raster:0.5", ".npz")]  # a grid forms no raster


@pytest.mark.parametrize("sensors, suffix", FILES)
def test_files_written_by_block_are_those_of_the_table_in_memory(monkeypatch, tmp_path, sensors, suffix):
    pytest.importorskip("rasterio")
    pytest.importorskip("pyarrow")
    monkeypatch.setattr(parquet_files, "_GROUP", 700)
    monkeypatch.setattr(result_table, "_TILE", 16)
    texts = []
    for k, size in enumerate((190, 1 << 20)):
        (tmp_path / str(k)).mkdir()
        in_blocks(monkeypatch, size, sensors).save(tmp_path / str(k) / f"a{suffix}")
    (tmp_path / "2").mkdir()
    table = at.sun_hours(town(), sensors, "2026-03-21", place=PLACE, step=60, energy=True)
    assert len(table) > 1000 and 0.0 < table["sun_hours"].mean() < table["sun_hours"].max()
    table.save(tmp_path / "2" / f"a{suffix}")
    for k in range(3):
        texts.append({path.name: path.read_bytes() for path in sorted((tmp_path / str(k)).iterdir())})
    assert texts[0] == texts[1] == texts[2] and f"a{suffix}" in texts[0]


def test_the_totals_of_blocks_are_those_of_the_table(monkeypatch):
    blocks = in_blocks(monkeypatch, 150)
    table, found = blocks.whole(), blocks.totals
    covered = table.sensors.covered
    assert 0 < covered.sum() < len(table) == len(blocks)
    hours = table["sun_hours"][covered]
    assert totals_of(table).keys() == found.keys()
    assert found["sun_hours"].rows == len(hours) and np.isclose(found["sun_hours"].mean, hours.mean())
    assert np.isclose(found["sun_hours"].median, np.median(hours), atol=1e-3)
    assert (found["sun_hours"].least, found["sun_hours"].most) == (hours.min(), hours.max())
    assert found["sun_hours"].positive == (hours > 0).sum()
    assert np.isclose(found["sun_hours"].area, table.sensors.areas[covered].sum())


def test_a_geotiff_is_tiled(monkeypatch, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    blocks = in_blocks(monkeypatch, 170)
    blocks.save(tmp_path / "a.tif")
    table = blocks.whole()
    with rasterio.open(tmp_path / "a.tif") as file:
        assert file.profile["tiled"] and file.descriptions[0] == "sun_hours"
        for band, name in enumerate(file.descriptions, 1):
            expected = table.sensors.on_raster(table[name]).astype(np.float32)
            assert np.array_equal(file.read(band), expected, equal_nan=True) and np.isnan(expected).any()


def test_a_choice_of_surfaces_is_made_by_block(monkeypatch):
    some = SunOptions(days="2026-03-21", place=PLACE, tilt="80:100")
    blocks = in_blocks(monkeypatch, 90, "grid:0.7", some)
    table = at.sun_hours(town(), at.grid_sensors(town(), 0.7), "2026-03-21", place=PLACE, tilt="80:100")
    assert 100 < len(blocks) == len(table) < len(at.grid_sensors(town(), 0.7))
    assert np.array_equal(np.concatenate([each["sun_hours"] for each in blocks.blocks()]), table["sun_hours"])
    none = SunOptions(days="2026-03-21", place=PLACE, tilt="20:30")
    with pytest.raises(at.InputError, match="no sensors with a tilt in 20:30"):
        in_blocks(monkeypatch, 90, "grid:0.7", none)


def test_a_table_that_does_not_fit_in_memory_is_refused_before_the_work(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ("sun", "procedural:city?triangles=3000", "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21")
    many = (*words, "--sensors", "raster:0.03", "--max-memory", "1G")
    cli(*many, "-o", "a.png").refused("a.png", "21,790,224 sensors", ".csv, .parquet, .parquets, .tif", "--max-memory")
    shard = cli(*many, "-o", "a.csv", "--shard", "9/9999")
    assert shard.code == 0 and "21,790,224 sensors by block" in shard.err and not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize("suffix", [suffix for suffix in WRITTEN_BY_BLOCK if suffix != ".zarr"])
def test_the_bytes_of_a_file_follow_from_some_of_its_rows(monkeypatch, tmp_path, suffix):
    pytest.importorskip("rasterio")
    blocks = in_blocks(monkeypatch, 1 << 15, "raster:0.1")
    path = tmp_path / f"a{suffix}"
    middle = blocks.whole()
    middle = at.Table(middle.sensors.take(np.arange(30_000, 34_096)), {
        name: column._replace(values=column.values[30_000:34_096]) for name, column in middle.columns.items()
    }, middle.about, middle.scene)  # fmt: skip
    expected = file_bytes(middle, len(blocks), path)
    blocks.save(path)
    files = [path] if path.is_file() else list(path.glob("part-*"))
    size = sum(file.stat().st_size for file in files)
    assert len(blocks) > 40_000 and size < 1.3 * expected
    assert size > expected / {".csv": 1.3, ".tif": np.inf}.get(suffix, 4.0), "Parquet compresses, and rasters by far"


def test_an_output_that_does_not_fit_on_the_disk_is_refused_before_the_work(cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr("antumbra.base.files.shutil.disk_usage", lambda folder: usage(0, 0, 1_500_000_000))
    words = ("sun", "procedural:city?triangles=3000", "--latitude", 52, "--longitude", 4.36, "--days", "2026-03-21")
    cli(*words, "--sensors", "raster:0.03", "-o", "a.csv").refused("a.csv: takes ", " MB, and ", "has 1,500.0 MB left")
    assert not list(tmp_path.rglob("*.npz"))


@pytest.mark.parametrize(
    "make", [lambda scene: at.raster_sensors(scene, 0.001), lambda scene: at.grid_sensors(scene, 0.0005)]
)
def test_sensors_that_do_not_fit_in_memory_are_refused(make):
    from antumbra.base.memory import reading_limit

    with reading_limit(1 << 30), pytest.raises(at.InputError, match=r"sensors at once takes about .* of memory"):
        make(town())
