"""`bsah`: parallel binned SAH [Wald 2007, "On fast construction of SAH-based bounding volume hierarchies"].

The triangles' boxes become records, which are split top-down (`top_down`). There are two departures from the paper:
small ranges get fewer bins, and ranges of at most four records get the optimal tree (`top_down.build_optimal_subtree`).
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..kernels.parallel import thread_count
from .binned_split import BIN_WORDS, binned
from .nodes import Bvh
from .top_down import Settings, build_below, largest_binned
from .top_levels import assemble, build_top, split_by_bins
from .triangle_bounds import PAIR, area_scale_for, checked_vertices, make_records, trivial_bvh


@cache
def _compile_top() -> None:
    """Load the kernels that only large scenes need, so that a process's first build warms up all later ones."""
    method = binned(2)
    build_top(2, *make_records(PAIR, method.records, 1), 1, split_by_bins(method, np.float32(1.0), 1))


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH by binned SAH. The tree is bitwise identical for any number of threads.

    Parameters
    ----------
    vertices : (n, 3, 3) float32
        Corners of the triangles, of magnitude below MAX_COORDINATE. Triangles may coincide or have no area.
    threads : int or None
        None means all cores.
    max_leaf : int
        Maximum number of triangles in a leaf, 1 to MAX_LEAF.

    Returns
    -------
    Bvh
        Boxes are the exact, unpadded bounds of the vertices. A left child follows its parent in memory.

    Raises
    ------
    InputError
        If the shape or dtype is wrong, there are too many triangles, or a coordinate is not finite or too large.

    Notes
    -----
    Visiting a node and testing a triangle cost 1 each. A range whose centroids all coincide is halved, since no split
    has a finite cost. So is a range so deep that only halving keeps the tree within MAX_DEPTH.
    """
    flat, threads = checked_vertices(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    _compile_top()
    if n < 2:
        return trivial_bvh(flat)
    method = binned(n)
    box, centroids = make_records(flat, method.records, threads)
    settings = Settings(np.int64(max_leaf), area_scale_for(box))
    top = build_top(n, box, centroids, largest_binned(n), split_by_bins(method, settings.scale, threads))
    bvh, subtrees = build_below(flat, method, BIN_WORDS, top, settings, threads)
    spare = method.spare
    del method  # frees the records
    return assemble(bvh, top, subtrees, threads, spare)
