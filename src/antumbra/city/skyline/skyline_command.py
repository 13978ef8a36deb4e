"""``antumbra skyline``: the elevation of the horizon that points see, by azimuth, as tables and for PVGIS."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.arguments import parse_point
from ...cli.options import LISTED_LAST, CrsOption, ListedBefore, MapOption, SceneArgument, SheetOption, UpOption, tables
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from .skyline_options import SkylineOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from ..sensors.sensors import Sensors
    from .skyline import Skyline

_SUFFIXES = ".csv", ".json", ".npz", ".txt"


@dataclass(frozen=True, kw_only=True)
class SkylineCommand(StudyCommand[SkylineOptions, "list[Skyline]"]):
    """Compute the horizon elevation at every azimuth.

    Azimuths are in degrees clockwise from true north. The column elevation is the horizon along an azimuth; highest is
    the highest within half a step on both sides, so nothing between two azimuths is missed. -90 means that nothing is
    there, 90 that a roof covers the point. A .txt file is a PVGIS horizon file for one point. --map draws its polar
    diagram, with the sun's paths if the scene has a CRS.

    \b
    Examples
      antumbra skyline city.glb --point 0,1.7,8 -o skyline.csv
      antumbra skyline city.city.json --point 85000,446500,1.6 --on-surface --azimuth-step 7.5 -o horizon.txt
      antumbra skyline city.city.json --point 85000,446500,12.5 --map horizon.pdf
      antumbra skyline city.city.json --points stations.csv --azimuth-step 1 -o skylines.npz
      antumbra skyline city.city.json --points roofs.csv --trees "trees.gpkg?height=h&radius=r" -o skylines.csv
      antumbra skyline city.glb --up z --north 0.81 --points raster:10 --eye-height 1.6 -o skylines.json
    """

    scene: SceneArgument = DEFAULT_SCENE
    point: Annotated[
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
    before: BeforeOption = False
    output: Annotated[
        list[Path] | None,
        tables("Output file, .txt for PVGIS", "--output", "-o", suffixes=_SUFFIXES),
        ListedBefore("time"),
    ] = None
    map: MapOption = None
    sheet: SheetOption = None
    highest: Annotated[
        bool,
        typer.Option(
            help="Write the conservative horizon to .txt files. It is the highest one near each azimuth, not the "
            "one along it."
        ),
    ] = False
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    records_trees: ClassVar[bool] = True

    def check(self) -> None:
        from ..sensors.sensor_files import check_sensors

        if self.tree_spec is not None:
            self.tree_spec.check_solid("a skyline is the edge of solid things, and crowns count as solid")
        if self.points is not None:
            check_sensors(self.points, "--points")
        if (self.point is None) == (self.points is None):
            raise InputError("give either --point X,Y,Z or --points FILE")

    def check_sheet(self, sheet: Any, scenes: Scenes) -> None:
        from ..sheets.sheet import check_diagram

        check_diagram(sheet)

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], list[Skyline] | None]":
        from .skyline import check_skyline_output, skyline

        points = self._points(scenes)
        for path in [*self.paths("output"), *self.paths("map")]:
            check_skyline_output(path, len(points))
        study = partial(skyline, scenes.planted, points, surface=scenes.bare, **field_values(self.options))

        def skylines() -> "list[Skyline] | None":
            found: Skyline | None = study(keep=executor)  # None: a shard
            return None if found is None else [found]

        return skylines

    def compared(self, before: "list[Skyline]", after: "list[Skyline]", scenes: Scenes) -> "list[Skyline]":
        return [*before, *after]

    def _points(self, scenes: Scenes) -> "Sensors":
        from ..sensors.sensors import point_sensors

        if self.points is not None:
            return scenes.sensors(self.points, self.threads)
        return point_sensors([parse_point(text, "--point") for text in self.point or []])

    def writers(self, result: "list[Skyline]", scenes: Scenes) -> Writers:
        return {"output": partial(self._write, result), "map": result[-1].save_map}

    def _write(self, result: "list[Skyline]", path: Path) -> None:
        """Write the skylines; of both states, all files but those of PVGIS have a row per point and azimuth."""
        from ..changes.before_and_after import before_and_after

        if len(result) == 1 or path.suffix.lower() == ".txt":
            result[-1].save(path, highest=self.highest)
        else:
            before_and_after(*(each.table() for each in result)).save(path)

    def about_of(self, result: "list[Skyline]") -> "dict[str, Any]":
        return result[-1].about

    def summary(self, result: "list[Skyline]", scenes: Scenes, seconds: float) -> Summary:
        return result[-1].summary(scenes.planted.name, seconds)


skyline = command_of(SkylineCommand, SkylineOptions)
