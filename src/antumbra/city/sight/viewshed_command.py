"""``antumbra viewshed``: how many observers see each sensor, as tables, maps and pictures."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...base.wording import counted
from ...cli.arguments import make_camera, parse_camera, parse_interval
from ...cli.console import say
from ...cli.options import (
    LISTED_LAST,
    CameraOption,
    ColumnOption,
    CrsOption,
    ListedBefore,
    MapOption,
    OutputsOption,
    SceneArgument,
    SensorsOrDefault,
    SheetOption,
    UpOption,
    tables,
    writes,
)
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyRun, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from ..sensor_study import SensorStudy
from .viewshed_options import ViewshedOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from ..gis.height_files import HeightFile
    from ..sensors.sensors import Sensors
    from ..sensors.vector_points import PointFile
    from ..tables.result_table import Table
    from .line_points import LinePoints
    from .viewshed import Viewshed

_SIZE = 1024, 768  # of pictures


@dataclass(frozen=True, kw_only=True)
class ViewshedCommand(SensorStudy[ViewshedOptions, "Viewshed"]):
    """Count the observers that see each place.

    The result has the columns seen (number of observers), first and nearest (observer indices, -1: none) and distance;
    with --along, also length, the length of line that sees a sensor; with --least-height, also least_height. Rasters
    are written as a map or GeoTIFF, other sensors as a view of the scene. raster:2+1.6 places targets 1.6 above the
    highest surfaces. Distances are straight-line distances from the eye.

    \b
    Examples
      antumbra viewshed --observer 0,1.7,8 -o seen.png
      antumbra viewshed city.glb --up z --sensors raster:1 --observer 10,20,0 --on-surface --eye-height 1.6 -o map.tif
      antumbra viewshed city.glb --up z --sensors raster:1 --observer 10,20,30 --map sheet.pdf
      antumbra viewshed city.glb --up z --sensors grid:2 --observers people.csv --max-distance 300 -o seen.png
      antumbra viewshed dem.tif --observer 85000,446000,0 --on-surface --eye-height 1.7 -o seen.tif
      antumbra viewshed dem.tif --along road.gpkg --spacing 25 --on-surface --eye-height 1.2 -o road.tif
      antumbra viewshed dem.tif --observer 85000,446000,90 --least-height -o hidden.tif
      antumbra viewshed dem.tif --observers towers.gpkg --on-surface --each --polygons seen.gpkg -o seen.tif
      antumbra viewshed country.tif --observer 85000,446000,0 --on-surface --eye-height 2 --max-memory 3G -o seen.tif
      antumbra viewshed hills.ply --up z --observer 0,0,900 --curvature --azimuth 350:10 -o seen.parquet
    """

    scene: SceneArgument = DEFAULT_SCENE
    sensors: SensorsOrDefault = None
    observer: Annotated[
        list[str] | None, typer.Option(help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False)
    ] = None
    observers: Annotated[
        Path | None,
        typer.Option(
            help="A file of observers: .csv, .parquet, .npy, .npz, .gpkg or .geojson. The columns eye_height, "
            "min_distance and max_distance replace the options; id or name names them.",
            show_default=False,
        ),
    ] = None
    along: Annotated[
        Path | None,
        typer.Option(
            help="Observers along lines, such as a road: a .gpkg, .geojson or .shp file, or the vertices of "
            "one line in a .csv file.",
            show_default=False,
        ),
    ] = None
    spacing: Annotated[
        float | None, typer.Option(help="Distance between observers along lines, in world units.", show_default=False)
    ] = None
    trees: VegetationOption = None
    before: BeforeOption = False
    output: Annotated[OutputsOption, ListedBefore("plan")] = None
    map: MapOption = None
    sheet: SheetOption = None
    column: ColumnOption = None
    camera: CameraOption = None
    bits: Annotated[
        Path | None,
        typer.Option(
            help="Write bits (.npy): who sees which sensor. A word holds 64 observers.",
            show_default=False,
            callback=writes(".npy"),
        ),
    ] = None
    polygons: Annotated[
        list[Path] | None,
        tables(
            "The cells that each observer sees, a polygon of several parts each",
            suffixes=(".gpkg", ".geojson", ".parquet"),
        ),
    ] = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    def check(self) -> None:
        from ...base.files import checked_file
        from ..sensors.point_attributes import IDS, warn_of_lost
        from ..tables.polygon_files import check_polygon_output
        from .observers import PER_OBSERVER

        if self.camera is not None:
            parse_camera(self.camera)
        super().check()
        eyes = self._eyes
        if eyes is not None and self.observers is not None:
            names = IDS if self.options.each or self.polygons else ()
            warn_of_lost(self.observers.name, eyes.sensors.attributes, {*PER_OBSERVER, *names})
        if eyes is None and self.along is None:
            raise InputError("there is no observer: give --observer X,Y,Z, --observers FILE or --along FILE")
        if self.along is not None:
            checked_file(self.along, f"--along {self.along}")
        if eyes is not None and self.along is not None:
            raise InputError("--along excludes --observer and --observers; give one of them")
        for path in self.polygons or ():
            check_polygon_output(path)
        if self.polygons and self.sensor_form.partition(":")[0].partition("+")[0].partition("@")[0] != "raster":
            raise InputError(
                f"--polygons are made of cells, and the sensors are {self.sensor_form}; use raster:SPACING"
            )
        if (self.along is None) != (self.spacing is None):
            raise InputError("--along FILE and --spacing DISTANCE need each other")

    def run(self) -> int:
        """Run the command: in bands if the cells of a raster do not fit into memory."""
        from ...base.memory import memory_limit, readable_size
        from ..gis.gis_data import height_file
        from ..gis.height_files import check_cells
        from ..sensors.sensor_files import raster_height
        from .raster_viewshed import RasterNeed

        if not self.spec.is_streamed or raster_height(self.sensor_form) is None:
            return super().run()
        self.check()
        assert self.spec.path is not None
        keywords = {**dict(self.spec.gis), "crs": self.spec.crs, "unit": self.spec.unit}
        file = height_file(self.spec.path, keywords)
        check_cells(file.grid, file.path.name)
        observers = 1 if self._eyes is None else len(self._eyes.sensors)
        need = RasterNeed(file.grid.rows * file.grid.columns, observers)
        most, size = memory_limit(), need.whole(self._is_by_block, self.options.curvature)
        if most is None or size <= most:
            return super().run()
        whole = f"{file.path.name}: {counted(need.cells, 'cell', 'take')} about {readable_size(size)} at once"
        if kept := self._needs_all_cells():
            raise InputError(
                f"{whole}, more than {readable_size(most)}; leave out {kept}, so that the cells are studied in bands, "
                "cut the raster with gdal_translate -projwin, or raise --max-memory"
            )
        need.check(file.path.name, most)
        if not self.quiet:
            say(f"note: {whole}, more than {readable_size(most)}; studied in bands")
        return self._in_bands(file, most)

    @property
    def _is_by_block(self) -> bool:
        """Whether the table is made and written by block."""
        from ..tables.table_blocks import WRITTEN_BY_BLOCK

        options, others = self.options, (self.bits, self.polygons, self.map, self.add, self.remove, self.trees)
        if any(others) or options.least_height:
            return False
        return all(path.suffix.lower() in WRITTEN_BY_BLOCK for path in self.paths("output"))

    def _needs_all_cells(self) -> str | None:
        """The first argument that needs all cells in memory; None: the study can be done in bands."""
        given = {"add": self.add, "remove": self.remove, "trees": self.trees, "along": self.along, "map": self.map}
        given |= {
            "bits": self.bits,
            "polygons": self.polygons,
            "camera": self.camera,
            "shard": self.shard,
            "ray": self.ray,
        }
        given |= {name: getattr(self.options, name) for name in ("curvature", "each", "least_height", "plan")}
        name = next((name for name, value in given.items() if value), None)
        if name is not None:
            return "--" + name.replace("_", "-")
        paths = self.paths("output")
        single = len(paths) == 1 and paths[0].suffix.lower() in (".tif", ".zarr")
        return None if single else "all outputs but one .tif or .zarr file (-o FILE.tif)"

    def _in_bands(self, file: "HeightFile", limit: int | None) -> int:
        from ...base.progress import report_progress
        from ...engine.scene import Scene
        from ..gis.height_grounds import plane_of
        from ..sensors.sensor_files import raster_height
        from .raster_viewshed import save_raster_viewshed

        eyes, (path,) = self._eyes, self.paths("output")
        assert eyes is not None  # checked before
        with StudyRun(self) as run:
            observers, height = eyes.within(Scene.of_data(plane_of(file))), raster_height(self.sensor_form) or 0.0
            with report_progress(f"{counted(file.grid.rows, 'row')}") as progress:
                study = partial(save_raster_viewshed, file, path, observers, self.options, progress, height, limit)
                result = run.timed(study)
            run.written.append(str(path))
        summary = result.summary(file.name, run.seconds)
        return run.report(summary._replace(values=summary.values | {"up": "z"}), self.files)

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Viewshed | None]":
        from .viewshed import viewshed, viewshed_blocks

        observers = self._observers(scenes)
        options = replace(self.options, bits=self.bits is not None, each=self.options.each or bool(self.polygons))
        keywords = {"surface": scenes.bare, **field_values(options)}
        sensors = scenes.sensor_blocks(self.sensor_form, self.threads)
        sensors = self.check_room(
            sensors, lambda some: viewshed(scenes.planted, some, observers, **keywords).table, executor
        )
        camera = None
        if self.camera is not None:
            camera = make_camera(parse_camera(self.camera), scenes.planted, options.time, _SIZE)

        def study() -> "Viewshed | None":
            result = viewshed_blocks(
                scenes.planted, options, sensors, observers, scenes.bare, executor, self.partitioned
            )
            if result is not None:
                result.table.camera = camera
            return result

        return study

    @cached_property
    def _eyes(self) -> "PointFile | None":
        from ..sensors.sensor_files import points_or_file

        return points_or_file(self.observer, self.observers, "--observer", "--observers", self.options.on_surface)

    def _observers(self, scenes: Scenes) -> "Sensors | LinePoints":
        from .line_points import points_along

        if self.along is not None:
            return points_along(self.along, self.spacing or 0.0, crs=scenes.planted.crs, up=scenes.planted.up)
        eyes = self._eyes
        assert eyes is not None  # checked before
        return eyes.within(scenes.bare)

    def table_of(self, result: "Viewshed") -> "Table":
        return result.table

    def with_table(self, result: "Viewshed", table: "Table") -> "Viewshed":
        return result._replace(table=table)

    def writers(self, result: "Viewshed", scenes: Scenes) -> Writers:
        return {
            **super().writers(result, scenes),
            "bits": partial(_write_bits, result),
            "polygons": result.save_polygons,
        }

    def summary(self, result: "Viewshed", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(scenes.planted.name, seconds)


def _write_bits(result: "Viewshed", path: Path) -> None:
    from ...base.files import atomic_output
    from ..tables.bit_matrices import write_rows

    assert result.bits is not None  # they were asked for
    with atomic_output(path) as temporary:
        write_rows(temporary, result.bits)


_ANGLES = {name: partial(parse_interval, option=f"--{name}") for name in ("azimuth", "elevation")}
viewshed = command_of(ViewshedCommand, ViewshedOptions, _ANGLES)
