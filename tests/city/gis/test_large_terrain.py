"""Rasters that are studied by block: the frame, the faces and the bits of the scene in memory, and what is refused."""

import json
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
import gis_files
from antumbra.city.gis.gis_data import height_file
from antumbra.city.gis.large_terrain import LargeTerrain
from antumbra.cli.scene_arguments import _OF_RASTERS
from antumbra.scene.raster import CellWindow
from antumbra.work.scene_records import scene_digest

rasterio = pytest.importorskip("rasterio")

PLACE = (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)
FEET = "EPSG:2263"  # New York, US survey feet
DAY = "--days", "2026-12-21", "--step", "60", "--timezone", "Europe/Amsterdam"


def mountains(shape, holes, seed=0):
    """Heights with valleys, one far mountain in the south, and holes."""
    random, (y, x) = np.random.default_rng(seed), np.mgrid[: shape[0], : shape[1]]
    heights = 12.0 * np.sin(x / 13.0) * np.cos(y / 9.0) + random.normal(size=shape)
    heights += 300.0 * np.exp(-(((x - 0.4 * shape[1]) / 20.0) ** 2) - ((y - 0.9 * shape[0]) / 20.0) ** 2)
    if holes:
        some = random.integers(0, [[shape[0]], [shape[1]]], (2, holes))
        heights[tuple(some)] = np.nan
        heights[200:280, 500:530] = np.nan
        heights[256, 505] = heights[240:256, 511] = heights[255:258, 600] = 4.0
        heights[:20, :35] = np.nan
        heights[5:8, 5] = 9.0  # without a triangle
    return heights


def large(path, window=None, **options):
    return at.Scene.of_data(LargeTerrain(height_file(path, options), window=window))


def test_the_frame_the_faces_and_the_digest_are_those_of_the_scene_in_memory(tmp_path):
    for k, shape in enumerate([(530, 1100), (257, 513), (2, 700), (600, 2)]):
        heights = mountains(shape, 300) if k == 0 else mountains(shape, 0)
        heights[0, 1] = np.nan if k == 1 else heights[0, 1]
        path = gis_files.write_raster(tmp_path / f"{k}.tif", heights.astype(np.float32), PLACE)
        scene, found = at.from_raster(path), large(path)
        assert (scene.bounds == found.bounds).all() and (scene.origin == found.origin).all()
        assert (scene.middle == found.middle).all() and scene.n_triangles == found.n_triangles
        assert scene.raster == found.raster and scene_digest(scene, 0.0) == scene_digest(found, 0.0)
        row, column = min(shape[0] - 2, 250), min(shape[1] - 2, 480)
        windows = None, CellWindow(0, 0, 1, shape[1]), CellWindow(row, column, 2, 2)
        for window in *windows, CellWindow(row, column, shape[0] - row, shape[1] - column):
            expected = scene.data.cell_tops(window)
            for a, b in zip(expected, found.data.cell_tops(window)):
                assert np.array_equal(a, b, equal_nan=True)
        assert (expected[1] >= 0).any()


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("holes", [0, 200])
def test_a_window_reads_the_far_horizon_and_nothing_else(tmp_path, holes, turned):
    heights = mountains((1400, 800), holes)
    heights = heights.T if turned else heights
    path = gis_files.write_raster(tmp_path / "a.tif", np.ascontiguousarray(heights, np.float32), PLACE)
    window = CellWindow(310, 200, 40, 70) if turned else CellWindow(200, 310, 70, 40)
    scene, found = at.from_raster(path), large(path, window)
    cells = at.raster_sensors(scene, None)
    rows, columns = np.mgrid[window.slices]
    some = (rows * scene.raster.columns + columns).reshape(-1)
    points, up = cells.points[some], cells.normals[some]
    towards = np.array([1.0, 0.01, 0.1] if turned else [0.01, -1.0, 0.1])  # over the mountain
    lights = at.DirectionalLights(-np.array([towards, towards * [1.0, 1.0, 3.0]]))
    bits, others = (at.visibility(each, points, lights, up) for each in (scene, found))
    assert (bits.bits == others.bits).all() and 0.05 < bits.seen_samples.mean() < 0.95
    part = found.data._pages._near[0]
    assert window.n_cells < part.n_cells < 0.8 * heights.size
    alone, near = large(path, window), CellWindow(window.row - 60, window.column - 60, 190, 190)
    alone.data._pages._reached = lambda directions, height, window: near  # without the mountain
    assert (at.visibility(alone, points, lights, up).bits != bits.bits).any()


def bands(path):
    with rasterio.open(path) as file:
        return file.read(), file.transform, file.descriptions, json.loads(file.tags()["antumbra"])


def study(cli, dem, name, *more):
    """The bands and the metadata of a study, and its answer."""
    done = cli("sun", dem, *DAY, "-o", name, "--json", *more)
    return *bands(name), done.json(), done.err


@pytest.mark.parametrize(
    "dtype, more",
    [
        ("float32", ("--energy", "--by", "hour")),
        ("float64", ("--sensors", "raster+1.5")),
        ("int16", ()),
        ("float32", ()),
    ],
)
def test_sun_by_block_equals_the_study_in_one_piece(cli, tmp_path, dtype, more):
    heights = mountains((300, 620), 0 if dtype == "int16" else 60)
    dem = gis_files.write_raster(tmp_path / "dem.tif", heights.astype(dtype), PLACE)
    whole, block = study(cli, dem, "a.tif", *more), study(cli, dem, "b.tif", "--max-memory", "8M", *more)
    assert "studied by block" in block[-1] and "studied by block" not in whole[-1]
    assert np.array_equal(whole[0], block[0], equal_nan=True) and whole[1:3] == block[1:3]
    assert whole[3] == block[3] and 0.0 < whole[4]["means"]["sun_share"] < 1.0
    for key in "sensors", "suns", "means", "rays":
        assert whole[4][key] == block[4][key], key
    assert not list(tmp_path.glob("*.parts"))


def test_sun_by_block_on_a_turned_raster_and_in_feet(cli, tmp_path):
    heights = mountains((300, 620), 60)
    place = (6.0, 0.0, 980000.0, 0.0, -6.0, 200000.0)
    for name, values in ("rows", heights), ("columns", np.ascontiguousarray(heights.T)):
        dem = gis_files.write_raster(tmp_path / f"{name}.tif", (3.0 * values).astype(np.float32), place, FEET)
        day = "--days", "2026-12-21", "--step", "60", "--timezone", "America/New_York", "-o"
        assert cli("sun", dem, *day, "a.tif").code == 0
        assert "studied by block" in cli("sun", dem, *day, "b.tif", "--max-memory", "8M").err
        whole, block = bands("a.tif"), bands("b.tif")
        assert np.array_equal(whole[0], block[0], equal_nan=True) and whole[1:] == block[1:]
        assert 0.0 < np.nanmean(whole[0][1]) < 1.0


def test_the_shards_of_a_window_are_merged_to_a_part_of_the_whole(cli, tmp_path):
    heights = mountains((700, 620), 60)
    dem = gis_files.write_raster(tmp_path / "dem.tif", heights.astype(np.float32), PLACE)
    window = "--bounds", "84400,445580,84700,445700"
    whole, part = study(cli, dem, "a.tif"), study(cli, dem, "b.tif", *window)
    east, north = round((part[1].c - whole[1].c) / 2.0), round((whole[1].f - part[1].f) / 2.0)
    rows, columns = part[0].shape[1:]
    assert (rows, columns) == (60, 150) and part[4]["sensors"] == rows * columns
    assert np.array_equal(whole[0][:, north : north + rows, east : east + columns], part[0], equal_nan=True)
    asked = "sun", dem, *DAY, *window, "--max-memory", "16M", "-o", "c.tif"
    assert [cli(*asked, "--shard", f"{k}/2").code for k in range(2)] == [0, 0]
    assert cli("merge", "c.shards").code == 0
    assert np.array_equal(bands("c.tif")[0], part[0], equal_nan=True) and bands("c.tif")[1] == part[1]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("-o", "a.png"), ["a scene of 186,000 cells", "--max-memory"]),
        (("-o", "a.tif", "--max-memory", "500k"), ["raise --max-memory", "--bounds"]),
        (("-o", "a.tif", "--bounds", "1,2,3,4"), ["no cell", "84000,"]),
        (("-o", "a.tif", "--bounds", "84400,445900,84100,446000"), ["--bounds", "X0,N0,X1,N1"]),
        (("-o", "a.csv", "--sensors", "face", "--bounds", "84400,445400,84700,446000"), ["sensors raster"]),
    ],
)
def test_what_does_not_fit_is_refused_with_the_remedy(cli, tmp_path, arguments, words):
    dem = gis_files.write_raster(tmp_path / "dem.tif", mountains((300, 620), 0).astype(np.float32), PLACE)
    memory = () if "--max-memory" in arguments or "face" in arguments else ("--max-memory", "8M")
    cli("sun", dem, *DAY, *arguments, *memory, "--quiet").refused(*words)
    assert not Path("a.tif").exists() and not Path("a.png").exists()


@pytest.mark.parametrize(
    "option", ["clip=84100,445500,84900,445900", "band=1", "nodata=4", "z_scale=2", "values_at=corners"]
)
def test_options_of_the_file_are_taken_by_block(cli, tmp_path, option):
    heights = mountains((300, 620), 0).round().astype(np.float32)
    dem = gis_files.write_raster(tmp_path / "dem.tif", heights, PLACE)
    whole, block = study(cli, f"{dem}?{option}", "a.tif"), study(cli, f"{dem}?{option}", "b.tif", "--max-memory", "4M")
    assert "studied by block" in block[-1] and np.array_equal(whole[0], block[0], equal_nan=True)
    assert whole[1:3] == block[1:3] and 0.0 < np.nanmean(whole[0][1]) < 1.0


def test_every_option_of_the_file_is_tried():
    tried = next(mark.args[1] for mark in test_options_of_the_file_are_taken_by_block.pytestmark)
    assert {each.partition("=")[0] for each in tried} == set(_OF_RASTERS) - {"terrain"}


MAPS = {
    "feet": (FEET, (6.0, 0.0, 980000.0, 0.0, -6.0, 200000.0)),
    "Web Mercator": ("EPSG:3857", (2.0, 0.0, 500000.0, 0.0, -2.0, 400000.0)),
    "far from the equator": ("EPSG:3857", (2.0, 0.0, 500000.0, 0.0, -2.0, 6800000.0)),
}


def ways(dem, place):
    """The ways to study a raster, by name: the words of the command; and the cells of the window."""
    side, west, north = place[0], place[2], place[5]
    window = CellWindow(60, 100, 120, 200)
    edges = west + side * 100, north - side * 180, west + side * 300, north - side * 60
    bounds, eye = ",".join(f"{each:.10g}" for each in edges), f"{west + 300 * side},{north - 150 * side},{100 * side}"
    store = dem.with_suffix(".antumbra")
    sun, viewshed = (
        ("sun", *DAY[:-2], "--latitude", "3", "--longitude", "4", "--timezone", "UTC"),
        ("viewshed", "--observer", eye),
    )
    return window, {
        "sun": (*sun, dem),
        "window": (*sun, dem, "--bounds", bounds),
        "window by block": (*sun, dem, "--bounds", bounds, "--max-memory", "4M"),
        "clip": (*sun, f"{dem}?clip={bounds}"),
        "store": (*sun, store, "--sensors", "raster"),
        "window of the store": (*sun, store, "--sensors", "raster", "--bounds", bounds),
        "viewshed": (*viewshed, dem),
        "viewshed in bands": (*viewshed, dem, "--max-memory", "386M"),
        "viewshed of the store": (*viewshed, store, "--sensors", "raster"),
    }


@pytest.mark.parametrize("name", MAPS)
def test_every_way_to_study_a_raster_has_one_result_in_any_unit_and_map(cli, tmp_path, name):
    crs, place = MAPS[name]
    heights = (mountains((300, 620), 40)[:, :420] * place[0] / 2.0).astype(np.float32)
    dem = gis_files.write_raster(tmp_path / "dem.tif", heights, place, crs)
    assert cli("build", dem, "-o", dem.with_suffix(".antumbra"), "--quiet").code == 0
    window, commands = ways(dem, place)
    if name == "far from the equator":
        for way, words in commands.items():
            done = cli(*words, "-o", "a.tif", "--quiet")
            assert done.code == 2, way
            done.refused("EPSG:3857", "has the scale 1.6", "reproject")
        return
    found = {}
    for way, words in commands.items():
        assert cli(*words, "-o", "a.tif", "--quiet").code == 0, way
        found[way] = bands("a.tif")
        assert found[way][3]["length_unit"] == ("us-ft" if name == "feet" else "m"), way
    rows, columns = window.slices
    part = found["sun"][0][:, rows, columns]
    assert np.array_equal(found["sun"][0], found["store"][0], equal_nan=True) and 0.0 < np.nanmean(part[1]) < 1.0
    for way in "window", "window by block", "window of the store":
        assert np.array_equal(part, found[way][0], equal_nan=True), way
    clip = found["clip"][0][0, 1:-1, 1:-1]
    assert clip.shape == part[0].shape and np.nansum(clip) > np.nansum(part[0])  # without the mountains beyond
    for way in "viewshed in bands", "viewshed of the store":
        assert np.array_equal(found["viewshed"][0], found[way][0], equal_nan=True), way


def test_a_viewshed_in_bands_has_the_unit_that_was_given(cli, tmp_path):
    heights = mountains((300, 620), 40)[:, :420].astype(np.float32)
    dem = gis_files.write_raster(tmp_path / "dem.tif", heights, PLACE, None)
    words = "viewshed", dem, "--observer", "84600,445700,200", "--unit", "ft", "--json", "-o"
    whole, banded = cli(*words, "a.tif").json(), cli(*words, "b.tif", "--max-memory", "386M").json()
    assert bands("a.tif")[3]["length_unit"] == bands("b.tif")[3]["length_unit"] == "ft"
    assert whole["area_seen"] == pytest.approx(banded["area_seen"], rel=1e-12)
    assert np.array_equal(bands("a.tif")[0], bands("b.tif")[0], equal_nan=True)


def test_what_needs_triangles_is_refused(tmp_path):
    path = gis_files.write_raster(tmp_path / "a.tif", mountains((300, 620), 0).astype(np.float32), PLACE)
    with pytest.raises(at.InputError, match="its own cells"):
        large(path).triangles()
