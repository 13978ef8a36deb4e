"""``antumbra bench pre-bvh-culling``: times to image with culling and without, and the cost of grids."""

from pathlib import Path
from typing import Annotated

import typer

from ...cli import arguments
from ...cli import console as report
from ...cli.bench_command import Results, benchmark
from ...cli.console import ProgressDisplay
from ...cli.options import Json, Quiet, Threads, writes
from ...errors import InputError


@benchmark(size="320x180", cellar="250k", video="100k", frames=3, rounds=1)
def pre_bvh_culling(
    results: Results,
    sponza: Annotated[
        Path | None,
        typer.Option(
            help="Crytek's Sponza.  [default: sponza_crytek/scene.glb in $ANTUMBRA_SCENES, or an atrium]",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Write the break-even plot to a .png file.",
            metavar="FILE",
            show_default=False,
            callback=writes(".png"),
        ),
    ] = None,
    tracer: Annotated[
        list[str] | None,
        typer.Option(
            help="How rays are traced, see antumbra plans; may be repeated.  [default: single and multifrusta]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    size: Annotated[str, typer.Option(help="Size of the pictures in pixels.", metavar="WxH")] = "1366x768",
    cellar: Annotated[str, typer.Option(help="Triangles of the cellar.", metavar="N")] = "1M",
    video: Annotated[str, typer.Option(help="Triangles of the animated city of Table 4.", metavar="N")] = "1M",
    frames: Annotated[int, typer.Option(help="Frames of the animation that are measured.", min=1, max=1000)] = 4,
    rounds: Annotated[int, typer.Option(help="Measurements of each; the median counts.", min=1, max=1000)] = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Time to image with pre-BVH culling and without [Selgrad et al. 2015, Tables 1 to 4, Figures 2 and 7].

    Tables 1 to 3 are of the paper's four views, and Table 4 is of an animated city. Figure 2 compares the grid with a
    convex region around receivers and lights; antumbra culling --culler grid32:convex draws it.

    \b
    Examples
      antumbra bench pre-bvh-culling
      antumbra bench pre-bvh-culling --sponza sponza.glb --rounds 5 --plot break_even.png
      antumbra bench pre-bvh-culling --tracer single --size 683x384 --cellar 250k --video 250k
    """
    width_height = arguments.parse_size(size)
    cellar_triangles, video_triangles = (
        arguments.parse_count(cellar, "--cellar"),
        arguments.parse_count(video, "--video"),
    )

    from ...kernels.parallel import thread_count

    tracers = list(dict.fromkeys(tracer or ("single", "multifrusta")))
    for name in tracers:
        _check_tracer(name)
    plots = results.plots(plot)

    from ..answers import agree
    from . import measure as bench
    from .video import video_views
    from .views import culling_views

    n_threads = thread_count(threads)
    with ProgressDisplay(quiet) as display:
        display.say("making the scenes")
        views = culling_views(sponza, width_height, cellar_triangles)
        times = [
            t for v in views for name in tracers for t in bench.times_to_image(v, name, n_threads, rounds, display.say)
        ]
        grids = [r for v in views for r in bench.grid_rows(v, bench.USUAL, (), n_threads, rounds, display.say)]
        moving = video_views(video_triangles, frames, width_height)
        filmed = [r for v in moving for r in bench.grid_rows(v, bench.VIDEO, tracers, n_threads, rounds, display.say)]
        for path in plots:
            from .plot import write_plot

            write_plot(times, path)
    same = agree((t.figure, t.bits) for t in times)
    rows = [{**t._asdict(), "bits": t.bits.hex()} for t in times]
    asked = {"tracers": tracers, "size": width_height, "rounds": rounds, "frames": frames, "threads": n_threads}
    tables = {"time_to_image": rows, "grids": [g._asdict() for g in grids], "video": [g._asdict() for g in filmed]}

    from . import tables as printed

    with results.told({**asked, **tables, "same_bits": same}):
        printed.print_details(times, grids)
        printed.print_times(times)
        printed.print_regions(grids)
        printed.print_grids(bench.mean_rows(filmed), tracers)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _check_tracer(name: str) -> None:
    """Raise InputError unless a tracer of this name walks a BVH."""
    from ...methods import TRACERS, find_method

    walking = ", ".join(each for each, method in TRACERS.items() if method.builds)
    found = find_method("trace", name)
    if found is None:
        raise InputError(f"tracer {name!r} is unknown; choose one of {walking}")
    if not found[1].builds:
        raise InputError(f"tracer {name!r} walks no BVH, whose building is measured here; choose one of {walking}")
