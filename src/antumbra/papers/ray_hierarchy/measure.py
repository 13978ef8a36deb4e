"""Measures Figures 6 and 7 and Table 2 of the report on ray hierarchies [Olsson and Assarsson 2011].

Each variant makes cones from the shadow rays of a picture, one for each pixel, and traces the triangles through them.
Times are of the phase `trace` of a frame, which includes making the cones. Variants take turns within each round. The
median of the rounds counts. Smaller pictures predict the time of a variant; if it is too long, the variant is left out.
"""

from collections.abc import Callable, Iterable
from statistics import fmean, median, pstdev
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ...rendering.frame import Frame
from ...rendering.renderer import Renderer
from ..answers import digest
from .published import VARIANTS
from .variants import with_culling
from .views import Picture

OURS, BEST = "cones", "PreciseSorted"
PLANS = {OURS: "cones", **{name: f"cones:{name}" for name in VARIANTS}}
"""Variant -> plan: our variant, then those of Table 1 by the report's names."""

CULLING_PLANS = {OURS: "cones", **{name: with_culling(name) for name in VARIANTS}}
"""The same, if faces are culled: all drop culled faces before the traversal."""

REFERENCE = "lbvh+single"
"""All variants must have the bits of this plan."""

SHRINK = (8, 4)
"""Divisors of the width and the height for the smaller pictures, which are traced first. The prediction assumes that
nodes and seconds grow with every doubling by the same factor as between these two, but not faster than the rays."""


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
    """The cost of one variant in one picture. None: it was left out, because it would have taken too long."""

    picture: str
    variant: str  # a key of PLANS
    predicted: float  # seconds, predicted from smaller pictures
    predicted_nodes: float
    nodes: int | None = None  # pairs of a triangle and a cone that were tested
    tests: int | None = None  # ray tests, of up to 16 rays each
    seconds: float | None = None  # time of the phase `trace`
    bits: bytes | None = None  # digest of the answer
    passed: int | None = None  # tested pairs that may meet


class Beside(NamedTuple):
    """Medians over the pictures of a scene: how many times the nodes and the time of BEST a variant takes."""

    of: str
    variant: str
    pictures: int
    nodes: float
    passed: float
    seconds: float


class Spread(NamedTuple):
    """The variation of the times of one variant over the frames of an animation."""

    of: str
    variant: str
    frames: int  # frames that were measured
    missing: int  # frames that were left out
    median: float
    ratio: float  # longest / shortest
    quartiles: float  # third quartile - first quartile
    deviation: float  # standard deviation / mean


def measure(
    picture: Picture, threads: int, rounds: int, limit: float, say: Callable[[str], None], cull_faces: str | None = None
) -> tuple[PictureRays, list[Cost]]:
    """Measure all variants in one picture; InputError if its camera sees nothing.

    limit : the most seconds that a variant may take
    cull_faces : the side of triangles, seen from a receiver, that does not block; "back" is as published
    """
    plans = PLANS if cull_faces is None else CULLING_PLANS
    renderers = {name: Renderer(picture.scene, plan, threads) for name, plan in plans.items()}

    def trace(name: str, renderer: Renderer, shrink=1, counters=False) -> Frame:
        camera = picture.camera.resized(*(max(n // shrink, 1) for n in (picture.camera.width, picture.camera.height)))
        say(f"{picture.name}, {name}, {camera.width} x {camera.height}")
        asked = {"spp": 1, "time": picture.time, "counters": counters, "cull_faces": cull_faces}
        return renderer.render(camera, [picture.light], **asked)

    frame = trace(REFERENCE, Renderer(picture.scene, REFERENCE, threads))
    if not frame.rays:
        raise InputError(f"{picture.name}: the camera sees nothing; choose a scene whose camera sees something")
    seen = _seen(picture, frame)
    predicted = {n: _predicted(*(trace(n, r, part, True) for part in SHRINK)) for n, r in renderers.items()}
    counted = {n: trace(n, r, counters=True) for n, r in renderers.items() if predicted[n][0] <= limit}
    laps: dict[str, list[float]] = {name: [] for name in counted}
    for turn in range(rounds):
        for name, first in counted.items():
            if turn == 0 or (turn + 1) * first.timings["trace"] <= limit:  # slow variants have one round
                laps[name].append(trace(name, renderers[name]).timings["trace"])
    costs = []
    for name in PLANS:
        cost = Cost(picture.name, name, *predicted[name])
        if name in counted:
            nodes, passed, tests = _counts(counted[name])
            cost = cost._replace(nodes=nodes, passed=passed, tests=tests)
            cost = cost._replace(seconds=median(laps[name]), bits=digest(counted[name].bits))
        costs.append(cost)
    return seen, costs


def _counts(frame: Frame) -> tuple[int, int, int]:
    """(nodes, passed, tests) from a frame's counters."""
    assert frame.counters is not None
    return frame.counters["nodes"], frame.counters["candidates"], frame.counters["triangle_tests"]


def _predicted(smallest: Frame, small: Frame) -> tuple[float, float]:
    """Predict (seconds, nodes) of the full picture from two smaller ones."""
    nodes = _counts(small)[0]
    doublings = np.log2(SHRINK[1]) / np.log2(SHRINK[0] / SHRINK[1])
    growth = min((nodes / max(_counts(smallest)[0], 1)) ** doublings, SHRINK[1] ** 2)
    return float(growth * small.timings["trace"]), float(growth * nodes)


def _seen(picture: Picture, frame: Frame) -> PictureRays:
    blocked = int(np.bitwise_count(frame.bits[0]).sum())
    shown = picture.name, picture.of, picture.frame, picture.scene.n_triangles
    return PictureRays(*shown, frame.rays, blocked, digest(frame.bits))


def answers(seen: Iterable[PictureRays], costs: Iterable[Cost]) -> list[tuple[str, bytes]]:
    """(picture, digest) of all answers, for `papers.answers.agree`."""
    return [(s.picture, s.bits) for s in seen] + [(c.picture, c.bits) for c in costs if c.bits is not None]


def of(costs: Iterable[Cost], picture: str, variant: str) -> Cost:
    """The cost of a variant in a picture."""
    return next(c for c in costs if (c.picture, c.variant) == (picture, variant))


def fewest(costs: Iterable[Cost], picture: str, among: Iterable[str]) -> str:
    """The variant that visits the fewest nodes, the first one of equals; "" if all were left out."""
    costs = list(costs)
    found = [c for c in (of(costs, picture, variant) for variant in among) if c.nodes is not None]
    return min(found, key=lambda c: c.nodes or 0).variant if found else ""


def cut(
    costs: Iterable[Cost], unsorted: str, sorted_: str, fields: tuple[str, str] = ("nodes", "predicted_nodes")
) -> tuple[float, str, bool]:
    """The largest reduction of nodes, or of another field, by sorting, as (ratio, picture, measured).

    `measured` is False if the unsorted variant was left out, so that its nodes are predicted. The result is
    (nan, "", False) if the sorted variant visited no node.

    fields : names of the measured and of the predicted field
    """
    costs, found, (field, predicted) = list(costs), [], fields
    for a in (c for c in costs if c.variant == unsorted):
        b = getattr(of(costs, a.picture, sorted_), field)
        if b:
            value = getattr(a, predicted if a.nodes is None else field)
            found.append((value / b, a.picture, a.nodes is not None))
    return max(found, default=(np.nan, "", False))


def beside(seen: Iterable[PictureRays], costs: Iterable[Cost], variants: Iterable[str]) -> list[Beside]:
    """The variants of Figure 7 beside BEST, for each scene, over the pictures where both were measured."""
    seen, costs, rows = list(seen), list(costs), []
    for name in dict.fromkeys(s.of for s in seen):
        pictures = [s.picture for s in seen if s.of == name]
        for variant in variants:
            pairs = [(of(costs, p, variant), of(costs, p, BEST)) for p in pictures]
            both = [(a, b) for a, b in pairs if a.nodes and b.nodes]
            if both:
                ratios = [
                    median(getattr(a, f) / max(getattr(b, f), 1e-9) for a, b in both)
                    for f in ("nodes", "passed", "seconds")
                ]
                rows.append(Beside(name, variant, len(both), *ratios))
    return rows


def spreads(seen: Iterable[PictureRays], costs: Iterable[Cost]) -> list[Spread]:
    """The spreads of each animation with at least two frames, and of each variant that was measured in two of them."""
    seen, costs, rows = list(seen), list(costs), []
    for name in dict.fromkeys(s.of for s in seen if s.frame is not None):
        frames = [s.picture for s in seen if s.of == name]
        for variant in PLANS:
            every = [of(costs, picture, variant).seconds for picture in frames]
            some = [s for s in every if s is not None]
            if len(some) > 1:
                quarter, most = np.percentile(some, (25, 75)).tolist()
                shares = median(some), max(some) / min(some), most - quarter, pstdev(some) / fmean(some)
                rows.append(Spread(name, variant, len(some), len(every) - len(some), *shares))
    return rows
