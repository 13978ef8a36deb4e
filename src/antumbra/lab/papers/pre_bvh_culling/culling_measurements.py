"""Measures the pre-BVH culling paper [Selgrad et al. 2015, Tables 1 to 4, Fig. 2 to 7].

As in the paper, time to image covers culling, building and tracing, but not the G-buffer and shading. All methods use
the same tracer and alternate within each round; the median of the rounds counts.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ....base.errors import InputError
from ....base.progress import clock_seconds
from ....engine.accelerator import Accelerator
from ....picture.frame import Frame
from ....picture.renderer import Renderer
from ....query.light_samples import light_samples
from ....query.shadow_query import ShadowQuery, shadow_queries
from ....scene.triangles import Triangles
from ....techniques.culling.pre_bvh_culling import HULLS, STEPS, CullResult, MarkingMethod, cull
from ...bench_conditions import record_laps
from ...bench_parts import BenchParts
from ..bench_runner import Say, interleave, medians, round_text
from ..benchmark_views import digest
from .cell_marking import LINES
from .convex_region import CONVEX
from .culling_published import CullingTable
from .culling_views import CullingView

METHODS = {
    "LBVH": "lbvh",
    "LBVH culled": "grid32:paper+lbvh",
    "LBVH, grid32": "grid32+lbvh",
    "TL-LBVH": "tl-lbvh",
    "TL-LBVH culled": "grid32:paper+tl-lbvh",
    "TL-LBVH, grid32": "grid32+tl-lbvh",
    "BSAH": "bsah",
    "BSAH culled": "grid32:paper+bsah",
    "BSAH, grid32": "grid32+bsah",
}
"""Method -> culler and builder of a plan. Names without grid32 are the paper's, and "culled" is its own marking."""

SAMPLES = (1, 10, 100)
"""Samples per pixel and light in Table 3."""

FIGURE_SAMPLES = 15
"""Samples per pixel and light in Fig. 3 to 6."""

FIGURE_METHODS = ("LBVH", "LBVH culled", "LBVH, grid32")
"""Methods that are timed with these samples."""

PUBLISHED, OURS, REGION = "as published", "hulls", "convex region"
MARKINGS = {PUBLISHED: LINES, OURS: HULLS, REGION: CONVEX}
"""Name -> marking method. The convex region is that of Fig. 2b."""

USUAL = {PUBLISHED: (32,), OURS: (32,), REGION: (32,)}
"""Marking -> grids of Tables 1 and 2, and of Fig. 2."""

VIDEO = {PUBLISHED: (16, 32, 64), OURS: (16, 32, 64, 128, 256)}
"""Marking -> grids of Table 4 in every frame."""

FINEST = (128, 256)
"""Further grids that are marked as published, in the first frame only: walking their lines takes seconds."""

BUILDERS = ("lbvh", "tl-lbvh")


class TimeToImage(NamedTuple):
    """Seconds of one method in one view."""

    figure: str
    tracer: str
    method: str  # a key of METHODS
    gbuffer: float
    shade: float
    cull: float
    build: float
    trace: dict[int, float]  # samples -> seconds, without sample counts that take too long
    remaining: float  # share of the triangles in the BVH
    bits: bytes  # digest of the answer

    def total(self, spp: int) -> float | None:
        """Seconds of culling, building and tracing; None if not measured."""
        return self.cull + self.build + self.trace[spp] if spp in self.trace else None


class GridRow(NamedTuple):
    """One grid in one view: seconds, and share of remaining triangles."""

    figure: str
    grid: int  # cells per axis; 0: no culling
    marked: str  # a key of MARKINGS; empty: no culling
    remaining: float  # share of remaining triangles
    steps: dict[str, float]  # step of STEPS -> seconds
    build: dict[str, float]  # builder+tracer -> seconds; empty if not measured
    trace: dict[str, float]  # builder+tracer -> seconds with one sample
    views: int = 1  # number of views; over one: means


class CullingEffort(NamedTuple):
    """How much to measure."""

    threads: int
    rounds: int
    limit: float  # in seconds; sample counts predicted to take longer per picture are skipped
    say: Say


class _MethodLap(NamedTuple):
    """One round of one method."""

    timings: dict[int, dict[str, float]]  # samples -> phase -> seconds
    bits: bytes  # digest of the answers with all sample counts


def times_to_image(view: CullingView, tracer: str, effort: CullingEffort) -> list[TimeToImage]:
    """Measure Tables 1 to 3 for one view and tracer; InputError if its camera sees nothing."""
    pictures = {m: _Pictures(view, f"{part}+{tracer}", effort) for m, part in METHODS.items()}
    samples = pictures["LBVH"].affordable_samples()

    def measure(method: str, turn: int) -> _MethodLap:
        frames = {}
        for spp in samples if turn >= 0 else samples[:1]:
            effort.say(f"{view.figure}, {method}, {tracer}, {spp} samples, {round_text(turn, effort.rounds)}")
            frames[spp] = pictures[method].render(spp)
        bits = digest(bits for frame in frames.values() for bits in frame.bits)
        return _MethodLap({spp: frame.timings for spp, frame in frames.items()}, bits)

    laps = interleave(METHODS, effort.rounds, measure, warm_up=1)
    remaining = remaining_shares(view, effort.threads)
    return [_time_to_image(view.figure, tracer, method, each, remaining) for method, each in laps.items()]


def _time_to_image(
    figure: str, tracer: str, method: str, laps: Sequence[_MethodLap], remaining: Mapping[str, float]
) -> TimeToImage:
    """The medians of a method's rounds; `remaining`: marking -> share of the triangles."""
    times = [lap.timings for lap in laps]
    gbuffer, shade, culling, build = (
        median(phases[phase] for lap in times for phases in lap.values())
        for phase in ("gbuffer", "shade", "cull", "build")
    )
    trace = {spp: median(lap[spp]["trace"] for lap in times) for spp in times[0]}
    marked = PUBLISHED if "culled" in method else OURS
    share = remaining[marked] if METHODS[method].startswith("grid") else 1.0
    return TimeToImage(figure, tracer, method, gbuffer, shade, culling, build, trace, share, laps[0].bits)


class _Pictures:
    """Pictures of a view by one plan. Each has a renderer of its own, which keeps no tree of an earlier picture."""

    def __init__(self, view: CullingView, plan: str, effort: CullingEffort):
        self._view, self._plan, self._effort = view, plan, effort

    def render(self, spp: int) -> Frame:
        """A picture; InputError if the camera sees nothing."""
        view = self._view
        renderer = Renderer(view.scene, self._plan, self._effort.threads)
        frame = renderer.render(view.camera, view.lights, spp=spp, time=view.time)
        if not frame.rays:
            raise InputError(f"{view.figure}: the camera sees nothing; give Crytek's Sponza, in centimetres")
        return frame

    def affordable_samples(self) -> list[int]:
        """The first of SAMPLES, and those whose tracing is predicted to stay below the limit, from the one before."""
        samples = [SAMPLES[0]]
        self.render(samples[0])  # warms up
        for spp in SAMPLES[1:]:
            if self.render(samples[-1]).timings["trace"] * spp / samples[-1] > self._effort.limit:
                break
            samples.append(spp)
        return samples


class FigureTime(NamedTuple):
    """Seconds of one method in one of Fig. 3 to 6, with 15 samples."""

    figure: str
    tracer: str
    method: str  # one of FIGURE_METHODS
    cull: float
    build: float
    trace: float

    @property
    def total(self) -> float:
        return self.cull + self.build + self.trace


def figure_times(view: CullingView, tracer: str, effort: CullingEffort) -> tuple[list[FigureTime], Frame]:
    """Measure one of Fig. 3 to 6; also returns its picture, which is the same with all methods."""
    pictures = {method: _Pictures(view, f"{METHODS[method]}+{tracer}", effort) for method in FIGURE_METHODS}
    latest: list[Frame] = []

    def measure(method: str, turn: int) -> dict[str, float]:
        effort.say(f"{view.figure}, {method}, {tracer}, {FIGURE_SAMPLES} samples, {round_text(turn, effort.rounds)}")
        latest[:] = [pictures[method].render(FIGURE_SAMPLES)]
        return latest[0].timings

    laps = interleave(FIGURE_METHODS, effort.rounds, measure)
    rows = []
    for method, times in laps.items():
        phases = medians(times)
        rows.append(FigureTime(view.figure, tracer, method, phases["cull"], phases["build"], phases["trace"]))
    return rows, latest[0]


def queries_of(view: CullingView, threads: int, spp: int = 1) -> tuple[Triangles, list[ShadowQuery]]:
    """The triangles of a view, and a query per light."""
    renderer = Renderer(view.scene, "bsah+single", threads)
    triangles = view.scene.triangles(view.time, threads)
    gbuffer = renderer.see(triangles, view.camera)
    samples = [light_samples(light, spp) for light in view.lights]
    return triangles, shadow_queries(triangles, gbuffer, view.lights, samples, threads=threads)


def remaining_shares(view: CullingView, threads: int) -> dict[str, float]:
    """Marking -> share of the triangles that it leaves in a view, with 32 cells per axis."""
    triangles, queries = queries_of(view, threads)
    kept = {marked: cull(triangles, queries, threads, method=method).kept for marked, method in MARKINGS.items()}
    return {marked: len(ids) / len(triangles.vertices) for marked, ids in kept.items()}


def grid_rows(
    view: CullingView, grids: Mapping[str, Sequence[int]], tracers: Sequence[str], effort: CullingEffort
) -> list[GridRow]:
    """Measure culling in one view with `grids`, such as USUAL or VIDEO.

    With `tracers`, build and trace times are measured too: first for all triangles, then for those that remain with
    each grid.
    """
    threads, rounds = effort.threads, effort.rounds
    plans = [f"{builder}+{tracer}" for builder in BUILDERS for tracer in tracers]
    accelerators = {plan: Renderer(view.scene, plan, threads).accelerator for plan in plans}
    triangles, queries = queries_of(view, threads)
    rows = [GridRow(view.figure, 0, "", 1.0, {}, *_all_traced(accelerators, triangles, None, queries, rounds))]
    for marked, sizes in grids.items():
        _culled(triangles, queries, threads, min(sizes), MARKINGS[marked])  # warms up
        for n in sizes:
            effort.say(f"{view.figure}, {view.time:.2f} s, grid of {n}, {marked}")
            laps = [_culled(triangles, queries, threads, n, MARKINGS[marked]) for _ in range(rounds)]
            if rounds > 1:
                record_laps([steps for _, steps in laps])
            culled = laps[0][0]
            times = _all_traced(accelerators, triangles, culled, queries, rounds)
            remaining = len(culled.kept) / len(triangles.vertices)
            rows.append(GridRow(view.figure, n, marked, remaining, medians([steps for _, steps in laps]), *times))
    return rows if tracers else rows[1:]


def published_grids(finest: int) -> dict[str, tuple[int, ...]]:
    """Marking -> grids of Table 4 in the first frame, those marked as published up to `finest` cells per axis."""
    return {**VIDEO, PUBLISHED: tuple(n for n in (*VIDEO[PUBLISHED], *FINEST) if n <= finest)}


def add_video(
    parts: BenchParts, views: Sequence[CullingView], tracers: Sequence[str], finest: int, effort: CullingEffort
) -> None:
    """Measure Table 4: each frame once, as the table has means over all frames."""
    once = effort._replace(rounds=1)
    for k, view in enumerate(views):
        grids = VIDEO if k else published_grids(finest)
        parts.add(CullingTable.video, f"frame at {view.time:.3f} s", partial(grid_rows, view, grids, tracers, once))


def _culled(
    triangles: Triangles, queries: Sequence[ShadowQuery], threads: int, n: int, method: MarkingMethod
) -> tuple[CullResult, dict[str, float]]:
    """The result of culling, and the seconds of each step."""
    last, seconds = clock_seconds(), dict.fromkeys(STEPS, 0.0)

    def lap(step: str) -> None:
        nonlocal last
        now = clock_seconds()
        seconds[step] += now - last
        last = now

    return cull(triangles, queries, threads, n=n, method=method, lap=lap), seconds


def _all_traced(
    accelerators: dict[str, Accelerator], triangles: Triangles, culled: Any, queries: Sequence[ShadowQuery], rounds: int
) -> tuple[dict[str, float], dict[str, float]]:
    """(seconds to build, seconds to trace) of each plan, the medians of `_traced`."""
    build, trace = {}, {}
    for plan, accelerator in accelerators.items():
        times = [_traced(accelerator, triangles, culled, queries) for _ in range(rounds)]
        build[plan], trace[plan] = (median(column) for column in zip(*times))
    return build, trace


def _traced(
    accelerator: Accelerator, triangles: Triangles, culled: Any, queries: Sequence[ShadowQuery]
) -> tuple[float, float]:
    """(seconds to build a BVH of the remaining triangles, seconds to trace the queries)."""
    start = clock_seconds()
    ready = accelerator.execute(accelerator.choice, triangles, culled)
    built = clock_seconds()
    for query in queries:
        accelerator.answer(ready, query)
    return built - start, clock_seconds() - built


def seconds_a_sample(t: TimeToImage) -> float:
    """Seconds per additional sample."""
    first, last = min(t.trace), max(t.trace)
    return (t.trace[last] - t.trace[first]) / (last - first) if last > first else t.trace[first] / first


def break_even(slow: TimeToImage, fast: TimeToImage) -> float:
    """The number of samples from which `slow`, with its longer build, is as fast as `fast`; inf if never (Fig. 7)."""
    first = SAMPLES[0]
    behind = slow.cull + slow.build + slow.trace[first] - fast.cull - fast.build - fast.trace[first]
    gain = seconds_a_sample(fast) - seconds_a_sample(slow)
    if gain > 0.0:
        return max(first, first + behind / gain)
    return first if behind <= 0.0 else np.inf


def mean_rows(rows: Iterable[GridRow]) -> list[GridRow]:
    """The means over all views for each grid."""
    groups: dict[tuple[int, str], list[GridRow]] = {}
    for row in rows:
        groups.setdefault((row.grid, row.marked), []).append(row)
    return [_mean(group) for group in groups.values()]


def _mean(rows: list[GridRow]) -> GridRow:
    mean = lambda values: float(np.mean(list(values)))
    steps, build, trace = (
        {key: mean(getattr(r, name)[key] for r in rows) for key in getattr(rows[0], name)}
        for name in ("steps", "build", "trace")
    )
    remaining = mean(r.remaining for r in rows)
    return GridRow("mean", rows[0].grid, rows[0].marked, remaining, steps, build, trace, len(rows))


# --- Random views -----------------------------------------------------------------------------------------------------


class RandomShares(NamedTuple):
    """The shares of the triangles that one marking leaves in random views of one part of a scene."""

    part: str
    marked: str  # a key of MARKINGS
    shares: list[float]  # one per view

    @property
    def quartiles(self) -> list[float]:
        """Lower quartile, median and upper quartile."""
        return [float(q) for q in np.quantile(self.shares, (0.25, 0.5, 0.75))]


def random_shares(views: Sequence[CullingView], effort: CullingEffort) -> list[RandomShares]:
    """Measure what each marking leaves in `random_views`, for each of their parts."""
    by_figure: dict[tuple[str, str], list[float]] = {}
    for k, view in enumerate(views):
        effort.say(f"{view.figure}, random camera {k + 1} of {len(views)}")
        for marked, share in remaining_shares(view, effort.threads).items():
            by_figure.setdefault((view.figure, marked), []).append(share)
    return [RandomShares(*key, shares) for key, shares in by_figure.items()]


# --- All measurements -------------------------------------------------------------------------------------------------


class CullingRows(NamedTuple):
    """All rows of the benchmark."""

    times: list[TimeToImage]
    figures: list[FigureTime]
    grids: list[GridRow]
    shares: list[RandomShares]
    video: list[GridRow]


ROWS = TimeToImage, FigureTime, GridRow, RandomShares
"""The rows in parts."""


def add_views(
    parts: BenchParts,
    views: Sequence[CullingView],
    tracers: Sequence[str],
    effort: CullingEffort,
    show: Callable[[CullingView, Frame], None],
) -> None:
    """Measure Tables 1 to 3 and Figures 3 to 6; `show` is called with the pictures of the figures."""
    for view in views:
        size = {"triangles": view.scene.n_triangles}
        parts.add(CullingTable.steps, view.figure, partial(grid_rows, view, USUAL, (), effort), **size)
        for name in tracers:
            parts.add(CullingTable.times, f"{view.figure}, {name}", partial(times_to_image, view, name, effort), **size)
        parts.add(CullingTable.figures, view.figure, partial(_shown_times, view, tracers[-1], effort, show), **size)


def add_random(parts: BenchParts, views: Sequence[CullingView], effort: CullingEffort) -> None:
    """Measure `random_views`."""
    for name in dict.fromkeys(view.figure for view in views):
        mine = [view for view in views if view.figure == name]
        size = {"triangles": mine[0].scene.n_triangles}
        parts.add(CullingTable.random, name, partial(random_shares, mine, effort), **size)


def _shown_times(
    view: CullingView, tracer: str, effort: CullingEffort, show: Callable[[CullingView, Frame], None]
) -> list[FigureTime]:
    times, frame = figure_times(view, tracer, effort)
    show(view, frame)
    return times


def rows_of(parts: BenchParts) -> CullingRows:
    """The rows of all parts."""
    tables = CullingTable.times, CullingTable.figures, CullingTable.steps, CullingTable.random, CullingTable.video
    return CullingRows(*(parts.rows(table) for table in tables))
