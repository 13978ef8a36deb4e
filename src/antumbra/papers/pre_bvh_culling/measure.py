"""Measures the tables and the plot of the pre-BVH culling paper [Selgrad et al. 2015, Tables 1 to 4, Fig. 2, 7].

As in the paper, time to image is the time of culling, building and tracing, without the G-buffer and the shading. All
methods use the same tracer and take turns within each round. The median of the rounds counts.
"""

from collections.abc import Callable, Iterable, Sequence
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...engine.accelerator import Accelerator
from ...errors import InputError
from ...query.light_samples import light_samples
from ...query.shadow_query import shadow_queries
from ...rendering.renderer import Renderer
from ...techniques.culling.pre_bvh_culling import STEPS, cull
from ..answers import digest
from .convex import mark_convex
from .lines import mark_lines
from .published import METHODS
from .views import CullingView

SAMPLES = (1, 10, 100)  # samples for each pixel and light
HULLS, LINES, CONVEX = "hulls", "as published", "convex region"
MARKINGS: dict[str, dict[str, Any]] = {
    HULLS: {},
    LINES: {"mark": mark_lines, "whole": True},
    CONVEX: {"mark": mark_convex},
}
"""Way to mark cells -> extra arguments of `cull`. The convex region is that of Fig. 2b."""

USUAL = {HULLS: (32,), LINES: (32,), CONVEX: (32,)}
"""Way to mark cells -> the grids of Tables 1 and 2, and of Fig. 2."""

VIDEO = {HULLS: (16, 32, 64, 128, 256), LINES: (16, 32, 64)}
"""Way to mark cells -> the grids of Table 4. Marking by lines takes too long in finer grids."""

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
    trace: dict[int, float]  # samples -> seconds
    remaining: float  # share of the triangles that are in the BVH
    bits: bytes  # digest of the answer

    def total(self, spp: int) -> float:
        return self.cull + self.build + self.trace[spp]


class GridRow(NamedTuple):
    """One grid in one view: seconds, and the share of the triangles that are left."""

    figure: str
    grid: int  # cells along an axis; 0: no culling
    marked: str  # a key of MARKINGS; empty: no culling
    remaining: float  # share of the triangles that are left
    steps: dict[str, float]  # step of STEPS -> seconds
    build: dict[str, float]  # builder+tracer -> seconds; empty if not measured
    trace: dict[str, float]  # builder+tracer -> seconds with one sample


def times_to_image(
    view: CullingView, tracer: str, threads: int, rounds: int, say: Callable[[str], None]
) -> list[TimeToImage]:
    """Measure Tables 1 to 3 for one view and tracer; InputError if its camera sees nothing."""
    renderers = {m: Renderer(view.scene, f"{part}+{tracer}", threads) for m, part in METHODS.items()}
    seconds: dict[str, dict[Any, list[float]]] = {m: {} for m in METHODS}
    bits: dict[str, bytes] = {}
    for turn in range(-1, rounds):  # the first turn only warms up
        for method, renderer in renderers.items():
            for spp in SAMPLES if turn >= 0 else SAMPLES[:1]:
                say(f"{view.figure}, {method}, {tracer}, {spp} samples, round {max(turn, 0) + 1} of {rounds}")
                frame = renderer.render(view.camera, view.lights, spp=spp, time=view.time)
                if not frame.rays:
                    raise InputError(f"{view.figure}: the camera sees nothing; give Crytek's Sponza, in centimetres")
                if turn >= 0:
                    for phase in ("gbuffer", "shade", "cull", "build"):
                        seconds[method].setdefault(phase, []).append(frame.timings[phase])
                    seconds[method].setdefault(spp, []).append(frame.timings["trace"])
                bits[method] = digest(frame.bits)
    left = _remaining(view, renderers["LBVH culled"])
    found = []
    for method, times in seconds.items():
        middle = {key: median(values) for key, values in times.items()}
        share = left if METHODS[method].startswith("grid") else 1.0
        phases = (middle[phase] for phase in ("gbuffer", "shade", "cull", "build"))
        trace = {spp: middle[spp] for spp in SAMPLES}
        found.append(TimeToImage(view.figure, tracer, method, *phases, trace, share, bits[method]))
    return found


def _queries(view: CullingView, renderer: Renderer, spp: int):
    triangles = view.scene.triangles(view.time, renderer.threads)
    gbuffer = renderer.see(triangles, view.camera, None)
    samples = [light_samples(light, spp) for light in view.lights]
    return triangles, shadow_queries(triangles, gbuffer, view.lights, samples, threads=renderer.threads)


def _remaining(view, renderer) -> float:
    triangles, queries = _queries(view, renderer, 1)
    return len(renderer.accelerator.culled(triangles, queries).kept) / len(triangles.vertices)


def grid_rows(
    view: CullingView, grids: dict[str, Sequence[int]], tracers: Sequence[str], threads: int, rounds: int, say
) -> list[GridRow]:
    """Measure culling in one view with `grids`, as USUAL or VIDEO.

    With `tracers`, the times to build and to trace are measured too, for all triangles first, and then for those that
    each grid marked by `HULLS` leaves.
    """
    renderers = {f"{b}+{t}": Renderer(view.scene, f"{b}+{t}", threads) for b in BUILDERS for t in tracers or ["single"]}
    triangles, queries = _queries(view, next(iter(renderers.values())), 1)
    accelerators = {plan: r.accelerator for plan, r in renderers.items()} if tracers else {}
    rows = [GridRow(view.figure, 0, "", 1.0, {}, *_all_traced(accelerators, triangles, None, queries, rounds))]
    for marked, sizes in grids.items():
        for n in sizes:
            say(f"{view.figure}, grid of {n}, {marked}")
            options = MARKINGS[marked]
            laps = [_steps(triangles, queries, threads, n, options) for _ in range(rounds + 1)][1:]
            culled = cull(triangles, queries, threads, n=n, **options)
            steps = {step: median(lap[step] for lap in laps) for step in STEPS}
            asked = accelerators if marked == HULLS else {}
            times = _all_traced(asked, triangles, culled, queries, rounds)
            rows.append(GridRow(view.figure, n, marked, len(culled.kept) / len(triangles.vertices), steps, *times))
    return rows if tracers else rows[1:]


def _steps(triangles, queries, threads, n, options) -> dict[str, float]:
    """Cull once; return the seconds of each step."""
    last, seconds = perf_counter(), dict.fromkeys(STEPS, 0.0)

    def lap(step: str) -> None:
        nonlocal last
        now = perf_counter()
        seconds[step] += now - last
        last = now

    cull(triangles, queries, threads, n=n, lap=lap, **options)
    return seconds


def _all_traced(accelerators, triangles, culled, queries, rounds) -> tuple[dict[str, float], dict[str, float]]:
    """The medians of `_traced` for each plan: (seconds to build, seconds to trace)."""
    build, trace = {}, {}
    for plan, accelerator in accelerators.items():
        times = [_traced(accelerator, triangles, culled, queries) for _ in range(rounds)]
        build[plan], trace[plan] = (median(column) for column in zip(*times))
    return build, trace


def _traced(accelerator: Accelerator, triangles, culled, queries) -> tuple[float, float]:
    """(seconds to build a BVH of the triangles that are left, seconds to trace the queries)."""
    start = perf_counter()
    ready = accelerator.build(triangles, culled)
    built = perf_counter()
    for query in queries:
        accelerator.answer(ready, query)
    return built - start, perf_counter() - built


def seconds_a_sample(t: TimeToImage) -> float:
    """Seconds of each further sample."""
    return (t.trace[SAMPLES[-1]] - t.trace[SAMPLES[0]]) / (SAMPLES[-1] - SAMPLES[0])


def break_even(slow: TimeToImage, fast: TimeToImage) -> float:
    """The number of samples from which `slow` is as fast as `fast`; inf if it never is (Fig. 7).

    `slow` takes longer to build.
    """
    first = SAMPLES[0]
    behind = slow.total(first) - fast.total(first)
    gain = seconds_a_sample(fast) - seconds_a_sample(slow)
    if gain > 0.0:
        return max(first, first + behind / gain)
    return first if behind <= 0.0 else np.inf


def mean_rows(rows: Iterable[GridRow]) -> list[GridRow]:
    """The means over all views, for each grid."""
    groups: dict[tuple[int, str], list[GridRow]] = {}
    for row in rows:
        groups.setdefault((row.grid, row.marked), []).append(row)
    return [_mean(group) for group in groups.values()]


def _mean(rows: list[GridRow]) -> GridRow:
    mean = lambda values: float(np.mean(list(values)))
    parts = (
        {key: mean(getattr(r, name)[key] for r in rows) for key in getattr(rows[0], name)}
        for name in ("steps", "build", "trace")
    )
    return GridRow("mean", rows[0].grid, rows[0].marked, mean(r.remaining for r in rows), *parts)
