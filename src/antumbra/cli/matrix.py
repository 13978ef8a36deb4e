"""``antumbra matrix``: which of many points see which others."""

from pathlib import Path
from time import perf_counter
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .joboptions import SensorsOption
from .options import SCENE_HELP, Json, Quiet, Threads, TimeOption, UpOption
from .progress import ProgressDisplay
from .sceneinput import open_scene

_BITS, _SPARSE = ".npy", ".npz"


def matrix(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE,
    sensors: SensorsOption = "face",
    targets: Annotated[
        str | None,
        typer.Option(help="The same forms as --sensors.  [default: the sensors themselves]", show_default=False),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="A .npy file of bits, 64 targets in a word; it goes on where it stopped.",
            show_default=False,
        ),
    ] = None,
    sparse: Annotated[
        Path | None,
        typer.Option(help="A .npz file of the visible pairs, for scipy.sparse.load_npz.", show_default=False),
    ] = None,
    counts: Annotated[
        list[Path] | None,
        typer.Option(
            help="A file of the number of targets that each sensor sees; may be repeated: .csv, .parquet, .json, .npz, "
            ".png, .glb or .tif.",
            show_default=False,
        ),
    ] = None,
    plan: Annotated[
        str | None, typer.Option(help="Methods; see antumbra plans.  [default: auto]", show_default=False)
    ] = None,
    time: TimeOption = 0.0,
    up: UpOption = None,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find which sensors of SCENE see which targets: one bit for each pair.

    Sensors on surfaces are seen from their outer side only. Bit j % 64 of word j // 64 of row i says whether sensor i
    and target j see each other. Without --targets each pair is traced once, and no sensor sees itself.

    \b
    Examples
      antumbra matrix --sparse faces.npz
      antumbra matrix hall.glb --sensors grid:0.5 -o seen.npy --counts seen.png
      antumbra matrix city.glb --up z --sensors people.csv --targets face -o seen.npy --sparse seen.npz
    """
    spec = arguments.parse_scene(scene)

    from ..jobs.formats import writer_of
    from ..jobs.readsensors import check_sensors, kind_of, sensors_of
    from ..jobs.sight.matrix import visibility_matrix
    from ..jobs.table import Column, Table
    from ..output import checked_output

    check_sensors(sensors)
    if targets is not None:
        check_sensors(targets, "--targets")
    bits = None if output is None else checked_output(output, (_BITS,))
    pairs = None if sparse is None else checked_output(sparse, (_SPARSE,))
    for path in counts or []:
        writer_of(path, kind_of(sensors))
    if bits is None and pairs is None and not counts:
        raise InputError("there is nothing to write: give --output, --sparse or --counts")
    with ProgressDisplay(quiet) as display:
        display.say("reading the scene")
        opened = open_scene(spec, None if up is None else up.value, quiet)
        display.say("preparing")
        own = sensors_of(sensors, opened, threads)
        others = None if targets is None else sensors_of(targets, opened, threads)
        start = perf_counter()
        found = visibility_matrix(opened, own, others, output=bits, plan=plan, time=time, threads=threads)
        seconds = perf_counter() - start
        display.say("writing the results")
        if pairs is not None:
            found.save(pairs)
        column = Column(found.counts, "", f"targets that it sees, of {found.columns}")
        for path in counts or []:
            Table(own, {"seen": column}, {"job": "matrix"}, opened).save(path)
    written = [str(path) for path in [bits, pairs, *(counts or [])] if path is not None]
    rows, columns = found.shape
    visible = int(found.counts.sum())
    if json:
        answer = {"scene": opened.name, "rows": rows, "columns": columns, "visible": visible, "seconds": seconds}
        report.print_json({**answer, "outputs": written})
    elif not quiet:
        share = 100.0 * visible / max(rows * columns, 1)
        fields = [("matrix", f"{rows:,} x {columns:,}"), ("visible", f"{visible:,} pairs ({share:.2f} %)")]
        fields.append(("time", report.duration(seconds)))
        report.print_fields([*fields, *(("written", path) for path in written)])
