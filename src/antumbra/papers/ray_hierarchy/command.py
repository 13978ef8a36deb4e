"""``antumbra bench ray-hierarchy``: nodes that ray hierarchies visit, and their times."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments
from ...cli import console as report
from ...cli.bench_command import Results, benchmark
from ...cli.console import ProgressDisplay
from ...cli.options import Json, Quiet, Threads, writes
from ...rendering.options import CullFaces
from ..views import open_view

if TYPE_CHECKING:
    from .measure import Beside, Cost, PictureRays, Spread

_WIDTH = 170  # width of the tables, in characters


@benchmark(size="192x192", frames=3, limit=0.5, rounds=1)
def ray_hierarchy(
    results: Results,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, a folder of vertex frames, a procedural scene; may be "
            "repeated.  [default: four folders of $ANTUMBRA_SCENES, or atrium and forest]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Write curves to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "1024x1024",
    frames: Annotated[
        int, typer.Option(help="Moments of each scene that moves, spread evenly.", min=1, max=10_000)
    ] = 10,
    limit: Annotated[
        float,
        typer.Option(help="Leave out the variants that would trace a picture for longer.", metavar="SECONDS", min=0.0),
    ] = 60.0,
    cull_faces: Annotated[
        CullFaces,
        typer.Option(
            help="The side of triangles that, seen from a receiver, blocks no shadow ray. The report culls faces that "
            "the light sees: back."
        ),
    ] = CullFaces.back,
    rounds: Annotated[int, typer.Option(help="Measurements of each time; the median counts.", min=1, max=1000)] = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Ray hierarchies: nodes, times and their variation [Olsson and Assarsson 2011].

    There is one point light, and one shadow ray for each pixel. It measures the variants of the report's Table 1 and
    ours. The scenes are the frames of BART's robots and views of its museum (Figures 6 and 7, Table 2), and still ones.

    \b
    Examples
      antumbra bench ray-hierarchy
      antumbra bench ray-hierarchy --scene bart_robots --frames 40 --plot robots.png
      antumbra bench ray-hierarchy --scene procedural:forest --size 512 --limit 10
    """
    width_height = arguments.parse_size(size)

    from ...kernels.parallel import thread_count
    from ..answers import agree
    from . import measure as bench
    from . import views
    from .published import FIGURE7

    plots = results.plots(plot)
    n_threads = thread_count(threads)
    seen: list[PictureRays] = []
    costs: list[Cost] = []
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        named = dict.fromkeys(scene or views.default_names())
        opened = [views.with_point(open_view(name, width_height, views.named_view)) for name in named]
        for picture in (p for view in opened for p in views.pictures(view, frames)):
            shown, found = bench.measure(picture, n_threads, rounds, limit, display.say, cull_faces.side)
            seen.append(shown)
            costs += found
        for path in plots:
            from .plot import write_plot

            write_plot(seen, costs, path)
    spreads = bench.spreads(seen, costs)
    same = agree(bench.answers(seen, costs))
    asked = {"size": width_height, "frames": frames, "limit": limit, "rounds": rounds, "threads": n_threads}
    asked["cull_faces"] = cull_faces.side
    tables = {
        "pictures": [{**s._asdict(), "bits": s.bits.hex()} for s in seen],
        "costs": [{**c._asdict(), "bits": c.bits.hex() if c.bits else None} for c in costs],
        "figure 7": [b._asdict() for b in bench.beside(seen, costs, FIGURE7)],
        "spreads": [s._asdict() for s in spreads],
    }
    with results.told({**asked, **tables, "same_bits": same}):
        _print_pictures(seen, costs)
        _print_museum(costs)
        _print_figure7(bench.beside(seen, costs, FIGURE7))
        _print_claims(seen, costs, spreads)
        _print_spreads(spreads)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _millions(count: float | None) -> str:
    return "" if count is None else f"{count / 1e6:,.3f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.1f}"


def _print_pictures(seen: "list[PictureRays]", costs: "list[Cost]") -> None:
    """Print Figures 6 and 7 as tables."""
    from .measure import PLANS, of
    from .views import ROBOTS, STILL_CAMERA

    asked = [(s.picture, f"{s.triangles:,}", f"{s.rays:,}", f"{100 * s.blocked / s.rays:.0f}") for s in seen]
    print("Pictures, one point light, one shadow ray for each pixel that sees something")
    report.print_table(("picture", "triangles", "rays", "% blocked"), asked, right=range(1, 4), width=_WIDTH)
    if any(s.of == ROBOTS for s in seen):
        print(f"{STILL_CAMERA}\n")
    left_out = "skipped: about "
    tables = (
        (
            "Nodes tested, millions (Figures 6 and 7)",
            lambda c: _millions(c.nodes) or left_out + _millions(c.predicted_nodes),
        ),
        ("Nodes passed, millions (Figures 6 and 7)", lambda c: _millions(c.passed) or "skipped"),
        ("Ray tests, of up to 16 rays each, millions", lambda c: _millions(c.tests) or "skipped"),
        (
            "Shadows, ms (Figures 6 and 7)",
            lambda c: left_out + report.duration(c.predicted) if c.seconds is None else _ms(c.seconds),
        ),
    )
    for title, cell in tables:
        table = [(s.picture, *(cell(of(costs, s.picture, variant)) for variant in PLANS)) for s in seen]
        print(title)
        report.print_table(("picture", *PLANS), table, right=range(1, 1 + len(PLANS)), width=_WIDTH)


def _print_museum(costs: "list[Cost]") -> None:
    """Print Table 2, with the report's figures in brackets. The report does not say whether it counts nodes passed."""
    from . import published as paper
    from .measure import of
    from .views import MUSEUM_NAME

    places = [name for name in dict.fromkeys(c.picture for c in costs) if name.startswith(f"{MUSEUM_NAME}, ")]
    if not places:
        return
    nodes, times = [], []
    for variant in paper.MEASURED:
        found = [of(costs, place, variant) for place in places]
        nodes.append((variant, *(_nodes_beside(c, n) for c, n in zip(found, paper.NODES[variant]))))
        times.append((variant, *(_ms_beside(c, ms) for c, ms in zip(found, paper.MILLISECONDS[variant]))))
    head = ("variant", *(place.removeprefix(f"{MUSEUM_NAME}, ") for place in places))
    for title, table in (("Nodes tested, and passed, millions", nodes), ("Shadows, ms", times)):
        print(f"{title}: subdivided museum (Table 2; in brackets the report's, of other views and a GPU)")
        report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _nodes_beside(cost: "Cost", theirs: float) -> str:
    tested = _millions(cost.nodes) or f"about {_millions(cost.predicted_nodes)}"
    return f"{tested}, {_millions(cost.passed) or '?'} ({theirs / 1e6:.2f})"


def _ms_beside(cost: "Cost", theirs: float) -> str:
    took = f"about {_ms(cost.predicted)}" if cost.seconds is None else _ms(cost.seconds)
    return f"{took} ({theirs:.1f})"


def _print_figure7(rows: "list[Beside]") -> None:
    """Print Figure 7 as a table: early accept and two passes."""
    from .measure import BEST

    table = [
        (b.of, b.variant, f"{b.pictures}", f"{b.nodes:.2f}", f"{b.passed:.2f}", f"{b.seconds:.2f}")
        for b in rows
        if b.variant != BEST
    ]
    head = ("scene", "variant", "pictures", "nodes tested", "nodes passed", "time")
    print(f"Early accept and two passes, as shares of {BEST} (Figure 7; in the report nodes fall and the time rises)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def _print_claims(seen: "list[PictureRays]", costs: "list[Cost]", spreads: "list[Spread]") -> None:
    """Print our figures for the claims of the report's text."""
    from . import measure as bench
    from . import published as paper

    rows = []
    for kind in ("Spheres", "Precise"):
        for what, fields, table in (
            ("nodes", ("nodes", "predicted_nodes"), paper.NODES),
            ("time", ("seconds", "predicted"), paper.MILLISECONDS),
        ):
            times, picture, measured = bench.cut(costs, kind, f"{kind}Sorted", fields)
            if picture:
                theirs = f"the report's {paper.cut(kind, f'{kind}Sorted', table):,.0f}"
                text = f"cuts {what} {'' if measured else 'about '}{times:,.1f} times in {picture} ({theirs})"
                rows.append((f"sorting, {kind}", text))
    for title, among in (
        ("of Figure 6", paper.MEASURED),
        ("of Table 1", paper.VARIANTS),
        ("of all", tuple(bench.PLANS)),
    ):
        best = [bench.fewest(costs, s.picture, among) for s in seen]
        wins = ", ".join(f"{name or 'none measured'} {best.count(name)}" for name in dict.fromkeys(best))
        rows.append((f"fewest nodes {title}", f"in {len(best)} pictures: {wins}"))
    for name in dict.fromkeys(s.of for s in spreads):
        least = min((s for s in spreads if s.of == name), key=lambda s: s.deviation)
        rows.append((f"steadiest in {name}", f"{least.variant}, deviation {100 * least.deviation:.0f} % of the mean"))
    report.print_fields(rows)
    print()


def _print_spreads(spreads: "list[Spread]") -> None:
    """Print the variation of the times of Figure 6(b)."""
    if not spreads:
        print("No animation is looked at, so nothing is said about how times vary (Figure 6b)\n")
        return
    table = []
    for s in spreads:
        frames = f"{s.frames}" if not s.missing else f"{s.frames} of {s.frames + s.missing}"
        shares = f"{s.ratio:.2f}", _ms(s.quartiles), f"{100 * s.deviation:.0f}"
        table.append((s.of, s.variant, frames, _ms(s.median), *shares))
    head = (
        "animation",
        "variant",
        "frames",
        "median, ms",
        "longest / shortest",
        "quartiles apart, ms",
        "deviation, % of mean",
    )
    print("Shadows over the frames of an animation (Figure 6b)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
