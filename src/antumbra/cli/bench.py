"""``antumbra bench``: what the papers measured, measured on this machine, with their figures beside ours.

Its commands come from packages that announce a function under the entry point ``antumbra.bench``, as `antumbra.papers`
does. They are looked for when the command is used.
"""

from functools import cache
from importlib.metadata import EntryPoint, entry_points

import typer
from typer.core import TyperGroup


@cache
def _points() -> dict[str, EntryPoint]:
    return {point.name: point for point in sorted(entry_points(group="antumbra.bench"))}


class _Announced(TyperGroup):
    """Finds its commands when it is asked for them."""

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
    """Tables and plots of the papers, measured here, with the papers' figures beside."""
