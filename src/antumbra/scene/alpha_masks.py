"""Alpha masks of cut-out faces, through whose transparent texels light passes.

A mask marks each texel as solid or clear. A cut-out face blocks a ray if the texel at the hit point is solid
(docs/design/cutouts.md). Most faces of a textured leaf or fence are classified as entirely solid or entirely clear.
Only the remaining faces are cut-outs and need texel lookups.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .appearance import Appearance
from .materials import BLEND, CLAMP, MASK, MIRROR, Material, Texture

SOLID, CUT, CLEAR = range(3)
"""Classes of faces."""

_HALF = 0.5  # least alpha of a solid BLEND texel
_ROUNDING = 1e-6  # 128 / 255 is solid at the cutoff 0.50196
_FAR = 1e6  # texture coordinates are clamped to this magnitude, so that texel indices fit integers
_MARGIN = 1  # texels by which a face's range is widened, against rounding of texture coordinates


class AlphaMask(NamedTuple):
    """The solid texels of a texture."""

    solid: NDArray[np.bool_]  # (h, w) bool, first row at v = 0
    wrap: tuple[int, int]  # REPEAT, CLAMP or MIRROR along u and v


class Cutouts(NamedTuple):
    """The cut-out and the solid faces of a scene. All other faces are clear, and no ray hits them."""

    solid: NDArray[np.int32]  # (k,) int32, ascending: faces without holes
    faces: NDArray[np.int32]  # (m,) int32, ascending: cut-outs
    uv: NDArray[np.float32]  # (m, 3, 2) float32: texture coordinates of their corners
    mask: NDArray[np.int32]  # (m,) int32: their masks
    shapes: NDArray[np.int32]  # (p, 4) int32, of each mask: width, height, wrap modes along u and v
    first: NDArray[np.int64]  # (p,) int64, of each mask: its offset in `texels`
    texels: NDArray[np.uint8]  # (b,) uint8: one bit per texel, 1: solid; rows start at whole bytes, lowest bit first


def find_cutouts(appearance: Appearance) -> Cutouts | None:
    """The cut-outs of a scene with alpha; None if no face has holes.

    A texel is solid if its alpha is at least the cutoff of a MASK material, or at least one half with BLEND. It is
    multiplied by the material's alpha and by the mean alpha of the face's corners.

    Raises
    ------
    InputError
        If a texture cannot be decoded.
    """
    mask = np.full(len(appearance.material_of_face), -1, np.int32)
    masks, numbers = list[AlphaMask](), dict[tuple[Texture | None, int], int]()
    for index, material in enumerate(appearance.materials):
        if material.alpha_mode not in (MASK, BLEND):
            continue
        faces = np.flatnonzero(appearance.material_of_face == index)
        thresholds = _least_byte(appearance, material, faces)
        textured = appearance.textured[faces]
        for byte in np.unique(thresholds):
            for has_texture in (True, False):
                rows = faces[(thresholds == byte) & (textured == has_texture)]
                if not len(rows):
                    continue
                key = (material.texture if has_texture else None), int(byte)
                if key not in numbers:
                    numbers[key] = len(masks)
                    masks.append(_mask_of(*key))
                mask[rows] = numbers[key]
    uv = np.zeros((len(mask), 3, 2), np.float32) if appearance.uv is None else appearance.uv
    return cutouts_of(uv, mask, masks)


def _least_byte(appearance: Appearance, material: Material, faces: np.ndarray) -> NDArray[np.int_]:
    """(f,) int: the alpha threshold of each face, 0 to 255; 256: no texel is solid."""
    alpha = np.full(len(faces), float(material.factor[3]))
    if appearance.colours is not None:
        alpha *= appearance.colours[faces, :, 3].mean(1, dtype=np.float64)
    cutoff = material.cutoff if material.alpha_mode == MASK else _HALF
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.ceil(255.0 * cutoff / alpha - _ROUNDING)
    out: NDArray[np.int_] = np.clip(np.nan_to_num(least, nan=0.0, posinf=256.0), 0, 256).astype(int)
    return out


def _mask_of(texture: Texture | None, least: int) -> AlphaMask:
    if texture is None:
        return AlphaMask(np.full((1, 1), least <= 255), (CLAMP, CLAMP))
    try:
        alpha = texture.pixels[..., 3]
    except ValueError as error:
        raise InputError(
            f"{texture.name}: its alpha cannot be read ({error}); load the scene with cutouts=False"
        ) from None
    return AlphaMask(alpha >= least, (texture.wrap_s, texture.wrap_t))


def cutouts_of(uv: NDArray[np.float32], mask: NDArray[np.int32], masks: Sequence[AlphaMask]) -> Cutouts | None:
    """The `Cutouts` of faces with given masks; None if no face has holes.

    uv : (n, 3, 2) float32, texture coordinates of the corners of all faces
    mask : (n,) int32, index in `masks` for each face; -1: the face is solid
    """
    kinds = np.full(len(mask), SOLID, np.int8)
    for k, each in enumerate(masks):
        faces = np.flatnonzero(mask == k)
        kinds[faces] = _kinds(finite_uv(uv[faces]), each)
    if not kinds.any():
        return None
    cut = np.flatnonzero(kinds == CUT).astype(np.int32)
    rows = [np.packbits(each.solid, axis=1, bitorder="little").ravel() for each in masks]
    first = np.cumsum([0, *(len(row) for row in rows)])[:-1]
    shapes = np.array([(*each.solid.shape[::-1], *each.wrap) for each in masks], np.int32)
    solid = np.flatnonzero(kinds == SOLID).astype(np.int32)
    return Cutouts(solid, cut, finite_uv(uv[cut]), mask[cut].astype(np.int32), shapes, first, np.concatenate(rows))


def finite_uv(uv: np.ndarray) -> NDArray[np.float32]:
    """Texture coordinates with NaN and infinity replaced, float32."""
    out: NDArray[np.float32] = np.clip(np.nan_to_num(uv, nan=0.0), -_FAR, _FAR).astype(np.float32)
    return out


def _kinds(uv: np.ndarray, mask: AlphaMask) -> np.ndarray:
    """(f,) int8: SOLID, CLEAR or CUT, depending on the texels in each face's bounding rectangle (summed-area table)."""
    h, w = mask.solid.shape
    sums = np.zeros((h + 1, w + 1), np.int64)  # summed-area table: over all texels above and to the left
    np.cumsum(np.cumsum(mask.solid, axis=0, dtype=np.int64), axis=1, out=sums[1:, 1:])
    (column_spans, n_columns), (row_spans, n_rows) = (
        _texel_spans(uv[..., k], size, mask.wrap[k]) for k, size in enumerate((w, h))
    )
    solid = np.zeros(len(uv), np.int64)
    for x0, x1 in column_spans:
        for y0, y1 in row_spans:
            solid += sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    return np.where(solid == 0, CLEAR, np.where(solid == n_columns * n_rows, SOLID, CUT)).astype(np.int8)


def _texel_spans(u: np.ndarray, size: int, wrap: int) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """The texels that faces cover along one axis, as two ranges [begin, end); and their number.

    u : (f, 3), texture coordinates of corners
    """
    low = np.floor(u.min(1, initial=np.inf).astype(np.float64) * size).astype(np.int64) - _MARGIN
    high = np.floor(u.max(1, initial=-np.inf).astype(np.float64) * size).astype(np.int64) + _MARGIN + 1
    none = np.zeros_like(low)
    if wrap == CLAMP:
        low, high = np.clip(low, 0, size - 1), np.clip(high, 1, size)
        return [(low, high), (none, none)], high - low
    if wrap == MIRROR:  # of a face that crosses a fold, the wider side covers the other
        low, high = _folded(low, high, size)
    covers_all = high - low >= size
    begin = np.where(covers_all, 0, low % size)
    end = np.where(covers_all, size, begin + (high - low))
    return [(begin, np.minimum(end, size)), (none, np.maximum(end - size, 0))], end - begin


def _folded(low: np.ndarray, high: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Texel ranges of a mirrored texture, folded back onto the texture, where each becomes a single range."""
    first, last = low // size, (high - 1) // size
    a, b = mirrored_texels(low, size), mirrored_texels(high - 1, size)
    low, high = np.minimum(a, b), np.maximum(a, b) + 1
    fold = np.where(first % 2 == 0, size, 0)  # the texture edge at which the range is mirrored
    crosses_fold = last == first + 1
    low, high = np.where(crosses_fold, np.minimum(low, fold), low), np.where(crosses_fold, np.maximum(high, fold), high)
    return np.where(last > first + 1, 0, low), np.where(last > first + 1, size, high)


def mirrored_texels(x: np.ndarray, size: int) -> np.ndarray:
    """Texel indices of a texture that is mirrored at its edges."""
    x = x % (2 * size)
    return np.where(x < size, x, 2 * size - 1 - x)
