"""The hierarchy over the rays: a quadtree of screen tiles [Mattausch et al. 2015, Sec. 4.3]."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ..trace.frusta.tile_clusters import layout_of
from ..trace.tile import TileShape


class Tiles(NamedTuple):
    """The t tiles of all levels, smallest first, row by row. The last tile is the whole screen."""

    spans: np.ndarray  # (t, 4) int32: first and end column of a tile's regions, then first and end row
    children: np.ndarray  # (t, 4) int32: tiles; -1 where there is none, and for the smallest tiles
    share: np.ndarray  # (t,) float64: share of the screen's area
    pixels: int  # side of the smallest tile in pixels
    across: int  # smallest tiles in a row
    smallest: int  # number of smallest tiles
    columns: int  # regions in a row


@lru_cache(maxsize=16)
def tiles_of(shape: TileShape, pixels: int) -> Tiles:
    """The quadtree over a query that `trace.tile.tile_shape` has cut into tiles of 16 receivers.

    pixels : side of the smallest tile; 64 times as long if the receivers form one row
    """
    layout = layout_of(shape)
    width, height = layout.across * shape.width, layout.down * shape.height  # pixels of a region
    pixels = pixels if shape.height > 1 else 64 * pixels
    step = pixels // width, max(pixels // height, 1)  # regions in a smallest tile
    spans, children, first, level = [], [], 0, 0
    across, down = -(-layout.columns // step[0]), -(-layout.rows // step[1])
    grid = smallest = across, down
    below = None
    while True:
        y, x = np.divmod(np.arange(grid[0] * grid[1]), grid[0])
        size = step[0] << level, step[1] << level
        spans.append(np.stack([x, x + 1, y, y + 1], 1) * [size[0], size[0], size[1], size[1]])
        kids = np.full((len(x), 4), -1)
        if below is not None:
            (nx, ny), start = below
            for k in range(4):
                cx, cy = 2 * x + (k & 1), 2 * y + (k >> 1)
                kids[:, k] = np.where((cx < nx) & (cy < ny), start + cy * nx + cx, -1)
        children.append(kids)
        if grid == (1, 1):
            break
        below, first = (grid, first), first + len(x)
        grid, level = ((grid[0] + 1) // 2, (grid[1] + 1) // 2), level + 1
    spans = np.minimum(np.concatenate(spans), [layout.columns] * 2 + [layout.rows] * 2).astype(np.int32)
    area = (spans[:, 1] - spans[:, 0]) * (spans[:, 3] - spans[:, 2])
    return Tiles(
        spans, np.concatenate(children).astype(np.int32), area / area[-1], pixels, smallest[0],
        smallest[0] * smallest[1], layout.columns,
    )  # fmt: skip
