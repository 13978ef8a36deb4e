"""Grids of sensors on every surface: square lattices in the planes of the faces, anchored in the world.

A lattice depends only on the plane and the place of a face, so a face keeps its sensors when other geometry is added or
removed.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...base.checks import number
from ...engine.scene_loading import SceneLike, scene_of
from .raster_grid import check_count
from .sensors import Sensors, areas_of, checked_lift, corners_of

_BLOCK = 256.0
"""Spacings between the anchors of lattices: far from its anchor, a lattice would magnify the rounding of its axes."""

_PHASE = 0.5 + 2.0**-7
"""Spacings from an anchor to the lattice: not half a spacing, since many edges lie at round coordinates."""


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
    corners = corners_of(scene, time)
    anchors = _anchors(corners, spacing)
    corners -= anchors[:, None]
    normals, areas = areas_of(corners)
    sound = np.flatnonzero(areas > 0.0)
    corners, normals, areas = corners[sound], normals[sound], areas[sound]
    check_count(areas.sum() / spacing / spacing + len(sound), spacing)
    across, along = _plane_axes(normals, "xyz".index(scene.up))
    flat = np.stack([(corners * axis[:, None]).sum(-1) for axis in (across, along)], -1) / spacing
    face, places = _lattice(flat)
    empty = np.setdiff1d(np.arange(len(sound)), face)
    face, places = np.concatenate([face, empty]), np.concatenate([places, flat[empty].mean(1)])
    order = np.argsort(face, kind="stable")
    face, places = face[order], places[order]
    height = (corners[:, 0] * normals).sum(-1) + lift
    at = spacing * (places[:, :1] * across[face] + places[:, 1:] * along[face]) + height[face, None] * normals[face]
    share = areas / np.bincount(face, minlength=len(sound))
    return Sensors(at + anchors[sound][face], normals[face], share[face], sound[face], "grid")


def _anchors(corners: np.ndarray, spacing: float) -> NDArray[np.float64]:
    """(n, 3) float64, world: a point from which the lattice of each face is counted, near the face.

    Anchors are multiples of the spacing. Both triangles of an upright rectangle have the same bounds, so one anchor.
    """
    block = _BLOCK * min(spacing, 1e30)  # finite, and so wide that all anchors are 0
    return np.asarray(np.round((corners.min(1) + corners.max(1)) / 2.0 / block) * block)


def _plane_axes(normals: np.ndarray, up: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors in the planes with these normals: a horizontal one, and one perpendicular to it."""
    north = np.array([0.0, 1.0, 0.0] if up == 2 else [0.0, 0.0, -1.0])
    across = np.cross(np.eye(3)[up], normals)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    level = length[:, 0] < 1e-3  # (nearly) horizontal planes share one direction
    across[level] = np.cross(north, normals[level])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return across, np.cross(normals, across)


def _lattice(flat: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points (i + _PHASE, j + _PHASE) in triangles: (m,) triangle indices and (m, 2) points.

    flat : (n, 3, 2) float64, corners in the plane
    """
    low, high = np.ceil(flat.min(1) - _PHASE), np.floor(flat.max(1) - _PHASE)
    counts = np.maximum(high - low + 1.0, 0.0).astype(np.int64)
    faces, places = list[np.ndarray](), list[np.ndarray]()
    total = np.cumsum(counts.prod(1))
    for first, last in _blocks(total, 1 << 22):
        n = counts[first:last].prod(1)
        face = np.repeat(np.arange(first, last), n)
        k = np.arange(len(face)) - np.repeat(np.cumsum(n) - n, n)
        columns = counts[face, 0]
        at = low[face] + np.stack([k % columns, k // columns], -1) + _PHASE
        inside = _inside(flat[face], at)
        faces.append(face[inside])
        places.append(at[inside])
    return np.concatenate([np.empty(0, np.int64), *faces]), np.concatenate([np.empty((0, 2)), *places])


def _blocks(total: NDArray[np.int64], most: int) -> Iterator[tuple[int, int]]:
    """Yield ranges (first, last) of items with about `most` points; `total`: cumulative number of points."""
    first = 0
    while first < len(total):
        before = total[first - 1] if first else 0
        last = max(int(np.searchsorted(total, before + most)), first + 1)
        yield first, last
        first = last


def _inside(triangles: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Whether points lie in triangles. A point on an edge shared by two triangles lies in exactly one of them."""
    sides = []
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        edge = b - a
        side = edge[:, 0] * (at[:, 1] - a[:, 1]) - edge[:, 1] * (at[:, 0] - a[:, 0])
        first = (edge[:, 1] > 0.0) | ((edge[:, 1] == 0.0) & (edge[:, 0] < 0.0))
        sides.append((side > 0.0) | ((side == 0.0) & first))
    return np.asarray(sides[0] & sides[1] & sides[2])
