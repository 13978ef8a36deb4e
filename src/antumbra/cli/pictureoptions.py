"""Options of a picture, which ``render`` and ``compare`` share."""

from enum import StrEnum
from typing import Annotated, NamedTuple

import typer

PictureLightOption = Annotated[
    list[str] | None,
    typer.Option(
        "--light", help="An index, or KIND:...[@INTENSITY]; may be repeated.", metavar="LIGHT", show_default=False
    ),
]
AoOption = Annotated[
    str | None,
    typer.Option(
        help="Ambient occlusion by what is nearer than RADIUS (inf: by everything), besides the lights.",
        metavar="RADIUS[@INTENSITY]",
        show_default=False,
    ),
]
VplOption = Annotated[
    int | None,
    typer.Option(
        help="Instead of ambient light, light that bounces once: photons of the first light and of a sky become point "
        "lights.",
        min=1,
        max=16384,
        metavar="PHOTONS",
        show_default=False,
    ),
]


class Preset(StrEnum):
    draft = "draft"
    standard = "standard"
    final = "final"


class Quality(NamedTuple):
    """The values of a preset."""

    spp: int
    filter: bool
    adaptive: bool


QUALITIES = {
    Preset.draft: Quality(4, True, False),
    Preset.standard: Quality(16, True, False),
    Preset.final: Quality(64, True, True),
}

PresetOption = Annotated[
    Preset,
    typer.Option(help="draft: 4 rays; standard: 16; final: 64, and adaptive. Other options override it."),
]
SkyOption = Annotated[
    str | None,
    typer.Option(
        help="Light from everywhere: a colour, a map in a .hdr or .exr file, or none.  "
        "[default: daylight, if there are no other lights or the file has a sun]",
        metavar="COLOUR|FILE|none",
        show_default=False,
    ),
]
ExposureOption = Annotated[
    float | None,
    typer.Option(help="Factor on the light of a .png.  [default: automatic]", show_default=False),
]
