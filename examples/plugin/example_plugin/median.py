"""A builder that halves the triangles at the median along the longest axis of their centroids."""

import numpy as np
from numpy.typing import NDArray

from antumbra.bvh.nodes import Bvh, aligned_empty, bvh_link, link_at
from antumbra.bvh.triangle_bounds import checked_vertices, scene_bounds, trivial_bvh
from antumbra.kernels.parallel import thread_count


def build(vertices: NDArray[np.float32], threads: int | None = None, max_leaf: int = 4) -> Bvh:
    """The BVH of triangles, (n, 3, 3) float32. Halving keeps its depth far below `nodes.MAX_DEPTH`."""
    flat = checked_vertices(vertices, max_leaf)
    scene_bounds(flat, thread_count(threads))  # raises InputError if a coordinate is not finite or too large
    n = len(flat)
    if n < 2:
        return trivial_bvh(flat)
    corners = flat.reshape(n, 3, 3)
    lower, upper, centroids = corners.min(1), corners.max(1), corners.mean(1, dtype=np.float64)
    ids, nodes = np.arange(n, dtype=np.int32), aligned_empty((n - 1, 16), "f4")
    nodes[:] = 0.0
    words, count = nodes.view(np.int32).reshape(-1), 0

    def place(first: int, last: int) -> int:
        """Write the nodes above the triangles in ``ids[first:last]``, and return the link to them."""
        nonlocal count
        if last - first <= max_leaf and (first, last) != (0, n):  # the root is never a leaf
            return int(bvh_link(first, last - first))
        node, middle = count, (first + last) // 2
        count += 1
        chosen = centroids[ids[first:last]]
        axis = int(np.argmax(chosen.max(0) - chosen.min(0)))
        ids[first:last] = ids[first:last][np.argsort(chosen[:, axis], kind="stable")]
        box = nodes[node, :12].reshape(3, 4)  # axis; L.lower, R.lower, L.upper, R.upper
        for side, part in enumerate((ids[first:middle], ids[middle:last])):
            box[:, side], box[:, side + 2] = lower[part].min(0), upper[part].max(0)
        for side, (a, b) in enumerate(((first, middle), (middle, last))):
            words[link_at(node, side)] = place(a, b)
        return node

    place(0, n)
    nodes = nodes[:count]
    return Bvh(nodes, nodes.view(np.int32), ids, flat[ids])
