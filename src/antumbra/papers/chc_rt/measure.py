"""The figures of the paper on CHC+RT, measured here: walkthroughs of 60 frames [Mattausch et al. 2015, Sec. 7].

Methods take their turns within each frame, on the same rays, and their answers are compared there. CHC+RT is in every
frame, since it remembers the one before; the others, which do not, are in some of them.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from ...bvh.blocks import block_tree
from ...chcrt.options import Options
from ...chcrt.parts import parts_of
from ...chcrt.trace import Scheduled
from ...errors import InputError
from ...image.tonemap import to_srgb8
from ...plan import parse_plan
from ...query.picture import Surfaces, surfaces_of
from ...query.sampling import ROTATIONS
from ...rendering.render_jobs import warm_up, warm_up_indirect
from ...rendering.renderer import Renderer
from ...scene.camera import Camera
from .rays import AO, DIFFUSE, KINDS, PLANS, SAMPLER, Answer, Asked, Culling, Method, Plain, asked_of, differing, timed
from .variants import THRESHOLDS, tracer_name
from .views import Place, Walk

CHCRT = tracer_name(0)
SAMPLERS = tuple(name for name in ROTATIONS if ":" in name)
"""What Table 5 compares: directions are rotated from pixel to pixel not at all, by 18 and 36 degrees, and fully."""

Say = Callable[[str], None]
PHASES = ("phase 1", "phase 2", "phase 3")
_OPTIONS = Options()


class Pace(NamedTuple):
    """How a walkthrough is gone through."""

    frames: int
    compared: int  # in how many of them the methods that remember nothing have their turns
    limit: float  # seconds after which no further frame begins, but for the second

    def takes_part(self, method: Method, frame: int) -> bool:
        """Has a method its turn in a frame? All but CHC+RT from the second one on, spread evenly."""
        every = max(1, -(-(self.frames - 1) // self.compared))
        return isinstance(method, Culling) or (frame > 0 and (frame - 1) % every == 0) or self.frames == 1

    def along(self, walk: Walk, what: str, say: Say) -> Iterator[tuple[int, Camera]]:
        """(frame, camera) until time is over, told of one by one."""
        start = perf_counter()
        for frame in range(self.frames):
            if frame > 1 and perf_counter() - start > self.limit:
                return
            say(f"{what}, frame {frame + 1} of {self.frames}")
            yield frame, walk.camera(frame, self.frames)


class Turn(NamedTuple):
    """One method tracing the rays of one kind in one frame."""

    scene: str
    view: str  # name of the walk
    sampler: str  # of AO and diffuse rays
    kind: str  # one of KINDS
    method: str
    frame: int
    rays: int
    seconds: float
    told: dict[str, float]  # by CHC+RT: seconds of PHASES, queries and pairs; of a store what came and went
    differs: int  # rays with another answer than the first method's
    error: float | None = (
        None  # mean absolute difference from its picture, 0 to 255; None unless the method neglects rays
    )


class InCore:
    """A place in memory: its triangles, and what all methods trace them by."""

    def __init__(self, place: Place, threads: int, options: Options = _OPTIONS):
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
        """CHC+RT that has seen nothing yet."""
        scheduled = Scheduled(self._parts, self._options._replace(threshold=threshold))
        return Culling(tracer_name(threshold), scheduled, self.threads)

    def plain(self) -> list[Plain]:
        """The plans that remember nothing."""
        return [Plain(plan, self._bvh, self._tree, self.threads) for plan in PLANS]

    def asked(self, camera: Camera, sampler: str) -> Asked:
        """The rays of a frame."""
        surfaces = surfaces_of(self._renderer.see(self.triangles, camera), self.triangles)
        return asked_of(self.place, camera, surfaces, sampler, self.threads)


def walk_through(
    core: InCore, walk: Walk, methods: Sequence[Method], kinds: Iterable[str], sampler: str, pace: Pace, say: Say
) -> list[Turn]:
    """The turns of all methods in a walkthrough; the first is CHC+RT as it is, which the others' answers are compared
    with. InputError if the camera sees nothing when it begins."""
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
    """A new frame begins."""
    for method in methods:
        if isinstance(method, Culling):
            method.scheduled.begin()


def told_by(method: Method) -> Callable[[], dict[str, float]]:
    """Function -> sums of what CHC+RT has told since now; nothing by other methods."""
    if not isinstance(method, Culling):
        return dict
    scheduled, first = method.scheduled, len(method.scheduled.told)

    def told() -> dict[str, float]:
        new = scheduled.told[first:]
        return {name: sum(question[name] for question in new) for name in new[0]}

    return told


def _error(asked: Asked, truth, found, method: Method, kind: str) -> float | None:
    """Mean absolute difference of two pictures of diffuse light, where a method neglects rays."""
    if not (isinstance(method, Culling) and method.scheduled.options.threshold and kind == DIFFUSE):
        return None
    colour = asked.surfaces.triangles.colour
    return error_of(*(bled(asked.surfaces, [(colour, met) for met, _ in answers]) for answers in (truth, found)))


def error_of(one: np.ndarray, other: np.ndarray) -> float:
    """Mean absolute difference of two pictures, 0 to 255."""
    return float(np.abs(one.astype(np.int16) - other).mean())


def bled(surfaces: Surfaces, met: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """(H, W, 3) uint8: what is seen, lit by the colours that its diffuse rays meet, as if all were lit alike, and by a
    white sky.

    `met`: of each pass the colours of triangles, and which of them each pixel's ray has met, or -1.
    """
    face = surfaces.gbuffer.face
    light = np.zeros((*face.shape, 3), np.float32)
    for colour, triangle in met:
        triangle = triangle.reshape(face.shape)
        light += np.where((triangle >= 0)[..., None], colour[triangle], np.float32(1.0))
    light *= surfaces.triangles.colour[face] * (face >= 0)[..., None] / np.float32(len(met))
    return to_srgb8(light, 1.0)


def times(core: InCore, pace: Pace, plain: bool, say: Say) -> list[Turn]:
    """Table 2, Table 3 and Fig. 8: rays of all kinds, near and far; `plain`: by the plans that remember nothing too."""
    turns = []
    for walk in core.place.walks:
        methods = [core.culling(), *(core.plain() if plain else [])]
        turns += walk_through(core, walk, methods, KINDS, SAMPLER, pace, say)
    return turns


def randomisation(core: InCore, pace: Pace, say: Say) -> list[Turn]:
    """Table 5: AO and diffuse rays near by, whose directions are rotated from pixel to pixel by more and more."""
    near, turns = core.place.walks[0], []
    for sampler in SAMPLERS:
        turns += walk_through(core, near, [core.culling()], (AO, DIFFUSE), sampler, pace, say)
    return turns


def aggressive(core: InCore, pace: Pace, say: Say) -> list[Turn]:
    """Table 4: diffuse rays, of which a few in each tile are neglected."""
    turns = []
    for walk in core.place.walks:
        methods = [core.culling(threshold) for threshold in THRESHOLDS]
        turns += walk_through(core, walk, methods, (DIFFUSE,), SAMPLER, pace, say)
    return turns


def of(turns: Iterable[Turn], **fields) -> list[Turn]:
    """The turns with these values, in the order of their frames."""
    return [turn for turn in turns if all(getattr(turn, name) == value for name, value in fields.items())]


def rows_of(turns: Iterable[Turn], *fields: str) -> list[dict]:
    """The values that some fields have together, in order of appearance."""
    return [dict(zip(fields, values)) for values in dict.fromkeys(tuple(getattr(t, f) for f in fields) for t in turns)]


def first(turns: list[Turn]) -> float | None:
    """Seconds of the first frame of all; None: it is not among these."""
    return next((t.seconds for t in turns if t.frame == 0), None)


def later(turns: list[Turn]) -> list[Turn]:
    """The turns after the first frame; that one if there is no other."""
    return [t for t in turns if t.frame > 0] or turns


def typical(turns: list[Turn], name: str = "seconds") -> float:
    """The median over the frames after the first: of the seconds, of something told (0 if it is not), or of "before",
    the seconds in no phase, which make cells and more."""
    return median(_value(turn, name) for turn in later(turns))


def _value(turn: Turn, name: str) -> float:
    if name == "before":
        return turn.seconds - sum(turn.told[phase] for phase in PHASES)
    return turn.seconds if name == "seconds" else turn.told.get(name, 0)


def speedup(ours: list[Turn], theirs: list[Turn]) -> float:
    """How many times as long another method takes in the frames in which it has its turn."""
    frames = {t.frame for t in later(theirs)}
    return typical(theirs) / median(t.seconds for t in ours if t.frame in frames)
