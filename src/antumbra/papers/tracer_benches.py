"""``antumbra bench multi-frusta`` and ``ray-hierarchy``: compare tracers with one another.

The measurements are imported only when a command runs, which keeps the help of ``antumbra bench`` fast.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..cli import arguments
from ..cli import console as report
from ..cli.bench_command import Results, benchmark
from ..cli.console import ProgressDisplay
from ..cli.options import Json, Quiet, Threads
from ..picture.render_options import CullFaces
from .bench_options import ImageSize, Rounds, open_views, plot_option, print_agreement, scene_option

# --- antumbra bench multi-frusta --------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from .multi_frusta.frusta_measurements import Case, Rows, SoftShadowQuality
    from .ray_hierarchy.ray_hierarchy_measurements import RelativeCost


@benchmark(size="160x160", rounds=1)
def multi_frusta(
    results: Results,
    scene: Annotated[
        list[str] | None, scene_option("two folders of $ANTUMBRA_SCENES, if they exist, and forest")
    ] = None,
    plot: Annotated[Path | None, plot_option("Figures 5 to 7")] = None,
    size: ImageSize = "512x512",
    cull_faces: Annotated[
        CullFaces, typer.Option(help="Triangle side that does not block shadow rays; published with: back.")
    ] = CullFaces.back,
    rounds: Rounds = 5,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Multi-frusta tracing compared with packets: accesses, tests and times [Benthin and Wald 2009].

    Traces 16 shadow rays per pixel to a square light on one thread. Table 1 compares the paper's tracer and ours with
    packets of 16 rays, for primary and shadow rays; Section 5.2 has packets of 256 rays. Table 2 compares three kinds
    of frustum shrinking. Figure 5 compares 16 filtered samples with 256. Figure 6 scales the light's edge by 1/4 to 8.
    Figure 7 counts silhouette pixels. All tracers give the same bits.

    \b
    Examples
      antumbra bench multi-frusta
      antumbra bench multi-frusta --scene forest --size 256 --rounds 3 --plot forest.png
    """
    width_height = arguments.parse_size(size)

    from .multi_frusta import frusta_measurements as bench

    plots = results.plots(plot)
    with ProgressDisplay(quiet) as display:
        views = open_views(scene or bench.default_names(), width_height, bench.quad_view, display.say)
        cases: dict[str, tuple[Case, dict[str, Any], SoftShadowQuality]] = {}
        for view in views:
            case = bench.case_of(view, cull_faces.side)
            cases[view.name] = case, bench.tables(case, rounds, display.say), bench.measure_quality(case, display.say)
        for path in plots:
            bench.write_plot({name: (tables, figures) for name, (_, tables, figures) in cases.items()}, path)
    rows = {
        name: {**tables, "figure 5": figures.rows, "figure 7": {"edges": figures.edges}}
        for name, (_, tables, figures) in cases.items()
    }
    settings = {"size": width_height, "rounds": rounds, "cull_faces": cull_faces.side}
    with results.told({**settings, "rows": rows, "same_bits": True}):
        for case, tables, figures in cases.values():
            _print_primary(case, tables["table 1 primary"])
            _print_table1(case, tables["table 1"])
            _print_packet256(tables["table 1"])
            _print_table2(case, tables["table 2"])
            _print_figure5(case, figures)
            _print_figure6(case, tables["figure 6"])
            _print_silhouettes(case, figures)
            print_agreement(True)


_NAMES = ("#tris", "+culling", "#AABB", "#isec")


def _print_primary(case: "Case", rows: "Rows") -> None:
    """Print the primary-ray rows (P) of Table 1, without shading."""
    from .multi_frusta import frusta_measurements as paper

    _print_counts(f"Table 1, {case.name}, primary rays", case, rows)
    _print_reduction(rows, "packet16", ("multifrusta",), paper.PUBLISHED_PRIMARY)


def _print_table1(case: "Case", rows: "Rows") -> None:
    """Print the shadow-ray rows (S) of Table 1."""
    from .multi_frusta import frusta_measurements as paper
    from .multi_frusta.frusta_measurements import BASELINES, TABLE1

    _print_counts(f"Table 1, {case.name}, shadow rays", case, rows)
    for base in BASELINES:
        _print_reduction(rows, base, TABLE1[2:], paper.PUBLISHED_TABLE1)


def _print_counts(title: str, case: "Case", rows: "Rows") -> None:
    from .multi_frusta import frusta_measurements as paper

    rays = next(iter(rows.values()))["rays"]
    print(f"{title}: {len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays")
    table = [
        (t, *(f"{r[c] / 1e3:,.0f}K" for c in paper.COLUMNS), f"{r['seconds']:.3f}", f"{rays / r['seconds'] / 1e6:.2f}")
        for t, r in rows.items()
    ]
    report.print_table(("tracer", *_NAMES, "seconds", "M rays/s"), table, right=range(1, 7))


def _print_reduction(rows: "Rows", base: str, tracers: tuple[str, ...], theirs: tuple[str, ...]) -> None:
    """Print by what factor the tracers reduce the counts and time of `base`, and the paper's range."""
    from .multi_frusta import frusta_measurements as paper

    print(f"Reduction factor over {base} (Table 1; the paper's range)")
    reductions = []
    for tracer in tracers:
        counts = (f"{rows[base][c] / max(rows[tracer][c], 1):.2f}" for c in paper.COLUMNS)
        reductions.append((tracer, *counts, f"{rows[base]['seconds'] / rows[tracer]['seconds']:.2f}"))
    report.print_table(("tracer", *_NAMES, "seconds"), [*reductions, ("the paper", *theirs)], right=range(1, 6))


def _print_packet256(rows: "Rows") -> None:
    """Print the comparison of Sec. 5.2. The paper counts a box once for all 256 rays, as this counts nodes."""
    from .multi_frusta import frusta_measurements as paper

    many, frusta, packets = (rows[t] for t in ("packet256", "multifrusta:paper", "packet16"))
    change = f"{100 * (many['nodes'] / max(frusta['nodes'], 1) - 1):+.0f} % (the paper: {paper.PACKET256[0]})"
    speed = f"{frusta['seconds'] / many['seconds']:.2f} (the paper: {paper.PACKET256[1]})"
    print("Packets of 256 rays compared with multifrusta:paper (Sec. 5.2)")
    over_packet16 = f"{packets['seconds'] / many['seconds']:.2f} (the paper: in some cases less than 1)"
    report.print_fields([("nodes", change), ("speedup", speed), ("speedup over packet16", over_packet16)])
    print()


def _print_table2(case: "Case", rows: "Rows") -> None:
    from .multi_frusta import frusta_measurements as paper
    from .multi_frusta.frusta_measurements import TABLE2

    none, table = rows[TABLE2[0]], []
    for tracer, r in rows.items():
        change = (f"{100 * (r[c] / max(none[c], 1) - 1):+.1f}" for c in paper.COLUMNS)
        more = f"{r['shrinks'] / 1e3:,.0f}K", f"{none['seconds'] / r['seconds']:.2f}"
        table.append((tracer, *change, paper.PUBLISHED_TABLE2[tracer], *more))
    print(f"Table 2, {case.name}: change in %, with the paper's for T-Rex")
    head = ("tracer", *_NAMES, "the paper", "shrinks", "speedup")
    report.print_table(head, table, right=(1, 2, 3, 4, 6, 7))


def _print_figure5(case: "Case", quality: "SoftShadowQuality") -> None:
    """Print the visibility errors relative to 256 samples."""
    table = [
        (name, f"{r['rays'] / 1e6:.2f}", f"{r['seconds']:.3f}", f"{1e3 * r['rms']:.1f}", f"{1e3 * r['mean']:.1f}")
        for name, r in quality.rows.items()
    ]
    print(f"Figure 5, {case.name}: visibility error x 1000 against 256 samples per pixel (the paper: pictures)")
    report.print_table(("frame", "M rays", "seconds", "rms", "mean"), table, right=range(1, 5))


def _print_silhouettes(case: "Case", quality: "SoftShadowQuality") -> None:
    from .multi_frusta import frusta_measurements as paper

    ours, theirs = f"{100 * quality.edges:.1f} %", f"{100 * paper.EDGES:.1f} % in Saloon"
    print(f"Figure 7, {case.name}: {ours} of the pixels are at edges (the paper: {theirs})\n")


def _print_figure6(case: "Case", sizes: "dict[str, Rows]") -> None:
    from .multi_frusta.frusta_measurements import FIGURE6

    cell: Callable[[dict[str, float]], str] = lambda row: (
        f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    )
    table = [(tracer, *(cell(rows[tracer]) for rows in sizes.values())) for tracer in FIGURE6]
    print(f"Figure 6, {case.name}: #tris and #isec in thousands, by edge length of the light")
    report.print_table(("tracer", *sizes), table, right=range(1, 1 + len(sizes)))


# --- antumbra bench ray-hierarchy -------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from .ray_hierarchy.ray_hierarchy_measurements import Cost, PictureRays, Spread

_WIDTH = 170  # width of the tables, in characters


@benchmark(size="192x192", frames=3, limit=0.5, rounds=1)
def ray_hierarchy(
    results: Results,
    scene: Annotated[
        list[str] | None,
        scene_option("four folders of $ANTUMBRA_SCENES, else atrium and forest", "a file, a folder of vertex frames"),
    ] = None,
    plot: Annotated[Path | None, plot_option("curves")] = None,
    size: ImageSize = "1024x1024",
    frames: Annotated[int, typer.Option(help="Evenly spaced frames of each animated scene.", min=1, max=10_000)] = 10,
    limit: Annotated[
        float,
        typer.Option(help="Skip variants predicted to take longer per picture.", metavar="SECONDS", min=0.0),
    ] = 60.0,
    cull_faces: Annotated[
        CullFaces,
        typer.Option(
            help="Triangle side, as seen from the receiver, that does not block shadow rays. The report culls faces "
            "visible from the light: back."
        ),
    ] = CullFaces.back,
    rounds: Rounds = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Ray hierarchies: nodes, times and their variation [Olsson and Assarsson 2011].

    Traces one shadow ray per pixel to a point light with the variants of the report's Table 1 and ours. The scenes are
    frames of BART's robots, views of its museum (Figures 6 and 7, Table 2), and static scenes.

    \b
    Examples
      antumbra bench ray-hierarchy
      antumbra bench ray-hierarchy --scene bart_robots --frames 40 --plot robots.png
      antumbra bench ray-hierarchy --scene procedural:forest --size 512 --limit 10
    """
    width_height = arguments.parse_size(size)

    from ..kernels.parallel import thread_count
    from .benchmark_views import agree
    from .ray_hierarchy import ray_hierarchy_measurements as bench

    plots = results.plots(plot)
    n_threads = thread_count(threads)
    picture_rays: list[PictureRays] = []
    costs: list[Cost] = []
    with ProgressDisplay(quiet) as display:
        views = open_views(scene or bench.default_names(), width_height, bench.named_view, display.say)
        for picture in (p for view in views for p in bench.pictures(bench.with_point(view), frames)):
            rays, picture_costs = bench.measure(picture, n_threads, rounds, limit, display.say, cull_faces.side)
            picture_rays.append(rays)
            costs += picture_costs
        for path in plots:
            bench.write_plot(picture_rays, costs, path)
    spreads = bench.spreads(picture_rays, costs)
    same = agree(bench.answers(picture_rays, costs))
    settings = {"size": width_height, "frames": frames, "limit": limit, "rounds": rounds, "threads": n_threads}
    settings["cull_faces"] = cull_faces.side
    tables = {
        "pictures": [{**s._asdict(), "bits": s.bits.hex()} for s in picture_rays],
        "costs": [{**c._asdict(), "bits": c.bits.hex() if c.bits else None} for c in costs],
        "figure 7": [b._asdict() for b in bench.relative_costs(picture_rays, costs, bench.FIGURE7)],
        "spreads": [s._asdict() for s in spreads],
    }
    with results.told({**settings, **tables, "same_bits": same}):
        _print_pictures(picture_rays, costs)
        _print_museum(costs)
        _print_figure7(bench.relative_costs(picture_rays, costs, bench.FIGURE7))
        _print_claims(picture_rays, costs, spreads)
        _print_spreads(spreads)
        print_agreement(same)


def _millions(count: float | None) -> str:
    return "" if count is None else f"{count / 1e6:,.3f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.1f}"


def _print_pictures(pictures: "list[PictureRays]", costs: "list[Cost]") -> None:
    """Print Figures 6 and 7 as tables."""
    from .ray_hierarchy.ray_hierarchy_measurements import PLANS, ROBOTS, STILL_CAMERA, of

    summary = [(s.picture, f"{s.triangles:,}", f"{s.rays:,}", f"{100 * s.blocked / s.rays:.0f}") for s in pictures]
    print("Pictures: one point light, one shadow ray per visible surface point")
    report.print_table(("picture", "triangles", "rays", "% blocked"), summary, right=range(1, 4), width=_WIDTH)
    if any(s.of == ROBOTS for s in pictures):
        print(f"{STILL_CAMERA}\n")
    skipped = "skipped: about "
    tables: tuple[tuple[str, Callable[[Cost], str]], ...] = (
        (
            "Nodes tested, millions (Figures 6 and 7)",
            lambda c: _millions(c.nodes) or skipped + _millions(c.predicted_nodes),
        ),
        ("Nodes passed, millions (Figures 6 and 7)", lambda c: _millions(c.passed) or "skipped"),
        ("Ray tests of up to 16 rays, millions", lambda c: _millions(c.tests) or "skipped"),
        (
            "Shadows, ms (Figures 6 and 7)",
            lambda c: skipped + report.duration(c.predicted) if c.seconds is None else _ms(c.seconds),
        ),
    )
    for title, cell in tables:
        table = [(s.picture, *(cell(of(costs, s.picture, variant)) for variant in PLANS)) for s in pictures]
        print(title)
        report.print_table(("picture", *PLANS), table, right=range(1, 1 + len(PLANS)), width=_WIDTH)


def _print_museum(costs: "list[Cost]") -> None:
    """Print Table 2, with the report's values in brackets. The report does not say whether it counts nodes passed."""
    from .ray_hierarchy import ray_hierarchy_measurements as paper
    from .ray_hierarchy.ray_hierarchy_measurements import MUSEUM_NAME, of

    places = [name for name in dict.fromkeys(c.picture for c in costs) if name.startswith(f"{MUSEUM_NAME}, ")]
    if not places:
        return
    nodes, times = [], []
    for variant in paper.MEASURED:
        place_costs = [of(costs, place, variant) for place in places]
        nodes.append((variant, *(_nodes_beside(c, n) for c, n in zip(place_costs, paper.NODES[variant]))))
        times.append((variant, *(_ms_beside(c, ms) for c, ms in zip(place_costs, paper.MILLISECONDS[variant]))))
    head = ("variant", *(place.removeprefix(f"{MUSEUM_NAME}, ") for place in places))
    for title, table in (("Nodes tested and passed, millions", nodes), ("Shadows, ms", times)):
        print(f"{title}: subdivided museum (Table 2; in brackets the report's, for other views on a GPU)")
        report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _nodes_beside(cost: "Cost", theirs: float) -> str:
    tested = _millions(cost.nodes) or f"about {_millions(cost.predicted_nodes)}"
    return f"{tested}, {_millions(cost.passed) or '?'} ({theirs / 1e6:.2f})"


def _ms_beside(cost: "Cost", theirs: float) -> str:
    took = f"about {_ms(cost.predicted)}" if cost.seconds is None else _ms(cost.seconds)
    return f"{took} ({theirs:.1f})"


def _print_figure7(rows: "list[RelativeCost]") -> None:
    """Print Figure 7 as a table: early accept and two passes."""
    from .ray_hierarchy.ray_hierarchy_measurements import BEST

    table = [
        (b.of, b.variant, f"{b.pictures}", f"{b.nodes:.2f}", f"{b.passed:.2f}", f"{b.seconds:.2f}")
        for b in rows
        if b.variant != BEST
    ]
    head = ("scene", "variant", "pictures", "nodes tested", "nodes passed", "time")
    print(f"Early accept and two passes relative to {BEST} (Figure 7; in the report, nodes fall and time rises)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def _print_claims(pictures: "list[PictureRays]", costs: "list[Cost]", spreads: "list[Spread]") -> None:
    """Print our results for the claims in the report's text."""
    from .ray_hierarchy import ray_hierarchy_measurements as paper

    rows = []
    for kind in ("Spheres", "Precise"):
        for what, fields, table in (
            ("nodes", ("nodes", "predicted_nodes"), paper.NODES),
            ("time", ("seconds", "predicted"), paper.MILLISECONDS),
        ):
            times, picture, measured = paper.cut(costs, kind, f"{kind}Sorted", fields)
            if picture:
                theirs = f"the report's {paper.published_cut(kind, f'{kind}Sorted', table):,.0f}"
                text = f"cuts {what} {'' if measured else 'about '}{times:,.1f} times in {picture} ({theirs})"
                rows.append((f"sorting, {kind}", text))
    for title, among in (
        ("of Figure 6", paper.MEASURED),
        ("of Table 1", paper.VARIANTS),
        ("of all", tuple(paper.PLANS)),
    ):
        best = [paper.fewest(costs, s.picture, among) for s in pictures]
        wins = ", ".join(f"{name or 'none measured'} {best.count(name)}" for name in dict.fromkeys(best))
        rows.append((f"fewest nodes {title}", f"in {len(best)} pictures: {wins}"))
    for name in dict.fromkeys(s.of for s in spreads):
        least = min((s for s in spreads if s.of == name), key=lambda s: s.deviation)
        text = f"{least.variant}, standard deviation {100 * least.deviation:.0f} % of the mean"
        rows.append((f"steadiest in {name}", text))
    report.print_fields(rows)
    print()


def _print_spreads(spreads: "list[Spread]") -> None:
    """Print the variation of the times in Figure 6(b)."""
    if not spreads:
        print("No animated scene, so no variation of times over frames (Figure 6b)\n")
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
        "interquartile range, ms",
        "deviation, % of mean",
    )
    print("Shadow times over the frames of an animation (Figure 6b)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
