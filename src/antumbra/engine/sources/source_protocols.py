"""What an engine needs of a scene, one protocol per concern; sources implement those that they can.

- `HitSource`: any and nearest hits of ray lists. `RayListSource`: all hits, too.
- `PointSource`: shadow rays of points.
- `CameraSource`: the surfaces that a camera sees.
- `Geometry`: all triangles at a time, and trees of them that plans build. Or `FixedTree`: a tree of the source's own,
  which no plan builds and time does not change.
- `Memory`: a limit on memory, within which frames are traced in bands and rays in batches.

The attributes of a `RenderSource` state which of them it offers; no code checks its type. An engine traces ray lists
and points by the first of a chain of sources. Each delegates what it cannot answer to the next: terrain, for example,
comes before triangles in memory, and so can a device with its own memory.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...query.equal_samples import traced_samples
from ...query.ray_list import RayArguments, TracedRays
from ...query.ray_passes import RayPass
from ...query.receivers import Receivers
from ...query.shadow_query import Surfaces
from ...scene.camera import Camera
from ...scene.lights import Light
from ...scene.scene_data import SceneData
from ...scene.triangles import AllHits, ClosestPoints, Triangles
from ...trace.rays.cell_verdicts import CellVerdicts
from ...trace.rays.inside_votes import Caps
from ...trace.transmission import TracedQuery
from ..accelerator import Accelerated, Accelerator, SceneTrees
from ..plan import Plan

# --- Ray lists --------------------------------------------------------------------------------------------------------


class HitSource(Protocol):
    """Traces any and nearest hits of ray lists."""

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays.

        Raises
        ------
        InputError
            If a ray is invalid: NaN, infinity, a zero direction, ...
        """
        ...


class Bodies(NamedTuple):
    """The surfaces of a scene at a time, for points inside them."""

    box: NDArray[np.float32]  # (2, 3): bounds in the recentred frame
    open_edges: int | None  # that an odd number of faces share; None: not counted
    crossings: Callable[[RayArguments, int], NDArray[np.int64]]  # counts of rays by the rule INSIDE, on some threads
    time: float  # seconds: that of the rays
    along: NDArray[np.float64] | None = None  # (3,) the axis along which rays are fastest; None: upwards
    caps: Caps | None = None  # that close the surfaces; None: rays through the surfaces vote
    cells: CellVerdicts | None = None  # that decide about most points; None: rays do


class TreeHits(HitSource, Protocol):
    """Traces ray lists through a tree, after a source that needs none."""

    @property
    def plan(self) -> Plan | None:
        """The plan of the tree that was built for ray lists; None: there is none."""
        ...


class RayListSource(HitSource, Protocol):
    """Traces ray lists."""

    def all_hits(self, rays: RayArguments, max_hits: int | None, rule: int, threads: int) -> AllHits:
        """All hits of rays, or the first `max_hits` of each; `rule`: TRIANGLES or SURFACES of `trace.rays.all_hits`."""
        ...

    def count_hits(self, rays: RayArguments, rule: int, threads: int) -> NDArray[np.int64]:
        """(n,) int64: the number of hits of each ray, by a rule of `trace.rays.all_hits`. INSIDE sees no holes."""
        ...

    def bodies(self, time: float) -> Bodies:
        """The surfaces at a time within 0 .. `duration`; those drawn twice count once."""
        ...

    def closest_points(self, points: NDArray[np.float32], time: float, threads: int) -> ClosestPoints:
        """The closest points to points, (n, 3) in the scene's frame, at a time within 0 .. `duration`."""
        ...


# --- Shadow rays of points --------------------------------------------------------------------------------------------


class PointQuery(NamedTuple):
    """Points and lights; `Engine.shadows` documents the fields."""

    receivers: Receivers
    lights: Sequence[Light]
    samples: Sequence[NDArray[np.float64]]
    facing: int = 0
    time: float = 0.0  # within 0 .. `duration`
    later: int = 0
    whole: bool = False
    month: int | None = None
    known: Sequence[NDArray[np.uint64]] | None = None

    @property
    def rays(self) -> int:
        """The number of rays."""
        return self.receivers.n * sum(map(traced_samples, self.lights, self.samples))


class PointSource(Protocol):
    """Traces the shadow rays of points. Callers take turns."""

    @property
    def prefers_rows(self) -> bool:
        """Whether points in rows of a raster are traced faster than in any other order."""
        ...

    def shadows(self, points: PointQuery, progress: ProgressCallback | None) -> list[TracedQuery]:
        """The shadow query of each light, with its answer. InputError if memory is too small."""
        ...


# --- The surfaces that a camera sees ----------------------------------------------------------------------------------


class CameraView(NamedTuple):
    """What a camera is to see."""

    camera: Camera
    triangles: Triangles  # of `Geometry.moment`, or of `FixedTree.accelerated`
    tree: Accelerated | None  # of all triangles; None: `gbuffer` is not "rays", or a device has no room
    rows: slice  # a band of the image; a source with `Geometry` always sees all rows
    progress: ProgressCallback | None = None  # of sources whose `looks` is 1


class CameraSource(Protocol):
    """Finds the surfaces that a camera sees.

    gbuffer : "raster", "rays" or "auto"
        The method of `look`.
    looks : int
        Progress cycles per `look`.
    """

    looks: ClassVar[int]

    @property
    def gbuffer(self) -> str: ...

    def look(self, view: CameraView) -> Surfaces:
        """The surfaces visible to a camera."""
        ...

    def subpixels(self, view: CameraView, edge: NDArray[np.bool_]) -> Surfaces:
        """The surfaces of the sub-pixels of selected pixels, see `query.pixel_refinement`; edge : (H, W) bool."""
        ...

    def see_on_cpu(self) -> bool:
        """Let the CPU find what cameras see from now on, since a device has too little memory. False: it does so."""
        ...


# --- Triangles and trees ----------------------------------------------------------------------------------------------


class Geometry(Protocol):
    """All triangles at a time, in memory, and trees that a plan builds of them."""

    def moment(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree of all of them if an earlier frame cached one."""
        ...

    def for_points(self, time: float) -> tuple[Triangles, Accelerated | None]:
        """The triangles at a time in seconds, and a tree for a point query; None: the tree depends on the query."""
        ...

    def triangles_for_few(self, time: float) -> Triangles | None:
        """The triangles at a time in seconds, if few points are best traced as rays; None: by shadow queries."""
        ...

    def keep(self, accelerated: Accelerated | None) -> None:
        """Offer the tree of a frame's shadow rays for reuse in later frames. None: drop the tree of earlier frames."""

    def keep_for_points(self, accelerated: Accelerated) -> None:
        """Offer the tree of a point query for reuse in later ones."""

    def box(self, triangles: Triangles) -> NDArray[np.float32]:
        """(2, 3) float32: bounds of the scene with these triangles, in the recentred frame."""
        ...


class FixedTree(Protocol):
    """A tree of the source's own. Its triangles are made where rays meet them."""

    @property
    def accelerated(self) -> Accelerated:
        """The input of the plan's tracer; its triangles are a placeholder."""
        ...

    @property
    def bounds(self) -> NDArray[np.float32]:
        """(2, 3) float32: bounds of the scene, in the recentred frame."""
        ...

    def nearest(self, passes: Sequence[RayPass], shape: tuple[int, int]) -> Iterator[Surfaces]:
        """The first surfaces hit by each of several passes of rays; `shape`: (H, W) of the image."""
        ...


# --- Memory -----------------------------------------------------------------------------------------------------------


CELL_BYTES = 4
"""Bytes per receiver of the cells of a ray set."""


class FrameMemory(NamedTuple):
    """Estimated memory of a frame in bytes."""

    fixed: int  # needed in any case
    cells: int  # cells of all shadow rays, if all are traced together
    passes: int  # all diffuse passes, if all are traced together; or the sub-pixels of all edges


def points_memory(points: PointQuery) -> FrameMemory:
    """The memory of a point query."""
    n, fixed, cells = points.receivers.n, 0, 0
    for light, samples in zip(points.lights, points.samples):
        fixed += (96 + 8 * -(-samples.shape[1] // 64)) * n
        cells += CELL_BYTES * ray_set_count(light, samples) * n
    return FrameMemory(fixed, cells, 0)


def ray_set_count(light: Light, samples: NDArray[np.float64]) -> int:
    """Number of ray sets of a light."""
    return samples.shape[1] if light.domain == "hemisphere" else 1


class Memory(Protocol):
    """The memory of a source that has a limit: a part of the triangles is read when rays reach them."""

    def begin(self, memory: FrameMemory) -> None:
        """Begin a frame or point query that needs this much memory.

        Raises
        ------
        InputError
            If the memory limit is too small for the frame.
        """

    def release(self) -> None:
        """Free the memory of resident chunks for other engines."""

    def left(self) -> int:
        """Bytes that arrays besides the resident parts may take. No part stays resident."""
        ...

    def has_room(self, size: int) -> bool:
        """Whether `make_room` for `size` bytes leaves half of the resident parts."""
        ...

    def make_room(self, size: int, what: str, stays: bool = False) -> None:
        """Free `size` bytes for arrays of the frame besides those that `begin` counted.

        stays : whether they stay until the next frame; otherwise, they replace those of the last such call

        Raises
        ------
        InputError
            If the memory limit is too small for them; `what` names them, and the cure.
        """
        ...

    def together(self, size: int) -> int:
        """Number of passes, or of images of their hits, to trace together; `size`: bytes of each."""
        ...

    def at_once(self, size: int) -> int:
        """Number of items of `size` bytes each that fit in memory at once."""
        ...

    def bands(self, height: int) -> Iterator[slice]:
        """Yield the rows of an image band by band. The caller traces the camera and shadow rays of each in turn."""
        ...

    def paging(self) -> dict[str, int]:
        """Counts of chunks read and evicted since `begin`."""
        ...


# --- Sources ----------------------------------------------------------------------------------------------------------


class RenderSource(CameraSource, Protocol):
    """A scene as one `Engine` traces it.

    geometry, fixed : exactly one of them is None
    memory : None if everything is in memory at all times
    """

    @property
    def scene(self) -> SceneData: ...

    @property
    def ray_lists(self) -> RayListSource: ...

    @property
    def geometry(self) -> Geometry | None: ...

    @property
    def fixed(self) -> FixedTree | None: ...

    @property
    def memory(self) -> Memory | None: ...

    def warm_up(self) -> None:
        """Compile the kernels specific to this kind of source."""


def moment_of(source: RenderSource, time: float) -> tuple[Triangles, Accelerated | None]:
    """The triangles of a source at a time, and a tree of all of them if there is one."""
    if source.geometry is not None:
        return source.geometry.moment(time)
    assert source.fixed is not None
    return source.fixed.accelerated.triangles, source.fixed.accelerated


def box_of(source: RenderSource, triangles: Triangles) -> NDArray[np.float32]:
    """(2, 3) float32: bounds of the scene with these triangles, in the recentred frame."""
    if source.geometry is not None:
        return source.geometry.box(triangles)
    assert source.fixed is not None
    return source.fixed.bounds


class SourceSettings(NamedTuple):
    """The settings of an engine's source, besides the plan."""

    gbuffer: str  # the method of `CameraSource.look`, where there is a choice
    max_memory: int | None  # limit in bytes, for a source with a `Memory`; None: its default
    turn: AbstractContextManager[Any]  # held by queries of such a source
    evict_others: Callable[[], object]  # frees what other engines of the scene keep in memory


class SharedTrees(Protocol):
    """What the engines of a scene share, by the kind of its data."""

    default_plan: ClassVar[str]

    def __init__(self, data: SceneData): ...

    def source(self, accelerator: Accelerator, settings: "SourceSettings") -> RenderSource:
        """The source of an engine. InputError if it does not support the plan or a setting."""
        ...

    def flat(self) -> SceneTrees:
        """The trees of all triangles in memory. InputError if they are in a store, or do not fit."""
        ...

    def clear(self) -> None:
        """Drop all trees. Other threads must not use them meanwhile."""
