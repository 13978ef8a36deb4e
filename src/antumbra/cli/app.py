"""The program ``antumbra``: its commands, and the groups of options in their help.

Heavy packages (Numba, trimesh, Rich) are not imported before a command needs them, so ``--help`` appears at once.
"""

import re
from functools import cache
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from ..errors import InputError
from . import bake_command as bake
from . import bench_command as bench
from . import compare_command as compare
from . import dataset_command as dataset
from . import explain_commands as culling
from . import explain_commands as explain
from . import installation_commands as doctor
from . import installation_commands as plans
from . import installation_commands as warmup
from . import render_command as render
from . import scene_commands as build
from . import scene_commands as info
from . import scene_commands as scenes
from . import shards as merge
from . import sight_commands as los
from . import sight_commands as matrix
from . import sight_commands as viewshed
from . import sun_command as sun
from . import view_command as view
from .shards import command_line

# --- Options of a command in groups, such as Camera and Light. Help is plain text, which needs no Rich ----------------


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
"""Title -> parameters below it, besides those that name a title themselves. Others stand below "Options"."""

_LEAST = 12  # options from which groups help


class Grouped(TyperCommand):
    """A command whose help shows its options in groups, if it has many."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        params = self.get_params(ctx)
        grouped = sum(param.param_type_name == "option" for param in params) >= _LEAST
        sections: dict[str, list] = {title: [] for title in ("Arguments", *PANELS, "Options")}
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


# --- The program ``antumbra``: its commands. Each command has a file of its own ---------------------------------------
#
# Heavy packages (Numba, trimesh, Rich) are not imported before a command needs them. So ``--help`` appears at once.


app = typer.Typer(
    name="antumbra",
    help="Which points see which lights: exact ray-traced shadows.",
    epilog="Each command explains itself: antumbra render --help",
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("render")(render.render)
app.command("sun")(sun.sun)
app.command("view", cls=Grouped)(view.view)
app.command("bake")(bake.bake)
app.command("los")(los.los)
app.command("viewshed")(viewshed.viewshed)
app.command("matrix")(matrix.matrix)
app.command("dataset")(dataset.dataset)
app.command("merge")(merge.merge)
app.command("build")(build.build)
app.command("info")(info.info)
app.command("scenes")(scenes.scenes)
app.command("plans")(plans.plans)
app.command("warmup")(warmup.warmup)
app.command("culling")(culling.culling)
app.command("explain")(explain.explain)
app.command("compare")(compare.compare)
app.command("render", cls=Grouped)(render.render)
app.command("build", cls=Grouped)(build.build)
app.command("dataset", cls=Grouped)(dataset.dataset)
app.command("info", cls=Grouped)(info.info)
app.command("scenes", cls=Grouped)(scenes.scenes)
app.command("plans", cls=Grouped)(plans.plans)
app.command("warmup", cls=Grouped)(warmup.warmup)
app.command("doctor", cls=Grouped)(doctor.doctor)
app.command("sun", cls=Grouped)(sun.sun)
app.command("culling", cls=Grouped)(culling.culling)
app.command("explain", cls=Grouped)(explain.explain)
app.command("compare", cls=Grouped)(compare.compare)
app.add_typer(bench.app, name="bench")


def _version(is_set: bool) -> None:
    if is_set:
        from ..version import VERSION as __version__

        print(f"antumbra {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _top(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Say the version.")
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks (also: ANTUMBRA_DEBUG=1).")] = False,
) -> None:
    if context.invoked_subcommand is None:
        print(context.get_help())


@cache
def _commands() -> Any:
    """All commands, as Typer makes them of their functions."""
    return typer.main.get_command(app)


def run(arguments: list[str]) -> object:
    """Run the command that the arguments name; return its exit code or its return value."""
    command_line.set(tuple(arguments))
    command = _commands()
    try:
        return command.main(arguments, prog_name="antumbra", standalone_mode=False)
    except InputError as error:
        raise InputError(_as_option(str(error), command, arguments)) from error


_PARAMETER = re.compile(r"(\w+)(?= ('[^']*' |\([^)]*\) )?(is|belongs|needs) )")


def _as_option(message: str, group: Any, arguments: list[str]) -> str:
    """The message of a function that names a parameter, with the option of the command in its place."""
    match = _PARAMETER.match(message)
    command = next((group.commands[word] for word in arguments if word in group.commands), None)
    for param in getattr(command, "params", ()):
        if match and param.name == match[1] and param.param_type_name == "option":
            return f"{param.opts[0]}{message[match.end() :]}"
    return message
