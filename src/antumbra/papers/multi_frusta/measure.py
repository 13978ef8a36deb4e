"""Measures tables of "Efficient ray traced soft shadows using multi-frusta tracing" [Benthin and Wald 2009].

- Table 1: accesses, tests and time of multi-frusta tracing, compared with packets of 16 rays.
- Table 2: three ways of frustum shrinking.
- Figure 6: lights from 1/4 to 8 times the edge.

The light is a level square whose edge is 1/40 of the scene's diagonal. Counts include shadow rays only, 16 samples a
pixel; the paper's include primary rays. Times are processor times of one thread. They are of tracing alone, without
building trees. Tracers take turns.
"""

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ...bvh import binned_sah
from ...errors import InputError
from ...methods import TRACERS, add_plugins
from ...query.gbuffer import GBuffer
from ...query.picture import shadow_queries
from ...query.rays import cull_value
from ...query.sampling import light_samples
from ...query.shadow import ShadowQuery
from ...rendering.renderer import Renderer
from ...scene.lights import QuadLight
from ...scene.triangles import Triangles
from ...trace.counters import as_dict, new_counters
from ..views import View, named_view, real_path, square

SPP = 16
TABLE1 = ("packet16", "packet16:samples", "packet256", "multifrusta:paper", "multifrusta")
BASELINES = TABLE1[:2]
TABLE2 = ("multifrusta:paper", "multifrusta:leaf-boxes", "multifrusta:corners", "multifrusta:full")
FIGURE6 = ("multifrusta:paper", "multifrusta")
SIZES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Edges of the light in Figure 6, relative to the usual one."""

REAL = ("sponza_crytek", "bart_robots")
EDGE = 40  # the usual edge of the light is 1 / EDGE of the scene's diagonal

Rows = dict[str, dict[str, float]]
"""Tracer -> its counters, and "seconds" if it was timed."""


class Case(NamedTuple):
    """A scene that is prepared for all tracers."""

    name: str
    triangles: Triangles
    gbuffer: GBuffer
    prepared: dict[str, object]  # tracer -> its acceleration structure
    light: QuadLight  # the light of the usual size
    facing: int  # value of CULL_FACES: the side of triangles that does not block


def default_names() -> list[str]:
    """The scenes in `REAL` that exist, and a procedural scene."""
    return [*(name for name in REAL if real_path(name)), "forest"]


def quad_view(name: str, size: tuple[int, int]) -> View:
    """The view of a named scene, with a square light."""
    return named_view(name, size, square(EDGE), REAL)


def case_of(view: View, cull_faces: str | None = "back") -> Case:
    """Prepare a view for every tracer of the tables. Culling back faces is as published.

    Raises
    ------
    InputError
        If the light is no square.
    """
    light, scene = view.lights[0], view.scene
    if not isinstance(light, QuadLight):
        raise InputError(f"{view.name}: its light is no rectangle, and multi-frusta are measured by one")
    corner, u, v = (np.asarray(x, float) for x in (light.corner, light.u, light.v))
    edge = np.linalg.norm(np.ptp(scene.bounds, axis=0)) / EDGE
    u, v, centre = (edge * u / np.linalg.norm(u), edge * v / np.linalg.norm(v), corner + (u + v) / 2)
    add_plugins()
    facing = cull_value(cull_faces)
    triangles = scene.triangles(0.0)
    gbuffer = Renderer(scene).see(triangles, view.camera, None)
    bvh = binned_sah.build(triangles.vertices)
    walking = {name: TRACERS[name] for name in dict.fromkeys((*TABLE1, *TABLE2, *FIGURE6))}
    shared = {prepare: prepare(bvh) for prepare in {t.prepare for t in walking.values()}}
    prepared = {name: shared[t.prepare] for name, t in walking.items()}
    return Case(view.name, triangles, gbuffer, prepared, QuadLight(centre - (u + v) / 2, u, v), facing)


def query_of(case: Case, size: float = 1.0) -> ShadowQuery:
    """The query of a light whose edge is `size` times the usual one."""
    corner, u, v = (np.asarray(x, float) for x in (case.light.corner, case.light.u, case.light.v))
    light = QuadLight(corner - (size - 1.0) / 2 * (u + v), size * u, size * v)
    return shadow_queries(case.triangles, case.gbuffer, [light], [light_samples(light, SPP)], case.facing)[0]


def answer(case: Case, tracer: str, query: ShadowQuery, counters: np.ndarray | None = None) -> np.ndarray:
    """(h, w, 1) uint64: the bits of a query by a tracer, in one thread."""
    bits = np.zeros((*query.sides.shape, 1), np.uint64)
    TRACERS[tracer].trace(case.prepared[tracer], query, bits, 1, counters, None)
    return bits


def measure(case: Case, tracers: tuple[str, ...], query: ShadowQuery, rounds: int) -> Rows:
    """Measure counters and median seconds of tracers, which take turns. Without rounds there are no seconds.

    Raises
    ------
    RuntimeError
        If two tracers give different bits.
    """
    results: Rows = {}
    seconds: dict[str, list[float]] = {t: [] for t in tracers}
    truth = answer(case, tracers[0], query)
    for tracer in tracers:
        counters = new_counters()
        if not np.array_equal(answer(case, tracer, query, counters), truth):
            raise RuntimeError(f"{case.name}: {tracer} and {tracers[0]} give different bits")
        results[tracer] = as_dict(counters)
        answer(case, tracer, query)  # compile the kernels without counters
    for _ in range(rounds):
        for tracer in tracers:
            start = time.thread_time()
            answer(case, tracer, query)
            seconds[tracer].append(time.thread_time() - start)
    return {t: {**r, "seconds": statistics.median(seconds[t])} if rounds else r for t, r in results.items()}


def tables(case: Case, rounds: int, say: Callable[[str], None]) -> dict:
    """Measure all tables of a case. "table 1" and "table 2" are Rows; "figure 6" maps edges of the light to Rows."""
    say(f"{case.name}, Table 1")
    one = measure(case, TABLE1, query_of(case), rounds)
    say(f"{case.name}, Table 2")
    two = measure(case, TABLE2, query_of(case), rounds)
    six = {}
    for size in SIZES:
        say(f"{case.name}, Figure 6, a light of {size:g} times the edge")
        six[str(size)] = measure(case, FIGURE6, query_of(case, size), 0)
    return {"table 1": one, "table 2": two, "figure 6": six}
