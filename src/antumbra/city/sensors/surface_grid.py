"""Grids of sensors on every surface: square lattices in the planes of the faces, anchored in the world.

A lattice depends only on the plane and the place of a face, so a face keeps its sensors when other geometry is added or
removed.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.checks import number
from ...engine.scene import AnyScene
from ...engine.scene_loading import SceneLike, scene_of
from .raster_grid import check_count, check_memory
from .sensors import Sensors, areas_of, checked_lift, corners_of

_BLOCK = 256.0
"""Spacings between the anchors of lattices: far from its anchor, a lattice would magnify the rounding of its axes."""

_PHASE = 0.5 + 2.0**-7
"""Spacings from an anchor to the lattice: not half a spacing, since many edges lie at round coordinates."""

_FACES = 1 << 18  # faces whose sensors are counted at a time


def grid_sensors(scene: SceneLike, spacing: float, time: float = 0.0, *, lift: float = 0.0) -> Sensors:
    """A square grid of sensors on every surface; a face without a grid point gets one sensor at its centre.

    Rows are horizontal. The grid of a horizontal face, or of a wall along an axis, lies half a spacing and 1/128 beside
    the multiples of the spacing in world coordinates; faces in another plane share a grid with those nearby. A face
    keeps its sensors, bit for bit, when other geometry is added or removed. Its area is divided among its sensors.

    spacing : float
        World units between neighbours.
    lift : float
        As for `face_sensors`.
    """
    scene, lift = scene_of(scene), checked_lift(lift)
    spacing = number(spacing, "the spacing of sensors", 0.0, np.inf)
    return _sensors_on(corners_of(scene, time), 0, spacing, lift, scene.up)


def grid_counts(scene: AnyScene, spacing: float) -> NDArray[np.int64]:
    """(faces,) int64: the number of sensors of `grid_sensors` on each face, without making them."""
    counts = list[np.ndarray]()
    for first in range(0, scene.n_triangles, _FACES):
        faces = np.arange(first, min(first + _FACES, scene.n_triangles))
        face = _lattices(scene.data.corners(0.0, faces), spacing, scene.up)
        counts.append(np.zeros(len(faces), np.int64))
        counts[-1][face.sound] = np.bincount(face.rows.face, face.rows.points, len(face.sound)).astype(np.int64)
    return np.concatenate([np.empty(0, np.int64), *counts])


def grid_on_faces(scene: AnyScene, spacing: float, lift: float, faces: range, places: range) -> Sensors:
    """Some of the sensors of `grid_sensors`, the same to the last bit.

    faces : those on which they lie
    places : their numbers among the sensors of these faces
    """
    corners = scene.data.corners(0.0, np.arange(faces.start, faces.stop))
    return _sensors_on(corners, faces.start, spacing, lift, scene.up, places)


# --- Lattices of faces ------------------------------------------------------------------------------------------------


class _LatticeRows(NamedTuple):
    """Rows of lattice points in triangles, in their order; without one, a point at the centre."""

    face: np.ndarray  # (r,) int64: the triangle
    row: np.ndarray  # (r,) float64: the whole number of the lattice row; NaN: the centre
    first: np.ndarray  # (r,) float64: the whole number of the first point
    points: np.ndarray  # (r,) int64: how many


class _Lattices(NamedTuple):
    """The lattices of the faces with an area."""

    sound: np.ndarray  # (n,) int64: their numbers
    anchors: np.ndarray  # (n, 3) float64, world
    corners: np.ndarray  # (n, 3, 3) float64, from the anchors
    normals: np.ndarray  # (n, 3) float64
    areas: np.ndarray  # (n,) float64
    across: np.ndarray  # (n, 3) float64: unit vectors in the planes
    along: np.ndarray
    flat: np.ndarray  # (n, 3, 2) float64: the corners in the plane, in spacings
    rows: _LatticeRows


def _lattices(corners: np.ndarray, spacing: float, up: str) -> _Lattices:
    anchors = _anchors(corners, spacing)
    corners = corners - anchors[:, None]
    normals, areas = areas_of(corners)
    sound = np.flatnonzero(areas > 0.0)
    corners, normals, areas = corners[sound], normals[sound], areas[sound]
    check_count(areas.sum() / spacing / spacing + len(sound), spacing)
    across, along = plane_axes(normals, "xyz".index(up))
    flat = np.stack([(corners * axis[:, None]).sum(-1) for axis in (across, along)], -1) / spacing
    return _Lattices(sound, anchors[sound], corners, normals, areas, across, along, flat, _lattice_rows(flat))


def _sensors_on(
    corners: np.ndarray, first_face: int, spacing: float, lift: float, up: str, places: range | None = None
) -> Sensors:
    """The sensors on faces, which are numbered from `first_face`; `places`: some of them."""
    on = _lattices(corners, spacing, up)
    if places is None:
        check_memory(float(on.rows.points.sum()))
    face, at = _points(on.rows, on.flat, places)
    height = (on.corners[:, 0] * on.normals).sum(-1) + lift
    flat = spacing * (at[:, :1] * on.across[face] + at[:, 1:] * on.along[face]) + height[face, None] * on.normals[face]
    share = on.areas / np.bincount(on.rows.face, on.rows.points, len(on.sound))
    faces = on.sound[face] + first_face
    return Sensors(flat + on.anchors[face], on.normals[face], share[face], faces, "grid")


def _anchors(corners: np.ndarray, spacing: float) -> NDArray[np.float64]:
    """(n, 3) float64, world: a point from which the lattice of each face is counted, near the face.

    Anchors are multiples of the spacing. Both triangles of an upright rectangle have the same bounds, so one anchor.
    """
    block = _BLOCK * min(spacing, 1e30)  # finite, and so wide that all anchors are 0
    return np.asarray(np.round((corners.min(1) + corners.max(1)) / 2.0 / block) * block)


def plane_axes(normals: np.ndarray, up: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors in the planes with these normals: a horizontal one, and one perpendicular to it."""
    north = np.array([0.0, 1.0, 0.0] if up == 2 else [0.0, 0.0, -1.0])
    across = np.cross(np.eye(3)[up], normals)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    level = length[:, 0] < 1e-3  # (nearly) horizontal planes share one direction
    across[level] = np.cross(north, normals[level])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(normals, across)


def _lattice_rows(flat: np.ndarray) -> _LatticeRows:
    """The rows of the points (i + _PHASE, j + _PHASE) in triangles, whose corners in the plane are `flat`, (n, 3, 2).

    The points of a row that lie on the inner side of an edge come one after another, in floating point too, since each
    operation of `_beside` is monotonic. So bisection finds the ends of a row, point for point.
    """
    low, high = np.ceil(flat.min(1) - _PHASE), np.floor(flat.max(1) - _PHASE)
    found = [_LatticeRows(*(np.empty(0, kind) for kind in (np.int64, np.float64, np.float64, np.int64)))]
    heights = np.maximum(high[:, 1] - low[:, 1] + 1.0, 0.0) * (high[:, 0] >= low[:, 0])
    for first, last in _blocks(np.cumsum(heights.astype(np.int64)), _ROWS):
        n = heights[first:last].astype(np.int64)
        face = np.repeat(np.arange(first, last), n)
        row = low[face, 1] + (np.arange(len(face)) - np.repeat(np.cumsum(n) - n, n))
        begin, end = np.zeros(len(face), np.int64), (high[face, 0] - low[face, 0] + 1.0).astype(np.int64)
        for k in range(3):
            _cut(flat[face, k], flat[face, (k + 1) % 3], row + _PHASE, low[face, 0], begin, end)
        some = end > begin
        found.append(_LatticeRows(face[some], row[some], low[face[some], 0] + begin[some], (end - begin)[some]))
    face, row, begin_at, count = (np.concatenate(each) for each in zip(*found))
    empty = np.setdiff1d(np.arange(len(flat)), face)
    face, row = np.concatenate([face, empty]), np.concatenate([row, np.full(len(empty), np.nan)])
    begin_at, count = np.concatenate([begin_at, np.zeros(len(empty))]), np.concatenate([count, np.ones_like(empty)])
    order = np.argsort(face, kind="stable")
    return _LatticeRows(face[order], row[order], begin_at[order], count[order])


_ROWS = 1 << 20  # rows at a time


def _blocks(total: NDArray[np.int64], most: int) -> Iterator[tuple[int, int]]:
    """Yield ranges (first, last) of items with about `most` rows; `total`: cumulative number of rows."""
    first = 0
    while first < len(total):
        before = total[first - 1] if first else 0
        last = max(int(np.searchsorted(total, before + most)), first + 1)
        yield first, last
        first = last


def _cut(a: np.ndarray, b: np.ndarray, y: np.ndarray, low: np.ndarray, begin: np.ndarray, end: np.ndarray) -> None:
    """Move the ends of rows, in place, to their points on the inner side of the edges from `a` to `b`."""
    rises = (b - a)[:, 1]
    inner_first = rises > 0.0  # the points before a certain one lie inside; for edges that fall, those from it on
    lower, upper = begin.copy(), end.copy()  # the certain point is in between, both ends included
    while (open_rows := np.flatnonzero(lower < upper)).size:
        middle = (lower[open_rows] + upper[open_rows]) // 2
        x = low[open_rows] + middle + _PHASE
        inside = _beside(a[open_rows], b[open_rows], x, y[open_rows])
        goes_on = inside == inner_first[open_rows]
        lower[open_rows] = np.where(goes_on, middle + 1, lower[open_rows])
        upper[open_rows] = np.where(goes_on, upper[open_rows], middle)
    end[inner_first] = lower[inner_first]
    begin[~inner_first] = lower[~inner_first]


def _beside(a: np.ndarray, b: np.ndarray, x: np.ndarray, y: np.ndarray) -> NDArray[np.bool_]:
    """Whether points are on the inner side of edges. On an edge of two triangles, they are in exactly one of them."""
    edge = b - a
    side = edge[:, 0] * (y - a[:, 1]) - edge[:, 1] * (x - a[:, 0])
    first = (edge[:, 1] > 0.0) | ((edge[:, 1] == 0.0) & (edge[:, 0] < 0.0))
    return np.asarray((side > 0.0) | ((side == 0.0) & first))


def _points(rows: _LatticeRows, flat: np.ndarray, places: range | None) -> tuple[np.ndarray, np.ndarray]:
    """The points of rows: (m,) triangles and (m, 2) positions; `places`: some of them."""
    ends = np.cumsum(rows.points)
    begin, end = (0, int(ends[-1]) if len(ends) else 0) if places is None else (places.start, places.stop)
    first, last = np.searchsorted(ends, begin, "right"), np.searchsorted(ends, end - 1, "right") + 1
    rows = _LatticeRows(*(each[first:last] for each in rows))
    which = np.repeat(np.arange(len(rows.face)), rows.points)
    starts = ends[first:last] - rows.points
    which = which[begin - int(starts[0]) :][: end - begin] if len(starts) else which
    along = rows.first[which] + (np.arange(begin, begin + len(which)) - starts[which])
    face, at = rows.face[which], np.stack([along, rows.row[which]], -1) + _PHASE
    centre = np.isnan(at[:, 1])
    at[centre] = flat[face[centre]].mean(1)
    return face, at
