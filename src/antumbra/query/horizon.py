"""Light samples below the horizons of receivers, without any triangle."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import ptr
from .shadow import ShadowQuery, horizon_of, is_above, new_bits, patch_of, query_pointers, sample_of, set_bit


@kernel
def _below_kernel(ticket, query, bits):
    asked, out = query_pointers(query), ptr(bits)
    for i in items(ticket):
        patch, horizon = patch_of(asked, i), horizon_of(asked, i)
        for s in range(asked.spp):
            x, y, z = sample_of(asked, patch, i, s)
            if not is_above(horizon, x, y, z, asked.corners):
                set_bit(asked, out, i, s)


def below_horizon(query: ShadowQuery, threads: int | None = None) -> np.ndarray:
    """(h, w, ceil(spp / 64)) uint64: bit s is set where the receiver's own surface occludes sample s."""
    bits = new_bits(query)
    run(_below_kernel, thread_count(threads), new_ticket(query.sides.size, 256), query, bits)
    return bits
