"""The directions in which receivers see a light's samples, for bent normals."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, put
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, patch_of, query_pointers, sample_of, three_at


@kernel
def _directions_kernel(ticket, query, bits, out):
    asked, words, sums = query_pointers(query), ptr(bits), ptr(out)
    for i in items(ticket):
        x = y = z = 0.0
        if get(asked.sides, i) != NOTHING:
            patch, p = patch_of(asked, i), three_at(asked.origins, i)
            for s in range(asked.spp):
                if get(words, i * asked.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
                    q = sample_of(asked, patch, i, s)
                    dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                    r = np.sqrt(dx * dx + dy * dy + dz * dz)
                    if r > 0.0:
                        x, y, z = x + dx / r, y + dy / r, z + dz / r
        put(sums, 3 * i, np.float32(x))
        put(sums, 3 * i + 1, np.float32(y))
        put(sums, 3 * i + 2, np.float32(z))


def open_directions(query: ShadowQuery, bits: np.ndarray, threads: int | None = None) -> np.ndarray:
    """(h, w, 3) float32: the sum of unit vectors to the samples that each receiver sees; `bits`: the query's answer."""
    out = np.empty((*query.sides.shape, 3), np.float32)
    ticket = new_ticket(query.sides.size, 1024)
    run(_directions_kernel, thread_count(threads), ticket, query, bits, out)
    return out
