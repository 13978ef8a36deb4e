"""Marks grid cells for pre-BVH culling as published: along lines between cells [Selgrad et al. 2015, Sec. 3.1 and 3.2].

The grid covers the whole scene, its receivers and its lights. Source cells contain receivers, and destination cells
overlap a light. A line is walked from the centre of each source cell to the centre of each destination cell [Amanatides
and Woo 1987], and each cell on it is marked with its one-ring. This is conservative: points with the same parameter on
this line and on any segment between the two cells are at most half a cell apart on each axis.

`techniques.culling.culling_grid` marks fewer cells in less time; this serves for comparison.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....kernels.jit import inlined, kernel
from ....kernels.parallel import items, new_ticket, run
from ....kernels.simd import load4, ptr, put
from ....query.receivers import NOTHING
from ....query.shadow_query import ShadowQuery
from ....scene.lights import AMBIENT, DIRECTIONAL
from ....techniques.culling.culling_grid import (
    CellGrid,
    ReceiverTiles,
    bounds_of,
    cell_number,
    cells_at,
    receiver_at,
    tile_range,
)
from ....techniques.culling.pre_bvh_culling import Box, MarkingMethod, QueryGroup
from .light_cells import light_box, light_cells

# --- The grid over the whole scene ------------------------------------------------------------------------------------

_RELATIVE = DIRECTIONAL, AMBIENT  # lights that move with the receiver, which the paper does not have


def scene_box(groups: Sequence[QueryGroup], triangles: NDArray[np.float32]) -> Box | None:
    """The box around all triangles, receivers and lights; `triangles`: (2, 3), that of all triangles."""
    boxes = [triangles.astype(np.float64)]
    for tiles, queries in groups:
        boxes.append(np.array(bounds_of(tiles)))
        boxes += [np.array(light_box(query)) for query in queries if query.light.kind not in _RELATIVE]
    lower, upper = np.stack(boxes, 1)
    return lower.min(0), upper.max(0)


# --- Source cells -----------------------------------------------------------------------------------------------------


@kernel
def _tag_receivers(ticket, tiles, grid, tags):
    """Worker: set the tag of each cell that contains a receiver. All threads write 1, so order does not matter."""
    for i in items(ticket):
        if not tiles.boxes[i, 0] <= tiles.boxes[i, 4]:
            continue
        first = cell_number(grid, cells_at(grid, load4(tiles.boxes, i * 8)))
        if first == cell_number(grid, cells_at(grid, load4(tiles.boxes, i * 8 + 4))):
            tags[first] = 1
            continue
        y0, x0, y1, x1 = tile_range(tiles, i)
        for y in range(y0, y1):
            for x in range(x0, x1):
                if tiles.sides[y, x] != NOTHING:
                    tags[cell_number(grid, cells_at(grid, receiver_at(tiles, y, x)))] = 1


def source_cells(tiles: ReceiverTiles, grid: CellGrid, threads: int) -> NDArray[np.int64]:
    """(m, 3) int64: the cells of a grid that contain a receiver, in ascending order."""
    tags = np.zeros(grid.n**3, np.uint8)
    run(_tag_receivers, threads, new_ticket(len(tiles.boxes), 64), tiles, grid, tags)
    return np.stack(np.unravel_index(np.flatnonzero(tags), (grid.n,) * 3), -1)


# --- Lines between cells ----------------------------------------------------------------------------------------------

_NEVER = np.int64(1 << 40)  # beyond all parameters of walls


@inlined
def _steps(a, b, stride):
    """(cells to b, step in memory) on one axis, from cell a to cell b."""
    return abs(b - a), stride if b > a else -stride


@inlined
def _walk(ax, ay, az, bx, by, bz, n, marked):
    """Mark the cells on the line from the centre of cell a to the centre of cell b, in a grid of n^3 cells.

    The line crosses wall i of an axis at (2 i + 1) / (2 d), if it crosses d walls. Multiplied by 2 dx dy dz, parameters
    are integers, so that ties are exact: x comes before y, and y before z.
    """
    dx, step_x = _steps(ax, bx, n * n)
    dy, step_y = _steps(ay, by, n)
    dz, step_z = _steps(az, bz, np.int64(1))
    x, y, z = max(dx, np.int64(1)), max(dy, np.int64(1)), max(dz, np.int64(1))
    tx = y * z if dx > 0 else _NEVER
    ty = x * z if dy > 0 else _NEVER
    tz = x * y if dz > 0 else _NEVER
    cell, between_x, between_y, between_z = (ax * n + ay) * n + az, 2 * y * z, 2 * x * z, 2 * x * y
    put(marked, cell, 1)
    for _ in range(dx + dy + dz):
        if tx <= ty and tx <= tz:
            cell, tx = cell + step_x, tx + between_x
        elif ty <= tz:
            cell, ty = cell + step_y, ty + between_y
        else:
            cell, tz = cell + step_z, tz + between_z
        put(marked, cell, 1)


@kernel
def _walk_all(ticket, sources, ends, marked):
    """Worker: walk the lines from each source cell. All threads write 1, so order does not matter."""
    n, cells = np.int64(len(marked)), ptr(marked)
    for i in items(ticket):
        for k in range(len(ends)):
            _walk(sources[i, 0], sources[i, 1], sources[i, 2], ends[k, 0], ends[k, 1], ends[k, 2], n, cells)


def walk_lines(sources: NDArray[np.int64], ends: NDArray[np.int64], n: int, threads: int) -> NDArray[np.uint8]:
    """(n, n, n) uint8: 1 on the lines from the (m, 3) cells `sources` to the (k, 3) cells `ends`."""
    lines = np.zeros((n, n, n), np.uint8)
    run(_walk_all, threads, new_ticket(len(sources), 1), sources, ends, lines)
    return lines


def with_one_ring(cells: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(n, n, n) uint8: 1 in marked cells and in all 26 neighbours, one axis after the other."""
    for axis in range(3):
        cells = np.moveaxis(cells, axis, 0)
        ring = cells.copy()
        ring[1:] |= cells[:-1]
        ring[:-1] |= cells[1:]
        cells = np.moveaxis(ring, 0, axis)
    return cells


def mark_lines(
    sources: NDArray[Any], query: ShadowQuery, grid: CellGrid, marked: NDArray[np.uint8], threads: int
) -> int:
    """Mark cells like `mark_hulls`, between (m, 3) source cells and the cells of the query's light.

    The paper has no lights that move with the receiver; for these, all cells are marked.
    """
    if query.light.kind in _RELATIVE:
        marked[:] = 1
        return 0
    ends = light_cells(query, grid)
    marked |= with_one_ring(walk_lines(sources, ends, grid.n, threads))
    return len(ends)


LINES = MarkingMethod(scene_box, source_cells, mark_lines)
"""Lines between cells, in a grid over the whole scene, as published."""
