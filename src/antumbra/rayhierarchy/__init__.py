"""Placeholder: every ray against every triangle, until the kernels of the ray hierarchy are there."""

import numpy as np

from ..jit import inlined, kernel
from ..parallel import new_ticket, run, take, thread_count
from ..predicate.exact import segment
from ..predicate.filters import meets
from ..query.receivers import NOTHING
from ..query.samples import sample_point
from ..query.shadow import horizon_of, is_above, patch_of
from ..simd import get, ptr
from ..trace.counters import BELOW_HORIZON, RAYS, TRIANGLE_TESTS, add_counters, count, private_counters
from .options import CONES, Cones, combination

__all__ = ["CONES", "Cones", "combination", "trace_shadow"]


@inlined
def _blocked(corners, ids, n, ray, skip, cull_faces, counters):
    for i in range(n):
        if np.int64(get(ids, i)) != skip:
            count(counters, TRIANGLE_TESTS, 1)
            side = meets(ray, corners, i)
            if side != 0 and side != cull_faces:
                return True
    return False


@kernel
def _trace_rows(ticket, soup, query, bits, counters):
    mine, n, spp = private_counters(counters), len(soup.ids), query.samples.shape[1]
    corners, ids, scene = ptr(soup.corners), ptr(soup.ids), ptr(query.corners)
    y = take(ticket)
    while y >= 0:
        for x in range(query.sides.shape[1]):
            if query.sides[y, x] == NOTHING:
                continue
            count(mine, RAYS, spp)
            patch, horizon, skip = patch_of(query, y, x), horizon_of(query, y, x), np.int64(query.faces[y, x])
            for s in range(spp):
                a, b, c = query.samples[(x & 3) + 4 * (y & 3), s]
                lx, ly, lz = sample_point(patch, a, b, c)
                if not is_above(horizon, lx, ly, lz, scene):
                    count(mine, BELOW_HORIZON, 1)
                else:
                    ray = segment(query.origins[y, x, 0], query.origins[y, x, 1], query.origins[y, x, 2], lx, ly, lz)
                    if ray.dx == 0.0 and ray.dy == 0.0 and ray.dz == 0.0:
                        continue
                    if not _blocked(corners, ids, n, ray, skip, query.cull_faces, mine):
                        continue
                bits[y, x, s >> 6] |= np.uint64(1) << np.uint64(s & 63)
        y = take(ticket)
    add_counters(counters, mine)


def trace_shadow(soup, query, bits, threads, counters, progress, options):
    ticket = new_ticket(len(query.sides), 1)
    run(_trace_rows, thread_count(threads), ticket, soup, query, bits, counters, progress=progress)
