"""``antumbra los``: lines of sight between pairs of points."""

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .joboptions import CrsOption, points_or_file
from .options import SCENE_HELP, Json, Quiet, Threads, TimeOption, UpOption
from .outputs import tables
from .progress import ProgressDisplay
from .sceneinput import in_memory, open_scene

if TYPE_CHECKING:
    from ..engine.scene import AnyScene
    from ..jobs.sight.pairs import Sightlines
    from ..jobs.sight.readpairs import PairList

_MOST_LINES = 20  # pairs that are printed
_MODEL = ".glb"
_SUFFIXES = ".csv", ".parquet", ".json", ".npz", _MODEL
_COLUMNS = "observer", "target", "visible", "blocked_by", "face", "distance"  # of the lines that are printed


def los(
    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE,
    observer: Annotated[
        list[str] | None,
        typer.Option("--from", help="An observer; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None,
    target: Annotated[
        list[str] | None,
        typer.Option("--to", help="A target; may be repeated.", metavar="X,Y,Z", show_default=False),
    ] = None,
    observers: Annotated[
        Path | None, typer.Option(help="A file of observers: .csv, .parquet, .npy or .npz.", show_default=False)
    ] = None,
    targets: Annotated[Path | None, typer.Option(help="A file of targets.", show_default=False)] = None,
    pairs: Annotated[
        str,
        typer.Option(
            help="all: each observer and each target; zip: one by one; a file with the columns from and to: indices; "
            "or, without observers and targets, a file with the columns x1,y1,z1,x2,y2,z2.",
            metavar="all|zip|FILE",
        ),
    ] = "all",
    output: Annotated[list[Path] | None, tables("Where to write", "--output", "-o", suffixes=_SUFFIXES)] = None,
    time: TimeOption = 0.0,
    up: UpOption = None,
    crs: CrsOption = None,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Say which points see each other in SCENE, and what blocks those that do not.

    Each pair gets the nearest blocking face, its object, the point where it blocks, and the distances. An end that lies
    on a surface needs a normal (columns nx,ny,nz, or nx1 to nz2) or its face (face1, face2), or float32 may round it
    behind the surface. Files hold a row for each pair; a .glb shows the lines, green as far as they see.

    \b
    Examples
      antumbra los --from 0,1.7,8 --to 0,3,-8
      antumbra los city.glb --up z --from 10,20,1.7 --targets windows.csv -o seen.csv
      antumbra los city.glb --up z --observers people.csv --targets signs.csv -o lines.glb -o lines.parquet
      antumbra los hall.glb --pairs pairs.csv -o result.csv --json
    """
    spec = arguments.parse_scene(scene)

    from ..jobs.formats import writer_of
    from ..jobs.readsensors import check_file_crs
    from ..jobs.sight.lines import sight_model, sight_table
    from ..jobs.sight.pairs import line_of_sight
    from ..jobs.sight.readpairs import check_pairs, paired, read_pairs
    from ..output import replacing

    check_pairs(pairs)
    outputs = output or []
    writers = [writer_of(path, "points") for path in outputs]
    begin = points_or_file(observer, observers, "--from", "--observers")
    end = points_or_file(target, targets, "--to", "--targets")
    if (begin is None) != (end is None):
        raise InputError("observers need targets: give --from or --observers, and --to or --targets")
    if begin is None and pairs in ("all", "zip"):
        raise InputError("there are no points: give --from and --to, --observers and --targets, or a file of --pairs")
    asked = read_pairs(Path(pairs)) if begin is None or end is None else paired(pairs, begin, end)
    with ProgressDisplay(quiet) as display:
        display.say("reading the scene")
        opened = in_memory(open_scene(spec, None if up is None else up.value, quiet, crs))
        check_file_crs(opened, observers, targets, Path(pairs))
        start = perf_counter()
        at, to, normals, target_normals, faces, target_faces = asked
        found = line_of_sight(
            opened, at, to, normals=normals, target_normals=target_normals, faces=faces, target_faces=target_faces,
            time=time, threads=threads,
        )  # fmt: skip
        seconds = perf_counter() - start
        display.say("writing the results")
        for path, write in zip(outputs, writers):
            if path.suffix.lower() == _MODEL:
                with replacing(path) as temporary:
                    temporary.write_bytes(sight_model(opened, asked, found))
            else:
                write(sight_table(opened, asked, found), path, "visible")
    seen = int(found.visible.sum())
    if json:
        answer = {"scene": opened.name, "pairs": len(at), "visible": seen, "seconds": seconds}
        answer["outputs"] = [str(path) for path in outputs]
        if len(at) <= _MOST_LINES:
            answer["lines"] = _lines(opened, asked, found)
        report.print_json(answer)
    elif not quiet:
        if len(at) <= _MOST_LINES:
            rows = [[str(line[name]) for name in _COLUMNS] for line in _lines(opened, asked, found)]
            report.print_table([name.replace("_", " ") for name in _COLUMNS], rows)
        fields = [("visible", f"{seen:,} of {len(at):,} pairs"), ("time", report.duration(seconds))]
        report.print_fields(fields + [("written", str(path)) for path in outputs])


def _lines(scene: "AnyScene", pairs: "PairList", found: "Sightlines") -> list[dict]:
    """A dictionary for each pair."""
    lines = []
    for k, visible in enumerate(found.visible.tolist()):
        face, own = int(found.face[k]), int(found.object[k])
        lines.append({
            "observer": ",".join(f"{x:g}" for x in pairs.observers[k]),
            "target": ",".join(f"{x:g}" for x in pairs.targets[k]),
            "visible": "yes" if visible else "no",
            "blocked_by": scene.objects[own].name if own >= 0 else "",
            "face": face if face >= 0 else "",
            "distance": "" if visible else round(float(found.distance[k]), 4),
            **_of_city(scene, face, own),
        })  # fmt: skip
    return lines


def _of_city(scene: "AnyScene", face: int, own: int) -> dict[str, str]:
    """What a city model knows of the blocking face."""
    if scene.city is None or own < 0:
        return {}
    thing = scene.objects[own]
    return {"type": thing.type, "parent": thing.parent, "surface": str(scene.city.surface_types(face))}
