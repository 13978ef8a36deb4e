"""A picture cut into regions of 16 tiles, and the tiles of a region that are traced together."""

from typing import NamedTuple

import numpy as np

from ...kernels.jit import inlined, kernel
from ...kernels.simd import get, lowest_bit, put
from ..lighttable import ALL_GROUPS
from ..querychunk import TileShape
from ..tile import coherent_part, load_receivers, tile_at
from .bundle import MAX_TILES

RUN = 64  # regions in a run: a square of 8 x 8, or a part of a row
_LARGE = np.float32(16.0)  # least size of the light, in sizes of the box of a tile group's receivers


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
def _tile_in(layout, g):
    """(row, column) of tile g in its region. Tiles come in Z order, too."""
    return (np.int64(0), np.int64(g)) if layout.down == 1 else (_even_bits(g >> 1), _even_bits(g))


@inlined
def next_parts(chunk, layout, y, x, scratch):
    """Load the next part of each tile of a region: receivers near each other that are not traced yet.

    Return the number of tiles that have such a part.
    """
    n = np.int64(0)
    for g in range(MAX_TILES):
        rest = np.int64(get(scratch.left, g))
        if rest != 0:
            tile, (row, column) = tile_at(scratch.tiles, n, chunk), _tile_in(layout, g)
            y0, x0 = (y + row) * chunk.shape.height, (x + column) * chunk.shape.width
            rest &= load_receivers(chunk, y0, x0, tile)
            part = coherent_part(tile, rest, chunk.light)
            put(scratch.left, g, rest & ~part)
            put(scratch.valid, n, part)
            put(scratch.places, 2 * n, y0)
            put(scratch.places, 2 * n + 1, x0)
            n += np.int64(part != 0)
    return n


@inlined
def _light_size(tile):
    """The sum of the extents of the light's box."""
    size = np.float32(0.0)
    for k in range(3):
        size += get(tile.groups, (3 + k) * ALL_GROUPS + 1) - get(tile.groups, k * ALL_GROUPS + 1)
    return size


@inlined
def _union(low, high, info):
    """(lower, upper corner) of a box widened by the box of a tile's receivers."""
    return (
        (min(low[0], get(info, 6)), min(low[1], get(info, 7)), min(low[2], get(info, 8))),
        (max(high[0], get(info, 9)), max(high[1], get(info, 10)), max(high[2], get(info, 11))),
    )


@kernel
def near_each_other(chunk, tiles, numbers):
    """Bits of the tiles in `numbers` that form a tile group with the first one: the light is large beside their box."""
    first = tile_at(tiles, lowest_bit(numbers), chunk)
    i, light, members = first.info, _light_size(first), numbers & -numbers
    low, high = (get(i, 6), get(i, 7), get(i, 8)), (get(i, 9), get(i, 10), get(i, 11))
    numbers &= numbers - 1
    while numbers != 0:
        g = lowest_bit(numbers)
        numbers &= numbers - 1
        a, b = _union(low, high, tile_at(tiles, g, chunk).info)
        if (b[0] - a[0] + b[1] - a[1] + b[2] - a[2]) * _LARGE < light:
            low, high = a, b
            members |= np.int64(1) << g
    return members
