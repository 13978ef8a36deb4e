"""Values at the texels of a sheet, and the image that viewers interpolate."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...picture.discontinuity_filter import filter_fractions
from ...progress import report_progress
from ...query.gbuffer import PictureSurfaces
from ...query.receivers import NOTHING
from .charts import Sheet, Unwrapped, chart_of_faces, corners_of
from .hidden import Solids
from .measure import SIDE, Measurement, Meter, SurfacePoints, nearby
from .parts import face_vectors
from .texels import Cover, closest_weights
from .vertices import suspects

_REACH = 2  # texels, of the filter
_PLACES = np.array([-0.4, 0.0, 0.4])  # of other samples in a hidden texel, from its centre


class Surface(NamedTuple):
    """The faces of a sheet in the world."""

    positions: np.ndarray  # (f, 3, 3) float64, corners
    normals: np.ndarray  # (f, 3, 3) float64, at the corners, unit
    uv: np.ndarray  # (f, 3, 2) float64, corners in texels


def surface_of(sheet: Sheet) -> Surface:
    """The faces of a sheet; faces of parts without NORMAL are flat, as viewers show them."""
    positions = corners_of(sheet.unwrapped, [one.part.positions for one in sheet.unwrapped])
    normals = np.concatenate([_corner_normals(one) for one in sheet.unwrapped])
    uv = np.concatenate([one.uv[one.faces] for one in sheet.unwrapped]) * sheet.cover.size
    return Surface(positions, normals, uv)


def receivers_at(surface: Surface, face: np.ndarray, weights: np.ndarray) -> SurfacePoints:
    """Points on faces. On smooth surfaces they lie on the curve that the normals describe, not on the facets.

    So facets that bulge do not shade their neighbours [Hanika 2021].
    """
    corners, normals = surface.positions[face], surface.normals[face]
    points = np.einsum("nk,nki->ni", weights, corners)
    normal = np.einsum("nk,nki->ni", weights, normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    below = np.minimum(np.einsum("nki,nki->nk", points[:, None] - corners, normals), 0.0)
    return SurfacePoints(points - np.einsum("nk,nk,nki->ni", weights, below, normals), normal)


class Texels:
    """The texels of a sheet, and their measurement.

    denoise : whether the filter smooths them
    folder : where parts are kept; None: in memory
    """

    def __init__(self, sheet: Sheet, meter: Meter, denoise: bool, folder: Path | None = None):
        self._sheet, self._meter, self._denoise = sheet, meter, denoise
        self._surface = surface_of(sheet)
        receivers = receivers_at(self._surface, sheet.cover.face, sheet.cover.weights)
        self._asked = Measurement(meter, receivers, texel_blocks(sheet.cover, receivers.positions), denoise, folder)
        self.parts = self._asked.parts

    def values(self, solids: Solids | None) -> tuple[np.ndarray, int]:
        """((n, c) float32 of the texels of the sheet's cover, number of texels that nobody sees), from all parts.

        A texel inside a solid is sampled elsewhere in its square. If all of it is inside, it is NaN.
        """
        values, receivers = self._asked.result(), self._asked.receivers
        sheet, surface, meter = self._sheet, self._surface, self._meter
        if self._denoise:
            values = np.mean([_smoothed(sheet, surface, receivers, c, meter) for c in values.T], 0)[:, None]
        if solids is None:
            return values, 0
        with report_progress("moving hidden texels"):
            hidden = np.flatnonzero(suspects(values, meter))
            hidden = hidden[solids.hold(receivers.at(hidden))]
            return values, _push_out(values, hidden, sheet.cover, surface, meter, solids)


def texel_blocks(cover: Cover, positions: np.ndarray) -> np.ndarray:
    """(m, 16) int64: the samples of squares of 4 x 4 texels, -1 where a texel has none."""
    across = -(-cover.size // SIDE)
    x, y = cover.texel % cover.size, cover.texel // cover.size
    blocks, of = np.unique(y // SIDE * across + x // SIDE, return_inverse=True)
    places = np.full((len(blocks), SIDE * SIDE), -1)
    places[of.reshape(-1), y % SIDE * SIDE + x % SIDE] = np.arange(len(cover.texel))
    return nearby(places, positions) if len(places) else places


def image_of(cover: Cover, values: np.ndarray) -> np.ndarray:
    """(size, size, c) float32: texels without a value have that of the nearest texel that has one."""
    from scipy.ndimage import distance_transform_edt

    texels = np.full((cover.size * cover.size, values.shape[1]), np.nan, np.float32)
    texels[cover.texel] = values
    image = texels.reshape(cover.size, cover.size, -1)
    empty = np.isnan(image[..., 0])
    if empty.all():
        return np.ones_like(image)
    y, x = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return image[y, x]


def looked_up(image: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, c): an image (h, w, c) at (n, 2) texture coordinates, bilinear, clamped at its edges."""
    h, w = image.shape[:2]
    x, y = np.clip(uv[:, 0] * w - 0.5, 0.0, w - 1), np.clip(uv[:, 1] * h - 0.5, 0.0, h - 1)
    i, k = np.minimum(x.astype(int), max(w - 2, 0)), np.minimum(y.astype(int), max(h - 2, 0))
    s, t = (x - i)[:, None], (y - k)[:, None]
    i1, k1 = np.minimum(i + 1, w - 1), np.minimum(k + 1, h - 1)
    above = (1.0 - s) * image[k, i] + s * image[k, i1]
    return (1.0 - t) * above + t * ((1.0 - s) * image[k1, i] + s * image[k1, i1])


def seam_differences(sheet: Sheet, image: np.ndarray) -> np.ndarray:
    """(n,) float64: how much the image differs between the two sides of a seam, at points along all seams.

    A seam is an edge where two charts meet on a smooth surface. A hard edge is none: its sides face apart.
    """
    surface = surface_of(sheet)
    _, corner = np.unique(surface.positions.reshape(-1, 3).astype(np.float32), axis=0, return_inverse=True)
    corner = corner.reshape(-1, 3)
    a, b = (np.concatenate([corner[:, [k, (k + 1) % 3][e]] for k in range(3)]) for e in (0, 1))
    side = {name: [np.concatenate([v[:, [k, (k + 1) % 3][e]] for k in range(3)]) for e in (0, 1)]
            for name, v in (("uv", surface.uv), ("normal", surface.normals))}  # fmt: skip
    swap = a > b
    key = np.where(swap, b, a) * (int(corner.max()) + 1) + np.where(swap, a, b)
    for pair in side.values():
        pair[0], pair[1] = (np.where(swap[:, None], pair[1 - e], pair[e]) for e in (0, 1))
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    one, other = order[same], order[same + 1]
    apart = np.abs(side["uv"][0][one] - side["uv"][0][other]).max(1) + np.abs(
        side["uv"][1][one] - side["uv"][1][other]
    ).max(1)
    aligned = [(side["normal"][e][one] * side["normal"][e][other]).sum(1) > 0.999 for e in (0, 1)]
    seam = (apart > 1e-3) & aligned[0] & aligned[1]
    one, other, found = one[seam], other[seam], []
    for t in (0.25, 0.5, 0.75):
        along = ((1.0 - t) * side["uv"][0] + t * side["uv"][1]) / sheet.cover.size
        found.append(np.abs(looked_up(image, along[one]) - looked_up(image, along[other])).max(1))
    return np.concatenate(found)


def _corner_normals(one: Unwrapped) -> np.ndarray:
    part = one.part
    if not part.flat:
        return part.normals[one.source][one.faces]
    vectors = face_vectors(part.positions, part.faces) * part.sign
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit = np.where(length > 0.0, vectors / np.maximum(length, 1e-300), part.normals[part.faces[:, 0]])
    return np.repeat(unit[:, None], 3, 1)


def _push_out(
    values: np.ndarray, hidden: np.ndarray, cover: Cover, surface: Surface, meter: Meter, solids: Solids
) -> int:
    """Sample hidden texels beside visible ones at other places of their squares, the nearest to the centre first.

    The texels that stay hidden become NaN. Returns how many these are.
    """
    inside = np.zeros(len(values), bool)
    inside[hidden] = True
    if inside.all():  # a room whose walls face outward
        return len(values)
    hidden = np.flatnonzero(inside & _beside(cover, ~inside))
    dx, dy = np.meshgrid(_PLACES, _PLACES)
    offsets = np.stack([dx.ravel(), dy.ravel()], 1)
    offsets = offsets[np.argsort((offsets**2).sum(1), kind="stable")][1:]
    for offset in offsets:
        if not len(hidden):
            break
        texel, face = cover.texel[hidden], cover.face[hidden]
        places = np.stack([texel % cover.size, texel // cover.size], 1) + 0.5 + offset
        points = receivers_at(surface, face, closest_weights(places, surface.uv[face]))
        seen = ~solids.hold(points)
        values[hidden[seen]] = meter.values(points.at(seen))
        inside[hidden[seen]] = False
        hidden = hidden[~seen]
    values[inside] = np.nan
    return int(inside.sum())


def _beside(cover: Cover, which: np.ndarray) -> np.ndarray:
    """(n,) bool: the texels that touch one of `which` ((n,) bool)."""
    from scipy.ndimage import binary_dilation

    picture = _scattered(cover, which, False, (cover.size, cover.size))
    return binary_dilation(picture, np.ones((3, 3), bool)).reshape(-1)[cover.texel]


def _smoothed(sheet: Sheet, surface: Surface, receivers: SurfacePoints, counts: np.ndarray, meter: Meter) -> np.ndarray:
    """(n,) float32: the share of a light that is visible, by the discontinuity filter over texels of one chart."""
    cover, spp = sheet.cover, meter.asked.spp
    shape = cover.size, cover.size
    picture = lambda values, like: _scattered(cover, values, like, shape)
    width = _texel_width(surface)[cover.face]
    seen = PictureSurfaces(
        picture((receivers.positions - meter.scene.origin).astype(np.float32), np.float32(0)),
        picture(receivers.normals.astype(np.float32), np.float32(0)),
        picture(cover.face.astype(np.int32), np.int32(-1)),
        picture(width.astype(np.float32), np.float32(0)),
        picture(np.ones(len(width), np.int8), np.int8(NOTHING)),
        np.float32(1.0),  # type: ignore[arg-type]
    )
    smooth = filter_fractions(seen, picture(counts, np.int32(0)), spp, meter.asked.threads).reshape(-1)[cover.texel]
    return np.where(_beside_others(sheet), np.float32(1.0) - counts / np.float32(spp), smooth).astype(np.float32)


def _beside_others(sheet: Sheet) -> np.ndarray:
    """(n,) bool: texels with another chart within reach of the filter."""
    from scipy.ndimage import maximum_filter, minimum_filter

    cover = sheet.cover
    charts = chart_of_faces(sheet.unwrapped)[cover.face]
    shape, window = (cover.size, cover.size), 2 * _REACH + 1
    most = maximum_filter(_scattered(cover, charts, -1, shape), window, mode="nearest")
    least = minimum_filter(_scattered(cover, charts, np.iinfo(np.int64).max, shape), window, mode="nearest")
    return (most != least).reshape(-1)[cover.texel]


def _scattered(cover: Cover, values: np.ndarray, background, shape: Sequence[int]) -> np.ndarray:
    out = np.full((shape[0] * shape[1], *values.shape[1:]), background, values.dtype)
    out[cover.texel] = values
    return out.reshape(*shape, *values.shape[1:])


def _texel_width(surface: Surface) -> np.ndarray:
    """(f,) float64: the width of a texel of each face in the world."""
    a, b, c = (surface.positions[:, k] for k in range(3))
    p, q = surface.uv[:, 1] - surface.uv[:, 0], surface.uv[:, 2] - surface.uv[:, 0]
    texels = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    return np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(texels, 1e-12))
