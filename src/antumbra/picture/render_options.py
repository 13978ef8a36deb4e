"""`RenderOptions` and `EngineOptions`: the only definition of a picture's options.

`antumbra.render` and `Renderer.render` take the fields as keywords. CLI options, the records of ``--json``, docstrings,
and the digests of finished frames, bands and data sets are derived from the same fields.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..checks import choice, flag, instance, number
from ..query.light_samples import SAMPLERS
from ..scene.lights import MAX_SPP
from .option_fields import (
    CommandOption,
    Option,
    RealNumber,
    WholeNumber,
    check_fields,
    describe_fields,
    optional_flag,
    unchecked,
)

if TYPE_CHECKING:
    from ..engine.plan import Plan

MAX_HEIGHT = 1e30
"""Of a ground, up or down: float32 holds it, as it does positions of cameras."""


class CullFaces(StrEnum):
    """`RenderOptions.cull_faces` on the command line."""

    none = "none"
    front = "front"
    back = "back"

    @property
    def side(self) -> str | None:
        """The value of the option."""
        return None if self is CullFaces.none else self.value


class GBufferBy(StrEnum):
    """`EngineOptions.gbuffer` on the command line."""

    auto = "auto"
    raster = "raster"
    rays = "rays"


def _sampler(value, what: str) -> str:
    return choice(value, what, SAMPLERS)


def _side(value, what: str) -> str | None:
    return choice(value, what, (None, "front", "back"))


def _ground(value, what: str) -> bool | float:
    if value is None or isinstance(value, (bool, np.bool_)):
        return bool(value)
    return number(value, f"{what} (height)", -MAX_HEIGHT, MAX_HEIGHT)


@describe_fields
@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """The options of a picture, checked and immutable.

    `render` and `Renderer.render` take them as keywords, or together as ``options``. Then keywords beside them replace
    single ones.

    Parameters
    ----------

    Raises
    ------
    InputError
        If a value is out of range.
    """

    spp: Annotated[
        int,
        Option(
            WholeNumber(1, MAX_SPP),
            "int",
            """Shadow rays per pixel and light, 1 to 1024. `PointLights`, and `AmbientOcclusion` with its own spp,
            ignore it.""",
            (CommandOption("Shadow rays for each pixel and light.", start=None, note="16"),),
        ),
    ] = 16
    time: Annotated[
        float,
        Option(
            RealNumber(-np.inf, np.inf, "[]", "seconds"),
            "float",
            "Seconds, clamped to [0, scene.duration].",
            (CommandOption("Seconds into the animation.", "Scene", start=None, note="0", literal=False),),
        ),
    ] = 0.0
    counters: Annotated[
        bool,
        Option(
            flag,
            "bool",
            "Count tests and nodes exactly (costs a little time).",
            (CommandOption("Count rays, nodes and tests exactly.", "Output", commands=("render",)),),
            decides=False,
        ),
    ] = False
    sampler: Annotated[
        str,
        Option(
            _sampler,
            "str",
            "A name in `antumbra.query.light_samples.SAMPLERS`.",
            (
                CommandOption(
                    "Points on the light: larcher-pillichshammer, hammersley, sobol or halton[:0|:18|:36|:full].",
                    metavar="NAME",
                ),
            ),
        ),
    ] = "larcher-pillichshammer"
    cull_faces: Annotated[
        str | None,
        Option(
            _side,
            'None, "front" or "back"',
            "Triangles whose given side faces the receiver do not block its rays.",
            (
                CommandOption(
                    "The side of triangles that, seen from a receiver, blocks no shadow ray.",
                    kind=CullFaces,
                    start=CullFaces.none,
                ),
            ),
        ),
    ] = None
    filter: Annotated[
        bool | None,
        Option(
            optional_flag,
            "bool or None",
            """Smooth the visibility, but not the bits, over 4 x 4 pixels of the same surface. In wide penumbrae each
            pixel then uses 16 times as many samples of the light. For interleaved lists of lights the irradiance is
            smoothed. None: only the irradiance of a `Sky` is smoothed.""",
            (CommandOption("Smooth noise in penumbrae over 4x4 pixels.", note="filter"),),
        ),
    ] = None
    antialias: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Smooth the edges of surfaces in the image, its coverage and the light of its layers, at next to no cost:
            pixels at an edge are mixed with their neighbours across it, by the shape of the edge. No ray is traced, and
            neither bits, visibility nor G-buffer change. `adaptive` smooths edges better, and replaces it. If False,
            each pixel shows what its centre sees.""",
            (
                CommandOption(
                    "Smooth edges of surfaces by their shape; --adaptive looks at them more closely.",
                    commands=("render",),
                ),
            ),
        ),
    ] = True
    adaptive: Annotated[
        int | None,
        Option(
            WholeNumber(1, MAX_SPP, optional=True),
            "int or None",
            """Refine with this many shadow rays per pixel and light, 1 to 1024; None: no refinement. In penumbrae the
            new visibility replaces the old one. At edges the rays are divided among 16 sub-pixels, and the image pixel
            is their mean. Lights with their own numbers of rays keep them, in each sub-pixel too.""",
            (
                CommandOption(
                    "Refine penumbrae with more rays, and edges by sub-pixels.",
                    kind=bool | None,
                    note="no-adaptive",
                    literal=False,
                ),
                CommandOption(
                    "Shadow rays for each refined pixel and light; implies --adaptive.",
                    note="4 times --spp",
                    name="adaptive_spp",
                    literal=False,
                ),
            ),
        ),
    ] = None
    bounce: Annotated[
        int | None,
        Option(
            WholeNumber(1, MAX_SPP, optional=True),
            "int or None",
            """Replace ambient light by light that bounces once: this many diffuse rays per pixel, 1 to 1024. Each
            diffuse ray has a shadow ray to each light from its end. `sampler` distributes the diffuse rays too.""",
            (
                CommandOption(
                    "Instead of ambient light, light that bounces once: so many diffuse rays from each pixel.",
                    "Light",
                    metavar="RAYS",
                ),
            ),
        ),
    ] = None
    background: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Whether pixels that see no surface show the skies among the lights. Without a sky, they are black in the
            image, and a PNG shows a soft daylight there, which sheds no light. If False, they are black.""",
            (
                CommandOption(
                    "What a .png shows where there is no surface: a colour, or transparent.",
                    "Scene",
                    kind=str | None,
                    start=None,
                    note="the sky",
                    metavar="COLOUR|transparent",
                    commands=("render",),
                    literal=False,
                ),
            ),
        ),
    ] = True
    layers: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Keep base colours, the image of each light alone, and objects in `Frame.layers`; EXR files then have
            them.""",
            decides=False,
        ),
    ] = False
    textures: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Show textures and colours of vertices. If not, each face has its mean colour, `Scene.colours`.""",
            (
                CommandOption(
                    "Show textures and colours of vertices, not the mean colour of each face.", commands=("render",)
                ),
            ),
        ),
    ] = True
    smooth_normals: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Shade with the normals of vertices, if the scene has them. If not, each face has its own. Neither changes
            the bits or the visibility: shadows stay on the geometric surface.""",
            (CommandOption("Shade with the normals of vertices, not with those of faces.", commands=("render",)),),
        ),
    ] = True
    ground: Annotated[
        bool | float,
        Option(
            _ground,
            "bool or float",
            """A level ground below the scene, of which only the shadows are seen. True: just under the lowest point of
            this moment; a number: at this height along the scene's up axis, in world units (see `Scene.ground_height`).
            Pixels that see it show what is behind, times the light that arrives over the light that would without
            shadows. `Frame.ground` has its visibility. It blocks no ray, changes no other pixel and is not in
            `Frame.mask`. It is not seen from below, and a store has none.""",
            (
                CommandOption(
                    "A ground below the scene, of which only the shadows are seen: on, off, a height, or auto: under "
                    "scenes seen from outside that have none.",
                    "Scene",
                    kind=str,
                    start="auto",
                    metavar="auto|on|off|HEIGHT",
                    commands=("render",),
                    literal=False,
                ),
            ),
        ),
    ] = False

    def __post_init__(self):
        check_fields(self)

    @property
    def smooths_edges(self) -> bool:
        """Whether edges are smoothed without another ray. Finer samples divide them instead."""
        return self.antialias and self.adaptive is None


def options_of(options: RenderOptions | None, keywords: dict[str, Any]) -> RenderOptions:
    """The options of a call: its argument ``options``, and its keywords, which replace single ones."""
    if options is None:
        return RenderOptions(**keywords)
    return replace(instance(options, RenderOptions, "options"), **keywords)


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """How questions are answered: the keywords of `Renderer`, which checks them. Exact plans change no bit."""

    plan: Annotated[
        "str | Plan | None",
        Option(
            unchecked,
            "str, Plan or None",
            """The methods, such as ``"bsah+single"`` (see ``antumbra plans``). A plan never changes the bits, unless it
            neglects geometry that few rays see (``"bsah+chcrt:20"``). None: ``"auto"``, which chooses the methods; for
            a store ``"bsah+chcrt"``.""",
            (
                CommandOption(
                    "The methods that answer; see antumbra plans.",
                    "Speed",
                    kind=str | None,
                    note="auto; of a store bsah+chcrt",
                    commands=("render",),
                ),
            ),
        ),
    ] = None
    threads: Annotated[
        int | None,
        Option(
            WholeNumber(1, 1024, optional=True),
            "int or None",
            "None: all cores.",
            (CommandOption("Threads to use.", "Speed", note="all cores"),),
        ),
    ] = None
    gbuffer: Annotated[
        str,
        Option(
            unchecked,
            '"raster", "rays" or "auto"',
            "The method of primary visibility, as for `Renderer`. It never changes the bits.",
            (
                CommandOption(
                    "The method that finds visible surfaces.",
                    "Speed",
                    kind=GBufferBy,
                    start=GBufferBy.auto,
                ),
            ),
        ),
    ] = "auto"
    max_memory: Annotated[
        int | None,
        Option(
            unchecked,
            "int or None",
            "Limit in bytes on the memory of the process, for a scene in a store; None: 4 GiB.",
            (
                CommandOption(
                    "Memory for a scene in a store, in bytes, or with M or G: 512M.",
                    "Speed",
                    kind=str | None,
                    note="4G",
                    metavar="SIZE",
                    literal=False,
                ),
            ),
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class RenderKeywords(EngineOptions, RenderOptions):
    """All keywords of `antumbra.render`: signatures are made of them."""
