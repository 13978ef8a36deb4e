"""One word for one thing: an option means the same in all commands, and its value has the same name in their help."""

import re
from collections import defaultdict
from pathlib import Path

import pytest
import typer

from antumbra.cli.app import program

COMMANDS = {
    name: each for name, each in typer.main.get_command(program()).commands.items() if name not in ("bench", "doctor")
}
GLOSSARY = Path(__file__).parents[2] / "docs/design/glossary.md"


def values() -> dict[str, set[str]]:
    """Option -> names of its values in the help of the commands; "" for a switch."""
    found = defaultdict(set)
    for command in COMMANDS.values():
        for param in command.get_params(typer.Context(command)):
            if param.param_type_name == "option" and param.name != "help":
                found[param.opts[0]].add("" if param.is_flag else param.metavar)
    return found


def documented() -> dict[str, set[str]]:
    """Option -> names of its values in the glossary."""
    found = defaultdict(set)
    for row in GLOSSARY.read_text("utf-8").splitlines():
        if row.startswith("| `--"):
            options, names, _ = (cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", row)[1:-1])
            for some, texts in zip(options.split("; "), names.split("; "), strict=True):
                for option in re.findall(r"`(--[\w-]+)`", some):
                    found[option] |= set(texts.replace(" or ", ", ").split(", "))
    return found


@pytest.mark.parametrize("option", sorted(values()))
def test_the_value_of_an_option_has_one_name(option):
    found, allowed = values()[option], documented()
    assert found <= allowed[option] if option in allowed else len(found) == 1, found


def test_the_glossary_lists_options_and_values_that_commands_have():
    found, listed = values(), documented()
    assert len(listed) >= 20
    for option, names in listed.items():
        assert names == found[option], option


def test_no_value_is_named_by_a_type():
    assert not {name for names in values().values() for name in names} & {None, "FLOAT", "INTEGER", "PATH", "STR"}
