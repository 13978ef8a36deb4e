"""The options of a bake: the keywords of `antumbra.bake`, checked as far as possible without a scene."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.checks import flag, is_number, quoted, text
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.option_fields import (
    Choice,
    RealNumber,
    WholeNumber,
    check_fields,
    option,
    optional,
    same_option,
    unchecked,
)
from ..engine.plan import Plan
from ..picture.image_files import openexr
from ..picture.render_options import EngineOptions, RenderOptions
from ..query.ray_passes import MAX_BOUNCES
from ..scene.lights import MAX_SPP, AmbientOcclusion, DirectionalLight, Light, check_lights

MAX_TEXTURE = 16384
_SKY = ("ao", "bent-normal")  # quantities that depend on the sky instead of lights

QUANTITIES = {
    "ao": "the cosine-weighted visible share of the sky",
    "shadow": "the visible share of the lights",
    "sun": "the irradiance of the sun over its intensity",
    "light": "the irradiance of all lights, linear RGB",
    "bent-normal": "the mean unoccluded direction",
}
"""Name of a quantity that a bake measures -> its meaning."""


def _bits(value: Any, what: str) -> int:
    if not is_number(value) or value not in (8, 16):
        raise InputError(f"{what} is {quoted(value)}; a PNG has 8 or 16")
    return int(value)


def _exposure(value: Any, what: str) -> float | None:
    from ..picture.image_files import checked_exposure

    return None if value is None else checked_exposure(value)


@dataclass(frozen=True, kw_only=True)
class BakeQuantity:
    """The quantity that a bake measures."""

    what: str = option("ao", Choice(tuple(QUANTITIES)), "Quantity to bake.")
    """A name in `QUANTITIES`."""


@dataclass(frozen=True, kw_only=True)
class BakeKeywords:
    """The keywords of `antumbra.bake` that define the baked values."""

    attribute: str | None = option(
        None,
        optional(text),
        "Vertex attribute: COLOR_0, or a custom name such as _AO.",
        note="COLOR_0; for bent normals _BENT_NORMAL",
        metavar="NAME",
    )
    """Vertex attribute: ``COLOR_0``, or a name that begins with an underscore. None: ``COLOR_0``, or ``_BENT_NORMAL``
    for bent normals."""
    multiply: bool = option(False, flag, "Multiply COLOR_0 of the file. Without this, it is replaced.")
    """Multiply an existing ``COLOR_0`` instead of replacing it."""
    texture: int | None = option(
        None,
        WholeNumber(16, MAX_TEXTURE, optional=True),
        "Bake a square texture of SIZE texels per side. Without this, vertices get values.",
        kind=int | None,
        metavar="SIZE",
    )
    """Bake into a square texture with this many texels per side, 16 to 16384, instead of vertices."""
    uv: int | None = option(
        None,
        WholeNumber(0, 7, optional=True),
        "UV set of the file that the texture uses.",
        kind=int | None,
        note="a new atlas",
        metavar="SET",
    )
    """UV set of the file for the texture. None: a new atlas (needs ``antumbra[bake]``)."""
    bit_depth: int = option(8, _bits, "Bits per texture channel: 8 or 16.")
    """Bits per channel of the texture, 8 or 16."""
    png: bool = option(False, flag, "Also write the texture as .png next to FILE.")
    """Also write the texture as PNG beside `output`, as it is in the file."""
    exr: bool = option(False, flag, "Also write the texture as .exr next to FILE.")
    """Also write the texture as float32 beside `output`."""
    unlit: bool = option(False, flag, "Write light times base colours, in unlit materials.")
    """Multiply a texture of shadow, sun or light by the base colour texture, and replace that, in unlit materials. All
    viewers show such files, but textures that repeat or are finer lose detail. False: a lightmap, which leaves
    materials as they are."""
    denoise: bool = option(False, flag, "Smooth noise over 4x4 texels. For ao, shadow and light.")
    """Filter a texture of ao or shadow over 4 x 4 texels, within penumbrae and surfaces; of light, filter the
    sky and bounced light, several times."""
    radius: float | None = option(
        None,
        RealNumber(0.0, np.inf, "(]", optional=True),
        "For ao: greatest distance of occluders, in world units.",
        note="no limit",
    )
    """For ao and bent-normal: ignore blockers farther away than this, in world units. None: all count."""
    lights: Sequence[Light] | Light | None = option(None, unchecked, doc_type="lights or None")
    """For shadow, sun and light, in the scene's own coordinates, even if +Z is up. None:
    `Scene.default_lights`. `AmbientOcclusion` among the lights of ``light`` acts as a sky."""
    bounces: int = option(0, WholeNumber(0, MAX_BOUNCES), "For light: bounces of indirect light.", metavar="N")
    """For light: add light that bounces off up to this number of diffuse surfaces, 0 to 64, and light that surfaces
    emit. Each receiver traces `spp` paths, with a shadow ray to each light where they meet a surface."""
    exposure: float | None = option(
        None, _exposure, "Exposure factor; values are clipped at 1.", note="1; for light automatic"
    )
    """Factor on light before it is clipped at 1. None: automatic for ``light``, else 1."""
    spp: int = option(256, WholeNumber(1, MAX_SPP), "Rays per vertex or texel and light.")
    """Rays per receiver and light, 1 to 1024."""
    sampler: str = same_option(RenderOptions, "sampler", "hammersley")
    """As in `render`. On a hemisphere, ``hammersley`` has half the error of the default sampler of pictures."""
    seed: int = same_option(RenderOptions, "seed")
    keep_hidden: bool = option(False, flag, "Keep points inside solids dark.")
    """Keep the values of points inside solids. Otherwise those of visible points nearby replace them."""
    time: float = same_option(RenderOptions, "time")
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    threads: int | None = same_option(EngineOptions, "threads")


@dataclass(frozen=True, kw_only=True)
class BakeOptions(BakeKeywords, BakeQuantity):
    """All options of a bake, checked and immutable. Raises InputError."""

    def __post_init__(self) -> None:
        check_fields(self)
        self.measured_lights()
        if self.texture is not None:
            if self.attribute is not None or self.multiply:
                raise InputError("attribute and multiply belong to values at vertices; leave them or texture out")
            import_extra("scipy", "a texture", "bake")
            if self.uv is None:
                import_extra("xatlas", "an atlas (--texture without --uv)", "bake")
            if self.exr:
                openexr()
        elif self.uv is not None or self.png or self.exr or self.unlit or self.denoise or self.bit_depth != 8:
            raise InputError("uv, bit_depth, png, exr, unlit and denoise belong to a texture; give its size as texture")
        if self.unlit and not self.is_light:
            raise InputError(f"unlit is for shadow, sun and light, not for {self.what}; leave it out")
        if self.bounces and self.what != "light":
            raise InputError(f"bounces is for light, not for {self.what}; leave it out")
        if self.denoise and self.what not in ("ao", "shadow", "light"):
            raise InputError(f"denoise is for ao, shadow and light, not for {self.what}; leave it out and raise spp")
        name = self.vertex_attribute
        if name != "COLOR_0" and not (name.startswith("_") and name.isascii() and name[1:]):
            example = f"_{self.what.upper().replace('-', '_')}"
            raise InputError(f"attribute is {name!r}; write COLOR_0, or a name of your own such as {example}")
        if self.multiply and name != "COLOR_0":
            raise InputError("multiply is for COLOR_0; leave it or attribute out")

    @property
    def vertex_attribute(self) -> str:
        """The vertex attribute for the values."""
        return self.attribute or ("_BENT_NORMAL" if self.what == "bent-normal" else "COLOR_0")

    @property
    def is_light(self) -> bool:
        """Whether the values multiply base colours, instead of being shown as they are."""
        return self.what in ("shadow", "sun", "light")

    @property
    def makes_lightmap(self) -> bool:
        """Whether the texture is a lightmap, which leaves the materials' own textures as they are."""
        return self.texture is not None and self.is_light and not self.unlit

    def measured_lights(self) -> list[Light]:
        """The lights whose shadows are measured; empty: the default lights of the scene. Raises InputError."""
        what, radius = self.what, self.radius
        if what in _SKY:
            if self.lights is not None:
                raise InputError(f"{what} depends on the sky, not on lights; leave lights out")
            return [AmbientOcclusion(radius)]
        if radius is not None:
            raise InputError(f"radius is for ao and bent-normal, not for {what}; leave it out")
        lights = [] if self.lights is None else check_lights(self.lights, "y")  # a `Sky` among them is rejected below
        if any(light.domain == "list" for light in lights):
            raise InputError("a bake takes lights one by one; PointLights is a list of them")
        if what == "sun" and lights and not (len(lights) == 1 and isinstance(lights[0], DirectionalLight)):
            raise InputError("sun takes one DirectionalLight; for several lights bake light")
        if what == "shadow" and any(light.domain == "hemisphere" for light in lights):
            raise InputError("a sky casts no shadow of its own; bake ao, or light")
        return lights
