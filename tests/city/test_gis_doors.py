"""The doors to GDAL and OGR: nothing outside a file's folder is read, and nothing expands beyond the limit."""

import re
import resource
import socket
import sqlite3
import time
from contextlib import suppress

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest

import antumbra as at
import gis_bombs
from antumbra.city.gis.raster_files import SUFFIXES, RasterFile
from antumbra.city.gis.vector_files import STARTS
from antumbra.city.sensors.raster_grid import raster_of_file
from antumbra.city.sensors.sensor_files import read_points
from gis_bombs import source, vrt
from gis_files import buildings, hills, write_buildings, write_raster

MEGABYTES = 400  # that refusing a file may add to the memory of the process


@pytest.fixture
def address(monkeypatch):
    """An address of this machine; the test fails if anybody has connected to it."""
    monkeypatch.setenv("GDAL_HTTP_TIMEOUT", "1")
    monkeypatch.setenv("GDAL_HTTP_MAX_RETRY", "0")
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"127.0.0.1:{server.getsockname()[1]}"
        server.setblocking(False)
        with pytest.raises(BlockingIOError):
            server.accept()


@pytest.fixture
def secret(tmp_path):
    """A raster and a table outside the folder of the scene."""
    (tmp_path / "outside").mkdir()
    write_buildings(tmp_path / "outside" / "s.geojson", buildings())
    return write_raster(tmp_path / "outside" / "s.tif", hills(9, 9))


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "scene").mkdir()
    write_raster(tmp_path / "scene" / "a.tif", hills(9, 9))
    return tmp_path / "scene"


def refusal(path, read=at.load) -> str:
    with pytest.raises(at.InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message and path.name in message and "is the file damaged" not in message
    return message


# --- Rasters that name other files ------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("name", gis_bombs.RASTER_TEXTS)
def test_no_raster_reads_files_outside_its_folder_or_addresses(folder, address, secret, name, suffix):
    path = folder / f"hostile{suffix}"
    path.write_text(gis_bombs.RASTER_TEXTS[name](address, secret))
    refusal(path)
    refusal(path, raster_of_file)


@pytest.mark.parametrize("name", gis_bombs.RASTER_TEXTS)
def test_descriptions_behind_the_first_bytes_of_a_tiff_are_refused(folder, address, secret, name):
    path = folder / "hostile.tif"
    path.write_bytes(b"II*\0" + gis_bombs.RASTER_TEXTS[name](address, secret).encode())
    refusal(path)
    (folder / "of.vrt").write_text(vrt(source("hostile.tif", 1)))
    refusal(folder / "of.vrt")


@pytest.mark.parametrize("name", gis_bombs.RASTER_TEXTS)
def test_the_sources_of_a_vrt_are_checked_like_other_rasters(folder, address, secret, name):
    for suffix in SUFFIXES:
        (folder / f"inner{suffix}").write_text(gis_bombs.RASTER_TEXTS[name](address, secret))
        (folder / "outer.vrt").write_text(vrt(source(f"inner{suffix}", 1)))
        assert f"inner{suffix}" in refusal(folder / "outer.vrt")


@pytest.mark.parametrize("suffix", [".msk", ".ovr", ".aux", ".MSK", ".OVR"])
def test_masks_and_overviews_beside_a_raster_must_be_rasters(folder, address, suffix):
    (folder / f"a.tif{suffix}").write_text(vrt(source(f"/vsicurl/http://{address}/a.tif")))
    assert "remove it" in refusal(folder / "a.tif")
    (folder / "of.vrt").write_text(vrt(source("a.tif", 1)))
    refusal(folder / "of.vrt")


def test_a_file_of_overviews_that_a_raster_names_is_refused(folder, address):
    name = f"/vsicurl/http://{address}/a.tif"
    item = f'<Metadata domain="OVERVIEWS"><MDI key="OVERVIEW_FILE">{name}</MDI></Metadata>'
    (folder / "a.tif.aux.xml").write_text(f"<PAMDataset>{item}</PAMDataset>")
    assert "names a file of overviews" in refusal(folder / "a.tif")
    smaller = source("a.tif", 1).replace(
        "</SimpleSource>", '<DstRect xOff="0" yOff="0" xSize="3" ySize="3"/></SimpleSource>'
    )
    (folder / "of.vrt").write_text(vrt(smaller, 3))
    assert "names a file of overviews" in refusal(folder / "of.vrt")


def test_masks_that_are_rasters_still_count(folder):
    import rasterio

    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(folder / "a.tif", "r+") as file:
        file.write_mask(np.arange(81).reshape(9, 9) != 40)
    assert (folder / "a.tif.msk").exists()
    assert at.load(folder / "a.tif").n_triangles == 2 * 64 - 6


def test_world_files_and_projections_still_count(folder):
    import rasterio

    with rasterio.open(folder / "b.tif", "w", driver="GTiff", height=9, width=9, count=1, dtype="float64") as file:
        file.write(hills(9, 9), 1)
    (folder / "b.tfw").write_text("2\n0\n0\n-2\n100001\n449999\n")
    assert at.load(folder / "b.tif").raster == at.load(folder / "a.tif").raster._replace(crs=None)
    write_raster(folder / "c.asc", hills(9, 9))
    assert at.load(folder / "c.asc").crs == at.load(folder / "a.tif").crs


@pytest.mark.parametrize("form", ["http://{}/crs", "/vsicurl/http://{}/crs", "{}"])
def test_a_crs_is_neither_fetched_nor_read_from_a_file(folder, address, secret, form, capfd):
    """The CRS of a DataArray may come from a file of anybody."""
    import xarray

    (secret.parent / "crs.wkt").write_text("EPSG:28992")
    crs = form.format(secret.parent / "crs.wkt" if form == "{}" else address)
    heights = xarray.DataArray(
        np.zeros((3, 3)), {"y": [3.0, 2.0, 1.0], "x": [1.0, 2.0, 3.0]}, ("y", "x"), attrs={"crs": crs}
    )
    place = (1, 0, 0, 0, -1, 0)
    for read in (
        lambda: at.from_raster(heights), lambda: at.from_raster((np.zeros((3, 3)), place, crs)),
        lambda: at.load(folder / "a.tif", crs=crs), lambda: at.from_raster(folder / "a.tif", crs=crs),
    ):  # fmt: skip
        with pytest.raises(at.InputError, match="is unknown"):
            read()
    assert capfd.readouterr() == ("", "")


# --- Virtual rasters that are read ------------------------------------------------------------------------------------


def heights_of(path) -> np.ndarray:
    return at.load(path).triangles(0.0).vertices


def test_a_vrt_of_tiles_reads_as_the_raster_does(folder):
    heights, place = hills(9, 9), (2.0, 0.0, 100000.0, 0.0, -2.0, 450000.0)
    (folder / "tiles").mkdir()
    sources = ""
    for k, (first, last) in enumerate(((0, 4), (4, 9))):
        where = (*place[:5], place[5] - 2.0 * first)
        write_raster(folder / "tiles" / f"100% {k}.tif", heights[first:last], where)
        size = f'xSize="9" ySize="{last - first}"'
        box = f'<SrcRect xOff="0" yOff="0" {size}/><DstRect xOff="0" yOff="{first}" {size}/>'
        sources += source(f"tiles/100% {k}.tif", 1).replace("</SimpleSource>", f"{box}</SimpleSource>")
    (folder / "tiles.vrt").write_text(vrt(sources))
    assert (heights_of(folder / "tiles.vrt") == heights_of(folder / "a.tif")).all()
    (folder / "nested.vrt").write_text(vrt(source("tiles.vrt", 1)))
    assert (heights_of(folder / "nested.vrt") == heights_of(folder / "a.tif")).all()


def test_an_absolute_path_in_the_folder_of_a_vrt_is_read(folder):
    (folder / "b.vrt").write_text(vrt(source(folder / "a.tif")))
    assert (heights_of(folder / "b.vrt") == heights_of(folder / "a.tif")).all()


def test_scales_offsets_holes_and_units_of_a_vrt_count(folder):
    band = "<NoDataValue>4</NoDataValue><UnitType>ft</UnitType><Scale>2</Scale><Offset>1</Offset>"
    (folder / "b.vrt").write_text(vrt(band + source("a.tif", 1, "ComplexSource")))
    with RasterFile(folder / "b.vrt").open() as file:
        assert (file.nodata, file.units, file.scales, file.offsets) == (4.0, ("ft",), (2.0,), (1.0,))
        assert (file.read(1) == hills(9, 9)).all()


@pytest.mark.parametrize("element", ["PansharpeningOptions", "ProcessingSteps", "VRTRasterBandX", "x"])
def test_unknown_elements_of_a_vrt_are_named(folder, element):
    (folder / "b.vrt").write_text(vrt(f"<{element}/>" + source("a.tif", 1)))
    assert f"<{element}>, which is not read; convert it to GeoTIFF with gdal_translate" in refusal(folder / "b.vrt")


# --- Vector files -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", STARTS)
@pytest.mark.parametrize("name", gis_bombs.VECTOR_TEXTS)
def test_no_vector_file_reads_other_files_or_addresses(folder, address, secret, name, suffix):
    text = gis_bombs.VECTOR_TEXTS[name](address, secret.with_name("s.geojson"))
    starts = {".gpkg": b"SQLite format 3\0", ".shp": b"\0\0\x27\x0a", ".fgb": b"fgb\x03fgb\0", ".geojson": b'{"a":"'}
    for start in (b"", starts.get(suffix, b"PAR1")):
        (folder / f"a{suffix}").write_bytes(start + text.encode())
        refusal(folder / f"a{suffix}")
        refusal(folder / f"a{suffix}", lambda path: at.points_along(path, 1.0))
        refusal(folder / f"a{suffix}", at.from_footprints)


@pytest.mark.parametrize("name", gis_bombs.crs_links(""))
def test_the_crs_of_geojson_is_not_fetched(folder, address, name):
    (folder / "a.geojson").write_text(gis_bombs.crs_links(address)[name])
    assert 'its "crs" is no name' in refusal(folder / "a.geojson")


@pytest.mark.parametrize(
    "crs",
    [
        {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::28992"}},
        {"type": "name", "properties": {"name": "http://www.opengis.net/def/crs/EPSG/0/28992"}},
        {"type": "EPSG", "properties": {"code": 28992}},
    ],
)
def test_the_crs_of_geojson_may_be_a_name(folder, address, crs):
    (folder / "a.geojson").write_text(gis_bombs.geojson(crs, note="crs", links=[{"href": f"http://{address}/next"}]))
    assert at.load(folder / "a.geojson").crs == "EPSG:28992"


@pytest.mark.parametrize("call", ["ogr_geocode('x', 'geometry', 'SERVICE=OSM_NOMINATIM', 'QUERY_TEMPLATE=http://{}/%s')",
                                  "ogr_datasource_load_layers('/vsicurl/http://{}/s.gpkg')"])  # fmt: skip
def test_views_in_a_geopackage_call_no_functions_of_ogr(folder, address, call):
    write_buildings(folder / "a.gpkg", buildings())
    with sqlite3.connect(folder / "a.gpkg") as database:
        table = database.execute("select table_name from gpkg_contents").fetchone()[0]
        database.execute(f'create view v as select fid, geom, {call.format(address)} as height from "{table}"')
        database.execute("insert into gpkg_contents(table_name, data_type) values('v', 'attributes')")
    refusal(folder / "a.gpkg", lambda path: at.from_footprints(path, layer="v"))


# --- Files that expand ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", gis_bombs.EXPANDING)
def test_files_that_expand_are_refused_before_they_do(tmp_path, name):
    path = gis_bombs.EXPANDING[name](tmp_path)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    refusal(path)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEGABYTES << 10  # kB


# --- ASCII grids ------------------------------------------------------------------------------------------------------


HEAD = "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n"
GRASS = "north: 2\nsouth: 0\neast: 3\nwest: 0\nrows: 2\ncols: 3\n"


@pytest.mark.parametrize("head", [HEAD, GRASS])
@pytest.mark.parametrize(
    "cells, words",
    [
        ("1 2 x\n4 5 6\n", "'x' in its cells is not a number"),
        ("1 2 3\n4 5 6m\n", "'6m' in its cells is not a number"),
        ("1 2 1-2\n4 5 6\n", "'1-2' in its cells is not a number"),
        ("1 2 3\n4 5\n", "has 5 cells"),
        ("1 2 3\n4 5 6\n7 8 9\n", "has 9 cells"),
        ("", "has 0 cells"),
    ],
)
def test_cells_of_an_ascii_grid_are_numbers_and_complete(tmp_path, head, cells, words):
    path = tmp_path / "a.asc"
    path.write_text(head + cells)
    assert words in refusal(path)
    (tmp_path / "b.vrt").write_text(vrt(source("a.asc", 1), 3))
    assert re.search(words, refusal(tmp_path / "b.vrt"))


@pytest.mark.parametrize("head", [HEAD, HEAD.upper(), HEAD + "NODATA_value -9999\n", GRASS, HEAD.replace("\n", "\r\n")])
@pytest.mark.parametrize(
    "cells", ["1 2 3\n4 5 6\n", "1\n2\n3\n4\n5\n6", " 1.0  2e0 +3\n4. 5 6.\n\n", "1,0 2 3\n4 5 6\n"]
)
def test_ascii_grids_in_their_usual_spellings_are_read(tmp_path, head, cells):
    path = tmp_path / "a.asc"
    path.write_bytes((head + cells).encode())
    assert at.load(path).triangles(0.0).vertices[..., 2].max() == 2.5  # recentred


def test_a_grid_that_is_changed_is_checked_again(tmp_path):
    path = tmp_path / "a.asc"
    path.write_text(f"{HEAD}1 2 3\n4 5 6\n")
    at.load(path)
    time.sleep(0.01)
    path.write_text(f"{HEAD}1 2 3\n4 5 x\n")
    assert "is not a number" in refusal(path)


def test_damaged_metadata_of_parquet_do_not_end_the_process(tmp_path):
    """Arrow aborts where statistics of a column do not fit its type, if it is asked for them."""
    columns = {name: np.arange(50, dtype=float) for name in "xyz"} | {"name": [f"a{k % 3}" for k in range(50)]}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    whole, read = (tmp_path / "a.parquet").read_bytes(), 0
    first, random = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little"), np.random.default_rng(0)
    for place in range(first, len(whole) - 8):
        damaged = bytearray(whole)
        damaged[place] = random.choice([0, 1, 2, 127, 255])
        (tmp_path / "b.parquet").write_bytes(damaged)
        with suppress(at.InputError):
            read += len(read_points(tmp_path / "b.parquet")) == 50
    assert 10 < read < len(whole) - first - 10
