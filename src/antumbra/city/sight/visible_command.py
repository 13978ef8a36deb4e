"""``antumbra visible``: the share of a facade, a polygon or a wind turbine that each sensor sees."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.checks import spelling_hint
from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.options import (
    LISTED_LAST,
    ColumnOption,
    CrsOption,
    ListedBefore,
    MapOption,
    OutputsOption,
    SceneArgument,
    SensorsOrDefault,
    SheetOption,
    UpOption,
)
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from ..sensor_study import SensorStudy
from .sight_options import VisibleOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ...work.executors import Executor
    from ..sensors.sensors import Sensors
    from ..sensors.vector_points import PointFile
    from ..tables.result_table import Table
    from ..tables.table_blocks import TableBlocks
    from .turbines import Turbine

_SPACING = 1.0  # metres between points on objects and polygons
_WAYS = "--turbine X,Y,Z, --turbines FILE, --object NAME, --polygon FILE or --points FILE"


@dataclass(frozen=True, kw_only=True)
class VisibleCommand(SensorStudy[VisibleOptions, "Table | TableBlocks"]):
    """Compute how much of a target each place sees.

    The target is one or several wind turbines, whose rotors turn towards each sensor, an object of the scene, a polygon
    or points. The result has the columns share, the visible fraction from 0 to 1, and visible, the number of visible
    sample points. For several turbines, it also has turbines, the number in sight, and the share of each.

    \b
    Examples
      antumbra visible dem.tif --sensors raster+1.6 --turbine 85000,446000,12 --hub-height 120 --rotor 150 -o share.tif
      antumbra visible dem.tif --sensors raster+1.6 --turbines farm.gpkg --on-surface --curvature -o farm.tif
      antumbra visible dem.tif --sensors raster+1.6 --turbines farm.gpkg --on-surface --map farm.pdf -o farm.tif
      antumbra visible city.city.json --sensors raster:2+1.6 --object Pand.1 --surfaces WallSurface -o share.tif
      antumbra visible city.glb --up z --sensors people.csv --polygon facade.csv --spacing 0.5 -o share.csv
      antumbra visible dem.tif --sensors raster+1.6 --turbine 85000,446000,12 --hub-height 120 --rotor 150 --map see.pdf
    """

    scene: SceneArgument = DEFAULT_SCENE
    sensors: SensorsOrDefault = None
    turbine: Annotated[
        list[str] | None,
        typer.Option(help="The foot of a wind turbine; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None
    turbines: Annotated[
        Path | None,
        typer.Option(
            help="A file of the feet of turbines: .csv, .parquet, .npz, .gpkg or .geojson, with the columns hub_height "
            "and rotor_diameter, and id or name.",
            show_default=False,
        ),
    ] = None
    hub_height: Annotated[
        float | None,
        typer.Option(help="Height of the hub above the foot of a turbine, in world units.", show_default=False),
    ] = None
    rotor: Annotated[float | None, typer.Option(help="Diameter of the rotor, in world units.", show_default=False)] = (
        None
    )
    object: Annotated[
        list[str] | None,
        typer.Option(help="An object of the scene, such as a building; may be repeated.", show_default=False),
        ListedBefore("plan"),
    ] = None
    surfaces: Annotated[
        str | None,
        typer.Option(
            help="Only these surface types, such as WallSurface,RoofSurface.", metavar="TYPES", show_default=False
        ),
    ] = None
    polygon: Annotated[
        Path | None,
        typer.Option(
            help="The corners of a flat polygon, counterclockwise from the front: .csv, .parquet, .npy, .npz, .gpkg or "
            ".geojson.",
            show_default=False,
        ),
    ] = None
    points: Annotated[
        Path | None, typer.Option(help="The points of the target, perhaps with normals.", show_default=False)
    ] = None
    spacing: Annotated[
        float | None,
        typer.Option(
            help="Distance between points on objects and polygons, in world units.  [default: 1 m]", show_default=False
        ),
    ] = None
    trees: VegetationOption = None
    before: BeforeOption = False
    output: OutputsOption = None
    map: MapOption = None
    sheet: SheetOption = None
    column: ColumnOption = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    def check(self) -> None:
        super().check()
        if self.surfaces is not None and self.object is None:
            raise InputError(f"--surfaces {self.surfaces}: needs --object NAME")
        given = self.turbine or None, self.turbines, self.object, self.polygon, self.points
        if sum(each is not None for each in given) != 1:
            raise InputError(f"give one target: {_WAYS}")
        of_turbines = bool(self.turbine) or self.turbines is not None
        if self.turbine and (self.hub_height is None or self.rotor is None):
            raise InputError("--turbine needs --hub-height and --rotor")
        if self.options.on_surface and not of_turbines:
            raise InputError("--on-surface places the feet of turbines, and there are none; leave it out")
        if not of_turbines and not (self.hub_height is None and self.rotor is None):
            raise InputError("--hub-height and --rotor are of turbines, and there are none; leave them out")
        _ = self._feet, self._file

    @cached_property
    def _feet(self) -> "PointFile | None":
        """Those of turbines."""
        from ..sensors.sensor_files import points_or_file
        from .turbines import turbines_of_table

        feet = points_or_file(self.turbine, self.turbines, "--turbine", "--turbines", self.options.on_surface)
        if feet is not None and self.turbines is not None:
            turbines_of_table(self.turbines, feet.sensors, self.hub_height, self.rotor)
        return feet

    @cached_property
    def _file(self) -> "PointFile | None":
        """The points of the target, or the corners of its polygon."""
        from ..sensors.point_attributes import warn_of_lost
        from ..sensors.sensor_files import points_or_file

        path = self.polygon or self.points
        points = points_or_file(None, path, "", "--points" if self.polygon is None else "--polygon")
        if points is not None:
            warn_of_lost(points.name, points.sensors.attributes)
        return points

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Table | TableBlocks | None]":
        from .targets import visible_blocks, visible_share

        target = self._target(scenes.bare)
        given = {"target": target, "surface": scenes.bare, **field_values(self.options)}
        sensors = scenes.sensor_blocks(self.sensor_form, self.threads)
        sensors = self.check_room(sensors, lambda some: visible_share(scenes.planted, some, **given), executor)
        return partial(
            visible_blocks, scenes.planted, self.options, sensors, target, scenes.bare, executor, self.partitioned
        )

    def _target(self, scene: "AnyScene") -> "Turbine | dict[str, Turbine] | Sensors":
        """The target that the options name."""
        from .targets import polygon_points, surface_points
        from .turbines import Turbine, turbines_of_table

        spacing = scene.unit.of_metres(_SPACING) if self.spacing is None else self.spacing
        if self._feet is not None:
            feet = self._feet.within(scene)
            if self.turbines is not None:
                named = turbines_of_table(self.turbines, feet, self.hub_height, self.rotor)
                return dict(zip(named.names, named.each))
            each = [Turbine(foot, self.hub_height or 0.0, self.rotor or 0.0) for foot in feet.points]
            return each[0] if len(each) == 1 else {str(k): turbine for k, turbine in enumerate(each, 1)}
        if self.object is not None:
            known = {name for thing in scene.objects for name in (thing.name, thing.parent) if name}
            for name in self.object:
                if name not in known:
                    hint = spelling_hint(name, known)
                    raise InputError(f"--object {name}: {scene.name} has no such object; {hint}see antumbra info")
            types = None if self.surfaces is None else self.surfaces.split(",")
            return surface_points(scene, spacing, objects=self.object, types=types)
        assert self._file is not None
        points = self._file.within(scene)
        return points if self.polygon is None else polygon_points(points.points, spacing)

    def summary(self, result: "Table | TableBlocks", scenes: Scenes, seconds: float) -> Summary:
        from .targets import share_summary

        return share_summary(result, scenes.planted.name, seconds)


visible = command_of(VisibleCommand, VisibleOptions)
