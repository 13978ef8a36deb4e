"""Values between sensors: on the surfaces of a scene, and between the centres of the cells of a raster.

On a planar lattice, interpolation is bilinear, and exact at the sensors. Elsewhere it is a mean of the sensors less
than a spacing away, weighted in the same way.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.small_matrices import dot
from ...query.nearest_points import PointTree
from ..sensors.sensors import Sensors
from ..sensors.surface_grid import plane_axes

_BATCH = 1 << 17  # places at a time
_SMALL = 0.25  # squares of the spacing: area of faces that have the value of their only sensor, such as leaves
_REACHES = 1.0, 3.0  # spacings: how far away sensors count; the second on strips between the rows of a lattice
_OFF = 0.005  # of the reach: how far off the plane of a place, which others, such as a kerb's, lie beside
_FACING = 0.5  # cosine: sensors whose normals differ more do not count
_BESIDE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)])


class Places(NamedTuple):
    """Points on surfaces."""

    points: NDArray[np.float64]  # (k, 3), world
    normals: np.ndarray  # (k, 3)
    faces: NDArray[np.integer]  # (k,)

    def at(self, some: object) -> "Places":
        return Places(*(each[some] for each in self))  # type: ignore[call-overload]


def values_on_surfaces(
    sensors: Sensors, values: NDArray[np.float64], places: Places, corners: NDArray[np.float64], up: str, smooth: bool
) -> NDArray[np.float64]:
    """(k,) float64: values at points of surfaces, NaN where there are none.

    Faces whose sensors were left out, such as roofs in a study of walls, have no value, nor have places whose nearest
    sensor has none. The two sides of a wall keep separate values.

    sensors : of kind "face", "vertex" or "grid"
    corners : (faces, 3, 3), world
    smooth : whether values lie on a continuous scale; otherwise, each place has the value of one sensor
    """
    if not len(sensors):
        return np.full(len(places.points), np.nan)
    if sensors.kind == "face":
        assert sensors.faces is not None
        return np.asarray(_of_faces(sensors.faces, values, len(corners))[places.faces])
    if sensors.kind == "vertex":
        return _between_corners(sensors, values, places, corners, smooth)
    assert sensors.faces is not None
    if sensors.normals is None or sensors.areas is None:
        return _of_nearest(sensors.points, sensors.faces, values, places)
    found = np.asarray(_of_faces(sensors.faces, values, len(corners))[places.faces])
    spacing, on_faces = spacing_of(sensors), np.flatnonzero(sensors.faces >= 0)
    small = np.zeros(len(corners), bool)
    small[sensors.faces[on_faces]] = sensors.areas[on_faces] < _SMALL * spacing * spacing
    open_places = np.flatnonzero(np.isin(places.faces, sensors.faces) & ~small[places.faces])
    grid = _grid_of(sensors, on_faces[~small[sensors.faces[on_faces]]], corners)
    for reach in _REACHES if len(grid.points) else ():
        cells, rest = _cells_of(grid.points, 2.0 * reach * spacing), []
        for first in range(0, len(open_places), _BATCH):
            batch = open_places[first : first + _BATCH]
            some, reached = _weighted(grid, values, cells, places.at(batch), up, smooth)
            found[batch[reached]] = some[reached]
            rest.append(batch[~reached])
        open_places = np.concatenate([np.empty(0, np.int64), *rest])
    return found


def _of_faces(faces: NDArray[np.int64], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    of_face = np.full(count, np.nan)
    of_face[faces[faces >= 0]] = values[faces >= 0]
    return of_face


def _of_nearest(
    points: NDArray[np.float64], faces: NDArray[np.int64], values: NDArray[np.float64], places: Places
) -> NDArray[np.float64]:
    """The values of the nearest sensors, whose normals or areas are unknown, on faces that have any."""
    found = np.full(len(places.points), np.nan)
    on = np.isin(places.faces, faces)
    found[on] = values[PointTree(points).nearest(places.points[on]).indices]
    return found


def _between_corners(
    sensors: Sensors, values: NDArray[np.float64], places: Places, corners: NDArray[np.float64], smooth: bool
) -> NDArray[np.float64]:
    """Values by the barycentric coordinates of places in their faces, or those of the nearest corner."""
    assert sensors.corners is not None
    triangle = corners[places.faces]
    u, v, d = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0], places.points - triangle[:, 0]
    uu, uv, vv, du, dv = (dot(a, b) for a, b in ((u, u), (u, v), (v, v), (d, u), (d, v)))
    with np.errstate(divide="ignore", invalid="ignore"):
        second, third = (vv * du - uv * dv) / (uu * vv - uv * uv), (uu * dv - uv * du) / (uu * vv - uv * uv)
    shares = np.clip(np.nan_to_num(np.stack([1.0 - second - third, second, third], 1)), 0.0, 1.0)
    rows = sensors.corners[places.faces]
    of_corners = np.where(rows >= 0, values[rows], np.nan)
    if smooth:
        return np.asarray((of_corners * shares).sum(1) / np.maximum(shares.sum(1), 1e-9))
    return np.asarray(np.take_along_axis(of_corners, shares.argmax(1)[:, None], 1)[:, 0])


def spacing_of(sensors: Sensors) -> float:
    """The spacing of surface grids: the least distance of neighbours on a face, or the mean one of single sensors."""
    assert sensors.areas is not None and sensors.faces is not None
    same = sensors.faces[1:] == sensors.faces[:-1]
    away = np.linalg.norm(sensors.points[1:][same] - sensors.points[:-1][same], axis=1)
    if not (away > 0.0).any():  # some may be given twice
        return float(np.sqrt(np.mean(sensors.areas)))
    return float(away[away > 0.0].min())


# --- Between the sensors of a grid ------------------------------------------------------------------------------------


class _CellGrid(NamedTuple):
    """Sensors of a surface grid."""

    rows: NDArray[np.int64]  # (n,): of the values
    points: NDArray[np.float64]  # (n, 3): on the surfaces
    normals: NDArray[np.float64]  # (n, 3)


def _grid_of(sensors: Sensors, rows: NDArray[np.int64], corners: NDArray[np.float64]) -> _CellGrid:
    """Some sensors, moved to the faces that they were lifted off."""
    assert sensors.faces is not None and sensors.normals is not None
    points, normals = sensors.points[rows], sensors.normals[rows]
    lift = dot(points - corners[sensors.faces[rows], 0], normals)
    return _CellGrid(rows, points - lift[:, None] * normals, normals)


class _Cells(NamedTuple):
    """Points by the cubes that hold them."""

    keys: NDArray[np.int64]  # (c,) ascending
    first: NDArray[np.int64]  # (c,): into `order`
    counts: NDArray[np.int64]  # (c,)
    order: NDArray[np.int64]  # (n,): the points
    lowest: NDArray[np.int64]  # (3,): a cube beside all others
    size: NDArray[np.int64]  # (3,): cubes along each axis, with those beside
    width: float

    def keys_of(self, cubes: NDArray[np.int64]) -> NDArray[np.int64]:
        """(k,) int64: the numbers of cubes, (k, 3)."""
        x, y, z = np.clip(cubes - self.lowest, 0, self.size - 1).T
        return np.asarray((x * self.size[1] + y) * self.size[2] + z)


def _cells_of(points: NDArray[np.float64], width: float) -> _Cells:
    cubes = np.floor(points / width).astype(np.int64)
    nothing = np.empty(0, np.int64)
    cells = _Cells(nothing, nothing, nothing, nothing, cubes.min(0) - 1, np.ptp(cubes, axis=0) + 3, width)
    keys = cells.keys_of(cubes)
    order = np.argsort(keys, kind="stable")
    unique, first, count = np.unique(keys[order], return_index=True, return_counts=True)
    return cells._replace(keys=unique, first=first, counts=count, order=order)


def _weighted(
    grid: _CellGrid, values: NDArray[np.float64], cells: _Cells, places: Places, up: str, smooth: bool
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The weighted means of the sensors around places, or the values of those with the largest weights.

    Where the sensor with the largest weight has no value, neither has the place. Returns also whether any is in reach.
    """
    plane = plane_axes(places.normals.astype(np.float64), "xyz".index(up))
    totals, sums, best = np.zeros((3, len(places.points)))
    nearest = np.full(len(places.points), np.nan)
    corner = np.floor(places.points / cells.width - 0.5).astype(np.int64)
    for beside in _BESIDE:
        keys = cells.keys_of(corner + beside)
        slot = np.minimum(np.searchsorted(cells.keys, keys), len(cells.keys) - 1)
        active = np.flatnonzero(cells.keys[slot] == keys)
        slot, k = slot[active], 0
        while len(active):
            sensor = cells.order[cells.first[slot] + k]
            axes = plane[0][active], plane[1][active]
            weight = _weights(grid, sensor, places.at(active), axes, cells.width / 2.0)
            value = values[grid.rows[sensor]]
            totals[active] += weight * np.isfinite(value)
            sums[active] += weight * np.nan_to_num(value)
            better = weight > best[active]
            best[active[better]], nearest[active[better]] = weight[better], value[better]
            k += 1
            more = cells.counts[slot] > k
            active, slot = active[more], slot[more]
    if smooth:
        np.divide(sums, totals, out=nearest, where=np.isfinite(nearest))
    return nearest, best > 0.0


def _weights(
    grid: _CellGrid, sensor: NDArray[np.int64], places: Places, plane: tuple[np.ndarray, np.ndarray], reach: float
) -> NDArray[np.float64]:
    """The bilinear weight of a sensor for each place, less where its surface is not that of the place.

    Surfaces that bend from one normal to the other leave the plane of the place by less than the distance times the
    sine of the angle.
    """
    away = (places.points - grid.points[sensor]) / reach
    across, along, off = (dot(away, axis) for axis in (*plane, places.normals))
    weight = np.maximum(1.0 - np.abs(across), 0.0) * np.maximum(1.0 - np.abs(along), 0.0)
    cosine = np.clip(dot(places.normals, grid.normals[sensor]), -1.0, 1.0)
    bend = np.sqrt((across * across + along * along) * (1.0 - cosine * cosine))
    same = np.maximum(1.0 - np.abs(off) / (_OFF + bend), 0.0)
    return np.asarray(weight * same * np.clip((cosine - _FACING) / (1.0 - _FACING), 0.0, 1.0))


# --- Between the cells of a raster ------------------------------------------------------------------------------------


def smooth_cells(cells: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """(h * parts, w * parts) float64: cells divided into parts, with bilinear interpolation between their centres.

    A part of a cell without a value has none, and others ignore cells without a value, so the outlines of holes stay.
    Values stay between those of the cells.
    """
    known = np.isfinite(cells)
    weights, values = known.astype(np.float64), np.where(known, cells, 0.0)
    for axis in 0, 1:
        weights, values = (_stretched(each, parts, axis) for each in (weights, values))
    with np.errstate(invalid="ignore"):
        smooth = values / weights
    smooth = np.clip(smooth, np.nanmin(cells), np.nanmax(cells)) if known.any() else smooth
    return np.where(known.repeat(parts, 0).repeat(parts, 1), smooth, np.nan)


def _stretched(values: NDArray[np.float64], parts: int, axis: int) -> NDArray[np.float64]:
    """Linear interpolation at the centres of the parts of cells along an axis; constant beyond the outermost ones."""
    n = values.shape[axis]
    at = np.clip((np.arange(n * parts) + 0.5) / parts - 0.5, 0.0, n - 1.0)
    low = np.minimum(at.astype(np.int64), max(n - 2, 0))
    share = np.expand_dims(at - low, 1 - axis)
    first, second = values.take(low, axis), values.take(np.minimum(low + 1, n - 1), axis)
    return np.asarray(first * (1.0 - share) + second * share)
