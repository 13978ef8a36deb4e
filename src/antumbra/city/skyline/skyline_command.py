"""``antumbra skyline``: the elevation of the horizon that points see, by azimuth, as tables and for PVGIS."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli import arguments, console
from ...cli.options import (
    Before,
    CrsOption,
    Json,
    MapOption,
    Quiet,
    SceneArgument,
    UpOption,
    arguments_of,
    literal,
    tables,
    takes,
)
from ...cli.scene_arguments import DEFAULT_SCENE
from ...cli.study_run import StudyRun
from ...cli.vegetation_options import VegetationOption, parse_vegetation, sensors_below_plants
from .skyline_options import SkylineOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ..sensors.sensors import Sensors
    from .skyline import Skyline

_MOST_POINTS = 20  # most points that are printed
_SUFFIXES = ".csv", ".json", ".npz", ".txt"

_Options: Any = arguments_of("skyline", SkylineOptions)


@dataclass(frozen=True, kw_only=True)
class SkylineArguments(_Options):  # type: ignore[misc] # made from the options of a skyline
    """The command-line arguments and options, besides those derived from `SkylineOptions`."""

    scene: SceneArgument = DEFAULT_SCENE
    at: Annotated[
        list[str] | None, typer.Option(help="A point; may be repeated.", metavar="X,Y,Z", show_default=False)
    ] = None
    points: Annotated[
        str | None,
        typer.Option(
            help="A file of points (.csv, .parquet, .npy, .npz; with normals for points on surfaces), or "
            "raster:SPACING, grid:SPACING, face or vertex.",
            metavar="FILE|FORM",
            show_default=False,
        ),
    ] = None
    trees: VegetationOption = None
    output: Annotated[
        list[Path] | None, tables("Output file, .txt for PVGIS", "--output", "-o", suffixes=_SUFFIXES), Before("time")
    ] = None
    map: MapOption = None
    highest: Annotated[
        bool, typer.Option(help="In a .txt file, the highest elevation near each azimuth instead of that along it.")
    ] = False
    up: Annotated[UpOption, Before("threads")] = None
    crs: CrsOption = None
    json: Annotated[Json, Before("")] = False
    quiet: Quiet = False


@takes(SkylineArguments)
def skyline(args: SkylineArguments) -> int:
    """Find the skyline of points in SCENE: the elevation of the horizon by azimuth.

    Azimuths are degrees clockwise from true north. elevation is that along an azimuth, highest the greatest within half
    a step on both sides, so nothing between two azimuths is missed. -90: there is nothing; 90: the point lies below
    a roof. A .txt file is the horizon file of PVGIS for one point. --map draws its polar diagram, with the paths of the
    sun if the scene has a CRS.

    \b
    Examples
      antumbra skyline city.glb --at 0,1.7,8 -o skyline.csv
      antumbra skyline city.city.json --at 85000,446500,1.6 --on-surface --eye-height 1.6 --step 7.5 -o horizon.txt
      antumbra skyline city.city.json --at 85000,446500,12.5 --map horizon.pdf
      antumbra skyline city.city.json --points stations.csv --step 1 -o skylines.npz
      antumbra skyline city.city.json --points roofs.csv --trees "trees.gpkg?height=h&radius=r" -o skylines.csv
      antumbra skyline city.glb --up z --north 0.81 --points raster:10 --eye-height 1.6 -o skylines.json
    """
    spec = args.spec_of(args.scene)
    options, trees = SkylineOptions(**literal(args, SkylineOptions)), parse_vegetation(args.trees)
    if trees is not None:
        trees.check_solid("a skyline is the edge of solid things, and crowns count as solid")

    from ..sensors.sensor_files import check_sensors
    from ..tables.map_page import check_map
    from .skyline import check_skyline_output
    from .skyline import skyline as find_skylines

    if args.points is not None:
        check_sensors(args.points, "--points")
    if (args.at is None) == (args.points is None):
        raise InputError("there are no points, or two kinds of them; give --at X,Y,Z or --points FILE")
    outputs, maps = args.output or [], args.map or []
    for path in maps:
        check_map(path)
    with StudyRun(args) as run:
        bare, opened = run.open(spec, trees, to_memory=True)
        points = _points(args, bare, opened)
        for path in [*outputs, *maps]:
            check_skyline_output(path, len(points))
        result = run.timed(find_skylines, opened, points, surface=bare, **field_values(options))
        if args.trees is not None:
            result.about["trees"] = args.trees
        run.save(lambda path: result.save(path, highest=args.highest), outputs)
        run.save(result.save_map, maps)
    return _report(args, run, opened.name, result)


def _points(args: SkylineArguments, bare: "AnyScene", scene: "AnyScene") -> "Sensors":
    from ..sensors.point_attributes import warn_of_lost
    from ..sensors.sensors import point_sensors

    if args.points is not None:
        points = sensors_below_plants(args.points, bare, scene, args.threads)
        warn_of_lost(args.points, points.attributes)
        return points
    return point_sensors([arguments.parse_point(text, "--at") for text in args.at or []])


def _report(args: SkylineArguments, run: StudyRun, name: str, skyline: "Skyline") -> int:
    factors = skyline.sky_view_factor()
    rows = [
        {
            "point": ",".join(f"{c:.9g}" for c in point),
            "lowest": round(float(elevation.min()), 3),
            "highest": round(float(highest.max()), 3),
            "towards": float(skyline.azimuth[highest.argmax()]),
            "sky_view_factor": round(float(factor), 4),
        }
        for point, elevation, highest, factor in zip(
            skyline.points[:_MOST_POINTS], skyline.elevation, skyline.highest, factors
        )
    ]
    n, azimuths = len(skyline.points), len(skyline.azimuth)
    few = n <= _MOST_POINTS
    answer = {"scene": name, "points": n, "azimuths": azimuths, "seconds": run.seconds, "north": skyline.about["north"]}
    answer |= {"sky_view_factor": float(np.mean(factors)), "outputs": run.written}
    if few and not (args.json or args.quiet):
        names = [name.replace("_", " ") for name in rows[0]]
        console.print_table(names, [[str(value) for value in row.values()] for row in rows])
    fields = [("skylines", f"{n:,} points x {azimuths:,} azimuths"), *run.rows()]
    return run.report(answer | ({"skylines": rows} if few else {}), fields)
