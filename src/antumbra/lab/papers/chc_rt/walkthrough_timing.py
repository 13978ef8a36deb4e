"""Measures walkthroughs of 60 frames in memory [Mattausch et al. 2015, Sec. 7].

The methods alternate within each frame, trace the same rays, and have their answers compared. CHC+RT traces every
frame, because it keeps state from the previous one; the other methods are stateless and trace only some frames.

`store_walkthroughs` measures them out of core.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ....base.errors import InputError
from ....bvh.block_tree import block_tree
from ....engine.plan import parse_plan
from ....engine.plan_records import precompile_plan
from ....engine.precompilation import precompile
from ....picture.image_files import to_srgb8
from ....picture.renderer import Renderer
from ....query.light_samples import ROTATIONS
from ....query.shadow_query import Surfaces, surfaces_of
from ....scene.camera import Camera
from ....techniques.chcrt.chc_rt import ChcRtState
from ....techniques.chcrt.tree_parts import TreeParts, parts_of
from ....techniques.tracer_options import ChcRtOptions
from ..bench_runner import Say
from ..published_methods import THRESHOLDS, tracer_name
from .walkthroughs import (
    AO,
    DIFFUSE,
    KINDS,
    ONE_PART,
    SAMPLER,
    SINGLE,
    TRACERS,
    Answer,
    Culling,
    FrameRays,
    Method,
    Plain,
    Walk,
    WalkPlace,
    differing,
    frame_rays,
    plan_of,
    timed,
)

# --- Walkthroughs in memory -------------------------------------------------------------------------------------------


CHCRT = tracer_name(0)
SAMPLERS = tuple(name for name in ROTATIONS if ":" in name)
"""The samplers of Table 5: directions are rotated between pixels by 0, 18 and 36 degrees, or fully."""

PHASES = ("phase 1", "phase 2", "phase 3")
_TILES, _PARTS = 8, 16  # least numbers of tiles and of parts, so that small scenes and images also have pairs to query
_SMALL = 64, 36  # pixels of the frame that warms up


_SHARE = 3  # further walkthroughs get 1 / _SHARE of the time limit
LEAST = 2
"""Frames of a walkthrough that always run: the first, and one that continues its state."""


class Pace(NamedTuple):
    """The length of a walkthrough."""

    frames: int  # frames of the whole walkthrough
    compared: int  # frames after the first that the stateless methods trace
    limit: float  # seconds after which no further frame begins; the first LEAST always do
    most: int = 10_000  # frames after which the walkthrough is cut short

    def takes_part(self, method: Method, frame: int) -> bool:
        """Whether a method traces a frame: CHC+RT all, the others some after the first."""
        return isinstance(method, Culling) or 0 < frame <= self.compared or self.frames == 1

    def shorter(self) -> "Pace":
        """The pace of further tables, whose walkthroughs get a share of the time."""
        return self._replace(limit=self.limit / _SHARE)

    def along(self, walk: Walk, what: str, say: Say) -> Iterator[tuple[int, Camera]]:
        """Yield (frame, camera) until the time limit, and report each frame to `say`."""
        start = perf_counter()
        for frame in range(min(self.frames, self.most)):
            if frame >= LEAST and perf_counter() - start > self.limit:
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


def options_of(place: WalkPlace) -> ChcRtOptions:
    """The options of CHC+RT for a scene: the default ones, or smaller tiles and parts if there would be too few."""
    camera, options = place.walks[0].first, ChcRtOptions()
    n_tiles = lambda side: -(-camera.width // side) * -(-camera.height // side)
    tile = next((side for side in (options.tile, 64) if n_tiles(side) >= _TILES), 32)
    return options._replace(tile=tile, triangles=min(options.triangles, max(place.scene.n_triangles // _PARTS, 1)))


class InCore:
    """A scene in memory: its triangles, and the acceleration structures of all methods."""

    def __init__(self, place: WalkPlace, threads: int, options: ChcRtOptions | None = None):
        options = options or options_of(place)
        self.place, self.threads, self._options = place, threads, options
        for tracer in (*TRACERS, CHCRT):
            precompile_plan(parse_plan(plan_of(tracer)), "rays")
        precompile("light that bounces (rays)")
        self._renderer = Renderer(place.scene, plan_of(SINGLE), threads)
        accelerated = self._renderer.accelerate()
        assert accelerated.bvh is not None
        self.triangles, self._bvh = accelerated.triangles, accelerated.bvh
        self._tree = block_tree(self._bvh, threads)
        self._parts = parts_of(self._tree, options)

    def culling(self, threshold: int = 0) -> Culling:
        """CHC+RT in its initial state."""
        return self.culling_by(tracer_name(threshold), {"threshold": threshold})

    def culling_by(self, name: str, changed: dict[str, Any]) -> Culling:
        """CHC+RT with some options changed, under another name; "build" names another builder of the tree."""
        return Culling(name, ChcRtState(self._parts_by(**changed), self._options_by(**changed)), self.threads)

    def _options_by(self, build: str | None = None, **changed: Any) -> ChcRtOptions:
        return self._options._replace(**changed)

    def _parts_by(self, build: str | None = None, **changed: Any) -> TreeParts:
        if not (build or {"triangles", "height"} & changed.keys()):
            return self._parts
        bvh = Renderer(self.place.scene, f"{build}+{SINGLE}", self.threads).accelerate().bvh if build else None
        return parts_of(block_tree(bvh, self.threads) if bvh else self._tree, self._options_by(**changed))

    def bytes(self) -> tuple[int, int]:
        """Bytes of (BVH nodes, triangles) that CHC+RT traces."""
        tree = self._tree
        geometry = tree.blocks, tree.bounds, tree.slots, tree.prim_ids, tree.corners, self.triangles.colour
        return tree.nodes.nbytes, sum(array.nbytes for array in geometry)

    def plain(self) -> list[Plain]:
        """The stateless tracers."""
        whole = parts_of(self._tree, ONE_PART)
        return [Plain(name, self._bvh, self._tree, self.threads, whole) for name in TRACERS]

    def frame_rays(self, camera: Camera, sampler: str) -> FrameRays:
        """The rays of a frame."""
        surfaces = surfaces_of(self._renderer.see(self.triangles, camera), self.triangles)
        return frame_rays(self.place, camera, surfaces, sampler, self.threads)


def walk_through(
    core: InCore, walk: Walk, methods: Sequence[Method], kinds: Sequence[str], sampler: str, pace: Pace, say: Say
) -> list[Turn]:
    """The turns of all methods in a walkthrough; InputError if the camera of the first frame sees nothing.

    The first method is exact CHC+RT; the answers of the others are compared with its answers. All methods first trace a
    small frame, whose times do not count: it loads their kernels.
    """
    _warm_up(core, walk, methods, kinds, sampler)
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


def _warm_up(core: InCore, walk: Walk, methods: Sequence[Method], kinds: Sequence[str], sampler: str) -> None:
    """Trace a small frame by all methods."""
    rays = core.frame_rays(walk.first.resized(*_SMALL), sampler)
    begin(methods)
    for kind in kinds:
        for method in methods:
            if kind in method.kinds:
                timed(method, rays, kind)


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


Digests = list[tuple[str, bytes]]
"""(query, digest) of answers, for `papers.benchmark_views.agree`."""


class Walked(NamedTuple):
    """What a walkthrough measured."""

    turns: list[Turn]
    digests: Digests
    compared: bool = False  # whether the turns count differing answers


Walks = Iterable[tuple[str, Callable[[], Walked]]]
"""Names of walkthroughs, and functions that measure them. Nothing is built before one is called."""


def times(place: WalkPlace, core: Callable[[], InCore], pace: Pace, say: Say) -> Walks:
    """Table 2, Table 3 and Fig. 8: all ray kinds, near and far."""
    for walk in place.walks:
        yield walk.name, partial(_walked, core, walk, None, KINDS, SAMPLER, pace, say)


def randomisation(place: WalkPlace, core: Callable[[], InCore], pace: Pace, say: Say) -> Walks:
    """Table 5: AO and diffuse rays in the near walk, with growing rotations between pixels."""
    for sampler in SAMPLERS:
        yield sampler, partial(_walked, core, place.walks[0], (0,), (AO, DIFFUSE), sampler, pace.shorter(), say)


def aggressive(place: WalkPlace, core: Callable[[], InCore], pace: Pace, say: Say) -> Walks:
    """Table 4: diffuse rays in aggressive mode."""
    for walk in place.walks:
        yield walk.name, partial(_walked, core, walk, THRESHOLDS, (DIFFUSE,), SAMPLER, pace.shorter(), say)


def _walked(
    core: Callable[[], InCore],
    walk: Walk,
    thresholds: Sequence[int] | None,
    kinds: Sequence[str],
    sampler: str,
    pace: Pace,
    say: Say,
) -> Walked:
    """A walkthrough by CHC+RT with these thresholds; None: by exact CHC+RT and the stateless tracers."""
    built = core()
    methods: list[Method] = [built.culling(threshold) for threshold in thresholds or (0,)]
    methods += built.plain() if thresholds is None else []
    return Walked(walk_through(built, walk, methods, kinds, sampler, pace, say), [], compared=True)


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


def speedups(turns: list[Turn], method: str = SINGLE) -> dict[str, list[float]]:
    """The speedups of CHC+RT over a method that traces from the root: those of each scene and view, by ray kind."""
    return {
        row["kind"]: [
            speedup(of(mine, method=CHCRT), plain)
            for walk in rows_of(turns, "scene", "view")
            if (plain := of(mine := of(turns, **walk, **row), method=method))
        ]
        for row in rows_of(turns, "kind")
    }
