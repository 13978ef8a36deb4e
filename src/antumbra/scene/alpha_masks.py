"""Alpha masks: cut-out faces, whose holes come from the alpha channel of a texture. Light passes through the holes.

A mask says of each texel whether it is solid. A ray that meets a cut-out is stopped if the texel there is solid
(docs/design/cutouts.md). Most faces of a textured leaf or fence are found to be solid, or clear, as a whole: only the
others are cut-outs, and only they ever read a texel.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from .appearance import Appearance
from .materials import BLEND, CLAMP, MASK, MIRROR, Material, Texture

SOLID, CUT, CLEAR = range(3)
"""What a face is."""

_HALF = 0.5  # alpha from which a BLEND texel stops light
_ROUNDING = 1e-6  # 128 / 255 is solid at the cutoff 0.50196
_FAR = 1e6  # texture coordinates beyond this are clamped to it: their texels fit whole numbers
_MARGIN = 1  # texels around a face's own that count as its own: covers the rounding of texture coordinates


class AlphaMask(NamedTuple):
    """The texels of a texture that are solid."""

    solid: np.ndarray  # (h, w) bool, the first row is at v = 0
    wrap: tuple[int, int]  # REPEAT, CLAMP or MIRROR along u and v


class Cutouts(NamedTuple):
    """The cut-outs of a scene, and the faces that are solid. Faces in neither are clear: nothing meets them."""

    solid: np.ndarray  # (k,) int32, ascending: faces without a hole
    faces: np.ndarray  # (m,) int32, ascending: cut-outs
    uv: np.ndarray  # (m, 3, 2) float32: texture coordinates of their corners
    mask: np.ndarray  # (m,) int32: their masks
    shapes: np.ndarray  # (p, 4) int32, of each mask: width, height, and how it goes on along u and v
    first: np.ndarray  # (p,) int64, of each mask: its place in `texels`
    texels: np.ndarray  # (b,) uint8: a bit a texel, 1: solid; rows begin at whole bytes, the lowest bit comes first


def find_cutouts(appearance: Appearance) -> Cutouts | None:
    """The cut-outs of a scene with alpha; None if no face has a hole.

    A texel is solid if its alpha is at least the cutoff of a MASK material, or a half with BLEND. The alpha of a
    material and the mean alpha of a face's corners multiply it.

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
        least = _least_byte(appearance, material, faces)
        textured = appearance.textured[faces]
        for byte in np.unique(least):
            for shown in (True, False):
                some = faces[(least == byte) & (textured == shown)]
                if not len(some):
                    continue
                key = (material.texture if shown else None), int(byte)
                if key not in numbers:
                    numbers[key] = len(masks)
                    masks.append(_mask_of(*key))
                mask[some] = numbers[key]
    uv = np.zeros((len(mask), 3, 2), np.float32) if appearance.uv is None else appearance.uv
    return with_masks(uv, mask, masks)


def _least_byte(appearance: Appearance, material: Material, faces: np.ndarray) -> np.ndarray:
    """(f,) int: the least alpha of a solid texel, 0 to 255; 256: no texel is solid."""
    alpha = np.full(len(faces), float(material.factor[3]))
    if appearance.colours is not None:
        alpha *= appearance.colours[faces, :, 3].mean(1, dtype=np.float64)
    cutoff = material.cutoff if material.alpha_mode == MASK else _HALF
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.ceil(255.0 * cutoff / alpha - _ROUNDING)
    return np.clip(np.nan_to_num(least, nan=0.0, posinf=256.0), 0, 256).astype(int)


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


def with_masks(uv: np.ndarray, mask: np.ndarray, masks: Sequence[AlphaMask]) -> Cutouts | None:
    """The `Cutouts` of faces with known masks; None if no face has a hole.

    uv : (n, 3, 2) float32, texture coordinates of the corners of all faces
    mask : (n,) int32, index in `masks` of each face, -1: the face is solid
    """
    kinds = np.full(len(mask), SOLID, np.int8)
    for k, each in enumerate(masks):
        faces = np.flatnonzero(mask == k)
        kinds[faces] = _kinds(finite(uv[faces]), each)
    if not kinds.any():
        return None
    cut = np.flatnonzero(kinds == CUT).astype(np.int32)
    rows = [np.packbits(each.solid, axis=1, bitorder="little").ravel() for each in masks]
    first = np.cumsum([0, *(len(row) for row in rows)])[:-1]
    shapes = np.array([(*each.solid.shape[::-1], *each.wrap) for each in masks], np.int32)
    solid = np.flatnonzero(kinds == SOLID).astype(np.int32)
    return Cutouts(solid, cut, finite(uv[cut]), mask[cut].astype(np.int32), shapes, first, np.concatenate(rows))


def finite(uv: np.ndarray) -> np.ndarray:
    """Texture coordinates without NaN and infinity, float32."""
    return np.clip(np.nan_to_num(uv, nan=0.0), -_FAR, _FAR).astype(np.float32)


def _kinds(uv: np.ndarray, mask: AlphaMask) -> np.ndarray:
    """(f,) int8: whether the texels around each face are all solid, all clear, or both."""
    h, w = mask.solid.shape
    sums = np.zeros((h + 1, w + 1), np.int64)  # of all texels above and to the left
    np.cumsum(np.cumsum(mask.solid, axis=0, dtype=np.int64), axis=1, out=sums[1:, 1:])
    (columns, wide), (rows, high) = (_stretches(uv[..., k], size, mask.wrap[k]) for k, size in enumerate((w, h)))
    solid = np.zeros(len(uv), np.int64)
    for x0, x1 in columns:
        for y0, y1 in rows:
            solid += sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    return np.where(solid == 0, CLEAR, np.where(solid == wide * high, SOLID, CUT)).astype(np.int8)


def _stretches(u: np.ndarray, size: int, wrap: int) -> tuple[list[tuple[np.ndarray, np.ndarray]], np.ndarray]:
    """The texels that faces cover along one axis, as two stretches [begin, end) of the texture; and their number.

    u : (f, 3), texture coordinates of corners
    """
    low = np.floor(u.min(1, initial=np.inf).astype(np.float64) * size).astype(np.int64) - _MARGIN
    high = np.floor(u.max(1, initial=-np.inf).astype(np.float64) * size).astype(np.int64) + _MARGIN + 1
    none = np.zeros_like(low)
    if wrap == CLAMP:
        low, high = np.clip(low, 0, size - 1), np.clip(high, 1, size)
        return [(low, high), (none, none)], high - low
    if wrap == MIRROR:  # faces that reach over a fold cover what the wider side of it does
        low, high = _folded(low, high, size)
    whole = high - low >= size
    begin = np.where(whole, 0, low % size)
    end = np.where(whole, size, begin + (high - low))
    return [(begin, np.minimum(end, size)), (none, np.maximum(end - size, 0))], end - begin


def _folded(low: np.ndarray, high: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Stretches of a mirrored texture, turned to the texture itself, where they take a single stretch."""
    first, last = low // size, (high - 1) // size
    a, b = mirrored(low, size), mirrored(high - 1, size)
    low, high = np.minimum(a, b), np.maximum(a, b) + 1
    fold = np.where(first % 2 == 0, size, 0)  # the end of the texture at which the stretch turns
    over = last == first + 1
    low, high = np.where(over, np.minimum(low, fold), low), np.where(over, np.maximum(high, fold), high)
    return np.where(last > first + 1, 0, low), np.where(last > first + 1, size, high)


def mirrored(x: np.ndarray, size: int) -> np.ndarray:
    """Texels of a texture that is mirrored at each of its edges."""
    x = x % (2 * size)
    return np.where(x < size, x, 2 * size - 1 - x)
