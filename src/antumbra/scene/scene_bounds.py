"""Scene bounds and the recentred frame: its origin, the coordinates it can hold, and the extent of the detail.

`Survey` accumulates the bounds piece by piece. A sample of the faces gives the extent of the detail and the up axis.
"""

from collections.abc import Iterable
from itertools import count

import numpy as np

from ..errors import InputError
from .mesh import Piece, Source

# --- The recentred frame of a scene: its zero, and which coordinates it holds -----------------------------------------


MAX_EXTENT = 1e18
"""Largest extent of a scene, in its own units. Areas of its boxes stay finite in float32."""


MIN_EXTENT = 2.0**-100
"""Least extent of a scene with more than one point, in its own units."""

NEAREST = 2.0**-110
"""Coordinates in the frame are 0 or of at least this magnitude, so that the tracers' error bounds cover underflow."""


def flush_to_zero(local: np.ndarray) -> np.ndarray:
    """Coordinates in a frame, with those below NEAREST set to 0."""
    return np.where(np.abs(local) < NEAREST, local.dtype.type(0.0), local)


def frame_origin(lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """World position ((3,) float64) of the zero of the frame for the bounds `lower`, `upper` ((3,) float64).

    The origin is the middle of the bounds, rounded to a whole number of steps above `lower`. The step is 2**-20
    times the largest power of two not above the widest extent. If a scene moves by an offset that float64 adds
    exactly, such as metres of a map grid, the frame moves by the same offset. The scene's float32 coordinates stay
    the same.
    """
    extent = (upper - lower).max()
    if not extent > 1e-200:
        return lower.copy()
    exponent = int(np.frexp(extent)[1]) - 1  # floor(log2(extent))
    step = np.ldexp(1.0, exponent - 20)
    return lower + np.round((upper - lower) / 2.0 / step) * step


# --- The bounds of a scene, from its pieces one after the other -------------------------------------------------------


def faces_of(piece: Piece) -> int:
    """The number of faces of each copy."""
    return piece.vertices.shape[1] // 3 if piece.faces is None else len(piece.faces)


def objects_of(pieces: Iterable[Piece]) -> np.ndarray:
    """(n,) int32: the object of each face of the pieces, in their order."""
    ids = [np.empty(0, np.int32)]
    for piece in pieces:
        if piece.owners is not None:
            ids.append(piece.owners)
            continue
        copies = np.arange(piece.first, piece.first + len(piece.vertices), dtype=np.int32)
        ids.append(np.repeat(copies, faces_of(piece)))
    return np.concatenate(ids)


def check_extent(bounds: np.ndarray, file: str) -> None:
    """Raise InputError if a scene with these bounds, (2, 3) float64, is too large or too small; `file` names it."""
    lower, upper = bounds
    if not (upper - lower <= MAX_EXTENT).all():
        raise InputError(
            f"{file}: the scene reaches from {lower.tolist()} to {upper.tolist()}; "
            f"it must be finite and at most {MAX_EXTENT:g} units wide"
        )
    extent = (upper - lower).max()
    if 0.0 < extent < MIN_EXTENT:
        raise InputError(
            f"{file}: the scene is {extent:.3g} units wide; float32 does not hold triangles of scenes below "
            f"{MIN_EXTENT:.2g} units: multiply all coordinates by a power of two"
        )


class Survey:
    """The number of triangles and the bounds of all added pieces; `file` names them in errors."""

    def __init__(self, file: str):
        self.file, self.n_triangles = file, 0
        self._lower, self._upper = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, piece: Piece) -> None:
        """Count a piece that does not move."""
        count = len(piece.vertices) * faces_of(piece)
        if count:
            self._lower = np.minimum(self._lower, piece.vertices.min(axis=(0, 1)))  # NaN stays, and fails in `bounds`
            self._upper = np.maximum(self._upper, piece.vertices.max(axis=(0, 1)))
        self.n_triangles += count

    def bounds(self) -> np.ndarray:
        """(2, 3) float64: lower and upper corner.

        Raises
        ------
        InputError
            If there are no triangles, or the scene is too large or too small.
        """
        if self.n_triangles == 0:
            raise InputError(f"{self.file}: no triangles; export the scene with its meshes triangulated")
        bounds = np.stack([self._lower, self._upper])
        check_extent(bounds, self.file)
        return bounds


# --- What a scene shows, from a sample of its faces: the extent of its detail, and the axis that points up ------------


MAX_SAMPLED_FACES = 50_000
"""Faces of a sample, at most."""

_FEW = 200  # triangles; scenes with fewer have no outliers
_RARE = 0.02  # share of the triangles that may lie outside of the box of the detail, at each of its sides
_FAR, _AROUND = 1.0, 0.5  # the box ends at a side of the scene if it is nearer than _FAR extents, or else after _AROUND
_MOMENTS = 5  # of an animation


def sampled_faces(source: Source, n_triangles: int, time: float = 0.0) -> np.ndarray:
    """(m, 3, 3) float64, world: every k-th face of a scene at a time, at most about `MOST`."""
    step, first, found = -(-n_triangles // MAX_SAMPLED_FACES), 0, [np.empty((0, 3, 3))]
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


def guess_z_up(faces: np.ndarray) -> bool:
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
