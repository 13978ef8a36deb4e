"""Measures walkthroughs of 60 frames, in memory and out of core [Mattausch et al. 2015, Sec. 7].

The methods alternate within each frame, trace the same rays, and have their answers compared. CHC+RT traces every
frame, because it keeps state from the previous one; the other methods are stateless and trace only some frames.

Out of core (Sec. 5.4, Tables 3 and 4), only part of the triangles is in memory. The eviction policies run one after the
other, because each may fill the memory. The operating system may still cache pages that the second policy reads.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from math import inf
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...bvh.block_tree import block_tree
from ...engine.paged_scene import PagedScene
from ...engine.paged_source import Paged
from ...engine.plan import parse_plan
from ...errors import InputError
from ...picture.frame_request import PASS_BYTES, Request, frame_memory
from ...picture.image_files import to_srgb8
from ...picture.render_kernels import precompile_indirect, precompile_plan
from ...picture.render_options import RenderOptions
from ...picture.renderer import Renderer
from ...query.light_samples import ROTATIONS, light_samples
from ...query.ray_passes import diffuse_passes
from ...query.shadow_query import Surfaces, surfaces_of
from ...scene.camera import Camera
from ...scene.lights import AmbientOcclusion
from ...techniques.chcrt.chc_rt import ChcRtState
from ...techniques.chcrt.tree_parts import parts_of
from ...techniques.tracer_options import ChcRtOptions
from ..bench_runner import Say
from ..benchmark_views import digest
from ..published_methods import THRESHOLDS, tracer_name
from .walkthroughs import (
    AO,
    DIFFUSE,
    KINDS,
    PASSES,
    PLANS,
    SAMPLER,
    SPP,
    Answer,
    Culling,
    FrameRays,
    Method,
    Plain,
    Walk,
    WalkPlace,
    differing,
    frame_rays,
    timed,
)

# --- Walkthroughs in memory -------------------------------------------------------------------------------------------


CHCRT = tracer_name(0)
SAMPLERS = tuple(name for name in ROTATIONS if ":" in name)
"""The samplers of Table 5: directions are rotated between pixels by 0, 18 and 36 degrees, or fully."""

PHASES = ("phase 1", "phase 2", "phase 3")
_OPTIONS = ChcRtOptions()


class Pace(NamedTuple):
    """The length of a walkthrough."""

    frames: int  # frames of the whole walkthrough
    compared: int  # frames that the stateless methods trace
    limit: float  # seconds after which no further frame begins; the second always does
    most: int = 10_000  # frames after which the walkthrough is cut short

    def takes_part(self, method: Method, frame: int) -> bool:
        """Whether a method traces a frame: CHC+RT all, the others evenly spaced ones from the second on."""
        every = max(1, -(-(self.frames - 1) // self.compared))
        return isinstance(method, Culling) or (frame > 0 and (frame - 1) % every == 0) or self.frames == 1

    def along(self, walk: Walk, what: str, say: Say) -> Iterator[tuple[int, Camera]]:
        """Yield (frame, camera) until the time limit, and report each frame to `say`."""
        start = perf_counter()
        for frame in range(min(self.frames, self.most)):
            if frame > 1 and perf_counter() - start > self.limit:
                return
            say(f"{what}, frame {frame + 1} of {self.frames}")
            yield frame, walk.camera(frame, self.frames)


class Turn(NamedTuple):
    """One method tracing the rays of one kind in one frame."""

    scene: str
    view: str  # name of the walk
    sampler: str  # sampler of AO and diffuse rays
    kind: str  # ray kind, one of KINDS
    method: str
    frame: int
    rays: int
    seconds: float
    statistics: dict[str, float]  # of CHC+RT: seconds of PHASES, queries, pairs; with a store, paging counts
    differs: int  # rays whose answer differs from the first method's
    error: float | None = None  # aggressive mode: mean absolute difference from the exact picture, 0 to 255


class InCore:
    """A scene in memory: its triangles, and the acceleration structures of all methods."""

    def __init__(self, place: WalkPlace, threads: int, options: ChcRtOptions = _OPTIONS):
        self.place, self.threads, self._options = place, threads, options
        plans = [parse_plan(plan) for plan in (*PLANS, "bsah+chcrt")]
        for plan in plans:
            precompile_plan(plan, "rays")
            precompile_indirect("rays")
        self._renderer = Renderer(place.scene, plans[0], threads)
        accelerated = self._renderer.accelerate()
        assert accelerated.bvh is not None
        self.triangles, self._bvh = accelerated.triangles, accelerated.bvh
        self._tree = block_tree(self._bvh, threads)
        self._parts = parts_of(self._tree, options)

    def culling(self, threshold: int = 0) -> Culling:
        """CHC+RT in its initial state."""
        return self.culling_by(tracer_name(threshold), {"threshold": threshold})

    def culling_by(self, name: str, changed: dict[str, Any]) -> Culling:
        """CHC+RT with some options changed, under another name."""
        options = self._options._replace(**changed)
        changes_parts = {"triangles", "height"} & changed.keys()
        parts = parts_of(self._tree, options) if changes_parts else self._parts
        return Culling(name, ChcRtState(parts, options), self.threads)

    def bytes(self) -> tuple[int, int]:
        """Bytes of (BVH nodes, triangles) that CHC+RT traces."""
        tree = self._tree
        geometry = tree.blocks, tree.bounds, tree.slots, tree.prim_ids, tree.corners, self.triangles.colour
        return tree.nodes.nbytes, sum(array.nbytes for array in geometry)

    def plain(self) -> list[Plain]:
        """The stateless plans."""
        return [Plain(plan, self._bvh, self._tree, self.threads) for plan in PLANS]

    def frame_rays(self, camera: Camera, sampler: str) -> FrameRays:
        """The rays of a frame."""
        surfaces = surfaces_of(self._renderer.see(self.triangles, camera), self.triangles)
        return frame_rays(self.place, camera, surfaces, sampler, self.threads)


def walk_through(
    core: InCore, walk: Walk, methods: Sequence[Method], kinds: Iterable[str], sampler: str, pace: Pace, say: Say
) -> list[Turn]:
    """The turns of all methods in a walkthrough; InputError if the camera of the first frame sees nothing.

    The first method is exact CHC+RT; the answers of the others are compared with its answers.
    """
    turns: list[Turn] = []
    for frame, camera in pace.along(walk, f"{core.place.name}, {walk.name}", say):
        frame_rays = core.frame_rays(camera, sampler)
        if frame == 0 and not (frame_rays.surfaces.ids >= 0).any():
            raise InputError(f"{core.place.name}: the {walk.name} camera sees nothing; choose another scene")
        begin(methods)
        for kind in kinds:
            truth: list[Answer] = []
            for method in methods:
                if kind in method.kinds and pace.takes_part(method, frame):
                    statistics, (seconds, answers) = statistics_counter(method), timed(method, frame_rays, kind)
                    truth = truth or answers
                    error = _error(frame_rays, truth, answers, method, kind)
                    where = core.place.name, walk.name, sampler, kind, method.name, frame
                    turns.append(
                        Turn(*where, frame_rays.rays(kind), seconds, statistics(), differing(truth, answers), error)
                    )
    return turns


def begin(methods: Iterable[Method]) -> None:
    """Start a frame."""
    for method in methods:
        if isinstance(method, Culling):
            method.scheduled.begin()


def statistics_counter(method: Method) -> Callable[[], dict[str, float]]:
    """A function that returns the sums of CHC+RT's statistics since this call, or an empty dict for other methods."""
    if not isinstance(method, Culling):
        return dict
    scheduled, first = method.scheduled, len(method.scheduled.statistics)

    def sums() -> dict[str, float]:
        new = scheduled.statistics[first:]
        return {name: sum(query[name] for query in new) for name in new[0]}

    return sums


def _error(frame_rays: FrameRays, truth: list[Answer], other: list[Answer], method: Method, kind: str) -> float | None:
    """Mean absolute difference of two diffuse pictures; None unless the method is aggressive."""
    if not (isinstance(method, Culling) and method.scheduled.options.threshold and kind == DIFFUSE):
        return None
    colour = frame_rays.surfaces.triangles.colour
    return error_of(
        *(colour_bleeding(frame_rays.surfaces, [(colour, face) for face, _ in answers]) for answers in (truth, other))
    )


def error_of(one: np.ndarray, other: np.ndarray) -> float:
    """Mean absolute difference of two pictures, on a scale of 0 to 255."""
    return float(np.abs(one.astype(np.int16) - other).mean())


def colour_bleeding(surfaces: Surfaces, hits: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(H, W, 3) uint8: a picture of colour bleeding.

    Surfaces are lit by a white sky and by the colours of the triangles that their diffuse rays hit, all equally bright.
    `hits` has per pass the colours of the triangles, and the triangle that each pixel's ray hits, or -1.
    """
    face = surfaces.gbuffer.face
    light = np.zeros((*face.shape, 3), np.float32)
    for colour, triangle in hits:
        triangle = triangle.reshape(face.shape)
        light += np.where((triangle >= 0)[..., None], colour[triangle], np.float32(1.0))
    light *= surfaces.triangles.colour[face] * (face >= 0)[..., None] / np.float32(len(hits))
    return to_srgb8(light, 1.0)


def times(core: InCore, pace: Pace, plain: bool, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 2, Table 3 and Fig. 8: all ray kinds, near and far. Yield the turns of each walkthrough.

    `plain` : whether to measure the stateless plans too
    """
    for walk in core.place.walks:
        methods: list[Method] = [core.culling(), *(core.plain() if plain else [])]
        yield walk_through(core, walk, methods, KINDS, SAMPLER, pace, say)


def randomisation(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 5: AO and diffuse rays in the near walk, with growing rotations between pixels."""
    for sampler in SAMPLERS:
        yield walk_through(core, core.place.walks[0], [core.culling()], (AO, DIFFUSE), sampler, pace, say)


def aggressive(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 4: diffuse rays in aggressive mode."""
    for walk in core.place.walks:
        methods = [core.culling(threshold) for threshold in THRESHOLDS]
        yield walk_through(core, walk, methods, (DIFFUSE,), SAMPLER, pace, say)


def of(turns: Iterable[Turn], **fields: object) -> list[Turn]:
    """The turns whose fields have these values, in frame order."""
    return [turn for turn in turns if all(getattr(turn, name) == value for name, value in fields.items())]


def rows_of(turns: Iterable[Turn], *fields: str) -> list[dict[str, str]]:
    """The distinct combinations of values of these fields, in order of appearance."""
    return [dict(zip(fields, values)) for values in dict.fromkeys(tuple(getattr(t, f) for f in fields) for t in turns)]


def first(turns: list[Turn]) -> float | None:
    """Seconds of frame 0; None if no turn has it."""
    return next((t.seconds for t in turns if t.frame == 0), None)


def later(turns: list[Turn]) -> list[Turn]:
    """The turns after the first frame, or all turns if there are none."""
    return [t for t in turns if t.frame > 0] or turns


def typical(turns: list[Turn], value: str = "seconds") -> float:
    """The median of a value over the frames after the first.

    `value` is "seconds", a statistic of CHC+RT (0 if missing), "before" or "geometry_bytes". "before" is the time
    outside all phases, which includes making cells; "geometry_bytes" are the bytes read other than nodes.
    """
    return median(value_of(turn, value) for turn in later(turns))


def value_of(turn: Turn, name: str) -> float:
    """A value of a turn, named as in `typical`."""
    if name == "before":
        return turn.seconds - sum(turn.statistics[phase] for phase in PHASES)
    if name == "geometry_bytes":
        return turn.statistics.get("bytes", 0) - turn.statistics.get("bvh_bytes", 0)
    return turn.seconds if name == "seconds" else turn.statistics.get(name, 0)


def speedup(ours: list[Turn], theirs: list[Turn]) -> float:
    """The time of another method relative to ours, in the frames that it traces."""
    frames = {t.frame for t in later(theirs)}
    return typical(theirs) / median(t.seconds for t in ours if t.frame in frames)


# --- Walkthroughs out of core -----------------------------------------------------------------------------------------


Digests = list[tuple[str, bytes]]
"""(query, digest) of all answers, for `papers.benchmark_views.agree`."""


def out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, policies: Sequence[str], say: Say
) -> Iterator[tuple[list[Turn], Digests]]:
    """Yield (turns, digests) of each walkthrough under each eviction policy, the `method` of its turns."""
    for walk in place.walks:
        for policy in policies:
            with opened(place, max_memory, threads) as paged:
                paged.residency.policy = policy
                result = walk_through_store(place, walk, paged, policy, pace, say)
            yield result


@contextmanager
def opened(place: WalkPlace, max_memory: int | None, threads: int) -> Iterator[Paged]:
    """The store of a scene, with no chunk in memory."""
    if not isinstance(place.scene, PagedScene):
        raise InputError(f"{place.name}: not a store; use --scene instead of --store")
    renderer = Renderer(place.scene, None, threads, max_memory=max_memory)
    precompile_plan(renderer.plan, "rays")
    precompile_indirect("rays")
    paged = renderer.source
    assert isinstance(paged, Paged)
    try:
        yield paged
    finally:
        paged.residency.close()


def aggressive_out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, say: Say
) -> Iterator[list[Turn]]:
    """Measure Table 4 out of core, where it matters most: aggressive diffuse rays after exact camera rays."""
    for walk in place.walks:
        pictures: list[np.ndarray] = []
        for threshold in THRESHOLDS:
            with opened(place, max_memory, threads) as paged:
                turns = _bleed_through(place, walk, paged, threshold, pictures, pace, say)
            yield turns


def _bleed_through(
    place: WalkPlace, walk: Walk, paged: Paged, threshold: int, pictures: list[np.ndarray], pace: Pace, say: Say
) -> list[Turn]:
    """The turns of one threshold.

    Threshold 0 appends its picture of each frame to `pictures`; the other thresholds are compared with these.
    """
    exact, threads = paged.accelerated.prepared, paged.threads
    by = ChcRtState(exact.parts, exact.options._replace(threshold=threshold))
    name = tracer_name(threshold)
    camera_method, method = Culling(CHCRT, exact, threads), Culling(name, by, threads)
    turns: list[Turn] = []
    pace = pace._replace(limit=inf) if threshold else pace
    frames = pace.along(walk, f"{place.name}, {walk.name}, {name}", say)
    for frame, camera in islice(frames, len(pictures) if threshold else None):
        paged.begin(frame_memory(_request(place, camera)))
        begin([camera_method, method])
        surfaces = paged.look(camera)
        rays = frame_rays(place, camera, surfaces, SAMPLER, threads)
        by.room = exact.room
        before, statistics, seconds, hit_colours = paged.residency.paging, statistics_counter(method), 0.0, []
        passes, each = list(rays.diffuse()), PASS_BYTES * camera.width * camera.height
        for first in range(0, len(passes), n := paged.together(each)):
            began = perf_counter()
            for hits in paged.nearest(passes[first : first + n], rays.shape, by):
                seconds += perf_counter() - began
                hit_colours.append((hits.triangles.colour, hits.gbuffer.face))
                began = perf_counter()
        moved = _moved(before, paged)
        picture = colour_bleeding(surfaces, hit_colours)
        pictures += [] if threshold else [picture]
        error = error_of(pictures[frame], picture) if threshold else None
        where = place.name, walk.name, SAMPLER, DIFFUSE, name, frame
        turns.append(Turn(*where, rays.rays(DIFFUSE), seconds, {**statistics(), **moved}, 0, error))
        del surfaces, rays, passes, hit_colours, hits  # free their memory for the next frame
    return turns


def _request(place: WalkPlace, camera: Camera) -> Request:
    """A frame request with the benchmark's rays."""
    lights = [AmbientOcclusion(place.reach), place.light]
    samples = [light_samples(lights[0], PASSES, SAMPLER), light_samples(lights[1], SPP)]
    return Request(camera, lights, RenderOptions(), samples, passes=diffuse_passes([place.light], PASSES, SAMPLER))


def _moved(before: NamedTuple, paged: Paged) -> dict[str, int]:
    """The paging counts since `before`."""
    after = paged.residency.paging
    return {name: b - a for name, a, b in zip(after._fields, before, after)}


def walk_through_store(
    place: WalkPlace, walk: Walk, paged: Paged, name: str, pace: Pace, say: Say
) -> tuple[list[Turn], Digests]:
    """(turns of all ray kinds, digests of their answers) of a walkthrough; `name` is the `method` of the turns."""
    threads = paged.threads
    method = Culling(name, paged.accelerated.prepared, threads)
    turns: list[Turn] = []
    digests: Digests = []
    for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, {name}", say):
        paged.begin(frame_memory(_request(place, camera)))
        method.together = paged.together(PASS_BYTES * camera.width * camera.height)
        begin([method])
        rays: FrameRays | None = None
        for kind in KINDS:
            before, statistics = paged.residency.paging, statistics_counter(method)
            if rays is None:  # camera rays are timed with making the surfaces, whose triangles are in the chunks
                began = perf_counter()
                surfaces = paged.look(camera)
                seconds = perf_counter() - began
                arrays = [surfaces.ids, surfaces.gbuffer.depth]
                rays = frame_rays(place, camera, surfaces, SAMPLER, threads)
            else:
                seconds, answers = timed(method, rays, kind)
                arrays = [a for answer in answers for a in answer]
            moved = _moved(before, paged)
            digests.append((f"{walk.name}, {frame}, {kind}", digest(arrays)))
            where = place.name, walk.name, SAMPLER, kind, name, frame
            turns.append(Turn(*where, rays.rays(kind), seconds, {**statistics(), **moved}, 0))
    return turns, digests


def hit_rate(turns: list[Turn]) -> float:
    """The share of requested chunks that were in memory."""
    requested = sum(t.statistics["wanted"] for t in turns)
    return sum(t.statistics["cached"] for t in turns) / requested if requested else 1.0
