"""A disk that fills up while a file is written: one line that says so, and nothing is left."""

import os

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.result_table import WRITERS
from antumbra.formats.format_registry import SCENE_WRITERS, write_scene
from antumbra.generate.procedural_scenes import generate
from antumbra.picture.image_files import save_png, write_film
from small_disk import small_disk

RNG = np.random.default_rng(0)
ROOM = 96 << 10  # bytes: enough for the check before the work, and for no file


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=1000)


def refused(folder, path, write):
    with pytest.raises(at.InputError) as caught:
        write(path)
    line = str(caught.value)
    full = "o space left on device", " MB left; free some, or choose"  # found while writing, or before
    assert str(path) in line and any(words in line for words in full) and "\n" not in line
    assert not os.listdir(folder)


@pytest.fixture(scope="module")
def disk(tmp_path_factory):
    with small_disk(tmp_path_factory.mktemp("full") / "disk", ROOM) as folder:
        yield folder


@pytest.mark.parametrize("suffix", [*WRITERS, ".cog.tif"])
def test_tables(disk, scene, suffix):
    sensors = at.raster_sensors(scene, 0.15) if suffix != ".glb" else at.grid_sensors(scene, 0.25)
    table = at.Table(sensors, {"noise": at.Column(RNG.random(len(sensors)), "", "noise")}, {}, scene)
    assert len(table) > 10_000 // (1 + 9 * (suffix == ".glb"))
    refused(disk, disk / f"a{suffix}", table.save)


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_pictures(disk, scene, suffix):
    frame = at.render(scene, scene.cameras[0].resized(256, 256), at.PointLight((0, 2, 0)), spp=1)
    frame = frame._replace(image=RNG.random(frame.image.shape, np.float32))
    refused(disk, disk / f"a{suffix}", frame.save)


@pytest.mark.parametrize("suffix", [".gif", ".mp4", ".webm"])
def test_films(disk, tmp_path, suffix):
    if suffix != ".gif":
        pytest.importorskip("imageio_ffmpeg", reason="films need antumbra[video]: NOT checked")
    pictures = [tmp_path / f"{k}.png" for k in range(3)]
    for picture in pictures:
        save_png(RNG.integers(0, 256, (256, 256, 3), np.uint8), picture)
    with pytest.raises(at.InputError) as caught:
        write_film(pictures, disk / f"a{suffix}", 24.0)
    assert f"a{suffix}" in str(caught.value) and "\n" not in str(caught.value) and not os.listdir(disk)


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_matrices(disk, suffix):
    bits = RNG.integers(0, 1 << 63, (2000, 16), np.uint64)
    matrix = at.VisibilityMatrix(bits, 1024, np.bitwise_count(bits).sum(1, np.int64))
    refused(disk, disk / f"a{suffix}", matrix.save)


@pytest.mark.parametrize("suffix", SCENE_WRITERS)
def test_models(disk, suffix):
    made = generate("atrium", 5000, 0)
    refused(disk, disk / f"a{suffix}", lambda path: write_scene(made, "atrium", path))


def test_stores(disk):
    with pytest.raises(at.InputError, match=r"left; free some, or choose another place"):
        at.build_store(at.procedural("atrium", triangles=2000), disk / "a.antumbra")
    assert not os.listdir(disk)


def test_bakes(disk):
    refused(disk, disk / "a.glb", lambda path: at.bake(at.procedural("atrium", triangles=5000), path, spp=1))
