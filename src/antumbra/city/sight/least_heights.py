"""The least height at which something in each cell of a raster of heights is seen, in closed form.

Let t run from 0 at the cell to 1 at the eye, which has the height e. A point at the height z over the cell is seen if
z (1 - t) + e t is above the surface for all t. Over the surface, the height h is linear between the edges of
triangles, so that::

    z = max (h(t) - e t) / (1 - t)

over the crossings with edges is exact. A line of sight that rises is followed from the cell towards the eye, and
blocks of cells are skipped if all their heights are below it, since they cannot raise z. Lines of sight that pass
below the surface through a hole do not count.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.progress import ProgressCallback
from ...engine.precompilation import precompile
from ...engine.scene import AnyScene, Scene
from ...engine.small_scenes import small_terrain
from ...kernels.jit import F32Ptr, I64Ptr, inlined, kernel
from ...kernels.parallel import items, new_ticket, run
from ...kernels.simd import get, ptr
from ...trace.terrain.terrain_rays import TerrainTree
from ...trace.terrain.terrain_stencils import BLOCKS, COLUMN_PAD, ROW_PAD, Relief
from ...trace.terrain.terrain_views import decided, ground_of, view_from
from ..sensors.sensors import Sensors

_FINE, _COARSE = BLOCKS
_FINE_SHIFT, _COARSE_SHIFT = _FINE.bit_length() - 1, _COARSE.bit_length() - 1
_AT_EYE = 1.0 - 1e-12  # t from which a crossing is at the eye itself


class ReliefEye(NamedTuple):
    """An eye over a raster, in float64."""

    column: float
    row: float
    z: float  # recentred
    drop: float  # of the curved earth, per square of a horizontal distance
    dx: float  # between columns
    dy: float  # between rows


class _SightSurface(NamedTuple):
    """Pointers to the heights of a raster, free of reference counts."""

    z: F32Ptr
    tops: F32Ptr
    starts: I64Ptr
    widths: I64Ptr
    rows: int
    columns: int
    whole: Any  # int: 1: there are no holes


class _Walk(NamedTuple):
    """A line of sight in plan, from a cell to an eye; its steps are columns or rows, whichever are more."""

    row: int
    column: int
    by_columns: Any  # bool
    sign: Any  # int, of the steps
    slope: float  # minor cells per step
    along: float  # steps to the eye
    quadrant: Any  # int, as in `Stencils`


@inlined
def _surface_of(tree, relief):
    rows, columns = tree.z.shape
    return _SightSurface(
        ptr(tree.z), ptr(relief.tops), ptr(relief.starts), ptr(relief.widths), rows, columns, np.int64(relief.whole)
    )


@inlined
def _walk(row, column, eye):
    """The `_Walk` from a cell to an eye."""
    du, dv = eye.column - column, eye.row - row
    by_columns = abs(du) >= abs(dv)
    major, minor = (du, dv) if by_columns else (dv, du)
    along = abs(major)
    slope = minor / along if along > 0.0 else np.float64(0.0)
    sign = np.int64(1) if major > 0.0 else np.int64(-1)
    quadrant = (np.int64(1) if dv < 0.0 else np.int64(0)) | (np.int64(2) if du < 0.0 else np.int64(0))
    return _Walk(row, column, by_columns, sign, slope, along, quadrant)


@inlined
def _place(walk, step, minor):
    """Row and column of the vertex at a step and a minor offset from the cell."""
    if walk.by_columns:
        return walk.row + minor, walk.column + walk.sign * step
    return walk.row + walk.sign * step, walk.column + minor


@inlined
def _height(surface, eye, row, column):
    """The height of a vertex as seen from an eye over the curved earth; NaN: there is none."""
    if row < 0 or column < 0 or row >= surface.rows or column >= surface.columns:
        return np.float64(np.nan)
    z = np.float64(get(surface.z, row * surface.columns + column))
    if eye.drop != 0.0:
        x, y = (column - eye.column) * eye.dx, (row - eye.row) * eye.dy
        z -= eye.drop * (x * x + y * y)
    return z


@inlined
def _has_vertex(surface, row, column):
    inside = row >= 0 and column >= 0 and row < surface.rows and column < surface.columns
    return inside and not np.isnan(get(surface.z, row * surface.columns + column))


@inlined
def _has_triangle(surface, a, b):
    """Whether the edge between two vertices, (row, column) each, has a triangle beside it."""
    row, column = min(a[0], b[0]), min(a[1], b[1])
    if a[0] != b[0] and a[1] != b[1]:
        return _has_vertex(surface, row + 1, column) or _has_vertex(surface, row, column + 1)
    if _has_vertex(surface, row + 1, column + 1):
        return True
    return _has_vertex(surface, row - 1, column) if a[0] == b[0] else _has_vertex(surface, row, column - 1)


@inlined
def _raised(surface, eye, walk, need, at, edge):
    """The height over the cell from which the crossing with an edge is passed, at least `need`.

    at : steps from the cell
    edge : (step, minor offset) of both ends, and the weight of the second one
    """
    t = at / walk.along
    if t >= _AT_EYE:
        return need
    a, b = _place(walk, edge[0], edge[1]), _place(walk, edge[2], edge[3])
    weight = edge[4]
    first, last = _height(surface, eye, a[0], a[1]), _height(surface, eye, b[0], b[1])
    height = first + weight * (last - first)
    if not height - eye.z * t > need * (1.0 - t):  # also if an end has no height
        return need
    if surface.whole == 0 and not _has_triangle(surface, a, b):
        return need
    return (height - eye.z * t) / (1.0 - t)


@inlined
def _over_step(surface, eye, walk, need, k):
    """`_raised` for all crossings of step k, from its beginning to before its end."""
    s, one = walk.slope, np.float64(1.0)
    y = s * k
    m = np.int64(np.floor(y))
    f = y - m
    if k > 0:
        need = _raised(surface, eye, walk, need, np.float64(k), (k, m, k, m + 1, f))
    main = walk.sign > 0  # whether diagonals ascend along both axes
    across = one - s if main else one + s
    for r in (m - 1, m, m + 1):
        if across > 0.0:
            t = (y - r) / across if main else (one + r - y) / across
            if 0.0 <= t <= 1.0 and k + t > 0.0:
                first, last = (r, r + 1) if main else (r + 1, r)
                need = _raised(surface, eye, walk, need, k + t, (k, first, k + 1, last, t))
    r = m + 1 if s > 0.0 else (m if f > 0.0 else m - 1)
    if s != 0.0:
        t = (r - y) / s
        if 0.0 <= t <= 1.0:
            need = _raised(surface, eye, walk, need, k + t, (k, r, k + 1, r, t))
    return need


@inlined
def _passes(surface, eye, walk, need, k, level):
    """Whether the line of sight passes above all cells that it reaches in the next steps; `level`: (index, shift)."""
    index, shift = level
    row, column = _place(walk, k, np.int64(np.floor(walk.slope * k)))
    if row < 0 or column < 0 or row >= surface.rows or column >= surface.columns:
        return False
    last = min(np.float64(k + (np.int64(2) << shift)), walk.along)
    t, u = k / walk.along, last / walk.along
    lowest = min(need + (eye.z - need) * t, need + (eye.z - need) * u)
    at = get(surface.starts, 2 * walk.quadrant + index)
    at += (row + ROW_PAD >> shift) * get(surface.widths, index) + (column + COLUMN_PAD >> shift)
    return lowest > np.float64(get(surface.tops, at))


@inlined
def _first_bound(surface, eye, walk, need, from_eye):
    """`_raised` for the steps about the place, in steps from the eye, that limits the view of the cell before."""
    first = max(np.int64(walk.along - from_eye) - 1, np.int64(0))
    for k in range(first, first + 3):
        if k < walk.along:
            need = _over_step(surface, eye, walk, need, k)
    return need


@kernel
def _least_height(surface, eye, row, column, from_eye):
    """The least height above a cell at which it is seen, NaN if it has none, and what limits it, steps from the eye.

    from_eye : that of the cell before; the horizons of neighbours mostly are the same ridge
    """
    z = _height(surface, eye, row, column)
    if np.isnan(z):
        return z, from_eye
    walk, k = _walk(row, column, eye), np.int64(0)
    need = _first_bound(surface, eye, walk, z, from_eye)
    while k < walk.along:
        if k > 0:
            if _passes(surface, eye, walk, need, k, (1, _COARSE_SHIFT)):
                k += 2 * _COARSE
                continue
            if _passes(surface, eye, walk, need, k, (0, _FINE_SHIFT)):
                k += 2 * _FINE
                continue
        before = need
        need = _over_step(surface, eye, walk, need, k)
        if need > before:
            from_eye = walk.along - k
        k += 1
    return need - z, from_eye


@kernel
def _least_heights(ticket, tree, relief, eye, out):
    """Worker: the least height of each cell, row by row."""
    surface = _surface_of(tree, relief)
    for row in items(ticket):
        from_eye = np.float64(0.0)
        for column in range(surface.columns):
            out[row, column], from_eye = _least_height(surface, eye, row, column, from_eye)


def least_heights(
    tree: TerrainTree, relief: Relief, eye: ReliefEye, threads: int, progress: ProgressCallback | None = None
) -> NDArray[np.float64]:
    """(rows, columns) float64: the least height above each cell at which it is seen from an eye; NaN: no data."""
    out = np.empty(tree.z.shape)
    run(_least_heights, threads, new_ticket(len(out), 4), tree, relief, eye, out, progress=progress)
    return out


# --- Scenes -----------------------------------------------------------------------------------------------------------


def check_own_cells(scene: AnyScene, sensors: Sensors) -> None:
    """Raise an InputError unless sensors are all cells of a scene that is a single raster of heights."""
    own = sensors.kind == "raster" and sensors.cells is None and sensors.raster == scene.raster
    if not own or scene.data.terrain is None or scene.engine.terrain is None:
        raise InputError(
            "least_height needs a scene that is a single raster of heights, and its own cells; "
            'use a raster such as dem.tif, and the sensors "raster"'
        )


def least_heights_of(scene: AnyScene, eye: NDArray[np.float64], drop: float, threads: int) -> NDArray[np.float64]:
    """(cells,) float64: the least height above each cell of a raster at which it is seen from an eye.

    eye : (3,) float64, world
    drop : as in `viewshed.Earth`; 0 for a flat earth

    NaN where there is no surface, and inf everywhere if the eye is below the surface.
    """
    precompile("least heights")
    surface, terrain = scene.data.terrain, scene.engine.terrain
    assert surface is not None and terrain is not None
    (column, row), grid = surface.grid.cells_of(eye[None, :2])[0], surface.grid
    tree, relief = terrain.pyramid.relief
    here = ReliefEye(float(column), float(row), float(eye[2] - scene.origin[2]), drop, grid.dx, grid.dy)
    heights = least_heights(tree, relief, here, threads).reshape(-1)
    ground = surface.at(eye[None, :2])[0]
    return np.where(np.isnan(heights), np.nan, np.inf) if eye[2] < ground else heights


def _example() -> None:
    least_heights_of(Scene.of_data(small_terrain()), np.array([1.5, -1.5, 1.0]), 0.0, 1)


def _views() -> None:
    """The kernels of `terrain_views`, which viewsheds of rasters use too."""
    places, eye = np.arange(3, dtype=np.float32), np.array([1.0, -1.0, 1.0], np.float32)
    ground, points = ground_of(places, -places, np.zeros((3, 3), np.float32)), np.array([[2.0, -1.0, 0.1]], np.float32)
    view_from(ground, eye, 0.1, 1)
    decided(ground, eye, np.array([5]), points, 1)


EXAMPLES = {"least heights": _example, "terrain views": _views}
"""The example calls of this study."""
