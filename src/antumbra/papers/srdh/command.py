"""``antumbra bench srdh``: cost and gain of trees that are built for shadow rays."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments, report
from ...cli.options import Json, Quiet, Threads
from ...cli.progress import ProgressDisplay
from ..views import open_view

if TYPE_CHECKING:
    from .measure import Counted
    from .times import BuildTimes, RenderTimes

_WIDTH = 150  # width of the tables, in characters


def srdh(
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, a procedural scene; may be repeated.  [default: five folders "
            "and blinds, or blinds, cellar and atrium]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Write bars and curves to a .png file.", metavar="FILE", show_default=False)
    ] = None,
    size: Annotated[
        str, typer.Option(help="Size of the pictures whose rays are counted.", metavar="WxH")
    ] = "1024x1024",
    spp: Annotated[
        int, typer.Option(help="Shadow rays that are counted for each light and point.", min=1, max=1024)
    ] = 1,
    timed_size: Annotated[
        str, typer.Option(help="Size of the pictures whose rendering is timed.", metavar="WxH")
    ] = "512x512",
    rounds: Annotated[int, typer.Option(help="Measurements of each time; the median counts.", min=1, max=1000)] = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Trees and orders for shadow rays: box tests, build times, trace times [Feltman et al. 2012].

    Box tests are counted for shadow rays from visible surfaces, and from the hits of one diffuse ray from each of these
    points (Figures 2, 4, 5). Build times are those of Table 1. Trace times are of direct light at the visible surfaces.

    \b
    Examples
      antumbra bench srdh
      antumbra bench srdh --scene blinds --scene room.glb --plot srdh.png
      antumbra bench srdh --scene "procedural:cellar?triangles=50k" --size 256 --rounds 5
    """
    width_height, timed = arguments.parse_size(size), arguments.parse_size(timed_size, "--timed-size")

    from ...kernels.parallel import thread_count
    from ..answers import agree
    from . import measure as counts
    from . import times as srdh_times
    from . import views as srdh_views

    if plot is not None:
        arguments.check_plot(plot)
    n_threads = thread_count(threads)
    rows: list[Counted] = []
    builds: list[BuildTimes] = []
    renders: list[RenderTimes] = []
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or srdh_views.default_names())
        for view in [open_view(name, width_height, srdh_views.named_view) for name in names]:
            rows += counts.count_view(view, spp, n_threads, display.say)
            builds += srdh_times.build_times(view, spp, n_threads, rounds, display.say)
            smaller = view._replace(camera=view.camera.resized(*timed))
            renders += srdh_times.render_times(smaller, n_threads, rounds, display.say)
        if plot is not None:
            from .plot import write_plot

            write_plot(rows, plot)
    same = agree((r.scene, r.bits) for r in renders)
    if json:
        asked = {"size": width_height, "spp": spp, "timed_size": timed, "rounds": rounds, "threads": n_threads}
        tables = {
            "counts": [{**r._asdict(), "relative": counts.relative(rows, r)} for r in rows],
            "builds": [{**b._asdict(), "both": b.both, "instead": b.instead} for b in builds],
            "renders": [{**r._asdict(), "bits": r.bits.hex()} for r in renders],
        }
        report.print_json({**asked, **tables, "same_bits": same})
        return
    if quiet:
        return
    _print_orders(rows)
    _print_saved(rows)
    _print_pixels(rows)
    _print_kernels(rows)
    _print_builds(builds)
    _print_renders(renders)
    report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _percent(share: float) -> str:
    return f"{100 * share:.0f}"


def _print_orders(rows: "list[Counted]") -> None:
    """Print the numbers of rays, then Figure 2 as a table."""
    from . import measure as bench

    asked, table = [], []
    for name in bench.scenes_of(rows):
        base = bench.of(rows, name, bench.BASE)
        asked.append((name, f"{base.triangles:,}", f"{base.rays:,}", _percent(base.blocked / base.rays)))
        for method in (*bench.SAH_ORDERS, bench.PUBLISHED, bench.OURS):
            r = bench.of(rows, name, method)
            parts = [_percent(part / base.total) for part in (r.total, *r.boxes)]
            table.append((name, method, *parts, f"{r.total / r.rays:.1f}", f"{r.tested / r.rays:.2f}"))
    print("Shadow rays that are counted")
    report.print_table(("scene", "triangles", "rays", "% blocked"), asked, right=range(1, 4), width=_WIDTH)
    classes = "path to the hit", "faux hits", "unoccluded"
    head = ("scene", "method", "all", *classes, "boxes a ray", "triangles a ray")
    print("Box tests in percent of random order, SRDH shown all rays (Figure 2)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def _print_saved(rows: "list[Counted]") -> None:
    """Print the savings that the paper's text derives from Figure 2."""
    from . import measure as bench
    from . import published as paper

    table = []
    for name in bench.scenes_of(rows):
        r = bench.of(rows, name, bench.PUBLISHED)
        shares = [bench.saved(rows, r, order) for order in bench.SAH_ORDERS]
        table.append((name, *map(_percent, shares), _percent(bench.saved_unoccluded(rows, r))))
    blinds = (_percent(paper.BEDROOM[order]) if order in paper.BEDROOM else "" for order in bench.SAH_ORDERS)
    table.append(("(paper: BEDROOM)", *blinds, ""))
    table += [(f"(paper: {name})", *[""] * 4, _percent(share)) for name, share in paper.UNOCCLUDED.items()]
    least, most = map(_percent, paper.REDUCTION)
    table.append(("(paper: all scenes)", f"{least} to {most}", *[""] * 4))
    head = ("scene", *(f"than {order}" for order in bench.SAH_ORDERS), "of unoccluded rays")
    print("Box tests that SRDH, as published and shown all rays, saves, in percent (Section 4.1)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _print_pixels(rows: "list[Counted]") -> None:
    """Print Figure 4 as a table."""
    from . import measure as bench
    from . import published as paper

    table, beyond = [], dict[str, list[float]]()
    for name in bench.scenes_of(rows):
        for method in (bench.PUBLISHED, bench.OURS):
            shown = [bench.of(rows, name, method, k) for k in (*bench.PIXELS, None)]
            sixteen = bench.beyond_all(rows, bench.of(rows, name, method, 16))
            beyond.setdefault(method, []).append(sixteen)
            cells = [f"{100 * bench.relative(rows, r):.1f}" for r in shown]
            table.append((name, method, *cells, f"{100 * sixteen:+.1f} %"))
    head = ("scene", "method", *(f"{k} x {k}" for k in bench.PIXELS), "all", "16 x 16 over all")
    print("Box tests in percent of random order, by the size of the pre-render (Figure 4)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
    most = {method: f"at most {100 * max(shares):.1f} % over all rays" for method, shares in beyond.items()}
    report.print_fields([*most.items(), ("the paper's", f"at most {_percent(paper.WITHIN)} %")])
    print()


def _print_kernels(rows: "list[Counted]") -> None:
    """Print Figure 5 as a table."""
    from . import measure as bench

    methods = (bench.CONSTANT, bench.DISTANCE, bench.PUBLISHED)
    table = []
    for name in bench.scenes_of(rows):
        found = [bench.of(rows, name, method) for method in methods]
        table.append((name, *(f"{100 * bench.relative(rows, r):.1f}" for r in found)))
    head = ("scene", *methods[:2], "all kernels")
    print("Box tests in percent of random order, by the kernels to choose from, all rays shown (Figure 5)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _print_builds(times: "list[BuildTimes]") -> None:
    """Print Table 1, and the build times of a renderer that has no other tree."""
    from . import published as paper
    from .times import PIXELS

    ms = lambda seconds: f"{1e3 * seconds:.1f}"
    table = []
    for t in times:
        published = ms(t.sah_single), ms(t.rays_by_sah), ms(t.published), f"{t.both:.2f}"
        ours = ms(t.sah), ms(t.rays_by_lbvh), ms(t.srdh), f"{t.instead:.2f}"
        table.append((t.scene, f"{t.pixels} x {t.pixels}", f"{t.rays:,}", f"{t.hits:,}", *published, *ours))
    head = (
        "scene", "pixels", "rays", "hits", "SAH", "its rays", "SRDH", "both / SAH",
        "bsah", "lbvh, rays", "srdh", "instead / bsah",
    )  # fmt: skip
    print("Build times, ms: as published, one triangle in a leaf; then as a renderer does it (Table 1)")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
    means = []
    for k in PIXELS:
        some = [t for t in times if t.pixels == k]
        both, instead = (sum(getattr(t, name) for t in some) / len(some) for name in ("both", "instead"))
        theirs = paper.both_over_sah(k)
        means.append((f"{k} x {k}", f"both / SAH {both:.2f} (the paper's {theirs:.2f}), instead / bsah {instead:.2f}"))
    report.print_fields(means)
    print()


def _print_renders(times: "list[RenderTimes]") -> None:
    """Print the gain of each tracer."""
    from .times import BUILDS, SPP, TRACERS

    table = []
    for name in dict.fromkeys(t.scene for t in times):
        for tracer in TRACERS:
            sah, ours = (next(t for t in times if t[:3] == (name, build, tracer)) for build in BUILDS)
            ms = (f"{1e3 * t:.0f}" for t in (sah.built, ours.built, sah.traced, ours.traced))
            all_ = (ours.built + ours.traced) / (sah.built + sah.traced)
            rate = f"{ours.rays / ours.traced / 1e6:.1f}"
            table.append((name, tracer, *ms, f"{ours.traced / sah.traced:.2f}", f"{all_:.2f}", rate))
    head = ("scene", "tracer", "build bsah", "srdh", "trace bsah", "srdh", "trace, ratio", "both, ratio", "M rays/s")
    print(f"Direct light of what the camera sees, {SPP} samples, ms: srdh beside bsah")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)
