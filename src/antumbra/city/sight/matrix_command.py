"""``antumbra matrix``: which sensors see which targets, as packed bits, sparse matrices and counts."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...cli.options import (
    LISTED_LAST,
    CrsOption,
    ListedBefore,
    MapOption,
    SceneArgument,
    SensorsOption,
    SheetOption,
    UpOption,
    tables,
    writes,
)
from ...cli.scene_arguments import DEFAULT_SCENE
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from .sight_options import MatrixOptions

if TYPE_CHECKING:
    from ...work.executors import Executor
    from ..tables.result_table import Table
    from .visibility_matrix import VisibilityMatrix

_BITS, _SPARSE = ".npy", ".npz"


@dataclass(frozen=True, kw_only=True)
class MatrixCommand(StudyCommand[MatrixOptions, "list[VisibilityMatrix]"]):
    """Find which sensors see which targets, as a matrix.

    Sensors on surfaces are visible only from their outer side. Bit j % 64 of word j // 64 in row i is set if sensor i
    and target j see each other. Without --targets, each pair is traced once, and no sensor sees itself.

    \b
    Examples
      antumbra matrix --sparse faces.npz
      antumbra matrix hall.glb --sensors grid:0.5 -o seen.npy --counts seen.png
      antumbra matrix city.glb --up z --sensors people.csv --targets face -o seen.npy --sparse seen.npz
      antumbra matrix city.glb --up z --sensors raster:5+1.6 --trees "trees.gpkg?height=h&radius=r" -o seen.npy
    """

    scene: SceneArgument = DEFAULT_SCENE
    sensors: SensorsOption = "face"
    targets: Annotated[
        str | None,
        typer.Option(
            help="Targets, same forms as --sensors.  [default: the sensors]", metavar="SENSORS", show_default=False
        ),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Write bits (.npy): which sensor sees which target. A word holds 64 targets; an interrupted "
            "run continues in the file.",
            show_default=False,
            callback=writes(_BITS),
        ),
    ] = None
    sparse: Annotated[
        Path | None,
        typer.Option(
            help="A .npz file of the visible pairs, for scipy.sparse.load_npz.",
            show_default=False,
            callback=writes(_SPARSE),
        ),
    ] = None
    counts: Annotated[list[Path] | None, tables("File of the number of targets visible from each sensor")] = None
    map: MapOption = None
    sheet: SheetOption = None
    trees: VegetationOption = None
    before: Annotated[
        bool,
        typer.Option(
            "--before",
            help="In --counts, also the state before --add and --remove: seen_before, seen and seen_loss.",
        ),
    ] = False
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    def check(self) -> None:
        from ..sensors.sensor_files import check_sensors, kind_of
        from ..tables.result_table import writer_of

        check_sensors(self.sensors)
        if self.targets is not None:
            check_sensors(self.targets, "--targets")
        for path in self.paths("counts"):
            writer_of(path, kind_of(self.sensors))
        if self.before and (self.output is not None or self.sparse is not None):
            raise InputError("--before works only with --counts and --map; omit --output and --sparse")
        if self.output is None and self.sparse is None and not self.counts and not self.map:
            raise InputError("there is nothing to write: give --output, --sparse, --counts or --map")

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], list[VisibilityMatrix] | None]":
        from ..sensors.point_attributes import warn_of_lost
        from .visibility_matrix import visibility_matrix

        sensors, targets = scenes.sensors(self.sensors, self.threads), None
        if self.targets is not None:
            targets = scenes.sensors(self.targets, self.threads)
            warn_of_lost(self.targets, targets.attributes)
        study = partial(visibility_matrix, scenes.planted, sensors, targets, **field_values(self.options))

        def matrices() -> "list[VisibilityMatrix] | None":
            found: VisibilityMatrix | None = study(output=self.output, keep=executor)  # None: a shard
            return None if found is None else [found]

        return matrices

    def compared(
        self, before: "list[VisibilityMatrix]", after: "list[VisibilityMatrix]", scenes: Scenes
    ) -> "list[VisibilityMatrix]":
        return [*before, *after]

    def writers(self, result: "list[VisibilityMatrix]", scenes: Scenes) -> Writers:
        return {
            "output": lambda path: None,  # the study has written it
            "sparse": result[-1].save,
            "counts": lambda path: self._counts(result, scenes).save(path),
            "map": lambda path, sheet: self._counts(result, scenes).save_map(path, sheet=sheet),
        }

    def _counts(self, result: "list[VisibilityMatrix]", scenes: Scenes) -> "Table":
        """The number of targets that each sensor sees, before and after if both states were traced."""
        from ..changes.before_and_after import before_and_after
        from ..tables.result_table import Column, Table

        sensors, tables = scenes.sensors(self.sensors, self.threads), list[Table]()
        for each in result:
            column = Column(each.counts, "", f"visible targets, of {each.columns}")
            tables.append(Table(sensors, {"seen": column}, {"job": "matrix"}, scenes.planted))
        return before_and_after(*tables) if len(tables) > 1 else tables[0]

    def summary(self, result: "list[VisibilityMatrix]", scenes: Scenes, seconds: float) -> Summary:
        return result[-1].summary(scenes.planted.name, seconds)


matrix = command_of(MatrixCommand, MatrixOptions)
