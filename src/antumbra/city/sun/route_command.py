"""``antumbra route``: shade along a route by the hour."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ...base.option_fields import field_values
from ...cli.options import (
    ColumnOption,
    CrsOption,
    LatitudeOption,
    ListedBefore,
    LongitudeOption,
    MapOption,
    NorthOption,
    SceneArgument,
    SheetOption,
    TimezoneOption,
    UpOption,
    position_of,
    tables,
)
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from .route_options import RouteOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from .route_shade import RouteShade

_SUFFIXES = ".csv", ".parquet", ".parquets", ".gpkg", ".json", ".npz", ".png"


@dataclass(frozen=True, kw_only=True)
class RouteCommand(StudyCommand[RouteOptions, "RouteShade"]):
    """Compute the hourly shade along a route.

    The result has a row per station: its distance along the route, shade (the fraction of daytime in shade), and for
    each hour of the day a column such as shade_08 (the fraction from 8 to 9 o'clock). --hours FILE.csv writes a row per
    hour: the fraction of the route in shade.

    \b
    Examples
      antumbra route city.city.json --line walk.gpkg --spacing 10 --on-surface --days 2026-07-21 -o walk.csv
      antumbra route dem.tif --line road.geojson --spacing 25 --on-surface --days 2026-12-21 --hours road.csv
    """

    scene: SceneArgument
    line: Annotated[
        Path,
        typer.Option(
            help="A file of lines: .gpkg, .geojson, .shp, or the vertices of one line in a .csv file.", metavar="FILE"
        ),
    ]
    spacing: Annotated[float, typer.Option(help="Distance between stations, in world units.")]
    days: Annotated[
        str,
        typer.Option(help="2026-06-21, 2026-03-21:2026-09-21, year:2026, or a comma-separated list.", metavar="DAYS"),
    ]
    trees: VegetationOption = None
    crs: CrsOption = None
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[
        list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES), ListedBefore("plan")
    ] = None
    map: MapOption = None
    sheet: SheetOption = None
    column: ColumnOption = None
    hours: Annotated[list[Path] | None, tables("The share of the route in shade by hour", suffixes=(".csv",))] = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None

    files: ClassVar[str | None] = "files"

    def check(self) -> None:
        from ...base.checks import number
        from ...base.files import checked_file
        from ...sun.sun_positions import days_of

        position_of(self)
        days_of(self.days)
        number(self.spacing, "--spacing", 0.0, float("inf"))
        checked_file(self.line, f"--line {self.line}")

    def check_output(self, path: Path) -> None:
        from ..tables.result_table import writer_of

        writer_of(path, "points")

    def default_output(self) -> str:
        return f"{self.spec.stem}-route.csv"

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], RouteShade | None]":
        from ...engine.measured_scenes import measured_scene
        from ...sun.location import place_of
        from .route_shade import route_shade

        scene = measured_scene(scenes.planted)
        options = replace(self.options, place=place_of(scene, **position_of(self)))
        study = partial(route_shade, scene, self.line, self.spacing, self.days, surface=scenes.bare, keep=executor)
        return partial(study, **field_values(options))

    def writers(self, result: "RouteShade", scenes: Scenes) -> Writers:
        if self.trees is not None:
            result.table.about["trees"] = self.trees
        column = self.column or "shade"
        save, save_map = (partial(write, column=column) for write in (result.table.save, result.table.save_map))
        return {"output": save, "map": save_map, "hours": result.save_hours}

    def summary(self, result: "RouteShade", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(scenes.planted.name, seconds)


route = command_of(RouteCommand, RouteOptions)
