"""Ray lists in memory: a moment's tree is optimised once its rays have lost the time that this takes.

So at most twice the necessary time is lost, however many rays follow. `choosing` has the same rule for pictures.
"""

import threading
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ..auto.rates import BEST, GOOD, seconds_before_best
from ..plan import Plan, parse_plan
from ..query.ray_list import HitArrays, RayArguments, changed, hit_arrays, rays_of
from ..scene.memory import MemoryData
from ..scene.triangles import Triangles
from ..trace.alpha_test import add_hits
from ..trace.rays.ray_batches import RayTracer
from .accelerate import Accelerated, Accelerator
from .choosing import best_tree_job
from .ready import Job, fixed_job, make_ready, small_scene
from .trees import Trees

PLANS = f"{GOOD}+wide", f"{BEST}+wide"
"""The plan of a moment's first rays, and that of later ones."""


class _Ready(NamedTuple):
    """The tree of a moment."""

    time: float
    plan: Plan
    until: float  # seconds of rays, after which a better tree pays
    accelerated: Accelerated
    tracer: RayTracer


class RayLists:
    """Traces the ray lists of a scene in memory. Threads of Python may share it.

    spent : float
        Seconds that the rays of the latest moment took.
    """

    def __init__(self, data: MemoryData, trees: Trees, threads: int):
        self._data, self._trees, self._threads = data, trees, threads
        self._ready: _Ready | None = None
        self._lock = threading.RLock()
        self.spent = 0.0

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> HitArrays:
        """The hits of rays at a time within 0 .. `duration`.

        Raises
        ------
        InputError
            If a ray holds an illegal number: NaN, infinity, a zero direction, ...
        """
        ready = self._ready_at(time)
        out, start = hit_arrays(rays.n, any_hit), perf_counter()
        legal = ready.tracer.trace(rays, any_hit, out, threads)
        self.spent += perf_counter() - start
        if not legal:  # and what was traced is not whole
            rays.arrays().check()
            raise changed()
        if ready.accelerated.cutouts is not None:
            add_hits(ready.accelerated.cutouts, rays.arrays(), rays.cull_faces, any_hit, out, threads)
        return out

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        """The triangles that rays with these hits meet, and the index of each ray's triangle in them, or -1."""
        return self._ready_at(time).accelerated.triangles, face

    @property
    def plan(self) -> Plan | None:
        """The plan of the latest rays."""
        return None if self._ready is None else self._ready.plan

    def _ready_at(self, time: float) -> _Ready:
        ready = self._ready
        return self._make_ready(time) if ready is None or ready.time != time or self.spent > ready.until else ready

    def _make_ready(self, time: float) -> _Ready:
        with self._lock:
            ready = self._ready
            if ready is None or ready.time != time:
                make_ready(rays_job)
                self.spent, plan = 0.0, parse_plan(PLANS[0])
            elif self.spent > ready.until:
                make_ready(best_tree_job)
                self._trees.forget(ready.plan)
                plan = parse_plan(PLANS[1])
            else:  # another thread was faster
                return ready
            made = self._trees.of(Accelerator(plan, self._threads), time)
            until = seconds_before_best(self._data.n_triangles) if str(plan) == PLANS[0] else np.inf
            self._ready = _Ready(time, plan, until, made, RayTracer(made.prepared))
            return self._ready


def rays_job() -> Job:
    """The job of ray queries."""

    def work():
        triangles = small_scene().triangles(0.0, 1)
        tracer = RayTracer(Accelerator(parse_plan(PLANS[0]), 1).build(triangles).prepared)
        rays = rays_of(np.zeros(3), np.ones(3), 0.0, 1.0, None, None, (0.0, 0.0, 0.0), 1)
        for any_hit in True, False:
            tracer.trace(rays, any_hit, hit_arrays(1, any_hit), 1)

    return fixed_job("ray queries", work)
