"""The cost model: predicted nanoseconds per ray of one thread, for each strategy.

The logarithm of a rate is a weighted sum of terms of the `QueryFeatures`, with weights fitted to measurements
(docs/design/auto.md). Measured rates scatter around the prediction by a factor of two, those of one query together. The
model selects the strategies that are worth trying, and decides alone for queries too short for a sample.

All times are computing time: the seconds that one thread would take.
"""

import json
from functools import cache
from math import inf, log2
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ...base.files import atomic_output, make_folder, read_trusted
from ...kernels.processor import level
from ...kernels.toolchain.kernel_cache import cache_root
from ...scene.lights import AMBIENT, DIRECTIONAL, LIST
from .query_features import QueryFeatures

QUICK, GOOD, GUIDED, BEST = "lbvh", "bsah", "srdh", "bsah+reinsert"
"""Builders: the fastest build, a good trade-off of build and ray time, the fastest rays of known queries [Feltman et
al. 2012], and the fastest rays of any queries."""

RAY_SECONDS = 1e-7
"""Default estimate of the time of a ray on one thread."""

_STRATA = 16
_MOST_SAMPLES = 24  # of the queries of the fit; the exponents of more samples are unknown
_QUICK_OVERHEAD = {"multifrusta": 0.12, "cones": 0.0}  # strategy -> see `lost_share`
_OTHER_QUICK_OVERHEAD = 0.22  # of all other strategies
_LOST_IN_GOOD = 0.5  # the part of the time lost in a QUICK tree that is also lost in a GOOD one
_GOOD_OVERHEAD = 0.12  # relative increase of the trace time in a GOOD tree over a BEST one
_MAX_BEST_TRIANGLES = 1 << 24  # `reinsert` takes about 100 bytes per triangle while it runs
_REFIT = 15.0  # nanoseconds per triangle
_MARK, _MARK_RECEIVER, _MARK_LIGHT = 8e5, 5.0, 6e5  # culling: nanoseconds in all, per receiver and per light
_SELECT = 6.0  # culling: nanoseconds per triangle of the scene
_MORTON_CAPACITY = 1 << 18  # triangles that the Morton cells of QUICK can separate


def terms(features: QueryFeatures) -> NDArray[np.float64]:
    """(k,) float64: the terms of Eq. (1) in docs/design/auto.md."""
    n, m, log = np.log(max(features.triangles, 1)), np.log(max(features.receivers, 1)), np.log
    few, many = log(min(features.samples, _STRATA)), log(min(max(features.samples, _STRATA), _MOST_SAMPLES))
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
    return cast(dict[str, Any], json.loads((Path(__file__).parent / "rates.json").read_text()))


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
    {},
    {"multifrusta": 40.0, "packet16:blocks": 40.0, "wide": 70.0},
    {QUICK: 40.0, GOOD: 195.0, GUIDED: 285.0, BEST: 600.0},
)
"""Rates used until `antumbra warmup` has measured this machine."""


def machine_rates_file() -> Path:
    """The file with the measured `MachineRates`, in the user's cache."""
    return cache_root() / f"rates-{level()}.json"


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
    """The relative increase of the trace time in a QUICK tree over a GUIDED one; ``""`` for an unknown strategy."""
    return _QUICK_OVERHEAD.get(strategy, _OTHER_QUICK_OVERHEAD)


def lost_in_quick(strategy: str, seconds: float) -> float:
    """The part of a query's `seconds` in a QUICK tree that a GUIDED tree would save."""
    share = lost_share(strategy)
    return seconds * share / (1.0 + share)


def choose_builder(triangles: int, lost: float, guided: bool) -> str:
    """QUICK, GOOD or GUIDED: the builder with the least time to build and lost time.

    lost : seconds that rays lose in a QUICK tree, see `lost_share`
    guided : whether sample rays are known
    """
    costs = _tree_costs(triangles, lost, guided)
    return min(costs, key=costs.__getitem__)


def tree_seconds(triangles: int, lost: float, strategy: str, guided: bool) -> float:
    """Predicted seconds to build the tree of `choose_builder` in the form of a strategy, and to lose in it."""
    return min(_tree_costs(triangles, lost, guided).values()) + form_seconds(strategy, triangles)


def _tree_costs(triangles: int, lost: float, guided: bool) -> dict[str, float]:
    lost *= _crowding(triangles)
    costs = {
        QUICK: build_seconds(QUICK, triangles) + lost,
        GOOD: build_seconds(GOOD, triangles) + _LOST_IN_GOOD * lost,
    }
    return {**costs, GUIDED: build_seconds(GUIDED, triangles)} if guided else costs


def refit_seconds(triangles: int, strategy: str) -> float:
    """Predicted seconds to refit a tree and to convert it to the form that a strategy traverses."""
    return 1e-9 * _REFIT * triangles + form_seconds(strategy, triangles)


def mark_seconds(receivers: int, lights: int) -> float:
    """Predicted seconds to mark the cells that segments may enter."""
    return 1e-9 * (_MARK + _MARK_RECEIVER * receivers + _MARK_LIGHT * lights)


def select_seconds(triangles: int) -> float:
    """Predicted seconds to find the triangles in marked cells."""
    return 1e-9 * _SELECT * triangles


def seconds_before_best(triangles: int) -> float:
    """Seconds of rays in a GOOD tree after which a BEST one pays off; inf: never."""
    return build_seconds(BEST, triangles) / _GOOD_OVERHEAD if triangles <= _MAX_BEST_TRIANGLES else inf


def best_pays(seconds: float, triangles: int) -> bool:
    """Whether rays that took `seconds` in a GOOD tree have lost as much time there as building a BEST one costs.

    False in scenes of more than `_MAX_BEST_TRIANGLES` triangles, where memory may run short.
    """
    return seconds > seconds_before_best(triangles)


def rebuild_pays(seconds: float, builder: str, triangles: int) -> bool:
    """Whether rays have lost as much time in a refitted tree as building it again costs."""
    return seconds > build_seconds(builder, triangles)


def _crowding(triangles: int) -> float:
    """The factor by which rays of a large scene lose more time in a QUICK tree than `lost_share` says.

    The Morton codes of QUICK have 1024 cells along each axis, so triangles of a large scene share cells.
    """
    return 1.0 + 0.5 * max(0.0, log2(max(triangles, 1) / _MORTON_CAPACITY))
