"""Origins of shadow rays: a box around the receivers in each cell.

They are the source cells of [Selgrad et al. 2015, Sec. 3.1].
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import broadcast4, load4, mask_from_bits4, maximum, minimum, select, splat4, store
from ..query.receivers import NOTHING
from .grid import cell_number, cells_at

FINEST = 32  # most cells along an axis that receivers are sorted into; the boxes around them are exact
TILE = 8  # a tile has 8 x 8 receivers, or 1 x 64 where there are fewer than 8 rows

_PARTS = 16  # most tables of cells; a table is a megabyte
_INF = np.float32(np.inf)


class ReceiverTiles(NamedTuple):
    """Receivers in tiles, with the box of each tile."""

    origins: np.ndarray  # (h, w, 3) float32
    sides: np.ndarray  # (h, w) int8
    rows: int  # of receivers in a tile
    columns: int  # of receivers in a tile
    boxes: np.ndarray  # (tiles, 8) float32: lower and upper corner, fourth numbers unused; inf and -inf: no receiver


@inlined
def _receiver(tiles, y, x):
    """Receiver (y, x) as an f32x4; the fourth lane repeats z."""
    i = (y * tiles.sides.shape[1] + x) * 3
    a, b, c = broadcast4(tiles.origins, i), broadcast4(tiles.origins, i + 1), broadcast4(tiles.origins, i + 2)
    return select(mask_from_bits4(1), a, select(mask_from_bits4(2), b, c))


@inlined
def _corner(tiles, tile):
    """(y, x) of the first receiver of a tile, and (y, x) behind its last one."""
    h, w = tiles.sides.shape
    across = (w + tiles.columns - 1) // tiles.columns
    y, x = tile // across * tiles.rows, tile % across * tiles.columns
    return y, x, min(y + tiles.rows, h), min(x + tiles.columns, w)


@kernel
def _bound_tiles(ticket, tiles):
    """Worker: find the box of each tile."""
    for i in items(ticket):
        y0, x0, y1, x1 = _corner(tiles, i)
        low, high = splat4(_INF), splat4(-_INF)
        for y in range(y0, y1):
            for x in range(x0, x1):
                if tiles.sides[y, x] != NOTHING:
                    point = _receiver(tiles, y, x)
                    low, high = minimum(low, point), maximum(high, point)
        store(tiles.boxes, i * 8, low)
        store(tiles.boxes, i * 8 + 4, high)


@inlined
def _grow(boxes, i, low, high):
    """Grow box i of an array to hold the box from `low` to `high`."""
    store(boxes, i * 8, minimum(load4(boxes, i * 8), low))
    store(boxes, i * 8 + 4, maximum(load4(boxes, i * 8 + 4), high))


@kernel
def _bound_cells(ticket, tiles, grid, cells):
    """Worker: fill one row of `cells` after the other. Each row covers its share of the tiles.

    An element is the box of the share's receivers in one cell.
    """
    for part in items(ticket):
        boxes = cells[part]
        for i in range(part, len(tiles.boxes), len(cells)):
            low, high = load4(tiles.boxes, i * 8), load4(tiles.boxes, i * 8 + 4)
            if not tiles.boxes[i, 0] <= tiles.boxes[i, 4]:
                continue
            first = cell_number(grid, cells_at(grid, low))
            if first == cell_number(grid, cells_at(grid, high)):
                _grow(boxes, first, low, high)
                continue
            y0, x0, y1, x1 = _corner(tiles, i)
            for y in range(y0, y1):
                for x in range(x0, x1):
                    if tiles.sides[y, x] != NOTHING:
                        point = _receiver(tiles, y, x)
                        _grow(boxes, cell_number(grid, cells_at(grid, point)), point, point)


def tiles_of(query, threads: int) -> ReceiverTiles:
    """The receivers of a ShadowQuery, in tiles."""
    h, w = query.sides.shape
    rows = TILE if h >= TILE else 1
    columns = TILE * TILE // rows
    count = -(-h // rows) * -(-w // columns)
    tiles = ReceiverTiles(query.origins, query.sides, rows, columns, np.empty((count, 8), np.float32))
    run(_bound_tiles, threads, new_ticket(count, 64), tiles)
    return tiles


def bounds_of(tiles: ReceiverTiles) -> tuple[np.ndarray, np.ndarray] | None:
    """Lower and upper corner, (3,) float64, of all receivers; None if there are none."""
    if not (tiles.boxes[:, 0] <= tiles.boxes[:, 4]).any():
        return None
    return tiles.boxes[:, :3].min(0).astype(np.float64), tiles.boxes[:, 4:7].max(0).astype(np.float64)


def sources_of(tiles: ReceiverTiles, grid, threads: int) -> np.ndarray:
    """(m, 2, 3) float64: for each cell of a grid that has receivers, the box around them."""
    parts = min(threads, _PARTS)
    cells = np.empty((parts, grid.n**3, 8), np.float32)
    cells[:, :, :4], cells[:, :, 4:] = np.inf, -np.inf
    run(_bound_cells, threads, new_ticket(parts, 1), tiles, grid, cells)
    lower, upper = cells[:, :, :3].min(0), cells[:, :, 4:7].max(0)
    held = lower[:, 0] <= upper[:, 0]
    return np.stack([lower[held], upper[held]], 1).astype(np.float64)
