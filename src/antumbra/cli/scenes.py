"""``antumbra scenes``: lists and exports the procedural scenes."""

from pathlib import Path
from typing import Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .options import Json
from .outputs import writes
from .progress import ProgressDisplay


def scenes(
    name: Annotated[str | None, typer.Argument(help="A scene to look at or to export.", metavar="NAME")] = None,
    triangles: Annotated[
        str | None,
        typer.Option(help="About how many triangles: 5000, 100k, 2M.  [default: the scene's own]", metavar="N"),
    ] = None,
    seed: Annotated[str, typer.Option(help="Other seeds scatter the clutter differently.", metavar="N")] = "0",
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="Write NAME to a .glb, .obj or .ply file.",
            metavar="FILE",
            callback=writes(".glb", ".obj", ".ply"),
        ),
    ] = None,
    json: Json = False,
) -> None:
    """List the procedural scenes, or export one.

    A GLB file also holds the scene's camera and a point light. The point light replaces the scene's quad light, because
    glTF has none. To render a procedural scene, name it: antumbra render procedural:city

    \b
    Examples
      antumbra scenes
      antumbra scenes city --triangles 1M --seed 7 -o city.glb
    """
    if name is None:
        if output is not None or triangles is not None:
            raise InputError("name a scene to export: antumbra scenes NAME -o FILE")
        _list(json)
        return
    count = None if triangles is None else arguments.parse_count(triangles, "--triangles")
    number = arguments.parse_count(seed, "--seed")
    if output is not None:
        from .export import check_output

        check_output(output)
    with ProgressDisplay() as display:
        display.say("generating")
        answer = _make(name, count, number, output)
    if json:
        report.print_json(answer)
    else:
        lower, upper = answer["bounds"]
        rows = [("scene", f"{name}, {answer['triangles']:,} triangles")]
        rows.append(("bounds", f"{report.vector(lower)} to {report.vector(upper)}"))
        rows += [("written", str(file)) for file in answer["files"]]
        report.print_fields(rows)


def _list(json: bool) -> None:
    from ..generate.procedural_scenes import PROCEDURAL, add_scenes

    add_scenes()
    rows = [(name, recipe.default_triangles, recipe.description) for name, recipe in PROCEDURAL.items()]
    if json:
        report.print_json({"scenes": [dict(zip(("name", "triangles", "description"), row)) for row in rows]})
        return
    shown = [(name, f"{triangles:,}", description) for name, triangles, description in rows]
    report.print_table(("name", "triangles", "what it is"), shown, right=(1,))


def _make(name: str, triangles: int | None, seed: int, output: Path | None) -> dict:
    from ..generate.procedural_scenes import generate

    made = generate(name, triangles, seed)
    files = []
    if output is not None:
        from .export import write_scene

        files = write_scene(made, name, output)
    return {
        "name": name,
        "seed": seed,
        "triangles": len(made.faces),
        "bounds": [made.vertices.min(0), made.vertices.max(0)],
        "camera": made.camera,
        "light": made.light,
        "files": [str(file) for file in files],
    }
