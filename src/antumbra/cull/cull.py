"""Pre-BVH culling [Selgrad et al. 2015, Sec. 3]: finds the triangles that the queries' segments can meet.

1. `sources` and `targets` make boxes of the receivers and of the lights.
2. `swept` marks the cells between these boxes.
3. `relevance` drops the triangles that overlap no marked cell.

The paper's grid lies over the whole scene. This grid lies over the box of all segments, so its cells are smaller.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..kernels.parallel import thread_count
from ..query.query_bounds import bounds
from .grid import CellGrid, grid_over
from .relevance import find, marks_of, pack
from .sources import FINEST, ReceiverTiles, bounds_of, sources_of, tiles_of
from .swept import mark_hulls
from .targets import targets_of

STEPS = ("sources", "mark", "triangles", "pack")
"""The steps of culling: sort receivers into cells, mark cells, find the triangles that are left, pack them together."""


class Culled(NamedTuple):
    """The triangles that are left of a scene, and how culling found them."""

    kept: np.ndarray  # (m,) int32, ascending: indices of the triangles that are left
    vertices: np.ndarray  # (m, 3, 3) float32: their vertices
    grid: CellGrid | None  # None: there is no segment, or no segment can meet a triangle
    marked: np.ndarray | None  # (n, n, n) uint8: 1 where segments can be
    sources: int  # number of boxes of receivers
    targets: int  # number of boxes of lights


def cull(
    triangles, queries, threads: int | None = None, *, n: int = 32, mark: Callable = mark_hulls, whole: bool = False,
    lap: Callable[[str], None] = lambda step: None,
) -> Culled:  # fmt: skip
    """Find all triangles that a segment of the queries can meet, and perhaps some more.

    Answers over the culled triangles equal answers over all triangles, bit for bit.

    Parameters
    ----------
    triangles : Triangles
        All triangles of the scene.
    queries : list of ShadowQuery
        They must hold every sample that will be asked.
    threads : int or None
        None: all cores.
    n : int
        Cells of the grid along an axis.
    mark : function of (sources, targets, grid, marked, threads)
        Marks the cells between sources and targets.
    whole : bool
        Whether the grid lies over the whole scene and all lights.
    lap : function of str
        Called after each step, with its name from STEPS.
    """
    threads, corners = thread_count(threads), triangles.vertices.reshape(-1, 9)
    groups = _groups(queries, threads)
    box = _box_of(groups, corners, whole, threads)
    if box is None:
        return Culled(np.empty(0, np.int32), np.empty((0, 3, 3), np.float32), None, None, 0, 0)
    grid, coarse = grid_over(*box, n), grid_over(*box, min(n, FINEST))
    marked, counts = np.zeros((n, n, n), np.uint8), np.zeros(2, np.int64)
    for tiles, asked in groups:
        sources = sources_of(tiles, coarse, threads)
        lap("sources")
        ends = [targets_of(query, (box[1] - box[0]) / n) for query in asked]
        for targets in ends:
            mark(sources, targets, grid, marked, threads)
        counts += len(sources), sum(len(targets.boxes) for targets in ends)
        lap("mark")
    found = find(corners, grid, marks_of(marked, threads), threads)
    lap("triangles")
    kept, packed = pack(corners, found, threads)
    lap("pack")
    return Culled(kept, packed.reshape(-1, 3, 3), grid, marked, *counts.tolist())


def _groups(queries, threads) -> list[tuple[ReceiverTiles, list]]:
    """Group the queries that share their receivers; leave out queries without receivers.

    The receivers of a group are sorted into tiles once.
    """
    groups: dict[tuple[int, int], tuple[ReceiverTiles, list]] = {}
    for query in queries:
        key = id(query.origins), id(query.sides)
        if key not in groups:
            groups[key] = tiles_of(query, threads), []
        groups[key][1].append(query)
    return [group for group in groups.values() if bounds_of(group[0]) is not None]


def _box_of(groups, corners, whole: bool, threads) -> tuple[np.ndarray, np.ndarray] | None:
    """Lower and upper corner, (3,) float64, of the grid's box; None if it is empty.

    The box is the overlap of the box of all segments and the box of all triangles. With `whole`, it is the box of all
    triangles, receivers and lights.
    """
    if not groups or not len(corners):
        return None
    everywhere = np.full(3, np.inf)
    low, high = everywhere, -everywhere
    for tiles, queries in groups:
        near, far = bounds_of(tiles)
        for query in queries:
            targets = targets_of(query, everywhere)
            if whole and targets.relative:
                continue
            ends = targets.boxes[0] + ([near, far] if targets.relative else 0.0)
            low, high = np.minimum(low, np.minimum(near, ends[0])), np.maximum(high, np.maximum(far, ends[1]))
    lower, upper = bounds(corners.reshape(-1, 3), threads)
    if whole:
        return np.minimum(low, lower), np.maximum(high, upper)
    low, high = np.maximum(low, lower), np.minimum(high, upper)
    return (low, high) if (low <= high).all() else None
