"""The commands of ``antumbra bench``: one per paper, each with its options and its settings.

The measurements are imported only when a command runs, which keeps the help of ``antumbra bench`` fast.
"""

from functools import partial
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from ...base.errors import InputError
from ...base.memory import readable_size
from ...cli import arguments, console
from ...cli.options import MaxMemoryOption, Threads, writes_folder
from ...picture.render_options import CullFaces
from ..bench_command import BenchResult, BenchRun, benchmark
from .bench_runner import (
    Clock,
    ClockOption,
    ImageSize,
    Rounds,
    check_plot_of_all,
    checked_clock,
    clocked,
    plot_option,
    records,
    scene_option,
    table_option,
)
from .chc_rt.chcrt_published import IN_CORE, PAGED, WALKED, ChcrtTable
from .multi_frusta.frusta_published import FrustaTable
from .pre_bvh_culling.culling_published import CullingTable
from .ray_hierarchy.ray_hierarchy_published import RayHierarchyTable
from .srdh.srdh_published import Lighting, SrdhTable

# --- antumbra bench multi-frusta --------------------------------------------------------------------------------------


class FrustaOptions(NamedTuple):
    """Options of ``antumbra bench multi-frusta``."""

    scene: Annotated[list[str] | None, scene_option("two folders of $ANTUMBRA_SCENES, if they exist, and forest")] = (
        None
    )
    table: Annotated[list[FrustaTable] | None, table_option()] = None
    plot: Annotated[Path | None, plot_option("speedups, and Figures 5 to 7")] = None
    size: ImageSize = "1024x1024"
    primary_size: Annotated[str, typer.Option(help="Image size for primary rays.", metavar="WxH")] = "1024x1024"
    lights_size: Annotated[
        str, typer.Option(help="Image size for Section 6.1, which has no figures.", metavar="WxH")
    ] = "512x512"
    cull_faces: Annotated[
        CullFaces, typer.Option(help="Triangle side that does not block shadow rays; published with: back.")
    ] = CullFaces.back
    rounds: Rounds = 3


@benchmark(size="160x160", primary_size="160x160", lights_size="160x160", rounds=1)
def multi_frusta(run: BenchRun, options: FrustaOptions) -> BenchResult:
    """Multi-frusta tracing compared with packets: accesses, tests and times [Benthin and Wald 2009].

    Traces 16 shadow rays per pixel to a square light on one thread, and measures CPU times. Table 1 compares the
    paper's tracers and ours with packets of 16 rays, for primary (primary), hard shadow (hard) and soft shadow rays
    (soft); Section 5.2 has packets of 256 rays. Table 2 compares three kinds of frustum shrinking (shrinking). Figure
    5 compares 16 filtered samples with 256, and Figure 7 counts silhouette pixels (quality). Figure 6 scales the
    light's edge by 1/4 to 8 (sizes). Section 6.1 has virtual point lights, a sky and ambient occlusion (lights). All
    tracers give the same bits.

    \b
    Examples
      antumbra bench multi-frusta
      antumbra bench multi-frusta --scene forest --size 256 --rounds 3 --plot forest.png
      antumbra bench multi-frusta --table soft --output results
    """
    check_plot_of_all(options)
    size, facing = arguments.parse_size(options.size), options.cull_faces.side
    primary_size = arguments.parse_size(options.primary_size, "--primary-size")
    lights_size = arguments.parse_size(options.lights_size, "--lights-size")

    from .multi_frusta import frusta_measurements
    from .multi_frusta.frusta_plots import write_plot
    from .multi_frusta.frusta_tables import print_tables

    common = {"cull_faces": facing, "rounds": options.rounds, "size": size}
    settings: dict[str, dict[str, Any]] = {table: common for table in FrustaTable}
    settings[FrustaTable.primary] = {**common, "primary_size": primary_size}
    settings[FrustaTable.lights] = {**common, "size": lights_size}
    parts = run.parts(settings, (frusta_measurements.SceneRows, frusta_measurements.SoftShadowQuality), options.table)
    effort = frusta_measurements.FrustaEffort(facing, primary_size, lights_size, options.rounds, run.say)
    for view in frusta_measurements.SCENES.open(options.scene, size, run.say):
        frusta_measurements.add_scene(parts, view, effort)
    scenes = frusta_measurements.scenes_of(parts)
    answer = {"size": size, "primary_size": primary_size, "lights_size": lights_size, "rounds": options.rounds}
    answer |= {"threads": 1, "clock": Clock.cpu, "cull_faces": facing}
    answer |= {"rows": {scene.name: frusta_measurements.records_of(scene) for scene in scenes}}
    whole = all(table in parts for table in (FrustaTable.primary, FrustaTable.soft, FrustaTable.sizes))
    plot = partial(write_plot, scenes) if whole and FrustaTable.quality in parts else None
    compared = any(scene.tables for scene in scenes)  # measuring them raises if bits differ
    return BenchResult(answer, partial(print_tables, scenes), plot, same_bits=compared or None)


# --- antumbra bench ray-hierarchy -------------------------------------------------------------------------------------


class RayHierarchyBenchOptions(NamedTuple):
    """Options of ``antumbra bench ray-hierarchy``."""

    scene: Annotated[
        list[str] | None,
        scene_option("four folders of $ANTUMBRA_SCENES, else atrium and forest", "a file, a folder of vertex frames"),
    ] = None
    table: Annotated[list[RayHierarchyTable] | None, table_option()] = None
    plot: Annotated[Path | None, plot_option("the comparison with the report and curves")] = None
    size: ImageSize = "1024x1024"
    frames: Annotated[
        int, typer.Option(help="Evenly spaced frames of each animation, for curves, each once.", min=0, max=10_000)
    ] = 800
    frame_size: Annotated[str, typer.Option(help="Size of these frames in pixels.", metavar="WxH")] = "1024x1024"
    limit: Annotated[
        float,
        typer.Option(
            help="Do not run variants predicted to take longer per picture, except in frames for curves.",
            metavar="SECONDS",
            min=0.0,
        ),
    ] = 120.0
    cull_faces: Annotated[
        CullFaces,
        typer.Option(
            help="Triangle side, as seen from the receiver, that does not block shadow rays. The report culls faces "
            "visible from the light: back."
        ),
    ] = CullFaces.back
    rounds: Rounds = 3
    clock: ClockOption = Clock.wall
    threads: Threads = None


@benchmark(size="192x192", frames=3, frame_size="96x96", limit=0.5, rounds=1)
def ray_hierarchy(run: BenchRun, options: RayHierarchyBenchOptions) -> BenchResult:
    """Ray hierarchies: nodes, times and their variation [Olsson and Assarsson 2011].

    Traces one shadow ray per pixel to a point light with the variants of the report's Table 1 and ours. The pictures
    are three frames of BART's robots and four of its museum, seen by BART's cameras (Table 2), and static scenes
    (pictures). Frames of the robots' animation give the curves of Figures 6 and 7 (film).

    \b
    Examples
      antumbra bench ray-hierarchy
      antumbra bench ray-hierarchy --scene bart_robots --frames 40 --plot robots.png
      antumbra bench ray-hierarchy --scene procedural:forest --size 512 --limit 10
    """
    check_plot_of_all(options)
    size, frame_size = arguments.parse_size(options.size), arguments.parse_size(options.frame_size, "--frame-size")

    from ...kernels.parallel import thread_count
    from .benchmark_views import agree
    from .ray_hierarchy import ray_hierarchy_measurements
    from .ray_hierarchy.ray_hierarchy_plot import write_plot
    from .ray_hierarchy.ray_hierarchy_published import FIGURE7
    from .ray_hierarchy.ray_hierarchy_tables import print_tables
    from .ray_hierarchy.ray_hierarchy_views import film, open_views, pictures

    effort = ray_hierarchy_measurements.Effort(
        thread_count(options.threads), options.rounds, options.limit, options.cull_faces.side
    )
    clock = checked_clock(options.clock, effort.threads)
    common = {"cull_faces": effort.cull_faces, "threads": effort.threads, "clock": clock}
    settings: dict[str, dict[str, Any]] = {
        RayHierarchyTable.pictures: {**common, "size": size, "limit": effort.limit, "rounds": effort.rounds},
        RayHierarchyTable.film: {**common, "frame_size": frame_size},
    }
    parts = run.parts(settings, ray_hierarchy_measurements.ROWS, options.table)
    views = open_views(options.scene, size, run.say)
    each = {RayHierarchyTable.pictures: effort, RayHierarchyTable.film: effort._replace(limit=None, rounds=1)}
    with clocked(clock):
        for view in views:
            shown = {RayHierarchyTable.pictures: pictures(view)}
            shown[RayHierarchyTable.film] = film(view, options.frames, frame_size)
            for table, cases in shown.items():
                ray_hierarchy_measurements.add_pictures(parts, table, cases, each[table], run.say)
    large, small = (ray_hierarchy_measurements.joined(parts.values(table)) for table in RayHierarchyTable)
    claims, spreads = ray_hierarchy_measurements.claims(large), ray_hierarchy_measurements.spreads(small)
    relative = ray_hierarchy_measurements.relative_costs(small if small.pictures else large, FIGURE7)
    answer = {"size": size, "frames": options.frames, "frame_size": frame_size, **effort._asdict()}
    answer |= {"clock": clock, "pictures": records(large.pictures), "costs": records(large.costs)}
    answer |= {"claims": records(claims)}
    answer |= {"film": {"pictures": records(small.pictures), "costs": records(small.costs)}}
    answer |= {"figure 7": records(relative), "spreads": records(spreads)}
    filmed = parts.wants(RayHierarchyTable.film)
    tables = partial(print_tables, large, small, claims, relative, spreads, filmed)
    plot = partial(write_plot, large, small, claims) if RayHierarchyTable.pictures in parts else None
    return BenchResult(answer, tables, plot, agree([*large.answers(), *small.answers()]))


# --- antumbra bench srdh ----------------------------------------------------------------------------------------------


class SrdhBenchOptions(NamedTuple):
    """Options of ``antumbra bench srdh``."""

    scene: Annotated[
        list[str] | None, scene_option("five folders and blinds; without the folders: blinds, cellar and atrium")
    ] = None
    lighting: Annotated[
        list[Lighting] | None,
        typer.Option(
            help="Lights: the scene's own, two opposed ones, four lamps, ambient occlusion or a sky; may be repeated.  "
            "[default: own; in Sponza and the atrium all; in godot_room also lamps]",
            show_default=False,
        ),
    ] = None
    table: Annotated[list[SrdhTable] | None, table_option()] = None
    plot: Annotated[Path | None, plot_option("bars and curves")] = None
    size: Annotated[str, typer.Option(help="Image size for counting box tests.", metavar="WxH")] = "1024x1024"
    spp: Annotated[int, typer.Option(help="Shadow rays counted per light and point.", min=1, max=1024)] = 1
    timed_size: Annotated[str, typer.Option(help="Image size for timing.", metavar="WxH")] = "512x512"
    rounds: Rounds = 3
    clock: ClockOption = Clock.wall
    threads: Threads = None


@benchmark(scene=["blinds", "procedural:cellar?triangles=50k"], size="192x192", timed_size="192x192", rounds=1)
def srdh(run: BenchRun, options: SrdhBenchOptions) -> BenchResult:
    """Trees and traversal orders for shadow rays: box tests, build and trace times [Feltman et al. 2012].

    Box tests are counted for shadow rays from the visible surfaces, and from where one diffuse ray per visible point
    hits (boxes: Figures 2, 4, 5). For Figure 3, the depths of frequent occluders are listed, and --output draws both
    trees. Memory is as in Section 5. RTSAH is checked with uniformly distributed lines, which it assumes (rtsah). Build
    times are as in Table 1 (builds); trace times are for direct light at the visible surfaces (renders).

    \b
    Examples
      antumbra bench srdh
      antumbra bench srdh --scene blinds --scene room.glb --plot srdh.png
      antumbra bench srdh --scene sponza_crytek --lighting opposed --lighting sky
      antumbra bench srdh --scene "procedural:cellar?triangles=50k" --size 256 --rounds 5
    """
    check_plot_of_all(options)
    size, timed = arguments.parse_size(options.size), arguments.parse_size(options.timed_size, "--timed-size")

    from ...kernels.parallel import thread_count
    from .benchmark_views import agree
    from .comparison_chart import comparison_writer
    from .srdh import srdh_measurements, srdh_tables
    from .srdh.srdh_workloads import SCENES, workloads

    effort = srdh_measurements.SrdhEffort(options.spp, timed, options.rounds, thread_count(options.threads))
    clock = checked_clock(options.clock, effort.threads)
    timing = {"rounds": effort.rounds, "threads": effort.threads, "clock": clock}
    counting = {"size": size, "spp": effort.spp}
    settings: dict[str, dict[str, Any]] = {
        SrdhTable.boxes: counting,
        SrdhTable.builds: {**counting, **timing},
        SrdhTable.rtsah: counting,
        SrdhTable.renders: {"timed_size": timed, **timing},
    }
    parts = run.parts(settings, srdh_measurements.ROWS, options.table)
    views = workloads(SCENES.open(options.scene, size, run.say), options.lighting)
    with clocked(clock):
        srdh_measurements.add_views(parts, views, effort, run.say, run.pictures())
    rows = srdh_measurements.rows_of(parts)
    answer: dict[str, Any] = {"size": size, **effort._asdict(), "clock": clock}
    relative = ({"relative": srdh_measurements.relative(rows.counts, row)} for row in rows.counts)
    answer |= {"counts": [record | more for record, more in zip(records(rows.counts), relative)]}
    answer |= {"saved": srdh_measurements.savings(rows.counts), "trees": records(rows.trees)}
    answer |= {"kernel_gains": records(srdh_measurements.kernel_gains(rows.counts, rows.trees))}
    answer |= {"memory": records(rows.memory, "growth", "growth_shared"), "rtsah": records(rows.rtsah)}
    answer |= {"builds": records(rows.builds, "both", "instead"), "renders": records(rows.renders)}
    answer |= {"gains": records(srdh_measurements.gains(rows.renders))}
    same = agree((row.scene, row.bits) for row in rows.renders) if rows.renders else None
    tables = partial(srdh_tables.print_tables, rows)
    plot = partial(srdh_tables.write_plot, rows.counts) if rows.counts else None
    compared = comparison_writer(srdh_tables.comparison(rows)) if rows.counts and rows.builds else None
    return BenchResult(answer, tables, plot, same, compared)


# --- antumbra bench pre-bvh-culling -----------------------------------------------------------------------------------


class CullingOptions(NamedTuple):
    """Options of ``antumbra bench pre-bvh-culling``."""

    sponza: Annotated[
        Path | None,
        typer.Option(
            help="Crytek's Sponza.  [default: sponza_crytek/scene.glb in $ANTUMBRA_SCENES, else the atrium]",
            metavar="FILE",
            show_default=False,
        ),
    ] = None
    table: Annotated[list[CullingTable] | None, table_option()] = None
    plot: Annotated[Path | None, plot_option("the paper's results beside ours, and break-even")] = None
    tracer: Annotated[
        list[str] | None,
        typer.Option(
            help="A tracer (see antumbra plans); may be repeated.  [default: single and multifrusta]",
            metavar="NAME",
            show_default=False,
        ),
    ] = None
    size: ImageSize = "1366x768"
    cellar: Annotated[str, typer.Option(help="Triangles in the cellar.", metavar="N")] = "1M"
    video: Annotated[str, typer.Option(help="Triangles in the animated city (Table 4).", metavar="N")] = "3.5M"
    frames: Annotated[
        int, typer.Option(help="Evenly spaced frames of the animation to measure, each once.", min=1, max=1000)
    ] = 24
    cameras: Annotated[int, typer.Option(help="Random cameras in each part of Sponza.", min=2, max=1000)] = 30
    finest: Annotated[
        int,
        typer.Option(
            help="Finest grid to mark as published, in cells per axis (Table 4).", metavar="N", min=64, max=256
        ),
    ] = 256
    limit: Annotated[
        float,
        typer.Option(help="Skip sample counts predicted to take longer per picture.", metavar="SECONDS", min=0.0),
    ] = 20.0
    rounds: Rounds = 3
    clock: ClockOption = Clock.wall
    threads: Threads = None


@benchmark(size="192x108", cellar="250k", video="100k", frames=2, cameras=4, finest=64, limit=0.5, rounds=1)
def pre_bvh_culling(run: BenchRun, options: CullingOptions) -> BenchResult:
    """Time to image with and without pre-BVH culling [Selgrad et al. 2015, Tables 1 to 4, Figures 2 to 7].

    Tables 1 to 3 cover the paper's four views, with cells marked as published (grid32:paper) and by hulls (grid32):
    the steps of culling (steps), and times to image (times), also with 15 samples (figures). Table 4 covers an animated
    city (video). Figure 2 compares both with a convex region around receivers and lights, which antumbra culling
    --culler grid32:convex draws, also for random cameras in Sponza (random).

    With --output, the views with 15 samples (Figures 3 to 6) and their marked cells (Figure 2d) are drawn.

    \b
    Examples
      antumbra bench pre-bvh-culling
      antumbra bench pre-bvh-culling --sponza sponza.glb --rounds 5 --plot results.png
      antumbra bench pre-bvh-culling --table times --tracer multifrusta --output results
      antumbra bench pre-bvh-culling --tracer single --size 683x384 --cellar 250k --video 250k
    """
    check_plot_of_all(options)
    size = arguments.parse_size(options.size)
    cellar = arguments.parse_count(options.cellar, "--cellar")
    video = arguments.parse_count(options.video, "--video")

    from ...kernels.parallel import thread_count

    tracers = list(dict.fromkeys(options.tracer or ("single", "multifrusta")))
    for name in tracers:
        _check_tracer(name)

    from .benchmark_views import agree
    from .pre_bvh_culling import culling_charts, culling_measurements, culling_views
    from .pre_bvh_culling.culling_tables import print_tables

    effort = culling_measurements.CullingEffort(thread_count(options.threads), options.rounds, options.limit, run.say)
    clock = checked_clock(options.clock, effort.threads)
    seen = {"size": size, "sponza": str(options.sponza or ""), "threads": effort.threads}
    timed = {**seen, "cellar": cellar, "rounds": effort.rounds, "clock": clock}
    film = {"size": size, "video": video, "frames": options.frames, "finest": options.finest, "tracers": tracers}
    settings: dict[str, dict[str, Any]] = {
        CullingTable.steps: timed,
        CullingTable.times: {**timed, "limit": effort.limit},
        CullingTable.figures: {**timed, "tracer": tracers[-1]},
        CullingTable.random: {**seen, "cameras": options.cameras},
        CullingTable.video: {**film, "threads": effort.threads, "clock": clock},
    }
    parts, folder = run.parts(settings, culling_measurements.ROWS, options.table), run.pictures()
    run.say("making the scenes")
    sponza = culling_views.sponza_scene(options.sponza)
    with clocked(clock):
        if parts.wants(CullingTable.steps, CullingTable.times, CullingTable.figures):
            views = culling_views.culling_views(sponza, size, cellar)
            culling_measurements.add_views(parts, views, tracers, effort, culling_charts.picture_writer(folder))
            cells = folder and culling_charts.cells_file(folder)
            if cells and parts.wants(CullingTable.figures) and not cells.exists():
                run.say("drawing the marked cells")
                culling_charts.write_cells(cells, views, effort.threads)
        if sponza is not None:
            cameras = culling_views.random_views(sponza, options.cameras, size)
            culling_measurements.add_random(parts, cameras, effort)
        if parts.wants(CullingTable.video):
            frames = culling_views.video_views(video, options.frames, size)
            culling_measurements.add_video(parts, frames, tracers, options.finest, effort)
    rows = culling_measurements.rows_of(parts)
    answer = {"tracers": tracers, "size": size, "rounds": effort.rounds, "frames": options.frames}
    answer |= {"cellar": cellar, "video_triangles": video, "threads": effort.threads, "clock": clock}
    answer |= {"limit": effort.limit, "time_to_image": records(rows.times)}
    answer |= {"figures": records(rows.figures, "total"), "grids": records(rows.grids)}
    answer |= {"random": records(rows.shares, "quartiles"), "video": records(rows.video)}
    same = agree((f"{t.figure}, {list(t.trace)}", t.bits) for t in rows.times) if rows.times else None
    plot = partial(culling_charts.write_charts, rows) if rows.times and rows.grids else None
    return BenchResult(answer, partial(print_tables, rows, tracers), plot, same)


def _check_tracer(name: str) -> None:
    """Raise InputError unless the tracer exists and uses a BVH."""
    from ...engine.method_registry import TRACERS, find_method

    with_bvh = ", ".join(each for each, method in TRACERS.items() if method.builds)
    match = find_method("trace", name)
    if match is None:
        raise InputError(f"tracer {name!r} is unknown; choose one of {with_bvh}")
    if not match[1].builds:
        raise InputError(
            f"tracer {name!r} uses no BVH, and this benchmark measures BVH builds; choose one of {with_bvh}"
        )


# --- antumbra bench chc-rt --------------------------------------------------------------------------------------------


class ChcrtOptions(NamedTuple):
    """Options of ``antumbra bench chc-rt``."""

    scene: Annotated[list[str] | None, scene_option("the city, and sanmiguel_lite if it exists")] = None
    store: Annotated[
        Path | None,
        typer.Option(
            help="Trace a store from antumbra build instead of scenes in memory.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None
    stored: Annotated[
        str | None,
        typer.Option(
            help="Also trace a city of N triangles from a store, built in a temporary folder; 0: none.  [default: "
            "40M; with --scene or --store: 0]",
            metavar="N",
            show_default=False,
        ),
    ] = None
    max_memory: MaxMemoryOption = None
    in_core: Annotated[
        float | None,
        typer.Option(
            help="Instead of --max-memory: the percentage of the store's chunks that is in memory, beside the rays.",
            metavar="PERCENT",
            min=1.0,
            max=100.0,
            show_default=False,
        ),
    ] = None
    table: Annotated[list[ChcrtTable] | None, table_option()] = None
    plot: Annotated[Path | None, plot_option("the paper's results and ours, bars and curves")] = None
    pictures: Annotated[
        Path | None,
        typer.Option(
            help="Write figures of the culling state to a folder.",
            metavar="FOLDER",
            show_default=False,
            callback=writes_folder(),
        ),
    ] = None
    triangles: Annotated[str, typer.Option(help="Triangles in the city.", metavar="N")] = "12M"
    size: ImageSize = "1920x1080"
    ablation_size: Annotated[
        str | None,
        typer.Option(
            help="Image size for the ablation, which has few figures in the paper.  [default: --size]",
            metavar="WxH",
            show_default=False,
        ),
    ] = None
    frames: Annotated[int, typer.Option(help="Frames per walkthrough.", min=1, max=10_000)] = 60
    compared: Annotated[int, typer.Option(help="Frames to time the other plans on.", min=1, max=10_000)] = 3
    limit: Annotated[
        float,
        typer.Option(
            help="Time limit per walkthrough of Table 2; others get a third. At least two frames run.",
            metavar="SECONDS",
            min=0.0,
        ),
    ] = 120.0
    clock: ClockOption = Clock.wall
    threads: Threads = None


@benchmark(triangles="300k", stored="100k", size="192x108", frames=4, compared=1, limit=0.5)
def chc_rt(run: BenchRun, options: ChcrtOptions) -> BenchResult:
    """CHC+RT compared with tracing from the root: times, phases, queries, paging [Mattausch et al. 2015].

    Measures a near and a far walkthrough; CHC+RT keeps its state from frame to frame. Each pixel has a primary ray, 20
    ambient occlusion rays, 20 diffuse rays, and 16 shadow rays to an area light.

    Times are medians over the frames after the first. The tables cover sizes (Table 1), times (Table 2), phases
    (Figure 8), queries and bytes read (Table 3), randomised directions (Table 5), aggressive mode (Table 4), and an
    ablation. A store has tables of two eviction policies, of paths of several bounces, and, if the benchmark has built
    it, of the same tree in a memory-mapped file instead of randomised directions.

    The medians of each walkthrough are printed to standard error as soon as it ends.

    --pictures draws two frames of the near walkthrough: queries and triangles per tile (Figure 4), subtrees (Figure
    5), the matrix of rays and triangles (Figure 6), the error of aggressive mode (Figure 9), and rotated directions
    (Figure 10).

    \b
    Examples
      antumbra bench chc-rt --triangles 1M --frames 20
      antumbra bench chc-rt --scene sanmiguel_lite --table times --table phases --plot chcrt.png
      antumbra bench chc-rt --scene atrium --table queries --frames 2 --pictures .
      antumbra bench chc-rt --store city.antumbra --max-memory 1G
    """
    size = arguments.parse_size(options.size)
    ablation_size = arguments.parse_size(options.ablation_size or options.size, "--ablation-size")
    store, pictures = options.store, options.pictures
    names = _checked_tables(options)
    memory = None if options.max_memory is None else arguments.parse_bytes(options.max_memory, "--max-memory")
    triangles, stored = arguments.parse_count(options.triangles, "--triangles"), _stored(options)

    from ...generate.palette import check_request
    from ...kernels.parallel import thread_count
    from ...store.chunk_residency import POLICIES
    from .chc_rt import chcrt_measurements, chcrt_tables, walkthroughs
    from .chc_rt.store_walkthroughs import StoreCase
    from .chc_rt.walkthrough_timing import Pace

    for n in {triangles, stored} - {0}:
        check_request("city", n, 0)
    if options.plot is not None and not WALKED.intersection(names):
        raise InputError("--plot needs --table times, phases, queries or store")
    if pictures is not None:
        if store is not None:
            raise InputError("--pictures draws scenes in memory; omit --store")
        arguments.check_plot(pictures / "figure-4.png", "--pictures")
    elif store is None:
        pictures = run.pictures()
    pace, threads = Pace(options.frames, options.compared, options.limit), thread_count(options.threads)
    clock = checked_clock(options.clock, threads)
    common = {"size": size, "frames": pace.frames, "compared": pace.compared, "limit": pace.limit}
    common |= {"threads": threads, "clock": clock}
    settings: dict[str, Any] = {table: common for table in chcrt_measurements.tables_of(ChcrtTable)}
    settings[ChcrtTable.ablation] = {**common, "size": ablation_size}
    parts = run.parts(settings, chcrt_measurements.ROWS, chcrt_measurements.tables_of(names))
    show = (lambda turns: None) if run.silent else chcrt_measurements.show_medians
    policies = POLICIES if ChcrtTable.store in names else POLICIES[:1]
    plan = chcrt_measurements.ChcrtRun(parts, policies, threads, ablation_size, pace, run.say, show, pictures)
    scenes, in_memory = walkthroughs.scenes(triangles), {*IN_CORE}.intersection(names)
    views = scenes.open([str(store)] if store else options.scene, size, run.say) if store or in_memory else []
    with clocked(clock):
        if store is not None:
            share = None if options.in_core is None else options.in_core / 100
            case = StoreCase(walkthroughs.place_of(views[0]), threads, memory, share)
            store_size = case.store.meta.n_triangles, memory, share
            chcrt_measurements.add_out_of_core(case.place.name, *store_size, lambda: case, plan)
        else:
            for view in views:
                walkthroughs.check_in_memory(view)
            if stored and {*PAGED}.intersection(names):  # first, while the process takes little memory
                chcrt_measurements.add_temporary_store(stored, size, plan)
            chcrt_measurements.add_in_memory(map(walkthroughs.place_of, views), plan)
    rows, same = chcrt_measurements.rows_of(parts)
    shown = names if run.pictures() is None else tuple(ChcrtTable)
    answer = {**common, "ablation_size": ablation_size, "stored": stored}
    answer |= {name.value: records(table) for name, table in rows.items()}
    peak = max((part.peak_resident or 0 for part in parts.conditions()), default=0)
    answer |= {"differs": chcrt_measurements.differing(rows), "same_answers": same, "peak_resident": peak or None}
    verdict = {
        True: "the same by all methods",
        False: f"DIFFER for {answer['differs']:,} rays: please report this",
        None: "not compared",
    }

    def print_tables() -> None:
        chcrt_tables.print_tables(shown, rows)
        memory_text = readable_size(peak) if peak else "unknown"
        console.print_fields([("answers", verdict[same]), ("peak memory", memory_text)])

    def write_plot(path: Path) -> None:
        from .chc_rt.chcrt_plots import write_plot

        turns = [*rows.get(ChcrtTable.times, []), *rows.get(ChcrtTable.store, [])]
        write_plot(turns, {size.scene: size.total for size in rows.get(ChcrtTable.scenes, [])}, path)

    walked = ChcrtTable.times in rows or ChcrtTable.store in rows
    return BenchResult(answer, print_tables, write_plot if walked else None)


_STORED = "40M"


def _stored(options: ChcrtOptions) -> int:
    """The number of triangles in the temporary store; 0: none."""
    if options.stored is None:
        return 0 if options.scene or options.store else arguments.parse_count(_STORED, "--stored")
    if options.store is not None:
        raise InputError("--store and --stored cannot be combined")
    return 0 if options.stored == "0" else arguments.parse_count(options.stored, "--stored")


def _checked_tables(options: ChcrtOptions) -> tuple[ChcrtTable, ...]:
    """The requested tables, in order; InputError on conflicting options."""
    store, tables = options.store, options.table
    if store is None and options.max_memory is not None:
        raise InputError("--max-memory needs --store")
    if options.in_core is not None and (store is None or options.max_memory is not None):
        raise InputError("--in-core needs --store, and no --max-memory")
    if store is not None and options.scene:
        raise InputError("--store and --scene cannot be combined")
    in_memory = IN_CORE if store is None else ()
    paged = PAGED if store is not None or _stored(options) else ()
    possible = tuple(name for name in ChcrtTable if name in in_memory or name in paged)
    wrong = [name.value for name in tables or () if name not in possible]
    if wrong:
        cure = "needs a --store or --stored" if store is None else "needs scenes in memory; omit --store"
        raise InputError(f"--table {wrong[0]} {cure}")
    return tuple(name for name in possible if not tables or name in tables)
