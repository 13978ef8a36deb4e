"""The program ``antumbra``: its commands.

A command's module is imported only when the command runs or explains itself, and heavy packages (Numba, trimesh, Rich)
only when it needs them. So ``--help`` appears at once.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer

from ..base import wings
from ..base.command_registry import COMMANDS, Command
from ..base.errors import InputError
from .command_help import HelpfulCommand, Program
from .completion import completing_words

# --- The program and its commands -------------------------------------------------------------------------------------


_BENCH = "bench", "Repeat the measurements of the papers."


@cache
def program(names: frozenset[str] | None = None) -> typer.Typer:
    """The program.

    names : commands that may run or explain themselves; the others are only listed. None: all
    """
    app = typer.Typer(
        name="antumbra",
        cls=Program,
        help="Find out exactly which points see which lights, by ray tracing.",
        epilog="Options of a command: antumbra render -h",
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    for name, entry in COMMANDS.items():
        function = entry.function(name) if names is None or name in names else _listed
        app.command(name, cls=HelpfulCommand, help=_help_of(function, entry))(function)
    if names is None or _BENCH[0] in names:
        app.add_typer(wings.named(wings.BENCH), name=_BENCH[0])
    else:
        app.command(_BENCH[0], help=_BENCH[1])(_listed)
    app.callback(invoke_without_command=True)(_top)
    return app


def _listed() -> None:
    """A command that is only listed."""


def _help_of(function: Callable[..., Any], entry: Command) -> str | None:
    return entry.help if function is _listed else None


def _version(is_set: bool) -> None:
    if is_set:
        from ..version import VERSION

        print(f"antumbra {VERSION}")
        raise typer.Exit


def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks (also: ANTUMBRA_DEBUG=1).")] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


def run(arguments: list[str]) -> object:
    """Run the command named by the arguments; return its exit code or its return value."""
    named = {*COMMANDS, _BENCH[0]}.intersection(arguments or completing_words())
    names = None if "merge" in arguments else frozenset(named)  # it runs others
    command: Any = typer.main.get_command(program(names))
    try:
        return command.main(arguments, prog_name="antumbra", standalone_mode=False)
    except InputError as error:
        raise InputError(_as_option(str(error), command, arguments)) from error


_PARAMETER = re.compile(r"(\w+)(?= ('[^']*' |\([^)]*\) )?(is|belongs|needs) )")


_CURES = {
    "place=antumbra.Place(latitude, longitude)": "--latitude and --longitude",
    "days such as": "--days, such as",
    "a rule": "--rule",
    "a CRS": "--crs",
    "an EPW file": "--epw",
}
"""What messages for Python advise to give -> the options that give it."""


def _as_option(message: str, group: Any, arguments: list[str]) -> str:
    """An error message with options in the place of a parameter's name at its start, and of what it advises to give."""
    command = next((group.commands[word] for word in arguments if word in group.commands), None)
    options = {each.name: each.opts[0] for each in getattr(command, "params", ()) if each.param_type_name == "option"}
    match = _PARAMETER.match(message)
    if match and match[1] in options:
        return f"{options[match[1]]}{message[match.end() :]}"
    problem, give, cure = message.partition("; give ")
    for words, names in _CURES.items():
        if {*re.findall(r"--\S+\b", names)} <= {*options.values()}:
            cure = cure.replace(words, names)
    return f"{problem}{give}{cure}"
