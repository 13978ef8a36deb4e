"""Materials and textures: base colour, alpha mode, decoded images with mip levels, and the mean colour of each face.

Also the conversion of sRGB to linear light.
"""

import io
import threading
import warnings
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

# --- Conversion of sRGB to linear light -------------------------------------------------------------------------------


def srgb_to_linear(value) -> np.ndarray:
    """Convert sRGB in [0, 1] to linear light (IEC 61966-2-1), float64."""
    value = np.asarray(value, np.float64)
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


BYTE_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0)

# --- Pictures of textures: decoding with checks, and mip levels in linear light ---------------------------------------


FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA")
MAX_PIXELS = 1 << 26
SMALL_PIXELS = 1 << 22
PIXELS_PER_BYTE = 2048  # a picture that is not small and has more is a decompression bomb

LINEAR = BYTE_TO_LINEAR.astype(np.float32)
"""(256,) float32: the linear light of sRGB bytes."""

_OPENING = threading.Lock()  # of pictures: filters of warnings belong to all threads, and a race would keep ours

_STEPS = 1 << 16  # entries of the table from linear light to sRGB bytes: the darkest byte has twenty


def decode_image(data: bytes, side: int | None = None) -> np.ndarray:
    """(h, w, 4) uint8: a picture of one of `FORMATS`. `side`: a large JPEG may come smaller, but not below this.

    Raises ValueError, with the reason, if the picture cannot be decoded or is unreasonably large.
    """
    try:
        with _opened(data) as image:
            _check_size(image.size, len(data))
            if side is not None:
                image.draft("RGB", (side, side))
            return rgba_of(image)
    except Exception as error:  # Pillow's decoders raise a dozen kinds of errors on damaged files
        raise ValueError(str(error) or type(error).__name__) from error


def _opened(data: bytes):
    """A Pillow image, whose pixels are not read yet. Pillow's warnings of large pictures are errors."""
    from PIL import Image

    with _OPENING, warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        return Image.open(io.BytesIO(data), formats=FORMATS)


def rgba_of(image) -> np.ndarray:
    """(h, w, 4) uint8, contiguous: the pixels of a Pillow image; of 16 bits a channel the higher byte."""
    if image.mode.startswith("I"):
        high = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.dstack([high, high, high, np.full_like(high, 255)])
    return np.array(image.convert("RGBA"))


def linear_of(pixels: np.ndarray) -> np.ndarray:
    """(h, w, 4) float32: sRGB bytes as linear light in [0, 1], and alpha."""
    out = pixels.astype(np.float32) / np.float32(255.0)
    out[..., :3] = LINEAR[pixels[..., :3]]
    return out


def mip_levels(pixels: np.ndarray, has_alpha: bool = False) -> list[np.ndarray]:
    """Means of a picture ((h, w, 4) uint8) over 2 x 2, 4 x 4 ... texels, as linear float32, down to a single texel.

    An odd number of texels is halved by the exact means of areas. With `has_alpha`, colours count by their alpha, so
    that those of holes do not bleed into leaves.
    """
    if pixels.shape[:2] == (1, 1):
        return []
    whole = len(pixels) if len(pixels) % 2 else _STRIP
    strips = (linear_of(pixels[y : y + whole]) for y in range(0, len(pixels), whole))
    weighted = np.concatenate([_quartered(_times_alpha(strip) if has_alpha else strip) for strip in strips])
    levels = [weighted]
    while weighted.shape[:2] != (1, 1):
        weighted = _quartered(weighted)
        levels.append(weighted)
    return [_by_alpha(level) for level in levels] if has_alpha else levels


_STRIP = 256  # rows that become linear light at a time, sixteen times the memory of their bytes
_LEAST = np.float32(1.0 / 255.0)  # weight of a texel without alpha, so that an empty picture has a mean


def _times_alpha(linear: np.ndarray) -> np.ndarray:
    out = linear.copy()
    out[..., 3] += _LEAST
    out[..., :3] *= out[..., 3:]
    return out


def _by_alpha(weighted: np.ndarray) -> np.ndarray:
    out = weighted.copy()
    out[..., :3] /= out[..., 3:]
    out[..., 3] -= _LEAST
    return out


def _quartered(picture: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(_halved(_halved(picture).swapaxes(0, 1)).swapaxes(0, 1))


def _halved(rows: np.ndarray) -> np.ndarray:
    """Means of pairs of rows. Of an odd number, 2 k + 1, k means of 2 + 1/k rows each."""
    n, k = len(rows), len(rows) // 2
    if n % 2 == 0:
        return (rows[0::2] + rows[1::2]) * np.float32(0.5)
    if n == 1:
        return rows
    i = np.arange(k, dtype=np.float32).reshape(-1, 1, 1)
    weights = np.float32(1.0 / n)
    return ((k - i) * rows[0:-1:2] + k * rows[1::2] + (i + 1) * rows[2::2]) * weights


def bytes_of(linear: np.ndarray) -> np.ndarray:
    """(h, w, 4) uint8: the inverse of `linear_of`."""
    shown = np.clip(linear, 0.0, 1.0)
    out = (shown * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    out[..., :3] = _TO_BYTE[(shown[..., :3] * np.float32(_STEPS - 1) + np.float32(0.5)).astype(np.uint16)]
    return out


def _byte_table() -> np.ndarray:
    """(65536,) uint8: the nearest sRGB byte of linear light."""
    edges = (BYTE_TO_LINEAR[1:] + BYTE_TO_LINEAR[:-1]) / 2.0
    return np.searchsorted(edges, np.arange(_STEPS) / (_STEPS - 1)).astype(np.uint8)


_TO_BYTE = _byte_table()


def _check_size(size: tuple[int, int], n_bytes: int) -> None:
    pixels = size[0] * size[1]
    if pixels > MAX_PIXELS or pixels > max(SMALL_PIXELS, PIXELS_PER_BYTE * n_bytes):
        raise ValueError(f"{size[0]}x{size[1]} pixels in {n_bytes} bytes are too many")


# --- Materials and textures: what a surface shows beyond one colour for each face -------------------------------------


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
        picture, opacity = self.picture, None if self.opacity is None else decode_image(self.opacity, side)
        if picture is None:
            pixels = np.full((1, 1, 4) if opacity is None else opacity.shape, 255, np.uint8)
        else:
            pixels = decode_image(picture, side) if isinstance(picture, bytes) else picture
        return pixels if opacity is None else _with_opaque_alpha(pixels, opacity)


def _with_opaque_alpha(pixels: np.ndarray, opacity: np.ndarray) -> np.ndarray:
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


# --- The mean colour of each face: of its material, its vertices, and the part of a texture that it shows -------------
#
# Whatever needs one colour for a face uses it: bounced light, stores, baking and jobs.


_POINTS = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2], [4 / 3, 4 / 3, 4 / 3]]) / 4.0
"""Barycentric coordinates of the points that stand for a face: of its four similar parts, the centres."""


def mean_colours(material: Material, faces: np.ndarray | None, uv=None, colours=None) -> np.ndarray:
    """(3,) or (f, 3) float32, linear, in [0, 1]: the base colour of a mesh or of each of its faces.

    faces : (f, 3) int; None: every three vertices are a face
    uv : (v, 2) float; None: a texture counts as a whole
    colours : (v, 3 or 4) float, linear

    Raises ValueError if the texture cannot be decoded.
    """
    colour: np.ndarray = np.array(material.factor[:3], np.float64)
    if material.texture is not None:
        texture = material.texture
        colour = colour * (texture.glance[-1][0, 0, :3] if uv is None else texture_means(texture, _corners(uv, faces)))
    if colours is not None:
        colour = colour * _corners(np.nan_to_num(np.asarray(colours)[:, :3]), faces).mean(axis=1, dtype=np.float64)
    return np.clip(colour, 0.0, 1.0).astype(np.float32)


def _corners(values: np.ndarray, faces: np.ndarray | None) -> np.ndarray:
    """(f, 3, k): the values of vertices at the corners of faces."""
    return values.reshape(-1, 3, values.shape[1]) if faces is None else values[faces]


def texture_means(texture: Texture, uv: np.ndarray) -> np.ndarray:
    """(f, 3) float32: the mean linear colour that faces show of a texture.

    uv : (f, 3, 2) float, texture coordinates of their corners

    Four texels stand for a face. They are of the mip level whose texels are about as large as a quarter of the face.
    """
    levels, uv = texture.glance, np.nan_to_num(np.asarray(uv, np.float64))
    edges = (uv[:, 1:] - uv[:, :1]) * levels[0].shape[1::-1]
    texels = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 8.0
    level = np.clip(np.rint(0.5 * np.log2(np.maximum(texels, 1.0))), 0, len(levels) - 1).astype(np.int64)
    out = np.empty((len(uv), 3), np.float32)
    for k in np.unique(level):
        own, pixels = level == k, levels[k]
        points = np.einsum("pc,fcx->pfx", _POINTS, uv[own])
        x = _texel(points[..., 0], pixels.shape[1], texture.wrap_s)
        y = _texel(points[..., 1], pixels.shape[0], texture.wrap_t)
        out[own] = pixels[y, x, :3].mean(0)
    return out


def _texel(at: np.ndarray, n: int, wrap: int) -> np.ndarray:
    """Whole numbers below n: the texels at texture coordinates along one axis."""
    if wrap == CLAMP:
        at = np.clip(at, 0.0, 1.0)
    elif wrap == MIRROR:
        at = 1.0 - np.abs(at % 2.0 - 1.0)
    else:
        at = at % 1.0
    return np.minimum((at * n).astype(np.int64), n - 1)
