"""Measures the pre-BVH culling paper [Selgrad et al. 2015, Tables 1 to 4, Fig. 2, 7].

The four views are reconstructed from the paper's pictures. In Table 4, a swaying procedural city with a flying camera
replaces the paper's video: every triangle above the ground moves in every frame, so nothing from an earlier frame can
be reused unchanged.

As in the paper, time to image covers culling, building and tracing, but not the G-buffer and shading. All methods use
the same tracer and alternate within each round; the median of the rounds counts.
"""

from collections.abc import Generator, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...engine.accelerator import Accelerator
from ...engine.scene import AnyScene, Scene, procedural
from ...engine.scene_loading import load
from ...errors import InputError
from ...picture.renderer import Renderer
from ...query.light_samples import light_samples
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...scene.camera import Camera
from ...scene.lights import Light, QuadLight
from ...scene.mesh import Piece
from ...scene.triangles import Triangles
from ...techniques.culling.pre_bvh_culling import STEPS, cull
from ..bench_runner import Say, interleave, medians, round_text
from ..benchmark_views import digest, real_path
from .cell_marking import mark_convex, mark_lines

# --- Views ------------------------------------------------------------------------------------------------------------


_SPONZA = {
    "Figure 3": ((-1150.0, 120.0, -180.0), (200.0, 420.0, 60.0)),
    "Figure 4": ((1180.0, 230.0, -40.0), (-1100.0, 150.0, 20.0)),
    "Figure 5": ((-1020.0, 640.0, 420.0), (700.0, 520.0, 330.0)),
}
"""Figure -> position and target of the camera: along the court, over the whole court, and in the upper gallery."""


class CullingView(NamedTuple):
    """A view of the paper."""

    figure: str
    scene: AnyScene
    camera: Camera
    lights: list[Light]
    time: float = 0.0  # seconds into the animation


def culling_views(sponza: Path | None, size: tuple[int, int], cellar_triangles: int) -> list[CullingView]:
    """The views of Figures 3 to 5, in Crytek's Sponza, and of Figure 6, in a procedural cellar.

    Sponza is a file in centimetres, or $ANTUMBRA_SCENES/sponza_crytek/scene.glb. Without it, a view of the procedural
    atrium with as many triangles replaces the first three.
    """
    cellar = procedural("cellar", triangles=cellar_triangles)
    last = CullingView("Figure 6", cellar, cellar.cameras[0].resized(*size), list(cellar.lights))
    path = real_path("sponza_crytek") if sponza is None else sponza
    if path is None:
        atrium = procedural("atrium", triangles=262_267)
        return [CullingView("atrium", atrium, atrium.cameras[0].resized(*size), list(atrium.lights)), last]
    if not path.exists():
        raise InputError(f"{path}: no such file; give Crytek's Sponza, or omit --sponza")
    scene = load(path)
    return [_in_sponza(figure, scene, size) for figure in _SPONZA] + [last]


def _in_sponza(figure: str, scene: AnyScene, size: tuple[int, int]) -> CullingView:
    """A view in Sponza with two area lights, a large one above the open roof and a smaller one behind the camera."""
    position, target = (np.array(p) for p in _SPONZA[figure])
    above = QuadLight((-900.0, 1400.0, -250.0), (1800.0, 0.0, 0.0), (0.0, 0.0, 450.0), intensity=2e6)
    ahead = (target - position) / np.linalg.norm(target - position)
    u = np.cross(ahead, (0.0, 1.0, 0.0))
    u, v = 120.0 * u / np.linalg.norm(u), 120.0 * np.cross(u / np.linalg.norm(u), ahead)
    behind = QuadLight(position - 60.0 * ahead + (0.0, 120.0, 0.0) - (u + v) / 2, u, v, intensity=3e5)
    return CullingView(
        figure, scene, Camera(position, target, vfov=60.0, width=size[0], height=size[1]), [above, behind]
    )


# --- Animation --------------------------------------------------------------------------------------------------------


FIGURE = "video"
SECONDS = 4.0  # length of the animation
_SWAY = 0.02  # largest displacement, as a share of the height above the ground
_FLIGHT = 0.6  # length of the flight, as a share of the distance from the first camera to its target


class Swaying:
    """The geometry of a static scene, displaced sideways in proportion to height (see `scene.mesh.Source`)."""

    duration = SECONDS

    def __init__(self, still: Scene):
        self.file, self.meshes = f"swaying {still.name}", still.meshes
        self.objects = still.objects
        self._pieces, self._cameras, self._lights = list(still.source.pieces(0.0)), still.cameras, still.lights

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        share = np.sin(2.0 * np.pi * time / SECONDS)
        for piece in self._pieces:
            x, y, z = np.moveaxis(np.asarray(piece.vertices, np.float64), -1, 0)
            by = _SWAY * share * y
            moved = np.stack([x + by * np.sin(0.05 * z), y, z + by * np.cos(0.05 * x)], -1)
            yield piece._replace(vertices=moved.astype(piece.vertices.dtype))

    def cameras(self, time: float) -> list[Camera]:
        return self._cameras

    def lights(self, time: float) -> list[Light]:
        return self._lights


def video_views(triangles: int, frames: int, size: tuple[int, int]) -> list[CullingView]:
    """The frames of the animation, as views of one scene with about `triangles` triangles."""
    still = procedural("city", triangles=triangles)
    scene = Scene(Swaying(still), name="swaying city")
    return [_frame(scene, still, time, size) for time in np.linspace(0.0, SECONDS, frames, endpoint=False).tolist()]


def _frame(scene: Scene, still: Scene, time: float, size: tuple[int, int]) -> CullingView:
    start = still.cameras[0]
    position, target = np.asarray(start.position, float), np.asarray(start.target, float)
    at = position + _FLIGHT * time / SECONDS * (target - position)
    camera = Camera(at, target, start.up, start.vfov, *size)
    return CullingView(FIGURE, scene, camera, list(still.lights), time)


# --- Measurements -----------------------------------------------------------------------------------------------------


METHODS = {
    "LBVH": "lbvh",
    "LBVH culled": "grid32+lbvh",
    "TL-LBVH": "tl-lbvh",
    "TL-LBVH culled": "grid32+tl-lbvh",
    "BSAH": "bsah",
}
"""The paper's name of a method -> culler and builder of a plan."""

SAMPLES = (1, 10, 100)  # samples per pixel and light
HULLS, LINES, CONVEX = "hulls", "as published", "convex region"
MARKINGS: dict[str, dict[str, Any]] = {
    HULLS: {},
    LINES: {"mark": mark_lines, "whole": True},
    CONVEX: {"mark": mark_convex},
}
"""Marking method -> extra arguments of `cull`. The convex region is that of Fig. 2b."""

USUAL = {HULLS: (32,), LINES: (32,), CONVEX: (32,)}
"""Marking method -> grids of Tables 1 and 2, and of Fig. 2."""

VIDEO = {HULLS: (16, 32, 64, 128, 256), LINES: (16, 32, 64)}
"""Marking method -> grids of Table 4. Marking by lines takes too long in finer grids."""

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
    remaining: float  # share of the triangles in the BVH
    bits: bytes  # digest of the answer

    def total(self, spp: int) -> float:
        return self.cull + self.build + self.trace[spp]


class GridRow(NamedTuple):
    """One grid in one view: seconds, and share of remaining triangles."""

    figure: str
    grid: int  # cells per axis; 0: no culling
    marked: str  # a key of MARKINGS; empty: no culling
    remaining: float  # share of remaining triangles
    steps: dict[str, float]  # step of STEPS -> seconds
    build: dict[str, float]  # builder+tracer -> seconds; empty if not measured
    trace: dict[str, float]  # builder+tracer -> seconds with one sample


def times_to_image(view: CullingView, tracer: str, threads: int, rounds: int, say: Say) -> list[TimeToImage]:
    """Measure Tables 1 to 3 for one view and tracer; InputError if its camera sees nothing."""
    renderers = {m: Renderer(view.scene, f"{part}+{tracer}", threads) for m, part in METHODS.items()}
    bits: dict[str, bytes] = {}

    def render(method: str, turn: int) -> dict[int, dict[str, float]]:
        timings = {}
        for spp in SAMPLES if turn >= 0 else SAMPLES[:1]:
            say(f"{view.figure}, {method}, {tracer}, {spp} samples, {round_text(turn, rounds)}")
            frame = renderers[method].render(view.camera, view.lights, spp=spp, time=view.time)
            if not frame.rays:
                raise InputError(f"{view.figure}: the camera sees nothing; give Crytek's Sponza, in centimetres")
            timings[spp], bits[method] = frame.timings, digest(frame.bits)
        return timings

    laps = interleave(METHODS, rounds, render, warm_up=1)
    remaining = _remaining(view, renderers["LBVH culled"])
    rows = []
    for method, times in laps.items():
        gbuffer, shade, culling, build = (
            median(lap[spp][phase] for lap in times for spp in SAMPLES)
            for phase in ("gbuffer", "shade", "cull", "build")
        )
        trace = {spp: median(lap[spp]["trace"] for lap in times) for spp in SAMPLES}
        share = remaining if METHODS[method].startswith("grid") else 1.0
        rows.append(
            TimeToImage(view.figure, tracer, method, gbuffer, shade, culling, build, trace, share, bits[method])
        )
    return rows


def _queries(view: CullingView, renderer: Renderer, spp: int) -> tuple[Triangles, list[ShadowQuery]]:
    triangles = view.scene.triangles(view.time, renderer.threads)
    gbuffer = renderer.see(triangles, view.camera, None)
    samples = [light_samples(light, spp) for light in view.lights]
    return triangles, shadow_queries(triangles, gbuffer, view.lights, samples, threads=renderer.threads)


def _remaining(view: CullingView, renderer: Renderer) -> float:
    triangles, queries = _queries(view, renderer, 1)
    culled = renderer.accelerator.cull(triangles, queries)
    assert culled is not None
    return len(culled.kept) / len(triangles.vertices)


def grid_rows(
    view: CullingView, grids: Mapping[str, Sequence[int]], tracers: Sequence[str], threads: int, rounds: int, say: Say
) -> list[GridRow]:
    """Measure culling in one view with `grids`, such as USUAL or VIDEO.

    With `tracers`, build and trace times are measured too: first for all triangles, then for those that remain with
    each grid marked by `HULLS`.
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
            timed = accelerators if marked == HULLS else {}
            times = _all_traced(timed, triangles, culled, queries, rounds)
            remaining = len(culled.kept) / len(triangles.vertices)
            rows.append(GridRow(view.figure, n, marked, remaining, medians(laps), *times))
    return rows if tracers else rows[1:]


def _steps(
    triangles: Triangles, queries: Sequence[ShadowQuery], threads: int, n: int, options: dict[str, Any]
) -> dict[str, float]:
    """The seconds of each step of culling."""
    last, seconds = perf_counter(), dict.fromkeys(STEPS, 0.0)

    def lap(step: str) -> None:
        nonlocal last
        now = perf_counter()
        seconds[step] += now - last
        last = now

    cull(triangles, queries, threads, n=n, lap=lap, **options)
    return seconds


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
    start = perf_counter()
    ready = accelerator.build(triangles, culled)
    built = perf_counter()
    for query in queries:
        accelerator.answer(ready, query)
    return built - start, perf_counter() - built


def seconds_a_sample(t: TimeToImage) -> float:
    """Seconds per additional sample."""
    return (t.trace[SAMPLES[-1]] - t.trace[SAMPLES[0]]) / (SAMPLES[-1] - SAMPLES[0])


def break_even(slow: TimeToImage, fast: TimeToImage) -> float:
    """The number of samples from which `slow`, with its longer build, is as fast as `fast`; inf if never (Fig. 7)."""
    first = SAMPLES[0]
    behind = slow.total(first) - fast.total(first)
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
    parts = (
        {key: mean(getattr(r, name)[key] for r in rows) for key in getattr(rows[0], name)}
        for name in ("steps", "build", "trace")
    )
    return GridRow("mean", rows[0].grid, rows[0].marked, mean(r.remaining for r in rows), *parts)
