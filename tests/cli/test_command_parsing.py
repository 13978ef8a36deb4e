"""Words of commands: options given twice, and one form of equal command lines. All commands and options are tried."""

import pytest
import typer

from antumbra.base.errors import InputError
from antumbra.base.extras import plugins_of
from antumbra.cli.app import program
from antumbra.cli.command_parsing import parsed_words
from antumbra.lab.bench_command import _loaded
from antumbra.lab.bench_command import app as bench

COMMANDS = {
    **{name: each for name, each in typer.main.get_command(program()).commands.items() if name != "bench"},
    **{f"bench {name}": each for name, each in typer.main.get_command(bench).commands.items()},
    **{f"bench {name}": _loaded(name) for name in plugins_of("antumbra.bench")},
}
OPTIONS = [
    (name, param)
    for name, command in COMMANDS.items()
    for param in command.params
    if param.param_type_name == "option" and param.name != "help"
]


def context(command):
    return typer.Context(COMMANDS[command], info_name=command, resilient_parsing=True)


def parse(command, *words):
    """The values of a command's parameters."""
    made = context(command)
    COMMANDS[command].parse_args(made, list(words))
    return made.params


def words_of(param, flag):
    return [flag] if param.is_flag else [flag, "1"]


def test_all_commands_are_tried():
    assert len(COMMANDS) > 25 and len(OPTIONS) > 300
    assert {"bench all", "bench srdh", "visible", "render"} <= COMMANDS.keys()


@pytest.mark.parametrize("name", COMMANDS)
def test_an_option_given_twice_is_a_list_or_an_error(name):
    for command, param in OPTIONS:
        if command != name:
            continue
        spellings = [*param.opts, *param.secondary_opts]
        for other in spellings:
            words = [*words_of(param, spellings[0]), *words_of(param, other)]
            if param.multiple:
                made = COMMANDS[name].make_parser(context(name)).parse_args(args=list(words))[0]
                assert len(made[param.name]) == 2, words
                continue
            with pytest.raises(InputError, match=f"^{param.opts[0]}( or .*)? is given twice; "):
                parse(name, *words)


@pytest.mark.parametrize(
    "words, told",
    [
        (("visible", "--turbines", "a.csv", "--turbines=b.csv"), "--turbines is given twice; it takes one value"),
        (("compare", "-o", "a.png", "--output", "b.png"), "--output is given twice; it takes one value"),
        (("render", "--filter", "--no-filter"), "--filter or --no-filter is given twice; decide for one of them"),
        (("info", "a.glb", "--json", "--json"), "--json is given twice; once is enough"),
        (("--version", "--version"), "--version is given twice; once is enough"),
        (("bench", "all", "--quick", "--quick"), "--quick is given twice; once is enough"),
    ],
)
def test_what_is_said_of_an_option_given_twice(cli, words, told):
    cli(*words).refused(told)


@pytest.mark.parametrize(
    "scene, told",
    [
        ("a.glb?cutouts=on&cutouts=off", "cutouts is repeated"),
        ("a.glb?instances=on&instances=on", "instances is repeated"),
        ("a.glb?transmittance=leaf:0.3&transmittance=leaf:0.5", "the transmittance of 'leaf' is repeated"),
        ("a.gpkg?height=h&height=g", "height is empty or repeated"),
        ("dem.tif?band=1&band=2", "band is empty or repeated"),
        ("procedural:city?seed=1&seed=2", "'seed' is unknown or repeated"),
        ("a.city.json?lod=1&lod=2", "lod is repeated"),
    ],
)
def test_options_in_the_text_of_a_scene_given_twice(cli, scene, told):
    cli("info", scene).refused(told)


@pytest.mark.parametrize(
    "words",
    [
        ("a.glb", "--spp", "4", "--output", "a.png", "--size=9"),
        ("--size", "9", "-o", "a.png", "--spp=04", "a.glb"),
        ("-o", "./a.png", "a.glb", "--size", "9", "--spp=4", "--preset", "standard", "--antialias"),
    ],
)
def test_equal_command_lines_have_one_form(words):
    parse("render", *words)
    assert parsed_words.get() == ("render", "a.glb", "--output=a.png", "--size=9", "--spp=4")


@pytest.mark.parametrize(
    "words",
    [
        ("a.glb", "--light", "sun:0,-1,0", "--light", "point:0,1,0"),
        ("a.glb", "--light", "point:0,1,0", "--light", "sun:0,-1,0"),
        ("a.glb", "--no-antialias"),
        ("a.glb", "--time=-1.5"),
        ("b c.glb",),
    ],
)
def test_the_form_of_a_command_line_means_the_same(words):
    values = parse("render", *words)
    form = parsed_words.get()
    assert parse(*form) == values and parsed_words.get() == form and values != parse("render", "a.glb")
