"""Scene bounds, the origin and coordinate range of the recentred frame, the box of the detail, and the up axis.

`Survey` accumulates the bounds piece by piece. The detail box and the up axis are estimated from a sample of the faces.
"""

from collections.abc import Iterable
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from .mesh import Piece, Source

# --- The recentred frame ----------------------------------------------------------------------------------------------


MAX_EXTENT = 1e18
"""Largest extent of a scene, in scene units. Surface areas of its boxes stay finite in float32."""


MIN_EXTENT = 2.0**-100
"""Smallest extent of a scene with more than one point, in scene units."""

NEAREST = 2.0**-110
"""Smallest nonzero magnitude of a coordinate in the frame, so that the tracers' error bounds cover underflow."""


def flush_to_zero(local: np.ndarray) -> np.ndarray:
    """Coordinates in a frame, with magnitudes below NEAREST set to 0."""
    return np.where(np.abs(local) < NEAREST, local.dtype.type(0.0), local)


_NEAR = 16.0  # widest extents; float32 has a spacing of 2**-20 extents there


def frame_origin(lower: NDArray[np.float64], upper: NDArray[np.float64], single: bool = False) -> NDArray[np.float64]:
    """World position ((3,) float64) of the frame's origin for the bounds `lower`, `upper` ((3,) float64).

    The origin is the centre of the bounds, rounded to a whole number of steps above `lower`. The step is 2**-20 times
    the largest power of two not above the widest extent. If a scene is translated by an offset that float64 adds
    exactly, such as whole metres of a map grid, the frame moves by the same offset, and the scene's float32 coordinates
    do not change.

    If all coordinates are those of float32 (`single`), the origin loses nothing. It is 0 on axes on which the scene
    lies within 16 times its widest extent: neither its vertices nor rays in float32 are rounded. On other axes it is
    the centre in float32. The difference of two float32 numbers of one sign is one itself if neither is more than twice
    the other [Sterbenz 1974], so all vertices fit into float32, as do rays whose origins are that near.
    """
    extent = (upper - lower).max()
    if not extent > 1e-200:
        return lower.copy()
    if single:
        near = np.maximum(np.abs(lower), np.abs(upper)) <= _NEAR * extent
        return np.where(near, 0.0, (lower / 2.0 + upper / 2.0).astype(np.float32).astype(np.float64))
    exponent = int(np.frexp(extent)[1]) - 1  # floor(log2(extent))
    step = np.ldexp(1.0, exponent - 20)
    out: NDArray[np.float64] = lower + np.round((upper - lower) / 2.0 / step) * step
    return out


# --- Bounds, accumulated piece by piece -------------------------------------------------------------------------------


def bounds_of_points(points: np.ndarray) -> np.ndarray:
    """(2, 3): lower and upper corner of points, (..., 3); NaN if a coordinate is.

    One column at a time is twenty times as fast as NumPy's reduction over all axes but the last.
    """
    columns = [points[..., k] for k in range(3)]
    return np.array([[column.min() for column in columns], [column.max() for column in columns]])


def plan_bounds(bounds: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """(2, 2) float64: lower and upper easting and northing of bounds, (2, 3)."""
    (x0, y0, z0), (x1, y1, z1) = bounds.tolist()
    return np.array([[x0, y0], [x1, y1]] if up == "z" else [[x0, -z1], [x1, -z0]])


def plan_points(points: NDArray[np.float64], up: str) -> NDArray[np.float64]:
    """(n, 2) float64: eastings and northings of points, (n, 3)."""
    return points[:, :2] if up == "z" else points[:, [0, 2]] * [1.0, -1.0]


def faces_of(piece: Piece) -> int:
    """The number of faces per copy."""
    return piece.vertices.shape[1] // 3 if piece.faces is None else len(piece.faces)


def objects_of(pieces: Iterable[Piece]) -> NDArray[np.int32]:
    """(n,) int32: the object of each face, in the order of the pieces."""
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
    """The number of triangles, the bounds and the frame of all added pieces; `file` names them in errors."""

    def __init__(self, file: str):
        self.file, self.n_triangles = file, 0
        self._single = True  # whether all coordinates are those of float32
        self._lower, self._upper = np.full(3, np.inf), np.full(3, -np.inf)

    def add(self, piece: Piece) -> None:
        """Add a piece at rest (without `towards`)."""
        count = len(piece.vertices) * faces_of(piece)
        if count:
            single = piece.vertices.dtype == np.float32 and piece.towards is None
            self.join(count, bounds_of_points(piece.vertices), single)

    def join(self, n_triangles: int, box: np.ndarray, single: bool) -> None:
        """Add triangles by their number and bounds, (2, 3); `single`: whether all coordinates are those of float32."""
        self._lower = np.minimum(self._lower, box[0])  # NaN persists, and `bounds` reports it
        self._upper = np.maximum(self._upper, box[1])
        self._single &= single
        self.n_triangles += n_triangles

    @property
    def parts(self) -> tuple[int, NDArray[np.float64], bool]:
        """What `join` adds to another survey. The bounds are not checked."""
        return self.n_triangles, np.stack([self._lower, self._upper]), self._single

    def bounds(self) -> NDArray[np.float64]:
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

    def origin(self) -> NDArray[np.float64]:
        """(3,) float64: the `frame_origin`. Raises the errors of `bounds`."""
        lower, upper = self.bounds()
        return frame_origin(lower, upper, self._single)


# --- Face samples: the box of the detail, and the up axis -------------------------------------------------------------


MAX_SAMPLED_FACES = 50_000
"""Approximate maximum number of faces in a sample."""

_FEW = 200  # triangles; smaller scenes have no outliers
_RARE = 0.02  # share of the triangles that may lie beyond each side of the detail box
_FAR, _AROUND = 1.0, 0.5  # the box extends to a side of the scene within _FAR extents, else by _AROUND extents
_MOMENTS = 5  # sampled times of an animation


def sampled_faces(source: Source, n_triangles: int, time: float = 0.0) -> NDArray[np.float64]:
    """(m, 3, 3) float64, world: every k-th face of a scene at `time`, about `MAX_SAMPLED_FACES` at most."""
    sample = FaceSample(n_triangles)
    for piece in source.pieces(time):
        sample.add(piece)
    return sample.corners


class FaceSample:
    """The faces of `sampled_faces`, from pieces that are added in order.

    first : number of the first face that is added
    """

    def __init__(self, n_triangles: int, first: int = 0):
        self._step, self._first = every_face(n_triangles), first
        self._found = [np.empty((0, 3, 3))]

    def add(self, piece: Piece) -> None:
        n, copies = faces_of(piece), len(piece.vertices)
        chosen = np.arange(-self._first % self._step, n * copies, self._step)
        self._first += n * copies
        self._found.append(_corners(piece, *np.divmod(chosen, max(n, 1))))

    @property
    def corners(self) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world."""
        return np.concatenate(self._found)


def face_corners(source: Source, faces: NDArray[np.integer], time: float = 0.0) -> NDArray[np.float64]:
    """(m, 3, 3) float64, world: the corners of faces, (m,) int, at `time`, as the source has them, in no frame."""
    out, first = np.empty((len(faces), 3, 3)), 0
    order = np.argsort(faces, kind="stable")
    ascending = faces[order]
    for piece in source.pieces(time):
        n = faces_of(piece)
        last = first + n * len(piece.vertices)
        low, high = np.searchsorted(ascending, (first, last))
        if low < high:
            out[order[low:high]] = _corners(piece, *np.divmod(ascending[low:high] - first, n))
        first = last
    return out


def _corners(piece: Piece, copies: np.ndarray, faces: np.ndarray) -> NDArray[np.float64]:
    """(m, 3, 3) float64: the corners of the given faces of the given copies."""
    corners = 3 * faces[:, None] + np.arange(3) if piece.faces is None else piece.faces[faces]
    points: NDArray[np.float64] = piece.vertices[copies[:, None], corners].astype(np.float64)
    if piece.towards is None:
        return points
    out: NDArray[np.float64] = (1.0 - piece.share) * points + piece.share * piece.towards[copies[:, None], corners]
    return out


def moving_faces(source: Source, n_triangles: int) -> NDArray[np.float64]:
    """(m, 3, 3) float64, world: `sampled_faces` at evenly spaced times of the animation."""
    moments = _MOMENTS if source.duration > 0.0 else 1
    times = (k * source.duration / max(moments - 1, 1) for k in count())
    return np.concatenate([sampled_faces(source, n_triangles * moments, t) for t, _ in zip(times, range(moments))])


def detail_box(faces: np.ndarray) -> NDArray[np.float64]:
    """(2, 3) float64: a box around nearly all triangles of a sample.

    Triangles are counted, not weighted by area, so a wide ground plane of few triangles or an isolated distant part
    does not enlarge the box.
    """
    corners = faces.reshape(-1, 3)
    bounds = bounds_of_points(corners)
    if len(faces) < _FEW:
        return bounds
    lower, upper = np.quantile(faces.mean(1), [_RARE, 1.0 - _RARE], axis=0)
    extent = upper - lower
    return np.stack(
        [
            np.where(bounds[0] >= lower - _FAR * extent, bounds[0], lower - _AROUND * extent),
            np.where(bounds[1] <= upper + _FAR * extent, bounds[1], upper + _AROUND * extent),
        ]
    )


class Detail(NamedTuple):
    """Where nearly all triangles of a scene are."""

    box: NDArray[np.float64]  # (2, 3) float64, world: the `detail_box` of a sample of its faces
    dense: NDArray[np.float64]  # (3,) float64, world: the median on each axis of the first corners of the sample

    @classmethod
    def of(cls, box: NDArray[np.float64], corners: NDArray[np.float32], origin: NDArray[np.float64]) -> "Detail":
        """The detail within a box; `corners`: (m, 3), the first corners of the sample, in the frame at an origin."""
        return cls(box, np.median(corners, axis=0) + origin)


def every_face(n_triangles: int) -> int:
    """The step between the faces of a sample of about `MAX_SAMPLED_FACES` faces at most."""
    return max(-(-n_triangles // MAX_SAMPLED_FACES), 1)


def corners_within(faces: np.ndarray, box: np.ndarray) -> NDArray[np.float64]:
    """(k, 3) float64: the sample's corners inside a box; the corners of the box itself if there are none."""
    corners = faces.reshape(-1, 3)
    inside = corners[((corners >= box[0]) & (corners <= box[1])).all(1)]
    return inside if len(inside) else corners_of(box)


def corners_of(box: np.ndarray) -> NDArray[np.float64]:
    """(8, 3) float64: the corners of a box."""
    return np.stack([box[i, range(3)] for i in np.ndindex(2, 2, 2)])


def guess_y_up(faces: np.ndarray) -> bool:
    """Whether a sample of faces suggests that y points up, as `guess_z_up` does for z."""
    return guess_z_up(faces[..., [0, 2, 1]] * (1.0, -1.0, 1.0))


def guess_z_up(faces: np.ndarray) -> bool:
    """Whether a sample of faces suggests that z points up.

    This is the case if the scene is lower along z than deep along y, and has far more area perpendicular to z than to
    y. Floors and roofs form such area, and about half of it or more must face up.
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
