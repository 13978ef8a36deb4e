"""A query in the form of the hot kernels: cut into tiles of 16 receivers and chunks of 16 samples."""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32Ptr, F64Ptr
from ..kernels.jit import inlined
from ..kernels.simd import get, ptr, ptr_at
from ..query.shadow_query import QueryPointers, query_pointers
from .lighttable import ALL_GROUPS, GROUPS, POINTS, STRATA, TARGETS, stays

_F = np.float32
_LIGHT = _F(2.0**-6)


class TileShape(NamedTuple):
    """How receivers are cut into tiles: 4 x 4 pixels, or 16 of a row."""

    width: int  # receivers in a row of a tile
    height: int  # rows of receivers in a tile
    columns: int  # tiles in a row
    rows: int  # rows of tiles


def tile_shape(query) -> TileShape:
    """The `TileShape` of a query: 4 x 4 pixels, or 16 receivers if they form a single row."""
    h, w = query.sides.shape
    width, height = (4, 4) if h > 1 else (16, 1)
    return TileShape(width, height, -(-w // width), -(-h // height))


def sets_of(shape) -> np.ndarray:
    """(16,) int: the sample set of each lane of a tile."""
    lane = np.arange(16)
    return (lane % shape.width & 3) + 4 * (lane // shape.width)


class QueryChunk(NamedTuple):
    """A query's chunk for hot kernels."""

    query: QueryPointers
    points: F32Ptr  # float32 * into the chunk's light table, like the next three; unused if the light moves
    groups: F32Ptr  # float32 *
    targets: F32Ptr  # float32 *
    by_lane: F32Ptr  # float32 *
    samples: F64Ptr  # float64 * into the chunk's light table, like the next; unused if the light stays
    turned: F64Ptr  # float64 *
    fixed: bool  # the light does not move with the receiver
    shape: TileShape
    first: int  # first sample
    count: int  # number of samples
    light: float  # a small part of the sum of the light's extents


@inlined
def query_chunk_of(query, table, shape, chunk, n_samples):
    """The `QueryChunk` of a chunk of a query."""
    groups, light, fixed = ptr_at(ptr(table.groups), chunk * GROUPS), _F(0.0), stays(query.light)
    moving = 0 if fixed else POINTS
    if fixed:
        for k in range(3):
            light += get(groups, (3 + k) * ALL_GROUPS + 1) - get(groups, k * ALL_GROUPS + 1)
    return QueryChunk(
        query_pointers(query), ptr_at(ptr(table.points), chunk * POINTS), groups,
        ptr_at(ptr(table.targets), chunk * TARGETS), ptr_at(ptr(table.by_lane), chunk * POINTS),
        ptr_at(ptr(table.samples), chunk * moving), ptr_at(ptr(table.turned), chunk * moving), fixed, shape,
        chunk * STRATA, n_samples, light * _LIGHT,
    )  # fmt: skip


@inlined
def place_of(chunk, y0, x0, lane):
    """Index of a lane's receiver among all receivers, row by row."""
    if chunk.shape.height == 1:
        return y0 * chunk.query.w + x0 + lane
    return (y0 + (lane >> 2)) * chunk.query.w + x0 + (lane & 3)  # a division by the width would take longer
