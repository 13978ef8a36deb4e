"""``antumbra shadow``: the shadow on the ground at a moment, or hours of shadow, as polygons for GIS programs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ...base.option_fields import field_values
from ...cli import console
from ...cli.options import (
    Before,
    CrsOption,
    DegreesOption,
    Json,
    MapOption,
    NorthOption,
    Quiet,
    SceneArgument,
    TimezoneOption,
    UpOption,
    arguments_of,
    literal,
    position_of,
    tables,
    takes,
)
from ...cli.study_run import StudyRun
from ...cli.vegetation_options import VegetationOption, parse_vegetation
from .shadow_options import ShadowOptions

if TYPE_CHECKING:
    from .shadow_polygons import Shadow

_SUFFIXES = ".gpkg", ".geojson", ".parquet", ".tif"
_MOST_ROWS = 20  # most rows that are printed

_Options: Any = arguments_of("shadow", ShadowOptions)


@dataclass(frozen=True, kw_only=True)
class ShadowArguments(_Options):  # type: ignore[misc] # made from the options of a shadow
    """The command-line arguments and options, besides those derived from `ShadowOptions`."""

    scene: SceneArgument
    trees: Annotated[VegetationOption, Before("plan")] = None
    crs: CrsOption = None
    latitude: DegreesOption = None
    longitude: DegreesOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES)] = None
    map: MapOption = None
    up: Annotated[UpOption, Before("threads")] = None
    json: Annotated[Json, Before("")] = False
    quiet: Quiet = False


@takes(ShadowArguments)
def shadow(args: ShadowArguments) -> int:
    """Find the shadow on the ground of SCENE, as polygons.

    At a moment, the shadow falls on a horizontal plane and its outline is exact. With --cell, or with --days for the
    hours of shadow, polygons follow raster cells on the highest surfaces, whose centres are traced exactly. The
    location comes from the file's CRS (CityJSON), --crs, or --latitude and --longitude.

    \b
    Outputs
      .gpkg .geojson .parquet    polygons with their area; GeoJSON in WGS 84
      .tif                       GeoTIFF of the cells
      --map .pdf                 map sheet for a report, also .svg and .png

    \b
    Examples
      antumbra shadow city.city.json --at 2026-06-21T15:00 --timezone Europe/Amsterdam -o shadow.gpkg
      antumbra shadow city.city.json --at 2026-06-21T15:00 --by object --casters "Building*" -o shadows.parquet
      antumbra shadow city.city.json --days 2026-03-21 --cell 0.5 --classes 0,2,4,6 -o hours.gpkg -o hours.tif
      antumbra shadow city.city.json --days 2026-06-21 --trees "trees.gpkg?height=h&radius=r&transmittance=0.2" -o h.tif
      antumbra shadow city.city.json --at 2026-12-21T12:00 --map sheet.pdf
      antumbra shadow house.glb --latitude 52 --longitude 4.36 --at 2026-12-21T12:00+01:00 -o shadow.geojson
    """
    spec = args.spec_of(args.scene)

    from ...engine.measured_scenes import measured_scene
    from ...sun.location import place_of
    from ..tables.map_page import check_map
    from .shadow import shadow as find_shadow
    from .shadow_polygons import check_shadow_output

    position = position_of(args)
    options = ShadowOptions(**literal(args, ShadowOptions))
    options.check_moment()
    trees = parse_vegetation(args.trees)
    if trees is not None and options.on_plane:
        trees.check_solid("the outline on a plane is that of solid crowns; with --cell SIZE, they let light pass")
    maps = args.map or []
    outputs = args.output or ([] if maps else [Path(f"{spec.stem}-shadow.gpkg")])
    for path in maps:
        check_map(path)
    for path in outputs:
        check_shadow_output(path, not options.on_plane)
    with StudyRun(args) as run:
        bare, planted = run.open(spec, trees, to_memory=options.on_plane)
        scene = measured_scene(planted)
        options = replace(options, place=place_of(scene, **position))
        result = run.timed(find_shadow, scene, surface=bare, **field_values(options))
        if args.trees is not None:
            result.about["trees"] = args.trees
        run.save(result.save, outputs)
        run.save(result.save_map, maps)
    _print_summary(args, run, result)
    return 0


def _print_summary(args: ShadowArguments, run: StudyRun, shadow: "Shadow") -> None:
    about, rows = shadow.about, {name: column.tolist() for name, column in shadow.columns.items()}
    if args.json:
        answer = {**about, "polygons": len(shadow.polygons), "area": shadow.area}
        answer |= {"seconds": run.seconds, "files": run.written}
        console.print_json(answer | ({"rows": rows} if len(shadow.polygons) <= _MOST_ROWS else {}))
    elif not args.quiet:
        fields = [
            ("place", f"{about['latitude']:.4f}, {about['longitude']:.4f}; north at {about['north']:.2f} degrees")
        ]
        if "sun_elevation" in about:
            sun = f"azimuth {about['sun_azimuth']:.1f}, elevation {about['sun_elevation']:.1f} degrees"
            fields.append(("sun", f"{about['time']}: {sun}"))
        else:
            fields.append(("days", f"{about['days']}, {about['hours']:.1f} h of daylight"))
        fields.append(("area", f"{shadow.area:,.1f} m2 in {len(shadow.polygons):,} polygons"))
        console.print_fields(fields + run.rows())
        if len(rows) > 1 and len(shadow.polygons) <= _MOST_ROWS:
            console.print_table(
                [name.replace("_", " ") for name in rows],
                [
                    [f"{cell:,.6g}" if isinstance(cell, float) else str(cell) for cell in row]
                    for row in zip(*rows.values())
                ],
            )
