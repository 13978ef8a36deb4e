"""Viewsheds of raster files in bands: the GeoTIFF of the study in one piece, bit for bit; and what does not fit."""

import json

import numpy as np
import pytest

import antumbra as at
from antumbra.city.gis.gis_data import height_file
from antumbra.city.gis.height_grounds import height_ground
from antumbra.trace.terrain.terrain_rays import terrain_tree
from antumbra.trace.terrain.terrain_views import ground_of

rasterio = pytest.importorskip("rasterio")

EYE = "--observer", "84060,445880,0", "--observer", "84250,445700,0", "--on-surface", "--eye-height", "2.5"


def write_hills(path, dtype="float32", holes=40, shape=(330, 290)):
    random = np.random.default_rng(holes)
    y, x = np.mgrid[: shape[0], : shape[1]]
    heights = 30.0 * np.sin(x / 13.0) * np.cos(y / 9.0) + random.normal(size=shape) + 100.0
    heights[random.integers(0, shape[0], holes), random.integers(0, shape[1], holes)] = -9999.0
    heights[: 20 if holes else 0, :35] = -9999.0
    heights[5:8, 5] = 90.0 if holes else heights[5:8, 5]  # without a triangle
    place = rasterio.transform.from_origin(84000.0, 446000.0, 1.0, 1.0)
    options = {"width": shape[1], "height": shape[0], "count": 1, "crs": "EPSG:28992", "nodata": -9999.0}
    with rasterio.open(path, "w", driver="GTiff", dtype=dtype, transform=place, **options) as file:
        file.write(heights.astype(dtype), 1)
    return path


def read(path):
    with rasterio.open(path) as file:
        return (
            file.read(),
            (file.transform, file.crs, file.descriptions, file.units),
            json.loads(file.tags()["antumbra"]),
        )


@pytest.mark.parametrize("dtype", ["float32", "float64", "int16"])
@pytest.mark.parametrize("more", [(), ("--sensors", "raster+1.5"), ("--max-distance", "150", "--azimuth", "300:100")])
def test_bands_equal_the_study_in_one_piece(cli, tmp_path, dtype, more):
    dem = write_hills(tmp_path / "dem.tif", dtype, holes=0 if dtype == "int16" else 40)
    asked = "viewshed", dem, *EYE, *more, "--json"
    whole = cli(*asked, "-o", "whole.tif").json()
    banded = cli(*asked, "-o", "banded.tif", "--max-memory", "386M")
    small = cli(*asked, "-o", "small.tif", "--max-memory", "381.9M").json()  # the heights in a scratch file
    assert "studied in bands" in banded.err
    values, place, about = read("whole.tif")
    assert 0.01 < (values[0] > 0.0).mean() < 0.9
    for name, told in ("banded.tif", banded.json()), ("small.tif", small):
        found = read(name)
        assert np.array_equal(found[0], values, equal_nan=True) and found[1:] == (place, about)
        for key in "sensors", "observers", "seen", "area", "area_seen", "up":
            assert told[key] == whole[key], key


@pytest.mark.parametrize("more", [("--curvature",), ("-o", "b.csv"), ("--each",), ("--shard", "0/2")])
def test_a_study_that_fits_by_block_needs_no_bands(cli, tmp_path, more):
    dem = write_hills(tmp_path / "dem.tif")
    done = cli("viewshed", dem, *EYE, *more, "-o", "a.tif", "--max-memory", "392M")  # less than with a table in memory
    assert done.code == 0 and "bands" not in done.err
    assert (tmp_path / ("a.shards" if "--shard" in more else "a.tif")).exists()
    cli("viewshed", dem, *EYE, "--least-height", "-o", "c.tif", "--max-memory", "392M").refused("--least-height")


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("-o", "a.csv"), ["take about", "-o FILE.tif"]),
        (("-o", "a.tif", "--curvature"), ["take about", "--curvature", "gdal_translate"]),
        (("-o", "a.tif", "--each"), ["--each"]),
        (("-o", "a.tif", "--max-memory", "1M"), ["observers takes about", "--max-memory"]),
        (("-o", "a.tif", "--max-memory", "much"), ["--max-memory"]),
        (("-o", "a.tif", "--shard", "0/2"), ["leave out --shard"]),
    ],
)
def test_what_does_not_fit_is_refused_with_the_remedy(cli, tmp_path, arguments, words):
    dem = write_hills(tmp_path / "dem.tif", shape=(1500, 1500))
    memory = () if "--max-memory" in arguments else ("--max-memory", "420M")
    cli("viewshed", dem, *EYE, *arguments, *memory, "--quiet").refused(*words)
    assert not (tmp_path / "a.tif").exists()


def test_an_eye_in_the_ground_is_refused(cli, tmp_path):
    dem = write_hills(tmp_path / "dem.tif")
    low = "--observer", "84060,445880,-50", "--max-memory", "386M", "--quiet", "-o", "a.tif"
    cli("viewshed", dem, *low).refused("not above the surface", "--eye-height")
    assert not (tmp_path / "a.tif").exists()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
@pytest.mark.parametrize("bare", [-300.0, 4000.0])
def test_a_last_row_without_triangles_counts_neither_for_the_frame_nor_as_cells(tmp_path, dtype, bare):
    """It is a band of its own, has all its heights, and the row before has none."""
    path, heights = tmp_path / "a.tif", np.random.default_rng(0).normal(size=(257, 40)) * 9.0
    heights[255], heights[256] = np.nan, bare
    place = rasterio.transform.from_origin(84000.0, 446000.0, 1.0, 1.0)
    options = {"width": 40, "height": 257, "count": 1, "crs": "EPSG:28992", "dtype": dtype, "transform": place}
    with rasterio.open(path, "w", driver="GTiff", **options) as file:
        file.write(heights.astype(dtype), 1)
    scene = at.from_raster(path)
    with height_ground(height_file(path, {}), None, lambda done, total: None) as ground:
        assert (ground.bounds == scene.bounds).all() and (ground.origin == scene.origin).all()
        anew = ground_of(ground.ground.x, ground.ground.y, ground.ground.z)
        assert np.isnan(ground.ground.z[255:]).all() and not np.isnan(ground.ground.z[:255]).any()
        assert ground.ground.reach == anew.reach
        for one, other in zip(ground.ground.blocks, anew.blocks):
            assert np.array_equal(one, other)


@pytest.mark.parametrize("origin", [0.0, 2.0**-60])
def test_heights_next_to_the_origin_are_those_of_the_scene(tmp_path, origin):
    """Heights about 0, some of which are so small that the frame sets them to 0."""
    path, heights = tmp_path / "a.tif", np.full((40, 30), origin, np.float32)
    heights[::2, ::3], heights[1::2, 1::3], heights[5, 5], heights[6, 6] = 1e-36, -1e-36, 2.0, -2.0
    place = rasterio.transform.from_origin(84000.0, 446000.0, 1.0, 1.0)
    options = {"width": 30, "height": 40, "count": 1, "crs": "EPSG:28992", "dtype": "float32", "transform": place}
    with rasterio.open(path, "w", driver="GTiff", **options) as file:
        file.write(heights, 1)
    with height_ground(height_file(path, {}), None, lambda done, total: None) as ground:
        scene = at.from_raster(path)
        assert np.array_equal(ground.ground.z, terrain_tree(scene.data.terrain, scene.origin).z)
        assert (np.abs(ground.ground.z) == 0.0).any() == (scene.origin[2] == 0.0)
