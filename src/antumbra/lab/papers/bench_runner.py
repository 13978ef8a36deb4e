"""What the benchmarks of the papers share: options, alternating runs, tables beside published figures, and plots."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from typing import Annotated, Any, NamedTuple, TypeVar

import typer

from ...base.files import atomic_output
from ...cli import console
from ...cli.options import writes
from ..bench_conditions import record_laps

# --- Options ----------------------------------------------------------------------------------------------------------


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


# --- Runs -------------------------------------------------------------------------------------------------------------


Say = Callable[[str], None]
Case = TypeVar("Case")
Lap = TypeVar("Lap")


def interleave(
    cases: Iterable[Case], rounds: int, measure: Callable[[Case, int], Lap | None], warm_up: int = 0
) -> dict[Case, list[Lap]]:
    """Measure all cases in each round, so that they take turns; return the results of each case.

    The results of the benchmark record the spread of its timings (`bench_conditions.record_laps`).

    measure : called with a case and a round
    warm_up : number of rounds before round 0, with negative numbers, whose results are dropped, as None always is
    """
    laps: dict[Case, list[Lap]] = {case: [] for case in cases}
    for turn in range(-warm_up, rounds):
        for case, results in laps.items():
            lap = measure(case, turn)
            if turn >= 0 and lap is not None:
                results.append(lap)
    for results in laps.values():
        record_laps(results)
    return laps


def medians(laps: Sequence[Mapping[Case, float]]) -> dict[Case, float]:
    """The median of each value over several laps."""
    return {name: median(lap[name] for lap in laps) for name in laps[0]}


def round_text(turn: int, rounds: int) -> str:
    """The round as text for people; rounds that warm up count as the first."""
    return f"round {max(turn, 0) + 1} of {rounds}"


# --- Tables -----------------------------------------------------------------------------------------------------------


_WIDTH = 170  # width of the tables, in characters


class TableColumn(NamedTuple):
    """A column of a table: how to write its cell in a measured row, and in a published row."""

    head: str
    cell: Callable[[Any], str]
    published: Callable[[Any], str] | None = None  # None: the paper has no such figure
    right: bool = True  # whether to align it right, as numbers are


def label(head: str, cell: Callable[[Any], str] | str, published: Callable[[Any], str] | None = None) -> TableColumn:
    """A column of text. `cell` may be the name of a row's attribute."""
    return TableColumn(head, attribute(cell) if isinstance(cell, str) else cell, published, right=False)


def columns_of(
    heads: Mapping[Case, str],
    cell: Callable[[Any, Case], str],
    published: Callable[[Any, Case], str] | None = None,
) -> list[TableColumn]:
    """A column per case. `heads` maps cases to heads; `cell` and `published` take a row and a case."""

    def column(case: Case, head: str) -> TableColumn:
        theirs = (lambda row: published(row, case)) if published else None
        return TableColumn(head, lambda row: cell(row, case), theirs)

    return [column(case, head) for case, head in heads.items()]


def attribute(name: str) -> Callable[[Any], str]:
    """A cell that shows an attribute of a row."""
    return lambda row: str(getattr(row, name))


def item(k: int, write: Callable[[Any], str] = str) -> Callable[[Any], str]:
    """A cell that shows item `k` of a row."""
    return lambda row: write(row[k])


def print_table(title: str, columns: Sequence[TableColumn], rows: Iterable[Any], published: Iterable[Any] = ()) -> None:
    """Print a table of measured rows, followed by the published rows."""
    table = [[column.cell(row) for column in columns] for row in rows]
    table += [[column.published(row) if column.published else "" for column in columns] for row in published]
    right = [k for k, column in enumerate(columns) if column.right]
    print(title)
    console.print_table([column.head for column in columns], table, right=right, width=_WIDTH)


def print_notes(notes: Iterable[tuple[str, str]]) -> None:
    """Print names and values below a table."""
    console.print_fields(notes)
    print()


def beside(ours: str, theirs: float | None, digits: int = 1) -> str:
    """Our figure, with the published one in brackets if there is one."""
    return ours if theirs is None else f"{ours} ({theirs:.{digits}f})"


def ms(seconds: float | None) -> str:
    """Seconds in milliseconds; None: empty."""
    return "" if seconds is None else f"{1e3 * seconds:,.1f}"


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100 * share:.0f}"


def records(rows: Iterable[Any], *properties: str) -> list[dict[str, Any]]:
    """NamedTuples as JSON objects, with digests in hexadecimal and some of their properties."""
    plain = lambda value: value.hex() if isinstance(value, bytes) else value
    return [{name: plain(getattr(row, name)) for name in (*row._fields, *properties)} for row in rows]


# --- Plots ------------------------------------------------------------------------------------------------------------


PLOT_STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 10.0,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "legend.fontsize": 8.0,
    "legend.frameon": False,
}
"""Matplotlib's settings for the plots of all papers."""


@contextmanager
def plot_sheet(path: Path, width: float, height: float) -> Iterator[Any]:
    """A Matplotlib figure of this size in inches, which is written to a .png file at the end of the block.

    In the block, `PLOT_STYLE` applies.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(PLOT_STYLE):
        sheet = Figure(figsize=(width, height), layout="constrained")
        yield sheet
        save_sheet(sheet, path)


def save_sheet(sheet: Any, path: Path) -> None:
    """Write a Matplotlib figure to a .png file."""
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)
