"""`RenderOptions` and `EngineOptions`: the single definition of all rendering options.

`antumbra.render` and `Renderer.render` take the fields as keywords. CLI options, the records of ``--json``, docstrings,
and the digests of finished frames, bands and data sets are derived from the same fields.
"""

from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any

import numpy as np

from ..base.checks import checked_instance, flag, number, quoted
from ..base.errors import InputError
from ..base.option_fields import (
    Choice,
    CommandOption,
    RealNumber,
    WholeNumber,
    check_fields,
    describe_fields,
    option,
    optional,
    unchecked,
)
from ..engine.plan import Plan, known_plan
from ..query.light_samples import SAMPLERS
from ..query.ray_passes import MAX_BOUNCES
from ..scene.lights import MAX_SPP

BOUNCE_STEPS = 1, 2, 4, 8
"""The values of `RenderOptions.bounce_step`."""

MAX_HEIGHT = 1e30
"""Limit of a ground's height, up or down. As for camera positions, float32 can represent it."""


DIFFUSE, PBR = "diffuse", "pbr"
"""The values of `RenderOptions.materials`."""


class Materials(StrEnum):
    """`RenderOptions.materials` on the command line."""

    pbr = PBR
    diffuse = DIFFUSE


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


def _ground(value: Any, what: str) -> bool | float:
    if value is None or isinstance(value, (bool, np.bool_)):
        return bool(value)
    return number(value, f"{what} (height)", -MAX_HEIGHT, MAX_HEIGHT)


def _bounce_step(value: Any, what: str) -> int:
    """The check of `RenderOptions.bounce_step`: bands of a picture must begin at rows of the grid, in the same set."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value not in BOUNCE_STEPS:
        raise InputError(f"{what} is {quoted(value)}; it must be 1, 2, 4 or 8")
    return int(value)


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

    spp: int = option(
        16, WholeNumber(1, MAX_SPP), "Shadow rays per pixel and light.", panel="Quality", start=None, note="16"
    )
    """Shadow rays per pixel and light, 1 to 1024. `PointLights`, and an `AmbientOcclusion` with its own spp, ignore
    it."""
    time: float = option(
        0.0,
        RealNumber(-np.inf, np.inf, "[]", "seconds"),
        "Seconds into the animation.",
        panel="Scene",
        start=None,
        note="0",
    )
    """Seconds, clamped to [0, scene.duration]."""
    counters: bool = option(
        False, flag, "Count rays, nodes and tests exactly.", panel="Output", commands=("render",), decides=False
    )
    """Count rays, nodes and tests exactly (slightly slower)."""
    sampler: str = option(
        "larcher-pillichshammer",
        Choice(tuple(SAMPLERS)),
        "Light samples: larcher-pillichshammer, hammersley, sobol or halton[:0|:18|:36|:full].",
        panel="Quality",
        kind=str,
        metavar="NAME",
        doc_type="str",
    )
    """How samples are distributed over a light: "larcher-pillichshammer", "hammersley", "sobol", "halton", "halton:0",
    "halton:18", "halton:36" or "halton:full". Halton sets suit numbers of samples that are not powers of two."""
    seed: int = option(
        0,
        WholeNumber(0, 2**63 - 1),
        "Draw other light samples; the mean of frames with different seeds converges.",
        panel="Quality",
        start=None,
        note="0",
        hides_limit=True,
    )
    """Draw other samples of the lights, of diffuse rays and of skies. Equal seeds give equal bits. The mean of frames
    with different seeds converges to the exact penumbrae; surfaces and edges are the same in all of them."""
    cull_faces: str | None = option(
        None,
        Choice((None, "front", "back")),
        "Ignore triangles that face the receiver with this side.",
        panel="Quality",
        kind=CullFaces,
        start=CullFaces.none,
    )
    """Triangles that face the receiver with this side do not block its rays."""
    filter: bool | None = option(
        None, optional(flag), "Smooth noise in penumbrae over 4x4 pixels.", panel="Quality", note="filter"
    )
    """Smooth the visibility, but not the bits, over 4 x 4 pixels of the same surface, so that pixels in wide penumbrae
    use 16 times as many samples of the light. For interleaved lists of lights, smooth the irradiance. None: smooth only
    the irradiance of a `Sky`."""
    antialias: bool = option(
        True,
        flag,
        "Smooth edges of surfaces by their shape; --adaptive smooths them better, with more rays.",
        panel="Quality",
        commands=("render",),
    )
    """Smooth the edges of surfaces in the image, its coverage and the light of its layers at almost no cost: mix pixels
    at an edge with their neighbours across it, according to the shape of the edge. No ray is traced, and bits,
    visibility and G-buffer do not change. `adaptive` smooths edges better, and replaces it. If False, each pixel shows
    what its centre sees."""
    adaptive: int | None = option(
        None,
        WholeNumber(1, MAX_SPP, optional=True),
        "Refine penumbrae with more rays, and edges by sub-pixels.",
        panel="Quality",
        kind=bool | None,
        note="no-adaptive",
        is_value=False,
        more=(
            CommandOption(
                "Shadow rays per refined pixel and light; implies --adaptive.",
                "Quality",
                note="4 times --spp",
                name="adaptive_spp",
                is_value=False,
            ),
        ),
    )
    """Refine with this many shadow rays per pixel and light, 1 to 1024; None: no refinement. In penumbrae the refined
    visibility replaces the original. At edges, the rays are divided among 16 sub-pixels, whose mean is the pixel of the
    image. Lights with their own number of rays keep it, in each sub-pixel too."""
    bounce: int | None = option(
        None,
        WholeNumber(1, MAX_SPP, optional=True),
        "Bounced light from RAYS diffuse rays per pixel. It replaces ambient light.",
        panel="Light",
        metavar="RAYS",
    )
    """Replace ambient light by light that bounces once: number of diffuse rays per pixel, 1 to 1024. From the hit of
    each diffuse ray, one shadow ray goes to each light. `sampler` also distributes the diffuse rays."""
    bounces: int = option(
        1,
        WholeNumber(1, MAX_BOUNCES),
        "Follow each ray of --bounce to N surfaces.",
        panel="Light",
        start=None,
        note="1",
        metavar="N",
    )
    """Surfaces that light meets on its way, 1 to 64: each diffuse ray of `bounce` goes on as a path of this number of
    rays."""
    bounce_step: int = option(
        1,
        _bounce_step,
        "Trace bounced light at one of N x N pixels, and interpolate the others; N is 1, 2, 4 or 8.",
        panel="Light",
        kind=int,
        start=None,
        note="1",
        metavar="N",
    )
    """Trace the diffuse rays of `bounce` at every n-th pixel of every n-th row only: 1, 2, 4 or 8. The others take the
    mean of the grid pixels around them that see the same surface. With n = 4, 16 times as many rays cost the same."""
    ambient: bool = option(
        True, flag, "Add a little ambient light. It stands in for bounced light.", panel="Light", commands=("render",)
    )
    """Add ambient light to the image: 12 % of the mean direct light of the visible surfaces, less on surfaces that face
    sideways. It stands for light that bounces; `bounce` replaces it. If False, the image holds direct light alone, so
    that values can be compared with those of other programs."""
    background: bool = option(
        True,
        flag,
        "Background of a .png: a colour, or transparent.",
        panel="Scene",
        kind=str | None,
        start=None,
        note="the sky",
        metavar="COLOUR|transparent",
        commands=("render",),
        is_value=False,
    )
    """Whether pixels that see no surface show the skies among the lights. Without a sky they are black in the image,
    but a PNG shows soft daylight there, which lights nothing. If False, they are always black."""
    layers: bool = option(False, flag, decides=False)
    """Keep base colours, the image of each light alone, and objects in `Frame.layers` and in EXR files."""
    textures: bool = option(
        True,
        flag,
        "Show textures and vertex colours instead of the mean colour of each face.",
        panel="Quality",
        commands=("render",),
    )
    """Show textures and vertex colours. If False, each face has its mean colour, see `Scene.colours`."""
    materials: str = option(
        PBR,
        Choice((PBR, DIFFUSE)),
        "Show metalness, roughness, normal maps, occlusion maps and emission; or base colours only.",
        panel="Quality",
        kind=Materials,
        start=Materials.pbr,
        commands=("render",),
        doc_type='"pbr" or "diffuse"',
    )
    """Show the materials of the file by the metallic-roughness model of glTF, see docs/design/shading.md: a GGX lobe
    for lights and the mirrored sky, normal maps, occlusion maps and emission. ``"diffuse"``: base colours only, the
    reference for radiometry. Bits, visibility and bounced light are always those of diffuse surfaces, and so are all
    measured quantities and bakes."""
    smooth_normals: bool = option(
        True, flag, "Shade with vertex normals instead of face normals.", panel="Quality", commands=("render",)
    )
    """Shade with vertex normals, if the scene has them. If False, shade with face normals. Bits and visibility stay the
    same: shadows are those of the geometric surface."""
    ground: bool | float = option(
        False,
        _ground,
        "Shadow-catcher plane below the scene: on, off, a height, or auto, which adds it to scenes without "
        "a ground that are seen from outside.",
        panel="Scene",
        kind=str,
        start="auto",
        metavar="auto|on|off|HEIGHT",
        commands=("render",),
        is_value=False,
    )
    """Add a shadow-catcher plane: a horizontal plane below the scene that shows only shadows. True: just below the
    lowest point at this time (see `Scene.ground_height`); a number: at this height along the scene's up axis, in world
    units. Pixels that see the plane show the background times the ratio of the light that arrives to the light that
    would arrive without shadows. `Frame.ground` has its visibility. The plane blocks no ray, changes no other pixel and
    is not in `Frame.mask`. It is invisible from below."""

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

    plan: str | Plan | None = option(
        None,
        known_plan,
        "The methods of building and tracing; see antumbra plans.",
        panel="Speed",
        kind=str | None,
        note="auto; bsah+chcrt for a store",
        commands=("render",),
    )
    """The methods, such as ``"bsah+single"`` (see ``antumbra plans``). A plan never changes the bits, unless it
    neglects geometry that few rays see, such as ``"bsah+chcrt:20"``. None: ``"auto"``, which chooses the methods;
    ``"bsah+chcrt"`` for a store."""
    threads: int | None = option(
        None, WholeNumber(1, 1024, optional=True), "Threads to use.", panel="Speed", note="all cores"
    )
    """None: all cores."""
    gbuffer: str = option(
        "auto",
        unchecked,
        "The method of primary visibility.",
        panel="Speed",
        kind=GBufferBy,
        start=GBufferBy.auto,
        doc_type='"raster", "rays" or "auto"',
    )
    """The method of primary visibility, see `Renderer`. It never changes the bits."""
    max_memory: int | None = option(
        None,
        unchecked,
        "Memory limit of reading files, of scenes in a store, and on a device: in bytes, or with M or G, such as 512M.",
        panel="Speed",
        kind=str | None,
        note="what is available; 4G for stores",
        metavar="SIZE",
        is_value=False,
    )
    """Limit in bytes on the memory of the process, for a store (None: see `PagedScene.max_memory`), or on a device."""
    device: str | None = option(
        None,
        unchecked,
        "The device that traces shadow rays: cuda, cuda:1, opencl, or cpu; see antumbra doctor.",
        panel="Speed",
        kind=str | None,
        note="ANTUMBRA_DEVICE, or cpu",
        metavar="NAME",
        commands=("render",),
    )
    """The device that traces shadow rays, such as ``"cuda"``, ``"cuda:1"`` or ``"opencl"``; ``"cpu"``: none. It never
    changes the bits. None: the one in the environment variable ``ANTUMBRA_DEVICE``, if no plan is given."""


@dataclass(frozen=True, kw_only=True)
class RenderKeywords(EngineOptions, RenderOptions):
    """All keywords of `antumbra.render`, for its signature."""
