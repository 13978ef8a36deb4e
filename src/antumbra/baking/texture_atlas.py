"""Texture sheets of a bake: UV sets of the file or an xatlas atlas, with conservative texel coverage.

Every texel whose square meets a triangle gets a sample, at the triangle's nearest point.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.progress import report_progress
from ..formats.gltf.accessors import Accessors
from .bent_surfaces import directions_of_bent
from .chart_process import ChartMesh, charts_of
from .gltf_primitives import NodePrimitive

# --- Conservative coverage --------------------------------------------------------------------------------------------


_PAIRS = 1 << 20  # pairs of texels and triangles tested at a time


class Cover(NamedTuple):
    """The samples of a square sheet's texels; texel (x, y) is x + y size, its centre (x + 1/2, y + 1/2)."""

    size: int  # texels per side
    texel: np.ndarray  # (n,) int64, the texels that have a sample, ascending
    face: np.ndarray  # (n,) int64, the face of each sample
    weights: np.ndarray  # (n, 3) float64, barycentric coordinates in [0, 1]
    overlap: float  # share of these texels whose centre is inside two faces


def cover(corners: NDArray[np.float64], size: int) -> Cover:
    """The samples of a sheet.

    Parameters
    ----------
    corners : (f, 3, 2) float64
        Corners of faces on the sheet, in texels.
    size : int

    Returns
    -------
    Cover
        Among the faces that meet a texel, the one nearest to its centre is used; the nearest point on it is the sample.
        Faces without area on the sheet have no samples.
    """
    nearest, face = np.full(size * size, np.inf, np.float32), np.full(size * size, -1, np.int64)
    inside = np.zeros(size * size, np.int32)
    for texel, of in _pairs(corners, size):
        gap, strictly = _distance(_centres(texel, size), corners[of])
        np.add.at(inside, texel[strictly], 1)
        order = np.lexsort((of, gap, texel))
        first = order[np.r_[True, np.diff(texel[order]) > 0]]
        better = first[gap[first] < nearest[texel[first]]]
        nearest[texel[better]], face[texel[better]] = gap[better], of[better]
    texel = np.flatnonzero(face >= 0)
    face = face[texel]
    overlap = np.count_nonzero(inside > 1) / max(len(texel), 1)
    return Cover(size, texel, face, closest_weights(_centres(texel, size), corners[face]), overlap)


def closest_weights(points: NDArray[np.float64], corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 3) float64: barycentric coordinates of the point in each triangle ((n, 3, 2)) nearest to a point."""
    weights, best = _barycentric(points, corners), np.zeros(len(points))
    outside = ~(weights >= 0.0).all(1)
    best[outside] = np.inf
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        t, gap = _on_segment(points, a, b)
        nearer = outside & (gap < best)
        edge = np.zeros((len(points), 3))
        edge[:, k], edge[:, (k + 1) % 3] = 1.0 - t, t
        weights[nearer], best[nearer] = edge[nearer], gap[nearer]
    return weights


def _pairs(corners: NDArray[np.float64], size: int) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield (texels, faces) for all texels that meet a face, a batch of face rows at a time."""
    area = np.abs(_cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]))
    faces = np.flatnonzero(area > 1e-12)
    low, high = corners[faces, :, 1].min(1), corners[faces, :, 1].max(1)
    first = np.clip(np.floor(low), 0, size - 1).astype(np.int64)
    rows = np.clip(np.floor(high), 0, size - 1).astype(np.int64) - first + 1
    for some in _batches(rows, _PAIRS // 4):
        of, y = _spread(faces[some], first[some], rows[some])
        x_min, x_max = _span(corners[of], y)
        meets = x_min <= x_max
        of, y, x_min, x_max = of[meets], y[meets], x_min[meets], x_max[meets]
        start = np.clip(np.floor(x_min), 0, size - 1).astype(np.int64)
        count = np.clip(np.floor(x_max), 0, size - 1).astype(np.int64) - start + 1
        for part in _batches(count, _PAIRS):
            row = np.repeat(y[part], count[part])
            face, x = _spread(of[part], start[part], count[part])
            yield row * size + x, face


def _batches(counts: NDArray[np.int64], most: int) -> Iterator[slice]:
    """Yield slices whose counts sum to about `most`."""
    ends = np.cumsum(counts)
    start = 0
    while start < len(counts):
        end = max(start + 1, int(np.searchsorted(ends, (ends[start - 1] if start else 0) + most, "right")))
        yield slice(start, end)
        start = end


def _spread(owner: np.ndarray, first: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(each owner repeated `count` times, first, first + 1, ... for each)."""
    starts = np.cumsum(count) - count
    return np.repeat(owner, count), np.arange(count.sum()) - np.repeat(starts - first, count)


def _span(corners: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The minimum and maximum x of each triangle within the row y to y + 1; an empty range if it misses the row."""
    x_min, x_max = np.full(len(y), np.inf), np.full(len(y), -np.inf)
    for k in range(3):
        a, b = corners[:, k], corners[:, (k + 1) % 3]
        rise = b[:, 1] - a[:, 1]
        steep = np.where(rise == 0.0, 1.0, rise)
        ends = np.stack([(y - a[:, 1]) / steep, (y + 1 - a[:, 1]) / steep])
        level = (a[:, 1] >= y) & (a[:, 1] <= y + 1)
        low = np.where(rise == 0.0, np.where(level, 0.0, 2.0), np.maximum(ends.min(0), 0.0))
        high = np.where(rise == 0.0, 1.0, np.minimum(ends.max(0), 1.0))
        for t in (low, high):
            x = np.where(low <= high, a[:, 0] + t * (b[:, 0] - a[:, 0]), np.nan)
            x_min, x_max = np.fmin(x_min, x), np.fmax(x_max, x)
    return x_min, x_max


def _distance(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(float32 distance of points from triangles, whether they are inside by more than rounding error)."""
    weights = _barycentric(points, corners)
    gap = np.full(len(points), np.inf)
    for k in range(3):
        gap = np.minimum(gap, _on_segment(points, corners[:, k], corners[:, (k + 1) % 3])[1])
    inside = (weights >= 0.0).all(1)
    return np.where(inside, 0.0, gap).astype(np.float32), inside & (gap > 1e-6)


def _barycentric(points: np.ndarray, corners: np.ndarray) -> np.ndarray:
    a, b, c = (corners[:, k] for k in range(3))
    area = _cross(b - a, c - a)
    v, w = _cross(points - a, c - a) / area, _cross(b - a, points - a) / area
    return np.stack([1.0 - v - w, v, w], 1)


def _on_segment(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(t, squared distance) of the point a + t (b - a) on each segment nearest to a point."""
    along, from_a = b - a, points - a
    length = (along * along).sum(1)
    t = np.clip((from_a * along).sum(1) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
    gap = from_a - t[:, None] * along
    return t, (gap * gap).sum(1)


def _centres(texel: np.ndarray, size: int) -> np.ndarray:
    return np.stack([texel % size + 0.5, texel // size + 0.5], 1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


# --- Sheets, one per image --------------------------------------------------------------------------------------------


PADDING = 4
"""Texels between the charts of an atlas: more than the radius of the filter and of bilinear lookups."""

_OUTSIDE = 1e-4
OVERLAP = 0.005
"""Tolerated share of a sheet's texels in which faces overlap: charts touch, and rounding makes them overlap."""


class Unwrapped(NamedTuple):
    """A part on a sheet."""

    part: NodePrimitive
    uv: np.ndarray  # (v, 2) float64 in [0, 1], from the top left
    faces: np.ndarray  # (f, 3) into `uv`, in the order of the part's faces
    source: np.ndarray  # (v,) the part's vertex of each row of `uv`


class AtlasSheet(NamedTuple):
    """Parts that share an image."""

    members: list[int]  # indices of parts
    unwrapped: list[Unwrapped]  # one per part
    cover: Cover


def atlas(parts: Sequence[NodePrimitive], size: int) -> list[AtlasSheet]:
    """One sheet with all parts, which xatlas divides into charts. Texels have about the same size everywhere.

    Raises InputError if xatlas cannot divide them.
    """
    middle = np.mean([p.positions.mean(0) for p in parts], 0)
    with report_progress("unwrapping"):
        pieces = [_pieces(part, middle) for part in parts]
        charts = iter(charts_of([piece.mesh for each in pieces for piece in each], size, PADDING))
        unwrapped = [_joined(part, each, [next(charts) for _ in each]) for part, each in zip(parts, pieces)]
    return [AtlasSheet(list(range(len(parts))), unwrapped, _cover_sheet(unwrapped, size))]


class _Piece(NamedTuple):
    """Faces of a part that are unwrapped as one mesh."""

    faces: NDArray[np.int64]  # indices of the part's faces
    vertices: NDArray[np.int64]  # indices of the part's vertices
    mesh: tuple[NDArray[np.float32], NDArray[np.uint32]]  # positions and faces


def _pieces(part: NodePrimitive, middle: NDArray[np.float64]) -> list[_Piece]:
    direction, pieces = directions_of_bent(part.positions, part.faces), []
    for each in np.unique(direction):
        faces = np.flatnonzero(direction == each)
        vertices, corners = np.unique(part.faces[faces], return_inverse=True)
        positions = (part.positions[vertices] - middle).astype(np.float32)
        pieces.append(_Piece(faces, vertices, (positions, corners.reshape(-1, 3).astype(np.uint32))))
    return pieces


def _joined(part: NodePrimitive, pieces: Sequence[_Piece], charts: Sequence[ChartMesh]) -> Unwrapped:
    starts = np.cumsum([0, *(len(chart.uv) for chart in charts)])
    faces = np.empty((len(part.faces), 3), np.int64)
    for piece, chart, start in zip(pieces, charts, starts):
        faces[piece.faces] = chart.faces + start
    source = np.concatenate([piece.vertices[chart.source] for piece, chart in zip(pieces, charts)])
    return Unwrapped(part, np.concatenate([chart.uv for chart in charts]), faces, source)


def uv_set_sheets(parts: Sequence[NodePrimitive], accessors: Accessors, uv_set: int, size: int) -> list[AtlasSheet]:
    """Sheets for a UV set of the file: one for all parts if they do not overlap, else one per part.

    Raises
    ------
    InputError
        If a part has no such set, its coordinates leave [0, 1], or it overlaps itself.
    """
    unwrapped = [_set_of(part, accessors, uv_set) for part in parts]
    together = _cover_sheet(unwrapped, size)
    if together.overlap <= OVERLAP:
        return [AtlasSheet(list(range(len(parts))), unwrapped, together)]
    sheets = []
    for i, one in enumerate(unwrapped):
        alone = _cover_sheet([one], size)
        if alone.overlap > OVERLAP:
            raise InputError(
                f"{one.part.where}: TEXCOORD_{uv_set} overlaps itself in {100 * alone.overlap:.1f} % of its texels; "
                "choose another --uv, or leave it out for an atlas"
            )
        sheets.append(AtlasSheet([i], [one], alone))
    return sheets


def corners_of(unwrapped: Sequence[Unwrapped], values: Sequence[np.ndarray]) -> np.ndarray:
    """(f, 3, k): vertex values of parts, gathered at the corners of all their faces."""
    return np.concatenate([rows[one.source][one.faces] for one, rows in zip(unwrapped, values)])


def chart_of_faces(unwrapped: Sequence[Unwrapped]) -> NDArray[np.int64]:
    """(f,) int64: the chart of each face; faces of a chart are connected by vertices on the sheet and in space."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    charts, start = [], 0
    for one in unwrapped:
        places = np.concatenate([one.uv, one.part.positions[one.source]], 1)  # charts may touch on the sheet alone
        _, same = np.unique(places, axis=0, return_inverse=True)
        faces, n = same.reshape(-1)[one.faces], int(same.max()) + 1
        edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]]])
        count, labels = connected_components(coo_array((np.ones(len(edges), bool), edges.T), (n, n)), directed=False)
        charts.append(labels[faces[:, 0]].astype(np.int64) + start)
        start += count
    return np.concatenate(charts)


def _cover_sheet(unwrapped: Sequence[Unwrapped], size: int) -> Cover:
    return cover(np.concatenate([one.uv[one.faces] for one in unwrapped]) * size, size)


def _set_of(part: NodePrimitive, accessors: Accessors, uv_set: int) -> Unwrapped:
    name, attributes = f"TEXCOORD_{uv_set}", part.json["attributes"]
    if name not in attributes:
        sets = ", ".join(k[9:] for k in sorted(attributes) if k.startswith("TEXCOORD_"))
        available = f"it has the UV sets {sets}; " if sets else "it has none; "
        raise InputError(f"{part.where} has no {name}; {available}leave --uv out for an atlas")
    uv = accessors.finite(attributes[name], "VEC2")[part.rows]
    if uv.min() < -_OUTSIDE or uv.max() > 1.0 + _OUTSIDE:
        low, high = uv.min(), uv.max()
        raise InputError(
            f"{part.where}: {name} reaches from {low:.3g} to {high:.3g}, beyond 0 to 1, so texels repeat; choose "
            "another --uv, or leave it out for an atlas"
        )
    return Unwrapped(part, np.clip(uv, 0.0, 1.0), part.faces.astype(np.int64), np.arange(len(uv)))
