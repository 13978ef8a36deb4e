"""What a tracer costs: the model from which the plan `auto` predicts its time for a query.

A tracer states its cost with `Cost`, or with `TreelessCost` if it traverses no tree. The rates of the built-in tracers
are `FittedRate`s: the logarithm of a rate is a weighted sum of terms of the `QueryFeatures`, with weights fitted to
measurements by ``benchmarks/fit_auto.py`` (docs/design/auto.md).
"""

from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scene.lights import AMBIENT, DIRECTIONAL, LIST

_STRATA = 16
_NOT_FACING = 0.15  # cost of a ray from a receiver that does not face the light, relative to one that is traced
_MOST_SAMPLES = 24  # of the queries of the fit; the exponents of more samples are unknown

LIKELY = 2.2
"""A tracer predicted to cost more than this multiple of the least cost is not tried, unless its `Cost` says more."""


class QueryFeatures(NamedTuple):
    """Counts and sizes of a query. Sizes are sums over the axes, relative to the scene's extents."""

    triangles: int
    receivers: int
    samples: int  # per receiver
    kind: int  # of the light, see `LightPatch.kind`; a sky counts as a LIST, since its rays have no common direction
    tile: float  # mean size of the box of a tile's 16 receivers
    stratum: float  # mean size of a stratum of the light's samples, halfway to the light
    chunk: float  # the same for 16 strata
    facing: float = 1.0  # share of the receivers that face the light; the surfaces of the others block their rays

    @property
    def rays(self) -> int:
        """The number of shadow rays."""
        return self.receivers * self.samples


@lru_cache(8)
def terms(features: QueryFeatures) -> NDArray[np.float64]:
    """(24,) float64: the terms of Eq. (1) in docs/design/auto.md. The result is cached: do not write to it."""
    n, m, log = np.log(max(features.triangles, 1)), np.log(max(features.receivers, 1)), np.log
    few, many = log(min(features.samples, _STRATA)), log(min(max(features.samples, _STRATA), _MOST_SAMPLES))
    tile, narrow, wide = (
        log(features.tile),
        log(features.tile / 2 + features.stratum),
        log(features.tile / 2 + features.chunk),
    )
    ambient, listed, distant = (float(features.kind == kind) for kind in (AMBIENT, LIST, DIRECTIONAL))
    facing = log(_NOT_FACING + features.facing)
    return np.array([
        1.0, ambient, listed, distant, n, m, few, many, tile, narrow, wide, few * tile, few * narrow, tile * tile,
        narrow * narrow, narrow * n, tile * n, ambient * tile, ambient * narrow, listed * tile, wide * wide, few * few,
        facing, facing * few,
    ])  # fmt: skip


class FittedRate:
    """A rate fitted to measurements: called with `QueryFeatures`, it returns nanoseconds per ray.

    Parameters
    ----------
    *weights : float
        One for each of `terms`.
    """

    def __init__(self, *weights: float):
        self.weights = np.array(weights)

    def __call__(self, features: QueryFeatures) -> float:
        return float(np.exp(terms(features) @ self.weights))


class Cost(NamedTuple):
    """The cost of a tracer that traverses a tree. All times are computing time, the sum over threads.

    A cost per query, such as a launch or a transfer to a device, is part of the rate: its nanoseconds divided by
    ``features.rays``. Copying the tree to a device is part of `form`. Elapsed time of a device counts for all threads
    (`kernels.parallel.thread_count`), since these could compute meanwhile.
    """

    rate: Callable[
        [QueryFeatures], float
    ]  # nanoseconds per ray; inf: the tracer cannot answer, such as for lack of memory
    form: float = 0.0  # nanoseconds per triangle to convert a BVH to the tracer's form
    quick_overhead: float = 0.22  # relative increase of the time in a tree by `lbvh` over one by `srdh`
    tried: float = LIKELY  # the multiple of the least cost up to which it is tried; above LIKELY: rates are unreliable
    reference: float | None = None  # of `engine.calibration.ray_times` where `rate` was fitted; None: not calibrated
    load: float = 0.0  # seconds to load its kernels; above 0: only for queries that pay for it, and only after a trial
    guided: float = 1.0  # time in a tree by `srdh`, relative to one by `bsah`; above 1: `bsah` may be worth building
    saving: float = 0.0  # share of the time of other tracers that it is expected to save, which pays for `load`

    @property
    def is_risky(self) -> bool:
        """Whether predictions are unreliable: it is tried at higher cost, but first on a single window."""
        return self.tried > LIKELY


class TreelessCost(NamedTuple):
    """The cost of a tracer without a tree, compared with that of a tree and its rays.

    `QueryFeatures.triangles` are those that are traced: without the ones that culling has dropped.
    """

    rate: Callable[[QueryFeatures], float]  # nanoseconds per ray, all that the query needs included
    candidate: float = 0.0  # nanoseconds per candidate (`counters.CANDIDATES`), in addition to `rate`; above 0: long
    # queries count those of a sample of triangles and rays, since they differ between scenes by a factor of thousands
    reason: str = "faster than a tree for its rays"  # why it is chosen, see `TreeChoice.why`
    load: float = 0.03  # seconds to load its kernels, once per process
    quick_overhead: float = 0.0  # as in `Cost`; there is no tree
