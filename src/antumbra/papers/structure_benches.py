"""``antumbra bench srdh``, ``pre-bvh-culling`` and ``chc-rt``: cost and gain of trees for shadow rays, and of culling.

Measurements are imported when a command runs, so the help of ``antumbra bench`` stays fast.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..cli import arguments
from ..cli import console as report
from ..cli.bench_command import Results, benchmark
from ..cli.console import ProgressDisplay
from ..cli.options import Json, MaxMemoryOption, Quiet, Threads, writes, writes_folder
from ..errors import InputError
from .benchmark_views import open_view
from .chc_rt.chcrt_published import IN_CORE, PAGED, WALKED, ChcrtTable

# --- ``antumbra bench srdh``: cost and gain of trees that are built for shadow rays -----------------------------------


if TYPE_CHECKING:
    from .srdh.srdh_measurements import BoxTests, BuildTimes, RenderTimes, RtsahCheck


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

    from ..kernels.parallel import thread_count
    from .benchmark_views import agree
    from .srdh import srdh_measurements as counts
    from .srdh import srdh_measurements as rtsah
    from .srdh import srdh_measurements as srdh_times
    from .srdh import srdh_measurements as srdh_views

    plots = results.plots(plot)
    n_threads = thread_count(threads)
    rows: list[BoxTests] = []
    assumed: list[RtsahCheck] = []
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
            from .srdh.srdh_tables import write_plot

            write_plot(rows, path)
    same = agree((r.scene, r.bits) for r in renders)
    asked = {"size": width_height, "spp": spp, "timed_size": timed, "rounds": rounds, "threads": n_threads}
    tables = {
        "counts": [{**r._asdict(), "relative": counts.relative(rows, r)} for r in rows],
        "rtsah": [a._asdict() for a in assumed],
        "builds": [{**b._asdict(), "both": b.both, "instead": b.instead} for b in builds],
        "renders": [{**r._asdict(), "bits": r.bits.hex()} for r in renders],
    }

    from .srdh import srdh_tables as printed

    with results.told({**asked, **tables, "same_bits": same}):
        printed.print_orders(rows)
        printed.print_saved(rows)
        printed.print_rtsah(assumed)
        printed.print_pixels(rows)
        printed.print_kernels(rows)
        printed.print_builds(builds)
        printed.print_renders(renders)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


# --- ``antumbra bench pre-bvh-culling``: times to image with culling and without, and the cost of grids ---------------


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

    from ..kernels.parallel import thread_count

    tracers = list(dict.fromkeys(tracer or ("single", "multifrusta")))
    for name in tracers:
        _check_tracer(name)
    plots = results.plots(plot)

    from .benchmark_views import agree
    from .pre_bvh_culling import culling_measurements as bench
    from .pre_bvh_culling.culling_measurements import culling_views, video_views

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
            from .pre_bvh_culling.culling_measurements import write_plot

            write_plot(times, path)
    same = agree((t.figure, t.bits) for t in times)
    rows = [{**t._asdict(), "bits": t.bits.hex()} for t in times]
    asked = {"tracers": tracers, "size": width_height, "rounds": rounds, "frames": frames, "threads": n_threads}
    tables = {"time_to_image": rows, "grids": [g._asdict() for g in grids], "video": [g._asdict() for g in filmed]}

    from .pre_bvh_culling import culling_measurements as printed

    with results.told({**asked, **tables, "same_bits": same}):
        printed.print_details(times, grids)
        printed.print_times(times)
        printed.print_regions(grids)
        printed.print_grids(bench.mean_rows(filmed), tracers)
        report.print_fields([("bits", "the same by all methods" if same else "DIFFER: please report this")])


def _check_tracer(name: str) -> None:
    """Raise InputError unless a tracer of this name walks a BVH."""
    from ..engine.method_registry import TRACERS, find_method

    walking = ", ".join(each for each, method in TRACERS.items() if method.builds)
    found = find_method("trace", name)
    if found is None:
        raise InputError(f"tracer {name!r} is unknown; choose one of {walking}")
    if not found[1].builds:
        raise InputError(f"tracer {name!r} walks no BVH, whose building is measured here; choose one of {walking}")


# --- ``antumbra bench chc-rt``: cost and gain of occlusion culling for rays, in memory and out of core ----------------


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
        list[ChcrtTable] | None,
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

    from ..generate.palette import check_request
    from ..kernels.parallel import thread_count
    from ..store.system_resources import peak_resident
    from .chc_rt import chcrt_tables as session
    from .chc_rt import walkthroughs as chcrt_views
    from .chc_rt.walkthrough_timing import Pace

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
            found, same = session.measure_in_memory(places, tables, n_threads, pace, activity.say, show, pictures)
        else:
            found, same = session.measure_out_of_core(places[0], tables, memory, n_threads, pace, activity.say, show)
        walked = found.get(ChcrtTable.store) or found.get(ChcrtTable.times) or []
        for path in plots:
            from .chc_rt.chcrt_figures import write_plot

            write_plot(walked, path)
    differs, peak = session.differing(found), peak_resident()
    told = {
        True: "the same by all methods",
        False: f"DIFFER, of {differs:,} rays: please report this",
        None: "not compared",
    }
    size = report.size_in_memory(peak) if peak else "unknown"
    from .chc_rt.chcrt_tables import PRINT

    asked = {"size": width_height, "frames": frames, "compared": compared, "limit": limit, "threads": n_threads}
    measured = {name.value: [t._asdict() for t in rows] for name, rows in found.items()}
    with results.told({**asked, **measured, "differs": differs, "same_answers": same, "peak_resident": peak}):
        for name in tables:
            PRINT[name](found.get(name, walked))
        report.print_fields([("answers", told[same]), ("memory at its peak", size)])


def _checked_tables(tables, scene, store, max_memory) -> tuple[ChcrtTable, ...]:
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
