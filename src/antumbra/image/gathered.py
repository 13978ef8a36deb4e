"""Light gathered from the samples that a receiver sees: irradiance, and the mean of the open directions."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..kernels.simd import get, ptr, put
from ..query.receivers import NOTHING
from ..query.shadow import ShadowQuery, patch_of, query_pointers, sample_of, three_at
from ..scene.lights import AMBIENT, DIRECTIONAL
from .irradiance import flat_normal, point_irradiance


@kernel
def _gather_kernel(ticket, query, bits, flat, distant, out):
    asked, words, sums = query_pointers(query), ptr(bits), ptr(out)
    flat = flat[0], flat[1], flat[2]
    first = take(ticket)
    while first >= 0:
        for i in range(first, min(first + ticket[CHUNK], ticket[N])):
            e = x = y = z = 0.0
            if get(asked.sides, i) != NOTHING:
                patch, p, n = patch_of(asked, i), three_at(asked.origins, i), three_at(asked.normals, i)
                for s in range(asked.spp):
                    if get(words, i * asked.words + (s >> 6)) >> np.uint64(s & 63) & np.uint64(1) == np.uint64(0):
                        q = sample_of(asked, patch, i, s)
                        e += point_irradiance(distant, flat, p, n, q)
                        dx, dy, dz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
                        r = np.sqrt(dx * dx + dy * dy + dz * dz)
                        if r > 0.0:
                            x, y, z = x + dx / r, y + dy / r, z + dz / r
            put(sums, 4 * i, np.float32(e / asked.spp))
            put(sums, 4 * i + 1, np.float32(x))
            put(sums, 4 * i + 2, np.float32(y))
            put(sums, 4 * i + 3, np.float32(z))
        first = take(ticket)


def gathered(query: ShadowQuery, bits: np.ndarray, threads: int | None = None) -> np.ndarray:
    """(h, w, 4) float32: the irradiance of a light of intensity 1, and the sum of unit vectors to its visible samples.

    query : with normals, (h, w, 3) float64
    bits : its answer
    """
    distant = query.light.kind in (DIRECTIONAL, AMBIENT)
    flat = np.zeros(3) if distant else flat_normal(query.light)
    out = np.empty((*query.sides.shape, 4), np.float32)
    ticket = new_ticket(query.sides.size, 1024)
    run(_gather_kernel, thread_count(threads), ticket, query, bits, flat, distant, out)
    return out
