"""``antumbra bench``: repeats the measurements of the papers, and prints the papers' figures beside ours.

Its commands are functions under the entry point ``antumbra.bench``. `antumbra.papers` announces some; other packages
can do the same. The program looks for them when the command is used.
"""

import typer
from typer.core import TyperGroup

from ..plugins import announced

_GROUP = "antumbra.bench"


class _Announced(TyperGroup):
    """A group that finds its commands when it is asked for them."""

    def list_commands(self, ctx) -> list[str]:
        return list(announced(_GROUP))

    def get_command(self, ctx, cmd_name: str):
        point = announced(_GROUP).get(cmd_name)
        if point is None:
            return None
        alone = typer.Typer(rich_markup_mode=None, add_completion=False)
        alone.command(cmd_name)(point.load())
        return typer.main.get_command(alone)


app = typer.Typer(cls=_Announced, help="Measure what the papers measured.", rich_markup_mode=None)


@app.callback()
def _bench() -> None:
    """Measure the tables and plots of the papers on this machine, with the papers' figures beside ours."""
