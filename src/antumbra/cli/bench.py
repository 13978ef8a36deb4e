"""``antumbra bench``: repeats the measurements of the papers, and prints the papers' figures beside ours.

Its commands are functions under the entry point ``antumbra.bench``, and ``all``, which runs them. `antumbra.papers`
announces some; other packages can do the same. The program looks for them when the command is used. `results.benchmark`
gives a command its options --quick and --output. ``all`` passes them on to the commands that have them.
"""

import gc
from pathlib import Path
from time import monotonic
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from ..plugins import announced
from . import report
from .failures import UNFORESEEN, explained, say
from .options import Quiet
from .results import OutputOption, made_folder

_GROUP = "antumbra.bench"


class _Announced(TyperGroup):
    """A group that finds its commands when it is asked for them."""

    def list_commands(self, ctx) -> list[str]:
        return [*super().list_commands(ctx), *announced(_GROUP)]

    def get_command(self, ctx, cmd_name: str):
        return _loaded(cmd_name) if cmd_name in announced(_GROUP) else super().get_command(ctx, cmd_name)


def _loaded(name: str) -> Any:
    """The announced command of this name."""
    alone = typer.Typer(rich_markup_mode=None, add_completion=False)
    alone.command(name)(announced(_GROUP)[name].load())
    return typer.main.get_command(alone)


app = typer.Typer(cls=_Announced, help="Measure what the papers measured.", rich_markup_mode=None)


@app.callback()
def _bench() -> None:
    """Measure the tables and plots of the papers on this machine, with the papers' figures beside ours."""


@app.command("all")
def all_(
    quick: Annotated[bool, typer.Option("--quick", help="Measure less: all in ten minutes on two cores.")] = False,
    output: OutputOption = None,
    quiet: Quiet = False,
) -> int:
    """All other benches, one after the other.

    If one fails, a line on standard error says why, the others follow, and the exit code is 1. After Ctrl-C, files of
    finished benches remain.

    \b
    Examples
      antumbra bench all --quick --output results
    """
    took: dict[str, str] = {}
    names = list(announced(_GROUP))
    with made_folder(output):
        try:
            for k, name in enumerate(names, 1):
                if not quiet:
                    print(f"== antumbra bench {name} ({k} of {len(names)})\n", flush=True)
                start, failed = monotonic(), _run(name, quick, output, quiet)
                took[name] = "failed after " * failed + report.duration(monotonic() - start)
                gc.collect()  # scenes of one bench do not stay in memory beside those of the next
        finally:
            if not quiet:
                report.print_fields(took.items())
    return UNFORESEEN if any(text.startswith("failed") for text in took.values()) else 0


def _run(name: str, quick: bool, output: Path | None, quiet: bool) -> bool:
    """Run a bench. If it fails, say why and return True."""
    try:
        command = _loaded(name)
        options = {
            "quick": ["--quick"] * quick,
            "output": ["--output", str(output)] if output else [],
            "quiet": ["--quiet"] * quiet,
        }
        words = [word for parameter in command.params for word in options.get(parameter.name or "", [])]
        with command.make_context(f"antumbra bench {name}", words) as context:
            command.invoke(context)
    except (BrokenPipeError, typer.Abort):
        raise
    except Exception as error:
        say(f"antumbra bench {name} failed: {explained(error)[0]}")
        return True
    return False
