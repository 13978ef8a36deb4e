"""``antumbra matrix``: which of many points see which others."""

from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .joboptions import CrsOption, PlanOption, SensorsOption
from .options import SCENE_HELP, Json, Quiet, Threads, TimeOption, UpOption, takes
from .outputs import tables, writes
from .progress import ProgressDisplay
from .sceneinput import open_scene
from .sharing import MergeOption, RayOption, ShardOption, engine_for, tell_shard

if TYPE_CHECKING:
    from ..jobs.sight.matrix import VisibilityMatrix

_BITS, _SPARSE = ".npy", ".npz"


@dataclass(frozen=True)
class MatrixArguments:
    """The arguments of the command line."""

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    sensors: SensorsOption = "face"
    targets: Annotated[
        str | None,
        typer.Option(help="The same forms as --sensors.  [default: the sensors themselves]", show_default=False),
    ] = None
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .npy file of bits, 64 targets in a word; it goes on where it stopped.",
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
    counts: Annotated[list[Path] | None, tables("A file of the number of targets that each sensor sees")] = None
    plan: PlanOption = None
    time: TimeOption = 0.0
    up: UpOption = None
    crs: CrsOption = None
    threads: Threads = None
    shard: ShardOption = None
    ray: RayOption = None
    merge: MergeOption = None
    json: Json = False
    quiet: Quiet = False


@takes(MatrixArguments)
def matrix(given: MatrixArguments) -> int:
    """Find which sensors of SCENE see which targets: one bit for each pair.

    Sensors on surfaces are seen from their outer side only. Bit j % 64 of word j // 64 of row i says whether sensor i
    and target j see each other. Without --targets each pair is traced once, and no sensor sees itself.

    \b
    Examples
      antumbra matrix --sparse faces.npz
      antumbra matrix hall.glb --sensors grid:0.5 -o seen.npy --counts seen.png
      antumbra matrix city.glb --up z --sensors people.csv --targets face -o seen.npy --sparse seen.npz
    """
    spec = arguments.parse_scene(given.scene)

    from ..jobs.readsensors import check_sensors, sensors_of
    from ..jobs.sight.matrix import visibility_matrix
    from ..jobs.table import Column, Table

    check_sensors(given.sensors)
    if given.targets is not None:
        check_sensors(given.targets, "--targets")
    bits, pairs, counts = _checked_outputs(given)
    outputs = [path for path in (bits, pairs, *counts) if path is not None]
    engine = engine_for(given, outputs[0])
    with ProgressDisplay(given.quiet) as display:
        display.say("reading the scene")
        opened = open_scene(spec, None if given.up is None else given.up.value, given.quiet, given.crs)
        display.say("preparing")
        own = sensors_of(given.sensors, opened, given.threads)
        others = None if given.targets is None else sensors_of(given.targets, opened, given.threads)
        start = perf_counter()
        found = visibility_matrix(
            opened, own, others, output=bits, plan=given.plan, time=given.time, threads=given.threads, keep=engine
        )
        seconds = perf_counter() - start
        if found is None:
            return tell_shard(engine, given, seconds)
        display.say("writing the results")
        if pairs is not None:
            found.save(pairs)
        column = Column(found.counts, "", f"targets that it sees, of {found.columns}")
        for path in counts:
            Table(own, {"seen": column}, {"job": "matrix"}, opened).save(path)
    _tell(given, opened.name, found, seconds, [str(path) for path in outputs])
    return 0


def _checked_outputs(given: MatrixArguments) -> tuple[Path | None, Path | None, list[Path]]:
    """The files to write, checked before a scene is read: of bits, of pairs, and of counts."""
    from ..jobs.formats import writer_of
    from ..jobs.readsensors import kind_of

    counts = given.counts or []
    for path in counts:
        writer_of(path, kind_of(given.sensors))
    if given.output is None and given.sparse is None and not counts:
        raise InputError("there is nothing to write: give --output, --sparse or --counts")
    return given.output, given.sparse, counts


def _tell(given: MatrixArguments, name: str, found: "VisibilityMatrix", seconds: float, written: list[str]) -> None:
    rows, columns = found.shape
    visible = int(found.counts.sum())
    if given.json:
        answer = {"scene": name, "rows": rows, "columns": columns, "visible": visible, "seconds": seconds}
        report.print_json({**answer, "outputs": written})
    elif not given.quiet:
        share = 100.0 * visible / max(rows * columns, 1)
        fields = [("matrix", f"{rows:,} x {columns:,}"), ("visible", f"{visible:,} pairs ({share:.2f} %)")]
        fields.append(("time", report.duration(seconds)))
        report.print_fields([*fields, *(("written", path) for path in written)])
