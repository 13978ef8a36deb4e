"""Options of commands that are made of the options of a picture: a new field of the class needs no other edit."""

import json
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from antumbra.base.option_fields import (
    WholeNumber,
    deciding_fields,
    field_values,
    option,
    with_keywords,
)
from antumbra.cli.app import program
from antumbra.cli.command_help import HelpfulCommand
from antumbra.cli.options import derived_options, literal, takes
from antumbra.cli.picture_spec import RenderArguments
from antumbra.cli.scene_arguments import SceneArguments
from antumbra.lab.compare_command import CompareArguments
from antumbra.picture.render_options import EngineOptions, RenderKeywords, RenderOptions

COMMANDS: Any = typer.main.get_command(program())
NAMES = {field.name for field in fields(RenderKeywords)}
APART = {
    "render": {"layers"},
    "compare": {"layers", "plan", "device", "counters", "antialias", "background", "textures", "smooth_normals"}
    | {"ambient", "ground", "materials"},
}
"""Options that a command does not have: EXR files have layers, and a comparison is of plans and their rays."""


@pytest.mark.parametrize("name", ["render", "compare"])
def test_a_command_has_the_options_that_name_it(name):
    own = {param.name: param for param in COMMANDS.commands[name].params}
    found = [each for each in derived_options() if name in (each.cli.commands or [name])]
    for each in found:
        param = own[each.name]
        assert each.cli.help in param.help and param.rich_help_panel == each.cli.panel
        assert f"--{each.name.replace('_', '-')}" in param.opts
    assert len(found) > 10
    assert NAMES - {each.field.name for each in found} == APART[name]


def test_help_shows_every_option(cli):
    shown = " ".join(cli("render", "--help").out.split())
    for each in derived_options():
        assert f"--{each.name.replace('_', '-')} " in shown
        assert " ".join(each.cli.help.split()) in shown and (not each.cli.note or each.cli.note in shown)


def test_json_and_settings_have_every_option(cli, square_obj):
    told = cli("render", square_obj, "--size", 4, "--spp", 1, "--json", "-o", "a.png").json()
    assert told.keys() >= NAMES
    assert (told["spp"], told["filter"], told["antialias"], told["plan"]) == (1, True, True, "auto")
    told = cli(
        "compare", square_obj, "--size", 4, "--spp", 1, "--json", "--plan", "bsah+single", "--plan", "cones"
    ).json()
    assert {field.name for field in fields(RenderKeywords)} - {"plan"} <= told.keys()
    assert (told["spp"], told["antialias"], told["gbuffer"]) == (1, False, "raster")


def test_the_digest_of_a_picture_has_every_option_that_decides(square_obj):
    from antumbra import load

    asked = RenderArguments(str(square_obj), cull_faces="back", adaptive=True, ground="off").options()
    settings = asked.settings(load(square_obj), "digest", 0.0)
    chosen = deciding_fields(RenderOptions(filter=True, adaptive=64, cull_faces="back"))
    assert {name: settings[name] for name in chosen} == json.loads(json.dumps(chosen))


def test_words_become_values():
    given = RenderArguments(spp=8, sampler="sobol", filter=False, textures=False, bounce=3, threads=2)
    assert literal(vars(given), RenderOptions) == {
        "spp": 8, "counters": False, "sampler": "sobol", "cull_faces": None, "filter": False, "antialias": True,
        "bounce": 3, "ambient": True, "textures": False, "smooth_normals": True,
        "materials": "pbr",
    }  # fmt: skip
    assert literal(vars(given), EngineOptions) == {"threads": 2, "gbuffer": "auto"}
    asked = given.options()
    assert asked.picture == RenderOptions(spp=8, sampler="sobol", filter=False, textures=False, bounce=3)
    assert field_values(asked.engine) == field_values(EngineOptions(threads=2))
    assert CompareArguments("x.obj", ["a", "b"]).options().engine == EngineOptions(gbuffer="raster")


@dataclass(frozen=True, kw_only=True)
class MoreOptions(RenderOptions):
    """The options of a picture, and one more."""

    glow: int = option(5, WholeNumber(0, 9), "How much it glows.", panel="Light")
    """How much it glows, 0 to 9."""


def test_a_new_option_needs_no_other_edit():
    @with_keywords(MoreOptions, 1)
    def render(given, scene, *args, **keywords):
        """Render.

        Parameters
        ----------
        scene : Scene
        """
        return MoreOptions(**given(*args, **keywords))

    @dataclass(frozen=True)
    class Arguments(SceneArguments):
        options: dict[str, Any] = field(default_factory=dict)
        scene: Annotated[str, typer.Argument()] = ""

    made = []

    @takes(Arguments, MoreOptions)
    def command(given: Arguments) -> int:
        """Render."""
        made.append(render(given.scene, **literal(given.options, MoreOptions)))
        return 0

    program = typer.Typer(rich_markup_mode=None)
    program.command(cls=HelpfulCommand)(command)
    shown = CliRunner().invoke(program, ["--help"]).output
    assert "Light:\n" in shown and "How much it glows." in shown and "--glow" in shown
    assert "0 to 9" in shown and "How much it glows, 0 to 9." in render.__doc__
    assert CliRunner().invoke(program, ["s", "--glow", "3"]).exit_code == 0
    assert made[0].glow == field_values(made[0])["glow"] == deciding_fields(made[0])["glow"] == 3
