"""Options that several commands share, and a decorator for commands that take all options as one object."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, Field, fields
from enum import StrEnum
from typing import Annotated, Any

import typer

from .written import written


class Up(StrEnum):
    y = "y"
    z = "z"


UpOption = Annotated[
    Up | None,
    typer.Option(
        help="Which axis of the file points up.  [default: z for CityJSON, and if floors and roofs face z; else y]",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, and nothing else there.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]

Threads = Annotated[int | None, written("threads")]
CameraOption = Annotated[
    str | None,
    typer.Option(
        "--camera",
        help="An index, POSITION:TARGET[:VFOV], ortho, top or panorama.",
        metavar="CAMERA",
        show_default=False,
    ),
]

LightOption = Annotated[
    list[str] | None,
    typer.Option("--light", help="An index, or KIND:...; may be repeated.", metavar="LIGHT", show_default=False),
]
TimeOption = Annotated[float, written("time", 0.0)]
SppOption = Annotated[int, written("spp", 16)]
SamplerOption = Annotated[str, written("sampler", "")]
SrdhRaysOption = Annotated[
    str | None,
    typer.Option(
        help="Shadow rays that the builder srdh is shown: of so many pixels across and down, or all; bounce: as many "
        "again after a diffuse bounce; last-frame: those of the frame before.  [default: 16]",
        metavar="N|all[,bounce][,last-frame]",
        show_default=False,
    ),
]
MaxMemoryOption = Annotated[str | None, written("max_memory")]

SCENE_HELP = (
    "A .glb, .gltf, .obj, .ply or .stl file, a CityJSON file (FILE or FILE?lod=N), a folder of vertex frames, "
    "or procedural:NAME?triangles=N&seed=N. FILE?cutouts=off closes the holes that alpha cuts."
)


def fields_of(arguments: type) -> list[Field]:
    """The fields of a dataclass of arguments in the order of the help: its own ones before those of base classes."""
    return sorted(fields(arguments), key=lambda field: field.name not in vars(arguments).get("__annotations__", {}))


def takes(arguments: type) -> Callable:
    """Decorator of a command ``f(arguments)``. Typer sees each field of the dataclass `arguments` as a parameter.

    A field without a default is a required one. In the help, those of base classes come last.
    """

    def default(field):
        return inspect.Parameter.empty if field.default is MISSING else field.default

    def wrap(command: Callable[[Any], int]) -> Callable[..., int]:
        def run(**given) -> int:
            return command(arguments(**given))

        found: Any = run
        kind, shown = inspect.Parameter.KEYWORD_ONLY, fields_of(arguments)
        found.__signature__ = inspect.Signature(
            [inspect.Parameter(f.name, kind, default=default(f), annotation=f.type) for f in shown]
        )
        found.__annotations__ = {f.name: f.type for f in shown}
        found.__doc__, found.__name__ = command.__doc__, command.__name__
        found.command, arguments.home = command, (command.__module__, command.__name__)  # type: ignore[attr-defined]
        return found

    return wrap
