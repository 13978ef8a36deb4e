"""Rasters of heights and footprints on the command line."""

import json
from pathlib import Path

import numpy as np
import pytest
import rasterio

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.cli.scene_arguments import SceneArguments
from gis_files import buildings, hills, write_buildings, write_raster


@pytest.fixture
def dem(tmp_path):
    return write_raster(tmp_path / "dem.tif", hills(20, 25))


@pytest.fixture
def houses(tmp_path):
    return write_buildings(tmp_path / "b.gpkg", buildings(h=[3.0, 5.0, 8.0]).drop(columns="height"))


def grid(path):
    with rasterio.open(path) as file:
        return file.transform, file.crs, file.shape


def test_a_viewshed_of_a_raster_has_its_cells(cli, dem):
    told = cli("viewshed", "dem.tif", "--observer", "100020,449980,30", "-o", "seen.tif", "--json").json()
    assert told["sensors"] == 500 and 0 < told["seen"] < 500
    assert grid("seen.tif") == grid("dem.tif")
    scene = at.load(dem)
    expected = at.viewshed(scene, "raster", (100020, 449980, 30)).table["seen"].reshape(20, 25)
    with rasterio.open("seen.tif") as file:
        assert (file.read(1) == expected).all()


def test_least_heights_and_roads_are_written_to_the_cells(cli, dem, tmp_path):
    (tmp_path / "road.csv").write_text("x,y\n100004,449990\n100040,449970\n")
    road = "--along", "road.csv", "--spacing", "3", "--on-surface", "--eye-height", "2"
    assert cli("viewshed", "dem.tif", *road, "-o", "road.tif").code == 0
    above = "--observer", "100020,449980,30", "--least-height"
    assert cli("viewshed", "dem.tif", *above, "-o", "least.tif").code == 0
    scene = at.load(dem)
    line = at.points_along(tmp_path / "road.csv", 3.0)
    length = at.viewshed(scene, "raster", line, on_surface=True, eye_height=2.0).table["length"]
    least = at.viewshed(scene, "raster", (100020, 449980, 30), least_height=True).table["least_height"]
    for path, name, expected in (("road.tif", "length", length), ("least.tif", "least_height", least)):
        assert grid(path) == grid("dem.tif")
        with rasterio.open(path) as file:
            band = 1 + file.descriptions.index(name)
            assert np.allclose(file.read(band), expected.reshape(20, 25)) and expected.max() > 0.0
    wrong = cli("viewshed", "dem.tif", *road, "--observer", "0,0,0")
    assert wrong.code != 0 and "--along excludes" in wrong.err
    assert "--spacing" in cli("viewshed", "dem.tif", "--along", "road.csv").err


def test_the_visible_share_of_a_turbine_is_written_to_the_cells(cli, dem):
    turbine = "--turbine", "100020,449980,8.5", "--hub-height", "4.5", "--rotor", "8"
    told = cli("visible", "dem.tif", "--sensors", "raster+1.6", *turbine, "-o", "share.tif", "--json").json()
    assert told["sensors"] == 500 and told["samples"] == 64 and 0 < told["seen_entirely"] < told["seen"]
    share = at.visible_share(at.load(dem), "raster+1.6", at.Turbine((100020, 449980, 8.5), 4.5, 8))["share"]
    with rasterio.open("share.tif") as file:
        assert (file.read(1).reshape(-1) == share).all()
    assert grid("share.tif") == grid("dem.tif")
    assert "one target" in cli("visible", "dem.tif").err
    assert "--hub-height" in cli("visible", "dem.tif", "--turbine", "0,0,0").err


def test_the_visible_share_of_walls_and_polygons(cli, dem, houses, tmp_path):
    (tmp_path / "eye.csv").write_text("x,y,z\n100007,449900,1.5\n")
    scene = "b.gpkg", "--height", "h", "--sensors", "eye.csv"
    walls = cli("visible", *scene, "--object", "a", "--surfaces", "WallSurface", "--spacing", "0.5", "--json").json()
    assert walls["seen"] == 1 and walls["seen_entirely"] == 0 and walls["samples"] == 4 * 32 * 3
    corners = "x,y,z\n100004,449988,0\n100010,449988,0\n100010,449988,3\n100004,449988,3\n"
    (tmp_path / "wall.csv").write_text(corners.replace("449988", "449987.9"))
    front = cli("visible", *scene, "--polygon", "wall.csv", "--spacing", "0.5", "--json").json()
    assert front["seen_entirely"] == 1 and front["samples"] == 72


def test_hours_of_sun_on_a_raster_are_written_to_its_cells(cli, dem):
    assert cli("sun", "dem.tif", "--days", "2026-03-21", "--step", "60").code == 0
    assert grid("dem-sun.tif") == grid("dem.tif")
    with rasterio.open("dem-sun.tif") as file:
        assert file.descriptions[0] == "sun_hours" and 0.0 < file.read(1).max() <= 13.0


def test_buildings_on_terrain_are_what_python_makes(cli, dem, houses):
    told = cli("info", "b.gpkg", "--height", "h", "--terrain", "dem.tif", "--json").json()
    scene = at.from_footprints(houses, "h", terrain=dem)
    assert told["triangles"] == scene.n_triangles and np.array(told["bounds"]).tolist() == scene.bounds.tolist()
    assert told["city"]["objects"] == {"Building": 3, "TINRelief": 1} and told["crs"] == "EPSG:28992"
    assert cli("info", "b.gpkg?height=h&terrain=dem.tif", "--json").json()["triangles"] == told["triangles"]
    assert cli("render", "b.gpkg", "--height", "h", "--terrain", "dem.tif", "--size", "32x32", "-o", "a.png").code == 0
    options = "--height", 4, "--terrain", "dem.tif", "--sensors", "grid:2", "--days", "2026-06-21", "--step", "120"
    assert cli("sun", "b.gpkg", *options, "-o", "a.csv").code == 0
    lines = cli(
        "los", "b.gpkg", "--height", "h", "--from", "100000,449991,1", "--to", "100020,449991,1", "--json"
    ).json()
    assert lines["lines"][0]["blocked_by"] == "a" and lines["lines"][0]["surface"] == "WallSurface"


def test_rasters_are_built_as_stores(cli, dem, houses):
    assert cli("build", "dem.tif", "-o", "a.antumbra").code == 0
    assert (
        cli("viewshed", "a.antumbra", "--sensors", "raster", "--observer", "100020,449980,30", "-o", "s.tif").code == 0
    )
    assert grid("s.tif") == grid("dem.tif")
    assert cli("build", "b.gpkg", "--height", "h", "--terrain", "dem.tif", "-o", "b.antumbra").code == 0
    assert at.load("b.antumbra").n_triangles == at.from_footprints(houses, "h", terrain=dem).n_triangles


def test_tiles_are_built_as_one_surface(cli, tmp_path):
    heights = hills(20, 25)
    for name, part, east in ("west", heights[:, :10], 0), ("east", heights[:, 10:], 20):
        write_raster(tmp_path / f"{name}.tif", part, (2.0, 0.0, 100000.0 + east, 0.0, -2.0, 450000.0))
    told = cli("build", "west.tif", "east.tif", "-o", "a.antumbra", "--json").json()
    assert told["triangles"] == 2 * 19 * 24  # none are missing between the tiles
    (tmp_path / "tiles").mkdir()
    for name in "west.tif", "east.tif":
        (tmp_path / "tiles" / name).write_bytes((tmp_path / name).read_bytes())
    (tmp_path / "tiles" / "read.me").touch()
    assert cli("build", "tiles", "-o", "b.antumbra", "--json").json()["triangles"] == told["triangles"]
    cli("build", ".", "-o", "c.antumbra", "--up", "y").refused("z up")
    write_raster(tmp_path / "coarse.tif", heights, (3.0, 0.0, 100050.0, 0.0, -3.0, 450000.0))
    cli("build", "west.tif", "coarse.tif", "-o", "b.antumbra").refused(
        "coarse: its cells do not continue those of west"
    )


def test_terrain_below_a_raster_is_its_ground(cli, dem, tmp_path):
    surface = hills(20, 25) + 20.0
    surface[5:9, 5:9] = -1.0
    write_raster(tmp_path / "dsm.tif", surface, nodata=-1.0)
    told = cli("info", "dsm.tif", "--terrain", "dem.tif", "--json").json()
    assert [mesh["name"] for mesh in told["meshes"]] == ["dsm", "dem"]


def test_wrong_inputs_are_answered_in_one_line(cli, dem, houses):
    cli("info", "b.gpkg").refused("b.gpkg", "no column 'height'", "h")
    cli("render", "dem.tif", "--height", "h").refused("--height h is for footprints", "dem.tif")
    cli("render", "procedural:atrium", "--terrain", "dem.tif").refused(
        "--terrain dem.tif is for footprints and rasters"
    )
    cli("info", "dem.tif?bands=1").refused("'bands' is unknown", "did you mean 'band'")
    cli("info", "dem.tif?band=1&band=2").refused("band is empty or repeated")
    cli("info", "dem.tif?band=x").refused("band is 'x'; it must be a number")
    cli("info", "dem.tif", "--up", "y").refused("dem.tif", "z up")
    cli("info", "b.gpkg", "--height", "h", "--terrain", "missing.tif").refused("missing.tif")
    cli("build", "dem.tif", "--up", "y", "-o", "a.antumbra").refused("dem.tif", "z up")
    cli("sun", "b.gpkg", "--height", "h", "--sensors", "raster", "--days", "2026-06-21").refused("no raster of its own")


def test_every_command_with_a_scene_has_the_options(cli):
    for name in (
        "render",
        "sun",
        "view",
        "los",
        "viewshed",
        "matrix",
        "dataset",
        "build",
        "info",
        "compare",
        "explain",
    ):
        words = cli(name, "--help").out
        assert "--height" in words and "--terrain" in words, name
    words = cli("formats").out
    assert ".gpkg" in words and ".tif" in words
    assert "--terrain" not in cli("plans", "--help").out and "plans" in COMMANDS


def test_names_of_files_survive_in_the_text_of_a_scene(cli, dem, tmp_path, houses):
    (tmp_path / "a&b c.tif").write_bytes(dem.read_bytes())
    text = SceneArguments(height="h", terrain=[Path("a&b c.tif")]).record_of("b.gpkg?layer=b")
    assert text.startswith("b.gpkg?layer=b&height=h&terrain=")
    assert cli("info", text, "--json").json()["city"]["objects"] == {"Building": 3, "TINRelief": 1}


def test_notes_on_points_are_lines_of_the_command_and_not_of_a_quiet_one(cli, dem, tmp_path):
    (tmp_path / "eyes.csv").write_text("x,y,z\n100020,449980,30\n100020,449980,-5\n100900,449980,30\n")
    viewshed = "viewshed", "dem.tif", "--observers", "eyes.csv", "-o", "seen.json"
    loud, quiet = cli(*viewshed), cli(*viewshed, "--quiet")
    below = "1 of 3 observers lies below the ground or inside a solid; the first is 100020,449980,-5"
    beside = "1 of 3 observers lies beside dem; the first is 100900,449980,30"
    assert loud.code == quiet.code == 0 and quiet.err == "" and loud.err.count("note: ") == 2
    assert f"antumbra: note: {below}\n" in loud.err and f"antumbra: note: {beside}\n" in loud.err
    assert sorted(json.loads((tmp_path / "seen.json").read_text())["about"]["warnings"]) == sorted([below, beside])


DEGREES = {
    "viewshed": ("--observer", "4.36,52.01,30"),
    "los": ("--from", "4.36,52.01,30", "--to", "100020,449980,30"),
    "skyline": ("--point", "4.36,52.01,30"),
    "visible": ("--turbine", "4.36,52.01,30", "--hub-height", "9", "--rotor", "4"),
    "render": (
        "--camera",
        "4.36,52.01,30:4.37,52.02,5",
    ),
}


@pytest.mark.parametrize("command", DEGREES)
def test_degrees_over_a_map_are_refused_before_any_file_is_written(cli, dem, command):
    output = "seen.png" if command == "render" else "seen.csv"
    cli(command, "dem.tif", *DEGREES[command], "-o", output).refused("are in degrees (4.36,52.01)", "project them")
    assert not list(dem.parent.glob("seen*"))


def test_points_to_be_placed_on_a_hole_are_refused(cli, dem):
    heights = hills(20, 25)
    heights[8:12, 8:12] = -9999
    write_raster(dem.with_name("hole.tif"), heights, nodata=-9999)
    for command, option in (("viewshed", "--observer"), ("skyline", "--point")):
        placed = cli(
            command, "hole.tif", option, "100020,449980,0", "--on-surface", "--eye-height", "1.7", "-o", "a.csv"
        )
        placed.refused("1 of 1", "lies beside hole or on a hole, where no surface is to", "100020,449980,0")
