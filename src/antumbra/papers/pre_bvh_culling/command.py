"""``antumbra bench pre-bvh-culling``: times to image with culling and without, and the cost of grids."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments, report
from ...cli.options import Json, Quiet, Threads
from ...cli.progress import ProgressDisplay
from ...errors import InputError

if TYPE_CHECKING:
    from .measure import GridRow, TimeToImage

_WIDTH = 150  # width of the tables, in characters


def pre_bvh_culling(
    sponza: Annotated[
        Path | None,
        typer.Option(
            help="Crytek's Sponza.  [default: sponza_crytek/scene.glb in $ANTUMBRA_SCENES, or an atrium]",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Write the break-even plot to a .png file.", metavar="FILE", show_default=False)
    ] = None,
    tracer: Annotated[str, typer.Option(help="How rays are traced; see antumbra plans.")] = "multifrusta",
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "1366x768",
    cellar: Annotated[str, typer.Option(help="Triangles of the cellar.", metavar="N")] = "1M",
    rounds: Annotated[int, typer.Option(help="Measurements of each; the median counts.", min=1, max=1000)] = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Time to image with pre-BVH culling and without [Selgrad et al. 2015, Tables 1 to 4, Figure 7].

    \b
    Examples
      antumbra bench pre-bvh-culling
      antumbra bench pre-bvh-culling --sponza sponza.glb --rounds 5 --plot break_even.png
      antumbra bench pre-bvh-culling --tracer single --size 683x384 --cellar 250k
    """
    width_height = arguments.parse_size(size)
    triangles = arguments.parse_count(cellar, "--cellar")

    from ...kernels.parallel import thread_count
    from ...methods import TRACERS, find_method

    walking = ", ".join(name for name, method in TRACERS.items() if method.builds)
    if find_method("trace", tracer) is None:
        raise InputError(f"tracer {tracer!r} is unknown; choose one of {walking}")
    if not TRACERS[tracer].builds:
        raise InputError(f"tracer {tracer!r} walks no BVH, whose building is measured here; choose one of {walking}")
    if plot is not None:
        arguments.check_plot(plot)

    from ..answers import agree
    from . import measure as bench
    from .views import culling_views

    n_threads = thread_count(threads)
    with ProgressDisplay(quiet) as display:
        display.say("making the scenes")
        views = culling_views(sponza, width_height, triangles)
        times = [t for v in views for t in bench.times_to_image(v, tracer, n_threads, rounds, display.say)]
        grids = [r for v in views for r in bench.grid_rows(v, tracer, n_threads, rounds, display.say)]
        if plot is not None:
            from .plot import write_plot

            write_plot(times, plot)
    same = agree((t.figure, t.bits) for t in times)
    if json:
        rows = [{**t._asdict(), "bits": t.bits.hex()} for t in times]
        asked = {"tracer": tracer, "size": width_height, "rounds": rounds, "threads": n_threads}
        report.print_json({**asked, "time_to_image": rows, "grids": [g._asdict() for g in grids], "same_bits": same})
        return
    if quiet:
        return
    _print_times(times)
    _print_grids(bench.mean_rows(grids))
    report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f}"


def _print_times(times: "list[TimeToImage]") -> None:
    """Print Table 3, with the paper's ratios to LBVH in brackets, and the break-even points of Figure 7."""
    from .measure import SAMPLES, break_even
    from .published import REMAINING, TIME_TO_IMAGE

    rows = []
    for t in times:
        first, last = (next(o for o in times if (o.figure, o.method) == (t.figure, m)) for m in ("LBVH", "BSAH"))
        theirs = TIME_TO_IMAGE.get(t.figure)
        ratios = []
        for k, spp in enumerate(SAMPLES):
            paper = f" ({100 * theirs[t.method][3 + k] / theirs['LBVH'][3 + k]:.0f})" if theirs else ""
            ratios.append(f"{100 * t.total(spp) / first.total(spp):.0f}{paper}")
        share = f"{100 * t.remaining:.0f}" + (
            f" ({100 * REMAINING[t.figure]:.0f})" if t.remaining < 1 and theirs else ""
        )
        caught = "" if t is last else f"{break_even(last, t):.0f}"
        seconds = t.cull, t.build, t.trace[1], *(t.total(spp) for spp in SAMPLES)
        rows.append((t.figure, t.method, share, *map(_ms, seconds), *ratios, caught))
    sums, ratios = ([f"{name} {spp} spp" for spp in SAMPLES] for name in ("sum", "% of LBVH"))
    head = ("view", "method", "% left", "cull", "build", "trace 1 spp", *sums, *ratios, "BSAH even at")
    print("Time to image, ms (the paper's figures in brackets)")
    report.print_table(head, rows, right=range(2, len(head)), width=_WIDTH)


def _print_grids(rows: "list[GridRow]") -> None:
    """Print Table 4, with the paper's share of the triangles and its time to mark cells in brackets."""
    from .published import GRIDS

    table = []
    for r in rows:
        theirs = GRIDS[r.grid]
        mark = f"{_ms(r.steps['mark'])} ({theirs[2]:.1f})"
        names = "lbvh", "tl-lbvh"
        times = [_ms(part[b]) if b in part else "" for b in names for part in (r.build, r.trace)]
        share = f"{100 * r.remaining:.0f} ({100 * theirs[0]:.0f})"
        how = "as published" if r.published else "hulls"
        total = _ms(sum(r.steps.values()))
        table.append((str(r.grid), how, share, _ms(r.steps["sources"]), mark, _ms(r.steps["triangles"]), total, *times))
    head = (
        "grid", "marked by", "% left", "sources", "mark", "triangles", "all culling",
        "build LBVH", "trace 1 spp", "build TL-LBVH", "trace 1 spp",
    )  # fmt: skip
    print("Grids, ms, means over the views (the paper's figures, of another scene, in brackets)")
    report.print_table(head, table, right=(0, *range(2, len(head))), width=_WIDTH)
