"""The argument SCENE: its text, and the options of the command, make the same object."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import pytest
import typer

import antumbra as at
from antumbra.cli.options import parameters_of, takes
from antumbra.cli.scene_arguments import DEFAULT_SCENE, SceneArguments, SceneSpec, parse_scene


def test_scenes():
    assert parse_scene("a/b.glb") == SceneSpec(Path("a/b.glb"))
    assert parse_scene("procedural:city") == SceneSpec(None, "city")
    assert parse_scene("procedural:city?triangles=100k&seed=3") == SceneSpec(None, "city", 100_000, 3)
    assert parse_scene("a/b.city.json?lod=2.2") == SceneSpec(Path("a/b.city.json"), lod="2.2")
    both = SceneSpec(Path("a/b.city.json"), lod="2.2", unit="ft")
    assert parse_scene("a/b.city.json?lod=2.2&unit=ft") == both
    assert parse_scene("a.gpkg?unit=us-ft&height=h").gis == (("height", "h"),)
    assert parse_scene("b.glb?lod=2.2").path == Path("b.glb?lod=2.2")
    assert parse_scene(DEFAULT_SCENE).name == "atrium"


def test_the_picture_is_named_after_the_scene(tmp_path, monkeypatch):
    folder = tmp_path / "bart.robots"
    folder.mkdir()
    monkeypatch.chdir(folder)
    for text, stem in [
        ("procedural:city", "antumbra"),
        ("a/sponza.v2.glb", "sponza.v2"),
        ("a/delft.city.json?lod=1", "delft"),
        (str(folder), "bart.robots"),
        (".", "bart.robots"),
        ("/", "antumbra"),
    ]:
        assert parse_scene(text).stem == stem


@pytest.mark.parametrize(
    "text",
    ["", "procedural:city?size=3", "procedural:city?seed=1&seed=2", "procedural:city?seed=", "procedural:c?seed=-1"],
)
def test_bad_scenes(text):
    with pytest.raises(at.InputError):
        parse_scene(text)


@pytest.mark.parametrize(
    "text, options",
    [
        ("b.gpkg?layer=b", {"height": "h", "terrain": [Path("a&b c.tif"), Path("d.tif")], "unit": "ft"}),
        ("b.gpkg", {"height": "3.5"}),
        ("dem.tif?band=2", {"terrain": [Path("d.tif")]}),
        ("a.city.json?lod=2.2", {"unit": "us-ft"}),
        ("example:hills", {"terrain": [Path("d.tif")], "unit": "m"}),
    ],
)
def test_options_of_the_command_and_of_the_text_make_one_scene(text, options):
    given = SceneArguments(**options)
    assert given.spec_of(text) == parse_scene(given.record_of(text)) != parse_scene(text)
    assert SceneArguments().spec_of(text) == parse_scene(text) and SceneArguments().record_of(text) == text


def test_an_option_in_the_text_and_of_the_command_is_refused(cli):
    cli("info", "b.gpkg?height=h", "--height", "4").refused("b.gpkg?height=h&height=4: height is empty or repeated")
    cli("info", "b.gpkg?unit=m", "--unit", "ft").refused("b.gpkg?unit=m&unit=ft: unit is empty or repeated")
    cli("info", "b.gpkg", "--height", "").refused("b.gpkg?height=: height is empty or repeated")
    cli("info", "b.gpkg", "--unit", "").refused("b.gpkg?unit=: unit is empty or repeated")
    cli("info", "procedural:city", "--unit", "m").refused("--unit m is for files")


def test_up_and_crs_belong_to_the_scene():
    @dataclass(frozen=True)
    class Arguments(SceneArguments):
        up: str = "z"
        crs: str = "EPSG:28992"

    assert Arguments().spec_of("a.obj") == SceneSpec(Path("a.obj"), up="z", crs="EPSG:28992")


def test_only_commands_with_a_scene_have_its_options():
    @dataclass(frozen=True)
    class Plain:
        name: Annotated[str, typer.Argument()]

    @dataclass(frozen=True)
    class WithScene(SceneArguments):
        scene: Annotated[str, typer.Argument()]
        quiet: Annotated[bool, typer.Option()] = False

    assert [each.name for each in parameters_of(Plain)] == ["name"]
    assert [each.name for each in parameters_of(WithScene)] == [
        "scene",
        "height",
        "terrain",
        "unit",
        "add",
        "remove",
        "quiet",
    ]
    made = [list(takes(kind)(lambda args: 0).__annotations__) for kind in (Plain, WithScene)]
    assert made == [["name"], ["scene", "height", "terrain", "unit", "add", "remove", "quiet", "max_memory"]]
