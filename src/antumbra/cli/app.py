"""The program ``antumbra``: its commands, and the option groups in their help.

Heavy packages (Numba, trimesh, Rich) are imported only when a command needs them, so ``--help`` appears at once.
"""

import re
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ..errors import InputError
from . import (
    bake_command,
    bench_command,
    compare_command,
    dataset_command,
    explain_commands,
    installation_commands,
    render_command,
    scene_commands,
    shards,
    sight_commands,
    sun_command,
    view_command,
)
from .shards import command_line

# --- Option groups of the help, which is plain text without Rich ------------------------------------------------------


PANELS: dict[str, tuple[str, ...]] = {
    "Scene": ("up",),
    "Camera": ("camera", "size"),
    "Light": ("light", "sky", "ao", "vpl", "exposure"),
    "Quality": ("preset",),
    "Animation": ("frames", "fps", "overwrite"),
    "Speed": ("plan", "explain_plan"),
    "Machines": ("shard", "ray"),
    "Output": ("output", "html", "json", "quiet"),
}
"""Title -> its parameters, besides those that name a title themselves. All others are listed under "Options"."""

_LEAST = 12  # least number of options that are grouped


class Grouped(TyperCommand):
    """A command whose help groups its options if there are many."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        params = self.get_params(ctx)
        grouped = sum(param.param_type_name == "option" for param in params) >= _LEAST
        sections: dict[str, list[tuple[str, str]]] = {title: [] for title in ("Arguments", *PANELS, "Options")}
        for param in params:
            record = param.get_help_record(ctx)
            if record is not None:
                sections[_title(param) if grouped or param.param_type_name == "argument" else "Options"].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def _title(param: Any) -> str:
    if param.param_type_name == "argument":
        return "Arguments"
    panel = getattr(param, "rich_help_panel", None)
    return panel or next((title for title, names in PANELS.items() if param.name in names), "Options")


# --- The program and its commands -------------------------------------------------------------------------------------


COMMANDS: dict[str, Callable[..., Any]] = {
    "render": render_command.render,
    "sun": sun_command.sun,
    "view": view_command.view,
    "bake": bake_command.bake,
    "los": sight_commands.los,
    "viewshed": sight_commands.viewshed,
    "matrix": sight_commands.matrix,
    "dataset": dataset_command.dataset,
    "merge": shards.merge,
    "build": scene_commands.build,
    "info": scene_commands.info,
    "scenes": scene_commands.scenes,
    "formats": scene_commands.formats,
    "plans": installation_commands.plans,
    "warmup": installation_commands.warmup,
    "culling": explain_commands.culling,
    "explain": explain_commands.explain,
    "compare": compare_command.compare,
    "doctor": installation_commands.doctor,
}
"""Name -> function, in the order of the help."""

_UNGROUPED = "bake", "los", "viewshed", "matrix", "merge"  # commands whose help lists all options under one title

app = typer.Typer(
    name="antumbra",
    help="Which points see which lights: exact ray-traced shadows.",
    epilog="Each command explains itself: antumbra render --help",
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _name, _command in COMMANDS.items():
    app.command(_name, cls=TyperCommand if _name in _UNGROUPED else Grouped)(_command)
app.add_typer(bench_command.app, name="bench")


def _version(is_set: bool) -> None:
    if is_set:
        from ..version import VERSION

        print(f"antumbra {VERSION}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks (also: ANTUMBRA_DEBUG=1).")] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@cache
def _commands() -> Any:
    """The Click command that Typer builds from the program."""
    return typer.main.get_command(app)


def run(arguments: list[str]) -> object:
    """Run the command named by the arguments; return its exit code or its return value."""
    command_line.set(tuple(arguments))
    command = _commands()
    try:
        return command.main(arguments, prog_name="antumbra", standalone_mode=False)
    except InputError as error:
        raise InputError(_as_option(str(error), command, arguments)) from error


_PARAMETER = re.compile(r"(\w+)(?= ('[^']*' |\([^)]*\) )?(is|belongs|needs) )")


def _as_option(message: str, group: Any, arguments: list[str]) -> str:
    """An error message that starts with a parameter's name, with the command-line option in its place."""
    match = _PARAMETER.match(message)
    command = next((group.commands[word] for word in arguments if word in group.commands), None)
    for param in getattr(command, "params", ()):
        if match and param.name == match[1] and param.param_type_name == "option":
            return f"{param.opts[0]}{message[match.end() :]}"
    return message
