"""The cost model: predicted nanoseconds per ray of one thread, for each strategy.

The logarithm of a rate is a weighted sum of terms of the `QueryFeatures`, with weights fitted to measurements
(docs/design/auto.md). Measured rates scatter around the prediction by a factor of 1.6. The model therefore only selects
the strategies that are worth trying; it decides alone for queries too short for a sample.
"""

import json
from functools import cache
from importlib.resources import files
from math import inf, log2
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...files import atomic_output, make_folder, read_trusted
from ...kernels.toolchain.kernel_cache import user_cache
from ...scene.lights import AMBIENT, DIRECTIONAL, LIST
from .query_features import QueryFeatures

QUICK, GOOD, BEST = "lbvh", "bsah", "bsah+reinsert"
"""Builders: the fastest build, the best trade-off of build and ray time, and the fastest rays."""

_STRATA = 16
_QUICK_OVERHEAD = {"multifrusta": 0.2}  # strategy -> see `lost_share`
_OTHER_QUICK_OVERHEAD = 0.4  # of all other strategies
_GOOD_OVERHEAD = 0.08  # relative increase of the trace time in a GOOD tree over a BEST one
_MAX_BEST_TRIANGLES = 1 << 24  # `reinsert` takes about 100 bytes per triangle while it runs
_MORTON_CAPACITY = 1 << 18  # triangles that the Morton cells of QUICK can separate


def terms(features: QueryFeatures) -> NDArray[np.float64]:
    """(k,) float64: the terms of Eq. (1) in docs/design/auto.md."""
    n, m, log = np.log(max(features.triangles, 1)), np.log(max(features.receivers, 1)), np.log
    few, many = log(min(features.samples, _STRATA)), log(max(features.samples, _STRATA))
    tile, narrow, wide = (
        log(features.tile),
        log(features.tile / 2 + features.stratum),
        log(features.tile / 2 + features.chunk),
    )
    ambient, listed, distant = (float(features.kind == kind) for kind in (AMBIENT, LIST, DIRECTIONAL))
    return np.array([
        1.0, ambient, listed, distant, n, m, few, many, tile, narrow, wide, few * tile, few * narrow, tile * tile,
        narrow * narrow, narrow * n, tile * n, ambient * tile, ambient * narrow, listed * tile, wide * wide, few * few,
    ])  # fmt: skip


@cache
def _shipped() -> dict[str, Any]:
    return cast(dict[str, Any], json.loads(files(__package__).joinpath("rates.json").read_text()))


@cache
def weights() -> dict[str, NDArray[np.float64]]:
    """Strategy -> the weights of `terms`."""
    return {strategy: np.array(values) for strategy, values in _shipped()["weights"].items()}


def reference() -> dict[str, float]:
    """Strategy -> nanoseconds per ray by `engine.calibration.ray_times`, on the machine used for the fit."""
    return cast(dict[str, float], _shipped()["reference"])


class MachineRates(NamedTuple):
    """The speed of this machine."""

    slower: dict[str, float]  # strategy -> measured time per ray relative to the fitted one
    forms: dict[str, float]  # strategy -> nanoseconds per triangle to convert the tree to its form
    builds: dict[str, float]  # builder -> nanoseconds per triangle


SHIPPED = MachineRates(
    {}, {"multifrusta": 40.0, "packet16:blocks": 40.0, "wide": 70.0}, {QUICK: 45.0, GOOD: 270.0, BEST: 1000.0}
)
"""Rates of two cores, used until `antumbra warmup` has measured this machine."""


def machine_rates_file() -> Path:
    """The file with the measured `MachineRates`, beside the kernels."""
    return user_cache().path / "rates.json"


@cache
def machine_rates() -> MachineRates:
    """The rates measured on this machine, or `SHIPPED`."""
    try:
        return MachineRates(**json.loads(read_trusted(machine_rates_file())))
    except (OSError, ValueError, TypeError):  # not measured yet, or written by another version
        return SHIPPED


def store_machine_rates(rates: MachineRates) -> None:
    """Store measured rates for this process and later ones."""
    path = machine_rates_file()
    make_folder(path.parent)
    with atomic_output(path) as temporary:
        temporary.write_text(json.dumps(rates._asdict()))
    machine_rates.cache_clear()


def predicted_rate(strategy: str, features: QueryFeatures) -> float:
    """Predicted seconds per ray, on one thread."""
    return 1e-9 * float(np.exp(terms(features) @ weights()[strategy])) * machine_rates().slower.get(strategy, 1.0)


def form_seconds(strategy: str, triangles: int) -> float:
    """Predicted seconds to convert a tree to the form that a strategy traverses."""
    return 1e-9 * machine_rates().forms.get(strategy, 0.0) * triangles


def build_seconds(builder: str, triangles: int) -> float:
    """Predicted seconds to build a tree."""
    return 1e-9 * machine_rates().builds.get(builder, SHIPPED.builds[builder]) * triangles


def lost_share(strategy: str) -> float:
    """The relative increase of the trace time in a QUICK tree over a GOOD one; ``""`` for an unknown strategy."""
    return _QUICK_OVERHEAD.get(strategy, _OTHER_QUICK_OVERHEAD)


def lost_in_quick(strategy: str, seconds: float, triangles: int) -> float:
    """The part of a query's `seconds` in a QUICK tree that a GOOD tree would save."""
    share = lost_share(strategy) * _crowding(triangles)
    return seconds * share / (1.0 + share)


def upgrade_seconds(strategy: str, triangles: int) -> float:
    """Predicted seconds to replace a QUICK tree by a GOOD one in the form that a strategy traverses."""
    return build_seconds(GOOD, triangles) + form_seconds(strategy, triangles)


def good_pays(lost: float, triangles: int) -> bool:
    """Whether rays lose more time in a QUICK tree than the longer build of a GOOD one takes.

    lost : seconds of the rays, weighted by `lost_share`
    """
    return lost * _crowding(triangles) > build_seconds(GOOD, triangles) - build_seconds(QUICK, triangles)


def seconds_before_best(triangles: int) -> float:
    """Seconds of rays in a GOOD tree after which a BEST one pays off; inf: never."""
    return build_seconds(BEST, triangles) / _GOOD_OVERHEAD if triangles <= _MAX_BEST_TRIANGLES else inf


def best_pays(seconds: float, triangles: int) -> bool:
    """Whether rays that took `seconds` in a GOOD tree have lost as much time there as building a BEST one costs.

    False in scenes of more than `_MAX_BEST_TRIANGLES` triangles, where memory may run short.
    """
    return seconds > seconds_before_best(triangles)


def _crowding(triangles: int) -> float:
    """The factor by which rays of a large scene lose more time in a QUICK tree than `lost_share` says.

    The Morton codes of QUICK have 1024 cells along each axis, so triangles of a large scene share cells.
    """
    return 1.0 + 0.5 * max(0.0, log2(max(triangles, 1) / _MORTON_CAPACITY))
