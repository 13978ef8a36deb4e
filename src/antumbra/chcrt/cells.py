"""Cells: the rays of a screen as occlusion queries test them, 16 cells of 16 receivers side by side.

The rays of a *cell* lie in one shaft (`trace.descent`), from the box of its receivers to the box of the rays' ends. Each
cell keeps the largest parameter up to which one of its rays still looks for a blocker, or for a nearer hit. These
numbers are the *depth buffer* of [Mattausch et al. 2015, Sec. 4.1]. They are shares of the rays' whole length, and
negative once no ray of the cell looks any more. The first rows of a region's cells are the rows that
`trace.frusta.bundle.shafts_of` loads.

The receivers of a cell are 4 x 4 neighbours, or 16 of a row. In *spread* pictures they are every fourth pixel of a
square of 16 x 16 pixels. Such pixels take the same sample of each set, so their directions are alike (Sec. 5.3).
"""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import put
from ..trace.frusta.tile_clusters import RegionLayout, layout_of
from ..trace.tile import TileShape

_F = np.float32
FAR, COUNT, ALL = 12, 13, 14  # rows after the shafts: how far rays look, number of rays that look, number of rays
ROWS = 15
NONE, BLOCKED = _F(-1.0), _F(-0.5)  # values of row FAR: a cell without rays, a cell whose rays are all blocked
WORDS = ROWS * 16  # float32 of a region
CELL = 4  # pixels of a cell of a picture, both ways


class Picture(NamedTuple):
    """How receivers are cut into cells and regions."""

    shape: TileShape
    layout: RegionLayout
    h: int  # rows of receivers
    w: int  # receivers in a row
    spread: bool  # a cell's receivers are not neighbours, but every fourth one, both ways


def picture_of(shape: TileShape, h: int, w: int) -> Picture:
    """The `Picture` of (h, w) receivers whose cells are the tiles of a query."""
    return Picture(shape, layout_of(shape), h, w, False)


def pixels_of(h: int, w: int, spread: bool = False) -> Picture:
    """The `Picture` of (h, w) pixels, also if they form a single row."""
    shape = TileShape(CELL, CELL, -(-w // CELL), -(-h // CELL))
    return Picture(shape, layout_of(shape), h, w, spread)


def new_cells(picture: Picture, sets: int) -> np.ndarray:
    """(sets, regions, ROWS, 16) float32: memory for the cells of some ray sets."""
    return np.empty((sets, picture.layout.rows * picture.layout.columns, ROWS, 16), np.float32)


@inlined
def first_receiver(picture, region, g):
    """(y, x) of the first receiver of cell g of a region."""
    layout, shape = picture.layout, picture.shape
    y, x = region // layout.columns * layout.down, region % layout.columns * layout.across
    row, column = g // layout.across, g % layout.across
    if picture.spread:
        return y * shape.height + row, x * shape.width + column
    return (y + row) * shape.height, (x + column) * shape.width


@inlined
def receiver_in(picture, y0, x0, lane):
    """(y, x, whether it is in the picture) of a receiver of the cell whose first receiver is (y0, x0)."""
    row, column = lane // picture.shape.width, lane % picture.shape.width
    if picture.spread:
        row, column = row * picture.layout.down, column * picture.layout.across
    y, x = y0 + row, x0 + column
    return y, x, y < picture.h and x < picture.w


@inlined
def regions_in(span):
    """The number of regions in a tile; `span`: its row of `Tiles.spans`."""
    return (span[1] - span[0]) * (span[3] - span[2])


@inlined
def region_in(span, j, columns):
    """The index of a tile's j-th region; `columns`: regions in a row of the picture."""
    across = span[1] - span[0]
    return (span[2] + j // across) * columns + span[0] + j % across


@inlined
def put_cell(cells, g, o_low, o_high, d_low, d_high, far, n):
    """Write cell g.

    o_low, o_high : box of the rays' origins
    d_low, d_high : vectors from its lower and upper corner to the corners of the box of the rays' ends
    far, n : how far the rays look, and how many rays look
    """
    for k in range(3):
        put(cells, 16 * k + g, o_low[k])
        put(cells, 48 + 16 * k + g, o_high[k])
        put(cells, 96 + 16 * k + g, d_low[k])
        put(cells, 144 + 16 * k + g, d_high[k])
    put(cells, FAR * 16 + g, far)
    put(cells, COUNT * 16 + g, n)
    put(cells, ALL * 16 + g, n)


@inlined
def no_cell(cells, g):
    """Write a cell g that has no rays."""
    zero, one = (_F(0.0), _F(0.0), _F(0.0)), (_F(1.0), _F(1.0), _F(1.0))
    put_cell(cells, g, zero, zero, one, one, NONE, _F(0.0))


@inlined
def wider(low, high, p):
    """The box from `low` to `high`, widened by a point."""
    return (
        (min(low[0], p[0]), min(low[1], p[1]), min(low[2], p[2])),
        (max(high[0], p[0]), max(high[1], p[1]), max(high[2], p[2])),
    )


@inlined
def nothing_yet():
    """The box of no points."""
    inf = _F(np.inf)
    return (inf, inf, inf), (-inf, -inf, -inf)
