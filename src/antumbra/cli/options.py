"""Options that several commands share, and a decorator for commands that take all options as one object."""

import inspect
from collections.abc import Callable
from dataclasses import MISSING, fields
from enum import StrEnum
from typing import Annotated, Any

import typer


class Up(StrEnum):
    y = "y"
    z = "z"


class GBufferBy(StrEnum):
    auto = "auto"
    raster = "raster"
    rays = "rays"


class CullFaces(StrEnum):
    none = "none"
    front = "front"
    back = "back"

    @property
    def side(self) -> str | None:
        """The value that `antumbra.render` takes."""
        return None if self is CullFaces.none else self.value


UpOption = Annotated[
    Up | None,
    typer.Option(
        help="Which axis of the file points up.  [default: z for CityJSON, and if floors and roofs face z; else y]",
        show_default=False,
    ),
]
Json = Annotated[bool, typer.Option("--json", help="One JSON object on standard output, and nothing else there.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but errors.")]

Threads = Annotated[
    int | None, typer.Option(help="Threads to use.  [default: all cores]", min=1, max=1024, show_default=False)
]
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
TimeOption = Annotated[float, typer.Option("--time", help="Seconds into the animation.")]
SppOption = Annotated[int, typer.Option("--spp", help="Shadow rays for each pixel and light.", min=1, max=1024)]

SrdhRaysOption = Annotated[
    str | None,
    typer.Option(
        help="Shadow rays that the builder srdh is shown: of so many pixels across and down, or all; bounce: as many "
        "again after a diffuse bounce; last-frame: those of the frame before.  [default: 16]",
        metavar="N|all[,bounce][,last-frame]",
        show_default=False,
    ),
]

MaxMemoryOption = Annotated[
    str | None,
    typer.Option(
        help="Memory for a scene in a store, in bytes, or with M or G: 512M.  [default: 4G]",
        metavar="SIZE",
        show_default=False,
    ),
]

SCENE_HELP = (
    "A .glb, .gltf, .obj, .ply or .stl file, a CityJSON file (FILE or FILE?lod=N), a folder of vertex frames, "
    "or procedural:NAME?triangles=N&seed=N. FILE?cutouts=off closes the holes that alpha cuts."
)


def takes(arguments: type) -> Callable:
    """Decorator of a command ``f(arguments)``. Typer sees each field of the dataclass `arguments` as a parameter.

    A field without a default is a required one.
    """

    def default(field):
        return inspect.Parameter.empty if field.default is MISSING else field.default

    def wrap(command: Callable[[Any], int]) -> Callable[..., int]:
        def run(**given) -> int:
            return command(arguments(**given))

        found: Any = run
        kind = inspect.Parameter.KEYWORD_ONLY
        found.__signature__ = inspect.Signature(
            [inspect.Parameter(f.name, kind, default=default(f), annotation=f.type) for f in fields(arguments)]
        )
        found.__annotations__ = {f.name: f.type for f in fields(arguments)}
        found.__doc__, found.__name__ = command.__doc__, command.__name__
        found.command, arguments.home = command, (command.__module__, command.__name__)  # type: ignore[attr-defined]
        return found

    return wrap
