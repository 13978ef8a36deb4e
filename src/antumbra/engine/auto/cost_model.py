"""The cost model of the plan `auto`: predicted seconds of rays, and of the trees that they need.

Each tracer states its rates (`trace.tracer_cost`); this module scales them to the machine, and adds the costs of trees.
Measured rates scatter around the prediction by a factor of two, those of one query together. The model selects the
tracers that are worth trying, and decides alone for queries too short for a sample.

All times are computing time: the seconds that one thread would take.
"""

import json
from functools import cache
from math import inf, log2
from pathlib import Path
from typing import NamedTuple

from ...base.errors import InputError
from ...base.files import atomic_output, make_folder, read_trusted
from ...kernels.processor import level
from ...kernels.toolchain.kernel_cache import cache_root
from ...trace.tracer import TRACERS, Tracer
from ...trace.tracer_cost import Cost, QueryFeatures
from .one_picture import few

QUICK, GOOD, GUIDED, BEST = "lbvh", "bsah", "srdh", "bsah+reinsert"
"""Builders: the fastest build, a good trade-off of build and ray time, the fastest rays of known queries [Feltman et
al. 2012], and the fastest rays of any queries."""

RAY_SECONDS = 1e-7
"""Default estimate of the time of a ray on one thread."""

_QUICK_OVERHEAD = 0.22  # of unknown tracers, see `lost_share`
_NEVER = 1e12  # nanoseconds per ray: instead of inf, which has no product with 0 rays
_LOST_IN_GOOD = 0.5  # the part of the time lost in a QUICK tree that is also lost in a GOOD one
_GOOD_OVERHEAD = 0.12  # relative increase of the trace time in a GOOD tree over a BEST one
_MAX_BEST_TRIANGLES = 1 << 24  # `reinsert` takes about 100 bytes per triangle while it runs
_GUIDE = 5.5e-3  # seconds to select sample rays for GUIDED, and to find what they meet
_REFIT = 15.0  # nanoseconds per triangle
_MARK, _MARK_RECEIVER, _MARK_LIGHT = 8e5, 9.0, 6e5  # culling: nanoseconds in all, per receiver and per light
_SELECT, _PACK = 6.0, 12.0  # culling: nanoseconds per triangle of the scene, and per triangle that remains
_MORTON_CAPACITY = 1 << 18  # triangles that the Morton cells of QUICK can separate


class MachineRates(NamedTuple):
    """The speed of this machine."""

    slower: dict[str, float]  # tracer -> measured time per ray relative to the rate that it states; missing: 1
    forms: dict[str, float]  # tracer -> nanoseconds per triangle to convert the tree to its form; missing: as it states
    builds: dict[str, float]  # builder -> nanoseconds per triangle, besides what GUIDED takes for its sample


SHIPPED = MachineRates({}, {}, {QUICK: 55.0, GOOD: 310.0, GUIDED: 355.0, BEST: 715.0})
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


def strategies() -> dict[str, Tracer]:
    """Name -> tracer, of all tracers that state a `Cost`: those that `auto` can choose for a query."""
    return {name: tracer for name, tracer in TRACERS.items() if isinstance(tracer.cost, Cost)}


def cost_of(tracer: str) -> Cost:
    """What a tracer states about its cost."""
    cost = TRACERS[tracer].cost
    assert isinstance(cost, Cost)
    return cost


def predicted_rate(tracer: str, features: QueryFeatures) -> float:
    """Predicted seconds per ray, on one thread; for a query without receivers, that of one receiver.

    Raises
    ------
    InputError
        If the tracer states no rate.
    """
    rate = cost_of(tracer).rate(features if features.receivers else features._replace(receivers=1))
    if not rate >= 0.0:
        raise InputError(f"tracer {tracer!r} states {rate} nanoseconds per ray; its cost must be a positive number")
    return 1e-9 * min(rate, _NEVER) * slowness(tracer)


def slowness(tracer: str) -> float:
    """The time of a tracer's rays on this machine relative to the rate that it states.

    Of a tracer that was not measured, such as one without a tree: the median of the others, since mostly the processor
    makes the difference, and predictions of tracers are compared.
    """
    measured = machine_rates().slower
    return measured.get(tracer, sorted(measured.values())[len(measured) // 2] if measured else 1.0)


def form_seconds(tracer: str | None, triangles: int) -> float:
    """Predicted seconds to convert a tree to the form that a tracer traverses; None: of an unknown tracer, zero."""
    if tracer is None:
        return 0.0
    measured = machine_rates().forms.get(tracer)
    return 1e-9 * (cost_of(tracer).form if measured is None else measured) * triangles


def build_seconds(builder: str, triangles: int) -> float:
    """Predicted seconds to build a tree."""
    seconds = 1e-9 * machine_rates().builds.get(builder, SHIPPED.builds[builder]) * triangles
    return seconds + _GUIDE if builder == GUIDED else seconds


def lost_share(tracer: str | None) -> float:
    """The relative increase of the trace time in a QUICK tree over a GUIDED one; None: of an unknown tracer."""
    cost = None if tracer is None else TRACERS[tracer].cost
    return _QUICK_OVERHEAD if cost is None else cost.quick_overhead


def lost_in_quick(tracer: str, seconds: float) -> float:
    """The part of a query's `seconds` in a QUICK tree that a GUIDED tree would save."""
    share = lost_share(tracer)
    return seconds * share / (1.0 + share)


def choose_builder(triangles: int, lost: float, guided: bool) -> str:
    """QUICK, GOOD or GUIDED: the builder with the least time to build and lost time.

    lost : seconds that rays lose in a QUICK tree, see `lost_share`
    guided : whether sample rays are known
    """
    if (only := few()) is not None:
        return only.builder
    costs = _tree_costs(triangles, lost, guided)
    return min(costs, key=costs.__getitem__)


def tree_seconds(triangles: int, lost: float, tracer: str | None, guided: bool) -> float:
    """Predicted seconds to build the tree of `choose_builder` in a tracer's form, and to lose in it."""
    return min(_tree_costs(triangles, lost, guided).values()) + form_seconds(tracer, triangles)


def _tree_costs(triangles: int, lost: float, guided: bool) -> dict[str, float]:
    lost *= _crowding(triangles)
    costs = {
        QUICK: build_seconds(QUICK, triangles) + lost,
        GOOD: build_seconds(GOOD, triangles) + _LOST_IN_GOOD * lost,
    }
    return {**costs, GUIDED: build_seconds(GUIDED, triangles)} if guided else costs


def refit_seconds(triangles: int, tracer: str | None) -> float:
    """Predicted seconds to refit a tree and to convert it to the form that a tracer traverses."""
    return 1e-9 * _REFIT * triangles + form_seconds(tracer, triangles)


def mark_seconds(receivers: int, lights: int) -> float:
    """Predicted seconds to mark the cells that segments may enter."""
    return 1e-9 * (_MARK + _MARK_RECEIVER * receivers + _MARK_LIGHT * lights)


def select_seconds(triangles: int, share: float) -> float:
    """Predicted seconds to find the triangles in marked cells, and to pack them; `share`: those of all triangles."""
    return 1e-9 * (_SELECT + _PACK * share) * triangles


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
