"""``antumbra bench srdh``, ``pre-bvh-culling`` and ``chc-rt``: what trees for shadow rays and culling cost and gain.

The measurements are imported only when a command runs, which keeps the help of ``antumbra bench`` fast.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..cli import arguments
from ..cli import console as report
from ..cli.bench_command import Results, benchmark
from ..cli.console import ProgressDisplay
from ..cli.options import Json, MaxMemoryOption, Quiet, Threads, writes_folder
from ..errors import InputError
from .bench_options import ImageSize, Rounds, open_views, plot_option, print_agreement, scene_option
from .chc_rt.chcrt_published import IN_CORE, PAGED, WALKED, ChcrtTable

# --- antumbra bench srdh ----------------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from .srdh.srdh_measurements import BoxTests, BuildTimes, RenderTimes, RtsahCheck


@benchmark(scene=["blinds", "procedural:cellar?triangles=50k"], size="192x192", timed_size="192x192", rounds=1)
def srdh(
    results: Results,
    scene: Annotated[
        list[str] | None, scene_option("five folders and blinds; without the folders: blinds, cellar and atrium")
    ] = None,
    plot: Annotated[Path | None, plot_option("bars and curves")] = None,
    size: Annotated[str, typer.Option(help="Image size for counting box tests.", metavar="WxH")] = "1024x1024",
    spp: Annotated[int, typer.Option(help="Shadow rays counted per light and point.", min=1, max=1024)] = 1,
    timed_size: Annotated[str, typer.Option(help="Image size for timing.", metavar="WxH")] = "512x512",
    rounds: Rounds = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Trees and traversal orders for shadow rays: box tests, build and trace times [Feltman et al. 2012].

    Box tests are counted for shadow rays from the visible surfaces, and from where one diffuse ray per visible point
    hits (Figures 2, 4, 5). RTSAH is checked with uniformly distributed lines, which it assumes. Build times are as in
    Table 1; trace times are for direct light at the visible surfaces.

    \b
    Examples
      antumbra bench srdh
      antumbra bench srdh --scene blinds --scene room.glb --plot srdh.png
      antumbra bench srdh --scene "procedural:cellar?triangles=50k" --size 256 --rounds 5
    """
    width_height, timed = arguments.parse_size(size), arguments.parse_size(timed_size, "--timed-size")

    from ..kernels.parallel import thread_count
    from .benchmark_views import agree
    from .srdh import srdh_measurements as bench

    plots = results.plots(plot)
    n_threads = thread_count(threads)
    rows: list[BoxTests] = []
    assumed: list[RtsahCheck] = []
    builds: list[BuildTimes] = []
    renders: list[RenderTimes] = []
    with ProgressDisplay(quiet) as display:
        for view in open_views(scene or bench.default_names(), width_height, bench.named_view, display.say):
            rows += bench.count_view(view, spp, n_threads, display.say)
            display.say(f"{view.name}, uniformly distributed lines")
            assumed.append(bench.check_rtsah(bench.Workload(view, spp, n_threads)))
            builds += bench.build_times(view, spp, n_threads, rounds, display.say)
            smaller = view._replace(camera=view.camera.resized(*timed))
            renders += bench.render_times(smaller, n_threads, rounds, display.say)
        for path in plots:
            from .srdh.srdh_tables import write_plot

            write_plot(rows, path)
    same = agree((r.scene, r.bits) for r in renders)
    settings = {"size": width_height, "spp": spp, "timed_size": timed, "rounds": rounds, "threads": n_threads}
    tables = {
        "counts": [{**r._asdict(), "relative": bench.relative(rows, r)} for r in rows],
        "rtsah": [a._asdict() for a in assumed],
        "builds": [{**b._asdict(), "both": b.both, "instead": b.instead} for b in builds],
        "renders": [{**r._asdict(), "bits": r.bits.hex()} for r in renders],
    }

    from .srdh import srdh_tables as printed

    with results.told({**settings, **tables, "same_bits": same}):
        printed.print_orders(rows)
        printed.print_saved(rows)
        printed.print_rtsah(assumed)
        printed.print_pixels(rows)
        printed.print_kernels(rows)
        printed.print_builds(builds)
        printed.print_renders(renders)
        print_agreement(same)


# --- antumbra bench pre-bvh-culling -----------------------------------------------------------------------------------


@benchmark(size="320x180", cellar="250k", video="100k", frames=3, rounds=1)
def pre_bvh_culling(
    results: Results,
    sponza: Annotated[
        Path | None,
        typer.Option(
            help="Crytek's Sponza.  [default: sponza_crytek/scene.glb in $ANTUMBRA_SCENES, else the atrium]",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    plot: Annotated[Path | None, plot_option("break-even")] = None,
    tracer: Annotated[
        list[str] | None,
        typer.Option(
            help="A tracer (see antumbra plans); may be repeated.  [default: single and multifrusta]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None,
    size: ImageSize = "1366x768",
    cellar: Annotated[str, typer.Option(help="Triangles in the cellar.", metavar="N")] = "1M",
    video: Annotated[str, typer.Option(help="Triangles in the animated city (Table 4).", metavar="N")] = "1M",
    frames: Annotated[int, typer.Option(help="Animation frames to measure.", min=1, max=1000)] = 4,
    rounds: Rounds = 3,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Time to image with and without pre-BVH culling [Selgrad et al. 2015, Tables 1 to 4, Figures 2 and 7].

    Tables 1 to 3 cover the paper's four views; Table 4 covers an animated city. Figure 2 compares the grid with a
    convex region around receivers and lights, which antumbra culling --culler grid32:convex draws.

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

    n_threads = thread_count(threads)
    with ProgressDisplay(quiet) as display:
        display.say("making the scenes")
        views = bench.culling_views(sponza, width_height, cellar_triangles)
        times = [
            t for v in views for name in tracers for t in bench.times_to_image(v, name, n_threads, rounds, display.say)
        ]
        grids = [r for v in views for r in bench.grid_rows(v, bench.USUAL, (), n_threads, rounds, display.say)]
        moving = bench.video_views(video_triangles, frames, width_height)
        filmed = [r for v in moving for r in bench.grid_rows(v, bench.VIDEO, tracers, n_threads, rounds, display.say)]
        for path in plots:
            bench.write_plot(times, path)
    same = agree((t.figure, t.bits) for t in times)
    rows = [{**t._asdict(), "bits": t.bits.hex()} for t in times]
    settings = {"tracers": tracers, "size": width_height, "rounds": rounds, "frames": frames, "threads": n_threads}
    tables = {"time_to_image": rows, "grids": [g._asdict() for g in grids], "video": [g._asdict() for g in filmed]}

    with results.told({**settings, **tables, "same_bits": same}):
        bench.print_details(times, grids)
        bench.print_times(times)
        bench.print_regions(grids)
        bench.print_grids(bench.mean_rows(filmed), tracers)
        print_agreement(same)


def _check_tracer(name: str) -> None:
    """Raise InputError unless the tracer exists and uses a BVH."""
    from ..engine.method_registry import TRACERS, find_method

    with_bvh = ", ".join(each for each, method in TRACERS.items() if method.builds)
    match = find_method("trace", name)
    if match is None:
        raise InputError(f"tracer {name!r} is unknown; choose one of {with_bvh}")
    if not match[1].builds:
        raise InputError(
            f"tracer {name!r} uses no BVH, and this benchmark measures BVH builds; choose one of {with_bvh}"
        )


# --- antumbra bench chc-rt --------------------------------------------------------------------------------------------


@benchmark(triangles="300k", size="192x108", frames=4, compared=1, limit=0.5)
def chc_rt(
    results: Results,
    scene: Annotated[list[str] | None, scene_option("the city, and sanmiguel_lite if it exists")] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            help="Trace a store from antumbra build instead of scenes in memory.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    max_memory: MaxMemoryOption = None,
    table: Annotated[
        list[ChcrtTable] | None,
        typer.Option(help="Measure only this table; may be repeated.  [default: all]", show_default=False),
    ] = None,
    plot: Annotated[Path | None, plot_option("bars and curves")] = None,
    pictures: Annotated[
        Path | None,
        typer.Option(
            help="Write figures of the culling state to a folder.",
            metavar="FOLDER",
            show_default=False,
            callback=writes_folder(),
        ),
    ] = None,
    triangles: Annotated[str, typer.Option(help="Triangles in the city.", metavar="N")] = "10M",
    size: ImageSize = "640x360",
    frames: Annotated[int, typer.Option(help="Frames per walkthrough.", min=1, max=10_000)] = 60,
    compared: Annotated[int, typer.Option(help="Frames to time the other plans on.", min=1, max=10_000)] = 3,
    limit: Annotated[
        float,
        typer.Option(help="Time limit per walkthrough; at least two frames run.", metavar="SECONDS", min=0.0),
    ] = 120.0,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """CHC+RT compared with tracing from the root: times, phases, queries, paging [Mattausch et al. 2015].

    Measures a near and a far walkthrough; CHC+RT keeps its state from frame to frame. Each pixel has a primary ray, 20
    ambient occlusion rays, 20 diffuse rays, and 16 shadow rays to an area light.

    Times are medians over the frames after the first. The tables cover sizes (Table 1), times (Table 2), phases
    (Figure 8), queries and bytes read (Table 3), randomised directions (Table 5), aggressive mode (Table 4), and an
    ablation. A store has a table of hit rates with two eviction policies instead of randomised directions.

    The medians of each walkthrough are printed to standard error as soon as it ends.

    --pictures draws two frames of the near walkthrough: queries and triangles per tile (Figure 4), subtrees (Figure
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
    from ..store.system_resources import peak_resident_memory
    from .chc_rt import chcrt_tables as session
    from .chc_rt import walkthroughs as chcrt_views
    from .chc_rt.walkthrough_timing import Pace

    check_request("city", count, 0)
    if plot is not None and not WALKED.intersection(tables):
        raise InputError("--plot needs --table times, phases, queries or store")
    plots = results.plots(plot) if WALKED.intersection(tables) else []
    if pictures is not None:
        if store is not None:
            raise InputError("--pictures draws scenes in memory; omit --store")
        arguments.check_plot(pictures / "figure-4.png", "--pictures")
    elif store is None:
        pictures = results.pictures()
    n_threads, pace = thread_count(threads), Pace(frames, compared, limit)
    show = (lambda turns: None) if json or quiet else session.show_medians
    with ProgressDisplay(quiet) as display:
        names = [str(store)] if store else scene or chcrt_views.default_names(count)
        views = open_views(names, width_height, chcrt_views.named_view, display.say)
        if store is None:
            for view in views:
                chcrt_views.check_in_memory(view)
        places = [chcrt_views.place_of(view) for view in views]
        if store is None:
            rows, same = session.measure_in_memory(places, tables, n_threads, pace, display.say, show, pictures)
        else:
            rows, same = session.measure_out_of_core(places[0], tables, memory, n_threads, pace, display.say, show)
        walked = rows.get(ChcrtTable.store) or rows.get(ChcrtTable.times) or []
        for path in plots:
            from .chc_rt.chcrt_figures import write_plot

            write_plot(walked, path)
    differs, peak = session.differing(rows), peak_resident_memory()
    verdict = {
        True: "the same by all methods",
        False: f"DIFFER for {differs:,} rays: please report this",
        None: "not compared",
    }
    size = report.size_in_memory(peak) if peak else "unknown"
    from .chc_rt.chcrt_tables import PRINT

    settings = {"size": width_height, "frames": frames, "compared": compared, "limit": limit, "threads": n_threads}
    measured = {name.value: [t._asdict() for t in table_rows] for name, table_rows in rows.items()}
    with results.told({**settings, **measured, "differs": differs, "same_answers": same, "peak_resident": peak}):
        for name in tables:
            PRINT[name](rows.get(name, walked))
        report.print_fields([("answers", verdict[same]), ("peak memory", size)])


def _checked_tables(
    tables: list[ChcrtTable] | None, scene: list[str] | None, store: Path | None, max_memory: str | None
) -> tuple[ChcrtTable, ...]:
    """The requested tables, in order; InputError on conflicting options."""
    if store is None and max_memory is not None:
        raise InputError("--max-memory needs --store")
    if store is not None and scene:
        raise InputError("--store and --scene cannot be combined")
    possible = IN_CORE if store is None else PAGED
    wrong = [name.value for name in tables or () if name not in possible]
    if wrong:
        cure = "needs a --store" if store is None else "needs scenes in memory; omit --store"
        raise InputError(f"--table {wrong[0]} {cure}")
    return tuple(name for name in possible if not tables or name in tables)
