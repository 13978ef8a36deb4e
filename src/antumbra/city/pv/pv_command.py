"""``antumbra pv``: how much of photovoltaic modules is shaded, by time."""

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
    NorthOption,
    SceneArgument,
    TimezoneOption,
    UpOption,
    position_of,
    tables,
)
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from .pv_options import PvOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ...sun.location import Place
    from ...work.executors import Executor
    from ..sensors.vector_points import PointFile
    from .module_shading import ModuleShading

_SUFFIXES = ".csv", ".parquet"


@dataclass(frozen=True, kw_only=True)
class PvCommand(StudyCommand[PvOptions, "ModuleShading"]):
    """Compute the shading of solar modules.

    The table of modules has their positions, id or name, and optionally tilt, azimuth (degrees), width, height, and
    string. A row with an axis_azimuth is a tracker (axis_tilt, max_angle, and gcr for backtracking). The result has a
    row for each module and time: shaded_fraction, from 0 to 1, which is 1 while the sun is down or behind the plane;
    sky_view_factor of the plane; and the sun's position. Use it in pandas and pvlib as it is.

    \b
    Examples
      antumbra pv roofs.city.json --modules modules.csv --days year:2026 -o shading.parquet
      antumbra pv dem.tif --modules sites.gpkg --on-surface --days 2026-06-21 --step 15 -o shading.csv
      antumbra pv plant.glb --up z --crs EPSG:28992 --modules rows.csv --per string --days 2026-12-21 -o strings.csv
    """

    scene: SceneArgument
    modules: Annotated[
        Path,
        typer.Option(help="A file of modules: .csv, .parquet, .npz, .gpkg or .geojson.", metavar="FILE"),
    ]
    on_surface: Annotated[
        bool,
        typer.Option("--on-surface", help="Measure heights from the highest surface. Without this, z is a coordinate."),
    ] = False
    days: Annotated[
        str,
        typer.Option(help="2026-06-21, 2026-03-21:2026-09-21, year:2026, or a comma-separated list.", metavar="DAYS"),
    ]
    step: Annotated[
        float, typer.Option(help="Interval between times. Each time is the middle of its interval.", metavar="MINUTES")
    ] = 60.0
    trees: VegetationOption = None
    crs: CrsOption = None
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[
        list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES), ListedBefore("plan")
    ] = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None

    files: ClassVar[str | None] = "files"
    records_trees: ClassVar[bool] = True

    def check(self) -> None:
        from ...sun.sun_positions import checked_step, days_of
        from ..sensors.point_attributes import IDS, warn_of_lost
        from .modules import COLUMNS

        position_of(self)
        days_of(self.days)
        checked_step(self.step)
        file = self._file
        warn_of_lost(file.name, file.sensors.attributes, {*COLUMNS, *IDS})

    def check_output(self, path: Path) -> None:
        from .module_shading import check_shading_output

        check_shading_output(path)

    def default_output(self) -> str:
        return f"{self.spec.stem}-shading.csv"

    @cached_property
    def _file(self) -> "PointFile":
        from ..sensors.sensor_files import points_or_file

        file = points_or_file(None, self.modules, "", "--modules", self.on_surface)
        assert file is not None
        return file

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], ModuleShading | None]":
        from ...engine.measured_scenes import measured_scene
        from ...sun.location import UNKNOWN_PLACE, place_of
        from ...sun.sun_positions import days_of, solar_angles, times_of, zone_of
        from .module_shading import module_shading
        from .modules import modules_of_table

        scene = measured_scene(scenes.planted)
        place = place_of(scene, **position_of(self))
        if place is None:
            raise InputError(f"{UNKNOWN_PLACE}, or a CRS")
        times = times_of(days_of(self.days), zone_of(place), self.step)
        points = self._file.within(scene)
        if self.on_surface:
            points = replace(points, points=self._placed(scenes.bare, points.points))
        modules = modules_of_table(self._file.name, points, *solar_angles(place, times.middle))
        options = field_values(self.options) | {"place": place}
        return partial(module_shading, scene, modules, _index(times.middle, place), keep=executor, **options)

    def _placed(self, scene: "AnyScene", at: Any) -> Any:
        """The points at their heights above the highest surface."""
        from ..sensors.point_checks import on_surface

        up = "xyz".index(scene.up)
        placed = on_surface(scene, at, "modules")
        placed[:, up] += at[:, up]
        return placed

    def writers(self, result: "ModuleShading", scenes: Scenes) -> Writers:
        return {"output": result.save}

    def summary(self, result: "ModuleShading", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(scenes.planted.name, seconds)


def _index(instants: Any, place: "Place") -> Any:
    """A pandas.DatetimeIndex in the zone of a place, from instants in UTC."""
    from ...base.extras import import_extra
    from ...sun.sun_positions import zone_of

    pandas = import_extra("pandas", "pv", "sun")
    return pandas.DatetimeIndex(instants).tz_localize("UTC").tz_convert(zone_of(place))


pv = command_of(PvCommand, PvOptions)
