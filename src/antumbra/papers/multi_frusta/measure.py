"""Measures tables of "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009].

- Table 1: accesses, tests and time of multi-frusta tracing, compared with packets of 16 rays. Shadow rays and primary
  rays have tables of their own; the paper's S rows contain the primary rays.
- Sec. 5.2: packets of 256 rays; they are in Table 1.
- Table 2: three ways of frustum shrinking.
- Figure 6: lights from 1/4 to 8 times the edge.

The light is a level square whose edge is 1/40 of the scene's diagonal, with 16 samples a pixel. Back faces are culled,
as published, unless the case says otherwise. Times are processor times of one thread. They are of tracing alone,
without building trees. Tracers take turns.
"""

import statistics
import time
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import numpy as np

from ...bvh import binned_sah
from ...bvh.blocks import block_tree
from ...errors import InputError
from ...methods import TRACERS, add_plugins
from ...query.gbuffer import GBuffer
from ...query.light_samples import light_samples
from ...query.ray_list import cull_value
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...rendering.renderer import Renderer
from ...scene.camera import CameraRays
from ...scene.lights import QuadLight
from ...scene.triangles import Triangles
from ...trace.counters import as_dict, new_counters
from ...trace.primary.primary_rays import trace_primary
from ..views import View, diagonal_of, named_view, real_path, square
from .primary import deep_tree, trace_packets

SPP = 16
TABLE1 = ("packet16", "packet16:samples", "packet256", "multifrusta:paper", "multifrusta")
BASELINES = TABLE1[:2]
PRIMARY = {"packet16": trace_packets, "multifrusta": trace_primary}
TABLE2 = ("multifrusta:paper", "multifrusta:leaf-boxes", "multifrusta:corners", "multifrusta:full")
FIGURE6 = ("multifrusta:paper", "multifrusta")
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Edges of the light in Figure 6, relative to the usual one."""

REAL = ("sponza_crytek", "bart_robots")
EDGE = 40  # the usual edge of the light is 1 / EDGE of the scene's diagonal

Rows = dict[str, dict[str, float]]
"""Tracer -> its counters, and "seconds" if it was timed."""

Asked = Callable[[np.ndarray | None], np.ndarray]
"""Answers a question once; the argument is the counters."""


class Case(NamedTuple):
    """A scene that is prepared for all tracers."""

    name: str
    view: View  # its light is that of the usual size
    cull_faces: str | None  # the side of triangles that does not block shadow rays
    triangles: Triangles
    gbuffer: GBuffer
    rays: CameraRays
    prepared: dict[str, object]  # tracer -> its acceleration structure
    primary: dict[str, object]  # the same for primary rays
    light: QuadLight  # the light of the usual size


def default_names() -> list[str]:
    """The scenes in `REAL` that exist, and a procedural scene."""
    return [*(name for name in REAL if real_path(name)), "forest"]


def quad_view(name: str, size: tuple[int, int]) -> View:
    """The view of a named scene, with a square light."""
    return named_view(name, size, square(EDGE), REAL)


def case_of(view: View, cull_faces: str | None = "back") -> Case:
    """Prepare a view for every tracer of the tables.

    Raises
    ------
    InputError
        If the light is no square.
    """
    light, scene = view.lights[0], view.scene
    if not isinstance(light, QuadLight):
        raise InputError(f"{view.name}: its light is no rectangle, and multi-frusta are measured by one")
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.u, light.v))
    edge = diagonal_of(view.name, scene.bounds) / EDGE
    u, v, centre = (edge * u / np.linalg.norm(u), edge * v / np.linalg.norm(v), corner + (u + v) / 2)
    light = QuadLight(centre - (u + v) / 2, u, v)
    add_plugins()
    triangles = scene.triangles(0.0)
    gbuffer = Renderer(scene).see(triangles, view.camera, None)
    bvh = binned_sah.build(triangles.vertices)
    walking = {name: TRACERS[name] for name in dict.fromkeys((*TABLE1, *TABLE2, *FIGURE6))}
    shared = {prepare: prepare(bvh) for prepare in {t.prepare for t in walking.values()}}
    prepared = {name: shared[t.prepare] for name, t in walking.items()}
    primary = {"packet16": deep_tree(bvh), "multifrusta": block_tree(bvh)}
    rays = view.camera.rays(triangles.origin)
    view = view._replace(lights=[light])
    return Case(view.name, view, cull_faces, triangles, gbuffer, rays, prepared, primary, light)


def query_of(case: Case, size: float = 1.0) -> ShadowQuery:
    """The query of a light whose edge is `size` times the usual one."""
    corner, u, v = (np.asarray(x, float) for x in (case.light.corner, case.light.u, case.light.v))
    light = QuadLight(corner - (size - 1.0) / 2 * (u + v), size * u, size * v)
    facing = cull_value(case.cull_faces)
    return shadow_queries(case.triangles, case.gbuffer, [light], [light_samples(light, SPP)], facing)[0]


def answer(case: Case, tracer: str, query: ShadowQuery, counters: np.ndarray | None = None) -> np.ndarray:
    """(h, w, 1) uint64: the bits of a query by a tracer, in one thread."""
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    TRACERS[tracer].trace(case.prepared[tracer], query, bits, 1, counters, None)
    return bits


def see(case: Case, tracer: str, counters: np.ndarray | None = None) -> np.ndarray:
    """(2, h, w) float64: the face and t that each pixel sees, in one thread."""
    return np.stack(PRIMARY[tracer](case.primary[tracer], case.rays, 1, counters))


def measure(case: Case, tracers: tuple[str, ...], query: ShadowQuery, rounds: int) -> Rows:
    """Measure counters and median seconds of tracers, which take turns. Without rounds there are no seconds.

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


def _in_turns(name: str, asked: dict[str, Asked], rounds: int) -> Rows:
    results: Rows = {}
    seconds: dict[str, list[float]] = {tracer: [] for tracer in asked}
    truth = None
    for tracer, ask in asked.items():
        counters = new_counters()
        found = ask(counters)
        truth = found if truth is None else truth
        if not np.array_equal(found, truth):
            raise RuntimeError(f"{name}: {tracer} and {next(iter(asked))} give different bits")
        results[tracer] = as_dict(counters)
        if rounds:
            ask(None)  # compile the kernels without counters
    for _ in range(rounds):
        for tracer, ask in asked.items():
            start = time.thread_time()
            ask(None)
            seconds[tracer].append(time.thread_time() - start)
    return {t: {**r, "seconds": statistics.median(seconds[t])} if rounds else r for t, r in results.items()}


def tables(case: Case, rounds: int, say: Callable[[str], None]) -> dict:
    """Measure all tables of a case.

    "table 1 primary", "table 1" and "table 2" are Rows; "figure 6" maps edges of the light to Rows.
    """
    say(f"{case.name}, Table 1, primary rays")
    primary = measure_primary(case, rounds)
    say(f"{case.name}, Table 1")
    one = measure(case, TABLE1, query_of(case), rounds)
    say(f"{case.name}, Table 2")
    two = measure(case, TABLE2, query_of(case), rounds)
    six = {}
    for size in SIZES:
        say(f"{case.name}, Figure 6, a light of {size:g} times the edge")
        six[str(size)] = measure(case, FIGURE6, query_of(case, size), 0)
    return {"table 1 primary": primary, "table 1": one, "table 2": two, "figure 6": six}
