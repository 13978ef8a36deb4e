"""``antumbra los``: which points see each other, and what blocks the others, as tables and models."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ...base.errors import InputError
from ...base.option_fields import field_values
from ...base.wording import some_of
from ...cli.options import LISTED_LAST, CrsOption, ListedBefore, MapOption, SceneArgument, SheetOption, UpOption, tables
from ...cli.scene_arguments import DEFAULT_SCENE, BeforeOption
from ...cli.shards import MergeOption, RayOption, ShardOption
from ...cli.study_run import Scenes, StudyCommand, Writers, command_of
from ...cli.vegetation_options import VegetationOption
from ...work.result_summary import Summary
from .sight_options import SightOptions

if TYPE_CHECKING:
    from ...engine.scene import AnyScene
    from ...work.executors import Executor
    from ..sensors.vector_points import PointFile
    from ..sheets.sheet_options import Sheet
    from .sightlines import PairList, Sightlines

_MODEL = ".glb"
_SUFFIXES = ".csv", ".parquet", ".parquets", ".json", ".npz", _MODEL


@dataclass(frozen=True, kw_only=True)
class LosCommand(StudyCommand[SightOptions, "list[Sightlines]"]):
    """Find which points see each other.

    For each pair that does not, the result names the nearest blocking face, its object, the blocked point, and the
    distances. An endpoint on a surface needs a normal (columns nx,ny,nz, or nx1 to nz2) or its face (face1, face2);
    otherwise float32 may round it behind the surface. Tables have a row per pair; a .glb shows the lines, green up to
    the first blocker.

    \b
    Examples
      antumbra los --from 0,1.7,8 --to 0,3,-8
      antumbra los city.glb --up z --from 10,20,1.7 --targets windows.csv -o seen.csv
      antumbra los city.glb --up z --observers people.csv --targets signs.csv -o lines.glb -o lines.parquet
      antumbra los city.glb --up z --from 10,20,1.7 --targets windows.csv --map lines.pdf
      antumbra los hall.glb --pairs pairs.csv -o result.csv --json
    """

    scene: SceneArgument = DEFAULT_SCENE
    observer: Annotated[
        list[str] | None,
        typer.Option("--from", help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None
    target: Annotated[
        list[str] | None,
        typer.Option("--to", help="A target; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None
    observers: Annotated[
        Path | None,
        typer.Option(help="A file of observers: .csv, .parquet, .npy, .npz, .gpkg or .geojson.", show_default=False),
    ] = None
    targets: Annotated[Path | None, typer.Option(help="A file of targets.", show_default=False)] = None
    pairs: Annotated[
        str,
        typer.Option(
            help="all: each observer with each target; zip: pairwise; a file of indices with the columns from and to; "
            "or, without observers and targets, a file of points with the columns x1,y1,z1,x2,y2,z2.",
            metavar="all|zip|FILE",
        ),
    ] = "all"
    trees: VegetationOption = None
    before: BeforeOption = False
    output: Annotated[list[Path] | None, tables("Output file", "--output", "-o", suffixes=_SUFFIXES)] = None
    map: MapOption = None
    sheet: SheetOption = None
    up: Annotated[UpOption, ListedBefore("threads")] = None
    crs: CrsOption = None
    shard: Annotated[ShardOption, LISTED_LAST] = None
    ray: RayOption = None
    merge: MergeOption = None

    def check(self) -> None:
        from .sightlines import check_pairs, pairs_of

        check_pairs(self.pairs)
        begin, end = self._ends
        if (begin is None) != (end is None):
            raise InputError("observers need targets: give --from or --observers, and --to or --targets")
        if begin is None and self.pairs in ("all", "zip"):
            raise InputError(
                "there are no points: give --from and --to, --observers and --targets, or a file of --pairs"
            )
        if begin is None or end is None:
            _ = self._listed
        else:
            pairs_of(self.pairs, begin.sensors, end.sensors)

    def check_output(self, path: Path) -> None:
        from ..tables.result_table import writer_of

        writer_of(path, "points")

    @cached_property
    def _ends(self) -> "tuple[PointFile | None, PointFile | None]":
        """The observers and the targets."""
        from ..sensors.sensor_files import points_or_file

        begin = points_or_file(self.observer, self.observers, "--from", "--observers")
        return begin, points_or_file(self.target, self.targets, "--to", "--targets")

    @cached_property
    def _listed(self) -> "PairList":
        """The pairs of a file of points."""
        from .sightlines import read_pairs

        return read_pairs(Path(self.pairs))

    def pairs_in(self, scene: "AnyScene") -> "PairList":
        """The pairs that the arguments name, in the CRS of a scene."""
        from .sightlines import pairs_of

        begin, end = self._ends
        if begin is None or end is None:
            return self._listed
        return pairs_of(self.pairs, begin.within(scene), end.within(scene))

    def work(self, scenes: Scenes, executor: "Executor | None") -> "Callable[[], list[Sightlines] | None]":
        from ..sensors.sensor_files import check_file_crs
        from .sightlines import line_of_sight

        check_file_crs(scenes.planted, Path(self.pairs))
        pairs = self.pairs_in(scenes.planted)
        study = partial(line_of_sight, scenes.planted, **pairs.keywords(), **field_values(self.options))

        def lines() -> "list[Sightlines] | None":
            found: Sightlines | None = study(keep=executor)  # None: a shard
            return None if found is None else [found]

        return lines

    def compared(self, before: "list[Sightlines]", after: "list[Sightlines]", scenes: Scenes) -> "list[Sightlines]":
        return [*before, *after]

    def writers(self, result: "list[Sightlines]", scenes: Scenes) -> Writers:
        return {"output": partial(self._write, result, scenes), "map": partial(self._write_map, result, scenes)}

    def _write_map(self, result: "list[Sightlines]", scenes: Scenes, path: Path, sheet: "Sheet") -> None:
        from .sight_map import save_sight_map

        save_sight_map(scenes.planted, self.pairs_in(scenes.planted), result[-1], path, sheet)

    def _write(self, result: "list[Sightlines]", scenes: Scenes, path: Path) -> None:
        from ...base.files import atomic_output
        from ..changes.before_and_after import before_and_after
        from .sightlines import sight_model, sight_table

        if path.suffix.lower() == _MODEL:
            with atomic_output(path) as temporary:
                temporary.write_bytes(sight_model(scenes.planted, self.pairs_in(scenes.planted), result[-1]))
            return
        tables = [sight_table(scenes.planted, self.pairs_in(scenes.planted), each) for each in result]
        (before_and_after(*tables) if len(tables) > 1 else tables[0]).save(path, "visible")

    def summary(self, result: "list[Sightlines]", scenes: Scenes, seconds: float) -> Summary:
        from .sightlines import sight_summary

        summary = sight_summary(scenes.planted, self.pairs_in(scenes.planted), result[-1], seconds)
        if len(result) == 1:
            return summary
        n = int(result[0].visible.sum())
        lines = [("visible before", f"{some_of(n, result[0].visible.size, 'pair')}"), *summary.lines]
        return summary._replace(values={**summary.values, "visible_before": n}, lines=lines)


los = command_of(LosCommand, SightOptions)
