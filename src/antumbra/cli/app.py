"""The program ``antumbra``: its commands. Each command has a file of its own.

Heavy packages (Numba, trimesh, Rich) are not imported before a command needs them. So ``--help`` appears at once.
"""

from typing import Annotated

import typer

from . import (
    bake,
    bench,
    build,
    compare,
    culling,
    dataset,
    explain,
    info,
    los,
    matrix,
    plans,
    render,
    scenes,
    sun,
    viewshed,
    warmup,
)

app = typer.Typer(
    name="antumbra",
    help="Which points see which lights: exact ray-traced shadows.",
    epilog="Each command explains itself: antumbra render --help",
    rich_markup_mode=None,
    add_completion=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("render")(render.render)
app.command("sun")(sun.sun)
app.command("bake")(bake.bake)
app.command("los")(los.los)
app.command("viewshed")(viewshed.viewshed)
app.command("matrix")(matrix.matrix)
app.command("dataset")(dataset.dataset)
app.command("build")(build.build)
app.command("info")(info.info)
app.command("scenes")(scenes.scenes)
app.command("plans")(plans.plans)
app.command("warmup")(warmup.warmup)
app.command("culling")(culling.culling)
app.command("explain")(explain.explain)
app.command("compare")(compare.compare)
app.add_typer(bench.app, name="bench")


def _version(wanted: bool) -> None:
    if wanted:
        from .. import __version__

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


def run(arguments: list[str]) -> object:
    """Run the command that the arguments name; return its exit code or its return value."""
    return typer.main.get_command(app).main(arguments, prog_name="antumbra", standalone_mode=False)
