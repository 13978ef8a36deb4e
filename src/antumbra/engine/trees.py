"""The triangles of a scene in memory at its latest moment, and the trees that questions have had made for them."""

import threading

from ..plan import Plan
from ..scene.memory import MemoryData
from ..scene.triangles import Triangles
from .accelerate import Accelerated, Accelerator


class Trees:
    """What the engines of one scene share: triangles at a time, and a tree for each plan. Threads of Python may ask it.

    data : MemoryData
    """

    def __init__(self, data: MemoryData):
        self._data, self._lock = data, threading.RLock()
        self._time: float | None = None
        self._triangles: Triangles | None = None
        self._made: dict[Plan, Accelerated] = {}

    def triangles(self, time: float, threads: int) -> Triangles:
        """The triangles at a time within 0 .. `duration`; those of the latest time are kept."""
        with self._lock:
            if self._triangles is None or self._time != time:
                self._time, self._made = time, {}
                self._triangles = self._data.triangles(time, threads)
            return self._triangles

    def of(self, make: Accelerator, time: float) -> Accelerated:
        """The tree of a plan at a time within 0 .. `duration`. Plans that differ only in their tracer share a BVH."""
        with self._lock:
            triangles, plan = self.triangles(time, make.threads), make.plan
            kept = self._made.get(plan)
            if kept is None or make.outgrown(kept):
                like = None if plan.chooses else next((t for p, t in self._made.items() if p.tree == plan.tree), None)
                kept = make.build(triangles) if like is None else make.prepare(triangles, like.bvh)
                self._made[plan] = kept
            return kept

    def forget(self, plan: Plan) -> None:
        """Make room for a better tree than that of this plan."""
        with self._lock:
            self._made.pop(plan, None)
