"""CHC+RT as a tracer: its state between frames, shadow queries, passes of rays, and the surfaces that they meet."""

from collections.abc import Iterator, Sequence
from threading import Lock

import numpy as np

from ...bvh.block_tree import block_tree
from ...bvh.nodes import Bvh
from ...kernels.parallel import thread_count
from ...query.query_bounds import bounds
from ...query.ray_passes import RayPass
from ...query.shadow_query import ShadowQuery, Surfaces, surfaces_of
from ...scene.camera import CameraRays
from ...trace.rays.ray_hits import Show, surfaces_met
from ...trace.tree_list import Hits, no_hits
from ..tracer_options import ChcRtOptions
from .picture_ray_sets import CameraRaySet, CombinedRaySets, PassRaySet, RaySets, SegmentRaySets, segments_of
from .ray_bundles import NO_TARGETS, PassRays, pass_rays
from .tree_parts import TreeParts, parts_of
from .visibility_fronts import Fronts, trace_frame

# --- CHC+RT as a tracer: its state between frames, and how it answers shadow queries and passes of rays ---------------


_KEPT = 8  # frames that a state is kept without being needed


class ChcRtState:
    """A scene ready for CHC+RT, with the visibility states that the last frame left.

    Each question of a frame has its own state. Question n starts from the state of question n of the last frame, if
    both have the same numbers of receivers and ray sets. So frames are coherent if they ask their questions in the same
    order. The answers never depend on this. A state that no question has needed for some frames is dropped.

    parts : Parts
    options : Options
    room : int
        Bytes of memory for the cells of ray sets that are asked together. 0: each is asked by itself.
    statistics : list of dict
        The statistics of each question of this frame: see `schedule.Statistics`.
    """

    def __init__(self, parts: TreeParts, options: ChcRtOptions):
        self.parts, self.options, self.room = parts, options, 0
        self._fronts: dict[tuple, tuple[int, Fronts]] = {}  # with the last frame that asked
        self._frame, self._lock = 0, Lock()
        self.begin()

    def begin(self) -> None:
        """Begin a new frame."""
        self._frame += 1
        self._fronts = {key: kept for key, kept in self._fronts.items() if kept[0] >= self._frame - _KEPT}
        self._questions, self.statistics = 0, list[dict]()

    def run(self, rays: RaySets | CombinedRaySets, shape: tuple, progress=None) -> None:
        """Trace ray sets as one question, from the state of the frame's next question."""
        with self._lock:
            key = self._questions, shape, rays.sets
            self._questions += 1
            fronts = self._fronts[key][1] if key in self._fronts else None
            if self.parts.memory is not None:
                self.parts.memory.begin_question()
            fronts = fronts or Fronts(rays.tiles, self.parts, rays.sets, self.options)
            self._fronts[key] = self._frame, fronts
            self.statistics.append(trace_frame(fronts, rays, progress).as_dict(fronts))

    def states(self) -> Iterator[tuple[int, Fronts]]:
        """Yield (number of a question, its state) for the questions of this frame, in order."""
        with self._lock:
            kept = [(key[0], fronts) for key, (frame, fronts) in self._fronts.items() if frame == self._frame]
        yield from sorted(kept, key=lambda state: state[0])


def prepare(bvh: Bvh, options: ChcRtOptions, threads=None) -> ChcRtState:
    """The tracer's form of a builder's tree."""
    return ChcRtState(parts_of(block_tree(bvh, threads), options), options)


def trace_shadow(scheduled: ChcRtState, query: ShadowQuery, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    trace_shadows(scheduled, [query], [bits], threads, counters, progress)


def trace_shadows(
    scheduled: ChcRtState, queries: Sequence[ShadowQuery], bits: Sequence[np.ndarray], threads=None, counters=None,
    progress=None,
) -> None:  # fmt: skip
    """Answer several queries of receivers of the same shape, as `trace_shadow` does.

    They are asked together as far as `Scheduled.room` allows. So each part is read once for all of them.
    """
    parts, options, used, members = scheduled.parts, scheduled.options, 0, list[SegmentRaySets]()
    inside = None if parts.memory else progress  # out of core, reading parts takes longest: report that
    how = {"threads": thread_count(threads), "counters": counters, "progress": inside}
    steps = [(q, b, *step) for q, b in zip(queries, bits, strict=True) for step in segments_of(parts, q)]
    for i, step in enumerate(steps):
        members.append(SegmentRaySets(parts, options, *step, **how))
        used += members[-1].rays.cells.nbytes
        if used >= scheduled.room or i == len(steps) - 1:
            scheduled.run(combine_ray_sets(members), queries[0].sides.shape, progress)
            used, members = 0, []


def combine_ray_sets(members: Sequence[RaySets]) -> RaySets | CombinedRaySets:
    """Ray sets as one question."""
    return members[0] if len(members) == 1 else CombinedRaySets(members)


def _reach(scheduled: ChcRtState, low, high) -> float:
    """The greatest length inside the scene of a ray that starts in the box from `low` to `high`."""
    boxes = scheduled.parts.boxes[0].astype(np.float64)
    return float(np.linalg.norm(np.maximum(boxes[1], high) - np.minimum(boxes[0], low))) + 1e-30


def nearest_hits(
    scheduled: ChcRtState, passes: Sequence[RayPass], shape: tuple[int, int], threads=None, progress=None
) -> list[Hits]:
    """The nearest hit of each ray of some passes over pictures of this shape, all asked together.

    Every other method finds the same hits.
    """
    threads = thread_count(threads)
    reach = _reach(scheduled, *bounds(passes[0].origins, threads))
    rays = [pass_rays(each, *shape, reach) for each in passes]
    members = [PassRaySet(scheduled.parts, scheduled.options, each, threads) for each in rays]
    scheduled.run(combine_ray_sets(members), shape, progress)
    return [member.hits for member in members]


def ray_hits(
    scheduled: ChcRtState, rays: RayPass, spans: np.ndarray, cull_faces: int, any_hit: bool, threads=None,
    targets: np.ndarray | None = None,
) -> Hits:  # fmt: skip
    """The nearest hit, or any hit, of each of m rays: `Hits` of shape (1, m).

    Rays that are near each other in the list should be alike.

    spans : (m, 2) float64, tmin and tmax of each ray, in lengths of its direction
    cull_faces : a value of CULL_FACES
    targets : (m, 3) float32, the ends of segments; for any hit only. Directions are their rounded differences.
    """
    threads, m = thread_count(threads), len(rays.origins)
    arrays = (a.reshape(1, m, *a.shape[1:]) for a in rays)
    reach = _reach(scheduled, *bounds(rays.origins, threads))
    ends = NO_TARGETS if targets is None else targets.reshape(1, m, 3)
    segments = targets is not None
    made = PassRays(*arrays, no_hits((1, m)), reach, spans, 1, cull_faces, any_hit, ends, segments)
    scheduled.run(PassRaySet(scheduled.parts, scheduled.options, made, threads), (1, m))
    return made.hits


def camera_hits(
    scheduled: ChcRtState, rays: CameraRays, threads=None, progress=None, rows: slice | None = None
) -> Hits:
    """The nearest hits of a camera's rays.

    rows : slice or None
        Of the picture, from a multiple of 16; None: all. The hits are those of these rows.

    Raises
    ------
    InputError
        If directions of neighbouring pixels are too close, as in `query.rasteriser.rasterise`.
    """
    reach = _reach(scheduled, rays.origin, rays.origin)
    rows = rows or slice(0, rays.height)
    view = CameraRaySet(scheduled.parts, scheduled.options, rays, rows, reach, thread_count(threads))
    scheduled.run(view, (rays.height, rays.width), progress)
    return Hits(*(of_all[rows] for of_all in view.hits))


# --- The surfaces that rays see, found by CHC+RT: for the camera's rays, and for passes of diffuse rays ---------------


def primary_hits(scheduled: ChcRtState, rays: CameraRays, threads=None) -> tuple[np.ndarray, np.ndarray]:
    """The (face, t) that a camera sees, in the format of `trace.primary.primary_rays.trace_primary`."""
    hits = camera_hits(scheduled, rays, threads)
    return hits.face, hits.t


def nearest_scheduled(
    passes: Sequence[RayPass], shape, scheduled: ChcRtState, triangles, threads=None, show: Show | None = None
) -> Iterator[Surfaces]:
    """Yield the surfaces that passes of a picture of this shape meet first; `triangles`: all triangles of the scene.

    show : as for `trace.rays.ray_hits.nearest_surfaces`
    """
    for rays in passes:
        (hits,) = nearest_hits(scheduled, [rays], shape, threads)
        found = hits.face.reshape(-1), hits.t.reshape(-1)
        if show is not None:
            show(rays, *found)
        met = surfaces_met(rays, *found, shape, triangles, threads)
        yield surfaces_of(met, triangles)
