"""Measures walkthroughs of 60 frames, in memory and out of core [Mattausch et al. 2015, Sec. 7].

Methods take turns within each frame, on the same rays, and their answers are compared there. CHC+RT takes part in every
frame, because it keeps state from the frame before. The other methods keep no state and take part in some frames. Out
of core, only a part of the triangles is in memory.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from math import inf
from statistics import median
from time import perf_counter
from typing import NamedTuple

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

# --- Measures the tables of the CHC+RT paper: walkthroughs of 60 frames [Mattausch et al. 2015, Sec. 7] ---------------
#
# Methods take turns within each frame, on the same rays. Their answers are compared there. CHC+RT takes part in every
# frame, because it keeps state from the frame before. The other methods keep no state and take part in some frames.


CHCRT = tracer_name(0)
SAMPLERS = tuple(name for name in ROTATIONS if ":" in name)
"""The samplers of Table 5: rotations from pixel to pixel by 0, 18 and 36 degrees, and full rotations."""

Say = Callable[[str], None]
PHASES = ("phase 1", "phase 2", "phase 3")
_OPTIONS = ChcRtOptions()


class Pace(NamedTuple):
    """The length of a walkthrough."""

    frames: int  # number of frames
    compared: int  # number of frames in which the methods without state take part
    limit: float  # seconds after which no further frame begins, except the second
    most: int = 10_000  # frames after which the walkthrough ends, however many there are

    def takes_part(self, method: Method, frame: int) -> bool:
        """Whether a method takes part in a frame.

        CHC+RT takes part in every frame. The others take part from the second frame on, in frames that are spread
        evenly.
        """
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
    kind: str  # kind of rays, one of KINDS
    method: str
    frame: int
    rays: int
    seconds: float
    told: dict[str, float]  # statistics of CHC+RT: seconds of PHASES, queries, pairs; with a store, counts of Paging
    differs: int  # rays whose answer differs from the first method's
    error: float | None = (
        None  # mean absolute difference from the exact picture, 0 to 255; None unless the method is aggressive
    )


class InCore:
    """A place in memory: its triangles, and the acceleration structures of all methods."""

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
        """CHC+RT without state from earlier frames."""
        return self.culling_by(tracer_name(threshold), {"threshold": threshold})

    def culling_by(self, name: str, changed: dict) -> Culling:
        """CHC+RT with some options changed, under a name of its own."""
        options = self._options._replace(**changed)
        cut = {"triangles", "height"} & changed.keys()
        parts = parts_of(self._tree, options) if cut else self._parts
        return Culling(name, ChcRtState(parts, options), self.threads)

    def bytes(self) -> tuple[int, int]:
        """Bytes of (the nodes of the BVH, the triangles) that CHC+RT traces."""
        tree = self._tree
        geometry = tree.blocks, tree.bounds, tree.slots, tree.prim_ids, tree.corners, self.triangles.colour
        return tree.nodes.nbytes, sum(array.nbytes for array in geometry)

    def plain(self) -> list[Plain]:
        """The plans that keep no state."""
        return [Plain(plan, self._bvh, self._tree, self.threads) for plan in PLANS]

    def asked(self, camera: Camera, sampler: str) -> FrameRays:
        """The rays of a frame."""
        surfaces = surfaces_of(self._renderer.see(self.triangles, camera), self.triangles)
        return frame_rays(self.place, camera, surfaces, sampler, self.threads)


def walk_through(
    core: InCore, walk: Walk, methods: Sequence[Method], kinds: Iterable[str], sampler: str, pace: Pace, say: Say
) -> list[Turn]:
    """The turns of all methods in a walkthrough.

    The first method is exact CHC+RT. The answers of the others are compared with its answers. InputError if the camera
    of the first frame sees nothing.
    """
    turns: list[Turn] = []
    for frame, camera in pace.along(walk, f"{core.place.name}, {walk.name}", say):
        asked = core.asked(camera, sampler)
        if frame == 0 and not (asked.surfaces.ids >= 0).any():
            raise InputError(f"{core.place.name}: the {walk.name} camera sees nothing; choose another scene")
        begin(methods)
        for kind in kinds:
            truth: list[Answer] = []
            for method in methods:
                if kind in method.kinds and pace.takes_part(method, frame):
                    told, (seconds, found) = statistics_counter(method), timed(method, asked, kind)
                    truth = truth or found
                    error = _error(asked, truth, found, method, kind)
                    where = core.place.name, walk.name, sampler, kind, method.name, frame
                    turns.append(Turn(*where, asked.rays(kind), seconds, told(), differing(truth, found), error))
    return turns


def begin(methods: Iterable[Method]) -> None:
    """Begin a new frame."""
    for method in methods:
        if isinstance(method, Culling):
            method.scheduled.begin()


def statistics_counter(method: Method) -> Callable[[], dict[str, float]]:
    """A function that sums the statistics of CHC+RT since this call. For other methods it returns an empty dict."""
    if not isinstance(method, Culling):
        return dict
    scheduled, first = method.scheduled, len(method.scheduled.statistics)

    def told() -> dict[str, float]:
        new = scheduled.statistics[first:]
        return {name: sum(question[name] for question in new) for name in new[0]}

    return told


def _error(asked: FrameRays, truth, found, method: Method, kind: str) -> float | None:
    """Mean absolute difference of two pictures of diffuse light; None unless the method is aggressive."""
    if not (isinstance(method, Culling) and method.scheduled.options.threshold and kind == DIFFUSE):
        return None
    colour = asked.surfaces.triangles.colour
    return error_of(*(bled(asked.surfaces, [(colour, met) for met, _ in answers]) for answers in (truth, found)))


def error_of(one: np.ndarray, other: np.ndarray) -> float:
    """Mean absolute difference of two pictures, 0 to 255."""
    return float(np.abs(one.astype(np.int16) - other).mean())


def bled(surfaces: Surfaces, met: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(H, W, 3) uint8: a picture of colour bleeding.

    Each surface is lit by a white sky and by the colours of the triangles that its diffuse rays hit. All triangles are
    equally lit. `met` holds for each pass the colours of triangles, and the triangle that each pixel's ray hit, or -1.
    """
    face = surfaces.gbuffer.face
    light = np.zeros((*face.shape, 3), np.float32)
    for colour, triangle in met:
        triangle = triangle.reshape(face.shape)
        light += np.where((triangle >= 0)[..., None], colour[triangle], np.float32(1.0))
    light *= surfaces.triangles.colour[face] * (face >= 0)[..., None] / np.float32(len(met))
    return to_srgb8(light, 1.0)


def times(core: InCore, pace: Pace, plain: bool, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 2, Table 3 and Fig. 8: rays of all kinds, near and far. Yield the turns of each walkthrough.

    `plain` : whether the plans without state are measured too
    """
    for walk in core.place.walks:
        methods = [core.culling(), *(core.plain() if plain else [])]
        yield walk_through(core, walk, methods, KINDS, SAMPLER, pace, say)


def randomisation(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 5: AO and diffuse rays in the near walk, with growing rotations from pixel to pixel."""
    for sampler in SAMPLERS:
        yield walk_through(core, core.place.walks[0], [core.culling()], (AO, DIFFUSE), sampler, pace, say)


def aggressive(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure Table 4: diffuse rays in aggressive mode."""
    for walk in core.place.walks:
        methods = [core.culling(threshold) for threshold in THRESHOLDS]
        yield walk_through(core, walk, methods, (DIFFUSE,), SAMPLER, pace, say)


def of(turns: Iterable[Turn], **fields) -> list[Turn]:
    """The turns whose fields have these values, in the order of their frames."""
    return [turn for turn in turns if all(getattr(turn, name) == value for name, value in fields.items())]


def rows_of(turns: Iterable[Turn], *fields: str) -> list[dict]:
    """The distinct combinations of values of some fields, in order of appearance."""
    return [dict(zip(fields, values)) for values in dict.fromkeys(tuple(getattr(t, f) for f in fields) for t in turns)]


def first(turns: list[Turn]) -> float | None:
    """Seconds of frame 0; None if it is not among the turns."""
    return next((t.seconds for t in turns if t.frame == 0), None)


def later(turns: list[Turn]) -> list[Turn]:
    """The turns after the first frame; the first one if there is no other."""
    return [t for t in turns if t.frame > 0] or turns


def typical(turns: list[Turn], name: str = "seconds") -> float:
    """The median over the frames after the first of a value.

    `name` is "seconds", a statistic of CHC+RT (0 if there is none), "before" or "geometry_bytes". "before" is the time
    outside all phases, which includes making cells. "geometry_bytes" are the bytes read besides those of nodes.
    """
    return median(value_of(turn, name) for turn in later(turns))


def value_of(turn: Turn, name: str) -> float:
    """A value of a turn, by the names of `typical`."""
    if name == "before":
        return turn.seconds - sum(turn.told[phase] for phase in PHASES)
    if name == "geometry_bytes":
        return turn.told.get("bytes", 0) - turn.told.get("bvh_bytes", 0)
    return turn.seconds if name == "seconds" else turn.told.get(name, 0)


def speedup(ours: list[Turn], theirs: list[Turn]) -> float:
    """The time of another method relative to ours, in the frames in which it takes part."""
    frames = {t.frame for t in later(theirs)}
    return typical(theirs) / median(t.seconds for t in ours if t.frame in frames)


# --- Measures walkthroughs out of core: only a part of the triangles is in memory -------------------------------------
#
# They are those of [Mattausch et al. 2015, Sec. 5.4, Tables 3 and 4]. The eviction policies run one after the other,
# because each may fill the memory. The system may still cache pages that the second one reads.


Digests = list[tuple[str, bytes]]
"""(question, digest) of all answers, for `papers.benchmark_views.agree`."""


def out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, policies: Sequence[str], say: Say
) -> Iterator[tuple[list[Turn], Digests]]:
    """Yield (turns, digests) of each walkthrough by each eviction policy. The method of a turn is its policy."""
    for walk in place.walks:
        for policy in policies:
            with opened(place, max_memory, threads) as paged:
                paged.residency.policy = policy
                found = walk_through_store(place, walk, paged, policy, pace, say)
            yield found


@contextmanager
def opened(place: WalkPlace, max_memory: int | None, threads: int) -> Iterator[Paged]:
    """The store of a place, with no chunk in memory."""
    if not isinstance(place.scene, PagedScene):
        raise InputError(f"{place.name}: is not a store; name it with --scene instead of --store")
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
    """Measure Table 4 out of core, where it matters most: diffuse rays in aggressive mode. Camera rays stay exact."""
    for walk in place.walks:
        pictures: list[np.ndarray] = []
        for threshold in THRESHOLDS:
            with opened(place, max_memory, threads) as paged:
                found = _bleed_through(place, walk, paged, threshold, pictures, pace, say)
            yield found


def _bleed_through(
    place: WalkPlace, walk: Walk, paged: Paged, threshold: int, pictures: list[np.ndarray], pace: Pace, say: Say
) -> list[Turn]:
    """The turns of one threshold.

    Threshold 0 appends the picture of each frame to `pictures`. Other thresholds compare their pictures with these, in
    the same frames.
    """
    exact, threads = paged.accelerated.prepared, paged.threads
    by = ChcRtState(exact.parts, exact.options._replace(threshold=threshold))
    name = tracer_name(threshold)
    seeing, method = Culling(CHCRT, exact, threads), Culling(name, by, threads)
    turns: list[Turn] = []
    pace = pace._replace(limit=inf) if threshold else pace
    frames = pace.along(walk, f"{place.name}, {walk.name}, {name}", say)
    for frame, camera in islice(frames, len(pictures) if threshold else None):
        paged.begin(frame_memory(_request(place, camera)))
        begin([seeing, method])
        surfaces = paged.look(camera)
        asked = frame_rays(place, camera, surfaces, SAMPLER, threads)
        by.room = exact.room
        before, told, seconds, met = paged.residency.paging, statistics_counter(method), 0.0, []
        passes, each = list(asked.questions(DIFFUSE)), PASS_BYTES * camera.width * camera.height
        for first in range(0, len(passes), n := paged.together(each)):
            began = perf_counter()
            for found in paged.nearest(passes[first : first + n], asked.shape, by):
                seconds += perf_counter() - began
                met.append((found.triangles.colour, found.gbuffer.face))
                began = perf_counter()
        moved = _moved(before, paged)
        picture = bled(surfaces, met)
        pictures += [] if threshold else [picture]
        error = error_of(pictures[frame], picture) if threshold else None
        where = place.name, walk.name, SAMPLER, DIFFUSE, name, frame
        turns.append(Turn(*where, asked.rays(DIFFUSE), seconds, {**told(), **moved}, 0, error))
        del surfaces, asked, passes, met, found  # the next frame has their memory
    return turns


def _request(place: WalkPlace, camera: Camera) -> Request:
    """A frame with the rays of the benchmark."""
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
    """(turns of all kinds of rays, digests of their answers) of a walkthrough; `name`: the method of the turns."""
    threads = paged.threads
    method = Culling(name, paged.accelerated.prepared, threads)
    turns: list[Turn] = []
    digests: Digests = []
    for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, {name}", say):
        paged.begin(frame_memory(_request(place, camera)))
        method.together = paged.together(PASS_BYTES * camera.width * camera.height)
        begin([method])
        asked: FrameRays | None = None
        for kind in KINDS:
            before, told = paged.residency.paging, statistics_counter(method)
            if asked is None:  # the time of camera rays includes making the surfaces, whose triangles are in the chunks
                began = perf_counter()
                surfaces = paged.look(camera)
                seconds = perf_counter() - began
                arrays = [surfaces.ids, surfaces.gbuffer.depth]
                asked = frame_rays(place, camera, surfaces, SAMPLER, threads)
            else:
                seconds, found = timed(method, asked, kind)
                arrays = [a for answer in found for a in answer]
            moved = _moved(before, paged)
            digests.append((f"{walk.name}, {frame}, {kind}", digest(arrays)))
            where = place.name, walk.name, SAMPLER, kind, name, frame
            turns.append(Turn(*where, asked.rays(kind), seconds, {**told(), **moved}, 0))
    return turns, digests


def hit_rate(turns: list[Turn]) -> float:
    """The share of requested chunks that were in memory."""
    wanted = sum(t.told["wanted"] for t in turns)
    return sum(t.told["cached"] for t in turns) / wanted if wanted else 1.0
