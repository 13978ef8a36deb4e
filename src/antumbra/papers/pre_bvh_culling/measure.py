"""Measures the tables and the plot of the pre-BVH culling paper [Selgrad et al. 2015, Tables 1 to 4, Fig. 7].

As in the paper, time to image is the time of culling, building and tracing, without the G-buffer and the shading. All
methods use the same tracer and take turns within each round. The median of the rounds counts.
"""

from collections.abc import Callable, Iterable
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...cull.cull import STEPS, cull
from ...errors import InputError
from ...query.picture import shadow_queries
from ...query.sampling import light_samples
from ...rendering.accelerate import Accelerator
from ...rendering.renderer import Renderer
from ..answers import digest
from .lines import mark_lines
from .published import METHODS
from .views import CullingView

SAMPLES = (1, 10, 100)  # samples for each pixel and light
GRIDS = (16, 32, 64, 128, 256)
PUBLISHED_GRIDS = (16, 32, 64)  # finer grids take too long with the published marking


class TimeToImage(NamedTuple):
    """Seconds of one method in one view."""

    figure: str
    method: str  # a key of METHODS
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
    grid: int  # cells along an axis
    published: bool  # marked by lines, in a grid over the whole scene
    remaining: float  # share of the triangles that are left
    steps: dict[str, float]  # step of STEPS -> seconds
    build: dict[str, float]  # builder -> seconds
    trace: dict[str, float]  # builder -> seconds with one sample; empty if not measured


def times_to_image(
    view: CullingView, tracer: str, threads: int, rounds: int, say: Callable[[str], None]
) -> list[TimeToImage]:
    """Measure Table 3 for one view; InputError if its camera sees nothing."""
    renderers = {m: Renderer(view.scene, f"{part}+{tracer}", threads) for m, part in METHODS.items()}
    seconds: dict[str, dict[Any, list[float]]] = {m: {} for m in METHODS}
    bits: dict[str, bytes] = {}
    for turn in range(-1, rounds):  # the first turn only warms up
        for method, renderer in renderers.items():
            for spp in SAMPLES if turn >= 0 else SAMPLES[:1]:
                say(f"{view.figure}, {method}, {spp} samples, round {max(turn, 0) + 1} of {rounds}")
                frame = renderer.render(view.camera, view.lights, spp=spp)
                if not frame.rays:
                    raise InputError(f"{view.figure}: the camera sees nothing; give Crytek's Sponza, in centimetres")
                if turn >= 0:
                    for phase in ("cull", "build"):
                        seconds[method].setdefault(phase, []).append(frame.timings[phase])
                    seconds[method].setdefault(spp, []).append(frame.timings["trace"])
                bits[method] = digest(frame.bits)
    left = _remaining(view, renderers["LBVH culled"])
    found = []
    for method, times in seconds.items():
        middle = {key: median(values) for key, values in times.items()}
        share = left if METHODS[method].startswith("grid") else 1.0
        trace = {spp: middle[spp] for spp in SAMPLES}
        found.append(TimeToImage(view.figure, method, middle["cull"], middle["build"], trace, share, bits[method]))
    return found


def _queries(view: CullingView, renderer: Renderer, spp: int):
    triangles = view.scene.triangles(0.0, renderer.threads)
    gbuffer = renderer.see(triangles, view.camera, None)
    samples = [light_samples(light, spp) for light in view.lights]
    return triangles, shadow_queries(triangles, gbuffer, view.lights, samples, threads=renderer.threads)


def _remaining(view, renderer) -> float:
    triangles, queries = _queries(view, renderer, 1)
    return len(renderer.accelerator.culled(triangles, queries).kept) / len(triangles.vertices)


def grid_rows(view: CullingView, tracer: str, threads: int, rounds: int, say: Callable[[str], None]) -> list[GridRow]:
    """Measure Table 4 for one view: our grids, and grids that are marked as published."""
    renderers = {b: Renderer(view.scene, f"{b}+{tracer}", threads) for b in ("lbvh", "tl-lbvh")}
    triangles, queries = _queries(view, renderers["lbvh"], 1)
    rows = []
    for published in (False, True):
        options = dict(mark=mark_lines, whole=True) if published else {}
        for n in PUBLISHED_GRIDS if published else GRIDS:
            say(f"{view.figure}, grid of {n}")
            laps = [_steps(triangles, queries, threads, n, options) for _ in range(rounds + 1)][1:]
            culled = cull(triangles, queries, threads, n=n, **options)
            steps = {step: median(lap[step] for lap in laps) for step in STEPS}
            build, trace = {}, {}
            for builder, renderer in () if published else renderers.items():
                times = [_traced(renderer.accelerator, triangles, culled, queries) for _ in range(rounds)]
                build[builder], trace[builder] = (median(column) for column in zip(*times))
            rows.append(
                GridRow(view.figure, n, published, len(culled.kept) / len(triangles.vertices), steps, build, trace)
            )
    return rows


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
    rows, found = list(rows), []
    for published in (False, True):
        for n in GRIDS:
            same = [r for r in rows if r.grid == n and r.published == published]
            if same:
                mean = lambda values: float(np.mean(list(values)))
                parts = [
                    {key: mean(getattr(r, name)[key] for r in same) for key in getattr(same[0], name)}
                    for name in ("steps", "build", "trace")
                ]
                found.append(GridRow("mean", n, published, mean(r.remaining for r in same), *parts))
    return found
