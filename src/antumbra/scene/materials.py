"""Materials and textures: base colour, alpha mode, maps, decoded images with mip levels, and mean face colours.

Also the conversions between sRGB and linear light.
"""

import io
import threading
import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.extras import MissingPackage
from ..base.forks import hold_during_fork
from ..base.memory import check_reading
from ..base.pickles import Squeezed, squeezed, without_cached
from ..kernels.elementary import log2, power
from ..kernels.small_matrices import product
from .ktx2 import decode_ktx2, is_ktx2, ktx2_size

if TYPE_CHECKING:
    from PIL import Image

# --- sRGB and linear light --------------------------------------------------------------------------------------------


def srgb_to_linear(value: ArrayLike) -> NDArray[np.float64]:
    """Convert sRGB in [0, 1] to linear light (IEC 61966-2-1), float64."""
    s = np.asarray(value, np.float64)
    linear: NDArray[np.float64] = np.where(s <= 0.04045, s / 12.92, power(np.maximum(s + 0.055, 0.0) / 1.055, 2.4))
    return linear


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Convert linear light in [0, 1] to sRGB (IEC 61966-2-1)."""
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * power(np.maximum(x, 0.0031308), 1.0 / 2.4) - 0.055)


BYTE_TO_LINEAR = srgb_to_linear(np.arange(256) / 255.0)

# --- Texture images: checked decoding, and mip levels in linear light -------------------------------------------------


FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TGA")
MAX_PIXELS = 1 << 26
SMALL_PIXELS = 1 << 22
PIXELS_PER_BYTE = 2048  # a larger image with more pixels per byte is a decompression bomb

LINEAR = BYTE_TO_LINEAR.astype(np.float32)
"""(256,) float32: the linear light of sRGB bytes."""

SHARES = (np.arange(256) / 255.0).astype(np.float32)
"""(256,) float32: the values of bytes that are numbers, not colours, such as roughness."""

_OPENING = threading.Lock()  # warning filters are shared by all threads, and a race would leave ours in place
hold_during_fork(_OPENING)

_STEPS = 1 << 16  # entries of the table from linear light to sRGB bytes: twenty for the darkest byte


def decode_image(data: bytes, side: int | None = None) -> NDArray[np.uint8]:
    """(h, w, 4) uint8: an image in one of `FORMATS`, or KTX2.

    A large JPEG may be decoded at reduced size, at least `side`.

    Raises ValueError, with the reason, if the image cannot be decoded or is unreasonably large; MissingPackage if it is
    KTX2 and the library of transcoders is missing.
    """
    try:
        if is_ktx2(data):
            _check_size(ktx2_size(data), len(data))
            return decode_ktx2(data)
        with _open_image(data) as image:
            _check_size(image.size, len(data))
            if side is not None:
                image.draft("RGB", (side, side))
            return rgba_of(image)
    except MissingPackage:
        raise
    except Exception as error:  # Pillow's decoders raise a dozen error types on damaged files
        raise ValueError(str(error) or type(error).__name__) from error


def _open_image(data: bytes) -> "Image.Image":
    """A Pillow image with its pixels still unread. Pillow's warnings about large images become errors."""
    from PIL import Image

    with _OPENING, warnings.catch_warnings():
        warnings.simplefilter("error", Image.DecompressionBombWarning)
        return Image.open(io.BytesIO(data), formats=FORMATS)


def rgba_of(image: "Image.Image") -> NDArray[np.uint8]:
    """(h, w, 4) uint8, contiguous: the pixels of a Pillow image; the high byte of 16-bit channels."""
    if image.mode.startswith("I"):
        high = (np.asarray(image).astype(np.int64) >> 8).clip(0, 255).astype(np.uint8)
        return np.dstack([high, high, high, np.full_like(high, 255)])
    return np.array(image.convert("RGBA"))


def linear_of(pixels: np.ndarray, table: NDArray[np.float32] = LINEAR) -> NDArray[np.float32]:
    """(h, w, 4) float32: sRGB bytes as linear light in [0, 1], and alpha; `table`: the values of bytes."""
    out = np.take(table, pixels)  # alpha too: one pass over memory is the fastest
    np.divide(pixels[..., 3], np.float32(255.0), out=out[..., 3])
    return out


def mip_levels(pixels: np.ndarray, has_alpha: bool = False, table: NDArray[np.float32] = LINEAR) -> list[np.ndarray]:
    """Mip levels of an image ((h, w, 4) uint8): means of 2 x 2, 4 x 4 ... texels, linear float32, down to one texel.

    An odd number of texels is halved by exact area averaging. With `has_alpha`, colours are weighted by alpha, so that
    the colours of holes do not bleed into leaves. `table`: the values of bytes.
    """
    if pixels.shape[:2] == (1, 1):
        return []
    strip_rows = len(pixels) if len(pixels) % 2 else _STRIP
    strips = (linear_of(pixels[y : y + strip_rows], table) for y in range(0, len(pixels), strip_rows))
    weighted = np.concatenate([_halve_image(_premultiplied(strip) if has_alpha else strip) for strip in strips])
    levels = [weighted]
    while weighted.shape[:2] != (1, 1):
        weighted = _halve_image(weighted)
        levels.append(weighted)
    return [_unpremultiplied(level) for level in levels] if has_alpha else levels


_STRIP = 256  # rows converted to linear light at a time: they take sixteen times the memory of their bytes
_LEAST = np.float32(1.0 / 255.0)  # added to every weight, so that a fully transparent image has a mean


def _premultiplied(linear: np.ndarray) -> np.ndarray:
    out = linear.copy()
    out[..., 3] += _LEAST
    for k in range(3):  # twice as fast as broadcasting over three channels
        out[..., k] *= out[..., 3]
    return out


def _unpremultiplied(weighted: np.ndarray) -> np.ndarray:
    out = weighted.copy()
    out[..., :3] /= out[..., 3:]
    out[..., 3] -= _LEAST
    return out


def _halve_image(picture: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.ascontiguousarray(_halve_rows(_halve_rows(picture).swapaxes(0, 1)).swapaxes(0, 1))


def _halve_rows(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Means of pairs of rows; for an odd number 2 k + 1, k means over 2 + 1/k rows each."""
    n, k = len(rows), len(rows) // 2
    if n % 2 == 0:
        return (rows[0::2] + rows[1::2]) * np.float32(0.5)
    if n == 1:
        return rows
    i = np.arange(k, dtype=np.float32).reshape(-1, 1, 1)
    weights = np.float32(1.0 / n)
    return ((k - i) * rows[0:-1:2] + k * rows[1::2] + (i + 1) * rows[2::2]) * weights


def bytes_of(linear: NDArray[np.float32], table: NDArray[np.float32] = LINEAR) -> NDArray[np.uint8]:
    """(h, w, 4) uint8: the inverse of `linear_of`."""
    clamped = np.clip(linear, 0.0, 1.0)
    out = (clamped * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
    if table is SHARES:
        return out
    out[..., :3] = _TO_BYTE[(clamped[..., :3] * np.float32(_STEPS - 1) + np.float32(0.5)).astype(np.uint16)]
    return out


def _byte_table() -> NDArray[np.uint8]:
    """(65536,) uint8: the nearest sRGB byte of linear light."""
    edges = (BYTE_TO_LINEAR[1:] + BYTE_TO_LINEAR[:-1]) / 2.0
    return np.searchsorted(edges, np.arange(_STEPS) / (_STEPS - 1)).astype(np.uint8)


_TO_BYTE = _byte_table()


def _check_size(size: tuple[int, int], n_bytes: int) -> None:
    pixels = size[0] * size[1]
    if pixels > MAX_PIXELS or pixels > max(SMALL_PIXELS, PIXELS_PER_BYTE * n_bytes):
        raise ValueError(f"{size[0]}x{size[1]} pixels in {n_bytes} bytes are too many")


# --- Materials, textures and vertex attributes ------------------------------------------------------------------------


REPEAT, CLAMP, MIRROR = 0, 1, 2
"""Wrap modes of textures."""

OPAQUE, MASK, BLEND = "OPAQUE", "MASK", "BLEND"
"""Alpha modes, as in glTF: alpha is ignored; a hole below the cutoff; the share of light that the surface blocks."""

_PREVIEW = 256  # pixels of a side that suffice for mean colours
BYTES_PER_PIXEL = 6
"""Memory of a decoded image with its mip levels."""

_MOST_BYTES = 1 << 22  # of an image that stays decoded before anybody needs its pixels


@dataclass(frozen=True, eq=False)
class Texture:
    """A texture image, decoded on first use and cached.

    Texture coordinates (0, 0) are its upper left corner and (1, 1) its lower right corner, as in glTF.
    """

    name: str  # in errors
    picture: "bytes | np.ndarray | None" = field(repr=False)  # for `decode_image`, or (h, w, 4) uint8; None: white
    wrap_s: int = REPEAT
    wrap_t: int = REPEAT
    nearest: bool = False  # nearest-texel lookup instead of interpolation
    has_alpha: bool = False  # whether alpha matters: mip levels then weight colours by it
    opacity: bytes | None = field(default=None, repr=False)  # a second image, whose brightness is the alpha
    holds_data: bool = False  # numbers, such as normals, instead of sRGB colours

    def __getstate__(self) -> dict[str, Any]:
        state = without_cached(self)
        return state | ({"picture": squeezed(self.picture)} if isinstance(self.picture, np.ndarray) else {})

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if isinstance(state["picture"], Squeezed):
            vars(self)["picture"] = state["picture"].array()

    @cached_property
    def pixels(self) -> NDArray[np.uint8]:
        """(h, w, 4) uint8, contiguous. Raises ValueError if the image cannot be decoded."""
        return self._decode(None)

    @cached_property
    def mips(self) -> NDArray[np.uint8]:
        """(n,) uint8: the pixels of all smaller mip levels, concatenated; see `mip_levels`."""
        table = SHARES if self.holds_data else LINEAR
        levels = mip_levels(self.pixels, self.has_alpha, table)
        return np.concatenate([np.empty(0, np.uint8), *(bytes_of(level, table).reshape(-1) for level in levels)])

    @cached_property
    def preview_levels(self) -> list[np.ndarray]:
        """Mip levels ((h, w, 4) float32, linear) for mean colours; those of a large image start at reduced size."""
        pixels = self._decode(_PREVIEW)
        if pixels.nbytes <= _MOST_BYTES and not any(map(_is_jpeg, (self.picture, self.opacity))):
            vars(self)["pixels"] = pixels  # the whole image: a picture needs it next
        smaller = mip_levels(pixels, self.has_alpha)
        if max(pixels.shape[:2]) <= _PREVIEW:
            return [linear_of(pixels), *smaller]
        return [level for level in smaller if max(level.shape[:2]) <= _PREVIEW]

    def _decode(self, side: int | None) -> np.ndarray:
        picture, opacity = self.picture, None if self.opacity is None else decode_image(self.opacity, side)
        if picture is None:
            pixels = np.full((1, 1, 4) if opacity is None else opacity.shape, 255, np.uint8)
        else:
            pixels = decode_image(picture, side) if isinstance(picture, bytes) else picture
        return pixels if opacity is None else _with_opaque_alpha(pixels, opacity)


def check_textures(textures: Iterable[Texture], file: str) -> None:
    """Raise an InputError if textures take too much memory once a picture needs all their pixels.

    Pixels are counted from the headers of images, before any is decoded.
    """
    images = [each for t in textures for each in (t.picture, t.opacity) if isinstance(each, bytes)]
    size = sum(BYTES_PER_PIXEL * pixel_count(image) for image in images)
    check_reading(size, f"{file}: its textures", sum(map(len, images)))


def pixel_count(image: bytes) -> int:
    """The pixels of an image; 0 if decoding it will fail."""
    try:
        width, height = checked_size(image)
    except ValueError:
        return 0
    return width * height


def checked_size(data: bytes) -> tuple[int, int]:
    """(width, height) of an image from its header. Raises ValueError, with the reason, as `decode_image` would."""
    try:
        if is_ktx2(data):
            size = ktx2_size(data)
        else:
            with _open_image(data) as opened:
                size = opened.size
        _check_size(size, len(data))
    except Exception as error:  # Pillow's decoders raise a dozen error types on damaged files
        raise ValueError(str(error) or type(error).__name__) from error
    return size


def is_plain_image(data: bytes) -> bool:
    """Whether the file of an image that can be decoded has sRGB colours without alpha."""
    with _open_image(data) as image:
        return image.mode in ("RGB", "L") and "icc_profile" not in image.info


def _is_jpeg(picture: "bytes | np.ndarray | None") -> bool:
    """Whether `decode_image` may reduce a picture."""
    return isinstance(picture, bytes) and picture.startswith(b"\xff\xd8")


def _with_opaque_alpha(pixels: np.ndarray, opacity: np.ndarray) -> np.ndarray:
    """The pixels with the brightness of another image as alpha; the smaller of the two is enlarged."""
    from PIL import Image

    size = max(pixels.shape[1], opacity.shape[1]), max(pixels.shape[0], opacity.shape[0])
    colour, alpha = (Image.fromarray(p).convert(mode).resize(size) for p, mode in ((pixels, "RGB"), (opacity, "L")))
    return np.ascontiguousarray(np.dstack([np.asarray(colour), np.asarray(alpha)]))


Affine: TypeAlias = tuple[tuple[float, float, float], tuple[float, float, float]]
"""The rows of a (2, 3) matrix: a linear map of texture coordinates, and an offset."""


class TextureMap(NamedTuple):
    """A texture of a material besides its base colour."""

    texture: Texture
    transform: Affine | None = None  # from the material's texture coordinates to those of the map; None: equal
    second: bool = False  # whether these are the second set of texture coordinates of the mesh, not the material's

    def transformed(self, uv: NDArray[np.float32]) -> NDArray[np.float32]:
        """Texture coordinates ((..., 2) float32) of the map."""
        if self.transform is None:
            return uv
        (a, b, x), (c, d, y) = np.array(self.transform, np.float32)
        u, v = uv[..., 0], uv[..., 1]
        return np.stack([a * u + b * v + x, c * u + d * v + y], -1)


class PbrParameters(NamedTuple):
    """The metallic-roughness parameters of a glTF material besides its base colour. Factors multiply maps.

    Only pictures use them: measured quantities are those of diffuse surfaces. `picture.ggx` has the formulas.
    """

    metallic: float = 0.0
    roughness: float = 1.0
    metal_map: TextureMap | None = None  # green: roughness, blue: metalness
    occlusion_map: TextureMap | None = None  # red: share of ambient light that arrives
    occlusion_strength: float = 1.0  # 0: the map has no effect
    normal_map: TextureMap | None = None
    normal_scale: float = 1.0  # of the map's x and y
    emission: tuple[float, float, float] = (0.0, 0.0, 0.0)  # linear radiance, in nits
    emission_map: TextureMap | None = None

    @property
    def maps(self) -> tuple[TextureMap, ...]:
        """The maps that there are."""
        maps = self.metal_map, self.occlusion_map, self.normal_map, self.emission_map
        return tuple(each for each in maps if each is not None)

    @property
    def has_lobe(self) -> bool:
        """Whether the surface has a GGX lobe. Without metal, at full roughness and without maps it is Lambertian."""
        maps = self.metal_map is not None or self.occlusion_map is not None
        return maps or self.metallic > 0.0 or self.roughness < 1.0

    @property
    def emits(self) -> bool:
        """Whether the surface emits light."""
        return any(self.emission)

    @property
    def is_plain(self) -> bool:
        """Whether the base colour is all that pictures show of the surface."""
        return not (self.has_lobe or self.emits or self.normal_map is not None)


LightShare: TypeAlias = tuple[float, float, float]
"""The shares of red, green and blue light that pass through a surface, each from 0 to 1."""

Transmittance: TypeAlias = float | Sequence[float | Sequence[float]]
"""A share of all light; shares of red, green and blue; or twelve of these, for the months from January to December."""

MONTHS = "jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"
"""The months of a transmittance that changes over the year."""


class Material(NamedTuple):
    """The base colour of surfaces: factor times texture times vertex colour; and what else pictures show of them."""

    name: str = ""
    factor: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)  # linear red, green, blue, and alpha
    texture: Texture | None = None
    alpha_mode: str = OPAQUE
    cutoff: float = 0.5  # for MASK
    double_sided: bool = True
    transmission: float = 0.0  # share of the base colour that light keeps when it passes straight through
    transmittance: tuple[LightShare, ...] | None = None  # overrides it: one share, or one for each month
    closed: bool = False  # whether its surfaces enclose bodies, each of which lets the transmittance pass as a whole
    pbr: PbrParameters | None = None  # for pictures; None: the surface is diffuse

    @property
    def lets_light_pass(self) -> bool:
        """Whether some light may pass through surfaces of this material."""
        return self.alpha_mode != OPAQUE or self.transmission > 0.0 or any(map(any, self.transmittance or ()))

    @property
    def has_maps(self) -> bool:
        """Whether it needs texture coordinates."""
        return self.texture is not None or (self.pbr is not None and bool(self.pbr.maps))


PLAIN = Material()

_LAMBERTIAN = PbrParameters()


def pbr_of(material: Material) -> PbrParameters:
    """The metallic-roughness parameters of a material; those of a Lambertian surface if it has none."""
    return _LAMBERTIAN if material.pbr is None else material.pbr


PINK = 0.9, 0.15, 0.6
"""Linear base colour of surfaces whose texture is missing, so that pictures show it; as in Blender and game engines."""


def without_texture(material: Material) -> Material:
    """A material whose texture is missing: pink times its factor."""
    r, g, b, alpha = material.factor
    return material._replace(factor=(PINK[0] * r, PINK[1] * g, PINK[2] * b, alpha))


class MeshAppearance(NamedTuple):
    """The appearance of a mesh beyond one colour per face. Rows are vertices; faces index them as they do positions."""

    materials: tuple[Material, ...]
    uv: NDArray[np.float32] | None = None  # (v, 2) float32: coordinates in the material's texture; None: untextured
    colours: NDArray[np.float32] | None = None  # (v, 4) float32: linear colour and alpha of each vertex
    normals: NDArray[np.float32] | None = None  # (v, 3) float32, for shading
    rest_positions: np.ndarray | None = None  # (v, 3) float32 or float64: the positions that the normals belong to
    material_of_face: NDArray[np.int32] | None = None  # (f,) int32: index in `materials`, or -1; None: the only one
    textured: NDArray[np.bool_] | None = None  # (f,) bool: faces with coordinates; None: all if there is `uv`
    tangents: NDArray[np.float32] | None = None  # (v, 4) float32: tangent of the normal map, and its handedness
    second_uv: NDArray[np.float32] | None = None  # (v, 2) float32: coordinates of maps that have a set of their own

    @property
    def is_plain(self) -> bool:
        """Whether one colour per face suffices, so that only the names of materials matter."""
        varied = self.uv is not None or self.colours is not None or self.normals is not None
        return not varied and not any(each.lets_light_pass or each.pbr is not None for each in self.materials)


def look_of(
    material: Material,
    uv: ArrayLike | None = None,
    colours: NDArray[Any] | None = None,
    normals: ArrayLike | None = None,
    rest_positions: NDArray[Any] | None = None,
    tangents: ArrayLike | None = None,
) -> MeshAppearance | None:
    """The look of a mesh; None if one colour per face suffices and the material has no name."""
    uv = None if uv is None or not material.has_maps else np.nan_to_num(np.asarray(uv, np.float32))
    colours = None if colours is None else rgba_rows(colours)
    normals = None if normals is None else np.nan_to_num(np.asarray(normals, np.float32))
    mapped = uv is not None and material.pbr is not None and material.pbr.normal_map is not None
    rest = None if normals is None and not mapped else rest_positions
    tangents = None if tangents is None or not mapped else np.nan_to_num(np.asarray(tangents, np.float32))
    look = MeshAppearance((material,), uv, colours, normals, rest, tangents=tangents)
    return None if look.is_plain and not material.name else look


def rgba_rows(colours: NDArray[Any]) -> NDArray[np.float32]:
    """(v, 4) float32 of linear colours (v, 3) or (v, 4), in [0, 1]."""
    out = np.ones((len(colours), 4), np.float32)
    out[:, : np.shape(colours)[1]] = np.clip(np.nan_to_num(colours), 0.0, 1.0)
    return out


# --- Mean face colours, for bounced light, stores, baking and studies -------------------------------------------------


_POINTS = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2], [4 / 3, 4 / 3, 4 / 3]]) / 4.0
"""Barycentric coordinates of a face's sample points: the centres of its four similar parts."""


def mean_colours(
    material: Material, faces: np.ndarray | None, uv: NDArray[Any] | None = None, colours: ArrayLike | None = None
) -> NDArray[np.float32]:
    """(3,) or (f, 3) float32, linear, in [0, 1]: the base colour of a mesh or of each of its faces.

    faces : (f, 3) int; None: every three vertices are a face
    uv : (v, 2) float; None: the mean of the whole texture
    colours : (v, 3 or 4) float, linear

    Raises ValueError if the texture cannot be decoded.
    """
    colour: np.ndarray = np.array(material.factor[:3], np.float64)
    if material.texture is not None:
        texture = material.texture
        colour = colour * (
            texture.preview_levels[-1][0, 0, :3] if uv is None else texture_means(texture, _corners(uv, faces))
        )
    if colours is not None:
        colour = colour * _corners(np.nan_to_num(np.asarray(colours)[:, :3]), faces).mean(axis=1, dtype=np.float64)
    out: NDArray[np.float32] = np.clip(colour, 0.0, 1.0).astype(np.float32)
    return out


def _corners(values: np.ndarray, faces: np.ndarray | None) -> np.ndarray:
    """(f, 3, k): vertex values at the corners of faces."""
    return values.reshape(-1, 3, values.shape[1]) if faces is None else values[faces]


def texture_means(texture: Texture, uv: np.ndarray) -> NDArray[np.float32]:
    """(f, 3) float32: the mean linear colour of the part of a texture that covers each face.

    uv : (f, 3, 2) float, texture coordinates of the corners

    It is the mean of four texels, from the mip level whose texels are about as large as a quarter of the face.
    """
    levels, uv = texture.preview_levels, np.nan_to_num(np.asarray(uv, np.float64))
    edges = (uv[:, 1:] - uv[:, :1]) * levels[0].shape[1::-1]
    texels = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 8.0
    level = np.clip(np.rint(0.5 * log2(np.maximum(texels, 1.0))), 0, len(levels) - 1).astype(np.int64)
    out = np.empty((len(uv), 3), np.float32)
    for k in np.unique(level):
        rows, pixels = level == k, levels[k]
        points = np.moveaxis(product(_POINTS, uv[rows]), 1, 0)
        x = _texel(points[..., 0], pixels.shape[1], texture.wrap_s)
        y = _texel(points[..., 1], pixels.shape[0], texture.wrap_t)
        out[rows] = pixels[y, x, :3].mean(0)
    return out


def _texel(at: np.ndarray, n: int, wrap: int) -> np.ndarray:
    """Texel indices below n at texture coordinates along one axis."""
    if wrap == CLAMP:
        at = np.clip(at, 0.0, 1.0)
    elif wrap == MIRROR:
        at = 1.0 - np.abs(at % 2.0 - 1.0)
    else:
        at = at % 1.0
    return np.minimum((at * n).astype(np.int64), n - 1)
