"""The cut-outs of a store: a section after the chunks, which have the solid faces, with those that let light pass.

::

    first, rows                     (p,) int64 each: see `scene.alpha_masks.Cutouts`
    corners, uv, colours            (m, 9), (m, 6) and (m, 3) float32
    faces, mask                     (m,) int32 each
    shapes, depths, months          (p, 4), (r, 4) and (k, r, 4) int32
    texels                          (b,) uint8, zeros up to the next page

A mask of -1 is that of a face through which all light passes: no ray hits it, but sensors may lie on it.

The whole section is in memory while rays are traced. Masks are in the order of the first faces that have them, so the
bytes do not depend on the pieces in which a scene was read.
"""

import zlib
from collections.abc import Callable, Iterable, Sequence
from hashlib import sha256
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..scene.alpha_masks import DARK, Cutouts, TexelMask, mask_columns
from ..scene.materials import CLAMP, MIRROR, REPEAT
from ..scene.open_faces import CLEAR
from ..scene.scene_bounds import NEAREST
from .staging_files import CutoutColumns, Record
from .store_format import CutoutSection, StoredArray, pages

_FAR = 1e6  # largest texture coordinate
_NO_TEXTURE = np.zeros(1, np.uint8)
CUTOUT_BYTES = 320
"""Memory of a cut-out, with the trees in which it is traced."""


class ClearFaces(NamedTuple):
    """The faces of a store through which all light passes."""

    faces: NDArray[np.int32]  # (k,), ascending
    corners: NDArray[np.float32]  # (k, 9), in the recentred frame
    colours: NDArray[np.float32]  # (k, 3)


class StoredCutouts(NamedTuple):
    """The cut-outs of a store. `cutouts.solid` is empty: the solid faces are those of the chunks."""

    cutouts: Cutouts
    corners: NDArray[np.float32]  # (m, 9), in the recentred frame
    colours: NDArray[np.float32]  # (m, 3)
    clear: ClearFaces


def _columns(section: CutoutSection) -> dict[str, StoredArray]:
    """The arrays of a section, in order."""
    m, p, r, k, b = section.faces, section.masks, section.rows, section.months, section.texels
    return {
        "first": StoredArray("<i8", (p,)), "rows": StoredArray("<i8", (p,)),
        "corners": StoredArray("<f4", (m, 9)), "uv": StoredArray("<f4", (m, 6)), "colours": StoredArray("<f4", (m, 3)),
        "faces": StoredArray("<i4", (m,)), "mask": StoredArray("<i4", (m,)),
        "shapes": StoredArray("<i4", (p, 4)), "depths": StoredArray("<i4", (r, 4)),
        "months": StoredArray("<i4", (k, r, 4)),
        "texels": StoredArray("u1", (b,)),
    }  # fmt: skip


# --- Writing ----------------------------------------------------------------------------------------------------------


def ordered_masks(masks: Sequence[TexelMask], used: Iterable[NDArray[np.int32]]) -> tuple[list[TexelMask], np.ndarray]:
    """Equal masks as one, in the order in which faces use them, then the others; and the new number of each.

    Masks that no face uses lose their texels, and keep their depths, which tell how much light passes through a scene.

    used : the masks of all faces, in order
    """
    contents, order = [_content(mask) for mask in masks], dict[bytes, int]()
    for numbers in used:
        found, first = np.unique(numbers, return_index=True)
        for number in found[np.argsort(first)].tolist():
            order.setdefault(contents[number], len(order))
    numbers = np.array([order.get(content, 0) for content in contents], np.int32)
    chosen = {content: _normal(mask) for content, mask in zip(contents, masks) if content in order}
    others = [_normal(mask)._replace(shape=(1, 1, CLAMP, CLAMP), texels=_NO_TEXTURE)
              for content, mask in zip(contents, masks) if content not in order]  # fmt: skip
    unused = {_content(mask): mask for mask in others}
    ordered = [*(chosen[content] for content in order), *(unused[content] for content in sorted(unused))]
    texels = dict[bytes, NDArray[np.uint8]]()
    return [each._replace(texels=texels.setdefault(each.texels.tobytes(), each.texels)) for each in ordered], numbers


def _normal(mask: TexelMask) -> TexelMask:
    """The mask without months if it never changes."""
    changes = bool((mask.months != mask.depths).any()) if len(mask.months) else False
    return mask if changes else mask._replace(months=mask.months[:0])


def _content(mask: TexelMask) -> bytes:
    mask = _normal(mask)
    arrays = np.array(mask.shape, np.int32), mask.texels, mask.depths, mask.months
    return b"".join(sha256(np.ascontiguousarray(each).data).digest() for each in arrays)


def write_cutouts(
    stream: BinaryIO, begin: int, parts: Callable[[], Iterable[CutoutColumns]], masks: Sequence[TexelMask]
) -> CutoutSection:
    """Append a section at `begin`.

    parts : yields the cut-outs, which have the largest part of the section, anew for each of their columns
    masks : those of their numbers, from `ordered_masks`
    """
    table = mask_columns(masks)
    faces, months = sum(len(part.faces) for part in parts()), len(table["months"])
    numbers = faces, len(masks), len(table["depths"]), months, len(table["texels"])
    section, crc, size = CutoutSection(begin, 0, *numbers, 0), 0, 0
    for name, column in _columns(section).items():
        arrays = [table[name]] if name in table else (getattr(part, name) for part in parts())
        for array in arrays:
            data = np.ascontiguousarray(array, column.dtype).reshape(-1).view(np.uint8).data
            stream.write(data)
            crc, size = zlib.crc32(data, crc), size + len(data)
    padding = bytes(pages(size) - size)
    stream.write(padding)
    return section._replace(bytes=size + len(padding), crc=zlib.crc32(padding, crc))


def masks_to_record(masks: Sequence[TexelMask]) -> Record:
    """Masks as arrays of a record."""
    return {f"masks_{name}": array for name, array in mask_columns(masks).items()}


def masks_of_record(record: Record) -> Cutouts:
    """The masks of a record, as cut-outs without faces."""
    fields = {name: record[f"masks_{name}"] for name in mask_columns([])}
    none = np.empty(0, np.int32)
    return Cutouts(none, none, np.empty((0, 3, 2), np.float32), none, **fields)


# --- Reading ----------------------------------------------------------------------------------------------------------


def section_fault(section: CutoutSection, most_faces: int) -> str:
    """The first fault of a section, whose fields may be anything, in words; "" if there is none."""
    if not all(type(each) is int and 0 <= each < 1 << 62 for each in section):
        return "its cut-outs have no place"
    if section.faces > most_faces or section.months not in (0, 12) or (section.faces and not section.masks):
        return f"it has {section.faces} cut-outs, {section.masks} masks and {section.months} months"
    if section.bytes != pages(sum(column.bytes for column in _columns(section).values())):
        return f"its cut-outs have {section.bytes} bytes, which do not fit their counts"
    return ""


def read_cutouts(
    section: CutoutSection,
    read: Callable[[memoryview, int], int],
    box: NDArray[np.float32],
    n_triangles: int,
    damaged: Callable[[str], InputError],
) -> StoredCutouts:
    """Read and check the cut-outs of a store.

    read : fills a view with the bytes of the file from an offset on, and returns their number
    box : (2, 3), that of the scene
    damaged : makes the error about cut-outs that are damaged, from words
    """
    data = np.empty(section.bytes, np.uint8)
    try:
        n_read = read(data.data, section.offset)
    except OSError as error:
        raise damaged(f"cannot be read ({error.strerror or error})") from None
    if n_read < len(data) or zlib.crc32(data.data) != section.crc:
        raise damaged("are damaged")
    arrays, at = dict[str, np.ndarray](), 0
    for name, column in _columns(section).items():
        arrays[name] = data[at : at + column.bytes].view(column.dtype).reshape(column.shape)
        at += column.bytes
    corners, colours = arrays.pop("corners"), arrays.pop("colours")
    arrays["uv"] = arrays["uv"].reshape(-1, 3, 2)
    found = Cutouts(np.empty(0, np.int32), **arrays)
    if fault := _fault(found, corners, colours, box, n_triangles):
        raise damaged(f"are not consistent ({fault})")
    is_clear = found.mask == CLEAR
    clear = ClearFaces(found.faces[is_clear], corners[is_clear], colours[is_clear])
    if len(clear.faces):
        cut = ~is_clear
        found = found._replace(faces=found.faces[cut], uv=found.uv[cut], mask=found.mask[cut])
        corners, colours = corners[cut], colours[cut]
    return StoredCutouts(found, corners, colours, clear)


def _fault(
    cutouts: Cutouts, all_corners: np.ndarray, colours: np.ndarray, box: NDArray[np.float32], n_triangles: int
) -> str:
    """The first fault of cut-outs and clear faces whose arrays have the right sizes."""
    corners = all_corners.reshape(-1, 3)
    faces, masks = cutouts.faces, len(cutouts.shapes)
    if len(faces) and (faces[0] < 0 or faces[-1] >= n_triangles or (np.diff(faces) <= 0).any()):
        return f"their faces are not ascending ones of 0 to {n_triangles - 1}"
    if ((cutouts.mask < CLEAR) | (cutouts.mask >= masks)).any():
        return "a mask is missing"
    size = np.abs(corners)
    if not ((box[0] <= corners).all() and (corners <= box[1]).all()) or ((size > 0.0) & (size < NEAREST)).any():
        return "a corner lies outside of the scene's box"
    if not (np.abs(cutouts.uv) <= _FAR).all():
        return "a texture coordinate is too large"
    if not ((colours >= 0.0) & (colours < np.inf)).all():
        return "a colour is negative, NaN or infinite"
    return _masks_fault(cutouts)


def _masks_fault(cutouts: Cutouts) -> str:
    depths = np.concatenate([cutouts.depths.reshape(-1, 4), cutouts.months.reshape(-1, 4)])
    if ((depths[:, :3] < 0) | (depths[:, :3] > DARK + 1)).any() or (depths[:, 3] & ~1).any():
        return "a depth is out of range"
    r, b = len(cutouts.depths), len(cutouts.texels)
    for k, ((w, h, *wrap), first, row) in enumerate(zip(cutouts.shapes.tolist(), cutouts.first, cutouts.rows)):
        good = min(w, h) >= 1 and set(wrap) <= {REPEAT, CLAMP, MIRROR}
        if not good or not (0 <= first <= b - w * h) or not 0 <= row < r:
            return f"mask {k} has no place"
        if int(cutouts.texels[first : first + w * h].max()) >= r - row:
            return f"a texel of mask {k} has no depth"
    return ""
