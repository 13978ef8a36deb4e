"""`bsah`: binned SAH, in parallel [Wald 2007, "On fast construction of SAH-based bounding volume hierarchies"].

The boxes of all triangles become records, which are split top-down (`top_down`). There are two departures from the
paper. Few records get few bins, and four records or fewer get the best of all trees (`smallest`).
"""

from functools import cache

import numpy as np

from ..kernels.parallel import thread_count
from .binned_split import BIN_WORDS, binned
from .nodes import Bvh
from .top_down import Settings, build_below, largest_subtree
from .top_levels import assemble, build_top, split_by_bins
from .triangle_bounds import PAIR, checked, make_records, power_of_two_for, tiny


@cache
def _compile_top() -> None:
    """Load the kernels that only large scenes run, so that the first build of a process readies all later ones."""
    method = binned(2)
    build_top(2, *make_records(PAIR, method.records, 1), 1, split_by_bins(method, np.float32(1.0), 1))


def build(vertices: np.ndarray, threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """Build a BVH by binned SAH; the same, bit for bit, for any number of threads.

    Parameters
    ----------
    vertices : (n, 3, 3) float32
        Corners of triangles, of magnitude less than MAX_COORDINATE. Triangles may be equal, or have no area.
    threads : int or None
        None: all cores.
    max_leaf : int
        Triangles in a leaf, 1 to MAX_LEAF.

    Returns
    -------
    Bvh
        Boxes are the exact bounds of the vertices, without padding. A left child follows its parent in memory.

    Raises
    ------
    InputError
        On another shape or dtype, too many triangles, or a coordinate that is not finite or too large.

    Notes
    -----
    Visiting a node costs 1, and testing a triangle costs 1. A range is halved if all its centroids coincide, since
    no split then has a finite cost. It is also halved if its depth leaves no other way to stay within MAX_DEPTH.
    """
    flat, threads = checked(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    _compile_top()
    if n < 2:
        return tiny(flat)
    method = binned(n)
    box, centroids = make_records(flat, method.records, threads)
    settings = Settings(np.int64(max_leaf), power_of_two_for(box))
    top = build_top(n, box, centroids, largest_subtree(n), split_by_bins(method, settings.scale, threads))
    bvh, subtrees = build_below(flat, method, BIN_WORDS, top, settings, threads)
    del method  # room for the final nodes
    return assemble(bvh, top, subtrees, threads)
