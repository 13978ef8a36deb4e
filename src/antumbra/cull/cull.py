"""Pre-BVH culling [Selgrad et al. 2015, Sec. 3]: from the segments that are asked to the triangles they can meet.

Receivers and lights become boxes (`sources`, `targets`), the cells between them are marked (`swept`), and triangles
that overlap no marked cell are dropped (`relevance`). The paper's grid lies over the whole scene; here it lies over the
box of all segments, so its cells are as small as they can be.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..kernels.parallel import thread_count
from ..query.bounds import bounds
from .grid import Grid, grid_over
from .relevance import marks_of, relevant
from .sources import FINEST, Tiles, bounds_of, sources_of, tiles_of
from .swept import mark_hulls
from .targets import targets_of

STEPS = ("sources", "mark", "triangles")
"""What culling does: receivers into cells, marking cells, finding and packing the triangles that are left."""


class Culled(NamedTuple):
    """What is left of a scene."""

    kept: np.ndarray  # (m,) int32, ascending: which triangles
    vertices: np.ndarray  # (m, 3, 3) float32, theirs
    grid: Grid | None  # None: no segment is asked, or none can meet a triangle
    marked: np.ndarray | None  # (n, n, n) uint8: 1 where segments can be
    sources: int  # boxes of receivers
    targets: int  # boxes of lights


def cull(
    triangles, queries, threads: int | None = None, *, n: int = 32, mark: Callable = mark_hulls, whole: bool = False,
    lap: Callable[[str], None] = lambda step: None,
) -> Culled:  # fmt: skip
    """The triangles that a segment of any of the queries can meet, and perhaps some more.

    Parameters
    ----------
    triangles : Triangles
        All that the scene has.
    queries : list of ShadowQuery
        Every sample that will be asked must be in one of them. The answers over the culled triangles are, to the bit,
        those over all triangles.
    threads : int or None
        None: all cores.
    n : int
        Cells of the grid along an axis.
    mark : function of (sources, targets, grid, marked, threads)
        How the cells between sources and targets are found.
    whole : bool
        Whether the grid lies over the whole scene and all lights.
    lap : function of str
        Told which of STEPS has just been done.
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
    kept, packed = relevant(corners, grid, marks_of(marked, threads), threads)
    lap("triangles")
    return Culled(kept, packed.reshape(-1, 3, 3), grid, marked, *counts.tolist())


def _groups(queries, threads) -> list[tuple[Tiles, list]]:
    """The queries that share their receivers, which are sorted into tiles once, and have any."""
    groups: dict[tuple[int, int], tuple[Tiles, list]] = {}
    for query in queries:
        key = id(query.origins), id(query.sides)
        if key not in groups:
            groups[key] = tiles_of(query, threads), []
        groups[key][1].append(query)
    return [group for group in groups.values() if bounds_of(group[0]) is not None]


def _box_of(groups, corners, whole: bool, threads) -> tuple[np.ndarray, np.ndarray] | None:
    """Lower and upper corner, (3,) float64, of where segments and triangles both are; None: nowhere.

    `whole`: of all triangles, receivers and lights instead.
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
