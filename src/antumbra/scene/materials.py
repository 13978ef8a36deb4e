"""Materials and textures: what a surface shows beyond one colour for each face."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .picture import bytes_of, decoded, linear_of, mip_levels

REPEAT, CLAMP, MIRROR = 0, 1, 2
"""How a texture continues beyond its edges."""

OPAQUE, MASK, BLEND = "OPAQUE", "MASK", "BLEND"
"""What alpha means: nothing; a hole below the cutoff; the share of light that the surface stops."""

_GLANCE = 256  # pixels of a side that are enough for mean colours


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture that covers surfaces. It is decoded when its pixels are asked for, and then kept.

    Texture coordinates (0, 0) are its upper left corner, and (1, 1) its lower right corner, as in glTF.
    """

    name: str  # in errors
    picture: "bytes | np.ndarray | None" = field(
        repr=False
    )  # encoded, in one of `picture.FORMATS`; or (h, w, 4) uint8; None: white
    wrap_s: int = REPEAT
    wrap_t: int = REPEAT
    nearest: bool = False  # whether texels are squares, not interpolated
    has_alpha: bool = False  # whether alpha counts: colours of texels without it do not
    opacity: bytes | None = field(default=None, repr=False)  # a second picture, whose brightness is the alpha

    @cached_property
    def pixels(self) -> np.ndarray:
        """(h, w, 4) uint8, contiguous. Raises ValueError if the picture cannot be decoded."""
        return self._decoded(None)

    @cached_property
    def mips(self) -> np.ndarray:
        """(n,) uint8: the pixels of all smaller mip levels, one after the other; see `mip_levels`."""
        levels = mip_levels(self.pixels, self.has_alpha)
        return np.concatenate([np.empty(0, np.uint8), *(bytes_of(level).reshape(-1) for level in levels)])

    @cached_property
    def glance(self) -> list[np.ndarray]:
        """Mip levels ((h, w, 4) float32, linear) that serve for mean colours; a large picture begins reduced."""
        pixels = self._decoded(_GLANCE)
        smaller = mip_levels(pixels, self.has_alpha)
        if max(pixels.shape[:2]) <= _GLANCE:
            return [linear_of(pixels), *smaller]
        return [level for level in smaller if max(level.shape[:2]) <= _GLANCE]

    def _decoded(self, side: int | None) -> np.ndarray:
        picture, opacity = self.picture, None if self.opacity is None else decoded(self.opacity, side)
        if picture is None:
            pixels = np.full((1, 1, 4) if opacity is None else opacity.shape, 255, np.uint8)
        else:
            pixels = decoded(picture, side) if isinstance(picture, bytes) else picture
        return pixels if opacity is None else _with_alpha(pixels, opacity)


def _with_alpha(pixels: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """The pixels with the brightness of another picture as alpha; the smaller of the two is enlarged."""
    from PIL import Image

    size = max(pixels.shape[1], opacity.shape[1]), max(pixels.shape[0], opacity.shape[0])
    colour, alpha = (Image.fromarray(p).convert(mode).resize(size) for p, mode in ((pixels, "RGB"), (opacity, "L")))
    return np.ascontiguousarray(np.dstack([np.asarray(colour), np.asarray(alpha)]))


class Material(NamedTuple):
    """The base colour of surfaces: factor times texture times the colours of vertices."""

    name: str = ""
    factor: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # linear red, green, blue, and alpha
    texture: Texture | None = None
    alpha_mode: str = OPAQUE
    cutoff: float = 0.5  # of MASK
    double_sided: bool = True


PLAIN = Material()


class Look(NamedTuple):
    """What a mesh shows beyond a colour for each face. Rows are its vertices; faces share them as they do positions."""

    materials: tuple[Material, ...]
    uv: np.ndarray | None = None  # (v, 2) float32: coordinates in the material's texture; None: no texture is shown
    colours: np.ndarray | None = None  # (v, 4) float32: linear colour and alpha of each vertex
    normals: np.ndarray | None = None  # (v, 3) float32, for shading
    rest: np.ndarray | None = None  # (v, 3) float32 or float64: the positions that the normals belong to
    material_of_face: np.ndarray | None = None  # (f,) int32: index in `materials`, or -1; None: all have the only one
    textured: np.ndarray | None = None  # (f,) bool: which faces show a texture; None: all if there is `uv`


def look_of(material: Material, uv=None, colours=None, normals=None, rest=None) -> Look | None:
    """The look of a mesh; None if a colour for each face says everything."""
    uv = None if uv is None or material.texture is None else np.nan_to_num(np.asarray(uv, np.float32))
    if uv is None and colours is None and normals is None and material.alpha_mode == OPAQUE:
        return None
    colours = None if colours is None else rgba_rows(colours)
    normals = None if normals is None else np.nan_to_num(np.asarray(normals, np.float32))
    return Look((material,), uv, colours, normals, None if normals is None else rest)


def rgba_rows(colours) -> np.ndarray:
    """(v, 4) float32 of linear colours (v, 3) or (v, 4), in [0, 1]."""
    out = np.ones((len(colours), 4), np.float32)
    out[:, : np.shape(colours)[1]] = np.clip(np.nan_to_num(colours), 0.0, 1.0)
    return out
