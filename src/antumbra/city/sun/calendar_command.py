"""``antumbra calendar``: the first and the last sun of each day behind the real horizon."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.options import (
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
from .route_options import CalendarOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from ..sensors.vector_points import PointFile
    from .sun_calendar import SunCalendar


@dataclass(frozen=True, kw_only=True)
class CalendarCommand(StudyCommand[CalendarOptions, "SunCalendar"]):
    """Find the first and last sun of each day.

    The result has a row per point and day: sunrise and sunset over an open horizon, first_sun and last_sun as the
    scene lets the point see them, in local time to the second, and the sun hours. --map draws the days of one point.

    \b
    Examples
      antumbra calendar dem.tif --point 85000,446000,0 --on-surface --curvature --days year:2026 -o sun.csv
      antumbra calendar city.city.json --points windows.csv --days year:2026 -o windows.csv
      antumbra calendar dem.tif --point 85000,446000,0 --on-surface --days year:2026 --map sun.pdf -o sun.csv
    """

    scene: SceneArgument
    point: Annotated[
        list[str] | None, typer.Option(help="A point; may be repeated.", metavar="X,Y,Z", show_default=False)
    ] = None
    points: Annotated[
        Path | None,
        typer.Option(
            help="A file of points, with normals on surfaces: .csv, .parquet, .npy, .npz, .gpkg or .geojson. The "
            "column id or name names them.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None
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
        list[Path] | None, tables("Output file", "--output", "-o", suffixes=(".csv",)), ListedBefore("plan")
    ] = None
    map: MapOption = None
    sheet: SheetOption = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None

    files: ClassVar[str | None] = "files"
    records_trees: ClassVar[bool] = True

    def check(self) -> None:
        from ...sun.sun_positions import days_of
        from ..sensors.point_attributes import IDS, warn_of_lost
        from .sun_calendar import check_calendar_output

        position_of(self)
        days_of(self.days)
        file = self._file
        if file is None:
            raise InputError("there are no points; give --point X,Y,Z or --points FILE")
        warn_of_lost(file.name, file.sensors.attributes, IDS)
        for path in [*self.paths("output"), *self.paths("map")]:
            check_calendar_output(path, len(file.sensors))

    def check_sheet(self, sheet: Any, scenes: Scenes) -> None:
        from ..sheets.sheet import check_diagram

        check_diagram(sheet)

    def default_output(self) -> str:
        return f"{self.spec.stem}-calendar.csv"

    @cached_property
    def _file(self) -> "PointFile | None":
        from ..sensors.sensor_files import points_or_file

        return points_or_file(self.point, self.points, "--point", "--points", self.options.on_surface)

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], SunCalendar | None]":
        from ...engine.measured_scenes import measured_scene
        from ...sun.location import place_of
        from .sun_calendar import sun_calendar

        scene = measured_scene(scenes.planted)
        options = replace(self.options, place=place_of(scene, **position_of(self)))
        assert self._file is not None  # checked before
        points = self._file.within(scenes.bare)
        study = partial(sun_calendar, scene, points, self.days, surface=scenes.bare, keep=executor)
        return partial(study, **field_values(options))

    def writers(self, result: "SunCalendar", scenes: Scenes) -> Writers:
        return {"output": result.save, "map": result.save_map}

    def summary(self, result: "SunCalendar", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(scenes.planted.name, seconds)


calendar = command_of(CalendarCommand, CalendarOptions)
