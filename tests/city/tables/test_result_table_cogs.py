"""Cloud Optimized GeoTIFFs of all jobs: the layout that GDAL documents, and the values and place of the plain file."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables import result_table
from city.sight.test_raster_viewshed import EYE, write_hills
from city.tables.test_table_blocks import PLACE, in_blocks, town

rasterio = pytest.importorskip("rasterio")


def checked(cog, tif):
    """Check the layout of a COG, and that it has all that the plain file has; return its overviews."""
    head = cog.read_bytes()[:512]
    assert b"GDAL_STRUCTURAL_METADATA_SIZE" in head and b"LAYOUT=IFDS_BEFORE_DATA" in head
    with rasterio.open(cog) as made, rasterio.open(tif) as plain:
        assert made.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG" and "LAYOUT" not in plain.tags(ns="IMAGE_STRUCTURE")
        assert made.profile["tiled"] and made.block_shapes == [(512, 512)] * made.count
        values = plain.read()
        assert np.array_equal(made.read(), values, equal_nan=True) and np.nanmin(values) < np.nanmax(values)
        for name in ("descriptions", "units", "crs", "transform", "shape", "dtypes"):
            assert getattr(made, name) == getattr(plain, name), name
        assert np.isnan(made.nodata) and made.tags()["antumbra"] == plain.tags()["antumbra"]
        return made.overviews(1), values


@pytest.mark.parametrize("in_memory", [0, 1 << 26])
def test_it_has_overviews_with_values_of_cells(monkeypatch, tmp_path, in_memory):
    monkeypatch.setattr(result_table, "_IN_MEMORY", in_memory)
    table = at.sun_hours(town(), "raster:0.02", "2026-03-21", place=PLACE, step=240)
    for name in "a.tif", "a.cog.tif":
        table.save(tmp_path / name)
    overviews, values = checked(tmp_path / "a.cog.tif", tmp_path / "a.tif")
    assert overviews == [2, 4]
    with rasterio.open(tmp_path / "a.cog.tif", overview_level=1) as small:
        found = small.read(1)
        assert small.width <= 512 and np.isin(found[~np.isnan(found)], values[0]).all() and np.nanmax(found) > 0.0
    assert not list(tmp_path.glob(".*")) and (tmp_path / "a.cog.qml").exists()


def test_equal_tables_give_equal_bytes(monkeypatch, tmp_path):
    for k, size in enumerate((190, 1 << 20)):
        in_blocks(monkeypatch, size).save(tmp_path / f"{k}.cog.tif")
    assert (tmp_path / "0.cog.tif").read_bytes() == (tmp_path / "1.cog.tif").read_bytes()


SUN = "--days", "2026-03-21", "--step", 240
JOBS = {
    "sun": ("sun", *SUN),
    "viewshed": ("viewshed", *EYE),
    "viewshed in bands": ("viewshed", *EYE, "--max-memory", "386M"),
    "visible": (
        "visible",
        "--turbine",
        "84060,445880,0",
        "--on-surface",
        "--hub-height",
        60,
        "--rotor",
        40,
        "--samples",
        8,
    ),
    "shadow on cells": ("shadow", *SUN, "--cell", 5),
}


@pytest.mark.parametrize("job", JOBS)
def test_every_job_with_a_raster_writes_it(cli, tmp_path, job):
    dem = write_hills(tmp_path / "dem.tif")
    command, *words = JOBS[job]
    for name in "a.tif", "a.cog.tif":
        done = cli(command, dem, *words, "-o", tmp_path / name)
        assert done.code == 0 and ("bands" in job) == ("studied in bands" in done.err), done
    checked(tmp_path / "a.cog.tif", tmp_path / "a.tif")


def test_without_rasterio_it_is_refused_in_one_line(cli, tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "rasterio", None)
    words = ("sun", "procedural:city?triangles=3000", "--latitude", 52, "--longitude", 4.36, *SUN)
    cli(*words, "--sensors", "raster:8", "-o", tmp_path / "a.cog.tif").refused("rasterio", "antumbra[gis]")
    assert not list(tmp_path.glob("a.*"))


def test_sensors_that_form_no_raster_are_refused(tmp_path):
    with pytest.raises(at.InputError, match="holds a raster"):
        result_table.writer_of(tmp_path / "a.cog.tif", "face")
