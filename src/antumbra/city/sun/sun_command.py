"""``antumbra sun``: hours of direct sunlight on sensors, as tables, pictures, models and CityJSON attributes."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli import console
from ...cli.arguments import parse_bytes
from ...cli.options import (
    SENSORS_HELP,
    Before,
    ColumnOption,
    CrsOption,
    DegreesOption,
    Json,
    MapOption,
    MaxMemoryOption,
    NorthOption,
    OutputsOption,
    Quiet,
    SceneArgument,
    TimezoneOption,
    UpOption,
    arguments_of,
    literal,
    position_of,
    takes,
    writes,
)
from ...cli.scene_arguments import SceneSpec, limit_memory
from ...cli.shards import MergeOption, RayOption, ShardOption, executor_for, report_shard
from ...cli.study_run import StudyRun
from ...cli.vegetation_options import VegetationOption, parse_vegetation, sensors_below_plants
from ...formats.format_registry import CITYJSON
from .sun_options import SunOptions

if TYPE_CHECKING:
    from ..tables.result_table import Table

# --- Arguments --------------------------------------------------------------------------------------------------------


_Options: Any = arguments_of("sun", SunOptions)


@dataclass(frozen=True, kw_only=True)
class SunArguments(_Options):  # type: ignore[misc] # made from the options of a study
    """The command-line arguments and options, besides those derived from `SunOptions`."""

    scene: SceneArgument
    sensors: Annotated[
        str | None,
        typer.Option(
            help=SENSORS_HELP + "  [default: face; on a raster of heights: raster; with --areas a raster of 0.5 m]",
            show_default=False,
        ),
    ] = None
    areas: Annotated[
        Path | None,
        typer.Option(
            help="GeoJSON polygons of gardens or other ground areas, for br209-amenity.",
            metavar="FILE",
            show_default=False,
        ),
        Before("epw"),
    ] = None
    trees: VegetationOption = None
    crs: Annotated[CrsOption, Before("energy")] = None
    latitude: DegreesOption = None
    longitude: DegreesOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[OutputsOption, Before("plan")] = None
    map: MapOption = None
    column: ColumnOption = None
    city_output: Annotated[
        Path | None,
        typer.Option(
            help="Copy the CityJSON file, .json or .jsonl, with the results as attributes.",
            metavar="FILE",
            callback=writes(*CITYJSON.suffixes),
        ),
    ] = None
    matrix: Annotated[
        Path | None,
        typer.Option(
            help="A .npy file of bits: which sensor sees which sun position.", metavar="FILE", callback=writes(".npy")
        ),
    ] = None
    max_memory: Annotated[MaxMemoryOption, Before("")] = None
    up: UpOption = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False


# --- The command ------------------------------------------------------------------------------------------------------


_MOST_AREAS = 50  # most areas that are printed


@takes(SunArguments)
def sun(args: SunArguments) -> int:
    """Find the hours of direct sun on the surfaces of SCENE.

    The location comes from the file's CRS (CityJSON), --crs, --latitude and --longitude, or an EPW file. Each sun
    position represents --step minutes, and results are exact for these positions. Repeat an interrupted command to
    continue it.

    \b
    Outputs
      .png            false-colour picture with a legend
      .glb            the model in these colours
      .csv .parquet .json .npz    table with a row per sensor
      .tif            GeoTIFF, for raster sensors
      .gpkg           GeoPackage, a layer of points
      --map .pdf      map sheet for a report, also .svg and .png

    \b
    Examples
      antumbra sun city.city.json --days 2026-03-21 -o sun.png -o sun.csv
      antumbra sun city.city.json --days 2026-03-21 --sensors raster:1 --map sheet.pdf -o sun.tif
      antumbra sun city.city.json --days year:2026 --by month --sky 512 --city-output sun.city.json
      antumbra sun house.glb --latitude 52 --longitude 4.36 --timezone Europe/Amsterdam --days 2026-06-21 --step 5
      antumbra sun city.ply --crs EPSG:28992 --up z --sensors raster:1 --days year:2026 -o sun.tif
      antumbra sun dem.tif --days 2026-12-21 --step 15 -o sun.tif
      antumbra sun buildings.gpkg --height h --terrain dem.tif --sensors grid:2 --days 2026-03-21 -o sun.png
      antumbra sun city.city.json --sensors windows.csv --rule br209-windows --epw delft.epw -o windows.csv
      antumbra sun city.city.json --trees "trees.gpkg?height=h&radius=r&transmittance=0.2" --days 2026-06-21 -o sun.png
      antumbra sun city.city.json --rule br209-amenity --areas gardens.geojson -o gardens.tif
      antumbra sun city.city.json --days year:2026 --energy --surfaces RoofSurface --per building -o roofs.csv
    """
    from ...engine.engine import default_plan_of
    from ...engine.measured_scenes import measured_scene
    from ...sun.location import place_of
    from ..sensors.ground_areas import check_areas, default_cells
    from ..sensors.sensor_files import check_sensors
    from .sun_hours import sun_hours

    spec, trees = args.spec_of(args.scene), parse_vegetation(args.trees)
    position = position_of(args)
    in_areas = args.areas is not None
    default = "raster" if spec.on_raster else "face"
    sensor_form = args.sensors or ("raster" if in_areas else default)
    if args.areas is not None:
        check_areas(args.areas)
    check_sensors(sensor_form, areas=in_areas)
    options = SunOptions(**literal(args, SunOptions))
    options.check_rule(in_areas)
    memory = None if args.max_memory is None else parse_bytes(args.max_memory, "--max-memory")
    outputs = _checked_outputs(args, spec, sensor_form)
    first = [*outputs, *(args.map or ())][0]
    executor = executor_for(args, first)
    if args.city_output is not None:
        _check_city(spec, args.city_output)
    with StudyRun(args) as run:
        bare, planted = run.open(spec, trees)
        scene = measured_scene(planted)
        limit_memory(scene, memory)
        if in_areas and args.sensors is None:
            sensor_form = default_cells(scene)
        place = place_of(scene, **position)
        sensors = sensors_below_plants(sensor_form, bare, scene, args.threads, args.areas)
        study = partial(sun_hours, scene, **field_values(replace(options, place=place)))
        if args.column is not None:
            study(sensors=sensors.part(0, 0)).shown(args.column)  # reports an unknown column before the long work
        keep = executor or first.with_suffix(".parts")
        table = run.timed(study, sensors=sensors, matrix=args.matrix, keep=keep)
        if table is None:
            return report_shard(executor, args, run.seconds)
        plan = args.plan or default_plan_of(scene.data)
        table.about |= {"scene": args.record_of(args.scene), "sensors": sensor_form, "plan": str(plan)}
        if args.trees is not None:
            table.about["trees"] = args.trees
        run.save(lambda path: table.save(path, args.column), outputs)
        run.save(lambda path: table.save_map(path, args.column), args.map)
        if args.city_output is not None:
            run.save(lambda path: _write_city(table, spec, path, bare.n_triangles), [args.city_output])
    if args.matrix is not None:
        run.written.append(str(args.matrix))
    _print_summary(args, run, table)
    return 0


def _checked_outputs(args: SunArguments, spec: SceneSpec, sensors: str) -> list[Path]:
    """The output files, whose formats are checked before a scene is read."""
    from ..sensors.sensor_files import kind_of
    from ..tables.map_page import check_map
    from ..tables.result_table import writer_of

    suffix = ".tif" if spec.on_raster and kind_of(sensors) == "raster" else ".png"
    paths = args.output or ([] if args.map else [Path(f"{spec.stem}-sun{suffix}")])
    for path in args.map or ():
        check_map(path)
    for path in paths:
        writer_of(path, kind_of(sensors) if args.per == "sensor" else "points")
    return paths


def _check_city(spec: SceneSpec, path: Path) -> None:
    """Raise an InputError unless a copy of the CityJSON file can be written to `path`."""
    from ...base.files import checked_output

    suffix = "" if spec.path is None else spec.path.suffix.lower()
    if suffix not in CITYJSON.suffixes:
        raise InputError(f"--city-output is for CityJSON files, unlike {spec.stem}; leave it out")
    checked_output(path, (suffix,))


def _write_city(table: "Table", spec: SceneSpec, path: Path, faces: int) -> None:
    """Write the numeric columns as attributes to a copy of the CityJSON file, which has the first `faces` faces."""
    from ..cityjson.attribute_writer import write_attributes

    values = {name: table.of_faces(name)[:faces] for name in _results(table)}
    assert spec.path is not None  # checked before the work: only CityJSON files have attributes
    write_attributes(spec.path, path, values, lod=spec.lod)


def _results(table: "Table") -> list[str]:
    """The names of the numeric columns, besides those that describe the surfaces."""
    from ..tables.surface_columns import NAMES

    return [name for name, column in table.columns.items() if column.values.dtype.kind in "fiub" and name not in NAMES]


def _print_summary(args: SunArguments, run: StudyRun, table: "Table") -> None:
    sensors = len(table) if args.per == "sensor" else int(table["sensors"].sum())
    rays = sensors * table.about["suns"] * table.about["samples"]
    covered = table.sensors.covered
    hours = table["sun_hours"][covered]
    numbers = {"sensors": sensors, "rows": len(table), "suns": table.about["suns"], "rays": rays}
    numbers["seconds"] = run.seconds
    if args.json:
        means = {name: float(table[name][covered].mean()) for name in _results(table)} if covered.any() else {}
        console.print_json({**table.about, **numbers, "means": means, "files": run.written})
    elif not args.quiet:
        about = table.about
        least, middle, most = np.percentile(hours, (0, 50, 100)) if len(hours) else (0.0, 0.0, 0.0)
        rows = [
            ("place", f"{about['latitude']:.4f}, {about['longitude']:.4f}; true north at {about['north']:.2f} degrees"),
            ("suns", f"{about['suns']:,} from {about['first']} to {about['last']}, {about['hours']:,.1f} h"),
            ("sensors", f"{sensors:,} ({about['sensors']})"),
            *([(f"{args.per}s", f"{len(table):,}")] if args.per != "sensor" else []),
            ("hours of sun", f"{least:,.1f} to {most:,.1f}, median {middle:,.1f}"),
        ]
        if "passes" in table.columns and "areas" not in about and args.per == "sensor":
            rows.append((about["rule"], f"{table['passes'][covered].mean():.1%} of the sensors on surfaces pass"))
        console.print_fields(rows + run.rows(rays))
        if "areas" in about:
            console.print_table(*_areas(about["areas"]), right=(1, 2, 3, 4))


def _areas(records: list[dict[str, Any]]) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The columns and rows of a table of areas."""
    judged = "share" in records[0]
    names = "area", "cells", "inside buildings", "mean hours", *(("at least 2 h", "passes") if judged else ())
    return names, [_area(each)[: len(names)] for each in records[:_MOST_AREAS]]


def _area(record: dict[str, Any]) -> tuple[str, ...]:
    """The row of an area."""
    hours, share = record["sun_hours"], record.get("share")
    row = record["name"], f"{record['cells']:,}", f"{record['left_out']:,}", "" if hours is None else f"{hours:.1f}"
    passes = {None: "no cells", True: "yes", False: "no"}[record.get("passes")]
    return *row, "" if share is None else f"{share:.1%}", passes
