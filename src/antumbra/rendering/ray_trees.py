"""The plan of ray lists in memory: a moment's tree is optimised once its rays have lost the time that this takes.

So at most twice the necessary time is lost, however many rays follow. `choosing` has the same rule for pictures.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter

from ..auto.rates import BEST, GOOD, best_pays
from ..plan import Plan, parse_plan
from .choosing import best_tree_job
from .ready import make_ready

PLAN, _BEST_PLAN = f"{GOOD}+wide", f"{BEST}+wide"
_SPENT = "_ray_seconds"  # attribute of a scene: (time, seconds of the rays of this moment)


def plan_at(scene, time: float) -> Plan:
    """The plan for the next rays of a scene at a time."""
    if not best_pays(_spent(scene, time), scene.n_triangles):
        return parse_plan(PLAN)
    make_ready(best_tree_job)
    _, plans = scene.__dict__.get("_accelerated", (time, {}))
    plans.pop(parse_plan(PLAN), None)  # room for the better tree
    return parse_plan(_BEST_PLAN)


@contextmanager
def counted(scene, time: float) -> Iterator[None]:
    """Within the context, rays of a scene at a time are traced."""
    start = perf_counter()
    yield
    scene.__dict__[_SPENT] = time, _spent(scene, time) + perf_counter() - start


def forget(scene) -> None:
    """Count a scene's rays anew."""
    scene.__dict__.pop(_SPENT, None)


def _spent(scene, time: float) -> float:
    at, seconds = scene.__dict__.get(_SPENT, (time, 0.0))
    return seconds if at == time else 0.0
