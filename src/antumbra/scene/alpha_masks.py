"""Faces that let light pass: cut-outs with holes, panes, and leaves.

A mask tells how much light passes through each texel. Most faces of a textured leaf or fence are either solid or clear
as a whole; only the others need texel lookups when a ray meets them (docs/design/cutouts.md).

Transmittances multiply along a ray. They are stored as *depths*, rounded logarithms, whose integer sums do not depend
on the order of the faces: every plan gets the same product.
"""

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.elementary import log2
from .appearance import Appearance
from .materials import BLEND, CLAMP, MASK, MIRROR, MONTHS, Material, Texture, srgb_to_linear

SOLID, CUT, CLEAR = range(3)
"""Classes of faces."""

HALVING = 1 << 24
"""The depth of a face that lets half of the light pass."""

DARK = 8 * HALVING
"""The depth of 1/256, the least product of transmittances; beyond, all light is blocked."""

_HALF = 0.5  # closest hits and cameras see surfaces through which at most this share of the light passes
_ROUNDING = 1e-6  # 128 / 255 is solid at the cutoff 0.50196
_FAR = 1e6  # texture coordinates are clamped to this magnitude, so that texel indices fit integers
_MARGIN = 1  # texels by which a face's range is widened, against rounding of texture coordinates
_LEVELS = 256  # rows of a mask's table, and different alphas of the faces of a material

_Key: TypeAlias = tuple[Material, bool, float]
"""A material, whether its texture counts, and the alpha of faces."""


class AlphaMask(NamedTuple):
    """The light that passes through each texel."""

    texels: NDArray[np.uint8]  # (h, w) uint8, first row at v = 0: rows of `transmittance`
    transmittance: NDArray[np.float64]  # (m, 3) float64 in [0, 1]: shares of red, green and blue
    wrap: tuple[int, int]  # REPEAT, CLAMP or MIRROR along u and v
    months: NDArray[np.float64] | None = None  # (12, m, 3): `transmittance` is their mean; None: it never changes
    closed: bool = False  # whether these are shares of closed bodies, which light enters and leaves


class Cutouts(NamedTuple):
    """The solid faces of a scene, and those that let some light pass. All others are clear, and no ray hits them."""

    solid: NDArray[np.int32]  # (k,) int32, ascending: faces that block all light
    faces: NDArray[np.int32]  # (m,) int32, ascending: faces that let some light pass, here called cut-outs
    uv: NDArray[np.float32]  # (m, 3, 2) float32: texture coordinates of their corners
    mask: NDArray[np.int32]  # (m,) int32: their masks
    shapes: NDArray[np.int32]  # (p, 4) int32, of each mask: width, height, wrap modes along u and v
    first: NDArray[np.int64]  # (p,) int64, of each mask: its offset in `texels`
    texels: NDArray[np.uint8]  # (b,) uint8: rows of the mask's part of `depths`
    rows: NDArray[np.int64]  # (p,) int64, of each mask: the first row of its part of `depths`
    depths: NDArray[np.int32]  # (r, 4) int32: depths of red, green and blue; 1: closest hits meet the texel, else 0
    months: NDArray[np.int32]  # (12, r, 4) int32: `depths` in each month; (0, r, 4): they never change

    @property
    def seasons(self) -> NDArray[np.int64]:
        """(12,) int64: for each month, the first month in which the same light passes; 0 is January."""
        if not len(self.months):
            return np.zeros(len(MONTHS), np.int64)
        rows = self.months.reshape(len(MONTHS), -1)
        _, first, season = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        return first[season.reshape(-1)]


def without_panes(cutouts: Cutouts) -> Cutouts:
    """The cut-outs without faces that closest hits meet at every texel of their masks, which become solid."""
    meets = np.minimum.reduceat(cutouts.depths[:, 3], cutouts.rows) > 0  # each mask has at least one row of its own
    panes = meets[cutouts.mask]
    solid = np.sort(np.concatenate([cutouts.solid, cutouts.faces[panes]]))
    return cutouts._replace(solid=solid, faces=cutouts.faces[~panes], uv=cutouts.uv[~panes], mask=cutouts.mask[~panes])


def channels_of(depths: NDArray[np.int32]) -> int:
    """Number of values that tell the transmittances: 0 if faces only have holes, 1 if they are grey, else 3."""
    depth = depths[:, :3]
    if (depth != depth[:, :1]).any():
        return 3
    return int(((depth > 0) & (depth <= DARK)).any())


class TexelMask(NamedTuple):
    """A mask with depths in place of shares: its part of `Cutouts`."""

    shape: tuple[int, int, int, int]  # width, height, wrap modes along u and v
    texels: NDArray[np.uint8]  # (height * width,) uint8: rows of `depths`
    depths: NDArray[np.int32]  # (m, 4) int32
    months: NDArray[np.int32]  # (12, m, 4) int32; (0, m, 4): `depths` never change


class FaceMasks:
    """Finds the masks of faces, of all faces of a scene at once or part by part.

    All parts are counted before the first one is found.

    masks : those found so far
    """

    def __init__(self) -> None:
        self.masks = list[AlphaMask]()
        self._numbers = dict[_Key, int]()
        self._alphas = dict[Material, NDArray[np.float64]]()  # those of the faces of a material, at most _LEVELS + 1

    def count(self, appearance: Appearance) -> None:
        """Count the alphas of some faces."""
        for material, faces in _open_materials(appearance):
            known = self._alphas.get(material, np.empty(0))
            self._alphas[material] = np.union1d(known, _alphas(appearance, material, faces))[: _LEVELS + 1]

    def find(self, appearance: Appearance) -> NDArray[np.int32]:
        """(n,) int32: the index in `masks` for each face; -1: the face is solid.

        Raises
        ------
        InputError
            If a texture cannot be decoded.
        """
        mask = np.full(len(appearance.material_of_face), -1, np.int32)
        for material, faces in _open_materials(appearance):
            alphas, textured = _alphas(appearance, material, faces), appearance.textured[faces]
            if len(self._alphas[material]) > _LEVELS:
                alphas = np.round(alphas * (_LEVELS - 1)) / (_LEVELS - 1)
            for alpha in np.unique(alphas):
                for has_texture in (True, False):
                    rows = faces[(alphas == alpha) & (textured == has_texture)]
                    if len(rows):
                        mask[rows] = self._number((material, has_texture, float(alpha)))
        return mask

    def _number(self, key: _Key) -> int:
        if key not in self._numbers:
            self._numbers[key] = len(self.masks)
            self.masks.append(_mask_of(*key))
        return self._numbers[key]


def find_cutouts(appearance: Appearance) -> Cutouts | None:
    """The faces of a scene that let light pass; None if there are none.

    Through a texel passes the share of light that it does not cover, 1 - alpha, where alpha is the texel's times the
    material's times the mean of the face's corners. With the alpha mode MASK, alpha is 1 from the cutoff on and 0
    below it; with OPAQUE it is 1. What a texel covers still lets pass the `transmittance` of its material, or the share
    `transmission` of its colour. Without a date, a transmittance that changes over the year counts as its mean. All of
    this is the share of a body, not of a surface, if the material is that of closed bodies.

    Raises
    ------
    InputError
        If a texture cannot be decoded.
    """
    found = FaceMasks()
    found.count(appearance)
    mask = found.find(appearance)
    uv = np.zeros((len(mask), 3, 2), np.float32) if appearance.uv is None else appearance.uv
    return cutouts_of(uv, mask, found.masks)


def _open_materials(appearance: Appearance) -> Iterator[tuple[Material, NDArray[np.int64]]]:
    """The materials that let light pass, each with its faces."""
    for index, material in enumerate(appearance.materials):
        if material.lets_light_pass:
            yield material, np.flatnonzero(appearance.material_of_face == index)


def _alphas(appearance: Appearance, material: Material, faces: np.ndarray) -> NDArray[np.float64]:
    """(f,) float64: the material's alpha times that of each face's corners."""
    alpha = np.full(len(faces), float(material.factor[3]))
    if appearance.colours is not None:
        alpha *= appearance.colours[faces, :, 3].mean(1, dtype=np.float64)
    return alpha


def _mask_of(material: Material, has_texture: bool, alpha: float) -> AlphaMask:
    """The mask of the faces of a material whose alpha, without that of the texture, is given."""
    texture = material.texture if has_texture else None
    coloured = material.transmittance is None and material.transmission > 0.0
    try:
        texels, palette = _texels_of(texture, coloured)
    except ValueError as error:
        name = texture.name if texture is not None else material.name
        raise InputError(f"{name}: its alpha cannot be read ({error}); load the scene with cutouts=False") from None
    covered = _covered(material, palette[:, 3], alpha)[:, None]
    colour = srgb_to_linear(palette[:, :3] / 255.0) * np.asarray(material.factor[:3])
    monthly = None if material.transmittance is None else np.array(material.transmittance)[:, None]  # (1 or 12, 1, 3)
    beyond = (colour * material.transmission)[None] if monthly is None else monthly
    passing = np.clip(1.0 - covered + covered * beyond, 0.0, 1.0)
    wrap = (CLAMP, CLAMP) if texture is None else (texture.wrap_s, texture.wrap_t)
    months = passing if len(passing) > 1 else None
    return AlphaMask(texels, passing.mean(0), wrap, months, material.closed)


def _covered(material: Material, alpha: np.ndarray, factor: float) -> np.ndarray:
    """(m,) float64: the share that texels cover of what is behind them; `alpha`: (m,) uint8."""
    if material.alpha_mode == BLEND:
        return alpha / 255.0 * factor
    if material.alpha_mode != MASK:
        return np.ones(len(alpha))
    with np.errstate(divide="ignore", invalid="ignore"):
        least = np.ceil(255.0 * material.cutoff / np.float64(factor) - _ROUNDING)
    covered: NDArray[np.float64] = (alpha >= np.clip(np.nan_to_num(least, nan=0.0, posinf=256.0), 0, 256)).astype(float)
    return covered


@lru_cache(maxsize=64)  # the faces of a material may have many alphas, and their masks share the texels
def _texels_of(texture: Texture | None, coloured: bool) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """(h, w) uint8 texels, and the RGBA of each of their values, (m, 4) uint8. White if colours do not count."""
    palette = np.full((_LEVELS, 4), 255, np.uint8)
    if texture is None:
        return np.zeros((1, 1), np.uint8), palette[:1]
    if not coloured:
        palette[:, 3] = np.arange(_LEVELS)
        return np.ascontiguousarray(texture.pixels[..., 3]), palette
    pixels = np.ascontiguousarray(texture.pixels)
    values, index = np.unique(pixels.view(np.uint32), return_inverse=True)
    if len(values) <= _LEVELS:
        return index.reshape(pixels.shape[:2]).astype(np.uint8), values.view(np.uint8).reshape(-1, 4)
    from PIL import Image

    reduced = Image.fromarray(pixels).quantize(_LEVELS, method=Image.Quantize.FASTOCTREE)
    colours = np.frombuffer(bytes(reduced.palette.tobytes()), np.uint8).reshape(-1, 4) if reduced.palette else palette
    return np.asarray(reduced), colours


def depths_of(transmittance: NDArray[np.float64]) -> NDArray[np.int32]:
    """The depths of transmittances: -log2 in units of 1 / HALVING, rounded; DARK + 1 below 1/256."""
    depth = -log2(np.maximum(transmittance, 1e-9)) * HALVING
    return np.where(transmittance < 2.0**-8, DARK + 1, np.round(depth)).astype(np.int32)


def cutouts_of(uv: NDArray[np.float32], mask: NDArray[np.int32], masks: Sequence[AlphaMask]) -> Cutouts | None:
    """The `Cutouts` of faces with given masks; None if all faces are solid.

    uv : (n, 3, 2) float32, texture coordinates of the corners of all faces
    mask : (n,) int32, index in `masks` for each face; -1: the face is solid
    """
    kinds = kinds_of(uv, mask, masks)
    if not kinds.any():
        return None
    cut = np.flatnonzero(kinds == CUT).astype(np.int32)
    solid = np.flatnonzero(kinds == SOLID).astype(np.int32)
    table = mask_columns([texel_mask(each) for each in masks])
    return Cutouts(solid, cut, finite_uv(uv[cut]), mask[cut].astype(np.int32), **table)


def kinds_of(uv: NDArray[np.float32], mask: NDArray[np.int32], masks: Sequence[AlphaMask]) -> NDArray[np.int8]:
    """(n,) int8: SOLID, CUT or CLEAR; the arguments are those of `cutouts_of`."""
    kinds = np.full(len(mask), SOLID, np.int8)
    for k in np.unique(mask[mask >= 0]).tolist():
        faces = np.flatnonzero(mask == k)
        kinds[faces] = _kinds(finite_uv(uv[faces]), masks[k], _tables_of(masks[k]))
    return kinds


def texel_mask(mask: AlphaMask) -> TexelMask:
    """A mask with the depths of its shares."""
    h, w = mask.texels.shape
    table = _tables_of(mask)
    return TexelMask((w, h, *mask.wrap), mask.texels.reshape(-1), table[0], table[1:])


def mask_columns(masks: Sequence[TexelMask]) -> dict[str, Any]:
    """The fields of `Cutouts` about masks, which may share their texels."""
    parts = {each.texels.ctypes.data: each.texels for each in masks}
    offsets = dict(zip(parts, np.cumsum([0, *map(len, parts.values())])))
    n_months = max((len(each.months) for each in masks), default=0)
    months = [np.broadcast_to(each.months if len(each.months) else each.depths, (n_months, *each.depths.shape))
              for each in masks]  # fmt: skip
    no_depths = np.empty((0, 4), np.int32)
    return {
        "shapes": np.array([each.shape for each in masks], np.int32).reshape(-1, 4),
        "first": np.array([offsets[each.texels.ctypes.data] for each in masks], np.int64),
        "texels": np.concatenate([np.empty(0, np.uint8), *parts.values()]),
        "rows": np.cumsum([0, *(len(each.depths) for each in masks)])[:-1],
        "depths": np.concatenate([no_depths, *(each.depths for each in masks)]),
        "months": np.concatenate([np.broadcast_to(no_depths, (n_months, 0, 4)), *months], axis=1),
    }


def masks_in(cutouts: Cutouts) -> list[TexelMask]:
    """The masks of cut-outs, in order."""
    ends = np.append(cutouts.rows, len(cutouts.depths))
    masks = list[TexelMask]()
    for shape, first, begin, end in zip(cutouts.shapes.tolist(), cutouts.first.tolist(), ends[:-1], ends[1:]):
        w, h, wrap_u, wrap_v = shape
        texels, months = cutouts.texels[first : first + w * h], cutouts.months[:, begin:end]
        masks.append(TexelMask((w, h, wrap_u, wrap_v), texels, cutouts.depths[begin:end], months))
    return masks


def _tables_of(mask: AlphaMask) -> NDArray[np.int32]:
    """The part of a mask in `Cutouts.depths`, (1, m, 4) int32; or in `depths` and `months`, (13, m, 4).

    Each of the two surfaces of a closed body has half of its depth, that is, the square root of its share.
    """
    shares = mask.transmittance[None]
    if mask.months is not None:
        shares = np.concatenate([shares, mask.months])
    meets = shares.mean(2, keepdims=True) <= _HALF + _ROUNDING
    depths = depths_of(np.sqrt(shares) if mask.closed else shares)
    return np.concatenate([depths, meets], axis=2).astype(np.int32)


def join_cutouts(parts: Sequence[tuple[Cutouts | None, int]]) -> Cutouts | None:
    """The cut-outs of several scenes as those of one scene, which has their faces in this order.

    parts : the cut-outs of each scene, None if all of its faces are solid, and its number of faces
    """
    if all(cutouts is None for cutouts, _ in parts):
        return None
    first = np.cumsum([0, *(n for _, n in parts)])
    each = [(_all_solid(n) if cutouts is None else cutouts) for cutouts, n in parts]
    masks = np.cumsum([0, *(len(part.shapes) for part in each)])
    texels, rows = (np.cumsum([0, *map(len, kind)]) for kind in ([c.texels for c in each], [c.depths for c in each]))
    n_months = max(len(part.months) for part in each)
    months = [part.months if len(part.months) else np.broadcast_to(part.depths, (n_months, *part.depths.shape))
              for part in each]  # fmt: skip
    return Cutouts(
        np.concatenate([part.solid + first[k] for k, part in enumerate(each)]).astype(np.int32),
        np.concatenate([part.faces + first[k] for k, part in enumerate(each)]).astype(np.int32),
        np.concatenate([part.uv for part in each]),
        np.concatenate([part.mask + masks[k] for k, part in enumerate(each)]).astype(np.int32),
        np.concatenate([part.shapes for part in each]),
        np.concatenate([part.first + texels[k] for k, part in enumerate(each)]),
        np.concatenate([part.texels for part in each]),
        np.concatenate([part.rows + rows[k] for k, part in enumerate(each)]),
        np.concatenate([part.depths for part in each]),
        np.concatenate(months, axis=1),
    )


def _all_solid(n: int) -> Cutouts:
    none = np.empty(0, np.int64)
    return Cutouts(
        np.arange(n, dtype=np.int32), none.astype(np.int32), np.empty((0, 3, 2), np.float32), none.astype(np.int32),
        np.empty((0, 4), np.int32), none, none.astype(np.uint8), none, np.empty((0, 4), np.int32),
        np.empty((0, 0, 4), np.int32),
    )  # fmt: skip


def finite_uv(uv: np.ndarray) -> NDArray[np.float32]:
    """Texture coordinates with NaN and infinity replaced, float32."""
    out: NDArray[np.float32] = np.clip(np.nan_to_num(uv, nan=0.0), -_FAR, _FAR).astype(np.float32)
    return out


def _kinds(uv: np.ndarray, mask: AlphaMask, tables: np.ndarray) -> np.ndarray:
    """(f,) int8: SOLID, CLEAR or CUT, depending on the texels in each face's bounding rectangle, in all months."""
    depths = tables[..., :3]
    solid, total = _count_texels(uv, mask, np.all(depths > DARK, axis=(0, 2)))
    clear, _ = _count_texels(uv, mask, np.all(depths == 0, axis=(0, 2)))
    return np.where(clear == total, CLEAR, np.where(solid == total, SOLID, CUT)).astype(np.int8)


def _count_texels(uv: np.ndarray, mask: AlphaMask, counts: NDArray[np.bool_]) -> tuple[np.ndarray, np.ndarray]:
    """(f,) int64 each: how many texels of each face's rectangle have values that count, and how many it has."""
    h, w = mask.texels.shape
    sums = np.zeros((h + 1, w + 1), np.int64)  # summed-area table: over all texels above and to the left
    np.cumsum(np.cumsum(counts[mask.texels], axis=0, dtype=np.int64), axis=1, out=sums[1:, 1:])
    (column_spans, n_columns), (row_spans, n_rows) = (
        _texel_spans(uv[..., k], size, mask.wrap[k]) for k, size in enumerate((w, h))
    )
    number = np.zeros(len(uv), np.int64)
    for x0, x1 in column_spans:
        for y0, y1 in row_spans:
            number += sums[y1, x1] - sums[y0, x1] - sums[y1, x0] + sums[y0, x0]
    return number, n_columns * n_rows


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
