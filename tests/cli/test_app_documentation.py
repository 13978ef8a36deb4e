"""The commands and options in the documentation, and in the help of commands, exist."""

import re
import shlex

import pytest
import typer

from antumbra.cli.app import program
from repository import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")), *sorted((ROOT / "docs").glob("[jt]*/*.md"))]
COMMANDS = typer.main.get_command(program()).commands
OTHER = {"--install-completion", "--help", "--version", "--debug"}  # of the program, and of no command


def options_of(command) -> set[str]:
    found = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    if isinstance(command, typer.core.TyperGroup):
        context = typer.Context(command)
        found.update(*(options_of(command.get_command(context, name)) for name in command.list_commands(context)))
    return found


def lines_of(text: str) -> list[list[str]]:
    """The words of all lines that call the program."""
    joined = re.sub(r"\\\n\s*", " ", text)
    lines = re.findall(r"^\s*(?:for .*; do )?(antumbra [a-z].*)$", joined, re.M)
    return [shlex.split(re.split(r" [|&;>] ?| #", line)[0], comments=False) for line in lines]


def unknown(words: list[str]) -> set[str]:
    """The words of a line that no option of its command is."""
    if words[1] not in COMMANDS:
        return {words[1]}
    given = {word.partition("=")[0] for word in words if re.match(r"--[a-z]", word)}
    return given - options_of(COMMANDS[words[1]]) - OTHER


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_commands_of_a_page(page):
    blocks = "\n".join(re.findall(r"^```(?:sh|bash|console)\n(.*?)^```", page.read_text(), re.M | re.S))
    assert not set().union(*map(unknown, lines_of(blocks)))


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_in_the_help_of_a_command(name):
    assert not set().union(*map(unknown, lines_of(COMMANDS[name].help or "")))


def test_options_in_the_text_exist_somewhere():
    known = set().union(OTHER, *map(options_of, COMMANDS.values()))
    told = {
        name: set(re.findall(r"`(--[a-z][a-z-]*)", (ROOT / "docs" / name).read_text()))
        for name in (
            "cli.md",
            *(f"{at}/{page.name}" for at in ("cli", "jobs") for page in (ROOT / "docs" / at).glob("*.md")),
        )
    }
    assert sum(map(len, told.values())) > 50
    assert {name: options - known for name, options in told.items() if options - known} == {}
