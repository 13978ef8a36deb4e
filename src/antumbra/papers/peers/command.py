"""``antumbra bench peers``: soft shadows by bsah+auto beside Embree."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...cli import arguments
from ...cli import console as report
from ...cli.bench_command import Results, benchmark
from ...cli.console import ProgressDisplay
from ...cli.options import Json, Quiet, Threads, writes
from ..views import open_view

if TYPE_CHECKING:
    from .measure import Built

_WIDTH = 110  # width of the tables, in characters


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

    from ...kernels.parallel import thread_count
    from ...plan import parse_plan
    from ...rendering.render_jobs import warm_up
    from . import measure as bench
    from .contenders import describe_embree

    plan = parse_plan("bsah+auto")
    plots = results.plots(plot)
    embree = describe_embree()  # an error if it is missing
    counts = [threads] if threads else list(dict.fromkeys((1, thread_count(None))))
    rows: list[dict] = []
    builds: list[Built] = []
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or bench.default_names())
        views = [open_view(name, width_height, bench.named_view) for name in names]
        warm_up(plan, "raster", False)
        for view in views:
            found, times = bench.measure(view, plan, spp, counts, rounds, display.say)
            rows += found
            builds += times
            if not (json or quiet):
                _show(found)
        for path in plots:
            from .plot import write_plot

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
    from .measure import finalists

    first, table = rows[0], []
    for row in finalists(rows):
        ratio = f"{row['ratio']:.2f}" if "ratio" in row else ""
        rates = f"{row['mrays']:.2f}", f"{row['best_mrays']:.2f}"
        table.append((f"{row['threads']}", row["contender"], *rates, ratio, f"{row['differs']:,}"))
    told = f"{first['triangles']:,} triangles, {first['rays'] / 1e6:.2f} M rays, {first['occluded']:.0%} blocked"
    print(f"Soft shadows, {first['scene']}: {told}")
    head = ("threads", "contender", "M rays/s", "at best", "ratio", "rays that differ")
    report.print_table(head, table, right=(0, 2, 3, 4, 5), width=_WIDTH)


def _print_builds(builds: "list[Built]") -> None:
    scenes, methods = (list(dict.fromkeys(getattr(b, name) for b in builds)) for name in ("scene", "method"))
    seconds = {(b.scene, b.method): b.seconds for b in builds}
    table = [(scene, *(f"{1e3 * seconds[scene, method]:.0f}" for method in methods)) for scene in scenes]
    print("Build times on all cores, ms; ours with the blocks of the tracer")
    report.print_table(("scene", *methods), table, right=range(1, 1 + len(methods)), width=_WIDTH)


def _print_summary(embree: str, rows: list[dict]) -> None:
    from .contest import summary

    report.print_fields([("peer", embree), *(("ours", line) for line in summary(rows))])
