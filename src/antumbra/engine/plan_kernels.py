"""The kernels of plans: the jobs of tracing shadows by a plan, and the records of their kernels.

A plan without a record of its own gets the kernels of plans that use its methods.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..kernels.toolchain import kernel_manifest
from ..kernels.toolchain.compile_pool import KernelRequest
from ..query.light_samples import light_samples
from ..query.shadow_query import shadow_queries
from ..scene.camera import Camera
from ..scene.lights import Light, QuadLight
from ..trace.counters import new_counters
from .auto.cost_model import GOOD, QUICK
from .auto.strategies import STRATEGIES, TreeForms, answer_query
from .auto_accelerator import CULLER, accelerator_of
from .method_registry import BUILDERS, CULLERS, UPDATERS
from .plan import Plan
from .precompilation import WarmUp, fixed_warm_up, precompile, small_scene, small_view
from .primary_visibility import primary_visibility


def warm_up(plan: Plan, gbuffer: str) -> None:
    """Compile the kernels that find surfaces and trace shadows by a plan."""
    precompile(tracing_warm_up, plan, gbuffer)
    if plan.trace == "cones":
        precompile(wide_lights_warm_up)


def tracing_warm_up(plan: Plan, gbuffer: str = "raster") -> WarmUp:
    """The job of tracing shadows by a plan. It shares the kernel record of rendering by this plan."""

    def work() -> None:
        if plan.tracer.chooses:
            trace_all_strategies(False)
        trace_small(plan, small_view())

    return WarmUp(record_name(plan, gbuffer, False), work, recorded(plan, gbuffer, False))


def wide_lights_warm_up() -> WarmUp:
    """The job of `cones` with lights too wide for a single apex."""

    def work() -> None:
        light = QuadLight(np.array([-1, 0.5, -1]), np.array([2, 0, 0]), np.array([0, 0, 2]))
        trace_small(Plan(trace="cones"), (Camera((0, 2, 3), (0, 0, 0), width=96, height=96), [light]), 16)

    return fixed_warm_up("cones, wide lights", work)


def record_name(plan: Plan, gbuffer: str, counters: bool) -> str:
    """The name under which the kernels of rendering by a plan are recorded."""
    return f"{plan} ({gbuffer}{', counted' if counters else ''})"


def recorded(plan: Plan, gbuffer: str, counters: bool) -> Callable[[], set[KernelRequest] | None]:
    """A function that returns the recorded kernels of rendering by a plan, or None if there is no record.

    For a plan without a record, they are combined from the records of plans that use its methods.
    """

    def without_counters(p: Plan) -> set[KernelRequest]:
        return kernel_manifest.kernels_of_warm_up(record_name(p, gbuffer, False)) or set()

    def kernels() -> set[KernelRequest] | None:
        record = kernel_manifest.kernels_of_warm_up(record_name(plan, gbuffer, counters))
        if record is not None:
            return record
        tracing = kernel_manifest.kernels_of_warm_up(record_name(Plan(trace=plan.trace), gbuffer, counters))
        if tracing is None:
            return None
        base = without_counters(Plan(trace="single"))
        for methods in _added_methods(plan):
            extended = without_counters(Plan(trace="single", **methods))
            tracing = (tracing - (base - extended)) | (extended - base)
        return tracing

    return kernels


def _added_methods(plan: Plan) -> list[dict[str, Any]]:
    """The methods that a plan adds to the default one, as plan fields, grouped as their kernels are recorded."""
    fields = "cull", "build", "optimise", "update"
    added = {f: method for f in fields if (method := getattr(plan, f)) not in (None, getattr(Plan(), f))}
    parts: list[dict[str, Any]] = [{field: method} for field, method in added.items()]
    if plan.cull and plan.update:
        parts.append({"cull": "grid32", "update": plan.update})
    return parts


def trace_small(plan: Plan, view: tuple[Camera, list[Light]], spp: int = 1) -> None:
    """Trace the shadows of a view of the small scene by a plan."""
    accelerator, triangles, (camera, lights) = accelerator_of(plan, 2), small_scene().triangles(0.0, 2), view
    samples = [light_samples(light, spp) for light in lights]
    queries = shadow_queries(triangles, primary_visibility(triangles, camera, None, 2), lights, samples, 0, 2)
    if accelerator.ray_selector is None:  # all triangles: culling leaves too few to reach every kernel of a builder
        accelerator.build(triangles)
    accelerator.answer_all(accelerator.tree_for(triangles, queries), queries)


def trace_all_strategies(counters: bool) -> None:
    """Cull for the lights of the small scene, and trace them by every strategy of `auto` in each kind of its trees."""
    triangles, (camera, lights) = small_scene().triangles(0.0, 2), small_view()
    queries = shadow_queries(
        triangles, primary_visibility(triangles, camera, None, 2), lights, [light_samples(s, 1) for s in lights]
    )
    CULLERS[CULLER].cull(triangles, queries, 2)
    for build in (BUILDERS[QUICK].build, UPDATERS["refit"].keep(BUILDERS[GOOD].build).update):
        forms = TreeForms(build(triangles.vertices, 2), 2)
        for name, strategy in STRATEGIES.items():
            for query in queries:
                if strategy.suits(query, forms.extent.box):
                    answer_query(name, forms, query, 2, new_counters() if counters else None)
