"""CHC+RT as a tracer: its state between frames, shadow queries, ray passes, and the surfaces that rays hit."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from threading import Lock
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback, split_progress
from ...bvh.block_tree import block_tree
from ...bvh.nodes import Bvh
from ...devices.device import OutOfDeviceMemory
from ...kernels.parallel import thread_count
from ...query.query_bounds import bounds
from ...query.ray_passes import RayPass
from ...query.shadow_query import ShadowQuery, Surfaces, surfaces_of
from ...scene.camera import CameraRays
from ...scene.triangles import Triangles
from ...trace.rays.ray_hits import Show, hit_surfaces
from ...trace.tracer import TracerState
from ...trace.tree_list import Hits, no_hits
from ..tracer_options import ChcRtOptions
from .picture_ray_sets import CameraRaySet, CombinedRaySets, PassRaySet, RaySets, SegmentRaySets, segments_of
from .ray_bundles import NO_TARGETS, PassRays, pass_rays
from .tree_parts import TreeParts, matching_rows, parts_of
from .visibility_fronts import Fronts, trace_frame

if TYPE_CHECKING:
    from .device_parts import OnDeviceParts

# --- State between frames, shadow queries and ray passes --------------------------------------------------------------


_Band: TypeAlias = tuple[int, int] | None
"""The first row and the end of a band of an image; None: calls that belong to no band."""

_Call: TypeAlias = tuple[_Band, int, tuple[int, ...], int, bool]
"""A call: its band, its number there, the image's shape, the number of ray sets, and whether they are traced here."""

_Sets = TypeVar("_Sets")

_UNUSED_FRAMES = 8  # fronts that no call has used for this many frames are evicted


class ChcRtState(TracerState):
    """A scene prepared for CHC+RT, with the fronts of the last frames.

    Each tracing call of a frame has its own fronts. Call n of a band starts from the fronts of call n of this band in
    the last frame if both have the same image shape and number of ray sets. Temporal coherence is therefore only used
    if each frame makes its calls in the same order; results never depend on it. Fronts that no call has used for some
    frames are evicted.

    parts : TreeParts
    options : ChcRtOptions
    room : int
        Memory budget in bytes for the cells of ray sets traced in one call; 0: one ray set per call.
    statistics : list of dict
        One entry per call of this frame: see `visibility_fronts.Statistics`.
    on_device : OnDeviceParts or None
        Where shadow segments and nearest-hit rays are traced, through parts in the memory of a device; None: here.
    sees_on_device : bool
        Whether nearest-hit rays are traced there, too. False: see `see_here`.
    """

    def __init__(self, parts: TreeParts, options: ChcRtOptions):
        self.parts, self.options, self.room = parts, options, 0
        self.on_device: OnDeviceParts | None = None
        self._see_here = False
        self._fronts: dict[_Call, tuple[int, Fronts]] = {}  # with the last frame of each
        self._frame, self._lock = 0, Lock()
        self.begin()

    def begin(self) -> None:
        """Start a new frame."""
        self._frame += 1
        self._fronts = {key: entry for key, entry in self._fronts.items() if entry[0] >= self._frame - _UNUSED_FRAMES}
        self.statistics = list[dict[str, float]]()
        self.begin_band(None)

    def begin_band(self, rows: slice | None) -> None:
        """Start a band of rows of the frame's image; None: calls that belong to no band."""
        self._band: _Band = None if rows is None else (rows.start, rows.stop)
        self._calls = 0

    @property
    def sees_on_device(self) -> bool:
        return self.on_device is not None and not self._see_here

    def see_here(self) -> None:
        """Trace nearest-hit rays here from now on, since the device has too little memory for them."""
        self._see_here = True
        if self.on_device is not None:
            self.on_device.free_blocks()

    def run(
        self, rays: RaySets | CombinedRaySets, shape: tuple[int, ...], progress: ProgressCallback | None = None
    ) -> None:
        """Trace ray sets in one call, starting from the fronts of the same call of the last frame."""
        with self._lock:
            parts = rays.parts
            key = self._band, self._calls, shape, rays.sets, parts is self.parts
            self._calls += 1
            _, fronts = self._fronts.pop(key, (0, None))  # so that fronts are in the order of the frame's calls
            if parts.memory is not None:
                parts.memory.begin_question()
            fronts = fronts or Fronts(rays.tiles, parts, rays.sets, self.options)
            self._fronts[key] = self._frame, fronts
            self.statistics.append(trace_frame(fronts, rays, progress).as_dict(fronts))

    def continue_from(self, previous: "ChcRtState") -> None:
        """Begin a frame with the fronts of the previous tree, if this tree has the same nodes, as after a refit."""
        rows = matching_rows(previous.parts, self.parts)
        if rows is not None:
            for _, fronts in previous._fronts.values():
                fronts.move_to(self.parts, rows)
            self._frame, self._fronts = previous._frame, previous._fronts
            self.begin()

    def states(self) -> Iterator[tuple[int, Fronts]]:
        """Yield (call number, fronts) for the calls of this frame, in order."""
        with self._lock:
            called = [fronts for frame, fronts in self._fronts.values() if frame == self._frame]
        yield from enumerate(called)


class ChcRtRanges(TracerState):
    """A scene with too many faces for int32: its ranges of faces, which are traced one after the other.

    states : list of ChcRtState
        The state of each range.
    numbers : list of functions
        Each takes faces of the scene, and returns their int32 numbers in its range; -1: in no or another range.
    """

    def __init__(self, states: Sequence[ChcRtState], numbers: Sequence[Callable[[np.ndarray], np.ndarray]]):
        self.ranges, self.numbers = states, numbers

    def begin(self) -> None:
        """Start a new frame."""
        for state in self.ranges:
            state.begin()

    @property
    def room(self) -> int:
        """As of `ChcRtState`."""
        return self.ranges[0].room

    @room.setter
    def room(self, size: int) -> None:
        for state in self.ranges:
            state.room = size

    @property
    def statistics(self) -> list[dict[str, float]]:
        """As of `ChcRtState`, range by range."""
        return [each for state in self.ranges for each in state.statistics]

    def trace_shadows(
        self,
        queries: Sequence[ShadowQuery],
        bits: Sequence[NDArray[np.uint64]],
        threads: int | None,
        counters: NDArray[np.int64] | None,
        progress: ProgressCallback | None,
    ) -> None:
        """As `trace_shadows`: what blocks a segment in any range blocks it."""
        step = split_progress(progress, len(self.ranges))
        for state, numbers in zip(self.ranges, self.numbers):
            found = [np.zeros_like(words) for words in bits]
            trace_shadows(state, [q._replace(ids=numbers(q.ids)) for q in queries], found, threads, counters, step)
            for words, more in zip(bits, found):
                words |= more


def prepare(bvh: Bvh, options: ChcRtOptions, threads: int | None = None) -> ChcRtState:
    """Prepare a builder's tree for CHC+RT."""
    return ChcRtState(parts_of(block_tree(bvh, threads), options), options)


def trace_shadow(
    scheduled: ChcRtState,
    query: ShadowQuery,
    bits: NDArray[np.uint64],
    threads: int | None = None,
    counters: NDArray[np.int64] | None = None,
    progress: ProgressCallback | None = None,
) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_shadows(scheduled, [query], [bits], threads, counters, progress)


def trace_shadows(
    scheduled: ChcRtState | ChcRtRanges,
    queries: Sequence[ShadowQuery],
    bits: Sequence[NDArray[np.uint64]],
    threads: int | None = None,
    counters: NDArray[np.int64] | None = None,
    progress: ProgressCallback | None = None,
) -> None:
    """Answer several queries with the same receiver shape, as `trace_shadow` does.

    As many queries as `ChcRtState.room` allows are traced in one call, which reads each part only once.
    """
    if isinstance(scheduled, ChcRtRanges):
        scheduled.trace_shadows(queries, bits, threads, counters, progress)
        return
    parts, options, used, members = scheduled.parts, scheduled.options, 0, list[SegmentRaySets]()
    make = partial(SegmentRaySets, parts) if scheduled.on_device is None else scheduled.on_device.segments
    inside = None if parts.memory else progress  # out of core, reading parts dominates: report that instead
    n_threads = thread_count(threads)
    asked = [(q, b) for q, b in zip(queries, bits, strict=True) if q.sides.size]  # a block may have no receivers
    steps = [(step, b) for q, b in asked for step in segments_of(parts, q)]
    for i, step in enumerate(steps):
        members.append(make(options, *step, n_threads, counters, inside))
        used += members[-1].rays.cells.nbytes
        if used >= scheduled.room or i == len(steps) - 1:
            scheduled.run(combine_ray_sets(members), queries[0].sides.shape, progress)
            used, members = 0, []


def combine_ray_sets(members: Sequence[RaySets]) -> RaySets | CombinedRaySets:
    """Combine ray sets for one call."""
    return members[0] if len(members) == 1 else CombinedRaySets(members)


def reach_inside(parts: TreeParts, low: NDArray[np.floating], high: NDArray[np.floating]) -> float:
    """Upper bound of the length inside the scene of rays that start in the box from `low` to `high`."""
    boxes = parts.boxes[0].astype(np.float64)
    return float(np.linalg.norm(np.maximum(boxes[1], high) - np.minimum(boxes[0], low))) + 1e-30


def nearest_hits(
    scheduled: ChcRtState,
    passes: Sequence[RayPass],
    shape: tuple[int, int],
    threads: int | None = None,
    progress: ProgressCallback | None = None,
) -> list[Hits]:
    """Nearest hits of several ray passes over images of this shape, traced in one call.

    The hits equal those of every other tracer.
    """
    threads = thread_count(threads)
    reach = reach_inside(scheduled.parts, *bounds(passes[0].origins, threads))
    members = _pass_sets(scheduled, [pass_rays(each, *shape, reach) for each in passes], threads)
    scheduled.run(combine_ray_sets(members), shape, progress)
    return [member.hits for member in members]


def _pass_sets(scheduled: ChcRtState, rays: Sequence[PassRays], threads: int) -> list[PassRaySet]:
    """Ray sets of passes, as from `_where_they_fit`; any-hit rays are traced here."""
    options, any_hit = scheduled.options, any(each.any_hit for each in rays)
    here = lambda: [PassRaySet(scheduled.parts, options, each, threads) for each in rays]
    there = lambda device: [device.passes(options, each, threads) for each in rays]
    return here() if any_hit else _where_they_fit(scheduled, there, here)


def _where_they_fit(
    scheduled: ChcRtState, there: "Callable[[OnDeviceParts], _Sets]", here: Callable[[], _Sets]
) -> _Sets:
    """Ray sets of nearest-hit rays on the device; here if there is none, and from the first ones on that do not fit."""
    if scheduled.on_device is not None and scheduled.sees_on_device:
        with suppress(OutOfDeviceMemory):
            return there(scheduled.on_device)
        scheduled.see_here()
    return here()


def ray_hits(
    scheduled: ChcRtState,
    rays: RayPass,
    spans: NDArray[np.float64],
    cull_faces: int,
    any_hit: bool,
    threads: int | None = None,
    targets: NDArray[np.float32] | None = None,
) -> Hits:
    """Nearest hit, or any hit, of m rays: `Hits` of shape (1, m).

    Consecutive rays should be coherent.

    spans : (m, 2) float64, tmin and tmax of each ray, in lengths of its direction
    cull_faces : a value of CULL_FACES
    targets : (m, 3) float32, ends of segments, for any-hit only; directions are their rounded differences
    """
    threads, m = thread_count(threads), len(rays.origins)
    origins, directions, skip = (a.reshape(1, m, *a.shape[1:]) for a in rays)
    reach = reach_inside(scheduled.parts, *bounds(rays.origins, threads))
    ends = NO_TARGETS if targets is None else targets.reshape(1, m, 3)
    segments = targets is not None
    pass_ = PassRays(origins, directions, skip, no_hits((1, m)), reach, spans, 1, cull_faces, any_hit, ends, segments)
    scheduled.run(_pass_sets(scheduled, [pass_], threads)[0], (1, m))
    return pass_.hits


def camera_hits(
    scheduled: ChcRtState,
    rays: CameraRays,
    threads: int | None = None,
    progress: ProgressCallback | None = None,
    rows: slice | None = None,
    signed: bool = False,
) -> Hits:
    """Nearest hits of camera rays.

    rows : slice or None
        Image rows to trace and return; starts at a multiple of 16. None: all rows.
    signed : bool
        Whether to write the signed t of all hits.

    Raises
    ------
    InputError
        If directions of adjacent pixels are too close, as in `query.rasteriser.rasterise`.
    """
    reach = reach_inside(scheduled.parts, rays.origin, rays.origin)
    rows = rows or slice(0, rays.height)
    arguments = scheduled.options, rays, rows, reach, thread_count(threads)
    view = _where_they_fit(
        scheduled, lambda device: device.camera(*arguments), lambda: CameraRaySet(scheduled.parts, *arguments)
    )
    scheduled.run(view, (rays.height, rays.width), progress)
    if signed:
        view.sign()
    return Hits(*(of_all[rows] for of_all in view.hits))


# --- Surfaces that camera rays and passes of diffuse rays hit ---------------------------------------------------------


def primary_hits(
    scheduled: ChcRtState, rays: CameraRays, threads: int | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """(face, t) of camera rays, in the format of `trace.primary.primary_rays.trace_primary`."""
    hits = camera_hits(scheduled, rays, threads)
    return hits.face, hits.t


def nearest_scheduled(
    passes: Sequence[RayPass],
    shape: tuple[int, int],
    scheduled: ChcRtState,
    triangles: Triangles,
    threads: int | None = None,
    show: Show | None = None,
) -> Iterator[Surfaces]:
    """Yield the nearest surfaces of each ray pass over an image of this shape; `triangles`: all triangles of the scene.

    show : as for `trace.rays.ray_hits.nearest_surfaces`
    """
    for rays in passes:
        (hits,) = nearest_hits(scheduled, [rays], shape, threads)
        face_t = hits.face.reshape(-1), hits.t.reshape(-1)
        if show is not None:
            show(rays, *face_t)
        met = hit_surfaces(rays, *face_t, shape, triangles, threads)
        yield surfaces_of(met, triangles)
