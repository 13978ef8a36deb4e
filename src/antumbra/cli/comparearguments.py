"""The command-line arguments of ``antumbra compare``, and their conversion to options."""

import shlex
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Annotated, Any

import typer

from ..errors import InputError
from ..rendering.options import GBufferBy
from . import arguments
from .options import SCENE_HELP, CameraOption, Json, Quiet, SrdhRaysOption, UpOption, fields_of
from .outputs import writes
from .pictureoptions import AoOption, ExposureOption, PictureLightOption, Preset, PresetOption, SkyOption, VplOption
from .picturespec import PictureSpec
from .renderarguments import RenderArguments
from .written import arguments_of

_Options: Any = arguments_of("compare", gbuffer=GBufferBy.raster)


@dataclass(frozen=True)
class CompareArguments(_Options):
    """The arguments of the command line: each field is an argument or an option.

    The base class has those of `RenderOptions` and `EngineOptions`.
    """

    scene: Annotated[str, typer.Argument(help=SCENE_HELP, metavar="SCENE")] = arguments.DEFAULT_SCENE
    plan: Annotated[
        list[str] | None,
        typer.Option(
            help="A plan; given twice or more. See antumbra plans.",
            metavar="PLAN",
            show_default=False,
        ),
    ] = None
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", help="A .png file: picture and heat maps.", metavar="FILE", callback=writes(".png")
        ),
    ] = Path("compare.png")
    html: Annotated[
        Path | None,
        typer.Option(
            help="A page with everything, in one .html file.",
            metavar="FILE",
            show_default=False,
            callback=writes(".html", ".htm"),
        ),
    ] = None
    rounds: Annotated[int, typer.Option(help="Timed frames of each plan; the median counts.", min=1, max=1000)] = 5
    size: Annotated[str, typer.Option(help="Size of the picture in pixels.", metavar="WxH")] = "512x512"
    camera: CameraOption = None
    light: PictureLightOption = None
    sky: SkyOption = None
    ao: AoOption = None
    vpl: VplOption = None
    up: UpOption = None
    preset: PresetOption = Preset.standard
    srdh_rays: SrdhRaysOption = None
    exposure: ExposureOption = None
    json: Json = False
    quiet: Quiet = False

    def options(self) -> PictureSpec:
        """The options of the picture, checked against each other; they name no plan.

        Raises
        ------
        InputError
            If a text cannot be parsed, or options exclude each other.
        """
        if self.srdh_rays is not None and arguments.parse_srdh_rays(self.srdh_rays).last_frame:
            raise InputError("--srdh-rays last-frame belongs to animations; a comparison is of one picture")
        shared = {f.name for f in fields(self)} & {f.name for f in fields(RenderArguments)} - {"plan", "output"}
        of_picture = RenderArguments(**{name: getattr(self, name) for name in shared})
        of_picture.check()
        return of_picture.options()

    def command(self) -> str:
        """A command line with the same arguments, for a shell."""
        words = ["antumbra", "compare", self.scene]
        for field in fields_of(type(self)):
            value = getattr(self, field.name)
            if field.name != "scene" and value != field.default:
                words += _words("--" + field.name.replace("_", "-"), value)
        return shlex.join(words)


def _words(option: str, value: Any) -> list[str]:
    """An option with its value, or with each of its values, as words of a command line."""
    if value is True:
        return [option]
    if isinstance(value, list):
        return [word for one in value for word in _words(option, one)]
    text = str(value.value if isinstance(value, Enum) else value)
    return [f"{option}={text}"] if text.startswith("-") else [option, text]
