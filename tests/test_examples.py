"""The example scenes: their files, the scripts that make them, and names on the command line."""

import inspect
import json
import re

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.cli.scene_arguments import parse_scene
from antumbra.examples import EXAMPLES
from repository import ROOT, tool

NEEDS = {"hills": "rasterio", "village": "pyproj"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_load_without_a_note(name, recwarn):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"the example {name} is NOT loaded without {NEEDS[name]}")
    scene = getattr(at.examples, name)()
    assert len(scene.triangles().vertices) > 300 and not recwarn.list
    assert at.examples.file_of(name).suffix == "." + EXAMPLES[name].file.rpartition(".")[2]


def test_each_example_has_a_function_and_a_file():
    functions = {name for name in at.examples.__all__ if inspect.isfunction(getattr(at.examples, name))}
    assert functions == {*EXAMPLES, "file_of"}
    folder = ROOT / "src" / "antumbra" / "examples"
    files = {path.name for path in folder.iterdir() if path.suffix not in (".py", "")}
    assert files == {each.file for each in EXAMPLES.values()}
    assert sum((folder / file).stat().st_size for file in files) < 2e6


def test_docstrings_tell_the_size():
    for name in ("mill", "room", "temple", "town"):
        scene, text = getattr(at.examples, name)(), inspect.getdoc(getattr(at.examples, name))
        assert f"{scene.n_triangles:,} triangles" in text
        assert name == "mill" or f"in {len(scene.objects)} objects" in text


def test_the_sails_of_the_mill_turn():
    mill = at.examples.mill()
    first, later = (mill.triangles(time).vertices for time in (0.0, 0.5))
    moved = (first != later).any((1, 2))
    assert mill.duration == 4.0 and 0 < moved.sum() < len(moved)
    half_turn = mill.triangles(2.0).vertices[moved].reshape(-1, 3).astype(float)
    axle = np.array([0.0, 8.9]) - mill.origin[:2]
    assert np.allclose(half_turn[:, :2] - axle, axle - first[moved].reshape(-1, 3)[:, :2], atol=1e-4)


def test_the_village_stands_on_the_hills():
    pytest.importorskip("rasterio", reason="the hills are NOT compared with the village without rasterio")
    pytest.importorskip("pyproj", reason="the village is NOT compared with the hills without pyproj")
    hills, village = at.examples.hills(), at.examples.village()
    corners = village.triangles().vertices.reshape(-1, 3).astype(float) + village.origin
    above = corners + (0, 0, 500)
    ground = above[:, 2] - hills.closest_hit(above, (0, 0, -1)).t
    assert np.isfinite(ground).all() and -3.0 < (corners[:, 2] - ground).min() < 0.5
    assert {"RoofSurface", "WallSurface", "GroundSurface"} == set(village.city.surface_types(np.arange(200)))
    kept = json.loads(at.examples.file_of("village").read_text())["CityObjects"]
    assert {"Building", "Road", "PlantCover", "SolitaryVegetationObject"} == {each["type"] for each in kept.values()}


def test_models_are_those_of_the_script(tmp_path):
    models = tool(ROOT / "scripts" / "example_models.py")
    assert {f"{name}.glb" for name in models.MODELS} == {each.file for each in EXAMPLES.values() if "glb" in each.file}
    for name, make in models.MODELS.items():
        models.write(tmp_path / f"{name}.glb", make())
        made, stored = at.load(tmp_path / f"{name}.glb"), at.load(at.examples.file_of(name))
        assert np.allclose(made.triangles().vertices, stored.triangles().vertices, atol=1e-4)
        assert [each.name for each in made.objects] == [each.name for each in stored.objects]


def test_the_invented_data_are_those_of_the_script(tmp_path):
    rasterio = pytest.importorskip("rasterio", reason="the invented data are NOT made again without rasterio")
    tool_file = tool(ROOT / "scripts" / "example_data.py")
    tool_file.write_hills(tmp_path / "hills.tif")
    tool_file.write_village(tmp_path / "village.city.json")
    heights = [rasterio.open(path).read(1) for path in (tmp_path / "hills.tif", at.examples.file_of("hills"))]
    assert np.abs(heights[0] - heights[1]).max() < 0.02  # NumPy's exponential may differ in the last bit
    made, kept = (json.loads(p.read_text()) for p in (tmp_path / "village.city.json", at.examples.file_of("village")))
    assert made["CityObjects"] == kept["CityObjects"]
    assert np.abs(np.subtract(made["vertices"], kept["vertices"])).max() <= 2


def test_examples_on_the_command_line(cli):
    assert parse_scene("example:temple").path == at.examples.file_of("temple")
    assert parse_scene("example:village?lod=2.2") == parse_scene(f"{at.examples.file_of('village')}?lod=2.2")
    assert parse_scene("example:hills?band=1").gis == (("band", 1),)
    told = cli("info", "example:town", "--json").json()
    assert told["triangles"] == 75_784
    listed = cli("scenes", "--json").json()["examples"]
    assert [each["name"] for each in listed] == list(EXAMPLES)
    assert all(re.search(rf"\b{name}\b", cli("scenes").out) for name in EXAMPLES)


@pytest.mark.parametrize(
    "name, words", [("tempel", "did you mean 'temple'"), ("", "choose one of hills, mill"), (7, "7")]
)
def test_unknown_examples(name, words):
    with pytest.raises(InputError, match=words):
        at.examples.file_of(name)
    if isinstance(name, str):
        with pytest.raises(InputError, match="no example scene"):
            parse_scene(f"example:{name}")
