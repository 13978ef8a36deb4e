"""``antumbra bench multi-frusta``: the tables of the multi-frusta paper, and Figures 5 to 7."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments
from ...cli import console as report
from ...cli.bench_command import Results, benchmark
from ...cli.console import ProgressDisplay
from ...cli.options import Json, Quiet, writes
from ...rendering.options import CullFaces

if TYPE_CHECKING:
    from .measure import Case
    from .quality import Quality


@benchmark(size="160x160", rounds=1)
def multi_frusta(
    results: Results,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, or a procedural scene; may be repeated.  [default: two folders "
            "of $ANTUMBRA_SCENES if they are there, and forest]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Write Figures 5 to 7 to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "512x512",
    cull_faces: Annotated[
        CullFaces, typer.Option(help="The side of triangles that blocks no shadow ray; back, as published.")
    ] = CullFaces.back,
    rounds: Annotated[int, typer.Option(help="Measurements of each time; the median counts.", min=1, max=1000)] = 5,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Multi-frusta tracing beside packets: accesses, tests and times [Benthin and Wald 2009].

    Each run uses one thread and 16 shadow rays a pixel to a square light. Table 1 compares the paper's tracer and ours
    with packets of 16 rays, for primary rays and for shadow rays. Section 5.2 has packets of 256 rays. Table 2 compares
    three ways of frustum shrinking. Figure 5 compares 16 filtered samples with 256. Figure 6 has lights of 1/4 to 8
    times the edge. Figure 7 counts the pixels at silhouettes. All give the same bits.

    \b
    Examples
      antumbra bench multi-frusta
      antumbra bench multi-frusta --scene forest --size 256 --rounds 3 --plot forest.png
    """
    width_height = arguments.parse_size(size)

    from ..views import open_view
    from . import measure as bench
    from . import quality

    plots = results.plots(plot)
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or bench.default_names())
        views = [open_view(name, width_height, bench.quad_view) for name in names]
        found = {}
        for view in views:
            case = bench.case_of(view, cull_faces.side)
            found[view.name] = case, bench.tables(case, rounds, display.say), quality.measure(case, display.say)
        for path in plots:
            from .plot import write_plot

            write_plot({name: (tables, shown) for name, (_, tables, shown) in found.items()}, path)
    rows = {
        name: {**tables, "figure 5": shown.rows, "figure 7": {"edges": shown.edges}}
        for name, (_, tables, shown) in found.items()
    }
    asked = {"size": width_height, "rounds": rounds, "cull_faces": cull_faces.side}
    with results.told({**asked, "rows": rows, "same_bits": True}):
        for case, tables, shown in found.values():
            _print_primary(case, tables["table 1 primary"])
            _print_table1(case, tables["table 1"])
            _print_packet256(tables["table 1"])
            _print_table2(case, tables["table 2"])
            _print_figure5(case, shown)
            _print_figure6(case, tables["figure 6"])
            _print_figure7(case, shown)
            report.print_fields([("bits", "the same by all methods")])


_NAMES = ("#tris", "+culling", "#AABB", "#isec")


def _print_primary(case: "Case", rows: dict) -> None:
    """Print the P rows of Table 1, without shading."""
    from . import published as paper

    _print_counts(f"Table 1, {case.name}, primary rays", case, rows)
    _print_reduction(rows, "packet16", ("multifrusta",), paper.PRIMARY)


def _print_table1(case: "Case", rows: dict) -> None:
    """Print the S rows of Table 1."""
    from . import published as paper
    from .measure import BASELINES, TABLE1

    _print_counts(f"Table 1, {case.name}, shadow rays", case, rows)
    for base in BASELINES:
        _print_reduction(rows, base, TABLE1[2:], paper.TABLE1)


def _print_counts(title: str, case: "Case", rows: dict) -> None:
    from . import published as paper

    rays = next(iter(rows.values()))["rays"]
    print(f"{title}: {len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays")
    table = [
        (t, *(f"{r[c] / 1e3:,.0f}K" for c in paper.COLUMNS), f"{r['seconds']:.3f}", f"{rays / r['seconds'] / 1e6:.2f}")
        for t, r in rows.items()
    ]
    report.print_table(("tracer", *_NAMES, "seconds", "M rays/s"), table, right=range(1, 7))


def _print_reduction(rows: dict, base: str, tracers: tuple[str, ...], theirs: tuple[str, ...]) -> None:
    """Print how many times less than `base` some tracers count and take, and the paper's range."""
    from . import published as paper

    print(f"Times less than {base} (Table 1; the paper's range)")
    less = []
    for tracer in tracers:
        counts = (f"{rows[base][c] / max(rows[tracer][c], 1):.2f}" for c in paper.COLUMNS)
        less.append((tracer, *counts, f"{rows[base]['seconds'] / rows[tracer]['seconds']:.2f}"))
    report.print_table(("tracer", *_NAMES, "seconds"), [*less, ("the paper", *theirs)], right=range(1, 6))


def _print_packet256(rows: dict) -> None:
    """Print the comparison of Sec. 5.2. The paper counts a box once for all 256 rays, as a node is counted here."""
    from . import published as paper

    many, frusta, packets = (rows[t] for t in ("packet256", "multifrusta:paper", "packet16"))
    change = f"{100 * (many['nodes'] / max(frusta['nodes'], 1) - 1):+.0f} % (the paper: {paper.PACKET256[0]})"
    speed = f"{frusta['seconds'] / many['seconds']:.2f} (the paper: {paper.PACKET256[1]})"
    print("Packets of 256 rays beside multifrusta:paper (Sec. 5.2)")
    beside = f"{packets['seconds'] / many['seconds']:.2f} (the paper: in some cases less than 1)"
    report.print_fields([("nodes", change), ("times as fast", speed), ("times as fast as packet16", beside)])
    print()


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


def _print_figure5(case: "Case", shown: "Quality") -> None:
    """Print the errors of the visibility against 256 samples."""
    table = [
        (name, f"{r['rays'] / 1e6:.2f}", f"{r['seconds']:.3f}", f"{1e3 * r['rms']:.1f}", f"{1e3 * r['mean']:.1f}")
        for name, r in shown.rows.items()
    ]
    print(f"Figure 5, {case.name}: visibility against 256 samples a pixel, errors times 1000 (the paper: pictures)")
    report.print_table(("frame", "M rays", "seconds", "rms", "mean"), table, right=range(1, 5))


def _print_figure7(case: "Case", shown: "Quality") -> None:
    from . import published as paper

    ours, theirs = f"{100 * shown.edges:.1f} %", f"{100 * paper.EDGES:.1f} % in Saloon"
    print(f"Figure 7, {case.name}: {ours} of the pixels lie at edges (the paper: {theirs})\n")


def _print_figure6(case: "Case", sizes: dict) -> None:
    from .measure import FIGURE6

    cell = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    table = [(tracer, *(cell(rows[tracer]) for rows in sizes.values())) for tracer in FIGURE6]
    print(f"Figure 6, {case.name}: #tris and #isec, in thousands, by the light's edge")
    report.print_table(("tracer", *sizes), table, right=range(1, 1 + len(sizes)))
