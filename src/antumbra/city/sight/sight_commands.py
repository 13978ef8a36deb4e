"""Visibility between points: ``antumbra los`` (lines of sight), ``viewshed`` (observers per sensor) and ``matrix``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli import arguments, console
from ...cli.options import (
    SENSORS_HELP,
    Before,
    CameraOption,
    ColumnOption,
    CrsOption,
    Json,
    MapOption,
    OutputsOption,
    PlanOption,
    Quiet,
    SceneArgument,
    SensorsOption,
    Threads,
    TimeOption,
    UpOption,
    arguments_of,
    literal,
    points_or_file,
    tables,
    takes,
    writes,
)
from ...cli.scene_arguments import DEFAULT_SCENE, SceneArguments
from ...cli.shards import MergeOption, RayOption, ShardOption, executor_for, report_shard
from ...cli.study_run import StudyRun
from ...cli.vegetation_options import VegetationOption, parse_vegetation, sensors_below_plants
from .viewshed_options import ViewshedOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ..tables.result_table import Table
    from .sightlines import PairList, Sightlines
    from .visibility_matrix import VisibilityMatrix


# --- ``antumbra los`` -------------------------------------------------------------------------------------------------


_MOST_LINES = 20  # most pairs that are printed
_MODEL = ".glb"
_SUFFIXES = ".csv", ".parquet", ".json", ".npz", _MODEL
_COLUMNS = "observer", "target", "visible", "blocked_by", "face", "distance"  # printed columns


@dataclass(frozen=True)
class SightArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    observer: Annotated[
        list[str] | None,
        typer.Option("--from", help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None
    target: Annotated[
        list[str] | None,
        typer.Option("--to", help="A target; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None
    observers: Annotated[
        Path | None, typer.Option(help="A file of observers: .csv, .parquet, .npy or .npz.", show_default=False)
    ] = None
    targets: Annotated[Path | None, typer.Option(help="A file of targets.", show_default=False)] = None
    pairs: Annotated[
        str,
        typer.Option(
            help="all: each observer with each target; zip: pairwise; a file of indices with the columns from and to; "
            "or, without observers and targets, a file of points with the columns x1,y1,z1,x2,y2,z2.",
            metavar="all|zip|FILE",
        ),
    ] = "all"
    trees: VegetationOption = None
    output: Annotated[list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES)] = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(SightArguments)
def los(args: SightArguments) -> int:
    """Find which points see each other in SCENE, and what blocks the others.

    The result lists, per pair, the nearest blocking face, its object, the blocked point, and the distances. An endpoint
    on a surface needs a normal (columns nx,ny,nz, or nx1 to nz2) or its face (face1, face2); otherwise float32 may
    round it behind the surface. Tables have a row per pair; a .glb shows the lines, green up to the first blocker.

    \b
    Examples
      antumbra los --from 0,1.7,8 --to 0,3,-8
      antumbra los city.glb --up z --from 10,20,1.7 --targets windows.csv -o seen.csv
      antumbra los city.glb --up z --observers people.csv --targets signs.csv -o lines.glb -o lines.parquet
      antumbra los hall.glb --pairs pairs.csv -o result.csv --json
    """
    spec = args.spec_of(args.scene)

    from ...base.files import atomic_output
    from ..sensors.sensor_files import check_file_crs
    from ..tables.result_table import writer_of
    from .sightlines import (
        check_pairs,
        line_of_sight,
        pairs_of,
        read_pairs,
        sight_model,
        sight_table,
    )

    trees = parse_vegetation(args.trees)
    check_pairs(args.pairs)
    outputs = args.output or []
    writers = {path: writer_of(path, "points") for path in outputs}
    begin = points_or_file(args.observer, args.observers, "--from", "--observers")
    end = points_or_file(args.target, args.targets, "--to", "--targets")
    if (begin is None) != (end is None):
        raise InputError("observers need targets: give --from or --observers, and --to or --targets")
    if begin is None and args.pairs in ("all", "zip"):
        raise InputError("there are no points: give --from and --to, --observers and --targets, or a file of --pairs")
    pair_list = read_pairs(Path(args.pairs)) if begin is None or end is None else pairs_of(args.pairs, begin, end)
    with StudyRun(args) as run:
        _, opened = run.open(spec, trees, to_memory=True)
        check_file_crs(opened, args.observers, args.targets, Path(args.pairs))
        keywords: dict[str, Any] = {**pair_list.keywords(), "time": args.time, "threads": args.threads}
        sightlines = run.timed(line_of_sight, opened, **keywords)

        def write(path: Path) -> None:
            if path.suffix.lower() == _MODEL:
                with atomic_output(path) as temporary:
                    temporary.write_bytes(sight_model(opened, pair_list, sightlines))
            else:
                writers[path](sight_table(opened, pair_list, sightlines), path, "visible")

        run.save(write, outputs)
    n, visible = len(pair_list.observers), int(sightlines.visible.sum())
    answer = {"scene": opened.name, "pairs": n, "visible": visible, "seconds": run.seconds, "outputs": run.written}
    if n <= _MOST_LINES:
        answer["lines"] = lines = _lines(opened, pair_list, sightlines)
        if not (args.json or args.quiet):
            rows = [[str(line[name]) for name in _COLUMNS] for line in lines]
            console.print_table([name.replace("_", " ") for name in _COLUMNS], rows)
    return run.report(answer, [("visible", f"{visible:,} of {n:,} pairs"), *run.rows()])


def _lines(scene: "AnyScene", pairs: "PairList", sightlines: "Sightlines") -> list[dict[str, Any]]:
    """A dictionary per pair."""
    lines = []
    for k, visible in enumerate(sightlines.visible.tolist()):
        face, blocker = int(sightlines.face[k]), int(sightlines.object[k])
        lines.append(
            {
                "observer": ",".join(f"{x:g}" for x in pairs.observers[k]),
                "target": ",".join(f"{x:g}" for x in pairs.targets[k]),
                "visible": "yes" if visible else "no",
                "blocked_by": scene.objects[blocker].name if blocker >= 0 else "",
                "face": face if face >= 0 else "",
                "distance": "" if visible else round(float(sightlines.distance[k]), 4),
                **_of_city(scene, face, blocker),
            }
        )
    return lines


def _of_city(scene: "AnyScene", face: int, blocker: int) -> dict[str, str]:
    """The city model's attributes of the blocking face."""
    if scene.city is None or blocker < 0:
        return {}
    thing = scene.objects[blocker]
    return {"type": thing.type, "parent": thing.parent, "surface": str(scene.city.surface_types(face))}


# --- ``antumbra viewshed`` --------------------------------------------------------------------------------------------


_SIZE = 1024, 768  # of pictures


_Options: Any = arguments_of("viewshed", ViewshedOptions)


@dataclass(frozen=True, kw_only=True)
class ViewshedArguments(_Options):  # type: ignore[misc] # made from the options of a viewshed
    """The command-line arguments and options, besides those derived from `ViewshedOptions`."""

    scene: SceneArgument = DEFAULT_SCENE
    sensors: Annotated[
        str | None,
        typer.Option(help=SENSORS_HELP + "  [default: face; on a raster of heights: raster]", show_default=False),
    ] = None
    observer: Annotated[
        list[str] | None, typer.Option(help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False)
    ] = None
    observers: Annotated[
        Path | None, typer.Option(help="A file of observers: .csv, .parquet, .npy or .npz.", show_default=False)
    ] = None
    along: Annotated[
        Path | None,
        typer.Option(
            help="A file of lines from which observers look, such as a road: .gpkg, .geojson, .shp, or the vertices of "
            "one line in a .csv file.",
            show_default=False,
        ),
    ] = None
    spacing: Annotated[
        float | None, typer.Option(help="World units between observers along lines.", show_default=False)
    ] = None
    trees: VegetationOption = None
    output: Annotated[OutputsOption, Before("plan")] = None
    map: MapOption = None
    column: ColumnOption = None
    camera: CameraOption = None
    bits: Annotated[
        Path | None,
        typer.Option(
            help="A .npy file of bits: which observer sees which sensor, 64 observers per word.",
            show_default=False,
            callback=writes(".npy"),
        ),
    ] = None
    up: Annotated[UpOption, Before("threads")] = None
    crs: CrsOption = None
    json: Annotated[Json, Before("")] = False
    quiet: Quiet = False


@takes(ViewshedArguments)
def viewshed(args: ViewshedArguments) -> int:
    """Count the observers that see each sensor of SCENE.

    The result has the columns seen (number of observers), first and nearest (observer indices, -1: none) and distance;
    with --along, also length, that of the lines that see a sensor; with --least-height, also least_height. Rasters are
    written as a map or GeoTIFF, other sensors as a view of the scene. raster:2+1.6 places targets 1.6 above the highest
    surfaces. Distances are straight-line distances from the eye.

    \b
    Examples
      antumbra viewshed --observer 0,1.7,8 -o seen.png
      antumbra viewshed city.glb --up z --sensors raster:1 --observer 10,20,0 --on-surface --eye-height 1.6 -o map.tif
      antumbra viewshed city.glb --up z --sensors raster:1 --observer 10,20,30 --map sheet.pdf
      antumbra viewshed city.glb --up z --sensors grid:2 --observers people.csv --max-distance 300 -o seen.png
      antumbra viewshed dem.tif --observer 85000,446000,0 --on-surface --eye-height 1.7 -o seen.tif
      antumbra viewshed dem.tif --along road.gpkg --spacing 25 --on-surface --eye-height 1.2 -o road.tif
      antumbra viewshed dem.tif --observer 85000,446000,90 --least-height -o hidden.tif
      antumbra viewshed hills.ply --up z --observer 0,0,900 --curvature --azimuth 350:10 -o seen.parquet
    """
    spec = args.spec_of(args.scene)
    options = ViewshedOptions(
        **literal(args, ViewshedOptions),
        azimuth=arguments.parse_interval(args.azimuth, "--azimuth"),
        elevation=arguments.parse_interval(args.elevation, "--elevation"),
        bits=args.bits is not None,
    )
    camera_spec = None if args.camera is None else arguments.parse_camera(args.camera)

    from ...base.files import atomic_output, checked_file
    from ..sensors.point_attributes import warn_of_lost
    from ..sensors.sensor_files import check_file_crs, check_sensors, kind_of
    from ..tables.bit_matrices import write_rows
    from ..tables.map_page import check_map
    from ..tables.result_table import writer_of
    from .line_points import points_along
    from .viewshed import viewshed as compute_viewshed

    trees = parse_vegetation(args.trees)
    sensor_form = args.sensors or ("raster" if spec.on_raster else "face")
    check_sensors(sensor_form)
    outputs = args.output or []
    for path in outputs:
        writer_of(path, kind_of(sensor_form))
    for path in args.map or ():
        check_map(path)
    eyes = points_or_file(args.observer, args.observers, "--observer", "--observers")
    if eyes is not None and args.observers is not None:
        warn_of_lost(args.observers.name, eyes.attributes)
    if eyes is None and args.along is None:
        raise InputError("there is no observer: give --observer X,Y,Z, --observers FILE or --along FILE")
    if args.along is not None:
        checked_file(args.along, f"--along {args.along}")
    if eyes is not None and args.along is not None:
        raise InputError("--along excludes --observer and --observers; give one of them")
    if (args.along is None) != (args.spacing is None):
        raise InputError("--along FILE and --spacing DISTANCE need each other")
    with StudyRun(args) as run:
        bare, opened = run.open(spec, trees)
        check_file_crs(bare, args.observers)
        observers: Any = None if eyes is None else eyes.points
        if args.along is not None:
            observers = points_along(args.along, args.spacing or 0.0, crs=opened.crs)
        sensors = sensors_below_plants(sensor_form, bare, opened, args.threads)
        camera = None if camera_spec is None else arguments.make_camera(camera_spec, opened, args.time, _SIZE)
        result = run.timed(compute_viewshed, opened, sensors, observers, surface=bare, **field_values(options))
        table, seen = result.table, result.bits
        table.camera = camera
        run.save(lambda path: table.save(path, args.column), outputs)
        run.save(lambda path: table.save_map(path, args.column), args.map)
        if args.bits is not None and seen is not None:
            with atomic_output(args.bits) as temporary:
                write_rows(temporary, seen)
            run.written.append(str(args.bits))
    answer = _answer(table, len(result.observers), run.seconds)
    return run.report({"scene": opened.name, **answer, "outputs": run.written}, [*_fields(answer), *run.rows()])


def _answer(table: "Table", observers: int, seconds: float) -> dict[str, Any]:
    """The fields of ``--json``."""
    counted = table.sensors.covered
    visible, sensors = table["seen"][counted] > 0, int(counted.sum())
    answer = {"sensors": sensors, "observers": observers, "seen": int(visible.sum()), "seconds": seconds}
    if table.sensors.areas is not None:
        assert table.scene is not None
        areas = table.sensors.areas[counted] * table.scene.unit.square_metres
        answer |= {"area": float(areas.sum()), "area_seen": float(areas[visible].sum())}
    return answer


def _fields(answer: dict[str, Any]) -> list[tuple[str, str]]:
    n, visible = answer["sensors"], answer["seen"]
    fields = [("sensors", f"{n:,}"), ("observers", f"{answer['observers']:,}")]
    fields.append(("seen by any", f"{visible:,} ({100.0 * visible / max(n, 1):.1f} %)"))
    if "area" in answer:
        fields.append(("area seen", f"{answer['area_seen']:,.6g} of {answer['area']:,.6g} m2"))
    return fields


# --- ``antumbra matrix`` ----------------------------------------------------------------------------------------------


_BITS, _SPARSE = ".npy", ".npz"


@dataclass(frozen=True)
class MatrixArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    sensors: SensorsOption = "face"
    targets: Annotated[
        str | None,
        typer.Option(help="Targets, same forms as --sensors.  [default: the sensors]", show_default=False),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .npy file of bits, 64 targets per word; an interrupted run continues in it.",
            show_default=False,
            callback=writes(_BITS),
        ),
    ] = None
    sparse: Annotated[
        Path | None,
        typer.Option(
            help="A .npz file of the visible pairs, for scipy.sparse.load_npz.",
            show_default=False,
            callback=writes(_SPARSE),
        ),
    ] = None
    counts: Annotated[list[Path] | None, tables("File of the number of targets visible from each sensor")] = None
    trees: VegetationOption = None
    plan: PlanOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False


@takes(MatrixArguments)
def matrix(args: MatrixArguments) -> int:
    """Find which sensors of SCENE see which targets, as one bit per pair.

    Sensors on surfaces are visible only from their outer side. Bit j % 64 of word j // 64 in row i is set if sensor i
    and target j see each other. Without --targets, each pair is traced once, and no sensor sees itself.

    \b
    Examples
      antumbra matrix --sparse faces.npz
      antumbra matrix hall.glb --sensors grid:0.5 -o seen.npy --counts seen.png
      antumbra matrix city.glb --up z --sensors people.csv --targets face -o seen.npy --sparse seen.npz
      antumbra matrix city.glb --up z --sensors raster:5+1.6 --trees "trees.gpkg?height=h&radius=r" -o seen.npy
    """
    spec = args.spec_of(args.scene)

    from ..sensors.point_attributes import warn_of_lost
    from ..sensors.sensor_files import check_sensors
    from ..tables.result_table import Column, Table
    from .visibility_matrix import visibility_matrix

    trees = parse_vegetation(args.trees)
    check_sensors(args.sensors)
    if args.targets is not None:
        check_sensors(args.targets, "--targets")
    bits, pairs, counts = _checked_outputs(args)
    outputs = [path for path in (bits, pairs, *counts) if path is not None]
    executor = executor_for(args, outputs[0])
    with StudyRun(args) as run:
        bare, opened = run.open(spec, trees)
        sensors, others = sensors_below_plants(args.sensors, bare, opened, args.threads), None
        if args.targets is not None:
            others = sensors_below_plants(args.targets, bare, opened, args.threads)
            warn_of_lost(args.targets, others.attributes)
        options: dict[str, Any] = {"plan": args.plan, "time": args.time, "threads": args.threads}
        result = run.timed(visibility_matrix, opened, sensors, others, output=bits, keep=executor, **options)
        if result is None:
            return report_shard(executor, args, run.seconds)
        if bits is not None:
            run.written.append(str(bits))
        run.save(result.save, [] if pairs is None else [pairs])
        column = Column(result.counts, "", f"visible targets, of {result.columns}")
        run.save(Table(sensors, {"seen": column}, {"job": "matrix"}, opened).save, counts)
    return _report(run, opened.name, result)


def _checked_outputs(args: MatrixArguments) -> tuple[Path | None, Path | None, list[Path]]:
    """The output files of bits, pairs and counts, checked before a scene is read."""
    from ..sensors.sensor_files import kind_of
    from ..tables.result_table import writer_of

    counts = args.counts or []
    for path in counts:
        writer_of(path, kind_of(args.sensors))
    if args.output is None and args.sparse is None and not counts:
        raise InputError("there is nothing to write: give --output, --sparse or --counts")
    return args.output, args.sparse, counts


def _report(run: StudyRun, name: str, result: "VisibilityMatrix") -> int:
    rows, columns = result.shape
    visible = int(result.counts.sum())
    share = 100.0 * visible / max(rows * columns, 1)
    answer = {"scene": name, "rows": rows, "columns": columns, "visible": visible, "seconds": run.seconds}
    fields = [("matrix", f"{rows:,} x {columns:,}"), ("visible", f"{visible:,} pairs ({share:.2f} %)")]
    return run.report({**answer, "outputs": run.written}, [*fields, *run.rows()])
