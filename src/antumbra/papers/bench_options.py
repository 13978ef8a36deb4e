"""Options and output that several commands of ``antumbra bench`` share."""

from collections.abc import Callable, Iterable
from typing import Annotated, Any

import typer

from ..cli import console as report
from ..cli.options import writes
from .benchmark_views import BenchmarkView, open_view

ImageSize = Annotated[str, typer.Option(help="Image size in pixels.", metavar="WxH")]
Rounds = Annotated[int, typer.Option(help="Repeat each timing; the median counts.", min=1, max=1000)]


def scene_option(default: str, files: str = "a file") -> Any:
    """The repeatable option --scene. `default` describes the default scenes, and `files` what it also accepts."""
    help = f"A folder of $ANTUMBRA_SCENES, {files}, or a procedural scene; may be repeated.  [default: {default}]"
    return typer.Option(help=help, metavar="SCENE", show_default=False)


def plot_option(contents: str) -> Any:
    """The option --plot, which writes `contents` to a .png file."""
    return typer.Option(
        help=f"Plot {contents} to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")
    )


def open_views(
    names: Iterable[str],
    size: tuple[int, int],
    named_view: Callable[[str, tuple[int, int]], BenchmarkView],
    say: Callable[[str], None],
) -> list[BenchmarkView]:
    """The views of distinct names."""
    say("opening the scenes")
    return [open_view(name, size, named_view) for name in dict.fromkeys(names)]


def print_agreement(same: bool) -> None:
    """Print whether all methods return the same bits."""
    report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])
