"""Baked values at vertices and texels, with values inside solids replaced, and the images of texels.

Points inside solids are never visible, but interpolation would spread their darkness.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import report_progress
from ..base.wording import counted
from ..picture.discontinuity_filter import filter_fractions
from ..query.receivers import NOTHING
from ..query.surface_links import PictureSurfaces
from ..scene.lights import AmbientOcclusion
from .gltf_primitives import NodePrimitive
from .smooth_normals import face_vectors
from .solids import Solids
from .surface_meter import SIDE, Measurement, Meter, ReceiverPoints, curve_order
from .texture_atlas import OVERLAP, AtlasSheet, Cover, Unwrapped, chart_of_faces, closest_weights, corners_of

# --- Vertices ---------------------------------------------------------------------------------------------------------


_TOWARDS = 0.125, 0.25, 0.5, 0.75, 1.0  # fractions of the way from a hidden vertex to the centre of a face


class AllFaces(NamedTuple):
    """The faces of all parts, indexing the vertices of all parts."""

    faces: np.ndarray  # (f, 3) int64
    areas: np.ndarray  # (f,) float64, twice the area
    normals: np.ndarray  # (f, 3) float64, unit, outward


def vertex_receivers(parts: Sequence[NodePrimitive]) -> ReceiverPoints:
    """The vertices of all parts, concatenated."""
    return ReceiverPoints(np.concatenate([p.positions for p in parts]), np.concatenate([p.normals for p in parts]))


def replace_hidden(
    values: np.ndarray, receivers: ReceiverPoints, parts: Sequence[NodePrimitive], meter: Meter, solids: Solids | None
) -> int:
    """Replace the values of vertices inside solids; return the number of these vertices.

    values : (n, c) float32, measured at the vertices of all parts
    solids : None: vertices inside solids keep their values
    """
    if solids is None:
        return 0
    with report_progress("moving hidden points"):
        candidates = np.flatnonzero(may_be_hidden(values, meter))
        hidden = candidates[solids.contain(receivers.at(candidates))]
        if len(hidden):
            _replace(values, hidden, receivers, faces_of(parts), meter, solids)
    return len(hidden)


def may_be_hidden(values: NDArray[np.float32], meter: Meter) -> NDArray[np.bool_]:
    """(n,) bool: receivers that may be inside a solid, since no ray escapes; all of them if rays may end at a radius.

    Bent normals do not show whether rays escape, so all receivers are candidates then, too.
    """
    what, light = meter.settings.what, meter.settings.lights[0]
    if what == "bent-normal" or (isinstance(light, AmbientOcclusion) and light.radius is not None):
        return np.ones(len(values), bool)
    return np.asarray((values <= 1.0 / meter.settings.spp).all(-1))


def faces_of(parts: Sequence[NodePrimitive]) -> AllFaces:
    """The faces of all parts, in their order."""
    starts = np.cumsum([0, *(len(p.positions) for p in parts)])
    vectors = np.concatenate([face_vectors(p.positions, p.faces) * p.sign for p in parts])
    areas = np.linalg.norm(vectors, axis=1)
    faces = np.concatenate([p.faces.astype(np.int64) + start for p, start in zip(parts, starts)])
    return AllFaces(faces, areas, vectors / np.maximum(areas, 1e-300)[:, None])


def _replace(
    values: np.ndarray, hidden: np.ndarray, receivers: ReceiverPoints, all_faces: AllFaces, meter: Meter, solids: Solids
) -> None:
    """Give hidden vertices the area-weighted mean of the nearest visible points on the faces around them.

    A vertex whose faces are also hidden keeps its value, since it is never visible.
    """
    pending = np.zeros(len(values), bool)
    pending[hidden] = True
    for share in _TOWARDS:
        face, corner = np.nonzero(pending[all_faces.faces] & (all_faces.areas > 0.0)[:, None])
        if not len(face):
            return
        vertex = all_faces.faces[face, corner]
        centre = receivers.positions[all_faces.faces[face]].mean(1)
        points = ReceiverPoints((1.0 - share) * receivers.positions[vertex] + share * centre, all_faces.normals[face])
        visible = ~solids.contain(points)
        if visible.any():
            measured, weight = meter.values(points.at(visible)), all_faces.areas[face[visible]]
            total = np.bincount(vertex[visible], weight, len(values))
            done = pending & (total > 0.0)
            for c in range(values.shape[1]):
                sums = np.bincount(vertex[visible], weight * measured[:, c], len(values))
                values[done, c] = sums[done] / total[done]
            pending &= ~done


# --- Texels -----------------------------------------------------------------------------------------------------------


_REACH = 2  # radius of the filter, texels
_SMOOTHINGS = 2  # passes over light that varies slowly
_WINDOW = 25  # texels of a pass
_RADIUS = 3.0  # their greatest distance, in texels
_FACING = 0.8  # the least cosine of their normals
_BATCH = 1 << 16
_INSET = 1.0 / 32.0  # least distance of samples from the edges of their faces, in texels
_MOST_INSET = 1.0 / 6.0  # of the height of a face
_PLACES = np.array([-0.4, 0.0, 0.4])  # offsets of alternative samples from the centre of a hidden texel


class SheetSurface(NamedTuple):
    """The faces of a sheet in world space."""

    positions: np.ndarray  # (f, 3, 3) float64, corners
    normals: np.ndarray  # (f, 3, 3) float64, at the corners, unit
    uv: np.ndarray  # (f, 3, 2) float64, corners in texels


def surface_of(sheet: AtlasSheet) -> SheetSurface:
    """The faces of a sheet; faces of parts without NORMAL are flat, as viewers shade them."""
    positions = corners_of(sheet.unwrapped, [one.part.positions for one in sheet.unwrapped])
    normals = np.concatenate([_corner_normals(one) for one in sheet.unwrapped])
    uv = np.concatenate([one.uv[one.faces] for one in sheet.unwrapped]) * sheet.cover.size
    return SheetSurface(positions, normals, uv)


def texel_receivers(surface: SheetSurface, face: np.ndarray, weights: np.ndarray) -> ReceiverPoints:
    """Points on faces. On smooth surfaces they lie on the curve described by the normals, not on the facets.

    Bulging facets therefore do not shadow their neighbours [Hanika 2021]. No point lies on an edge of its face, where
    another surface may begin: rays that start on a wall would pass it.
    """
    corners, normals = surface.positions[face], surface.normals[face]
    weights = _off_edges(weights, surface.uv[face])
    points = np.einsum("nk,nki->ni", weights, corners)
    normal = np.einsum("nk,nki->ni", weights, normals)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    below = np.minimum(np.einsum("nki,nki->nk", points[:, None] - corners, normals), 0.0)
    return ReceiverPoints(points - np.einsum("nk,nk,nki->ni", weights, below, normals), normal)


def _off_edges(weights: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(n, 3): barycentric coordinates of points in triangles ((n, 3, 2), in texels), a little away from all edges."""
    edges = uv[:, [2, 0, 1]] - uv[:, [1, 2, 0]]
    area = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0])[:, None]
    least = np.minimum(_INSET * np.linalg.norm(edges, axis=2) / np.maximum(area, 1e-30), _MOST_INSET)
    inside = np.maximum(weights, least)
    return np.asarray(inside / inside.sum(1, keepdims=True))


class Texels:
    """The texels of a sheet, and their measurement.

    denoise : apply the discontinuity filter
    folder : stores the parts; None: in memory
    """

    def __init__(self, sheet: AtlasSheet, meter: Meter, denoise: bool, folder: Path | None = None):
        self._sheet, self._meter, self._denoise = sheet, meter, denoise
        self._surface = surface_of(sheet)
        receivers = texel_receivers(self._surface, sheet.cover.face, sheet.cover.weights)
        self._measurement = Measurement(
            meter,
            receivers,
            texel_blocks(sheet.cover, receivers.positions),
            denoise and not meter.settings.separate,
            folder,
        )
        self.parts = self._measurement.parts

    def values(self, solids: Solids | None) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """((n, c) float32 values of the covered texels, (n,) bool: which are hidden), once all parts are done.

        A texel inside a solid is sampled elsewhere in its square. If the whole square is inside, it is hidden, and
        takes the value of the nearest visible texel of its chart. A chart without visible texels keeps its own values.
        """
        values, receivers = self._measurement.result(), self._measurement.receivers
        sheet, surface, meter = self._sheet, self._surface, self._meter
        separate = meter.settings.separate
        if self._denoise and not separate:
            values = np.mean([_smoothed(sheet, surface, receivers, c, meter) for c in values.T], 0)[:, None]
        hidden = np.zeros(len(values), bool)
        if solids is not None:
            self._replace_hidden(values, hidden, solids)
        if separate:
            lamps, others = np.split(values, 2, 1)
            values = lamps + _smoothed_light(surface, sheet.cover, receivers, others)
        return values, hidden

    def _replace_hidden(self, values: np.ndarray, hidden: np.ndarray, solids: Solids) -> None:
        """Mark hidden texels, and change their values."""
        sheet, surface, meter, receivers = self._sheet, self._surface, self._meter, self._measurement.receivers
        with report_progress("moving hidden texels"):
            candidates = np.flatnonzero(may_be_hidden(values, meter))
            hidden[candidates] = solids.contain(receivers.at(candidates))
            if hidden.any() and not hidden.all():  # all: a room whose walls face outward
                _push_out(values, hidden, sheet.cover, surface, meter, solids)
                _fill_hidden(values, hidden, sheet)


def texel_blocks(cover: Cover, positions: NDArray[np.float64]) -> NDArray[np.int64]:
    """(m, 16) int64: the samples of squares of 4 x 4 texels, -1 where a texel has none."""
    across = -(-cover.size // SIDE)
    x, y = cover.texel % cover.size, cover.texel // cover.size
    blocks, of = np.unique(y // SIDE * across + x // SIDE, return_inverse=True)
    places = np.full((len(blocks), SIDE * SIDE), -1)
    places[of.reshape(-1), y % SIDE * SIDE + x % SIDE] = np.arange(len(cover.texel))
    return curve_order(places, positions) if len(places) else places


def image_of(cover: Cover, values: NDArray[np.floating]) -> NDArray[np.float32]:
    """(size, size, c) float32: the values as an image; empty texels take the value of the nearest covered one."""
    from scipy.ndimage import distance_transform_edt

    shape = cover.size, cover.size
    image = _scattered(cover, np.asarray(values, np.float32), 1.0, shape)
    if not len(cover.texel):
        return image
    empty = _scattered(cover, np.zeros(len(cover.texel), bool), True, shape)
    y, x = distance_transform_edt(empty, return_distances=False, return_indices=True)
    return np.asarray(image[y, x])


def sample_bilinear(image: NDArray[np.float32], uv: NDArray[np.float64]) -> np.ndarray:
    """(n, c): an image (h, w, c) at (n, 2) texture coordinates, bilinear, clamped at its edges."""
    h, w = image.shape[:2]
    x, y = np.clip(uv[:, 0] * w - 0.5, 0.0, w - 1), np.clip(uv[:, 1] * h - 0.5, 0.0, h - 1)
    i, k = np.minimum(x.astype(int), max(w - 2, 0)), np.minimum(y.astype(int), max(h - 2, 0))
    s, t = (x - i)[:, None], (y - k)[:, None]
    i1, k1 = np.minimum(i + 1, w - 1), np.minimum(k + 1, h - 1)
    above = (1.0 - s) * image[k, i] + s * image[k, i1]
    return np.asarray((1.0 - t) * above + t * ((1.0 - s) * image[k1, i] + s * image[k1, i1]))


def _corner_normals(one: Unwrapped) -> np.ndarray:
    part = one.part
    if not part.flat:
        return np.asarray(part.normals[one.source][one.faces])
    vectors = face_vectors(part.positions, part.faces) * part.sign
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit = np.where(length > 0.0, vectors / np.maximum(length, 1e-300), part.normals[part.faces[:, 0]])
    return np.repeat(unit[:, None], 3, 1)


def _push_out(
    values: np.ndarray, hidden: np.ndarray, cover: Cover, surface: SheetSurface, meter: Meter, solids: Solids
) -> None:
    """Sample hidden texels beside visible ones elsewhere in their squares, starting closest to the centre.

    hidden : (n,) bool, changed: texels with such a sample are not hidden
    """
    chosen = np.flatnonzero(hidden & _beside(cover, ~hidden))
    dx, dy = np.meshgrid(_PLACES, _PLACES)
    offsets = np.stack([dx.ravel(), dy.ravel()], 1)
    offsets = offsets[np.argsort((offsets**2).sum(1), kind="stable")][1:]
    for offset in offsets:
        if not len(chosen):
            return
        texel, face = cover.texel[chosen], cover.face[chosen]
        places = np.stack([texel % cover.size, texel // cover.size], 1) + 0.5 + offset
        points = texel_receivers(surface, face, closest_weights(places, surface.uv[face]))
        visible = ~solids.contain(points)
        values[chosen[visible]] = meter.values(points.at(visible))
        hidden[chosen[visible]] = False
        chosen = chosen[~visible]


def _fill_hidden(values: np.ndarray, hidden: np.ndarray, sheet: AtlasSheet) -> None:
    """Give hidden texels the value of the nearest visible texel of their chart, if it has one."""
    from scipy.spatial import cKDTree

    size, texel = sheet.cover.size, sheet.cover.texel
    chart = chart_of_faces(sheet.unwrapped)[sheet.cover.face]
    places = np.stack([texel % size, texel // size, 4 * size * chart], 1)  # other charts are farther than the diagonal
    visible = np.flatnonzero(~hidden)
    distance, nearest = cKDTree(places[visible]).query(places[hidden], distance_upper_bound=2 * size)
    found = np.isfinite(distance)
    values[np.flatnonzero(hidden)[found]] = values[visible[nearest[found]]]


def _beside(cover: Cover, which: np.ndarray) -> np.ndarray:
    """(n,) bool: the texels that touch one of the texels `which` ((n,) bool)."""
    from scipy.ndimage import binary_dilation

    picture = _scattered(cover, which, False, (cover.size, cover.size))
    return np.asarray(binary_dilation(picture, np.ones((3, 3), bool)).reshape(-1)[cover.texel])


def _smoothed(
    sheet: AtlasSheet, surface: SheetSurface, receivers: ReceiverPoints, counts: np.ndarray, meter: Meter
) -> np.ndarray:
    """(n,) float32: the visible share of a light, by the discontinuity filter over texels of one chart."""
    cover, spp = sheet.cover, meter.settings.spp
    shape = cover.size, cover.size
    picture: Callable[[np.ndarray, Any], np.ndarray]
    picture = lambda values, background: _scattered(cover, values, background, shape)
    width = _texel_width(surface)[cover.face]
    surfaces = PictureSurfaces(
        picture((receivers.positions - meter.scene.origin).astype(np.float32), np.float32(0)),
        picture(receivers.normals.astype(np.float32), np.float32(0)),
        picture(cover.face.astype(np.int32), np.int32(-1)),
        picture(width.astype(np.float32), np.float32(0)),
        picture(np.ones(len(width), np.int8), np.int8(NOTHING)),
        np.float32(1.0),
    )
    smooth = filter_fractions(surfaces, picture(counts, np.int32(0)), spp, meter.settings.threads).reshape(-1)[
        cover.texel
    ]
    return np.where(_beside_others(sheet, _REACH), np.float32(1.0) - counts / np.float32(spp), smooth).astype(
        np.float32
    )


def _smoothed_light(surface: SheetSurface, cover: Cover, receivers: ReceiverPoints, values: np.ndarray) -> np.ndarray:
    """(n, c) float32: light that varies slowly, averaged over the texels nearest in space that face the same way.

    In space, and not on the sheet, so that both sides of a seam average the same texels.
    """
    from scipy.spatial import cKDTree

    tree, width = cKDTree(receivers.positions), _texel_width(surface)[cover.face]
    out = np.asarray(values, np.float32)
    for _ in range(_SMOOTHINGS):
        before, out = out, np.empty_like(out)
        for start in range(0, len(out), _BATCH):
            rows = slice(start, start + _BATCH)
            points, normals = receivers.at(rows)
            distance, near = tree.query(points, min(_WINDOW, len(before)))
            distance, near = distance.reshape(len(points), -1), near.reshape(len(points), -1)
            size = width[rows, None]
            off = np.abs(np.einsum("nki,ni->nk", receivers.positions[near] - points[:, None], normals))
            facing = np.einsum("nki,ni->nk", receivers.normals[near], normals)
            weight = (distance <= _RADIUS * size) * (off <= size) * (facing > _FACING)
            out[rows] = np.einsum("nk,nkc->nc", weight, before[near]) / weight.sum(1)[:, None]
    return out


def sheet_notes(sheets: Sequence[AtlasSheet], uv_set: int | None) -> list[str]:
    """Notes on texels that belong to several faces or charts.

    uv_set : the UV set of the file; None: an atlas
    """
    name, cure = "the atlas", "raise texture"
    if uv_set is not None:
        name, cure = f"TEXCOORD_{uv_set}", "leave uv out for an atlas"
    least = OVERLAP if uv_set is None else 0.0  # in an atlas, rounding folds triangles smaller than a texel
    overlaps = [(sheet.cover.overlap, len(sheet.cover.texel)) for sheet in sheets if sheet.cover.overlap > least]
    shared = sum(round(overlap * count) for overlap, count in overlaps)
    close = 0 if uv_set is None else sum(int(_beside_others(sheet, 1).sum()) for sheet in sheets)
    notes = [
        (shared, f"faces overlap in {counted(shared, 'texel')} of {name}, which have the light of one of them; {cure}"),
        (
            close,
            f"charts of {name} touch at {counted(close, 'texel')}, where light bleeds across; raise texture",
        ),
    ]
    return [note for count, note in notes if count]


def _beside_others(sheet: AtlasSheet, reach: int) -> np.ndarray:
    """(n,) bool: texels with another chart within `reach` texels."""
    from scipy.ndimage import maximum_filter, minimum_filter

    cover = sheet.cover
    charts = chart_of_faces(sheet.unwrapped)[cover.face]
    shape, window = (cover.size, cover.size), 2 * reach + 1
    above = int(charts.max(initial=-1)) + 1  # scipy computes in float64, so no greatest int64
    most = maximum_filter(_scattered(cover, charts, -1, shape), window, mode="nearest")
    least = minimum_filter(_scattered(cover, charts, above, shape), window, mode="nearest")
    return np.asarray((most != least).reshape(-1)[cover.texel])


def _scattered(cover: Cover, values: np.ndarray, background: Any, shape: Sequence[int]) -> np.ndarray:
    """The values of covered texels as an image, with `background` elsewhere."""
    out = np.full((shape[0] * shape[1], *values.shape[1:]), background, values.dtype)
    out[cover.texel] = values
    return out.reshape(*shape, *values.shape[1:])


def _texel_width(surface: SheetSurface) -> np.ndarray:
    """(f,) float64: the world-space width of a texel of each face."""
    a, b, c = (surface.positions[:, k] for k in range(3))
    p, q = surface.uv[:, 1] - surface.uv[:, 0], surface.uv[:, 2] - surface.uv[:, 0]
    texels = np.abs(p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0])
    return np.asarray(np.sqrt(np.linalg.norm(np.cross(b - a, c - a), axis=1) / np.maximum(texels, 1e-12)))
