"""A picture cut into regions of 16 tiles."""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined
from ..querychunk import TileShape

MAX_TILES = 16  # in a region
RUN = 64  # regions in a run: a square of 8 x 8, or a part of a row


class Layout(NamedTuple):
    """How tiles are cut into regions: 4 x 4 tiles, or 16 tiles of a row."""

    across: int  # tiles in a row of a region
    down: int  # rows of tiles in a region
    columns: int  # regions in a row
    rows: int  # rows of regions


def layout_of(shape: TileShape) -> Layout:
    """The `Layout` of a query."""
    across = MAX_TILES if shape.height == 1 else 4
    down = MAX_TILES // across
    return Layout(across, down, -(-shape.columns // across), -(-shape.rows // down))


def runs(layout: Layout) -> int:
    """The number of runs of RUN regions: squares of 8 x 8, or parts of a row."""
    return -(-layout.columns // RUN) if layout.rows == 1 else -(-layout.columns // 8) * -(-layout.rows // 8)


@inlined
def _even_bits(code):
    """Bits 0, 2 and 4 of a number, side by side."""
    return code & 1 | code >> 1 & 2 | code >> 2 & 4


@inlined
def corner_of(layout, at):
    """(row, column) of the first tile of region `at`. For the caches, the regions of each square come in Z order."""
    if layout.rows == 1:
        return np.int64(0), at * layout.across
    square, code, across = at >> 6, at & 63, (layout.columns + 7) >> 3
    by, bx = square // across * 8 + _even_bits(code >> 1), square % across * 8 + _even_bits(code)
    return by * layout.down, bx * layout.across


@inlined
def tile_in(layout, g):
    """(row, column) of tile g in its region, or in four regions that follow one another. Tiles come in Z order, too."""
    if layout.down == 1:
        return np.int64(0), np.int64(g)
    if layout.rows == 1:  # regions follow one another in a row
        return _even_bits((g & 15) >> 1), _even_bits(g & 15) + (g >> 4) * layout.across
    return _even_bits(g >> 1), _even_bits(g)
