"""Measures "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009]; see `frusta_tables`.

- Table 1, P rows: primary rays, with and without shading, at their own size; and hard shadow rays from a point light.
- Table 1, S rows: accesses, tests and time of shadow rays. The paper's rows include the primary rays.
- Sec. 5.2: packets of 256 rays, listed in Table 1.
- Table 2: three kinds of frustum shrinking.
- Figure 5: visibility with 16 interleaved samples, smoothed by the discontinuity filter, and with 256 samples.
- Figure 6: lights with 1/4 to 8 times the edge length; counts only.
- Figure 7: silhouettes. The paper finds them by adjacency during traversal; here they are discontinuities of the
  G-buffer. Marked pixels are retraced with 16 sub-pixels.
- Sec. 6.1: 256 virtual point lights, 256 directions of a sky, and ambient occlusion.

The light is a horizontal square with an edge of 1/40 of the scene's diagonal, sampled by 16 rays per pixel. Back faces
are culled, as published, unless the case says otherwise. Times are CPU times of one thread and cover tracing only, not
building. Tracers alternate in each round.
"""

import time
from collections.abc import Callable, Mapping
from functools import cache, partial
from statistics import median
from typing import Any, NamedTuple

import numpy as np

from ....base.errors import InputError
from ....bvh import binned_sah
from ....bvh.block_tree import block_tree
from ....engine.method_registry import TRACERS, add_plugins
from ....picture.frame import Frame
from ....picture.image_files import automatic_exposure, to_srgb8
from ....picture.irradiance import irradiance
from ....picture.renderer import Renderer
from ....picture.virtual_point_lights import virtual_point_lights
from ....query.gbuffer import GBuffer, from_hits
from ....query.light_samples import hammersley, light_samples, to_domain
from ....query.pixel_refinement import edges
from ....query.ray_list import cull_value
from ....query.shadow_query import ShadowQuery, shadow_queries
from ....query.surface_links import picture_surfaces
from ....scene.camera import CameraRays
from ....scene.light_lists import DirectionalLights
from ....scene.lights import AmbientOcclusion, Light, PointLight, QuadLight, tangents
from ....scene.triangles import Triangles
from ....trace.counters import as_dict, new_counters
from ....trace.primary.primary_rays import trace_primary
from ...bench_parts import BenchParts
from ..bench_runner import Say, interleave
from ..benchmark_views import BenchmarkScenes, BenchmarkView, diagonal_of, square
from . import frusta_published
from .frusta_published import FrustaTable
from .moeller_trumbore import deep_tree, trace_packets
from .primary_frusta import trace_frusta
from .published_frusta import BLOCK

# --- Cases ------------------------------------------------------------------------------------------------------------


SPP = frusta_published.SPP
BASELINES = ("packet16:paper", "packet16", "packet16:samples")
TABLE1 = (*BASELINES, "packet256", "multifrusta:paper", "multifrusta")
PRIMARY: dict[str, Callable[..., tuple[np.ndarray, np.ndarray]]] = {
    "packet16:paper": trace_packets,
    "primary:paper": trace_frusta,
    "primary:entries": partial(trace_frusta, entries=True),
    "multifrusta": trace_primary,
}
HARD = ("packet16", "multifrusta:by-sample", "multifrusta")
TABLE2 = tuple(frusta_published.TABLE2)
FIGURE6 = ("packet16:paper", "multifrusta:paper", "multifrusta")
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Edge lengths of the light in Figure 6, relative to the default."""

N_LIGHTS = 256
"""Virtual point lights, and directions of the sky, in Sec. 6.1."""

SLOW = 20.0
"""Seconds of a run above which it is not repeated in further rounds."""

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
    primary_rays: CameraRays  # primary rays may have their own size
    light: QuadLight  # the default light


def case_of(view: BenchmarkView, cull_faces: str | None = "back", primary_size: tuple[int, int] | None = None) -> Case:
    """Prepare a view for every tracer of the tables; primary_size: None for the size of the view.

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
    tracers = {name: TRACERS[name] for name in dict.fromkeys((*TABLE1, *TABLE2, *HARD))}
    shared = {tracer.form: tracer.prepare(bvh) for tracer in tracers.values()}
    prepared = {name: shared[tracer.form] for name, tracer in tracers.items()}
    shallow = block_tree(bvh, block=BLOCK)
    primary = {"packet16:paper": deep_tree(bvh), "multifrusta": block_tree(bvh)}
    primary |= {"primary:paper": shallow, "primary:entries": shallow}
    rays = view.camera.rays(triangles.origin)
    primary_rays = view.camera.resized(*(primary_size or (rays.width, rays.height))).rays(triangles.origin)
    view = view._replace(lights=[light])
    return Case(view.name, view, cull_faces, triangles, gbuffer, rays, prepared, primary, primary_rays, light)


# --- Tables 1 and 2, Figure 6 -----------------------------------------------------------------------------------------


def query_to(case: Case, light: Light, spp: int = SPP) -> ShadowQuery:
    """The query of a light."""
    facing = cull_value(case.cull_faces)
    return shadow_queries(case.triangles, case.gbuffer, [light], [light_samples(light, spp)], facing)[0]


def query_of(case: Case, size: float = 1.0) -> ShadowQuery:
    """The query of the light with `size` times the default edge."""
    corner, u, v = (np.asarray(x, float) for x in (case.light.corner, case.light.u, case.light.v))
    return query_to(case, QuadLight(corner - (size - 1.0) / 2 * (u + v), size * u, size * v))


def answer(case: Case, tracer: str, query: ShadowQuery, counters: np.ndarray | None = None) -> np.ndarray:
    """(h, w, 1) uint64: the bits of a query by a tracer, on one thread."""
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    TRACERS[tracer].trace(case.prepared[tracer], query, bits, 1, counters, None)
    return bits


def see(case: Case, tracer: str, counters: np.ndarray | None = None) -> np.ndarray:
    """(2, h, w) float64: the face and t of each pixel's nearest hit, on one thread."""
    return np.stack(PRIMARY[tracer](case.primary[tracer], case.primary_rays, 1, counters))


def measure(case: Case, tracers: tuple[str, ...], query: ShadowQuery, rounds: int) -> Rows:
    """Measure counters and median seconds of alternating tracers. Without rounds there are no seconds.

    Raises
    ------
    RuntimeError
        If two tracers give different bits.
    """
    return _in_turns(case.name, {tracer: partial(answer, case, tracer, query) for tracer in tracers}, rounds)


def measure_primary(case: Case, rounds: int) -> Rows:
    """As `measure`, for primary rays; "shaded" is the time with shading, which is the same for all tracers."""
    rows = _in_turns(case.name, {tracer: partial(see, case, tracer) for tracer in PRIMARY}, rounds)
    shading = _shading_time(case, max(rounds, 1))
    pixels = case.primary_rays.width * case.primary_rays.height
    return {tracer: {**row, "rays": pixels, "shaded": row["seconds"] + shading} for tracer, row in rows.items()}


def _shading_time(case: Case, rounds: int) -> float:
    """Seconds to make the G-buffer of the hits and its irradiance from the light, without shadows."""
    (face, t), laps = PRIMARY["multifrusta"](case.primary["multifrusta"], case.primary_rays, 1), []
    patch = query_of(case).light
    for _ in range(rounds + 1):
        start = time.thread_time()
        irradiance(from_hits(face, t, case.triangles, case.primary_rays, 1), patch, case.light.domain, threads=1)
        laps.append(time.thread_time() - start)
    return median(laps[1:])  # the first round may compile


def measure_hard(case: Case, rounds: int) -> Rows:
    """As `measure`, for one shadow ray per pixel to a point light at the light's centre."""
    corner, u, v = (np.asarray(x, float) for x in (case.light.corner, case.light.u, case.light.v))
    return measure(case, HARD, query_to(case, PointLight(corner + (u + v) / 2), 1), rounds)


# --- Sec. 6.1: lists of lights, a sky, and ambient occlusion ----------------------------------------------------------


LIGHTS = f"{N_LIGHTS} virtual point lights", f"{N_LIGHTS} directions of a sky", "ambient occlusion"
"""The lights of Sec. 6.1: interleaved lists, and ambient occlusion with 16 rays per pixel."""


def coherent_light(case: Case, name: str) -> Light:
    """One of LIGHTS."""
    points, sky, _ = LIGHTS
    if name == points:
        return virtual_point_lights(case.view.scene, case.light, N_LIGHTS, threads=1)
    if name == sky:
        axis = np.eye(3)["xyz".index(case.view.scene.up)]
        a, b, c = to_domain(hammersley(N_LIGHTS), "hemisphere").T[:, :, None]
        u, v = tangents(axis)
        return DirectionalLights(-(a * u + b * v + c * axis), interleave=True)
    return AmbientOcclusion()


def measure_light(case: Case, rounds: int, name: str) -> Rows:
    """As `measure`, for one of LIGHTS."""
    return measure(case, HARD, query_to(case, coherent_light(case, name)), rounds)


# --- Runs -------------------------------------------------------------------------------------------------------------


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
    first: dict[str, float] = {}

    def seconds(tracer: str, turn: int) -> float | None:
        if first.get(tracer, 0.0) > SLOW:
            return None
        start = time.thread_time()
        calls[tracer](None)
        lap = time.thread_time() - start
        first.setdefault(tracer, lap)
        return lap

    for tracer, laps in interleave(calls, rounds, seconds).items():
        results[tracer] |= {"seconds": median(laps), "rounds": len(laps)} if laps else {}
    return results


# --- Parts ------------------------------------------------------------------------------------------------------------


class FrustaEffort(NamedTuple):
    """What to measure of each scene."""

    cull_faces: str | None
    primary_size: tuple[int, int]
    lights_size: tuple[int, int]
    rounds: int
    say: Say


class SceneRows(NamedTuple):
    """A part: rows of a table of a scene, or of one light of a table."""

    scene: str
    triangles: int
    table: str
    rows: Any  # Rows; of a light: its name and Rows; of Figures 5 and 7: `SoftShadowQuality`


PARTS_OF = {"figure 6": tuple(str(size) for size in SIZES), "section 6.1": LIGHTS}
"""Table -> its parts, which are its lights."""


class MeasuredScene(NamedTuple):
    """The results of a scene, as far as they were measured."""

    name: str
    triangles: int
    tables: dict[str, Any]  # table -> Rows, or those of each light
    quality: "SoftShadowQuality | None"


def add_scene(parts: BenchParts, view: BenchmarkView, effort: FrustaEffort) -> None:
    """Measure the parts of a scene."""
    case = cache(partial(case_of, view, effort.cull_faces, effort.primary_size))
    resized = view._replace(camera=view.camera.resized(*effort.lights_size))
    case_of_lights = cache(partial(case_of, resized, effort.cull_faces))
    rounds = effort.rounds

    def add(table: FrustaTable, name: str, measure: Callable[[], Any], light: str = "") -> None:
        what = f"{view.name}, {light}" if light else view.name

        def measured() -> SceneRows:
            effort.say(f"{what}, {name}")
            rows = measure()
            return SceneRows(view.name, view.scene.n_triangles, name, (light, rows) if light else rows)

        parts.add(table, what, measured, triangles=view.scene.n_triangles)

    add(FrustaTable.primary, "table 1 primary", lambda: measure_primary(case(), rounds))
    add(FrustaTable.soft, "table 1", lambda: measure(case(), TABLE1, query_of(case()), rounds))
    add(FrustaTable.hard, "hard shadows", lambda: measure_hard(case(), rounds))
    add(FrustaTable.shrinking, "table 2", lambda: measure(case(), TABLE2, query_of(case()), rounds))
    add(FrustaTable.quality, "quality", lambda: measure_quality(case(), effort.say))
    for size in SIZES:
        add(FrustaTable.sizes, "figure 6", partial(_measure_size, case, size), str(size))
    for light in LIGHTS:
        add(FrustaTable.lights, "section 6.1", partial(_measure_light, case_of_lights, rounds, light), light)


def _measure_size(case: Callable[[], Case], size: float) -> Rows:
    return measure(case(), FIGURE6, query_of(case(), size), 0)


def _measure_light(case: Callable[[], Case], rounds: int, light: str) -> Rows:
    return measure_light(case(), rounds, light)


TABLE_ORDER = ("table 1 primary", "hard shadows", "table 1", "table 2", "figure 6", "section 6.1")


def scenes_of(parts: BenchParts) -> list[MeasuredScene]:
    """The results of each scene, from its parts."""
    found: list[SceneRows] = [part for table in FrustaTable for part in parts.values(table)]
    scenes = []
    for name in dict.fromkeys(part.scene for part in found):
        mine = [part for part in found if part.scene == name]
        tables: dict[str, Any] = {part.table: part.rows for part in mine if part.table not in PARTS_OF}
        for table, lights in PARTS_OF.items():
            if rows := dict(part.rows for part in mine if part.table == table):
                tables[table] = {light: rows[light] for light in lights if light in rows}
        quality = tables.pop("quality", None)
        ordered = {table: tables[table] for table in TABLE_ORDER if table in tables}
        scenes.append(MeasuredScene(name, mine[0].triangles, ordered, quality))
    return scenes


def records_of(scene: MeasuredScene) -> dict[str, Any]:
    """The results of a scene as JSON objects."""
    if scene.quality is None:
        return scene.tables
    return {**scene.tables, "figure 5": scene.quality.rows, "figure 7": {"edges": scene.quality.edges}}


def exponents(sizes: Mapping[str, Rows], tracer: str, counter: str) -> tuple[float, float]:
    """Exponents of the power laws in the light's edge and in its area that fit a counter of Figure 6 best.

    The area grows with the square of the edge, so the second exponent is half of the first.
    """
    edges = np.log([float(size) for size in sizes])
    counts = np.log([max(rows[tracer][counter], 1.0) for rows in sizes.values()])
    slope = float(np.polyfit(edges, counts, 1)[0])
    return slope, slope / 2.0


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
