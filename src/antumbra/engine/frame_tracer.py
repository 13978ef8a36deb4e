"""The frame tracer: finds surfaces of a frame, builds the tree for their shadow rays, and traces visibility bits."""

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.progress import ProgressCallback
from ..devices.device import OutOfDeviceMemory
from ..query.gbuffer import GBuffer
from ..query.shadow_query import ShadowQuery, Surfaces
from ..scene.camera import Camera, CameraRays, ExplicitRays
from ..scene.lights import Light
from ..scene.triangles import Triangles
from ..techniques.srdh.representative_rays import RepresentativeRays, bounced_queries
from ..trace.rays.ray_hits import Nearest
from ..trace.transmission import TracedQuery
from .accelerator import Accelerated, Accelerator
from .auto.strategies import StrategyChoice
from .primary_visibility import RAYS, nearest_in
from .sources.source_protocols import CameraView, FrameMemory, RenderSource, box_of, moment_of
from .tree_choice import TreeChoice


class FrameMethods(NamedTuple):
    """The methods that ran in a frame."""

    plan: str
    tree: TreeChoice | None  # of the plan `auto`
    choices: list[StrategyChoice] | None  # of the plan `auto`, one per query
    statistics: list[dict[str, Any]] | None  # of CHC+RT, one `visibility_fronts.Statistics` per query


class FrameTracer:
    """Finds the surfaces of a frame and traces its shadow rays. Create it by `Engine.frame_tracer`.

    Call `begin` first. Then, for each band of `bands`, call `surfaces` and `prepare`, and trace queries in `tree`.

    scene : SceneData
    accelerator : Accelerator
        Answers queries in `tree`.
    plan : Plan
    memory : Memory or None
        If there is one, each band of an image has triangles of its own. None: there is one band.
    triangles : Triangles
        All triangles of the scene; for a store, only the visible ones.
    view : CameraRays or ExplicitRays
        The camera's rays, in the frame of the triangles.
    """

    triangles: Triangles
    view: CameraRays | ExplicitRays

    def __init__(self, source: RenderSource, accelerator: Accelerator):
        self.scene, self.plan, self.memory = source.scene, accelerator.plan, source.memory
        self._source, self.accelerator = source, accelerator
        self._seen: CameraView | None = None  # by the latest `surfaces`
        self._full_tree: Accelerated | None = None  # a tree of all triangles, possibly for camera rays only
        self._accelerated: Accelerated | None = None  # the tree of the queries prepared last
        self._sample_rays: RepresentativeRays | None = None  # for a ray-guided builder
        self._bounce_state: tuple[Nearest, Accelerated] | None = None  # closest-hit function and shadow tree of bounces

    def begin(self, memory: FrameMemory, rays: int, later: int, time: float, frames: int = 1) -> None:
        """Begin a frame at a time in seconds.

        rays : estimated number of rays in the frame
        later : estimated number of further rays of the frame in the same tree
        frames : estimated number of frames from this one on; those of an animated scene share no tree

        Raises
        ------
        InputError
            If the memory limit is too small for the frame.
        """
        if self.memory is not None:
            self.memory.begin(memory)
        self.accelerator.begin(rays, later, 1 if self.scene.animated else frames)
        self.triangles, self._full_tree = moment_of(self._source, time)

    def build_for_camera(self, camera: Camera) -> bool:
        """Build a tree of all triangles if the camera's rays need one. Returns whether one was built."""
        needed = self._full_tree is None and (self._source.gbuffer == RAYS or camera.listed)
        if needed:
            self._full_tree = self.accelerator.prepare_all(self.triangles)
        return needed

    def bands(self, height: int) -> Iterator[slice]:
        """The rows of an image, band by band. Trace the shadow rays of each band before requesting the next."""
        if self._full_tree is not None:
            self._full_tree.begin()
        return iter([slice(0, height)]) if self.memory is None else self.memory.bands(height)

    def surfaces(self, camera: Camera, rows: slice, progress: ProgressCallback | None = None) -> Surfaces:
        """The surfaces visible in some rows of the camera."""
        self._seen = CameraView(camera, self.triangles, self._full_tree, rows, progress)
        surfaces = self._source.look(self._seen)
        self.triangles, self.view = surfaces.triangles, camera.view(surfaces.triangles.origin)
        return surfaces

    def subpixels(self, edge: np.ndarray) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, see `query.pixel_refinement`; edge : (H, W) bool."""
        assert self._seen is not None
        return self._source.subpixels(self._seen._replace(triangles=self.triangles, tree=self._full_tree), edge)

    def sample(
        self,
        gbuffer: GBuffer,
        queries: Sequence[ShadowQuery],
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int,
    ) -> None:
        """Select the sample rays of a ray-guided builder from an image's queries. No-op for other builders."""
        accelerator, tree = self.accelerator, self._full_tree
        bounce = bounced_queries(accelerator.ray_selector, self.triangles, gbuffer, lights, samples, facing)
        self._sample_rays = accelerator.sample_rays(self.triangles, queries, None if tree is None else tree.bvh, bounce)

    def prepare(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Cull for the first queries of a frame or band, and build their tree unless an earlier frame cached it.

        lap : called with the name of each finished step, "cull" or "build"
        """
        self._prepare(queries, False, lap)
        if self._source.geometry is not None and self._accelerated is not None:
            whole = self._full_tree if self._accelerated.partial and self.accelerator.sees else None
            self._source.geometry.keep(whole or self._accelerated)

    def prepare_again(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Prepare for further queries. The last tree is reused unless culling has dropped some of its triangles."""
        self._prepare(queries, True, lap)

    @property
    def _shared_tree(self) -> Accelerated | None:
        """The tree of all triangles, if shadow rays may use it."""
        return self._full_tree if self.accelerator.one_tree else None

    def _prepare(self, queries: Sequence[ShadowQuery], again: bool, lap: Callable[[str], None]) -> None:
        """Prepare for queries; again: the tree of the last ones serves, too, if it has all triangles."""
        ready = (self._accelerated if again else None) or self._shared_tree
        if ready is None or ready.partial or self.plan.cull:
            ready = self._accelerated = None  # a device may have no room for both
            try:
                ready = self._tree_for(queries, lap)
            except OutOfDeviceMemory:
                if not self._drop_full_tree():
                    raise
        self._accelerated = ready or self._tree_for(queries, lap)
        lap("build")

    def _tree_for(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> Accelerated:
        return self.accelerator.tree_for(self.triangles, queries, self._sample_rays, lap)

    def _drop_full_tree(self) -> bool:
        """Drop the tree in which a device has found the surfaces. Returns whether there was one."""
        geometry, seen = self._source.geometry, self._seen
        if self._full_tree is None or not self.accelerator.sees or geometry is None:
            return False
        self._full_tree, self._seen = None, None if seen is None else seen._replace(tree=None)
        self.accelerator.memory.own = None
        geometry.keep(None)
        return True

    @property
    def tree(self) -> Accelerated:
        """The tree of the queries prepared last, in which `accelerator` answers them."""
        assert self._accelerated is not None
        return self._accelerated

    def traced_query(self, query: ShadowQuery, bits: NDArray[np.uint64]) -> TracedQuery:
        """A query with its bits, and with the light that comes through cut-outs."""
        tree = self._accelerated or self._full_tree
        if tree is None:  # the bits were known, and nothing was prepared
            tree = Accelerated(self.triangles, None, None, self.accelerator.cutouts_of(self.triangles))
        return self.accelerator.traced_query(tree, query, bits)

    def reuse_tree(self) -> None:
        """Trace the next band of the image in this band's tree, if the plan allows it."""
        accelerator = self.accelerator
        if self._accelerated is not None and accelerator.one_tree and not self._accelerated.partial:
            self._full_tree = None if accelerator.needs_rebuild(self._accelerated) else self._accelerated
        if self._full_tree is not None:
            self._full_tree.begin()

    def closest_hits(self, lap: Callable[[str], None]) -> Nearest:
        """A closest-hit function over all triangles. Later shadow queries use a tree of all triangles, too."""
        if self._bounce_state is None:
            accelerator = self.accelerator
            if self._accelerated is None or self._accelerated.partial:
                self._accelerated = self._shared_tree or accelerator.build(self.triangles, self._sample_rays)
            tree = (
                self._accelerated if accelerator.one_tree else self._full_tree or accelerator.for_camera(self.triangles)
            )
            assert tree is not None and self._accelerated is not None
            lap("build")
            fixed = self._source.fixed
            nearest = nearest_in(tree, self.accelerator.threads) if fixed is None else fixed.nearest
            self._bounce_state = nearest, self._accelerated
        nearest, self._accelerated = self._bounce_state
        return nearest

    def methods(self) -> FrameMethods:
        """The methods that ran."""
        chosen, scheduled = self.tree.chosen, self.tree.scheduled
        executed = self.accelerator.executed(self.tree)
        statistics = None if scheduled is None else scheduled.statistics
        if chosen is None:
            return FrameMethods(str(executed), None, None, statistics)
        return FrameMethods(str(executed), executed, chosen.choices, statistics)

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        return None if self.memory is None else self.memory.paging()

    def box(self) -> np.ndarray:
        """(2, 3) float32: bounds of the scene, in the frame of the triangles."""
        return box_of(self._source, self.triangles)

    def at_once(self, size: int) -> int:
        """Number of items of `size` bytes each that fit in memory at once."""
        return sys.maxsize if self.memory is None else self.memory.at_once(size)

    def passes_at_once(self, size: int) -> int:
        """Number of passes of bounced rays, or of images of their hits, to trace together; `size`: bytes of each."""
        return 1 if self.memory is None else self.memory.together(size)
