"""The cost model: predicted nanoseconds per ray of one thread, for each strategy.

The logarithm of a rate is a sum of terms of the `QueryFeatures`. Its weights were fitted to measurements
(docs/design/auto.md). The measured rates of a case scatter around it by a factor of 1.6, so it only says which
strategies are worth a try, and decides alone for queries that are done at once.
"""

import json
from functools import cache
from importlib.resources import files
from math import inf, log2
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...files import atomic_output, make_folder, read_own
from ...kernels.toolchain.kernel_cache import user_cache
from ...scene.lights import AMBIENT, DIRECTIONAL, LIST
from .query_features import QueryFeatures

QUICK, GOOD, BEST = "lbvh", "bsah", "bsah+reinsert"
"""Trees: built soonest, with the fastest rays for its build, and with the fastest rays."""

_STRATA = 16
_LOST = {"multifrusta": 0.2}  # way -> see `lost_share`
_OTHERS_LOSE = 0.4
_LOST_IN_GOOD = 0.08  # share of the time to trace that a tree of GOOD costs more than one of BEST
_LARGE = 1 << 24  # triangles: `reinsert` takes about 100 bytes for each while it runs
_ROOM = 1 << 18  # triangles that the cells of QUICK keep apart


def terms(facts: QueryFeatures) -> np.ndarray:
    """(k,) float64: the terms of Eq. (1) in docs/design/auto.md."""
    n, m, log = np.log(max(facts.triangles, 1)), np.log(max(facts.receivers, 1)), np.log
    few, many = log(min(facts.samples, _STRATA)), log(max(facts.samples, _STRATA))
    tile, narrow, wide = log(facts.tile), log(facts.tile / 2 + facts.stratum), log(facts.tile / 2 + facts.chunk)
    ambient, listed, distant = (float(facts.kind == kind) for kind in (AMBIENT, LIST, DIRECTIONAL))
    return np.array([
        1.0, ambient, listed, distant, n, m, few, many, tile, narrow, wide, few * tile, few * narrow, tile * tile,
        narrow * narrow, narrow * n, tile * n, ambient * tile, ambient * narrow, listed * tile, wide * wide, few * few,
    ])  # fmt: skip


@cache
def _shipped() -> dict:
    return json.loads(files(__package__).joinpath("rates.json").read_text())


@cache
def weights() -> dict[str, np.ndarray]:
    """Way -> the weights of `terms`."""
    return {way: np.array(values) for way, values in _shipped()["weights"].items()}


def reference() -> dict[str, float]:
    """Way -> nanoseconds a ray of `engine.calibration.ray_times`, on the machine of the fit."""
    return _shipped()["reference"]


class MachineRates(NamedTuple):
    """How fast this machine is."""

    slower: dict[str, float]  # way -> its measured rates relative to the fitted ones
    forms: dict[str, float]  # way -> nanoseconds a triangle to make the form that it walks
    builds: dict[str, float]  # tree -> nanoseconds a triangle


SHIPPED = MachineRates(
    {}, {"multifrusta": 40.0, "packet16:blocks": 40.0, "wide": 70.0}, {QUICK: 45.0, GOOD: 270.0, BEST: 1000.0}
)
"""Of two cores; used where `antumbra warmup` has not measured."""


def machine_rates_file() -> Path:
    """Where the measured `Machine` is kept, beside the kernels."""
    return user_cache().path / "rates.json"


@cache
def machine_rates() -> MachineRates:
    """What was measured on this machine, or `SHIPPED`."""
    try:
        return MachineRates(**json.loads(read_own(machine_rates_file())))
    except (OSError, ValueError, TypeError):  # never measured, or by another version
        return SHIPPED


def store_machine_rates(measured: MachineRates) -> None:
    """Keep what was measured, for this process and later ones."""
    path = machine_rates_file()
    make_folder(path.parent)
    with atomic_output(path) as temporary:
        temporary.write_text(json.dumps(measured._asdict()))
    machine_rates.cache_clear()


def predicted_rate(way: str, facts: QueryFeatures) -> float:
    """Predicted seconds of one thread for a ray."""
    return 1e-9 * float(np.exp(terms(facts) @ weights()[way])) * machine_rates().slower.get(way, 1.0)


def form_seconds(way: str, triangles: int) -> float:
    """Predicted seconds to make the form that a way walks."""
    return 1e-9 * machine_rates().forms.get(way, 0.0) * triangles


def build_seconds(tree: str, triangles: int) -> float:
    """Predicted seconds to build a tree."""
    return 1e-9 * machine_rates().builds.get(tree, SHIPPED.builds[tree]) * triangles


def lost_share(way: str) -> float:
    """The share of the time to trace that a tree of QUICK costs more than one of GOOD."""
    return _LOST.get(way, _OTHERS_LOSE)


def lost_in_quick(way: str, seconds: float, triangles: int) -> float:
    """Seconds of a query that takes so many in a tree of QUICK, and that it would not take in one of GOOD."""
    share = lost_share(way) * _crowded(triangles)
    return seconds * share / (1.0 + share)


def better_seconds(way: str, triangles: int) -> float:
    """Predicted seconds to build a tree of GOOD, and its form for a way, where a tree of QUICK is there."""
    return build_seconds(GOOD, triangles) + form_seconds(way, triangles)


def good_pays(lost: float, triangles: int) -> bool:
    """Is a tree of GOOD built sooner than its rays are slower in a tree of QUICK?

    lost : seconds, by `lost_share`
    """
    return lost * _crowded(triangles) > build_seconds(GOOD, triangles) - build_seconds(QUICK, triangles)


def seconds_before_best(triangles: int) -> float:
    """Seconds of rays in a tree of GOOD after which one of BEST pays; inf: never."""
    return build_seconds(BEST, triangles) / _LOST_IN_GOOD if triangles <= _LARGE else inf


def best_pays(seconds: float, triangles: int) -> bool:
    """Have rays that took so many seconds in a tree of GOOD lost as much there as one of BEST costs?

    Never in scenes of more than `_LARGE` triangles, whose memory may be short.
    """
    return seconds > seconds_before_best(triangles)


def _crowded(triangles: int) -> float:
    """How much more than `lost_share` a tree of QUICK loses in a large scene.

    Its Morton codes have 1024 cells along an axis, so triangles of a large scene share cells.
    """
    return 1.0 + 0.5 * max(0.0, log2(max(triangles, 1) / _ROOM))
