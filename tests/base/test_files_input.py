"""Input files: what is not a local file is refused with the command that makes one of it."""

from pathlib import Path

import pytest

import antumbra as at
from antumbra.base.files import checked_file

CURES = {
    "https://example.org/d/a.tif": "download it first: curl -LO https://example.org/d/a.tif",
    "HTTP://example.org/a.tif": "download it first: curl -LO http://example.org/a.tif",
    "/vsicurl/https://example.org/d/a.tif": "download it first: curl -LO https://example.org/d/a.tif",
    "/vsizip//vsicurl/https://example.org/a.zip/d/a.tif": "download it first: curl -LO https://example.org/a.zip",
    "s3://bucket/d/a.tif": "download it first: aws s3 cp s3://bucket/d/a.tif .",
    "/vsis3/bucket/d/a.tif": "download it first: aws s3 cp s3://bucket/d/a.tif .",
    "gs://bucket/a.tif": "download it first: gcloud storage cp gs://bucket/a.tif .",
    "/vsizip/a.zip/a.tif": "download or unpack it first, and give the path of the file itself",
    "file:///data/a.tif": "download or unpack it first, and give the path of the file itself",
}


@pytest.mark.parametrize("text", CURES)
def test_a_url_or_a_virtual_path_is_refused_with_the_command_that_downloads_it(text):
    with pytest.raises(at.InputError) as refused:
        checked_file(Path(text), "a.tif")
    assert str(refused.value) == f"a.tif: is not a local file; {CURES[text]}"


@pytest.mark.parametrize("text", ["a.tif", "data/https/a.tif", "C:/a.tif", "vsizip/a.tif"])
def test_a_missing_local_file_is_no_url(text):
    with pytest.raises(at.InputError, match=r"a\.tif: no such file; check the path"):
        checked_file(Path(text), "a.tif")


@pytest.mark.parametrize("option", ["units=m", "up=z", "=", ""])
def test_a_file_with_an_unknown_option_is_told_from_a_missing_file(tmp_path, option):
    (tmp_path / "a.obj").write_text("v 0 0 0")
    with pytest.raises(at.InputError, match=r"a\.obj has no such option; antumbra formats lists the options of files"):
        checked_file(tmp_path / f"a.obj?{option}", f"a.obj?{option}")
    for missing in (f"b.obj?{option}", f"?{option}"):
        with pytest.raises(at.InputError, match="no such file; check the path"):
            checked_file(tmp_path / missing, missing)


URL = "https://example.org/a"
READERS = {
    "scene": lambda room: at.load(f"{URL}.glb"),
    "frames": lambda room: at.load(URL),
    "virtual raster": lambda room: at.from_raster(f"{URL}.vrt"),
    "footprints": lambda room: at.from_footprints(f"{URL}.gpkg"),
    "terrain": lambda room: at.from_footprints(__file__, terrain=f"{URL}.asc"),
    "trees": lambda room: at.from_trees(f"{URL}.gpkg", height=3, radius=1),
    "areas": lambda room: at.area_sensors(room, f"{URL}.geojson"),
    "lines": lambda room: at.points_along(f"{URL}.gpkg", 1.0),
    "cells": lambda room: at.raster_sensors(room, f"{URL}.vrt"),
    "points": lambda room: at.sensors_of(f"{URL}.csv", room),
    "weather": lambda room: at.sun_hours(room, "face", epw=f"{URL}.epw"),
    "sky": lambda room: at.Sky(f"{URL}.hdr"),
}


@pytest.mark.parametrize("reader", READERS)
def test_other_readers_than_those_of_geotiffs_and_stores_open_no_url(reader):
    room = at.Scene.from_arrays([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], up="z")
    with pytest.raises(at.InputError, match=r"is not a local file; download it first: curl -LO https://example.org/a"):
        READERS[reader](room)
