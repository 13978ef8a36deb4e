"""The kernels of plans, which are compiled before the first question is answered."""

from collections.abc import Callable

import numpy as np

from ..auto.rates import GOOD, QUICK
from ..auto.ways import WAYS, Forms, answer
from ..kernels import needs
from ..kernels.crew import Wanted
from ..methods import BUILDERS, UPDATERS
from ..plan import Plan
from ..query.light_samples import light_samples
from ..query.shadow_query import shadow_queries
from ..scene.camera import Camera
from ..scene.lights import QuadLight
from ..trace.counters import new_counters
from .choosing import accelerator_of
from .ready import Job, fixed_job, make_ready, small_scene, small_view
from .see import see


def warm_up(plan: Plan, gbuffer: str) -> None:
    """Compile the kernels of surfaces and shadows by a plan."""
    make_ready(tracing_job, plan, gbuffer)
    if plan.trace == "cones":
        make_ready(wide_lights_job)


def tracing_job(plan: Plan, gbuffer: str = "raster") -> Job:
    """The job of shadows by a plan, which has the record of pictures by this plan."""

    def work():
        if plan.tracer.chooses:
            trace_all_ways(False)
        trace_small(plan, small_view())

    return Job(record_of(plan, gbuffer, False), work, recorded(plan, gbuffer, False))


def wide_lights_job() -> Job:
    """The job of `cones` with lights too wide for one apex."""

    def work():
        light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
        trace_small(Plan(trace="cones"), (Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]), 16)

    return fixed_job("cones, wide lights", work)


def record_of(plan: Plan, gbuffer: str, counters: bool) -> str:
    """The name under which the kernels of pictures by a plan are recorded."""
    return f"{plan} ({gbuffer}{', counted' if counters else ''})"


def recorded(plan: Plan, gbuffer: str, counters: bool) -> Callable[[], set[Wanted] | None]:
    """A function that gives the recorded kernels of pictures by a plan; None: there is no record.

    A plan without a record gets the kernels of recorded plans with its methods.
    """
    plain = lambda p: needs.of_job(record_of(p, gbuffer, False)) or set()

    def kernels():
        found = needs.of_job(record_of(plan, gbuffer, counters))
        if found is not None:
            return found
        tracing = needs.of_job(record_of(Plan(trace=plan.trace), gbuffer, counters))
        if tracing is None:
            return None
        usual = plain(Plan(trace="single"))
        for methods in _parts(plan):
            with_it = plain(Plan(trace="single", **methods))
            tracing = (tracing - (usual - with_it)) | (with_it - usual)
        return tracing

    return kernels


def _parts(plan: Plan) -> list[dict[str, str]]:
    """Methods whose kernels are recorded together, as fields of a plan, for all methods that the plan adds."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts


def trace_small(plan: Plan, view: tuple[Camera, list], spp: int = 1) -> None:
    """Trace the shadows of a view of the small scene by a plan."""
    make, triangles, (camera, lights) = accelerator_of(plan, 2), small_scene().triangles(0.0, 2), view
    samples = [light_samples(light, spp) for light in lights]
    queries = shadow_queries(triangles, see(triangles, camera, None, 2), lights, samples, 0, 2)
    if make.showing is None:  # all triangles: culling leaves too few to reach all of a builder
        make.build(triangles)
    make.answer_all(make.build(triangles, make.culled(triangles, queries), make.show(triangles, queries)), queries)


def trace_all_ways(counters: bool) -> None:
    """Trace the lights of the small scene in each way that `auto` may choose, over the trees that it may build."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    queries = shadow_queries(triangles, see(triangles, camera, None, 2), lights, [light_samples(s, 1) for s in lights])
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = Forms(build(triangles.vertices, 2), 2)
        for name, way in WAYS.items():
            for query in queries:
                if way.suits(query, forms.box):
                    answer(name, forms, query, 2, new_counters() if counters else None)
