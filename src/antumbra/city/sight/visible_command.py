"""``antumbra visible``: the share of a facade, a polygon or a wind turbine that each sensor sees."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ...base.checks import spelling_hint
from ...base.errors import InputError
from ...cli import arguments
from ...cli.options import (
    SENSORS_HELP,
    ColumnOption,
    CrsOption,
    Json,
    OutputsOption,
    PlanOption,
    Quiet,
    SceneArgument,
    Threads,
    TimeOption,
    UpOption,
    takes,
)
from ...cli.scene_arguments import DEFAULT_SCENE, SceneArguments, in_memory
from ...cli.study_run import StudyRun
from ...cli.vegetation_options import VegetationOption, parse_vegetation, sensors_below_plants

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ...engine.scene import AnyScene
    from ..sensors.sensors import Sensors
    from ..tables.result_table import Table
    from .targets import Turbine

_SPACING = 1.0  # metres between points on objects and polygons
_WAYS = "--turbine X,Y,Z, --object NAME, --polygon FILE or --points FILE"


@dataclass(frozen=True, kw_only=True)
class VisibleArguments(SceneArguments):
    """The command-line arguments and options, one per field."""

    scene: SceneArgument = DEFAULT_SCENE
    sensors: Annotated[
        str | None,
        typer.Option(help=SENSORS_HELP + "  [default: face; on a raster of heights: raster]", show_default=False),
    ] = None
    turbine: Annotated[
        str | None, typer.Option(help="The foot of a wind turbine.", metavar="X,Y,Z", show_default=False)
    ] = None
    hub_height: Annotated[float | None, typer.Option(help="Of the turbine, above its foot.", show_default=False)] = None
    rotor: Annotated[float | None, typer.Option(help="Diameter of the turbine's rotor.", show_default=False)] = None
    samples: Annotated[int, typer.Option(help="Sample points of the rotor.")] = 64
    object: Annotated[
        list[str] | None,
        typer.Option(help="An object of the scene, such as a building; may be repeated.", show_default=False),
    ] = None
    surfaces: Annotated[
        str | None,
        typer.Option(
            help="Types of its surfaces, such as WallSurface,RoofSurface.", metavar="TYPES", show_default=False
        ),
    ] = None
    polygon: Annotated[
        Path | None,
        typer.Option(
            help="The corners of a flat polygon, counterclockwise from the front: .csv, .parquet, .npy or .npz.",
            show_default=False,
        ),
    ] = None
    points: Annotated[
        Path | None, typer.Option(help="The points of the target, perhaps with normals.", show_default=False)
    ] = None
    spacing: Annotated[
        float | None,
        typer.Option(help="World units between points on objects and polygons.  [default: 1 m]", show_default=False),
    ] = None
    trees: VegetationOption = None
    output: OutputsOption = None
    column: ColumnOption = None
    plan: PlanOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    json: Json = False
    quiet: Quiet = False


@takes(VisibleArguments)
def visible(args: VisibleArguments) -> int:
    """Find the share of a target in SCENE that each sensor sees.

    The target is a wind turbine, whose rotor turns towards each sensor, an object of the scene, a polygon or points.
    The result has the columns share, from 0 to 1, and visible, the number of visible sample points.

    \b
    Examples
      antumbra visible dem.tif --sensors raster+1.6 --turbine 85000,446000,12 --hub-height 120 --rotor 150 -o share.tif
      antumbra visible city.city.json --sensors raster:2+1.6 --object Pand.1 --surfaces WallSurface -o share.tif
      antumbra visible city.glb --up z --sensors people.csv --polygon facade.csv --spacing 0.5 -o share.csv
    """
    spec = args.spec_of(args.scene)

    from ..sensors.sensor_files import check_file_crs, check_sensors, kind_of
    from ..tables.result_table import writer_of
    from .targets import visible_share

    trees = parse_vegetation(args.trees)
    sensor_form = args.sensors or ("raster" if spec.on_raster else "face")
    check_sensors(sensor_form)
    outputs = args.output or []
    for path in outputs:
        writer_of(path, kind_of(sensor_form))
    if args.surfaces is not None and args.object is None:
        raise InputError(f"--surfaces {args.surfaces}: needs --object NAME")
    if sum(each is not None for each in (args.turbine, args.object, args.polygon, args.points)) != 1:
        raise InputError(f"give one target: {_WAYS}")
    foot = None if args.turbine is None else arguments.parse_point(args.turbine, "--turbine")
    if foot is not None and (args.hub_height is None or args.rotor is None):
        raise InputError("--turbine needs --hub-height and --rotor")
    with StudyRun(args) as run:
        bare, opened = run.open(spec, trees)
        check_file_crs(opened, args.polygon, args.points)
        target = _target(args, bare, foot)
        sensors = sensors_below_plants(sensor_form, bare, opened, args.threads)
        options: dict[str, Any] = {"samples": args.samples, "plan": args.plan, "time": args.time}
        table = run.timed(visible_share, opened, sensors, target, threads=args.threads, **options)
        run.save(lambda path: table.save(path, args.column), outputs)
    return _report(run, opened.name, table)


def _target(args: VisibleArguments, scene: "AnyScene", foot: "NDArray[np.float64] | None") -> "Turbine | Sensors":
    """The target that the options name; `foot`: that of the turbine."""
    from ..sensors.point_attributes import warn_of_lost
    from ..sensors.sensor_files import read_points
    from .targets import Turbine, polygon_points, surface_points

    spacing = scene.unit.of_metres(_SPACING) if args.spacing is None else args.spacing
    if foot is not None:
        return Turbine(foot, args.hub_height or 0.0, args.rotor or 0.0)
    if args.object is not None:
        known = {name for thing in scene.objects for name in (thing.name, thing.parent) if name}
        for name in args.object:
            if name not in known:
                hint = spelling_hint(name, known)
                raise InputError(f"--object {name}: {scene.name} has no such object; {hint}see antumbra info")
        types = None if args.surfaces is None else args.surfaces.split(",")
        return surface_points(in_memory(scene), spacing, objects=args.object, types=types)
    path = args.polygon or args.points or Path()
    points = read_points(path)
    warn_of_lost(path.name, points.attributes)
    return points if args.polygon is None else polygon_points(points.points, spacing)


def _report(run: StudyRun, name: str, table: "Table") -> int:
    counted = table.sensors.covered
    share = table["share"][counted]
    answer: dict[str, Any] = {"sensors": int(counted.sum()), "samples": table.about["samples"], "seconds": run.seconds}
    answer |= {"seen": int((share > 0).sum()), "seen_entirely": int((share == 1).sum())}
    fields = [("sensors", f"{answer['sensors']:,}"), ("points of the target", f"{answer['samples']:,}")]
    fields.append(("see it", f"{answer['seen']:,}, {answer['seen_entirely']:,} entirely"))
    return run.report({"scene": name, **answer, "outputs": run.written}, [*fields, *run.rows()])
