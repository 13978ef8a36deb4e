"""``antumbra visible``: the share of a facade, a polygon or a wind turbine that each sensor sees."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.checks import spelling_hint
from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.arguments import parse_point
from ...cli.options import (
    ColumnOption,
    CrsOption,
    ListedBefore,
    OutputsOption,
    SceneArgument,
    SensorsOrDefault,
    UpOption,
)
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption, in_memory
from ...cli.study_run import Scenes, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from ..sensor_study import SensorStudy
from .sight_options import VisibleOptions

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ...engine.scene import AnyScene
    from ...work.executors import Executor
    from ..sensors.sensors import Sensors
    from ..tables.result_table import Table
    from .targets import Turbine

_SPACING = 1.0  # metres between points on objects and polygons
_WAYS = "--turbine X,Y,Z, --object NAME, --polygon FILE or --points FILE"


@dataclass(frozen=True, kw_only=True)
class VisibleCommand(SensorStudy[VisibleOptions, "Table"]):
    """Find the share of a target in SCENE that each sensor sees.

    The target is a wind turbine, whose rotor turns towards each sensor, an object of the scene, a polygon or points.
    The result has the columns share, from 0 to 1, and visible, the number of visible sample points.

    \b
    Examples
      antumbra visible dem.tif --sensors raster+1.6 --turbine 85000,446000,12 --hub-height 120 --rotor 150 -o share.tif
      antumbra visible city.city.json --sensors raster:2+1.6 --object Pand.1 --surfaces WallSurface -o share.tif
      antumbra visible city.glb --up z --sensors people.csv --polygon facade.csv --spacing 0.5 -o share.csv
    """

    scene: SceneArgument = DEFAULT_SCENE
    sensors: SensorsOrDefault = None
    turbine: Annotated[
        str | None, typer.Option(help="The foot of a wind turbine.", metavar="X,Y,Z", show_default=False)
    ] = None
    hub_height: Annotated[float | None, typer.Option(help="Of the turbine, above its foot.", show_default=False)] = None
    rotor: Annotated[float | None, typer.Option(help="Diameter of the turbine's rotor.", show_default=False)] = None
    object: Annotated[
        list[str] | None,
        typer.Option(help="An object of the scene, such as a building; may be repeated.", show_default=False),
        ListedBefore("plan"),
    ] = None
    surfaces: Annotated[
        str | None,
        typer.Option(
            help="Types of its surfaces, such as WallSurface,RoofSurface.", metavar="TYPES", show_default=False
        ),
    ] = None
    polygon: Annotated[
        Path | None,
        typer.Option(
            help="The corners of a flat polygon, counterclockwise from the front: .csv, .parquet, .npy or .npz.",
            show_default=False,
        ),
    ] = None
    points: Annotated[
        Path | None, typer.Option(help="The points of the target, perhaps with normals.", show_default=False)
    ] = None
    spacing: Annotated[
        float | None,
        typer.Option(help="World units between points on objects and polygons.  [default: 1 m]", show_default=False),
    ] = None
    trees: VegetationOption = None
    before: BeforeOption = False
    output: OutputsOption = None
    column: ColumnOption = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None

    @property
    def foot(self) -> "NDArray[np.float64] | None":
        """That of the turbine."""
        return None if self.turbine is None else parse_point(self.turbine, "--turbine")

    def check(self) -> None:
        super().check()
        if self.surfaces is not None and self.object is None:
            raise InputError(f"--surfaces {self.surfaces}: needs --object NAME")
        if sum(each is not None for each in (self.turbine, self.object, self.polygon, self.points)) != 1:
            raise InputError(f"give one target: {_WAYS}")
        if self.foot is not None and (self.hub_height is None or self.rotor is None):
            raise InputError("--turbine needs --hub-height and --rotor")

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], Table]":
        from ..sensors.sensor_files import check_file_crs
        from .targets import visible_share

        check_file_crs(scenes.planted, self.polygon, self.points)
        target = self._target(scenes.bare)
        sensors = scenes.sensors(self.sensor_form, self.threads)
        return partial(visible_share, scenes.planted, sensors, target, **field_values(self.options))

    def _target(self, scene: "AnyScene") -> "Turbine | Sensors":
        """The target that the options name."""
        from ..sensors.point_attributes import warn_of_lost
        from ..sensors.sensor_files import read_points
        from .targets import Turbine, polygon_points, surface_points

        spacing = scene.unit.of_metres(_SPACING) if self.spacing is None else self.spacing
        if self.foot is not None:
            return Turbine(self.foot, self.hub_height or 0.0, self.rotor or 0.0)
        if self.object is not None:
            known = {name for thing in scene.objects for name in (thing.name, thing.parent) if name}
            for name in self.object:
                if name not in known:
                    hint = spelling_hint(name, known)
                    raise InputError(f"--object {name}: {scene.name} has no such object; {hint}see antumbra info")
            types = None if self.surfaces is None else self.surfaces.split(",")
            return surface_points(in_memory(scene), spacing, objects=self.object, types=types)
        path = self.polygon or self.points or Path()
        points = read_points(path)
        warn_of_lost(path.name, points.attributes)
        return points if self.polygon is None else polygon_points(points.points, spacing)

    def summary(self, result: "Table", scenes: Scenes, seconds: float) -> Summary:
        from .targets import share_summary

        return share_summary(result, scenes.planted.name, seconds)


visible = command_of(VisibleCommand, VisibleOptions)
