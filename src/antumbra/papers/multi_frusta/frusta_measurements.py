"""Measures, prints and draws "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009].

- Table 1: accesses, tests and time of multi-frusta tracing and of packets of 16 rays. Shadow rays and primary rays have
  separate tables; the paper's S rows include the primary rays.
- Sec. 5.2: packets of 256 rays, listed in Table 1.
- Table 2: three kinds of frustum shrinking.
- Figure 5: visibility with 16 interleaved samples, smoothed by the discontinuity filter, and with 256 samples.
- Figure 6: lights with 1/4 to 8 times the edge length.
- Figure 7: silhouettes. The paper finds them by adjacency during traversal; here they are discontinuities of the
  G-buffer. Marked pixels are retraced with 16 sub-pixels.

The light is a horizontal square with an edge of 1/40 of the scene's diagonal, sampled by 16 rays per pixel. Back faces
are culled, as published, unless the case says otherwise. Times are CPU times of one thread and cover tracing only, not
building. Tracers alternate in each round.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ...bvh import binned_sah
from ...bvh.block_tree import block_tree
from ...engine.method_registry import TRACERS, add_plugins
from ...errors import InputError
from ...picture.frame import Frame
from ...picture.image_files import automatic_exposure, to_srgb8
from ...picture.renderer import Renderer
from ...query.gbuffer import GBuffer, picture_surfaces
from ...query.light_samples import light_samples
from ...query.pixel_refinement import edges
from ...query.ray_list import cull_value
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...scene.camera import CameraRays
from ...scene.lights import QuadLight
from ...scene.triangles import Triangles
from ...trace.counters import as_dict, new_counters
from ...trace.primary.primary_rays import trace_primary
from ..bench_runner import Say, TableColumn, columns_of, interleave, item, label, plot_sheet, print_notes, print_table
from ..benchmark_views import BenchmarkScenes, BenchmarkView, diagonal_of, square
from .packet_baselines import deep_tree, trace_packets

# --- Published results ------------------------------------------------------------------------------------------------


COLUMNS = ("triangles", "candidates", "box_tests", "triangle_tests")
"""Names of our counters for the paper's #tris, +culling, #AABB and #isec."""

PUBLISHED_TABLE1 = ("1.9-3.7", "5.0-10.1", "14.1-23.8", "1.0-1.4", "3.3-6.1")
"""The S rows: ranges over the paper's scenes of packets of 16 rays divided by multi-frusta, for COLUMNS and seconds."""

PUBLISHED_PRIMARY = ("1.5-2.3", "3.0-9.5", "11.8-21", "1.7-3.1", "3.4-7.8")
"""The same for the P rows: primary rays without shading."""

PACKET256 = "-3 to -4 %", "at most 0.5"
"""Sec. 5.2: packets of 256 rays relative to multi-frusta: change in box tests, and speedup."""

EDGES = 0.115
"""Figure 7: share of pixels at silhouettes, in the scene Saloon."""

PUBLISHED_TABLE2 = {
    "multifrusta:paper": "0 0 0 0",
    "multifrusta:leaf-boxes": "-15 -19 +155 -26",
    "multifrusta:corners": "0 -14 0 -21",
    "multifrusta:full": "-8 -18 -2 -23",
}
"""Changes of COLUMNS in per cent, in the scene T-Rex."""

# --- Tables 1 and 2, Figure 6 -----------------------------------------------------------------------------------------


SPP = 16
TABLE1 = ("packet16", "packet16:samples", "packet256", "multifrusta:paper", "multifrusta")
BASELINES = TABLE1[:2]
PRIMARY = {"packet16": trace_packets, "multifrusta": trace_primary}
TABLE2 = ("multifrusta:paper", "multifrusta:leaf-boxes", "multifrusta:corners", "multifrusta:full")
FIGURE6 = ("multifrusta:paper", "multifrusta")
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Edge lengths of the light in Figure 6, relative to the default."""

EDGE = 40  # the default edge of the light is 1 / EDGE of the scene's diagonal
SCENES = BenchmarkScenes(("sponza_crytek", "bart_robots"), ("forest",), ("forest",), square(EDGE))

Rows = dict[str, dict[str, float]]
"""Tracer -> its counters, and "seconds" if it was timed."""

TraceCall = Callable[[np.ndarray | None], np.ndarray]
"""Traces a query once; the argument is the counters."""


class Case(NamedTuple):
    """A scene prepared for all tracers."""

    name: str
    view: BenchmarkView  # with the default light
    cull_faces: str | None  # the side of triangles that does not block shadow rays
    triangles: Triangles
    gbuffer: GBuffer
    rays: CameraRays
    prepared: Mapping[str, Any]  # tracer -> its acceleration structure
    primary: Mapping[str, Any]  # the same for primary rays
    light: QuadLight  # the default light


def case_of(view: BenchmarkView, cull_faces: str | None = "back") -> Case:
    """Prepare a view for every tracer of the tables.

    Raises
    ------
    InputError
        If the light is not rectangular.
    """
    light, scene = view.lights[0], view.scene
    if not isinstance(light, QuadLight):
        raise InputError(f"{view.name}: multi-frusta are measured with a rectangular light, and its light is not one")
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.u, light.v))
    edge = diagonal_of(view.name, scene.bounds) / EDGE
    u, v, centre = (edge * u / np.linalg.norm(u), edge * v / np.linalg.norm(v), corner + (u + v) / 2)
    light = QuadLight(centre - (u + v) / 2, u, v)
    add_plugins()
    triangles = scene.triangles(0.0)
    gbuffer = Renderer(scene).see(triangles, view.camera, None)
    bvh = binned_sah.build(triangles.vertices)
    tracers = {name: TRACERS[name] for name in dict.fromkeys((*TABLE1, *TABLE2, *FIGURE6))}
    shared = {prepare: prepare(bvh) for prepare in {t.prepare for t in tracers.values()}}
    prepared = {name: shared[t.prepare] for name, t in tracers.items()}
    primary = {"packet16": deep_tree(bvh), "multifrusta": block_tree(bvh)}
    rays = view.camera.rays(triangles.origin)
    view = view._replace(lights=[light])
    return Case(view.name, view, cull_faces, triangles, gbuffer, rays, prepared, primary, light)


def query_of(case: Case, size: float = 1.0) -> ShadowQuery:
    """The query of a light with `size` times the default edge."""
    corner, u, v = (np.asarray(x, float) for x in (case.light.corner, case.light.u, case.light.v))
    light = QuadLight(corner - (size - 1.0) / 2 * (u + v), size * u, size * v)
    facing = cull_value(case.cull_faces)
    return shadow_queries(case.triangles, case.gbuffer, [light], [light_samples(light, SPP)], facing)[0]


def answer(case: Case, tracer: str, query: ShadowQuery, counters: np.ndarray | None = None) -> np.ndarray:
    """(h, w, 1) uint64: the bits of a query by a tracer, on one thread."""
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    TRACERS[tracer].trace(case.prepared[tracer], query, bits, 1, counters, None)
    return bits


def see(case: Case, tracer: str, counters: np.ndarray | None = None) -> np.ndarray:
    """(2, h, w) float64: the face and t of each pixel's nearest hit, on one thread."""
    return np.stack(PRIMARY[tracer](case.primary[tracer], case.rays, 1, counters))


def measure(case: Case, tracers: tuple[str, ...], query: ShadowQuery, rounds: int) -> Rows:
    """Measure counters and median seconds of alternating tracers. Without rounds there are no seconds.

    Raises
    ------
    RuntimeError
        If two tracers give different bits.
    """
    return _in_turns(case.name, {tracer: partial(answer, case, tracer, query) for tracer in tracers}, rounds)


def measure_primary(case: Case, rounds: int) -> Rows:
    """As `measure`, for primary rays."""
    rows = _in_turns(case.name, {tracer: partial(see, case, tracer) for tracer in PRIMARY}, rounds)
    return {tracer: {**row, "rays": case.gbuffer.face.size} for tracer, row in rows.items()}


def _in_turns(name: str, calls: dict[str, TraceCall], rounds: int) -> Rows:
    results: Rows = {}
    reference = None
    for tracer, call in calls.items():
        counters = new_counters()
        result = call(counters)
        reference = result if reference is None else reference
        if not np.array_equal(result, reference):
            raise RuntimeError(f"{name}: {tracer} and {next(iter(calls))} give different bits")
        results[tracer] = dict(as_dict(counters))
        if rounds:
            call(None)  # compile the kernels without counters

    def seconds(tracer: str, turn: int) -> float:
        start = time.thread_time()
        calls[tracer](None)
        return time.thread_time() - start

    for tracer, laps in interleave(calls, rounds, seconds).items():
        results[tracer] |= {"seconds": median(laps)} if laps else {}
    return results


def tables(case: Case, rounds: int, say: Say) -> dict[str, Any]:
    """Measure all tables of a case.

    "table 1 primary", "table 1" and "table 2" are Rows; "figure 6" maps relative edge lengths of the light to Rows.
    """
    say(f"{case.name}, Table 1, primary rays")
    primary = measure_primary(case, rounds)
    say(f"{case.name}, Table 1")
    one = measure(case, TABLE1, query_of(case), rounds)
    say(f"{case.name}, Table 2")
    two = measure(case, TABLE2, query_of(case), rounds)
    six = {}
    for size in SIZES:
        say(f"{case.name}, Figure 6, light edge x {size:g}")
        six[str(size)] = measure(case, FIGURE6, query_of(case, size), 0)
    return {"table 1 primary": primary, "table 1": one, "table 2": two, "figure 6": six}


# --- Figures 5 and 7: filtered samples, and retraced edges ------------------------------------------------------------


MANY = 256
FRAMES: dict[str, dict[str, Any]] = {
    "16 samples": {"spp": SPP},
    "16 samples, filtered": {"spp": SPP, "filter": True},
    "256 samples": {"spp": MANY},
    "edges retraced": {"spp": SPP, "filter": True, "adaptive": 4 * SPP},
}
_PARTS = 3  # pictures are cropped to 1 / _PARTS of each side


class SoftShadowQuality(NamedTuple):
    """The data of Figures 5 and 7 for a case."""

    rows: dict[str, dict[str, float]]  # name in FRAMES -> rays, seconds, and visibility errors relative to MANY
    edges: float  # share of the pixels with a visible surface
    pictures: dict[str, np.ndarray]  # name -> (h, w, 3) uint8, in the order of the figures


def measure_quality(case: Case, say: Say) -> SoftShadowQuality:
    """Render each frame of both figures once with the default plan."""
    renderer, frames = Renderer(case.view.scene), {}
    for name, options in FRAMES.items():
        say(f"{case.name}, Figures 5 and 7, {name}")
        frames[name] = renderer.render(
            case.view.camera, case.view.lights, cull_faces=case.cull_faces, antialias=False, **options
        )
    visible, reference = case.gbuffer.face >= 0, frames["256 samples"]
    colours = case.view.scene.colours
    edge = edges(picture_surfaces(case.gbuffer, case.rays), colours) & visible
    rows = {name: _row(frame, reference, visible) for name, frame in frames.items()}
    return SoftShadowQuality(rows, float(edge.sum() / max(visible.sum(), 1)), _pictures(frames, edge, visible))


def _row(frame: Frame, reference: Frame, visible: np.ndarray) -> dict[str, float]:
    error = (frame.visibility[0] - reference.visibility[0])[visible].astype(float)
    rms, mean = (float(np.sqrt(np.mean(error**2))), float(np.mean(np.abs(error)))) if error.size else (0.0, 0.0)
    return {"rays": frame.rays, "seconds": frame.timings["trace"] + frame.timings["filter"], "rms": rms, "mean": mean}


def _pictures(frames: dict[str, Frame], edge: np.ndarray, visible: np.ndarray) -> dict[str, np.ndarray]:
    exposure = automatic_exposure(frames["256 samples"].image, visible)
    images = {name: to_srgb8(frame.image, exposure) for name, frame in frames.items()}
    marked = images["16 samples, filtered"] // 2
    marked[edge] = 255, 64, 64
    crop = _most_varied_crop(frames["256 samples"].visibility[0], visible)
    filtered, reference = (f"{name} (Fig. 5)" for name in ("16 samples, filtered", "256 samples"))
    return {
        filtered: images["16 samples, filtered"][crop],
        reference: images["256 samples"][crop],
        "edges (Fig. 7)": marked,
        "edges retraced (Fig. 7)": images["edges retraced"],
    }


def _most_varied_crop(visibility: np.ndarray, visible: np.ndarray) -> tuple[slice, slice]:
    """The part of the picture with the highest variance of visibility."""
    h, w = (max(n // _PARTS, 1) for n in visible.shape)
    parts = [(slice(y * h, y * h + h), slice(x * w, x * w + w)) for y in range(_PARTS) for x in range(_PARTS)]
    return max(parts, key=lambda part: float((visibility[part] * visible[part]).var()))


# --- Tables -----------------------------------------------------------------------------------------------------------


_NAMES = dict(zip(COLUMNS, ("#tris", "+culling", "#AABB", "#isec")))
"""Counter -> its name in the paper."""


def print_case(case: Case, tables: dict[str, Any], quality: SoftShadowQuality) -> None:
    """Print all tables of a case; `tables` is the result of `tables`."""
    primary, one, two, six = tables.values()
    _print_counts(f"Table 1, {case.name}, primary rays", case, primary)
    _print_reduction(primary, "packet16", ("multifrusta",), PUBLISHED_PRIMARY)
    _print_counts(f"Table 1, {case.name}, shadow rays", case, one)
    for base in BASELINES:
        _print_reduction(one, base, TABLE1[2:], PUBLISHED_TABLE1)
    _print_packet256(one)
    _print_table2(case, two)
    title = f"Figure 5, {case.name}: visibility error x 1000 against 256 samples per pixel (the paper: pictures)"
    print_table(title, _FIGURE5, quality.rows.items())
    _print_figure6(case, six)
    ours, theirs = f"{100 * quality.edges:.1f} %", f"{100 * EDGES:.1f} % in Saloon"
    print(f"Figure 7, {case.name}: {ours} of the pixels are at edges (the paper: {theirs})\n")


_FIGURE5 = (
    label("frame", item(0)),
    TableColumn("M rays", item(1, lambda row: f"{row['rays'] / 1e6:.2f}")),
    TableColumn("seconds", item(1, lambda row: f"{row['seconds']:.3f}")),
    TableColumn("rms", item(1, lambda row: f"{1e3 * row['rms']:.1f}")),
    TableColumn("mean", item(1, lambda row: f"{1e3 * row['mean']:.1f}")),
)


def _per_counter(cell: Callable[[dict[str, float], str], str], published: bool = False) -> list[TableColumn]:
    """A column per counter of COLUMNS. Rows are (tracer, counters); the published row has its figures in order."""
    theirs = (lambda row, counter: row[1 + COLUMNS.index(counter)]) if published else None
    return columns_of(_NAMES, lambda row, counter: cell(row[1], counter), theirs)


def _print_counts(title: str, case: Case, rows: Rows) -> None:
    rays = next(iter(rows.values()))["rays"]
    columns = (
        label("tracer", item(0)),
        *_per_counter(lambda row, counter: f"{row[counter] / 1e3:,.0f}K"),
        TableColumn("seconds", item(1, lambda row: f"{row['seconds']:.3f}")),
        TableColumn("M rays/s", item(1, lambda row: f"{rays / row['seconds'] / 1e6:.2f}")),
    )
    size = f"{len(case.triangles.vertices):,} triangles, {rays / 1e6:.2f} M rays"
    print_table(f"{title}: {size}", columns, rows.items())


def _print_reduction(rows: Rows, base: str, tracers: Sequence[str], published: Sequence[str]) -> None:
    """Print by what factor the tracers reduce the counts and time of `base`, and the paper's range."""
    columns = (
        label("tracer", item(0), item(0)),
        *_per_counter(lambda row, counter: f"{rows[base][counter] / max(row[counter], 1):.2f}", published=True),
        TableColumn("seconds", item(1, lambda row: f"{rows[base]['seconds'] / row['seconds']:.2f}"), item(5)),
    )
    reductions = [(tracer, rows[tracer]) for tracer in tracers]
    title = f"Reduction factor over {base} (Table 1; the paper's range)"
    print_table(title, columns, reductions, [("the paper", *published)])


def _print_packet256(rows: Rows) -> None:
    """Print the comparison of Sec. 5.2. The paper counts a box once for all 256 rays, as this counts nodes."""
    many, frusta, packets = (rows[t] for t in ("packet256", "multifrusta:paper", "packet16"))
    change = f"{100 * (many['nodes'] / max(frusta['nodes'], 1) - 1):+.0f} % (the paper: {PACKET256[0]})"
    speed = f"{frusta['seconds'] / many['seconds']:.2f} (the paper: {PACKET256[1]})"
    over_packet16 = f"{packets['seconds'] / many['seconds']:.2f} (the paper: in some cases less than 1)"
    print("Packets of 256 rays compared with multifrusta:paper (Sec. 5.2)")
    print_notes([("nodes", change), ("speedup", speed), ("speedup over packet16", over_packet16)])


def _print_table2(case: Case, rows: Rows) -> None:
    none = rows[TABLE2[0]]
    columns = (
        label("tracer", item(0)),
        *_per_counter(lambda row, counter: f"{100 * (row[counter] / max(none[counter], 1) - 1):+.1f}"),
        label("the paper", item(0, PUBLISHED_TABLE2.__getitem__)),
        TableColumn("shrinks", item(1, lambda row: f"{row['shrinks'] / 1e3:,.0f}K")),
        TableColumn("speedup", item(1, lambda row: f"{none['seconds'] / row['seconds']:.2f}")),
    )
    print_table(f"Table 2, {case.name}: change in %, with the paper's for T-Rex", columns, rows.items())


def _print_figure6(case: Case, sizes: dict[str, Rows]) -> None:
    thousands = lambda row: f"{row['triangles'] / 1e3:,.0f} {row['triangle_tests'] / 1e3:,.0f}"
    columns = columns_of({size: size for size in sizes}, lambda tracer, size: thousands(sizes[size][tracer]))
    title = f"Figure 6, {case.name}: #tris and #isec in thousands, by edge length of the light"
    print_table(title, [label("tracer", str), *columns], FIGURE6)


# --- Draws Figures 5 to 7 ---------------------------------------------------------------------------------------------


_STYLES = dict(zip(FIGURE6, ("-", "--")))
_PANELS = (("triangles", "triangles accessed"), ("triangle_tests", "tests of a triangle with 16 rays"))


def write_plot(scenes: dict[str, tuple[dict[str, Any], SoftShadowQuality]], path: Path) -> None:
    """Write a plot: Figure 6 at the top, and below it a row per scene with Figures 5 and 7.

    scenes : name of the scene -> (its tables, its quality)
    """
    with plot_sheet(path, 14.0, 4.5 + 3.7 * len(scenes)) as sheet:
        (above,), (below,) = sheet.subfigures(2, 1, squeeze=False, height_ratios=[4.5, 3.7 * len(scenes)])
        for panel, (counter, axis) in zip(above.subplots(1, 2), _PANELS):
            _draw_sizes(panel, {name: tables["figure 6"] for name, (tables, _) in scenes.items()}, counter, axis)
        panels = below.subplots(len(scenes), 4, squeeze=False)
        for row, (name, (_, quality)) in zip(panels, scenes.items()):
            for panel, (title, picture) in zip(row, quality.pictures.items()):
                panel.imshow(picture, interpolation="nearest")
                panel.set_title(f"{name}: {title}", fontsize=9)
                panel.set_axis_off()


def _draw_sizes(panel: Any, scenes: dict[str, dict[str, Rows]], counter: str, axis: str) -> None:
    """Draw a counter over the light's size: a colour per scene, a line style per tracer."""
    for k, (name, sizes) in enumerate(scenes.items()):
        edges = [float(size) for size in sizes]
        for tracer, style in _STYLES.items():
            millions = [rows[tracer][counter] / 1e6 for rows in sizes.values()]
            panel.plot(edges, millions, style, marker=".", color=f"C{k}", label=f"{name}, {tracer}")
    panel.set_xscale("log", base=2)
    panel.set_yscale("log")
    panel.set_xticks(edges, [f"{edge:g}" for edge in edges])
    panel.set(xlabel="edge length of the light, relative (Fig. 6)", ylabel=f"{axis}, millions")
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
