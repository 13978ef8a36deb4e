"""``antumbra bench chc-rt``: cost and gain of occlusion culling for rays, in memory and out of core."""

from pathlib import Path
from typing import Annotated

import typer

from ...cli import arguments
from ...cli import console as report
from ...cli.bench_command import Results, benchmark
from ...cli.console import ProgressDisplay
from ...cli.options import Json, MaxMemoryOption, Quiet, Threads, writes, writes_folder
from ...errors import InputError
from ..views import open_view
from .kinds import IN_CORE, PAGED, WALKED, Table


@benchmark(triangles="300k", size="192x108", frames=4, compared=1, limit=0.5)
def chc_rt(
    results: Results,
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, a procedural scene; may be repeated.  [default: the city, and "
            "sanmiguel_lite where it is there]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            help="Instead of scenes in memory, a store that antumbra build has made.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    max_memory: MaxMemoryOption = None,
    table: Annotated[
        list[Table] | None,
        typer.Option(help="Measure only this; may be repeated.  [default: all]", show_default=False),
    ] = None,
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Write bars and curves to a .png file.", metavar="FILE", show_default=False, callback=writes(".png")
        ),
    ] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            help="Write pictures of culling to a folder.",
            metavar="FOLDER",
            show_default=False,
            callback=writes_folder(),
        ),
    ] = None,
    triangles: Annotated[str, typer.Option(help="Size of the city.", metavar="N")] = "10M",
    size: Annotated[str, typer.Option(help="Size of the pictures.", metavar="WxH")] = "640x360",
    frames: Annotated[int, typer.Option(help="Frames of a walkthrough.", min=1, max=10_000)] = 60,
    compared: Annotated[
        int, typer.Option(help="In how many frames the other plans have their turns.", min=1, max=10_000)
    ] = 3,
    limit: Annotated[
        float,
        typer.Option(help="End a walkthrough after so long; two frames come anyway.", metavar="SECONDS", min=0.0),
    ] = 120.0,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """CHC+RT beside tracing from the root: times, phases, queries, paging [Mattausch et al. 2015].

    There is a near and a far walkthrough, and CHC+RT keeps its state from frame to frame. Each pixel has primary rays,
    20 rays of ambient occlusion, 20 diffuse rays, and 16 shadow rays to an area light.

    Times are medians over the frames after the first. The tables show sizes (Table 1), times (Table 2), phases
    (Figure 8), queries and bytes moved (Table 3), randomised directions (Table 5), aggressive mode (Table 4), and
    CHC+RT without its parts. A store also has its hit rate and two ways to make room, but no randomised directions.

    Lines on standard error show each walkthrough as soon as it has ended.

    Pictures are of two frames of the near walkthrough: queries and triangles of each tile (Figure 4), subtrees (Figure
    5), the matrix of rays and triangles (Figure 6), and the error of aggressive mode (Figure 9).

    \b
    Examples
      antumbra bench chc-rt --triangles 1M --frames 20
      antumbra bench chc-rt --scene sanmiguel_lite --table times --table phases --plot chcrt.png
      antumbra bench chc-rt --scene atrium --table queries --frames 2 --pictures .
      antumbra bench chc-rt --store city.antumbra --max-memory 1G
    """
    width_height = arguments.parse_size(size)
    tables = _checked_tables(table, scene, store, max_memory)
    memory = None if max_memory is None else arguments.parse_bytes(max_memory, "--max-memory")
    count = arguments.parse_count(triangles, "--triangles")

    from ...generate.palette import check_request
    from ...kernels.parallel import thread_count
    from ...store.system_resources import peak_resident
    from . import session
    from . import views as chcrt_views
    from .measure import Pace

    check_request("city", count, 0)
    if plot is not None and not WALKED.intersection(tables):
        raise InputError("--plot shows what --table times, phases, queries or store measure; name one of them")
    plots = results.plots(plot) if WALKED.intersection(tables) else []
    if pictures is not None:
        if store is not None:
            raise InputError("--pictures shows scenes in memory; leave --store out")
        arguments.check_plot(pictures / "figure-4.png", "--pictures")
    elif store is None:
        pictures = results.pictures()
    n_threads, pace = thread_count(threads), Pace(frames, compared, limit)
    show = (lambda turns: None) if json or quiet else session.show_medians
    with ProgressDisplay(quiet) as activity:
        activity.say("opening the scenes")
        names = dict.fromkeys([str(store)] if store else scene or chcrt_views.default_names(count))
        views = [open_view(name, width_height, chcrt_views.named_view) for name in names]
        if store is None:
            for view in views:
                chcrt_views.check_in_memory(view)
        places = [chcrt_views.place_of(view) for view in views]
        if store is None:
            found, same = session.in_memory(places, tables, n_threads, pace, activity.say, show, pictures)
        else:
            found, same = session.out_of_core(places[0], tables, memory, n_threads, pace, activity.say, show)
        walked = found.get(Table.store) or found.get(Table.times) or []
        for path in plots:
            from .plot import write_plot

            write_plot(walked, path)
    differs, peak = session.differing(found), peak_resident()
    told = {
        True: "the same by all methods",
        False: f"DIFFER, of {differs:,} rays: please report this",
        None: "not compared",
    }
    size = report.size_in_memory(peak) if peak else "unknown"
    from .tables import PRINT

    asked = {"size": width_height, "frames": frames, "compared": compared, "limit": limit, "threads": n_threads}
    measured = {name.value: [t._asdict() for t in rows] for name, rows in found.items()}
    with results.told({**asked, **measured, "differs": differs, "same_answers": same, "peak_resident": peak}):
        for name in tables:
            PRINT[name](found.get(name, walked))
        report.print_fields([("answers", told[same]), ("memory at its peak", size)])


def _checked_tables(tables, scene, store, max_memory) -> tuple[Table, ...]:
    """The requested tables, in order; InputError on options that do not go together."""
    if store is None and max_memory is not None:
        raise InputError("--max-memory is for --store; leave it out")
    if store is not None and scene:
        raise InputError("--store is measured by itself; leave --scene out")
    possible = IN_CORE if store is None else PAGED
    wrong = [name.value for name in tables or () if name not in possible]
    if wrong:
        cure = "name a --store" if store is None else "leave --store out"
        raise InputError(f"--table {wrong[0]} has nothing to measure; {cure}")
    return tuple(name for name in possible if not tables or name in tables)
