"""``antumbra bench multi-frusta``: Tables 1 and 2, and Figure 6, of the multi-frusta paper."""

from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments, report
from ...cli.options import Json, Quiet
from ...cli.progress import ProgressDisplay

if TYPE_CHECKING:
    from .measure import Case


def multi_frusta(
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, or a procedural scene; may be repeated.  [default: two folders "
            "of $ANTUMBRA_SCENES if they are there, and forest]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "512x512",
    rounds: Annotated[int, typer.Option(help="Measurements of each time; the median counts.", min=1, max=1000)] = 5,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Multi-frusta tracing beside packets: accesses, tests and times [Benthin and Wald 2009].

    Each run uses one thread and 16 shadow rays a pixel to a square light. Table 1 compares the paper's tracer and ours
    with packets of 16 rays. Table 2 compares three ways of frustum shrinking. Figure 6 has lights of 1/4 to 8 times the
    edge. All give the same bits.

    \b
    Examples
      antumbra bench multi-frusta
      antumbra bench multi-frusta --scene forest --size 256 --rounds 3
    """
    width_height = arguments.parse_size(size)

    from ..views import open_view
    from . import measure as bench

    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or bench.default_names())
        views = [open_view(name, width_height, bench.quad_view) for name in names]
        found = {}
        for view in views:
            case = bench.case_of(view)
            found[view.name] = case, bench.tables(case, rounds, display.say)
    if json:
        rows = {name: tables for name, (_, tables) in found.items()}
        report.print_json({"size": width_height, "rounds": rounds, "rows": rows, "same_bits": True})
        return
    for case, tables in found.values() if not quiet else ():
        _print_table1(case, tables["table 1"])
        _print_table2(case, tables["table 2"])
        _print_figure6(case, tables["figure 6"])
        report.print_fields([("bits", "the same by all methods")])


_NAMES = ("#tris", "+culling", "#AABB", "#isec")


def _print_table1(case: "Case", rows: dict) -> None:
    from . import published as paper
    from .measure import BASELINES, TABLE1

    rays = rows[TABLE1[0]]["rays"]
    print(f"Table 1, {case.name}: {len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays")
    table = [
        (t, *(f"{r[c] / 1e3:,.0f}K" for c in paper.COLUMNS), f"{r['seconds']:.3f}", f"{rays / r['seconds'] / 1e6:.2f}")
        for t, r in rows.items()
    ]
    report.print_table(("tracer", *_NAMES, "seconds", "M rays/s"), table, right=range(1, 7))
    for base in BASELINES:
        print(f"Times less than {base} (Table 1; the paper's range)")
        less = []
        for tracer in TABLE1[2:]:
            counts = (f"{rows[base][c] / max(rows[tracer][c], 1):.2f}" for c in paper.COLUMNS)
            less.append((tracer, *counts, f"{rows[base]['seconds'] / rows[tracer]['seconds']:.2f}"))
        report.print_table(("tracer", *_NAMES, "seconds"), [*less, ("the paper", *paper.TABLE1)], right=range(1, 6))


def _print_table2(case: "Case", rows: dict) -> None:
    from . import published as paper
    from .measure import TABLE2

    none, table = rows[TABLE2[0]], []
    for tracer, r in rows.items():
        change = (f"{100 * (r[c] / max(none[c], 1) - 1):+.1f}" for c in paper.COLUMNS)
        more = f"{r['shrinks'] / 1e3:,.0f}K", f"{none['seconds'] / r['seconds']:.2f}"
        table.append((tracer, *change, paper.TABLE2[tracer], *more))
    print(f"Table 2, {case.name}: change in %; the paper's of T-Rex beside it")
    head = ("tracer", *_NAMES, "the paper", "shrinks", "times as fast")
    report.print_table(head, table, right=(1, 2, 3, 4, 6, 7))


def _print_figure6(case: "Case", sizes: dict) -> None:
    from .measure import FIGURE6

    cell = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    table = [(tracer, *(cell(rows[tracer]) for rows in sizes.values())) for tracer in FIGURE6]
    print(f"Figure 6, {case.name}: #tris and #isec, in thousands, by the light's edge")
    report.print_table(("tracer", *sizes), table, right=range(1, 1 + len(sizes)))
