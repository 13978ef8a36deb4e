"""Regions of tiles: each tile of a picture is in one region, at one place."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.trace.frusta.tile_clusters import RUN, corner_of, layout_of, runs, tile_in
from antumbra.trace.tile import TileShape


@kernel
def _places(layout, n, places):
    for at in range(n):
        y, x = corner_of(layout, at)
        for g in range(16):
            row, column = tile_in(layout, g)
            places[at, g, 0], places[at, g, 1] = y + row, x + column


SHAPES = [(1, 1, 4), (4, 4, 4), (33, 5, 4), (40, 70, 4), (1000, 1, 4), (3, 90, 4), (1, 1, 1), (1000, 1, 1)]


@pytest.mark.parametrize("columns, rows, height", SHAPES)
def test_each_tile_is_in_one_region(columns, rows, height):
    shape = TileShape(16 // height, height, columns, rows)
    layout = layout_of(shape)
    places = np.zeros((runs(layout) * RUN, 16, 2), np.int64)
    _places(layout, len(places), places)
    places = places.reshape(-1, 2)
    inside = places[(places[:, 0] < rows) & (places[:, 1] < columns)]
    assert (places >= 0).all() and len(inside) == rows * columns == len(np.unique(inside, axis=0))
