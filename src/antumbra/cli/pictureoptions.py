"""Options of a picture, which ``render`` and ``compare`` share."""

from enum import StrEnum
from typing import Annotated, NamedTuple

import typer

from .options import CullFaces, GBufferBy

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
BounceOption = Annotated[
    int | None,
    typer.Option(
        help="Instead of ambient light, light that bounces once: so many diffuse rays from each pixel.",
        min=1,
        max=1024,
        metavar="RAYS",
        show_default=False,
    ),
]
SamplerOption = Annotated[
    str,
    typer.Option(
        help="Points on the light: larcher-pillichshammer, hammersley, sobol or halton[:0|:18|:36|:full].",
        metavar="NAME",
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
BackgroundOption = Annotated[
    str | None,
    typer.Option(
        help="What a .png shows where there is no surface: a colour, or transparent.  [default: the sky]",
        metavar="COLOUR|transparent",
        show_default=False,
    ),
]
GroundOption = Annotated[
    str,
    typer.Option(
        help="A ground below the scene, of which only the shadows are seen: on, off, a height, or auto: under scenes "
        "seen from outside that have none.",
        metavar="auto|on|off|HEIGHT",
    ),
]
PresetSppOption = Annotated[
    int | None,
    typer.Option(
        "--spp", help="Shadow rays for each pixel and light.  [default: 16]", min=1, max=1024, show_default=False
    ),
]
FilterOption = Annotated[
    bool | None,
    typer.Option(
        "--filter/--no-filter", help="Smooth noise in penumbrae over 4x4 pixels.  [default: filter]", show_default=False
    ),
]
AntialiasOption = Annotated[
    bool,
    typer.Option(
        "--antialias/--no-antialias",
        help="Smooth edges of surfaces by their shape; --adaptive looks at them more closely.",
    ),
]
AdaptiveOption = Annotated[
    bool | None,
    typer.Option(
        "--adaptive/--no-adaptive",
        help="Refine penumbrae with more rays, and edges by sub-pixels.  [default: no-adaptive]",
        show_default=False,
    ),
]
AdaptiveSppOption = Annotated[
    int | None,
    typer.Option(
        help="Shadow rays for each refined pixel and light; implies --adaptive.  [default: 4 times --spp]",
        min=1,
        max=1024,
        show_default=False,
    ),
]
CullFacesOption = Annotated[
    CullFaces, typer.Option(help="The side of triangles that, seen from a receiver, blocks no shadow ray.")
]
GBufferOption = Annotated[GBufferBy, typer.Option(help="The method that finds visible surfaces.")]
ExposureOption = Annotated[
    float | None,
    typer.Option(help="Factor on the light of a .png.  [default: automatic]", show_default=False),
]
TexturesOption = Annotated[
    bool,
    typer.Option(
        "--textures/--no-textures", help="Show textures and colours of vertices, not the mean colour of each face."
    ),
]
SmoothNormalsOption = Annotated[
    bool,
    typer.Option(
        "--smooth-normals/--no-smooth-normals", help="Shade with the normals of vertices, not with those of faces."
    ),
]
