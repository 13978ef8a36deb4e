"""What a scene shows, from a sample of its faces: the extent of its detail, and the axis that points up."""

from itertools import count

import numpy as np

from .source import Piece, Source
from .survey import faces_of

MOST = 50_000
"""Faces of a sample, at most."""

_FEW = 200  # triangles; scenes with fewer have no outliers
_RARE = 0.02  # share of the triangles that may lie outside of the box of the detail, at each of its sides
_FAR, _AROUND = 1.0, 0.5  # the box ends at a side of the scene if it is nearer than _FAR extents, or else after _AROUND
_MOMENTS = 5  # of an animation


def sampled_faces(source: Source, n_triangles: int, time: float = 0.0) -> np.ndarray:
    """(m, 3, 3) float64, world: every k-th face of a scene at a time, at most about `MOST`."""
    step, first, found = -(-n_triangles // MOST), 0, [np.empty((0, 3, 3))]
    for piece in source.pieces(time):
        n, copies = faces_of(piece), len(piece.vertices)
        chosen = np.arange(-first % step, n * copies, step)
        first += n * copies
        found.append(_corners(piece, *np.divmod(chosen, max(n, 1))))
    return np.concatenate(found)


def _corners(piece: Piece, copies: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(m, 3, 3) float64: the corners of some faces of some copies."""
    corners = 3 * faces[:, None] + np.arange(3) if piece.faces is None else piece.faces[faces]
    found = piece.vertices[copies[:, None], corners].astype(np.float64)
    if piece.towards is None:
        return found
    return (1.0 - piece.share) * found + piece.share * piece.towards[copies[:, None], corners]


def moving_faces(source: Source, n_triangles: int) -> np.ndarray:
    """(m, 3, 3) float64, world: `sampled_faces` of moments that are spread over the animation."""
    moments = _MOMENTS if source.duration > 0.0 else 1
    times = (k * source.duration / max(moments - 1, 1) for k in count())
    return np.concatenate([sampled_faces(source, n_triangles * moments, t) for t, _ in zip(times, range(moments))])


def detail(faces: np.ndarray) -> np.ndarray:
    """(2, 3) float64: a box around nearly all triangles of a sample.

    Triangles count, not their area. So a wide ground of few triangles, or a lone part far away, does not enlarge it.
    """
    corners = faces.reshape(-1, 3)
    whole = np.stack([corners.min(0), corners.max(0)])
    if len(faces) < _FEW:
        return whole
    lower, upper = np.quantile(faces.mean(1), [_RARE, 1.0 - _RARE], axis=0)
    extent = upper - lower
    return np.stack(
        [
            np.where(whole[0] >= lower - _FAR * extent, whole[0], lower - _AROUND * extent),
            np.where(whole[1] <= upper + _FAR * extent, whole[1], upper + _AROUND * extent),
        ]
    )


def within(faces: np.ndarray, box: np.ndarray) -> np.ndarray:
    """(k, 3) float64: the corners of a sample that lie in a box; the box's own corners if there are none."""
    corners = faces.reshape(-1, 3)
    inside = corners[((corners >= box[0]) & (corners <= box[1])).all(1)]
    return inside if len(inside) else corners_of(box)


def corners_of(box: np.ndarray) -> np.ndarray:
    """(8, 3) float64: the corners of a box."""
    return np.stack([box[i, range(3)] for i in np.ndindex(2, 2, 2)])


def looks_z_up(faces: np.ndarray) -> bool:
    """Whether a sample of faces looks as if z pointed up.

    It does if the scene is lower along z than along y, and has far more level area facing z than facing y. Floors and
    roofs are such areas, and at least about half of them face up.
    """
    if len(faces) < _FEW:
        return False
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    areas = np.linalg.norm(normals, axis=1)
    steep = 0.99 * areas
    level = [np.abs(normals[np.abs(normals[:, axis]) > steep, axis]).sum() for axis in range(3)]
    rising = normals[normals[:, 2] > steep, 2].sum()
    lower, upper = np.quantile(faces.mean(1), [_RARE, 1.0 - _RARE], axis=0)
    height, depth = (upper - lower)[2], (upper - lower)[1]
    floors = level[2] > max(1.5 * level[1], 0.15 * areas.sum()) and rising > 0.4 * level[2]
    return bool(floors and 0.0 < height < 0.9 * depth)
