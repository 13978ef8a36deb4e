"""Scenes in memory: all triangles are resident, and any plan can trace them."""

import sys
from collections.abc import Iterator
from typing import ClassVar

import numpy as np

from ..plan import DEFAULT_PLAN
from ..query.pixel_refinement import subpixel_rays
from ..query.query_bounds import bounds
from ..query.ray_list import HitArrays, RayArguments
from ..query.shadow_query import Surfaces, surfaces_of
from ..scene.camera import CameraRays
from ..scene.listed_rays import ListedRays
from ..scene.memory import MemoryData
from ..scene.triangles import Triangles
from ..trace.rays.ray_hits import Nearest
from .accelerate import Accelerated, Accelerator
from .looking import AUTO, RAYS, Looking
from .memory import FrameMemory
from .ray_lists import RayLists
from .ready import make_ready
from .see import cutouts_job, nearest_in, see, see_subpixels
from .trees import Trees


class InMemory:
    """A scene whose triangles are in memory; `RenderSource` documents the methods.

    Parameters
    ----------
    data : MemoryData
    accelerator : Accelerator
        Holds the plan and builds its trees.
    trees : Trees
        Shared with other engines of the scene.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility; "auto": the faster one, see `looking`.
    """

    default_plan: ClassVar = DEFAULT_PLAN
    in_store: ClassVar = False
    looks: ClassVar = 0

    def __init__(self, data: MemoryData, accelerator: Accelerator, trees: Trees, gbuffer: str = AUTO):
        self.scene, self.gbuffer, self._looking, self._trees = data, gbuffer, Looking(), trees
        self._accelerator, self.threads = accelerator, accelerator.threads
        self._box: tuple[Triangles, np.ndarray] | None = None  # of the triangles that were asked for last
        self.ray_lists = RayLists(data, trees, self.threads)
        self._last: Accelerated | None = None  # of earlier frames, if later frames can reuse it

    def warm_up(self) -> None:
        if self.scene.cutouts is not None:
            make_ready(cutouts_job)

    def begin(self, memory: FrameMemory) -> None:
        pass

    def release(self) -> None:
        pass

    def together(self, size: int) -> int:
        return 1

    def at_once(self, size: int) -> int:
        return sys.maxsize

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        if self._last is None or self._accelerator.outgrown(self._last):
            self._last = None
            return self._trees.triangles(time, self.threads), None
        return self._last.triangles, self._last

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        plan = self._accelerator.plan
        if plan.cull or plan.wants_rays:
            return self._trees.triangles(time, self.threads), None
        ready = self._trees.of(self._accelerator, time)
        return ready.triangles, ready

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

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> HitArrays:
        return self.ray_lists.trace_rays(rays, any_hit, time, threads)

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        return self.ray_lists.triangles_hit(rays, face, time)

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
        if self._box is None or self._box[0] is not triangles:
            self._box = triangles, np.stack(bounds(triangles.vertices, self.threads))
        return self._box[1]

    def paging(self) -> None:
        return None
