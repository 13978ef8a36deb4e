"""The frame tracer: finds the surfaces of a frame, builds the tree for their shadow rays, and traces visibility bits.

`RenderSource` is the common interface of scenes in memory and in stores: triangles, trees, primary visibility and
closest hits. `FrameMemory` estimates the memory of a query; the chunks of a store get the rest.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ..base.progress import ProgressCallback
from ..query.gbuffer import GBuffer
from ..query.ray_list import RayArguments, TracedRays
from ..query.shadow_query import ShadowQuery, Surfaces
from ..scene.camera import Camera, CameraRays, ExplicitRays
from ..scene.lights import Light
from ..scene.scene_data import SceneData
from ..scene.triangles import AllHits, Triangles
from ..techniques.srdh.representative_rays import RepresentativeRays, bounced_queries
from ..trace.rays.ray_hits import Nearest
from ..trace.transmission import TracedQuery
from .accelerator import Accelerated, Accelerator
from .auto.strategies import StrategyChoice
from .plan import Plan
from .tree_choice import TreeChoice

# --- Memory estimates -------------------------------------------------------------------------------------------------


CELL_BYTES = 4
"""Bytes per receiver of the cells of a ray set."""


class FrameMemory(NamedTuple):
    """Estimated memory of a frame in bytes."""

    fixed: int  # needed in any case
    cells: int  # cells of all shadow rays, if all are traced together
    passes: int  # all diffuse passes, if all are traced together; or the sub-pixels of all edges


def points_memory(points: int, light: Light, samples: np.ndarray) -> FrameMemory:
    """The memory of a point query."""
    words = -(-samples.shape[1] // 64)
    return FrameMemory((96 + 8 * words) * points, CELL_BYTES * ray_set_count(light, samples) * points, 0)


def ray_set_count(light: Light, samples: np.ndarray) -> int:
    """Number of ray sets of a light."""
    return samples.shape[1] if light.domain == "hemisphere" else 1


# --- The protocol of render sources -----------------------------------------------------------------------------------


class RenderSource(Protocol):
    """A scene as seen by one `Engine`: `InMemory` or `Paged`.

    default_plan : str
        The plan of an `Engine` without an explicit plan.
    in_store : bool
        Whether triangles are read in chunks when rays reach them.
    looks : int
        Progress cycles per `look`.
    gbuffer : "raster", "rays" or "auto"
        The method of primary visibility in `look`.
    """

    default_plan: ClassVar[str]
    in_store: ClassVar[bool]
    looks: ClassVar[int]

    @property
    def scene(self) -> SceneData: ...

    @property
    def gbuffer(self) -> str: ...

    def warm_up(self) -> None:
        """Compile the kernels specific to this kind of source."""

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame or point query that needs this much memory.

        Raises
        ------
        InputError
            If the memory limit is too small for the frame.
        """

    def release(self) -> None:
        """Free the memory of resident chunks for other engines."""

    def together(self, size: int) -> int:
        """Number of passes, or of images of their hits, to trace together; `size`: bytes of each."""
        ...

    def at_once(self, size: int) -> int:
        """Number of items of `size` bytes each that fit in memory at once."""
        ...

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree of all of them if an earlier frame cached one."""
        ...

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree for a point query; None: the tree depends on the query."""
        ...

    def keep_for_points(self, accelerated: Accelerated) -> None:
        """Offer the tree of a point query for reuse in later ones."""

    def keep(self, accelerated: Accelerated) -> None:
        """Offer the tree of a frame's shadow rays for reuse in later frames."""

    def bands(self, height: int) -> Iterator[slice]:
        """Yield the rows of an image band by band. The caller traces the camera and shadow rays of each in turn."""
        ...

    def look(
        self,
        camera: Camera,
        triangles: Triangles,
        tree: Accelerated | None,
        progress: ProgressCallback | None = None,
        rows: slice | None = None,
    ) -> Surfaces:
        """The surfaces visible to a camera.

        tree : a tree of all triangles; never None if `gbuffer` is "rays" or the camera is not perspective
        rows : a band of the image; None: all rows
        """
        ...

    def nearest_in(self, tree: Accelerated) -> Nearest:
        """A closest-hit function, which finds the first surfaces hit by passes of diffuse rays."""
        ...

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ExplicitRays, edge: np.ndarray, tree: Accelerated | None
    ) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, see `query.pixel_refinement`; `tree`: as in `look`."""
        ...

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> TracedRays:
        """Trace a list of rays at a time within 0 .. `duration`.

        Raises
        ------
        InputError
            If a ray has an invalid component.
        """
        ...

    def all_hits(
        self, rays: RayArguments, max_hits: int | None, rule: int, time: float, threads: int | None = None
    ) -> AllHits:
        """All hits of rays, or the first `max_hits` of each; `rule`: TRIANGLES or SURFACES of `trace.rays.all_hits`."""
        ...

    def count_hits(self, rays: RayArguments, rule: int, time: float, threads: int | None = None) -> NDArray[np.int64]:
        """(n,) int64: the number of hits of each ray, by a rule of `trace.rays.all_hits`."""
        ...

    def box(self, triangles: Triangles) -> np.ndarray:
        """(2, 3) float32: bounds of the scene with these triangles, in the recentred frame."""
        ...

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        ...


# --- The rays of one frame --------------------------------------------------------------------------------------------


class FrameMethods(NamedTuple):
    """The methods that ran in a frame."""

    plan: str
    tree: TreeChoice | None  # of the plan `auto`
    choices: list[StrategyChoice] | None  # of the plan `auto`, one per query
    statistics: list[dict[str, Any]] | None  # of CHC+RT, one `visibility_fronts.Statistics` per query


class FrameTracer:
    """Finds the surfaces of a frame and traces its shadow rays. Create it by `Engine.frame_tracer`.

    Call `begin` first. Then, for each band of `bands`, call `surfaces`, `prepare` and `trace`.

    triangles : Triangles
        All triangles of the scene; for a store, only the visible ones.
    view : CameraRays or ExplicitRays
        The camera's rays, in the frame of the triangles.
    """

    triangles: Triangles
    view: CameraRays | ExplicitRays

    def __init__(self, source: RenderSource, accelerator: Accelerator):
        self._source, self._accelerator = source, accelerator
        self._full_tree: Accelerated | None = None  # a tree of all triangles, possibly for camera rays only
        self._accelerated: Accelerated | None = None  # the tree of the queries prepared last
        self._sample_rays: RepresentativeRays | None = None  # for a ray-guided builder
        self._bounce_state: tuple[Nearest, Accelerated] | None = None  # closest-hit function and shadow tree of bounces

    @property
    def plan(self) -> Plan:
        return self._accelerator.plan

    @property
    def scene(self) -> SceneData:
        return self._source.scene

    @property
    def in_store(self) -> bool:
        """Whether triangles are read in chunks, so that each band of an image has its own triangles."""
        return self._source.in_store

    def begin(self, memory: FrameMemory, rays: int, later: int, time: float) -> None:
        """Begin a frame at a time in seconds.

        rays : estimated number of rays in the frame
        later : estimated number of rays of later frames in the same tree

        Raises
        ------
        InputError
            If the memory limit is too small for the frame.
        """
        self._source.begin(memory)
        self._accelerator.begin(rays, later)
        self.triangles, self._full_tree = self._source.moment(time)

    def build_for_camera(self, camera: Camera) -> bool:
        """Build a tree of all triangles if the camera's rays need one. Returns whether one was built."""
        needed = self._full_tree is None and (self._source.gbuffer == "rays" or camera.listed)
        if needed:
            self._full_tree = self._accelerator.prepare_all(self.triangles)
        return needed

    def bands(self, height: int) -> Iterator[slice]:
        """The rows of an image, band by band. Trace the shadow rays of each band before requesting the next."""
        if self._full_tree is not None:
            self._full_tree.begin()
        return self._source.bands(height)

    def surfaces(self, camera: Camera, rows: slice, progress: ProgressCallback | None = None) -> Surfaces:
        """The surfaces visible in some rows of the camera."""
        surfaces = self._source.look(camera, self.triangles, self._full_tree, progress, rows)
        self.triangles, self.view = surfaces.triangles, camera.view(surfaces.triangles.origin)
        return surfaces

    def subpixels(self, edge: np.ndarray) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, see `query.pixel_refinement`; edge : (H, W) bool."""
        return self._source.subpixels(self.triangles, self.view, edge, self._full_tree)

    def sample(
        self,
        gbuffer: GBuffer,
        queries: Sequence[ShadowQuery],
        lights: Sequence[Light],
        samples: Sequence[NDArray[np.float64]],
        facing: int,
    ) -> None:
        """Select the sample rays of a ray-guided builder from an image's queries. No-op for other builders."""
        accelerator, tree = self._accelerator, self._full_tree
        bounce = bounced_queries(accelerator.ray_selector, self.triangles, gbuffer, lights, samples, facing)
        self._sample_rays = accelerator.sample_rays(self.triangles, queries, None if tree is None else tree.bvh, bounce)

    def prepare(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Cull for the first queries of a frame or band, and build their tree unless an earlier frame cached it.

        lap : called with the name of each finished step, "cull" or "build"
        """
        self._prepare(queries, self._full_tree if self._accelerator.one_tree else None, lap)
        assert self._accelerated is not None
        self._source.keep(self._accelerated)

    def prepare_again(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Prepare for further queries. The last tree is reused unless culling has dropped some of its triangles."""
        self._prepare(queries, self._accelerated, lap)

    def _prepare(
        self, queries: Sequence[ShadowQuery], accelerated: Accelerated | None, lap: Callable[[str], None]
    ) -> None:
        if accelerated is None or accelerated.partial or self.plan.cull:
            accelerated = self._accelerator.tree_for(self.triangles, queries, self._sample_rays, lap)
        self._accelerated = accelerated
        lap("build")

    def trace(
        self, queries: Sequence[ShadowQuery], tally: np.ndarray | None, progress: ProgressCallback | None
    ) -> list[NDArray[np.uint64]]:
        """The bits of each query, (h, w, ceil(n / 64)) uint64. The receivers of all have the same shape."""
        assert self._accelerated is not None
        return self._accelerator.answer_all(self._accelerated, queries, tally, progress)

    def traced_query(self, query: ShadowQuery, bits: NDArray[np.uint64]) -> TracedQuery:
        """A query with its bits, and with the light that comes through cut-outs."""
        return TracedQuery(query, bits, self._accelerator.transmission(self.triangles, query, bits))

    def reuse_tree(self) -> None:
        """Trace the next band of the image in this band's tree, if the plan allows it."""
        accelerator = self._accelerator
        if self._accelerated is not None and accelerator.one_tree and not self._accelerated.partial:
            self._full_tree = None if accelerator.needs_rebuild(self._accelerated) else self._accelerated
        if self._full_tree is not None:
            self._full_tree.begin()

    def closest_hits(self, lap: Callable[[str], None]) -> Nearest:
        """A closest-hit function over all triangles. Later shadow queries use a tree of all triangles, too."""
        if self._bounce_state is None:
            accelerator = self._accelerator
            if self._accelerated is None or self._accelerated.partial:
                shadow_tree = self._full_tree if accelerator.one_tree else None
                self._accelerated = shadow_tree or accelerator.build(self.triangles, self._sample_rays)
            tree = (
                self._accelerated if accelerator.one_tree else self._full_tree or accelerator.for_camera(self.triangles)
            )
            assert tree is not None and self._accelerated is not None
            lap("build")
            self._bounce_state = self._source.nearest_in(tree), self._accelerated
        nearest, self._accelerated = self._bounce_state
        return nearest

    def methods(self) -> FrameMethods:
        """The methods that ran."""
        assert self._accelerated is not None
        chosen, scheduled = self._accelerated.chosen, self._accelerated.scheduled
        executed = self._accelerator.executed(self._accelerated)
        statistics = None if scheduled is None else scheduled.statistics
        if chosen is None:
            return FrameMethods(str(executed), None, None, statistics)
        return FrameMethods(str(executed), executed, chosen.choices, statistics)

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        return self._source.paging()

    def box(self) -> np.ndarray:
        """(2, 3) float32: bounds of the scene, in the frame of the triangles."""
        return self._source.box(self.triangles)

    def at_once(self, size: int) -> int:
        """Number of items of `size` bytes each that fit in memory at once."""
        return self._source.at_once(size)

    def passes_at_once(self, size: int) -> int:
        """Number of passes of bounced rays, or of images of their hits, to trace together; `size`: bytes of each."""
        return self._source.together(size)
