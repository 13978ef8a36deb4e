"""Rasters at URLs: the scenes of local files, read by window; and nothing that a file names or that lies beside it."""

import numpy as np
import pytest

import antumbra as at
import gis_bombs
from gis_files import CRS, PLACE, hills, write_raster
from range_server import serving

HEIGHTS = hills(30, 40)


@pytest.fixture
def server(tmp_path, monkeypatch):
    (tmp_path / "web").mkdir()
    with serving(tmp_path / "web", monkeypatch) as found:
        yield found


def same(a, b):
    assert a.raster == b.raster and a.crs == b.crs and (a.triangles().vertices == b.triangles().vertices).all()


READERS = {
    "load": at.load,
    "from_raster": at.from_raster,
    "terrain": lambda raster: at.from_raster((HEIGHTS + 9.0, PLACE, CRS), ground=raster),
}


@pytest.mark.parametrize("reader", READERS)
def test_a_raster_at_a_url_is_that_of_the_file(server, reader):
    path = write_raster(server.folder / "a.tif", HEIGHTS)
    same(READERS[reader](f"{server.url}/a.tif"), READERS[reader](path))
    assert server.paths() == {"/a.tif"} and server.sent > 0


def test_a_raster_that_changes_at_its_url_is_read_anew(server):
    """GDAL would keep what it has read, and that a file is missing, until the process ends."""
    with pytest.raises(at.InputError, match="404"):
        at.load(f"{server.url}/a.tif")
    for heights in (HEIGHTS, HEIGHTS + 9.0, hills(20, 30)):
        path = write_raster(server.folder / "a.tif", heights)
        same(at.load(f"{server.url}/a.tif"), at.load(path))


def test_object_storage_is_read_with_the_settings_of_the_environment(server, monkeypatch):
    (server.folder / "bucket" / "d").mkdir(parents=True)
    path = write_raster(server.folder / "bucket" / "d" / "a.tif", HEIGHTS)
    endpoint = {"AWS_S3_ENDPOINT": server.url.removeprefix("http://"), "AWS_HTTPS": "NO"}
    for name, value in {**endpoint, "AWS_VIRTUAL_HOSTING": "FALSE", "AWS_NO_SIGN_REQUEST": "YES"}.items():
        monkeypatch.setenv(name, value)
    same(at.load("s3://bucket/d/a.tif"), at.load(path))
    assert server.paths() == {"/bucket/d/a.tif"}


def test_bounds_of_a_tiled_raster_need_a_small_share_of_its_bytes(server):
    rng = np.random.default_rng(1)
    heights = rng.random((1024, 1024)).astype(np.float32)
    tiled = {"tiled": True, "blockxsize": 128, "blockysize": 128}
    import rasterio

    shape = {"height": 1024, "width": 1024, "count": 1, "dtype": "float32", "crs": CRS}
    with rasterio.open(
        server.folder / "a.tif", "w", driver="GTiff", transform=rasterio.Affine(*PLACE), **shape, **tiled
    ) as file:
        file.write(heights, 1)
    bounds = (100801.0, 449001.0, 101001.0, 449101.0)  # columns 400 to 500, rows 449 to 499
    part = at.from_raster(f"{server.url}/a.tif", clip=bounds)
    same(part, at.from_raster(server.folder / "a.tif", clip=bounds))
    assert part.bounds[:, :2].tolist() == [[100801.0, 449001.0], [101001.0, 449101.0]]
    assert 0 < server.sent < heights.nbytes / 8


def test_commands_read_rasters_at_urls(cli, server, tmp_path):
    write_raster(server.folder / "a.tif", HEIGHTS)
    local, remote = server.folder / "a.tif", f"{server.url}/a.tif"
    eye = "--observer", "100030,449970,0", "--on-surface", "--eye-height", "3", "--quiet"
    for scene, name in (local, "local"), (remote, "remote"):
        part = f"{scene}?clip=100011,449961,100051,449991"
        for words in (
            ("viewshed", scene, *eye, "-o", f"{name}.tif"),
            ("viewshed", part, *eye, "-o", f"part-{name}.csv"),
            ("viewshed", local, *eye, "--sensors", f"raster:{scene}+1", "-o", f"cells-{name}.csv"),
            ("build", scene, "-o", f"{name}.antumbra", "--quiet"),
        ):
            outcome = cli(*words)
            assert outcome.code == 0, outcome.err
    for kind in "{}.tif", "part-{}.csv", "cells-{}.csv", "{}.antumbra":
        found, expected = ((tmp_path / kind.format(name)).read_bytes() for name in ("remote", "local"))
        assert found == expected and len(found) > 1000, kind


@pytest.mark.parametrize("suffix", [".ovr", ".msk", ".aux", ".aux.xml"])
@pytest.mark.parametrize("name", gis_bombs.RASTER_TEXTS)
def test_nothing_beside_a_raster_at_a_url_is_opened(server, tmp_path, name, suffix):
    write_raster(server.folder / "a.tif", HEIGHTS)
    address = server.url.removeprefix("http://")
    for beside in f"a.tif{suffix}", f"a{suffix}":
        (server.folder / beside).write_text(gis_bombs.RASTER_TEXTS[name](f"{address}/secret", tmp_path / "secret.tif"))
    same(at.load(f"{server.url}/a.tif"), at.from_raster((HEIGHTS, PLACE, CRS)))
    assert server.paths() == {"/a.tif"}


@pytest.mark.parametrize("name", gis_bombs.RASTER_TEXTS)
def test_a_description_at_a_url_is_no_raster(server, tmp_path, name):
    text = gis_bombs.RASTER_TEXTS[name](f"{server.url.removeprefix('http://')}/secret", tmp_path / "secret.tif")
    for k, start in enumerate((b"", b"II*\0")):
        (server.folder / f"{k}.tif").write_bytes(start + text.encode())
        with pytest.raises(at.InputError, match=rf"{k}\.tif: cannot be read from {server.url} .*download the file"):
            at.load(f"{server.url}/{k}.tif")
    assert server.paths() == {"/0.tif", "/1.tif"}


def test_a_raster_at_a_url_that_names_overviews_is_refused(server):
    import rasterio

    write_raster(server.folder / "a.tif", HEIGHTS)
    with rasterio.open(server.folder / "a.tif", "r+") as file:
        file.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=f"/vsicurl/{server.url}/secret.tif")
    for path in f"{server.url}/a.tif", server.folder / "a.tif":
        with pytest.raises(at.InputError, match="names a file of overviews"):
            at.load(path)
    assert server.paths() == {"/a.tif"}


def test_a_file_that_names_a_raster_at_a_url_does_not_open_it(server, tmp_path):
    write_raster(server.folder / "a.tif", HEIGHTS)
    for k, text in enumerate((f"{server.url}/a.tif", f"/vsicurl/{server.url}/a.tif", "/vsis3/bucket/a.tif")):
        for relative in 0, 1:
            path = tmp_path / f"{k}{relative}.vrt"
            path.write_text(gis_bombs.vrt(gis_bombs.source(text, relative)))
            with pytest.raises(at.InputError):
                at.load(path)
    assert not server.requests


@pytest.mark.parametrize("suffix", [".vrt", ".asc"])
def test_rasters_that_are_read_whole_are_refused_by_url_with_the_command_that_downloads_them(server, suffix):
    write_raster(server.folder / f"a{suffix}", HEIGHTS, crs=None if suffix == ".asc" else CRS)
    with pytest.raises(at.InputError, match=rf"download it first: curl -LO {server.url}/a{suffix}"):
        at.load(f"{server.url}/a{suffix}")
    assert not server.requests


def test_a_missing_raster_at_a_url_is_one_line_with_the_remedy(server):
    with pytest.raises(at.InputError, match=rf"no\.tif: cannot be read from {server.url} \(.*check the URL") as caught:
        at.load(f"{server.url}/no.tif")
    assert "\n" not in str(caught.value)


# --- Bounds -----------------------------------------------------------------------------------------------------------


BOUNDS = (100010.5, 449961.0, 100031.0, 449990.5)  # between the centres of columns 4 and 5, at that of 15; rows 4 to 19
ROWS, COLUMNS = slice(4, 20), slice(4, 16)
PART = (2.0, 0.0, 100008.0, 0.0, -2.0, 449992.0)


def forms(folder):
    import xarray

    south_up = (2.0, 0.0, 100000.0, 0.0, 2.0, 450000.0 - 60.0)
    x, y = 100001.0 + 2.0 * np.arange(40), 449999.0 - 2.0 * np.arange(30)
    array = xarray.DataArray(HEIGHTS, {"y": y, "x": x}, ("y", "x"))
    return {
        "file": write_raster(folder / "a.tif", HEIGHTS),
        "virtual raster": write_raster(folder / "a.vrt", HEIGHTS),
        "file, south up": write_raster(folder / "b.tif", HEIGHTS[::-1], south_up),
        "array": (HEIGHTS, PLACE, CRS),
        "array, south up": (HEIGHTS[::-1], south_up, CRS),
        "DataArray": array,
        "DataArray, south up": array[::-1, ::-1],
        "DataArray, x first": array.T,
    }


FORMS = (
    *("file", "virtual raster", "file, south up", "array", "array, south up"),
    *("DataArray", "DataArray, south up", "DataArray, x first"),
)


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("band", [256, 7])
def test_bounds_choose_the_vertices_whose_surface_covers_them(tmp_path, monkeypatch, form, band):
    monkeypatch.setattr("antumbra.city.gis.height_files._BAND", band)
    rasters = forms(tmp_path)
    assert (*rasters,) == FORMS
    scene = at.from_raster(rasters[form], clip=BOUNDS, crs=CRS)
    same(scene, at.from_raster((HEIGHTS[ROWS, COLUMNS], PART, CRS)))


def test_bounds_beyond_a_raster_are_cut_and_beside_it_refused(tmp_path):
    path = write_raster(tmp_path / "a.tif", HEIGHTS)
    same(at.from_raster(path, clip=(0.0, 0.0, 1e6, 1e6)), at.load(path))
    for bounds in (0.0, 0.0, 9.0, 9.0), (100200.0, 449961.0, 100300.0, 449990.0), (100000.0, 450001.0, 100080.0, 5e5):
        with pytest.raises(
            at.InputError, match=r"a\.tif: clip lies beside its cells, which extend over 100001,449941,"
        ):
            at.from_raster(path, clip=bounds)
    for bounds in (9.0, 0.0, 0.0, 9.0), (0.0, 0.0, 9.0), "here", (0.0, np.nan, 9.0, 9.0):
        with pytest.raises(at.InputError, match="clip"):
            at.from_raster(path, clip=bounds)


def test_a_part_is_read_of_a_raster_with_too_many_cells(tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.city.gis.height_files._MOST_CELLS", 1000)
    path = write_raster(tmp_path / "a.tif", HEIGHTS)
    with pytest.raises(at.InputError, match=r"a\.tif: has 1\.2e\+03 cells, more than 1e\+03; read a part: clip="):
        at.load(path)
    assert at.from_raster(path, clip=BOUNDS).raster.n_cells == 16 * 12
