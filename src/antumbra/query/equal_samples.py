"""Equal samples: where all samples of each receiver are one point, one ray answers them all.

So it is for point lights, for suns without a diameter, for areas that float32 rounds to a point, and for lists of one
position or direction. Whoever traces a query traces `with_distinct_samples` of it, and copies the bit of the single
sample to the others with `copy_bits`. Queries and bits keep all samples, so results do not depend on it.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..scene.lights import AMBIENT, DIRECTIONAL, FIXED, SPHERE, Light, LightPatch
from .shadow_query import ShadowQuery

_AT_ORIGIN = np.zeros(3)


def have_equal_samples(light: LightPatch, sets: NDArray[np.float64]) -> bool:
    """Whether the samples of any receiver are equal, for the sample sets (16, n, 3) of a light."""
    if light.kind in (FIXED, DIRECTIONAL) and not any(map(np.count_nonzero, (light.u, light.v, light.w))):
        return True  # at once: a single point is answered in less time than its 16 samples are compared
    return all(
        bool((ends == ends[:, :1]).all()) for ends in (_ends(light, some) for some in (sets[:1, :2], sets))
    )  # most lights differ in the first two samples


def _ends(light: LightPatch, sets: NDArray[np.float64]) -> np.ndarray:
    """(k, n, ...): what the samples of a receiver depend on; equal if these samples are equal for all receivers."""
    if light.kind in (SPHERE, AMBIENT):  # the axes depend on the receiver
        return sets
    a, b, c = (sets[..., k, None] * axis for k, axis in enumerate((light.u, light.v, light.w)))
    if light.kind == DIRECTIONAL:  # the base depends on the receiver
        return np.stack([a, b, c], -1)
    ends: NDArray[np.float32] = (((light.base + a) + b) + c).astype(np.float32)  # as `light_samples.sample_point`
    return ends


def with_distinct_samples(query: ShadowQuery) -> ShadowQuery:
    """The query with the first sample of each set if all samples of each receiver are equal, or the same query."""
    if query.samples.shape[1] < 2 or not have_equal_samples(query.light, query.samples):
        return query
    return query._replace(samples=np.ascontiguousarray(query.samples[:, :1]))


def traced_samples(light: Light, sets: NDArray[np.float64]) -> int:
    """The number of rays per receiver to a light with sample sets (16, n, 3), before a scene places the light."""
    n = sets.shape[1]
    return 1 if n > 1 and have_equal_samples(light.patch(_AT_ORIGIN, 1.0), sets) else n


def copy_bits(bits: NDArray[np.uint64], samples: int) -> NDArray[np.uint64]:
    """(h, w, ceil(samples / 64)) uint64: the bits of all samples, each that of the only sample in (h, w, 1) `bits`."""
    copies: NDArray[np.uint64] = bits * _all_samples(samples)
    return copies


@lru_cache(64)
def _all_samples(samples: int) -> NDArray[np.uint64]:
    """(ceil(samples / 64),) uint64: the bits of all samples, set. The result is cached: do not write to it."""
    words = np.full(-(-samples // 64), ~np.uint64(0))
    words[-1] >>= np.uint64(-samples % 64)
    return words


def any_bit(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """(h, w, 1) uint64: the bit of a single sample, set if any of the equal samples in (h, w, words) `bits` is."""
    blocked: NDArray[np.uint64] = np.asarray(bits.any(-1, keepdims=True)).astype(np.uint64)
    return blocked
