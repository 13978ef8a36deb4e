"""``antumbra bench``: repeats the measurements of the papers, and prints the papers' figures beside ours.

Its commands are functions under the entry point ``antumbra.bench``. `antumbra.papers` announces some; other packages
can do the same. The program looks for them when the command is used.
"""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

import typer
from typer.core import TyperGroup


@cache
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in sorted(entry_points(group="antumbra.bench"))}


class _Announced(TyperGroup):
    """A group that finds its commands when it is asked for them."""

    def list_commands(self, ctx) -> list[str]:
        return list(_points())

    def get_command(self, ctx, cmd_name: str):
        if cmd_name not in _points():
            return None
        alone = typer.Typer(rich_markup_mode=None, add_completion=False)
        alone.command(cmd_name)(_points()[cmd_name].load())
        return typer.main.get_command(alone)


app = typer.Typer(cls=_Announced, help="Measure what the papers measured.", rich_markup_mode=None)


@app.callback()
def _bench() -> None:
    """Measure the tables and plots of the papers on this machine, with the papers' figures beside ours."""
