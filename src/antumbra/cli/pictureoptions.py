"""Options of a picture, which ``render`` and ``compare`` share."""

from typing import Annotated

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
        help="Instead of ambient light, light that bounces once: photons of the first light become point lights.",
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
FilterOption = Annotated[bool, typer.Option("--filter", help="Smooth noise in penumbrae over 4x4 pixels.")]
AdaptiveOption = Annotated[
    bool, typer.Option("--adaptive", help="Refine penumbrae with more rays, and edges by sub-pixels.")
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
