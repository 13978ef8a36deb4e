"""All triangles that segments meet. The builder `srdh` needs them for its rays [Feltman et al. 2012, Sec. 3.4]."""

import numpy as np

from ...bvh.nodes import Bvh, tree_of
from ...bvh.rayset import Intersections
from ...kernels.jit import kernel
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.predicate.exact import segment
from ...kernels.simd import atomic_add, get, put, stack_i32
from .orders import LEFT_FIRST
from .traverse import HitList, walk

MOST_HITS = 1 << 14
"""The most triangles that are kept for a segment; others are left out."""

_CHUNK = 64
_A_RAY = 16  # hits for each segment that the first allocation has room for


@kernel
def _collect(ticket, bvh, origins, ends, skip, cull_faces, next_free, prims, spans):
    """Worker: write the triangles that each segment meets to `prims`, as far as there is room, and their `spans`."""
    # In: bvh, origins, ends, skip, cull_faces. Out: next_free, prims, spans.
    tree, found, n = tree_of(bvh), stack_i32(MOST_HITS), stack_i32(1)
    hits = HitList(found, n, np.int64(MOST_HITS))
    for i in items(ticket):
        put(n, 0, 0)
        o, e = origins[i], ends[i]
        ray = segment(o[0], o[1], o[2], e[0], e[1], e[2])
        if ray.dx != 0.0 or ray.dy != 0.0 or ray.dz != 0.0:
            walk(tree, ray, np.int64(skip[i]), cull_faces, np.int64(LEFT_FIRST), hits, None)
        start, count = np.int64(0), np.int64(get(n, 0))
        if count > 0:
            start = atomic_add(next_free, 0, count)
        for k in range(min(count, len(prims) - start)):
            prims[start + k] = get(found, k)
        spans[i, 0], spans[i, 1] = start, count


def intersections(bvh: Bvh, origins, ends, skip, threads: int | None = None, cull_faces: int = 0) -> Intersections:
    """All triangles that segments meet, by exact tests.

    origins, ends : (m, 3) float32
    skip : (m,) int32, a triangle that does not count for each segment, or -1
    cull_faces : a value of `query.shadow_query.CULL_FACES`
    """
    m, room = len(origins), _A_RAY * len(origins)
    spans = np.empty((m, 2), np.int64)
    while True:
        next_free, prims = np.zeros(1, np.int64), np.empty(room, np.int32)
        ticket = new_ticket(m, _CHUNK)
        run(_collect, thread_count(threads), ticket, bvh, origins, ends, skip, cull_faces, next_free, prims, spans)
        if next_free[0] <= room:
            break
        room = int(next_free[0])
    starts, counts = spans.T
    first = np.concatenate([[0], np.cumsum(counts)])
    # threads write to `prims` in any order; sort by segment, so that the result does not depend on threads
    order = np.repeat(starts - first[:-1], counts) + np.arange(first[-1])
    return Intersections(origins, ends, first, prims[order])
