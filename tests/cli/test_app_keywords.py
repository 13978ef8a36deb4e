"""The commands and the functions are two faces of the same jobs: names, messages and help."""

import inspect
import re

import pytest
import typer

import antumbra as at
from antumbra.cli.app import program
from antumbra.cli.scene_arguments import _OF_FOOTPRINTS, _OF_RASTERS
from study_cases import study_cases

COMMANDS = {
    name: each for name, each in typer.main.get_command(program()).commands.items() if name not in ("bench", "doctor")
}

TWINS = {
    "render": at.render,
    "sun": at.sun_hours,
    "viewshed": at.viewshed,
    "los": at.line_of_sight,
    "matrix": at.visibility_matrix,
    "skyline": at.skyline,
    "shadow": at.shadow,
    "bake": at.bake,
    "dataset": at.dataset,
    "build": at.build_store,
    "view": at.view,
    "pv": at.module_shading,
    "route": at.route_shade,
    "calendar": at.sun_calendar,
}
TWINS |= {case.command: getattr(at, case.function) for case in study_cases() if case.command}
"""Command -> the function that does the same."""

OF_COMMANDS = {
    "up": "load() takes it", "unit": "load() takes it", "max_memory": "load() takes it",
    "add": "scene_change", "remove": "scene_change", "before": "SceneChange.compare",
    "height": "from_footprints", "terrain": "from_footprints and from_raster",
    "json": "output", "quiet": "output", "html": "output", "sheet": "output", "contact_sheet": "output",
    "explain_plan": "output",
    "output": "results are returned, and have save()", "column": "Table.save takes it",
    "reciprocal": "ViewFactors.reciprocal", "map": "Table.save_map", "trees": "from_trees",
    "shard": "keep", "ray": "keep", "merge": "keep", "page": "Baked.page",
    "crs": "place", "latitude": "place", "longitude": "place", "north": "place", "timezone": "place",
    "light": "one of lights", "ao": "one of lights", "sky": "one of lights", "open_sky": "one of lights",
    "vpl": "some of lights",
    "observer": "one of observers", "target": "one of targets", "pairs": "shapes broadcast",
    "size": "Camera has it", "exposure": "Frame.save takes it", "preset": "sets spp, filter and adaptive",
    "camera_path": "a loop",
    "bounds": "sensors of the window", "adaptive_spp": "the number in adaptive",
    "frames": "a loop", "fps": "a loop", "overwrite": "a loop",
    "city_output": "write_attributes", "sparse": "VisibilityMatrix.save", "counts": "VisibilityMatrix.counts",
    "device": "part of the plan", "srdh_rays": "Plan.sample", "vertex": "texture is None",
    "no_browser": "browser=False", "polygons": "Viewshed.save_polygons", "hours": "RouteShade.save_hours",
}  # fmt: skip
"""Option that no function has -> where Python has it."""

OF_FUNCTIONS = {
    "lights": "--light, once for each", "cameras": "--camera, once for each", "place": "--latitude and its company",
    "normals": "columns of files", "target_normals": "columns of files",
    "faces": "columns of files", "target_faces": "columns of files",
    "options": "each is an option of its own",
    "layers": "EXR files have them", "progress": "shown on terminals", "keep": "--shard and --ray",
    "folder": "--output", "path": "--output", "surface": "--trees", "chunk": "for tests", "browser": "--no-browser",
    "scenes": "SCENE...", "times": "--days and --step",
}  # fmt: skip
"""Parameter that no command has -> how the command gives it."""

BY_COMMAND = {
    "viewshed": {"camera", "along", "spacing"},
    "dataset": {"camera"}, "skyline": {"point", "highest"}, "calendar": {"point"}, "pv": {"days", "step", "on_surface"},
}  # fmt: skip
"""Options of one command that its function gets otherwise: of the scene, of the table, or as points."""


def options(name: str) -> dict:
    """Name of the parameter of a command -> the parameter."""
    return {param.name: param for param in COMMANDS[name].params if param.name != "help"}


@pytest.mark.parametrize("name", TWINS)
def test_a_command_and_its_function_have_the_same_names(name):
    own, others = set(options(name)), set(inspect.signature(TWINS[name]).parameters)
    assert len(own & others) >= 3
    assert own - others <= OF_COMMANDS.keys() | BY_COMMAND.get(name, set()) | {"scene"} | OF_FUNCTIONS.keys()
    assert others - own <= OF_FUNCTIONS.keys()


@pytest.mark.parametrize("name", TWINS)
def test_options_are_written_as_parameters(name):
    """--eye-height is eye_height; a switch may have --no- before it."""
    for param in options(name).values():
        if param.param_type_name == "option" and param.name not in ("observer", "target", "camera_path"):
            assert f"--{param.name.replace('_', '-')}" in param.opts, param.opts


def test_every_exception_is_needed():
    own = set().union(*(options(name) for name in TWINS))
    others = set().union(*(inspect.signature(function).parameters for function in TWINS.values()))
    assert OF_COMMANDS.keys() <= own
    assert OF_FUNCTIONS.keys() <= others


OF_SCENES = {"terrain", "height", "unit", "triangles", "seed"}
"""Options of scenes, FILE?NAME=VALUE, that are those of commands."""


def test_an_option_of_a_scene_has_the_meaning_of_the_option_of_a_command_or_another_name():
    own = {*_OF_RASTERS, *_OF_FOOTPRINTS, "cutouts", "instances", "transmittance", "lod", "unit", "triangles", "seed"}
    others = set().union(*(options(name) for name in COMMANDS))
    assert own & others == OF_SCENES and "clip" in own and "bounds" in others


ARGUMENTS = {
    "sun": ["--latitude", "52", "--longitude", "4", "--days", "2026-06-21", "--step", "720"],
    "bake": ["-o", "b.glb", "--spp", "1"],
    "los": ["--from", "0.1,1,0.1", "--to", "0.1,-1,0.1"],
    "viewshed": ["--observer", "0.1,1,0.1"],
    "matrix": ["--sparse", "m.npz"],
    "visible": ["--turbine", "0,0,0", "--hub-height", "1", "--rotor", "1"],
    "skyline": ["--point", "0.1,1,0.1"],
    "shadow": ["--latitude", "52", "--longitude", "4", "--at", "2026-06-21T12:00", "-o", "s.gpkg"],
    "dataset": ["-o", "d", "--size", "4", "--spp", "1"],
    "build": ["-o", "b.antumbra"],
    "render": ["--size", "4", "--spp", "1"],
    "compare": ["--size", "4", "--spp", "1", "--plan", "bsah+single", "--plan", "bsah+wide"],
    "view": ["--no-browser"],
    "pv": ["--latitude", "52", "--longitude", "4", "--days", "2026-06-21", "--modules", "points.csv"],
    "route": ["--latitude", "52", "--longitude", "4", "--days", "2026-06-21", "--spacing", "1", "--line", "points.csv"],
    "calendar": ["--latitude", "52", "--longitude", "4", "--days", "2026-06-21", "--point", "0,1,0"],
}
ARGUMENTS |= {case.command: list(case.words) for case in study_cases() if case.command}
ANYTHING = {  # any text names something, or a file that may be missing
    "output", "html", "sheet", "contact_sheet", "epw", "crs", "host", "merge", "observers", "targets", "sparse", "bits",
    "camera_path",
    "matrix", "counts", "city_output", "column", "camera", "light", "timezone", "plot", "attribute",
    "allow_host", "trees", "map", "points", "polygon", "object", "surfaces", "polygons", "hours", "modules", "line",
    "turbines", "add", "title", "credits", "page", "variant",
}  # fmt: skip
"""Options whose messages name the value, not the option."""
NO_VALUES = "merge", "warmup", "plans", "scenes", "formats"
"""Commands without a scene, or without options that take a checked value."""


def _others(words: list[str], param) -> list[str]:
    """Words without an option that takes one value, and its value."""
    place = next((k for k, word in enumerate(words) if word in param.opts and not param.multiple), len(words))
    return words[:place] + words[place + 2 :]


@pytest.mark.parametrize(
    "name", [name for name in COMMANDS if name not in ("merge", "warmup", "plans", "scenes", "formats")]
)
def test_wrong_values_of_options(name, cli, square_obj):
    """One line, which names the option as it was written, in words of this package."""
    (square_obj.parent / "points.csv").write_text("x,y,z\n0,1,0\n1,1,0\n")
    asked = 0
    for param in COMMANDS[name].params:
        if param.param_type_name != "option" or param.is_flag or param.name in ANYTHING | {"help"}:
            continue
        option = next(text for text in param.opts if text.startswith("--"))
        done = cli(name, square_obj, *_others(ARGUMENTS.get(name, []), param), f"{option}=arcade")
        done.refused("arcade")
        told = done.err.removeprefix("antumbra: ")
        assert told.startswith((option, "plan", "rule", "days")), told
        assert not re.search(r"Value error|Input should|Invalid value|pydantic", told), told
        asked += 1
    assert asked or name in ("info",)


def test_numbers_of_options_name_their_limits(cli, square_obj):
    cli("render", square_obj, "--threads", "100000").refused("--threads is '100000'; it must be at most 1024")
    cli("render", square_obj, "--spp", "0").refused("--spp is '0'; it must be at least 1")
    cli("render", square_obj, "--preset", "best").refused("--preset is 'best'; it must be one of 'draft', 'standard'")
    cli("render", square_obj, "--exposure=-1").refused("--exposure is -1.0; it must lie between 0 and 1e+30")
    cli("build", square_obj, "-o", "b.antumbra", "--max-memory", "100M").refused("--max-memory is 100M", "from 384M")


@pytest.mark.parametrize("name", COMMANDS)
def test_help_keeps_lines_that_are_laid_out(name, cli, monkeypatch):
    """Tables and examples of a docstring stand in the help as they were written; only its sentences are wrapped."""
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERMINAL_WIDTH", "80")
    shown = cli(name, "--help").out.splitlines()
    laid_out = [line for line in inspect.cleandoc(COMMANDS[name].callback.__doc__).splitlines() if line[:2] == "  "]
    assert laid_out or name in (
        "plans",
        "doctor",
        "warmup",
        "merge",
        "compare",
        "scenes",
        "formats",
        "culling",
        "explain",
    )
    for line in laid_out:
        assert f"  {line}".rstrip() in shown, line
