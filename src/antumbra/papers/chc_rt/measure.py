"""Measures the tables of the CHC+RT paper: walkthroughs of 60 frames [Mattausch et al. 2015, Sec. 7].

Methods take turns within each frame, on the same rays. Their answers are compared there. CHC+RT takes part in every
frame, because it keeps state from the frame before. The other methods keep no state and take part in some frames.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ...bvh.blocks import block_tree
from ...errors import InputError
from ...picture.image_files import to_srgb8
from ...plan import parse_plan
from ...query.light_samples import ROTATIONS
from ...query.shadow_query import Surfaces, surfaces_of
from ...rendering.render_jobs import warm_up, warm_up_indirect
from ...rendering.renderer import Renderer
from ...scene.camera import Camera
from ...techniques.chcrt.chc_rt import ChcRtState
from ...techniques.chcrt.tree_parts import parts_of
from ...techniques.tracer_options import ChcRtOptions
from .rays import (
    AO,
    DIFFUSE,
    KINDS,
    PLANS,
    SAMPLER,
    Answer,
    Culling,
    FrameRays,
    Method,
    Plain,
    asked_of,
    differing,
    timed,
)
from .variants import THRESHOLDS, tracer_name
from .views import Walk, WalkPlace

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
            warm_up(plan, "rays")
            warm_up_indirect("rays")
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
        return asked_of(self.place, camera, surfaces, sampler, self.threads)


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
                    told, (seconds, found) = told_by(method), timed(method, asked, kind)
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


def told_by(method: Method) -> Callable[[], dict[str, float]]:
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
