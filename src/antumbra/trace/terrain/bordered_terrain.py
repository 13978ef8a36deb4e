"""Terrain in 4.4 bytes a cell, for rasters larger than memory: a grid of heights that has its border without data.

The heights serve exact rays and lanes alike, where terrain in memory has three copies of them. The pyramid begins at
nodes of 8 x 8 squares. Crossings with edges of missing vertices are undecided, and so are rays that may have passed a
hole before they were below the surface: exact rays decide them, so the bits are the same.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...scene.scene_bounds import flush_to_zero
from ...scene.terrain import GridPoints
from .terrain_rays import PAD, TerrainTree, halved, under_of
from .terrain_stencils import BLOCKS, COLUMN_PAD, NO_SURFACE, ROW_PAD, Relief, block_maxima, reached, shift_of

_SIDE = BLOCKS[0]
_BASE = _SIDE.bit_length() - 1  # level
_BAND = 8 * _SIDE  # rows at a time

INSIDE = slice(ROW_PAD, -ROW_PAD), slice(COLUMN_PAD, -COLUMN_PAD)
"""The heights without their border."""


def bordered_shape(rows: int, columns: int) -> tuple[int, int]:
    """The shape of the heights of a grid with its border."""
    return rows + 2 * ROW_PAD, columns + 2 * COLUMN_PAD


class BorderedTerrain(NamedTuple):
    """A `TerrainTree` whose grid has a border without data, and its `Relief`, which has the same heights."""

    tree: TerrainTree
    relief: Relief


def bordered_terrain(
    grid: GridPoints, z: NDArray[np.float32], origin: NDArray[np.float64], row: int = 0, column: int = 0
) -> BorderedTerrain:
    """The terrain of a part of a grid.

    z : (rows, columns) float32 of `bordered_shape`, in the frame at `origin`; NaN: no vertex, also in the border
    row, column : the first ones of the part
    """
    row, column = row - ROW_PAD, column - COLUMN_PAD
    eastings, northings = grid.eastings(column, column + z.shape[1]), grid.northings(row, row + len(z))
    x, y = (flush_to_zero((each - o).astype(np.float32)) for each, o in zip((eastings, northings), origin))
    found = _blocks(z)
    under = np.inf
    if not found.missing:
        part = grid._replace(west=eastings[0], north=northings[0], rows=len(z), columns=z.shape[1])
        under = under_of(part, x, y, origin, found.steepest, found.reach)
    nodes = found.tops[: -(-(len(z) - 1) // _SIDE), : -(-(z.shape[1] - 1) // _SIDE)]
    levels = [np.where(nodes > NO_SURFACE, nodes, np.float32(-np.inf))]
    while max(levels[-1].shape) > 1:
        levels.append(halved(levels[-1]))
    tree = TerrainTree(
        x, y, z, np.concatenate([level.reshape(-1) for level in levels]),
        np.cumsum([0, *(level.size for level in levels)]).astype(np.int64),
        np.array([level.shape[1] for level in levels], np.int64),
        float(eastings[0]) - origin[0], float(northings[0]) - origin[1], 1.0 / grid.dx, 1.0 / grid.dy,
        PAD * max(z.shape), float(levels[-1].max()), found.reach, under, _BASE,
    )  # fmt: skip
    ratio = BLOCKS[1] // _SIDE
    holes, starts, widths = reached([found.holes, block_maxima(found.holes, ratio)])
    tops, _, _ = reached([found.tops, block_maxima(found.tops, ratio)])
    relief = Relief(z, z, tops, starts, widths, 0, found.steepest, shift_of(tree), holes, 1)
    return BorderedTerrain(tree, relief)


class _Blocks(NamedTuple):
    """Blocks of `_SIDE` x `_SIDE` vertices, each with the vertices around it; and numbers of the whole."""

    tops: NDArray[np.float32]  # NO_SURFACE: it has no height
    holes: NDArray[np.uint8]  # whether a vertex is missing
    steepest: float  # greatest difference of neighbouring heights
    reach: float  # largest magnitude of a height
    missing: bool  # whether a vertex is missing inside the border


def _blocks(z: NDArray[np.float32]) -> _Blocks:
    """The `_Blocks` of heights with their border, found by bands of rows."""
    shape = tuple(-(-n // _SIDE) for n in z.shape)
    tops, holes = np.empty(shape, np.float32), np.empty(shape, np.uint8)
    steepest, reach, missing = 0.0, 0.0, False
    for first in range(0, len(z), _BAND):
        begin, end = max(first - 1, 0), min(first + _BAND + 1, len(z))
        part, into = z[begin:end], slice(first // _SIDE, min((first + _BAND) // _SIDE, shape[0]))
        bare = np.isnan(part)
        high = np.where(bare, NO_SURFACE, part)
        rows = slice(max(ROW_PAD - begin, 0), max(len(z) - ROW_PAD - begin, 0))
        inside = bare[rows, COLUMN_PAD:-COLUMN_PAD]
        missing = missing or bool(inside.any())
        for values, out, outside in (high, tops, NO_SURFACE), (bare.view(np.uint8), holes, np.uint8(1)):
            size = (into.stop - into.start) * _SIDE + 2, shape[1] * _SIDE + 2
            padded = np.full(size, outside)
            row = begin - first + 1
            padded[row : row + len(part), 1 : 1 + part.shape[1]] = values
            out[into] = _around(padded)
        with np.errstate(invalid="ignore"):
            for change in part[1:] - part[:-1], part[:, 1:] - part[:, :-1]:
                steepest = max(steepest, *(abs(float(each.reduce(change, None))) for each in (np.fmin, np.fmax)))
            reach = max(reach, *(abs(float(each.reduce(part, None))) for each in (np.fmin, np.fmax)))
    return _Blocks(tops, holes, steepest, reach, missing)


def _around(padded: NDArray[Any]) -> NDArray[Any]:
    """The greatest values of blocks and of what is around them; `padded`: with one more row and column on each side."""
    rows, columns = (n - 2 for n in padded.shape)
    out = padded[0:rows:_SIDE].copy()
    for k in range(1, _SIDE + 2):
        np.maximum(out, padded[k : k + rows : _SIDE], out=out)
    whole = out[:, 0:columns:_SIDE].copy()
    for k in range(1, _SIDE + 2):
        np.maximum(whole, out[:, k : k + columns : _SIDE], out=whole)
    return whole
