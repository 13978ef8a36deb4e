"""The frame tracer: surfaces, the tree for their shadow rays, and visibility bits, in the order that a picture needs.

`RenderSource` is the protocol that scenes in memory and in stores share: triangles, trees, primary visibility and
closest hits. `FrameMemory` estimates the memory of a question, so that chunks of a store get the rest.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from ..auto.choose import Choice
from ..plan import Plan
from ..query.gbuffer import GBuffer
from ..query.ray_list import HitArrays, RayArguments
from ..query.shadow_query import ShadowQuery, Surfaces
from ..scene.camera import Camera, CameraRays
from ..scene.data import SceneData
from ..scene.lights import Light
from ..scene.listed_rays import ListedRays
from ..scene.triangles import Triangles
from ..techniques.srdh.representative_rays import RepresentativeRays, bounced_queries
from ..trace.rays.ray_hits import Nearest
from .accelerator import Accelerated, Accelerator

# --- The memory of a question: an estimate by what is asked, so that the chunks of a store get all the rest -----------


CELL_BYTES = 4
"""Of the cells of a ray set, for each receiver."""


class FrameMemory(NamedTuple):
    """Bytes of a frame."""

    fixed: int  # what the frame takes in any case
    cells: int  # cells of all shadow rays, if all are asked together
    passes: int  # all diffuse passes, if all are traced together; or the sub-pixels of all edges


def points_memory(points: int, light, samples) -> FrameMemory:
    """The memory of a query of points."""
    words = -(-samples.shape[1] // 64)
    return FrameMemory((96 + 8 * words) * points, CELL_BYTES * ray_set_count(light, samples) * points, 0)


def ray_set_count(light, samples) -> int:
    """How many ray sets a light has."""
    return samples.shape[1] if light.domain == "hemisphere" else 1


# --- The protocol of a render source: it supplies triangles and trees, primary visibility and closest hits ------------


Progress = Callable[[int, int], Any]
"""Hears (rays done, rays), or whatever a tracer counts, about ten times a second."""


class RenderSource(Protocol):
    """A scene as seen by one `Engine`: `InMemory` or `Paged`.

    default_plan : str
        The plan of an `Engine` without an explicit plan.
    in_store : bool
        True if the triangles are read in chunks when rays reach them.
    looks : int
        How often `look` runs `progress` to its end.
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
        """Compile the kernels that only this kind of source calls."""

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame, or a query of points, that takes so much memory.

        Raises
        ------
        InputError
            If memory is too small for the frame.
        """

    def release(self) -> None:
        """Leave the memory of what was read to others."""

    def together(self, size: int) -> int:
        """How many passes, or pictures that they meet, are traced together; `size`: bytes of each."""
        ...

    def at_once(self, size: int) -> int:
        """How many things that take `size` bytes each may be in memory at once."""
        ...

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds; and a tree of all of them, if an earlier frame kept one."""
        ...

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree for a query of points; None: the tree depends on the query."""
        ...

    def keep(self, accelerated: Accelerated) -> None:
        """Offer the tree of a frame's shadow rays for reuse in later frames."""

    def bands(self, height: int) -> Iterator[slice]:
        """Yield the rows of a picture band by band. The caller traces the camera and shadow rays of each in turn."""
        ...

    def look(
        self, camera, triangles: Triangles, tree: Accelerated | None, progress=None, rows: slice | None = None
    ) -> Surfaces:
        """The surfaces that a camera sees.

        whole : a tree of all triangles; never None where `gbuffer` is "rays" or the camera is not perspective
        rows : a band of the picture; None: all
        """
        ...

    def nearest_in(self, tree: Accelerated) -> Nearest:
        """A closest-hit function: it finds the first surfaces that passes of diffuse rays meet."""
        ...

    def subpixels(
        self, triangles: Triangles, view: CameraRays | ListedRays, edge: np.ndarray, tree: Accelerated | None
    ) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels: see `query.pixel_refinement`; `whole`: as in `look`."""
        ...

    def trace_rays(self, rays: RayArguments, any_hit: bool, time: float, threads: int | None = None) -> HitArrays:
        """Trace a list of rays at a time within 0 .. `duration`.

        Raises
        ------
        InputError
            If a ray holds an invalid number.
        """
        ...

    def triangles_hit(self, rays: RayArguments, face: np.ndarray, time: float) -> tuple[Triangles, np.ndarray]:
        """The triangles that rays with these hits meet, and the index of each ray's triangle in them, or -1."""
        ...

    def box(self, triangles: Triangles) -> np.ndarray:
        """(2, 3) float32: bounds of the scene with these triangles, in the recentred frame."""
        ...

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        ...


# ---------------------------------------------------------------------------------------------------------------------
# The rays of one frame: surfaces, the tree for their shadow rays, and the bits, in the order that a picture needs.


class FrameMethods(NamedTuple):
    """The methods of a frame."""

    plan: str
    choices: list[Choice] | None  # of the plan `auto`, one per query
    statistics: list[dict] | None  # of CHC+RT: cost of each query, see `techniques.chcrt.visibility_fronts.Statistics`


class FrameTracer:
    """Finds the surfaces of a frame and traces its shadow rays; `Engine.frame_tracer` makes it.

    Call `begin` first, then for each of the `bands` `surfaces`, `prepare` and `trace`.

    triangles : Triangles
        All triangles of the scene; of a store only the visible ones.
    view : CameraRays or ListedRays
        The camera's rays, in the frame of the triangles.
    """

    triangles: Triangles
    view: CameraRays | ListedRays

    def __init__(self, source: RenderSource, accelerator: Accelerator):
        self._source, self._accelerator = source, accelerator
        self._whole: Accelerated | None = None  # a tree of all triangles; it may serve camera rays only
        self._ready: Accelerated | None = None  # answers the queries that were prepared last
        self._shown: RepresentativeRays | None = None  # sample rays for the builder
        self._open: tuple[Nearest, Accelerated] | None = None  # for bounced rays

    @property
    def plan(self) -> Plan:
        return self._accelerator.plan

    @property
    def scene(self) -> SceneData:
        return self._source.scene

    @property
    def in_store(self) -> bool:
        """Whether triangles are read in chunks, so that each band of a picture has triangles of its own."""
        return self._source.in_store

    def begin(self, memory: FrameMemory, rays: int, later: int, time: float) -> None:
        """Begin a frame at a time in seconds.

        rays : about so many rays follow
        later : about so many follow in other frames, in the same tree

        Raises
        ------
        InputError
            If memory is too small for the frame.
        """
        self._source.begin(memory)
        self._accelerator.begin(rays, later)
        self.triangles, self._whole = self._source.moment(time)

    def build_for_camera(self, camera: Camera) -> bool:
        """Build a tree of all triangles if the camera's rays need one; whether one was built."""
        needed = self._whole is None and (self._source.gbuffer == "rays" or camera.listed)
        if needed:
            self._whole = self._accelerator.prepare_all(self.triangles)
        return needed

    def bands(self, height: int) -> Iterator[slice]:
        """The rows of a picture, band by band. Trace the shadow rays of each before the next."""
        if self._whole is not None:
            self._whole.begin()
        return self._source.bands(height)

    def surfaces(self, camera: Camera, rows: slice, progress: Progress | None = None) -> Surfaces:
        """The surfaces that some rows of the camera see."""
        surfaces = self._source.look(camera, self.triangles, self._whole, progress, rows)
        self.triangles, self.view = surfaces.triangles, camera.view(surfaces.triangles.origin)
        return surfaces

    def subpixels(self, edge: np.ndarray) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, see `query.pixel_refinement`; edge : (H, W) bool."""
        return self._source.subpixels(self.triangles, self.view, edge, self._whole)

    def sample(
        self, gbuffer: GBuffer, queries: Sequence[ShadowQuery], lights: Sequence[Light],
        samples: Sequence[np.ndarray], facing: int,
    ) -> None:  # fmt: skip
        """Take the sample rays of a ray-guided builder from a picture's queries; a no-op for other builders."""
        accelerator, tree = self._accelerator, self._whole
        bounce = bounced_queries(accelerator.showing, self.triangles, gbuffer, lights, samples, facing)
        self._shown = accelerator.show(self.triangles, queries, None if tree is None else tree.bvh, bounce)

    def prepare(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Cull for the first queries of a frame or band, and build their tree unless an earlier frame kept it.

        lap : called with the name of each finished step, "cull" or "build"
        """
        self._prepare(queries, self._whole if self._accelerator.one_tree else None, lap)
        self._source.keep(self._ready)

    def prepare_again(self, queries: Sequence[ShadowQuery], lap: Callable[[str], None]) -> None:
        """Cull for further queries; if nothing is culled, the last tree serves."""
        self._prepare(queries, self._ready, lap)

    def _prepare(self, queries, accelerated: Accelerated | None, lap: Callable[[str], None]) -> None:
        culled = self._accelerator.culled(self.triangles, queries)
        if culled is not None:
            lap("cull")
        if culled is not None or accelerated is None:
            accelerated = self._accelerator.build(self.triangles, culled, self._shown)
        self._ready = accelerated
        lap("build")

    def trace(
        self, queries: Sequence[ShadowQuery], tally: np.ndarray | None, progress: Progress | None
    ) -> list[np.ndarray]:
        """The bits of each query, (h, w, ceil(n / 64)) uint64; all have receivers of the same shape."""
        assert self._ready is not None
        return self._accelerator.answer_all(self._ready, queries, tally, progress)

    def reuse_tree(self) -> None:
        """Trace the next band of the same picture in this band's tree, if the plan allows it."""
        accelerator = self._accelerator
        if self._ready is not None and accelerator.one_tree and not accelerator.plan.cull:
            self._whole = None if accelerator.needs_rebuild(self._ready) else self._ready
        if self._whole is not None:
            self._whole.begin()

    def closest_hits(self, lap: Callable[[str], None]) -> Nearest:
        """A closest-hit function over all triangles. Later queries are traced in a tree of all of them, too."""
        if self._open is None:
            accelerator = self._accelerator
            if accelerator.plan.cull:
                shadow_tree = self._whole if accelerator.one_tree else None
                self._ready = shadow_tree or accelerator.build(self.triangles, None, self._shown)
            tree = self._ready if accelerator.one_tree else self._whole or accelerator.for_camera(self.triangles)
            assert tree is not None and self._ready is not None
            lap("build")
            self._open = self._source.nearest_in(tree), self._ready
        nearest, self._ready = self._open
        return nearest

    def methods(self) -> FrameMethods:
        """The methods that ran."""
        assert self._ready is not None
        chosen, scheduled = self._ready.chosen, self._ready.scheduled
        return FrameMethods(
            str(self._accelerator.executed_plan(self._ready)), None if chosen is None else chosen.choices,
            None if scheduled is None else scheduled.statistics,
        )  # fmt: skip

    def paging(self) -> dict[str, int] | None:
        """Counts of chunks read and evicted since `begin`; None if the scene is in memory."""
        return self._source.paging()

    def box(self) -> np.ndarray:
        """(2, 3) float32: bounds of the scene, in the frame of the triangles."""
        return self._source.box(self.triangles)

    def at_once(self, size: int) -> int:
        """How many things of `size` bytes each may be in memory at once."""
        return self._source.at_once(size)

    def passes_at_once(self, size: int) -> int:
        """How many passes of bounced rays, or pictures that they meet, to trace together; `size`: bytes of each."""
        return self._source.together(size)
