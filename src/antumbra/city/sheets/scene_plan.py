"""Scenes from above, as the background of maps: the walls of buildings as lines, and hillshades.

An upright face is a line in plan, so the walls of a city model, of extruded footprints and of meshes are the outlines
of their buildings.
"""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ...engine.scene import AnyScene
from ...scene.scene_bounds import plan_bounds, plan_points
from ...store.store_data import ALL_BYTES
from ..cityjson.surface_types import BUILT
from ..sensors.sensors import LOW, on_top
from .map_frame import Extent

if TYPE_CHECKING:
    from matplotlib.axes import Axes

WALL = "#3c4043"
"""Colour of outlines."""

CASING = "#ffffffb0"
"""Colour beside outlines."""

_UPRIGHT = 0.02  # slope of a wall's normal against the horizontal
_SAME = 1e-3  # metres: ends of lines closer than this coincide
_FACES, _MOST_FACES = 1 << 20, 20_000_000  # at a time, and altogether
_MOST_LINES = 40_000  # in vector output; more are drawn as pixels
_LIGHT = -0.5, 0.5, 0.5**0.5  # east, north, up: from the north-west, 45 degrees high, as maps have it
_ROWS = 1 << 20  # rays at a time
_DARKEST, _BRIGHTEST = 0.35, 1.2  # factors on colours
_PAPER = 236.0  # grey of horizontal surfaces
_RELIEF = 0.35  # slope to which gentle hills are raised, on average
_MOST_RAISED = 6.0  # times


def bounds_of_scene(scene: AnyScene) -> Extent:
    """The bounds of a scene in plan."""
    return Extent(*plan_bounds(np.asarray(scene.bounds, np.float64), scene.up).ravel().tolist())


# --- Outlines ---------------------------------------------------------------------------------------------------------


def outlines_of(scene: AnyScene, extent: Extent | None = None) -> NDArray[np.float64]:
    """(n, 2, 2) float64: the walls of a scene in plan, each once: upright faces at least a metre high.

    Of a city model, only those of buildings and other constructions count. A raster of heights has none, nor has a
    scene whose faces would take too much memory.

    extent : only walls that reach into it; None: all
    """
    n, terrain = scene.n_triangles, scene.data.terrain
    if terrain is not None or n > _MOST_FACES or not scene.data.fits(ALL_BYTES):
        return np.empty((0, 2, 2))
    triangles, built = scene.triangles(), None
    types = [each.type for each in scene.objects]
    if any(types):
        built = np.array([not kind or kind.startswith(BUILT) for kind in types])[scene.object_of_face]
    lines = [np.empty((0, 2, 2))]
    for first in range(0, len(triangles.vertices), _FACES):
        corners = triangles.vertices[first : first + _FACES].astype(np.float64) + triangles.origin
        lines.append(_walls(corners if built is None else corners[built[first : first + _FACES]], scene, extent))
    return _distinct(np.concatenate(lines), scene.unit.of_metres(_SAME))


def _walls(corners: NDArray[np.float64], scene: AnyScene, extent: Extent | None) -> NDArray[np.float64]:
    """(n, 2, 2): the longest sides in plan of the upright ones of faces, (k, 3, 3), that are high enough."""
    high = np.ptp(corners[..., "xyz".index(scene.up)], axis=1) >= scene.unit.of_metres(LOW)
    upright = _is_upright(corners, scene.up) & high
    plan = plan_points(corners[upright].reshape(-1, 3), scene.up).reshape(-1, 3, 2)
    if extent is not None:
        low, high = plan.min(1), plan.max(1)
        inside = (high >= (extent.west, extent.south)).all(1) & (low <= (extent.east, extent.north)).all(1)
        plan = plan[inside]
    return _longest_sides(plan)


def _is_upright(corners: NDArray[np.float64], up: str) -> NDArray[np.bool_]:
    """(k,) bool: which faces, (k, 3, 3), are walls, so that a line is left of them in plan."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    return np.asarray((length > 0.0) & (np.abs(normals[:, "xyz".index(up)]) <= _UPRIGHT * length))


def wall_lines(corners: NDArray[np.float64], up: str) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """(k,) bool: which faces, (k, 3, 3), are walls; and (n, 2, 2) float64: each of these in plan."""
    walls = _is_upright(corners, up)
    return walls, _longest_sides(plan_points(corners[walls].reshape(-1, 3), up).reshape(-1, 3, 2))


def _longest_sides(plan: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n, 2, 2): the longest side of each triangle, (n, 3, 2): what is left of an upright one in plan."""
    if not len(plan):
        return np.empty((0, 2, 2))
    sides = np.stack([plan, np.roll(plan, -1, 1)], 2)
    longest = np.linalg.norm(sides[:, :, 1] - sides[:, :, 0], axis=2).argmax(1)
    return np.asarray(sides[np.arange(len(plan)), longest])


def _distinct(lines: NDArray[np.float64], same: float) -> NDArray[np.float64]:
    """The lines, each once, whichever way it runs, without those that are points."""
    keys = np.round(lines / same).astype(np.int64)
    swap = (keys[:, 0, 0] > keys[:, 1, 0]) | ((keys[:, 0, 0] == keys[:, 1, 0]) & (keys[:, 0, 1] > keys[:, 1, 1]))
    keys[swap] = keys[swap, ::-1]
    flat = keys.reshape(-1, 4)
    _, first = np.unique(flat, axis=0, return_index=True)
    first = np.sort(first[(flat[first, :2] != flat[first, 2:]).any(1)])
    return lines[first]


def draw_outlines(axes: "Axes", lines: NDArray[np.float64], width: float = 0.5) -> None:
    """Draw outlines, as pixels if they are very many; `width`: in points."""
    from matplotlib.collections import LineCollection

    if len(lines):
        many = len(lines) > _MOST_LINES
        for colour, extra in ((CASING, 0.6), (WALL, 0.0)):  # on light and on dark colours
            axes.add_collection(
                LineCollection(list(lines), colors=colour, linewidths=width + extra, rasterized=many, zorder=3)
            )


# --- Hillshades -------------------------------------------------------------------------------------------------------


def hillshade(scene: AnyScene, extent: Extent, columns: int, rows: int) -> NDArray[np.float64]:
    """(rows, columns) float64 in [0, 1]: the shade of the highest surfaces, lit from the north-west; NaN beside them.

    The first row is the northernmost.
    """
    wide, high = extent.width / columns, extent.height / rows
    east = extent.west + (np.arange(columns) + 0.5) * wide
    north = extent.north - (np.arange(rows) + 0.5) * high
    heights = np.empty(rows * columns)
    plan = np.stack(np.meshgrid(east, north), -1).reshape(-1, 2)
    for first in range(0, len(plan), _ROWS):
        heights[first : first + _ROWS] = _heights(scene, plan[first : first + _ROWS])
    return shaded(heights.reshape(rows, columns), wide, high)


def _heights(scene: AnyScene, plan: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) float64: the height of the highest surface at each position; NaN: none."""
    if (terrain := scene.data.terrain) is not None:
        cells, last = terrain.grid.cells_of(plan), np.array([terrain.grid.columns, terrain.grid.rows]) - 1
        within = ((cells >= -0.5) & (cells <= last + 0.5)).all(1)  # the surface ends in the centres of the outer cells
        column, row = np.clip(cells, 0, last).T
        return np.where(within, terrain.at_cells(column, row), np.nan)
    zeros = np.zeros(len(plan))
    points = np.stack([plan[:, 0], zeros, -plan[:, 1]] if scene.up == "y" else [*plan.T, zeros], 1)
    tops, faces = on_top(scene, points)
    return np.where(faces >= 0, tops, np.nan)


def shaded(heights: NDArray[np.float64], wide: float, high: float) -> NDArray[np.float64]:
    """The shade of heights, (rows, columns) from the north, of cells of a width and a height.

    A horizontal surface has the same shade everywhere. Gentle hills are raised, so that they show. Beside surfaces,
    slopes are taken as level.
    """
    if min(heights.shape) < 2:
        return np.where(np.isfinite(heights), _LIGHT[2], np.nan)
    southward, eastward = np.gradient(heights, high, wide)
    dx, dy = np.nan_to_num(eastward), -np.nan_to_num(southward)
    steep = float(np.sqrt(np.mean(dx * dx + dy * dy)))
    raised = float(np.clip(_RELIEF / steep, 1.0, _MOST_RAISED)) if steep > 0.0 else 1.0
    dx, dy = raised * dx, raised * dy
    shade = (_LIGHT[2] - dx * _LIGHT[0] - dy * _LIGHT[1]) / np.sqrt(1.0 + dx * dx + dy * dy)
    return np.where(np.isfinite(heights), np.clip(shade, 0.0, 1.0), np.nan)


def brightness(shade: NDArray[np.float64]) -> NDArray[np.float64]:
    """Factors on colours that leave those of horizontal surfaces unchanged; 1 for NaN."""
    share = shade / _LIGHT[2]
    return np.asarray(np.nan_to_num(_DARKEST + (1.0 - _DARKEST) * np.minimum(share, _BRIGHTEST), nan=1.0))


def draw_hillshade(axes: "Axes", shade: NDArray[np.float64], extent: Extent) -> None:
    """Draw a hillshade in light greys, transparent beside the scene."""
    pixels = np.empty((*shade.shape, 4), np.uint8)
    pixels[..., :3] = np.round(np.minimum(_PAPER * brightness(shade), 255.0))[..., None]
    pixels[..., 3] = np.where(np.isfinite(shade), 255, 0)
    draw_pixels(axes, pixels, extent, zorder=0)


def draw_pixels(axes: "Axes", pixels: Any, extent: Extent, **more: Any) -> None:
    """Draw a picture whose first row is the northernmost, in its place on a map."""
    bounds = extent.west, extent.east, extent.south, extent.north
    axes.imshow(pixels, extent=bounds, interpolation="nearest", aspect="auto", **more)
