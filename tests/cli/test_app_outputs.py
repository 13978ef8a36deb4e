"""Every command checks every file and folder that it will write, before any work."""

import os
import re
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple, get_type_hints

import pytest

import antumbra as at
import city_files
from antumbra.base.extras import plugins_of
from antumbra.city.tables import result_table
from antumbra.cli import options
from antumbra.cli.app import program
from antumbra.lab import bench_command
from small_disk import fill, small_disk

READ = {"terrain", "areas", "epw", "observers", "along", "targets", "polygon", "points", "merge", "folders", "store"}
READ |= {"sponza", "line", "modules", "turbines", "camera_path"}
"""Arguments of commands that name files and folders to read."""


class Written(NamedTuple):
    """An argument of a command that is a path."""

    words: tuple[str, ...]  # of the command
    name: str
    option: str
    info: Any  # what Typer knows of it

    @property
    def is_folder(self) -> bool:
        return self.info.metavar == "FOLDER"

    def __str__(self) -> str:
        return " ".join((*self.words, self.option))


def commands():
    """(words, function) of all commands."""
    for command in program().registered_commands:
        yield (command.name,), command.callback
    for command in bench_command.app.registered_commands:
        yield ("bench", command.name), command.callback
    for name, entry in plugins_of("antumbra.bench").items():
        yield ("bench", name), entry.load()


def paths():
    """All arguments of all commands that are paths."""
    for words, function in dict(commands()).items():
        for name, kind in get_type_hints(function, include_extras=True).items():
            for info in getattr(kind, "__metadata__", ()):
                if "pathlib.Path" in str(kind.__origin__) or kind.__origin__ is Path:
                    names = [each for each in info.param_decls or () if each.startswith("--")]
                    yield Written(words, name, names[0] if names else f"--{name.replace('_', '-')}", info)


PATHS = list(paths())
OUTPUTS = [path for path in PATHS if hasattr(path.info.callback, "writes")]


def test_paths_are_read_or_checked():
    assert {path.name for path in PATHS if path not in OUTPUTS} == READ
    names = {str(path) for path in OUTPUTS}
    assert (
        len(names) > 25 and {"sun --city-output", "build --output", "bench srdh --plot", "bench all --output"} < names
    )


@pytest.mark.parametrize("output", [path for path in OUTPUTS if not path.is_folder], ids=str)
def test_help_lists_what_an_option_takes(output):
    listed = re.findall(r"(?<!\w)\.[a-z0-9]+", f"{output.info.help} {output.info.metavar}")
    assert set(listed) == set(output.info.callback.writes()) - {".htm"}


def test_tables_have_the_suffixes_of_their_writers():
    assert set(options.TABLES) == set(result_table.WRITERS)


SCENES = {
    "build": ["none.glb"],
    "bake": ["none.glb"],
    "dataset": ["none.glb"],
    "sun": ["none.glb"],
    "scenes": ["none"],
}
"""Command -> arguments that it needs, whose scene is missing."""


def ask(cli, output, path):
    """Run a command with an output. Its scene is missing, so that another error shows that work began."""
    given = SCENES.get(output.words[0], [])
    if output.words[0] in ("bake", "dataset") and output.name != "output":
        given = [*given, "--output", "unused.glb" if output.words[0] == "bake" else "unused"]
    return cli(*output.words, *given, output.option, path)


def right_name(output) -> str:
    """A name that the option takes: its refusal of another one says which."""
    if output.is_folder:
        return "out"
    with pytest.raises(at.InputError) as caught:
        output.info.callback(SimpleNamespace(resilient_parsing=False, meta={}), Path("out.xyz"))
    return "out" + str(caught.value).partition("; use ")[2].partition(" or ")[0].partition(", ")[0]


MAIN = [path for path in OUTPUTS if path.name == "output"]


@pytest.mark.parametrize("output", MAIN, ids=str)
def test_every_command_takes_a_second_output_or_refuses_it(cli, output, tmp_path):
    """No command keeps the last output and drops the others in silence."""
    good = right_name(output)
    missing = [] if output.words[0] == "bench" else SCENES.get(output.words[0], ["none.glb"])
    done = cli(*output.words, *missing, "--output", good, "--output", f"other-{good}")
    assert done.code == 2 and not list(tmp_path.iterdir()), done
    if "may be repeated" in output.info.help:
        assert "--output" not in done.err  # its missing scene is the error, or its missing input
    else:
        done.refused("--output is given twice; it takes one value")


def test_studies_and_pictures_take_several_outputs():
    several = {str(path).partition(" ")[0] for path in MAIN if "may be repeated" in path.info.help}
    assert {"render", "sun", "shadow", "viewshed", "skyline", "los", "view-factors"} <= several


@pytest.mark.parametrize("output", OUTPUTS, ids=str)
def test_bad_places_are_refused_before_any_work(cli, tmp_path, output):
    good = right_name(output)
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / "folder" / good).mkdir(parents=True)
    before = sorted(tmp_path.rglob("*"))
    places = [f"none/{good}", f"file/{good}", *(["file"] if output.is_folder else ["out.xyz", "out", f"folder/{good}"])]
    if sys.platform == "linux":
        places.append(f"/proc/{good}")  # root may write to any folder but this
    for place in places:
        ask(cli, output, place).refused(place)
        assert sorted(tmp_path.rglob("*")) == before, place


@pytest.mark.parametrize("output", OUTPUTS, ids=str)
def test_a_full_disk_is_found_before_any_work(cli, full_disk, output):
    path = full_disk / right_name(output)
    ask(cli, output, path).refused(str(path), "No space left on device")
    assert os.listdir(full_disk) == ["filling"]


@pytest.fixture(scope="module")
def full_disk(tmp_path_factory):
    with small_disk(tmp_path_factory.mktemp("outputs") / "disk", 1 << 20) as folder:
        fill(folder)
        yield folder


def test_one_file_for_two_outputs(cli):
    cli("sun", "none.glb", "-o", "a.csv", "-o", "./a.csv").refused("a.csv: is named twice")
    cli("matrix", "none.glb", "-o", "a.npy", "--counts", "b.csv", "--counts", "b.csv").refused("b.csv: is named twice")


def test_names_by_default_are_checked_too(cli, tmp_path):
    for name in ("none.png", "none-sun.png", "none-explain.png", "none-culling.png", "compare.png"):
        (tmp_path / name).mkdir()
    for command in ("render", "sun", "explain", "culling", "compare"):
        cli(command, "none.glb").refused(".png: is a folder")


def test_more_files_of_one_output(cli, tmp_path):
    (tmp_path / "a.mtl").mkdir()
    (tmp_path / "a.gif.frames").write_bytes(b"")
    cli("scenes", "atrium", "-o", "a.obj").refused("a.mtl: is a folder")
    cli("render", "none.glb", "--frames", "0:1", "-o", "a.gif").refused("a.gif.frames: is a file")


@pytest.mark.parametrize("suffix, other", [(".json", ".jsonl"), (".jsonl", ".json")])
def test_a_copy_of_a_city_has_the_suffix_of_the_file(cli, tmp_path, suffix, other):
    text = city_files.city(
        {"a": city_files.building(city_files.solid())}, vertices=city_files.CUBE + (85000, 447000, 0)
    )
    city_files.put(tmp_path, city_files.sequence(text) if suffix == ".jsonl" else text, "a.city" + suffix)
    asked = "sun", f"a.city{suffix}", "--days", "2026-06-21", "--step", 240, "-o", "a.csv", "--city-output"
    cli(*asked, f"b{other}").refused(f"b{other}: unknown suffix", f"use {suffix}")
    assert not (tmp_path / "a.csv").exists()
    assert cli(*asked, f"b{suffix}").code == 0
    assert "sun_hours" in (tmp_path / f"b{suffix}").read_text()
