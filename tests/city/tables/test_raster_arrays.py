"""Zarr: the values of GeoTIFFs, with the metadata that xarray, rioxarray and GDAL read; written by block, and whole."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables import raster_arrays, result_table
from city.tables.test_table_blocks import PLACE, in_blocks, town
from gis_files import hills, write_raster

zarr = pytest.importorskip("zarr")
xarray = pytest.importorskip("xarray")
rasterio = pytest.importorskip("rasterio")


def same_rasters(tif, store):
    """Check that a Zarr store has the bands of a GeoTIFF, and the same place; return it."""
    found = xarray.open_zarr(store)
    with rasterio.open(tif) as file:
        assert set(found.data_vars) == set(file.descriptions) and list(found.coords) == ["spatial_ref", "x", "y"]
        for band, name, unit in zip(file.read(), file.descriptions, file.units):
            assert np.array_equal(found[name].values, band, equal_nan=True), name
            assert found[name].attrs["units"] == unit and found[name].dims == ("y", "x")
        assert json.loads(found.attrs["antumbra"]) == json.loads(file.tags()["antumbra"])
        x, y = (file.transform * (np.arange(n) + 0.5, np.arange(n) + 0.5) for n in (file.width, file.height))
        assert np.allclose(found.x, x[0], rtol=0, atol=1e-9) and np.allclose(found.y, y[1], rtol=0, atol=1e-9)
        return found, file.crs, file.transform


@pytest.mark.parametrize("size", [190, 1 << 20])
def test_a_zarr_store_has_the_bands_of_a_geotiff(monkeypatch, tmp_path, size):
    monkeypatch.setattr(result_table, "_TILE", 16)
    monkeypatch.setattr(raster_arrays, "_CHUNK", (16, 24))
    blocks = in_blocks(monkeypatch, size)
    for name in "a.tif", "a.zarr":
        blocks.save(tmp_path / name)
    pytest.importorskip("rioxarray")
    found, crs, transform = same_rasters(tmp_path / "a.tif", tmp_path / "a.zarr")
    assert len(np.unique(found.sun_hours)) > 5 and np.isnan(found.sun_hours).any()
    assert found.sun_hours.rio.crs == crs and found.rio.transform() == transform
    assert found.sun_hours.encoding["chunks"] == (16, 24)


def test_gdal_opens_the_store(tmp_path):
    if "Zarr" not in rasterio.drivers.raster_driver_extensions().values():
        with rasterio.Env() as env:
            if "Zarr" not in env.drivers():
                pytest.skip("this GDAL has no driver of Zarr: NOT checked")
    table = at.sun_hours(town(), "raster:0.5", "2026-03-21", place=PLACE, step=120)
    table.save(tmp_path / "a.zarr")
    with rasterio.open(f'ZARR:"{tmp_path / "a.zarr"}":/sun_hours') as file:
        expected = table.to_xarray().sun_hours.values
        assert np.array_equal(file.read(1), expected, equal_nan=True) and file.transform.a == 0.5


def test_a_store_is_replaced_whole_and_other_folders_are_kept(tmp_path, monkeypatch):
    table = at.sun_hours(town(), "raster:1", "2026-03-21", place=PLACE, step=240)
    table.save(tmp_path / "a.zarr")
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "a.zarr").rglob("*")}

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(zarr, "consolidate_metadata", stop)
        with pytest.raises(KeyboardInterrupt):
            table.save(tmp_path / "a.zarr")
    assert {path.name: path.stat().st_mtime_ns for path in (tmp_path / "a.zarr").rglob("*")} == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.zarr"]
    (tmp_path / "a.zarr" / "stale").write_text("x")
    table.save(tmp_path / "a.zarr")
    assert not (tmp_path / "a.zarr" / "stale").exists() and [p.name for p in tmp_path.iterdir()] == ["a.zarr"]
    (tmp_path / "b.zarr").mkdir()
    (tmp_path / "b.zarr" / "mine").write_text("x")
    with pytest.raises(at.InputError, match=r"b\.zarr: is a folder"):
        table.save(tmp_path / "b.zarr")
    assert (tmp_path / "b.zarr" / "mine").exists()


def test_only_rasters_are_written_as_zarr(tmp_path):
    table = at.sun_hours(town(), "grid:3", "2026-03-21", place=PLACE, step=240)
    with pytest.raises(at.InputError, match=r"a\.zarr: Zarr holds a raster, and the sensors are of kind 'grid'"):
        table.save(tmp_path / "a.zarr")
    assert not (tmp_path / "a.zarr").exists()


@pytest.mark.parametrize("memory", [(), ("--max-memory", "390M")])
def test_commands_write_zarr_in_one_piece_and_in_bands(cli, tmp_path, memory):
    dem = write_raster(tmp_path / "dem.tif", hills(300, 290))
    eye = "--observer", "100030,449970,0", "--on-surface", "--eye-height", "9", "--quiet"
    assert cli("viewshed", dem, *eye, "-o", "a.tif").code == 0
    assert cli("viewshed", dem, *eye, "-o", "a.zarr", *memory).code == 0
    found, *_ = same_rasters(tmp_path / "a.tif", tmp_path / "a.zarr")
    assert 0.0 < float((found.seen > 0).mean()) < 0.9


def test_shadows_on_cells_are_written_as_zarr_and_outlines_are_not(cli, tmp_path):
    noon = (
        "procedural:city?triangles=3000",
        "--latitude",
        52,
        "--longitude",
        4.36,
        "--at",
        "2026-03-21T12:00",
        "--quiet",
    )
    assert cli("shadow", *noon, "--cell", 8, "-o", "a.tif", "-o", "a.zarr").code == 0
    found, *_ = same_rasters(tmp_path / "a.tif", tmp_path / "a.zarr")
    assert any(len(np.unique(found[name])) > 1 for name in found.data_vars)
    cli("shadow", *noon, "-o", "b.zarr").refused("b.zarr: a raster needs cells")
