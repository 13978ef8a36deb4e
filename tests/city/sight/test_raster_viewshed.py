"""Viewsheds of raster files in bands: the GeoTIFF of the study in one piece, bit for bit; and what does not fit."""

import json

import numpy as np
import pytest

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
    banded = cli(*asked, "-o", "banded.tif", "--max-memory", "390M")
    small = cli(*asked, "-o", "small.tif", "--max-memory", "381.9M").json()  # the heights in a scratch file
    assert "studied in bands" in banded.err
    values, place, about = read("whole.tif")
    assert 0.01 < (values[0] > 0.0).mean() < 0.9
    for name, told in ("banded.tif", banded.json()), ("small.tif", small):
        found = read(name)
        assert np.array_equal(found[0], values, equal_nan=True) and found[1:] == (place, about)
        for key in "sensors", "observers", "seen", "area", "area_seen", "up":
            assert told[key] == whole[key], key


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
    low = "--observer", "84060,445880,-50", "--max-memory", "390M", "--quiet", "-o", "a.tif"
    cli("viewshed", dem, *low).refused("not above the surface", "--eye-height")
    assert not (tmp_path / "a.tif").exists()
