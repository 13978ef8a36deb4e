"""The help of commands: -h, --help, and the list of commands."""

import re

import pytest
import typer

from antumbra.base.command_registry import COMMANDS
from antumbra.cli.app import program
from antumbra.cli.command_help import PANELS

PROGRAM = typer.main.get_command(program())


@pytest.fixture(autouse=True)
def _width(monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERMINAL_WIDTH", "80")


def titles_in(text: str) -> list[str]:
    return re.findall(r"^(\w[\w ]*):$", text, re.M)


def test_commands_are_listed_in_groups(cli):
    shown = cli("--help").out
    groups = list(dict.fromkeys(command.group for command in COMMANDS.values()))
    assert titles_in(shown) == ["Options", *groups] and len(groups) > 4
    for name, command in COMMANDS.items():
        assert len(command.help) <= 55 and re.search(rf"^  {name} +{re.escape(command.help)}$", shown, re.M), name


def test_options_stand_in_groups(cli):
    shown = cli("render", "--help").out
    assert titles_in(shown) == [title for title in PANELS if f"\n{title}:\n" in shown] and len(titles_in(shown)) > 8
    light = shown[shown.index("\nLight:\n") : shown.index("\nOutput:\n")]
    assert "--vpl" in light and "--spp" not in light
    assert "\nLight:\n" not in cli("plans", "--help").out


@pytest.mark.parametrize("name", COMMANDS)
def test_help_names_values_as_users_know_them(name, cli):
    shown = cli(name, "--help").out
    found = re.search(r"<|list\[|\bint\b|\bstr\b|float range|<=x|None", shown)
    assert found is None, shown[found.start() - 60 : found.end()]


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_has_a_line_for_each_main_option(name, cli):
    short, whole = cli(name, "-h").out, cli(name, "--help").out
    lines = short.splitlines()
    assert len(lines) <= 50 and all(len(line) <= 80 for line in lines if " antumbra " not in f" {line.strip()} ")
    assert lines[-1] == f"All options: antumbra {name} --help" and COMMANDS[name].help in short
    listed = set(re.findall(r"^  (?:-\w, )?(--[\w-]+)", short, re.M))
    assert "--help" in listed and listed <= set(re.findall(r"--[\w-]+", whole))


@pytest.mark.parametrize("name", COMMANDS)
def test_the_short_help_is_cut_only_after_a_clause(name, cli):
    cut = re.findall(r"^.* …$", cli(name, "-h").out, re.M)
    assert [line for line in cut if line[-3] not in ",;:"] == []


def test_the_short_help_is_asked_for_anywhere(cli, square_obj):
    assert cli("render", square_obj, "-h").out == cli("render", "-h").out
    assert cli("render", "--", "-h").code == 2  # the name of a file


def test_titles_are_bold_in_a_terminal_only(cli, monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr("antumbra.cli.command_help.is_coloured", lambda stream: True)
    assert "\033[1mOptions:\033[0m" in PROGRAM.commands["sun"].get_help(typer.Context(PROGRAM.commands["sun"]))
    monkeypatch.undo()
    assert "\033" not in cli("sun", "--help").out + cli("info").err
