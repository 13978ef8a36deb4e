"""``antumbra bench multi-frusta``, ``ray-hierarchy`` and ``peers``: tracers beside each other, and beside Embree.

Measurements are imported when a command runs, so the help of ``antumbra bench`` stays fast.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..cli import arguments
from ..cli import console as report
from ..cli.bench_command import Results, benchmark
from ..cli.console import ProgressDisplay
from ..cli.options import Json, Quiet, Threads, writes
from ..picture.render_options import CullFaces
from .benchmark_views import open_view

# --- ``antumbra bench multi-frusta``: the tables of the multi-frusta paper, and Figures 5 to 7 ------------------------


if TYPE_CHECKING:
    from .multi_frusta.frusta_measurements import Case, SoftShadowQuality
    from .ray_hierarchy.ray_hierarchy_measurements import RelativeCost


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

    from .benchmark_views import open_view
    from .multi_frusta import frusta_measurements as bench
    from .multi_frusta import frusta_measurements as quality

    plots = results.plots(plot)
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or bench.default_names())
        views = [open_view(name, width_height, bench.quad_view) for name in names]
        found = {}
        for view in views:
            case = bench.case_of(view, cull_faces.side)
            found[view.name] = case, bench.tables(case, rounds, display.say), quality.measure_quality(case, display.say)
        for path in plots:
            from .multi_frusta.frusta_measurements import write_plot

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
            _print_silhouettes(case, shown)
            report.print_fields([("bits", "the same by all methods")])


_NAMES = ("#tris", "+culling", "#AABB", "#isec")


def _print_primary(case: "Case", rows: dict) -> None:
    """Print the P rows of Table 1, without shading."""
    from .multi_frusta import frusta_measurements as paper

    _print_counts(f"Table 1, {case.name}, primary rays", case, rows)
    _print_reduction(rows, "packet16", ("multifrusta",), paper.PUBLISHED_PRIMARY)


def _print_table1(case: "Case", rows: dict) -> None:
    """Print the S rows of Table 1."""
    from .multi_frusta import frusta_measurements as paper
    from .multi_frusta.frusta_measurements import BASELINES, TABLE1

    _print_counts(f"Table 1, {case.name}, shadow rays", case, rows)
    for base in BASELINES:
        _print_reduction(rows, base, TABLE1[2:], paper.PUBLISHED_TABLE1)


def _print_counts(title: str, case: "Case", rows: dict) -> None:
    from .multi_frusta import frusta_measurements as paper

    rays = next(iter(rows.values()))["rays"]
    print(f"{title}: {len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays")
    table = [
        (t, *(f"{r[c] / 1e3:,.0f}K" for c in paper.COLUMNS), f"{r['seconds']:.3f}", f"{rays / r['seconds'] / 1e6:.2f}")
        for t, r in rows.items()
    ]
    report.print_table(("tracer", *_NAMES, "seconds", "M rays/s"), table, right=range(1, 7))


def _print_reduction(rows: dict, base: str, tracers: tuple[str, ...], theirs: tuple[str, ...]) -> None:
    """Print how many times less than `base` some tracers count and take, and the paper's range."""
    from .multi_frusta import frusta_measurements as paper

    print(f"Times less than {base} (Table 1; the paper's range)")
    less = []
    for tracer in tracers:
        counts = (f"{rows[base][c] / max(rows[tracer][c], 1):.2f}" for c in paper.COLUMNS)
        less.append((tracer, *counts, f"{rows[base]['seconds'] / rows[tracer]['seconds']:.2f}"))
    report.print_table(("tracer", *_NAMES, "seconds"), [*less, ("the paper", *theirs)], right=range(1, 6))


def _print_packet256(rows: dict) -> None:
    """Print the comparison of Sec. 5.2. The paper counts a box once for all 256 rays, as a node is counted here."""
    from .multi_frusta import frusta_measurements as paper

    many, frusta, packets = (rows[t] for t in ("packet256", "multifrusta:paper", "packet16"))
    change = f"{100 * (many['nodes'] / max(frusta['nodes'], 1) - 1):+.0f} % (the paper: {paper.PACKET256[0]})"
    speed = f"{frusta['seconds'] / many['seconds']:.2f} (the paper: {paper.PACKET256[1]})"
    print("Packets of 256 rays beside multifrusta:paper (Sec. 5.2)")
    beside = f"{packets['seconds'] / many['seconds']:.2f} (the paper: in some cases less than 1)"
    report.print_fields([("nodes", change), ("times as fast", speed), ("times as fast as packet16", beside)])
    print()


def _print_table2(case: "Case", rows: dict) -> None:
    from .multi_frusta import frusta_measurements as paper
    from .multi_frusta.frusta_measurements import TABLE2

    none, table = rows[TABLE2[0]], []
    for tracer, r in rows.items():
        change = (f"{100 * (r[c] / max(none[c], 1) - 1):+.1f}" for c in paper.COLUMNS)
        more = f"{r['shrinks'] / 1e3:,.0f}K", f"{none['seconds'] / r['seconds']:.2f}"
        table.append((tracer, *change, paper.PUBLISHED_TABLE2[tracer], *more))
    print(f"Table 2, {case.name}: change in %; the paper's of T-Rex beside it")
    head = ("tracer", *_NAMES, "the paper", "shrinks", "times as fast")
    report.print_table(head, table, right=(1, 2, 3, 4, 6, 7))


def _print_figure5(case: "Case", shown: "SoftShadowQuality") -> None:
    """Print the errors of the visibility against 256 samples."""
    table = [
        (name, f"{r['rays'] / 1e6:.2f}", f"{r['seconds']:.3f}", f"{1e3 * r['rms']:.1f}", f"{1e3 * r['mean']:.1f}")
        for name, r in shown.rows.items()
    ]
    print(f"Figure 5, {case.name}: visibility against 256 samples a pixel, errors times 1000 (the paper: pictures)")
    report.print_table(("frame", "M rays", "seconds", "rms", "mean"), table, right=range(1, 5))


def _print_silhouettes(case: "Case", shown: "SoftShadowQuality") -> None:
    from .multi_frusta import frusta_measurements as paper

    ours, theirs = f"{100 * shown.edges:.1f} %", f"{100 * paper.EDGES:.1f} % in Saloon"
    print(f"Figure 7, {case.name}: {ours} of the pixels lie at edges (the paper: {theirs})\n")


def _print_figure6(case: "Case", sizes: dict) -> None:
    from .multi_frusta.frusta_measurements import FIGURE6

    cell = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    table = [(tracer, *(cell(rows[tracer]) for rows in sizes.values())) for tracer in FIGURE6]
    print(f"Figure 6, {case.name}: #tris and #isec, in thousands, by the light's edge")
    report.print_table(("tracer", *sizes), table, right=range(1, 1 + len(sizes)))


# --- ``antumbra bench ray-hierarchy``: nodes that ray hierarchies visit, and their times ------------------------------


if TYPE_CHECKING:
    from .ray_hierarchy.ray_hierarchy_measurements import Cost, PictureRays, Spread

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

    from ..kernels.parallel import thread_count
    from .benchmark_views import agree
    from .ray_hierarchy import ray_hierarchy_measurements as bench
    from .ray_hierarchy import ray_hierarchy_measurements as views
    from .ray_hierarchy.ray_hierarchy_measurements import FIGURE7

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
            from .ray_hierarchy.ray_hierarchy_measurements import write_plot

            write_plot(seen, costs, path)
    spreads = bench.spreads(seen, costs)
    same = agree(bench.answers(seen, costs))
    asked = {"size": width_height, "frames": frames, "limit": limit, "rounds": rounds, "threads": n_threads}
    asked["cull_faces"] = cull_faces.side
    tables = {
        "pictures": [{**s._asdict(), "bits": s.bits.hex()} for s in seen],
        "costs": [{**c._asdict(), "bits": c.bits.hex() if c.bits else None} for c in costs],
        "figure 7": [b._asdict() for b in bench.relative_costs(seen, costs, FIGURE7)],
        "spreads": [s._asdict() for s in spreads],
    }
    with results.told({**asked, **tables, "same_bits": same}):
        _print_pictures(seen, costs)
        _print_museum(costs)
        _print_figure7(bench.relative_costs(seen, costs, FIGURE7))
        _print_claims(seen, costs, spreads)
        _print_spreads(spreads)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _millions(count: float | None) -> str:
    return "" if count is None else f"{count / 1e6:,.3f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:,.1f}"


def _print_pictures(seen: "list[PictureRays]", costs: "list[Cost]") -> None:
    """Print Figures 6 and 7 as tables."""
    from .ray_hierarchy.ray_hierarchy_measurements import PLANS, ROBOTS, STILL_CAMERA, of

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
    from .ray_hierarchy import ray_hierarchy_measurements as paper
    from .ray_hierarchy.ray_hierarchy_measurements import MUSEUM_NAME, of

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


def _print_figure7(rows: "list[RelativeCost]") -> None:
    """Print Figure 7 as a table: early accept and two passes."""
    from .ray_hierarchy.ray_hierarchy_measurements import BEST

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
    from .ray_hierarchy import ray_hierarchy_measurements as bench
    from .ray_hierarchy import ray_hierarchy_measurements as paper

    rows = []
    for kind in ("Spheres", "Precise"):
        for what, fields, table in (
            ("nodes", ("nodes", "predicted_nodes"), paper.NODES),
            ("time", ("seconds", "predicted"), paper.MILLISECONDS),
        ):
            times, picture, measured = bench.cut(costs, kind, f"{kind}Sorted", fields)
            if picture:
                theirs = f"the report's {paper.published_cut(kind, f'{kind}Sorted', table):,.0f}"
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


# --- ``antumbra bench peers``: soft shadows by bsah+auto beside Embree ------------------------------------------------


if TYPE_CHECKING:
    from .peers.peer_measurements import PeerBuild

_PEERS_WIDTH = 110  # width of the tables, in characters


@benchmark(size="384x384", rounds=3)
def peers(
    results: Results,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, a procedural scene; may be repeated.  [default: sponza_crytek "
            "where it is there, and forest]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Write bars to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "1024x1024",
    spp: Annotated[int, typer.Option(help="Shadow rays for each pixel.", min=1, max=1024)] = 16,
    rounds: Annotated[int, typer.Option(help="Turns of each contender; the median counts.", min=1, max=1000)] = 5,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """The plan bsah+auto beside Embree: soft shadows on the same rays, turn by turn, in one process.

    Ours is timed from the query of a frame to its bits. Embree is timed on rays that were made before, one by one and
    in packets. Each of its modes is tried once, and the fastest have their turns. The ratio is that of the medians,
    ours to Embree's fastest. Each number of rays that differ is that of answers that are not ours: Embree rounds.

    One thread is measured, and all cores. Embree needs: pip install 'antumbra[peers]'

    \b
    Examples
      antumbra bench peers
      antumbra bench peers --scene forest --size 512 --rounds 9 --threads 1
    """
    width_height = arguments.parse_size(size)

    from ..engine.plan import parse_plan
    from ..kernels.parallel import thread_count
    from ..picture.render_kernels import precompile_plan
    from .peers import peer_measurements as bench
    from .peers.peer_measurements import describe_embree

    plan = parse_plan("bsah+auto")
    plots = results.plots(plot)
    embree = describe_embree()  # an error if it is missing
    counts = [threads] if threads else list(dict.fromkeys((1, thread_count(None))))
    rows: list[dict] = []
    builds: list[PeerBuild] = []
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or bench.default_names())
        views = [open_view(name, width_height, bench.named_view) for name in names]
        precompile_plan(plan, "raster", False)
        for view in views:
            found, times = bench.measure(view, plan, spp, counts, rounds, display.say)
            rows += found
            builds += times
            if not (json or quiet):
                _show(found)
        for path in plots:
            from .peers.peer_measurements import write_plot

            write_plot(rows, path)
    asked = {"plan": str(plan), "embree": embree, "size": width_height, "spp": spp, "rounds": rounds, "threads": counts}
    with results.told({**asked, "rows": rows, "builds": [b._asdict() for b in builds]}):
        for name in dict.fromkeys(row["scene"] for row in rows):
            _print_rates([row for row in rows if row["scene"] == name])
        _print_builds(builds)
        _print_summary(embree, rows)


def _show(rows: list[dict]) -> None:
    """Print a line for each number of threads to standard error, as soon as a scene has been measured."""
    for row in rows:
        if "ratio" in row:
            told = f"{row['mrays']:.1f} M rays/s, {row['ratio']:.2f} times the fastest of Embree"
            print(f"{row['scene']}, {row['threads']} thread(s): {told}", file=sys.stderr, flush=True)


def _print_rates(rows: list[dict]) -> None:
    """Print the rates of one scene."""
    from .peers.peer_measurements import finalists

    first, table = rows[0], []
    for row in finalists(rows):
        ratio = f"{row['ratio']:.2f}" if "ratio" in row else ""
        rates = f"{row['mrays']:.2f}", f"{row['best_mrays']:.2f}"
        table.append((f"{row['threads']}", row["contender"], *rates, ratio, f"{row['differs']:,}"))
    told = f"{first['triangles']:,} triangles, {first['rays'] / 1e6:.2f} M rays, {first['occluded']:.0%} blocked"
    print(f"Soft shadows, {first['scene']}: {told}")
    head = ("threads", "contender", "M rays/s", "at best", "ratio", "rays that differ")
    report.print_table(head, table, right=(0, 2, 3, 4, 5), width=_PEERS_WIDTH)


def _print_builds(builds: "list[PeerBuild]") -> None:
    scenes, methods = (list(dict.fromkeys(getattr(b, name) for b in builds)) for name in ("scene", "method"))
    seconds = {(b.scene, b.method): b.seconds for b in builds}
    table = [(scene, *(f"{1e3 * seconds[scene, method]:.0f}" for method in methods)) for scene in scenes]
    print("Build times on all cores, ms; ours with the blocks of the tracer")
    report.print_table(("scene", *methods), table, right=range(1, 1 + len(methods)), width=_PEERS_WIDTH)


def _print_summary(embree: str, rows: list[dict]) -> None:
    from .peers.ray_contest import summary

    report.print_fields([("peer", embree), *(("ours", line) for line in summary(rows))])
