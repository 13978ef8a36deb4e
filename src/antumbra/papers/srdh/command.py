"""``antumbra bench srdh``: cost and gain of trees that are built for shadow rays."""

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
    from .measure import Counted
    from .rtsah import Assumed
    from .times import BuildTimes, RenderTimes


@benchmark(scene=["blinds", "procedural:cellar?triangles=50k"], size="192x192", timed_size="192x192", rounds=1)
def srdh(
    results: Results,
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
        Path | None,
        typer.Option(
            help="Write bars and curves to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")
        ),
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
    points (Figures 2, 4, 5). RTSAH is checked with lines spread evenly, which it assumes. Build times are those of
    Table 1. Trace times are of direct light at the visible surfaces.

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
    from . import rtsah
    from . import times as srdh_times
    from . import views as srdh_views

    plots = results.plots(plot)
    n_threads = thread_count(threads)
    rows: list[Counted] = []
    assumed: list[Assumed] = []
    builds: list[BuildTimes] = []
    renders: list[RenderTimes] = []
    with ProgressDisplay(quiet) as display:
        display.say("opening the scenes")
        names = dict.fromkeys(scene or srdh_views.default_names())
        for view in [open_view(name, width_height, srdh_views.named_view) for name in names]:
            rows += counts.count_view(view, spp, n_threads, display.say)
            display.say(f"{view.name}, lines spread evenly")
            assumed.append(rtsah.check_rtsah(counts.Workload(view, spp, n_threads)))
            builds += srdh_times.build_times(view, spp, n_threads, rounds, display.say)
            smaller = view._replace(camera=view.camera.resized(*timed))
            renders += srdh_times.render_times(smaller, n_threads, rounds, display.say)
        for path in plots:
            from .plot import write_plot

            write_plot(rows, path)
    same = agree((r.scene, r.bits) for r in renders)
    asked = {"size": width_height, "spp": spp, "timed_size": timed, "rounds": rounds, "threads": n_threads}
    tables = {
        "counts": [{**r._asdict(), "relative": counts.relative(rows, r)} for r in rows],
        "rtsah": [a._asdict() for a in assumed],
        "builds": [{**b._asdict(), "both": b.both, "instead": b.instead} for b in builds],
        "renders": [{**r._asdict(), "bits": r.bits.hex()} for r in renders],
    }

    from . import tables as printed

    with results.told({**asked, **tables, "same_bits": same}):
        printed.print_orders(rows)
        printed.print_saved(rows)
        printed.print_rtsah(assumed)
        printed.print_pixels(rows)
        printed.print_kernels(rows)
        printed.print_builds(builds)
        printed.print_renders(renders)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])
