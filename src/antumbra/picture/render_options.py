"""`RenderOptions` and `EngineOptions`: the single definition of all rendering options.

`antumbra.render` and `Renderer.render` take the fields as keywords. CLI options, the records of ``--json``, docstrings,
and the digests of finished frames, bands and data sets are derived from the same fields.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from ..checks import checked_instance, choice, flag, number
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
"""Limit of a ground's height, up or down. As for camera positions, float32 can represent it."""


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


def _sampler(value: Any, what: str) -> str:
    name: str = choice(value, what, SAMPLERS)
    return name


def _side(value: Any, what: str) -> str | None:
    side: str | None = choice(value, what, (None, "front", "back"))
    return side


def _ground(value: Any, what: str) -> bool | float:
    if value is None or isinstance(value, (bool, np.bool_)):
        return bool(value)
    return number(value, f"{what} (height)", -MAX_HEIGHT, MAX_HEIGHT)


@describe_fields
@dataclass(frozen=True, kw_only=True)
class RenderOptions:
    """The options of a picture, checked and immutable.

    `render` and `Renderer.render` take them as keywords, or together as ``options``; further keywords then replace
    single fields.

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
            """Shadow rays per pixel and light, 1 to 1024. `PointLights`, and an `AmbientOcclusion` with its own spp,
            ignore it.""",
            (CommandOption("Shadow rays per pixel and light.", start=None, note="16"),),
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
            "Count rays, nodes and tests exactly (slightly slower).",
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
                    "Light samples: larcher-pillichshammer, hammersley, sobol or halton[:0|:18|:36|:full].",
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
            "Triangles that face the receiver with this side do not block its rays.",
            (
                CommandOption(
                    "Ignore triangles that face the receiver with this side.",
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
            """Smooth the visibility, but not the bits, over 4 x 4 pixels of the same surface, so that pixels in wide
            penumbrae use 16 times as many samples of the light. For interleaved lists of lights, smooth the irradiance.
            None: smooth only the irradiance of a `Sky`.""",
            (CommandOption("Smooth noise in penumbrae over 4x4 pixels.", note="filter"),),
        ),
    ] = None
    antialias: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Smooth the edges of surfaces in the image, its coverage and the light of its layers at almost no cost:
            mix pixels at an edge with their neighbours across it, according to the shape of the edge. No ray is traced,
            and bits, visibility and G-buffer do not change. `adaptive` smooths edges better, and replaces it. If False,
            each pixel shows what its centre sees.""",
            (
                CommandOption(
                    "Smooth edges of surfaces by their shape; --adaptive smooths them better, with more rays.",
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
            refined visibility replaces the original. At edges, the rays are divided among 16 sub-pixels, whose mean is
            the pixel of the image. Lights with their own number of rays keep it, in each sub-pixel too.""",
            (
                CommandOption(
                    "Refine penumbrae with more rays, and edges by sub-pixels.",
                    kind=bool | None,
                    note="no-adaptive",
                    literal=False,
                ),
                CommandOption(
                    "Shadow rays per refined pixel and light; implies --adaptive.",
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
            """Replace ambient light by light that bounces once: number of diffuse rays per pixel, 1 to 1024. From the
            hit of each diffuse ray, one shadow ray goes to each light. `sampler` also distributes the diffuse rays.""",
            (
                CommandOption(
                    "Replace ambient light by light that bounces once, with this number of diffuse rays per pixel.",
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
            """Whether pixels that see no surface show the skies among the lights. Without a sky they are black in the
            image, but a PNG shows soft daylight there, which lights nothing. If False, they are always black.""",
            (
                CommandOption(
                    "Background of a .png: a colour, or transparent.",
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
            """Keep base colours, the image of each light alone, and objects in `Frame.layers` and in EXR files.""",
            decides=False,
        ),
    ] = False
    textures: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Show textures and vertex colours. If False, each face has its mean colour, see `Scene.colours`.""",
            (
                CommandOption(
                    "Show textures and vertex colours instead of the mean colour of each face.", commands=("render",)
                ),
            ),
        ),
    ] = True
    smooth_normals: Annotated[
        bool,
        Option(
            flag,
            "bool",
            """Shade with vertex normals, if the scene has them. If False, shade with face normals. Bits and visibility
            stay the same: shadows are those of the geometric surface.""",
            (CommandOption("Shade with vertex normals instead of face normals.", commands=("render",)),),
        ),
    ] = True
    ground: Annotated[
        bool | float,
        Option(
            _ground,
            "bool or float",
            """Add a shadow-catcher plane: a horizontal plane below the scene that shows only shadows. True: just below
            the lowest point at this time (see `Scene.ground_height`); a number: at this height along the scene's up
            axis, in world units. Pixels that see the plane show the background times the ratio of the light that
            arrives to the light that would arrive without shadows. `Frame.ground` has its visibility. The plane blocks
            no ray, changes no other pixel and is not in `Frame.mask`. It is invisible from below. Not available for a
            store.""",
            (
                CommandOption(
                    "Shadow-catcher plane below the scene: on, off, a height, or auto, which adds it to scenes without "
                    "a ground that are seen from outside.",
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

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def smooths_edges(self) -> bool:
        """Whether to smooth edges without tracing rays; `adaptive` refines them instead."""
        return self.antialias and self.adaptive is None


def options_of(options: RenderOptions | None, keywords: dict[str, Any]) -> RenderOptions:
    """The options of a call: its argument ``options``, with single fields replaced by its keywords."""
    if options is None:
        return RenderOptions(**keywords)
    return replace(checked_instance(options, RenderOptions, "options"), **keywords)


@dataclass(frozen=True, kw_only=True)
class EngineOptions:
    """The keywords of `Renderer`, which checks them: methods and resources. Exact plans change no bit."""

    plan: Annotated[
        "str | Plan | None",
        Option(
            unchecked,
            "str, Plan or None",
            """The methods, such as ``"bsah+single"`` (see ``antumbra plans``). A plan never changes the bits, unless it
            neglects geometry that few rays see, such as ``"bsah+chcrt:20"``. None: ``"auto"``, which chooses the
            methods; ``"bsah+chcrt"`` for a store.""",
            (
                CommandOption(
                    "The methods of building and tracing; see antumbra plans.",
                    "Speed",
                    kind=str | None,
                    note="auto; bsah+chcrt for a store",
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
            "The method of primary visibility, see `Renderer`. It never changes the bits.",
            (
                CommandOption(
                    "The method of primary visibility.",
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
            "Limit in bytes on the memory of the process, for scenes in a store; None: 4 GiB.",
            (
                CommandOption(
                    "Memory limit for scenes in a store: in bytes, or with M or G, such as 512M.",
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
    """All keywords of `antumbra.render`, for its signature."""
