"""Measures Figures 6 and 7 and Table 2 of the report on ray hierarchies [Olsson and Assarsson 2011].

Each variant builds cones from the shadow rays of a picture, one per pixel, and traces the triangles through them. All
variants get the same rays, which are made once. Times include building the cones, but not finding the surfaces or
making the rays. Variants alternate within each round, and the median of the rounds counts; slow variants run once.
Smaller pictures predict the time of a variant, which is not run if it would take too long; predictions decide nothing
else, and no table or claim contains them.
"""

from collections.abc import Iterable, Sequence
from functools import partial
from statistics import fmean, geometric_mean, median, pstdev
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.errors import InputError
from ....base.progress import clock_seconds
from ....engine.accelerator import Accelerator
from ....engine.auto_accelerator import accelerator_of
from ....engine.plan import parse_plan
from ....engine.plan_records import precompile_plan
from ....engine.primary_visibility import RASTER
from ....picture.frame_request import PictureQueries, TimeSample, build_for, picture_queries
from ....picture.render_options import RenderOptions
from ....query.shadow_query import ray_count
from ....trace.counters import as_dict, new_counters
from ...bench_parts import BenchParts
from ..bench_runner import Say, interleave
from ..benchmark_views import digest
from . import ray_hierarchy_published
from .cone_hierarchy import with_culling
from .ray_hierarchy_published import VARIANTS, RayHierarchyTable
from .ray_hierarchy_views import MUSEUM, WALL_PICTURE, PictureCase

# --- Pictures ---------------------------------------------------------------------------------------------------------


OURS, BEST = "cones", "PreciseSorted"
PLANS = {OURS: "cones", **{name: f"cones:{name}" for name in VARIANTS}}
"""Variant -> plan: our variant, then those of Table 1."""

CULLING_PLANS = {OURS: "cones", **{name: with_culling(name) for name in VARIANTS}}
"""The same with face culling: all drop culled faces before the traversal."""

REFERENCE = "lbvh+single"
"""All variants must return the bits of this plan."""

SHRINK = (8, 4)
"""Divisors of the width and height for the smaller pictures, which are traced first. The prediction assumes that each
doubling multiplies seconds by the same factor as between these two, but by no more than the rays."""

_SMALL = 16, 16  # pixels of the picture that loads the kernels where there are no predictions

SLOW = 3.0
"""Seconds in one picture above which a variant is not repeated in further rounds."""


class PictureRays(NamedTuple):
    """The shadow rays of a picture."""

    picture: str
    of: str  # name of the scene
    frame: int | None  # number within its animation
    triangles: int
    rays: int
    blocked: int
    bits: bytes  # digest of the answer of REFERENCE


class Cost(NamedTuple):
    """The cost of one variant in one picture; None if it was not run because it would have taken too long."""

    picture: str
    variant: str  # a key of PLANS
    nodes: int | None = None  # tested pairs of a triangle and a cone
    passed: int | None = None  # tested pairs with a possible intersection
    tests: int | None = None  # ray tests of up to 16 rays
    seconds: float | None = None  # to build the cones and trace the triangles
    bits: bytes | None = None  # digest of the answer
    rounds: int | None = None  # how often it was measured


class Effort(NamedTuple):
    """How much to measure."""

    threads: int
    rounds: int
    limit: float | None  # maximum seconds per variant and picture; None: all variants are run
    cull_faces: str | None = None  # triangle side, as seen from the receiver, that does not block; published: "back"


class Answer(NamedTuple):
    """One variant's answer to the shadow rays of a picture."""

    seconds: float
    counters: dict[str, int]
    bits: NDArray[np.uint64]


def _answer(accelerator: Accelerator, rays: PictureQueries) -> Answer:
    (query,), tally = rays.queries, new_counters()
    accelerator.begin(ray_count(query))
    accelerated = build_for(accelerator, rays)
    start = clock_seconds()
    bits = accelerator.answer(accelerated, query, tally)
    return Answer(clock_seconds() - start, as_dict(tally), bits)


def measure(picture: PictureCase, effort: Effort, say: Say) -> tuple[PictureRays, list[Cost]]:
    """Measure all variants in one picture; InputError if its camera sees nothing."""
    plans = PLANS if effort.cull_faces is None else CULLING_PLANS
    variants = {name: accelerator_of(parse_plan(plan), effort.threads) for name, plan in plans.items()}
    options = RenderOptions(spp=1, cull_faces=effort.cull_faces)
    for plan in (REFERENCE, *plans.values()):
        precompile_plan(parse_plan(plan), RASTER, True)

    def rays_at(width: int, height: int) -> PictureQueries:
        say(f"{picture.name}, surfaces, {width} x {height}")
        moment = TimeSample(picture.time, picture.camera.resized(width, height), [picture.light])
        return picture_queries(picture.scene, moment, options, effort.threads)

    def answer(name: str, rays: PictureQueries) -> Answer:
        height, width = rays.gbuffer.face.shape
        say(f"{picture.name}, {name}, {width} x {height}")
        return _answer(variants[name], rays)

    size, limit = (picture.camera.width, picture.camera.height), effort.limit
    rays = rays_at(*size)
    truth = _answer(accelerator_of(parse_plan(REFERENCE), effort.threads), rays)
    if not ray_count(rays.queries[0]):
        raise InputError(f"{picture.name}: the camera sees nothing; choose a scene whose camera sees something")
    smaller = [_SMALL] if limit is None else [(max(size[0] // n, 1), max(size[1] // n, 1)) for n in SHRINK]
    few = [rays_at(*each) for each in smaller]
    first_answers = {name: [answer(name, each) for each in few] for name in variants}
    if limit is not None:
        variants = {name: a for name, a in variants.items() if _predicted(*first_answers[name]) <= limit}

    first: dict[str, Cost] = {}

    def seconds(name: str, turn: int) -> float | None:
        if turn and (first[name].seconds or 0.0) > SLOW:
            return None
        answered = answer(name, rays)
        first.setdefault(name, _cost(picture.name, name, answered))
        return answered.seconds

    laps = interleave(variants, effort.rounds, seconds)
    costs = [
        first[name]._replace(seconds=median(laps[name]), rounds=len(laps[name]))
        if name in first
        else Cost(picture.name, name)
        for name in plans
    ]
    return _picture_rays(picture, rays, truth), costs


def _cost(picture: str, variant: str, answer: Answer) -> Cost:
    nodes, passed, tests = (answer.counters[name] for name in ("nodes", "candidates", "triangle_tests"))
    return Cost(picture, variant, nodes, passed, tests, answer.seconds, digest([answer.bits]))


def _predicted(smallest: Answer, small: Answer) -> float:
    """Predict the seconds of the full picture from two smaller ones."""
    doublings = np.log2(SHRINK[1]) / np.log2(SHRINK[0] / SHRINK[1])
    growth = (small.counters["nodes"] / max(smallest.counters["nodes"], 1)) ** doublings
    return float(min(growth, SHRINK[1] ** 2) * small.seconds)


def _picture_rays(picture: PictureCase, rays: PictureQueries, truth: Answer) -> PictureRays:
    blocked, count = int(np.bitwise_count(truth.bits).sum()), ray_count(rays.queries[0])
    fields = picture.name, picture.of, picture.frame, picture.scene.n_triangles
    return PictureRays(*fields, count, blocked, digest([truth.bits]))


class Measured(NamedTuple):
    """The shadow rays of several pictures, and the costs of all variants in each."""

    pictures: list[PictureRays]
    costs: list[Cost]

    def of(self, picture: str, variant: str) -> Cost:
        """The cost of a variant in a picture."""
        return next(c for c in self.costs if (c.picture, c.variant) == (picture, variant))

    def pairs(self, one: str, other: str, among: Iterable[str] | None = None) -> list[tuple[Cost, Cost]]:
        """The costs of two variants in each picture where both were run; `among`: these pictures only."""
        names = [s.picture for s in self.pictures] if among is None else among
        both = ((self.of(name, one), self.of(name, other)) for name in names)
        return [(a, b) for a, b in both if a.nodes is not None and b.nodes is not None]

    def answers(self) -> list[tuple[str, bytes]]:
        """(picture, digest) of all answers, for `papers.benchmark_views.agree`."""
        theirs = [(c.picture, c.bits) for c in self.costs if c.bits is not None]
        return [(s.picture, s.bits) for s in self.pictures] + theirs


def measure_all(pictures: Sequence[PictureCase], effort: Effort, say: Say) -> Measured:
    """`measure` several pictures."""
    return joined([Measured([rays], costs) for rays, costs in (measure(each, effort, say) for each in pictures)])


def joined(several: Iterable[Measured]) -> Measured:
    """The pictures of several measurements, frames of films in their order."""
    each = list(several)
    pictures = sorted((s for one in each for s in one.pictures), key=lambda s: s.frame or 0)
    return Measured(pictures, [c for one in each for c in one.costs])


# --- Parts ------------------------------------------------------------------------------------------------------------


ROWS = Measured, PictureRays, Cost
"""The rows in parts."""


def add_pictures(
    parts: BenchParts, table: RayHierarchyTable, pictures: Sequence[PictureCase], effort: Effort, say: Say
) -> None:
    """Measure pictures, or frames of a film, one in each part, so that a film can get further frames."""
    for each in pictures:
        measured = partial(measure_all, [each], effort, say)
        parts.add(table, each.name, measured, triangles=each.scene.n_triangles, time=each.time)


# --- Comparisons ------------------------------------------------------------------------------------------------------


class RelativeCost(NamedTuple):
    """A variant's nodes and time relative to BEST, as medians over the pictures of a scene."""

    of: str
    variant: str
    pictures: int
    nodes: float
    passed: float
    seconds: float


class Spread(NamedTuple):
    """A variant over the frames of an animation."""

    of: str
    variant: str
    frames: int
    nodes: float  # tested, median
    most_nodes: int  # tested
    passed: float  # median
    median: float  # seconds
    ratio: float  # longest / shortest
    quartiles: float  # third quartile - first quartile, seconds
    deviation: float  # standard deviation / mean


class Claim(NamedTuple):
    """A ratio that the report states, and ours."""

    text: str
    published: float
    ours: float
    picture: str  # where our ratio was measured


def fewest(measured: Measured, picture: str, among: Iterable[str]) -> str:
    """The first variant that tests the fewest nodes; "" if none was run."""
    ran = [c for c in (measured.of(picture, variant) for variant in among) if c.nodes is not None]
    return min(ran, key=lambda c: c.nodes or 0).variant if ran else ""


def relative_costs(measured: Measured, variants: Iterable[str]) -> list[RelativeCost]:
    """The variants of Figure 7 relative to BEST, for each scene, over the pictures where both were run."""
    rows = []
    for name in dict.fromkeys(s.of for s in measured.pictures):
        names = [s.picture for s in measured.pictures if s.of == name]
        for variant in variants:
            if both := measured.pairs(variant, BEST, names):
                ratios = (median(_ratio(a, b, field) for a, b in both) for field in ("nodes", "passed", "seconds"))
                rows.append(RelativeCost(name, variant, len(both), *ratios))
    return rows


def _ratio(one: Cost, other: Cost, field: str) -> float:
    return float(getattr(one, field) / (getattr(other, field) or 1))


def spreads(film: Measured) -> list[Spread]:
    """The spread of each variant in each animation with at least two frames; `film`: its frames, all run."""
    rows = []
    for name in dict.fromkeys(s.of for s in film.pictures):
        frames = [s.picture for s in film.pictures if s.of == name]
        for variant in PLANS if len(frames) > 1 else ():
            costs = [film.of(picture, variant) for picture in frames]
            nodes, passed, seconds = ([getattr(c, f) for c in costs] for f in ("nodes", "passed", "seconds"))
            quarter, most = np.percentile(seconds, (25, 75)).tolist()
            shares = median(seconds), max(seconds) / min(seconds), most - quarter, pstdev(seconds) / fmean(seconds)
            rows.append(Spread(name, variant, len(frames), median(nodes), max(nodes), median(passed), *shares))
    return rows


def never_more(film: Measured, one: str, other: str) -> tuple[int, int]:
    """(frames where `one` tests no more nodes than `other`, frames)."""
    both = film.pairs(one, other)
    return sum((a.nodes or 0) <= (b.nodes or 0) for a, b in both), len(both)


def claims(measured: Measured) -> list[Claim]:
    """The report's ratios beside ours: of its Table 2 beside the museum, and of its text beside the robots' wall.

    Ratios of nodes are of those passed, as in the report (see `ray_hierarchy_published.WALL_NODES`). A ratio is left
    out unless all variants that it needs were run in all pictures that it needs.
    """
    rows = [claim for kind in ("Spheres", "Precise") for claim in _sorting_claims(measured, kind)]
    for suffix, rays in (("", "in image order"), ("Sorted", "sorted")):
        slow, fast = f"Spheres{suffix}", f"Precise{suffix}"
        theirs = geometric_mean(ray_hierarchy_published.ratios(slow, fast))
        if both := _museum(measured, slow, fast):
            ours = geometric_mean([_ratio(a, b, "passed") for a, b in both])
            rows.append(Claim(f"precise test: fewer nodes, rays {rays}", theirs, ours, "museum, mean of four views"))
    walls = [s.picture for s in measured.pictures if s.picture == WALL_PICTURE]
    for a, b in measured.pairs("Spheres", "Precise", walls):
        theirs = ray_hierarchy_published.WALL_NODES["Spheres"] / ray_hierarchy_published.WALL_NODES["Precise"]
        rows.append(Claim("precise test: fewer nodes at a wall", theirs, _ratio(a, b, "passed"), a.picture))
    return rows


def _sorting_claims(measured: Measured, kind: str) -> list[Claim]:
    """The largest reductions of nodes and of time by sorting, in the views of the museum."""
    rows, both = [], _museum(measured, kind, f"{kind}Sorted")
    for what, field, table in (
        ("fewer nodes", "passed", ray_hierarchy_published.NODES),
        ("less time", "seconds", ray_hierarchy_published.MILLISECONDS),
    ):
        if both:
            ours, picture = max((_ratio(a, b, field), a.picture) for a, b in both)
            rows.append(
                Claim(
                    f"sorting, {kind}: {what}",
                    max(ray_hierarchy_published.ratios(kind, f"{kind}Sorted", table)),
                    ours,
                    picture,
                )
            )
    return rows


def _museum(measured: Measured, one: str, other: str) -> list[tuple[Cost, Cost]]:
    """The costs of two variants in all views of the museum; empty unless both were run in all of them."""
    names = [s.picture for s in measured.pictures if s.of == MUSEUM]
    both = measured.pairs(one, other, names)
    return both if len(both) == len(names) else []
