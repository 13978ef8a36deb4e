"""What the benchmarks of the papers share: options, alternating runs, tables beside published figures, and plots."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from enum import StrEnum
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Annotated, Any, NamedTuple, TypeVar

import typer

from ...base.errors import InputError
from ...base.files import atomic_output
from ...base.progress import clocked_by
from ...cli import console
from ...cli.options import writes
from ..bench_conditions import record_laps

# --- Options ----------------------------------------------------------------------------------------------------------


ImageSize = Annotated[str, typer.Option(help="Image size in pixels.", metavar="WxH")]
Rounds = Annotated[int, typer.Option(help="Repeat each timing; the median counts.", min=1, max=1000)]


class Clock(StrEnum):
    """What times are measured in."""

    wall = "wall"
    cpu = "cpu"


ClockOption = Annotated[
    Clock,
    typer.Option(
        help="Measure elapsed time, or the CPU time of one thread, which other work on the machine affects less."
    ),
]


def checked_clock(clock: Clock, threads: int) -> Clock:
    """`clock`; InputError if it adds up the times of several threads."""
    if clock == Clock.cpu and threads != 1:
        raise InputError(f"--clock cpu adds up the times of {threads} threads; use --threads 1")
    return clock


def clocked(clock: Clock) -> AbstractContextManager[None]:
    """A context in which times are measured by a clock."""
    return clocked_by(process_time if clock == Clock.cpu else perf_counter)


def table_option() -> Any:
    """The repeatable option --table."""
    return typer.Option(help="Measure only this table; may be repeated.  [default: all]", show_default=False)


def scene_option(default: str, files: str = "a file") -> Any:
    """The repeatable option --scene. `default` describes the default scenes, and `files` what it also accepts."""
    help = f"A folder of $ANTUMBRA_SCENES, {files}, or a procedural scene; may be repeated.  [default: {default}]"
    return typer.Option(help=help, metavar="SCENE", show_default=False)


def plot_option(contents: str) -> Any:
    """The option --plot, which writes `contents` to a .png file."""
    return typer.Option(
        help=f"Plot {contents} to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")
    )


def check_plot_of_all(options: Any) -> None:
    """Raise an InputError if a plot of all tables is requested, but only some are measured."""
    if options.plot is not None and options.table:
        raise InputError("--plot draws all tables; omit --table, or use --output, which joins tables measured alone")


# --- Runs -------------------------------------------------------------------------------------------------------------


Say = Callable[[str], None]
Case = TypeVar("Case")
Lap = TypeVar("Lap")


def interleave(
    cases: Iterable[Case], rounds: int, measure: Callable[[Case, int], Lap | None], warm_up: int = 0
) -> dict[Case, list[Lap]]:
    """Measure all cases in each round, so that they take turns; return the results of each case.

    The results of the benchmark record rounds and the spread of timings (`bench_conditions.record_laps`) if there are
    several rounds.

    measure : called with a case and a round
    warm_up : number of rounds before round 0, with negative numbers, whose results are dropped, as None always is
    """
    laps: dict[Case, list[Lap]] = {case: [] for case in cases}
    for turn in range(-warm_up, rounds):
        for case, results in laps.items():
            lap = measure(case, turn)
            if turn >= 0 and lap is not None:
                results.append(lap)
    for results in laps.values() if rounds > 1 else ():
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


ROUNDS = 3
"""Rounds below which a table shows how often a time was measured."""


def few_rounds(text: str, rounds: int | None) -> str:
    """A time as text, with the number of its rounds if these are few; None: it was not measured."""
    return text if rounds is None or rounds >= ROUNDS else f"{text} ({rounds} round{'s' * (rounds > 1)})"


def percent(share: float) -> str:
    """A share in per cent."""
    return f"{100 * share:.0f}"


def records(rows: Iterable[Any], *properties: str) -> list[dict[str, Any]]:
    """NamedTuples as JSON objects, with digests in hexadecimal and some of their properties."""
    plain = lambda value: value.hex() if isinstance(value, bytes) else value
    return [{name: plain(getattr(row, name)) for name in (*row._fields, *properties)} for row in rows]


# --- Plots ------------------------------------------------------------------------------------------------------------


SHEET_WIDTH = 7.4  # inches, of all plots: pages of the docs show letters of 8 points 11 pixels high
_PIXELS = 1480  # width of all plots
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
def plot_sheet(path: Path, height: float) -> Iterator[Any]:
    """A Matplotlib figure of this height in inches, which is written to a .png file at the end of the block.

    In the block, `PLOT_STYLE` applies.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(PLOT_STYLE):
        sheet = Figure(figsize=(SHEET_WIDTH, height), layout="constrained")
        yield sheet
        save_sheet(sheet, path)


def save_sheet(sheet: Any, path: Path) -> None:
    """Write a Matplotlib figure to a .png file."""
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=_PIXELS / sheet.get_figwidth())
