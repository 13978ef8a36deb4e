"""``antumbra sun``: hours of direct sunlight on sensors, as tables, pictures, models and CityJSON attributes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.arguments import parse_bounds, parse_bytes
from ...cli.options import (
    LISTED_LAST,
    SENSORS_HELP,
    ColumnOption,
    CrsOption,
    LatitudeOption,
    ListedBefore,
    LongitudeOption,
    MapOption,
    MaxMemoryOption,
    NorthOption,
    OutputsOption,
    SceneArgument,
    SheetOption,
    TimezoneOption,
    UpOption,
    position_of,
    writes,
)
from ...cli.scene_arguments import BeforeOption, SceneSpec, limit_memory
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from ..city_formats import CITYJSON
from ..sensor_study import SensorStudy
from .sun_options import SunOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ...work.executors import Executor
    from ..tables.result_table import Table
    from ..tables.table_blocks import TableBlocks


@dataclass(frozen=True, kw_only=True)
class SunCommand(SensorStudy[SunOptions, "Table | TableBlocks"]):
    """Compute sun hours on surfaces.

    The location comes from the file's CRS (CityJSON), --crs, --latitude and --longitude, or an EPW file. Each sun
    position represents --step minutes, and results are exact for these positions. Repeat an interrupted command to
    continue it.

    \b
    Outputs
      .png            false-colour picture with a legend
      .glb            the model in these colours
      .html           a page that any browser opens offline, with these colours and exact shadows
      .csv .parquet .json .npz    table with a row per sensor
      .tif            GeoTIFF, for raster sensors
      .gpkg           GeoPackage, a layer of points
      --map .pdf      map sheet for a report, also .svg and .png

    \b
    Examples
      antumbra sun city.city.json --days 2026-03-21 -o sun.png -o sun.csv
      antumbra sun city.city.json --days 2026-03-21 --sensors raster:1 --map sheet.pdf -o sun.tif
      antumbra sun city.city.json --days year:2026 --by month --sky-view 512 --city-output sun.city.json
      antumbra sun house.glb --latitude 52 --longitude 4.36 --timezone Europe/Amsterdam --days 2026-06-21 --step 5
      antumbra sun city.ply --crs EPSG:28992 --up z --sensors raster:1 --days year:2026 -o sun.tif
      antumbra sun dem.tif --days 2026-12-21 --step 15 -o sun.tif
      antumbra sun country.tif --bounds 84000,445000,86000,447000 --days 2026-12-21 --max-memory 4G -o valley.tif
      antumbra sun buildings.gpkg --height h --terrain dem.tif --sensors grid:2 --days 2026-03-21 -o sun.png
      antumbra sun city.city.json --sensors windows.csv --rule br209-apsh --epw delft.epw -o windows.csv
      antumbra sun city.city.json --sensors windows.csv --rule br209-vsc --per dwelling -o homes.csv
      antumbra sun city.city.json --trees "trees.gpkg?height=h&radius=r&transmittance=0.2" --days 2026-06-21 -o sun.png
      antumbra sun city.city.json --rule br209-amenity --areas gardens.geojson -o gardens.tif
      antumbra sun city.city.json --days year:2026 --energy --surfaces RoofSurface --per building -o roofs.csv
    """

    scene: SceneArgument
    sensors: Annotated[
        str | None,
        typer.Option(
            help=SENSORS_HELP + "  [default: face; on a raster of heights: raster; with --areas a raster of 0.5 m]",
            show_default=False,
        ),
    ] = None
    bounds: Annotated[
        str | None,
        typer.Option(
            help="Only raster cells within this rectangle. Their centres lie between these eastings and northings.",
            metavar="X0,N0,X1,N1",
            show_default=False,
        ),
    ] = None
    areas: Annotated[
        Path | None,
        typer.Option(
            help="GeoJSON polygons, such as gardens, for br209-amenity.",
            metavar="FILE",
            show_default=False,
        ),
        ListedBefore("epw"),
    ] = None
    trees: VegetationOption = None
    before: BeforeOption = False
    crs: Annotated[CrsOption, ListedBefore("energy")] = None
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[OutputsOption, ListedBefore("plan")] = None
    map: MapOption = None
    sheet: SheetOption = None
    column: ColumnOption = None
    city_output: Annotated[
        Path | None,
        typer.Option(
            help="Copy the CityJSON file with the results added. They are attributes; FILE is .json or .jsonl.",
            metavar="FILE",
            callback=writes(*CITYJSON.suffixes),
        ),
    ] = None
    matrix: Annotated[
        Path | None,
        typer.Option(help="Write bits (.npy): which sensor sees which sun.", metavar="FILE", callback=writes(".npy")),
    ] = None
    max_memory: Annotated[MaxMemoryOption, LISTED_LAST] = None
    up: UpOption = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None

    of_one_state: ClassVar[tuple[str, ...]] = ("matrix",)
    files: ClassVar[str | None] = "files"
    records_trees: ClassVar[bool] = True

    @property
    def sensor_form(self) -> str:
        return self.sensors or ("raster" if self.areas is not None else super().sensor_form)

    @property
    def spec(self) -> SceneSpec:
        bounds = None if self.bounds is None else tuple(parse_bounds(self.bounds))
        return super().spec._replace(own_cells=self._in_own_cells, bounds=bounds)

    @property
    def _in_own_cells(self) -> bool:
        """Whether only shadows at the own cells of a raster are needed."""
        from ..sensors.sensor_files import raster_height
        from ..tables.table_blocks import WRITTEN_BY_BLOCK

        others = self.terrain, self.add, self.remove, self.trees, self.areas, self.city_output, self.map
        if any(others) or self.options.curvature or self.options.plan is not None or self.options.per != "sensor":
            return False
        form = self.sensors or "raster"
        by_block = all(path.suffix.lower() in WRITTEN_BY_BLOCK for path in self.output or ())
        return super().spec.is_streamed and by_block and raster_height(form) is not None

    def check(self) -> None:
        from ..sensors.ground_areas import check_areas
        from ..sensors.sensor_files import check_sensors

        position_of(self)
        if self.areas is not None:
            check_areas(self.areas)
        check_sensors(self.sensor_form, areas=self.areas is not None)
        self.options.check_rules(self.areas is not None)
        self._memory()
        if self.city_output is not None:
            self._check_city(self.city_output)

    def check_output(self, path: Path) -> None:
        from ..tables.result_table import writer_of

        writer_of(path, self._kind if self.options.per == "sensor" else "points")

    def default_output(self) -> str:
        return f"{self.spec.stem}-sun{'.tif' if self.spec.on_raster and self._kind == 'raster' else '.png'}"

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Table | TableBlocks | None]":
        from ...engine.measured_scenes import measured_scene
        from ...sun.location import place_of
        from ..changes.before_and_after import before_and_after
        from ..sensors.sensor_blocks import cells_within
        from .sun_hours import sun_blocks, sun_hours

        scene = measured_scene(scenes.planted)
        limit_memory(scene, self._memory())
        options = replace(self.options, place=place_of(scene, **position_of(self)))
        named = scenes.sensor_blocks(self._form_in(scene), self.threads, self.areas)
        study = lambda some: sun_hours(scene, some, **field_values(options))
        sensors = named if self.bounds is None else cells_within(named, parse_bounds(self.bounds))
        sensors = self.check_room(sensors, study, executor)
        if self.column is not None:  # an unknown column is reported before the long work
            none = study(sensors.block(0, 0))
            (before_and_after(none, none) if self.in_both_states else none).shown(self.column)
        return partial(sun_blocks, scene, options, sensors, None, self.matrix, executor, self.partitioned)

    def describe(self, result: "Table | TableBlocks", scenes: Scenes) -> None:
        from ...engine.engine import default_plan_of

        plan = str(self.options.plan or default_plan_of(scenes.planted.data))
        result.about |= {"scene": self.record_of(self.scene), "sensors": self._form_in(scenes.planted), "plan": plan}
        super().describe(result, scenes)

    def writers(self, result: "Table | TableBlocks", scenes: Scenes) -> Writers:
        return {
            **super().writers(result, scenes),
            "city_output": partial(self._write_city, result, scenes.n_faces),
            "matrix": lambda path: None,  # the study has written it
        }

    def summary(self, result: "Table | TableBlocks", scenes: Scenes, seconds: float) -> Summary:
        from .sun_summary import sun_summary

        return sun_summary(result, self.options.per, seconds)

    @property
    def _kind(self) -> str:
        """The kind of the sensors."""
        from ..sensors.sensor_files import kind_of

        return kind_of(self.sensor_form)

    def _form_in(self, scene: "AnyScene") -> str:
        """The text of the sensors; the default in areas depends on the unit of the scene."""
        from ..sensors.ground_areas import default_cells

        return default_cells(scene) if self.areas is not None and self.sensors is None else self.sensor_form

    def _memory(self) -> int | None:
        return None if self.max_memory is None else parse_bytes(self.max_memory, "--max-memory")

    def _check_city(self, path: Path) -> None:
        """Raise an InputError unless a copy of the CityJSON file can be written to `path`."""
        from ...base.files import checked_output

        suffix = "" if self.spec.path is None else self.spec.path.suffix.lower()
        if suffix not in CITYJSON.suffixes:
            raise InputError(f"--city-output is for CityJSON files, unlike {self.spec.stem}; leave it out")
        checked_output(path, (suffix,))

    def _write_city(self, result: "Table | TableBlocks", faces: int, path: Path) -> None:
        """Write the numeric columns as attributes to a copy of the CityJSON file, which has the first `faces` faces."""
        from ..cityjson.attribute_writer import write_attributes
        from .sun_summary import numeric_results

        table = result.whole()
        values = {name: table.of_faces(name)[:faces] for name in numeric_results(table)}
        assert self.spec.path is not None  # checked before the work: only CityJSON files have attributes
        write_attributes(self.spec.path, path, values, lod=self.spec.lod)


sun = command_of(SunCommand, SunOptions)
