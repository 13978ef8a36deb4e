"""Scenes in memory: all triangles are resident, and any plan can trace them."""

import sys
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..errors import InputError
from ..plan import DEFAULT_PLAN, Plan
from ..query.bounds import bounds
from ..query.picture import Surfaces, surfaces_of
from ..query.rays import Arguments, HitArrays, changed, hit_arrays
from ..query.subpixels import subpixel_rays
from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from ..scene.scene import Scene
from ..scene.triangles import Triangles
from ..trace.cutouts import add_hits
from ..trace.rays.batch import trace_batch
from ..trace.rays.bounce import Nearest
from .accelerate import Accelerated, Accelerator
from .looking import AUTO, RAYS, Looking
from .memory import FrameMemory
from .ray_trees import counted
from .ready import make_ready
from .see import cutouts_job, nearest_in, see, see_subpixels


class InMemory:
    """A scene whose triangles are in memory; `RenderSource` documents the methods.

    Parameters
    ----------
    scene : Scene
    accelerator : Accelerator
        Holds the plan and builds its trees.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility; "auto": the faster one, see `looking`.
    max_memory : None
        Must be None; the limit exists only for stores.

    Raises
    ------
    InputError
        If `max_memory` is given.
    """

    default_plan: ClassVar = DEFAULT_PLAN
    keeps_read: ClassVar = False
    looks: ClassVar = 0

    def __init__(self, scene: Scene, accelerator: Accelerator, gbuffer: str = AUTO, max_memory: int | None = None):
        if max_memory is not None:
            raise InputError(f"max_memory is for scenes in a store, and {scene.name} is in memory; leave it out")
        self.scene, self.gbuffer, self._looking = scene, gbuffer, Looking()
        self._accelerator, self.threads = accelerator, accelerator.threads
        self._last: Accelerated | None = None  # of earlier frames, if later frames can reuse it

    def warm_up(self) -> None:
        if self.scene.cutouts is not None:
            make_ready(cutouts_job)

    def begin(self, memory: FrameMemory) -> None:
        pass

    def together(self, size: int) -> int:
        return 1

    def at_once(self, size: int) -> int:
        return sys.maxsize

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        if self._last is None or self._accelerator.outgrown(self._last):
            self._last = None
            return self.scene.triangles(time, self.threads), None
        return self._last.triangles, self._last

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        plan = self._accelerator.plan
        if plan.cull or plan.wants_rays:
            return self.scene.triangles(time, self.threads), None
        ready = self.accelerated(time)
        return ready.triangles, ready

    def accelerated(self, time: float) -> Accelerated:
        """The scene's triangles and BVH at a time in seconds; the scene caches them, per plan, for the latest time.

        Plans that differ only in their tracer share the triangles and the BVH, if they have one.
        """
        make, time = self._accelerator, self.scene.clamped(time)
        kept: tuple[float, dict[Plan, Accelerated]] | None = self.scene.__dict__.get("_accelerated")
        if kept is None or kept[0] != time:
            kept = self.scene.__dict__["_accelerated"] = (time, {})
        plan, plans = make.plan, kept[1]
        if plan not in plans or make.outgrown(plans[plan]):
            built = None if plan.chooses else next((p for o, p in list(plans.items()) if o.tree == plan.tree), None)
            if built is None:
                plans[plan] = make.build(self.scene.triangles(time, self.threads))
            else:
                plans[plan] = make.prepare(built.triangles, built.bvh)
        return plans[plan]

    def keep(self, accelerated: Accelerated) -> None:
        """Keep the tree if its tracer remembers frames and later frames use the same triangles and tree."""
        plan = self._accelerator.plan
        if plan.tracer.keeps and not (self.scene.animated or plan.cull or plan.wants_rays):
            self._last = accelerated

    def bands(self, height: int) -> Iterator[slice]:
        yield slice(0, height)

    def look(self, camera, triangles: Triangles, whole: Accelerated | None, progress=None, rows=None) -> Surfaces:
        cutouts = self._accelerator.cutouts_of(triangles)
        seen = lambda tree: surfaces_of(see(triangles, camera, tree, self.threads, cutouts), triangles)
        if camera.listed or self.gbuffer != AUTO:
            return seen(whole if camera.listed or self.gbuffer == RAYS else None)
        method = self._looking.choose(whole)
        return self._looking.timed(
            method, camera.width * camera.height, lambda: seen(whole if method == RAYS else None)
        )

    def nearest_in(self, whole: Accelerated) -> Nearest:
        return nearest_in(whole, self.threads)

    def trace_rays(self, arguments: Arguments, any_hit: bool, cull_faces: int, time: float) -> HitArrays:
        out = hit_arrays(len(arguments.origins), any_hit)
        ready = self.accelerated(time)
        with counted(self.scene, self.scene.clamped(time)):
            legal = trace_batch(ready.prepared, arguments.ray_list(cull_faces), any_hit, out, self.threads)
        if not legal:  # and what was traced is not whole
            arguments.check()
            raise changed()
        if ready.cutouts is not None:
            add_hits(ready.cutouts, arguments, cull_faces, any_hit, out, self.threads)
        return out

    def surfaces_hit(
        self, arguments: Arguments, time: float, cull_faces: int = 0
    ) -> tuple[np.ndarray, Triangles, np.ndarray]:
        found = self.trace_rays(arguments, False, cull_faces, time)
        return found.t, self.accelerated(time).triangles, found.face

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ListedRays, edge: np.ndarray, whole: Accelerated | None
    ) -> Surfaces:
        if isinstance(view, ListedRays):
            assert whole is not None
            rays, shape = subpixel_rays(view, edge, self.threads)
            return next(self.nearest_in(whole)([rays], shape))
        cutouts = self._accelerator.cutouts_of(triangles)
        return surfaces_of(see_subpixels(triangles, view, edge, self.threads, cutouts), triangles)

    def box(self, triangles: Triangles) -> np.ndarray:
        return np.stack(bounds(triangles.vertices, self.threads))

    def paging(self) -> None:
        return None
