"""The program ``antumbra``: its commands, and the option groups in their help.

A command's module is imported only when the command runs or explains itself, and heavy packages (Numba, trimesh, Rich)
only when it needs them. So ``--help`` appears at once.
"""

import re
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Annotated, Any, NamedTuple

import typer
from typer.core import TyperCommand, TyperGroup

from ..base.errors import InputError
from .command_parsing import ParsedOnce

# --- Commands: option groups of the help, which is plain text without Rich --------------------------------------------


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


class Program(ParsedOnce, TyperGroup):
    """The program."""


class Command(ParsedOnce, TyperCommand):
    """A command."""


class Grouped(Command):
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


class CommandEntry(NamedTuple):
    """A command: where it is defined, and its line in the help, which is the first line of its docstring."""

    module: str
    help: str
    grouped: bool = True  # whether its help groups its options if there are many

    def function(self, name: str) -> Callable[..., Any]:
        """The command's function, whose module is imported."""
        function: Callable[..., Any] = getattr(import_module(f"antumbra.{self.module}"), name.replace("-", "_"))
        return function


COMMANDS = {
    "render": CommandEntry("cli.render_command", "Render SCENE with exact shadows."),
    "sun": CommandEntry("city.sun.sun_command", "Find the hours of direct sun on the surfaces of SCENE."),
    "shadow": CommandEntry("city.shadow.shadow_command", "Find the shadow on the ground of SCENE, as polygons."),
    "view": CommandEntry("cli.view_command", "Show SCENE in the browser, until Ctrl-C."),
    "bake": CommandEntry(
        "cli.bake_command", "Bake occlusion, shadows or light of SCENE into a copy of its glTF file.", grouped=False
    ),
    "los": CommandEntry(
        "city.sight.sight_commands",
        "Find which points see each other in SCENE, and what blocks the others.",
        grouped=False,
    ),
    "viewshed": CommandEntry(
        "city.sight.sight_commands", "Count the observers that see each sensor of SCENE.", grouped=False
    ),
    "visible": CommandEntry(
        "city.sight.visible_command", "Find the share of a target in SCENE that each sensor sees.", grouped=False
    ),
    "matrix": CommandEntry(
        "city.sight.sight_commands",
        "Find which sensors of SCENE see which targets, as one bit per pair.",
        grouped=False,
    ),
    "skyline": CommandEntry(
        "city.skyline.skyline_command",
        "Find the skyline of points in SCENE: the elevation of the horizon by azimuth.",
        grouped=False,
    ),
    "view-factors": CommandEntry(
        "city.view_factors.view_factors_command",
        "Find the view factors between the surfaces of SCENE, and of the sky.",
        grouped=False,
    ),
    "dataset": CommandEntry(
        "cli.dataset_command",
        "Render a data set of SCENE: per camera, a multi-layer EXR and a shadow mask of each light.",
    ),
    "merge": CommandEntry(
        "cli.shards",
        "Join the shards of a command into the files it writes without --shard, byte for byte.",
        grouped=False,
    ),
    "build": CommandEntry("cli.scene_commands", "Combine SCENEs in one store, which may exceed memory."),
    "info": CommandEntry("cli.scene_commands", "Show the contents of SCENE."),
    "scenes": CommandEntry(
        "cli.scene_commands", "List the procedural and the example scenes, or export a procedural one."
    ),
    "formats": CommandEntry("cli.scene_commands", "List the file formats of scenes, and what is lost in them."),
    "plans": CommandEntry("cli.installation_commands", "List the methods, and the plans they form."),
    "warmup": CommandEntry(
        "cli.installation_commands",
        "Compile all kernels ahead of time, store them on disk, and calibrate the plan auto.",
    ),
    "culling": CommandEntry("lab.explain_commands", "Show which triangles of SCENE survive pre-BVH culling."),
    "explain": CommandEntry(
        "lab.explain_commands", "Show where plans spend the traversal steps of SCENE's shadow rays."
    ),
    "compare": CommandEntry("lab.compare_command", "Measure plans on the same picture of SCENE, side by side."),
    "doctor": CommandEntry(
        "cli.installation_commands",
        "Check this installation: versions, processor, kernels on disk, optional packages, and a small query.",
    ),
}
"""Name -> command, in the order of the help. The function has the same name, with _ for -."""

_BENCH = "bench", "Measure what the papers measured."


@cache
def program(names: frozenset[str] | None = None) -> typer.Typer:
    """The program.

    names : commands that may run or explain themselves; the others are only listed. None: all
    """
    app = typer.Typer(
        name="antumbra",
        cls=Program,
        help="Which points see which lights: exact ray-traced shadows.",
        epilog="Each command explains itself: antumbra render --help",
        rich_markup_mode=None,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    for name, entry in COMMANDS.items():
        function = entry.function(name) if names is None or name in names else _listed
        app.command(name, cls=Grouped if entry.grouped else Command, help=_help_of(function, entry))(function)
    if names is None or _BENCH[0] in names:
        from ..lab import bench_command

        app.add_typer(bench_command.app, name=_BENCH[0])
    else:
        app.command(_BENCH[0], help=_BENCH[1])(_listed)
    app.callback(invoke_without_command=True)(_top)
    return app


def _listed() -> None:
    """A command that is only listed."""


def _help_of(function: Callable[..., Any], entry: CommandEntry) -> str | None:
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
    names = (
        None if "merge" in arguments else frozenset({*COMMANDS, _BENCH[0]}.intersection(arguments))
    )  # it runs others
    command: Any = typer.main.get_command(program(names))
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
