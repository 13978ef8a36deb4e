"""Measures, prints and draws the pre-BVH culling paper [Selgrad et al. 2015, Tables 1 to 4, Fig. 2, 7].

The four views are reconstructed from the paper's pictures. In Table 4, a swaying procedural city with a flying camera
replaces the paper's video: every triangle above the ground moves in every frame, so nothing from an earlier frame can
be reused unchanged. Tables show the paper's results, measured on a GPU, in brackets. Figure 7 shows time to image over
samples, relative to BSAH, with a row per tracer.

As in the paper, time to image covers culling, building and tracing, but not the G-buffer and shading. All methods use
the same tracer and alternate within each round; the median of the rounds counts.
"""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from ...cli import console as report
from ...engine.accelerator import Accelerator
from ...engine.scene import AnyScene, Scene, procedural
from ...engine.scene_loading import load
from ...errors import InputError
from ...files import atomic_output
from ...picture.renderer import Renderer
from ...query.light_samples import light_samples
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...scene.camera import Camera
from ...scene.lights import Light, QuadLight
from ...scene.mesh import Piece
from ...scene.triangles import Triangles
from ...techniques.culling.pre_bvh_culling import STEPS, cull
from ..benchmark_views import digest, real_path
from .cell_marking import mark_convex, mark_lines

# --- Published results, in milliseconds on a GPU ----------------------------------------------------------------------


METHODS = {
    "LBVH": "lbvh",
    "LBVH culled": "grid32+lbvh",
    "TL-LBVH": "tl-lbvh",
    "TL-LBVH culled": "grid32+tl-lbvh",
    "BSAH": "bsah",
}
"""The paper's name of a method -> culler and builder of a plan."""

TIME_TO_IMAGE = {
    "Figure 3": {
        "LBVH": (0.0, 3.520, 26.836, 30.356, 271.880, 2687.120),
        "LBVH culled": (1.399, 2.095, 20.955, 24.449, 213.044, 2098.994),
        "TL-LBVH": (0.0, 23.316, 20.776, 44.092, 231.076, 2100.916),
        "TL-LBVH culled": (1.399, 12.065, 17.653, 31.117, 189.994, 1778.764),
        "BSAH": (0.0, 278.500, 14.279, 292.779, 421.290, 1706.400),
    },
    "Figure 4": {
        "LBVH": (0.0, 3.539, 15.872, 19.411, 162.259, 1590.739),
        "LBVH culled": (1.405, 2.428, 12.636, 16.469, 130.193, 1267.433),
        "TL-LBVH": (0.0, 23.408, 11.862, 35.270, 142.028, 1209.608),
        "TL-LBVH culled": (1.405, 15.185, 9.834, 26.424, 114.930, 999.990),
        "BSAH": (0.0, 278.500, 8.428, 286.928, 362.780, 1121.300),
    },
    "Figure 5": {
        "LBVH": (0.0, 3.525, 12.684, 16.209, 130.365, 1271.925),
        "LBVH culled": (1.228, 2.687, 11.004, 14.919, 113.955, 1104.315),
        "TL-LBVH": (0.0, 23.293, 10.349, 33.642, 126.783, 1058.193),
        "TL-LBVH culled": (1.228, 16.678, 9.741, 27.647, 115.316, 992.006),
        "BSAH": (0.0, 278.500, 8.372, 286.872, 362.220, 1115.700),
    },
    "Figure 6": {
        "LBVH": (0.0, 9.902, 18.408, 28.310, 193.982, 1850.702),
        "LBVH culled": (2.374, 1.121, 14.160, 17.655, 145.095, 1419.495),
        "TL-LBVH": (0.0, 68.993, 10.540, 79.533, 174.393, 1122.993),
        "TL-LBVH culled": (2.374, 4.775, 9.329, 16.478, 100.439, 940.049),
        "BSAH": (0.0, 879.400, 9.041, 888.441, 969.810, 1783.500),
    },
}
"""Table 3: view -> method -> times of culling, building and tracing 1 sample, and totals with 1, 10 and 100 samples."""

DETAILS = {
    "Figure 3": (2.158, 0.734, 0.387, 0.122, 0.638, 0.231),
    "Figure 4": (2.897, 0.710, 0.710, 0.128, 0.600, 0.232),
    "Figure 5": (3.035, 1.539, 0.344, 0.133, 0.562, 0.220),
    "Figure 6": (4.554, 1.623, 0.403, 0.126, 1.570, 0.251),
}
"""Tables 1 and 2: view -> times of the G-buffer, the final blit, and the culling steps."""

REMAINING = {"Figure 3": 0.45, "Figure 4": 0.60, "Figure 5": 0.60, "Figure 6": 0.04}
"""Captions of Figures 3 to 6: share of remaining triangles."""

GRIDS = {
    16: (0.34, 0.319, 0.074, 4.323, 4.716, 15.464, 15.430, 95.601, 11.496),
    32: (0.24, 0.463, 0.133, 4.810, 5.406, 11.450, 13.915, 67.056, 10.660),
    64: (0.19, 0.658, 0.704, 5.884, 7.246, 9.809, 13.307, 56.057, 10.354),
    128: (0.17, 0.904, 11.880, 8.515, 21.299, 8.989, 12.889, 49.942, 10.095),
    256: (0.16, 2.995, 534.021, 16.388, 553.404, 8.458, 12.538, 46.145, 9.874),
}
"""Table 4: grid -> (share of remaining triangles, times of sources, marking, triangles and all culling, of building and
tracing with LBVH, and of building and tracing with TL-LBVH)."""

UNCULLED = (42.161, 17.020, 261.186, 12.167)
"""Table 4, without culling: times of building and tracing with LBVH, and with TL-LBVH."""

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


def times_to_image(
    view: CullingView, tracer: str, threads: int, rounds: int, say: Callable[[str], None]
) -> list[TimeToImage]:
    """Measure Tables 1 to 3 for one view and tracer; InputError if its camera sees nothing."""
    renderers = {m: Renderer(view.scene, f"{part}+{tracer}", threads) for m, part in METHODS.items()}
    seconds: dict[str, dict[Any, list[float]]] = {m: {} for m in METHODS}
    bits: dict[str, bytes] = {}
    for turn in range(-1, rounds):  # the first is a warm-up
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
    remaining = _remaining(view, renderers["LBVH culled"])
    rows = []
    for method, times in seconds.items():
        middle = {key: median(values) for key, values in times.items()}
        share = remaining if METHODS[method].startswith("grid") else 1.0
        gbuffer, shade, culling, build = (middle[phase] for phase in ("gbuffer", "shade", "cull", "build"))
        trace = {spp: middle[spp] for spp in SAMPLES}
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
    view: CullingView,
    grids: Mapping[str, Sequence[int]],
    tracers: Sequence[str],
    threads: int,
    rounds: int,
    say: Callable[[str], None],
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
            steps = {step: median(lap[step] for lap in laps) for step in STEPS}
            timed = accelerators if marked == HULLS else {}
            times = _all_traced(timed, triangles, culled, queries, rounds)
            rows.append(GridRow(view.figure, n, marked, len(culled.kept) / len(triangles.vertices), steps, *times))
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


# --- Tables -----------------------------------------------------------------------------------------------------------


_WIDTH = 150  # width of the tables, in characters
_STEPS = {
    "sources": "G-buffer to grid",
    "mark": "mark cells",
    "triangles": "determine triangles",
    "pack": "scan and pack triangles",
}
"""Culling step -> its name in Tables 1 and 2."""


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.1f}"


def _beside(ours: str, theirs: float | None, digits: int = 1) -> str:
    """Our result, with the paper's in brackets if there is one."""
    return ours if theirs is None else f"{ours} ({theirs:.{digits}f})"


def print_details(times: list[TimeToImage], grids: list[GridRow]) -> None:
    """Print Tables 1 and 2: all steps for each view and tracer."""
    columns = list(dict.fromkeys((t.figure, t.tracer) for t in times))
    parts = [_details(*column, times, grids) for column in columns]
    table = [(name, *(part[name] for part in parts)) for name in parts[0]]
    head = ("ms", *(f"{figure}, {tracer}" for figure, tracer in columns))
    print("All steps with one sample (Tables 1 and 2; in brackets the paper's results on a GPU)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _details(figure: str, tracer: str, times: list[TimeToImage], grids: list[GridRow]) -> dict[str, str]:
    """The column of one view and tracer: row name -> times."""
    methods = {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)}
    grid = next(r for r in grids if r.figure == figure and r.marked == HULLS)
    theirs: Sequence[float | None] = DETAILS.get(figure) or (None,) * 6
    totals: Mapping[str, Sequence[float | None]] = TIME_TO_IMAGE.get(figure, {})
    first = methods["LBVH"]
    rows = {
        "render G-buffer": _beside(_ms(first.gbuffer), theirs[0]),
        "shading (final blit)": _beside(_ms(first.shade), theirs[1]),
    }
    for (step, name), ms in zip(_STEPS.items(), theirs[2:]):
        rows[name] = _beside(_ms(grid.steps[step]), ms)
    for method, t in methods.items():
        total = totals.get(method, (None,) * 3)
        if t.cull:
            rows[f"{method}: all culling"] = _beside(_ms(t.cull), total[0])
        rows[f"{method}: build"] = _beside(_ms(t.build), total[1])
        rows[f"{method}: trace"] = _beside(_ms(t.trace[SAMPLES[0]]), total[2])
    return rows


def print_times(times: list[TimeToImage]) -> None:
    """Print Table 3, with the paper's ratios to LBVH in brackets, and the break-even points of Figure 7."""
    rows = []
    for t in times:
        same = {o.method: o for o in times if (o.figure, o.tracer) == (t.figure, t.tracer)}
        first, last, theirs = same["LBVH"], same["BSAH"], TIME_TO_IMAGE.get(t.figure)
        ratios = []
        for k, spp in enumerate(SAMPLES):
            ratio = 100 * theirs[t.method][3 + k] / theirs["LBVH"][3 + k] if theirs else None
            ratios.append(_beside(f"{100 * t.total(spp) / first.total(spp):.0f}", ratio, 0))
        even = "" if t is last else f"{break_even(last, t):.0f}"
        seconds = t.cull, t.build, t.trace[SAMPLES[0]], *(t.total(spp) for spp in SAMPLES)
        rows.append((t.figure, t.tracer, t.method, *map(_ms, seconds), *ratios, even))
    totals, ratios = ([f"{name} {spp} spp" for spp in SAMPLES] for name in ("total", "% of LBVH"))
    head = ("view", "tracer", "method", "cull", "build", "trace 1 spp", *totals, *ratios, "BSAH breaks even, spp")
    print("Time to image, ms (Table 3 and Figure 7; the paper's results in brackets)")
    report.print_table(head, rows, right=range(3, len(head)), width=_WIDTH)


def print_regions(grids: list[GridRow]) -> None:
    """Print the remaining triangles with a convex region and with grids (Figure 2, captions of Figures 3 to 6)."""
    figures, table = list(dict.fromkeys(r.figure for r in grids)), []
    for figure in figures:
        shares = {r.marked: f"{100 * r.remaining:.1f}" for r in grids if r.figure == figure}
        theirs = REMAINING.get(figure)
        published = _beside(shares[LINES], None if theirs is None else 100 * theirs, 0)
        table.append((figure, shares[CONVEX], published, shares[HULLS]))
    head = ("view", "convex region (Figure 2b)", "as published (Figure 2d)", "hulls (grid32)")
    print("Remaining triangles, %, with 32 cells per axis (the paper's results in brackets)")
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def print_grids(rows: list[GridRow], tracers: list[str]) -> None:
    """Print Table 4, with the paper's results in brackets."""
    table = []
    for r in rows:
        theirs: Sequence[float | None] = GRIDS[r.grid] if r.grid else (None, None, None, None, None, *UNCULLED)
        share = _beside(f"{100 * r.remaining:.0f}", 100 * GRIDS[r.grid][0] if r.grid else None, 0)
        steps = ["", "", ""]
        if r.grid:
            parts = r.steps["sources"], r.steps["mark"], r.steps["triangles"] + r.steps["pack"]
            steps = [_beside(_ms(part), ms) for part, ms in zip(parts, theirs[1:4])]
        total = _beside(_ms(sum(r.steps.values())), theirs[4]) if r.grid else ""
        times = []
        for builder, ms in zip(BUILDERS, (theirs[5:7], theirs[7:9])):
            plans = [f"{builder}+{tracer}" for tracer in tracers]
            times.append(_beside(_ms(r.build[plans[0]]), ms[0]) if r.build else "")
            times += [_beside(_ms(r.trace[plan]), ms[1]) if r.trace else "" for plan in plans]
        table.append((str(r.grid or "none"), r.marked, share, *steps, total, *times))
    names = [name for b in BUILDERS for name in (f"build {b}", *(f"{t}, 1 spp" for t in tracers))]
    head = ("grid", "marking", "% remaining", "sources", "mark", "triangles", "all culling", *names)
    print("Grids, ms, means over the frames of an animated city (Table 4; in brackets the paper's, for another scene)")
    report.print_table(head, table, right=(0, *range(2, len(head))), width=_WIDTH)


# --- Plot -------------------------------------------------------------------------------------------------------------


def _sums(t: TimeToImage, spp: np.ndarray) -> np.ndarray:
    """Time to image in seconds for any number of samples, by linear interpolation and extrapolation."""
    traced = np.array([t.trace[s] for s in SAMPLES])
    beyond = np.maximum(spp - SAMPLES[-1], 0) * seconds_a_sample(t)
    sums: np.ndarray = t.cull + t.build + np.interp(spp, SAMPLES, traced) + beyond
    return sums


def write_plot(times: list[TimeToImage], path: Path) -> None:
    """Write Figure 7 with a panel per view and tracer. A dot marks where BSAH breaks even with a method."""
    from matplotlib.figure import Figure

    figures, tracers = (list(dict.fromkeys(getattr(t, name) for t in times)) for name in ("figure", "tracer"))
    sheet = Figure(figsize=(4.2 * len(figures), 3.8 * len(tracers)), layout="constrained")
    panels = sheet.subplots(len(tracers), len(figures), squeeze=False)
    for row, tracer in zip(panels, tracers):
        for panel, figure in zip(row, figures):
            _draw(panel, {t.method: t for t in times if (t.figure, t.tracer) == (figure, tracer)})
        row[0].set_ylabel("time to image / BSAH's")
    sheet.axes[0].legend(fontsize=8)
    with atomic_output(path) as temporary:
        sheet.savefig(temporary, format="png", dpi=110)


def _draw(panel: Any, methods: dict[str, TimeToImage]) -> None:
    """Draw the curves of one view and one tracer."""
    spp, last = np.geomspace(1, 1000, 200), methods["BSAH"]
    for method, t in methods.items():
        (line,) = panel.plot(spp, _sums(t, spp) / _sums(last, spp), label=method)
        even = break_even(last, t)
        if t is not last and even <= spp[-1]:
            panel.plot(even, 1.0, "o", color=line.get_color())
    title = f"{last.figure}, {last.tracer}"
    panel.set(xscale="log", title=title, xlabel="samples per pixel and light", ylim=(0, None))
    panel.grid(alpha=0.3)
