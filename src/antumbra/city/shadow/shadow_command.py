"""``antumbra shadow``: the shadow on the ground at a moment, or hours of shadow, as polygons for GIS programs."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import numpy as np
import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.options import (
    LISTED_LAST,
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
from .shadow_options import ShadowOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from .shadow_polygons import Shadow

_SUFFIXES = ".gpkg", ".geojson", ".parquet", ".tif", ".zarr", ".html"


@dataclass(frozen=True, kw_only=True)
class ShadowCommand(StudyCommand[ShadowOptions, "Shadow"]):
    """Draw the shadow on the ground, as GIS polygons.

    At a moment, the shadow falls on a horizontal plane and its outline is exact. With --cell, or with --days for the
    hours of shadow, polygons follow raster cells on the highest surfaces, whose centres are traced exactly. The
    location comes from the file's CRS (CityJSON), --crs, or --latitude and --longitude.

    \b
    Outputs
      .gpkg .geojson .parquet    polygons with their area; GeoJSON in WGS 84
      .tif .zarr                 GeoTIFF or Zarr of the cells
      .html                      a page with the shadow on the scene, which any browser opens offline
      --map .pdf                 map sheet for a report, also .svg and .png

    \b
    Examples
      antumbra shadow city.city.json --at 2026-06-21T15:00 --timezone Europe/Amsterdam -o shadow.gpkg
      antumbra shadow city.city.json --at 2026-06-21T15:00 --per object --casters "Building*" -o shadows.parquet
      antumbra shadow city.city.json --days 2026-03-21 --cell 0.5 --classes 0,2,4,6 -o hours.gpkg -o hours.tif
      antumbra shadow city.city.json --days 2026-06-21 --trees "trees.gpkg?height=h&radius=r&transmittance=0.2" -o h.tif
      antumbra shadow city.city.json --at 2026-12-21T12:00 --map sheet.pdf
      antumbra shadow house.glb --latitude 52 --longitude 4.36 --at 2026-12-21T12:00+01:00 -o shadow.geojson
    """

    scene: SceneArgument
    trees: Annotated[VegetationOption, ListedBefore("plan")] = None
    before: Annotated[
        bool,
        typer.Option(
            "--before",
            help="Compare with the state before changes: new and gone shadow, or added hours. See --add and --remove.",
        ),
    ] = False
    crs: CrsOption = None
    latitude: LatitudeOption = None
    longitude: LongitudeOption = None
    north: NorthOption = None
    timezone: TimezoneOption = None
    output: Annotated[list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES)] = None
    map: MapOption = None
    sheet: SheetOption = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    files: ClassVar[str | None] = "files"
    records_trees: ClassVar[bool] = True

    def check(self) -> None:
        position_of(self)
        if (self.options.at is None) == (self.options.days is None):
            raise InputError("give either --at TIME, such as --at 2026-06-21T15:00, or --days DAYS")
        if self.before and self.options.per == "object":
            raise InputError("--before compares the whole shadow; leave --per object out")
        if self.tree_spec is not None and self.options.on_plane:
            why = "the outline on a plane is that of solid crowns; with --cell SIZE, they let light pass"
            self.tree_spec.check_solid(why)

    def check_output(self, path: Path) -> None:
        from .shadow_polygons import check_shadow_output

        check_shadow_output(path, not self.options.on_plane)

    def default_output(self) -> str:
        return f"{self.spec.stem}-shadow.gpkg"

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Shadow | None]":
        from ...engine.measured_scenes import measured_scene
        from ...sun.location import place_of
        from .shadow import shadow

        scene = measured_scene(scenes.planted)
        options = replace(self.options, place=place_of(scene, **position_of(self)))
        if self.before and options.on_plane and options.plane is None:  # the same plane in both states
            options = replace(options, plane=float(scene.bounds[0, "xyz".index(scene.up)]))
        return partial(shadow, scene, surface=scenes.bare, keep=executor, **field_values(options))

    def compared(self, before: "Shadow", after: "Shadow", scenes: Scenes) -> "Shadow":
        from .added_shadow import added_shadow

        limits, exposed = np.array(self.options.classes, np.float64), None
        if after.table is not None and scenes.change is not None:
            exposed = scenes.change.exposed(after.table.sensors, self.threads)
        return added_shadow(before, after, limits, scenes.bare.unit.square_metres, exposed)

    def writers(self, result: "Shadow", scenes: Scenes) -> Writers:
        writers = dict(super().writers(result, scenes))
        if self.before:
            writers["map"] = partial(result.save_map, title="Added shadow")
        return writers

    def summary(self, result: "Shadow", scenes: Scenes, seconds: float) -> Summary:
        return result.summary(seconds)


shadow = command_of(ShadowCommand, ShadowOptions)
